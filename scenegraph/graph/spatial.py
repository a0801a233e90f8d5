"""Where nodes are: oriented boxes by slot, found by place at a cost that depends on what is there."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import box_index, boxes
from scenegraph.graph.index import NodeIndex
from scenegraph.graph.node import LAYERS, Layer, Node

__all__ = ["SpatialIndex", "box_of"]

Array = NDArray[Any]
_LAYER_CODE: dict[str, int] = {name: code for code, name in enumerate(LAYERS)}


def box_of(node: Node) -> tuple[Array, Array, Array]:
    """Centre (3,), half size (3,) [m] and axes (3, 3) of a node's box; a node without one is a point."""
    if node.box is None:
        return node.position, np.zeros(3), np.eye(3)
    return node.box.center, 0.5 * node.box.size, node.box.rotation


class SpatialIndex:
    """The boxes of nodes by slot: `center`, `half` (n, 3) [m], `axes` (n, 3, 3), `layer` (n,), index into `LAYERS`; a
    node without a box is a point. The arrays are for reading; slots that are not taken have any values.

    Memory: some 170 bytes a slot.
    """

    def __init__(self, nodes: NodeIndex) -> None:
        self._n = self._n_cells = 0
        n = max(16, nodes.n_slots)
        self.center, self.half, self.axes = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3))
        self.layer, self._level = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
        self._cell, self._before, self._after = (np.full(n, -1, np.int32) for _ in range(3))
        self._begin(n)
        slots = np.array(list(nodes.slot_of.values()), np.int32)
        rows = np.array([slot for slot in slots.tolist() if not nodes.is_made(slot)], np.int32)
        if len(rows):
            table = nodes.table
            assert table is not None
            boxed = table.boxed[rows, None]
            self.center[rows] = np.where(boxed, table.center[rows], table.position[rows])
            self.half[rows] = np.where(boxed, 0.5 * table.size[rows], 0.0)
            self.axes[rows] = boxes.axes_of(np.where(boxed, table.rotation_wxyz[rows], (1.0, 0.0, 0.0, 0.0)))
            self.layer[rows] = table.layer[rows]
        for slot in slots.tolist():
            if nodes.is_made(slot):
                self._write(slot, nodes.at(slot))
        self._enter(slots)

    def copy(self) -> Self:
        """Another one with the same contents, which changes on its own."""
        other = type(self).__new__(type(self))
        other.__dict__.update({k: v.copy() if isinstance(v, np.ndarray) else v for k, v in self.__dict__.items()})
        return other

    def put(self, slot: int, node: Node) -> None:
        """Enter a node, or move it."""
        if slot >= len(self.center):
            self._grow(2 * slot)
        self._write(slot, node)
        self._enter(np.array([slot], np.int32))

    def drop(self, slot: int) -> None:
        """Take a node out."""
        box_index.drop(
            np.array([slot], np.int32), self._level, self._cell, self._before, self._after, self._heads, self._n_at
        )

    def within(self, p_map: Array, radius_m: float, layer: Layer | None) -> tuple[list[int], list[float]]:
        """The slots of the nodes within reach of a point (3,), nearest first, and their distances [m]."""
        slots, distance = box_index.near_point(
            self._candidates(p_map - radius_m, p_map + radius_m),
            self.center,
            self.half,
            self.axes,
            self.layer,
            -1 if layer is None else _LAYER_CODE.get(layer, len(LAYERS)),
            p_map,
            radius_m,
        )
        order = np.lexsort((slots, distance))
        return slots[order].tolist(), distance[order].tolist()

    def in_box(self, low: Array, high: Array, layer: Layer | None = None) -> Array:
        """The slots, in order, of the nodes that have a point between two corners (3,)."""
        slots: Array = box_index.meeting_box(
            self._candidates(low, high),
            self.center,
            self.half,
            self.axes,
            self.layer,
            -1 if layer is None else _LAYER_CODE.get(layer, len(LAYERS)),
            0.5 * (low + high),
            0.5 * (high - low),
        )
        return np.sort(slots)

    def bounds(self, slots: Array) -> tuple[Array, Array]:
        """The lowest and the highest corners (k, 3) [m] of the boxes in slots (k,)."""
        reach = (np.abs(self.axes[slots]) * self.half[slots, None, :]).sum(axis=2)
        return self.center[slots] - reach, self.center[slots] + reach

    def _candidates(self, low: Array, high: Array) -> Array:
        found: Array = box_index.candidates(
            low, high, self._level, self._cell, self._after, self._table, self._heads, self._n_at, self._reach, self._n
        )
        return found

    def _write(self, slot: int, node: Node) -> None:
        self.center[slot], self.half[slot], self.axes[slot] = box_of(node)
        self.layer[slot] = _LAYER_CODE[node.layer]

    def _enter(self, slots: Array) -> None:
        if len(slots) == 0:
            return
        self._n = max(self._n, int(slots.max()) + 1)
        if 2 * (self._n_cells + len(slots)) > len(self._table):
            self._begin(len(slots))
            slots = np.union1d(slots, np.flatnonzero(self._cell[: self._n] >= 0)).astype(np.int32)
            self._cell[:] = -1
            self._n_at[:] = 0
        self._n_cells = box_index.put(
            slots,
            self.center,
            self.half,
            self.axes,
            self._level,
            self._cell,
            self._before,
            self._after,
            self._table,
            self._heads,
            self._n_cells,
            self._n_at,
            self._reach,
        )

    def _begin(self, more: int) -> None:
        """An empty grid with room for what there is, for `more`, and for as many again."""
        size = 64
        while size < 4 * (self._n + more):
            size *= 2
        self._table: Array = np.full((size, 2), -1, np.int64)
        self._heads: Array = np.empty(size // 2 + 1, np.int32)
        self._n_cells = 0
        self._n_at: Array = np.zeros(box_index.N_LEVELS, np.int64)
        self._reach: Array = np.zeros(box_index.N_LEVELS)

    def _grow(self, n: int) -> None:
        """Room for n slots; what is there stays."""
        for name in ("center", "half", "axes", "layer", "_level", "_cell", "_before", "_after"):
            old = getattr(self, name)
            new = np.full((n, *old.shape[1:]), -1 if old.dtype == np.int32 else 0, old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)
