"""What bodies touch in a distance field, voxel by voxel: columns of voxels under a sphere or a standing prism."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

FREE, COLLIDES, UNKNOWN = 1, 0, -1
_SKIN = 1e-6
"""Bodies that share no more than this [voxels] with a voxel do not touch it: they may stand on a floor."""
_HALF_DIAGONAL = 0.8660254037844386


@njit(cache=True)
def stored_at(table: Array, distance: Array, i: Int, j: Int, k: Int) -> Float:
    """The distance of voxel (i, j, k), NaN where there is none."""
    slot = lookup(table, i >> 3, j >> 3, k >> 3)
    return distance[slot, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] if slot >= 0 else np.float32(np.nan)


@njit(cache=True)
def scan_column(
    table: Array, distance: Array, i: Int, j: Int, low: Int, high: Int, least: Float, unknown: bool, at: Array
) -> tuple[Float, bool]:
    """The smaller of `least` and the distances of voxels (i, j, low … high), and whether one of them is unknown or
    `unknown` was true. Fills at (3,) with the voxel of the smallest, or the first unknown one while none collides."""
    k = low
    while k <= high:
        end = min(high, k | 7)
        slot = lookup(table, i >> 3, j >> 3, k >> 3)
        row = (i & 7) << 6 | (j & 7) << 3
        for z in range(k, end + 1):
            value = distance[slot, row | (z & 7)] if slot >= 0 else np.float32(np.nan)
            if np.isnan(value):
                if not unknown and least > 0.0:
                    at[0], at[1], at[2] = i, j, z
                unknown = True
            elif value < least:
                least = value
                if not unknown or value <= 0.0:
                    at[0], at[1], at[2] = i, j, z
        k = end + 1
    return least, unknown


@njit(cache=True)
def judge(least: Float, unknown: bool) -> Int:
    """What a body does that touches voxels of these distances."""
    if least <= 0.0:
        return COLLIDES
    return UNKNOWN if unknown else FREE


@njit(cache=True, parallel=True)
def check_spheres(
    table: Array, distance: Array, voxel_size: Float, exact_below: Float, centres: Array, radii: Array, verdicts: Array
) -> None:
    """Whether spheres about centres (n, 3) with radii (n,) [m] are free; fills verdicts (n,) int8.

    exact_below : distances below this [m] lead exactly from a voxel's centre to that of an occupied one, but for half a
                  voxel, so that one look is often enough
    """
    bound = 4.0 * BLOCK_LIMIT
    for n in prange(centres.shape[0]):
        x, y, z = centres[n, 0] / voxel_size, centres[n, 1] / voxel_size, centres[n, 2] / voxel_size
        r = radii[n] / voxel_size - _SKIN
        verdicts[n] = UNKNOWN
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound and r < bound):  # also NaN
            continue
        middle = stored_at(table, distance, np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z)))
        if middle < 0.0 or (middle < exact_below and middle / voxel_size + 0.5 + _HALF_DIAGONAL < r):
            verdicts[n] = COLLIDES
            continue
        least, unknown = np.inf, False
        at = np.empty(3, np.int64)
        for i in range(np.int64(np.floor(x - r)), np.int64(np.floor(x + r)) + 1):
            across_x = max(i - x, x - (i + 1), 0.0)
            for j in range(np.int64(np.floor(y - r)), np.int64(np.floor(y + r)) + 1):
                across = max(j - y, y - (j + 1), 0.0) ** 2 + across_x**2
                if across > r * r:
                    continue
                up = np.sqrt(r * r - across)
                low, high = np.int64(np.floor(z - up)), np.int64(np.floor(z + up))
                least, unknown = scan_column(table, distance, i, j, low, high, least, unknown, at)
                if least <= 0.0:
                    break
            if least <= 0.0:
                break
        verdicts[n] = judge(least, unknown)


@njit(cache=True)
def meet_strip(corners: Array, left: Float, right: Float) -> tuple[Float, Float]:
    """The range of y of a convex polygon (k, 2) where left ≤ x ≤ right; inf, −inf where it is not there."""
    low, high = np.inf, -np.inf
    last = corners.shape[0] - 1
    for n in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[last, 0], corners[last, 1], corners[n, 0], corners[n, 1]
        last = n
        if left <= x1 <= right:
            low, high = min(low, y1), max(high, y1)
        for border in (left, right):
            if (x0 < border) != (x1 < border):
                y = y0 + (y1 - y0) * (border - x0) / (x1 - x0)
                low, high = min(low, y), max(high, y)
    return low, high


@njit(cache=True, parallel=True)
def check_prisms(
    table: Array,
    distance: Array,
    voxel_size: Float,
    corners: Array,
    first_of: Array,
    height: Float,
    poses: Array,
    verdicts: Array,
    least: Array,
    where: Array,
) -> None:
    """What a standing prism touches in each of its poses.

    corners   : (k, 2) [m, frame of the body] of convex parts of the ground plan; part p is first_of[p] :
                first_of[p + 1]
    height    : from the pose's z upward [m]
    poses     : (n, 4) x, y, z [m] and yaw [rad]
    verdicts  : (n,) int8, least (n,) [m] the smallest distance of a voxel that is touched (inf: none is known), where
                (n, 3) int64 that voxel, or an unknown one where none collides; filled
    """
    bound = 4.0 * BLOCK_LIMIT
    for n in prange(poses.shape[0]):
        c, s = np.cos(poses[n, 3]), np.sin(poses[n, 3])
        x, y, z = poses[n, 0] / voxel_size, poses[n, 1] / voxel_size, poses[n, 2] / voxel_size
        verdicts[n], least[n] = UNKNOWN, np.inf
        where[n, :] = 0
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):
            continue
        low_z, high_z = np.int64(np.floor(z + _SKIN)), np.int64(np.ceil(z + height / voxel_size - _SKIN)) - 1
        smallest, unknown = np.inf, False
        turned = np.empty_like(corners)
        for k in range(corners.shape[0]):
            a, b = corners[k, 0] / voxel_size, corners[k, 1] / voxel_size
            turned[k, 0], turned[k, 1] = x + c * a - s * b, y + s * a + c * b
        for part in range(first_of.shape[0] - 1):
            plan = turned[first_of[part] : first_of[part + 1]]
            first, last = plan[:, 0].min() + _SKIN, plan[:, 0].max() - _SKIN
            for i in range(np.int64(np.floor(first)), np.int64(np.ceil(last))):
                left, right = max(np.float64(i), first), min(i + 1.0, last)
                low, high = meet_strip(plan, left, right)
                for j in range(np.int64(np.floor(low + _SKIN)), np.int64(np.ceil(high - _SKIN))):
                    smallest, unknown = scan_column(table, distance, i, j, low_z, high_z, smallest, unknown, where[n])
        verdicts[n], least[n] = judge(smallest, unknown), smallest
