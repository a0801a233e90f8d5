"""A room that is simple enough to know every distance in it, seen by cameras and beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics

SMALL_CAMERA = CameraIntrinsics(fx=40.0, fy=40.0, cx=31.5, cy=23.5, width=64, height=48)
MIDDLE_CAMERA = CameraIntrinsics(fx=200.0, fy=200.0, cx=159.5, cy=119.5, width=320, height=240)
LARGE_CAMERA = CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)


@dataclass(frozen=True)
class Room:
    """The inside of a box about the origin with a ball in it. `distance` is its exact signed distance field."""

    half: tuple[float, float, float] = (2.013, 1.587, 1.217)
    ball: tuple[float, float, float] = (1.0, 0.1, -0.2)
    radius: float = 0.4

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Signed distance (N,) [m]: positive in the air, negative in walls and ball."""
        to_walls = (np.array(self.half) - np.abs(p)).min(axis=1)
        outside = np.linalg.norm(np.maximum(np.abs(p) - self.half, 0.0), axis=1)
        to_walls = np.where(to_walls < 0.0, -outside, to_walls)
        return np.minimum(to_walls, np.linalg.norm(p - self.ball, axis=1) - self.radius)

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Length (N,) [units of direction] of each ray (N, 3) from `origin` to the first surface."""
        with np.errstate(divide="ignore", invalid="ignore"):
            to_walls = np.where(
                directions > 0, (self.half - origin) / directions, (-np.array(self.half) - origin) / directions
            )
        walls = np.nanmin(np.where(directions == 0.0, np.inf, to_walls), axis=1)
        offset = origin - self.ball
        a = (directions**2).sum(axis=1)
        b = directions @ offset
        c = offset @ offset - self.radius**2
        root = b**2 - a * c
        ball = np.where(root >= 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
        return np.minimum(walls, np.where(ball > 0.0, ball, np.inf))

    def depth(self, T_map_camera: SE3, camera: CameraIntrinsics) -> np.ndarray:
        """The exact depth image (H, W) float32 [m]."""
        rays = camera.rays().reshape(-1, 3).astype(np.float64) @ T_map_camera.rotation.T
        return self.cast(T_map_camera.translation, rays).reshape(camera.height, camera.width).astype(np.float32)

    def scan(self, T_map_sensor: SE3, n: int, seed: int = 0) -> np.ndarray:
        """`n` surface points (n, 3) [m] in the sensor frame, in random directions."""
        directions = np.random.default_rng(seed).normal(size=(n, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return directions * self.cast(T_map_sensor.translation, directions @ T_map_sensor.rotation.T)[:, None]


def looking(yaw: float, pitch: float = 0.0, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SE3:
    """A camera (z forward, x right, y down) at `position` that looks along x, turned by yaw, then pitch."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turn = SE3.exp([0, 0, 0, 0, 0, yaw]) @ SE3.exp([0, 0, 0, 0, pitch, 0])
    return SE3(turn.rotation @ level, position)


TOUR = [
    looking(yaw, pitch, (0.3 * np.cos(yaw) - 0.5, 0.3 * np.sin(yaw), 0.1 * n % 0.3))
    for n, (yaw, pitch) in enumerate((y, p) for p in (0.0, 0.6, -0.6) for y in np.arange(0, 2 * np.pi, np.pi / 4))
]
"""Poses from which, together, the whole room is seen."""
