"""Planes from oriented surface samples: additive moments, fits, matching, patches, and rasters of covered cells.

The moments of a set of samples are the 13 sums `MOMENTS`: count, Σp (3), Σppᵀ (xx xy xz yy yz zz), Σn (3), with points
p [m] and unit normals n. They add, so that a plane's fit follows from the sums of its parts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

MOMENTS = 13


@njit(cache=True)
def accumulate(moments, plane_of, points, normals, sign):
    """Add (`sign` 1) or take away (−1) samples from the moments of the planes that they are on, in place.

    moments  : (P, 13) float64
    plane_of : (N,) int32, row of `moments`; negative where a sample is on no plane
    points   : (N, 3) float32 [m];  normals : (N, 3) float32
    """
    for i in range(len(points)):
        k = plane_of[i]
        if k < 0:
            continue
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        moments[k, 0] += sign
        moments[k, 1] += sign * x
        moments[k, 2] += sign * y
        moments[k, 3] += sign * z
        moments[k, 4] += sign * x * x
        moments[k, 5] += sign * x * y
        moments[k, 6] += sign * x * z
        moments[k, 7] += sign * y * y
        moments[k, 8] += sign * y * z
        moments[k, 9] += sign * z * z
        moments[k, 10] += sign * normals[i, 0]
        moments[k, 11] += sign * normals[i, 1]
        moments[k, 12] += sign * normals[i, 2]


@njit(cache=True)
def fit(moments, normal):
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
def fit_all(moments, rows, least, normal, offset):
    """Fit the planes `rows` (K,) of `moments` (P, 13) that have `least` samples (≥ 3): normal (P, 3), offset (P,), in place."""
    for row in rows:
        if moments[row, 0] >= least:
            offset[row], _ = fit(moments[row], normal[row])


@njit(cache=True)
def match(plane_of, points, normals, place_of, first, candidates, normal, offset, tolerance, least_cosine):
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
def count_planes(block_of, plane_of, row, plane, n):
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
def gather(first_near, near, neighbours, first, planes, mark):
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


@njit(cache=True)
def find_patches(patch_of, moments, place_of_patch, points, normals, first, hypotheses, tolerance, least_cosine, least):
    """Cut the samples of each place into flat patches, in place; returns how many.

    Per place: of `hypotheses` oriented samples, spread evenly, the plane that most samples agree with is refitted
    to them three times, and taken when `least` of them remain; the rest is cut likewise. (Random sample consensus
    with refinement after Nüchter & Hertzberg 2008, section 3.1; evenly spread instead of random: results repeat.)

    patch_of       : (N,) int32, −1 on entry; samples of place q are first[q]:first[q + 1]
    moments        : (M, 13) float64 zeros, place_of_patch : (M,) int64; no more than M patches are made
    """
    made = 0
    normal = np.empty(3)
    for q in range(len(first) - 1):
        low, high = first[q], first[q + 1]
        while made < len(moments):
            free = 0
            for i in range(low, high):
                if patch_of[i] == -1:
                    free += 1
            if free < least:
                break
            # the hypothesis with the most agreement
            step = max(1, free // hypotheses)
            best, best_x, best_y, best_z, best_d = 0, 0.0, 0.0, 0.0, 0.0
            seen = -1
            for h in range(low, high):
                if patch_of[h] != -1:
                    continue
                seen += 1
                if seen % step != 0:
                    continue
                # mean normal of what looks alike nearby: one sample's normal is too noisy
                x, y, z = 0.0, 0.0, 0.0
                mx, my, mz, n = 0.0, 0.0, 0.0, 0
                for i in range(low, high):
                    if patch_of[i] != -1:
                        continue
                    cosine = (
                        normals[h, 0] * normals[i, 0] + normals[h, 1] * normals[i, 1] + normals[h, 2] * normals[i, 2]
                    )
                    along = (
                        normals[h, 0] * (points[i, 0] - points[h, 0])
                        + normals[h, 1] * (points[i, 1] - points[h, 1])
                        + normals[h, 2] * (points[i, 2] - points[h, 2])
                    )
                    if cosine >= least_cosine and abs(along) < 2.0 * tolerance:
                        x += normals[i, 0]
                        y += normals[i, 1]
                        z += normals[i, 2]
                        mx += points[i, 0]
                        my += points[i, 1]
                        mz += points[i, 2]
                        n += 1
                length = np.sqrt(x * x + y * y + z * z)
                if n <= best or length == 0.0:
                    continue
                x, y, z = x / length, y / length, z / length
                d = (x * mx + y * my + z * mz) / n
                agreeing = 0
                for i in range(low, high):
                    if (
                        patch_of[i] == -1
                        and abs(x * points[i, 0] + y * points[i, 1] + z * points[i, 2] - d) < tolerance
                        and x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2] >= least_cosine
                    ):
                        agreeing += 1
                if agreeing > best:
                    best, best_x, best_y, best_z, best_d = agreeing, x, y, z, d
            if best < least:
                break
            # refinement
            normal[0], normal[1], normal[2] = best_x, best_y, best_z
            offset = best_d
            sums = moments[made]
            for _ in range(3):
                sums[:] = 0.0
                for i in range(low, high):
                    if (
                        patch_of[i] == -1
                        and abs(normal[0] * points[i, 0] + normal[1] * points[i, 1] + normal[2] * points[i, 2] - offset)
                        < tolerance
                        and normal[0] * normals[i, 0] + normal[1] * normals[i, 1] + normal[2] * normals[i, 2]
                        >= least_cosine
                    ):
                        sums[0] += 1.0
                        for a in range(3):
                            sums[1 + a] += points[i, a]
                            sums[10 + a] += normals[i, a]
                        sums[4] += points[i, 0] * points[i, 0]
                        sums[5] += points[i, 0] * points[i, 1]
                        sums[6] += points[i, 0] * points[i, 2]
                        sums[7] += points[i, 1] * points[i, 1]
                        sums[8] += points[i, 1] * points[i, 2]
                        sums[9] += points[i, 2] * points[i, 2]
                if sums[0] < least:
                    break
                offset, _ = fit(sums, normal)
            if sums[0] < least:
                sums[:] = 0.0
                break
            taken = 0
            for i in range(low, high):
                if (
                    patch_of[i] == -1
                    and abs(normal[0] * points[i, 0] + normal[1] * points[i, 1] + normal[2] * points[i, 2] - offset)
                    < tolerance
                    and normal[0] * normals[i, 0] + normal[1] * normals[i, 1] + normal[2] * normals[i, 2] >= least_cosine
                ):
                    patch_of[i] = made
                    taken += 1
            if taken < least:
                for i in range(low, high):
                    if patch_of[i] == made:
                        patch_of[i] = -1
                sums[:] = 0.0
                break
            sums[:] = 0.0
            accumulate(moments[made : made + 1], np.where(patch_of[low:high] == made, 0, -1), points[low:high], normals[low:high], 1.0)
            place_of_patch[made] = q
            made += 1
    return made


@njit(cache=True)
def misfit(moments, normal, offset):
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
    return np.sqrt(max(square, 0.0))


@njit(cache=True)
def alignment(moments_a, moments_b):
    """Cosine of the angle between the mean sample normals of two sets."""
    dot = moments_a[10] * moments_b[10] + moments_a[11] * moments_b[11] + moments_a[12] * moments_b[12]
    a = moments_a[10] ** 2 + moments_a[11] ** 2 + moments_a[12] ** 2
    b = moments_b[10] ** 2 + moments_b[11] ** 2 + moments_b[12] ** 2
    return dot / np.sqrt(max(a * b, 1e-30))


@njit(cache=True)
def grow_patches(group_of, moments, ijk, tolerance, least_cosine):
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


@njit(cache=True)
def find_cells(cell, points, origin, u, v, per_metre):
    """The raster cell (N, 2) int64 that each point (N, 3) [m] projects to, in place."""
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        cell[i, 0] = np.int64(np.floor((x * u[0] + y * u[1] + z * u[2]) * per_metre))
        cell[i, 1] = np.int64(np.floor((x * v[0] + y * v[1] + z * v[2]) * per_metre))


@njit(cache=True)
def bounds(cell, low, high):
    """Lowest and highest cell of (N, 2), in place."""
    low[:] = cell[0]
    high[:] = cell[0]
    for i in range(1, len(cell)):
        for a in range(2):
            low[a] = min(low[a], cell[i, a])
            high[a] = max(high[a], cell[i, a])


@njit(cache=True)
def cover(counts, rows, columns, cell, lowest, sign):
    """Add (`sign` 1) or take away (−1) samples from a raster's cells, in place; returns the change in covered cells.

    counts  : (U, V) uint16 samples per cell, of which the first is cell `lowest` (2,)
    rows    : (U,) int32, columns : (V,) int32, covered cells per row and column
    cell    : (N, 2) int64
    """
    change = 0
    for i in range(len(cell)):
        u, v = cell[i, 0] - lowest[0], cell[i, 1] - lowest[1]
        before = counts[u, v]
        if sign > 0:
            if before < 65535:
                counts[u, v] = before + 1
            if before == 0:
                rows[u] += 1
                columns[v] += 1
                change += 1
        elif before > 0:
            counts[u, v] = before - 1
            if before == 1:
                rows[u] -= 1
                columns[v] -= 1
                change -= 1
    return change


@njit(cache=True)
def covered_near(hit, counts, cell, reach):
    """Whether a covered cell lies within `reach` cells (along u and v) of each cell (N, 2) int64; hit (N,) bool, in place."""
    width, height = counts.shape
    for i in range(len(cell)):
        hit[i] = False
        for u in range(max(0, cell[i, 0] - reach), min(width, cell[i, 0] + reach + 1)):
            for v in range(max(0, cell[i, 1] - reach), min(height, cell[i, 1] + reach + 1)):
                if counts[u, v] > 0:
                    hit[i] = True
                    break
            if hit[i]:
                break


@njit(cache=True)
def trace(mask, corners, ring_end):
    """The borders of the covered cells as rings of grid corners, in place; returns how many rings.

    Covered cells are on the left: outer rings run counter-clockwise, holes clockwise. Cells that touch in a corner
    only are kept apart. Only corners where the border turns are listed.

    mask     : (U, V) bool, with an uncovered margin of one cell
    corners  : (C, 2) int32 out; ring r is corners[ring_end[r - 1]:ring_end[r]];  ring_end : (R,) int64 out
    """
    width, height = mask.shape
    # direction of travel: 0 +u, 1 +v, 2 −u, 3 −v; visited marks borders (cell below, i.e. v − 1 uncovered) by lower left corner
    step_u = np.array([1, 0, -1, 0])
    step_v = np.array([0, 1, 0, -1])
    left_u = np.array([0, -1, -1, 0])
    left_v = np.array([0, 0, -1, -1])
    right_u = np.array([0, 0, -1, -1])
    right_v = np.array([-1, 0, 0, -1])
    visited = np.zeros((width, height), np.bool_)
    n, rings = 0, 0
    for start_u in range(width):
        for start_v in range(1, height):
            if not mask[start_u, start_v] or mask[start_u, start_v - 1] or visited[start_u, start_v]:
                continue
            u, v, way = start_u, start_v, 0
            begin = n
            while True:
                if way == 0:
                    if visited[u, v]:
                        break
                    visited[u, v] = True
                u += step_u[way]
                v += step_v[way]
                before = way
                for turn in (1, 0, 3):
                    way = (before + turn) % 4
                    if mask[u + left_u[way], v + left_v[way]] and not mask[u + right_u[way], v + right_v[way]]:
                        break
                if way != before:
                    corners[n, 0] = u
                    corners[n, 1] = v
                    n += 1
            if n > begin:
                ring_end[rings] = n
                rings += 1
    return rings
