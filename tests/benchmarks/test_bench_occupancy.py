"""What one more scan or image costs an occupancy map that has seen it all before, beside OctoMap.

Run with `make bench`. The configurations are those that tests/mapping/test_modes.py verifies.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.occupancy import OccupancyMap
from tests.support import modes
from tests.support.agreement import with_octomap
from tests.support.building import LOOP, lidar_scans, rgbd_images
from tests.support.modes import Beams, Configuration, beams_of
from tests.support.racing import Table, bytes_per_ms, race

LAZY, LAZY_ALL, EAGER = "OctoMap, lazy, discretised", "OctoMap, lazy, all beams", "OctoMap, eager, all beams"
NOISE_M = 0.01


class Peer:
    """An octree that has seen all the beams, and sees them again one by one."""

    def __init__(self, configuration: Configuration, beams: list[Beams], *, lazy: bool) -> None:
        self.configuration, self.beams, self.lazy = configuration, beams, lazy
        self.tree = configuration.theirs()
        for scan in beams:
            configuration.insert(self.tree, scan)
        self.tree.updateInnerOccupancy()

    def __call__(self, n: int) -> None:
        self.configuration.insert(self.tree, self.beams[n % len(self.beams)], lazy=self.lazy)


@pytest.fixture(scope="module")
def lidar_beams() -> list[Beams]:
    return beams_of(lidar_scans(noise_m=NOISE_M))


@pytest.fixture(scope="module")
def lidar_peers(lidar_beams: list[Beams]) -> dict[str, Peer]:
    return {
        LAZY: Peer(modes.LIDAR_5CM_DISCRETISED, lidar_beams, lazy=True),
        EAGER: Peer(modes.LIDAR_5CM, lidar_beams, lazy=False),
    }


@pytest.fixture(scope="module")
def loop_peers() -> dict[str, Peer]:
    beams = beams_of(rgbd_images(LOOP))
    return {
        LAZY_ALL: Peer(modes.RGBD_5CM, beams, lazy=True),
        LAZY: Peer(modes.RGBD_5CM_DISCRETISED, beams, lazy=True),
    }


def again(layer: OccupancyMap, fuse: Callable[[OccupancyMap, Any], object], seen: list[Any]) -> Callable[[int], object]:
    """The map is shown everything once; then each call shows it the next once more."""
    for item in seen:
        fuse(layer, item)
    return lambda n: fuse(layer, seen[n % len(seen)])


def bound_ms(make: Callable[[], OccupancyMap], fuse: Callable[[OccupancyMap, Any], object], seen: list[Any]) -> float:
    """Reading and writing each byte of the blocks that one scan touches, once: mean over the scans."""
    blocks = 0
    for item in seen[:4]:
        layer = make()
        fuse(layer, item)
        blocks += len(layer.block_ijk)
    return 2 * 512 * blocks / len(seen[:4]) / bytes_per_ms()


@pytest.mark.parametrize("configuration", [modes.LIDAR_5CM, modes.LIDAR_5CM_DISCRETISED], ids=str)
def test_what_is_timed_says_what_octomap_says(
    benchmark: BenchmarkFixture, table: Table, lidar_beams: list[Beams], tmp_path: Path, configuration: Configuration
) -> None:
    """Once, as it takes long: all scans that are timed here, not only the few that the tests compare."""
    found = benchmark.pedantic(with_octomap, args=(configuration, lidar_beams, tmp_path), rounds=1)
    table.notes += [f"lidar, rays, {configuration}, {len(lidar_beams)} scans: {found.lines()[0]}", *found.lines()[1:]]
    assert found.share >= 0.999


@pytest.mark.parametrize("discretise", [False, True], ids=["all beams", "discretised"])
def test_a_lidar_scan_by_rays(
    benchmark: BenchmarkFixture, table: Table, lidar_beams: list[Beams], lidar_peers: dict[str, Peer], discretise: bool
) -> None:
    configuration = modes.LIDAR_5CM_DISCRETISED if discretise else modes.LIDAR_5CM
    step = again(configuration.ours(), configuration.cast, lidar_beams)
    ours, theirs = race(benchmark, step, lidar_peers, rounds=40, peer_every=8)
    table.add(
        "lidar 64 × 1024, 5 cm",
        f"rays, {'discretised' if discretise else 'all beams'}",
        ours,
        theirs,
        must_share={LAZY: 1 / 40},
        bound_ms=bound_ms(configuration.ours, configuration.cast, lidar_beams),
    )


def test_a_lidar_scan_projected(benchmark: BenchmarkFixture, table: Table, lidar_peers: dict[str, Peer]) -> None:
    scans = lidar_scans(noise_m=NOISE_M)
    step = again(modes.LIDAR_5CM.ours(), modes.project_sweep, scans)
    ours, theirs = race(benchmark, step, lidar_peers, rounds=40, peer_every=8)
    bound = bound_ms(modes.LIDAR_5CM.ours, modes.project_sweep, scans)
    table.add("lidar 64 × 1024, 5 cm", "projective", ours, theirs, must_share={LAZY: 1 / 40}, bound_ms=bound)


@pytest.mark.parametrize("discretise", [False, True], ids=["all beams", "discretised"])
def test_an_image_by_rays(
    benchmark: BenchmarkFixture, table: Table, loop_peers: dict[str, Peer], discretise: bool
) -> None:
    beams = beams_of(rgbd_images(LOOP))
    configuration = modes.RGBD_5CM_DISCRETISED if discretise else modes.RGBD_5CM
    step = again(configuration.ours(), configuration.cast, beams)
    ours, theirs = race(benchmark, step, loop_peers, rounds=2 * LOOP, peer_every=6)
    bound = bound_ms(configuration.ours, configuration.cast, beams)
    mode = f"rays, {'discretised' if discretise else 'all beams'}"
    must = {LAZY if discretise else LAZY_ALL: 1 / 6}  # the peer that does the same
    table.add("RGB-D 640 × 480, 5 cm", mode, ours, theirs, must_share=must, bound_ms=bound)


def test_an_image_projected(benchmark: BenchmarkFixture, table: Table, loop_peers: dict[str, Peer]) -> None:
    images = rgbd_images(LOOP)
    step = again(modes.RGBD_5CM.ours(), modes.project, images)
    ours, theirs = race(benchmark, step, loop_peers, rounds=2 * LOOP, peer_every=6)
    bound = bound_ms(modes.RGBD_5CM.ours, modes.project, images)
    table.add("RGB-D 640 × 480, 5 cm", "projective", ours, theirs, must_share=1 / 6, bound_ms=bound)
