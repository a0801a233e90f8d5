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
from scenegraph.perception.free_places import FLOOR_BAND_M
from scenegraph.perception.relations import NO_PATH_M, MeasurementChange
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

WORDS = frozenset({"visible_from", "reachable", "can_reach", "blocks", "between"})
SIGHT_M = 10.0
"""Farther than this nothing is looked for."""
SIGHT_RAYS = 48
EYE_M = 1.2
"""Height of the eyes of a robot that did not say how tall it is, and of whoever stands at a place."""
REACH_M = 0.8
"""How far a robot reaches that did not say so."""
CELL_M = 0.05
"""Ways are looked for on ground cells of this width, or as wide as a voxel."""
FREE_SHARE = 0.5
"""Ground is known to be free when this share of the space over it was seen to be."""
WINDOW_M = 15.0
"""Ways are looked for within this distance of the robot, along both axes; whether one leads farther is not known."""
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
        if not words.isdisjoint({"reachable", "can_reach"}):
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
        """Shares of rays from the viewer's eyes to points of a thing that meet the thing first: surely, and perhaps.

        A voxel stands up to its width beyond the surface in it and would hide what lies flat behind, so rays pass that
        much above the points, or below those over the eyes (Holbert, *Normal offset shadows*, 2011).
        """
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
        slack = self._occupancy.voxel_size_m
        targets = [shape.points[_spread(len(shape.points), SIGHT_RAYS)].astype(np.float64) for _, shape in near]
        for points in targets:
            points[:, 2] += slack * np.sign(eye[2] - points[:, 2])
        rays = np.concatenate(targets) - eye
        hits = self._occupancy.cast(eye, rays, 2.0 * SIGHT_M)
        at = 0
        for (name, shape), points in zip(near, targets, strict=True):
            mine = slice(at, at + len(points))
            at += len(points)
            met = shape.box.contains(hits.points[mine], 1.5 * slack)
            arrives = np.linalg.norm(points - eye, axis=1)
            met |= hits.distance_m[mine] >= arrives - slack
            known = hits.unknown_at_m[mine] >= np.minimum(hits.distance_m[mine], arrives) - 1.5 * slack
            found["visible", name, viewer.id] = float((met & known).mean())
            found["possibly_visible", name, viewer.id] = float(met.mean())
        return found

    # -- ways ---------------------------------------------------------------------------------------------
    def _ways(self, agent: Node) -> dict[tuple[str, ...], float]:
        """Length of the shortest way of a robot's disc to where it reaches each thing: over ground that was seen to be
        free, and over ground that may be, where voxels are filled half; NO_PATH_M where there is none."""
        body = self._body(agent)
        start = agent.position[:2]
        floor = self._building.floor_below(*agent.position.tolist())
        floor_z = float(agent.position[2]) if floor is None else floor[1]
        reach = body.radius_m + body.reach_m
        found: dict[tuple[str, ...], float] = {}
        about: dict[str, Shape] = {}
        for thing, shape in self._shapes.items():
            if not floor_z - 0.5 <= shape.lowest <= floor_z + 2.5:
                continue
            away = np.maximum(np.maximum(shape.bounds[0][:2] - start, start - shape.bounds[1][:2]), 0.0)
            if (away <= WINDOW_M).all():
                about[thing] = shape
            else:
                found["way_upper", thing, agent.id] = NO_PATH_M
                found["way_lower", thing, agent.id] = max(0.0, float(np.hypot(*away)) - reach)
        corners = np.array([start, *(bound[:2] for shape in about.values() for bound in shape.bounds)])
        low = np.maximum(corners.min(axis=0) - 2.0 * reach, start - WINDOW_M)
        high = np.minimum(corners.max(axis=0) + 2.0 * reach, start + WINDOW_M)
        surely, perhaps, origin, cell_m = passable_ground(self._occupancy, low, high, floor_z, body.height_m)
        xs, ys = ((first + 0.5 + np.arange(n)) * cell_m for first, n in zip(origin, surely.shape, strict=True))
        at = np.floor(start / cell_m).astype(np.int64) - origin
        lengths = {
            name: _lengths(ground, at, max(0.0, radius) / cell_m) * cell_m
            for name, ground, radius in (
                ("way_upper", surely, body.radius_m - 0.5 * cell_m),  # its middle need not be the middle of a cell
                ("way_lower", perhaps, body.radius_m - self._occupancy.voxel_size_m),
            )
        }
        for thing, shape in about.items():
            near = tuple(
                slice(*np.searchsorted(axis, (shape.bounds[0][k] - reach, shape.bounds[1][k] + reach)))
                for k, axis in enumerate((xs, ys))
            )
            there = np.argwhere(np.isfinite(lengths["way_lower"][near]))
            cells = np.column_stack([xs[near[0]][there[:, 0]], ys[near[1]][there[:, 1]]])
            hand = self._in_reach(shape, cells, reach)
            there = there[hand]
            for name, length in lengths.items():
                least = length[near][there[:, 0], there[:, 1]].min(initial=NO_PATH_M)
                found[name, thing, agent.id] = float(min(least, NO_PATH_M))
        return found

    def _in_reach(self, shape: Shape, cells: Array, reach: float) -> Array:
        """(N,) bool: from which ground points (N, 2) a thing is no farther than `reach`, and not behind a wall."""
        hull = shapely.MultiPoint(shape.hull).convex_hull
        shapely.prepare(hull)
        points = shapely.points(cells)
        found = shapely.dwithin(points, hull, reach)
        if found.any():
            ends = shapely.get_coordinates(shapely.shortest_line(points[found], hull)).reshape(-1, 2, 2)
            ends = np.concatenate([ends, np.full((len(ends), 2, 1), 0.5 * (shape.lowest + shape.highest))], axis=2)
            found[found] = ~self._building.walled(ends[:, 0], ends[:, 1])
        return np.asarray(found)

    # -- doors --------------------------------------------------------------------------------------------
    def _blocked(self, door: Node) -> dict[tuple[str, ...], float]:
        """The widest part of a door's opening that each thing in it leaves clear [m].

        The opening is where the way through it is: the leaf of a door ajar stands beside that.
        """
        edges = self._graph.edges("connects", source=door.id)
        width = max((float(edge.value or 0.0) for edge in edges), default=0.0)
        middle = next((np.array(e.attributes["at"]) for e in edges if "at" in e.attributes), door.position[:2])
        along = self._along(door, middle)
        if along is None or width <= 0.0:
            return {}
        across = np.array([-along[1], along[0]])
        corners = [
            u * 0.5 * width * along + v * DOORWAY_DEEP_M * across for u, v in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        doorway = shapely.Polygon(middle + np.array(corners))
        floor = self._building.floor_below(float(middle[0]), float(middle[1]), float(door.position[2]))
        if floor is None:
            return {}
        found: dict[tuple[str, ...], float] = {}
        for thing, shape in self._shapes.items():
            if thing == door.id or self._graph.node(thing).layer != "object" or len(shape.hull) < 3:
                continue
            if not floor[1] + FLOOR_BAND_M[1] < shape.highest or shape.lowest > floor[1] + EYE_M:
                continue
            inside = shapely.Polygon(shape.hull).intersection(doorway)
            if inside.is_empty or not inside.area:
                continue
            at = (shapely.get_coordinates(inside) - middle) @ along
            found["clear_width", thing, door.id] = float(max(at.min() + 0.5 * width, 0.5 * width - at.max()))
        return found

    def _along(self, door: Node, middle: Array) -> Array | None:
        """The direction (2,) along the wall that a door with its opening at `middle` (2,) is in, else along its
        leaf."""
        at = np.array([*middle, door.position[2]])
        walls = self._building.walls_beside(at - ALONG_WALL_M, at + ALONG_WALL_M)
        near = sorted((abs(float(at[:2] @ wall.normal - wall.offset)), wall.node) for wall in walls)
        if near and near[0][0] <= ALONG_WALL_M:
            return next(wall.along for wall in walls if wall.node == near[0][1])
        if door.id in self._shapes:
            yaw = self._shapes[door.id].rectangle[4]
            return np.array([np.cos(yaw), np.sin(yaw)])
        return None


def passable_ground(
    occupancy: OccupancyMap, low: Array, high: Array, floor_z: float, height_m: float
) -> tuple[Array, Array, Array, float]:
    """Over the ground from corner `low` to `high` (2,): (W, H) bool where nothing stands up to a height, half of it
    seen at least; where nothing is known to; the first cell (2,), and how wide a cell is [m]."""
    voxel = occupancy.voxel_size_m
    wide = max(1, int(CELL_M / voxel + 1e-6))
    origin = np.floor(low / (wide * voxel)).astype(np.int64)
    shape = np.floor(high / (wide * voxel)).astype(np.int64) - origin + 1
    box = np.array([[*(origin * wide * voxel), floor_z], [*((origin + shape) * wide * voxel), floor_z + height_m]])
    codes, first = occupancy.box(*box)
    over = (first[2] + 0.5 + np.arange(codes.shape[2])) * voxel - floor_z
    codes = codes[: shape[0] * wide, : shape[1] * wide, (over > FLOOR_BAND_M[1]) & (over < height_m)]
    codes = codes.reshape(shape[0], wide, shape[1], wide, -1)
    clear = np.asarray(~(codes > FREE).any(axis=(1, 3, 4)))
    seen = (codes == FREE).mean(axis=(1, 3, 4)) >= FREE_SHARE
    return np.asarray(clear & seen), clear, origin, wide * voxel


def _lengths(passable: Array, start: Array, radius: float) -> Array:
    """(W, H) shortest way from cell `start` to each cell that a disc fits in, in cells; inf elsewhere.

    Where the disc stands it fits, whatever the map says, and it gets from there to where it fits a radius away.
    """
    room = ndimage.distance_transform_edt(np.pad(passable, 1))[1:-1, 1:-1]
    beside = np.hypot(*(np.indices(room.shape) - start[:, None, None]))
    there = beside == 0.0
    fits = (room > radius) | there | (passable & (beside <= radius))
    number = np.full(fits.shape, -1)
    number[fits] = np.arange(fits.sum())
    rows, columns, costs = [], [], []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = number[: len(number) - i, max(0, -j) : number.shape[1] - max(0, j)]
        b = number[i:, max(0, j) : number.shape[1] - max(0, -j)]
        both = (a >= 0) & (b >= 0)
        rows.append(a[both])
        columns.append(b[both])
        costs.append(np.full(int(both.sum()), np.hypot(i, j)))
    n = int(fits.sum())
    steps = coo_array((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n))
    lengths = np.full(fits.shape, np.inf)
    lengths[fits] = dijkstra(steps.tocsr(), directed=False, indices=int(number[tuple(start)]))
    return np.asarray(np.where((room > radius) | there, lengths, np.inf))


def asks_for(goal: str) -> bool:
    """Whether a goal has a word that must be measured for."""
    return not WORDS.isdisjoint(_NAME.findall(goal))


def asks_between(goal: str) -> bool:
    """Whether a goal asks what lies between things, for which their ground projections must be known."""
    return "between" in _NAME.findall(goal)


def outdated(before: Iterable[tuple[str, ...]], now: MeasurementChange) -> list[tuple[str, ...]]:
    """What was measured for an earlier question and not for this one."""
    return [key for key in before if key not in now.put]


def _spread(n: int, most: int) -> Array:
    """Indices of at most `most` of n things, evenly chosen."""
    return np.linspace(0, n - 1, min(n, most)).astype(np.int64)
