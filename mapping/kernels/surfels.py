"""Moments of the points in each voxel, and the normal distributions and surfels that they make.

A voxel's moments are one row of 13 float32. Lengths are in edges of the voxel, places relative to its lower corner:

    0        n, the number of points
    1 … 3    mean
    4 … 9    scatter Σ (p − mean)(p − mean)ᵀ: xx, xy, xz, yy, yz, zz
    10 … 12  Σ of the unit vectors from the mean of a scan's points to its sensor, a point each
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

MOMENTS = 13
"""Length of a voxel's row."""


@njit(cache=True)
def sum_points(rows: Array, offsets: Array, voxel_ijk: Array, origin: Array, sums: Array) -> None:
    """The moments (k, 13) float64 of one scan in each of its voxels, filled.

    rows (n,) : each point's voxel, −1 = none;  offsets (n, 3) float32 : the point within it, 0 … 1
    voxel_ijk (k, 3);  origin (3,) : the sensor, in voxels

    Plain sums about the voxel's centre do here: in double precision they lose nothing over the width of a voxel.
    """
    sums[:] = 0.0
    for n in range(rows.shape[0]):
        if rows[n] < 0:
            continue
        of = sums[rows[n]]
        x, y, z = offsets[n, 0] - 0.5, offsets[n, 1] - 0.5, offsets[n, 2] - 0.5
        of[0] += 1.0
        of[1] += x
        of[2] += y
        of[3] += z
        of[4] += x * x
        of[5] += x * y
        of[6] += x * z
        of[7] += y * y
        of[8] += y * z
        of[9] += z * z
    for r in range(sums.shape[0]):
        of = sums[r]
        n_points = of[0]
        x, y, z = of[1] / n_points, of[2] / n_points, of[3] / n_points
        of[4] -= x * x * n_points
        of[5] -= x * y * n_points
        of[6] -= x * z * n_points
        of[7] -= y * y * n_points
        of[8] -= y * z * n_points
        of[9] -= z * z * n_points
        of[1], of[2], of[3] = x + 0.5, y + 0.5, z + 0.5
        a = origin[0] - voxel_ijk[r, 0] - of[1]
        b = origin[1] - voxel_ijk[r, 1] - of[2]
        c = origin[2] - voxel_ijk[r, 2] - of[3]
        length = np.sqrt(a * a + b * b + c * c)
        if length > 0.0:
            of[10], of[11], of[12] = n_points * a / length, n_points * b / length, n_points * c / length


@njit(cache=True)
def merge_moments(moments: Array, slots: Array, others: Array) -> None:
    """Merge moments `others` (k, 13) into the rows `slots` (k,) of `moments` (capacity, 13), in place.

    The pairwise update of Chan, Golub & LeVeque (Updating formulae and a pairwise algorithm for computing sample
    variances, 1979); with one point in `others` it is Welford's (1962).
    """
    for r in range(slots.shape[0]):
        to, of = moments[slots[r]], others[r]
        n, m = np.float64(to[0]), np.float64(of[0])
        if m == 0.0:
            continue
        share = m / (n + m)
        x, y, z = of[1] - np.float64(to[1]), of[2] - np.float64(to[2]), of[3] - np.float64(to[3])
        cross = n * share
        to[0] = n + m
        to[1] += share * x
        to[2] += share * y
        to[3] += share * z
        to[4] += of[4] + cross * x * x
        to[5] += of[5] + cross * x * y
        to[6] += of[6] + cross * x * z
        to[7] += of[7] + cross * y * y
        to[8] += of[8] + cross * y * z
        to[9] += of[9] + cross * z * z
        to[10] += of[10]
        to[11] += of[11]
        to[12] += of[12]


@njit(cache=True)
def sum_colors(rows: Array, color: Array, sums: Array) -> None:
    """Number and mean colour (k, 4) float64 of one scan's points in each of its voxels, filled.

    rows (n,) : each point's voxel, −1 = none;  color (n, 3) uint8
    """
    sums[:] = 0.0
    for n in range(rows.shape[0]):
        if rows[n] >= 0:
            of = sums[rows[n]]
            of[0] += 1.0
            for channel in range(3):
                of[1 + channel] += (color[n, channel] - of[1 + channel]) / of[0]


@njit(cache=True)
def merge_colors(colors: Array, slots: Array, others: Array) -> None:
    """Merge numbers and mean colours `others` (k, 4) into the rows `slots` (k,) of `colors` (capacity, 4), in place."""
    for r in range(slots.shape[0]):
        to, of = colors[slots[r]], others[r]
        if of[0] > 0.0:
            to[0] += of[0]
            for channel in range(1, 4):
                to[channel] += of[0] / to[0] * (of[channel] - to[channel])


@njit(cache=True)
def _across(m: Array, shift: Float) -> tuple[Float, Float, Float]:
    """The unit vector across the rows of the symmetric matrix m (6,) less `shift` times the identity, of rank 2."""
    xx, xy, xz, yy, yz, zz = m[0] - shift, m[1], m[2], m[3] - shift, m[4], m[5] - shift
    x, y, z = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
    best = x * x + y * y + z * z
    a, b, c = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
    squared = a * a + b * b + c * c
    if squared > best:
        x, y, z, best = a, b, c, squared
    a, b, c = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    squared = a * a + b * b + c * c
    if squared > best:
        x, y, z, best = a, b, c, squared
    if best == 0.0:
        return 1.0, 0.0, 0.0
    length = np.sqrt(best)
    return x / length, y / length, z / length


@njit(cache=True)
def _form(m: Array, a: Array, b: Array) -> Float:
    """aᵀ m b for the symmetric matrix m (6,)."""
    return (
        a[0] * (m[0] * b[0] + m[1] * b[1] + m[2] * b[2])
        + a[1] * (m[1] * b[0] + m[3] * b[1] + m[4] * b[2])
        + a[2] * (m[2] * b[0] + m[4] * b[1] + m[5] * b[2])
    )


@njit(cache=True)
def decompose(m: Array, values: Array, vectors: Array) -> None:
    """Eigenvalues (3,), ascending, and unit eigenvectors (rows of (3, 3)) of a symmetric matrix, in place.

    m : (6,) float64 xx, xy, xz, yy, yz, zz. Closed form after Eberly, A Robust Eigensolver for 3×3 Symmetric Matrices
    (2014): first the eigenvector of the eigenvalue that is farthest from the others, then these from the 2×2 problem
    across it, so that equal eigenvalues do no harm.
    """
    mean = (m[0] + m[3] + m[5]) / 3.0
    a, b, c = m[0] - mean, m[3] - mean, m[5] - mean
    spread = np.sqrt((a * a + b * b + c * c + 2.0 * (m[1] * m[1] + m[2] * m[2] + m[4] * m[4])) / 6.0)
    if spread <= 1e-15 * abs(mean):  # a multiple of the identity
        values[:] = mean
        vectors[:] = 0.0
        vectors[0, 0] = vectors[1, 1] = vectors[2, 2] = 1.0
        return
    determinant = a * (b * c - m[4] * m[4]) - m[1] * (m[1] * c - m[4] * m[2]) + m[2] * (m[1] * m[4] - b * m[2])
    half = min(max(0.5 * determinant / (spread * spread * spread), -1.0), 1.0)
    angle = np.arccos(abs(half)) / 3.0
    largest = half >= 0.0  # whether the largest eigenvalue stands apart, or the smallest
    apart = mean + (2.0 if largest else -2.0) * spread * np.cos(angle)
    alone, low, high = (2, 0, 1) if largest else (0, 1, 2)
    u, v, w = vectors[alone], vectors[low], vectors[high]
    u[0], u[1], u[2] = _across(m, apart)
    if abs(u[0]) > abs(u[1]):
        length = np.sqrt(u[0] * u[0] + u[2] * u[2])
        v[0], v[1], v[2] = -u[2] / length, 0.0, u[0] / length
    else:
        length = np.sqrt(u[1] * u[1] + u[2] * u[2])
        v[0], v[1], v[2] = 0.0, u[2] / length, -u[1] / length
    w[0], w[1], w[2] = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    vv, vw, ww = _form(m, v, v), _form(m, v, w), _form(m, w, w)
    half_gap = 0.5 * (vv - ww)
    root = np.sqrt(half_gap * half_gap + vw * vw)
    values[alone], values[low], values[high] = _form(m, u, u), 0.5 * (vv + ww) - root, 0.5 * (vv + ww) + root
    p, q = (half_gap + root, vw) if half_gap >= 0.0 else (vw, root - half_gap)  # along v and w: the larger one's
    length = np.sqrt(p * p + q * q)
    p, q = (p / length, q / length) if length > 0.0 else (0.0, 1.0)
    for axis in range(3):
        v[axis], w[axis] = p * w[axis] - q * v[axis], p * v[axis] + q * w[axis]


@njit(cache=True)
def distribution(of: Array, matrix: Array, values: Array, vectors: Array) -> None:
    """Covariance (6,), its eigenvalues (3,), ascending and not negative, and eigenvectors (rows of (3, 3)) of a row of
    moments with n ≥ 2, in place. The first vector is the normal, on the side from which the points were seen."""
    for e in range(6):
        matrix[e] = np.float64(of[4 + e]) / (np.float64(of[0]) - 1.0)
    decompose(matrix, values, vectors)
    for e in range(3):
        values[e] = max(values[e], 0.0)
    if vectors[0, 0] * of[10] + vectors[0, 1] * of[11] + vectors[0, 2] * of[12] < 0.0:
        for axis in range(3):
            vectors[0, axis] = -vectors[0, axis]


@njit(cache=True)
def list_distributions(moments: Array, slots: Array, covariances: Array, values: Array, normals: Array) -> None:
    """Covariance (k, 6) and its eigenvalues (k, 3), in squared voxel edges, and the normal (k, 3) of the rows `slots`
    (k,) of `moments`; all in place."""
    vectors = np.empty((3, 3))
    for r in range(slots.shape[0]):
        distribution(moments[slots[r]], covariances[r], values[r], vectors)
        normals[r, 0], normals[r, 1], normals[r, 2] = vectors[0, 0], vectors[0, 1], vectors[0, 2]


@njit(cache=True)
def measure_points(
    table: Array, moments: Array, per_voxel: Float, least: Float, flattest: Float, p_map: Array, planes: Array,
    squared: Array,
) -> None:  # fmt: skip
    """How far each point (n, 3) [m] is from the distribution of its voxel; NaN where there is none, both in place.

    planes  : (n,) float64 signed distance from the plane through the mean across the normal, in voxel edges
    squared : (n,) float64 squared Mahalanobis distance
    least   : points that make a distribution;  flattest : eigenvalues below this share of the largest are raised to it
    """
    matrix, values, vectors = np.empty(6), np.empty(3), np.empty((3, 3))
    limit = np.float64(BLOCK_LIMIT)
    last = -1  # the slot that `values` and `vectors` belong to
    for n in range(p_map.shape[0]):
        x, y, z = p_map[n, 0] * per_voxel, p_map[n, 1] * per_voxel, p_map[n, 2] * per_voxel
        planes[n] = squared[n] = np.nan
        if not (abs(x) < limit and abs(y) < limit and abs(z) < limit):  # also NaN
            continue
        i, j, k = np.floor(x), np.floor(y), np.floor(z)
        s = lookup(table, np.int64(i), np.int64(j), np.int64(k))
        if s < 0 or moments[s, 0] < least:
            continue
        of = moments[s]
        if s != last:
            distribution(of, matrix, values, vectors)
            last = s
        a, b, c = x - i - of[1], y - j - of[2], z - k - of[3]
        planes[n] = vectors[0, 0] * a + vectors[0, 1] * b + vectors[0, 2] * c
        floor = max(flattest * values[2], 1e-12)
        total = 0.0
        for e in range(3):
            along = vectors[e, 0] * a + vectors[e, 1] * b + vectors[e, 2] * c
            total += along * along / max(values[e], floor)
        squared[n] = total
