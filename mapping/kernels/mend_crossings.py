"""Distances of hashed blocks made right where the surfaces of signed distances moved."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup
from mapping.kernels.nearest import find_nearest
from mapping.kernels.sites import BEHIND
from mapping.kernels.surface import slope

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


@njit(cache=True)
def value_at(table: Array, distance: Array, weight: Array, i: Int, j: Int, k: Int) -> Float:
    """The signed distance of voxel (i, j, k); NaN where unknown."""
    slot = lookup(table, i >> 3, j >> 3, k >> 3)
    local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
    return distance[slot, local] if slot >= 0 and weight[slot, local] > np.float32(0.0) else np.float32(np.nan)


@njit(cache=True, error_model="numpy")
def find_foot(table: Array, distance: Array, weight: Array, i: Int, j: Int, k: Int, foot: Array) -> None:
    """The way [voxels] from a site to its surface, taken as the plane that its distance and gradient give; fills foot
    (3,)."""
    here = value_at(table, distance, weight, i, j, k)
    g0 = slope(
        value_at(table, distance, weight, i - 1, j, k), here, value_at(table, distance, weight, i + 1, j, k), np.inf
    )
    g1 = slope(
        value_at(table, distance, weight, i, j - 1, k), here, value_at(table, distance, weight, i, j + 1, k), np.inf
    )
    g2 = slope(
        value_at(table, distance, weight, i, j, k - 1), here, value_at(table, distance, weight, i, j, k + 1), np.inf
    )
    norm = max(np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), 1e-12)
    length = min(abs(here) / norm, 1.0) / norm  # a site is within one voxel of its surface
    length = -length if here >= np.float32(0.0) else length
    foot[0], foot[1], foot[2] = length * g0, length * g1, length * g2


@njit(cache=True)
def mend_block(
    distance: Array,
    reach: Array,
    planes: Array,
    table: Array,
    near: Array,
    weight: Array,
    far: Int,
    voxel_size: Float,
    truncation: Float,
    grid: Array,
    first: Array,
    offsets: Array,
    cell: Array,
) -> bool:
    """`mend_from_crossings` for the block at `cell` (3,); whether it changed."""
    at = (cell[0], cell[1], cell[2])
    slot = grid[at]
    i0, j0, k0 = first[0] + cell[0], first[1] + cell[1], first[2] + cell[2]
    source = lookup(table, i0, j0, k0)
    i0, j0, k0 = 8 * i0, 8 * j0, 8 * k0
    squared, nearest = np.empty(512, np.int32), np.empty(512, np.int32)
    wanted = np.empty(512, np.bool_)
    known_feet, feet = np.full(256, -1, np.int32), np.empty((256, 3), np.float64)
    different = False
    for plane in range(2):
        side = -1.0 if plane == BEHIND else 1.0
        for w in range(512):
            wanted[w] = ((near[source, w] < 0.0) == (plane == BEHIND)) & (weight[source, w] > 0.0)
        find_nearest(planes, plane, grid, at, offsets, far, wanted, squared, nearest)
        top = np.int32(0)
        for w in range(512):
            if not wanted[w]:
                continue
            top = max(top, squared[w])
            new = truncation
            if squared[w] < far:
                s0, s1, s2 = (nearest[w] >> 20) - 512, (nearest[w] >> 10 & 1023) - 512, (nearest[w] & 1023) - 512
                row = (nearest[w] ^ nearest[w] >> 9 ^ nearest[w] >> 17) & 255
                if known_feet[row] != nearest[w]:
                    known_feet[row] = nearest[w]
                    find_foot(table, near, weight, i0 + s0, j0 + s1, k0 + s2, feet[row])
                d0 = (w >> 6) - s0 - feet[row, 0]
                d1 = ((w >> 3) & 7) - s1 - feet[row, 1]
                d2 = (w & 7) - s2 - feet[row, 2]
                new = min(np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) * voxel_size, truncation)
            rounded = np.float32(side * new)
            different |= distance[slot, w] != rounded
            distance[slot, w] = rounded
        reach[slot, plane] = top
    for w in range(512):
        if not weight[source, w] > 0.0:
            different |= not np.isnan(distance[slot, w])
            distance[slot, w] = np.nan
    return different


@njit(cache=True, parallel=True)
def mend_from_crossings(
    distance: Array,
    reach: Array,
    planes: Array,
    table: Array,
    near: Array,
    weight: Array,
    far: Int,
    voxel_size: Float,
    truncation: Float,
    grid: Array,
    first: Array,
    offsets: Array,
    targets: Array,
    changed: Array,
) -> None:
    """Work out the distances of blocks anew after surfaces moved, in place.

    distance   : (capacity, 512) float32 [m]: positive before surfaces, negative behind them, NaN where unknown
    reach      : (capacity, 2) int32, written: the largest squared distance to a site BEFORE, to one BEHIND
    planes     : (capacity, 2, 8) uint64, bits of BEFORE and BEHIND
    table, near, weight : the source's hash, signed distances [m] and weights, 0 where unknown
    far        : sites at this squared distance or beyond are none
    grid, offsets                see `mapping.kernels.nearest.find_nearest`; first (3,) is the block of the first cell
    targets    : (m, 3) int64 cells of the grid
    changed    : (m,) bool, filled: whether a distance changed
    """
    for t in prange(targets.shape[0]):
        changed[t] = mend_block(
            distance, reach, planes, table, near, weight, far, voxel_size, truncation, grid, first, offsets, targets[t]
        )
