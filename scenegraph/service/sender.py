"""Sending: replies by a few workers, problems, and puts, each in the form and with the quality that its key wants."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import zenoh
from pydantic import BaseModel

from scenegraph.errors import Problem, problem_of
from scenegraph.service import keys
from scenegraph.service.codec import Form, media_type
from scenegraph.service.errors import Overloaded
from scenegraph.service.messages import encode, encoding_of
from scenegraph.service.session import qos_options

__all__ = ["Sender", "problem_told", "reply_form"]

log = logging.getLogger(__name__)

_WORKERS = 3


class Sender:
    """Sends for one world.

    world    its name;  session: an open Zenoh session
    waiting  how many replies may wait to be made
    """

    def __init__(self, world: str, session: zenoh.Session, waiting: int) -> None:
        self._world = world
        self._session = session
        self._waiting = waiting
        self._room = threading.BoundedSemaphore(waiting)
        self._pool = ThreadPoolExecutor(_WORKERS, thread_name_prefix="reply")

    def close(self) -> None:
        """Send what is waiting, and end."""
        self._pool.shutdown(wait=True)

    # -- replies -------------------------------------------------------------------------------------------------

    def soon(self, query: zenoh.Query, reply: Callable[[], None]) -> None:
        """Let a worker make and send a reply. Raises `Overloaded` when too many are waiting."""
        if not self._room.acquire(blocking=False):
            raise Overloaded(f"{self._waiting} replies are waiting already", hint="ask again a little later")

        def guarded() -> None:
            try:
                reply()
            except zenoh.ZError as failure:  # who asked has gone
                log.debug("a reply could not be sent: %s", failure)
            except Exception as error:
                self.problem(query, error)
            finally:
                query.drop()  # type: ignore[no-untyped-call]
                self._room.release()

        try:
            self._pool.submit(guarded)
        except RuntimeError:
            self._room.release()
            raise Overloaded("the server is stopping") from None

    def reply(self, query: zenoh.Query, path: str, message: BaseModel) -> None:
        """Reply with a message, on this world's key."""
        form = reply_form(query)
        self.reply_bytes(query, path, encode(message, form), encoding_of(message, form))

    def reply_bytes(self, query: zenoh.Query, path: str, data: bytes, encoding: str) -> None:
        """Reply with bytes, on this world's key."""
        query.reply(keys.key(self._world, path), data, encoding=encoding)

    def problem(self, query: zenoh.Query, error: Exception) -> None:
        """Reply with what went wrong; that ends the query."""
        form = reply_form(query)
        try:
            query.reply_err(encode(problem_told(error), form), encoding=media_type(form, "Problem"))
        except zenoh.ZError as failure:
            log.debug("a problem could not be told: %s", failure)
        finally:
            query.drop()  # type: ignore[no-untyped-call]

    # -- puts ----------------------------------------------------------------------------------------------------

    def put(self, row: str, where: str, message: BaseModel | None) -> None:
        """Put a message with the quality of its row in the key table, or delete what is there."""
        options = qos_options(keys.qos(row))
        if message is None:
            self._session.delete(where, **options)
        else:
            self._session.put(where, encode(message, "json"), encoding=encoding_of(message, "json"), **options)


def problem_told(error: Exception) -> Problem:
    """The problem that a client is told; what is unexpected is logged, and told without its secrets."""
    problem = problem_of(error)
    if problem.code == "internal_error":
        log.error("unexpected error", exc_info=error)
    return problem


def reply_form(query: zenoh.Query) -> Form:
    """The form to reply in: what `format` says, else that of the request, else JSON."""
    wanted = query.parameters.get("format")
    if wanted == "cbor" or wanted == "json":
        return "cbor" if wanted == "cbor" else "json"
    encoding = str(query.encoding or "")
    if query.payload is not None and not encoding.startswith(("application/cbor", "application/json")):
        return "cbor" if 0xA0 <= query.payload.to_bytes()[:1].ljust(1)[0] < 0xC0 else "json"  # a CBOR mapping
    return "cbor" if encoding.startswith("application/cbor") else "json"
