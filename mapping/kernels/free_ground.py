"""Ground on which a body can stand: what the voxels above it say, and places spread over it by their clearance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

UNKNOWN, FREE, BLOCKED = 0, 1, 2
IGNORED, FLOOR, BODY = 0, 1, 2


@njit(cache=True)
def survey(evidence: Array, levels: Array, wide: int) -> tuple[Array, Array]:
    """What columns of voxels say of the ground below them.

    evidence : (C, L, 8, 8, 8) int8, log-odds of columns of L blocks, lowest first; −128 where nothing is known
    levels   : (L, 8) int8, what each height is: IGNORED, of the FLOOR, or of the BODY that is to stand there
    wide     : voxels to the side of a cell, 1, 2, 4 or 8

    Returns (C, 8/wide, 8/wide) int8 BLOCKED where a voxel of the body's is occupied, FREE where at least half of them
    are free, else UNKNOWN; and bool, where a voxel of the floor's is occupied.
    """
    n, cells = len(evidence), 8 // wide
    space = np.zeros((n, cells, cells), dtype=np.int8)
    floor = np.zeros((n, cells, cells), dtype=np.bool_)
    free = np.zeros((cells, cells), dtype=np.int64)
    body = 0
    for block in range(levels.shape[0]):
        for z in range(8):
            body += wide * wide * (levels[block, z] == BODY)
    for c in range(n):
        free[:] = 0
        for block in range(evidence.shape[1]):
            for u in range(8):
                for v in range(8):
                    i, j = u // wide, v // wide
                    for z in range(8):
                        value = evidence[c, block, u, v, z]
                        if levels[block, z] == BODY:
                            if value > 0:
                                space[c, i, j] = BLOCKED
                            elif value < 0 and value > -128:
                                free[i, j] += 1
                        elif levels[block, z] == FLOOR and value > 0:
                            floor[c, i, j] = True
        for i in range(cells):
            for j in range(cells):
                if space[c, i, j] != BLOCKED and body > 0 and 2 * free[i, j] >= body:
                    space[c, i, j] = FREE
    return space, floor


@njit(cache=True)
def note_columns(
    free: Array, solid: Array, evidence: Array, blocks: Array, heights: Array, columns_per_cell: float, low: Array
) -> tuple[int, Array]:
    """Note what columns of voxels say of the ground cells below them, in place.

    free     : (W, H) bool, set where a voxel is free
    solid    : (W, H) uint16, bit b set or cleared as something is or is not in the blocks that have it
    evidence : (K, 8, 8, 8) int8 of the blocks (K, 3), −128 where nothing is known; heights (K, 8) bool: which count
    low      : (2,) the cell of the first entry of the arrays

    Returns how many cells are free that were not, and the lowest and the highest of these (2, 2), counted as in `low`.
    A block's bit is its layer modulo 16.
    """
    n = 0
    bounds = np.empty((2, 2), dtype=np.int64)
    for clearing in (True, False):
        for b in range(len(blocks)):
            bit = np.uint16(1 << (blocks[b, 2] & 15))
            for u in range(8):
                i = int(np.floor((8 * blocks[b, 0] + u + 0.5) / columns_per_cell)) - low[0]
                for v in range(8):
                    j = int(np.floor((8 * blocks[b, 1] + v + 0.5) / columns_per_cell)) - low[1]
                    if clearing:
                        solid[i, j] &= ~bit
                        continue
                    for z in range(8):
                        value = evidence[b, u, v, z]
                        if not heights[b, z] or value == -128:
                            continue
                        if value >= 0:
                            solid[i, j] |= bit
                        elif not free[i, j]:
                            free[i, j] = True
                            for a, cell in enumerate((i + low[0], j + low[1])):
                                bounds[0, a] = cell if n == 0 else min(bounds[0, a], cell)
                                bounds[1, a] = cell if n == 0 else max(bounds[1, a], cell)
                            n += 1
    return n, bounds


@njit(cache=True)
def choose_places(clearance: Array, worth: Array, taken: Array, spacing: float, share: float) -> Array:
    """The cells (K, 2) of places: the one with most clearance first, then that which is left with most, and so on.

    clearance : (W, H) float64 [cells], 0 where no place may be
    worth     : (W, H) float64, by which cells are put in order; at most `clearance` times a constant
    taken     : (N, 3) float64, cell and clearance of places that are there already

    Around each place the cells nearer than `spacing` or `share` of its clearance, whichever is more, are left out.
    """
    width, height = clearance.shape
    covered = np.zeros((width, height), dtype=np.bool_)
    for n in range(len(taken)):
        _cover(covered, taken[n, 0], taken[n, 1], max(spacing, share * taken[n, 2]))
    flat = worth.ravel()
    order = np.argsort(-flat, kind="mergesort")
    places = np.empty((width * height, 2), dtype=np.int64)
    n = 0
    for cell in order:
        if flat[cell] <= 0.0:
            break
        i, j = cell // height, cell % height
        if covered[i, j]:
            continue
        places[n, 0], places[n, 1] = i, j
        n += 1
        _cover(covered, float(i), float(j), max(spacing, share * clearance[i, j]))
    return places[:n].copy()


@njit(cache=True)
def _cover(covered: Array, x: float, y: float, radius: float) -> None:
    r = int(np.ceil(radius))
    for i in range(max(0, int(x) - r), min(covered.shape[0], int(x) + r + 1)):
        for j in range(max(0, int(y) - r), min(covered.shape[1], int(y) + r + 1)):
            if (i - x) ** 2 + (j - y) ** 2 < radius * radius:
                covered[i, j] = True


@njit(cache=True)
def join_places(clearance: Array, places: Array, least: float) -> tuple[Array, Array]:
    """Which places (N, 2) [cells] free ground joins, and how wide.

    Every cell with a clearance (W, H) of at least `least` falls to the place from which the fewest 4-neighbour steps
    lead to it; two places are joined where their cells meet. Returns pairs (M, 2) of indices into `places`, the
    smaller first, and for each the clearance (M,) of the narrowest cell on the widest such way.
    """
    width, height = clearance.shape
    owner = np.full((width, height), -1, dtype=np.int32)
    narrow = np.zeros((width, height))
    front = np.empty((width * height, 2), dtype=np.int32)
    end = 0
    for n in range(len(places)):
        i, j = places[n]
        if clearance[i, j] < least or owner[i, j] >= 0:
            continue
        owner[i, j], narrow[i, j] = n, clearance[i, j]
        front[end, 0], front[end, 1] = i, j
        end += 1
    begin = 0
    joined = dict()  # noqa: C408 (numba)
    joined[np.int64(-1)] = 0.0
    while begin < end:
        i, j = front[begin]
        begin += 1
        for d in range(4):
            a = i + (1 if d == 0 else -1 if d == 1 else 0)
            b = j + (1 if d == 2 else -1 if d == 3 else 0)
            if a < 0 or b < 0 or a >= width or b >= height or clearance[a, b] < least:
                continue
            if owner[a, b] < 0:
                owner[a, b] = owner[i, j]
                narrow[a, b] = min(narrow[i, j], clearance[a, b])
                front[end, 0], front[end, 1] = a, b
                end += 1
            elif owner[a, b] != owner[i, j]:
                one, two = min(owner[a, b], owner[i, j]), max(owner[a, b], owner[i, j])
                key = np.int64(one) * len(places) + two
                wide = min(narrow[a, b], narrow[i, j])
                if key not in joined or joined[key] < wide:
                    joined[key] = wide
    pairs = np.empty((len(joined) - 1, 2), dtype=np.int64)
    widths = np.empty(len(joined) - 1)
    n = 0
    for key, wide in joined.items():
        if key >= 0:
            pairs[n, 0], pairs[n, 1] = key // len(places), key % len(places)
            widths[n] = wide
            n += 1
    return pairs, widths
