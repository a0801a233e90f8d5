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

from mapping.kernels.cells import (
    N_FREE_SLOTS,
    TOP,
    UNKNOWN,
    add_row,
    find_cell,
    has_room,
    merge_up,
    split_down,
    take_slot,
    uniform,
    value_of,
)
from mapping.kernels.hashing import BLOCK_LIMIT, find_or_insert, lookup
from mapping.kernels.projection import project_block

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MISS, HIT = 1, 2
SOME_MISS, ALL_MISS, WITH_HITS = 1, 2, 3
"""What a scan says of a block: beams passed some of its voxels, or all; beams ended in it."""


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


@njit(cache=True, inline="always")
def list_row(reach: Array, row_i: Array, row_j: Array, row_k: Array, voxels: Array, count: Int) -> Int:
    """Add the voxels of one row of pixels to `voxels` (n, 3), of which `count` are in use, in place; returns how many
    are then. Pixels (w,) that met nothing (reach ≤ 0) have none, neighbours that share a voxel give it once.

    No branches: which pixels come to a new voxel cannot be foretold.
    """
    fresh = np.empty(reach.shape[0], np.bool_)
    fresh[0] = reach[0] > np.float32(0.0)
    for u in range(1, reach.shape[0]):
        other = ((row_i[u] ^ row_i[u - 1]) | (row_j[u] ^ row_j[u - 1]) | (row_k[u] ^ row_k[u - 1])) != 0
        fresh[u] = (reach[u] > np.float32(0.0)) & (other | (not reach[u - 1] > np.float32(0.0)))
    for u in range(reach.shape[0]):
        voxels[count, 0] = row_i[u]
        voxels[count, 1] = row_j[u]
        voxels[count, 2] = row_k[u]
        count += np.int64(fresh[u])
    return count


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
        count = list_row(reach[v], row_i, row_j, row_k, voxels, count)
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


# -- folding into the map --------------------------------------------------------------------------------------


@njit(cache=True, parallel=True)
def sort_marks(marks: Array, which: Array, kinds: Array) -> None:
    """What rows `which` (n,) of marks (m, 512) say of their blocks: fills kinds (n,) uint8 with 0, SOME_MISS, ALL_MISS
    or WITH_HITS. Row −1: a beam passed the whole block."""
    for n in prange(which.shape[0]):
        either = np.uint8(0)
        both = np.uint8(255)
        m = which[n]
        if m < 0:
            kinds[n] = ALL_MISS
            continue
        for w in range(512):
            either |= marks[m, w]
            both &= np.uint8(MISS) if marks[m, w] else np.uint8(0)
        if either & np.uint8(HIT):
            kinds[n] = WITH_HITS
        elif either:
            kinds[n] = ALL_MISS if both else SOME_MISS
        else:
            kinds[n] = 0


@njit(cache=True, inline="always")
def updated(old: Int, step: Int, lowest: Int, highest: Int) -> Int:
    """The evidence after one more step, clamped to lowest … highest."""
    return min(max((0 if old == UNKNOWN else old) + step, lowest), highest)


@njit(cache=True)
def open_blocks(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, payload: Array,
    free_slots: Array, counts: Array, start: Int, blocks: Array, kinds: Array, steps: Array, revision: Int,
    rows: Array, changed: Array,
) -> Int:  # fmt: skip
    """Make the blocks (n, 3) of a scan ready to be updated, in place, from number `start` on.

    What a uniform block becomes is settled here when that is uniform again; else it gets voxels of its own. The tree
    is that of `mapping.kernels.cells`; steps (4,) int64: hit, miss, lowest, highest.

    rows    : (n,) int64, filled: the row of a block whose voxels are to be updated one by one, −1 where nothing is left
    changed : (n,) bool, filled for the others
    Returns the number to go on with when room ran out, or n.
    """
    miss, lowest, highest = steps[1], steps[2], steps[3]
    for n in range(start, blocks.shape[0]):
        rows[n] = -1
        changed[n] = False
        if kinds[n] == 0:
            continue
        if not has_room(ijk, payload, counts):
            return n
        bi, bj, bk = np.int64(blocks[n, 0]), np.int64(blocks[n, 1]), np.int64(blocks[n, 2])
        row = find_cell(table, counts[TOP], bi, bj, bk)
        if row >= 0 and slot[row] >= 0:
            rows[n] = row
            continue
        old = np.int64(UNKNOWN) if row < 0 else np.int64(value_of(np.int64(slot[row])))
        passed = updated(old, miss, lowest, highest)
        if kinds[n] != WITH_HITS and passed == old:
            continue
        if row < 0:
            row = add_row(
                table, ijk, level, slot, changed_at, free_rows, counts, 0, bi, bj, bk, uniform(old), revision
            )  # fmt: skip
        elif level[row] > 0:
            row = split_down(table, ijk, level, slot, changed_at, free_rows, counts, row, bi, bj, bk)
        if kinds[n] == ALL_MISS:
            slot[row] = uniform(passed)
            changed_at[row] = revision
            changed[n] = True
            if passed == lowest:
                merge_up(table, ijk, level, slot, changed_at, free_rows, counts, row)
        else:
            slot[row] = take_slot(payload, free_slots, counts, old)
            rows[n] = row
    return blocks.shape[0]


@njit(cache=True, parallel=True)
def fold_marks(
    payload: Array, slot: Array, rows: Array, which: Array, marks: Array, steps: Array, changed: Array, same: Array
) -> None:
    """Update each marked voxel of open blocks once: evidence += hit or miss, clamped to lowest … highest; in place.

    payload : (capacity, 512) int8, UNKNOWN where nothing is known; slot: the row of payload of each row of the tree
    rows    : (n,) rows of the blocks of the scan, −1: not open; which (n,) their row in marks (m, 512), −1: a beam
              passed the whole block
    changed, same : (n,) bool, filled for open blocks: whether a voxel changed, whether all are the same now
    """
    hit, miss, lowest, highest = np.int16(steps[0]), np.int16(steps[1]), np.int16(steps[2]), np.int16(steps[3])
    for n in prange(rows.shape[0]):
        if rows[n] < 0:
            continue
        at, m = slot[rows[n]], which[n]
        difference = np.int16(0)
        spread = np.int16(0)
        for w in range(512):
            mark = marks[m, w] if m >= 0 else np.uint8(MISS)
            old = np.int16(payload[at, w])
            new = np.int16(0) if old == UNKNOWN else old
            new = new + (hit if mark == HIT else miss)
            new = min(max(new, lowest), highest)
            new = new if mark != 0 else old
            difference |= new ^ old
            payload[at, w] = np.int8(new)
        first = payload[at, 0]
        for w in range(512):
            spread |= np.int16(payload[at, w] ^ first)
        changed[n] = difference != 0
        same[n] = spread == 0


@njit(cache=True)
def settle_blocks(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, payload: Array,
    free_slots: Array, counts: Array, rows: Array, changed: Array, same: Array, steps: Array, revision: Int,
) -> None:  # fmt: skip
    """After the update of open blocks: note what changed, and keep once what is alike, in place.

    Blocks merge with their siblings when they are sure of what they hold: others are about to change again.
    """
    for n in range(rows.shape[0]):
        if rows[n] < 0:
            continue
        row = rows[n]
        if changed[n]:
            changed_at[row] = revision
        if same[n]:
            value = np.int64(payload[slot[row], 0])
            free_slots[counts[N_FREE_SLOTS]] = slot[row]
            counts[N_FREE_SLOTS] += 1
            slot[row] = uniform(value)
            if value == steps[2] or value == steps[3]:
                merge_up(table, ijk, level, slot, changed_at, free_rows, counts, row)
