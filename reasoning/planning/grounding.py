"""From action schemas to the actions that can ever be taken: a relaxed exploration by joins, as in a datalog engine.

An action is instantiated when its positive conditions have all been reached, ignoring what actions end; parameters are
found by looking conditions up among the facts, the one with the fewest matches first, never by trying all objects (the
idea of Helmert 2009, *Concise finite-domain representations for PDDL planning tasks*, §6). Quantifiers and
disjunctions are then written out, conditional effects become alternatives, and what must *not* hold becomes a fact of
its own, so that a planner for plain STRIPS can be given the rest.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

from reasoning.planning.formulas import (
    Effect,
    Formula,
    Possible,
    Schema,
    Schemas,
    Variables,
    bindings,
    conjuncts,
    ground,
    simple,
)
from reasoning.planning.task import Action, Fact, Literal_, Task

__all__ = ["GroundTask", "TooLarge", "ground_task"]

_MOST_ALTERNATIVES = 256
Binding: TypeAlias = dict[str, str]


class TooLarge(Exception):
    """More actions than asked for can be taken, or one has too many alternatives."""


@dataclass(frozen=True)
class GroundTask:
    """A task in STRIPS with literals: conditions and goal may ask for what does not hold.

    goal : None when it cannot be reached even if nothing ever ended
    """

    init: frozenset[Fact]
    goal: tuple[Literal_, ...] | None
    actions: tuple[Action, ...]


class _Facts:
    """Ground facts, found by predicate and any one argument."""

    def __init__(self) -> None:
        self.all: set[Fact] = set()
        self._by: defaultdict[tuple[object, ...], list[Fact]] = defaultdict(list)

    def add(self, fact: Fact) -> bool:
        if fact in self.all:
            return False
        self.all.add(fact)
        self._by[fact[0],].append(fact)
        for place, value in enumerate(fact[1:]):
            self._by[fact[0], place, value].append(fact)
        return True

    def candidates(self, predicate: str, terms: tuple[str, ...], binding: Mapping[str, str]) -> list[Fact]:
        """The shortest list that holds every fact which matches."""
        least = self._by.get((predicate,), [])
        for place, term in enumerate(terms):
            value = binding.get(term) if term[0] == "?" else term
            if value is not None:
                found = self._by.get((predicate, place, value), [])
                if len(found) < len(least):
                    least = found
        return least


class _Grounder:
    def __init__(self, task: Task, schemas: Schemas, most_actions: int) -> None:
        objects = {**schemas.constants, **task.objects}
        self.schemas = schemas
        self.fluents = schemas.fluents
        self.of_type = schemas.of_type(objects)
        self.member = {kind: frozenset(names) for kind, names in self.of_type.items()}
        self.facts = _Facts()
        self.possible = Possible(task.init, self.facts.all, self.fluents)
        self.queue: deque[Fact] = deque()
        self.init = task.init
        self.most = most_actions
        self.found: list[tuple[Schema, Binding]] = []
        self.seen: set[tuple[object, ...]] = set()
        self.waits: defaultdict[str, list[tuple[Schema, int]]] = defaultdict(list)
        self.parts: dict[str, tuple[list[Formula], list[Formula]]] = {}

    def explore(self) -> None:
        """Find every instance of an action that the relaxed exploration reaches."""
        for schema in self.schemas.actions:
            positive = [c for c in conjuncts(schema.condition) if c[0] == "atom"]
            rest = [c for c in conjuncts(schema.condition) if c[0] != "atom"]
            self.parts[schema.name] = positive, rest
            for place, atom in enumerate(positive):
                self.waits[atom[1]].append((schema, place))
        for fact in self.init:
            if self.facts.add(fact) and fact[0] in self.fluents:
                self.queue.append(fact)
        for schema in self.schemas.actions:
            if not any(atom[1] in self.fluents for atom in self.parts[schema.name][0]):
                self._instantiate(schema, self.parts[schema.name][0], {})
        while self.queue:
            fact = self.queue.popleft()
            for schema, place in self.waits[fact[0]]:
                positive = self.parts[schema.name][0]
                binding = self._match(positive[place], fact, {}, schema.parameters)
                if binding is not None:
                    self._instantiate(schema, [*positive[:place], *positive[place + 1 :]], binding)

    def _match(self, atom: Formula, fact: Fact, binding: Binding, parameters: Variables) -> Binding | None:
        """The binding under which an atom is a fact, with values of the parameters' types."""
        if len(atom[2]) != len(fact) - 1:
            return None
        new = binding
        for term, value in zip(atom[2], fact[1:], strict=True):
            if term[0] != "?":
                if term != value:
                    return None
            elif term in new:
                if new[term] != value:
                    return None
            else:
                kind = next(kind for name, kind in parameters if name == term)
                if value not in self.member[kind]:
                    return None
                new = {**new, term: value}
        return new

    def _instantiate(self, schema: Schema, left: list[Formula], binding: Binding) -> None:
        if left:
            lists = [(self.facts.candidates(atom[1], atom[2], binding), k) for k, atom in enumerate(left)]
            candidates, k = min(lists, key=lambda pair: len(pair[0]))
            rest = [*left[:k], *left[k + 1 :]]
            for fact in list(candidates):
                wider = self._match(left[k], fact, binding, schema.parameters)
                if wider is not None:
                    self._instantiate(schema, rest, wider)
            return
        unbound = tuple((name, kind) for name, kind in schema.parameters if name not in binding)
        for full in bindings(unbound, binding, self.of_type):
            self._take(schema, dict(full))

    def _take(self, schema: Schema, binding: Binding) -> None:
        key = (schema.name, *(binding[name] for name, _ in schema.parameters))
        if key in self.seen:
            return
        for part in self.parts[schema.name][1]:  # what is decided by what never changes
            if self._never(part, binding):
                return
        self.seen.add(key)
        self.found.append((schema, binding))
        if len(self.found) > self.most:
            raise TooLarge(f"more than {self.most} actions can be taken")
        for effect in schema.effects:
            if effect.holds:
                for wider in self._values(effect, binding):
                    fact = (effect.predicate, *(wider.get(t, t) for t in effect.terms))
                    if self.facts.add(fact):
                        self.queue.append(fact)

    def _never(self, part: Formula, binding: Binding) -> bool:
        """Whether a condition that is no atom can be seen to fail for good."""
        if part[0] == "not" and part[1][0] == "atom":
            _, predicate, terms = part[1]
            return predicate not in self.fluents and (predicate, *(binding.get(t, t) for t in terms)) in self.init
        if part[0] == "equal" or (part[0] == "not" and part[1][0] == "equal"):
            return not ground(part, binding, self.of_type, self.possible)
        return False

    def _values(self, effect: Effect, binding: Mapping[str, str]) -> Iterator[Mapping[str, str]]:
        """The bindings of an effect's own variables under which what never changes lets it happen."""
        static = [c for c in conjuncts(effect.condition) if simple(c) and _atom(c)[1] not in self.fluents]
        for wider in bindings(effect.variables, binding, self.of_type):
            if all(ground(c, wider, self.of_type, self.possible) for c in static):
                yield wider

    # -- writing out ------------------------------------------------------------------------------------------------
    def actions(self) -> Iterator[Action]:
        """The instances found, with alternatives written out."""
        for schema, binding in self.found:
            conditions = ground(schema.condition, binding, self.of_type, self.possible)
            if not conditions:
                continue
            plain: list[Literal_] = []
            choices: list[list[tuple[list[Literal_], list[Literal_]]]] = []
            for effect in schema.effects:
                for wider in self._values(effect, binding):
                    fact = (effect.predicate, *(wider.get(t, t) for t in effect.terms))
                    if not effect.holds and fact not in self.facts.all:
                        continue
                    when = ground(effect.condition, wider, self.of_type, self.possible)
                    if [] in when:
                        plain.append((effect.holds, fact))
                    elif when:
                        unless = ground(effect.condition, wider, self.of_type, self.possible, positive=False)
                        choices.append(
                            [(c, [(effect.holds, fact)]) for c in when] + [(c, []) for c in unless]
                        )  # fmt: skip
            arguments = tuple(binding[name] for name, _ in schema.parameters)
            yield from _alternatives(schema.name, arguments, conditions, plain, choices)


def _atom(formula: Formula) -> Formula:
    return formula[1] if formula[0] == "not" else formula


def _alternatives(
    name: str,
    arguments: tuple[str, ...],
    conditions: list[list[Literal_]],
    plain: list[Literal_],
    choices: list[list[tuple[list[Literal_], list[Literal_]]]],
) -> Iterator[Action]:
    """One action for each way in which its condition holds and its conditional effects happen or not."""
    count = len(conditions)
    for choice in choices:
        count *= len(choice)
        if count > _MOST_ALTERNATIVES:
            raise TooLarge(f"{name} has more than {_MOST_ALTERNATIVES} alternatives")
    for condition in conditions:
        for chosen in product(*choices):
            needed = dict.fromkeys(condition)
            effects = dict.fromkeys(plain)
            for more, happens in chosen:
                needed |= dict.fromkeys(more)
                effects |= dict.fromkeys(happens)
            if not any((not holds, fact) in needed for holds, fact in needed):
                yield Action(name, arguments, tuple(needed), tuple(effects))


def ground_task(task: Task, schemas: Schemas, most_actions: int = 1_000_000) -> GroundTask:
    """The actions that matter to a task. Raises `TooLarge`."""
    grounder = _Grounder(task, schemas, most_actions)
    grounder.explore()
    goal: list[Literal_] = []
    for holds, fact in task.goal:
        decided = grounder.possible.decide(fact)
        if decided is (not holds):
            return GroundTask(task.init, None, ())
        if decided is None:
            goal.append((holds, fact))
    actions = _relevant(list(grounder.actions()), goal)
    return GroundTask(task.init, tuple(goal), actions)


def _relevant(actions: list[Action], goal: list[Literal_]) -> tuple[Action, ...]:
    """The actions that bring about what the goal, or a condition of another such action, asks for."""
    achievers: defaultdict[Literal_, list[int]] = defaultdict(list)
    for number, action in enumerate(actions):
        for literal in action.effects:
            achievers[literal].append(number)
    wanted, kept = set(goal), set()
    queue = deque(goal)
    while queue:
        for number in achievers[queue.popleft()]:
            if number not in kept:
                kept.add(number)
                fresh = [c for c in actions[number].conditions if c not in wanted]
                wanted.update(fresh)
                queue.extend(fresh)
    return tuple(action for number, action in enumerate(actions) if number in kept)
