"""Which blocks does a range image see? Coarse to fine, against the lowest and highest ranges of windows of pixels.

The spherical counterpart of `mapping.kernels.visibility`, after the projective tests of wavemap (Reijgwart et al.,
Efficient volumetric mapping of multi-scale environments using wavelet-based compression, RSS 2023) and supereight2
(Funk et al., Multi-Resolution 3D Mapping With Explicit Free Space Representation, RA-L 2021).

A *reach* image (rows, columns) float32 holds the range [m] up to which each beam saw free space; negative where it
ended at the range limit and not at a surface; 0 where it says nothing. *lidar* and *spans* are those of
`mapping.kernels.lidar`.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.lidar import ATAN_32, ATAN_ERROR, angle_of
from mapping.kernels.visibility import FREE, MIXED, list_cube

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

WINDOWS = 6
"""Sizes of windows: 1, 2, 4 … pixels along an edge."""
_LEVEL_OF_HALF = np.array([max(0, int(n - 1).bit_length() - 1) for n in range(256)])
_LEVEL_OF_QUARTER = np.array([max(0, int(n - 1).bit_length() - 2) for n in range(256)])
"""Of so many pixels: the smallest windows of which two, or four, reach over them."""
NEAR, FAR, STEP_HIGH, STEP_LOW, LEFT, RIGHT, FLAT, AHEAD_X, AHEAD_Y, HEIGHT, COLUMN = range(11)
N_BOUNDS = 11
"""What is known of a cell, see `bound_children`."""


# -- the range image -------------------------------------------------------------------------------------------


@njit(cache=True)
def measure_reach(ranges: Array, max_range: Float, reach: Array) -> Float:
    """Turn a range image (rows, columns) float32 [m] (0, NaN: nothing) into a reach image, in place; returns the
    largest."""
    limit, nothing = np.float32(max_range), np.float32(0.0)
    farthest = np.float32(0.0)
    for row in range(ranges.shape[0]):
        for column in range(ranges.shape[1]):
            d = ranges[row, column]
            reached = d if d <= limit else -limit
            reach[row, column] = reached if d > nothing else nothing
        for column in range(ranges.shape[1]):
            farthest = max(farthest, abs(reach[row, column]))
    return farthest


@njit(cache=True)
def bridge_gaps(reach: Array, wraps: bool) -> None:
    """Where a beam says nothing and at most one of those about it neither, let it have seen as far as the nearest of
    them, and no surface; in place. wraps: whether the first column lies next to the last."""
    rows, columns = reach.shape
    bridged = np.empty((reach.size, 3), np.float32)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if reach[row, column] != np.float32(0.0):
                continue
            gaps = 0
            nearest = np.float32(np.inf)
            for other in range(max(row - 1, 0), min(row + 2, rows)):
                for beside in range(column - 1, column + 2):
                    if (beside < 0 or beside >= columns) and not wraps:
                        continue
                    d = abs(reach[other, beside % columns])
                    gaps += d == np.float32(0.0)
                    nearest = min(nearest, d) if d > np.float32(0.0) else nearest
                if gaps > 2:
                    break
            if gaps <= 2 and nearest < np.float32(np.inf):  # itself and one more
                bridged[count, 0], bridged[count, 1], bridged[count, 2] = row, column, nearest
                count += 1
    for n in range(count):
        reach[np.int64(bridged[n, 0]), np.int64(bridged[n, 1])] = -bridged[n, 2]


@njit(cache=True)
def build_windows(reach: Array, wraps: bool, windows: Array) -> None:
    """Fill windows (n, rows, columns, 2) float32 with the negative of the lowest |reach| of square windows of pixels
    and with the highest, in place.

    windows[k, r, c, 1] is over the 2^k rows from r on and the 2^k columns from c on, those below the last row left out
    and those right of the last column going on at the first. windows[k, r, c, 0] is over the same and one pixel more on
    each side; where the image does not wrap around, nothing lies right of the last column, nor left of the first.
    2^(n − 1) ≤ columns.
    """
    rows, columns = reach.shape
    line = np.empty(4 * columns, np.float32)
    for row in range(rows):
        above, here, below = reach[max(row - 1, 0)], reach[row], reach[min(row + 1, rows - 1)]
        for column in range(columns):
            line[column + 1] = min(abs(here[column]), min(abs(above[column]), abs(below[column])))
        line[0] = line[columns] if wraps else line[1]
        line[columns + 1] = line[1] if wraps else line[columns]
        for column in range(columns):
            windows[0, row, column, 0] = -min(line[column + 1], min(line[column], line[column + 2]))
            windows[0, row, column, 1] = abs(here[column])
    pairs = windows.reshape(windows.shape[0], rows, 2 * columns)
    for level in range(1, windows.shape[0]):
        half = 1 << (level - 1)
        shifted = line[2 * half :]
        for row in range(rows):
            other = row + half if row + half < rows else row
            first, second, merged = pairs[level - 1, row], pairs[level - 1, other], pairs[level, row]
            for n in range(2 * columns):
                line[n] = max(first[n], second[n])
            line[2 * columns : 2 * columns + 2 * half] = line[: 2 * half]
            for n in range(2 * columns):
                merged[n] = max(line[n], shifted[n])


@njit(cache=True)
def range_bounds(windows: Array, row0: Int, row1: Int, column0: Int, n_columns: Int) -> tuple[Float, Float]:
    """Lowest and highest range over at least rows row0 … row1 and n_columns columns from column0 on, which may wrap."""
    columns = windows.shape[2]
    n_rows = row1 - row0 + 1
    level = windows.shape[0] - 1
    if n_rows < _LEVEL_OF_HALF.shape[0] and n_columns < _LEVEL_OF_QUARTER.shape[0]:
        level = min(level, max(_LEVEL_OF_HALF[n_rows], _LEVEL_OF_QUARTER[n_columns]))
    size = 1 << level
    rest = max(n_columns - size, 0)
    low, high = -np.float32(np.inf), np.float32(0.0)
    if n_rows <= 2 * size and n_columns <= 4 * size:  # eight windows, without branches that nobody could foresee
        first, second = windows[level, row0], windows[level, max(row1 - size + 1, row0)]
        for n in range(4):
            column = column0 + min(n << level, rest)
            at = np.uint64(column - columns if column >= columns else column)
            low = max(low, max(first[at, 0], second[at, 0]))
            high = max(high, max(first[at, 1], second[at, 1]))
        return -low, high
    for row in range(row0, row1 + 1, size):
        first = windows[level, min(row, max(row1 - size + 1, row0))]
        for n in range((n_columns + size - 1) >> level):
            column = column0 + min(n << level, rest)
            at = np.uint64(column - columns if column >= columns else column)
            low, high = max(low, first[at, 0]), max(high, first[at, 1])
    return -low, high


# -- cells -----------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def bound_children(lidar: Array, a: Float, b: Float, c: Float, half: Float, touch: Float, bounds: Array) -> None:
    """Bounds of how the lidar sees the eight children of the cube with centre a, b, c [m, map].

    half   : half an edge of a child [m]
    touch  : up to this far beside its elevations a row of beams still counts [m]
    bounds : (N_BOUNDS, 8) float32, filled. Bounds: NEAR, FAR range [m]; STEP_HIGH, STEP_LOW steps of the sine of the
             highest and the lowest elevation; LEFT, RIGHT columns, of which a voxel takes the floor. Of the centre:
             FLAT horizontal distance [m], AHEAD_X, AHEAD_Y the direction of that, HEIGHT [m] above the sensor, COLUMN.
             Child 4·x + 2·y + z has the greater coordinate along each axis that is 1.
    """
    nothing, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
    x0 = lidar[0] * a + lidar[1] * b + lidar[2] * c + lidar[9]
    y0 = lidar[3] * a + lidar[4] * b + lidar[5] * c + lidar[10]
    z0 = lidar[6] * a + lidar[7] * b + lidar[8] * c + lidar[11]
    m0 = np.float32(lidar[0] * x0 + lidar[3] * y0 + lidar[6] * z0)  # from the sensor, along the map's axes
    m1 = np.float32(lidar[1] * x0 + lidar[4] * y0 + lidar[7] * z0)
    m2 = np.float32(lidar[2] * x0 + lidar[5] * y0 + lidar[8] * z0)
    q, two_q = np.float32(half), np.float32(2.0 * half)
    r0, r1, r2 = np.float32(lidar[0]), np.float32(lidar[1]), np.float32(lidar[2])
    r3, r4, r5 = np.float32(lidar[3]), np.float32(lidar[4]), np.float32(lidar[5])
    r6, r7, r8 = np.float32(lidar[6]), np.float32(lidar[7]), np.float32(lidar[8])
    beside = np.float32(touch)
    tall = q * (abs(r6) + abs(r7) + abs(r8)) + beside
    offset, per_radian, turn = np.float32(lidar[12]), np.float32(lidar[13]), np.float32(lidar[15])
    per_sine, last_step = np.float32(lidar[16]), np.float32(lidar[17] - 1.0)
    margin = np.float32(0.01 + 2e-6 * lidar[16])  # for rounding; so is the hundredth below
    slack = np.float32(0.51 + 2.0 * ATAN_ERROR * lidar[13])
    for n in range(bounds.shape[1]):  # no branches, so that it runs on vectors
        s0 = np.float32((n >> 2) & 1) * two_q - q
        s1 = np.float32((n >> 1) & 1) * two_q - q
        s2 = np.float32(n & 1) * two_q - q
        d0, d1, d2 = abs(m0 + s0), abs(m1 + s1), abs(m2 + s2)
        n0, n1, n2 = max(d0 - q, nothing), max(d1 - q, nothing), max(d2 - q, nothing)
        bounds[NEAR, n] = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) * np.float32(1.0 - 2e-6)
        f0, f1, f2 = d0 + q, d1 + q, d2 + q
        bounds[FAR, n] = np.sqrt(f0 * f0 + f1 * f1 + f2 * f2) * np.float32(1.0 + 2e-6)
        x = np.float32(x0) + s0 * r0 + s1 * r1 + s2 * r2
        y = np.float32(y0) + s0 * r3 + s1 * r4 + s2 * r5
        z = np.float32(z0) + s0 * r6 + s1 * r7 + s2 * r8
        # The box about the child with one face across the horizontal direction (u, v) to its centre.
        flat = np.sqrt(x * x + y * y)
        inverse = np.float32(1.0) / max(flat, tiny)
        u, v = x * inverse, y * inverse
        deep = q * (abs(u * r0 + v * r3) + abs(u * r1 + v * r4) + abs(u * r2 + v * r5))
        wide = q * (abs(u * r3 - v * r0) + abs(u * r4 - v * r1) + abs(u * r5 - v * r2))
        flat_low = max(flat - deep, nothing)
        nearer = max(flat_low - beside, nothing)
        farther = np.sqrt((flat + deep) * (flat + deep) + wide * wide) + beside
        z_low, z_high = z - tall, z + tall
        flat_of_low = farther if z_low > nothing else nearer
        flat_of_high = nearer if z_high > nothing else farther
        sine_low = z_low / max(np.sqrt(z_low * z_low + flat_of_low * flat_of_low), tiny)
        sine_high = z_high / max(np.sqrt(z_high * z_high + flat_of_high * flat_of_high), tiny)
        bounds[STEP_HIGH, n] = min(max((one - sine_high) * per_sine - margin, nothing), last_step)
        bounds[STEP_LOW, n] = min(max((one - sine_low) * per_sine + margin, nothing), last_step)
        column = offset - angle_of(x, y, ATAN_32) * per_radian
        column = column + turn if column < nothing else column
        column = column - turn if column >= turn else column
        bounds[FLAT, n], bounds[AHEAD_X, n], bounds[AHEAD_Y, n], bounds[HEIGHT, n] = flat, u, v, z
        bounds[COLUMN, n] = column
        spread = angle_of(flat_low, wide, ATAN_32) * per_radian
        spread = spread if flat_low > nothing else turn
        bounds[LEFT, n] = column - spread + np.float32(1.0) - slack
        bounds[RIGHT, n] = column + spread + slack


@njit(cache=True)
def classify_children(
    windows: Array, lidar: Array, spans: Array, a: Float, b: Float, c: Float, half: Float,
    front: Float, back: Float, touch: Float, bounds: Array, kinds: Array,
) -> None:  # fmt: skip
    """What the range image says of the eight children of the cube with centre a, b, c [m, map].

    half        : half an edge of a child [m]
    front, back : how far [m] before and behind a surface counts as near it
    touch       : see `bound_children`
    bounds      : (N_BOUNDS, 8) float32, filled as `bound_children` does
    kinds       : (8,) uint8, filled: 0 (not seen), MIXED or FREE; never wrongly 0 or FREE
    """
    bound_children(lidar, a, b, c, half, touch, bounds)
    columns, turn = windows.shape[2], lidar[15]
    whole_turn = lidar[14] >= turn
    for n in range(8):
        kinds[n] = 0
        upper, lower = np.int64(bounds[STEP_HIGH, n]), np.int64(bounds[STEP_LOW, n])
        row0, row1 = np.int64(spans[upper, 0]), np.int64(spans[lower, 1])
        if row0 > row1:
            continue
        inside = lower + 1 < spans.shape[0] and spans[lower + 1, 2] - spans[upper, 2] == lower + 1 - upper
        left: Int = np.int64(np.floor(bounds[LEFT, n]))
        right: Int = np.int64(np.floor(bounds[RIGHT, n]))
        if whole_turn:
            n_columns = min(right - left + 1, columns)
            column0 = 0 if n_columns == columns else left + columns if left < 0 else left
        else:
            inside = inside and left >= 0 and right <= columns - 1
            if right < turn - 1.5 and left > columns - turn + 0.5:
                left, right = max(left, 0), min(right, columns - 1)
                if left > right:
                    continue
            else:  # from one end of the image across the gap to the other
                left, right = 0, columns - 1
            column0, n_columns = left, right - left + 1
        low, high = range_bounds(windows, row0, row1, column0, n_columns)
        if bounds[NEAR, n] - back > high or high == 0.0:
            continue
        kinds[n] = FREE if inside and bounds[FAR, n] + front < low else MIXED


@njit(cache=True)
def list_blocks(
    windows: Array, lidar: Array, spans: Array, roots: Array, root_level: Int, block_size: Float,
    front: Float, back: Float, touch: Float, with_free: bool, blocks: Array, kinds: Array,
) -> Int:  # fmt: skip
    """List the blocks that the range image sees, depth first below each root: their index and kind, in place.

    roots (r, 3) int64 are cells of 2^root_level blocks along an edge, root_level ≥ 1. front, back, touch: see
    `classify_children`.

    blocks (n, 3) int32, kinds (n,) uint8. Returns how many there are; beyond n they are counted and not written.
    """
    stack = np.empty((7 * root_level + 1, 4), np.int64)
    bounds, seen = np.empty((N_BOUNDS, 8), np.float32), np.empty(8, np.uint8)
    count = 0
    for root in range(roots.shape[0]):
        stack[0, 0], stack[0, 1], stack[0, 2] = roots[root, 0], roots[root, 1], roots[root, 2]
        stack[0, 3] = root_level
        top = 1
        while top > 0:
            top -= 1
            i, j, k, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] - 1
            half = 0.5 * block_size * (1 << level)
            a, b, c = (4 * i + 2) * half, (4 * j + 2) * half, (4 * k + 2) * half
            classify_children(windows, lidar, spans, a, b, c, half, front, back, touch, bounds, seen)
            for child in range(8):
                kind = seen[child]
                if kind == 0 or (kind == FREE and not with_free):
                    continue
                ci, cj, ck = 2 * i + (child >> 2), 2 * j + ((child >> 1) & 1), 2 * k + (child & 1)
                if level > 0 and kind == MIXED:
                    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = ci, cj, ck, level
                    top += 1
                    continue
                count = list_cube(ci, cj, ck, level, kind, blocks, kinds, count)
    return count
