"""Places: spread over the free ground, joined where it leads, in their rooms, and kept when seen again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from mapping.kernels import free_ground as kernels
from mapping.layer import Changed
from mapping.occupancy import OccupancyMap
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.free_places import (
    LEAST_PLACE_M,
    MOST_CLEARANCE_M,
    SPACING_M,
    FreePlaces,
)
from scenegraph.perception.rooms import Rooms
from scenegraph.world import World
from tests.scenegraph.test_rooms import UPSTAIRS, floor, wall
from tests.support import small_home
from tests.support.small_home import room_at, stamp

# -- kernels -----------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), wide=st.sampled_from([1, 2, 4]))
@settings(max_examples=30, deadline=None)
def test_columns_say_what_is_free_and_what_is_solid(seed: int, wide: int) -> None:
    random = np.random.default_rng(seed)
    blocks = np.unique(random.integers(-1, 2, (9, 3)), axis=0)
    evidence = random.choice(np.array([-128, -5, 5], np.int8), (len(blocks), 8, 8, 8), p=[0.9, 0.07, 0.03])
    heights = random.random((len(blocks), 8)) < 0.6
    low, shape = np.array([-16, -16]), (40, 40)
    free, solid = random.random(shape) < 0.1, random.integers(0, 4, shape).astype(np.uint16)
    free_then, solid_then = free.copy(), solid.copy()
    for clearing in (True, False):
        for block, values, counts in zip(blocks, evidence, heights, strict=True):
            for u, v in np.ndindex(8, 8):
                i, j = (8 * block[:2] + (u, v)) // wide - low
                bit = np.uint16(1 << block[2] % 16)
                if clearing:
                    solid_then[i, j] &= ~bit
                else:
                    column = values[u, v][counts]
                    solid_then[i, j] |= bit if (column >= 0).any() else 0
                    free_then[i, j] |= ((column < 0) & (column > -128)).any()
    new = np.argwhere(free_then & ~free) + low
    n, bounds = kernels.note_columns(free, solid, evidence, blocks, heights, float(wide), low)
    assert (free == free_then).all()
    assert (solid == solid_then).all()
    assert n == len(new)
    if n:
        assert (bounds == [new.min(axis=0), new.max(axis=0)]).all()


grounds = st.integers(0, 2**32 - 1).map(
    lambda seed: ndimage.binary_opening(np.random.default_rng(seed).random((24, 20)) < 0.9, np.ones((3, 3)))
)


@given(free=grounds, share=st.sampled_from([0.5, 1.0]))
@settings(max_examples=40, deadline=None)
def test_places_keep_their_distance_and_leave_no_ground_out(free: np.ndarray, share: float) -> None:
    clearance = ndimage.distance_transform_edt(free)
    places = kernels.choose_places(clearance, clearance, np.empty((0, 3)), 3.0, share)
    radius = np.maximum(3.0, share * clearance[tuple(places.T)])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert np.all(np.diff(clearance[tuple(places.T)]) <= 1e-9), "the widest first"
    for later in range(len(places)):
        assert np.all(apart[:later, later] >= radius[:later] - 1e-9)
    ground = np.argwhere(free)
    if len(ground):
        reach = np.linalg.norm(ground[:, None] - places[None], axis=2)
        assert (reach <= radius + 1e-9).any(axis=1).all()


@given(free=grounds)
@settings(max_examples=40, deadline=None)
def test_places_are_joined_exactly_where_free_ground_joins_them(free: np.ndarray) -> None:
    clearance = ndimage.distance_transform_edt(free)
    places = kernels.choose_places(clearance, clearance, np.empty((0, 3)), 3.0, 1.0)
    pairs, narrow = kernels.join_places(clearance, places, 1.0)
    parts, _ = ndimage.label(free)
    group = list(range(len(places)))
    for (a, b), width in zip(pairs.tolist(), narrow.tolist(), strict=True):
        assert a < b
        assert 1.0 <= width <= min(clearance[tuple(places[a])], clearance[tuple(places[b])])
        group = [group[a] if g == group[b] else g for g in group]
    for a in range(len(places)):
        for b in range(a):
            assert (group[a] == group[b]) == (parts[tuple(places[a])] == parts[tuple(places[b])])


@pytest.mark.parametrize("wide", [1, 2, 4, 8])
def test_a_survey_agrees_with_its_naive_twin(wide: int) -> None:
    rng = np.random.default_rng(wide)
    evidence = rng.choice(
        np.array([-128, -20, -20, -20, 20], np.int8), (5, 3, 8, 8, 8), p=[0.25, 0.25, 0.2, 0.29, 0.01]
    )
    levels = rng.integers(0, 3, (3, 8)).astype(np.int8)
    space, seen = kernels.survey(evidence, levels, wide)
    columns = evidence.transpose(0, 2, 3, 1, 4).reshape(5, 8 // wide, wide, 8 // wide, wide, 24)
    columns = columns.transpose(0, 1, 3, 2, 4, 5).reshape(5, 8 // wide, 8 // wide, -1, 24)
    body, under = columns[..., levels.ravel() == kernels.BODY], columns[..., levels.ravel() == kernels.FLOOR]
    free = ((body < 0) & (body > -128)).mean(axis=(3, 4)) >= 0.5
    blocked = (body > 0).any(axis=(3, 4))
    assert np.array_equal(space, np.where(blocked, kernels.BLOCKED, np.where(free, kernels.FREE, kernels.UNKNOWN)))
    assert np.array_equal(seen, (under > 0).any(axis=(3, 4)))


# -- places in a home --------------------------------------------------------------------------------------------------


class Ground:
    """Places that watch ground being explored."""

    def __init__(self) -> None:
        self.occupancy = OccupancyMap(voxel_size_m=0.05, max_range_m=10.0)
        self.rooms, self.places, self.graph = Rooms(), FreePlaces(0.25), SceneGraph()
        founded = GraphChanges()
        times = {"first_seen_ns": 0, "last_seen_ns": 0}
        founded.put(Node(id="building_1", layer="building", label="building", position=(0, 0, 0), **times))
        self.graph.commit(founded, 0)
        self.now = 0

    def see(self, *boxes: tuple[float, ...], value: int = -20, structure: tuple = (), under: bool = True) -> set[str]:
        """Boxes x0, y0, x1, y1, z0, z1 of free (or, with a value > 0, occupied) space; returns the nodes written."""
        self.now += 1
        seen = [np.empty((0, 3), np.int32)]
        for x0, y0, x1, y1, z0, z1 in boxes:
            for low, high, evidence in ((z0, z1, value), (z0 - 0.05, z0, 20)):
                if evidence > 0 and value < 0 and not under:
                    continue
                axes = (np.arange(a + 0.025, b, 0.05) for a, b in ((x0, x1), (y0, y1), (low, high)))
                centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
                self.occupancy.assign(centres, evidence)
                seen.append(np.unique(np.floor(centres / 0.4).astype(np.int32), axis=0))
        blocks = np.unique(np.concatenate(seen), axis=0)
        changed = Changed(blocks, self.occupancy.block_size_m)
        changes, moved = self.rooms.update(self.occupancy, changed, structure, self.graph, self.now)
        self.rooms.storeys.write(changes, "building_1", self.graph, self.now)
        changes.extend(self.places.update(self.occupancy, blocks, self.rooms, moved, self.graph, self.now))
        delta = self.graph.commit(changes, self.now)
        return {node.id for node in delta.nodes.put if node.layer == "place"}

    @property
    def nodes(self) -> list[Node]:
        return self.graph.nodes("place")

    def check(self) -> None:
        """What must hold of all places and ways."""
        at = np.array([n.position for n in self.nodes])
        apart = np.linalg.norm(at[:, None] - at[None], axis=2) + 1e3 * np.eye(len(at))
        assert apart.min() >= SPACING_M - 0.11
        for node in self.nodes:
            clearance = node.attributes["clearance_m"]
            assert LEAST_PLACE_M <= clearance <= MOST_CLEARANCE_M
            assert len(self.graph.edges("in", source=node.id)) <= 1
        for edge in self.graph.edges("connected_to"):
            back = self.graph.edge("connected_to", edge.target, edge.source)
            assert back is not None
            assert (back.value, back.attributes) == (edge.value, edge.attributes)
        assert {n.id for n in self.nodes} == {f"place_{number}" for number in self.places.places}

    def reached_from(self, place: str) -> set[str]:
        seen, todo = {place}, [place]
        while todo:
            for edge in self.graph.edges("connected_to", source=todo.pop()):
                if edge.target not in seen:
                    seen.add(edge.target)
                    todo.append(edge.target)
        return seen


WALLS = (floor(1, 0, 0, 8, 4), wall(6, 4, 0, 4, 4))
LEFT, RIGHT, DOOR = (0.1, 0.1, 3.9, 3.9, 0.0, 2.1), (4.1, 0.1, 7.9, 3.9, 0.0, 2.1), (3.9, 1.5, 4.1, 2.4, 0.0, 2.1)


def two_rooms(*more: tuple[float, ...]) -> Ground:
    ground = Ground()
    ground.see(LEFT, RIGHT, *more, structure=WALLS)
    ground.check()
    return ground


def test_places_lie_in_their_rooms_and_ways_lead_through_the_door() -> None:
    ground = two_rooms(DOOR)
    rooms = {e.target for e in ground.graph.edges("in") if e.source.startswith("place")}
    assert rooms == {n.id for n in ground.graph.nodes("room")}
    assert all(ground.graph.edge("contains", e.target, e.source) for e in ground.graph.edges("in"))
    assert ground.reached_from(ground.nodes[0].id) == {n.id for n in ground.nodes}
    middle = max(ground.nodes, key=lambda n: n.attributes["clearance_m"])  # type: ignore[arg-type, return-value]
    assert middle.attributes["clearance_m"] == MOST_CLEARANCE_M


def test_no_way_leads_through_a_wall() -> None:
    ground = two_rooms()
    assert len(ground.reached_from(ground.nodes[0].id)) < len(ground.nodes)


def test_a_way_is_as_wide_as_the_door() -> None:
    ground = two_rooms(DOOR)
    sides = {n.id: n.position[0] < 4.0 for n in ground.nodes}
    through = [e for e in ground.graph.edges("connected_to") if sides[e.source] != sides[e.target]]
    assert max(e.value for e in through) == pytest.approx(0.9, abs=0.21)  # type: ignore[type-var]


def test_seeing_the_same_again_changes_nothing_and_ids_last_when_things_move_a_little() -> None:
    ground = two_rooms(DOOR)
    before = {n.id for n in ground.nodes}
    assert ground.see(LEFT, RIGHT, DOOR) == set()
    ground.see((1.0, 1.0, 1.4, 1.4, 0.0, 0.8), value=20)
    ground.check()
    after = {n.id: n for n in ground.nodes}
    right = {n for n in before if n in after and after[n].position[0] > 5.5}
    assert right, "far from the change all stays"
    assert len(before & after.keys()) >= 0.7 * len(before)
    for node in after.values():
        assert not (0.8 < node.position[0] < 1.6 and 0.8 < node.position[1] < 1.6), "nobody stands in a box"


def test_bit_by_bit_gives_as_many_places_as_at_once() -> None:
    whole, bits = two_rooms(DOOR), Ground()
    bits.see((0.1, 0.1, 1.0, 3.9, 0.0, 2.1), structure=WALLS)
    for x in np.arange(1.0, 7.8, 0.4):
        bits.see(*((max(x, x0), y0, min(x + 0.4, x1), y1, 0.0, 2.1) for x0, y0, x1, y1, _, _ in (LEFT, RIGHT, DOOR)
                   if min(x + 0.4, x1) > max(x, x0)))  # fmt: skip
        bits.check()
    assert len(bits.nodes) == pytest.approx(len(whole.nodes), abs=4)
    assert bits.reached_from(bits.nodes[0].id) == {n.id for n in bits.nodes}


def test_a_change_is_looked_at_where_it_is() -> None:
    ground = two_rooms(DOOR)
    ground.see((20.0, 0.1, 24.0, 3.9, 0.0, 2.1))
    before = {n.id for n in ground.nodes if n.position[0] > 15}
    written = ground.see((1.0, 1.0, 1.6, 1.6, 0.0, 0.8), value=20)
    assert before
    assert not written & before


def test_changes_far_apart_are_looked_at_apart() -> None:
    """A few cells that changed here do not make the ground from here to there be looked at."""
    ground = two_rooms(DOOR)
    ground.see((200.0, 0.1, 204.0, 3.9, 0.0, 2.1))
    sizes = []
    distance = ndimage.distance_transform_edt

    def measured(free: np.ndarray) -> np.ndarray:
        sizes.append(free.size)
        return distance(free)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ndimage, "distance_transform_edt", measured)
        blocks = []
        for x in (1.0, 1.1, 202.0):
            centres = np.array([[x + 0.025, 1.025, z] for z in np.arange(0.2, 0.8, 0.05)])
            ground.occupancy.assign(centres, 20)
            blocks.append(np.unique(np.floor(centres / 0.4).astype(np.int32), axis=0))
        ground.places.update(ground.occupancy, np.concatenate(blocks[:2]), ground.rooms, (), ground.graph, 9)
        assert not sizes, "two cells are no news"
        ground.see((202.0, 1.0, 202.6, 1.6, 0.0, 0.8), value=20)
    assert sizes
    assert max(sizes) < 150**2


def test_a_place_over_ground_that_was_not_seen_says_nothing_of_traversability() -> None:
    seen, unseen = two_rooms(DOOR), Ground()
    unseen.see(LEFT, RIGHT, DOOR, structure=WALLS, under=False)
    assert any(n.attributes.get("traversable") is True for n in seen.nodes)
    assert unseen.nodes
    assert all("traversable" not in n.attributes for n in unseen.nodes)


def test_each_storey_has_its_places() -> None:
    ground = two_rooms(DOOR)
    ground.see((0.1, 0.1, 3.9, 3.9, 2.7, 4.8), structure=tuple(UPSTAIRS))
    ground.check()
    heights = {(n.attributes["storey"], float(n.position[2])) for n in ground.nodes}
    assert heights == {(1, 0.0), (2, 2.7)}
    for edge in ground.graph.edges("connected_to"):
        a, b = (ground.graph.node(end).attributes["storey"] for end in (edge.source, edge.target))
        assert a == b


# -- the whole world ---------------------------------------------------------------------------------------------------


def test_the_small_home_has_places_in_both_rooms_and_ways_through_its_door(home: World) -> None:
    kitchen, bedroom = room_at(home, small_home.KITCHEN), room_at(home, small_home.BEDROOM)
    rooms = [e.target for e in home.graph.edges("in") if e.source.startswith("place_")]
    assert {kitchen, bedroom} == set(rooms)
    free = sum(n.attributes["area_m2"] for n in home.graph.nodes("room"))  # type: ignore[misc]
    assert len(home.graph.nodes("place")) <= 3.5 * free
    joined = {
        frozenset(home.perception.free_places.room_of[int(end.removeprefix("place_"))] for end in (e.source, e.target))
        for e in home.graph.edges("connected_to")
    }
    assert frozenset({kitchen, bedroom}) in joined


def test_what_is_in_a_room_names_no_places_but_places_can_be_asked_for(home: World) -> None:
    kitchen = room_at(home, small_home.KITCHEN)
    assert not [row["X"].id for row in home.ask("in(X, kitchen)", limit=1000) if row["X"].id.startswith("place_")]
    mine = {n.id for n in home.graph.nodes("place") if home.graph.edge("in", n.id, kitchen)}
    assert {row["X"].id for row in home.ask("place(X), in(X, kitchen)", limit=1000)} == mine
    wide = {n.id for n in home.graph.nodes("place") if n.attributes["clearance_m"] > 0.6}  # type: ignore[operator]
    asked = home.ask("place(X), attribute(X, clearance_m, C), C > 0.6", limit=1000)
    assert {row["X"].id for row in asked} == wide


def test_places_come_back_from_disk_and_mapping_goes_on(copy_home: Callable[[], World], tmp_path: Path) -> None:
    world = copy_home()
    known = world.perception.free_places
    ids = {n.id for n in world.graph.nodes("place")}
    assert {f"place_{n}" for n in known.places} == ids
    assert sum(map(len, known.ways.values())) == len(world.graph.edges("connected_to"))
    for n, image in enumerate(small_home.images()[::6]):
        world.integrate(image.model_copy(update={"stamp_ns": stamp(100 + n)}))
    later = {n.id for n in world.graph.nodes("place")}
    assert len(ids & later) >= 0.7 * len(ids)
    split = room_at(world, small_home.BEDROOM)
    world.tell(f"split({split}, [[4.0, 1.8], [5.0, 1.8]])", author="ann")
    for node in world.graph.nodes("place"):
        [edge] = world.graph.edges("in", source=node.id) or [None]
        if edge is not None:
            assert edge.target == room_at(world, (float(node.position[0]), float(node.position[1])))
