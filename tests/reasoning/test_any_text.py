"""Whatever text arrives as a goal or a phrase: a reply comes back, the facts stay, and nothing is wrongly true."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase

PUNCTUATION = r"""()[]{},;.|:!'"`\-+*/=<>@^~$#&%_"""
PIECES = [
    *PUNCTUATION,
    *["0", "1", "2.5", "X", "Y", "\n", "/*", "*/", "0'", "0x", "1e400", "1.0Inf", "1r3", "\\x0\\", "\0"],
    *[":-", "-->", "\\+", "->", "*->", "is", "=..", "\\=", "@<", "?-"],
    *["on", "in", "near", "cup", "table", "kitchen", "cup_1", "table_1", "oven", "on(X, Y)", "near(X, oven)", "room_1"],
    *["findall", "forall", "aggregate_all", "call", "halt", "assert", "facts", "position", "attribute", "X{a:1}.a"],
    *[
        "on(cup, table)",
        "true",
        "fail",
        "repeat",
        "between(1, 3, X)",
        "member(X, [1, 2])",
        "the",
        "what is on",
        "under",
    ],
]
goals = st.lists(st.sampled_from(PIECES), max_size=12).map(" ".join) | st.text(max_size=40)


@settings(max_examples=400, deadline=None)
@given(goal=goals)
def test_any_goal_gets_a_reply(home: KnowledgeBase, goal: str) -> None:
    known, restarts = len(home), home.engine.restarts
    reply = home.ask(goal, timeout_s=0.3, limit=5, explain=True)
    assert (reply.truth == "true") == bool(reply.answers)
    assert reply.truth != "false" or reply.problem is None
    if reply.problem is not None:
        assert reply.problem.code
        assert reply.problem.message
    assert len(reply.answers) <= 5
    assert home.engine.restarts == restarts
    assert len(home) == known
    assert home.ask("on(cup_1, table_1)").truth == "true"


@settings(max_examples=150, deadline=None)
@given(text=goals)
def test_any_phrase_gets_a_reply(home: KnowledgeBase, text: str) -> None:
    phrase = home.phrase(text)
    if phrase.problem is None:
        reply = home.ask(phrase.goal)
        assert reply.problem is None, (phrase, reply)
        assert phrase.variables
    else:
        assert phrase.problem.code == "not_understood"
