"""Where a signed distance field crosses zero: one sample a voxel, block by block."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


@njit(cache=True)
def pad_block(table: Array, distance: Array, weight: Array, bi: Int, bj: Int, bk: Int, padded: Array) -> None:
    """Copy block (bi, bj, bk) and one voxel of its neighbours all round into `padded` (10, 10, 10) float32, in place.

    Voxels of weight 0 become NaN.
    """
    nothing = np.float32(np.nan)
    for di in range(-1, 2):
        i0, i1 = (0, 1) if di < 0 else ((1, 9) if di == 0 else (9, 10))
        for dj in range(-1, 2):
            j0, j1 = (0, 1) if dj < 0 else ((1, 9) if dj == 0 else (9, 10))
            for dk in range(-1, 2):
                k0, k1 = (0, 1) if dk < 0 else ((1, 9) if dk == 0 else (9, 10))
                slot = lookup(table, bi + di, bj + dj, bk + dk)
                for i in range(i0, i1):
                    for j in range(j0, j1):
                        for k in range(k0, k1):
                            if slot < 0:
                                padded[i, j, k] = nothing
                            else:
                                local = ((i - 1) & 7) << 6 | ((j - 1) & 7) << 3 | ((k - 1) & 7)
                                known = weight[slot, local] > np.float32(0.0)
                                padded[i, j, k] = distance[slot, local] if known else nothing


@njit(cache=True, parallel=True, error_model="numpy")
def sample_surface(
    table: Array,
    distance: Array,
    weight: Array,
    voxel_size: Float,
    max_jump: Float,
    blocks: Array,
    samples: Array,
    counts: Array,
) -> None:
    """Sample the zero crossing in each voxel of `blocks` (n, 3) that has one towards its next voxel along an axis.

    max_jump : neighbours whose distances differ by more [m] are an edge between two surfaces, not a surface
    samples  : (n, 512, 6) float32, filled: x, y, z, and the unit normal into free space
    counts   : (n,) int64, filled: how many samples each block has
    """
    for n in prange(blocks.shape[0]):
        padded = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], padded)
        base0, base1, base2 = 8.0 * blocks[n, 0] - 0.5, 8.0 * blocks[n, 1] - 0.5, 8.0 * blocks[n, 2] - 0.5
        count = 0
        for i in range(1, 9):
            for j in range(1, 9):
                for k in range(1, 9):
                    here = padded[i, j, k]
                    if not abs(here) < max_jump:
                        continue
                    x = y = z = 0.0
                    crossings = 0
                    inside = here < 0.0
                    there = padded[i + 1, j, k]
                    if (there < 0.0) != inside and abs(there - here) < max_jump:
                        x += here / (here - there)
                        crossings += 1
                    there = padded[i, j + 1, k]
                    if (there < 0.0) != inside and abs(there - here) < max_jump:
                        y += here / (here - there)
                        crossings += 1
                    there = padded[i, j, k + 1]
                    if (there < 0.0) != inside and abs(there - here) < max_jump:
                        z += here / (here - there)
                        crossings += 1
                    if crossings == 0:
                        continue
                    g0 = slope(padded[i - 1, j, k], here, padded[i + 1, j, k], max_jump)
                    g1 = slope(padded[i, j - 1, k], here, padded[i, j + 1, k], max_jump)
                    g2 = slope(padded[i, j, k - 1], here, padded[i, j, k + 1], max_jump)
                    norm = np.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
                    if not norm > 0.0:
                        continue
                    samples[n, count, 0] = (base0 + i + x / crossings) * voxel_size
                    samples[n, count, 1] = (base1 + j + y / crossings) * voxel_size
                    samples[n, count, 2] = (base2 + k + z / crossings) * voxel_size
                    samples[n, count, 3] = g0 / norm
                    samples[n, count, 4] = g1 / norm
                    samples[n, count, 5] = g2 / norm
                    count += 1
        counts[n] = count


@njit(cache=True)
def gather_samples(samples: Array, counts: Array, points: Array, normals: Array) -> None:
    """Put the first counts (n,) of the samples (n, 512, 6) of each block one behind the other: fills points and normals
    (N, 3) float32."""
    row = 0
    for n in range(counts.shape[0]):
        for k in range(counts[n]):
            for a in range(3):
                points[row, a], normals[row, a] = samples[n, k, a], samples[n, k, a + 3]
            row += 1


@njit(cache=True)
def slope(before: Float, here: Float, after: Float, max_jump: Float) -> Float:
    """Derivative a voxel from those of two neighbours that are known and not across an edge; 0 when none is."""
    total = 0.0
    sides = 0
    if abs(here - before) < max_jump:
        total += here - before
        sides += 1
    if abs(after - here) < max_jump:
        total += after - here
        sides += 1
    return total / sides if sides > 0 else 0.0
