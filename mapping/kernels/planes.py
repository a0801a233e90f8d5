"""Planes from oriented surface samples: additive moments, fits, matching, patches and how they grow together.

The moments of a set of samples are the 13 sums `MOMENTS`: count, Σp (3), Σppᵀ (xx xy xz yy yz zz), Σn (3), with points
p [m] and unit normals n. They add, so that a plane's fit follows from the sums of its parts.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]

MOMENTS = 13


@njit(cache=True, inline="always")
def add(sums: Array, point: Array, normal: Array, sign: float) -> None:
    """Add (`sign` 1) one sample to its plane's moments (13,) or take it away (−1), in place."""
    x, y, z = np.float64(point[0]), np.float64(point[1]), np.float64(point[2])
    sums[0] += sign
    sums[1] += sign * x
    sums[2] += sign * y
    sums[3] += sign * z
    sums[4] += sign * x * x
    sums[5] += sign * x * y
    sums[6] += sign * x * z
    sums[7] += sign * y * y
    sums[8] += sign * y * z
    sums[9] += sign * z * z
    for a in range(3):
        sums[10 + a] += sign * normal[a]


@njit(cache=True)
def accumulate(moments: Array, plane_of: Array, points: Array, normals: Array, sign: float) -> None:
    """Add (`sign` 1) or take away (−1) samples from the moments of the planes that they are on, in place.

    moments  : (P, 13) float64
    plane_of : (N,) int32, row of `moments`; negative where a sample is on no plane
    points   : (N, 3) float32 [m];  normals : (N, 3) float32
    """
    for i in range(len(points)):
        if plane_of[i] >= 0:
            add(moments[plane_of[i]], points[i], normals[i], sign)


@njit(cache=True)
def find_unmoved(same: Array, points: Array, block_of: Array, old: Array, old_block_of: Array, reach: float) -> None:
    """Which blocks hold as many samples as they did, each within `reach` [m] along each axis of what it was, in place.

    points, old : (N, 3), (M, 3) float32 [m], by ascending block (N,), (M,);  same : (K,) bool
    """
    a = b = 0
    for k in range(len(same)):
        n = 0
        same[k] = True
        while a + n < len(points) and block_of[a + n] == k:
            m = b + n
            if m >= len(old) or old_block_of[m] != k:
                same[k] = False
            elif same[k]:
                for d in range(3):
                    if abs(points[a + n, d] - old[m, d]) > reach:
                        same[k] = False
            n += 1
        a += n
        while b < len(old) and old_block_of[b] == k:
            b += 1
            n -= 1
        if n != 0:
            same[k] = False


@njit(cache=True)
def fit(moments: Array, normal: Array) -> tuple[float, float]:
    """The least-squares plane of the moments (13,): writes its unit normal (3,), returns its offset and the rms [m].

    The normal points the way the samples' normals do. Needs three samples that are not on a line.
    """
    n = moments[0]
    mx, my, mz = moments[1] / n, moments[2] / n, moments[3] / n
    scatter = np.empty((3, 3))
    scatter[0, 0] = moments[4] / n - mx * mx
    scatter[0, 1] = scatter[1, 0] = moments[5] / n - mx * my
    scatter[0, 2] = scatter[2, 0] = moments[6] / n - mx * mz
    scatter[1, 1] = moments[7] / n - my * my
    scatter[1, 2] = scatter[2, 1] = moments[8] / n - my * mz
    scatter[2, 2] = moments[9] / n - mz * mz
    values, vectors = np.linalg.eigh(scatter)
    x, y, z = vectors[0, 0], vectors[1, 0], vectors[2, 0]
    if x * moments[10] + y * moments[11] + z * moments[12] < 0.0:
        x, y, z = -x, -y, -z
    normal[0], normal[1], normal[2] = x, y, z
    return x * mx + y * my + z * mz, np.sqrt(max(values[0], 0.0))


@njit(cache=True)
def fit_all(moments: Array, rows: Array, least: float, normal: Array, offset: Array) -> None:
    """Fit the planes `rows` (K,) that have `least` samples (≥ 3), in place.

    moments : (P, 13) float64;  normal : (P, 3) float64;  offset : (P,) float64 [m]
    """
    for row in rows:
        if moments[row, 0] >= least:
            offset[row], _ = fit(moments[row], normal[row])


@njit(cache=True)
def match(
    plane_of: Array,
    points: Array,
    normals: Array,
    place_of: Array,
    first: Array,
    candidates: Array,
    normal: Array,
    offset: Array,
    tolerance: float,
    least_cosine: float,
) -> None:
    """Put every sample that is on no plane yet (negative) on the nearest plane of its place that it fits, in place.

    plane_of   : (N,) int32
    place_of   : (N,) int64; the planes near place q are candidates[first[q]:first[q + 1]]
    normal     : (P, 3) float64, offset : (P,) float64 [m]
    A sample fits when it is closer than `tolerance` [m] and its normal is within the angle of `least_cosine`.
    """
    for i in range(len(points)):
        if plane_of[i] >= 0:
            continue
        nearest = tolerance
        for c in range(first[place_of[i]], first[place_of[i] + 1]):
            k = candidates[c]
            cosine = normal[k, 0] * normals[i, 0] + normal[k, 1] * normals[i, 1] + normal[k, 2] * normals[i, 2]
            if cosine < least_cosine:
                continue
            distance = abs(
                normal[k, 0] * points[i, 0] + normal[k, 1] * points[i, 1] + normal[k, 2] * points[i, 2] - offset[k]
            )
            if distance < nearest:
                nearest = distance
                plane_of[i] = k


@njit(cache=True)
def count_planes(block_of: Array, plane_of: Array, row: Array, plane: Array, n: Array) -> int:
    """How many samples of each block are on each plane, in place; returns the number of entries.

    block_of : (N,) int64 ascending;  plane_of : (N,) int32, negative for none
    row, plane, n : (N,) int64 out: entry e says that n[e] samples of block row[e] are on plane[e]; by block
    """
    entries, begin = 0, 0
    for i in range(len(block_of)):
        if i > 0 and block_of[i] != block_of[i - 1]:
            begin = entries
        if plane_of[i] < 0:
            continue
        for e in range(begin, entries):
            if plane[e] == plane_of[i]:
                n[e] += 1
                break
        else:
            row[entries], plane[entries], n[entries] = block_of[i], plane_of[i], 1
            entries += 1
    return entries


@njit(cache=True)
def gather(first_near: Array, near: Array, neighbours: Array, first: Array, planes: Array, mark: Array) -> None:
    """The planes in any of each place's neighbours, each once, in place.

    first_near : (Q + 1,) int64, near : (M,) int64 out: those of place q are near[first_near[q]:first_near[q + 1]]
    neighbours : (Q, K) int64 rows of known places, −1 where there is none
    first, planes : the planes in known place r are planes[first[r]:first[r + 1]]
    mark       : (P,) int64 of −1, one per plane
    """
    n = 0
    first_near[0] = 0
    for q in range(len(neighbours)):
        for r in neighbours[q]:
            if r < 0:
                continue
            for e in range(first[r], first[r + 1]):
                if mark[planes[e]] != q:
                    mark[planes[e]] = q
                    near[n] = planes[e]
                    n += 1
        first_near[q + 1] = n


@njit(cache=True, inline="always")
def agrees(point: Array, direction: Array, normal: Array, offset: float, tolerance: float, least_cosine: float) -> bool:
    """Whether a sample with normal `direction` fits a plane."""
    distance = normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - offset
    cosine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    return bool(abs(distance) < tolerance and cosine >= least_cosine)


@njit(cache=True)
def _hypothesis(
    normal: Array, seed: int, open_rows: Array, points: Array, normals: Array, tolerance: float, least_cosine: float
) -> float:
    """The plane of what looks like sample `seed` about it: one sample's own normal is too noisy. Normal in place;
    returns the offset."""
    sums = np.zeros(6)
    n = 0
    offset = (
        normals[seed, 0] * points[seed, 0] + normals[seed, 1] * points[seed, 1] + normals[seed, 2] * points[seed, 2]
    )
    for i in open_rows:
        if agrees(points[i], normals[i], normals[seed], offset, 2.0 * tolerance, least_cosine):
            for a in range(3):
                sums[a] += normals[i, a]
                sums[3 + a] += points[i, a]
            n += 1
    length = np.sqrt(sums[0] ** 2 + sums[1] ** 2 + sums[2] ** 2)
    if length == 0.0:
        return np.inf
    for a in range(3):
        normal[a] = sums[a] / length
    return float((normal[0] * sums[3] + normal[1] * sums[4] + normal[2] * sums[5]) / n)


@njit(cache=True)
def find_patches(
    patch_of: Array,
    moments: Array,
    place_of_patch: Array,
    points: Array,
    normals: Array,
    first: Array,
    hypotheses: int,
    tolerance: float,
    least_cosine: float,
    least: int,
) -> int:
    """Cut the samples of each place into flat patches, in place; returns how many.

    Per place: of `hypotheses` samples, spread evenly, the plane about one that most samples agree with is refitted to
    them twice and taken when `least` samples agree with it in the end; then the rest is cut likewise. (Random sample
    consensus with refinement, after Nüchter & Hertzberg 2008, section 3.1; spread instead of random: results repeat.)

    patch_of       : (N,) int32, −1 on entry; samples of place q are first[q]:first[q + 1]
    moments        : (M, 13) float64 zeros, place_of_patch : (M,) int64; no more than M patches are made
    """
    made = 0
    normal, best_normal = np.empty(3), np.empty(3)
    for q in range(len(first) - 1):
        open_rows = np.arange(first[q], first[q + 1])
        while len(open_rows) >= least and made < len(moments):
            best, best_offset = 0, 0.0
            for seed in open_rows[:: max(1, len(open_rows) // hypotheses)]:
                offset = _hypothesis(normal, seed, open_rows, points, normals, tolerance, least_cosine)
                count = 0
                for i in open_rows:
                    count += agrees(points[i], normals[i], normal, offset, tolerance, least_cosine)
                if count > best:
                    best, best_offset = count, offset
                    best_normal[:] = normal
            sums = moments[made]
            on = np.zeros(len(open_rows), np.bool_)
            for step in range(3):
                if best < least:
                    break
                best = 0
                sums[:] = 0.0
                for k in range(len(open_rows)):
                    i = open_rows[k]
                    on[k] = agrees(points[i], normals[i], best_normal, best_offset, tolerance, least_cosine)
                    best += on[k]
                    if on[k]:
                        add(sums, points[i], normals[i], 1.0)
                if best >= least and step < 2:
                    best_offset, _ = fit(sums, best_normal)
            if best < least:
                sums[:] = 0.0
                break
            patch_of[open_rows[on]] = made
            open_rows = open_rows[~on]
            place_of_patch[made] = q
            made += 1
    return made


@njit(cache=True)
def misfit(moments: Array, normal: Array, offset: float) -> float:
    """Root mean square distance [m] of the samples summed up in `moments` (13,) to a plane: exact, from the sums."""
    n = moments[0]
    x, y, z = normal[0], normal[1], normal[2]
    square = (
        x * x * moments[4]
        + y * y * moments[7]
        + z * z * moments[9]
        + 2.0 * (x * y * moments[5] + x * z * moments[6] + y * z * moments[8])
        - 2.0 * offset * (x * moments[1] + y * moments[2] + z * moments[3])
    ) / n + offset * offset
    return float(np.sqrt(max(square, 0.0)))


@njit(cache=True)
def lies_in(small: Array, normal: Array, large: Array, offset: float, least_cosine: float, tolerance: float) -> bool:
    """Whether the samples summed up in `small` (13,), of a piece with this `normal` (3,), lie in the plane (large,
    offset)."""
    cosine = normal[0] * large[0] + normal[1] * large[1] + normal[2] * large[2]
    return bool(small[0] > 2.5 and cosine >= least_cosine and misfit(small, large, offset) <= tolerance)


@njit(cache=True)
def find_coplanar(
    pairs: Array,
    first_in: Array,
    inside: Array,
    first_near: Array,
    near: Array,
    moments: Array,
    normal: Array,
    offset: Array,
    least_cosine: float,
    tolerance: float,
) -> int:
    """Pairs (M, 2) int64 of pieces close to each other of which the smaller lies in the plane of the larger, in place,
    the lower number first, some more than once; returns how many.

    first_in, inside   : the pieces in place q are inside[first_in[q]:first_in[q + 1]]
    first_near, near   : likewise those in it or beside it
    moments            : (P, 13) float64;  normal : (P, 3) float64;  offset : (P,) float64 [m]
    """
    n = 0
    for q in range(len(first_in) - 1):
        for a in inside[first_in[q] : first_in[q + 1]]:
            for b in near[first_near[q] : first_near[q + 1]]:
                large, small = (a, b) if moments[a, 0] >= moments[b, 0] else (b, a)
                if a != b and lies_in(
                    moments[small], normal[small], normal[large], offset[large], least_cosine, tolerance
                ):
                    pairs[n, 0], pairs[n, 1] = min(a, b), max(a, b)
                    n += 1
    return n


@njit(cache=True)
def alignment(moments_a: Array, moments_b: Array) -> float:
    """Cosine of the angle between the mean sample normals of two sets."""
    dot = moments_a[10] * moments_b[10] + moments_a[11] * moments_b[11] + moments_a[12] * moments_b[12]
    a = moments_a[10] ** 2 + moments_a[11] ** 2 + moments_a[12] ** 2
    b = moments_b[10] ** 2 + moments_b[11] ** 2 + moments_b[12] ** 2
    return float(dot / np.sqrt(max(a * b, 1e-30)))


@njit(cache=True)
def grow_patches(group_of: Array, moments: Array, ijk: Array, tolerance: float, least_cosine: float) -> int:
    """Join patches of touching places that lie in one plane into groups, in place; returns how many groups.

    Largest patch first; each group takes in, breadth first, the patches that fit the plane of all it has so far.

    group_of : (M,) int32, −1 on entry;  moments : (M, 13) float64;  ijk : (M, 3) int64 place of each patch
    """
    m = len(moments)
    order = np.argsort(-moments[:, 0], kind="mergesort")
    queue = np.empty(m, np.int64)
    normal = np.empty(3)
    sums = np.empty(MOMENTS)
    made = 0
    for seed in order:
        if group_of[seed] >= 0:
            continue
        group_of[seed] = made
        sums[:] = moments[seed]
        offset, _ = fit(sums, normal)
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            a = queue[head]
            head += 1
            for b in range(m):
                if (
                    group_of[b] >= 0
                    or abs(ijk[a, 0] - ijk[b, 0]) > 1
                    or abs(ijk[a, 1] - ijk[b, 1]) > 1
                    or abs(ijk[a, 2] - ijk[b, 2]) > 1
                    or alignment(sums, moments[b]) < least_cosine
                    or misfit(moments[b], normal, offset) > tolerance
                ):
                    continue
                group_of[b] = made
                sums += moments[b]
                offset, _ = fit(sums, normal)
                queue[tail] = b
                tail += 1
        made += 1
    return made
