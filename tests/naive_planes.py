"""Slow, obvious twins of the plane and raster kernels, and surfaces made of rectangles to try planes on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely


def moments(points: Any, normals: Any) -> Any:
    p, n = np.asarray(points, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    scatter = p.T @ p
    upper = scatter[np.triu_indices(3)]
    return np.concatenate([[len(p)], p.sum(axis=0), upper, n.sum(axis=0)])


def fit(points: Any, normals: Any) -> tuple[Any, float, float]:
    """Normal, offset and rms of the least-squares plane, by singular values."""
    p = np.asarray(points, dtype=np.float64)
    centroid = p.mean(axis=0)
    _, values, axes = np.linalg.svd(p - centroid)
    normal = axes[2] if axes[2] @ np.sum(normals, axis=0) >= 0 else -axes[2]
    return normal, float(normal @ centroid), float(values[2] / np.sqrt(len(p)))


def match(points: Any, normals: Any, near: Any, planes: Any, tolerance: float, least_cosine: float) -> list[int]:
    """The nearest fitting plane of each sample; `near` its candidates, `planes` their (normal, offset)."""
    chosen = []
    for p, n, candidates in zip(points, normals, near, strict=True):
        best = (tolerance, -1)
        for k in candidates:
            normal, offset = planes[k]
            distance = abs(float(normal @ p) - offset)
            if float(normal @ n) >= least_cosine and distance < best[0]:
                best = (distance, k)
        chosen.append(best[1])
    return chosen


def counts(cells: Iterable[tuple[int, int]]) -> dict[tuple[int, int], int]:
    found: dict[tuple[int, int], int] = {}
    for cell in cells:
        found[cell] = found.get(cell, 0) + 1
    return found


def outline(mask: Any) -> Any:
    """The covered cells of a mask as one shape."""
    return shapely.union_all([shapely.box(u, v, u + 1, v + 1) for u, v in np.argwhere(mask)])


@dataclass(eq=False)
class Rectangle:
    """A rectangle that faces u × v: a corner (3,) and edges u, v (3,) [m]; holes are (u0, v0, u1, v1) [m]."""

    corner: Any
    u: Any
    v: Any
    holes: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def normal(self) -> Any:
        n = np.cross(self.u, self.v)
        return n / np.linalg.norm(n)

    @property
    def area(self) -> float:
        whole = float(np.linalg.norm(np.cross(self.u, self.v)))
        return whole - sum((c - a) * (d - b) for a, b, c, d in self.holes)

    def turned(self, yaw: float) -> Rectangle:
        c, s = np.cos(yaw), np.sin(yaw)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Rectangle(rotation @ self.corner, rotation @ self.u, rotation @ self.v, self.holes)

    def samples(self, spacing: float) -> Any:
        width, height = np.linalg.norm(self.u), np.linalg.norm(self.v)
        a, b = np.meshgrid(
            (np.arange(round(width / spacing)) + 0.5) * spacing, (np.arange(round(height / spacing)) + 0.5) * spacing
        )
        a, b = a.ravel(), b.ravel()
        keep = np.ones(len(a), dtype=bool)
        for u0, v0, u1, v1 in self.holes:
            keep &= ~((a > u0) & (a < u1) & (b > v0) & (b < v1))
        return self.corner + np.outer(a[keep] / width, self.u) + np.outer(b[keep] / height, self.v)


def box(low: Any, high: Any, inwards: bool = False) -> list[Rectangle]:
    """The six faces of an axis-aligned box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    x, y, z = np.diag([x1 - x0, y1 - y0, z1 - z0])
    lower, upper = np.array([x0, y0, z0], float), np.array([x1, y1, z1], float)
    outwards = [
        Rectangle(lower, y, x), Rectangle(upper, -x, -y), Rectangle(lower, x, z),
        Rectangle(upper, -z, -x), Rectangle(lower, z, y), Rectangle(upper, -y, -z),
    ]  # fmt: skip
    return [Rectangle(r.corner, r.v, r.u) for r in outwards] if inwards else outwards


@dataclass(eq=False)
class Soup:
    """Rectangles as a surface in blocks, one sample per 4 cm and some noise, as a signed distance map would give."""

    voxel_size_m: float = 0.05
    noise_m: float = 0.004
    seed: int = 0
    asked: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._parts: dict[Rectangle, tuple[Any, Any, Any]] = {}
        self._rows: dict[tuple[int, int, int], list[tuple[Rectangle, Any]]] = {}

    def add(self, rectangle: Rectangle) -> Any:
        """Put a rectangle there; returns the blocks (K, 3) that changed."""
        points = rectangle.samples(0.8 * self.voxel_size_m)
        normals = np.broadcast_to(rectangle.normal, points.shape) + 0.1 * self._rng.standard_normal(points.shape)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        points = points + self.noise_m * self._rng.standard_normal((len(points), 1)) * rectangle.normal
        blocks = np.floor(points / (8.0 * self.voxel_size_m)).astype(np.int32)
        self._parts[rectangle] = (points, normals, blocks)
        changed, block_of = np.unique(blocks, axis=0, return_inverse=True)
        order = np.argsort(block_of.reshape(-1), kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(block_of.reshape(-1)))[:-1])
        for key, rows in zip(map(tuple, changed.tolist()), parts, strict=True):
            self._rows.setdefault(key, []).append((rectangle, rows))
        return changed

    def add_all(self, rectangles: Iterable[Rectangle]) -> Any:
        return np.unique(np.concatenate([self.add(r) for r in rectangles]), axis=0)

    def remove(self, rectangle: Rectangle) -> Any:
        """Take a rectangle away; returns the blocks (K, 3) that changed."""
        _, _, blocks = self._parts.pop(rectangle)
        changed = np.unique(blocks, axis=0)
        for key in map(tuple, changed.tolist()):
            self._rows[key] = [entry for entry in self._rows[key] if entry[0] is not rectangle]
        return changed

    def surface(self, block_ijk: Any = None, /) -> tuple[Any, Any, Any]:
        self.asked.append(np.array(block_ijk))
        points, normals, owner = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, np.int64)]
        for k, key in enumerate(map(tuple, np.asarray(block_ijk).tolist())):
            for part, rows in self._rows.get(key, []):
                points.append(self._parts[part][0][rows])
                normals.append(self._parts[part][1][rows])
                owner.append(np.full(len(rows), k))
        return (
            np.concatenate(points).astype(np.float32),
            np.concatenate(normals).astype(np.float32),
            np.concatenate(owner),
        )
