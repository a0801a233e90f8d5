"""What the rules say of the past is what the graph was then, however its history came about and was told."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase
from scenegraph import facts
from scenegraph.errors import HistoryUnavailable
from scenegraph.events import EventLog, events_of
from scenegraph.graph import Delta, Edge, EdgeKey, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion
from scenegraph.past import Past
from scenegraph.world import World

THINGS = ["cup_1", "table_1", "shelf_1", "box_1"]
LABELS = ["cup", "table", "shelf", "vase"]
RELATIONS = ["on", "near"]


def node(node_id: str, label: str = "cup", stamp_ns: int = 1, **attributes: Any) -> Node:
    return Node(
        id=node_id, layer="object", label=label, position=(0, 0, 0), first_seen_ns=stamp_ns, last_seen_ns=stamp_ns,
        attributes=attributes,
    )  # fmt: skip


def edge(relation: str, source: str, target: str, stamp_ns: int = 1) -> Edge:
    return Edge(relation=relation, source=source, target=target, first_seen_ns=stamp_ns, last_seen_ns=stamp_ns)


class Story:
    """A graph with its events and what the rules are told of it, as a world keeps them; without a map."""

    def __init__(self, knowledge: KnowledgeBase, history_limit: int = 100_000) -> None:
        knowledge.update(forget=THINGS, deleted=_remembered(knowledge))
        self.knowledge = knowledge
        self.graph = SceneGraph(history_limit=history_limit)
        self.events = EventLog()
        self.past = Past()
        knowledge.watching.supplier = self.supply

    def commit(self, stamp_ns: int, changes: GraphChanges) -> Delta:
        steps = [s for s in changes.steps if isinstance(s, Node | NodeDeletion) and s.id in self.graph]
        before = {step.id: self.graph.node(step.id) for step in steps}
        delta = self.graph.commit(changes, stamp_ns)
        self.events.add(events_of(delta, before))
        self.knowledge.update(
            put=[fact for one in delta.nodes.put for fact in facts.node_facts(one)], forget=delta.nodes.deleted
        )
        return delta

    def supply(self, what: str) -> bool:
        if self.past.knows(what):
            return False
        put, deleted = self.past.supply(what, self.graph, self.events)
        self.knowledge.update(put=put, deleted=deleted)
        return True

    def catch_up(self) -> None:
        put, deleted = self.past.catch_up(self.graph, self.events)
        self.knowledge.update(put=put, deleted=deleted)

    def pairs(self, goal: str) -> set[tuple[str, ...]]:
        reply = self.knowledge.ask(goal, limit=10_000, timeout_s=10.0)
        assert reply.problem is None, reply.problem
        return {tuple(str(term) for term in row.values()) for row in reply.answers}


def _remembered(knowledge: KnowledgeBase) -> list[Any]:
    names = ["lasted/5", "lived/5", "had/5", "event/5", "sighted/3", "past_relation/1", "told_past/1"]
    found = []
    for name, arity in (spec.split("/") for spec in names):
        arguments = ", ".join(f"A{n}" for n in range(int(arity)))
        found += [row["F"] for row in knowledge.call(f"F = {name}({arguments}), facts:F")]
    return [*found, *(row["F"] for row in knowledge.call("F = parameter(N, V), parameter(N, V)"))]


@pytest.fixture(scope="module")
def knowledge() -> Iterator[KnowledgeBase]:
    with KnowledgeBase() as base:
        yield base


@st.composite
def stories(draw: Any) -> list[tuple[int, list[tuple[Any, ...]]]]:
    """Steps in time, several of them at one moment now and then: nodes and edges that come and go."""
    stamp_ns, steps = 10, []
    for _ in range(draw(st.integers(1, 10))):
        stamp_ns += draw(st.integers(0, 5))
        wishes: list[tuple[Any, ...]] = []
        for _ in range(draw(st.integers(1, 4))):
            a = draw(st.sampled_from(THINGS))
            b = draw(st.sampled_from([thing for thing in THINGS if thing != a]))
            kind = draw(st.sampled_from(["node", "node", "edge", "edge", "edge", "no edge", "no node"]))
            wishes.append(
                {
                    "node": ("node", a, draw(st.sampled_from(LABELS)), draw(st.sampled_from(["open", "closed", ""]))),
                    "edge": ("edge", draw(st.sampled_from(RELATIONS)), a, b),
                    "no edge": ("no edge", draw(st.sampled_from(RELATIONS)), a, b),
                    "no node": ("no node", a),
                }[kind]
            )
        steps.append((stamp_ns, wishes))
    return steps


def carried_out(story: Story, stamp_ns: int, wishes: list[tuple[Any, ...]]) -> None:
    changes = GraphChanges()
    there = {one.id for one in story.graph}
    for kind, *what in wishes:
        if kind == "node":
            changes.put(node(what[0], what[1], stamp_ns, **({"state": what[2]} if what[2] else {})))
            there.add(what[0])
        elif kind == "edge" and set(what[1:]) <= there:
            changes.put(edge(*what, stamp_ns))
        elif kind == "no edge":
            changes.delete_edge(*what)
        elif kind == "no node" and what[0] in there:
            changes.delete_node(what[0], "gone")
            there.discard(what[0])
    story.commit(stamp_ns, changes)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=stories(), asked_at=st.sets(st.integers(0, 9)), limit=st.sampled_from([100_000, 6]))
def test_what_held_is_what_the_graph_of_then_has(
    knowledge: KnowledgeBase, steps: list[Any], asked_at: set[int], limit: int
) -> None:
    story = Story(knowledge, limit)
    for n, (stamp_ns, wishes) in enumerate(steps):
        carried_out(story, stamp_ns, wishes)
        if story.past.is_asked_for:
            story.catch_up()
        if n in asked_at:
            story.pairs("holds(on(X, Y), now)")
    [row] = [*knowledge.call("parameter(history_since_ns, S)"), {"S": 0}][:1]
    since = row["S"]
    assert isinstance(since, int)
    ever = {str(row["X"]) for row in knowledge.call("lived(X, _, _, _, _)")}
    for at in range(max(since, steps[0][0]), steps[-1][0] + 2):
        try:
            then = story.graph.as_of(at)
        except HistoryUnavailable:
            assert limit == 6
            continue
        for relation in RELATIONS:
            held = {(one.source, one.target) for one in then.edges(relation)}
            assert story.pairs(f"holds({relation}(X, Y), {at})") == held, (relation, at)
        assert story.pairs(f"holds(object(X), {at})") == {(one.id,) for one in then}
        assert story.pairs(f"holds(label(X, C), {at})") == {(one.id, one.label) for one in then}
        states = {(one.id, one.attributes["state"]) for one in then if "state" in one.attributes}
        assert story.pairs(f"holds(attribute(X, state, V), {at})") == states
        for a, b in (("cup_1", "table_1"), ("table_1", "shelf_1"), ("box_1", "cup_1")):
            if {a, b} <= ever:
                truth = knowledge.ask(f"holds(on({a}, {b}), {at})").truth
                known = a in then and b in then
                assert truth == ("true" if EdgeKey("on", a, b) in then else "false" if known else "unknown")


def test_the_past_of_a_world_agrees_with_asking_it_then() -> None:
    with World() as world:
        knowledge = world.meaning.knowledge
        for stamp_ns, wishes in [
            (10, [node("cup_1"), node("table_1", "table"), edge("on", "cup_1", "table_1")]),
            (20, [node("shelf_1", "shelf"), edge("on", "cup_1", "shelf_1")]),
            (30, [edge("near", "table_1", "shelf_1")]),
        ]:
            changes = GraphChanges()
            for item in wishes:
                changes.put(item)
            if stamp_ns == 20:
                changes.delete_edge("on", "cup_1", "table_1")
            knowledge.update(put=[f for item in wishes if isinstance(item, Node) for f in facts.node_facts(item)])
            world._commit(changes, stamp_ns)
        for at in (5, 10, 20, 35):
            for state in ("on(cup_1, table_1)", "on(cup_1, shelf_1)", "near(table_1, shelf_1)", "on(cup_1, X)"):
                now, then = world.ask(f"holds({state}, {at})"), world.ask(state, at_ns=at)
                assert now.truth == then.truth, (state, at)
                if "X" in state:
                    assert [row["X"].id for row in now] == [row["X"].id for row in then]
        why = world.ask("holds(on(cup_1, table_1), 12)").explain()
        assert why is not None
        assert "held(on(cup_1,table_1),10,20)" in why.text
        no = world.ask("holds(on(cup_1, table_1), 25)").explain()
        assert no is not None
        assert "moment 25 >= 20" in no.text
        open_ = world.ask("holds(on(cup_1, shelf_1), 12)").explain()
        assert open_ is not None
        assert "first_observed(shelf_1,20)" in open_.text
        assert world.ask("before(on(cup_1, table_1), near(table_1, shelf_1))").truth == "true"
        assert [row["R"] for row in world.ask("allen(R, on(cup_1, table_1), on(cup_1, shelf_1))")] == ["meets"]
        world.tell("fact(moment(breakfast, 12))", author="ann")
        changed = world.ask("changed_since(breakfast, E)")
        assert {row["E"].replace(" ", "") for row in changed} == {
            "appeared(shelf_1)", "ended(on(cup_1,table_1))", "began(on(cup_1,shelf_1))", "began(near(table_1,shelf_1))",
        }  # fmt: skip
        for goal, code in [
            ("holds(F, 12)", "unbound_variable"),
            ("holds(on(cup_1, X), T)", "unbound_variable"),
            ("holds(on(dragon, X), 12)", "unknown_name"),
            ("holds(on(cup_1, X), lunch)", "unknown_name"),
            ("holds(larger(cup_1, X), 12)", "bad_argument"),
            ("before(on(cup_1, X), 'x y z'(1))", "bad_argument"),
        ]:
            problem = world.ask(goal).problem
            assert problem is not None, goal
            assert problem.code == code, goal


def test_a_watch_of_the_past_follows_the_clock_of_the_graph() -> None:
    with World() as world:
        changes = GraphChanges()
        changes.put(node("cup_1"))
        changes.put(node("table_1", "table"))
        changes.put(edge("on", "cup_1", "table_1"))
        world.meaning.knowledge.update(put=[f for n in ("cup_1", "table_1") for f in facts.node_facts(node(n))])
        world._commit(changes, 1_000_000_000)
        with world.watch("holds(on(cup_1, X), ago(5))") as told:
            assert [change.truth for change in told] == ["unknown"]
            changes = GraphChanges()
            changes.delete_edge("on", "cup_1", "table_1")
            world._commit(changes, 7_000_000_000)
            assert [len(change.came) for change in told] == [1], "five seconds ago it was there"
            changes = GraphChanges()
            changes.put(node("cup_2"))
            world._commit(changes, 13_000_000_000)
            assert [len(change.went) for change in told] == [1]
