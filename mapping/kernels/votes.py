"""Votes of labelled pixels for the voxels in which their points lie.

A pixel's vote weighs the share of a voxel's face that the pixel covers, (z/f)² / v², so that a full view of a voxel
counts about one whatever the distance, and less near the boundary of its mask, where masks are wrong most often.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import find_or_insert, lookup

Array = NDArray[Any]

DENSE_PIXELS = 0.25
"""Surfaces nearer than this share of the distance at which a pixel is as wide as a voxel are seen densely enough."""


@njit(cache=True)
def touched_blocks(depth: Array, wanted: Array, camera: Array, pose: Array, voxel: float, step: int) -> Array:
    """The blocks (K, 3) int32 in which the points of the wanted pixels lie, each once, in order of appearance.

    depth  : (H, W) float32 [m];  wanted : (H, W) bool
    camera : (4,) fx, fy, cx, cy;  pose : (3, 4) camera in map;  voxel : edge [m];  step : every n-th row and column
    """
    height, width = depth.shape
    edge = 8.0 * voxel
    found = np.empty((1024, 3), dtype=np.int32)
    table = np.full((4096, 2), -1, dtype=np.int64)
    n = 0
    last_i = last_j = last_k = 1 << 30
    for v in range(0, height, step):
        for u in range(0, width, step):
            if not wanted[v, u]:
                continue
            z = depth[v, u]
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            i = int(np.floor((pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / edge))
            j = int(np.floor((pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / edge))
            k = int(np.floor((pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) / edge))
            if i == last_i and j == last_j and k == last_k:
                continue
            last_i, last_j, last_k = i, j, k
            if find_or_insert(table, i, j, k, n) == n:
                if n == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[n, 0], found[n, 1], found[n, 2] = i, j, k
                n += 1
                if 2 * n > len(table):
                    table = np.full((2 * len(table), 2), -1, dtype=np.int64)
                    for b in range(n):
                        find_or_insert(table, found[b, 0], found[b, 1], found[b, 2], b)
    return found[:n].copy()


@njit(cache=True, inline="always")
def _vote(
    first: Array, first_weight: Array, second: Array, second_weight: Array, s: int, l: int, choice: int, w: float
) -> None:
    """Count one vote in voxel (s, l): the leader and a contender are kept, a third choice wears the contender down
    (Misra & Gries 1982 with two counters)."""
    if choice == first[s, l]:
        first_weight[s, l] += w
    elif first_weight[s, l] == 0.0:
        first[s, l] = choice
        first_weight[s, l] = w
    else:
        if choice == second[s, l]:
            second_weight[s, l] += w
        elif second_weight[s, l] >= w:
            second_weight[s, l] -= w
        else:
            second[s, l] = choice
            second_weight[s, l] = w - second_weight[s, l]
        if second_weight[s, l] > first_weight[s, l]:
            first[s, l], second[s, l] = second[s, l], first[s, l]
            first_weight[s, l], second_weight[s, l] = second_weight[s, l], first_weight[s, l]


@njit(cache=True, inline="always")
def _remember(first_weight: Array, second_weight: Array, total: Array, s: int, l: int, w: float, limit: float) -> None:
    """Add a vote to the sum of voxel (s, l); beyond the limit all of its votes count half from now on."""
    total[s, l] += w
    if total[s, l] > limit:
        total[s, l] *= 0.5
        first_weight[s, l] *= 0.5
        second_weight[s, l] *= 0.5


@njit(cache=True)
def vote_points(
    table: Array,
    first: Array,
    first_weight: Array,
    second: Array,
    second_weight: Array,
    total: Array,
    p_map: Array,
    choices: Array,
    weights: Array,
    voxel: float,
    limit: float,
) -> None:
    """Votes of points, in place. p_map (N, 3) [m], choices (N,) with 0 = no vote, weights (N,)."""
    per_voxel = 1.0 / voxel  # as everywhere, so that a point on a border lies in the same voxel for all
    for n in range(len(p_map)):
        if choices[n] == 0 or not weights[n] > 0.0:
            continue
        i = int(np.floor(p_map[n, 0] * per_voxel))
        j = int(np.floor(p_map[n, 1] * per_voxel))
        k = int(np.floor(p_map[n, 2] * per_voxel))
        s = lookup(table, i >> 3, j >> 3, k >> 3)
        if s < 0:
            continue
        l = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
        _vote(first, first_weight, second, second_weight, s, l, choices[n], weights[n])
        _remember(first_weight, second_weight, total, s, l, weights[n], limit)


@njit(cache=True)
def vote_image(
    table: Array,
    first: Array,
    first_weight: Array,
    second: Array,
    second_weight: Array,
    total: Array,
    mean: Array,
    depth: Array,
    choices: Array,
    weights: Array,
    camera: Array,
    pose: Array,
    voxel: float,
    limit: float,
    mean_limit: float,
) -> None:
    """Votes of the pixels of an image, in place.

    first, second (n, 512) choices and first_weight, second_weight, total (n, 512) float32: the voxels
    mean    (n, 512, 3) float32: offset of the mean point from the voxel's centre, in voxels; size 0 to do without
    depth   (H, W) float32 [m]; choices (H, W) with 0 = no vote; weights (H, W) float32: trust in each pixel, 0 … 1
    camera  (4,) fx, fy, cx, cy; pose (3, 4) camera in map
    limit   total at which a voxel's votes are halved; mean_limit: votes that the mean remembers

    Where pixels are far denser than voxels every other row and column is enough.
    """
    height, width = depth.shape
    focal = camera[0] * camera[1]
    dense = DENSE_PIXELS * voxel * np.sqrt(focal)
    with_mean = mean.shape[0] > 0
    last_i = last_j = last_k = 1 << 30
    s = -1
    for v in range(height):
        for u in range(width):
            choice = choices[v, u]
            if choice == 0:
                continue
            z = depth[v, u]
            w = weights[v, u] * z * z / (focal * voxel * voxel)
            if z < dense:
                if (u | v) & 1:
                    continue
                w *= 4.0
            if not w > 0.0:
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            px = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / voxel
            py = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / voxel
            pz = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) / voxel
            i, j, k = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                last_i, last_j, last_k = bi, bj, bk
                s = lookup(table, bi, bj, bk)
            if s < 0:
                continue
            l = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
            if with_mean:
                gain = w / (min(total[s, l], mean_limit) + w)
                mean[s, l, 0] += gain * (px - i - 0.5 - mean[s, l, 0])
                mean[s, l, 1] += gain * (py - j - 0.5 - mean[s, l, 1])
                mean[s, l, 2] += gain * (pz - k - 0.5 - mean[s, l, 2])
            _vote(first, first_weight, second, second_weight, s, l, choice, w)
            _remember(first_weight, second_weight, total, s, l, w, limit)


@njit(cache=True)
def count_overlaps(
    table: Array,
    first: Array,
    first_weight: Array,
    depth: Array,
    pieces: Array,
    camera: Array,
    pose: Array,
    voxel: float,
    step: int,
    n_pieces: int,
) -> tuple[Array, Array, Array, Array]:
    """How many pixels of each piece lie on voxels of which known instance.

    pieces (H, W) int32: 1 … n_pieces, 0 = none. Looked up at the point, then beside it: before and behind on the ray,
    above and below. Returns piece (K,) with 0 for none, instance (K,), hits (K,) of the pairs that occur, and the
    pixels
    looked at per piece (n_pieces + 1,).
    """
    height, width = depth.shape
    rows = 8192
    key = np.full(rows, -1, dtype=np.int64)
    hits = np.zeros(rows, dtype=np.int64)
    looked = np.zeros(n_pieces + 1, dtype=np.int64)
    n = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            z = depth[v, u]
            if not z > 0.0:
                continue
            piece = pieces[v, u]
            looked[piece] += 1
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            dx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z
            dy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z
            dz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z
            for attempt in range(7 if piece else 1):
                t = 1.0
                up = 0.0
                if attempt == 1:
                    t = 1.0 + voxel / z
                elif attempt == 2:
                    t = 1.0 - voxel / z
                elif attempt == 3:
                    up = -voxel
                elif attempt == 4:
                    up = voxel
                elif attempt == 5:
                    t = 1.0 + 2.0 * voxel / z
                elif attempt == 6:
                    t = 1.0 - 2.0 * voxel / z
                i = int(np.floor((t * dx + pose[0, 3]) / voxel))
                j = int(np.floor((t * dy + pose[1, 3]) / voxel))
                k = int(np.floor((t * dz + pose[2, 3] + up) / voxel))
                s = lookup(table, i >> 3, j >> 3, k >> 3)
                if s < 0:
                    continue
                l = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                if first[s, l] == 0 or first_weight[s, l] < 0.05:
                    continue
                pair = np.int64(piece) << 32 | np.int64(first[s, l])
                row = (pair * 2654435761) & (rows - 1)
                while key[row] >= 0 and key[row] != pair:
                    row = (row + 1) & (rows - 1)
                if key[row] < 0:
                    if 2 * n > rows:
                        break
                    key[row] = pair
                    n += 1
                hits[row] += 1
                break
    used = np.nonzero(key >= 0)[0]
    return key[used] >> 32, key[used] & 0xFFFFFFFF, hits[used], looked


@njit(cache=True)
def gather(
    slots: Array,
    block_ijk: Array,
    first: Array,
    first_weight: Array,
    total: Array,
    mean: Array,
    instance: int,
    voxel: float,
    least_weight: float,
    least_share: float,
) -> tuple[Array, Array]:
    """The mean points (N, 3) float32 [m] and weights (N,) of the voxels that an instance has won, in the blocks
    `slots`."""
    n = 0
    for at in range(len(slots)):
        s = slots[at]
        for l in range(512):
            if first[s, l] == instance and first_weight[s, l] >= max(least_weight, least_share * total[s, l]):
                n += 1
    points = np.empty((n, 3), dtype=np.float32)
    weights = np.empty(n, dtype=np.float32)
    n = 0
    for at in range(len(slots)):
        s = slots[at]
        for l in range(512):
            if first[s, l] == instance and first_weight[s, l] >= max(least_weight, least_share * total[s, l]):
                points[n, 0] = ((block_ijk[s, 0] << 3) + (l >> 6) + 0.5 + mean[s, l, 0]) * voxel
                points[n, 1] = ((block_ijk[s, 1] << 3) + (l >> 3 & 7) + 0.5 + mean[s, l, 1]) * voxel
                points[n, 2] = ((block_ijk[s, 2] << 3) + (l & 7) + 0.5 + mean[s, l, 2]) * voxel
                weights[n] = first_weight[s, l]
                n += 1
    return points, weights


@njit(cache=True)
def rename(
    slots: Array, first: Array, first_weight: Array, second: Array, second_weight: Array, old: int, new: int
) -> None:
    """Give the votes for choice `old` to `new` in the blocks `slots`, in place."""
    for at in range(len(slots)):
        s = slots[at]
        for l in range(512):
            if first[s, l] == old:
                first[s, l] = new
            if second[s, l] == old:
                second[s, l] = new
            if first[s, l] == new and second[s, l] == new:
                first_weight[s, l] += second_weight[s, l]
                second[s, l] = 0
                second_weight[s, l] = 0.0


@njit(cache=True)
def blocks_of_choices(
    table: Array, depth: Array, choices: Array, camera: Array, pose: Array, voxel: float, step: int
) -> Array:
    """Pairs (choice, slot) (K, 2) int64 of the blocks in which pixels with a choice ≠ 0 lie; repeats may remain."""
    height, width = depth.shape
    pairs = np.empty((height * width // (step * step) + 1, 2), dtype=np.int64)
    n = 0
    for v in range(0, height, step):
        for u in range(0, width, step):
            choice = choices[v, u]
            if choice == 0:
                continue
            z = depth[v, u]
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            i = int(np.floor((pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / voxel))
            j = int(np.floor((pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / voxel))
            k = int(np.floor((pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) / voxel))
            s = lookup(table, i >> 3, j >> 3, k >> 3)
            if s < 0 or (n and pairs[n - 1, 0] == choice and pairs[n - 1, 1] == s):
                continue
            pairs[n, 0], pairs[n, 1] = choice, s
            n += 1
    return pairs[:n]


@njit(cache=True)
def classes_of_instances(
    table: Array,
    first: Array,
    first_weight: Array,
    class_of: Array,
    background: int,
    low: Array,
    high: Array,
    labels: Array,
    weights: Array,
    others: Array,
) -> None:
    """What fine voxels within each box say of its class by the instances that lead in them, in place.

    class_of        (m,) uint16: the class of instance 0 … m − 1; background: the choice that is no instance
    low, high       (N, 3) int64: lowest fine voxel of each box, and the first beyond it
    labels, weights (N,) filled: the class with most votes, and these; others (N,): votes for other classes and for none
    """
    classes, votes = np.empty(64, np.uint16), np.empty(64)
    for n in range(len(low)):
        count = 0
        total = 0.0
        for i in range(low[n, 0], high[n, 0]):
            for j in range(low[n, 1], high[n, 1]):
                for k in range(low[n, 2], high[n, 2]):
                    s = lookup(table, i >> 3, j >> 3, k >> 3)
                    if s < 0:
                        continue
                    l = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                    w = first_weight[s, l]
                    if first[s, l] == 0 or not w > 0.0:
                        continue
                    total += w
                    if first[s, l] == background or first[s, l] >= len(class_of):
                        continue
                    c = class_of[first[s, l]]
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
