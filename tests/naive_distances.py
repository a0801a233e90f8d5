"""Slow, obvious twins of the distance field: every voxel against every site, dense arrays."""

from __future__ import annotations

import numpy as np

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
