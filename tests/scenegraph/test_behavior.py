"""Conditions and plans under a behaviour tree."""

from __future__ import annotations

import pytest

from scenegraph.graph import Edge, GraphChanges, SceneGraph
from scenegraph.importing import GraphFile
from scenegraph.planning import Step
from tests.scenegraph.test_planning import moved
from tests.support.errands import small_flat

py_trees = pytest.importorskip("py_trees")
from py_trees.common import Status  # noqa: E402

from scenegraph.behavior import Condition, condition, plan_tree  # noqa: E402


def drive(graph: SceneGraph, step: Step) -> None:
    """The robot is seen in the room that a step leads to."""
    if step.arguments[0].startswith("room_"):
        changes = GraphChanges()
        for edge in graph.edges("in", source="agent_rob"):
            changes.delete_edge("in", "agent_rob", edge.target)
        changes.put(Edge(relation="in", source="agent_rob", target=step.arguments[0], first_seen_ns=2, last_seen_ns=2))
        room = graph.node(step.arguments[0])
        changes.put(graph.node("agent_rob").replace(position=room.position))
        graph.commit(changes, 2)


def test_a_condition_follows_the_truth() -> None:
    with GraphFile(small_flat()) as file:
        assert condition(file, "on(object_6, object_5)")() is Status.SUCCESS
        assert condition(file, "on(object_6, object_7)")() is Status.FAILURE
        assert condition(file, "open(object_2)")() is Status.RUNNING  # nobody told
        assert condition(file, "open(object_2)", unknown=Status.FAILURE)() is Status.FAILURE
        with pytest.raises(ValueError, match="tabel"):
            condition(file, "on(cup, tabel)")()


def test_py_trees_ticks_it() -> None:
    with GraphFile(small_flat()) as file:
        tree = py_trees.composites.Selector("cup", memory=False)
        tree.add_children([Condition(file, "on(cup, bed)"), Condition(file, "on(cup, book)")])
        tree.tick_once()
        assert [child.status for child in tree.children] == [Status.FAILURE, Status.SUCCESS]
        assert tree.status is Status.SUCCESS


def test_a_plan_is_acted_step_by_step_while_it_holds() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("on(cup, bed)")
        done: list[str] = []
        pending = {str(step): 2 for step in plan}  # each step takes two ticks

        def act(step: Step) -> Status:
            pending[str(step)] -= 1
            if pending[str(step)]:
                return Status.RUNNING
            drive(file.graph, step)
            done.append(str(step))
            return Status.SUCCESS

        tree = plan_tree(file, plan, act)
        for _ in range(20):
            tree.tick_once()
            if tree.status is not Status.RUNNING:
                break
        assert tree.status is Status.SUCCESS
        assert done == [str(step) for step in plan]


def test_it_fails_at_the_step_that_cannot_be_taken_any_more_and_says_why() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("on(cup, bed)")

        def act(step: Step) -> Status:
            drive(file.graph, step)
            moved(file.graph, "object_6", "object_1")
            return Status.SUCCESS

        tree = plan_tree(file, plan, act)
        tree.tick_once()
        assert tree.status is Status.FAILURE
        failed = next(leaf for leaf in tree.iterate() if leaf.status is Status.FAILURE and not leaf.children)
        assert "object_1 (counter)" in failed.feedback_message
