"""Trees of classes from other programs' files, to be told to a world: which class is below which.

owl, rdf, xml : RDF/XML, of which rdfs:subClassOf between named classes and rdfs:label are read
ttl           : the same in Turtle
csv           : a table of `child,parent`, a line each; the first line may be a heading
txt           : a tree by indentation, as of WordNet's hyponyms: what stands deeper is below the last that did not
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from reasoning.terms import Atom, term_text
from scenegraph.errors import TaxonomyUnreadable
from scenegraph.facts import class_atom

__all__ = ["Taxonomy", "read_taxonomy"]

_RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_RDFS: Final = "http://www.w3.org/2000/01/rdf-schema#"
_THING: Final = "http://www.w3.org/2002/07/owl#Thing"
_SUBCLASS, _LABEL = _RDFS + "subClassOf", _RDFS + "label"
_HUMP: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_SENSE: Final = re.compile(r"\.[nvasr]\.\d+$")
_LARGEST: Final = 50_000_000

Pair = tuple[str, str]


@dataclass(frozen=True)
class Taxonomy:
    """Classes as goals write them, each with those directly above it; none is above itself."""

    parents: Mapping[str, tuple[str, ...]]

    def __len__(self) -> int:
        return sum(map(len, self.parents.values()))

    def statements(self) -> list[str]:
        """What to `tell` a world, a statement each: parents before what is below them."""
        above = {name: list(of) for name, of in self.parents.items()}
        order = TopologicalSorter(above).static_order()
        return [
            f"subclass({term_text(Atom(name))}, {term_text(Atom(parent))})"
            for name in order
            for parent in self.parents.get(name, ())
        ]


def read_taxonomy(path: str | Path) -> Taxonomy:
    """The tree of classes in a file, whose format is known by its ending.

    Raises TaxonomyUnreadable when it cannot be read, is damaged, holds no class, or runs in a circle.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise TaxonomyUnreadable(
            f"{path}: not a tree of classes", hint=f"expected one of {', '.join(sorted(_READERS))}"
        )
    try:
        if path.stat().st_size > _LARGEST:
            raise TaxonomyUnreadable(f"{path}: larger than {_LARGEST // 1_000_000} MB")
        pairs = list(reader(path.read_text(encoding="utf-8-sig")))
    except OSError as error:
        raise TaxonomyUnreadable(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TaxonomyUnreadable(f"{path}: expected text in UTF-8") from None
    except TaxonomyUnreadable as error:
        raise TaxonomyUnreadable(f"{path}{error}", hint=error.hint) from None
    return _tree(path, pairs)


def _tree(path: Path, pairs: Iterable[Pair]) -> Taxonomy:
    parents: dict[str, tuple[str, ...]] = {}
    for child, parent in pairs:
        below, above = class_atom(child), class_atom(parent)
        if below != above and above not in parents.get(below, ()):
            parents[below] = (*parents.get(below, ()), above)
    if not parents:
        raise TaxonomyUnreadable(f"{path}: no class is below another there")
    try:
        TopologicalSorter({name: list(of) for name, of in parents.items()}).prepare()
    except CycleError as error:
        circle = " → ".join(reversed(error.args[1]))
        raise TaxonomyUnreadable(f"{path}: classes are below themselves: {circle}") from None
    return Taxonomy(parents)


# -- plain text -------------------------------------------------------------------------------------------------------


def _from_csv(text: str) -> Iterator[Pair]:
    for number, row in enumerate(csv.reader(io.StringIO(text)), 1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if len(cells) != 2 or not all(cells):
            raise TaxonomyUnreadable(f":{number}: expected `child,parent`, got {','.join(cells)!r}")
        if number > 1 or [cell.lower() for cell in cells] not in (["child", "parent"], ["class", "parent"]):
            yield cells[0], cells[1]


def _from_indented(text: str) -> Iterator[Pair]:
    open_classes: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        name = _SENSE.sub("", line.strip().lstrip("-*=> ").strip())
        if not name or name.startswith("#"):
            continue
        depth = len(line.expandtabs(4)) - len(line.expandtabs(4).lstrip())
        while open_classes and open_classes[-1][0] >= depth:
            dropped = open_classes.pop()
            if not open_classes and depth > 0 and dropped[0] > depth:
                raise TaxonomyUnreadable(
                    f":{number}: {name!r} is indented less than the first class, but not as a root"
                )
        if open_classes:
            yield name, open_classes[-1][1]
        open_classes.append((depth, name))


# -- RDF --------------------------------------------------------------------------------------------------------------


def _named(above: Iterable[Pair], labels: Mapping[str, str]) -> Iterator[Pair]:
    """Pairs of IRIs as pairs of names: the label, else the last part of the IRI with its humps parted."""
    for child, parent in above:
        if _THING not in (child, parent):
            yield _name(child, labels), _name(parent, labels)


def _name(iri: str, labels: Mapping[str, str]) -> str:
    return labels.get(iri) or _HUMP.sub(" ", re.split(r"[#/:]", iri)[-1])


def _from_rdf_xml(text: str) -> Iterator[Pair]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise TaxonomyUnreadable(f":{line}:{column + 1}: not well-formed XML: {error}") from None
    if root.tag != f"{{{_RDF}}}RDF":
        raise TaxonomyUnreadable(
            ": expected RDF/XML with an element rdf:RDF", hint="save the ontology as RDF/XML or Turtle"
        )
    base = root.get("{http://www.w3.org/XML/1998/namespace}base", "")
    above: list[Pair] = []
    labels: dict[str, str] = {}
    for element in root.iter():
        child = _subject(element, base)
        if child is None:
            continue
        for of in element:
            if of.tag == f"{{{_RDFS}}}label" and of.text and _is_english(of.get(_LANGUAGE)):
                labels[child] = of.text.strip()
            if of.tag == f"{{{_RDFS}}}subClassOf":
                parent = of.get(f"{{{_RDF}}}resource")
                inner = [found for part in of if (found := _subject(part, base)) is not None]
                above += [
                    (child, base + name if name.startswith("#") else name) for name in ([parent] if parent else inner)
                ]
    return _named(above, labels)


_LANGUAGE: Final = "{http://www.w3.org/XML/1998/namespace}lang"


def _subject(element: ElementTree.Element, base: str) -> str | None:
    about, own = element.get(f"{{{_RDF}}}about"), element.get(f"{{{_RDF}}}ID")
    if own is not None:
        return f"{base}#{own}"
    return base + about if about is not None and about.startswith("#") else about


def _is_english(language: str | None) -> bool:
    return language is None or language.lower().startswith("en")


_TOKEN: Final = re.compile(
    r"""(?P<skip>\s+|\#[^\n]*)
      | (?P<iri><[^<>"{}|^`\\\s]*>)
      | (?P<text>\"{3}(?:\\.|[^\\])*?\"{3} | '{3}(?:\\.|[^\\])*?'{3} | "(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*')
      | (?P<directive>@prefix\b|@base\b|(?:PREFIX|BASE|prefix|base)(?=\s))
      | (?P<language>@[A-Za-z]+(?:-[A-Za-z0-9]+)*)
      | (?P<number>[+-]?\d*\.?\d+(?:[eE][+-]?\d+)?)
      | (?P<mark>\^\^|[;,.\[\]()])
      | (?P<name>[^\s<>"'\[\]();,]*[^\s<>"'\[\]();,.])""",
    re.VERBOSE | re.DOTALL,
)


class _Turtle:
    """What a Turtle document says of classes: subClassOf between IRIs, and labels. Blank nodes are passed over."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = list(self._split(text))
        self._at = 0
        self._prefixes: dict[str, str] = {}
        self._base = ""
        self.above: list[Pair] = []
        self.labels: dict[str, str] = {}
        while self._at < len(self._tokens):
            self._statement()

    def _split(self, text: str) -> Iterator[tuple[str, str, int]]:
        at = 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise TaxonomyUnreadable(f":{self._line(at)}: not Turtle: {text[at : at + 20].splitlines()[0]!r}")
            if match.lastgroup != "skip":
                yield str(match.lastgroup), match.group(), at
            at = match.end()

    def _line(self, at: int) -> int:
        return self._text.count("\n", 0, at) + 1

    def _next(self) -> tuple[str, str]:
        if self._at == len(self._tokens):
            raise TaxonomyUnreadable(f":{self._line(len(self._text))}: the document ends within a statement")
        kind, token, _ = self._tokens[self._at]
        self._at += 1
        return kind, token

    def _peek(self) -> str:
        return self._tokens[self._at][1] if self._at < len(self._tokens) else ""

    def _expect(self, mark: str) -> None:
        _, token = self._next()
        if token != mark:
            at = self._tokens[self._at - 1][2]
            raise TaxonomyUnreadable(f":{self._line(at)}: expected `{mark}`, got {token!r}")

    def _statement(self) -> None:
        kind, token = self._next()
        if kind == "directive":
            self._directive(token)
            return
        self._at -= 1
        subject = self._term()
        if subject is not None or self._peek() != ".":
            self._properties(subject, ".")
        self._expect(".")

    def _directive(self, token: str) -> None:
        if token.lower().endswith("prefix"):
            _, prefix = self._next()
            self._prefixes[prefix.removesuffix(":")] = self._next()[1].strip("<>")
        else:
            self._base = self._next()[1].strip("<>")
        if token.startswith("@"):
            self._expect(".")

    def _properties(self, subject: str | None, end: str) -> None:
        while self._peek() not in (end, ""):
            if self._peek() == ";":
                self._at += 1
                continue
            predicate = self._term()
            while True:
                at = self._at
                value = self._term()
                if predicate == _SUBCLASS and subject is not None and value is not None:
                    self.above.append((subject, value))
                elif predicate == _LABEL and subject is not None:
                    self._label(subject, at)
                if self._peek() != ",":
                    break
                self._at += 1
            if self._peek() not in (";", end):
                self._expect(";")

    def _label(self, subject: str, at: int) -> None:
        kind, token, _ = self._tokens[at]
        language = self._tokens[at + 1][1][1:] if self._tokens[at + 1][0] == "language" else None
        if kind == "text" and _is_english(language):
            self.labels[subject] = token.strip("\"'")

    def _term(self) -> str | None:
        """The IRI that comes next; None for a text, a number or a blank node."""
        kind, token = self._next()
        if kind == "iri":
            iri = token[1:-1]
            return iri if ":" in iri else self._base + iri
        if kind == "text":
            if self._peek() == "^^":
                self._at += 1
                self._term()
            elif self._at < len(self._tokens) and self._tokens[self._at][0] == "language":
                self._at += 1
            return None
        if kind == "number":
            return None
        if token == "[":
            self._properties(None, "]")
            self._expect("]")
            return None
        if token == "(":
            while self._peek() != ")":
                self._term()
            self._expect(")")
            return None
        if kind == "name":
            return self._expanded(token)
        at = self._tokens[self._at - 1][2]
        raise TaxonomyUnreadable(f":{self._line(at)}: expected a name, got {token!r}")

    def _expanded(self, name: str) -> str | None:
        if name == "a":
            return f"{_RDF}type"
        if name in ("true", "false") or name.startswith("_:"):
            return None
        prefix, colon, local = name.partition(":")
        if not colon or prefix not in self._prefixes:
            at = self._tokens[self._at - 1][2]
            raise TaxonomyUnreadable(f":{self._line(at)}: the prefix of {name!r} is not declared")
        return self._prefixes[prefix] + local


def _from_turtle(text: str) -> Iterator[Pair]:
    document = _Turtle(text)
    return _named(document.above, document.labels)


_READERS: Final = {
    ".csv": _from_csv, ".txt": _from_indented, ".ttl": _from_turtle,
    ".owl": _from_rdf_xml, ".rdf": _from_rdf_xml, ".xml": _from_rdf_xml,
}  # fmt: skip
