"""What an operator may state with `tell`, and how it is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from reasoning.errors import ReasoningError
from reasoning.knowledge import KnowledgeBase, Problem
from reasoning.terms import Atom, Compound, Term, Var, term_text
from scenegraph.errors import InvalidStatement, SceneGraphError

__all__ = ["FORMS", "Statement", "problem", "read", "telling"]

FORMS = {
    ("fact", 1): "fact(Term)",
    ("retract", 1): "retract(Term)",
    ("subclass", 2): "subclass(Class, Super)",
    ("rename", 2): "rename(Id, Name)",
    ("set", 3): "set(Id, Attribute, Value)",
    ("merge", 2): "merge(Id, Id)",
    ("split", 2): "split(Room, [[X, Y], [X, Y]])",
    ("delete", 1): "delete(Id)",
    ("room", 2): "room(Name, [[X, Y], …])",
    ("room", 3): "room(Name, [[X, Y], …], Storey)",
    ("rules", 2): "rules(Name, Text)",
    ("forget_rules", 1): "forget_rules(Name)",
}


@dataclass(frozen=True)
class Statement:
    """A statement with its author and reason; `args` are plain values, ids are texts, the term of a fact stays a
    term."""

    kind: str
    args: tuple[Any, ...]
    text: str
    author: str
    reason: str
    stamp_ns: int

    def as_json(self) -> dict[str, Any]:
        return {"text": self.text, "author": self.author, "reason": self.reason, "stamp_ns": self.stamp_ns}


def read(text: str, author: str, reason: str, stamp_ns: int, knowledge: KnowledgeBase) -> Statement:
    """The statement that `text` spells. Raises `InvalidStatement`."""
    if not author:
        raise InvalidStatement("author: a statement needs the name of who makes it")
    try:
        term = parse(text, knowledge)
    except ReasoningError as error:
        raise InvalidStatement(f"statement: {error}", hint=f"one of {', '.join(FORMS.values())}") from None
    if not isinstance(term, Compound) or (term.name, len(term.args)) not in FORMS:
        raise InvalidStatement(
            f"statement: {text!r} is none of those known", hint=f"one of {', '.join(FORMS.values())}"
        )
    if not _ground(term):
        raise InvalidStatement(
            f"statement: {text!r} holds a variable", hint="names begin with a lower-case letter, or use quotes"
        )
    kind = term.name
    args = term.args if kind in ("fact", "retract") else tuple(_plain(kind, argument) for argument in term.args)
    return Statement(kind, args, text, author, reason, stamp_ns)


def telling(name: str, rules: str) -> str:
    """The statement that tells rules, whose text needs quotes and escapes in it: `rules(name, "…")`."""
    return term_text(Compound("rules", (Atom(name), rules)))


def _ground(term: Term) -> bool:
    if isinstance(term, Compound):
        return all(_ground(argument) for argument in term.args)
    if isinstance(term, list):
        return all(_ground(item) for item in term)
    return not isinstance(term, Var)


def _plain(kind: str, term: Term) -> Any:
    if isinstance(term, Atom):
        return {"true": True, "false": False}.get(term.name, term.name)
    if isinstance(term, list):
        return [_plain(kind, item) for item in term]
    if isinstance(term, (int, float, str)):
        return term
    raise InvalidStatement(f"{kind}: expected names, numbers and texts, got {term_text(term)}")


def parse(text: str, knowledge: KnowledgeBase) -> Term:
    """The term that `text` spells, with or without a full stop. Raises `ReasoningError` on a syntax error.

    Prolog reads up to a full stop and forgets the rest; in brackets the rest would be an error.
    """
    whole = text.strip().removesuffix(".")
    [plain] = knowledge.call(Compound("term_string", (Var("Term"), whole)), limit=1)
    [bracketed] = knowledge.call(Compound("term_string", (Var("Term"), f"({whole}\n)")), limit=1)
    if plain["Term"] != bracketed["Term"] and _ground(plain["Term"]):
        raise InvalidStatement(f"statement: {text!r} is more than one statement")
    return plain["Term"]


def problem(error: SceneGraphError) -> Problem:
    """Why a statement was refused."""
    return Problem(error.code, str(error), error.hint)
