"""Formulas and action schemas as plain tuples: what is left of a domain once unified-planning has read it.

A formula is `("atom", predicate, terms)`, `("equal", a, b)`, `("not", f)`, `("and", fs)`, `("or", fs)`,
`("forall", variables, f)` or `("exists", variables, f)`; a term is an object's name, or a variable's with `?` before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from reasoning.planning.task import Fact

__all__ = ["Effect", "Formula", "Schema", "Schemas", "Variables", "conjuncts", "ground", "read_schemas", "simple"]

Formula: TypeAlias = tuple[Any, ...]
Variables: TypeAlias = tuple[tuple[str, str], ...]
"""Names with `?` before them, each with its type."""

TRUE: Formula = ("and", ())
FALSE: Formula = ("or", ())


@dataclass(frozen=True)
class Effect:
    """`fact` begins to hold, or ends, where `condition` held; for all values of `variables`."""

    variables: Variables
    condition: Formula
    holds: bool
    predicate: str
    terms: tuple[str, ...]


@dataclass(frozen=True)
class Schema:
    """An action with parameters."""

    name: str
    parameters: Variables
    condition: Formula
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Schemas:
    """The actions of a domain, which types lie below which, and which predicates no action changes."""

    actions: tuple[Schema, ...]
    supertypes: Mapping[str, tuple[str, ...]]
    predicates: Mapping[str, tuple[str, ...]]
    constants: Mapping[str, str]

    @property
    def fluents(self) -> frozenset[str]:
        """The predicates that some action changes."""
        return frozenset(effect.predicate for action in self.actions for effect in action.effects)

    def of_type(self, objects: Mapping[str, str]) -> dict[str, list[str]]:
        """The objects of each type, those of its subtypes among them."""
        found: dict[str, list[str]] = {kind: [] for kind in self.supertypes}
        for name, kind in objects.items():
            for above in self.supertypes[kind]:
                found[above].append(name)
        return found


def read_schemas(problem: Any) -> Schemas:
    """The schemas of a `unified_planning.model.Problem`. Changes of numbers are left out: they bound no plan."""
    supertypes = {t.name: tuple(a.name for a in t.ancestors) for t in problem.user_types}
    actions = tuple(
        Schema(
            name=action.name,
            parameters=tuple((f"?{p.name}", p.type.name) for p in action.parameters),
            condition=("and", tuple(_formula(c) for c in action.preconditions)),
            effects=tuple(_effect(e) for e in action.effects if e.fluent.type.is_bool_type()),
        )
        for action in problem.actions
    )
    predicates = {
        f.name: tuple(p.type.name for p in f.signature) for f in problem.fluents if f.type.is_bool_type()
    }  # fmt: skip
    constants = {o.name: o.type.name for o in problem.all_objects}
    return Schemas(actions, supertypes, predicates, constants)


def _effect(effect: Any) -> Effect:
    return Effect(
        variables=tuple((f"?{v.name}", v.type.name) for v in effect.forall),
        condition=_formula(effect.condition),
        holds=effect.value.is_true(),
        predicate=effect.fluent.fluent().name,
        terms=tuple(_term(a) for a in effect.fluent.args),
    )


def _term(node: Any) -> str:
    if node.is_parameter_exp():
        return f"?{node.parameter().name}"
    if node.is_variable_exp():
        return f"?{node.variable().name}"
    if node.is_object_exp():
        return str(node.object().name)
    raise ValueError(f"expected an object, a parameter or a variable, got {node}")


def _formula(node: Any) -> Formula:
    if node.is_bool_constant():
        return TRUE if node.is_true() else FALSE
    if node.is_fluent_exp():
        return ("atom", node.fluent().name, tuple(_term(a) for a in node.args))
    if node.is_not():
        return ("not", _formula(node.arg(0)))
    if node.is_and() or node.is_or():
        return ("and" if node.is_and() else "or", tuple(_formula(a) for a in node.args))
    if node.is_implies():
        return ("or", (("not", _formula(node.arg(0))), _formula(node.arg(1))))
    if node.is_iff():
        a, b = _formula(node.arg(0)), _formula(node.arg(1))
        return ("or", (("and", (a, b)), ("and", (("not", a), ("not", b)))))
    if node.is_equals():
        return ("equal", _term(node.arg(0)), _term(node.arg(1)))
    if node.is_forall() or node.is_exists():
        variables = tuple((f"?{v.name}", v.type.name) for v in node.variables())
        return ("forall" if node.is_forall() else "exists", variables, _formula(node.arg(0)))
    raise ValueError(f"conditions on numbers are not understood: {node}")


def conjuncts(formula: Formula) -> Iterator[Formula]:
    """The parts of a conjunction, however nested; any other formula itself."""
    if formula[0] == "and":
        for part in formula[1]:
            yield from conjuncts(part)
    else:
        yield formula


def simple(formula: Formula) -> bool:
    """Whether it is an atom, or an atom that shall not hold."""
    return bool(formula[0] == "atom" or (formula[0] == "not" and formula[1][0] == "atom"))


class Possible:
    """What may hold at some time, and what no action changes: enough to decide a part of ground formulas."""

    def __init__(self, init: frozenset[Fact], reachable: set[Fact], fluents: frozenset[str]) -> None:
        self._init, self._reachable, self._fluents = init, reachable, fluents

    def decide(self, fact: Fact) -> bool | None:
        """Whether it always holds (True), never (False), or now and then (None)."""
        if fact[0] not in self._fluents:
            return fact in self._init
        return None if fact in self._reachable else False


def ground(
    formula: Formula,
    binding: Mapping[str, str],
    of_type: Mapping[str, Sequence[str]],
    possible: Possible,
    positive: bool = True,
) -> list[list[tuple[bool, Fact]]]:
    """A formula (or, unless `positive`, its negation) as alternatives of ground literals of fluents.

    [] never holds; [[]] always does.
    """
    kind = formula[0]
    if kind == "not":
        return ground(formula[1], binding, of_type, possible, not positive)
    if kind == "atom":
        fact = (formula[1], *(binding.get(t, t) for t in formula[2]))
        decided = possible.decide(fact)
        if decided is None:
            return [[(positive, fact)]]
        return [[]] if decided == positive else []
    if kind == "equal":
        same = binding.get(formula[1], formula[1]) == binding.get(formula[2], formula[2])
        return [[]] if same == positive else []
    if kind in ("forall", "exists"):
        parts = [(formula[2], b) for b in bindings(formula[1], binding, of_type)]
        joined = (kind == "forall") == positive
    else:
        parts = [(part, binding) for part in formula[1]]
        joined = (kind == "and") == positive
    alternatives = (ground(part, b, of_type, possible, positive) for part, b in parts)
    return _all(alternatives) if joined else _any(alternatives)


def bindings(
    variables: Variables, binding: Mapping[str, str], of_type: Mapping[str, Sequence[str]]
) -> Iterator[Mapping[str, str]]:
    """A binding extended by all values of some variables."""
    if not variables:
        yield binding
        return
    (name, kind), *rest = variables
    for value in of_type[kind]:
        yield from bindings(tuple(rest), {**binding, name: value}, of_type)


def _all(parts: Iterator[list[list[tuple[bool, Fact]]]]) -> list[list[tuple[bool, Fact]]]:
    found: list[list[tuple[bool, Fact]]] = [[]]
    for part in parts:
        if not part:
            return []
        if part != [[]]:
            found = [[*a, *b] for a in found for b in part]
    return found


def _any(parts: Iterator[list[list[tuple[bool, Fact]]]]) -> list[list[tuple[bool, Fact]]]:
    found: list[list[tuple[bool, Fact]]] = []
    for part in parts:
        if [] in part:
            return [[]]
        found += part
    return found
