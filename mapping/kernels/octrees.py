"""OctoMap's node streams: depth first, children in the order of their index (bit 0: x, bit 1: y, bit 2: z).

In `.bt` files a node is 16 bits, two for each child: FREE, OCCUPIED, INNER, or 0 where there is none. In `.ot` files it
is a float32 log-odds, a colour where the tree has them, and a byte that says which children follow.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any

DEPTH = 16
"""Levels of an OctoMap tree: keys have 16 bits."""
ORIGIN = 1 << (DEPTH - 1)
"""The key of voxel 0."""
FREE, OCCUPIED, INNER = 1, 2, 3
BLOCK_NODES = 1 + 8 + 64
"""Most inner nodes that a block of 8³ voxels can need."""


@njit(cache=True)
def read_binary(words: Array, corners: Array, levels: Array, occupied: Array) -> tuple[Int, Int]:
    """Read the leaves of a `.bt` stream, in place.

    words    : (n,) uint16, the inner nodes
    corners  : (m, 3) int32, the lowest voxel of each leaf; levels (m,) int8, its edge is 2^level voxels; occupied (m,)
    Returns (leaves, words read); words read is −1 where the stream ends early or goes deeper than 16 levels.
    """
    stack = np.empty((8 * DEPTH + 1, 4), np.int64)
    stack[0, 0] = stack[0, 1] = stack[0, 2] = -ORIGIN
    stack[0, 3] = DEPTH
    top = 1
    at = 0
    count = 0
    while top > 0:
        top -= 1
        i, j, k, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if at >= words.shape[0] or level == 0:
            return count, -1
        word = np.int64(words[at])
        at += 1
        half = np.int64(1) << (level - 1)
        for child in range(8):
            code = word >> (2 * child) & 3
            if code in (FREE, OCCUPIED):
                corners[count, 0] = i + half * (child & 1)
                corners[count, 1] = j + half * (child >> 1 & 1)
                corners[count, 2] = k + half * (child >> 2)
                levels[count] = level - 1
                occupied[count] = code == OCCUPIED
                count += 1
        for child in range(7, -1, -1):
            if word >> (2 * child) & 3 == INNER:
                stack[top, 0] = i + half * (child & 1)
                stack[top, 1] = j + half * (child >> 1 & 1)
                stack[top, 2] = k + half * (child >> 2)
                stack[top, 3] = level - 1
                top += 1
    return count, at


@njit(cache=True)
def read_full(stream: Array, node_bytes: Int, corners: Array, levels: Array, offsets: Array) -> tuple[Int, Int, Int]:
    """Find the leaves of an `.ot` stream (n,) uint8 whose nodes have `node_bytes` of content, in place.

    offsets : (m,) int64, where in the stream each leaf's content begins; corners and levels as in `read_binary`
    Returns (leaves, nodes, bytes read); bytes read is −1 where the stream ends early or goes deeper than 16 levels.
    """
    stack = np.empty((8 * DEPTH + 1, 4), np.int64)
    stack[0, 0] = stack[0, 1] = stack[0, 2] = -ORIGIN
    stack[0, 3] = DEPTH
    top = 1
    at = 0
    count = 0
    nodes = 0
    while top > 0:
        top -= 1
        i, j, k, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if at + node_bytes >= stream.shape[0]:
            return count, nodes, -1
        children = np.int64(stream[at + node_bytes])
        nodes += 1
        if children == 0:
            if count == levels.shape[0]:
                return count, nodes, -1
            corners[count, 0] = i
            corners[count, 1] = j
            corners[count, 2] = k
            levels[count] = level
            offsets[count] = at
            count += 1
        elif level == 0:
            return count, nodes, -1
        at += node_bytes + 1
        half = np.int64(1) << max(level - 1, 0)
        for child in range(7, -1, -1):
            if children >> child & 1:
                stack[top, 0] = i + half * (child & 1)
                stack[top, 1] = j + half * (child >> 1 & 1)
                stack[top, 2] = k + half * (child >> 2)
                stack[top, 3] = level - 1
                top += 1
    return count, nodes, at


@njit(cache=True)
def list_leaf_blocks(corners: Array, levels: Array, blocks: Array) -> Int:
    """List the 8³ blocks that the leaves meet, leaf by leaf; fills blocks (n, 3) int32 as far as there is room.

    Repeats of the same block by leaves that follow each other are left out. Returns how many there are.
    """
    count = 0
    last_i, last_j, last_k = np.int64(1 << 40), np.int64(0), np.int64(0)
    for n in range(corners.shape[0]):
        span = np.int64(1) << max(levels[n] - 3, 0)
        bi, bj, bk = np.int64(corners[n, 0]) >> 3, np.int64(corners[n, 1]) >> 3, np.int64(corners[n, 2]) >> 3
        if span == 1 and bi == last_i and bj == last_j and bk == last_k:
            continue
        last_i, last_j, last_k = bi, bj, bk
        if count + span**3 > blocks.shape[0]:
            count += span**3
            continue
        for i in range(span):
            for j in range(span):
                for k in range(span):
                    blocks[count, 0] = bi + i
                    blocks[count, 1] = bj + j
                    blocks[count, 2] = bk + k
                    count += 1
    return count


@njit(cache=True)
def fill_leaves(evidence: Array, corners: Array, levels: Array, values: Array, slots: Array) -> None:
    """Write each leaf's value (n,) int8 into its voxels of `evidence` (capacity, 512), in place.

    slots : the slots of the blocks that `list_leaf_blocks` listed, in that order
    """
    at = -1
    last_i, last_j, last_k = np.int64(1 << 40), np.int64(0), np.int64(0)
    for n in range(corners.shape[0]):
        i, j, k = np.int64(corners[n, 0]), np.int64(corners[n, 1]), np.int64(corners[n, 2])
        span = np.int64(1) << max(levels[n] - 3, 0)
        repeated = span == 1 and i >> 3 == last_i and j >> 3 == last_j and k >> 3 == last_k
        last_i, last_j, last_k = i >> 3, j >> 3, k >> 3
        if not repeated:
            at += 1
        if levels[n] >= 3:
            for block in range(at, at + span**3):
                evidence[slots[block], :] = values[n]
            at += span**3 - 1
            continue
        edge = np.int64(1) << levels[n]
        for a in range(i & 7, (i & 7) + edge):
            for b in range(j & 7, (j & 7) + edge):
                for c in range(k & 7, (k & 7) + edge):
                    evidence[slots[at], a << 6 | b << 3 | c] = values[n]


@njit(cache=True)
def join_children(codes: Array, first: Int) -> tuple[Int, Int]:
    """(word, code) of the node above the eight codes from `first` on; code 0, FREE, OCCUPIED where it can be pruned."""
    word: Int = 0
    alike = True
    for child in range(8):
        code = np.int64(codes[first + child])
        word |= code << (2 * child)
        alike = alike and code == codes[first]
    if alike and codes[first] != INNER:
        return 0, np.int64(codes[first])
    return word, np.int64(INNER)


@njit(cache=True)
def encode_blocks(evidence: Array, slots: Array, unknown: Int, words: Array, lengths: Array, codes: Array) -> None:
    """Encode each block of `slots` (n,) as a pruned `.bt` subtree, in place.

    words   : (n, BLOCK_NODES) uint16, its inner nodes depth first; lengths (n,) how many
    codes   : (n,) uint8, what its own root is: 0, FREE, OCCUPIED or INNER
    """
    fine = np.empty(512, np.int64)  # in the order of children: z, y, x bits interleaved
    middle = np.empty(64, np.int64)
    middle_words = np.empty(64, np.int64)
    coarse = np.empty(8, np.int64)
    coarse_words = np.empty(8, np.int64)
    for n in range(slots.shape[0]):
        for m in range(512):
            i = (m & 1) | (m >> 3 & 1) << 1 | (m >> 6 & 1) << 2
            j = (m >> 1 & 1) | (m >> 4 & 1) << 1 | (m >> 7 & 1) << 2
            k = (m >> 2 & 1) | (m >> 5 & 1) << 1 | (m >> 8 & 1) << 2
            value = evidence[slots[n], i << 6 | j << 3 | k]
            fine[m] = 0 if value == unknown else (OCCUPIED if value >= 0 else FREE)
        for m in range(64):
            middle_words[m], middle[m] = join_children(fine, 8 * m)
        for m in range(8):
            coarse_words[m], coarse[m] = join_children(middle, 8 * m)
        word, code = join_children(coarse, 0)
        codes[n] = code
        length = 0
        if code == INNER:
            words[n, 0] = word
            length = 1
            for a in range(8):
                if coarse[a] == INNER:
                    words[n, length] = coarse_words[a]
                    length += 1
                    for b in range(8 * a, 8 * a + 8):
                        if middle[b] == INNER:
                            words[n, length] = middle_words[b]
                            length += 1
        lengths[n] = length


@njit(cache=True)
def write_binary(
    levels: Array, first_rows: Array, words: Array, block_words: Array, block_lengths: Array, stream: Array
) -> Int:
    """Write the tree above the blocks and the blocks' subtrees depth first into `stream` (n,) uint16, in place.

    words        : inner nodes of the levels above the blocks, level by level from the root, each level in Morton order
    levels       : (w,) level of each; first_rows (w,) the row of its first inner child, in `words` or, for the lowest
                   level, in `block_words`
    Returns how many words were written.
    """
    stack = np.empty((8 * DEPTH + 1, 2), np.int64)
    stack[0, 0], stack[0, 1] = 0, levels[0]
    top = 1
    at = 0
    while top > 0:
        top -= 1
        row, level = stack[top, 0], stack[top, 1]
        if level == 3:
            for n in range(block_lengths[row]):
                stream[at] = block_words[row, n]
                at += 1
            continue
        word = np.int64(words[row])
        stream[at] = word
        at += 1
        children = 0
        for child in range(8):
            children += word >> (2 * child) & 3 == INNER
        for child in range(children - 1, -1, -1):
            stack[top, 0] = first_rows[row] + child
            stack[top, 1] = level - 1
            top += 1
    return at
