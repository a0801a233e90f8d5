"""Occupancy: the log-odds that a voxel is filled, in one byte; free, occupied and unknown are three things."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from math import log
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping import octree
from mapping.cells import Cells, CellStore
from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import (
    ADDRESSABLE_VOXELS,
    BLOCK_EDGE,
    LOCAL_IJK,
    as_blocks,
    as_points,
    ijk_to_centre,
    join_ijk,
    point_to_ijk,
    split_ijk,
)
from mapping.kernels import cells, occupancy, visibility
from mapping.kernels.cells import UNKNOWN as UNKNOWN_BYTE
from mapping.layer import Changed, MapLayer, require
from mapping.octomap_tree import OctoMapTree
from mapping.range_view import RangeView
from mapping.scanning import Marks, ScanBlocks, cast_rays
from mapping.sensors import LidarModel
from mapping.sight import Hits, first_hits
from mapping.view import DepthView, as_pose

Array: TypeAlias = NDArray[Any]

OCCUPIED, FREE, UNKNOWN = 1, 0, -1
"""Codes that `classify` and `box` give."""
FINEST = octree.FINEST


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
    store: CellStore

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
        discretize: bool = False,
    ) -> None:
        require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        self.hit = require("hit", hit, 0.5, 0.999)
        self.highest = require("highest", highest, 0.5, 0.9999)
        for name, value in (("miss", miss), ("lowest", lowest)):
            require(name, value, 0.0, 0.4999)
        self.miss, self.lowest = float(miss), float(lowest)
        self.discretize = bool(discretize)
        self.log_odds_step = self._choose_step()
        self._steps = np.array([round(_log_odds(p) / self.log_odds_step) for p in (hit, miss, lowest, highest)])
        self._steps.setflags(write=False)
        self.store = CellStore(voxel_size_m)

    @property
    def lowest_evidence(self) -> int:
        """The clamp of a voxel's byte from below."""
        return int(self._steps[2])

    @property
    def highest_evidence(self) -> int:
        """The clamp of a voxel's byte from above."""
        return int(self._steps[3])

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
            "discretize": self.discretize,
        }

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike) -> Changed:
        """Fuse one scan by ray casting. `p_sensor` is (N, 3) [m] in the sensor frame; returns the blocks changed."""
        points, pose = as_points(p_sensor, "p_sensor"), as_pose(T_map_sensor, "T_map_sensor")
        return self._fold(cast_rays(points, pose, self.voxel_size_m, self.max_range_m, discretize=self.discretize))

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
        return self._fuse(view, blocks, kinds)

    def integrate_range_image(self, ranges: Array, model: LidarModel, T_map_sensor: SE3 | ArrayLike) -> Changed:
        """Fuse one lidar range image (rows, columns) float32 [m], 0 = not measured, infinity = nothing there; returns
        the blocks changed.

        The voxel of each beam's surface point is hit; a voxel is free where the beam nearest to its centre passes it,
        and where it lies wholly before what that beam and its neighbours saw. Much faster than `integrate`, which knows
        of beams only; it leaves no gaps between beams that are farther apart than voxels.
        """
        return self.integrate_range_view(RangeView(ranges, model, T_map_sensor, self.max_range_m))

    def integrate_range_view(self, view: RangeView) -> Changed:
        """Fuse a lidar range image that has been prepared already."""
        size = self.voxel_size_m
        blocks, kinds = view.blocks(self.block_size_m, front_m=size, back_m=0.0, touch_m=0.5 * size, with_free=True)
        return self._fuse(view, blocks, kinds)

    def _fuse(self, view: DepthView | RangeView, blocks: NDArray[np.int32], kinds: NDArray[np.uint8]) -> Changed:
        """Fuse a prepared image, of which `blocks` (n, 3) and their `kinds` (n,) say where it saw anything."""
        mixed, free = blocks[kinds == visibility.MIXED], blocks[kinds == visibility.FREE]
        scan = ScanBlocks(mixed, len(mixed) + 256)
        view.mark_free(mixed, self.voxel_size_m, scan.marks)
        scan.mark_hits(view.hits(self.voxel_size_m))
        return self._fold(scan.done(free))

    def _fold(self, scan: Marks) -> Changed:
        """Update each marked voxel of a scan once."""
        store, revision, n_blocks = self.store, self.revision + 1, len(scan.blocks)
        rows, changed, same = np.empty(n_blocks, np.int64), np.empty(n_blocks, np.bool_), np.zeros(n_blocks, np.bool_)
        n = 0
        while n < n_blocks:
            n = occupancy.open_blocks(
                *store.rows, store.payload, store.free_slots, store.counts, n, scan.blocks, scan.kinds, self._steps,
                revision, rows, changed,
            )  # fmt: skip
            if n < n_blocks:
                store.make_room()
        occupancy.fold_marks(store.payload, store.tree[1], rows, scan.which, scan.marks, self._steps, changed, same)
        occupancy.settle_blocks(
            *store.rows, store.payload, store.free_slots, store.counts, rows, changed, same, self._steps, revision
        )
        self.revision = revision
        return Changed(scan.blocks[changed], self.block_size_m)

    def set_evidence(self, block_ijk: ArrayLike, evidence: NDArray[np.int8]) -> Changed:
        """Replace all voxels (K, 512) int8 of blocks (K, 3), each named once; returns the blocks that changed.

        Evidence counts steps of log-odds (`log_odds_step`), ≥ 0 occupied, −128 unknown; a voxel's place in its block is
        x·64 + y·8 + z.
        """
        blocks = as_blocks(block_ijk)
        self.revision += 1
        changed = self.store.write(blocks, evidence, self.revision)
        return Changed(blocks[changed], self.block_size_m)

    def assign(self, p_map: ArrayLike, evidence: ArrayLike) -> Changed:
        """Replace the evidence of the voxels that hold points (N, 3) [m] by `evidence` (N,) or one for all, int8."""
        points = as_points(p_map)
        if not (np.isfinite(points).all() and (np.abs(points) < ADDRESSABLE_VOXELS * self.voxel_size_m).all()):
            raise InvalidParameter("p_map: expected finite points within the map's addressable voxels")
        of, local = split_ijk(point_to_ijk(points, self.voxel_size_m))
        blocks, rows = np.unique(of, axis=0, return_inverse=True)
        values = self.evidence_of(blocks)
        values[rows.ravel(), local] = np.asarray(evidence, np.int8)
        return self.set_evidence(blocks, values)

    def fill_cells(self, cell_ijk: ArrayLike, level: Array, evidence: Array) -> None:
        """Add whole cubes of the same evidence (K,) where nothing is known yet.

        level (K,): a cube has 2^level blocks along an edge, 0 … 7; cell_ijk (K, 3): its index in units of that edge.
        Raises `MappingError` where something is known, or two of the cubes overlap; then nothing is added.
        """
        cell = Cells(as_blocks(cell_ijk), np.asarray(level, np.uint8), np.asarray(evidence, np.int8))
        self.store.fill(cell, self.revision + 1)
        self.revision += 1

    def clear_box(self, lo: ArrayLike, hi: ArrayLike) -> Changed:
        """Forget the voxels whose centres lie in the box from corner `lo` to `hi` (3,) [m]: they become unknown."""
        low, high = _corners(lo, hi)
        return self._clear(low, high, lambda centres: ((centres >= low) & (centres <= high)).all(axis=-1))

    def clear_sphere(self, centre: ArrayLike, radius_m: float) -> Changed:
        """Forget the voxels whose centres lie within `radius_m` of `centre` (3,) [m]: they become unknown."""
        middle, radius = _ball(centre, radius_m)
        return self._clear(
            middle - radius, middle + radius, lambda centres: np.linalg.norm(centres - middle, axis=-1) <= radius
        )

    def _clear(self, low: Array, high: Array, inside: Callable[[Array], Any]) -> Changed:
        edge = self.block_size_m
        blocks = self.block_ijk
        near = ((blocks + 1) * edge > low).all(axis=1) & (blocks * edge < high).all(axis=1)
        blocks = blocks[near]
        evidence = self.evidence_of(blocks)
        for n, block in enumerate(blocks):
            evidence[n, inside(ijk_to_centre(block * BLOCK_EDGE + LOCAL_IJK, self.voxel_size_m))] = UNKNOWN_BYTE
        return self.set_evidence(blocks, evidence)

    def merge(self, other: OccupancyMap) -> Changed:
        """Add another map's evidence to this one's: log-odds are summed and clamped, as if one map had seen all.

        Both must be in the same frame with the same voxels; the sum is that of a single map as long as no clamp cut off
        evidence on the way. Raises `InvalidParameter` on another voxel size.
        """
        if other.voxel_size_m != self.voxel_size_m:
            raise InvalidParameter(f"other: expected voxels of {self.voxel_size_m} m, got {other.voxel_size_m} m")
        blocks = other.block_ijk
        revision = self.revision + 1
        changed = [
            self.store.write(chunk, self._sum(chunk, other), revision)
            for chunk in np.array_split(blocks, max(1, len(blocks) // 1024))
        ]
        self.revision = revision
        return Changed(blocks[np.concatenate(changed)], self.block_size_m)

    def _sum(self, blocks: NDArray[np.int32], other: OccupancyMap) -> NDArray[np.int8]:
        ours, theirs = self.evidence_of(blocks), other.evidence_of(blocks)
        scaled = np.rint(theirs * (other.log_odds_step / self.log_odds_step))
        total = np.where(ours == UNKNOWN_BYTE, 0, ours) + scaled
        total = np.clip(total, self.lowest_evidence, self.highest_evidence)
        return np.where(theirs == UNKNOWN_BYTE, ours, total).astype(np.int8)

    # -- questions ----------------------------------------------------------------------------------------
    def query(
        self, p_map: ArrayLike, *, depth: int = FINEST, rule: Literal["max", "mean"] = "max"
    ) -> NDArray[np.float64]:
        """The probability (N,) that the voxel at each point (N, 3) [m] is occupied; NaN where unknown.

        depth : level of OctoMap's tree. 16 asks for voxels, 15 for cubes of 2³ voxels, … 0 for the whole; a cube is
                unknown where all of it is
        rule  : what a cube is: "max", as its most occupied voxel, so that nothing in it is missed, or "mean", the mean
                probability of its known voxels (Hornung et al. 2013, §3.3)
        """
        if rule not in ("max", "mean"):
            raise InvalidParameter(f'rule: expected "max" or "mean", got {rule!r}')
        if depth == FINEST:
            return np.asarray(self.probabilities[self._values(p_map).view(np.uint8)])
        highest, mean = octree.sum_up(self, as_points(p_map), depth)
        return mean if rule == "mean" else np.asarray(self.probabilities[highest.view(np.uint8)])

    @cached_property
    def probabilities(self) -> NDArray[np.float64]:
        """(256,) what each byte of evidence, taken as uint8, means: the probability, NaN for unknown."""
        steps = np.arange(256, dtype=np.uint8).view(np.int8)
        meant = 1.0 / (1.0 + np.exp(-self.log_odds_step * steps.astype(np.float64)))
        return np.where(steps == UNKNOWN_BYTE, np.nan, meant)

    def classify(self, p_map: ArrayLike) -> NDArray[np.int8]:
        """What is at each point (N, 3) [m]: OCCUPIED 1, FREE 0 or UNKNOWN −1, int8 (N,)."""
        return classes_of(self._values(p_map))

    def box(self, lo: ArrayLike, hi: ArrayLike) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """The classes of all voxels that meet the box from corner `lo` to `hi` (3,) [m], dense.

        Returns int8 (nx, ny, nz) of OCCUPIED, FREE, UNKNOWN, and the voxel ijk (3,) of its first element.
        """
        low, high = _corners(lo, hi)
        first = np.floor(low / self.voxel_size_m + 1e-6).astype(np.int64)
        beyond = np.ceil(high / self.voxel_size_m - 1e-6).astype(np.int64)
        nx, ny, nz = (int(n) for n in np.maximum(beyond - first, 1))
        return classes_of(self.evidence_in(first, (nx, ny, nz))), first

    def sphere(self, centre: ArrayLike, radius_m: float) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """The classes (N,) of all voxels whose centres (N, 3) [m] lie within `radius_m` of `centre` (3,) [m]."""
        middle, radius = _ball(centre, radius_m)
        classes, first = self.box(middle - radius, middle + radius)
        centres = ijk_to_centre(np.moveaxis(np.indices(classes.shape), 0, -1) + first, self.voxel_size_m)
        inside = np.linalg.norm(centres - middle, axis=-1) <= radius
        return classes[inside], centres[inside]

    def cast(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        max_range_m: float | None = None,
        *,
        stop_at_unknown: bool = False,
    ) -> Hits:
        """What rays from `origins` (N, 3) or (3,) [m] along `directions` (N, 3) or (3,) meet first.

        max_range_m     where rays end; default the map's own
        stop_at_unknown whether a ray ends at the first voxel of which nothing is known; otherwise it goes on through
        """
        reach = self.max_range_m if max_range_m is None else max_range_m
        return first_hits(self, origins, directions, reach, stop_at_unknown=stop_at_unknown)

    def evidence_in(self, first: ArrayLike, shape: tuple[int, int, int]) -> NDArray[np.int8]:
        """The evidence of the voxels from `first` (3,) on, dense, int8 of `shape`; −128 unknown, ≥ 0 occupied."""
        values = np.empty(shape, np.int8)
        cells.copy_box(values, *self.store.tree, np.asarray(first, np.int64))
        return values

    def evidence_of(self, block_ijk: ArrayLike) -> NDArray[np.int8]:
        """The evidence (K, 512) int8 of the voxels of blocks (K, 3); −128 also where nothing is known."""
        return self.store.read(block_ijk)

    def occupied_centres(self) -> NDArray[np.float64]:
        """Centres (N, 3) [m] of the occupied voxels."""
        return self._centres(occupied=True)

    def free_centres(self) -> NDArray[np.float64]:
        """Centres (N, 3) [m] of the voxels known to be free."""
        return self._centres(occupied=False)

    def changed_since(self, revision: int) -> Changed:
        """The blocks that changed after `revision` (0: all that ever changed), those that are unknown again included.

        Where several blocks are one cell, all of them are named as soon as one of them changed.
        """
        return super().changed_since(revision)

    def leaves(self, depth: int = FINEST) -> octree.Leaves:
        """The leaves of the octree, none finer than level `depth` (16: voxels): what is alike is one leaf."""
        return octree.leaves(self, depth)

    def state(self) -> dict[str, Array]:
        """Everything that makes this map, as named arrays; with what the OctoMap file said that it was read from."""
        return {**super().state(), **({} if self.octomap is None else self.octomap.state())}

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> Self:
        """The map that `state()` described; raises `MappingError` where it is of another kind or incomplete."""
        layer = super().from_state(state)
        layer.octomap = OctoMapTree.from_state(state, layer.voxel_size_m)
        return layer

    def write(self, path: str | Path) -> None:
        """Write an OctoMap file, `.bt` or `.ot` as its name ends; see `mapping.octomap`."""
        from mapping.octomap import write_octomap

        write_octomap(self, path)

    def _centres(self, *, occupied: bool) -> NDArray[np.float64]:
        blocks, slots = self.store.dense_blocks()
        values = self.store.payload[slots]
        rows, local = np.nonzero(values >= 0 if occupied else (values < 0) & (values != UNKNOWN_BYTE))
        voxels = join_ijk(blocks[rows], local)
        uniform = self.store.uniform_cells()
        which = (uniform.value >= 0) == occupied
        wholes = octree.voxels_of(Cells(*(field[which] for field in uniform)))
        return ijk_to_centre(np.concatenate([voxels, wholes]), self.voxel_size_m)

    def _values(self, p_map: ArrayLike) -> NDArray[np.int8]:
        points = as_points(p_map)
        values = np.empty(len(points), np.int8)
        cells.look_up(*self.store.tree, points, 1.0 / self.voxel_size_m, values)
        return values


def _corners(lo: ArrayLike, hi: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = np.asarray(lo, np.float64), np.asarray(hi, np.float64)
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
        raise InvalidParameter(f"lo, hi: expected corners (3,) with lo < hi, got {low.tolist()} and {high.tolist()}")
    return low, high


def _ball(centre: ArrayLike, radius_m: float) -> tuple[NDArray[np.float64], float]:
    middle = np.asarray(centre, np.float64)
    if middle.shape != (3,) or not np.isfinite(middle).all():
        raise InvalidParameter(f"centre: expected a point (3,), got {middle.tolist()}")
    return middle, require("radius_m", radius_m, 0.0, 1e4, "m")


def classes_of(values: NDArray[np.int8]) -> NDArray[np.int8]:
    """Evidence of any shape as OCCUPIED, FREE or UNKNOWN."""
    classes = (values >= 0).astype(np.int8)
    classes[values == UNKNOWN_BYTE] = UNKNOWN
    return classes
