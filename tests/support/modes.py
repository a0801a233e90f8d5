"""The configurations of occupancy maps that are verified against OctoMap and timed beside it: the same for both.

`rays` casts every beam and says what OctoMap says; `projective` tests blocks and voxels against the whole image.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from mapping.occupancy import OccupancyMap
from tests.support.building import CAMERA, CAMERA_RANGE_M, LIDAR, LIDAR_RANGE_M, DepthImage, LidarScan

HIT, MISS, LOWEST, HIGHEST = 0.7, 0.4, 0.1192, 0.971
"""Probabilities of OctoMap's sensor model and its clamps; both libraries' defaults."""


@dataclass(frozen=True)
class Configuration:
    """How occupancy is mapped. discretize: of all beams that end in one voxel, one counts, through its centre."""

    voxel_size_m: float
    max_range_m: float
    discretize: bool = False

    def __str__(self) -> str:
        return f"{100 * self.voxel_size_m:.0f} cm {'discretised' if self.discretize else 'all beams'}"

    def ours(self) -> OccupancyMap:
        """An empty map."""
        return OccupancyMap(
            self.voxel_size_m, self.max_range_m, hit=HIT, miss=MISS, lowest=LOWEST, highest=HIGHEST,
            discretize=self.discretize,
        )  # fmt: skip

    def theirs(self) -> Any:
        """An empty octree; the test is skipped where there is no pyoctomap."""
        tree = pytest.importorskip("pyoctomap").OcTree(self.voxel_size_m)
        tree.setProbHit(HIT)
        tree.setProbMiss(MISS)
        tree.setClampingThresMin(LOWEST)
        tree.setClampingThresMax(HIGHEST)
        return tree

    def cast(self, layer: OccupancyMap, beams: Beams) -> None:
        """Mode `rays`."""
        layer.integrate(beams.points, beams.T_map_sensor)

    def insert(self, tree: Any, beams: Beams, *, lazy: bool = True) -> None:
        """The same with OctoMap. The points are brought into the map beforehand, which costs us and not the peer."""
        tree.insertPointCloud(
            beams.points_map, beams.origin, max_range=self.max_range_m, lazy_eval=lazy, discretize=self.discretize
        )


LIDAR_10CM = Configuration(0.10, LIDAR_RANGE_M)
LIDAR_5CM = Configuration(0.05, LIDAR_RANGE_M)
RGBD_5CM = Configuration(0.05, CAMERA_RANGE_M)
LIDAR_10CM_DISCRETISED, LIDAR_5CM_DISCRETISED, RGBD_5CM_DISCRETISED = (
    replace(c, discretize=True) for c in (LIDAR_10CM, LIDAR_5CM, RGBD_5CM)
)


class Beams:
    """The end points of one scan (N, 3) float32 [m, sensor frame] and from where."""

    def __init__(self, points: np.ndarray, T_map_sensor: Any) -> None:
        self.points, self.T_map_sensor = points, T_map_sensor
        self.points_map: np.ndarray = T_map_sensor @ points.astype(np.float64)
        self.origin = np.array(T_map_sensor.translation)


def beams_of(seen: Iterable[LidarScan | DepthImage]) -> list[Beams]:
    """The beams of lidar scans or depth images."""
    return [Beams(s.points, s.T_map_sensor if isinstance(s, LidarScan) else s.T_map_camera) for s in seen]


def project(layer: OccupancyMap, image: DepthImage) -> None:
    """Mode `projective`, for images."""
    layer.integrate_image(image.depth, CAMERA, image.T_map_camera)


def project_sweep(layer: OccupancyMap, scan: LidarScan) -> None:
    """Mode `projective`, for the range images of a lidar."""
    layer.integrate_range_image(scan.ranges, LIDAR, scan.T_map_sensor)
