"""Occupancy kernels: what one scan says of each voxel, and folding that into the map.

A scan first collects *marks*, one byte a voxel of the blocks it touches: 0 nothing, MISS a beam passed, HIT a beam
ended. A mark is set, never counted, and HIT outranks MISS, so that neither the order of the beams nor the number of
threads can matter. Only then is each marked voxel updated, once (Hornung et al., OctoMap, Autonomous Robots 2013,
§3.2).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, find_or_insert, lookup
from mapping.kernels.projection import project_block

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MISS, HIT = 1, 2
UNKNOWN = -128
"""The byte of a voxel of which nothing is known."""


# -- images ----------------------------------------------------------------------------------------------------


@njit(cache=True, parallel=True, error_model="numpy")
def mark_free(blocks: Array, voxel_size: Float, reach: Array, camera: Array, marks: Array) -> None:
    """Mark each voxel of `blocks` (n, 3) whose centre the image sees before its surface; fills marks (n, 512) uint8.

    A voxel takes the pixel nearest to its centre. Where pixels are wider apart than voxels, the voxel must lie before
    the surface as a whole.
    """
    seen = reach.ravel()
    sparse_z = np.float32(voxel_size * min(camera[12], camera[13]))  # beyond this, pixels are wider apart than voxels
    margin = np.float32(0.87 * voxel_size)
    for n in prange(blocks.shape[0]):
        pixels = np.empty(512, np.int32)
        z = np.empty(512, np.float32)
        stretch = np.empty(512, np.float32)
        project_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, camera, pixels, z, stretch)
        for w in range(512):
            d = abs(seen[max(pixels[w], 0)])
            d = d - margin if z[w] > sparse_z else d
            marks[n, w] = np.uint8(MISS) if (pixels[w] >= 0) & (z[w] < d) else np.uint8(0)


@njit(cache=True)
def list_hits(reach: Array, camera: Array, pose: Array, voxel_size: Float, voxels: Array) -> Int:
    """List the voxel of each pixel's surface point, row by row; pixels in a row that share a voxel give it once.

    pose   : (12,) float64, R_map_camera row by row and t_map_camera
    voxels : (n, 3) int32, filled in place from the start; n must be the number of pixels. Returns how many there are.
    """
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    per_voxel = 1.0 / voxel_size
    width = reach.shape[1]
    row_i, row_j, row_k = np.empty(width, np.int32), np.empty(width, np.int32), np.empty(width, np.int32)
    count = 0
    for v in range(reach.shape[0]):
        y = (v - cy) / fy
        a0, a1 = pose[0] / fx, pose[1] * y + pose[2] - pose[0] * cx / fx
        b0, b1 = pose[3] / fx, pose[4] * y + pose[5] - pose[3] * cx / fx
        c0, c1 = pose[6] / fx, pose[7] * y + pose[8] - pose[6] * cx / fx
        for u in range(width):  # no branches, so that it runs on vectors
            d = np.float64(reach[v, u])
            row_i[u] = np.int32(np.floor((d * (a0 * u + a1) + pose[9]) * per_voxel))
            row_j[u] = np.int32(np.floor((d * (b0 * u + b1) + pose[10]) * per_voxel))
            row_k[u] = np.int32(np.floor((d * (c0 * u + c1) + pose[11]) * per_voxel))
        last = -1
        for u in range(width):
            if reach[v, u] > np.float32(0.0):
                if last >= 0 and row_i[u] == row_i[last] and row_j[u] == row_j[last] and row_k[u] == row_k[last]:
                    continue
                voxels[count, 0] = row_i[u]
                voxels[count, 1] = row_j[u]
                voxels[count, 2] = row_k[u]
                count += 1
                last = u
    return count


@njit(cache=True)
def mark_hits(voxels: Array, table: Array, blocks: Array, n_blocks: Int, marks: Array) -> Int:
    """Mark `voxels` (m, 3) as hit, in place; blocks not listed yet are added. Returns the new number of blocks, or −1
    where there is no room for them.

    table             hash of the scan's blocks: index → row of `blocks` and `marks`
    blocks, marks     (capacity, 3) int32, (capacity, 512) uint8, of which `n_blocks` are in use
    """
    last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
    row: Int = np.int64(0)
    for n in range(voxels.shape[0]):
        i, j, k = np.int64(voxels[n, 0]), np.int64(voxels[n, 1]), np.int64(voxels[n, 2])
        bi, bj, bk = i >> 3, j >> 3, k >> 3
        if bi != last_i or bj != last_j or bk != last_k:
            if n_blocks == blocks.shape[0]:
                row = lookup(table, bi, bj, bk)
                if row < 0:
                    return -1
            else:
                row = find_or_insert(table, bi, bj, bk, n_blocks)
            if row == n_blocks:
                blocks[row, 0] = bi
                blocks[row, 1] = bj
                blocks[row, 2] = bk
                marks[row, :] = 0
                n_blocks += 1
            last_i, last_j, last_k = bi, bj, bk
        marks[row, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] = HIT
    return n_blocks


# -- beams -----------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def mark_beams(
    origin: Array,
    ends: Array,
    start: Int,
    voxel_size: Float,
    table: Array,
    blocks: Array,
    n_blocks: Int,
    marks: Array,
) -> tuple[Int, Int]:
    """Walk each beam from `origin` (3,) to `ends` (m, 3) [m, map] and mark what it passes, in place.

    The walk is that of OctoMap's `computeRayKeys` (Amanatides & Woo 1987): the voxel of the origin is passed, that of
    the end is not. table, blocks and marks as in `mark_hits`; begins at beam `start`. Returns (the beam to go on with
    when room ran out, or m; number of blocks).
    """
    per_voxel = 1.0 / voxel_size
    o0 = np.int64(np.floor(origin[0] * per_voxel))
    o1 = np.int64(np.floor(origin[1] * per_voxel))
    o2 = np.int64(np.floor(origin[2] * per_voxel))
    for n in range(start, ends.shape[0]):
        steps = abs(np.int64(np.floor(ends[n, 0] * per_voxel)) - o0)
        steps += abs(np.int64(np.floor(ends[n, 1] * per_voxel)) - o1)
        steps += abs(np.int64(np.floor(ends[n, 2] * per_voxel)) - o2)
        d0, d1, d2 = ends[n, 0] - origin[0], ends[n, 1] - origin[1], ends[n, 2] - origin[2]
        s0, s1, s2 = np.int64(np.sign(d0)), np.int64(np.sign(d1)), np.int64(np.sign(d2))
        # Share of the beam up to the next border across each axis, and between borders.
        t0 = ((o0 + (s0 > 0)) * voxel_size - origin[0]) / d0 if s0 != 0 else np.inf
        t1 = ((o1 + (s1 > 0)) * voxel_size - origin[1]) / d1 if s1 != 0 else np.inf
        t2 = ((o2 + (s2 > 0)) * voxel_size - origin[2]) / d2 if s2 != 0 else np.inf
        step0 = voxel_size / abs(d0) if s0 != 0 else np.inf
        step1 = voxel_size / abs(d1) if s1 != 0 else np.inf
        step2 = voxel_size / abs(d2) if s2 != 0 else np.inf
        i, j, k = o0, o1, o2
        last_i, last_j, last_k = ~o0, ~o1, ~o2  # in no block of this one's
        row: Int = np.int64(0)
        for _ in range(steps):
            if ((i ^ last_i) | (j ^ last_j) | (k ^ last_k)) & ~7:
                last_i, last_j, last_k = i, j, k
                if n_blocks == blocks.shape[0]:
                    row = lookup(table, i >> 3, j >> 3, k >> 3)
                    if row < 0:
                        return n, n_blocks
                else:
                    row = find_or_insert(table, i >> 3, j >> 3, k >> 3, n_blocks)
                if row == n_blocks:
                    blocks[row, 0] = i >> 3
                    blocks[row, 1] = j >> 3
                    blocks[row, 2] = k >> 3
                    marks[row, :] = 0
                    n_blocks += 1
            marks[row, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] = MISS
            # The nearest border is crossed; without branches, which the processor could not foresee.
            x_before_y = t0 < t1
            x = x_before_y & (t0 < t2)
            y = (not x_before_y) & (t1 < t2)
            z = not (x | y)
            i += s0 if x else 0
            j += s1 if y else 0
            k += s2 if z else 0
            t0 = t0 + step0 if x else t0
            t1 = t1 + step1 if y else t1
            t2 = t2 + step2 if z else t2
    return ends.shape[0], n_blocks


# -- folding into the map --------------------------------------------------------------------------------------


@njit(cache=True, parallel=True)
def find_marked(marks: Array, marked: Array) -> None:
    """Which rows of marks (n, 512) have any mark: fills marked (n,) bool."""
    for n in prange(marks.shape[0]):
        some = np.uint8(0)
        for w in range(512):
            some |= marks[n, w]
        marked[n] = some != 0


@njit(cache=True, parallel=True)
def fold_marks(
    evidence: Array,
    slots: Array,
    rows: Array,
    marks: Array,
    hit: Int,
    miss: Int,
    lowest: Int,
    highest: Int,
    changed: Array,
) -> None:
    """Update each marked voxel once: evidence += hit or miss, clamped to lowest … highest; in place.

    evidence : (capacity, 512) int8, UNKNOWN where nothing is known
    slots    : (n,) the blocks to update; rows (n,) their row in marks (m, 512), −1: a beam passed the whole block
    changed  : (n,) bool, filled: whether a voxel of the block changed
    """
    for n in prange(slots.shape[0]):
        slot, row = slots[n], rows[n]
        difference = np.int16(0)
        for w in range(512):
            mark = marks[row, w] if row >= 0 else np.uint8(MISS)
            old = np.int16(evidence[slot, w])
            new = np.int16(0) if old == UNKNOWN else old
            new = new + np.int16(hit if mark == HIT else miss)
            new = np.int16(min(max(new, np.int16(lowest)), np.int16(highest)))
            new = new if mark != 0 else old
            difference |= new ^ old
            evidence[slot, w] = np.int8(new)
        changed[n] = difference != 0
