"""One tree from a map and the OctoMap file that it was read from: what did not change keeps the file's nodes."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.octrees import DEPTH, WHITE, next_sibling

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any

UNKNOWN = -128
"""Content of a cell that the map does not know; other evidence is above."""
SEVERAL = 128
"""Content of a cell that holds more than one cell of the map."""
ROW = 256
"""Content of a block whose voxels differ: ROW and its row of `evidence`."""

_VOXEL_OF_CODE = np.array(
    [
        sum((m >> 3 * b & 1) << 6 + b | (m >> 3 * b + 1 & 1) << 3 + b | (m >> 3 * b + 2 & 1) << b for b in range(3))
        for m in range(512)
    ]
)
"""(512,) the index in its block of the voxel with each Morton code."""

# What is kept of a node while its children are visited.
_CHILD, _CODE, _OWN, _CONTENT = 0, 1, 2, 3  # next child; Morton code of its cell; place in the output; content
_INNER, _LEAF, _NEXT = 4, 5, 6  # the file's node with children here, or its leaf over this cell; its next node
_SAME, _MASK, _ALIKE = 7, 8, 9  # nothing changed so far; children there are; all leaves of one value so far
_RED, _GREEN, _BLUE, _COLORED = 10, 11, 12, 13  # sums over the children that have a colour; which have
FRAME = 14
"""Numbers that `merge` keeps for each level."""


@njit(cache=True)
def open_root(frames: Array, file_children: Array) -> None:
    """Set up `frames` (DEPTH + 2, FRAME) int64 for `merge`, in place."""
    frames[:] = 0
    inner = leaf = np.int64(-1)
    if file_children.shape[0]:
        if file_children[0]:
            inner = np.int64(0)
        else:
            leaf = np.int64(0)
    _open(frames, DEPTH, 0, 0, SEVERAL, inner, leaf)


@njit(cache=True)
def _open(frames: Array, level: Int, code: Int, own: Int, content: Int, inner: Int, leaf: Int) -> None:
    for n in range(FRAME):
        frames[level, n] = 0
    frames[level, _CODE], frames[level, _OWN], frames[level, _CONTENT] = code, own, content
    frames[level, _INNER], frames[level, _LEAF], frames[level, _NEXT] = inner, leaf, inner + 1
    frames[level, _SAME] = frames[level, _ALIKE] = 1


@njit(cache=True)
def _add_child(frames: Array, limits: Array, level: Int, child: Int, leaf: Int, value: float) -> None:
    """Count one finished child in the frame of its parent at `level`."""
    if frames[level, _MASK] == 0:
        limits[level, 0] = limits[level, 1] = value
    elif value > limits[level, 1]:
        limits[level, 1] = value
    if not leaf or value != limits[level, 0]:
        frames[level, _ALIKE] = 0
    frames[level, _MASK] |= 1 << child


@njit(cache=True)
def _add_color(frames: Array, level: Int, child: Int, colors: Array, node: Int) -> None:
    """Add the colour of a finished child, if it has one, to the frame of its parent at `level`."""
    red, green, blue = np.int64(colors[node, 0]), np.int64(colors[node, 1]), np.int64(colors[node, 2])
    if red != WHITE or green != WHITE or blue != WHITE:
        frames[level, _RED] += red
        frames[level, _GREEN] += green
        frames[level, _BLUE] += blue
        frames[level, _COLORED] |= 1 << child


@njit(cache=True)
def merge(
    children: Array, values: Array, colors: Array, cursor: Array, frames: Array, limits: Array,
    codes: Array, levels: Array, contents: Array, evidence: Array, value_of: Array,
    file_children: Array, file_evidence: Array, file_values: Array, file_colors: Array,
) -> bool:  # fmt: skip
    """Write the tree of a map depth first, in place; False where there is no more room: call again with more.

    children, values : (m,) uint8, float32, and colors (m, 3) uint8 or (1, 3) for none: the tree that is written
    cursor           : (3,) int64: level, nodes written, cells read; begins as DEPTH, 1, 0
    frames, limits   : what is kept between the calls: (DEPTH + 2, FRAME) int64 of `open_root`, (DEPTH + 2, 2) float32
    codes, levels    : (c,) cells of the map that do not overlap: Morton code in blocks of 8³, ascending, and level ≥ 3
    contents         : (c,) int64, the cell's evidence, or ROW + r: its voxels have `evidence` (…, 512) int8 of row r
    value_of         : (256,) float32, log-odds of evidence −128 …
    file_…           : the nodes of the file, and the evidence (n,) int8 that the map got from each; (0,) for none

    A node below which the map still has what the file gave is written as the file has it. Others are made as OctoMap
    makes them: eight leaves of the same value become one, a node with children has the highest of their values and the
    mean of their colours.
    """
    colored = colors.shape[0] > 1
    level, at, cell = cursor[0], cursor[1], cursor[2]
    while level <= DEPTH:
        if at == children.shape[0]:
            cursor[0], cursor[1], cursor[2] = level, at, cell
            return False
        child = frames[level, _CHILD]
        if child < 8:
            frames[level, _CHILD] += 1
            below = level - 1
            code = frames[level, _CODE] | child << 3 * below
            inner, leaf, content = np.int64(-1), frames[level, _LEAF], frames[level, _CONTENT]
            if frames[level, _INNER] >= 0 and file_children[frames[level, _INNER]] >> child & 1:
                if file_children[frames[level, _NEXT]]:
                    inner = frames[level, _NEXT]
                else:
                    leaf = frames[level, _NEXT]
                    frames[level, _NEXT] += 1
            if content == SEVERAL:
                if cell == codes.shape[0] or codes[cell] >= (code >> 9) + (np.int64(1) << 3 * (below - 3)):
                    content = UNKNOWN
                elif levels[cell] == below:
                    content = contents[cell]
                    cell += 1
            elif content >= ROW and below == 0:
                content = np.int64(evidence[content - ROW, _VOXEL_OF_CODE[code & 511]])
            if content == UNKNOWN:
                if inner >= 0:
                    frames[level, _NEXT] = next_sibling(file_children, inner)
                if inner >= 0 or leaf >= 0:
                    frames[level, _SAME] = 0
            elif content < SEVERAL and inner < 0:
                children[at] = 0
                if leaf >= 0 and file_evidence[leaf] == content:
                    values[at] = file_values[leaf]
                else:
                    values[at] = value_of[content + 128]
                    frames[level, _SAME] = 0
                _add_child(frames, limits, level, child, 1, values[at])
                if colored:
                    for channel in range(3):
                        colors[at, channel] = file_colors[leaf, channel] if leaf >= 0 else WHITE
                    _add_color(frames, level, child, colors, at)
                at += 1
            else:
                _open(frames, below, code, at, content, inner, leaf)
                level = below
                at += 1
            continue
        own, inner, leaf = frames[level, _OWN], frames[level, _INNER], frames[level, _LEAF]
        same, mask = frames[level, _SAME], frames[level, _MASK]
        if inner >= 0:
            frames[level + 1, _NEXT] = frames[level, _NEXT]
        if not same:
            frames[level + 1, _SAME] = 0
        if mask == 0:
            at = own
        else:
            which = frames[level, _CODE] >> 3 * level & 7
            source = inner if inner >= 0 else leaf
            pruned = inner < 0 if same else mask == 255 and frames[level, _ALIKE] != 0
            values[own] = file_values[source] if same else limits[level, 1]
            children[own] = 0 if pruned else mask
            _add_child(frames, limits, level + 1, which, pruned, values[own])
            if colored:
                given = frames[level, _COLORED]
                if pruned and not given & 1:
                    given = 0
                count = (given & 1) + (given >> 1 & 1) + (given >> 2 & 1) + (given >> 3 & 1)
                count += (given >> 4 & 1) + (given >> 5 & 1) + (given >> 6 & 1) + (given >> 7)
                for channel in range(3):
                    mean = frames[level, _RED + channel] // count if count else WHITE
                    colors[own, channel] = file_colors[source, channel] if same else mean
                _add_color(frames, level + 1, which, colors, own)
            if pruned:
                at = own + 1
        level += 1
    cursor[0], cursor[1], cursor[2] = level, at, cell
    return True
