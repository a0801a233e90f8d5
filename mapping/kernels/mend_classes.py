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

_MANY = 128
"""So many changes of sites cost as much as looking for the nearest sites of all voxels of a block."""


@njit(cache=True)
def decode(
    stored: Array, targets: Array, side: Float, voxel_size: Float, values: Array, squared: Array, wanted: Array
) -> tuple[bool, bool]:
    """The squared distances (512,) int32 [voxels²] behind a block's stored ones (512,) [m], filled; −1: no target.

    targets : (8,) uint64, the voxels that lie on this side, 1 outside and −1 inside
    values  : (far + 1,) float32, see `mend_from_classes`
    wanted  : (512,) bool, filled: targets of which no distance on this side is stored; their squared one is `far`

    Returns whether there is any target, and whether any is wanted.
    """
    far = values.shape[0] - 1
    some = np.uint64(0)
    for x in range(8):
        some |= targets[x]
    if some == 0:
        return False, False
    some_wanted = False
    for w in range(512):
        is_target = (targets[w >> 6] >> np.uint64(w & 63)) & np.uint64(1) != 0
        distance = side * stored[w]
        root = np.float64(distance) / voxel_size + 0.5
        known = distance > np.float32(0.0)
        wanted[w] = is_target & (not known)
        some_wanted |= wanted[w]
        whole = np.int32(root * root + 0.5) if known & (distance < values[far]) else np.int32(far)
        squared[w] = whole if is_target else np.int32(-1)
    return True, some_wanted


@njit(cache=True)
def apply_sites(words: Array, toward: Array, reach: Int, vanish: bool, far: Int, squared: Array, wanted: Array) -> None:
    """Let sites, bits (8,) uint64 of a block, appear or vanish for the 512 voxels of another, in place.

    toward  : (3,) from the first voxel of the other block to that of the sites'
    reach   : sites farther than this squared distance from all voxels of the other block change nothing
    squared : (512,) int32; a site that appears comes to all voxels to which it is nearer
    wanted  : (512,) bool; a site that vanishes leaves all voxels that are as far as it
    """
    planar = np.empty(8, np.int32)
    for lx in range(8):
        if words[lx] == 0:
            continue
        for ly in range(8):
            byte = np.int64((words[lx] >> np.uint64(8 * ly)) & np.uint64(255))
            s0, s1 = toward[0] + lx, toward[1] + ly
            between = gap(s0, s0, 0, 7) ** 2 + gap(s1, s1, 0, 7) ** 2
            while byte:
                s2 = toward[2] + LOWEST[byte]
                byte &= byte - 1
                if between + gap(s2, s2, 0, 7) ** 2 > reach:
                    continue
                for z in range(8):
                    planar[z] = (s2 - z) ** 2
                for row in range(64):
                    across = np.int32((s0 - (row >> 3)) ** 2 + (s1 - (row & 7)) ** 2)
                    for z in range(8):
                        w = row << 3 | z
                        away = np.int32(planar[z] + across)
                        if vanish:
                            wanted[w] |= (away == squared[w]) & (away < far)
                        else:
                            squared[w] = min(squared[w], away)


@njit(cache=True)
def count_changes(appeared: Array, vanished: Array, plane: Int, rows: Array) -> Int:
    """How many sites of a plane changed in the `rows` (n,) of appeared, vanished (k, 2, 8)."""
    count = 0
    for n in rows:
        for x in range(8):
            both = appeared[n, plane, x] | vanished[n, plane, x]
            while both:
                both &= both - np.uint64(1)
                count += 1
    return count


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
    toward = np.empty(3, np.int64)
    different = False
    for plane in range(2):
        side = np.float32(1.0 if plane == OCCUPIED else -1.0)
        targets = planes[slot, FREE if plane == OCCUPIED else OCCUPIED]
        limit = np.int64(reach[slot, plane])
        reach[slot, plane] = 0
        some, some_wanted = decode(distance[slot], targets, side, voxel_size, values, squared, wanted)
        if not some:
            continue
        count = count_changes(appeared, vanished, plane, rows)
        if count == 0 and not some_wanted:
            reach[slot, plane] = limit
            continue
        if count > _MANY:
            for w in range(512):
                wanted[w] = squared[w] >= 0
        else:
            for vanish in (True, False):
                for n in rows:
                    for a in range(3):
                        toward[a] = 8 * (cells[n, a] - cell[a])
                    words = vanished[n, plane] if vanish else appeared[n, plane]
                    apply_sites(words, toward, limit, vanish, far, squared, wanted)
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
