"""A grid of oriented boxes that changes box by box: what lies within reach of a point, or meets a box.

Each box is entered once, in the cell of its centre, on the level whose cells are as large as it is; so that moving one
costs the same whatever its size, and a search looks a little farther on the levels of large boxes (a loose octree
without its tree: Ulrich, *Loose Octrees*, Game Programming Gems, 2000).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels import hashing
from mapping.kernels.box_grid import CELL_LIMIT
from mapping.kernels.boxes import outside, overlap

Array = NDArray[Any]

N_LEVELS = 16
FINEST_M = 1.0
"""Edge of the cells of level 0; each level doubles it."""
_HEIGHT_LIMIT = (CELL_LIMIT >> 4) - 1


@njit(cache=True, inline="always")
def _cell(at: float, edge: float, limit: int) -> Any:
    return np.int64(min(max(np.floor(at / edge), -float(limit)), float(limit)))


@njit(cache=True)
def _unlink(slot: int, level: Array, cell: Array, before: Array, after: Array, heads: Array, n_at: Array) -> None:
    if cell[slot] < 0:
        return
    if before[slot] >= 0:
        after[before[slot]] = after[slot]
    else:
        heads[cell[slot]] = after[slot]
    if after[slot] >= 0:
        before[after[slot]] = before[slot]
    n_at[level[slot]] -= 1
    cell[slot] = -1


@njit(cache=True)
def put(
    slots: Array,
    center: Array,
    half: Array,
    axes: Array,
    level: Array,
    cell: Array,
    before: Array,
    after: Array,
    table: Array,
    heads: Array,
    n_cells: int,
    n_at: Array,
    reach: Array,
) -> int:
    """Enter the boxes in `slots` (k,), or move them to where they now are; all arrays change in place.

    center, half (n, 3), axes (n, 3, 3) : the boxes, already changed
    level, cell, before, after (n,)     : where each box is entered (cell −1: nowhere), and its neighbours in that list
    table, heads, n_cells               : hash of the cells, and the first box of each; there is room for k more cells
    n_at, reach (N_LEVELS,)             : of each level the number of boxes, and the largest half extent [m]
    Returns the new number of cells.
    """
    for slot in slots:
        _unlink(slot, level, cell, before, after, heads, n_at)
        largest = 0.0
        for r in range(3):
            extent = 0.0
            for k in range(3):
                extent += abs(axes[slot, r, k]) * half[slot, k]
            largest = max(largest, extent)
        at, edge = 0, FINEST_M
        while edge < 2.0 * largest and at < N_LEVELS - 1:
            at, edge = at + 1, 2.0 * edge
        i, j = _cell(center[slot, 0], edge, CELL_LIMIT), _cell(center[slot, 1], edge, CELL_LIMIT)
        k = _cell(center[slot, 2], edge, _HEIGHT_LIMIT) * N_LEVELS + at
        home = hashing.find_or_insert(table, i, j, k, n_cells)
        if home == n_cells:
            heads[home] = -1
            n_cells += 1
        level[slot], cell[slot], before[slot], after[slot] = at, home, -1, heads[home]
        if heads[home] >= 0:
            before[heads[home]] = slot
        heads[home] = slot
        n_at[at] += 1
        reach[at] = max(reach[at], largest)
    return n_cells


@njit(cache=True)
def drop(slots: Array, level: Array, cell: Array, before: Array, after: Array, heads: Array, n_at: Array) -> None:
    """Take the boxes in `slots` (k,) out, in place."""
    for slot in slots:
        _unlink(slot, level, cell, before, after, heads, n_at)


@njit(cache=True)
def candidates(
    low: Array,
    high: Array,
    level: Array,
    cell: Array,
    after: Array,
    table: Array,
    heads: Array,
    n_at: Array,
    reach: Array,
    n_slots: int,
) -> Array:
    """The slots (m,) of all boxes that may meet bounds (3,), each once."""
    found = np.empty(max(16, n_at.sum()), np.int32)
    n = 0
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    edge = 0.5 * FINEST_M
    for at in range(N_LEVELS):
        edge *= 2.0
        if n_at[at] == 0:
            continue
        count = 1.0
        for r in range(3):
            limit = CELL_LIMIT if r < 2 else _HEIGHT_LIMIT
            first[r] = _cell(low[r] - reach[at], edge, limit)
            last[r] = _cell(high[r] + reach[at], edge, limit)
            count *= last[r] - first[r] + 1.0
        if count > n_slots + 64:
            for slot in range(n_slots):
                if cell[slot] >= 0 and level[slot] == at:
                    found[n] = slot
                    n += 1
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    home = hashing.lookup(table, i, j, k * N_LEVELS + at)
                    slot = heads[home] if home >= 0 else -1
                    while slot >= 0:
                        found[n] = slot
                        n += 1
                        slot = after[slot]
    return found[:n].copy()


@njit(cache=True)
def near_point(
    slots: Array, center: Array, half: Array, axes: Array, layer: Array, wanted: int, p: Array, radius: float
) -> tuple[Array, Array]:
    """Of the boxes in `slots` those of layer `wanted` (−1: any) that p (3,) is within `radius` of: slots (m,) and
    distances (m,) [m], 0 inside a box."""
    found, distance = np.empty(len(slots), np.int32), np.empty(len(slots))
    n = 0
    for slot in slots:
        if wanted >= 0 and layer[slot] != wanted:
            continue
        away = outside(center[slot], half[slot], axes[slot], p[0], p[1], p[2])
        if away <= radius:
            found[n], distance[n] = slot, away
            n += 1
    return found[:n], distance[:n]


@njit(cache=True)
def meeting_box(
    slots: Array, center: Array, half: Array, axes: Array, layer: Array, wanted: int, middle: Array, reach: Array
) -> Array:
    """Of the boxes in `slots` those of layer `wanted` (−1: any) that have a point in common with the upright box of
    this middle and half size (3,)."""
    found = np.empty(len(slots), np.int32)
    n = 0
    upright = np.eye(3)
    for slot in slots:
        if wanted >= 0 and layer[slot] != wanted:
            continue
        inside = True
        apart = False
        for r in range(3):
            away = abs(center[slot, r] - middle[r]) - reach[r]
            extent = 0.0
            for k in range(3):
                extent += abs(axes[slot, r, k]) * half[slot, k]
            inside &= away <= 0.0
            apart |= away > extent
        if inside or not (apart or not overlap(center[slot], half[slot], axes[slot], middle, reach, upright)):
            found[n] = slot
            n += 1
    return found[:n]
