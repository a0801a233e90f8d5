"""Marching cubes on hashed blocks (Lorensen & Cline 1987), with tables that are derived instead of typed.

A cube's corner c has offset (c >> 2, (c >> 1) & 1, c & 1); bit c of its case is set where the corner is behind the
surface. On a face with four crossings each corner behind is cut off by itself; as this depends on the face alone,
neighbouring cubes agree and the surface has no cracks (the ambiguity of the original method).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup
from mapping.kernels.surface import pad_block, slope

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any


def corner_offset(corner: int) -> tuple[int, int, int]:
    """Offset of a corner from the cube's first voxel."""
    return corner >> 2, (corner >> 1) & 1, corner & 1


EDGES: list[tuple[int, int]] = [(a, a | bit) for bit in (4, 2, 1) for a in range(8) if not a & bit]
"""The 12 edges as (lower corner, upper corner): four along x, four along y, four along z."""

_FACES: list[tuple[int, int, int, int]] = [  # corners counter-clockwise as seen from outside the cube
    (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3),
]  # fmt: skip


def triangulate_case(case: int) -> list[tuple[int, int, int]]:
    """Triangles of one case as edge numbers, counter-clockwise as seen from free space."""
    edge_of = {frozenset(edge): n for n, edge in enumerate(EDGES)}
    follows: dict[int, int] = {}
    for face in _FACES:
        behind = [bool(case >> corner & 1) for corner in face]
        for n in range(4):
            if behind[n] or not behind[(n + 1) % 4]:
                continue
            entry = edge_of[frozenset((face[n], face[(n + 1) % 4]))]
            last = (n + 1) % 4
            while behind[(last + 1) % 4]:
                last = (last + 1) % 4
            follows[edge_of[frozenset((face[last], face[(last + 1) % 4]))]] = entry
    triangles = []
    while follows:
        first, at = follows.popitem()
        loop = [first]
        while at != first:
            loop.append(at)
            at = follows.pop(at)
        triangles += [(loop[0], loop[n + 1], loop[n]) for n in range(1, len(loop) - 1)]
    return triangles


_CASES = [triangulate_case(case) for case in range(256)]
MOST_TRIANGLES = max(len(triangles) for triangles in _CASES)
TRIANGLE_COUNT: NDArray[np.int64] = np.array([len(triangles) for triangles in _CASES])
"""(256,) triangles of each case."""
TRIANGLES: NDArray[np.int64] = np.zeros((256, MOST_TRIANGLES, 3), np.int64)
"""(256, MOST_TRIANGLES, 3) edge numbers of each case's triangles."""
for _case, _triangles in enumerate(_CASES):
    if _triangles:
        TRIANGLES[_case, : len(_triangles)] = _triangles
EDGE_OFFSET: NDArray[np.int64] = np.array([[*corner_offset(a), n // 4] for n, (a, _) in enumerate(EDGES)])
"""(12, 4) offset of the voxel that owns each edge, and the edge's axis."""


SIDE_BITS = 11
"""A corner of a triangle is kept as side << SIDE_BITS | n: on side 0 the n-th vertex of the block itself, on another
the vertex on edge n of the block that is 1 farther along the axes of the side's bits (4 x, 2 y, 1 z).
Edge = 3 · voxel + axis."""
_STEP: NDArray[np.int64] = np.array([100, 10, 1])


@njit(cache=True)
def gradient_at(padded: Array, p: Int, max_jump: Float) -> tuple[Float, Float, Float]:
    """Gradient [m a voxel] at voxel `p` of `padded` (1000,), from the neighbours that are on the same surface."""
    i, j, k = p // 100, (p // 10) % 10, p % 10
    here = padded[p]
    nothing = np.float32(np.nan)
    return (
        slope(padded[p - 100] if i > 0 else nothing, here, padded[p + 100] if i < 9 else nothing, max_jump),
        slope(padded[p - 10] if j > 0 else nothing, here, padded[p + 10] if j < 9 else nothing, max_jump),
        slope(padded[p - 1] if k > 0 else nothing, here, padded[p + 1] if k < 9 else nothing, max_jump),
    )


@njit(cache=True, parallel=True)
def mesh_blocks(
    table: Array,
    distance: Array,
    weight: Array,
    voxel_size: Float,
    max_jump: Float,
    blocks: Array,
    vertices: Array,
    edges: Array,
    triangles: Array,
    counts: Array,
) -> None:
    """The surface in each of `blocks` (n, 3): a vertex on each edge that it crosses, joined cube by cube.

    A cube with an unknown corner has no surface, nor has one on an edge of which the distance changes by `max_jump` [m]
    or more: that is an edge between two surfaces.

    vertices  : (n, 1536, 6) float32, filled: position [m] and unit normal into free space, by rising edge
    edges     : (n, 1536) int16, filled: the edge of each vertex
    triangles : (n, 512 · MOST_TRIANGLES, 3) int32, filled: corners, see SIDE_BITS
    counts    : (n, 2) int64, filled: vertices and triangles of each block
    """
    for n in prange(blocks.shape[0]):
        cube = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], cube)
        padded = cube.ravel()
        codes = np.empty(1000, np.int16)
        for p in range(1000):
            codes[p] = np.int16(1) if padded[p] < 0.0 else (np.int16(0) if padded[p] >= 0.0 else np.int16(256))
        cases = np.empty(889, np.int16)  # bits 0 … 7: corner is behind; from 8 on: a corner is unknown
        crossed: Any = False
        for p in range(889):
            known = (codes[p] & 1) | (codes[p + 1] & 1) << 1 | (codes[p + 10] & 1) << 2 | (codes[p + 11] & 1) << 3
            known |= (codes[p + 100] & 1) << 4 | (codes[p + 101] & 1) << 5
            known |= (codes[p + 110] & 1) << 6 | (codes[p + 111] & 1) << 7
            unknown = codes[p] | codes[p + 1] | codes[p + 10] | codes[p + 11]
            unknown |= codes[p + 100] | codes[p + 101] | codes[p + 110] | codes[p + 111]
            cases[p] = known | (unknown & 256)
            crossed |= (known != 0) & (known != 255)
        counts[n, 0] = counts[n, 1] = 0
        if not crossed:
            continue
        number = np.empty(1536, np.int32)
        n_vertices = n_triangles = 0
        for w in range(512):
            i, j, k = w >> 6, (w >> 3) & 7, w & 7
            p = 100 * i + 10 * j + k + 111
            if (cases[p] & 255) == 0 or (cases[p] & 255) == 255:
                continue
            here = padded[p]
            for axis in range(3):
                q = p + _STEP[axis]
                there = padded[q]
                number[3 * w + axis] = -1
                if (here < 0.0) != (there < 0.0) and abs(here - there) < max_jump:
                    share = here / (here - there)
                    vertex = vertices[n, n_vertices]
                    vertex[0] = (8.0 * blocks[n, 0] + i + 0.5 + share * (axis == 0)) * voxel_size
                    vertex[1] = (8.0 * blocks[n, 1] + j + 0.5 + share * (axis == 1)) * voxel_size
                    vertex[2] = (8.0 * blocks[n, 2] + k + 0.5 + share * (axis == 2)) * voxel_size
                    a0, a1, a2 = gradient_at(padded, p, max_jump)
                    b0, b1, b2 = gradient_at(padded, q, max_jump)
                    a0, a1, a2 = a0 + (b0 - a0) * share, a1 + (b1 - a1) * share, a2 + (b2 - a2) * share
                    norm = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
                    if norm > 0.0:
                        vertex[3], vertex[4], vertex[5] = a0 / norm, a1 / norm, a2 / norm
                    else:
                        vertex[3], vertex[4], vertex[5] = 0.0, 0.0, 0.0
                        vertex[3 + axis] = 1.0 if there > here else -1.0
                    edges[n, n_vertices] = 3 * w + axis
                    number[3 * w + axis] = n_vertices
                    n_vertices += 1
        corners = np.empty(12, np.int32)
        for w in range(512):
            i, j, k = w >> 6, (w >> 3) & 7, w & 7
            p = 100 * i + 10 * j + k + 111
            case = cases[p]
            if case >= 256 or TRIANGLE_COUNT[case] == 0:
                continue
            whole: Any = True
            for t in range(TRIANGLE_COUNT[case]):
                for corner in range(3):
                    edge = TRIANGLES[case, t, corner]
                    axis = EDGE_OFFSET[edge, 3]
                    ei, ej, ek = i + EDGE_OFFSET[edge, 0], j + EDGE_OFFSET[edge, 1], k + EDGE_OFFSET[edge, 2]
                    side = (ei >> 3) << 2 | (ej >> 3) << 1 | (ek >> 3)
                    at = 3 * ((ei & 7) << 6 | (ej & 7) << 3 | (ek & 7)) + axis
                    if side == 0:
                        corners[edge] = number[at]
                        whole = whole and number[at] >= 0
                    else:
                        q = 100 * ei + 10 * ej + ek + 111
                        corners[edge] = side << SIDE_BITS | at
                        whole = whole and abs(padded[q] - padded[q + _STEP[axis]]) < max_jump
            if whole:
                for t in range(TRIANGLE_COUNT[case]):
                    for corner in range(3):
                        triangles[n, n_triangles + t, corner] = corners[TRIANGLES[case, t, corner]]
                n_triangles += TRIANGLE_COUNT[case]
        counts[n, 0], counts[n, 1] = n_vertices, n_triangles


@njit(cache=True)
def keep_pieces(
    all_vertices: Array,
    all_edges: Array,
    all_triangles: Array,
    pieces: Array,
    vertices: Array,
    edges: Array,
    triangles: Array,
) -> None:
    """Copy what `mesh_blocks` made of n blocks to where it is kept: all_… change in place.

    pieces : (n, 4) first vertex, vertices, first triangle, triangles of each block
    """
    for n in range(pieces.shape[0]):
        a, b = pieces[n, 0], pieces[n, 1]
        all_vertices[a : a + b] = vertices[n, :b]
        all_edges[a : a + b] = edges[n, :b]
        a, b = pieces[n, 2], pieces[n, 3]
        all_triangles[a : a + b] = triangles[n, :b]


@njit(cache=True, parallel=True)
def weld(
    table: Array,
    blocks: Array,
    slots: Array,
    pieces: Array,
    edges: Array,
    corners: Array,
    first_rows: Array,
    firsts: Array,
    triangles: Array,
) -> None:
    """Turn the kept corners of the pieces of `slots` (n,) into rows of one array of vertices.

    blocks, pieces : (m, 3), (m, 4) of all slots; edges, corners: as kept by `keep_pieces`
    first_rows     : (m,) row of the first vertex of each slot's piece; firsts: (n,) row of the first triangle
    triangles      : (t, 3) int32, filled
    """
    for n in prange(slots.shape[0]):
        slot = slots[n]
        around = np.empty(8, np.int64)
        for side in range(8):
            around[side] = lookup(
                table, blocks[slot, 0] + (side >> 2), blocks[slot, 1] + ((side >> 1) & 1), blocks[slot, 2] + (side & 1)
            )
        for t in range(pieces[slot, 3]):
            for corner in range(3):
                code = corners[pieces[slot, 2] + t, corner]
                if code >> SIDE_BITS == 0:
                    triangles[firsts[n] + t, corner] = first_rows[slot] + code
                    continue
                other, edge = around[code >> SIDE_BITS], code & ((1 << SIDE_BITS) - 1)
                low, high = pieces[other, 0], pieces[other, 0] + pieces[other, 1] - 1
                while low < high:  # its vertices are by rising edge
                    middle = (low + high) >> 1
                    if edges[middle] < edge:
                        low = middle + 1
                    else:
                        high = middle
                triangles[firsts[n] + t, corner] = first_rows[other] + low - pieces[other, 0]


@njit(cache=True)
def gather_pieces(all_vertices: Array, pieces: Array, slots: Array, vertices: Array) -> None:
    """Copy the vertices of the pieces of `slots`, one after the other; fills vertices (n, 6) float32."""
    row = 0
    for n in range(slots.shape[0]):
        a, b = pieces[slots[n], 0], pieces[slots[n], 1]
        vertices[row : row + b] = all_vertices[a : a + b]
        row += b
