"""Range images into signed distances; arguments as in `mapping.kernels.tsdf` and `mapping.kernels.lidar`."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.lidar import project_block
from mapping.kernels.tsdf import fold_block

Array: TypeAlias = NDArray[Any]
Float: TypeAlias = Any

TOUCH = 0.75
"""A beam tells of a voxel whose centre it passes within √TOUCH of its edge: half the voxel's diagonal."""


@njit(cache=True, parallel=True, error_model="numpy")
def find_band(
    blocks: Array,
    slots: Array,
    voxel_size: Float,
    truncation: Float,
    reach: Array,
    lidar: Array,
    row_of: Array,
    off_row: Array,
    wanted: Array,
) -> None:
    """Which blocks (n, 3) exist (slot ≥ 0) or have a voxel within `truncation` [m] of the surface: fills wanted."""
    seen = reach.ravel()
    tau = np.float32(truncation)
    touch = np.float32(TOUCH * voxel_size * voxel_size)
    for n in prange(blocks.shape[0]):
        wanted[n] = slots[n] >= 0
        if wanted[n]:
            continue
        pixels = np.empty(512, np.int32)
        r, aside = np.empty(512, np.float32), np.empty(512, np.float32)
        project_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, lidar, row_of, off_row, pixels, r, aside)
        for w in range(512):
            if pixels[w] >= 0 and aside[w] <= touch:
                d = seen[pixels[w]]
                if d > np.float32(0.0) and abs(d - r[w]) <= tau:
                    wanted[n] = True
                    break


@njit(cache=True, parallel=True, error_model="numpy")
def fuse_ranges(
    distance: Array,
    weight: Array,
    slots: Array,
    blocks: Array,
    voxel_size: Float,
    truncation: Float,
    carve: bool,
    inverse_square: bool,
    max_weight: Float,
    reach: Array,
    lidar: Array,
    row_of: Array,
    off_row: Array,
    changed: Array,
) -> None:
    """Fold one range image into the running mean of each voxel that a beam touches, of the blocks in `slots` (n,), in
    place; fills changed (n,) bool."""
    seen = reach.ravel()
    zero = np.float32(0.0)
    tau = np.float32(truncation)
    touch = np.float32(TOUCH * voxel_size * voxel_size)
    for n in prange(slots.shape[0]):
        pixels = np.empty(512, np.int32)
        r, s, gains = np.empty(512, np.float32), np.empty(512, np.float32), np.empty(512, np.float32)
        project_block(blocks[n, 0], blocks[n, 1], blocks[n, 2], voxel_size, lidar, row_of, off_row, pixels, r, s)
        for w in range(512):  # s: squared distance to the beam → signed distance along it, NaN where unseen
            d = seen[max(pixels[w], 0)]
            along = abs(d) - r[w]
            in_front = d > zero or (d < zero and along >= tau)
            s[w] = along if pixels[w] >= 0 and s[w] <= touch and in_front else np.float32(np.nan)
        changed[n] = fold_block(
            distance, weight, slots[n], s, r, voxel_size, truncation, carve, inverse_square, 0.0, max_weight, gains
        )
