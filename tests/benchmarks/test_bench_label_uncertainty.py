"""Labels of an image from an uncertain pose: as published, with N drawn noises, beside the spread in closed form.

Run with `make bench`. A 640×480 image of a furnished room with 32 classes, every pixel labelled, voxels of 5 cm, the
robot 1.4 m from the origin of odom. Both use the diagonal of the covariance only, and the noise acts in odom, as
published. Times are from the cells of the image, as the paper's octomap has them, and from its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.geometry import SE3
from mapping.label_uncertainty import LabelEvidence, count_labels, sample_labels, spread_labels
from tests import naive_label_uncertainty as naive
from tests.support.racing import Table, bytes_per_ms, race
from tests.support.rooms import LARGE_CAMERA
from tests.support.scenes import Block, Scene, looking_at, shell

VOXEL = 0.05
N = 100
DEVIATIONS = np.array([0.04, 0.04, 0.01, 0.003, 0.003, 0.02])
"""x, y, z [m], roll, pitch, yaw [rad]: a well localised robot."""


@dataclass(frozen=True)
class Cloud:
    """Labelled points (N, 3) [m] in map, what each counts, and where localisation says that odom is."""

    points: np.ndarray
    labels: np.ndarray
    weights: np.ndarray
    T_map_odom: SE3

    def spread(self, covariance: np.ndarray) -> LabelEvidence:
        return spread_labels(self.points, self.labels, self.T_map_odom, covariance, VOXEL, weights=self.weights)

    def sample(self, covariance: np.ndarray, n: int, seed: int) -> LabelEvidence:
        return sample_labels(
            self.points, self.labels, self.T_map_odom, covariance, VOXEL, n_samples=n, seed=seed, weights=self.weights
        )


@cache
def pixels() -> Cloud:
    """Every pixel of the image."""
    rng = np.random.default_rng(0)
    blocks = shell((0.0, 0.0), (6.013, 5.017), 2.61)
    for n in range(29):
        size = rng.uniform(0.15, 0.7, 3)
        center = (rng.uniform(2.0, 5.6), rng.uniform(0.3, 4.7), rng.uniform(0.0, 1.2) + size[2] / 2)
        blocks.append(Block(f"thing{n}", center, tuple(size), n + 1, rng.uniform(0.0, 3.0)))
    T_map_camera = looking_at((0.4, 0.5, 1.3), (4.0, 3.0, 0.9))
    image = Scene(tuple(blocks)).image(T_map_camera, 0, camera=LARGE_CAMERA)
    seen = image.depth_m > 0.0
    points = T_map_camera @ LARGE_CAMERA.backproject(image.depth_m)[seen].astype(np.float64)
    assert image.labels is not None
    return Cloud(points, image.labels[seen], np.ones(len(points)), SE3.exp([-0.7, -0.4, 0.0, 0.0, 0.0, 0.3]))


@cache
def cells() -> Cloud:
    """The voxels of the image, each counting as much as the pixels in it."""
    image = pixels()
    counted = count_labels(image.points, image.labels, VOXEL)
    return Cloud(counted.centres, counted.labels, counted.evidence, image.T_map_odom)


@pytest.mark.parametrize("size", [1.0, 2.5], ids=["well localised", "badly localised"])
@pytest.mark.parametrize("make", [cells, pixels], ids=["cells", "pixels"])
def test_one_image(benchmark: BenchmarkFixture, table: Table, make: object, size: float) -> None:
    cloud: Cloud = make()  # type: ignore[operator]
    covariance = np.diag((size * DEVIATIONS) ** 2)
    ours, theirs = race(
        benchmark,
        lambda n: cloud.spread(covariance),
        {f"equation (5), N = {N}": lambda n: cloud.sample(covariance, N, n)},
        rounds=20,
        peer_every=4 if make is cells else 10,
    )
    mode = f"{len(cloud.points)} {'cells' if make is cells else 'pixels'}, ± {100 * size * DEVIATIONS[0]:.0f} cm"
    bound = cloud.points.nbytes / bytes_per_ms()
    table.add("labels from an uncertain pose", mode, ours, theirs, must_share=0.1, bound_ms=bound)


def test_both_are_the_same_within_the_sampling_error(benchmark: BenchmarkFixture, table: Table) -> None:
    covariance = np.diag(DEVIATIONS**2)
    spread = naive.as_tally(benchmark.pedantic(cells().spread, (covariance,), rounds=1))
    table.notes.append("evidence that lies in other voxels, as a share of all (total variation):")
    table.notes.append("  N     equation (5) to spread   by sampling alone (two runs, ÷ √2)")
    for n in (1, 10, 100, 1000, 4000):
        one, two = (naive.as_tally(cells().sample(covariance, n, seed)) for seed in (n, n + 1))
        off, by_chance = naive.distance(one, spread), naive.distance(one, two) / np.sqrt(2.0)
        table.notes.append(f"  {n:<5d} {off:.4f}                   {by_chance:.4f}")
    image = naive.distance(
        naive.as_tally(pixels().sample(covariance, N, 0)), naive.as_tally(pixels().spread(covariance))
    )
    table.notes.append(f"  from pixels, N = {N}: {image:.4f}")
    once = naive.as_tally(count_labels(cells().points, cells().labels, VOXEL, weights=cells().weights))
    table.notes.append(f"  direct projection, as if the pose were certain: {naive.distance(once, spread):.4f}")
