"""What a range image says of voxels: those that it sees free, those that its beams ended in.

Arguments are those of `mapping.kernels.lidar` and `mapping.kernels.range_visibility`, marks those of
`mapping.kernels.occupancy`.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.lidar import BESIDE, LOCAL_4, NEAREST_AHEAD, aim, aim_ahead
from mapping.kernels.occupancy import MISS, list_row
from mapping.kernels.range_visibility import (
    AHEAD_X,
    AHEAD_Y,
    COLUMN,
    FLAT,
    HEIGHT,
    LEFT,
    N_BOUNDS,
    RIGHT,
    classify_children,
)
from mapping.kernels.visibility import FREE, MIXED

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

_CHUNK = 32
"""Blocks that are worked through with the same scratch arrays."""
_INSIDE = (64 * LOCAL_4[0] + 8 * LOCAL_4[1] + LOCAL_4[2]).astype(np.uint64)
"""(64,) place in its block of each voxel of the block's first octant."""


@njit(cache=True, parallel=True, error_model="numpy")
def mark_free(
    blocks: Array, voxel_size: Float, windows: Array, lidar: Array, spans: Array,
    row_of: Array, off_row: Array, marks: Array,
) -> None:  # fmt: skip
    """Mark each voxel of `blocks` (n, 3) that the range image sees free; fills marks (n, 512) uint8.

    A voxel is free where the beam nearest to its centre passes it before the surface, as in ray casting; and, between
    the beams, where it lies as a whole before the nearest surface that the beam and its eight neighbours saw. Octants
    of a block are tested as a whole first.
    """
    seen = windows[0].reshape(-1, 2)
    margin = np.float32(0.87 * voxel_size)  # half a voxel's diagonal
    touch = np.float32(0.25 * voxel_size * voxel_size)
    half = 2.0 * voxel_size
    ahead = np.float32(NEAREST_AHEAD * voxel_size)
    nothing, last_column = np.float32(0.0), np.float32(lidar[14] - 1.0)
    for chunk in prange((blocks.shape[0] + _CHUNK - 1) // _CHUNK):
        bounds, kinds = np.empty((N_BOUNDS, 8), np.float32), np.empty(8, np.uint8)
        columns, steps = np.empty(64, np.int32), np.empty(64, np.int32)
        r, aside = np.empty(64, np.float32), np.empty(64, np.float32)
        for n in range(chunk * _CHUNK, min(chunk * _CHUNK + _CHUNK, blocks.shape[0])):
            i, j, k = 8 * np.int64(blocks[n, 0]), 8 * np.int64(blocks[n, 1]), 8 * np.int64(blocks[n, 2])
            a, b, c = (i + 4) * voxel_size, (j + 4) * voxel_size, (k + 4) * voxel_size
            row = marks[n]
            classify_children(windows, lidar, spans, a, b, c, half, voxel_size, 0.0, 0.5 * voxel_size, bounds, kinds)
            for octant in range(8):
                x, y, z = (octant >> 2) * 4, ((octant >> 1) & 1) * 4, (octant & 1) * 4
                first = np.uint64(x << 6 | y << 3 | z)
                if kinds[octant] != MIXED:
                    mark = np.uint8(MISS) if kinds[octant] == FREE else np.uint8(0)
                    for w in range(64):
                        row[first + _INSIDE[w]] = mark
                    continue
                of = bounds[:, octant]
                if of[FLAT] > ahead and of[LEFT] >= nothing and of[RIGHT] < last_column:
                    aim_ahead(
                        of[FLAT], of[AHEAD_X], of[AHEAD_Y], of[HEIGHT], of[COLUMN], LOCAL_4, voxel_size, lidar,
                        columns, steps, r, aside,
                    )  # fmt: skip
                else:
                    aim(i + x, j + y, k + z, LOCAL_4, voxel_size, lidar, columns, steps, r, aside)
                for w in range(64):
                    step = np.uint32(steps[w])
                    up = off_row[step] * r[w]
                    pixel = columns[w] + row_of[step]
                    near = pixel if pixel >= 0 else pixel - np.int32(BESIDE)
                    at = np.uint32(max(near, np.int32(0)))
                    passed = (near >= 0) & (r[w] < seen[at, 1]) & (aside[w] + up * up < touch)
                    free = passed | ((pixel >= 0) & (r[w] + margin < -seen[at, 0]))
                    row[first + _INSIDE[w]] = np.uint8(MISS) if free else np.uint8(0)


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
        count = list_row(reach[row], row_i, row_j, row_k, voxels, count)
    return count


@njit(cache=True)
def list_ends(points: Array, max_range: Float, pose: Array, voxel_size: Float, voxels: Array) -> Int:
    """List the voxel of each of `points` (n, 3) float64 [m, sensor frame] that is not farther than max_range [m].

    pose   : (12,) float64, R_map_sensor row by row and t_map_sensor
    voxels : (n, 3) int32, filled in place from the start. Returns how many there are.
    """
    per_voxel = 1.0 / voxel_size
    count = 0
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if np.sqrt(x * x + y * y + z * z) <= max_range:
            for axis in range(3):
                a = pose[3 * axis] * x + pose[3 * axis + 1] * y + pose[3 * axis + 2] * z + pose[9 + axis]
                voxels[count, axis] = np.int32(np.floor(a * per_voxel))
            count += 1
    return count
