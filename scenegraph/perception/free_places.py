"""Places: where a robot can stand, spread over the free ground of each storey by their distance to what stands on it.

A place has the most clearance around it, as the vertices of a generalised Voronoi diagram have (Thrun, *Learning
Metric-Topological Maps for Indoor Mobile Robot Navigation*, 1998; Hughes et al., *Hydra*, 2022, take the diagram
itself); others keep a distance that grows with that clearance. Two places are joined where the ground nearest to one
meets that of the other.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

from mapping.kernels import free_ground as kernels
from mapping.occupancy import OccupancyMap
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.perception.ground import Grid
from scenegraph.perception.rooms import Rooms
from scenegraph.perception.storeys import Storey

Array: TypeAlias = NDArray[Any]

WIDEST_CELL_M = 0.125
FLOOR_BAND_M = (-0.15, 0.1)
"""Heights about that of the floor at which material is the floor, and nothing to bump into."""
BODY_M = 1.2
"""What stands lower than this over the floor is in the way of a robot."""
LEAST_CLEARANCE_M = 0.2
"""Ground nearer than this to what stands there is no way for any robot, and …"""
LEAST_PLACE_M = 0.25
"""… nearer than this no place."""
MOST_CLEARANCE_M = 1.5
"""Clearance beyond this is not told apart: only so far does a change reach."""
SPACING_M = 0.6
"""Places are never nearer to each other than this: at most 3.5 of them are on a square metre."""
SPACING_SHARE = 1.0
"""Nor nearer than this share of the clearance of the one that has more."""
STAY_BONUS = 1.15
"""The ground where a place is counts so much more than it has clearance: places stay where they are."""
SAME_M = 0.75
"""A place that moved less than this is the same place."""
NOTICED_M = 0.1
"""A place is written anew when it moved, or its clearance or the width of a way changed, by more than this."""
FLOOR_SHARE = 0.5
"""A place can be driven on when this share of the floor about it was seen."""
LEAST_NEW_CELLS = 20
PATCH_CELLS = 32
"""Cells that changed are looked at together when the patches of this side that they lie in hang together."""
ENCLOSED_SHARE = 0.7
"""A cell that was not seen is free when more than this share of it and its eight neighbours is."""


class StandingGround(Grid):
    """space : int8 (unknown, free or blocked at a robot's height), floor : bool (was seen), seat : int32 (the number
    of the place at this cell, 0 = none)."""

    channels: ClassVar[dict[str, type]] = {"space": np.int8, "floor": np.bool_, "seat": np.int32}
    space: NDArray[np.int8]
    floor: NDArray[np.bool_]
    seat: NDArray[np.int32]


@dataclass(frozen=True)
class FreePlace:
    """A place: its cell on a storey, how far it is to the next thing there [m], and whether the floor was seen."""

    storey: int
    cell: tuple[int, int]
    clearance_m: float
    floor_share: float


@dataclass
class _Level:
    """The ground of one storey, and where it changed since places were last looked for."""

    ground: StandingGround
    changed: dict[tuple[int, int], list[Array]] = field(default_factory=lambda: defaultdict(list))

    def note(self, cells: Array) -> None:
        """Cells (N, 2) that changed; they are kept by the patch of ground that they lie in."""
        patches = cells // PATCH_CELLS
        for patch in {(i, j) for i, j in patches.tolist()}:
            self.changed[patch].append(cells[(patches == patch).all(axis=1)])

    def take_changed(self) -> list[Array]:
        """Cells (N, 2) of patches beside each other, one array for all that hang together; what is too little to look
        at waits."""
        taken = []
        waiting, self.changed = self.changed, defaultdict(list)
        while waiting:
            together = [next(iter(waiting))]
            for i, j in together:
                beside = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
                together += [patch for patch in beside if patch in waiting and patch not in together]
            parts = {patch: waiting.pop(patch) for patch in together}
            cells = np.concatenate([cells for part in parts.values() for cells in part])
            if len(cells) >= LEAST_NEW_CELLS:
                taken.append(cells)
            else:
                self.changed.update(parts)
        return taken


@dataclass
class FreePlaces:
    """Keeps place nodes and the ways between them in step with the free ground; looks only about what changed.

    robot_radius_m : of the robot that a place must hold to be called traversable
    """

    robot_radius_m: float
    places: dict[int, FreePlace] = field(default_factory=dict)
    ways: dict[int, dict[int, float]] = field(default_factory=dict)
    room_of: dict[int, str] = field(default_factory=dict)
    _levels: dict[int, _Level] = field(default_factory=dict)
    _next: int = 1

    def update(
        self,
        occupancy: OccupancyMap,
        blocks: Array,
        rooms: Rooms,
        moved_rooms: Iterable[str],
        graph: SceneGraph,
        stamp_ns: int,
    ) -> GraphChanges:
        """Changes of the graph. blocks : occupancy blocks (N, 3) that changed; moved_rooms : whose ground changed."""
        changes = GraphChanges()
        stale: set[int] = set()
        for storey in rooms.storeys:
            level = self._survey(storey, occupancy, blocks)
            for changed in level.take_changed():
                stale |= self._renew(storey, level.ground, changed, graph, stamp_ns, changes)
        stale |= self._in_rooms(rooms, moved_rooms)
        self._put_in_rooms(sorted(stale), rooms, graph, stamp_ns, changes)
        return changes

    def restore(self, occupancy: OccupancyMap, rooms: Rooms, graph: SceneGraph) -> None:
        """Know again the places of a graph that comes back from disk; the ground is surveyed anew."""
        for storey in rooms.storeys:
            self._survey(storey, occupancy, np.empty((0, 3), np.int64)).changed.clear()
        for node in graph.nodes("place"):
            number, where = int(node.id.removeprefix("place_")), int(node.attributes["storey"])
            ground = self._levels[where].ground
            i, j = np.floor(node.position[:2] / ground.cell_m).astype(np.int64).tolist()
            share = float(node.attributes["floor_seen"])
            self.places[number] = FreePlace(where, (i, j), float(node.attributes["clearance_m"]), share)
            ground.seat[ground.cover(np.array([i, j]), np.array([i, j]))] = number
            for edge in graph.edges("connected_to", source=node.id):
                self.ways.setdefault(number, {})[int(edge.target.removeprefix("place_"))] = float(edge.value or 0.0)
            for edge in graph.edges("in", source=node.id):
                self.room_of[number] = edge.target
        numbers = [*self.places, *(int(t.id[6:]) for t in graph.tombstones() if t.id.startswith("place_"))]
        self._next = max(numbers, default=0) + 1

    # -- the ground ---------------------------------------------------------------------------------------
    def _survey(self, storey: Storey, occupancy: OccupancyMap, blocks: Array) -> _Level:
        """Note what the columns over changed blocks say of the ground; of a new storey all columns are looked at."""
        wide = max(k for k in (1, 2, 4, 8) if k == 1 or k * occupancy.voxel_size_m <= WIDEST_CELL_M)
        level = self._levels.get(storey.number)
        if level is None:
            level = self._levels[storey.number] = _Level(StandingGround(wide * occupancy.voxel_size_m))
            blocks = occupancy.block_ijk
        edge = occupancy.block_size_m
        low, high = storey.floor_z + FLOOR_BAND_M[0], storey.floor_z + BODY_M
        layers = np.arange(np.floor(low / edge), np.floor(high / edge) + 1).astype(np.int64)
        near = blocks[(blocks[:, 2] >= layers[0]) & (blocks[:, 2] <= layers[-1]), :2].astype(np.int64)
        if not len(near):
            return level
        keys = np.unique((near[:, 0] << 32) + near[:, 1] + (1 << 31))
        columns = np.stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)], axis=1)
        heights = (layers[:, None] * 8 + np.arange(8) + 0.5) * occupancy.voxel_size_m - storey.floor_z
        bands = np.full(heights.shape, kernels.IGNORED, np.int8)
        bands[(heights > FLOOR_BAND_M[0]) & (heights <= FLOOR_BAND_M[1])] = kernels.FLOOR
        bands[(heights > FLOOR_BAND_M[1]) & (heights < BODY_M)] = kernels.BODY
        stacks = np.empty((len(columns), len(layers), 3), np.int64)
        stacks[..., :2], stacks[..., 2] = columns[:, None], layers
        evidence = occupancy.evidence_of(stacks.reshape(-1, 3)).reshape(len(columns), len(layers), 8, 8, 8)
        space, floor = kernels.survey(evidence, bands, wide)
        n = 8 // wide
        cells = (columns[:, None] * n + np.indices((n, n)).reshape(2, n * n).T).reshape(-1, 2)
        level.ground.cover(cells.min(axis=0), cells.max(axis=0))
        at = tuple((cells - level.ground.low).T)
        fresh = level.ground.space[at] != space.ravel()
        level.ground.space[at] = space.ravel()
        level.ground.floor[at] |= floor.ravel()
        if fresh.any():
            level.note(cells[fresh])
        return level

    # -- places -------------------------------------------------------------------------------------------
    def _renew(
        self,
        storey: Storey,
        ground: StandingGround,
        changed: Array,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
    ) -> set[int]:
        """Choose places anew about what changed; returns the numbers of those that are new or moved."""
        reach = int(np.ceil(MOST_CLEARANCE_M / ground.cell_m))
        low = changed.min(axis=0) - 2 * reach
        window = ground.cover(low, changed.max(axis=0) + 2 * reach)
        space, seat = ground.space[window], ground.seat[window]
        free = space == kernels.FREE
        enclosed = ndimage.uniform_filter(free.astype(np.float32), 3) > ENCLOSED_SHARE
        free |= enclosed & (space == kernels.UNKNOWN)
        to_edge = ndimage.distance_transform_edt(free) - 0.5  # of the nearest cell that is not free
        clearance = np.clip(to_edge, 0.0, MOST_CLEARANCE_M / ground.cell_m)
        least = LEAST_PLACE_M / ground.cell_m
        inner = np.zeros(free.shape, bool)
        inner[reach:-reach, reach:-reach] = True
        standing = np.argwhere(seat > 0)
        stays = ~inner[standing[:, 0], standing[:, 1]]
        worth = np.where(inner & (clearance >= least), clearance, 0.0)
        old_cells = standing[~stays]
        worth[old_cells[:, 0], old_cells[:, 1]] *= STAY_BONUS
        kept = np.column_stack([standing[stays], clearance[tuple(standing[stays].T)]]).astype(np.float64)
        chosen = kernels.choose_places(clearance, worth, kept, SPACING_M / ground.cell_m, SPACING_SHARE)
        old = seat[old_cells[:, 0], old_cells[:, 1]]
        numbers = self._same(old, old_cells * ground.cell_m, chosen * ground.cell_m)
        seat[old_cells[:, 0], old_cells[:, 1]] = 0
        seat[chosen[:, 0], chosen[:, 1]] = numbers
        for number in sorted(set(old.tolist()) - set(numbers.tolist())):
            self._forget(number, graph, changes)
        seen = ndimage.uniform_filter(ground.floor[window].astype(np.float32), 2 * round(0.3 / ground.cell_m) + 1)
        moved = set()
        for number, (i, j) in zip(numbers.tolist(), chosen.tolist(), strict=True):
            metres = round(float(clearance[i, j]) * ground.cell_m, 2)
            cell = (int(low[0]) + i, int(low[1]) + j)
            place = FreePlace(storey.number, cell, metres, round(float(seen[i, j]), 2))
            if self._write(number, place, storey, ground.cell_m, graph, stamp_ns, changes):
                moved.add(number)
        self._join(numbers, chosen, seat, standing[stays], clearance, ground.cell_m, stamp_ns, changes)
        return moved

    def _same(self, old: Array, was: Array, now: Array) -> Array:
        """Numbers (N,) for places at `now` (N, 2) [m]: those of old places (M,) at `was` (M, 2) near them, or new."""
        numbers = np.zeros(len(now), np.int32)
        if len(old) and len(now):
            apart = np.linalg.norm(was[:, None] - now[None], axis=2)
            rows, columns = linear_sum_assignment(np.minimum(apart, 2.0 * SAME_M))
            for r, c in zip(rows, columns, strict=True):
                if apart[r, c] < SAME_M:
                    numbers[c] = old[r]
        for c in np.flatnonzero(numbers == 0):
            numbers[c], self._next = self._next, self._next + 1
        return numbers

    def _write(
        self,
        number: int,
        place: FreePlace,
        storey: Storey,
        cell_m: float,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
    ) -> bool:
        """Put the node of a place where it changed enough; whether it did."""
        known = self.places.get(number)
        if known is not None:
            shift = float(np.hypot(*np.subtract(known.cell, place.cell))) * cell_m
            grown = abs(known.clearance_m - place.clearance_m)
            if shift < NOTICED_M - 1e-9 and grown < NOTICED_M and self._drivable(known) == self._drivable(place):
                self.places[number] = replace(known, cell=place.cell)
                return False
        self.places[number] = place
        name = f"place_{number}"
        before = graph.node(name) if name in graph else None
        x, y = ((c + 0.5) * cell_m for c in place.cell)
        drivable = self._drivable(place)
        changes.put(
            Node(
                id=name,
                layer="place",
                label="place",
                position=(x, y, storey.floor_z),
                confidence=0.9,
                first_seen_ns=stamp_ns if before is None else before.first_seen_ns,
                last_seen_ns=stamp_ns if before is None else max(stamp_ns, before.last_seen_ns),
                attributes={
                    "clearance_m": place.clearance_m,
                    "storey": storey.number,
                    "floor_seen": place.floor_share,
                    **({} if drivable is None else {"traversable": drivable}),
                },
            )
        )
        return True

    def _drivable(self, place: FreePlace) -> bool | None:
        """Whether a robot can stand there; None where too little of the floor was seen to tell."""
        if place.clearance_m < self.robot_radius_m:
            return False
        return True if place.floor_share >= FLOOR_SHARE else None

    def _forget(self, number: int, graph: SceneGraph, changes: GraphChanges) -> None:
        self.places.pop(number, None)
        self.room_of.pop(number, None)
        for other in self.ways.pop(number, {}):
            self.ways[other].pop(number, None)
        if f"place_{number}" in graph:
            changes.delete_node(f"place_{number}", "other places are about there now")

    def _join(
        self,
        numbers: Array,
        chosen: Array,
        seat: Array,
        kept: Array,
        clearance: Array,
        cell_m: float,
        stamp_ns: int,
        changes: GraphChanges,
    ) -> None:
        """Find the ways between the places chosen, and from them to those about them, anew."""
        cells = np.concatenate([chosen, kept])
        ids = np.concatenate([numbers, seat[kept[:, 0], kept[:, 1]]]).tolist()
        pairs, narrow = kernels.join_places(clearance, cells, LEAST_CLEARANCE_M / cell_m)
        found: dict[tuple[int, int], float] = {}
        for (a, b), n in zip(pairs.tolist(), narrow.tolist(), strict=True):
            if a < len(chosen):
                found[min(ids[a], ids[b]), max(ids[a], ids[b])] = round(2.0 * n * cell_m, 2)
        mine = set(numbers.tolist())
        known = {(min(a, b), max(a, b)): w for a in mine for b, w in self.ways.get(a, {}).items()}
        for a, b in known.keys() - found.keys():
            del self.ways[a][b], self.ways[b][a]
            changes.delete_edge("connected_to", f"place_{a}", f"place_{b}")
            changes.delete_edge("connected_to", f"place_{b}", f"place_{a}")
        for (a, b), width in sorted(found.items()):
            if abs(known.get((a, b), -1.0) - width) < NOTICED_M:
                continue
            for one, two in ((a, b), (b, a)):
                self.ways.setdefault(one, {})[two] = width
                changes.put(
                    Edge(
                        relation="connected_to", source=f"place_{one}", target=f"place_{two}", value=width,
                        threshold=2.0 * LEAST_CLEARANCE_M, first_seen_ns=stamp_ns, last_seen_ns=stamp_ns,
                        attributes={"width_m": width, "traversable": width >= 2.0 * self.robot_radius_m},
                    )
                )  # fmt: skip

    # -- rooms --------------------------------------------------------------------------------------------
    def _in_rooms(self, rooms: Rooms, moved: Iterable[str]) -> set[int]:
        """The places that are, or were, in rooms whose ground changed."""
        moved = set(moved)
        found: set[int] = set()
        for room in moved & rooms.footprints.keys():
            x0, y0, x1, y1 = rooms.footprints[room].bounds
            for level in self._levels.values():
                ground = level.ground
                size = np.array(ground.seat.shape)
                low = np.clip(np.floor(np.array([x0, y0]) / ground.cell_m).astype(int) - ground.low, 0, size)
                high = np.clip(np.ceil(np.array([x1, y1]) / ground.cell_m).astype(int) - ground.low, 0, size)
                found.update(np.unique(ground.seat[low[0] : high[0], low[1] : high[1]]).tolist())
        gone = moved - rooms.footprints.keys()
        if gone:
            found |= {number for number, room in self.room_of.items() if room in gone}
        return found - {0}

    def _put_in_rooms(
        self, numbers: list[int], rooms: Rooms, graph: SceneGraph, stamp_ns: int, changes: GraphChanges
    ) -> None:
        for number in numbers:
            place = self.places.get(number)
            if place is None:
                continue
            cell_m = self._levels[place.storey].ground.cell_m
            xy = (np.array([place.cell]) + 0.5) * cell_m
            its = int(rooms.storeys[place.storey - 1].ground.at(xy)[0])
            room, known = f"room_{its}" if its else None, self.room_of.get(number)
            name = f"place_{number}"
            if known is not None and known != room:
                del self.room_of[number]
                for relation, source, target in (("in", name, known), ("contains", known, name)):
                    changes.delete_edge(relation, source, target)
            if room is not None and known != room:
                self.room_of[number] = room
                times = {"first_seen_ns": stamp_ns, "last_seen_ns": stamp_ns}
                for relation, source, target in (("in", name, room), ("contains", room, name)):
                    changes.put(Edge(relation=relation, source=source, target=target, **times))
