"""One labelled image through every floor of the world, in a small world and in one 20 times larger.

Run with `make bench`, or alone: `pytest tests/benchmarks/test_bench_world.py --benchmark-enable --benchmark-only -s`.
"""

import gc
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.geometry import SE3
from mapping.observations import LabelSpace, RgbdImage
from scenegraph.simulation import simulate_home
from scenegraph.world import World

IMAGES = 30
HOMES = 20
APART_M = 40.0


@pytest.fixture(scope="module")
def tour() -> tuple[LabelSpace, list[RgbdImage]]:
    stream = simulate_home(1000).observe(noise="realistic", seed=1000)
    seen = [o for o in islice(stream, 2 * IMAGES + 2) if isinstance(o, LabelSpace | RgbdImage)]
    return seen[0], seen[1:]  # type: ignore[return-value]


def moved(image: RgbdImage, homes: int, stamp_ns: int) -> RgbdImage:
    """The image as it would be in the home that stands `homes` places further on."""
    assert image.T_map_camera is not None
    shift = SE3(np.eye(3), (APART_M * (homes % 5), APART_M * (homes // 5), 0.0))
    return image.model_copy(update={"T_map_camera": shift @ image.T_map_camera, "stamp_ns": stamp_ns})


@pytest.fixture(params=[1, HOMES], ids=["one home", f"{HOMES} homes"])
def world(request: pytest.FixtureRequest, tour: tuple[LabelSpace, list[RgbdImage]]) -> Iterator[World]:
    with World() as world:
        world.integrate(tour[0])
        for home in range(request.param):
            for n, image in enumerate(tour[1]):
                world.integrate(moved(image, home, home * IMAGES * 500_000_000 + n * 500_000_000))
        yield world


def test_one_image_through_all_floors(
    benchmark: BenchmarkFixture, world: World, tour: tuple[LabelSpace, list[RgbdImage]]
) -> None:
    """The first home is seen once more, image by image."""
    stamp_ns = world.graph.stamp_ns
    times = []
    gc.collect()

    def see_again() -> None:
        nonlocal stamp_ns
        for image in tour[1]:
            stamp_ns += 500_000_000
            again = moved(image, 0, stamp_ns)
            started = time.perf_counter()
            world.integrate(again)
            times.append((time.perf_counter() - started) * 1e3)

    benchmark.pedantic(see_again, rounds=1)
    median, p99 = np.median(times), np.percentile(times, 99)
    size = f"{len(world.graph)} nodes, {world.graph.n_edges} edges"
    print(f"\n{size}: median {median:.1f} ms an image, p99 {p99:.1f} ms")
