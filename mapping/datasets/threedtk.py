"""3DTK (slam6d) scan folders: `scanNNN.3d` with `scanNNN.frames` (registered) or `scanNNN.pose` (odometry).

3DTK counts in centimetres in a left-handed frame: x right, y up, z forward. Here metres, x forward, y left, z up
(REP-103): p = 0.01 · M · p_3dtk with M of determinant −1, and a pose is conjugated, T = M · T_3dtk · M⁻¹.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mapping.datasets.dataset import Dataset, natural, read_text
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import Scan

M = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
METRES = 0.01
INVALID_RANGE_M = 32.7
"""Rays that met nothing are stored at 3276 cm."""


class ThreeDtkDataset(Dataset):
    """Scans of one run, a second apart, since the format keeps no time.

    poses         `frames`: the result of registration; `odometry`: the robot's own estimate (`.pose`)
    min_range_m   nearer points are the robot's own and are left out
    Raises `DatasetError`.
    """

    format = "3dtk"
    title = "a folder of 3DTK scans"
    signs = "scan000.3d, … with .frames or .pose"
    default_voxel_size_m = 0.1  # beams half a degree apart: 9 cm at 10 m; with finer voxels walls fall to pieces
    max_range_m = 20.0

    def __init__(
        self,
        path: Path,
        *,
        poses: Literal["frames", "odometry"] = "frames",
        min_range_m: float = 0.3,
        robot: str = "robot",
        sensor: str = "lidar",
    ) -> None:
        super().__init__(path)
        if poses not in ("frames", "odometry"):
            raise InvalidParameter(f"poses: expected 'frames' or 'odometry', got {poses!r}")
        self._robot, self._sensor = robot, sensor
        self._poses, self._min_range_m = poses, min_range_m
        self._scans = sorted(path.glob("scan*.3d"), key=natural)
        suffix = ".frames" if poses == "frames" else ".pose"
        without = [file.with_suffix(suffix).name for file in self._scans if not file.with_suffix(suffix).is_file()]
        if without:
            other = "odometry" if poses == "frames" else "frames"
            has_other = all(f.with_suffix(".pose" if poses == "frames" else ".frames").is_file() for f in self._scans)
            raise DatasetError(
                f"{path}: {_some(without)} missing: the scans have no {poses} poses",
                hint=f"read it with poses={other!r} (--poses {other})" if has_other else None,
            )

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        scans = sorted(path.glob("scan*.3d"), key=natural) if path.is_dir() else []
        if not scans:
            return None
        if any(all(scan.with_suffix(poses).is_file() for scan in scans) for poses in (".frames", ".pose")):
            return []
        return [f"{_some([s.with_suffix('.frames').name for s in scans])} or .pose (the poses of the scans)"]

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        self.skipped.clear()
        for number, file in enumerate(self._scans):
            yield Scan(
                stamp_ns=number * 10**9,
                robot=self._robot,
                sensor=self._sensor,
                points=self._points(file),
                T_map_sensor=read_frames(file.with_suffix(".frames"))
                if self._poses == "frames"
                else read_pose(file.with_suffix(".pose")),
            )

    def _points(self, file: Path) -> NDArray[np.float32]:
        try:
            raw = np.loadtxt(file, usecols=(0, 1, 2), ndmin=2, dtype=np.float64)
        except (ValueError, OSError) as error:
            raise DatasetError(f"{file}: expected lines x y z ({error})") from None
        points = (raw @ M.T * METRES).astype(np.float32)
        distance = np.linalg.norm(points, axis=1)
        near, far = distance < self._min_range_m, ~(distance < INVALID_RANGE_M)
        self.skipped["points that met nothing (3276 cm)"] += int(far.sum())
        self.skipped[f"points nearer than {self._min_range_m} m"] += int(near.sum())
        return np.asarray(points[~near & ~far])


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _numbers(path: Path, text: str) -> NDArray[Any]:
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise DatasetError(f"{path}: expected numbers ({error})") from None


def _to_ros(path: Path, rotation: NDArray[Any], translation_cm: NDArray[Any]) -> SE3:
    try:
        return SE3(M @ rotation @ M.T, M @ translation_cm * METRES)
    except InvalidParameter as error:
        raise DatasetError(f"{path}: {error}") from None


def read_frames(path: Path) -> SE3:
    """The last line of a `.frames` file, the final pose: a column-major matrix (4, 4) and a type."""
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    values = _numbers(path, lines[-1]) if lines else np.zeros(0)
    if len(values) < 16:
        raise DatasetError(f"{path}: expected lines of 16 numbers and a type, got {len(values)} in the last")
    matrix = values[:16].reshape(4, 4).T
    return _to_ros(path, matrix[:3, :3], matrix[:3, 3])


def read_pose(path: Path) -> SE3:
    """A `.pose` file: x y z [cm], then Euler angles [degrees], R = Rx · Ry · Rz in 3DTK's frame (EulerToMatrix4)."""
    values = _numbers(path, read_text(path))
    if len(values) < 6:
        raise DatasetError(f"{path}: expected x y z and three angles, got {len(values)} numbers")
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(values[3:6])), np.cos(np.radians(values[3:6]))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return _to_ros(path, rx @ ry @ rz, values[:3])
