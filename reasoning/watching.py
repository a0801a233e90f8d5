"""Goals that are kept answered: asked again when a fact changes that was read when they were asked last.

While a watched goal runs the engine notes the facts that are looked up (`rules/watching.pl`), each by its predicate and
one name that was given: an id, a class, a key. So whatever rules stand between a goal and the facts, a change that can
matter is found by a look at what changed, at a cost that depends on the change and not on how many goals are watched.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, cast

from reasoning.engine import Engine
from reasoning.facts import FactStore, Key
from reasoning.terms import Atom, Compound, Term, term_text

__all__ = ["Question", "Watching"]

ANY = "'*'"
"""Stands for a look-up that names nothing: any fact of the predicate can matter."""

BATCH = 256
BATCH_S = 0.25
"""Goals are handed over in batches; each is asked for as long, and what is left goes with the next."""

NONE = Atom("none")
MOST_THINGS = 10_000
AT_A_TIME = 16

SLOW_S = 0.05
REST = 10.0
"""A question that takes longer than SLOW_S may rest for REST times as long before it is asked again."""

NEEDS = "needs_past"
"""The problem of a goal that reads facts that are told only when they are needed; its hint says which."""

UNSETTLED = frozenset({"timeout", "resource_limit"})
"""Problems of goals that were broken off: what they would have read is not known."""


Reads: TypeAlias = list[list[Atom]]
"""For each predicate its name and the names that it was read with. An atom stands for what was read the last time."""


class Question(NamedTuple):
    """What is asked: as in `KnowledgeBase.ask`; viewer is a term, the atom `none` without one."""

    goal: str
    limit: int
    timeout_s: float
    viewer: Term
    pin: tuple[str, ...] | None = None
    """Asked only where the class that the goal begins with is one of these things."""


@dataclass
class _Parts:
    """A question that is asked for a few things at a time: the question which things there are, which of the others has
    each of them, and the replies to these."""

    things: int
    of: dict[str, int] = field(default_factory=dict)
    replies: dict[int, Any] = field(default_factory=dict)

    @property
    def numbers(self) -> list[int]:
        return [self.things, *dict.fromkeys(self.of.values())]


class Watching:
    """The watched questions of one knowledge base, numbered. Not thread-safe.

    A question that begins with a class of which there are many (`near(X, cup)`) is asked for a few of them at a time:
    after a change it is asked again only of those that it can matter to.

    reply_of : makes of the engine's result and the time it took [ms] what `refresh` gives
    union    : makes one such reply of those of the parts, within a limit of answers; None when that needs the whole
    """

    def __init__(
        self,
        engine: Engine,
        facts: FactStore,
        reply_of: Callable[[Term, float], Any],
        union: Callable[[list[Any], int], Any],
    ) -> None:
        self._engine = engine
        self._facts = facts
        self._reply_of = reply_of
        self._union = union
        self._parts: dict[int, _Parts] = {}
        self._whole_of: dict[int, int] = {}
        self._whole_for_good: set[int] = set()
        self._incomplete: dict[int, None] = {}
        self._questions: dict[int, Question] = {}
        self._reads = _Reads()
        self._pending: dict[int, None] = {}
        self._rests_until: dict[int, float] = {}
        self._unsettled: set[int] = set()
        self._measurements: set[str] = set()
        self._next = 1
        self.supplier: Callable[[str], bool] | None = None
        """Tells what a problem NEEDS says; returns whether that was new."""

    def __len__(self) -> int:
        return len(self._questions) - len(self._whole_of)

    def add(self, question: Question) -> int:
        """Watch a question; its first answers come with the next `refresh`."""
        number = self._next
        self._next += 1
        self._questions[number] = question
        self._pending[number] = None
        if self._facts.follower is None:
            self._measurements = self._facts.measurements()
            self._facts.follower = self._changed
        return number

    def remove(self, number: int) -> None:
        """Watch it no longer. Does nothing when it is not watched."""
        if number in self._parts:
            self._make_whole(number)
        if self._questions.pop(number, None) is not None:
            self._whole_for_good.discard(number)
            self._reads.forget(number)
            self._pending.pop(number, None)
            self._rests_until.pop(number, None)
            self._unsettled.discard(number)
        if not self._questions:
            self._facts.follower = None

    def due(self, *, resting: bool = True) -> list[int]:
        """The questions that a change may have given other answers, the one that waits longest first.

        resting : with those that are slow, and rest after they were asked
        """
        if resting or not self._rests_until:
            return list(self._pending)
        now = time.monotonic()
        return [number for number in self._pending if self._rests_until.get(number, 0.0) <= now]

    def touch(self, numbers: Iterable[int] | None = None) -> None:
        """Have questions asked again whatever changed; None: all, since rules have changed."""
        for number in self._questions if numbers is None else numbers:
            if number in self._parts:
                self._pending.update(dict.fromkeys(self._parts[number].numbers))
            elif number in self._questions:
                self._pending[number] = None

    def refresh(self, *, budget_s: float = math.inf, resting: bool = True) -> Iterator[tuple[int, Any]]:
        """Ask pending questions again until the budget is spent: their numbers and replies.

        resting : whether slow questions, which rest after they were asked, are asked all the same
        """
        until = time.monotonic() + budget_s
        while waiting := self.due(resting=resting)[:BATCH]:
            left = min(BATCH_S, until - time.monotonic())
            if left <= 0.0:
                return
            for asked in self._asked(waiting, left):
                if self.supplied(asked[1]) or asked[0] not in self._questions:
                    continue
                number, reply = self._settle(*asked)
                if number in self._whole_of:
                    self._collect(self._whole_of[number], number, reply)
                else:
                    self._take_apart(number, asked[-1], reply)
                    yield number, reply
            yield from self._completed()

    def ask(self, number: int) -> Any:
        """Ask one watched question now, pending or not: its reply."""
        [asked] = self._asked([number], 0.0)
        while self.supplied(asked[1]):
            [asked] = self._asked([number], 0.0)
        if number in self._parts:  # these follow what changes
            return self._reply_of(asked[1], 1e3 * asked[2])
        self._pending[number] = None
        return self._settle(*asked)[1]

    def supplied(self, result: Term) -> bool:
        """Whether a question lacked facts that are told only when they are needed, and now are."""
        if self.supplier is None or _problem_code(result) != NEEDS:
            return False
        return self.supplier(str(_problem_of(result).args[2]))

    # -- a few things at a time ---------------------------------------------------------------------------
    def _take_apart(self, number: int, kind: Atom, reply: Any) -> None:
        """Ask a question from now on for a few things at a time of the class that it begins with, if worth it."""
        if kind == NONE or number in self._whole_for_good or reply.problem is not None or reply.truncated:
            return
        question = self._questions[number]
        goal = f"instance_of(X, {term_text(kind)})"
        things = self.add(Question(goal, MOST_THINGS, question.timeout_s, Atom("none")))
        self._parts[number] = _Parts(things)
        self._whole_of[things] = number
        self._reads.forget(number)

    def _collect(self, whole: int, number: int, reply: Any) -> None:
        """Take in the reply of a part, or the things that there are."""
        parts = self._parts[whole]
        self._incomplete[whole] = None
        if number != parts.things:
            parts.replies[number] = reply
        elif reply.problem is not None or reply.truncated:
            self._make_whole(whole)
        else:
            self._deal_out(whole, {str(row["X"]) for row in reply.answers})

    def _deal_out(self, whole: int, things: set[str]) -> None:
        """Have each thing in one of the parts of a question; the parts that this changes are asked again."""
        parts = self._parts[whole]
        members: dict[int, set[str]] = {}
        for thing, part in parts.of.items():
            members.setdefault(part, set()).add(thing)
        changed = set()
        for thing in parts.of.keys() - things:
            part = parts.of.pop(thing)
            members[part].discard(thing)
            changed.add(part)
        room = [part for part, those in members.items() for _ in range(AT_A_TIME - len(those)) if those]
        for thing in sorted(things - parts.of.keys()):
            if not room:
                part = self.add(self._questions[whole]._replace(pin=()))
                self._whole_of[part] = whole
                room = [part] * AT_A_TIME
            part = parts.of[thing] = room.pop()
            members.setdefault(part, set()).add(thing)
            changed.add(part)
        for part in changed:
            if members[part]:
                self._questions[part] = self._questions[part]._replace(pin=tuple(sorted(members[part])))
                self._pending[part] = None
            else:
                parts.replies.pop(part, None)
                del self._whole_of[part]
                self.remove(part)

    def _completed(self) -> Iterator[tuple[int, Any]]:
        """The replies of questions all of whose parts are answered."""
        for whole in list(self._incomplete):
            parts = self._parts.get(whole)
            if parts is not None and any(number in self._pending for number in parts.numbers):
                continue
            del self._incomplete[whole]
            if parts is None:
                continue
            reply = self._union(list(parts.replies.values()), self._questions[whole].limit) if parts.of else None
            if reply is None:
                self._make_whole(whole)
            else:
                yield whole, reply

    def _make_whole(self, number: int) -> None:
        """Ask a question as a whole again, now and for good."""
        for part in self._parts.pop(number).numbers:
            del self._whole_of[part]
            self.remove(part)
        self._incomplete.pop(number, None)
        self._whole_for_good.add(number)
        self._pending[number] = None

    # -- asking -------------------------------------------------------------------------------------------
    def _asked(self, batch: list[int], seconds: float) -> list[tuple[int, Term, float, Reads | Atom | None, Atom]]:
        """Results, times [s] and what was read for the first ones of a batch, all if time allows."""
        watches: list[Any] = [
            _watch_term(number, self._questions[number], number in self._reads) for number in batch
        ]  # fmt: skip
        longest = max(self._questions[number].timeout_s for number in batch)
        began = time.monotonic()
        result = self._engine.request(Compound("watch", (watches, seconds)), timeout_s=seconds + longest)
        if isinstance(result, list):
            return [cast(Compound, asked).args for asked in result]  # type: ignore[misc]
        if len(batch) == 1:
            return [(batch[0], result, time.monotonic() - began, None, NONE)]
        return [asked for number in batch for asked in self._asked([number], 0.0)]

    def _settle(self, number: int, result: Term, took_s: float, reads: Reads | Atom | None, _: Atom) -> tuple[int, Any]:
        del self._pending[number]
        if took_s > SLOW_S:
            self._rests_until[number] = time.monotonic() + REST * took_s
        else:
            self._rests_until.pop(number, None)
        if reads is not None and not isinstance(reads, Atom):
            self._reads.put(number, reads)
        if reads is None or _problem_code(result) in UNSETTLED:
            self._unsettled.add(number)
        else:
            self._unsettled.discard(number)
        return number, self._reply_of(result, 1e3 * took_s)

    # -- following the facts ------------------------------------------------------------------------------
    def _changed(self, key: Key, text: str) -> None:
        name, identity = key[0], key[2:]
        rest = text[len(name) + 1 + sum(map(len, identity)) + len(identity) : -1]
        match name:
            case "measured":
                name, identity = f"measured_{key[2]}", key[3:]
                if key[2] not in self._measurements:
                    self._measurements.add(key[2])
                    self._touched("store", (key[2],))
            case "edge":
                name = "stored_edge"
            case "name":
                name = "named"
            case "label" | "node" | "attribute":
                identity = (*identity, rest)
            case "class_info":
                identity = (*identity, rest.partition(",")[2])
        self._touched(name, identity)
        self._pending.update(dict.fromkeys(self._unsettled))

    def _touched(self, predicate: str, names: tuple[str, ...]) -> None:
        self._pending.update(dict.fromkeys(self._reads.of(predicate, names)))


class _Reads:
    """Which questions read what: by name, then question, the predicates as bits."""

    def __init__(self) -> None:
        self._bits: dict[str, int] = {}
        self._by_name: dict[str, dict[int, int]] = {}
        self._names: dict[int, set[str]] = {}

    def __contains__(self, number: int) -> bool:
        """Whether it is known what a question read."""
        return number in self._names

    def put(self, number: int, reads: Reads) -> None:
        """Take down what a question read, in the place of what it read before."""
        found: dict[str, int] = {}
        for predicate, *names in reads:
            bit = self._bit(str(predicate))
            for name in map(term_text, names):
                found[name] = found.get(name, 0) | bit
        for name in self._names.get(number, set()) - found.keys():
            self._drop(name, number)
        for name, bits in found.items():
            self._by_name.setdefault(name, {})[number] = bits
        self._names[number] = set(found)

    def forget(self, number: int) -> None:
        """A question is watched no longer."""
        for name in self._names.pop(number, ()):
            self._drop(name, number)

    def of(self, predicate: str, names: tuple[str, ...]) -> list[int]:
        """The questions that read facts of the predicate with one of the names, or with any."""
        bit = self._bit(predicate)
        return [
            number
            for name in (*names, ANY)
            for number, bits in self._by_name.get(name, _NOBODY).items()
            if bits & bit
        ]  # fmt: skip

    def _bit(self, predicate: str) -> int:
        return self._bits.setdefault(predicate, 1 << len(self._bits))

    def _drop(self, name: str, number: int) -> None:
        readers = self._by_name[name]
        del readers[number]
        if not readers:
            del self._by_name[name]


_NOBODY: dict[int, int] = {}


def _watch_term(number: int, question: Question, known: bool) -> Compound:
    options = (
        question.limit,
        question.timeout_s,
        int(question.timeout_s * _INFERENCES_PER_SECOND),
        Atom("false"),
        question.viewer,
    )
    pin = Atom("any") if question.pin is None else Compound("pin", ([Atom(thing) for thing in question.pin],))
    return Compound(
        "watch", (number, question.goal, Compound("options", options), pin, Atom("true" if known else "false"))
    )


def _problem_of(result: Term) -> Compound:
    """The problem that a result is or has; of one without, whatever is in its place."""
    told = cast(Compound, result)
    return cast(Compound, told.args[4]) if told.name == "reply" else told


def _problem_code(result: Term) -> str | None:
    trouble = _problem_of(result)
    return str(trouble.args[0]) if isinstance(trouble, Compound) else None


_INFERENCES_PER_SECOND = 150_000_000
"""Noting costs steps, too: three times what a goal may take that is only asked."""
