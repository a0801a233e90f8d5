"""Kernels of the multi-level surface map: the update rules of one cell's patches.

A *patch* is (mean, variance, depth): a surface at height mean [m] of variance [m²], below which `depth` [m] is solid:
it occupies [mean − depth, mean]. (Triebel, Pfaff & Burgard, Multi-Level Surface Maps for Outdoor Terrain Mapping and
Loop Closing, IROS 2006.)
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.tiles import pose_variance, split_at_gaps

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MEAN, VARIANCE, DEPTH = 0, 1, 2
"""Columns of a patch."""


@njit(cache=True, error_model="numpy")
def nearest_patch(patches: Array, n: Int, height: Float) -> Int:
    """Which of the first n of patches (m, 3) is nearest to a height [m]: 0 away from what it occupies; −1: none.

    Of equally near ones the first counts.
    """
    best = -1
    best_distance = np.inf
    for a in range(n):
        top = patches[a, MEAN]
        distance = max(height - top, top - patches[a, DEPTH] - height, 0.0)
        if distance < best_distance:
            best, best_distance = a, distance
    return best


@njit(cache=True, error_model="numpy")
def unite(patches: Array, a: Int, b: Int) -> None:
    """Make patch `a` of patches (m, 3) the surface of the higher of a and b, solid down to the lower bottom."""
    bottom = min(patches[a, MEAN] - patches[a, DEPTH], patches[b, MEAN] - patches[b, DEPTH])
    if patches[b, MEAN] > patches[a, MEAN]:
        patches[a, MEAN], patches[a, VARIANCE] = patches[b, MEAN], patches[b, VARIANCE]
    patches[a, DEPTH] = patches[a, MEAN] - bottom


@njit(cache=True, error_model="numpy")
def tidy(patches: Array, n: Int, most: Int) -> Int:
    """Put the first n of patches (m, 3) in ascending order, unite those that overlap, and the nearest beyond `most`.

    In place; returns how many are left.
    """
    for a in range(1, n):
        b = a
        while b > 0 and patches[b - 1, MEAN] > patches[b, MEAN]:
            for f in range(3):
                patches[b, f], patches[b - 1, f] = patches[b - 1, f], patches[b, f]
            b -= 1
    while True:
        nearest, smallest = 0, np.inf
        for a in range(1, n):
            gap = patches[a, MEAN] - patches[a, DEPTH] - patches[a - 1, MEAN]
            if gap < smallest:
                nearest, smallest = a, gap
        if n <= most and smallest > 0.0:
            return n
        unite(patches, nearest - 1, nearest)
        for a in range(nearest, n - 1):
            for f in range(3):
                patches[a, f] = patches[a + 1, f]
        n -= 1


@njit(cache=True, error_model="numpy")
def update_cell(
    patches: Array, n: Int, most: Int, height: Float, variance: Float, depth: Float, least_variance: Float
) -> Int:
    """One measurement of a cell: a surface at `height` of `variance`, solid for `depth` below. Returns the new n.

    patches : (> most, 3), the first n in ascending order; changes in place
    Within 3 σ of the nearest patch it corrects that one (Kalman); where that one is solid it is disregarded; else it is
    a new patch. Patches that then overlap are one; of more than `most`, the two with the smallest gap become one.
    """
    bottom = height - depth
    a = nearest_patch(patches, n, height)
    if a >= 0 and (height - patches[a, MEAN]) ** 2 <= 9.0 * patches[a, VARIANCE]:
        old_bottom = patches[a, MEAN] - patches[a, DEPTH]
        gain = patches[a, VARIANCE] / (patches[a, VARIANCE] + variance)
        patches[a, MEAN] += gain * (height - patches[a, MEAN])
        patches[a, VARIANCE] = max((1.0 - gain) * patches[a, VARIANCE], least_variance)
        if depth > 0.0 or patches[a, DEPTH] > 0.0:
            patches[a, DEPTH] = max(patches[a, MEAN] - min(old_bottom, bottom), 0.0)
    elif a >= 0 and patches[a, MEAN] - patches[a, DEPTH] <= height <= patches[a, MEAN]:
        patches[a, DEPTH] = max(patches[a, DEPTH], patches[a, MEAN] - bottom)
    else:
        patches[n, MEAN], patches[n, VARIANCE], patches[n, DEPTH] = height, max(variance, least_variance), depth
        n += 1
    return tidy(patches, n, most)


@njit(cache=True, error_model="numpy")
def fuse_patches(
    patches: Array,
    slots: Array,
    tiles: Array,
    starts: Array,
    heights: Array,
    weights: Array,
    cell_size: Float,
    pose: Array,
    quadratic: Array,
    least_variance: Float,
    gap: Float,
    thickness: Float,
    changed: Array,
) -> None:
    """Cut the heights that a scan measured in each cell into intervals and update the cell's patches by them, in place.

    patches   : (capacity, 64, K, 3) float32, columns as above, NaN where there is none
    gap       : heights farther apart than this [m] belong to different intervals
    thickness : an interval longer than this [m] is vertical: a patch at its highest point, as deep as the interval is
                long; others are horizontal: a patch without depth at the weighted mean of their points
    changed   : (n_tiles,) bool, filled: whether a cell of the tile changed
    """
    most = patches.shape[2]
    longest = 0
    for c in range(64 * slots.shape[0]):
        longest = max(longest, starts[c + 1] - starts[c])
    lows, highs = np.empty(longest), np.empty(longest)
    totals, means, tops = np.empty(longest), np.empty(longest), np.empty(longest)
    work = np.empty((most + 1, 3))
    for r in range(slots.shape[0]):
        slot = slots[r]
        changed[r] = False
        for w in range(64):
            start, end = starts[64 * r + w], starts[64 * r + w + 1]
            if start == end:
                continue
            n = 0
            while n < most and not np.isnan(patches[slot, w, n, MEAN]):
                for f in range(3):
                    work[n, f] = patches[slot, w, n, f]
                n += 1
            n_before = n
            m = split_at_gaps(heights, start, end, gap, lows, highs)
            for a in range(m):
                totals[a], means[a], tops[a] = 0.0, 0.0, 0.0
            for k in range(start, end):
                a = 0
                while heights[k] > highs[a]:
                    a += 1
                totals[a] += weights[k]
                means[a] += heights[k] * weights[k]
                if heights[k] == highs[a]:
                    tops[a] = max(tops[a], weights[k])
            shared = pose_variance(tiles, r, w, cell_size, pose, quadratic)
            for a in range(m):
                length = highs[a] - lows[a]
                if length > thickness:
                    height, variance, depth = highs[a], 1.0 / tops[a], length
                else:
                    height, variance, depth = means[a] / totals[a], 1.0 / totals[a], 0.0
                n = update_cell(work, n, most, height, variance + shared, depth, least_variance)
            for a in range(n):
                for f in range(3):
                    value = np.float32(work[a, f])
                    changed[r] |= value != patches[slot, w, a, f]
                    patches[slot, w, a, f] = value
            for a in range(n, n_before):
                changed[r] = True
                for f in range(3):
                    patches[slot, w, a, f] = np.nan


@njit(cache=True, error_model="numpy")
def read_nearest(patches: Array, slots: Array, local: Array, heights: Array, found: Array) -> None:
    """The patch nearest to each height, as `nearest_patch` has it, in the cell (slots, local) (n,); in place.

    heights : (n,) float64 [m], NaN: the lowest patch is asked for
    found   : (n, 4) float64, filled: mean, variance, depth, and the free height above it, ∞ where no patch is above;
              NaN where there is no patch
    """
    for n in range(slots.shape[0]):
        found[n, 0] = found[n, 1] = found[n, 2] = found[n, 3] = np.nan
        slot, w = slots[n], local[n]
        best = -1
        best_distance = np.inf
        m = 0
        while slot >= 0 and m < patches.shape[2] and not np.isnan(patches[slot, w, m, MEAN]):
            top = np.float64(patches[slot, w, m, MEAN])
            bottom = top - np.float64(patches[slot, w, m, DEPTH])
            distance = 0.0 if np.isnan(heights[n]) else max(heights[n] - top, bottom - heights[n], 0.0)
            if distance < best_distance:
                best, best_distance = m, distance
            m += 1
        if best >= 0:
            for f in range(3):
                found[n, f] = patches[slot, w, best, f]
            found[n, 3] = np.inf
            if best + 1 < m:
                above = np.float64(patches[slot, w, best + 1, MEAN]) - np.float64(patches[slot, w, best + 1, DEPTH])
                found[n, 3] = above - found[n, 0]
