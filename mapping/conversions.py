"""From one kind of measurement or map to another: depth ⇄ points ⇄ range image, colour registered to depth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import as_points, read_only
from mapping.kernels import images
from mapping.layer import require
from mapping.range_view import as_ranges_m
from mapping.sensors import LidarModel
from mapping.view import as_depth_m, as_pose

Array: TypeAlias = NDArray[Any]
Camera: TypeAlias = CameraIntrinsics | Mapping[str, float]


# -- images ⇄ points -------------------------------------------------------------------------------------------


def depth_to_points(depth: Array, intrinsics: Camera) -> NDArray[np.float32]:
    """The points (N, 3) float32 [m, optical frame] that a depth image (H, W) measured, row by row.

    depth : float32 [m] or uint16 [mm]; 0, NaN and infinity = not measured
    """
    depth_m, camera = _checked_depth(depth, intrinsics)
    points = np.empty((depth_m.size + 1, 3), np.float32)  # one more, for what is written before it is known to count
    return points[: images.lift_depth(depth_m, _camera_row(camera), points)].copy()


def measured_pixels(depth: Array) -> NDArray[np.bool_]:
    """Which pixels (H, W) of a depth image measured something: those that `depth_to_points` gives a point for."""
    depth_m = as_depth_m(depth)
    return np.asarray((depth_m > 0.0) & np.isfinite(depth_m))


def points_to_depth(p_camera: ArrayLike, intrinsics: Camera) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Points (N, 3) [m, optical frame] → depth image (H, W) float32 [m], and which point each pixel shows.

    A point falls on the pixel nearest to it; of several the nearest counts; where there is none the depth is 0 and the
    index −1.
    """
    camera = _as_camera(intrinsics)
    shape = (camera.height, camera.width)
    depth, index = np.empty(shape, np.float32), np.empty(shape, np.int64)
    images.drop_points(as_points(p_camera, "p_camera"), _camera_row(camera), depth, index)
    return depth, index


def range_image_to_points(ranges: Array, model: LidarModel) -> NDArray[np.float32]:
    """The points (N, 3) float32 [m, sensor frame] that a range image (rows, columns) float32 [m] measured, row by row.

    0, NaN and infinity = not measured.
    """
    ranges_m = as_ranges_m(ranges, model)
    measured = (ranges_m > 0.0) & np.isfinite(ranges_m)
    return np.asarray(model.rays()[measured] * ranges_m[measured][:, None])


def points_to_range_image(p_sensor: ArrayLike, model: LidarModel) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Points (N, 3) [m, sensor frame] → range image (rows, columns) float32 [m], and which point each beam met; see
    `LidarModel.range_image`."""
    return model.range_image(p_sensor)


# -- colour of one camera for the depth of another -------------------------------------------------------------


def register_color(
    color: Array,
    color_intrinsics: Camera,
    T_depth_color: SE3 | ArrayLike,
    depth: Array,
    intrinsics: Camera,
    *,
    tolerance: float = 0.02,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The colour that each pixel of a depth image has in the image of another camera.

    color      (h, w, 3) uint8 of the colour camera, which stands at `T_depth_color` in the depth camera's frame
    depth      (H, W) float32 [m] or uint16 [mm]; 0, NaN and infinity = not measured
    tolerance  share of the distance by which a surface may lie behind another one and still be the same

    Returns the colours (H, W, 3) uint8, interpolated between pixels, and which of them are valid (H, W) bool: measured,
    inside the colour image, and not hidden from the colour camera by something else that the depth image shows. The
    hidden are found by drawing the depth image into the colour camera (a z-buffer, Catmull 1974).
    Raises `InvalidObservation` where an image does not fit its camera.
    """
    depth_m, camera = _checked_depth(depth, intrinsics)
    other = _as_camera(color_intrinsics)
    pixels = np.asarray(color)
    if pixels.dtype != np.uint8 or pixels.shape != (other.height, other.width, 3):
        raise InvalidObservation(
            f"color: expected uint8 {(other.height, other.width, 3)} as color_intrinsics say, "
            f"got {pixels.dtype} {pixels.shape}"
        )
    pose = as_pose(T_depth_color, "T_depth_color").inverse()
    pose_row = np.concatenate([pose.rotation.ravel(), pose.translation])
    seen = np.empty((*depth_m.shape, 3), np.float32)
    images.look_from(depth_m, _camera_row(camera), pose_row, _camera_row(other), seen)
    nearest = np.full((other.height, other.width), np.inf, np.float32)
    images.cover(depth_m, seen, other.fx / camera.fx, other.fy / camera.fy, nearest)
    registered, valid = np.empty((*depth_m.shape, 3), np.uint8), np.empty(depth_m.shape, np.bool_)
    share = require("tolerance", tolerance, 0.0, 1.0)
    images.pick_colors(seen, nearest, share, read_only(np.ascontiguousarray(pixels)), registered, valid)
    return registered, valid


def _as_camera(intrinsics: Camera) -> CameraIntrinsics:
    return intrinsics if isinstance(intrinsics, CameraIntrinsics) else CameraIntrinsics.model_validate(intrinsics)


def _camera_row(camera: CameraIntrinsics) -> NDArray[np.float64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])


def _checked_depth(depth: Array, intrinsics: Camera) -> tuple[NDArray[np.float32], CameraIntrinsics]:
    camera = _as_camera(intrinsics)
    depth_m = as_depth_m(depth)
    if depth_m.shape != (camera.height, camera.width):
        raise InvalidObservation(
            f"depth has shape {depth_m.shape}, but intrinsics say (height, width) = {(camera.height, camera.width)}"
        )
    return depth_m, camera
