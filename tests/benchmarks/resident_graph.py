"""What a graph costs a process that does nothing else: run by test_bench_graph_scale.py, one a library.

    python -m tests.benchmarks.resident_graph ours|spark_dsg rooms pairs.npy

Prints JSON: megabytes that became resident while the graph was made, and those that stay with it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from reasoning import KnowledgeBase
from scenegraph.graph import SceneGraph
from scenegraph.relating import Thresholds, relate
from tests.benchmarks.resident import give_back, resident_mb
from tests.support.many_boxes import building
from tests.support.spark_graph import SparkInput, spark_graph


def ours(n_rooms: int, thresholds: Thresholds) -> tuple[SceneGraph, list[list[int]]]:
    """The graph, and its pairs."""
    nodes, hierarchy = building(n_rooms)
    edges = relate(nodes, thresholds).joined(hierarchy)
    return SceneGraph.from_tables(nodes, edges), SparkInput(nodes, [edges]).pairs


def main(library: str, n_rooms: str, path: str) -> None:
    made: Any
    if library == "ours":
        with KnowledgeBase() as knowledge:
            thresholds = Thresholds.of(knowledge)
            ours(2, thresholds)  # what is compiled and loaded once is not the graph's
            give_back()
            before = resident_mb()
            made, pairs = ours(int(n_rooms), thresholds)
        Path(path).write_bytes(np.array(pairs, np.int32).tobytes())
        del pairs
    else:
        given = SparkInput(*(lambda nodes, edges: (nodes, [edges]))(*building(int(n_rooms))))
        given.pairs = np.frombuffer(Path(path).read_bytes(), np.int32).reshape(-1, 2).tolist()
        small = SparkInput(*(lambda nodes, edges: (nodes, [edges]))(*building(2)))
        spark_graph(small)
        give_back()
        before = resident_mb()
        made = spark_graph(given)
    grown = resident_mb() - before
    give_back()
    print(json.dumps({"grown": grown, "kept": resident_mb() - before}))
    del made


if __name__ == "__main__":
    main(*sys.argv[1:])
