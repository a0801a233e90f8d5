"""Which points of a scan can be driven on? The gradient along vertical sweeps tells, whatever the height.

(Nüchter & Hertzberg, Towards semantic maps for mobile robots, RAS 2008, §3.2, after Wulf, Arras, Christensen & Wagner,
2D mapping of cluttered indoor environments by means of 3D perception, ICRA 2004.) In a vertical cylindrical coordinate
system about the sensor, the points at one azimuth are swept from bottom to top. With y the distance over ground, the
gradient between point j and its k-th neighbour before it is α = arctan((z_j − z_{j−k}) / (y_j − y_{j−k})) in
[−π/2, 3π/2): below τ the point is floor, above π − τ ceiling, between them an object such as a wall.

Neighbours, not heights, decide, so that a small error of the robot's roll and pitch does not matter. Both sides of a
sharp edge may be floor; that there is a step between them is for `mapping.traversability` to tell, from heights.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.grid import as_points, read_only
from mapping.kernels import drivable
from mapping.layer import require
from mapping.view import as_pose

__all__ = ["CEILING", "FLOOR", "OBJECT", "UNKNOWN", "label_points", "label_range_image"]

Array: TypeAlias = NDArray[Any]

FLOOR, OBJECT, CEILING, UNKNOWN = drivable.FLOOR, drivable.OBJECT, drivable.CEILING, drivable.UNKNOWN
"""Labels of points: 0, 1, 2 and −1."""


def label_points(
    p_sensor: ArrayLike,
    T_map_sensor: SE3 | ArrayLike | None = None,
    *,
    tau_deg: float = 20.0,
    k: int = 1,
    baseline_m: float = 0.1,
    azimuth_step_deg: float = 0.5,
) -> NDArray[np.int8]:
    """Label the points (N, 3) [m] of an unorganised scan FLOOR, OBJECT, CEILING or UNKNOWN, int8 (N,).

    T_map_sensor      only its rotation is used, to know what is vertical; without it the sensor's z axis is
    tau_deg           floor is less steep than this [°]
    k                 which neighbour in sweep order the gradient is taken from, at least
    baseline_m        … and at least so far away [m]: nearer ones say more of noise than of slope; 0 as in the paper
    azimuth_step_deg  width of a sweep [°]; in it, points are ordered by elevation. As wide as beams lie apart is
                      best: where a wall is seen at a grazing angle, one sweep spans a long piece of it, and they mix

    UNKNOWN is a point that is alone in its sweep. Raises `InvalidParameter`, `InvalidObservation`.
    """
    step = np.radians(require("azimuth_step_deg", azimuth_step_deg, 0.0, 90.0, "°"))
    flat, height, keys, _ = _cylindrical(as_points(p_sensor, "p_sensor"), T_map_sensor, step)
    if not (np.isfinite(flat) & np.isfinite(height)).all():
        raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
    order = np.argsort(keys, kind="stable")
    sweep = np.floor(keys[order])
    starts = np.flatnonzero(np.diff(sweep, prepend=-np.inf, append=np.inf))
    return _label(order, starts, flat, height, tau_deg, k, baseline_m)


def label_range_image(
    points: ArrayLike,
    T_map_sensor: SE3 | ArrayLike | None = None,
    *,
    tau_deg: float = 20.0,
    k: int = 1,
    baseline_m: float = 0.1,
) -> NDArray[np.int8]:
    """Label the points (rows, columns, 3) [m] of an organised scan, int8 (rows, columns), each column being a sweep.

    Row 0 looks highest, as `LidarModel` has it; the origin or NaN stands for nothing measured, and is UNKNOWN. The rest
    as in `label_points`.
    """
    image = np.asarray(points, dtype=np.float64)
    if image.ndim != 3 or image.shape[2] != 3:
        raise InvalidParameter(f"points: expected (rows, columns, 3), got an array of shape {image.shape}")
    rows, columns = image.shape[:2]
    flat, height, _, measured = _cylindrical(as_points(image.reshape(-1, 3)), T_map_sensor, 1.0)
    upwards = np.arange(rows * columns).reshape(rows, columns)[::-1].T.ravel()
    order = upwards[measured[upwards]]
    starts = np.concatenate([[0], np.cumsum(measured.reshape(rows, columns).sum(axis=0))])
    return _label(order, starts, flat, height, tau_deg, k, baseline_m).reshape(rows, columns)


def _cylindrical(points: Array, T_map_sensor: SE3 | ArrayLike | None, step: float) -> tuple[Array, ...]:
    """See `kernels.drivable.measure_sweeps`; the map's idea of what is up."""
    rotation = np.eye(3) if T_map_sensor is None else as_pose(T_map_sensor, "T_map_sensor").rotation
    flat, height, keys = (np.empty(len(points)) for _ in range(3))
    measured = np.empty(len(points), np.bool_)
    drivable.measure_sweeps(points, np.array(rotation), step, flat, height, keys, measured)
    return flat, height, keys, measured


def _label(
    order: Array, starts: Array, flat: Array, height: Array, tau_deg: float, k: int, baseline_m: float
) -> NDArray[np.int8]:
    tau = np.radians(require("tau_deg", tau_deg, 0.0, 89.0, "°"))
    if k < 1 or k != int(k):
        raise InvalidParameter(f"k: expected a whole number ≥ 1, got {k!r}")
    if baseline_m != 0.0:
        require("baseline_m", baseline_m, 0.0, 100.0, "m")
    labels = np.full(len(flat), UNKNOWN, np.int8)
    rows = np.ascontiguousarray(order, np.int64)
    drivable.label_sweeps(
        rows,
        np.ascontiguousarray(starts, np.int64),
        read_only(flat[rows]),
        read_only(height[rows]),
        int(k),
        float(baseline_m),
        tau,
        labels,
    )
    return labels
