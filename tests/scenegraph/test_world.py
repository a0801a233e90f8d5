"""The main path on a small home: what is in the graph, that deltas add up to it, and that bad input changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mapping.errors import InvalidObservation, PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import LabelSpace, RgbdImage, RobotDescription, Scan, Transform
from scenegraph.config import WorldConfig
from scenegraph.errors import InvalidConfig
from scenegraph.graph import Delta, SceneGraph
from scenegraph.meaning import follows_rules
from scenegraph.statements import telling
from scenegraph.world import World
from tests.support import small_home
from tests.support.scenes import Block, Scene, looking_at
from tests.support.small_home import id_of, room_at, stamp

Copy = Callable[[], World]


def names(world: World, relation: str) -> set[tuple[str, str]]:
    """Pairs of class names that a relation joins."""
    return {(world.graph.node(e.source).label, world.graph.node(e.target).label) for e in world.graph.edges(relation)}


# -- what is found -----------------------------------------------------------------------------------------------------


def test_every_thing_is_found_once_where_it_stands(home: World) -> None:
    blocks = {block.thing: block.label for block in small_home.SCENE.blocks if block.thing}
    assert sorted(n.label for n in home.graph.nodes("object")) == sorted(blocks.values())
    for number, label in blocks.items():
        node = home.graph.node(id_of(home, label))
        assert node.position[:2] == pytest.approx(small_home.CENTRES[number], abs=0.08)
        assert node.confidence > 0.9


def test_boxes_are_turned_as_the_things_are(home: World) -> None:
    table = home.graph.node(id_of(home, "table")).box
    assert table is not None
    assert table.size == pytest.approx([1.2, 0.8, 0.74], abs=0.08)
    assert table.yaw == pytest.approx(0.3, abs=0.1)


def test_each_thing_stands_on_what_it_stands_on(home: World) -> None:
    assert names(home, "on") == small_home.ON
    assert names(home, "supports") == {(b, a) for a, b in small_home.ON}


def test_near_does_not_reach_through_the_wall_between_two_rooms(home: World) -> None:
    oven, bed = (home.graph.node(id_of(home, label)) for label in ("oven", "bed"))
    assert np.linalg.norm(oven.position - bed.position) < 1.6
    assert home.graph.edge("near", oven.id, bed.id) is None
    assert home.ask("near(oven, bed)").truth == "false"
    assert home.ask("near(vase, book)").truth == "true"


def test_the_door_parts_two_rooms_and_each_thing_is_in_one(home: World) -> None:
    assert len(home.graph.nodes("room")) == 2
    kitchen, bedroom = room_at(home, small_home.KITCHEN), room_at(home, small_home.BEDROOM)
    expected = dict.fromkeys(("table", "vase", "book", "oven"), kitchen) | {"bed": bedroom, "stool": bedroom}
    housed = [e for e in home.graph.edges("in") if e.target.startswith("room") and not e.source.startswith("place")]
    rooms = {(e.source, e.target) for e in housed}
    agent = {("agent_rob", kitchen)}
    assert rooms == {(id_of(home, label), room) for label, room in expected.items()} | agent
    assert home.graph.node(kitchen).attributes["type"] == "kitchen"
    assert home.graph.node(bedroom).attributes["type"] == "bedroom"
    assert {n.label for n in home.graph.nodes("building")} == {"building"}
    [storey] = home.graph.nodes("storey")
    assert home.graph.edge("in", kitchen, storey.id) is not None
    assert home.graph.edge("in", storey.id, "building_1") is not None
    assert storey.attributes["height_m"] == pytest.approx(2.4, abs=0.02)
    assert home.graph.node(kitchen).attributes["height_m"] == pytest.approx(2.4, abs=0.02)
    assert {row["X"].id for row in home.ask("in(oven, X)")} == {kitchen, storey.id, "building_1"}
    assert home.ask("contains(building, oven)").truth == "true"


def test_walls_floor_and_ceiling_are_labelled(home: World) -> None:
    labels = [n.label for n in home.graph.nodes("structure")]
    assert labels.count("floor") == 1
    assert labels.count("wall") >= 6
    assert labels.count("ceiling") >= 1
    for node in home.graph.nodes("structure", label="wall"):
        normal = np.asarray(node.attributes["normal"], dtype=float)
        assert abs(normal[2]) < 0.05


def test_an_edge_knows_its_measurement_and_its_evidence(home: World) -> None:
    edge = home.graph.edge("on", id_of(home, "vase"), id_of(home, "table"))
    assert edge is not None
    assert edge.value is not None
    assert edge.threshold is not None
    assert edge.value >= edge.threshold
    assert 0.5 <= edge.confidence <= 1.0
    assert all(text.startswith("rob/camera@") for text in edge.evidence)
    assert edge.first_seen_ns <= edge.last_seen_ns


def test_questions_are_answered_and_explained(home: World) -> None:
    answers = home.ask("on(X, table)")
    assert {row["X"].label for row in answers} == {"vase", "book"}
    assert answers.truth == "true"
    assert answers.explain() is not None
    assert "contact" in answers.explain().text  # type: ignore[union-attr]
    assert home.ask("in(oven, kitchen)").truth == "true"
    assert home.ask("in(bed, kitchen)").truth == "false"
    assert home.ask("unicorn(X)").problem is not None
    assert home.ask("near(X, ").problem is not None


def test_the_layers_say_what_they_hold(home: World) -> None:
    status = home.status()
    assert status["revision"] == home.graph.revision
    assert set(status["layers"]) == {"occupancy", "tsdf", "semantics", "instances"}
    assert all(layer["blocks"] > 50 for layer in status["layers"].values())
    assert status["nodes"]["room"] == 2
    labels, confidence = home.map.semantics.query([[1.0, 2.3, 0.74], [0.001, 1.0, 1.5], [1.5, 1.5, 1.2]])
    assert [home.labels.name(int(n)) if n else None for n in labels] == ["table", "wall", None]
    assert (confidence[:2] > 0.9).all()


# -- deltas ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stream() -> Iterator[tuple[World, list[Delta]]]:
    """A world of its own, and every delta that it gave."""
    with small_home.new_world() as world:
        deltas = [world.integrate(observation) for observation in small_home.observations()]  # type: ignore[arg-type]
        deltas.append(world.integrate(small_home.robot_at(*small_home.BEDROOM, stamp(60))))
        yield world, deltas


def test_a_mirror_that_applies_the_deltas_equals_the_graph(stream: tuple[World, list[Delta]]) -> None:
    world, deltas = stream
    mirror = SceneGraph()
    for delta in deltas:
        if delta:
            mirror.apply(delta)
    assert mirror.snapshot() == world.graph.snapshot()


def test_deltas_are_numbered_without_gaps_and_say_only_what_changed(stream: tuple[World, list[Delta]]) -> None:
    _, deltas = stream
    revisions = [delta.revision for delta in deltas if delta]
    assert revisions == list(range(1, len(revisions) + 1))
    stamps = [delta.stamp_ns for delta in deltas if delta]
    assert stamps == sorted(stamps)
    mirror = SceneGraph()
    for delta in deltas:
        if not delta:
            continue
        for node in delta.nodes.put:
            assert node.id not in mirror or mirror.node(node.id) != node
        for edge in delta.edges.put:
            assert mirror.edge(edge.relation, edge.source, edge.target) != edge
        mirror.apply(delta)


def test_the_same_observations_give_the_same_graph(stream: tuple[World, list[Delta]], home: World) -> None:
    world, _ = stream
    assert {n.id: (n.label, n.position.tolist()) for n in world.graph.nodes("object")} == {
        n.id: (n.label, n.position.tolist()) for n in home.graph.nodes("object")
    }
    for relation in ("on", "in", "near", "above", "touching"):
        one = {e.key for e in world.graph.edges(relation) if "agent" not in e.source}
        assert one == {e.key for e in home.graph.edges(relation) if "agent" not in e.source}


def test_the_robot_is_in_the_room_where_it_stands(stream: tuple[World, list[Delta]]) -> None:
    world, deltas = stream
    rooms = [e.target for e in world.graph.edges("in", source="agent_rob")]
    assert rooms == [room_at(world, small_home.BEDROOM)]
    assert ["in", "agent_rob", room_at(world, small_home.KITCHEN)] in [list(key) for key in deltas[-1].edges.deleted]
    past = world.graph.as_of(stamp(50))
    assert [e.target for e in past.edges("in", source="agent_rob")] == [room_at(world, small_home.KITCHEN)]


def test_what_stored_edges_say_follows_from_the_rules(stream: tuple[World, list[Delta]]) -> None:
    """Edges kept up to date bit by bit are those that the rules derive from all measurements."""
    world, _ = stream
    ids = [n.id for layer in ("object", "structure", "agent") for n in world.graph.nodes(layer)]
    _, edges = world.meaning.knowledge.derived_edges(ids)
    derived = {(e.relation, e.source, e.target) for e in edges}
    stored = {tuple(e.key) for e in world.graph.edges() if follows_rules(e)}
    assert stored == derived


# -- bad input ---------------------------------------------------------------------------------------------------------


def state_of(world: World) -> tuple[object, ...]:
    layers = world.map.layers
    blocks = [
        (name, field, values.shape, float(values.sum(dtype=np.float64)))
        for name, layer in layers.items()
        for field, values in layer.store.state().items()
    ]
    ids = {i: known.views for i, known in world.map.instances.instances.items()}
    classes = [c.name for c in world.labels.classes]
    return (
        world.graph.revision,
        world.graph.snapshot(),
        blocks,
        ids,
        world.map.planes.ids,
        classes,
        len(world.statements),
    )


def first_image(**changes: object) -> RgbdImage:
    return small_home.images()[0].model_copy(update={"stamp_ns": stamp(99), **changes})


@pytest.fixture(scope="module")
def mapped(copy_home: Copy) -> World:
    return copy_home()


def test_an_image_without_a_pose_is_refused_and_changes_nothing(mapped: World) -> None:
    before = state_of(mapped)
    with pytest.raises(PoseUnavailable):
        mapped.integrate(first_image(T_map_camera=None))
    assert state_of(mapped) == before


def test_a_scan_without_a_pose_is_refused_and_changes_nothing(mapped: World) -> None:
    before = state_of(mapped)
    with pytest.raises(PoseUnavailable):
        mapped.integrate(Scan(stamp_ns=stamp(99), robot="rob", sensor="lidar", points=np.ones((5, 3), np.float32)))
    assert state_of(mapped) == before


def test_a_class_id_that_no_label_space_names_is_refused_before_anything_changed(mapped: World) -> None:
    before = state_of(mapped)
    labels = np.array(small_home.images()[0].labels)
    labels[10, 10] = 4711
    with pytest.raises(InvalidObservation, match="4711"):
        mapped.integrate(first_image(labels=labels))
    points = Scan(
        stamp_ns=stamp(99), robot="rob", sensor="lidar", points=np.ones((5, 3), np.float32),
        T_map_sensor=SE3.identity(), labels=np.full(5, 4711, np.uint16),
    )  # fmt: skip
    with pytest.raises(InvalidObservation, match="4711"):
        mapped.integrate(points)
    assert state_of(mapped) == before


def test_labels_before_any_label_space_are_refused() -> None:
    with World() as world:
        with pytest.raises(InvalidObservation, match="label space"):
            world.integrate(small_home.images()[0])
        assert len(world.map.tsdf.block_ijk) == 0
        assert world.graph.revision == 0


def test_what_is_no_observation_is_refused(mapped: World) -> None:
    with pytest.raises(TypeError, match="observation"):
        mapped.integrate({"stamp_ns": 1})  # type: ignore[arg-type]


def test_a_world_is_set_up_with_sensible_numbers_only() -> None:
    for bad in ({"voxel_size_m": -1.0}, {"voxel_size_m": float("nan")}, {"max_range_m": 0.0}, {"voxels": 0.05}):
        with pytest.raises(InvalidConfig, match=next(iter(bad))):
            WorldConfig(**bad)


# -- other observations ------------------------------------------------------------------------------------------------


def test_a_pose_is_looked_up_in_the_frame_tree() -> None:
    scene = Scene(
        (Block("floor", (0.0, 0.0, -0.1), (6.0, 6.0, 0.2)), Block("crate", (1.5, 0.0, 0.3), (0.6, 0.6, 0.6), 1))
    )
    T_map_camera = looking_at((0.0, 0.0, 1.0), (1.5, 0.0, 0.3))
    T_base_camera = SE3(np.eye(3), (0.1, 0.0, 0.9))
    with World() as given, World() as looked_up:
        for world in (given, looked_up):
            world.integrate(scene.label_space)
        optical = SE3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
        T_map_base = T_map_camera @ optical.inverse() @ T_base_camera.inverse()
        looked_up.integrate(
            Transform(
                stamp_ns=0,
                robot="rob",
                parent="base_link",
                child="camera",
                T_parent_child=T_base_camera,
                static=True,
            )
        )
        looked_up.integrate(small_home.robot_at(0.0, 0.0, 1).model_copy(update={"T_map_base": T_map_base}))
        image = scene.image(T_map_camera, 1)
        given.integrate(image)
        looked_up.integrate(image.model_copy(update={"T_map_camera": None}))
        at = [[1.5, 0.0, 0.601], [0.7, 0.1, 0.01]]
        assert looked_up.map.tsdf.query(at) == pytest.approx(given.map.tsdf.query(at), abs=1e-4, nan_ok=True)


def test_a_labelled_scan_builds_all_layers() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    walls = 2.0 / np.abs(directions).max(axis=1)
    points = (directions * walls[:, None]).astype(np.float32)
    with World() as world:
        world.integrate(LabelSpace(classes={7: {"name": "wall", "kind": "stuff"}}))
        scan = Scan(
            stamp_ns=1, robot="rob", sensor="lidar", points=points, T_map_sensor=SE3.identity(),
            labels=np.full(len(points), 7, np.uint16),
        )  # fmt: skip
        delta = world.integrate(scan)
        assert delta
        assert world.labels.name(int(world.map.semantics.query([[2.01, 0.0, 0.3]])[0][0])) == "wall"
        assert world.map.occupancy.classify(
            np.array([[1.0, 0.0, 0.0], [2.01, 0.5, 0.5], [9.0, 0.0, 0.0]])
        ).tolist() == [0, 1, -1]
        assert len(world.graph.nodes("structure")) == 6


def test_a_robot_may_describe_itself(copy_home: Copy) -> None:
    world = copy_home()
    world.integrate(
        RobotDescription(
            robot="rob", height_m=0.8, max_width_m=0.4, footprint=[[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]
        )
    )
    assert world.robots["rob"].height_m == 0.8


# -- odd but valid input -----------------------------------------------------------------------------------------------


def test_the_past_can_be_asked(stream: tuple[World, list[Delta]]) -> None:
    world, _ = stream
    [then] = [row["X"].id for row in world.ask("in(agent_rob, X), room(X)", at_ns=stamp(50))]
    [now] = [row["X"].id for row in world.ask("in(agent_rob, X), room(X)")]
    assert (then, now) == (room_at(world, small_home.KITCHEN), room_at(world, small_home.BEDROOM))
    assert world.ask("on(vase, table)", at_ns=stamp(0)).truth != "true", "it had not been seen yet"


@pytest.mark.parametrize(
    "changes",
    [
        {"depth": np.zeros((150, 200), np.float32)},
        {"depth": np.full((150, 200), 30.0, np.float32)},
        {"depth": np.full((150, 200), 0.001, np.float32)},
        {"depth": np.full((150, 200), 1500, np.uint16)},
        {"T_map_camera": SE3(np.eye(3), (5000.0, -5000.0, 300.0))},
        {"instances": None},
        {"labels": None},
        {"labels": None, "instances": None},
        {"label_confidence": np.zeros((150, 200), np.float32)},
        {"covariance": np.zeros((6, 6))},
        {"covariance": np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.001])},
        {"covariance": 100.0 * np.eye(6)},
    ],
)
def test_an_odd_image_does_no_harm(mapped: World, changes: dict[str, object]) -> None:
    image = small_home.images()[5]
    mapped.integrate(RgbdImage(**{**dict(image), "stamp_ns": stamp(700), **changes}))
    assert mapped.ask("on(vase, table)").truth == "true"
    assert len(mapped.graph.nodes("object")) == 6


def test_an_image_of_one_pixel_and_an_empty_scan_do_no_harm(mapped: World) -> None:
    pixel = RgbdImage(
        stamp_ns=stamp(710), robot="rob", sensor="tiny", depth=np.ones((1, 1), np.float32), T_map_camera=SE3.identity(),
        intrinsics={"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "width": 1, "height": 1},
        labels=np.ones((1, 1), np.uint16),
    )  # fmt: skip
    mapped.integrate(pixel)
    nothing = np.empty((0, 3), np.float32)
    mapped.integrate(
        Scan(stamp_ns=stamp(711), robot="rob", sensor="lidar", points=nothing, T_map_sensor=SE3.identity())
    )
    assert mapped.ask("on(vase, table)").truth == "true"


def test_images_that_come_in_any_order_of_time_give_the_same_things(home: World) -> None:
    images = list(small_home.images())
    with small_home.new_world() as world:
        world.integrate(small_home.SCENE.label_space)
        for image in images[::-1]:
            delta = world.integrate(image)
            assert delta.stamp_ns == images[-1].stamp_ns, "the graph's time does not run back"
        assert names(world, "on") == small_home.ON
        for node in world.graph.nodes("object"):
            assert 0 < node.first_seen_ns <= node.last_seen_ns <= images[-1].stamp_ns
            assert node.position == pytest.approx(home.graph.node(id_of(home, node.label)).position, abs=0.05)


@pytest.mark.parametrize("label", ["3D printer!", "été 🙂", "halt", "Near", "[]", "a'b\\\"c", "room", "fact(x)"])
def test_a_class_may_be_called_anything(label: str) -> None:
    scene = Scene(
        (Block("floor", (0.0, 0.0, -0.1), (6.0, 6.0, 0.2)), Block(label, (1.5, 0.0, 0.3), (0.6, 0.6, 0.6), 1))
    )
    with World() as world:
        world.integrate(scene.label_space)
        for n in range(4):
            world.integrate(scene.image(looking_at((0.0, 0.2 * n, 1.2), (1.5, 0.0, 0.3)), stamp(n)))
        [node] = world.graph.nodes("object")
        assert node.label == label
        assert [row["X"].id for row in world.ask("on(X, Y), object(X)")] in ([node.id], [])
        assert world.ask("on(X, Y)").truth == "true"


def test_rules_that_were_told_last_and_can_be_taken_back(home: World, tmp_path: Path) -> None:
    rules = 'signature(laden(thing), "something stands on it").\nladen(X) :- furniture(X), on(_, X).'
    told = home.tell(telling("tidy", rules), author="operator", reason="to tidy up")
    assert told.accepted, told.problem
    assert home.status()["rules"] == {"tidy": {"laden(thing)": "something stands on it"}}
    before = {row["X"].id for row in home.ask("laden(X)")}
    assert before
    home.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        assert {row["X"].id for row in again.ask("laden(X)")} == before
    refused = home.tell('rules(tidy, "laden(X) :- halt.")', author="somebody")
    assert not refused.accepted
    assert refused.problem is not None
    assert "line 1" in refused.problem.message
    assert {row["X"].id for row in home.ask("laden(X)")} == before
    assert home.tell("forget_rules(tidy)", author="operator").accepted
    assert home.status()["rules"] == {}
    assert home.ask("laden(X)").problem is not None
    assert [s.kind for s in home.statements if "rules" in s.kind] == ["rules", "forget_rules"]


def test_a_proof_goes_down_to_the_observations(home: World) -> None:
    why = home.ask("on(vase, table)").explain()
    assert why is not None
    [on] = why.children
    assert on.observations
    assert all(seen.startswith("rob/camera@") for seen in on.observations)
    assert f"seen by {on.observations[0]}" in why.text
