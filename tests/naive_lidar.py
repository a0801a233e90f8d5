"""Slow, obvious twins of the lidar and image kernels: one voxel, one beam, one point at a time."""

from __future__ import annotations

from itertools import pairwise, product
from math import asin, atan2, cos, floor, inf, isfinite, pi, sin, sqrt

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics
from mapping.sensors import LidarModel
from tests.naive_layers import Voxel, centre_of, voxel_of

UNSURE = 0.05
"""Share of a row or column: so near to a border, rounding may give the other one."""


def beam_of(point: np.ndarray, model: LidarModel) -> tuple[tuple[int, int] | None, bool, bool]:
    """(row, column) of the beam nearest to a point in the sensor frame, None outside the span; whether its row answers
    for the point; and whether rounding could not have changed either."""
    x, y, z = point
    elevation, azimuth = asin(z / sqrt(x * x + y * y + z * z)), atan2(y, x)
    step = model.span / model.columns
    e = model.elevations
    half = [abs(b - a) / 2 for a, b in pairwise(e)] or [step / 2]
    answers, sure = False, True
    for row in range(len(e)):
        above = min(half[max(row - 1, 0)], model.widest_gap / 2)
        below = min(half[min(row, len(half) - 1)], model.widest_gap / 2)
        narrow = UNSURE * min(above, below)
        answers = answers or e[row] - below <= elevation <= e[row] + above
        sure = sure and min(abs(elevation - e[row] + below), abs(elevation - e[row] - above)) > narrow
    row = min(range(len(e)), key=lambda r: abs(elevation - e[r]))
    around = [(azimuth - a + pi) % (2 * pi) - pi for a in model.azimuths]
    column = min(range(model.columns), key=lambda c: abs(around[c]))
    sure = sure and abs(abs(around[column]) - step / 2) > UNSURE * step
    return (None if abs(around[column]) > step / 2 else (row, column)), answers, sure


def direction_of(row: int, column: int, model: LidarModel) -> np.ndarray:
    elevation, azimuth = model.elevations[row], model.azimuths[column]
    return np.array([cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)])


def neighbours(row: int, column: int, model: LidarModel) -> list[tuple[int, int]]:
    """The pixel and those about it; the columns of a whole turn go round."""
    rows, columns = model.shape
    near = product(range(max(row - 1, 0), min(row + 2, rows)), range(column - 1, column + 2))
    return [(r, c % columns) for r, c in near if 0 <= c < columns or abs(model.span - 2 * pi) < 1e-9]


def reaches_of(ranges: np.ndarray, max_range: float) -> np.ndarray:
    """How far each beam saw free space."""
    return np.array([[min(float(r), max_range) if r > 0 else 0.0 for r in row] for row in ranges])


def bridged(reaches: np.ndarray, model: LidarModel) -> np.ndarray:
    """How far the beams saw free space, the gaps of single beams bridged."""
    result = reaches.copy()
    for pixel in map(tuple, np.argwhere(reaches == 0)):
        about = [float(reaches[p]) for p in neighbours(*pixel, model) if p != pixel]
        if sum(d == 0 for d in about) <= 1 and any(about):
            result[pixel] = min(d for d in about if d > 0)
    return result


def is_free(voxel: Voxel, reaches: np.ndarray, model: LidarModel, T: SE3, voxel_size: float) -> bool | None:
    """Whether the range image sees the voxel free, given how far its beams saw; None where rounding decides."""
    point = T.inverse() @ centre_of(voxel, voxel_size)
    r = float(np.linalg.norm(point))
    beam, answers, sure = beam_of(point, model)
    if not sure or r < 1e-6:
        return None
    if beam is None:
        return False
    reach = float(reaches[beam])
    aside = float(np.linalg.norm(np.cross(direction_of(*beam, model), point)))
    clear = min(float(reaches[p]) for p in neighbours(*beam, model))
    rounding = 0.02 * voxel_size + 2e-3 * r * model.span / model.columns
    if abs(aside - voxel_size / 2) < rounding or abs(r - reach) < 1e-4 or abs(r + 0.87 * voxel_size - clear) < 1e-4:
        return None
    return (r < reach and aside < voxel_size / 2) or (answers and r + 0.87 * voxel_size < clear)


def hits(ranges: np.ndarray, model: LidarModel, T: SE3, max_range: float, voxel_size: float) -> set[Voxel]:
    """The voxels that a beam ended in."""
    found = set()
    for row, column in np.argwhere((ranges > 0) & (ranges <= max_range)):
        found.add(voxel_of(T @ (float(ranges[row, column]) * direction_of(row, column, model)), voxel_size))
    return found


def range_image(points: np.ndarray, model: LidarModel) -> tuple[np.ndarray, np.ndarray]:
    """The nearest point of each beam."""
    ranges, index = np.full(model.shape, inf), np.full(model.shape, -1)
    for n, point in enumerate(points):
        r = float(np.linalg.norm(point))
        if r > 0 and isfinite(r):
            beam, answers, _ = beam_of(point, model)
            if beam is not None and answers and r <= ranges[beam]:
                ranges[beam], index[beam] = r, n
    return np.where(index < 0, 0.0, ranges), index


# -- images ----------------------------------------------------------------------------------------------------


def depth_image(points: np.ndarray, camera: CameraIntrinsics) -> tuple[np.ndarray, np.ndarray]:
    """The nearest point of each pixel."""
    shape = (camera.height, camera.width)
    depth, index = np.zeros(shape), np.full(shape, -1)
    for n, (x, y, z) in enumerate(points):
        if not (0 < z < inf and isfinite(x) and isfinite(y)):
            continue
        column, row = floor(camera.fx * x / z + camera.cx + 0.5), floor(camera.fy * y / z + camera.cy + 0.5)
        if (
            0 <= row < camera.height
            and 0 <= column < camera.width
            and (index[row, column] < 0 or z <= depth[row, column])
        ):
            depth[row, column], index[row, column] = z, n
    return depth, index
