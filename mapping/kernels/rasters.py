"""Rasters of covered cells, as counts of the samples in each: fill, look up, trace the border."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


@njit(cache=True)
def find_cells(cell: Array, points: Array, origin: Array, u: Array, v: Array, per_metre: float) -> None:
    """The raster cell (N, 2) int64 that each point (N, 3) [m] projects to, in place."""
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        cell[i, 0] = np.int64(np.floor((x * u[0] + y * u[1] + z * u[2]) * per_metre))
        cell[i, 1] = np.int64(np.floor((x * v[0] + y * v[1] + z * v[2]) * per_metre))


@njit(cache=True)
def bounds(cell: Array, low: Array, high: Array) -> None:
    """Lowest and highest cell of (N, 2), in place."""
    low[:] = cell[0]
    high[:] = cell[0]
    for i in range(1, len(cell)):
        for a in range(2):
            low[a] = min(low[a], cell[i, a])
            high[a] = max(high[a], cell[i, a])


@njit(cache=True)
def cover(counts: Array, rows: Array, columns: Array, cell: Array, lowest: Array, sign: int) -> int:
    """Add (`sign` 1) or take away (−1) samples from a raster's cells, in place; returns the change in covered cells.

    counts  : (U, V) uint16 samples per cell, of which the first is cell `lowest` (2,)
    rows    : (U,) int32, columns : (V,) int32, covered cells per row and column
    cell    : (N, 2) int64
    """
    change = 0
    for i in range(len(cell)):
        u, v = cell[i, 0] - lowest[0], cell[i, 1] - lowest[1]
        before = counts[u, v]
        if sign > 0:
            if before < 65535:
                counts[u, v] = before + 1
            if before == 0:
                rows[u] += 1
                columns[v] += 1
                change += 1
        elif before > 0:
            counts[u, v] = before - 1
            if before == 1:
                rows[u] -= 1
                columns[v] -= 1
                change -= 1
    return change


@njit(cache=True, inline="always")
def _covered(counts: Array, u: int, v: int, reach: int) -> bool:
    """Whether a covered cell of `counts` (U, V) lies within `reach` cells of cell u, v."""
    for a in range(max(0, u - reach), min(counts.shape[0], u + reach + 1)):
        for b in range(max(0, v - reach), min(counts.shape[1], v + reach + 1)):
            if counts[a, b] > 0:
                return True
    return False


@njit(cache=True)
def covered_near(hit: Array, counts: Array, cell: Array, reach: int) -> None:
    """Whether a covered cell of `counts` (U, V) lies within `reach` cells of each `cell` (N, 2): hit (N,), in place."""
    for i in range(len(cell)):
        hit[i] = _covered(counts, cell[i, 0], cell[i, 1], reach)


@njit(cache=True)
def near_plane(
    hit: Array, points: Array, counts: Array, lowest: Array, axes: Array, normal: Array, offset: float,
    per_cell: float, reach: int, height: float,
) -> None:  # fmt: skip
    """Which points (N, 3) [m] lie within `height` [m] of a plane and project to within `reach` cells of a covered one.

    hit    : (N,) bool, in place
    axes   : (3, 3) origin, u and v of the raster [m], whose cell (0, 0) is `lowest` (2,);  per_cell : 1 / edge [1/m]
    normal : (3,), and offset [m], of the plane
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        hit[i] = abs(x * normal[0] + y * normal[1] + z * normal[2] - offset) <= height and _at(
            counts, lowest, axes, per_cell, reach, x, y, z
        )


@njit(cache=True)
def count_crossings(
    crossed: Array, p: Array, q: Array, counts: Array, lowest: Array, axes: Array, normal: Array, offset: float,
    per_cell: float, reach: int,
) -> None:  # fmt: skip
    """Add one, in place, to `crossed` (N,) for each segment from p to q (N, 3) [m] that passes through a plane within
    `reach` cells of a covered one; a segment that ends on the plane does not. The rest as in `near_plane`."""
    for i in range(len(p)):
        a = p[i, 0] * normal[0] + p[i, 1] * normal[1] + p[i, 2] * normal[2] - offset
        b = q[i, 0] * normal[0] + q[i, 1] * normal[1] + q[i, 2] * normal[2] - offset
        if a * b < 0.0:
            s = a / (a - b)
            x, y = p[i, 0] + s * (q[i, 0] - p[i, 0]), p[i, 1] + s * (q[i, 1] - p[i, 1])
            z = p[i, 2] + s * (q[i, 2] - p[i, 2])
            crossed[i] += _at(counts, lowest, axes, per_cell, reach, x, y, z)


@njit(cache=True)
def seen_along(
    seen: Array, begin: Array, step: Array, heights: Array, half: Array, counts: Array, lowest: Array, axes: Array,
    normal: Array, offset: float, per_cell: float, reach: int,
) -> None:  # fmt: skip
    """Whether a plane is covered, within `reach` cells, at one of the heights (H,) [m] over places begin + i · step
    (2,) [m] of the ground: seen (N,) bool, in place. Looked at is where the way from `half` (2,) [m] before such a
    place to as far behind it meets the plane. The rest as in `near_plane`."""
    for i in range(len(seen)):
        x, y = begin[0] + i * step[0], begin[1] + i * step[1]
        seen[i] = False
        for z in heights:
            middle = x * normal[0] + y * normal[1] + z * normal[2] - offset
            turn = half[0] * normal[0] + half[1] * normal[1]
            if abs(middle) < abs(turn):
                s = middle / turn
                if _at(counts, lowest, axes, per_cell, reach, x - s * half[0], y - s * half[1], z):
                    seen[i] = True
                    break


@njit(cache=True)
def _at(counts: Array, lowest: Array, axes: Array, per_cell: float, reach: int, x: float, y: float, z: float) -> Any:
    """Whether a point projects to within `reach` cells of a covered one."""
    x, y, z = x - axes[0, 0], y - axes[0, 1], z - axes[0, 2]
    u = np.int64(np.floor((x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) * per_cell)) - lowest[0]
    v = np.int64(np.floor((x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]) * per_cell)) - lowest[1]
    return _covered(counts, u, v, reach)


@njit(cache=True)
def coarsen(coarse: Array, counts: Array, stride: int) -> None:
    """Mark the coarse cells, of `stride`² cells each, that hold a covered cell; `coarse` of zeros, in place."""
    for u in range(counts.shape[0]):
        for v in range(counts.shape[1]):
            if counts[u, v] > 0:
                coarse[u // stride, v // stride] = True


@njit(cache=True)
def trace(mask: Array, corners: Array, ring_end: Array) -> int:
    """The borders of the covered cells as rings of grid corners, in place; returns how many rings.

    Covered cells are on the left: outer rings run counter-clockwise, holes clockwise. Cells that touch in a corner
    only are kept apart. Only corners where the border turns are listed.

    mask     : (U, V) bool, with an uncovered margin of one cell
    corners  : (C, 2) int32 out; ring r is corners[ring_end[r - 1]:ring_end[r]];  ring_end : (R,) int64 out
    """
    width, height = mask.shape
    # ways: 0 +u, 1 +v, 2 −u, 3 −v; `visited` marks borders travelled along +u, by where they begin
    step_u = np.array([1, 0, -1, 0])
    step_v = np.array([0, 1, 0, -1])
    left_u = np.array([0, -1, -1, 0])
    left_v = np.array([0, 0, -1, -1])
    right_u = np.array([0, 0, -1, -1])
    right_v = np.array([-1, 0, 0, -1])
    visited = np.zeros((width, height), np.bool_)
    n, rings = 0, 0
    for start_u in range(width):
        for start_v in range(1, height):
            if not mask[start_u, start_v] or mask[start_u, start_v - 1] or visited[start_u, start_v]:
                continue
            u, v, way = start_u, start_v, 0
            begin = n
            while True:
                if way == 0:
                    if visited[u, v]:
                        break
                    visited[u, v] = True
                u += step_u[way]
                v += step_v[way]
                before = way
                for turn in (1, 0, 3):
                    way = (before + turn) % 4
                    if mask[u + left_u[way], v + left_v[way]] and not mask[u + right_u[way], v + right_v[way]]:
                        break
                if way != before:
                    corners[n, 0] = u
                    corners[n, 1] = v
                    n += 1
            if n > begin:
                ring_end[rings] = n
                rings += 1
    return rings


@njit(cache=True)
def ring_areas(area: Array, corners: Array, ring_end: Array) -> None:
    """Signed area of each ring that `trace` found, counter-clockwise positive; area (R,) float64, in place."""
    begin = 0
    for r in range(len(area)):
        twice = 0
        last = ring_end[r] - 1
        for i in range(begin, ring_end[r]):
            twice += np.int64(corners[last, 0]) * corners[i, 1] - np.int64(corners[i, 0]) * corners[last, 1]
            last = i
        area[r] = 0.5 * twice
        begin = ring_end[r]
