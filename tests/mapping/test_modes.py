"""Two ways of mapping occupancy: `rays` says what OctoMap says, `projective` what `rays` says where both know.

The configurations are those that tests/benchmarks times. Every difference to OctoMap is counted and explained.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from mapping.datasets.opening import open_dataset
from mapping.kernels.occupancy import UNKNOWN
from mapping.occupancy import OccupancyMap
from mapping.octomap import read_octomap
from tests.support import modes
from tests.support.building import N_IMAGES, lidar_scans, rgbd_image, rgbd_images
from tests.support.modes import Beams, Configuration, beams_of
from tests.support.recordings import recording

ENOUGH = 0.999
GRAZE_M = 2e-5
"""OctoMap computes in single precision: 20 m are known to 2 µm, the steps of a walk to some more."""


def classes_of(*layers: OccupancyMap) -> tuple[np.ndarray, list[np.ndarray]]:
    """The voxel ijk (3,) of the first element, and dense classes of each map: 1 occupied, 0 free, −1 unknown."""
    blocks = np.concatenate([layer.block_ijk for layer in layers])
    first = blocks.min(axis=0) * 8
    nx, ny, nz = (int(n) for n in (blocks.max(axis=0) + 1) * 8 - first)
    dense = [layer.evidence_in(first, (nx, ny, nz)) for layer in layers]
    return first, [np.where(e == UNKNOWN, -1, e >= 0).astype(np.int8) for e in dense]


def beams_cast(configuration: Configuration, beams: Beams) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is cast, by definition: ends (N, 3) [m], whether they are hits, and whether single precision is sure of
    that beam."""
    size, reach = configuration.voxel_size_m, configuration.max_range_m
    ends, sure = beams.points_map, np.ones(len(beams.points), np.bool_)
    if configuration.discretize:
        border = np.abs(ends / size - np.rint(ends / size)).min(axis=1) * size < GRAZE_M
        around = [np.floor((ends + GRAZE_M * shift) / size) for shift in np.array([[0, 0, 0], *_CORNERS])]
        certain = {tuple(v) for v in around[0][~border].astype(int).tolist()}
        voxels = np.unique(np.concatenate(around), axis=0)
        sure = np.array([tuple(v) in certain for v in voxels.astype(int).tolist()])
        ends = (voxels + 0.5) * size
    lengths = np.linalg.norm(ends - beams.origin, axis=1)
    hit = lengths <= reach
    sure &= np.abs(lengths - reach) > GRAZE_M
    share = np.minimum(1.0, reach / np.maximum(lengths, 1e-12))[:, None]
    return beams.origin + share * (ends - beams.origin), hit, sure


_CORNERS = [[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]


def why(voxel: np.ndarray, configuration: Configuration, cast: list[tuple[np.ndarray, ...]]) -> str:
    """Why single precision and ours can differ in a voxel (3,). `cast`: origin, ends, hits, sure of each scan."""
    size = configuration.voxel_size_m
    low, high = voxel * size, (voxel + 1) * size
    marks = []
    for origin, ends, hits, sure in cast:
        outer = (ends > low - GRAZE_M).all(axis=1) & (ends < high + GRAZE_M).all(axis=1)
        inner = (ends > low + GRAZE_M).all(axis=1) & (ends < high - GRAZE_M).all(axis=1)
        if (inner & hits & sure).any():
            marks.append("hit")
            continue
        if (outer & hits).any():
            return "an end within 20 µm of a voxel's face"
        passed = _passes(origin, ends, low + GRAZE_M, high - GRAZE_M) & sure & ~outer
        grazed = _passes(origin, ends, low - GRAZE_M, high + GRAZE_M) & ~inner
        if not passed.any() and grazed.any():
            return "a beam within 20 µm of a voxel's edge" if sure[grazed].any() else "a beam whose end is on a face"
        marks += ["miss"] * bool(passed.any())
    layer = configuration.ours()
    exact = 0.0
    for mark in marks:
        change = np.log(modes.HIT / (1 - modes.HIT)) if mark == "hit" else np.log(modes.MISS / (1 - modes.MISS))
        bounds = [np.log(p / (1 - p)) for p in (modes.LOWEST, modes.HIGHEST)]
        exact = float(np.clip(exact + change, *bounds))
    return "evidence within a step of even odds" if abs(exact) < 2 * layer.log_odds_step else "unexplained"


def _passes(origin: np.ndarray, ends: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which of the beams (N,) pass the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - origin) / (ends - origin), (high - origin) / (ends - origin)
    near, far = np.minimum(to_low, to_high).max(axis=1), np.maximum(to_low, to_high).min(axis=1)
    return (near <= far) & (far >= 0.0) & (near <= 1.0)


def compare_with_octomap(name: str, configuration: Configuration, scans: list[Beams], folder: Path) -> None:
    """Fuse the scans with both, print how they differ and why: little, and never without a reason."""
    layer, tree = configuration.ours(), configuration.theirs()
    for beams in scans:
        configuration.cast(layer, beams)
        configuration.insert(tree, beams)
    tree.updateInnerOccupancy()
    tree.writeBinary(str(folder / "theirs.bt"))
    first, (ours, theirs) = classes_of(layer, read_octomap(folder / "theirs.bt"))
    known = int(((ours >= 0) | (theirs >= 0)).sum())
    differing = np.argwhere(ours != theirs)
    cast = [(beams.origin, *beams_cast(configuration, beams)) for beams in scans]
    reasons = Counter(why(first + voxel, configuration, cast) for voxel in differing[:200])
    kinds = Counter((_NAMES[ours[tuple(v)]], _NAMES[theirs[tuple(v)]]) for v in differing)
    same = 1.0 - len(differing) / known
    print(f"{name}, {configuration}: {known} voxels known, same class on {same:.4%}; {len(differing)} differ")
    for (mine, other), count in kinds.items():
        print(f"    {count} {mine}, OctoMap {other}")
    for reason, count in reasons.items():
        print(f"    {count} of {min(len(differing), 200)}: {reason}")
    assert same >= ENOUGH
    assert not reasons["unexplained"]


_NAMES = {1: "occupied", 0: "free", -1: "unknown"}


@pytest.mark.parametrize(
    ("configuration", "count"),
    [
        (modes.LIDAR_10CM, 4),
        (modes.LIDAR_10CM_DISCRETISED, 4),
        (modes.LIDAR_5CM, 2),
        (modes.LIDAR_5CM_DISCRETISED, 2),
    ],
    ids=str,
)
def test_rays_of_the_lidar_say_what_octomap_says(configuration, count, tmp_path):
    compare_with_octomap("lidar", configuration, beams_of(lidar_scans(count, 0.01)), tmp_path)


@pytest.mark.parametrize("configuration", [modes.RGBD_5CM, modes.RGBD_5CM_DISCRETISED], ids=str)
def test_rays_of_depth_images_say_what_octomap_says(configuration, tmp_path):
    compare_with_octomap("RGB-D", configuration, beams_of(rgbd_images(2)), tmp_path)


@pytest.mark.parametrize("discretize", [False, True], ids=["all beams", "discretised"])
@pytest.mark.parametrize("name", ["sim_structured", "sim_unstructured"])
def test_rays_of_recorded_scans_say_what_octomap_says(name, discretize, tmp_path):
    folder = recording(f"la3dm_sim_lidar_poses/{name}")
    scans = [Beams(scan.points, scan.T_map_sensor) for scan in open_dataset(folder) if hasattr(scan, "points")]
    compare_with_octomap(name, Configuration(0.1, 8.0, discretize), scans, tmp_path)


@pytest.mark.parametrize("noisy", [False, True], ids=["exact", "noisy"])
def test_images_projected_say_what_their_rays_say(noisy):
    projected, cast = modes.RGBD_5CM.ours(), modes.RGBD_5CM.ours()
    images = [rgbd_image(n, noisy=noisy) for n in range(0, N_IMAGES, 15)]
    for image, beams in zip(images, beams_of(images), strict=True):
        modes.project(projected, image)
        modes.RGBD_5CM.cast(cast, beams)
    compare_with_rays("RGB-D", projected, cast)


def compare_with_rays(name: str, projected: OccupancyMap, cast: OccupancyMap) -> None:
    """Print what `projective` knows more and less than `rays`; they must agree where both know."""
    _, (mine, other) = classes_of(projected, cast)
    both = (mine >= 0) & (other >= 0)
    same = float((mine == other)[both].mean())
    volume = cast.voxel_size_m**3
    more, less = ((mine >= 0) & (other < 0)).sum(), ((mine < 0) & (other >= 0)).sum()
    known = (other >= 0).sum()
    print(f"{name}, projective and rays: same class on {same:.4%} of {both.sum()} voxels known to both")
    print(f"    known to projective alone {more * volume:.3f} m³ ({more / known:.2%} of what rays know)")
    print(f"    known to rays alone {less * volume:.3f} m³ ({less / known:.2%})")
    assert same >= ENOUGH
