"""What is seen, reached and blocked, and from where: measured when somebody asks.

These relations depend on a viewer or on a robot's body, and each costs a look at the map, so nothing of them is stored:
a question that has one of their words is preceded by the measurements that it may need.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from mapping.observations import RobotDescription
from mapping.occupancy import FREE, OccupancyMap
from scenegraph.graph import Node, SceneGraph
from scenegraph.perception.building import Building
from scenegraph.perception.relations import NO_PATH_M, MeasurementChange
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

WORDS = frozenset({"visible_from", "reachable", "blocks"})
SIGHT_M = 10.0
"""Farther than this nothing is looked for."""
SIGHT_RAYS = 48
EYE_M = 1.2
"""Height of the eyes of a robot that did not say how tall it is, and of whoever stands at a place."""
REACH_M = 0.8
"""How far a robot reaches that did not say so."""
CELL_M = 0.1
WINDOW_M = 10.0
"""Ways are looked for within this distance of the robot, along both axes."""
OVER_M = 0.08
"""What is lower than this is driven over."""
DOORWAY_DEEP_M = 0.35
"""What stands no farther than this before or behind the middle of a door stands in it."""
ALONG_WALL_M = 0.6
"""The wall that a door is in is no farther from it than this."""
_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Body:
    """What matters of a robot: radius of its disc, height and reach [m]."""

    radius_m: float
    height_m: float = EYE_M
    reach_m: float = REACH_M


class Access:
    """Measures for questions, in the world as it stands.

    shapes: the things' shapes by node id; robots: by name; radius_m: of a robot that did not describe itself
    """

    def __init__(
        self,
        graph: SceneGraph,
        shapes: Mapping[str, Shape],
        occupancy: OccupancyMap,
        building: Building,
        robots: Mapping[str, RobotDescription],
        radius_m: float,
    ) -> None:
        self._graph = graph
        self._shapes = shapes
        self._occupancy = occupancy
        self._building = building
        self._robots = robots
        self._radius_m = radius_m

    def measure(self, goal: str) -> MeasurementChange:
        """All that the words in a goal may need: of the robots there are, and of the nodes that it names."""
        words = set(_NAME.findall(goal))
        found: dict[tuple[str, ...], float] = {}
        named = [self._graph.node(word) for word in sorted(words) if word in self._graph]
        agents = list(self._graph.nodes("agent"))
        if "visible_from" in words:
            viewers = {node.id: node for node in [*agents, *named] if node.layer in ("agent", "place", "object")}
            for viewer in viewers.values():
                found |= self._sight(viewer)
        if "reachable" in words:
            for agent in agents:
                found |= self._ways(agent)
        if "blocks" in words:
            for door in sorted({edge.source for edge in self._graph.edges("connects")}):
                found |= self._blocked(self._graph.node(door))
        return MeasurementChange(put=found)

    def _body(self, agent: Node) -> Body:
        known = self._robots.get(agent.id.removeprefix("agent_"))
        if known is None:
            return Body(self._radius_m)
        return Body(known.radius_m, known.height_m, known.reach_m or REACH_M)

    # -- sight --------------------------------------------------------------------------------------------
    def _sight(self, viewer: Node) -> dict[tuple[str, ...], float]:
        """Shares of rays from the viewer's eyes to points of a thing that meet the thing first: surely, and perhaps."""
        eye = viewer.position.copy()
        if viewer.layer != "object":
            eye[2] += self._body(viewer).height_m if viewer.layer == "agent" else EYE_M
        found: dict[tuple[str, ...], float] = {}
        near = [
            (name, shape)
            for name, shape in self._shapes.items()
            if name != viewer.id and np.linalg.norm(0.5 * sum(shape.bounds) - eye) <= SIGHT_M
        ]
        if not near:
            return found
        targets = [shape.points[_spread(len(shape.points), SIGHT_RAYS)].astype(np.float64) for _, shape in near]
        rays = np.concatenate(targets) - eye
        hits = self._occupancy.cast(eye, rays, 2.0 * SIGHT_M)
        slack = self._occupancy.voxel_size_m
        at = 0
        for (name, shape), points in zip(near, targets, strict=True):
            mine = slice(at, at + len(points))
            at += len(points)
            low, high = shape.bounds
            met = ((hits.points[mine] >= low - 1.5 * slack) & (hits.points[mine] <= high + 1.5 * slack)).all(axis=1)
            arrives = np.linalg.norm(points - eye, axis=1)
            met |= hits.distance_m[mine] >= arrives - slack
            known = hits.unknown_at_m[mine] >= np.minimum(hits.distance_m[mine], arrives) - 1.5 * slack
            found["visible", name, viewer.id] = float((met & known).mean())
            found["possibly_visible", name, viewer.id] = float(met.mean())
        return found

    # -- ways ---------------------------------------------------------------------------------------------
    def _ways(self, agent: Node) -> dict[tuple[str, ...], float]:
        """Length of the shortest way of a robot's disc to where it reaches each thing: over ground that was seen to be
        free, and over ground that may be; NO_PATH_M where there is none."""
        body = self._body(agent)
        start = agent.position[:2]
        origin = np.floor((start - WINDOW_M) / CELL_M).astype(np.int64)
        shape = (round(2 * WINDOW_M / CELL_M),) * 2
        x, y, z = agent.position.tolist()
        floor = self._building.floor_below(x, y, z)
        floor_z = z if floor is None else floor[1]
        cells = (np.indices(shape).reshape(2, -1).T + origin + 0.5) * CELL_M
        surely, perhaps = self._passable(origin, shape, floor_z, body.height_m)
        found: dict[tuple[str, ...], float] = {}
        lengths = {name: self._lengths(ground, start, origin, body) for name, ground in
                   (("way_upper", surely), ("way_lower", perhaps))}  # fmt: skip
        for thing, its in self._shapes.items():
            low, high = its.bounds
            if (
                (high[:2] < cells[0]) | (low[:2] > cells[-1])
            ).any() or not floor_z - 0.5 <= its.lowest <= floor_z + 2.5:
                continue
            reach = body.radius_m + body.reach_m
            window = ((cells >= low[:2] - reach) & (cells <= high[:2] + reach)).all(axis=1)
            away = shapely.distance(shapely.points(cells[window]), shapely.MultiPoint(its.hull).convex_hull)
            for name, length in lengths.items():
                least = length.ravel()[window][away <= reach].min(initial=NO_PATH_M)
                found[name, thing, agent.id] = float(min(least, NO_PATH_M))
        return found

    def _passable(self, origin: Array, shape: tuple[int, int], floor_z: float, height_m: float) -> tuple[Array, Array]:
        """(W, H) bool: where nothing stands up to a height, half of it seen at least; and where nothing is known to."""
        low = np.array([*(origin * CELL_M), floor_z + OVER_M])
        codes, first = self._occupancy.box(low, low + np.array([*(np.array(shape) * CELL_M), height_m - OVER_M]))
        filled = np.asarray((codes > FREE).any(axis=2))
        seen = np.asarray((codes == FREE).sum(axis=2) >= 0.5 * codes.shape[2])
        centres = (np.indices(shape).reshape(2, -1).T + origin + 0.5) * CELL_M
        ij = np.floor(centres / self._occupancy.voxel_size_m).astype(np.int64) - first[:2]
        ij = np.clip(ij, 0, np.array(filled.shape) - 1)
        clear = ~filled[ij[:, 0], ij[:, 1]]
        return (clear & seen[ij[:, 0], ij[:, 1]]).reshape(shape), clear.reshape(shape)

    @staticmethod
    def _lengths(passable: Array, start: Array, origin: Array, body: Body) -> Array:
        """(W, H) shortest way [m] from where the robot stands to each cell that its disc fits in; inf elsewhere."""
        room = ndimage.distance_transform_edt(np.pad(passable, 1))[1:-1, 1:-1] * CELL_M
        cell = np.floor(start / CELL_M).astype(np.int64) - origin
        beside = np.hypot(*(np.indices(room.shape) - cell[:, None, None])) * CELL_M
        fits = (room > body.radius_m) | (beside <= 2.0 * body.radius_m)  # it fits where it stands
        number = np.full(fits.shape, -1)
        number[fits] = np.arange(fits.sum())
        rows, columns, costs = [], [], []
        for i, j in ((1, 0), (0, 1), (1, 1), (1, -1)):
            a = number[: len(number) - i, max(0, -j) : number.shape[1] - max(0, j)]
            b = number[i:, max(0, j) : number.shape[1] - max(0, -j)]
            both = (a >= 0) & (b >= 0)
            rows.append(a[both])
            columns.append(b[both])
            costs.append(np.full(int(both.sum()), CELL_M * np.hypot(i, j)))
        n = int(fits.sum())
        steps = coo_array((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n))
        lengths = np.full(fits.shape, np.inf)
        lengths[fits] = dijkstra(steps.tocsr(), directed=False, indices=int(number[tuple(cell)]))
        return lengths

    # -- doors --------------------------------------------------------------------------------------------
    def _blocked(self, door: Node) -> dict[tuple[str, ...], float]:
        """The widest part of a door's opening that each thing in it leaves clear [m]."""
        width = max((float(edge.value or 0.0) for edge in self._graph.edges("connects", source=door.id)), default=0.0)
        along = self._along(door)
        if along is None or width <= 0.0:
            return {}
        across = np.array([-along[1], along[0]])
        corners = [
            u * 0.5 * width * along + v * DOORWAY_DEEP_M * across for u, v in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        doorway = shapely.Polygon(door.position[:2] + np.array(corners))
        found: dict[tuple[str, ...], float] = {}
        for thing, shape in self._shapes.items():
            if thing == door.id or self._graph.node(thing).layer != "object" or len(shape.hull) < 3:
                continue
            floor = self._building.floor_below(*door.position.tolist())
            if floor is None or not floor[1] + OVER_M < shape.highest or shape.lowest > floor[1] + EYE_M:
                continue
            inside = shapely.Polygon(shape.hull).intersection(doorway)
            if inside.is_empty or not inside.area:
                continue
            at = (shapely.get_coordinates(inside) - door.position[:2]) @ along
            found["clear_width", thing, door.id] = float(max(at.min() + 0.5 * width, 0.5 * width - at.max()))
        return found

    def _along(self, door: Node) -> Array | None:
        """The direction (2,) along the wall that a door is in, else along its leaf."""
        at = np.array([*door.position[:2], door.position[2]])
        walls = self._building.walls_beside(at - ALONG_WALL_M, at + ALONG_WALL_M)
        near = sorted((abs(float(at[:2] @ wall.normal - wall.offset)), wall.node) for wall in walls)
        if near and near[0][0] <= ALONG_WALL_M:
            return next(wall.along for wall in walls if wall.node == near[0][1])
        if door.id in self._shapes:
            yaw = self._shapes[door.id].rectangle[4]
            return np.array([np.cos(yaw), np.sin(yaw)])
        return None


def asks_for(goal: str) -> bool:
    """Whether a goal has a word that must be measured for."""
    return not WORDS.isdisjoint(_NAME.findall(goal))


def outdated(before: Iterable[tuple[str, ...]], now: MeasurementChange) -> list[tuple[str, ...]]:
    """What was measured for an earlier question and not for this one."""
    return [key for key in before if key not in now.put]


def _spread(n: int, most: int) -> Array:
    """Indices of at most `most` of n things, evenly chosen."""
    return np.linspace(0, n - 1, min(n, most)).astype(np.int64)
