"""Redwood / Open3D RGB-D folders: `color/`, `depth/` (uint16 millimetres), `trajectory.log`, a camera file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mapping.datasets.dataset import Dataset, natural, read_color, read_depth, read_text
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import RgbdImage

COLOR_FOLDERS = ("color", "rgb", "image")
CAMERA_FILES = ("camera_primesense.json", "camera_intrinsic.json", "intrinsic.json", "camera.json")
PRIMESENSE = (525.0, 525.0, 319.5, 239.5)
"""Open3D's PinholeCameraIntrinsicParameters.PrimeSenseDefault, for a folder without a camera file."""

Up = Literal["auto", "x", "-x", "y", "-y", "z", "-z"]
UPRIGHT = 0.8
"""With `up="auto"`: an axis within 37° of the cameras' mean upward direction is up."""


class RedwoodDataset(Dataset):
    """One sequence, 30 images a second, since the format keeps no time.

    up                the axis of the recording that points up; the map is turned so that it becomes z. `auto`: z,
                      unless another axis is where the cameras, held upright on the whole, have their upper side
    depth_scale       units of the depth images a metre
    fx, fy, cx, cy    override the intrinsics of the camera file
    Raises `DatasetError`.
    """

    format = "redwood"
    title = "a Redwood RGB-D folder"
    signs = "depth/ with trajectory.log"
    default_voxel_size_m = 0.02
    max_range_m = 4.0

    def __init__(
        self,
        path: Path,
        *,
        up: Up = "auto",
        depth_scale: float = 1000.0,
        rate_hz: float = 30.0,
        fx: float | None = None,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        robot: str = "robot",
        sensor: str = "camera",
    ) -> None:
        super().__init__(path)
        for name, value in (("depth_scale", depth_scale), ("rate_hz", rate_hz)):
            if not 0.0 < value < 1e6:
                raise InvalidParameter(f"{name}: expected a number > 0, got {value}")
        if up not in get_args(Up):
            raise InvalidParameter(f"up: expected one of {', '.join(get_args(Up))}, got {up!r}")
        self._robot, self._sensor = robot, sensor
        self._depth_scale, self._period_ns = depth_scale, round(1e9 / rate_hz)
        self._camera = [
            given if given is not None else known for given, known in zip((fx, fy, cx, cy), _camera(path), strict=True)
        ]
        depth = _images(path / "depth")
        color = _colors(path, depth)
        poses = read_trajectory(path / "trajectory.log")
        T_map_world = _upright(up, [pose for _, pose in poses])
        self._images: list[tuple[int, Path, Path | None, SE3]] = []
        for index, T_world_camera in poses:
            if index < len(depth):
                self._images.append((index, depth[index], color[index], T_map_world @ T_world_camera))
            else:
                self.skipped["pose without an image"] += 1
        self.skipped["image without a pose"] = len(depth) - len(self._images)
        if not self._images:
            raise DatasetError(f"{path}: no image with depth and pose ({len(depth)} images, {len(poses)} poses)")

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        if not (path / "depth").is_dir():
            return None
        if not (path / "trajectory.log").is_file():
            if not any((path / name).is_dir() for name in COLOR_FOLDERS):
                return None
            return ["trajectory.log (the poses: three numbers, then a matrix (4, 4), for each image)"]
        return [] if _images(path / "depth") else ["depth/*.png"]

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[RgbdImage]:
        for index, depth_file, color_file, T_map_camera in self._images:
            depth = read_depth(depth_file)
            height, width = depth.shape
            fx, fy, cx, cy = self._camera
            yield RgbdImage(
                stamp_ns=index * self._period_ns,
                robot=self._robot,
                sensor=self._sensor,
                depth=depth if self._depth_scale == 1000.0 else depth / np.float32(self._depth_scale),
                intrinsics=CameraIntrinsics(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height),
                T_map_camera=T_map_camera,
                color=None if color_file is None else read_color(color_file),
            )


def _images(folder: Path) -> list[Path]:
    return sorted((file for file in folder.glob("*") if file.suffix.lower() in (".png", ".jpg", ".jpeg")), key=natural)


def _colors(path: Path, depth: list[Path]) -> list[Path | None]:
    """The colour image of each depth image: of the same name, or else of the same rank where there are as many."""
    for name in COLOR_FOLDERS:
        files = _images(path / name)
        by_stem = {file.stem: file for file in files}
        if files and all(file.stem in by_stem for file in depth):
            return [by_stem[file.stem] for file in depth]
        if files and len(files) == len(depth):
            return list(files)
    return [None] * len(depth)


def _camera(path: Path) -> tuple[float, float, float, float]:
    for name in CAMERA_FILES:
        file = path / name
        if file.is_file():
            try:
                fx, _, _, _, fy, _, cx, cy, _ = (float(v) for v in json.loads(read_text(file))["intrinsic_matrix"])
            except (ValueError, KeyError, TypeError) as error:
                raise DatasetError(f"{file}: expected intrinsic_matrix, 9 numbers by columns ({error})") from None
            return fx, fy, cx, cy
    return PRIMESENSE


def read_trajectory(path: Path) -> list[tuple[int, SE3]]:
    """A `.log` trajectory: the number of each image and its camera-to-world pose, in order of number."""
    numbers = read_text(path).split()
    if not numbers or len(numbers) % 19:
        raise DatasetError(
            f"{path}: truncated or not a trajectory: expected 19 numbers an image (3 and a matrix), got {len(numbers)}"
        )
    try:
        rows = np.array(numbers, dtype=np.float64).reshape(-1, 19)
    except ValueError as error:
        raise DatasetError(f"{path}: expected numbers ({error})") from None
    poses = []
    for row in rows:
        if row[0] < 0 or row[0] != int(row[0]):
            raise DatasetError(f"{path}: expected an image number ≥ 0, got {row[0]}")
        try:
            poses.append((int(row[0]), SE3.from_matrix(row[3:].reshape(4, 4))))
        except InvalidParameter as error:
            raise DatasetError(f"{path}, image {int(row[0])}: {error}") from None
    return sorted(poses, key=lambda pose: pose[0])


def _upright(up: Up, poses: list[SE3]) -> SE3:
    """T_map_world: the smallest turn that takes the up axis of the recording to z."""
    axes: dict[str, NDArray[Any]] = {}
    for i, name in enumerate("xyz"):
        axes[name], axes["-" + name] = np.eye(3)[i], -np.eye(3)[i]
    if up == "auto":
        camera_up = -np.mean([pose.rotation[:, 1] for pose in poses], axis=0)
        best = max(axes, key=lambda name: float(axes[name] @ camera_up))
        axis = axes[best] if axes[best] @ camera_up > UPRIGHT else axes["z"]
    else:
        axis = axes[up]
    z = axes["z"]
    if axis @ z < -0.5:
        return SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    turn = np.cross(axis, z)
    return SE3.exp(np.concatenate([np.zeros(3), turn * (np.pi / 2)]))
