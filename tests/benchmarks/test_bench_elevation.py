"""What one more lidar scan costs the 2.5-D layers, in a map as it is and in one a hundred times larger.

Run with `make bench`. Scans of up to 65 536 points in the simulated building, cells of 10 cm, all scans seen before.
"""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.elevation import ElevationMap, ExtendedElevationMap, HeightMap
from mapping.multilevel import MultiLevelMap
from mapping.tiles import TileLayer
from mapping.traversability import traversability
from tests.support.building import LIDAR_RANGE_M, lidar_scans
from tests.support.racing import Table, bytes_per_ms, race

CELL_M = 0.1
TIMES = 100
LAYERS = [HeightMap, ElevationMap, ExtendedElevationMap, MultiLevelMap]


def seen_all(make: type[TileLayer]) -> TileLayer:
    layer = make(CELL_M, LIDAR_RANGE_M)
    for scan in lidar_scans(noise_m=0.01):
        layer.integrate(scan.points, scan.T_map_sensor)
    return layer


def grow(layer: TileLayer) -> None:
    """Put copies of the map beside it until it has `TIMES` as many tiles."""
    tiles = layer.block_ijk.copy()
    fields = {name: layer.store.used(name).copy() for name in layer.store.fields}
    for n in range(1, TIMES):
        slots = layer.store.allocate(tiles + np.array([n % 10, n // 10, 0], np.int32) * 100)
        for name, values in fields.items():
            layer.store.fields[name][slots] = values


@pytest.mark.parametrize("make", LAYERS)
def test_one_more_scan(benchmark: BenchmarkFixture, table: Table, make: type[TileLayer]) -> None:
    scans = lidar_scans(noise_m=0.01)
    layer, large = seen_all(make), seen_all(make)
    grow(large)

    def scan(into: TileLayer, n: int) -> None:
        seen = scans[n % len(scans)]
        into.integrate(seen.points, seen.T_map_sensor)

    ours, theirs = race(benchmark, lambda n: scan(large, n), {"the map itself": lambda n: scan(layer, n)}, rounds=60)
    points = float(np.mean([s.points.nbytes for s in scans]))
    megabytes = f"{layer.memory_bytes / 1e6:.1f} MB"
    name = f"{layer.kind.replace('_', ' ')}, {CELL_M * 100:.0f} cm, into {TIMES} × the map of {megabytes}"
    table.add(name, "points", ours, theirs, must_ms=5.0, must_share=1.2, bound_ms=points / bytes_per_ms())


@pytest.mark.parametrize("make", LAYERS)
def test_traversability_of_a_building(benchmark: BenchmarkFixture, table: Table, make: type[TileLayer]) -> None:
    layer = seen_all(make)
    ours, _ = race(benchmark, lambda n: traversability(layer), {}, rounds=9)
    cells = int(np.isfinite(layer.grid()[0]).sum())
    table.add(f"traversability of {cells} cells, {layer.kind.replace('_', ' ')}", "all cells", ours, {})
