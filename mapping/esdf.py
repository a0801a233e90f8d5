"""Euclidean signed distances: how far and in which direction the nearest surface is, for collision checks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import BLOCK_EDGE, BlockStore, as_points
from mapping.kernels import boxes, esdf, occupancy
from mapping.layer import Changed, MapLayer, require
from mapping.occupancy import OccupancyMap
from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]

_MOST_VOXELS = 24_000_000  # of one dense box; larger regions are done in parts


class EsdfMap(MapLayer):
    """Signed distance [m] from each voxel that its source knows to the nearest surface, capped.

    source        an `OccupancyMap` (surfaces are the faces between occupied and other voxels) or a `TsdfMap` (surfaces
                  are its zero crossings); None makes a field that follows nothing, such as one loaded from a file
    truncation_m  distances beyond are this [m]

    Positive in free space, negative inside; NaN where the source knows nothing: unknown is not free. Note that a
    `TsdfMap` knows only the band about its surfaces. The field follows its source: every `query` first recomputes the
    region that the source's changes can reach. Distances from an
    `OccupancyMap` are exact between voxel centres; from a `TsdfMap` they lead to the surface beside the nearest voxel
    that touches it.
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
        self.store = BlockStore({"distance": np.float32}, size, fill={"distance": np.nan})

    def parameters(self) -> dict[str, Any]:
        return {"voxel_size_m": self.voxel_size_m, "truncation_m": self.truncation_m}

    # -- following the source -----------------------------------------------------------------------------
    def update(self) -> Changed:
        """Recompute what the source's changes since the last call can reach; returns the blocks changed."""
        if self.source is None or self.source.revision == self._seen:
            return Changed(np.empty((0, 3), np.int32), self.block_size_m)
        changes = self.source.changed_since(self._seen)
        self._seen = self.source.revision
        if not len(changes):
            return Changed(np.empty((0, 3), np.int32), self.block_size_m)
        reach = int(np.ceil(self._cap / BLOCK_EDGE))
        low, high = changes.blocks.min(axis=0) - reach, changes.blocks.max(axis=0) + reach + 1
        known = self.source.block_ijk
        affected = known[((known >= low) & (known < high)).all(axis=1)]
        slots = self.store.allocate(affected)
        changed = np.zeros(len(affected), np.bool_)
        for part in self._parts(affected, np.arange(len(affected))):
            changed[part] = self._recompute(affected[part], slots[part])
        return self._note(slots[changed])

    @property
    def _cap(self) -> int:
        """Voxels within which a site can matter."""
        return int(np.ceil(self.truncation_m / self.voxel_size_m)) + 1

    def _parts(self, blocks: Array, rows: Array) -> Iterator[Array]:
        """Split the blocks at the middle of their box until each part's dense box is small enough."""
        extent = np.ptp(blocks[rows], axis=0) + 1
        if len(rows) == 1 or np.prod(extent.astype(np.float64) * BLOCK_EDGE + 2 * self._cap) <= _MOST_VOXELS:
            yield rows
            return
        along = blocks[rows, int(extent.argmax())]
        lower = along < along.min() + extent.max() // 2
        yield from self._parts(blocks, rows[lower])
        yield from self._parts(blocks, rows[~lower])

    def _recompute(self, blocks: Array, slots: Array) -> NDArray[np.bool_]:
        margin = BLOCK_EDGE * int(np.ceil((self._cap + 1) / BLOCK_EDGE))
        first = blocks.min(axis=0).astype(np.int64) * BLOCK_EDGE - margin
        shape = (blocks.max(axis=0) + 1).astype(np.int64) * BLOCK_EDGE + margin - first
        field = self._from_occupancy if isinstance(self.source, OccupancyMap) else self._from_tsdf
        changed = np.empty(len(blocks), np.bool_)
        esdf.store_box(self.store.fields["distance"], slots, blocks, first, field(first, tuple(shape)), changed)
        return changed

    def _from_occupancy(self, first: Array, shape: tuple[int, ...]) -> NDArray[np.float32]:
        assert isinstance(self.source, OccupancyMap)
        evidence = self.source.evidence_in(first, (shape[0], shape[1], shape[2]))
        known = evidence != occupancy.UNKNOWN
        occupied = evidence >= 0
        outside, _ = self._transform(occupied)
        inside, _ = self._transform(known & ~occupied)
        half = np.float32(0.5)
        voxels = np.where(occupied, half - np.sqrt(inside, dtype=np.float32), np.sqrt(outside, dtype=np.float32) - half)
        distance = np.clip(voxels * np.float32(self.voxel_size_m), -self.truncation_m, self.truncation_m)
        distance[~known] = np.nan
        return np.asarray(distance, dtype=np.float32)

    def _from_tsdf(self, first: Array, shape: tuple[int, ...]) -> NDArray[np.float32]:
        assert isinstance(self.source, TsdfMap)
        store = self.source.store
        weight, near = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        boxes.copy_box(weight, store.table, store.fields["weight"], first)
        boxes.copy_box(near, store.table, store.fields["distance"], first)
        near[weight == 0.0] = np.nan
        before, behind = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
        esdf.find_crossings(near, before, behind)
        distance = np.full(shape, np.nan, np.float32)
        for sites, side in ((before, 1.0), (behind, -1.0)):
            _, nearest = self._transform(sites)
            esdf.measure_side(near, nearest, side, self.voxel_size_m, self.truncation_m, distance)
        return distance

    def _transform(self, sites: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        squared, nearest = np.empty(sites.shape, np.int32), np.empty(sites.shape, np.int32)
        esdf.transform(sites, self._cap, squared, nearest)
        return squared, nearest

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
        values, gradients = np.empty(len(points)), np.empty((len(points), 3))
        esdf.interpolate_with_gradient(
            self.store.table, self.store.fields["distance"], self.voxel_size_m, points, values, gradients
        )
        return (values, gradients) if gradient else values
