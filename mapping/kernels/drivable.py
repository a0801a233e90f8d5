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
