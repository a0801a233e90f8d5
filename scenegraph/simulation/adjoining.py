"""What truly stands next to, is fixed to or hangs from what in a home, from exact meshes. Lengths in metres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home
    from scenegraph.simulation.relations import Body
    from scenegraph.simulation.structure import TruePlane

Relation: TypeAlias = tuple[str, str, str]

TOUCHING_M = 0.055
"""The gap in contact, 3 cm, and one voxel of 2.5 cm, since surfaces are not known better than that."""
SIDE_SHARE = 0.2
HEAD_M = 0.05
_CONTACT_M = 0.03
_CONTACT_SHARE = 0.2
_SAMPLES = 9  # along each edge of a side
_TIE_M = 0.01
_END = 1e-3  # share of a line at either end that is its ends' own


def box_gaps(bodies: list[Body]) -> Array:
    """(n, n) distance between the boxes of things, along the axes of the map."""
    lower, upper = np.array([b.lower for b in bodies]), np.array([b.upper for b in bodies])
    apart = np.maximum(0.0, np.maximum(lower[:, None] - upper[None], lower[None] - upper[:, None]))
    return np.asarray(np.linalg.norm(apart, axis=2))


def next_to(
    bodies: Mapping[str, Body], near: Mapping[Relation, float], bearers: Mapping[str, frozenset[str]]
) -> dict[Relation, float]:
    """Of the near pairs those that one thing, or the floor, bears both, with nothing on the line between their nearest
    points. bearers: what bears each thing."""
    everything = list(bodies.values())
    lower, upper = np.array([b.lower for b in everything]), np.array([b.upper for b in everything])
    found: dict[Relation, float] = {}
    for (_, a, b), gap in near.items():
        if not bearers[a] & bearers[b]:
            continue
        p, q = _nearest(bodies[a], bodies[b])
        low, high = np.minimum(p, q), np.maximum(p, q)
        beside = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
        others = (everything[k] for k in beside if everything[k].thing.id not in (a, b))
        if not any(_crosses(other, p, q) for other in others):
            found["next_to", a, b] = gap
    return found


def _nearest(a: Body, b: Body) -> tuple[Array, Array]:
    """Points (3,) of two things that lie nearest to each other, to within _TIE_M; of all that do, the highest."""
    _, on_b = b.scene.closest(a.samples)
    _, on_a = a.scene.closest(b.samples)
    p, q = np.concatenate([a.samples, on_a]), np.concatenate([on_b, b.samples])
    distance = np.linalg.norm(p - q, axis=1)
    low = np.minimum(p[:, 2], q[:, 2])
    k = int(np.where(distance <= distance.min() + _TIE_M, low, -np.inf).argmax())
    return p[k], q[k]


def _crosses(other: Body, p: Array, q: Array) -> bool:
    if np.linalg.norm(q - p) < 1e-6:
        return False
    share = float(other.scene.cast(p[None], (q - p)[None])[0][0])
    return _END < share < 1.0 - _END


def fixed(home: Home, bodies: list[Body], borne: Mapping[str, float]) -> dict[Relation, float]:
    """`attached_to` and `hanging_from` of the things that nothing bears: to walls, ceilings and other things.

    borne: share of the footing under which anything lies in contact
    """
    found: dict[Relation, float] = {}
    walls = [plane for plane in home.structure if plane.kind == "wall"]
    for body in bodies:
        name = body.thing.id
        if borne[name] >= _CONTACT_SHARE:
            continue
        sides = _sides(body)
        flat = sides.reshape(-1, 3)
        shares = {wall.id: _on_plane(flat, wall) for wall in walls}
        for other in bodies:
            apart = np.maximum(0.0, np.maximum(body.lower - other.upper, other.lower - body.upper))
            if other is not body and float(np.linalg.norm(apart)) <= _CONTACT_M:
                shares[other.thing.id] = other.scene.distance(flat) <= _CONTACT_M
        for target, inside in shares.items():
            share = float(inside.reshape(4, -1).mean(axis=1).max())
            if share >= SIDE_SHARE:
                found["attached_to", name, target] = share
        found |= {("hanging_from", name, target): share for target, share in _tops(home, body).items()}
    return found


def _sides(body: Body) -> Array:
    """(4, n, 3) points spread over the four sides of a thing's own box."""
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    across, up = (grid.ravel() for grid in np.meshgrid(steps, steps))
    half = np.full(len(up), 0.5)
    local = [(half, across), (-half, across), (across, half), (across, -half)]
    sides = np.stack([np.stack([u, v, up], axis=1) for u, v in local]) * body.thing.size
    return np.asarray(sides @ body.axes + body.thing.center)


def _on_plane(points: Array, plane: TruePlane) -> Array:
    """(n,) bool: points (n, 3) in contact with a plane, within the rectangle about it."""
    local = (points - plane.origin) @ plane.axes.T
    inside = ((local >= -1e-6) & (local <= np.array(plane.extent) + 1e-6)).all(axis=1)
    return np.asarray(inside & (np.abs(points @ plane.normal - plane.offset) <= _CONTACT_M))


def _tops(home: Home, body: Body) -> dict[str, float]:
    """Share of the topmost part over which the first other material upwards, within contact, is a thing's or a
    ceiling's."""
    up = np.array([0.0, 0.0, 1.0])
    columns = np.column_stack([body.columns, np.full(len(body.columns), body.upper[2] + 0.1)])
    down = body.scene.cast(columns, -up)[0]
    top = columns[:, 2] - down
    head = np.column_stack([body.columns, top])[top >= body.upper[2] - HEAD_M]
    distance, triangle = home.renderer.scene.cast(head + 2e-4 * up, up)
    close = distance <= _CONTACT_M
    found: dict[str, float] = {}
    for t in triangle[close].tolist():
        entity, plane = int(home.triangle_entity[t]), int(home.triangle_plane[t])
        target = home.entities[entity - 1] if entity else home.structure[plane].id if plane >= 0 else ""
        if target and target != body.thing.id:
            found[target] = found.get(target, 0.0) + 1.0 / len(head)
    return {target: share for target, share in found.items() if share >= _CONTACT_SHARE}
