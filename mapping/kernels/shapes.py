"""Plane geometry of footprints and distances between sets of surface points. All lengths in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

MANY_PAIRS = 20_000
"""More pairs of points than this are not all compared."""
ROUNDING_M = 1e-5
"""Distances are summed up in the precision of the points, float32."""


@njit(cache=True)
def bounds(points: Array) -> tuple[Array, Array]:
    """The lowest and the highest corner (3,) of points (N, 3), as float64."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(len(points)):
        for a in range(3):
            x = np.float64(points[n, a])
            low[a], high[a] = min(low[a], x), max(high[a], x)
    return low, high


@njit(cache=True)
def _outermost(points: Array) -> Array:
    """The points (K, 2) of (N, 2) that may be corners of the convex hull: those that do not lie inside the octagon of
    the points farthest along the axes and diagonals (Akl & Toussaint, A fast convex hull algorithm, 1978)."""
    n = len(points)
    farthest, at = np.full(8, -np.inf), np.zeros(8, np.int64)
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        along = (x, x + y, y, y - x, -x, -x - y, -y, x - y)
        for d in range(8):
            if along[d] > farthest[d]:
                farthest[d], at[d] = along[d], i
    kept = np.empty((n, 2))
    k = 0
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        for d in range(8):
            ax, ay = points[at[d], 0], points[at[d], 1]
            bx, by = points[at[(d + 1) % 8], 0], points[at[(d + 1) % 8], 1]
            if (ax != bx or ay != by) and (bx - ax) * (y - ay) - (by - ay) * (x - ax) <= 0.0:
                kept[k, 0], kept[k, 1] = x, y
                k += 1
                break
    return kept[:k] if k else points[:1].copy()


@njit(cache=True)
def convex_hull(points: Array) -> Array:
    """Corners (K, 2), counter-clockwise, of the convex hull of `points` (N, 2), by Andrew's monotone chain.

    Fewer than three points, or points on a line, give the one or two extreme points.
    """
    points = _outermost(points) if len(points) > 16 else points
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
def median(values: Array) -> float:
    """The median of values (N ≥ 1,): as `np.median`, a hundred times as fast for few."""
    return float(np.median(values))


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
def _closeness(points: Array, hull: Array, yaw: float, near: float) -> float:
    """Σ 1/max(d, near) over points, d being the distance to the sides of the rectangle of this yaw about all points, of
    which `hull` are the outermost."""
    c, s = np.cos(yaw), np.sin(yaw)
    low_u = low_v = np.inf
    high_u = high_v = -np.inf
    for n in range(len(hull)):
        u, v = c * hull[n, 0] + s * hull[n, 1], c * hull[n, 1] - s * hull[n, 0]
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    total = 0.0
    for n in range(len(points)):
        u, v = c * points[n, 0] + s * points[n, 1], c * points[n, 1] - s * points[n, 0]
        total += 1.0 / max(near, min(min(u - low_u, high_u - u), min(v - low_v, high_v - v)))
    return total


@njit(cache=True)
def fit_rectangle(points: Array, most: int, near: float) -> tuple[float, float, float, float, float]:
    """The rectangle about ground points (N, 2) whose sides the points lie along: centre x, y, length, width, yaw of its
    length.

    Of all directions that in which most points are close to a side (closeness criterion, Zhang et al., *Efficient
    L-shape fitting for vehicle detection using laser scanners*, 2017), so that a thing of which only two faces were
    seen is not turned. Looked for with about `most` of the points, by degrees, then tenths, then hundredths; nearer
    than `near` [m] to a side is close enough. Length ≥ width; yaw in [−π/2, π/2).
    """
    step = max(1, len(points) // most)
    some = points[::step].copy()
    hull = convex_hull(some)
    best, yaw = -1.0, 0.0
    for k in range(90):
        score = _closeness(some, hull, np.pi * k / 180.0, near)
        if score > best:
            best, yaw = score, np.pi * k / 180.0
    for finer in (1800.0, 18000.0):
        middle = yaw
        for k in range(-9, 10):
            score = _closeness(some, hull, middle + np.pi * k / finer, near)
            if score > best:
                best, yaw = score, middle + np.pi * k / finer
    c, s = np.cos(yaw), np.sin(yaw)
    along, across = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
    mid_u, mid_v = 0.5 * (along.min() + along.max()), 0.5 * (across.min() + across.max())
    length, width = along.max() - along.min(), across.max() - across.min()
    if width > length:
        length, width = width, length
        yaw += 0.5 * np.pi
    yaw = (yaw + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    return c * mid_u - s * mid_v, s * mid_u + c * mid_v, length, width, yaw


@njit(cache=True)
def _beside(points: Array, low: Array, high: Array, reach: float) -> Array:
    """Indices of the points (N, 3) whose distance to the box low, high (3,) is no more than `reach` [m]."""
    found = np.empty(len(points), dtype=np.int64)
    n = 0
    for i in range(len(points)):
        apart = 0.0
        for d in range(3):
            off = max(0.0, max(low[d] - points[i, d], points[i, d] - high[d]))
            apart += off * off
        if apart <= reach * reach:
            found[n] = i
            n += 1
    return found[:n]


@njit(cache=True)
def _nearest_of(a: Array, b: Array, some_a: Array, some_b: Array) -> tuple[float, int, int]:
    """The squared distance of the nearest pair of the points `some_a` of a and `some_b` of b, and their indices."""
    best = np.inf
    at_a = at_b = 0
    for i in some_a:
        for j in some_b:
            d = (a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2 + (a[i, 2] - b[j, 2]) ** 2
            if d < best:
                best, at_a, at_b = d, i, j
    return best, at_a, at_b


@njit(cache=True)
def nearest_pair(a: Array, b: Array) -> tuple[float, int, int]:
    """Least distance between two point sets (N, 3), (M, 3), and the indices of a pair that attains it.

    Of large sets a few points give a bound first, and points that are farther from the other set's box are left out.
    """
    some_a, some_b = np.arange(len(a)), np.arange(len(b))
    if len(a) * len(b) > MANY_PAIRS:
        step_a, step_b = max(1, len(a) // 32), max(1, len(b) // 32)
        bound = np.sqrt(_nearest_of(a, b, some_a[::step_a].copy(), some_b[::step_b].copy())[0]) + ROUNDING_M
        low, high = bounds(b)
        some_a = _beside(a, low, high, bound)
        low, high = bounds(a)
        some_b = _beside(b, low, high, bound)
    best, at_a, at_b = _nearest_of(a, b, some_a, some_b)
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


@njit(cache=True)
def highest_pair(a: Array, b: Array, reach: float) -> tuple[int, int]:
    """Of the points of a (N, 3), each with the nearest of b (M, 3), the pair within `reach` [m] whose lower point is
    highest; else -1, -1."""
    best = -np.inf
    at_a = at_b = -1
    low, high = bounds(b)
    some_a = _beside(a, low, high, reach + ROUNDING_M)
    low, high = bounds(a)
    some_b = _beside(b, low, high, reach + ROUNDING_M)
    for i in some_a:
        if a[i, 2] <= best:
            continue
        least = reach * reach
        nearest = -1
        for j in some_b:
            d = (a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2 + (a[i, 2] - b[j, 2]) ** 2
            if d <= least:
                least, nearest = d, j
        if nearest >= 0 and min(a[i, 2], b[nearest, 2]) > best:
            best, at_a, at_b = min(a[i, 2], b[nearest, 2]), i, nearest
    return at_a, at_b


@njit(cache=True)
def near_segment(points: Array, p: Array, q: Array, beside: float, clear: float) -> bool:
    """Whether a point (N, 3) lies within `beside` of the segment from p to q (3,) and more than `clear` from its ends.

    Lengths in metres, that from the ends along the segment.
    """
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    if length <= 2.0 * clear:
        return False
    dx, dy, dz = dx / length, dy / length, dz / length
    for n in range(len(points)):
        x, y, z = points[n, 0] - p[0], points[n, 1] - p[1], points[n, 2] - p[2]
        along = x * dx + y * dy + z * dz
        if clear < along < length - clear and x * x + y * y + z * z - along * along <= beside * beside:
            return True
    return False


@njit(cache=True)
def levels_under(
    up: Array, top: float, bottom: float, low: Array, high: Array, thick: float, footing: Array, margin: float
) -> tuple[Array, Array]:
    """The level surfaces that points facing up make under a thing, highest first.

    up (N, 3) [m]: those between the heights bottom and top whose ground lies between low and high (2,) count
    thick: points no lower than this under the highest one left are one surface [m]

    Returns the median height (L,) of each surface, and the columns (L, F) bool of the footing (F, 2) that its convex
    hull, grown by `margin` [m], covers. Surfaces that cover none are left out, and what fewer than three points make.
    """
    left = np.empty((len(up), 3))
    n = 0
    for i in range(len(up)):
        x, y, z = up[i, 0], up[i, 1], up[i, 2]
        if bottom <= z <= top and low[0] <= x <= high[0] and low[1] <= y <= high[1]:
            left[n, 0], left[n, 1], left[n, 2] = x, y, z
            n += 1
    heights, covered = np.empty(n // 3), np.empty((n // 3, len(footing)), np.bool_)
    level = np.empty((n, 3))
    found = 0
    while n >= 3:
        floor = left[:n, 2].max() - thick
        count = rest = 0
        for i in range(n):
            if left[i, 2] >= floor:
                level[count] = left[i]
                count += 1
            else:
                left[rest] = left[i]
                rest += 1
        inside = points_inside(convex_hull(level[:count, :2]), footing, margin)
        if inside.any():
            heights[found], covered[found] = np.median(level[:count, 2]), inside
            found += 1
        n = rest
    return heights[:found], covered[:found]
