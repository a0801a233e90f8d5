"""What comes back from planning: a plan of steps that name nodes and poses."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from mapping.geometry import SE3
from reasoning.knowledge import Problem
from reasoning.planning import Action, Fact, Task, fact_text
from scenegraph.graph import Delta

__all__ = ["Check", "Plan", "PlanCheck", "PlanStatus", "Step"]

PlanStatus: TypeAlias = Literal["solved", "unsolvable", "unknown", "timeout"]

NAMES = {"pass": "navigate", "place_on": "place", "place_in": "place", "place_inside": "place"}
"""What actions of the household domain are called in steps, where a robot needs no finer difference."""
ARGUMENTS = {
    "navigate": (2,),
    "pass": (4, 2),
    "open": (1,),
    "close": (1,),
    "switch_on": (1,),
    "switch_off": (1,),
    "pick": (1,),
    "place_on": (1, 2),
    "place_in": (1, 2),
    "place_inside": (1, 2),
    "pour": (1, 2),
}
"""Which parameters of an action of the household domain a step names."""


@dataclass(frozen=True)
class Step:
    """One thing to do.

    action        navigate, open, close, pick, place, pour, switch_on or switch_off; in a user's domain its own names
    arguments     node ids: navigate (where to[, through which door]), pick (what), place (what, where), pour (from,
                  into)
    target        where base_link is to stand for it; None when no free, reachable pose is known
    preconditions what must hold before, as texts: `on(object_4, object_9)`, `\\+ opened(object_9)`
    effects       what it brings about, in the same form
    """

    action: str
    arguments: tuple[str, ...]
    target: SE3 | None = None
    preconditions: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()

    def __str__(self) -> str:
        return fact_text((self.action, *self.arguments))


@dataclass(frozen=True)
class Plan:
    """The answer to `World.plan`. Iterating yields its steps.

    status    "unsolvable" when no plan exists as far as is known; "unknown" when what the goal is about is not known
    problem   None, or why there is no plan
    revision  of the graph that was planned in
    rooms     the rooms that the robot is in, in order
    task      what the planner was given: `task.domain.text` and `task.pddl` are PDDL; None when it was not asked
    actions   the plan in the words of the task's domain: steps one to one
    """

    status: PlanStatus
    goal: str
    steps: tuple[Step, ...] = ()
    problem: Problem | None = None
    revision: int = 0
    robot: str | None = None
    rooms: tuple[str, ...] = ()
    task: Task | None = None
    actions: tuple[Action, ...] = ()
    elapsed_ms: float = field(default=0.0, compare=False)

    def __iter__(self) -> Iterator[Step]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)

    def __bool__(self) -> bool:
        return self.status == "solved"

    @property
    def pddl(self) -> str | None:
        """The problem as PDDL text; the domain's is `plan.task.domain.text`."""
        return None if self.task is None else self.task.pddl

    def to_unified_planning(self) -> Any:
        """What the planner was given as a `unified_planning.model.Problem`; None when it was not asked."""
        from reasoning.planning.unified import to_unified

        return None if self.task is None else to_unified(self.task)

    def validate(self) -> str | None:
        """None when unified-planning's validator finds the plan valid, else why not."""
        from reasoning.planning.unified import validate

        if self.task is None:
            return "there is no plan"
        return validate(self.task, self.actions)

    def broken_by(self, delta: Delta) -> tuple[str, ...]:
        """What of a change of the graph may break the plan, in words: cheap, to be called with every delta; what it
        means for the steps is for `World.verify` to say. Empty when the change is none of the plan's business."""
        needs = {fact for action in self.actions for holds, fact in action.conditions if holds}
        taken = {action.arguments[1] for action in self.actions if action.name == "pick"}
        found = [f"{node_id} is gone" for node_id in delta.nodes.deleted if node_id in self.about]
        for key in delta.edges.deleted:
            told = {(key.relation, key.source, key.target), ("resting", key.source, key.target)}
            if key.relation in ("on", "in") and told & needs:
                found.append(f"{key.source} is no longer {key.relation} {key.target}")
            elif key.relation == "connects" and key.source in self.about:
                found.append(f"{key.source} no longer leads to {key.target}")
        at_first = set() if self.task is None else self.task.init
        for edge in delta.edges.put:
            concerned = edge.source in self.about or edge.target in taken
            if concerned and edge.relation in ("on", "in") and not _known(edge.key, at_first):
                found.append(f"{edge.source} is {edge.relation} {edge.target}")
        return tuple(found)

    @property
    def about(self) -> frozenset[str]:
        """The ids of all nodes that the plan has to do with."""
        return frozenset(self.task.objects) if self.task is not None else frozenset()


def _known(key: tuple[str, str, str], facts: Set[Fact]) -> bool:
    """Whether a plan was made knowing of an edge: facts tell it, or it is about which room a thing is in."""
    return (
        key in facts or ("resting", *key[1:]) in facts or ("kept", *key[1:]) in facts or ("beside", *key[1:]) in facts
    )


def step_of(action: Action, household: bool, target: SE3 | None) -> Step:
    """An action as a step of a plan."""
    name, arguments = action.name, action.arguments
    if household:
        name, arguments = NAMES.get(name, name), tuple(action.arguments[k] for k in ARGUMENTS[action.name])
    return Step(
        action=name,
        arguments=arguments,
        target=target,
        preconditions=tuple(_text(holds, fact) for holds, fact in action.conditions),
        effects=tuple(_text(holds, fact) for holds, fact in action.effects),
    )


def _text(holds: bool, fact: Fact) -> str:
    return fact_text(fact) if holds else f"\\+ {fact_text(fact)}"


@dataclass(frozen=True)
class Check:
    """Whether a step can still be taken; `reasons` says why not, one for each condition that fails."""

    step: Step
    holds: bool
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlanCheck:
    """Whether a plan still leads to its goal: step by step, each in the state that those before it leave.

    reasons : why not, the first step's first; empty when it holds
    """

    holds: bool
    checks: tuple[Check, ...]
    reasons: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.holds
