"""A grid over the ground that finds the things near a thing, whatever the number of things."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Cell: TypeAlias = tuple[int, int]


class GroundIndex:
    """Axis-aligned bounds of things, found by the ground cells of side `cell_m` that they cover."""

    def __init__(self, cell_m: float = 2.0) -> None:
        self._cell_m = cell_m
        self._bounds: dict[str, tuple[Array, Array]] = {}
        self._members: defaultdict[Cell, set[str]] = defaultdict(set)

    def put(self, thing: str, bounds: tuple[Array, Array]) -> None:
        """Add or move a thing; bounds are its lowest and highest corner (3,) [m]."""
        self.remove(thing)
        self._bounds[thing] = bounds
        for cell in self._cells(bounds, 0.0):
            self._members[cell].add(thing)

    def remove(self, thing: str) -> None:
        bounds = self._bounds.pop(thing, None)
        if bounds is not None:
            for cell in self._cells(bounds, 0.0):
                self._members[cell].discard(thing)
                if not self._members[cell]:
                    del self._members[cell]

    def within(self, bounds: tuple[Array, Array], reach_m: float) -> list[str]:
        """The things whose bounds, seen from above, lie within `reach_m` of the given ones along both axes; sorted."""
        low, high = bounds
        found = set()
        for cell in self._cells(bounds, reach_m):
            for thing in self._members.get(cell, ()):
                a, b = self._bounds[thing]
                if (a[:2] <= high[:2] + reach_m).all() and (b[:2] >= low[:2] - reach_m).all():
                    found.add(thing)
        return sorted(found)

    def _cells(self, bounds: tuple[Array, Array], reach_m: float) -> Iterator[Cell]:
        low = np.floor((bounds[0][:2] - reach_m) / self._cell_m).astype(int)
        high = np.floor((bounds[1][:2] + reach_m) / self._cell_m).astype(int)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                yield i, j
