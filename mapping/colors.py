"""What colours a thing shows: a histogram of what was seen of it, and how alike two of them are.

After *Color indexing* (Swain and Ballard 1991): a thing is told by how much of each colour it shows, wherever on it, so
that views from any side can be compared. Cells are shares of red and green, which light and shade hardly change, and
brightness, coarsely.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.grid import read_only
from mapping.kernels.colors import CELLS, count_colors

__all__ = ["CELLS", "distance", "likeness", "no_colors", "piece_colors", "point_colors"]

Array: TypeAlias = NDArray[Any]

STEP = 2
"""Every so many-th row and column of an image tells the colours of things."""


def no_colors() -> NDArray[np.float32]:
    """The histogram (CELLS,) of what was seen without colour."""
    return np.zeros(CELLS, np.float32)


def piece_colors(pieces: Array, trust: Array, n: int, color: Array | None) -> NDArray[np.float32]:
    """The colours (n, CELLS) of the pieces 1 … n of an image, each row of sum 1; 0 where nothing is to be trusted, or
    the image has no colour.

    pieces (H, W) int32; trust (H, W) float32 in 0 … 1; color (H, W, 3) uint8
    """
    counts = np.zeros((n + 1, CELLS), np.float32)
    if color is not None:
        count_colors(counts, read_only(pieces), read_only(trust), read_only(np.ascontiguousarray(color)), STEP)
    total = counts.sum(axis=1, keepdims=True)
    return np.asarray(counts[1:] / np.where(total > 0.0, total, np.float32(1.0))[1:], np.float32)


def point_colors(owner: Array, n: int, shades: Array) -> NDArray[np.float32]:
    """The colours (n, CELLS) that single points of things 0 … n − 1 show: owner (k,) of each, shades (k, 3) uint8."""
    counts = np.zeros((n + 1, CELLS), np.float32)
    pieces = (np.asarray(owner, np.int32) + np.int32(1)).reshape(1, -1)
    trust = np.ones(pieces.shape, np.float32)
    count_colors(counts, read_only(pieces), read_only(trust), read_only(np.ascontiguousarray(shades)[None]), 1)
    return counts[1:]


def likeness(a: Array, b: Array) -> NDArray[np.float32]:
    """How alike colours (…, CELLS) of any sum are, 0 … 1: the Bhattacharyya coefficient; NaN where one is not known."""
    norm = np.sqrt(a.sum(axis=-1) * b.sum(axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(a * b).sum(axis=-1) / norm, np.float32)


def distance(a: Array, b: Array) -> NDArray[np.float32]:
    """How far apart colours (…, CELLS) of any sum are, 0 … ∞; NaN where one is not known.

    The root of the Bhattacharyya distance, −ln of `likeness`: of two normal distributions of one width it is how many
    widths (times √8) their means are apart.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        root_a, root_b = (np.sqrt(x / x.sum(axis=-1, keepdims=True)) for x in (a, b))
        apart = 0.5 * ((root_a - root_b) ** 2).sum(axis=-1)  # exactly 0 for the same
        return np.asarray(np.sqrt(-np.log1p(-np.minimum(apart, 1.0))), np.float32)
