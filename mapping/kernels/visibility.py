"""Which blocks does a depth image see? Coarse to fine, against a pyramid of lowest and highest depths.

After the projective tests of supereight2 (Funk et al., Multi-Resolution 3D Mapping With Explicit Free Space
Representation, RA-L 2021) and wavemap (Reijgwart et al., RSS 2023).

A *camera* is a (18,) float64 array: R_camera_map row by row, t_camera_map, fx, fy, cx, cy, width, height. A *reach*
image (H, W) float32 holds the depth z [m] up to which each pixel saw free space; negative where it ended at the range
limit and not at a surface; 0 where it says nothing.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

CELL = 8
"""Edge in pixels of the finest cells of the pyramid."""
LEVELS = 6
MIXED, FREE = 1, 2
"""Codes of a block: perhaps near a surface; wholly before every surface it covers."""


@njit(cache=True, error_model="numpy")
def measure_reach(depth: Array, camera: Array, max_range: Float, reach: Array) -> Float:
    """Turn a depth image (H, W) float32 [m] (0, NaN: nothing) into a reach image, in place; returns the largest."""
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    limit = np.float32(max_range)
    nothing = np.float32(0.0)
    farthest = np.float32(0.0)
    width = depth.shape[1]
    x_squared = np.empty(width, np.float32)
    for u in range(width):
        x_squared[u] = ((u - cx) / fx) ** 2
    for v in range(depth.shape[0]):
        y_squared = np.float32(1.0 + ((v - cy) / fy) ** 2)
        for u in range(width):  # no branches, so that it runs on vectors
            d = depth[v, u]
            end = limit / np.sqrt(y_squared + x_squared[u])
            reached = d if d <= end else -end
            reach[v, u] = reached if d > nothing else nothing
        for u in range(width):
            farthest = max(farthest, abs(reach[v, u]))
    return farthest


@njit(cache=True)
def build_pyramid(reach: Array, pyramid: Array) -> None:
    """Fill `pyramid` (LEVELS, ⌈H/CELL⌉, ⌈W/CELL⌉, 2) with the lowest and highest |reach| of each cell, in place.

    A pixel that says nothing counts as 0 for both.
    """
    height, width = reach.shape
    rows, columns = pyramid.shape[1], pyramid.shape[2]
    lows = np.empty(columns * CELL, np.float32)
    highs = np.empty(columns * CELL, np.float32)
    for r in range(rows):
        lows[:] = np.inf
        highs[:] = 0.0
        for v in range(r * CELL, min(r * CELL + CELL, height)):
            for u in range(width):
                d = abs(reach[v, u])
                lows[u] = d if d < lows[u] else lows[u]
                highs[u] = d if d > highs[u] else highs[u]
        for c in range(columns):
            low = lows[c * CELL]
            high = highs[c * CELL]
            for u in range(c * CELL + 1, c * CELL + CELL):
                low = min(low, lows[u])
                high = max(high, highs[u])
            pyramid[0, r, c, 0] = low
            pyramid[0, r, c, 1] = high
    for level in range(1, pyramid.shape[0]):
        below_rows, below_columns = rows, columns
        rows, columns = (rows + 1) >> 1, (columns + 1) >> 1
        for r in range(rows):
            for c in range(columns):
                low = np.float32(np.inf)
                high = np.float32(0.0)
                for v in range(2 * r, min(2 * r + 2, below_rows)):
                    for u in range(2 * c, min(2 * c + 2, below_columns)):
                        low = min(low, pyramid[level - 1, v, u, 0])
                        high = max(high, pyramid[level - 1, v, u, 1])
                pyramid[level, r, c, 0] = low
                pyramid[level, r, c, 1] = high


@njit(cache=True)
def depth_bounds(pyramid: Array, u0: Int, u1: Int, v0: Int, v1: Int) -> tuple[Float, Float]:
    """Lowest and highest |reach| over at least the pixels u0 … u1, v0 … v1 (inclusive, inside the image)."""
    size = max(u1 - u0, v1 - v0) + 1
    level = 0
    while level + 1 < pyramid.shape[0] and (CELL << level) * 4 < size:
        level += 1
    cell = CELL << level
    low = np.float32(np.inf)
    high = np.float32(0.0)
    for r in range(v0 // cell, v1 // cell + 1):
        for c in range(u0 // cell, u1 // cell + 1):
            low = min(low, pyramid[level, r, c, 0])
            high = max(high, pyramid[level, r, c, 1])
    return low, high


@njit(cache=True)
def classify_cell(
    pyramid: Array, camera: Array, x: Float, y: Float, z: Float, half: Float, front: Float, back: Float
) -> Int:
    """What the image says of the cube with centre x, y, z [m, camera frame] and half an edge [m], along the map's axes.

    front, back : how far [m] before and behind a surface counts as near it
    Returns 0 (not seen), MIXED or FREE; never wrongly 0 or FREE.
    """
    hx = half * (abs(camera[0]) + abs(camera[1]) + abs(camera[2]))
    hy = half * (abs(camera[3]) + abs(camera[4]) + abs(camera[5]))
    hz = half * (abs(camera[6]) + abs(camera[7]) + abs(camera[8]))
    z_low, z_high = z - hz, z + hz
    if z_high <= 0.0:
        return 0
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    width, height = camera[16], camera[17]
    # Outside one of the four side planes of the frustum: n · p > 0 for the whole cube.
    for side in range(4):
        axis = 0 if side < 2 else 3
        if side == 0:
            slope, sign = (-0.5 - cx) / fx, 1.0
        elif side == 1:
            slope, sign = (width - 0.5 - cx) / fx, -1.0
        elif side == 2:
            slope, sign = (-0.5 - cy) / fy, 1.0
        else:
            slope, sign = (height - 0.5 - cy) / fy, -1.0
        across = x if side < 2 else y
        extent = half * (
            abs(camera[axis] - slope * camera[6])
            + abs(camera[axis + 1] - slope * camera[7])
            + abs(camera[axis + 2] - slope * camera[8])
        )
        if sign * (across - slope * z) + extent < 0.0:
            return 0
    if z_low <= 1e-3:
        return MIXED
    x_low, x_high, y_low, y_high = x - hx, x + hx, y - hy, y + hy
    u_low = x_low / (z_low if x_low < 0.0 else z_high) * fx + cx
    u_high = x_high / (z_high if x_high < 0.0 else z_low) * fx + cx
    v_low = y_low / (z_low if y_low < 0.0 else z_high) * fy + cy
    v_high = y_high / (z_high if y_high < 0.0 else z_low) * fy + cy
    # A voxel takes the nearest pixel, hence the half; the hundredth is for rounding.
    u0, u1 = np.floor(u_low + 0.49), np.floor(u_high + 0.51)
    v0, v1 = np.floor(v_low + 0.49), np.floor(v_high + 0.51)
    inside = u0 >= 0.0 and v0 >= 0.0 and u1 <= width - 1.0 and v1 <= height - 1.0
    u0, u1 = max(u0, 0.0), min(u1, width - 1.0)
    v0, v1 = max(v0, 0.0), min(v1, height - 1.0)
    if u0 > u1 or v0 > v1:
        return 0
    low, high = depth_bounds(pyramid, np.int64(u0), np.int64(u1), np.int64(v0), np.int64(v1))
    if z_low - back > high or high == 0.0:
        return 0
    if inside and z_high + front < low:
        return FREE
    return MIXED


@njit(cache=True)
def list_blocks(
    pyramid: Array,
    camera: Array,
    roots: Array,
    root_level: Int,
    block_size: Float,
    front: Float,
    back: Float,
    with_free: bool,
    blocks: Array,
    kinds: Array,
) -> Int:
    """List the blocks that the image sees, depth first below each root: their index and kind, in place.

    roots (r, 3) int64 are cells of 2^root_level blocks along an edge.

    blocks (n, 3) int32, kinds (n,) uint8. Returns how many there are; beyond n they are counted and not written.
    """
    stack = np.empty((8 * root_level + 1, 4), np.int64)
    count = 0
    for root in range(roots.shape[0]):
        stack[0, 0], stack[0, 1], stack[0, 2] = roots[root, 0], roots[root, 1], roots[root, 2]
        stack[0, 3] = root_level
        top = 1
        while top > 0:
            top -= 1
            i, j, k, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            edge = block_size * (1 << level)
            a, b, c = (i + 0.5) * edge, (j + 0.5) * edge, (k + 0.5) * edge
            x = camera[0] * a + camera[1] * b + camera[2] * c + camera[9]
            y = camera[3] * a + camera[4] * b + camera[5] * c + camera[10]
            z = camera[6] * a + camera[7] * b + camera[8] * c + camera[11]
            kind = classify_cell(pyramid, camera, x, y, z, 0.5 * edge, front, back)
            if kind == 0 or (kind == FREE and not with_free):
                continue
            if level > 0 and kind == MIXED:
                for child in range(8):
                    stack[top, 0] = 2 * i + (child >> 2)
                    stack[top, 1] = 2 * j + ((child >> 1) & 1)
                    stack[top, 2] = 2 * k + (child & 1)
                    stack[top, 3] = level - 1
                    top += 1
                continue
            span = 1 << level
            for di in range(span):
                for dj in range(span):
                    for dk in range(span):
                        if count < blocks.shape[0]:
                            blocks[count, 0] = i * span + di
                            blocks[count, 1] = j * span + dj
                            blocks[count, 2] = k * span + dk
                            kinds[count] = kind
                        count += 1
    return count
