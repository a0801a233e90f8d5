"""The lidar model: range image ⇄ points. (The camera model is in `mapping.geometry`.)"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import as_points, read_only
from mapping.kernels import lidar

__all__ = ["LidarModel"]

STEPS_PER_ROW = 32
"""Kernels know the sine of an elevation to this share of the narrowest row, or of their largest table."""
_MOST_STEPS = 1 << 17
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
        angles = np.concatenate([self.elevations, self.azimuths])
        self.directions: NDArray[np.float64] = read_only(np.stack([np.sin(angles), np.cos(angles)], axis=1))
        """(rows + columns, 2) sine and cosine of each row's elevation, then of each column's azimuth."""
        self._see()

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

    def __repr__(self) -> str:
        rows, columns = self.shape
        highest, lowest = np.degrees(self.elevations[[0, -1]])
        return f"LidarModel({rows} × {columns}, {highest:.4g}° … {lowest:.4g}°, span {np.degrees(self.span):.4g}°)"

    def _see(self) -> None:
        """Prepare what kernels take, see `mapping.kernels.lidar`: its tables, and the last six numbers of a lidar."""
        e = self.elevations
        rows = len(e)
        gaps = -np.diff(e)
        half = 0.5 * gaps if rows > 1 else np.array([0.5 * self.span / self.columns])
        above = np.minimum(np.concatenate([half[:1], half])[:rows], 0.5 * self.widest_gap)
        below = np.minimum(np.concatenate([half, half[-1:]])[-rows:], 0.5 * self.widest_gap)
        low = np.sin(np.maximum(e - below, -0.5 * np.pi))
        high = np.sin(np.minimum(e + above, 0.5 * np.pi))
        high[1:] = np.where(gaps <= self.widest_gap, low[:-1], high[1:])  # neighbours meet, to the last digit
        per_sine = min(STEPS_PER_ROW / (high - low).min(), 0.5 * _MOST_STEPS)
        steps = int(np.ceil(2.0 * per_sine)) + 1
        upper = 1.0 - (np.arange(steps) - 0.01) / per_sine  # a little above, for the rounding of who looks up
        middle = (upper - 0.51 / per_sine).clip(-1.0, 1.0)
        row = np.searchsorted(-low, -middle, side="left")
        answered = (row < rows) & (middle <= np.append(high, -2.0)[row])
        nearest = np.searchsorted(-np.sin(0.5 * (e[1:] + e[:-1])), -middle, side="left")
        row_of = nearest * self.columns + np.where(answered, 0, lidar.BESIDE)
        off = np.arcsin(middle) - e[nearest]
        first_row = np.minimum.accumulate(np.where(answered, row, rows)[::-1])[::-1]
        last_row = np.maximum.accumulate(np.where(answered, row, -1))
        before = np.cumsum(answered) - answered
        per_radian = self.columns / self.span
        turn = _WHOLE_TURN * per_radian
        if abs(turn - self.columns) < 1e-6:
            turn = float(self.columns)
        offset = (self.first_azimuth * per_radian) % turn
        self.rings: NDArray[np.float64] = read_only(np.stack([np.append(low, -2.0), np.append(high, -2.0)], axis=1))
        self.row_at: NDArray[np.int32] = read_only(np.searchsorted(-low, -upper, side="left").astype(np.int32))
        self.row_of: NDArray[np.int32] = read_only(row_of.astype(np.int32))
        self.off_row: NDArray[np.float32] = read_only(off.astype(np.float32))
        self.spans: NDArray[np.int32] = read_only(np.stack([first_row, last_row, before], axis=1).astype(np.int32))
        self.seeing: NDArray[np.float64] = read_only(
            np.array([offset, per_radian, self.columns, turn, per_sine, steps])
        )

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
        lidar.find_beams(points, self.seeing, self.rings, self.row_at, pixels, distance)
        return pixels, distance
