"""Graph ⇄ ground terms: the only border between the scene graph and Prolog."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from numpy.typing import NDArray

from reasoning.knowledge import DerivedEdge
from reasoning.terms import Atom, Compound, Term, Var
from scenegraph.graph import Edge, EdgeKey, Node
from scenegraph.perception.relations import MeasurementChange

__all__ = [
    "class_atom",
    "class_facts",
    "derived_edge",
    "edge_fact",
    "edge_key_fact",
    "measurement_facts",
    "node_facts",
    "outline_fact",
    "outline_key_fact",
    "value_of",
]

_DECIMALS = 4
_NOT_NAME = re.compile(r"[^a-z0-9]+")


def class_atom(label: str) -> str:
    """A class as goals write it: `TV` → `tv`, `coffee table` → `coffee_table`, `3d printer` → `c_3d_printer`."""
    name = _NOT_NAME.sub("_", label.lower()).strip("_")
    return name if name[:1].isalpha() else f"c_{name}".rstrip("_")


def node_facts(node: Node) -> Iterator[Compound]:
    """What the rules know of a node: its layer, class, place, size, confidence, times and plain attributes.

    Lengths and angles go to a tenth of a millimetre and of a mrad: many are told with every image, and texts are short.
    """
    subject = Atom(node.id)
    x, y, z = (round(metres, _DECIMALS) for metres in node.position.tolist())
    yield Compound("node", (subject, Atom(node.layer)))
    yield Compound("label", (subject, Atom(class_atom(node.label))))
    yield Compound("position", (subject, x, y, z))
    if node.box is not None:
        yield Compound("size", (subject, *(round(metres, _DECIMALS) for metres in node.box.size.tolist())))
        yield Compound("yaw", (subject, round(node.box.yaw, _DECIMALS)))
    yield Compound("confidence", (subject, round(float(node.confidence), _DECIMALS)))
    yield Compound("seen", (subject, node.first_seen_ns, node.last_seen_ns))
    told = str(node.attributes.get("type_reason", "")).startswith("told")
    for key, value in node.attributes.items():
        if key in ("type", "type_reason"):  # a type that the rules gave is no fact for them
            if key == "type" and told:
                yield Compound("attribute", (subject, Atom("type"), Atom(class_atom(str(value)))))
        elif key == "name":
            yield Compound("name", (subject, str(value)))
        elif isinstance(value, bool):
            yield Compound("attribute", (subject, Atom(key), Atom("true" if value else "false")))
        elif isinstance(value, (int, float, str)):
            yield Compound("attribute", (subject, Atom(key), value))


def outline_fact(node_id: str, corners: NDArray[Any]) -> Compound:
    """The ground projection of a thing: corners (K, 2) in order [m]."""
    return Compound("outline", (Atom(node_id), corners.round(_DECIMALS).tolist()))


def outline_key_fact(node_id: str) -> Compound:
    """A ground projection by what names it, for its deletion."""
    return Compound("outline", (Atom(node_id), Var("Corners")))


def edge_fact(edge: Edge) -> Compound:
    """A stored edge: one that rules do not derive, such as `connects`."""
    ends = (Atom(edge.relation), Atom(edge.source), Atom(edge.target))
    numbers = (Atom("none") if n is None else float(n) for n in (edge.value, edge.threshold))
    return Compound("edge", (*ends, *numbers, float(edge.confidence)))


def edge_key_fact(key: EdgeKey) -> Compound:
    """A stored edge by what names it, for its deletion."""
    return Compound(
        "edge", (Atom(key.relation), Atom(key.source), Atom(key.target), *(Var(n) for n in ("V", "T", "C")))
    )


def measurement_facts(change: MeasurementChange) -> tuple[list[Compound], list[Compound]]:
    """Measurements to put and to delete."""
    put = [_measured(key, value) for key, value in change.put.items()]
    return put, [_measured(key, 0.0) for key in change.deleted]


def _measured(key: tuple[str, ...], value: float) -> Compound:
    return Compound("measured", (*(Atom(part) for part in key), float(value)))


def class_facts(classes: Iterable[tuple[str, str, str | None]]) -> list[Compound]:
    """Classes of a label space: (name, thing or stuff, parent or None)."""
    return [
        Compound("class_info", (Atom(class_atom(name)), Atom(kind), Atom(class_atom(parent) if parent else "none")))
        for name, kind, parent in classes
    ]


def derived_edge(derived: DerivedEdge, known: Edge | None, evidence: tuple[str, ...], stamp_ns: int) -> Edge:
    """The edge for what the rules derived; one that was there keeps its first time."""
    return Edge(
        relation=derived.relation,
        source=derived.source,
        target=derived.target,
        value=float(derived.value),
        threshold=float(derived.threshold),
        confidence=min(1.0, max(0.0, float(derived.confidence))),
        evidence=evidence if known is None else (*known.evidence, *evidence)[-5:],
        first_seen_ns=stamp_ns if known is None else known.first_seen_ns,
        last_seen_ns=stamp_ns if known is None else max(stamp_ns, known.last_seen_ns),
    )


def value_of(term: Term, nodes: Mapping[str, Node]) -> Any:
    """What an answer's term means to a Python user: a node, a number, a text, a list, or the term's text."""
    if isinstance(term, Atom):
        return nodes.get(term.name, term.name)
    if isinstance(term, list):
        return [value_of(item, nodes) for item in term]
    return term if isinstance(term, (int, float, str)) else str(term)
