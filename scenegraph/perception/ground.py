"""Dense ground grids that grow in every direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


class Grid:
    """Cells (i, j) of the plane z = 0 of map, each `cell_m` wide, cell (0, 0) at the origin; some values a cell.

    `channels` names the arrays (W, H) that hold the values, and their types. Cells outside what was covered so far
    read as 0 and False.
    """

    channels: ClassVar[Mapping[str, type]] = {}

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._low = np.zeros(2, np.int64)
        self._shape = (0, 0)
        for name, kind in self.channels.items():
            setattr(self, name, np.zeros((0, 0), kind))

    def cover(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Make room for the cells low … high (2,), both included; returns where they lie in the arrays."""
        old_high = self._low + self._shape
        if 0 in self._shape:
            self._low, old_high = np.array(low), np.array(low)
        if (low < self._low).any() or (high + 1 > old_high).any():
            room_to_grow = max(40, max(self._shape) // 4)
            new_low = np.where(low < self._low, np.asarray(low) - room_to_grow, self._low)
            new_high = np.where(high + 1 > old_high, np.asarray(high) + 1 + room_to_grow, old_high)
            where = tuple(slice(a, a + n) for a, n in zip(self._low - new_low, self._shape, strict=True))
            width, height = (new_high - new_low).tolist()
            for name in self.channels:
                old = getattr(self, name)
                grown = np.zeros((width, height), old.dtype)
                grown[where] = old
                setattr(self, name, grown)
            self._low, self._shape = new_low, (width, height)
        i, j = (np.asarray(low) - self._low).tolist()
        m, n = (np.asarray(high) - self._low + 1).tolist()
        return slice(i, m), slice(j, n)

    @property
    def low(self) -> NDArray[np.int64]:
        """The cell (2,) that the first entry of the arrays stands for."""
        return self._low

    def state(self) -> dict[str, Array]:
        """The arrays that make this grid."""
        return {"low": self._low.copy(), **{name: getattr(self, name).copy() for name in self.channels}}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take over what `state` gave; values that older states lack are 0 everywhere."""
        self._low = np.array(state["low"])
        known = next(state[name] for name in self.channels if name in state)
        width, height = self._shape = known.shape
        for name, kind in self.channels.items():
            setattr(self, name, np.array(state.get(name, np.zeros((width, height), kind)), dtype=kind))

    def look_up(self, channel: str, xy: Array) -> Array:
        """The value (N,) of a channel at points (N, 2) [m]; 0 where nothing was covered."""
        values = getattr(self, channel)
        ij = np.floor(np.asarray(xy) / self.cell_m).astype(np.int64) - self._low
        inside = ((ij >= 0) & (ij < self._shape)).all(axis=1)
        found = np.zeros(len(ij), values.dtype)
        found[inside] = values[ij[inside, 0], ij[inside, 1]]
        return found


class GroundGrid(Grid):
    """The ground of the rooms of a storey.

    free : bool, room : int32 (0 = none), drawn : bool (an operator gave it to the room, or to none), sky : bool (free
    above every ceiling), tall : bool (something is as high as that), solid : uint16 (a bit for each layer of blocks at
    standing height in which something is)
    """

    channels: ClassVar[Mapping[str, type]] = {
        "free": np.bool_, "room": np.int32, "drawn": np.bool_, "sky": np.bool_, "tall": np.bool_,
        "solid": np.uint16,
    }  # fmt: skip
    free: NDArray[np.bool_]
    room: NDArray[np.int32]
    drawn: NDArray[np.bool_]
    sky: NDArray[np.bool_]
    tall: NDArray[np.bool_]
    solid: NDArray[np.uint16]

    def at(self, xy: Array) -> Array:
        """The room number (N,) at points (N, 2) [m]; 0 where there is none."""
        return self.look_up("room", xy)
