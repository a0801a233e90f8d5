"""Classes out of the map of rooms of a simulated home, beside the obvious ways. Run with `make bench`.

The labels of a mesh, obviously: the nearest labelled voxel, by a k-d tree over all of them. A coloured octree:
pyoctomap's, leaf by leaf. The rest has no peer.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pyoctomap
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.spatial import cKDTree

from mapping.cost import CostMap, CostTable
from mapping.histograms import aligned_box, class_histogram
from mapping.labelled import class_colors, labelled_cloud, labels_at, labels_near, write_class_octree
from mapping.layered import LayeredMap
from mapping.palette import Palette
from scenegraph import World
from scenegraph.simulation import simulate_home
from tests.support.racing import Table, race

OBSERVATIONS = 160
PALETTE = Palette()


@pytest.fixture(scope="module")
def layers() -> Iterator[LayeredMap]:
    """What was mapped on the first part of a tour."""
    with World() as world:
        for observation in islice(simulate_home(0).observe(noise="realistic", seed=0), OBSERVATIONS):
            world.integrate(observation)
        yield world.map


def case(what: str, n: int, of: str) -> str:
    return f"{what}, {n:,} {of}"


def test_labels_of_a_mesh(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap) -> None:
    semantics, vertices = layers.semantics, layers.tsdf.mesh().vertices
    reach = layers.tsdf.voxel_size_m

    def by_tree(n: int) -> object:
        centres, labels, _ = semantics.voxels()
        far, row = cKDTree(centres).query(vertices, distance_upper_bound=reach)
        return np.where(np.isfinite(far), np.append(labels, 0)[row], 0)

    peers = {"scipy cKDTree": by_tree}
    ours, times = race(benchmark, lambda n: labels_near(vertices, semantics, reach), peers, rounds=10, peer_every=5)
    table.add(case("labels of a mesh", len(vertices), "vertices"), "–", ours, times, must_share=0.2)


def test_coloured_octree(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap, tmp_path: Path) -> None:
    occupied, free = layers.occupancy.occupied_centres(), layers.occupancy.free_centres()

    def leaf_by_leaf(n: int) -> None:
        tree = pyoctomap.ColorOcTree(layers.occupancy.voxel_size_m)
        colors = class_colors(layers.semantics, layers.occupancy.voxel_size_m, PALETTE)(occupied)
        for point in free:
            tree.updateNode(point, False, True)
        for point, (red, green, blue) in zip(occupied, colors.tolist(), strict=True):
            tree.updateNode(point, True, True)
            tree.setNodeColor(point, red, green, blue)
        tree.updateInnerOccupancy()
        tree.write(str(tmp_path / "theirs.ot"))

    def ours(n: int) -> None:
        write_class_octree(layers.occupancy, layers.semantics, tmp_path / "ours.ot", PALETTE)

    own, times = race(benchmark, ours, {"pyoctomap": leaf_by_leaf}, rounds=3, peer_every=3)
    size = (tmp_path / "ours.ot").stat().st_size
    table.add(case("coloured octree", len(occupied), f"occupied voxels, {size:,} bytes"), "–", own, times)


def test_cloud(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap) -> None:
    def write(n: int) -> bytes:
        return labelled_cloud(layers.semantics, layers.instances, PALETTE).ply()

    ours, _ = race(benchmark, write, {}, rounds=5)
    table.add(case("labelled cloud as PLY", layers.semantics.store.n_records, f"points, {len(write(0)):,} bytes"),
              "–", ours, {})  # fmt: skip


def test_questions(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap) -> None:
    points = np.random.default_rng(0).choice(layers.occupancy.occupied_centres(), 100_000)
    ours, _ = race(
        benchmark, lambda n: labels_at(points, layers.semantics, layers.occupancy, layers.instances), {}, rounds=10
    )
    table.add(case("class, instance and state", len(points), "points"), "–", ours, {})


def test_histogram(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap) -> None:
    middle = np.median(layers.occupancy.occupied_centres(), axis=0)
    box = aligned_box(middle - 1.0, middle + 1.0)
    ours, _ = race(benchmark, lambda n: class_histogram(box, layers.semantics, layers.occupancy), {}, rounds=10)
    table.add("class histogram of a box of 8 m³", "–", ours, {})


def test_cost(benchmark: BenchmarkFixture, table: Table, layers: LayeredMap) -> None:
    costs = CostTable({1: np.inf, 2: 0.0}, default=1.0)

    def anew(n: int) -> None:
        CostMap(layers.semantics, costs, band_m=(-0.1, 1.0), occupancy=layers.occupancy).update()

    ours, _ = race(benchmark, anew, {}, rounds=5)
    table.add("cost grid of all that was mapped", "–", ours, {})
