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
    """Every pixel beside a mask that is not of it, the step into the mask, and which mask that is."""
    for v, u in np.ndindex(mask.shape):
        for dv, du in FOUR:
            if inside(mask, v + dv, u + du) and 0 < mask[v + dv, u + du] != mask[v, u]:
                yield v, u, dv, du, int(mask[v + dv, u + du])


def bleeds(
    mask: np.ndarray, depth: np.ndarray, step_m: float, step_share: float, slope: float, pixel_m: float, gap: int,
    most: int,
) -> dict[int, dict[int, int]]:  # fmt: skip
    """How many border pixels of each mask show each reach beyond the thing [half pixels]."""
    found: defaultdict[int, defaultdict[int, int]] = defaultdict(lambda: defaultdict(int))
    for v, u, dv, du, m in borders(mask):
        if mask[v, u] > 0:
            continue
        # the ray of pixels through the border: those of the background up to the gap, then those of the mask
        outer = []
        for s in range(gap):
            if not inside(mask, v - s * dv, u - s * du) or mask[v - s * dv, u - s * du] > 0:
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


def rims(
    mask: np.ndarray, depth: np.ndarray, bleed: np.ndarray, share: float, step_m: float, slope: float, pixel_m: float
) -> dict[tuple[int, int], set[tuple[int, bool]]]:
    """What each pixel of the masks may become, by the nearest pixels outside that face it, and whether in doubt."""
    facing: defaultdict[tuple[int, int], defaultdict[int, set[tuple[int, int]]]]
    facing = defaultdict(lambda: defaultdict(set))
    for v, u, dv, du, m in borders(mask):
        for a, b in np.argwhere(mask == m).tolist():
            down, right = a - v, b - u
            if depth[v, u] > 0 and down * dv + right * du >= abs(down * du) + abs(right * dv):
                facing[a, b][down**2 + right**2].add((v, u))
    choices = {}
    for pixel, by_distance in facing.items():
        square, m, choices[pixel] = min(by_distance), int(mask[pixel]), set()
        for v, u in by_distance[square]:
            behind = (v + round((pixel[0] - v) / share), u + round((pixel[1] - u) / share))
            deep = not inside(mask, *behind) or mask[behind] == m
            limit = step_m + slope * np.sqrt(square) * depth[v, u] * pixel_m
            rim = square <= bleed[m] ** 2 and abs(depth[pixel] - depth[v, u]) < limit
            outside = int(mask[v, u])
            choices[pixel].add((outside if rim and deep and outside <= 0 else m, bool(rim and outside > 0)))
    return choices


def sweep(shape: tuple[int, ...]) -> Iterator[tuple[tuple[int, int], list[tuple[int, int]]]]:
    """All pixels row by row, then all of them back, each with the neighbours of eight that the sweep has passed."""
    height, width = shape
    pixels = [(v, u) for v in range(height) for u in range(width)]
    for order in (pixels, pixels[::-1]):
        passed: set[tuple[int, int]] = set()
        for v, u in order:
            around = [(v + dv, u + du) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
            yield (v, u), [pixel for pixel in around if pixel in passed]
            passed.add((v, u))


def cores(mask: np.ndarray, distance: np.ndarray, least: np.ndarray) -> np.ndarray:
    """The pixels of masks that lie deeper than the mask's depth around them asks for."""
    peak = 2 * distance.astype(int)
    for pixel, passed in sweep(mask.shape):
        for other in passed:
            if mask[other] == mask[pixel]:
                peak[pixel] = max(peak[pixel], peak[other] - 1)
    return np.where((mask > 0) & (distance > least[peak]), mask, 0)


def widened(
    pieces: np.ndarray, mask: np.ndarray, depth: np.ndarray, reach: int, step_m: float, slope: float, pixel_m: float
) -> list[list[set[int]]]:
    """The pieces that each pixel may belong to: its own, or those of the nearest cores of its mask, if they fit."""
    away = {pixel: (0.0, {pixel}) for pixel in map(tuple, np.argwhere(pieces > 0).tolist())}
    for pixel, passed in sweep(mask.shape):
        for other in passed:
            if mask[pixel] > 0 and mask[other] == mask[pixel] and other in away:
                step = 1.5 if pixel[0] != other[0] and pixel[1] != other[1] else 1.0
                cost = away[other][0] + step
                best, sources = away.get(pixel, (np.inf, set()))
                if cost <= best:
                    away[pixel] = (cost, away[other][1] | (sources if cost == best else set()))
    out = [[{int(piece)} for piece in row] for row in pieces]
    for (v, u), (d, sources) in away.items():
        if d == 0:
            continue
        z = depth[v, u]
        fits = {
            int(pieces[s]) if abs(depth[s] - z) < step_m + slope * d * z * pixel_m and z > 0 and d <= reach else 0
            for s in sources
        }
        out[v][u] = fits
    return out


def weight(trust: float, most: float, depth: float, depth_noise: float, voxel: float) -> float:
    """What a full view of a pixel counts."""
    sigma = depth_noise * depth**2
    return most * (trust / most) ** 6 / (1.0 + (2.0 * sigma / voxel) ** 2)
