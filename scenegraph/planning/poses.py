"""Where a robot stands for each step of a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mapping.geometry import SE3
from reasoning.planning import Action
from scenegraph.graph import Node, SceneGraph
from scenegraph.places import PlaceFinder

__all__ = ["Standing"]

_WORK = {"open": 1, "close": 1, "switch_on": 1, "switch_off": 1, "pick": 1, "place_on": 2, "place_in": 2,
         "place_inside": 2, "pour": 2}  # fmt: skip
"""Which parameter of an action is what the robot must stand before."""


class Standing:
    """Free, reachable poses for the steps of plans.

    finder : finds them in the map; None: there is no map, and only what the graph knows of places is told
    """

    def __init__(self, graph: SceneGraph, finder: PlaceFinder | None, robot: str | None) -> None:
        self._graph = graph
        self._finder = finder
        self._robot = robot
        self._known: dict[str, SE3 | None] = {}

    def targets(self, actions: Sequence[Action]) -> list[SE3 | None]:
        """A pose of base_link for each action of the household domain: where it drives to, or stands.

        What it drives to a thing for decides from which side: it drives to the cup, not to the middle of the table.
        """
        found: list[SE3 | None] = []
        moved: set[str] = set()
        here: SE3 | None = None
        room: str | None = None
        for k, action in enumerate(actions):
            if action.name == "pass":
                room = action.arguments[4]
                here = self._beyond(action.arguments[2], room)
            elif action.name == "navigate":
                room = action.arguments[3]
                here = self._before(action.arguments[2], self._work(actions[k + 1 :]), moved, room)
            elif here is None:
                here = self._before(action.arguments[_WORK[action.name]], None, moved, room)
            if action.name == "pick":
                moved.add(action.arguments[1])
            found.append(here)
        return found

    def before(self, node_id: str) -> SE3 | None:
        """A pose before one node, or in a room."""
        if node_id not in self._graph:
            return None
        rooms = [edge.target for edge in self._graph.edges("in", source=node_id) if edge.target.startswith("room_")]
        return self._before(node_id, None, set(), rooms[0] if rooms else None)

    @staticmethod
    def _work(following: Sequence[Action]) -> str | None:
        """What is done first at the place that the robot drives to."""
        if not following or following[0].name not in _WORK:
            return None
        return following[0].arguments[_WORK[following[0].name]]

    def _before(self, site: str, work: str | None, moved: set[str], room: str | None) -> SE3 | None:
        """A pose before what is to be worked on, else before the site."""
        for node_id in (work, site):
            if node_id is not None and node_id not in moved and node_id in self._graph:
                node = self._graph.node(node_id)
                if node.layer == "room":
                    return self._place_in(node_id, node)
                if node.id.startswith("opening_") or node.layer == "structure":
                    return self._facing(node, room)
                pose = self._beside(node, room)
                if pose is not None:
                    return pose
        return None

    def _beside(self, node: Node, room: str | None) -> SE3 | None:
        if node.id not in self._known:
            place = self._nearest_place(room, node)
            start = None if place is None else place.position[:2]
            poses = [] if self._finder is None else self._finder.beside(node, self._robot, most=1, start=start)
            self._known[node.id] = poses[0].pose if poses else None
        return self._known[node.id]

    def _facing(self, door: Node, room: str | None) -> SE3 | None:
        """A place in the room before a door, looking at it."""
        place = self._nearest_place(room, door)
        return None if place is None else _pose(place, door.position.tolist())

    def _beyond(self, door_id: str, room: str) -> SE3 | None:
        """A place in the room behind a door, looking away from it."""
        door = self._graph.node(door_id)
        place = self._nearest_place(room, door)
        if place is None:
            return None
        ahead = [2.0 * p - d for p, d in zip(place.position.tolist(), door.position.tolist(), strict=True)]
        return _pose(place, ahead)

    def _place_in(self, room: str, node: Node) -> SE3 | None:
        place = self._nearest_place(room, node)
        return None if place is None else _pose(place, node.position.tolist())

    def _nearest_place(self, room: str | None, to: Node) -> Node | None:
        """The place in a room that is nearest to a node, of those where a robot can stand."""
        places = [
            self._graph.node(edge.target)
            for edge in self._graph.edges("contains", source=room)
            if edge.target.startswith("place_")
        ]
        standing = [p for p in places if p.layer == "place" and p.attributes.get("traversable", True) is not False]
        x, y = to.position[:2].tolist()
        return min(standing, key=lambda p: math.dist(p.position[:2], (x, y)), default=None)


def _pose(place: Node, towards: Sequence[float]) -> SE3:
    x, y, z = place.position.tolist()
    yaw = math.atan2(towards[1] - y, towards[0] - x) if math.dist((x, y), towards[:2]) > 1e-6 else 0.0
    return SE3(SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, yaw]).rotation, (x, y, z))
