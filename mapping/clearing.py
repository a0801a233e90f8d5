"""Which voxels of a surface are no longer there: a later image sees through them, and the occupancy map agrees.

What lay nearer than a voxel of the occupancy map to what is still there is not told from it. Of a thing that has gone,
such a rest is let go when most of the thing has faded; a thing that was all as flat as that does not fade, it is
outvoted where the surface below falls into the same voxels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ijk_to_centre, point_to_ijk
from mapping.instances import InstanceMap
from mapping.kernels import clearing as kernels
from mapping.occupancy import OccupancyMap
from mapping.packed import PackedStore
from mapping.semantics import SemanticMap
from mapping.view import DepthView

Array: TypeAlias = NDArray[Any]

MARGIN_VOXELS = 1.0
"""An image sees through a voxel when it sees farther than it by so many voxels of the occupancy map …"""
MARGIN_SHARE = 0.015
"""… and by this share of the distance, as depth and the angles of a pose are less certain far away, …"""
MARGIN_RAD = 0.02
"""… in the pixels so far to the left and right, above and below, too (one pixel at least): twice what a pose errs, as
edges and what is thin would fade else."""
TURNS = 3
"""Of all blocks, one image looks at every so-manieth."""
REST_SHARE = 0.25
"""When no more than this share is left of a thing that faded and was not seen meanwhile, the rest goes, too."""


class Clearing:
    """Lets go of what classes and instances know of voxels through which images see."""

    def __init__(self) -> None:
        self._images = 0
        self._faded: dict[int, tuple[int, int]] = {}  # instance → when it was seen last, voxels that it lost since

    def update(
        self, view: DepthView, occupancy: OccupancyMap, semantics: SemanticMap, instances: InstanceMap
    ) -> set[int]:
        """Let fade what one image sees through; returns the instances that lost voxels, among them those that are given
        up."""
        self._images += 1
        voxels, sure = seen_through(view, semantics.store, occupancy, turn=self._images)
        if len(voxels):
            semantics.fade(voxels, sure)
        voxels, sure = seen_through(view, instances.store, occupancy, turn=self._images)
        if not len(voxels):
            return set()
        faded = instances.fade(voxels, sure)
        for instance_id in sorted(faded):
            left = instances.n_voxels(instance_id)
            seen = instances.instances[instance_id].last_seen_ns
            since, lost = self._faded.get(instance_id, (seen, 0))
            lost = faded[instance_id] + (lost if since == seen else 0)
            self._faded[instance_id] = (seen, lost)
            if left <= REST_SHARE * (left + lost):
                rest = point_to_ijk(instances.points(instance_id)[0], instances.voxel_size_m)
                semantics.fade(rest, np.ones(len(rest), np.bool_))
                instances.forget(instance_id)
                del self._faded[instance_id]
        return set(faded)

    def state(self) -> dict[str, Array]:
        """How many images there were, and what faded."""
        rows = [(instance_id, *row) for instance_id, row in self._faded.items()]
        return {"images": np.array(self._images), "faded": np.array(rows, np.int64).reshape(-1, 3)}

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> Clearing:
        """What `state` gave."""
        clearing = cls()
        clearing._images = int(state["images"])
        clearing._faded = {instance_id: (seen, lost) for instance_id, seen, lost in state["faded"].tolist()}
        return clearing


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
