"""Rays through the octree: what do they meet first? Uniform cells are crossed in one step."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.cells import UNKNOWN, find_cell, uniform, value_of
from mapping.kernels.hashing import BLOCK_LIMIT

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

_PART = 256


@njit(cache=True, inline="always")
def leave(low: Int, edge: Int, origin: Float, direction: Float) -> Float:
    """How far along a ray [voxels] one axis of the cube from voxel `low` on, `edge` voxels wide, is left."""
    if direction > 0.0:
        return (low + edge - origin) / direction
    if direction < 0.0:
        return (low - origin) / direction
    return np.inf


@njit(cache=True, parallel=True, error_model="numpy")
def first_hits(
    table: Array, slot: Array, payload: Array, top: Int, level: Array, origins: Array, directions: Array,
    reach: Float, stop_at_unknown: bool, distance: Array, unknown_at: Array, met: Array,
) -> None:  # fmt: skip
    """Follow rays through the tree of `mapping.kernels.cells` until a voxel is occupied.

    origins, directions : (n, 3) in voxels, directions of unit length; reach: where rays end [voxels]
    distance   : (n,) filled: the way to the occupied voxel, or to where the ray ended [voxels]
    unknown_at : (n,) filled: the way to the first voxel of which nothing is known, infinite where there is none
    met        : (n,) int8, filled: 1 occupied; 0 nothing; −1 nothing, but unknown voxels were passed
    """
    bound = 8.0 * BLOCK_LIMIT
    for p in prange(-(-origins.shape[0] // _PART)):
        for n in range(p * _PART, min(origins.shape[0], (p + 1) * _PART)):
            o0, o1, o2 = origins[n, 0], origins[n, 1], origins[n, 2]
            d0, d1, d2 = directions[n, 0], directions[n, 1], directions[n, 2]
            i, j, k = np.int64(np.floor(o0)), np.int64(np.floor(o1)), np.int64(np.floor(o2))
            t = 0.0
            distance[n], unknown_at[n], met[n] = reach, np.inf, 0
            while t <= reach and max(abs(i), abs(j), abs(k)) < bound:
                row = find_cell(table, top, i >> 3, j >> 3, k >> 3)
                at = np.int64(uniform(UNKNOWN)) if row < 0 else np.int64(slot[row])
                dense = at >= 0
                value = np.int64(payload[at, (i & 7) << 6 | (j & 7) << 3 | (k & 7)] if dense else value_of(at))
                if value >= 0:
                    distance[n], met[n] = t, 1
                    break
                if value == UNKNOWN and unknown_at[n] == np.inf:
                    unknown_at[n], met[n] = t, -1
                    if stop_at_unknown:
                        distance[n] = t
                        break
                # To the far side of what is the same all over: the voxel, the missing block or the cell.
                bits = 0 if dense else 3 if row < 0 else 3 + np.int64(level[row])
                low_i, low_j, low_k = i >> bits << bits, j >> bits << bits, k >> bits << bits
                t0, t1, t2 = (
                    leave(low_i, 1 << bits, o0, d0),
                    leave(low_j, 1 << bits, o1, d1),
                    leave(low_k, 1 << bits, o2, d2),
                )
                t = max(t, min(t0, min(t1, t2)))
                # The axis that is crossed moves by an index; the others are where the ray is, inside the cube.
                high = (1 << bits) - 1
                a, b, c = (
                    np.int64(np.floor(o0 + t * d0)),
                    np.int64(np.floor(o1 + t * d1)),
                    np.int64(np.floor(o2 + t * d2)),
                )
                i = min(max(a, low_i), low_i + high)
                j = min(max(b, low_j), low_j + high)
                k = min(max(c, low_k), low_k + high)
                if t0 <= t1 and t0 <= t2:
                    i = low_i + high + 1 if d0 > 0.0 else low_i - 1
                elif t1 <= t2:
                    j = low_j + high + 1 if d1 > 0.0 else low_j - 1
                else:
                    k = low_k + high + 1 if d2 > 0.0 else low_k - 1
