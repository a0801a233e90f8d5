"""The block hash: an open-addressed table on one plain array, so that any kernel can read it.

`table` is (m, 2) int64 with m a power of two: column 0 the packed block index, column 1 the slot; slot −1 marks an
empty row. One probe touches one cache line. Block indices lie within ±2²⁰ (at 1 cm voxels: ±83 km).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any  # a Python int outside the JIT, a machine integer inside

BLOCK_LIMIT = 1 << 20
"""Block indices are in [−BLOCK_LIMIT, BLOCK_LIMIT)."""

_MASK = (1 << 21) - 1
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True, inline="always")
def pack(bi: Int, bj: Int, bk: Int) -> Int:
    """One int64 for a block index; different for different blocks within the limit."""
    return (
        ((np.int64(bi) + BLOCK_LIMIT) & _MASK) << 42
        | ((np.int64(bj) + BLOCK_LIMIT) & _MASK) << 21
        | ((np.int64(bk) + BLOCK_LIMIT) & _MASK)
    )


@njit(cache=True, inline="always")
def home(key: Int, size: Int) -> Int:
    """The row at which the search for `key` begins in a table of `size` rows."""
    mixed = np.uint64(key) * _GOLDEN
    return np.int64((mixed ^ (mixed >> np.uint64(29))) >> np.uint64(20)) & (np.int64(size) - 1)


@njit(cache=True)
def lookup(table: Array, bi: Int, bj: Int, bk: Int) -> Int:
    """The slot of block (bi, bj, bk), −1 where there is none."""
    key = pack(bi, bj, bk)
    size = table.shape[0]
    row = home(key, size)
    while True:
        slot = table[row, 1]
        if slot < 0:
            return -1
        if table[row, 0] == key:
            return slot
        row = (row + 1) & (size - 1)


@njit(cache=True)
def find_or_insert(table: Array, bi: Int, bj: Int, bk: Int, slot: Int) -> Int:
    """The slot of block (bi, bj, bk); where there is none, `slot` is entered into the table, in place."""
    key = pack(bi, bj, bk)
    size = table.shape[0]
    row = home(key, size)
    while True:
        found = table[row, 1]
        if found < 0:
            table[row, 0] = key
            table[row, 1] = slot
            return slot
        if table[row, 0] == key:
            return found
        row = (row + 1) & (size - 1)


@njit(cache=True)
def room_for(fresh: Array, found: Array, n: Int, first: Int, more: Int) -> tuple[Array, Array]:
    """`fresh` and `found`, see `number_new`, with room for so many more than the n blocks that they hold; copies where
    they had none. To be called now and then: an array that is assigned in a loop is counted as a reference each time.
    """
    size = len(fresh)
    while size < 2 * (n + more):
        size *= 2
    if size > len(fresh):
        fresh = np.full((size, 2), -1, np.int64)
        for m in range(n):
            find_or_insert(fresh, found[m, 0], found[m, 1], found[m, 2], first + m)
        found = np.concatenate((found[:n], np.empty((size - n, 3), found.dtype)))
    return fresh, found


@njit(cache=True)
def number_new(fresh: Array, found: Array, n: Int, first: Int, bi: Int, bj: Int, bk: Int) -> Int:
    """The slot of a block that a table does not have, where such blocks are numbered on from `first` as they appear.

    fresh (m, 2) int64, found (m, 3) int32: a table of these blocks, and the blocks; n: how many there are already. Both
    change in place and must have room, see `room_for`. The block is new where its slot is first + n.
    """
    slot = find_or_insert(fresh, bi, bj, bk, first + n)
    if slot == first + n:
        found[n, 0], found[n, 1], found[n, 2] = bi, bj, bk
    return slot


@njit(cache=True)
def find_all(table: Array, block_ijk: Array, slots: Array) -> Int:
    """Write the slot of each block (k, 3) into `slots` (k,), −1 where there is none; returns how many are missing."""
    missing = 0
    for n in range(block_ijk.shape[0]):
        slots[n] = lookup(table, block_ijk[n, 0], block_ijk[n, 1], block_ijk[n, 2])
        missing += slots[n] < 0
    return missing


@njit(cache=True)
def insert_all(table: Array, stored_ijk: Array, n_blocks: Int, block_ijk: Array, slots: Array) -> Int:
    """Give a slot to each block (k, 3) that has none, in the order given; returns the new number of blocks.

    table, stored_ijk (capacity, 3), slots (k,) change in place; there must be room for every new block.
    """
    for n in range(block_ijk.shape[0]):
        bi, bj, bk = block_ijk[n, 0], block_ijk[n, 1], block_ijk[n, 2]
        slot = find_or_insert(table, bi, bj, bk, n_blocks)
        if slot == n_blocks:
            stored_ijk[slot, 0] = bi
            stored_ijk[slot, 1] = bj
            stored_ijk[slot, 2] = bk
            n_blocks += 1
        slots[n] = slot
    return n_blocks


@njit(cache=True)
def refill(table: Array, stored_ijk: Array, n_blocks: Int) -> None:
    """Enter the first `n_blocks` stored blocks into an empty `table`, in place."""
    for slot in range(n_blocks):
        find_or_insert(table, stored_ijk[slot, 0], stored_ijk[slot, 1], stored_ijk[slot, 2], slot)


@njit(cache=True)
def locate(table: Array, p_map: Array, per_voxel: float, slots: Array, local: Array) -> None:
    """Where the voxel of each point (n, 3) [m] is stored: slot (−1: nowhere) and index within the block, in place.

    per_voxel : 1 / voxel size [1/m]
    """
    last_i = last_j = last_k = np.int64(BLOCK_LIMIT)
    last_slot: Int = np.int64(-1)
    bound = 8.0 * BLOCK_LIMIT
    for n in range(p_map.shape[0]):
        x = np.floor(p_map[n, 0] * per_voxel)
        y = np.floor(p_map[n, 1] * per_voxel)
        z = np.floor(p_map[n, 2] * per_voxel)
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
            slots[n] = -1
            local[n] = 0
            continue
        i, j, k = np.int64(x), np.int64(y), np.int64(z)
        bi, bj, bk = i >> 3, j >> 3, k >> 3
        if bi != last_i or bj != last_j or bk != last_k:
            last_i, last_j, last_k = bi, bj, bk
            last_slot = lookup(table, bi, bj, bk)
        slots[n] = last_slot
        local[n] = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
