"""What a map of the building costs a process that does nothing else: run by test_bench_memory.py, one a library.

    python -m tests.benchmarks.resident ours|pyoctomap scans.npz

The scans come from a file, so that making them leaves nothing behind. Prints JSON: megabytes that became resident,
those that stay when the allocator gives back what it keeps for later, and what the library itself says.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from mapping.geometry import SE3
from tests.support import modes
from tests.support.modes import Beams, Configuration


def resident_mb() -> float:
    """Megabytes of this process that lie in memory."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def give_back() -> None:
    """Let the C library give freed memory back to the system, where it can."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def fill(library: str, configuration: Configuration, scans: list[Beams]) -> tuple[Any, float]:
    """A map of the scans, and how large the library says that it is [MB]."""
    if library == "ours":
        layer = configuration.ours()
        for beams in scans:
            configuration.cast(layer, beams)
        return layer, layer.memory_bytes / 1e6
    tree = configuration.theirs()
    for beams in scans:
        configuration.insert(tree, beams, lazy=False)
    return tree, tree.memoryUsage() / 1e6


def main(library: str, path: str) -> None:
    with np.load(path) as stored:
        n = len(stored["poses"])
        scans = [Beams(stored[f"points{k}"], SE3.from_matrix(stored["poses"][k])) for k in range(n)]
    small = [Beams(beams.points[::500], beams.T_map_sensor) for beams in scans]
    fill(library, modes.LIDAR_10CM, small)  # what is compiled and loaded once is not the map's
    give_back()
    before = resident_mb()
    layer, said = fill(library, modes.LIDAR_5CM, scans)
    grown = resident_mb() - before
    give_back()
    print(json.dumps({"grown": grown, "kept": resident_mb() - before, "said": said}))
    del layer


if __name__ == "__main__":
    main(*sys.argv[1:])
