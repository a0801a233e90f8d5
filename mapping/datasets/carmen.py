"""CARMEN logs of 2D lasers (`.clf`, `.log`, also `.bz2` and `.gz`): FLASER and ODOM lines, one message a line."""

from __future__ import annotations

import bz2
import gzip
import heapq
import math
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np

from mapping.datasets.dataset import Dataset, natural, seconds_to_ns
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import AgentPose, Scan

SUFFIXES = (".clf", ".clf.bz2", ".clf.gz", ".log", ".log.bz2", ".log.gz")
PARTLY_SORTED = 256
"""Lines are in the logger's order; within so many of them they are put in order of the robot's clock."""


class CarmenDataset(Dataset):
    """One log: FLASER → a `Scan` in the plane z = 0 of the laser, ODOM → an `AgentPose`.

    laser_height_m   height of the laser above the floor, which is z = 0 of the map [m]
    laser_max_m      longer readings met nothing; by default the log's `robot_front_laser_max`, at most 50 m
    odometry         False leaves the ODOM lines out

    A reading i of n stands at −90° + i·180°/n, or at −90° + i·180°/(n − 1) where n is odd. Raises `DatasetError`.
    """

    format = "carmen"
    title = "a CARMEN log"
    signs = "*.clf"
    default_voxel_size_m = 0.1
    max_range_m = 30.0

    def __init__(
        self,
        path: Path,
        *,
        laser_height_m: float = 0.3,
        laser_max_m: float | None = None,
        odometry: bool = True,
        robot: str = "robot",
        sensor: str = "laser",
    ) -> None:
        files = _files(path)
        if len(files) != 1:
            raise DatasetError(f"{path}: expected one log, got {', '.join(file.name for file in files) or 'none'}")
        super().__init__(files[0])
        if laser_max_m is not None and not 0.0 < laser_max_m < 1e3:
            raise InvalidParameter(f"laser_max_m: expected metres > 0, got {laser_max_m}")
        if not math.isfinite(laser_height_m):
            raise InvalidParameter(f"laser_height_m: expected metres, got {laser_height_m}")
        self._laser_height_m, self._odometry = laser_height_m, odometry
        self._robot, self._sensor = robot, sensor
        self._laser_max_m, self._len = laser_max_m or 50.0, 0
        for words in _lines(self.path):
            if words[:2] == ["PARAM", "robot_front_laser_max"] and laser_max_m is None:
                self._laser_max_m = min(self._laser_max_m, float(words[2]))
            self._len += words[0] == "FLASER" or (odometry and words[0] == "ODOM")
        if not self._len:
            raise DatasetError(f"{self.path}: no FLASER lines in it")

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        files = _files(path)
        if not files:
            return None
        if len(files) > 1:
            return [f"one log only: name the file ({', '.join(file.name for file in files[:5])})"]
        kinds = {words[0] for words in _lines(files[0], limit=2000)}
        if not kinds & {"FLASER", "ODOM", "PARAM"}:
            return None
        return [] if "FLASER" in kinds else ["FLASER lines (the scans with their poses)"]

    def __len__(self) -> int:
        return self._len

    def __iter__(self) -> Iterator[Scan | AgentPose]:
        self.skipped.clear()
        waiting: list[tuple[int, int, Scan | AgentPose]] = []
        order = count()
        for words in _lines(self.path):
            if words[0] == "FLASER":
                observation: Scan | AgentPose = self._scan(words)
            elif words[0] == "ODOM" and self._odometry:
                observation = self._agent_pose(words)
            else:
                continue
            heapq.heappush(waiting, (observation.stamp_ns, next(order), observation))
            if len(waiting) > PARTLY_SORTED:
                yield heapq.heappop(waiting)[2]
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _scan(self, words: list[str]) -> Scan:
        try:
            n = int(words[1])
            ranges = np.array(words[2 : 2 + n], dtype=np.float64)
            x, y, theta = (float(word) for word in words[2 + n : 5 + n])
            stamp_ns = seconds_to_ns(words[8 + n])
        except (ValueError, IndexError):
            raise self._damaged(words, "n, n readings, x y theta, odometry x y theta, time, host, time") from None
        angles = -np.pi / 2 + np.arange(n) * (np.pi / max(n - n % 2, 1))
        met = (ranges > 0.0) & (ranges < self._laser_max_m)
        self.skipped["readings that met nothing"] += int((~met).sum())
        points = np.zeros((int(met.sum()), 3), dtype=np.float32)
        points[:, 0] = (ranges * np.cos(angles))[met]
        points[:, 1] = (ranges * np.sin(angles))[met]
        return Scan(
            stamp_ns=stamp_ns,
            robot=self._robot,
            sensor=self._sensor,
            points=points,
            T_map_sensor=_planar(x, y, self._laser_height_m, theta),
        )

    def _agent_pose(self, words: list[str]) -> AgentPose:
        try:
            x, y, theta = (float(word) for word in words[1:4])
            stamp_ns = seconds_to_ns(words[7])
        except (ValueError, IndexError):
            raise self._damaged(words, "x y theta tv rv accel, time, host, time") from None
        return AgentPose(stamp_ns=stamp_ns, robot=self._robot, T_map_base=_planar(x, y, 0.0, theta))

    def _damaged(self, words: list[str], expected: str) -> DatasetError:
        return DatasetError(f"{self.path}: expected {words[0]} {expected}, got {' '.join(words)[:80]!r}")


def _planar(x: float, y: float, z: float, theta: float) -> SE3:
    c, s = math.cos(theta), math.sin(theta)
    return SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z]))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.name.lower().endswith(SUFFIXES) else []
    return sorted((file for file in path.glob("*") if file.name.lower().endswith(SUFFIXES[:3])), key=natural)


def _open(path: Path) -> IO[str]:
    if path.suffix == ".bz2":
        return bz2.open(path, "rt", encoding="ascii", errors="replace")
    if path.suffix == ".gz":
        return gzip.open(path, "rt", encoding="ascii", errors="replace")
    return path.open(encoding="ascii", errors="replace")


def _lines(path: Path, limit: int | None = None) -> Iterator[list[str]]:
    """The words of each line that has some; of the first `limit` lines."""
    try:
        with _open(path) as file:
            for number, line in enumerate(file):
                if limit is not None and number >= limit:
                    return
                if words := line.split():
                    yield words
    except (OSError, EOFError) as error:
        raise DatasetError(f"{path}: damaged or truncated ({error})") from None
