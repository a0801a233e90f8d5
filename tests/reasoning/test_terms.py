"""Terms reach Prolog and come back as they were, whatever is in them."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning import Atom, Compound, InvalidTerm, KnowledgeBase, Term, Var
from reasoning.terms import decode_json, term_text

texts = st.text(st.characters(codec="utf-8"), max_size=20)
leaves = st.one_of(
    texts.map(Atom),
    texts,
    st.integers(),
    st.integers(-(10**40), 10**40),
    st.floats(allow_nan=False),
)
names = texts.filter(lambda name: name not in ("[]", "[|]"))
terms = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.builds(Compound, names, st.lists(inner, max_size=4).map(tuple)),
    ),
    max_leaves=12,
)


def echo(knowledge: KnowledgeBase, term: Term) -> Term:
    [answer] = knowledge.call(Compound("=", (Var("X"), term)))
    return answer["X"]


def same(a: Term, b: Term) -> bool:
    """Equality that tells 1 from 1.0 and 0.0 from -0.0."""
    if type(a) is not type(b):
        return False
    if isinstance(a, Compound) and isinstance(b, Compound):
        return a.name == b.name and len(a.args) == len(b.args) and all(map(same, a.args, b.args))
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return a == b and math.copysign(1, a) == math.copysign(1, b)
    return a == b


@settings(max_examples=300, deadline=None)
@given(term=terms)
def test_every_term_comes_back_as_it_was(home: KnowledgeBase, term: Term) -> None:
    assert same(echo(home, term), term)


@pytest.mark.parametrize(
    "term",
    [
        Atom("a"),
        "a",
        Atom("1"),
        "1",
        1,
        1.0,
        Atom("[]"),
        "[]",
        [],
        Atom(""),
        "",
        Atom('it\'s "quoted" \\ and `so`'),
        "line\nbreak\ttab\0nul\x7f",
        Atom("\0"),
        Atom("naïve 日本 🤖 \u2028"),
        10**400,
        -(10**400),
        7**6000,
        (1 << 63) - 1,
        1 << 63,
        -(1 << 63),
        -(1 << 63) - 1,
        1e308,
        5e-324,
        -0.0,
        1e22,
        math.inf,
        -math.inf,
        Fraction(1, 3),
        Compound("f", ()),
        Compound("-", (1,)),
        Compound("-", (Compound("-", (1,)),)),
        Compound(":-", (Atom("a"), Atom("halt"))),
        Compound("{}", (Atom("x"),)),
        [Atom("a"), "a", 1, [1.0, []]],
    ],
    ids=lambda _: "",
)
def test_atoms_strings_and_numbers_never_mix(home: KnowledgeBase, term: Term) -> None:
    assert same(echo(home, term), term)


def test_text_is_never_run(home: KnowledgeBase) -> None:
    evil = "'), halt, atom('"
    assert echo(home, evil) == evil
    assert echo(home, Atom(evil)) == Atom(evil)


def test_a_variable_stays_a_variable(home: KnowledgeBase) -> None:
    [answer] = home.call(Compound("=", (Var("X"), Compound("f", (Var("Y"), Var("Y"), Var("Z"))))))
    one, two, three = answer["X"].args  # type: ignore[union-attr]
    assert isinstance(one, Var)
    assert one == two != three


@pytest.mark.parametrize(
    "value", [math.nan, True, None, b"bytes", (1, 2), {"a": 1}, "\ud800", Atom("\udfff")], ids=repr
)
def test_what_has_no_prolog_counterpart_is_refused(value: object) -> None:
    with pytest.raises(InvalidTerm):
        term_text([value])  # type: ignore[list-item]


@pytest.mark.parametrize("name", ["x", "1X", "", "X Y", "É"])
def test_a_variable_needs_a_variable_name(name: str) -> None:
    with pytest.raises(InvalidTerm, match="not a variable name"):
        Var(name)


@pytest.mark.parametrize("text", ["null", "[1]", "[]", '{"x": 1}', '{"l": [null]}', "{", '{"a": 1, "b": 2}', "true"])
def test_json_that_is_no_term_is_refused(text: str) -> None:
    with pytest.raises(InvalidTerm):
        decode_json(text)


def test_a_term_nested_too_deep_is_a_problem_not_a_crash(fresh: KnowledgeBase) -> None:
    reply = fresh.ask("length(L, 300), " + "X = " + "f(" * 300 + "a" + ")" * 300)
    assert reply.problem is not None
    assert reply.problem.code == "resource_limit"
    assert fresh.ask("on(cup_1, table_1)").truth == "true"
