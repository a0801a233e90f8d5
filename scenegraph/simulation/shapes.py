"""Meshes of furniture, put together from boxes, tubes and surfaces of revolution.

A `Model` stands in its own frame: z up, its lowest point at z = 0, its front towards −y. Beside its triangles it keeps
*solids*, upright prisms that hold its material, by which the layout tells whether two things would run into each
other, and *surfaces* on which other things may stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Color: TypeAlias = tuple[int, int, int]

_BAND_M = 0.02  # height of the prisms that hold a surface of revolution

_BOX_CORNERS = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
_BOX_QUADS = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
_BOX_TRIANGLES = np.array([t for a, b, c, d in _BOX_QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


@dataclass(frozen=True)
class Solid:
    """An upright prism: `outline` (a shapely polygon, may have a hole) between the heights `low` and `high` [m]."""

    outline: Any
    low: float
    high: float


@dataclass(frozen=True)
class Surface:
    """A level place to stand on: the rectangle `lower` … `upper` (x, y) at height `z`, `clearance` above it [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]
    z: float
    clearance: float = 2.0


@dataclass(frozen=True)
class Model:
    """One thing in its own frame.

    vertices (N, 3) [m], triangles (M, 3) int32, colors (M, 3) uint8: a colour a triangle
    """

    label: str
    vertices: Array
    triangles: Array
    colors: Array
    solids: tuple[Solid, ...]
    surfaces: tuple[Surface, ...]

    @property
    def lower(self) -> Array:
        """(3,) least corner of the bounding box [m]."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def upper(self) -> Array:
        """(3,) greatest corner of the bounding box [m]."""
        return np.asarray(self.vertices.max(axis=0))


@dataclass
class Shape:
    """Builds a `Model` part by part."""

    label: str
    color: Color = (160, 160, 160)
    _vertices: list[Array] = field(default_factory=list)
    _triangles: list[Array] = field(default_factory=list)
    _colors: list[Array] = field(default_factory=list)
    _solids: list[Solid] = field(default_factory=list)
    _surfaces: list[Surface] = field(default_factory=list)

    def _add(self, vertices: Array, triangles: Array, color: Color | None) -> None:
        first = sum(len(v) for v in self._vertices)
        self._vertices.append(vertices)
        self._triangles.append(triangles + first)
        self._colors.append(np.tile(np.array(color or self.color, dtype=np.uint8), (len(triangles), 1)))

    def box(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        color: Color | None = None,
        tilt: float = 0.0,
    ) -> Shape:
        """A box between the given limits, tilted by `tilt` [rad] about the x direction through its lowest middle."""
        lower, upper = np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]])
        vertices = _BOX_CORNERS * (upper - lower) + (lower + upper) / 2
        if tilt:
            pivot = np.array([0.0, (y[0] + y[1]) / 2, z[0]])
            c, s = np.cos(tilt), np.sin(tilt)
            vertices = (vertices - pivot) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) + pivot
        self._add(vertices, _BOX_TRIANGLES, color)
        (x0, y0, z0), (x1, y1, z1) = vertices.min(axis=0), vertices.max(axis=0)
        self._solids.append(Solid(shapely.box(x0, y0, x1, y1), float(z0), float(z1)))
        return self

    def revolve(
        self,
        profile: Sequence[tuple[float, float]],
        center: tuple[float, float] = (0.0, 0.0),
        color: Color | None = None,
        sides: int = 16,
        stretch: tuple[float, float] = (1.0, 1.0),
    ) -> Shape:
        """The surface swept by `profile` (radius, z) about the vertical through `center`, stretched along x and y.

        The profile runs from the axis at the bottom, around the material, back to the axis; a hollow thing's goes up
        outside and down inside.
        """
        angle = 2 * np.pi * np.arange(sides) / sides
        circle = np.stack([np.cos(angle) * stretch[0], np.sin(angle) * stretch[1]], axis=1)
        rings = [np.column_stack([circle * r + center, np.full(sides, z)]) for r, z in profile]
        vertices = np.concatenate(rings)
        here, after = np.arange(sides), (np.arange(sides) + 1) % sides
        triangles = []
        for k, ((r0, _), (r1, _)) in enumerate(pairwise(profile)):
            a, b, c, d = k * sides + here, k * sides + after, (k + 1) * sides + here, (k + 1) * sides + after
            if r0 > 0:
                triangles.append(np.stack([a, b, c], axis=1))
            if r1 > 0:
                triangles.append(np.stack([b, d, c], axis=1))
        self._add(vertices, np.concatenate(triangles).astype(np.int32), color)

        section = shapely.Polygon(profile)
        widest = max(r for r, _ in profile)
        heights = sorted({round(z, 6) for _, z in profile})
        levels = [heights[0]]
        for z in heights[1:]:
            steps = max(1, int(np.ceil((z - levels[-1]) / _BAND_M)))
            levels.extend(np.linspace(levels[-1], z, steps + 1)[1:].tolist())
        for low, high in pairwise(levels):
            band = section.intersection(shapely.box(0.0, low + 1e-6, widest, high - 1e-6))
            if band.area < 1e-9:
                continue
            inner, _, outer, _ = band.bounds
            hole = [circle[::-1] * inner + center] if inner > 1e-4 else []
            self._solids.append(Solid(shapely.Polygon(circle * outer + center, hole), low, high))
        return self

    def cylinder(
        self,
        radius: float,
        z: tuple[float, float],
        center: tuple[float, float] = (0.0, 0.0),
        color: Color | None = None,
        sides: int = 12,
    ) -> Shape:
        """An upright cylinder between two heights."""
        return self.revolve([(0.0, z[0]), (radius, z[0]), (radius, z[1]), (0.0, z[1])], center, color, sides)

    def ball(
        self, radius: float, z: float = 0.0, center: tuple[float, float] = (0.0, 0.0), color: Color | None = None
    ) -> Shape:
        """A ball whose lowest point is at height `z`."""
        angle = np.linspace(-np.pi / 2, np.pi / 2, 9)
        radii, heights = radius * np.cos(angle), z + radius * (1 + np.sin(angle))
        radii[0] = radii[-1] = 0.0
        return self.revolve([(float(r), float(h)) for r, h in zip(radii, heights, strict=True)], center, color)

    def open_box(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        wall: float,
        color: Color | None = None,
        open_front: bool = False,
    ) -> Shape:
        """A box without a lid (or, with `open_front`, with a lid but without its −y side), with walls `wall` thick."""
        self.box(x, y, (z[0], z[0] + wall), color)
        inner = (z[0] + wall, z[1] - wall if open_front else z[1])
        self.box((x[0], x[0] + wall), y, inner, color)
        self.box((x[1] - wall, x[1]), y, inner, color)
        between = (x[0] + wall, x[1] - wall)
        self.box(between, (y[1] - wall, y[1]), inner, color)
        if open_front:
            self.box(x, y, (z[1] - wall, z[1]), color)
        else:
            self.box(between, (y[0], y[0] + wall), inner, color)
        return self

    def surface(
        self, x: tuple[float, float], y: tuple[float, float], z: float, clearance: float = 2.0, inset: float = 0.01
    ) -> Shape:
        """Lets other things stand on the rectangle x × y at height `z`, `inset` away from its edge."""
        lower, upper = (x[0] + inset, y[0] + inset), (x[1] - inset, y[1] - inset)
        self._surfaces.append(Surface(lower, upper, z, clearance))
        return self

    def model(self) -> Model:
        """The finished thing, moved so that its bounding box stands at z = 0 with its middle on the z axis."""
        vertices = np.concatenate(self._vertices)
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        shift = np.array([-(lower[0] + upper[0]) / 2, -(lower[1] + upper[1]) / 2, -lower[2]])
        dx, dy, dz = shift.tolist()

        def moved(outline: Any) -> Any:
            return shapely.transform(outline, lambda p: p + shift[:2])

        return Model(
            label=self.label,
            vertices=vertices + shift,
            triangles=np.concatenate(self._triangles),
            colors=np.concatenate(self._colors),
            solids=tuple(Solid(moved(s.outline), s.low + dz, s.high + dz) for s in self._solids),
            surfaces=tuple(
                Surface((s.lower[0] + dx, s.lower[1] + dy), (s.upper[0] + dx, s.upper[1] + dy), s.z + dz, s.clearance)
                for s in self._surfaces
            ),
        )
