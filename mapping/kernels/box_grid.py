"""Axis-aligned bounds in a hashed grid: which of many meet each other."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels import hashing

__all__ = ["CELL_LIMIT", "MOST_CELLS", "Grid", "cells_covered", "fill_grid", "meeting"]

Array = NDArray[Any]
Int = Any

CELL_LIMIT = (1 << 20) - 1
MOST_CELLS = 4096
"""What covers more cells of a grid than this is compared with everything instead."""
FEW_PAIRS = 4096
"""So many comparisons are done faster than a grid is filled."""


class Grid(NamedTuple):
    """Bounds in all the cells that they cover.

    cell             : (3,) edges of a cell [m]
    table            : hash of the cells
    heads            : (cells,) the first entry of each cell
    items, following : (entries,) what lies there, and the next entry of that cell (−1: none)
    large            : what covers too many cells to be entered
    """

    cell: Array
    table: Array
    heads: Array
    items: Array
    following: Array
    large: Array


@njit(cache=True, inline="always")
def cell_of(at: float, cell: float) -> Any:
    """The index of the grid cell of a coordinate; what lies beyond the grid's reach is put at its border."""
    return np.int64(min(max(np.floor(at / cell), -float(CELL_LIMIT)), float(CELL_LIMIT)))


@njit(cache=True)
def cells_covered(low: Array, high: Array, cell: Array, first: Array, last: Array) -> float:
    """The cells (3,) that bounds cover, written to `first` and `last`; returns how many."""
    count = 1.0
    for r in range(3):
        first[r], last[r] = cell_of(low[r], cell[r]), cell_of(high[r], cell[r])
        count *= last[r] - first[r] + 1.0
    return count


@njit(cache=True)
def fill_grid(low: Array, high: Array, cell: Array) -> Grid:
    """The grid of bounds (n, 3) with cells (3,) [m]."""
    n = len(low)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    total: Int = 0
    n_large = 0
    for m in range(n):
        count = cells_covered(low[m], high[m], cell, first, last)
        if count > MOST_CELLS:
            n_large += 1
        else:
            total += np.int64(count)
    size = 16
    while size < 2 * total:
        size *= 2
    table = np.full((size, 2), -1, np.int64)
    heads = np.full(max(total, 1), -1, np.int32)
    items, following = np.empty(total, np.int32), np.empty(total, np.int32)
    large = np.empty(n_large, np.int32)
    n_cells: Int = 0
    entry = n_large = 0
    for m in range(n):
        if cells_covered(low[m], high[m], cell, first, last) > MOST_CELLS:
            large[n_large] = m
            n_large += 1
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    slot = hashing.find_or_insert(table, i, j, k, n_cells)
                    n_cells += slot == n_cells
                    items[entry], following[entry] = m, heads[slot]
                    heads[slot] = entry
                    entry += 1
    return Grid(cell, table, heads[:n_cells].copy(), items, following, large)


@njit(cache=True, inline="always")
def _bounds_meet(low_a: Array, high_a: Array, low_b: Array, high_b: Array) -> bool:
    return bool(
        low_a[0] <= high_b[0]
        and low_b[0] <= high_a[0]
        and low_a[1] <= high_b[1]
        and low_b[1] <= high_a[1]
        and low_a[2] <= high_b[2]
        and low_b[2] <= high_a[2]
    )


@njit(cache=True)
def meeting(low_a: Array, high_a: Array, low_b: Array, high_b: Array, cell: Array, same: bool) -> Array:
    """(m, 2) int32: which of the bounds a (n, 3) meet which of b (k, 3), each pair once.

    cell : (3,) [m] the cells of the grid in which b is looked up, where comparing all would take longer
    same : a and b are the same; then each pair is there in one order only, the lower index first; else the
        pairs come in the order of a
    """
    found = np.empty((max(64, 4 * len(low_a)), 2), np.int32)
    n = 0
    if len(low_a) * len(low_b) <= FEW_PAIRS:
        for a in range(len(low_a)):
            for b in range(a + 1 if same else 0, len(low_b)):
                if _bounds_meet(low_a[a], high_a[a], low_b[b], high_b[b]):
                    if n == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[n, 0], found[n, 1] = a, b
                    n += 1
        return found[:n].copy()
    grid = fill_grid(low_b, high_b, cell)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(len(low_a)):
        everything = cells_covered(low_a[a], high_a[a], cell, first, last) > MOST_CELLS
        others = len(low_b) if everything and not same else len(grid.large)
        if n + others > len(found):
            found = np.concatenate((found, np.empty((len(found) + others, 2), np.int32)))
        for m in range(others):
            b = m if everything and not same else grid.large[m]
            if (same and (a == b or (everything and a > b))) or not _bounds_meet(
                low_a[a], high_a[a], low_b[b], high_b[b]
            ):
                continue
            found[n, 0], found[n, 1] = (min(a, b), max(a, b)) if same else (a, b)
            n += 1
        if everything:
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    slot = hashing.lookup(grid.table, i, j, k)
                    entry = grid.heads[slot] if slot >= 0 else -1
                    while entry >= 0:
                        b = grid.items[entry]
                        entry = grid.following[entry]
                        if (same and a >= b) or not _bounds_meet(low_a[a], high_a[a], low_b[b], high_b[b]):
                            continue
                        if (  # of all cells that both cover, this is the first
                            i == max(first[0], cell_of(low_b[b, 0], cell[0]))
                            and j == max(first[1], cell_of(low_b[b, 1], cell[1]))
                            and k == max(first[2], cell_of(low_b[b, 2], cell[2]))
                        ):
                            if n == len(found):
                                found = np.concatenate((found, np.empty_like(found)))
                            found[n, 0], found[n, 1] = a, b
                            n += 1
    return found[:n].copy()
