"""May a body be there? Spheres, and a robot's footprint swept along a path, against what a distance field knows.

There are three answers: a body *collides* when it touches an occupied voxel; else it is *unknown* whether it is free
when it touches a voxel of which nothing is known; else it is *free*. Voxels are cubes; a body that only shares a face
with one does not touch it, so that a robot may stand on the floor. The decision is exact down to a voxel, without
interpolation: it is that of looking at every voxel in the occupancy map. (Distance fields for this purpose: Oleynikova
et al., Voxblox, IROS 2017; bodies as spheres: Ratliff et al., CHOMP, ICRA 2009; three answers as in Hornung et al.,
OctoMap, Autonomous Robots 2013, whose unknown space is no free space either.)
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.esdf import EsdfMap
from mapping.grid import as_points, ijk_to_centre, read_only
from mapping.kernels import collision
from mapping.layer import require

Array: TypeAlias = NDArray[Any]


class Verdict(IntEnum):
    """What is known of a body in a place."""

    FREE = collision.FREE
    COLLIDES = collision.COLLIDES
    UNKNOWN = collision.UNKNOWN


@dataclass(frozen=True, eq=False)
class SweepReport:
    """What a footprint meets along a path.

    poses        (M, 4) float64 x, y, z [m] and yaw [rad]: all that were checked, in order, those given among them
    leg          (M,) int64: poses[m] lies after the path's pose leg[m] and before the next, or is it
    verdicts     (M,) int8 `Verdict` of each
    clearance_m  (M,) float64 [m]: the body is at least this far from all that is occupied, as far as the field reaches;
                 0 where it collides, NaN where it touches what is unknown
    where        (M, 3) float64 [m]: centre of the voxel that decided: the one it collides with, an unknown one, or of
                 those that it touches the one nearest to what is occupied
    """

    poses: NDArray[np.float64]
    leg: NDArray[np.int64]
    verdicts: NDArray[np.int8]
    clearance_m: NDArray[np.float64]
    where: NDArray[np.float64]

    @property
    def verdict(self) -> Verdict:
        """Of the whole path: free only where all of it is."""
        if (self.verdicts == Verdict.COLLIDES).any():
            return Verdict.COLLIDES
        return Verdict.UNKNOWN if (self.verdicts == Verdict.UNKNOWN).any() else Verdict.FREE

    @property
    def first_blocked(self) -> int | None:
        """Row of the first pose that is not known to be free; None where all are."""
        blocked = np.flatnonzero(self.verdicts != Verdict.FREE)
        return int(blocked[0]) if len(blocked) else None


def spheres_are_free(field: EsdfMap, centres: ArrayLike, radius_m: ArrayLike) -> NDArray[np.int8]:
    """The `Verdict` (N,) int8 of spheres about centres (N, 3) [m] with radius_m, one or (N,) [m]."""
    points = as_points(centres, "centres")
    radii = np.asarray(radius_m, np.float64)
    if radii.ndim > 1 or (radii.ndim == 1 and len(radii) != len(points)) or not (radii > 0.0).all():
        raise InvalidParameter(f"radius_m: expected lengths > 0 m, one or {len(points)}, got {radius_m!r}")
    field.update()
    verdicts = np.empty(len(points), np.int8)
    collision.check_spheres(
        field.store.table, field.store.fields["distance"], field.voxel_size_m, field.exact_below_m, points,
        read_only(np.ascontiguousarray(np.broadcast_to(radii, len(points)))), verdicts,
    )  # fmt: skip
    return verdicts


def sweep(
    field: EsdfMap,
    footprint: ArrayLike,
    height_m: float,
    poses: ArrayLike,
    step_m: float | None = None,
    *,
    margin_m: float = 0.0,
) -> SweepReport:
    """Sweep a robot's body, its footprint from the floor up to its height, along a path.

    footprint  (K, 2) [m]: corners of a simple polygon in the robot's frame, convex or not, in either sense
    height_m   of the body above the pose [m]
    poses      (N, 4) x, y, z [m] and yaw [rad], or (N, 3) x, y, yaw with z = 0; the way between is straight, with the
               shorter turn
    step_m     no point of the body moves farther than this from one pose to the next [m]; default one voxel
    margin_m   how much the footprint is widened to all sides [m]. What lies between the poses that are checked is
               covered, too, where this is at least half a step.

    Raises `InvalidParameter` on bad values.
    """
    outline = _outline(footprint, margin_m)
    require("height_m", height_m, 0.0, 1000.0, "m")
    step = require("step_m", field.voxel_size_m if step_m is None else step_m, 0.0, 1000.0, "m")
    way = np.asarray(poses, np.float64)
    if way.ndim != 2 or way.shape[1] not in (3, 4) or not len(way) or not np.isfinite(way).all():
        raise InvalidParameter(f"poses: expected finite numbers (N ≥ 1, 4) or (N ≥ 1, 3), got shape {way.shape}")
    if way.shape[1] == 3:
        way = np.column_stack([way[:, :2], np.zeros(len(way)), way[:, 2]])
    longest = float(np.linalg.norm(shapely.get_coordinates(outline), axis=1).max())
    checked, leg = _densify(way, step, longest)
    field.update()
    parts = _convex_parts(outline)
    n = len(checked)
    verdicts, least, where = np.empty(n, np.int8), np.empty(n), np.empty((n, 3), np.int64)
    collision.check_prisms(
        field.store.table, field.store.fields["distance"], field.voxel_size_m, np.concatenate(parts),
        np.cumsum([0, *map(len, parts)]), float(height_m), checked, verdicts, least, where,
    )  # fmt: skip
    # The points of two voxels that are nearest to each other are each within half a diagonal of the voxel's centre.
    clearance = np.maximum(least - (np.sqrt(3.0) - 0.5) * field.voxel_size_m, 0.0)
    clearance[verdicts == Verdict.UNKNOWN] = np.nan
    return SweepReport(checked, leg, verdicts, clearance, ijk_to_centre(where, field.voxel_size_m))


def _outline(footprint: ArrayLike, margin_m: float) -> shapely.Polygon:
    corners = np.asarray(footprint, np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3 or not np.isfinite(corners).all():
        raise InvalidParameter(f"footprint: expected finite corners (K ≥ 3, 2), got shape {corners.shape}")
    outline = shapely.Polygon(corners)
    if not outline.is_valid or outline.area <= 0.0:
        raise InvalidParameter(f"footprint: expected a simple polygon, got {shapely.is_valid_reason(outline)}")
    if not 0.0 <= margin_m <= 1000.0:
        raise InvalidParameter(f"margin_m: expected a number in [0, 1000] m, got {margin_m!r}")
    return outline.buffer(margin_m, join_style="mitre") if margin_m else outline


def _convex_parts(outline: shapely.Polygon) -> list[NDArray[np.float64]]:
    """The corners (k, 2) of convex polygons that make up the outline."""
    if outline.convex_hull.area <= outline.area * (1.0 + 1e-12):
        pieces = [outline.convex_hull]
    else:
        pieces = list(shapely.constrained_delaunay_triangles(outline).geoms)
    return [shapely.get_coordinates(piece)[:-1] for piece in pieces]


def _densify(way: Array, step_m: float, longest_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Poses between those of `way` (N, 4) such that no point within `longest_m` of the origin moves farther than a step
    from one to the next; and which of the given poses each follows."""
    moves = np.diff(way, axis=0)
    moves[:, 3] = (moves[:, 3] + np.pi) % (2.0 * np.pi) - np.pi
    lengths = np.linalg.norm(moves[:, :3], axis=1) + longest_m * np.abs(moves[:, 3])
    counts = np.append(np.maximum(np.ceil(lengths / step_m), 1.0).astype(np.int64), 1)
    leg = np.repeat(np.arange(len(way)), counts)
    share = (np.arange(len(leg)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[leg]
    return way[leg] + share[:, None] * np.vstack([moves, np.zeros(4)])[leg], leg
