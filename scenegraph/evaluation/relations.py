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
LEAST_PART = 0.1


def judge_relations(
    world: World, home: Home, matched: dict[str, str], countable: frozenset[str], result: Evaluation
) -> None:
    """Compare edges between matched nodes (node id → true id) with what holds between the things they stand for."""
    planes = match_planes(world, home)
    ids = {plane.id for plane in home.structure}
    stands_for = {**planes, **{node: (true,) for node, true in matched.items()}}
    known = {true for several in stands_for.values() for true in several}
    all_counted = countable | {r.id for r in home.rooms} | ids
    for relation in JUDGED:
        true = {(a, b) for name, a, b in home.relations() if name == relation}
        said = set()
        for edge in world.graph.edges(relation):
            pairs = [(a, b) for a in stands_for.get(edge.source, ()) for b in stands_for.get(edge.target, ())]
            if relation in SYMMETRIC:
                pairs = [(min(pair), max(pair)) for pair in pairs]
            if pairs and not (relation == "on" and edge.target in planes):
                said.add(next((pair for pair in pairs if pair in true), pairs[0]))
        judgeable = {pair for pair in true if known.issuperset(pair)}
        result.tallies[f"relations.{relation}"].add(len(said & judgeable), len(said), len(judgeable))
        everything = {pair for pair in true if all_counted.issuperset(pair)}
        result.tallies[f"relations.{relation}.recall_all"].add(len(said & everything), 0, len(everything))
        result.notes += [f"{home.seed}: missed {relation}{pair}" for pair in sorted(judgeable - said)]
        result.notes += [f"{home.seed}: wrong {relation}{pair}" for pair in sorted(said - judgeable)]


def match_planes(world: World, home: Home) -> dict[str, tuple[str, ...]]:
    """Plane node id → the true planes that parts of it lie on and that face the same way, the largest part first.

    Walls of two rooms may lie in one plane, and are then mapped as one.
    """
    found: dict[str, tuple[str, ...]] = {}
    for node in world.graph.nodes("structure"):
        if not node.id.startswith("plane_"):
            continue
        plane = world.map.planes.plane(int(node.id.removeprefix("plane_")))
        points = world.map.planes.samples(plane.id, SAMPLES).astype(np.float64)
        truth = home.triangle_plane[home.renderer.scene.closest(points)[0]]
        numbers, counts = np.unique(truth[truth >= 0], return_counts=True)
        parts = [int(k) for k, n in sorted(zip(numbers, counts, strict=True), key=lambda part: -part[1])
                 if n >= LEAST_PART * len(points)]  # fmt: skip
        facing = [home.structure[k] for k in parts if float(home.structure[k].normal @ plane.normal) >= FACING]
        if facing:
            found[node.id] = tuple(true.id for true in facing)
    return found
