"""The lidar model: range image ⇄ points. (The camera model is in `mapping.geometry`.)"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter

__all__ = ["LidarModel"]


class LidarModel:
    """A rotating range sensor: a ring of beams for each elevation, fired in even steps of azimuth.

    elevations      (rows,) of the rings [rad], strictly decreasing: row 0 looks highest, as in an image
    columns         beams of a ring in one turn
    first_azimuth   of column 0 [rad], about z, from x towards y; azimuths fall with the column, from left to right

    The sensor frame has x forward, y left, z up (REP-103). Raises `InvalidParameter`.
    """

    def __init__(self, elevations: ArrayLike, columns: int, *, first_azimuth: float = np.pi) -> None:
        self.elevations: NDArray[Any] = np.array(elevations, dtype=np.float64)
        if self.elevations.ndim != 1 or len(self.elevations) == 0 or not (np.abs(self.elevations) < np.pi / 2).all():
            raise InvalidParameter(f"elevations: expected angles (rows,) within ±π/2, got {elevations!r}")
        if (np.diff(self.elevations) >= 0.0).any():
            raise InvalidParameter("elevations: expected strictly decreasing angles, the highest first")
        if columns < 1:
            raise InvalidParameter(f"columns: expected at least 1, got {columns}")
        if not np.isfinite(first_azimuth):
            raise InvalidParameter(f"first_azimuth: expected an angle, got {first_azimuth}")
        self.columns = int(columns)
        self.first_azimuth = float(first_azimuth)
        self.elevations.setflags(write=False)
        middles = 0.5 * (self.elevations[1:] + self.elevations[:-1])
        half = 0.5 * np.abs(np.diff(self.elevations)[[0, -1]]) if len(middles) else np.full(2, np.pi / self.columns)
        #: where one row ends and the next begins, from below, so that searchsorted finds the row
        self._bounds = np.array([self.elevations[-1] - half[1], *middles[::-1], self.elevations[0] + half[0]])

    @staticmethod
    def even(rows: int, lowest: float, highest: float, columns: int, *, first_azimuth: float = np.pi) -> LidarModel:
        """Rings in even steps between two elevations [rad]."""
        if rows < 1 or not lowest <= highest:
            raise InvalidParameter(
                f"rows, lowest, highest: expected ≥ 1 row and lowest ≤ highest, got {rows}, {lowest}, {highest}"
            )
        return LidarModel(np.linspace(highest, lowest, rows), columns, first_azimuth=first_azimuth)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the range image."""
        return len(self.elevations), self.columns

    def rays(self) -> NDArray[np.float32]:
        """(rows, columns, 3) float32 unit vectors in the sensor frame, one a beam."""
        azimuth = self.first_azimuth - np.arange(self.columns) * (2.0 * np.pi / self.columns)
        flat = np.cos(self.elevations)[:, None]
        x, y, z = np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(self.elevations)[:, None])
        return np.asarray(np.stack([x, y, z], axis=-1), dtype=np.float32)

    def backproject(self, ranges: ArrayLike) -> NDArray[np.float32]:
        """A range image (rows, columns) [m] → points (rows, columns, 3) [m]; range 0 gives the origin."""
        ranges = np.asarray(ranges, dtype=np.float32)
        if ranges.shape != self.shape:
            raise InvalidParameter(f"ranges: expected shape {self.shape}, got {ranges.shape}")
        return np.asarray(self.rays() * ranges[..., None])

    def project(self, p_sensor: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Points (N, 3) [m] → row, column and range [m] (N,) of the nearest beams; row −1 where none looks there."""
        p = np.asarray(p_sensor, dtype=np.float64)
        distance = np.linalg.norm(p, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            elevation = np.arcsin(np.clip(p[:, 2] / distance, -1.0, 1.0))
        turn = (self.first_azimuth - np.arctan2(p[:, 1], p[:, 0])) * (self.columns / (2.0 * np.pi))
        columns = np.rint(turn).astype(np.int64) % self.columns
        rows = len(self.elevations) - np.searchsorted(self._bounds, elevation, side="left")
        outside = (rows < 0) | (rows >= len(self.elevations)) | ~(distance > 0.0)
        return np.where(outside, -1, rows), columns, distance

    def range_image(self, p_sensor: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Points (N, 3) [m] → range image (rows, columns) float32 [m], and which point each beam met.

        Of several points on a beam the nearest counts; where there is none the range is 0 and the index −1.
        """
        rows, columns, distance = self.project(p_sensor)
        ranges = np.zeros(self.shape, dtype=np.float32)
        index = np.full(self.shape, -1, dtype=np.int64)
        seen = np.flatnonzero(rows >= 0)
        far_to_near = seen[np.argsort(-distance[seen], kind="stable")]  # what is written last stays: the nearest
        ranges[rows[far_to_near], columns[far_to_near]] = distance[far_to_near]
        index[rows[far_to_near], columns[far_to_near]] = far_to_near
        return ranges, index
