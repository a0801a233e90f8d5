"""What a graph costs a process that does nothing else: run by test_bench_graph_scale.py, one a library.

    python -m tests.benchmarks.resident_graph ours|spark_dsg rooms pairs.npy

Prints JSON: megabytes that became resident while the graph was made, and those that stay with it.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np

from reasoning import KnowledgeBase
from scenegraph.graph import SceneGraph
from scenegraph.relating import Thresholds, relate
from tests.benchmarks.resident import give_back, resident_mb
from tests.support.many_boxes import building
from tests.support.spark_graph import SparkInput, spark_graph


def ours(n_rooms: int, thresholds: Thresholds) -> SceneGraph:
    """The graph with its relations."""
    nodes, hierarchy = building(n_rooms)
    return SceneGraph.from_tables(nodes, relate(nodes, thresholds).joined(hierarchy))


def theirs(n_rooms: int) -> SparkInput:
    """What spark-dsg is given, but for the relations."""
    nodes, hierarchy = building(n_rooms)
    return SparkInput(nodes, [hierarchy])


def main(library: str, n_rooms: str, path: str) -> None:
    made: Any
    if library == "ours":
        with KnowledgeBase() as knowledge:
            thresholds = Thresholds.of(knowledge)
            ours(2, thresholds)  # what is compiled and loaded once is not the graph's
            give_back()
            before = resident_mb()
            made = ours(int(n_rooms), thresholds)
            grown = resident_mb() - before
            give_back()
            kept = resident_mb() - before
        nodes, edges = made.tables()
        given = SparkInput(nodes, [edges])
        np.save(path, np.array([given.sources, given.targets], np.int32).T)
    else:
        given = theirs(int(n_rooms))
        given.take_pairs(np.load(path))
        spark_graph(theirs(2))
        give_back()
        before = resident_mb()
        made = spark_graph(given)
        grown = resident_mb() - before
        give_back()
        kept = resident_mb() - before
    print(json.dumps({"grown": grown, "kept": kept}))
    del made


if __name__ == "__main__":
    main(*sys.argv[1:])
