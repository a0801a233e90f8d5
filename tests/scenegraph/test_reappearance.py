"""What has gone and what appears are one thing when they look alike: one to one, the best match, and not forever."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenegraph.graph import Box, Node
from scenegraph.perception.reappearance import MOST_REMEMBERED, WINDOW_S, Look, Reappearance

RED, BLUE = (200.0, 30.0, 30.0), (30.0, 30.0, 200.0)
CUP, BIG = (0.08, 0.08, 0.10), (0.3, 0.3, 0.4)


def node(name: str, label: str = "cup", at: float = 0.0, first: int = 0, last: int = 10) -> Node:
    box = Box(center=(at, 0.0, 0.5), size=CUP)
    return Node(
        id=name,
        layer="object",
        label=label,
        position=(at, 0.0, 0.5),
        box=box,
        first_seen_ns=first,
        last_seen_ns=max(first, last),
    )


@pytest.fixture
def known() -> Reappearance:
    found = Reappearance()
    found.leave(node("object_1"), Look(CUP, RED), 20)
    return found


@pytest.mark.parametrize(
    ("new", "look", "same"),
    [
        (node("object_9", at=3.0, first=15), Look(CUP, RED), True),
        (node("object_9", at=3.0, first=15), Look(CUP, None), True),
        (node("object_9", at=3.0, first=15), Look(CUP, BLUE), False),
        (node("object_9", at=3.0, first=15), Look(BIG, RED), False),
        (node("object_9", "bowl", at=3.0, first=15), Look(CUP, RED), False),
        (node("object_9", at=3.0, first=5), Look(CUP, RED), False),  # both were seen at one time: two things
    ],
)
def test_what_appears_is_what_has_gone_when_it_looks_the_same(known, new, look, same):
    one = known.who_is(new, look, 30)
    assert (one is not None and one.node.id == "object_1") == same


@given(st.permutations([RED, BLUE, (30.0, 200.0, 30.0)]))
def test_of_several_that_have_gone_the_best_match_comes_back(order):
    gone = Reappearance()
    for n, tint in enumerate(order):
        gone.leave(node(f"object_{n}"), Look(CUP, tint), 20)
    one = gone.who_is(node("object_9", first=15), Look(CUP, BLUE), 30)
    assert one is not None
    assert one.look.tint == BLUE


def test_of_those_alike_the_nearest_comes_back():
    gone = Reappearance()
    for n, at in enumerate((0.0, 4.0)):
        gone.leave(node(f"object_{n}", at=at), Look(CUP, RED), 20)
    one = gone.who_is(node("object_9", at=3.0, first=15), Look(CUP, RED), 30)
    assert one is not None
    assert one.node.id == "object_1"


def test_after_the_window_nothing_comes_back(known):
    assert known.who_is(node("object_9", first=15), Look(CUP, RED), 21 + round(WINDOW_S * 1e9)) is None


def test_a_thing_that_goes_is_the_newcomer_that_looks_like_it(known):
    gone = node("object_2")
    newcomers = [
        (node("object_7", first=15), Look(CUP, BLUE), []),
        (node("object_8", at=2.0, first=15), Look(CUP, RED), []),
        (node("object_9", at=1.0, first=5), Look(CUP, RED), []),
    ]
    now = known.where_is(gone, Look(CUP, RED), newcomers)
    assert now is not None
    assert now.id == "object_8"
    assert known.where_is(gone, Look(BIG, RED), newcomers) is None
    assert known.where_is(gone, Look(CUP, RED), []) is None


def test_while_it_may_rather_be_another_that_nobody_looked_for_time_has_to_tell(known):
    new, look = node("object_9", at=3.0, first=15), Look(CUP, RED)
    nearer = (node("object_3", at=2.5), Look(CUP, RED))
    unlike = (node("object_4", at=2.5), Look(BIG, BLUE))
    assert known.who_is(new, look, 30, [nearer]) is None
    assert known.who_is(new, look, 30, [unlike]) is not None
    gone = node("object_2")
    assert known.where_is(gone, Look(CUP, RED), [(new, look, [nearer])]) is None
    assert known.where_is(gone, Look(CUP, RED), [(new, look, [unlike])]) is new


@given(*[st.lists(st.floats(0.02, 2.0), min_size=3, max_size=3)] * 2)
def test_misfit_is_symmetric_and_nothing_differs_from_itself(a, b):
    one, other = Look(tuple(a), RED), Look(tuple(b), BLUE)
    assert one.misfit(other) == pytest.approx(other.misfit(one))
    assert one.misfit(one) == 0.0


def test_no_more_is_remembered_than_said():
    gone = Reappearance()
    for n in range(MOST_REMEMBERED + 5):
        gone.leave(node(f"object_{n}"), Look(CUP, RED), n)
    assert len(gone.absent) == MOST_REMEMBERED
    assert "object_0" not in gone.absent


def test_newcomers_are_news_for_a_while():
    found = Reappearance()
    found.arrive(node("object_1", first=0), 0)
    later = round(2 * WINDOW_S * 1e9)
    found.arrive(node("object_2", first=later, last=later), later)
    assert set(found.newcomers) == {"object_2"}


def test_what_is_remembered_outlives_a_restart(known):
    known.arrive(node("object_5"), 10)
    again = Reappearance()
    again.restore(json.loads(json.dumps(known.document())))
    assert again.absent["object_1"].look == known.absent["object_1"].look
    assert again.absent["object_1"].node == known.absent["object_1"].node
    assert again.newcomers == known.newcomers
    assert np.isclose(again.absent["object_1"].left_ns, 20)
