"""What a change of sites can reach: which blocks hold a voxel whose nearest site may be another one now."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.cells import UNKNOWN
from mapping.kernels.nearest import gap
from mapping.kernels.surface import pad_block

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any

OCCUPIED, FREE = 0, 1
"""Planes of the sites of an occupancy map: what free voxels are far from, and what occupied ones are far from."""
BEFORE, BEHIND = 0, 1
"""Planes of the sites of signed distances: voxels before and behind a surface, with a face neighbour on its other
side."""


@njit(cache=True)
def read_classes(evidence: Array, slots: Array, planes: Array, appeared: Array, vanished: Array) -> Int:
    """Set the occupied and free voxels of the blocks in `slots` (k,) as their evidence (k, 512) int8 says, in place.

    planes             : (capacity, 2, 8) uint64, bits as in `mapping.kernels.nearest`, of OCCUPIED and FREE
    appeared, vanished : (k, 2, 8) uint64, filled: the bits that were set, those that were cleared

    Returns how many bits changed.
    """
    one = np.uint64(1)
    changes = 0
    for n in range(slots.shape[0]):
        for x in range(8):
            occupied = free = np.uint64(0)
            for bit in range(64):
                value = evidence[n, x << 6 | bit]
                occupied |= np.uint64(value >= 0) << np.uint64(bit)
                free |= np.uint64((value < 0) & (value != UNKNOWN)) << np.uint64(bit)
            for plane in range(2):
                now = occupied if plane == OCCUPIED else free
                before = planes[slots[n], plane, x]
                appeared[n, plane, x] = now & ~before
                vanished[n, plane, x] = before & ~now
                planes[slots[n], plane, x] = now
                different = now ^ before
                while different:
                    different &= different - one
                    changes += 1
    return changes


@njit(cache=True, parallel=True)
def read_crossings(
    table: Array, distance: Array, weight: Array, blocks: Array, slots: Array, planes: Array, changed: Array
) -> None:
    """Set the sites of `blocks` (k, 3) as the signed distances (capacity, 512) of their source say, in place.

    planes  : (capacity', 2, 8) uint64, of BEFORE and BEHIND; slots (k,) are the blocks' places in it
    changed : (k, 2, 8) uint64, filled: the sites that there were and those that there are
    """
    for n in prange(blocks.shape[0]):
        near = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], near)
        for x in range(8):
            before = behind = np.uint64(0)
            for bit in range(64):
                i, j, k = x + 1, (bit >> 3) + 1, (bit & 7) + 1
                if near[i, j, k] >= 0.0:
                    crossing = (near[i - 1, j, k] < 0.0) | (near[i + 1, j, k] < 0.0) | (near[i, j - 1, k] < 0.0)
                    crossing |= (near[i, j + 1, k] < 0.0) | (near[i, j, k - 1] < 0.0) | (near[i, j, k + 1] < 0.0)
                    before |= np.uint64(crossing) << np.uint64(bit)
                elif near[i, j, k] < 0.0:
                    crossing = (near[i - 1, j, k] >= 0.0) | (near[i + 1, j, k] >= 0.0) | (near[i, j - 1, k] >= 0.0)
                    crossing |= (near[i, j + 1, k] >= 0.0) | (near[i, j, k - 1] >= 0.0) | (near[i, j, k + 1] >= 0.0)
                    behind |= np.uint64(crossing) << np.uint64(bit)
            for plane in range(2):
                now = before if plane == BEFORE else behind
                changed[n, plane, x] = planes[slots[n], plane, x] | now
                planes[slots[n], plane, x] = now


@njit(cache=True)
def bound_bits(words: Array, box: Array) -> Int:
    """The box (6,) of the bits that are set in words (8,), filled; returns how many there are."""
    box[:3] = 8
    box[3:] = -1
    count = 0
    for x in range(8):
        for bit in range(64):
            if (words[x] >> np.uint64(bit)) & np.uint64(1):
                y, z = bit >> 3, bit & 7
                box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
                box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)
                count += 1
    return count


@njit(cache=True)
def list_reached(
    cells: Array,
    changed: Array,
    offsets: Array,
    reach: Array,
    deepest: Array,
    grid: Array,
    rank: Array,
    targets: Array,
    pairs: Array,
) -> tuple[Int, Int]:
    """The blocks that changes of sites can reach, and which changes reach each.

    cells   : (k, 3) int64, the cells of the grid in which sites changed; these blocks are targets in any case
    changed : (k, n, 8) uint64, the sites of each plane that changed
    offsets : see `mapping.kernels.nearest.find_nearest`
    reach   : (capacity, n) int32, the largest squared distance to a site of each plane that a voxel of a block has
    deepest : (n,) int64, no block's reach is larger
    grid    : (nx, ny, nz) int32 slots, −1 where there is no block
    rank    : (nx, ny, nz) int32, all −1; scratch
    targets : (m, 3) int64, filled: cells, first those that changed; there must be room for all
    pairs   : (p, 2) int32, filled as far as there is room: row of targets, row of changed

    Returns the numbers of targets and of pairs.
    """
    nx, ny, nz = grid.shape
    box = np.empty(6, np.int64)
    n_targets = n_pairs = 0
    for n in range(cells.shape[0]):
        x, y, z = cells[n, 0], cells[n, 1], cells[n, 2]
        rank[x, y, z] = n_targets
        targets[n_targets] = cells[n]
        n_targets += 1
    for n in range(cells.shape[0]):
        for plane in range(changed.shape[1]):
            if bound_bits(changed[n, plane], box) == 0:
                continue
            for o in range(offsets.shape[0]):
                if offsets[o, 3] > deepest[plane]:
                    break
                x, y, z = cells[n, 0] + offsets[o, 0], cells[n, 1] + offsets[o, 1], cells[n, 2] + offsets[o, 2]
                if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
                    continue
                slot = grid[x, y, z]
                if slot < 0 or reach[slot, plane] < offsets[o, 3]:
                    continue
                between = gap(box[0], box[3], 8 * offsets[o, 0], 8 * offsets[o, 0] + 7) ** 2
                between += gap(box[1], box[4], 8 * offsets[o, 1], 8 * offsets[o, 1] + 7) ** 2
                between += gap(box[2], box[5], 8 * offsets[o, 2], 8 * offsets[o, 2] + 7) ** 2
                if between > reach[slot, plane]:
                    continue
                if rank[x, y, z] < 0:
                    rank[x, y, z] = n_targets
                    targets[n_targets, 0], targets[n_targets, 1], targets[n_targets, 2] = x, y, z
                    n_targets += 1
                if n_pairs < pairs.shape[0]:
                    pairs[n_pairs, 0], pairs[n_pairs, 1] = rank[x, y, z], n
                n_pairs += 1
    return n_targets, n_pairs
