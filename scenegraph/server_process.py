"""A server as a process of its own, as long as it is needed."""

from __future__ import annotations

import json
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from scenegraph.service.errors import ServerUnreachable

__all__ = ["free_endpoint", "heed", "server_process"]

_START_S = 120.0
_SAVE_S = 60.0

_told_to_end = threading.Event()


def free_endpoint() -> str:
    """A loopback endpoint at which nothing listens yet."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def server_process(world: str, store: Path, log: Path) -> Iterator[str]:
    """Run `scenegraph serve` at a free endpoint, which is the value; told to end when the block is left, however it is.

    store   where it saves the world at its end
    log     the file that gets what it has to say

    Raises `ServerUnreachable` when it does not start, or did not end well.
    """
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "scenegraph.cli", "serve", "--json", "--world", world, "--endpoint", endpoint]
    command += ["--store", str(store.absolute()), "--save-every-s", "0"]
    with log.open("wb") as errors, _ended_by_sigterm():
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
        try:
            assert process.stdout is not None
            _await_start(process, process.stdout, log)
            yield endpoint
        finally:
            status = _end(process)
    if status != 0:
        raise ServerUnreachable(f"the server ended with status {status}", hint=_last_words(log))


def _await_start(process: subprocess.Popen[bytes], out: IO[bytes], log: Path) -> None:
    ready, _, _ = select.select([out], [], [], _START_S)
    told = json.loads((out.readline() if ready else b"") or b"{}")  # where it listens, or what its problem is
    if "endpoint" in told:
        return
    if ready:
        process.wait(_SAVE_S)
    why = f"within {_START_S:g} s" if process.poll() is None else f"and ended with status {process.returncode}"
    raise ServerUnreachable(f"the server did not start {why}", hint=_last_words(log))


def _end(process: subprocess.Popen[bytes]) -> int:
    """Tell the process to end; its status. It has time to save, unless a second Ctrl-C comes."""
    process.terminate()
    try:
        return process.wait(_SAVE_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _last_words(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
    return f"{last[:200]}; see {log}"


def _end_program(*_: object) -> None:
    _told_to_end.set()
    signal.raise_signal(signal.SIGINT)


def heed() -> None:
    """Raise `KeyboardInterrupt` when this program was told to end but the interrupt was lost, as it is when it falls
    into a
    callback of compiled code. For long loops in a `server_process` block."""
    if _told_to_end.is_set():
        raise KeyboardInterrupt


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end this program as Ctrl-C does, so that no server is left behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _told_to_end.clear()
    before = signal.signal(signal.SIGTERM, _end_program)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
