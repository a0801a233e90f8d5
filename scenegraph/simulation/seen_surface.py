"""The part of a home's surfaces that images showed: what is behind a mirror is a wall, but nobody saw it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from scenegraph.simulation.shapes import Array

CELL_M = 0.0125
"""One seen point is kept of each cell of this size."""
_TOGETHER = 32  # images whose points are put together at once


class SeenSurface:
    """Points on true surfaces, as exact rays met them, with the triangle that each lies on."""

    def __init__(self) -> None:
        self._keys: list[Array] = []
        self._points: list[Array] = []
        self._triangles: list[Array] = []

    def add(self, p_map: Array, triangles: Array) -> None:
        """Take in points (N, 3) [m] on triangles (N,)."""
        ijk = np.floor(p_map / CELL_M).astype(np.int64) + (1 << 20)
        self._keys.append(ijk[:, 0] << 42 | ijk[:, 1] << 21 | ijk[:, 2])
        self._points.append(p_map.astype(np.float32))
        self._triangles.append(triangles.astype(np.int32))
        if len(self._keys) > _TOGETHER:
            self._put_together()

    def closest(self, p_map: ArrayLike, radius_m: float) -> tuple[Array, Array]:
        """The triangle (N,) of the seen point that is nearest to each point (N, 3) [m], and its distance (N,) [m]; −1
        and ∞ where none was seen within `radius_m`."""
        self._put_together()
        points, triangles = self._points[0], self._triangles[0]
        distance, nearest = cKDTree(points).query(np.asarray(p_map), distance_upper_bound=radius_m, workers=-1)
        return np.append(triangles, -1)[nearest], distance

    def _put_together(self) -> None:
        keys = np.concatenate([np.empty(0, np.int64), *self._keys])
        _, first = np.unique(keys, return_index=True)
        self._points = [np.concatenate([np.empty((0, 3), np.float32), *self._points])[first]]
        self._triangles = [np.concatenate([np.empty(0, np.int32), *self._triangles])[first]]
        self._keys = [keys[first]]
