"""Kernels of height map, elevation map and extended elevation map: folding the heights of one scan into cells.

Scans are grouped by cell as in `mapping.kernels.tiles`.
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

# -- height map ------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def fuse_heights(
    count: Array, mean: Array, spread: Array, lowest: Array, highest: Array, slots: Array, starts: Array, heights: Array
) -> None:
    """Fold a scan into number, mean, sum of squared deviations, lowest and highest height of cells, in place.

    count … highest : (capacity, 64) float32;  slots (n_tiles,);  starts, heights as in `tiles.group_by_cell`
    (Chan, Golub & LeVeque, Updating formulae and a pairwise algorithm for computing sample variances, 1979.)
    """
    for r in range(slots.shape[0]):
        slot = slots[r]
        for w in range(64):
            start, end = starts[64 * r + w], starts[64 * r + w + 1]
            if start == end:
                continue
            low = high = heights[start]
            middle = 0.0
            for n in range(start, end):
                low, high, middle = min(low, heights[n]), max(high, heights[n]), middle + heights[n]
            m = end - start
            middle /= m
            deviation = 0.0
            for n in range(start, end):
                deviation += (heights[n] - middle) ** 2
            before = np.float64(count[slot, w])
            if before == 0.0:
                lowest[slot, w], highest[slot, w], mean[slot, w] = low, high, middle
                spread[slot, w] = deviation
            else:
                lowest[slot, w] = min(np.float64(lowest[slot, w]), low)
                highest[slot, w] = max(np.float64(highest[slot, w]), high)
                away = middle - mean[slot, w]
                spread[slot, w] += deviation + away * away * before * m / (before + m)
                mean[slot, w] += away * m / (before + m)
            count[slot, w] = before + m


# -- elevation map ---------------------------------------------------------------------------------------------


@njit(cache=True, inline="always", error_model="numpy")
def weigh(heights: Array, weights: Array, start: Int, end: Int) -> tuple[Float, Float]:
    """The weighted mean of heights [start, end) and the sum of weights: what a Kalman filter makes of them."""
    weight = 0.0
    total = 0.0
    for n in range(start, end):
        weight += weights[n]
        total += heights[n] * weights[n]
    return total / weight, weight


@njit(cache=True, error_model="numpy")
def fuse_elevations(
    mean: Array,
    variance: Array,
    slots: Array,
    tiles: Array,
    starts: Array,
    heights: Array,
    weights: Array,
    cell_size: Float,
    pose: Array,
    quadratic: Array,
    least_variance: Float,
    changed: Array,
) -> None:
    """Kalman update of the height of each cell by the heights that a scan measured in it, in place.

    mean, variance : (capacity, 64) float32, NaN where nothing is known
    changed        : (n_tiles,) bool, filled: whether a cell of the tile changed
    The points of a scan share the error of its pose: their weighted mean has the variance 1/Σ(1/σ²) + σ_pose².
    """
    for r in range(slots.shape[0]):
        slot = slots[r]
        changed[r] = False
        for w in range(64):
            start, end = starts[64 * r + w], starts[64 * r + w + 1]
            if start == end:
                continue
            height, weight = weigh(heights, weights, start, end)
            noise = 1.0 / weight + pose_variance(tiles, r, w, cell_size, pose, quadratic)
            old_mean, old_variance = mean[slot, w], variance[slot, w]
            if np.isnan(old_mean):
                mean[slot, w] = height
                variance[slot, w] = max(noise, least_variance)
            else:
                gain = old_variance / (old_variance + noise)
                mean[slot, w] = old_mean + gain * (height - old_mean)
                variance[slot, w] = max((1.0 - gain) * old_variance, least_variance)
            changed[r] |= mean[slot, w] != old_mean or variance[slot, w] != old_variance


# -- extended elevation map ------------------------------------------------------------------------------------


LOW, HIGH, WEIGHT, MEAN, SPREAD = 0, 1, 2, 3, 4
"""Columns of a *part*: the heights of a cell that no gap separates. SPREAD is Σ w·(z − mean)²."""


@njit(cache=True, error_model="numpy")
def absorb(parts: Array, a: Int, b: Int) -> None:
    """Make part `a` of parts (m, 5) the union of parts a and b, in place (Chan et al. 1979)."""
    weight = parts[a, WEIGHT] + parts[b, WEIGHT]
    away = parts[b, MEAN] - parts[a, MEAN]
    parts[a, LOW] = min(parts[a, LOW], parts[b, LOW])
    parts[a, HIGH] = max(parts[a, HIGH], parts[b, HIGH])
    parts[a, SPREAD] += parts[b, SPREAD] + away * away * parts[a, WEIGHT] * parts[b, WEIGHT] / weight
    parts[a, MEAN] += away * parts[b, WEIGHT] / weight
    parts[a, WEIGHT] = weight


@njit(cache=True, error_model="numpy")
def join_parts(parts: Array, n: Int, gap: Float, most: Int) -> Int:
    """Join those of the first n of parts (m, 5) that no gap separates, then the nearest until `most` are left.

    Changes parts in place: ascending. Returns how many are left.
    """
    for a in range(1, n):  # few, and nearly in order
        b = a
        while b > 0 and parts[b - 1, LOW] > parts[b, LOW]:
            for f in range(5):
                parts[b, f], parts[b - 1, f] = parts[b - 1, f], parts[b, f]
            b -= 1
    kept = 0
    for a in range(1, n):
        if parts[a, LOW] - parts[kept, HIGH] <= gap:
            absorb(parts, kept, a)
        else:
            kept += 1
            for f in range(5):
                parts[kept, f] = parts[a, f]
    kept += 1
    while kept > most:
        nearest = 1
        for a in range(2, kept):
            if parts[a, LOW] - parts[a - 1, HIGH] < parts[nearest, LOW] - parts[nearest - 1, HIGH]:
                nearest = a
        absorb(parts, nearest - 1, nearest)
        for a in range(nearest, kept - 1):
            for f in range(5):
                parts[a, f] = parts[a + 1, f]
        kept -= 1
    return kept


@njit(cache=True, error_model="numpy")
def fuse_parts(
    parts: Array,
    slots: Array,
    tiles: Array,
    starts: Array,
    heights: Array,
    weights: Array,
    cell_size: Float,
    pose: Array,
    quadratic: Array,
    gap: Float,
    changed: Array,
) -> None:
    """Fold the heights of a scan into the parts of each cell, in place.

    parts   : (capacity, 64, K, 5) float32, columns as above, NaN where there is none
    gap     : height [m] that must be empty between two parts
    changed : (n_tiles,) bool, filled: whether a cell of the tile changed
    """
    most = parts.shape[2]
    longest = 0
    for c in range(64 * slots.shape[0]):
        longest = max(longest, starts[c + 1] - starts[c])
    lows, highs = np.empty(longest), np.empty(longest)
    work = np.empty((longest + most, 5))
    for r in range(slots.shape[0]):
        slot = slots[r]
        changed[r] = False
        for w in range(64):
            start, end = starts[64 * r + w], starts[64 * r + w + 1]
            if start == end:
                continue
            n = 0
            while n < most and not np.isnan(parts[slot, w, n, LOW]):
                for f in range(5):
                    work[n, f] = parts[slot, w, n, f]
                n += 1
            n_before = n
            shared = pose_variance(tiles, r, w, cell_size, pose, quadratic)
            m = split_at_gaps(heights, start, end, gap, lows, highs)
            for a in range(m):
                work[n + a, LOW], work[n + a, HIGH] = lows[a], highs[a]
                work[n + a, WEIGHT], work[n + a, MEAN], work[n + a, SPREAD] = 0.0, 0.0, 0.0
            for pass_ in range(2):
                for k in range(start, end):
                    a = 0
                    while heights[k] > highs[a]:
                        a += 1
                    if pass_ == 0:
                        work[n + a, WEIGHT] += weights[k]
                        work[n + a, MEAN] += heights[k] * weights[k]
                    else:
                        work[n + a, SPREAD] += (heights[k] - work[n + a, MEAN]) ** 2 * weights[k]
                for a in range(n, n + m):
                    if pass_ == 0:
                        work[a, MEAN] /= work[a, WEIGHT]
                    else:  # what the points of a scan weigh together is bounded by the error of its pose
                        weight = 1.0 / (1.0 / work[a, WEIGHT] + shared)
                        work[a, SPREAD] *= weight / work[a, WEIGHT]
                        work[a, WEIGHT] = weight
            n = join_parts(work, n + m, gap, most)
            for a in range(n):
                for f in range(5):
                    value = np.float32(work[a, f])
                    changed[r] |= value != parts[slot, w, a, f]
                    parts[slot, w, a, f] = value
            for a in range(n, n_before):
                changed[r] = True
                for f in range(5):
                    parts[slot, w, a, f] = np.nan
