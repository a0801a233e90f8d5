"""Meshes of a furnished building against its true surfaces, beside Open3D's of the same images."""

import numpy as np
import pytest

from mapping.tsdf import TsdfMap
from scenegraph.simulation.rays import RayScene
from tests.support.building import CAMERA, CAMERA_RANGE_M, LOOP, building, rgbd_image
from tests.support.open3d_grid import TRUNCATION_VOXELS, Grid


def surfaces_of(voxel_size_m: float, noisy: bool) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Vertices and triangles of our mesh and of Open3D's, of every third image of a turn round in a room."""
    layer = TsdfMap(voxel_size_m, TRUNCATION_VOXELS * voxel_size_m, CAMERA_RANGE_M)
    grid = Grid(voxel_size_m)
    for n in range(0, LOOP, 3):
        image = rgbd_image(n, noisy=noisy)
        layer.integrate_image(image.depth, CAMERA, image.T_map_camera)
        grid.fuse(image)
    mesh = layer.mesh()
    return (mesh.vertices, mesh.triangles), grid.surface()


def errors_of(vertices: np.ndarray, triangles: np.ndarray, near_m: float) -> tuple[np.ndarray, float]:
    """Distances (N,) [m] of the vertices from the true surface, and the share of what the camera truly saw that the
    mesh comes nearer to than `near_m`."""
    seen = [rgbd_image(n) for n in range(0, LOOP, 3)]
    truth = np.concatenate([(image.T_map_camera @ image.points)[::301] for image in seen])
    found = RayScene(vertices, triangles).distance(truth) < near_m
    return building().scene.distance(vertices[::20]), float(found.mean())


@pytest.mark.parametrize(("voxel_size_m", "noisy"), [(0.02, False), (0.02, True), (0.05, True)])
def test_the_mesh_lies_on_the_true_surfaces_at_least_as_well_as_open3ds(voxel_size_m, noisy):
    (ours, our_share), (theirs, their_share) = (errors_of(*s, voxel_size_m) for s in surfaces_of(voxel_size_m, noisy))
    print(f"\n{100 * voxel_size_m:.0f} cm, {'noisy' if noisy else 'noise-free'}: distance from the truth [mm]")
    for name, error, share in (("ours", ours, our_share), ("Open3D", theirs, their_share)):
        median, tenth = 1e3 * np.percentile(error, (50, 90))
        mean = 1e3 * error.mean()
        print(f"    {name}: median {median:.2f}, mean {mean:.2f}, 90 % below {tenth:.2f}; found {share:.2%}")
    if not noisy:
        assert np.median(ours) <= 0.003
    assert np.median(ours) <= np.median(theirs)
    assert ours.mean() <= 1.05 * theirs.mean()
    assert our_share >= their_share - 0.01
