"""Signed distance kernels: fusing images and beams into the map.

Distances are positive before a surface and negative behind it [m]; a voxel with weight 0 is unknown. Fusing is the
weighted running mean of Curless & Levoy, A Volumetric Method for Building Complex Models from Range Images, 1996.
Cameras and reach images are those of `mapping.kernels.visibility`.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, find_or_insert, lookup
from mapping.kernels.projection import project_block

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

BEHIND = 0.02
"""Weight of a distance far behind the surface: enough where nothing else is known."""
COLOR_STEPS = 256.0
"""Colours are kept in 1/256 of an 8-bit step, so that running means do not stick."""
CHUNK = 4096
"""Points that one thread looks up at a time."""


FREE_VIEWS = 2.0
"""Space that was never seen to be anything but free is remembered for so many views, from 2 m where these count by
distance: what comes there is to show soon."""


@njit(cache=True, inline="always")
def trust(voxels: Float, slack: Float) -> Float:
    """The weight of a signed distance [voxels]: 1 up to 1 + slack behind the surface, BEHIND from one more on.

    What lies behind a surface is a guess. It must be there for the surface to lie between voxels, and it must yield
    where the thing is seen from its other side, or both sides of a thin thing push each other apart. But where noise
    alone puts the surface so far before the voxel, leaving these measurements out would move the surface: hence slack.
    """
    one = np.float32(1.0)
    return min(one, max(one + (one + slack) + voxels, np.float32(BEHIND)))


@njit(cache=True, forceinline=True, error_model="numpy")
def fold_block(
    distance: Array,
    weight: Array,
    slot: Int,
    s: Array,
    z: Array,
    voxel_size: Float,
    truncation: Float,
    carve: bool,
    inverse_square: bool,
    slack: Float,
    max_weight: Float,
    gains: Array,
) -> Any:
    """Fold one signed distance a voxel into the running means of the block in `slot`, in place; whether any changed.

    s, z  : (512,) float32: distance [m], NaN where unseen; depth or range at which it was measured [m]
    slack : how many voxels more the noise is given at 1 m; it grows with the square of z
    gains : (512,) float32, filled: the weight of each measurement
    """
    one = np.float32(1.0)
    tau = np.float32(truncation)
    per_voxel = np.float32(1.0 / voxel_size)
    front = np.float32(np.inf) if carve else tau
    highest = np.float32(max_weight)
    freest = np.float32(FREE_VIEWS * (0.25 if inverse_square else 1.0)) if carve else highest
    noise = np.float32(slack)
    difference = np.uint8(0)
    for w in range(512):
        new = min(s[w], tau)
        gain = one / (max(z[w], np.float32(0.5)) ** 2) if inverse_square else one
        gain = gain * trust(new * per_voxel, noise * z[w] * z[w])
        gains[w] = gain
        old, had = distance[slot, w], weight[slot, w]
        total = had + gain
        mean = (old * had + new * gain) / total
        total = min(total, freest if mean >= tau else highest)
        update = (s[w] > -tau) & (s[w] <= front)
        mean = mean if update else old
        total = total if update else had
        difference |= np.uint8(mean != old) | np.uint8(total != had)
        distance[slot, w] = mean
        weight[slot, w] = total
    return difference != 0


@njit(cache=True, parallel=True, error_model="numpy")
def find_band(
    blocks: Array, slots: Array, voxel_size: Float, truncation: Float, reach: Array, camera: Array, wanted: Array
) -> None:
    """Which blocks (n, 3) exist (slot ≥ 0) or have a voxel within `truncation` [m] of the surface: fills wanted."""
    seen = reach.ravel()
    tau = np.float32(truncation)
    for n in prange(blocks.shape[0]):
        wanted[n] = slots[n] >= 0
        if wanted[n]:
            continue
        pixels = np.empty(512, np.int32)
        z = np.empty(512, np.float32)
        stretch = np.empty(512, np.float32)
        project_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, camera, pixels, z, stretch)
        for w in range(512):
            if pixels[w] >= 0:
                d = seen[pixels[w]]
                if d > np.float32(0.0) and abs(d - z[w]) * stretch[w] <= tau:
                    wanted[n] = True
                    break


@njit(cache=True, inline="always")
def blend(kept: Float, seen: Float, share: Float) -> Any:
    """A colour channel as it is kept, moved by a share of the way to one that was seen (8 bit)."""
    old = np.float32(kept)
    return np.uint16(old + (np.float32(seen) * np.float32(COLOR_STEPS) - old) * share + np.float32(0.5))


@njit(cache=True, parallel=True, error_model="numpy")
def fuse_image(
    distance: Array,
    weight: Array,
    color: Array,
    slots: Array,
    blocks: Array,
    voxel_size: Float,
    truncation: Float,
    carve: bool,
    inverse_square: bool,
    slack: Float,
    max_weight: Float,
    reach: Array,
    camera: Array,
    image: Array,
    changed: Array,
) -> None:
    """Fold one depth image into the running mean of each voxel of the blocks in `slots` (n,), in place.

    distance, weight : (capacity, 512) float32 [m], [-]
    color            : (capacity, 512, 3) uint16 in 1/256 of a step, or empty
    carve            : whether voxels farther before the surface than `truncation` are updated too
    slack            : see `fold_block`
    image            : (H, W, 3) uint8, or empty
    changed          : (n,) bool, filled
    """
    seen = reach.ravel()
    zero = np.float32(0.0)
    one = np.float32(1.0)
    tau = np.float32(truncation)
    colored = image.shape[0] > 0
    rgb = image.reshape(-1, 3)
    for n in prange(slots.shape[0]):
        slot = slots[n]
        pixels = np.empty(512, np.int32)
        z = np.empty(512, np.float32)
        s = np.empty(512, np.float32)
        gains = np.empty(512, np.float32)
        project_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, camera, pixels, z, s)
        for w in range(512):  # s: length per depth → signed distance along the ray, NaN where unseen
            d = seen[max(pixels[w], 0)]
            s[w] = (abs(d) - z[w]) * s[w]
            in_front = d > zero or (d < zero and s[w] >= tau)
            if pixels[w] < 0 or not in_front:
                s[w] = np.nan
        changed[n] = fold_block(
            distance, weight, slot, s, z, voxel_size, truncation, carve, inverse_square, slack, max_weight, gains
        )
        if colored:
            for w in range(512):
                if abs(s[w]) < tau:
                    pixel = np.uint64(pixels[w])
                    share = gains[w] / weight[slot, w]
                    red, green, blue = color[slot, w, 0], color[slot, w, 1], color[slot, w, 2]
                    if (red | green | blue) == 0:
                        share = one  # weight so far, but no colour
                    color[slot, w, 0] = blend(red, rgb[pixel, 0], share)
                    color[slot, w, 1] = blend(green, rgb[pixel, 1], share)
                    color[slot, w, 2] = blend(blue, rgb[pixel, 2], share)


@njit(cache=True, error_model="numpy")
def sum_beams(
    origin: Array,
    ends: Array,
    start: Int,
    max_range: Float,
    voxel_size: Float,
    truncation: Float,
    table: Array,
    blocks: Array,
    n_blocks: Int,
    sums: Array,
    weights: Array,
) -> tuple[Int, Int]:
    """Walk each beam through the band about its end and add up its signed distances, in place.

    origin, ends   : (3,), (m, 3) [m, map]; beams longer than `max_range` are left out
    table          : hash of the scan's blocks, index → row; blocks (room, 3) int32, of which `n_blocks` are in use
    sums, weights  : (room, 512) float32, for each voxel Σ weight · distance along the beam [m] and Σ weight
    Begins at beam `start`; returns (beam to go on with when room ran out or m, number of blocks).
    """
    per_voxel = 1.0 / voxel_size
    for n in range(start, ends.shape[0]):
        d0, d1, d2 = ends[n, 0] - origin[0], ends[n, 1] - origin[1], ends[n, 2] - origin[2]
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        if not 0.0 < length <= max_range:
            continue
        d0, d1, d2 = d0 / length, d1 / length, d2 / length
        t = max(length - truncation, 0.0)
        p0, p1, p2 = origin[0] + t * d0, origin[1] + t * d1, origin[2] + t * d2
        i, j = np.int64(np.floor(p0 * per_voxel)), np.int64(np.floor(p1 * per_voxel))
        k = np.int64(np.floor(p2 * per_voxel))
        s0, s1, s2 = np.int64(np.sign(d0)), np.int64(np.sign(d1)), np.int64(np.sign(d2))
        t0 = t + ((i + (0.5 + 0.5 * s0)) * voxel_size - p0) / d0 if s0 != 0 else np.inf
        t1 = t + ((j + (0.5 + 0.5 * s1)) * voxel_size - p1) / d1 if s1 != 0 else np.inf
        t2 = t + ((k + (0.5 + 0.5 * s2)) * voxel_size - p2) / d2 if s2 != 0 else np.inf
        step0 = voxel_size / abs(d0) if s0 != 0 else np.inf
        step1 = voxel_size / abs(d1) if s1 != 0 else np.inf
        step2 = voxel_size / abs(d2) if s2 != 0 else np.inf
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        row: Int = np.int64(0)
        first_pass = True
        # Room is checked along the whole band before anything is added, so that a beam can be taken up again.
        start_i, start_j, start_k, start_t0, start_t1, start_t2 = i, j, k, t0, t1, t2
        while True:
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                if n_blocks == blocks.shape[0]:
                    row = lookup(table, bi, bj, bk)
                    if row < 0:
                        return n, n_blocks
                else:
                    row = find_or_insert(table, bi, bj, bk, n_blocks)
                if row == n_blocks:
                    blocks[row, 0] = bi
                    blocks[row, 1] = bj
                    blocks[row, 2] = bk
                    sums[row, :] = 0.0
                    weights[row, :] = 0.0
                    n_blocks += 1
                last_i, last_j, last_k = bi, bj, bk
            if not first_pass:
                x, y, z = (i + 0.5) * voxel_size, (j + 0.5) * voxel_size, (k + 0.5) * voxel_size
                along = (x - origin[0]) * d0 + (y - origin[1]) * d1 + (z - origin[2]) * d2
                new = min(length - along, truncation)
                if new > -truncation:
                    local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                    gain = trust(np.float32(new * per_voxel), np.float32(0.0))
                    sums[row, local] += gain * new
                    weights[row, local] += gain
            if min(t0, t1, t2) > length + truncation:
                if not first_pass:
                    break
                first_pass = False
                i, j, k, t0, t1, t2 = start_i, start_j, start_k, start_t0, start_t1, start_t2
                continue
            if t0 < t1:
                if t0 < t2:
                    i += s0
                    t0 += step0
                else:
                    k += s2
                    t2 += step2
            elif t1 < t2:
                j += s1
                t1 += step1
            else:
                k += s2
                t2 += step2
    return ends.shape[0], n_blocks


@njit(cache=True, parallel=True, error_model="numpy")
def fold_sums(
    distance: Array, weight: Array, slots: Array, sums: Array, weights: Array, max_weight: Float, changed: Array
) -> None:
    """Fold Σ weight · distance and Σ weight (n, 512) of one scan into the running means of the blocks `slots` (n,)."""
    highest = np.float32(max_weight)
    for n in prange(slots.shape[0]):
        slot = slots[n]
        difference = np.uint8(0)
        for w in range(512):
            gain = weights[n, w]
            if gain > np.float32(0.0):
                old, had = distance[slot, w], weight[slot, w]
                total = had + gain
                mean = (old * had + sums[n, w]) / total
                total = min(total, highest)
                difference |= np.uint8(mean != old) | np.uint8(total != had)
                distance[slot, w] = mean
                weight[slot, w] = total
        changed[n] = difference != 0


@njit(cache=True, forceinline=True)
def sample_field(
    table: Array, distance: Array, weight: Array, i: Int, j: Int, k: Int, slot: Int, fx: Float, fy: Float, fz: Float
) -> Float:
    """Distance [m] between the eight voxels from (i, j, k) on, at the shares fx, fy, fz of the way; NaN where one is
    unknown. `slot` is that of the first one's block."""
    if slot < 0:
        return np.nan
    li, lj, lk = i & 7, j & 7, k & 7
    if li < 7 and lj < 7 and lk < 7:  # all in one block
        n = li << 6 | lj << 3 | lk
        least = min(min(weight[slot, n], weight[slot, n + 1]), min(weight[slot, n + 8], weight[slot, n + 9]))
        least = min(least, min(weight[slot, n + 64], weight[slot, n + 65]))
        least = min(least, min(weight[slot, n + 72], weight[slot, n + 73]))
        a, b, c, e = distance[slot, n], distance[slot, n + 1], distance[slot, n + 8], distance[slot, n + 9]
        a, b = a + (distance[slot, n + 64] - a) * fx, b + (distance[slot, n + 65] - b) * fx
        c, e = c + (distance[slot, n + 72] - c) * fx, e + (distance[slot, n + 73] - e) * fx
        a, b = a + (c - a) * fy, b + (e - b) * fy
        return a + (b - a) * fz if least > np.float32(0.0) else np.nan
    total = 0.0
    last_i, last_j, last_k = i >> 3, j >> 3, k >> 3
    for corner in range(8):
        di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
        bi, bj, bk = (i + di) >> 3, (j + dj) >> 3, (k + dk) >> 3
        if bi != last_i or bj != last_j or bk != last_k:
            slot = lookup(table, bi, bj, bk)
            last_i, last_j, last_k = bi, bj, bk
        local = ((i + di) & 7) << 6 | ((j + dj) & 7) << 3 | ((k + dk) & 7)
        if slot < 0 or not weight[slot, local] > np.float32(0.0):
            return np.nan
        share = (fx if di else 1.0 - fx) * (fy if dj else 1.0 - fy) * (fz if dk else 1.0 - fz)
        total += share * distance[slot, local]
    return total


@njit(cache=True, parallel=True)
def interpolate(table: Array, distance: Array, weight: Array, voxel_size: Float, p_map: Array, values: Array) -> None:
    """Trilinear signed distance at each point (n, 3) [m] between the eight voxel centres about it; fills values (n,),
    NaN where one of them is unknown."""
    per_voxel = 1.0 / voxel_size
    bound = 8.0 * BLOCK_LIMIT - 2.0
    chunks = (p_map.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(chunks):
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        slot: Int = np.int64(-1)
        for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, p_map.shape[0])):
            x, y, z = p_map[n, 0] * per_voxel - 0.5, p_map[n, 1] * per_voxel - 0.5, p_map[n, 2] * per_voxel - 0.5
            if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
                values[n] = np.nan
                continue
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            bi, bj, bk = i >> 3, j >> 3, k >> 3
            if bi != last_i or bj != last_j or bk != last_k:
                slot = lookup(table, bi, bj, bk)
                last_i, last_j, last_k = bi, bj, bk
            values[n] = sample_field(table, distance, weight, i, j, k, slot, x - i, y - j, z - k)


@njit(cache=True, parallel=True)
def blend_colors(table: Array, color: Array, voxel_size: Float, p_map: Array, colors: Array) -> None:
    """Colour at each point (n, 3) [m]: the mean of the eight voxels about it that have one, by nearness.

    color  : (capacity, 512, 3) uint16 in 1/256 of a step, 0 0 0 where there is none
    colors : (n, 3) uint8, filled; 0 where none of the eight has a colour
    """
    per_voxel = 1.0 / voxel_size
    bound = 8.0 * BLOCK_LIMIT - 2.0
    chunks = (p_map.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(chunks):
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        slot: Int = np.int64(-1)
        for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, p_map.shape[0])):
            x, y, z = p_map[n, 0] * per_voxel - 0.5, p_map[n, 1] * per_voxel - 0.5, p_map[n, 2] * per_voxel - 0.5
            if not (abs(x) < bound and abs(y) < bound and abs(z) < bound):  # also NaN
                colors[n, 0] = colors[n, 1] = colors[n, 2] = np.uint8(0)
                continue
            i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            fx, fy, fz = x - i, y - j, z - k
            red = green = blue = total = 0.0
            for corner in range(8):
                di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
                bi, bj, bk = (i + di) >> 3, (j + dj) >> 3, (k + dk) >> 3
                if bi != last_i or bj != last_j or bk != last_k:
                    slot = lookup(table, bi, bj, bk)
                    last_i, last_j, last_k = bi, bj, bk
                if slot < 0:
                    continue
                rgb = color[slot, ((i + di) & 7) << 6 | ((j + dj) & 7) << 3 | ((k + dk) & 7)]
                if rgb[0] == 0 and rgb[1] == 0 and rgb[2] == 0:
                    continue
                share = (fx if di else 1.0 - fx) * (fy if dj else 1.0 - fy) * (fz if dk else 1.0 - fz) + 1e-6
                red, green, blue = red + share * rgb[0], green + share * rgb[1], blue + share * rgb[2]
                total += share
            scale = 1.0 / (COLOR_STEPS * total) if total > 0.0 else 0.0
            colors[n, 0] = np.uint8(red * scale)
            colors[n, 1] = np.uint8(green * scale)
            colors[n, 2] = np.uint8(blue * scale)
