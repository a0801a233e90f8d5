"""What lies beside, under, in and between oriented boxes: measurements of pairs of them.

Boxes are named by their rows in `Boxes`; pairs are (m, 2) rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels import hashing
from mapping.kernels.box_grid import MOST_CELLS, Grid, cells_covered
from mapping.kernels.boxes import UPRIGHT, Boxes, column_through, crosses, gap_between, outside
from mapping.kernels.shapes import overlap_area

__all__ = ["Obstacles", "inside_boxes", "measure_pairs", "shares_in_polygons", "stand"]

Array = NDArray[Any]

SIDE_SAMPLES = 8
"""A footing is looked at in the middles of so many squares along each side."""


class Obstacles(NamedTuple):
    """Boxes through which no way leads: centres, half sizes (n, 3) [m], axes (n, 3, 3), and a grid of their bounds."""

    center: Array
    half: Array
    axes: Array
    grid: Grid


@njit(cache=True)
def _blocked(p: Array, q: Array, inset_m: float, obstacles: Obstacles) -> bool:
    """Whether the segment from p to q (3,), short of `inset_m` at both ends, meets an obstacle."""
    center, half, axes, grid = obstacles
    length = np.sqrt(((q - p) ** 2).sum())
    if length < 1e-6 or len(center) == 0:
        return False
    inset = min(inset_m, 0.3 * length) / length
    a, b = p + inset * (q - p), q - inset * (q - p)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    everything = cells_covered(np.minimum(a, b), np.maximum(a, b), grid.cell, first, last) > MOST_CELLS
    for m in range(len(center) if everything else len(grid.large)):
        n = m if everything else grid.large[m]
        if crosses(center[n], half[n], axes[n], a, b):
            return True
    if everything:
        return False
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                slot = hashing.lookup(grid.table, i, j, k)
                entry = grid.heads[slot] if slot >= 0 else -1
                while entry >= 0:
                    n = grid.items[entry]
                    if crosses(center[n], half[n], axes[n], a, b):
                        return True
                    entry = grid.following[entry]
    return False


@njit(cache=True)
def measure_pairs(
    pairs: Array, boxes: Boxes, reach: Array, inset_m: float, obstacles: Obstacles
) -> tuple[Array, Array, Array, Array]:
    """Measurements of pairs (m, 2) of boxes.

    reach   : (n,) the gap of a pair is looked for up to the sum of both [m]
    inset_m : the way between two boxes begins and ends this far from them
    Returns (m,) arrays: gap [m] (inf beyond reach); whether the way between the nearest points is clear;
    overlap of the footprints as a share of the smaller; whether a solid lies between the upper and the lower there.
    """
    n_pairs = len(pairs)
    gap, overlap = np.full(n_pairs, np.inf), np.zeros(n_pairs)
    clear, between = np.ones(n_pairs, np.bool_), np.zeros(n_pairs, np.bool_)
    p, q = np.empty(3), np.empty(3)
    center, half, axes, low, high, corners, count, area, _ = boxes
    for m in range(n_pairs):
        i, j = pairs[m, 0], pairs[m, 1]
        bounds_apart = 0.0
        for r in range(3):
            bounds_apart += max(0.0, low[i, r] - high[j, r], low[j, r] - high[i, r]) ** 2
        far = reach[i] + reach[j]
        apart = np.inf
        if bounds_apart <= far * far:
            apart = gap_between(center[i], half[i], axes[i], center[j], half[j], axes[j], p, q)
        if apart <= far:
            gap[m] = apart
            clear[m] = apart == 0.0 or not _blocked(p, q, inset_m, obstacles)
        smaller = min(area[i], area[j])
        if (
            smaller <= 0.0
            or low[i, 0] > high[j, 0]
            or low[j, 0] > high[i, 0]
            or low[i, 1] > high[j, 1]
            or low[j, 1] > high[i, 1]
        ):
            continue
        shared = overlap_area(corners[i, : count[i]], corners[j, : count[j]])
        overlap[m] = min(1.0, shared / smaller)
        if shared > 0.0 and (low[i, 2] > high[j, 2] or low[j, 2] > high[i, 2]):
            upper, lower = (i, j) if low[i, 2] > high[j, 2] else (j, i)
            small = i if area[i] <= area[j] else j
            other = j if small == i else i
            p[0], p[1] = _common_point(
                corners[small, : count[small]], center[small], center[other], half[other], axes[other]
            )
            q[0], q[1] = p[0], p[1]
            p[2], q[2] = low[upper, 2], high[lower, 2]
            between[m] = _blocked(p, q, inset_m, obstacles)
    return gap, clear, overlap, between


@njit(cache=True)
def _common_point(corners: Array, middle: Array, center: Array, half: Array, axes: Array) -> tuple[float, float]:
    """A point of one footprint that lies in another's: its middle, else the mean of its parts inside."""
    if column_through(center, half, axes, middle[0], middle[1])[0] < np.inf:
        return middle[0], middle[1]
    x = y = 0.0
    n = 0
    for m in range(len(corners)):
        for a in range(1, 8):
            for b in range(8):
                along, across = a / 8.0, b / 8.0
                s, t = corners[m], corners[(m + 1) % len(corners)]
                at_x = middle[0] + along * (s[0] + across * (t[0] - s[0]) - middle[0])
                at_y = middle[1] + along * (s[1] + across * (t[1] - s[1]) - middle[1])
                if column_through(center, half, axes, at_x, at_y)[0] < np.inf:
                    x, y, n = x + at_x, y + at_y, n + 1
    return (x / n, y / n) if n else (0.5 * (middle[0] + center[0]), 0.5 * (middle[1] + center[1]))


@njit(cache=True)
def _samples(boxes: Boxes, n: int, foot: float, at: Array) -> int:
    """Columns (k, 2) through one box, spread over its footing: where it reaches down to `foot` [m] above its lowest
    point. Written to `at`; returns how many."""
    found = 0
    lowest, rectangle = boxes.low[n, 2], boxes.rectangle[n]
    upright = boxes.axes[n, 2, 2] > 1.0 - UPRIGHT
    for a in range(SIDE_SAMPLES):
        for b in range(SIDE_SAMPLES):
            along = rectangle[4] * ((2 * a + 1) / SIDE_SAMPLES - 1.0)
            across = rectangle[5] * ((2 * b + 1) / SIDE_SAMPLES - 1.0)
            x = rectangle[0] + along * rectangle[2] - across * rectangle[3]
            y = rectangle[1] + along * rectangle[3] + across * rectangle[2]
            enters = lowest if upright else column_through(boxes.center[n], boxes.half[n], boxes.axes[n], x, y)[0]
            if enters < np.inf and enters <= lowest + foot:
                at[found, 0], at[found, 1] = x, y
                found += 1
    if found == 0:
        at[0, 0], at[0, 1] = boxes.center[n, 0], boxes.center[n, 1]
        found = 1
    return found


@njit(cache=True)
def _covers_all(upper: int, candidates: Array, rank: Array, boxes: Boxes) -> int:
    """The first of the candidates that lies under the whole of an upright box, all being upright; −1: it does not."""
    best = -1
    for j in candidates:
        if boxes.axes[j, 2, 2] <= 1.0 - UPRIGHT:
            return -1
        if (
            best < 0
            or boxes.high[j, 2] > boxes.high[best, 2]
            or (boxes.high[j, 2] == boxes.high[best, 2] and rank[j] < rank[best])
        ):
            best = j
    if boxes.axes[upper, 2, 2] <= 1.0 - UPRIGHT:
        return -1
    x0, y0, ux, uy, length, width = boxes.rectangle[upper]
    for m in range(4):
        along = length if m & 1 else -length
        across = width if m & 2 else -width
        x, y = x0 + along * ux - across * uy, y0 + along * uy + across * ux
        if column_through(boxes.center[best], boxes.half[best], boxes.axes[best], x, y)[0] == np.inf:
            return -1
    return best


@njit(cache=True)
def _may_carry(upper: int, lower: int, boxes: Boxes, tolerance: float) -> bool:
    """Whether the lower's surface may lie within the tolerance [m] of the upper's lowest point."""
    foot, top = boxes.low[upper, 2], boxes.high[lower, 2]
    if upper == lower or top < foot - tolerance:
        return False
    leans = boxes.axes[lower, 2, 2] <= 1.0 - UPRIGHT
    return bool(top <= foot + tolerance or (leans and boxes.low[lower, 2] <= foot + tolerance))


@njit(cache=True)
def stand(below: Array, rank: Array, boxes: Boxes, tolerance: float, foot: float) -> tuple[Array, Array]:
    """On what boxes stand: each column of a footing goes to the first other material downwards, within `tolerance`.

    below : (m, 2) upper and lower: all that may lie below each upper box, which are one after another
    rank  : (n,) which of two equally high surfaces goes first
    foot  : columns whose lowest point lies within this of a tilted box's lowest are its footing [m]
    Returns upper and lower (k, 2), and shares (k,) of the upper one's footing.
    """
    ends, shares = np.empty((len(below), 2), np.int64), np.empty(len(below))
    center, half, axes, low, high = boxes.center, boxes.half, boxes.axes, boxes.low, boxes.high
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    n = start = 0
    while start < len(below):
        i, stop = below[start, 0], start
        n_candidates = 0
        candidates = np.empty(16, np.int64)
        while stop < len(below) and below[stop, 0] == i:
            if _may_carry(i, below[stop, 1], boxes, tolerance):
                if n_candidates == len(candidates):
                    candidates = np.concatenate((candidates, np.empty_like(candidates)))
                candidates[n_candidates] = below[stop, 1]
                n_candidates += 1
            stop += 1
        start = stop
        candidates = candidates[:n_candidates]
        if n_candidates == 0:
            continue
        highest = _covers_all(i, candidates, rank, boxes)
        if highest >= 0:
            ends[n, 0], ends[n, 1], shares[n] = i, highest, 1.0
            n += 1
            continue
        counts = np.zeros(n_candidates, np.int64)
        n_columns = _samples(boxes, i, foot, at)
        for c in range(n_columns):
            best, top = -1, low[i, 2] - tolerance
            for m in range(n_candidates):
                j = candidates[m]
                if high[j, 2] < top:
                    continue
                leaves = column_through(center[j], half[j], axes[j], at[c, 0], at[c, 1])[1]
                if leaves < low[i, 2] - tolerance or leaves > low[i, 2] + tolerance:
                    continue
                if best < 0 or leaves > top or (leaves == top and rank[j] < rank[candidates[best]]):
                    best, top = m, leaves
            if best >= 0:
                counts[best] += 1
        for m in range(n_candidates):
            if counts[m]:
                ends[n, 0], ends[n, 1], shares[n] = i, candidates[m], counts[m] / n_columns
                n += 1
    return ends[:n].copy(), shares[:n].copy()


@njit(cache=True)
def inside_boxes(pairs: Array, holds: Array, boxes: Boxes, foot: float) -> tuple[Array, Array, Array]:
    """What of pairs (m, 2) lies in the other of its pair, where that is one that `holds` (n,) things.

    foot : as in `stand`; an upright box's footing lies half its height, and at most this, above its bottom [m]
    Returns thing and container (k, 2), and the shares (k,) of the thing's footing, and of its volume, that lie inside;
    those of whose footing there is any.
    """
    ends = np.empty((2 * len(pairs), 2), np.int64)
    footing, volume = np.empty(2 * len(pairs)), np.empty(2 * len(pairs))
    n = 0
    for m in range(2 * len(pairs)):
        a, b = pairs[m // 2, m % 2], pairs[m // 2, 1 - m % 2]
        if not holds[b]:
            continue
        meet = True
        for r in range(3):
            meet &= boxes.low[a, r] <= boxes.high[b, r] and boxes.low[b, r] <= boxes.high[a, r]
        if not meet:
            continue
        footing[n], volume[n] = _shares_inside(boxes, a, b, foot)
        if footing[n] > 0.0:
            ends[n, 0], ends[n, 1] = a, b
            n += 1
    return ends[:n].copy(), footing[:n].copy(), volume[:n].copy()


@njit(cache=True)
def _shares_inside(boxes: Boxes, a: int, b: int, foot: float) -> tuple[float, float]:
    """The shares of a box's footing and volume that lie in another."""
    center, half, axes, low, high, corners, count, area, _ = boxes
    height = high[a, 2] - low[a, 2]
    lift = min(foot, 0.5 * height)
    if axes[a, 2, 2] > 1.0 - UPRIGHT and axes[b, 2, 2] > 1.0 - UPRIGHT and area[a] > 0.0 and height > 0.0:
        share = min(1.0, overlap_area(corners[a, : count[a]], corners[b, : count[b]]) / area[a])
        common = min(high[a, 2], high[b, 2]) - max(low[a, 2], low[b, 2])
        footing = share if low[b, 2] <= low[a, 2] + lift <= high[b, 2] else 0.0
        return footing, share * max(0.0, common) / height
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    n_columns = _samples(boxes, a, foot, at)
    n_footing = n_volume = 0
    for c in range(n_columns):
        n_footing += outside(center[b], half[b], axes[b], at[c, 0], at[c, 1], low[a, 2] + lift) <= 1e-9
    for i in range(SIDE_SAMPLES):
        for j in range(SIDE_SAMPLES):
            for k in range(SIDE_SAMPLES):
                u = half[a, 0] * ((2 * i + 1) / SIDE_SAMPLES - 1.0)
                v = half[a, 1] * ((2 * j + 1) / SIDE_SAMPLES - 1.0)
                w = half[a, 2] * ((2 * k + 1) / SIDE_SAMPLES - 1.0)
                point = center[a] + u * axes[a, :, 0] + v * axes[a, :, 1] + w * axes[a, :, 2]
                n_volume += outside(center[b], half[b], axes[b], point[0], point[1], point[2]) <= 1e-9
    return n_footing / n_columns, n_volume / SIDE_SAMPLES**3


@njit(cache=True)
def shares_in_polygons(pairs: Array, boxes: Boxes, starts: Array, rings: Array) -> Array:
    """(m,) shares of a box's ground projection that lie in a polygon, for pairs (box, polygon) (m, 2).

    starts, rings : (n + 1,), (k, 2) the corners of polygon i are rings[starts[i] : starts[i + 1]]
    """
    shares = np.empty(len(pairs))
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    for m in range(len(pairs)):
        ring = rings[starts[pairs[m, 1]] : starts[pairs[m, 1] + 1]]
        n_columns = _samples(boxes, pairs[m, 0], np.inf, at)
        n_inside = 0
        for c in range(n_columns):
            n_inside += _in_ring(ring, at[c, 0], at[c, 1])
        shares[m] = n_inside / n_columns
    return shares


@njit(cache=True)
def _in_ring(ring: Array, x: float, y: float) -> bool:
    inside = False
    for m in range(len(ring)):
        x0, y0 = ring[m]
        x1, y1 = ring[(m + 1) % len(ring)]
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            inside = not inside
    return inside
