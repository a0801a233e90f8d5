"""A watch of a server's: its answers as they come, renewed as long as it is held."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import zenoh

from scenegraph.errors import Problem, SceneGraphError, problem_of
from scenegraph.service import keys
from scenegraph.service.errors import ServiceError
from scenegraph.service.messages import WatchAnswers, WatchReply, WatchRequest, decode, plain
from scenegraph.service.replies import bound

if TYPE_CHECKING:
    from scenegraph.service.client import Client

__all__ = ["RemoteChange", "RemoteWatch"]

log = logging.getLogger(__name__)

Row = dict[str, Any]


class RemoteChange(NamedTuple):
    """How the answers of a server's watch changed; the fields of `scenegraph.watching.AnswerChange`.

    answers  all that hold now: variable name → `Node` or plain value; with a problem those that were known before
    """

    came: tuple[Row, ...]
    went: tuple[Row, ...]
    answers: tuple[Row, ...]
    truth: str
    problem: Problem | None
    revision: int
    stamp_ns: int


class RemoteWatch:
    """One goal that a server keeps answered. Iterating yields each `RemoteChange` as it comes, and waits for the next
    until the watch is closed; `poll` does not wait. The first tells the answers that there are.

    A context manager, which ends the watch. A thread of its own renews the lease; a server that came back is asked
    anew, and while none replies a change with that problem is told.
    """

    def __init__(self, client: Client, request: WatchRequest) -> None:
        self._client = client
        self._request = request
        self._changes: queue.SimpleQueue[RemoteChange | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._known: dict[str, Row] = {}
        self._state: tuple[Any, ...] | None = None
        self._number = 0
        self._subscriber: zenoh.Subscriber[Any] | None = None
        self._name = ""
        self._closed = threading.Event()
        self._begin()
        self._thread = threading.Thread(target=self._renew, name="watch", daemon=True)
        self._thread.start()

    @property
    def goal(self) -> str:
        return self._request.goal

    @property
    def name(self) -> str:
        """What the server calls it: its answers are put at `answers/{name}`."""
        return self._name

    def next(self, timeout_s: float | None = None) -> RemoteChange | None:
        """The next change; None when none came in time, or the watch was closed."""
        try:
            change = self._changes.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if change is None:
            self._changes.put(None)
        return change

    def poll(self) -> list[RemoteChange]:
        """The changes since they were read last, oldest first."""
        changes = []
        while not self._changes.empty() and (change := self.next()) is not None:
            changes.append(change)
        return changes

    def __iter__(self) -> Iterator[RemoteChange]:
        while (change := self.next()) is not None:
            yield change

    def close(self) -> None:
        """End the watch. Closing twice does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._unsubscribe()
        try:
            self._ask(self._name, 0.0)
        except SceneGraphError as error:  # its lease will end it
            log.debug("watch %s could not be ended: %s", self._name, error)
        self._changes.put(None)
        self._thread.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the lease -----------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Start the watch, listen to its answers, and take those that were put before."""
        self._unsubscribe()
        self._name = self._ask(None, self._request.lease_s).watch
        world, session = self._client.world, self._client._session
        with self._lock:
            self._number = 0
        self._subscriber = session.declare_subscriber(keys.answers(world, self._name), self._receive)
        data, encoding = self._client._get(f"answers/{self._name}", None, self._client._timeout_s)
        self._take(decode(data, "WatchAnswers", encoding))

    def _ask(self, name: str | None, lease_s: float) -> WatchReply:
        request = self._request.model_copy(update={"watch": name, "lease_s": lease_s})
        return self._client._call("watch", request, WatchReply, self._request.timeout_s + self._client._timeout_s)

    def _renew(self) -> None:
        while not self._closed.wait(self._request.lease_s / 3.0):
            try:
                try:
                    self._ask(self._name, self._request.lease_s)
                except ServiceError as error:
                    if error.code != "unknown_watch":
                        raise
                    self._begin()
            except SceneGraphError as error:
                if not self._closed.is_set():
                    self._trouble(problem_of(error))

    def _unsubscribe(self) -> None:
        if self._subscriber is not None:
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._subscriber = None

    # -- answers -------------------------------------------------------------------------------------------------

    def _receive(self, sample: zenoh.Sample) -> None:
        try:
            self._take(decode(sample.payload.to_bytes(), "WatchAnswers", str(sample.encoding)))
        except SceneGraphError as error:
            log.warning("answers of %s could not be read, the next ones will be: %s", self._name, error)

    def _take(self, message: WatchAnswers) -> None:
        """Compare with what was known: each message tells all answers, so that one that was lost does no harm."""
        with self._lock:
            if message.number <= self._number:
                return
            self._number = message.number
            known = self._known
            if message.problem is None:
                nodes = {node.id: node for node in message.nodes or ()}
                known = {str(plain(row)): bound(row, nodes) for row in message.answers}
            self._tell(known, message.truth, message.problem, message.revision, message.stamp_ns, message.truncated)

    def _trouble(self, problem: Problem) -> None:
        with self._lock:
            revision, stamp_ns = (self._state or (None, None, None, 0, 0))[3:5]
            self._tell(self._known, "unknown", problem, revision, stamp_ns)

    def _tell(
        self,
        known: dict[str, Row],
        truth: str,
        problem: Problem | None,
        revision: int,
        stamp_ns: int,
        truncated: bool = False,
    ) -> None:
        came = tuple(row for key, row in known.items() if key not in self._known)
        went = tuple(row for key, row in self._known.items() if key not in known)
        state = (truth, problem, truncated, revision, stamp_ns)
        before, self._known, self._state = self._state, known, state
        if came or went or before is None or before[:3] != state[:3]:
            self._changes.put(RemoteChange(came, went, tuple(known.values()), truth, problem, revision, stamp_ns))
