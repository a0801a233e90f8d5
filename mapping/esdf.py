"""Euclidean signed distances: how far and in which direction the nearest surface is, for collision checks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import ADDRESSABLE_VOXELS, BLOCK_EDGE, BlockStore, as_points, read_only
from mapping.kernels import esdf, mend_classes, mend_crossings, nearest, sites
from mapping.layer import BlockLayer, Changed, require
from mapping.occupancy import OccupancyMap
from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]

_MOST_CELLS = 1 << 22  # blocks in the box of what is mended at once; larger regions are done in parts


class EsdfMap(BlockLayer):
    """Signed distance [m] from each voxel that its source knows to the nearest surface, capped.

    source        an `OccupancyMap` (surfaces are the faces between occupied and other voxels) or a `TsdfMap` (surfaces
                  are its zero crossings); None makes a field that follows nothing, such as one loaded from a file
    truncation_m  distances beyond are this [m]

    Positive in free space, negative inside; NaN where the source knows nothing: unknown is not free. Note that a
    `TsdfMap` knows only the band about its surfaces. Distances from an `OccupancyMap` are exact between voxel centres;
    from a `TsdfMap` they lead to the surface beside the nearest voxel that touches it.

    The field follows its source: `update`, and so every `query`, first takes over what changed. Sites, the voxels that
    others are far from, are kept as bits. Where a site came, it is offered to the voxels of the blocks near enough;
    where one went, the voxels that were as far as it look for their nearest site anew. These are the lower and raise
    waves of Lau, Sprunk & Burgard (Robotics and Autonomous Systems 2013) and of Voxblox (Oleynikova et al., IROS 2017),
    but from block to block instead of from voxel to voxel, which keeps the distances exact: they are those of a field
    made anew, bit by bit. Of a `TsdfMap` all sites count as changed in blocks that changed.

    Costs 4.3 bytes a voxel of the blocks that the source knows, before room to grow.
    """

    kind: ClassVar[str] = "esdf"

    def __init__(
        self,
        source: OccupancyMap | TsdfMap | None = None,
        truncation_m: float = 2.0,
        *,
        voxel_size_m: float | None = None,
    ) -> None:
        if source is not None and not isinstance(source, OccupancyMap | TsdfMap):
            raise InvalidParameter(f"source: expected an OccupancyMap or a TsdfMap, got {type(source).__name__}")
        if source is not None and voxel_size_m not in (None, source.voxel_size_m):
            raise InvalidParameter(
                f"voxel_size_m: expected that of the source, {source.voxel_size_m}, got {voxel_size_m}"
            )
        size = require("voxel_size_m", source.voxel_size_m if source else voxel_size_m or 0.0, 0.0, 100.0, "m")
        self.truncation_m = require("truncation_m", truncation_m, size, 200.0 * size, "m (1 … 200 voxels)")
        self.source = source
        self._seen = 0
        self._margin = int(np.ceil((self.truncation_m / size + 2.0) / BLOCK_EDGE))
        self._values = _distances(size, self.truncation_m)
        # A surface may pass a voxel beside the site of signed distances that tells of it.
        beyond = int((self.truncation_m / size + 1.0) ** 2) + 1
        self._far = beyond if isinstance(source, TsdfMap) else len(self._values) - 1
        self._offsets = _offsets(self._margin, self._far)
        self._planes = np.zeros((0, 2, 8), np.uint64)
        self._reach = np.zeros((0, 2), np.int32)
        self._deepest = np.zeros(2, np.int64)
        self._bounds: tuple[Array, Array] = (np.full(3, ADDRESSABLE_VOXELS), np.full(3, -ADDRESSABLE_VOXELS))
        self.store = BlockStore({"distance": np.float32}, size, fill={"distance": np.nan})

    def parameters(self) -> dict[str, Any]:
        return {"voxel_size_m": self.voxel_size_m, "truncation_m": self.truncation_m}

    @property
    def exact_below_m(self) -> float:
        """Shorter distances are exact between the centres of voxels, but for half a voxel [m]."""
        return self.truncation_m if isinstance(self.source, OccupancyMap) else 0.0

    @property
    def memory_bytes(self) -> int:
        return self.store.memory_bytes + self._planes.nbytes + self._reach.nbytes

    # -- following the source -----------------------------------------------------------------------------
    def update(self) -> Changed:
        """Take over what changed in the source since the last call; returns the blocks whose distances changed."""
        nothing = Changed(np.empty((0, 3), np.int32), self.block_size_m)
        if self.source is None or self.source.revision == self._seen:
            return nothing
        blocks = self.source.changed_since(self._seen).blocks
        self._seen = self.source.revision
        if not len(blocks):
            return nothing
        self._make_room(blocks)
        read = self._read_classes if isinstance(self.source, OccupancyMap) else self._read_crossings
        blocks, appeared, vanished = read(blocks)
        if not len(blocks):
            return nothing
        parts = self._parts(blocks, np.arange(len(blocks)))
        changed = [self._mend(blocks[part], appeared[part], vanished[part]) for part in parts]
        return self._note(np.unique(np.concatenate(changed)))

    def _read_classes(self, blocks: Array) -> tuple[Array, Array, Array]:
        """The blocks (K, 3) of these whose voxels changed class, and the sites (K, 2, 8) that came and went."""
        assert isinstance(self.source, OccupancyMap)
        appeared, vanished = (np.empty((len(blocks), 2, 8), np.uint64) for _ in range(2))
        sites.read_classes(self.source.evidence_of(blocks), self.store.find(blocks), self._planes, appeared, vanished)
        rows = (appeared | vanished).any(axis=(1, 2))
        return blocks[rows], appeared[rows], vanished[rows]

    def _read_crossings(self, blocks: Array) -> tuple[Array, Array, Array]:
        """The blocks (K, 3) whose surface may have moved, and the sites (K, 2, 8) that they had or have."""
        assert isinstance(self.source, TsdfMap)
        beside = [blocks + step for step in np.concatenate([np.eye(3, dtype=np.int32), -np.eye(3, dtype=np.int32)])]
        blocks = np.unique(np.concatenate([blocks, *beside]), axis=0)
        slots = self.store.find(blocks)
        blocks, slots = read_only(blocks[slots >= 0]), slots[slots >= 0]
        changed = np.empty((len(blocks), 2, 8), np.uint64)
        fields = self.source.store.fields
        sites.read_crossings(
            self.source.store.table, fields["distance"], fields["weight"], blocks, slots, self._planes, changed
        )
        return blocks, changed, np.zeros_like(changed)

    def _make_room(self, blocks: Array) -> None:
        """Allocate blocks, and let what is kept beside the store grow with it."""
        self.store.allocate(blocks)
        self._bounds = (
            np.minimum(self._bounds[0], blocks.min(axis=0)),
            np.maximum(self._bounds[1], blocks.max(axis=0)),
        )
        missing = len(self.store.changed_at) - len(self._planes)
        if missing:
            self._planes = np.concatenate([self._planes, np.zeros((missing, 2, 8), np.uint64)])
            self._reach = np.concatenate([self._reach, np.zeros((missing, 2), np.int32)])

    def _parts(self, blocks: Array, rows: Array) -> Iterator[Array]:
        """Split the blocks at the middle of their box until the box of what each part can reach is small enough."""
        extent = np.ptp(blocks[rows], axis=0) + 1
        if len(rows) == 1 or np.prod(extent + 4.0 * self._margin) <= _MOST_CELLS:
            yield rows
            return
        along = blocks[rows, int(extent.argmax())]
        lower = along < along.min() + extent.max() // 2
        yield from self._parts(blocks, rows[lower])
        yield from self._parts(blocks, rows[~lower])

    def _mend(self, blocks: Array, appeared: Array, vanished: Array) -> Array:
        """Mend all that sites in `blocks` (K, 3) that appeared and vanished (K, 2, 8) can reach; returns the slots of
        the blocks changed."""
        store = self.store
        low = np.maximum(blocks.min(axis=0) - 2 * self._margin, self._bounds[0])
        high = np.minimum(blocks.max(axis=0) + 2 * self._margin, self._bounds[1])
        grid = np.empty(high - low + 1, np.int32)
        nearest.fill_grid(store.table, read_only(store.block_ijk), store.n_blocks, low, grid)
        cells = blocks - low
        targets = np.empty((min(store.n_blocks, grid.size), 3), np.int64)
        room = 1 << 14
        while True:
            pairs = np.empty((room, 2), np.int32)
            n_targets, n_pairs = sites.list_reached(
                cells, appeared | vanished, self._offsets, self._reach, self._deepest, grid,
                np.full_like(grid, -1), targets, pairs,
            )  # fmt: skip
            if n_pairs <= room:
                break
            room = n_pairs
        targets, pairs = targets[:n_targets], pairs[:n_pairs]
        changed = np.empty(n_targets, np.bool_)
        if isinstance(self.source, TsdfMap):
            source = self.source.store
            mend_crossings.mend_from_crossings(
                store.fields["distance"], self._reach, self._planes, source.table, source.fields["distance"],
                source.fields["weight"], self._far, self.voxel_size_m, self.truncation_m, grid, low, self._offsets,
                targets, changed,
            )  # fmt: skip
        else:
            first_of = np.concatenate([[0], np.cumsum(np.bincount(pairs[:, 0], minlength=n_targets))])
            changed_of = pairs[np.argsort(pairs[:, 0], kind="stable"), 1]
            mend_classes.mend_from_classes(
                store.fields["distance"], self._reach, self._planes, self._values, self.voxel_size_m, grid,
                self._offsets, targets, changed_of, first_of, cells, appeared, vanished, changed,
            )  # fmt: skip
        slots = grid[tuple(targets.T)]
        self._deepest = np.maximum(self._deepest, self._reach[slots].max(axis=0))
        return np.asarray(slots[changed])

    # -- questions ----------------------------------------------------------------------------------------
    @overload
    def query(self, p_map: ArrayLike, *, gradient: Literal[False] = False) -> NDArray[np.float64]: ...
    @overload
    def query(
        self, p_map: ArrayLike, *, gradient: Literal[True]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def query(
        self, p_map: ArrayLike, *, gradient: bool = False
    ) -> NDArray[np.float64] | tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The distance (N,) [m] at each point (N, 3) [m], interpolated between the eight voxels about it, NaN where one
        of them is unknown; with `gradient` also its gradient (N, 3), which points away from the nearest surface."""
        self.update()
        points = as_points(p_map)
        values, gradients = np.empty(len(points)), np.empty((len(points) if gradient else 0, 3))
        field = (self.store.table, self.store.fields["distance"], self.voxel_size_m, points)
        if len(points) <= esdf.POINTS:  # starting threads would take longer
            esdf.interpolate_some(*field, 0, len(points), values, gradients)
        else:
            order = np.empty(len(points), np.int32)
            esdf.sort_by_place(points, esdf.CELL * self.voxel_size_m, order)
            esdf.interpolate(*field, order, values, gradients)
        return (values, gradients) if gradient else values


def _distances(voxel_size_m: float, truncation_m: float) -> NDArray[np.float32]:
    """The distance [m] from a surface that each squared distance [voxels²] between voxel centres means, up to the first
    that is truncated."""
    size, longest = np.float32(voxel_size_m), np.float32(truncation_m)
    squared = np.arange(int((truncation_m / voxel_size_m + 1.5) ** 2) + 1)
    distances = np.minimum((np.sqrt(squared, dtype=np.float32) - np.float32(0.5)) * size, longest)
    return np.asarray(distances[: int(np.argmax(distances >= longest)) + 1], dtype=np.float32)


def _offsets(margin: int, far: int) -> NDArray[np.int64]:
    """(m, 4) the way to each block that can hold a voxel nearer than `far` [voxels²], and the smallest squared distance
    to one, sorted by it."""
    steps = np.indices((2 * margin + 1,) * 3).reshape(3, -1).T - margin
    apart = np.maximum(BLOCK_EDGE * np.abs(steps) - (BLOCK_EDGE - 1), 0)
    squared = (apart**2).sum(axis=1)
    order = np.argsort(squared, kind="stable")
    return np.asarray(np.column_stack([steps, squared])[order[squared[order] < far]], dtype=np.int64)
