"""A million random look-ups, beside peers. Run with `make bench`.

The points lie anywhere in the blocks that the map has, in random order, so that the cache helps little.
"""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.esdf import EsdfMap
from mapping.layer import MapLayer
from mapping.occupancy import OccupancyMap
from tests.benchmarks.test_bench_occupancy import Peer
from tests.benchmarks.test_bench_tsdf import OPEN3D, fuse, new_map
from tests.support import modes
from tests.support.building import lidar_scans, rgbd_images
from tests.support.modes import beams_of
from tests.support.open3d_grid import Grid
from tests.support.racing import Table, bytes_per_ms, race

MILLION = 1_000_000


def points_in(layer: MapLayer) -> np.ndarray:
    """A million points (N, 3) [m] in blocks of the map."""
    rng = np.random.default_rng(0)
    blocks = layer.block_ijk[rng.integers(0, len(layer.block_ijk), MILLION)]
    return (blocks + rng.random((MILLION, 3))) * layer.block_size_m


@pytest.fixture(scope="module")
def building() -> OccupancyMap:
    layer = modes.LIDAR_5CM.ours()
    for beams in beams_of(lidar_scans(noise_m=0.01)):
        modes.LIDAR_5CM.cast(layer, beams)
    return layer


def test_occupancy(benchmark: BenchmarkFixture, table: Table, building: OccupancyMap) -> None:
    points = points_in(building)
    tree = Peer(modes.LIDAR_5CM_DISCRETISED, beams_of(lidar_scans(noise_m=0.01)), lazy=True).tree
    theirs = {"pyoctomap getLabels": lambda n: tree.getLabels(points)}
    ours, times = race(benchmark, lambda n: building.classify(points), theirs, rounds=10, peer_every=3)
    bound = points.nbytes / bytes_per_ms()
    table.add("1e6 look-ups, occupancy classes", "–", ours, times, must_ms=50.0, bound_ms=bound)


def test_occupancy_probability(benchmark: BenchmarkFixture, table: Table, building: OccupancyMap) -> None:
    points = points_in(building)
    ours, _ = race(benchmark, lambda n: building.query(points), {}, rounds=10)
    bound = (points.nbytes + 8 * MILLION) / bytes_per_ms()
    table.add("1e6 look-ups, occupancy probability", "–", ours, {}, must_ms=50.0, bound_ms=bound)


def test_tsdf(benchmark: BenchmarkFixture, table: Table) -> None:
    layer, grid = new_map(0.05), Grid(0.05)
    for image in rgbd_images():
        fuse(layer, image)
        grid.fuse(image)
    points = points_in(layer)
    distances = grid.grid.attribute("tsdf").reshape((-1, 1))
    hashed = grid.grid.hashmap()

    def nearest(n: int) -> np.ndarray:
        """The nearest voxel's distance: Open3D interpolates only while it casts rays."""
        voxels = np.rint(points / 0.05).astype(np.int32)
        rows, found = hashed.find(grid.tensor(voxels >> 3))
        local = (voxels & 7) @ np.array([1, 8, 64])
        index = grid.tensor((rows.numpy().astype(np.int64) * 512 + local)[found.numpy()])
        values = np.full(len(points), np.nan)
        values[found.numpy()] = distances[index].numpy()[:, 0]
        return values

    theirs = {f"{OPEN3D}, nearest": nearest}
    ours, times = race(benchmark, lambda n: layer.query(points), theirs, rounds=10, peer_every=2)
    bound = (points.nbytes + 8 * MILLION) / bytes_per_ms()
    table.add("1e6 look-ups, TSDF interpolated", "–", ours, times, must_ms=100.0, bound_ms=bound)


def test_distance_and_gradient(benchmark: BenchmarkFixture, table: Table, building: OccupancyMap) -> None:
    field = EsdfMap(building, 0.5)
    field.update()
    points = points_in(building)
    ours, _ = race(benchmark, lambda n: field.query(points, gradient=True), {}, rounds=10)
    bound = (points.nbytes + 32 * MILLION) / bytes_per_ms()
    table.add("1e6 look-ups, ESDF with gradient", "–", ours, {}, must_ms=100.0, bound_ms=bound)
