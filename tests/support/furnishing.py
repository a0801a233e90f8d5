"""Things as sets of surface points, and buildings that say exactly what stands between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from reasoning import KnowledgeBase
from reasoning.terms import Atom, Compound
from scenegraph.facts import measurement_facts
from scenegraph.perception.contacts import Wall
from scenegraph.perception.relations import Passage, Relations
from scenegraph.perception.shapes import Shape

VOXEL = 0.025
Part = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Centre and size of a box [m]."""


def surface(*parts: Part, step: float = 0.02, faces: Sequence[str] = ("x", "y", "z")) -> np.ndarray:
    """Points (N, 3) on the outside of boxes, about one each `step`; `faces`: which of them are there ("z": top and
    bottom, "top" only the top)."""
    points = []
    for center, size in parts:
        for axis, name in enumerate("xyz"):
            sides = [-1, 1] if name in faces else [1] if name == "z" and "top" in faces else []
            if not sides:
                continue
            others = [k for k in range(3) if k != axis]
            lines = [np.linspace(-0.5 * size[k], 0.5 * size[k], max(2, round(size[k] / step) + 1)) for k in others]
            grid = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
            for side in sides:
                face = np.empty((len(grid), 3))
                face[:, others] = grid
                face[:, axis] = 0.5 * side * size[axis]
                points.append(face + center)
    return np.concatenate(points)


def thing(*parts: Part, at: Sequence[float] = (0.0, 0.0, 0.0), yaw: float = 0.0, **how: object) -> Shape:
    """A thing made of boxes, turned by yaw about its own origin and put at a place."""
    return placed(surface(*parts, **how), at, yaw)  # type: ignore[arg-type]


def placed(points: np.ndarray, at: Sequence[float], yaw: float = 0.0) -> Shape:
    """A thing with these points, turned about its own origin and put at a place."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return Shape((points @ turn.T + at).astype(np.float32), VOXEL)


def box(size: tuple[float, float, float]) -> Part:
    """A box that stands on its origin."""
    return ((0.0, 0.0, 0.5 * size[2]), size)


def plate_on_legs(length: float, width: float, height: float) -> list[Part]:
    """A table, or the seat of a chair."""
    x, y = 0.5 * length - 0.03, 0.5 * width - 0.03
    legs = [((i * x, j * y, 0.5 * height - 0.02), (0.05, 0.05, height - 0.04)) for i in (-1, 1) for j in (-1, 1)]
    return [((0.0, 0.0, height - 0.02), (length, width, 0.04)), *legs]


def chair() -> list[Part]:
    return [*plate_on_legs(0.44, 0.44, 0.46), ((-0.2, 0.0, 0.7), (0.04, 0.44, 0.48))]


def cup() -> np.ndarray:
    """Points of a hollow cup, 8 cm wide and 10 cm high, bottom and wall, standing on its origin."""
    angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    wall = [(0.04 * np.cos(a), 0.04 * np.sin(a), z) for a in angle for z in np.linspace(0.0, 0.1, 8)]
    bottom = [(r * np.cos(a), r * np.sin(a), 0.0) for a in angle for r in (0.0, 0.015, 0.03)]
    return np.array([*wall, *bottom])


@dataclass
class Plan:
    """A building: walls as segments in plan with their range of heights, floors and slabs as heights, doors as points.

    A way around structure leads through one of the doors; what was not seen is listed as `unseen` walls, and space that
    was not seen as `hidden` boxes, lowest and highest corner of each.
    """

    floors: Mapping[str, float] = field(default_factory=lambda: {"plane_1": 0.0})
    slabs: Sequence[float] = ()
    walls: Sequence[tuple[float, float, float, float]] = ()
    unseen: Sequence[tuple[float, float, float, float]] = ()
    doors: Sequence[tuple[float, float]] = ()
    ceilings: Mapping[str, float] = field(default_factory=dict)
    seen_free_everywhere: bool = True
    hidden: Sequence[tuple[tuple[float, float, float], tuple[float, float, float]]] = ()

    def floor_below(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        below = {name: height for name, height in self.floors.items() if height <= z + 0.3}
        if not below:
            return None
        name = max(below, key=lambda n: below[n])
        return name, below[name]

    def ceiling_above(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        above = {name: height for name, height in self.ceilings.items() if height >= z - 0.3}
        if not above:
            return None
        name = min(above, key=lambda n: above[n])
        return name, above[name]

    def walls_beside(self, low: np.ndarray, high: np.ndarray) -> list[Wall]:
        found = []
        for n, (x0, y0, x1, y1) in enumerate(self.walls):
            along = np.array([x1 - x0, y1 - y0]) / np.hypot(x1 - x0, y1 - y0)
            normal = np.array([-along[1], along[0]])
            start = np.array([x0, y0])
            found.append(
                Wall(f"wall_{n}", normal, float(start @ normal), along, float(start @ along),
                     float(np.array([x1, y1]) @ along), 0.0, 2.4)
            )  # fmt: skip
        return found

    def storey(self, z: float) -> int | None:
        below = sorted(height for height in self.floors.values() if height <= z + 0.3)
        return len(below) or None

    def between(self, p: np.ndarray, q: np.ndarray) -> Passage:
        if any(min(p[2], q[2]) < z < max(p[2], q[2]) for z in self.slabs):
            return "blocked"
        if any(_cross(p[:2], q[:2], np.array(w[:2]), np.array(w[2:])) for w in self.walls):
            return "blocked"
        if any(_cross(p[:2], q[:2], np.array(w[:2]), np.array(w[2:])) for w in self.unseen):
            return "unseen"
        return "clear"

    def way_around(self, p: np.ndarray, q: np.ndarray, limit_m: float) -> tuple[float, float]:
        if any(min(p[2], q[2]) < z < max(p[2], q[2]) for z in self.slabs):
            return np.inf, np.inf
        ways = [
            float(np.linalg.norm(p[:2] - d) + np.linalg.norm(q[:2] - d)) for d in np.array(self.doors).reshape(-1, 2)
        ]
        way = min(ways, default=np.inf)
        return (way, way) if way <= limit_m else (np.inf, np.inf)

    def seen_free(self, points: np.ndarray) -> np.ndarray:
        free = np.full(len(points), self.seen_free_everywhere)
        for low, high in self.hidden:
            free &= ~((points >= low) & (points <= high)).all(axis=1)
        return free


def _cross(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    def side(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> float:
        return float((v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0]))

    return side(p, q, a) * side(p, q, b) < 0 and side(a, b, p) * side(a, b, q) < 0


def label_of(name: str) -> str:
    """`cup_1` → `cup`."""
    return name.rstrip("0123456789_")


def tell(
    knowledge: KnowledgeBase,
    things: Mapping[str, Shape],
    around: Plan,
    shares: Mapping[str, Mapping[str, float]] | None = None,
) -> list[str]:
    """Measure things and tell the rules; everything told before is forgotten. Returns the ids."""
    known = [str(row["X"]) for row in knowledge.call("node(X, _)")]
    relations = Relations(lambda label: bool(knowledge.call(Compound("container_class", (Atom(label),)), limit=1)))
    measured = relations.update(things, {name: label_of(name) for name in things}, set(things), around)
    for name, of_rooms in (shares or {}).items():
        measured.merge(relations.set_shares(name, of_rooms))
    facts = [Compound("parameter", (Atom("voxel_size_m"), VOXEL))]
    rooms = sorted({room for of_rooms in (shares or {}).values() for room in of_rooms})
    layers = [
        *((n, "object") for n in things),
        *((level, "structure") for level in (*around.floors, *around.ceilings)),
        *((f"wall_{n}", "structure") for n in range(len(around.walls))),
        *((r, "room") for r in rooms),
    ]
    for name, layer in layers:
        label = label_of(name) if layer == "object" or name.startswith("wall") else "floor"
        label = "room" if layer == "room" else label
        facts += [Compound("node", (Atom(name), Atom(layer))), Compound("label", (Atom(name), Atom(label)))]
    knowledge.update(put=facts + measurement_facts(measured)[0], forget=known)
    return sorted(things)


def judged(
    knowledge: KnowledgeBase,
    things: Mapping[str, Shape],
    around: Plan,
    shares: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[tuple[str, str, str], float]:
    """The edges (relation, source, target) that the rules derive from what is measured, and their confidences."""
    _, edges = knowledge.derived_edges(tell(knowledge, things, around, shares))
    return {(edge.relation, edge.source, edge.target): edge.confidence for edge in edges}


def derived(
    knowledge: KnowledgeBase,
    things: Mapping[str, Shape],
    around: Plan,
    shares: Mapping[str, Mapping[str, float]] | None = None,
) -> set[tuple[str, str, str]]:
    """The edges alone."""
    return set(judged(knowledge, things, around, shares))
