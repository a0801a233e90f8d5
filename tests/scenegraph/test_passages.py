"""Doors and openings between rooms."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
import shapely

from mapping.occupancy import OccupancyMap
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.ground import GroundGrid
from scenegraph.perception.passages import Passages
from scenegraph.perception.shapes import Shape
from scenegraph.perception.storeys import CELL_M, Storey

if TYPE_CHECKING:
    from scenegraph.world import World

WALL_X = 3.0


def two_rooms(
    gap: tuple[float, float] | None, *, yaw: float = 0.0, hidden: tuple[float, float] = (0.0, 0.0)
) -> tuple[Storey, OccupancyMap, SceneGraph]:
    """Rooms 1 and 2, 3 m × 3 m, on either side of a wall at x = 3 that is open between two y, turned about the origin.

    hidden : between these y nothing was seen in the wall
    """
    ground = GroundGrid(CELL_M)
    ground.cover(np.array([-60, -60]), np.array([79, 79]))
    x, y = unturned((np.indices(ground.room.shape) + ground.low[:, None, None] + 0.5) * CELL_M, yaw)
    inside = (x >= 0) & (x < 6) & (y >= 0) & (y < 3)
    ground.room[:] = np.where(inside, np.where(x < WALL_X, 1, 2), 0)
    occupancy = OccupancyMap(voxel_size_m=0.05)
    centres = np.stack(np.meshgrid(*(np.arange(a, b, 0.05) for a, b in ((-5.975, 8), (-5.975, 8), (0.025, 2)))), -1)
    centres = centres.reshape(-1, 3)
    x, y = unturned(centres[:, :2].T, yaw)
    seen = (x > 0) & (x < 6) & (y > 0) & (y < 3)
    wall = np.abs(x - WALL_X) < 0.06
    seen &= ~(wall & (y > hidden[0]) & (y < hidden[1]))
    if gap is not None:
        wall &= (y < gap[0]) | (y > gap[1])
    occupancy.assign(centres[seen], np.where(wall, 20, -20)[seen])
    graph = SceneGraph()
    changes = GraphChanges()
    for n in (1, 2):
        changes.put(
            Node(id=f"room_{n}", layer="room", label="room", position=(n, 1, 0), first_seen_ns=0, last_seen_ns=0)
        )
    graph.commit(changes, 0)
    return Storey(1, 0.0, ground), occupancy, graph


def unturned(xy: np.ndarray, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, …) in the frame of a building that is turned by yaw."""
    (x, y), c, s = xy, np.cos(yaw), np.sin(yaw)
    return c * x + s * y, c * y - s * x


def passages_of(
    gap: tuple[float, float] | None, doors: dict[str, Shape] | None = None, **how: object
) -> tuple[SceneGraph, Callable[[tuple[float, float] | None], None]]:
    """The graph with the passages, and a function that builds the wall anew and looks again."""
    passages = Passages()
    storey, occupancy, graph = two_rooms(gap, **how)  # type: ignore[arg-type]
    add = GraphChanges()
    for door in doors or {}:
        add.put(Node(id=door, layer="structure", label="door", position=(3, 1, 1), first_seen_ns=0, last_seen_ns=0))
    graph.commit(add, 0)

    outline = shapely.box(-6.0, -6.0, 8.0, 8.0)

    def look(storey: Storey, occupancy: OccupancyMap, stamp_ns: int) -> None:
        near = passages.see(doors or {}, doors or {}, dict.fromkeys(doors or {}, "door"))
        moved = {"room_1", *near}
        graph.commit(passages.update([storey], moved, {"room_1": outline}, occupancy, graph, stamp_ns), stamp_ns)

    look(storey, occupancy, 1)

    def again(other: tuple[float, float] | None) -> None:
        changed, space, _ = two_rooms(other)
        look(changed, space, 2)

    return graph, again


def door_at(y: float) -> Shape:
    """A shut leaf of 0.9 m × 2 m in the wall."""
    y_, z_ = np.meshgrid(np.arange(y - 0.45, y + 0.451, 0.025), np.arange(0.0, 2.0, 0.025))
    return Shape(np.column_stack([np.full(y_.size, WALL_X), y_.ravel(), z_.ravel()]).astype(np.float32), 0.025)


def joined(graph: SceneGraph) -> dict[str, set[str]]:
    return {e.source: {o.target for o in graph.edges("connects", source=e.source)} for e in graph.edges("connects")}


def test_a_gap_in_the_wall_is_a_doorway_that_connects_both_rooms() -> None:
    graph, _ = passages_of((1.0, 1.9))
    assert joined(graph) == {"passage_1": {"room_1", "room_2"}}
    node = graph.node("passage_1")
    assert node.label == "doorway"
    assert node.attributes["width_m"] == pytest.approx(0.9, abs=0.11)
    assert np.allclose(node.position[:2], (3.0, 1.45), atol=0.11)


@pytest.mark.parametrize(("a", "b"), [("room_1", "room_2"), ("room_2", "room_1")])
def test_adjacency_goes_both_ways_and_names_the_passage(a: str, b: str) -> None:
    graph, _ = passages_of((1.0, 1.9))
    edge = graph.edge("adjacent", a, b)
    assert edge is not None
    assert edge.attributes["through"] == "passage_1"


def test_a_wide_gap_is_an_opening() -> None:
    graph, _ = passages_of((0.4, 2.6))
    assert graph.node("passage_1").label == "opening"


@pytest.mark.parametrize("gap", [None, (1.0, 1.3)])
def test_a_whole_wall_or_a_narrow_slit_connects_nothing(gap: tuple[float, float] | None) -> None:
    graph, _ = passages_of(gap)
    assert not joined(graph)


def test_a_gap_with_a_leaf_beside_it_goes_by_the_door() -> None:
    graph, _ = passages_of((1.0, 1.9), {"opening_7": door_at(1.4)})
    assert joined(graph) == {"opening_7": {"room_1", "room_2"}}
    assert all(e.attributes["open"] for e in graph.edges("connects"))


@pytest.mark.parametrize(
    ("gap", "by_leaf"), [((1.0, 1.9), True), ((1.0, 1.75), True), ((0.9, 2.1), False), ((1.2, 1.7), False)]
)
def test_an_opening_is_as_wide_as_its_leaf_unless_that_is_narrower_or_much_wider(
    gap: tuple[float, float], by_leaf: bool
) -> None:
    """What rims of voxels hide is the leaf's; a part of a leaf, or a wall taken for one, says nothing."""
    bare = passages_of(gap)[0].node("passage_1").attributes["width_m"]
    graph, _ = passages_of(gap, {"opening_7": door_at(float(np.mean(gap)))})
    [width] = {edge.value for edge in graph.edges("connects", source="opening_7")}
    assert width == pytest.approx(0.9 if by_leaf else bare, abs=0.01)
    assert by_leaf or width == bare


def test_a_shut_door_connects_its_rooms_and_says_so() -> None:
    graph, _ = passages_of(None, {"opening_7": door_at(1.4)})
    assert joined(graph) == {"opening_7": {"room_1", "room_2"}}
    assert not any(e.attributes["open"] for e in graph.edges("connects"))


def test_a_shut_door_seen_as_two_things_is_one_door() -> None:
    sides = {"opening_7": door_at(1.4), "opening_8": door_at(1.6)}
    sides["opening_8"] = Shape(sides["opening_8"].points[:400], 0.025)
    graph, _ = passages_of(None, sides)
    assert joined(graph) == {"opening_7": {"room_1", "room_2"}}


def test_a_leaf_that_stands_open_before_a_whole_wall_is_no_shut_door() -> None:
    beside = door_at(1.4).points + np.array([0.28, 0.0, 0.0], np.float32)
    graph, _ = passages_of(None, {"opening_7": Shape(beside, 0.025)})
    assert not joined(graph)


def test_what_was_not_seen_of_an_opening_does_not_part_it() -> None:
    graph, _ = passages_of((0.4, 2.6), hidden=(1.3, 1.6))
    assert joined(graph) == {"passage_1": {"room_1", "room_2"}}
    assert graph.node("passage_1").attributes["width_m"] == pytest.approx(2.2, abs=0.11)


@pytest.mark.parametrize("degrees", [0, 13, 30, 45, 60, 77])
def test_a_doorway_is_found_in_a_wall_that_lies_askew_in_the_grid(degrees: float) -> None:
    graph, _ = passages_of((1.0, 1.9), yaw=np.radians(degrees))
    assert joined(graph) == {"passage_1": {"room_1", "room_2"}}
    assert graph.node("passage_1").attributes["width_m"] == pytest.approx(0.9, abs=0.2)
    for edge in graph.edges("connects"):
        turn = np.array([[np.cos(np.radians(degrees)), -np.sin(np.radians(degrees))],
                         [np.sin(np.radians(degrees)), np.cos(np.radians(degrees))]])  # fmt: skip
        assert np.allclose(edge.attributes["at"], turn @ (WALL_X, 1.45), atol=0.15)


def test_a_passage_keeps_its_id_and_goes_when_it_is_walled_up() -> None:
    graph, again = passages_of((1.0, 1.9))
    again((1.1, 2.0))
    assert joined(graph) == {"passage_1": {"room_1", "room_2"}}
    again(None)
    assert not joined(graph)
    assert not graph.edges("adjacent")
    assert graph.tombstone("passage_1") is not None


def test_rooms_stay_adjacent_through_a_second_way_when_the_first_is_walled_up() -> None:
    graph, again = passages_of((0.4, 1.3), {"opening_8": door_at(2.5)})
    assert set(joined(graph)) == {"passage_1", "opening_8"}
    again(None)
    assert set(joined(graph)) == {"opening_8"}
    edge = graph.edge("adjacent", "room_1", "room_2")
    assert edge is not None
    assert edge.attributes["through"] == "opening_8"


def test_a_door_that_is_gone_leads_nowhere() -> None:
    passages, (storey, occupancy, graph) = Passages(), two_rooms(None)
    added = GraphChanges()
    added.put(
        Node(id="opening_7", layer="structure", label="door", position=(3, 1, 1), first_seen_ns=0, last_seen_ns=0)
    )
    graph.commit(added, 0)
    shapes, labels = {"opening_7": door_at(1.4)}, {"opening_7": "door"}
    graph.commit(passages.update([storey], passages.see(shapes, shapes, labels), {}, occupancy, graph, 1), 1)
    assert joined(graph) == {"opening_7": {"room_1", "room_2"}}, "a new door is looked at though no room moved"
    graph.commit(passages.update([storey], passages.see(shapes, {}, {}), {}, occupancy, graph, 2), 2)
    assert not joined(graph)
    assert not graph.edges("adjacent")


def test_stairs_lead_from_the_room_at_their_foot_to_that_at_their_head() -> None:
    storeys = []
    for number, floor_z in ((1, 0.0), (2, 2.7)):
        ground = GroundGrid(CELL_M)
        ground.cover(np.array([0, 0]), np.array([79, 29]))
        ground.room[:] = number
        storeys.append(Storey(number, floor_z, ground))
    steps = [
        np.stack(
            np.meshgrid(np.arange(1.0 + 0.25 * n, 1.3 + 0.25 * n, 0.025), np.arange(1.0, 1.9, 0.025), 0.18 * n), -1
        )
        for n in range(16)
    ]
    shape = Shape(np.concatenate([s.reshape(-1, 3) for s in steps]).astype(np.float32), 0.025)
    graph, changes = SceneGraph(), GraphChanges()
    times = {"first_seen_ns": 0, "last_seen_ns": 0}
    for n in (1, 2):
        changes.put(Node(id=f"room_{n}", layer="room", label="room", position=(4, 1, 2.7 * n - 2.7), **times))
    changes.put(Node(id="opening_3", layer="structure", label="stairs", position=(3, 1.5, 1.3), **times))
    graph.commit(changes, 0)
    passages, occupancy = Passages(), OccupancyMap(voxel_size_m=0.05)
    moved = passages.see(["opening_3"], {"opening_3": shape}, {"opening_3": "stairs"})
    graph.commit(passages.update(storeys, moved, {}, occupancy, graph, 1), 1)
    assert joined(graph) == {"opening_3": {"room_1", "room_2"}}
    assert graph.edge("adjacent", "room_1", "room_2").attributes["through"] == "opening_3"  # type: ignore[union-attr]
    half = Shape(shape.points[shape.points[:, 2] < 1.4], 0.025)
    moved = passages.see(["opening_3"], {"opening_3": half}, {"opening_3": "stairs"})
    graph.commit(passages.update(storeys, moved, {}, occupancy, graph, 2), 2)
    assert not joined(graph), "they end halfway"


def test_the_small_home_has_a_way_from_one_room_to_the_other(home: World) -> None:
    one, two = (room.id for room in home.graph.nodes("room"))
    assert home.graph.edge("adjacent", one, two) is not None
    assert home.ask(f"leads_to({one}, {two})").truth == "true"


def test_passages_are_known_again_after_a_restart(copy_home: Callable[[], World]) -> None:
    world = copy_home()
    known = world.perception.passages._known
    assert set(known) == {e.source for e in world.graph.edges("connects")}
