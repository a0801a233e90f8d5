"""Slow, obvious twins of the kernels of points and surfels: dictionaries and loops, one point at a time."""

from __future__ import annotations

from math import ceil, floor, log, sqrt

import numpy as np

Voxel = tuple[int, int, int]
Place = tuple[int, int, int]
"""Where a point lies in its voxel, in steps of 1/65 536 of the edge."""

_ALL = (1 << 64) - 1


# -- points ----------------------------------------------------------------------------------------------------


def places_of(points: np.ndarray, voxel_size: float) -> list[tuple[Voxel, Place]]:
    """The voxel of each point and its place there, by way of float32 as the kernel goes."""
    scaled = points * (1.0 / voxel_size)
    found = []
    for row in scaled:
        voxel = tuple(floor(x) for x in row)
        inside = [float(np.float32(x - i)) for x, i in zip(row, voxel, strict=True)]
        found.append((voxel, tuple(min(int(65536.0 * x), 65535) for x in inside)))
    return found


def rank_of(place: Place) -> int:
    """The finaliser of splitmix64 over the 48 bits of a place, its lowest 16 bits."""
    x = place[0] << 32 | place[1] << 16 | place[2]
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & _ALL
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & _ALL
    return (x ^ (x >> 31)) & 0xFFFF


def kept_places(points: np.ndarray, voxel_size: float, max_points: int) -> dict[Voxel, list[Place]]:
    """What each voxel keeps of all points that ever came: of each cell that of the lowest rank, and of these the
    `max_points` lowest."""
    cells_along_edge = 2 ** max(ceil(log(max_points, 4)), 0)
    cells: dict[Voxel, dict[Place, Place]] = {}
    for voxel, place in places_of(points, voxel_size):
        of_voxel = cells.setdefault(voxel, {})
        cell = tuple(q * cells_along_edge // 65536 for q in place)
        of_voxel[cell] = min(place, of_voxel.get(cell, place), key=lambda p: (rank_of(p), p))
    return {
        voxel: sorted(of_voxel.values(), key=lambda p: (rank_of(p), p))[:max_points]
        for voxel, of_voxel in cells.items()
    }


def points_of(kept: dict[Voxel, list[Place]], voxel_size: float) -> np.ndarray:
    """(N, 3) [m]."""
    return np.array(
        [
            [(i + (q + 0.5) / 65536) * voxel_size for i, q in zip(v, p, strict=True)]
            for v, of in kept.items()
            for p in of
        ]
    ).reshape(-1, 3)


# -- surfels ---------------------------------------------------------------------------------------------------


def distributions(points: np.ndarray, voxel_size: float) -> dict[Voxel, tuple[int, np.ndarray, np.ndarray]]:
    """Number, mean [m] and covariance [m²] of the points of each voxel that holds two or more."""
    members: dict[Voxel, list[np.ndarray]] = {}
    for point in points:
        members.setdefault(tuple(floor(x) for x in point * (1.0 / voxel_size)), []).append(point)
    return {v: (len(p), np.mean(p, axis=0), np.cov(p, rowvar=False)) for v, p in members.items() if len(p) > 1}


def welford(points: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Number, mean and scatter of points, one at a time (Welford 1962)."""
    n, mean, scatter = 0, np.zeros(3), np.zeros((3, 3))
    for point in points:
        n += 1
        before = point - mean
        mean = mean + before / n
        scatter = scatter + np.outer(before, point - mean)
    return n, mean, scatter


def normal_of(covariance: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """The eigenvector of the smallest eigenvalue on the side of `towards`."""
    normal = np.linalg.eigh(covariance)[1][:, 0]
    return normal if normal @ towards >= 0.0 else -normal


def mahalanobis(point: np.ndarray, mean: np.ndarray, covariance: np.ndarray, flattest: float) -> float:
    """Distance in standard deviations, with eigenvalues raised to the share `flattest` of the largest."""
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, flattest * values[2])
    return sqrt(float((((point - mean) @ vectors) ** 2 / values).sum()))
