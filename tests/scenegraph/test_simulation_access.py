"""What is truly seen, reached, blocked and between in a home: laws, and cases worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from scenegraph.simulation.access import DOORWAY_DEEP_M, Disc, TrueAccess
from scenegraph.simulation.arrangement import Placed
from scenegraph.simulation.assembling import assemble
from scenegraph.simulation.shapes import Shape
from tests.support.homes import home

SEED = 2
SMALL = Disc(0.25, 1.4, 0.8)


@cache
def access() -> TrueAccess:
    return TrueAccess(home(SEED))


def middle(kind):
    return next(r for r in home(SEED).rooms if r.kind == kind).footprint.mean(axis=0)


def test_what_is_seen_is_in_sight_of_a_ray_and_nothing_is_seen_through_a_shut_room():
    eye = np.array([*middle("bathroom"), 1.2])
    seen = access().visible_from(eye)
    assert {home(SEED).thing(thing).label for thing in seen} >= {"toilet"}
    for thing in seen:
        points = home(SEED).thing(thing).vertices
        assert np.linalg.norm(points.mean(axis=0) - eye) <= 10.0
    behind = np.array([*middle("bathroom"), -1.0])  # under the floor
    assert not access().visible_from(behind)


def test_a_longer_arm_and_a_slimmer_body_reach_no_less():
    start = middle("hallway")
    reached = access().reachable(start, SMALL)
    assert reached
    assert access().reachable(start, replace(SMALL, reach_m=0.3)) <= reached
    assert access().reachable(start, replace(SMALL, radius_m=0.35, reach_m=0.7)) <= reached
    everything = {o.id for o in home(SEED).objects}
    far = access().reachable(start, replace(SMALL, reach_m=8.0))
    assert reached <= far <= everything


def test_a_robot_wider_than_every_door_stays_in_its_room():
    wide = max(d.width for d in home(SEED).doors if d.kind != "opening") / 2 + 0.02
    start = middle("living_room")
    stout = access().reachable(start, Disc(wide, 1.4, 0.1))
    if stout is not None:
        rooms = {home(SEED).thing(thing).room for thing in stout}
        assert rooms <= {"living_room", "kitchen"}, "a wide opening joins these two"


def test_a_robot_that_does_not_fit_where_it_stands_is_not_judged():
    bed = next(o for o in home(SEED).objects if o.label == "bed")
    assert access().reachable(bed.center[:2], SMALL) is None


@pytest.mark.parametrize(("aside", "radius", "blocked"), [(0.0, 0.25, True), (0.0, 0.05, False), (2.0, 0.25, False)])
def test_a_crate_in_a_doorway_blocks_it_for_whom_it_leaves_no_passage(aside, radius, blocked):
    h = home(SEED)
    door = next(d for d in h.doors if d.kind == "doorway")
    at = h.T_map_home.inverse() @ (door.center + aside * door.normal)
    half = door.width / 2 - 0.1
    crate = Shape("box").box((-half, half), (-half, half), (0.0, 0.4)).model()
    placed = [*h.placed, Placed("crate", crate, (float(at[0]), float(at[1]), 0.0), 0.0, door.rooms[0])]
    names = {p.id: o.id for p, o in zip(h.placed, h.objects, strict=True)} | {"crate": "box_99"}
    assert aside == 0.0 or aside > half + DOORWAY_DEEP_M
    crowded = assemble(h.seed, h.yaw, h.T_map_home, h.plan, placed, h.tints, names)
    found = TrueAccess(crowded).blocks(Disc(radius, 1.4, 0.8))
    assert found == ({("box_99", door.id)} if blocked else set())


def test_nothing_blocks_the_doors_of_a_home_for_the_robot_that_toured_it():
    assert access().blocks(SMALL) == frozenset()


def test_between_is_symmetric_and_names_neither_end():
    things = [o.id for o in home(SEED).objects]
    rng = np.random.default_rng(0)
    for a, b in rng.choice(things, (40, 2)).tolist():
        if a != b:
            found = access().between(a, b)
            assert found == access().between(b, a)
            assert not {a, b} & found
