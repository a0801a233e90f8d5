"""Forty phrases that must be understood, with the right answers, and twenty that must be refused with a useful word."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from reasoning import KnowledgeBase
from scenegraph.phrases import answered, is_phrase, read
from tests.support.questions import (
    SEATS,
    TABLES,
    Question,
    apart,
    best,
    holds,
    in_room,
    kitchen,
    mistake,
    one,
    volume,
)  # fmt: skip
from tests.support.true_home import ROBOT, Truth, model, truth


@pytest.fixture(scope="module")
def world() -> Iterator[tuple[Truth, KnowledgeBase]]:
    true = truth(0)
    with model(true) as knowledge:
        yield true, knowledge


UNDERSTOOD = [
    Question("thing", "the sofa", lambda t: t.things("sofa")),
    Question("thing", "Where is the kettle?", lambda t: t.things("kettle")),
    Question("thing", "find the refrigerator", lambda t: t.things("fridge")),
    Question("thing", "show me all chairs in the living room",
             lambda t: t.things("chair", "office_chair") & in_room(t, "living_room")),
    Question("thing", "the office chair", lambda t: t.things("office_chair")),
    Question("thing", "the kitchen table", lambda t: t.things(*TABLES) & in_room(t, "kitchen")),
    Question("thing", "bring me an apple", lambda t: t.things("apple")),
    Question("thing", "the bowl with an apple in it, please",
             lambda t: t.of("in", t.things("apple")) & t.things("bowl")),
    Question("thing", "everything on the counter", lambda t: t.to("on", t.things("counter"))),
    Question("thing", "the cups on a table", lambda t: t.things("cup") & t.to("on", t.things(*TABLES))),
    Question("thing", "books on a shelf in the office",
             lambda t: t.things("book") & t.to("on", t.things("shelf") & in_room(t, "office"))),
    Question("thing", "balls that are in a basket", lambda t: t.things("ball") & t.to("in", t.things("basket"))),
    Question("thing", "shoes not under a bed", lambda t: t.things("shoe") - t.of("above", t.things("bed"))),
    Question("thing", "the largest chair not near a table",
             lambda t: best(t.things("chair", "office_chair") - t.to("near", t.things(*TABLES)),
                            lambda x: volume(t, x))),
    Question("thing", "the cup nearest to the oven",
             lambda t: best(t.things("cup"), lambda x: -apart(t, x, one(t, "oven")))),
    Question("thing", "the smallest book in the child room",
             lambda t: best(t.things("book") & in_room(t, "child_room"), lambda x: -volume(t, x))),
    Question("thing", "the most recently seen shoe", lambda t: best(t.things("shoe"), t.last_seen_ns.__getitem__)),
    Question("thing", "the plant I saw last", lambda t: best(t.things("plant"), t.last_seen_ns.__getitem__)),
    Question("thing", "things taller than the sofa",
             lambda t: {x for x in t.label if t.size[x][2] > t.size[one(t, "sofa")][2]}),
    Question("thing", "tables with a cup on them", lambda t: t.of("on", t.things("cup")) & t.things(*TABLES)),
    Question("thing", "seats within 2 metres of the tv",
             lambda t: {x for x in t.things(*SEATS) if apart(t, x, one(t, "tv")) <= 2.0}),
    Question("thing", "empty baskets",
             lambda t: t.things("basket") - t.of("in", t.label) - t.of("on", t.label)),
    Question("room", "the kitchen", lambda t: t.room_of("kitchen")),
    Question("room", "the room with the bathtub", lambda t: t.of("in", t.things("bathtub")) & set(t.rooms)),
    Question("room", "rooms without a bed", lambda t: set(t.rooms) - t.of("in", t.things("bed"))),
    Question("room", "which rooms have a plant and no window?",
             lambda t: (t.of("in", t.things("plant")) & set(t.rooms)) - set(t.windows.values())),
    Question("room", "which room is the washing machine in?",
             lambda t: t.of("in", t.things("washing_machine")) & set(t.rooms)),
    Question("room", "which rooms does the hall lead to?",
             lambda t: set().union(*(t.led_to(r) for r in t.room_of("hallway")))),
    Question("which", "what's in the fridge?", lambda t: t.to("in", t.things("fridge"))),
    Question("which", "which books are on the desk in the child room?",
             lambda t: t.things("book") & t.to("on", t.things("desk") & in_room(t, "child_room"))),
    Question("which", "which chair is nearest to the oven?",
             lambda t: best(t.things("chair", "office_chair"), lambda x: -apart(t, x, one(t, "oven")))),
    Question("which", "what does the table in the kitchen support?",
             lambda t: t.to("on", t.things(*TABLES) & in_room(t, "kitchen"))),
    Question("which", "which lamps are not on a desk or a nightstand?",
             lambda t: t.things("lamp") - t.to("on", t.things("desk", "nightstand"))),
    Question("yes", "is the microwave on the counter?",
             lambda t: holds(t.things("microwave") <= t.to("on", t.things("counter")))),
    Question("yes", "Is there a television in the bedroom?", lambda t: holds(t.things("tv") & in_room(t, "bedroom"))),
    Question("yes", "are the towels in the bathroom?", lambda t: holds(t.things("towel") <= in_room(t, "bathroom"))),
    Question("yes", "does the hallway have a window?",
             lambda t: holds(t.room_of("hallway") & set(t.windows.values()))),
    Question("yes", "is the fridge larger than the washing machine?",
             lambda t: holds(volume(t, one(t, "fridge")) > volume(t, one(t, "washing_machine")))),
    Question("value", "how many cups are there in the kitchen?",
             lambda t: len(t.things("cup") & in_room(t, "kitchen"))),
    Question("value", "how many toys does the child room contain?",
             lambda t: len(t.things("ball", "teddy_bear", "toy_block") & in_room(t, "child_room"))),
    Question("value", "how wide is the sofa?", lambda t: max(t.size[one(t, "sofa")][:2])),
    Question("value", "what is the area of the kitchen?", lambda t: t.area[kitchen(t)]),
]  # fmt: skip

PLACES = [
    ("near the oven", "near", lambda t: t.things("oven")),
    ("in the kitchen", "in", lambda t: t.room_of("kitchen")),
    ("somewhere beside the toilet", "next_to", lambda t: t.things("toilet")),
    ("go to the left of the sofa", "left_of", lambda t: t.things("sofa")),
    ("in the kitchen near a window", "near", lambda t: {w for w, r in t.windows.items() if r == kitchen(t)}),
]

REFUSED = [
    ("on the tabel", "tabel", "`table`"),
    ("the ovem", "ovem", "`oven`"),
    ("near the unicorn", "unicorn", None),
    ("how are you", "you", None),
    ("the cup behind", "behind", "what is meant"),
    ("near the", "the", "what is meant"),
    ("which rooms have", "have", "what is meant"),
    ("how many", "many", "what is meant"),
    ("between the oven", "oven", "what is meant"),
    ("the cup the table", "`the table` after it", "for example"),
    ("the big cup", "big", "largest"),
    ("a heavy box", "heavy", "largest"),
    ("put it on the table", "it", "name the thing"),
    ("the cup yesterday", "yesterday", "last seen"),
    ("why is the cup on the table?", "why", "explanation"),
    ("the nice chair", "nice", "colour"),
    ("fly to the moon", "fly", None),
    ("the chair in front the table", "front", "for example"),
    ("on on the table", "on", "for example"),
    ("the table quickly", "quickly", None),
    ("is the cup", "cup", "what is meant"),
    ("cups cups cups", "cups", "for example"),
]


def test_there_are_forty_and_twenty() -> None:
    assert len({q.text for q in UNDERSTOOD}) >= 40
    assert len({text for text, *_ in REFUSED}) >= 20


@pytest.mark.parametrize("question", UNDERSTOOD, ids=lambda q: q.text)
def test_what_is_understood_is_answered_rightly(world: tuple[Truth, KnowledgeBase], question: Question) -> None:
    assert is_phrase(question.text)
    assert mistake(question, *world) is None


@pytest.mark.parametrize(("text", "relation", "landmark"), PLACES)
def test_places_are_told_by_relation_and_landmark(
    world: tuple[Truth, KnowledgeBase], text: str, relation: str, landmark: object
) -> None:
    true, knowledge = world
    phrase = knowledge.phrase(text)
    assert (phrase.kind, phrase.relation, phrase.problem) == ("place", relation, None)
    reply = knowledge.ask(phrase.goal, viewer=ROBOT)
    assert {str(row["Target"]) for row in reply.answers} == landmark(true)  # type: ignore[operator]


@pytest.mark.parametrize(("text", "word", "hint"), REFUSED)
def test_what_is_not_understood_is_refused_with_the_word(
    world: tuple[Truth, KnowledgeBase], text: str, word: str, hint: str | None
) -> None:
    problem = world[1].phrase(text).problem
    assert problem is not None
    assert problem.code == "not_understood"
    assert word in problem.message
    assert hint is None or hint in (problem.hint or "")


@pytest.mark.parametrize("text", ["the chair", "what is on the desk?"])
def test_the_is_asked_back_when_it_fits_several(world: tuple[Truth, KnowledgeBase], text: str) -> None:
    _, knowledge = world
    phrase = read(text, knowledge)
    reply = answered(phrase, knowledge.ask(phrase.goal, viewer=ROBOT))
    several = {name for name in phrase.definite if len({row[name] for row in reply.answers}) > 1}
    assert len(several) == 1
    assert reply.truth == "unknown"
    assert reply.problem is not None
    assert reply.problem.code == "ambiguous"
    assert str(reply.answers[0][several.pop()]) in reply.problem.message


def test_the_is_not_asked_back_where_only_one_fits_all_that_is_said(world: tuple[Truth, KnowledgeBase]) -> None:
    """There are several cups; what is said of this one fits no other."""
    true, knowledge = world
    phrase = read("the cup nearest to the oven", knowledge)
    reply = answered(phrase, knowledge.ask(phrase.goal))
    assert len(true.things("cup")) > 1
    assert (reply.truth, reply.problem, len(reply.answers)) == ("true", None, 1)


@pytest.mark.parametrize("text", ["near(X, oven)", "X is 3", "true", "oven", "X = oven", "cup(X), oven(Y)", "?- true"])
def test_goals_are_no_phrases(text: str) -> None:
    assert not is_phrase(text)


@pytest.mark.parametrize("text", ["near the oven", "Is the cup red?", "what's this", "The cup is on a table."])
def test_words_are_phrases(text: str) -> None:
    assert is_phrase(text)
