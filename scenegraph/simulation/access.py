"""What is truly visible from where in a home, what a robot reaches, what blocks a door and what lies between what.

Exact rays against all meshes; exact free ground of a disc (the ground less all outlines, widened by its radius:
Lozano-Pérez, *Spatial planning: a configuration space approach*, 1983); exact convex hulls. Lengths in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from scenegraph.simulation.arrangement import free_floor
from scenegraph.simulation.relations import spread
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home, TrueDoor

VISIBLE_SHARE = 0.05
SIGHT_M = 10.0
BETWEEN_SHARE = 0.5
OVER_M = 0.1
"""What is lower than this is driven over."""
DOORWAY_DEEP_M = 0.35
"""What stands no farther than this before or behind the middle of a door stands in it."""
_POSE_M = 0.05
_STEP_M = 0.05  # between the places from which a robot reaches for a thing
_SLACK_M = 0.02  # a thing may stand so deep in a wall, or a door leaf in its frame


@dataclass(frozen=True)
class Disc:
    """A robot's body: radius and height, and how far it reaches beyond its rim."""

    radius_m: float
    height_m: float
    reach_m: float


class TrueAccess:
    """Measures one home."""

    def __init__(self, home: Home) -> None:
        self._home = home
        self._hulls: dict[str, Any] = {}

    # -- sight --------------------------------------------------------------------------------------------
    def visible_from(self, eye: Array) -> frozenset[str]:
        """The things of which at least VISIBLE_SHARE of the surface points are such that a ray to them from an eye (3,)
        meets the thing first."""
        home = self._home
        near = [o for o in home.objects if np.linalg.norm(o.vertices.mean(axis=0) - eye) <= SIGHT_M]
        if not near:
            return frozenset()
        points = [spread(o) for o in near]
        _, triangle = home.renderer.scene.cast(np.asarray(eye), np.concatenate(points) - eye)
        met = home.renderer.entities_of(triangle)
        seen = set()
        at = 0
        for thing, mine in zip(near, points, strict=True):
            number = home.entities.index(thing.id) + 1
            if float((met[at : at + len(mine)] == number).mean()) >= VISIBLE_SHARE:
                seen.add(thing.id)
            at += len(mine)
        return frozenset(seen)

    # -- ways ---------------------------------------------------------------------------------------------
    def reachable(self, start: Array, robot: Disc) -> frozenset[str] | None:
        """The things that a robot that stands at `start` (2,) gets so near to that it can reach them, round no wall.

        Its middle stays on the ground that its disc fits on and that is joined to where it stands; who reaches a thing
        from there does so, in the same direction, from the rim of that ground.

        None when the robot does not fit where it stands, up to the few centimetres of its pose.
        """
        low = [
            outline
            for thing in self._home.placed
            for outline in thing.solids.outlines[(thing.solids.lows < robot.height_m) & (thing.solids.highs > OVER_M)]
        ]
        free = self._open.buffer(-robot.radius_m)
        free = free.difference(shapely.union_all([*low, *self._leaves]).buffer(robot.radius_m))
        parts = shapely.get_parts(free)
        away = shapely.distance(parts, shapely.Point(self._to_home(start)))
        if not (away <= _POSE_M).any():
            return None
        ground = parts[int(away.argmin())]
        rim = shapely.points(shapely.get_coordinates(shapely.segmentize(ground.boundary, _STEP_M)))
        reach = robot.radius_m + robot.reach_m
        clear = self._open.buffer(_SLACK_M)
        shapely.prepare(clear)
        found = set()
        for thing in self._home.objects:
            hull = self._hull(thing.id)
            near = rim[shapely.distance(rim, hull) <= reach]
            if shapely.covers(clear, shapely.shortest_line(near, hull)).any() or ground.intersects(hull):
                found.add(thing.id)
        return frozenset(found)

    @cached_property
    def _open(self) -> Any:
        """The ground of all rooms and of the holes that can be walked through, in the home's frame."""
        return free_floor(self._home.plan, self._home.plan.rooms, [], 0.0)

    @cached_property
    def _leaves(self) -> list[Any]:
        """Outlines of the leaves of doors ajar, in the home's frame."""
        home = self._home
        return [self._outline(d.id) for d in home.doors if d.kind == "ajar"]

    def _outline(self, entity: str) -> Any:
        mine = self._home.triangle_entity == self._home.entities.index(entity) + 1
        corners = self._home.vertices[np.unique(self._home.triangles[mine])]
        return shapely.MultiPoint(self._to_home(corners[:, :2])).convex_hull

    def _to_home(self, points: Array) -> Array:
        """Points (…, 2) on the map's ground, in the home's frame."""
        T = self._home.T_map_home
        return np.asarray((points - T.translation[:2]) @ T.rotation[:2, :2])

    def _hull(self, thing: str) -> Any:
        """Convex ground projection of a thing, in the home's frame."""
        if thing not in self._hulls:
            ground = self._to_home(self._home.thing(thing).vertices[:, :2])
            self._hulls[thing] = shapely.MultiPoint(ground).convex_hull
        return self._hulls[thing]

    # -- doors --------------------------------------------------------------------------------------------
    def blocks(self, robot: Disc) -> frozenset[tuple[str, str]]:
        """The (thing, door) where the thing stands in the door and leaves the robot no passage beside it."""
        found = set()
        for door in self._home.doors:
            doorway, along, middle = self._doorway(door)
            for thing, placed in zip(self._home.objects, self._home.placed, strict=True):
                solids = placed.solids
                in_way = solids.outlines[(solids.lows < robot.height_m) & (solids.highs > OVER_M)]
                inside = shapely.intersection(in_way, doorway)
                if not shapely.area(inside).sum() > 0.0:
                    continue
                at = (shapely.get_coordinates(inside) - middle) @ along
                clear = max(at.min() + door.width / 2, door.width / 2 - at.max())
                if clear < 2.0 * robot.radius_m:
                    found.add((thing.id, door.id))
        return frozenset(found)

    def _doorway(self, door: TrueDoor) -> tuple[Any, Array, Array]:
        """The ground of a door, the direction along it (2,) and its middle (2,), in the home's frame."""
        normal = door.normal[:2] @ self._home.T_map_home.rotation[:2, :2]
        along = np.array([-normal[1], normal[0]])
        middle = self._to_home(door.center[:2])
        corners = [
            middle + u * door.width / 2 * along + v * DOORWAY_DEEP_M * normal
            for u, v in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        return shapely.Polygon(corners), along, middle

    # -- between ------------------------------------------------------------------------------------------
    def between(self, b: str, c: str) -> frozenset[str]:
        """The things of whose footprint at least BETWEEN_SHARE lies inside the hull of two things' and outside both."""
        one, other = self._hull(b), self._hull(c)
        gap = shapely.convex_hull(shapely.union(one, other)).difference(shapely.union(one, other))
        mine = [o.id for o in self._home.objects if o.id not in (b, c)]
        hulls = np.array([self._hull(thing) for thing in mine], dtype=object)
        shares = shapely.area(shapely.intersection(hulls, gap)) / shapely.area(hulls)
        return frozenset(thing for thing, share in zip(mine, shares.tolist(), strict=True) if share >= BETWEEN_SHARE)
