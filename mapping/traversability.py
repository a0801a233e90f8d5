"""Where can a robot drive? Step, slope, roughness and clearance of the ground, from any of the 2.5-D layers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.elevation import VERTICAL, ElevationMap, ExtendedElevationMap, HeightMap
from mapping.errors import InvalidParameter
from mapping.kernels import traversability as kernels
from mapping.layer import require
from mapping.multilevel import MultiLevelMap
from mapping.observations import RobotDescription
from mapping.occupancy import OccupancyMap
from mapping.tiles import as_columns

__all__ = ["BLOCKED", "TRAVERSABLE", "UNKNOWN", "TerrainLimits", "Traversability", "traversability"]

Array: TypeAlias = NDArray[Any]
HeightLayer: TypeAlias = HeightMap | ElevationMap | ExtendedElevationMap | MultiLevelMap
Surfaces: TypeAlias = tuple[Array, Array, Array, Array]

TRAVERSABLE, BLOCKED, UNKNOWN = 1, 0, -1
"""Codes of `Traversability.classes`."""
CHUNK = 64
"""Cells along a side of the pieces in which occupancy is looked at."""


@dataclass(frozen=True)
class TerrainLimits:
    """What a robot can drive over, and how much must be known before it may.

    max_step_m       difference in height between neighbouring cells, or within one [m]
    max_slope_deg    inclination of the ground under the robot [°]
    max_roughness_m  root mean square distance of the ground from a plane [m]
    height_m         free height that the robot needs above the ground [m]
    radius_m         of the disc of ground that is judged as one plane: the robot's [m]
    known_share      share of the cells of that disc, and of the voxels of an occupancy map above, that must be known

    Raises `InvalidParameter`.
    """

    max_step_m: float = 0.05
    max_slope_deg: float = 20.0
    max_roughness_m: float = 0.03
    height_m: float = 1.0
    radius_m: float = 0.3
    known_share: float = 0.6

    def __post_init__(self) -> None:
        highest = {"max_slope_deg": 89.0, "known_share": 1.0}
        for field in fields(self):
            require(field.name, getattr(self, field.name), 0.0, highest.get(field.name, 100.0))

    @staticmethod
    def of(robot: RobotDescription, **limits: float) -> TerrainLimits:
        """Height and radius of a described robot, the rest by keyword or default."""
        return TerrainLimits(**{"height_m": robot.height_m, "radius_m": robot.radius_m, **limits})


@dataclass(frozen=True, eq=False)
class Traversability:
    """How a robot gets along on each surface of a layer. All arrays are (nx, ny, levels), levels ascending.

    corner_m (2,), cell_size_m   where the first cell begins, edge of a cell [m]
    heights, bottoms    of the surfaces, and down to where they are solid [m]; NaN where there is none
    headroom_m   height of the robot: it passes below surfaces that begin higher above it
    classes      int8: TRAVERSABLE 1, BLOCKED 0, UNKNOWN −1
    cost         0 flat … 1 at a limit or blocked, NaN unknown
    steps_m, slopes_deg, roughness_m, clearance_m   what was measured; NaN where it cannot be told, clearance ∞ where
                 nothing was seen above
    """

    corner_m: NDArray[np.float64]
    cell_size_m: float
    headroom_m: float
    heights: NDArray[np.float64]
    bottoms: NDArray[np.float64]
    classes: NDArray[np.int8]
    cost: NDArray[np.float64]
    steps_m: NDArray[np.float64]
    slopes_deg: NDArray[np.float64]
    roughness_m: NDArray[np.float64]
    clearance_m: NDArray[np.float64]

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The cost (N,) of the surface that a robot at each point (N, 3) [m] would meet; NaN where unknown.

        That is the nearest one of those that do not hang above the robot; for points (N, 2) the lowest of all.
        """
        return self._at(p_map, self.cost, np.nan)

    def classify(self, p_map: ArrayLike) -> NDArray[np.int8]:
        """The class (N,) int8 of that surface: TRAVERSABLE, BLOCKED or UNKNOWN."""
        return self._at(p_map, self.classes, UNKNOWN)

    def level(self, z: float) -> NDArray[np.float64]:
        """The cost (nx, ny) for a robot at height z [m], for pictures."""
        nx, ny, _ = self.cost.shape
        i, j = np.indices((nx, ny)).reshape(2, -1)
        centres = self.corner_m + (np.stack([i, j], axis=1) + 0.5) * self.cell_size_m
        return self.query(np.c_[centres, np.full(len(centres), z)]).reshape(nx, ny)

    def _at(self, p_map: ArrayLike, values: Array, outside: float) -> Array:
        cells = np.floor((as_columns(p_map) - self.corner_m) / self.cell_size_m)
        nx, ny, _ = self.heights.shape
        inside = ((cells >= 0) & (cells < (nx, ny))).all(axis=1)
        found = np.full(len(cells), outside, values.dtype)
        i, j = cells[inside].astype(np.int64).T
        points = np.asarray(p_map, dtype=np.float64)[inside]
        if points.shape[1] == 2 or not points.size:
            found[inside] = values[i, j, 0]
            return found
        top, bottom, z = self.heights[i, j], self.bottoms[i, j], points[:, 2:]
        away = np.maximum(np.maximum(z - top, bottom - z), 0.0)
        away[np.isnan(top) | (bottom > z + self.headroom_m)] = np.inf
        chosen = away.argmin(axis=1)
        met = np.isfinite(away[np.arange(len(away)), chosen])
        found[inside] = np.where(met, values[i, j, chosen], outside)
        return found


def traversability(
    layer: HeightLayer,
    limits: TerrainLimits | None = None,
    *,
    overhead: OccupancyMap | None = None,
    lo: ArrayLike | None = None,
    hi: ArrayLike | None = None,
) -> Traversability:
    """Judge each surface of a height map, elevation map, extended elevation map or multi-level map.

    overhead  an occupancy map that knows what hangs above the ground; a robot fits where enough of it is known and none
              is occupied between `max_step_m` and `height_m` above the surface
    lo, hi    corners (2,) [m] of the region to judge; without them, all of the layer

    A surface is BLOCKED where step, slope, roughness or clearance break a limit for certain; UNKNOWN where none does
    but too little is known about it or above it; else TRAVERSABLE, at the cost of what comes nearest to its limit. The
    plane is fitted to the cells of the disc that the robot could get to without breaking a limit, so that a wall beside
    the robot makes a step, but no slope. Clearance can only be judged by layers that know of gaps, or with `overhead`.
    In an elevation map a step may be spread over two cells, half as high in each: then it is the roughness that tells.
    An extended elevation map only knows gaps higher than its `robot_height_m`: let that be no more than `height_m`.
    """
    if not isinstance(layer, HeightLayer):
        raise InvalidParameter(f"layer: expected a map of heights, got {type(layer).__name__}")
    robot = limits or TerrainLimits()
    centres = layer.centres(lo, hi)
    nx, ny = centres.shape[:2]
    levels = layer.most_patches if isinstance(layer, MultiLevelMap) else 1
    tops, bottoms, relief, clearance = (
        np.ascontiguousarray(a.reshape(nx, ny, levels)) for a in _surfaces(layer, centres.reshape(-1, 2))
    )
    steps, slopes, roughness, known = (np.empty_like(tops) for _ in range(4))
    slope = np.radians(robot.max_slope_deg)
    kernels.measure_ground(
        tops,
        bottoms,
        _disc(robot.radius_m, layer.voxel_size_m),
        layer.voxel_size_m,
        robot.height_m,
        robot.max_step_m,
        np.tan(slope),
        steps,
        slopes,
        roughness,
        known,
    )
    steps = np.maximum(steps, relief)
    corner = centres[0, 0] - 0.5 * layer.voxel_size_m if centres.size else np.zeros(2)
    if overhead is not None:
        known = np.minimum(known, _look_up(overhead, robot, tops, corner, layer.voxel_size_m, clearance))
    with np.errstate(invalid="ignore"):
        share = np.maximum(np.maximum(steps / robot.max_step_m, slopes / slope), roughness / robot.max_roughness_m)
        broken = (steps > robot.max_step_m) | (slopes > slope) | (roughness > robot.max_roughness_m)
        broken |= clearance < robot.height_m
        told = ~np.isnan(slopes) & (known >= robot.known_share)
    classes = np.where(broken, BLOCKED, np.where(told, TRAVERSABLE, UNKNOWN)).astype(np.int8)
    cost = np.where(broken, 1.0, np.where(told, share, np.nan))
    return Traversability(
        corner,
        layer.voxel_size_m,
        robot.height_m,
        tops,
        bottoms,
        classes,
        cost,
        steps,
        np.degrees(slopes),
        roughness,
        clearance,
    )


def _surfaces(layer: HeightLayer, xy: Array) -> Surfaces:
    """Top, bottom, rise within the cell and free height above [m] of the surfaces of cells (N, 2): (N, levels) each."""
    if isinstance(layer, HeightMap):
        lowest, highest = layer.query(xy, "lowest"), layer.query(xy, "highest")
        return layer.query(xy), lowest, highest - lowest, np.full(len(xy), np.nan)
    if isinstance(layer, ElevationMap):
        heights = layer.query(xy)
        solid = np.where(np.isnan(heights), np.nan, -np.inf)  # a high cell is a thing that stands there
        return heights, solid, np.zeros(len(xy)), np.full(len(xy), np.nan)
    if isinstance(layer, ExtendedElevationMap):
        upright = np.where(layer.classify(xy) == VERTICAL, np.inf, 0.0)
        return layer.query(xy), layer.extent(xy)[0], upright, layer.clearance(xy)
    patches = layer.patches(xy)
    tops, bottoms = patches[..., 0], patches[..., 0] - patches[..., 2]
    above = np.concatenate([bottoms[:, 1:], np.full((len(xy), 1), np.nan)], axis=1)
    free = np.where(np.isnan(above), np.inf, above) - tops
    return tops, bottoms, np.zeros_like(tops), free


def _disc(radius_m: float, cell_size_m: float) -> NDArray[np.int64]:
    """Offsets (m, 2) of the cells whose centres lie within `radius_m`; the 8 neighbours at the least."""
    reach = max(1, int(radius_m / cell_size_m))
    offsets = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1).T - reach
    near = (offsets**2).sum(axis=1) <= max((radius_m / cell_size_m) ** 2, 2.0)
    return np.ascontiguousarray(offsets[near], dtype=np.int64)


def _look_up(
    overhead: OccupancyMap, robot: TerrainLimits, tops: Array, corner: Array, cell_size_m: float, clearance: Array
) -> Array:
    """Lower `clearance` to what is occupied above each surface; the share (nx, ny, levels) of it that is known."""
    voxel = overhead.voxel_size_m
    known = np.full_like(tops, np.nan)
    clearance[np.isnan(clearance) & ~np.isnan(tops)] = np.inf
    for i in range(0, tops.shape[0], CHUNK):
        for j in range(0, tops.shape[1], CHUNK):
            piece = np.s_[i : i + CHUNK, j : j + CHUNK]
            some = tops[piece]
            if np.isnan(some).all():
                continue
            begin = corner + np.array([i, j]) * cell_size_m
            low = np.array([*begin, np.nanmin(some)])
            high = np.array([*(begin + np.array(some.shape[:2]) * cell_size_m), np.nanmax(some) + robot.height_m])
            first = np.floor(low / voxel).astype(np.int64)
            nx, ny, nz = (int(n) for n in np.ceil(high / voxel).astype(np.int64) - first + 1)
            lowered, share = np.ascontiguousarray(clearance[piece]), np.empty(some.shape)
            kernels.look_up(
                np.ascontiguousarray(some),
                overhead.evidence_in(first, (nx, ny, nz)),
                first,
                begin,
                cell_size_m,
                voxel,
                robot.max_step_m,
                robot.height_m,
                lowered,
                share,
            )
            clearance[piece], known[piece] = lowered, share
    return known
