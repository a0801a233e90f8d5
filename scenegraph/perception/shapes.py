"""The measured shape of a thing: surface points, and what relations need to know of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapping.geometry import SE3
from mapping.kernels import columns, shapes
from scenegraph.graph import Box

Array: TypeAlias = NDArray[Any]

COARSE_CELL_M = 0.06
CLUSTER_CELL_M = 0.06
"""Parts of a thing are no farther apart than about two of these; what lies farther is another thing's, mistaken for
it."""
PART_SHARE = 0.05
PART_BESIDE_M = 0.08
PART_INSIDE = 0.6
PART_GAP_M = 0.45
MOST_PARTS = 3
"""… but for what lies right under or over it: a seat hides the column that joins it to its foot. Such a part has this
share of the votes, and so much of it lies over or under the main part, or of the main part over or under it as of a
pedestal under its basin, give or take a margin, at most this far off."""
EXTREME_SHARE = 0.003
"""Share of the votes that may stick out of a box at the bottom; half of it at the top: outliers of depth and pose."""
SIDE_SHARE = 0.001
SIDE_DIRECTIONS = 8
"""Share of the votes that may stick out at either end of as many horizontal axes: masks bleed and poses err sideways.
Chosen so that boxes of simulated things are neither too long nor too short in the median."""
MOST_VOTES = 0.5
"""A voxel counts no more than this there, or the face that was seen best would outweigh the others."""
MOST_TO_FIT = 800
SIDE_NEAR_M = 0.02
"""Points that look for the direction of a box, and how close to its side is close enough: the noise of its surface."""
FOOTING_HEIGHT_M = 0.03
"""Columns whose lowest material lies within this of the lowest point carry the thing (`contact_gap` in the rules)."""
AS_NEAR_M = 0.02
"""Pairs of points that are no farther apart than this beyond the nearest are as near."""
OUTLINE_M = 0.002
"""So far a ground projection that is told may be off the hull of the points."""
CLOSE_M = 0.15
"""Nearer than this it matters to the centimetre how far two things are apart."""
MOST_COMPARED = 400_000
HEAD_HEIGHT_M = 0.05
"""The topmost part of a thing, by which it hangs."""
HEADROOM_M = 0.10
"""A surface faces up, and can carry something, when this much above it is clear of the thing's own material."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Surface points (N, 3) float32 [m] of one thing in map, one a voxel of edge `voxel_size_m`."""

    points: NDArray[np.float32]
    voxel_size_m: float

    @staticmethod
    def trimmed(points: NDArray[np.float32], weights: NDArray[np.float32], voxel_size_m: float) -> Shape | None:
        """The shape without what few votes say sticks out of it; None when there are too few points for one."""
        if len(points) < 4:
            return None
        together = _parts_of_one(points, weights)
        points, weights = points[together], weights[together]
        if len(points) < 4:
            return None
        kept = columns.inner_part(
            points, np.minimum(weights, np.float32(MOST_VOTES)), SIDE_SHARE, SIDE_DIRECTIONS, 0.005
        )
        order = np.argsort(points[:, 2])
        mass = np.cumsum(weights[order])
        kept[order[(mass < EXTREME_SHARE * mass[-1]) | (mass > (1.0 - EXTREME_SHARE / 2) * mass[-1])]] = False
        return Shape(np.ascontiguousarray(points[kept]) if kept.sum() >= 4 else points, voxel_size_m)

    def moved(self, T: SE3) -> Shape:
        """The shape carried along by a motion of the map."""
        return Shape(np.ascontiguousarray(T @ self.points), self.voxel_size_m)

    @cached_property
    def lowest(self) -> float:
        return float(self.bounds[0][2])

    @cached_property
    def highest(self) -> float:
        return float(self.bounds[1][2])

    @cached_property
    def hull(self) -> Array:
        """Convex ground projection: corners (K, 2), counter-clockwise."""
        hull: Array = shapes.convex_hull(self.points[:, :2].astype(np.float64))
        return hull

    @cached_property
    def outline(self) -> Array:
        """The hull (K, 2) less the corners that no side would miss by more than OUTLINE_M."""
        if len(self.hull) < 3:
            return self.hull
        corners: Array = shapely.get_coordinates(shapely.Polygon(self.hull).simplify(OUTLINE_M))[:-1]
        return corners

    @cached_property
    def area(self) -> float:
        """Of the hull [m²]."""
        return abs(shapes.polygon_area(self.hull)) if len(self.hull) > 2 else 0.0

    @cached_property
    def ground_samples(self) -> Array:
        """(N, 2) points spread over the hull, one each 5 cm or closer; corners and middle of what has hardly any."""
        low, high = self.hull.min(axis=0), self.hull.max(axis=0)
        steps = np.clip(np.ceil((high - low) / 0.05).astype(int), 12, 60)
        grid = np.stack(np.meshgrid(*(np.linspace(a, b, n) for a, b, n in zip(low, high, steps, strict=True))), axis=-1)
        inside = grid.reshape(-1, 2)[shapes.points_inside(self.hull, grid.reshape(-1, 2), 1e-9)]
        return inside if len(inside) >= 4 else np.vstack([self.hull, self.hull.mean(axis=0)])

    @cached_property
    def rectangle(self) -> tuple[float, float, float, float, float]:
        """Centre x, y, length, width, yaw of the upright rectangle about the points, along whose sides they lie."""
        ground = self.points[:, :2].astype(np.float64)
        x, y, length, width, yaw = shapes.fit_rectangle(ground, MOST_TO_FIT, SIDE_NEAR_M)
        return x, y, length, width, yaw

    @cached_property
    def box(self) -> Box:
        """Upright oriented box: x along the longer side, z up."""
        x, y, length, width, yaw = self.rectangle
        least = 0.5 * self.voxel_size_m
        return Box.from_yaw(
            (x, y, 0.5 * (self.lowest + self.highest)),
            (max(length, least), max(width, least), max(self.highest - self.lowest, least)),
            yaw,
        )

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) of the axis-aligned box."""
        return shapes.bounds(self.points)  # type: ignore[no-any-return]

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """(M, 3) some of the points, about one each COARSE_CELL_M."""
        coarse: NDArray[np.float32] = self.points[columns.thin_out(self.points, COARSE_CELL_M)]
        return coarse

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        keys = columns.column_keys(self.points, self.voxel_size_m)
        return keys, np.lexsort((self.points[:, 2], keys))

    @cached_property
    def facing_up(self) -> NDArray[np.float32]:
        """(E, 3) the points on which something could stand."""
        keys, order = self._columns
        free = columns.facing_up(self.points, keys, order, 1.5 * self.voxel_size_m, HEADROOM_M)
        exposed: NDArray[np.float32] = self.points[free]
        return exposed

    @cached_property
    def bottoms(self) -> NDArray[np.float32]:
        """(C, 3) the lowest point of every column."""
        keys, order = self._columns
        lowest: NDArray[np.float32] = self.points[columns.column_bottoms(self.points, keys, order)]
        return lowest

    @cached_property
    def footing(self) -> Array:
        """(F, 2) the columns on which the thing stands."""
        bottoms = self.bottoms
        return bottoms[bottoms[:, 2] <= self.lowest + FOOTING_HEIGHT_M, :2].astype(np.float64)

    @cached_property
    def tops(self) -> NDArray[np.float32]:
        """(C, 3) the highest point of every column."""
        highest: NDArray[np.float32] = self.points[columns.column_tops(*self._columns)]
        return highest

    @cached_property
    def upside_down(self) -> Shape:
        """The same thing mirrored at z = 0: its underside faces up."""
        return Shape(self.points * np.array([1.0, 1.0, -1.0], np.float32), self.voxel_size_m)

    @cached_property
    def head(self) -> Array:
        """(H, 2) the columns that reach up into its topmost part."""
        return self.tops[self.tops[:, 2] >= self.highest - HEAD_HEIGHT_M, :2].astype(np.float64)

    def distance_m(self, other: Shape) -> tuple[float, Array, Array]:
        """Least distance between the points of both, and a pair of points (3,), (3,) that attains it.

        Coarse points first, then all points around the coarse pair; within CLOSE_M all points that can be nearest, so
        exactly.
        """
        reach, i, j = shapes.nearest_pair(self.coarse, other.coarse)
        p, q = self.coarse[i], other.coarse[j]
        if reach <= CLOSE_M:
            return self._exactly(other, reach + 1e-4)
        mine = self.points[shapes.within(self.points, q, reach + 1e-4)]
        theirs = other.points[shapes.within(other.points, p, reach + 1e-4)]
        if len(mine) * len(theirs) == 0 or len(mine) * len(theirs) > MOST_COMPARED:
            return reach, p, q
        least, i, j = shapes.nearest_pair(mine, theirs)
        return float(least), mine[i], theirs[j]

    def _exactly(self, other: Shape, reach: float) -> tuple[float, Array, Array]:
        """The nearest points of two things that are known to be within `reach` [m]."""
        mine, theirs = _beside(self.points, other.bounds, reach), _beside(other.points, self.bounds, reach)
        if len(mine) * len(theirs) <= MOST_COMPARED:
            least, i, j = shapes.nearest_pair(mine, theirs)
            return float(least), mine[i], theirs[j]
        distance, at = cKDTree(theirs).query(mine)
        k = int(distance.argmin())
        return float(distance[k]), mine[k], theirs[at[k]]

    def line_to(self, other: Shape, reach: float, p: Array, q: Array) -> tuple[Array, Array]:
        """The ends (3,), (3,) of a line between nearest points, of which p and q are a pair, `reach` apart.

        Where others are as near, the highest: sides of things are upright, and what stands between them need not reach
        down to their feet.
        """
        swapped = len(other.coarse) < len(self.coarse)
        one, two = (other, self) if swapped else (self, other)
        i, j = shapes.highest_pair(one.coarse, two.coarse, reach + AS_NEAR_M)
        if i < 0 or min(one.coarse[i, 2], two.coarse[j, 2]) <= min(p[2], q[2]) + AS_NEAR_M:
            return p, q
        return (two.coarse[j], one.coarse[i]) if swapped else (one.coarse[i], two.coarse[j])


def _beside(points: NDArray[np.float32], bounds: tuple[Array, Array], reach: float) -> NDArray[np.float32]:
    """The points (N, 3) that lie within `reach` of a box along every axis."""
    kept: NDArray[np.float32] = points[((points >= bounds[0] - reach) & (points <= bounds[1] + reach)).all(axis=1)]
    return kept


def _parts_of_one(points: NDArray[np.float32], weights: NDArray[np.float32]) -> Array:
    """(N,) bool: the largest cluster of points (N, 3), and what stands apart from it only in height."""
    together: Array = columns.largest_cluster(points, weights, CLUSTER_CELL_M)
    total, left = float(weights.sum()), ~together
    for _ in range(MOST_PARTS):
        if weights[left].sum() < PART_SHARE * total:
            break
        rest = np.flatnonzero(left)
        part = rest[columns.largest_cluster(points[rest], weights[rest], CLUSTER_CELL_M)]
        left[part] = False
        if weights[part].sum() < PART_SHARE * total:
            break
        main, other = points[together, :2].astype(np.float64), points[part, :2].astype(np.float64)
        inside = max(_share_inside(other, main), _share_inside(main, other))
        low, high = points[together, 2].min(), points[together, 2].max()
        apart = max(low - points[part, 2].max(), points[part, 2].min() - high)
        if inside >= PART_INSIDE and apart <= PART_GAP_M:
            together[part] = True
    return together


def _share_inside(points: Array, others: Array) -> float:
    """Share of the points (N, 2) that lie in the convex hull of others (M, 2), give or take PART_BESIDE_M."""
    return float(shapes.points_inside(shapes.convex_hull(others), points, PART_BESIDE_M).mean())
