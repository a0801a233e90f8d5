"""Puts things into rooms, against walls, about the floor and upon each other, so that none runs into another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.random import Generator

from scenegraph.simulation.floorplan import DOOR_ZONE_M, WALL_M, FloorPlan, Hole, RoomPlan, Side
from scenegraph.simulation.shapes import Array, Model, Surface

Maker: TypeAlias = Callable[[Generator], Model]

REST_M = 0.001  # a thing stands this far over what bears it
ROBOT_RADIUS_M = 0.25
ROBOT_HEIGHT_M = 1.45
_TRIES = 60
_YAW = {"south": np.pi, "north": 0.0, "west": np.pi / 2, "east": -np.pi / 2}


@dataclass(frozen=True, eq=False)
class Solids:
    """Upright prisms in the home's frame: `outlines` (n,) shapely polygons, from `lows` (n,) to `highs` (n,) [m]."""

    outlines: Array
    lows: Array
    highs: Array


@dataclass(frozen=True)
class Placed:
    """A thing in the home's frame: its model, turned by `yaw` [rad] about z and moved to `position`."""

    id: str
    model: Model
    position: tuple[float, float, float]
    yaw: float
    room: str
    support: str | None = None

    def to_home(self, points: Array) -> Array:
        """Points of the model (N, 2) or (N, 3) in the home's frame."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        moved = points.copy()
        moved[:, 0] = c * points[:, 0] - s * points[:, 1] + self.position[0]
        moved[:, 1] = s * points[:, 0] + c * points[:, 1] + self.position[1]
        if points.shape[1] == 3:
            moved[:, 2] += self.position[2]
        return moved

    @cached_property
    def solids(self) -> Solids:
        """Its material as upright prisms, in the home's frame."""
        mine = self.model.solids
        outlines = shapely.transform(np.array([s.outline for s in mine], dtype=object), self.to_home)
        z = self.position[2]
        return Solids(outlines, np.array([s.low for s in mine]) + z, np.array([s.high for s in mine]) + z)

    @cached_property
    def footprint(self) -> Any:
        """The rectangle of its bounding box on the ground, a shapely polygon."""
        lower, upper = self.model.lower, self.model.upper
        return shapely.transform(shapely.box(lower[0], lower[1], upper[0], upper[1]), self.to_home)

    @property
    def top(self) -> float:
        """Height of its highest point [m]."""
        return float(self.position[2] + self.model.upper[2])


def overlap(a: Solids, b: Solids, margin: float = 0.0) -> bool:
    """Whether material of `a`, widened by `margin` [m] on all sides, meets material of `b`."""
    i, j = np.nonzero((a.lows[:, None] < b.highs) & (b.lows < a.highs[:, None]))
    return bool(shapely.dwithin(a.outlines[i], b.outlines[j], margin).any())


class Arrangement:
    """One room while it is being filled. Methods return the placed thing, or None when no free place was found."""

    def __init__(self, rng: Generator, plan: FloorPlan, room: RoomPlan) -> None:
        self.rng, self.plan, self.room = rng, plan, room
        self.things: list[Placed] = []
        self.outline = shapely.box(room.x0, room.y0, room.x1, room.y1)
        zones: list[tuple[Any, float, float]] = []
        self.gates: list[tuple[float, float]] = []
        self._number = count()
        for hole in plan.holes:
            for owner, side in hole.rooms:
                if owner == room.id:
                    zones.append(self._zone(hole, side))
        outlines, lows, highs = zip(*zones, strict=True)
        self.zones = Solids(np.array(outlines, dtype=object), np.array(lows), np.array(highs))

    def _zone(self, hole: Hole, side: Side) -> tuple[Any, float, float]:
        """What must stay free before a door or window: an outline, and from which height to which."""
        window, start, end = hole.kind == "window", hole.start, hole.end
        deep = 0.3 if window else 0.6 if self.room.kind == "hallway" else DOOR_ZONE_M
        fixed, _, _ = self.room.wall(side)
        inward = 1.0 if side in ("south", "west") else -1.0
        a, b = sorted((fixed, fixed + inward * deep))
        if not window:
            start, end = start - 0.25, end + 0.25
        rectangle = shapely.box(start, a, end, b) if side in ("south", "north") else shapely.box(a, start, b, end)
        if not window:
            middle, gate = (start + end) / 2, fixed + inward * (ROBOT_RADIUS_M + 0.1)
            self.gates.append((middle, gate) if side in ("south", "north") else (gate, middle))
        return rectangle, hole.low - 0.03, hole.high

    # -- placing ------------------------------------------------------------------------------------------
    def against_wall(
        self, make: Maker, *, sides: Sequence[Side] = ("south", "north", "west", "east"), height: float = 0.0,
        gap: float = 0.02, margin: float = 0.03, yaw: float = 0.0, beside: Placed | None = None,
    ) -> Placed | None:  # fmt: skip
        """With its back to a wall, `height` above the floor, turned by up to `yaw`; near `beside` along its wall."""
        model = make(self.rng)
        half = (model.upper[1] - model.lower[1]) / 2
        for _ in range(_TRIES):
            side = sides[int(self.rng.integers(len(sides)))]
            fixed, start, end = self.room.wall(side)
            reach = float(model.upper[0])
            if end - start < 2 * reach + 0.02:
                continue
            along = self.rng.uniform(start + reach + 0.01, end - reach - 0.01)
            if beside is not None:
                middle = beside.position[0] if side in ("south", "north") else beside.position[1]
                shift = reach + float(beside.model.upper[0]) + self.rng.uniform(0.03, 0.08)
                along = middle + shift * (1 if self.rng.random() < 0.5 else -1) if height == 0.0 else middle
            turn = self.rng.uniform(-yaw, yaw)
            away = half * np.cos(turn) + reach * abs(np.sin(turn)) + gap
            inward = 1.0 if side in ("south", "west") else -1.0
            across = fixed + inward * away
            x, y = (along, across) if side in ("south", "north") else (across, along)
            placed = self._try(model, (x, y, height), _YAW[side] + turn, margin)
            if placed is not None:
                return placed
        return None

    def on_floor(
        self, make: Maker, *, margin: float = 0.05, aligned: bool = False, inset: float = 0.05
    ) -> Placed | None:
        """Anywhere on the free floor, turned at random."""
        model = make(self.rng)
        for _ in range(_TRIES):
            yaw = self.rng.uniform(-np.pi, np.pi)
            if aligned:
                yaw = np.pi / 2 * self.rng.integers(4) + self.rng.normal(0.0, 0.03)
            r = self.room
            x, y = self.rng.uniform(r.x0 + inset, r.x1 - inset), self.rng.uniform(r.y0 + inset, r.y1 - inset)
            placed = self._try(model, (x, y, REST_M), yaw, margin)
            if placed is not None:
                return placed
        return None

    def before(
        self,
        make: Maker,
        of: Placed,
        offset: tuple[float, float],
        turn: float,
        jitter: float = 0.15,
        margin: float = 0.02,
    ) -> Placed | None:
        """On the floor at `offset` (x, y) in the frame of `of`, turned by `turn` against it, each a little varied."""
        model = make(self.rng)
        for k in range(_TRIES):
            wobble = 0.02 + 0.1 * k / _TRIES
            local = np.array([offset]) + self.rng.uniform(-wobble, wobble, (1, 2))
            x, y = of.to_home(local)[0]
            yaw = of.yaw + turn + self.rng.uniform(-jitter, jitter)
            placed = self._try(model, (float(x), float(y), REST_M), yaw, margin)
            if placed is not None:
                return placed
        return None

    def upon(
        self, make: Maker, bearer: Placed | None, *, level: int | None = None, yaw: float = np.pi,
        margin: float = 0.012, at: tuple[float, float] | None = None,
    ) -> Placed | None:  # fmt: skip
        """On (or in) `bearer`: on its surface number `level`, or any; turned by up to `yaw` against it.

        `at` asks for a place on the surface, each coordinate from 0 to 1.
        """
        if bearer is None or not bearer.model.surfaces:
            return None
        model = make(self.rng)
        surfaces = bearer.model.surfaces
        for k in range(_TRIES):
            surface = surfaces[int(self.rng.integers(len(surfaces))) if level is None else level]
            turn = self.rng.uniform(-yaw, yaw)
            spot = self._spot(model, surface, turn, at if k < _TRIES // 2 else None)
            if spot is None:
                continue
            x, y = bearer.to_home(np.array([spot]))[0]
            z = bearer.position[2] + surface.z + REST_M
            placed = self._try(model, (float(x), float(y), float(z)), bearer.yaw + turn, margin, bearer.id)
            if placed is not None:
                return placed
        return None

    def _spot(self, model: Model, surface: Surface, turn: float, at: tuple[float, float] | None) -> Array | None:
        """A place on the surface at which the foot of the model, turned by `turn`, does not reach over its edge."""
        if model.upper[2] > surface.clearance:
            return None
        foot = np.concatenate(
            [shapely.get_coordinates(s.outline) for s in model.solids if s.low < 0.3 * float(model.upper[2])]
        )
        c, s = np.cos(turn), np.sin(turn)
        turned = foot @ np.array([[c, s], [-s, c]])
        lower, upper = surface.lower - turned.min(axis=0), surface.upper - turned.max(axis=0)
        if np.any(lower > upper):
            return None
        share = self.rng.uniform(0.0, 1.0, 2) if at is None else np.array(at)
        return np.asarray(lower + (upper - lower) * share)

    def _try(
        self, model: Model, position: tuple[float, float, float], yaw: float, margin: float, support: str | None = None
    ) -> Placed | None:
        name = f"{self.room.id}.{next(self._number)}"
        height = max(position[2], REST_M)
        placed = Placed(name, model, (position[0], position[1], height), yaw, self.room.id, support)
        if not self.outline.contains(placed.footprint) or placed.top > self.room.height - 0.05:
            return None
        if support is None and overlap(placed.solids, self.zones):
            return None
        near = shapely.dwithin([other.footprint for other in self.things], placed.footprint, margin)
        for k in np.flatnonzero(near):
            other = self.things[k]
            if overlap(placed.solids, other.solids, 0.0 if other.id == support else margin):
                return None
        self.things.append(placed)
        return placed

    def remove(self, thing: Placed) -> None:
        """Takes a thing away, with all that stands on or in it."""
        gone = {thing.id}
        while more := {t.id for t in self.things if t.support in gone} - gone:
            gone |= more
        self.things = [t for t in self.things if t.id not in gone]

    # -- judging ------------------------------------------------------------------------------------------
    def free_floor(self, clearance: float = ROBOT_RADIUS_M + 0.1) -> Any:
        """Where the middle of a robot may be: the room less what stands in its way."""
        return free_floor(self.plan, [self.room], self.things, clearance)

    def passable(self) -> bool:
        """Whether a robot gets from each door of the room to each other one, and to most of its floor."""
        parts = shapely.get_parts(self.free_floor())
        if len(parts) == 0:
            return False
        largest = max(parts, key=lambda part: part.area)
        most = largest.area > max(0.8, 0.75 * sum(part.area for part in parts))
        return bool(most and all(largest.distance(shapely.Point(gate)) < 0.1 for gate in self.gates))


def free_floor(plan: FloorPlan, rooms: Sequence[RoomPlan], things: Sequence[Placed], clearance: float) -> Any:
    """Where the middle of a robot of radius `clearance` may be in `rooms`: a shapely geometry in the home's frame."""
    inside = [shapely.box(r.x0, r.y0, r.x1, r.y1) for r in rooms]
    ids = {r.id for r in rooms}
    for hole in plan.holes:
        if hole.kind != "window" and hole.door != "closed" and all(owner in ids for owner, _ in hole.rooms):
            owner, side = hole.rooms[0]
            fixed, _, _ = plan.room(owner).wall(side)
            beyond = fixed - WALL_M if side in ("south", "west") else fixed + WALL_M
            a, b = min(fixed, beyond) - 0.01, max(fixed, beyond) + 0.01
            flat = side in ("south", "north")
            inside.append(shapely.box(hole.start, a, hole.end, b) if flat else shapely.box(a, hole.start, b, hole.end))
    # a negative buffer with flat corners shrinks the floor; what stands on it grows
    floor = shapely.union_all(inside).buffer(-clearance)
    low = [outline for t in things for outline in t.solids.outlines[t.solids.lows < ROBOT_HEIGHT_M]]
    return floor.difference(shapely.union_all(low).buffer(clearance)) if low else floor
