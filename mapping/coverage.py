"""What part of a plane has been seen: a raster of covered cells in a frame fixed to the plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mapping.kernels import rasters as kernels

Array: TypeAlias = NDArray[Any]

_SNAP = np.cos(np.deg2rad(20.0))
_TRIM = 0.05  # rows and columns with less than this share of the fullest one do not count for the extent


@dataclass(frozen=True)
class PlaneFrame:
    """Axes of a raster: `u`, `v`, `normal` (3,), right-handed, and an `origin` (3,) [m] in map.

    Points are projected along `normal`. It need not be the plane's own normal exactly, so that it can stay while the
    plane is refined: `lift` goes back to the plane itself.
    """

    origin: Array
    u: Array
    v: Array
    normal: Array

    @staticmethod
    def about(origin: Array, normal: Array) -> PlaneFrame:
        """The frame for a plane: u, v are map x and ±y when it is nearly level, level and up when it is upright."""
        if abs(normal[2]) > _SNAP:
            n = np.array([0.0, 0.0, np.sign(normal[2])])
            u = np.array([1.0, 0.0, 0.0])
        else:
            n = np.array(normal, dtype=np.float64)
            if abs(n[2]) < np.sqrt(1.0 - _SNAP**2):
                n[2] = 0.0
            n /= np.linalg.norm(n)
            u = np.array([-n[1], n[0], 0.0])
            u /= np.linalg.norm(u)
        return PlaneFrame(np.asarray(origin, dtype=np.float64), u, np.cross(n, u), n)

    @cached_property
    def _axes(self) -> Array:
        return np.stack([self.u, self.v])

    @cached_property
    def rows(self) -> Array:
        """(3, 3) origin, u and v, as kernels take them."""
        return np.stack([self.origin, self.u, self.v])

    def project(self, points: Array) -> Array:
        """Points (N, 3) [m] → (N, 2) [m] along u and v."""
        return np.asarray((points - self.origin) @ self._axes.T)

    def lift(self, uv: Array, normal: Array, offset: float) -> Array:
        """(N, 2) [m] → the points (N, 3) [m] of the plane normal·p = offset that project there."""
        flat = self.origin + uv @ self._axes
        along = (offset - flat @ normal) / (self.normal @ normal)
        return np.asarray(flat + along[:, None] * self.normal)


class Coverage:
    """The cells of one plane that hold samples, as counts, so that samples can be taken away again.

    frame       : where u = v = 0 lies and how the raster is turned
    cell_size_m : edge of a cell [m]
    """

    def __init__(self, frame: PlaneFrame, cell_size_m: float) -> None:
        self.frame = frame
        self.cell_size_m = cell_size_m
        self.n_covered = 0
        self._per_metre = 1.0 / cell_size_m
        self._low = np.zeros(2, np.int64)
        self._counts = np.zeros((0, 0), np.uint16)
        self._rows = np.zeros(0, np.int32)
        self._columns = np.zeros(0, np.int32)

    # -- change -------------------------------------------------------------------------------------------
    def add(self, points: Array) -> None:
        """Cover the cells of samples (N ≥ 1, 3) [m]."""
        self._reserve(*kernels.bounds(points, self.frame.rows, self._per_metre))
        self._cover(points, 1)

    def remove(self, points: Array) -> None:
        """Take away samples (N, 3) [m] that were added before."""
        self._cover(points, -1)

    def _cover(self, points: Array, sign: int) -> None:
        self.n_covered += kernels.cover(
            self._counts, self._rows, self._columns, self._low, points, self.frame.rows, self._per_metre, sign
        )

    def _cells(self, points: Array) -> NDArray[np.int64]:
        cell = np.empty((len(points), 2), np.int64)
        kernels.find_cells(cell, points, self.frame.rows, self._per_metre)
        return cell

    def _reserve(self, u0: int, u1: int, v0: int, v1: int) -> None:
        """Make the raster hold the cells from (u0, v0) to (u1, v1)."""
        (nu, nv), (low_u, low_v) = self._counts.shape, self._low.tolist()
        if low_u <= u0 and u1 < low_u + nu and low_v <= v0 and v1 < low_v + nv:
            return
        first_u, new_u = _grown(low_u, nu, u0, u1)
        first_v, new_v = _grown(low_v, nv, v0, v1)
        counts, at_u, at_v = np.zeros((new_u, new_v), np.uint16), low_u - first_u, low_v - first_v
        rows, columns = np.zeros(new_u, np.int32), np.zeros(new_v, np.int32)
        if nu:
            counts[at_u : at_u + nu, at_v : at_v + nv] = self._counts
            rows[at_u : at_u + nu], columns[at_v : at_v + nv] = self._rows, self._columns
        self._counts, self._rows, self._columns = counts, rows, columns
        self._low = np.array([first_u, first_v])

    # -- what is covered ----------------------------------------------------------------------------------
    def area_m2(self, normal: Array) -> float:
        """Area [m²] of the covered cells on a plane with this normal."""
        return float(self.n_covered * self.cell_size_m**2 / max(abs(float(self.frame.normal @ normal)), 0.1))

    def extent(self) -> NDArray[np.float64]:
        """[[u low, u high], [v low, v high]] [m] of what is covered, without stray rows and columns."""
        ends = np.empty((2, 2))
        kernels.extent(ends[0], self._rows, self._low[0], _TRIM)
        kernels.extent(ends[1], self._columns, self._low[1], _TRIM)
        return ends * self.cell_size_m

    def bound(self, low: Array, high: Array, extent: Array, normal: Array, offset: float) -> None:
        """Write the axis-aligned box low, high (3,) [m] of the rectangle `extent` (2, 2) [m] on the plane normal·p =
        offset."""
        kernels.bound_rectangle(low, high, extent, self.frame.rows, self.frame.normal, normal, offset)

    def near(self, uv: Array, reach_m: float) -> NDArray[np.bool_]:
        """(N,) whether a covered cell lies within `reach_m` (along u and v, a cell at least) of places (N, 2) [m]."""
        hit = np.empty(len(uv), dtype=np.bool_)
        cell = np.floor(uv / self.cell_size_m).astype(np.int64) - self._low
        kernels.covered_near(hit, self._counts, cell, self._cells_in(reach_m))
        return hit

    def near_plane(
        self, points: Array, normal: Array, offset: float, reach_m: float, height_m: float
    ) -> NDArray[np.bool_]:
        """(N,) which points (N, 3) [m] are within `height_m` of the plane normal·p = offset and project to within
        `reach_m` of a covered cell."""
        hit = np.empty(len(points), dtype=np.bool_)
        kernels.near_plane(
            hit, points, self._counts, self._low, self.frame.rows, normal, offset, self._per_metre,
            self._cells_in(reach_m), height_m,
        )  # fmt: skip
        return hit

    def count_crossings(
        self, crossed: NDArray[np.int64], p: Array, q: Array, normal: Array, offset: float, reach_m: float
    ) -> None:
        """Add one to `crossed` (N,), in place, for each segment from p to q (N, 3) [m] that passes through the plane
        normal·p = offset within `reach_m` of a covered cell."""
        kernels.count_crossings(
            crossed, p, q, self._counts, self._low, self.frame.rows, normal, offset, self._per_metre,
            self._cells_in(reach_m),
        )  # fmt: skip

    def seen_along(
        self, n: int, begin: Array, step: Array, heights: Array, half: Array, normal: Array, offset: float,
        reach_m: float,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """(n,) whether the plane normal·p = offset is covered at one of the heights (H,) over places of the ground; see
        `kernels.rasters.seen_along`."""
        seen = np.empty(n, dtype=np.bool_)
        kernels.seen_along(
            seen, begin, step, heights, half, self._counts, self._low, self.frame.rows, normal, offset,
            self._per_metre, self._cells_in(reach_m),
        )  # fmt: skip
        return seen

    def _cells_in(self, reach_m: float) -> int:
        return max(1, round(reach_m / self.cell_size_m))

    def parts(self, reach_m: float) -> tuple[int, NDArray[np.int32], int]:
        """The parts of what is covered that lie more than `reach_m` (at most twice that) from each other: how many, the
        part of each coarse cell (from 1; 0: none), and the edge of a coarse cell in cells; see `part_of`."""
        stride = self._cells_in(reach_m)
        u, v = (-(-n // stride) for n in self._counts.shape)
        coarse = np.zeros((u, v), np.bool_)
        kernels.coarsen(coarse, self._counts, stride)
        labels, n = ndimage.label(coarse, structure=np.ones((3, 3)))
        return int(n), labels.astype(np.int32), stride

    def part_of(self, points: Array, labels: NDArray[np.int32], stride: int) -> NDArray[np.int32]:
        """The part (N,) that each covered sample (N, 3) [m] belongs to, from `parts`."""
        cell = (self._cells(points) - self._low) // stride
        return np.asarray(labels[cell[:, 0], cell[:, 1]])

    def centres(self, at_most: int) -> Array:
        """(N, 2) [m] centres of covered cells, thinned to a coarser grid of some `at_most` cells."""
        stride = max(1, int(np.ceil(np.sqrt(self.n_covered / at_most))))
        u, v = np.nonzero(self._counts[::stride, ::stride])
        return (np.stack([u, v], axis=1) * stride + self._low + 0.5) * self.cell_size_m

    def shape(self, least_m2: float, tolerance_m: float) -> Any:
        """What is covered as a shapely (multi)polygon in u, v [m]: gaps of one cell closed, borders simplified to
        `tolerance_m`, holes below `least_m2` filled, and parts below it left out, but for the largest part."""
        span = np.empty((2, 2), np.int64)
        kernels.extent(span[0], self._rows, 0, 0.0)
        kernels.extent(span[1], self._columns, 0, 0.0)
        (u0, u1), (v0, v1) = span.tolist()
        mask = np.empty((u1 - u0 + 6, v1 - v0 + 6), np.bool_)
        kernels.close_gaps(mask, self._counts[u0:u1, v0:v1])
        edges = sum(int(np.count_nonzero(mask[1:] != mask[:-1])) for mask in (mask, mask.T))
        corners = np.empty((edges, 2), np.int32)
        ends = np.empty(edges, np.int64)
        n = kernels.trace(mask, corners, ends)
        area = np.empty(n)
        kernels.ring_areas(area, corners, ends)
        large = np.abs(area) * self.cell_size_m**2 >= least_m2
        large[area.argmax()] = True
        origin = self._low + np.array([u0 - 3, v0 - 3])
        rings = [(ring + origin) * self.cell_size_m for ring in np.split(corners, ends[:n])[:n]]
        owner = np.empty(n, np.int64)
        kernels.nest(owner, area, large, corners, ends)
        outer = np.flatnonzero(large & (area > 0.0)).tolist()
        parts = [shapely.Polygon(rings[k], [rings[h] for h in np.flatnonzero(owner == k)]) for k in outer]
        whole = parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)
        return whole.simplify(tolerance_m)


def _grown(first: int, n: int, low: int, high: int) -> tuple[int, int]:
    """Where a line of `n` cells from `first` on begins and how long it is once it holds low … high, with room to spare
    where it grew."""
    spare = max(8, n // 2)
    if n == 0:
        first, end = low, high + 1 + spare
    else:
        end = first + n if high < first + n else high + 1 + spare
    first = first if low >= first else low - spare
    return first, end - first
