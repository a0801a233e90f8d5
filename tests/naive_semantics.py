"""Slow, obvious twins of the kernels of labels, shapes and rooms: dictionaries, sets and loops."""

from __future__ import annotations

from collections import defaultdict, deque
from itertools import pairwise

import numpy as np
import shapely

Cell = tuple[int, int]
FOUR = ((1, 0), (-1, 0), (0, 1), (0, -1))


def neighbours(cell: Cell, shape: tuple[int, ...]) -> list[Cell]:
    """The 4-neighbours inside the grid."""
    around = ((cell[0] + i, cell[1] + j) for i, j in FOUR)
    return [(i, j) for i, j in around if 0 <= i < shape[0] and 0 <= j < shape[1]]


# -- masks ---------------------------------------------------------------------------------------------------------


def mask_depths(keys: np.ndarray, cap: int) -> np.ndarray:
    """City-block distance of every masked pixel to the nearest pixel of another mask."""
    height, width = keys.shape
    distance = np.zeros(keys.shape, np.uint8)
    for v, u in np.argwhere(keys != 0):
        others = np.argwhere(keys != keys[v, u])
        nearest = np.abs(others - (v, u)).sum(axis=1).min() if len(others) else cap
        distance[v, u] = min(cap, nearest)
    assert distance.shape == (height, width)
    return distance


def pieces(keys: np.ndarray, depth: np.ndarray, step_m: float, step_share: float) -> set[frozenset[Cell]]:
    """Connected pieces of the masks, by breadth-first search; the right or lower of two neighbours sets the limit."""
    left = {(int(v), int(u)) for v, u in np.argwhere((keys != 0) & (depth > 0))}
    found = set()
    while left:
        todo = deque([left.pop()])
        piece = set(todo)
        while todo:
            a = todo.popleft()
            for b in neighbours(a, keys.shape):
                later = depth[max(a, b)]
                if b in left and keys[a] == keys[b] and abs(depth[a] - depth[b]) < step_m + step_share * later:
                    left.discard(b)
                    piece.add(b)
                    todo.append(b)
        found.add(frozenset(piece))
    return found


# -- votes ---------------------------------------------------------------------------------------------------------


class Ballots:
    """All votes ever cast, by voxel and class; nothing is forgotten."""

    def __init__(self) -> None:
        self.votes: defaultdict[tuple[int, int, int], defaultdict[int, float]] = defaultdict(lambda: defaultdict(float))

    def cast(self, points: np.ndarray, labels: np.ndarray, weights: np.ndarray, voxel: float) -> None:
        for point, label, weight in zip(points, labels, weights, strict=True):
            if label and weight > 0:
                ijk = tuple(int(np.floor(c / voxel)) for c in point)
                self.votes[ijk][int(label)] += float(weight)

    def leader(self, ijk: tuple[int, int, int]) -> tuple[int, float]:
        """The class with most votes and its share of all."""
        votes = self.votes[ijk]
        best = max(votes, key=lambda c: votes[c])
        return best, votes[best] / sum(votes.values())


# -- grids ---------------------------------------------------------------------------------------------------------


def grown(reach: np.ndarray, barrier: np.ndarray, steps: int) -> np.ndarray:
    """Cells at most `steps` 4-neighbour steps from the set, on ways that enter no barrier."""
    now = reach.copy()
    for _ in range(steps):
        wider = now.copy()
        for cell in map(tuple, np.argwhere(now)):
            for other in neighbours(cell, now.shape):
                if not barrier[other]:
                    wider[other] = True
        now = wider
    return now


def steps_from(sources: set[Cell], allowed: np.ndarray) -> dict[Cell, int]:
    """How many 4-neighbour steps each allowed cell is away from the sources."""
    away = dict.fromkeys(sources, 0)
    todo = deque(sources)
    while todo:
        cell = todo.popleft()
        for other in neighbours(cell, allowed.shape):
            if other not in away and allowed[other]:
                away[other] = away[cell] + 1
                todo.append(other)
    return away


def way_length(blocked: np.ndarray, start: Cell, goal: Cell) -> float:
    """Length of the shortest 8-neighbour way by Dijkstra over a plain dictionary; inf where there is none."""
    cost = {start: 0.0}
    done: set[Cell] = set()
    while len(done) < len(cost):
        cell = min((c for c in cost if c not in done), key=lambda c: cost[c])
        done.add(cell)
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                other = (cell[0] + i, cell[1] + j)
                if not (0 <= other[0] < blocked.shape[0] and 0 <= other[1] < blocked.shape[1]):
                    continue
                if blocked[other] and other != goal:
                    continue
                if i and j and (blocked[cell[0] + i, cell[1]] or blocked[cell[0], cell[1] + j]):
                    continue
                reached = cost[cell] + float(np.hypot(i, j))
                cost[other] = min(cost.get(other, np.inf), reached)
    return cost.get(goal, np.inf)


def length_of(way: np.ndarray) -> float:
    """Length of a way of cells."""
    return float(sum(np.hypot(*(b - a)) for a, b in pairwise(way)))


# -- shapes --------------------------------------------------------------------------------------------------------


def overlap_area(a: np.ndarray, b: np.ndarray) -> float:
    return float(shapely.Polygon(a).intersection(shapely.Polygon(b)).area)


def nearest_pair(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


def facing_up(points: np.ndarray, cell: float, least: float, clearance: float) -> np.ndarray:
    """Points with no other point of their column between `least` and `clearance` above."""
    column = np.floor(points[:, :2] / cell)
    result = np.ones(len(points), bool)
    for n, p in enumerate(points):
        rise = points[:, 2] - p[2]
        mine = (column == column[n]).all(axis=1)
        result[n] = not (mine & (rise > least) & (rise <= clearance)).any()
    return result


def closed_sides(points: np.ndarray, material: np.ndarray, beside: float) -> list[int]:
    """In how many of ±x, ±y, −z each point meets material."""
    counts = []
    for x, y, z in points:
        met = set()
        for a, b, c in material:
            level = 0.0 <= c - z <= 2.0 * beside
            if abs(b - y) <= beside and level:
                met.add("+x" if a > x else "-x")
            if abs(a - x) <= beside and level:
                met.add("+y" if b > y else "-y")
            if abs(a - x) <= beside and abs(b - y) <= beside and c < z:
                met.add("-z")
        counts.append(len(met))
    return counts


def clusters(points: np.ndarray, cell: float) -> list[set[int]]:
    """Sets of points whose cells hang together over 26 neighbours."""
    cells = np.floor(points / cell).astype(int)
    left, found = set(range(len(points))), []
    while left:
        todo = [left.pop()]
        cluster = set(todo)
        while todo:
            a = todo.pop()
            for b in [b for b in left if np.abs(cells[a] - cells[b]).max() <= 1]:
                left.discard(b)
                cluster.add(b)
                todo.append(b)
        found.append(cluster)
    return found


def inner_part(points: np.ndarray, weights: np.ndarray, share: float, directions: int, bin_m: float) -> np.ndarray:
    """Points that in no direction lie in a bin beyond which, it included, less than `share` of the weight lies."""
    kept = np.ones(len(points), bool)
    for d in range(directions):
        angle = np.pi * d / directions
        along = np.floor((points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle)) / bin_m)
        for p in range(len(points)):
            below, above = weights[along <= along[p]].sum(), weights[along >= along[p]].sum()
            kept[p] &= bool(below >= share * weights.sum() and above >= share * weights.sum())
    return kept
