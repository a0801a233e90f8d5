"""From the pixels of a mask to the voxels of one object: components of voxels, and the rim of the mask.

Windows are parts (h, w) of images. A *camera* is (4,) float64: fx, fy, and cx, cy within the window. The noise of depth
is σ(z) = noise[0] + noise[1] · (z − 0.4)² [m] (Nguyen et al., Modeling Kinect sensor noise, 2012).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.forest import join, root_of
from mapping.kernels.hashing import BLOCK_LIMIT, home, pack

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


@njit(cache=True)
def measure_inside(mask: Array, most: Int, inside: Array) -> None:
    """How far each pixel lies inside a mask (h, w) bool, in place: its distance from the nearest pixel outside it in
    thirds of a pixel, `most` at most; 0 outside. What lies beyond the window counts as inside.

    inside : (h, w) uint8, chamfer distances 3-4 by two raster sweeps (Borgefors, Distance transformations in digital
             images, 1986)
    """
    height, width = mask.shape
    for v in range(height):
        left: Int = most  # kept at hand, since what was just written takes long to be read again
        for u in range(width):
            best: Int = most if mask[v, u] else 0
            if v > 0:
                best = min(best, inside[v - 1, u] + 3)
                if u > 0:
                    best = min(best, inside[v - 1, u - 1] + 4)
                if u < width - 1:
                    best = min(best, inside[v - 1, u + 1] + 4)
            left = min(best, left + 3)
            inside[v, u] = left
    for v in range(height - 1, -1, -1):
        right: Int = most
        for u in range(width - 1, -1, -1):
            best = np.int64(inside[v, u])
            if v < height - 1:
                best = min(best, inside[v + 1, u] + 3)
                if u > 0:
                    best = min(best, inside[v + 1, u - 1] + 4)
                if u < width - 1:
                    best = min(best, inside[v + 1, u + 1] + 4)
            right = min(best, right + 3)
            inside[v, u] = right


@njit(cache=True, inline="always")
def _lies_on(planes: Array, x: Float, y: Float, z: Float, slack: Float, noise: Array) -> bool:
    """Whether a point in the optical frame is nearer than slack + σ(z) / 2 to one of the planes (P, 14)."""
    near = False
    if planes.shape[0]:
        reach = slack + 0.5 * (noise[0] + noise[1] * (z - 0.4) ** 2)
        for p in range(planes.shape[0]):
            if abs(planes[p, 0] * x + planes[p, 1] * y + planes[p, 2] * z - planes[p, 3]) <= reach:
                a = planes[p, 4] * x + planes[p, 5] * y + planes[p, 6] * z - planes[p, 7]
                b = planes[p, 8] * x + planes[p, 9] * y + planes[p, 10] * z - planes[p, 11]
                near |= abs(a) <= planes[p, 12] + reach and abs(b) <= planes[p, 13] + reach
    return near


@njit(cache=True)
def find_on_planes(
    depth: Array, inside: Array, camera: Array, planes: Array, slack: Float, noise: Array, on: Array
) -> None:
    """Which masked pixels lie on a plane, in place.

    planes : (P, 14) float64 in the optical frame: unit normal and offset [m], two axes along the plane each with its
             offset, and how far the plane reaches to both sides along each; slack [m] is added to the noise about them
    on     : (h, w) bool
    """
    per_x, per_y, cx, cy = 1.0 / camera[0], 1.0 / camera[1], camera[2], camera[3]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = np.float64(depth[v, u])
            x, y = (u - cx) * per_x * z, (v - cy) * per_y * z
            on[v, u] = inside[v, u] > 0 and 0.0 < z < np.inf and _lies_on(planes, x, y, z, slack, noise)


@njit(cache=True)
def _enter_all(line: Array, table: Array, keys: Array, count: Int, rows: Array) -> Int:
    """The row of each key of `line` (n,) in `keys`, −1 where it is below 0; new keys are entered, in place.

    table : int32 hash table of rows, −1 = empty, of a size that is a power of two;  rows : (n,) int32
    Returns how many keys there are then.
    """
    last_key, last = np.int64(-1), np.int32(-1)
    size = len(table)
    for u in range(len(line)):
        key = line[u]
        if key < 0:
            rows[u] = -1
            continue
        if key != last_key:
            last_key = key
            at = home(key, size)
            while table[at] >= 0 and keys[table[at]] != key:
                at = (at + 1) & (size - 1)
            if table[at] < 0:
                table[at] = count
                keys[count] = key
                count += 1
            last = table[at]
        rows[u] = last
    return count


@njit(cache=True)
def bin_pixels(
    depth: Array, inside: Array, camera: Array, pose: Array, per_voxel: Float, row_at: Array
) -> tuple[Array, Int]:
    """The voxels in which masked pixels lie: packed keys (K,) in order of appearance, and how many pixels have none
    because they lie too far away.

    depth, inside : (h, w) float32 [m], and uint8 as `measure_inside` gives it
    pose          : (12,) R_map_camera row by row, then t_map_camera;  per_voxel : 1 / voxel size [1/m]
    row_at        : (h, w) int32, in place: row of each pixel's voxel in what is returned, −1 where there is none
    """
    height, width = depth.shape
    per_x, per_y, cx, cy = 1.0 / camera[0], 1.0 / camera[1], camera[2], camera[3]
    keys = np.empty(4096 + width, np.int64)
    table = np.full(2 << int(np.ceil(np.log2(len(keys)))), -1, np.int32)
    line = np.empty(width, np.int64)
    count, lost = 0, 0
    limit = np.float64(BLOCK_LIMIT - 1)
    for v in range(height):
        y0 = (v - cy) * per_y
        for u in range(width):  # without branches, so that several pixels are computed at once
            z = np.float64(depth[v, u])
            x, y = (u - cx) * per_x * z, y0 * z
            i = np.floor((pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) * per_voxel)
            j = np.floor((pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) * per_voxel)
            k = np.floor((pose[6] * x + pose[7] * y + pose[8] * z + pose[11]) * per_voxel)
            far = max(max(abs(i), abs(j)), abs(k)) >= limit
            key = pack(np.int32(i), np.int32(j), np.int32(k))
            measured = (inside[v, u] > 0) & (z > 0.0) & (z < np.inf)
            line[u] = (-2 if far else key) if measured else -1
        if count + width > len(keys):
            more = np.empty(4 * len(keys) + width, np.int64)
            more[:count] = keys[:count]
            keys = more
            table = np.full(2 << int(np.ceil(np.log2(len(keys)))), -1, np.int32)
            _enter_all(keys[:count], table, keys, 0, np.empty(count, np.int32))
        count = _enter_all(line, table, keys, count, row_at[v])
        for u in range(width):
            lost += line[u] == -2
    return keys[:count].copy(), lost


@njit(cache=True)
def mark_flat(on: Array, inside: Array, most: Int, row_at: Array, flat: Array) -> None:
    """Which voxels (K,) bool hold pixels of a plane in the rim of the mask and no others, in place; at first all True.

    on, inside, row_at : (h, w) bool, uint8, int32
    """
    for v in range(on.shape[0]):
        for u in range(on.shape[1]):
            if row_at[v, u] >= 0 and not (on[v, u] and inside[v, u] < most):
                flat[row_at[v, u]] = False


@njit(cache=True)
def join_voxels(keys: Array, flat: Array, parent: Array) -> None:
    """Join each voxel to those of its 26 neighbours that are, like it, flat or not, in place.

    keys   : (K,) int64, packed indices (`hashing.pack`), ascending, each once
    flat   : (K,) bool
    parent : (K,) int32, a forest of rows, at first 0 … K − 1: union-find with path halving (Tarjan & van Leeuwen 1984);
             the root of a component is its lowest voxel

    Half of the neighbours are asked for; they lie in the four rows of voxels ahead and at the next place in their own.
    In each row ahead a finger moves on as the voxels do, so that all is one pass.
    """
    count = len(keys)
    for row in range(4):
        ahead = np.int64(1 << 21) if row == 0 else np.int64((1 << 42) + ((row - 2) << 21))
        finger = 0
        for n in range(count):
            lowest = keys[n] + ahead - 1
            while finger < count and keys[finger] < lowest:
                finger += 1
            m = finger
            while m < count and keys[m] <= lowest + 2:
                if flat[m] == flat[n]:
                    join(parent, n, m)
                m += 1
    for n in range(count - 1):
        if keys[n + 1] == keys[n] + 1 and flat[n] == flat[n + 1]:
            join(parent, n, n + 1)


@njit(cache=True)
def _step_at(z: Float, step: Float, noise: Array) -> Float:
    """How far the depths of two neighbours on one surface may differ at depth z [m]: `step`, or three σ of depth."""
    return max(step, 3.0 * (noise[0] + noise[1] * (z - 0.4) ** 2))


@njit(cache=True)
def join_pixels(depth: Array, row_at: Array, flat: Array, step: Float, noise: Array, parent: Array) -> None:
    """Join the voxels of neighbouring pixels whose depths differ by no more than `step` [m] or noise, in place.

    row_at : (h, w) int32, the voxel of each pixel, −1 where there is none;  flat, parent : as in `join_voxels`
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            row = row_at[v, u]
            if row < 0:
                continue
            z = depth[v, u]
            for n in range(2):
                a, b = (v, u - 1) if n == 0 else (v - 1, u)
                if a < 0 or b < 0 or row_at[a, b] < 0 or row_at[a, b] == row:
                    continue
                other = row_at[a, b]
                if (
                    flat[row] == flat[other]
                    and parent[row] != parent[other]
                    and abs(depth[a, b] - z) <= _step_at(z, step, noise)
                ):
                    join(parent, row, other)


@njit(cache=True)
def find_roots(parent: Array) -> None:
    """Name the root of each row of a forest (K,) int32, in place."""
    for row in range(len(parent)):
        parent[row] = root_of(parent, row)


@njit(cache=True)
def _is_seed(inside: Array, v: Int, u: Int, least: Int, most: Int) -> Any:
    """Whether a pixel lies `most` deep inside its mask, or `least` and as deep as all around: a thin part's middle."""
    own = inside[v, u]
    if own >= most:
        return True
    if own < least:
        return False
    for a in range(max(v - 1, 0), min(v + 2, inside.shape[0])):
        for b in range(max(u - 1, 0), min(u + 2, inside.shape[1])):
            if inside[a, b] > own:
                return False
    return True


@njit(cache=True)
def weigh_parts(
    depth: Array, inside: Array, least: Int, most: Int, deepest: Int, row_at: Array, parent: Array, sums: Array
) -> None:
    """Sum up each component, in place: its seeds, which are pixels that bleeding by less than `most` cannot explain.

    sums : (K, 4) float64 of zeros, at the component's root: of its seeds Σ w, Σ w · z and Σ w · z², w being inside²,
           but at most most²; and how many pixels it has less than `deepest` inside the mask
    """
    height, width = inside.shape
    for v in range(height):
        last = np.int32(-1)  # neighbours mostly have one root: sums of a run are kept at hand
        w0 = w1 = w2 = border = 0.0
        for u in range(width):
            if row_at[v, u] < 0:
                continue
            root, z = parent[row_at[v, u]], np.float64(depth[v, u])
            if root != last:
                _add(sums, last, w0, w1, w2, border)
                w0 = w1 = w2 = border = 0.0
                last = root
            if inside[v, u] < deepest:
                border += 1.0
            if _is_seed(inside, v, u, least, most):
                weight = np.float64(min(inside[v, u], most)) ** 2
                w0 += weight
                w1 += weight * z
                w2 += weight * z * z
        _add(sums, last, w0, w1, w2, border)


@njit(cache=True, inline="always")
def _add(sums: Array, root: Int, w0: Float, w1: Float, w2: Float, border: Float) -> None:
    if root >= 0:
        sums[root, 0] += w0
        sums[root, 1] += w1
        sums[root, 2] += w2
        sums[root, 3] += border


@njit(cache=True)
def grow_rim(
    depth: Array,
    inside: Array,
    most: Int,
    deepest: Int,
    row_at: Array,
    chosen: Array,
    on: Array,
    step: Float,
    noise: Array,
    front: Array,
) -> Int:
    """Which pixels are the object's: those deep in the mask of its components, and what goes on from them outwards.

    chosen  : (K,) bool, voxels of the object's components
    on      : (h, w) bool, pixels that lie on a plane, and deepest ≥ most: how deep inside they count as any others
    front   : (h, w) float32 of zeros, in place: the depth [m] of a pixel that is the object's, minus the depth that the
              object has there where nothing was measured; 0 elsewhere

    Where the mask is `most` deep, all pixels of chosen voxels are the object's, but for those on a plane. From there
    outwards a pixel is when most of its neighbours deeper inside the mask are the object's, and it measured their mean
    depth, but for `step` [m] or noise; on a plane these have to lie on one, too. As the way leads outwards only, it
    cannot run along the rim to a background that the object stands on elsewhere. Returns how many are the object's.
    """
    height, width = inside.shape
    first = np.zeros(deepest + 2, np.int64)
    rim = np.empty(height * width, np.int32)
    count: Int = 0
    size: Int = 0
    for v in range(height):
        for u in range(width):
            row, level = row_at[v, u], inside[v, u]
            if level < most or (on[v, u] and level < deepest):
                rim[size] = v * width + u
                size += level > 0
                first[level + 1] += level > 0
            elif row >= 0 and chosen[row]:
                front[v, u] = depth[v, u]
                count += 1
    for level in range(1, deepest + 1):
        first[level] += first[level - 1]
    order = np.empty(size, np.int32)
    place = first.copy()
    for n in range(size):
        level = inside[rim[n] // width, rim[n] % width]
        order[place[level]] = rim[n]
        place[level] += 1
    for level in range(deepest - 1, 0, -1):
        for n in range(first[level], first[level + 1]):
            v, u = order[n] // width, order[n] % width
            row, z = row_at[v, u], depth[v, u]
            measured = 0.0 < z < np.inf
            deeper, ways, others, before = False, 0, 0, np.float32(0.0)
            found = np.float32(0.0)
            for a in range(max(v - 1, 0), min(v + 2, height)):
                for b in range(max(u - 1, 0), min(u + 2, width)):
                    if inside[a, b] <= level:
                        continue
                    deeper = True
                    if front[a, b] != 0.0 and (on[a, b] or not on[v, u]):
                        before += abs(front[a, b])
                        ways += 1
                    elif row_at[a, b] >= 0:
                        others += 1
            if ways > others and not measured:
                found = -before / ways
            elif row >= 0:
                goes_on = ways > others and abs(before / max(ways, 1) - z) <= _step_at(z, step, noise)
                if goes_on or (chosen[row] and not deeper):
                    found = z
            front[v, u] = found
            count += found > 0.0
    return count


@njit(cache=True)
def gather(
    front: Array,
    inside: Array,
    most: Int,
    row_at: Array,
    camera: Array,
    pose: Array,
    points: Array,
    voxel_of: Array,
    counts: Array,
    votes: Array,
) -> None:
    """What the object's pixels are in space, in place.

    front    : (h, w) as `grow_rim` gives it
    points   : (n, 3) float32 [m] in the frame of the pose, row by row of the window;  voxel_of : (n,) int32
    counts   : (K,) int64 of zeros, points of each voxel
    votes    : (K,) float32 of zeros: the sum over them of their depth inside the mask, 1 where no bleeding reaches
    """
    per_x, per_y, cx, cy = 1.0 / camera[0], 1.0 / camera[1], camera[2], camera[3]
    share = np.float32(1.0 / most)
    n = 0
    for v in range(front.shape[0]):
        for u in range(front.shape[1]):
            z = np.float64(front[v, u])
            if z <= 0.0:
                continue
            x, y, row = (u - cx) * per_x * z, (v - cy) * per_y * z, row_at[v, u]
            points[n, 0] = pose[0] * x + pose[1] * y + pose[2] * z + pose[9]
            points[n, 1] = pose[3] * x + pose[4] * y + pose[5] * z + pose[10]
            points[n, 2] = pose[6] * x + pose[7] * y + pose[8] * z + pose[11]
            voxel_of[n] = row
            counts[row] += 1
            votes[row] += min(np.float32(inside[v, u]) * share, np.float32(1.0))
            n += 1
