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
def measure_reach(depth: Array, camera: Array, max_range: Float, reach: Array) -> None:
    """Turn a depth image (H, W) float32 [m] (0, NaN: nothing) into a reach image, in place."""
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    limit = np.float32(max_range)
    nothing = np.float32(0.0)
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


@njit(inline="always")
def least(a: Float, b: Float) -> Float:
    """The lower number, in the form that becomes one instruction."""
    return a if a < b else b


@njit(inline="always")
def most(a: Float, b: Float) -> Float:
    """The higher number, in the form that becomes one instruction."""
    return a if a > b else b


@njit(cache=True)
def build_pyramid(reach: Array, pyramid: Array) -> Float:
    """Fill `pyramid` (LEVELS, ⌈H/CELL⌉, ⌈W/CELL⌉, 4), in place; returns the highest |reach| of all.

    For each cell: the lowest and highest |reach|, for which a pixel that says nothing counts as 0, and the lowest and
    highest depth of a surface, ∞ and 0 where there is none.
    """
    height, width = reach.shape
    rows, columns = pyramid.shape[1], pyramid.shape[2]
    none = np.float32(np.inf)
    zero = np.float32(0.0)
    bounds = np.empty((4, columns * CELL), np.float32)
    bounds[0::2] = none
    bounds[1::2] = zero
    lows, highs, nears, fars = bounds[0], bounds[1], bounds[2], bounds[3]
    for r in range(rows):
        last = height - 1  # all eight rows at once, so that it runs on vectors; those below the image are its last
        p0, p1 = reach[min(r * CELL, last)], reach[min(r * CELL + 1, last)]
        p2, p3 = reach[min(r * CELL + 2, last)], reach[min(r * CELL + 3, last)]
        p4, p5 = reach[min(r * CELL + 4, last)], reach[min(r * CELL + 5, last)]
        p6, p7 = reach[min(r * CELL + 6, last)], reach[min(r * CELL + 7, last)]
        for u in range(width):
            a, b, c, d = abs(p0[u]), abs(p1[u]), abs(p2[u]), abs(p3[u])
            e, f, g, h = abs(p4[u]), abs(p5[u]), abs(p6[u]), abs(p7[u])
            lows[u] = least(least(least(a, b), least(c, d)), least(least(e, f), least(g, h)))
            highs[u] = most(most(most(a, b), most(c, d)), most(most(e, f), most(g, h)))
        for u in range(width):
            a, b, c, d, e, f, g, h = p0[u], p1[u], p2[u], p3[u], p4[u], p5[u], p6[u], p7[u]
            fars[u] = most(most(most(most(a, b), most(c, d)), most(most(e, f), most(g, h))), zero)
            a, b = a if a > zero else none, b if b > zero else none
            c, d = c if c > zero else none, d if d > zero else none
            e, f = e if e > zero else none, f if f > zero else none
            g, h = g if g > zero else none, h if h > zero else none
            nears[u] = least(least(least(a, b), least(c, d)), least(least(e, f), least(g, h)))
        for c in range(columns):
            first = c * CELL
            low, high, near, far = lows[first], highs[first], nears[first], fars[first]
            for u in range(first + 1, first + CELL):
                low, high = least(low, lows[u]), most(high, highs[u])
                near, far = least(near, nears[u]), most(far, fars[u])
            pyramid[0, r, c, 0] = low
            pyramid[0, r, c, 1] = high
            pyramid[0, r, c, 2] = near
            pyramid[0, r, c, 3] = far
    for level in range(1, pyramid.shape[0]):
        below_rows, below_columns = rows, columns
        rows, columns = (rows + 1) >> 1, (columns + 1) >> 1
        for r in range(rows):
            for c in range(columns):
                low, high, near, far = none, zero, none, zero
                for v in range(2 * r, min(2 * r + 2, below_rows)):
                    for u in range(2 * c, min(2 * c + 2, below_columns)):
                        below = pyramid[level - 1, v, u]
                        low, high = least(low, below[0]), most(high, below[1])
                        near, far = least(near, below[2]), most(far, below[3])
                pyramid[level, r, c, 0] = low
                pyramid[level, r, c, 1] = high
                pyramid[level, r, c, 2] = near
                pyramid[level, r, c, 3] = far
    highest = zero
    for r in range(rows):
        for c in range(columns):
            highest = most(highest, pyramid[pyramid.shape[0] - 1, r, c, 1])
    return highest


@njit(cache=True)
def judge_pixels(
    pyramid: Array, u0: Int, u1: Int, v0: Int, v1: Int, z_low: Float, z_high: Float
) -> tuple[bool, bool, bool]:
    """What at least the pixels u0 … u1, v0 … v1 (inclusive, inside the image) say of the depths z_low … z_high [m].

    Returns whether a surface may lie there, whether some pixel reaches z_low, and whether all reach beyond z_high.
    """
    size = max(u1 - u0, v1 - v0) + 1
    level = 0
    while level + 1 < pyramid.shape[0] and (CELL << level) * 4 < size:
        level += 1
    shift = level + 3
    surface = reached = False
    beyond = True
    for r in range(v0 >> shift, (v1 >> shift) + 1):
        for c in range(u0 >> shift, (u1 >> shift) + 1):
            low, high = pyramid[level, r, c, 0], pyramid[level, r, c, 1]
            near, far = pyramid[level, r, c, 2], pyramid[level, r, c, 3]
            surface |= (far >= z_low) & (near <= z_high) & (far > 0.0)
            reached |= (high >= z_low) & (high > 0.0)
            beyond &= low > z_high
        if surface and reached and not beyond:
            break
    return surface, reached, beyond


@njit(cache=True)
def measure_cube(camera: Array, half: Float, extents: Array) -> None:
    """How far a cube with half an edge [m], along the map's axes, extends from its centre, in place.

    extents : (7,) [m] along x, y, z of the camera, and across the left, right, upper and lower side of the frustum
    """
    fx, fy, cx, cy, width, height = camera[12], camera[13], camera[14], camera[15], camera[16], camera[17]
    for axis in range(3):
        extents[axis] = half * (abs(camera[3 * axis]) + abs(camera[3 * axis + 1]) + abs(camera[3 * axis + 2]))
    slopes = ((-0.5 - cx) / fx, (width - 0.5 - cx) / fx, (-0.5 - cy) / fy, (height - 0.5 - cy) / fy)
    for side in range(4):
        axis = 0 if side < 2 else 3
        extents[3 + side] = half * (
            abs(camera[axis] - slopes[side] * camera[6])
            + abs(camera[axis + 1] - slopes[side] * camera[7])
            + abs(camera[axis + 2] - slopes[side] * camera[8])
        )


@njit(cache=True, error_model="numpy")
def classify_cell(
    pyramid: Array,
    camera: Array,
    x: Float,
    y: Float,
    z: Float,
    extents: Array,
    front: Float,
    back: Float,
    gaps_are_free: bool,
) -> Int:
    """What the image says of the cube with centre x, y, z [m, camera frame] and the `extents` of `measure_cube`.

    front, back   : how far [m] before and behind a surface counts as near it
    gaps_are_free : whether FREE may also be what is covered in part by pixels that say nothing or by none, or what lies
                    behind some surface and far before another
    Returns 0 (not seen), MIXED or FREE; never wrongly 0 or FREE.
    """
    z_low, z_high = z - extents[2], z + extents[2]
    if z_high <= 0.0:
        return 0
    fx, fy, cx, cy, width, height = camera[12], camera[13], camera[14], camera[15], camera[16], camera[17]
    # Outside one of the four side planes of the frustum: n · p > 0 for the whole cube.
    if (
        x - (-0.5 - cx) / fx * z + extents[3] < 0.0
        or (width - 0.5 - cx) / fx * z - x + extents[4] < 0.0
        or y - (-0.5 - cy) / fy * z + extents[5] < 0.0
        or (height - 0.5 - cy) / fy * z - y + extents[6] < 0.0
    ):
        return 0
    if z_low <= 1e-3:
        return MIXED
    x_low, x_high, y_low, y_high = x - extents[0], x + extents[0], y - extents[1], y + extents[1]
    per_low, per_high = 1.0 / z_low, 1.0 / z_high
    u_low = x_low * (per_low if x_low < 0.0 else per_high) * fx + cx
    u_high = x_high * (per_high if x_high < 0.0 else per_low) * fx + cx
    v_low = y_low * (per_low if y_low < 0.0 else per_high) * fy + cy
    v_high = y_high * (per_high if y_high < 0.0 else per_low) * fy + cy
    # A voxel takes the nearest pixel, hence the half; the hundredth is for rounding.
    u0, u1 = np.floor(u_low + 0.49), np.floor(u_high + 0.51)
    v0, v1 = np.floor(v_low + 0.49), np.floor(v_high + 0.51)
    inside = u0 >= 0.0 and v0 >= 0.0 and u1 <= width - 1.0 and v1 <= height - 1.0
    u0, u1 = max(u0, 0.0), min(u1, width - 1.0)
    v0, v1 = max(v0, 0.0), min(v1, height - 1.0)
    if u0 > u1 or v0 > v1:
        return 0
    near_surface, reached, beyond = judge_pixels(
        pyramid, np.int64(u0), np.int64(u1), np.int64(v0), np.int64(v1), z_low - back, z_high + front
    )
    if not reached:
        return 0
    if (not near_surface) if gaps_are_free else (inside and beyond):
        return FREE
    return MIXED


@njit(cache=True)
def list_roots(
    camera: Array, pose: Array, z: Float, block_size: Float, along_axis: Int, roots: Array
) -> tuple[Int, Int]:
    """List the cells of 2^level blocks along an edge that the box about the frustum up to depth z [m] meets, in place.

    pose       : (12,) R_map_camera row by row, then t_map_camera
    along_axis : the level is the lowest at which the box's longest edge is no longer than so many cells
    roots      : (r, 3) int64, r ≥ (along_axis + 2)³. Returns how many there are, and the level.
    """
    low, high = pose[9:].copy(), pose[9:].copy()
    for corner in range(4):
        x = z * ((camera[16] - 0.5 if corner & 1 else -0.5) - camera[14]) / camera[12]
        y = z * ((camera[17] - 0.5 if corner & 2 else -0.5) - camera[15]) / camera[13]
        for axis in range(3):
            p = pose[3 * axis] * x + pose[3 * axis + 1] * y + pose[3 * axis + 2] * z + pose[9 + axis]
            low[axis], high[axis] = min(low[axis], p), max(high[axis], p)
    longest = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    level = 0
    while along_axis * block_size * (1 << level) < longest:
        level += 1
    edge = block_size * (1 << level)
    count = 0
    for i in range(np.int64(np.floor(low[0] / edge)), np.int64(np.floor(high[0] / edge)) + 1):
        for j in range(np.int64(np.floor(low[1] / edge)), np.int64(np.floor(high[1] / edge)) + 1):
            for k in range(np.int64(np.floor(low[2] / edge)), np.int64(np.floor(high[2] / edge)) + 1):
                roots[count, 0] = i
                roots[count, 1] = j
                roots[count, 2] = k
                count += 1
    return count, level


@njit(cache=True, inline="always")
def list_cube(i: Int, j: Int, k: Int, level: Int, kind: Int, blocks: Array, kinds: Array, count: Int) -> Int:
    """Add the blocks of cell (i, j, k), of 2^level blocks along an edge, to `blocks` (n, 3) and `kinds` (n,), of which
    `count` are in use, in place; returns how many are then. Beyond n they are counted and not written."""
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
    gaps_are_free: bool,
    blocks: Array,
    kinds: Array,
) -> Int:
    """List the blocks that the image sees, depth first below each root: their index and kind, in place.

    roots (r, 3) int64 are cells of 2^root_level blocks along an edge.

    blocks (n, 3) int32, kinds (n,) uint8. Returns how many there are; beyond n they are counted and not written.
    """
    stack = np.empty((8 * root_level + 1, 4), np.int64)
    extents = np.empty((root_level + 1, 7))
    for level in range(root_level + 1):
        measure_cube(camera, 0.5 * block_size * (1 << level), extents[level])
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
            kind = classify_cell(pyramid, camera, x, y, z, extents[level], front, back, gaps_are_free)
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
            count = list_cube(i, j, k, level, kind, blocks, kinds, count)
    return count
