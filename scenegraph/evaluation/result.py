"""What an evaluation has counted, and the figures that come of it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from scenegraph.evaluation.semantics import SemanticTally
from scenegraph.simulation import NoiseModel

__all__ = ["Evaluation", "Tally"]


@dataclass
class Tally:
    """Counts that make precision and recall."""

    right: int = 0
    said: int = 0
    true: int = 0

    def add(self, right: int, said: int, true: int) -> None:
        self.right, self.said, self.true = self.right + right, self.said + said, self.true + true

    @property
    def precision(self) -> float:
        return self.right / self.said if self.said else 1.0

    @property
    def recall(self) -> float:
        return self.right / self.true if self.true else 1.0


@dataclass
class Evaluation:
    """Counts over all homes, and the notes on what went wrong.

    noise   what was wrong with the sensors, when all homes were seen alike
    """

    seeds: list[int] = field(default_factory=list)
    tallies: defaultdict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    shares: defaultdict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    semantics: SemanticTally = field(default_factory=SemanticTally)
    image_ms: list[float] = field(default_factory=list)
    uncounted: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    noise: NoiseModel | None = None

    def count(self, name: str, some: int, of_all: int) -> None:
        """Add to a figure that is a share."""
        self.shares[name].add(some, of_all, of_all)

    def merge(self, other: Evaluation) -> None:
        """Add the counts and notes of other homes."""
        self.seeds += other.seeds
        for mine, theirs in ((self.tallies, other.tallies), (self.shares, other.shares)):
            for name, tally in theirs.items():
                mine[name].add(tally.right, tally.said, tally.true)
        self.semantics.merge(other.semantics)
        self.image_ms += other.image_ms
        self.uncounted += other.uncounted
        self.notes += other.notes

    def figures(self) -> dict[str, float]:
        """Every figure by name."""
        found: dict[str, float] = {}
        for name, tally in sorted(self.tallies.items()):
            if name.endswith(("accuracy", "recall_all")):
                found[name] = tally.recall
            else:
                found[f"{name}.precision"], found[f"{name}.recall"] = tally.precision, tally.recall
        found |= {name: tally.right / tally.true for name, tally in sorted(self.shares.items()) if tally.true}
        found |= self.semantics.figures()
        if self.image_ms:
            found["image_ms.median"] = float(np.median(self.image_ms))
            found["image_ms.p99"] = float(np.percentile(self.image_ms, 99))
        return {name: round(value, 4) for name, value in found.items()}

    def as_json(self) -> dict[str, Any]:
        """Figures, the label accuracy by the number of views, the noise, and the notes, as JSON values."""
        return {
            "seeds": len(self.seeds),
            "figures": self.figures(),
            "semantics.accuracy_by_views": self.semantics.accuracy_by_views(),
            "noise": None if self.noise is None else asdict(self.noise),
            "uncounted": self.uncounted,
            "notes": self.notes,
        }
