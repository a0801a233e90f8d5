"""What follows when past poses turn out to be others: things move as the poses moved that they were seen from.

Each node moves rigidly, by the mean of the corrections at the times it was seen, weighed by how often. Its position,
box, footprint and plane follow; its id stays, and all of it is one change of the graph. Two things that moved alike
stay in the relations they were in; between others relations are inferred anew.

Only the graph follows, and the things' measured shapes with it until they are seen again. **The maps below do not
follow yet**: voxels, planes and the ground of rooms lie where they were fused. What is seen again after a correction is
measured from these, and its node goes back to where its voxels are. Until the maps follow, a correction is of lasting
use to graphs that no longer grow: stored, imported or joined ones.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mapping.geometry import SE3
from mapping.observations import PoseCorrection
from scenegraph.errors import InvalidGraphValue
from scenegraph.graph import Delta, Edge, EdgeKey, GraphChanges, Node, SceneGraph
from scenegraph.matching import footprint_polygon
from scenegraph.relating import Thresholds, follow
from scenegraph.rigid import moved, moved_edge

__all__ = [
    "Corrections",
    "Sighting",
    "Sightings",
    "alike",
    "carried",
    "carry",
    "motions",
    "realign",
    "shares_in",
]

MOST_SIGHTINGS = 8
"""So many times at which it was seen are kept of each node; the closest ones become one that weighs as much as both."""
SAMPLES = 9
"""Of a node of which no sightings are kept, so many times between its first and last sight count."""
LEAST_M = 1e-4
LEAST_TURN = 1e-5
"""A node that would move by less stays: corrections are numbers, too."""
ALIKE_M = 0.01
ALIKE_TURN = np.radians(0.5)
"""Two things moved alike when they keep their places to each other to within this."""
_FAR_TURN = 2.0**1.5 * np.sin(0.5 * ALIKE_TURN)  # Frobenius distance of rotations that differ by as much


class Corrections:
    """How the map has moved, as a function of the time at which it was seen by one robot.

    before : the poses as they were believed, one each of `correction.poses`; only those are used that do not say it
    """

    def __init__(self, correction: PoseCorrection, before: Sequence[SE3 | None] = ()) -> None:
        self.robot = correction.robot
        self._until_ns = correction.stamp_ns
        self._stamps: list[int] = []
        self._moves: list[SE3] = []
        for k, pose in enumerate(correction.poses):
            T_map_base_before = pose.T_map_base_before or (before[k] if k < len(before) else None)
            if T_map_base_before is None:
                raise InvalidGraphValue(
                    f"PoseCorrection.poses[{k}].T_map_base_before: needed, nothing else says where {self.robot} was "
                    f"believed to be at {pose.stamp_ns} ns"
                )
            self._stamps.append(pose.stamp_ns)
            self._moves.append(pose.T_map_base @ T_map_base_before.inverse())

    def at(self, stamp_ns: int) -> SE3:
        """The motion of what was seen then: `p_map_now = at(stamp_ns) @ p_map_before`."""
        if stamp_ns < self._stamps[0] or stamp_ns > self._until_ns:
            return SE3.identity()
        k = bisect_right(self._stamps, stamp_ns) - 1
        if k + 1 == len(self._stamps):
            return self._moves[-1]
        share = (stamp_ns - self._stamps[k]) / (self._stamps[k + 1] - self._stamps[k])
        return self._moves[k].interpolate(self._moves[k + 1], share)


class Sighting(NamedTuple):
    """That a robot saw something at a time, and how many sights that stands for."""

    robot: str
    stamp_ns: int
    weight: float


class Sightings:
    """From when, and by whom, each node was seen: at most `MOST_SIGHTINGS` each, some 100 bytes a sighting."""

    def __init__(self) -> None:
        self._of: dict[str, list[Sighting]] = {}

    def note(self, delta: Delta, robot: str, stamp_ns: int) -> None:
        """What of a change of the graph this robot has just seen; what is deleted is forgotten, or seen as its heir."""
        for node in delta.nodes.put:
            if node.last_seen_ns == stamp_ns and node.layer != "agent":
                self._add(node.id, (Sighting(robot, stamp_ns, 1.0),))
        for stone in delta.tombstones:
            seen = self._of.pop(stone.id, [])
            if stone.became is not None:
                self._add(stone.became, seen)

    def of(self, node_id: str) -> Sequence[Sighting]:
        """By robot, in order of time; empty when nothing is known."""
        return self._of.get(node_id, ())

    def _add(self, node_id: str, more: Iterable[Sighting]) -> None:
        seen = sorted([*self._of.get(node_id, ()), *more])
        while len(seen) > MOST_SIGHTINGS:
            _merge_closest(seen)
        if seen:
            self._of[node_id] = seen

    def document(self) -> dict[str, list[list[Any]]]:
        """All of it as JSON values."""
        return {node_id: [list(sighting) for sighting in seen] for node_id, seen in self._of.items()}

    def restore(self, document: Mapping[str, Iterable[Sequence[Any]]]) -> None:
        """Take over what `document` gave."""
        self._of = {i: [Sighting(str(r), int(s), float(w)) for r, s, w in seen] for i, seen in document.items()}


def _merge_closest(seen: list[Sighting]) -> None:
    """Make one of the two sightings of a robot that are closest in time; the lightest goes when each robot has one."""
    gaps = [(b.stamp_ns - a.stamp_ns, k) for k, (a, b) in enumerate(pairwise(seen)) if a.robot == b.robot]
    if not gaps:
        del seen[min(range(len(seen)), key=lambda k: seen[k].weight)]
        return
    _, k = min(gaps)
    a, b = seen[k], seen[k + 1]
    weight = a.weight + b.weight
    seen[k : k + 2] = [Sighting(a.robot, a.stamp_ns + round((b.stamp_ns - a.stamp_ns) * b.weight / weight), weight)]


# -- motions -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Finder:
    graph: SceneGraph
    corrections: Corrections
    sightings: Sightings | None

    def motion(self, node: Node) -> SE3 | None:
        """How a node moves; None when nothing says so, and it is what it holds that moves."""
        if node.layer == "agent":
            return self.corrections.at(node.last_seen_ns) if self.is_robot(node) else SE3.identity()
        if node.layer == "building":
            return SE3.identity()
        seen = () if self.sightings is None else self.sightings.of(node.id)
        if seen:
            moves = [
                self.corrections.at(s.stamp_ns) if s.robot == self.corrections.robot else SE3.identity() for s in seen
            ]
            return _mean(moves, [s.weight for s in seen], node.position)
        if node.layer in ("storey", "room"):
            return None
        stamps = np.linspace(node.first_seen_ns, node.last_seen_ns, SAMPLES).astype(np.int64).tolist()
        return _mean([self.corrections.at(stamp_ns) for stamp_ns in stamps], [1.0] * SAMPLES, node.position)

    def is_robot(self, node: Node) -> bool:
        """Whether the node is the robot whose poses are corrected."""
        robot = self.corrections.robot
        return node.layer == "agent" and (node.attributes.get("name") == robot or node.id == f"agent_{robot}")

    def motion_of_parts(self, node: Node, known: Mapping[str, SE3]) -> SE3:
        """The mean motion of what is in a room or storey."""
        parts = [edge.source for edge in self.graph.edges("in", target=node.id) if edge.source in known]
        parts = [part for part in parts if self.graph.node(part).layer != "agent"]
        return _mean([known[part] for part in parts], [1.0] * len(parts), node.position)


def motions(graph: SceneGraph, corrections: Corrections, sightings: Sightings | None = None) -> dict[str, SE3]:
    """How each node of the graph moves, but for those that do not. The robot itself is always there: its way changes.

    sightings : when each was seen, by whom; None, or nothing of a node: evenly between its first and last sight. Rooms
        and storeys of which nothing is kept move as what is in them; a building, the frame of it all, never moves.
    """
    finder = _Finder(graph, corrections, sightings)
    found: dict[str, SE3] = {}
    waiting: list[Node] = []
    for node in graph:
        motion = finder.motion(node)
        if motion is None:
            waiting.append(node)
        else:
            found[node.id] = motion
    for layer in ("room", "storey"):
        for node in waiting:
            if node.layer == layer:
                found[node.id] = finder.motion_of_parts(node, found)
    return {i: T for i, T in found.items() if _moves(T, graph.node(i)) or finder.is_robot(graph.node(i))}


def carried(graph: SceneGraph, moves: Mapping[str, SE3], corrections: Corrections) -> list[Node]:
    """The nodes as they are after their motions; of the robot's way each point by the correction at its time."""
    nodes = []
    for node_id, T in moves.items():
        node = moved(graph.node(node_id), T)
        way, times = (graph.node(node_id).attributes.get(name) for name in ("trajectory", "trajectory_ns"))
        if node.layer == "agent" and isinstance(way, list) and isinstance(times, list) and len(way) == len(times):
            points = [corrections.at(int(t)) @ np.asarray(p, np.float64) for p, t in zip(way, times, strict=True)]
            node = node.replace(attributes={**node.attributes, "trajectory": np.round(points, 3)})
        nodes.append(node)
    return nodes


def carry(graph: SceneGraph, moves: Mapping[str, SE3], corrections: Corrections) -> GraphChanges:
    """What the motions alone change: nodes, and the edges that have a place of their own."""
    changes = GraphChanges()
    for node in carried(graph, moves, corrections):
        changes.put(node)
    for edge in _carried_edges(graph, moves):
        changes.put(edge)
    return changes


def _carried_edges(graph: SceneGraph, moves: Mapping[str, SE3]) -> list[Edge]:
    """The edges with a place of their own, as they are after the motions of what they begin at."""
    edges = graph.edges_at([node_id for node_id in moves if node_id in graph], ("connects",))
    found = []
    for edge in edges:
        if edge.source in moves:
            now = moved_edge(edge, moves[edge.source], float(graph.node(edge.source).position[2]))
            if now is not edge:
                found.append(now)
    return found


def realign(
    graph: SceneGraph,
    corrections: Corrections,
    thresholds: Thresholds,
    sightings: Sightings | None = None,
) -> GraphChanges:
    """The change that a correction makes to a graph of boxes, to be committed at once.

    Relations between things that did not move alike are inferred anew from their boxes, see `scenegraph.relating`.
    """
    moves = motions(graph, corrections, sightings)
    changes = carry(graph, moves, corrections)
    anew = GraphChanges()
    anew.extend(changes)
    follow(graph, anew, thresholds)
    for step in anew.steps[len(changes) :]:
        if isinstance(step, Edge) and not alike(graph, moves, step.source, step.target):
            changes.put(step)
        elif isinstance(step, EdgeKey) and not alike(graph, moves, step.source, step.target):
            changes.delete_edge(*step)
    return changes


def alike(graph: SceneGraph, moves: Mapping[str, SE3], one: str, other: str) -> bool:
    """Whether two nodes keep their places to each other."""
    a, b = moves.get(one), moves.get(other)
    if a is None and b is None:
        return True
    a, b = a or SE3.identity(), b or SE3.identity()
    if np.linalg.norm(a.rotation - b.rotation) > _FAR_TURN:
        return False
    middle = 0.5 * (graph.node(one).position + graph.node(other).position)
    return bool(np.linalg.norm(a @ middle - b @ middle) <= ALIKE_M)


def shares_in(ground: NDArray[Any], rooms: Iterable[Node]) -> dict[str, float]:
    """Which shares of points (N, 2) lie in the footprints of rooms."""
    points = shapely.points(ground)
    shares: dict[str, float] = {}
    for room in rooms:
        footprint = footprint_polygon(room)
        if footprint is not None:
            share = float(shapely.contains(footprint, points).mean())
            if share > 0.0:
                shares[room.id] = share
    return shares


def _mean(moves: Sequence[SE3], weights: Sequence[float], position: Any) -> SE3:
    """The rigid motion that takes a place to the mean of where the others take it, turned by the mean of their turns
    (chordal mean: Hartley et al., Rotation Averaging, 2013)."""
    total = sum(weights)
    if not moves or total <= 0.0 or all(T.isclose(SE3.identity(), atol=0.0) for T in moves):
        return SE3.identity()
    if all(moves[0] == T for T in moves):
        return moves[0]
    u, _, vt = np.linalg.svd(sum(w * T.rotation for w, T in zip(weights, moves, strict=True)))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    target = sum(w * (T @ np.asarray(position)) for w, T in zip(weights, moves, strict=True)) / total
    return SE3(rotation, target - rotation @ np.asarray(position))


def _turn(T: SE3) -> float:
    return float(np.linalg.norm(T.log()[3:]))


def _moves(T: SE3, node: Node) -> bool:
    return bool(np.linalg.norm(T @ node.position - node.position) > LEAST_M or _turn(T) > LEAST_TURN)
