"""Slow, obvious twins of the kernels that make surfaces from signed distances: dictionaries, one cube at a time."""

from __future__ import annotations

import numpy as np

from mapping.kernels.marching_cubes import EDGES, corner_offset, triangulate_case
from tests.naive_layers import Voxel, centre_of

Corner = tuple[float, float, float]


def triangles_of(values: dict[Voxel, float], voxel_size: float, max_jump: float) -> list[tuple[Corner, ...]]:
    """Marching cubes over the known voxels: each triangle as three points [m], from its lowest point on."""
    triangles = []
    for voxel in values:
        corners = [tuple(np.add(voxel, corner_offset(c))) for c in range(8)]
        if not all(corner in values for corner in corners):
            continue
        case = sum((values[corner] < 0.0) << c for c, corner in enumerate(corners))
        points = {}
        for edge in {edge for triangle in triangulate_case(case) for edge in triangle}:
            a, b = (corners[c] for c in EDGES[edge])
            if not abs(values[a] - values[b]) < max_jump:
                break
            share = values[a] / (values[a] - values[b])
            point = (1.0 - share) * centre_of(a, voxel_size) + share * centre_of(b, voxel_size)
            points[edge] = tuple(point.tolist())
        else:
            triangles += [tuple(points[edge] for edge in triangle) for triangle in triangulate_case(case)]
    return triangles
