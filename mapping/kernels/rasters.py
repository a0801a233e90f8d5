"""Rasters of covered cells, as counts of the samples in each: fill, look up, trace the border."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


@njit(cache=True, inline="always")
def cell_of(point: Array, frame: Array, per_metre: float) -> tuple[int, int]:
    """The raster cell that a point (3,) [m] projects to; `frame` (3, 3) has the rows origin, u and v."""
    x, y, z = point[0] - frame[0, 0], point[1] - frame[0, 1], point[2] - frame[0, 2]
    u = (x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2]) * per_metre
    v = (x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2]) * per_metre
    return int(np.floor(u)), int(np.floor(v))


@njit(cache=True)
def find_cells(cell: Array, points: Array, frame: Array, per_metre: float) -> None:
    """The raster cell (N, 2) int64 that each point (N, 3) [m] projects to, in place; see `cell_of`."""
    for i in range(len(points)):
        cell[i, 0], cell[i, 1] = cell_of(points[i], frame, per_metre)


@njit(cache=True)
def bounds(points: Array, frame: Array, per_metre: float) -> tuple[int, int, int, int]:
    """The lowest and the highest u, the lowest and the highest v of the cells of points (N ≥ 1, 3); see `cell_of`."""
    u0, v0 = cell_of(points[0], frame, per_metre)
    u1, v1 = u0, v0
    for i in range(1, len(points)):
        u, v = cell_of(points[i], frame, per_metre)
        u0, u1 = min(u0, u), max(u1, u)
        v0, v1 = min(v0, v), max(v1, v)
    return u0, u1, v0, v1


@njit(cache=True)
def extent(ends: Array, line: Array, first: int, trim: float) -> None:
    """The first cell (of which that of `line` (n,) int32, covered cells of each, is `first`) with more than the share
    `trim` of the fullest, and one past the last, in place (2,); none are `first` and `first`."""
    most = 0
    for n in line:
        most = max(most, n)
    ends[0] = ends[1] = first
    found = False
    for i in range(len(line)):
        if line[i] > trim * most:
            if not found:
                ends[0] = first + i
                found = True
            ends[1] = first + i + 1


@njit(cache=True)
def bound_rectangle(
    low: Array, high: Array, ends: Array, frame: Array, axis: Array, normal: Array, offset: float
) -> None:
    """The axis-aligned box low, high (3,) [m] of a rectangle of the plane normal·p = offset, in place.

    ends  : (2, 2) [m] of the rectangle along u and v of `frame`, (3, 3) rows origin, u, v
    axis  : (3,) along which the frame is lifted to the plane
    """
    low[:], high[:] = np.inf, -np.inf
    slope = axis[0] * normal[0] + axis[1] * normal[1] + axis[2] * normal[2]
    for corner in range(4):
        u, v = ends[0, corner & 1], ends[1, corner >> 1]
        along = offset
        for a in range(3):
            along -= (frame[0, a] + u * frame[1, a] + v * frame[2, a]) * normal[a]
        along /= slope
        for a in range(3):
            x = frame[0, a] + u * frame[1, a] + v * frame[2, a] + along * axis[a]
            low[a], high[a] = min(low[a], x), max(high[a], x)


@njit(cache=True)
def cover(
    counts: Array, rows: Array, columns: Array, lowest: Array, points: Array, frame: Array, per_metre: float, sign: int
) -> int:
    """Add (`sign` 1) or take away (−1) samples from a raster's cells, in place; returns the change in covered cells.

    counts  : (U, V) uint16 samples per cell, of which the first is cell `lowest` (2,)
    rows    : (U,) int32, columns : (V,) int32, covered cells per row and column
    points  : (N, 3) [m], in cells of the raster; see `cell_of`
    """
    change = 0
    for i in range(len(points)):
        u, v = cell_of(points[i], frame, per_metre)
        u -= lowest[0]
        v -= lowest[1]
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
def close_gaps(mask: Array, counts: Array) -> None:
    """The covered cells of `counts` (U, V), and those between them that no 3 × 3 cells without a covered one hold (the
    morphological closing), in place, with a margin of three cells: mask (U + 6, V + 6) bool."""
    width, height = mask.shape
    grown = np.zeros((width, height), np.bool_)
    mask[:] = False
    for u in range(counts.shape[0]):
        for v in range(counts.shape[1]):
            if counts[u, v]:
                mask[u + 2 : u + 5, v + 3] = True
    for u in range(width):
        for v in range(1, height - 1):
            grown[u, v] = mask[u, v - 1] or mask[u, v] or mask[u, v + 1]
    for u in range(width):
        for v in range(1, height - 1):
            mask[u, v] = grown[u, v - 1] and grown[u, v] and grown[u, v + 1]
    for v in range(height):
        before = False
        for u in range(width - 1):
            here = mask[u, v]
            mask[u, v] = before and here and mask[u + 1, v]
            before = here


@njit(cache=True)
def _close(corners: Array, n: int, ring: Array, first: int, length: int, index_of: Array) -> int:
    """Append ring[first:length] to the `n` corners, and forget where its corners are; returns how many there are."""
    for i in range(first, length):
        corners[n + i - first] = ring[i]
        index_of[ring[i, 0], ring[i, 1]] = -1
    return n + length - first


@njit(cache=True)
def trace(mask: Array, corners: Array, ring_end: Array) -> int:
    """The borders of the covered cells as rings of grid corners, in place; returns how many rings.

    Covered cells are on the left: outer rings run counter-clockwise, holes clockwise. Cells that touch in a corner
    only are kept apart, and a border that comes to a corner twice is cut into two rings there: no ring meets itself.
    Only corners where the border turns are listed.

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
    index_of = np.full((width, height), -1, np.int32)  # of the ring being traced, where in `ring` each corner is
    ring = np.empty_like(corners)
    n, rings = 0, 0
    for start_u in range(width):
        for start_v in range(1, height):
            if not mask[start_u, start_v] or mask[start_u, start_v - 1] or visited[start_u, start_v]:
                continue
            u, v, way = start_u, start_v, 0
            length = 0
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
                if way == before:
                    continue
                if index_of[u, v] >= 0:
                    first = index_of[u, v]
                    n = _close(corners, n, ring, first, length, index_of)
                    ring_end[rings] = n
                    rings += 1
                    length = first
                ring[length, 0], ring[length, 1] = u, v
                index_of[u, v] = length
                length += 1
            if length:
                n = _close(corners, n, ring, 0, length, index_of)
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


@njit(cache=True)
def nest(owner: Array, area: Array, large: Array, corners: Array, ring_end: Array) -> None:
    """The outer ring about each hole that is `large` (R,) bool: the smallest such; owner (R,) int64, in place, −1 for
    other rings. Rings as `trace` found them, areas as `ring_areas` did."""
    owner[:] = -1
    for hole in range(len(area)):
        if not large[hole] or area[hole] >= 0.0:
            continue
        begin = ring_end[hole - 1] if hole else 0
        # beside the first border of the hole, where no border is: both its sides lie within the outer ring
        x = 0.5 * (corners[begin, 0] + corners[begin + 1, 0]) + 0.25
        y = 0.5 * (corners[begin, 1] + corners[begin + 1, 1]) + 0.25
        for outer in range(len(area)):
            if not large[outer] or area[outer] <= 0.0 or (owner[hole] >= 0 and area[outer] > area[owner[hole]]):
                continue
            first = ring_end[outer - 1] if outer else 0
            last = ring_end[outer] - 1
            inside = False
            for i in range(first, ring_end[outer]):
                a, b = corners[last], corners[i]
                if (a[1] > y) != (b[1] > y) and a[0] > x:  # borders run along the axes
                    inside = not inside
                last = i
            if inside:
                owner[hole] = outer
