"""Slow, obvious twins of the 2.5-D layers: dictionaries of cells, one height at a time."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from math import atan2, floor, hypot, inf, pi

import numpy as np

from mapping.geometry import SE3
from mapping.tiles import HeightNoise

Cell = tuple[int, int]


@dataclass(frozen=True)
class Measured:
    """A height [m] in a cell, its own variance [m²]."""

    height: float
    variance: float


def measured(
    p_sensor: np.ndarray, T: SE3, size: float, noise: HeightNoise, farthest: float = inf, above: float = inf
) -> dict[Cell, list[Measured]]:
    """What a scan measured in each cell."""
    cells: dict[Cell, list[Measured]] = defaultdict(list)
    for p in np.asarray(p_sensor, dtype=np.float64):
        x, y, z = T @ p
        rise, reach = z - T.translation[2], float(np.linalg.norm(p))
        if reach > farthest or rise > above:
            continue
        sine = rise / reach if reach else 1.0
        cosine_squared = max(1.0 - sine**2, 0.0)
        sigma = noise.range_sigma_m + noise.range_sigma_per_m * reach
        variance = (sigma * sine) ** 2 + (noise.beam_sigma_rad * reach) ** 2 * cosine_squared + noise.least_sigma_m**2
        cells[floor(x / size), floor(y / size)].append(Measured(z, variance))
    return cells


def variance_of_pose(cell: Cell, height: float, T: SE3, covariance: np.ndarray, size: float) -> float:
    """J·Σ·Jᵀ for a point at the cell's centre, J by moving the pose a little along each axis."""
    point = np.array([(cell[0] + 0.5) * size, (cell[1] + 0.5) * size, height])
    p_sensor = T.inverse() @ point
    step = 1e-6
    jacobian = np.array([((T @ SE3.exp(step * axis)) @ p_sensor - point)[2] / step for axis in np.eye(6)])
    return float(jacobian @ covariance @ jacobian)


def kalman(mean: float, variance: float, z: float, z_variance: float) -> tuple[float, float]:
    """One update of a height; an infinite variance knows nothing."""
    if variance == inf:
        return z, z_variance
    gain = variance / (variance + z_variance)
    return mean + gain * (z - mean), (1.0 - gain) * variance


def kalman_of(heights: list[Measured]) -> tuple[float, float]:
    """All heights of a scan in a cell, one after the other."""
    mean, variance = 0.0, inf
    for h in heights:
        mean, variance = kalman(mean, variance, h.height, h.variance)
    return mean, variance


# -- extended elevation map ------------------------------------------------------------------------------------


def intervals(heights: list[float], gap: float) -> list[list[float]]:
    """Sorted heights, cut where the next is more than `gap` higher."""
    groups: list[list[float]] = []
    for h in sorted(heights):
        if groups and h - groups[-1][-1] <= gap:
            groups[-1].append(h)
        else:
            groups.append([h])
    return groups


@dataclass(frozen=True)
class Part:
    """Heights that no gap separates."""

    low: float
    high: float
    mean: float
    sigma: float


def parts_of(heights: list[float], weights: list[float], gap: float) -> list[Part]:
    """The parts of all heights that a cell ever got, each with its weight."""
    z, w = np.array(heights), np.array(weights)
    parts = []
    for group in intervals(heights, gap):
        inside = (z >= group[0]) & (z <= group[-1])
        mean = float(np.average(z[inside], weights=w[inside]))
        sigma = float(np.sqrt(np.average((z[inside] - mean) ** 2, weights=w[inside])))
        parts.append(Part(group[0], group[-1], mean, sigma))
    return parts


# -- multi-level surface map -----------------------------------------------------------------------------------


@dataclass
class Patch:
    """A surface at `mean` [m] of `variance` [m²], solid for `depth` [m] below."""

    mean: float
    variance: float
    depth: float

    @property
    def bottom(self) -> float:
        return self.mean - self.depth

    def distance(self, z: float) -> float:
        return max(z - self.mean, self.bottom - z, 0.0)


def union(a: Patch, b: Patch) -> Patch:
    higher = b if b.mean > a.mean else a
    return Patch(higher.mean, higher.variance, higher.mean - min(a.bottom, b.bottom))


def update(patches: list[Patch], z: Patch, least_variance: float, most: int) -> list[Patch]:
    """The rules for one measurement z; `patches` ascend."""
    patches = [Patch(p.mean, p.variance, p.depth) for p in patches]
    nearest = min(patches, key=lambda p: p.distance(z.mean), default=None)
    if nearest and abs(z.mean - nearest.mean) <= 3.0 * nearest.variance**0.5:
        bottom = min(nearest.bottom, z.bottom)
        flat = nearest.depth == 0.0 and z.depth == 0.0
        nearest.mean, nearest.variance = kalman(nearest.mean, nearest.variance, z.mean, z.variance)
        nearest.variance = max(nearest.variance, least_variance)
        nearest.depth = 0.0 if flat else max(nearest.mean - bottom, 0.0)
    elif nearest and nearest.bottom <= z.mean <= nearest.mean:
        nearest.depth = max(nearest.depth, nearest.mean - z.bottom)
    else:
        patches.append(Patch(z.mean, max(z.variance, least_variance), z.depth))
    patches.sort(key=lambda p: p.mean)
    while len(patches) > 1:
        gaps = [upper.bottom - lower.mean for lower, upper in pairwise(patches)]
        n = int(np.argmin(gaps))
        if len(patches) <= most and gaps[n] > 0.0:
            break
        patches[n : n + 2] = [union(patches[n], patches[n + 1])]
    return patches


def measurements(heights: list[Measured], gap: float, thickness: float) -> list[Patch]:
    """What a scan says of a cell: a patch for each interval of its heights, lowest first."""
    found = []
    for group in intervals([h.height for h in heights], gap):
        inside = [h for h in heights if group[0] <= h.height <= group[-1]]
        if group[-1] - group[0] > thickness:
            variance = min(h.variance for h in inside if h.height == group[-1])
            found.append(Patch(group[-1], variance, group[-1] - group[0]))
        else:
            found.append(Patch(*kalman_of(inside), 0.0))
    return found


# -- traversability --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ground:
    """What is measured about one surface; NaN where it cannot be."""

    step: float
    slope: float
    roughness: float
    known: float


Surfaces = dict[Cell, list[tuple[float, float]]]
"""Top and bottom of the surfaces of each cell, lowest first."""


def met(surfaces: Surfaces, cell: Cell, z: float, headroom: float) -> float | None:
    """The height of the surface that a robot at height z meets in a cell."""
    candidates = [
        (max(z - top, bottom - z, 0.0), top) for top, bottom in surfaces.get(cell, []) if bottom <= z + headroom
    ]
    return min(candidates, key=lambda c: c[0])[1] if candidates else None


def ground(
    surfaces: Surfaces, cell: Cell, z: float, radius: float, size: float, headroom: float, reach: float, rise: float
) -> Ground:
    """Step, slope [rad] and roughness [m] about the surface at height z of a cell."""
    span = range(-max(1, int(radius / size)), max(1, int(radius / size)) + 1)
    disc = [(i, j) for i in span for j in span if hypot(i, j) * size <= radius + 1e-12 or max(abs(i), abs(j)) <= 1]
    step, points, known = 0.0, [], 0
    for i, j in disc:
        top = z if (i, j) == (0, 0) else met(surfaces, (cell[0] + i, cell[1] + j), z, headroom)
        if top is None:
            continue
        known += 1
        if max(abs(i), abs(j)) <= 1:
            step = max(step, abs(top - z))
        if abs(top - z) <= reach + rise * hypot(i, j) * size:
            points.append((i * size, j * size, top - z))
    slope = roughness = float("nan")
    p = np.array(points)
    design = np.c_[p[:, :2], np.ones(len(p))]
    if np.linalg.matrix_rank(design, tol=1e-6) == 3:
        plane = np.linalg.lstsq(design, p[:, 2], rcond=None)[0]
        slope = float(np.arctan(np.hypot(*plane[:2])))
        roughness = float(np.sqrt(np.mean((design @ plane - p[:, 2]) ** 2)))
    return Ground(step, slope, roughness, known / len(disc))


# -- labels by gradient ----------------------------------------------------------------------------------------


def gradient(before: tuple[float, float], after: tuple[float, float]) -> float:
    """The angle of the way between two points (distance over ground, height) of a sweep, in [−π/2, 3π/2)."""
    angle = atan2(after[1] - before[1], after[0] - before[0])
    return angle + 2.0 * pi if angle < -0.5 * pi else angle


def label_of(angle: float, tau: float) -> int:
    return 0 if angle < tau else 1 if angle <= pi - tau else 2


def labels_of_sweep(sweep: list[tuple[float, float]], k: int, baseline: float, tau: float) -> list[int]:
    """0 floor, 1 object, 2 ceiling, −1 unknown for points (distance over ground, height) from bottom to top."""
    labels = []
    for j, point in enumerate(sweep):
        below = [p for p in sweep[: max(j - k + 1, 0)] if hypot(p[0] - point[0], p[1] - point[1]) >= baseline]
        above = [p for p in sweep[j + k :] if hypot(p[0] - point[0], p[1] - point[1]) >= baseline]
        if below:
            labels.append(label_of(gradient(below[-1], point), tau))
        elif above:
            labels.append(label_of(gradient(point, above[0]), tau))
        else:
            labels.append(-1)
    return labels
