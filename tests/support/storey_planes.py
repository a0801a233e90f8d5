"""Planes of a storey as they are seen: rooms side by side with walls, a leaf each, and furniture as clutter."""

from __future__ import annotations

import numpy as np

from reasoning.labelling import PlaneFacts, PlaneRelation

ROOM_M = (4.0, 3.5, 2.6)
"""Inner length and width of a room, and its height."""
WALL_M = 0.15


def storey_planes(n: int, clutter: float, seed: int = 0) -> tuple[list[PlaneFacts], list[PlaneRelation]]:
    """About n planes, of which a share is furniture, without any label, and how they stand to each other.

    Seven planes are a room: floor, ceiling, four walls and a leaf ajar. Relations are those of
    `scenegraph.perception.plane_relations`, of boxes.
    """
    rng = np.random.default_rng(seed)
    rooms = max(1, round(n * (1.0 - clutter) / 7.0))
    columns = max(1, int(np.ceil(np.sqrt(rooms))))
    low = [np.array([k % columns, k // columns]) * (np.array(ROOM_M[:2]) + WALL_M) for k in range(rooms)]
    boxes = [box for corner in low for box in _room(corner, rng)]
    boxes += [_furniture(low[k % rooms], rng) for k in range(max(0, n - len(boxes)))]
    planes = [_facts(k, facing, *corners) for k, (facing, *corners) in enumerate(boxes)]
    corners = np.array([[a, b] for _, a, b in boxes])
    relations = [
        relation
        for i in range(len(boxes))
        for j in np.flatnonzero(_gap(corners[i], corners[i + 1 :]) <= 1.0) + i + 1
        for relation in _between(i, int(j), boxes[i], boxes[j])
    ]
    return planes, relations


def _room(corner, rng):  # type: ignore[no-untyped-def]
    (x, y), (a, b, h) = corner, ROOM_M
    h += rng.uniform(-0.03, 0.03)
    low = rng.uniform(0.0, 0.4)
    door = x + rng.uniform(0.3, a - 1.3)
    return [
        ("up", np.array([x, y, 0.0]), np.array([x + a, y + b, 0.01])),
        ("down", np.array([x, y, h]), np.array([x + a, y + b, h + 0.01])),
        ("side", np.array([x, y, low]), np.array([x + a, y, h])),
        ("side", np.array([x, y + b, 0.0]), np.array([x + a, y + b, h])),
        ("side", np.array([x, y, 0.0]), np.array([x, y + b, h])),
        ("side", np.array([x + a, y, 0.0]), np.array([x + a, y + b, h])),
        ("askew", np.array([door, y + 0.02, 0.0]), np.array([door + 0.6, y + 0.7, 2.0])),
    ]


def _furniture(corner, rng):  # type: ignore[no-untyped-def]
    x, y = corner + rng.uniform(0.0, 0.6, 2) * ROOM_M[:2]
    length, depth, height = rng.uniform(0.5, 1.8), rng.uniform(0.3, 0.9), rng.uniform(0.4, 2.3)
    kind = rng.integers(4)
    if kind == 0:
        return "up", np.array([x, y, height]), np.array([x + length, y + depth, height + 0.01])
    if kind == 1:
        return "down", np.array([x, y, height]), np.array([x + length, y + depth, height + 0.01])
    if kind == 2:
        return "side", np.array([x, y, 0.0]), np.array([x + length, y, height])
    return "side", np.array([x, y, 0.0]), np.array([x, y + length, height])


def _facts(k: int, facing: str, low, high) -> PlaneFacts:  # type: ignore[no-untyped-def]
    size = high - low
    width = float(np.hypot(size[0], size[1])) if facing in ("side", "askew") else float(max(size[:2]))
    area = float(size[0] * size[1]) if facing in ("up", "down") else width * float(size[2])
    facing = "side" if facing == "askew" else facing
    return PlaneFacts(k, facing, float(low[2]), float(high[2]), width, area)


def _gap(one, others):  # type: ignore[no-untyped-def]
    """Horizontal distance between upright boxes."""
    apart = np.maximum(0.0, np.maximum(others[:, 0, :2] - one[1, :2], one[0, :2] - others[:, 1, :2]))
    return np.hypot(apart[:, 0], apart[:, 1])


def _between(i: int, j: int, one, two) -> list[PlaneRelation]:  # type: ignore[no-untyped-def]
    gap = float(_gap(np.array(one[1:]), np.array([two[1:]]))[0])
    level = [box[0] in ("up", "down") for box in (one, two)]
    if all(level):
        return _level(i, j, one, two) if gap <= 0.4 else []
    if any(level):
        return _standing(*((i, j, one, two) if level[0] else (j, i, two, one))) if gap <= 0.2 else []
    if "askew" in (one[0], two[0]):
        return []
    along = [int(box[2][0] - box[1][0] > box[2][1] - box[1][1]) for box in (one, two)]
    if along[0] == along[1]:
        return [("parallel", i, j)]
    if gap > 0.4:
        return []
    alike = abs(one[2][2] - two[2][2]) <= 0.1
    return [("orthogonal", i, j), *([("equalheight", i, j)] if alike else [])]


def _level(i: int, j: int, one, two) -> list[PlaneRelation]:  # type: ignore[no-untyped-def]
    rise = two[1][2] - one[1][2]
    upper, lower = ((j, two), (i, one)) if rise > 0.0 else ((i, one), (j, two))
    if abs(rise) <= 0.1:
        return [("parallel", i, j), ("equalheight", i, j)] if one[0] == two[0] else [("parallel", i, j)]
    if one[0] == two[0] or (upper[1][0], lower[1][0]) == ("down", "up"):
        return [("parallel", i, j), ("above", upper[0], lower[0])]
    return []


def _standing(level: int, upright: int, flat, side) -> list[PlaneRelation]:  # type: ignore[no-untyped-def]
    found: list[PlaneRelation] = [("orthogonal", level, upright)]
    middle = 0.5 * (side[1][2] + side[2][2])
    if flat[0] == "down" and middle < flat[1][2]:
        return [*found, ("above", level, upright)]
    if flat[0] == "up" and middle > flat[1][2]:
        return [*found, ("above", upright, level)]
    return []
