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
        self._bounds: dict[str, tuple[float, float, float, float]] = {}
        self._members: defaultdict[Cell, set[str]] = defaultdict(set)

    def put(self, thing: str, bounds: tuple[Array, Array]) -> None:
        """Add or move a thing; bounds are its lowest and highest corner (3,) [m]."""
        self.remove(thing)
        (x0, y0), (x1, y1) = bounds[0][:2].tolist(), bounds[1][:2].tolist()
        self._bounds[thing] = (x0, y0, x1, y1)
        for cell in self._cells(x0, y0, x1, y1):
            self._members[cell].add(thing)

    def remove(self, thing: str) -> None:
        bounds = self._bounds.pop(thing, None)
        if bounds is not None:
            for cell in self._cells(*bounds):
                self._members[cell].discard(thing)
                if not self._members[cell]:
                    del self._members[cell]

    def bounds(self, thing: str) -> tuple[Array, Array] | None:
        """The lowest and highest corner (2,) of a thing on the ground [m]; None when it is not here."""
        known = self._bounds.get(thing)
        return None if known is None else (np.array(known[:2]), np.array(known[2:]))

    def within(self, bounds: tuple[Array, Array], reach_m: float) -> list[str]:
        """The things whose bounds, seen from above, lie within `reach_m` of the given ones along both axes; sorted."""
        (x0, y0), (x1, y1) = bounds[0][:2].tolist(), bounds[1][:2].tolist()
        x0, y0, x1, y1 = x0 - reach_m, y0 - reach_m, x1 + reach_m, y1 + reach_m
        about = set[str]()
        for cell in self._cells(x0, y0, x1, y1):
            if cell in self._members:
                about |= self._members[cell]
        found = []
        for thing in about:
            a, b, c, d = self._bounds[thing]
            if a <= x1 and b <= y1 and c >= x0 and d >= y0:
                found.append(thing)
        return sorted(found)

    def _cells(self, x0: float, y0: float, x1: float, y1: float) -> Iterator[Cell]:
        for i in range(int(x0 // self._cell_m), int(x1 // self._cell_m) + 1):
            for j in range(int(y0 // self._cell_m), int(y1 // self._cell_m) + 1):
                yield i, j
