"""Slow, obvious twins of the distance field and of what bodies touch in it: every voxel is looked at."""

from __future__ import annotations

from math import floor

import numpy as np
import shapely

from mapping.grid import LOCAL_IJK


def nearest_squared(sites: np.ndarray) -> np.ndarray:
    """Squared distance [voxels²] from each voxel of a dense bool array to the nearest site, by trying all."""
    places = np.argwhere(sites)
    squared = np.full(sites.shape, np.iinfo(np.int64).max)
    for place in places:
        x, y, z = (np.arange(n) - at for n, at in zip(sites.shape, place, strict=True))
        squared = np.minimum(squared, (x**2)[:, None, None] + (y**2)[:, None] + z**2)
    return squared


def blocks_of(sites: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The blocks (n, 3) of a dense bool array, row by row, and their sites as one plane of bits (n, 1, 8) uint64."""
    blocks = np.argwhere(np.ones(np.array(sites.shape) // 8, bool))
    bits = np.zeros((len(blocks), 1, 8), np.uint64)
    for n, block in enumerate(blocks):
        for x, y, z in LOCAL_IJK[sites[tuple((LOCAL_IJK + 8 * block).T)]]:
            bits[n, 0, x] |= np.uint64(1 << int(8 * y + z))
    return blocks, bits


def signed_distances(blocks: np.ndarray, evidence: np.ndarray, voxel_size: float, truncation: float) -> np.ndarray:
    """What an `EsdfMap` holds for blocks (n, 3) of evidence (n, 512): float32 (n, 512) [m]."""
    first = blocks.min(axis=0)
    dense = np.full(8 * (blocks.max(axis=0) - first + 1), -128, np.int8)
    for block, values in zip(blocks, evidence, strict=True):
        dense[tuple((LOCAL_IJK + 8 * (block - first)).T)] = values
    occupied, free = dense >= 0, (dense < 0) & (dense != -128)
    size, half = np.float32(voxel_size), np.float32(0.5)
    outside = (np.sqrt(nearest_squared(occupied), dtype=np.float32) - half) * size
    inside = (np.sqrt(nearest_squared(free), dtype=np.float32) - half) * size
    longest = np.float32(truncation)
    signed = np.where(free, np.minimum(outside, longest), np.where(occupied, -np.minimum(inside, longest), np.nan))
    return np.stack([signed[tuple((LOCAL_IJK + 8 * (block - first)).T)] for block in blocks]).astype(np.float32)


# -- bodies ----------------------------------------------------------------------------------------------------


def touched_by_sphere(centre: np.ndarray, radius: float, voxel_size: float) -> np.ndarray:
    """The voxels (n, 3) whose cube has a point inside the sphere."""
    low = np.floor((centre - radius) / voxel_size).astype(int) - 1
    high = np.floor((centre + radius) / voxel_size).astype(int) + 2
    voxels = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    nearest = np.clip(centre, voxels * voxel_size, (voxels + 1) * voxel_size)
    return voxels[np.linalg.norm(nearest - centre, axis=1) < radius]


def touched_by_prism(plan: shapely.Polygon, low: float, high: float, voxel_size: float) -> np.ndarray:
    """The voxels (n, 3) whose cube has a point inside the prism over `plan` [m] from `low` to `high` [m]."""
    west, south, east, north = (np.array(plan.bounds) / voxel_size).tolist()
    columns = [
        (i, j)
        for i in range(floor(west) - 1, floor(east) + 2)
        for j in range(floor(south) - 1, floor(north) + 2)
        if plan.intersection(shapely.box(*(voxel_size * np.array([i, j, i + 1, j + 1])))).area > 1e-12
    ]
    levels = range(floor(low / voxel_size) - 1, floor(high / voxel_size) + 2)
    levels = [k for k in levels if min(high, (k + 1) * voxel_size) - max(low, k * voxel_size) > 1e-9]
    return np.array([(i, j, k) for i, j in columns for k in levels])


def verdict(codes: np.ndarray) -> int:
    """What is known of a body that touches voxels of these classes (1 occupied, 0 free, −1 unknown): 0 it collides, −1
    nothing, 1 it is free."""
    if (codes == 1).any():
        return 0
    return -1 if (codes == -1).any() else 1
