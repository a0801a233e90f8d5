"""Semantic voxels: which class a piece of surface belongs to, by votes, with the runner-up kept.

Confidence is the leader's share of all votes, so it falls when observations disagree. Per voxel two classes and the sum
of all votes are kept, whatever the number of classes (Misra & Gries 1982); votes age once a voxel has seen `memory`.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore, as_points, point_to_ijk
from mapping.kernels import votes as kernels
from mapping.layer import Changed, MapLayer, require

Array: TypeAlias = NDArray[Any]

_NO_MEAN = np.empty((0, 0, 3), np.float32)


def camera_row(intrinsics: CameraIntrinsics) -> Array:
    """(4,) fx, fy, cx, cy as kernels take them."""
    return np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])


def pose_rows(T_map_camera: SE3) -> Array:
    """(3, 4) rotation and translation as kernels take them."""
    return np.ascontiguousarray(T_map_camera.matrix[:3])


class SemanticMap(MapLayer):
    """Class votes per voxel.

    voxel_size_m  edge of a voxel [m]
    memory        votes (about: full views) after which older ones begin to count half
    """

    kind = "semantics"

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
        """Class id (N,), 0 where unknown, and the leader's share of the votes (N,), NaN where unknown."""
        slots, local = self.store.locate(p_map)
        known = slots >= 0
        at = (np.where(known, slots, 0), local)
        labels = np.zeros(len(slots), np.uint16)
        confidence = np.full(len(slots), np.nan, np.float32)
        if self.store.n_blocks:
            total = self.store.fields["total"][at]
            known &= total > 0
            labels[known] = self.store.fields["label"][at][known]
            confidence[known] = self.store.fields["weight"][at][known] / total[known]
        return labels, confidence

    def voxels(self) -> tuple[Array, Array, Array]:
        """Centres (N, 3) [m], class ids (N,) and confidences (N,) of all voxels with a vote."""
        slots, local = np.nonzero(self.store.used("total") > 0)
        ijk = (self.block_ijk[slots] << 3) + np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1)
        at = (slots, local)
        share = self.store.fields["weight"][at] / self.store.fields["total"][at]
        return (ijk + 0.5) * self.voxel_size_m, self.store.fields["label"][at], share

    def _votes(self) -> tuple[Array, ...]:
        return tuple(self.store.fields[name] for name in ("label", "weight", "second", "second_weight", "total"))
