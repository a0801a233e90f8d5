"""Records of voxels before what an image sees."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.packed import count_bits

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

_ONE = np.uint64(1)


@njit(cache=True)
def list_seen_through(
    masks: Array,
    block_ijk: Array,
    slots: Array,
    voxel: Float,
    reach: Array,
    camera: Array,
    margin: Float,
    share: Float,
    around: Int,
) -> Array:
    """The cells (n,) int64 of the records in blocks `slots` that lie before all that is seen about them.

    reach, camera : as in `mapping.kernels.visibility`
    A record's centre at depth z is seen through when each pixel of five, its own and those `around` px beside it,
    above and below, reaches farther than z · (1 + share) + margin.
    """
    height, width = reach.shape
    cells = np.empty(1024, np.int64)
    n = 0
    for m in range(slots.shape[0]):
        slot = slots[m]
        if n + 512 > cells.shape[0]:  # once a block: an array that is assigned in a loop is counted as a reference
            cells = np.concatenate((cells, np.empty_like(cells)))
        for slab in range(8):
            left = masks[slot, slab]
            while left:
                bit = left & (~left + _ONE)
                left ^= bit
                local = slab << 6 | count_bits(bit - _ONE)
                a = (8 * block_ijk[slot, 0] + (local >> 6) + 0.5) * voxel
                b = (8 * block_ijk[slot, 1] + (local >> 3 & 7) + 0.5) * voxel
                c = (8 * block_ijk[slot, 2] + (local & 7) + 0.5) * voxel
                z = camera[6] * a + camera[7] * b + camera[8] * c + camera[11]
                if not z > 0.0:
                    continue
                x = camera[0] * a + camera[1] * b + camera[2] * c + camera[9]
                y = camera[3] * a + camera[4] * b + camera[5] * c + camera[10]
                u = np.int64(np.floor(camera[12] * x / z + camera[14] + 0.5))
                v = np.int64(np.floor(camera[13] * y / z + camera[15] + 0.5))
                if u < around or v < around or u >= width - around or v >= height - around:
                    continue
                beyond = z * (1.0 + share) + margin
                if (
                    abs(reach[v, u]) > beyond
                    and abs(reach[v, u - around]) > beyond
                    and abs(reach[v, u + around]) > beyond
                    and abs(reach[v - around, u]) > beyond
                    and abs(reach[v + around, u]) > beyond
                ):
                    cells[n] = slot << 9 | local
                    n += 1
    return cells[:n].copy()
