"""The same scan into a map as it is, and into one that is a hundred times larger. Run with `make bench`."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.layer import MapLayer
from mapping.occupancy import OccupancyMap
from tests.benchmarks.test_bench_tsdf import fuse, new_map
from tests.support import modes
from tests.support.building import LOOP, lidar_scans, rgbd_images
from tests.support.modes import beams_of
from tests.support.racing import Table, race

TIMES = 100
MUST = 1.2
APART_BLOCKS = 100


def grow(layer: MapLayer) -> None:
    """Put copies of the map beside it, all about it, until there are `TIMES` as many blocks."""
    blocks = layer.block_ijk.copy()
    evidence = layer.evidence_of(blocks) if isinstance(layer, OccupancyMap) else None
    fields = {} if evidence is not None else {name: layer.store.used(name).copy() for name in layer.store.fields}
    for n in range(1, TIMES):
        beside = blocks + np.array([n % 10, n // 10, 0], np.int32) * APART_BLOCKS
        if evidence is not None:
            layer.set_evidence(beside, evidence)
            continue
        slots = layer.store.allocate(beside)
        for name, values in fields.items():
            layer.store.fields[name][slots] = values


@pytest.mark.parametrize("kind", ["lidar", "occupancy image", "TSDF image"])
def test_growth(benchmark: BenchmarkFixture, table: Table, kind: str) -> None:
    if kind == "lidar":
        mode, seen, make, step = "rays", beams_of(lidar_scans(2, 0.01)), modes.LIDAR_5CM.ours, modes.LIDAR_5CM.cast
    elif kind == "occupancy image":
        mode, seen, make, step = "projective", rgbd_images(LOOP), modes.RGBD_5CM.ours, modes.project
    else:
        mode, seen, make, step = "projective", rgbd_images(LOOP), lambda: new_map(0.05), fuse
    small, large = make(), make()
    for layer in (small, large):
        for item in seen:
            step(layer, item)
    grow(large)
    ours, theirs = race(
        benchmark,
        lambda n: step(large, seen[n % len(seen)]),
        {"the map itself": lambda n: step(small, seen[n % len(seen)])},
        rounds=48,
    )
    megabytes = f"{large.memory_bytes / 1e6:.0f} MB"
    table.add(f"growth: {kind} into {TIMES} × the map ({megabytes})", mode, ours, theirs, must_share=MUST)
