"""Slow, obvious twins of how evidence for classes is counted: dictionaries and sums of everything."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np

from mapping.kernels.evidence import UNIT

Voxel = tuple[int, int, int]


class Ledger:
    """All evidence that was ever given, by voxel and class, in whole units; nothing is forgotten."""

    def __init__(self, voxel_size_m: float) -> None:
        self.voxel_size_m = voxel_size_m
        self.given: defaultdict[Voxel, Counter[int]] = defaultdict(Counter)

    def give(self, points: np.ndarray, labels: np.ndarray, weights: np.ndarray) -> None:
        for point, label, weight in zip(points, labels, weights, strict=True):
            units = round(float(weight) * UNIT)
            if label and units:
                self.given[tuple(int(np.floor(c / self.voxel_size_m)) for c in point)][int(label)] += units


class Counters:
    """The best k classes of one voxel, by the book (Misra & Gries 1982, weighted)."""

    def __init__(self, k: int) -> None:
        self.k = k
        self.counts: dict[int, int] = {}
        self.other = 0

    def give(self, label: int, units: int) -> None:
        if label in self.counts or len(self.counts) < self.k:
            self.counts[label] = self.counts.get(label, 0) + units
            return
        worn = min(units, *self.counts.values())
        self.counts = {c: n - worn for c, n in self.counts.items() if n > worn}
        self.other += (self.k + 1) * worn
        if units > worn:
            self.counts[label] = units - worn


def posterior(likelihoods: list[np.ndarray]) -> np.ndarray:
    """(K,) of a product of likelihoods (K,) under an even prior."""
    logs = np.sum([np.log(row) for row in likelihoods], axis=0)
    odds = np.exp(logs - logs.max())
    return odds / odds.sum()
