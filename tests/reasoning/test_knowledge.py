"""Facts are kept by key, in the engine as in the memory that a new one is told from; and the Python face of it all."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reasoning
from reasoning import Atom, Compound, GoalFailed, InvalidFact, InvalidTerm, KnowledgeBase, Var
from reasoning.facts import FACTS, FactStore
from reasoning.terms import term_text
from rules import rule_path
from tests.reasoning.homes import fact, small_home

ids = st.sampled_from(["a", "b", "c"])
numbers = st.sampled_from([0, 1, 0.5])
some_facts = st.one_of(
    st.builds(lambda a: fact("node", a, "object"), ids),
    st.builds(lambda a, k, v: fact("attribute", a, k, v), ids, st.sampled_from(["color", "size"]), numbers),
    st.builds(lambda a, v: fact("measured", "lowest", a, v), ids, numbers),
    st.builds(lambda a, b, v: fact("measured", "gap", a, b, v), ids, ids, numbers),
    st.builds(lambda a, b, v: fact("measured", "contact", a, b, v), ids, ids, numbers),
    st.builds(lambda a, b, v: fact("edge", "part_of", a, b, v, 0, 1), ids, ids, numbers),
    st.builds(lambda v: fact("told", fact("weight", v)), numbers),
    st.builds(lambda v: fact("parameter", "voxel_size_m", v), numbers),
)
changes = st.tuples(st.lists(some_facts, max_size=6), st.lists(some_facts, max_size=2), st.lists(ids, max_size=1))


def everything(knowledge: KnowledgeBase) -> list[str]:
    """All facts in the engine, in the form in which they are told."""
    goals = {
        "node(A, B)": "node(A, B)",
        "attribute(A, B, C)": "attribute(A, B, C)",
        "measured(A, B, C)": "measured(A, B, C)",
        "measured(A, B, C, D)": "measured(A, B, C, D)",
        "edge(A, B, C, D, E, F)": "edge(A, B, C, D, E, F)",
        "told(A)": "told(A)",
        "parameter(A, B)": "parameter(A, B)",
    }
    return sorted(
        term_text(row["T"]) for goal, template in goals.items() for row in knowledge.call(f"T = {template}, {goal}")
    )


def remembered(knowledge: KnowledgeBase) -> list[str]:
    text = knowledge._facts.text()
    return sorted(line.removeprefix("add(").removesuffix(").") for line in text.splitlines())


@settings(max_examples=60, deadline=None)
@given(history=st.lists(changes, max_size=4))
def test_memory_and_engine_agree_after_any_changes(empty: KnowledgeBase, history: list[Any]) -> None:
    for put, deleted, forget in history:
        empty.update(put, deleted, forget)
        assert everything(empty) == remembered(empty)
        assert len(empty) == len(remembered(empty))


@pytest.fixture(scope="module")
def empty() -> Any:
    with KnowledgeBase() as knowledge:
        yield knowledge


def test_a_new_engine_is_told_the_same(fresh: KnowledgeBase) -> None:
    before = everything(fresh)
    assert fresh.engine.pid is not None
    os.kill(fresh.engine.pid, 9)
    assert everything(fresh) == before


def test_a_worker_that_dies_before_it_is_told_learns_each_fact_once(fresh: KnowledgeBase) -> None:
    assert fresh.engine.pid is not None
    os.kill(fresh.engine.pid, 9)
    fresh.update([fact("measured", "contact", "bowl_1", "book_1", 0.5)])
    told = [line for line in everything(fresh) if line.startswith("measured(contact,bowl_1")]
    assert sorted(told) == ["measured(contact,bowl_1,book_1,0.5)", "measured(contact,bowl_1,table_1,1.0)"]


def test_threads_that_tell_and_ask_agree_in_the_end(fresh: KnowledgeBase) -> None:
    def tell(name: str) -> None:
        for number in range(12):
            fresh.update([fact("attribute", name, "count", number)])
            if number == 5 and fresh.engine.pid is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(fresh.engine.pid, 9)
            fresh.ask("on(cup_1, table_1)")

    threads = [threading.Thread(target=tell, args=(name,)) for name in ("a", "b", "c")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    told = [line for line in everything(fresh) if "count" in line]
    assert told == [f"attribute({name},count,11)" for name in ("a", "b", "c")]


def test_unchanged_facts_are_not_sent_again() -> None:
    store = FactStore()
    facts = [fact("position", "a", 1.0, 2.0, 3.0)]
    assert store.change(facts, (), ()) == "add(position(a,1.0,2.0,3.0))."
    assert store.change(facts, (), ()) == ""
    assert store.change([fact("position", "a", 1.0, 2.0, 4.0)], (), ()) == "put(position(a,1.0,2.0,4.0))."


def test_a_variable_in_what_is_deleted_matches_anything(fresh: KnowledgeBase) -> None:
    fresh.update(deleted=[Compound("measured", (Atom("contact"), Var("_"), Atom("table_1"), Var("_")))])
    assert fresh.ask("on(X, table)").truth == "false"
    assert fresh.ask("on(X, book)").truth == "true"
    assert everything(fresh) == sorted(
        line
        for line in remembered(fresh)
        if line.split("(")[0] in {"node", "attribute", "measured", "edge", "told", "parameter"}
    )


def test_an_attributes_plain_text_can_be_asked_for_as_a_name(fresh: KnowledgeBase) -> None:
    fresh.update(
        [fact("attribute", "sofa_1", "color", "=green"), fact("attribute", "tv_1", "note", "=Ada's, do not touch")]
    )
    assert fresh.ask("attribute(X, color, green)").answers == ({"X": Atom("sofa_1")},)
    assert fresh.ask("attribute(tv_1, note, X)").answers == ({"X": "Ada's, do not touch"},)
    assert fresh.phrase("the green sofa").problem is None


def test_a_symmetric_measurement_has_no_direction(fresh: KnowledgeBase) -> None:
    fresh.update([fact("measured", "gap", "table_1", "apple_1", 0.01)])
    assert fresh.ask("touching(apple_1, table_1)").truth == "true"
    fresh.update([fact("measured", "gap", "apple_1", "table_1", 0.5)])
    assert fresh.ask("touching(table_1, apple_1)").truth == "false"


def test_a_refused_change_changes_nothing(fresh: KnowledgeBase) -> None:
    before = everything(fresh)
    for bad in (
        fact("nonsense", "x"),
        fact("node", float("nan"), "object"),
        Compound("node", (Var("X"), Atom("object"))),
    ):
        with pytest.raises((InvalidFact, InvalidTerm)):
            fresh.update([fact("node", "new_1", "object"), bad], forget=["cup_1"])
    assert (
        everything(fresh)
        == before
        == sorted(line for line in remembered(fresh) if line.split("(")[0] in {"node", "attribute", "measured", "edge"})
    )


def test_every_documented_fact_can_be_told(empty: KnowledgeBase) -> None:
    for name, arity in FACTS:
        empty.update([Compound(name, tuple([Atom(f"x{i}") for i in range(arity)]))])
    assert {line.split("(")[0] for line in remembered(empty)} >= {name for name, _ in FACTS}
    empty.update(deleted=[Compound(name, tuple([Atom(f"x{i}") for i in range(arity)])) for name, arity in FACTS])


def test_a_trusted_call_runs_any_rule(home: KnowledgeBase) -> None:
    [answer] = home.call(Compound("near_distance", (Atom("cup_1"), Atom("oven_1"), Var("D"))))
    assert answer == {"D": 0.5}
    assert home.call("fail") == []
    assert len(home.call("between(1, 10, X)", limit=3)) == 3


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ("X is foo + 1", "bad_argument"),
        ("no_such_predicate(X)", "goal_error"),
        ("on(", "syntax_error"),
        ("repeat, fail", "timeout"),
    ],
)
def test_a_trusted_call_that_goes_wrong_raises(home: KnowledgeBase, goal: str, code: str) -> None:
    with pytest.raises(GoalFailed) as caught:
        home.call(goal, timeout_s=0.1)
    assert caught.value.code == code


def test_the_vocabulary_can_be_listed(home: KnowledgeBase) -> None:
    words = home.vocabulary()
    assert words["near(thing, thing)"] == "a short way apart, around walls"
    assert len(words) > 40


@pytest.mark.parametrize(
    ("text", "kind", "relation"),
    [
        ("near the oven", "place", "near"),
        ("the red cup on the table", "thing", None),
        ("in the kitchen", "place", "in"),
    ],
)
def test_a_phrase_becomes_a_goal_that_can_be_asked(
    home: KnowledgeBase, text: str, kind: str, relation: str | None
) -> None:
    phrase = home.phrase(text)
    assert (phrase.kind, phrase.relation, phrase.problem) == (kind, relation, None)
    reply = home.ask(phrase.goal)
    assert reply.truth == "true"
    assert all(set(answer) == {*phrase.variables, *phrase.definite} for answer in reply.answers)


def test_a_phrase_says_which_word_it_did_not_understand(home: KnowledgeBase) -> None:
    problem = home.phrase("near the ovven").problem
    assert problem is not None
    assert problem.code == "not_understood"
    assert "ovven" in problem.message
    assert "oven" in (problem.hint or "")


def test_several_threads_may_ask_at_once(home: KnowledgeBase) -> None:
    wrong: list[object] = []

    def ask(number: int) -> None:
        for _ in range(20):
            reply = home.ask(f"X = {number}, on(cup_1, table_1)")
            if reply.answers != ({"X": number},):
                wrong.append(reply)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_exported_names_exist() -> None:
    assert all(hasattr(reasoning, name) for name in reasoning.__all__)
    assert sorted(reasoning.__all__) == reasoning.__all__


def test_the_rules_travel_with_the_package() -> None:
    modules = {path.stem for path in rule_path().glob("*.pl")}
    assert modules >= {"vocabulary", "taxonomy", "spatial", "rooms", "language", "explain", "structure", "facts"}
    assert rule_path("spatial").is_file()


@pytest.mark.parametrize("path", sorted(rule_path().glob("*.pl")), ids=lambda path: path.stem)
def test_every_exported_predicate_is_documented(path: Path) -> None:
    """With its modes and determinism, or as a word of the vocabulary with its kinds of arguments."""
    text = path.read_text()
    exports = re.findall(r"([a-z][a-z_]*)//?\d", text[: text.index("]).")])
    facts = rule_path("facts").read_text()
    missing = [
        name
        for name in exports
        if not re.search(rf"^%!  {name}(\(.*\))?(//)? is ", text, re.MULTILINE)
        and f"signature({name}(" not in text
        and not (path.stem == "vocabulary" and f"%!  {name}(" in facts)
    ]
    assert exports
    assert missing == []


def test_facts_are_told_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reasoning.engine._BATCH_CHARACTERS", 200)
    with KnowledgeBase() as knowledge:
        knowledge.update(small_home())
        known = len(knowledge.call("facts:node(X, L)")), knowledge.ask("on(X, Y)").answers
        assert known[0] == len([fact for fact in small_home() if fact.name == "node"])
        assert knowledge.engine.pid is not None
        os.kill(knowledge.engine.pid, 9)
        assert (len(knowledge.call("facts:node(X, L)")), knowledge.ask("on(X, Y)").answers) == known
