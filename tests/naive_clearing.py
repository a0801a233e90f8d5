"""The slow, obvious twin of the kernel that looks for voxels that an image sees through."""

from __future__ import annotations

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics


def is_seen_through(
    point: np.ndarray, depth: np.ndarray, camera: CameraIntrinsics, T_map_camera: SE3, margin: float, share: float,
    around: int,
) -> bool:  # fmt: skip
    """Whether the five pixels about a point (3,) in map all measured something farther, by margin + share · z."""
    x, y, z = T_map_camera.inverse() @ point
    if z <= 0.0:
        return False
    u = int(np.floor(camera.fx * x / z + camera.cx + 0.5))
    v = int(np.floor(camera.fy * y / z + camera.cy + 0.5))
    for du, dv in ((0, 0), (-around, 0), (around, 0), (0, -around), (0, around)):
        column, row = u + du, v + dv
        if not (0 <= column < camera.width and 0 <= row < camera.height):
            return False
        if not depth[row, column] > z * (1.0 + share) + margin:
            return False
    return True
