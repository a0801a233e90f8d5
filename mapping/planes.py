"""Planes in surfaces: found in a cloud at once (`extract_planes`), or kept up to date block by block (`PlaneMap`).

After Nüchter & Hertzberg, Towards semantic maps for mobile robots, 2008, section 3.1 (random sample consensus with
refinement), made incremental: what a block contributes to a plane is additive and is replaced when the block changes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Protocol, TypeAlias

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mapping.coverage import Coverage, PlaneFrame
from mapping.errors import InvalidParameter
from mapping.kernels import planes as kernels

Array: TypeAlias = NDArray[Any]
Key: TypeAlias = tuple[int, int, int]

_SPAN, _HALF = 1 << 20, 1 << 19  # places are numbered within ± 2¹⁹ along each axis
_BESIDE: NDArray[np.int64] = np.array(
    [(i * _SPAN + j) * _SPAN + k for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], np.int64
)
_NO_SLOTS: dict[int, int] = {}

_HYPOTHESES = 12
_TURNED = float(np.cos(np.deg2rad(10.0)))
_REACH_M = 0.25
"""Coarse cell for telling pieces apart: gaps above twice this always part a plane."""


class Surface(Protocol):
    """What planes are found in: a `TsdfMap`, or anything else with oriented surface samples per block."""

    def surface(self, block_ijk: Any = None) -> tuple[Array, Array, Array]:
        """Samples (N, 3) [m], normals (N, 3) into free space, and the index (N,) into `block_ijk` of each."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A bounded piece of a plane: normal·p = offset for its points p [m] in map.

    normal   : (3,) unit, towards free space        offset : [m]
    centroid : (3,) [m] mean of its samples
    rings    : borders (K, 3) [m], not closed: of each part the outer one, counter-clockwise seen from free space, then its
               holes, clockwise
    polygon  : (K, 3) the outer border of its largest part
    area_m2  : covered area        z_min, z_max : [m]        width_m : its extent along the horizontal in its plane
    box_center, box_axes, box_size : the rectangle about it: centre (3,), columns u, v, normal (3, 3), size (3,) [m]
    n_points : number of samples        rms_m : root mean square distance of the samples
    """

    id: int
    normal: Array
    offset: float
    centroid: Array
    rings: tuple[Array, ...]
    area_m2: float
    z_min: float
    z_max: float
    width_m: float
    box_center: Array
    box_axes: Array
    box_size: Array
    n_points: int
    rms_m: float

    @property
    def polygon(self) -> Array:
        return self.rings[0]


@dataclass(frozen=True, eq=False)
class PlaneSummary:
    """The measures of several planes that cost little: one row per plane of `ids` (K,).

    normal (K, 3), offset (K,), area_m2 (K,), low and high (K, 3) [m]: the axis-aligned box, width_m (K,): horizontal extent.
    """

    ids: NDArray[np.int64]
    normal: Array
    offset: Array
    area_m2: Array
    low: Array
    high: Array
    width_m: Array


@dataclass(frozen=True)
class PlaneChange:
    """What an update did: ids of planes that are new or changed, that vanished, and vanished → what it became part of."""

    changed: tuple[int, ...] = ()
    deleted: tuple[int, ...] = ()
    merged: Mapping[int, int] = field(default_factory=dict)


@dataclass(eq=False)
class _Block:
    points: Array
    normals: Array
    slot_of: NDArray[np.int32]
    counts: dict[int, int]


class PlaneMap:
    """Planes of a surface that changes block by block; the cost of an update depends on the changed blocks only.

    voxel_size_m  : of the surface's blocks of 8³ voxels [m]
    tolerance_m   : a sample within this distance of a plane may be on it; default half a voxel + 1 cm
    max_angle_deg : between a sample's normal and its plane's
    min_area_m2   : smaller pieces are kept but not told of

    Pieces of one plane that are parted by a gap of 0.5 m or more are different planes. Ids are kept for as long as the plane
    is there; when planes merge, the lowest id stays.
    """

    def __init__(
        self,
        voxel_size_m: float,
        *,
        tolerance_m: float | None = None,
        max_angle_deg: float = 30.0,
        min_area_m2: float = 0.2,
    ) -> None:
        for name, value in (("voxel_size_m", voxel_size_m), ("min_area_m2", min_area_m2)):
            if not (np.isfinite(value) and value > 0.0):
                raise InvalidParameter(f"{name}: expected a number > 0, got {value!r}")
        if not 0.0 < max_angle_deg < 90.0:
            raise InvalidParameter(f"max_angle_deg: expected an angle between 0° and 90°, got {max_angle_deg!r}")
        self.voxel_size_m = float(voxel_size_m)
        self.tolerance_m = 0.5 * self.voxel_size_m + 0.01 if tolerance_m is None else float(tolerance_m)
        self.min_area_m2 = float(min_area_m2)
        self._cosine = float(np.cos(np.deg2rad(max_angle_deg)))
        self._patch_cosine = float(np.cos(np.deg2rad(max_angle_deg * 2.0 / 3.0)))
        self._merge_cosine = float(np.cos(np.deg2rad(max_angle_deg / 2.0)))
        self._place_shift = max(0, int(np.floor(np.log2(0.45 / (8.0 * self.voxel_size_m)))))
        """Places, in which neighbours are looked for, are 2^shift blocks wide: 0.2 to 0.45 m, or one block."""
        self._least_patch = max(6, round(0.03 / self.voxel_size_m**2))
        self._least_group = max(12, round(0.06 / self.voxel_size_m**2))
        self._blocks: dict[Key, _Block] = {}
        self._places: dict[int, dict[int, int]] = {}
        # one slot per plane or smaller piece
        self._moments = np.zeros((0, kernels.MOMENTS))
        self._normal = np.zeros((0, 3))
        self._offset = np.zeros(0)
        self._id = np.zeros(0, np.int64)
        self._coverage: list[Coverage | None] = []
        self._on: list[dict[Key, int]] = []
        self._checked_area: list[float] = []
        self._free: list[int] = []
        self._slot_of_id: dict[int, int] = {}
        self._next_id = 1

    # -- reading ------------------------------------------------------------------------------------------
    def __len__(self) -> int:
        return len(self._slot_of_id)

    def __contains__(self, plane_id: object) -> bool:
        return plane_id in self._slot_of_id

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._slot_of_id))

    @property
    def ids(self) -> list[int]:
        """Ids of the planes, ascending."""
        return sorted(self._slot_of_id)

    def planes(self) -> list[Plane]:
        """All planes, by id."""
        return [self.plane(plane_id) for plane_id in self.ids]

    def plane(self, plane_id: int) -> Plane:
        """One plane with its border; raises `KeyError` when there is none of this id."""
        slot = self._slot_of_id[plane_id]
        coverage = self._covered(slot)
        normal, offset = self._normal[slot], float(self._offset[slot])
        shape = coverage.shape(0.1, 1.5 * self.voxel_size_m)
        rings: list[Array] = []
        for part in sorted(shapely.get_parts(shape), key=lambda p: -p.area):
            part = shapely.orient_polygons(part)
            for ring in (part.exterior, *part.interiors):
                rings.append(coverage.frame.lift(shapely.get_coordinates(ring)[:-1], normal, offset))
        axes = np.stack([coverage.frame.u, coverage.frame.v, coverage.frame.normal], axis=1)
        summary = self.summary([plane_id])
        (u0, u1), (v0, v1) = coverage.extent()
        center = coverage.frame.lift(np.array([[0.5 * (u0 + u1), 0.5 * (v0 + v1)]]), normal, offset)[0]
        moments = self._moments[slot]
        rms = float(kernels.misfit(moments, normal, offset))
        return Plane(
            id=plane_id,
            normal=normal.copy(),
            offset=offset,
            centroid=moments[1:4] / moments[0],
            rings=tuple(rings),
            area_m2=float(summary.area_m2[0]),
            z_min=float(summary.low[0, 2]),
            z_max=float(summary.high[0, 2]),
            width_m=float(summary.width_m[0]),
            box_center=center,
            box_axes=axes,
            box_size=np.array([u1 - u0, v1 - v0, max(4.0 * rms, 0.01)]),
            n_points=int(moments[0]),
            rms_m=rms,
        )

    def summary(self, ids: Iterable[int] | None = None) -> PlaneSummary:
        """The cheap measures of the planes `ids` (default all)."""
        chosen = np.array(self.ids if ids is None else list(ids), dtype=np.int64)
        slots = [self._slot_of_id[int(i)] for i in chosen]
        low, high = np.empty((len(slots), 3)), np.empty((len(slots), 3))
        area, width = np.empty(len(slots)), np.empty(len(slots))
        for k, slot in enumerate(slots):
            coverage = self._covered(slot)
            (u0, u1), (v0, v1) = coverage.extent()
            corners = coverage.frame.lift(
                np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]), self._normal[slot], self._offset[slot]
            )
            low[k], high[k] = corners.min(axis=0), corners.max(axis=0)
            area[k] = coverage.area_m2(self._normal[slot])
            upright = abs(coverage.frame.normal[2]) < 0.5
            width[k] = u1 - u0 if upright else max(u1 - u0, v1 - v0)
        return PlaneSummary(chosen, self._normal[slots], self._offset[slots], area, low, high, width)

    def samples(self, plane_id: int, at_most: int | None = None) -> Array:
        """Samples (N, 3) float32 [m] on a plane, evenly thinned to `at_most`."""
        slot = self._slot_of_id[plane_id]
        keys = list(self._on[slot])
        if at_most is not None:
            keys = keys[:: len(keys) // (at_most // 6 + 1) + 1]
        blocks = [self._blocks[key] for key in keys]
        points = np.concatenate([block.points[block.slot_of == slot] for block in blocks])
        if at_most is not None and len(points) > at_most:
            points = points[np.linspace(0, len(points) - 1, at_most).astype(np.int64)]
        return points

    def blocks_segment(self, p0: ArrayLike, p1: ArrayLike, ids: Iterable[int]) -> NDArray[np.bool_]:
        """(N,) whether each segment from p0 to p1, both (N, 3) [m], crosses a covered cell of one of the planes `ids`.

        A segment that ends on a plane does not cross it; openings (doors, windows) and what was never seen do not block.
        """
        a = np.atleast_2d(np.asarray(p0, dtype=np.float64))
        b = np.atleast_2d(np.asarray(p1, dtype=np.float64))
        blocked = np.zeros(len(a), dtype=bool)
        for plane_id in ids:
            slot = self._slot_of_id.get(int(plane_id))
            if slot is None:
                continue
            normal, offset = self._normal[slot], self._offset[slot]
            da, db = a @ normal - offset, b @ normal - offset
            crossing = np.flatnonzero(~blocked & (da * db < 0.0))
            if not len(crossing):
                continue
            share = da[crossing] / (da[crossing] - db[crossing])
            at = a[crossing] + share[:, None] * (b[crossing] - a[crossing])
            coverage = self._covered(slot)
            blocked[crossing] = coverage.near(coverage.frame.project(at), self.voxel_size_m)
        return blocked

    def spread(self, plane_id: int, at_most: int) -> Array:
        """Some `at_most` points (N, 3) [m] spread evenly over what is covered of a plane."""
        slot = self._slot_of_id[plane_id]
        coverage = self._covered(slot)
        return coverage.frame.lift(coverage.centres(at_most), self._normal[slot], float(self._offset[slot]))

    def near(self, plane_id: int, points: Array, reach_m: float, height_m: float) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] are within `height_m` of a plane and project to within `reach_m` of what is covered."""
        slot = self._slot_of_id[plane_id]
        coverage = self._covered(slot)
        hit = coverage.near(coverage.frame.project(points), reach_m)
        return np.asarray(hit & (np.abs(points @ self._normal[slot] - self._offset[slot]) <= height_m))

    # -- change -------------------------------------------------------------------------------------------
    def update(self, surface: Surface, changed_blocks: Any) -> PlaneChange:
        """Read the blocks that changed (a `Changed`, or indices (K, 3)) from the surface anew and bring the planes up to date."""
        block_ijk = np.asarray(getattr(changed_blocks, "blocks", changed_blocks), dtype=np.int32).reshape(-1, 3)
        if not len(block_ijk):
            return PlaneChange()
        return self.replace(block_ijk, *surface.surface(block_ijk))

    def replace(self, block_ijk: Array, points: Array, normals: Array, block_of_point: Array) -> PlaneChange:
        """Set the samples of the blocks (K, 3): points and normals (N, 3), and the row of `block_ijk` of each (N,)."""
        order = np.argsort(block_of_point, kind="stable")
        points = np.ascontiguousarray(points[order], dtype=np.float32)
        normals = np.ascontiguousarray(normals[order], dtype=np.float32)
        owner = np.asarray(block_of_point)[order]
        first = np.searchsorted(owner, np.arange(len(block_ijk) + 1))
        keys: list[Key] = list(map(tuple, block_ijk.tolist()))
        places = block_ijk >> self._place_shift
        codes, at, place_of_block = np.unique(_code(places), return_index=True, return_inverse=True)
        place_ijk = places[at]
        place_of = place_of_block[owner]

        near, candidates, _ = self._nearby(codes)
        touched, shrunk = self._take_away(keys)
        slot_of = np.full(len(points), -1, np.int32)
        fit_args = (self._normal, self._offset, self.tolerance_m, self._cosine)
        kernels.match(slot_of, points, normals, place_of, near, candidates, *fit_args)
        new = self._seed(slot_of, points, normals, place_of, codes, place_ijk)
        self._put(keys, owner, first, slot_of, points, normals)
        touched.update(np.unique(slot_of[slot_of >= 0]).tolist())
        touched.update(new)
        self._refit(touched)
        merged = self._merge(codes, touched)
        self._split(touched, shrunk)
        return self._publish(touched, merged)

    # -- steps of an update -------------------------------------------------------------------------------
    def _nearby(self, codes: NDArray[np.int64]) -> tuple[Array, Array, list[Iterable[int]]]:
        """Slots of the planes in or beside each place, as rows `first` and `candidates` (see `match`), and those in it."""
        around = codes[:, None] + _BESIDE
        known, row = np.unique(around, return_inverse=True)
        slots = [self._places.get(code, _NO_SLOTS) for code in known.tolist()]
        return *_gathered(slots, row.reshape(around.shape), len(self._id)), [slots[r] for r in row.reshape(around.shape)[:, 13]]

    def _place(self, key: Key) -> int:
        s = self._place_shift
        return (((key[0] >> s) + _HALF) * _SPAN + (key[1] >> s) + _HALF) * _SPAN + (key[2] >> s) + _HALF

    def _take_away(self, keys: list[Key]) -> tuple[set[int], dict[int, set[Key]]]:
        """Remove what the blocks held; returns the slots touched, and of each slot the blocks that it was in."""
        old = [(key, block) for key in keys if (block := self._blocks.pop(key, None)) is not None]
        held: dict[int, set[Key]] = {}
        if not old:
            return set(), held
        slot_of = np.concatenate([block.slot_of for _, block in old])
        points = np.concatenate([block.points for _, block in old])
        normals = np.concatenate([block.normals for _, block in old])
        self._sum(slot_of, points, normals, -1)
        for key, block in old:
            self._count(key, block.counts, -1)
            for slot in block.counts:
                held.setdefault(slot, set()).add(key)
        return set(held), held

    def _put(self, keys: list[Key], owner: Array, first: Array, slot_of: Array, points: Array, normals: Array) -> None:
        """Store samples, sorted by block, with the planes they are on."""
        self._sum(slot_of, points, normals, 1)
        row, slot, n = np.empty((3, len(points)), np.int64)
        entries = kernels.count_planes(owner, slot_of, row, slot, n)
        counts: list[dict[int, int]] = [{} for _ in keys]
        for r, s, m in zip(row[:entries].tolist(), slot[:entries].tolist(), n[:entries].tolist(), strict=True):
            counts[r][s] = m
        starts = first.tolist()
        for key, held, low, high in zip(keys, counts, starts[:-1], starts[1:], strict=True):
            if low < high:
                self._blocks[key] = _Block(points[low:high], normals[low:high], slot_of[low:high], held)
                self._count(key, held, 1)

    def _count(self, key: Key, counts: Mapping[int, int], sign: int) -> None:
        """Note that a block got (`sign` 1) or lost (−1) so many samples of each slot."""
        if not counts:
            return
        place = self._place(key)
        here = self._places.setdefault(place, {})
        for slot, n in counts.items():
            _add(here, slot, sign * n)
            _add(self._on[slot], key, sign * n)
        if not here:
            del self._places[place]

    def _sum(self, slot_of: Array, points: Array, normals: Array, sign: int) -> None:
        """Add samples to (or take them from) the moments and rasters of their planes."""
        kernels.accumulate(self._moments, slot_of, points, normals, float(sign))
        order = np.argsort(slot_of, kind="stable")
        slots, first = np.unique(slot_of[order], return_index=True)
        for slot, rows in zip(slots.tolist(), np.split(order, first[1:]), strict=True):
            if slot >= 0:
                coverage = self._covered(slot)
                (coverage.add if sign > 0 else coverage.remove)(points[rows])

    def _seed(
        self, slot_of: Array, points: Array, normals: Array, place_of: Array, codes: Array, place_ijk: Array
    ) -> list[int]:
        """Find new planes in the samples that are on none, in place; returns their slots."""
        loose = np.flatnonzero(slot_of < 0)
        if len(loose) < self._least_patch:
            return []
        loose = loose[np.argsort(place_of[loose], kind="stable")]
        first = np.searchsorted(place_of[loose], np.arange(len(place_ijk) + 1))
        moments = np.zeros((len(loose) // self._least_patch + 1, kernels.MOMENTS))
        patch_of = np.full(len(loose), -1, np.int32)
        place = np.zeros(len(moments), np.int64)
        n = kernels.find_patches(
            patch_of, moments, place, points[loose], normals[loose], first,
            _HYPOTHESES, self.tolerance_m, self._patch_cosine, self._least_patch,
        )  # fmt: skip
        if n == 0:
            return []
        group_of = np.full(n, -1, np.int32)
        ijk = place_ijk[place[:n]].astype(np.int64)
        n_groups = kernels.grow_patches(group_of, moments[:n], ijk, self.tolerance_m, self._patch_cosine)
        sums = np.zeros((n_groups, kernels.MOMENTS))
        np.add.at(sums, group_of, moments[:n])
        slot_of_group = np.full(n_groups, -1, np.int32)
        for group in np.flatnonzero(sums[:, 0] >= self._least_group):
            normal = np.empty(3)
            offset, rms = kernels.fit(sums[group], normal)
            if rms < self.tolerance_m:
                slot_of_group[group] = self._new_slot(sums[group, 1:4] / sums[group, 0], normal, offset)
        slot_of[loose] = np.where(patch_of >= 0, slot_of_group[group_of[patch_of]], -1)
        made: list[int] = slot_of_group[slot_of_group >= 0].tolist()
        if made:
            # samples that were in no patch may well be on one of the new planes
            on = slot_of[loose]
            members: list[set[int]] = [set() for _ in codes]
            for q, slot in set(zip(place_of[loose[on >= 0]].tolist(), on[on >= 0].tolist(), strict=True)):
                members[q].add(slot)
            around = codes[:, None] + _BESIDE
            row = np.minimum(np.searchsorted(codes, around), len(codes) - 1)
            row[codes[row] != around] = -1
            first, candidates = _gathered(members, row, len(self._id))
            fit_args = (self._normal, self._offset, self.tolerance_m, self._cosine)
            kernels.match(slot_of, points, normals, place_of, first, candidates, *fit_args)
        return made

    def _new_slot(self, origin: Array, normal: Array, offset: float) -> int:
        if not self._free:
            n = len(self._id)
            capacity = max(64, 2 * n)
            self._moments = np.concatenate([self._moments, np.zeros((capacity - n, kernels.MOMENTS))])
            self._normal = np.concatenate([self._normal, np.zeros((capacity - n, 3))])
            self._offset = np.concatenate([self._offset, np.zeros(capacity - n)])
            self._id = np.concatenate([self._id, np.full(capacity - n, -1)])
            self._coverage.extend([None] * (capacity - n))
            self._on.extend({} for _ in range(capacity - n))
            self._checked_area.extend([0.0] * (capacity - n))
            self._free = list(range(capacity - 1, n - 1, -1))
        slot = self._free.pop()
        self._normal[slot], self._offset[slot] = normal, offset
        self._moments[slot] = 0.0
        self._coverage[slot] = Coverage(PlaneFrame.about(origin, normal), self.voxel_size_m)
        self._checked_area[slot] = 0.0
        return slot

    def _release(self, slot: int) -> None:
        self._id[slot] = -1
        self._coverage[slot] = None
        self._on[slot].clear()
        self._free.append(slot)

    def _refit(self, slots: Iterable[int]) -> None:
        """Fit planes to their samples, and turn rasters that have come to lie badly on their plane."""
        rows = np.array(sorted(slots), np.int64)
        kernels.fit_all(self._moments, rows, self._least_patch, self._normal, self._offset)
        for slot in rows.tolist():
            frame = self._covered(slot).frame
            if self._normal[slot] @ frame.normal > _TURNED:
                continue
            best = PlaneFrame.about(frame.origin, self._normal[slot])
            if best.normal @ frame.normal < _TURNED:
                coverage = Coverage(best, self.voxel_size_m)
                coverage.add(self._samples(slot)[0])
                self._coverage[slot] = coverage

    def _covered(self, slot: int) -> Coverage:
        coverage = self._coverage[slot]
        assert coverage is not None
        return coverage

    def _samples(self, slot: int) -> tuple[Array, Array, list[tuple[_Block, Array]]]:
        """All samples of a slot: points, normals, and the blocks that hold them with their rows there."""
        held = []
        for key in self._on[slot]:
            block = self._blocks[key]
            held.append((block, np.flatnonzero(block.slot_of == slot)))
        points = np.concatenate([block.points[rows] for block, rows in held] or [np.zeros((0, 3), np.float32)])
        normals = np.concatenate([block.normals[rows] for block, rows in held] or [np.zeros((0, 3), np.float32)])
        return points, normals, held

    def _move(self, old: int, new: int, chosen: Array | None = None) -> None:
        """Give the samples of one slot, or those `chosen` (a mask in the order of `_samples`), to another."""
        keys = list(self._on[old])
        points, normals, held = self._samples(old)
        if chosen is None:
            chosen = np.ones(len(points), dtype=bool)
        start = 0
        for key, (block, rows) in zip(keys, held, strict=True):
            part = rows[chosen[start : start + len(rows)]]
            start += len(rows)
            if not len(part):
                continue
            if not block.slot_of.flags.owndata:
                block.slot_of = block.slot_of.copy()
            block.slot_of[part] = new
            for slot, sign in ((old, -1), (new, 1)):
                self._count(key, {slot: len(part)}, sign)
                _add(block.counts, slot, sign * len(part))
        points, normals = points[chosen], normals[chosen]
        if len(points):
            self._sum(np.full(len(points), old, np.int32), points, normals, -1)
            self._sum(np.full(len(points), new, np.int32), points, normals, 1)

    def _merge(self, codes: NDArray[np.int64], touched: set[int]) -> dict[int, int]:
        """Join coplanar planes that touch; returns id → id that it became part of."""
        first, nearby, inside = self._nearby(codes)
        starts, other = first.tolist(), nearby.tolist()
        pairs = {
            (min(a, b), max(a, b))
            for here, low, high in zip(inside, starts[:-1], starts[1:], strict=True)
            for a in here
            for b in other[low:high]
            if a != b
        }
        became: dict[int, int] = {}
        merged: dict[int, int] = {}
        for a, b in sorted(pairs):
            while a in became:
                a = became[a]
            while b in became:
                b = became[b]
            if a == b or not self._coplanar(a, b):
                continue
            large, small = (a, b) if self._moments[a, 0] >= self._moments[b, 0] else (b, a)
            frame = self._covered(small).frame
            cells = frame.lift(self._covered(small).centres(400), self._normal[small], self._offset[small])
            rim = self._covered(large)
            if not rim.near(rim.frame.project(cells), 1.5 * _REACH_M).any():
                continue
            ids = sorted(int(i) for i in self._id[[large, small]] if i >= 0)
            self._move(small, large)
            became[small] = large
            touched.discard(small)
            touched.add(large)
            if ids:
                if len(ids) == 2:
                    merged[ids[1]] = ids[0]
                    self._slot_of_id.pop(ids[1])
                self._id[large] = ids[0]
                self._slot_of_id[ids[0]] = large
            self._release(small)
            self._refit({large})
        for old in merged:
            while merged[old] in merged:
                merged[old] = merged[merged[old]]
        return merged

    def _coplanar(self, a: int, b: int) -> bool:
        large, small = (a, b) if self._moments[a, 0] >= self._moments[b, 0] else (b, a)
        if self._moments[small, 0] < 3:
            return False
        cosine = float(self._normal[a] @ self._normal[b])
        return bool(
            cosine >= self._merge_cosine
            and kernels.misfit(self._moments[small], self._normal[large], self._offset[large]) <= self.tolerance_m
        )

    def _split(self, touched: set[int], shrunk: dict[int, set[Key]]) -> None:
        """Part planes whose pieces do not hang together; the largest piece keeps the slot."""
        for slot in sorted(touched):
            if self._moments[slot, 0] < 0.5:
                continue
            coverage = self._covered(slot)
            lost = any(key not in self._on[slot] for key in shrunk.get(slot, ()))
            if not lost and coverage.n_covered < 1.1 * self._checked_area[slot]:
                continue
            self._checked_area[slot] = coverage.n_covered
            n, labels, stride = coverage.parts(_REACH_M)
            if n < 2:
                continue
            part = coverage.part_of(self._samples(slot)[0], labels, stride)
            sizes = np.bincount(part, minlength=n + 1)
            largest = int(sizes.argmax())
            smaller = [p for p in range(1, n + 1) if p != largest and sizes[p]]
            for p in smaller:
                new = self._new_slot(coverage.frame.origin, self._normal[slot], float(self._offset[slot]))
                points = self._samples(slot)[0]
                self._move(slot, new, coverage.part_of(points, labels, stride) == p)
                touched.add(new)
            self._refit(touched)

    def _publish(self, touched: set[int], merged: dict[int, int]) -> PlaneChange:
        """Give ids to what has become large enough, and say what changed."""
        changed: list[int] = []
        deleted: list[int] = sorted(merged)
        for slot in sorted(touched):
            plane_id = int(self._id[slot])
            coverage = self._covered(slot)
            n = self._moments[slot, 0]
            area = coverage.area_m2(self._normal[slot]) if n > 0.5 else 0.0
            if plane_id < 0 and area >= self.min_area_m2:
                plane_id = self._next_id
                self._next_id += 1
                self._id[slot] = plane_id
                self._slot_of_id[plane_id] = slot
            elif plane_id >= 0 and area < 0.7 * self.min_area_m2:
                deleted.append(plane_id)
                self._id[slot] = -1
                self._slot_of_id.pop(plane_id)
                plane_id = -1
            if plane_id >= 0:
                changed.append(plane_id)
            if n <= 0.5:
                self._release(slot)
        return PlaneChange(tuple(changed), tuple(deleted), merged)


def _code(ijk: Array) -> NDArray[np.int64]:
    """Places (N, 3) as numbers (N,), so that neighbours are a fixed number apart (see `_BESIDE`)."""
    i, j, k = (ijk.astype(np.int64) + _HALF).T
    return np.asarray((i * _SPAN + j) * _SPAN + k)


def _gathered(slots: Sequence[Collection[int]], neighbours: Array, n_slots: int) -> tuple[Array, Array]:
    """Slots in any of the neighbours (Q, K), rows of `slots` or −1, of each place (see `gather`)."""
    first = np.cumsum([0, *map(len, slots)])
    held = np.fromiter(chain.from_iterable(slots), np.int64, first[-1])
    size = first[neighbours + 1] - first[neighbours]
    near = np.empty(int(size[neighbours >= 0].sum()), np.int64)
    first_near = np.empty(len(neighbours) + 1, np.int64)
    kernels.gather(first_near, near, neighbours, first, held, np.full(n_slots, -1, np.int64))
    return first_near, near


def _add(counts: dict[Any, int], key: Any, n: int) -> None:
    """Add to a count, which is not kept when it is zero."""
    total = counts.get(key, 0) + n
    if total:
        counts[key] = total
    else:
        counts.pop(key, None)


def extract_planes(
    points: ArrayLike,
    normals: ArrayLike | None = None,
    *,
    voxel_size_m: float = 0.05,
    viewpoint: ArrayLike | None = None,
    tolerance_m: float | None = None,
    max_angle_deg: float = 30.0,
    min_area_m2: float = 0.2,
) -> list[Plane]:
    """The planes of a cloud (N, 3) [m], largest first.

    normals   : (N, 3) towards free space; where left out, estimated from the 16 nearest points and turned towards
                `viewpoint` (3,) or (N, 3) [m] (default: the origin)
    voxel_size_m : the cloud is thinned to one mean point per voxel before
    The rest as in `PlaneMap`. Raises `InvalidParameter` when the arrays do not have these shapes.
    """
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InvalidParameter(f"points: expected an array (N, 3), got {cloud.shape}")
    planes = PlaneMap(
        voxel_size_m, tolerance_m=tolerance_m, max_angle_deg=max_angle_deg, min_area_m2=min_area_m2
    )
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if len(cloud) < 16:
        return []
    eye = np.zeros(3) if viewpoint is None else np.asarray(viewpoint, dtype=np.float64)
    ijk = np.floor(cloud / voxel_size_m).astype(np.int64)
    voxels, voxel_of, n = np.unique(ijk, axis=0, return_inverse=True, return_counts=True)
    voxel_of = voxel_of.reshape(-1)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(voxel_of, values[:, a], len(voxels)) for a in range(3)], axis=1) / n[:, None]

    thinned = mean(cloud)
    if normals is None:
        towards = mean(np.broadcast_to(eye, cloud.shape)) - thinned
        oriented = _estimate_normals(thinned, towards)
    else:
        given = np.asarray(normals, dtype=np.float64)
        if given.shape != np.shape(points):
            raise InvalidParameter(f"normals: expected the shape of points {np.shape(points)}, got {given.shape}")
        oriented = mean(given[np.isfinite(np.asarray(points)).all(axis=1)])
        oriented /= np.maximum(np.linalg.norm(oriented, axis=1, keepdims=True), 1e-9)
    blocks, block_of = np.unique(voxels >> 3, axis=0, return_inverse=True)
    planes.replace(blocks.astype(np.int32), thinned, oriented, block_of.reshape(-1))
    return sorted(planes.planes(), key=lambda plane: -plane.area_m2)


def _estimate_normals(points: Array, towards: Array) -> Array:
    """Normals (N, 3) from the 16 nearest points each, turned the way of `towards` (N, 3)."""
    from scipy.spatial import cKDTree

    _, index = cKDTree(points).query(points, k=16)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))[1][:, :, 0]
    return np.asarray(normals * np.where(np.einsum("ni,ni->n", normals, towards) < 0.0, -1.0, 1.0)[:, None])
