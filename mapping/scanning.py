"""What one scan says of the space about it: the blocks that its beams pass and end in, voxel by voxel."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.grid import BLOCK_VOXELS, new_table, point_to_ijk
from mapping.kernels import beams, occupancy

Array: TypeAlias = NDArray[Any]

_SCANNED_BLOCKS = 1 << 16
"""In a volume of at most so many blocks, those with marks are found afterwards: to note them at each step takes
longer."""
_MOST_BLOCKS = 1 << 21
"""Of the volume about a scan; beyond, its blocks are kept in a hash. Of a volume's memory only what beams touch is ever
used."""


class Marks(NamedTuple):
    """The blocks (n, 3) of a scan, and rows `which` (n,) of marks (m, 512) uint8, one a voxel: 0, MISS or HIT; −1
    stands for a block that beams passed as a whole. `kinds` (n,): what the marks say of a block, see `sort_marks`."""

    blocks: NDArray[np.int32]
    which: NDArray[np.int64]
    marks: NDArray[np.uint8]
    kinds: NDArray[np.uint8]


def _sorted_out(blocks: NDArray[np.int32], which: NDArray[np.int64], marks: NDArray[np.uint8]) -> Marks:
    kinds = np.empty(len(blocks), np.uint8)
    occupancy.sort_marks(marks, which, kinds)
    return Marks(blocks, which, marks, kinds)


def cast_rays(
    p_sensor: NDArray[np.float64], T_map_sensor: SE3, voxel_size_m: float, max_range_m: float, *, discretize: bool
) -> Marks:
    """The marks of a scan (N, 3) [m, sensor frame] by ray casting, as OctoMap's `computeUpdate` defines them.

    Beams longer than `max_range_m` free space up to it and hit nothing. With `discretize` one beam is cast to the
    centre of each voxel in which any end, as `computeDiscreteUpdate` has it.
    """
    pose = np.concatenate([T_map_sensor.rotation.ravel(), T_map_sensor.translation])
    origin = T_map_sensor.translation
    ends, whole, box = np.empty(p_sensor.shape), np.empty(len(p_sensor), np.bool_), np.empty((2, 3))
    snap = voxel_size_m if discretize else 0.0
    if not beams.place_beams(p_sensor, pose, max_range_m, snap, ends, whole, box):
        raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
    low, high = point_to_ijk(box, voxel_size_m).astype(np.int64)
    low, high = low - 1, high + 1  # a beam's rounding may step aside
    n_blocks = (high >> 3) - (low >> 3) + 1
    if np.prod(n_blocks.astype(np.float64)) > _MOST_BLOCKS:
        return _cast_far(origin, ends, whole, voxel_size_m)
    layout = np.concatenate([low >> 3, n_blocks])
    return _cast_near(origin, ends, whole, voxel_size_m, layout, thin=discretize)


def _cast_near(
    origin: Array, ends: Array, whole: Array, voxel_size_m: float, layout: NDArray[np.int64], *, thin: bool
) -> Marks:
    """Cast rays in a volume about the scan."""
    shape = tuple(int(n) for n in layout[3:])
    offsets = np.empty((3, 8 * max(shape)), np.int64)
    beams.list_offsets(layout, offsets)
    n_blocks = int(np.prod(shape))
    marks = np.zeros(BLOCK_VOXELS * n_blocks, np.uint8)
    noted = np.zeros(n_blocks if n_blocks > _SCANNED_BLOCKS else 0, np.uint8)
    if thin:
        n = beams.thin_out(ends, whole, voxel_size_m, layout, offsets, marks)
        ends, whole = ends[:n], whole[:n]
    beams.mark_beams(origin, ends, voxel_size_m, layout, offsets, marks, noted)
    beams.mark_ends(ends, whole, voxel_size_m, layout, offsets, marks, noted)
    rows = np.flatnonzero(noted) if len(noted) else np.arange(n_blocks)
    kinds, of_blocks = np.empty(len(rows), np.uint8), marks.reshape(-1, BLOCK_VOXELS)
    occupancy.sort_marks(of_blocks, rows, kinds)
    marked = np.flatnonzero(kinds)
    rows = rows[marked]
    blocks = np.stack(np.unravel_index(rows, shape), axis=1) + layout[:3]
    return Marks(blocks.astype(np.int32), rows, of_blocks, kinds[marked])


def _cast_far(origin: Array, ends: Array, whole: Array, voxel_size_m: float) -> Marks:
    """Cast rays of a scan that reaches too far for a volume."""
    scan = ScanBlocks(np.empty((0, 3), np.int32), 1024)
    beam = 0
    while beam < len(ends):
        beam, scan.n_blocks = beams.mark_far_beams(
            origin, ends, beam, voxel_size_m, scan.table, scan.blocks, scan.n_blocks, scan.marks
        )
        if beam < len(ends):
            scan.grow()
    scan.mark_hits(point_to_ijk(ends[whole], voxel_size_m))
    return scan.done()


class ScanBlocks:
    """The blocks that one scan touches, a byte for each of their voxels, and room for more."""

    def __init__(self, blocks: Array, room: int) -> None:
        self.n_blocks = len(blocks)
        self.blocks: NDArray[np.int32] = np.empty((room, 3), np.int32)
        self.blocks[: self.n_blocks] = blocks
        self.marks: NDArray[np.uint8] = np.empty((room, BLOCK_VOXELS), np.uint8)
        self.table = new_table(self.blocks, self.n_blocks, room)

    def mark_hits(self, voxels: NDArray[np.int32]) -> None:
        """Mark voxels (m, 3) as hit."""
        while (n := occupancy.mark_hits(voxels, self.table, self.blocks, self.n_blocks, self.marks)) < 0:
            self.grow()
        self.n_blocks = n

    def grow(self) -> None:
        """Make room for twice as many blocks; those listed stay."""
        n, room = self.n_blocks, 2 * len(self.blocks)
        blocks, marks = self.blocks[:n], self.marks[:n]
        self.blocks, self.marks = np.empty((room, 3), np.int32), np.empty((room, BLOCK_VOXELS), np.uint8)
        self.blocks[:n], self.marks[:n] = blocks, marks
        self.table = new_table(self.blocks, n, room)

    def done(self, free: NDArray[np.int32] | None = None) -> Marks:
        """The marks, and after them blocks `free` (k, 3) that were passed as a whole."""
        blocks, which = self.blocks[: self.n_blocks], np.arange(self.n_blocks)
        if free is not None:
            blocks, which = np.concatenate([blocks, free]), np.concatenate([which, np.full(len(free), -1)])
        return _sorted_out(blocks, which, self.marks)
