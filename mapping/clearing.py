"""Which voxels of a surface are no longer there: a later image sees through them, and the occupancy map agrees.

What was flatter than a voxel of the occupancy map and lay on something is not told from what it lay on: it does not
fade, it is outvoted where the surface below falls into the same voxels.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ijk_to_centre
from mapping.kernels import clearing as kernels
from mapping.occupancy import OccupancyMap
from mapping.packed import PackedStore
from mapping.view import DepthView

Array: TypeAlias = NDArray[Any]

MARGIN_VOXELS = 1.0
"""An image sees through a voxel when it sees farther than it by so many voxels of the occupancy map …"""
MARGIN_SHARE = 0.015
"""… and by this share of the distance, as depth and the angles of a pose are less certain far away, …"""
MARGIN_RAD = 0.009
"""… in the pixels so far to the left and right, above and below, too (one pixel at least): about what a pose errs."""
TURNS = 3
"""Of all blocks, one image looks at every so-manieth."""


def seen_through(
    view: DepthView, store: PackedStore, occupancy: OccupancyMap, *, turn: int = 0
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Voxels (N, 3) of `store` through which the image sees and which the occupancy map holds for free, and whether it
    is as sure of that as it can be (N,).

    turn : number of the image; any TURNS images that follow each other look at all blocks
    """
    margin = MARGIN_VOXELS * occupancy.voxel_size_m
    blocks, _ = view.blocks(store.block_size_m, front_m=margin, back_m=0.0, with_free=True)
    slots = store.find(blocks)
    slots = slots[(slots >= 0) & (slots % TURNS == turn % TURNS)]
    around = max(1, round(MARGIN_RAD * float(view.camera[12])))
    cells = kernels.list_seen_through(
        store.masks, store.block_ijk, slots, store.voxel_size_m, view.reach, view.camera, margin, MARGIN_SHARE,
        around,
    )  # fmt: skip
    voxels = store.ijk(cells)
    probability = occupancy.query(ijk_to_centre(voxels, store.voxel_size_m))
    free = probability < 0.5
    return voxels[free], probability[free] <= occupancy.lowest + 0.01
