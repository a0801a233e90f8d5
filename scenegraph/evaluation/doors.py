"""Doors and openings between rooms, against those of the home."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from scenegraph.evaluation.result import Evaluation
from scenegraph.simulation import Home
from scenegraph.world import World

__all__ = ["DOOR_M", "judge_doors"]

DOOR_M = 0.5
"""A door is found where a node leads from one room to the other so near to its middle, seen from above: the leaf of a
door ajar stands beside the way."""


def judge_doors(world: World, home: Home, rooms: dict[str, str], result: Evaluation) -> dict[str, str]:
    """Match nodes that connect two rooms to the doors, doorways and openings between those rooms, one to one.

    rooms : room node id → true id; a node that connects a room that was not matched counts as wrong

    Returns node id → true id of the doors that were found.
    """
    joined: dict[str, set[str]] = {}
    at: dict[str, Any] = {}
    for edge in world.graph.edges("connects"):
        joined.setdefault(edge.source, set()).add(rooms.get(edge.target, edge.target))
        at[edge.source] = edge.attributes.get("at", world.graph.node(edge.source).position[:2].tolist())
    said = {by: pair for by, pair in joined.items() if len(pair) == 2}
    true = [door for door in home.doors if len(door.rooms) == 2]
    near = [[float(np.hypot(*np.subtract(at[by], d.center[:2]))) <= DOOR_M for d in true] for by in said]
    fits = [[pair == set(d.rooms) for d in true] for pair in said.values()]
    right = (np.array(near, bool) & np.array(fits, bool)).reshape(len(said), len(true))
    rows, columns = linear_sum_assignment(~right)
    pairs = [(r, c) for r, c in zip(rows, columns, strict=True) if right[r, c]]
    result.tallies["doors"].add(len(pairs), len(said), len(true))
    good, found = {r for r, _ in pairs}, {c for _, c in pairs}
    result.notes += [f"{home.seed}: missed {d.kind} {d.id} of {d.rooms}" for c, d in enumerate(true) if c not in found]
    wrong = [by for r, by in enumerate(said) if r not in good]
    result.notes += [f"{home.seed}: {by} is no way between {' and '.join(sorted(said[by]))}" for by in wrong]
    names = list(said)
    return {names[r]: true[c].id for r, c in pairs}
