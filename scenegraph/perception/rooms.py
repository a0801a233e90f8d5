"""Rooms: the parts of a storey's ground that walls and narrow passages set apart.

Free space at standing height is gathered in a ground grid; walls are drawn as closed lines, openings included, and
what fills all of standing height away from them, nobody having called it a wall, parts the ground too. What is left
falls apart when the walls are dilated: components appear at the widest places, as the radius shrinks, and one lives on
as a room when it meets the next at a neck clearly narrower than either (persistence of connected components under
dilation, as in Hughes et al., *Hydra*, RSS 2022, but by the ratio of the radii, so that no size of homes is assumed; on
necks after Bormann et al., *Room Segmentation: Survey, Implementation, and Analysis*, 2016).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mapping.kernels import rasters
from mapping.kernels import regions as kernels
from mapping.layer import Changed
from mapping.occupancy import OccupancyMap
from mapping.planes import Plane
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph
from scenegraph.perception.storeys import CELL_M, DEFAULT_HEIGHT_M, Storey, Storeys

Array: TypeAlias = NDArray[Any]

HIDDEN_M = 0.7
"""Ground that tall furniture hides belongs to the room before it, up to this depth."""
NECK_SHARE = 0.72
"""A passage narrower than this share of the rooms it joins parts them: doors do, and wide openings between wall
stubs."""
LEAST_ROOM_M2 = 1.2
LEAST_SEEN_SHARE = 0.3
"""Of the ground of a room at least this share was seen, the rest is taken to be hidden: a few beams that went through
a window make no room."""
UNNOTICED_CELLS = 10
"""A room that won and lost no more cells than this stays as it was written."""
SAME_SHARE = 0.3
"""A region is a known room when they share this much of the larger one's ground."""
OUTDOORS_SHARE = 0.5
"""A room is outdoors when the sky was seen over this share of it, no ceiling, and …"""
TALL_BESIDE_M = 0.3
LEAST_TALL_M = 1.0
"""… no wall as high as that beside it for so long: a hall has such walls, and its ceiling may be out of sight."""


class Rooms:
    """Keeps room nodes in step with walls, floors and free space; only the ground around a change is looked at.

    Ground that an operator gave a room (`GroundGrid.drawn`) stays with it. What is seen later of the ground beside it
    falls to that room too, unless the operator drew its outline (`outlined`).
    """

    def __init__(self) -> None:
        self.storeys = Storeys()
        self.footprints: dict[str, shapely.Polygon] = {}
        self.outlined: set[int] = set()
        self._shifted: dict[int, int] = {}
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
        fresh = [s for label, plane in planes if label == "floor" and (s := self.storeys.found(plane)) is not None]
        dirty: dict[int, list[Array]] = {}
        for storey in self.storeys:
            blocks = occupancy.block_ijk if storey in fresh else seen.blocks
            dirty[storey.number] = storey.open_ground(occupancy, blocks)
            dirty[storey.number] += storey.move_walls(planes) + storey.opened
            storey.opened = []
        hung = self.storeys.hang_ceilings(planes)
        for storey in self.storeys:
            if dirty[storey.number]:
                corners = np.concatenate(dirty[storey.number])
                self._partition(storey, corners.min(axis=0), corners.max(axis=0), graph, stamp_ns, changes, changed)
        for storey, covered in hung:
            self._raise_ceilings(storey, covered, graph, stamp_ns, changes, changed)
        return changes, changed

    def forget_planes(self, plane_ids: Iterable[int]) -> None:
        """Planes that are no more."""
        for plane_id in plane_ids:
            for storey in self.storeys:
                storey.forget(plane_id)

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
        reached = _numbers(np.where(storey.ground.drawn[window], 0, storey.ground.room[window]))
        for room in reached:
            bounds = np.round(np.reshape(self.footprints[f"room_{room}"].bounds, (2, 2)) / CELL_M).astype(np.int64)
            low, high = np.minimum(low, bounds[0] - margin), np.maximum(high, bounds[1] + margin)
        window = storey.ground.cover(low, high)
        before = storey.ground.room[window].copy()
        other = ((before > 0) & ~np.isin(before, reached)) | storey.ground.drawn[window]
        barrier = self._barrier(storey, low, before.shape)
        solid = storey.solid(window)
        closed = barrier | other
        free = storey.ground.free[window] & ~closed
        reach = _widened(free, closed | _apart(solid, barrier), solid | closed)
        clearance = ndimage.distance_transform_edt(np.pad(reach, 1))[1:-1, 1:-1]
        labels = kernels.basins(clearance, NECK_SHARE)
        cells = np.bincount(labels.ravel())
        seen = np.bincount(labels.ravel(), weights=storey.ground.free[window].ravel())
        guessed = (seen < LEAST_SEEN_SHARE * cells)[labels] & (labels > 0)
        reach &= ~guessed
        labels[guessed | (cells * CELL_M**2 < LEAST_ROOM_M2)[labels]] = 0
        reach = _widened(reach, closed, solid | closed)
        kernels.flood(labels, reach)
        told = np.where(storey.ground.drawn[window], before, 0)
        before[other] = 0
        gained = self._give_to_told(labels, told, before, reach, clearance)
        after = self._identify(labels, before, reached, changes, changed)
        owned = _into_walls(after, barrier)
        storey.ground.room[window] = np.where(other, storey.ground.room[window], owned)
        moved = owned != before
        shifts = np.bincount(owned[moved], minlength=self._next) + np.bincount(before[moved], minlength=self._next)
        for room in _numbers(after):
            self._shifted[room] = self._shifted.get(room, 0) + int(shifts[room])
            if self._shifted[room] > (UNNOTICED_CELLS if f"room_{room}" in graph else 0):
                self.write(room, storey, np.argwhere(after == room) + low, graph, stamp_ns, changes)
                changed.add(f"room_{room}")
        for room in _numbers(gained):
            cells = np.concatenate([self.floor_of(room, storey), np.argwhere(gained == room) + low])
            self.write(room, storey, np.unique(cells, axis=0), graph, stamp_ns, changes)
            changed.add(f"room_{room}")
        storey.ground.room[window][gained > 0] = gained[gained > 0]
        storey.ground.drawn[window] |= gained > 0

    def _give_to_told(self, labels: Array, told: Array, before: Array, reach: Array, clearance: Array) -> Array:
        """Take from `labels` what belongs to the rooms that an operator made; returns these rooms' numbers there.

        labels, told, before : (W, H) regions found now, rooms told, rooms as they were. A told room gets what is left
        over at its border, and whole regions that were in no room yet and open widely onto it.
        """
        told = np.where(np.isin(told, list(self.outlined)), 0, told)
        gained = np.zeros_like(labels)
        if not told.any():
            return gained
        around = np.pad(told, 1)
        beside = np.max([around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]], axis=0)
        onto = reach & (beside > 0) & (labels > 0)
        for region in np.unique(labels[onto]).tolist():
            mine = labels == region
            if before[mine].any():
                continue
            rooms, widths = np.unique(beside[mine & onto], return_counts=True)
            if widths.max() >= NECK_SHARE * 2.0 * clearance[mine].max():
                gained[mine] = rooms[widths.argmax()]
                labels[mine] = 0
        left = told + gained
        kernels.flood(left, reach & (labels == 0))
        return np.where(told > 0, 0, left)

    def floor_of(self, number: int, storey: Storey) -> Array:
        """The cells (N, 2) of a room that lie in its footprint, in row order: without those of its walls."""
        outline = self.footprints[f"room_{number}"]
        low, high = np.round(np.reshape(outline.bounds, (2, 2)) / CELL_M).astype(np.int64) + np.array([[-1], [1]])
        cells = np.argwhere(storey.ground.room[storey.ground.cover(low, high)] == number) + low
        x, y = (cells.T + 0.5) * CELL_M
        inside: Array = cells[shapely.contains_xy(outline.buffer(-0.2 * CELL_M), x, y)]
        return inside

    def new_number(self) -> int:
        """A number that no room ever had."""
        self._next += 1
        return self._next - 1

    def _raise_ceilings(
        self,
        storey: Storey,
        covered: shapely.Geometry,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        written: set[str],
    ) -> None:
        """Write the rooms below a ceiling that changed, unless they were written already."""
        corners = np.round(np.reshape(covered.bounds, (2, 2)) / CELL_M).astype(np.int64)
        low = np.maximum(corners[0], storey.ground.low)
        high = np.minimum(corners[1], storey.ground.low + storey.ground.room.shape - 1)
        if (low > high).any():
            return
        for number in _numbers(storey.ground.room[storey.ground.cover(low, high)]):
            room = f"room_{number}"
            if room not in written and room in graph and room in self.footprints:
                self.write(number, storey, self.floor_of(number, storey), graph, stamp_ns, changes)

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """The arrays that make all storeys."""
        outlined = np.array(sorted(self.outlined), np.int64)
        return {"next": np.array(self._next), "outlined": outlined, **self.storeys.state()}

    def restore(self, state: Mapping[str, Array], graph: SceneGraph) -> None:
        """Take over what `state` gave; footprints are those of the graph's nodes."""
        self._next = int(state["next"])
        self.outlined = set(state.get("outlined", np.empty(0, np.int64)).tolist())
        self.storeys.restore(state, graph)
        self.footprints = {n.id: shapely.Polygon(n.attributes["footprint"]) for n in graph.nodes("room")}

    def shares(self, xy: Array, z: float) -> dict[str, float]:
        """The share of points (N, 2) [m] at height z [m] that lies in each room."""
        storey = self.storeys.at(z)
        if storey is None or not len(xy):
            return {}
        counts = np.bincount(storey.ground.at(xy))
        rooms = counts.nonzero()[0].tolist()
        return {f"room_{r}": int(counts[r]) / len(xy) for r in rooms if r}

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
        place = np.zeros(max(int(before.max()), *reached, 0) + 1, np.int64)
        place[reached] = np.arange(1, len(reached) + 1)
        width = len(reached) + 1
        joint = np.bincount((labels.astype(np.int64) * width + place[before]).ravel(), minlength=width)
        joint = np.pad(joint, (0, -len(joint) % width)).reshape(-1, width)
        size = {int(region): int(joint[region].sum()) for region in np.flatnonzero(joint[1:].any(axis=1)) + 1}
        old_size = joint.sum(axis=0)
        common = [
            (joint[region, k] / max(n, old_size[k]), region, room)
            for region, n in size.items()
            for k, room in enumerate(reached, start=1)
            if joint[region, k]
        ]
        room_of: dict[int, int] = {}
        for share, region, room in sorted(common, key=lambda c: (-c[0], c[1], c[2])):
            if share >= SAME_SHARE and region not in room_of and room not in room_of.values():
                room_of[region] = room
        for region in size:
            if region not in room_of:
                room_of[region] = self.new_number()
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

    def write(
        self,
        number: int,
        storey: Storey,
        cells: Array,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        name: str | None = None,
    ) -> None:
        """Write the node of a room with these cells (N, 2), in row order."""
        room = f"room_{number}"
        self._shifted.pop(number, None)
        footprint = _outline(cells)
        self.footprints[room] = footprint
        known = graph.node(room) if room in graph else None
        x0, y0, x1, y1 = footprint.bounds
        at = footprint.representative_point() if not footprint.contains(footprint.centroid) else footprint.centroid
        ceiling = storey.ceiling_over(footprint)
        height = DEFAULT_HEIGHT_M if ceiling is None else ceiling - storey.floor_z
        measures = {} if ceiling is None else {"ceiling_z": round(ceiling, 3), "height_m": round(height, 3)}
        outdoors = ceiling is None and _under_the_sky(cells, storey)
        told_before = known is not None and "outdoors" in known.attributes
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
                    "footprint": np.round(shapely.get_coordinates(footprint.exterior)[:-1], 3),
                    "storey": storey.number,
                    "floor_z": round(storey.floor_z, 3),
                    "area_m2": round(footprint.area, 2),
                    **measures,
                    **({"outdoors": outdoors} if outdoors or told_before else {}),
                },
            )
        )


def _widened(reach: Array, barrier: Array, solid: Array) -> Array:
    """Ground (W, H) with what furniture hides of it, so far as hidden ground goes: what lies between the ground and
    something solid, or between solid things. Enters no barrier."""
    deep = round(HIDDEN_M / CELL_M)
    everywhere = np.zeros_like(reach)
    closed = reach | solid
    kernels.grow(closed, everywhere, (deep + 1) // 2)
    outside = ~closed
    kernels.grow(outside, everywhere, (deep + 1) // 2)
    widened = reach.copy()
    kernels.grow(widened, barrier | outside, deep)
    kernels.fill_holes(widened)
    return widened & ~barrier


def _apart(solid: Array, barrier: Array) -> Array:
    """Of what is solid (W, H), what no known wall is near: what is near may be furniture before it."""
    near = barrier.copy()
    kernels.grow(near, np.zeros_like(near), round(HIDDEN_M / CELL_M))
    return solid & ~near


def _under_the_sky(cells: Array, storey: Storey) -> bool:
    """Whether ground, cells (N, 2), lies free under the sky, with no wall beside it that is as high as a hall's."""
    i, j = (cells - storey.ground.low).T
    if float(storey.ground.sky[i, j].mean()) < OUTDOORS_SHARE:
        return False
    reach = round(TALL_BESIDE_M / CELL_M)
    low, high = cells.min(axis=0) - reach, cells.max(axis=0) + reach
    tall = storey.ground.tall[storey.ground.cover(low, high)]
    mine = np.zeros(tall.shape, np.bool_)
    mine[tuple((cells - low).T)] = True
    beside = ndimage.binary_dilation(mine, np.ones((3, 3)), iterations=reach)
    return bool(np.count_nonzero(tall & beside) * CELL_M < LEAST_TALL_M)


def _into_walls(rooms: Array, barrier: Array) -> Array:
    """Rooms (W, H) with the wall cells at their border added, two deep: what hangs on a wall is in the room."""
    owned = rooms.copy()
    for _ in range(2):
        beside = np.pad(owned, 1)
        nearest = np.max([beside[:-2, 1:-1], beside[2:, 1:-1], beside[1:-1, :-2], beside[1:-1, 2:]], axis=0)
        owned = np.where((owned == 0) & barrier, nearest, owned)
    return owned


def _outline(cells: Array) -> shapely.Polygon:
    """The outer border [m] of the largest part of cells (N, 2), simplified by half a cell."""
    low = cells.min(axis=0) - 1
    mask = np.zeros(cells.max(axis=0) - low + 2, bool)
    mask[tuple((cells - low).T)] = True
    corners, ends = np.empty((4 * len(cells), 2), np.int32), np.empty(len(cells), np.int64)
    rings = np.split(corners, ends[: rasters.trace(mask, corners, ends)])[:-1]
    largest = shapely.Polygon((max(rings, key=_twice_area) + low) * CELL_M)
    whole = largest.buffer(0.5 * CELL_M, join_style="mitre")
    outline: shapely.Polygon = whole.simplify(0.5 * CELL_M)
    return outline


def _twice_area(ring: Array) -> float:
    """Of a ring of corners (N, 2), positive when it runs counter-clockwise."""
    x, y = ring.astype(np.float64).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _numbers(values: Array) -> list[int]:
    """The numbers > 0 among values ≥ 0, ascending."""
    return [int(n) for n in np.flatnonzero(np.bincount(values.ravel())) if n]
