"""Where a robot can drive in a home, and the ways between places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from scenegraph.simulation.arrangement import ROBOT_RADIUS_M, Placed, free_floor
from scenegraph.simulation.floorplan import FloorPlan
from scenegraph.simulation.shapes import Array

_CELL_M = 0.1


class FloorGrid:
    """The floor a robot's middle can be on, as cells of 0.1 m, joined where it can drive.

    points (n, 2): the cells' places in the home's frame [m]; a cell is known by its number
    """

    def __init__(self, plan: FloorPlan, placed: Sequence[Placed]) -> None:
        self._plan = plan
        floor: Any = free_floor(plan, plan.rooms, placed, ROBOT_RADIUS_M + 0.03)
        gx, gy = np.meshgrid(np.arange(0.0, plan.width, _CELL_M), np.arange(0.0, plan.depth, _CELL_M), indexing="ij")
        shapely.prepare(floor)
        free = shapely.contains_xy(floor, gx, gy)
        number = np.full(free.shape, -1)
        number[free] = np.arange(free.sum())
        self.points: Array = np.stack([gx[free], gy[free]], axis=1)
        self._graph = _joined(number)
        self._ways: dict[int, tuple[Array, Array]] = {}
        self._room = np.array([self.room_at(p) for p in self.points])
        self._reachable = np.isfinite(self._from(self.start())[0])

    def room_at(self, p: Array) -> str:
        """Id of the room at (or closest to) a point (2,)."""
        outside = [max(r.x0 - p[0], p[0] - r.x1, r.y0 - p[1], p[1] - r.y1) for r in self._plan.rooms]
        return self._plan.rooms[int(np.argmin(outside))].id

    def start(self) -> int:
        """A free cell in the middle of the hallway."""
        hall = self._plan.room("hallway")
        middle = np.array([(hall.x0 + hall.x1) / 2, (hall.y0 + hall.y1) / 2])
        return int(np.linalg.norm(self.points - middle, axis=1).argmin())

    def _from(self, cell: int) -> tuple[Array, Array]:
        if cell not in self._ways:
            distance, before = dijkstra(self._graph, indices=cell, return_predecessors=True)
            self._ways[cell] = distance, before
        return self._ways[cell]

    def distance(self, here: int, there: int) -> float:
        """Length of the way between two cells [m]; infinite when there is none."""
        return float(self._from(here)[0][there])

    def path(self, here: int, there: int) -> Array:
        """(n, 2) points of the way between two cells that are joined."""
        before = self._from(here)[1]
        cells = [there]
        while cells[-1] != here:
            cells.append(int(before[cells[-1]]))
        return np.asarray(self.points[cells[::-1]])

    def order(self, here: int) -> list[str]:
        """All rooms that can be reached, each next one the nearest."""
        distance = self._from(here)[0]
        left = {room: self._cells(room) for room in np.unique(self._room[self._reachable]).tolist()}
        order = []
        while left:
            nearest = min(left, key=lambda room: float(distance[left[room]].min()))
            cells = left.pop(nearest)
            order.append(nearest)
            distance = self._from(int(cells[np.argmin(distance[cells])]))[0]
        return order

    def _cells(self, room: str) -> Array:
        return np.flatnonzero((self._room == room) & self._reachable)

    def spread(self, room: str, count: int) -> list[int]:
        """Up to `count` reachable cells of a room, spread evenly (farthest-point sampling from its middle)."""
        cells = self._cells(room)
        points = self.points[cells]
        chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())]
        gap = np.linalg.norm(points - points[chosen[0]], axis=1)
        while len(chosen) < count and gap.max() > 0.3:
            chosen.append(int(gap.argmax()))
            gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
        return [int(cells[k]) for k in chosen]


def _joined(number: Array) -> csr_matrix:
    """Of a grid of cell numbers (-1: not free): the graph of free neighbours, diagonals too, weighted by distance."""
    ends: list[tuple[Array, Array, float]] = []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = number[: number.shape[0] - dx, max(0, -dy) : number.shape[1] - max(0, dy)]
        b = number[dx:, max(0, dy) : number.shape[1] - max(0, -dy)]
        both = (a >= 0) & (b >= 0)
        ends.append((a[both], b[both], _CELL_M * float(np.hypot(dx, dy))))
    rows, columns = np.concatenate([a for a, _, _ in ends]), np.concatenate([b for _, b, _ in ends])
    weights = np.concatenate([np.full(len(a), w) for a, _, w in ends])
    n = int(number.max()) + 1
    both_ways = (np.concatenate([rows, columns]), np.concatenate([columns, rows]))
    return coo_matrix((np.concatenate([weights, weights]), both_ways), shape=(n, n)).tocsr()
