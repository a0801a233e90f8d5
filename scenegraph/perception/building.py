"""What relations ask of the building: the floor below, whether structure stands between, the way around it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import regions as kernels
from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.planes import Plane, PlaneMap
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.relations import Passage

Array: TypeAlias = NDArray[Any]

SOLID = frozenset({"wall", "floor", "ceiling"})
INSET_M = 0.06
"""Segments between two surfaces begin and end this far from them: a picture's points straddle the wall it hangs on."""
WAY_CELL_M = 0.05


class Building:
    """The labelled planes of the structure, indexed over the ground."""

    def __init__(self, planes: PlaneMap, occupancy: OccupancyMap) -> None:
        self._planes = planes
        self._occupancy = occupancy
        self._index = GroundIndex()
        self._floors: dict[str, tuple[Array, Array, float]] = {}
        self._walls = GroundIndex()
        self._lines: dict[str, tuple[Array, float, Array, float, float]] = {}

    def update(self, labelled: Iterable[tuple[str, Plane]], gone: Iterable[int]) -> None:
        """Planes that were labelled or changed, and ids of planes that are no more."""
        for plane_id in gone:
            self._index.remove(str(plane_id))
            self._walls.remove(str(plane_id))
            self._floors.pop(f"plane_{plane_id}", None)
        for label, plane in labelled:
            corners = np.concatenate(plane.rings)
            low, high = corners.min(axis=0), corners.max(axis=0)
            if label in SOLID:
                self._index.put(str(plane.id), (low, high))
            else:
                self._index.remove(str(plane.id))
            self._walls.remove(str(plane.id))
            if label == "wall":
                normal = plane.normal[:2] / np.linalg.norm(plane.normal[:2])
                along = np.array([-normal[1], normal[0]])
                reach = corners[:, :2] @ along
                self._lines[str(plane.id)] = (
                    normal,
                    float(plane.centroid[:2] @ normal),
                    along,
                    reach.min(),
                    reach.max(),
                )
                self._walls.put(str(plane.id), (low, high))
            self._floors.pop(f"plane_{plane.id}", None)
            if label == "floor":
                self._floors[f"plane_{plane.id}"] = (low, high, float(plane.centroid[2]))

    def floor_below(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The floor under a point: its node id and height [m]; the nearest in plan where none lies right below."""
        best: tuple[float, str, float] | None = None
        for node, (low, high, height) in self._floors.items():
            if height > z + 0.3:
                continue
            outside = np.maximum(np.maximum(low[:2] - (x, y), (x, y) - high[:2]), 0.0)
            badness = 10.0 * float(np.hypot(*outside)) + (z - height)
            if best is None or (badness, node) < best[:2]:
                best = (badness, node, height)
        return None if best is None else best[1:]

    def between(self, p: Array, q: Array) -> Passage:
        """What stands between two points (3,): nothing, a wall, floor or ceiling, or a part of a wall that was not
        seen.

        Furniture hides the walls behind it: a wall is taken to go on, unseen, wherever it was not seen to be open.
        """
        p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
        length = float(np.linalg.norm(q - p))
        if length < 1e-6:
            return "clear"
        inset = min(INSET_M, 0.3 * length) / length
        a, b = p + inset * (q - p), q - inset * (q - p)
        low, high = np.minimum(a, b), np.maximum(a, b)
        ids = self._near(low, high)
        if ids and self._planes.blocks_segment(a[None], b[None], ids)[0]:
            return "blocked"
        for node in self._walls.within((low, high), 0.1):
            normal, offset, along, start, end = self._lines[node]
            da, db = float(a[:2] @ normal - offset), float(b[:2] @ normal - offset)
            if da * db >= 0.0:
                continue
            at = a + da / (da - db) * (b - a)
            if start <= at[:2] @ along <= end and not self._open(at, normal):
                return "unseen"
        return "clear"

    def _open(self, at: Array, normal: Array) -> bool:
        """Whether a wall was seen to be open at a point (3,)."""
        step = np.array([*normal, 0.0]) * self._occupancy.voxel_size_m
        return bool((self._occupancy.classify(np.stack([at - step, at, at + step])) == FREE).all())

    def way_around(self, p: Array, q: Array, limit_m: float) -> tuple[float, float]:
        """Shortest way from p to q around walls, through observed space only and with unknown passable [m]; inf if
        longer.

        The way is looked for on the ground, at the height of the two points, and pulled taut.
        """
        p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
        low, high = np.minimum(p, q) - limit_m, np.maximum(p, q) + limit_m
        z_low, z_high = min(p[2], q[2]), max(p[2], q[2])
        origin = np.floor(low[:2] / WAY_CELL_M).astype(np.int64)
        shape = tuple((np.floor(high[:2] / WAY_CELL_M).astype(np.int64) - origin + 1).tolist())
        blocked = np.zeros(shape, bool)
        for node in self._walls.within((low, high), 0.0):
            points = self._wall_points(node, low, high, (z_low, 0.5 * (z_low + z_high), z_high))
            cells = np.floor(points / WAY_CELL_M).astype(np.int64) - origin
            cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
            blocked[cells[:, 0], cells[:, 1]] = True
        ends = [(np.floor(e[:2] / WAY_CELL_M).astype(np.int64) - origin).tolist() for e in (p, q)]
        rise = abs(float(p[2] - q[2]))
        lower = self._taut(blocked, ends, rise, limit_m)
        if not np.isfinite(lower):
            return np.inf, np.inf
        middle = 0.5 * (z_low + z_high)
        ij = np.indices(shape).reshape(2, -1).T
        centres = np.column_stack([(ij + origin + 0.5) * WAY_CELL_M, np.full(len(ij), middle)])
        unknown = (self._occupancy.classify(centres) < FREE).reshape(shape)
        return self._taut(blocked | unknown, ends, rise, limit_m), lower

    def _wall_points(self, node: str, low: Array, high: Array, heights: tuple[float, ...]) -> Array:
        """Ground points (N, 2), half a cell apart, of the part of a wall that was seen at one of the heights."""
        normal, offset, along, start, end = self._lines[node]
        corners = np.array([low[:2], [low[0], high[1]], high[:2], [high[0], low[1]]]) @ along
        steps = np.arange(max(start, corners.min()), min(end, corners.max()), 0.5 * WAY_CELL_M)
        ground = offset * normal + steps[:, None] * along
        seen = np.zeros(len(ground), bool)
        for z in heights:
            at = np.column_stack([ground, np.full(len(ground), z)])
            through = np.array([*normal, 0.0]) * WAY_CELL_M
            seen |= self._planes.blocks_segment(at - through, at + through, [int(node)])
        return np.asarray(ground[seen])

    @staticmethod
    def _taut(blocked: Array, ends: list[list[int]], rise: float, limit_m: float) -> float:
        (a, b), (c, d) = ends
        way = kernels.shortest_way(blocked, a, b, c, d, 1.1 * limit_m / WAY_CELL_M)
        if not len(way):
            return np.inf
        return float(np.hypot(kernels.taut_length(blocked, way) * WAY_CELL_M, rise))

    def seen_free(self, points: Array) -> Array:
        """(N,) bool: which points (N, 3) lie in space that was observed to be free."""
        return np.asarray(self._occupancy.classify(points) == FREE)

    def occupied(self, points: Array) -> Array:
        """(N,) bool: which points (N, 3) lie in space that was observed to be filled."""
        return np.asarray(self._occupancy.classify(points) == OCCUPIED)

    def _near(self, low: Array, high: Array) -> list[int]:
        return [int(name) for name in self._index.within((low, high), 0.1)]
