"""Lidar range images: voxels onto beams, and which blocks a range image sees, coarse to fine.

The spherical counterpart of `mapping.kernels.visibility` and `mapping.kernels.projection`, after the projective
integrators of wavemap (Reijgwart et al., Efficient volumetric mapping of multi-scale environments using wavelet-based
compression, RSS 2023) and supereight2 (Funk et al., Multi-Resolution 3D Mapping With Explicit Free Space
Representation, RA-L 2021).

A *lidar* is a (19,) float64 array: R_sensor_map row by row, t_sensor_map, then how it sees: the column at azimuth 0,
columns per radian, columns, columns that would fill a turn, the sine at which the steps begin, steps per sine and how
many steps there are, the first and the last of them seen by none. Tables over the steps of the sine, from the top: *row_of* (steps,) int32, the row that
answers for it times columns, or NO_PIXEL; *off_row* (steps,) float32, the angle from that row's beams [rad]; *row_at*
(steps,) int32, the first row that reaches below the upper end of the step. *rings* (rows + 1, 3) float64 holds for each
row, from the top, the sines of the lowest and highest elevation that it answers for, and how many gaps that no row
answers for lie above it; a last row ends the search. A *reach* image (rows, columns) float32 holds the range [m] up to
which each beam saw free space; negative where it ended at the range limit and not at a surface; 0 where it says
nothing.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.visibility import FREE, MIXED

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

WINDOWS = 6
"""Sizes of windows, 1, 2, 4 … pixels along an edge, of which lowest and highest ranges are kept."""
ATAN_ERROR = 1.2e-5
"""Bound of the error of `angle_of` [rad]."""
_ATAN = (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351, 0.5 * np.pi, np.pi, 1e-30)
ATAN_64 = tuple(np.float64(c) for c in _ATAN)
ATAN_32 = tuple(np.float32(c) for c in _ATAN)
"""Constants of `angle_of` in either precision."""
NO_PIXEL = -(1 << 30)
"""In place of the column or of the row that nothing looks along; below 0 whatever is added."""
_MISS = 1


# -- angles ----------------------------------------------------------------------------------------------------


@njit(cache=True, inline="always")
def angle_of(x: Float, y: Float, k: Any) -> Float:
    """atan2(y, x) [rad] to within ATAN_ERROR, in steps that run on vectors (Abramowitz & Stegun 1964, 4.4.47).

    k : ATAN_32 or ATAN_64, of the precision of x and y
    """
    across, along = abs(y), abs(x)
    a = min(across, along) / max(max(across, along), k[7])
    q = a * a
    angle = a * (k[0] + q * (k[1] + q * (k[2] + q * (k[3] + q * k[4]))))
    angle = k[5] - angle if across > along else angle
    angle = k[6] - angle if x < 0 else angle
    return -angle if y < 0 else angle


@njit(cache=True, inline="always")
def row_below(sine: Float, lidar: Array, rings: Array, row_at: Array) -> Int:
    """The row that answers for an elevation of this sine, or else the next below; rows where there is none."""
    step = np.int64((lidar[16] - sine) * lidar[17])
    row = np.int64(row_at[min(max(step, 0), row_at.shape[0] - 1)])
    return row + 1 if sine < rings[row, 0] else row


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def aim_block(
    bi: Int, bj: Int, bk: Int, voxel_size: Float, lidar: Array, columns: Array, steps: Array, r: Array, aside: Array
) -> None:
    """Where the 512 voxel centres of block (bi, bj, bk) lie.

    columns : (512,) int32, filled: column of the nearest beam, NO_PIXEL outside the span
    steps   : (512,) int32, filled: step of the elevation's sine, within the tables
    r       : (512,) float32, filled: range [m]
    aside   : (512,) float32, filled: squared distance to the middle of the column [m²]
    """
    half = np.float32(0.5)
    nothing = np.float32(0.0)
    v = np.float32(voxel_size)
    offset, per_radian, turn = np.float32(lidar[12]), np.float32(lidar[13]), np.float32(lidar[15])
    last_column, turn_end = np.float32(lidar[14] - 1.0), np.float32(lidar[15] - 0.5)
    span_end = np.float32(lidar[14] - 0.5 if lidar[14] < lidar[15] else np.inf)
    top, per_sine, last_step = np.float32(lidar[16]), np.float32(lidar[17]), np.float32(lidar[18] - 1.0)
    column_angle = np.float32(1.0 / lidar[13])
    r0, r1, r2 = np.float32(lidar[0]) * v, np.float32(lidar[1]) * v, np.float32(lidar[2]) * v
    r3, r4, r5 = np.float32(lidar[3]) * v, np.float32(lidar[4]) * v, np.float32(lidar[5]) * v
    r6, r7, r8 = np.float32(lidar[6]) * v, np.float32(lidar[7]) * v, np.float32(lidar[8]) * v
    a, b, c = (8.0 * bi + 0.5) * voxel_size, (8.0 * bj + 0.5) * voxel_size, (8.0 * bk + 0.5) * voxel_size
    x0 = np.float32(lidar[0] * a + lidar[1] * b + lidar[2] * c + lidar[9])
    y0 = np.float32(lidar[3] * a + lidar[4] * b + lidar[5] * c + lidar[10])
    z0 = np.float32(lidar[6] * a + lidar[7] * b + lidar[8] * c + lidar[11])
    for w in range(512):  # no branches, so that it runs on vectors
        i, j, k = np.float32((w >> 6) & 7), np.float32((w >> 3) & 7), np.float32(w & 7)
        x = x0 + i * r0 + j * r1 + k * r2
        y = y0 + i * r3 + j * r4 + k * r5
        z = z0 + i * r6 + j * r7 + k * r8
        flat_squared = x * x + y * y
        column = offset - angle_of(x, y, ATAN_32) * per_radian
        column = column + turn if column < -half else column
        column = column - turn if column >= turn_end else column
        nearest = np.int32(min(column + half, last_column))
        off = (column - np.float32(nearest)) * column_angle
        distance = np.sqrt(flat_squared + z * z)
        sine = z / max(distance, np.float32(1e-9))
        columns[w] = nearest if column < span_end else np.int32(NO_PIXEL)
        steps[w] = np.int32(min(max((top - sine) * per_sine, nothing), last_step))
        r[w] = distance
        aside[w] = off * off * flat_squared


@njit(cache=True, error_model="numpy")
def project_block(
    bi: Int,
    bj: Int,
    bk: Int,
    voxel_size: Float,
    lidar: Array,
    row_of: Array,
    off_row: Array,
    pixels: Array,
    r: Array,
    aside: Array,
) -> None:
    """Project the 512 voxel centres of block (bi, bj, bk).

    pixels : (512,) int32, filled: row · columns + column of the nearest beam, below 0 where none answers
    r      : (512,) float32, filled: range [m]
    aside  : (512,) float32, filled: squared distance from the voxel's centre to the beam [m²], where one answers
    """
    steps = np.empty(512, np.int32)
    aim_block(bi, bj, bk, voxel_size, lidar, pixels, steps, r, aside)
    for w in range(512):
        step = np.uint32(steps[w])
        up = off_row[step] * r[w]
        pixels[w] += row_of[step]
        aside[w] += up * up


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
def build_windows(reach: Array, wraps: bool, lows: Array, highs: Array) -> None:
    """Fill lows and highs (n, rows, columns) with the lowest and highest |reach| of square windows, in place.

    highs[k, r, c] is over the 2^k rows from r on and the 2^k columns from c on, those below the last row left out and
    those right of the last column going on at the first. lows are over the same and one pixel more on each side; where
    the image does not wrap around, nothing lies right of the last column, nor left of the first.
    """
    rows, columns = reach.shape
    line = np.empty(columns, np.float32)
    for row in range(rows):
        for column in range(columns):
            highs[0, row, column] = abs(reach[row, column])
    for row in range(rows):
        line[:] = highs[0, row]
        for other in range(max(row - 1, 0), min(row + 2, rows)):
            for column in range(columns):
                d = highs[0, other, column]
                line[column] = d if d < line[column] else line[column]
        for column in range(1, columns - 1):
            lows[0, row, column] = min(min(line[column - 1], line[column]), line[column + 1])
        before = line[columns - 1] if wraps else line[0]
        after = line[0] if wraps else line[columns - 1]
        lows[0, row, 0] = min(min(before, line[0]), line[min(1, columns - 1)])
        lows[0, row, columns - 1] = min(min(line[max(columns - 2, 0)], line[columns - 1]), after)
    for level in range(1, lows.shape[0]):
        half = 1 << (level - 1)
        for row in range(rows):
            other = row + half if row + half < rows else row
            for column in range(columns):
                lows[level, row, column] = min(lows[level - 1, row, column], lows[level - 1, other, column])
                highs[level, row, column] = max(highs[level - 1, row, column], highs[level - 1, other, column])
            # In place from left to right: what is read further right has not been merged yet.
            line[:half] = lows[level, row, :half]
            for column in range(columns - half):
                lows[level, row, column] = min(lows[level, row, column], lows[level, row, column + half])
            for column in range(columns - half, columns):
                lows[level, row, column] = min(lows[level, row, column], line[column + half - columns])
            line[:half] = highs[level, row, :half]
            for column in range(columns - half):
                highs[level, row, column] = max(highs[level, row, column], highs[level, row, column + half])
            for column in range(columns - half, columns):
                highs[level, row, column] = max(highs[level, row, column], line[column + half - columns])


@njit(cache=True)
def range_bounds(lows: Array, highs: Array, row0: Int, row1: Int, column0: Int, n_columns: Int) -> tuple[Float, Float]:
    """Lowest and highest range over at least rows row0 … row1 and n_columns columns from column0 on, which may wrap."""
    columns = lows.shape[2]
    n_rows = row1 - row0 + 1
    level = 0
    while level + 1 < lows.shape[0] and (
        (2 << level) <= min(n_rows, n_columns) or (4 << level) < max(n_rows, n_columns)
    ):
        level += 1
    size = 1 << level
    low, high = np.float32(np.inf), np.float32(0.0)
    row = row0
    while True:
        column, left = column0, n_columns
        while True:
            low = min(low, lows[level, row, column])
            high = max(high, highs[level, row, column])
            if left <= size:
                break
            step = min(size, left - size)
            left -= step
            column += step
            column = column - columns if column >= columns else column
        if row + size > row1:
            break
        row = min(row + size, max(row1 - size + 1, 0))
    return low, high


# -- blocks, coarse to fine ------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def classify_cell(
    lows: Array,
    highs: Array,
    lidar: Array,
    rings: Array,
    row_at: Array,
    x: Float,
    y: Float,
    z: Float,
    half: Float,
    front: Float,
    back: Float,
) -> Int:
    """What the range image says of the cube with centre x, y, z [m, sensor frame] and half an edge [m], along the
    map's axes.

    front, back : how far [m] before and behind a surface counts as near it
    Returns 0 (not seen), MIXED or FREE; never wrongly 0 or FREE.
    """
    # Ranges: the nearest and farthest point of the cube, in its own frame.
    nearest, farthest = 0.0, 0.0
    for axis in range(3):
        along = abs(lidar[axis] * x + lidar[3 + axis] * y + lidar[6 + axis] * z)
        nearest += max(along - half, 0.0) ** 2
        farthest += (along + half) ** 2
    nearest, farthest = np.sqrt(nearest), np.sqrt(farthest)
    # Azimuths: the box about the cube with one face across the horizontal direction (u, v) to its centre.
    flat = np.sqrt(x * x + y * y)
    u, v = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
    deep, wide = 0.0, 0.0
    for axis in range(3):
        deep += abs(u * lidar[axis] + v * lidar[3 + axis])
        wide += abs(u * lidar[3 + axis] - v * lidar[axis])
    deep, wide = half * deep, half * wide
    tall = half * (abs(lidar[6]) + abs(lidar[7]) + abs(lidar[8]))
    flat_low = max(flat - deep, 0.0)
    flat_high = np.sqrt((flat + deep) ** 2 + wide * wide)
    # Elevations; a voxel takes the row of its step.
    margin = 1.0 / lidar[17] + 4e-6
    z_low, z_high = z - tall, z + tall
    flat_of_low = flat_high if z_low > 0.0 else flat_low
    flat_of_high = flat_low if z_high > 0.0 else flat_high
    sine_low = z_low / max(np.sqrt(z_low * z_low + flat_of_low * flat_of_low), 1e-12) - margin
    sine_high = z_high / max(np.sqrt(z_high * z_high + flat_of_high * flat_of_high), 1e-12) + margin
    rows = rings.shape[0] - 1
    row0, row1 = row_below(sine_high, lidar, rings, row_at), row_below(sine_low, lidar, rings, row_at)
    if row1 >= rows or sine_low > rings[row1, 1]:
        row1 -= 1
        inside = False
    else:
        inside = rings[row0, 2] == rings[row1, 2]
    if row0 > row1:
        return 0
    inside = inside and sine_high <= rings[row0, 1]
    columns, turn = np.int64(lidar[14]), lidar[15]
    whole_turn = lidar[14] >= turn
    column0, n_columns = np.int64(0), columns
    if flat_low > 0.0:
        spread = (angle_of(flat_low, wide, ATAN_64) + 2.0 * ATAN_ERROR) * lidar[13] + 0.01
        column = lidar[12] - angle_of(x, y, ATAN_64) * lidar[13]
        column -= turn * np.floor((column + 0.5) / turn)
        # A voxel takes the nearest column.
        first, last = np.int64(np.floor(column - spread + 0.5)), np.int64(np.floor(column + spread + 0.5))
        if whole_turn:
            if last - first + 1 < columns:
                column0, n_columns = first % columns, last - first + 1
        else:
            inside = inside and first >= 0 and last <= columns - 1
            reaches_round = last >= turn - 1.5 or first <= columns - turn + 0.5
            if not reaches_round:
                first, last = max(first, 0), min(last, columns - 1)
                if first > last:
                    return 0
                column0, n_columns = first, last - first + 1
    else:
        inside = inside and whole_turn
    low, high = range_bounds(lows, highs, row0, row1, column0, n_columns)
    if nearest - back > high or high == 0.0:
        return 0
    if inside and farthest + front < low:
        return FREE
    return MIXED


@njit(cache=True)
def list_blocks(
    lows: Array,
    highs: Array,
    lidar: Array,
    rings: Array,
    row_at: Array,
    roots: Array,
    root_level: Int,
    block_size: Float,
    front: Float,
    back: Float,
    with_free: bool,
    blocks: Array,
    kinds: Array,
) -> Int:
    """List the blocks that the range image sees, depth first below each root: their index and kind, in place.

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
            x = lidar[0] * a + lidar[1] * b + lidar[2] * c + lidar[9]
            y = lidar[3] * a + lidar[4] * b + lidar[5] * c + lidar[10]
            z = lidar[6] * a + lidar[7] * b + lidar[8] * c + lidar[11]
            kind = classify_cell(lows, highs, lidar, rings, row_at, x, y, z, 0.5 * edge, front, back)
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


# -- occupancy -------------------------------------------------------------------------------------------------


@njit(cache=True, parallel=True, error_model="numpy")
def mark_free(
    blocks: Array,
    voxel_size: Float,
    reach: Array,
    clear: Array,
    lidar: Array,
    row_of: Array,
    off_row: Array,
    marks: Array,
) -> None:
    """Mark each voxel of `blocks` (n, 3) that the range image sees free; fills marks (n, 512) uint8.

    A voxel is free where the beam nearest to its centre passes it before the surface, as in ray casting; and, between
    the beams, where it lies as a whole before the nearest surface that the beam and its eight neighbours saw.

    clear : (rows, columns) float32 the lowest |reach| of a pixel and its neighbours
    """
    seen, nearby = reach.ravel(), clear.ravel()
    margin = np.float32(0.87 * voxel_size)  # half a voxel's diagonal
    touch = np.float32(0.25 * voxel_size * voxel_size)
    for n in prange(blocks.shape[0]):
        columns, steps = np.empty(512, np.int32), np.empty(512, np.int32)
        r, aside = np.empty(512, np.float32), np.empty(512, np.float32)
        aim_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, lidar, columns, steps, r, aside)
        for w in range(512):
            step = np.uint32(steps[w])
            up = off_row[step] * r[w]
            pixel = columns[w] + row_of[step]
            at = np.uint32(max(pixel, np.int32(0)))
            passed = (r[w] < abs(seen[at])) & (aside[w] + up * up < touch)
            free = (pixel >= 0) & (passed | (r[w] + margin < nearby[at]))
            marks[n, w] = np.uint8(_MISS) if free else np.uint8(0)


@njit(cache=True)
def list_hits(reach: Array, directions: Array, pose: Array, voxel_size: Float, voxels: Array) -> Int:
    """List the voxel of each beam's surface point, row by row; beams in a row that share a voxel give it once.

    directions : (rows + columns, 2) float64: sine and cosine of each row's elevation, then of each column's azimuth
    pose       : (12,) float64, R_map_sensor row by row and t_map_sensor
    voxels     : (n, 3) int32, filled in place from the start; n must be the number of pixels. Returns how many
                 there are.
    """
    per_voxel = 1.0 / voxel_size
    rows, columns = reach.shape
    row_i, row_j, row_k = np.empty(columns, np.int32), np.empty(columns, np.int32), np.empty(columns, np.int32)
    sines, cosines = directions[rows:, 0].copy(), directions[rows:, 1].copy()
    count = 0
    for row in range(rows):
        up, flat = directions[row, 0], directions[row, 1]
        a0, a1, a2 = pose[0] * flat, pose[1] * flat, pose[2] * up
        b0, b1, b2 = pose[3] * flat, pose[4] * flat, pose[5] * up
        c0, c1, c2 = pose[6] * flat, pose[7] * flat, pose[8] * up
        for u in range(columns):  # no branches, so that it runs on vectors
            d = np.float64(reach[row, u])
            row_i[u] = np.int32(np.floor((d * (a0 * cosines[u] + a1 * sines[u] + a2) + pose[9]) * per_voxel))
            row_j[u] = np.int32(np.floor((d * (b0 * cosines[u] + b1 * sines[u] + b2) + pose[10]) * per_voxel))
            row_k[u] = np.int32(np.floor((d * (c0 * cosines[u] + c1 * sines[u] + c2) + pose[11]) * per_voxel))
        last = -1
        for u in range(columns):
            if reach[row, u] > np.float32(0.0):
                if last >= 0 and row_i[u] == row_i[last] and row_j[u] == row_j[last] and row_k[u] == row_k[last]:
                    continue
                voxels[count, 0] = row_i[u]
                voxels[count, 1] = row_j[u]
                voxels[count, 2] = row_k[u]
                count += 1
                last = u
    return count


# -- points onto the image -------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def find_beams(points: Array, seeing: Array, rings: Array, row_at: Array, pixels: Array, r: Array) -> None:
    """The beam nearest to each of `points` (n, 3) float64 [m, sensor frame].

    seeing : (19,) float64 a lidar, of which the pose is not read
    pixels : (n,) int64, filled: row · columns + column, −1 where no beam looks there
    r      : (n,) float64, filled: range [m]
    """
    offset, per_radian, columns, turn = seeing[12], seeing[13], seeing[14], seeing[15]
    n_columns = np.int64(columns)
    whole_turn = columns >= turn
    unsure = 2.0 * ATAN_ERROR * per_radian + 1e-6
    rows = rings.shape[0] - 1
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        r[n] = distance
        pixels[n] = -1
        if not 0.0 < distance < np.inf:
            continue
        sine = z / distance
        row = row_below(sine, seeing, rings, row_at)
        if row >= rows or sine > rings[row, 1]:
            continue
        column = offset - angle_of(x, y, ATAN_64) * per_radian
        nearest = np.floor(column + 0.5)
        if (
            abs(abs(column - nearest) - 0.5) < unsure
        ):  # near the middle between two columns, where the last digits count
            column = offset - np.arctan2(y, x) * per_radian
            nearest = np.floor(column + 0.5)
        if column < -0.5:
            column, nearest = column + turn, np.floor(column + turn + 0.5)
        if column >= turn - 0.5:
            column, nearest = column - turn, np.floor(column - turn + 0.5)
        if column >= columns - 0.5 and not whole_turn:
            continue
        pixels[n] = row * n_columns + min(np.int64(nearest), n_columns - 1)


@njit(cache=True)
def keep_nearest(pixels: Array, r: Array, ranges: Array, index: Array) -> None:
    """Fill ranges (m,) float32 [m] and index (m,) int64 with the nearest point of each pixel, in place; 0 and −1 where
    there is none. Of points at the same range the last counts.

    pixels, r : (n,) as `find_beams` gives them
    """
    best = np.full(ranges.shape[0], np.inf)
    ranges[:] = 0.0
    index[:] = -1
    for n in range(pixels.shape[0]):
        pixel = pixels[n]
        if pixel >= 0 and r[n] <= best[pixel]:
            best[pixel] = r[n]
            ranges[pixel] = np.float32(r[n])
            index[pixel] = n
