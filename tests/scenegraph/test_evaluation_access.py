"""Worlds that answer with the truth, with nothing and with everything, and the figures that they get."""

from __future__ import annotations

import re
from functools import cache
from types import SimpleNamespace

import numpy as np

from scenegraph.evaluation import Evaluation
from scenegraph.evaluation.access import PAIRS, PLACES, ROBOTS, judge_access
from scenegraph.perception.access import EYE_M
from scenegraph.simulation.access import Disc, TrueAccess
from scenegraph.simulation.observing import robot_description
from tests.support.homes import home

SEED = 2
NAMES = ("visible_from", "reachable", "blocks", "between")


@cache
def truth() -> TrueAccess:
    return TrueAccess(home(SEED))


class Oracle:
    """A world in which each thing is a node of its own name; `answer` turns the truth of a goal into what it says."""

    def __init__(self, answer):
        self.answer, self.asked = answer, []
        self.robots = {"robot": robot_description()}
        rooms = sorted(home(SEED).rooms, key=lambda r: r.id)
        self.places = [
            SimpleNamespace(id=f"place_{k}", position=np.array([*r.footprint.mean(axis=0), 0.0]))
            for k, r in enumerate(rooms)
        ]
        hall = next(r for r in rooms if r.kind == "hallway").footprint.mean(axis=0)
        self.agent = SimpleNamespace(id="agent_robot", position=np.array([*hall, 0.0]))
        self.graph = SimpleNamespace(nodes=lambda layer: self.places if layer == "place" else [self.agent])

    def integrate(self, description):
        self.robots[description.robot] = description

    def ask(self, goal, *, limit, timeout_s):
        self.asked.append(goal)
        relation, *rest = re.findall(r"\w+", goal)
        body = self.robots["robot"]
        robot = Disc(body.radius_m, body.height_m, body.reach_m)
        match relation, rest:
            case "visible_from", ["X", place]:
                at = next(p.position for p in self.places if p.id == place)
                true = truth().visible_from(at + np.array([0.0, 0.0, EYE_M]))
            case "reachable", ["X", _]:
                true = truth().reachable(self.agent.position[:2], robot)
            case "blocks", ["X", door]:
                true = {thing for thing, its in truth().blocks(robot) if its == door}
            case "between", ["X", a, b]:
                true = truth().between(a, b)
        return [{"X": SimpleNamespace(id=thing)} for thing in self.answer(true)]


def judged(answer):
    things = {o.id: o.id for o in home(SEED).objects}
    doors = {d.id: d.id for d in home(SEED).doors}
    world, result = Oracle(answer), Evaluation()
    judge_access(world, home(SEED), things, doors, result)
    return world, {name: result.tallies[f"relations.{name}"] for name in NAMES}, result


def test_a_world_that_knows_everything_is_right_on_every_count():
    world, tallies, result = judged(lambda true: true)
    assert all(tally.precision == tally.recall == 1.0 for tally in tallies.values())
    assert all(tallies[name].true > 0 for name in NAMES if name != "blocks")
    assert not result.notes
    assert world.robots["robot"].radius_m == robot_description().radius_m, "it is described as it was"
    asked = [goal.split("(")[0] for goal in world.asked]
    assert asked.count("visible_from") <= PLACES
    assert asked.count("between") == PAIRS
    assert asked.count("reachable") <= len(ROBOTS)


def test_a_world_that_does_not_know_is_not_wrong_and_misses_everything():
    world, tallies, result = judged(lambda true: ())
    assert all(tally.said == 0 for tally in tallies.values())
    assert all(tallies[name].recall == 0.0 for name in NAMES if name != "blocks")
    assert all("missed" in note for note in result.notes)
    assert world.asked == judged(lambda true: true)[0].asked, "the same home is asked the same"


def test_a_world_that_says_everything_misses_nothing_and_ghosts_are_not_counted():
    _, tallies, result = judged(lambda true: [*(o.id for o in home(SEED).objects), "ghost_1"])
    for name in NAMES:
        assert tallies[name].recall == 1.0
        assert tallies[name].precision < 1.0
    assert not any("ghost" in note for note in result.notes)
