"""Signed distances and meshes from images, beside Open3D's voxel block grid: whole calls, from the depth image to the
updated map. Run with `make bench`.

Both keep distances up to four voxels and believe depth up to 5 m.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.mesh import IncrementalMesh
from mapping.tsdf import TsdfMap
from tests.support.building import CAMERA, CAMERA_RANGE_M, LOOP, N_IMAGES, DepthImage, rgbd_image, rgbd_images
from tests.support.open3d_grid import TRUNCATION_VOXELS, Grid
from tests.support.racing import Table, bytes_per_ms, race

OPEN3D = "Open3D VoxelBlockGrid"


def new_map(voxel_size_m: float) -> TsdfMap:
    return TsdfMap(voxel_size_m, TRUNCATION_VOXELS * voxel_size_m, CAMERA_RANGE_M)


def fuse(layer: TsdfMap, image: DepthImage) -> Any:
    return layer.integrate_image(image.depth, CAMERA, image.T_map_camera)


@pytest.mark.parametrize("voxel_size_m", [0.05, 0.02], ids=["5 cm", "2 cm"])
def test_an_image(benchmark: BenchmarkFixture, table: Table, voxel_size_m: float) -> None:
    images = rgbd_images(LOOP)
    layer, grid = new_map(voxel_size_m), Grid(voxel_size_m)
    touched = [len(fuse(layer, image)) for image in images]
    for image in images:
        grid.fuse(image)
    ours, theirs = race(
        benchmark,
        lambda n: fuse(layer, images[n % LOOP]),
        {OPEN3D: lambda n: grid.fuse(images[n % LOOP])},
        rounds=4 * LOOP,
    )
    bound = (2 * 8 * 512 * np.mean(touched) + images[0].depth.nbytes) / bytes_per_ms()
    case = f"TSDF 640 × 480, {100 * voxel_size_m:.0f} cm"
    table.add(case, "projective", ours, theirs, must_share=1.0, bound_ms=float(bound))


@pytest.mark.parametrize("put_together", [False, True], ids=["pieces", "put together"])
@pytest.mark.parametrize("again", [True, False], ids=["a room seen before", "new rooms"])
def test_mesh_after_one_more_image(benchmark: BenchmarkFixture, table: Table, again: bool, put_together: bool) -> None:
    """Every image is new to the map and has a structured-light camera's noise; only the mesh is timed."""
    layer, grid = new_map(0.05), Grid(0.05)
    for image in rgbd_images(LOOP):
        fuse(layer, image)
        grid.fuse(image)
    mesh = IncrementalMesh(layer)
    mesh.update()
    images = [rgbd_image(n, noisy=True) for n in (range(LOOP) if again else range(LOOP, N_IMAGES))]

    def follow(n: int) -> None:
        mesh.update()
        if put_together:
            mesh.mesh()

    def integrate(n: int) -> None:
        fuse(layer, images[n])
        grid.fuse(images[n])

    theirs = {f"{OPEN3D}, whole": lambda n: grid.mesh()}
    ours, times = race(benchmark, follow, theirs, rounds=len(images), peer_every=4, prepare=integrate)
    case = f"mesh 5 cm, one more image of {'a room seen before' if again else 'new rooms'}"
    mode = "incremental, put together" if put_together else "incremental, pieces"
    table.add(case, mode, ours, times, **({"must_share": 1.0} if put_together else {"must_ms": 8.0}))


def test_whole_mesh(benchmark: BenchmarkFixture, table: Table) -> None:
    layer, grid = new_map(0.05), Grid(0.05)
    for image in rgbd_images(N_IMAGES):
        fuse(layer, image)
        grid.fuse(image)
    ours, theirs = race(benchmark, lambda n: layer.mesh(), {OPEN3D: lambda n: grid.mesh()}, rounds=9)
    bound = 8 * 512 * layer.store.n_blocks / bytes_per_ms()
    table.add("mesh 5 cm, whole", "–", ours, theirs, must_share=1.0, bound_ms=bound)
    table.notes.append(
        f"mesh 5 cm: ours {len(layer.mesh().triangles)} triangles, Open3D {len(grid.mesh().triangle.indices)}"
    )
