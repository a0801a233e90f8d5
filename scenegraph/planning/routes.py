"""Which rooms lead to which, and by how long a way: the level on which a plan begins."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from scenegraph.graph import Node, SceneGraph

__all__ = ["Door", "Routes"]

SHUT_M = 20.0
"""What a shut door costs, as a way [m]: a way through open ones is preferred, since full hands open none."""


@dataclass(frozen=True)
class Door:
    """A door or opening, and the rooms it joins.

    shut : whether it must be opened first;  refused : why the robot cannot pass at all, or None
    """

    node: Node
    rooms: tuple[str, ...]
    shut: bool
    openable: bool
    refused: str | None = None


class Routes:
    """The rooms of a graph and the doors between them, for a robot of some width [m].

    states : door id → "open" or "closed", where it is known
    """

    def __init__(self, graph: SceneGraph, width_m: float, states: Mapping[str, str] | None = None) -> None:
        self.doors: dict[str, Door] = {}
        self._graph = graph
        self._of_room: dict[str, list[Door]] = {}
        self._lengths: dict[str, tuple[dict[str, float], dict[str, tuple[str, str]]]] = {}
        joined: dict[str, dict[str, float | None]] = {}
        for edge in graph.edges("connects"):
            joined.setdefault(edge.source, {})[edge.target] = edge.value
        for door_id, rooms in joined.items():
            door = self._door(graph.node(door_id), rooms, width_m, (states or {}).get(door_id))
            self.doors[door_id] = door
            for room in rooms:
                self._of_room.setdefault(room, []).append(door)

    @staticmethod
    def _door(node: Node, rooms: Mapping[str, float | None], width_m: float, state: str | None) -> Door:
        """A door of which nobody told the state is shut where no clear width was ever measured in it."""
        widths = [value for value in rooms.values() if value is not None]
        leaf = "door" in node.label and node.label != "doorway"
        shut = state == "closed" or (state is None and leaf and not widths)
        refused = None
        if widths and min(widths) <= width_m:
            refused = f"{node.id} is {min(widths):.2f} m wide, the robot {width_m:.2f} m"
        elif shut and node.attributes.get("locked") in (True, "true"):
            refused = f"{node.id} is locked"
        return Door(node, tuple(sorted(rooms)), shut, leaf, refused)

    def passable(self, room: str) -> list[Door]:
        """The doors of a room that the robot can pass, if need be after opening them."""
        return [door for door in self._of_room.get(room, ()) if door.refused is None]

    def length_m(self, start: str, end: str) -> float:
        """The way between two rooms by way of the doors' centres [m]; inf when there is none."""
        return self._from(start)[0].get(end, math.inf)

    def doors_on_the_way(self, start: str, end: str) -> list[tuple[Door, str]]:
        """The doors to pass, each with the room behind it, in order; empty also when there is no way."""
        came = self._from(start)[1]
        found: list[tuple[Door, str]] = []
        while end != start and end in came:
            before, door = came[end]
            found.append((self.doors[door], end))
            end = before
        return found[::-1]

    def why_not(self, start: str, end: str) -> str:
        """Why no way leads from one room to another, as far as doors tell."""
        reached = self._from(start)[0]
        refusals = [
            door.refused
            for door in self.doors.values()
            if door.refused and any(r in reached for r in door.rooms) and any(r not in reached for r in door.rooms)
        ]
        return f"no way leads from {start} to {end}" + (f": {'; '.join(refusals)}" if refusals else "")

    def between(self, rooms: Iterable[str]) -> tuple[set[str], set[str]]:
        """The rooms and doors on the ways from each of some rooms to each other, and the rooms themselves."""
        wanted = sorted(set(rooms))
        around, doors = set(wanted), set()
        for k, start in enumerate(wanted):
            for end in wanted[k + 1 :]:
                for door, behind in self.doors_on_the_way(start, end):
                    doors.add(door.node.id)
                    around.add(behind)
        return around, doors

    def _from(self, start: str) -> tuple[dict[str, float], dict[str, tuple[str, str]]]:
        """Dijkstra from the middle of a room: lengths, and the room and door before each."""
        if start in self._lengths:
            return self._lengths[start]
        lengths: dict[str, float] = {start: 0.0}
        came: dict[str, tuple[str, str]] = {}
        queue = [(0.0, start)]
        done: set[str] = set()
        while queue:
            length, room = heapq.heappop(queue)
            if room in done:
                continue
            done.add(room)
            for door in self.passable(room):
                for other in door.rooms:
                    if other == room:
                        continue
                    way = length + self._through(room, door, other) + (SHUT_M if door.shut else 0.0)
                    if way < lengths.get(other, math.inf):
                        lengths[other] = way
                        came[other] = (room, door.node.id)
                        heapq.heappush(queue, (way, other))
        self._lengths[start] = lengths, came
        return lengths, came

    def _through(self, room: str, door: Door, other: str) -> float:
        at = door.node.position
        return sum(float(math.dist(self._graph.node(r).position, at)) for r in (room, other))
