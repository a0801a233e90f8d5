"""What a changed home must be: the same, but for what its truth says; and nothing in it is impossible."""

from __future__ import annotations

import pickle
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from mapping.errors import InvalidParameter
from scenegraph.simulation import Home, NoiseModel, change_home
from scenegraph.simulation.arrangement import overlap
from scenegraph.simulation.changing import FARTHEST_M, FIXED_CLASSES, NEAREST_M, REMOVED_SHARE
from scenegraph.simulation.driving import FloorGrid
from scenegraph.simulation.observing import make_segmenter
from tests.support.homes import home

every_home = pytest.mark.parametrize("seed", range(3))


@cache
def changed(seed: int) -> Home:
    return change_home(home(seed), seed)


def ids(h: Home) -> set[str]:
    return {o.id for o in h.objects}


@every_home
def test_what_is_there_is_what_was_there_less_the_removed_and_with_the_added(seed):
    before, after = home(seed), changed(seed)
    change = after.change
    assert change.before is before
    assert ids(after) == ids(before) - change.removed | change.added
    assert not ids(before) & change.added
    assert change.moved <= ids(before) - change.removed
    assert len(change.added) >= 3
    assert len(change.moved) >= 5


@every_home
def test_a_fifth_of_the_loose_things_is_removed_and_furniture_stays(seed):
    before, change = home(seed), changed(seed).change
    bearing = {o.support for o in before.objects}
    loose = {o.id for o in before.objects if o.label not in FIXED_CLASSES} - bearing
    assert len(change.removed) == round(REMOVED_SHARE * len(loose))
    assert change.removed | change.moved <= loose


@every_home
def test_what_was_moved_looks_the_same_elsewhere_and_all_else_is_where_it_was(seed):
    before, after = home(seed), changed(seed)
    for thing in after.objects:
        if thing.id in after.change.added:
            continue
        was = before.thing(thing.id)
        assert (thing.label, thing.size.tolist()) == (was.label, was.size.tolist())
        assert np.array_equal(thing.colors, was.colors)
        way = np.linalg.norm(thing.center - was.center)
        if thing.id in after.change.moved:
            assert NEAREST_M - 1e-6 <= way <= FARTHEST_M + 1e-6
        else:
            assert np.array_equal(thing.vertices, was.vertices)


@every_home
def test_nothing_runs_into_another_and_what_bears_is_there(seed):
    after = changed(seed)
    for a, b in combinations(after.placed, 2):
        if a.room == b.room and b.id != a.support and a.id != b.support:
            assert not overlap(a.solids, b.solids), (a.id, b.id)
    assert {o.support for o in after.objects} - {None} <= ids(after)


def test_a_robot_still_gets_into_every_room():
    after = changed(0)
    grid = FloorGrid(after.plan, after.placed)
    assert set(grid.order(grid.start())) == {room.id for room in after.rooms}


def test_the_same_seed_changes_a_home_alike_and_another_differently():
    assert change_home(home(0), 0).change.removed == changed(0).change.removed
    assert change_home(home(0), 1).change.removed != changed(0).change.removed
    again = pickle.loads(pickle.dumps(changed(0)))
    assert np.array_equal(again.vertices, changed(0).vertices)
    assert again.change.moved == changed(0).change.moved


def test_a_changed_home_is_not_changed_again():
    with pytest.raises(InvalidParameter, match="changed before"):
        change_home(changed(0))


def test_what_the_segmenter_always_mistakes_it_still_does():
    before, after = make_segmenter(home(0), NoiseModel(), 0), make_segmenter(changed(0), NoiseModel(), 0)
    said = dict(zip(home(0).entities, before.persistent[1:].tolist(), strict=True))
    for k, name in enumerate(changed(0).entities, 1):
        assert after.persistent[k] == said.get(name, after.true_class[k])
