"""Twins for planning: slow, obvious, and by unified-planning's own means."""

from __future__ import annotations

from collections import deque
from itertools import product
from typing import Any

from reasoning.planning import Task
from reasoning.planning.unified import to_unified


def successors(task: Task) -> tuple[Any, Any]:
    """unified-planning's simulator of a task, and its first state."""
    from unified_planning.engines.sequential_simulator import UPSequentialSimulator

    problem = to_unified(task)
    simulator = UPSequentialSimulator(problem)
    return simulator, simulator.get_initial_state()


def shortest_plan_length(task: Task, most: int = 4000) -> int | None:
    """How many actions the shortest plan has, by breadth first over every state; None when there is no plan.

    Raises RuntimeError beyond `most` states.
    """
    simulator, start = successors(task)
    problem = simulator._problem
    atoms = [f for f in problem.initial_values if f.type.is_bool_type()]

    def key(state: Any) -> frozenset[Any]:
        return frozenset(a for a in atoms if state.get_value(a).is_true())

    seen = {key(start)}
    queue = deque([(start, 0)])
    while queue:
        state, depth = queue.popleft()
        if simulator.is_goal(state):
            return depth
        for action, parameters in simulator.get_applicable_actions(state):
            after = simulator.apply(state, action, parameters)
            found = key(after)
            if found not in seen:
                seen.add(found)
                queue.append((after, depth + 1))
        if len(seen) > most:
            raise RuntimeError("too many states")
    return None


def reachable_actions(task: Task, schemas: Any) -> set[tuple[str, tuple[str, ...]]]:
    """The actions that can be taken if nothing ever ended: every binding of every action is tried, until none is new.

    Conditions that are no atoms count only where nothing can change them.
    """
    from reasoning.planning.formulas import Possible, conjuncts, ground

    objects = {**schemas.constants, **task.objects}
    of_type = schemas.of_type(objects)
    facts = set(task.init)
    found: set[tuple[str, tuple[str, ...]]] = set()
    while True:
        before = len(facts), len(found)
        for schema in schemas.actions:
            for values in product(*(of_type[kind] for _, kind in schema.parameters)):
                binding = dict(zip((name for name, _ in schema.parameters), values, strict=True))
                possible = Possible(task.init, facts, schemas.fluents)
                held = all(
                    (c[1], *(binding.get(t, t) for t in c[2])) in facts
                    if c[0] == "atom"
                    else ground(c, binding, of_type, possible)
                    for c in conjuncts(schema.condition)
                )
                if not held:
                    continue
                found.add((schema.name, values))
                facts |= {
                    (e.predicate, *(binding.get(t, t) for t in e.terms))
                    for e in schema.effects
                    if e.holds and not e.variables
                }
        if before == (len(facts), len(found)):
            return found
