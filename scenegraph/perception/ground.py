"""A dense ground grid that grows in every direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


_CHANNELS = ("free", "room", "drawn", "sky")


class GroundGrid:
    """Cells (i, j) of the plane z = 0 of map, each `cell_m` wide, cell (0, 0) at the origin; some values a cell.

    free : bool, room : int32 (0 = none), drawn : bool (an operator drew the room), sky : bool (free above every
    ceiling). Cells outside what was covered so far read as False and 0.
    """

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._low = np.zeros(2, np.int64)
        self.free: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self.room: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        self.drawn: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self.sky: NDArray[np.bool_] = np.zeros((0, 0), bool)

    def cover(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Make room for the cells low … high (2,), both included; returns where they lie in the arrays."""
        old_high = self._low + self.free.shape
        if not self.free.size:
            self._low, old_high = np.array(low), np.array(low)
        if (low < self._low).any() or (high + 1 > old_high).any():
            room_to_grow = 40
            new_low = np.where(low < self._low, np.asarray(low) - room_to_grow, self._low)
            new_high = np.where(high + 1 > old_high, np.asarray(high) + 1 + room_to_grow, old_high)
            where = tuple(slice(a, a + n) for a, n in zip(self._low - new_low, self.free.shape, strict=True))
            for name in _CHANNELS:
                old = getattr(self, name)
                grown = np.zeros(tuple((new_high - new_low).tolist()), old.dtype)
                grown[where] = old
                setattr(self, name, grown)
            self._low = new_low
        i, j = (np.asarray(low) - self._low).tolist()
        m, n = (np.asarray(high) - self._low + 1).tolist()
        return slice(i, m), slice(j, n)

    @property
    def low(self) -> NDArray[np.int64]:
        """The cell (2,) that the first entry of the arrays stands for."""
        return self._low

    def state(self) -> dict[str, Array]:
        """The arrays that make this grid."""
        return {"low": self._low.copy(), **{name: getattr(self, name).copy() for name in _CHANNELS}}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take over what `state` gave; a value that older states lack is False everywhere."""
        self._low = np.array(state["low"])
        for name in _CHANNELS:
            setattr(self, name, np.array(state.get(name, np.zeros_like(state["free"]))))

    def at(self, xy: Array) -> Array:
        """The room number (N,) at points (N, 2) [m]; 0 where there is none."""
        ij = np.floor(np.asarray(xy) / self.cell_m).astype(np.int64) - self._low
        inside = ((ij >= 0) & (ij < self.room.shape)).all(axis=1)
        found = np.zeros(len(ij), np.int32)
        found[inside] = self.room[ij[inside, 0], ij[inside, 1]]
        return found
