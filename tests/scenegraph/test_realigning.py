"""Things move as the poses moved that they were seen from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import AgentPose, CorrectedPose, PoseCorrection, RgbdImage
from reasoning.knowledge import KnowledgeBase
from scenegraph.errors import InvalidGraphValue
from scenegraph.graph import Box, Delta, Edge, GraphChanges, Node, SceneGraph, Tombstone
from scenegraph.graph.delta import NodeChanges
from scenegraph.realigning import MOST_SIGHTINGS, Corrections, Sightings, carried, motions, realign
from scenegraph.relating import Thresholds, relate
from scenegraph.rigid import moved
from tests.support import small_home
from tests.support.furnished import furnished, turned
from tests.support.graphs import graphs

if TYPE_CHECKING:
    from scenegraph.world import World

poses = st.builds(turned, st.floats(-3.1, 3.1), st.floats(-5, 5), st.floats(-5, 5), st.floats(-0.5, 0.5))
HERE = SE3.identity()


@pytest.fixture(scope="module")
def thresholds() -> Iterator[Thresholds]:
    with KnowledgeBase() as knowledge:
        yield Thresholds.of(knowledge)


def correction(*found: tuple[int, SE3], until_ns: int = 1000, robot: str = "spot") -> Corrections:
    """At each time the robot was believed to be at the origin, and was really at the pose."""
    told = [CorrectedPose(stamp_ns=stamp, T_map_base=T, T_map_base_before=HERE) for stamp, T in found]
    return Corrections(PoseCorrection(stamp_ns=until_ns, robot=robot, poses=tuple(told)))


def thing(node_id: str, x: float, first: int, last: int, label: str = "cup") -> Node:
    box = Box(center=(x, 0, 0.1), size=(0.2, 0.2, 0.2))
    return Node(
        id=node_id, layer="object", label=label, position=(x, 0, 0.1), box=box, first_seen_ns=first, last_seen_ns=last
    )


def graph_of(*nodes: Node) -> SceneGraph:
    changes = GraphChanges()
    for node in nodes:
        changes.put(node)
    graph = SceneGraph()
    graph.commit(changes, 1)
    return graph


def put(*nodes: Node) -> Delta:
    """A change of the graph that puts nodes."""
    return Delta(revision=1, stamp_ns=0, nodes=NodeChanges(put=nodes))


# -- corrections -----------------------------------------------------------------------------------------------------


@given(poses, poses, st.floats(0.0, 1.0))
def test_a_correction_is_interpolated_and_holds_until_it_was_found(a: SE3, b: SE3, share: float) -> None:
    found = correction((100, a), (200, b), until_ns=300)
    assert found.at(100).isclose(a)
    assert found.at(200).isclose(b)
    assert found.at(250).isclose(b)
    assert found.at(300).isclose(b)
    assert found.at(99) == found.at(301) == SE3.identity()
    stamp = 100 + round(100 * share)
    assert found.at(stamp).isclose(a.interpolate(b, (stamp - 100) / 100), atol=1e-6)


def test_what_nobody_knows_about_is_asked_for() -> None:
    told = PoseCorrection(stamp_ns=5, robot="spot", poses=(CorrectedPose(stamp_ns=3, T_map_base=HERE),))
    with pytest.raises(InvalidGraphValue, match=r"poses\[0\].T_map_base_before: needed.*at 3 ns"):
        Corrections(told)
    assert Corrections(told, [turned(0.0, 1.0)]).at(4).translation.tolist() == [-1, 0, 0]


# -- motions ---------------------------------------------------------------------------------------------------------


@given(graphs(), poses)
@settings(max_examples=30)
def test_nothing_but_a_rigid_motion_happens_to_a_node(graph: SceneGraph, T: SE3) -> None:
    for node in graph:
        same = moved(moved(node, T), T.inverse())
        np.testing.assert_allclose(same.position, node.position, atol=1e-9)
        assert (same.id, same.layer, same.label, same.last_seen_ns) == (
            node.id,
            node.layer,
            node.label,
            node.last_seen_ns,
        )
        if node.box is not None and node.layer not in ("room", "storey", "building"):
            np.testing.assert_allclose(moved(node, T).box.corners(), T @ node.box.corners(), atol=1e-9)
            np.testing.assert_allclose(same.box.corners(), node.box.corners(), atol=1e-9)


def test_footprints_planes_and_heights_are_carried_along() -> None:
    T = turned(np.pi / 2, 1.0, 2.0, 0.5)
    home = furnished(3)
    room, wall = moved(home.node("room_1"), T), moved(home.node("plane_1"), T)
    assert room.attributes["footprint"] == [[1, 2], [1, 6], [-3, 6], [-3, 2]]
    assert room.attributes["floor_z"] == 0.5
    np.testing.assert_allclose(room.box.size, (4, 4, 2.5))
    assert wall.attributes["normal"] == [0, 1, 0]
    assert wall.attributes["offset"] == pytest.approx(wall.position[1])


@given(st.integers(0, 100), poses)
@settings(max_examples=6)
def test_when_all_poses_moved_alike_all_things_do_and_stay_as_they_are_to_each_other(
    thresholds: Thresholds, seed: int, T: SE3
) -> None:
    home = furnished(seed)
    before = {node.id: node for node in home}
    edges = {edge.key: edge for edge in home.edges()}
    delta = home.commit(realign(home, correction((0, T), until_ns=2000), thresholds), 3000)
    assert delta.revision == home.revision <= 2
    assert {node.id for node in home} == before.keys()
    assert {edge.key: edge for edge in home.edges()} == edges
    for node in home:
        expected = before[node.id].position if node.layer == "building" else T @ before[node.id].position
        np.testing.assert_allclose(node.position, expected, atol=1e-9)


@given(st.integers(0, 10_000), st.floats(0.05, 0.3), st.booleans())
@settings(max_examples=15)
def test_a_closed_loop_puts_things_back_where_they_are(seed: int, drift: float, remembered: bool) -> None:
    """A robot drifts on its way; things stand where the mean of its sights puts them; then it learns its true way."""
    rng = np.random.default_rng(seed)

    def believed(stamp: int) -> SE3:  # where the map then lies in the true one: a walk that ends `drift` per second off
        s = stamp * 1e-2
        return turned(0.02 * s * drift, drift * s, 0.3 * drift * s * np.sin(s))

    true = {f"object_{k}": rng.uniform(-5, 5, 3) for k in range(20)}
    sightings, nodes = Sightings(), []
    for node_id, place in true.items():
        start = int(rng.integers(0, 800))
        stamps = sorted({start + int(n) for n in rng.integers(0, 60, int(rng.integers(1, 20)))})
        seen_at = np.mean([believed(stamp) @ place for stamp in stamps], axis=0)
        node = Node(
            id=node_id, layer="object", label="cup", position=seen_at, first_seen_ns=stamps[0], last_seen_ns=stamps[-1]
        )
        nodes.append(node)
        if remembered:
            for stamp in stamps:
                sightings.note(put(node.replace(last_seen_ns=stamp, first_seen_ns=stamp)), "spot", stamp)
    graph = graph_of(*nodes)
    way = [(stamp, turned(0.001 * stamp, 0.01 * stamp)) for stamp in range(0, 1000, 40)]
    told = tuple(CorrectedPose(stamp_ns=stamp, T_map_base=T, T_map_base_before=believed(stamp) @ T) for stamp, T in way)
    corrections = Corrections(PoseCorrection(stamp_ns=2000, robot="spot", poses=told))
    moves = motions(graph, corrections, sightings)
    for node in graph:
        error = np.linalg.norm(node.position - true[node.id])
        left = np.linalg.norm(moved(node, moves.get(node.id, HERE)).position - true[node.id])
        assert left <= max(0.02, 0.15 * error if remembered else 0.3 * error)


def test_rooms_go_with_what_is_in_them_and_robots_with_their_last_pose() -> None:
    home = furnished(4)
    changes = GraphChanges()
    for robot in ("spot", "tiago"):
        changes.put(
            Node(
                id=f"agent_{robot}", layer="agent", label="robot", position=(1, 1, 0), first_seen_ns=1,
                last_seen_ns=900, attributes={"name": robot},
            )
        )  # fmt: skip
    home.commit(changes, 1001)
    moves = motions(home, correction((0, turned(0.0, 0.5)), until_ns=5000))
    assert moves["room_1"].translation.tolist() == pytest.approx([0.5, 0, 0])
    assert moves["agent_spot"].translation.tolist() == [0.5, 0, 0]
    assert "agent_tiago" not in moves
    assert "building_1" not in moves


def test_each_point_of_a_robots_way_moves_by_the_correction_at_its_time() -> None:
    way = {"trajectory": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "trajectory_ns": [100, 150, 200], "name": "spot"}
    robot = Node(
        id="agent_spot", layer="agent", label="robot", position=(2, 0, 0), first_seen_ns=100, last_seen_ns=5000,
        attributes=way,
    )  # fmt: skip
    graph = graph_of(robot)
    corrections = correction((100, HERE), (200, turned(0.0, 0.0, 1.0)))
    moves = motions(graph, corrections)
    [after] = carried(graph, moves, corrections)
    assert after.attributes["trajectory"] == [[0, 0, 0], [1, 0.5, 0], [2, 1, 0]]
    assert after.position.tolist() == [2, 0, 0]  # a pose that came after the correction is right


def test_what_another_robot_saw_counts_against_it() -> None:
    graph = graph_of(thing("object_1", 0.0, 10, 20))
    sightings = Sightings()
    sightings.restore({"object_1": [["spot", 10, 1.0], ["tiago", 20, 3.0]]})
    moves = motions(graph, correction((0, turned(0.0, 1.0))), sightings)
    assert moves["object_1"].translation.tolist() == pytest.approx([0.25, 0, 0])


def test_the_place_of_a_way_between_rooms_goes_with_it(thresholds: Thresholds) -> None:
    door = thing("object_1", 1.0, 100, 200, label="door")
    rooms = [
        Node(id=f"room_{n}", layer="room", label="room", position=(n, 0, 0), first_seen_ns=100, last_seen_ns=200)
        for n in (1, 2)
    ]
    graph = graph_of(door, *rooms)
    changes = GraphChanges()
    for room in rooms:
        way = {"at": [1.0, 0.0], "open": True}
        changes.put(
            Edge(
                relation="connects", source=door.id, target=room.id, attributes=way, first_seen_ns=100,
                last_seen_ns=200,
            )
        )  # fmt: skip
    graph.commit(changes, 2)
    graph.commit(realign(graph, correction((50, turned(np.pi / 2, 3.0))), thresholds), 3)
    for edge in graph.edges("connects"):
        assert edge.attributes["at"] == pytest.approx([3.0, 1.0])
        assert edge.attributes["open"] is True


def test_relations_are_inferred_anew_between_what_did_not_move_alike(thresholds: Thresholds) -> None:
    nodes = [
        thing("object_1", 0.0, 0, 10), thing("object_2", 0.4, 0, 10),  # seen together: stay near each other
        thing("object_3", 5.0, 500, 510), thing("object_4", 0.8, 500, 510),  # seen later, a metre off
    ]  # fmt: skip
    graph = graph_of(*nodes)
    first = GraphChanges()
    for edge in relate(nodes, thresholds):
        first.put(edge)
    graph.commit(first, 2)
    near = {(edge.source, edge.target) for edge in graph.edges("near")}
    assert ("object_2", "object_4") in near
    kept = graph.edge("near", "object_1", "object_2")
    graph.commit(realign(graph, correction((400, turned(0.0, -4.5)), until_ns=600), thresholds), 3)
    near = {(edge.source, edge.target) for edge in graph.edges("near")}
    assert graph.edge("near", "object_1", "object_2") == kept
    assert ("object_2", "object_4") not in near
    assert {("object_2", "object_3"), ("object_3", "object_2")} <= near
    anew = {edge.key for edge in relate(list(graph), thresholds)}
    assert {edge.key for edge in graph.edges()} == anew


# -- what is kept of when things were seen ---------------------------------------------------------------------------


@given(st.lists(st.tuples(st.sampled_from(["spot", "tiago"]), st.integers(0, 10**12)), min_size=1, max_size=60))
def test_sightings_are_few_and_weigh_as_much_as_all(seen: list[tuple[str, int]]) -> None:
    sightings = Sightings()
    for robot, stamp in seen:
        sightings.note(put(thing("object_1", 0.0, 0, stamp)), robot, stamp)
    kept = sightings.of("object_1")
    assert len(kept) <= MOST_SIGHTINGS
    for robot in ("spot", "tiago"):
        stamps = [stamp for name, stamp in seen if name == robot]
        mine = [s for s in kept if s.robot == robot]
        assert sum(s.weight for s in mine) == len(stamps)
        if stamps:
            mean = sum(s.weight * s.stamp_ns for s in mine) / len(stamps)
            assert mean == pytest.approx(np.mean(stamps), abs=60)
    again = Sightings()
    again.restore(sightings.document())
    assert list(again.of("object_1")) == list(kept)


def test_the_heir_was_seen_when_the_dead_were() -> None:
    sightings = Sightings()
    sightings.restore(
        {"object_1": [["spot", 10, 1.0]], "object_2": [["spot", 30, 2.0]], "object_3": [["spot", 1, 1.0]]}
    )
    stones = (
        Tombstone(id="object_1", became="object_2", reason="", stamp_ns=40),
        Tombstone(id="object_3", reason="", stamp_ns=40),
    )
    sightings.note(Delta(revision=1, stamp_ns=40, tombstones=stones), "spot", 40)
    assert [tuple(s) for s in sightings.of("object_2")] == [("spot", 10, 1.0), ("spot", 30, 2.0)]
    assert sightings.of("object_1") == sightings.of("object_3") == ()


# -- in a world ------------------------------------------------------------------------------------------------------


def test_a_world_follows_a_correction_in_one_change(copy_home: Callable[[], World]) -> None:
    world = copy_home()
    before = {node.id: node for node in world.graph}
    edges = {edge.key for edge in world.graph.edges()}
    events = len(world.events())
    T = turned(0.3, 2.0, -1.0)
    stamp = world.graph.stamp_ns + 1
    told = CorrectedPose(stamp_ns=0, T_map_base=T, T_map_base_before=HERE)
    delta = world.integrate(PoseCorrection(stamp_ns=stamp, robot="rob", poses=(told,)))
    robot = next(iter({s.robot for node_id in before for s in world.sightings.of(node_id)}))
    assert robot == "rob"
    assert delta.revision == world.graph.revision
    assert len({node.id for node in delta.nodes.put}) >= len(world.graph.nodes("object"))
    for node in world.graph.nodes("object"):
        np.testing.assert_allclose(node.position, T @ before[node.id].position, atol=1e-9)
    assert {node.id for node in world.graph} == before.keys()
    assert {edge.key for edge in world.graph.edges()} == edges
    assert len(world.events()) == events  # nothing was carried anywhere
    assert world.ask("on(vase, table)").truth == "true"


def test_believed_poses_are_looked_up_and_corrected(copy_home: Callable[[], World]) -> None:
    world = copy_home()
    start = world.graph.stamp_ns
    for k in range(3):
        world.integrate(AgentPose(stamp_ns=start + k * 10**8, robot="spot", T_map_base=turned(0.0, 0.1 * k)))
    stamp = start + 2 * 10**8
    told = CorrectedPose(stamp_ns=stamp, T_map_base=turned(0.0, 1.2))
    world.integrate(PoseCorrection(stamp_ns=stamp, robot="spot", poses=(told,)))
    assert world.frames.lookup("spot", "map", "base_link", stamp).translation[0] == pytest.approx(1.2)
    assert world.frames.lookup("spot", "map", "base_link", start).translation[0] == 0.0
    robot = world.graph.node("agent_spot")
    assert robot.position[0] == pytest.approx(1.2)
    unknown = CorrectedPose(stamp_ns=1, T_map_base=HERE)
    with pytest.raises(PoseUnavailable):
        world.integrate(PoseCorrection(stamp_ns=stamp, robot="nobody", poses=(unknown,)))


def test_a_home_that_was_mapped_with_drift_is_put_right(home: World) -> None:
    """The robot drifts a third of a metre on its tour; its corrected poses bring things back to within centimetres."""
    images = [o for o in small_home.observations() if isinstance(o, RgbdImage)]
    first, last = images[0].stamp_ns, images[-1].stamp_ns

    def drifted(stamp_ns: int) -> SE3:
        share = (stamp_ns - first) / (last - first)
        return turned(0.04 * share, 0.3 * share, -0.15 * share)

    true = {node.label: node.position for node in home.graph.nodes("object")}

    def errors(world: World) -> list[float]:
        return [float(np.linalg.norm(node.position - true[node.label])) for node in world.graph.nodes("object")]

    with small_home.new_world() as world:
        for observation in small_home.observations():
            if isinstance(observation, RgbdImage):
                T_map_camera = drifted(observation.stamp_ns) @ observation.T_map_camera
                observation = observation.model_copy(update={"T_map_camera": T_map_camera})
            world.integrate(observation)
        before = errors(world)
        ids = {node.id for node in world.graph}
        told = tuple(
            CorrectedPose(
                stamp_ns=image.stamp_ns,
                T_map_base=image.T_map_camera,
                T_map_base_before=drifted(image.stamp_ns) @ image.T_map_camera,
            )
            for image in images[::4]
        )
        world.integrate(PoseCorrection(stamp_ns=last + 1, robot=images[0].robot, poses=told))
        after = errors(world)
        assert {node.id for node in world.graph} == ids
    assert np.median(before) > 0.08
    assert np.median(after) < 0.03
