"""Every change of the graph is told once, as what it means."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenegraph.events import EventLog, events_of
from scenegraph.graph import Delta, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion


def node(name: str = "object_1", label: str = "cup", at: float = 0.0, layer: str = "object", **about: object) -> Node:
    return Node(
        id=name, layer=layer, label=label, position=(at, 0.0, 0.0), first_seen_ns=0, last_seen_ns=1, attributes=about
    )


class Told:
    """A graph whose changes are told."""

    def __init__(self, *nodes: Node) -> None:
        self.graph = SceneGraph()
        self.now = 0
        self.commit(*nodes)

    def commit(self, *steps: Node | tuple[str, str, str | None]) -> list[tuple[str, str]]:
        changes = GraphChanges()
        for step in steps:
            changes.put(step) if isinstance(step, Node) else changes.delete_node(*step)
        self.now += 1
        before = {n.id: n for n in self.graph}
        self.delta: Delta = self.graph.commit(changes, self.now)
        self.events = events_of(self.delta, before)
        return [(event.kind, event.node) for event in self.events]


def test_what_is_new_has_appeared_and_what_is_deleted_has_vanished():
    told = Told()
    assert told.commit(node(at=1.0)) == [("appeared", "object_1")]
    assert told.commit(("object_1", "no longer seen", None)) == [("vanished", "object_1")]
    (event,) = told.events
    assert (event.reason, event.stamp_ns, event.revision) == ("no longer seen", 3, 2)
    assert event.position == (1.0, 0.0, 0.0)


def test_what_is_part_of_another_now_was_merged_into_it():
    told = Told(node(), node("object_2"))
    assert told.commit(("object_2", "the same thing as another", "object_1")) == [("merged", "object_2")]
    assert told.events[0].other == "object_1"


def test_a_thing_that_was_carried_has_moved_once_whether_it_was_gone_meanwhile_or_not():
    told = Told(node(), node("object_2"))
    there = node(at=3.0, moved_ns=2, moved_from=[0.0, 0.0, 0.0])
    assert told.commit(there) == [("moved", "object_1")]
    assert told.events[0].origin == (0.0, 0.0, 0.0)
    assert told.commit(there.replace(position=(3.05, 0.0, 0.0))) == []
    told.commit(("object_2", "no longer seen", None))
    assert told.commit(node("object_2", at=2.0, moved_ns=4, moved_from=[0.0, 0.0, 0.0])) == [("moved", "object_2")]


def test_what_comes_back_where_it_was_says_so():
    told = Told()
    told.commit(node(returned_ns=1))
    assert [(e.kind, e.reason) for e in told.events] == [("appeared", "seen again where it was")]


def test_another_class_and_a_part_of_another_are_told():
    told = Told(node())
    assert told.commit(node(label="bowl"), node("object_2", split_from="object_1")) == [
        ("relabelled", "object_1"),
        ("split", "object_2"),
    ]
    assert told.events[0].label_before == "cup"
    assert told.events[1].other == "object_1"


def test_better_measurements_are_no_events_nor_are_planes():
    told = Told(node())
    assert told.commit(node(at=0.02), node("plane_3", "wall", layer="structure")) == []
    assert told.commit(node("opening_3", "door", layer="structure")) == [("appeared", "opening_3")]


@given(st.lists(st.integers(0, 5), max_size=30), st.integers(1, 10))
def test_the_log_keeps_the_latest_and_tells_what_came_since(gaps, limit):
    log, stamps, now = EventLog(limit), [], 0
    told = Told(node())
    told.commit(node(label="bowl"))
    (event,) = told.events
    for gap in gaps:
        now += gap
        stamps.append(now)
        log.add([event.model_copy(update={"stamp_ns": now})])
    kept = stamps[-limit:]
    assert [e.stamp_ns for e in log.since()] == kept
    for since in {0, now, now // 2}:
        assert [e.stamp_ns for e in log.since(since)] == [s for s in kept if s > since]
    again = EventLog(limit)
    again.restore(json.loads(json.dumps(log.document())))
    assert again.since() == log.since()


def test_a_deletion_of_what_never_was_is_no_event():
    told = Told()
    changes = GraphChanges()
    changes.put(node())
    changes.delete_node("object_1", "at once")
    assert isinstance(changes.steps[1], NodeDeletion)
    assert events_of(told.graph.commit(changes, 5), {}) == []


@pytest.mark.parametrize("layer", ["room", "agent"])
def test_rooms_and_robots_have_events_too(layer):
    assert Told().commit(node("thing_1", layer=layer)) == [("appeared", "thing_1")]
