"""A lidar range image prepared for fusion: what each beam saw, and which blocks it can say anything about."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.grid import as_points, read_only
from mapping.kernels import range_occupancy, range_visibility
from mapping.sensors import LidarModel
from mapping.view import as_pose

Array: TypeAlias = NDArray[Any]

_ROOTS_ALONG_AXIS = 2
"""About so many cells along the edge of what the image can see are where the search for blocks begins."""


def as_ranges_m(ranges: Array, model: LidarModel) -> NDArray[np.float32]:
    """A range image of `model`, as contiguous float32 [m]."""
    image = np.asarray(ranges)
    if image.shape != model.shape:
        raise InvalidObservation(
            f"ranges: expected the model's shape (rows, columns) = {model.shape}, got {image.shape}"
        )
    if image.dtype != np.float32:
        raise InvalidObservation(f"ranges: expected float32 [m], got {image.dtype}")
    return read_only(np.ascontiguousarray(image))


class RangeView:
    """One lidar range image from one pose, prepared once for any number of layers.

    ranges       (rows, columns) float32 [m]; 0 or NaN = not measured, infinity = nothing there
    max_range_m  surfaces farther than this from the sensor [m] are not believed; free space is, up to it

    A single beam that measured nothing among others that did (at most one of its neighbours may lack too) leaves no
    hole: free space is believed as far as the nearest of its neighbours saw. Larger gaps say nothing.
    """

    def __init__(self, ranges: Array, model: LidarModel, T_map_sensor: SE3 | ArrayLike, max_range_m: float) -> None:
        pose = as_pose(T_map_sensor, "T_map_sensor")
        ranges_m = as_ranges_m(ranges, model)
        inverse = pose.inverse()
        self.model = model
        self.max_range_m = float(max_range_m)
        self.lidar: NDArray[np.float64] = np.array([*inverse.rotation.ravel(), *inverse.translation, *model.seeing])
        """The lidar as kernels take it, with `row_of` and `off_row`, see `mapping.kernels.lidar`."""
        self.row_of: NDArray[np.int32] = model.row_of
        self.off_row: NDArray[np.float32] = model.off_row
        self.pose: NDArray[np.float64] = np.concatenate([pose.rotation.ravel(), pose.translation])
        """(12,) R_map_sensor row by row, then t_map_sensor."""
        self.reach: NDArray[np.float32] = np.empty_like(ranges_m)
        """(rows, columns) float32 see `mapping.kernels.range_visibility`."""
        self.farthest_m = float(range_visibility.measure_reach(ranges_m, self.max_range_m, self.reach))
        """The largest range of which the image says anything [m]."""
        wraps = bool(model.seeing[2] == model.seeing[3])
        range_visibility.bridge_gaps(self.reach, wraps)
        levels = min(range_visibility.WINDOWS, max(model.shape).bit_length(), model.columns.bit_length())
        self._windows = np.empty((levels, *model.shape, 2), np.float32)
        range_visibility.build_windows(self.reach, wraps, self._windows)
        self._points: NDArray[np.float64] | None = None

    @classmethod
    def from_points(
        cls, p_sensor: ArrayLike, model: LidarModel, T_map_sensor: SE3 | ArrayLike, max_range_m: float
    ) -> RangeView:
        """A scan of points (N, 3) [m] in the sensor frame. What is free is seen along the model's beams; what is hit
        is where the points are."""
        pose = as_pose(T_map_sensor, "T_map_sensor")
        points = as_points(np.array(p_sensor, np.float64), "p_sensor")  # a copy: looked at when hits are asked for
        if not np.isfinite(points).all():
            raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
        ranges, _ = model.range_image(points)
        view = cls(ranges, model, pose, max_range_m)
        view._points = points
        return view

    @property
    def clear(self) -> NDArray[np.float32]:
        """(rows, columns) float32 [m] the lowest range that a beam and its neighbours saw."""
        return -self._windows[0, ..., 0]

    def blocks(
        self, block_size_m: float, *, front_m: float, back_m: float, with_free: bool, touch_m: float = 0.0
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """The blocks (n, 3) that the image sees and their kinds (n,): `visibility.MIXED` or, if asked for, `FREE`.

        front_m, back_m : how far before and behind a surface a block still counts as near it [m]
        touch_m         : how far beside a beam it still counts as seen above and below what the rows answer for [m]
        """
        roots, level = self._roots(block_size_m, back_m)
        n = 1 << 14
        while True:
            blocks, kinds = np.empty((n, 3), np.int32), np.empty(n, np.uint8)
            count = range_visibility.list_blocks(
                self._windows, self.lidar, self.model.spans, roots, level, block_size_m, front_m, back_m, touch_m,
                with_free, blocks, kinds,
            )  # fmt: skip
            if count <= n:
                return blocks[:count], kinds[:count]
            n = count

    def mark_free(self, blocks: NDArray[np.int32], voxel_size_m: float, marks: NDArray[np.uint8]) -> None:
        """Mark each voxel of blocks (n, 3) that the image sees free, see `mapping.kernels.range_occupancy`; fills
        marks (n, 512)."""
        range_occupancy.mark_free(
            blocks, voxel_size_m, self._windows, self.lidar, self.model.spans, self.row_of,
            self.off_row, marks,
        )  # fmt: skip

    def hits(self, voxel_size_m: float) -> NDArray[np.int32]:
        """The voxels (n, 3) that a beam ended in; some may be named more than once."""
        if self._points is not None:
            voxels = np.empty((len(self._points), 3), np.int32)
            return voxels[: range_occupancy.list_ends(self._points, self.max_range_m, self.pose, voxel_size_m, voxels)]
        voxels = np.empty((self.reach.size, 3), np.int32)
        return voxels[: range_occupancy.list_hits(self.reach, self.model.directions, self.pose, voxel_size_m, voxels)]

    def _roots(self, block_size_m: float, back_m: float) -> tuple[NDArray[np.int64], int]:
        """The cells (r, 3) of 2^level blocks along an edge that the reach's bounding box meets, and that level."""
        if self.farthest_m == 0.0:
            return np.empty((0, 3), np.int64), 1
        low, high = self.pose[9:] - self.farthest_m - back_m, self.pose[9:] + self.farthest_m + back_m
        level = max(1, int(np.ceil(np.log2((high - low).max() / (_ROOTS_ALONG_AXIS * block_size_m)))))
        edge_m = block_size_m * (1 << level)
        axes = [np.arange(np.floor(a / edge_m), np.floor(b / edge_m) + 1) for a, b in zip(low, high, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int64), level
