"""Slow, obvious twins of the kernels that cut masks: one pixel at a time, by definition."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

FOUR = ((-1, 0), (1, 0), (0, -1), (0, 1))


def inside(image: np.ndarray, v: int, u: int) -> bool:
    return 0 <= v < image.shape[0] and 0 <= u < image.shape[1]


def borders(mask: np.ndarray) -> Iterator[tuple[int, int, int, int, int]]:
    """Every background pixel beside a mask, the step into the mask, and which mask that is."""
    for v, u in np.argwhere(mask == 0).tolist():
        for dv, du in FOUR:
            if inside(mask, v + dv, u + du) and mask[v + dv, u + du]:
                yield v, u, dv, du, int(mask[v + dv, u + du])


def bleeds(
    mask: np.ndarray, depth: np.ndarray, step_m: float, step_share: float, slope: float, pixel_m: float, gap: int,
    most: int,
) -> dict[int, dict[int, int]]:  # fmt: skip
    """How many border pixels of each mask show each reach beyond the thing [half pixels]."""
    found: defaultdict[int, defaultdict[int, int]] = defaultdict(lambda: defaultdict(int))
    for v, u, dv, du, m in borders(mask):
        # the ray of pixels through the border: those of the background up to the gap, then those of the mask
        outer = []
        for s in range(gap):
            if not inside(mask, v - s * dv, u - s * du) or mask[v - s * dv, u - s * du]:
                break
            outer.append(-s)
        inner = []
        for s in range(1, most // 2 + gap):
            if not inside(mask, v + s * dv, u + s * du) or mask[v + s * dv, u + s * du] != m:
                break
            inner.append(s)
        seen = [s for s in outer if depth[v + s * dv, u + s * du] > 0][:1]  # outside, only the nearest measured one
        seen += [s for s in inner if depth[v + s * dv, u + s * du] > 0]
        for far, near in pairwise(seen):
            z, behind = depth[v + near * dv, u + near * du], depth[v + far * dv, u + far * du]
            if near > 0 and behind - z > step_m + (step_share + slope * (near - far) * pixel_m) * z:
                outline = (near + far) / 2  # from this background pixel; the mask begins half a pixel further
                reach = max(0, round(2 * (outline - 0.5)))
                if reach < most:
                    found[m][reach] += 1
                break
    return {m: dict(of) for m, of in found.items()}


def without_rims(
    mask: np.ndarray, labels: np.ndarray, depth: np.ndarray, bleed: np.ndarray, share: float, step_m: float,
    slope: float, pixel_m: float,
) -> tuple[np.ndarray, dict[tuple[int, int], set[int]]]:  # fmt: skip
    """The masks without their rims, and which labels the nearest backgrounds of each rim pixel have."""
    rims: dict[tuple[int, int], dict[int, set[int]]] = {}
    for v, u, dv, du, m in borders(mask):
        for a, b in np.argwhere(mask == m).tolist():
            down, right = a - v, b - u
            square = down**2 + right**2
            ahead, aside = down * dv + right * du, abs(down * du) + abs(right * dv)
            if square > bleed[m] ** 2 or ahead < aside or depth[v, u] <= 0:
                continue
            behind = (v + round(down / share), u + round(right / share))
            if inside(mask, *behind) and mask[behind] != m:
                continue
            z = depth[v, u]
            if abs(depth[a, b] - z) < step_m + slope * np.sqrt(square) * z * pixel_m:
                rims.setdefault((a, b), {}).setdefault(square, set()).add(int(labels[v, u]))
    left = mask.copy()
    for pixel in rims:
        left[pixel] = 0
    return left, {pixel: of[min(of)] for pixel, of in rims.items()}
