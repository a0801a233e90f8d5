"""Lidar kernels: points and voxels onto the beams of a range image.

A *lidar* is a (18,) float64 array: R_sensor_map row by row, t_sensor_map, then how it sees: the column at azimuth 0,
columns per radian, columns, columns that would fill a turn, and the steps in which it knows the sine of an elevation,
from 1 to −1: steps per unit and how many there are. Tables over these steps:

row_of  (steps,) int32: the nearest row, times columns; BESIDE is added where that row does not answer for the step
off_row (steps,) float32: the angle between the step and the beams of that row [rad]
spans   (steps, 3) int32: the row that answers for the step or else for the next below; for the step or else for the
        next above; and how many of the steps before it are answered for

Steps are far finer than rows (`mapping.sensors.STEPS_PER_ROW`): a voxel so near to the border between two rows that it
is given to the other one lies between the two beams just as well.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

ATAN_ERROR = 1.2e-5
"""Bound of the error of `angle_of` [rad]."""
_ATAN = (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351, 0.5 * np.pi, np.pi, 1e-30)
ATAN_64 = tuple(np.float64(c) for c in _ATAN)
ATAN_32 = tuple(np.float32(c) for c in _ATAN)
"""Constants of `angle_of` in either precision."""
NO_COLUMN, BESIDE = -(1 << 30), -(1 << 29)
"""What is added to pixels outside the span and to those of rows that do not answer: pixel ≥ 0 is answered for;
pixel − BESIDE ≥ 0 is the nearest all the same."""
NEAREST_AHEAD = 22.0
"""In voxels: so far from the axis must a cube of 4³ voxels be for `aim_ahead`."""
LOCAL_8 = np.indices((8, 8, 8), np.float32).reshape(3, -1)
LOCAL_4 = np.indices((4, 4, 4), np.float32).reshape(3, -1)
"""(3, n) where the voxels of a cube of 8³ or 4³ lie in it, in the order of their index."""


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


# -- voxels ----------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def aim(
    i: Int, j: Int, k: Int, local: Array, voxel_size: Float, lidar: Array,
    columns: Array, steps: Array, r: Array, aside: Array,
) -> None:  # fmt: skip
    """Where the n voxel centres of a cube lie whose first voxel is (i, j, k) and whose others are at `local` (3, n).

    columns : (n,) int32, filled: column of the nearest beam, NO_COLUMN outside the span
    steps   : (n,) int32, filled: step of the elevation's sine
    r       : (n,) float32, filled: range [m]
    aside   : (n,) float32, filled: squared distance to the middle of the column [m²]
    """
    half, nothing, one = np.float32(0.5), np.float32(0.0), np.float32(1.0)
    v = np.float32(voxel_size)
    offset, per_radian, turn = np.float32(lidar[12]), np.float32(lidar[13]), np.float32(lidar[15])
    last_column, turn_end = np.float32(lidar[14] - 1.0), np.float32(lidar[15] - 0.5)
    span_end = np.float32(lidar[14] - 0.5 if lidar[14] < lidar[15] else np.inf)
    per_sine, last_step = np.float32(lidar[16]), np.float32(lidar[17] - 1.0)
    column_angle = np.float32(1.0 / lidar[13])
    r0, r1, r2 = np.float32(lidar[0]) * v, np.float32(lidar[1]) * v, np.float32(lidar[2]) * v
    r3, r4, r5 = np.float32(lidar[3]) * v, np.float32(lidar[4]) * v, np.float32(lidar[5]) * v
    r6, r7, r8 = np.float32(lidar[6]) * v, np.float32(lidar[7]) * v, np.float32(lidar[8]) * v
    a, b, c = (i + 0.5) * voxel_size, (j + 0.5) * voxel_size, (k + 0.5) * voxel_size
    x0 = np.float32(lidar[0] * a + lidar[1] * b + lidar[2] * c + lidar[9])
    y0 = np.float32(lidar[3] * a + lidar[4] * b + lidar[5] * c + lidar[10])
    z0 = np.float32(lidar[6] * a + lidar[7] * b + lidar[8] * c + lidar[11])
    for w in range(local.shape[1]):  # no branches, so that it runs on vectors
        x = x0 + local[0, w] * r0 + local[1, w] * r1 + local[2, w] * r2
        y = y0 + local[0, w] * r3 + local[1, w] * r4 + local[2, w] * r5
        z = z0 + local[0, w] * r6 + local[1, w] * r7 + local[2, w] * r8
        flat_squared = x * x + y * y
        column = offset - angle_of(x, y, ATAN_32) * per_radian
        column = column + turn if column < -half else column
        column = column - turn if column >= turn_end else column
        nearest = np.int32(min(column + half, last_column))
        off = (column - np.float32(nearest)) * column_angle
        distance = np.sqrt(flat_squared + z * z)
        sine = z / max(distance, np.float32(1e-9))
        columns[w] = nearest if column < span_end else np.int32(NO_COLUMN)
        steps[w] = np.int32(min(max((one - sine) * per_sine, nothing), last_step))
        r[w] = distance
        aside[w] = off * off * flat_squared


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def aim_ahead(
    flat: Float, u: Float, v: Float, height: Float, column: Float, local: Array, voxel_size: Float, lidar: Array,
    columns: Array, steps: Array, r: Array, aside: Array,
) -> None:  # fmt: skip
    """What `aim` says, in half the time, of a cube of 4³ voxels whose centre lies `flat` [m] ahead in the horizontal
    direction (u, v), at a height [m], and all of whose columns are within the image, next to that of its centre.

    The angle from the centre is a series (a − a³/3 + a⁵/5): for centres at least NEAREST_AHEAD voxels ahead it is good
    to 2e-6 rad.
    """
    half, nothing = np.float32(0.5), np.float32(0.0)
    size = np.float32(voxel_size)
    per_radian, column_angle = np.float32(lidar[13]), np.float32(1.0 / lidar[13])
    per_sine, last_step = np.float32(lidar[16]), np.float32(lidar[17] - 1.0)
    third, fifth, one = np.float32(1.0 / 3.0), np.float32(0.2), np.float32(1.0)
    r0, r1, r2 = np.float32(lidar[0]) * size, np.float32(lidar[1]) * size, np.float32(lidar[2]) * size
    r3, r4, r5 = np.float32(lidar[3]) * size, np.float32(lidar[4]) * size, np.float32(lidar[5]) * size
    a0, a1, a2 = u * r0 + v * r3, u * r1 + v * r4, u * r2 + v * r5
    b0, b1, b2 = u * r3 - v * r0, u * r4 - v * r1, u * r5 - v * r2
    c0, c1, c2 = np.float32(lidar[6]) * size, np.float32(lidar[7]) * size, np.float32(lidar[8]) * size
    middle = np.float32(1.5)
    x0, y0, z0 = flat - middle * (a0 + a1 + a2), -middle * (b0 + b1 + b2), height - middle * (c0 + c1 + c2)
    for w in range(local.shape[1]):  # no branches, so that it runs on vectors
        x = x0 + local[0, w] * a0 + local[1, w] * a1 + local[2, w] * a2
        y = y0 + local[0, w] * b0 + local[1, w] * b1 + local[2, w] * b2
        z = z0 + local[0, w] * c0 + local[1, w] * c1 + local[2, w] * c2
        a = y / x
        q = a * a
        here = column - a * (one - q * (third - q * fifth)) * per_radian
        nearest = np.int32(here + half)
        off = (here - np.float32(nearest)) * column_angle
        flat_squared = x * x + y * y
        distance = np.sqrt(flat_squared + z * z)
        columns[w] = nearest
        steps[w] = np.int32(min(max((one - z / distance) * per_sine, nothing), last_step))
        r[w] = distance
        aside[w] = off * off * flat_squared


@njit(cache=True, error_model="numpy")
def project_block(
    bi: Int, bj: Int, bk: Int, voxel_size: Float, lidar: Array, row_of: Array, off_row: Array,
    pixels: Array, r: Array, aside: Array,
) -> None:  # fmt: skip
    """Project the 512 voxel centres of block (bi, bj, bk).

    pixels : (512,) int32, filled: row · columns + column of the nearest beam, below 0 where none answers
    r      : (512,) float32, filled: range [m]
    aside  : (512,) float32, filled: squared distance from the voxel's centre to the beam [m²], where one answers
    """
    steps = np.empty(512, np.int32)
    aim(8 * np.int64(bi), 8 * np.int64(bj), 8 * np.int64(bk), LOCAL_8, voxel_size, lidar, pixels, steps, r, aside)
    for w in range(512):
        step = np.uint32(steps[w])
        up = off_row[step] * r[w]
        pixels[w] += row_of[step]
        aside[w] += up * up


# -- points ----------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def find_beams(points: Array, seeing: Array, rings: Array, row_at: Array, pixels: Array, r: Array) -> None:
    """The beam nearest to each of `points` (n, 3) float64 [m, sensor frame].

    seeing : (6,) float64 the last six numbers of a lidar
    rings  : (rows + 1, 2) float64 the sines of the lowest and highest elevation that each row answers for, from the
             top; after the last row one that ends the search
    row_at : (steps,) int32 the first row that reaches below the upper end of each step
    pixels : (n,) int64, filled: row · columns + column, −1 where no beam looks there
    r      : (n,) float64, filled: range [m]
    """
    offset, per_radian, columns, turn = seeing[0], seeing[1], seeing[2], seeing[3]
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
        row = np.int64(row_at[min(np.int64((1.0 - sine) * seeing[4]), row_at.shape[0] - 1)])
        while sine < rings[row, 0]:
            row += 1
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
