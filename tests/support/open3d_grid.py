"""Open3D's voxel block grid, set up as our signed distances are: the peer in accuracy and in speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.building import CAMERA, CAMERA_RANGE_M, DepthImage

TRUNCATION_VOXELS = 4.0


class Grid:
    """Blocks of 8³ voxels, distances and weights; the test is skipped where there is no Open3D."""

    def __init__(self, voxel_size_m: float) -> None:
        o3d = pytest.importorskip("open3d")
        core = o3d.core
        self.tensor, self.image, self.float64 = core.Tensor, o3d.t.geometry.Image, core.float64
        attributes = ("tsdf", "weight"), (core.float32, core.float32), ((1,), (1,))
        self.grid = o3d.t.geometry.VoxelBlockGrid(*attributes, voxel_size_m, 8, 20_000, core.Device("CPU:0"))
        matrix = np.array([[CAMERA.fx, 0.0, CAMERA.cx], [0.0, CAMERA.fy, CAMERA.cy], [0.0, 0.0, 1.0]])
        self.intrinsic = core.Tensor(matrix, core.float64)

    def fuse(self, image: DepthImage) -> None:
        depth = self.image(self.tensor(image.depth))
        scale = 1.0 if image.depth.dtype == np.float32 else 1000.0
        extrinsic = self.tensor(image.T_map_camera.inverse().matrix, self.float64)
        how = (self.intrinsic, extrinsic, scale, CAMERA_RANGE_M, TRUNCATION_VOXELS)
        self.grid.integrate(self.grid.compute_unique_block_coordinates(depth, *how), depth, *how)

    def mesh(self) -> Any:
        """As Open3D's tensor mesh, of all voxels that were ever seen."""
        return self.grid.extract_triangle_mesh(0.0)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """The mesh's vertices (N, 3) float32 [m] and triangles (M, 3)."""
        mesh = self.mesh()
        return mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()
