"""What a depth camera and a rotating lidar would see of a home without any noise, by ray casting (Open3D, Embree)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics
from scenegraph.simulation.rays import RayScene
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home

CAMERA = CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)
RANGE_M = 6.0
_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])


@dataclass(frozen=True)
class Rendered:
    """A noise-free image from a true pose.

    depth     (H, W) float32 z [m]; 0 beyond the camera's range
    labels    (H, W) uint16 class ids
    entities  (H, W) int32: 1 … number of `Home.entities`, 0 for walls, floors and ceilings
    triangles (H, W) int32, index into the home's triangles, -1 where nothing was hit
    color     (H, W, 3) uint8
    """

    T_map_camera: SE3
    depth: Array
    labels: Array
    entities: Array
    triangles: Array
    color: Array


@dataclass(frozen=True)
class Lidar:
    """A rotating lidar: `rings` beams between two elevations [rad], each fired `columns` times a turn."""

    rings: int = 64
    columns: int = 1024
    lowest: float = -0.5236
    highest: float = 0.5236
    range_m: float = 20.0

    def directions(self) -> Array:
        """(rings · columns, 3) float32 unit vectors in the sensor frame (x forward, z up), from the lowest ring up."""
        elevation = np.linspace(self.lowest, self.highest, self.rings)[:, None]
        azimuth = np.linspace(-np.pi, np.pi, self.columns, endpoint=False)[None, :]
        flat = np.cos(elevation)
        rays = np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)
        return np.asarray(rays.reshape(-1, 3), dtype=np.float32)


class Renderer:
    """Looks at one home; `scene` holds all of its triangles, in the home's order."""

    def __init__(self, home: Home) -> None:
        self.scene = RayScene(home.vertices, home.triangles)
        self._labels = np.append(home.triangle_class, np.uint16(0))  # one more, for rays that hit nothing
        self._entities = np.append(home.triangle_entity, np.int32(0))
        corners = home.vertices[home.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        # the light turns with the home, so that opposite walls differ
        bright = 0.68 + 0.2 * np.abs(normals @ (home.T_map_home.rotation @ _LIGHT)) + 0.12 * np.abs(normals[:, 2])
        shaded = np.clip(home.triangle_color * bright[:, None], 0, 255).astype(np.uint8)
        self._colors = np.concatenate([shaded, np.zeros((1, 3), np.uint8)])
        self._rays: dict[CameraIntrinsics, Array] = {}

    def render(
        self, T_map_camera: SE3, camera: CameraIntrinsics = CAMERA, range_m: float = RANGE_M, *, colored: bool = True
    ) -> Rendered:
        """The image of a camera at its true pose (optical frame); `colored=False` leaves the colour black."""
        rays = self._rays.get(camera)
        if rays is None:
            rays = np.zeros((camera.height, camera.width, 6), dtype=np.float32)
            rays[..., 3:] = camera.rays()
            self._rays[camera] = rays
        here = np.empty_like(rays)
        here[..., :3] = T_map_camera.translation.astype(np.float32)
        np.matmul(rays[..., 3:], T_map_camera.rotation.T.astype(np.float32), out=here[..., 3:])
        distance, triangle = self.scene.first_hits(here)
        depth = np.where(distance > range_m, np.float32(0.0), distance)  # the rays have z = 1 in the optical frame
        color = self._colors[triangle] if colored else np.zeros((*depth.shape, 3), np.uint8)
        return Rendered(T_map_camera, depth, self._labels[triangle], self._entities[triangle], triangle, color)

    def sweep(self, T_map_sensor: SE3, lidar: Lidar) -> tuple[Array, Array, Array]:
        """One turn of a lidar: directions (N, 3) that hit within range, their distances (N,) [m] and triangles (N,)."""
        directions = lidar.directions()
        distance, triangle = self.scene.cast(T_map_sensor.translation, directions @ T_map_sensor.rotation.T)
        hit = (triangle >= 0) & (distance <= lidar.range_m)
        return directions[hit], distance[hit], triangle[hit]

    def classes_of(self, triangles: Array) -> Array:
        """Class ids (…) uint16 of triangles; 0 for -1."""
        return np.asarray(self._labels[triangles])

    def entities_of(self, triangles: Array) -> Array:
        """Entity numbers (…) int32 of triangles; 0 for -1."""
        return np.asarray(self._entities[triangles])
