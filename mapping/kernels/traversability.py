"""Kernels of traversability: the ground about each surface, and the room above it."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


@njit(cache=True)
def facing_surface(tops: Array, bottoms: Array, i: Int, j: Int, height: Float, headroom: Float) -> Int:
    """The surface of cell (i, j) that a robot at `height` [m] would meet; −1 when nothing is known there.

    tops, bottoms : (nx, ny, levels) what each surface occupies, NaN where there is none
    A robot of height `headroom` [m] passes below surfaces whose bottom is higher than itself: of the others, the one
    nearest to its height, measured to what it occupies, the lowest of equals.
    """
    best = -1
    best_distance = np.inf
    for level in range(tops.shape[2]):
        top, bottom = tops[i, j, level], bottoms[i, j, level]
        if np.isnan(top):
            break
        if bottom > height + headroom:
            continue
        distance = max(height - top, bottom - height, 0.0)
        if distance < best_distance:
            best, best_distance = level, distance
    return best


@njit(cache=True, error_model="numpy")
def measure_ground(
    tops: Array,
    bottoms: Array,
    window: Array,
    cell_size: Float,
    headroom: Float,
    reach: Float,
    rise: Float,
    steps: Array,
    slopes: Array,
    roughness: Array,
    known: Array,
) -> None:
    """Step, slope and roughness of the ground about each surface, in place.

    tops, bottoms : (nx, ny, levels) float64 as in `facing_surface`
    window        : (m, 2) int64 the offsets of the cells of a disc about a cell, itself among them
    reach, rise   : a surface at distance d belongs to the same plane when it is no more than reach + rise·d higher or
                    lower [m]; what is farther off is a step or a wall, not a slope
    steps         : (nx, ny, levels) float64, filled: greatest difference in height to one of the 8 neighbours [m]
    slopes        : likewise: inclination of the least squares plane through the surfaces of the window [rad]; NaN where
                    fewer than three or all on a line
    roughness     : likewise: root mean square residual of that plane [m]
    known         : likewise: share of the cells of the window in which a surface is known
    """
    nx, ny, levels = tops.shape
    for i in range(nx):
        for j in range(ny):
            for level in range(levels):
                steps[i, j, level] = slopes[i, j, level] = roughness[i, j, level] = known[i, j, level] = np.nan
                z = tops[i, j, level]
                if np.isnan(z):
                    continue
                step = 0.0
                n_known = 0
                n = sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
                for m in range(window.shape[0]):
                    di, dj = window[m, 0], window[m, 1]
                    if not (0 <= i + di < nx and 0 <= j + dj < ny):
                        continue
                    other = level
                    if di != 0 or dj != 0:
                        other = facing_surface(tops, bottoms, i + di, j + dj, z, headroom)
                    if other < 0:
                        continue
                    n_known += 1
                    dz = tops[i + di, j + dj, other] - z
                    if abs(di) <= 1 and abs(dj) <= 1:
                        step = max(step, abs(dz))
                    x, y = di * cell_size, dj * cell_size
                    if abs(dz) > reach + rise * np.sqrt(x * x + y * y):
                        continue
                    n += 1.0
                    sx, sy, sz = sx + x, sy + y, sz + dz
                    sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
                    sxz, syz, szz = sxz + x * dz, syz + y * dz, szz + dz * dz
                steps[i, j, level] = step
                known[i, j, level] = n_known / window.shape[0]
                cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
                cxz, cyz, czz = sxz - sx * sz / n, syz - sy * sz / n, szz - sz * sz / n
                determinant = cxx * cyy - cxy * cxy
                if determinant > 1e-6 * cell_size**4:
                    a = (cxz * cyy - cyz * cxy) / determinant
                    b = (cyz * cxx - cxz * cxy) / determinant
                    slopes[i, j, level] = np.arctan(np.sqrt(a * a + b * b))
                    roughness[i, j, level] = np.sqrt(max(czz - a * cxz - b * cyz, 0.0) / n)


@njit(cache=True)
def look_up(
    tops: Array,
    evidence: Array,
    first: Array,
    corner: Array,
    cell_size: Float,
    voxel_size: Float,
    above: Float,
    headroom: Float,
    clearance: Array,
    known: Array,
) -> None:
    """How much free height a dense box of occupancy knows above each surface, in place.

    tops      : (nx, ny, levels) float64 [m];  corner (2,) of the first cell [m]
    evidence  : (mx, my, mz) int8, −128 unknown, ≥ 0 occupied;  first (3,) int64 the voxel of its first element; outside
                of it everything is unknown
    above, headroom : what lies between these heights above a surface is looked at [m]
    clearance : (nx, ny, levels) float64: lowered to the lowest occupied voxel above the surface [m]
    known     : (nx, ny, levels) float64, filled: share of the voxels looked at that are free or occupied
    """
    mx, my, mz = evidence.shape
    per_voxel = 1.0 / voxel_size
    for i in range(tops.shape[0]):
        for j in range(tops.shape[1]):
            i0 = np.int64(np.floor((corner[0] + i * cell_size) * per_voxel + 1e-6)) - first[0]
            i1 = np.int64(np.ceil((corner[0] + (i + 1) * cell_size) * per_voxel - 1e-6)) - first[0]
            j0 = np.int64(np.floor((corner[1] + j * cell_size) * per_voxel + 1e-6)) - first[1]
            j1 = np.int64(np.ceil((corner[1] + (j + 1) * cell_size) * per_voxel - 1e-6)) - first[1]
            for level in range(tops.shape[2]):
                z = tops[i, j, level]
                known[i, j, level] = np.nan
                if np.isnan(z):
                    continue
                k0 = np.int64(np.ceil((z + above) * per_voxel - 1e-6)) - first[2]
                k1 = np.int64(np.ceil((z + headroom) * per_voxel - 1e-6)) - first[2]
                n = n_known = 0
                for a in range(i0, i1):
                    for b in range(j0, j1):
                        for k in range(k0, k1):
                            n += 1
                            if not (0 <= a < mx and 0 <= b < my and 0 <= k < mz) or evidence[a, b, k] == -128:
                                continue
                            n_known += 1
                            if evidence[a, b, k] >= 0:
                                free = max((k + first[2]) * voxel_size - z, 0.0)
                                clearance[i, j, level] = min(clearance[i, j, level], free)
                known[i, j, level] = n_known / n if n else 1.0
