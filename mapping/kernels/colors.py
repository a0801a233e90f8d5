"""How much of each colour the pieces of an image show: histograms with soft cells, of what is to be trusted of them."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]

CHROMA_CELLS = 10
"""Cells along the share of red, and along that of green; each as wide as colours of one surface may differ."""
CHROMA_STEP = 0.1
LIGHT_CELLS = 4
"""Cells of brightness, each of LIGHT_STEP octaves: light and shade change it more than the shares."""
LIGHT_STEP = 1.6
DARK = 16.0
"""Added to each channel, so that the noise of dark pixels is no colour."""
CELLS = CHROMA_CELLS * CHROMA_CELLS * LIGHT_CELLS


@njit(cache=True)
def count_colors(counts: Array, pieces: Array, trust: Array, color: Array, step: int) -> None:
    """Count the pixels of each piece by colour, in place; each adds the fourth power of its trust.

    counts (n + 1, CELLS) float32, of pieces 0 … n; those of piece 0 stay as they are
    pieces (H, W) int32; trust (H, W) float32 in 0 … 1; color (H, W, 3) uint8
    step   every so many-th row and column is looked at

    A pixel is shared between the eight cells about its shares of red and green and its brightness (trilinear), so that
    nothing jumps where cells meet.
    """
    height, width = pieces.shape
    per_octave = 1.0 / (np.log(2.0) * LIGHT_STEP)
    for v in range(step // 2, height, step):
        for u in range(step // 2, width, step):
            piece = pieces[v, u]
            if piece <= 0 or trust[v, u] <= 0.0:
                continue
            worth = trust[v, u] * trust[v, u]
            worth *= worth
            red, green, blue = color[v, u, 0] + DARK, color[v, u, 1] + DARK, color[v, u, 2] + DARK
            total = red + green + blue
            x, y = red / total / CHROMA_STEP, green / total / CHROMA_STEP
            z = min(np.log(total / (3.0 * DARK)) * per_octave, LIGHT_CELLS - 1.001)
            i, j, k = int(x), int(y), int(z)
            x, y, z = x - i, y - j, z - k
            for a in range(2):
                for b in range(2):
                    for c in range(2):
                        share = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
                        cell = ((i + a) * CHROMA_CELLS + j + b) * LIGHT_CELLS + k + c
                        counts[piece, cell] += worth * share


@njit(cache=True)
def main_block(colors: Array) -> tuple[float, float, float, float]:
    """The 2 × 2 × 2 neighbouring cells of a histogram (CELLS,) that hold most: their share of all, and their mean share
    of red, of green and brightness, in cells. The share is 0 where nothing was counted."""
    total = 0.0
    for cell in range(len(colors)):
        total += colors[cell]
    most, best = 0.0, (0, 0, 0)
    for i in range(CHROMA_CELLS - 1):
        for j in range(CHROMA_CELLS - 1):
            for k in range(LIGHT_CELLS - 1):
                held = 0.0
                for a in range(2):
                    for b in range(2):
                        for c in range(2):
                            held += colors[((i + a) * CHROMA_CELLS + j + b) * LIGHT_CELLS + k + c]
                if held > most:
                    most, best = held, (i, j, k)
    if most <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    x, y, z = 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                part = colors[((best[0] + a) * CHROMA_CELLS + best[1] + b) * LIGHT_CELLS + best[2] + c] / most
                x += a * part
                y += b * part
                z += c * part
    return most / total, best[0] + x, best[1] + y, best[2] + z
