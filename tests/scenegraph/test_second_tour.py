"""The figures of a second tour tell ghosts, ids that were kept and ids that were lost."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenegraph.evaluation.result import Evaluation
from scenegraph.evaluation.second_tour import LOOKED_IMAGES, SecondLook, judge_second_tour
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph
from scenegraph.simulation import Home, TrueObject, change_home
from tests.support.homes import home
from tests.support.scenes import looking_at


@cache
def changed() -> Home:
    return change_home(home(0), 0)


def node(name: str, thing: TrueObject) -> Node:
    box = Box.from_yaw(thing.center, thing.size, thing.yaw)
    return Node(
        id=name, layer="object", label=thing.label, position=thing.center, box=box, first_seen_ns=1, last_seen_ns=2
    )


def judged(ids: dict[str, str], extra: tuple[Node, ...] = ()) -> Evaluation:
    """The figures of a world that holds all things of the changed home exactly, under the `ids` of their true ids,
    after a first tour on which all had a node of their own name."""
    after = changed()
    changes = GraphChanges()
    for thing in after.objects:
        changes.put(node(ids.get(thing.id, thing.id), thing))
    for one in extra:
        changes.put(one)
    graph = SceneGraph()
    graph.commit(changes, 1)
    world: Any = SimpleNamespace(graph=graph, perception=SimpleNamespace(objects=SimpleNamespace(shapes={})))
    before = {o.id: o.id for o in home(0).objects}
    first: Any = SimpleNamespace(countable=frozenset(before))
    look: Any = SimpleNamespace(
        countable=frozenset(o.id for o in after.objects),
        looked_at=after.change.removed | after.change.moved,
        confused=frozenset(),
    )
    result = Evaluation()
    judge_second_tour(world, after, first, look, before, result)
    return result


def test_a_world_that_follows_every_change_has_no_ghost_and_every_id():
    figures = judged({}).figures()
    assert figures["lasting.ghosts"] == figures["second_tour.objects.duplicates"] == 0.0
    names = ("lasting.removed_noticed", "lasting.moved_keep_id", "lasting.stayed_keep_id", "second_tour.objects.recall")
    assert [figures[name] for name in names] == [1.0] * 4


def test_a_node_where_a_thing_was_is_a_ghost():
    gone = home(0).thing(sorted(changed().change.removed)[0])
    result = judged({}, (node("old_1", gone),))
    assert result.shares["lasting.ghosts"].right == 1
    noticed = result.shares["lasting.removed_noticed"]
    assert noticed.right == noticed.true - 1
    assert any(f"stands where {gone.id} was" in note for note in result.notes)


@pytest.mark.parametrize("kind", ["moved", "stayed"])
def test_an_id_that_was_lost_counts_against_it(kind):
    change = changed().change
    stayed = sorted(o.id for o in changed().objects if o.id not in change.moved | change.added)
    [lost] = (sorted(change.moved) if kind == "moved" else stayed)[:1]
    result = judged({lost: "new_1"})
    share = result.shares[f"lasting.{kind}_keep_id"]
    assert share.right == share.true - 1
    assert any(f"{lost} ({kind}) was {lost} and is new_1" in note for note in result.notes)


def test_a_place_is_looked_at_again_when_images_see_through_it_and_not_from_elsewhere():
    before, after = home(0), changed()
    heights = {i: before.thing(i).center[2] for i in after.change.removed}
    name = max(heights, key=lambda i: heights[i])
    center = before.thing(name).center
    seen, away = SecondLook(after), SecondLook(after)
    for k in range(LOOKED_IMAGES):
        assert name not in seen.looked_at
        eye = center + np.array([0.5 * np.cos(0.2 * k), 0.5 * np.sin(0.2 * k), 0.35])
        seen.record(after.renderer.render(looking_at(eye, center)))
        away.record(after.renderer.render(looking_at(eye, eye + (eye - center))))
    assert name in seen.looked_at
    assert name not in away.looked_at
