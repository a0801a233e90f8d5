"""Regions of a ground grid: growth that does not pass walls, and basins of the distance to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.forest import root_of

Array = NDArray[Any]


@njit(cache=True)
def draw_segment(grid: Array, x0: float, y0: float, x1: float, y1: float) -> None:
    """Set the cells that a segment passes, in place. grid (W, H) bool; coordinates in cells."""
    steps = int(np.ceil(2.0 * max(abs(x1 - x0), abs(y1 - y0)))) + 1
    for n in range(steps + 1):
        i = int(np.floor(x0 + (x1 - x0) * n / steps))
        j = int(np.floor(y0 + (y1 - y0) * n / steps))
        if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
            grid[i, j] = True


@njit(cache=True)
def grow(reach: Array, barrier: Array, steps: int) -> None:
    """Widen the set of cells by `steps` 4-neighbour steps that never enter a barrier, in place. Both (W, H) bool."""
    width, height = reach.shape
    front = np.empty((width * height, 2), dtype=np.int32)
    n = 0
    for i in range(width):
        for j in range(height):
            if reach[i, j]:
                front[n, 0], front[n, 1] = i, j
                n += 1
    begin = 0
    for _ in range(steps):
        end = n
        for f in range(begin, end):
            for d in range(4):
                i = front[f, 0] + (1 if d == 0 else -1 if d == 1 else 0)
                j = front[f, 1] + (1 if d == 2 else -1 if d == 3 else 0)
                if 0 <= i < width and 0 <= j < height and not reach[i, j] and not barrier[i, j]:
                    reach[i, j] = True
                    front[n, 0], front[n, 1] = i, j
                    n += 1
        begin = end


@njit(cache=True)
def basins(clearance: Array, neck_share: float) -> Array:
    """Label (W, H) int32 the basins of `clearance` (W, H) > 0; 0 elsewhere.

    Cells are flooded from the widest down. Two basins that meet become one when the neck between them is wider than
    `neck_share` of the narrower basin's widest place, else the border between them stays (persistence by ratio).
    """
    width, height = clearance.shape
    flat = clearance.ravel()
    order = np.argsort(-flat, kind="mergesort")
    labels = np.zeros(width * height, dtype=np.int32)
    parent = np.zeros(width * height + 1, dtype=np.int32)
    peak = np.zeros(width * height + 1, dtype=np.float64)
    n = 0
    for cell in order:
        value = flat[cell]
        if not value > 0.0:
            break
        i, j = cell // height, cell % height
        best = 0
        for d in range(4):
            a = i + (1 if d == 0 else -1 if d == 1 else 0)
            b = j + (1 if d == 2 else -1 if d == 3 else 0)
            if a < 0 or b < 0 or a >= width or b >= height:
                continue
            near = labels[a * height + b]
            if near == 0:
                continue
            near = root_of(parent, near)
            if best == 0:
                best = near
            elif near != best:
                low, high = (near, best) if peak[near] < peak[best] else (best, near)
                if value >= neck_share * peak[low]:
                    parent[low] = high
                    best = high
                else:
                    best = high
        if best == 0:
            n += 1
            parent[n] = n
            peak[n] = value
            best = n
        labels[cell] = best
    for cell in range(width * height):
        if labels[cell]:
            labels[cell] = root_of(parent, labels[cell])
    return labels.reshape(width, height)


@njit(cache=True)
def flood(labels: Array, allowed: Array) -> None:
    """Spread labels (W, H) > 0 over the allowed unlabelled cells, nearest first by 4-neighbour steps, in place."""
    width, height = labels.shape
    front = np.empty((width * height, 2), dtype=np.int32)
    n = 0
    for i in range(width):
        for j in range(height):
            if labels[i, j]:
                front[n, 0], front[n, 1] = i, j
                n += 1
    f = 0
    while f < n:
        for d in range(4):
            i = front[f, 0] + (1 if d == 0 else -1 if d == 1 else 0)
            j = front[f, 1] + (1 if d == 2 else -1 if d == 3 else 0)
            if 0 <= i < width and 0 <= j < height and allowed[i, j] and labels[i, j] == 0:
                labels[i, j] = labels[front[f, 0], front[f, 1]]
                front[n, 0], front[n, 1] = i, j
                n += 1
        f += 1


@njit(cache=True)
def shortest_way(blocked: Array, start_i: int, start_j: int, goal_i: int, goal_j: int, limit: float) -> Array:
    """The cells (K, 2) of a shortest 8-neighbour way over a grid (W, H), both ends included; empty beyond `limit`
    cells.

    A* with the octile distance. A diagonal step needs both cells beside it free. The ends themselves may be blocked.
    """
    width, height = blocked.shape
    cost = np.full((width, height), np.inf)
    came = np.full((width, height), -1, dtype=np.int64)
    heap_key = np.empty(width * height * 8 + 8)
    heap_cell = np.empty(width * height * 8 + 8, dtype=np.int64)
    size = 0
    root2 = np.sqrt(2.0)
    cost[start_i, start_j] = 0.0
    heap_key[0], heap_cell[0] = 0.0, start_i * height + start_j
    size = 1
    while size:
        key, cell = heap_key[0], heap_cell[0]
        size -= 1
        last_key, last_cell = heap_key[size], heap_cell[size]
        at = 0
        while 2 * at + 1 < size:
            child = 2 * at + 1
            if child + 1 < size and heap_key[child + 1] < heap_key[child]:
                child += 1
            if heap_key[child] >= last_key:
                break
            heap_key[at], heap_cell[at] = heap_key[child], heap_cell[child]
            at = child
        heap_key[at], heap_cell[at] = last_key, last_cell
        i, j = cell // height, cell % height
        if i == goal_i and j == goal_j:
            break
        if key > limit:
            return np.empty((0, 2), dtype=np.int64)
        for di in range(-1, 2):
            for dj in range(-1, 2):
                a, b = i + di, j + dj
                if (di == 0 and dj == 0) or a < 0 or b < 0 or a >= width or b >= height:
                    continue
                if blocked[a, b] and not (a == goal_i and b == goal_j):
                    continue
                if di and dj and (blocked[i + di, j] or blocked[i, j + dj]):
                    continue
                reached = cost[i, j] + (root2 if di and dj else 1.0)
                if reached < cost[a, b] - 1e-12:
                    cost[a, b] = reached
                    came[a, b] = cell
                    dx, dy = abs(a - goal_i), abs(b - goal_j)
                    guess = reached + max(dx, dy) + (root2 - 1.0) * min(dx, dy)
                    at = size
                    size += 1
                    while at and heap_key[(at - 1) // 2] > guess:
                        heap_key[at], heap_cell[at] = heap_key[(at - 1) // 2], heap_cell[(at - 1) // 2]
                        at = (at - 1) // 2
                    heap_key[at], heap_cell[at] = guess, a * height + b
    if not cost[goal_i, goal_j] <= limit:
        return np.empty((0, 2), dtype=np.int64)
    way = np.empty((width * height, 2), dtype=np.int64)
    n = 0
    cell = goal_i * height + goal_j
    while cell >= 0:
        way[n, 0], way[n, 1] = cell // height, cell % height
        n += 1
        cell = came[cell // height, cell % height]
    return way[:n][::-1].copy()


@njit(cache=True)
def _clear(blocked: Array, x0: float, y0: float, x1: float, y1: float) -> bool:
    steps = int(np.ceil(4.0 * max(abs(x1 - x0), abs(y1 - y0)))) + 1
    for n in range(1, steps):
        if blocked[int(np.floor(x0 + (x1 - x0) * n / steps)), int(np.floor(y0 + (y1 - y0) * n / steps))]:
            return False
    return True


@njit(cache=True)
def taut_length(blocked: Array, way: Array) -> float:
    """Length [cells] of a way (K, 2) of cells once pulled taut: corners are cut wherever the straight line is free."""
    if len(way) < 2:
        return 0.0
    total = 0.0
    at = 0
    while at < len(way) - 1:
        to = len(way) - 1
        while to > at + 1 and not _clear(
            blocked, way[at, 0] + 0.5, way[at, 1] + 0.5, way[to, 0] + 0.5, way[to, 1] + 0.5
        ):
            to -= 1
        total += np.sqrt(float((way[to, 0] - way[at, 0]) ** 2 + (way[to, 1] - way[at, 1]) ** 2))
        at = to
    return total


@njit(cache=True)
def sight(points: Array, walls: Array) -> Array:
    """(N, N) float64: distances between ground points (N, 2) that see each other past walls, inf where they do not.

    walls : (M, 4) segments x0, y0, x1, y1 that block sight; touching one is not yet crossing it
    """
    n = len(points)
    distance = np.full((n, n), np.inf)
    for i in range(n):
        distance[i, i] = 0.0
        for j in range(i + 1, n):
            px, py = points[i]
            qx, qy = points[j]
            free = True
            for w in range(len(walls)):
                ax, ay, bx, by = walls[w]
                s1 = (qx - px) * (ay - py) - (qy - py) * (ax - px)
                s2 = (qx - px) * (by - py) - (qy - py) * (bx - px)
                s3 = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
                s4 = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
                if s1 * s2 < 0.0 and s3 * s4 < 0.0:
                    free = False
                    break
            if free:
                distance[i, j] = distance[j, i] = np.sqrt((px - qx) ** 2 + (py - qy) ** 2)
    return distance


@njit(cache=True)
def shortest_chain(distance: Array, start: int, goal: int) -> float:
    """Length of the shortest chain of steps (N, N) from one point to another, inf where there is none (Dijkstra
    1959)."""
    n = len(distance)
    cost = np.full(n, np.inf)
    done = np.zeros(n, dtype=np.bool_)
    cost[start] = 0.0
    for _ in range(n):
        here = -1
        for i in range(n):
            if not done[i] and cost[i] < np.inf and (here < 0 or cost[i] < cost[here]):
                here = i
        if here < 0 or here == goal:
            break
        done[here] = True
        for j in range(n):
            cost[j] = min(cost[j], cost[here] + distance[here, j])
    return float(cost[goal])


@njit(cache=True)
def fill_holes(reach: Array) -> None:
    """Add to a set of cells (W, H) bool those from which no 4-neighbour way leads out to the border, in place."""
    outside = np.zeros(reach.shape, dtype=np.bool_)
    outside[0], outside[-1] = ~reach[0], ~reach[-1]
    outside[:, 0], outside[:, -1] = ~reach[:, 0], ~reach[:, -1]
    flood(outside, ~reach)
    reach[:] = ~outside
