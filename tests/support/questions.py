"""Questions with the answers that are true, and what to say of them; asked of models of simulated homes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from reasoning import Atom, KnowledgeBase
from scenegraph.phrases import answered, read
from tests.support.true_home import ROBOT, Truth

SEATS = ("chair", "office_chair", "sofa", "armchair", "stool", "bench")
TABLEWARE = ("cup", "bowl", "plate")
APPLIANCES = ("oven", "fridge", "microwave", "kettle", "toaster", "washing_machine")
ELECTRONICS = ("tv", "monitor", "laptop", "keyboard", "speaker")
TABLES = ("table", "coffee_table")
FURNITURE = (
    *SEATS, *TABLES, "desk", "counter", "nightstand", "tv_stand", "shelf", "cabinet", "wardrobe", "dresser", "bed",
)  # fmt: skip
CONTAINERS = (
    "basket", "box", "bin", "backpack", "vase", "shelf", "cabinet", "wardrobe", "dresser", "bottle", "cup", "bowl",
    "pot", "kettle", "sink", "bathtub", "oven", "fridge", "microwave", "toaster", "washing_machine",
)  # fmt: skip
FIXTURES = (
    "shelf", "cabinet", "wardrobe", "dresser", "bed", "counter", "sofa", "oven", "fridge", "washing_machine", "sink",
    "toilet", "bathtub",
)  # fmt: skip
HAND_M = 0.12


@dataclass(frozen=True)
class Question:
    """What is asked, and what is true: ids, a number (within a centimetre), or true, false, unknown."""

    kind: str
    text: str
    true: Callable[[Truth], Any]


def kitchen(t: Truth) -> str:
    return next(iter(t.room_of("kitchen")))


def one(t: Truth, label: str) -> str:
    [name] = t.things(label)
    return name


def in_room(t: Truth, *kinds: str) -> set[str]:
    return t.to("in", t.room_of(*kinds))


def apart(t: Truth, a: str, b: str) -> float:
    return float(np.linalg.norm(t.center[a] - t.center[b]))


def holds(fact: object) -> str:
    return "true" if fact else "false"


def volume(t: Truth, name: str) -> float:
    return float(np.prod(t.size[name]))


def best(names: set[str], value: Callable[[str], float]) -> set[str]:
    most = max(value(name) for name in names)
    return {name for name in names if value(name) >= most - 1e-9}


def workplaces(t: Truth) -> set[str]:
    desks = t.things("desk", *TABLES)
    screens = t.of("on", t.things("monitor", "laptop", "keyboard"))
    return {d for d in desks & screens if t.to("near", {d}) & t.things(*SEATS)}


def mistake(question: Question, true: Truth, knowledge: KnowledgeBase) -> str | None:
    """What is wrong with the answer to a question; None when it is right."""
    expected = question.true(true)
    phrase = read(question.text, knowledge)
    if phrase.problem is not None:
        return f"{question.text}: {phrase.problem}"
    reply = answered(phrase, knowledge.ask(phrase.goal, viewer=ROBOT, limit=1000))
    if reply.problem is not None:
        return f"{question.text}: {reply.problem}"
    if isinstance(expected, str):
        return None if reply.truth == expected else f"{question.text}: {reply.truth}, but it is {expected}"
    name = phrase.variables[0] if phrase.variables else "X"
    if isinstance(expected, set):
        ids = {t.name for row in reply.answers if isinstance(t := row[name], Atom)}
        if ids == expected:
            return None
        return f"{question.text}: missed {sorted(expected - ids)}, wrong {sorted(ids - expected)}"
    values = [row[name] for row in reply.answers]
    if len(values) == 1 and abs(float(values[0]) - float(expected)) <= 0.01:  # type: ignore[arg-type]
        return None
    return f"{question.text}: {values}, but it is {expected}"
