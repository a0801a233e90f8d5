"""The cluster step of a 640×480 image and of a lidar scan without labels, in one room and in a world of many.

Run with `make bench`, or alone: `pytest tests/benchmarks/test_bench_clusters.py --benchmark-enable --benchmark-only -s`
Timed is what clusters cost beside all else: finding components anew and bringing their nodes up to date.
"""

from __future__ import annotations

import gc
import time
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.geometry import SE3
from mapping.observations import RgbdImage, Scan
from scenegraph.world import World
from tests.scenegraph.test_clusters import room, round_the_room, swept
from tests.support.rooms import LARGE_CAMERA

ROOMS = 12
APART_M = 20.0


def images() -> list[RgbdImage]:
    return [
        room(0).image(pose, n + 1, labelled=False, camera=LARGE_CAMERA) for n, pose in enumerate(round_the_room()[::2])
    ]


def scans() -> list[Scan]:
    places = ((0.4, 0.4), (3.6, 0.4), (3.6, 3.6), (0.4, 3.6))
    return [swept(room(0), SE3(np.eye(3), np.array([x, y, 1.6])), n + 1) for n, (x, y) in enumerate(places)]


def moved(observation: Any, rooms: int, stamp_ns: int) -> Any:
    """The observation as it would be in the room that lies so many places further on."""
    pose = "T_map_camera" if isinstance(observation, RgbdImage) else "T_map_sensor"
    shift = SE3(np.eye(3), (APART_M * rooms, 0.0, 0.0))
    return observation.model_copy(update={pose: shift @ getattr(observation, pose), "stamp_ns": stamp_ns})


@pytest.mark.parametrize("rooms", [1, ROOMS], ids=["one room", f"{ROOMS} rooms"])
@pytest.mark.parametrize("seen", [images, scans], ids=["image", "scan"])
def test_clusters_of_one_observation(
    benchmark: BenchmarkFixture, monkeypatch: pytest.MonkeyPatch, seen: Any, rooms: int
) -> None:
    """The first room is seen once more."""
    observations, times = seen(), list[float]()
    with World() as world:
        for n in range(rooms):
            for observation in observations:
                world.integrate(moved(observation, n, observation.stamp_ns + 1000 * n))
        update = world.perception.clusters.update

        def timed(*args: Any) -> Any:
            started = time.process_time()
            result = update(*args)
            times.append(1e3 * (time.process_time() - started))
            return result

        monkeypatch.setattr(world.perception.clusters, "update", timed)
        gc.collect()

        def see_again() -> None:
            for observation in observations:
                world.integrate(moved(observation, 0, 10**6 + observation.stamp_ns))

        benchmark.pedantic(see_again, rounds=1)
        print(f"\n{len(world.map.clusters)} components: median {np.median(times):.2f} ms CPU, most {max(times):.2f} ms")
