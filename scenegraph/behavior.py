"""Goals as conditions that a behaviour tree ticks, and plans as trees. Needs the extra `behavior` (py_trees).

tree = plan_tree(world, world.plan("on(cup, table)"), act)     # act(step) → py_trees.common.Status
while tree.status in (Status.INVALID, Status.RUNNING):
    tree.tick_once()
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence

from scenegraph.planning import Plan, Step

__all__ = ["Condition", "condition", "plan_tree"]


class Asked(Protocol):
    """A `World` or a `Client`."""

    def ask(self, goal: str, *, robot: str | None = None, limit: int = 100, timeout_s: float = 1.0) -> Any: ...


class Verifying(Asked, Protocol):
    """A `World`."""

    def verify(self, plan: Plan, *, done: int = 0) -> Any: ...


def condition(
    world: Asked, goal: str, *, robot: str | None = None, unknown: Status = Status.RUNNING, timeout_s: float = 1.0
) -> Callable[[], Status]:
    """A function that asks a goal: SUCCESS when it is true, FAILURE when it is false, `unknown` when nobody knows.

    Raises ValueError when called with a goal that cannot be asked: a misspelt one shall not pass for a false one.
    """

    def tick() -> Status:
        answers = world.ask(goal, robot=robot, limit=1, timeout_s=timeout_s)
        if answers.problem is not None and answers.problem.code not in ("timeout", "resource_limit"):
            raise ValueError(f"condition {goal!r}: {answers.problem.message}")
        return {"true": Status.SUCCESS, "false": Status.FAILURE}.get(answers.truth, unknown)

    return tick


class Condition(Behaviour):
    """A leaf that asks a goal with every tick; see `condition`."""

    def __init__(self, world: Asked, goal: str, *, name: str | None = None, **options: Any) -> None:
        super().__init__(name or goal)
        self._ask = condition(world, goal, **options)

    def update(self) -> Status:
        return self._ask()


class _Guard(Behaviour):
    """Whether a step of a plan can be taken now; its feedback says why not."""

    def __init__(self, world: Verifying, plan: Plan, number: int) -> None:
        super().__init__(f"can {plan.steps[number]}")
        self._world, self._plan, self._number = world, plan, number

    def update(self) -> Status:
        check = self._world.verify(self._plan, done=self._number).checks[0]
        self.feedback_message = "; ".join(check.reasons)
        return Status.SUCCESS if check.holds else Status.FAILURE


class _Act(Behaviour):
    def __init__(self, step: Step, act: Callable[[Step], Status]) -> None:
        super().__init__(str(step))
        self._step, self._act = step, act

    def update(self) -> Status:
        return self._act(self._step)


def plan_tree(world: Verifying, plan: Plan, act: Callable[[Step], Status]) -> Sequence:
    """A plan as a sequence with memory: before each step its preconditions are checked in the graph as it is then, and
    where one fails the tree does, so that whoever ticks it can plan anew.

    act : does a step, or begins and goes on with it (RUNNING), and is called with every tick until it ends
    """
    tree = Sequence(plan.goal, memory=True)
    for number, step in enumerate(plan.steps):
        tree.add_child(
            Sequence(str(step), memory=True, children=[_Guard(world, plan, number), _Act(step, act)]),
        )
    return tree
