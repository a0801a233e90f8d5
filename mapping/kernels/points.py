"""Points sorted into voxels, a bounded sample of them a voxel, and the nearest of those.

A kept point is one 64-bit word: its rank in the upper 16 bits, below it its place in the voxel, 16 bits an axis, in
steps of 1/65 536 of the voxel's edge. The rank is a hash of the place, so comparing words compares ranks, and the set
of the lowest words is the same in whatever order points come.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, home, lookup, pack

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

EMPTY = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
"""Marks room for a point; larger than the word of any point."""

_PLACE = np.uint64(0xFFFF_FFFF_FFFF)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_STEPS = 65536.0


@njit(cache=True, inline="always")
def _enter(table: Array, keys: Array, key: Int, count: Int) -> Int:
    """The row of `key` in `keys`; `count` is entered into the table, in place, where it is not there yet."""
    at = home(key, len(table))
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + 1) & (len(table) - 1)
    if table[at] < 0:
        table[at] = count
    return table[at]


@njit(cache=True)
def sort_into_voxels(
    p_sensor: Array, pose: Array, max_range: Float, per_voxel: Float, rows: Array, offsets: Array
) -> tuple[Array, Int]:
    """The voxels (K, 3) int32 in which points lie, each once, in order of appearance, and how many points are lost.

    p_sensor : (n, 3) float64 [m];  pose : (12,) R_map_sensor row by row, then t_map_sensor
    max_range : points farther from the sensor [m] are left out;  per_voxel : 1 / voxel size [1/m]
    rows     : (n,) int32, in place: row of each point's voxel in what is returned; −1 where it was left out
    offsets  : (n, 3) float32, in place: the point within its voxel, 0 … 1 of the edge

    A point is lost when no voxel has an index for it (see `hashing.BLOCK_LIMIT`).
    """
    keys = np.empty(4096, np.int64)
    table = np.full(2 * len(keys), -1, np.int32)  # rows of `keys`: half the size of a table of the hash itself
    count, lost = 0, 0
    limit = np.float64(BLOCK_LIMIT)
    last_i = last_j = last_k = limit
    last = np.int32(-1)
    for n in range(p_sensor.shape[0]):
        x, y, z = p_sensor[n, 0], p_sensor[n, 1], p_sensor[n, 2]
        rows[n] = -1
        if x * x + y * y + z * z > max_range * max_range:
            continue
        a = (pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) * per_voxel
        b = (pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) * per_voxel
        c = (pose[6] * x + pose[7] * y + pose[8] * z + pose[11]) * per_voxel
        i, j, k = np.floor(a), np.floor(b), np.floor(c)
        if i != last_i or j != last_j or k != last_k:
            if not (-limit <= i < limit and -limit <= j < limit and -limit <= k < limit):
                lost += 1
                continue
            last_i, last_j, last_k = i, j, k
            key = pack(np.int64(i), np.int64(j), np.int64(k))
            last = _enter(table, keys, key, count)
            if last == count:
                keys[count] = key
                count += 1
                if count == len(keys):
                    keys = np.concatenate((keys, np.empty_like(keys), np.empty_like(keys), np.empty_like(keys)))
                    table = np.full(2 * len(keys), -1, np.int32)
                    for m in range(count):
                        _enter(table, keys, keys[m], m)
        rows[n] = last
        offsets[n, 0] = np.float32(a - i)
        offsets[n, 1] = np.float32(b - j)
        offsets[n, 2] = np.float32(c - k)
    found = np.empty((count, 3), np.int32)
    for m in range(count):
        for axis in range(3):
            found[m, axis] = np.int32((keys[m] >> (42 - 21 * axis) & (2 * BLOCK_LIMIT - 1)) - BLOCK_LIMIT)
    return found, lost


@njit(cache=True, inline="always")
def _word(x: Float, y: Float, z: Float) -> Int:
    """The word of a point at x, y, z (0 … 1 of the voxel's edge); the mixing is that of splitmix64 (Steele 2014)."""
    a = np.uint64(np.minimum(np.int64(x * _STEPS), np.int64(65535)))
    b = np.uint64(np.minimum(np.int64(y * _STEPS), np.int64(65535)))
    c = np.uint64(np.minimum(np.int64(z * _STEPS), np.int64(65535)))
    place = a << np.uint64(32) | b << np.uint64(16) | c
    mixed = (place ^ (place >> np.uint64(30))) * _MIX_1
    mixed = (mixed ^ (mixed >> np.uint64(27))) * _MIX_2
    mixed ^= mixed >> np.uint64(31)
    return (mixed << np.uint64(48)) | place


@njit(cache=True)
def make_words(offsets: Array, words: Array) -> None:
    """The words (n,) uint64 of points at `offsets` (n, 3) within their voxels, in place."""
    for n in range(offsets.shape[0]):
        words[n] = _word(offsets[n, 0], offsets[n, 1], offsets[n, 2])


@njit(cache=True)
def keep_points(
    kept: Array,
    kept_intensity: Array,
    kept_color: Array,
    slots: Array,
    rows: Array,
    words: Array,
    intensity: Array,
    color: Array,
    same_cell: Int,
    changed: Array,
) -> None:
    """Offer points to their voxels, each of which keeps the lowest words: one a cell, and no more than it has room for.

    kept           : (capacity, room) uint64, in place, each row in ascending order
    kept_intensity : (capacity, room) float32 and kept_color : (capacity, room) uint32, in place; no rows = not wanted
    slots (k,)     : where each voxel of this scan is kept;  rows (n,) : each point's voxel, −1 = none;  words (n,)
    same_cell      : uint64 mask; points whose words agree under it lie in one cell of a voxel
    changed        : (k,) bool, filled: whether the voxel keeps another set now
    """
    room = kept.shape[1]
    with_intensity, with_color = kept_intensity.shape[0] > 0, kept_color.shape[0] > 0
    changed[:] = False
    for n in range(words.shape[0]):
        row = rows[n]
        if row < 0:
            continue
        s, word = slots[row], words[n]
        if word >= kept[s, room - 1]:
            continue
        at = room - 1
        for m in range(room):
            if (kept[s, m] ^ word) & same_cell == 0 or kept[s, m] == EMPTY:
                at = m
                break
        if kept[s, at] <= word:
            continue
        changed[row] = True
        while at > 0 and kept[s, at - 1] > word:
            kept[s, at] = kept[s, at - 1]
            if with_intensity:
                kept_intensity[s, at] = kept_intensity[s, at - 1]
            if with_color:
                kept_color[s, at] = kept_color[s, at - 1]
            at -= 1
        kept[s, at] = word
        if with_intensity:
            kept_intensity[s, at] = intensity[n]
        if with_color:
            kept_color[s, at] = color[n]


@njit(cache=True, inline="always")
def _place(word: Int, axis: Int) -> Float:
    """Where along an axis a kept point lies in its voxel, 0 … 1."""
    return (np.float64((word >> np.uint64(32 - 16 * axis)) & np.uint64(0xFFFF)) + 0.5) / _STEPS


@njit(cache=True)
def list_points(kept: Array, voxel_ijk: Array, voxel_size: Float, points: Array) -> Int:
    """Write the kept points (N, 3) float32 [m] in the order of their slots, in place; returns how many there are.

    With no rows in `points` they are only counted.
    """
    n = 0
    for s in range(voxel_ijk.shape[0]):
        for m in range(kept.shape[1]):
            if kept[s, m] == EMPTY:
                break
            if points.shape[0]:
                for axis in range(3):
                    points[n, axis] = (voxel_ijk[s, axis] + _place(kept[s, m], axis)) * voxel_size
            n += 1
    return n


@njit(cache=True, inline="always")
def _gap(cell: Int, at: Float) -> Float:
    """Distance from `at` to the interval [cell, cell + 1]."""
    return max(cell - at, at - (cell + 1.0), 0.0)


@njit(cache=True)
def find_nearest(
    table: Array, kept: Array, per_voxel: Float, max_distance: Float, p_map: Array, nearest: Array, distance: Array
) -> None:
    """The kept point nearest to each of `p_map` (n, 3) [m], within `max_distance` [m]; NaN where there is none.

    nearest (n, 3) float64 and distance (n,) float64 [m] change in place. Voxels are searched in growing cubes about the
    point until none that is left can hold a nearer one.
    """
    reach = max_distance * per_voxel
    limit = np.float64(BLOCK_LIMIT)
    for n in range(p_map.shape[0]):
        x, y, z = p_map[n, 0] * per_voxel, p_map[n, 1] * per_voxel, p_map[n, 2] * per_voxel
        nearest[n, 0] = nearest[n, 1] = nearest[n, 2] = distance[n] = np.nan
        if not (abs(x) < limit and abs(y) < limit and abs(z) < limit):  # also NaN
            continue
        i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        margin = min(min(x - i, i + 1.0 - x), min(y - j, j + 1.0 - y), min(z - k, k + 1.0 - z))
        best = reach * reach * (1.0 + 1e-12)
        found = False
        shell = 0
        while shell == 0 or (shell - 1.0 + margin) ** 2 < best:
            for di in range(-shell, shell + 1):
                gap_x = _gap(i + di, x) ** 2
                if gap_x > best:
                    continue
                for dj in range(-shell, shell + 1):
                    gap_xy = gap_x + _gap(j + dj, y) ** 2
                    if gap_xy > best:
                        continue
                    step = 1 if abs(di) == shell or abs(dj) == shell else 2 * shell
                    for dk in range(-shell, shell + 1, step):
                        if gap_xy + _gap(k + dk, z) ** 2 > best:
                            continue
                        s = lookup(table, i + di, j + dj, k + dk)
                        if s < 0:
                            continue
                        for m in range(kept.shape[1]):
                            word = kept[s, m]
                            if word == EMPTY:
                                break
                            a, b, c = i + di + _place(word, 0), j + dj + _place(word, 1), k + dk + _place(word, 2)
                            squared = (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2
                            if squared < best or (squared == best and not found):
                                best, found = squared, True
                                nearest[n, 0], nearest[n, 1], nearest[n, 2] = a, b, c
            shell += 1
        if found:
            distance[n] = np.sqrt(best) / per_voxel
            for axis in range(3):
                nearest[n, axis] /= per_voxel


@njit(cache=True)
def find_within(
    table: Array, kept: Array, per_voxel: Float, radius: Float, p_map: Array, owners: Array, found: Array
) -> Int:
    """All kept points within `radius` [m] of each of `p_map` (n, 3) [m]; returns how many pairs there are.

    owners (m,) int64 : row in p_map, and found (m, 3) float64 [m] : the kept point, in place as far as there is room
    """
    reach = radius * per_voxel
    limit = np.float64(BLOCK_LIMIT)
    count = 0
    for n in range(p_map.shape[0]):
        x, y, z = p_map[n, 0] * per_voxel, p_map[n, 1] * per_voxel, p_map[n, 2] * per_voxel
        if not (abs(x) < limit and abs(y) < limit and abs(z) < limit):  # also NaN
            continue
        for i in range(np.int64(np.floor(x - reach)), np.int64(np.floor(x + reach)) + 1):
            for j in range(np.int64(np.floor(y - reach)), np.int64(np.floor(y + reach)) + 1):
                for k in range(np.int64(np.floor(z - reach)), np.int64(np.floor(z + reach)) + 1):
                    if _gap(i, x) ** 2 + _gap(j, y) ** 2 + _gap(k, z) ** 2 > reach * reach:
                        continue
                    s = lookup(table, i, j, k)
                    if s < 0:
                        continue
                    for m in range(kept.shape[1]):
                        word = kept[s, m]
                        if word == EMPTY:
                            break
                        a, b, c = i + _place(word, 0), j + _place(word, 1), k + _place(word, 2)
                        if (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 <= reach * reach:
                            if count < owners.shape[0]:
                                owners[count] = n
                                found[count, 0], found[count, 1], found[count, 2] = (
                                    a / per_voxel, b / per_voxel, c / per_voxel,
                                )  # fmt: skip
                            count += 1
    return count
