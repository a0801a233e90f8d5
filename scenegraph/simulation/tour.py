"""A robot's way through a home: where it stands, and where it looks, so that nearly everything is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from scenegraph.simulation.arrangement import ROBOT_RADIUS_M, free_floor
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home

CAMERA_HEIGHT_M = 1.3
_CELL_M = 0.1
_LOOKS = 7  # views from one standpoint: six around, one up


@dataclass(frozen=True)
class Step:
    """Where the robot and its camera (optical frame) truly are, and in which room."""

    T_map_base: SE3
    T_map_camera: SE3
    room: str


class Tour:
    """The steps of one way through all rooms of a home.

    images_per_room   about how many views the robot takes in each room, ≥ 7
    """

    def __init__(self, home: Home, *, images_per_room: int = 30) -> None:
        if images_per_room < _LOOKS:
            raise InvalidParameter(f"images_per_room: expected at least {_LOOKS}, got {images_per_room}")
        self.home = home
        self._grid = _Grid(home)
        self.steps: tuple[Step, ...] = tuple(self._walk(images_per_room))

    def __len__(self) -> int:
        return len(self.steps)

    def _walk(self, images_per_room: int) -> list[Step]:
        steps: list[Step] = []
        here = self._grid.start()
        for room in self._grid.order(here):
            spots = self._grid.spread(room, max(1, round(images_per_room / _LOOKS)))
            while spots:
                spots.sort(key=lambda s: self._grid.distance(here, s))
                there = spots.pop(0)
                steps.extend(self._on_the_way(here, there))
                steps.extend(self._look_around(there, room, len(spots)))
                here = there
        return steps

    def _on_the_way(self, here: int, there: int) -> list[Step]:
        path = self._grid.path(here, there)
        steps = []
        last = path[0]
        for a, b in zip(path[:-1], path[1:], strict=True):
            if np.linalg.norm(b - last) > 0.8:
                heading = float(np.arctan2(*(b - a)[::-1]))
                steps.append(self._step(b, heading, -0.35, self._grid.room_at(b)))
                last = b
        return steps

    def _look_around(self, cell: int, room: str, phase: int) -> list[Step]:
        spot = self._grid.points[cell]
        pitch = -0.28 if phase % 2 else -0.5
        first = phase * 0.5
        steps = [self._step(spot, first + k * np.pi / 3, pitch, room) for k in range(_LOOKS - 1)]
        return [*steps, self._step(spot, first + phase * 1.9, 0.6, room)]

    def _step(self, spot: Array, heading: float, pitch: float, room: str) -> Step:
        """At `spot` (2,) in the home's frame, looking along `heading` there, `pitch` [rad] above the horizon."""
        c, s = np.cos(heading), np.sin(heading)
        T_home_base = SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), [spot[0], spot[1], 0.0])
        cp, sp = np.cos(pitch), np.sin(pitch)
        forward, right = np.array([cp, 0.0, sp]), np.array([0.0, -1.0, 0.0])
        optical = np.stack([right, np.cross(forward, right), forward], axis=1)
        T_base_camera = SE3(optical, [0.0, 0.0, CAMERA_HEIGHT_M])
        T_map_base = self.home.T_map_home @ T_home_base
        return Step(T_map_base, T_map_base @ T_base_camera, room)


class _Grid:
    """The floor a robot can be on, as cells of 0.1 m in the home's frame, joined where it can drive."""

    def __init__(self, home: Home) -> None:
        self._home = home
        plan = home.plan
        floor: Any = free_floor(plan, plan.rooms, home.placed, ROBOT_RADIUS_M + 0.03)
        xs = np.arange(0.0, plan.width, _CELL_M)
        ys = np.arange(0.0, plan.depth, _CELL_M)
        gx, gy = np.meshgrid(xs, ys, indexing="ij")
        shapely.prepare(floor)
        free = shapely.contains_xy(floor, gx, gy)
        number = np.full(free.shape, -1)
        number[free] = np.arange(free.sum())
        self.points: Array = np.stack([gx[free], gy[free]], axis=1)
        self._graph = _joined(number)
        self._from: dict[int, tuple[Array, Array]] = {}
        self._room = np.array([self._find_room(p) for p in self.points])
        reach = np.isfinite(self._reach(self.start())[0])
        self._reachable = reach

    def _find_room(self, p: Array) -> str:
        rooms = self._home.plan.rooms
        outside = [max(r.x0 - p[0], p[0] - r.x1, r.y0 - p[1], p[1] - r.y1) for r in rooms]
        return rooms[int(np.argmin(outside))].id

    def room_at(self, p: Array) -> str:
        """The room at a point (2,) in the home's frame."""
        return self._find_room(p)

    def start(self) -> int:
        """A free cell in the middle of the hallway."""
        hall = self._home.plan.room("hallway")
        middle = np.array([(hall.x0 + hall.x1) / 2, (hall.y0 + hall.y1) / 2])
        return int(np.linalg.norm(self.points - middle, axis=1).argmin())

    def _reach(self, cell: int) -> tuple[Array, Array]:
        if cell not in self._from:
            distance, before = dijkstra(self._graph, indices=cell, return_predecessors=True)
            self._from[cell] = distance, before
        return self._from[cell]

    def distance(self, here: int, there: int) -> float:
        """Length of the way between two cells [m]."""
        return float(self._reach(here)[0][there])

    def path(self, here: int, there: int) -> Array:
        """(n, 2) points of the way between two cells."""
        before = self._reach(here)[1]
        cells = [there]
        while cells[-1] != here:
            cells.append(int(before[cells[-1]]))
        return np.asarray(self.points[cells[::-1]])

    def order(self, here: int) -> Sequence[str]:
        """The rooms, each next one the nearest."""
        distance = self._reach(here)[0]
        left = [r.id for r in self._home.plan.rooms if np.any((self._room == r.id) & self._reachable)]
        order = []
        while left:
            nearest = min(left, key=lambda room: float(distance[self._room == room].min()))
            left.remove(nearest)
            order.append(nearest)
            inside = np.flatnonzero((self._room == nearest) & self._reachable)
            distance = self._reach(int(inside[np.argmin(distance[inside])]))[0]
        return order

    def spread(self, room: str, count: int) -> list[int]:
        """Up to `count` reachable cells of a room, as far from each other as can be (farthest-point sampling)."""
        cells = np.flatnonzero((self._room == room) & self._reachable)
        points = self.points[cells]
        chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
        gap = np.linalg.norm(points - points[chosen[0]], axis=1)
        while len(chosen) < count and gap.max() > 0.3:
            chosen.append(int(gap.argmax()))
            gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
        return [int(cells[k]) for k in chosen]


def _joined(number: Array) -> csr_matrix:
    """Of a grid of cell numbers (-1: not free): the graph of free neighbours, diagonals too, weighted by distance."""
    rows, columns, weights = [], [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = number[: number.shape[0] - dx, max(0, -dy) : number.shape[1] - max(0, dy)]
        b = number[dx:, max(0, dy) : number.shape[1] - max(0, -dy)]
        both = (a >= 0) & (b >= 0)
        rows.append(a[both])
        columns.append(b[both])
        weights.append(np.full(int(both.sum()), _CELL_M * np.hypot(dx, dy)))
    r, c, w = np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)
    n = int(number.max()) + 1
    graph = coo_matrix((np.concatenate([w, w]), (np.concatenate([r, c]), np.concatenate([c, r]))), shape=(n, n))
    return graph.tocsr()
