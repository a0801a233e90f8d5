"""Which spatial relations truly hold between the things of a home, from their exact meshes.

The definitions are those of the scene graph's relations: contact of footings for `on`, enclosed space for `in`, shares
of footprints for rooms, columns for `above`, the shortest way around structure for `near`; the rest is in `adjoining`.
Lengths in metres.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import shapely
from scipy.spatial import cKDTree

from scenegraph.simulation.adjoining import TOUCHING_M, box_gaps, fixed, next_to
from scenegraph.simulation.rays import RayScene
from scenegraph.simulation.shapes import Array
from scenegraph.simulation.ways import WayAround

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home, TrueObject

Relation: TypeAlias = tuple[str, str, str]

GROUND = "ground"
"""Stands for floors where things are named."""

CONTACT_GAP_M = 0.03
CONTACT_SHARE = 0.2
FOOTING_INSIDE = 0.8
MATERIAL_INSIDE = 0.3
CLOSED_SIDES = 4
ROOM_SHARE = 0.5
ROOM_SHARE_ALONE = 0.8
OVERLAP_SHARE = 0.2
NEAR_M = (0.5, 1.5)

_EPSILON_M = 2e-4
_SPACING_M = 0.025  # of the samples on a surface


@dataclass(frozen=True, eq=False)
class Body:
    """A thing prepared for measuring: its own ray-casting scene, hull on the ground, samples and columns.

    samples (n, 3) points spread evenly over its surface, and its vertices; footing (m, 3) the lowest points of the
    columns whose lowest material lies within the contact gap of the lowest point of all; columns (k, 2) over its box
    """

    thing: TrueObject
    scene: RayScene
    hull: Any
    lower: Array
    upper: Array
    axes: Array
    samples: Array
    tree: Any
    footing: Array
    columns: Array

    @property
    def longer_side(self) -> float:
        """The longer side of its footprint [m]."""
        return float(max(self.thing.size[:2]))


def true_relations(home: Home) -> dict[Relation, float]:
    """Relation (name, a, b) → the value that was measured, for all that hold.

    `on`, `in`, `above`; `near`, `next_to`, `touching` with a < b; `attached_to`, `hanging_from`: b may be a true plane.
    """
    bodies = [_body(o) for o in home.objects]
    found: dict[Relation, float] = {}
    contacts = _contacts(home, bodies)
    by_id = {b.thing.id: b for b in bodies}
    borne: defaultdict[str, float] = defaultdict(float)
    bearers: defaultdict[str, set[str]] = defaultdict(set)
    for (upper, lower), share in contacts.items():
        borne[upper] += share
        if share < CONTACT_SHARE:
            continue
        if lower == GROUND:
            bearers[upper].add(GROUND)
        elif (by_id[upper].lower[2], upper) > (by_id[lower].lower[2], lower):
            found["on", upper, lower] = share
            bearers[upper].add(lower)
    for a, b, share in _overlapping(bodies):
        for one, other in ((a, b), (b, a)):
            inside = _inside(one, other)
            if inside >= FOOTING_INSIDE:
                found["in", one.thing.id, other.thing.id] = inside
            if share >= OVERLAP_SHARE and ("on", one.thing.id, other.thing.id) not in found:
                rise = _rise(one, other)
                if rise > TOUCHING_M:
                    found["above", one.thing.id, other.thing.id] = rise
    found.update(_rooms(home, bodies, found))
    near = _near(home, bodies)
    found.update(near)
    found.update(next_to(by_id, near, {name: frozenset(bearers[name]) for name in by_id}))
    found.update(_touching(bodies))
    found.update(fixed(home, bodies, borne))
    return found


# -- preparing ------------------------------------------------------------------------------------------------


def _body(thing: TrueObject) -> Body:
    scene = RayScene(thing.vertices, thing.triangles)
    c, s = np.cos(thing.yaw), np.sin(thing.yaw)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    samples = spread(thing)
    lower, upper = thing.vertices.min(axis=0), thing.vertices.max(axis=0)
    columns = _columns(thing.center, thing.size[:2] / 2, axes, 700)
    up = np.array([0.0, 0.0, 1.0])
    start = np.column_stack([columns, np.full(len(columns), lower[2] - 0.1)])
    lowest = lower[2] - 0.1 + scene.cast(start, up)[0]
    footing = np.column_stack([columns, lowest])[lowest <= lower[2] + CONTACT_GAP_M]
    hull = shapely.MultiPoint(thing.vertices[:, :2]).convex_hull
    return Body(thing, scene, hull, lower, upper, axes, samples, cKDTree(samples), footing, columns)


def _columns(center: Array, half: Array, axes: Array, count: int) -> Array:
    """About `count` points (n, 2) on a grid over a rectangle on the ground, along its own axes, none on its border."""
    n = np.maximum(3, np.ceil(2 * half / np.sqrt(4 * half[0] * half[1] / count)).astype(int))
    u = half[0] * ((np.arange(n[0]) + 0.47) * 2 / n[0] - 1)
    v = half[1] * ((np.arange(n[1]) + 0.47) * 2 / n[1] - 1)
    gu, gv = np.meshgrid(u, v, indexing="ij")
    return np.asarray(center[:2] + gu.reshape(-1, 1) * axes[0, :2] + gv.reshape(-1, 1) * axes[1, :2])


def spread(thing: TrueObject) -> Array:
    """Points on the surface, by area, and the vertices: the same for the same mesh wherever it stands."""
    corners = thing.vertices[thing.triangles]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(u, v), axis=1) / 2
    count = int(np.clip(area.sum() / _SPACING_M**2, 150, 1200))
    rng = np.random.default_rng(0)
    which = rng.choice(len(area), count, p=area / area.sum())
    a, b = rng.random(count), rng.random(count)
    fold = a + b > 1
    a[fold], b[fold] = 1 - a[fold], 1 - b[fold]
    inner = corners[which, 0] + a[:, None] * u[which] + b[:, None] * v[which]
    return np.concatenate([inner, thing.vertices])


# -- on, in, above --------------------------------------------------------------------------------------------


def _contacts(home: Home, bodies: list[Body]) -> dict[tuple[str, str], float]:
    """(a, b) → share of a's footing under which the first other material downwards, within the gap, is b's, or the
    structure's (`GROUND`)."""
    feet = [b.footing for b in bodies]
    points = np.concatenate(feet)
    points = points - np.array([0.0, 0.0, _EPSILON_M])
    distance, triangle = home.renderer.scene.cast(points, np.array([0.0, 0.0, -1.0]))
    entity = np.where(distance <= CONTACT_GAP_M, home.renderer.entities_of(triangle), -1)
    owner = np.repeat(np.arange(len(bodies)), [len(f) for f in feet])
    shares: dict[tuple[str, str], float] = {}
    for k, body in enumerate(bodies):
        below = np.bincount(entity[owner == k] + 1, minlength=2)
        for e in np.flatnonzero(below[1:]):
            if e <= len(bodies) and (e == 0 or bodies[e - 1] is not body):
                lower = bodies[e - 1].thing.id if e else GROUND
                shares[body.thing.id, lower] = float(below[e + 1] / below.sum())
    return shares


def _overlapping(bodies: list[Body]) -> list[tuple[Body, Body, float]]:
    """Pairs whose footprints overlap, and the share of the smaller footprint that does."""
    tree = shapely.STRtree([b.hull for b in bodies])
    one, other = tree.query([b.hull for b in bodies], predicate="intersects")
    pairs = []
    for i, j in zip(one[one < other].tolist(), other[one < other].tolist(), strict=True):
        a, b = bodies[i], bodies[j]
        pairs.append((a, b, float(a.hull.intersection(b.hull).area / min(a.hull.area, b.hull.area))))
    return pairs


def _enclosed(points: Array, body: Body) -> Array:
    """(n,) bool: whether points lie in the body's interior: in its box and closed in, or in a container's box."""
    local = (points - body.thing.center) @ body.axes.T
    result = np.all(np.abs(local) <= body.thing.size / 2, axis=1)
    if body.thing.container or not result.any():
        return np.asarray(result)
    x, y, z = body.axes
    inside = points[result]
    closed = sum(np.isfinite(body.scene.cast(inside, d)[0]).astype(int) for d in (x, -x, y, -y, -z))
    result[result] = closed >= CLOSED_SIDES
    return np.asarray(result)


def _inside(a: Body, b: Body) -> float:
    """Share of a's footing inside b's interior; 0 when too little of its material is."""
    if a.lower[2] < b.lower[2] - _EPSILON_M or a.lower[2] > b.upper[2] or np.prod(a.thing.size) > np.prod(b.thing.size):
        return 0.0
    footing = float(_enclosed(a.footing, b).mean())
    if footing < FOOTING_INSIDE or float(_enclosed(a.samples, b).mean()) < MATERIAL_INSIDE:
        return 0.0
    return footing


def _rise(a: Body, b: Body) -> float:
    """Median over the overlapping columns of (bottom of a − top of b); -inf when they share no column."""
    if a.upper[2] <= b.lower[2]:
        return -np.inf
    smaller = a if a.hull.area <= b.hull.area else b
    columns = _columns(smaller.thing.center, smaller.thing.size[:2] / 2, smaller.axes, 500)
    low, high = a.lower[2] - 0.1, b.upper[2] + 0.1
    up, down = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
    bottom = low + a.scene.cast(np.column_stack([columns, np.full(len(columns), low)]), up)[0]
    top = high - b.scene.cast(np.column_stack([columns, np.full(len(columns), high)]), down)[0]
    both = np.isfinite(bottom) & np.isfinite(top)
    return float(np.median(bottom[both] - top[both])) if both.any() else -np.inf


# -- rooms ----------------------------------------------------------------------------------------------------


def _rooms(home: Home, bodies: list[Body], found: dict[Relation, float]) -> dict[Relation, float]:
    rooms = [(r.id, shapely.Polygon(r.footprint)) for r in sorted(home.rooms, key=lambda r: r.id)]
    bearer: dict[str, str] = {}
    for (name, a, b), _ in sorted(found.items(), key=lambda item: -item[1]):
        if name == "on":
            bearer.setdefault(a, b)
    share: dict[str, tuple[float, str]] = {}
    for body in bodies:
        parts = [(float(body.hull.intersection(polygon).area / body.hull.area), room) for room, polygon in rooms]
        share[body.thing.id] = max(parts, key=lambda part: part[0])

    def room_of(thing: str) -> tuple[float, str]:
        own = share[thing]
        if own[0] < ROOM_SHARE_ALONE and thing in bearer:
            return room_of(bearer[thing])
        return own

    result: dict[Relation, float] = {}
    for body in bodies:
        value, room = room_of(body.thing.id)
        if value >= ROOM_SHARE:
            result["in", body.thing.id, room] = value
    return result


# -- near -----------------------------------------------------------------------------------------------------


def near_distance(a: Body, b: Body) -> float:
    """Up to which length of the way between them two things are near [m]."""
    return float(np.clip((a.longer_side + b.longer_side) / 2, *NEAR_M))


def _near(home: Home, bodies: list[Body]) -> dict[Relation, float]:
    ways = WayAround(home)
    result: dict[Relation, float] = {}
    for a, b in combinations(sorted(bodies, key=lambda body: body.thing.id), 2):
        reach = near_distance(a, b)
        apart = np.maximum(0.0, np.maximum(a.lower - b.upper, b.lower - a.upper))
        if float(np.linalg.norm(apart)) > reach:
            continue
        together = a.thing.room == b.thing.room  # nothing stands between them, since rooms are convex
        gap = surface_gap(a, b, reach) if together else ways.length(a.samples, b.samples, reach)
        if gap <= reach:
            result["near", a.thing.id, b.thing.id] = gap
    return result


def _touching(bodies: list[Body]) -> dict[Relation, float]:
    result: dict[Relation, float] = {}
    for i, j in np.argwhere(np.triu(box_gaps(bodies) <= TOUCHING_M, 1)).tolist():
        gap = surface_gap(bodies[i], bodies[j], TOUCHING_M)
        if gap <= TOUCHING_M:
            a, b = sorted((bodies[i].thing.id, bodies[j].thing.id))
            result["touching", a, b] = gap
    return result


def surface_gap(a: Body, b: Body, reach: float) -> float:
    """Smallest distance between two surfaces, exact up to `reach`, beyond it to within the samples' spacing."""
    few, many = (a, b) if len(a.samples) <= len(b.samples) else (b, a)
    gap = float(many.tree.query(few.samples)[0].min())
    if gap > reach + 2 * _SPACING_M:
        return gap
    return min(gap, float(b.scene.distance(a.samples).min()), float(a.scene.distance(b.samples).min()))
