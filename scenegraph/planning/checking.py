"""Whether a plan still leads to its goal, in the graph as it is now, and in words why not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from reasoning.planning import Action, Fact, Task, fact_text
from scenegraph.graph import Node, SceneGraph
from scenegraph.planning.plan import Check, Plan, PlanCheck
from scenegraph.planning.situation import Scope, Situation

__all__ = ["check_plan", "simulate"]

_PRIVATE = frozenset({"at", "within", "holding", "free", "opened", "switched_on", "poured"})
"""What a robot knows of what it did, and no camera tells."""


def simulate(plan: Plan, state: set[Fact], done: int, why: Reasons) -> PlanCheck:
    """Take the steps of a plan from `done` on in a state, which is changed in place, and say where it cannot be done.

    What a step that cannot be taken would bring about counts as done: each step answers for itself.
    """
    checks: list[Check] = []
    assert plan.task is not None
    for step, action in list(zip(plan.steps, plan.actions, strict=True))[done:]:
        failing = action.failing(state) + [
            (False, fact) for fact in sorted(state) if action.name == "pick" and _rests_on(fact, action.arguments[1])
        ]
        reasons = tuple(dict.fromkeys(why.of(holds, fact) for holds, fact in failing))
        checks.append(Check(step, not reasons, reasons))
        action.apply(state)
    missed = [why.of(holds, fact) for holds, fact in plan.task.goal if (fact in state) != holds]
    reasons = tuple(dict.fromkeys([reason for check in checks for reason in check.reasons] + missed))
    return PlanCheck(not reasons, tuple(checks), reasons)


def _rests_on(fact: Fact, thing: str) -> bool:
    return fact[0] == "resting" and fact[2] == thing


def check_plan(plan: Plan, situation: Situation, done: int) -> PlanCheck:
    """Check a plan of the household domain in a situation; its first `done` actions are done."""
    assert plan.task is not None
    expected = _believed(plan.task, plan.actions[:done])
    _catch_up(situation, expected, plan.actions[:done])
    scope = _scope_of(plan.task, situation)
    return simulate(plan, set(situation.facts(scope)), done, Reasons(situation.graph, situation))


def _believed(task: Task, actions: Sequence[Action]) -> set[Fact]:
    """What should hold after some actions."""
    state = set(task.init)
    for action in actions:
        action.apply(state)
    return state


def _catch_up(situation: Situation, expected: set[Fact], done: Iterable[Action]) -> None:
    """Let the robot be where it should be in the room that it is seen in, and hold and have opened what it did."""
    for action in done:
        known = [(holds, fact) for holds, fact in action.effects if fact[0] in _PRIVATE - {"at", "within"}]
        situation.advance(Action(action.name, action.arguments, (), tuple(known)))
    sites = [fact[2] for fact in expected if fact[0] == "at"]
    if ("within", situation.robot, situation.room or "") in expected and sites:
        situation.site = sites[0]


def _scope_of(task: Task, situation: Situation) -> Scope:
    """What a task was about, as far as it is still there, and what stands now on the things to be taken."""
    graph = situation.graph
    kinds = {name: kind for name, kind in task.objects.items() if name in graph}
    movable = {fact[2] for fact in task.init if fact[0] == "graspable"} | {f[2] for f in task.init if f[0] == "holding"}
    hosts = {fact[2] for fact in task.init if fact[0] in ("fits_on", "fits_in")}
    things = {name for name, kind in kinds.items() if kind in ("thing", "door")}
    things |= {child for thing in movable & things for child in situation.children(thing)}
    for thing in list(things):  # where a thing is now, if it is elsewhere
        things |= {carrier for carrier, _ in situation.chain(thing)}
    rooms = {name for name, kind in kinds.items() if kind == "room"}
    rooms |= {room for thing in things if (room := situation.room_of(thing))}
    doors = {name for name, kind in kinds.items() if kind == "door" and name in situation.routes.doors}
    return Scope(movable & things, hosts & things, things, rooms, doors)


class Reasons:
    """Says in words why a condition does not hold.

    situation : None in users' domains, of whose words nothing is known
    """

    def __init__(self, graph: SceneGraph, situation: Situation | None) -> None:
        self._graph = graph
        self._now = situation

    def of(self, holds: bool, fact: Fact) -> str:
        """Why `fact` does not hold, or does."""
        for name in fact[1:]:
            if name not in self._graph and (stone := self._graph.tombstone(name)) is not None:
                return f"{name} is gone: {stone.reason}" + (f"; it became {stone.became}" if stone.became else "")
        return self._in_words(holds, fact) or (
            f"{fact_text(fact)} does not hold" if holds else f"{fact_text(fact)} holds, and should not"
        )

    def _in_words(self, holds: bool, fact: Fact) -> str | None:
        now = self._now
        if now is None:
            return None
        match (fact[0], *fact[1:]):
            case ("on" | "in" | "resting") as how, thing, host if holds:
                word = {"resting": "on"}.get(how, how)
                return f"{thing} is no longer {word} {self._named(host)}: {self._whereabouts(thing)}"
            case "resting", thing, host:
                return f"{thing} is {self._how(thing)} {self._named(host)}"
            case (("reached_from" | "kept"), thing, _):
                return f"{thing} is elsewhere now: {self._whereabouts(thing)}"
            case "beside", site, room if site in self._graph:
                return f"{site} is not in {room}, but in {now.room_of(site)}"
            case "within", robot, room:
                return f"{robot} is not in {room}, but in {now.room}"
            case "at", robot, site:
                return f"{robot} is not at {site}, but somewhere else in {now.room}"
            case "opened", thing:
                return f"{self._named(thing)} is {'closed' if holds else 'open'}"
            case "free", robot:
                return f"{robot} holds {now.held}"
            case "holding", robot, thing:
                return f"{robot} does not hold {thing}" + (f", but {now.held}" if now.held else "")
            case "joins", door, a, b:
                known = now.routes.doors.get(door)
                refused = None if known is None else known.refused
                return refused or f"{door} no longer joins {a} and {b}"
            case "graspable", _, thing:
                return now.not_graspable(thing)
            case ("fits_on" | "fits_in") as how, thing, host:
                return now.not_fitting(thing, how.removeprefix("fits_"), host)
            case _:
                return None

    def _whereabouts(self, thing: str) -> str:
        assert self._now is not None
        if self._now.held == thing:
            return f"{self._now.robot} holds it"
        host = self._now.host(thing)
        if host is None:
            return "nobody knows what it rests on"
        edge = self._graph.edge(host[1], thing, host[0])
        since = "" if edge is None else f" since {edge.first_seen_ns / 1e9:.1f} s"
        return f"it is {host[1]} {self._named(host[0])}{since}"

    def _how(self, thing: str) -> str:
        assert self._now is not None
        host = self._now.host(thing)
        return "on" if host is None else host[1]

    def _named(self, node_id: str) -> str:
        node: Node | None = self._graph.node(node_id) if node_id in self._graph else None
        return node_id if node is None or node.label in ("", node.layer) else f"{node_id} ({node.label})"
