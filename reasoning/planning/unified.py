"""Tasks and plans in unified-planning: to be read from PDDL, solved by other planners, and checked by its validator."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from reasoning.planning.task import Action, Outcome, Task

__all__ = ["DomainUnreadable", "read_domain", "read_problem", "solve_with", "to_unified", "validate"]


class DomainUnreadable(ValueError):
    """A text is no domain that unified-planning can read."""

    code = "domain_unreadable"


@lru_cache(maxsize=16)
def read_domain(text: str) -> Any:
    """The domain as a `unified_planning.model.Problem` without objects. Raises `DomainUnreadable`."""
    return read_problem(text, None)


def read_problem(domain: str, problem: str | None) -> Any:
    """A problem, or a domain alone, from PDDL texts. Raises `DomainUnreadable`."""
    from unified_planning.io import PDDLReader

    try:
        with _settings():
            return PDDLReader().parse_problem_string(domain, problem)
    except Exception as error:  # the reader raises errors of its parser, of its own and plain ones
        first = str(error).strip().splitlines() or [type(error).__name__]
        raise DomainUnreadable(f"domain: unified-planning cannot read it: {first[0]}") from error


def to_unified(task: Task) -> Any:
    """The task as a `unified_planning.model.Problem`."""
    problem = read_domain(task.domain.text).clone()
    problem.name = task.name
    with _settings():
        _fill(problem, task)
    return problem


@contextmanager
def _settings() -> Iterator[None]:
    """Let a predicate, an action and an object have one name, as PDDL does, and print neither credits nor warnings that
    are not ours to act on. (The reader knows no environment but the global one: quantified variables of others are
    refused.)"""
    from unified_planning.environment import get_environment

    environment = get_environment()
    environment.credits_stream = None
    before, environment.error_used_name = environment.error_used_name, False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        environment.error_used_name = before


def _fill(problem: Any, task: Task) -> None:
    known = {o.name for o in problem.all_objects}
    for name, kind in sorted(task.objects.items()):
        if name not in known:
            problem.add_object(name, problem.user_type(kind))
    manager = problem.environment.expression_manager

    def atom(fact: Sequence[str]) -> Any:
        return problem.fluent(fact[0])(*(problem.object(name) for name in fact[1:]))

    for fact in sorted(task.init):
        problem.set_initial_value(atom(fact), True)
    for holds, fact in task.goal:
        problem.add_goal(atom(fact) if holds else manager.Not(atom(fact)))


def solve_with(task: Task, engine: str) -> Outcome:
    """A plan by a planner that unified-planning knows under a name, such as "fast-downward".

    What an action needs and changes is found by grounding the task, as for our own search.
    """
    from unified_planning.engines import PlanGenerationResultStatus as Found
    from unified_planning.exceptions import UPException
    from unified_planning.shortcuts import OneshotPlanner

    problem = to_unified(task)
    try:
        with _settings(), OneshotPlanner(name=engine) as planner:
            planner.skip_checks = False
            result = planner.solve(problem)
    except (UPException, ImportError, AssertionError) as error:
        return Outcome("unsupported", message=f"{engine}: {str(error).strip() or type(error).__name__}")
    if result.plan is None:
        proven = result.status in (Found.UNSOLVABLE_PROVEN, Found.UNSOLVABLE_INCOMPLETELY)
        return Outcome("unsolvable" if proven else "timeout", message=f"{engine}: {result.status.name.lower()}")
    steps = [(step.action.name, tuple(str(p) for p in step.actual_parameters)) for step in result.plan.actions]
    return Outcome("solved", tuple(Action(name, arguments, (), ()) for name, arguments in steps))


def validate(task: Task, actions: Sequence[Action]) -> str | None:
    """None when unified-planning's validator finds the plan valid, else why not."""
    from unified_planning.engines import SequentialPlanValidator
    from unified_planning.plans import ActionInstance, SequentialPlan

    problem = to_unified(task)
    plan = SequentialPlan(
        [
            ActionInstance(
                problem.action(action.name),
                tuple(problem.environment.expression_manager.ObjectExp(problem.object(a)) for a in action.arguments),
            )
            for action in actions
        ],
        problem.environment,
    )
    with _settings():
        result = SequentialPlanValidator(environment=problem.environment).validate(problem, plan)
    if result.status.name == "VALID":
        return None
    told = [str(message.message) for message in result.log_messages or ()]
    return re.sub(r"\s+", " ", "; ".join([str(result.reason), *told]))
