"""Columns of surface points over a ground grid: what stands lowest, what faces up with air above it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
def thin_out(points: Array, cell: float) -> Array:
    """Indices of one point (the first) in each cubic cell of side `cell` [m]."""
    keys = np.empty(len(points), dtype=np.int64)
    for n in range(len(points)):
        i = np.int64(np.floor(points[n, 0] / cell)) + (1 << 20)
        j = np.int64(np.floor(points[n, 1] / cell)) + (1 << 20)
        k = np.int64(np.floor(points[n, 2] / cell)) + (1 << 20)
        keys[n] = i << 42 | j << 21 | k
    order = np.argsort(keys, kind="mergesort")
    kept = np.empty(len(points), dtype=np.int64)
    n = 0
    for a in range(len(order)):
        if a == 0 or keys[order[a]] != keys[order[a - 1]]:
            kept[n] = order[a]
            n += 1
    return np.sort(kept[:n])


@njit(cache=True)
def closed_sides(points: Array, material: Array, beside: float) -> Array:
    """(N,) int64: in how many of the directions ±x, ±y, −z each point (N, 3) meets material (M, 3).

    Material is met that lies in the direction and within `beside` of its axis along both other axes.
    """
    closed = np.zeros(len(points), dtype=np.int64)
    met = np.zeros(5, dtype=np.bool_)
    for n in range(len(points)):
        met[:] = False
        for m in range(len(material)):
            dx = material[m, 0] - points[n, 0]
            dy = material[m, 1] - points[n, 1]
            dz = material[m, 2] - points[n, 2]
            near_x, near_y, near_z = abs(dx) <= beside, abs(dy) <= beside, abs(dz) <= beside
            if near_y and near_z:
                met[0 if dx > 0.0 else 1] = True
            if near_x and near_z:
                met[2 if dy > 0.0 else 3] = True
            if near_x and near_y and dz < 0.0:
                met[4] = True
        closed[n] = met.sum()
    return closed
