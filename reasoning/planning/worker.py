"""The planner's side of the line: solves one task after the other. Runs in a process of its own."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import lru_cache
from typing import Any

from reasoning.planning.formulas import Schemas, conjuncts, read_schemas
from reasoning.planning.grounding import TooLarge, ground_task
from reasoning.planning.planner import DEFAULT, Line
from reasoning.planning.search import search
from reasoning.planning.task import Action, Outcome, Task, household
from reasoning.planning.unified import DomainUnreadable, read_domain, solve_with

__all__ = ["serve", "solve"]


def serve(request_fd: int, reply_fd: int, memory_limit_bytes: int) -> None:
    """Answer tasks until the line closes."""
    import resource
    import signal

    resource.setrlimit(resource.RLIMIT_AS, (memory_limit_bytes, memory_limit_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for our owner to act on
    line = Line(request_fd, reply_fd)
    _schemas(household().text)
    import pyperplan.search  # noqa: F401  the first task need not wait for it

    line.send("ready")
    while True:
        try:
            task, engine = line.recv()
        except EOFError:
            os._exit(0)
        line.send(solve(task, engine))


@lru_cache(maxsize=16)
def _schemas(text: str) -> Schemas:
    return read_schemas(read_domain(text))


def solve(task: Task, engine: str = DEFAULT) -> Outcome:
    """A plan for a task, in this process and for as long as it takes."""
    try:
        if engine == DEFAULT:
            return _solve(task)
        outcome = solve_with(task, engine)
        return replace(outcome, actions=_filled(task, outcome.actions)) if outcome.actions else outcome
    except (DomainUnreadable, TooLarge, ValueError) as error:
        return Outcome("unsupported", message=str(error))
    except MemoryError:
        return Outcome("unsupported", message="the task needs more memory than the planner may use")


def _solve(task: Task) -> Outcome:
    schemas = _schemas(task.domain.text)
    began = time.perf_counter()
    grounded = ground_task(task, schemas)
    between = time.perf_counter()
    plan = search(grounded)
    figures: dict[str, Any] = {
        "actions": len(grounded.actions),
        "ground_s": between - began,
        "search_s": time.perf_counter() - between,
    }
    if plan is None:
        return Outcome("unsolvable", figures=figures)
    return Outcome("solved", tuple(_whole(action, schemas) for action in plan), figures=figures)


def _filled(task: Task, bare: tuple[Action, ...]) -> tuple[Action, ...]:
    """Actions of which only names and arguments are known, with what they need and change, in the order of a plan."""
    schemas = _schemas(task.domain.text)
    known: dict[tuple[str, tuple[str, ...]], list[Action]] = {}
    for action in ground_task(task, schemas).actions:
        known.setdefault((action.name, action.arguments), []).append(action)
    state, found = set(task.init), []
    for step in bare:
        action = next(a for a in known[step.name, step.arguments] if not a.failing(state))
        action.apply(state)
        found.append(_whole(action, schemas))
    return tuple(found)


def _whole(action: Action, schemas: Schemas) -> Action:
    """An action with those of its conditions that nothing changes in the domain, but something may in the world."""
    schema = next(schema for schema in schemas.actions if schema.name == action.name)
    binding = dict(zip((name for name, _ in schema.parameters), action.arguments, strict=True))
    fluents = schemas.fluents
    lasting = [
        (True, (part[1], *(binding.get(term, term) for term in part[2])))
        for part in conjuncts(schema.condition)
        if part[0] == "atom" and part[1] not in fluents
    ]
    return replace(action, conditions=(*action.conditions, *lasting))
