"""Things, rooms and planes of a world's graph, against those of the home."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from scenegraph.evaluation.identity import true_things
from scenegraph.evaluation.result import Evaluation
from scenegraph.graph import Box, Node
from scenegraph.simulation import Home, TrueObject, TruthRecorder
from scenegraph.world import World

__all__ = ["CENTRE_M", "judge_objects", "judge_planes", "judge_rooms"]

Array: TypeAlias = NDArray[Any]
CENTRE_M = 0.25
ROOM_OVERLAP = 0.5
PLANE_COVER = 1.0 / 3.0


# -- objects ---------------------------------------------------------------------------------------------------


def judge_objects(
    world: World,
    home: Home,
    countable: frozenset[str],
    result: Evaluation,
    name: str = "objects",
    *,
    confused: frozenset[str] = frozenset(),
) -> dict[str, str]:
    """Match object nodes to things of their class, counted ones first; returns node id → true id.

    name      of the figures
    confused  things that the segmenter always mistakes for one other class

    `any_class` are the figures of a match by place and overlap alone; `unconfused` leave out the confused things, and
    the nodes that lie on them.
    """
    nodes = world.graph.nodes("object")
    counted = [o for o in home.objects if o.id in countable]
    others = [o for o in home.objects if o.id not in countable]
    matched = _assign(nodes, counted)
    aside = _assign([n for n in nodes if n.id not in matched], others)
    result.tallies[name].add(len(matched), len(nodes) - len(aside), len(counted))
    placed = _assign(nodes, counted, any_class=True)
    beside = _assign([n for n in nodes if n.id not in placed], others, any_class=True)
    result.tallies[f"{name}.any_class"].add(len(placed), len(nodes) - len(beside), len(counted))

    lies_on = true_things(world, home, nodes)
    node_of = {true: node for pairs in (beside, placed, aside, matched) for node, true in pairs.items()}
    wrong = [n for n in nodes if n.id not in matched and n.id not in aside]
    misled = sum(lies_on.get(n.id) in confused for n in wrong)
    clear = [o for o in counted if o.id not in confused]
    right = sum(true not in confused for true in matched.values())
    result.tallies[f"{name}.unconfused"].add(right, right + len(wrong) - misled, len(clear))
    again = {n.id: node_of[true] for n in wrong if (true := lies_on.get(n.id, "")) in node_of and node_of[true] != n.id}
    result.count(f"{name}.duplicates", len(again), len(nodes))
    found = set(matched.values())
    for thing in counted:
        if thing.id not in found:
            mine = [n for n in nodes if lies_on.get(n.id) == thing.id]
            why = ", ".join(_compared(n, thing) for n in mine) or "it has no node"
            excuse = ", always mistaken" if thing.id in confused else ""
            result.notes.append(f"{home.seed}: missed {thing.id}{excuse}: {why}")
    for n in wrong:
        twin = f", as does {again[n.id]}" if n.id in again else ""
        result.notes.append(f"{home.seed}: {n.id} is no {n.label}: it lies on {lies_on.get(n.id, 'nothing')}{twin}")
    return matched


def _compared(node: Node, thing: TrueObject) -> str:
    """In what a node differs from the thing on which it lies."""
    off = float(np.linalg.norm(node.position - thing.center))
    return f"{node.id} is {f'a {node.label}, ' if node.label != thing.label else ''}{off:.2f} m off"


def _assign(nodes: list[Node], things: list[TrueObject], *, any_class: bool = False) -> dict[str, str]:
    """One-to-one pairs of a node and a thing of one class within CENTRE_M: as many as can be, then the nearest.

    any_class : pairs of any classes, then those whose boxes overlap most
    """
    if not nodes or not things:
        return {}
    a = np.array([n.position for n in nodes])
    b = np.array([t.center for t in things])
    cost = np.linalg.norm(a[:, None] - b[None], axis=2)
    allowed = cost <= CENTRE_M
    if any_class:
        boxes = [Box.from_yaw(t.center, t.size, t.yaw) for t in things]
        for r, c in np.argwhere(allowed).tolist():
            cost[r, c] += 1.0 - _overlap(nodes[r].box, boxes[c])
    else:
        allowed &= np.array([[n.label == t.label for t in things] for n in nodes])
    rows, columns = linear_sum_assignment(np.where(allowed, cost, 1e3))
    return {nodes[r].id: things[c].id for r, c in zip(rows, columns, strict=True) if allowed[r, c]}


def _overlap(a: Box | None, b: Box) -> float:
    """Intersection over union of two upright boxes."""
    if a is None:
        return 0.0
    grounds = [shapely.Polygon(box.corners()[[0, 2, 6, 4], :2]) for box in (a, b)]
    lows, highs = ([box.center[2] + sign * 0.5 * box.size[2] for box in (a, b)] for sign in (-1.0, 1.0))
    both = grounds[0].intersection(grounds[1]).area * max(0.0, min(highs) - max(lows))
    each = sum(ground.area * (high - low) for ground, low, high in zip(grounds, lows, highs, strict=True))
    return float(both / max(each - both, 1e-9))


# -- rooms -----------------------------------------------------------------------------------------------------


def judge_rooms(world: World, home: Home, result: Evaluation) -> dict[str, str]:
    """Match room nodes to rooms; returns node id → true id."""
    nodes = world.graph.nodes("room")
    outlines = [shapely.Polygon(n.attributes["footprint"]) for n in nodes]
    truths = [shapely.Polygon(r.footprint) for r in home.rooms]
    overlap = np.array([[o.intersection(t).area / o.union(t).area for t in truths] for o in outlines]).reshape(
        len(nodes), len(truths)
    )
    rows, columns = linear_sum_assignment(-overlap)
    matched = {
        nodes[r].id: home.rooms[c].id for r, c in zip(rows, columns, strict=True) if overlap[r, c] >= ROOM_OVERLAP
    }
    result.tallies["rooms"].add(len(matched), len(nodes), len(home.rooms))
    kinds = {r.id: r.kind for r in home.rooms}
    typed = sum(world.graph.node(n).attributes.get("type") == kinds[t] for n, t in matched.items())
    result.tallies["rooms.type_accuracy"].add(typed, len(matched), len(matched))
    result.notes += [f"{home.seed}: missed room {r.id}" for r in home.rooms if r.id not in matched.values()]
    result.notes += [f"{home.seed}: {n.id} is no room" for n in nodes if n.id not in matched]
    return matched


# -- planes ----------------------------------------------------------------------------------------------------


def judge_planes(world: World, home: Home, recorder: TruthRecorder, result: Evaluation) -> None:
    """Each sample of an extracted plane stands for its share of the plane's area and lies on the nearest true
    surface."""
    covered: defaultdict[int, Counter[str]] = defaultdict(Counter)
    planes = world.map.planes
    names = {info.name: class_id for class_id, info in home.label_space.classes.items()}
    building = [names[name] for name in ("wall", "floor", "ceiling", "door", "window")]
    right = said = 0
    for node in world.graph.nodes("structure"):
        if not node.id.startswith("plane_"):
            continue
        plane = planes.plane(int(node.id.removeprefix("plane_")))
        points = planes.samples(plane.id, 400).astype(np.float64)
        triangles = home.renderer.scene.closest(points)[0]
        truth, classes = home.triangle_plane[triangles], home.triangle_class[triangles]
        facing = np.array([t >= 0 and home.structure[t].normal @ plane.normal > 0.8 for t in truth])
        share = plane.area_m2 / len(points)
        for k, n in zip(*np.unique(truth[facing], return_counts=True), strict=True):
            covered[int(k)][node.label] += n * share
        if facing.mean() < 0.5 and np.isin(classes, building).mean() < 0.5:
            said += 1
            right += node.label == "no_feature"
            if node.label != "no_feature":
                result.notes.append(f"{home.seed}: {node.id} is no {node.label}")
    seen = recorder.plane_seen
    for k, true in enumerate(home.structure):
        if true.id not in recorder.countable_planes:
            continue
        said += 1
        label, area = covered[k].most_common(1)[0] if covered[k] else ("missed", 0.0)
        enough = sum(covered[k].values()) >= PLANE_COVER * true.area * seen[true.id]
        good = enough and label == true.kind
        right += good
        if not good:
            result.notes.append(f"{home.seed}: plane {true.id} is {label if enough else 'missed'}, {area:.1f} m²")
    result.tallies["planes.accuracy"].add(right, said, said)
