"""What relations ask of the building: the floor below, whether structure stands between, the way around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import regions as kernels
from mapping.occupancy import FREE, OccupancyMap
from mapping.planes import Plane, PlaneMap
from scenegraph.perception.contacts import Wall
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.relations import Passage

Array: TypeAlias = NDArray[Any]

SOLID = frozenset({"wall", "floor", "ceiling"})
INSET_M = 0.06
"""Segments between two surfaces begin and end this far from them: a picture's points straddle the wall it hangs on."""
OPPOSITE = -0.9
"""Cosine between the normals of two faces of a wall, at most."""
WALL_STEP_M = 0.025
"""How finely it is told where a wall ends."""
FLOOR_REACH_M = 1.5
"""A thing stands on a floor that was seen no farther than this from under it."""
CORNER_GAP_M = 0.08
"""Where a wall ends, as against where it opens, it goes on this far, to meet the next."""
CORNER_M = 0.01
"""How far from the end of a wall a way leads past it."""


class Building:
    """The labelled planes of the structure, indexed over the ground.

    storey_at: the number of the storey that a height [m] lies in; default: there is one
    """

    def __init__(
        self, planes: PlaneMap, occupancy: OccupancyMap, storey_at: Callable[[float], int | None] = lambda _: None
    ) -> None:
        self._planes = planes
        self._occupancy = occupancy
        self._index = GroundIndex()
        self._floors = GroundIndex()
        self._ceilings = GroundIndex()
        self._level_boxes: dict[str, tuple[Array, Array, float]] = {}
        self._walls = GroundIndex()
        self._lines: dict[str, tuple[Array, float, Array, float, float]] = {}
        self._wall_heights: dict[str, tuple[float, float]] = {}
        self.storey = storey_at

    def update(self, labelled: Iterable[tuple[str, Plane]], gone: Iterable[int]) -> None:
        """Planes that were labelled or changed, and ids of planes that are no more."""
        for plane_id in gone:
            self._index.remove(str(plane_id))
            self._walls.remove(str(plane_id))
            self._lines.pop(str(plane_id), None)
            self._floors.remove(f"plane_{plane_id}")
            self._ceilings.remove(f"plane_{plane_id}")
        for label, plane in labelled:
            corners = np.concatenate(plane.rings)
            low, high = corners.min(axis=0), corners.max(axis=0)
            if label in SOLID:
                self._index.put(str(plane.id), (low, high))
            else:
                self._index.remove(str(plane.id))
            self._walls.remove(str(plane.id))
            self._lines.pop(str(plane.id), None)
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
                self._wall_heights[str(plane.id)] = float(low[2]), float(high[2])
            for kind, levels in (("floor", self._floors), ("ceiling", self._ceilings)):
                levels.remove(f"plane_{plane.id}")
                if label == kind:
                    levels.put(f"plane_{plane.id}", (low, high))
                    self._level_boxes[f"plane_{plane.id}"] = (low, high, float(plane.centroid[2]))

    def floor_below(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The floor under a point: its node id and height [m]; the nearest in plan where none lies right below."""
        return self._level(self._floors, x, y, z, -1.0)

    def ceiling_above(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The ceiling over a point: its node id and height [m]; the nearest in plan where none lies right above."""
        return self._level(self._ceilings, x, y, z, 1.0)

    def _level(self, levels: GroundIndex, x: float, y: float, z: float, up: float) -> tuple[str, float] | None:
        best: tuple[float, str, float] | None = None
        at = np.array([x, y, z])
        for node in levels.within((at, at), FLOOR_REACH_M):
            low, high, height = self._level_boxes[node]
            if up * (height - z) < -0.3:
                continue
            outside = np.maximum(np.maximum(low[:2] - at[:2], at[:2] - high[:2]), 0.0)
            badness = 10.0 * float(np.hypot(*outside)) + up * (height - z)
            if best is None or (badness, node) < best[:2]:
                best = (badness, node, height)
        return None if best is None else best[1:]

    def walls_beside(self, low: Array, high: Array) -> list[Wall]:
        """The walls whose bounds meet the box from corner `low` to `high` (3,)."""
        found = []
        for node in self._walls.within((low, high), 0.0):
            bottom, top = self._wall_heights[node]
            if bottom <= high[2] and top >= low[2]:
                found.append(Wall(f"plane_{node}", *self._lines[node], bottom, top))
        return found

    def between(self, p: Array, q: Array) -> Passage:
        """What stands between two points (3,): nothing, a wall, floor or ceiling, or a part of a wall that was not
        seen.

        Furniture hides the walls behind it: a wall is taken to go on, unseen, wherever it was not seen to be open.
        """
        p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
        length = float(np.linalg.norm(q - p))
        about = self._near(np.minimum(p, q), np.maximum(p, q)) if length >= 1e-6 else []
        if not about:
            return "clear"
        inset = min(INSET_M, 0.3 * length) / length
        a, b = p + inset * (q - p), q - inset * (q - p)
        if self._planes.blocks_segment(a, b, about)[0]:
            return "blocked"
        crossed = int(self._planes.count_crossings(p, q, about)[0])
        if crossed >= 2:
            return "blocked"  # both faces of a wall that is little thicker than the two ends stand off it
        faces: list[Array] = []
        unseen = False
        for node in map(str, about):
            if node not in self._lines:
                continue
            normal, offset, along, start, end = self._lines[node]
            dp, dq = float(p[:2] @ normal - offset), float(q[:2] @ normal - offset)
            if dp * dq >= 0.0:
                continue
            share = dp / (dp - dq)
            at = p + share * (q - p)
            if start <= at[:2] @ along <= end and not self._open(at, normal):
                unseen |= inset < share < 1.0 - inset
                faces.append(normal)
        if any(float(one @ other) < OPPOSITE for one, other in combinations(faces, 2)):
            return "blocked" if crossed else "unseen"  # both faces of a wall, which things hide
        return "unseen" if unseen else "clear"

    def _open(self, at: Array, normal: Array) -> bool:
        """Whether a wall was seen to be open at a point (3,)."""
        step = np.array([*normal, 0.0]) * self._occupancy.voxel_size_m
        return bool((self._occupancy.classify(np.stack([at - step, at, at + step])) == FREE).all())

    def walled(self, p: Array, q: Array) -> Array:
        """(N,) bool: whether a wall, wherever it was not seen to be open, stands between points (N, 3) and (N, 3)."""
        ends = np.concatenate([p, q])
        found = np.zeros(len(p), bool)
        for wall in self.walls_beside(ends.min(axis=0), ends.max(axis=0)):
            dp, dq = p[:, :2] @ wall.normal - wall.offset, q[:, :2] @ wall.normal - wall.offset
            across = np.flatnonzero((dp * dq < 0.0) & ~found)
            at = p[across] + (dp / np.where(dp == dq, 1.0, dp - dq))[across, None] * (q - p)[across]
            along = at[:, :2] @ wall.along
            inside = (along >= wall.start) & (along <= wall.end)
            across, at = across[inside], at[inside]
            step = np.array([*wall.normal, 0.0]) * self._occupancy.voxel_size_m
            free = self._occupancy.classify(np.concatenate([at - step, at, at + step])) == FREE
            found[across] = ~free.reshape(3, -1).all(axis=0)
        return found

    def way_around(self, p: Array, q: Array, limit_m: float) -> tuple[float, float]:
        """Shortest way from p to q around walls, through observed space only and with unknown passable [m]; inf if
        longer.

        The way leads over the ground along the ends of what was seen of the walls at the heights of the two points
        (visibility graph), so it is exact up to how finely walls are known.
        """
        p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
        reach = 0.5 * limit_m
        low, high = np.minimum(p, q) - reach, np.maximum(p, q) + reach
        heights = np.array([min(p[2], q[2]), 0.5 * (p[2] + q[2]), max(p[2], q[2])])
        parts = [self._seen_parts(node, low, high, heights) for node in self._walls.within((low, high), 0.0)]
        walls = np.concatenate(parts) if parts else np.empty((0, 4))
        along = (walls[:, 2:] - walls[:, :2]) / np.maximum(np.linalg.norm(walls[:, 2:] - walls[:, :2], axis=1), 1e-9)[
            :, None
        ]
        corners = np.concatenate([walls[:, :2] - CORNER_M * along, walls[:, 2:] + CORNER_M * along])
        detour = np.hypot(*(corners - p[:2]).T) + np.hypot(*(corners - q[:2]).T)
        points = np.concatenate([[p[:2], q[:2]], corners[detour <= limit_m]])
        steps = kernels.sight(points, walls)
        rise = abs(float(p[2] - q[2]))
        lower = self._length(steps, rise, limit_m)
        if not np.isfinite(lower):
            return np.inf, np.inf
        return self._length(self._through_seen_space(steps, points, heights[1]), rise, limit_m), lower

    def _seen_parts(self, node: str, low: Array, high: Array, heights: Array) -> Array:
        """The parts (M, 4) of a wall, x0, y0, x1, y1, that were seen at one of the heights, between two corners
        (3,)."""
        normal, offset, along, start, end = self._lines[node]
        corners = np.array([low[:2], [low[0], high[1]], high[:2], [high[0], low[1]]]) @ along
        steps = np.arange(max(start, corners.min()), min(end, corners.max()), WALL_STEP_M)
        if not len(steps):
            return np.empty((0, 4))
        begin = offset * normal + steps[0] * along
        seen = np.zeros(len(steps) + 2, bool)
        seen[1:-1] = self._planes.seen_along(
            int(node), len(steps), begin, WALL_STEP_M * along, heights, WALL_STEP_M * normal
        )
        first, last = np.flatnonzero(seen[1:] & ~seen[:-1]), np.flatnonzero(seen[:-1] & ~seen[1:]) - 1
        if not len(first):
            return np.empty((0, 4))
        at_start, at_end = steps[first] - start < CORNER_GAP_M, end - steps[last] < CORNER_GAP_M
        before = np.where(at_start, CORNER_GAP_M, 0.5 * WALL_STEP_M)[:, None] * along
        after = np.where(at_end, CORNER_GAP_M, 0.5 * WALL_STEP_M)[:, None] * along
        ground = offset * normal + steps[:, None] * along
        return np.concatenate([ground[first] - before, ground[last] + after], axis=1)

    def _through_seen_space(self, steps: Array, points: Array, z: float) -> Array:
        """The steps (N, N) that lead through space that was observed; the others are inf."""
        i, j = np.nonzero(np.isfinite(steps) & (np.arange(len(points))[:, None] < np.arange(len(points))))
        shares = np.linspace(0.0, 1.0, 20)
        ground = points[i, None] + shares[None, :, None] * (points[j, None] - points[i, None])
        at = np.concatenate([ground, np.full((*ground.shape[:2], 1), z)], axis=2).reshape(-1, 3)
        unseen = (self._occupancy.classify(at) < FREE).reshape(len(i), -1).any(axis=1)
        steps[i[unseen], j[unseen]] = steps[j[unseen], i[unseen]] = np.inf
        return steps

    @staticmethod
    def _length(steps: Array, rise: float, limit_m: float) -> float:
        length = float(np.hypot(kernels.shortest_chain(steps, 0, 1), rise))
        return length if length <= limit_m else np.inf

    def seen_free(self, points: Array) -> Array:
        """(N,) bool: which points (N, 3) lie in space that was observed to be free."""
        return np.asarray(self._occupancy.classify(points) == FREE)

    def _near(self, low: Array, high: Array) -> list[int]:
        return [int(name) for name in self._index.within((low, high), 0.1)]
