"""What a camera would see of a signed distance map: the model's image from any pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.geometry import SE3, CameraIntrinsics
from mapping.kernels import raycast
from mapping.layer import require
from mapping.view import as_camera, as_pose, camera_arrays

if TYPE_CHECKING:
    from mapping.tsdf import TsdfMap


@dataclass(frozen=True, eq=False)
class VirtualView:
    """An image of the map.

    depth    (H, W) float32 z [m], 0 = nothing is seen
    normals  (H, W, 3) float32, unit, in map, into free space; 0 where nothing is seen
    colors   (H, W, 3) uint8 red, green, blue, or None; 0 where nothing is seen
    """

    depth: NDArray[np.float32]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8] | None = None


def render(
    tsdf: TsdfMap,
    intrinsics: CameraIntrinsics | Mapping[str, float],
    T_map_camera: SE3 | ArrayLike,
    *,
    max_range_m: float | None = None,
) -> VirtualView:
    """The image that a camera at `T_map_camera` would take of the surfaces of `tsdf` (KinectFusion's model frame).

    max_range_m : surfaces farther from the camera than this [m, along the ray] are not seen; default the map's

    Each surface is seen from its free side only, and what is unknown is looked through. Raises `InvalidParameter`.
    """
    model, pose = as_camera(intrinsics), as_pose(T_map_camera, "T_map_camera")
    if max_range_m is None:
        max_range_m = tsdf.max_range_m
    farthest = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
    camera, pose_row = camera_arrays(model, pose)
    store = tsdf.store
    distance, weight = store.fields["distance"], store.fields["weight"]
    bounds = np.empty((-(-model.height // raycast.TILE), -(-model.width // raycast.TILE), 2), np.float32)
    boxes = tsdf.surface_boxes()
    raycast.bound_tiles(store.block_ijk, boxes, store.voxel_size_m, camera, farthest, bounds)
    depth = np.zeros((model.height, model.width), np.float32)
    normals = np.zeros((model.height, model.width, 3), np.float32)
    raycast.cast_view(
        store.table, distance, weight, store.voxel_size_m, tsdf.max_jump_m, camera, pose_row, farthest, bounds,
        depth, normals,
    )  # fmt: skip
    if not tsdf.has_color:
        return VirtualView(depth, normals)
    colors = np.zeros((model.height, model.width, 3), np.uint8)
    seen = depth > 0.0
    colors[seen] = tsdf.colors_at(pose @ model.backproject(depth)[seen].astype(np.float64))
    return VirtualView(depth, normals, colors)
