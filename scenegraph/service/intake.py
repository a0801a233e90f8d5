"""Work that waits for the thread that owns the world: bounded, fair, and counted.

Three queues, each with its policy:

images     images and scans. The newest win: at most `images_per_stream` wait for each sensor and `images` in all;
           beyond that the oldest of the longest queue is dropped and counted. Robots take turns.
kept       all other observations, and those whose sender waits for the reply, in the order they came. Beyond
           `kept` messages or `kept_bytes` a new one is refused, and the sender is told.
requests   questions and statements, in the order they came; refused beyond `requests`. They go first, but after
           `request_share_s` of them one observation gets its turn.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from scenegraph.service.errors import Overloaded
from scenegraph.service.keys import Input
from scenegraph.service.messages import Counts

__all__ = ["Bounds", "Intake", "Job", "Tally"]

_MAX_STREAMS = 256
_OTHERS = Input("others", "others", "any")


@dataclass(frozen=True)
class Bounds:
    """How much may wait, and how long."""

    images_per_stream: int = 2
    images: int = 24
    kept: int = 5000
    kept_bytes: int = 256 << 20
    requests: int = 256
    request_share_s: float = 0.05
    request_wait_s: float = 10.0
    replies: int = 256


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work, run by the thread that owns the world; `size` in bytes, `stream` of an observation."""

    run: Callable[[], None]
    size: int = 0
    stream: Input | None = None
    since: float = field(default_factory=time.monotonic)

    @property
    def waited_s(self) -> float:
        """How long it has been waiting [s]."""
        return time.monotonic() - self.since


class Tally:
    """What became of the messages of each input stream, for at most 256 streams (the rest together, as `others`)."""

    def __init__(self) -> None:
        self._counts: dict[Input, dict[str, int]] = {}
        self._lock = threading.Lock()

    def add(self, stream: Input, what: str, n: int = 1) -> None:
        """Count `n` messages as `received`, `taken`, `dropped` or `refused`."""
        with self._lock:
            if stream not in self._counts and len(self._counts) >= _MAX_STREAMS:
                stream = _OTHERS
            row = self._counts.setdefault(stream, {"received": 0, "taken": 0, "dropped": 0, "refused": 0})
            row[what] += n

    def counts(self) -> dict[str, Counts]:
        """By `robot/sensor/kind`; what is neither taken nor dropped nor refused is waiting."""
        with self._lock:
            rows = {stream.path: dict(row) for stream, row in self._counts.items()}
        return {
            name: Counts(**row, waiting=row["received"] - row["taken"] - row["dropped"] - row["refused"])
            for name, row in rows.items()
        }


class Intake:
    """The three queues. Any thread puts; one thread takes."""

    def __init__(self, bounds: Bounds, tally: Tally) -> None:
        self._bounds = bounds
        self._tally = tally
        self._ready = threading.Condition()
        self._images: dict[Input, deque[Job]] = {}
        self._n_images = 0
        self._kept: deque[Job] = deque()
        self._kept_bytes = 0
        self._requests: deque[Job] = deque()
        self._request_s = 0.0
        self._kept_run = 0
        self._turns = itertools.count(1)
        self._last_turn: dict[object, int] = {}

    def put_image(self, job: Job) -> None:
        """Add an image or scan; when too many wait, the oldest of the longest queue is dropped."""
        assert job.stream is not None
        with self._ready:
            queue = self._images.setdefault(job.stream, deque())
            queue.append(job)
            self._n_images += 1
            if len(queue) > self._bounds.images_per_stream:
                self._drop(job.stream)
            elif self._n_images > self._bounds.images:
                self._drop(max(self._images, key=lambda stream: (len(self._images[stream]), stream != job.stream)))
            self._ready.notify()

    def put_kept(self, job: Job) -> None:
        """Add an observation that must not be lost. Raises `Overloaded` when there is no room."""
        bounds = self._bounds
        with self._ready:
            if len(self._kept) >= bounds.kept or self._kept_bytes + job.size > bounds.kept_bytes:
                raise Overloaded(
                    f"{len(self._kept)} observations ({self._kept_bytes} bytes) are waiting already; "
                    f"at most {bounds.kept} ({bounds.kept_bytes} bytes) are kept",
                    hint="send slower, or wait for the reply to each (Client.integrate)",
                )
            self._kept.append(job)
            self._kept_bytes += job.size
            self._ready.notify()

    def put_request(self, job: Job) -> None:
        """Add a request. Raises `Overloaded` when there is no room."""
        with self._ready:
            if len(self._requests) >= self._bounds.requests:
                raise Overloaded(
                    f"{len(self._requests)} requests are waiting already, at most {self._bounds.requests} are kept",
                    hint="ask again a little later",
                )
            self._requests.append(job)
            self._ready.notify()

    def take(self, timeout_s: float) -> Job | None:
        """The next job, or None when none came in time. Requests first, yet observations always get their turns."""
        with self._ready:
            if not self._any():
                self._ready.wait(timeout_s)
            observations = bool(self._kept or self._n_images)
            if self._requests and not (observations and self._request_s >= self._bounds.request_share_s):
                return self._requests.popleft()
            self._request_s = 0.0
            if self._kept and not (self._n_images and self._kept_run >= 64):
                self._kept_run += 1
                job = self._kept.popleft()
                self._kept_bytes -= job.size
                return job
            self._kept_run = 0
            return self._take_image() if self._n_images else None

    def spent_on_request(self, seconds: float) -> None:
        """Tell how long the last request took, so that observations get their turns."""
        self._request_s += seconds

    def wake(self) -> None:
        """Let `take` return."""
        with self._ready:
            self._ready.notify_all()

    @property
    def idle(self) -> bool:
        """Whether nothing waits."""
        with self._ready:
            return not self._any()

    def waiting(self) -> dict[str, int]:
        """How much waits in each queue."""
        with self._ready:
            return {"images": self._n_images, "kept": len(self._kept), "requests": len(self._requests)}

    def _any(self) -> bool:
        return bool(self._requests or self._kept or self._n_images)

    def _drop(self, stream: Input) -> None:
        self._tally.add(stream, "dropped")
        self._pop(stream)

    def _pop(self, stream: Input) -> Job:
        queue = self._images[stream]
        job = queue.popleft()
        self._n_images -= 1
        if not queue:
            del self._images[stream]
        return job

    def _take_image(self) -> Job:
        """The oldest image of the sensor that waited longest for its turn, of the robot that did."""
        last = self._last_turn
        stream = min(self._images, key=lambda s: (last.get(s.robot, 0), last.get(s, 0)))
        if len(last) > 4 * _MAX_STREAMS:
            last.clear()
        last[stream.robot] = last[stream] = next(self._turns)
        return self._pop(stream)
