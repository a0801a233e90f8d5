"""Connected components of surface voxels that change block by block.

A voxel's code says what it is: NOTHING (no surface, or one that is not clustered), LOOSE, or RAISED: of a level surface
that carries things. Neighbours among the 26 of a voxel are *linked* when they have one code; or when one is raised and
the other loose and lower: what stands on a table is not of it, its legs are. A *cell* is a block's slot · 512 + the
voxel's linear index in it.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.forest import join, root_of
from mapping.kernels.hashing import lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

NOTHING, LOOSE, RAISED = 0, 1, 2
HALF = 0.499
"""A sample lies between the centre of its voxel and those of the next ones, often exactly at the former along some
axes: a little is left for rounding."""


@njit(cache=True)
def enter(codes: Array, points: Array, owner: Array, given: Array, blocks: Array, per_voxel: Float) -> None:
    """Write the codes `given` (N,) uint8 of surface samples into the voxels of their blocks, in place; the highest
    wins.

    codes  (K, 512) uint8;  points (N, 3) [m];  owner (N,): the row of `blocks` (K, 3) of each"""
    for n in range(len(points)):
        row = owner[n]
        local: Int = np.int64(0)
        for a in range(3):
            within = np.int64(np.floor(points[n, a] * per_voxel - HALF)) - 8 * np.int64(blocks[row, a])
            local = local << 3 | min(max(within, 0), 7)
        codes[row, local] = max(codes[row, local], given[n])


@njit(cache=True)
def replace(code: Array, component: Array, slots: Array, codes: Array, cells: Array, lost: Array) -> Int:
    """Write new codes (K, 512) into the blocks `slots` (K,), in place; returns how many voxels changed.

    code (·, 512) uint8, component (·, 512) int32: voxels that are NOTHING now are of no component (0)
    cells, lost (≥ 512 K,): filled with the changed voxels and the components that they were of
    """
    n: Int = np.int64(0)
    for row in range(len(slots)):
        slot = slots[row]
        for local in range(512):
            if code[slot, local] != codes[row, local]:
                cells[n] = slot << 9 | local
                lost[n] = component[slot, local]
                code[slot, local] = codes[row, local]
                if codes[row, local] == NOTHING:
                    component[slot, local] = 0
                n += 1
    return n


@njit(cache=True, inline="always")
def linked(one: Int, other: Int, rise: Int) -> Any:
    """Whether two neighbours with these codes hang together, the other lying `rise` voxels above the one."""
    if one == NOTHING or other == NOTHING:
        return False
    return one == other or (rise > 0 if one == LOOSE else rise < 0)


@njit(cache=True)
def _blocks_around(table: Array, block_ijk: Array, slot: Int, around: Array) -> None:
    """The slots (27,) of a block and its neighbours, −1 where there is none, in place."""
    for n in range(27):
        around[n] = lookup(
            table, block_ijk[slot, 0] + n // 9 - 1, block_ijk[slot, 1] + n // 3 % 3 - 1, block_ijk[slot, 2] + n % 3 - 1
        )


@njit(cache=True, inline="always")
def _beside(around: Array, local: Int, step: Int) -> tuple[Int, Int]:
    """The slot, −1 where there is none, and the place in its block of the neighbour `step` (0 … 26) of a voxel."""
    i = (local >> 6) + step // 9 - 1
    j = (local >> 3 & 7) + step // 3 % 3 - 1
    k = (local & 7) + step % 3 - 1
    return around[((i >> 3) + 1) * 9 + ((j >> 3) + 1) * 3 + (k >> 3) + 1], (i & 7) << 6 | (j & 7) << 3 | (k & 7)


@njit(cache=True)
def touch(table: Array, block_ijk: Array, code: Array, component: Array, cells: Array, marked: Array) -> None:
    """Mark the components (C,) bool that are linked to one of the voxels `cells` (n,), in place."""
    around = np.empty(27, np.int64)
    at: Int = np.int64(-1)
    for cell in cells:
        slot, local = cell >> 9, cell & 511
        mine = code[slot, local]
        if mine == NOTHING:
            continue
        if slot != at:
            _blocks_around(table, block_ijk, slot, around)
            at = slot
        for step in range(27):
            other, there = _beside(around, local, step)
            if other < 0:
                continue
            found = component[other, there]
            if found > 0 and not marked[found] and linked(mine, code[other, there], step % 3 - 1):
                marked[found] = True


@njit(cache=True)
def find(component: Array, slots: Array, marked: Array) -> None:
    """Mark the components (C,) bool that have voxels in the blocks `slots` (m,), in place."""
    for slot in slots:
        for local in range(512):
            if component[slot, local] > 0:
                marked[component[slot, local]] = True


@njit(cache=True)
def collect(code: Array, component: Array, slots: Array, marked: Array, cells: Array, of: Array) -> Int:
    """List the voxels of the blocks `slots` (m,) that are of a marked component or, though clustered, of none.

    cells, of (≥ 512 m,): filled with them and their components; returns how many there are
    """
    n: Int = np.int64(0)
    for slot in slots:
        for local in range(512):
            if code[slot, local] != NOTHING and (component[slot, local] == 0 or marked[component[slot, local]]):
                cells[n] = slot << 9 | local
                of[n] = component[slot, local]
                n += 1
    return n


@njit(cache=True)
def connect(table: Array, block_ijk: Array, code: Array, component: Array, cells: Array, label: Array) -> Int:
    """Number the connected components of the voxels `cells` (n,), block by block; returns how many there are.

    label     (n,) int64: filled with 0, 1, … in the order in which components first appear
    component of these voxels is left negative, in place: for the caller to overwrite
    """
    parent = np.arange(len(cells))
    for n in range(len(cells)):
        component[cells[n] >> 9, cells[n] & 511] = -n - 1
    around = np.empty(27, np.int64)
    at: Int = np.int64(-1)
    for n in range(len(cells)):
        slot, local = cells[n] >> 9, cells[n] & 511
        if slot != at:
            _blocks_around(table, block_ijk, slot, around)
            at = slot
        for step in range(14, 27):  # half of the neighbours: links are symmetric
            other, there = _beside(around, local, step)
            if other < 0:
                continue
            if component[other, there] < 0 and linked(code[slot, local], code[other, there], step % 3 - 1):
                join(parent, n, -np.int64(component[other, there]) - 1)
    found: Int = np.int64(0)
    for n in range(len(cells)):
        root = root_of(parent, n)
        if root == n:
            label[n] = found
            found += 1
        else:
            label[n] = label[root]
    return found


@njit(cache=True)
def cells_near(table: Array, code: Array, points: Array, per_voxel: Float, seen: Array) -> Array:
    """The clustered voxels (n,), each once, that hold one of the points (N, 3) [m] or lie beside one that does.

    seen (·, 512) bool: all False, and so again afterwards
    """
    found = np.empty(64, np.int64)
    n: Int = np.int64(0)
    for p in range(len(points)):
        i0 = np.int64(np.floor(points[p, 0] * per_voxel - HALF))
        j0 = np.int64(np.floor(points[p, 1] * per_voxel - HALF))
        k0 = np.int64(np.floor(points[p, 2] * per_voxel - HALF))
        at_i: Int = np.int64(1 << 40)
        at_j: Int = np.int64(0)
        at_k: Int = np.int64(0)
        slot: Int = np.int64(-1)
        for step in range(27):
            i, j, k = i0 + step // 9 - 1, j0 + step // 3 % 3 - 1, k0 + step % 3 - 1
            if i >> 3 != at_i or j >> 3 != at_j or k >> 3 != at_k:
                at_i, at_j, at_k = i >> 3, j >> 3, k >> 3
                slot = lookup(table, at_i, at_j, at_k)
            local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
            if slot >= 0 and code[slot, local] != NOTHING and not seen[slot, local]:
                seen[slot, local] = True
                if n == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[n] = slot << 9 | local
                n += 1
    for m in range(n):
        seen[found[m] >> 9, found[m] & 511] = False
    return found[:n]
