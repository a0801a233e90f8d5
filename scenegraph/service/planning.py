"""Requests for plans: the graph is read by the thread that owns the world, the planner is waited for by another.

Planning yields one task after the other (`World.planning`). Each is solved here, in a thread that waits for the
planner's process, while the world goes on; what was found is then a job for the world's thread again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import zenoh

from reasoning.errors import ReasoningError
from scenegraph.service import replies
from scenegraph.service.errors import Overloaded
from scenegraph.service.health import RequestTimes
from scenegraph.service.intake import Intake, Job
from scenegraph.service.messages import PlanRequest
from scenegraph.service.sender import Sender

__all__ = ["PlanRequests"]

_WAITING = 16


class PlanRequests:
    """Plans for those who ask, one task at a time.

    world         its `planning` runs on the thread that takes jobs from `intake`, its `planner` solves
    max_timeout_s no plan may take longer
    """

    def __init__(self, world: Any, intake: Intake, sender: Sender, times: RequestTimes, max_timeout_s: float) -> None:
        self._world = world
        self._intake = intake
        self._sender = sender
        self._times = times
        self._max_timeout_s = max_timeout_s
        self._room = threading.BoundedSemaphore(_WAITING)
        self._solvers = ThreadPoolExecutor(1, thread_name_prefix="plan")

    def close(self) -> None:
        """Take no more tasks, and give up the one that is being solved."""
        self._solvers.shutdown(wait=False, cancel_futures=True)
        if hasattr(self._world, "planner"):
            self._world.planner.cancel()

    def admit(self, query: zenoh.Query, read: Callable[[], PlanRequest]) -> None:
        """Queue a request for a plan. Raises `Overloaded` when too many are waiting."""
        if not self._room.acquire(blocking=False):
            raise Overloaded(f"{_WAITING} plans are being made already", hint="ask again a little later")
        try:
            self._intake.put_request(Job(lambda: self._begin(query, read, time.perf_counter())))
        except Exception:
            self._room.release()
            raise

    # -- on the world's thread -----------------------------------------------------------------------------------
    def _begin(self, query: zenoh.Query, read: Callable[[], PlanRequest], began: float) -> None:
        try:
            request = read()
            timeout_s = min(request.timeout_s, self._max_timeout_s)
            planning = self._world.planning(request.goal, robot=request.robot, timeout_s=timeout_s)
        except Exception as error:
            self._end(query, began, error)
            return
        self._go_on(query, began, planning, lambda: next(planning))

    def _go_on(self, query: zenoh.Query, began: float, planning: Any, resume: Callable[[], Any]) -> None:
        """Plan until the next task or the end."""
        since = time.perf_counter()
        try:
            order = resume()
            self._solvers.submit(self._solve, query, began, planning, order)
        except StopIteration as done:
            reply = replies.plan_reply(done.value)
            try:
                self._sender.soon(query, lambda: self._sender.reply(query, "plan", reply))
                self._end(query, began, None)
            except Overloaded as error:
                self._end(query, began, error)
        except Exception as error:
            self._end(query, began, error)
        finally:
            self._intake.spent_on_request(time.perf_counter() - since)

    # -- on the thread that waits --------------------------------------------------------------------------------
    def _solve(self, query: zenoh.Query, began: float, planning: Any, order: Any) -> None:
        def resume() -> Any:
            return planning.throw(failure) if failure is not None else planning.send(outcome)

        outcome, failure = None, None
        try:
            outcome = self._world.planner.solve(order.task, timeout_s=order.timeout_s)
        except ReasoningError as error:
            failure = error
        try:
            self._intake.put_request(Job(lambda: self._go_on(query, began, planning, resume)))
        except Overloaded as error:
            self._end(query, began, error)

    def _end(self, query: zenoh.Query, began: float, error: Exception | None) -> None:
        self._room.release()
        self._times.add("plan", time.perf_counter() - began, error is not None)
        if error is not None:
            self._sender.problem(query, error)
