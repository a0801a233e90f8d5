"""OctoMap's trees as arrays of nodes: depth first, children in the order of their index (bit 0: x, 1: y, 2: z).

`children` (n,) uint8 says of each node which children follow it, bit c for child c; leaves have none. The root is at
level 16, its children at level 15, voxels at level 0; a node's cell is 2^level voxels wide. In `.bt` files a node with
children is 16 bits, two for each child: FREE, OCCUPIED, INNER, or 0 where there is none.
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
WHITE = 255
"""What all three channels of a node without a colour are."""


@njit(cache=True, inline="always")
def lowest_child(mask: Int) -> Int:
    """The index of the first child in a mask that is not 0."""
    child = 0
    while not mask >> child & 1:
        child += 1
    return child


@njit(cache=True)
def next_sibling(children: Array, node: Int) -> Int:
    """The first node behind all that is below `node`."""
    pending = 1
    while pending > 0:
        mask = np.int64(children[node])
        while mask:
            mask &= mask - 1
            pending += 1
        pending -= 1
        node += 1
    return node


@njit(cache=True)
def read_words(words: Array, children: Array, occupied: Array) -> tuple[Int, Int]:
    """Turn the words (m,) uint16 of a `.bt` file into nodes, in place.

    children, occupied : (n,) for the nodes that are expected; a node is occupied where a leaf below is, the root always
    Returns (nodes, words read); words read is −1 where they end early, go deeper than 16 levels, or name a node without
    children or more nodes than expected.
    """
    rest = np.zeros(DEPTH + 2, np.int64)  # codes of the children still to come at each level
    node_at = np.zeros(DEPTH + 2, np.int64)
    level = DEPTH + 1
    rest[level] = INNER
    count = at = 0
    while True:
        if rest[level] == 0:
            if level == DEPTH + 1:
                occupied[0] = True
                return count, at
            if level < DEPTH and occupied[node_at[level]]:
                occupied[node_at[level + 1]] = True
            level += 1
            continue
        code = rest[level] & 3
        rest[level] >>= 2
        if code == 0:
            continue
        if count == children.shape[0]:
            return count, -1
        if code == INNER:
            if level == 1 or at == words.shape[0] or words[at] == 0:
                return count, -1
            level -= 1
            word = np.int64(words[at])
            at += 1
            mask: Int = 0
            for child in range(8):
                mask |= np.int64(word >> (2 * child) & 3 != 0) << child
            rest[level] = word
            node_at[level] = count
            children[count] = mask
            occupied[count] = False
        else:
            children[count] = 0
            occupied[count] = code == OCCUPIED
            if code == OCCUPIED:
                occupied[node_at[level]] = True
        count += 1


@njit(cache=True)
def write_words(children: Array, occupied: Array, words: Array) -> None:
    """Turn nodes (n,) into the words of a `.bt` file, one for each node with children, in place."""
    rest = np.zeros(DEPTH + 2, np.int64)  # children still to come at each level
    word_at = np.zeros(DEPTH + 2, np.int64)
    level = DEPTH + 1
    count = 0
    for node in range(children.shape[0]):
        while node > 0 and rest[level] == 0:
            level += 1
        mask = np.int64(children[node])
        if node > 0:
            child = lowest_child(rest[level])
            rest[level] &= rest[level] - 1
            code = INNER if mask else (OCCUPIED if occupied[node] else FREE)
            words[word_at[level]] |= np.uint16(code << (2 * child))
        if mask:
            level -= 1
            rest[level] = mask
            word_at[level] = count
            words[count] = 0
            count += 1


@njit(cache=True)
def list_cells(children: Array, finest: Int, nodes: Array, corners: Array, levels: Array) -> tuple[Int, Int]:
    """List the nodes at level `finest` and the leaves above, in place as far as there is room.

    nodes   : (m,) int64, the node of each; corners (m, 3) int32 its lowest voxel; levels (m,) int8
    Returns (how many there are, nodes of the tree); the first is −1 where the tree lacks nodes that it names or goes
    deeper than 16 levels.
    """
    rest = np.zeros(DEPTH + 2, np.int64)  # children still to come at each level
    corner = np.full((DEPTH + 2, 3), -ORIGIN, np.int64)
    level = DEPTH + 1
    rest[level] = 1
    count = node = 0
    while True:
        while rest[level] == 0:
            if level == DEPTH + 1:
                return count, node
            level += 1
        if node == children.shape[0]:
            return -1, node
        child = lowest_child(rest[level])
        rest[level] &= rest[level] - 1
        below = level - 1
        i = corner[level, 0] + ((child & 1) << below)
        j = corner[level, 1] + ((child >> 1 & 1) << below)
        k = corner[level, 2] + ((child >> 2) << below)
        mask = np.int64(children[node])
        if below == finest or (mask == 0 and below > finest):
            if count < nodes.shape[0]:
                nodes[count] = node
                corners[count, 0], corners[count, 1], corners[count, 2] = i, j, k
                levels[count] = below
            count += 1
        node += 1
        if mask:
            if below == 0:
                return -1, node
            level = below
            rest[level] = mask
            corner[level, 0], corner[level, 1], corner[level, 2] = i, j, k


@njit(cache=True)
def nearest_evidence(evidence: Array, log_odds: Array, per_step: float, lowest: Int, highest: Int) -> None:
    """Round log-odds (n,) float32 to steps, `per_step` of them to 1, of the same sign and clamped, in place.

    evidence : (n,) int8; what is not negative stays so, as 0 is occupied
    """
    for n in range(log_odds.shape[0]):
        steps = np.rint(log_odds[n] * per_step)
        steps = max(steps, 0.0) if log_odds[n] >= 0.0 else min(steps, -1.0)
        evidence[n] = np.int8(min(max(steps, float(lowest)), float(highest)))


@njit(cache=True)
def fill_blocks(rows: Array, children: Array, evidence: Array, nodes: Array) -> None:
    """Write the leaves below each of `nodes` (k,), which are at level 3, into `rows` (k, 512) int8, in place.

    evidence : (n,) int8, of each node of the tree
    """
    rest = np.zeros(5, np.int64)
    base = np.zeros(5, np.int64)
    for row in range(nodes.shape[0]):
        node = nodes[row]
        level = 4
        rest[level] = 1
        base[level] = 0
        while True:
            while level < 5 and rest[level] == 0:
                level += 1
            if level == 5:
                break
            child = lowest_child(rest[level])
            rest[level] &= rest[level] - 1
            below = level - 1
            first = base[level] + (((child & 1) << 6 | (child >> 1 & 1) << 3 | child >> 2) << below)
            mask = np.int64(children[node])
            if mask:
                level = below
                rest[level] = mask
                base[level] = first
            else:
                edge = 1 << below
                for i in range(edge):
                    for j in range(edge):
                        for k in range(edge):
                            rows[row, first + (i << 6 | j << 3 | k)] = evidence[node]
            node += 1


@njit(cache=True)
def find_leaves(found: Array, children: Array, nodes: Array, levels: Array, keys: Array) -> None:
    """The leaf that holds each voxel, −1 where there is none, in place.

    found  : (m,) int64, in: the row of `nodes` (k,) and `levels` (k,) below which to look, −1 for nowhere
    keys   : (m, 3) int64, the voxels; only their bits below the level of that node are looked at
    """
    for n in range(found.shape[0]):
        if found[n] < 0:
            continue
        node, level = nodes[found[n]], np.int64(levels[found[n]])
        while children[node]:
            level -= 1
            wanted = (keys[n, 0] >> level & 1) | (keys[n, 1] >> level & 1) << 1 | (keys[n, 2] >> level & 1) << 2
            mask = np.int64(children[node])
            if not mask >> wanted & 1:
                node = -1
                break
            node += 1
            for child in range(wanted):
                if mask >> child & 1:
                    node = next_sibling(children, node)
        found[n] = node


@njit(cache=True)
def average_colors(colors: Array, children: Array) -> None:
    """Give each node with children the mean of those children's colours that have one, in place.

    colors : (n, 3) uint8; white means without colour, as for `ColorOcTreeNode::getAverageChildColor`
    """
    stack = np.empty(8 * (DEPTH + 1), np.int64)  # trees behind the node that is looked at, the nearest on top
    top = 0
    for node in range(children.shape[0] - 1, -1, -1):
        mask = np.int64(children[node])
        if mask:
            red = green = blue = count = 0
            while mask:
                mask &= mask - 1
                top -= 1
                child = stack[top]
                if colors[child, 0] != WHITE or colors[child, 1] != WHITE or colors[child, 2] != WHITE:
                    red += colors[child, 0]
                    green += colors[child, 1]
                    blue += colors[child, 2]
                    count += 1
            colors[node, :] = WHITE
            if count:
                colors[node, 0], colors[node, 1], colors[node, 2] = red // count, green // count, blue // count
        stack[top] = node
        top += 1
