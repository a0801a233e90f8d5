"""What a server remembers about itself: causes of refusal, each told once, and how long requests take."""

from __future__ import annotations

import re
import threading
import time
from collections import deque

from scenegraph.errors import Problem
from scenegraph.service.messages import Refusal

__all__ = ["Causes", "RequestTimes"]

_MAX_CAUSES = 500
_REMEMBERED = 256
_BURST, _A_SECOND = 100, 20
_NUMBERS = re.compile(r"-?[\d.]+(e[-+]?\d+)?")


class Causes:
    """Causes of refusal, counted: same place, same code, same message but for its numbers.

    At most 500 are known, the oldest are forgotten; at most 20 a second are told (100 at once), the others are counted
    only: who invents causes fills neither the memory nor the line.
    """

    def __init__(self) -> None:
        self._tellable, self._told_at = float(_BURST), time.monotonic()
        self._causes: dict[tuple[str, str, str], Refusal] = {}
        self._lock = threading.Lock()
        self.total = 0

    def add(self, source: str, problem: Problem) -> Refusal | None:
        """Count one more refusal; returns it when its cause is new, and so is to be told."""
        cause = (source, problem.code, _NUMBERS.sub("#", problem.message.partition(" (value")[0])[:200])
        with self._lock:
            self.total += 1
            known = self._causes.pop(cause, None)
            count = known.count + 1 if known else 1
            hint = problem.hint
            refusal = Refusal(code=problem.code, message=problem.message, hint=hint, source=source, count=count)
            self._causes[cause] = refusal
            if len(self._causes) > _MAX_CAUSES:
                del self._causes[next(iter(self._causes))]
            return refusal if known is None and self._may_tell() else None

    def _may_tell(self) -> bool:
        now = time.monotonic()
        self._tellable = min(_BURST, self._tellable + _A_SECOND * (now - self._told_at))
        self._told_at = now
        if self._tellable < 1.0:
            return False
        self._tellable -= 1.0
        return True

    def all(self) -> tuple[Refusal, ...]:
        """The causes, the one met last at the end."""
        with self._lock:
            return tuple(self._causes.values())


class RequestTimes:
    """How many requests of each verb there were, how many failed, and how long the latest took [ms]."""

    def __init__(self) -> None:
        self._verbs: dict[str, list[int]] = {}
        self._latest: dict[str, deque[float]] = {}
        self._lock = threading.Lock()

    def add(self, verb: str, elapsed_s: float, failed: bool) -> None:
        """Count one request."""
        with self._lock:
            row = self._verbs.setdefault(verb, [0, 0])
            row[0] += 1
            row[1] += failed
            self._latest.setdefault(verb, deque(maxlen=_REMEMBERED)).append(1e3 * elapsed_s)

    def figures(self) -> dict[str, dict[str, float]]:
        """By verb: `count`, `failed`, and `median_ms` and `worst_ms` of the latest 256."""
        with self._lock:
            counts = {verb: (count, failed) for verb, (count, failed) in self._verbs.items()}
            latest = {verb: sorted(times) for verb, times in self._latest.items()}
        return {
            verb: {
                "count": count,
                "failed": failed,
                "median_ms": round(latest[verb][len(latest[verb]) // 2], 3),
                "worst_ms": round(latest[verb][-1], 3),
            }
            for verb, (count, failed) in counts.items()
        }
