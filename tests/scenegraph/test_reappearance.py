"""What has gone and what appears are one thing when they look alike: one to one, all at once, and not forever."""

from __future__ import annotations

import json
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.colors import no_colors
from scenegraph.graph import Box, Node
from scenegraph.perception.reappearance import (
    COMMON,
    ELSEWHERE,
    FAR,
    FAR_M,
    MOST_REMEMBERED,
    MOST_UNLIKE,
    SAME_PLACE_M,
    UNSETTLED_S,
    WINDOW_S,
    Absent,
    Arrival,
    Look,
    Reappearance,
)

CUP, BIG = (0.08, 0.08, 0.10), (0.3, 0.3, 0.4)
RED, BLUE, GREEN = 11, 222, 333
LATER = 30


def look(size: tuple[float, float, float] = CUP, color: int | None = RED, mixed: float = 0.0) -> Look:
    """Of one colour, with a share of the next."""
    colors = no_colors()
    if color is not None:
        colors[color], colors[color + 1] = 1.0 - mixed, mixed
    return Look(size, colors)


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


def settled(
    found: Reappearance, *came: tuple[Node, Look], doubted: tuple[tuple[Node, Look], ...] = (), there: int = 0
) -> dict:
    """Node id → the id of what it is now thought to be, of those of which something else was thought."""
    for one, _ in came:
        if one.id not in found.newcomers:
            found.arrive(one, LATER)
    return {i: was and was.node.id for i, was in found.settle(came, doubted, LATER, there).items()}


@pytest.fixture
def known() -> Reappearance:
    found = Reappearance()
    found.leave(node("object_1"), look(), 20)
    return found


@pytest.mark.parametrize(
    ("new", "seen", "same"),
    [
        (node("object_9", at=3.0, first=15), look(), True),
        (node("object_9", at=3.0, first=15), look(color=None), True),
        (node("object_9", at=3.0, first=15), look(color=BLUE), False),
        (node("object_9", at=3.0, first=15), look(BIG), False),
        (node("object_9", "bowl", at=3.0, first=15), look(), False),
        (node("object_9", at=3.0, first=5), look(), False),  # both were seen at one time: two things
    ],
)
def test_what_appears_is_what_has_gone_when_it_looks_the_same(known, new, seen, same):
    assert settled(known, (new, seen)) == ({"object_9": "object_1"} if same else {})


def test_of_those_alike_the_nearest_comes_back():
    gone = Reappearance()
    for n, at in enumerate((0.0, 4.0)):
        gone.leave(node(f"object_{n}", at=at), look(), 20)
    assert settled(gone, (node("object_9", at=3.0, first=15), look())) == {"object_9": "object_1"}


def test_after_the_window_nothing_comes_back(known):
    new = node("object_9", first=15)
    known.arrive(new, 15)
    assert known.settle([(new, look())], [], 21 + round(WINDOW_S * 1e9)) == {}


def test_what_was_looked_for_in_vain_may_be_what_came_but_rather_what_has_gone(known):
    new = (node("object_9", at=3.0, first=15), look())
    doubted = (node("object_2"), look())
    assert settled(Reappearance(), new, doubted=(doubted,)) == {"object_9": "object_2"}
    assert settled(known, new, doubted=(doubted,)) == {"object_9": "object_1"}


@given(st.floats(0.0, 1.0), st.floats(0.0, 9.0), st.integers(0, 100), st.integers(1, 100))
def test_the_more_of_a_class_there_are_the_more_alike_the_same_thing_must_be(mixed, at, there, more):
    def same(there: int) -> bool:
        gone = Reappearance()
        gone.leave(node("object_1"), look(), 20)
        return bool(settled(gone, (node("object_9", at=at, first=15), look(mixed=mixed)), there=there))

    assert same(there) or not same(there + more)


def test_the_only_one_of_its_class_comes_back_from_another_side_and_one_of_many_does_not(known):
    new = (node("object_9", at=3.0, first=15), look(mixed=0.7))
    assert settled(known, new, there=30) == {}
    assert settled(known, new) == {"object_9": "object_1"}


@given(st.lists(st.tuples(st.floats(0.0, 0.2), st.floats(0.0, 6.0)), min_size=1, max_size=3), st.randoms())
def test_all_that_came_and_all_that_has_gone_fit_together_as_well_as_can_be(looks, random):
    gone = Reappearance()
    before = [(node(f"object_{n}", at=at), look(mixed=mixed)) for n, (mixed, at) in enumerate(looks)]
    for one, seen in before:
        gone.leave(one, seen, 20)
    came = [(node(f"new_{n}", at=at + 0.5, first=15), look(mixed=mixed)) for n, (mixed, at) in enumerate(looks)]
    random.shuffle(came)
    found = settled(gone, *came)

    def gain(new: tuple[Node, Look], old: tuple[Node, Look]) -> float:
        alone = Reappearance()
        alone.leave(*old, 20)
        if not settled(alone, new, there=len(before) - 1):
            return 0.0
        way = abs(float(new[0].position[0] - old[0].position[0]))
        away = ELSEWHERE * min(way / SAME_PLACE_M, 1.0) + FAR * min(way / FAR_M, 1.0)
        return MOST_UNLIKE - COMMON * np.log(len(before)) - float(new[1].unlike([old[1]])[0]) - away

    table = np.array([[gain(new, old) for old in before] for new in came])
    best = max(sum(table[row, column] for row, column in enumerate(order)) for order in permutations(range(len(came))))
    names = [one.id for one, _ in before]
    total = sum(table[row, names.index(found[new.id])] for row, (new, _) in enumerate(came) if new.id in found)
    assert total == pytest.approx(best, abs=1e-4)


def test_who_came_first_is_not_taken_for_what_another_is_more_like():
    """A cup that is a little like the one that has gone is found before the one that is just like it."""
    gone = Reappearance()
    gone.leave(node("object_1"), look(), 20)
    first = (node("object_8", at=2.0, first=15), look(mixed=0.1))
    assert settled(gone, first) == {"object_8": "object_1"}
    gone.newcomers["object_1"] = Arrival(gone.newcomers.pop("object_8").came_ns, gone.absent.pop("object_1"))
    first = (node("object_1", at=2.0), first[1])
    assert settled(gone, first) == {}, "what is settled stays while nothing fits better"
    second = (node("object_9", at=2.0, first=15), look())
    assert settled(gone, first, second) == {"object_1": None, "object_9": "object_1"}


@given(*[st.lists(st.floats(0.02, 2.0), min_size=3, max_size=3)] * 2)
def test_being_unlike_is_symmetric_and_nothing_is_unlike_itself(a, b):
    one, other = look(tuple(a)), look(tuple(b), BLUE)
    assert one.unlike([other, one]) == pytest.approx([float(other.unlike([one])[0]), 0.0], abs=1e-4)


@given(
    st.lists(st.floats(0.1, 2.0), min_size=3, max_size=3),
    st.integers(0, 2),
    *[st.floats(1.0, 4.0)] * 2,
    *[st.floats(0.0, 0.5)] * 2,
)
def test_being_unlike_grows_with_each_edge_and_with_the_share_of_other_colors(size, edge, by, more, mixed, mix):
    """By as much whichever edge it is, and whatever else is different."""
    size = sorted(size, reverse=True)
    one = look(tuple(size))
    size[2] /= by
    less, most = look(tuple(size), mixed=mixed), look((size[0], size[1], size[2] / more), mixed=mixed + mix)
    a, b = one.unlike([less, most])
    assert b >= a - 1e-4
    other = [1.0, 1.0, 1.0]
    other[edge] = 4.0
    cube = look((1.0, 1.0, 1.0))
    assert cube.unlike([look(tuple(other))]) == pytest.approx(cube.unlike([look((1.0, 1.0, 0.25))]))


def test_no_more_is_remembered_than_said():
    gone = Reappearance()
    for n in range(MOST_REMEMBERED + 5):
        gone.leave(node(f"object_{n}"), look(), n)
    assert len(gone.absent) == MOST_REMEMBERED
    assert "object_0" not in gone.absent


def test_newcomers_are_news_for_a_while():
    found = Reappearance()
    found.arrive(node("object_1", first=0), 0)
    later = round(2 * UNSETTLED_S * 1e9)
    found.arrive(node("object_2", first=later, last=later), later)
    assert set(found.newcomers) == {"object_2"}


def test_what_is_remembered_outlives_a_restart(known):
    known.arrive(node("object_5"), 10)
    known.newcomers["object_6"] = Arrival(12, Absent(node("object_6"), look(color=GREEN, mixed=0.3), 11))
    again = Reappearance()
    again.restore(json.loads(json.dumps(known.document())))
    assert again.absent["object_1"].node == known.absent["object_1"].node
    assert again.absent["object_1"].left_ns == 20
    assert again.newcomers["object_5"] == known.newcomers["object_5"]
    was, before = again.newcomers["object_6"].was, known.newcomers["object_6"].was
    assert (again.newcomers["object_6"].came_ns, was.node, was.left_ns) == (12, before.node, 11)
    assert was.look.size == before.look.size
    assert np.array_equal(was.look.colors, before.look.colors)
