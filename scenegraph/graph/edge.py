"""Typed, directed edges of the scene graph, with the measurement that made them."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from scenegraph.errors import InvalidGraphValue
from scenegraph.graph.values import Attributes, Identifier, PlainAttributes, Value

__all__ = ["Edge", "EdgeKey"]


class EdgeKey(NamedTuple):
    """What names an edge: several relations may join the same pair, each once a direction."""

    relation: str
    source: str
    target: str


class Edge(Value):
    """One relation that holds: `relation(source, target)`, as in `on(cup, table)`.

    value, threshold : what was measured and what it was compared with (units by relation), or None
    confidence       : in [0, 1], from the margin between the two
    evidence         : the observations behind it, newest last: names (`robot/sensor@stamp_ns`) or stamps
    first_seen_ns, last_seen_ns : when it first held and was last confirmed
    attributes       : plain JSON values (`through` of `adjacent`, …); read-only

    Symmetric relations and inverses are edges of their own; who puts one puts the other.
    """

    relation: Identifier
    source: Identifier
    target: Identifier
    value: float | None = Field(default=None, allow_inf_nan=False)
    threshold: float | None = Field(default=None, allow_inf_nan=False)
    confidence: float = Field(default=1.0, ge=0.0, le=1.0, allow_inf_nan=False)
    evidence: tuple[str | int, ...] = ()
    first_seen_ns: int
    last_seen_ns: int
    attributes: PlainAttributes = Field(default_factory=Attributes)

    @model_validator(mode="after")
    def _two_ends_in_order(self) -> Self:
        if self.source == self.target:
            raise ValueError(f"{self.relation}: expected two different ends, got {self.source!r} twice")
        if self.first_seen_ns > self.last_seen_ns:
            raise ValueError(f"first_seen_ns {self.first_seen_ns} is later than last_seen_ns {self.last_seen_ns}")
        return self

    @property
    def key(self) -> EdgeKey:
        """`(relation, source, target)`."""
        return EdgeKey(self.relation, self.source, self.target)

    def replace(self, **fields: Any) -> Edge:
        """A copy with some fields changed and checked. The relation and the ends stay."""
        fixed = fields.keys() & {"relation", "source", "target"}
        if fixed:
            raise InvalidGraphValue(f"Edge.replace: {', '.join(sorted(fixed))} of an edge cannot change")
        return Edge(**{**self.__dict__, **fields})

    def __hash__(self) -> int:
        return hash((self.relation, self.source, self.target, self.last_seen_ns))
