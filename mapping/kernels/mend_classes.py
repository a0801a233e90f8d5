"""Distances of hashed blocks made right where the sites of an occupancy map came and went."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.nearest import LOWEST, find_nearest, gap
from mapping.kernels.sites import FREE, OCCUPIED

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

_NONE = np.int32(1 << 29)
"""Farther than any site, squared."""


@njit(cache=True)
def decode(
    stored: Array, targets: Array, side: Float, voxel_size: Float, values: Array, squared: Array, wanted: Array
) -> tuple[bool, bool]:
    """The squared distances (512,) int32 [voxels²] behind a block's stored ones (512,) [m], filled; −1: no target.

    targets : (8,) uint64, the voxels that lie on this side, 1 outside and −1 inside
    values  : (far + 1,) float32, see `mend_from_classes`
    wanted  : (512,) bool, filled: targets of which no distance on this side is stored; their squared one is `far`

    Returns whether there is any target of which a distance is stored, and whether any is wanted.
    """
    far = values.shape[0] - 1
    some = np.uint64(0)
    for x in range(8):
        some |= targets[x]
    if some == 0:
        return False, False
    some_known = some_wanted = False
    for w in range(512):
        is_target = (targets[w >> 6] >> np.uint64(w & 63)) & np.uint64(1) != 0
        distance = side * stored[w]
        root = np.float64(distance) / voxel_size + 0.5
        known = distance > np.float32(0.0)
        wanted[w] = is_target & (not known)
        some_known |= is_target & known
        some_wanted |= wanted[w]
        whole = np.int32(root * root + 0.5) if known & (distance < values[far]) else np.int32(far)
        squared[w] = whole if is_target else np.int32(-1)
    return some_known, some_wanted


@njit(cache=True)
def take_lower(away: Array, from_beside: Array, across: Int) -> None:
    """Lower `away` (n,) int32 to `from_beside` (n,) int32 and what lies across, in place."""
    for n in range(away.shape[0]):
        total = np.int32(from_beside[n] + across)
        away[n] = total if total < away[n] else away[n]


@njit(cache=True)
def approach(words: Array, toward: Array, reach: Int, away: Array, slab: Array) -> None:
    """Lower the squared distances of the 8³ voxels of a block to what they are from sites of another, in place.

    words  : (8,) uint64, the sites, bits of the other block
    toward : (3,) from the first voxel of the block to that of the sites'
    reach  : sites farther than this squared distance from all voxels of the block are left out
    away   : (8, 64) int32;  slab: (9, 8) int32, scratch

    A squared distance is a sum over the axes, so that its least value is found along one axis after the other.
    """
    line = slab[8]
    for lx in range(8):
        s0 = toward[0] + lx
        before = gap(s0, s0, 0, 7) ** 2
        if words[lx] == 0 or before > reach:
            continue
        some = False
        slab[:] = _NONE
        for ly in range(8):
            byte = np.int64((words[lx] >> np.uint64(8 * ly)) & np.uint64(255))
            s1 = toward[1] + ly
            beside = before + gap(s1, s1, 0, 7) ** 2
            if byte == 0 or beside > reach:
                continue
            line[:] = _NONE
            while byte:
                s2 = toward[2] + LOWEST[byte]
                byte &= byte - 1
                if beside + gap(s2, s2, 0, 7) ** 2 <= reach:
                    for z in range(8):
                        d = np.int32(s2 - z)
                        line[z] = min(line[z], np.int32(d * d))
            for y in range(8):
                d = np.int32(s1 - y)
                take_lower(slab[y], line, np.int32(d * d))
            some = True
        if some:
            plane = slab[:8].reshape(64)
            for x in range(8):
                d = np.int32(s0 - x)
                take_lower(away[x], plane, np.int32(d * d))


@njit(cache=True)
def withdraw(left: Array, squared: Array, far: Int, wanted: Array) -> None:
    """Mark as wanted (512,) bool, in place, the voxels whose nearest site, at `squared` (512,) int32, is one of those
    that left, of which the nearest is at `left` (512,) int32."""
    for w in range(512):
        wanted[w] |= (left[w] == squared[w]) & (squared[w] < far)


@njit(cache=True)
def have_changed(appeared: Array, vanished: Array, plane: Int, rows: Array) -> bool:
    """Whether sites of a plane changed in the `rows` (n,) of appeared, vanished (k, 2, 8)."""
    some = np.uint64(0)
    for n in rows:
        for x in range(8):
            some |= appeared[n, plane, x] | vanished[n, plane, x]
    return bool(some != 0)


@njit(cache=True)
def mend_block(
    distance: Array,
    reach: Array,
    planes: Array,
    values: Array,
    voxel_size: Float,
    grid: Array,
    offsets: Array,
    cell: Array,
    rows: Array,
    cells: Array,
    appeared: Array,
    vanished: Array,
) -> bool:
    """`mend_from_classes` for the block at `cell` (3,), which the changes in `rows` (n,) reach; whether it changed."""
    far = values.shape[0] - 1
    at = (cell[0], cell[1], cell[2])
    slot = grid[at]
    squared, nearest = np.empty(512, np.int32), np.empty(512, np.int32)
    wanted = np.empty(512, np.bool_)
    left, come, slab = np.empty((8, 64), np.int32), np.empty((8, 64), np.int32), np.empty((9, 8), np.int32)
    toward = np.empty(3, np.int64)
    different = False
    for plane in range(2):
        side = np.float32(1.0 if plane == OCCUPIED else -1.0)
        targets = planes[slot, FREE if plane == OCCUPIED else OCCUPIED]
        limit = np.int64(reach[slot, plane])
        reach[slot, plane] = 0
        some_known, some_wanted = decode(distance[slot], targets, side, voxel_size, values, squared, wanted)
        if not (some_known or some_wanted):
            continue
        if not (some_wanted or have_changed(appeared, vanished, plane, rows)):
            reach[slot, plane] = limit
            continue
        if some_known:
            left[:] = _NONE
            come[:] = _NONE
            for n in rows:
                for a in range(3):
                    toward[a] = 8 * (cells[n, a] - cell[a])
                approach(vanished[n, plane], toward, limit, left, slab)
                approach(appeared[n, plane], toward, limit, come, slab)
            withdraw(left.reshape(512), squared, far, wanted)
            take_lower(squared, come.reshape(512), np.int32(0))
        find_nearest(planes, plane, grid, at, offsets, far, wanted, squared, nearest)
        top = np.int32(0)
        for w in range(512):
            if squared[w] >= 0:
                new = side * values[squared[w]]
                different |= distance[slot, w] != new
                distance[slot, w] = new
                top = max(top, squared[w])
        reach[slot, plane] = top
    for w in range(512):
        known = (planes[slot, OCCUPIED, w >> 6] | planes[slot, FREE, w >> 6]) >> np.uint64(w & 63)
        if known & np.uint64(1) == 0:
            different |= not np.isnan(distance[slot, w])
            distance[slot, w] = np.nan
    return different


@njit(cache=True, parallel=True)
def mend_from_classes(
    distance: Array,
    reach: Array,
    planes: Array,
    values: Array,
    voxel_size: Float,
    grid: Array,
    offsets: Array,
    targets: Array,
    changed_of: Array,
    first_of: Array,
    cells: Array,
    appeared: Array,
    vanished: Array,
    changed: Array,
) -> None:
    """Make the distances of blocks right after sites appeared and vanished, in place.

    distance   : (capacity, 512) float32 [m]: positive in FREE voxels, negative in OCCUPIED ones, NaN in others
    reach      : (capacity, 2) int32, written: the largest squared distance to an OCCUPIED, to a FREE voxel
    planes     : (capacity, 2, 8) uint64, bits of OCCUPIED and FREE as they are now
    values     : (far + 1,) float32 [m], the distance that each squared one means; at `far` it is truncated
    grid, offsets                see `mapping.kernels.nearest.find_nearest`
    targets    : (m, 3) int64 cells of the grid to mend; target t is reached by the changes changed_of[first_of[t] :
                 first_of[t + 1]], rows of cells (k, 3) int64, appeared and vanished (k, 2, 8) uint64
    changed    : (m,) bool, filled: whether a distance changed
    """
    for t in prange(targets.shape[0]):
        rows = changed_of[first_of[t] : first_of[t + 1]]
        changed[t] = mend_block(
            distance, reach, planes, values, voxel_size, grid, offsets, targets[t], rows, cells, appeared, vanished
        )
