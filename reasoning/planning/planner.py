"""The planner's process: tasks in, plans out, ended when it does not come back in time.

Planners cannot be interrupted and may use any amount of memory; so they run in a process of their own, as the rules do.
It also keeps what planners import, which takes a second, out of programs that never plan.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import weakref
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from reasoning.errors import ReasoningError
from reasoning.planning.task import Outcome, Task

__all__ = ["Line", "Planner", "PlannerUnavailable"]

_START_TIMEOUT_S = 60.0
_MEMORY_BYTES = 4 << 30
DEFAULT = "pyperplan"


class PlannerUnavailable(ReasoningError):
    """The planner's process could not be started."""

    code = "planner_unavailable"


class Planner:
    """One process that plans; a context manager, safe to use from several threads, one task at a time.

    It is started by the first task, and again after one that had to be ended.
    """

    def __init__(self, *, memory_limit_bytes: int = _MEMORY_BYTES) -> None:
        self._memory = memory_limit_bytes
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._line: Line | None = None
        self._end: Any = None

    def __enter__(self) -> Planner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """The process's id; None while there is none."""
        return self._process.pid if self._process else None

    def solve(self, task: Task, *, timeout_s: float = 10.0, engine: str = DEFAULT) -> Outcome:
        """Look for a plan for so long; the time that the process takes to start does not count.

        engine : "pyperplan", or the name under which unified-planning knows another one ("fast-downward")
        """
        with self._lock:
            started = time.monotonic()
            line = self._running()
            began = time.monotonic()
            try:
                line.send((task, engine))
                if not line.poll(timeout_s):
                    self._stop()
                    return Outcome("timeout", message=f"no plan was found within {timeout_s:g} s")
                outcome: Outcome = line.recv()
            except (EOFError, BrokenPipeError, ConnectionResetError):
                self._stop()
                return Outcome("timeout", message="the planner used up its memory, or was ended")
            times = {"start_s": began - started, "took_s": time.monotonic() - began}
            return Outcome(outcome.status, outcome.actions, outcome.message, {**outcome.figures, **times})

    def start(self) -> None:
        """Start the process now, so that the first task need not wait for it."""
        with self._lock:
            self._running()

    def cancel(self) -> None:
        """End the process, so that whoever waits for a plan is told at once that there is none."""
        process = self._process
        if process is not None:
            process.kill()
            process.wait()

    def close(self) -> None:
        """End the process. Closing twice does nothing."""
        with self._lock:
            self._stop()

    def _running(self) -> Line:
        if self._process is not None and self._process.poll() is not None:
            self._stop()
        if self._line is None:
            self._start()
        assert self._line is not None
        return self._line

    def _start(self) -> None:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        root = str(Path(__file__).resolve().parents[2])
        code = (
            f"import sys; sys.path.insert(0, {root!r}); from reasoning.planning.worker import serve; "
            f"serve({theirs_in}, {theirs_out}, {self._memory})"
        )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(theirs_in, theirs_out),
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._line = Line(ours_in, ours_out)
        self._end = weakref.finalize(self, _end, self._process, self._line, os.getpid())
        try:
            ready = self._line.poll(_START_TIMEOUT_S) and self._line.recv() == "ready"
        except EOFError:
            ready = False
        if not ready:
            self._stop()
            raise PlannerUnavailable(
                "the planner's process did not start", hint="are unified-planning and up-pyperplan installed?"
            )

    def _stop(self) -> None:
        if self._process is not None:
            self._end()
        self._process = self._line = self._end = None


class Line:
    """Two pipes, one a direction, that carry pickled values."""

    def __init__(self, read_fd: int, write_fd: int) -> None:
        self._reader, self._writer = Connection(read_fd, writable=False), Connection(write_fd, readable=False)

    def poll(self, timeout: float | None = 0.0) -> bool:
        return self._reader.poll(timeout)

    def send(self, value: Any) -> None:
        self._writer.send(value)

    def recv(self) -> Any:
        return self._reader.recv()

    def close(self) -> None:
        self._reader.close()
        self._writer.close()


def _end(process: subprocess.Popen[bytes], line: Line, owner: int) -> None:
    if os.getpid() == owner:  # a forked copy of the owner must not end its worker
        process.kill()
        process.wait()
    line.close()
