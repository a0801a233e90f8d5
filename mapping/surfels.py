"""Surfels: a normal distribution of the points in each voxel, and the disc that it is where they lie on a surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.conversions import depth_to_points
from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore, as_points
from mapping.kernels import surfels as kernels
from mapping.layer import BlockLayer, Changed, require, require_whole
from mapping.points import SortedPoints, as_colors, color_of_points
from mapping.view import as_pose

Array: TypeAlias = NDArray[Any]

FLATTEST = 1e-3
"""A distribution is never thought flatter than this share of its largest eigenvalue (Biber & Straßer 2003)."""


@dataclass(frozen=True, eq=False)
class Surfels:
    """Discs on a surface, a row each.

    centres      (N, 3) float64 [m] in map, the mean of the points
    normals      (N, 3) float32, unit, on the side from which the points were seen
    radii        (N,) float32 [m] of the disc that has the same variances within its plane as the points have
    covariances  (N, 3, 3) float64 [m²] of the points (divided by n − 1)
    eigenvalues  (N, 3) float64 [m²] of these, ascending; the first is the variance across the surface
    counts       (N,) int64 points
    colors       (N, 3) uint8, the mean of the points that had one, black where none had; None where none ever had
    """

    centres: NDArray[np.float64]
    normals: NDArray[np.float32]
    radii: NDArray[np.float32]
    covariances: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    counts: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def planarity(self) -> NDArray[np.float64]:
        """(N,) 0 … 1: how much the points look like a plane rather than a line or a ball, (λ₂ − λ₁) / λ₃ with λ₁ ≤ λ₂
        ≤ λ₃; 0 where all points are one."""
        low, middle, high = self.eigenvalues.T
        return np.asarray(np.divide(middle - low, high, out=np.zeros(len(self)), where=high > 0.0))


class SurfelMap(BlockLayer):
    """Mean and covariance of the points of each voxel: the normal distributions transform (Biber & Straßer, IROS 2003;
    Magnusson 2009), which is a surfel where the points lie on a surface.

    voxel_size_m  edge of a voxel [m]
    max_range_m   points farther from the sensor [m] are left out
    min_points    points that a voxel needs to make a surfel, 3 or more
    with_color    keep mean colours from the beginning; otherwise from the first scan that has any

    Moments of scans are merged pairwise (Chan, Golub & LeVeque 1979), so order does not matter but for rounding, and
    maps can be merged. Nothing is forgotten. Blocks of this layer are single voxels. Raises `InvalidParameter` on bad
    values.
    """

    kind: ClassVar[str] = "surfels"

    def __init__(
        self,
        voxel_size_m: float = 0.1,
        max_range_m: float = 100.0,
        *,
        min_points: int = 5,
        with_color: bool = False,
    ) -> None:
        size = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        self.min_points = require_whole("min_points", min_points, 3, 1_000_000)
        self.store = BlockStore({"moments": np.dtype((np.float32, (kernels.MOMENTS,)))}, size, edge=1)
        if with_color:
            self._keep_color()

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "max_range_m": self.max_range_m,
            "min_points": self.min_points,
            "with_color": self.has_color,
        }

    @property
    def has_color(self) -> bool:
        return "color" in self.store.fields

    def _keep_color(self) -> None:
        self.store.add_field("color", np.dtype((np.float32, (4,))))

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(
        self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike, *, color: ArrayLike | None = None
    ) -> Changed:
        """Add one scan: p_sensor (N, 3) [m] in the sensor frame and, if there are any, colours (N, 3) uint8. Returns
        the blocks (voxels) changed: those that hold points of the scan."""
        scan = SortedPoints(p_sensor, T_map_sensor, self.max_range_m, self.voxel_size_m)
        moments, colors = np.empty((len(scan.voxel_ijk), kernels.MOMENTS)), None
        origin = as_pose(T_map_sensor, "T_map_sensor").translation / self.voxel_size_m
        kernels.sum_points(scan.rows, scan.offsets, scan.voxel_ijk, origin, moments)
        if color is not None:
            colors = np.empty((len(scan.voxel_ijk), 4))
            kernels.sum_colors(scan.rows, as_colors(color, len(scan.rows)), colors)
        return self._merge(scan.voxel_ijk, moments, colors)

    def integrate_image(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        color: Array | None = None,
    ) -> Changed:
        """Add the points of one depth image (H, W) float32 [m] or uint16 [mm], 0 = not measured, and its colours
        (H, W, 3) uint8. Returns the blocks changed."""
        paints = None if color is None else color_of_points(depth, color)
        return self.integrate(depth_to_points(depth, intrinsics), T_map_camera, color=paints)

    def merge(self, other: SurfelMap) -> Changed:
        """Add the points of another map of the same frame and voxel size, by their moments. Returns the blocks changed;
        raises `InvalidParameter` where the voxels differ."""
        if other.voxel_size_m != self.voxel_size_m:
            raise InvalidParameter(f"other: expected voxel_size_m = {self.voxel_size_m}, got {other.voxel_size_m}")
        colors = other.store.used("color")[:, 0].astype(np.float64) if other.has_color else None
        return self._merge(other.block_ijk, other.store.used("moments")[:, 0].astype(np.float64), colors)

    def _merge(self, voxel_ijk: Array, moments: NDArray[np.float64], colors: NDArray[np.float64] | None) -> Changed:
        if colors is not None and not self.has_color:
            self._keep_color()
        slots = self.store.allocate(voxel_ijk)
        kernels.merge_moments(self._moments, slots, moments)
        if colors is not None:
            kernels.merge_colors(self.store.fields["color"].reshape(-1, 4), slots, colors)
        return self._note(slots)

    @property
    def _moments(self) -> NDArray[np.float32]:
        """(capacity, 13), see `mapping.kernels.surfels`."""
        return self.store.fields["moments"].reshape(-1, kernels.MOMENTS)

    # -- questions ----------------------------------------------------------------------------------------
    @property
    def surfels(self) -> Surfels:
        """The surfels of all voxels that have enough points."""
        moments = self._moments[: self.store.n_blocks]
        slots = np.flatnonzero(moments[:, 0] >= self.min_points)
        covariances, eigenvalues = np.empty((len(slots), 6)), np.empty((len(slots), 3))
        normals = np.empty((len(slots), 3), np.float32)
        kernels.list_distributions(self._moments, slots, covariances, eigenvalues, normals)
        size, rows = self.voxel_size_m, moments[slots]
        in_plane = eigenvalues[:, 1] + eigenvalues[:, 2]  # a disc of radius r has the variance r² / 4 along each axis
        return Surfels(
            centres=np.asarray((self.block_ijk[slots] + rows[:, 1:4].astype(np.float64)) * size),
            normals=normals,
            radii=(np.sqrt(2.0 * in_plane) * size).astype(np.float32),
            covariances=covariances[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]] * size**2,
            eigenvalues=eigenvalues * size**2,
            counts=rows[:, 0].astype(np.int64),
            colors=np.rint(self.store.used("color")[slots, 0, 1:]).astype(np.uint8) if self.has_color else None,
        )

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The signed distance (N,) [m] from the plane of the surfel in its voxel to each point (N, 3) [m], positive on
        the side from which the surface was seen; NaN where the voxel has no surfel."""
        return self._measure(p_map)[0] * self.voxel_size_m

    def mahalanobis(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The Mahalanobis distance (N,) of each point (N, 3) [m] from the distribution in its voxel, in standard
        deviations; NaN where the voxel has no surfel. Eigenvalues below `FLATTEST` of the largest count as that."""
        return np.sqrt(self._measure(p_map)[1])

    def likelihood(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The score exp(−½ m²) (N,), 0 … 1, of each point (N, 3) [m], m its Mahalanobis distance (Biber & Straßer
        2003); NaN where the voxel has no surfel. Its mean over a scan tells how well the scan fits the map."""
        return np.asarray(np.exp(-0.5 * self._measure(p_map)[1]))

    def _measure(self, p_map: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Signed distance from the plane [voxel edges] and squared Mahalanobis distance (N,) of each point."""
        points = as_points(p_map)
        planes, squared = np.empty(len(points)), np.empty(len(points))
        kernels.measure_points(
            self.store.table, self._moments, 1.0 / self.voxel_size_m, float(self.min_points), FLATTEST, points, planes,
            squared,
        )  # fmt: skip
        return planes, squared
