"""Oriented boxes: distances, ground projections, columns through them, and which of many lie near each other.

A box is its centre (3,) [m], half its edge lengths (3,) [m], and its axes as the columns of a rotation (3, 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels import hashing
from mapping.kernels.shapes import convex_hull, overlap_area, polygon_area

Array = NDArray[Any]
Int = Any

UPRIGHT = 1e-6
"""A box whose z axis leans from the map's by less than this is taken to stand upright."""
TIE = 1e-12
"""Squared distances this close are taken to be the same [m²]."""
CELL_LIMIT = (1 << 20) - 1
MOST_CELLS = 4096
"""What covers more cells of a grid than this is compared with everything instead."""
SIDE_SAMPLES = 8


# -- one box ----------------------------------------------------------------------------------------------------------


@njit(cache=True)
def axes_of(rotation_wxyz: Array) -> Array:
    """(n, 3, 3) rotation matrices of unit quaternions (n, 4)."""
    axes = np.empty((len(rotation_wxyz), 3, 3))
    for n in range(len(rotation_wxyz)):
        w, x, y, z = rotation_wxyz[n]
        axes[n, 0, 0], axes[n, 0, 1], axes[n, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        axes[n, 1, 0], axes[n, 1, 1], axes[n, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        axes[n, 2, 0], axes[n, 2, 1], axes[n, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return axes


@njit(cache=True)
def bounds_of(center: Array, half: Array, axes: Array, low: Array, high: Array) -> None:
    """The axis-aligned bounds (n, 3) of boxes, written to `low` and `high`."""
    for n in range(len(center)):
        for r in range(3):
            reach = 0.0
            for k in range(3):
                reach += abs(axes[n, r, k]) * half[n, k]
            low[n, r], high[n, r] = center[n, r] - reach, center[n, r] + reach


@njit(cache=True)
def footprints_of(center: Array, half: Array, axes: Array) -> tuple[Array, Array, Array, Array]:
    """The ground projections of boxes and the rectangles about them along their longest horizontal direction.

    Returns corners (n, 8, 2), counter-clockwise, their number (n,) (6 at most, but for rounding), the area (n,) [m²],
    and the rectangles (n, 6): centre x, y, unit direction of the length, half length, half width.
    """
    n_boxes = len(center)
    corners = np.zeros((n_boxes, 8, 2))
    count = np.zeros(n_boxes, np.int64)
    area = np.zeros(n_boxes)
    rectangle = np.empty((n_boxes, 6))
    points = np.empty((8, 2))
    for n in range(n_boxes):
        lead, longest = 0, -1.0
        for k in range(3):
            length = half[n, k] * np.hypot(axes[n, 0, k], axes[n, 1, k])
            if length > longest + 1e-12:
                lead, longest = k, length
        norm = np.hypot(axes[n, 0, lead], axes[n, 1, lead])
        ux, uy = (axes[n, 0, lead] / norm, axes[n, 1, lead] / norm) if norm > 1e-9 else (1.0, 0.0)
        along = across = 0.0
        for k in range(3):
            along += half[n, k] * abs(ux * axes[n, 0, k] + uy * axes[n, 1, k])
            across += half[n, k] * abs(-uy * axes[n, 0, k] + ux * axes[n, 1, k])
        rectangle[n] = center[n, 0], center[n, 1], ux, uy, along, across
        if axes[n, 2, 2] > 1.0 - UPRIGHT:
            for m in range(4):
                a = along if m in (1, 2) else -along
                b = across if m in (2, 3) else -across
                corners[n, m, 0], corners[n, m, 1] = center[n, 0] + a * ux - b * uy, center[n, 1] + a * uy + b * ux
            count[n], area[n] = 4, 4.0 * along * across
        else:
            for m in range(8):
                for r in range(2):
                    points[m, r] = center[n, r]
                    for k in range(3):
                        points[m, r] += (half[n, k] if m >> k & 1 else -half[n, k]) * axes[n, r, k]
            hull = convex_hull(points)
            count[n] = len(hull)
            corners[n, : count[n]] = hull[: count[n]]
            area[n] = abs(polygon_area(hull)) if len(hull) > 2 else 0.0
    return corners, count, area, rectangle


@njit(cache=True)
def outside(center: Array, half: Array, axes: Array, x: float, y: float, z: float) -> float:
    """Distance of a point from one box; 0 inside."""
    dx, dy, dz = x - center[0], y - center[1], z - center[2]
    total = 0.0
    for k in range(3):
        beyond = abs(axes[0, k] * dx + axes[1, k] * dy + axes[2, k] * dz) - half[k]
        if beyond > 0.0:
            total += beyond * beyond
    return float(np.sqrt(total))


@njit(cache=True)
def column_through(center: Array, half: Array, axes: Array, x: float, y: float) -> tuple[float, float]:
    """Where the vertical line at (x, y) enters and leaves one box, from below; (inf, −inf) where it does not."""
    low, high = -np.inf, np.inf
    dx, dy = x - center[0], y - center[1]
    for k in range(3):
        at = axes[0, k] * dx + axes[1, k] * dy
        slope = axes[2, k]
        if abs(slope) < 1e-12:
            if abs(at) > half[k] + 1e-9:
                return np.inf, -np.inf
            continue
        one, two = (-half[k] - at) / slope, (half[k] - at) / slope
        low, high = max(low, min(one, two)), min(high, max(one, two))
    if low > high + 1e-12:
        return np.inf, -np.inf
    return center[2] + low, center[2] + high


@njit(cache=True)
def crosses(center: Array, half: Array, axes: Array, p: Array, q: Array) -> bool:
    """Whether the segment from p to q (3,) meets one box."""
    enters, leaves = 0.0, 1.0
    for k in range(3):
        a = b = 0.0
        for r in range(3):
            a += axes[r, k] * (p[r] - center[r])
            b += axes[r, k] * (q[r] - center[r])
        step = b - a
        if abs(step) < 1e-12:
            if abs(a) > half[k]:
                return False
            continue
        one, two = (-half[k] - a) / step, (half[k] - a) / step
        enters, leaves = max(enters, min(one, two)), min(leaves, max(one, two))
        if enters > leaves:
            return False
    return True


# -- two boxes --------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _nearest_on_segments(a: Array, b: Array, c: Array, d: Array, p: Array, q: Array) -> float:
    """Squared distance of segments ab and cd; the nearest points are written to p and q (Ericson, *Real-Time Collision
    Detection*, 5.1.9). inf where they are parallel: then one of their ends is as near."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (u * u).sum(), (v * v).sum(), (u * v).sum(), (u * w).sum(), (v * w).sum()
    across = uu * vv - uv * uv
    if across <= 1e-9 * uu * vv:
        return np.inf
    s = min(1.0, max(0.0, (uv * vw - uw * vv) / across))
    t = (uv * s + vw) / vv
    if t < 0.0:
        t, s = 0.0, min(1.0, max(0.0, -uw / uu))
    elif t > 1.0:
        t, s = 1.0, min(1.0, max(0.0, (uv - uw) / uu))
    p[:] = a + s * u
    q[:] = c + t * v
    return float(((p - q) ** 2).sum())


@njit(cache=True)
def _overlap(ca: Array, ha: Array, ra: Array, cb: Array, hb: Array, rb: Array) -> bool:
    """Whether two boxes have a point in common, by the 15 separating axes (Gottschalk, Lin, Manocha, 1996)."""
    d = cb - ca
    axis = np.empty(3)
    for n in range(15):
        if n < 3:
            axis[:] = ra[:, n]
        elif n < 6:
            axis[:] = rb[:, n - 3]
        else:
            a, b = ra[:, (n - 6) // 3], rb[:, (n - 6) % 3]
            axis[0], axis[1], axis[2] = (
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            )
            if (axis * axis).sum() < 1e-12:
                continue
        reach = 0.0
        for k in range(3):
            reach += ha[k] * abs((ra[:, k] * axis).sum()) + hb[k] * abs((rb[:, k] * axis).sum())
        if abs((d * axis).sum()) > reach:
            return False
    return True


@njit(cache=True)
def _upright_gap(ca: Array, ha: Array, ra: Array, cb: Array, hb: Array, rb: Array, p: Array, q: Array) -> float:
    """`gap_between` of two upright boxes: their distance over the ground and in height."""
    apart, ties = np.inf, 0
    for side in range(2):
        c0, h0, r0, c1, h1, r1 = (ca, ha, ra, cb, hb, rb) if side == 0 else (cb, hb, rb, ca, ha, ra)
        for m in range(4):
            a, b = h0[0] if m & 1 else -h0[0], h0[1] if m & 2 else -h0[1]
            x, y = c0[0] + a * r0[0, 0] + b * r0[0, 1], c0[1] + a * r0[1, 0] + b * r0[1, 1]
            u = (x - c1[0]) * r1[0, 0] + (y - c1[1]) * r1[1, 0]
            v = (x - c1[0]) * r1[0, 1] + (y - c1[1]) * r1[1, 1]
            u_in, v_in = min(h1[0], max(-h1[0], u)), min(h1[1], max(-h1[1], v))
            away = (u - u_in) ** 2 + (v - v_in) ** 2
            if away > apart + TIE:
                continue
            if away < apart - TIE:
                p[:2], q[:2], ties = 0.0, 0.0, 0
            apart, ties = min(apart, away), ties + 1
            gx, gy = c1[0] + u_in * r1[0, 0] + v_in * r1[0, 1], c1[1] + u_in * r1[1, 0] + v_in * r1[1, 1]
            if side == 0:
                p[0], p[1], q[0], q[1] = p[0] + x, p[1] + y, q[0] + gx, q[1] + gy
            else:
                p[0], p[1], q[0], q[1] = p[0] + gx, p[1] + gy, q[0] + x, q[1] + y
    p[:2], q[:2] = p[:2] / ties, q[:2] / ties
    if apart > 0.0:
        separate = False
        for n in range(4):
            ax, ay = (ra[0, n], ra[1, n]) if n < 2 else (rb[0, n - 2], rb[1, n - 2])
            reach = 0.0
            for k in range(2):
                reach += ha[k] * abs(ra[0, k] * ax + ra[1, k] * ay) + hb[k] * abs(rb[0, k] * ax + rb[1, k] * ay)
            if abs((cb[0] - ca[0]) * ax + (cb[1] - ca[1]) * ay) > reach:
                separate = True
                break
        if not separate:  # they cross without a corner of either inside the other
            apart = 0.0
            q[0], q[1] = p[0], p[1]
    low, high = max(ca[2] - ha[2], cb[2] - hb[2]), min(ca[2] + ha[2], cb[2] + hb[2])
    if low <= high:
        p[2] = q[2] = 0.5 * (low + high)
        return float(np.sqrt(apart))
    p[2], q[2] = (low, high) if ca[2] > cb[2] else (high, low)
    return float(np.sqrt(apart + (low - high) ** 2))


@njit(cache=True)
def gap_between(ca: Array, ha: Array, ra: Array, cb: Array, hb: Array, rb: Array, p: Array, q: Array) -> float:
    """Least distance between two boxes, 0 where they overlap; a pair of points that attains it is written to p, q (3,).

    Exact: two separate boxes are nearest at a corner of one and the surface of the other, or at two edges. Where sides
    face each other, many pairs are as near: then the points are the means of all that were looked at.
    """
    if ra[2, 2] > 1.0 - UPRIGHT and rb[2, 2] > 1.0 - UPRIGHT:
        return float(_upright_gap(ca, ha, ra, cb, hb, rb, p, q))
    p[:], q[:] = 0.5 * (ca + cb), 0.5 * (ca + cb)
    if _overlap(ca, ha, ra, cb, hb, rb):
        return 0.0
    best, ties = np.inf, 0
    for side in range(2):
        c0, h0, r0, c1, h1, r1 = (ca, ha, ra, cb, hb, rb) if side == 0 else (cb, hb, rb, ca, ha, ra)
        for m in range(8):
            corner, on_box = c0.copy(), c1.copy()
            for k in range(3):
                corner += (h0[k] if m >> k & 1 else -h0[k]) * r0[:, k]
            for k in range(3):
                at = ((corner - c1) * r1[:, k]).sum()
                on_box += min(h1[k], max(-h1[k], at)) * r1[:, k]
            away = ((corner - on_box) ** 2).sum()
            if away < best - TIE:
                p[:], q[:], ties = 0.0, 0.0, 0
            if away <= best + TIE:
                best, ties = min(best, away), ties + 1
                p += corner if side == 0 else on_box
                q += on_box if side == 0 else corner
    edges_a, edges_b = _edges(ca, ha, ra), _edges(cb, hb, rb)
    on_a, on_b = np.empty(3), np.empty(3)
    for m in range(12):
        for n in range(12):
            away = _nearest_on_segments(edges_a[m, 0], edges_a[m, 1], edges_b[n, 0], edges_b[n, 1], on_a, on_b)
            if away < best - TIE:
                p[:], q[:], ties = 0.0, 0.0, 0
            if away <= best + TIE:
                best, ties = min(best, away), ties + 1
                p += on_a
                q += on_b
    p /= ties
    q /= ties
    return float(np.sqrt(best))


@njit(cache=True)
def _edges(center: Array, half: Array, axes: Array) -> Array:
    """(12, 2, 3) the ends of a box's edges."""
    edges = np.empty((12, 2, 3))
    n = 0
    for k in range(3):
        for m in range(4):
            middle = center.copy()
            for r in range(2):
                other = (k + 1 + r) % 3
                middle += (half[other] if m >> r & 1 else -half[other]) * axes[:, other]
            edges[n, 0], edges[n, 1] = middle - half[k] * axes[:, k], middle + half[k] * axes[:, k]
            n += 1
    return edges


# -- many boxes: which lie near each other ----------------------------------------------------------------------------


@njit(cache=True, inline="always")
def cell_of(at: float, cell: float) -> Any:
    """The index of the grid cell of a coordinate; what lies beyond the grid's reach is put at its border."""
    return np.int64(min(max(np.floor(at / cell), -float(CELL_LIMIT)), float(CELL_LIMIT)))


@njit(cache=True)
def cells_covered(low: Array, high: Array, cell: Array, first: Array, last: Array) -> float:
    """The cells (3,) that bounds cover, written to `first` and `last`; returns how many."""
    count = 1.0
    for r in range(3):
        first[r], last[r] = cell_of(low[r], cell[r]), cell_of(high[r], cell[r])
        count *= last[r] - first[r] + 1.0
    return count


@njit(cache=True)
def fill_grid(low: Array, high: Array, cell: Array) -> tuple[Array, Array, Array, Array, Array]:
    """A grid of bounds (n, 3) with cells (3,) [m], each in all the cells that it covers.

    Returns the cells' hash table, the first entry of each cell, and of each entry what lies there and the next entry
    (−1: none); last, what covers too many cells to be entered.
    """
    n = len(low)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    total: Int = 0
    n_large = 0
    for m in range(n):
        count = cells_covered(low[m], high[m], cell, first, last)
        if count > MOST_CELLS:
            n_large += 1
        else:
            total += np.int64(count)
    size = 16
    while size < 2 * total:
        size *= 2
    table = np.full((size, 2), -1, np.int64)
    heads = np.full(max(total, 1), -1, np.int32)
    items, following = np.empty(total, np.int32), np.empty(total, np.int32)
    large = np.empty(n_large, np.int32)
    n_cells: Int = 0
    entry = n_large = 0
    for m in range(n):
        if cells_covered(low[m], high[m], cell, first, last) > MOST_CELLS:
            large[n_large] = m
            n_large += 1
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    slot = hashing.find_or_insert(table, i, j, k, n_cells)
                    n_cells += slot == n_cells
                    items[entry], following[entry] = m, heads[slot]
                    heads[slot] = entry
                    entry += 1
    return table, heads[:n_cells].copy(), items, following, large


@njit(cache=True, inline="always")
def _bounds_meet(low_a: Array, high_a: Array, low_b: Array, high_b: Array) -> bool:
    return bool(
        low_a[0] <= high_b[0]
        and low_b[0] <= high_a[0]
        and low_a[1] <= high_b[1]
        and low_b[1] <= high_a[1]
        and low_a[2] <= high_b[2]
        and low_b[2] <= high_a[2]
    )


@njit(cache=True)
def meeting(
    low_a: Array,
    high_a: Array,
    low_b: Array,
    high_b: Array,
    cell: Array,
    table: Array,
    heads: Array,
    items: Array,
    following: Array,
    large: Array,
    same: bool,
) -> Array:
    """(m, 2) int32: which of the bounds a (n, 3) meet which of b (n, 3), those that `fill_grid` entered; each pair
    once. same: a and b are the same; then each pair is there in one order only, the lower index first.
    """
    found = np.empty((max(64, 4 * len(low_a)), 2), np.int32)
    n = 0
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(len(low_a)):
        everything = cells_covered(low_a[a], high_a[a], cell, first, last) > MOST_CELLS
        others = len(low_b) if everything and not same else len(large)
        if n + others > len(found):
            found = np.concatenate((found, np.empty((len(found) + others, 2), np.int32)))
        for m in range(others):
            b = m if everything and not same else large[m]
            if (same and (a == b or (everything and a > b))) or not _bounds_meet(
                low_a[a], high_a[a], low_b[b], high_b[b]
            ):
                continue
            found[n, 0], found[n, 1] = (min(a, b), max(a, b)) if same else (a, b)
            n += 1
        if everything:
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    slot = hashing.lookup(table, i, j, k)
                    entry = heads[slot] if slot >= 0 else -1
                    while entry >= 0:
                        b = items[entry]
                        entry = following[entry]
                        if (same and a >= b) or not _bounds_meet(low_a[a], high_a[a], low_b[b], high_b[b]):
                            continue
                        if (  # of all cells that both cover, this is the first
                            i == max(first[0], cell_of(low_b[b, 0], cell[0]))
                            and j == max(first[1], cell_of(low_b[b, 1], cell[1]))
                            and k == max(first[2], cell_of(low_b[b, 2], cell[2]))
                        ):
                            if n == len(found):
                                found = np.concatenate((found, np.empty_like(found)))
                            found[n, 0], found[n, 1] = a, b
                            n += 1
    return found[:n].copy()


# -- many boxes: measurements -----------------------------------------------------------------------------------------


@njit(cache=True)
def blocked(
    p: Array,
    q: Array,
    inset_m: float,
    center: Array,
    half: Array,
    axes: Array,
    cell: Array,
    table: Array,
    heads: Array,
    items: Array,
    following: Array,
    large: Array,
) -> bool:
    """Whether the segment from p to q (3,), short of `inset_m` at both ends, meets one of the boxes in a grid."""
    length = np.sqrt(((q - p) ** 2).sum())
    if length < 1e-6 or len(center) == 0:
        return False
    inset = min(inset_m, 0.3 * length) / length
    a, b = p + inset * (q - p), q - inset * (q - p)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    everything = cells_covered(np.minimum(a, b), np.maximum(a, b), cell, first, last) > MOST_CELLS
    for m in range(len(center) if everything else len(large)):
        n = m if everything else large[m]
        if crosses(center[n], half[n], axes[n], a, b):
            return True
    if everything:
        return False
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                slot = hashing.lookup(table, i, j, k)
                entry = heads[slot] if slot >= 0 else -1
                while entry >= 0:
                    n = items[entry]
                    if crosses(center[n], half[n], axes[n], a, b):
                        return True
                    entry = following[entry]
    return False


@njit(cache=True)
def measure_pairs(
    pairs: Array,
    center: Array,
    half: Array,
    axes: Array,
    low: Array,
    high: Array,
    corners: Array,
    count: Array,
    area: Array,
    reach: Array,
    inset_m: float,
    solid: tuple[Array, Array, Array],
    grid: tuple[Array, Array, Array, Array, Array, Array],
) -> tuple[Array, Array, Array, Array]:
    """Measurements of pairs (m, 2) of boxes.

    reach       : (n,) the gap of a pair is looked for up to the sum of both [m]
    solid, grid : boxes (centre, half, axes) through which no way leads, and (cell, *fill_grid) of their bounds
    Returns (m,) arrays: gap [m] (inf beyond reach); whether the way between the nearest points is clear;
    overlap of the footprints as a share of the smaller; whether a solid lies between the upper and the lower there.
    """
    n_pairs = len(pairs)
    gap, overlap = np.full(n_pairs, np.inf), np.zeros(n_pairs)
    clear, between = np.ones(n_pairs, np.bool_), np.zeros(n_pairs, np.bool_)
    p, q = np.empty(3), np.empty(3)
    cell, table, heads, items, following, large = grid
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
            clear[m] = apart == 0.0 or not blocked(
                p, q, inset_m, solid[0], solid[1], solid[2], cell, table, heads, items, following, large
            )
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
            between[m] = blocked(
                p, q, inset_m, solid[0], solid[1], solid[2], cell, table, heads, items, following, large
            )
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
def _samples(center: Array, half: Array, axes: Array, rectangle: Array, lowest: float, foot: float, at: Array) -> int:
    """Columns (n, 2) through one box, spread over its footing: where it reaches down to `foot` [m] above its lowest
    point. Written to `at`; returns how many."""
    n = 0
    upright = axes[2, 2] > 1.0 - UPRIGHT
    for a in range(SIDE_SAMPLES):
        for b in range(SIDE_SAMPLES):
            along = rectangle[4] * ((2 * a + 1) / SIDE_SAMPLES - 1.0)
            across = rectangle[5] * ((2 * b + 1) / SIDE_SAMPLES - 1.0)
            x = rectangle[0] + along * rectangle[2] - across * rectangle[3]
            y = rectangle[1] + along * rectangle[3] + across * rectangle[2]
            enters = lowest if upright else column_through(center, half, axes, x, y)[0]
            if enters < np.inf and enters <= lowest + foot:
                at[n, 0], at[n, 1] = x, y
                n += 1
    if n == 0:
        at[0, 0], at[0, 1] = center[0], center[1]
        n = 1
    return n


@njit(cache=True)
def _covers_all(
    candidates: Array,
    rank: Array,
    center: Array,
    half: Array,
    axes: Array,
    high: Array,
    middle: Array,
    turned: Array,
    rectangle: Array,
) -> int:
    """The first of the candidates that lies under the whole of an upright box, all being upright; −1: it does not."""
    best = -1
    for j in candidates:
        if axes[j, 2, 2] <= 1.0 - UPRIGHT:
            return -1
        if best < 0 or high[j, 2] > high[best, 2] or (high[j, 2] == high[best, 2] and rank[j] < rank[best]):
            best = j
    if turned[2, 2] <= 1.0 - UPRIGHT:
        return -1
    for m in range(4):
        along = rectangle[4] if m & 1 else -rectangle[4]
        across = rectangle[5] if m & 2 else -rectangle[5]
        x = middle[0] + along * rectangle[2] - across * rectangle[3]
        y = middle[1] + along * rectangle[3] + across * rectangle[2]
        if column_through(center[best], half[best], axes[best], x, y)[0] == np.inf:
            return -1
    return best


@njit(cache=True)
def stand(
    starts: Array,
    below: Array,
    rank: Array,
    center: Array,
    half: Array,
    axes: Array,
    low: Array,
    high: Array,
    rectangle: Array,
    tolerance: float,
    foot: float,
) -> tuple[Array, Array, Array]:
    """On what boxes stand: each column of a footing goes to the first other material downwards, within `tolerance`.

    starts, below : (n + 1,), (m,) what may lie below each of the first n boxes: those of row i are
        below[starts[i] : starts[i + 1]]
    rank          : (boxes,) which of two equally high surfaces goes first
    Returns (k,) arrays: upper box, lower box, share of the upper one's footing.
    """
    uppers, lowers, shares = np.empty(64, np.int32), np.empty(64, np.int32), np.empty(64)
    n = 0
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    for i in range(len(starts) - 1):
        candidates = below[starts[i] : starts[i + 1]]
        if len(candidates) == 0:
            continue
        while n + len(candidates) > len(uppers):
            uppers, lowers = np.concatenate((uppers, uppers)), np.concatenate((lowers, lowers))
            shares = np.concatenate((shares, shares))
        highest = _covers_all(candidates, rank, center, half, axes, high, center[i], axes[i], rectangle[i])
        if highest >= 0:
            uppers[n], lowers[n], shares[n] = i, highest, 1.0
            n += 1
            continue
        counts = np.zeros(len(candidates), np.int64)
        n_columns = _samples(center[i], half[i], axes[i], rectangle[i], low[i, 2], foot, at)
        for c in range(n_columns):
            best, top = -1, low[i, 2] - tolerance
            for m in range(len(candidates)):
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
        for m in range(len(candidates)):
            if counts[m]:
                uppers[n], lowers[n], shares[n] = i, candidates[m], counts[m] / n_columns
                n += 1
    return uppers[:n].copy(), lowers[:n].copy(), shares[:n].copy()


@njit(cache=True)
def inside_boxes(
    pairs: Array,
    center: Array,
    half: Array,
    axes: Array,
    low: Array,
    high: Array,
    corners: Array,
    count: Array,
    area: Array,
    rectangle: Array,
    foot: float,
) -> tuple[Array, Array]:
    """For pairs (m, 2), the shares (m,) of the first box's footing, a little above its bottom, and of its volume that
    lie in the second box."""
    footing, volume = np.empty(len(pairs)), np.empty(len(pairs))
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    for m in range(len(pairs)):
        a, b = pairs[m, 0], pairs[m, 1]
        lift = min(foot, 0.5 * (high[a, 2] - low[a, 2]))
        height = high[a, 2] - low[a, 2]
        if axes[a, 2, 2] > 1.0 - UPRIGHT and axes[b, 2, 2] > 1.0 - UPRIGHT and area[a] > 0.0 and height > 0.0:
            share = min(1.0, overlap_area(corners[a, : count[a]], corners[b, : count[b]]) / area[a])
            common = min(high[a, 2], high[b, 2]) - max(low[a, 2], low[b, 2])
            footing[m] = share if low[b, 2] <= low[a, 2] + lift <= high[b, 2] else 0.0
            volume[m] = share * max(0.0, common) / height
            continue
        n_columns = _samples(center[a], half[a], axes[a], rectangle[a], low[a, 2], foot, at)
        n_inside = 0
        for c in range(n_columns):
            n_inside += outside(center[b], half[b], axes[b], at[c, 0], at[c, 1], low[a, 2] + lift) <= 1e-9
        footing[m] = n_inside / n_columns
        n_inside = 0
        for i in range(SIDE_SAMPLES):
            for j in range(SIDE_SAMPLES):
                for k in range(SIDE_SAMPLES):
                    u = half[a, 0] * ((2 * i + 1) / SIDE_SAMPLES - 1.0)
                    v = half[a, 1] * ((2 * j + 1) / SIDE_SAMPLES - 1.0)
                    w = half[a, 2] * ((2 * k + 1) / SIDE_SAMPLES - 1.0)
                    point = center[a] + u * axes[a, :, 0] + v * axes[a, :, 1] + w * axes[a, :, 2]
                    n_inside += outside(center[b], half[b], axes[b], point[0], point[1], point[2]) <= 1e-9
        volume[m] = n_inside / SIDE_SAMPLES**3
    return footing, volume


@njit(cache=True)
def shares_in_polygons(
    pairs: Array, center: Array, half: Array, axes: Array, rectangle: Array, starts: Array, rings: Array
) -> Array:
    """(m,) shares of a box's ground projection that lie in a polygon, for pairs (box, polygon) (m, 2).

    starts, rings : (n + 1,), (k, 2) the corners of polygon i are rings[starts[i] : starts[i + 1]]
    """
    shares = np.empty(len(pairs))
    at = np.empty((SIDE_SAMPLES * SIDE_SAMPLES, 2))
    for m in range(len(pairs)):
        a, ring = pairs[m, 0], rings[starts[pairs[m, 1]] : starts[pairs[m, 1] + 1]]
        n_columns = _samples(center[a], half[a], axes[a], rectangle[a], 0.0, np.inf, at)
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
