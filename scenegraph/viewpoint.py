"""What a camera sees of a cloud of surface samples: a depth-buffered picture of small squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenegraph.errors import PictureError

__all__ = ["Colors", "Points", "Surface", "View", "rows"]

Points = NDArray[np.float64]
Colors = NDArray[np.uint8]

_BACKGROUND = np.array([250, 250, 248], np.uint8)
_MAX_POINTS = 2_000_000
_HEIGHT = 1200  # of a picture, pixels
_ASPECT = (0.7, 1.8)  # width of a picture, of its height


@dataclass(frozen=True, slots=True)
class Surface:
    """Coloured surface samples; normals are zero where they are not known."""

    points: Points
    colors: Colors
    normals: Points
    spacing_m: float

    @classmethod
    def of(cls, points: ArrayLike | None, colors: ArrayLike | None, normals: ArrayLike | None) -> Surface:
        """Checked samples: colours by height and no normals when left out, stray (not finite) ones dropped."""
        p = rows("points", np.empty((0, 3)) if points is None else points)
        n = np.zeros_like(p) if normals is None else rows("normals", normals)
        c = _by_height(p[:, 2]) if colors is None else _bytes(colors)
        for name, array in (("colors", c), ("normals", n)):
            if len(array) != len(p):
                raise PictureError(f"{name}: expected as many rows as points, {len(p)}, got {len(array)}")
        keep = np.isfinite(p).all(axis=1)
        if keep.sum() > _MAX_POINTS:
            keep &= np.random.default_rng(0).random(len(p)) < _MAX_POINTS / keep.sum()
        p, c, n = p[keep], c[keep], np.nan_to_num(n[keep])
        return cls(p, c, n, _spacing(p))

    def below(self, z: float) -> Surface:
        """The samples lower than `z` [m]."""
        keep = self.points[:, 2] < z
        return Surface(self.points[keep], self.colors[keep], self.normals[keep], self.spacing_m)


def rows(name: str, given: ArrayLike) -> Points:
    """`given` as (N, 3) float64, or PictureError."""
    array = np.asarray(given, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise PictureError(f"{name}: expected shape (N, 3), got {array.shape}")
    return array


def _bytes(colors: ArrayLike) -> Colors:
    array = np.asarray(colors)
    if array.ndim != 2 or array.shape[1] != 3:
        raise PictureError(f"colors: expected shape (N, 3), got {array.shape}")
    if array.dtype == np.uint8:
        return array
    return (np.clip(np.nan_to_num(array.astype(np.float64)), 0.0, 1.0) * 255).astype(np.uint8)


def _by_height(z: NDArray[np.float64]) -> Colors:
    """From blue-grey at the bottom to sand at the top."""
    known = z[np.isfinite(z)]
    low, high = np.percentile(known, [1, 99]) if len(known) else (0.0, 0.0)
    share = np.clip((np.nan_to_num(z) - low) / max(high - low, 1e-9), 0.0, 1.0)[:, None]
    colors: Colors = ((1 - share) * np.array([110, 130, 150]) + share * np.array([222, 205, 170])).astype(np.uint8)
    return colors


def _spacing(points: Points) -> float:
    """Typical distance between neighbouring samples [m]."""
    from scipy.spatial import cKDTree

    if len(points) < 8:
        return 0.05
    some = points[:: max(1, len(points) // 400)]
    distances, _ = cKDTree(points).query(some, k=5)
    return float(np.clip(np.median(distances[:, -1]), 0.005, 0.5))


@dataclass(frozen=True, slots=True)
class View:
    """A camera: map → picture. The rows of `rotation` are the picture's right, down and forward."""

    rotation: Points
    eye: Points
    scale: float
    offset: Points
    focal: bool  # perspective, else parallel
    width: int
    height: int

    @classmethod
    def from_above(cls, points: ArrayLike, height: int = _HEIGHT) -> View:
        """A parallel camera above points (N, 3): x to the right, y up."""
        p = rows("points", points)
        low, high = p.min(axis=0), p.max(axis=0)
        rotation = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
        return cls._fitted(rotation, np.array([*(low + high)[:2] / 2, high[2] + 1.0]), False, p, height)

    @classmethod
    def in_perspective(cls, points: ArrayLike, height: int = _HEIGHT) -> View:
        """A camera south-south-west of points (N, 3), looking down on them."""
        p = rows("points", points)
        low, high = p.min(axis=0), p.max(axis=0)
        azimuth, elevation = math.radians(-118.0), math.radians(52.0)
        back = np.array(
            [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
        )
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        rotation = np.array([right, np.cross(right, back), -back])
        eye = (low + high) / 2 + back * 1.6 * np.linalg.norm(high - low)
        return cls._fitted(rotation, eye, True, p, height)

    @classmethod
    def _fitted(cls, rotation: Points, eye: Points, focal: bool, points: Points, height: int) -> View:
        """The camera whose picture, so many pixels high, is just filled by the points; wide as it must be for that."""
        view = cls(rotation, eye, 1.0, np.zeros(2), focal, 1, 1)
        uv = view.project(points)[:, :2]
        low, high = uv.min(axis=0), uv.max(axis=0)
        size = np.maximum(high - low, 1e-3)
        aspect = float(np.clip(size[0] / size[1], *_ASPECT))
        frame = np.array([round(height * aspect), height])
        scale = 0.96 * float(np.min(frame / size))
        offset = frame / 2 - scale * (high + low) / 2
        return cls(rotation, eye, scale, offset, focal, int(frame[0]), height)

    def project(self, points: ArrayLike) -> Points:
        """(N, 3) map points → (N, 3): picture u, v and depth [m]."""
        camera = (np.asarray(points, dtype=np.float64) - self.eye) @ self.rotation.T
        uv = camera[:, :2] / camera[:, 2:] if self.focal else camera[:, :2]
        return np.column_stack([uv * self.scale + self.offset, camera[:, 2]])

    def splat(self, surface: Surface) -> NDArray[np.uint8]:
        """The surface as a picture (height, width, 3): each sample a small square, nearer ones over farther ones."""
        picture = np.broadcast_to(_BACKGROUND, (self.height, self.width, 3)).copy()
        if len(surface.points) == 0:
            return picture
        to_eye = self.eye - surface.points if self.focal else np.array([0.0, 0.0, 1.0])
        facing = np.sum(surface.normals * to_eye, axis=1)
        seen = facing >= 0
        uvz = self.project(surface.points[seen])
        shade = 0.72 + 0.28 * np.abs(surface.normals[seen] @ np.array([0.36, 0.48, 0.8]))
        shade[~surface.normals[seen].any(axis=1)] = 1.0
        colors = (surface.colors[seen] * shade[:, None]).astype(np.uint8)
        order = np.argsort(-uvz[:, 2], kind="stable")  # of several samples on one pixel the last, the nearest, stays
        uvz, colors = uvz[order], colors[order]
        depth = uvz[:, 2] if self.focal else np.ones(len(uvz))
        size = np.clip(np.ceil(1.3 * surface.spacing_m * self.scale / depth), 1, 9).astype(np.int64)
        column, row = (np.floor(uvz[:, :2].T - size / 2 + 0.5)).astype(np.int64)
        n = int(size.max(initial=0))
        flat = picture.reshape(-1, 3)
        nearest = np.full(self.height * self.width, -1, np.int64)
        for dy in range(n):
            for dx in range(n):
                u, v = column + dx, row + dy
                ok = (size > max(dx, dy)) & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
                rank = np.flatnonzero(ok)
                latest = np.full(len(nearest), -1, np.int64)
                latest[v[rank] * self.width + u[rank]] = rank
                np.maximum(nearest, latest, out=nearest)
        hit = nearest >= 0
        flat[hit] = colors[nearest[hit]]
        return picture
