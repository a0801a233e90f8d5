"""Meshes that rays can be cast at: the one place that talks to Open3D's ray casting (Embree)."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenegraph.simulation.shapes import Array


class RayScene:
    """A triangle mesh, (N, 3) and (M, 3), prepared for questions about rays and distances. It does not change."""

    def __init__(self, vertices: Array, triangles: Array) -> None:
        import open3d as o3d

        core: Any = o3d.core
        self._tensor = core.Tensor
        self._scene: Any = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._of(vertices), self._tensor(np.ascontiguousarray(triangles, dtype=np.uint32)))

    def _of(self, values: Array) -> Any:
        return self._tensor(np.ascontiguousarray(values, dtype=np.float32))

    def first_hits(self, rays: Array) -> tuple[Array, Array]:
        """Of rays (…, 6), origin and direction: the distance (…) in lengths of the direction (inf: nothing is hit),
        and the triangle (…) int32 that is hit (-1: none)."""
        hits = self._scene.cast_rays(self._of(rays))
        distance = hits["t_hit"].numpy()
        triangle = hits["primitive_ids"].numpy().view(np.int32)
        return distance, np.where(np.isfinite(distance), triangle, np.int32(-1))

    def cast(self, origins: Array, directions: Array) -> tuple[Array, Array]:
        """`first_hits` of rays from (n, 3) or (3,) along (n, 3) or (3,)."""
        origins, directions = np.broadcast_arrays(origins, directions)
        return self.first_hits(np.concatenate([origins, directions], axis=-1))

    def closest(self, points: Array) -> tuple[Array, Array]:
        """Of points (n, 3): the closest triangle (n,) int32 and its closest point (n, 3)."""
        if len(points) == 0:
            return np.zeros(0, dtype=np.int32), np.zeros((0, 3), dtype=np.float32)
        found = self._scene.compute_closest_points(self._of(points))
        return found["primitive_ids"].numpy().view(np.int32), found["points"].numpy()

    def distance(self, points: Array) -> Array:
        """Unsigned distance (n,) of points (n, 3) from the surface."""
        return np.asarray(self._scene.compute_distance(self._of(points)).numpy())
