"""A depth image prepared for fusion: what each pixel saw, and which blocks the image can say anything about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import read_only
from mapping.kernels import occupancy, visibility

Array: TypeAlias = NDArray[Any]

ROOTS_ALONG_AXIS = 4
"""About so many cells along the frustum's box are where the search for blocks begins."""


def as_pose(pose: SE3 | ArrayLike, name: str) -> SE3:
    """An `SE3` or a homogeneous matrix (4, 4) as `SE3`."""
    return pose if isinstance(pose, SE3) else SE3.from_matrix(pose)


def as_camera(intrinsics: CameraIntrinsics | Mapping[str, float]) -> CameraIntrinsics:
    """A camera model, or its fields by name, as `CameraIntrinsics`."""
    return intrinsics if isinstance(intrinsics, CameraIntrinsics) else CameraIntrinsics.model_validate(intrinsics)


def camera_arrays(model: CameraIntrinsics, pose: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A camera (18,) and its pose (12,) as kernels take them, see `mapping.kernels.visibility`."""
    to_camera = pose.rotation.T
    intrinsics = (model.fx, model.fy, model.cx, model.cy, model.width, model.height)
    camera = np.concatenate([to_camera.ravel(), -to_camera @ pose.translation, intrinsics])
    return camera, np.concatenate([pose.rotation.ravel(), pose.translation])


def as_depth_m(depth: Array) -> NDArray[np.float32]:
    """A depth image as float32 metres: float32 is metres, uint16 millimetres; 0 or NaN = not measured."""
    image = np.asarray(depth)
    if image.ndim != 2:
        raise InvalidObservation(f"depth: expected an image (H, W), got shape {image.shape}")
    if image.dtype == np.uint16:
        return read_only(image * np.float32(0.001))
    if image.dtype != np.float32:
        raise InvalidObservation(f"depth: expected float32 [m] or uint16 [mm], got {image.dtype}")
    return read_only(np.ascontiguousarray(image))


class DepthView:
    """One depth image from one pose, prepared once for any number of layers.

    depth        (H, W) float32 [m] or uint16 [mm]; 0 or NaN = not measured
    max_range_m  surfaces farther than this from the camera [m, along the ray] are not believed; free space is, up to it
    """

    def __init__(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        max_range_m: float,
    ) -> None:
        model = as_camera(intrinsics)
        pose = as_pose(T_map_camera, "T_map_camera")
        depth_m = as_depth_m(depth)
        if depth_m.shape != (model.height, model.width):
            raise InvalidObservation(
                f"depth has shape {depth_m.shape}, but intrinsics say (height, width) = {(model.height, model.width)}"
            )
        self.camera: NDArray[np.float64]
        """(18,) the camera as kernels take it, see `mapping.kernels.visibility`."""
        self.pose: NDArray[np.float64]
        """(12,) R_map_camera row by row, then t_map_camera."""
        self.camera, self.pose = camera_arrays(model, pose)
        self.reach: NDArray[np.float32] = np.empty_like(depth_m)
        """(H, W) float32 see `mapping.kernels.visibility`."""
        visibility.measure_reach(depth_m, self.camera, float(max_range_m), self.reach)
        cells = (visibility.LEVELS, -(-model.height // visibility.CELL), -(-model.width // visibility.CELL), 4)
        self._pyramid = np.empty(cells, np.float32)
        self.farthest_m = float(visibility.build_pyramid(self.reach, self._pyramid))
        """The largest depth z of which the image says anything [m]."""
        self._blocks: dict[tuple[float, float, float, bool, bool], tuple[NDArray[np.int32], NDArray[np.uint8]]] = {}

    def blocks(
        self, block_size_m: float, *, front_m: float, back_m: float, with_free: bool, gaps_are_free: bool = False
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """The blocks (n, 3) that the image sees and their kinds (n,): `visibility.MIXED` or, if asked for, `FREE`.

        front_m, back_m : how far before and behind a surface a block still counts as near it [m]
        gaps_are_free   : whether whatever is near no surface and before some counts as free, even where it is covered
                          in part by pixels that say nothing; for layers that look at surfaces only
        """
        asked = (block_size_m, front_m, back_m, with_free, gaps_are_free)
        if asked not in self._blocks:  # layers with blocks of one size ask for the same
            self._blocks[asked] = self._listed(*asked)
        return self._blocks[asked]

    def _listed(
        self, block_size_m: float, front_m: float, back_m: float, with_free: bool, gaps_are_free: bool
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        roots, level = self._roots(block_size_m, back_m)
        n = 1 << 14
        while True:
            blocks, kinds = np.empty((n, 3), np.int32), np.empty(n, np.uint8)
            count = visibility.list_blocks(
                self._pyramid, self.camera, roots, level, block_size_m, front_m, back_m, with_free, gaps_are_free,
                blocks, kinds,
            )  # fmt: skip
            if count <= n:
                return read_only(blocks[:count]), read_only(kinds[:count])
            n = count

    def mark_free(self, blocks: NDArray[np.int32], voxel_size_m: float, marks: NDArray[np.uint8]) -> None:
        """Mark each voxel of blocks (n, 3) that the image sees free, see `mapping.kernels.occupancy`; fills marks
        (n, 512)."""
        occupancy.mark_free(blocks, voxel_size_m, self.reach, self.camera, marks)

    def hits(self, voxel_size_m: float) -> NDArray[np.int32]:
        """The voxels (n, 3) that a surface point lies in; some may be named more than once."""
        voxels = np.empty((self.reach.size, 3), np.int32)
        return voxels[: occupancy.list_hits(self.reach, self.camera, self.pose, voxel_size_m, voxels)]

    def _roots(self, block_size_m: float, back_m: float) -> tuple[NDArray[np.int64], int]:
        """The cells (r, 3) of 2^level blocks along an edge that the frustum's bounding box meets, and that level."""
        roots = np.empty(((ROOTS_ALONG_AXIS + 2) ** 3, 3), np.int64)
        if self.farthest_m == 0.0:
            return roots[:0], 0
        count, level = visibility.list_roots(
            self.camera, self.pose, self.farthest_m + back_m, block_size_m, ROOTS_ALONG_AXIS, roots
        )
        return roots[:count], level
