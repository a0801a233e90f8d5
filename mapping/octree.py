"""Occupancy as the octree that it is: coarser levels, leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.cells import Cells
from mapping.errors import InvalidParameter
from mapping.grid import ADDRESSABLE_VOXELS, BLOCK_EDGE
from mapping.kernels import cells
from mapping.kernels.cells import UNKNOWN

if TYPE_CHECKING:
    from mapping.occupancy import OccupancyMap

Array: TypeAlias = NDArray[Any]

FINEST = 16
"""The level of OctoMap's tree at which nodes are voxels; at level d they are 2^(16 − d) voxels wide."""


class Leaves(NamedTuple):
    """The leaves of an octree: centres (N, 3) [m], edges `size_m` (N,), `probability` (N,) that they are occupied."""

    centre: NDArray[np.float64]
    size_m: NDArray[np.float64]
    probability: NDArray[np.float64]


def require_depth(depth: int) -> int:
    """A level of the tree, 0 … 16, or `InvalidParameter`."""
    if depth not in range(FINEST + 1):
        raise InvalidParameter(f"depth: expected a level in 0 … {FINEST}, got {depth!r}")
    return int(depth)


def sum_up(
    occupancy: OccupancyMap, points: NDArray[np.float64], depth: int
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Of the cube of level `depth` at each point (N, 3) [m]: the highest evidence (N,), and the mean probability."""
    shift = FINEST - require_depth(depth)
    highest, mean = np.full(len(points), UNKNOWN, np.int8), np.full(len(points), np.nan)
    voxels = points / occupancy.voxel_size_m
    inside = np.isfinite(points).all(axis=1) & (np.abs(voxels) < ADDRESSABLE_VOXELS).all(axis=1)
    cubes, which = np.unique(np.floor(voxels[inside]).astype(np.int64) >> shift, axis=0, return_inverse=True)
    high, average = np.full(len(cubes), UNKNOWN, np.int8), np.full(len(cubes), np.nan)
    probability = np.roll(occupancy.probabilities, 128)  # from −128 on
    if shift - 3 <= cells.MAX_LEVEL:
        cells.sum_up_cubes(*occupancy.store.tree, cubes << shift, 1 << shift, probability, high, average)
    else:
        _sum_up_wide(occupancy, cubes, shift, probability, high, average)
    highest[inside], mean[inside] = high[which.ravel()], average[which.ravel()]
    return highest, mean


def _sum_up_wide(
    occupancy: OccupancyMap, cubes: Array, shift: int, probability: Array, highest: Array, mean: Array
) -> None:
    """The same for cubes wider than any cell: every cell of the map lies in one of them, or in none."""
    blocks, slots = occupancy.store.dense_blocks()
    values = occupancy.store.payload[slots]
    known = values != UNKNOWN
    uniform = occupancy.store.uniform_cells()
    corner = np.concatenate([blocks.astype(np.int64), uniform.ijk.astype(np.int64) << uniform.level[:, None]])
    voxels = np.concatenate([known.sum(axis=1), np.int64(BLOCK_EDGE**3) << 3 * uniform.level.astype(np.int64)])
    sums = np.concatenate(
        [
            np.where(known, probability[values.astype(np.int64) + 128], 0.0).sum(axis=1),
            probability[uniform.value.astype(np.int64) + 128] * voxels[len(blocks) :],
        ]
    )
    tops = np.concatenate([values.max(axis=1, initial=UNKNOWN), uniform.value])
    for n, cube in enumerate(cubes):
        within = (corner >> (shift - 3) == cube).all(axis=1)
        if voxels[within].sum():
            highest[n], mean[n] = tops[within].max(), sums[within].sum() / voxels[within].sum()


def leaves(occupancy: OccupancyMap, depth: int = FINEST) -> Leaves:
    """The leaves of the tree, none finer than level `depth`: what is alike is one leaf, as wide as its cell.

    A leaf of level `depth` that holds different voxels is as occupied as the most occupied of them; cubes of which
    nothing is known are left out.
    """
    finest = FINEST - require_depth(depth)
    store = occupancy.store
    _, ijk, level, _, _, _ = store.rows
    room = 1024
    while True:
        corners, edges = np.empty((room, 3), np.int64), np.empty(room, np.int64)
        values = np.empty(room, np.int8)
        _, slot, payload, _ = store.tree
        n = cells.list_leaves(
            ijk, level, slot, payload, int(store.counts[cells.N_ROWS]), min(finest, 3), corners, edges, values
        )
        if n <= room:
            break
        room = n
    corners, edges, values = corners[:n], edges[:n], values[:n]
    if finest > 3:
        corners, edges, values = _coarsened(corners, edges, values, finest)
    size = occupancy.voxel_size_m
    centre = (corners + 0.5 * edges[:, None]) * size
    return Leaves(centre, np.asarray(edges * size, np.float64), occupancy.probabilities[values.view(np.uint8)])


def _coarsened(corners: Array, edges: Array, values: Array, finest: int) -> tuple[Array, Array, Array]:
    """Leaves narrower than 2^finest voxels joined into cubes of that width, each as high as its highest leaf."""
    small = edges < 1 << finest
    cubes, which = np.unique(corners[small] >> finest, axis=0, return_inverse=True)
    highest = np.full(len(cubes), UNKNOWN, np.int8)
    np.maximum.at(highest, which.ravel(), values[small])
    return (
        np.concatenate([corners[~small], cubes << finest]),
        np.concatenate([edges[~small], np.full(len(cubes), 1 << finest)]),
        np.concatenate([values[~small], highest]),
    )


def voxels_of(cell: Cells) -> NDArray[np.int32]:
    """All voxels (N, 3) of cells."""
    edges = np.int64(BLOCK_EDGE) << cell.level.astype(np.int64)
    of = np.repeat(np.arange(len(edges)), edges**3)
    inside = np.arange(len(of)) - np.repeat(np.cumsum(edges**3) - edges**3, edges**3)
    edge = edges[of]
    within = np.stack([inside // (edge * edge), inside // edge % edge, inside % edge], axis=1)
    return np.asarray(cell.ijk[of].astype(np.int64) * edge[:, None] + within, dtype=np.int32)
