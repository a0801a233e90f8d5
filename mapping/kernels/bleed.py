"""How far masks reach beyond their things: measured where depth shows a thing's outline, taken off where it does not.

A *mask* image numbers the masks of things in an image from 1; pixels of the background have minus their label, 0 where
they have none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

GAP_PX = 6  # depth is looked for at most this far beside a jump, where cameras lose it


@njit(cache=True)
def find_borders(mask: Array) -> Array:
    """Where masks (H, W) int32 end: (n,) int32 4 · pixel outside + way into the mask.

    Pixels are counted row by row; ways are 0 up, 1 down, 2 left, 3 right. Outside is background or another mask.
    """
    height, width = mask.shape
    found = np.empty(4 * height * width, np.int32)
    n = 0
    for v in range(height):
        row, above = mask[v], mask[max(v - 1, 0)]
        left = row[0]
        for u in range(width):
            m = row[u]
            if above[u] != m:
                n = _enter_border(m, above[u], v * width + u, (v - 1) * width + u, 0, found, n)
            if left != m:
                n = _enter_border(m, left, v * width + u, v * width + u - 1, 2, found, n)
            left = m
    return found[:n].copy()


@njit(cache=True, inline="always")
def _enter_border(m: int, beside: int, pixel: int, pixel_beside: int, way: int, found: Array, n: int) -> int:
    """Enter where mask m at a pixel and the other beside it end into `found`, in place, of which n are in use; see
    `find_borders`. Returns how many are then."""
    if beside > 0:
        found[n] = 4 * pixel + way
        n += 1
    if m > 0:
        found[n] = 4 * pixel_beside + way + 1
        n += 1
    return n


@njit(cache=True, inline="always")
def _step(way: int) -> tuple[int, int]:
    """Rows and columns that one step on this way goes."""
    return (-1, 0) if way == 0 else (1, 0) if way == 1 else (0, -1) if way == 2 else (0, 1)


@njit(cache=True)
def measure_bleed(
    mask: Array,
    borders: Array,
    depth: Array,
    step_m: float,
    step_share: float,
    slope: float,
    pixel_m: float,
    counts: Array,
) -> None:
    """Count how far each mask reaches beyond its thing, in place, at border pixels where depth shows the outline.

    mask   : (H, W) int32; borders (n,) as found in it; depth (H, W) float32 [m], 0 = not measured
    slope  : surfaces are no steeper than this against the image plane; pixel_m: the width of a pixel at 1 m
    counts : (n_masks + 1, bins) int32: border pixels by reach [half pixels]; farther ones are not counted

    From every background pixel beside a mask the look goes straight into the mask until depth jumps towards the camera
    by more than noise and slope allow: there is the outline. Cameras lose as much depth on either side of a jump, so it
    lies midway between the two pixels measured next to it.
    """
    height, width = mask.shape
    bins = counts.shape[1]
    for i in range(len(borders)):
        v, u = borders[i] // 4 // width, borders[i] // 4 % width
        if mask[v, u] > 0:
            continue
        dv, du = _step(borders[i] % 4)
        m = mask[v + dv, u + du]
        behind, at = np.float32(0.0), 0  # the depth measured last, and how many pixels from here
        for outside in range(GAP_PX):
            a, b = v - outside * dv, u - outside * du
            if a < 0 or b < 0 or a >= height or b >= width or mask[a, b] > 0:
                break
            if depth[a, b] > 0.0:
                behind, at = depth[a, b], -outside
                break
        for inside in range(1, bins // 2 + GAP_PX):
            a, b = v + inside * dv, u + inside * du
            if a < 0 or b < 0 or a >= height or b >= width or mask[a, b] != m:
                break
            z = depth[a, b]
            if not z > 0.0:
                continue
            if behind > 0.0 and behind - z > step_m + (step_share + slope * (inside - at) * pixel_m) * z:
                reach = max(inside + at - 1, 0)
                if reach < bins:
                    counts[m, reach] += 1
                break
            behind, at = z, inside


@njit(cache=True)
def take_off(
    mask: Array,
    doubtful: Array,
    borders: Array,
    depth: Array,
    bleed: Array,
    share: float,
    step_m: float,
    slope: float,
    pixel_m: float,
) -> None:
    """Give the rims of masks to the background that they lie on, and doubt those beside other masks, in place.

    mask     : (H, W) int32; a pixel taken off becomes what the nearest background is
    doubtful : (H, W) uint8 of zeros; 1 where either of two masks that touch may have bled over the other
    borders  : (n,) as found in the masks;  depth (H, W) float32 [m], 0 = not measured
    bleed    : (n_masks + 1,) int64 [px]: how wide the rim of each mask is, at most 15
    share    : of a mask's width that may be taken off one side

    Of the measured pixels just outside a mask, one faces a pixel of the mask that lies straight ahead or up to 45°
    aside. A pixel is of the rim when the nearest that faces it is no farther than the mask's bleed and the surface goes
    on from there: depths differ by less than step_m + slope · d · z · pixel_m.
    """
    height, width = mask.shape
    nearest = np.zeros((height, width), np.uint8)  # squared distance to the nearest pixel outside so far, 0 = none
    source = np.empty((height, width), np.int32)
    rim = np.empty(height * width, np.int32)
    n_rim = 0
    for i in range(len(borders)):
        v, u = borders[i] // 4 // width, borders[i] // 4 % width
        dv, du = _step(borders[i] % 4)
        m = mask[v + dv, u + du]
        r = bleed[m]
        if r == 0 or not depth[v, u] > 0.0:
            continue
        # what lies aside is nearer to the next pixel outside, if the border goes straight on there
        left, right = 1, 1
        for side in (-1, 1):
            a, b = v + side * du, u + side * dv
            within = 0 <= a < height and 0 <= b < width
            if within and mask[a, b] != m and depth[a, b] > 0.0 and mask[a + dv, b + du] == m:
                left, right = (0, right) if side < 0 else (left, 0)
        for ahead in range(1, r + 1):
            for aside in range(-left * ahead, right * ahead + 1):
                square = ahead * ahead + aside * aside
                a, b = v + ahead * dv + aside * du, u + ahead * du + aside * dv
                if square > r * r or a < 0 or b < 0 or a >= height or b >= width or mask[a, b] != m:
                    continue
                if nearest[a, b] == 0:
                    rim[n_rim] = a * width + b
                    n_rim += 1
                elif square >= nearest[a, b]:
                    continue
                nearest[a, b], source[a, b] = square, v * width + u
    taken = 0
    for i in range(n_rim):
        v, u = rim[i] // width, rim[i] % width
        a, b = source[v, u] // width, source[v, u] % width
        if not abs(depth[v, u] - depth[a, b]) < step_m + slope * np.sqrt(nearest[v, u]) * depth[a, b] * pixel_m:
            continue
        if mask[a, b] > 0:
            doubtful[v, u] = 1
            continue
        c, d = a + int(np.rint((v - a) / share)), b + int(np.rint((u - b) / share))
        if c < 0 or c >= height or d < 0 or d >= width or mask[c, d] == mask[v, u]:
            rim[taken] = rim[i]
            taken += 1
    for i in range(taken):
        v, u = rim[i] // width, rim[i] % width
        mask[v, u] = mask[source[v, u] // width, source[v, u] % width]
