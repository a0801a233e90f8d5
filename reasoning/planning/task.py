"""A planning task as data: a domain in PDDL, objects, what holds now, and what shall hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

__all__ = ["Action", "Domain", "Fact", "Literal_", "Outcome", "Task", "fact_text", "household"]

Fact: TypeAlias = tuple[str, ...]
"""A ground atom: the predicate's name, then the objects' names."""

Literal_: TypeAlias = tuple[bool, Fact]
"""A ground atom that shall hold, or shall not."""

Status: TypeAlias = Literal["solved", "unsolvable", "timeout", "unsupported"]


def fact_text(fact: Fact) -> str:
    """`("on", "cup_1", "table_2")` → `on(cup_1, table_2)`."""
    return f"{fact[0]}({', '.join(fact[1:])})" if len(fact) > 1 else fact[0]


@dataclass(frozen=True)
class Domain:
    """A domain by its name and its text in PDDL."""

    name: str
    text: str


@cache
def household() -> Domain:
    """The domain that comes with the package."""
    path = Path(__file__).with_name("household.pddl")
    return Domain("household", path.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Task:
    """What a planner is given.

    objects : name → type of the domain
    init    : what holds; all else does not
    goal    : ground literals that shall hold together
    """

    domain: Domain
    objects: Mapping[str, str]
    init: frozenset[Fact]
    goal: tuple[Literal_, ...]
    name: str = "task"

    @property
    def pddl(self) -> str:
        """The problem as PDDL text; the domain's is `domain.text`."""
        by_type: dict[str, list[str]] = {}
        for name, kind in sorted(self.objects.items()):
            by_type.setdefault(kind, []).append(name)
        lines = [
            f"(define (problem {self.name})",
            f" (:domain {self.domain.name})",
            " (:objects",
            *(f"   {' '.join(names)} - {kind}" for kind, names in sorted(by_type.items())),
            " )",
            " (:init",
            *(f"   {_pddl(fact)}" for fact in sorted(self.init)),
            " )",
            " (:goal (and",
            *(f"   {_pddl(fact) if holds else f'(not {_pddl(fact)})'}" for holds, fact in self.goal),
            " ))",
            ")",
        ]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Action:
    """A ground action of a plan: what must hold before it, and what it changes."""

    name: str
    arguments: tuple[str, ...]
    conditions: tuple[Literal_, ...]
    effects: tuple[Literal_, ...]

    def __str__(self) -> str:
        return fact_text((self.name, *self.arguments))

    def failing(self, state: Iterable[Fact]) -> list[Literal_]:
        """The conditions that do not hold in a state."""
        held = state if isinstance(state, set | frozenset) else set(state)
        return [(holds, fact) for holds, fact in self.conditions if (fact in held) != holds]

    def apply(self, state: set[Fact]) -> None:
        """Change a state in place: first what ends, then what begins."""
        state.difference_update(fact for holds, fact in self.effects if not holds)
        state.update(fact for holds, fact in self.effects if holds)


@dataclass(frozen=True)
class Outcome:
    """What a planner found.

    status : "unsupported" where the planner does not understand the domain: `message` says what
    """

    status: Status
    actions: tuple[Action, ...] = ()
    message: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


def _pddl(fact: Fact) -> str:
    return f"({' '.join(fact)})"
