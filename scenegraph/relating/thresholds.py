"""The numbers and classes that the rules of space compare with, as a knowledge base has them."""

from __future__ import annotations

from dataclasses import dataclass, field

from reasoning.knowledge import KnowledgeBase
from reasoning.terms import Atom, Compound
from scenegraph.facts import class_atom

__all__ = ["Thresholds"]


@dataclass
class Thresholds:
    """The numbers that `rules/spatial.pl` compares with, and which classes are containers, as a knowledge base has them
    when it is asked. Lengths in metres, shares in 0 … 1."""

    contact_gap: float
    contact_share: float
    overlap_share: float
    footing_inside_share: float
    voxels_inside_share: float
    room_share: float
    own_room_share: float
    near_least: float
    near_most: float
    knowledge: KnowledgeBase = field(repr=False)
    _containers: dict[str, bool] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, knowledge: KnowledgeBase) -> Thresholds:
        """Those that hold now."""
        told = {str(row["N"]): row["V"] for row in knowledge.call("threshold(N, V, _, _)")}
        [answer] = knowledge.call("contact_gap(G)")
        names = cls.__dataclass_fields__.keys() & told.keys()
        values = {name: float(told[name]) for name in names}  # type: ignore[arg-type]
        return cls(contact_gap=float(answer["G"]), knowledge=knowledge, **values)  # type: ignore[arg-type]

    def is_container(self, label: str) -> bool:
        """Whether the taxonomy says that the whole box of such a thing is its inside."""
        if label not in self._containers:
            goal = Compound("container_class", (Atom(class_atom(label)),))
            self._containers[label] = bool(self.knowledge.call(goal, limit=1))
        return self._containers[label]
