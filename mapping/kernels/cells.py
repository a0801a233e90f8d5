"""The sparse tree of uniform cells over hashed 8³ blocks: finding, splitting, merging.

A *cell* of level L is a cube of 2^L blocks along an edge; level 0 is one block of 8³ voxels. Each cell that exists is a
*row* of plain arrays: its index `ijk` (n, 3) at its level, `level` (n,), `slot` (n,) and the revision `changed_at` (n,)
at which it changed last. slot ≥ 0 is a row of `payload` (m, 512) int8, the voxels of a block that differ; a slot below
0 says that all voxels of the cell are the same, see `uniform` and `value_of`. No two cells overlap. `table` (k, 2)
int64, k a power of two, is the hash from a cell's key to its row; row −1 marks an empty place.

`counts` holds N_ROWS … TOP: rows given out, rows free again (the stack `free_rows`), slots given out, slots free again
(`free_slots`), and the highest level that was ever in use.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, home

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

UNKNOWN = -128
"""The byte of a voxel of which nothing is known."""
MAX_LEVEL = 7
"""Cells are at most 128 blocks, 1024 voxels, along an edge."""
N_ROWS, N_FREE_ROWS, N_SLOTS, N_FREE_SLOTS, TOP = 0, 1, 2, 3, 4
GONE = 255
"""The level of a row that is free."""

_MASK = (1 << 21) - 1


@njit(cache=True, inline="always")
def uniform(value: Int) -> Int:
    """The slot that says: all voxels have this value, −128 … 127."""
    return -129 - value


@njit(cache=True, inline="always")
def value_of(slot: Int) -> Int:
    """The value that all voxels of a cell with this slot < 0 have."""
    return -129 - slot


@njit(cache=True, inline="always")
def pack(level: Int, i: Int, j: Int, k: Int) -> Int:
    """One int64 for a cell; different for different cells of all levels within the limit.

    Indices at level L ≥ 1 lie within ±2^(20−L), so that all these levels fit side by side into one range of i.
    """
    if level == 0:
        return (
            ((np.int64(i) + BLOCK_LIMIT) & _MASK) << 42
            | ((np.int64(j) + BLOCK_LIMIT) & _MASK) << 21
            | ((np.int64(k) + BLOCK_LIMIT) & _MASK)
        )
    half = BLOCK_LIMIT >> level
    before = 2 * BLOCK_LIMIT - 4 * half  # places that the levels below take: 2^20 + 2^19 + …
    return ~(
        ((np.int64(i) + half + before) & _MASK) << 42
        | ((np.int64(j) + half) & _MASK) << 21
        | ((np.int64(k) + half) & _MASK)
    )


@njit(cache=True)
def find_row(table: Array, key: Int) -> Int:
    """The row of the cell with this key, −1 where there is none."""
    size = table.shape[0]
    place = home(key, size)
    while True:
        row = table[place, 1]
        if row < 0 or table[place, 0] == key:
            return row
        place = (place + 1) & (size - 1)


@njit(cache=True)
def find_cell(table: Array, top: Int, bi: Int, bj: Int, bk: Int) -> Int:
    """The row of the cell, of whatever level up to `top`, that block (bi, bj, bk) lies in; −1 where there is none."""
    for level in range(top + 1):
        row = find_row(table, pack(level, bi >> level, bj >> level, bk >> level))
        if row >= 0:
            return row
    return -1


@njit(cache=True)
def enter(table: Array, key: Int, row: Int) -> None:
    """Enter a key that is not there yet into `table`, in place; there must be room."""
    size = table.shape[0]
    place = home(key, size)
    while table[place, 1] >= 0:
        place = (place + 1) & (size - 1)
    table[place, 0] = key
    table[place, 1] = row


@njit(cache=True)
def remove(table: Array, key: Int) -> None:
    """Take a key that is there out of `table`, in place; what was pushed behind it moves up."""
    size = table.shape[0]
    hole = home(key, size)
    while table[hole, 0] != key or table[hole, 1] < 0:
        hole = (hole + 1) & (size - 1)
    place = hole
    while True:
        place = (place + 1) & (size - 1)
        if table[place, 1] < 0:
            break
        wanted = home(table[place, 0], size)
        if ((place - wanted) & (size - 1)) >= ((place - hole) & (size - 1)):
            table[hole, 0] = table[place, 0]
            table[hole, 1] = table[place, 1]
            hole = place
    table[hole, 1] = -1


@njit(cache=True)
def refill(table: Array, ijk: Array, level: Array, n_rows: Int) -> None:
    """Enter the first `n_rows` rows that are in use into an empty `table`, in place."""
    for row in range(n_rows):
        if level[row] != GONE:
            enter(table, pack(np.int64(level[row]), ijk[row, 0], ijk[row, 1], ijk[row, 2]), row)


@njit(cache=True)
def add_row(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, counts: Array,
    of_level: Int, i: Int, j: Int, k: Int, with_slot: Int, revision: Int,
) -> Int:  # fmt: skip
    """Add a cell that overlaps no other, in place; returns its row. There must be room."""
    if counts[N_FREE_ROWS] > 0:
        counts[N_FREE_ROWS] -= 1
        row = free_rows[counts[N_FREE_ROWS]]
    else:
        row = counts[N_ROWS]
        counts[N_ROWS] += 1
    ijk[row, 0] = i
    ijk[row, 1] = j
    ijk[row, 2] = k
    level[row] = of_level
    slot[row] = with_slot
    changed_at[row] = revision
    counts[TOP] = max(counts[TOP], np.int64(of_level))
    enter(table, pack(of_level, i, j, k), row)
    return row


@njit(cache=True)
def drop_row(table: Array, ijk: Array, level: Array, free_rows: Array, counts: Array, row: Int) -> None:
    """Take a uniform cell out, in place."""
    remove(table, pack(np.int64(level[row]), ijk[row, 0], ijk[row, 1], ijk[row, 2]))
    level[row] = GONE
    free_rows[counts[N_FREE_ROWS]] = row
    counts[N_FREE_ROWS] += 1


@njit(cache=True, inline="always")
def has_room(ijk: Array, payload: Array, counts: Array) -> bool:
    """Whether any one block can be given voxels of its own, even if a cell must be split down to it."""
    rows_left = ijk.shape[0] - counts[N_ROWS]
    slots_left = counts[N_FREE_SLOTS] + payload.shape[0] - counts[N_SLOTS]
    return bool(rows_left >= 8 * (MAX_LEVEL + 1) and slots_left > 0)


@njit(cache=True)
def take_slot(payload: Array, free_slots: Array, counts: Array, value: Int) -> Int:
    """A row of `payload`, filled with `value`, in place; −1 where there is no room."""
    if counts[N_FREE_SLOTS] > 0:
        counts[N_FREE_SLOTS] -= 1
        taken = np.int64(free_slots[counts[N_FREE_SLOTS]])
    elif counts[N_SLOTS] < payload.shape[0]:
        taken = counts[N_SLOTS]
        counts[N_SLOTS] += 1
    else:
        return -1
    payload[taken, :] = value
    return taken


@njit(cache=True)
def split_down(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, counts: Array,
    row: Int, bi: Int, bj: Int, bk: Int,
) -> Int:  # fmt: skip
    """Split a uniform cell until block (bi, bj, bk) is a cell of its own, in place; returns its row, whose other
    siblings keep value and revision. There must be room for 7 rows a level."""
    same, revision = slot[row], changed_at[row]
    coarse = np.int64(level[row])
    drop_row(table, ijk, level, free_rows, counts, row)
    found: Int = np.int64(-1)
    for below in range(coarse - 1, -1, -1):
        i0, j0, k0 = bi >> (below + 1) << 1, bj >> (below + 1) << 1, bk >> (below + 1) << 1
        for child in range(8):
            i, j, k = i0 + (child >> 2), j0 + (child >> 1 & 1), k0 + (child & 1)
            here = i == bi >> below and j == bj >> below and k == bk >> below
            if here and below > 0:
                continue
            new = add_row(
                table, ijk, level, slot, changed_at, free_rows, counts, below, i, j, k, same, revision
            )  # fmt: skip
            if here:
                found = new
    return found


@njit(cache=True)
def merge_up(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, counts: Array, row: Int
) -> None:
    """While a uniform cell and its seven siblings are the same, make them one cell of the next level, in place.

    The one cell counts as changed when the last of them was.
    """
    while level[row] < MAX_LEVEL:
        at = np.int64(level[row])
        i0, j0, k0 = ijk[row, 0] >> 1 << 1, ijk[row, 1] >> 1 << 1, ijk[row, 2] >> 1 << 1
        same, latest = slot[row], changed_at[row]
        rows = np.empty(8, np.int64)
        for child in range(8):
            sibling = find_row(table, pack(at, i0 + (child >> 2), j0 + (child >> 1 & 1), k0 + (child & 1)))
            if sibling < 0 or slot[sibling] != same:
                return
            rows[child] = sibling
            latest = max(latest, changed_at[sibling])
        for child in range(8):
            drop_row(table, ijk, level, free_rows, counts, rows[child])
        row = add_row(
            table, ijk, level, slot, changed_at, free_rows, counts, at + 1, i0 >> 1, j0 >> 1, k0 >> 1, same, latest
        )  # fmt: skip


# -- blocks out of cells and into them --------------------------------------------------------------------------


@njit(cache=True)
def read_blocks(table: Array, slot: Array, payload: Array, top: Int, block_ijk: Array, values: Array) -> None:
    """Fill `values` (n, 512) int8 with the voxels of blocks (n, 3); UNKNOWN where there is no cell."""
    for n in range(block_ijk.shape[0]):
        row = find_cell(table, top, block_ijk[n, 0], block_ijk[n, 1], block_ijk[n, 2])
        if row < 0:
            values[n, :] = UNKNOWN
        elif slot[row] < 0:
            values[n, :] = value_of(slot[row])
        else:
            values[n, :] = payload[slot[row]]


@njit(cache=True)
def write_blocks(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, payload: Array, free_rows: Array,
    free_slots: Array, counts: Array, start: Int, block_ijk: Array, values: Array, revision: Int, changed: Array,
) -> Int:  # fmt: skip
    """Give blocks (n, 3) the voxels `values` (n, 512) int8, in place, from number `start` on; fills changed (n,) bool.

    Equal voxels are kept as one. Returns the number to go on with when room ran out, or n.
    """
    for n in range(start, block_ijk.shape[0]):
        if not has_room(ijk, payload, counts):
            return n
        bi, bj, bk = np.int64(block_ijk[n, 0]), np.int64(block_ijk[n, 1]), np.int64(block_ijk[n, 2])
        first = np.int64(values[n, 0])
        same, equal = True, True
        row = find_cell(table, counts[TOP], bi, bj, bk)
        old = np.int64(uniform(UNKNOWN)) if row < 0 else np.int64(slot[row])
        for w in range(512):
            same &= values[n, w] == first
            equal &= values[n, w] == (payload[old, w] if old >= 0 else value_of(old))
        changed[n] = not equal
        if equal:
            continue
        if row < 0:
            row = add_row(
                table, ijk, level, slot, changed_at, free_rows, counts, 0, bi, bj, bk, uniform(UNKNOWN), revision
            )  # fmt: skip
        elif level[row] > 0:
            row = split_down(table, ijk, level, slot, changed_at, free_rows, counts, row, bi, bj, bk)
        changed_at[row] = revision
        if same:
            if slot[row] >= 0:
                free_slots[counts[N_FREE_SLOTS]] = slot[row]
                counts[N_FREE_SLOTS] += 1
            slot[row] = uniform(first)
            merge_up(table, ijk, level, slot, changed_at, free_rows, counts, row)
        else:
            if slot[row] < 0:
                slot[row] = take_slot(payload, free_slots, counts, UNKNOWN)
            payload[slot[row], :] = values[n]
    return block_ijk.shape[0]


@njit(cache=True)
def copy_box(box: Array, table: Array, slot: Array, payload: Array, top: Int, first: Array) -> None:
    """Fill `box` (nx, ny, nz) int8 with the voxels from `first` (3,) on; UNKNOWN where there is no cell."""
    i0, j0, k0 = first[0], first[1], first[2]
    i1, j1, k1 = i0 + box.shape[0], j0 + box.shape[1], k0 + box.shape[2]
    for bi in range(i0 >> 3, ((i1 - 1) >> 3) + 1):
        for bj in range(j0 >> 3, ((j1 - 1) >> 3) + 1):
            for bk in range(k0 >> 3, ((k1 - 1) >> 3) + 1):
                row = find_cell(table, top, bi, bj, bk)
                at = np.int64(uniform(UNKNOWN)) if row < 0 else np.int64(slot[row])
                for i in range(max(i0, bi * 8), min(i1, bi * 8 + 8)):
                    for j in range(max(j0, bj * 8), min(j1, bj * 8 + 8)):
                        for k in range(max(k0, bk * 8), min(k1, bk * 8 + 8)):
                            box[i - i0, j - j0, k - k0] = (
                                payload[at, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] if at >= 0 else value_of(at)
                            )


@njit(cache=True)
def fill_cells(
    table: Array, ijk: Array, level: Array, slot: Array, changed_at: Array, free_rows: Array, counts: Array,
    cell_ijk: Array, cell_level: Array, cell_value: Array, revision: Int,
) -> None:  # fmt: skip
    """Add uniform cells that overlap no other, in place, and merge what can be. There must be room."""
    for n in range(cell_ijk.shape[0]):
        at = np.int64(cell_level[n])
        i, j, k = np.int64(cell_ijk[n, 0]), np.int64(cell_ijk[n, 1]), np.int64(cell_ijk[n, 2])
        row = add_row(
            table, ijk, level, slot, changed_at, free_rows, counts, at, i, j, k, uniform(np.int64(cell_value[n])),
            revision,
        )  # fmt: skip
        merge_up(table, ijk, level, slot, changed_at, free_rows, counts, row)


@njit(cache=True)
def distinct(ijk: Array, level: Array, table: Array) -> bool:
    """Enter all rows into an empty `table`, in place; False when a block is named twice, or lies in a coarser cell."""
    top: Int = np.int64(0)
    for row in range(ijk.shape[0]):
        top = max(top, np.int64(level[row]))
        key = pack(np.int64(level[row]), ijk[row, 0], ijk[row, 1], ijk[row, 2])
        if find_row(table, key) >= 0:
            return False
        enter(table, key, row)
    for row in range(ijk.shape[0]):
        own = np.int64(level[row])
        for above in range(own + 1, top + 1):
            up = above - own
            if find_row(table, pack(above, ijk[row, 0] >> up, ijk[row, 1] >> up, ijk[row, 2] >> up)) >= 0:
                return False
    return True


# -- questions -------------------------------------------------------------------------------------------------


@njit(cache=True, parallel=True)
def look_up(table: Array, slot: Array, payload: Array, top: Int, p_map: Array, per_voxel: Float, values: Array) -> None:
    """The voxel that holds each point (n, 3) [m]: fills values (n,) int8, UNKNOWN where there is none.

    per_voxel : 1 / voxel size [1/m]
    """
    bound = 8.0 * BLOCK_LIMIT
    part = 8192
    for p in prange(-(-p_map.shape[0] // part)):
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        at: Int = np.int64(uniform(UNKNOWN))
        for n in range(p * part, min(p_map.shape[0], (p + 1) * part)):
            x = np.floor(p_map[n, 0] * per_voxel)
            y = np.floor(p_map[n, 1] * per_voxel)
            z = np.floor(p_map[n, 2] * per_voxel)
            if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
                values[n] = UNKNOWN
                continue
            i, j, k = np.int64(x), np.int64(y), np.int64(z)
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                last_i, last_j, last_k = bi, bj, bk
                row = find_cell(table, top, bi, bj, bk)
                at = np.int64(uniform(UNKNOWN)) if row < 0 else np.int64(slot[row])
            values[n] = payload[at, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] if at >= 0 else value_of(at)


@njit(cache=True)
def sum_up_cubes(
    table: Array, slot: Array, payload: Array, top: Int, corners: Array, edge: Int, probability: Array,
    highest: Array, mean: Array,
) -> None:  # fmt: skip
    """The known voxels of cubes: the highest value and the mean probability, UNKNOWN and NaN where there are none.

    corners     : (n, 3) int64, lowest voxel of each cube, a multiple of `edge`, its edge in voxels (a power of two)
    probability : (256,) of each value, from −128 on
    highest (n,) int8, mean (n,) float64: filled
    """
    for n in range(corners.shape[0]):
        i0, j0, k0 = corners[n, 0], corners[n, 1], corners[n, 2]
        inner = min(edge, 8)
        best = np.int64(UNKNOWN)
        total, count = 0.0, 0
        for bi in range(i0 >> 3, (i0 + edge - 1 >> 3) + 1):
            for bj in range(j0 >> 3, (j0 + edge - 1 >> 3) + 1):
                for bk in range(k0 >> 3, (k0 + edge - 1 >> 3) + 1):
                    row = find_cell(table, top, bi, bj, bk)
                    if row < 0:
                        continue
                    if slot[row] < 0:
                        value = np.int64(value_of(np.int64(slot[row])))
                        if value != UNKNOWN:
                            best = max(best, value)
                            total += probability[value + 128] * inner**3
                            count += inner**3
                        continue
                    for i in range(i0 & 7, (i0 & 7) + inner):
                        for j in range(j0 & 7, (j0 & 7) + inner):
                            for k in range(k0 & 7, (k0 & 7) + inner):
                                value = np.int64(payload[slot[row], i << 6 | j << 3 | k])
                                if value != UNKNOWN:
                                    best = max(best, value)
                                    total += probability[value + 128]
                                    count += 1
        highest[n] = best
        mean[n] = total / count if count else np.nan


@njit(cache=True)
def list_leaves(
    ijk: Array, level: Array, slot: Array, payload: Array, n_rows: Int, finest: Int,
    corners: Array, edges: Array, values: Array,
) -> Int:  # fmt: skip
    """The leaves of the octree, none finer than 2^finest voxels (0 … 3): cubes whose known voxels are all the same, or
    that are 2^finest voxels wide, with their highest value; in place.

    corners (n, 3) int64 [voxels], edges (n,) int64 [voxels], values (n,) int8. Cubes of which nothing is known are left
    out; a cube wider than 2^finest is one leaf only where all of its voxels are known. Returns how many there are;
    beyond n they are counted and not written.
    """
    count = 0
    best = np.empty((4, 512), np.int16)  # a pyramid a block: the highest of each cube …
    alike = np.empty((4, 512), np.bool_)  # … and whether all of its voxels are the same
    for row in range(n_rows):
        if level[row] == GONE:
            continue
        scale = 8 << np.int64(level[row])
        if slot[row] < 0:
            if value_of(np.int64(slot[row])) != UNKNOWN:
                if count < corners.shape[0]:
                    corners[count, 0] = ijk[row, 0] * scale
                    corners[count, 1] = ijk[row, 1] * scale
                    corners[count, 2] = ijk[row, 2] * scale
                    edges[count] = scale
                    values[count] = value_of(np.int64(slot[row]))
                count += 1
            continue
        voxels = payload[slot[row]]
        for w in range(512):
            best[0, w] = voxels[w]
            alike[0, w] = True
        for l in range(1, 4):
            side, below = 8 >> l, 16 >> l
            for a in range(side):
                for b in range(side):
                    for c in range(side):
                        first = (2 * a * below + 2 * b) * below + 2 * c
                        high, same = np.int16(UNKNOWN), True
                        for child in range(8):
                            w = first + (child >> 2) * below * below + (child >> 1 & 1) * below + (child & 1)
                            high = max(high, best[l - 1, w])
                            same &= alike[l - 1, w] and best[l - 1, w] == best[l - 1, first]
                        best[l, (a * side + b) * side + c] = high
                        alike[l, (a * side + b) * side + c] = same
        for l in range(3, finest - 1, -1):
            side = 8 >> l
            for a in range(side):
                for b in range(side):
                    for c in range(side):
                        w = (a * side + b) * side + c
                        if best[l, w] == UNKNOWN or not (alike[l, w] or l == finest):
                            continue
                        covered = False
                        for up in range(l + 1, 4):
                            s = 8 >> up
                            covered |= alike[up, ((a >> up - l) * s + (b >> up - l)) * s + (c >> up - l)]
                        if covered:
                            continue
                        if count < corners.shape[0]:
                            corners[count, 0] = 8 * ijk[row, 0] + (a << l)
                            corners[count, 1] = 8 * ijk[row, 1] + (b << l)
                            corners[count, 2] = 8 * ijk[row, 2] + (c << l)
                            edges[count] = 1 << l
                            values[count] = np.int8(best[l, w])
                        count += 1
    return count
