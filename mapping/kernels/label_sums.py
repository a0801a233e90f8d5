"""Kernels of labelled points: evidence, mean and covariance summed by voxel and class. Lengths are in voxels."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import home, pack

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


@njit(cache=True)
def slot_of(table: Array, key: Int, tag: Int, fresh: Int) -> Int:
    """The slot of a packed voxel and a tag below 2²⁴ in a hash (m, 2) of voxel and slot·2²⁴ + tag, −1 in empty rows;
    where it has none, `fresh` is entered, in place."""
    size = table.shape[0]
    row = home(key ^ (np.int64(tag) << 21), size)
    while True:
        found = table[row, 1]
        if found < 0:
            table[row, 0] = key
            table[row, 1] = np.int64(fresh) << 24 | np.int64(tag)
            return fresh
        if table[row, 0] == key and found & 0xFFFFFF == tag:
            return found >> 24
        row = (row + 1) & (size - 1)


@njit(cache=True)
def bounds_of(points: Array, weights: Array) -> tuple[Array, Array]:
    """Lowest and highest coordinates (3,) of points (n, 3), zero if there are none; NaN where one of them is not
    finite or a weight (n,) is not, or below zero."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    fine = True
    for m in range(points.shape[0]):
        for d in range(3):
            x = points[m, d]
            low[d], high[d] = min(low[d], x), max(high[d], x)
            fine &= abs(x) < np.inf
    for m in range(weights.shape[0]):
        fine &= 0.0 <= weights[m] < np.inf
    if not fine:
        low[:] = np.nan
    elif points.shape[0] == 0:
        low[:] = high[:] = 0.0
    return low, high


@njit(cache=True)
def _sum_until_full(
    table: Array, ijk: Array, label_of: Array, sums: Array, squares: Array, n: Int, points: Array, labels: Array,
    weights: Array, T: Array, share: Float, first: Int,
) -> tuple[Int, Int]:  # fmt: skip
    """Sum the points from `first` on, in place, until all are done or there is no room for one voxel more; returns how
    many voxels there are and the next point. squares: (n, 6), or (0, 6) to do without."""
    with_squares = squares.shape[0] > 0
    last_i = last_j = last_k = np.int64(1) << 40
    last_label = np.uint16(0)
    slot = np.int64(0)
    for m in range(first, points.shape[0]):
        label = labels[m]
        w = weights[m] * share if weights.shape[0] else share
        if label == 0 or w == 0.0:
            continue
        a, b, c = points[m, 0], points[m, 1], points[m, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        if i != last_i or j != last_j or k != last_k or label != last_label:
            if n == ijk.shape[0]:
                return n, m
            last_i, last_j, last_k, last_label = i, j, k, label
            slot = slot_of(table, pack(i, j, k), label, n)
            if slot == n:
                ijk[n, 0], ijk[n, 1], ijk[n, 2], label_of[n] = i, j, k, label
                sums[n] = 0.0
                if with_squares:
                    squares[n] = 0.0
                n += 1
        x, y, z = x - i, y - j, z - k
        sums[slot, 0] += w * x
        sums[slot, 1] += w * y
        sums[slot, 2] += w * z
        sums[slot, 3] += w
        if with_squares:
            squares[slot, 0] += w * x * x
            squares[slot, 1] += w * y * y
            squares[slot, 2] += w * z * z
            squares[slot, 3] += w * x * y
            squares[slot, 4] += w * x * z
            squares[slot, 5] += w * y * z
    return n, points.shape[0]


@njit(cache=True)
def sum_labels(
    points: Array, labels: Array, weights: Array, poses: Array, with_squares: bool
) -> tuple[Array, Array, Array, Array]:
    """Evidence of labelled points, seen from each of some poses, summed by voxel and class.

    points : (n, 3) float64; labels : (n,) uint16, 0 = none; weights : (n,) float64 ≥ 0, or (0,): all 1
    poses  : (p, 3, 4) float64 takes points to where they are [voxels]; each counts 1/p
    Returns voxels (m, 3) int32, labels (m,) uint16, the mean point, weighted by evidence, and the evidence (m, 4)
    float64 [voxels], in order of first appearance; and, if asked for, the covariance xx, yy, zz, xy, xz, yz of the
    points about their mean (m, 6), else (0, 6).
    """
    room = 1 << 10
    while room < min(points.shape[0], 1 << 15):
        room *= 2
    table = np.full((2 * room, 2), -1, np.int64)
    ijk, label_of, sums = np.empty((room, 3), np.int32), np.empty(room, np.uint16), np.empty((room, 4))
    squares = np.empty((room if with_squares else 0, 6))
    n = 0
    for p in range(poses.shape[0]):
        m = 0
        while True:
            n, m = _sum_until_full(
                table, ijk, label_of, sums, squares, n, points, labels, weights, poses[p], 1.0 / poses.shape[0], m
            )
            if m == points.shape[0]:
                break
            room *= 2
            ijk = np.concatenate((ijk, np.empty_like(ijk)))
            label_of = np.concatenate((label_of, np.empty_like(label_of)))
            sums = np.concatenate((sums, np.empty_like(sums)))
            squares = np.concatenate((squares, np.empty_like(squares)))
            table = np.full((2 * room, 2), -1, np.int64)
            for s in range(n):
                slot_of(table, pack(ijk[s, 0], ijk[s, 1], ijk[s, 2]), label_of[s], s)
    for s in range(n):
        x, y, z = sums[s, 0] / sums[s, 3], sums[s, 1] / sums[s, 3], sums[s, 2] / sums[s, 3]
        if with_squares:
            for d in range(6):
                squares[s, d] /= sums[s, 3]
            squares[s, 0], squares[s, 3] = max(squares[s, 0] - x * x, 0.0), squares[s, 3] - x * y
            squares[s, 1], squares[s, 4] = max(squares[s, 1] - y * y, 0.0), squares[s, 4] - x * z
            squares[s, 2], squares[s, 5] = max(squares[s, 2] - z * z, 0.0), squares[s, 5] - y * z
        sums[s, 0], sums[s, 1], sums[s, 2] = ijk[s, 0] + x, ijk[s, 1] + y, ijk[s, 2] + z
    return ijk[:n], label_of[:n], sums[:n], squares[:n]
