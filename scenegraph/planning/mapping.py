"""Users' own domains: which of our words are their types and predicates, as a file says.

    domain = "taskographyv1.pddl"             # beside the mapping
    include = "base.toml"                     # optional, one or several: what is not said here is said there

    [types.receptacle]                        # the objects of a type: answers to questions, or names
    ask = "container(X)"
    [types.location]
    ask = ["room(X)", "container(X)"]
    name = "at_{}"                            # for nodes that stand for objects of several types
    [types.slot]
    objects = ["slot_1", "slot_2"]

    [predicates.receptacleAtLocation]         # facts: answers to questions, in the order of `arguments`
    ask = "container(R)"
    arguments = ["R", "R"]

    [goals]                                   # our wishes in their words; 1, 2, … are the arguments
    on = "inReceptacle(1, 2)"

    [targets]                                 # which argument of an action the robot stands before
    GotoLocation = 3

Questions are those of `World.ask`; what they do not tell is false, as planners have it. Facts about things that are no
objects of the types that a predicate wants are left out. The file is TOML or JSON.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from reasoning.knowledge import KnowledgeBase
from reasoning.planning import Domain, Fact, Task
from reasoning.planning.pddl import normalised
from reasoning.terms import Term, term_text
from scenegraph.errors import GoalRefused, InvalidConfig, one_line
from scenegraph.planning.goals import Literal

__all__ = ["DomainMapping", "Mapped"]

_LIMIT = 100_000
_TIMEOUT_S = 10.0
_CALL = re.compile(r"\s*([A-Za-z][\w-]*)\s*\(\s*([\w\s,]*)\)\s*\Z")
WORDS = {"opened": "open", "at": "near", "within": "in_room"}
"""How facts of the household domain are called in `[goals]` where they are called otherwise."""


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


Texts: TypeAlias = Annotated[tuple[str, ...], BeforeValidator(_listed)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class TypeRule(_Part):
    """What the objects of a type are: `ask` has one variable X."""

    ask: Texts = ()
    objects: tuple[str, ...] = ()
    name: str = "{}"


class PredicateRule(_Part):
    """For what a predicate holds."""

    ask: Texts
    arguments: tuple[str, ...] = ()


class DomainMapping(_Part):
    """A domain, and what its words mean; see above."""

    domain: Path
    types: dict[str, TypeRule]
    predicates: dict[str, PredicateRule] = Field(default_factory=dict)
    goals: dict[str, Texts] = Field(default_factory=dict)
    targets: dict[str, int] = Field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path, *, domain: str | Path | None = None) -> DomainMapping:
        """Read a mapping from a TOML or JSON file. Raises `InvalidConfig`, which names file and field.

        domain : where the domain lies, when not where the mapping says
        """
        document = _read(Path(path)) | ({} if domain is None else {"domain": str(domain)})
        try:
            return cls(**document)
        except ValidationError as error:
            raise InvalidConfig(f"{path}: {one_line(error)}") from None

    @cached_property
    def text(self) -> str:
        """The domain's text, put in the form that unified-planning reads. Raises `InvalidConfig`."""
        try:
            return normalised(self.domain.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InvalidConfig(f"{self.domain}: {error}") from None

    @cached_property
    def spelled(self) -> Mapping[str, str]:
        """Names of actions as the domain spells them, by their lower-case ones."""
        names = re.findall(r":action\s+([^\s()]+)", self.domain.read_text(encoding="utf-8"), re.IGNORECASE)
        return {name.lower(): name for name in names}

    @cached_property
    def signature(self) -> Mapping[str, tuple[str, tuple[str, ...]]]:
        """Lower-case names of predicates → their names and the types of their arguments. Raises `InvalidConfig`."""
        from reasoning.planning.formulas import read_schemas
        from reasoning.planning.unified import DomainUnreadable, read_domain

        try:
            schemas = read_schemas(read_domain(self.text))
        except (DomainUnreadable, ValueError) as error:
            raise InvalidConfig(f"{self.domain}: {error}") from None
        found = {name.lower(): (name, kinds) for name, kinds in schemas.predicates.items()}
        for kind in self.types:
            if kind not in schemas.supertypes:
                raise InvalidConfig(
                    f"types.{kind}: {self.domain.name} has no such type: {', '.join(schemas.supertypes)}"
                )
        for name in self.predicates:
            if name.lower() not in found:
                raise InvalidConfig(f"predicates.{name}: {self.domain.name} has no such predicate")
        return found


def _read(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        document = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, ValueError) as error:
        raise InvalidConfig(f"{path}: {error}") from None
    if not isinstance(document, dict):
        raise InvalidConfig(f"{path}: expected a table of domain, types, predicates, …")
    if "domain" in document:
        document["domain"] = str(path.parent / document["domain"])
    whole: dict[str, Any] = {}
    for base in _listed(document.pop("include", [])):
        whole = _merged(whole, _read(path.parent / str(base)))
    return _merged(whole, document)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    found = dict(base)
    for name, value in over.items():
        both = isinstance(value, dict) and isinstance(found.get(name), dict)
        found[name] = {**found[name], **value} if both else value
    return found


@dataclass
class Mapped:
    """A graph in the words of a user's domain, as its rules are answered now."""

    mapping: DomainMapping
    knowledge: KnowledgeBase
    objects: dict[str, str] = field(default_factory=dict)
    """Name → type."""
    node_of: dict[str, str] = field(default_factory=dict)
    """Name → the id of the node (or the value) that it stands for."""

    def task(self, literals: Sequence[Literal], about: Set[str] | None = None) -> Task:
        """The task of a goal, whole, or only about some nodes. Raises `GoalRefused`, `InvalidConfig`."""
        signature = self.mapping.signature
        self.objects, self.node_of = self._objects(about)
        init = frozenset(self._facts(signature))
        goal = tuple((holds, fact) for literal in literals for holds, fact in self._goal(literal, signature))
        used = {a for fact in init for a in fact[1:]} | {a for _, fact in goal for a in fact[1:]}
        constants = {n for rule in self.mapping.types.values() for n in rule.objects}
        objects = {n: k for n, k in self.objects.items() if n in used or n in constants}
        name = _domain_name(self.mapping.text)
        return Task(Domain(name, self.mapping.text), objects, init, goal)

    def _rows(self, questions: Sequence[str], where: str) -> list[dict[str, str]]:
        found = []
        for question in questions:
            reply = self.knowledge.ask(question, limit=_LIMIT, timeout_s=_TIMEOUT_S)
            if reply.problem is not None:
                raise InvalidConfig(f"{where}.ask: {question}: {reply.problem.message}", hint=reply.problem.hint)
            found += [{name: _named(term) for name, term in row.items()} for row in reply.answers]
        return found

    def _objects(self, about: Set[str] | None) -> tuple[dict[str, str], dict[str, str]]:
        objects: dict[str, str] = {}
        nodes: dict[str, str] = {}
        known = {str(row["X"]) for row in self.knowledge.call("node(X, _)")} if about is not None else set()
        for kind, rule in self.mapping.types.items():
            values = [row.get("X", "") for row in self._rows(rule.ask, f"types.{kind}")]
            if any(not value for value in values):
                raise InvalidConfig(f"types.{kind}.ask: expected a question about X")
            if about is not None:
                values = [v for v in values if v in about or v not in known]
            for value in dict.fromkeys([*rule.objects, *values]):
                name = rule.name.format(value)
                if objects.setdefault(name, kind) != kind:
                    raise InvalidConfig(
                        f"types.{kind}.name: {name} is also a {objects[name]}",
                        hint=f'name = "{kind}_{{}}" tells them apart',
                    )
                nodes[name] = value
        return objects, nodes

    def _as_objects(self, values: Sequence[str], kinds: Sequence[str]) -> tuple[str, ...] | None:
        """Values as objects of the types wanted; None when one is none."""
        found = []
        for value, kind in zip(values, kinds, strict=True):
            names = {k: self.mapping.types[k].name.format(value) for k in self._below(kind)}
            name = next((n for k, n in names.items() if self.objects.get(n) == k), None)
            if name is None:
                return None
            found.append(name)
        return tuple(found)

    def _below(self, kind: str) -> list[str]:
        """The mapped types at or below a type of the domain."""
        below = [k for k in self.mapping.types if k != kind and kind in self._above.get(k, (k,))]
        return [kind, *below] if kind in self.mapping.types else below

    @cached_property
    def _above(self) -> Mapping[str, tuple[str, ...]]:
        from reasoning.planning.formulas import read_schemas
        from reasoning.planning.unified import read_domain

        return read_schemas(read_domain(self.mapping.text)).supertypes

    def _facts(self, signature: Mapping[str, tuple[str, tuple[str, ...]]]) -> Set[Fact]:
        found: set[Fact] = set()
        for word, rule in self.mapping.predicates.items():
            name, kinds = signature[word.lower()]
            if len(rule.arguments) != len(kinds):
                raise InvalidConfig(f"predicates.{word}.arguments: expected {len(kinds)}, for {', '.join(kinds)}")
            for row in self._rows(rule.ask, f"predicates.{word}"):
                missing = next((a for a in rule.arguments if a not in row), None)
                if missing is not None:
                    raise InvalidConfig(f"predicates.{word}.arguments: {missing} is no variable of its question")
                arguments = self._as_objects([row[a] for a in rule.arguments], kinds)
                if arguments is not None:
                    found.add((name, *arguments))
        return found

    def _goal(
        self, literal: Literal, signature: Mapping[str, tuple[str, tuple[str, ...]]]
    ) -> Sequence[tuple[bool, Fact]]:
        holds, fact = literal
        word = WORDS.get(fact[0], fact[0])
        patterns = self.mapping.goals.get(word)
        if patterns is None:
            raise GoalRefused(
                "not_in_domain", f"{self.mapping.domain.name} has no word for {word}", f"goals.{word} = …"
            )
        found = []
        for pattern in patterns:
            call = _CALL.match(pattern)
            known = signature.get(call[1].lower()) if call else None
            if call is None or known is None:
                raise InvalidConfig(f"goals.{word}: {pattern!r}: expected a predicate of the domain, such as in(1, 2)")
            places = [part.strip() for part in call[2].split(",")]
            values = [fact[int(p)] if p.isdigit() and int(p) < len(fact) else p for p in places]
            arguments = self._as_objects(values, known[1]) if len(values) == len(known[1]) else None
            if arguments is None:
                raise GoalRefused("not_in_domain", f"{pattern}: {', '.join(values)} are not {', '.join(known[1])}")
            found.append((holds, (known[0], *arguments)))
        return found


def _named(term: Term) -> str:
    """A value as an object's name."""
    text = term if isinstance(term, str) else term_text(term)
    return re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")


def _domain_name(text: str) -> str:
    found = re.search(r"\(\s*domain\s+([^\s()]+)", text, re.IGNORECASE)
    return found[1] if found else "domain"
