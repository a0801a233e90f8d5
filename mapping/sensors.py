"""The lidar model: range image ⇄ points. (The camera model is in `mapping.geometry`.)"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import as_points, read_only
from mapping.kernels import lidar

__all__ = ["LidarModel"]

_MOST_BINS = 1 << 16
_WHOLE_TURN = 2.0 * np.pi


class LidarModel:
    """A range sensor that turns: a ring of beams for each elevation, fired in even steps of azimuth.

    elevations      (rows,) of the rings [rad], strictly decreasing: row 0 looks highest, as in an image; uneven steps
                    are fine, a single row is a planar scanner
    columns         beams of a ring
    first_azimuth   of column 0 [rad], about z, from x towards y; azimuths fall with the column, from left to right
    span            what the columns cover together [rad], each its equal share; a full turn by default
    widest_gap      a ring answers for the elevations up to the middle between it and the next, but for no more than
                    half of this angle [rad] to either side: what lies between rings that are farther apart is not seen

    The sensor frame has x forward, y left, z up (REP-103). Raises `InvalidParameter`.
    """

    def __init__(
        self,
        elevations: ArrayLike,
        columns: int,
        *,
        first_azimuth: float = np.pi,
        span: float = _WHOLE_TURN,
        widest_gap: float = np.pi,
    ) -> None:
        self.elevations: NDArray[Any] = np.array(elevations, dtype=np.float64)
        if self.elevations.ndim != 1 or len(self.elevations) == 0 or not (np.abs(self.elevations) < np.pi / 2).all():
            raise InvalidParameter(f"elevations: expected angles (rows,) within ±π/2, got {elevations!r}")
        if (np.diff(self.elevations) >= 0.0).any():
            raise InvalidParameter("elevations: expected strictly decreasing angles, the highest first")
        if columns < 1:
            raise InvalidParameter(f"columns: expected at least 1, got {columns}")
        if not np.isfinite(first_azimuth):
            raise InvalidParameter(f"first_azimuth: expected an angle, got {first_azimuth}")
        for name, angle, most in (("span", span, _WHOLE_TURN), ("widest_gap", widest_gap, np.pi)):
            if not 0.0 < angle <= most + 1e-9:
                raise InvalidParameter(f"{name}: expected an angle in (0, {most:.4g}] rad, got {angle!r}")
        self.columns = int(columns)
        self.first_azimuth = float(first_azimuth)
        self.span = float(span)
        self.widest_gap = float(widest_gap)
        self.elevations.setflags(write=False)
        self.rings, self.row_at, self.seeing = self._tables()

    @staticmethod
    def even(
        rows: int,
        lowest: float,
        highest: float,
        columns: int,
        *,
        first_azimuth: float = np.pi,
        span: float = _WHOLE_TURN,
    ) -> LidarModel:
        """Rings in even steps between two elevations [rad]."""
        if rows < 1 or not lowest <= highest:
            raise InvalidParameter(
                f"rows, lowest, highest: expected ≥ 1 row and lowest ≤ highest, got {rows}, {lowest}, {highest}"
            )
        return LidarModel(np.linspace(highest, lowest, rows), columns, first_azimuth=first_azimuth, span=span)

    def _tables(self) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
        """What kernels take: rings, row_at and the last six numbers of a lidar, see `mapping.kernels.lidar`."""
        e = self.elevations
        rows = len(e)
        steps = -np.diff(e)
        half = 0.5 * steps if rows > 1 else np.array([0.5 * self.span / self.columns])
        above = np.minimum(np.concatenate([half[:1], half])[:rows], 0.5 * self.widest_gap)
        below = np.minimum(np.concatenate([half, half[-1:]])[-rows:], 0.5 * self.widest_gap)
        low = np.sin(np.maximum(e - below, -0.5 * np.pi))
        high = np.sin(np.minimum(e + above, 0.5 * np.pi))
        high[1:] = np.where(steps < self.widest_gap, low[:-1], high[1:])  # neighbours meet, to the last digit
        gaps = np.concatenate([[0.0], np.cumsum(high[1:] < low[:-1])])
        rings = np.empty((rows + 1, 5))
        rings[:rows] = np.stack([low, high, np.sin(e), np.cos(e), gaps], axis=1)
        rings[rows] = (-2.0, -2.0, 0.0, 1.0, gaps[-1])
        # So many bins that at most one row ends within each.
        narrowest = np.abs(np.diff(low)).min() if rows > 1 else 2.0
        bins = int(np.ceil((high[0] - low[-1]) / (0.9 * narrowest))) + 1
        if bins > _MOST_BINS:
            raise InvalidParameter(f"elevations: expected rings farther apart, got {steps.min():.3g} rad")
        per_sine = 1.0 / (0.9 * narrowest)
        starts = high[0] - (np.arange(bins) - 0.01) / per_sine  # a little above, for the rounding of who looks up
        row_at = np.searchsorted(-low, -starts, side="left").clip(0, rows).astype(np.int32)
        per_radian = self.columns / self.span
        turn = _WHOLE_TURN * per_radian
        if abs(turn - self.columns) < 1e-6:
            turn = float(self.columns)
        seeing = np.array([(self.first_azimuth * per_radian) % turn, per_radian, self.columns, turn, high[0], per_sine])
        return read_only(rings), read_only(row_at), read_only(seeing)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the range image."""
        return len(self.elevations), self.columns

    @property
    def azimuths(self) -> NDArray[np.float64]:
        """(columns,) of each column [rad]."""
        return np.asarray(self.first_azimuth - np.arange(self.columns) * (self.span / self.columns))

    def rays(self) -> NDArray[np.float32]:
        """(rows, columns, 3) float32 unit vectors in the sensor frame, one a beam."""
        azimuth = self.azimuths
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
        pixels, distance = self._find_beams(p_sensor)
        rows, columns = np.divmod(pixels, self.columns)
        return np.where(pixels < 0, -1, rows), columns, distance

    def range_image(self, p_sensor: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Points (N, 3) [m] → range image (rows, columns) float32 [m], and which point each beam met.

        Of several points on a beam the nearest counts; where there is none the range is 0 and the index −1.
        """
        pixels, distance = self._find_beams(p_sensor)
        ranges, index = np.empty(self.shape, np.float32), np.empty(self.shape, np.int64)
        lidar.keep_nearest(pixels, distance, ranges.reshape(-1), index.reshape(-1))
        return ranges, index

    def _find_beams(self, p_sensor: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        points = as_points(p_sensor, "p_sensor")
        pixels, distance = np.empty(len(points), np.int64), np.empty(len(points))
        seeing = np.concatenate([np.zeros(12), self.seeing])
        lidar.find_beams(points, seeing, self.rings, self.row_at, pixels, distance)
        return pixels, distance
