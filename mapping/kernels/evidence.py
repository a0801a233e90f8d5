"""Evidence for classes in the records of voxels: the best few are counted, what is left of the others is one sum.

A record of k classes is uint16 (2k + 1,): k class ids with 0 = none, the evidence for each, and that for *other*, in
units of 1/UNIT. The counters are those of Misra & Gries (Finding repeated elements, 1982) for weighted items: evidence
for a class that has no counter wears all counters down by the same amount, k + 1 times which goes to *other*. So a
counter is too low by at most other / (k + 1), and sums of whole numbers do not depend on their order.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import find_or_insert, lookup
from mapping.kernels.packed import has_record, row_of

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

UNIT = 256
"""So many counts are one full view of a voxel, or one nat."""
MOST = 65535 // UNIT - 1
"""More evidence than this a voxel cannot hold: it is halved before."""
DENSE_PIXELS = 0.25
"""Surfaces nearer than this share of the distance at which a pixel is as wide as a voxel are seen densely enough."""


@njit(cache=True)
def cells_of_image(
    table: Array,
    masks: Array,
    n_blocks: Int,
    depth: Array,
    choices: Array,
    trust: Array,
    camera: Array,
    pose: Array,
    voxel: Float,
    cells: Array,
    votes: Array,
) -> tuple[Array, Array]:
    """The cell in which each pixel's point lies, and what the pixel counts there, in place.

    depth (H, W) float32 [m]; choices (H, W) with 0 = no vote; trust (H, W) float32, what a full view counts
    camera (4,) fx, fy, cx, cy; pose (3, 4) camera in map; voxel: edge [m]
    cells (H, W) int32, −1 where there is no vote; votes (H, W) uint16 [1/UNIT]

    A pixel counts the share of a voxel's face that it covers, (z/f)² / v² or 1, so that a full view counts about one
    whatever the distance; shares of a unit are rounded up and down in turn (by Roberts' R₂ sequence), so that their sum
    is right. Where pixels are far denser than voxels every other row and column is enough. Blocks that the table does
    not have are numbered on from n_blocks and returned (m, 3) int32, in that order; with the cells (k,) int32 that have
    no record yet, some more than once.
    """
    height, width = depth.shape
    focal = camera[0] * camera[1]
    dense = DENSE_PIXELS * voxel * np.sqrt(focal)
    per_voxel = 1.0 / voxel
    scale = UNIT * per_voxel * per_voxel / focal
    bare = np.empty(height * width, np.int32)
    n_bare = 0
    found = np.empty((256, 3), np.int32)
    fresh = np.full((1024, 2), -1, np.int64)
    n = 0
    last_i: Int = 1 << 30
    last_j: Int = 1 << 30
    last_k: Int = 1 << 30
    slot: Int = np.int64(-1)
    for v in range(height):
        y_z = (v - camera[3]) / camera[1]
        for u in range(width):
            cells[v, u] = -1
            z = np.float64(depth[v, u])
            if choices[v, u] == 0 or not z > 0.0:
                continue
            share = z * z * scale
            if z < dense:
                if (u | v) & 1:
                    continue
                share *= 4.0
            count = np.int64(trust[v, u] * min(share, UNIT) + (0.7548776662 * u + 0.5698402910 * v) % 1.0)
            if count <= 0:
                continue
            x, y = (u - camera[2]) / camera[0] * z, y_z * z
            i = np.int64(np.floor((pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * per_voxel))
            j = np.int64(np.floor((pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * per_voxel))
            k = np.int64(np.floor((pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) * per_voxel))
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                last_i, last_j, last_k = bi, bj, bk
                slot = np.int64(lookup(table, bi, bj, bk))
                if slot < 0:
                    if 2 * n > len(fresh):
                        fresh = np.full((4 * len(fresh), 2), -1, np.int64)
                        for m in range(n):
                            find_or_insert(fresh, found[m, 0], found[m, 1], found[m, 2], n_blocks + m)
                    slot = np.int64(find_or_insert(fresh, bi, bj, bk, n_blocks + n))
                    if slot == n_blocks + n:
                        if n == len(found):
                            found = np.concatenate((found, np.empty_like(found)))
                        found[n, 0], found[n, 1], found[n, 2] = bi, bj, bk
                        n += 1
            cell = slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (k & 7)
            cells[v, u] = cell
            votes[v, u] = min(count, 65535)
            if slot >= n_blocks or not has_record(masks, cell):
                bare[n_bare] = cell
                n_bare += 1
    return found[:n].copy(), bare[:n_bare]


@njit(cache=True, inline="always")
def give(records: Array, row: Int, choice: Int, count: Int, limit: Int) -> None:
    """Add evidence for a class ≠ 0 to a record, in place; if that is more than `limit`, what it held counts half.

    count > 0 is cut off at limit
    """
    count = min(count, limit)
    k = records.shape[1] // 2
    held: Int = np.int64(0)
    for c in range(k, 2 * k + 1):
        held += records[row, c]
    while held + count > limit:
        held = np.int64(0)
        for c in range(k, 2 * k + 1):
            records[row, c] >>= 1
            held += records[row, c]
    empty: Int = np.int64(-1)
    least: Int = np.int64(count)
    for c in range(k):
        here = records[row, k + c]
        if here == 0:
            empty = c
        elif records[row, c] == choice:
            records[row, k + c] = here + count
            return
        least = min(least, np.int64(here))
    if empty >= 0:
        records[row, empty], records[row, k + empty] = choice, count
        return
    left = count - least
    for c in range(k):
        records[row, k + c] -= least
        if left > 0 and records[row, k + c] == 0:
            records[row, c], records[row, k + c] = choice, left
            left = 0
    records[row, 2 * k] += (k + 1) * least


@njit(cache=True)
def give_all(
    masks: Array,
    first: Array,
    records: Array,
    cells: Array,
    choices: Array,
    counts: Array,
    limit: Int,
    changed_at: Array,
    revision: Int,
    touched: Array,
) -> Int:
    """Give evidence for class choices (n,) to the records of cells (n,), where both are there, in place.

    changed_at: set to `revision` for each block; touched (·,): the slots of these; returns how many they are
    """
    n = 0
    for m in range(cells.shape[0]):
        cell = np.int64(cells[m])
        if cell < 0 or choices[m] == 0 or counts[m] == 0:
            continue
        row = row_of(masks, first, cell)
        if row < 0:
            continue
        give(records, row, choices[m], np.int64(counts[m]), limit)
        slot = cell >> 9
        if changed_at[slot] != revision:
            changed_at[slot] = revision
            touched[n] = slot
            n += 1
    return n


@njit(cache=True)
def halve(records: Array, rows: Array) -> None:
    """Make all evidence in the records `rows` (n,), each named once, count half, in place."""
    k = records.shape[1] // 2
    for n in range(rows.shape[0]):
        for c in range(k, 2 * k + 1):
            records[rows[n], c] >>= 1


@njit(cache=True)
def lead(records: Array, rows: Array, labels: Array, evidence: Array, held: Array) -> None:
    """The class with most evidence in the records `rows` (n,), of equals the lowest, its evidence, and that of all,
    in place; 0 where a row is below 0."""
    k = records.shape[1] // 2
    for n in range(rows.shape[0]):
        labels[n] = evidence[n] = held[n] = 0
        if rows[n] < 0:
            continue
        for c in range(k):
            here, label = records[rows[n], k + c], records[rows[n], c]
            held[n] += here
            if here > evidence[n] or (here == evidence[n] and here > 0 and label < labels[n]):
                labels[n], evidence[n] = label, here
        held[n] += records[rows[n], 2 * k]
