"""Relations of a world's graph against those of the home, each with its own precision and recall."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scenegraph.evaluation.result import Evaluation
from scenegraph.simulation import Home
from scenegraph.world import World

__all__ = ["JUDGED", "judge_relations", "match_planes"]

Array: TypeAlias = NDArray[Any]
SYMMETRIC = frozenset({"near", "next_to", "touching"})
JUDGED = ("on", "in", "above", "near", "next_to", "touching", "attached_to", "hanging_from", "part_of")
"""The canonical ones of all stored relations between things; part_of holds of none: no thing of a home has a part."""
FACING = 0.8
SAMPLES = 200


def judge_relations(
    world: World, home: Home, matched: dict[str, str], countable: frozenset[str], result: Evaluation
) -> None:
    """Compare edges between matched nodes (node id → true id) with what holds between the things they stand for."""
    on_planes = match_planes(world, home)
    matched, planes = {**on_planes, **matched}, set(on_planes.values())
    known = set(matched.values())
    all_counted = countable | {r.id for r in home.rooms} | {plane.id for plane in home.structure}
    for relation in JUDGED:
        true = {(a, b) for name, a, b in home.relations() if name == relation}
        said = set()
        for edge in world.graph.edges(relation):
            a, b = matched.get(edge.source), matched.get(edge.target)
            if a is not None and b is not None and (relation != "on" or b not in planes):
                said.add((min(a, b), max(a, b)) if relation in SYMMETRIC else (a, b))
        judgeable = {pair for pair in true if known.issuperset(pair)}
        result.tallies[f"relations.{relation}"].add(len(said & judgeable), len(said), len(judgeable))
        everything = {pair for pair in true if all_counted.issuperset(pair)}
        result.tallies[f"relations.{relation}.recall_all"].add(len(said & everything), 0, len(everything))
        result.notes += [f"{home.seed}: missed {relation}{pair}" for pair in sorted(judgeable - said)]
        result.notes += [f"{home.seed}: wrong {relation}{pair}" for pair in sorted(said - judgeable)]


def match_planes(world: World, home: Home) -> dict[str, str]:
    """Plane node id → the true plane that most of the plane lies on, where it faces the same way."""
    found: dict[str, str] = {}
    for node in world.graph.nodes("structure"):
        if not node.id.startswith("plane_"):
            continue
        plane = world.map.planes.plane(int(node.id.removeprefix("plane_")))
        points = world.map.planes.samples(plane.id, SAMPLES).astype(np.float64)
        truth = home.triangle_plane[home.renderer.scene.closest(points)[0]]
        numbers, counts = np.unique(truth[truth >= 0], return_counts=True)
        if len(numbers) and counts.max() >= 0.5 * len(points):
            best = home.structure[int(numbers[counts.argmax()])]
            if float(best.normal @ plane.normal) >= FACING:
                found[node.id] = best.id
    return found
