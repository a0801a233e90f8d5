"""One surface above each cell of the ground: height map, elevation map, extended elevation map."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.kernels import elevation
from mapping.layer import require
from mapping.tiles import Grouped, HeightNoise, TileLayer

Height = Literal["mean", "lowest", "highest"]

LEVEL, VERTICAL, GAP, UNKNOWN = 0, 1, 2, -1
"""Codes that `ExtendedElevationMap.classify` gives."""

MOST_PARTS = 4
"""Parts of a cell that an `ExtendedElevationMap` tells apart."""


class HeightMap(TileLayer):
    """The average of all points that fall into a cell, the lowest and the highest of them: the plainest 2.5-D map.

    voxel_size_m    edge of a cell [m];  max_range_m, above_sensor_m  see `TileLayer`

    Not probabilistic; knows one level, and no difference between free and unknown.
    """

    kind: ClassVar[str] = "height"

    def __init__(self, voxel_size_m: float = 0.1, max_range_m: float = 30.0, *, above_sensor_m: float = np.inf) -> None:
        names = ("count", "mean", "spread", "lowest", "highest")
        super().__init__(
            dict.fromkeys(names, np.float32),
            dict.fromkeys(names[1:], np.nan),
            voxel_size_m,
            max_range_m,
            above_sensor_m,
            HeightNoise(),
        )

    def parameters(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("voxel_size_m", "max_range_m", "above_sensor_m")}

    def query(self, p_map: ArrayLike, which: Height = "mean") -> NDArray[np.float64]:
        """The mean, lowest or highest height (N,) [m] of the cell of each point (N, 3) or (N, 2) [m]; NaN unknown."""
        if which not in get_args(Height):
            raise InvalidParameter(f"which: expected one of {', '.join(get_args(Height))}, got {which!r}")
        return self._cells(which, p_map)

    def variance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The variance (N,) [m²] of the heights that were measured in the cell of each point; NaN where unknown."""
        return self._cells("spread", p_map) / np.maximum(self._cells("count", p_map), 1.0)

    def _fuse(self, scan: Grouped, slots: NDArray[np.int64]) -> NDArray[np.bool_]:
        f = self.store.fields
        elevation.fuse_heights(
            f["count"], f["mean"], f["spread"], f["lowest"], f["highest"], slots, scan.starts, scan.heights
        )
        return np.ones(len(slots), np.bool_)


class ElevationMap(TileLayer):
    """The height of each cell by a Kalman filter, with its variance.

    voxel_size_m    edge of a cell [m];  max_range_m, above_sensor_m  see `TileLayer`
    noise           by keyword: what the variance of a measurement comes from, see `HeightNoise`

    h ← h + K·(z − h), σ² ← (1 − K)·σ², K = σ²/(σ² + σ_z²), where z is the mean of the heights that a scan measured in
    the cell, weighed by their certainty. Within the floor of `least_sigma_m`, scans may come in any order. Knows one
    level and no vertical things: a cell with a wall in it gets a height between its foot and its top.
    """

    kind: ClassVar[str] = "elevation"

    def __init__(
        self,
        voxel_size_m: float = 0.1,
        max_range_m: float = 30.0,
        *,
        above_sensor_m: float = np.inf,
        **noise: float,
    ) -> None:
        super().__init__(
            {"mean": np.float32, "variance": np.float32},
            {"mean": np.nan, "variance": np.nan},
            voxel_size_m,
            max_range_m,
            above_sensor_m,
            HeightNoise(**noise),
        )

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The height (N,) [m] of the cell of each point (N, 3) or (N, 2) [m]; NaN where unknown."""
        return self._cells("mean", p_map)

    def variance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The variance (N,) [m²] of that height; NaN where unknown."""
        return self._cells("variance", p_map)

    def _fuse(self, scan: Grouped, slots: NDArray[np.int64]) -> NDArray[np.bool_]:
        changed = np.empty(len(slots), np.bool_)
        elevation.fuse_elevations(
            self.store.fields["mean"],
            self.store.fields["variance"],
            slots,
            scan.tiles,
            scan.starts,
            scan.heights,
            scan.weights,
            self.voxel_size_m,
            scan.pose,
            scan.quadratic,
            self.noise.least_sigma_m**2,
            changed,
        )
        return changed


class ExtendedElevationMap(TileLayer):
    """An elevation map that knows which cells hold something vertical and which hold a gap that a robot fits through.

    voxel_size_m      edge of a cell [m];  max_range_m, above_sensor_m  see `TileLayer`
    robot_height_m    a gap must be higher than this [m]
    vertical_sigma_m  cells whose heights vary by more than this (standard deviation, m) are no surface
    noise             by keyword, see `HeightNoise`

    (Pfaff, Triebel & Burgard, An Efficient Extension to Elevation Maps for Outdoor Terrain Mapping and Loop Closing,
    IJRR 2007.) Where the heights of all points of a cell vary little, it is LEVEL. Else, where a gap higher than the
    robot parts them, it is a GAP cell, and its height is that of the part below the lowest gap: an underpass. Else it
    is VERTICAL. Two refinements: few points above a gap make it a gap even if they do not make the variance large, and
    where the part below the gap varies too much itself (a hedge under a bridge) the cell is VERTICAL.

    The points of a cell are kept as *parts*, separated by gaps: lowest, highest, mean, weight and spread, each point
    weighed by its certainty. That is exact in any order of scans up to `MOST_PARTS` parts; of more, the two with the
    smallest gap between them become one.
    """

    kind: ClassVar[str] = "extended_elevation"

    def __init__(
        self,
        voxel_size_m: float = 0.1,
        max_range_m: float = 30.0,
        *,
        robot_height_m: float = 1.0,
        vertical_sigma_m: float = 0.1,
        above_sensor_m: float = np.inf,
        **noise: float,
    ) -> None:
        self.robot_height_m = require("robot_height_m", robot_height_m, 0.0, 100.0, "m")
        self.vertical_sigma_m = require("vertical_sigma_m", vertical_sigma_m, 0.0, 100.0, "m")
        super().__init__(
            {"parts": np.dtype((np.float32, (MOST_PARTS, 5)))},
            {"parts": np.nan},
            voxel_size_m,
            max_range_m,
            above_sensor_m,
            HeightNoise(**noise),
        )

    def parameters(self) -> dict[str, Any]:
        return {
            **super().parameters(),
            "robot_height_m": self.robot_height_m,
            "vertical_sigma_m": self.vertical_sigma_m,
        }

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The height (N,) [m], below any gap, of the cell of each point (N, 3) or (N, 2) [m]; NaN where unknown."""
        return self._cells("parts", p_map, 0, elevation.MEAN)

    def variance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The variance (N,) [m²] of that height; NaN where unknown."""
        weight = self._cells("parts", p_map, 0, elevation.WEIGHT)
        return np.maximum(1.0 / weight, self.noise.least_sigma_m**2)

    def extent(self, p_map: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lowest and highest point (N,) [m] below the lowest gap of each point's cell; NaN where unknown."""
        part = self._cells("parts", p_map, 0)
        return part[:, elevation.LOW], part[:, elevation.HIGH]

    def clearance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The height (N,) [m] of the lowest gap in each point's cell: ∞ where nothing was seen above, NaN unknown."""
        parts = self._cells("parts", p_map)
        gap = parts[:, 1, elevation.LOW] - parts[:, 0, elevation.HIGH]
        return np.where(np.isnan(gap) & ~np.isnan(parts[:, 0, elevation.LOW]), np.inf, gap)

    def classify(self, p_map: ArrayLike) -> NDArray[np.int8]:
        """What each point's cell is: LEVEL 0, VERTICAL 1, GAP 2 or UNKNOWN −1, int8 (N,)."""
        parts = self._cells("parts", p_map)
        known = ~np.isnan(parts[:, 0, elevation.LOW])
        sigma = np.sqrt(parts[known, 0, elevation.SPREAD] / parts[known, 0, elevation.WEIGHT])
        gap = ~np.isnan(parts[known, 1, elevation.LOW])
        classes = np.full(len(parts), UNKNOWN, np.int8)
        classes[known] = np.where(sigma > self.vertical_sigma_m, VERTICAL, np.where(gap, GAP, LEVEL))
        return classes

    def _fuse(self, scan: Grouped, slots: NDArray[np.int64]) -> NDArray[np.bool_]:
        changed = np.empty(len(slots), np.bool_)
        elevation.fuse_parts(
            self.store.fields["parts"],
            slots,
            scan.tiles,
            scan.starts,
            scan.heights,
            scan.weights,
            self.voxel_size_m,
            scan.pose,
            scan.quadratic,
            self.robot_height_m,
            changed,
        )
        return changed
