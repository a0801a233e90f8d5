"""The sparse voxel store: blocks of 8³ voxels, found by a hash, that keep records of the voxels in use and no others.

For what lies on surfaces: of a block that a wall passes, an eighth to a quarter is in use. A record costs its fields
and about two bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from mapping.errors import MappingError
from mapping.grid import BLOCK_EDGE, BlockStore, as_blocks, as_points, check_array, check_state, join_ijk, split_ijk
from mapping.kernels import packed as kernels
from mapping.layer import SlotLayer

Array: TypeAlias = NDArray[Any]

GROWTH = 1.25
"""When the records are full, they are laid out anew with so many times the room that they need."""
MOST_BLOCKS = 1 << 22
"""A cell is an int32."""


class PackedStore:
    """Records of single voxels, each field an array of its own with a row for each record.

    fields        name → (dtype, number of columns); zero in a new record
    voxel_size_m  edge of a voxel [m]

    A *cell* is a block's slot · 512 + the voxel's linear index in it, and stays what it is as the store grows; a *row*
    is where a voxel's record lies, until records are added or removed. Read `masks`, `first`, `table` and `fields` anew
    after that, too.
    """

    def __init__(self, fields: Mapping[str, tuple[DTypeLike, int]], voxel_size_m: float) -> None:
        self.voxel_size_m = voxel_size_m
        self._slabs = BlockStore({"mask": "u8", "first": "i4"}, voxel_size_m, fill={"first": -1}, edge=8, axes=1)
        self.fields: dict[str, Array] = {name: np.zeros((0, n), dtype) for name, (dtype, n) in fields.items()}
        self._free = np.full(kernels.CLASSES, -1, np.int64)
        self._links = np.empty(0, np.int32)
        self._end = 0
        self._n_records = 0

    # -- what is there ------------------------------------------------------------------------------------
    @property
    def block_size_m(self) -> float:
        return self._slabs.block_size_m

    @property
    def block_ijk(self) -> NDArray[np.int32]:
        """(n_blocks, 3) index of each block, in slot order (a view: do not write)."""
        return self._slabs.block_ijk

    @property
    def n_blocks(self) -> int:
        return self._slabs.n_blocks

    @property
    def n_records(self) -> int:
        """Voxels that have a record."""
        return self._n_records

    @property
    def table(self) -> Array:
        return self._slabs.table

    @property
    def masks(self) -> NDArray[np.uint64]:
        """(·, 8) which voxels have records, see `mapping.kernels.packed`."""
        return self._slabs.fields["mask"]

    @property
    def first(self) -> NDArray[np.int32]:
        """(·, 8) the row of each slab's first record."""
        return self._slabs.fields["first"]

    @property
    def changed_at(self) -> NDArray[np.int64]:
        return self._slabs.changed_at

    @property
    def memory_bytes(self) -> int:
        """Bytes held by all arrays, room to grow included."""
        return self._slabs.memory_bytes + self._links.nbytes + sum(field.nbytes for field in self.fields.values())

    def changed_since(self, revision: int) -> NDArray[np.int32]:
        return self._slabs.changed_since(revision)

    def find(self, block_ijk: ArrayLike) -> NDArray[np.int64]:
        """The slot (K,) of each block (K, 3), −1 where there is none."""
        return self._slabs.find(block_ijk)

    def cells_at(self, p_map: ArrayLike) -> NDArray[np.int64]:
        """The cell (N,) of the voxel that holds each point (N, 3) [m]; −1 where there is no block."""
        slots, local = self._slabs.locate(as_points(p_map))
        return np.where(slots >= 0, slots << 9 | local, -1)

    def cells_of(self, ijk: ArrayLike) -> NDArray[np.int64]:
        """The cell (N,) of each voxel (N, 3); −1 where there is no block."""
        blocks, local = split_ijk(ijk)
        slots = self._slabs.find(blocks)
        return np.where(slots >= 0, slots << 9 | local, -1)

    def rows(self, cells: Array) -> NDArray[np.int64]:
        """The row (N,) of the record of each cell (N,); −1 where it has none, and for cells of −1."""
        rows = np.empty(len(cells), np.int64)
        kernels.rows_of(self.masks, self.first, np.asarray(cells, np.int64), rows)
        return rows

    def cells(self, slots: ArrayLike | None = None) -> NDArray[np.int64]:
        """The cells (n,) of all records in the blocks `slots` (m,) (None: in all), block by block, each in order."""
        chosen = np.arange(self.n_blocks) if slots is None else np.asarray(slots, np.int64)
        cells = np.empty(int(kernels.count_records(self.masks[chosen])), np.int64)
        kernels.list_cells(self.masks, chosen, cells)
        return cells

    def ijk(self, cells: Array) -> NDArray[np.int32]:
        """The voxel (N, 3) of each cell (N,) ≥ 0."""
        return join_ijk(self.block_ijk[cells >> 9], cells & 511)

    # -- change -------------------------------------------------------------------------------------------
    def allocate(self, block_ijk: ArrayLike) -> NDArray[np.int64]:
        """The slot (K,) of each block (K, 3); blocks that are not there yet are added, without records."""
        slots = self._slabs.allocate(block_ijk)
        if self.n_blocks > MOST_BLOCKS:
            raise MappingError(f"the map has more than {MOST_BLOCKS} blocks of {self.block_size_m:g} m")
        return slots

    def add(self, cells: Array) -> None:
        """Give each cell (n,) ≥ 0 a record, zero in all fields, where it has none yet."""
        self._change(kernels.want, cells)

    def remove(self, cells: Array) -> None:
        """Take the records of the cells (n,) ≥ 0 away."""
        self._change(kernels.drop, cells)

    def _change(self, mark: Any, cells: Array) -> None:
        most = min(self.n_blocks, cells.size)
        slots, old = np.empty(most, np.int64), np.empty((most, BLOCK_EDGE), np.uint64)
        starts = np.empty(most, np.int64)
        n = mark(self.masks, self.first, cells.ravel(), slots, old, starts)
        if not n:
            return
        slots, old, starts = slots[:n], old[:n], starts[:n]
        source, target, fresh, self._end = kernels.settle(
            self.masks, self.first, slots, old, starts, self._free, self._links, self._end
        )
        self._n_records += int(kernels.count_records(self.masks[slots]) - kernels.count_records(old))
        full = self._end > self._links.size * kernels.CHUNK
        for name, field in self.fields.items():
            if full:
                held, field = field, np.empty((self._end, field.shape[1]), field.dtype)
                field[: len(held)] = held
                self.fields[name] = field
            kernels.shift(field, source, target, fresh)
        if full:
            self._lay_out()

    def _lay_out(self) -> None:
        """Put the records of all blocks one behind the other, with room to grow."""
        moves = np.empty((self.n_blocks, 3), np.int64)
        self._end = int(kernels.lay_out(self.masks[: self.n_blocks], self.first, moves))
        chunks = -(-int(GROWTH * self._end) // kernels.CHUNK)
        self._links, self._free[:] = np.empty(chunks, np.int32), -1
        for name, field in self.fields.items():
            laid = np.empty((chunks * kernels.CHUNK, field.shape[1]), field.dtype)
            kernels.move(moves, field.strides[0], field.view(np.uint8).ravel(), laid.view(np.uint8).ravel())
            self.fields[name] = laid

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Copies of the arrays that make this store: `block_ijk`, `masks`, and each field in the order of `cells`."""
        rows = self.rows(self.cells())
        masks = self.masks[: self.n_blocks].copy()
        return {
            "block_ijk": self.block_ijk.copy(),
            "masks": masks,
            **{name: field[rows] for name, field in self.fields.items()},
        }

    def restore(self, state: Mapping[str, Array], revision: int = 1) -> None:
        """Take over what `state()` gave, into an empty store, as changed at `revision`; raises `MappingError` where it
        does not fit."""
        check_state(not self.n_blocks, state, ("block_ijk", "masks", *self.fields))
        blocks = as_blocks(state["block_ijk"])
        masks = check_array(state, "masks", np.uint64, (len(blocks), BLOCK_EDGE))
        n = int(kernels.count_records(masks))
        for name, field in self.fields.items():
            check_array(state, name, field.dtype, (n, field.shape[1]))
        self.allocate(blocks)
        if self.n_blocks != len(blocks):
            raise MappingError("the saved map names a block twice")
        cells = np.empty(n, np.int64)
        kernels.list_cells(masks, np.arange(len(blocks)), cells)
        self.add(cells)
        rows = self.rows(cells)
        for name, field in self.fields.items():
            field[rows] = state[name]
        self.changed_at[: len(blocks)] = revision


class PackedLayer(SlotLayer):
    """A layer whose voxels lie in a `PackedStore`."""

    store: PackedStore
