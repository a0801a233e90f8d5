"""From a segmented depth image to connected pieces of surface, without the boundary-pixel error.

A mask that bleeds over its object's edge lies, beyond the edge, on another surface: the depth jumps there. Pieces are
the 4-connected components of one mask over which the depth does not jump.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

CORE_PX = 16  # distances to the mask's boundary are counted up to here


@njit(cache=True)
def mask_depths(keys: Array, distance: Array) -> None:
    """Distance of every pixel to the nearest pixel of another mask, in place.

    keys     : (H, W) int64, the mask that a pixel belongs to; 0 = none
    distance : (H, W) uint8 [px], city-block, capped at CORE_PX; 0 outside masks. The image's edge is no boundary.
    """
    height, width = keys.shape
    for v in range(height):
        for u in range(width):
            if keys[v, u] == 0:
                distance[v, u] = 0
                continue
            best = CORE_PX
            if v > 0:
                best = min(best, distance[v - 1, u] + 1 if keys[v - 1, u] == keys[v, u] else 1)
            if u > 0:
                best = min(best, distance[v, u - 1] + 1 if keys[v, u - 1] == keys[v, u] else 1)
            distance[v, u] = best
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            best = int(distance[v, u])
            if best == 0:
                continue
            if v + 1 < height:
                best = min(best, distance[v + 1, u] + 1 if keys[v + 1, u] == keys[v, u] else 1)
            if u + 1 < width:
                best = min(best, distance[v, u + 1] + 1 if keys[v, u + 1] == keys[v, u] else 1)
            distance[v, u] = best


@njit(cache=True)
def _root(parent: Array, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def connect(keys: Array, depth: Array, step_m: float, step_share: float, pieces: Array) -> int:
    """Number the connected pieces of all masks, in place; returns how many there are.

    keys   : (H, W) int64, 0 = none
    depth  : (H, W) float32 [m], 0 = not measured
    pieces : (H, W) int32, out: 1 … n, 0 where there is no mask or no depth

    Neighbours belong together when their depths differ by less than step_m + step_share · depth.
    """
    height, width = keys.shape
    parent = np.empty(height * width // 2 + 2, dtype=np.int32)
    n = 0
    for v in range(height):
        for u in range(width):
            pieces[v, u] = 0
            z = depth[v, u]
            if keys[v, u] == 0 or not z > 0.0:
                continue
            limit = step_m + step_share * z
            left = up = 0
            if u > 0 and pieces[v, u - 1] and keys[v, u - 1] == keys[v, u] and abs(depth[v, u - 1] - z) < limit:
                left = _root(parent, pieces[v, u - 1])
            if v > 0 and pieces[v - 1, u] and keys[v - 1, u] == keys[v, u] and abs(depth[v - 1, u] - z) < limit:
                up = _root(parent, pieces[v - 1, u])
            if left and up:
                low, high = min(left, up), max(left, up)
                parent[high] = low
                pieces[v, u] = low
            elif left or up:
                pieces[v, u] = left + up
            else:
                n += 1
                parent[n] = n
                pieces[v, u] = n
    number = np.zeros(n + 1, dtype=np.int32)
    found = 0
    for i in range(1, n + 1):
        if _root(parent, i) == i:
            found += 1
            number[i] = found
    for v in range(height):
        for u in range(width):
            if pieces[v, u]:
                pieces[v, u] = number[_root(parent, pieces[v, u])]
    return found


@njit(cache=True)
def number_masks(keys: Array, mask: Array) -> Array:
    """Number the masks in order of appearance, in place; returns their keys (n,), the first being 0, no mask.

    keys (H, W) int64, 0 = none; mask (H, W) int32
    """
    height, width = keys.shape
    size = 1024
    table = np.zeros((size, 2), dtype=np.int64)  # key, number
    names = np.zeros(size, dtype=np.int64)
    n = 1
    last_key, last = np.int64(0), np.int32(0)
    for v in range(height):
        for u in range(width):
            key = keys[v, u]
            if key == last_key:
                mask[v, u] = last
                continue
            row = (key * 0x9E3779B1 >> 7) & (size - 1)
            while table[row, 0] != key and table[row, 0] != 0:
                row = (row + 1) & (size - 1)
            if table[row, 0] == 0 and key != 0:
                if 2 * n >= size:
                    size *= 2
                    table = np.zeros((size, 2), dtype=np.int64)
                    longer = np.zeros(size, dtype=np.int64)
                    longer[:n] = names[:n]
                    names = longer
                    for m in range(1, n):
                        row = (names[m] * 0x9E3779B1 >> 7) & (size - 1)
                        while table[row, 0] != 0:
                            row = (row + 1) & (size - 1)
                        table[row, 0], table[row, 1] = names[m], m
                    row = (key * 0x9E3779B1 >> 7) & (size - 1)
                    while table[row, 0] != 0:
                        row = (row + 1) & (size - 1)
                table[row, 0], table[row, 1] = key, n
                names[n] = key
                n += 1
            last_key, last = key, np.int32(0 if key == 0 else table[row, 1])
            mask[v, u] = last
    return names[:n].copy()


@njit(cache=True)
def local_peaks(mask: Array, distance: Array, peak: Array) -> None:
    """How deep a mask is around each of its pixels, in place: the largest distance from its boundary, fading with
    half a
    pixel a pixel.

    mask (H, W) int32, 0 = none; distance (H, W) uint8 [px]; peak (H, W) uint8, out [half pixels]: the largest of
    2 · distance(q) − steps from q along the mask. Two raster sweeps, as for a chamfer distance.
    """
    height, width = mask.shape
    for v in range(height):
        for u in range(width):
            best = 2 * int(distance[v, u])
            if mask[v, u]:
                for n in range(4):
                    a = v if n == 0 else v - 1
                    b = u - 1 if n < 2 else u + n - 2
                    if a >= 0 and b >= 0 and b < width and mask[a, b] == mask[v, u]:
                        best = max(best, int(peak[a, b]) - 1)
            peak[v, u] = best
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            if mask[v, u]:
                best = int(peak[v, u])
                for n in range(4):
                    a = v if n == 0 else v + 1
                    b = u + 1 if n < 2 else u - n + 2
                    if a < height and b >= 0 and b < width and mask[a, b] == mask[v, u]:
                        best = max(best, int(peak[a, b]) - 1)
                peak[v, u] = best


@njit(cache=True)
def measure_pieces(
    mask: Array,
    distance: Array,
    depth: Array,
    pieces: Array,
    of_mask: Array,
    pixels: Array,
    centrality: Array,
    mean_depth: Array,
) -> None:
    """Sum up every piece, in place.

    of_mask    : (n,) int32, the mask that a piece belongs to
    pixels     : (n,) int64, its size
    centrality : (n,) float64, Σ distance²: large where the middle of the mask is
    mean_depth : (n,) float64 [m]
    """
    height, width = mask.shape
    for v in range(height):
        for u in range(width):
            i = pieces[v, u] - 1
            if i < 0:
                continue
            of_mask[i] = mask[v, u]
            pixels[i] += 1
            centrality[i] += float(distance[v, u]) ** 2
            mean_depth[i] += depth[v, u]
    for i in range(len(pixels)):
        mean_depth[i] /= max(pixels[i], 1)


@njit(cache=True)
def widen(pieces: Array, mask: Array, depth: Array, reach: int, step_m: float, slope: float, pixel_m: float) -> None:
    """Give the rim of each mask to the nearest core pixel of the same mask, where the depths agree, in place.

    pieces  : (H, W) int32, > 0 on cores
    reach   : how far a rim is wide at most [px]
    A rim pixel at depth z, d pixels from its core pixel, agrees when the depths differ by less than
    step_m + slope · d · z · pixel_m, pixel_m being the width of a pixel at 1 m: the surface goes on, however slanted.
    """
    height, width = mask.shape
    source = np.full((height, width), -1, dtype=np.int32)
    away = np.full((height, width), 1 << 20, dtype=np.int32)
    for v in range(height):
        for u in range(width):
            if pieces[v, u]:
                source[v, u] = v * width + u
                away[v, u] = 0
            for n in range(4):
                a, b = (v, u - 1) if n == 0 else (v - 1, u - 1) if n == 1 else (v - 1, u) if n == 2 else (v - 1, u + 1)
                if a < 0 or b < 0 or b >= width or mask[a, b] != mask[v, u] or source[a, b] < 0:
                    continue
                cost = away[a, b] + (3 if n % 2 else 2)
                if cost < away[v, u]:
                    away[v, u], source[v, u] = cost, source[a, b]
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            for n in range(4):
                a, b = (v, u + 1) if n == 0 else (v + 1, u + 1) if n == 1 else (v + 1, u) if n == 2 else (v + 1, u - 1)
                if a >= height or b < 0 or b >= width or mask[a, b] != mask[v, u] or source[a, b] < 0:
                    continue
                cost = away[a, b] + (3 if n % 2 else 2)
                if cost < away[v, u]:
                    away[v, u], source[v, u] = cost, source[a, b]
    for v in range(height):
        for u in range(width):
            d = 0.5 * away[v, u]
            z = depth[v, u]
            if d == 0.0 or d > reach or not z > 0.0 or mask[v, u] == 0:
                continue
            a, b = source[v, u] // width, source[v, u] % width
            if abs(depth[a, b] - z) < step_m + slope * d * z * pixel_m:
                pieces[v, u] = pieces[a, b]
