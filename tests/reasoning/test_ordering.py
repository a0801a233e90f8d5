"""The order in which the parts of a question are written changes how long it takes, never what is answered."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase
from reasoning.terms import term_text

PARTS = [
    "cup(X)", "table(Y)", "on(X, Y)", "near(X, oven)", "near(X, Y)", "in(X, kitchen)", "in(X, room_1)", "furniture(Y)",
    "on(X, table)", "supports(Y, X)", "near(chair_1, Y)", "contains(bowl_1, X)", "touching(X, Y)",
]  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(parts=st.lists(st.sampled_from(PARTS), min_size=2, max_size=4, unique=True).flatmap(
    lambda parts: st.tuples(st.just(parts), st.permutations(parts))
))  # fmt: skip
def test_any_order_has_the_same_answers(home: KnowledgeBase, parts: tuple[list[str], list[str]]) -> None:
    replies = [home.ask(", ".join(order), limit=10_000, timeout_s=10.0) for order in parts]
    assert replies[0].problem is replies[1].problem is None
    assert replies[0].truth == replies[1].truth
    rows = [
        {tuple(sorted((name, term_text(value)) for name, value in row.items())) for row in r.answers} for r in replies
    ]
    assert rows[0] == rows[1]
