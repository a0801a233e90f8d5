"""Look-ups in a field of signed distances in hashed blocks."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

POINTS = 2048
"""Points that one thread looks up at a time."""
GROUPS = 4096
CELL = 16
"""Edge [voxels] of the cells whose points are looked up together."""


@njit(cache=True)
def read_corners(table: Array, distance: Array, i: Int, j: Int, k: Int, corners: Array) -> bool:
    """The distances of the voxels (i … i + 1, j … j + 1, k … k + 1), fills corners (8,); whether all have a block."""
    slot = lookup(table, i >> 3, j >> 3, k >> 3)
    if slot < 0:
        return False
    x, y, z = i & 7, j & 7, k & 7
    if x < 7 and y < 7 and z < 7:
        stored = distance[slot]
        local = x << 6 | y << 3 | z
        corners[0], corners[1] = stored[local], stored[local + 1]
        corners[2], corners[3] = stored[local + 8], stored[local + 9]
        corners[4], corners[5] = stored[local + 64], stored[local + 65]
        corners[6], corners[7] = stored[local + 72], stored[local + 73]
        return True
    # Along an axis on which the next voxel is in the next block, so is the block of half of the corners.
    bi, bj, bk = i >> 3, j >> 3, k >> 3
    s1 = lookup(table, bi, bj, bk + 1) if z == 7 else slot
    s2 = lookup(table, bi, bj + 1, bk) if y == 7 else slot
    s3 = (lookup(table, bi, bj + 1, bk + 1) if y == 7 else s1) if z == 7 else s2
    s4, s5, s6, s7 = slot, s1, s2, s3
    if x == 7:
        s4 = lookup(table, bi + 1, bj, bk)
        s5 = lookup(table, bi + 1, bj, bk + 1) if z == 7 else s4
        s6 = lookup(table, bi + 1, bj + 1, bk) if y == 7 else s4
        s7 = (lookup(table, bi + 1, bj + 1, bk + 1) if y == 7 else s5) if z == 7 else s6
    if min(min(s1, s2), min(s3, s4)) < 0 or min(s5, min(s6, s7)) < 0:
        return False
    x0, x1 = x << 6, ((x + 1) & 7) << 6
    y0, y1 = y << 3, ((y + 1) & 7) << 3
    z1 = (z + 1) & 7
    corners[0], corners[1] = distance[slot, x0 | y0 | z], distance[s1, x0 | y0 | z1]
    corners[2], corners[3] = distance[s2, x0 | y1 | z], distance[s3, x0 | y1 | z1]
    corners[4], corners[5] = distance[s4, x1 | y0 | z], distance[s5, x1 | y0 | z1]
    corners[6], corners[7] = distance[s6, x1 | y1 | z], distance[s7, x1 | y1 | z1]
    return True


@njit(cache=True)
def interpolate_some(
    table: Array,
    distance: Array,
    voxel_size: Float,
    p_map: Array,
    first: Int,
    last: Int,
    values: Array,
    gradients: Array,
) -> None:
    """Trilinear distance (n,) [m] and its gradient (n, 3) at the points (n, 3) [m] from `first` to before `last`, in
    place; NaN where one of the eight voxels about it is unknown. gradients may have no rows: then there are none."""
    per_voxel = 1.0 / voxel_size
    bound = 8.0 * BLOCK_LIMIT - 2.0
    c = np.empty(8, np.float64)
    for n in range(first, last):
        x, y, z = p_map[n, 0] * per_voxel - 0.5, p_map[n, 1] * per_voxel - 0.5, p_map[n, 2] * per_voxel - 0.5
        found = False
        if abs(x) < bound and abs(y) < bound and abs(z) < bound:  # not NaN either
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            found = read_corners(table, distance, i, j, k, c)
            x, y, z = x - i, y - j, z - k
        if not found:
            values[n] = np.nan
            if gradients.shape[0]:
                gradients[n, 0] = gradients[n, 1] = gradients[n, 2] = np.nan
            continue
        # Along z, then y, then x.
        z00, z01, z10, z11 = c[1] - c[0], c[3] - c[2], c[5] - c[4], c[7] - c[6]
        v00, v01, v10, v11 = c[0] + z * z00, c[2] + z * z01, c[4] + z * z10, c[6] + z * z11
        v0, v1 = v00 + y * (v01 - v00), v10 + y * (v11 - v10)
        values[n] = v0 + x * (v1 - v0)
        if gradients.shape[0]:
            gradients[n, 0] = (v1 - v0) * per_voxel
            gradients[n, 1] = ((1.0 - x) * (v01 - v00) + x * (v11 - v10)) * per_voxel
            along_z = (1.0 - x) * ((1.0 - y) * z00 + y * z01) + x * ((1.0 - y) * z10 + y * z11)
            gradients[n, 2] = along_z * per_voxel


@njit(cache=True)
def sort_by_place(p_map: Array, cell_size: Float, order: Array) -> None:
    """Order points (n, 3) [m] so that those of one cell of the map follow each other: fills order (n,) int32.

    Points that are far apart may fall into one group, too: it is not an order of cells, but one that the cache likes.
    """
    per_cell = 1.0 / cell_size
    n_points = p_map.shape[0]
    group = np.empty(n_points, np.int32)
    start = np.zeros(GROUPS + 1, np.int64)
    for n in range(n_points):
        x, y, z = p_map[n, 0] * per_cell, p_map[n, 1] * per_cell, p_map[n, 2] * per_cell
        group[n] = 0
        if abs(x) < BLOCK_LIMIT and abs(y) < BLOCK_LIMIT and abs(z) < BLOCK_LIMIT:  # not NaN either
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            group[n] = (i * 73856093 ^ j * 19349669 ^ k * 83492791) & (GROUPS - 1)
        start[group[n] + 1] += 1
    for g in range(GROUPS):
        start[g + 1] += start[g]
    for n in range(n_points):
        order[start[group[n]]] = n
        start[group[n]] += 1


@njit(cache=True, parallel=True)
def interpolate(
    table: Array, distance: Array, voxel_size: Float, p_map: Array, order: Array, values: Array, gradients: Array
) -> None:
    """`interpolate_some` for all points in the given order (n,), many at a time."""
    n_points = p_map.shape[0]
    with_gradient = gradients.shape[0] > 0
    for part in prange((n_points + POINTS - 1) // POINTS):
        first, last = part * POINTS, min((part + 1) * POINTS, n_points)
        points, found = np.empty((POINTS, 3)), np.empty(POINTS)
        slopes = np.empty((POINTS if with_gradient else 0, 3))
        for m in range(first, last):
            for axis in range(3):
                points[m - first, axis] = p_map[order[m], axis]
        interpolate_some(table, distance, voxel_size, points, 0, last - first, found, slopes)
        for m in range(first, last):
            values[order[m]] = found[m - first]
            if with_gradient:
                for axis in range(3):
                    gradients[order[m], axis] = slopes[m - first, axis]
