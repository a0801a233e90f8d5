"""Prolog terms as Python values, and the two texts they travel in.

| Prolog | Python | in an answer's JSON |
| --- | --- | --- |
| `abc` | `Atom("abc")` | `"abc"` |
| `"abc"` | `"abc"` | `{"s": "abc"}` |
| `3` | `3` | `3`, beyond 2⁶³ `{"i": "<hexadecimal>"}` |
| `1.5` | `1.5` | `1.5`; infinities `{"f": "inf"}`, `{"f": "-inf"}` |
| `1r3` | `Fraction(1, 3)` | `{"q": "1/3"}` |
| `f(a, X)` | `Compound("f", (Atom("a"), Var("X")))` | `["f", "a", {"v": "X"}]` |
| `[a]` | `[Atom("a")]` | `{"l": ["a"]}` |

An atom, a string and a number never mix. Text towards Prolog is written here with every name quoted where it needs to
be; nothing is ever pasted into it.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeAlias

from reasoning.errors import InvalidTerm

__all__ = ["Atom", "Compound", "Term", "Var", "decode", "decode_json", "term_text"]

_PLAIN_ATOM = re.compile(r"[a-z][a-zA-Z0-9_]*\Z", re.ASCII)
_VARIABLE = re.compile(r"[A-Z_][a-zA-Z0-9_]*\Z", re.ASCII)
_MUST_ESCAPE = re.compile(r"[\\'\"\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff]")
_SMALL = 1 << 63


@dataclass(frozen=True, slots=True)
class Atom:
    """A Prolog atom: a name such as `object_12`, `cup` or `near`."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Var:
    """A Prolog variable, by name (`X`, `_G12`)."""

    name: str

    def __post_init__(self) -> None:
        if not _VARIABLE.match(self.name):
            raise InvalidTerm(f"Var.name: {self.name!r} is not a variable name: expected a capital letter or '_' first")

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Compound:
    """A Prolog compound term, `name(*args)`. Lists are Python lists, not compounds."""

    name: str
    args: tuple[Term, ...]

    def __str__(self) -> str:
        return term_text(self)


Term: TypeAlias = "Atom | Compound | Var | int | float | Fraction | str | list[Any]"


def _escape(match: re.Match[str]) -> str:
    character = match.group()
    return "\\" + character if character in "\\'\"" else f"\\x{ord(character):x}\\"


def _quoted(text: str, quote: str) -> str:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise InvalidTerm(f"text: {text!r} holds half a surrogate pair: expected characters of Unicode") from None
    return quote + _MUST_ESCAPE.sub(_escape, text) + quote


@lru_cache(maxsize=65536)
def _atom_text(name: str) -> str:
    return name if _PLAIN_ATOM.match(name) else _quoted(name, "'")


def _integer_text(value: int) -> str:
    # Python refuses to write very long integers in decimal, and both sides read hexadecimal in linear time.
    return str(value) if -_SMALL <= value < _SMALL else f"{'-' if value < 0 else ''}0x{abs(value):x}"


def _float_text(value: float) -> str:
    if math.isnan(value):
        raise InvalidTerm("number: nan is not a value: expected a number, or the atom `unknown`")
    if math.isinf(value):
        return "1.0Inf" if value > 0 else "-1.0Inf"
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text


def term_text(term: Term) -> str:
    """`term` as Prolog text that reads back as the same term (canonical form, quoted). Raises `InvalidTerm`."""
    if type(term) is Atom:
        return _atom_text(term.name)
    if type(term) is float:
        return _float_text(term)
    if type(term) is int:
        return _integer_text(term)
    if type(term) is str:
        return _quoted(term, '"')
    if type(term) is Compound:
        return f"{_atom_text(term.name)}({','.join([term_text(argument) for argument in term.args])})"
    if type(term) is list:
        return f"[{','.join([term_text(item) for item in term])}]"
    if type(term) is Var:
        return term.name
    if type(term) is Fraction:
        return _integer_text(term.numerator) if term.denominator == 1 else f"{term.numerator}r{term.denominator}"
    raise InvalidTerm(
        f"term: {term!r} of type {type(term).__name__} has no Prolog counterpart",
        hint="use Atom, Compound, Var, int, float, str or a list of these (Atom('true') for a truth value)",
    )


@lru_cache(maxsize=65536)
def _atom(name: str) -> Atom:
    return Atom(name)


def decode(value: Any) -> Term:
    """A term from the JSON value that the engine wrote for it. Raises `InvalidTerm`."""
    kind = type(value)
    if kind is str:
        return _atom(value)
    if kind is int or kind is float:
        return value  # type: ignore[no-any-return]
    if kind is list and value and type(value[0]) is str:
        return Compound(value[0], tuple([decode(item) for item in value[1:]]))
    if kind is dict and len(value) == 1:
        [(tag, content)] = value.items()
        if tag == "l":
            return [decode(item) for item in content]
        if tag == "s":
            return str(content)
        if tag == "v":
            return Var(content)
        if tag == "i":
            return int(content, 16)
        if tag == "f":
            return float(content)
        if tag == "q":
            return Fraction(content)
    raise InvalidTerm(f"term: {value!r} is not the JSON of a term")


def decode_json(text: str | bytes) -> Term:
    """A term from the JSON text that the engine wrote for it. Raises `InvalidTerm`."""
    try:
        return decode(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise InvalidTerm(f"term: unreadable answer from the engine: {error}") from None
