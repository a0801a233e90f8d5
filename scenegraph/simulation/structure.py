"""The surfaces of a home's structure: walls, floors, ceilings, doors and windows, and their true planes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from scenegraph.simulation.floorplan import WALL_M, FloorPlan, Hole, RoomPlan, Side
from scenegraph.simulation.shapes import Array, Color

PlaneKind: TypeAlias = Literal["wall", "floor", "ceiling", "door"]

LEAF_M = 0.04
PANE_RECESS_M = 0.02
_FRAME_M = 0.06  # breadth of the frame about a door, which stands out of the wall by _PROUD_M
_PROUD_M = 0.01
_SIDES: tuple[Side, ...] = ("south", "north", "west", "east")
_INWARD = {"south": (0.0, 1.0), "north": (0.0, -1.0), "west": (1.0, 0.0), "east": (-1.0, 0.0)}


@dataclass(frozen=True)
class TruePlane:
    """A true planar surface of the structure.

    kind      wall, floor, ceiling or door (the two faces of a leaf that stands open)
    source    id of the room it bounds, or of the door
    polygon   (K, 3) outer boundary [m]; `holes` are (k, 3) boundaries inside it
    normal    (3,) unit vector, into free space
    area      of the polygon less its holes [m²]
    """

    id: str
    kind: PlaneKind
    source: str
    polygon: Array
    holes: tuple[Array, ...]
    normal: Array
    area: float
    origin: Array
    axes: Array
    extent: tuple[float, float]

    @property
    def offset(self) -> float:
        """d of the plane's equation normal · p = d [m]."""
        return float(self.normal @ self.polygon[0])


@dataclass
class Patches:
    """Grows the triangle soup of the structure: for each triangle its class name, instance, plane and colour."""

    def __post_init__(self) -> None:
        self.vertices: list[Array] = []
        self.triangles: list[Array] = []
        self.labels: list[str] = []
        self.instances: list[str] = []
        self.plane_of: list[int] = []
        self.colors: list[Color] = []
        self.planes: list[TruePlane] = []
        self._n = 0

    def quad(self, corners: Array, label: str, color: Color, instance: str = "", plane: int = -1) -> None:
        """Two triangles over four corners (4, 3) in order."""
        self.vertices.append(corners)
        self.triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + self._n)
        self._n += 4
        for _ in range(2):
            self.labels.append(label)
            self.instances.append(instance)
            self.plane_of.append(plane)
            self.colors.append(color)

    def rectangle(
        self,
        origin: Array,
        u: Array,
        v: Array,
        extent: tuple[float, float],
        label: str,
        color: Color,
        *,
        normal: Array | None = None,
        holes: list[tuple[float, float, float, float]] | None = None,
        instance: str = "",
        kind: PlaneKind | None = None,
        source: str = "",
    ) -> None:
        """A rectangle with rectangular holes (u0, v0, u1, v1); a true plane when it has a `kind`."""
        holes = holes or []
        plane = -1
        if kind is not None and normal is not None:
            plane = len(self.planes)

            def ring(u0: float, v0: float, u1: float, v1: float) -> Array:
                return np.array([origin + u * a + v * b for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))])

            area = extent[0] * extent[1] - sum((c - a) * (d - b) for a, b, c, d in holes)
            self.planes.append(
                TruePlane(
                    f"plane_{plane + 1}", kind, source, ring(0.0, 0.0, *extent), tuple(ring(*h) for h in holes), normal,
                    area, origin, np.stack([u, v]), extent,
                )
            )  # fmt: skip
        us = sorted({0.0, extent[0], *(h[0] for h in holes), *(h[2] for h in holes)})
        vs = sorted({0.0, extent[1], *(h[1] for h in holes), *(h[3] for h in holes)})
        for a, c in pairwise(us):
            for b, d in pairwise(vs):
                mu, mv = (a + c) / 2, (b + d) / 2
                if not any(h[0] < mu < h[2] and h[1] < mv < h[3] for h in holes):
                    corners = np.array([origin + u * p + v * q for p, q in ((a, b), (c, b), (c, d), (a, d))])
                    self.quad(corners, label, color, instance, plane)

    def box(self, corner: Array, edges: Array, label: str, color: Color, instance: str) -> None:
        """The six faces of the parallelepiped that `edges` (3, 3) span from `corner`."""
        a, b, c = edges
        for u, v, w in ((a, b, c), (a, c, b), (b, c, a)):
            for start in (corner, corner + w):
                self.quad(np.array([start, start + u, start + u + v, start + v]), label, color, instance)


def build_structure(plan: FloorPlan, tints: dict[str, tuple[Color, Color]]) -> Patches:
    """All surfaces of `plan` in its own frame; `tints` gives each room's wall and floor colour."""
    out = Patches()
    up = np.array([0.0, 0.0, 1.0])
    x, y = np.eye(3)[:2]
    for room in plan.rooms:
        wall, floor = tints[room.id]
        size = (room.x1 - room.x0, room.y1 - room.y0)
        corner = np.array([room.x0, room.y0, 0.0])
        out.rectangle(corner, x, y, size, "floor", floor, normal=up, kind="floor", source=room.id)
        white, high = (245, 245, 242), corner + up * room.height
        out.rectangle(high, x, y, size, "ceiling", white, normal=-up, kind="ceiling", source=room.id)
        for side in _SIDES:
            _wall(out, plan, room, side, wall)
    for hole in plan.holes:
        _fill(out, plan, hole, tints[hole.rooms[0][0]])
    return out


def _frame_of(room: RoomPlan, side: Side) -> tuple[Array, Array, Array]:
    """A point of the wall's coordinate 0 on the floor, the direction along it, and its normal into the room."""
    fixed, _, _ = room.wall(side)
    normal = np.array([*_INWARD[side], 0.0])
    along = np.array([1.0, 0.0, 0.0]) if side in ("south", "north") else np.array([0.0, 1.0, 0.0])
    origin = np.array([0.0, fixed, 0.0]) if side in ("south", "north") else np.array([fixed, 0.0, 0.0])
    return origin, along, normal


def _wall(out: Patches, plan: FloorPlan, room: RoomPlan, side: Side, color: Color) -> None:
    origin, along, normal = _frame_of(room, side)
    _, start, end = room.wall(side)
    holes = [(h.start - start, h.low, h.end - start, h.high) for h in plan.holes if (room.id, side) in h.rooms]
    out.rectangle(
        origin + along * start, along, np.array([0.0, 0.0, 1.0]), (end - start, room.height), "wall", color,
        normal=normal, holes=holes, kind="wall", source=room.id,
    )  # fmt: skip


def _fill(out: Patches, plan: FloorPlan, hole: Hole, tint: tuple[Color, Color]) -> None:
    """What is inside a hole: its reveals, and a pane, a leaf or a threshold."""
    room_id, side = hole.rooms[0]
    origin, along, normal = _frame_of(plan.room(room_id), side)
    up = np.array([0.0, 0.0, 1.0])
    deep = -normal * (PANE_RECESS_M if hole.kind == "window" else WALL_M)
    lower = origin + along * hole.start + up * hole.low
    across, rise = along * (hole.end - hole.start), up * (hole.high - hole.low)
    wall, floor = tint
    sill = ("wall", wall) if hole.kind == "window" else ("floor", floor)
    if hole.door != "closed":
        out.quad(np.array([lower, lower + deep, lower + deep + rise, lower + rise]), "wall", wall)
        right = lower + across
        out.quad(np.array([right, right + deep, right + deep + rise, right + rise]), "wall", wall)
        out.quad(np.array([lower, lower + across, lower + across + deep, lower + deep]), *sill)
        top = lower + rise
        out.quad(np.array([top, top + across, top + across + deep, top + deep]), "wall", wall)

    white, wood = (230, 230, 225), (150, 105, 70)
    if hole.kind == "window":
        pane = lower + deep
        out.quad(np.array([pane, pane + across, pane + across + rise, pane + rise]), "window", (170, 205, 235), hole.id)
        for at, du, dv in _frame_bars(hole.end - hole.start, hole.high - hole.low, 0.05, sill=True):
            out.box(
                pane + along * at[0] + up * at[1],
                np.stack([along * du, up * dv, normal * 0.03]),
                "window",
                white,
                hole.id,
            )
    elif hole.door == "closed":
        for base, outward in ((lower, normal), (lower - normal * WALL_M, -normal)):
            if outward is not normal and len(hole.rooms) == 1:
                break
            out.quad(np.array([base, base + across, base + across + rise, base + rise]), "door", wood, hole.id)
            for at, du, dv in _frame_bars(hole.end - hole.start, hole.high - hole.low, _FRAME_M, sill=False):
                edges = np.stack([along * du, up * dv, outward * _PROUD_M])
                out.box(base + along * at[0] + up * at[1], edges, "door", white, hole.id)
            handle = base + along * (hole.end - hole.start - 0.12) + up * 1.0
            out.box(handle, np.stack([along * -0.12, up * 0.025, outward * 0.05]), "door", (120, 120, 125), hole.id)
    elif hole.door == "ajar":
        _leaf(out, hole, origin, along, normal)


def _frame_bars(w: float, h: float, broad: float, *, sill: bool) -> list[tuple[tuple[float, float], float, float]]:
    bars = [((0.0, 0.0), broad, h), ((w - broad, 0.0), broad, h), ((broad, h - broad), w - 2 * broad, broad)]
    return [*bars, ((broad, 0.0), w - 2 * broad, broad)] if sill else bars


def leaf_axes(hole: Hole, origin: Array, along: Array, normal: Array) -> tuple[Array, Array, Array]:
    """Of a leaf that stands ajar: the corner at its hinge, its direction and that of its thickness, each (3,)."""
    sign = 1.0 if hole.hinge_at_start else -1.0
    hinge = origin + along * (hole.start if hole.hinge_at_start else hole.end)
    direction = along * sign * np.cos(hole.angle) + normal * np.sin(hole.angle)
    thickness = along * sign * np.sin(hole.angle) - normal * np.cos(hole.angle)
    return hinge + normal * 0.005, direction, thickness


def _leaf(out: Patches, hole: Hole, origin: Array, along: Array, normal: Array) -> None:
    corner, direction, thickness = leaf_axes(hole, origin, along, normal)
    up, wood = np.array([0.0, 0.0, 1.0]), (150, 105, 70)
    length, height, bottom = hole.end - hole.start - 0.02, hole.high - 0.02, np.array([0.0, 0.0, 0.01])
    for start, outward in ((corner, -thickness), (corner + thickness * LEAF_M, thickness)):
        out.rectangle(
            start + bottom, direction, up, (length, height - 0.01), "door", wood, normal=outward, instance=hole.id,
            kind="door", source=hole.id,
        )  # fmt: skip
        handle = start + direction * (length - 0.18) + up * 1.0
        out.box(handle, np.stack([direction * 0.12, up * 0.025, outward * 0.05]), "door", (120, 120, 125), hole.id)
    for start, u in ((corner, up * height), (corner + direction * length, up * height)):
        out.quad(
            np.array([start, start + thickness * LEAF_M, start + thickness * LEAF_M + u, start + u]),
            "door",
            wood,
            hole.id,
        )
    top = corner + up * height
    along_leaf, thick = direction * length, thickness * LEAF_M
    out.quad(np.array([top, top + along_leaf, top + along_leaf + thick, top + thick]), "door", wood, hole.id)
