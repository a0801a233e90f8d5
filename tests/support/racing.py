"""Timing beside peers: both take turns in one process, so that what else the machine does meets them alike."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

Step = Callable[[int], object]
"""What is timed; it is given the number of the round."""


@dataclass(frozen=True)
class Times:
    """How long each round took [ms], by the clock and in the processor's time, of all threads together.

    The latter does not count what other programs take, nor does it gain by threads.
    """

    all_ms: list[float]
    cpu_ms: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        return float(np.median(self.all_ms))

    @property
    def least(self) -> float:
        return float(np.min(self.all_ms))

    @property
    def cpu(self) -> float:
        return float(np.median(self.cpu_ms)) if len(self.cpu_ms) else float("nan")

    def __str__(self) -> str:
        cpu = f"; {self.cpu:.3g}" if self.cpu_ms else ""
        return f"{self.median:.3g} ({self.least:.3g}{cpu})"


def race(
    benchmark: Any,
    ours: Step,
    peers: Mapping[str, Step],
    *,
    rounds: int,
    peer_every: int = 1,
    prepare: Step | None = None,
) -> tuple[Times, dict[str, Times]]:
    """Time `ours` in every round, and before every `peer_every`-th of them each peer. `prepare` is not timed."""
    own = Clocked(ours)
    of_peers = {name: Clocked(peer) for name, peer in peers.items()}
    n = -1

    def before() -> tuple[tuple[int], dict[str, object]]:
        nonlocal n
        n += 1
        if n % peer_every == 0:
            for peer in of_peers.values():
                peer(n // peer_every)
        if prepare is not None:
            prepare(n)
        return (n,), {}

    if prepare is None:
        ours(0)
    gc.collect()
    benchmark.pedantic(own, setup=before, rounds=rounds)
    return own.times, {name: peer.times for name, peer in of_peers.items()}


class Clocked:
    """A step that writes down how long it takes."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self.times = Times([], [])

    def __call__(self, n: int) -> None:
        started, at_work = time.perf_counter(), time.process_time()
        self.step(n)
        self.times.cpu_ms.append(1e3 * (time.process_time() - at_work))
        self.times.all_ms.append(1e3 * (time.perf_counter() - started))


@dataclass(frozen=True)
class Row:
    """One line of the table. must: largest allowed time [ms] or share of the peer's; bound: no program could be faster
    than this [ms], as the memory alone takes so long."""

    case: str
    mode: str
    ours: Times
    peer: str = "–"
    theirs: Times | None = None
    must_ms: float | None = None
    must_share: float | None = None
    bound_ms: float | None = None

    def cells(self) -> list[str]:
        ratio = theirs = "–"
        if self.theirs is not None:
            theirs = str(self.theirs)
            ratio = f"{_share(self._ratio('median'))} ({_share(self._ratio('least'))}; {_share(self._ratio('cpu'))})"
        bound = "–" if self.bound_ms is None else f"{self.bound_ms:.2g}"
        return [self.case, self.mode, str(self.ours), self.peer, theirs, ratio, self._verdict(), bound]

    def _ratio(self, of: str) -> float:
        assert self.theirs is not None
        return float(getattr(self.ours, of) / getattr(self.theirs, of))

    def _verdict(self) -> str:
        must = []
        if self.must_ms is not None:
            must.append(f"{self.must_ms:g} ms")
        if self.must_share is not None and self.theirs is not None:
            must.append(_share(self.must_share))
        if not must:
            return "–"
        met = "met" if self._meets("median") else "met by the least" if self._meets("least") else "NOT met"
        return f"≤ {' and '.join(must)}: {met}"

    def _meets(self, of: str) -> bool:
        fast = self.must_ms is None or getattr(self.ours, of) <= self.must_ms
        faster = self.must_share is None or self.theirs is None or self._ratio(of) <= self.must_share
        return fast and faster


def _share(value: float) -> str:
    return f"1/{1 / value:.3g}" if value < 1.0 else f"{value:.3g}"


@dataclass
class Table:
    """What all races gave, and what else was measured."""

    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, case: str, mode: str, ours: Times, theirs: Mapping[str, Times], **limits: Any) -> None:
        """One row a peer; `must_share` may be a mapping from peer to share."""
        shares = limits.pop("must_share", None)
        for name, taken in theirs.items():
            share = shares.get(name) if isinstance(shares, Mapping) else shares
            self.rows.append(Row(case, mode, ours, name, taken, must_share=share, **limits))
        if not theirs:
            self.rows.append(Row(case, mode, ours, **limits))

    def lines(self) -> list[str]:
        """The table, set in columns."""
        head = ["case", "mode", "ours ms: median (least; cpu)", "peer", "its ms", "ours ÷ peer", "must", "bound ms"]
        return (columns([head, *(row.cells() for row in self.rows)]) if self.rows else []) + self.notes


def columns(cells: Sequence[Sequence[str]]) -> list[str]:
    """Lines with all columns below each other; the first is the head."""
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    lines = [" | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in cells]
    return [lines[0], "-+-".join("-" * width for width in widths), *lines[1:]]


@cache
def bytes_per_ms() -> float:
    """What the machine copies from memory to memory, read and written bytes together."""
    source = np.ones(1 << 25)
    target = np.zeros_like(source)
    taken = []
    for _ in range(7):
        started = time.perf_counter()
        np.copyto(target, source)
        taken.append(time.perf_counter() - started)
    return float(2 * source.nbytes / (1e3 * min(taken)))
