"""Following a map with a distance field, beside computing it anew over the whole map's box. Run with `make bench`.

Distances up to 2 m at 5 cm. Every image is new to the map and has a structured-light camera's noise. Only the
field's update is timed, not the image's.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.esdf import EsdfMap
from mapping.occupancy import OCCUPIED, OccupancyMap
from tests.support import modes
from tests.support.building import LOOP, N_IMAGES, lidar_scans, rgbd_image, rgbd_images
from tests.support.modes import beams_of
from tests.support.racing import Table, bytes_per_ms, race

TRUNCATION_M = 2.0


def one_room() -> OccupancyMap:
    """The first room, seen by a perfect camera."""
    layer = modes.RGBD_5CM.ours()
    for image in rgbd_images(LOOP):
        modes.project(layer, image)
    return layer


def whole_building() -> OccupancyMap:
    """All rooms, seen by the lidar."""
    layer = modes.LIDAR_5CM.ours()
    for beams in beams_of(lidar_scans(noise_m=0.01)):
        modes.LIDAR_5CM.cast(layer, beams)
    return layer


def transform_of(layer: OccupancyMap) -> tuple[str, int, Callable[[int], object]]:
    """The full distance transform of the map's box as it is now, with what PyPI has fastest."""
    blocks = layer.block_ijk
    free = layer.box(blocks.min(axis=0) * layer.block_size_m, (blocks.max(axis=0) + 1) * layer.block_size_m)[0]
    free = np.ascontiguousarray(free != OCCUPIED)
    try:
        from edt import edt

        threads = os.cpu_count() or 1
        return "edt of the whole box", free.size, lambda n: edt(free, parallel=threads)
    except ImportError:
        from scipy.ndimage import distance_transform_edt

        return "scipy's transform of the whole box", free.size, lambda n: distance_transform_edt(free)


@dataclass(frozen=True)
class Case:
    """The map as it is, and the images that come to it one by one."""

    name: str
    make: Callable[[], OccupancyMap]
    images: range


CASES = [
    Case("in a room seen before", one_room, range(LOOP)),
    Case("into new rooms", one_room, range(LOOP, N_IMAGES)),
    Case("in a building seen by the lidar", whole_building, range(LOOP)),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_distances_after_one_more_image(benchmark: BenchmarkFixture, table: Table, case: Case) -> None:
    layer = case.make()
    field = EsdfMap(layer, TRUNCATION_M)
    field.update()
    images = [rgbd_image(n, noisy=True) for n in case.images]
    name, size, transform = transform_of(layer)
    changed: list[int] = []
    ours, theirs = race(
        benchmark,
        lambda n: changed.append(len(field.update())),
        {name: transform},
        rounds=len(images),
        peer_every=6,
        prepare=lambda n: modes.project(layer, images[n]),
    )
    bound = 2 * 4 * 512 * float(np.mean(changed)) / bytes_per_ms()
    row = f"ESDF, 5 cm, 2 m, one more image {case.name} ({size / 1e6:.1f} M voxels)"
    table.add(row, "projective", ours, theirs, must_ms=20.0, must_share=0.1, bound_ms=bound)
