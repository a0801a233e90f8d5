"""Image kernels: depth images ⇄ points, and one camera's image as another camera's pixels.

A *camera* is a (6,) float64 array: fx, fy, cx, cy, width, height. A pose is (12,) float64: the rotation row by row,
then the translation [m].
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MOST_SIGMA = 3.0
"""Pixels beside each other are of one surface when their mean is no more σ of the depth away."""
MEDIAN_BEND = 1.652
"""Median of |p + q − 2z| where p, q and z differ by normal noise of σ = 1: 0.6745 √6."""
LEAST_BENDS = 100
FOOTPRINT = 1.25
"""A pixel of depth covers its share of the other image and a quarter more, for surfaces that the other camera sees
less aslant."""


@njit(cache=True)
def translate(labels: Array, table: Array, translated: Array) -> Int:
    """Name labels (n,) by a table: fills translated (n,). Returns how many labels other than 0 it calls 0."""
    unknown: Int = 0
    for n in range(labels.shape[0]):
        name = table[labels[n]]
        translated[n] = name
        unknown += np.int64((name == 0) & (labels[n] != 0))
    return unknown


@njit(cache=True, error_model="numpy")
def lift_depth(depth: Array, camera: Array, points: Array) -> Int:
    """The point (x, y, z) [m, optical frame] of each pixel of depth (H, W) float32 [m] that measured something, row by
    row.

    points : (H · W, 3) float32, filled in place from the start. Returns how many there are.
    """
    per_x, per_y = np.float32(1.0 / camera[0]), np.float32(1.0 / camera[1])
    cx, cy = np.float32(camera[2]), np.float32(camera[3])
    count: Int = 0
    for v in range(depth.shape[0]):
        y = (np.float32(v) - cy) * per_y
        for u in range(depth.shape[1]):
            z = depth[v, u]
            points[count, 0] = (np.float32(u) - cx) * per_x * z
            points[count, 1] = y * z
            points[count, 2] = z
            count += np.int64((z > np.float32(0.0)) & (z < np.float32(np.inf)))
    return count


@njit(cache=True, error_model="numpy")
def drop_points(points: Array, camera: Array, depth: Array, index: Array) -> None:
    """The depth image (H, W) float32 [m] that a camera at the origin sees of points (n, 3) float64 [m, optical frame].

    depth, index : (H, W), filled: the nearest point of each pixel, 0 and −1 where there is none; of points at the same
                   depth the last counts
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    depth[:] = 0.0
    index[:] = -1
    for n in range(points.shape[0]):
        z = points[n, 2]
        if not 0.0 < z < np.inf:
            continue
        column = np.floor(points[n, 0] / z * fx + cx + 0.5)
        row = np.floor(points[n, 1] / z * fy + cy + 0.5)
        if not (0.0 <= column < camera[4] and 0.0 <= row < camera[5]):
            continue
        u, v = np.int64(column), np.int64(row)
        if index[v, u] < 0 or z <= points[index[v, u], 2]:
            depth[v, u] = z
            index[v, u] = n


@njit(cache=True, parallel=True, error_model="numpy")
def look_from(depth: Array, camera: Array, pose: Array, other: Array, seen: Array) -> None:
    """Where each pixel of a depth image (H, W) float32 [m] lies in the image of another camera.

    pose : of this camera in the other's frame
    seen : (H, W, 3) float32, filled: column, row and depth [m] in the other camera; depth 0 where this camera measured
           nothing or the point lies outside the other's image
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    for v in prange(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = np.float64(depth[v, u])
            x, y = (u - cx) / fx * d, (v - cy) / fy * d
            z = pose[6] * x + pose[7] * y + pose[8] * d + pose[11]
            column = (pose[0] * x + pose[1] * y + pose[2] * d + pose[9]) / z * other[0] + other[2]
            row = (pose[3] * x + pose[4] * y + pose[5] * d + pose[10]) / z * other[1] + other[3]
            inside = 0.0 < d < np.inf and z > 0.0
            inside = inside and -0.5 <= column < other[4] - 0.5 and -0.5 <= row < other[5] - 0.5
            seen[v, u, 0] = column if inside else 0.0
            seen[v, u, 1] = row if inside else 0.0
            seen[v, u, 2] = z if inside else 0.0


@njit(cache=True, error_model="numpy")
def cover(depth: Array, seen: Array, magnify_x: Float, magnify_y: Float, nearest: Array) -> None:
    """How near the surfaces are that cover each pixel of the other camera, in place.

    seen                 : (H, W, 3) float32 as `look_from` gives it, for depth (H, W) float32 [m]
    magnify_x, magnify_y : pixels of the other image for one of this, at equal depth
    nearest              : (h, w) float32, lowered to the depth [m] in the other camera of what covers the pixel
    """
    height, width = nearest.shape
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = seen[v, u, 2]
            if z == np.float32(0.0):
                continue
            reach = 0.5 * FOOTPRINT * depth[v, u] / z
            column, row = seen[v, u, 0], seen[v, u, 1]
            column0 = np.int64(np.ceil(max(column - reach * magnify_x, 0.0)))
            column1 = np.int64(np.floor(min(column + reach * magnify_x, width - 1.0)))
            row0 = np.int64(np.ceil(max(row - reach * magnify_y, 0.0)))
            row1 = np.int64(np.floor(min(row + reach * magnify_y, height - 1.0)))
            for j in range(row0, row1 + 1):
                for i in range(column0, column1 + 1):
                    nearest[j, i] = min(nearest[j, i], z)


@njit(cache=True, parallel=True)
def pick_colors(seen: Array, nearest: Array, tolerance: Float, color: Array, picked: Array, valid: Array) -> None:
    """The colour of each pixel of depth, between the four pixels of `color` (h, w, 3) uint8 about it.

    seen, nearest : as `look_from` and `cover` give them; farther than (1 + tolerance) · nearest is hidden
    picked, valid : (H, W, 3) uint8 and (H, W) bool, filled; black where not valid
    """
    height, width = nearest.shape
    half, most = np.float32(0.5), np.float32(1.0 + tolerance)
    right_most, lowest = np.float32(width - 1), np.float32(height - 1)
    for v in prange(seen.shape[0]):
        for u in range(seen.shape[1]):
            # Within half a pixel beyond the outermost ones, those count.
            column = min(max(seen[v, u, 0], np.float32(0.0)), right_most)
            row = min(max(seen[v, u, 1], np.float32(0.0)), lowest)
            z = seen[v, u, 2]
            visible = z > np.float32(0.0) and z <= nearest[np.int64(row + half), np.int64(column + half)] * most
            valid[v, u] = visible
            i, j = np.int64(column), np.int64(row)
            right, below = min(i + 1, width - 1), min(j + 1, height - 1)
            a, b = column - np.float32(i), row - np.float32(j)
            for c in range(3):
                first, second = np.float32(color[j, i, c]), np.float32(color[below, i, c])
                upper = first + (np.float32(color[j, right, c]) - first) * a
                lower = second + (np.float32(color[below, right, c]) - second) * a
                mixed = upper + (lower - upper) * b + half
                picked[v, u, c] = np.uint8(mixed) if visible else np.uint8(0)


@njit(cache=True)
def pick_pixels(seen: Array, nearest: Array, tolerance: Float, index: Array) -> None:
    """Which pixel of another camera's image (h, w) each pixel of depth is nearest to, in place.

    seen, nearest : as for `pick_colors`
    index         : (H, W) int32, row · w + column; −1 where it is hidden, outside or not measured
    """
    height, width = nearest.shape
    for v in range(seen.shape[0]):
        for u in range(seen.shape[1]):
            z = seen[v, u, 2]
            i = min(max(np.int64(np.floor(seen[v, u, 0] + np.float32(0.5))), 0), width - 1)
            j = min(max(np.int64(np.floor(seen[v, u, 1] + np.float32(0.5))), 0), height - 1)
            index[v, u] = j * width + i if z > 0.0 and z <= nearest[j, i] * (1.0 + tolerance) else -1


@njit(cache=True)
def cut_off(depth: Array, range_m: Float, near: Array) -> None:
    """What of a depth image (H, W) float32 [m] is nearer than that, filled into near (H, W) float32; 0 elsewhere."""
    most, zero = np.float32(range_m), np.float32(0.0)
    for v in range(depth.shape[0]):
        row, out = depth[v], near[v]
        for u in range(depth.shape[1]):
            out[u] = row[u] if row[u] < most else zero


@njit(cache=True)
def noise_share(depth: Array, noise_base: Float, noise_growth: Float, step: Int) -> float:
    """How noisy a depth image is, as a share of the σ of its sensor: the median second difference of rows, over what
    noise of σ makes of it; 1 at most, and where there are too few pixels to tell.

    depth (H, W) float32 [m], 0 = nothing; every `step`-th row and column is looked at. Noise as for `smooth_depth`.
    """
    height, width = depth.shape
    bends = np.empty((height // step + 1) * (width // step + 1), np.float32)
    n = 0
    for v in range(step // 2, height, step):
        for u in range(1 + step // 2, width - 1, step):
            p, z, q = depth[v, u - 1], depth[v, u], depth[v, u + 1]
            if p > 0.0 and z > 0.0 and q > 0.0:
                sigma = noise_base + noise_growth * (z - 0.4) * (z - 0.4)
                bends[n] = abs(p + q - np.float32(2.0) * z) / sigma
                n += 1
    return min(1.0, float(np.median(bends[:n])) / MEDIAN_BEND) if n >= LEAST_BENDS else 1.0


@njit(cache=True, error_model="numpy")
def smooth_depth(depth: Array, noise_base: Float, noise_growth: Float, smooth: Array) -> None:
    """The mean of each pixel's depth and those about it that lie on its surface, filled into smooth (H, W) float32.

    depth (H, W) float32 [m], 0 = nothing. Noise σ(z) = noise_base + noise_growth · (z − 0.4)² [m]. The eight pixels
    around count in pairs that face each other, where both measured something and their mean differs from the depth
    by less than MOST_SIGMA · σ: so a slant does not shift the mean, and the far side of an edge has no part in it.
    """
    height, width = depth.shape
    base, growth, zero = np.float32(noise_base * MOST_SIGMA), np.float32(noise_growth * MOST_SIGMA), np.float32(0.0)
    two, near = np.float32(2.0), np.float32(0.4)
    smooth[0], smooth[height - 1] = depth[0], depth[height - 1]
    for v in range(1, height - 1):
        above, here, below, out = depth[v - 1], depth[v], depth[v + 1], smooth[v]
        out[0], out[width - 1] = here[0], here[width - 1]
        for u in range(1, width - 1):  # no branches, so that it runs on vectors
            z = here[u]
            limit = two * (base + growth * (z - near) * (z - near))
            total, n = z, np.float32(1.0)
            for p, q in (
                (here[u - 1], here[u + 1]),
                (above[u], below[u]),
                (above[u - 1], below[u + 1]),
                (above[u + 1], below[u - 1]),
            ):
                fits = (abs(p + q - two * z) < limit) & (p > zero) & (q > zero)
                total += p + q if fits else zero
                n += two if fits else zero
            out[u] = total / n if z > zero else zero
