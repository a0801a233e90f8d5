"""How far masks reach beyond their things: measured where depth shows a thing's outline, taken off where it does not.

A *mask* image numbers the masks of things in an image; 0 is background: what is labelled as stuff, or not at all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

GAP_PX = 6  # depth is looked for at most this far beside a jump, where cameras lose it


@njit(cache=True)
def measure_bleed(
    mask: Array, depth: Array, step_m: float, step_share: float, slope: float, pixel_m: float, counts: Array
) -> None:
    """Count how far each mask reaches beyond its thing, in place, at border pixels where depth shows the outline.

    mask   : (H, W) int32; depth (H, W) float32 [m], 0 = not measured
    slope  : surfaces are no steeper than this against the image plane; pixel_m: the width of a pixel at 1 m
    counts : (n_masks + 1, bins) int32: border pixels by reach [half pixels]; farther ones are not counted

    From every background pixel that touches a mask the look goes straight into the mask until depth jumps towards the
    camera by more than noise and slope allow: there is the outline. Cameras lose as much depth on either side of a
    jump, so it lies midway between the two pixels measured next to it.
    """
    height, width = mask.shape
    bins = counts.shape[1]
    for v in range(height):
        for u in range(width):
            if mask[v, u] != 0:
                continue
            for n in range(4):
                dv, du = (-1, 0) if n == 0 else (1, 0) if n == 1 else (0, -1) if n == 2 else (0, 1)
                a, b = v + dv, u + du
                if a < 0 or b < 0 or a >= height or b >= width or mask[a, b] == 0:
                    continue
                m = mask[a, b]
                behind, at = np.float32(0.0), 0  # the depth measured last, and how many pixels from here
                for outside in range(GAP_PX):
                    a, b = v - outside * dv, u - outside * du
                    if a < 0 or b < 0 or a >= height or b >= width or mask[a, b] != 0:
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
    mask: Array, labels: Array, depth: Array, bleed: Array, share: float, step_m: float, slope: float, pixel_m: float
) -> int:
    """Give the rims of masks to the background that they lie on, in place; returns how many pixels that were.

    mask   : (H, W) int32, 0 where taken off;  labels (H, W) uint16: there that of the nearest background beside it
    depth  : (H, W) float32 [m], 0 = not measured
    bleed  : (n_masks + 1,) int64 [px]: how wide the rim of each mask is, at most 15
    share  : of a mask's width that may be taken off one side

    A pixel is of the rim when a background pixel beside the mask is no farther than its bleed, straight ahead or up to
    45° aside, and the surface goes on from there: depths differ by less than step_m + slope · d · z · pixel_m.
    """
    height, width = mask.shape
    nearest = np.zeros((height, width), np.uint8)  # squared distance to the nearest background so far, 0 = none
    source = np.empty((height, width), np.int32)
    rim = np.empty(height * width, np.int32)
    n_rim = 0
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if mask[v, u] != 0 or not z > 0.0:
                continue
            for n in range(4):
                dv, du = (-1, 0) if n == 0 else (1, 0) if n == 1 else (0, -1) if n == 2 else (0, 1)
                a, b = v + dv, u + du
                if a < 0 or b < 0 or a >= height or b >= width or mask[a, b] == 0:
                    continue
                m = mask[a, b]
                r = bleed[m]
                for along in range(1, r + 1):
                    for aside in range(-along, along + 1):
                        square = along * along + aside * aside
                        down, right = along * dv + aside * du, along * du + aside * dv
                        a, b = v + down, u + right
                        if square > r * r or a < 0 or b < 0 or a >= height or b >= width or mask[a, b] != m:
                            continue
                        if 0 < nearest[a, b] <= square:
                            continue
                        c, d = v + int(np.rint(down / share)), u + int(np.rint(right / share))
                        if 0 <= c < height and 0 <= d < width and mask[c, d] != m:
                            continue
                        if not abs(depth[a, b] - z) < step_m + slope * np.sqrt(square) * z * pixel_m:
                            continue
                        if nearest[a, b] == 0:
                            rim[n_rim] = a * width + b
                            n_rim += 1
                        nearest[a, b], source[a, b] = square, v * width + u
    for i in range(n_rim):
        v, u = rim[i] // width, rim[i] % width
        mask[v, u] = 0
        labels[v, u] = labels[source[v, u] // width, source[v, u] % width]
    return n_rim
