"""Every index ⇄ point conversion, and the hashed store of 8³-voxel blocks that all voxel layers stand on.

Voxel (i, j, k) covers [i·v, (i+1)·v) along each axis; its centre is (i + ½)·v. Block = voxel >> 3. Within a block the
linear index is lx·64 + ly·8 + lz. (After Nießner et al., Real-time 3D Reconstruction at Scale using Voxel Hashing,
2013.)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from mapping.errors import InvalidParameter, MappingError
from mapping.kernels import hashing

Array: TypeAlias = NDArray[Any]

BLOCK_EDGE = 8
"""Voxels along a block's edge."""
BLOCK_VOXELS = BLOCK_EDGE**3
ADDRESSABLE_VOXELS = BLOCK_EDGE * hashing.BLOCK_LIMIT
"""Voxel indices lie within ± this."""

LOCAL_IJK: NDArray[np.int32] = np.stack(np.unravel_index(np.arange(BLOCK_VOXELS), (BLOCK_EDGE,) * 3), axis=1).astype(
    np.int32
)
"""(512, 3): position within the block of each linear index."""
LOCAL_IJK.setflags(write=False)


def read_only(array: Array) -> Array:
    """A view that cannot be written, so that kernels are compiled for one type of input whatever the caller holds."""
    view = array.view()
    view.setflags(write=False)
    return view


def as_points(points: ArrayLike, name: str = "p_map") -> NDArray[np.float64]:
    """`points` as contiguous read-only (N, 3) float64; raises `InvalidParameter` on another shape."""
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidParameter(f"{name}: expected points (N, 3), got an array of shape {array.shape}")
    return read_only(array)


def as_blocks(block_ijk: ArrayLike) -> NDArray[np.int32]:
    """`block_ijk` as contiguous read-only (K, 3) int32; raises `InvalidParameter` on another shape."""
    array = np.asarray(block_ijk)
    if array.size == 0:
        return read_only(np.empty((0, 3), np.int32))
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InvalidParameter(f"block_ijk: expected integers (K, 3), got {array.dtype} of shape {array.shape}")
    if max(-int(array.min()), int(array.max()) + 1) > hashing.BLOCK_LIMIT:
        raise InvalidParameter(
            f"block_ijk: expected indices within ±{hashing.BLOCK_LIMIT}, got {int(np.abs(array).max())}"
        )
    return read_only(np.ascontiguousarray(array, dtype=np.int32))


def point_to_ijk(p_map: ArrayLike, voxel_size_m: float) -> NDArray[np.int32]:
    """The voxel (N, 3) that holds each point (N, 3) [m]."""
    return np.floor(np.asarray(p_map, dtype=np.float64) * (1.0 / voxel_size_m)).astype(np.int32)


def ijk_to_centre(ijk: ArrayLike, voxel_size_m: float) -> NDArray[np.float64]:
    """The centre (N, 3) [m] of each voxel (N, 3)."""
    return (np.asarray(ijk, dtype=np.float64) + 0.5) * voxel_size_m


def split_ijk(ijk: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Voxels (N, 3) → their blocks (N, 3) and linear index within the block (N,)."""
    voxels = np.asarray(ijk)
    inside = (voxels & (BLOCK_EDGE - 1)).astype(np.int64)
    return (voxels >> 3).astype(np.int32), inside[..., 0] << 6 | inside[..., 1] << 3 | inside[..., 2]


def join_ijk(block_ijk: ArrayLike, local: ArrayLike) -> NDArray[np.int32]:
    """Blocks (N, 3) and linear indices within them (N,) → voxels (N, 3)."""
    voxels: NDArray[np.int32] = (np.asarray(block_ijk, dtype=np.int32) << 3) + LOCAL_IJK[np.asarray(local)]
    return voxels


def new_table(block_ijk: NDArray[np.int32], n_blocks: int, capacity: int) -> NDArray[np.int64]:
    """A hash table with room for `capacity` blocks, in which the first `n_blocks` of block_ijk have slots 0, 1, …"""
    table = np.full((1 << max(6, (2 * capacity - 1).bit_length()), 2), -1, np.int64)
    hashing.refill(table, read_only(block_ijk), n_blocks)
    return table


def check_state(empty: bool, state: Mapping[str, Array], names: Iterable[str]) -> None:
    """Raises `MappingError` where a state cannot be restored: into what is not empty, or for want of arrays `names`."""
    if not empty:
        raise MappingError("a state can only be restored into an empty store")
    missing = [name for name in names if name not in state]
    if missing:
        raise MappingError(f"the saved map lacks {', '.join(missing)}")


def check_array(state: Mapping[str, Array], name: str, dtype: DTypeLike, shape: tuple[int, ...]) -> Array:
    """The array `name` of a saved map; raises `MappingError` where it is of another type or shape."""
    values = state[name]
    if values.shape != shape or values.dtype != dtype:
        raise MappingError(
            f"the saved map's {name}: expected {np.dtype(dtype)} of shape {shape}, "
            f"got {values.dtype} of shape {values.shape}"
        )
    return values


class BlockStore:
    """Blocks of voxels, found by a hash of their index, each field an array of its own; grows by doubling.

    fields        name → dtype; a sub-array dtype such as `("u2", 3)` gives a field of shape (capacity, n, 3) for blocks
                  of n voxels
    voxel_size_m  edge of a voxel [m]
    fill          value of a field in a new block (default 0), such as the code of *unknown*
    edge, axes    voxels along a block's edge, and axes that it extends along: 8³ by default; (8, 2) gives flat tiles of
                  64 columns with block index (i, j, 0), (1, 3) single voxels, for layers that are sparser than blocks

    Slots are given in the order in which blocks are asked for and never move, so that equal calls give equal stores.
    Kernels take `store.table` (see `mapping.kernels.hashing.lookup`) and the arrays of `store.fields`; both are
    replaced when the store grows: read them anew after `allocate`.
    """

    def __init__(
        self,
        fields: Mapping[str, DTypeLike],
        voxel_size_m: float,
        *,
        fill: Mapping[str, int | float] | None = None,
        edge: int = BLOCK_EDGE,
        axes: int = 3,
    ) -> None:
        if not (np.isfinite(voxel_size_m) and voxel_size_m > 0.0):
            raise InvalidParameter(f"voxel_size_m: expected a length > 0 m, got {voxel_size_m!r}")
        self.voxel_size_m = float(voxel_size_m)
        self.edge = edge
        self.n_cells = edge**axes
        """Voxels of a block."""
        self._dtypes = {name: np.dtype(dtype) for name, dtype in fields.items()}
        self._fill = {name: (fill or {}).get(name, 0) for name in self._dtypes}
        self._capacity = 0
        self._n_blocks = 0
        self._stored_ijk: NDArray[np.int32] = np.empty((0, 3), np.int32)
        self.fields: dict[str, Array] = {name: self._filled(name, 0) for name in self._dtypes}
        self.changed_at: NDArray[np.int64] = np.zeros(0, np.int64)
        """(capacity,) the revision of its layer at which each block last changed."""
        self.table = new_table(self._stored_ijk, 0, 0)

    # -- what is there ------------------------------------------------------------------------------------
    @property
    def n_blocks(self) -> int:
        return self._n_blocks

    @property
    def block_ijk(self) -> NDArray[np.int32]:
        """(n_blocks, 3) index of each block, in slot order (a view: do not write)."""
        return self._stored_ijk[: self._n_blocks]

    @property
    def block_size_m(self) -> float:
        return self.edge * self.voxel_size_m

    @property
    def memory_bytes(self) -> int:
        """Bytes held by all arrays, room to grow included."""
        return (
            sum(field.nbytes for field in self.fields.values())
            + self.table.nbytes
            + self._stored_ijk.nbytes
            + self.changed_at.nbytes
        )

    def used(self, name: str) -> Array:
        """(n_blocks, n_cells, …) the field of the blocks that exist (a view)."""
        return self.fields[name][: self._n_blocks]

    def find(self, block_ijk: ArrayLike) -> NDArray[np.int64]:
        """The slot (K,) of each block (K, 3), −1 where there is none."""
        blocks = as_blocks(block_ijk)
        slots = np.empty(len(blocks), np.int64)
        hashing.find_all(self.table, blocks, slots)
        return slots

    def locate(self, p_map: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Slot (N,) (−1: no block) and index within the block (N,) of the voxel that holds each point (N, 3) [m]; for
        blocks of 8³."""
        points = as_points(p_map)
        slots = np.empty(len(points), np.int64)
        local = np.empty(len(points), np.int64)
        hashing.locate(self.table, points, 1.0 / self.voxel_size_m, slots, local)
        return slots, local

    def changed_since(self, revision: int) -> NDArray[np.int32]:
        """The blocks (n, 3) that changed after `revision`."""
        return self.block_ijk[self.changed_at[: self._n_blocks] > revision]

    # -- growth -------------------------------------------------------------------------------------------
    def allocate(self, block_ijk: ArrayLike) -> NDArray[np.int64]:
        """The slot (K,) of each block (K, 3); blocks that are not there yet are added, filled. Repeats are fine."""
        blocks = as_blocks(block_ijk)
        slots = np.empty(len(blocks), np.int64)
        missing = hashing.find_all(self.table, blocks, slots)
        if missing:
            self._reserve(self._n_blocks + missing)
            self._n_blocks = hashing.insert_all(self.table, self._stored_ijk, self._n_blocks, blocks, slots)
        return slots

    def add_field(self, name: str, dtype: DTypeLike) -> None:
        """Add a field, zero everywhere; raises `InvalidParameter` when it is there already."""
        if name in self.fields:
            raise InvalidParameter(f"name: expected a new field, got {name!r}, which exists")
        self._dtypes[name], self._fill[name] = np.dtype(dtype), 0
        self.fields[name] = self._filled(name, self._capacity)

    def _filled(self, name: str, n: int) -> Array:
        if self._fill[name] == 0:
            return np.zeros((n, self.n_cells), self._dtypes[name])
        return np.full((n, self.n_cells, *self._dtypes[name].shape), self._fill[name], self._dtypes[name].base)

    def _reserve(self, n: int) -> None:
        if n <= self._capacity:
            return
        capacity = max(64, self._capacity)
        while capacity < n:
            capacity *= 2
        for name in self.fields:
            grown = self._filled(name, capacity)
            grown[: self._n_blocks] = self.used(name)
            self.fields[name] = grown
        self.changed_at = np.concatenate([self.changed_at, np.zeros(capacity - self._capacity, np.int64)])
        stored = np.empty((capacity, 3), np.int32)
        stored[: self._n_blocks] = self.block_ijk
        self._stored_ijk = stored
        self._capacity = capacity
        self.table = new_table(stored, self._n_blocks, capacity)

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Copies of the arrays that make this store: `block_ijk` and each field."""
        return {"block_ijk": self.block_ijk.copy(), **{name: self.used(name).copy() for name in self.fields}}

    def restore(self, state: Mapping[str, Array], revision: int = 1) -> None:
        """Take over what `state()` gave, into an empty store, as changed at `revision`; raises `MappingError` where it
        does not fit."""
        check_state(not self._n_blocks, state, ("block_ijk", *self.fields))
        blocks = as_blocks(state["block_ijk"])
        for name, dtype in self._dtypes.items():
            check_array(state, name, dtype.base, (len(blocks), self.n_cells, *dtype.shape))
        self.allocate(blocks)
        if self._n_blocks != len(blocks):
            raise MappingError("the saved map names a block twice")
        for name in self.fields:
            self.used(name)[:] = state[name]
        self.changed_at[: self._n_blocks] = revision
