"""What rays through an occupancy map meet first."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import as_points, read_only
from mapping.kernels import sight
from mapping.layer import require

if TYPE_CHECKING:
    from mapping.occupancy import OccupancyMap


class Hits(NamedTuple):
    """What each of N rays met.

    met          (N,) int8: 1 an occupied voxel; 0 only free space; −1 no occupied voxel, but unknown ones
    distance_m   (N,) the way to where the ray enters the occupied voxel, or to where it ended [m]
    points       (N, 3) that place [m, map]
    unknown_at_m (N,) the way to the first unknown voxel [m], infinite where there was none
    """

    met: NDArray[np.int8]
    distance_m: NDArray[np.float64]
    points: NDArray[np.float64]
    unknown_at_m: NDArray[np.float64]


def first_hits(
    occupancy: OccupancyMap, origins: ArrayLike, directions: ArrayLike, max_range_m: float, *, stop_at_unknown: bool
) -> Hits:
    """Follow rays from `origins` (N, 3) or (3,) [m] along `directions` (N, 3) or (3,), of any length."""
    reach = require("max_range_m", max_range_m, 0.0, 1e6, "m")
    starts, along = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
    starts, along = as_points(starts, "origins"), as_points(along, "directions")
    lengths = np.linalg.norm(along, axis=1)
    if not (np.isfinite(starts).all() and np.isfinite(lengths).all() and (lengths > 0.0).all()):
        raise InvalidParameter("origins, directions: expected finite points, and directions that are not 0")
    unit = along / lengths[:, None]
    n, size = len(starts), occupancy.voxel_size_m
    distance, unknown_at, met = np.empty(n), np.empty(n), np.empty(n, np.int8)
    sight.first_hits(
        *occupancy.store.tree, occupancy.store.rows[2], read_only(starts / size), read_only(unit), reach / size,
        stop_at_unknown, distance, unknown_at, met,
    )  # fmt: skip
    return Hits(met, distance * size, starts + unit * (distance * size)[:, None], unknown_at * size)
