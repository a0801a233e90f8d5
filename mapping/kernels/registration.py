"""Normal equations of aligning points with a truncated signed distance field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup

Array = NDArray[Any]


@njit(cache=True)
def _sample(
    table: Array, distance: Array, weight: Array, voxel: float, x: float, y: float, z: float, gradient: Array
) -> float:
    """Signed distance interpolated between eight voxels, its gradient in place; NaN where one of them is unknown."""
    fx, fy, fz = x / voxel - 0.5, y / voxel - 0.5, z / voxel - 0.5
    i, j, k = int(np.floor(fx)), int(np.floor(fy)), int(np.floor(fz))
    a, b, c = fx - i, fy - j, fz - k
    value = gx = gy = gz = 0.0
    slot = -1
    last_i = last_j = last_k = 1 << 30
    for corner in range(8):
        di, dj, dk = corner >> 2, corner >> 1 & 1, corner & 1
        u, v, w = i + di, j + dj, k + dk
        if u >> 3 != last_i or v >> 3 != last_j or w >> 3 != last_k:
            last_i, last_j, last_k = u >> 3, v >> 3, w >> 3
            slot = lookup(table, last_i, last_j, last_k)
        if slot < 0:
            return np.nan
        at = (u & 7) << 6 | (v & 7) << 3 | (w & 7)
        if not weight[slot, at] > 0.0:
            return np.nan
        d = distance[slot, at]
        wx, wy, wz = (a if di else 1.0 - a), (b if dj else 1.0 - b), (c if dk else 1.0 - c)
        value += wx * wy * wz * d
        gx += (1.0 if di else -1.0) * wy * wz * d
        gy += (1.0 if dj else -1.0) * wx * wz * d
        gz += (1.0 if dk else -1.0) * wx * wy * d
    gradient[0], gradient[1], gradient[2] = gx / voxel, gy / voxel, gz / voxel
    return value


@njit(cache=True)
def accumulate(
    table: Array,
    distance: Array,
    weight: Array,
    voxel: float,
    points: Array,
    sigma: Array,
    pose: Array,
    huber: float,
    information: Array,
    vector: Array,
) -> tuple[int, float]:
    """Sum the normal equations of Σ ρ(d(T · p)/σ) over points, in place; returns how many took part and their mean
    |d| [m].

    points (N, 3) in the sensor frame [m], sigma (N,) [m], pose (3, 4) sensor in map
    information (6, 6), vector (6,): Hessian and descent direction for a right perturbation x, y, z, roll, pitch, yaw
    huber : residuals beyond this many σ count linearly
    """
    gradient = np.empty(3)
    row = np.empty(6)
    used = 0
    misfit = 0.0
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        d = _sample(
            table,
            distance,
            weight,
            voxel,
            pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3],
            pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3],
            pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3],
            gradient,
        )
        if not abs(d) < np.inf:
            continue
        steep = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
        if steep < 0.4 or steep > 2.5:  # the edge of the band, or two surfaces in one cell
            continue
        d /= steep
        mx = (pose[0, 0] * gradient[0] + pose[1, 0] * gradient[1] + pose[2, 0] * gradient[2]) / steep
        my = (pose[0, 1] * gradient[0] + pose[1, 1] * gradient[1] + pose[2, 1] * gradient[2]) / steep
        mz = (pose[0, 2] * gradient[0] + pose[1, 2] * gradient[1] + pose[2, 2] * gradient[2]) / steep
        row[0], row[1], row[2] = mx, my, mz
        row[3], row[4], row[5] = py * mz - pz * my, pz * mx - px * mz, px * my - py * mx
        size = abs(d) / sigma[n]
        w = (1.0 if size <= huber else huber / size) / sigma[n] ** 2
        for r in range(6):
            vector[r] -= w * row[r] * d
            for c in range(6):
                information[r, c] += w * row[r] * row[c]
        used += 1
        misfit += abs(d)
    return used, misfit / max(used, 1)
