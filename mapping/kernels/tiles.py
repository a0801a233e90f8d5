"""Kernels that all 2.5-D layers share: the heights of one scan, sorted into the cells of the ground.

A *tile* is a block of 8 × 8 cells of the ground with index (i, j, 0); a cell has index lx·8 + ly within it.
A scan is first *grouped*: row r of `tiles` names the r-th tile that it touches, and the heights of cell w of that tile
are heights[starts[64·r + w] : starts[64·r + w + 1]], in the order of the scan.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, find_or_insert, lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

OUT_OF_ROOM, OUT_OF_RANGE = -1, -2
"""What `group_by_cell` answers when there are more tiles than room, and when a point is NaN or cannot be addressed."""


@njit(cache=True, error_model="numpy")
def points_of_image(depth: Array, fx: float, fy: float, cx: float, cy: float, points: Array) -> Int:
    """The points of a depth image (H, W) float32 [m], 0 or NaN where there are none, in the camera's optical frame.

    Fills the first rows of points (H·W, 3) float64; returns how many.
    """
    n = 0
    for v in range(depth.shape[0]):
        y = (v - cy) / fy
        for u in range(depth.shape[1]):
            z = np.float64(depth[v, u])
            if z > 0.0 and z < np.inf:
                points[n, 0] = z * (u - cx) / fx
                points[n, 1] = z * y
                points[n, 2] = z
                n += 1
    return n


@njit(cache=True, error_model="numpy")
def group_by_cell(
    p_sensor: Array,
    pose: Array,
    noise: Array,
    limits: Array,
    table: Array,
    tiles: Array,
    keys: Array,
    scratch: Array,
    starts: Array,
    heights: Array,
    weights: Array,
) -> Int:
    """Sort the points of a scan into the cells of the ground, in place.

    p_sensor  : (n, 3) float64 [m];  pose (12,) R_map_sensor row by row, then t_map_sensor
    noise     : (4,) σ of a range [m], its growth with range [-], σ of a beam's direction [rad], least σ of a height [m]
    limits    : (3,) cells per metre, largest range [m], greatest height above the sensor that counts [m]
    table     : empty, room for more than `room` tiles;  tiles (room, 3) int32
    keys      : (n,) int32;  scratch (n, 2) float64
    starts    : (64·room + 1,) int32;  heights, weights (n,) float64, a weight is 1/variance [1/m²]
    Returns the number of tiles, OUT_OF_ROOM or OUT_OF_RANGE.

    A point's height varies with its range r by σ_r·sin(elevation), with its beam by σ_beam·(distance over ground).
    """
    per_cell, farthest, above = limits[0], limits[1], limits[2]
    bound = 8.0 * BLOCK_LIMIT
    room = tiles.shape[0]
    n_tiles = np.int64(0)
    last_i = last_j = np.int64(BLOCK_LIMIT)
    row: Int = np.int64(0)
    for n in range(p_sensor.shape[0]):
        x, y, z = p_sensor[n, 0], p_sensor[n, 1], p_sensor[n, 2]
        range_squared = x * x + y * y + z * z
        keys[n] = -1
        if not range_squared < np.inf:
            return OUT_OF_RANGE
        rise = pose[6] * x + pose[7] * y + pose[8] * z
        if range_squared > farthest * farthest or rise > above:
            continue
        i_real = np.floor((pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) * per_cell)
        j_real = np.floor((pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) * per_cell)
        if not (abs(i_real) < bound and abs(j_real) < bound):
            return OUT_OF_RANGE
        i, j = np.int64(i_real), np.int64(j_real)
        if (i >> 3) != last_i or (j >> 3) != last_j:
            last_i, last_j = i >> 3, j >> 3
            if n_tiles == room:
                row = lookup(table, last_i, last_j, 0)
                if row < 0:
                    return OUT_OF_ROOM
            else:
                row = find_or_insert(table, last_i, last_j, 0, n_tiles)
            if row == n_tiles:
                tiles[row, 0] = last_i
                tiles[row, 1] = last_j
                tiles[row, 2] = 0
                starts[64 * row + 1 : 64 * row + 65] = 0
                n_tiles += 1
        key = 64 * row + ((i & 7) << 3 | (j & 7))
        keys[n] = key
        starts[key + 1] += 1
        scratch[n, 0] = rise + pose[11]
        sigma = noise[0] + noise[1] * np.sqrt(range_squared)
        flat_squared = range_squared - rise * rise
        along = sigma * sigma * rise * rise / range_squared if range_squared > 0.0 else sigma * sigma
        scratch[n, 1] = 1.0 / (along + noise[2] * noise[2] * flat_squared + noise[3] * noise[3])
    starts[0] = 0
    for c in range(64 * n_tiles):
        starts[c + 1] += starts[c]
    n_kept = starts[64 * n_tiles]
    for n in range(p_sensor.shape[0] - 1, -1, -1):  # from behind: `starts` moves from the cells' ends to their starts
        key = keys[n]
        if key >= 0:
            starts[key + 1] -= 1
            at = starts[key + 1]
            heights[at] = scratch[n, 0]
            weights[at] = scratch[n, 1]
    for c in range(64 * n_tiles):
        starts[c] = starts[c + 1]
    starts[64 * n_tiles] = n_kept
    return n_tiles


@njit(cache=True, error_model="numpy")
def locate_cells(table: Array, xy: Array, per_cell: float, slots: Array, local: Array) -> None:
    """Where the cell of each point (n, 2) [m] is stored: slot (−1: nowhere) and index within the tile, in place."""
    last_i = last_j = np.int64(BLOCK_LIMIT)
    last_slot: Int = np.int64(-1)
    bound = 8.0 * BLOCK_LIMIT
    for n in range(xy.shape[0]):
        x, y = np.floor(xy[n, 0] * per_cell), np.floor(xy[n, 1] * per_cell)
        slots[n] = -1
        local[n] = 0
        if not (abs(x) < bound and abs(y) < bound):  # also NaN
            continue
        i, j = np.int64(x), np.int64(y)
        if (i >> 3) != last_i or (j >> 3) != last_j:
            last_i, last_j = i >> 3, j >> 3
            last_slot = lookup(table, last_i, last_j, 0)
        slots[n] = last_slot
        local[n] = (i & 7) << 3 | (j & 7)


@njit(cache=True, inline="always", error_model="numpy")
def pose_variance(tiles: Array, row: Int, w: Int, cell_size: Float, pose: Array, quadratic: Array) -> Float:
    """The variance [m²] that an uncertain pose gives to all heights of a cell; it grows with the way to its centre.

    quadratic : (6,) factors of 1, x, y, x², xy, y² of the way (x, y) from the sensor to the cell, in map
    """
    x = (8 * tiles[row, 0] + (w >> 3) + 0.5) * cell_size - pose[9]
    y = (8 * tiles[row, 1] + (w & 7) + 0.5) * cell_size - pose[10]
    return (
        quadratic[0]
        + quadratic[1] * x
        + quadratic[2] * y
        + quadratic[3] * x * x
        + quadratic[4] * x * y
        + quadratic[5] * y * y
    )


@njit(cache=True, error_model="numpy")
def split_at_gaps(heights: Array, start: Int, end: Int, gap: Float, lows: Array, highs: Array) -> Int:
    """Cut heights [start, end) into intervals with more than `gap` [m] between them; the lowest come first.

    Fills lows, highs (≥ end − start,) with the ends of the intervals, in place. Returns how many.
    """
    m = end - start
    low = high = heights[start]
    for k in range(start + 1, end):
        low, high = min(low, heights[k]), max(high, heights[k])
    lows[0], highs[0] = low, high
    if high - low <= gap:
        return 1
    n = 0
    buckets = np.int64(2.0 * (high - low) / gap) + 1
    if buckets < m:  # buckets of half a gap: no gap fits into one
        for a in range(buckets):
            lows[a], highs[a] = np.inf, -np.inf
        for k in range(start, end):
            bucket = np.int64(2.0 * (heights[k] - low) / gap)
            lows[bucket], highs[bucket] = min(lows[bucket], heights[k]), max(highs[bucket], heights[k])
        for a in range(1, buckets):
            if lows[a] - highs[n] > gap and lows[a] < np.inf:
                n += 1
                lows[n], highs[n] = lows[a], highs[a]
            else:
                highs[n] = max(highs[n], highs[a])
        return n + 1
    for k in range(m):
        lows[k] = heights[start + k]
    apart = 1
    while 9 * apart < m:
        apart = 3 * apart + 1
    while apart > 0:  # Shell's sort with Knuth's steps: mostly there are few
        for k in range(apart, m):
            value = lows[k]
            to = k
            while to >= apart and lows[to - apart] > value:
                lows[to] = lows[to - apart]
                to -= apart
            lows[to] = value
        apart //= 3
    last = low
    for k in range(1, m):
        value = lows[k]
        if value - last > gap:
            highs[n] = last
            n += 1
            lows[n] = value
        last = value
    highs[n] = last
    return n + 1
