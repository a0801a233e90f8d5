"""Homes of any size for a robot that runs errands: rooms in rows, doors between them, furniture, and things on and in
it. All relations are told, nothing is measured."""

from __future__ import annotations

import random
from collections.abc import Sequence

from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph

FURNITURE = {
    "table": (1.4, 0.8, 0.75),
    "desk": (1.4, 0.7, 0.74),
    "counter": (2.0, 0.6, 0.9),
    "fridge": (0.6, 0.6, 1.7),
    "cabinet": (0.9, 0.45, 1.0),
    "bed": (2.0, 1.4, 0.5),
    "sofa": (1.9, 0.9, 0.8),
    "shelf": (0.9, 0.35, 1.8),
}
SMALL = {
    "cup": (0.08, 0.08, 0.1),
    "book": (0.22, 0.16, 0.03),
    "bowl": (0.2, 0.2, 0.08),
    "bottle": (0.08, 0.08, 0.26),
    "apple": (0.07, 0.07, 0.07),
    "plate": (0.24, 0.24, 0.02),
}
ROOM_M = 5.0
CONTAINERS = ("fridge", "cabinet")


class Home:
    """A graph under construction."""

    def __init__(self) -> None:
        self.graph = SceneGraph()
        self._changes = GraphChanges()
        self._count = 0

    def node(
        self,
        node_id: str,
        layer: str,
        label: str,
        at: Sequence[float],
        size: Sequence[float] = (),
        **attributes: object,
    ) -> str:
        box = Box(center=tuple(at), size=tuple(size)) if size else None
        self._changes.put(
            Node(
                id=node_id,
                layer=layer,
                label=label,
                position=tuple(at),
                box=box,  # type: ignore[arg-type]
                first_seen_ns=1,
                last_seen_ns=1,
                attributes=attributes,
            )
        )
        return node_id

    def edge(self, relation: str, source: str, target: str, value: float | None = 1.0, inverse: str = "") -> None:
        for name, a, b in ((relation, source, target), (inverse, target, source)):
            if name:
                self._changes.put(Edge(relation=name, source=a, target=b, value=value, first_seen_ns=1, last_seen_ns=1))

    def room(self, number: int, x: float, y: float, kind: str = "room") -> str:
        ring = [[x, y], [x + ROOM_M, y], [x + ROOM_M, y + ROOM_M], [x, y + ROOM_M]]
        middle = (x + ROOM_M / 2, y + ROOM_M / 2, 0.0)
        room = self.node(f"room_{number}", "room", kind, middle, footprint=ring, floor_z=0.0)
        floor = self.node(f"floor_{number}", "structure", "floor", middle, (ROOM_M, ROOM_M, 0.1))
        self.edge("in", floor, room)
        place = self.node(f"place_{number}", "place", "place", middle, traversable=True)
        self.edge("in", place, room, inverse="contains")
        return room

    def door(self, number: int, a: str, b: str, at: Sequence[float], width: float | None = 0.9) -> str:
        door = self.node(f"door_{number}", "structure", "door", (*at, 1.0), (0.9, 0.1, 2.0))
        for room in (a, b):
            self.edge("connects", door, room, width)
        return door

    def thing(
        self, label: str, room: str, at: Sequence[float], host: str | None = None, how: str = "on", **attributes: object
    ) -> str:
        size = {**FURNITURE, **SMALL}[label]
        self._count += 1
        thing = self.node(
            f"object_{self._count}", "object", label, (at[0], at[1], at[2] + size[2] / 2), size, **attributes
        )
        self.edge("in", thing, room, inverse="contains")
        self.edge(how, thing, host or room.replace("room", "floor"), inverse="supports" if how == "on" else "contains")
        return thing

    def agent(self, room: str, at: Sequence[float], name: str = "rob") -> str:
        agent = self.node(f"agent_{name}", "agent", "robot", (*at, 0.0))
        self.edge("in", agent, room, inverse="contains")
        return agent

    def done(self) -> SceneGraph:
        self.graph.commit(self._changes, 1)
        self._changes = GraphChanges()
        return self.graph


def small_flat(*, shut: bool = False, door_width: float | None = 0.9) -> SceneGraph:
    """A kitchen (room_1) with counter object_1, fridge object_2 (milk bottle object_3 in it) and table object_4 (book
    object_5, on it cup object_6); a bedroom (room_2) with bed object_7 and desk object_8 (plate object_9 with apple
    object_10). The robot is in the bedroom."""
    home = Home()
    kitchen, bedroom = home.room(1, 0.0, 0.0, "kitchen"), home.room(2, ROOM_M, 0.0, "bedroom")
    home.door(1, kitchen, bedroom, (ROOM_M, 2.5), None if shut else door_width)
    home.thing("counter", kitchen, (1.0, 0.5, 0.0))
    fridge = home.thing("fridge", kitchen, (3.0, 0.5, 0.0))
    home.thing("bottle", kitchen, (3.0, 0.5, 0.5), fridge, "in")
    table = home.thing("table", kitchen, (2.0, 3.0, 0.0))
    book = home.thing("book", kitchen, (2.0, 3.0, 0.75), table)
    home.thing("cup", kitchen, (2.0, 3.0, 0.78), book)
    home.thing("bed", bedroom, (7.0, 1.0, 0.0))
    desk = home.thing("desk", bedroom, (8.0, 4.0, 0.0))
    plate = home.thing("plate", bedroom, (8.0, 4.0, 0.74), desk)
    home.thing("apple", bedroom, (8.0, 4.0, 0.76), plate)
    home.agent(bedroom, (6.5, 2.5))
    return home.done()


def large_home(n_rooms: int, n_objects: int, seed: int = 0) -> SceneGraph:
    """Rooms in rows of eight, doors to all neighbours (one in eight shut), about a quarter of the objects furniture."""
    rng = random.Random(seed)
    home = Home()
    columns = 8
    kinds = ("kitchen", "bedroom", "office", "living_room", "bathroom")
    at = {k: ((k % columns) * ROOM_M, (k // columns) * ROOM_M) for k in range(n_rooms)}
    rooms = [home.room(k, *at[k], kind=kinds[k % len(kinds)]) for k in range(n_rooms)]
    doors = 0
    for k in range(n_rooms):
        x, y = at[k]
        for other, middle in ((k + 1, (x + ROOM_M, y + ROOM_M / 2)), (k + columns, (x + ROOM_M / 2, y + ROOM_M))):
            if other < n_rooms and (other == k + columns or other % columns):
                home.door(doors, rooms[k], rooms[other], middle, None if rng.random() < 0.125 else 0.9)
                doors += 1
    per_room = n_objects // n_rooms
    for k in range(n_rooms):
        hosts = []
        for i in range(max(2, per_room // 4)):
            label = list(FURNITURE)[(i + k) % len(FURNITURE)]
            spot = (at[k][0] + rng.uniform(0.5, 4.5), at[k][1] + rng.uniform(0.5, 4.5))
            hosts.append((home.thing(label, rooms[k], (*spot, 0.0)), label, spot))
        for _ in range(per_room - len(hosts)):
            label = rng.choice(list(SMALL))
            host, kind, spot = rng.choice(hosts)
            inside = kind in CONTAINERS
            height = 0.5 if inside else FURNITURE[kind][2]
            home.thing(label, rooms[k], (*spot, height), host, "in" if inside else "on")
    home.agent(rooms[0], (2.5, 2.5))
    return home.done()
