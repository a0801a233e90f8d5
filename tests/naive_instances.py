"""Slow, obvious twins of the kernels of instances: one dictionary of votes a voxel."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

Voxel = tuple[int, int, int]
BACKGROUND = 65535


class Ballots:
    """Votes by voxel and number, all of them kept, and sums of the points that cast them."""

    def __init__(self, voxel: float) -> None:
        self.voxel = voxel
        self.votes: dict[Voxel, dict[int, int]] = {}
        self.points: dict[Voxel, list[tuple[int, np.ndarray]]] = {}

    def at(self, point: np.ndarray) -> Voxel:
        i, j, k = np.floor(point / self.voxel).astype(int).tolist()
        return i, j, k

    def cast(self, point: np.ndarray, number: int, count: int) -> None:
        here = self.votes.setdefault(self.at(point), defaultdict(int))
        here[number] += count
        self.points.setdefault(self.at(point), []).append((count, point))

    def mean(self, voxel: Voxel) -> np.ndarray:
        """The mean point, weighted by votes."""
        counts, points = zip(*self.points[voxel], strict=True)
        return np.average(np.array(points), axis=0, weights=counts)

    def leader(self, voxel: Voxel) -> int:
        """The number with most votes, 0 where there are none."""
        votes = self.votes.get(voxel, {})
        return max(votes, key=lambda n: votes[n]) if votes else 0

    def sizes(self) -> dict[int, int]:
        """In how many voxels each number leads."""
        found: defaultdict[int, int] = defaultdict(int)
        for voxel in self.votes:
            found[self.leader(voxel)] += 1
        return dict(found)

    def rename(self, old: int, new: int) -> None:
        """Give all votes for a number to another; 0 = to none."""
        for votes in self.votes.values():
            count = votes.pop(old, 0)
            if count and new:
                votes[new] = votes.get(new, 0) + count

    def won(self, number: int, least: int, share: float) -> set[Voxel]:
        """The voxels in which a number leads with so many votes and this share of all."""
        return {
            voxel
            for voxel, votes in self.votes.items()
            if self.leader(voxel) == number and votes[number] >= max(least, share * sum(votes.values()))
        }

    def class_votes(self, voxel: Voxel, class_of: dict[int, int]) -> tuple[int, int, int]:
        """The class with most votes (ties: the lowest), these, and those for other classes and for none."""
        by_class: defaultdict[int, int] = defaultdict(int)
        for number, count in self.votes.get(voxel, {}).items():
            by_class[class_of.get(number, 0)] += count
        total = sum(by_class.values())
        named = {c: n for c, n in by_class.items() if c and n}
        if not named:
            return 0, 0, total
        best = min(named, key=lambda c: (-named[c], c))
        return best, named[best], total - named[best]
