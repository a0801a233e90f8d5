"""Slow, obvious twins of the space of an object: a flood fill, and Algorithm 1 of the paper as it is printed."""

from __future__ import annotations

from collections import deque
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

Voxel = tuple[int, int, int]

DIAGONAL = np.array(list(product((-1, 1), repeat=3)))
"""The offsets of the printed listing: dx, dy and dz run over {−kr, kr}."""
ALL_26 = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])


def flood(voxels: set[Voxel]) -> list[set[Voxel]]:
    """The 26-connected components, by breadth-first search."""
    left, found = set(voxels), []
    while left:
        todo = deque([left.pop()])
        component = set(todo)
        while todo:
            i, j, k = todo.popleft()
            for di, dj, dk in ALL_26.tolist():
                near = (i + di, j + dj, k + dk)
                if near in left:
                    left.discard(near)
                    component.add(near)
                    todo.append(near)
        found.append(component)
    return found


def heaviest(points: np.ndarray, weights: np.ndarray, size: float) -> set[Voxel]:
    """The component of the voxels of points (N, 3) whose points weigh most; of equals that with the lowest voxel."""
    of_voxel: dict[Voxel, float] = {}
    for point, weight in zip(np.floor(points / size).astype(int).tolist(), weights.tolist(), strict=True):
        of_voxel[tuple(point)] = of_voxel.get(tuple(point), 0.0) + weight
    components = flood(set(of_voxel))
    return min(components, key=lambda c: (-sum(of_voxel[v] for v in c), min(c)), default=set())


def expand_octomap(
    points: np.ndarray, start: np.ndarray, resolution: float, *, radius: float, offsets: np.ndarray = DIAGONAL
) -> np.ndarray:
    """EXPAND_OCTOMAP of Algorithm 1 (Martín et al. 2021): the centres (K, 3) [m] of the cells that it finds.

    points  (N, 3) [m] of the mask;  start (3,) [m], the point at the mask's centre
    radius  of the search about a cell's centre [m]: the listing says kr/2, the text kr, kr being the resolution
    offsets of the cells that follow, in units of kr: the listing's loops give the 8 diagonal ones

    Recursion is turned into waves, so that one wave asks the k-d tree at once; what is found is the same.
    """
    tree = cKDTree(points)
    wave = np.zeros((1, 3), np.int64)
    asked: set[Voxel] = {(0, 0, 0)}
    found = []
    while len(wave):
        away, _ = tree.query(start + resolution * wave, distance_upper_bound=radius)
        wave = wave[np.isfinite(away)]
        found.append(wave)
        ahead = np.unique((wave[:, None] + offsets).reshape(-1, 3), axis=0) if len(wave) else wave
        news = [cell for cell in map(tuple, ahead.tolist()) if cell not in asked]
        asked.update(news)
        wave = np.array(news, np.int64).reshape(-1, 3)
    return start + resolution * np.concatenate(found)


def grow_rim(
    depth: np.ndarray, inside: np.ndarray, most: int, deepest: int, own: np.ndarray, on: np.ndarray, step_m: float
) -> np.ndarray:
    """Which pixels (H, W) are the object's, without noise: deep ones of `own`, and what goes on from them outwards."""
    front = np.zeros(depth.shape)
    height, width = depth.shape
    for level in range(int(inside.max(initial=0)), 0, -1):
        for v, u in np.argwhere(inside == level).tolist():
            if level >= deepest or (level >= most and not on[v, u]):
                front[v, u] = depth[v, u] if own[v, u] else 0.0
                continue
            around = [(a, b) for a in (v - 1, v, v + 1) for b in (u - 1, u, u + 1)]
            deeper = [(a, b) for a, b in around if 0 <= a < height and 0 <= b < width and inside[a, b] > level]
            mine = [abs(front[at]) for at in deeper if front[at] and (on[at] or not on[v, u])]
            others = sum(depth[at] > 0 and not (front[at] and (on[at] or not on[v, u])) for at in deeper)
            goes_on = len(mine) > others
            if depth[v, u] == 0.0:
                front[v, u] = -np.mean(mine) if goes_on else 0.0
            elif (goes_on and abs(np.mean(mine) - depth[v, u]) <= step_m) or (not deeper and own[v, u]):
                front[v, u] = depth[v, u]
    return front > 0.0
