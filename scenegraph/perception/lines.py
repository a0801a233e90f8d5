"""The straight lines between nearest points of two things, and what stands on them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Set
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels.shapes import near_segment
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Pair: TypeAlias = tuple[str, str]
Line: TypeAlias = tuple[Array, Array]

BESIDE_VOXELS = 0.6
"""Material this near a line is on it, in voxels: half the diagonal of a voxel's face."""
CLEAR_VOXELS = 1.5
"""Material this near either end of a line is the end's own, or lies against it."""


class Lines:
    """A line for each pair of things, found by its pair, its ends or the ground that it passes over."""

    def __init__(self) -> None:
        self._ends: dict[Pair, Line] = {}
        self._of: defaultdict[str, set[Pair]] = defaultdict(set)
        self._index = GroundIndex()

    def __len__(self) -> int:
        return len(self._ends)

    def put(self, pair: Pair, p: Array, q: Array) -> None:
        """Add or move the line of a pair, from p to q (3,) [m]."""
        self._ends[pair] = p, q
        self._index.put(" ".join(pair), (np.minimum(p, q), np.maximum(p, q)))
        for thing in pair:
            self._of[thing].add(pair)

    def remove(self, pair: Pair) -> None:
        if self._ends.pop(pair, None) is not None:
            self._index.remove(" ".join(pair))
            for thing in pair:
                self._of[thing].discard(pair)

    def forget(self, thing: str) -> None:
        """Remove all lines that begin or end at a thing."""
        for pair in list(self._of.pop(thing, ())):
            self.remove(pair)

    def of(self, thing: str) -> frozenset[Pair]:
        """The pairs whose line begins or ends at a thing."""
        return frozenset(self._of.get(thing, ()))

    def over(self, bounds: tuple[Array, Array]) -> set[Pair]:
        """The pairs whose line passes over the ground between two corners."""
        return {_pair(name) for name in self._index.within(bounds, 0.0)}

    def between(
        self,
        pair: Pair,
        supports: Set[str],
        levels: Mapping[str, float],
        shapes: Mapping[str, Shape],
        within: Callable[[tuple[Array, Array], float], Iterable[str]],
    ) -> int:
        """How many other things stand on the line of a pair; 0 without a line.

        supports: what carries both; levels: the height at which each rests [m]. A support stands between them where
        the line comes from below to the one that stands higher, as from board to board.
        within(bounds, reach): the things whose ground meets such bounds.
        """
        if pair not in self._ends:
            return 0
        p, q = self._ends[pair]
        low, high = np.minimum(p, q), np.maximum(p, q)
        higher = pair[int(q[2] > p[2])]
        count = int(low[2] < levels[higher] - 0.5 * shapes[higher].voxel_size_m)
        for other in within((low, high), 0.0):
            if other in pair or other in supports or other not in shapes:
                continue
            shape = shapes[other]
            if shape.lowest <= high[2] and shape.highest >= low[2]:
                beside, clear = BESIDE_VOXELS * shape.voxel_size_m, CLEAR_VOXELS * shape.voxel_size_m
                count += bool(near_segment(shape.points, p, q, beside, clear))
        return count

    def document(self) -> list[list[Any]]:
        """All lines as JSON values: [name, name, p, q]."""
        return [[*pair, p.tolist(), q.tolist()] for pair, (p, q) in self._ends.items()]

    def restore(self, document: Iterable[list[Any]]) -> None:
        """Take over what `document` gave."""
        for one, two, p, q in document:
            self.put((one, two), np.array(p), np.array(q))


def _pair(name: str) -> Pair:
    one, two = name.split(" ")
    return one, two
