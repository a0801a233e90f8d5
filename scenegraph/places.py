"""Where a phrase means, and where a robot can stand for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from mapping.geometry import SE3
from mapping.observations import RobotDescription
from mapping.occupancy import OccupancyMap
from reasoning.knowledge import KnowledgeBase, Phrase, Problem
from reasoning.terms import Atom, Compound, Var
from scenegraph.answers import GoalPose, Place, PlaceAnswer, Region
from scenegraph.graph import Node, SceneGraph
from scenegraph.phrases import ambiguous
from scenegraph.standing import Standing

Array: TypeAlias = NDArray[Any]

FloorBelow: TypeAlias = Callable[[float, float, float], tuple[str, float] | None]
"""The floor under a point: its node id and height [m]."""

DEFAULT_HEIGHT_M = 1.2
STAND_OFF_M = 1.2
"""How far from a thing a robot may stand for it."""
FARTHEST_M = 24.0
"""Whether a robot gets farther than this from where it is, along both axes, is not looked for."""
DETOURS_M = (3.0, 12.0)
"""A way may lead so far around robot and goal: where none is found within the first, the second is tried."""
MOST_POSES = 5
MOST_ANSWERS = 20
BESIDE = frozenset(
    {"near", "next_to", "in_front_of", "behind", "left_of", "right_of", "under", "above", "on", "between"}
)


class PlaceFinder:
    """Turns a phrase or a goal into regions and reachable poses in the world as it stands."""

    def __init__(
        self,
        graph: SceneGraph,
        occupancy: OccupancyMap,
        knowledge: KnowledgeBase,
        robots: Mapping[str, RobotDescription],
        robot_radius_m: float,
        floor_below: FloorBelow = lambda x, y, z: None,
    ) -> None:
        self._graph = graph
        self._occupancy = occupancy
        self._knowledge = knowledge
        self._robots = robots
        self._radius_m = robot_radius_m
        self._floor_below = floor_below
        self._known: dict[tuple[Any, ...], tuple[tuple[Array, Array], Standing]] = {}

    def find(self, phrase: str, understood: Phrase, robot: str | None) -> Place:
        """Where a phrase that was `read` is; see `World.where`."""
        if understood.problem is not None:
            return Place("unknown", phrase, problem=understood.problem)
        viewer = None if robot is None else f"agent_{robot}"
        reply = self._knowledge.ask(understood.goal, limit=MOST_ANSWERS, timeout_s=1.0, viewer=viewer)
        if reply.problem is not None:
            return Place("unknown", phrase, problem=reply.problem)
        groups = {}
        for row in reply.answers:
            names = understood.variables or tuple(row)
            ids = tuple(t.name for n in names if isinstance(t := row.get(n), Atom) and t.name in self._graph)
            groups[ids] = [self._graph.node(node_id) for node_id in ids]
        answers = [self._place(nodes, understood.relation, robot) for nodes in groups.values() if nodes]
        answers.sort(key=_rank)
        several = ambiguous(understood, reply)
        unclear = next((several[name] for name in (*understood.variables, *several) if name in several), ())
        return Place(reply.truth, phrase, tuple(answers), unclear)

    def read(self, phrase: str) -> Phrase:
        """What is meant: a goal is about all of its variables."""
        if "(" in phrase:
            return Phrase("thing", phrase)
        understood = self._knowledge.phrase(phrase)
        if understood.problem is None and understood.kind == "question":
            said = "this asks for a number, a value, or yes and no, and not for a place"
            return Phrase("question", "", problem=Problem("not_a_place", said, "ask it instead"))
        return understood

    # -- regions ------------------------------------------------------------------------------------------
    def _place(self, nodes: Sequence[Node], relation: str | None, robot: str | None) -> PlaceAnswer:
        footprint, z_min, z_max = self._ground(nodes)
        if relation in BESIDE and relation not in ("on", "under", "above"):
            reach = max(self._near_distance(n) for n in nodes)
            region = footprint.buffer(reach).difference(footprint)
        else:
            region = footprint
        return PlaceAnswer(
            nodes=tuple(n.id for n in nodes),
            region=Region(tuple((round(x, 3), round(y, 3)) for x, y in _outer(region)), z_min, z_max),
            poses=tuple(self._poses(nodes, footprint, z_min, robot)),
        )

    @staticmethod
    def _ground(nodes: Sequence[Node]) -> tuple[shapely.Geometry, float, float]:
        """The ground that nodes cover together, and the range of their heights."""
        parts, low, high = [], math.inf, -math.inf
        for node in nodes:
            outline = node.attributes.get("footprint")
            if outline:
                parts.append(shapely.Polygon(outline))
            if node.box is not None:
                corners = node.box.corners()
                low, high = min(low, corners[:, 2].min()), max(high, corners[:, 2].max())
                if not outline:
                    parts.append(shapely.MultiPoint(corners[:, :2]).convex_hull)
            elif not outline:
                low, high = min(low, node.position[2]), max(high, node.position[2])
                parts.append(shapely.Point(node.position[:2]).buffer(0.05))
        return shapely.union_all(parts).buffer(0.0), float(low), float(high)

    def _near_distance(self, node: Node) -> float:
        """How near is near to this thing for a robot, as the rules say."""
        goal = Compound("near_distance", (Atom(node.id), Atom(node.id), Var("D")))
        rows = self._knowledge.call(goal, limit=1)
        return float(rows[0]["D"]) if rows else 1.0  # type: ignore[arg-type]

    def beside(
        self, node: Node, robot: str | None, most: int = MOST_POSES, start: Array | None = None
    ) -> list[GoalPose]:
        """Free poses for a robot beside a thing, looking at it, best first; reachable from `start` (2,) [m], or from
        where the robot is."""
        footprint, z_min, _ = self._ground([node])
        return self._poses([node], footprint, z_min, robot, most, start)

    # -- poses --------------------------------------------------------------------------------------------
    def _poses(
        self,
        nodes: Sequence[Node],
        footprint: shapely.Geometry,
        z_min: float,
        robot: str | None,
        most: int = MOST_POSES,
        start: Array | None = None,
    ) -> list[GoalPose]:
        """Free, reachable poses that look at the nodes: for a room inside it, else beside the things."""
        start = self._robot_at(robot) if start is None else start
        if start is not None and np.abs(start - np.array(footprint.centroid.coords[0])).max() > FARTHEST_M:
            start = None
        floor_z = self._floor_z(nodes, footprint, z_min)
        for detour_m in DETOURS_M if start is not None else (0.0,):
            standing = self._standing(footprint, floor_z, robot, start, detour_m)
            poses = self._chosen(nodes, footprint, standing, floor_z, robot, most)
            if poses:
                return poses
        return []

    def _chosen(
        self,
        nodes: Sequence[Node],
        footprint: shapely.Geometry,
        standing: Standing,
        floor_z: float,
        robot: str | None,
        most: int,
    ) -> list[GoalPose]:
        """The best of where a robot can stand, no two close together."""
        inside = all(n.layer == "room" for n in nodes)
        xy = standing.xy
        if not len(xy):
            return []
        if inside:
            away = np.where(shapely.contains_xy(footprint, xy[:, 0], xy[:, 1]), 0.0, np.inf)
            badness = away - standing.clearance_m
        else:
            away = shapely.distance(shapely.points(xy), footprint)
            near = away <= STAND_OFF_M + self._radius(robot)
            rooms = [shapely.Polygon(r.attributes["footprint"]) for r in self._rooms_of(nodes)]
            if rooms:  # a place behind the wall is no place beside the thing
                near &= shapely.contains_xy(shapely.union_all(rooms), xy[:, 0], xy[:, 1])
            badness = np.where(near, away, np.inf) - 0.3 * np.minimum(standing.clearance_m, 1.0)
        focus = np.array(footprint.centroid.coords[0])
        poses: list[GoalPose] = []
        chosen: list[Array] = []
        for at in np.argsort(badness, kind="stable"):
            if not np.isfinite(badness[at]) or len(poses) == most:
                break
            if any(np.linalg.norm(xy[at] - other) < 0.4 for other in chosen):
                continue
            chosen.append(xy[at])
            yaw = math.atan2(*(focus - xy[at])[::-1])
            pose = SE3(SE3.exp([0, 0, 0, 0, 0, yaw]).rotation, (*xy[at], floor_z))
            poses.append(GoalPose(pose, round(float(standing.clearance_m[at]), 2), standing.way_m(int(at))))
        return poses

    def _standing(
        self, footprint: shapely.Geometry, floor_z: float, robot: str | None, start: Array | None, detour_m: float
    ) -> Standing:
        """The ground about things, with that on ways from the robot that lead no farther around than a detour."""
        low = np.array(footprint.bounds[:2]) - STAND_OFF_M - 0.5
        high = np.array(footprint.bounds[2:]) + STAND_OFF_M + 0.5
        if start is not None:
            low, high = np.minimum(low, start) - detour_m, np.maximum(high, start) + detour_m
        key = (robot, round(floor_z, 2), None if start is None else tuple(start.tolist()))
        window, known = self._known.get(key, ((low, high), None))
        if known is None or (low < window[0]).any() or (high > window[1]).any():
            window = (np.minimum(low, window[0]), np.maximum(high, window[1])) if start is not None else (low, high)
            known = Standing.between(
                self._occupancy, *window, floor_z=floor_z, height_m=self._height_m(robot),
                radius_m=self._radius(robot), start=start,
            )  # fmt: skip
            self._known[key] = window, known
        return known

    def _robot_at(self, robot: str | None) -> Array | None:
        agents = self._graph.nodes("agent")
        wanted = [a for a in agents if robot is None or a.id == f"agent_{robot}"]
        if not wanted:
            return None
        return np.asarray(max(wanted, key=lambda a: a.last_seen_ns).position[:2])

    def _rooms_of(self, nodes: Sequence[Node]) -> list[Node]:
        """The rooms among nodes, and those that the others are in."""
        rooms = [n for n in nodes if n.layer == "room"]
        for node in nodes:
            for edge in self._graph.edges("in", source=node.id):
                target = self._graph.node(edge.target)
                rooms += [target] if target.layer == "room" else []
        return rooms

    def _floor_z(self, nodes: Sequence[Node], footprint: shapely.Geometry, z_min: float) -> float:
        """The height of the floor under things."""
        middle = footprint.centroid
        floor = self._floor_below(middle.x, middle.y, z_min)
        if floor is not None:
            return floor[1]
        rooms = self._rooms_of(nodes)
        heights = [float(r.attributes["floor_z"]) for r in rooms if "floor_z" in r.attributes]
        if heights:
            return min(heights)
        floors = [n.position[2] for n in self._graph.nodes("structure", label="floor")]
        return float(min(floors)) if floors else min(float(n.position[2]) for n in nodes)

    def _radius(self, robot: str | None) -> float:
        known = self._describe(robot)
        return self._radius_m if known is None else known.radius_m

    def _height_m(self, robot: str | None) -> float:
        known = self._describe(robot)
        return DEFAULT_HEIGHT_M if known is None else known.height_m

    def _describe(self, robot: str | None) -> RobotDescription | None:
        if robot is not None:
            return self._robots.get(robot)
        return next(iter(self._robots.values())) if len(self._robots) == 1 else None


def _rank(answer: PlaceAnswer) -> tuple[bool, float]:
    lengths = [p.path_length_m for p in answer.poses if p.path_length_m is not None]
    return not answer.poses, min(lengths, default=math.inf)


def _outer(region: shapely.Geometry) -> list[tuple[float, float]]:
    largest = max(shapely.get_parts(region), key=lambda part: part.area)
    return list(largest.exterior.simplify(0.02).coords[:-1])
