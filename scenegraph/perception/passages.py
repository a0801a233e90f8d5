"""Doors and openings between rooms: where free space leads from one room into another, and doors that are shut."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.perception.shapes import Shape
from scenegraph.perception.storeys import CELL_M, Storey

Array: TypeAlias = NDArray[Any]

LEAST_WIDTH_M = 0.5
DOORWAY_M = 1.3
"""A passage up to this wide is a doorway, a wider one an opening."""
LEAF_M = 0.9
"""A door leaf belongs to the passage whose middle is this near the middle of the leaf, ajar or not."""
THROUGH_M = 0.3
"""A passage is open where a straight way, free so far to both sides of the border, leads from room to room …"""
HEIGHTS_M = (1.0, 1.4, 1.8)
"""… at these heights over the floor …"""
DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 8), np.sin(np.arange(8) * np.pi / 8)], axis=1)
"""… in one of these directions: homes lie askew in the grid."""
SIDES_M = (0.2, 0.35)
"""How far from the middle of a shut door its rooms are looked for: a leaf that stands open before a wall has only one
room beside it."""
SAME_M = 0.5
"""A passage between the same rooms whose middle moved less than this is the same passage."""


@dataclass(frozen=True)
class Passage:
    """A way between two rooms: `by` is the node of the door or of the passage itself."""

    by: str
    rooms: tuple[str, str]
    at: tuple[float, float]
    width_m: float
    is_open: bool


class Passages:
    """Keeps `connects` and `adjacent` edges, and nodes of passages without a door, in step with the rooms."""

    def __init__(self) -> None:
        self._known: dict[str, Passage] = {}
        self._next = 1

    def update(
        self,
        storeys: Iterable[Storey],
        moved: set[str],
        doors: Mapping[str, Shape],
        occupancy: OccupancyMap,
        graph: SceneGraph,
        stamp_ns: int,
    ) -> GraphChanges:
        """Find the passages of the rooms `moved` anew. doors: the shapes of things that are doors, by node id."""
        changes = GraphChanges()
        if not moved:
            return changes
        found: list[Passage] = []
        for storey in storeys:
            openings = _openings(storey, moved, occupancy)
            found += self._with_doors(openings, doors)
            taken = {p.by for p in found}
            found += _shut({d: s for d, s in doors.items() if d not in taken}, storey, moved)
        before = {by: p for by, p in self._known.items() if moved.intersection(p.rooms)}
        now = {p.by: p for p in found}
        for by in sorted(before.keys() - now.keys()):
            self._forget(before[by], changes, graph)
        for passage in found:
            if before.get(passage.by) != passage:
                if passage.by in before:
                    _cut(before[passage.by], changes)
                self._known[passage.by] = passage
                _write(passage, storeys, graph, stamp_ns, changes)
        return changes

    def restore(self, graph: SceneGraph) -> None:
        """Know again the passages of a graph that comes back from disk."""
        for edge in graph.edges("connects"):
            rooms = sorted({e.target for e in graph.edges("connects", source=edge.source)})
            if len(rooms) == 2:
                x, y = edge.attributes.get("at", graph.node(edge.source).position[:2].tolist())
                width, is_open = float(edge.value or 0.0), bool(edge.attributes.get("open", True))
                self._known[edge.source] = Passage(edge.source, (rooms[0], rooms[1]), (x, y), width, is_open)
        numbers = [int(by.removeprefix("passage_")) for by in self._known if by.startswith("passage_")]
        self._next = max(numbers, default=0) + 1

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
            named.append(Passage(by, opening.rooms, opening.at, opening.width_m, True))
        return named

    def _same(self, opening: Passage, used: set[str]) -> str:
        for by, known in self._known.items():
            free = by.startswith("passage_") and by not in used
            if free and known.rooms == opening.rooms and np.hypot(*np.subtract(known.at, opening.at)) < SAME_M:
                return by
        return ""

    def _forget(self, passage: Passage, changes: GraphChanges, graph: SceneGraph) -> None:
        del self._known[passage.by]
        _cut(passage, changes)
        if passage.by.startswith("passage_") and passage.by in graph:
            changes.delete_node(passage.by, "nothing leads through there")


def _openings(storey: Storey, moved: set[str], occupancy: OccupancyMap) -> list[Passage]:
    """Where free space leads across the border between two rooms; they are not named yet."""
    numbers = np.array([int(room.removeprefix("room_")) for room in moved])
    rooms = storey.ground.room
    where = np.argwhere(np.isin(rooms, numbers))
    if not len(where):
        return []
    low, high = np.maximum(where.min(axis=0) - 4, 0), where.max(axis=0) + 5
    rooms = rooms[low[0] : high[0], low[1] : high[1]]
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
                found.append(Passage("", (f"room_{a}", f"room_{b}"), (x, y), round(width, 2), True))
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


def _shut(doors: Mapping[str, Shape], storey: Storey, moved: set[str]) -> list[Passage]:
    """Doors with a room on either side and nothing open between: they are shut."""
    found = []
    for door, shape in sorted(doors.items()):
        x, y, length, _, yaw = shape.rectangle
        across = np.array([-np.sin(yaw), np.cos(yaw)])
        pairs = {
            tuple(sorted(storey.ground.at(np.array([x, y]) + side * np.stack([across, -across])).tolist()))
            for side in SIDES_M
        }
        rooms = sorted(f"room_{n}" for n in next(iter(pairs)) if n)
        if len(pairs) == 1 and len(set(rooms)) == 2 and moved.intersection(rooms):
            found.append(Passage(door, (rooms[0], rooms[1]), (round(x, 3), round(y, 3)), round(length, 2), False))
    return found


def _cut(passage: Passage, changes: GraphChanges) -> None:
    one, two = passage.rooms
    for relation, source, target in (
        ("connects", passage.by, one), ("connects", passage.by, two), ("adjacent", one, two), ("adjacent", two, one),
    ):  # fmt: skip
        changes.delete_edge(relation, source, target)


def _write(
    passage: Passage, storeys: Iterable[Storey], graph: SceneGraph, stamp_ns: int, changes: GraphChanges
) -> None:
    if passage.by.startswith("passage_"):
        known = graph.node(passage.by) if passage.by in graph else None
        floor = min((s.floor_z for s in storeys), default=0.0)
        changes.put(
            Node(
                id=passage.by,
                layer="structure",
                label="doorway" if passage.width_m <= DOORWAY_M else "opening",
                position=(*passage.at, floor + 1.0),
                confidence=0.9,
                first_seen_ns=stamp_ns if known is None else min(known.first_seen_ns, stamp_ns),
                last_seen_ns=stamp_ns if known is None else max(known.last_seen_ns, stamp_ns),
                attributes={"width_m": passage.width_m},
            )
        )
    one, two = passage.rooms
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
    for a, b in ((one, two), (two, one)):
        changes.put(Edge(relation="adjacent", source=a, target=b, attributes={"through": passage.by}, **times))
