"""What one more image or scan costs the metric layers, alone, in a map 20 times as large, and beside peers.

Run with `make bench`. Every timed configuration is the one that tests/mapping verifies: images are `projective`,
scans are `rays`. Steady state: the map has seen the same part of the room before.
"""

from __future__ import annotations

import numpy as np
import pytest

from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.layer import MapLayer
from mapping.occupancy import OccupancyMap
from mapping.tsdf import TsdfMap
from tests.support.rooms import LARGE_CAMERA, Room, looking

ROOM = Room(half=(3.013, 2.587, 1.317), ball=(1.2, 0.4, -0.6), radius=0.5)
POSES = [looking(0.25 * n, 0.1, (-1.0, 0.1 * (n % 5), 0.2)) for n in range(25)]


@pytest.fixture(scope="module")
def images() -> list[tuple[np.ndarray, SE3]]:
    """25 depth images 640 × 480 of a room of 6 × 5 × 2.6 m, with 1 % of the pixels missing."""
    rng = np.random.default_rng(0)
    depths = [ROOM.depth(pose, LARGE_CAMERA) for pose in POSES]
    for depth in depths:
        depth[rng.random(depth.shape) < 0.01] = 0.0
    return list(zip(depths, POSES, strict=True))


@pytest.fixture(scope="module")
def scans() -> list[tuple[np.ndarray, SE3]]:
    """5 lidar scans of 64 × 1024 beams."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1024, endpoint=False), np.linspace(-0.4, 0.4, 64))
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    poses = [SE3(np.eye(3), (0.2 * n, 0.1 * n, 0.1)) for n in range(5)]
    return [(directions * ROOM.cast(T.translation, directions)[:, None], T) for T in poses]


def grow(layer: MapLayer, times: int) -> None:
    """Add `times` − 1 copies of the map beside it."""
    blocks, state = layer.block_ijk.copy(), layer.store.state()
    width = np.ptp(blocks, axis=0)[0] + 2
    for n in range(1, times):
        slots = layer.store.allocate(blocks + np.array([n * width, 0, 0], np.int32))
        for name, field in layer.store.fields.items():
            field[slots] = state[name]
    layer._note(np.arange(layer.store.n_blocks))


class Turn:
    """Calls `action` with each item in turn."""

    def __init__(self, action, items) -> None:
        self.action, self.items, self.n = action, items, 0

    def __call__(self) -> None:
        self.action(*self.items[self.n % len(self.items)])
        self.n += 1


def measure(benchmark, action, items, rounds: int | None = None) -> None:
    turn = Turn(action, items)
    rounds = rounds or 2 * len(items)
    benchmark.pedantic(turn, rounds=rounds, warmup_rounds=len(items))


@pytest.mark.parametrize("times", [1, 20], ids=["map", "20×map"])
@pytest.mark.parametrize("voxel_size", [0.05, 0.02])
@pytest.mark.parametrize("make", [OccupancyMap, TsdfMap])
def test_one_image(benchmark, images, make, voxel_size, times):
    if times > 1 and voxel_size < 0.05:
        pytest.skip("20 maps at 2 cm need more memory than they tell")
    layer = make(voxel_size, max_range_m=5.0)
    for depth, pose in images:
        layer.integrate_image(depth, LARGE_CAMERA, pose)
    grow(layer, times)
    measure(benchmark, lambda depth, pose: layer.integrate_image(depth, LARGE_CAMERA, pose), images)
    benchmark.extra_info.update(blocks=layer.store.n_blocks, megabytes=round(layer.memory_bytes / 1e6, 1))


@pytest.mark.parametrize("voxel_size", [0.05, 0.02])
def test_surface_of_the_blocks_that_an_image_touched(benchmark, images, voxel_size):
    layer = TsdfMap(voxel_size, max_range_m=5.0)
    changed = [layer.integrate_image(depth, LARGE_CAMERA, pose) for depth, pose in images]
    measure(benchmark, layer.surface, [(c.blocks,) for c in changed])
    benchmark.extra_info["blocks"] = int(np.median([len(c) for c in changed]))


@pytest.mark.parametrize("voxel_size", [0.05, 0.02])
def test_whole_mesh(benchmark, images, voxel_size):
    layer = TsdfMap(voxel_size, max_range_m=5.0)
    for depth, pose in images:
        layer.integrate_image(depth, LARGE_CAMERA, pose)
    benchmark.pedantic(layer.mesh, rounds=5, warmup_rounds=1)


def test_distances_after_one_more_image(benchmark, images):
    layer = OccupancyMap(0.05, 5.0)
    for depth, pose in images:
        layer.integrate_image(depth, LARGE_CAMERA, pose)
    field = EsdfMap(layer, 2.0)
    field.update()

    def follow(depth: np.ndarray, pose: SE3) -> None:
        layer.integrate_image(depth, LARGE_CAMERA, pose)
        field.update()

    measure(benchmark, follow, images[:5], rounds=5)


@pytest.mark.parametrize("voxel_size", [0.1, 0.05])
def test_one_lidar_scan(benchmark, scans, voxel_size):
    layer = OccupancyMap(voxel_size, 20.0)
    measure(benchmark, layer.integrate, scans)


def test_one_lidar_scan_into_pyoctomap(benchmark, scans):
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.05)

    def insert(points: np.ndarray, pose: SE3) -> None:
        tree.insertPointCloud(
            pose @ points, np.array(pose.translation), max_range=20.0, lazy_eval=True, discretize=True
        )

    measure(benchmark, insert, scans, rounds=3)


@pytest.mark.parametrize("voxel_size", [0.05, 0.02])
def test_one_image_into_open3d(benchmark, images, voxel_size):
    o3d = pytest.importorskip("open3d")
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1,), (1,)), voxel_size, 8, 20000, core.Device("CPU:0")
    )
    camera = LARGE_CAMERA
    intrinsic = core.Tensor(
        np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]), core.float64
    )

    def fuse(depth: np.ndarray, pose: SE3) -> None:
        image = o3d.t.geometry.Image(core.Tensor(depth))
        extrinsic = core.Tensor(pose.inverse().matrix, core.float64)
        blocks = grid.compute_unique_block_coordinates(image, intrinsic, extrinsic, 1.0, 5.0, 4.0)
        grid.integrate(blocks, image, intrinsic, extrinsic, 1.0, 5.0, 4.0)

    measure(benchmark, fuse, images)


@pytest.mark.parametrize("layer", ["occupancy", "tsdf", "esdf with gradient"])
def test_a_million_random_look_ups(benchmark, images, layer):
    occupancy, tsdf = OccupancyMap(0.05, 5.0), TsdfMap(0.05, max_range_m=5.0)
    for depth, pose in images:
        occupancy.integrate_image(depth, LARGE_CAMERA, pose)
        tsdf.integrate_image(depth, LARGE_CAMERA, pose)
    field = EsdfMap(occupancy, 0.5)
    field.update()
    points = np.random.default_rng(0).uniform((-3, -2.5, -1.3), (3, 2.5, 1.3), (1_000_000, 3))
    ask = {
        "occupancy": occupancy.query,
        "tsdf": tsdf.query,
        "esdf with gradient": lambda p: field.query(p, gradient=True),
    }[layer]
    benchmark.pedantic(ask, args=(points,), rounds=5, warmup_rounds=1)
