"""From goals about a graph to plans: what is chosen, what is told to the planner, what is said when there is none."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from reasoning.planning.unified import read_problem
from scenegraph.cli import app
from scenegraph.errors import GoalRefused
from scenegraph.exporting import export_pddl
from scenegraph.graph import Delta, Edge, GraphChanges, SceneGraph
from scenegraph.importing import GraphFile
from scenegraph.interop import export_graph
from scenegraph.planning import Plan
from tests.support.errands import large_home, small_flat


@pytest.fixture(scope="module")
def flat() -> Iterator[GraphFile]:
    with GraphFile(small_flat()) as file:
        yield file


@pytest.fixture(scope="module")
def large() -> Iterator[GraphFile]:
    with GraphFile(large_home(40, 1000)) as file:
        yield file


def told(plan: Plan) -> list[str]:
    return [str(step) for step in plan]


def final(plan: Plan) -> set[tuple[str, ...]]:
    """What holds after the plan, by what its steps say of themselves."""
    assert plan.task is not None
    state = set(plan.task.init)
    for action in plan.actions:
        assert not action.failing(state)
        action.apply(state)
    return state


def test_a_cup_is_brought_to_the_bed(flat: GraphFile) -> None:
    plan = flat.plan("on(cup, bed)")
    assert plan.status == "solved"
    assert plan.problem is None
    assert told(plan) == [
        "navigate(room_1, door_1)",
        "navigate(object_4)",
        "pick(object_6)",
        "navigate(room_2, door_1)",
        "navigate(object_7)",
        "place(object_6, object_7)",
    ]
    assert plan.rooms == ("room_2", "room_1", "room_2")
    assert "free(agent_rob)" in plan.steps[2].preconditions
    assert "on(object_6, object_7)" in plan.steps[-1].effects
    assert plan.validate() is None


@pytest.mark.parametrize(
    ("goal", "must_do"),
    [
        ("in(bottle, cabinet)", None),
        ("holding(bottle)", ["open(object_2)", "pick(object_3)"]),
        ("on(bottle, table), closed(fridge)", ["open(object_2)", "close(object_2)"]),
        ("on(book, bed)", ["pick(object_6)", "pick(object_5)"]),  # the cup on the book goes first
        ("in(apple, fridge)", ["open(object_2)", "place(object_10, object_2)"]),
        ("in(apple, kitchen)", ["pick(object_10)"]),
        ("poured(bottle, cup)", ["open(object_2)", "pick(object_3)", "pour(object_3, object_6)"]),
        ("\\+ on(cup, book)", ["pick(object_6)"]),
        ("near(robot, fridge)", ["navigate(object_2)"]),
        ("in(robot, kitchen)", ["navigate(room_1, door_1)"]),
        ("switched_on(fridge)", ["switch_on(object_2)"]),
        ("on(X, table), apple(X), on(Y, desk), cup(Y)", ["place(object_10, object_4)", "place(object_6, object_8)"]),
        ("forall(on(X, desk), on(X, bed))", ["place(object_9, object_7)"]),
    ],
)
def test_plans_do_what_they_must_and_are_valid(flat: GraphFile, goal: str, must_do: list[str] | None) -> None:
    plan = flat.plan(goal)
    if must_do is None:
        assert plan.status in ("unknown", "unsolvable")
        return
    assert plan.status == "solved", plan.problem
    assert plan.validate() is None
    assert set(must_do) <= set(told(plan))


def test_what_holds_already_needs_no_step(flat: GraphFile) -> None:
    plan = flat.plan("on(apple, plate)")
    assert (plan.status, len(plan)) == ("solved", 0)


def test_a_shut_door_is_opened_before_hands_are_full() -> None:
    with GraphFile(small_flat(shut=True)) as file:
        plan = file.plan("on(cup, bed)")
        steps = told(plan)
        assert steps.index("open(door_1)") < steps.index("pick(object_6)")
        assert plan.validate() is None


@pytest.mark.parametrize(
    ("goal", "status", "code", "words"),
    [
        ("on(cup, tabel)", "unknown", "unknown_name", "tabel"),
        ("fly(cup)", "unknown", "unknown_predicate", "fly/1"),
        ("on(cup", "unknown", "syntax_error", ""),
        ("cup(X)", "unknown", "not_a_plan_goal", "brought about"),
        ("on(cup, bed) ; on(cup, desk)", "unknown", "not_a_plan_goal", "conjunction"),
        ("on(X, bed)", "unknown", "unbound_variable", "say what it is"),
        ("on(banana, table)", "unknown", "none_known", "no banana is known"),
        ("on(X, bed), cup(X), attribute(X, color, red)", "unknown", "none_known", "attribute(X, color, red)"),
        ("on(sofa, bed)", "unknown", "none_known", "no sofa is known"),
        ("on(bed, desk)", "unsolvable", "impossible", "object_7 is a bed, which cannot be taken"),
        ("open(cup)", "unsolvable", "impossible", "cannot be opened"),
        ("in(fridge, cup)", "unsolvable", "impossible", "object_2 is a fridge"),
        ("in(plate, cup)", "unsolvable", "impossible", "is larger than"),
        ("switched_on(cup)", "unsolvable", "impossible", "cannot be switched"),
        ("on(cup, apple)", "unsolvable", "impossible", "nothing can be put on"),
        ("holding(cup), holding(apple)", "unsolvable", "no_plan", "no sequence"),
    ],
)
def test_where_there_is_no_plan_the_problem_says_why(
    flat: GraphFile, goal: str, status: str, code: str, words: str
) -> None:
    plan = flat.plan(goal)
    assert plan.problem is not None
    assert (plan.status, plan.problem.code) == (status, code), plan.problem
    assert words in plan.problem.message
    assert plan.steps == ()


def test_a_door_that_is_too_narrow_is_named() -> None:
    with GraphFile(small_flat(door_width=0.3)) as file:
        plan = file.plan("on(cup, bed)")
        assert plan.status == "unsolvable"
        assert plan.problem is not None
        assert "door_1 is 0.30 m wide" in plan.problem.message


def test_nobody_knows_where_the_robot_is() -> None:
    graph = small_flat()
    changes = GraphChanges()
    changes.delete_node("agent_rob", "gone")
    graph.commit(changes, 2)
    with GraphFile(graph) as file:
        plan = file.plan("on(cup, bed)")
        assert plan.status == "unknown"
        assert plan.problem is not None
        assert plan.problem.code == "robot_unknown"


LARGE_GOALS = (
    "on(cup, bed)",
    "in(apple, fridge), closed(fridge)",
    "on(book, desk), on(bottle, sofa)",
    "holding(plate), in(robot, room_39)",
    "on(cup, X), counter(X), in(X, room_33)",
    "in(object_20, room_39)",
    "\\+ on(cup, table), open(cabinet)",
    "poured(bottle, cup), in(robot, kitchen)",
    "near(robot, fridge), switched_on(fridge)",
    "on(apple, bed), on(cup, bed), on(book, bed), on(plate, bed), on(bowl, bed)",
)


@pytest.mark.parametrize("goal", LARGE_GOALS)
def test_plans_in_a_large_home_are_about_few_things_and_valid(large: GraphFile, goal: str) -> None:
    plan = large.plan(goal)
    assert plan.status == "solved", plan.problem
    assert plan.validate() is None
    assert plan.task is not None
    assert len(plan.task.objects) < 80


def test_far_goals_are_reached_room_by_room(large: GraphFile) -> None:
    plan = large.plan("in(robot, room_39)")
    doors = {frozenset(e.target for e in large.graph.edges("connects", source=d.id)) for d in large.graph.nodes()}
    assert plan.rooms[0] == "room_0"
    assert plan.rooms[-1] == "room_39"
    assert all(frozenset(pair) in doors for pair in zip(plan.rooms, plan.rooms[1:], strict=False))


def moved(graph: SceneGraph, thing: str, host: str, stamp_ns: int = 5_000_000_000) -> Delta:
    """Somebody puts a thing on another."""
    changes = GraphChanges()
    for edge in graph.edges("on", source=thing):
        changes.delete_edge("on", thing, edge.target)
        changes.delete_edge("supports", edge.target, thing)
    put = {"value": 1.0, "first_seen_ns": stamp_ns, "last_seen_ns": stamp_ns}
    changes.put(Edge(relation="on", source=thing, target=host, **put))
    changes.put(Edge(relation="supports", source=host, target=thing, **put))
    return graph.commit(changes, stamp_ns)


def test_a_plan_that_nothing_disturbs_holds_to_its_end(flat: GraphFile) -> None:
    for goal in ("on(cup, bed)", "on(book, bed), closed(fridge)", "in(apple, fridge)", "poured(bottle, cup)"):
        plan = flat.plan(goal)
        for done in range(len(plan) + 1):
            check = flat.verify(plan, done=done)
            if done == 0:
                assert check.holds, check.reasons
            assert len(check.checks) == len(plan) - done


def test_what_was_taken_away_is_told_with_where_it_is_now() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("on(cup, bed)")
        assert file.verify(plan)
        delta = moved(file.graph, "object_6", "object_1")
        assert plan.broken_by(delta)
        check = file.verify(plan)
        assert not check
        assert [c.step.action for c in check.checks if not c.holds] == ["pick"]
        assert "object_6 is no longer on object_5 (book): it is on object_1 (counter) since 5.0 s" in check.reasons
        again = file.plan(plan.goal)
        assert file.verify(again)
        assert "navigate(object_1)" in told(again)


def test_what_was_put_on_a_thing_that_shall_be_taken_is_told() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("on(plate, bed), on(apple, table)")
        assert file.verify(plan)
        delta = moved(file.graph, "object_6", "object_9")
        assert plan.broken_by(delta)
        assert any("object_6 is on object_9 (plate)" in reason for reason in file.verify(plan).reasons)


def test_a_change_elsewhere_is_none_of_the_plans_business() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("near(robot, fridge)")
        delta = moved(file.graph, "object_10", "object_7")
        assert plan.broken_by(delta) == ()
        assert file.verify(plan)


def test_what_is_gone_is_told() -> None:
    with GraphFile(small_flat()) as file:
        plan = file.plan("on(cup, bed)")
        changes = GraphChanges()
        changes.delete_node("object_6", "seen to be away")
        assert "object_6 is gone" in plan.broken_by(file.graph.commit(changes, 9))
        assert any(reason.startswith("object_6 is gone: seen to be away") for reason in file.verify(plan).reasons)


def test_the_files_of_a_goal_are_read_and_solved_by_others(tmp_path: Path) -> None:
    with GraphFile(small_flat()) as file:
        scoped, domain = export_pddl(file, "on(cup, bed)", tmp_path / "cup.pddl")
        whole, _ = export_pddl(file, "on(cup, bed)", tmp_path / "whole.pddl", scoped=False)
        assert domain.name == "cup_domain.pddl"
        problem = read_problem(domain.read_text(), scoped.read_text())
        assert [str(goal) for goal in problem.goals] == ["on(object_6, object_7)"]
        small, large = (len(read_problem(domain.read_text(), p.read_text()).all_objects) for p in (scoped, whole))
        assert small < large
        with pytest.raises(GoalRefused, match="no banana is known"):
            export_pddl(file, "on(banana, bed)", tmp_path / "none.pddl")


def run(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_the_command_line_plans(tmp_path: Path) -> None:
    path = export_graph(small_flat(), "json", tmp_path / "flat.json")
    found = run("plan", "on(cup, bed)", "--map", path, "--json")
    assert found.exit_code == 0, found.output
    document = json.loads(found.stdout)
    assert document["status"] == "solved"
    assert [step["action"] for step in document["steps"]][-1] == "place"
    assert set(document["steps"][0]["target"]) == {"translation", "rotation_wxyz"}
    assert run("plan", "on(banana, bed)", "--map", path).exit_code == 1
    assert run("plan", "on(bed, cup)", "--map", path).exit_code == 1
    misspelt = run("plan", "on(cup, tabel)", "--map", path)
    assert misspelt.exit_code == 2
    assert "did you mean" in " ".join(misspelt.stderr.split())
    assert "solved" in run("plan", "on(cup, bed)", "--map", path).stdout
    told = run("export", "--format", "pddl", "--goal", "on(cup, bed)", "--output", tmp_path / "x.pddl", "--map", path)
    assert told.exit_code == 0, told.output
    assert (tmp_path / "x_domain.pddl").read_text().startswith(";")
    assert run("export", "--format", "pddl", "--output", tmp_path / "x.pddl", "--map", path).exit_code == 2
