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


@njit(cache=True, parallel=True, error_model="numpy")
def place_beams(p_sensor: Array, pose: Array, max_range: Float, ends: Array, whole: Array) -> bool:
    """The end of each beam in map, cut at `max_range`, in place; False where a point is not finite.

    p_sensor : (n, 3) [m]; pose (12,): R_map_sensor row by row, then t_map_sensor
    ends     : (n, 3) [m], filled; whole (n,) bool, filled: whether the beam was not cut
    """
    part = -(-p_sensor.shape[0] // PARTS)
    finite = np.ones(PARTS, np.bool_)
    for p in prange(PARTS):
        for n in range(p * part, min(p_sensor.shape[0], (p + 1) * part)):
            a, b, c = p_sensor[n, 0], p_sensor[n, 1], p_sensor[n, 2]
            length = np.sqrt(a * a + b * b + c * c)
            if not length < np.inf:
                finite[p] = False
            whole[n] = length <= max_range
            share = 1.0 if whole[n] else max_range / length
            for axis in range(3):
                r = 3 * axis
                ends[n, axis] = (pose[r] * a + pose[r + 1] * b + pose[r + 2] * c) * share + pose[9 + axis]
    return finite.all()


@njit(cache=True)
def thin_out(ends: Array, origin: Array, max_range: Float, voxel_size: Float, seen: Array, whole: Array) -> Int:
    """One beam a voxel, to its centre: OctoMap's `computeDiscreteUpdate`; in place, returns how many are left.

    ends  : (n, 3) [m, map] not cut yet; those left are moved to the front, cut at `max_range`; whole (n,) is filled
    seen  : (m, 3) int64 scratch of a hash set, m a power of two ≥ 2 n, filled with the lowest number
    """
    size = seen.shape[0]
    per_voxel = 1.0 / voxel_size
    count = 0
    for n in range(ends.shape[0]):
        i = np.int64(np.floor(ends[n, 0] * per_voxel))
        j = np.int64(np.floor(ends[n, 1] * per_voxel))
        k = np.int64(np.floor(ends[n, 2] * per_voxel))
        place = (i * 73856093 ^ j * 19349669 ^ k * 83492791) * 0x9E3779B1 >> 15 & (size - 1)
        while seen[place, 0] != np.iinfo(np.int64).min and not (
            seen[place, 0] == i and seen[place, 1] == j and seen[place, 2] == k
        ):
            place = (place + 1) & (size - 1)
        if seen[place, 0] != np.iinfo(np.int64).min:
            continue
        seen[place, 0], seen[place, 1], seen[place, 2] = i, j, k
        a, b, c = (i + 0.5) * voxel_size - origin[0], (j + 0.5) * voxel_size - origin[1], 0.0
        c = (k + 0.5) * voxel_size - origin[2]
        length = np.sqrt(a * a + b * b + c * c)
        whole[count] = length <= max_range
        share = 1.0 if whole[count] else max_range / length
        ends[count, 0], ends[count, 1], ends[count, 2] = (
            origin[0] + a * share,
            origin[1] + b * share,
            origin[2] + c * share,
        )
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
    marks   : (voxels of the layout,) uint8; touched (blocks of the layout,) uint8, set where a voxel is marked
    """
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
