"""Watches: goals whose answers are told whenever they change."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

from reasoning.knowledge import KnowledgeBase, Problem, Reply
from reasoning.terms import Compound, Term, Var, term_text
from reasoning.watching import REST, SLOW_S
from scenegraph.answers import Answers, Truth
from scenegraph.errors import GoalRefused

__all__ = ["AnswerChange", "Watch", "Watches"]

log = logging.getLogger(__name__)

MOST_WAITING = 1000
"""Changes that wait to be read; beyond, the oldest two are told as one."""

Row = dict[str, Any]
_Key = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class AnswerChange:
    """How the answers to a watched goal changed. The first one of a watch tells those that there are.

    came, went : the answers that are new, and those that hold no longer: variable name → `Node` or plain value
    answers    : all of them, as `World.ask` gives them
    stamp_ns   : of the graph that was asked

    With a `problem` the goal could not be asked to the end, for what is then not known nothing came or went.
    """

    came: tuple[Row, ...]
    went: tuple[Row, ...]
    answers: Answers = field(repr=False)
    stamp_ns: int

    @property
    def truth(self) -> Truth:
        return self.answers.truth

    @property
    def problem(self) -> Problem | None:
        return self.answers.problem

    @property
    def revision(self) -> int:
        """The graph's, when it was asked."""
        return self.answers.revision


class _Sought(NamedTuple):
    """A question as it was put; those that are equal are asked once."""

    goal: str
    robot: str | None
    limit: int
    timeout_s: float


class Watch:
    """One watched goal. Iterating yields the `AnswerChange`s that were not read yet, and ends when there is none left.

    A context manager, which ends the watch. `answers` are the present ones.
    """

    def __init__(
        self, sought: _Sought, close: Callable[[Watch], None], on_change: Callable[[AnswerChange], object] | None
    ) -> None:
        self._sought = sought
        self._close = close
        self._on_change = on_change
        self._known: dict[_Key, Row] = {}
        self._waiting: deque[tuple[dict[_Key, Row], dict[_Key, Row], Answers, int]] = deque()
        self._answers: Answers | None = None

    @property
    def goal(self) -> str:
        return self._sought.goal

    @property
    def answers(self) -> Answers:
        """The present answers."""
        assert self._answers is not None
        return self._answers

    def poll(self) -> list[AnswerChange]:
        """The changes since they were read last, oldest first."""
        return list(self)

    def __iter__(self) -> Iterator[AnswerChange]:
        while self._waiting:
            yield _change(self._waiting.popleft())

    def close(self) -> None:
        """End the watch; what was not read yet can still be. Closing twice does nothing."""
        self._close(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def take(self, answers: Answers, stamp_ns: int) -> bool:
        """Compare with what was known; returns whether that is a change, which is then told."""
        before = self._answers
        self._answers = answers
        came: dict[_Key, Row] = {}
        went: dict[_Key, Row] = {}
        if answers.problem is None:
            rows = dict(zip(map(_key, answers.reply.answers), answers, strict=True))
            came = {key: row for key, row in rows.items() if key not in self._known}
            went = {key: row for key, row in self._known.items() if key not in rows}
            self._known = rows
        if before is not None and not (came or went) and _state(before) == _state(answers):
            return False
        change = (came, went, answers, stamp_ns)
        if self._on_change is not None:
            try:
                self._on_change(_change(change))
            except Exception:  # what changed has changed, and others wait to be told
                log.exception("watch of %s: the function that is told of changes failed", self.goal)
        else:
            self._waiting.append(change)
            if len(self._waiting) > MOST_WAITING:
                first, second = self._waiting.popleft(), self._waiting.popleft()
                self._waiting.appendleft(_joined(first, second))
        return True


def _key(row: Mapping[str, Term]) -> _Key:
    """What makes a row the same answer; the engine names variables that have no value anew each time."""
    names: dict[str, Var] = {}
    return tuple((name, term_text(_renamed(term, names))) for name, term in row.items())


def _renamed(term: Term, names: dict[str, Var]) -> Term:
    match term:
        case Var(name):
            return names.setdefault(name, Var(f"_{len(names)}"))
        case Compound(name, arguments):
            return Compound(name, tuple(_renamed(argument, names) for argument in arguments))
        case list():
            return [_renamed(item, names) for item in term]
    return term


def _state(answers: Answers) -> tuple[Any, ...]:
    return answers.truth, answers.truncated, answers.problem


_Change = tuple[dict[_Key, Row], dict[_Key, Row], Answers, int]


def _change(change: _Change) -> AnswerChange:
    came, went, answers, stamp_ns = change
    return AnswerChange(tuple(came.values()), tuple(went.values()), answers, stamp_ns)


def _joined(first: _Change, second: _Change) -> _Change:
    """Two changes as one: what came and went again did neither."""
    came = {key: row for key, row in first[0].items() if key not in second[1]}
    came |= {key: row for key, row in second[0].items() if key not in first[1]}
    went = {key: row for key, row in first[1].items() if key not in second[0]}
    went |= {key: row for key, row in second[1].items() if key not in first[0]}
    return came, went, *second[2:]


class Watches:
    """The watches of one world. After each change the goals that read what changed are asked again.

    ask       : asks a goal of the world, with the measurements that it needs
    answers   : what a reply means for the graph as it is;  stamp : when that changed last [ns]
    on_demand : whether a goal needs measurements that are made when it is asked: it is asked again after each change
    """

    def __init__(
        self,
        knowledge: KnowledgeBase,
        ask: Callable[[_Sought], Answers],
        answers: Callable[[Reply], Answers],
        stamp: Callable[[], int],
        on_demand: Callable[[str], bool],
    ) -> None:
        self._knowledge = knowledge
        self._ask, self._answers_of, self._stamp, self._on_demand = ask, answers, stamp, on_demand
        self._watches: dict[_Sought, list[Watch]] = {}
        self._number_of: dict[_Sought, int] = {}
        self._sought_by: dict[int, _Sought] = {}
        self._rests_until: dict[_Sought, float] = {}
        self.by_hand = False
        """Whether `refresh` is called by who serves the world, not after each change."""

    def __len__(self) -> int:
        return sum(map(len, self._watches.values()))

    def add(
        self,
        goal: str,
        robot: str | None,
        limit: int,
        timeout_s: float,
        on_change: Callable[[AnswerChange], object] | None,
    ) -> Watch:
        """Watch a goal. Raises `GoalRefused` when it cannot be asked."""
        if not goal.isprintable() and any("\ud800" <= character <= "\udfff" for character in goal):
            raise GoalRefused("syntax_error", "the goal holds half a surrogate pair: expected characters of Unicode")
        sought = _Sought(goal, robot, limit, timeout_s)
        answers = self._first(sought)
        if answers.problem is not None:
            if sought not in self._watches:
                self._forget(sought)
            problem = answers.problem
            raise GoalRefused(problem.code, problem.message, hint=problem.hint)
        watch = Watch(sought, self._end, on_change)
        self._watches.setdefault(sought, []).append(watch)
        watch.take(answers, self._stamp())
        return watch

    def refresh(self, *, budget_s: float = math.inf, resting: bool = True) -> list[Watch]:
        """Ask again what a change may have answered anew, until the budget is spent: the watches with a change.

        resting : whether goals that take long, and rest after they were asked, are asked all the same
        """
        until = time.monotonic() + budget_s
        changed: list[Watch] = []
        for number, reply in self._knowledge.watching.refresh(budget_s=budget_s, resting=resting):
            changed += self._tell(self._sought_by[number], self._answers_of(reply))
        for sought in [s for s in self._watches if s not in self._number_of]:
            began = time.monotonic()
            if began >= until:
                break
            if resting or self._rests_until.get(sought, 0.0) <= began:
                changed += self._tell(sought, self._ask(sought))
                took = time.monotonic() - began
                self._rests_until[sought] = began + (REST * took if took > SLOW_S else 0.0)
        return changed

    @property
    def pending(self) -> int:
        """How many goals are to be asked again and do not rest."""
        return len(self._knowledge.watching.due(resting=False))

    def _first(self, sought: _Sought) -> Answers:
        if self._on_demand(sought.goal):
            return self._ask(sought)
        if sought not in self._number_of:
            viewer = None if sought.robot is None else f"agent_{sought.robot}"
            number = self._knowledge.watch(
                sought.goal, limit=sought.limit, timeout_s=sought.timeout_s, viewer=viewer
            )  # fmt: skip
            self._number_of[sought], self._sought_by[number] = number, sought
        answers = self._answers_of(self._knowledge.watching.ask(self._number_of[sought]))
        self._tell(sought, answers)
        return answers

    def _tell(self, sought: _Sought, answers: Answers) -> list[Watch]:
        stamp_ns = self._stamp()
        return [watch for watch in list(self._watches.get(sought, ())) if watch.take(answers, stamp_ns)]

    def _end(self, watch: Watch) -> None:
        sought = watch._sought
        others = [other for other in self._watches.get(sought, ()) if other is not watch]
        if others:
            self._watches[sought] = others
        elif self._watches.pop(sought, None) is not None:
            self._forget(sought)

    def _forget(self, sought: _Sought) -> None:
        self._rests_until.pop(sought, None)
        number = self._number_of.pop(sought, None)
        if number is not None:
            del self._sought_by[number]
            self._knowledge.watching.remove(number)
