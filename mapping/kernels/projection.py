"""Voxels of a block onto the pixels of a camera."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


_W = np.arange(512)
_LOCAL_I: NDArray[np.float32] = (_W >> 6).astype(np.float32)
_LOCAL_J: NDArray[np.float32] = ((_W >> 3) & 7).astype(np.float32)
_LOCAL_K: NDArray[np.float32] = (_W & 7).astype(np.float32)
# Where each voxel is within its block: read, for turning integers into these takes longer than all the rest.


@njit(cache=True, error_model="numpy")
def project_block(
    bi: Int, bj: Int, bk: Int, voxel_size: Float, camera: Array, pixels: Array, z: Array, stretch: Array
) -> None:
    """Project the 512 voxel centres of block (bi, bj, bk).

    camera  : (18,) float64 as in `mapping.kernels.visibility`
    pixels  : (512,) int32, filled: row · width + column of the nearest pixel, −1 outside the image
    z       : (512,) float32, filled: depth [m]
    stretch : (512,) float32, filled: length along the ray per depth
    """
    half = np.float32(0.5)
    one = np.float32(1.0)
    v = np.float32(voxel_size)
    fx, fy, cx, cy = np.float32(camera[12]), np.float32(camera[13]), np.float32(camera[14]), np.float32(camera[15])
    width, right, bottom = np.int32(camera[16]), np.float32(camera[16]) - half, np.float32(camera[17]) - half
    r0, r1, r2 = np.float32(camera[0]) * v, np.float32(camera[1]) * v, np.float32(camera[2]) * v
    r3, r4, r5 = np.float32(camera[3]) * v, np.float32(camera[4]) * v, np.float32(camera[5]) * v
    r6, r7, r8 = np.float32(camera[6]) * v, np.float32(camera[7]) * v, np.float32(camera[8]) * v
    a, b, c = (8.0 * bi + 0.5) * voxel_size, (8.0 * bj + 0.5) * voxel_size, (8.0 * bk + 0.5) * voxel_size
    x0 = np.float32(camera[0] * a + camera[1] * b + camera[2] * c + camera[9])
    y0 = np.float32(camera[3] * a + camera[4] * b + camera[5] * c + camera[10])
    z0 = np.float32(camera[6] * a + camera[7] * b + camera[8] * c + camera[11])
    for w in range(512):  # no branches, so that it runs on vectors
        i, j, k = _LOCAL_I[w], _LOCAL_J[w], _LOCAL_K[w]
        depth = z0 + i * r6 + j * r7 + k * r8
        before = depth > np.float32(1e-4)
        inverse = one / (depth if before else one)
        x = (x0 + i * r0 + j * r1 + k * r2) * inverse
        y = (y0 + i * r3 + j * r4 + k * r5) * inverse
        column = x * fx + cx
        row = y * fy + cy
        inside = before & (column > -half) & (row > -half) & (column < right) & (row < bottom)
        column = column if inside else np.float32(0.0)
        row = row if inside else np.float32(0.0)
        pixel = np.int32(row + half) * width + np.int32(column + half)
        pixels[w] = pixel if inside else np.int32(-1)
        z[w] = depth
        stretch[w] = np.sqrt(one + x * x + y * y)
