"""Plans for ground tasks, by pyperplan's search and heuristic."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import count

from reasoning.planning.grounding import GroundTask
from reasoning.planning.task import Action, Fact, Literal_

__all__ = ["improved", "search", "shortened"]


def search(task: GroundTask) -> list[Action] | None:
    """A plan, or None when there is none.

    Enforced hill-climbing with the relaxed plan's actions (Hoffmann & Nebel 2001) answers most tasks of a home; where
    it ends in a blind alley, weighted A* with the same heuristic decides.
    """
    if task.goal is None:
        return None
    from pyperplan.heuristics.relaxation import hFFHeuristic
    from pyperplan.search.a_star import weighted_astar_search
    from pyperplan.search.enforced_hillclimbing_search import enforced_hillclimbing_search
    from pyperplan.task import Operator
    from pyperplan.task import Task as StripsTask

    logging.disable(logging.INFO)
    negated = {fact for action in task.actions for holds, fact in action.conditions if not holds}
    negated |= {fact for holds, fact in task.goal if not holds}
    number: dict[Literal_, int] = {}
    fresh = count()

    def numbered(literal: Literal_) -> int:
        if literal not in number:
            number[literal] = next(fresh)
        return number[literal]

    operators = []
    for name, action in enumerate(task.actions):
        begins = {fact for holds, fact in action.effects if holds}
        ends = {fact for holds, fact in action.effects if not holds} - begins
        adds = [numbered((True, f)) for f in begins] + [numbered((False, f)) for f in ends if f in negated]
        deletes = [numbered((True, f)) for f in ends] + [numbered((False, f)) for f in begins if f in negated]
        operators.append(Operator(name, [numbered(c) for c in action.conditions], adds, deletes))
    goal = frozenset(numbered(literal) for literal in task.goal)
    init = {number[True, fact] for fact in task.init if (True, fact) in number}
    init |= {number[False, fact] for fact in negated if (False, fact) in number and fact not in task.init}
    strips = StripsTask("task", frozenset(number.values()), frozenset(init), goal, operators)
    heuristic = hFFHeuristic(strips)
    found = enforced_hillclimbing_search(strips, heuristic, use_preferred_ops=True)
    if found is None:
        found = weighted_astar_search(strips, heuristic)
    return None if found is None else improved([task.actions[op.name] for op in found], task)


def improved(plan: Sequence[Action], task: GroundTask) -> list[Action]:
    """The plan, shortened: actions that it does not need are left out, and short runs of actions replaced by one."""
    assert task.goal is not None
    best = shortened(plan, task.init, task.goal)
    while (shorter := _with_a_shortcut(best, task)) is not None:
        best = shortened(shorter, task.init, task.goal)
    return best


def _with_a_shortcut(plan: Sequence[Action], task: GroundTask) -> list[Action] | None:
    """The plan with the first two or three actions replaced that one other action can stand for."""
    state = set(task.init)
    for at, old in enumerate(plan):
        for action in task.actions:
            if not action.failing(state):
                for width in (3, 2):
                    new = [*plan[:at], action, *plan[at + width :]]
                    if at + width <= len(plan) and _reaches([action, *plan[at + width :]], state, task.goal or ()):
                        return new
        old.apply(state)
    return None


def _reaches(plan: Sequence[Action], state: set[Fact], goal: Sequence[Literal_]) -> bool:
    state = set(state)
    for action in plan:
        if action.failing(state):
            return False
        action.apply(state)
    return all((fact in state) == holds for holds, fact in goal)


def shortened(plan: Sequence[Action], init: frozenset[Fact], goal: Sequence[Literal_]) -> list[Action]:
    """The plan without actions that it does not need: each is left out, with all that then cannot be done, where the
    goal is still reached (*action elimination*, Nakhost & Müller 2010)."""
    plan = list(plan)
    at = 0
    while at < len(plan):
        state, kept = set(init), []
        for k, action in enumerate(plan):
            if k != at and (k < at or not action.failing(state)):
                action.apply(state)
                kept.append(action)
        if all((fact in state) == holds for holds, fact in goal):
            plan = kept
        else:
            at += 1
    return plan
