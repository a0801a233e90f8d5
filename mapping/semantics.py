"""Semantic voxels: which class a piece of surface belongs to, by votes, with the runner-up kept.

Confidence is the leader's share of all votes, so it falls when observations disagree. Per voxel two classes and the sum
of all votes are kept, whatever the number of classes (Misra & Gries 1982); votes age once a voxel has seen `memory`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore, as_points, ijk_to_centre, join_ijk, point_to_ijk
from mapping.kernels import votes as kernels
from mapping.layer import BlockLayer, Changed, require

if TYPE_CHECKING:
    from mapping.instances import InstanceMap

Array: TypeAlias = NDArray[Any]

LEAST_THING_VOTES = 0.1
"""A voxel is a thing's when the fine voxels in it have more votes for it (about: full views) than this, and than for
others."""

_NO_MEAN = np.empty((0, 0, 3), np.float32)


def camera_row(intrinsics: CameraIntrinsics) -> Array:
    """(4,) fx, fy, cx, cy as kernels take them."""
    return np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])


def pose_rows(T_map_camera: SE3) -> Array:
    """(3, 4) rotation and translation as kernels take them."""
    return np.ascontiguousarray(T_map_camera.matrix[:3])


class SemanticMap(BlockLayer):
    """Class votes per voxel.

    voxel_size_m  edge of a voxel [m]
    memory        votes (about: full views) after which older ones begin to count half

    A voxel on a thing is of the thing's class, once `things` is set: a whole thing is right more often than single
    voxels of it, which are seen less often and lie at the border of masks.
    """

    kind = "semantics"
    things: InstanceMap | None = None
    """The instances whose classes outrank the votes of single voxels."""

    def __init__(self, *, voxel_size_m: float, memory: float = 200.0) -> None:
        self.memory = require("memory", memory, 0.0, 1e6)
        self.store = BlockStore(
            {"label": "u2", "weight": "f4", "second": "u2", "second_weight": "f4", "total": "f4"}, voxel_size_m
        )

    def parameters(self) -> dict[str, Any]:
        return {"voxel_size_m": self.voxel_size_m, "memory": self.memory}

    def integrate(self, p_map: ArrayLike, labels: ArrayLike, weights: ArrayLike | None = None) -> Changed:
        """Votes of points: p_map (N, 3) [m], class ids (N,) with 0 = no vote, weights (N,) ≥ 0 (default 1)."""
        points, choices = as_points(p_map), np.ascontiguousarray(labels, dtype=np.uint16)
        trust = np.ones(len(points), np.float32) if weights is None else np.ascontiguousarray(weights, dtype=np.float32)
        if not len(points) == len(choices) == len(trust):
            raise InvalidParameter(
                f"labels, weights: expected one a point, {len(points)}, got {len(choices)}, {len(trust)}"
            )
        voting = (choices != 0) & (trust > 0)
        slots = self.store.allocate(np.unique(point_to_ijk(points[voting], self.voxel_size_m) >> 3, axis=0))
        kernels.vote_points(self.store.table, *self._votes(), points, choices, trust, self.voxel_size_m, self.memory)
        return self._note(slots)

    def integrate_image(
        self, depth_m: Array, labels: Array, trust: Array, intrinsics: CameraIntrinsics, T_map_camera: SE3
    ) -> Changed:
        """Votes of pixels: depth (H, W) float32 [m], class ids (H, W) uint16 with 0 = no vote, trust (H, W) in 0 …
        1."""
        camera, pose = camera_row(intrinsics), pose_rows(T_map_camera)
        voting = (labels != 0) & (depth_m > 0)
        blocks = kernels.touched_blocks(depth_m, voting, camera, pose, self.voxel_size_m, 2)
        slots = self.store.allocate(blocks)
        choices = np.where(voting, labels, 0).astype(np.uint16)
        kernels.vote_image(
            self.store.table,
            *self._votes(),
            _NO_MEAN,
            depth_m,
            choices,
            np.ascontiguousarray(trust, dtype=np.float32),
            camera,
            pose,
            self.voxel_size_m,
            self.memory,
            0.0,
        )
        return self._note(slots)

    def query(self, p_map: ArrayLike) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Class id (N,), 0 where unknown, and its share of the votes (N,), NaN where unknown."""
        points = as_points(p_map)
        slots, local = self.store.locate(points)
        labels, shares = np.zeros(len(slots), np.uint16), np.full(len(slots), np.nan, np.float32)
        if not self.store.n_blocks:
            return labels, shares
        known = (slots >= 0) & (self.store.fields["total"][np.where(slots >= 0, slots, 0), local] > 0)
        ijk = point_to_ijk(points[known], self.voxel_size_m)
        labels[known], shares[known] = self._classes(ijk, slots[known], local[known])
        return labels, shares

    def voxels(self) -> tuple[Array, Array, Array]:
        """Centres (N, 3) [m], class ids (N,) and confidences (N,) of all voxels with a vote."""
        slots, local = np.nonzero(self.store.used("total") > 0)
        ijk = join_ijk(self.block_ijk[slots], local)
        return ijk_to_centre(ijk, self.voxel_size_m), *self._classes(ijk, slots, local)

    def _classes(self, ijk: Array, slots: Array, local: Array) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Class (N,) of voxels (N, 3) with votes, stored at slots and local (N,), and its share of the votes."""
        labels = self.store.fields["label"][slots, local].copy()
        shares = self.store.fields["weight"][slots, local] / self.store.fields["total"][slots, local]
        if self.things is not None and len(ijk):
            of_thing, votes, others = self.things.classes(ijk * self.voxel_size_m, (ijk + 1) * self.voxel_size_m)
            sure = votes > np.maximum(others, LEAST_THING_VOTES)
            labels[sure] = of_thing[sure]
            shares[sure] = votes[sure] / (votes[sure] + others[sure])
        return labels, np.asarray(shares, np.float32)

    def _votes(self) -> tuple[Array, ...]:
        return tuple(self.store.fields[name] for name in ("label", "weight", "second", "second_weight", "total"))
