"""Labels of points by the gradient along vertical sweeps."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

FLOOR, OBJECT, CEILING, UNKNOWN = 0, 1, 2, -1


@njit(cache=True)
def measure_sweeps(
    points: Array, rotation: Array, step: Float, flat: Array, height: Array, keys: Array, measured: Array
) -> None:
    """Vertical cylindrical coordinates of points (n, 3) [m] in the sensor frame, in place.

    rotation     : (3, 3) of the sensor, whose z axis need not be vertical;  step : width of a sweep [rad]
    flat, height : (n,) distance over ground and height about the sensor [m]
    keys         : (n,) float64 that sort the points by sweep, then by elevation: the whole part names the sweep
    measured     : (n,) bool, whether the point is finite and not the origin
    """
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        v = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        height[n] = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        flat[n] = np.sqrt(u * u + v * v)
        measured[n] = np.isfinite(flat[n] + height[n]) and not (x == 0.0 and y == 0.0 and z == 0.0)
        share = 0.5 + np.arctan2(height[n], flat[n]) / np.pi  # of the way from straight down to straight up
        keys[n] = np.floor(np.arctan2(v, u) / step) + 0.999 * share


@njit(cache=True)
def neighbour(flat: Array, height: Array, j: Int, beyond: Int, step: Int, k: Int, baseline: Float) -> Int:
    """The point of a sweep that lies k or more points from j in direction `step` (±1) and `baseline` [m] or more away.

    Looked for before `beyond`; `beyond` when there is none.
    """
    i = j + step * k
    while (beyond - i) * step > 0:
        if (flat[i] - flat[j]) ** 2 + (height[i] - height[j]) ** 2 >= baseline * baseline:
            return i
        i += step
    return beyond


@njit(cache=True)
def label_sweeps(
    order: Array, starts: Array, flat: Array, height: Array, k: Int, baseline: Float, tau: Float, labels: Array
) -> None:
    """Label each point of each sweep by the gradient from its k-th neighbour below, in place.

    order  : (m,) the points from bottom to top, sweep after sweep;  starts (s + 1,) where each sweep begins in `order`
    flat, height : (m,) distance over ground and height [m] of the points, in that order
    tau    : [rad];  labels (n,) int8, set for the points in `order`
    The first points of a sweep take the gradient to the neighbour above; a point without neighbours is UNKNOWN.
    """
    for s in range(starts.shape[0] - 1):
        start, end = starts[s], starts[s + 1]
        for j in range(start, end):
            a, b = neighbour(flat, height, j, start - 1, -1, k, baseline), j
            if a < start:
                a, b = j, neighbour(flat, height, j, end, 1, k, baseline)
            if b == end:
                labels[order[j]] = UNKNOWN
                continue
            angle = np.arctan2(height[b] - height[a], flat[b] - flat[a])
            if angle < -0.5 * np.pi:
                angle += 2.0 * np.pi
            if angle < tau:
                labels[order[j]] = FLOOR
            elif angle <= np.pi - tau:
                labels[order[j]] = OBJECT
            else:
                labels[order[j]] = CEILING
