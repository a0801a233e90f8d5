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
_RED, _GREEN, _BLUE, _COLORED, _FIRST_COLORED = 10, 11, 12, 13, 14
FRAME = 15
"""Numbers that `merge` keeps for each level."""


@njit(cache=True)
def open_root(frames: Array, file_children: Array) -> None:
    """Set up `frames` (DEPTH + 2, FRAME) int64 for `merge`, in place."""
    frames[:] = 0
    _open(frames[DEPTH], 0, 0, SEVERAL, -1, -1)
    if file_children.shape[0]:
        if file_children[0]:
            frames[DEPTH, _INNER], frames[DEPTH, _NEXT] = 0, 1
        else:
            frames[DEPTH, _LEAF] = 0


@njit(cache=True)
def _open(frame: Array, code: Int, own: Int, content: Int, inner: Int, leaf: Int) -> None:
    frame[:] = 0
    frame[_CODE], frame[_OWN], frame[_CONTENT] = code, own, content
    frame[_INNER], frame[_LEAF], frame[_NEXT] = inner, leaf, inner + 1
    frame[_SAME] = frame[_ALIKE] = 1


@njit(cache=True)
def _add_child(frame: Array, limits: Array, child: Int, leaf: Int, value: float, color: Array) -> None:
    """Count one finished child in its parent's frame."""
    colored = color[0] != WHITE or color[1] != WHITE or color[2] != WHITE
    if frame[_MASK] == 0:
        limits[0] = limits[1] = value
        frame[_FIRST_COLORED] = colored
    frame[_MASK] |= 1 << child
    frame[_ALIKE] = frame[_ALIKE] and leaf and value == limits[0]
    limits[1] = max(limits[1], value)
    if colored:
        frame[_RED] += color[0]
        frame[_GREEN] += color[1]
        frame[_BLUE] += color[2]
        frame[_COLORED] += 1


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
        frame = frames[level]
        child = frame[_CHILD]
        if child < 8:
            frame[_CHILD] += 1
            below = level - 1
            code = frame[_CODE] | child << 3 * below
            inner, leaf, content = np.int64(-1), frame[_LEAF], frame[_CONTENT]
            if frame[_INNER] >= 0 and file_children[frame[_INNER]] >> child & 1:
                if file_children[frame[_NEXT]]:
                    inner = frame[_NEXT]
                else:
                    leaf = frame[_NEXT]
                    frame[_NEXT] += 1
            if content == SEVERAL:
                if cell == codes.shape[0] or codes[cell] >= (code >> 9) + (np.int64(1) << 3 * (below - 3)):
                    content = UNKNOWN
                elif levels[cell] == below:
                    content = contents[cell]
                    cell += 1
            elif content >= ROW and below == 0:
                content = evidence[content - ROW, _VOXEL_OF_CODE[code & 511]]
            if content == UNKNOWN:
                if inner >= 0:
                    frame[_NEXT] = next_sibling(file_children, inner)
                frame[_SAME] = frame[_SAME] and inner < 0 and leaf < 0
            elif content < SEVERAL and inner < 0:
                children[at] = 0
                if leaf >= 0 and file_evidence[leaf] == content:
                    values[at] = file_values[leaf]
                else:
                    values[at] = value_of[content + 128]
                    frame[_SAME] = 0
                if colored:
                    colors[at] = WHITE
                    if leaf >= 0:
                        colors[at] = file_colors[leaf]
                _add_child(frame, limits[level], child, 1, values[at], colors[at if colored else 0])
                at += 1
            else:
                _open(frames[below], code, at, content, inner, leaf)
                level = below
                at += 1
            continue
        own, parent = frame[_OWN], frames[level + 1]
        if frame[_INNER] >= 0:
            parent[_NEXT] = frame[_NEXT]
        parent[_SAME] = parent[_SAME] and frame[_SAME]
        if frame[_MASK] == 0:
            at = own
        else:
            pruned = False
            if frame[_SAME]:
                source = frame[_INNER] if frame[_INNER] >= 0 else frame[_LEAF]
                pruned = frame[_INNER] < 0
                values[own] = file_values[source]
                if colored:
                    colors[own] = file_colors[source]
            else:
                pruned = frame[_MASK] == 255 and frame[_ALIKE]
                values[own] = limits[level, 1]
                if colored:
                    count = frame[_COLORED] if not pruned or frame[_FIRST_COLORED] else 0
                    colors[own] = WHITE
                    if count:
                        colors[own, 0] = frame[_RED] // count
                        colors[own, 1] = frame[_GREEN] // count
                        colors[own, 2] = frame[_BLUE] // count
            children[own] = 0 if pruned else frame[_MASK]
            if pruned:
                at = own + 1
            _add_child(parent, limits[level + 1], frame[_CODE] >> 3 * level & 7, pruned, values[own],
                       colors[own if colored else 0])  # fmt: skip
        level += 1
    cursor[0], cursor[1], cursor[2] = level, at, cell
    return True
