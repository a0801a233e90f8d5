"""Which planes are walls, floors, ceilings and doors: the network of `rules/structure.pl`, solved.

The rule base holds the labels, what a plane with each is like, and which go together, as tables; they are read once.
Costs and constraints of the planes at hand are then numbers, and `reasoning.constraints` finds the cheapest consistent
labels (method: Nüchter & Hertzberg 2008, section 3.1, as a weighted constraint network).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from reasoning.constraints import cheapest
from reasoning.errors import InvalidRules
from reasoning.knowledge import KnowledgeBase
from reasoning.terms import Atom, Compound, Term, Var, term_text

__all__ = ["NO_FEATURE", "Labelling", "PlaneFacts", "PlaneRelation", "PlaneRules"]

Array: TypeAlias = NDArray[Any]
PlaneRelation: TypeAlias = tuple[str, int, int]
"""How two planes stand: parallel, orthogonal, equalheight, above or under; the ids of the first and the second."""

NO_FEATURE = "no_feature"
FACINGS = ("up", "down", "side", "oblique")
RELATIONS = ("parallel", "orthogonal", "equalheight", "above")
CONVERSE = {"above": "under", "under": "above"}
"""Other relations are symmetric."""


@dataclass(frozen=True)
class PlaneFacts:
    """What the rules know of one plane; lengths in metres.

    facing   : up | down | side | oblique
    evidence : class → share of the plane's surface that carries it
    given    : the label of a plane that only serves as context, else None
    """

    id: int
    facing: str
    z_min: float
    z_max: float
    width_m: float
    area_m2: float
    evidence: Mapping[str, float] = field(default_factory=dict)
    given: str | None = None


@dataclass(frozen=True)
class Labelling:
    """labels: plane id → label, consistent with the rules; they cost `cost`, and no others less than `bound`."""

    labels: Mapping[int, str]
    cost: float
    bound: float

    @property
    def optimal(self) -> bool:
        """Whether it is proven that no consistent labels are cheaper."""
        return self.bound >= self.cost - 1e-6


Measures: TypeAlias = Mapping[str, Array]
Condition: TypeAlias = Callable[[Measures, Measures], Array]
"""Measures (N,) of planes, and of the planes that stand beside them → (N,) bool."""


class PlaneRules:
    """The tables of `rules/structure.pl`, and of the rule files that add to them, as arrays.

    Raises `InvalidRules`, which names the line, where a table holds what is neither a measure, a number, a threshold
    nor a label.
    """

    def __init__(self, network: Compound) -> None:
        numbers, labels, shapes, unseen, needs, goes, trusted, never, worth, supports, neutral = network.args
        self._share, self._evidence, self._smallest, self._largest = map(float, cast(Any, cast(Compound, numbers).args))
        costs = [_strict(line, "label", 2) for line in _lines(labels)]
        self.labels = [str(label) for label, _ in costs] + [NO_FEATURE]
        if len(set(self.labels)) < len(self.labels):
            raise InvalidRules(f"label/2: each label once, and not {NO_FEATURE}: {', '.join(self.labels)}")
        self._index = {label: k for k, label in enumerate(self.labels)}
        self._prior = np.array([float(cast(float, cost)) for _, cost in costs])
        self._shape = [(self._label(line.args[0], line), _condition(line.args[1], line)) for line in _lines(shapes)]
        self._unseen = [(self._label(line.args[0], line), _condition(line.args[1], line)) for line in _lines(unseen)]
        self._needs = [self._need(line) for line in _lines(needs)]
        self._worth = [(_condition(line.args[0], line), _expression(line.args[1], line)) for line in _lines(worth)]
        self._supports = [(str(line.args[0]), self._label(line.args[1], line)) for line in _lines(supports)]
        self._neutral = {str(name) for name in cast(list[Term], neutral)}
        size = len(self.labels)
        self._always = {name: np.zeros((size, size), np.bool_) for name in RELATIONS}
        self._sometimes: dict[str, list[tuple[int, int, Condition]]] = {name: [] for name in RELATIONS}
        self._trusted = {name: np.zeros((2, size, size), np.bool_) for name in RELATIONS}
        self._never = {name: np.zeros((size, size), np.bool_) for name in RELATIONS}
        for always in self._always.values():
            always[-1] = always[:, -1] = True
        for line in _lines(goes):
            self._allow(line)
        for line in _lines(trusted):
            self._trust(line)
        for line in _lines(never):
            for name, turned in _ways(line.args[0], line):
                for k in self._labels(line.args[1], line):
                    self._never[name][(slice(None), k) if turned else k] = True
        for name in RELATIONS:
            self._always[name] &= ~self._never[name]

    @staticmethod
    def of(knowledge: KnowledgeBase) -> PlaneRules:
        """The tables of a rule base."""
        [answer] = knowledge.call("structure:network(Network)", limit=1)
        return PlaneRules(cast(Compound, answer["Network"]))

    # -- reading the tables -------------------------------------------------------------------------------
    def _label(self, term: Term, line: Compound) -> int:
        if str(term) not in self._index:
            raise InvalidRules(f"{_said(line)}: {term_text(term)} is not one of the labels {', '.join(self.labels)}")
        return self._index[str(term)]

    def _labels(self, term: Term, line: Compound) -> list[int]:
        """The label that a term names; all for a variable."""
        return list(range(len(self.labels))) if isinstance(term, Var) else [self._label(term, line)]

    def _need(self, line: Compound) -> tuple[int, list[tuple[str, bool]], int, Condition]:
        label, relation, other, conditions = line.args
        ways = _ways(relation, line)
        return self._label(label, line), ways, self._label(other, line), _condition(conditions, line)

    def _allow(self, line: Compound) -> None:
        relation, a, b, conditions = line.args
        condition = _condition(conditions, line)
        for name, turned in _ways(relation, line):
            for i in self._labels(a, line):
                for j in self._labels(b, line):
                    pair = (j, i) if turned else (i, j)
                    if not conditions:
                        self._always[name][pair] = True
                    else:
                        self._sometimes[name].append((*pair, _turned(condition) if turned else condition))

    def _trust(self, line: Compound) -> None:
        relation, label, other = line.args
        for name, turned in _ways(relation, line):
            for i in self._labels(label, line):
                for j in self._labels(other, line):
                    self._trusted[name][(1, j, i) if turned else (0, i, j)] = True

    # -- labelling ----------------------------------------------------------------------------------------
    def label(
        self, planes: Sequence[PlaneFacts], relations: Sequence[PlaneRelation], *, most_steps: int = 1_000_000
    ) -> Labelling:
        """The cheapest consistent labels of planes, each told once, between which these relations hold.

        After about `most_steps` operations of the search (some ten million a second) the best labels that were found
        are taken, and `bound` says how much cheaper others could be. Raises `ValueError` for a relation that is not
        known, or with a plane that is not.
        """
        if not planes:
            return Labelling({}, 0.0, 0.0)
        index = {plane.id: k for k, plane in enumerate(planes)}
        pairs = _by_relation(relations, index)
        measures = _measures(planes)
        costs, evident = self._unary(planes, measures)
        self._ground(costs, evident, measures, pairs)
        arcs, fits = self._binary(measures, evident, pairs)
        found = cheapest(costs, arcs, fits, most_steps=most_steps)
        labels = {plane.id: self.labels[value] for plane, value in zip(planes, found.values.tolist(), strict=True)}
        for plane in planes:
            if plane.given is not None:
                labels[plane.id] = plane.given
        return Labelling(labels, found.cost, found.bound)

    def _unary(self, planes: Sequence[PlaneFacts], measures: Measures) -> tuple[Array, Array]:
        """What each label costs each plane (N, L), inf where it cannot be, and whether it was seen on it (N, L)."""
        n, size = len(planes), len(self.labels)
        shares, against = np.zeros((n, size)), np.zeros(n)
        for k, plane in enumerate(planes):
            for name, share in plane.evidence.items() if plane.given is None else ():
                supported = [label for supporter, label in self._supports if supporter == name]
                shares[k, supported] += share
                against[k] += share if not supported and name not in self._neutral else 0.0
        against = np.minimum(against, 1.0)
        total = shares.sum(axis=1)
        evident = shares >= self._share
        possible = np.ones((n, size), np.bool_)
        for label, condition in self._shape:
            possible[:, label] &= condition(measures, measures)
        for label, condition in self._unseen:
            possible[:, label] &= condition(measures, measures) | evident[:, label]
        costs = np.full((n, size), np.inf)
        costs[:, :-1] = self._prior + self._evidence * (against[:, None] + total[:, None] - shares[:, :-1])
        weight = np.minimum(self._largest, self._smallest + self._worth_of(measures))
        costs[:, -1] = weight * (1.0 - against) + self._evidence * total
        costs[~possible] = np.inf
        for k, plane in enumerate(planes):
            if plane.given is not None:  # a label that these rules do not know stands for no feature
                given = self._index.get(plane.given, size - 1)
                costs[k], evident[k] = np.inf, False
                costs[k, given], evident[k, given] = 0.0, True
        return costs, evident

    def _worth_of(self, measures: Measures) -> Array:
        worth = np.zeros(len(measures["area"]))
        left = np.ones(len(worth), np.bool_)
        for condition, expression in self._worth:
            here = left & condition(measures, measures)
            worth[here] = np.broadcast_to(expression(measures, measures), worth.shape)[here]
            left &= ~here
        return worth

    def _ground(self, costs: Array, evident: Array, measures: Measures, pairs: Mapping[str, Array]) -> None:
        """Take labels, in place, from planes that lack what they need."""
        possible = np.isfinite(costs)
        for label, ways, other, condition in self._needs:
            supplied = evident[:, label].copy()
            for name, turned in ways:
                mine, theirs = pairs[name][:, ::-1].T if turned else pairs[name].T
                met = condition(_taken(measures, mine), _taken(measures, theirs)) & possible[theirs, other]
                supplied[mine[met]] = True
            costs[~supplied, label] = np.inf

    def _binary(self, measures: Measures, evident: Array, pairs: Mapping[str, Array]) -> tuple[Array, Array]:
        """Pairs of planes (M, 2), each once, and which labels of the first and second go together (M, L, L)."""
        size = len(self.labels)
        arcs, fits = [np.empty((0, 2), np.int64)], [np.empty((0, size, size), np.bool_)]
        for name, pair in pairs.items():
            if len(pair):
                arcs.append(pair)
                fits.append(self._fits(name, measures, evident, pair))
        return _joined(np.concatenate(arcs), np.concatenate(fits))

    def _fits(self, name: str, measures: Measures, evident: Array, pair: Array) -> Array:
        a, b = pair.T
        fits = np.repeat(self._always[name][None], len(pair), axis=0)
        if self._sometimes[name]:
            first, second = _taken(measures, a), _taken(measures, b)
            for i, j, condition in self._sometimes[name]:
                fits[:, i, j] |= condition(first, second)
            fits &= ~self._never[name]
        seen_a, seen_b = evident[a][:, :, None], evident[b][:, None, :]
        fits |= (seen_a & self._trusted[name][0]) | (seen_b & self._trusted[name][1]) | (seen_a & seen_b)
        return fits


def _by_relation(relations: Sequence[PlaneRelation], index: Mapping[int, int]) -> dict[str, Array]:
    """For each relation the pairs of planes (K, 2), by their place."""
    told: dict[str, list[tuple[int, int]]] = {name: [] for name in RELATIONS}
    for name, a, b in relations:
        try:
            if name == "under":
                told["above"].append((index[b], index[a]))
            else:
                told[name].append((index[a], index[b]))
        except KeyError as missing:
            raise ValueError(
                f"relations: ({name}, {a}, {b}): {missing} is not a relation or a plane that was told"
            ) from None
    return {name: np.array(pairs, np.int64).reshape(-1, 2) for name, pairs in told.items()}


def _measures(planes: Sequence[PlaneFacts]) -> Measures:
    numbers = np.array([(plane.z_min, plane.z_max, plane.width_m, plane.area_m2) for plane in planes])
    z_min, z_max, width, area = np.ascontiguousarray(numbers.T)
    facing = np.array([FACINGS.index(plane.facing) for plane in planes])
    return {"z_min": z_min, "z_max": z_max, "height": z_max - z_min, "width": width, "area": area, "facing": facing}


def _taken(measures: Measures, at: Array) -> Measures:
    return {name: values[at] for name, values in measures.items()}


def _joined(arcs: Array, fits: Array) -> tuple[Array, Array]:
    """Each pair once, the lower first: what several relations allow."""
    turned = arcs[:, 0] > arcs[:, 1]
    arcs = np.sort(arcs, axis=1)
    fits[turned] = fits[turned].transpose(0, 2, 1)
    order = np.lexsort((arcs[:, 1], arcs[:, 0]))
    arcs, fits = arcs[order], fits[order]
    first = np.flatnonzero(np.r_[True, (arcs[1:] != arcs[:-1]).any(axis=1)]) if len(arcs) else np.empty(0, np.int64)
    return arcs[first], np.logical_and.reduceat(fits, first, axis=0) if len(arcs) else fits


# -- terms ------------------------------------------------------------------------------------------------

_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "min": np.minimum, "max": np.maximum,
}  # fmt: skip
_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {">=": operator.ge, "=<": operator.le}


def _lines(table: Term) -> list[Compound]:
    return cast(list[Compound], table)


def _strict(line: Compound, name: str, arity: int) -> tuple[Term, ...]:
    if line.name != name or len(line.args) != arity or not isinstance(line.args[1], int | float):
        raise InvalidRules(f"{_said(line)}: a label and what it costs, a number, are expected")
    return line.args


def _said(line: Compound) -> str:
    return term_text(line)


def _ways(relation: Term, line: Compound) -> list[tuple[str, bool]]:
    """The relations that a term names, and whether they are told the other way round there."""
    names = RELATIONS if isinstance(relation, Var) else (str(relation),)
    ways: list[tuple[str, bool]] = []
    for name in names:
        if name in CONVERSE:
            ways.append(("above", name == "under"))
        elif name in RELATIONS:
            ways += [(name, False), (name, True)]
        else:
            raise InvalidRules(f"{_said(line)}: {name} is not one of {', '.join(RELATIONS)}, under")
    if isinstance(relation, Var):
        ways.append(("above", True))
    return ways


def _condition(conditions: Term, line: Compound) -> Condition:
    """All conditions of a list."""
    tests = [_test(condition, line) for condition in cast(list[Term], conditions)]

    def hold(a: Measures, b: Measures) -> Array:
        return reduce(operator.and_, (test(a, b) for test in tests)) if tests else np.ones(len(a["area"]), np.bool_)

    return hold


def _test(term: Term, line: Compound) -> Condition:
    if isinstance(term, Compound) and term.name == "one_of" and len(term.args) == 2:
        wanted = {str(name) for name in cast(list[Term], term.args[1])}
        suits = np.array([name in wanted for name in FACINGS])
        return lambda a, _: suits[a["facing"]]
    if isinstance(term, Compound) and term.name in _COMPARISONS and len(term.args) == 2:
        compare = _COMPARISONS[term.name]
        x, y = (_expression(argument, line) for argument in term.args)
        return lambda a, b: cast(Array, compare(x(a, b), y(a, b)))
    raise InvalidRules(f"{_said(line)}: {term_text(term)} is not a comparison by >= or =<, nor one_of(facing, Facings)")


def _expression(term: Term, line: Compound) -> Callable[[Measures, Measures], Any]:
    if isinstance(term, int | float):
        return lambda _, __: term
    if isinstance(term, Atom) and term.name in ("z_min", "z_max", "height", "width", "area"):
        return lambda a, _: a[term.name]
    if isinstance(term, Compound) and term.name in ("a", "b") and len(term.args) == 1:
        inner = _expression(term.args[0], line)
        return inner if term.name == "a" else lambda _, b: inner(b, b)
    if isinstance(term, Compound) and term.name in _OPERATORS and len(term.args) == 2:
        apply = _OPERATORS[term.name]
        x, y = (_expression(argument, line) for argument in term.args)
        return lambda a, b: apply(x(a, b), y(a, b))
    raise InvalidRules(f"{_said(line)}: {term_text(term)} is neither a measure of a plane, a number nor a threshold")


def _turned(condition: Condition) -> Condition:
    return lambda a, b: condition(b, a)
