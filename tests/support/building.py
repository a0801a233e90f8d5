"""A furnished building of eight rooms along a corridor, and what a lidar and a camera that walk through it measure.

It is as large as the one that the figures for other map libraries were taken in: 26 × 18.5 × 3 m, turned by 0.3 rad so
that no wall lies along the voxels; twenty scans at 5 cm know some ten million voxels. The furniture is that of
simulated homes. Everything is made from exact meshes by ray casting and is the same on every run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics
from mapping.sensors import LidarModel
from scenegraph.simulation import NoiseModel
from scenegraph.simulation.rays import RayScene
from tests.support.homes import home
from tests.support.rooms import LARGE_CAMERA, looking

CAMERA: CameraIntrinsics = LARGE_CAMERA
LIDAR = LidarModel.even(64, -np.deg2rad(22.5), np.deg2rad(22.5), 1024)
N_SCANS, N_IMAGES, LOOP = 20, 60, 24
"""`LOOP` images turn once round in the first room: the same again and again is a steady state."""
LIDAR_RANGE_M, CAMERA_RANGE_M = 20.0, 5.0
"""Farther surfaces are not measured [m, along the ray]."""

ROOMS, ROOM_X, ROOM_Y, CORRIDOR_Y, HEIGHT, WALL = 4, 6.5, 8.0, 2.2, 3.0, 0.15
"""Rooms on each side of the corridor; their size, its width, the height [m]."""
DOOR_X, DOOR_WIDTH, DOOR_HEIGHT = 5.4, 1.0, 2.1
"""Where a room's door is along its wall, and its size [m]."""
T_MAP_BUILDING = SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]) @ SE3(np.eye(3), (-13.0, -9.25, 0.013))
_LIGHT = np.array([0.36, 0.26, 0.9])


@dataclass(frozen=True)
class LidarScan:
    """One turn of the lidar. ranges (64, 1024) float32 [m], 0 where nothing was met; points (N, 3) float32 [m] in the
    sensor frame, those that met something, row by row."""

    ranges: np.ndarray
    points: np.ndarray
    T_map_sensor: SE3


@dataclass(frozen=True)
class DepthImage:
    """What the camera saw: depth (480, 640) float32 [m] or, with noise, uint16 [mm], 0 where nothing was measured;
    color (480, 640, 3) uint8."""

    depth: np.ndarray
    color: np.ndarray
    T_map_camera: SE3

    @property
    def depth_m(self) -> np.ndarray:
        """float32 [m]."""
        return self.depth if self.depth.dtype == np.float32 else self.depth * np.float32(0.001)

    @property
    def points(self) -> np.ndarray:
        """(N, 3) float32 [m] in the optical frame, of the pixels that measured something."""
        depth = self.depth_m
        return CAMERA.backproject(depth)[depth > 0.0]


@dataclass(frozen=True)
class Building:
    """Triangles (M, 3) over vertices (N, 3) [m, map] with a colour (M, 3) uint8 each, ready to be looked at."""

    vertices: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray
    scene: RayScene

    def sweep(self, T_map_sensor: SE3, noise_m: float, seed: int) -> LidarScan:
        """One turn of the lidar; distances with Gaussian noise [m]."""
        rays = LIDAR.rays()
        distance, _ = self.scene.cast(T_map_sensor.translation, rays @ T_map_sensor.rotation.T.astype(np.float32))
        if noise_m:
            distance = distance + np.float32(noise_m) * np.random.default_rng(seed).standard_normal(
                distance.shape, dtype=np.float32
            )
        ranges = np.where(distance < LIDAR_RANGE_M, distance, 0.0).astype(np.float32)
        return LidarScan(ranges, LIDAR.backproject(ranges)[ranges > 0.0], T_map_sensor)

    def image(self, T_map_camera: SE3, noise: NoiseModel | None, seed: int) -> DepthImage:
        """One image of the camera; `noise` makes it what a structured-light camera would report [mm]."""
        rays = CAMERA.rays()
        depth, triangle = self.scene.cast(T_map_camera.translation, rays @ T_map_camera.rotation.T.astype(np.float32))
        far = depth * np.linalg.norm(rays, axis=-1) > CAMERA_RANGE_M
        depth = np.where(far, np.float32(0.0), depth)
        seen = depth if noise is None else noise.depth_mm(depth, np.random.default_rng(seed))
        return DepthImage(seen, self.colors[triangle], T_map_camera)


@cache
def building() -> Building:
    """The building, made once."""
    parts = [_boxes(_structure() + _boards()), *_furniture()]
    offsets = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts[:-1])])
    vertices = np.concatenate([vertices for vertices, _, _ in parts])
    triangles = np.concatenate([triangles + n for (_, triangles, _), n in zip(parts, offsets, strict=True)])
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shade = 0.7 + 0.3 * np.abs(normals @ _LIGHT)
    colors = np.clip(np.concatenate([c for _, _, c in parts]) * shade[:, None], 0, 255).astype(np.uint8)
    vertices = (T_MAP_BUILDING @ vertices).astype(np.float32)
    black = np.zeros((1, 3), np.uint8)  # one more, for rays that meet nothing
    return Building(vertices, triangles, np.concatenate([colors, black]), RayScene(vertices, triangles))


@cache
def lidar_scan(n: int, noise_m: float = 0.0) -> LidarScan:
    """Scan `n` of `N_SCANS`, two in each room and four in the corridor."""
    return building().sweep(_lidar_poses()[n], noise_m, n)


@cache
def rgbd_image(n: int, *, noisy: bool = False) -> DepthImage:
    """Image `n` of `N_IMAGES`: round in one room (`LOOP` images), out through its door, and round in the next."""
    return building().image(_camera_poses()[n], NoiseModel() if noisy else None, n)


def lidar_scans(count: int = N_SCANS, noise_m: float = 0.0) -> list[LidarScan]:
    """The first scans, or all."""
    return [lidar_scan(n, noise_m) for n in range(count)]


def rgbd_images(count: int = N_IMAGES, *, noisy: bool = False) -> list[DepthImage]:
    """The first images, or all."""
    return [rgbd_image(n, noisy=noisy) for n in range(count)]


# -- where the sensors are -------------------------------------------------------------------------------------


def _room_corner(room: int) -> tuple[float, float]:
    """The corner of room 0 … 7 with the smallest x and y; even rooms lie on one side of the corridor."""
    return (room // 2) * ROOM_X, (room % 2) * (ROOM_Y + CORRIDOR_Y)


def _lidar_poses() -> list[SE3]:
    poses = []
    for room in range(2 * ROOMS):
        x, y = _room_corner(room)
        near = 1.5 if room % 2 else ROOM_Y - 1.5
        poses += [(x + DOOR_X, y + near), (x + DOOR_X - 0.2, y + ROOM_Y - near)]
        if room % 2:
            poses.append((x + 0.5 * ROOM_X, ROOM_Y + 0.5 * CORRIDOR_Y))
    rng = np.random.default_rng(7)
    level = zip(poses, rng.uniform(1.0, 1.5, len(poses)), rng.uniform(-1.0, 1.0, (len(poses), 3)), strict=True)
    turned = [SE3(np.eye(3), (x, y, z)) @ SE3.exp([0, 0, 0, *(turn * (0.05, 0.05, 3.0))]) for (x, y), z, turn in level]
    return [T_MAP_BUILDING @ pose for pose in turned]


def _camera_poses() -> list[SE3]:
    first, second = _room_corner(1), _room_corner(3)
    poses = []
    for n in range(LOOP):  # a turn to the left that begins and ends at the door
        angle = -0.5 * np.pi + 2.0 * np.pi * n / LOOP
        for x, y in (first, second):
            place = (x + DOOR_X - 0.9 + 0.4 * np.cos(angle), y + 3.2 + 1.2 * np.sin(angle), 1.3 + 0.15 * np.sin(3 * n))
            poses.append(looking(angle, 0.2 + 0.15 * np.cos(2.0 * n), place))
    rounds = [poses[0::2], poses[1::2]]
    corridor = []
    for n in range(N_IMAGES - 2 * LOOP):
        share = n / (N_IMAGES - 2 * LOOP - 1)
        x, y = first[0] + DOOR_X - 0.5 + share * ROOM_X, ROOM_Y + 0.5 * CORRIDOR_Y
        corridor.append(looking(-0.5 * np.pi + np.pi * share, 0.1, (x, y, 1.3)))
    return [T_MAP_BUILDING @ pose for pose in rounds[0] + corridor + rounds[1]]


# -- what stands there -----------------------------------------------------------------------------------------

Box = tuple[tuple[float, float, float], tuple[float, float, float], tuple[int, int, int]]
"""Lowest and highest corner [m, frame of the building] and colour."""
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], np.float64)
_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
_PLASTER, _WOOD, _WHITE = (190, 190, 180), (150, 120, 90), (235, 235, 235)


def _structure() -> list[Box]:
    """Floor, ceiling and walls with doorways."""
    length, depth = ROOMS * ROOM_X, 2 * ROOM_Y + CORRIDOR_Y
    found: list[Box] = [
        ((-0.3, -0.3, -0.2), (length + 0.3, depth + 0.3, 0.0), _WOOD),
        ((-0.3, -0.3, HEIGHT), (length + 0.3, depth + 0.3, HEIGHT + 0.2), _WHITE),
    ]

    def wall(x0: float, y0: float, x1: float, y1: float, z0: float = 0.0) -> None:
        found.append(((x0, y0, z0), (x1, y1, HEIGHT), _PLASTER))

    for y in (-0.3, depth):
        wall(-0.3, y, length + 0.3, y + 0.3)
    for x in (-0.3, length):
        wall(x, -0.3, x + 0.3, depth + 0.3)
    for room in range(2 * ROOMS):
        x, y = _room_corner(room)
        if x > 0.0:
            wall(x - 0.5 * WALL, y, x + 0.5 * WALL, y + ROOM_Y)
        y0 = ROOM_Y + CORRIDOR_Y if room % 2 else ROOM_Y - WALL
        a, b = x + DOOR_X - 0.5 * DOOR_WIDTH, x + DOOR_X + 0.5 * DOOR_WIDTH
        wall(x, y0, a, y0 + WALL)
        wall(a, y0, b, y0 + WALL, DOOR_HEIGHT)
        wall(b, y0, x + ROOM_X, y0 + WALL)
    return found


def _boards() -> list[Box]:
    """Along one wall of each room cupboards with a few boxes on top, and pictures above them."""
    rng = np.random.default_rng(3)
    found: list[Box] = []
    for room in range(2 * ROOMS):
        x, y = _room_corner(room)
        x1 = x + ROOM_X - 0.5 * WALL
        for k in range(3):
            y0, depth, height = y + 1.0 + 2.2 * k, rng.uniform(0.25, 0.5), rng.uniform(0.5, 1.0)
            wood = tuple(int(c) for c in rng.integers(60, 200, 3))
            found.append(((x1 - depth, y0, 0.0), (x1, y0 + rng.uniform(0.8, 1.4), height), wood))
            found.append(((x1 - 0.04, y0, 1.5), (x1, y0 + rng.uniform(0.4, 0.9), rng.uniform(1.8, 2.2)), wood[::-1]))
            for n in range(3):
                a, b = y0 + 0.25 * n, y0 + 0.25 * n + rng.uniform(0.08, 0.2)
                paint = tuple(int(c) for c in rng.integers(0, 256, 3))
                found.append(((x1 - 0.22, a, height), (x1 - 0.05, b, height + rng.uniform(0.05, 0.3)), paint))
    return found


def _boxes(boxes: list[Box]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and their colours."""
    low, high = np.array([b[0] for b in boxes]), np.array([b[1] for b in boxes])
    vertices = low[:, None] + _CORNERS * (high - low)[:, None]
    triangles = _FACES + 8 * np.arange(len(boxes))[:, None, None]
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3), np.repeat([b[2] for b in boxes], 12, axis=0)


def _furniture() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What stands in the rooms of three simulated homes: two of those rooms' things in each room of the building, and
    those of the hallways in the corridor."""
    slots: list[Callable[[np.ndarray, np.ndarray], np.ndarray]] = []
    for room in range(2 * ROOMS):
        x, y = _room_corner(room)
        inside = np.array([x + WALL, y + WALL, 0.0]), np.array([x + ROOM_X - WALL, y + ROOM_Y - WALL, 0.0])
        slots.append(lambda low, high, at=inside[0]: at - low)
        slots.append(lambda low, high, at=inside: np.array([at[0][0] - low[0], at[1][1] - high[1], 0.0]))
    corridor = [lambda low, high, at=x: np.array([at, ROOM_Y + 0.1, 0.0]) - low for x in (0.2, 12.8)]
    found = []
    for seed in (0, 1, 2):
        inverse = home(seed).T_map_home.inverse()
        for room in home(seed).rooms:
            free = corridor if room.kind == "hallway" else slots
            if not free:
                continue
            plan = inverse @ np.column_stack([room.footprint, np.full(len(room.footprint), room.floor_z)])
            shift = free.pop(0)(plan.min(axis=0), plan.max(axis=0)) * (1.0, 1.0, 0.0)
            shift[2] = -plan[0, 2]
            for thing in home(seed).objects:
                if thing.room == room.id:
                    found.append((inverse @ thing.vertices + shift, thing.triangles, thing.colors))  # noqa: PERF401
    return found
