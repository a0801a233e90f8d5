"""Boxes of voxels out of hashed blocks: dense copies and extremes."""

from __future__ import annotations

from typing import Any, TypeAlias

from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any


@njit(cache=True)
def highest_in_cells(table: Array, field: Array, corners: Array, edge: Int, values: Array) -> None:
    """The highest of the voxels of `field` (capacity, 512) in each cube of voxels; `values` (n,) keeps what it holds
    where no block exists or nothing is higher.

    corners : (n, 3) int64, lowest voxel of each cube, a multiple of `edge`, its edge in voxels (a power of two)
    """
    for n in range(corners.shape[0]):
        i0, j0, k0 = corners[n, 0], corners[n, 1], corners[n, 2]
        inner = min(edge, 8)
        for bi in range(i0 >> 3, (i0 + edge - 1 >> 3) + 1):
            for bj in range(j0 >> 3, (j0 + edge - 1 >> 3) + 1):
                for bk in range(k0 >> 3, (k0 + edge - 1 >> 3) + 1):
                    slot = lookup(table, bi, bj, bk)
                    if slot < 0:
                        continue
                    for i in range(i0 & 7, (i0 & 7) + inner):
                        for j in range(j0 & 7, (j0 & 7) + inner):
                            for k in range(k0 & 7, (k0 & 7) + inner):
                                values[n] = max(values[n], field[slot, i << 6 | j << 3 | k])


@njit(cache=True)
def copy_box(box: Array, table: Array, field: Array, first: Array) -> None:
    """Copy the voxels of `field` (capacity, 512) that exist into `box` (nx, ny, nz), in place; the rest stays as it is.

    first : (3,) voxel index of box[0, 0, 0]
    """
    i0, j0, k0 = first[0], first[1], first[2]
    i1, j1, k1 = i0 + box.shape[0], j0 + box.shape[1], k0 + box.shape[2]
    for bi in range(i0 >> 3, ((i1 - 1) >> 3) + 1):
        for bj in range(j0 >> 3, ((j1 - 1) >> 3) + 1):
            for bk in range(k0 >> 3, ((k1 - 1) >> 3) + 1):
                slot = lookup(table, bi, bj, bk)
                if slot < 0:
                    continue
                for i in range(max(i0, bi * 8), min(i1, bi * 8 + 8)):
                    for j in range(max(j0, bj * 8), min(j1, bj * 8 + 8)):
                        for k in range(max(k0, bk * 8), min(k1, bk * 8 + 8)):
                            box[i - i0, j - j0, k - k0] = field[slot, (i & 7) << 6 | (j & 7) << 3 | (k & 7)]
