"""What a camera would see of a signed distance map: bounds of where a surface can be, then a march along each ray.

After Newcombe et al., KinectFusion, ISMAR 2011, §3.3 (march to the change of sign, place it by interpolation, normal
from the gradient) and Prisacariu et al., A Framework for the Volumetric Integration of Depth Images, 2014 (range images
of the blocks, so that a ray begins where something can be).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import BLOCK_LIMIT, lookup
from mapping.kernels.surface import pad_block
from mapping.kernels.tsdf import sample_field

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

TILE = 8
"""Edge in pixels of the cells for which nearest and farthest possible surface are kept."""
CAUTION = 0.7
"""Share of the distance at a point that a ray is moved on: distances were measured along other rays."""
FAR_APART = 1.5
"""In voxels: the change of sign is narrowed down to this before the surface is interpolated."""
REFINEMENTS = 1
"""How often the distance is measured where the surface was interpolated, before it is interpolated for the last
time."""


@njit(cache=True, parallel=True)
def box_surfaces(table: Array, distance: Array, weight: Array, max_jump: Float, blocks: Array, boxes: Array) -> None:
    """The box about the surface in each of `blocks` (n, 3): boxes (n, 6) int8, filled.

    A box is the lowest and the highest voxel, −1 … 9 in the block, of the cells about every edge between voxels on
    which the sign changes by no more than `max_jump` [m]; where there is none the lowest is above the highest.
    """
    for n in prange(blocks.shape[0]):
        padded = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], padded)
        low_i = low_j = low_k = 100
        high_i = high_j = high_k = -100
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    here = padded[i + 1, j + 1, k + 1]
                    x, y, z = padded[i + 2, j + 1, k + 1], padded[i + 1, j + 2, k + 1], padded[i + 1, j + 1, k + 2]
                    inside = here < 0.0
                    along_x = ((x < 0.0) != inside) & (abs(here - x) < max_jump)
                    along_y = ((y < 0.0) != inside) & (abs(here - y) < max_jump)
                    along_z = ((z < 0.0) != inside) & (abs(here - z) < max_jump)
                    if along_x | along_y | along_z:
                        low_i, high_i = min(low_i, i - 1), max(high_i, i + 1)
                        low_j, high_j = min(low_j, j - 1), max(high_j, j + 1)
                        low_k, high_k = min(low_k, k - 1), max(high_k, k + 1)
        boxes[n, 0], boxes[n, 1], boxes[n, 2] = low_i, low_j, low_k
        boxes[n, 3], boxes[n, 4], boxes[n, 5] = high_i, high_j, high_k


@njit(cache=True)
def bound_tiles(blocks: Array, boxes: Array, voxel_size: Float, camera: Array, farthest: Float, bounds: Array) -> None:
    """Lowest and highest depth [m] at which each tile of the image may see the surface in `boxes`, in place.

    blocks, boxes : (n, 3), (n, 6) from `box_surfaces`
    camera        : (18,) as in `mapping.kernels.visibility`
    farthest      : boxes beyond this depth [m] are left out
    bounds        : (⌈H/TILE⌉, ⌈W/TILE⌉, 2) float32, (∞, 0) where there is nothing
    """
    fx, fy, cx, cy, width, height = camera[12], camera[13], camera[14], camera[15], camera[16], camera[17]
    bounds[:, :, 0] = np.inf
    bounds[:, :, 1] = 0.0
    for n in range(blocks.shape[0]):
        if boxes[n, 0] > boxes[n, 3]:
            continue
        u_low = v_low = z_low = np.inf
        u_high = v_high = z_high = -np.inf
        left = right = above = below = True  # the whole box lies outside this side of the frustum
        for corner in range(8):
            a = (8.0 * blocks[n, 0] + 0.5 + (boxes[n, 3] + 0.5 if corner & 4 else boxes[n, 0] - 0.5)) * voxel_size
            b = (8.0 * blocks[n, 1] + 0.5 + (boxes[n, 4] + 0.5 if corner & 2 else boxes[n, 1] - 0.5)) * voxel_size
            c = (8.0 * blocks[n, 2] + 0.5 + (boxes[n, 5] + 0.5 if corner & 1 else boxes[n, 2] - 0.5)) * voxel_size
            x = camera[0] * a + camera[1] * b + camera[2] * c + camera[9]
            y = camera[3] * a + camera[4] * b + camera[5] * c + camera[10]
            z = camera[6] * a + camera[7] * b + camera[8] * c + camera[11]
            z_low, z_high = min(z_low, z), max(z_high, z)
            left &= fx * x < (-0.5 - cx) * z
            right &= fx * x > (width - 0.5 - cx) * z
            above &= fy * y < (-0.5 - cy) * z
            below &= fy * y > (height - 0.5 - cy) * z
            if z > 1e-3:
                u, v = fx * x / z + cx, fy * y / z + cy
                u_low, u_high, v_low, v_high = min(u_low, u), max(u_high, u), min(v_low, v), max(v_high, v)
        if z_high <= 0.0 or z_low > farthest or left or right or above or below:
            continue
        if z_low <= 1e-3:  # about the camera: it may be anywhere in the image
            u_low, u_high, v_low, v_high, z_low = 0.0, width, 0.0, height, 0.0
        for r in range(np.int64(max(v_low, 0.0)) // TILE, np.int64(min(v_high, height - 1.0)) // TILE + 1):
            for c in range(np.int64(max(u_low, 0.0)) // TILE, np.int64(min(u_high, width - 1.0)) // TILE + 1):
                bounds[r, c, 0] = min(bounds[r, c, 0], z_low)
                bounds[r, c, 1] = max(bounds[r, c, 1], z_high)


@njit(cache=True, inline="always")
def step_ahead(z: Float, step: Float, end: Float) -> Float:
    """The next place to look at on a ray: never past `end` without a look at it, and past all once it was."""
    return min(z + step, end) if z < end else np.inf


@njit(cache=True, parallel=True, error_model="numpy")
def cast_view(
    table: Array,
    distance: Array,
    weight: Array,
    voxel_size: Float,
    max_jump: Float,
    camera: Array,
    pose: Array,
    max_range: Float,
    bounds: Array,
    depth: Array,
    normals: Array,
) -> None:
    """March along the ray of each pixel to where the distance changes from before to behind a surface, in place.

    max_jump      : a change by more over one voxel [m] is an edge between two surfaces, not a surface
    camera, pose  : (18,) as in `mapping.kernels.visibility`; (12,) R_map_camera row by row, then t_map_camera
    bounds        : from `bound_tiles`
    depth, normals: (H, W) float32 z [m] and (H, W, 3) float32 in the map, into free space; left as they are
                    where nothing is seen
    """
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    per_voxel = 1.0 / voxel_size
    o0, o1, o2 = pose[9] * per_voxel - 0.5, pose[10] * per_voxel - 0.5, pose[11] * per_voxel - 0.5
    for v in prange(depth.shape[0]):
        last_i, last_j, last_k = np.int64(BLOCK_LIMIT), np.int64(0), np.int64(0)
        slot: Int = np.int64(-1)
        corners, gradient = np.empty(8, np.float64), np.empty(3, np.float64)
        for u in range(depth.shape[1]):
            z, end = np.float64(bounds[v // TILE, u // TILE, 0]), np.float64(bounds[v // TILE, u // TILE, 1])
            if not z < end:
                continue
            a, b = (u - cx) / fx, (v - cy) / fy
            stretch = np.sqrt(1.0 + a * a + b * b)
            end = min(end, max_range / stretch)
            r0 = (pose[0] * a + pose[1] * b + pose[2]) * per_voxel
            r1 = (pose[3] * a + pose[4] * b + pose[5]) * per_voxel
            r2 = (pose[6] * a + pose[7] * b + pose[8]) * per_voxel
            per_length = 1.0 / stretch  # of z
            before, behind, z_before, z_behind, tries = np.nan, np.nan, z, z, 0
            while z <= end:
                p0, p1, p2 = o0 + z * r0, o1 + z * r1, o2 + z * r2
                if not behind < 0.0:
                    # Far from a surface the nearest voxel says enough.
                    i, j, k = np.int64(np.floor(p0 + 0.5)), np.int64(np.floor(p1 + 0.5)), np.int64(np.floor(p2 + 0.5))
                    if i >> 3 != last_i or j >> 3 != last_j or k >> 3 != last_k:
                        last_i, last_j, last_k = i >> 3, j >> 3, k >> 3
                        slot = lookup(table, last_i, last_j, last_k)
                    if slot < 0:  # no block: to where the ray leaves it
                        leave = ((last_i + (r0 > 0.0)) * 8.0 - 0.5 - p0) / r0 if r0 != 0.0 else np.inf
                        leave = min(leave, ((last_j + (r1 > 0.0)) * 8.0 - 0.5 - p1) / r1 if r1 != 0.0 else np.inf)
                        leave = min(leave, ((last_k + (r2 > 0.0)) * 8.0 - 0.5 - p2) / r2 if r2 != 0.0 else np.inf)
                        z = step_ahead(z, max(leave, 0.0) + 0.01 * voxel_size * per_length, end)
                        before = np.nan
                        continue
                    local = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
                    nearest = np.float64(distance[slot, local])
                    if not weight[slot, local] > np.float32(0.0):
                        z = step_ahead(z, voxel_size * per_length, end)
                        before = np.nan
                        continue
                    if nearest > 2.0 * voxel_size:
                        before, z_before = nearest, z
                        z = step_ahead(z, CAUTION * (nearest - voxel_size) * per_length, end)
                        continue
                    if nearest < -2.0 * voxel_size and not before >= 0.0:
                        z = step_ahead(z, -CAUTION * (nearest + voxel_size) * per_length, end)
                        continue
                i, j, k = np.int64(np.floor(p0)), np.int64(np.floor(p1)), np.int64(np.floor(p2))
                if i >> 3 != last_i or j >> 3 != last_j or k >> 3 != last_k:
                    last_i, last_j, last_k = i >> 3, j >> 3, k >> 3
                    slot = lookup(table, last_i, last_j, last_k)
                here = sample_field(table, distance, weight, i, j, k, slot, p0 - i, p1 - j, p2 - k)
                if behind < 0.0:  # the change of sign lies between z_before and z_behind
                    if here >= 0.0:
                        z_before, before = z, here
                    else:
                        z_behind, behind = z, here
                elif here >= 0.0:
                    before, z_before = here, z
                    z = step_ahead(z, max(CAUTION * here, voxel_size) * per_length, end)
                    continue
                elif here < 0.0 and before >= 0.0:
                    z_behind, behind, tries = z, here, 0
                else:
                    before = np.nan
                    z = step_ahead(z, voxel_size * per_length, end)
                    continue
                between = (z_behind - z_before) * stretch * per_voxel
                if not here > -np.inf or (
                    tries == 0 and between <= FAR_APART and before - behind >= max_jump * between
                ):
                    norm = 0.0
                elif tries < REFINEMENTS:
                    if between > FAR_APART:
                        z = 0.5 * (z_before + z_behind)
                    else:
                        z = z_before + (z_behind - z_before) * before / (before - behind)
                        tries += 1
                    continue
                else:
                    read_corners(table, distance, i, j, k, slot, corners)
                    norm = find_slope(corners, max_jump, p0 - i, p1 - j, p2 - k, gradient)
                if norm > 0.0:
                    depth[v, u] = z_before + (z_behind - z_before) * before / (before - behind)
                    for axis in range(3):
                        normals[v, u, axis] = gradient[axis] / norm
                    break
                # something unknown, or an edge between two surfaces
                z = step_ahead(z_behind, 0.5 * voxel_size * per_length, end)
                before = behind = np.nan


@njit(cache=True, forceinline=True)
def read_corners(table: Array, distance: Array, i: Int, j: Int, k: Int, slot: Int, corners: Array) -> None:
    """The distances (8,) of the known voxels from (i, j, k) on, in place; `slot` is that of the first one's block."""
    if (i & 7) < 7 and (j & 7) < 7 and (k & 7) < 7:
        n = (i & 7) << 6 | (j & 7) << 3 | (k & 7)
        for corner in range(8):
            corners[corner] = distance[slot, n + ((corner & 4) << 4 | (corner & 2) << 2 | (corner & 1))]
        return
    for corner in range(8):
        a, b, c = i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1)
        corners[corner] = distance[lookup(table, a >> 3, b >> 3, c >> 3), (a & 7) << 6 | (b & 7) << 3 | (c & 7)]


@njit(cache=True)
def find_slope(corners: Array, max_jump: Float, fx: Float, fy: Float, fz: Float, gradient: Array) -> Float:
    """Gradient (3,) [m a voxel] between eight corners, at the shares fx, fy, fz of the way, in place.

    Returns its norm; 0 where the sign changes by `max_jump` or more along an edge between two of them: there is no
    surface there, as in the mesh.
    """
    for corner in range(8):
        here = corners[corner]
        for bit in (4, 2, 1):
            there = corners[corner | bit]
            if (here < 0.0) != (there < 0.0) and not abs(here - there) < max_jump:
                return 0.0
    gx, gy, gz = 1.0 - fx, 1.0 - fy, 1.0 - fz
    gradient[0] = (
        (corners[4] - corners[0]) * gy * gz
        + (corners[5] - corners[1]) * gy * fz
        + (corners[6] - corners[2]) * fy * gz
        + (corners[7] - corners[3]) * fy * fz
    )
    gradient[1] = (
        (corners[2] - corners[0]) * gx * gz
        + (corners[3] - corners[1]) * gx * fz
        + (corners[6] - corners[4]) * fx * gz
        + (corners[7] - corners[5]) * fx * fz
    )
    gradient[2] = (
        (corners[1] - corners[0]) * gx * gy
        + (corners[3] - corners[2]) * gx * fy
        + (corners[5] - corners[4]) * fx * gy
        + (corners[7] - corners[6]) * fx * fy
    )
    return np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
