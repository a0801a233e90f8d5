"""What a robot has to do with in a home, as facts for a planner: read from the graph where a plan needs them.

Nothing here looks at the whole graph: what a thing stands on, what stands on it, where it is reached from are looked up
when asked for, and then changed by the actions of a plan.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely

from mapping.observations import RobotDescription
from reasoning.knowledge import KnowledgeBase
from reasoning.planning import Action, Fact
from reasoning.terms import Atom, Compound, Term, Var
from scenegraph.facts import class_atom
from scenegraph.graph import Node, SceneGraph
from scenegraph.planning.routes import Routes

__all__ = ["Host", "Scope", "Situation"]

Host: TypeAlias = tuple[str, str]
"""What a thing rests on or in, and which: "on" or "in"."""

SLACK_M = 0.02
"""By so much a box may be measured too large."""
STATES = {"opened": ("open", "closed"), "switched_on": ("switched_on", "switched_off")}


@dataclass
class Scope:
    """What a task is about: only this is told to the planner.

    movable : things that may be taken;  hosts : where things may be put;  things : these, and what else matters
    """

    movable: set[str] = field(default_factory=set)
    hosts: set[str] = field(default_factory=set)
    things: set[str] = field(default_factory=set)
    rooms: set[str] = field(default_factory=set)
    doors: set[str] = field(default_factory=set)

    def join(self, other: Scope) -> None:
        """Take in another scope."""
        self.movable |= other.movable
        self.hosts |= other.hosts
        self.things |= other.things
        self.rooms |= other.rooms
        self.doors |= other.doors


class Situation:
    """A graph as a robot finds it, and as it becomes by what it does.

    robot : its name in facts;  place : (x, y) where it is [m], or None when nobody knows
    """

    def __init__(
        self,
        graph: SceneGraph,
        knowledge: KnowledgeBase,
        *,
        robot: str,
        body: RobotDescription | None,
        radius_m: float,
        place: tuple[float, float, float] | None,
    ) -> None:
        self.graph = graph
        self.robot = robot
        self._knowledge = knowledge
        self._body = body
        self._affords: dict[str, frozenset[str]] = {}
        self._ungraspable: dict[str, str | None] = {}
        self._states = self._told_states()
        self.routes = Routes(graph, 2.0 * (body.radius_m if body else radius_m), self._states["opened"])
        self.room = self._room_of_agent() or self._room_around(place)
        self.site = self.room
        self.held = self._told_holding()
        self._moved: dict[str, Host | None] = {}
        self._reached: dict[str, str] = {}
        self._kept: dict[str, str] = {}
        self._added: dict[str, set[str]] = {}
        self._extra: set[Fact] = set(self._told_poured())
        self._hosts: dict[str, Host | None] = {}
        self._of_room: dict[str, str | None] = {}
        self._floors_of: dict[str, list[str]] = {}

    def _room_of_agent(self) -> str | None:
        rooms = [e.target for e in self.graph.edges("in", source=self.robot) if e.target in self.graph]
        return next((room for room in rooms if self.graph.node(room).layer == "room"), None)

    # -- what was told -------------------------------------------------------------------------------------
    def _told_states(self) -> dict[str, dict[str, str]]:
        found: dict[str, dict[str, str]] = {name: {} for name in STATES}
        for name, words in STATES.items():
            for word in words:
                for row in self._knowledge.call(Compound(word, (Var("X"),))):
                    found[name][str(row["X"])] = word
        return found

    def _told_holding(self) -> str | None:
        rows = self._knowledge.call(Compound("holding", (Atom(self.robot), Var("X"))), limit=1)
        return str(rows[0]["X"]) if rows else None

    def _told_poured(self) -> Iterable[Fact]:
        for row in self._knowledge.call(Compound("poured", (Var("X"), Var("Y")))):
            yield ("poured", str(row["X"]), str(row["Y"]))

    # -- classes -------------------------------------------------------------------------------------------
    def affords(self, thing: str, what: str) -> bool:
        """Whether things of this one's class afford something, as rules/affordances.pl says."""
        return what in self._affordances(self.graph.node(thing).label)

    def _affordances(self, label: str) -> frozenset[str]:
        if label not in self._affords:
            name = Atom(class_atom(label))
            rows = self._knowledge.call(Compound("offered_by", (Var("W"), name)))
            self._affords[label] = frozenset(str(row["W"]) for row in rows)
        return self._affords[label]

    # -- places --------------------------------------------------------------------------------------------
    def host(self, thing: str) -> Host | None:
        """What a thing rests on or in; None when it is held, or nothing is known to carry it."""
        if thing in self._moved:
            return self._moved[thing]
        if thing not in self._hosts:
            self._hosts[thing] = self._seen_host(thing)
        return self._hosts[thing]

    def _seen_host(self, thing: str) -> Host | None:
        for how in ("in", "on"):
            carriers = [
                (edge.value or 0.0, edge.target)
                for edge in self.graph.edges(how, source=thing)
                if self.graph.node(edge.target).layer in ("object", "structure")
            ]
            if carriers:
                carrier = max(carriers)[1]
                return carrier, "on" if how == "in" and self._on_top(thing, carrier) else how
        return None

    def _on_top(self, thing: str, carrier: str) -> bool:
        """Whether a thing that lies in the box of a container, and on it, is to be taken from above: its middle is
        higher than what it stands on."""
        box, around = self.graph.node(thing).box, self.graph.node(carrier).box
        if box is None or around is None or self.graph.edge("on", thing, carrier) is None:
            return False
        return bool(box.center[2] > around.center[2] + 0.5 * around.size[2] - SLACK_M)

    def children(self, host: str) -> list[str]:
        """The things that rest on or in another."""
        found = {
            edge.source
            for how in ("in", "on")
            for edge in self.graph.edges(how, target=host)
            if edge.source not in self._moved and self.graph.node(edge.source).layer == "object"
        }
        return sorted(child for child in found | self._added.get(host, set()) if (self.host(child) or ("",))[0] == host)

    def chain(self, thing: str) -> list[Host]:
        """What carries a thing, what carries that, and so on, down to what stands on the floor or hangs on a wall."""
        found: list[Host] = []
        seen = {thing}
        while (host := self.host(thing)) is not None and host[0] not in seen:
            if self.graph.node(host[0]).layer == "structure":
                break
            found.append(host)
            thing = host[0]
            seen.add(thing)
        return found

    def reached_from(self, thing: str) -> str:
        """The site from which a thing is reached: what it stands on in the end, or itself."""
        if thing in self._reached:
            return self._reached[thing]
        for carrier, _ in self.chain(thing):
            if carrier in self._reached:
                return self._reached[carrier]
            thing = carrier
        return thing

    def kept_in(self, thing: str) -> str | None:
        """What must be open to get at a thing: a container that can be shut, else its room."""
        if thing in self._kept:
            return self._kept[thing]
        below = thing
        for carrier, how in self.chain(thing):
            if how == "in" and self.openable(carrier):
                return carrier
            if carrier in self._kept:
                return self._kept[carrier]
            below = carrier
        return self.room_of(below)

    def room_of(self, thing: str) -> str | None:
        """The room that a thing is in, or stands in by what carries it."""
        if thing not in self._of_room:
            self._of_room[thing] = self._find_room(thing)
        return self._of_room[thing]

    def _find_room(self, thing: str) -> str | None:
        if thing in self.graph and self.graph.node(thing).layer == "room":
            return thing
        site = self.reached_from(thing)
        if site != thing:
            return self.room_of(site)
        for edge in self.graph.edges("in", source=thing):
            if self.graph.node(edge.target).layer == "room":
                return edge.target
        node = self.graph.node(thing)
        return self._room_around((float(node.position[0]), float(node.position[1]), float(node.position[2])))

    @cached_property
    def _rooms(self) -> list[tuple[str, shapely.Geometry, float]]:
        found = []
        for room in self.graph.nodes("room"):
            outline = room.footprint
            shape = None if outline is None else shapely.Polygon(outline).buffer(0.0)
            if shape is None and room.box is not None:
                shape = shapely.MultiPoint(room.box.corners()[:, :2]).convex_hull
            if shape is not None:
                found.append((room.id, shape, _floor_z(room)))
        return found

    def _room_around(self, place: tuple[float, float, float] | None) -> str | None:
        """The room that a place is in, else the nearest within 2 m on the same storey."""
        if place is None:
            return None
        point = shapely.Point(place[:2])
        away = [
            (float(shape.distance(point)), abs(place[2] - floor_z), room)
            for room, shape, floor_z in self._rooms
            if -1.0 <= place[2] - floor_z <= 3.0
        ]
        nearest = min(away, default=None)
        return nearest[2] if nearest is not None and nearest[0] <= 2.0 else None

    def way_m(self, a: str | None, b: str | None) -> float:
        """The way between two rooms [m]; inf when one is unknown or cannot be reached."""
        return math.inf if a is None or b is None else self.routes.length_m(a, b)

    def away_m(self, thing: str) -> float:
        """About how far a thing is for the robot [m]."""
        room = self.room_of(thing)
        way = self.way_m(self.room, room)
        if way or room is None or self.site is None:
            return way
        return 0.3 * float(math.dist(self.graph.node(self.site).position[:2], self.graph.node(thing).position[:2]))

    # -- what can be done ------------------------------------------------------------------------------------
    def openable(self, thing: str) -> bool:
        return self.affords(thing, "openable")

    def opened(self, thing: str) -> bool:
        """Whether it is open; what nobody told of is taken to be shut, but for doors that were seen to be clear."""
        if thing in self.routes.doors and thing not in self._states["opened"]:
            return not self.routes.doors[thing].shut
        told = self._states["opened"].get(thing)
        return told == "open" if told is not None else not self.affords(thing, "shut")

    def switched_on(self, thing: str) -> bool:
        return self._states["switched_on"].get(thing) == "switched_on"

    def not_graspable(self, thing: str) -> str | None:
        """Why the robot cannot take a thing, as rules/affordances.pl says; None when it can, or may."""
        if thing not in self._ungraspable:
            self._ungraspable[thing] = self._why_not_graspable(thing)
        return self._ungraspable[thing]

    def _why_not_graspable(self, thing: str) -> str | None:
        node = self.graph.node(thing)
        if node.layer != "object":
            return f"{thing} is a {node.layer} and cannot be taken"
        hand = None if self._body is None else self._body.max_width_m
        if hand is not None and node.box is not None and node.box.size.min() > hand + SLACK_M:
            return f"{thing} is {node.box.size.min():.2f} m across, and the hand of {self.robot} opens {hand:.2f} m"
        for goal in (("affords", "graspable"), ("can", "can_carry")):
            arguments = (Atom(goal[1]), Atom(thing), Atom("false"), Var("Tests"))
            if rows := self._knowledge.call(Compound(goal[0], arguments), limit=1):
                if hand is not None and "grasp_width" in str(rows[0]["Tests"]):
                    continue  # the robot told how far its hand opens
                return f"{thing} is a {node.label}, which cannot be taken{_measured(rows[0]['Tests'])}"
        return None

    def surface(self, host: str) -> bool:
        """Whether things can be put on it: it is made for that, or carries something."""
        return self.affords(host, "surface") or bool(self.graph.edges("on", target=host))

    def container(self, host: str) -> bool:
        """Whether things can be put into it: it is made for that, or contains something."""
        return self.affords(host, "container") or bool(self.graph.edges("in", target=host))

    def not_fitting(self, thing: str, how: str, host: str) -> str | None:
        """Why a thing cannot be put on or into another; None when it can."""
        if thing == host:
            return f"{thing} cannot be {how} itself"
        if host not in self.graph or self.graph.node(host).layer not in ("object", "structure"):
            return f"nothing can be put {how} {host}"
        if not (self.surface(host) if how == "on" else self.container(host)):
            return f"{host} is a {self.graph.node(host).label}: nothing can be put {how} it"
        box, around = self.graph.node(thing).box, self.graph.node(host).box
        if box is None or around is None:
            return None
        if how == "on":
            fits = (np.sort(box.size[:2]) <= np.sort(around.size[:2]) + SLACK_M).all()
        else:
            fits = (np.sort(box.size) <= np.sort(around.size) + SLACK_M).all()
        if not fits:
            return f"{thing} ({_sides(box.size)}) is larger than {host} ({_sides(around.size)})"
        return None

    def not_reached(self, thing: str) -> str | None:
        """Why the robot cannot get to a thing; None when it can."""
        room = self.room_of(thing)
        if self.room is None:
            return f"nobody knows where {self.robot} is"
        if room is None:
            return f"nobody knows which room {thing} is in"
        if math.isinf(self.way_m(self.room, room)):
            return self.routes.why_not(self.room, room)
        return None

    # -- facts -----------------------------------------------------------------------------------------------
    def widen(self, scope: Scope) -> Scope:
        """A scope with everything that its things depend on: what carries them and what they carry, where those may be
        put aside, and the ways between all the rooms."""
        pending = list(scope.movable)
        while pending:  # what rests on a thing must be put aside before it is taken
            thing = pending.pop()
            for child in self.children(thing):
                if child not in scope.movable:
                    scope.movable.add(child)
                    pending.append(child)
                    scope.hosts |= self._aside(child)
        things = scope.things | scope.movable | scope.hosts
        for thing in list(things):
            host = self.host(thing)
            things |= {carrier for carrier, _ in self.chain(thing)} | ({host[0]} if host else set())
        sites = {self.reached_from(t) for t in things} | ({self.site} if self.site else set())
        things |= {s for s in sites if s not in self.graph or self.graph.node(s).layer != "room"}
        things |= {kept for t in things if (kept := self.kept_in(t)) and self.graph.node(kept).layer != "room"}
        if self.held is not None:
            things.add(self.held)
            scope.movable.add(self.held)
        rooms = (
            {room for t in things if (room := self.room_of(t))} | scope.rooms | ({self.room} if self.room else set())
        )
        if self.held is not None and not scope.hosts:
            scope.hosts |= self._aside(self.held)
            things |= scope.hosts
        around, doors = self.routes.between(rooms)
        doors |= scope.doors
        return Scope(scope.movable, scope.hosts, things | doors, around, doors)

    def everything(self) -> Scope:
        """All that the graph knows, for comparison: what classical planners are often given."""
        objects = [node.id for node in self.graph.nodes("object")]
        movable = {thing for thing in objects if self.not_graspable(thing) is None}
        hosts = {thing for thing in objects if self.surface(thing) or self.container(thing)}
        floors = {floor for room in self.graph.nodes("room") for floor in self._floors(room.id)}
        things = set(objects) | floors | set(self.routes.doors)
        return Scope(movable, hosts, things, {room.id for room in self.graph.nodes("room")}, set(self.routes.doors))

    def _aside(self, thing: str, most: int = 2) -> set[str]:
        """Where a thing may be put aside: surfaces near it."""
        room = self.room_of(thing) or self.room
        if room is None:
            return set()
        carriers = {carrier for carrier, _ in self.chain(thing)}
        return set(self.hosts_in(room, thing, "on", most, first=carriers))

    def hosts_in(
        self, room: str, thing: str, how: str, most: int, first: Iterable[str] = (), beside: str | None = None
    ) -> list[str]:
        """The surfaces (or containers) in a room that a thing fits on, nearest first; the floor when there is none."""
        site = beside or self.reached_from(thing)
        near = self.graph.node(site).position if site in self.graph else self.graph.node(room).position
        preferred = set(first)
        found = []
        for edge in self.graph.edges("in", target=room):
            node = self.graph.node(edge.source)
            if node.layer != "object" or node.id == thing or node.id == self.held:
                continue
            if self.not_fitting(thing, how, node.id) or self.not_graspable(node.id) is None:
                continue
            away = float(math.dist(node.position[:2], near[:2]))
            found.append((node.id not in preferred, away, node.id))
        if found or how != "on":
            return [host for *_, host in sorted(found)[:most]]
        return [floor for floor in self._floors(room) if self.not_fitting(thing, "on", floor) is None][:1]

    def _floors(self, room: str) -> list[str]:
        """The floors that things of a room stand on, the most used first."""
        if room not in self._floors_of:
            used: dict[str, int] = {}
            for edge in self.graph.edges("in", target=room):
                for on in self.graph.edges("on", source=edge.source):
                    if self.graph.node(on.target).layer == "structure":
                        used[on.target] = used.get(on.target, 0) + 1
            self._floors_of[room] = sorted(used, key=lambda floor: -used[floor])
        return self._floors_of[room]

    def objects(self, scope: Scope) -> dict[str, str]:
        """The objects of a scope with their types."""
        found = dict.fromkeys(sorted(scope.rooms), "room")
        found |= dict.fromkeys(sorted(scope.things), "thing")
        found |= dict.fromkeys(sorted(scope.doors), "door")
        found[self.robot] = "robot"
        return found

    def facts(self, scope: Scope) -> frozenset[Fact]:
        """What holds now among the things of a scope."""
        robot, held = self.robot, self.held
        found: set[Fact] = {fact for fact in self._extra if all(a in scope.things for a in fact[1:])}
        for room in scope.rooms:
            found |= {("beside", room, room), ("opened", room)}
        if self.room is not None and self.site is not None:
            found |= {("at", robot, self.site), ("within", robot, self.room)}
        found.add(("holding", robot, held) if held else ("free", robot))
        for door_id in scope.doors:
            door = self.routes.doors[door_id]
            rooms = [room for room in door.rooms if room in scope.rooms]
            found |= {("beside", door_id, room) for room in rooms} | {("reached_from", door_id, door_id)}
            found |= {("joins", door_id, a, b) for a in rooms for b in rooms if a != b and not door.refused}
            found |= {("openable", door_id)} if door.openable and not door.refused else set()
            found |= {("opened", door_id)} if self.opened(door_id) else set()
        for thing in scope.things - scope.doors:
            found |= self._facts_of(thing, scope)
        for thing in scope.movable:
            if self.not_graspable(thing) is None:
                found.add(("graspable", robot, thing))
            for host in scope.hosts:
                for how in ("on", "in"):
                    if self.not_fitting(thing, how, host) is None:
                        found.add((f"fits_{how}", thing, host))
        return frozenset(found)

    def _facts_of(self, thing: str, scope: Scope) -> set[Fact]:
        found: set[Fact] = set()
        if self.graph.node(thing).layer == "structure":
            for around in scope.rooms:  # a floor is reached from every room that it lies in
                if thing in self._floors(around):
                    found |= {("reached_from", thing, around), ("kept", thing, around)}
        elif thing != self.held:
            site, kept, room = self.reached_from(thing), self.kept_in(thing), self.room_of(thing)
            found.add(("reached_from", thing, site))
            if kept is not None:
                found.add(("kept", thing, kept))
            if site == thing and room is not None:
                found.add(("beside", thing, room))
            carried = self.host(thing)
            if carried is None and kept is not None:
                found.add(("resting", thing, kept))
            elif carried is not None and carried[0] in scope.things:
                carrier, how = carried
                found |= {("resting", thing, carrier), (how, thing, carrier)}
                if thing not in self._moved:  # a cup in a sink is on it, too
                    found |= {(h, thing, carrier) for h in ("on", "in") if self.graph.edge(h, thing, carrier)}
        if self.openable(thing):
            found.add(("openable", thing))
            found |= {("opened", thing)} if self.opened(thing) else set()
        for what in ("powered", "pourable", "vessel"):
            if self.affords(thing, what):
                found.add((what, thing))
        if self.switched_on(thing):
            found.add(("switched_on", thing))
        return found

    def fork(self) -> Situation:
        """A copy that changes by itself."""
        twin = copy.copy(self)
        twin._states = {name: dict(states) for name, states in self._states.items()}
        twin._moved, twin._reached, twin._kept = dict(self._moved), dict(self._reached), dict(self._kept)
        twin._added = {host: set(things) for host, things in self._added.items()}
        twin._extra, twin._of_room = set(self._extra), {}
        return twin

    # -- change ----------------------------------------------------------------------------------------------
    def advance(self, action: Action) -> None:
        """Take an action: what it begins and ends is so from now on."""
        self._of_room = {}
        for holds, fact in sorted(action.effects):  # what ends comes first
            match fact[0], holds:
                case "at", True:
                    self.site = fact[2]
                case "within", True:
                    self.room = fact[2]
                case "holding", _:
                    self.held = fact[2] if holds else None
                case "resting", False:
                    self._moved[fact[1]] = None
                    self._added.get(fact[2], set()).discard(fact[1])
                case (("on" | "in"), True):
                    self._moved[fact[1]] = fact[2], fact[0]
                    self._added.setdefault(fact[2], set()).add(fact[1])
                case "reached_from", True:
                    self._reached[fact[1]] = fact[2]
                case "kept", True:
                    self._kept[fact[1]] = fact[2]
                case "opened", _:
                    self._states["opened"][fact[1]] = "open" if holds else "closed"
                case "switched_on", _:
                    self._states["switched_on"][fact[1]] = "switched_on" if holds else "switched_off"
                case "poured", True:
                    self._extra.add(fact)
                case _:
                    pass


def _measured(tests: Term) -> str:
    """What of a test that failed was measured, in words: ` (grasp width 0.45 m, hand opening 0.12 m)`."""
    for test in tests if isinstance(tests, list) else ():
        if isinstance(test, Compound) and isinstance(test.args[1], float | int):
            names = (str(test.args[0]).replace("_", " "), str(test.args[3]).replace("_", " "))
            return f" ({names[0]} {test.args[1]:.3g}, {names[1]} {test.args[4]:.3g})"
    return ""


def _floor_z(room: Node) -> float:
    told = room.attributes.get("floor_z")
    return float(told) if isinstance(told, int | float) else float(room.position[2])


def _sides(size: np.ndarray) -> str:
    return " × ".join(f"{side:.2f}" for side in size.tolist()) + " m"
