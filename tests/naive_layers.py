"""Slow, obvious twins of the layers' kernels: dictionaries and loops, one voxel at a time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import floor, inf, sqrt

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics

Voxel = tuple[int, int, int]


def voxel_of(point: np.ndarray, voxel_size: float) -> Voxel:
    return tuple(floor(x / voxel_size) for x in point)


def voxels_of_block(block: Voxel) -> Iterator[Voxel]:
    return ((8 * block[0] + i, 8 * block[1] + j, 8 * block[2] + k) for i, j, k in product(range(8), repeat=3))


def centre_of(voxel: Voxel, voxel_size: float) -> np.ndarray:
    return (np.array(voxel) + 0.5) * voxel_size


# -- occupancy -------------------------------------------------------------------------------------------------


def voxels_on_beam(origin: np.ndarray, end: np.ndarray, voxel_size: float) -> list[Voxel]:
    """The voxels of a segment from that of its origin to that of its end, in order (Amanatides & Woo 1987)."""
    length = float(np.linalg.norm(end - origin))
    at, last = list(voxel_of(origin, voxel_size)), list(voxel_of(end, voxel_size))
    passed = [tuple(at)]
    if at == last:
        return passed
    direction = (end - origin) / length
    step = [int(np.sign(d)) for d in direction]
    border = [((at[a] + (step[a] > 0)) * voxel_size - origin[a]) / direction[a] if step[a] else inf for a in range(3)]
    between = [voxel_size / abs(direction[a]) if step[a] else inf for a in range(3)]
    while at != last:
        if min(border) > length + 1e-9:
            at = last
        else:
            axis = min((2, 1, 0), key=lambda a: border[a])
            at = list(at)
            at[axis] += step[axis]
            border[axis] += between[axis]
        passed.append(tuple(at))
    return passed


def marks_of_beams(origin: np.ndarray, ends: np.ndarray, max_range: float, voxel_size: float) -> dict[Voxel, bool]:
    """What a scan says of each voxel it touches: hit (True) or passed (False). A hit outranks a pass."""
    marks: dict[Voxel, bool] = {}
    for end in ends:
        length = float(np.linalg.norm(end - origin))
        cut = length > max_range
        reached = origin + (end - origin) * (max_range / length) if cut else end
        beam = voxels_on_beam(origin, reached, voxel_size)
        for voxel in beam[:-1]:
            marks.setdefault(voxel, False)
        if not cut:
            marks[beam[-1]] = True
    return marks


def fold(evidence: dict[Voxel, int], marks: dict[Voxel, bool], hit: int, miss: int, low: int, high: int) -> None:
    """Update each marked voxel once."""
    for voxel, was_hit in marks.items():
        evidence[voxel] = min(max(evidence.get(voxel, 0) + (hit if was_hit else miss), low), high)


def means_of_beams(
    origin: np.ndarray, ends: np.ndarray, truncation: float, voxel_size: float
) -> dict[Voxel, tuple[float, float]]:
    """Mean signed distance along the beams and total weight of each voxel within the truncation of a beam's end."""
    sums: dict[Voxel, tuple[float, float]] = {}
    for end in ends:
        length = float(np.linalg.norm(end - origin))
        direction = (end - origin) / length
        first = origin + max(length - truncation, 0.0) * direction
        for voxel in voxels_on_beam(first, end + truncation * direction, voxel_size):
            distance = min(length - float((centre_of(voxel, voxel_size) - origin) @ direction), truncation)
            if distance > -truncation:
                gain = min(1.0, max(2.0 + distance / voxel_size, 0.02))
                total, weight = sums.get(voxel, (0.0, 0.0))
                sums[voxel] = total + gain * distance, weight + gain
    return {voxel: (total / weight, weight) for voxel, (total, weight) in sums.items()}


# -- images ----------------------------------------------------------------------------------------------------


def pixel_of(
    point: np.ndarray, T_map_camera: SE3, camera: CameraIntrinsics
) -> tuple[int, int, float, float, bool] | None:
    """(row, column, z, length of the ray per depth, whether rounding could not have changed the pixel)."""
    x, y, z = (point - T_map_camera.translation) @ T_map_camera.rotation
    if z <= 1e-4:
        return None
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    sure = all(abs(abs(c - round(c)) - 0.5) > 1e-3 for c in (u, v))
    row, column = floor(v + 0.5), floor(u + 0.5)
    if not (0 <= row < camera.height and 0 <= column < camera.width):
        return None if sure else (0, 0, z, 1.0, False)
    return row, column, z, sqrt(1.0 + (x / z) ** 2 + (y / z) ** 2), sure


def hits_of_image(depth: np.ndarray, T_map_camera: SE3, camera: CameraIntrinsics, voxel_size: float) -> set[Voxel]:
    points = T_map_camera @ camera.backproject(depth).reshape(-1, 3).astype(np.float64)[depth.ravel() > 0]
    return {voxel_of(p, voxel_size) for p in points}


def is_free(voxel: Voxel, depth: np.ndarray, T: SE3, camera: CameraIntrinsics, voxel_size: float) -> bool | None:
    """Whether the image sees the voxel's centre before its surface; None where rounding decides."""
    seen = pixel_of(centre_of(voxel, voxel_size), T, camera)
    if seen is None:
        return False
    row, column, z, _, sure = seen
    d = float(depth[row, column])
    if z > voxel_size * min(camera.fx, camera.fy) and d > 0:
        d -= 0.87 * voxel_size
    return (d > 0 and z < d) if sure and abs(z - d) > 1e-4 else None


def signed_distance(
    voxel: Voxel, depth: np.ndarray, T: SE3, camera: CameraIntrinsics, voxel_size: float
) -> tuple[float, bool]:
    """Along the ray from the voxel's centre to the surface, NaN where unseen; and whether rounding was no matter."""
    seen = pixel_of(centre_of(voxel, voxel_size), T, camera)
    if seen is None:
        return float("nan"), True
    row, column, z, stretch, sure = seen
    d = float(depth[row, column])
    return ((d - z) * stretch if d > 0 else float("nan")), sure


# -- distances -------------------------------------------------------------------------------------------------


def trilinear(values: dict[Voxel, float], point: np.ndarray, voxel_size: float) -> float:
    """Interpolation between the eight voxel centres about a point; NaN where one is unknown."""
    scaled = point / voxel_size - 0.5
    base = np.floor(scaled).astype(int)
    share = scaled - base
    total = 0.0
    for corner in product((0, 1), repeat=3):
        weight = np.prod([share[a] if corner[a] else 1.0 - share[a] for a in range(3)])
        total += weight * values.get(tuple(base + corner), float("nan"))
    return float(total)
