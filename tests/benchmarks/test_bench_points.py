"""Lidar scans into points and surfels at 10 cm, and who is near, beside peers. Run with `make bench`.

small_gicp's maps of voxels in C++ take part where it is installed; they drop voxels that were long not seen, ours do
not.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.spatial import cKDTree

from mapping.geometry import SE3
from mapping.points import PointMap
from mapping.surfels import SurfelMap
from tests.support.building import LidarScan, lidar_scans
from tests.support.racing import Table, bytes_per_ms, race

SIZE = 0.1
MUST_MS = 10.0
MAPS = [PointMap, SurfelMap]


def gicp_map(name: str) -> Callable[[LidarScan], None]:
    """A map of small_gicp's, as a function that adds a scan; points and covariances are prepared outside the clock."""
    import small_gicp

    layer = getattr(small_gicp, name)(SIZE)
    prepared: dict[int, Any] = {}
    for scan in lidar_scans(noise_m=0.01):
        cloud = small_gicp.PointCloud(scan.points.astype(np.float64))
        small_gicp.estimate_normals_covariances(cloud)
        prepared[id(scan)] = cloud
    return lambda scan: layer.insert(prepared[id(scan)], scan.T_map_sensor.matrix)


@pytest.mark.parametrize("make", MAPS)
def test_integrate(benchmark: BenchmarkFixture, table: Table, make: type[PointMap | SurfelMap]) -> None:
    import open3d

    scans = lidar_scans(noise_m=0.01)
    layer = make(SIZE)
    for scan in scans:
        layer.integrate(scan.points, scan.T_map_sensor)

    def down_sample(n: int) -> object:
        scan = scans[n % len(scans)]
        places = (scan.T_map_sensor @ scan.points).astype(np.float64)
        return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(places)).voxel_down_sample(SIZE)

    peers = {"Open3D voxel_down_sample (no map)": down_sample}
    if find_spec("small_gicp"):
        name = "IncrementalVoxelMap" if make is PointMap else "GaussianVoxelMap"
        insert = gicp_map(name)
        peers[f"small_gicp {name}"] = lambda n: insert(scans[n % len(scans)])
    ours, theirs = race(
        benchmark,
        lambda n: layer.integrate(scans[n % len(scans)].points, scans[n % len(scans)].T_map_sensor),
        peers,
        rounds=40,
        peer_every=2,
    )
    moved = sum(scan.points.nbytes for scan in scans) / len(scans)
    table.add(f"lidar, 10 cm, {layer.kind}", "–", ours, theirs, must_ms=MUST_MS, bound_ms=moved / bytes_per_ms())
    used = sum(layer.store.used(name).nbytes for name in layer.store.fields)
    table.notes.append(
        f"{layer.kind}, 10 cm: {layer.memory_bytes / 1e6:.1f} MB, {used / layer.store.n_blocks:.0f} B a voxel, "
        f"{used / layer.store.n_blocks * voxels_a_square_metre(make) / 1e3:.1f} kB a m² of noise-free surface"
    )


def voxels_a_square_metre(make: type[PointMap | SurfelMap]) -> float:
    """Voxels that 100 m² of planes in all directions take."""
    rng = np.random.default_rng(0)
    layer = make(SIZE)
    for n in range(100):
        flat = np.column_stack([rng.uniform(0.0, 1.0, (20_000, 2)), np.zeros(20_000)])
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        layer.integrate(flat, SE3(turn * np.linalg.det(turn), [3.0 * n, 0.0, 0.0]))
    return layer.store.n_blocks / 100.0


@pytest.mark.parametrize("make", MAPS)
def test_growth(benchmark: BenchmarkFixture, table: Table, make: type[PointMap | SurfelMap]) -> None:
    scan = lidar_scans(noise_m=0.01)[0]
    small, large = make(SIZE), make(SIZE)
    for n in range(100):
        away = SE3(np.eye(3), [60.0 * (n % 10), 60.0 * (n // 10), 0.0])
        large.integrate(scan.points, away @ scan.T_map_sensor)
    for layer in (small, large):
        layer.integrate(scan.points, scan.T_map_sensor)
    ours, theirs = race(
        benchmark,
        lambda n: large.integrate(scan.points, scan.T_map_sensor),
        {"the map itself": lambda n: small.integrate(scan.points, scan.T_map_sensor)},
        rounds=60,
    )
    table.add(f"growth: {large.kind}, lidar into 100 × the map", "–", ours, theirs, must_share=1.2)


def test_nearest(benchmark: BenchmarkFixture, table: Table) -> None:
    layer = PointMap(SIZE)
    scans = lidar_scans(noise_m=0.01)
    for scan in scans:
        layer.integrate(scan.points, scan.T_map_sensor)
    asked = (scans[0].T_map_sensor @ scans[0].points).astype(np.float64) + np.array([0.02, -0.01, 0.03])
    points = layer.points.astype(np.float64)
    tree = cKDTree(points)
    theirs = {
        "scipy cKDTree, query": lambda n: tree.query(asked, distance_upper_bound=SIZE),
        "scipy cKDTree, build and query": lambda n: cKDTree(points).query(asked, distance_upper_bound=SIZE),
    }
    ours, times = race(benchmark, lambda n: layer.query(asked), theirs, rounds=10, peer_every=3)
    bound = (asked.nbytes + 8 * len(asked)) / bytes_per_ms()
    table.add(f"nearest point of {len(points)}, {len(asked)} times", "–", ours, times, bound_ms=bound)
