"""The watches of clients: each has a lease and a key of its own, where its answers are put whenever they change."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh
from pydantic import BaseModel

from scenegraph.service import keys, replies
from scenegraph.service.errors import Overloaded, UnknownKey, UnknownWatch
from scenegraph.service.messages import AskReply, Binding, WatchAnswers, WatchReply, WatchRequest, plain

__all__ = ["WatchDesk"]

log = logging.getLogger(__name__)

ANSWERS = "answers/{watch}"

SHARE_S = 0.05
SLICE_S = 0.25
"""For so long watched goals are asked again after a job while others wait, and while none does."""


class WatchDesk:
    """Starts, renews and ends watches, and asks them again; called by the thread that owns the world.

    world  as served; one without `watch` has no watches
    name   of the world;  most: how many watches there may be
    put    sends a message: row of the key table, key, message
    """

    def __init__(
        self, world: Any, name: str, put: Callable[[str, str, BaseModel | None], None], *, most: int = 10_000
    ) -> None:
        self._world = world
        self._most = most
        self._leases: dict[str, _Lease] = {}
        self._next = 1000 * secrets.randbelow(1_000_000) + 1  # names of an earlier server's watches mean none of ours
        self._publisher = _Publisher(name, put)
        watches = getattr(world, "watches", None)
        self._watches = watches
        if watches is not None:
            watches.by_hand = True

    def __len__(self) -> int:
        return len(self._leases)

    def start(self) -> None:
        """Begin to publish."""
        self._publisher.start()

    def stop(self) -> None:
        """Send what is waiting, and end all watches."""
        for name in list(self._leases):
            self._end(name)
        self._publisher.stop()
        if self._watches is not None:
            self._watches.by_hand = False

    def take(self, request: WatchRequest) -> WatchReply:
        """Start a watch, or renew or end the one that is named. Raises `UnknownWatch` when its lease has run out, and
        the problem that asking the goal has."""
        if request.watch is not None:
            lease = self._leases.get(request.watch)
            if lease is None or lease.goal != request.goal:
                raise UnknownWatch(
                    f"no watch {request.watch} of {request.goal!r} is held: its lease has run out",
                    hint="start it anew, without `watch`",
                )
            if request.lease_s == 0.0:
                self._end(request.watch)
            else:
                lease.until = time.monotonic() + request.lease_s
            return WatchReply(watch=request.watch, lease_s=request.lease_s)
        if self._watches is None:
            raise UnknownKey("this world keeps no watches")
        if len(self._leases) >= self._most:
            raise Overloaded(f"{self._most} goals are watched already", hint="end watches that are needed no more")
        name = f"w_{self._next}"
        self._next += 1
        publish = self._publisher
        watch = self._world.watch(
            request.goal,
            robot=request.robot,
            limit=request.limit,
            timeout_s=request.timeout_s,
            on_change=lambda change: publish.hand_over(name, change, request.nodes),
        )
        self._leases[name] = _Lease(request.goal, watch, time.monotonic() + request.lease_s)
        return WatchReply(watch=name, lease_s=request.lease_s)

    def answers(self, name: str) -> WatchAnswers:
        """The present answers of a watch, as they were put last. Raises `UnknownWatch`."""
        if name not in self._leases:
            raise UnknownWatch(f"no watch is called {name[:60]!r}")
        return self._publisher.last(name)

    def step(self, *, idle: bool) -> bool:
        """Let leases run out and ask again for a moment what may have changed; returns whether more is to be asked."""
        if not self._leases or self._watches is None:
            return False
        now = time.monotonic()
        for name in [name for name, lease in self._leases.items() if lease.until < now]:
            log.info("watch %s: its lease has run out", name)
            self._end(name)
        self._watches.refresh(budget_s=SLICE_S if idle else SHARE_S, resting=False)
        return bool(self._watches.pending)

    def _end(self, name: str) -> None:
        self._leases.pop(name).watch.close()
        self._publisher.forget(name)


class _Lease:
    def __init__(self, goal: str, watch: Any, until: float) -> None:
        self.goal, self.watch, self.until = goal, watch, until


class _Told(NamedTuple):
    """A message, its number, and by their text the answers that are known with it: with a problem those before it."""

    number: int
    message: Any
    known: dict[str, dict[str, Binding]]


_NOTHING = _Told(0, None, {})


class _Publisher:
    """Puts the answers of watches, from a thread of its own: of those that wait, only the newest of each watch."""

    def __init__(self, name: str, put: Callable[[str, str, BaseModel | None], None]) -> None:
        self._name = name
        self._put = put
        self._waiting: dict[str, _Told] = {}
        self._told: dict[str, _Told] = {}
        self._changed = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._publish, name="answers", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float = 5.0) -> None:
        """Send what is waiting, and end."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def hand_over(self, name: str, change: Any, nodes: bool) -> None:
        """Have a change of a watch put."""
        answers = change.answers
        reply = replies.ask_reply(
            answers, revision=answers.revision, elapsed_ms=answers.elapsed_ms, explain=False, nodes=nodes
        )
        with self._changed:
            self._waiting[name] = _after(self._told.get(name, _NOTHING), name, reply, change.stamp_ns)
            self._changed.notify()

    def last(self, name: str) -> WatchAnswers:
        """What was handed over last."""
        with self._changed:
            message: WatchAnswers = (self._waiting.get(name) or self._told[name]).message
            return message

    def forget(self, name: str) -> None:
        """A watch has ended."""
        with self._changed:
            self._waiting.pop(name, None)
            self._told.pop(name, None)

    def _publish(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting) or self._stopping)
                if not self._waiting:
                    return
                name = next(iter(self._waiting))
                told = self._told[name] = self._waiting.pop(name)
            try:
                self._put(ANSWERS, keys.answers(self._name, name), told.message)
            except zenoh.ZError as failure:  # the line is closing
                log.debug("the answers of %s could not be put: %s", name, failure)


def _after(told: _Told, name: str, reply: AskReply, stamp_ns: int) -> _Told:
    """The message that follows the one that was put last, with what came and went since then."""
    known = told.known if reply.problem else {str(plain(row)): row for row in reply.answers}
    message = WatchAnswers(
        **{field: getattr(reply, field) for field in AskReply.model_fields},
        watch=name,
        number=told.number + 1,
        stamp_ns=stamp_ns,
        came=tuple(row for text, row in known.items() if text not in told.known),
        went=tuple(row for text, row in told.known.items() if text not in known),
    )
    return _Told(message.number, message, known)
