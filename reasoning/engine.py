"""The Prolog process: one worker behind a pipe, fed with text, answering in JSON, killed when it does not come back.

The worker is a process of its own because SWI-Prolog has one open query a process, cannot be interrupted everywhere
(big-number arithmetic, unification of huge terms), and dies when memory ends. It talks over two private pipes, so that
whatever a rule file prints cannot corrupt an answer, and it needs no `__main__` guard in the program that starts it.
"""

from __future__ import annotations

import ctypes
import os
import select
import struct
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, cast

from reasoning.errors import EngineUnavailable, InvalidRules
from reasoning.terms import Atom, Compound, Term, decode_json, term_text
from rules import rule_path

__all__ = ["Engine", "learning", "problem"]

_HEADER = struct.Struct("<QQ")
_GRACE_S = 0.5
_START_TIMEOUT_S = 30.0
_BATCH_CHARACTERS = 8_000_000
"""Facts are told in batches: what the worker is told at once stands on its stacks as a whole."""


def problem(code: str, message: str, hint: str = "") -> Compound:
    """The term in which both sides of the pipe say what went wrong."""
    return Compound("problem", (Atom(code), message, hint))


def learning(rules: str, names: Literal["known", "any", "signatures"]) -> Compound:
    """The command to take in the rules of that name; which things and classes they may name: see `learn/4` in
    `rules/told_rules.pl`."""
    return Compound("learn", (Atom(rules), Atom(names)))


def _timed_out() -> Compound:
    return problem("timeout", "the goal did not end in the time it was given and had to be broken off")


class Engine:
    """One Prolog worker process with the rule base loaded; a context manager, safe to use from several threads.

    rule_files         : a user's own rules, loaded after ours; an error or a warning in one raises `InvalidRules`
    remembered         : gives the text of all facts, which a new worker is told when the old one had to be killed
    remembered_rules   : gives the texts of the rules that were told, by their names, which it is told after that
    stack_limit_bytes  : what one goal may use on Prolog's stacks
    memory_limit_bytes : what the whole process may use; beyond it, it is replaced
    """

    def __init__(
        self,
        rule_files: Sequence[Path | str] = (),
        *,
        remembered: Callable[[], str] = str,
        remembered_rules: Callable[[], Mapping[str, str]] = dict,
        stack_limit_bytes: int = 256 << 20,
        memory_limit_bytes: int = 4 << 30,
    ) -> None:
        self._rule_files = [Path(file).resolve() for file in rule_files]
        for file in self._rule_files:
            if not file.is_file():
                raise InvalidRules(f"rule_files: {str(file)!r} is not a file")
        self._remembered, self._remembered_rules = remembered, remembered_rules
        self._limits = (stack_limit_bytes, memory_limit_bytes)
        self._lock = threading.RLock()
        self._process: subprocess.Popen[bytes] | None = None
        self._to_worker = self._from_worker = -1
        self.restarts = 0
        self._start()

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """The worker's process id; None once closed."""
        return self._process.pid if self._process else None

    def ping(self) -> bool:
        """Whether the worker answers (a dead one is replaced on the way)."""
        return self.request(Atom("ping"), timeout_s=5.0) == Atom("pong")

    def request(self, command: Term, payload: str = "", *, timeout_s: float) -> Term:
        """Carry out one command and return its result, or `problem(Code, Message, Hint)`.

        A worker that has not answered within `timeout_s` and a little grace is killed and replaced.
        """
        if not _is_unicode(payload):
            return problem("syntax_error", "the text holds half a surrogate pair: expected characters of Unicode")
        with self._lock:
            self._ensure_running()
            for _ in range(2):  # a worker that died may have been killed from outside: the next one shows
                try:
                    return self._exchange(command, payload, timeout_s)
                except TimeoutError:
                    self._restart()
                    return _timed_out()
                except (EOFError, BrokenPipeError):
                    self._restart()
            return problem("resource_limit", "the goal used up the engine's memory twice; the engine was started anew")

    def tell(self, change: Callable[[], str]) -> Term:
        """Carry out `change` on what is remembered and tell the worker the text that it returns.

        A worker that dies over it is replaced, and the new one is told everything that is then remembered.
        """
        with self._lock:
            self._ensure_running()
            text = change()
            if not text:
                return Atom("updated")
            try:
                return self._update(text)
            except (TimeoutError, EOFError, BrokenPipeError):
                self._restart()
                return Atom("updated")

    def _ensure_running(self) -> None:
        if self._process is None:
            raise EngineUnavailable("the engine was closed")
        if self._process.poll() is not None:
            self._restart()

    def close(self) -> None:
        """End the worker. Closing twice does nothing."""
        with self._lock:
            self._stop()
            self._process = None

    def _update(self, text: str) -> Term:
        """Tell the worker changes, one a line: what came of the last batch, or of the first that was refused."""
        result: Term = Atom("updated")
        for batch in _batches(text):
            result = self._exchange(Atom("update"), batch, _START_TIMEOUT_S + len(batch) / 1e6)
            if result != Atom("updated"):
                break
        return result

    def _exchange(self, command: Term, payload: str, timeout_s: float) -> Term:
        self._send(command, payload)
        return self._receive(time.monotonic() + timeout_s + _GRACE_S)

    def _send(self, command: Term, payload: str) -> None:
        head, body = term_text(command).encode(), payload.encode()
        _write(self._to_worker, _HEADER.pack(len(head), len(body)) + head + body)

    def _receive(self, deadline: float) -> Term:
        (size, _) = _HEADER.unpack(_read(self._from_worker, _HEADER.size, deadline))
        return decode_json(_read(self._from_worker, size, deadline))

    def _start(self) -> None:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        package_root = str(Path(__file__).resolve().parent.parent)
        call = f"serve({theirs_in}, {theirs_out}, {self._limits[0]}, {self._limits[1]})"
        code = f"import sys; sys.path.insert(0, {package_root!r}); from reasoning.engine import serve; {call}"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(theirs_in, theirs_out),
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._to_worker, self._from_worker = ours_out, ours_in
        self._end = weakref.finalize(self, _end, self._process, (ours_in, ours_out), os.getpid())
        ours = [str(file) for file in sorted(rule_path().glob("*.pl"))]
        try:
            load = Compound("load", (ours, [str(file) for file in self._rule_files]))
            loaded = self._exchange(load, "", _START_TIMEOUT_S)
            facts = self._remembered()
            if facts and loaded == Atom("loaded"):
                self._update(facts)
            rules = self._remembered_rules().items()
            for names in cast("tuple[Literal['signatures', 'any'], ...]", ("signatures", "any")):
                for name, text in rules:
                    self._exchange(learning(name, names), text, _START_TIMEOUT_S)
        except (TimeoutError, EOFError, BrokenPipeError) as error:
            self._stop()
            raise EngineUnavailable(
                "the Prolog worker did not start", hint="is SWI-Prolog (swi-prolog-nox) installed?"
            ) from error
        if loaded != Atom("loaded"):
            self._stop()
            assert isinstance(loaded, Compound)
            raise InvalidRules(str(loaded.args[1]))

    def _restart(self) -> None:
        self._stop()
        self.restarts += 1
        self._start()

    def _stop(self) -> None:
        if self._process is not None:
            self._end()


def _end(process: subprocess.Popen[bytes], pipes: tuple[int, int], owner: int) -> None:
    if os.getpid() == owner:  # a forked copy of the owner must not end its worker
        process.kill()
        process.wait()
    for pipe in pipes:
        os.close(pipe)


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _batches(text: str) -> Iterator[str]:
    """`text` in pieces of whole lines."""
    start = 0
    while len(text) - start > _BATCH_CHARACTERS and (end := text.find("\n", start + _BATCH_CHARACTERS)) >= 0:
        yield text[start:end]
        start = end + 1
    yield text[start:]


def _write(pipe: int, message: bytes) -> None:
    view = memoryview(message)
    while view:
        view = view[os.write(pipe, view) :]


def _read(pipe: int, size: int, deadline: float | None = None) -> bytes:
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    chunks: list[bytes] = []
    while size:
        if deadline is not None and not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
            raise TimeoutError
        chunk = os.read(pipe, min(size, 1 << 20))
        if not chunk:
            raise EOFError
        chunks.append(chunk)
        size -= len(chunk)
    return b"".join(chunks)


# ---------------------------------------------------------------------------------------------------------------------
# The worker's side


def serve(request_pipe: int, reply_pipe: int, stack_limit_bytes: int, memory_limit_bytes: int) -> None:
    """Be the worker: answer commands until the pipe closes. Runs in a process of its own."""
    import resource
    import signal

    resource.setrlimit(resource.RLIMIT_AS, (memory_limit_bytes, memory_limit_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    prolog = _Prolog(stack_limit_bytes)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole terminal, but is for our owner to act on
    while True:
        try:
            head, body = _HEADER.unpack(_read(request_pipe, _HEADER.size))
            command, payload = _read(request_pipe, head), _read(request_pipe, body)
        except EOFError:
            os._exit(0)
        reply = prolog.serve(command, payload)
        _write(reply_pipe, _HEADER.pack(len(reply), 0) + reply)


class _Prolog:
    """SWI-Prolog in this process, reached through one predicate: bridge:serve(+Command, +Payload, -Reply)."""

    def __init__(self, stack_limit_bytes: int) -> None:
        from pyswip import core

        self._core: Any = core
        self._text = core.PL_STRING | core.REP_UTF8
        self._get_chars = core._lib.PL_get_nchars
        self._get_chars.argtypes = [
            core.term_t,
            ctypes.POINTER(ctypes.c_size_t),
            ctypes.POINTER(ctypes.c_void_p),
            ctypes.c_uint,
        ]
        for goal in (
            "set_prolog_flag(debug_on_error, false)",
            f"set_prolog_flag(stack_limit, {stack_limit_bytes})",
            f"load_files({term_text(Atom(str(rule_path('bridge'))))}, [silent(true)])",
        ):
            frame = core.PL_open_foreign_frame()
            term = core.PL_new_term_ref()
            if not (core.PL_chars_to_term(goal.encode(), term) and core.PL_call(term, None)):
                raise SystemExit(f"prolog: {goal} failed")
            core.PL_discard_foreign_frame(frame)
        self._serve = core.PL_predicate(b"serve", 3, b"bridge")

    def serve(self, command: bytes, payload: bytes) -> bytes:
        """One command's reply, JSON as UTF-8."""
        core = self._core
        frame = core.PL_open_foreign_frame()
        arguments = core.PL_new_term_refs(3)
        core.PL_put_chars(arguments, self._text, len(command), command)
        core.PL_put_chars(arguments + 1, self._text, len(payload), payload)
        query = core.PL_open_query(None, core.PL_Q_NODEBUG | core.PL_Q_CATCH_EXCEPTION, self._serve, arguments)
        try:
            if not core.PL_next_solution(query):
                return b'["problem","engine_error",{"s":"the engine could not carry out the command"},{"s":""}]'
            size, text = ctypes.c_size_t(), ctypes.c_void_p()
            flags = core.CVT_STRING | core.REP_UTF8 | core.BUF_MALLOC
            if not self._get_chars(arguments + 2, ctypes.byref(size), ctypes.byref(text), flags):
                return b'["problem","engine_error",{"s":"the engine gave no text"},{"s":""}]'
            reply = ctypes.string_at(text, size.value)
            core._lib.PL_free(text)
            return reply
        finally:
            core.PL_close_query(query)
            core.PL_discard_foreign_frame(frame)
