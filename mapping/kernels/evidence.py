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

from mapping.kernels.hashing import lookup, number_new, room_for
from mapping.kernels.packed import has_record, row_of

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

UNIT = 256
"""So many counts are one full view of a voxel, or one nat."""
MOST = 65535 // UNIT - 1
"""More evidence than this a voxel cannot hold: it is halved before."""
DENSE_PIXELS = 0.5
"""Where pixels are narrower than this share of a voxel every other row and column is enough."""


@njit(cache=True, inline="always")
def rounded(amount: Float, u: Int, v: Int) -> Int:
    """A whole number, up or down in turn from pixel to pixel (by Roberts' R₂ sequence), so that sums are right."""
    turn = 0.7548776662 * u + 0.5698402910 * v
    return np.int64(amount + (turn - np.floor(turn)))


@njit(cache=True)
def runs_of_image(
    table: Array,
    masks: Array,
    n_blocks: Int,
    depth: Array,
    choices: Array,
    trust: Array,
    camera: Array,
    pose: Array,
    voxel: Float,
) -> tuple[Array, Array, Array, Array, Array]:
    """What the pixels of an image say of which voxels: runs of pixels beside each other that agree on both.

    depth (H, W) float32 [m]; choices (H, W) uint16 with 0 = no vote; trust (H, W) float32, what a full view counts
    camera (4,) fx, fy, cx, cy; pose (3, 4) camera in map; voxel: edge [m]

    Returns cells (n,), choices (n,) uint16 and counts (n,) [1/UNIT] of the runs; the blocks (m, 3) int32 that the table
    does not have, numbered on from n_blocks in that order; and the cells (k,) that have no record yet, some more than
    once.

    A pixel counts the share of a voxel's face that it covers, (z/f)² / v² or 1, so that a full view counts about one
    whatever the distance; what a run counts is `rounded`.
    """
    height, width = depth.shape
    focal = camera[0] * camera[1]
    dense = DENSE_PIXELS * voxel * np.sqrt(focal)
    per_voxel = 1.0 / voxel
    scale = UNIT * per_voxel * per_voxel / focal
    cells, counts = np.empty(height * width, np.int64), np.empty(height * width, np.int64)
    said, bare = np.empty(height * width, np.uint16), np.empty(height * width, np.int64)
    found, fresh = np.empty((1024, 3), np.int32), np.full((1024, 2), -1, np.int64)
    n = n_bare = n_found = 0
    bi: Int = 1 << 30
    bj: Int = 1 << 30
    bk: Int = 1 << 30
    slot: Int = np.int64(-1)
    along = (np.arange(width) - camera[2]) / camera[0]
    for v in range(height):
        fresh, found = room_for(fresh, found, n_found, n_blocks, width)
        y_z = (v - camera[3]) / camera[1]
        total = 0.0  # of the run that is going on, which began at `start` in voxel (a, b, c)
        choice: Int = np.int64(0)
        a: Int = np.int64(0)
        b: Int = np.int64(0)
        c: Int = np.int64(0)
        start = 0
        for u in range(width + 1):
            here: Int = np.int64(0)
            weight = 0.0
            i: Int = np.int64(0)
            j: Int = np.int64(0)
            k: Int = np.int64(0)
            z = np.float64(depth[v, u]) if u < width else 0.0
            if u < width and z < dense and (u | v) & 1:
                continue
            if z > 0.0 and choices[v, u] != 0 and trust[v, u] > 0.0:
                share = z * z * scale * (4.0 if z < dense else 1.0)
                here, weight = np.int64(choices[v, u]), trust[v, u] * min(share, UNIT)
                x, y = along[u] * z, y_z * z
                i = np.int64(np.floor((pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * per_voxel))
                j = np.int64(np.floor((pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * per_voxel))
                k = np.int64(np.floor((pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) * per_voxel))
            if here == choice and i == a and j == b and k == c:
                total += weight
                continue
            count = rounded(total, start, v) if choice != 0 else np.int64(0)
            if count > 0:
                if a >> 3 != bi or b >> 3 != bj or c >> 3 != bk:
                    bi, bj, bk = a >> 3, b >> 3, c >> 3
                    slot = np.int64(lookup(table, bi, bj, bk))
                    if slot < 0:
                        slot = np.int64(number_new(fresh, found, n_found, n_blocks, bi, bj, bk))
                        n_found += slot == n_blocks + n_found
                cell = slot << 9 | (a & 7) << 6 | (b & 7) << 3 | (c & 7)
                cells[n], said[n], counts[n] = cell, choice, count
                n += 1
                if slot >= n_blocks or not has_record(masks, cell):
                    bare[n_bare] = cell
                    n_bare += 1
            choice, a, b, c, total, start = here, i, j, k, weight, u
    return cells[:n], said[:n], counts[:n], found[:n_found].copy(), bare[:n_bare]


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
