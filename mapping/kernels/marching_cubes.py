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
from mapping.kernels.surface import pad_block

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


@njit(cache=True, parallel=True)
def number_vertices(
    table: Array,
    distance: Array,
    weight: Array,
    voxel_size: Float,
    max_jump: Float,
    blocks: Array,
    firsts: Array,
    numbers: Array,
    vertices: Array,
    counts: Array,
) -> None:
    """Put a vertex on each grid edge that crosses the surface, and number them.

    blocks   : (n, 3) the blocks to mesh; firsts (n,) the number of each block's first vertex
    numbers  : (n, 512, 3) int32, filled: vertex on the edge from each voxel along x, y, z, −1 where there is none
    vertices : (m, 3) float32, filled [m]; empty to count only
    counts   : (n,) int64, filled: vertices of each block
    """
    for n in prange(blocks.shape[0]):
        padded = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], padded)
        number = firsts[n]
        for w in range(512):
            i, j, k = 1 + (w >> 6), 1 + ((w >> 3) & 7), 1 + (w & 7)
            here = padded[i, j, k]
            for axis in range(3):
                there = padded[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
                numbers[n, w, axis] = -1
                if (here < 0.0) != (there < 0.0) and abs(here - there) < max_jump:
                    numbers[n, w, axis] = number
                    if vertices.shape[0] > 0:
                        share = here / (here - there)
                        vertices[number, 0] = (8.0 * blocks[n, 0] + i - 0.5 + share * (axis == 0)) * voxel_size
                        vertices[number, 1] = (8.0 * blocks[n, 1] + j - 0.5 + share * (axis == 1)) * voxel_size
                        vertices[number, 2] = (8.0 * blocks[n, 2] + k - 0.5 + share * (axis == 2)) * voxel_size
                    number += 1
        counts[n] = number - firsts[n]


@njit(cache=True, parallel=True)
def join_triangles(
    table: Array,
    distance: Array,
    weight: Array,
    blocks: Array,
    rows: Array,
    numbers: Array,
    firsts: Array,
    triangles: Array,
    counts: Array,
) -> None:
    """Join the vertices to triangles, cube by cube; cubes with an unknown corner or an edge between surfaces have none.

    rows      : hash table of `blocks` (n, 3): index → row
    numbers   : (n, 512, 3) from `number_vertices`
    triangles : (m, 3) int32, filled from firsts[n] on for each block; empty to count only
    counts    : (n,) int64, filled: triangles of each block
    """
    for n in prange(blocks.shape[0]):
        padded = np.empty((10, 10, 10), np.float32)
        pad_block(table, distance, weight, blocks[n, 0], blocks[n, 1], blocks[n, 2], padded)
        around = np.empty(8, np.int64)
        for side in range(8):
            around[side] = lookup(
                rows, blocks[n, 0] + (side >> 2), blocks[n, 1] + ((side >> 1) & 1), blocks[n, 2] + (side & 1)
            )
        corners = np.empty(12, np.int64)
        count = 0
        for w in range(512):
            i, j, k = w >> 6, (w >> 3) & 7, w & 7
            case = 0
            known: Any = True
            for corner in range(8):
                value = padded[1 + i + (corner >> 2), 1 + j + ((corner >> 1) & 1), 1 + k + (corner & 1)]
                known = known and not np.isnan(value)
                case |= (value < 0.0) << corner
            if not known or TRIANGLE_COUNT[case] == 0:
                continue
            whole: Any = True
            for t in range(TRIANGLE_COUNT[case]):
                for corner in range(3):
                    edge = TRIANGLES[case, t, corner]
                    ei, ej, ek = i + EDGE_OFFSET[edge, 0], j + EDGE_OFFSET[edge, 1], k + EDGE_OFFSET[edge, 2]
                    row = around[(ei >> 3) << 2 | (ej >> 3) << 1 | (ek >> 3)]
                    local = (ei & 7) << 6 | (ej & 7) << 3 | (ek & 7)
                    number = numbers[row, local, EDGE_OFFSET[edge, 3]] if row >= 0 else np.int32(-1)
                    corners[edge] = number
                    whole = whole and number >= 0
            if not whole:
                continue
            if triangles.shape[0] > 0:
                for t in range(TRIANGLE_COUNT[case]):
                    for corner in range(3):
                        triangles[firsts[n] + count + t, corner] = corners[TRIANGLES[case, t, corner]]
            count += TRIANGLE_COUNT[case]
        counts[n] = count


@njit(cache=True)
def sum_normals(vertices: Array, triangles: Array, normals: Array) -> None:
    """Unit normal of each vertex: the mean of its triangles', weighted by area; fills normals (n, 3) float32."""
    normals[:] = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in range(3):
            vertex = triangles[t, corner]
            normals[vertex, 0] += nx
            normals[vertex, 1] += ny
            normals[vertex, 2] += nz
    for n in range(normals.shape[0]):
        x, y, z = normals[n, 0], normals[n, 1], normals[n, 2]
        norm = np.sqrt(x * x + y * y + z * z)
        if norm > 0.0:
            normals[n, 0] = x / norm
            normals[n, 1] = y / norm
            normals[n, 2] = z / norm
