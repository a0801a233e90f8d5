"""Rooms, walls, doors and windows of a home, in the home's own axis-aligned frame (x along the hallway, z up).

A hallway runs along x between a southern and a northern row of rooms. Kitchen and living room are neighbours, joined
by a wide opening without a door; all are joined to the hallway by doors that stand ajar, are closed, or are missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from numpy.random import Generator

WALL_M = 0.12
DOOR_HEIGHT_M = 2.05
DOOR_ZONE_M = 0.95  # how far from a door the floor stays free

Side: TypeAlias = Literal["south", "north", "west", "east"]
DoorKind: TypeAlias = Literal["ajar", "closed", "doorway", "opening"]


@dataclass(frozen=True)
class RoomPlan:
    """A rectangular room: lower and upper corner of its free space (x0, y0), (x1, y1), and its ceiling's height."""

    id: str
    kind: str
    x0: float
    y0: float
    x1: float
    y1: float
    height: float

    def wall(self, side: Side) -> tuple[float, float, float]:
        """Of the wall at `side`: its fixed coordinate, and from where to where it runs along the other axis."""
        match side:
            case "south":
                return self.y0, self.x0, self.x1
            case "north":
                return self.y1, self.x0, self.x1
            case "west":
                return self.x0, self.y0, self.y1
            case "east":
                return self.x1, self.y0, self.y1


@dataclass(frozen=True)
class Hole:
    """A hole in a wall between the coordinates `start` … `end` along it and the heights `low` … `high`.

    rooms   (room id, side) whose walls have it: two for doors between rooms, one for windows and the front door
    hinge   of a door ajar: the end of the hole at which its leaf hangs, and the angle it stands open [rad];
            the leaf opens into the first of `rooms`
    """

    id: str
    kind: Literal["door", "window", "opening"]
    door: DoorKind | None
    rooms: tuple[tuple[str, Side], ...]
    start: float
    end: float
    low: float
    high: float
    hinge_at_start: bool = True
    angle: float = 0.0


@dataclass(frozen=True)
class FloorPlan:
    """All rooms and holes; every point of the outer walls and rooms lies within `width` × `depth` from the origin."""

    rooms: tuple[RoomPlan, ...]
    holes: tuple[Hole, ...]
    width: float
    depth: float

    def room(self, room_id: str) -> RoomPlan:
        """The room of that id."""
        return next(r for r in self.rooms if r.id == room_id)


def draw_floorplan(rng: Generator) -> FloorPlan:
    """A random plan of six or seven rooms."""
    height = float(rng.uniform(2.4, 2.7))
    south_depth, north_depth = rng.uniform(3.5, 4.4), rng.uniform(3.2, 4.0)
    hall_depth = rng.uniform(1.7, 2.0)
    south = ["kitchen", "living_room"]
    north = ["bedroom", "bathroom", "office"]
    widths = {
        "kitchen": rng.uniform(3.4, 3.9),
        "living_room": rng.uniform(4.5, 5.0),
        "bedroom": rng.uniform(3.4, 3.9),
        "bathroom": rng.uniform(2.6, 2.9),
        "office": rng.uniform(2.9, 3.4),
    }
    if rng.random() < 0.5:
        south.reverse()
    if rng.random() < 0.3:
        widths["child_room"] = rng.uniform(2.8, 3.2)
        south.insert(0 if rng.random() < 0.5 else 2, "child_room")
        widths["bedroom"], widths["bathroom"], widths["office"] = 4.2, 2.9, 4.1
    rng.shuffle(north)
    width = max(sum(widths[k] for k in row) + WALL_M * (len(row) - 1) for row in (south, north))

    rooms: list[RoomPlan] = []
    y_hall = WALL_M + south_depth + WALL_M
    y_north = y_hall + hall_depth + WALL_M
    for row, y0, depth in ((south, WALL_M, south_depth), (north, y_north, north_depth)):
        spare = (width - WALL_M * (len(row) - 1) - sum(widths[k] for k in row)) / len(row)
        x = WALL_M
        for kind in row:
            w = widths[kind] + spare
            rooms.append(RoomPlan(kind, kind, x, y0, x + w, y0 + depth, height))
            x += w + WALL_M
    low_hall = height - (0.2 if rng.random() < 0.3 and height > 2.6 else 0.0)
    rooms.append(RoomPlan("hallway", "hallway", WALL_M, y_hall, WALL_M + width, y_hall + hall_depth, low_hall))
    plan = FloorPlan(tuple(rooms), (), width + 2 * WALL_M, y_north + north_depth + WALL_M)
    return FloorPlan(plan.rooms, tuple(_holes(rng, plan, south, north)), plan.width, plan.depth)


def _holes(rng: Generator, plan: FloorPlan, south: list[str], north: list[str]) -> list[Hole]:
    holes: list[Hole] = []
    kitchen, living = plan.room("kitchen"), plan.room("living_room")
    wide = rng.uniform(2.0, 2.5)
    y = rng.uniform(kitchen.y0 + 0.35, kitchen.y1 - 0.35 - wide)
    sides: tuple[tuple[str, Side], tuple[str, Side]]
    sides = (
        (("kitchen", "east"), ("living_room", "west"))
        if kitchen.x0 < living.x0
        else (("kitchen", "west"), ("living_room", "east"))
    )
    holes.append(Hole("opening_1", "opening", "opening", sides, y, y + wide, 0.0, 2.2))

    bare = "office" if rng.random() < 0.5 else "living_room"
    for kind in (*south, *north):
        room = plan.room(kind)
        into: Side = "north" if kind in south else "south"
        hall: Side = "south" if kind in south else "north"
        w = rng.uniform(0.86, 0.94)
        at_start = bool(rng.random() < 0.5)
        margin = rng.uniform(0.25, 0.4)
        start = room.x0 + margin if at_start else room.x1 - margin - w
        door: DoorKind = "closed" if kind == "kitchen" else "doorway" if kind == bare else "ajar"
        angle = float(rng.uniform(1.35, 1.75)) if door == "ajar" else 0.0
        holes.append(
            Hole(
                f"door_{len(holes)}", "door", door, ((kind, into), ("hallway", hall)), start, start + w, 0.0,
                DOOR_HEIGHT_M, hinge_at_start=at_start, angle=angle,
            )
        )  # fmt: skip
    hallway = plan.room("hallway")
    end: Side = "west" if rng.random() < 0.5 else "east"
    y = (hallway.y0 + hallway.y1) / 2 - 0.45
    holes.append(Hole(f"door_{len(holes)}", "door", "closed", (("hallway", end),), y, y + 0.9, 0.0, DOOR_HEIGHT_M))

    for n, kind in enumerate((*south, *north)):
        room = plan.room(kind)
        w = rng.uniform(0.6, 0.8) if kind == "bathroom" else rng.uniform(1.0, 1.5)
        x = rng.uniform(room.x0 + 0.4, room.x1 - 0.4 - w)
        side: Side = "south" if kind in south else "north"
        low = rng.uniform(1.2, 1.3) if kind == "bathroom" else rng.uniform(0.95, 1.1)
        holes.append(Hole(f"window_{n + 1}", "window", None, ((kind, side),), x, x + w, low, rng.uniform(1.95, 2.1)))
    return holes
