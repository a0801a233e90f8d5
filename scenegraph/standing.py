"""Where on the ground a robot can stand, and how far it is to get there."""

from __future__ import annotations

from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mapping.kernels import regions as kernels
from mapping.occupancy import OccupancyMap
from scenegraph.perception.access import passable_ground

Array: TypeAlias = NDArray[Any]


class Standing:
    """Cells of the ground on which the disc of a robot fits, and to which it gets from where it is.

    cells       (N, 2) int64, over the window
    xy          (N, 2) their middles in map [m]
    clearance_m (N,) distance to the nearest ground that is not known to be free
    """

    def __init__(self, free: Array, origin: Array, cell_m: float, radius_m: float, start: Array | None) -> None:
        self._origin, self._cell_m = origin, cell_m
        room = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * cell_m
        fits = room > radius_m - 0.5 * cell_m  # the middle of a robot need not be the middle of a cell
        self._start = None if start is None else np.floor(start / cell_m).astype(np.int64) - origin
        if self._start is not None:  # where it stands it fits, whatever the map says
            beside = np.hypot(*(np.indices(free.shape) - self._start[:, None, None])) * cell_m
            fits |= (beside == 0.0) | (free & (beside <= radius_m))
        self._blocked = ~fits
        reached = self._reached(fits)
        self.cells = np.argwhere(reached & (room > radius_m))
        self.xy = (self.cells + origin + 0.5) * cell_m
        self.clearance_m = room[tuple(self.cells.T)]

    @classmethod
    def between(
        cls,
        occupancy: OccupancyMap,
        low: Array,
        high: Array,
        *,
        floor_z: float,
        height_m: float,
        radius_m: float,
        start: Array | None,
    ) -> Self:
        """On the ground from corner `low` to `high` (2,), for a robot of that height and radius at `start` (2,)."""
        free, _, origin, cell_m = passable_ground(occupancy, low, high, floor_z, height_m)
        return cls(free, origin, cell_m, radius_m, start)

    def _reached(self, fits: Array) -> Array:
        """The cells that connect to the robot's, or to each other most widely where its place is not known."""
        parts, n = ndimage.label(fits, structure=np.ones((3, 3)))
        if n == 0:
            return fits
        if self._start is not None:
            return np.asarray(parts == parts[tuple(self._start)])
        sizes = np.bincount(parts.ravel())
        sizes[0] = 0
        return np.asarray(parts == sizes.argmax())

    def way_m(self, index: int) -> float | None:
        """Length of the shortest way to the cell of that index [m]; None where the robot's place is not known."""
        if self._start is None:
            return None
        way = kernels.shortest_way(self._blocked, *self._start.tolist(), *self.cells[index].tolist(), 1e9)
        return round(float(kernels.taut_length(self._blocked, way)) * self._cell_m, 2)
