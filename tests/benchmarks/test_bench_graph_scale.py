"""Graphs of 1 000, 10 000 and 100 000 objects beside the `spark-dsg` package. Run with `make bench`.

A building of rooms of a hundred objects each. Ours finds the relations itself, from the boxes and by the thresholds of
the rules; spark-dsg is given the pairs that ours found, one undirected edge a pair.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from reasoning import KnowledgeBase
from scenegraph.graph import LAYERS, Box, EdgeTable, GraphChanges, NodeTable, SceneGraph
from scenegraph.relating import Thresholds, follow, relate
from scenegraph.store import load_graph, save_graph
from tests.support.many_boxes import building
from tests.support.racing import Table, race
from tests.support.spark_graph import SparkInput, spark_graph

spark_dsg = pytest.importorskip("spark_dsg")
SPARK = "spark-dsg"
ROOMS = (10, 100, 1000)
NEAR_M = 5.0


@pytest.fixture(scope="module")
def thresholds() -> Iterator[Thresholds]:
    with KnowledgeBase() as knowledge:
        found = Thresholds.of(knowledge)
        relate(building(2)[0], found)  # asks once which classes are containers
        yield found


@cache
def given(n_rooms: int) -> tuple[NodeTable, EdgeTable, dict[str, Any]]:
    """The nodes, the edges that are no measurements, and the nodes' columns as a program would have them."""
    nodes, hierarchy = building(n_rooms)
    columns = {
        "ids": list(nodes.ids),
        "layers": [LAYERS[layer] for layer in nodes.layer.tolist()],
        "labels": [nodes.labels[label] for label in nodes.label.tolist()],
        "center": nodes.center,
        "size": nodes.size,
        "rotation_wxyz": nodes.rotation_wxyz,
        "confidence": nodes.confidence,
        "first_seen_ns": nodes.first_seen_ns,
        "last_seen_ns": nodes.last_seen_ns,
        "attributes": nodes.attributes,
    }
    return nodes, hierarchy, columns


def build(n_rooms: int, thresholds: Thresholds) -> SceneGraph:
    """From columns to a graph with all its relations."""
    _, hierarchy, columns = given(n_rooms)
    nodes = NodeTable.columns(**columns)
    return SceneGraph.from_tables(nodes, relate(nodes, thresholds).joined(hierarchy))


@pytest.fixture(scope="module")
def graphs(thresholds: Thresholds) -> dict[int, SceneGraph]:
    return {n_rooms: build(n_rooms, thresholds) for n_rooms in ROOMS}


@pytest.fixture(scope="module")
def sparks(graphs: dict[int, SceneGraph]) -> dict[int, Any]:
    return {n_rooms: spark_graph(spark_input(n_rooms, graphs)) for n_rooms in ROOMS}


@cache
def _spark_input(n_rooms: int, edges: EdgeTable) -> SparkInput:
    return SparkInput(given(n_rooms)[0], [edges])


def spark_input(n_rooms: int, graphs: dict[int, SceneGraph]) -> SparkInput:
    return _spark_input(n_rooms, graphs[n_rooms].tables()[1])


def size(n_rooms: int) -> str:
    return f"graph of {100 * n_rooms:,} objects".replace(",", " ")


@pytest.mark.parametrize("n_rooms", ROOMS)
def test_build(
    benchmark: BenchmarkFixture, table: Table, thresholds: Thresholds, graphs: dict[int, SceneGraph], n_rooms: int
) -> None:
    pairs = spark_input(n_rooms, graphs)
    rounds = 3 if n_rooms == max(ROOMS) else 7
    peers = {SPARK: lambda n: spark_graph(pairs)}
    ours, theirs = race(benchmark, lambda n: build(n_rooms, thresholds), peers, rounds=rounds)
    table.add(f"{size(n_rooms)}: build", "relations inferred", ours, theirs, must_share=3.0)
    table.notes.append(f"{size(n_rooms)}: {graphs[n_rooms]!r}; {SPARK} has {len(pairs.sources)} pairs")


@pytest.mark.parametrize("n_rooms", ROOMS)
def test_update(
    benchmark: BenchmarkFixture, table: Table, thresholds: Thresholds, graphs: dict[int, SceneGraph], n_rooms: int
) -> None:
    """An object is pushed by some decimetres, and all its relations follow."""
    rng = np.random.default_rng(0)
    graph = graphs[n_rooms]

    def push(n: int) -> None:
        node = graph.node(f"object_{rng.integers(100 * n_rooms)}")
        assert node.box is not None
        center = node.box.center + rng.normal(0.0, 0.2, 3) * (1, 1, 0)
        box = Box(center=center, size=node.box.size, rotation_wxyz=node.box.rotation_wxyz)
        changes = GraphChanges()
        changes.put(node.replace(box=box, position=center, last_seen_ns=10_000 + n))
        follow(graph, changes, thresholds)
        graph.commit(changes, 10_000 + n)

    ours, _ = race(benchmark, push, {}, rounds=200)
    table.add(f"{size(n_rooms)}: one object moves", "relations inferred", ours, {}, must_ms=5.0)


@pytest.mark.parametrize("n_rooms", ROOMS)
def test_near(
    benchmark: BenchmarkFixture, table: Table, graphs: dict[int, SceneGraph], sparks: dict[int, Any], n_rooms: int
) -> None:
    """The objects within 5 m of a point, nearest first; spark-dsg leaves the look at all of them to its user."""
    rng = np.random.default_rng(1)
    graph, spark = graphs[n_rooms], sparks[n_rooms]
    points = given(n_rooms)[0].center[rng.integers(0, 100 * n_rooms, 300)]
    found: list[int] = []

    def scan(n: int) -> None:
        objects = spark.get_layer(2).nodes
        away = [(float(np.linalg.norm(node.attributes.position - points[n])), node.id) for node in objects]
        sorted(item for item in away if item[0] <= NEAR_M)

    ours, theirs = race(
        benchmark,
        lambda n: found.append(len(graph.within(points[n], NEAR_M, "object"))),
        {f"{SPARK}, a scan in Python": scan},
        rounds=300,
        peer_every=100,
    )
    table.add(
        f"{size(n_rooms)}: near {NEAR_M:g} m of a point ({np.mean(found):.0f} found)", "–", ours, theirs, must_ms=1.0
    )


@pytest.mark.parametrize("n_rooms", ROOMS)
def test_save_and_load(
    benchmark: BenchmarkFixture,
    table: Table,
    thresholds: Thresholds,
    graphs: dict[int, SceneGraph],
    sparks: dict[int, Any],
    tmp_path: Path,
    n_rooms: int,
) -> None:
    graph, spark = build(n_rooms, thresholds), sparks[n_rooms]
    file, theirs_file = tmp_path / "graph.sgm", tmp_path / "spark.bin"

    def ours_once(n: int) -> None:
        save_graph(file, graph)
        load_graph(file)

    def theirs_once(n: int) -> None:
        theirs_file.write_bytes(spark.to_binary())
        spark_dsg.DynamicSceneGraph.from_binary(theirs_file.read_bytes())

    ours, theirs = race(benchmark, ours_once, {f"{SPARK}, binary": theirs_once}, rounds=3, peer_every=3)
    table.add(f"{size(n_rooms)}: save and load", "compact", ours, theirs, must_ms=1500.0)
    megabytes = [path.stat().st_size / 1e6 for path in (file, theirs_file)]
    table.notes.append(f"{size(n_rooms)}: file of {megabytes[0]:.1f} MB, of {SPARK} {megabytes[1]:.1f} MB")
    assert load_graph(file) == graph


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads what is resident from /proc")
def test_memory(benchmark: BenchmarkFixture, table: Table, tmp_path: Path) -> None:
    found: dict[str, dict[str, float]] = {}
    n_rooms = max(ROOMS)

    def measure(library: str) -> None:
        command = [
            sys.executable,
            "-m",
            "tests.benchmarks.resident_graph",
            library,
            str(n_rooms),
            str(tmp_path / "pairs.npy"),
        ]
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout
        found[library] = json.loads(told.splitlines()[-1])

    benchmark.pedantic(measure, args=("ours",), rounds=1)
    measure("spark_dsg")
    for library, mb in found.items():
        table.notes.append(
            f"{size(n_rooms)}: memory of {library}: {mb['grown']:+.0f} MB resident, of which the graph keeps "
            f"{mb['kept']:+.0f} MB"
        )
