"""Slow, obvious twins of the octree: a dictionary of voxels."""

from __future__ import annotations

import numpy as np

Voxels = dict[tuple[int, int, int], int]


def sum_up(voxels: Voxels, point_ijk: tuple[int, int, int], shift: int) -> list[int]:
    """The evidence of the known voxels in the cube of 2^shift voxels that holds a voxel."""
    cube = tuple(x >> shift for x in point_ijk)
    return [value for ijk, value in voxels.items() if tuple(x >> shift for x in ijk) == cube]


def leaves(voxels: Voxels, finest: int, widest: int) -> dict[tuple[tuple[int, int, int], int], int]:
    """(lowest voxel, edge) → evidence of the leaves of the pruned octree, from cubes of 2^widest voxels down."""
    found: dict[tuple[tuple[int, int, int], int], int] = {}
    within: dict[tuple[int, int, int], Voxels] = {}
    for (i, j, k), value in voxels.items():
        within.setdefault((i >> widest, j >> widest, k >> widest), {})[i, j, k] = value
    for cube, inside in within.items():
        edge = 1 << widest
        values = set(inside.values())
        if widest <= finest or (len(inside) == edge**3 and len(values) == 1):
            found[tuple(x * edge for x in cube), edge] = max(values)
        else:
            found.update(leaves(inside, finest, widest - 1))
    return found


def first_hit(
    voxels: Voxels, origin: np.ndarray, direction: np.ndarray, reach: float, step: float = 0.001
) -> tuple[float | None, float | None]:
    """The way [voxels] along a ray to the first occupied and to the first unknown voxel, by small steps."""
    unknown = None
    for t in np.arange(0.0, reach, step):
        value = voxels.get(tuple(np.floor(origin + t * direction).astype(int).tolist()))
        if value is None and unknown is None:
            unknown = float(t)
        if value is not None and value >= 0:
            return float(t), unknown
    return None, unknown
