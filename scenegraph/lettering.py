"""Labels that do not cover each other: each is put where it belongs, or beside it with a line that leads there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Lettering"]

_GLYPH = 0.58  # mean width of a letter, of the font's size
_LINE = 1.22  # height of a line, of the font's size
_STEP = 7.0  # between rings of places that are tried, pixels
_RINGS = 14
_RAYS = 16


class Lettering:
    """The labels of one picture, (width, height) pixels; those placed first keep their places.

    pixels_per_point   of the fonts' sizes
    """

    def __init__(self, width: float, height: float, pixels_per_point: float) -> None:
        self._frame = np.array([width, height])
        self._pixels_per_point = pixels_per_point
        self._taken = np.empty((0, 4))

    def place(self, u: float, v: float, text: str, points: float) -> tuple[float, float]:
        """A free place near (u, v) for the middle of a label in a font of so many points; it is taken from now on.

        Where all is full it is the place with the least overlap.
        """
        lines = text.split("\n")
        size = points * self._pixels_per_point
        half = 0.5 * size * np.array([_GLYPH * max(map(len, lines)) + 0.4, _LINE * len(lines)])
        places = np.clip(np.array([u, v]) + _OFFSETS, half, np.maximum(self._frame - half, half))
        boxes = np.hstack([places - half, places + half])
        overlap = self._overlap(boxes)
        best = int(np.argmin(overlap))  # the first of equals, and that is the nearest
        self._taken = np.vstack([self._taken, boxes[best]])
        return float(places[best, 0]), float(places[best, 1])

    def _overlap(self, boxes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Area of each box (N, 4) that is taken already (N,)."""
        low = np.maximum(boxes[:, None, :2], self._taken[None, :, :2])
        high = np.minimum(boxes[:, None, 2:], self._taken[None, :, 2:])
        area: NDArray[np.float64] = np.prod(np.maximum(high - low, 0.0), axis=2).sum(axis=1)
        return area


def _rings() -> NDArray[np.float64]:
    rays = [(math.cos(a), math.sin(a)) for a in 2 * np.pi * np.arange(_RAYS) / _RAYS]
    offsets = [(0.0, 0.0)]
    for ring in range(1, _RINGS + 1):
        offsets += [(1.6 * ring * _STEP * x, ring * _STEP * y) for x, y in rays]  # labels are wider than high
    return np.array(offsets)


_OFFSETS = _rings()
