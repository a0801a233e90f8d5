"""Exact Euclidean distances in a dense box, up to a cap, and their way in and out of hashed blocks.

The transform is separable: nearest site along z, then lower envelopes of parabolas along y and x (Felzenszwalb &
Huttenlocher, Distance Transforms of Sampled Functions, 2012). It carries the nearest site along, so that the surface
may lie between voxels.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup
from mapping.kernels.surface import slope

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

FAR = 1 << 28
"""Squared distance [voxels²] of a voxel that has no site within the cap."""


@njit(cache=True)
def lower_envelope(heights: Array, n: Int, places: Array, borders: Array, nearest: Array) -> None:
    """For each q of 0 … n − 1 the p that minimises (q − p)² + heights[p]; fills nearest (n,), −1 where there is no
    finite height. places (n,) int64 and borders (n + 1,) float64 are scratch."""
    top = -1
    for q in range(n):
        if heights[q] >= FAR:
            continue
        while top >= 0:
            p = places[top]
            meet = (heights[q] + q * q - heights[p] - p * p) / (2.0 * (q - p))
            if meet > borders[top]:
                break
            top -= 1
        top += 1
        places[top] = q
        borders[top] = meet if top > 0 else -np.inf
    at = 0
    for q in range(n):
        if top < 0:
            nearest[q] = -1
            continue
        while at < top and borders[at + 1] < q:
            at += 1
        nearest[q] = places[at]


@njit(cache=True, parallel=True)
def transform(sites: Array, cap: Int, squared: Array, nearest: Array) -> None:
    """The nearest site of each voxel of a dense box.

    sites   : (nx, ny, nz) bool
    cap     : sites farther than this [voxels] are none
    squared : (nx, ny, nz) int32, filled: squared distance [voxels²], FAR where there is no site within the cap
    nearest : (nx, ny, nz) int32, filled: the site as x · ny · nz + y · nz + z, −1 where there is none
    """
    nx, ny, nz = sites.shape
    for x in prange(nx):
        longest = max(ny, nz)
        heights = np.empty(longest, np.int64)
        places = np.empty(longest, np.int64)
        borders = np.empty(longest + 1, np.float64)
        best = np.empty(longest, np.int64)
        along_z = np.empty((ny, nz), np.int32)
        some = False
        for y in range(ny):
            last = -FAR
            for z in range(nz):
                if sites[x, y, z]:
                    last = z
                    some = True
                along_z[y, z] = last if z - last <= cap else -1
            last = FAR
            for z in range(nz - 1, -1, -1):
                if sites[x, y, z]:
                    last = z
                if last - z <= cap and (along_z[y, z] < 0 or last - z < z - along_z[y, z]):
                    along_z[y, z] = last
        if not some:
            squared[x] = FAR
            nearest[x] = -1
            continue
        for z in range(nz):
            for y in range(ny):
                there = along_z[y, z]
                heights[y] = FAR if there < 0 else (z - there) ** 2
            lower_envelope(heights, ny, places, borders, best)
            for y in range(ny):
                p = best[y]
                if p < 0 or (y - p) ** 2 + heights[p] > cap * cap:
                    squared[x, y, z] = FAR
                    nearest[x, y, z] = -1
                else:
                    squared[x, y, z] = (y - p) ** 2 + heights[p]
                    nearest[x, y, z] = x * ny * nz + p * nz + along_z[p, z]
    for y in prange(ny):
        heights_x = np.empty(nx, np.int64)
        from_x = np.empty(nx, np.int32)
        places_x = np.empty(nx, np.int64)
        borders_x = np.empty(nx + 1, np.float64)
        best_x = np.empty(nx, np.int64)
        for z in range(nz):
            for x in range(nx):
                heights_x[x] = squared[x, y, z]
                from_x[x] = nearest[x, y, z]
            lower_envelope(heights_x, nx, places_x, borders_x, best_x)
            for x in range(nx):
                p = best_x[x]
                if p < 0 or (x - p) ** 2 + heights_x[p] > cap * cap:
                    squared[x, y, z] = FAR
                    nearest[x, y, z] = -1
                else:
                    squared[x, y, z] = (x - p) ** 2 + heights_x[p]
                    nearest[x, y, z] = from_x[p]


@njit(cache=True, parallel=True)
def find_crossings(distance: Array, before: Array, behind: Array) -> None:
    """Which voxels of dense signed distances (nx, ny, nz), NaN where unknown, have a face neighbour of the other sign.

    before, behind : (nx, ny, nz) bool, filled: such voxels with distance ≥ 0, < 0
    """
    nx, ny, nz = distance.shape
    for x in prange(nx):
        for y in range(ny):
            for z in range(nz):
                here = distance[x, y, z]
                inside = here < 0.0
                crossing = False
                for face in range(6):
                    step = 1 if face & 1 else -1
                    a = x + (step if face >> 1 == 0 else 0)
                    b = y + (step if face >> 1 == 1 else 0)
                    c = z + (step if face >> 1 == 2 else 0)
                    if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
                        there = distance[a, b, c]
                        crossing |= not np.isnan(there) and (there < 0.0) != inside
                crossing &= not np.isnan(here)
                before[x, y, z] = crossing and not inside
                behind[x, y, z] = crossing and inside


@njit(cache=True, parallel=True, error_model="numpy")
def measure_side(
    near: Array, nearest: Array, side: Float, voxel_size: Float, truncation: Float, distance: Array
) -> None:
    """Distance to the surface beside the nearest site, for the voxels before (side 1) or behind it (−1), in place.

    near     : (nx, ny, nz) float32, signed distances of the source [m], NaN where unknown
    nearest  : (nx, ny, nz) int32 from `transform`, of the sites on this side
    distance : (nx, ny, nz) float32 [m], written on this side only

    The surface is taken as the plane that the site's distance and gradient give, at the foot of its perpendicular.
    """
    nx, ny, nz = near.shape
    for x in prange(nx):
        for y in range(ny):
            for z in range(nz):
                if not ((near[x, y, z] >= 0.0) if side > 0.0 else (near[x, y, z] < 0.0)):
                    continue
                site = np.int64(nearest[x, y, z])
                if site < 0:
                    distance[x, y, z] = side * truncation
                    continue
                a, b, c = site // (ny * nz), site // nz % ny, site % nz
                here = near[a, b, c]
                before = near[a - 1, b, c] if a > 0 else np.nan
                after = near[a + 1, b, c] if a + 1 < nx else np.nan
                g0 = slope(before, here, after, np.inf)
                before = near[a, b - 1, c] if b > 0 else np.nan
                after = near[a, b + 1, c] if b + 1 < ny else np.nan
                g1 = slope(before, here, after, np.inf)
                before = near[a, b, c - 1] if c > 0 else np.nan
                after = near[a, b, c + 1] if c + 1 < nz else np.nan
                g2 = slope(before, here, after, np.inf)
                norm = max(np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), 1e-12)
                offset = min(abs(here) / norm, 1.0) * side / norm  # [voxels]; a site is within one voxel of its surface
                d0, d1, d2 = x - a + offset * g0, y - b + offset * g1, z - c + offset * g2
                distance[x, y, z] = side * min(np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) * voxel_size, truncation)


@njit(cache=True, parallel=True)
def store_box(distance: Array, slots: Array, blocks: Array, first: Array, box: Array, changed: Array) -> None:
    """Copy dense distances into the blocks in `slots` (n,), in place.

    first   : (3,) voxel index of box[0, 0, 0]; the blocks (n, 3) lie within the box
    changed : (n,) bool, filled
    """
    for n in prange(slots.shape[0]):
        x, y, z = 8 * blocks[n, 0] - first[0], 8 * blocks[n, 1] - first[1], 8 * blocks[n, 2] - first[2]
        difference = np.uint8(0)
        for w in range(512):
            old = distance[slots[n], w]
            new = box[x + (w >> 6), y + ((w >> 3) & 7), z + (w & 7)]
            same = old == new or (np.isnan(old) and np.isnan(new))
            difference |= np.uint8(not same)
            distance[slots[n], w] = new
        changed[n] = difference != 0


@njit(cache=True)
def interpolate_with_gradient(
    table: Array, distance: Array, voxel_size: Float, p_map: Array, values: Array, gradients: Array
) -> None:
    """Trilinear distance (n,) [m] and its gradient (n, 3) at each point (n, 3) [m], in place; NaN where one of the
    eight voxels about it is unknown."""
    per_voxel = 1.0 / voxel_size
    bound = 8.0 * BLOCK_LIMIT - 2.0
    last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
    slot: Int = np.int64(-1)
    for n in range(p_map.shape[0]):
        values[n] = np.nan
        gradients[n, :] = np.nan
        x, y, z = p_map[n, 0] * per_voxel - 0.5, p_map[n, 1] * per_voxel - 0.5, p_map[n, 2] * per_voxel - 0.5
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
            continue
        i0, j0, k0 = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        fx, fy, fz = x - i0, y - j0, z - k0
        total = g0 = g1 = g2 = 0.0
        for corner in range(8):
            di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
            i, j, k = i0 + di, j0 + dj, k0 + dk
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                slot = lookup(table, bi, bj, bk)
                last_i, last_j, last_k = bi, bj, bk
            if slot < 0:
                total = np.nan
                break
            d = distance[slot, (i & 7) << 6 | (j & 7) << 3 | (k & 7)]
            wx, wy, wz = (fx if di else 1.0 - fx), (fy if dj else 1.0 - fy), (fz if dk else 1.0 - fz)
            total += wx * wy * wz * d
            g0 += (1.0 if di else -1.0) * wy * wz * d
            g1 += (1.0 if dj else -1.0) * wx * wz * d
            g2 += (1.0 if dk else -1.0) * wx * wy * d
        if not np.isnan(total):
            values[n] = total
            gradients[n, 0] = g0 * per_voxel
            gradients[n, 1] = g1 * per_voxel
            gradients[n, 2] = g2 * per_voxel
