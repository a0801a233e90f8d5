"""Shortest ways around walls and closed doors.

Structure stands upright from floor to ceiling, so a shortest way bends only at the vertical edges of door holes: it is
found among the straight lines between points and these edges, in the plan, with the difference in height unrolled
along it (exact for prisms; de Berg et al., *Computational Geometry*, ch. 15).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scenegraph.simulation.floorplan import DOOR_HEIGHT_M, WALL_M
from scenegraph.simulation.rays import RayScene
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home

_INSET_M = 1e-3  # the edges stand this far off the wall, so that lines of sight may pass along it
_EYE_M = 0.5  # at this height no window sill is passed, and every open door is open
_SAMPLES = 160


class WayAround:
    """Measures ways between sets of points of one home."""

    def __init__(self, home: Home) -> None:
        ajar = [home.entities.index(d.id) + 1 for d in home.doors if d.kind == "ajar"]
        n_things = len(home.objects)
        entity = home.triangle_entity
        solid = ((entity == 0) | (entity > n_things)) & ~np.isin(entity, ajar)
        self._structure = RayScene(home.vertices, home.triangles[solid])
        self._edges = _door_edges(home)
        between = self._sight(
            np.repeat(self._edges, len(self._edges), axis=0), np.tile(self._edges, (len(self._edges), 1))
        )
        ways = between.reshape(len(self._edges), len(self._edges))
        for k in range(len(ways)):  # Floyd–Warshall
            ways = np.minimum(ways, ways[:, k : k + 1] + ways[k : k + 1])
        self._ways = ways

    def _blocked(self, start: Array, end: Array) -> Array:
        """(n,) bool: whether structure crosses the segments from (n, 3) to (n, 3)."""
        return np.asarray(self._structure.cast(start, end - start)[0] < 1.0 - 1e-4)

    def _sight(self, start: Array, end: Array) -> Array:
        """(n,) length in the plan of the lines from (n, 2) to (n, 2); inf where a wall or closed door is in between."""
        eye = np.full((len(start), 1), _EYE_M)
        length = np.linalg.norm(end - start, axis=1)
        blocked = self._blocked(np.hstack([start, eye]), np.hstack([end, eye]))
        return np.where(blocked & (length > 1e-6), np.inf, length)

    def length(self, a: Array, b: Array, reach: float) -> float:
        """Length of the shortest way from points (n, 3) to (m, 3) [m]; inf when it is surely longer than `reach`."""
        a, b = _thin(a), _thin(b)
        gap = np.linalg.norm(a[:, None] - b[None], axis=2)
        i, j = np.nonzero(gap <= reach)
        if len(i) == 0:
            return np.inf
        clear = ~self._blocked(a[i], b[j])
        best = float(gap[i[clear], j[clear]].min()) if clear.any() else np.inf
        to_a, to_b = self._to_edges(a, reach), self._to_edges(b, reach)
        low_a, low_b = np.minimum(a[:, 2], DOOR_HEIGHT_M), np.minimum(b[:, 2], DOOR_HEIGHT_M)
        dive = (a[:, 2] - low_a)[:, None] + (b[:, 2] - low_b)[None]
        for p in np.flatnonzero(np.isfinite(to_a).any(axis=0)):
            for q in np.flatnonzero(np.isfinite(to_b).any(axis=0) & (self._ways[p] < reach)):
                flat = to_a[:, p : p + 1] + self._ways[p, q] + to_b[:, q][None]
                best = min(best, float((np.hypot(flat, low_a[:, None] - low_b[None]) + dive).min()))
        return best

    def _to_edges(self, points: Array, reach: float) -> Array:
        """(n, edges) length in the plan from points to the edges of doors within reach; inf where not in sight."""
        near = np.linalg.norm(points[:, None, :2] - self._edges[None], axis=2)
        result = np.full(near.shape, np.inf)
        i, j = np.nonzero(near <= reach)
        if len(i):
            result[i, j] = self._sight(points[i, :2], self._edges[j])
        return result


def _thin(points: Array) -> Array:
    """At most about 160 of the points, among them the outermost along sixteen directions."""
    if len(points) <= _SAMPLES:
        return points
    angle = np.pi * np.arange(8) / 8
    along = points[:, :2] @ np.stack([np.cos(angle), np.sin(angle)])
    outermost = np.concatenate([along.argmin(axis=0), along.argmax(axis=0)])
    rest = np.linspace(0, len(points) - 1, _SAMPLES).astype(int)
    return np.asarray(points[np.unique(np.concatenate([outermost, rest]))])


def _door_edges(home: Home) -> Array:
    """(n, 2) in map: the four vertical edges of each hole that can be walked through, a little inside it."""
    edges = []
    for door in home.doors:
        if door.kind == "closed":
            continue
        normal = door.normal[:2]
        along = np.array([-normal[1], normal[0]]) * (door.width / 2 - _INSET_M)
        across = normal * (WALL_M / 2 + _INSET_M)
        edges.extend([door.center[:2] + u * along + v * across for u in (-1, 1) for v in (-1, 1)])
    return np.array(edges)
