"""How much memory a map of the building takes, beside OctoMap; each in a process of its own. Run with `make bench`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.support.building import lidar_scans
from tests.support.racing import Table

MUST_MB = 16.0


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scans") / "scans.npz"
    seen = lidar_scans(noise_m=0.01)
    points = {f"points{n}": scan.points for n, scan in enumerate(seen)}
    np.savez(path, poses=np.array([scan.T_map_sensor.matrix for scan in seen]), **points)
    return path


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads what is resident from /proc")
def test_memory_of_the_building(benchmark: BenchmarkFixture, table: Table, scans: Path) -> None:
    pytest.importorskip("pyoctomap")
    found: dict[str, dict[str, float]] = {}

    def measure(library: str) -> None:
        command = [sys.executable, "-m", "tests.benchmarks.resident", library, str(scans)]
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout
        found[library] = json.loads(told.splitlines()[-1])

    measure("pyoctomap")
    benchmark.pedantic(measure, args=("ours",), rounds=1)
    for library, mb in found.items():
        table.notes.append(
            f"memory, lidar map at 5 cm, 20 scans, {library}: {mb['said']:.1f} MB by its own account, "
            f"resident {mb['grown']:+.0f} MB, of which the map keeps {mb['kept']:+.0f} MB"
        )
    table.notes.append(f"memory must be ≤ {MUST_MB:g} MB: {'met' if found['ours']['said'] <= MUST_MB else 'NOT met'}")
