"""Blocks of 8³ voxels that keep a record only for the voxels that have something to say.

A block is eight slabs of 64 voxels. `masks` (n, 8) uint64 has a bit for each voxel of a slab that has a record, `first`
(n, 8) int32 the row of a slab's first record: a voxel's row is found by counting the bits below its own. The records of
a block lie in one segment, in order of the voxels, whose length is a multiple of 8. A *cell* is slot · 512 + voxel.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any

CHUNK = 8
"""Segments are so many records long, or a multiple of it."""
CLASSES = 512 // CHUNK + 1
"""Lengths that segments can have, in chunks, with 0."""

_ONE = np.uint64(1)
_TWO = np.uint64(2)
_FOUR = np.uint64(4)
_TOP = np.uint64(56)
_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_EIGHTS = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM = np.uint64(0x0101010101010101)


@njit(cache=True, inline="always")
def count_bits(mask: Int) -> Int:
    """How many bits of a uint64 are set."""
    mask = mask - ((mask >> _ONE) & _PAIRS)
    mask = (mask & _FOURS) + ((mask >> _TWO) & _FOURS)
    mask = (mask + (mask >> _FOUR)) & _EIGHTS
    return np.int64((mask * _SUM) >> _TOP)


@njit(cache=True, inline="always")
def has_record(masks: Array, cell: Int) -> Any:
    """Whether a cell ≥ 0 has a record."""
    return masks[cell >> 9, (cell >> 6) & 7] & (_ONE << np.uint64(cell & 63)) != np.uint64(0)


@njit(cache=True, inline="always")
def row_of(masks: Array, first: Array, cell: Int) -> Int:
    """The row of the record of a cell ≥ 0, −1 where it has none."""
    slot, slab = cell >> 9, (cell >> 6) & 7
    bit = _ONE << np.uint64(cell & 63)
    mask = masks[slot, slab]
    if mask & bit == np.uint64(0):
        return np.int64(-1)
    return np.int64(first[slot, slab]) + count_bits(mask & (bit - _ONE))


@njit(cache=True)
def rows_of(masks: Array, first: Array, cells: Array, rows: Array) -> None:
    """The row (n,) of each cell (n,), −1 where it has no record or is below 0, in place."""
    for n in range(cells.shape[0]):
        rows[n] = row_of(masks, first, np.int64(cells[n])) if cells[n] >= 0 else -1


@njit(cache=True, inline="always")
def _remember(masks: Array, first: Array, slot: Int, slots: Array, old_masks: Array, starts: Array, n: Int) -> Int:
    """Keep what a block was like before the first change of a batch, in place; returns how many blocks were kept.

    A block that is kept has −2 − its place in the list in place of the row where it starts.
    """
    if first[slot, 0] <= -2:
        return n
    slots[n], starts[n] = slot, first[slot, 0]
    old_masks[n] = masks[slot]
    first[slot, 0] = -2 - n
    return n + 1


@njit(cache=True)
def want(masks: Array, first: Array, cells: Array, slots: Array, old_masks: Array, starts: Array) -> Int:
    """Set the bits of cells (n,), those below 0 left out; returns how many blocks changed. `settle` must follow.

    masks, first are changed in place; slots, old_masks (·, 8), starts: what the blocks that change were like.
    """
    n = 0
    for c in range(cells.shape[0]):
        cell = np.int64(cells[c])
        if cell < 0:
            continue
        if not has_record(masks, cell):
            n = _remember(masks, first, cell >> 9, slots, old_masks, starts, n)
            masks[cell >> 9, (cell >> 6) & 7] |= _ONE << np.uint64(cell & 63)
    return n


@njit(cache=True)
def drop(masks: Array, first: Array, cells: Array, slots: Array, old_masks: Array, starts: Array) -> Int:
    """Clear the bits of cells (n,), in place, as `want` sets them."""
    n = 0
    for c in range(cells.shape[0]):
        cell = np.int64(cells[c])
        if cell < 0:
            continue
        if has_record(masks, cell):
            n = _remember(masks, first, cell >> 9, slots, old_masks, starts, n)
            masks[cell >> 9, (cell >> 6) & 7] &= ~(_ONE << np.uint64(cell & 63))
    return n


@njit(cache=True)
def count_records(masks: Array) -> Int:
    """How many bits (n, 8) masks have."""
    total = 0
    for n in range(masks.shape[0]):
        for slab in range(8):
            total += count_bits(masks[n, slab])
    return total


@njit(cache=True)
def settle(
    masks: Array, first: Array, slots: Array, old_masks: Array, starts: Array, free: Array, links: Array, end: Int
) -> tuple[Array, Array, Array, Int]:
    """Give blocks whose bits changed segments that fit, in place.

    free (CLASSES,) int64: the first unused segment of each length in chunks, −1 = none; links (·,) int32: the next one
    of its length, by chunk; end: the first row that was never in use.
    Returns the rows that records move from and to (m,), together, the rows that are new (k,), and the new end.
    """
    size = count_records(old_masks)
    source, target = np.empty(size, np.int64), np.empty(size, np.int64)
    wanted = 0
    for n in range(slots.shape[0]):
        for slab in range(8):
            wanted += count_bits(masks[slots[n], slab] & ~old_masks[n, slab])
    fresh = np.empty(wanted, np.int64)
    moved = made = 0
    for n in range(slots.shape[0]):
        slot, start = slots[n], starts[n]
        before = (count_records(old_masks[n : n + 1]) + CHUNK - 1) // CHUNK
        after = (count_records(masks[slot : slot + 1]) + CHUNK - 1) // CHUNK
        place = start
        if after > before:
            if free[after] >= 0:
                place = free[after]
                free[after] = links[place // CHUNK]
            else:
                place = end
                end += after * CHUNK
            if before:
                links[start // CHUNK] = free[before]
                free[before] = start
        elif after < before:
            tail = start + after * CHUNK
            links[tail // CHUNK] = free[before - after]
            free[before - after] = tail
            if after == 0:
                place = np.int64(-1)
        old, new = start, place
        for slab in range(8):
            first[slot, slab] = new
            was, now = old_masks[n, slab], masks[slot, slab]
            either = was | now
            while either:
                bit = either & (~either + _ONE)
                either ^= bit
                if now & bit:
                    if was & bit:
                        source[moved], target[moved] = old, new
                        moved += 1
                    else:
                        fresh[made] = new
                        made += 1
                    new += 1
                if was & bit:
                    old += 1
    return source[:moved], target[:moved], fresh, end


@njit(cache=True)
def shift(records: Array, source: Array, target: Array, fresh: Array) -> None:
    """Move the records (R, k) of the rows `source` (m,) to `target` (m,), together, and empty those of the rows `fresh`
    (n,), in place."""
    held = np.empty((source.shape[0], records.shape[1]), records.dtype)
    for m in range(source.shape[0]):
        for c in range(records.shape[1]):
            held[m, c] = records[source[m], c]
    for m in range(target.shape[0]):
        for c in range(records.shape[1]):
            records[target[m], c] = held[m, c]
    for n in range(fresh.shape[0]):
        for c in range(records.shape[1]):
            records[fresh[n], c] = 0


@njit(cache=True)
def lay_out(masks: Array, first: Array, moves: Array) -> Int:
    """Give the blocks (n, 8) segments one behind the other, in place; returns where the last ends.

    moves (n, 3) int64, out: where a block's records began, where they begin now, and how many they are
    """
    end = 0
    for n in range(masks.shape[0]):
        row = end
        moves[n, 0], moves[n, 1] = first[n, 0], end
        for slab in range(8):
            first[n, slab] = row
            row += count_bits(masks[n, slab])
        moves[n, 2] = row - end
        if row == end:
            first[n, 0] = -1
        end += (row - end + CHUNK - 1) // CHUNK * CHUNK
    return end


@njit(cache=True)
def move(moves: Array, width: Int, source: Array, target: Array) -> None:
    """Copy records of `width` bytes from `source` to `target`, both uint8 (·,), as `lay_out` says, in place."""
    for n in range(moves.shape[0]):
        a, b, size = moves[n, 0] * width, moves[n, 1] * width, moves[n, 2] * width
        target[b : b + size] = source[a : a + size]


@njit(cache=True)
def list_cells(masks: Array, slots: Array, cells: Array) -> None:
    """The cells (n,) of all records in the blocks `slots` (m,), block by block, in place."""
    n = 0
    for m in range(slots.shape[0]):
        for slab in range(8):
            mask = masks[slots[m], slab]
            while mask:
                bit = mask & (~mask + _ONE)
                mask ^= bit
                cells[n] = slots[m] << 9 | slab << 6 | count_bits(bit - _ONE)
                n += 1
