"""Votes of pixels for the instances in whose voxels their points lie, and what the votes say of masks and boxes.

A voxel's record is that of `mapping.kernels.evidence` with instance numbers for classes, and beside it the mean of its
points: int16 (3,), their offset from the voxel's centre in units of 1/MEAN_UNIT voxels.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.evidence import UNIT, give
from mapping.kernels.hashing import lookup
from mapping.kernels.packed import row_of

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MEAN_UNIT = 65534.0
BACKGROUND = 65535
"""The number of what is no instance: walls, floors."""
LEAST_EVIDENCE = 13
"""A voxel is looked at in an image when its first instance has this much evidence [1/UNIT]."""


@njit(cache=True, inline="always")
def leader(records: Array, row: Int) -> Int:
    """The column of the number with most evidence in a record, of equals the first."""
    k = records.shape[1] // 2
    best: Int = 0
    for c in range(1, k):
        if records[row, k + c] > records[row, k + best]:
            best = c
    return best


@njit(cache=True, inline="always")
def wins(records: Array, row: Int, column: Int, least: Int, share: Float) -> bool:
    """Whether a number's evidence in a record is `least` and this `share` of all."""
    k = records.shape[1] // 2
    held: Int = np.int64(0)
    for c in range(k, 2 * k + 1):
        held += records[row, c]
    here = np.int64(records[row, k + column])
    return here >= least and here >= share * held


@njit(cache=True)
def weigh(
    pieces: Array,
    labels: Array,
    numbers: Array,
    trust: Array,
    depth: Array,
    depth_noise: Float,
    voxel: Float,
    power: Int,
    choices: Array,
    weights: Array,
) -> None:
    """The number that each pixel votes for, and what a full view of it counts, in place.

    pieces (H, W) int32: 1 … n, 0 = none; labels (H, W) uint16, 0 = none; numbers (n + 1,) uint16: of each piece, 0 = no
    vote; trust (H, W) float32 in 0 … 1; depth (H, W) float32 [m] with a standard deviation of depth_noise · depth²
    choices (H, W) uint16: BACKGROUND where there is a label and no piece; weights (H, W) float32

    A pixel counts most(piece) · (trust / most(piece)) ^ power / (1 + (2σ / voxel)²), with the most trust that any pixel
    of its piece has (1 for background), and σ the standard deviation of its depth.
    """
    height, width = depth.shape
    most = np.zeros(len(numbers), np.float32)
    for v in range(height):
        for u in range(width):
            most[pieces[v, u]] = max(most[pieces[v, u]], trust[v, u])
    most[0] = 1.0
    spread = 2.0 * depth_noise / voxel
    for v in range(height):
        for u in range(width):
            piece = pieces[v, u]
            choice = np.int64(numbers[piece]) if piece else BACKGROUND if labels[v, u] else 0
            choices[v, u] = choice
            weights[v, u] = 0.0
            if choice and trust[v, u] > 0.0:
                z = np.float64(depth[v, u])
                sigma = spread * z * z
                weights[v, u] = most[piece] * (trust[v, u] / most[piece]) ** power / (1.0 + sigma * sigma)


@njit(cache=True)
def vote(
    masks: Array,
    first: Array,
    records: Array,
    means: Array,
    sizes: Array,
    lost: Array,
    changed_at: Array,
    revision: Int,
    cells: Array,
    votes: Array,
    choices: Array,
    depth: Array,
    camera: Array,
    pose: Array,
    voxel: Float,
    limit: Int,
    mean_limit: Int,
) -> Array:
    """Count the votes of an image's pixels, in place.

    records (R, 2k + 1) uint16, means (R, 3) int16: of the voxels
    sizes   (65536,) int64: in how many voxels each number leads; lost (65536,) bool: set where it loses one
    changed_at is set to `revision` for each block with votes
    cells, votes (H, W): see `evidence.cells_of_image`; choices (H, W) uint16; depth (H, W) float32 [m]
    camera  (4,) fx, fy, cx, cy; pose (3, 4) camera in map; limit: evidence at which a record is halved; mean_limit:
            evidence over which the mean is taken [1/UNIT]

    Returns number and slot (K, 2) int64 of the blocks in which instances got votes; repeats may remain.
    """
    height, width = depth.shape
    per_voxel = 1.0 / voxel
    k = records.shape[1] // 2
    latest = np.full(65536, -1, np.int64)
    pairs = np.empty((4096, 2), np.int64)
    n = 0
    for v in range(height):
        y_z = (v - camera[3]) / camera[1]
        for u in range(width):
            cell = np.int64(cells[v, u])
            if cell < 0:
                continue
            row = row_of(masks, first, cell)
            if row < 0:
                continue
            choice, count = choices[v, u], np.int64(votes[v, u])
            held: Int = np.int64(0)
            for c in range(k, 2 * k + 1):
                held += records[row, c]
            before = leader(records, row)
            was = records[row, before] if records[row, k + before] > 0 else 0
            give(records, row, choice, count, limit)
            after = leader(records, row)
            now = records[row, after]
            if now != was:
                sizes[was] -= 1
                sizes[now] += 1
                lost[was] = True
            z = np.float64(depth[v, u])
            x, y = (u - camera[2]) / camera[0] * z, y_z * z
            px = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * per_voxel
            py = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * per_voxel
            pz = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) * per_voxel
            gain = count / (min(held, mean_limit) + count)
            ox, oy, oz = means[row, 0], means[row, 1], means[row, 2]
            means[row, 0] = np.int16(np.rint(ox + gain * ((px - np.floor(px) - 0.5) * MEAN_UNIT - ox)))
            means[row, 1] = np.int16(np.rint(oy + gain * ((py - np.floor(py) - 0.5) * MEAN_UNIT - oy)))
            means[row, 2] = np.int16(np.rint(oz + gain * ((pz - np.floor(pz) - 0.5) * MEAN_UNIT - oz)))
            slot = cell >> 9
            changed_at[slot] = revision
            if choice != BACKGROUND and latest[choice] != slot:
                latest[choice] = slot
                if n == len(pairs):
                    pairs = np.concatenate((pairs, np.empty_like(pairs)))
                pairs[n, 0], pairs[n, 1] = choice, slot
                n += 1
    return pairs[:n]


@njit(cache=True)
def count_overlaps(
    table: Array,
    masks: Array,
    first: Array,
    records: Array,
    depth: Array,
    pieces: Array,
    camera: Array,
    pose: Array,
    voxel: Float,
    step: Int,
    n_pieces: Int,
) -> tuple[Array, Array, Array, Array]:
    """How many pixels of each piece lie on voxels that which instance leads.

    pieces (H, W) int32: 1 … n_pieces, 0 = none. Looked up at the point, then, for pieces, beside it: before and behind
    on the ray, above and below. Returns piece (K,) with 0 for none, number (K,), hits (K,) of the pairs that occur, and
    the pixels looked at per piece (n_pieces + 1,).
    """
    height, width = depth.shape
    rows = 8192
    key = np.full(rows, -1, np.int64)
    hits = np.zeros(rows, np.int64)
    looked = np.zeros(n_pieces + 1, np.int64)
    per_voxel = 1.0 / voxel
    k = records.shape[1] // 2
    n = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            z = np.float64(depth[v, u])
            if not z > 0.0:
                continue
            piece = pieces[v, u]
            looked[piece] += 1
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            dx = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z) * per_voxel
            dy = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z) * per_voxel
            dz = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z) * per_voxel
            for attempt in range(7 if piece else 1):
                t = 1.0
                up = 0.0
                if attempt == 1:
                    t = 1.0 + voxel / z
                elif attempt == 2:
                    t = 1.0 - voxel / z
                elif attempt == 3:
                    up = -1.0
                elif attempt == 4:
                    up = 1.0
                elif attempt == 5:
                    t = 1.0 + 2.0 * voxel / z
                elif attempt == 6:
                    t = 1.0 - 2.0 * voxel / z
                i = np.int64(np.floor(t * dx + pose[0, 3] * per_voxel))
                j = np.int64(np.floor(t * dy + pose[1, 3] * per_voxel))
                l = np.int64(np.floor(t * dz + pose[2, 3] * per_voxel + up))
                slot = np.int64(lookup(table, i >> 3, j >> 3, l >> 3))
                if slot < 0:
                    continue
                row = row_of(masks, first, slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (l & 7))
                if row < 0:
                    continue
                best = leader(records, row)
                if records[row, k + best] < LEAST_EVIDENCE:
                    continue
                pair = np.int64(piece) << 32 | np.int64(records[row, best])
                at = (pair * 2654435761) & (rows - 1)
                while key[at] >= 0 and key[at] != pair:
                    at = (at + 1) & (rows - 1)
                if key[at] < 0:
                    if 2 * n > rows:
                        break
                    key[at] = pair
                    n += 1
                hits[at] += 1
                break
    used = np.nonzero(key >= 0)[0]
    return key[used] >> 32, key[used] & 0xFFFFFFFF, hits[used], looked


@njit(cache=True)
def gather(records: Array, rows: Array, number: Int, least: Int, share: Float, chosen: Array, weights: Array) -> Int:
    """Which of the rows (n,) a number has won, and its evidence there, in place; returns how many."""
    k = records.shape[1] // 2
    n = 0
    for m in range(rows.shape[0]):
        row = rows[m]
        best = leader(records, row)
        if records[row, best] == number and records[row, k + best] > 0 and wins(records, row, best, least, share):
            chosen[n], weights[n] = m, records[row, k + best]
            n += 1
    return n


@njit(cache=True)
def rename(records: Array, rows: Array, sizes: Array, old: Int, new: Int) -> None:
    """Give the evidence for number `old` to `new`, 0 = to none, in the records `rows` (n,), in place; sizes as in
    `vote`."""
    k = records.shape[1] // 2
    for m in range(rows.shape[0]):
        row = rows[m]
        there, target = -1, -1
        for c in range(k):
            if records[row, k + c] > 0:
                if records[row, c] == old:
                    there = c
                elif records[row, c] == new:
                    target = c
        if there < 0:
            continue
        before = leader(records, row)
        sizes[records[row, before]] -= 1
        if new == 0:
            records[row, there] = records[row, k + there] = 0
        elif target < 0:
            records[row, there] = new
        else:
            records[row, k + target] += records[row, k + there]
            records[row, there] = records[row, k + there] = 0
        after = leader(records, row)
        if records[row, k + after] > 0:
            sizes[records[row, after]] += 1


@njit(cache=True)
def classes_of_boxes(
    table: Array,
    masks: Array,
    first: Array,
    records: Array,
    class_of: Array,
    low: Array,
    high: Array,
    labels: Array,
    weights: Array,
    others: Array,
) -> None:
    """What voxels within each box say of its class by the instances that lead in them, in place.

    class_of        (65536,) uint16: the class of each number, 0 for none
    low, high       (N, 3) int64: lowest voxel of each box, and the first beyond it
    labels, weights (N,) the class with most evidence, and this [full views]; others (N,): that for other classes and
                    for none
    """
    classes, votes = np.empty(64, np.uint16), np.empty(64)
    k = records.shape[1] // 2
    for n in range(len(low)):
        count = 0
        total = 0.0
        for i in range(low[n, 0], high[n, 0]):
            for j in range(low[n, 1], high[n, 1]):
                for l in range(low[n, 2], high[n, 2]):
                    slot = np.int64(lookup(table, i >> 3, j >> 3, l >> 3))
                    if slot < 0:
                        continue
                    row = row_of(masks, first, slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (l & 7))
                    if row < 0:
                        continue
                    best = leader(records, row)
                    w = records[row, k + best] / UNIT
                    if not w > 0.0:
                        continue
                    total += w
                    c = class_of[records[row, best]]
                    if c == 0:
                        continue
                    at = 0
                    while at < count and classes[at] != c:
                        at += 1
                    if at == len(classes):
                        continue
                    if at == count:
                        classes[at] = c
                        votes[at] = 0.0
                        count += 1
                    votes[at] += w
        labels[n] = 0
        weights[n] = 0.0
        for at in range(count):
            if votes[at] > weights[n] or (votes[at] == weights[n] and classes[at] < labels[n]):
                labels[n] = classes[at]
                weights[n] = votes[at]
        others[n] = total - weights[n]


@njit(cache=True)
def fade(records: Array, rows: Array, gone: Array, sizes: Array, lost: Array, least: Int, empty: Array) -> None:
    """Let all evidence in the records `rows` (n,) count half, in place; rows below 0 are left out.

    gone (n,) bool: those that hold nothing any more; sizes, lost: as in `vote`
    empty (n,) bool, out: where less than `least` is left
    """
    k = records.shape[1] // 2
    for m in range(rows.shape[0]):
        row = rows[m]
        empty[m] = False
        if row < 0:
            continue
        before = leader(records, row)
        was = records[row, before] if records[row, k + before] > 0 else 0
        held: Int = np.int64(0)
        for c in range(k, 2 * k + 1):
            records[row, c] >>= 1
            held += records[row, c]
        after = leader(records, row)
        now = records[row, after] if records[row, k + after] > 0 else 0
        if gone[m] or held < least:
            empty[m] = True
            now = 0
            for c in range(2 * k + 1):
                records[row, c] = 0
        if now != was:
            sizes[was] -= 1
            sizes[now] += 1
            lost[was] = True


@njit(cache=True)
def numbers_of(records: Array, rows: Array, numbers: Array) -> None:
    """The number (n,) that leads in each of the records `rows` (n,), in place; 0 where there is none."""
    k = records.shape[1] // 2
    for m in range(rows.shape[0]):
        numbers[m] = 0
        if rows[m] >= 0:
            best = leader(records, rows[m])
            if records[rows[m], k + best] > 0:
                numbers[m] = records[rows[m], best]


@njit(cache=True)
def classes_of(records: Array, rows: Array, class_of: Array, labels: Array, weights: Array, others: Array) -> None:
    """What the records `rows` (n,) say of the class of their voxels by the numbers that they count, in place.

    class_of, labels, weights, others as in `classes_of_boxes`; nothing is said where a row is below 0.
    """
    k = records.shape[1] // 2
    for m in range(rows.shape[0]):
        row = rows[m]
        labels[m] = 0
        weights[m] = others[m] = 0.0
        if row < 0:
            continue
        held: Int = np.int64(0)
        best: Int = np.int64(0)
        for c in range(k, 2 * k + 1):
            held += records[row, c]
        for c in range(k):
            label = class_of[records[row, c]]
            if label == 0 or records[row, k + c] == 0:
                continue
            here: Int = np.int64(0)
            for d in range(k):
                if class_of[records[row, d]] == label:
                    here += records[row, k + d]
            if here > best or (here == best and label < labels[m]):
                labels[m], best = label, here
        weights[m], others[m] = best / UNIT, (held - best) / UNIT
