"""Rooms: the parts of a storey's ground that walls and narrow passages set apart.

Free space at standing height is gathered in a ground grid; walls are drawn as closed lines, openings included; what is
left falls into basins of the distance to the walls, and a basin stays a room of its own when the neck to the next is
clearly narrower than either (after Bormann et al., *Room Segmentation: Survey, Implementation, and Analysis*, 2016).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mapping.kernels import regions as kernels
from mapping.layer import Changed
from mapping.occupancy import OccupancyMap
from mapping.planes import Plane
from scenegraph.errors import InvalidStatement
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph
from scenegraph.perception.ground import GroundGrid

Array: TypeAlias = NDArray[Any]

CELL_M = 0.1
BAND_M = (1.0, 1.9)
"""Heights over the floor at which space counts: above tables and counters, below the lintels of doors."""
HIDDEN_M = 0.7
"""Ground that tall furniture hides belongs to the room before it, up to this depth."""
NECK_SHARE = 0.72
"""A passage narrower than this share of the rooms it joins parts them: doors do, and wide openings between wall
stubs."""
CORNER_M = 0.15
"""Walls are drawn this much longer at both ends, to meet in the corners."""
LEAST_ROOM_M2 = 1.2
LEAST_NEW_CELLS = 10
LEAST_WALL_M = 0.4
STOREY_M = 1.5
"""Floors that differ by less than this in height belong to one storey."""
SAME_SHARE = 0.3
"""A region is a known room when they share this much of the larger one's ground."""
FARTHEST_DRAWN_M = 50.0
"""An operator draws rooms no farther than this from what was mapped: the ground grid is dense."""


@dataclass
class Storey:
    """The ground of one storey: what is free at standing height and which room it belongs to, and its walls as
    lines; `opened` holds the bounds of walls that are no more, until the ground there is looked at again."""

    number: int
    floor_z: float
    ground: GroundGrid = field(default_factory=lambda: GroundGrid(CELL_M))
    walls: dict[int, tuple[float, float, float, float]] = field(default_factory=dict)
    opened: list[Array] = field(default_factory=list)


class Rooms:
    """Keeps room nodes in step with walls, floors and free space; only the ground around a change is looked at."""

    def __init__(self) -> None:
        self.storeys: list[Storey] = []
        self.footprints: dict[str, shapely.Polygon] = {}
        self._next = 1

    def update(
        self,
        occupancy: OccupancyMap,
        seen: Changed,
        structure: Iterable[tuple[str, Plane]],
        graph: SceneGraph,
        stamp_ns: int,
    ) -> tuple[GraphChanges, set[str]]:
        """Changes of the graph, and the ids of rooms whose ground changed.

        seen      : occupancy blocks that changed
        structure : (label, plane) of the labelled planes that changed
        """
        changes, changed = GraphChanges(), set[str]()
        planes = list(structure)
        fresh = [s for label, plane in planes if label == "floor" and (s := self._storey_of(plane)) is not None]
        dirty: dict[int, list[Array]] = {}
        for storey in self.storeys:
            blocks = occupancy.block_ijk if storey in fresh else seen.blocks
            dirty[storey.number] = self._open_ground(storey, occupancy, blocks)
            dirty[storey.number] += self._move_walls(storey, planes) + storey.opened
            storey.opened = []
        for storey in self.storeys:
            if dirty[storey.number]:
                corners = np.concatenate(dirty[storey.number])
                self._partition(storey, corners.min(axis=0), corners.max(axis=0), graph, stamp_ns, changes, changed)
        return changes, changed

    # -- the ground ---------------------------------------------------------------------------------------
    def _storey_of(self, floor: Plane) -> Storey | None:
        """The storey that a floor founds; None when it belongs to one that is known."""
        z = float(floor.centroid[2])
        if floor.area_m2 < 1.0 or any(abs(z - s.floor_z) < STOREY_M for s in self.storeys):
            return None
        storey = Storey(len(self.storeys) + 1, z)
        self.storeys.append(storey)
        return storey

    @staticmethod
    def _open_ground(storey: Storey, occupancy: OccupancyMap, blocks: Array) -> list[Array]:
        """Note the cells that are free at standing height; returns their bounds, corners (2, 2) in cells, where new."""
        edge = occupancy.block_size_m
        low, high = storey.floor_z + BAND_M[0], storey.floor_z + BAND_M[1]
        blocks = blocks[(blocks[:, 2] * edge < high) & ((blocks[:, 2] + 1) * edge > low)]
        if not len(blocks):
            return []
        evidence = occupancy.evidence_of(blocks).reshape(-1, 8, 8, 8)
        heights = (blocks[:, 2, None] * 8 + np.arange(8) + 0.5) * occupancy.voxel_size_m
        in_band = (heights > low) & (heights < high)
        free = ((evidence < 0) & (evidence > -128) & in_band[:, None, None, :]).any(axis=3)
        which, u, v = np.nonzero(free)
        xy = (blocks[which, :2] * 8 + np.stack([u, v], axis=1) + 0.5) * occupancy.voxel_size_m
        cells = np.floor(xy / CELL_M).astype(np.int64)
        if not len(cells):
            return []
        low_cell, high_cell = cells.min(axis=0), cells.max(axis=0)
        where = storey.ground.cover(low_cell, high_cell)
        window = storey.ground.free[where]
        at = tuple((cells - low_cell).T)
        new = cells[~window[at]]
        window[at] = True
        return [np.stack([new.min(axis=0), new.max(axis=0)])] if len(new) >= LEAST_NEW_CELLS else []

    @staticmethod
    def _move_walls(storey: Storey, planes: list[tuple[str, Plane]]) -> list[Array]:
        """Draw walls anew; returns the bounds of those that changed."""
        dirty = []
        for label, plane in planes:
            known = storey.walls.get(plane.id)
            line = None
            if (
                label == "wall"
                and plane.width_m >= LEAST_WALL_M
                and plane.z_max > storey.floor_z + BAND_M[0]
                and plane.z_min < storey.floor_z + BAND_M[1] + 0.5
            ):
                line = _ground_line(plane)
            if line is None:
                if known is not None:
                    del storey.walls[plane.id]
                    dirty.append(_line_bounds(known))
            elif known is None or np.abs(np.subtract(known, line)).max() > CELL_M:
                storey.walls[plane.id] = line
                dirty.append(_line_bounds(line))
        return dirty

    def forget_walls(self, plane_ids: Iterable[int]) -> None:
        """Planes that are no more."""
        for storey in self.storeys:
            for plane_id in plane_ids:
                line = storey.walls.pop(plane_id, None)
                if line is not None:
                    storey.opened.append(_line_bounds(line))

    # -- rooms --------------------------------------------------------------------------------------------
    def _partition(
        self,
        storey: Storey,
        low: Array,
        high: Array,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        changed: set[str],
    ) -> None:
        """Find the rooms anew in the part of the ground that holds the change and every room it reaches."""
        margin = round(HIDDEN_M / CELL_M) + 3
        low, high = low - margin, high + margin
        window = storey.ground.cover(low, high)
        reached = np.unique(storey.ground.room[window][~storey.ground.drawn[window]])
        reached = reached[reached > 0]
        for room in reached.tolist():
            bounds = np.round(np.reshape(self.footprints[f"room_{room}"].bounds, (2, 2)) / CELL_M).astype(np.int64)
            low, high = np.minimum(low, bounds[0] - margin), np.maximum(high, bounds[1] + margin)
        window = storey.ground.cover(low, high)
        before = storey.ground.room[window].copy()
        other = ((before > 0) & ~np.isin(before, reached)) | storey.ground.drawn[window]
        barrier = self._barrier(storey, low, before.shape)
        closed = barrier | other
        reach = storey.ground.free[window] & ~closed
        kernels.grow(reach, closed, round(HIDDEN_M / CELL_M))
        reach = ndimage.binary_fill_holes(reach) & ~closed
        clearance = ndimage.distance_transform_edt(np.pad(reach, 1))[1:-1, 1:-1]
        labels = kernels.basins(clearance, NECK_SHARE)
        ids, areas = np.unique(labels[labels > 0], return_counts=True)
        labels[np.isin(labels, ids[areas * CELL_M**2 < LEAST_ROOM_M2])] = 0
        kernels.flood(labels, reach)
        before[other] = 0
        after = self._identify(labels, before, reached.tolist(), changes, changed)
        owned = _into_walls(after, barrier)
        storey.ground.room[window] = np.where(other, storey.ground.room[window], owned)
        for room in np.unique(after[after > 0]).tolist():
            if ((owned == room) != (before == room)).any():
                self._write(room, storey, np.argwhere(after == room) + low, graph, stamp_ns, changes)
                changed.add(f"room_{room}")

    def draw(self, name: str, polygon: list[Any], graph: SceneGraph, stamp_ns: int) -> tuple[GraphChanges, set[str]]:
        """A room with this outline (corners x, y [m]), drawn by an operator: mapping leaves its ground alone from now
        on.

        Returns the changes and the ids of the rooms that it touches. Raises `InvalidStatement`.
        """
        try:
            corners = np.array(polygon, dtype=np.float64)
            if corners.shape[1:] != (2,) or not np.isfinite(corners).all():
                raise ValueError("expected finite corners [x, y]")
            outline = shapely.Polygon(corners)
        except (ValueError, TypeError) as error:
            raise InvalidStatement(
                f"room: the outline is no polygon ({error})", hint="room(name, [[x, y], [x, y], [x, y], …])"
            ) from None
        if not outline.is_valid or outline.area < 0.1:
            raise InvalidStatement("room: expected corners [x, y] of a simple polygon of at least 0.1 m²")
        if not self.storeys:
            raise InvalidStatement(
                "room: no floor has been mapped yet", hint="a room lies on a storey; map some floor first"
            )
        storey = self.storeys[0]
        ground_low, ground_high = storey.ground.low * CELL_M, (storey.ground.low + storey.ground.free.shape) * CELL_M
        if (corners < ground_low - FARTHEST_DRAWN_M).any() or (corners > ground_high + FARTHEST_DRAWN_M).any():
            raise InvalidStatement(f"room: a corner lies more than {FARTHEST_DRAWN_M:g} m from all that was mapped")
        changes, touched = GraphChanges(), set[str]()
        low, high = (
            np.floor(corners.min(axis=0) / CELL_M).astype(np.int64),
            np.floor(corners.max(axis=0) / CELL_M).astype(np.int64),
        )
        window = storey.ground.cover(low, high)
        cells = np.argwhere(np.ones(storey.ground.room[window].shape, bool))
        xy = (cells + low + 0.5) * CELL_M
        mine = shapely.contains_xy(outline, xy[:, 0], xy[:, 1]).reshape(storey.ground.room[window].shape)
        touched |= {f"room_{n}" for n in np.unique(storey.ground.room[window][mine]).tolist() if n}
        number, self._next = self._next, self._next + 1
        storey.ground.room[window][mine] = number
        storey.ground.drawn[window][mine] = True
        for room in sorted(touched):
            self._shrink(room, storey, graph, stamp_ns, changes)
        self._write(number, storey, np.argwhere(mine) + low, graph, stamp_ns, changes, name=name)
        return changes, touched | {f"room_{number}"}

    def _shrink(self, room: str, storey: Storey, graph: SceneGraph, stamp_ns: int, changes: GraphChanges) -> None:
        """Write a room anew that lost ground; one that lost nearly all is gone."""
        number = int(room.removeprefix("room_"))
        cells = np.argwhere(storey.ground.room == number)
        if len(cells) * CELL_M**2 < LEAST_ROOM_M2:
            storey.ground.room[storey.ground.room == number] = 0
            changes.delete_node(room, "an operator drew another room there", became=f"room_{self._next - 1}")
            self.footprints.pop(room, None)
        else:
            self._write(number, storey, cells + storey.ground.low, graph, stamp_ns, changes)

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """The arrays that make all storeys."""
        state: dict[str, Array] = {"next": np.array(self._next), "floors": np.array([s.floor_z for s in self.storeys])}
        for storey in self.storeys:
            prefix = f"storey.{storey.number}."
            state.update({prefix + name: array for name, array in storey.ground.state().items()})
            walls = [(i, *line) for i, line in storey.walls.items()]
            state[prefix + "walls"] = np.array(walls, np.float64).reshape(-1, 5)
        return state

    def restore(self, state: Mapping[str, Array], graph: SceneGraph) -> None:
        """Take over what `state` gave; footprints are those of the graph's nodes."""
        self._next = int(state["next"])
        for k, floor_z in enumerate(state["floors"].tolist()):
            storey, prefix = Storey(k + 1, floor_z), f"storey.{k + 1}."
            storey.ground.restore({key.removeprefix(prefix): a for key, a in state.items() if key.startswith(prefix)})
            storey.walls = {int(row[0]): (row[1], row[2], row[3], row[4]) for row in state[prefix + "walls"].tolist()}
            self.storeys.append(storey)
        self.footprints = {n.id: shapely.Polygon(n.attributes["footprint"]) for n in graph.nodes("room")}

    def shares(self, xy: Array, z: float) -> dict[str, float]:
        """The share of points (N, 2) [m] at height z [m] that lies in each room."""
        storey = self.storey_at(z)
        if storey is None or not len(xy):
            return {}
        rooms, counts = np.unique(storey.ground.at(xy), return_counts=True)
        return {f"room_{r}": n / len(xy) for r, n in zip(rooms.tolist(), counts.tolist(), strict=True) if r}

    def storey_at(self, z: float) -> Storey | None:
        """The highest storey whose floor is not above z (0.3 m is forgiven); None where there is none."""
        below = [s for s in self.storeys if s.floor_z <= z + 0.3]
        return max(below, key=lambda s: s.floor_z, default=None)

    @staticmethod
    def _barrier(storey: Storey, low: Array, shape: tuple[int, ...]) -> Array:
        barrier = np.zeros(shape, bool)
        for line in storey.walls.values():
            kernels.draw_segment(barrier, *(np.array(line) / CELL_M - np.tile(low, 2)))
        return barrier

    def _identify(
        self, labels: Array, before: Array, reached: list[int], changes: GraphChanges, changed: set[str]
    ) -> Array:
        """Give each region (W, H) the number of the known room with which it shares most ground, or a new one."""
        pairs, shared = np.unique(np.stack([labels, before], axis=2).reshape(-1, 2), axis=0, return_counts=True)
        size = dict(zip(*(a.tolist() for a in np.unique(labels, return_counts=True)), strict=True))
        old_size = dict(zip(*(a.tolist() for a in np.unique(before, return_counts=True)), strict=True))
        common = [
            (n / max(size[a], old_size[b]), a, b)
            for (a, b), n in zip(pairs.tolist(), shared.tolist(), strict=True)
            if a and b
        ]
        room_of: dict[int, int] = {}
        for share, region, room in sorted(common, key=lambda c: (-c[0], c[1], c[2])):
            if share >= SAME_SHARE and region not in room_of and room not in room_of.values():
                room_of[region] = room
        for region in size:
            if region and region not in room_of:
                room_of[region], self._next = self._next, self._next + 1
        for room in reached:
            if room not in room_of.values():
                heirs = [(share, region) for share, region, old in common if old == room]
                became = f"room_{room_of[max(heirs)[1]]}" if heirs else None
                changes.delete_node(f"room_{room}", "its ground belongs to another room", became=became)
                self.footprints.pop(f"room_{room}", None)
                changed.add(f"room_{room}")
        renumber = np.zeros(int(labels.max()) + 1, np.int32)
        for region, room in room_of.items():
            renumber[region] = room
        return renumber[labels]

    def _write(
        self,
        number: int,
        storey: Storey,
        cells: Array,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        name: str | None = None,
    ) -> None:
        room = f"room_{number}"
        footprint = _outline(cells)
        self.footprints[room] = footprint
        known = graph.node(room) if room in graph else None
        x0, y0, x1, y1 = footprint.bounds
        at = footprint.representative_point() if not footprint.contains(footprint.centroid) else footprint.centroid
        height = 2.4
        named = {} if name is None else {"name": name}
        kept = (
            named
            if known is None
            else {k: v for k, v in known.attributes.items() if k in ("name", "type", "type_reason")}
        )
        changes.put(
            Node(
                id=room,
                layer="room",
                label="room" if known is None else known.label,
                position=(at.x, at.y, storey.floor_z),
                box=Box(
                    center=(0.5 * (x0 + x1), 0.5 * (y0 + y1), storey.floor_z + 0.5 * height),
                    size=(x1 - x0, y1 - y0, height),
                ),
                confidence=0.9,
                first_seen_ns=stamp_ns if known is None else known.first_seen_ns,
                last_seen_ns=stamp_ns if known is None else max(stamp_ns, known.last_seen_ns),
                attributes={
                    **kept,
                    "footprint": [[round(x, 3), round(y, 3)] for x, y in footprint.exterior.coords[:-1]],
                    "storey": storey.number,
                    "floor_z": round(storey.floor_z, 3),
                    "area_m2": round(footprint.area, 2),
                },
            )
        )


def _into_walls(rooms: Array, barrier: Array) -> Array:
    """Rooms (W, H) with the wall cells at their border added, two deep: what hangs on a wall is in the room."""
    owned = rooms.copy()
    for _ in range(2):
        beside = np.pad(owned, 1)
        nearest = np.max([beside[:-2, 1:-1], beside[2:, 1:-1], beside[1:-1, :-2], beside[1:-1, 2:]], axis=0)
        owned = np.where((owned == 0) & barrier, nearest, owned)
    return owned


def _ground_line(plane: Plane) -> tuple[float, float, float, float]:
    """A wall seen from above: x0, y0, x1, y1 [m], a little longer than what was seen of it."""
    along = np.array([-plane.normal[1], plane.normal[0]])
    along /= np.linalg.norm(along)
    half = 0.5 * plane.width_m + CORNER_M
    a, b = plane.box_center[:2] - half * along, plane.box_center[:2] + half * along
    return float(a[0]), float(a[1]), float(b[0]), float(b[1])


def _line_bounds(line: tuple[float, float, float, float]) -> Array:
    ends = np.floor(np.array(line).reshape(2, 2) / CELL_M).astype(np.int64)
    return np.stack([ends.min(axis=0), ends.max(axis=0)])


def _outline(cells: Array) -> shapely.Polygon:
    """The outer border [m] of cells (N, 2) in row order, simplified by half a cell."""
    breaks = np.flatnonzero((np.diff(cells[:, 0]) != 0) | (np.diff(cells[:, 1]) != 1))
    first, last = cells[np.r_[0, breaks + 1]], cells[np.r_[breaks, len(cells) - 1]]
    runs = shapely.box(
        first[:, 0] * CELL_M, first[:, 1] * CELL_M, (first[:, 0] + 1) * CELL_M, (last[:, 1] + 1) * CELL_M
    )
    largest = max(shapely.get_parts(shapely.union_all(runs)), key=lambda part: part.area)
    whole = shapely.Polygon(largest.exterior).buffer(0.5 * CELL_M, join_style="mitre")
    outline: shapely.Polygon = whole.simplify(0.5 * CELL_M)
    return outline
