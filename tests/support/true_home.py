"""A simulated home as the rules would know it had every surface been seen: its truth, and a world model of it.

The model is what the main path makes of perfect surfaces: points on the true meshes become shapes, `Relations` measures
them, the graph's own facts are told to the rules, and the rules derive all else. The truth comes from the simulator
alone: exact meshes, what it placed where, and its own definitions of the relations.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, cached_property

import numpy as np
import shapely

from reasoning import KnowledgeBase
from reasoning.terms import Atom, Compound
from scenegraph import facts
from scenegraph.graph import Box, Edge, Node
from scenegraph.perception.relations import Relations
from scenegraph.perception.shapes import Shape
from scenegraph.simulation import Home
from tests.support.furnishing import Plan
from tests.support.homes import home

VOXEL_M = 0.025
STEP_M = 0.011
ROBOT = "agent_rob"
ROBOT_WIDTH_M = 0.5


class Truth:
    """What is true of a home, in sets of ids."""

    def __init__(self, of: Home) -> None:
        self.home = of
        self.label = {o.id: o.label for o in of.objects}
        self.size = {o.id: o.size for o in of.objects}
        self.center = {o.id: o.center for o in of.objects}
        self.room_ids = {r.id: f"room_{n}" for n, r in enumerate(of.rooms, 1)}
        self.rooms = {self.room_ids[r.id]: r.kind for r in of.rooms}
        self.area = {self.room_ids[r.id]: shapely.Polygon(r.footprint).area for r in of.rooms}
        self.windows = {w.id: self.room_ids[w.room] for w in of.windows}
        self.doors = {d.id: tuple(self.room_ids[room] for room in d.rooms) for d in of.doors}
        self.door_width = {d.id: d.width for d in of.doors}
        self.robot = np.array([*shapely.Polygon(of.rooms[0].footprint).representative_point().coords[0], 0.0])
        self.last_seen_ns = {o.id: 1_000 + 10 * ((7 * n) % 1009) for n, o in enumerate(of.objects)}

    @cached_property
    def pairs(self) -> dict[str, set[tuple[str, str]]]:
        """Relation → pairs; symmetric ones both ways."""
        found: dict[str, set[tuple[str, str]]] = {}
        for name, a, b0 in self.home.relations():
            b = self.room_ids.get(b0, b0)
            found.setdefault(name, set()).add((a, b))
            if name in ("near", "next_to", "touching"):
                found[name].add((b, a))
        return found

    def things(self, *labels: str) -> set[str]:
        """The things of these classes."""
        return {name for name, label in self.label.items() if label in labels}

    def room_of(self, *kinds: str) -> set[str]:
        """The rooms of these kinds."""
        return {room for room, kind in self.rooms.items() if kind in kinds}

    def to(self, relation: str, targets: Iterable[str]) -> set[str]:
        """What stands in this relation to one of the targets."""
        of = set(targets)
        return {a for a, b in self.pairs.get(relation, set()) if b in of}

    def of(self, relation: str, sources: Iterable[str]) -> set[str]:
        """That to which one of the sources stands in this relation."""
        of = set(sources)
        return {b for a, b in self.pairs.get(relation, set()) if a in of}

    def adjacent(self, room: str) -> set[str]:
        """The rooms that share a door or opening with a room."""
        return {other for rooms in self.doors.values() if room in rooms for other in rooms} - {room}

    def led_to(self, room: str) -> set[str]:
        """The rooms that one gets to through doors wider than the robot."""
        found, new = {room}, {room}
        while new:
            wide = [rooms for door, rooms in self.doors.items() if self.door_width[door] > ROBOT_WIDTH_M]
            new = {b for rooms in wide if new & set(rooms) for b in rooms} - found
            found |= new
        return found - {room}

    def sides(self, landmark: str, seen_from: np.ndarray) -> dict[str, set[str]]:
        """What is in front of, behind, left and right of a thing for a viewer, within 3 m."""
        centre = self.center[landmark][:2]
        towards = seen_from[:2] - centre
        found: dict[str, set[str]] = {"in_front_of": set(), "behind": set(), "left_of": set(), "right_of": set()}
        for other in set(self.label) - {landmark}:
            away = self.center[other][:2] - centre
            if not 0.0 < np.linalg.norm(away) <= 3.0:
                continue
            along, across = away @ towards, towards[0] * away[1] - towards[1] * away[0]
            if abs(along) > abs(across):
                found["in_front_of" if along > 0 else "behind"].add(other)
            else:
                found["right_of" if across > 0 else "left_of"].add(other)
        return found

    def ground(self, thing: str) -> shapely.Polygon:
        """The upright footprint of a thing's own box."""
        o = self.home.thing(thing)
        c, s = np.cos(o.yaw), np.sin(o.yaw)
        corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * o.size[:2]
        return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + o.center[:2])

    def between(self, a: str, b: str) -> set[str]:
        """What lies by half of its footprint between two things."""
        one, two = self.ground(a), self.ground(b)
        gap = shapely.union(one, two).convex_hull - one - two
        return {
            x for x in set(self.label) - {a, b} if self.ground(x).intersection(gap).area >= 0.5 * self.ground(x).area
        }


@cache
def truth(seed: int) -> Truth:
    """What is true of the home of that seed."""
    return Truth(home(seed))


def model(true: Truth) -> KnowledgeBase:
    """A knowledge base of the home, as from true surfaces; to be closed."""
    knowledge = KnowledgeBase()
    of = true.home
    labels = {o.id: facts.class_atom(o.label) for o in of.objects}
    containers = {
        label: bool(knowledge.call(Compound("container_class", (Atom(label),)), limit=1)) for label in labels.values()
    }
    relations = Relations(containers.__getitem__)
    shapes = {o.id: Shape(_surface(o.vertices, o.triangles), VOXEL_M) for o in of.objects}
    measured = relations.update(shapes, labels, set(shapes), _plan(of))
    polygons = {true.room_ids[r.id]: shapely.Polygon(r.footprint) for r in of.rooms}
    for o in of.objects:
        hull = shapely.MultiPoint(o.vertices[:, :2]).convex_hull
        shares = {room: hull.intersection(polygon).area / hull.area for room, polygon in polygons.items()}
        measured.merge(relations.set_shares(o.id, {room: share for room, share in shares.items() if share > 0.0}))
    for window, room_id in true.windows.items():
        measured.merge(relations.set_shares(window, {room_id: 1.0}))
    nodes = [*_object_nodes(true), *_building_nodes(true)]
    knowledge.update(
        put=[
            Compound("parameter", (Atom("voxel_size_m"), VOXEL_M)),
            Compound("parameter", (Atom("robot_width_m"), ROBOT_WIDTH_M)),
            Compound("unobserved", (Atom("world"),)),
            Compound("attribute", (Atom(ROBOT), Atom("width_m"), ROBOT_WIDTH_M)),
            Compound("attribute", (Atom(ROBOT), Atom("payload_kg"), 2.0)),
            *(fact for node in nodes for fact in facts.node_facts(node)),
            *map(facts.edge_fact, _doors(true)),
            *facts.measurement_facts(measured)[0],
        ]
    )
    return knowledge


def _surface(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Points (N, 3) on a mesh, the mean of those in each voxel."""
    rng = np.random.default_rng(0)
    corners = vertices[triangles].astype(np.float64)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(u, v), axis=1) / 2
    which = np.repeat(np.arange(len(triangles)), np.maximum(1, np.ceil(area / STEP_M**2).astype(int)))
    a, b = rng.random(len(which)), rng.random(len(which))
    fold = a + b > 1
    a[fold], b[fold] = 1 - a[fold], 1 - b[fold]
    points = np.concatenate([corners[which, 0] + a[:, None] * u[which] + b[:, None] * v[which], vertices])
    _, voxel, count = np.unique(np.floor(points / VOXEL_M), axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(count), 3))
    np.add.at(total, voxel.ravel(), points)
    return np.asarray(total / count[:, None], np.float32)


def _plan(of: Home) -> Plan:
    """The true walls, floor, ceiling and doors."""
    walls = []
    for plane in of.structure:
        if plane.kind == "wall":
            ends = plane.polygon[:, :2]
            start = ends[0]
            walls.append((*start.tolist(), *ends[np.argmax(np.linalg.norm(ends - start, axis=1))].tolist()))
    return Plan(
        floors={"floor_1": 0.0},
        walls=walls,
        doors=[(float(d.center[0]), float(d.center[1])) for d in of.doors],
        ceilings={"ceiling_1": float(of.rooms[0].ceiling_z)},
    )


def _node(
    node_id: str, layer: str, label: str, center: np.ndarray, size: object, yaw: float = 0.0, **more: object
) -> Node:
    return Node(
        id=node_id, layer=layer, label=label, position=center, box=Box.from_yaw(center, size, yaw),
        first_seen_ns=0, **{"last_seen_ns": 1_000, **more},
    )  # fmt: skip


def _object_nodes(true: Truth) -> list[Node]:
    return [
        _node(o.id, "object", o.label, o.center, o.size, o.yaw, last_seen_ns=true.last_seen_ns[o.id])
        for o in true.home.objects
    ]


def _building_nodes(true: Truth) -> list[Node]:
    of = true.home
    nodes = [
        _node("floor_1", "structure", "floor", np.zeros(3), (20.0, 20.0, 0.02)),
        Node(id=ROBOT, layer="agent", label="robot", position=true.robot, first_seen_ns=0, last_seen_ns=1_000),
    ]
    for room in of.rooms:
        low, high = room.footprint.min(axis=0), room.footprint.max(axis=0)
        height = room.ceiling_z - room.floor_z
        center = np.array([*(low + high) / 2, room.floor_z + height / 2])
        room_id = true.room_ids[room.id]
        area = {"attributes": {"area_m2": round(true.area[room_id], 3)}}
        nodes.append(_node(room_id, "room", "room", center, (*(high - low), height), **area))
    for opening in (*of.doors, *of.windows):
        kind = getattr(opening, "kind", "window")
        label = "door" if kind in ("closed", "ajar") else kind
        yaw = float(np.arctan2(*opening.normal[[0, 1]] * [-1, 1]))
        nodes.append(_node(opening.id, "structure", label, opening.center, (opening.width, 0.05, opening.height), yaw))
    return nodes


def _doors(true: Truth) -> list[Edge]:
    times = {"first_seen_ns": 0, "last_seen_ns": 0}
    return [
        Edge(relation="connects", source=door, target=room, value=true.door_width[door], threshold=0.0, **times)
        for door, rooms in true.doors.items()
        for room in rooms
    ]
