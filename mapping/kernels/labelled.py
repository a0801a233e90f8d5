"""Where the labelled voxel next to a point is, and what a turned box holds."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup
from mapping.kernels.packed import row_of

Array: TypeAlias = NDArray[Any]
Float: TypeAlias = Any
Int: TypeAlias = Any


@njit(cache=True, inline="always")
def _is_labelled(records: Array, row: Int, least: Float) -> Any:
    """Whether a record (2k + 1,), see `mapping.kernels.evidence`, has a class and evidence ≥ `least` [1/UNIT]."""
    k = records.shape[1] // 2
    held = np.int64(records[row, 2 * k])
    counted = np.int64(0)
    for c in range(k):
        counted += records[row, k + c]
    return counted > 0 and held + counted >= least


@njit(cache=True)
def nearest_cells(
    table: Array,
    masks: Array,
    first: Array,
    records: Array,
    least: Float,
    points: Array,
    voxel: Float,
    reach: Float,
    cells: Array,
) -> None:
    """The cell (n,) int64 of the labelled voxel nearest to each point (n, 3) [m], in place; −1 where none is near.

    That of the voxel in which the point lies, if it has a label; else of those whose centres lie within `reach` [m]
    that with the nearest centre, of equally near ones the first in order of i, j, k.
    least : evidence [1/UNIT] from which a record is a label
    """
    steps = np.int64(np.ceil(reach / voxel))
    bound = 8.0 * (BLOCK_LIMIT - 1) - steps
    last_i: Int = np.int64(BLOCK_LIMIT)
    last_j: Int = np.int64(BLOCK_LIMIT)
    last_k: Int = np.int64(BLOCK_LIMIT)
    slot: Int = np.int64(-1)
    for n in range(points.shape[0]):
        cells[n] = -1
        x, y, z = points[n, 0] / voxel, points[n, 1] / voxel, points[n, 2] / voxel
        if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
            continue
        ci, cj, ck = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        best = (reach / voxel) ** 2 * (1.0 + 1e-12)
        for ring in range(2):  # the voxel itself, then all about it
            r = 0 if ring == 0 else steps
            if cells[n] >= 0:
                break
            for i in range(ci - r, ci + r + 1):
                for j in range(cj - r, cj + r + 1):
                    for k in range(ck - r, ck + r + 1):
                        far = (i + 0.5 - x) ** 2 + (j + 0.5 - y) ** 2 + (k + 0.5 - z) ** 2
                        if ring == 1 and not (far < best or (far == best and cells[n] < 0)):
                            continue
                        bi, bj, bk = i >> 3, j >> 3, k >> 3
                        if bi != last_i or bj != last_j or bk != last_k:
                            last_i, last_j, last_k = bi, bj, bk
                            slot = np.int64(lookup(table, bi, bj, bk))
                        if slot < 0:
                            continue
                        cell = slot << 9 | (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                        row = row_of(masks, first, cell)
                        if row >= 0 and _is_labelled(records, row, least):
                            best = far
                            cells[n] = cell


@njit(cache=True)
def count_box(
    evidence: Array, corner: Array, voxel: Float, centre: Array, axes: Array, half: Array, counts: Array, solid: Array
) -> Int:
    """Count the voxels whose centres lie in a box: occupied, free and unknown, in place; returns how many of them are
    listed.

    evidence (nx, ny, nz) int8 of the voxels from `corner` (3,) on: −128 unknown, ≥ 0 occupied; voxel: edge [m]
    centre (3,) [m], axes (3, 3) its columns, half (3,) [m]: the box; its lower faces belong to it, its upper ones not
    counts (3,) int64; solid (m, 3) int64: the occupied voxels, as many as fit
    """
    n = 0
    for i in range(evidence.shape[0]):
        x = (corner[0] + i + 0.5) * voxel - centre[0]
        for j in range(evidence.shape[1]):
            y = (corner[1] + j + 0.5) * voxel - centre[1]
            for k in range(evidence.shape[2]):
                z = (corner[2] + k + 0.5) * voxel - centre[2]
                inside = True
                for a in range(3):
                    away = x * axes[0, a] + y * axes[1, a] + z * axes[2, a]
                    inside = inside and -half[a] <= away < half[a]
                if not inside:
                    continue
                value = evidence[i, j, k]
                counts[0 if value >= 0 else 2 if value == -128 else 1] += 1
                if value >= 0:
                    if n < solid.shape[0]:
                        solid[n, 0], solid[n, 1], solid[n, 2] = corner[0] + i, corner[1] + j, corner[2] + k
                    n += 1
    return n
