"""TUM RGB-D benchmark folders (Sturm et al., IROS 2012): `rgb/`, `depth/`, their lists, `groundtruth.txt`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.datasets.dataset import Dataset, read_color, read_depth, read_text, seconds_to_ns
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import RgbdImage

DEPTH_UNITS_PER_M = 5000.0
MAX_IMAGE_GAP_NS = 20_000_000
"""Colour and depth further apart than this are not of one image (as the benchmark's associate.py)."""

CAMERAS = {  # fx, fy, cx, cy of the benchmark's page; depth is registered to colour
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}


@dataclass(frozen=True)
class _Pair:
    stamp_ns: int
    depth: Path
    color: Path | None


class TumDataset(Dataset):
    """One sequence. Depth in metres as float32, poses interpolated at the stamp of the depth image.

    fx, fy, cx, cy    override the intrinsics, which are otherwise those of the camera that the folder's name tells
                      (`fr1`/`freiburg1` …), and freiburg1 by default
    max_pose_gap_s    images without a pose that near on both sides are skipped and counted

    `rgb.txt` and `depth.txt` are paired by time where there is no `associations.txt`. Raises `DatasetError`.
    """

    format = "tum"
    title = "a TUM RGB-D folder"
    signs = "depth.txt or associations.txt with groundtruth.txt"
    default_voxel_size_m = 0.02
    max_range_m = 4.0  # the noise of a Kinect grows with the square of depth: 3 cm at 4 m

    def __init__(
        self,
        path: Path,
        *,
        fx: float | None = None,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        max_pose_gap_s: float = 0.05,
        robot: str = "robot",
        sensor: str = "camera",
    ) -> None:
        super().__init__(path)
        self._robot, self._sensor = robot, sensor
        self._camera = [
            given if given is not None else known
            for given, known in zip((fx, fy, cx, cy), CAMERAS[_camera_of(self.name)], strict=True)
        ]
        if not 0.0 < max_pose_gap_s < 10.0:
            raise InvalidParameter(f"max_pose_gap_s: expected seconds in 0 … 10, got {max_pose_gap_s}")
        pose_stamps, poses = _trajectory(path / "groundtruth.txt")
        self._images: list[tuple[_Pair, SE3]] = []
        for pair in self._existing(_pairs(path)):
            pose = _pose_at(pose_stamps, poses, pair.stamp_ns, round(max_pose_gap_s * 1e9))
            if pose is None:
                self.skipped["no pose near the image"] += 1
            else:
                self._images.append((pair, pose))
        if not self._images:
            reasons = ", ".join(f"{reason}: {n}" for reason, n in self.skipped.items()) or "the lists are empty"
            raise DatasetError(f"{path}: no image with depth and pose ({reasons})")

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        lists = [name for name in ("associations.txt", "depth.txt") if (path / name).is_file()]
        if not lists and not ((path / "rgb").is_dir() and (path / "depth").is_dir()):
            return None
        missing = [] if lists else ["associations.txt or depth.txt (the list of depth images)"]
        if not (path / "groundtruth.txt").is_file():
            missing.append("groundtruth.txt (the poses: t tx ty tz qx qy qz qw)")
        return missing

    def _existing(self, pairs: list[_Pair]) -> Iterator[_Pair]:
        """A part of a sequence may come with the lists of the whole."""
        for pair in pairs:
            if pair.depth.is_file() and (pair.color is None or pair.color.is_file()):
                yield pair
            else:
                self.skipped["image file not in the folder"] += 1

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[RgbdImage]:
        for pair, T_map_camera in self._images:
            depth = read_depth(pair.depth)
            height, width = depth.shape
            fx, fy, cx, cy = self._camera
            yield RgbdImage(
                stamp_ns=pair.stamp_ns,
                robot=self._robot,
                sensor=self._sensor,
                depth=depth.astype(np.float32) / np.float32(DEPTH_UNITS_PER_M),
                intrinsics=CameraIntrinsics(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height),
                T_map_camera=T_map_camera,
                color=None if pair.color is None else read_color(pair.color),
            )


def _camera_of(name: str) -> str:
    for number in "123":
        if f"fr{number}" in name or f"freiburg{number}" in name:
            return f"freiburg{number}"
    return "freiburg1"


def _rows(path: Path, fields: int) -> list[list[str]]:
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = line.replace(",", " ").split()
        if len(row) < fields:
            raise DatasetError(f"{path}, line {number}: expected {fields} columns, got {len(row)}: {line[:60]!r}")
        rows.append(row)
    return rows


def _stamp(path: Path, text: str) -> int:
    try:
        return seconds_to_ns(text)
    except (ValueError, OverflowError):
        raise DatasetError(f"{path}: expected a time in seconds, got {text!r}") from None


def _pairs(folder: Path) -> list[_Pair]:
    """Depth images with their colour images, in order of time."""
    associations = folder / "associations.txt"
    if associations.is_file():
        pairs = []
        for t0, file0, t1, file1 in (row[:4] for row in _rows(associations, 4)):
            if file0.startswith("depth"):
                t0, file0, t1, file1 = t1, file1, t0, file0  # both orders are in use
            pairs.append(_Pair(_stamp(associations, t1), folder / file1, folder / file0))
        return sorted(pairs, key=lambda pair: pair.stamp_ns)
    depth = [(_stamp(folder / "depth.txt", t), folder / name) for t, name, *_ in _rows(folder / "depth.txt", 2)]
    if not (folder / "rgb.txt").is_file():
        return sorted((_Pair(stamp, file, None) for stamp, file in depth), key=lambda pair: pair.stamp_ns)
    color = [(_stamp(folder / "rgb.txt", t), folder / name) for t, name, *_ in _rows(folder / "rgb.txt", 2)]
    return associate(depth, color)


def associate(depth: list[tuple[int, Path]], color: list[tuple[int, Path]]) -> list[_Pair]:
    """Pair each depth image with at most one colour image, nearest in time first, at most 20 ms apart."""
    depth, color = sorted(depth), sorted(color)
    color_stamps = np.array([stamp for stamp, _ in color], dtype=np.int64)
    candidates: list[tuple[int, int, int]] = []
    for i, (stamp, _) in enumerate(depth):
        first, last = np.searchsorted(color_stamps, (stamp - MAX_IMAGE_GAP_NS, stamp + MAX_IMAGE_GAP_NS + 1))
        candidates += [(abs(color[j][0] - stamp), i, j) for j in range(int(first), int(last))]
    chosen: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in sorted(candidates):
        if i not in chosen and j not in taken:
            chosen[i] = j
            taken.add(j)
    return [_Pair(depth[i][0], depth[i][1], color[j][1]) for i, j in sorted(chosen.items())]


def _trajectory(path: Path) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Stamps (n,) [ns] and rows (n, 7) tx ty tz qx qy qz qw, in order of time."""
    rows = _rows(path, 8)
    if not rows:
        raise DatasetError(f"{path}: no poses in it")
    try:
        values = np.array([row[1:8] for row in rows], dtype=np.float64)
    except ValueError as error:
        raise DatasetError(f"{path}: expected numbers t tx ty tz qx qy qz qw ({error})") from None
    stamps = np.array([_stamp(path, row[0]) for row in rows], dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    return stamps[order], values[order]


def _pose_at(stamps: NDArray[np.int64], poses: NDArray[Any], stamp_ns: int, max_gap_ns: int) -> SE3 | None:
    """The pose interpolated at `stamp_ns`; None when there is none within `max_gap_ns` before and after."""
    after = int(np.searchsorted(stamps, stamp_ns))
    if after < len(stamps) and stamps[after] == stamp_ns:
        return _se3(poses[after])
    if after in (0, len(stamps)):
        return None
    before_ns, after_ns = int(stamps[after - 1]), int(stamps[after])
    if max(stamp_ns - before_ns, after_ns - stamp_ns) > max_gap_ns:
        return None
    share = (stamp_ns - before_ns) / (after_ns - before_ns)
    return _se3(poses[after - 1]).interpolate(_se3(poses[after]), share)


def _se3(row: NDArray[Any]) -> SE3:
    x, y, z, qx, qy, qz, qw = row
    return SE3.from_quaternion((qw, qx, qy, qz), (x, y, z))
