"""A watch's answers are those of asking anew, after whatever change; what came and went adds up to them."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mapping.observations import LabelSpace
from reasoning import Compound, KnowledgeBase, Reply
from reasoning import watching as asking
from reasoning.terms import term_text
from scenegraph import watching
from scenegraph.answers import Answers
from scenegraph.errors import GoalRefused
from scenegraph.graph import Node
from scenegraph.watching import AnswerChange, Watch, Watches, _Sought
from scenegraph.world import World
from tests.reasoning.homes import fact, pair, small_home


def rows(reply: Reply) -> set[tuple[tuple[str, str], ...]]:
    return {
        tuple((name, re.sub(r"\b_[0-9G]\w*", "_", term_text(term))) for name, term in row.items())
        for row in reply.answers
    }


def plain(row: dict[str, Any]) -> str:
    return re.sub(r"\b_[0-9G]\w*", "_", str(row))


def state(reply: Reply) -> tuple[Any, ...]:
    return rows(reply), reply.truth, reply.truncated, reply.problem


class Desk:
    """A knowledge base with watches, and no graph."""

    def __init__(self, knowledge: KnowledgeBase) -> None:
        self.knowledge = knowledge
        self.revision = 0
        self.watches = Watches(
            knowledge,
            ask=lambda asked: self.answers(knowledge.ask(asked.goal, limit=asked.limit, timeout_s=asked.timeout_s)),
            answers=self.answers,
            stamp=lambda: self.revision,
            on_demand=lambda goal: "visible_from" in goal,
        )

    def answers(self, reply: Reply) -> Answers:
        return Answers(reply, self.revision, {})

    def watch(self, goal: str, on_change: Any = None, limit: int = 100) -> Watch:
        return self.watches.add(goal, None, limit, 10.0, on_change)

    def change(self, **how: Any) -> None:
        self.revision += 1
        self.knowledge.update(**how)
        self.watches.refresh()


@pytest.fixture(scope="module")
def knowledge() -> Iterator[KnowledgeBase]:
    with KnowledgeBase() as base:
        yield base


@pytest.fixture
def desk(knowledge: KnowledgeBase) -> Iterator[Desk]:
    knowledge.update(forget=IDS)
    knowledge.update(put=small_home())
    yield Desk(knowledge)
    for number in list(knowledge.watching._questions):
        knowledge.watching.remove(number)


THINGS = ["cup_1", "mug_1", "book_1", "bowl_1", "table_1", "chair_1", "oven_1", "sofa_1"]
ROOMS = ["room_1", "room_2"]
IDS = [*THINGS, *ROOMS, "tv_1", "apple_1", "door_1", "floor_1", "new_1"]

things = st.sampled_from(THINGS)
pairs = st.tuples(things, things).filter(lambda pair: pair[0] != pair[1])
metres = st.sampled_from([0.0, 0.02, 0.3, 0.6, 1.4, 1.6, 8.0, 1e9])
shares = st.sampled_from([0.0, 0.1, 0.25, 0.6, 1.0])


@st.composite
def facts_about(draw: Any) -> Compound:
    kind = draw(st.integers(0, 11))
    a, b = draw(pairs)
    match kind:
        case 0:
            return fact("measured", "contact", a, b, draw(shares))
        case 1:
            return fact(
                "measured", draw(st.sampled_from(["path_gap_upper", "path_gap_lower"])), *sorted((a, b)), draw(metres)
            )
        case 2:
            return fact("measured", "gap", *sorted((a, b)), draw(metres))
        case 3:
            return fact("measured", "footprint_share", a, draw(st.sampled_from(ROOMS)), draw(shares))
        case 4:
            return fact("label", a, draw(st.sampled_from(["cup", "mug", "table", "oven", "bed", "chair"])))
        case 5:
            return fact(
                "attribute", a, draw(st.sampled_from(["color", "name_of"])), draw(st.sampled_from(["red", "blue"]))
            )
        case 6:
            return fact("position", a, *(draw(st.sampled_from([0.0, 1.0, 5.0])) for _ in range(3)))
        case 7:
            return fact("size", a, *(draw(st.sampled_from([0.1, 0.5, 2.0])) for _ in range(3)))
        case 8:
            return fact("name", draw(st.sampled_from(ROOMS)), draw(st.sampled_from(["=den", "=Guest room"])))
        case 9:
            return fact("edge", draw(st.sampled_from(["on", "near", "connects"])), a, b, 1.0, 0.5, 1.0)
        case 10:
            return fact("told", draw(st.sampled_from(["lamp_broken", "visitor_here"])))
        case _:
            return fact("node", "new_1", draw(st.sampled_from(["object", "room"])))


changes = st.fixed_dictionaries(
    {
        "put": st.lists(facts_about(), max_size=4),
        "deleted": st.lists(facts_about(), max_size=2),
        "forget": st.lists(things, max_size=1),
    }
)

GOALS = [
    "near(X, oven)",
    "near(X, Y)",
    "on(X, table), near(X, oven)",
    "on(cup, X)",
    "on(cup_1, table_1)",
    "\\+ near(X, sofa)",
    "forall(cup(X), on(X, table))",
    "aggregate_all(count, on(_, table), N)",
    "findall(X, near(X, oven), L)",
    "in(X, kitchen)",
    "room_type(R, T)",
    "instance_of(X, furniture)",
    "attribute(X, color, red)",
    "gap(cup_1, X, G), G < 0.5",
    "next_to(X, Y)",
    "larger(X, oven)",
    "left_of(X, oven_1)",
    "fact(X)",
    "leads_to(R, S)",
    "(cup(X) -> near(X, Y) ; on(Y, table))",
    "measured(gap, X, Y, V)",
    "limit(1, on(X, table))",
    "order_by([desc(S)], (object(X), size(X, S, _, _)))",
    "touching(X, cup)",
    "named(X, N)",
    "node(X, room)",
]


def at_most(desk: Desk, much: int) -> None:
    """Ask goals that look up more than that for a few things at a time."""
    desk.knowledge.call(f"retractall(watching:much(_)), assertz(watching:much({much}))")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    goals=st.lists(st.sampled_from(GOALS), min_size=3, max_size=10, unique=True),
    story=st.lists(changes, max_size=6),
    few=st.sampled_from([1, 2, 16]),
    much=st.sampled_from([0, 0, 1000]),
    limit=st.sampled_from([100, 3]),
)
def test_a_watch_answers_as_asking_anew_does(
    desk: Desk, goals: list[str], story: list[dict[str, Any]], much: int, limit: int, few: int
) -> None:
    """Also where goals that look up more than `much` are asked for a few things at a time."""
    at_most(desk, much)
    asking.AT_A_TIME = few
    desk.knowledge.update(forget=IDS, deleted=[fact("told", "lamp_broken"), fact("told", "visitor_here")])
    desk.knowledge.update(put=small_home())
    watches = [desk.watch(goal, limit=limit) for goal in goals]
    told: list[set[Any]] = [set() for _ in goals]
    try:
        for change in [{}, *story]:
            desk.change(**change)
            for known, watch in zip(told, watches, strict=True):
                asked = desk.knowledge.ask(watch.goal, timeout_s=10.0, limit=limit)
                assert state(watch.answers.reply) == state(asked), watch.goal
                for one in watch:
                    came, went = ({plain(row) for row in side} for side in (one.came, one.went))
                    assert came.isdisjoint(known)
                    assert went <= known
                    known -= went
                    known |= came
                if asked.problem is None:
                    assert known == {plain(row) for row in watch.answers}
    finally:
        asking.AT_A_TIME = 16
        at_most(desk, 1000)
        for watch in watches:
            watch.close()
    assert not len(desk.watches)
    assert not len(desk.knowledge.watching)
    assert not desk.knowledge.watching._reads._by_name, "what was read is forgotten with the watch"


@pytest.mark.parametrize("goal", ["near(dragon, X)", "near(X,", "shell(X)", "near(X)", "Table", "repeat, fail"])
def test_a_goal_that_cannot_be_asked_is_refused_with_the_problem_that_asking_it_has(desk: Desk, goal: str) -> None:
    problem = desk.knowledge.ask(goal, timeout_s=0.2).problem
    assert problem is not None
    with pytest.raises(GoalRefused) as refused:
        desk.watches.add(goal, None, 100, 0.2, None)
    assert (refused.value.code, refused.value.message, refused.value.hint) == (
        problem.code, problem.message, problem.hint,
    )  # fmt: skip
    assert not len(desk.watches)
    assert not len(desk.knowledge.watching)


def test_the_first_change_tells_what_there_is_and_each_next_what_came_and_went(desk: Desk) -> None:
    with desk.watch("near(X, oven)") as changes:
        [first] = changes
        assert ({row["X"] for row in first.came}, first.went, first.truth) == ({"cup_1", "table_1"}, (), "true")
        desk.change(put=[fact("measured", "path_gap_upper", "mug_1", "oven_1", 3.0)])
        assert changes.poll() == [], "too far, as before"
        desk.change(put=[fact("measured", "path_gap_upper", "cup_1", "oven_1", 3.0)])
        [second] = changes
        assert [row["X"] for row in second.went] == ["cup_1"]
        assert second.came == ()
        assert second.revision == second.stamp_ns == 2
        assert second.truth == "true"


def test_a_truth_that_changes_without_an_answer_is_a_change(desk: Desk) -> None:
    with desk.watch("near(mug_1, sofa_1)") as changes:
        assert [change.truth for change in changes] == ["false"]
        desk.change(put=[fact("measured", "path_gap_upper", "mug_1", "sofa_1", 1e9)])
        assert [(change.truth, change.came, change.went) for change in changes] == [("unknown", (), ())]


def test_a_problem_is_told_and_is_no_empty_answer(desk: Desk) -> None:
    with desk.watch("on(X, table_1)") as changes:
        [first] = changes
        assert len(first.came) == 3
        table = [f for f in small_home() if "table_1" in term_text(f)]
        desk.change(forget=["table_1"])
        [trouble] = changes
        assert trouble.problem is not None
        assert trouble.problem.code == "unknown_name"
        assert (trouble.truth, trouble.came, trouble.went) == ("unknown", (), ())
        desk.change(put=[f for f in table if "cup_1" not in term_text(f)])
        [again] = changes
        assert again.problem is None
        assert (again.came, [row["X"] for row in again.went]) == ((), ["cup_1"]), "against what was known before"


def test_a_goal_is_asked_again_only_when_what_it_read_changed(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    settle = desk.knowledge.watching._settle
    monkeypatch.setattr(desk.knowledge.watching, "_settle", lambda n, *rest: asked.append(n) or settle(n, *rest))
    with desk.watch("near(X, oven)"), desk.watch("on(X, table)"):
        asked.clear()
        desk.change(put=[fact("seen", "cup_1", 1_000, 3_000), fact("position", "oven_1", 0.0, 0.1, 0.45)])
        desk.change(put=[fact("label", "sofa_1", "armchair"), fact("measured", "gap", "chair_1", "oven_1", 0.4)])
        desk.change(put=[fact("measured", "contact", "tv_1", "sofa_1", 0.4)])
        assert asked == [], "sight, places, labels elsewhere, other measurements, other things"
        desk.change(put=[fact("measured", "path_gap_upper", "chair_1", "oven_1", 0.2)])
        assert len(asked) == 1
        asked.clear()
        desk.change(put=[fact("measured", "contact", "cup_1", "table_1", 0.1)])
        assert len(asked) == 1


def test_what_was_worked_out_for_another_goal_hides_nothing(desk: Desk) -> None:
    desk.knowledge.ask("room_type(room_1, T)")
    with desk.watch("room_type(room_1, T)"), desk.watch("instance_of(X, kitchen)") as things:
        things.poll()
        desk.change(put=[fact("label", "oven_1", "chair")])
        [change] = things
        assert [row["X"] for row in change.went] == ["room_1"], "without its oven it is no kitchen"


def test_a_goal_about_many_things_is_asked_again_of_those_that_changed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    knowledge, asked = desk.knowledge, list[Any]()
    at_most(desk, 0)
    monkeypatch.setattr(asking, "AT_A_TIME", 1)
    with desk.watch("near(cup, X)") as changes:
        desk.change(put=[fact("measured", "path_gap_upper", "cup_1", "oven_1", 0.35)])
        at_most(desk, 1000)
        settle, questions = knowledge.watching._settle, knowledge.watching._questions
        monkeypatch.setattr(
            knowledge.watching, "_settle", lambda n, *rest: asked.append(questions[n].pin) or settle(n, *rest)
        )
        [first] = changes
        assert {row["X"] for row in first.came} == {"oven_1", "mug_1", "cup_1", "book_1"}, "a mug is a cup"
        desk.change(put=pair("mug_1", "sofa_1", 0.2))
        assert asked == [("mug_1",)]
        assert [{row["X"] for row in change.came} for change in changes] == [{"sofa_1"}]
        desk.change(put=[fact("label", "bowl_1", "cup"), *pair("bowl_1", "chair_1", 0.1)])
        assert [{row["X"] for row in change.came} for change in changes] == [{"chair_1"}]
        desk.change(forget=["mug_1"])
        assert [{row["X"] for row in change.went} for change in changes] == [{"sofa_1", "book_1", "cup_1", "mug_1"}]
        assert state(changes.answers.reply) == state(knowledge.ask("near(cup, X)"))
        desk.change(put=[fact("label", thing, "chair") for thing in ("cup_1", "bowl_1")])
        assert [change.truth for change in changes] == ["false"]
        assert state(changes.answers.reply) == state(knowledge.ask("near(cup, X)"))
    assert not len(knowledge.watching)
    assert not knowledge.watching._questions
    assert not knowledge.watching._reads._by_name


def test_equal_goals_are_asked_once(desk: Desk) -> None:
    first, second = desk.watch("near(X, oven)"), desk.watch("near(X, oven)")
    assert (len(desk.watches), len(desk.knowledge.watching)) == (2, 1)
    first.close()
    desk.change(forget=["oven_1"])
    assert [change.truth for change in second] == ["true", "false"]
    assert [change.truth for change in first] == ["true"]
    second.close()
    second.close()
    assert not len(desk.knowledge.watching)


def test_a_function_that_fails_does_not_keep_others_from_being_told(desk: Desk) -> None:
    told: list[AnswerChange] = []

    def fail(change: AnswerChange) -> None:
        raise ZeroDivisionError

    with desk.watch("near(X, oven)", fail), desk.watch("near(X, oven)", told.append):
        desk.change(forget=["oven_1"])
    assert [change.truth for change in told] == ["true", "false"]


def test_a_goal_that_needs_measuring_is_asked_after_every_change(desk: Desk) -> None:
    desk.knowledge.update(put=[fact("node", "agent_r", "agent"), fact("position", "agent_r", 0.0, 0.0, 0.0)])
    with desk.watch("visible_from(X, agent_r)") as changes:
        desk.knowledge.update(put=[fact("measured", "visible", "cup_1", "agent_r", 1.0)])
        desk.change()
        assert [len(change.came) for change in changes] == [0, 1]


def test_a_goal_that_was_broken_off_is_asked_again_after_a_rest(desk: Desk) -> None:
    goal = "(fact(lamp_broken) -> repeat, fail ; near(X, oven))"
    watch = desk.watches.add(goal, None, 100, 0.5, None)
    desk.change(put=[fact("told", "lamp_broken")])
    assert watch.answers.problem is not None
    assert watch.answers.problem.code == "timeout"
    desk.knowledge.update(deleted=[fact("told", "lamp_broken")])
    desk.watches.refresh(resting=False)
    assert watch.answers.problem is not None, "it rests"
    desk.watches.refresh()
    assert watch.answers.truth == "true"
    watch.close()


def test_a_watch_survives_the_loss_of_the_engine(desk: Desk) -> None:
    with desk.watch("near(X, oven)") as changes, desk.watch("on(X, table)") as others:
        pid = desk.knowledge.engine.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        desk.change(forget=["oven_1", "table_1"])
        assert [change.truth for change in changes] == ["true", "false"]
        assert [change.truth for change in others] == ["true", "false"]


@given(steps=st.lists(st.sets(st.integers(0, 5)), min_size=3, max_size=12), most=st.integers(2, 4))
def test_changes_that_nobody_reads_are_joined_and_still_add_up(steps: list[set[int]], most: int) -> None:
    watch = Watch(_Sought("x", None, 100, 1.0), lambda _: None, None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watching, "MOST_WAITING", most)
        for n, step in enumerate(steps):
            watch.take(Answers(Reply("true", tuple({"N": i} for i in step)), n, {}), n)
    known: set[int] = set()
    assert len(watch._waiting) <= most
    for change in watch:
        assert not known & {row["N"] for row in change.came}
        known = (known - {row["N"] for row in change.went}) | {row["N"] for row in change.came}
    assert known == steps[-1]


def test_a_world_tells_its_watches_after_everything_it_takes_in() -> None:
    with World() as world, world.watch("fact(X)") as changes:
        [first] = changes
        assert (first.truth, first.came) == ("false", ())
        world.tell("fact(visitor_here)", author="ann")
        [second] = changes
        assert [row["X"] for row in second.came] == ["visitor_here"]
        assert second.revision == world.graph.revision
        world.tell("retract(visitor_here)", author="ann")
        assert [row["X"] for change in changes for row in change.went] == ["visitor_here"]
        spaces: list[AnswerChange] = []
        with world.watch("subclass(X, cup)", on_change=spaces.append):
            classes = {1: {"name": "espresso cup", "kind": "thing", "parent": "cup"}}
            world.integrate(LabelSpace(classes=classes))
        assert [row["X"] for row in spaces[-1].came] == ["espresso_cup"]
    assert not len(world.watches)


def test_watches_of_a_mapped_home_answer_as_asking_does(copy_home: Callable[[], World]) -> None:
    world = copy_home()
    goals = ["near(X, table)", "on(X, table)", "object(X)", "in(X, R)", "aggregate_all(count, object(X), N)"]
    watches = [world.watch(goal, timeout_s=10.0) for goal in goals]
    deleted = [node.id for node in world.graph.nodes("object")][::3]
    for thing in deleted:
        world.tell(f"delete({thing})", author="ann")
        for watch in watches:
            asked = world.ask(watch.goal, timeout_s=10.0)
            assert state(watch.answers.reply) == state(asked.reply)
            assert watch.answers.revision <= world.graph.revision
    gone = {row["X"].id if isinstance(row["X"], Node) else row["X"] for c in watches[2] for row in c.went}
    assert gone == set(deleted)


def test_every_fact_that_changes_is_noted_when_it_is_read(knowledge: KnowledgeBase) -> None:
    kept = knowledge.call("predicate_property(facts:H, dynamic), \\+ predicate_property(facts:H, imported_from(_)), "
                          "functor(H, Name, Arity)")  # fmt: skip
    noted = knowledge.call("watching:names_in(H, _), functor(H, Name, Arity)")
    names = [
        {(str(row["Name"]), row["Arity"]) for row in rows if not str(row["Name"]).startswith("$wrap$")}
        for rows in (kept, noted)
    ]
    assert names[0] ^ names[1] == {("current_revision", 1)}
