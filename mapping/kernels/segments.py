"""From a segmented depth image to connected pieces of surface, without the boundary-pixel error.

A mask that bleeds over its object's edge lies, beyond the edge, on another surface: the depth jumps there. Pieces are
the 4-connected components of one mask's core over which the depth does not jump, and what of its rim fits them.

A *mask* image (H, W) int32 numbers the masks of things in an image from 1; pixels of the background have minus their
label, 0 where they have none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.forest import root_of

Array = NDArray[Any]

CORE_PX = 16  # distances to the mask's boundary are counted up to here


@njit(cache=True)
def _row_of(key: int, keys: Array) -> int:
    """The row of a hash table (size,) in which a key ≠ 0 stands or, where it is 0, may be entered."""
    row = (key * 0x9E3779B1 >> 7) & (len(keys) - 1)
    while keys[row] != key and keys[row] != 0:
        row = (row + 1) & (len(keys) - 1)
    return row


@njit(cache=True)
def number_masks(mask: Array, labels: Array, instances: Array, things: Array) -> Array:
    """Number the masks in order of appearance, in place; returns what they are (n + 1,) int64, the first being 0.

    mask   : (H, W) int32, filled;  labels (H, W) uint16; instances (H, W) uint32
    things : (65536,) bool: labels of which a pixel without an instance is a thing's too

    A mask is instance << 16 | label; an instance 0 is none.
    """
    height, width = labels.shape
    size = 1024
    keys, numbers, names = np.zeros(size, np.int64), np.zeros(size, np.int32), np.zeros(size, np.int64)
    n = 1
    last_label, last_instance, last = np.uint16(0), np.uint32(0), np.int32(0)
    for v in range(height):
        if 2 * (n + width) > size:  # there may be as many more
            while 2 * (n + width) > size:
                size *= 2
            keys, numbers = np.zeros(size, np.int64), np.zeros(size, np.int32)
            for m in range(1, n):
                row = _row_of(names[m], keys)
                keys[row], numbers[row] = names[m], m
            names = np.concatenate((names[:n], np.zeros(size, np.int64)))
        for u in range(width):
            label, instance = labels[v, u], instances[v, u]
            if label != last_label or instance != last_instance:
                last_label, last_instance, last = label, instance, np.int32(-np.int32(label))
                if instance != 0 or (label != 0 and things[label]):
                    key = np.int64(instance) << 16 | np.int64(label)
                    row = _row_of(key, keys)
                    if keys[row] == 0:
                        keys[row], numbers[row], names[n] = key, n, key
                        n += 1
                    last = numbers[row]
            mask[v, u] = last
    return names[:n].copy()


@njit(cache=True)
def mask_depths(mask: Array, distance: Array) -> None:
    """Distance of every pixel to the nearest pixel of another mask, in place.

    mask     : (H, W) int32, 0 = none
    distance : (H, W) uint8 [px], city-block, capped at CORE_PX; 0 outside masks. The image's edge is no boundary.

    Along rows first, by the ends of each run of equal pixels; then down and up the columns, all of a row at once.
    """
    height, width = mask.shape
    far = np.uint8(CORE_PX)
    for v in range(height):
        u = 0
        while u < width:
            end = u + 1
            while end < width and mask[v, end] == mask[v, u]:
                end += 1
            distance[v, u:end] = far if mask[v, u] != 0 else np.uint8(0)
            if mask[v, u] != 0:
                for k in range(min(CORE_PX, end - u)):
                    if u > 0:
                        distance[v, u + k] = min(distance[v, u + k], k + 1)
                    if end < width:
                        distance[v, end - 1 - k] = min(distance[v, end - 1 - k], k + 1)
            u = end
    for v in range(1, height):
        _carry(mask[v - 1], distance[v - 1], mask[v], distance[v])
    for v in range(height - 2, -1, -1):
        _carry(mask[v + 1], distance[v + 1], mask[v], distance[v])


@njit(cache=True)
def _carry(mask_beside: Array, distance_beside: Array, mask: Array, distance: Array) -> None:
    """Shorten the distances of a row, in place, by those of the row beside it, one step away."""
    one = np.uint8(1)
    for u in range(len(mask)):  # no branches and bytes only, so that it runs on vectors
        step = np.uint8(distance_beside[u] + one)
        step = step if mask_beside[u] == mask[u] else one
        distance[u] = step if step < distance[u] else distance[u]


@njit(cache=True)
def find_cores(mask: Array, distance: Array, least: Array, core: Array) -> None:
    """The inner part of each mask, in place: what lies deeper than the middle of the mask there asks for.

    mask     : (H, W) int32, > 0 on masks; distance (H, W) uint8 [px] from their boundary
    least    : (2 · CORE_PX + 1,) uint8 [px]: core pixels are deeper than this, by the peak around them
    core     : (H, W) int32, filled: the mask where a pixel is of its core, else 0

    The peak [half pixels] is how deep the mask is around a pixel: the largest of 2 · distance(q) − steps from q along
    the mask, in two raster sweeps as for a chamfer distance (Borgefors 1986).
    """
    height, width = mask.shape
    peak = np.empty((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            m = mask[v, u]
            if m <= 0:
                continue
            best = 2 * int(distance[v, u])
            if u > 0 and mask[v, u - 1] == m:
                best = max(best, int(peak[v, u - 1]) - 1)
            if v > 0:
                if mask[v - 1, u] == m:
                    best = max(best, int(peak[v - 1, u]) - 1)
                if u > 0 and mask[v - 1, u - 1] == m:
                    best = max(best, int(peak[v - 1, u - 1]) - 1)
                if u + 1 < width and mask[v - 1, u + 1] == m:
                    best = max(best, int(peak[v - 1, u + 1]) - 1)
            peak[v, u] = best
    for v in range(height - 1, -1, -1):
        for u in range(width - 1, -1, -1):
            m = mask[v, u]
            core[v, u] = 0
            if m <= 0:
                continue
            best = int(peak[v, u])
            if u + 1 < width and mask[v, u + 1] == m:
                best = max(best, int(peak[v, u + 1]) - 1)
            if v + 1 < height:
                if mask[v + 1, u] == m:
                    best = max(best, int(peak[v + 1, u]) - 1)
                if u + 1 < width and mask[v + 1, u + 1] == m:
                    best = max(best, int(peak[v + 1, u + 1]) - 1)
                if u > 0 and mask[v + 1, u - 1] == m:
                    best = max(best, int(peak[v + 1, u - 1]) - 1)
            peak[v, u] = best
            if distance[v, u] > least[best]:
                core[v, u] = m


@njit(cache=True)
def connect(core: Array, depth: Array, step_m: float, step_share: float, pieces: Array) -> int:
    """Number the connected pieces of all cores, in place; returns how many there are.

    core   : (H, W) int32, 0 = none
    depth  : (H, W) float32 [m], 0 = not measured
    pieces : (H, W) int32, filled: 1 … n, 0 where there is no core or no depth

    Neighbours belong together when their depths differ by less than step_m + step_share · depth.
    """
    height, width = core.shape
    parent = np.empty(height * width // 2 + 2, dtype=np.int32)
    n = 0
    for v in range(height):
        for u in range(width):
            pieces[v, u] = 0
            m, z = core[v, u], depth[v, u]
            if m == 0 or not z > 0.0:
                continue
            limit = step_m + step_share * z
            left = up = 0
            if u > 0 and pieces[v, u - 1] and core[v, u - 1] == m and abs(depth[v, u - 1] - z) < limit:
                left = root_of(parent, pieces[v, u - 1])
            if v > 0 and pieces[v - 1, u] and core[v - 1, u] == m and abs(depth[v - 1, u] - z) < limit:
                up = root_of(parent, pieces[v - 1, u])
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
        root = root_of(parent, i)  # the lowest of its piece, and so numbered before
        if root == i:
            found += 1
            number[i] = found
        else:
            number[i] = number[root]
    for v in range(height):
        for u in range(width):
            if pieces[v, u]:
                pieces[v, u] = number[pieces[v, u]]
    return found


@njit(cache=True)
def measure_pieces(
    mask: Array, distance: Array, depth: Array, pieces: Array, of_mask: Array, centrality: Array, mean_depth: Array
) -> None:
    """Sum up every piece, in place.

    of_mask    : (n,) int32, the mask that a piece belongs to
    centrality : (n,) float64 of zeros, Σ distance²: large where the middle of the mask is
    mean_depth : (n,) float64 of zeros [m]
    """
    height, width = mask.shape
    pixels = np.zeros(len(of_mask), np.int64)
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
def widen(
    pieces: Array,
    pixels: Array,
    group: Array,
    mask: Array,
    depth: Array,
    reach: int,
    step_m: float,
    slope: float,
    pixel_m: float,
) -> None:
    """Make pieces one that belong to one thing, and give them the rims of their masks where depths agree, in place.

    pieces  : (H, W) int32, > 0 on cores
    pixels  : (n_groups + 1,) int64 of zeros: the size of each group, that of 0 left out
    group   : (n_pieces + 1,) int32: what becomes of each piece, 0 = none
    reach   : how far a rim is wide at most [px]

    The nearest core pixel along the same mask decides, by a chamfer distance of 1 and 1.5 in two raster sweeps. A rim
    pixel at depth z, d pixels from it, agrees when depths differ by less than step_m + slope · d · z · pixel_m, pixel_m
    being the width of a pixel at 1 m: the surface goes on, however slanted.
    """
    height, width = mask.shape
    source = np.empty((height, width), np.int32)
    away = np.empty((height, width), np.int32)
    rim = np.empty(height * width, np.int32)
    n = 0
    for v in range(height):
        for u in range(width):
            if mask[v, u] <= 0:
                continue
            piece = group[pieces[v, u]]
            pieces[v, u] = piece
            if piece:
                pixels[piece] += 1
                source[v, u], away[v, u] = v * width + u, 0
            else:
                source[v, u], away[v, u] = -1, 1 << 20
                rim[n] = v * width + u
                n += 1
    for sweep in range(2):
        back = 1 - 2 * sweep  # towards what the sweep has been at before
        for k in range(n):
            at = rim[k] if sweep == 0 else rim[n - 1 - k]
            v, u = at // width, at % width
            m, best, nearest = mask[v, u], away[v, u], source[v, u]
            for way in range(4):
                a, b = (v, u - back) if way == 0 else (v - back, u + (way - 2) * back)
                if a < 0 or a >= height or b < 0 or b >= width or mask[a, b] != m or source[a, b] < 0:
                    continue
                cost = away[a, b] + (2 if way % 2 == 0 else 3)
                if cost < best:
                    best, nearest = cost, source[a, b]
            away[v, u], source[v, u] = best, nearest
    for k in range(n):
        v, u = rim[k] // width, rim[k] % width
        d, z = 0.5 * away[v, u], depth[v, u]
        if d > reach or not z > 0.0:
            continue
        a, b = source[v, u] // width, source[v, u] % width
        if abs(depth[a, b] - z) < step_m + slope * d * z * pixel_m:
            pieces[v, u] = pieces[a, b]
            pixels[pieces[v, u]] += 1


@njit(cache=True)
def believe(
    pieces: Array,
    labels: Array,
    trust: Array,
    number: Array,
    class_of: Array,
    mask: Array,
    depth: Array,
    distance: Array,
    rim_px: float,
    doubtful: Array,
    doubt: float,
) -> None:
    """Say what each pixel is and how far it is to be trusted, in place.

    pieces     : (H, W) int32, renumbered by `number` (n_groups + 1,) int32
    labels     : (H, W) uint16, filled: where there is depth, of the background and of the masks of pieces, by
                 `class_of` (n_masks + 1,) uint16; 0 elsewhere
    trust      : (H, W) float32, filled: full where `distance` (H, W) uint8 [px] is rim_px, less at boundaries; times
                 `doubt` where `doubtful` (H, W) uint8
    """
    height, width = mask.shape
    per_px, one, less = np.float32(1.0 / rim_px), np.float32(1.0), np.float32(doubt)
    for v in range(height):
        for u in range(width):
            m = mask[v, u]
            label = np.uint16(0)
            if m > 0:
                piece = number[pieces[v, u]]
                pieces[v, u] = piece
                if piece > 0:
                    label = class_of[m]
            else:
                label = np.uint16(-m)
            labels[v, u] = label if depth[v, u] > 0.0 else np.uint16(0)
        deep, odd, sure = distance[v], doubtful[v], trust[v]
        for u in range(width):  # no branches, so that it runs on vectors
            full = np.float32(deep[u]) * per_px
            full = full if full < one else one
            sure[u] = full * (less if odd[u] else one)


@njit(cache=True, error_model="numpy")
def weigh(
    pieces: Array, trust: Array, depth: Array, n_pieces: int, depth_noise: float, voxel: float, weights: Array
) -> None:
    """What each pixel's vote for a voxel weighs, filled into weights (H, W) float32.

    pieces (H, W) int32: 1 … n_pieces, 0 = none; trust (H, W) float32 in 0 … 1
    depth  (H, W) float32 [m] with a standard deviation σ = depth_noise · depth²; voxel: edge [m]

    most · (trust / most)⁶ / (1 + (2σ / voxel)²), with the most trust that any pixel of its piece has (without one: 1).
    """
    height, width = depth.shape
    most = np.zeros(n_pieces + 1, np.float32)
    for v in range(height):
        for u in range(width):
            piece = pieces[v, u]
            if piece and trust[v, u] > most[piece]:
                most[piece] = trust[v, u]
    most[0] = np.float32(1.0)
    per_most = np.float32(1.0) / np.maximum(most, np.float32(1e-9))
    spread, one = np.float32((2.0 * depth_noise / voxel) ** 2), np.float32(1.0)
    full, per_full = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        of, sure, z, out = pieces[v], trust[v], depth[v], weights[v]
        for u in range(width):
            full[u], per_full[u] = most[of[u]], per_most[of[u]]
        for u in range(width):  # no branches and no tables, so that it runs on vectors
            share = sure[u] * per_full[u]
            cube = share * share * share
            square = z[u] * z[u]
            out[u] = full[u] * cube * cube / (one + spread * square * square)
