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
from mapping.kernels.colors import CELLS, CHROMA_STEP, DARK, LIGHT_STEP, count_colors, main_block

__all__ = [
    "CELLS",
    "color_name",
    "distance",
    "likeness",
    "main_color",
    "no_colors",
    "piece_colors",
    "point_colors",
]

Array: TypeAlias = NDArray[Any]

STEP = 2
"""Every so many-th row and column of an image tells the colours of things."""
MAIN_SHARE = 0.5
"""A thing has a colour when this much of what was seen of it has."""


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


def main_color(colors: Array) -> tuple[float, float, float] | None:
    """The colour red, green, blue [0 … 255] that most of a histogram (CELLS,) shows; None where no colour does.

    A colour is shared between the eight cells about it, so that their weighted mean is that colour again.
    """
    share, red, green, light = main_block(read_only(np.ascontiguousarray(colors, np.float32)))
    if share < MAIN_SHARE:
        return None
    brightness = 3.0 * DARK * 2.0 ** (LIGHT_STEP * light)
    shares = (red * CHROMA_STEP, green * CHROMA_STEP, 1.0 - (red + green) * CHROMA_STEP)
    r, g, b = (min(max(brightness * share - DARK, 0.0), 255.0) for share in shares)
    return r, g, b


def color_name(red: float, green: float, blue: float) -> str:
    """What people call a colour red, green, blue [0 … 255]: one of eleven basic terms and beige.

    The terms are those of *Basic color terms* (Berlin and Kay 1969); the borders are ours, and leave room for the shade
    indoors: white things are seen as bright as 150 and more.
    """
    most, least = max(red, green, blue), min(red, green, blue)
    chroma = most - least
    saturation = chroma / most if most > 0.0 else 0.0
    if most < 50.0 and chroma < 30.0:
        return "black"
    if saturation < 0.15 or chroma < 16.0:
        return "white" if most > 150.0 else "grey"
    if most == red:
        hue = 60.0 * ((green - blue) / chroma % 6.0)
    elif most == green:
        hue = 60.0 * ((blue - red) / chroma + 2.0)
    else:
        hue = 60.0 * ((red - green) / chroma + 4.0)
    if hue < 16.0 or hue >= 340.0:
        return "pink" if saturation < 0.45 and most > 140.0 else "red"
    if hue < 70.0:
        return _earthen(hue, saturation, most)
    return "green" if hue < 165.0 else "blue" if hue < 258.0 else "purple" if hue < 310.0 else "pink"


def _earthen(hue: float, saturation: float, most: float) -> str:
    """Between red and green in hue [degrees]: much of a home is of wood and cardboard."""
    if saturation < 0.4 and most > 130.0:
        return "beige"
    if hue >= 42.0:
        return "yellow" if saturation >= 0.5 else "brown"
    return "orange" if saturation >= 0.62 and most >= 140.0 else "brown"
