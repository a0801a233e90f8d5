"""Columns of surface points over a ground grid: what stands lowest, what faces up with air above it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.forest import join, root_of

Array = NDArray[Any]


@njit(cache=True)
def column_keys(points: Array, cell: float) -> Array:
    """(N,) int64: the column of side `cell` [m] in which each point (N, 3) stands."""
    keys = np.empty(len(points), dtype=np.int64)
    for n in range(len(points)):
        i = np.int64(np.floor(points[n, 0] / cell))
        j = np.int64(np.floor(points[n, 1] / cell))
        keys[n] = (i + (1 << 30)) << 32 | (j + (1 << 30))
    return keys


@njit(cache=True)
def facing_up(points: Array, keys: Array, order: Array, least: float, clearance: float) -> Array:
    """(N,) bool: points with no other point of their column between `least` and `clearance` [m] above them.

    order (N,) sorts the points by column, then height.
    """
    n = len(points)
    result = np.ones(n, dtype=np.bool_)
    for a in range(n):
        p = order[a]
        for b in range(a + 1, n):
            q = order[b]
            if keys[q] != keys[p]:
                break
            rise = points[q, 2] - points[p, 2]
            if rise > clearance:
                break
            if rise > least:
                result[p] = False
                break
    return result


@njit(cache=True)
def column_tops(keys: Array, order: Array) -> Array:
    """Indices (C,) of the highest point of each column; order as in `facing_up`."""
    found = np.empty(len(order), dtype=np.int64)
    n = 0
    for a in range(len(order)):
        if a == len(order) - 1 or keys[order[a]] != keys[order[a + 1]]:
            found[n] = order[a]
            n += 1
    return found[:n]


@njit(cache=True)
def column_bottoms(points: Array, keys: Array, order: Array) -> Array:
    """Indices (C,) of the lowest point of each column."""
    found = np.empty(len(points), dtype=np.int64)
    n = 0
    for a in range(len(points)):
        if a == 0 or keys[order[a]] != keys[order[a - 1]]:
            found[n] = order[a]
            n += 1
    return found[:n]


@njit(cache=True)
def cell_keys(points: Array, cell: float) -> Array:
    """(N,) int64: the cubic cell of side `cell` [m] in which each point (N, 3) lies; k + 1 is the next number."""
    keys = np.empty(len(points), dtype=np.int64)
    for n in range(len(points)):
        i = np.int64(np.floor(points[n, 0] / cell)) + (1 << 20)
        j = np.int64(np.floor(points[n, 1] / cell)) + (1 << 20)
        k = np.int64(np.floor(points[n, 2] / cell)) + (1 << 20)
        keys[n] = i << 42 | j << 21 | k
    return keys


@njit(cache=True)
def thin_out(points: Array, cell: float) -> Array:
    """Indices of one point (the first) in each cubic cell of side `cell` [m]."""
    keys = cell_keys(points, cell)
    order = np.argsort(keys)
    kept = np.empty(len(points), dtype=np.int64)
    n = 0
    for a in range(len(order)):
        if a == 0 or keys[order[a]] != keys[order[a - 1]]:
            kept[n] = order[a]
            n += 1
        else:
            kept[n - 1] = min(kept[n - 1], order[a])
    return np.sort(kept[:n])


@njit(cache=True)
def closed_sides(points: Array, material: Array, beside: float) -> Array:
    """(N,) int64: in how many of the directions ±x, ±y, −z each point (N, 3) meets material (M, 3).

    Material is met that lies in the direction and within `beside` of its axis along both other axes; to the sides only
    what is no lower than the point: a surface on which the point lies does not close it in.
    """
    closed = np.zeros(len(points), dtype=np.int64)
    met = np.zeros(5, dtype=np.bool_)
    for n in range(len(points)):
        met[:] = False
        for m in range(len(material)):
            dx = material[m, 0] - points[n, 0]
            dy = material[m, 1] - points[n, 1]
            dz = material[m, 2] - points[n, 2]
            near_x, near_y, near_z = abs(dx) <= beside, abs(dy) <= beside, 0.0 <= dz <= 2.0 * beside
            if near_y and near_z:
                met[0 if dx > 0.0 else 1] = True
            if near_x and near_z:
                met[2 if dy > 0.0 else 3] = True
            if near_x and near_y and dz < 0.0:
                met[4] = True
        closed[n] = met.sum()
    return closed


@njit(cache=True)
def inner_part(points: Array, weights: Array, share: float, directions: int, bin_m: float) -> Array:
    """(N,) bool: points that in no horizontal direction belong to the outermost `share` of the weight.

    points (N, 3) [m], weights (N,); looked at along `directions` axes, each from both ends, in bins of bin_m [m].
    """
    n = len(points)
    kept = np.ones(n, dtype=np.bool_)
    total = weights.sum()
    along = np.empty(n, dtype=np.int64)
    for d in range(directions):
        angle = np.pi * d / directions
        c, s = np.cos(angle) / bin_m, np.sin(angle) / bin_m
        low = high = np.int64(np.floor(c * points[0, 0] + s * points[0, 1]))
        for p in range(n):
            along[p] = np.int64(np.floor(c * points[p, 0] + s * points[p, 1]))
            low, high = min(low, along[p]), max(high, along[p])
        mass = np.zeros(high - low + 1)
        for p in range(n):
            mass[along[p] - low] += weights[p]
        first, last = low, high
        sum_low = mass[0]
        while sum_low < share * total:
            first += 1
            sum_low += mass[first - low]
        sum_high = mass[high - low]
        while sum_high < share * total:
            last -= 1
            sum_high += mass[last - low]
        for p in range(n):
            if along[p] < first or along[p] > last:
                kept[p] = False
    return kept


@njit(cache=True)
def largest_cluster(points: Array, weights: Array, cell: float) -> Array:
    """(N,) bool: the points of the heaviest connected cluster; cells of side `cell` [m] connect to their 26
    neighbours."""
    n = len(points)
    keys = cell_keys(points, cell)
    order = np.argsort(keys)
    cells, at, m = np.empty(n, np.int64), np.empty(n, np.int64), 0
    for p in order:
        if m == 0 or keys[p] != cells[m - 1]:
            cells[m] = keys[p]
            m += 1
        at[p] = m - 1
    cells = cells[:m]
    parent = np.arange(len(cells))
    for c in range(len(cells) - 1):
        if cells[c + 1] == cells[c] + 1:
            join(parent, c, c + 1)
    for di, dj in ((0, 1), (1, -1), (1, 0), (1, 1)):  # half of the rows beside: the relation is symmetric
        beside = (np.int64(di) << 42) + (np.int64(dj) << 21)
        d = 0
        for c in range(len(cells)):
            first = cells[c] + beside - 1
            while d < len(cells) and cells[d] < first:
                d += 1
            e = d
            while e < len(cells) and cells[e] <= first + 2:
                join(parent, c, e)
                e += 1
    mass = np.zeros(len(cells))
    root = np.empty(n, dtype=np.int64)
    for p in range(n):
        root[p] = root_of(parent, at[p])
        mass[root[p]] += weights[p]
    heaviest = mass.argmax()
    together: Array = root == heaviest
    return together
