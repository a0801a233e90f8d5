"""One byte a voxel, in hashed blocks of 8³ under a sparse tree of uniform cells: what is alike is stored once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter, MappingError
from mapping.grid import BLOCK_EDGE, BLOCK_VOXELS, as_blocks, check_array, check_state
from mapping.kernels import cells
from mapping.kernels.cells import UNKNOWN

Array: TypeAlias = NDArray[Any]

_CHUNK = 4096  # blocks read or written at once: bounds the memory of copies


class Cells(NamedTuple):
    """Cells of one value: index (n, 3) at their level, level (n,) (a cube of 2^level blocks), value (n,) int8."""

    ijk: NDArray[np.int32]
    level: NDArray[np.uint8]
    value: NDArray[np.int8]


def _new_table(n: int) -> NDArray[np.int64]:
    """An empty hash table with room for `n` cells."""
    return np.full((1 << max(6, (3 * n // 2 - 1).bit_length()), 2), -1, np.int64)


class CellStore:
    """Voxels of one byte, −128 for *unknown*: hashed 8³ blocks, and above them uniform cells of 2^L blocks an edge.

    A block whose voxels are all the same takes one row and no voxels; eight such siblings that are the same become one
    cell of the next level, up to 128 blocks. Nothing is lost: a cell splits again where a part of it changes. (As
    OctoMap's pruning, Hornung et al. 2013, §3.3, over the hashed blocks of Nießner et al. 2013.)

    Kernels take `store.tree`; read it anew after anything that may grow the store.
    """

    edge, n_cells = BLOCK_EDGE, BLOCK_VOXELS
    """Voxels along a block's edge, and in a block."""

    def __init__(self, voxel_size_m: float) -> None:
        if not (np.isfinite(voxel_size_m) and voxel_size_m > 0.0):
            raise InvalidParameter(f"voxel_size_m: expected a length > 0 m, got {voxel_size_m!r}")
        self.voxel_size_m = float(voxel_size_m)
        self.counts: NDArray[np.int64] = np.zeros(5, np.int64)
        self._ijk: NDArray[np.int32] = np.empty((0, 3), np.int32)
        self._level: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._slot: NDArray[np.int32] = np.empty(0, np.int32)
        self._changed_at: NDArray[np.int64] = np.empty(0, np.int64)
        self._free_rows: NDArray[np.int32] = np.empty(0, np.int32)
        self.payload: NDArray[np.int8] = np.empty((0, BLOCK_VOXELS), np.int8)
        self._free_slots: NDArray[np.int32] = np.empty(0, np.int32)
        self.table: NDArray[np.int64] = np.empty((0, 2), np.int64)
        self._grow_rows(128)
        self._grow_payload(64)

    # -- what is there ------------------------------------------------------------------------------------
    @property
    def block_size_m(self) -> float:
        return BLOCK_EDGE * self.voxel_size_m

    @property
    def rows(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """table, ijk, level, slot, changed_at, free_rows: the tree as kernels that change it take it."""
        return self.table, self._ijk, self._level, self._slot, self._changed_at, self._free_rows

    @property
    def free_slots(self) -> NDArray[np.int32]:
        return self._free_slots

    @property
    def tree(self) -> tuple[Array, Array, Array, int]:
        """table, slot, payload, top: the tree as kernels that read it take it."""
        return self.table, self._slot, self.payload, int(self.counts[cells.TOP])

    @property
    def n_blocks(self) -> int:
        """How many blocks are stored voxel by voxel."""
        return int(self.counts[cells.N_SLOTS] - self.counts[cells.N_FREE_SLOTS])

    @property
    def n_nodes(self) -> int:
        """How many cells there are: blocks stored voxel by voxel, and uniform cells."""
        return int(self.counts[cells.N_ROWS] - self.counts[cells.N_FREE_ROWS])

    @property
    def memory_bytes(self) -> int:
        """Bytes in use. Room to grow into is not counted: it is memory that has never been touched."""
        rows = self._ijk.itemsize * 3 + sum(a.itemsize for a in (self._level, self._slot, self._changed_at))
        return int(
            self.counts[cells.N_SLOTS] * BLOCK_VOXELS
            + self.counts[cells.N_ROWS] * rows
            + 4 * (self.counts[cells.N_FREE_ROWS] + self.counts[cells.N_FREE_SLOTS])
            + self.table.nbytes
        )

    @property
    def block_ijk(self) -> NDArray[np.int32]:
        """(n, 3) the blocks of which something is known, cells as the blocks that they stand for."""
        return self._blocks_of(self._in_use() & (self._used(self._slot) != cells.uniform(UNKNOWN)))

    def changed_since(self, revision: int) -> NDArray[np.int32]:
        """(n, 3) the blocks that changed after `revision`, also those that are unknown again.

        Of a cell of several blocks it is known when the last of them changed; all of them are named then.
        """
        return self._blocks_of(self._in_use() & (self._used(self._changed_at) > revision))

    def uniform_cells(self) -> Cells:
        """The cells whose voxels are all the same, unknown ones left out."""
        slot = self._used(self._slot)
        which = np.flatnonzero(self._in_use() & (slot < 0) & (slot != cells.uniform(UNKNOWN)))
        return Cells(self._ijk[which], self._level[which], cells.value_of(slot[which]).astype(np.int8))

    def dense_blocks(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The blocks (n, 3) that are stored voxel by voxel, and their rows (n,) of `payload`."""
        which = np.flatnonzero(self._in_use() & (self._used(self._slot) >= 0))
        return self._ijk[which], self._slot[which]

    def read(self, block_ijk: ArrayLike) -> NDArray[np.int8]:
        """The voxels (K, 512) of blocks (K, 3); UNKNOWN where nothing is known."""
        blocks = as_blocks(block_ijk)
        values = np.empty((len(blocks), BLOCK_VOXELS), np.int8)
        table, slot, payload, top = self.tree
        cells.read_blocks(table, slot, payload, top, blocks, values)
        return values

    # -- change -------------------------------------------------------------------------------------------
    def write(self, block_ijk: ArrayLike, values: NDArray[np.int8], revision: int) -> NDArray[np.bool_]:
        """Give blocks (K, 3) the voxels (K, 512); returns (K,) whether that changed the block."""
        blocks = as_blocks(block_ijk)
        if values.shape != (len(blocks), BLOCK_VOXELS) or values.dtype != np.int8:
            raise InvalidParameter(
                f"evidence: expected int8 of shape {(len(blocks), BLOCK_VOXELS)}, got {values.dtype} of {values.shape}"
            )
        changed = np.zeros(len(blocks), np.bool_)
        done = 0
        while True:
            done = cells.write_blocks(
                *self.rows[:5], self.payload, self._free_rows, self._free_slots, self.counts, done, blocks,
                np.ascontiguousarray(values), revision, changed,
            )  # fmt: skip
            if done == len(blocks):
                return changed
            self.make_room()

    def fill(self, cell: Cells, revision: int) -> None:
        """Add uniform cells where nothing is known yet; raises `MappingError`, and adds none, where something is or two
        of them overlap."""
        for level in np.unique(cell.level):
            if level > cells.MAX_LEVEL:
                raise InvalidParameter(f"level: expected 0 … {cells.MAX_LEVEL}, got {level}")
        in_use = self._in_use()
        ijk = np.concatenate([self._used(self._ijk)[in_use], cell.ijk])
        level = np.concatenate([self._used(self._level)[in_use], cell.level])
        if not cells.distinct(ijk, level, _new_table(len(ijk))):
            raise MappingError("cells can only be added where nothing is known yet, each once")
        missing = len(cell.ijk) + 8 * (cells.MAX_LEVEL + 1) + int(self.counts[cells.N_ROWS]) - len(self._ijk)
        if missing > 0:
            self._grow_rows(len(self._ijk) + missing)
        cells.fill_cells(*self.rows, self.counts, cell.ijk, cell.level, cell.value, revision)

    def make_room(self) -> None:
        """Make sure that at least one more block can be written."""
        counts = self.counts
        if counts[cells.N_ROWS] + 8 * (cells.MAX_LEVEL + 1) > len(self._ijk):
            self._grow_rows(len(self._ijk) * 3 // 2)
        if counts[cells.N_FREE_SLOTS] == 0 and counts[cells.N_SLOTS] == len(self.payload):
            self._grow_payload(len(self.payload) * 3 // 2)

    def _grow_rows(self, n: int) -> None:
        used = int(self.counts[cells.N_ROWS])

        def grown(old: Array) -> Array:
            new = np.empty((n, *old.shape[1:]), old.dtype)
            new[:used] = old[:used]
            return new

        self._ijk, self._level, self._slot = grown(self._ijk), grown(self._level), grown(self._slot)
        self._changed_at, self._free_rows = grown(self._changed_at), grown(self._free_rows)
        self.table = _new_table(n)
        cells.refill(self.table, self._ijk, self._level, used)

    def _grow_payload(self, n: int) -> None:
        payload, free = np.empty((n, BLOCK_VOXELS), np.int8), np.empty(n, np.int32)
        payload[: len(self.payload)], free[: len(self._free_slots)] = self.payload, self._free_slots
        self.payload, self._free_slots = payload, free

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Copies of the arrays that make this store, in the order of its rows."""
        rows = np.flatnonzero(self._in_use())
        slot = self._slot[rows]
        dense = slot >= 0
        return {
            "block_ijk": self._ijk[rows][dense],
            "evidence": self.payload[slot[dense]],
            "cell_row": np.flatnonzero(~dense).astype(np.int64),
            "cell_ijk": self._ijk[rows][~dense],
            "cell_level": self._level[rows][~dense],
            "cell_value": cells.value_of(slot[~dense]).astype(np.int8),
        }

    def restore(self, state: Mapping[str, Array], revision: int) -> None:
        """Take over what `state()` gave, into an empty store; raises `MappingError` where it does not fit.

        Cells may be missing: maps of earlier versions held blocks alone.
        """
        check_state(not self.n_nodes, state, ("block_ijk", "evidence"))
        blocks = as_blocks(state["block_ijk"])
        evidence = check_array(state, "evidence", np.int8, (len(blocks), BLOCK_VOXELS))
        if "cell_ijk" not in state:
            self.write(blocks, evidence, revision)
            return
        cell = Cells(as_blocks(state["cell_ijk"]), state["cell_level"], state["cell_value"])
        cell_row = state["cell_row"]
        n = len(blocks) + len(cell.ijk)
        is_cell = np.zeros(n, np.bool_)
        if (
            not len(cell_row) == len(cell.level) == len(cell.value) == len(cell.ijk)
            or not ((cell_row >= 0) & (cell_row < n)).all()
        ):
            raise MappingError("the saved map's cells do not fit each other")
        is_cell[cell_row] = True
        if is_cell.sum() != len(cell.ijk) or (cell.level > cells.MAX_LEVEL).any():
            raise MappingError("the saved map's cells do not fit each other")
        self.counts[:] = 0
        self._grow_rows(n + 8 * (cells.MAX_LEVEL + 1))
        self._grow_payload(len(blocks) + 64)
        self._ijk[:n][is_cell], self._ijk[:n][~is_cell] = cell.ijk, blocks
        self._level[:n][is_cell], self._level[:n][~is_cell] = cell.level, 0
        self._slot[:n][is_cell] = cells.uniform(cell.value.astype(np.int32))
        self._slot[:n][~is_cell] = np.arange(len(blocks))
        self._changed_at[:n] = revision
        self.payload[: len(blocks)] = evidence
        self.counts[:] = n, 0, len(blocks), 0, int(cell.level.max(initial=0))
        if not cells.distinct(self._ijk[:n], self._level[:n], self.table):
            raise MappingError("the saved map names a block twice")

    # -- inside -------------------------------------------------------------------------------------------
    def _used(self, array: Array) -> Array:
        return array[: int(self.counts[cells.N_ROWS])]

    def _in_use(self) -> NDArray[np.bool_]:
        return np.asarray(self._used(self._level) != cells.GONE)

    def _blocks_of(self, which: Array) -> NDArray[np.int32]:
        rows = np.flatnonzero(which)
        ijk, level = self._ijk[rows], self._level[rows].astype(np.int64)
        if not level.any():
            return ijk
        spans = 1 << level
        of = np.repeat(np.arange(len(rows)), spans**3)
        inside = np.arange(len(of)) - np.repeat(np.cumsum(spans**3) - spans**3, spans**3)
        span = spans[of]
        within = np.stack([inside // (span * span), inside // span % span, inside % span], axis=1)
        return np.asarray(ijk[of] * span[:, None] + within, dtype=np.int32)
