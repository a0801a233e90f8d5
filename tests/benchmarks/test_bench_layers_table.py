"""Every layer on the same recording: what an update costs, what the map takes, what a look-up costs.

Run with `make bench`; the tables tell which layer is affordable for which task. All cells are 5 cm wide, depth is
believed up to 5 m and lidar up to 20 m. A look-up asks for a million points close to measured surfaces.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.datasets.opening import open_dataset
from mapping.elevation import ElevationMap, ExtendedElevationMap, HeightMap
from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.kernels.occupancy import UNKNOWN
from mapping.layer import MapLayer
from mapping.multilevel import MultiLevelMap
from mapping.observations import RgbdImage, Scan
from mapping.occupancy import OccupancyMap
from mapping.points import PointMap
from mapping.semantics import SemanticMap
from mapping.surfels import SurfelMap
from mapping.tsdf import TsdfMap
from tests.support.building import CAMERA, CAMERA_RANGE_M, LIDAR, LIDAR_RANGE_M, lidar_scan, lidar_scans, rgbd_images
from tests.support.racing import Table, Times, columns
from tests.support.recordings import recording as path_of

SIZE = 0.05
MILLION = 1_000_000
MOST_IMAGES = 60
NOISE_M = 0.01
IMAGES, SCANS, RANGE_IMAGES = "images", "lidar scans", "range images"
Seen = RgbdImage | Scan
Update = Callable[[Any, Seen], object]


# -- recordings ------------------------------------------------------------------------------------------------


def _building_images() -> list[Seen]:
    return [
        RgbdImage(
            stamp_ns=n,
            robot="robot",
            sensor="camera",
            depth=image.depth_m,
            intrinsics=CAMERA,
            T_map_camera=image.T_map_camera,
            color=image.color,
        )
        for n, image in enumerate(rgbd_images(MOST_IMAGES, noisy=True))
    ]


def _building_scans() -> list[Seen]:
    return [
        Scan(stamp_ns=n, robot="robot", sensor="lidar", points=scan.points, T_map_sensor=scan.T_map_sensor)
        for n, scan in enumerate(lidar_scans(noise_m=NOISE_M))
    ]


def _recorded(name: str) -> list[Seen]:
    found = (o for o in open_dataset(path_of(name)) if isinstance(o, Seen))
    return [o for o in islice(found, MOST_IMAGES) if _pose(o) is not None]


@dataclass(frozen=True)
class Recording:
    """What there is, and of which kinds it is."""

    name: str
    kinds: tuple[str, ...]
    load: Callable[[], list[Seen]]


RECORDINGS = [
    Recording("TUM fr1_rpy", (IMAGES,), lambda: _recorded("tum_fr1_rpy_rgbd")),
    Recording("the simulated building", (IMAGES,), _building_images),
    Recording("3DTK's dat", (SCANS,), lambda: _recorded("3dtk_dat_lidar_odometry")),
    Recording("the simulated building", (SCANS, RANGE_IMAGES), _building_scans),
]


def _pose(seen: Seen) -> SE3 | None:
    return seen.T_map_camera if isinstance(seen, RgbdImage) else seen.T_map_sensor


def points_of(seen: Seen) -> np.ndarray:
    """(N, 3) [m] in the sensor frame."""
    if isinstance(seen, Scan):
        return seen.points
    depth = seen.depth.astype(np.float32) * np.float32(0.001 if seen.depth.dtype == np.uint16 else 1.0)
    return seen.intrinsics.backproject(depth)[depth > 0.0]


def places_near(everything: Sequence[Seen], range_m: float) -> np.ndarray:
    """A million points (N, 3) [m, map] within some centimetres of what was measured, in random order."""
    rng = np.random.default_rng(0)
    surfaces = []
    for seen in everything:
        points = points_of(seen)
        points = points[np.linalg.norm(points, axis=1) < range_m]
        surfaces.append(_pose(seen) @ points[rng.integers(0, len(points), MILLION // len(everything) + 1)])
    chosen = rng.permutation(np.concatenate(surfaces))[:MILLION].astype(np.float64)
    return chosen + rng.normal(0.0, 0.03, chosen.shape)


# -- layers ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contestant:
    """A layer, how it takes in an observation, and how many cells it knows."""

    name: str
    make: Callable[[float], MapLayer]
    update: Update
    known: Callable[[Any], int]
    query: Callable[[Any, np.ndarray], object] = lambda layer, points: layer.query(points)
    kinds: tuple[str, ...] = (IMAGES, SCANS)
    """From what it is made here."""


def by_beams(layer: Any, seen: Seen) -> None:
    layer.integrate(points_of(seen), _pose(seen))


def by_image(layer: Any, seen: Seen) -> None:
    if isinstance(seen, Scan):
        by_beams(layer, seen)
    else:
        layer.integrate_image(seen.depth, seen.intrinsics, seen.T_map_camera)


def by_range_image(layer: Any, seen: Scan) -> None:
    """A scan of the building; its stamp is its number."""
    scan = lidar_scan(seen.stamp_ns, NOISE_M)
    layer.integrate_range_image(scan.ranges, LIDAR, scan.T_map_sensor)


def by_colored_image(layer: Any, seen: RgbdImage) -> None:
    layer.integrate_image(seen.depth, seen.intrinsics, seen.T_map_camera, seen.color)


def by_labels(layer: SemanticMap, seen: Seen) -> None:
    """Labels are made up: eight classes of brightness in images, of height in scans."""
    if isinstance(seen, Scan):
        points = _pose(seen) @ seen.points
        layer.integrate(points, 1 + (points[:, 2] > 1.0))
    else:
        labels = (1 + (seen.color[..., 0] >> 5)).astype(np.uint16)
        layer.integrate_image(_metres(seen), labels, np.ones(labels.shape, np.float32), seen.intrinsics, _pose(seen))


def _metres(seen: RgbdImage) -> np.ndarray:
    return seen.depth * np.float32(0.001) if seen.depth.dtype == np.uint16 else seen.depth


def follow(layer: EsdfMap, seen: Seen) -> None:
    layer.update()


def known_voxels(layer: OccupancyMap) -> int:
    return int((layer.evidence_of(layer.block_ijk) != UNKNOWN).sum())


def finite(field: str) -> Callable[[MapLayer], int]:
    return lambda layer: int(np.isfinite(layer.store.used(field)).sum())


def positive(field: str) -> Callable[[MapLayer], int]:
    return lambda layer: int((layer.store.used(field) > 0).sum())


def known_cells(layer: Any) -> int:
    return int(np.isfinite(layer.grid()[0]).sum())


def source_of(range_m: float) -> EsdfMap:
    return EsdfMap(OccupancyMap(SIZE, range_m), 1.0)


CONTESTANTS = [
    Contestant("OccupancyMap, rays", lambda r: OccupancyMap(SIZE, r), by_beams, known_voxels),
    Contestant("OccupancyMap, projective", lambda r: OccupancyMap(SIZE, r), by_image, known_voxels, kinds=(IMAGES,)),
    Contestant(
        "OccupancyMap, projective", lambda r: OccupancyMap(SIZE, r), by_range_image, known_voxels, kinds=(RANGE_IMAGES,)
    ),
    Contestant("TsdfMap", lambda r: TsdfMap(SIZE, max_range_m=r), by_image, positive("weight")),
    Contestant(
        "TsdfMap, projective",
        lambda r: TsdfMap(SIZE, max_range_m=r),
        by_range_image,
        positive("weight"),
        kinds=(RANGE_IMAGES,),
    ),
    Contestant(
        "TsdfMap with colours",
        lambda r: TsdfMap(SIZE, max_range_m=r),
        by_colored_image,
        positive("weight"),
        kinds=(IMAGES,),
    ),
    Contestant(
        "EsdfMap, 1 m",
        source_of,
        follow,
        finite("distance"),
        lambda layer, points: layer.query(points, gradient=True),
    ),
    Contestant("PointMap", lambda r: PointMap(SIZE, 4, r), by_image, lambda layer: len(layer.points)),
    Contestant("SurfelMap", lambda r: SurfelMap(SIZE, r), by_image, lambda layer: len(layer.block_ijk)),
    Contestant("SemanticMap", lambda r: SemanticMap(voxel_size_m=SIZE), by_labels, lambda layer: layer.store.n_records),
    Contestant("HeightMap", lambda r: HeightMap(SIZE, r), by_image, known_cells),
    Contestant("ElevationMap", lambda r: ElevationMap(SIZE, r), by_image, known_cells),
    Contestant("ExtendedElevationMap", lambda r: ExtendedElevationMap(SIZE, r), by_image, known_cells),
    Contestant("MultiLevelMap", lambda r: MultiLevelMap(SIZE, r), by_image, known_cells),
]


def prepare(layer: MapLayer, seen: Seen) -> None:
    """What happens before an update and is not its work: a distance field's source takes in the observation."""
    if isinstance(layer, EsdfMap):
        (by_beams if isinstance(seen, Scan) else by_image)(layer.source, seen)


def measure(contestant: Contestant, everything: Sequence[Seen], range_m: float, points: np.ndarray) -> list[str]:
    """One line of a table."""
    layer = contestant.make(range_m)
    updates = []
    for seen in everything:
        prepare(layer, seen)
        updates.append(_ms(contestant.update, layer, seen))
    asked = [_ms(contestant.query, layer, points) for _ in range(4)][1:]
    known, megabytes = contestant.known(layer), layer.memory_bytes / 1e6
    each = f"{1e6 * megabytes / max(known, 1):.2g}"
    return [contestant.name, str(Times(updates)), f"{megabytes:.1f}", f"{known}", each, str(Times(asked))]


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda r: f"{r.kinds[0]} of {r.name}")
def test_all_layers_on_one_recording(benchmark: BenchmarkFixture, table: Table, recording: Recording) -> None:
    everything = recording.load()
    range_m = CAMERA_RANGE_M if IMAGES in recording.kinds else LIDAR_RANGE_M
    points = places_near(everything, range_m)
    cells = [["layer", "update ms: median (least)", "memory MB", "cells known", "bytes a cell", "1e6 look-ups ms"]]

    def measure_all() -> None:
        taking_part = [c for c in CONTESTANTS if set(c.kinds) & set(recording.kinds)]
        cells.extend(measure(contestant, everything, range_m, points) for contestant in taking_part)

    benchmark.pedantic(measure_all, rounds=1)
    title = f"all layers, {len(everything)} {' and '.join(recording.kinds)} of {recording.name}:"
    table.notes += ["", title, *columns(cells)]


def _ms(action: Callable[..., object], *arguments: object) -> float:
    started = time.perf_counter()
    action(*arguments)
    return 1e3 * (time.perf_counter() - started)
