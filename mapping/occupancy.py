"""Occupancy: the log-odds that a voxel is filled, in one byte; free, occupied and unknown are three things."""

from __future__ import annotations

from collections.abc import Mapping
from math import log
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import (
    ADDRESSABLE_VOXELS,
    BLOCK_VOXELS,
    BlockStore,
    as_points,
    ijk_to_centre,
    join_ijk,
    new_table,
    point_to_ijk,
)
from mapping.kernels import boxes, occupancy, visibility
from mapping.layer import Changed, MapLayer, require
from mapping.view import DepthView, as_pose

if TYPE_CHECKING:
    from mapping.octomap_tree import OctoMapTree

Array: TypeAlias = NDArray[Any]

OCCUPIED, FREE, UNKNOWN = 1, 0, -1
"""Codes that `classify` and `box` give."""
FINEST, COARSEST = 16, 8
"""Levels of OctoMap's tree that `query` answers at."""


def _log_odds(probability: float) -> float:
    return log(probability / (1.0 - probability))


class OccupancyMap(MapLayer):
    """Log-odds occupancy (Moravec & Elfes 1985; Hornung et al., OctoMap, Autonomous Robots 2013).

    voxel_size_m  edge of a voxel [m]
    max_range_m   beams are cut here [m]: free space up to it, no surface beyond
    hit, miss     probability that a voxel is occupied given one hit, one miss; OctoMap's defaults
    lowest, highest   clamps of the probability, so that the map can change its mind

    Each scan updates a voxel at most once, and a hit outranks a miss. A voxel's byte counts log-odds in steps of
    `log_odds_step`, chosen so that hit and miss are whole numbers of steps (to within 0.5 % for the defaults) and the
    clamps fit; −128 is *unknown*. Occupied means probability ≥ ½. Raises `InvalidParameter` on bad values.
    """

    kind: ClassVar[str] = "occupancy"

    octomap: OctoMapTree | None = None
    """The OctoMap file that the map was read from: exact log-odds and colours of what has not changed since."""

    def __init__(
        self,
        voxel_size_m: float = 0.05,
        max_range_m: float = 20.0,
        *,
        hit: float = 0.7,
        miss: float = 0.4,
        lowest: float = 0.1192,
        highest: float = 0.971,
    ) -> None:
        require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        self.hit = require("hit", hit, 0.5, 0.999)
        self.highest = require("highest", highest, 0.5, 0.9999)
        for name, value in (("miss", miss), ("lowest", lowest)):
            require(name, value, 0.0, 0.4999)
        self.miss, self.lowest = float(miss), float(lowest)
        self.log_odds_step = self._choose_step()
        self._hit, self._miss, self.lowest_evidence, self.highest_evidence = (
            round(_log_odds(p) / self.log_odds_step) for p in (hit, miss, lowest, highest)
        )
        self.store = BlockStore({"evidence": np.int8}, voxel_size_m, fill={"evidence": occupancy.UNKNOWN})

    def _choose_step(self) -> float:
        """The log-odds of one step, for which hit ÷ miss is as nearly as can be a ratio of whole numbers."""
        hit, miss = _log_odds(self.hit), -_log_odds(self.miss)
        reach = max(_log_odds(self.highest), -_log_odds(self.lowest), hit, miss)
        best, best_error = reach / 127.0, np.inf
        for miss_steps in range(1, 128):
            step = miss / miss_steps
            hit_steps = round(hit / step)
            if round(reach / step) > 127 or hit_steps < 1:
                continue
            error = abs(hit_steps * step - hit) / hit
            if error <= best_error:
                best, best_error = step, error
        if best_error > 0.05:
            raise InvalidParameter(
                f"hit, miss, lowest, highest: {self.hit}, {self.miss}, {self.lowest}, {self.highest} "
                "do not fit one byte to within 5 %; expected evidence of more equal strength"
            )
        return best

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "max_range_m": self.max_range_m,
            "hit": self.hit,
            "miss": self.miss,
            "lowest": self.lowest,
            "highest": self.highest,
        }

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike) -> Changed:
        """Fuse one scan by ray casting. `p_sensor` is (N, 3) [m] in the sensor frame; returns the blocks changed."""
        pose = as_pose(T_map_sensor, "T_map_sensor")
        ends = as_points(p_sensor, "p_sensor")
        if not np.isfinite(ends).all():
            raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
        lengths = np.linalg.norm(ends, axis=1)
        whole = lengths <= self.max_range_m
        ends = pose @ ends
        voxels = point_to_ijk(ends[whole], self.voxel_size_m)
        cut = (self.max_range_m / lengths[~whole])[:, None]
        ends[~whole] = pose.translation + cut * (ends[~whole] - pose.translation)
        scan = _ScanBlocks(np.empty((0, 3), np.int32), 1024)
        beam = 0
        while beam < len(ends):
            beam, scan.n_blocks = occupancy.mark_beams(
                pose.translation, ends, beam, self.voxel_size_m, scan.table, scan.blocks, scan.n_blocks, scan.marks
            )
            if beam < len(ends):
                scan.grow()
        scan.mark_hits(voxels)
        return self._fold(scan.blocks[: scan.n_blocks], np.arange(scan.n_blocks), scan.marks)

    def integrate_image(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
    ) -> Changed:
        """Fuse one depth image (H, W) float32 [m] or uint16 [mm], 0 = not measured; returns the blocks changed.

        The voxel of each pixel's surface point is hit; a voxel whose centre lies before the surface seen by the pixel
        nearest to it is free. Whole blocks before the surface are never projected voxel by voxel.
        """
        return self.integrate_view(DepthView(depth, intrinsics, T_map_camera, self.max_range_m))

    def integrate_view(self, view: DepthView) -> Changed:
        """Fuse a depth image that has been prepared already."""
        blocks, kinds = view.blocks(self.block_size_m, front_m=self.voxel_size_m, back_m=0.0, with_free=True)
        mixed, free = blocks[kinds == visibility.MIXED], blocks[kinds == visibility.FREE]
        scan = _ScanBlocks(mixed, len(mixed) + 256)
        occupancy.mark_free(mixed, self.voxel_size_m, view.reach, view.camera, scan.marks)
        voxels = np.empty((view.reach.size, 3), np.int32)
        n_hits = occupancy.list_hits(view.reach, view.camera, view.pose, self.voxel_size_m, voxels)
        scan.mark_hits(voxels[:n_hits])
        marked = np.empty(scan.n_blocks, np.bool_)
        occupancy.find_marked(scan.marks[: scan.n_blocks], marked)
        rows = np.flatnonzero(marked)
        return self._fold(
            np.concatenate([scan.blocks[rows], free]), np.concatenate([rows, np.full(len(free), -1)]), scan.marks
        )

    def _fold(self, blocks: Array, rows: Array, marks: Array) -> Changed:
        slots = self.store.allocate(blocks)
        changed = np.empty(len(slots), np.bool_)
        evidence = self.store.fields["evidence"]
        occupancy.fold_marks(
            evidence, slots, rows, marks, self._hit, self._miss, self.lowest_evidence, self.highest_evidence, changed
        )
        return self._note(slots[changed])

    # -- questions ----------------------------------------------------------------------------------------
    def query(self, p_map: ArrayLike, *, depth: int = FINEST) -> NDArray[np.float64]:
        """The probability (N,) that the voxel at each point (N, 3) [m] is occupied; NaN where unknown.

        depth : level of OctoMap's tree. 16 asks for voxels, 15 for cubes of 2³ voxels, … down to 8; a cube is as
                occupied as its most occupied voxel, and unknown where all of it is.
        """
        values = self._values(p_map) if depth == FINEST else self._coarse_values(p_map, depth)
        with np.errstate(invalid="ignore"):
            return 1.0 / (1.0 + np.exp(np.where(values == occupancy.UNKNOWN, np.nan, -self.log_odds_step * values)))

    def classify(self, p_map: ArrayLike) -> NDArray[np.int8]:
        """What is at each point (N, 3) [m]: OCCUPIED 1, FREE 0 or UNKNOWN −1, int8 (N,)."""
        return _classes(self._values(p_map))

    def box(self, lo: ArrayLike, hi: ArrayLike) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """The classes of all voxels that meet the box from corner `lo` to `hi` (3,) [m], dense.

        Returns int8 (nx, ny, nz) of OCCUPIED, FREE, UNKNOWN, and the voxel ijk (3,) of its first element.
        """
        low, high = np.asarray(lo, np.float64), np.asarray(hi, np.float64)
        if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
            raise InvalidParameter(
                f"lo, hi: expected corners (3,) with lo < hi, got {low.tolist()} and {high.tolist()}"
            )
        first = np.floor(low / self.voxel_size_m + 1e-6).astype(np.int64)
        beyond = np.ceil(high / self.voxel_size_m - 1e-6).astype(np.int64)
        nx, ny, nz = (int(n) for n in np.maximum(beyond - first, 1))
        return _classes(self.evidence_in(first, (nx, ny, nz))), first

    def evidence_in(self, first: ArrayLike, shape: tuple[int, int, int]) -> NDArray[np.int8]:
        """The evidence of the voxels from `first` (3,) on, dense, int8 of `shape`; `kernels.occupancy.UNKNOWN` −128."""
        values = np.full(shape, occupancy.UNKNOWN, np.int8)
        boxes.copy_box(values, self.store.table, self.store.fields["evidence"], np.asarray(first, np.int64))
        return values

    def evidence_of(self, block_ijk: ArrayLike) -> NDArray[np.int8]:
        """The evidence (K, 512) int8 of the voxels of blocks (K, 3); UNKNOWN −128 also where there is no block."""
        slots = self.store.find(block_ijk)
        values = self.store.fields["evidence"][slots]
        values[slots < 0] = occupancy.UNKNOWN
        return values

    def occupied_centres(self) -> NDArray[np.float64]:
        """Centres (N, 3) [m] of the occupied voxels."""
        return self._centres(self.store.used("evidence") >= 0)

    def free_centres(self) -> NDArray[np.float64]:
        """Centres (N, 3) [m] of the voxels known to be free."""
        values = self.store.used("evidence")
        return self._centres((values < 0) & (values != occupancy.UNKNOWN))

    def write(self, path: str | Path) -> None:
        """Write an OctoMap file, `.bt` or `.ot` as its name ends; see `mapping.octomap`."""
        from mapping.octomap import write_octomap

        write_octomap(self, path)

    def _centres(self, which: Array) -> NDArray[np.float64]:
        slots, local = np.nonzero(which)
        return ijk_to_centre(join_ijk(self.block_ijk[slots], local), self.voxel_size_m)

    def _coarse_values(self, p_map: ArrayLike, depth: int) -> NDArray[np.int8]:
        if depth not in range(COARSEST, FINEST + 1):
            raise InvalidParameter(f"depth: expected a level in {COARSEST} … {FINEST}, got {depth!r}")
        points = as_points(p_map)
        values = np.full(len(points), occupancy.UNKNOWN, np.int8)
        inside = np.isfinite(points).all(axis=1) & (np.abs(points) < ADDRESSABLE_VOXELS * self.voxel_size_m).all(axis=1)
        shift = FINEST - depth
        cells, which = np.unique(point_to_ijk(points[inside], self.voxel_size_m) >> shift, axis=0, return_inverse=True)
        highest = np.full(len(cells), occupancy.UNKNOWN, np.int8)
        corners = cells.astype(np.int64) << shift
        boxes.highest_in_cells(self.store.table, self.store.fields["evidence"], corners, 1 << shift, highest)
        values[inside] = highest[which.ravel()]
        return values

    def _values(self, p_map: ArrayLike) -> NDArray[np.int8]:
        slots, local = self.store.locate(p_map)
        values = np.full(len(slots), occupancy.UNKNOWN, np.int8)
        found = slots >= 0
        values[found] = self.store.fields["evidence"][slots[found], local[found]]
        return values


def _classes(values: NDArray[np.int8]) -> NDArray[np.int8]:
    classes = (values >= 0).astype(np.int8)
    classes[values == occupancy.UNKNOWN] = UNKNOWN
    return classes


class _ScanBlocks:
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
