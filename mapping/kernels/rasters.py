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


@njit(cache=True)
def covered_near(hit: Array, counts: Array, cell: Array, reach: int) -> None:
    """Whether a covered cell of `counts` (U, V) lies within `reach` cells of each `cell` (N, 2): hit (N,), in place."""
    width, height = counts.shape
    for i in range(len(cell)):
        hit[i] = False
        for u in range(max(0, cell[i, 0] - reach), min(width, cell[i, 0] + reach + 1)):
            for v in range(max(0, cell[i, 1] - reach), min(height, cell[i, 1] + reach + 1)):
                if counts[u, v] > 0:
                    hit[i] = True
                    break
            if hit[i]:
                break


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
