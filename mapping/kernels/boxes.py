"""Oriented boxes: bounds, ground projections, columns and segments through them, and the distance of two.

A box is its centre (3,) [m], half its edge lengths (3,) [m], and its axes as the columns of a rotation (3, 3).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.shapes import convex_hull, polygon_area

Array = NDArray[Any]

UPRIGHT = 1e-6
"""A box whose z axis leans from the map's by less than this is taken to stand upright."""
TIE = 1e-12
"""Squared distances this close are taken to be the same [m²]."""


class Boxes(NamedTuple):
    """Many boxes, as `describe` gives them.

    center, half (n, 3) [m], axes (n, 3, 3) : as above
    low, high : (n, 3) their bounds along the axes of the map [m]
    corners   : (n, 8, 2) their ground projections, counter-clockwise;  n_corners : (n,) how many of these are used
        (6 at most, but for rounding);  area : (n,) [m²]
    rectangle : (n, 6) about the ground projection, along its longest direction: centre x, y, unit direction of the
        length, half length, half width
    """

    center: Array
    half: Array
    axes: Array
    low: Array
    high: Array
    corners: Array
    n_corners: Array
    area: Array
    rectangle: Array


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
def describe(center: Array, half: Array, axes: Array) -> Boxes:
    """The boxes of these centres (n, 3), half sizes (n, 3) [m] and axes (n, 3, 3)."""
    n_boxes = len(center)
    low, high = np.empty((n_boxes, 3)), np.empty((n_boxes, 3))
    corners = np.zeros((n_boxes, 8, 2))
    count = np.zeros(n_boxes, np.int64)
    area = np.zeros(n_boxes)
    rectangle = np.empty((n_boxes, 6))
    points = np.empty((8, 2))
    for n in range(n_boxes):
        for r in range(3):
            reach = 0.0
            for k in range(3):
                reach += abs(axes[n, r, k]) * half[n, k]
            low[n, r], high[n, r] = center[n, r] - reach, center[n, r] + reach
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
    return Boxes(center, half, axes, low, high, corners, count, area, rectangle)


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
def overlap(ca: Array, ha: Array, ra: Array, cb: Array, hb: Array, rb: Array) -> bool:
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
    if overlap(ca, ha, ra, cb, hb, rb):
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
