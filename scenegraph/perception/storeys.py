"""Storeys: floors one above the other, with what is known of the ground of each, and their nodes in the graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from mapping.kernels import free_ground
from mapping.occupancy import OccupancyMap
from mapping.planes import Plane
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph
from scenegraph.perception.ground import GroundGrid
from scenegraph.perception.neighbours import GroundIndex

Array: TypeAlias = NDArray[Any]
Line: TypeAlias = tuple[float, float, float, float]

CELL_M = 0.1
BAND_M = (1.0, 1.9)
"""Heights over the floor at which space counts: above tables and counters, below the lintels of doors."""
OPEN_SKY_M = (2.0, 2.5)
"""Space that is free so far above the ceilings of a storey may be under the sky."""
DEFAULT_HEIGHT_M = 2.4
"""Of rooms whose ceiling was not seen."""
TALLEST_STOREY_M = 3.2
"""Where no ceiling was seen, one may hang as high as this over the floor."""
CORNER_M = 0.15
"""Walls are drawn this much longer at both ends, to meet in the corners."""
LEAST_WALL_M = 0.4
LEAST_NEW_CELLS = 10
LEAST_LAYER_VOXELS = 3
"""A layer of blocks counts when so many of its voxels lie at standing height."""
STOREY_M = 1.9
"""Floors that differ by less than this in height belong to one storey: landings of stairs lie halfway."""
LEAST_FLOOR_M2 = 1.0
LEAST_HEIGHT_M = 1.5
"""A ceiling hangs at least so high over its floor."""
LEAST_CEILING_SHARE = 0.2
"""The ceiling of a room is known when this share of it was seen."""
NOTICED_M = 0.05
NOTICED_SHARE = 0.8
"""A ceiling whose height changed by less, or that did not grow beyond its share, is news to nobody."""
GROWN_M = 0.5
"""The box of a storey follows its rooms in steps of this."""


@dataclass
class Storey:
    """The ground of one storey: what is free at standing height and which room it belongs to, and its walls as lines.

    opened    bounds of walls that are no more, until the ground there is looked at again
    ceilings  plane id → height [m] and hull of the ceilings seen over this floor
    ceiling_z the height of those that cover most [m]; None where none was seen
    """

    number: int
    floor_z: float
    ground: GroundGrid = field(default_factory=lambda: GroundGrid(CELL_M))
    walls: dict[int, Line] = field(default_factory=dict)
    opened: list[Array] = field(default_factory=list)
    ceilings: dict[int, tuple[float, shapely.Geometry]] = field(default_factory=dict)
    ceiling_z: float | None = None
    _over: GroundIndex = field(default_factory=GroundIndex)
    _weights: dict[int, tuple[float, float]] = field(default_factory=dict)
    _layers: int = 0

    @property
    def id(self) -> str:
        """The node's id."""
        return f"storey_{self.number}"

    def ceiling_over(self, footprint: shapely.Polygon) -> float | None:
        """The height of the ceiling over a room [m]; None where none was seen over a fifth of it."""
        near = [self.ceilings[int(i)] for i in self._over.within(_bounds(footprint), 0.0)]
        over = [(z, footprint.intersection(outline).area) for z, outline in near]
        if sum(area for _, area in over) < LEAST_CEILING_SHARE * footprint.area:
            return None
        return _weighted_median(over)

    def hang(self, plane_id: int, z: float, outline: shapely.Geometry) -> None:
        """Note a ceiling."""
        self.ceilings[plane_id] = (z, outline)
        self._weights[plane_id] = (z, outline.area)
        self._over.put(str(plane_id), _bounds(outline))
        self._weigh()

    def unhang(self, plane_id: int) -> shapely.Geometry | None:
        """Forget a ceiling; returns what it covered, None when it was none."""
        known = self.ceilings.pop(plane_id, None)
        if known is None:
            return None
        self._over.remove(str(plane_id))
        del self._weights[plane_id]
        self._weigh()
        return known[1]

    def _weigh(self) -> None:
        self.ceiling_z = _weighted_median(list(self._weights.values()))

    # -- what is seen -------------------------------------------------------------------------------------
    def open_ground(self, occupancy: OccupancyMap, blocks: Array) -> list[Array]:
        """Note the cells that are free at standing height, and what is above every ceiling, free or tall; returns the
        bounds of the former, corners (2, 2) in cells, where new."""
        height = TALLEST_STOREY_M if self.ceiling_z is None else self.ceiling_z - self.floor_z
        sky, tall = self._look_up(occupancy, blocks, height + OPEN_SKY_M[0], height + OPEN_SKY_M[1])
        if len(sky):
            above = self._at(sky)
            self.ground.sky[above], self.ground.tall[above] = True, False
        if len(tall):
            self.ground.tall[self._at(tall)] = True
        return self._look_round(occupancy, blocks)

    def _look_up(self, occupancy: OccupancyMap, blocks: Array, low_m: float, high_m: float) -> tuple[Array, Array]:
        """Cells (N, 2) of which the blocks show, between two heights over the floor, free space throughout, and those
        where something is."""
        blocks, evidence, in_band = self._between(occupancy, blocks, low_m, high_m)
        throughout = np.all(_is_free(evidence) | ~in_band, axis=3) & np.any(in_band, axis=3)
        occupied = np.any((evidence >= 0) & in_band, axis=3)
        return self._ground_cells(blocks, throughout, occupancy), self._ground_cells(blocks, occupied, occupancy)

    def _look_round(self, occupancy: OccupancyMap, blocks: Array) -> list[Array]:
        """Note the cells with free space at standing height, and in which layers of blocks there something is; returns
        the bounds of the former, where new."""
        self._layers = _layers(occupancy, self.floor_z + BAND_M[0], self.floor_z + BAND_M[1])
        blocks, evidence, in_band = self._between(occupancy, blocks, *BAND_M)
        if not len(blocks):
            return []
        corners = np.stack([blocks[:, :2].min(axis=0), blocks[:, :2].max(axis=0) + 1]) * occupancy.block_size_m
        self.ground.cover(*np.floor(corners / CELL_M).astype(np.int64))
        n, bounds = free_ground.note_columns(
            self.ground.free, self.ground.solid, evidence, blocks.astype(np.int64), in_band[:, 0, 0],
            CELL_M / occupancy.voxel_size_m, self.ground.low,
        )  # fmt: skip
        return [bounds] if n >= LEAST_NEW_CELLS else []

    def _between(
        self, occupancy: OccupancyMap, blocks: Array, low_m: float, high_m: float
    ) -> tuple[Array, Array, Array]:
        """The blocks (K, 3) that reach between two heights over the floor, their evidence (K, 8, 8, 8), and which of
        their voxels (K, 1, 1, 8) lie between."""
        edge = occupancy.block_size_m
        low, high = self.floor_z + low_m, self.floor_z + high_m
        blocks = blocks[(blocks[:, 2] * edge < high) & ((blocks[:, 2] + 1) * edge > low)]
        heights = (blocks[:, 2, None] * 8 + np.arange(8) + 0.5) * occupancy.voxel_size_m
        in_band = ((heights > low) & (heights < high))[:, None, None, :]
        return blocks, occupancy.evidence_of(blocks).reshape(-1, 8, 8, 8), in_band

    @staticmethod
    def _ground_cells(blocks: Array, columns: Array, occupancy: OccupancyMap) -> Array:
        """The cells (N, 2) below columns (K, 8, 8) bool of blocks (K, 3)."""
        which, u, v = np.nonzero(columns)
        xy = (blocks[which, :2] * 8 + np.stack([u, v], axis=1) + 0.5) * occupancy.voxel_size_m
        return np.floor(xy / CELL_M).astype(np.int64)

    def _at(self, cells: Array) -> tuple[Array, Array]:
        """Where the cells (N, 2) lie in the arrays of the ground, which is made to hold them."""
        self.ground.cover(cells.min(axis=0), cells.max(axis=0))
        i, j = (cells - self.ground.low).T
        return i, j

    def solid(self, where: tuple[slice, slice]) -> Array:
        """(W, H) bool: the cells of a window that something fills from the lowest to the highest layer at standing
        height: walls, labelled or not, and tall furniture."""
        if not self._layers:
            return np.zeros(self.ground.solid[where].shape, np.bool_)
        return np.asarray((self.ground.solid[where] & self._layers) == self._layers)

    def move_walls(self, planes: Iterable[tuple[str, Plane]]) -> list[Array]:
        """Draw walls anew; returns the bounds of those that changed."""
        dirty = []
        for label, plane in planes:
            known = self.walls.get(plane.id)
            line = None
            if (
                label == "wall"
                and plane.width_m >= LEAST_WALL_M
                and plane.z_max > self.floor_z + BAND_M[0]
                and plane.z_min < self.floor_z + BAND_M[1] + 0.5
            ):
                line = _ground_line(plane)
            if line is None:
                if known is not None:
                    del self.walls[plane.id]
                    dirty.append(_line_bounds(known))
            elif known is None or np.abs(np.subtract(known, line)).max() > CELL_M:
                self.walls[plane.id] = line
                dirty.append(_line_bounds(line))
        return dirty

    def forget(self, plane_id: int) -> None:
        """A plane that is no more."""
        self.unhang(plane_id)
        line = self.walls.pop(plane_id, None)
        if line is not None:
            self.opened.append(_line_bounds(line))


def _is_free(evidence: Array) -> NDArray[np.bool_]:
    return (evidence < 0) & (evidence > -128)


def _layers(occupancy: OccupancyMap, low: float, high: float) -> int:
    """A bit for each layer of blocks of which some voxels lie between two heights [m]."""
    voxels = np.arange(np.ceil(low / occupancy.voxel_size_m - 0.5), np.floor(high / occupancy.voxel_size_m + 0.5))
    layers, counts = np.unique(voxels.astype(np.int64) // 8, return_counts=True)
    return sum(1 << layer % 16 for layer in layers[counts >= LEAST_LAYER_VOXELS].tolist())


class Storeys(Sequence[Storey]):
    """All storeys, in the order in which they were found, and their nodes."""

    def __init__(self) -> None:
        self._all: list[Storey] = []
        self._written: dict[int, tuple[Array, float | None]] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, index: Any) -> Any:
        return self._all[index]

    def found(self, floor: Plane) -> Storey | None:
        """The storey that a floor founds; None when it belongs to one that is known."""
        z = float(floor.centroid[2])
        if floor.area_m2 < LEAST_FLOOR_M2 or any(abs(z - s.floor_z) < STOREY_M for s in self._all):
            return None
        storey = Storey(len(self._all) + 1, z)
        self._all.append(storey)
        return storey

    def at(self, z: float) -> Storey | None:
        """The highest storey whose floor is not above z (0.3 m is forgiven); None where there is none."""
        below = [s for s in self._all if s.floor_z <= z + 0.3]
        return max(below, key=lambda s: s.floor_z, default=None)

    def hang_ceilings(self, planes: Iterable[tuple[str, Plane]]) -> list[tuple[Storey, shapely.Geometry]]:
        """Note ceilings that are new or changed; returns what they cover or covered, with the storey below them."""
        changed = []
        for label, plane in planes:
            z = float(plane.centroid[2])
            storey = self.at(z - LEAST_HEIGHT_M) if label == "ceiling" else None
            others = [s for s in self._all if s is not storey]
            changed += [(s, covered) for s in others if (covered := s.unhang(plane.id)) is not None]
            if storey is not None:
                outline = shapely.MultiPoint(plane.rings[0][:, :2]).convex_hull
                known = storey.ceilings.get(plane.id)
                if known is None or abs(known[0] - z) > NOTICED_M or known[1].area < NOTICED_SHARE * outline.area:
                    storey.hang(plane.id, z, outline)
                    changed.append((storey, outline))
        return changed

    # -- the graph ----------------------------------------------------------------------------------------
    def write(self, changes: GraphChanges, building: str, graph: SceneGraph, stamp_ns: int) -> None:
        """Join the rooms that the changes put to their storeys, and these to the building; a room outdoors is in none.

        The box of a storey holds its rooms.
        """
        rooms = {step.id: step for step in changes.steps if isinstance(step, Node) and step.layer == "room"}
        for storey in self._all:
            own = [room for room in rooms.values() if room.attributes.get("storey") == storey.number]
            for room in own:
                _join(changes, graph, room, storey.id, outdoors=bool(room.attributes.get("outdoors", False)))
            extent = [box for room in own if (box := room.box) is not None]
            if extent:
                self._write_storey(storey, extent, changes, building, graph, stamp_ns)

    def _write_storey(
        self, storey: Storey, boxes: list[Box], changes: GraphChanges, building: str, graph: SceneGraph, stamp_ns: int
    ) -> None:
        """Write the node of a storey, where it grew or its ceiling was found."""
        low = np.min([b.center[:2] - 0.5 * b.size[:2] for b in boxes], axis=0)
        high = np.max([b.center[:2] + 0.5 * b.size[:2] for b in boxes], axis=0)
        bounds = np.concatenate([low, -high])
        ceiling = storey.ceiling_z
        known = self._written.get(storey.number)
        if known is not None:
            bounds = np.minimum(bounds, known[0])
            same = _same_height(ceiling, known[1])
            if storey.id in graph and same and (known[0] - bounds).max() < GROWN_M:
                return
        self._written[storey.number] = (bounds, ceiling)
        low, high = bounds[:2], -bounds[2:]
        height = DEFAULT_HEIGHT_M if ceiling is None else ceiling - storey.floor_z
        before = graph.node(storey.id) if storey.id in graph else None
        first = stamp_ns if before is None else before.first_seen_ns
        measures = {} if ceiling is None else {"ceiling_z": round(ceiling, 3), "height_m": round(height, 3)}
        changes.put(
            Node(
                id=storey.id,
                layer="storey",
                label="storey",
                position=(*(0.5 * (low + high)), storey.floor_z),
                box=Box(center=(*(0.5 * (low + high)), storey.floor_z + 0.5 * height), size=(*(high - low), height)),
                first_seen_ns=first,
                last_seen_ns=stamp_ns if before is None else max(stamp_ns, before.last_seen_ns),
                attributes={"number": storey.number, "floor_z": round(storey.floor_z, 3), **measures},
            )
        )
        if before is None or graph.edge("in", storey.id, building) is None:
            for relation, source, target in (("in", storey.id, building), ("contains", building, storey.id)):
                changes.put(
                    Edge(relation=relation, source=source, target=target, first_seen_ns=first, last_seen_ns=stamp_ns)
                )

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """The arrays that make all storeys."""
        state: dict[str, Array] = {"floors": np.array([s.floor_z for s in self._all])}
        for storey in self._all:
            prefix = f"storey.{storey.number}."
            state.update({prefix + name: array for name, array in storey.ground.state().items()})
            state[prefix + "walls"] = np.array([(i, *line) for i, line in storey.walls.items()]).reshape(-1, 5)
            heights = np.array([(i, z) for i, (z, _) in storey.ceilings.items()]).reshape(-1, 2)
            rings = [shapely.get_coordinates(outline) for _, outline in storey.ceilings.values()]
            state[prefix + "ceilings"] = heights
            state[prefix + "ceiling_sizes"] = np.array([len(ring) for ring in rings], np.int64)
            state[prefix + "ceiling_corners"] = np.concatenate([np.empty((0, 2)), *rings])
        return state

    def restore(self, state: Mapping[str, Array], graph: SceneGraph) -> None:
        """Take over what `state` gave."""
        for k, floor_z in enumerate(state["floors"].tolist()):
            storey, prefix = Storey(k + 1, floor_z), f"storey.{k + 1}."
            storey.ground.restore({key.removeprefix(prefix): a for key, a in state.items() if key.startswith(prefix)})
            storey.walls = {int(row[0]): (row[1], row[2], row[3], row[4]) for row in state[prefix + "walls"].tolist()}
            if prefix + "ceilings" in state:
                ends = np.cumsum(state[prefix + "ceiling_sizes"])
                hulls = np.split(state[prefix + "ceiling_corners"], ends[:-1])
                for (plane_id, z), hull in zip(state[prefix + "ceilings"].tolist(), hulls, strict=False):
                    storey.hang(int(plane_id), z, shapely.MultiPoint(hull).convex_hull)
            self._all.append(storey)
            if storey.id in graph and (box := graph.node(storey.id).box) is not None:
                low, high = box.center[:2] - 0.5 * box.size[:2], box.center[:2] + 0.5 * box.size[:2]
                self._written[storey.number] = (np.concatenate([low, -high]), storey.ceiling_z)


def _join(changes: GraphChanges, graph: SceneGraph, room: Node, storey: str, *, outdoors: bool) -> None:
    housed = graph.edge("in", room.id, storey) is not None
    times = {"first_seen_ns": room.first_seen_ns, "last_seen_ns": room.last_seen_ns}
    for relation, source, target in (("in", room.id, storey), ("contains", storey, room.id)):
        if outdoors and housed:
            changes.delete_edge(relation, source, target)
        elif not outdoors and not housed:
            changes.put(Edge(relation=relation, source=source, target=target, **times))


def _same_height(a: float | None, b: float | None) -> bool:
    return a is b if a is None or b is None else abs(a - b) < NOTICED_M


def _bounds(outline: shapely.Geometry) -> tuple[Array, Array]:
    x0, y0, x1, y1 = outline.bounds
    return np.array([x0, y0, 0.0]), np.array([x1, y1, 0.0])


def _weighted_median(values: list[tuple[float, float]]) -> float | None:
    """Of (value, weight): the value below which half of the weight lies; None where nothing weighs anything."""
    total = sum(weight for _, weight in values)
    passed = 0.0
    for value, weight in sorted(values):
        passed += weight
        if weight > 0.0 and passed >= 0.5 * total:
            return value
    return None


def _ground_line(plane: Plane) -> Line:
    """A wall seen from above: x0, y0, x1, y1 [m], a little longer than what was seen of it."""
    along = np.array([-plane.normal[1], plane.normal[0]])
    along /= np.linalg.norm(along)
    half = 0.5 * plane.width_m + CORNER_M
    a, b = plane.box_center[:2] - half * along, plane.box_center[:2] + half * along
    return float(a[0]), float(a[1]), float(b[0]), float(b[1])


def _line_bounds(line: Line) -> Array:
    ends = np.floor(np.array(line).reshape(2, 2) / CELL_M).astype(np.int64)
    return np.stack([ends.min(axis=0), ends.max(axis=0)])
