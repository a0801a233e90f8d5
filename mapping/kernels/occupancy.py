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
    height, width = reach.shape
    v_ = np.float32(voxel_size)
    fx, fy, cx, cy = np.float32(camera[12]), np.float32(camera[13]), np.float32(camera[14]), np.float32(camera[15])
    r0, r1, r2 = np.float32(camera[0]) * v_, np.float32(camera[1]) * v_, np.float32(camera[2]) * v_
    r3, r4, r5 = np.float32(camera[3]) * v_, np.float32(camera[4]) * v_, np.float32(camera[5]) * v_
    r6, r7, r8 = np.float32(camera[6]) * v_, np.float32(camera[7]) * v_, np.float32(camera[8]) * v_
    half = np.float32(0.5)
    sparse_z = v_ * min(fx, fy)  # beyond this depth pixels are wider apart than voxels
    right, bottom = np.float32(width) - half, np.float32(height) - half
    for n in prange(blocks.shape[0]):
        a = (8.0 * blocks[n, 0] + 0.5) * voxel_size
        b = (8.0 * blocks[n, 1] + 0.5) * voxel_size
        c = (8.0 * blocks[n, 2] + 0.5) * voxel_size
        x0 = np.float32(camera[0] * a + camera[1] * b + camera[2] * c + camera[9])
        y0 = np.float32(camera[3] * a + camera[4] * b + camera[5] * c + camera[10])
        z0 = np.float32(camera[6] * a + camera[7] * b + camera[8] * c + camera[11])
        for w in range(512):
            i, j, k = np.float32(w >> 6), np.float32((w >> 3) & 7), np.float32(w & 7)
            mark = np.uint8(0)
            z = z0 + i * r6 + j * r7 + k * r8
            if z > np.float32(1e-4):
                u = (x0 + i * r0 + j * r1 + k * r2) / z * fx + cx
                v = (y0 + i * r3 + j * r4 + k * r5) / z * fy + cy
                if u > -half and v > -half and u < right and v < bottom:
                    d = abs(reach[np.int64(v + half), np.int64(u + half)])
                    if z > sparse_z:
                        d -= np.float32(0.87) * v_
                    if z < d:
                        mark = np.uint8(MISS)
            marks[n, w] = mark


@njit(cache=True)
def list_hits(reach: Array, camera: Array, pose: Array, voxel_size: Float, voxels: Array) -> Int:
    """List the voxel of each pixel's surface point, row by row; pixels in a row that share a voxel give it once.

    pose   : (12,) float64, R_map_camera row by row and t_map_camera
    voxels : (n, 3) int32, filled in place from the start; n must be the number of pixels. Returns how many there are.
    """
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    per_voxel = 1.0 / voxel_size
    count = 0
    for v in range(reach.shape[0]):
        y = (v - cy) / fy
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT * 8), np.int64(0), np.int64(0)
        for u in range(reach.shape[1]):
            d = reach[v, u]
            if d > np.float32(0.0):
                x = (u - cx) / fx
                i = np.int64(np.floor((d * (pose[0] * x + pose[1] * y + pose[2]) + pose[9]) * per_voxel))
                j = np.int64(np.floor((d * (pose[3] * x + pose[4] * y + pose[5]) + pose[10]) * per_voxel))
                k = np.int64(np.floor((d * (pose[6] * x + pose[7] * y + pose[8]) + pose[11]) * per_voxel))
                if i != last_i or j != last_j or k != last_k:
                    voxels[count, 0] = i
                    voxels[count, 1] = j
                    voxels[count, 2] = k
                    count += 1
                    last_i, last_j, last_k = i, j, k
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
    max_range: Float,
    voxel_size: Float,
    table: Array,
    blocks: Array,
    n_blocks: Int,
    marks: Array,
) -> tuple[Int, Int]:
    """Walk each beam from `origin` (3,) to `ends` (m, 3) [m, map]; mark what it passes and hits, in place.

    The walk is that of OctoMap's `computeRayKeys` (Amanatides & Woo 1987): the voxel of the origin is passed, that of
    the end is hit; a beam longer than `max_range` is cut there and hits nothing. table, blocks, marks: see `mark_hits`.
    Begins at beam `start`; returns (beam to go on with when room ran out or m, number of blocks).
    """
    per_voxel = 1.0 / voxel_size
    o0 = np.int64(np.floor(origin[0] * per_voxel))
    o1 = np.int64(np.floor(origin[1] * per_voxel))
    o2 = np.int64(np.floor(origin[2] * per_voxel))
    for n in range(start, ends.shape[0]):
        d0, d1, d2 = ends[n, 0] - origin[0], ends[n, 1] - origin[1], ends[n, 2] - origin[2]
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        if not length > 0.0:
            length = 0.0
            d0 = d1 = d2 = 0.0
        else:
            d0, d1, d2 = d0 / length, d1 / length, d2 / length
        whole = length <= max_range
        length = min(length, max_range)
        if whole:
            e0 = np.int64(np.floor(ends[n, 0] * per_voxel))
            e1 = np.int64(np.floor(ends[n, 1] * per_voxel))
            e2 = np.int64(np.floor(ends[n, 2] * per_voxel))
        else:
            e0 = np.int64(np.floor((origin[0] + d0 * length) * per_voxel))
            e1 = np.int64(np.floor((origin[1] + d1 * length) * per_voxel))
            e2 = np.int64(np.floor((origin[2] + d2 * length) * per_voxel))
        s0, s1, s2 = np.int64(np.sign(d0)), np.int64(np.sign(d1)), np.int64(np.sign(d2))
        # Distance along the beam to the next border across each axis, and between borders.
        t0 = ((o0 + (0.5 + 0.5 * s0)) * voxel_size - origin[0]) / d0 if s0 != 0 else np.inf
        t1 = ((o1 + (0.5 + 0.5 * s1)) * voxel_size - origin[1]) / d1 if s1 != 0 else np.inf
        t2 = ((o2 + (0.5 + 0.5 * s2)) * voxel_size - origin[2]) / d2 if s2 != 0 else np.inf
        step0 = voxel_size / abs(d0) if s0 != 0 else np.inf
        step1 = voxel_size / abs(d1) if s1 != 0 else np.inf
        step2 = voxel_size / abs(d2) if s2 != 0 else np.inf
        i, j, k = o0, o1, o2
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        row: Int = np.int64(0)
        while True:
            at_end = i == e0 and j == e1 and k == e2
            if at_end and not whole:
                break
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                if n_blocks == blocks.shape[0]:
                    row = lookup(table, bi, bj, bk)
                    if row < 0:
                        return n, n_blocks
                else:
                    row = find_or_insert(table, bi, bj, bk, n_blocks)
                if row == n_blocks:
                    blocks[row, 0] = bi
                    blocks[row, 1] = bj
                    blocks[row, 2] = bk
                    marks[row, :] = 0
                    n_blocks += 1
                last_i, last_j, last_k = bi, bj, bk
            local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
            if at_end:
                marks[row, local] = HIT
                break
            marks[row, local] = max(marks[row, local], np.uint8(MISS))
            if t0 < t1:
                if t0 < t2:
                    i += s0
                    t0 += step0
                else:
                    k += s2
                    t2 += step2
            elif t1 < t2:
                j += s1
                t1 += step1
            else:
                k += s2
                t2 += step2
            if min(t0, t1, t2) > length and not (i == e0 and j == e1 and k == e2):
                # Rounding led past the end without meeting its voxel: go there directly.
                i, j, k = e0, e1, e2
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
