"""What depends on a viewer or a robot, or on three things, and is measured when somebody asks: as asked of a world, and
as it truly is in the home.

A few questions a home, drawn with its seed: what is visible from places of the graph, what robots of several sizes
reach and what blocks doors for them, what lies between two things. What a world does not know it does not answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from mapping.observations import RobotDescription
from scenegraph.evaluation.result import Evaluation
from scenegraph.perception.access import EYE_M
from scenegraph.simulation import Home
from scenegraph.simulation.access import Disc, TrueAccess
from scenegraph.world import World

__all__ = ["judge_access"]

ROBOTS = (Disc(0.25, 1.4, 0.8), Disc(0.25, 1.4, 0.3), Disc(0.35, 1.4, 0.5))
"""The one that took the tour, one with a short arm, and a stout one."""
PLACES = 6
PAIRS = 40
APART_M = 3.0
"""Two things between which something is looked for are no farther apart than this."""
MOST_ANSWERS = 10_000
TIME_S = 30.0

Found = Iterator[tuple[tuple[str, ...], bool]]


def judge_access(world: World, home: Home, things: dict[str, str], doors: dict[str, str], result: Evaluation) -> None:
    """Ask what is visible, reachable, blocked and between; count the answers about things and doors that were found.

    things, doors : node id → true id. The robot of the tour is described anew, and at the end as it was.
    """
    rng = np.random.default_rng(home.seed)
    truth = TrueAccess(home)
    found = {true: node for node, true in things.items()}

    def count(relation: str, said: set[str], true: frozenset[str], of: str) -> None:
        said, known = {things[x] for x in said if x in things}, {x for x in true if x in found}
        result.tallies[f"relations.{relation}"].add(len(said & known), len(said), len(known))
        result.notes += [f"{home.seed}: missed {relation}({x}, {of})" for x in sorted(known - said)]
        result.notes += [f"{home.seed}: wrong {relation}({x}, {of})" for x in sorted(said - known)]

    places = world.graph.nodes("place")
    for k in sorted(rng.choice(len(places), min(PLACES, len(places)), replace=False).tolist()):
        place = places[k]
        eye = place.position + np.array([0.0, 0.0, EYE_M])
        count("visible_from", _answers(world, f"visible_from(X, {place.id})"), truth.visible_from(eye), place.id)
    pairs = [
        (a, b)
        for a, b in combinations(sorted(found), 2)
        if np.linalg.norm(home.thing(a).center - home.thing(b).center) <= APART_M
    ]
    for k in sorted(rng.choice(len(pairs), min(PAIRS, len(pairs)), replace=False).tolist()):
        a, b = pairs[k]
        said = _answers(world, f"between(X, {found[a]}, {found[b]})")
        count("between", said, truth.between(a, b), f"{a}, {b}")
    for agent in world.graph.nodes("agent"):
        name = agent.id.removeprefix("agent_")
        before = world.robots[name]
        for robot in ROBOTS:
            world.integrate(_described(name, robot))
            here = f"{name} of {robot.radius_m} m, arm {robot.reach_m} m"
            true = truth.reachable(agent.position[:2], robot)
            if true is not None:
                count("reachable", _answers(world, f"reachable(X, {agent.id})"), true, here)
            for node, door in sorted(doors.items()):
                blocking = frozenset(thing for thing, its in truth.blocks(robot) if its == door)
                count("blocks", _answers(world, f"blocks(X, {node})"), blocking, f"{door} for {here}")
        world.integrate(before)


def _answers(world: World, goal: str) -> set[str]:
    """Ids of the nodes X of which a goal is true."""
    return {row["X"].id for row in world.ask(goal, limit=MOST_ANSWERS, timeout_s=TIME_S)}


def _described(name: str, robot: Disc) -> RobotDescription:
    angle = np.arange(16) * np.pi / 8
    rim = robot.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return RobotDescription(robot=name, footprint=rim, height_m=robot.height_m, reach_m=robot.reach_m)
