"""Votes of pixels for the instances in whose voxels their points lie, and what the votes say of masks and boxes.

A voxel's record is that of `mapping.kernels.evidence` with instance numbers for classes, and beside it the mean of its
points: int16 (3,), their offset from the voxel's centre in units of 1/MEAN_UNIT voxels.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.evidence import UNIT, give, rounded
from mapping.kernels.hashing import lookup, number_new, room_for
from mapping.kernels.packed import has_record, row_of

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MEAN_UNIT = 65534.0
BACKGROUND = 65535
"""The number of what is no instance: walls, floors."""
LEAST_EVIDENCE = 3
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
    return bool(here >= least and here >= share * held)


@njit(cache=True)
def trace(
    table: Array,
    masks: Array,
    n_blocks: Int,
    pieces: Array,
    labels: Array,
    weights: Array,
    depth: Array,
    camera: Array,
    pose: Array,
    voxel: Float,
    step: Int,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """Runs of pixels along the rows of an image that lie in one voxel and belong to one piece.

    table, masks, n_blocks: of the store
    pieces (H, W) int32 from 1 on, 0 = none; labels (H, W) uint16, 0 = none
    weights (H, W) float32: what a full view of a voxel counts; depth (H, W) float32 [m]
    camera (4,) fx, fy, cx, cy; pose (3, 4) camera in map; voxel: edge [m]; step: every n-th row and column is looked at

    A pixel counts the share of a voxel's face that it stands for, (step · z/f)² / v², times its weight.

    Returns of each run: cells (K,) int64; owners (K,) int32: the piece, 0 for a label without a piece, −1 for no label;
    pixels (K,) int64 looked at; votes (K,) int64 [1/UNIT], rounded up and down in turn; offsets (K, 3) float32 of their
    mean point from the voxel's centre [voxels]. Then blocks (m, 3) int32 that the table does not have, numbered on from
    n_blocks, and the cells (k,) of runs with votes that have no record yet. Runs of no
    piece are left out in blocks where no piece ever was: nobody asks there.
    """
    height, width = depth.shape
    per_voxel = 1.0 / voxel
    face = UNIT * step * step * per_voxel * per_voxel / (camera[0] * camera[1])
    cx, per_fx = camera[2], 1.0 / camera[0]
    x_x, x_y, x_z = pose[0, 0] * per_voxel, pose[1, 0] * per_voxel, pose[2, 0] * per_voxel  # axes and place of the
    y_x, y_y, y_z = pose[0, 1] * per_voxel, pose[1, 1] * per_voxel, pose[2, 1] * per_voxel  # camera [voxels]
    z_x, z_y, z_z = pose[0, 2] * per_voxel, pose[1, 2] * per_voxel, pose[2, 2] * per_voxel
    eye_x, eye_y, eye_z = pose[0, 3] * per_voxel, pose[1, 3] * per_voxel, pose[2, 3] * per_voxel
    room = ((height + step - 1) // step) * ((width + step - 1) // step)
    cells, owners, pixels = np.empty(room, np.int64), np.empty(room, np.int32), np.empty(room, np.int64)
    votes, offsets, bare = np.empty(room, np.int64), np.empty((room, 3), np.float32), np.empty(room, np.int64)
    found, fresh = np.empty((1024, 3), np.int32), np.full((1024, 2), -1, np.int64)
    n_bare = n_found = n = 0
    bi: Int = 1 << 30
    bj: Int = 1 << 30
    bk: Int = 1 << 30
    slot: Int = np.int64(-1)
    for v in range(0, height, step):
        fresh, found = room_for(fresh, found, n_found, n_blocks, width)
        y = (v - camera[3]) / camera[1]
        bx, by, bz = y * y_x + z_x, y * y_y + z_y, y * y_z + z_z
        at: Int = np.int64(-1)  # cell, owner and sums of the run that is going on
        whose: Int = np.int64(-1)
        count: Int = np.int64(0)
        weight: Float = 0.0
        total = sx = sy = sz = fx = fy = fz = 0.0
        for u in range(0, width + step, step):
            cell: Int = np.int64(-1)
            owner: Int = np.int64(-1)
            if u < width and depth[v, u] > 0.0:
                z = np.float64(depth[v, u])
                owner = np.int64(pieces[v, u])
                if owner == 0 and labels[v, u] == 0:
                    owner = np.int64(-1)
                x = (u - cx) * per_fx
                px, py, pz = (x * x_x + bx) * z + eye_x, (x * x_y + by) * z + eye_y, (x * x_z + bz) * z + eye_z
                i, j, k = np.int64(np.floor(px)), np.int64(np.floor(py)), np.int64(np.floor(pz))
                fx, fy, fz = px - i - 0.5, py - j - 0.5, pz - k - 0.5
                if i >> 3 != bi or j >> 3 != bj or k >> 3 != bk:
                    bi, bj, bk = i >> 3, j >> 3, k >> 3
                    slot = np.int64(lookup(table, bi, bj, bk))
                if slot < 0 and owner > 0:
                    slot = np.int64(number_new(fresh, found, n_found, n_blocks, bi, bj, bk))
                    n_found += slot == n_blocks + n_found
                if slot >= 0:
                    cell = slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                weight = 0.0
                if owner >= 0:
                    weight = face * z * z * weights[v, u]
            if cell != at or owner != whose:
                if at >= 0:
                    cells[n], owners[n], pixels[n] = at, whose, count
                    votes[n] = rounded(total, u, v)
                    each = 1.0 / total if total > 0.0 else 0.0
                    offsets[n, 0], offsets[n, 1], offsets[n, 2] = sx * each, sy * each, sz * each
                    if votes[n] > 0 and (at >> 9 >= n_blocks or not has_record(masks, at)):
                        bare[n_bare] = at
                        n_bare += 1
                    n += 1
                at, whose, count = cell, owner, 0
                total = sx = sy = sz = 0.0
            count += 1
            total += weight
            sx, sy, sz = sx + weight * fx, sy + weight * fy, sz + weight * fz
    return cells[:n], owners[:n], pixels[:n], votes[:n], offsets[:n], found[:n_found].copy(), bare[:n_bare]


@njit(cache=True)
def count_overlaps(
    table: Array,
    masks: Array,
    first: Array,
    records: Array,
    block_ijk: Array,
    cells: Array,
    owners: Array,
    pixels: Array,
    offsets: Array,
    eye: Array,
    n_pieces: Int,
) -> tuple[Array, Array, Array, Array]:
    """How many pixels of each piece lie on voxels that which instance leads.

    block_ijk (B, 3) int32; cells, owners, pixels, offsets: see `trace`; eye (3,): the camera [voxels]
    Looked up in the voxel, then, for pieces, beside it: before and behind on the ray, above and below. Returns piece
    (K,) with 0 for none, number (K,), hits (K,) of the pairs that occur, and the pixels looked at per piece
    (n_pieces + 1,).
    """
    rows = 8192
    key = np.full(rows, -1, np.int64)
    hits = np.zeros(rows, np.int64)
    looked = np.zeros(n_pieces + 1, np.int64)
    k = records.shape[1] // 2
    n = 0
    for m in range(cells.shape[0]):
        piece: Int = max(np.int64(owners[m]), 0)
        looked[piece] += pixels[m]
        cell, slot = cells[m], cells[m] >> 9
        px = (block_ijk[slot, 0] << 3) + ((cell >> 6) & 7) + 0.5 + offsets[m, 0]
        py = (block_ijk[slot, 1] << 3) + ((cell >> 3) & 7) + 0.5 + offsets[m, 1]
        pz = (block_ijk[slot, 2] << 3) + (cell & 7) + 0.5 + offsets[m, 2]
        dx, dy, dz = px - eye[0], py - eye[1], pz - eye[2]
        per_length = 1.0 / max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        for attempt in range(7 if piece else 1):
            t = up = 0.0
            if attempt == 1:
                t = per_length
            elif attempt == 2:
                t = -per_length
            elif attempt == 3:
                up = -1.0
            elif attempt == 4:
                up = 1.0
            elif attempt == 5:
                t = 2.0 * per_length
            elif attempt == 6:
                t = -2.0 * per_length
            if attempt:
                x, y, z = np.floor(px + t * dx), np.floor(py + t * dy), np.floor(pz + t * dz + up)
                i, j, l = np.int64(x), np.int64(y), np.int64(z)
                slot = np.int64(lookup(table, i >> 3, j >> 3, l >> 3))
                cell = slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (l & 7)
            if slot < 0:
                continue
            row = row_of(masks, first, cell)
            if row < 0:
                continue
            best = leader(records, row)
            if records[row, k + best] < LEAST_EVIDENCE:
                continue
            pair = piece << 32 | np.int64(records[row, best])
            at = (pair * 2654435761) & (rows - 1)
            while key[at] >= 0 and key[at] != pair:
                at = (at + 1) & (rows - 1)
            if key[at] < 0:
                if 2 * n > rows:
                    break
                key[at] = pair
                n += 1
            hits[at] += pixels[m]
            break
    used = np.nonzero(key >= 0)[0]
    return key[used] >> 32, key[used] & 0xFFFFFFFF, hits[used], looked


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
    choices: Array,
    votes: Array,
    offsets: Array,
    limit: Int,
    mean_limit: Int,
) -> Array:
    """Count the votes of an image's runs of pixels, in place.

    records (R, 2k + 1) uint16, means (R, 3) int16: of the voxels
    sizes   (65536,) int64: in how many voxels each number leads; lost (65536,) bool: set where it loses one
    changed_at is set to `revision` for each block with votes
    cells, votes, offsets: see `trace`; choices (K,) uint16: the number that each run votes for, 0 = none
    limit: evidence at which a record is halved; mean_limit: evidence over which the mean is taken [1/UNIT]

    Returns number and slot (K, 2) int64 of the blocks in which instances got votes; repeats may remain.
    """
    k = records.shape[1] // 2
    latest = np.full(65536, -1, np.int64)
    pairs = np.empty((cells.shape[0], 2), np.int64)
    n = 0
    for m in range(cells.shape[0]):
        choice, count = choices[m], min(votes[m], limit)
        if choice == 0 or count <= 0:
            continue
        row = row_of(masks, first, cells[m])
        if row < 0:
            continue
        held: Int = np.int64(0)
        for c in range(k, 2 * k + 1):
            held += records[row, c]
        before = leader(records, row)
        was = records[row, before] if records[row, k + before] > 0 else 0
        give(records, row, choice, count, limit)
        now = records[row, leader(records, row)]
        if now != was:
            sizes[was] -= 1
            sizes[now] += 1
            lost[was] = True
        gain = count / (min(held, mean_limit) + count)
        for axis in range(3):
            mean = np.float64(means[row, axis])
            means[row, axis] = np.int16(np.rint(mean + gain * (offsets[m, axis] * MEAN_UNIT - mean)))
        slot = cells[m] >> 9
        changed_at[slot] = revision
        if choice != BACKGROUND and latest[choice] != slot:
            latest[choice] = slot
            pairs[n, 0], pairs[n, 1] = choice, slot
            n += 1
    return pairs[:n]


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
