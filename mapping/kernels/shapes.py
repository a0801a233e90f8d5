"""Plane geometry of footprints and distances between sets of surface points. All lengths in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True)
def convex_hull(points: Array) -> Array:
    """Corners (K, 2), counter-clockwise, of the convex hull of `points` (N, 2), by Andrew's monotone chain.

    Fewer than three points, or points on a line, give the one or two extreme points.
    """
    n = len(points)
    order = np.argsort(points[:, 1], kind="mergesort")
    order = order[np.argsort(points[order, 0], kind="mergesort")]
    hull = np.empty((2 * n + 1, 2), dtype=np.float64)
    k = 0
    for sweep in range(2):
        start = k
        for s in range(n):
            i = order[s] if sweep == 0 else order[n - 1 - s]
            x, y = points[i, 0], points[i, 1]
            while (
                k - start >= 2
                and (
                    (hull[k - 1, 0] - hull[k - 2, 0]) * (y - hull[k - 2, 1])
                    - (hull[k - 1, 1] - hull[k - 2, 1]) * (x - hull[k - 2, 0])
                )
                <= 0.0
            ):
                k -= 1
            if k > start and hull[k - 1, 0] == x and hull[k - 1, 1] == y:
                continue
            hull[k, 0], hull[k, 1] = x, y
            k += 1
        k -= 1  # the last corner of one chain is the first of the other
        if k < start + 1 and sweep == 0:
            break
    return hull[: max(k, 1)].copy()


@njit(cache=True)
def polygon_area(corners: Array) -> float:
    """Signed area of a polygon (K, 2); positive when counter-clockwise."""
    total = 0.0
    n = len(corners)
    for i in range(n):
        j = (i + 1) % n
        total += corners[i, 0] * corners[j, 1] - corners[j, 0] * corners[i, 1]
    return 0.5 * total


@njit(cache=True)
def overlap_area(a: Array, b: Array) -> float:
    """Area of the intersection of two convex, counter-clockwise polygons, by clipping a at each edge of b."""
    if len(a) < 3 or len(b) < 3:
        return 0.0
    size = len(a) + len(b) + 8
    inside = np.empty((size, 2), dtype=np.float64)
    clipped = np.empty((size, 2), dtype=np.float64)
    n = len(a)
    inside[:n] = a
    for e in range(len(b)):
        x0, y0 = b[e]
        x1, y1 = b[(e + 1) % len(b)]
        m = 0
        for i in range(n):
            px, py = inside[i]
            qx, qy = inside[(i + 1) % n]
            sp = (x1 - x0) * (py - y0) - (y1 - y0) * (px - x0)
            sq = (x1 - x0) * (qy - y0) - (y1 - y0) * (qx - x0)
            if sp >= 0.0:
                clipped[m, 0], clipped[m, 1] = px, py
                m += 1
            if (sp > 0.0 and sq < 0.0) or (sp < 0.0 and sq > 0.0):
                t = sp / (sp - sq)
                clipped[m, 0], clipped[m, 1] = px + t * (qx - px), py + t * (qy - py)
                m += 1
        n = m
        if n < 3:
            return 0.0
        inside[:n] = clipped[:n]
    return float(abs(polygon_area(inside[:n])))


@njit(cache=True)
def points_inside(corners: Array, points: Array, margin: float) -> Array:
    """(N,) bool: which points (N, 2) lie in the convex counter-clockwise polygon grown by `margin` [m]."""
    n = len(corners)
    result = np.empty(len(points), dtype=np.bool_)
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        inside = n >= 3
        for i in range(n):
            j = (i + 1) % n
            ex, ey = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
            if ex * (y - corners[i, 1]) - ey * (x - corners[i, 0]) < -margin * np.sqrt(ex * ex + ey * ey):
                inside = False
                break
        result[p] = inside
    return result


@njit(cache=True)
def smallest_rectangle(hull: Array) -> tuple[float, float, float, float, float]:
    """The rectangle of least area around a convex polygon: centre x, y, length, width, yaw of its length axis.

    One side of it lies on a side of the polygon (Freeman & Shapira 1975). Length ≥ width; yaw in [−π/2, π/2).
    """
    best = np.inf
    result = (hull[:, 0].mean(), hull[:, 1].mean(), 0.0, 0.0, 0.0)
    n = len(hull)
    for i in range(n):
        j = (i + 1) % n
        ex, ey = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
        length = np.sqrt(ex * ex + ey * ey)
        if length < 1e-9:
            continue
        c, s = ex / length, ey / length
        lo_u = lo_v = np.inf
        hi_u = hi_v = -np.inf
        for k in range(n):
            u = c * hull[k, 0] + s * hull[k, 1]
            v = -s * hull[k, 0] + c * hull[k, 1]
            lo_u, hi_u = min(lo_u, u), max(hi_u, u)
            lo_v, hi_v = min(lo_v, v), max(hi_v, v)
        area = (hi_u - lo_u) * (hi_v - lo_v)
        if area < best - 1e-12:
            best = area
            mu, mv = 0.5 * (lo_u + hi_u), 0.5 * (lo_v + hi_v)
            du, dv = hi_u - lo_u, hi_v - lo_v
            yaw = np.arctan2(s, c)
            if dv > du:
                du, dv = dv, du
                yaw += 0.5 * np.pi
            yaw = (yaw + 0.5 * np.pi) % np.pi - 0.5 * np.pi
            result = (c * mu - s * mv, s * mu + c * mv, du, dv, yaw)
    return result


@njit(cache=True)
def nearest_pair(a: Array, b: Array) -> tuple[float, int, int]:
    """Least distance between two point sets (N, 3), (M, 3), and the indices of a pair that attains it."""
    best = np.inf
    at_a = at_b = 0
    for i in range(len(a)):
        for j in range(len(b)):
            d = (a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2 + (a[i, 2] - b[j, 2]) ** 2
            if d < best:
                best, at_a, at_b = d, i, j
    return np.sqrt(best), at_a, at_b


@njit(cache=True)
def within(points: Array, center: Array, radius: float) -> Array:
    """Indices of the points (N, 3) within `radius` of `center` (3,)."""
    found = np.empty(len(points), dtype=np.int64)
    n = 0
    for i in range(len(points)):
        dx, dy, dz = points[i, 0] - center[0], points[i, 1] - center[1], points[i, 2] - center[2]
        if dx * dx + dy * dy + dz * dz <= radius * radius:
            found[n] = i
            n += 1
    return found[:n]
