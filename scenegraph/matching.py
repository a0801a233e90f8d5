"""One to one: which nodes of two graphs of the same place are the same thing, by class, place and overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scenegraph.facts import class_atom
from scenegraph.graph import Box, Layer, Node

__all__ = ["Match", "footprint_polygon", "match"]

Array: TypeAlias = NDArray[Any]

REACH_M = 0.3
"""Things of one class are candidates when their centres are at most this far apart …"""
OVERLAP_SHARE = 0.1
"""… or they overlap by so much: volume in common ÷ volume of both; a part of a table is seen from each side of it."""
OTHER_CLASS_SHARE = 0.5
"""Things of different classes are one only when they overlap by so much: a matter of labels, then."""
ROOM_SHARE = 0.5
"""Rooms are one when so much of the smaller footprint lies in the other."""
STOREY_M = 1.0
"""… and their floors, as those of storeys, are nearer than this."""
PLACE_M = 0.3
PLANE_ANGLE = math.radians(15.0)
PLANE_OFFSET_M = 0.25
PLANE_GROWN_M = 0.15
PLANE_SHARE = 0.3
"""Planes are one when they face the same way, lie in one another, and, grown by as much, share this of the smaller."""
SAME_NAME = 1e-3
"""What two nodes of the same id, or known as one before, are ahead of others that fit as well."""

LEAST_VOLUME_M3 = 1e-12
"""What is smaller has no volume to share."""


@dataclass(frozen=True, slots=True)
class Match:
    """Row of ours, row of theirs; metres between them; overlap in 0 … 1; and why they are one, in words."""

    ours: int
    theirs: int
    distance_m: float
    overlap: float
    reason: str


def match(ours: Sequence[Node], theirs: Sequence[Node], layer: Layer, known_as: dict[str, str]) -> list[Match]:
    """Pairs of nodes of one layer that are the same; each is in one pair at most, and the sum of how well they fit is
    greatest.

    theirs   : in the frame of ours
    known_as : their id → the id of ours that it was joined with before
    """
    if not ours or not theirs:
        return []
    candidates = _CANDIDATES[layer](ours, theirs)
    if not candidates:
        return []
    rows, columns = np.array([(c.ours, c.theirs) for c, _ in candidates]).T
    scores = np.array([score for _, score in candidates])
    for k, (i, j) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        if known_as.get(theirs[j].id, theirs[j].id) == ours[i].id:
            scores[k] += SAME_NAME
    chosen = _assigned(rows, columns, scores, len(ours), len(theirs))
    return [candidates[k][0] for k in chosen]


def _assigned(rows: Array, columns: Array, scores: Array, n: int, m: int) -> list[int]:
    """Which candidates to take: at most one a row and one a column, the greatest sum of scores (> 0)."""
    joined = coo_array((np.ones(len(rows)), (rows, n + columns)), shape=(n + m, n + m))
    _, part = connected_components(joined, directed=False)
    order = np.argsort(part[rows], kind="stable")
    bounds = np.flatnonzero(np.diff(part[rows][order])) + 1
    chosen: list[int] = []
    for group in np.split(order, bounds):
        if len(group) == 1:
            chosen.append(int(group[0]))
            continue
        local_rows, i = np.unique(rows[group], return_inverse=True)
        local_columns, j = np.unique(columns[group], return_inverse=True)
        gain = np.zeros((len(local_rows), len(local_columns)))
        which = np.full(gain.shape, -1, np.int64)
        gain[i, j], which[i, j] = scores[group], group
        taken = which[linear_sum_assignment(gain, maximize=True)]
        chosen += taken[taken >= 0].tolist()
    return sorted(chosen)


_Candidates = list[tuple[Match, float]]


def _things(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    """Objects: by class, distance and overlap."""
    a, b = _Boxes(ours), _Boxes(theirs)
    i, j = a.near(b, REACH_M)
    same = a.classes[i] == b.classes[j]
    distance = np.linalg.norm(a.positions[i] - b.positions[j], axis=1)
    overlap, _ = a.overlap(b, i, j)
    alike = np.where(same, (distance <= REACH_M) | (overlap >= OVERLAP_SHARE), overlap >= OTHER_CLASS_SHARE)
    score = overlap + np.exp(-((distance / REACH_M) ** 2)) + same
    found: _Candidates = []
    for k in np.flatnonzero(alike).tolist():
        one, other = int(i[k]), int(j[k])
        what = "same class" if same[k] else f"{ours[one].label} here, {theirs[other].label} there"
        reason = f"{what}, {distance[k]:.2f} m apart, {100 * overlap[k]:.0f} % of their space in common"
        found.append((Match(one, other, float(distance[k]), float(overlap[k]), reason), float(score[k])))
    return found


def _structure(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    """Planes by pose and overlap; doors, windows and openings, which are no planes, as things."""
    found: _Candidates = []
    for finder, is_plane in ((_things, False), (_planes, True)):
        rows = [
            [k for k, node in enumerate(nodes) if (_normal(node) is not None) is is_plane] for nodes in (ours, theirs)
        ]
        if rows[0] and rows[1]:
            for pair, score in finder([ours[k] for k in rows[0]], [theirs[k] for k in rows[1]]):
                found.append((replace(pair, ours=rows[0][pair.ours], theirs=rows[1][pair.theirs]), score))
    return found


def _planes(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    a, b = _Boxes(ours, PLANE_GROWN_M), _Boxes(theirs, PLANE_GROWN_M)
    i, j = a.near(b, 0.0)
    normals = [np.array([_normal(node) for node in nodes], np.float64) for nodes in (ours, theirs)]
    one, other = normals[0][i], normals[1][j]
    turn = np.arccos(np.clip(np.abs((one * other).sum(axis=1)), 0.0, 1.0))
    offset = np.abs((one * (b.positions[j] - a.positions[i])).sum(axis=1))
    alike = (a.classes[i] == b.classes[j]) & (turn <= PLANE_ANGLE) & (offset <= PLANE_OFFSET_M)
    i, j, turn, offset = i[alike], j[alike], turn[alike], offset[alike]
    both, share = a.overlap(b, i, j)
    found: _Candidates = []
    for k in np.flatnonzero(share >= PLANE_SHARE).tolist():
        angle, part = math.degrees(turn[k]), 100 * share[k]
        reason = f"{ours[i[k]].label}s {offset[k]:.2f} m and {angle:.0f}° apart, {part:.0f} % of the smaller in common"
        score = both[k] + share[k] + math.exp(-((offset[k] / PLANE_OFFSET_M) ** 2))
        found.append((Match(int(i[k]), int(j[k]), float(offset[k]), float(share[k]), reason), float(score)))
    return found


def _rooms(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    """Rooms by how much of the smaller footprint they share."""
    found: _Candidates = []
    outlines = [[_outline(node) for node in nodes] for nodes in (ours, theirs)]
    tree = shapely.STRtree(outlines[1])
    for i, outline in enumerate(outlines[0]):
        for j in sorted(tree.query(outline, predicate="intersects").tolist()):
            a, b = ours[i], theirs[j]
            rise = abs(float(a.position[2] - b.position[2]))
            smaller = min(outline.area, outlines[1][j].area)
            common = float(outline.intersection(outlines[1][j]).area)
            share = common / smaller if smaller > 0 else 1.0
            if rise > STOREY_M or share < ROOM_SHARE:
                continue
            union = outline.area + outlines[1][j].area - common
            reason = f"{100 * share:.0f} % of the smaller footprint in common"
            found.append((Match(i, j, _distance(a, b), share, reason), common / union if union > 0 else 1.0))
    return found


def _storeys(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    found: _Candidates = []
    for i, a in enumerate(ours):
        for j, b in enumerate(theirs):
            rise = abs(_floor(a) - _floor(b))
            if rise <= STOREY_M:
                found.append((Match(i, j, rise, 1.0, f"floors {rise:.2f} m apart"), 1.0 + math.exp(-(rise**2))))
    return found


def _buildings(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    if len(ours) == len(theirs) == 1:
        return [(Match(0, 0, _distance(ours[0], theirs[0]), 1.0, "the only building"), 1.0)]
    return _rooms(ours, theirs)


def _places(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    a, b = _Boxes(ours), _Boxes(theirs)
    i, j = a.near(b, PLACE_M)
    distances = np.linalg.norm(a.positions[i] - b.positions[j], axis=1)
    found: _Candidates = []
    for one, other, distance in zip(i.tolist(), j.tolist(), distances.tolist(), strict=True):
        if distance <= PLACE_M:
            score = 1.0 + math.exp(-((distance / PLACE_M) ** 2))
            found.append((Match(one, other, distance, 0.0, f"{distance:.2f} m apart"), score))
    return found


def _agents(ours: Sequence[Node], theirs: Sequence[Node]) -> _Candidates:
    """Robots by their name."""
    named: dict[str, list[int]] = {}
    for i, node in enumerate(ours):
        named.setdefault(str(node.attributes.get("name") or node.id), []).append(i)
    found: _Candidates = []
    for j, node in enumerate(theirs):
        for i in named.get(str(node.attributes.get("name") or node.id), ()):
            found.append((Match(i, j, _distance(ours[i], node), 0.0, "the same robot"), 1.0))
    return found


_CANDIDATES: dict[Layer, Any] = {
    "building": _buildings,
    "storey": _storeys,
    "room": _rooms,
    "place": _places,
    "object": _things,
    "structure": _structure,
    "agent": _agents,
}


# -- geometry of nodes -------------------------------------------------------------------------------------------------


class _Boxes:
    """Nodes as arrays: positions (N, 3), classes (N,), corners of their boxes, grown on every side, (N, 8, 3), all at
    the position where there is no box."""

    def __init__(self, nodes: Sequence[Node], grown: float = 0.0) -> None:
        self.positions = np.array([node.position for node in nodes])
        self.classes = np.array([class_atom(node.label) for node in nodes])
        self.corners = np.array([_corners(node, grown) for node in nodes])
        self._low, self._high = self.corners.min(axis=1), self.corners.max(axis=1)

    def near(self, other: _Boxes, reach: float) -> tuple[Array, Array]:
        """Rows of ours and of theirs whose positions are at most `reach` apart, or that may overlap."""
        close = cKDTree(self.positions).query_ball_tree(cKDTree(other.positions), reach)
        pairs = {(i, j) for i, near in enumerate(close) for j in near}
        tree = shapely.STRtree(shapely.box(*self._low[:, :2].T, *self._high[:, :2].T))
        pairs.update(
            zip(*reversed(tree.query(shapely.box(*other._low[:, :2].T, *other._high[:, :2].T)).tolist()), strict=True)
        )
        i, j = np.array(sorted(pairs), np.int64).reshape(-1, 2).T
        return i, j

    def overlap(self, other: _Boxes, i: Array, j: Array) -> tuple[Array, Array]:
        """Volume in common ÷ that of both together, and ÷ the smaller, of pairs of rows.

        Exact for boxes that stand upright; tilted ones count with the prism about them.
        """
        low, high = np.maximum(self._low[i], other._low[j]), np.minimum(self._high[i], other._high[j])
        meet = np.flatnonzero((high > low).all(axis=1))
        ratios = np.zeros((2, len(i)))
        if len(meet):
            i, j, height = i[meet], j[meet], (high - low)[meet, 2]
            one, others = self._grounds(i), other._grounds(j)
            common = height * shapely.area(shapely.intersection(one, others))
            volume = shapely.area(one) * (self._high - self._low)[i, 2]
            theirs = shapely.area(others) * (other._high - other._low)[j, 2]
            smaller = np.minimum(volume, theirs)
            solid = smaller > LEAST_VOLUME_M3
            ratios[0, meet[solid]] = common[solid] / (volume + theirs - common)[solid]
            ratios[1, meet[solid]] = common[solid] / smaller[solid]
        return ratios[0], ratios[1]

    def _grounds(self, rows: Array) -> Any:
        """Ground projections of some of the boxes."""
        wanted, of = np.unique(rows, return_inverse=True)
        points = self.corners[wanted, :, :2]
        grounds = shapely.convex_hull(
            shapely.multipoints(points.reshape(-1, 2), indices=np.repeat(np.arange(len(points)), 8))
        )
        return grounds[of]


def _corners(node: Node, grown: float) -> Array:
    box = node.box
    if box is None:
        return np.tile(node.position, (8, 1))
    if grown:
        box = Box(center=box.center, size=box.size + 2.0 * grown, rotation_wxyz=box.rotation_wxyz)
    return box.corners()


def _normal(node: Node) -> Array | None:
    """The normal (3,) of a node that is a plane."""
    try:
        normal = np.array(node.attributes.get("normal"), np.float64)
    except (TypeError, ValueError):
        return None
    return normal if normal.shape == (3,) and bool(np.isfinite(normal).all()) else None


def _distance(a: Node, b: Node) -> float:
    return float(np.linalg.norm(a.position - b.position))


def _floor(node: Node) -> float:
    height = node.attributes.get("floor_z")
    return float(height) if isinstance(height, int | float) else float(node.position[2])


def footprint_polygon(node: Node) -> Any:
    """The footprint of a node as a valid shapely geometry; None where it has none."""
    footprint = node.footprint
    return None if footprint is None else shapely.make_valid(shapely.Polygon(footprint))


def _outline(node: Node) -> Any:
    """A room's footprint, else the ground projection of its box, else a disc about its position."""
    footprint = footprint_polygon(node)
    if footprint is not None:
        return footprint
    if node.box is not None:
        return shapely.MultiPoint(node.box.corners()[:, :2]).convex_hull
    return shapely.Point(node.position[:2]).buffer(0.5)
