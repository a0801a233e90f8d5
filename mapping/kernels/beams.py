"""What the beams of one scan pass: ray casting into a dense volume about the scan.

The volume holds a byte a voxel, block after block as in the map, so that a scan's blocks need no search and no copy.
Marks are set and never counted, and HIT outranks MISS: neither the order of the beams nor the number of threads can
matter. Only where a scan reaches too far for a volume are its blocks kept in a hash, see `mark_far_beams`.

A *layout* (6,) int64 is the volume's first block and its number of blocks along each axis.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import find_or_insert, lookup
from mapping.kernels.occupancy import HIT, MISS

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

PARTS = 8
"""The beams are shared out to threads in so many parts."""


@njit(cache=True, error_model="numpy")
def place_beams(
    p_sensor: Array, pose: Array, max_range: Float, snap: Float, ends: Array, whole: Array, box: Array
) -> bool:
    """The end of each beam in map, cut at `max_range`, in place; False where a point is not finite.

    p_sensor : (n, 3) [m]; pose (12,): R_map_sensor row by row, then t_map_sensor
    snap     : a voxel's edge [m] to move ends to the centre of their voxel, before they are cut; 0 to leave them
    ends     : (n, 3) [m], filled; whole (n,) bool, filled: whether the beam was not cut
    box      : (2, 3) [m], filled: lowest and highest corner of the box about the sensor and all ends
    """
    per_voxel = 1.0 / snap if snap > 0.0 else 0.0
    low_x, low_y, low_z = pose[9], pose[10], pose[11]
    high_x, high_y, high_z = low_x, low_y, low_z
    finite = True
    for n in range(p_sensor.shape[0]):
        a, b, c = p_sensor[n, 0], p_sensor[n, 1], p_sensor[n, 2]
        x = pose[0] * a + pose[1] * b + pose[2] * c
        y = pose[3] * a + pose[4] * b + pose[5] * c
        z = pose[6] * a + pose[7] * b + pose[8] * c
        if snap > 0.0:
            x = (np.floor((x + pose[9]) * per_voxel) + 0.5) * snap - pose[9]
            y = (np.floor((y + pose[10]) * per_voxel) + 0.5) * snap - pose[10]
            z = (np.floor((z + pose[11]) * per_voxel) + 0.5) * snap - pose[11]
        length = np.sqrt(x * x + y * y + z * z)
        finite &= length < np.inf
        whole[n] = length <= max_range
        share = 1.0 if whole[n] else max_range / length
        x, y, z = x * share + pose[9], y * share + pose[10], z * share + pose[11]
        ends[n, 0], ends[n, 1], ends[n, 2] = x, y, z
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    box[0, 0], box[0, 1], box[0, 2] = low_x, low_y, low_z
    box[1, 0], box[1, 1], box[1, 2] = high_x, high_y, high_z
    return finite


@njit(cache=True)
def thin_out(ends: Array, whole: Array, voxel_size: Float, layout: Array, offsets: Array, marks: Array) -> Int:
    """Of beams that end in the same voxel keep one, in place at the front; returns how many there are.

    ends (n, 3) [m, map] are centres of voxels where whole (n,) says so. Beams that were cut are kept, but for one like
    the one before. marks: a volume in which nothing is marked, see `mark_beams`; the ends that are kept are marked.
    """
    per_voxel = 1.0 / voxel_size
    count = 0
    for n in range(ends.shape[0]):
        same = count > 0 and ends[n, 0] == ends[count - 1, 0] and ends[n, 1] == ends[count - 1, 1]
        if same and ends[n, 2] == ends[count - 1, 2]:
            continue
        if whole[n]:
            at = offsets[0, np.int64(np.floor(ends[n, 0] * per_voxel)) - 8 * layout[0]]
            at += offsets[1, np.int64(np.floor(ends[n, 1] * per_voxel)) - 8 * layout[1]]
            at += offsets[2, np.int64(np.floor(ends[n, 2] * per_voxel)) - 8 * layout[2]]
            if marks[at]:
                continue
            marks[at] = HIT
        ends[count, 0], ends[count, 1], ends[count, 2] = ends[n, 0], ends[n, 1], ends[n, 2]
        whole[count] = whole[n]
        count += 1
    return count


@njit(cache=True, inline="always")
def first_border(voxel: Int, origin: Float, step: Float, voxel_size: Float) -> tuple[Int, Float, Float]:
    """Along one axis of a beam `step` [m] long: its direction, and as shares of it the way to the next border between
    voxels and the way between borders (Amanatides & Woo 1987)."""
    if step > 0.0:
        return 1, ((voxel + 1) * voxel_size - origin) / step, voxel_size / step
    if step < 0.0:
        return -1, (voxel * voxel_size - origin) / step, -voxel_size / step
    return 0, np.inf, np.inf


@njit(cache=True, parallel=True, error_model="numpy")
def mark_beams(
    origin: Array, ends: Array, voxel_size: Float, layout: Array, offsets: Array, marks: Array, touched: Array
) -> None:
    """Walk each beam from `origin` (3,) to `ends` (n, 3) [m, map] and mark what it passes, in place.

    The walk is that of OctoMap's `computeRayKeys`: the voxel of the origin is passed, that of the end is not.

    offsets : (3, m) int64: where in `marks` the voxels of each index along an axis begin, see `list_offsets`
    marks   : (voxels of the layout,) uint8
    touched : (blocks of the layout,) uint8, set where a voxel is marked, or empty: then nothing is noted
    """
    noting = touched.shape[0] > 0
    per_voxel = 1.0 / voxel_size
    o0 = np.int64(np.floor(origin[0] * per_voxel))
    o1 = np.int64(np.floor(origin[1] * per_voxel))
    o2 = np.int64(np.floor(origin[2] * per_voxel))
    along0, along1, along2 = offsets[0], offsets[1], offsets[2]
    part = -(-ends.shape[0] // PARTS)
    for p in prange(PARTS):
        for n in range(p * part, min(ends.shape[0], (p + 1) * part)):
            steps = abs(np.int64(np.floor(ends[n, 0] * per_voxel)) - o0)
            steps += abs(np.int64(np.floor(ends[n, 1] * per_voxel)) - o1)
            steps += abs(np.int64(np.floor(ends[n, 2] * per_voxel)) - o2)
            s0, t0, step0 = first_border(o0, origin[0], ends[n, 0] - origin[0], voxel_size)
            s1, t1, step1 = first_border(o1, origin[1], ends[n, 1] - origin[1], voxel_size)
            s2, t2, step2 = first_border(o2, origin[2], ends[n, 2] - origin[2], voxel_size)
            i, j, k = o0 - 8 * layout[0], o1 - 8 * layout[1], o2 - 8 * layout[2]
            a, b, c = along0[i], along1[j], along2[k]
            for _ in range(steps):
                at = a + b + c
                marks[at] = MISS
                if noting:
                    touched[at >> 9] = 1
                if t0 < t1:
                    if t0 < t2:
                        t0 += step0
                        i += s0
                        a = along0[i]
                    else:
                        t2 += step2
                        k += s2
                        c = along2[k]
                elif t1 < t2:
                    t1 += step1
                    j += s1
                    b = along1[j]
                else:
                    t2 += step2
                    k += s2
                    c = along2[k]


@njit(cache=True)
def list_offsets(layout: Array, offsets: Array) -> None:
    """Where in the volume of a layout the voxels of index 0, 1, … along each axis begin: fills offsets (3, m) int64."""
    along = 512
    for axis in range(2, -1, -1):
        for n in range(8 * layout[3 + axis]):
            offsets[axis, n] = (n >> 3) * along + ((n & 7) << 3 * (2 - axis))
        along *= layout[3 + axis]


@njit(cache=True)
def mark_ends(
    ends: Array, whole: Array, voxel_size: Float, layout: Array, offsets: Array, marks: Array, touched: Array
) -> None:
    """Mark the voxel at the end of each beam that was not cut as hit, in place; the rest as in `mark_beams`."""
    per_voxel = 1.0 / voxel_size
    for n in range(ends.shape[0]):
        if whole[n]:
            at = offsets[0, np.int64(np.floor(ends[n, 0] * per_voxel)) - 8 * layout[0]]
            at += offsets[1, np.int64(np.floor(ends[n, 1] * per_voxel)) - 8 * layout[1]]
            at += offsets[2, np.int64(np.floor(ends[n, 2] * per_voxel)) - 8 * layout[2]]
            marks[at] = HIT
            if touched.shape[0] > 0:
                touched[at >> 9] = 1


@njit(cache=True, error_model="numpy")
def mark_far_beams(
    origin: Array, ends: Array, start: Int, voxel_size: Float, table: Array, blocks: Array, n_blocks: Int, marks: Array
) -> tuple[Int, Int]:
    """`mark_beams` for scans that reach too far for a volume: the blocks that are passed are listed, in place.

    table             hash of the scan's blocks: index → row of `blocks` and `marks`
    blocks, marks     (capacity, 3) int32, (capacity, 512) uint8, of which `n_blocks` are in use
    Begins at beam `start`; returns (the beam to go on with when room ran out, or n; number of blocks).
    """
    per_voxel = 1.0 / voxel_size
    o0 = np.int64(np.floor(origin[0] * per_voxel))
    o1 = np.int64(np.floor(origin[1] * per_voxel))
    o2 = np.int64(np.floor(origin[2] * per_voxel))
    for n in range(start, ends.shape[0]):
        steps = abs(np.int64(np.floor(ends[n, 0] * per_voxel)) - o0)
        steps += abs(np.int64(np.floor(ends[n, 1] * per_voxel)) - o1)
        steps += abs(np.int64(np.floor(ends[n, 2] * per_voxel)) - o2)
        s0, t0, step0 = first_border(o0, origin[0], ends[n, 0] - origin[0], voxel_size)
        s1, t1, step1 = first_border(o1, origin[1], ends[n, 1] - origin[1], voxel_size)
        s2, t2, step2 = first_border(o2, origin[2], ends[n, 2] - origin[2], voxel_size)
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
            if t0 < t1 and t0 < t2:
                t0 += step0
                i += s0
            elif t1 <= t0 and t1 < t2:
                t1 += step1
                j += s1
            else:
                t2 += step2
                k += s2
    return ends.shape[0], n_blocks
