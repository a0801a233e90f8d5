"""Two ways of mapping occupancy: `rays` says what OctoMap says, `projective` what `rays` says where both know.

The configurations are those that tests/benchmarks times. Every difference to OctoMap is counted and explained.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.datasets.opening import open_dataset
from mapping.occupancy import OccupancyMap
from tests.support import modes
from tests.support.agreement import beams_cast, classes_of, why, with_octomap
from tests.support.building import N_IMAGES, building, lidar_scans, rgbd_image, rgbd_images
from tests.support.modes import Beams, Configuration, beams_of
from tests.support.recordings import recording

ENOUGH = 0.999


def compare_with_octomap(name: str, configuration: Configuration, scans: list[Beams], folder: Path) -> None:
    """Print how far they agree and why they do not; there must be a reason, and little of it."""
    found = with_octomap(configuration, scans, folder)
    print(f"{name}, {configuration}:", "\n".join(found.lines()))
    assert found.share >= ENOUGH
    assert not found.reasons["unexplained"]


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


@pytest.mark.parametrize("configuration", [modes.LIDAR_10CM, modes.LIDAR_10CM_DISCRETISED], ids=str)
def test_what_has_no_reason_is_not_explained_away(configuration):
    """Voxels that beams pass through their middle, or end in: were they to differ, it would be a fault."""
    [beams] = beams_of(lidar_scans(1))
    cast = [(beams.origin, *beams_cast(configuration, beams))]
    _, ends, _, sure = cast[0]
    for share in (0.5, 1.0):
        places = beams.origin + share * (ends[sure][::3001] - beams.origin)
        voxels = np.floor(places / configuration.voxel_size_m)
        inner = np.abs(places / configuration.voxel_size_m - voxels - 0.5).max(axis=1) < 0.4
        assert {why(voxel, configuration, cast) for voxel in voxels[inner]} == {"unexplained"}


@pytest.mark.parametrize("noisy", [False, True], ids=["exact", "noisy"])
def test_images_projected_say_what_their_rays_say(noisy):
    projected, cast = modes.RGBD_5CM.ours(), modes.RGBD_5CM.ours()
    images = [rgbd_image(n, noisy=noisy) for n in range(0, N_IMAGES, 15)]
    for image, beams in zip(images, beams_of(images), strict=True):
        modes.project(projected, image)
        modes.RGBD_5CM.cast(cast, beams)
    compare_with_rays("RGB-D", projected, cast)


@pytest.mark.parametrize("noise_m", [0.0, 0.01], ids=["exact", "noisy"])
def test_range_images_projected_say_what_their_rays_say(noise_m):
    projected, cast = modes.LIDAR_5CM.ours(), modes.LIDAR_5CM.ours()
    scans = lidar_scans(2, noise_m)
    for scan, beams in zip(scans, beams_of(scans), strict=True):
        modes.project_sweep(projected, scan)
        modes.LIDAR_5CM.cast(cast, beams)
    compare_with_rays("lidar", projected, cast)


def compare_with_rays(name: str, projected: OccupancyMap, cast: OccupancyMap) -> None:
    """Print what `projective` knows more and less than `rays`, and how true it is; they must agree where both know."""
    first, (mine, other) = classes_of(projected, cast)
    both = (mine >= 0) & (other >= 0)
    same = float((mine == other)[both].mean())
    volume = cast.voxel_size_m**3
    more, less = (mine >= 0) & (other < 0), (mine < 0) & (other >= 0)
    known = (other >= 0).sum()
    print(f"{name}, projective and rays: same class on {same:.4%} of {both.sum()} voxels known to both")
    print(f"    known to projective alone {more.sum() * volume:.3f} m³ ({more.sum() / known:.2%} of what rays know)")
    print(f"    known to rays alone {less.sum() * volume:.3f} m³ ({less.sum() / known:.2%})")
    for kind, where in (("projective alone", more & (mine == 0)), ("projective", mine == 0), ("rays", other == 0)):
        centres = (first + np.argwhere(where)[::10] + 0.5) * cast.voxel_size_m
        if len(centres):
            wrong = float((building().scene.distance(centres) < 0.5 * cast.voxel_size_m).mean())
            print(f"    free to {kind}: {wrong:.2%} of these voxels hold a true surface at their middle")
    assert same >= ENOUGH
