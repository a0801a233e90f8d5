"""Slow, obvious twins of the kernels that join surface voxels to components: one voxel at a time, by definition."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from mapping.kernels.clusters import LOOSE, NOTHING, RAISED

Voxel = tuple[int, int, int]
BESIDE = [step for step in product((-1, 0, 1), repeat=3) if any(step)]


def linked(codes: Mapping[Voxel, int], a: Voxel, b: Voxel) -> bool:
    """Whether two voxels hang together: beside each other, and of one code, or a loose one below a raised one."""
    if max(abs(p - q) for p, q in zip(a, b, strict=True)) != 1:
        return False
    one, other = codes.get(a, NOTHING), codes.get(b, NOTHING)
    if {one, other} == {LOOSE, RAISED}:
        loose, raised = (a, b) if one == LOOSE else (b, a)
        return loose[2] < raised[2]
    return one == other != NOTHING


def components(codes: Mapping[Voxel, int]) -> set[frozenset[Voxel]]:
    """The voxels that hang together, by flooding from each in turn."""
    left = {voxel for voxel, code in codes.items() if code != NOTHING}
    found = set()
    while left:
        front = [left.pop()]
        whole = set(front)
        while front:
            here = front.pop()
            for step in BESIDE:
                there = (here[0] + step[0], here[1] + step[1], here[2] + step[2])
                if there in left and linked(codes, here, there):
                    left.remove(there)
                    whole.add(there)
                    front.append(there)
        found.add(frozenset(whole))
    return found


class Samples:
    """Stands for a `PlaneMap` over a surface that is given voxel by voxel: raised ones lie on plane 7."""

    def __init__(self, voxel_size_m: float) -> None:
        self.voxel_size_m = voxel_size_m
        self.tolerance_m = 0.5 * voxel_size_m
        self.codes: dict[Voxel, int] = {}

    def set(self, codes: Mapping[Voxel, int]) -> np.ndarray:
        """Change voxels; returns the blocks (K, 3) they lie in."""
        self.codes.update(codes)
        blocks = sorted({(i >> 3, j >> 3, k >> 3) for i, j, k in codes})
        return np.array(blocks, np.int32).reshape(-1, 3)

    def samples_in(self, block_ijk: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        rows = [
            (np.add(voxel, 1.0) * self.voxel_size_m, 7 if code == RAISED else 0, row)
            for row, block in enumerate(block_ijk.tolist())
            for voxel, code in self.codes.items()
            if code != NOTHING and [n >> 3 for n in voxel] == block
        ]
        points = np.array([point for point, *_ in rows], np.float32).reshape(-1, 3)
        normals = np.tile(np.float32([0, 0, 1]), (len(points), 1))
        return points, normals, np.array([i for _, i, _ in rows], np.int64), np.array([r for *_, r in rows], np.int64)

    def ids_near(self, block_ijk: np.ndarray) -> list[int]:
        return []

    def __contains__(self, plane_id: object) -> bool:
        return False
