"""What all 2.5-D layers share: cells of the ground in flat tiles, and how sure a scan is of a height."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BLOCK_EDGE, BlockStore, as_points, new_table, read_only
from mapping.kernels import tiles as kernels
from mapping.layer import BlockLayer, Changed, require
from mapping.view import as_depth_m, as_pose

Array: TypeAlias = NDArray[Any]

CELLS = BLOCK_EDGE**2
"""Cells of a tile."""
MOST_CELLS = 50_000_000
"""A picture of more cells than this is refused: some stray point made the map wide."""


@dataclass(frozen=True)
class HeightNoise:
    """How uncertain a measured height is.

    range_sigma_m      σ of a range [m] …
    range_sigma_per_m  … and how much of it comes with each metre of range: what is far is known less well
    beam_sigma_rad     σ of a beam's direction [rad]
    pose_sigma_m       σ of the sensor's position along each axis [m], when a scan brings no covariance of its own
    tilt_sigma_rad     σ of its rotation about each axis [rad], likewise
    least_sigma_m      no single height is believed better than this [m], nor is any fused one

    For a point at range r, rising by h over a way d on the ground: σ² = (σ_range·h/r)² + (σ_beam·d)² + σ_least², of its
    own, and J·Σ_pose·Jᵀ in common with its scan: far away the direction counts, close by the range, where beams are
    steep. Raises `InvalidParameter`.
    """

    range_sigma_m: float = 0.02
    range_sigma_per_m: float = 0.001
    beam_sigma_rad: float = 0.001
    pose_sigma_m: float = 0.01
    tilt_sigma_rad: float = 0.001
    least_sigma_m: float = 0.005

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value != 0.0 or field.name == "least_sigma_m" or isinstance(value, bool):
                require(field.name, value, 0.0, 10.0)

    @property
    def of_points(self) -> NDArray[np.float64]:
        """(4,) as `kernels.group_by_cell` takes it."""
        return np.array([self.range_sigma_m, self.range_sigma_per_m, self.beam_sigma_rad, self.least_sigma_m])

    @property
    def of_pose(self) -> NDArray[np.float64]:
        """The covariance (6, 6) of a pose: x, y, z, roll, pitch, yaw in the sensor frame, right perturbation."""
        return np.diag([self.pose_sigma_m**2] * 3 + [self.tilt_sigma_rad**2] * 3)


def height_variance(T_map_sensor: SE3, covariance: Array) -> NDArray[np.float64]:
    """How the covariance (6, 6) of a pose makes heights vary: factors (6,) of 1, x, y, x², xy, y².

    (x, y) is the way over ground [m] from the sensor to the point. With T = T̂ · Exp(ξ) a point p has height
    e_zᵀ·(R·(p + ρ + ω × p) + t), so that J = (a, p × a) with a = Rᵀ·e_z, and p × a = y·Rᵀe_x − x·Rᵀe_y.
    """
    a, for_x, for_y = T_map_sensor.rotation[2], -T_map_sensor.rotation[1], T_map_sensor.rotation[0]
    moved, mixed, turned = covariance[:3, :3], covariance[:3, 3:] + covariance[3:, :3].T, covariance[3:, 3:]
    return np.array(
        [
            a @ moved @ a,
            a @ mixed @ for_x,
            a @ mixed @ for_y,
            for_x @ turned @ for_x,
            for_x @ (turned + turned.T) @ for_y,
            for_y @ turned @ for_y,
        ]
    )


class Grouped(NamedTuple):
    """The heights of a scan, sorted by cell; see `mapping.kernels.tiles`."""

    tiles: NDArray[np.int32]
    starts: NDArray[np.int32]
    heights: NDArray[np.float64]
    weights: NDArray[np.float64]
    pose: NDArray[np.float64]
    quadratic: NDArray[np.float64]


class TileLayer(BlockLayer):
    """A layer on the ground: 8 × 8 cells a block, found by index (i, j, 0); `voxel_size_m` is the edge of a cell.

    In a `Changed` of such a layer only x and y mean something: a tile stands for all that is above it.

    max_range_m     points farther from the sensor than this are left out [m]
    above_sensor_m  points that lie more than this above the sensor are left out [m]: what a robot drives under
    noise           by keyword, see `HeightNoise`
    """

    def __init__(
        self,
        cell_fields: Mapping[str, DTypeLike],
        fill: Mapping[str, float],
        voxel_size_m: float,
        max_range_m: float,
        above_sensor_m: float,
        noise: HeightNoise,
    ) -> None:
        require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        self.above_sensor_m = require("above_sensor_m", above_sensor_m, -10_000.0, np.inf, "m")
        self.noise = noise
        self.store = BlockStore(cell_fields, voxel_size_m, fill=fill, edge=BLOCK_EDGE, axes=2)
        self._room = 256

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "max_range_m": self.max_range_m,
            "above_sensor_m": self.above_sensor_m,
            **asdict(self.noise),
        }

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(
        self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike, covariance: ArrayLike | None = None
    ) -> Changed:
        """Fuse one scan: points (N, 3) [m] in the sensor frame. Returns the tiles changed.

        covariance : (6, 6) of the pose, order x, y, z, roll, pitch, yaw, right perturbation in the sensor frame;
                     without one, that of the layer's `noise`
        Raises `InvalidObservation` on points or covariances that are not finite.
        """
        return self._integrate(as_points(p_sensor, "p_sensor"), as_pose(T_map_sensor, "T_map_sensor"), covariance)

    def integrate_image(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        covariance: ArrayLike | None = None,
    ) -> Changed:
        """Fuse one depth image (H, W) float32 [m] or uint16 [mm], 0 = not measured; see `integrate`."""
        model = intrinsics if isinstance(intrinsics, CameraIntrinsics) else CameraIntrinsics.model_validate(intrinsics)
        pose = as_pose(T_map_camera, "T_map_camera")
        depth_m = as_depth_m(depth)
        if depth_m.shape != (model.height, model.width):
            raise InvalidObservation(
                f"depth has shape {depth_m.shape}, but intrinsics say (height, width) = {(model.height, model.width)}"
            )
        points = np.empty((depth_m.size, 3))
        n = kernels.points_of_image(depth_m, model.fx, model.fy, model.cx, model.cy, points)
        return self._integrate(read_only(points[:n]), pose, covariance)

    def _integrate(self, points: NDArray[np.float64], pose: SE3, covariance: ArrayLike | None) -> Changed:
        grouped = self._group(points, pose, self._covariance(covariance))
        slots = self.store.allocate(grouped.tiles)
        return self._note(slots[self._fuse(grouped, slots)])

    def _covariance(self, covariance: ArrayLike | None) -> NDArray[np.float64]:
        if covariance is None:
            return self.noise.of_pose
        matrix = np.asarray(covariance, dtype=np.float64)
        if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or np.linalg.eigvalsh(matrix).min() < -1e-9:
            raise InvalidObservation(
                f"covariance: expected a covariance (6, 6) of finite numbers, got {matrix.tolist()}"
            )
        return matrix

    def _group(self, points: NDArray[np.float64], pose: SE3, covariance: NDArray[np.float64]) -> Grouped:
        n = len(points)
        row = np.concatenate([pose.rotation.ravel(), pose.translation])
        limits = np.array([1.0 / self.voxel_size_m, self.max_range_m, self.above_sensor_m])
        keys, scratch = np.empty(n, np.int32), np.empty((n, 2))
        heights, weights = np.empty(n), np.empty(n)
        while True:
            tiles = np.empty((self._room, 3), np.int32)
            starts = np.empty(CELLS * self._room + 1, np.int32)
            table = new_table(tiles, 0, self._room)
            n_tiles = kernels.group_by_cell(
                points, row, self.noise.of_points, limits, table, tiles, keys, scratch, starts, heights, weights
            )
            if n_tiles == kernels.OUT_OF_RANGE:
                raise InvalidObservation("p_sensor: expected finite points within the map's bounds, got others")
            if n_tiles >= 0:
                quadratic = height_variance(pose, covariance)
                return Grouped(tiles[:n_tiles], starts, heights, weights, row, quadratic)
            self._room *= 2

    @abstractmethod
    def _fuse(self, scan: Grouped, slots: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Fold a scan into the tiles in `slots` (n,), one for each of `scan.tiles`; which of them it changed (n,)."""

    # -- questions ----------------------------------------------------------------------------------------
    def locate(self, p_map: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Slot (N,) (−1: no tile) and index within the tile (N,) of the cell below each point (N, 3) or (N, 2) [m]."""
        xy = as_columns(p_map)
        slots, local = np.empty(len(xy), np.int64), np.empty(len(xy), np.int64)
        kernels.locate_cells(self.store.table, xy, 1.0 / self.voxel_size_m, slots, local)
        return slots, local

    def _cells(self, name: str, p_map: ArrayLike, *of_cell: int) -> NDArray[np.float64]:
        """The field `name` of the cell of each point, or an element of it, (N, …) float64; NaN where there is none."""
        slots, local = self.locate(p_map)
        field = self.store.fields[name]
        if not self.store.n_blocks:
            return np.full((len(slots), *field.shape[2 + len(of_cell) :]), np.nan)
        values: NDArray[np.float64] = field[(slots, local, *of_cell)].astype(np.float64)
        values[slots < 0] = np.nan
        return values

    # -- pictures -----------------------------------------------------------------------------------------
    def centres(self, lo: ArrayLike | None = None, hi: ArrayLike | None = None) -> NDArray[np.float64]:
        """The centres (nx, ny, 2) [m] of the cells from corner `lo` to `hi` (2,) [m]; of all tiles without these.

        Raises `InvalidParameter` on impossible corners and more than `MOST_CELLS` cells.
        """
        size = self.voxel_size_m
        if lo is None or hi is None:
            tiles = self.block_ijk[:, :2] if self.store.n_blocks else np.zeros((0, 2), np.int32)
            first = tiles.min(axis=0) * BLOCK_EDGE if len(tiles) else np.zeros(2, np.int64)
            beyond = (tiles.max(axis=0) + 1) * BLOCK_EDGE if len(tiles) else np.zeros(2, np.int64)
        else:
            low, high = np.asarray(lo, np.float64)[:2], np.asarray(hi, np.float64)[:2]
            if low.shape != (2,) or high.shape != (2,) or not (low < high).all():
                raise InvalidParameter(
                    f"lo, hi: expected corners (2,) with lo < hi, got {low.tolist()} and {high.tolist()}"
                )
            first = np.floor(low / size + 1e-6).astype(np.int64)
            beyond = np.maximum(np.ceil(high / size - 1e-6).astype(np.int64), first + 1)
        nx, ny = (int(n) for n in beyond - first)
        if nx * ny > MOST_CELLS:
            raise InvalidParameter(f"lo, hi: expected a region of at most {MOST_CELLS} cells, got {nx} × {ny}")
        axes = [(np.arange(a, b) + 0.5) * size for a, b in zip(first, beyond, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def box(self, lo: ArrayLike, hi: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The heights (nx, ny) [m] of the cells that meet the box from corner `lo` to `hi` (2,) [m], NaN where unknown.

        Also the corner (2,) [m] at which the first cell begins.
        """
        return self._dense(self.centres(lo, hi))

    def grid(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The heights (nx, ny) [m] of the box about all tiles, NaN where unknown, and its corner (2,) [m]."""
        return self._dense(self.centres())

    def _dense(self, centres: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        corner = centres[0, 0] - 0.5 * self.voxel_size_m if centres.size else np.zeros(2)
        return np.asarray(self.query(centres.reshape(-1, 2))).reshape(centres.shape[:2]), corner


def as_columns(p_map: ArrayLike) -> NDArray[np.float64]:
    """The (x, y) (N, 2) of points (N, 3) or (N, 2) [m]; raises `InvalidParameter` on another shape."""
    array = np.asarray(p_map, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise InvalidParameter(f"p_map: expected points (N, 3) or (N, 2), got an array of shape {array.shape}")
    return read_only(np.ascontiguousarray(array[:, :2]))
