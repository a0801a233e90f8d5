"""Rules that anybody may tell: new words by those there are, and nothing besides."""

from __future__ import annotations

import os

import pytest

from reasoning import InvalidRules, KnowledgeBase

RULES = """
signature(stacked(thing), "it stands on something that stands on another").
stacked(X) :- on(X, Y), on(Y, _).

signature(over(thing, thing), "on it, or on what is over it").
over(X, Y) :- on(X, Y).
over(X, Y) :- on(X, Z), over(Z, Y).

signature(cosy(thing), "near an oven, and no tv").
cosy(X) :- near(X, oven), \\+ tv(X).
"""


@pytest.fixture
def taught(fresh: KnowledgeBase) -> KnowledgeBase:
    fresh.learn("mine", RULES)
    return fresh


@pytest.mark.parametrize(
    ("goal", "truth"),
    [
        ("stacked(mug_1)", "true"),
        ("stacked(chair_1)", "false"),
        ("over(mug, floor_1)", "true"),
        ("over(oven, mug)", "false"),
        ("cosy(cup)", "true"),
        ("cosy(tv_1)", "false"),
        ("cosy(chair_1)", "unknown"),
        ("\\+ cosy(chair_1)", "unknown"),
        ("\\+ cosy(tv_1)", "true"),
        ("forall(stacked(X), over(X, floor_1))", "true"),
        ("aggregate_all(count, over(_, table_1), 5)", "true"),
    ],
)
def test_a_told_word_has_its_truth_from_what_defines_it(taught: KnowledgeBase, goal: str, truth: str) -> None:
    reply = taught.ask(goal)
    assert reply.problem is None
    assert reply.truth == truth


def test_its_proof_goes_down_to_what_was_measured(taught: KnowledgeBase) -> None:
    why = taught.ask("over(mug_1, floor_1)", explain=True).explanation
    assert why is not None
    assert "by the rules mine" in why.text
    assert why.text.count("contact") == 3 * 2
    why_not = taught.ask("cosy(tv_1)", explain=True).explanation
    assert why_not is not None
    assert "path_gap_upper 8" in why_not.text


def test_words_are_known_replaced_and_forgotten(taught: KnowledgeBase) -> None:
    assert taught.rules["mine"]["stacked(thing)"] == "it stands on something that stands on another"
    assert "over(thing, thing)" in taught.vocabulary()
    taught.learn("mine", 'signature(stacked(thing), "").\nstacked(X) :- on(X, _).')
    assert taught.ask("stacked(chair_1)").truth == "true"
    assert taught.ask("over(X, Y)").problem is not None
    taught.unlearn("mine")
    assert taught.rules == {}
    assert taught.ask("stacked(X)").problem is not None
    with pytest.raises(InvalidRules, match="no rules called mine"):
        taught.unlearn("mine")


def test_what_others_use_is_not_taken_away(taught: KnowledgeBase) -> None:
    taught.learn("other", 'signature(high(thing), "").\nhigh(X) :- stacked(X), \\+ over(X, oven_1).')
    for change in (lambda: taught.unlearn("mine"), lambda: taught.learn("mine", "")):
        with pytest.raises(InvalidRules, match="is used by the rules other"):
            change()
    assert taught.ask("high(mug_1)").truth == "true"


def test_a_new_worker_is_told_them_again_in_any_order_of_use(taught: KnowledgeBase) -> None:
    taught.learn("other", 'signature(high(thing), "").\nhigh(X) :- stacked(X).')
    taught.learn("mine", RULES + 'signature(top(thing), "").\ntop(X) :- high(X), \\+ on(_, X).')
    before = taught.ask("top(X)")
    taught.update(forget=["chair_1"])
    assert taught.engine.pid is not None
    os.kill(taught.engine.pid, 9)
    assert taught.ask("top(X)") == before


@pytest.mark.parametrize(
    ("text", "code", "complaint"),
    [
        ("a(X) :- on(X, _).", "invalid_rules", "line 1: a/1 has no signature"),
        ('signature(a(thing), "").\n\na(X) :- on(X, Y).', "invalid_rules", "line 3: Y stands alone"),
        ('signature(a(thing), "").', "invalid_rules", "a/1 of the rules mine has a signature and no rule"),
        ('signature(a(banana), "").\na(_).', "invalid_rules", "line 1"),
        ('signature(a(thing), "").\na(X) :- near(X, ovn).', "unknown_name", "line 2: ovn"),
        ('signature(a(thing), "").\na(X) :- (', "syntax_error", "line 2"),
        ('signature(a(thing), "").\na(X) :- near(X).', "unknown_predicate", "near/1"),
        ('signature(a(thing), "").\na(X) :- shell(X).', "forbidden", "line 2: shell/1"),
        ('signature(a(thing), "").\na(X) :- on(X, _), halt.', "forbidden", "halt/0"),
        ('signature(a(thing), "").\na(X) :- facts:assertz(X).', "forbidden", "module"),
        ('signature(a(thing), "").\na(X) :- call(X).', "forbidden", "variable"),
        ('signature(a(thing), "").\na(X) :- findall(Y, assertz(Y), X).', "forbidden", "assertz/1"),
        ('signature(a(thing), "").\na(X) --> [X].', "forbidden", "grammars"),
        ('signature(on(thing, thing), "").\non(_, _).', "forbidden", "on/2 is a word already"),
        ('signature(near(thing), "").\nnear(_).', "forbidden", "near/1 is a word already"),
        ('signature(cup(thing), "").\ncup(X) :- mug(X).', "forbidden", "cup/1"),
        ('signature(member(any, any), "").\nmember(_, _).', "forbidden", "member/2"),
        ('signature(halt, "").\nhalt.', "invalid_rules", "not a signature"),
        ('signature(assertz(any), "").\nassertz(_).', "forbidden", "assertz/1"),
        ('signature((thing, thing), "").\n(_, _).', "forbidden", "word already"),
        ("on(a, b).", "forbidden", "on/2 is not these rules' own"),
        ("vocabulary:on(a, b).", "forbidden", "own"),
        ("facts:position(a, 0, 0, 0).", "forbidden", "own"),
        (":- initialization(halt).", "forbidden", "orders"),
        (":- override(contact_share(0.0)).", "forbidden", "orders"),
        ("?- halt.", "forbidden", "orders"),
        ("X.", "invalid_rules", "alone"),
        ("3.", "invalid_rules", "no head"),
        ("a(X) :- " + "on(X, X), " * 2_500 + "true.", "resource_limit", "20 000"),
        ('signature(a(number), "").\n' + "".join(f"a({n}).\n" for n in range(201)), "resource_limit", "200 clauses"),
    ],
)
def test_what_is_refused_says_why_and_where_and_changes_nothing(
    taught: KnowledgeBase, text: str, code: str, complaint: str
) -> None:
    before = taught.rules
    with pytest.raises(InvalidRules, match=complaint) as caught:
        taught.learn("mine", text)
    assert caught.value.code == code
    assert taught.rules == before
    assert taught.ask("stacked(mug_1)").truth == "true"
    assert taught.ask("over(mug, floor_1)").truth == "true"
