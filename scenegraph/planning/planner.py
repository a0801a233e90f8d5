"""From a goal to a plan: rooms first, then what is to be done in them.

1. The goal is taken apart (`goals.py`): wishes, and the things that they may be about.
2. For each group of wishes the cheapest choice of things is found, by the rooms they are in and the ways between
   rooms; what cannot be done at all is sorted out here, with reasons.
3. The groups are put in an order that visits near rooms first, and what others need before what needs it.
4. One small task after the other is given to the planner, each about what its wishes depend on and the rooms and doors
   on the way (its `Scope`), beginning where the one before it ends and keeping what was reached. Where that order leads
   nowhere, the next best choice is tried, and then everything in one task.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias, TypeVar

from reasoning.knowledge import Problem
from reasoning.planning import Action, Outcome, Task, household
from scenegraph.errors import GoalRefused
from scenegraph.planning.goals import Aim, Chooser, Goal, Group, Literal, Wish
from scenegraph.planning.plan import Plan, PlanStatus
from scenegraph.planning.situation import Scope, Situation

__all__ = ["Order", "Planning", "TaskPlanner", "whole_task"]

MOST_TRIES = 12


class Order(NamedTuple):
    """A task that is to be solved within some seconds, before planning goes on."""

    task: Task
    timeout_s: float


_T = TypeVar("_T")
Planning: TypeAlias = Generator[Order, Outcome, _T]
"""Planning yields what it wants solved and is sent what was found, so that whoever runs it decides where the solver
works: a server reads the graph in one thread, and waits for solvers in another."""


class TaskPlanner:
    """Plans in the household domain."""

    def __init__(self, timeout_s: float) -> None:
        self._deadline = time.monotonic() + timeout_s

    def plan(self, goal: Goal, situation: Situation) -> Planning[Plan]:
        """A plan for a goal, without poses. Raises `GoalRefused` when the goal cannot be planned for."""
        start = situation.fork()
        if situation.room is None:
            raise GoalRefused(
                "robot_unknown",
                f"nobody knows where {situation.robot} is",
                "publish its AgentPose, or tell which room it is in",
            )
        actions: list[Action] = []
        scope = Scope()
        reached: list[Literal] = []
        left = list(goal.groups)
        while left:
            group, aims = self._next(left, situation)
            left.remove(group)
            found = yield from self._bring_about(aims, situation, reached)
            if found is None:
                return (yield from self._together(goal, start))
            aim, wide, outcome = found
            if outcome.status == "timeout":
                return self._result("timeout", goal, start, problem=Problem("timeout", outcome.message))
            for action in outcome.actions:
                situation.advance(action)
            actions += outcome.actions
            reached += [literal for literal in aim.literals if literal not in reached]
            scope.join(wide)
        task = _task(start, start.widen(scope), reached)
        if not _valid(task, actions):
            return (yield from self._together(goal, start))
        return self._result("solved", goal, start, task, actions)

    # -- one group after the other -------------------------------------------------------------------------------
    def _next(self, left: Sequence[Group], situation: Situation) -> tuple[Group, list[Aim]]:
        """The group to bring about next, with the ways to do so."""
        chooser = Chooser(situation)
        options = []
        for number, group in enumerate(left):
            aims, reasons = chooser.aims(group)
            if not aims:
                raise _impossible(group, reasons)
            options.append((_turn(group, left, situation.robot), aims[0].cost, number, group, aims))
        _, _, _, group, aims = min(options, key=lambda option: option[:3])
        return group, aims

    def _bring_about(
        self, aims: Sequence[Aim], situation: Situation, reached: Sequence[Literal]
    ) -> Planning[tuple[Aim, Scope, Outcome] | None]:
        """The first of some aims that a plan leads to, without giving up what was reached."""
        spoken_for = {fact[1] for holds, fact in reached if holds and fact[0] in ("on", "in")}
        untouched = [aim for aim in aims if not aim.about & spoken_for] or list(aims)
        for aim in untouched[:MOST_TRIES]:
            if any((not holds, fact) in reached for holds, fact in aim.literals):
                continue
            kept = Scope(things={a for _, fact in reached for a in fact[1:] if self._is_thing(a, situation)})
            kept.join(aim.scope)
            wide = situation.widen(kept)
            outcome = yield from self._doors_first(aim, situation, wide, reached)
            if outcome.status in ("solved", "timeout"):
                return aim, wide, outcome
            if outcome.status == "unsupported":
                raise GoalRefused("planner_failed", outcome.message)
        return None

    def _doors_first(
        self, aim: Aim, situation: Situation, scope: Scope, reached: Sequence[Literal]
    ) -> Planning[Outcome]:
        """Open the doors through which something will be carried, since full hands open none; then the aim."""
        doors = [("opened", door) for door in _doors_to_open(aim, situation)] if situation.held is None else []
        before: tuple[Action, ...] = ()
        if doors:
            opened = yield from self._solve(_task(situation, scope, [*reached, *((True, door) for door in doors)]))
            if opened.status == "solved":
                before = opened.actions
                situation = situation.fork()
                for action in before:
                    situation.advance(action)
        outcome = yield from self._solve(_task(situation, scope, [*reached, *aim.literals]))
        return replace(outcome, actions=(*before, *outcome.actions)) if outcome.status == "solved" else outcome

    @staticmethod
    def _is_thing(node_id: str, situation: Situation) -> bool:
        return (
            node_id in situation.graph
            and situation.graph.node(node_id).layer in ("object", "structure")
            and node_id not in situation.routes.doors
        )

    # -- everything at once ----------------------------------------------------------------------------------------
    def _together(self, goal: Goal, situation: Situation) -> Planning[Plan]:
        """One task for the whole goal, with the first choice of each group."""
        task = whole_task(goal, situation)
        outcome = yield from self._solve(task)
        if outcome.status == "solved":
            return self._result("solved", goal, situation, task, list(outcome.actions))
        if outcome.status == "timeout":
            return self._result("timeout", goal, situation, problem=Problem("timeout", outcome.message))
        message = "no sequence of actions brings it about, as far as the world is known"
        return self._result("unsolvable", goal, situation, problem=Problem("no_plan", message))

    def _solve(self, task: Task) -> Planning[Outcome]:
        left = self._deadline - time.monotonic()
        if left <= 0.0:
            return Outcome("timeout", message="no plan was found in the time given")
        began = time.monotonic()
        outcome = yield Order(task, left)
        waited = time.monotonic() - began
        self._deadline += max(0.0, waited - outcome.figures.get("took_s", waited))  # for its turn, or the start
        return outcome

    @staticmethod
    def _result(
        status: PlanStatus,
        goal: Goal,
        situation: Situation,
        task: Task | None = None,
        actions: Sequence[Action] = (),
        problem: Problem | None = None,
    ) -> Plan:
        rooms = [situation.room] if situation.room else []
        rooms += [fact[2] for action in actions for holds, fact in action.effects if holds and fact[0] == "within"]
        return Plan(
            status=status,
            goal=goal.text,
            problem=problem,
            revision=situation.graph.revision,
            robot=situation.robot,
            rooms=tuple(rooms) if status == "solved" else (),
            task=task,
            actions=tuple(actions),
        )


def _doors_to_open(aim: Aim, situation: Situation) -> list[str]:
    """The shut doors between where things are and where they shall be."""
    found: dict[str, None] = {}
    for holds, fact in aim.literals:
        if holds and fact[0] in ("on", "in"):
            start, end = situation.room_of(fact[1]), situation.room_of(fact[2])
            if start is not None and end is not None:
                doors = situation.routes.doors_on_the_way(start, end)
                found |= {door.node.id: None for door, _ in doors if not situation.opened(door.node.id)}
    return list(found)


def whole_task(goal: Goal, situation: Situation, *, scoped: bool = True) -> Task:
    """One task for a whole goal, with the first choice for each of its groups. Raises `GoalRefused`.

    scoped : only what the goal and the actions can touch; else everything that the graph knows
    """
    chooser = Chooser(situation)
    scope = Scope()
    literals: list[Literal] = []
    for group in goal.groups:
        aims, reasons = chooser.aims(group)
        if not aims:
            raise _impossible(group, reasons)
        scope.join(aims[0].scope)
        literals += aims[0].literals
    return _task(situation, situation.widen(scope) if scoped else situation.everything(), literals)


def _task(situation: Situation, scope: Scope, literals: Sequence[Literal]) -> Task:
    goal = tuple(dict.fromkeys(literals))
    return Task(household(), situation.objects(scope), situation.facts(scope), goal)


def _impossible(group: Group, reasons: Sequence[str]) -> GoalRefused:
    wishes = ", ".join(wish.told(group.names) for wish in group.wishes)
    return GoalRefused("impossible", f"{wishes}: {reasons[0] if reasons else 'nothing brings it about'}")


def _turn(group: Group, left: Sequence[Group], robot: str) -> int:
    """When a group's turn comes: what others stand on first, then what is moved, then what is switched or shut, and
    last where the robot shall be and what it shall hold."""
    turns = []
    moved = {w.arguments[0] for g in left if g is not group for w in g.wishes if w.name in ("on", "in") and w.holds}
    for wish in group.wishes:
        match wish.name, wish.holds:
            case (("in" | "near"), _) if robot in wish.arguments or robot in _only(group, wish):
                turns.append(4)
            case (("on" | "in"), True):
                turns.append(1 if wish.arguments[-1] in moved else 0)
            case "open", False:
                turns.append(2)
            case "holding", True:
                turns.append(3)
            case _:
                turns.append(1)
    return max(turns)


def _only(group: Group, wish: Wish) -> set[str]:
    """What stands for the variables of a wish that have one candidate."""
    return {ids[0] for a in wish.arguments if len(ids := group.domains.get(a, ())) == 1}


def _valid(task: Task, actions: Sequence[Action]) -> bool:
    """Whether the actions can be taken one after the other, and lead to the goal."""
    state = set(task.init)
    for action in actions:
        if action.failing(state):
            return False
        action.apply(state)
    return all((fact in state) == holds for holds, fact in task.goal)
