"""Ways between rooms: where free space leads from one room into another, doors that are shut, and stairs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.shapes import Shape
from scenegraph.perception.storeys import CELL_M, Storey

Array: TypeAlias = NDArray[Any]

LEAST_WIDTH_M = 0.5
DOORWAY_M = 1.3
"""A passage up to this wide is a doorway, a wider one an opening."""
LEAF_M = 0.9
"""A door leaf belongs to the passage whose middle is this near the middle of the leaf, ajar or not."""
LEAF_BEYOND_M = 0.3
"""A leaf that is longer than its opening is wide by more than this is not all one leaf."""
THROUGH_M = 0.3
"""A passage is open where a straight way, free so far to both sides of the border, leads from room to room …"""
HEIGHTS_M = (1.0, 1.4, 1.8)
"""… at these heights over the floor …"""
DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 8), np.sin(np.arange(8) * np.pi / 8)], axis=1)
"""… in one of these directions: homes lie askew in the grid."""
SIDES_M = (0.2, 0.35)
"""How far from the middle of a shut door its rooms are looked for: a leaf that stands open before a wall has only one
room beside it."""
DOOR_OFF_FLOOR_M = 1.0
"""A door whose lowest part that was seen is farther than this from a floor belongs to another storey."""
DOORS = ("door",)
STAIRS = ("stairs", "staircase", "stairway")
STEP_M = 0.5
"""Stairs lead to a floor that is no farther than this from their lowest or highest step …"""
TALLEST_RAIL_M = 1.5
"""… and a rail may stand so high above that."""
RING = np.stack([np.cos(np.arange(12) * np.pi / 6), np.sin(np.arange(12) * np.pi / 6)], axis=1)
SAME_M = 0.5
"""A passage between the same rooms whose middle moved less than this is the same passage."""


@dataclass(frozen=True)
class Passage:
    """A way between two rooms: `by` is the node of the door, the stairs, or the passage itself.

    floor_z : height of the floor at its lower end [m]
    """

    by: str
    rooms: tuple[str, str]
    at: tuple[float, float]
    width_m: float
    is_open: bool
    floor_z: float


class Passages:
    """Keeps `connects` and `adjacent` edges, and nodes of passages without a door, in step with the rooms.

    Rooms of two storeys are joined by stairs.
    """

    def __init__(self) -> None:
        self._known: dict[str, Passage] = {}
        self._of_room: defaultdict[str, set[str]] = defaultdict(set)
        self._shapes: dict[str, Shape] = {}
        self._index = GroundIndex()
        self._stairs: set[str] = set()
        self._dismissed: list[Passage] = []
        self._next = 1

    def see(self, things: Iterable[str], shapes: Mapping[str, Shape], labels: Mapping[str, str]) -> set[str]:
        """Note the doors and stairs among things that are new, changed or gone.

        Returns what `update` must look at: doors that are new, stairs, and the rooms that something gone joined.
        """
        moved: set[str] = set()
        for thing in things:
            label = labels.get(thing)
            if label in (*DOORS, *STAIRS) and thing in shapes:
                if label in STAIRS or thing not in self._shapes:
                    moved.add(thing)
                self._shapes[thing] = shapes[thing]
                self._index.put(thing, shapes[thing].bounds)
                (self._stairs.add if label in STAIRS else self._stairs.discard)(thing)
            elif self._shapes.pop(thing, None) is not None:
                self._index.remove(thing)
                self._stairs.discard(thing)
                moved.update(self._known[thing].rooms if thing in self._known else ())
        return moved

    def update(
        self,
        storeys: Sequence[Storey],
        moved: set[str],
        footprints: Mapping[str, shapely.Polygon],
        occupancy: OccupancyMap,
        graph: SceneGraph,
        stamp_ns: int,
    ) -> GraphChanges:
        """Find anew the passages of the rooms, doors and stairs in `moved`."""
        changes = GraphChanges()
        if not moved:
            return changes
        things = moved & self._shapes.keys()
        moved = moved | {room for thing in things for room in _rooms_about(self._shapes[thing], storeys)}
        outlines = [footprints[room].bounds for room in moved if room in footprints]
        outlines += [np.concatenate([corner[:2] for corner in self._shapes[thing].bounds]) for thing in things]
        found: list[Passage] = []
        if outlines:
            low, high = np.min(outlines, axis=0)[:2], np.max(outlines, axis=0)[2:]
            near = self._index.within((low, high), LEAF_M)
            for storey in storeys:
                found += self._on_storey(storey, moved, (low, high), near, occupancy)
            for stairs in (thing for thing in near if thing in self._stairs):
                found += _up_stairs(stairs, self._shapes[stairs], storeys)
        found = [passage for passage in found if not self._is_dismissed(passage)]
        before = {by: self._known[by] for room in moved for by in self._of_room.get(room, ())}
        before.update({by: self._known[by] for by in moved & self._known.keys()})
        now = {p.by: p for p in found}
        parted = set()
        for by in sorted(before.keys() - now.keys()):
            self._forget(before[by], changes, graph)
            parted.add(before[by].rooms)
        for passage in found:
            known = self._known.get(passage.by)
            if known != passage:
                if known is not None:
                    _cut(known, changes)
                    parted.add(known.rooms)
                self._keep(passage)
                _write(passage, graph, stamp_ns, changes)
        for rooms in sorted(parted):
            for by in sorted(self._of_room.get(rooms[0], ())):
                if self._known[by].rooms == rooms:
                    _adjoin(self._known[by], stamp_ns, changes)
        return changes

    def dismiss(self, by: str, graph: SceneGraph) -> GraphChanges:
        """Give up a passage without a door: that two rooms open onto each other there is no way any more."""
        changes = GraphChanges()
        passage = self._known.get(by)
        if passage is not None and by.startswith("passage_"):
            self._dismissed.append(passage)
            self._forget(passage, changes, graph)
        return changes

    def _is_dismissed(self, passage: Passage) -> bool:
        return passage.by.startswith("passage_") and any(
            passage.rooms == told.rooms and math.dist(passage.at, told.at) < SAME_M for told in self._dismissed
        )

    def document(self) -> list[list[Any]]:
        """The passages that were given up, as JSON values; `restore` knows the others by the graph."""
        return [[p.by, list(p.rooms), list(p.at), p.width_m, p.is_open, p.floor_z] for p in self._dismissed]

    def restore(
        self,
        document: Iterable[Sequence[Any]],
        graph: SceneGraph,
        shapes: Mapping[str, Shape],
        labels: Mapping[str, str],
    ) -> None:
        """Know again the passages of a graph that comes back from disk, and those that were given up."""
        self._dismissed = [Passage(by, (a, b), (x, y), *rest) for by, (a, b), (x, y), *rest in document]
        self.see(shapes, shapes, labels)
        for edge in graph.edges("connects"):
            rooms = sorted({e.target for e in graph.edges("connects", source=edge.source)})
            if len(rooms) == 2:
                x, y = edge.attributes.get("at", graph.node(edge.source).position[:2].tolist())
                width, is_open = float(edge.value or 0.0), bool(edge.attributes.get("open", True))
                floor = float(min(graph.node(room).position[2] for room in rooms))
                self._keep(Passage(edge.source, (rooms[0], rooms[1]), (x, y), width, is_open, floor))
        numbers = [int(by.removeprefix("passage_")) for by in self._known if by.startswith("passage_")]
        self._next = max(numbers, default=0) + 1

    def _on_storey(
        self, storey: Storey, moved: set[str], window: tuple[Array, Array], near: list[str], occupancy: OccupancyMap
    ) -> list[Passage]:
        """The passages of rooms of one storey. window: lowest and highest corner (2,) of what moved; near: doors."""
        doors = {
            thing: self._shapes[thing]
            for thing in near
            if thing not in self._stairs and abs(self._shapes[thing].lowest - storey.floor_z) < DOOR_OFF_FLOOR_M
        }
        named = self._with_doors(_openings(storey, moved, window, occupancy), doors)
        taken = {p.by for p in named}
        return named + _shut({d: s for d, s in doors.items() if d not in taken}, named, storey, moved)

    def _with_doors(self, openings: list[Passage], doors: Mapping[str, Shape]) -> list[Passage]:
        """The openings with the door, the known passage or a new id that each goes by."""
        named: list[Passage] = []
        used: set[str] = set()
        for opening in sorted(openings, key=lambda o: (o.rooms, o.at)):
            near = [
                (float(np.hypot(*np.subtract(shape.rectangle[:2], opening.at))), door)
                for door, shape in doors.items()
                if door not in used
            ]
            by = min((d for d in near if d[0] <= LEAF_M), default=(0.0, ""))[1] or self._same(opening, used)
            if not by:
                by, self._next = f"passage_{self._next}", self._next + 1
            used.add(by)
            wide = _leaf_wide(opening.width_m, doors[by]) if by in doors else opening.width_m
            named.append(replace(opening, by=by, width_m=wide))
        return named

    def _same(self, opening: Passage, used: set[str]) -> str:
        for by in sorted(self._of_room[opening.rooms[0]]):
            known = self._known[by]
            free = by.startswith("passage_") and by not in used
            if free and known.rooms == opening.rooms and np.hypot(*np.subtract(known.at, opening.at)) < SAME_M:
                return by
        return ""

    def _keep(self, passage: Passage) -> None:
        self._drop(passage.by)
        self._known[passage.by] = passage
        for room in passage.rooms:
            self._of_room[room].add(passage.by)

    def _drop(self, by: str) -> None:
        known = self._known.pop(by, None)
        for room in () if known is None else known.rooms:
            self._of_room[room].discard(by)
            if not self._of_room[room]:
                del self._of_room[room]

    def _forget(self, passage: Passage, changes: GraphChanges, graph: SceneGraph) -> None:
        self._drop(passage.by)
        _cut(passage, changes)
        if passage.by.startswith("passage_") and passage.by in graph:
            changes.delete_node(passage.by, "nothing leads through there")


def _leaf_wide(free_m: float, leaf: Shape) -> float:
    """How wide an opening with a leaf ajar is [m], of which so much was seen to be free: as wide as the leaf.

    Voxels of the jambs reach into the opening, up to two on either side. A leaf of which only a part was seen, or one
    of two, is narrower than what is free and says nothing.
    """
    length = leaf.rectangle[2]
    return round(max(free_m, length), 2) if length <= min(DOORWAY_M, free_m + LEAF_BEYOND_M) else free_m


def _openings(storey: Storey, moved: set[str], window: tuple[Array, Array], occupancy: OccupancyMap) -> list[Passage]:
    """Where free space leads across the border between two rooms; they are not named yet."""
    numbers = np.array([int(room.removeprefix("room_")) for room in moved if room.startswith("room_")])
    corners = np.floor(np.stack(window) / CELL_M).astype(np.int64) - storey.ground.low
    low = np.maximum(corners[0] - 4, 0)
    high = np.maximum(np.minimum(corners[1] + 5, storey.ground.room.shape), low)
    rooms = storey.ground.room[low[0] : high[0], low[1] : high[1]]
    if min(rooms.shape) <= 3 or not len(numbers):
        return []
    borders = [_borders(rooms, numbers, axis, apart) for axis in (0, 1) for apart in (1, 2, 3)]
    at, pair = (np.concatenate(parts) for parts in zip(*borders, strict=True))
    if not len(at):
        return []
    xy = (at + low + storey.ground.low + 0.5) * CELL_M
    space = _classify(xy, storey, occupancy).reshape(len(at), -1)
    is_shut = (space == OCCUPIED).any(axis=1)
    is_open = (space == FREE).all(axis=1)
    is_open[is_open] = _leads_through(xy[is_open], pair[is_open], storey, occupancy)
    cells = np.floor(at).astype(np.int64)
    found = []
    for a, b in np.unique(pair[is_open], axis=0).tolist():
        mine = (pair == (a, b)).all(axis=1)
        raster, seen = np.zeros(rooms.shape, bool), np.zeros(rooms.shape, bool)
        raster[tuple(cells[mine & ~is_shut].T)] = True  # gaps that were not seen do not part an opening in two
        seen[tuple(cells[mine & is_open].T)] = True
        parts, n = ndimage.label(raster, np.ones((3, 3)))
        for part in range(1, n + 1):
            if not (seen & (parts == part)).any():
                continue
            mine_xy = (np.argwhere(seen & (parts == part)) + low + storey.ground.low + 0.5) * CELL_M
            width = float(np.hypot(*np.ptp(mine_xy, axis=0))) + CELL_M
            if width >= LEAST_WIDTH_M:
                x, y = mine_xy.mean(axis=0).round(3).tolist()
                found.append(Passage("", (f"room_{a}", f"room_{b}"), (x, y), round(width, 2), True, storey.floor_z))
    return found


def _classify(xy: Array, storey: Storey, occupancy: OccupancyMap) -> Array:
    """What the space over points (N, 2) is, at each of HEIGHTS_M: (N, 3)."""
    points = np.concatenate([np.column_stack([xy, np.full(len(xy), storey.floor_z + z)]) for z in HEIGHTS_M])
    return occupancy.classify(points).reshape(len(HEIGHTS_M), len(xy)).T


def _leads_through(xy: Array, pair: Array, storey: Storey, occupancy: OccupancyMap) -> Array:
    """(N,) bool: whether a free straight way over points (N, 2) leads from one room of the pair (N, 2) to the other."""
    steps = np.linspace(-THROUGH_M, THROUGH_M, 13)
    through = np.zeros(len(xy), bool)
    for direction in DIRECTIONS:
        ends = [storey.ground.at(xy + reach * direction) for reach in (-THROUGH_M, THROUGH_M)]
        todo = np.flatnonzero(~through & (np.sort(np.stack(ends, axis=1), axis=1) == pair).all(axis=1))
        ways = xy[todo, None] + steps[:, None] * direction
        free = _classify(ways.reshape(-1, 2), storey, occupancy) == FREE
        through[todo] = free.reshape(len(todo), len(steps) * len(HEIGHTS_M)).all(axis=1)
    return through


def _borders(rooms: Array, numbers: Array, axis: int, apart: int) -> tuple[Array, Array]:
    """Where two rooms meet along an axis, `apart` cells from each other with no room between.

    Returns the middles (N, 2) in cells, and the room numbers (N, 2), the smaller first.
    """
    a = rooms if axis == 0 else rooms.T
    first, second = a[:-apart], a[apart:]
    meet = (first > 0) & (second > 0) & (first != second) & (np.isin(first, numbers) | np.isin(second, numbers))
    for step in range(1, apart):
        meet &= a[step : len(a) - apart + step] == 0
    i, j = np.nonzero(meet)
    at = np.stack([i + 0.5 * apart, j.astype(np.float64)], axis=1)
    pair = np.sort(np.stack([first[i, j], second[i, j]], axis=1), axis=1)
    return (at, pair) if axis == 0 else (at[:, ::-1], pair)


def _shut(doors: Mapping[str, Shape], opened: list[Passage], storey: Storey, moved: set[str]) -> list[Passage]:
    """Doors with a room on either side and nothing open between: they are shut.

    Of leaves in one place (its two sides may be seen as two things) the one that most was seen of is the door.
    """
    found: list[Passage] = []
    for door, shape in sorted(doors.items(), key=lambda d: (-len(d[1].points), d[0])):
        x, y, length, _, yaw = shape.rectangle
        across = np.array([-np.sin(yaw), np.cos(yaw)])
        pairs = {
            tuple(sorted(storey.ground.at(np.array([x, y]) + side * np.stack([across, -across])).tolist()))
            for side in SIDES_M
        }
        rooms = sorted(f"room_{n}" for n in next(iter(pairs)) if n)
        if len(pairs) == 1 and len(set(rooms)) == 2 and moved.intersection(rooms):
            at = (round(x, 3), round(y, 3))
            if any(p.rooms == (rooms[0], rooms[1]) and math.dist(p.at, at) < SAME_M for p in [*opened, *found]):
                continue
            found.append(Passage(door, (rooms[0], rooms[1]), at, round(length, 2), False, storey.floor_z))
    return found


def _up_stairs(stairs: str, shape: Shape, storeys: Sequence[Storey]) -> list[Passage]:
    """The way from the room at the foot of stairs to that at their head, one storey up."""
    by_height = sorted(storeys, key=lambda s: s.floor_z)
    for lower, upper in pairwise(by_height):
        reaches = shape.lowest < lower.floor_z + STEP_M and shape.highest > upper.floor_z - STEP_M
        if not reaches or shape.highest > upper.floor_z + TALLEST_RAIL_M:
            continue
        heights = shape.points[:, 2]
        foot = _room_at_end(shape.points[heights < lower.floor_z + STEP_M, :2], lower)
        head = _room_at_end(shape.points[np.abs(heights - upper.floor_z) < STEP_M, :2], upper)
        if foot and head:
            x, y, _, width, _ = shape.rectangle
            one, two = sorted((foot, head))
            return [Passage(stairs, (one, two), (round(x, 3), round(y, 3)), round(width, 2), True, lower.floor_z)]
    return []


def _rooms_about(shape: Shape, storeys: Sequence[Storey]) -> set[str]:
    """The rooms on whose ground a thing stands, or that lie beside it."""
    x, y, _, _, _ = shape.rectangle
    around = np.array([x, y]) + np.concatenate([[[0.0, 0.0]], 0.5 * RING, 1.0 * RING])
    return {f"room_{n}" for storey in storeys for n in storey.ground.at(around).tolist() if n}


def _room_at_end(xy: Array, storey: Storey) -> str | None:
    """The room that most of the ground about one end of stairs, points (N, 2), belongs to."""
    if not len(xy):
        return None
    around = xy.mean(axis=0) + np.concatenate([reach * RING for reach in (0.3, 0.6, 0.9)])
    rooms = storey.ground.at(np.concatenate([around, xy[:: max(1, len(xy) // 50)]]))
    counts = np.bincount(rooms[rooms > 0])
    return f"room_{counts.argmax()}" if len(counts) else None


def _cut(passage: Passage, changes: GraphChanges) -> None:
    one, two = passage.rooms
    for relation, source, target in (
        ("connects", passage.by, one), ("connects", passage.by, two), ("adjacent", one, two), ("adjacent", two, one),
    ):  # fmt: skip
        changes.delete_edge(relation, source, target)


def _write(passage: Passage, graph: SceneGraph, stamp_ns: int, changes: GraphChanges) -> None:
    if passage.by.startswith("passage_"):
        known = graph.node(passage.by) if passage.by in graph else None
        changes.put(
            Node(
                id=passage.by,
                layer="structure",
                label="doorway" if passage.width_m <= DOORWAY_M else "opening",
                position=(*passage.at, passage.floor_z + 1.0),
                confidence=0.9,
                first_seen_ns=stamp_ns if known is None else min(known.first_seen_ns, stamp_ns),
                last_seen_ns=stamp_ns if known is None else max(known.last_seen_ns, stamp_ns),
                attributes={"width_m": passage.width_m},
            )
        )
    times = {"first_seen_ns": stamp_ns, "last_seen_ns": stamp_ns}
    for room in passage.rooms:
        changes.put(
            Edge(
                relation="connects",
                source=passage.by,
                target=room,
                value=passage.width_m,
                threshold=LEAST_WIDTH_M,
                attributes={"open": passage.is_open, "width_m": passage.width_m, "at": list(passage.at)},
                **times,
            )
        )
    _adjoin(passage, stamp_ns, changes)


def _adjoin(passage: Passage, stamp_ns: int, changes: GraphChanges) -> None:
    one, two = passage.rooms
    times = {"first_seen_ns": stamp_ns, "last_seen_ns": stamp_ns}
    for a, b in ((one, two), (two, one)):
        changes.put(Edge(relation="adjacent", source=a, target=b, attributes={"through": passage.by}, **times))
