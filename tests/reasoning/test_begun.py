"""Goals that are begun: the rules work on them beside their asker."""

import os
import signal
import time

import pytest

from reasoning.errors import GoalFailed
from reasoning.knowledge import KnowledgeBase
from reasoning.terms import Atom, Compound


def label(thing: str, name: str) -> Compound:
    return Compound("label", (Atom(thing), Atom(name)))


def test_a_goal_that_was_begun_is_answered_as_things_were_then() -> None:
    with KnowledgeBase() as knowledge:
        knowledge.update(put=[label("a", "cup")])
        before = knowledge.begin("facts:label(a, Label)")
        knowledge.update(put=[label("a", "plate")])
        [now] = knowledge.call("facts:label(a, Label)")
        later = knowledge.begin("facts:label(a, Label)")
        assert now == {"Label": Atom("plate")}
        assert before() == [{"Label": Atom("cup")}]
        assert before() == [{"Label": Atom("cup")}]
        assert later() == [{"Label": Atom("plate")}]


def test_begun_goals_are_answered_in_any_order() -> None:
    with KnowledgeBase() as knowledge:
        begun = [knowledge.begin(f"X = {n}") for n in range(5)]
        for n in (3, 0, 4, 1, 2):
            assert begun[n]() == [{"X": n}]


def test_what_is_begun_runs_beside_its_asker() -> None:
    with KnowledgeBase() as knowledge:
        begun = knowledge.begin("get_time(Ended)")
        time.sleep(0.5)
        woken = time.time()
        assert begun()[0]["Ended"] < woken


def test_a_worker_that_dies_over_a_begun_goal_is_asked_anew() -> None:
    with KnowledgeBase() as knowledge:
        knowledge.update(put=[label("a", "cup")])
        pid = knowledge.engine.pid
        assert pid is not None
        begun = knowledge.begin("sleep(0.2), facts:label(a, Label)")
        os.kill(pid, signal.SIGKILL)
        knowledge.update(put=[label("b", "plate")])
        assert knowledge.call("facts:label(b, Label)") == [{"Label": Atom("plate")}]
        assert begun() == [{"Label": Atom("cup")}]


def test_a_begun_goal_that_takes_too_long_is_broken_off() -> None:
    with KnowledgeBase() as knowledge:
        begun = knowledge.begin("repeat, fail", timeout_s=0.2)
        with pytest.raises(GoalFailed) as caught:
            begun()
        assert caught.value.code == "timeout"
        assert knowledge.call("X = 1") == [{"X": 1}]
