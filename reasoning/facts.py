"""The ground facts of the world: which there are, what identifies each, and their remembered text.

The engine's process may be killed; what it knew is kept here, one line a fact, so that a new one can be told at once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Final

from reasoning.errors import InvalidFact
from reasoning.terms import Atom, Compound, Term, Var, term_text

__all__ = ["FACTS", "SYMMETRIC", "FactStore"]

#: (name, arity) → how many leading arguments identify the fact; a second fact with the same ones replaces the first.
FACTS: Final[dict[tuple[str, int], int]] = {
    ("node", 2): 1,
    ("label", 2): 1,
    ("name", 2): 1,
    ("position", 4): 1,
    ("size", 4): 1,
    ("yaw", 2): 1,
    ("outline", 2): 1,
    ("confidence", 2): 1,
    ("seen", 3): 1,
    ("attribute", 3): 2,
    ("measured", 3): 2,
    ("measured", 4): 3,
    ("edge", 6): 3,
    ("told", 1): 1,
    ("class_info", 3): 1,
    ("parameter", 2): 1,
    ("unobserved", 1): 1,
    ("lasted", 5): 4,
    ("lived", 5): 4,
    ("had", 5): 4,
    ("event", 5): 5,
    ("sighted", 3): 1,
    ("past_relation", 1): 1,
    ("told_past", 1): 1,
}

#: Measurements that are the same in both directions: kept once, with the smaller id first.
SYMMETRIC: Final = frozenset({"gap", "path_gap_upper", "path_gap_lower", "footprint_overlap", "things_between"})

_IDS: Final[dict[tuple[str, int], tuple[int, ...]]] = {
    **{key: (0,) for key in FACTS if key[0] in {"node", "label", "name", "position", "size", "yaw", "confidence"}},
    ("outline", 2): (0,),
    ("seen", 3): (0,),
    ("attribute", 3): (0,),
    ("measured", 3): (1,),
    ("measured", 4): (1, 2),
    ("edge", 6): (1, 2),
}
Key = tuple[str, ...]

#: An attribute's text that is a plain name is told as one, so that it can be asked for as `red` and not only as "red".
_NAME: Final = re.compile(r"[a-z][a-z0-9_]*\Z", re.ASCII)


class FactStore:
    """The facts as they stand, in the text that the engine reads."""

    def __init__(self) -> None:
        self._lines: dict[Key, str] = {}
        self._about: dict[str, set[Key]] = {}
        self.follower: Callable[[Key, str], None] | None = None
        """Is told of each fact that comes or goes, by its key and text."""

    def __len__(self) -> int:
        return len(self._lines)

    def change(self, put: Iterable[Compound], deleted: Iterable[Compound], forget: Iterable[str]) -> str:
        """Carry out a change here and return its text for the engine: first `forget`, then `deleted`, then `put`.

        Nothing is changed when a fact is refused. Raises `InvalidFact`, `InvalidTerm`.
        """
        puts = [_keyed(fact) for fact in put]
        for key, text, _ in puts:
            if "_" in key:
                raise InvalidFact(f"fact: {text} is not ground: expected values, no variables")
        deletes = [_keyed(fact) for fact in deleted]
        ids = [term_text(Atom(node)) for node in forget]
        lines = [f"forget({node})." for node in ids]
        for node in ids:
            for key in self._about.pop(node, ()):
                self._drop(key)
        for key, text, _ in deletes:
            lines.append(f"delete({text}).")
            if "_" in key:
                for match in [other for other in self._lines if _matches(key, other)]:
                    self._drop(match)
            else:
                self._drop(key)
        for key, text, about in puts:
            before = self._lines.get(key)
            if before == text:
                continue
            lines.append(f"add({text})." if before is None else f"put({text}).")
            if before is not None:
                self._tell(key, before)
            self._tell(key, text)
            self._lines[key] = text
            for node in about:
                self._about.setdefault(node, set()).add(key)
        return "\n".join(lines)

    def measurements(self) -> set[str]:
        """The names of what was measured, as the engine reads them."""
        return {key[2] for key in self._lines if key[0] == "measured"}

    def text(self) -> str:
        """All facts, as the text of one change to an empty world."""
        return "\n".join([f"add({text})." for text in self._lines.values()])

    def _tell(self, key: Key, text: str) -> None:
        if self.follower is not None:
            self.follower(key, text)

    def _drop(self, key: Key) -> None:
        before = self._lines.pop(key, None)
        if before is not None:
            self._tell(key, before)
        for index in _IDS.get((key[0], int(key[1])), ()):
            keys = self._about.get(key[2 + index])
            if keys is not None:
                keys.discard(key)


def _matches(pattern: Key, key: Key) -> bool:
    return len(pattern) == len(key) and all(p in ("_", k) for p, k in zip(pattern, key, strict=True))


def _argument(term: Term) -> str:
    return "_" if type(term) is Var else term_text(term)


def _keyed(fact: Compound) -> tuple[Key, str, tuple[str, ...]]:
    """The fact's key, its text, and the ids that it is about."""
    if type(fact) is not Compound or (identity := FACTS.get((fact.name, len(fact.args)))) is None:
        known = ", ".join(f"{name}/{arity}" for name, arity in FACTS)
        raise InvalidFact(f"fact: {fact!s} is not a fact of this world: expected one of {known}")
    name, arguments = fact.name, fact.args
    arity = len(arguments)
    if name in ("attribute", "had") and type(arguments[2]) is str and _NAME.match(arguments[2]):
        arguments = (*arguments[:2], Atom(arguments[2]), *arguments[3:])
    texts = [_argument(argument) for argument in arguments]
    if name == "measured" and arity == 4 and texts[0] in SYMMETRIC and texts[1] > texts[2] and "_" not in texts[1:3]:
        texts[1], texts[2] = texts[2], texts[1]
    key = (name, str(arity), *texts[:identity])
    return key, f"{name}({','.join(texts)})", tuple([texts[i] for i in _IDS.get((name, arity), ())])
