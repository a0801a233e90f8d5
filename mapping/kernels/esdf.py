"""Signed distances in hashed blocks: mended where sites changed, interpolated where they are asked for."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup
from mapping.kernels.nearest import LOWEST, find_nearest, gap
from mapping.kernels.sites import BEHIND, FREE, OCCUPIED
from mapping.kernels.surface import slope

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

POINTS = 2048
"""Points that one thread looks up at a time."""
_MANY = 128
"""So many changes of sites cost as much as looking for the nearest sites of all voxels of a block."""


@njit(cache=True)
def decode(
    stored: Array, targets: Array, side: Float, voxel_size: Float, values: Array, squared: Array, wanted: Array
) -> bool:
    """The squared distances (512,) int32 [voxels²] behind a block's stored ones (512,) [m], filled; −1: no target.

    targets : (8,) uint64, the voxels that lie on this side, 1 outside and −1 inside
    values  : (far + 1,) float32, see `mend_from_classes`
    wanted  : (512,) bool, filled: targets of which no distance on this side is stored; their squared one is `far`

    Returns whether there is any target.
    """
    far = values.shape[0] - 1
    some = np.uint64(0)
    for x in range(8):
        some |= targets[x]
    if some == 0:
        return False
    for w in range(512):
        is_target = (targets[w >> 6] >> np.uint64(w & 63)) & np.uint64(1) != 0
        distance = side * stored[w]
        root = np.float64(distance) / voxel_size + 0.5
        known = distance > np.float32(0.0)
        wanted[w] = is_target & (not known)
        whole = np.int32(root * root + 0.5) if known & (distance < values[far]) else np.int32(far)
        squared[w] = whole if is_target else np.int32(-1)
    return True


@njit(cache=True)
def apply_sites(words: Array, toward: Array, reach: Int, vanish: bool, far: Int, squared: Array, wanted: Array) -> None:
    """Let sites, bits (8,) uint64 of a block, appear or vanish for the 512 voxels of another, in place.

    toward  : (3,) from the first voxel of the other block to that of the sites'
    reach   : sites farther than this squared distance from all voxels of the other block change nothing
    squared : (512,) int32; a site that appears comes to all voxels to which it is nearer
    wanted  : (512,) bool; a site that vanishes leaves all voxels that are as far as it
    """
    planar = np.empty(8, np.int32)
    for lx in range(8):
        if words[lx] == 0:
            continue
        for ly in range(8):
            byte = np.int64((words[lx] >> np.uint64(8 * ly)) & np.uint64(255))
            s0, s1 = toward[0] + lx, toward[1] + ly
            between = gap(s0, s0, 0, 7) ** 2 + gap(s1, s1, 0, 7) ** 2
            while byte:
                s2 = toward[2] + LOWEST[byte]
                byte &= byte - 1
                if between + gap(s2, s2, 0, 7) ** 2 > reach:
                    continue
                for z in range(8):
                    planar[z] = (s2 - z) ** 2
                for row in range(64):
                    across = np.int32((s0 - (row >> 3)) ** 2 + (s1 - (row & 7)) ** 2)
                    for z in range(8):
                        w = row << 3 | z
                        away = np.int32(planar[z] + across)
                        if vanish:
                            wanted[w] |= (away == squared[w]) & (away < far)
                        else:
                            squared[w] = min(squared[w], away)


@njit(cache=True)
def count_changes(appeared: Array, vanished: Array, plane: Int, rows: Array) -> Int:
    """How many sites of a plane changed in the `rows` (n,) of appeared, vanished (k, 2, 8)."""
    count = 0
    for n in rows:
        for x in range(8):
            both = appeared[n, plane, x] | vanished[n, plane, x]
            while both:
                both &= both - np.uint64(1)
                count += 1
    return count


@njit(cache=True, parallel=True)
def mend_from_classes(
    distance: Array,
    reach: Array,
    planes: Array,
    values: Array,
    voxel_size: Float,
    grid: Array,
    offsets: Array,
    targets: Array,
    changed_of: Array,
    first_of: Array,
    cells: Array,
    appeared: Array,
    vanished: Array,
    changed: Array,
) -> None:
    """Make the distances of blocks right after sites appeared and vanished, in place.

    distance   : (capacity, 512) float32 [m]: positive in FREE voxels, negative in OCCUPIED ones, NaN in others
    reach      : (capacity, 2) int32, written: the largest squared distance to an OCCUPIED, to a FREE voxel
    planes     : (capacity, 2, 8) uint64, bits of OCCUPIED and FREE as they are now
    values     : (far + 1,) float32 [m], the distance that each squared one means; at `far` it is truncated
    grid, offsets                see `mapping.kernels.nearest.find_nearest`
    targets    : (m, 3) int64 cells of the grid to mend; target t is reached by the changes changed_of[first_of[t] :
                 first_of[t + 1]], rows of cells (k, 3) int64, appeared and vanished (k, 2, 8) uint64
    changed    : (m,) bool, filled: whether a distance changed
    """
    far = values.shape[0] - 1
    for t in prange(targets.shape[0]):
        x, y, z = targets[t, 0], targets[t, 1], targets[t, 2]
        slot = grid[x, y, z]
        squared, nearest = np.empty(512, np.int32), np.empty(512, np.int32)
        wanted = np.empty(512, np.bool_)
        toward = np.empty(3, np.int64)
        different = False
        rows = changed_of[first_of[t] : first_of[t + 1]]
        for plane in range(2):
            is_inside = plane == FREE
            side = np.float32(-1.0 if is_inside else 1.0)
            sides = planes[slot, OCCUPIED if is_inside else FREE]
            limit = np.int64(reach[slot, plane])
            reach[slot, plane] = 0
            if not decode(distance[slot], sides, side, voxel_size, values, squared, wanted):
                continue
            count = count_changes(appeared, vanished, plane, rows)
            if count == 0 and not wanted.any():
                reach[slot, plane] = limit
                continue
            if count > _MANY:
                for w in range(512):
                    wanted[w] = squared[w] >= 0
            else:
                for vanish in (True, False):
                    for n in rows:
                        for a in range(3):
                            toward[a] = 8 * (cells[n, a] - targets[t, a])
                        words = vanished[n, plane] if vanish else appeared[n, plane]
                        apply_sites(words, toward, limit, vanish, far, squared, wanted)
            find_nearest(planes, plane, grid, (x, y, z), offsets, far, wanted, squared, nearest)
            top = np.int32(0)
            for w in range(512):
                if squared[w] >= 0:
                    new = side * values[min(squared[w], far)]
                    different |= distance[slot, w] != new
                    distance[slot, w] = new
                    top = max(top, min(squared[w], np.int32(far)))
            reach[slot, plane] = top
        for w in range(512):
            known = (planes[slot, OCCUPIED, w >> 6] | planes[slot, FREE, w >> 6]) >> np.uint64(w & 63)
            if known & np.uint64(1) == 0:
                different |= not np.isnan(distance[slot, w])
                distance[slot, w] = np.nan
        changed[t] = different


@njit(cache=True)
def value_at(table: Array, distance: Array, weight: Array, i: Int, j: Int, k: Int) -> Float:
    """The signed distance of voxel (i, j, k); NaN where unknown."""
    slot = lookup(table, i >> 3, j >> 3, k >> 3)
    local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
    return distance[slot, local] if slot >= 0 and weight[slot, local] > np.float32(0.0) else np.float32(np.nan)


@njit(cache=True, error_model="numpy")
def find_foot(table: Array, distance: Array, weight: Array, i: Int, j: Int, k: Int, foot: Array) -> None:
    """The way [voxels] from a site to its surface, taken as the plane that its distance and gradient give; fills foot
    (3,)."""
    here = value_at(table, distance, weight, i, j, k)
    g0 = slope(
        value_at(table, distance, weight, i - 1, j, k), here, value_at(table, distance, weight, i + 1, j, k), np.inf
    )
    g1 = slope(
        value_at(table, distance, weight, i, j - 1, k), here, value_at(table, distance, weight, i, j + 1, k), np.inf
    )
    g2 = slope(
        value_at(table, distance, weight, i, j, k - 1), here, value_at(table, distance, weight, i, j, k + 1), np.inf
    )
    norm = max(np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), 1e-12)
    length = min(abs(here) / norm, 1.0) / norm  # a site is within one voxel of its surface
    length = -length if here >= np.float32(0.0) else length
    foot[0], foot[1], foot[2] = length * g0, length * g1, length * g2


@njit(cache=True, parallel=True)
def mend_from_crossings(
    distance: Array,
    reach: Array,
    planes: Array,
    source_table: Array,
    source_distance: Array,
    source_weight: Array,
    far: Int,
    voxel_size: Float,
    truncation: Float,
    grid: Array,
    first: Array,
    offsets: Array,
    targets: Array,
    changed: Array,
) -> None:
    """Work out the distances of blocks anew after crossings of the source's signed distances changed, in place.

    source_*      : the source's hash, signed distances [m] and weights (0: unknown)
    first         : (3,) the block of the grid's first cell; planes (capacity, 2, 8) uint64 of BEFORE and BEHIND
    the rest as in `mend_from_classes`; sites at squared distance `far` or beyond are none
    """
    for t in prange(targets.shape[0]):
        x, y, z = targets[t, 0], targets[t, 1], targets[t, 2]
        slot = grid[x, y, z]
        bi, bj, bk = first[0] + x, first[1] + y, first[2] + z
        source = lookup(source_table, bi, bj, bk)
        squared, nearest = np.empty(512, np.int32), np.empty(512, np.int32)
        wanted = np.empty(512, np.bool_)
        known_feet, feet = np.full(256, -1, np.int32), np.empty((256, 3), np.float64)
        different = False
        for plane in range(2):
            side = -1.0 if plane == BEHIND else 1.0
            for w in range(512):
                here = source_distance[source, w]
                wanted[w] = ((here < 0.0) == (plane == BEHIND)) & (source_weight[source, w] > 0.0)
            find_nearest(planes, plane, grid, (x, y, z), offsets, far, wanted, squared, nearest)
            top = np.int32(0)
            for w in range(512):
                if not wanted[w]:
                    continue
                top = max(top, squared[w])
                new = truncation
                if squared[w] < far:
                    s0, s1, s2 = (nearest[w] >> 20) - 512, (nearest[w] >> 10 & 1023) - 512, (nearest[w] & 1023) - 512
                    row = (nearest[w] ^ nearest[w] >> 9 ^ nearest[w] >> 17) & 255
                    if known_feet[row] != nearest[w]:
                        known_feet[row] = nearest[w]
                        find_foot(
                            source_table,
                            source_distance,
                            source_weight,
                            8 * bi + s0,
                            8 * bj + s1,
                            8 * bk + s2,
                            feet[row],
                        )
                    d0 = (w >> 6) - s0 - feet[row, 0]
                    d1 = ((w >> 3) & 7) - s1 - feet[row, 1]
                    d2 = (w & 7) - s2 - feet[row, 2]
                    new = min(np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) * voxel_size, truncation)
                rounded = np.float32(side * new)
                different |= distance[slot, w] != rounded
                distance[slot, w] = rounded
            reach[slot, plane] = top
        for w in range(512):
            if not source_weight[source, w] > 0.0:
                different |= not np.isnan(distance[slot, w])
                distance[slot, w] = np.nan
        changed[t] = different


@njit(cache=True)
def read_corners(table: Array, distance: Array, i: Int, j: Int, k: Int, corners: Array) -> bool:
    """The distances of the voxels (i … i + 1, j … j + 1, k … k + 1), fills corners (8,); whether all have a block."""
    slot = lookup(table, i >> 3, j >> 3, k >> 3)
    if slot < 0:
        return False
    x, y, z = i & 7, j & 7, k & 7
    if x < 7 and y < 7 and z < 7:
        stored = distance[slot]
        local = x << 6 | y << 3 | z
        corners[0], corners[1] = stored[local], stored[local + 1]
        corners[2], corners[3] = stored[local + 8], stored[local + 9]
        corners[4], corners[5] = stored[local + 64], stored[local + 65]
        corners[6], corners[7] = stored[local + 72], stored[local + 73]
        return True
    bi, bj, bk = i >> 3, j >> 3, k >> 3
    for corner in range(8):
        a, b, c = i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1)
        if a >> 3 != bi or b >> 3 != bj or c >> 3 != bk:
            bi, bj, bk = a >> 3, b >> 3, c >> 3
            slot = lookup(table, bi, bj, bk)
            if slot < 0:
                return False
        corners[corner] = distance[slot, (a & 7) << 6 | (b & 7) << 3 | (c & 7)]
    return True


@njit(cache=True)
def interpolate_some(
    table: Array,
    distance: Array,
    voxel_size: Float,
    p_map: Array,
    first: Int,
    last: Int,
    values: Array,
    gradients: Array,
) -> None:
    """Trilinear distance (n,) [m] and its gradient (n, 3) at the points (n, 3) [m] from `first` to before `last`, in
    place; NaN where one of the eight voxels about it is unknown. gradients may have no rows: then there are none."""
    per_voxel = 1.0 / voxel_size
    bound = 8.0 * BLOCK_LIMIT - 2.0
    c = np.empty(8, np.float64)
    for n in range(first, last):
        x, y, z = p_map[n, 0] * per_voxel - 0.5, p_map[n, 1] * per_voxel - 0.5, p_map[n, 2] * per_voxel - 0.5
        found = False
        if abs(x) < bound and abs(y) < bound and abs(z) < bound:  # not NaN either
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            found = read_corners(table, distance, i, j, k, c)
            x, y, z = x - i, y - j, z - k
        if not found:
            c[:] = np.nan
        # Along z, then y, then x.
        z00, z01, z10, z11 = c[1] - c[0], c[3] - c[2], c[5] - c[4], c[7] - c[6]
        v00, v01, v10, v11 = c[0] + z * z00, c[2] + z * z01, c[4] + z * z10, c[6] + z * z11
        v0, v1 = v00 + y * (v01 - v00), v10 + y * (v11 - v10)
        values[n] = v0 + x * (v1 - v0)
        if gradients.shape[0]:
            gradients[n, 0] = (v1 - v0) * per_voxel
            gradients[n, 1] = ((1.0 - x) * (v01 - v00) + x * (v11 - v10)) * per_voxel
            along_z = (1.0 - x) * ((1.0 - y) * z00 + y * z01) + x * ((1.0 - y) * z10 + y * z11)
            gradients[n, 2] = along_z * per_voxel


@njit(cache=True, parallel=True)
def interpolate(
    table: Array, distance: Array, voxel_size: Float, p_map: Array, values: Array, gradients: Array
) -> None:
    """`interpolate_some` for all points, many at a time."""
    n_points = p_map.shape[0]
    for part in prange((n_points + POINTS - 1) // POINTS):
        last = min((part + 1) * POINTS, n_points)
        interpolate_some(table, distance, voxel_size, p_map, part * POINTS, last, values, gradients)
