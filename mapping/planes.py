"""Planes in surfaces: found in a cloud at once (`extract_planes`), or kept up to date block by block (`PlaneMap`).

After Nüchter & Hertzberg, Towards semantic maps for mobile robots, 2008, section 3.1 (random sample consensus with
refinement), made incremental: what a block contributes to a plane is additive and is replaced when the block changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol, TypeAlias

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter, MappingError
from mapping.kernels import planes as kernels
from mapping.plane import Plane, PlaneChange, PlaneSummary
from mapping.plane_pieces import Key, Pieces, Surrounding

__all__ = ["Plane", "PlaneChange", "PlaneMap", "PlaneSummary", "Surface", "extract_planes"]

Array: TypeAlias = NDArray[Any]

_HYPOTHESES = 12
_REACH_M = 0.25
"""Coarse cell for telling pieces apart: gaps above twice this always part a plane."""
_LEAST_BORDER_M2 = 0.1
"""Smaller holes and parts do not show in a plane's borders."""
_UNMOVED = 0.1
"""A block whose samples all stayed within so many voxels says of planes what it said before."""


class Surface(Protocol):
    """What planes are found in: a `TsdfMap`, or anything else with oriented surface samples per block."""

    def surface(self, block_ijk: Any = None, /) -> tuple[Array, Array, Array]:
        """Samples (N, 3) [m], normals (N, 3) into free space, and the index (N,) into `block_ijk` of each."""


class PlaneMap:
    """Planes of a surface that changes block by block; the cost of an update depends on the changed blocks only.

    voxel_size_m  : of the surface's blocks of 8³ voxels [m]
    tolerance_m   : a sample within this distance of a plane may be on it; default half a voxel + 1 cm
    max_angle_deg : between a sample's normal and its plane's
    min_area_m2   : smaller pieces are kept but not told of

    Pieces of one plane that are parted by a gap of 0.5 m or more are different planes. Ids are kept for as long as the
    plane is there; when planes merge, the lowest id stays. Raises `InvalidParameter` on bad values.
    """

    def __init__(
        self,
        voxel_size_m: float,
        *,
        tolerance_m: float | None = None,
        max_angle_deg: float = 30.0,
        min_area_m2: float = 0.2,
    ) -> None:
        self.voxel_size_m = _positive("voxel_size_m", voxel_size_m)
        self.tolerance_m = _positive("tolerance_m", 0.5 * voxel_size_m + 0.01 if tolerance_m is None else tolerance_m)
        self.min_area_m2 = _positive("min_area_m2", min_area_m2)
        self.max_angle_deg = _positive("max_angle_deg", max_angle_deg)
        if max_angle_deg >= 90.0:
            raise InvalidParameter(f"max_angle_deg: expected an angle below 90°, got {max_angle_deg!r}")
        self._cosine, self._patch_cosine, self._merge_cosine = (
            float(np.cos(np.deg2rad(share * max_angle_deg))) for share in (1.0, 2.0 / 3.0, 0.5)
        )
        self._least_patch = max(6, round(0.03 / voxel_size_m**2))
        self._least_group = max(12, round(0.06 / voxel_size_m**2))
        self._pieces = self._no_pieces()
        self._slot_of: dict[int, int] = {}
        self._id_of: dict[int, int] = {}
        self._checked: dict[int, int] = {}
        self._known: dict[int, Plane] = {}
        self._next_id = 1

    def _no_pieces(self) -> Pieces:
        # places of 0.2 to 0.45 m, or of one block
        shift = max(0, int(np.floor(np.log2(0.45 / (8.0 * self.voxel_size_m)))))
        return Pieces(self.voxel_size_m, least=self._least_patch, place_shift=shift)

    # -- reading ------------------------------------------------------------------------------------------
    def __len__(self) -> int:
        return len(self._slot_of)

    def __contains__(self, plane_id: object) -> bool:
        return plane_id in self._slot_of

    def __iter__(self) -> Iterator[int]:
        return iter(self.ids)

    @property
    def ids(self) -> list[int]:
        """Ids of the planes, ascending."""
        return sorted(self._slot_of)

    def planes(self) -> list[Plane]:
        """All planes, by id."""
        return [self.plane(plane_id) for plane_id in self.ids]

    def plane(self, plane_id: int) -> Plane:
        """One plane with its border, kept until it changes; raises `KeyError` when there is none of this id."""
        slot = self._slot_of[plane_id]
        if slot not in self._known:
            self._known[slot] = self._described(plane_id, slot)
        return self._known[slot]

    def _described(self, plane_id: int, slot: int) -> Plane:
        coverage, moments = self._pieces.coverage(slot), self._pieces.moments[slot]
        frame, normal, offset = coverage.frame, self._pieces.normal[slot].copy(), float(self._pieces.offset[slot])
        rings: list[Array] = []
        shape = coverage.shape(_LEAST_BORDER_M2, 1.5 * self.voxel_size_m)
        for part in sorted(shapely.get_parts(shape), key=lambda p: -p.area):
            turned = shapely.orient_polygons(part)
            borders = (turned.exterior, *turned.interiors)
            rings.extend(frame.lift(shapely.get_coordinates(ring)[:-1], normal, offset) for ring in borders)
        summary = self.summary([plane_id])
        (u0, u1), (v0, v1) = coverage.extent()
        rms = float(kernels.misfit(moments, normal, offset))
        return Plane(
            id=plane_id,
            normal=normal,
            offset=offset,
            centroid=moments[1:4] / moments[0],
            rings=tuple(rings),
            area_m2=float(summary.area_m2[0]),
            z_min=float(summary.low[0, 2]),
            z_max=float(summary.high[0, 2]),
            width_m=float(summary.width_m[0]),
            box_center=frame.lift(np.array([[0.5 * (u0 + u1), 0.5 * (v0 + v1)]]), normal, offset)[0],
            box_axes=np.stack([frame.u, frame.v, frame.normal], axis=1),
            box_size=np.array([u1 - u0, v1 - v0, max(4.0 * rms, 0.01)]),
            n_points=self._pieces.count(slot),
            rms_m=rms,
        )

    def summary(self, ids: Iterable[int] | None = None) -> PlaneSummary:
        """The cheap measures of the planes `ids` (default all)."""
        chosen = np.array(self.ids if ids is None else list(ids), dtype=np.int64)
        slots = [self._slot_of[int(i)] for i in chosen]
        normals, offsets = self._pieces.normal[slots], self._pieces.offset[slots]
        low, high = np.empty((2, len(slots), 3))
        area, width = np.empty((2, len(slots)))
        for k, slot in enumerate(slots):
            coverage = self._pieces.coverage(slot)
            extent = coverage.extent()
            coverage.bound(low[k], high[k], extent, normals[k], offsets[k])
            area[k] = coverage.area_m2(normals[k])
            upright = abs(coverage.frame.normal[2]) < 0.5
            along_u, along_v = extent[:, 1] - extent[:, 0]
            width[k] = along_u if upright else max(along_u, along_v)
        return PlaneSummary(chosen, normals, offsets, area, low, high, width)

    def samples(self, plane_id: int, at_most: int | None = None) -> Array:
        """Samples (N, 3) float32 [m] on a plane, thinned to `at_most`."""
        return self._pieces.samples(self._slot_of[plane_id], at_most)

    def equations(self, ids: Iterable[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normals (K, 3) and offsets (K,) [m] of the planes `ids`."""
        slots = [self._slot_of[i] for i in ids]
        return self._pieces.normal[slots], self._pieces.offset[slots]

    def blocks_of(self, plane_id: int) -> NDArray[np.int32]:
        """The blocks (K, 3) of the surface that hold samples of a plane."""
        return np.array(sorted(self._pieces.blocks(self._slot_of[plane_id])), np.int32).reshape(-1, 3)

    def samples_in(
        self, block_ijk: Array
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """The surface in blocks (K, 3): points (N, 3) float32 [m], their normals (N, 3), the id (N,) of the plane of
        each, 0 where it is on none that is told of, and the row (N,) of its block, ascending."""
        points, normals, slots, owner = self._pieces.samples_in(block_ijk.tolist())
        ids = np.zeros(int(slots.max(initial=-1)) + 2, np.int64)  # the last is that of no piece
        for slot in np.unique(slots[slots >= 0]).tolist():
            ids[slot] = self._id_of.get(slot, 0)
        return points, normals, ids[slots], owner

    def ids_near(self, block_ijk: Array) -> list[int]:
        """The planes, ascending, of which samples lie in or next to (0.2 to 0.45 m) one of the blocks (K, 3)."""
        codes = np.unique(self._pieces.place_codes(block_ijk))
        _, slots = self._pieces.nearby(self._pieces.about(codes))
        return sorted(self._id_of[slot] for slot in set(slots.tolist()) if slot in self._id_of)

    def spread(self, plane_id: int, at_most: int) -> Array:
        """Some `at_most` points (N, 3) [m] spread evenly over what is covered of a plane."""
        slot = self._slot_of[plane_id]
        return self._spread(slot, at_most)

    def _spread(self, slot: int, at_most: int) -> Array:
        coverage = self._pieces.coverage(slot)
        return coverage.frame.lift(coverage.centres(at_most), self._pieces.normal[slot], self._pieces.offset[slot])

    def near(self, plane_id: int, points: Array, reach_m: float, height_m: float) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] are within `height_m` of a plane and project to within `reach_m` of a covered
        cell."""
        slot = self._slot_of[plane_id]
        points = np.ascontiguousarray(points, dtype=np.float64)
        normal, offset = self._pieces.normal[slot], self._pieces.offset[slot]
        return self._pieces.coverage(slot).near_plane(points, normal, offset, reach_m, height_m)

    def blocks_segment(self, p0: ArrayLike, p1: ArrayLike, ids: Iterable[int]) -> NDArray[np.bool_]:
        """(N,) whether each segment from p0 to p1, both (N, 3) [m], crosses a covered cell of one of the planes `ids`.

        A segment that ends on a plane does not cross it; openings and what was never seen do not block.
        """
        return self.count_crossings(p0, p1, ids) > 0

    def count_crossings(self, p0: ArrayLike, p1: ArrayLike, ids: Iterable[int]) -> NDArray[np.int64]:
        """(N,) how many of the planes `ids` each segment crosses in a covered cell, as in `blocks_segment`."""
        p, q = (np.ascontiguousarray(np.atleast_2d(np.asarray(end, dtype=np.float64))) for end in (p0, p1))
        crossed = np.zeros(len(p), dtype=np.int64)
        slots = [slot for plane_id in ids if (slot := self._slot_of.get(int(plane_id))) is not None]
        normals, offsets = self._pieces.normal, self._pieces.offset
        if len(p) == 1 and len(slots) > 2:  # most planes about a segment have it on one side
            sides = (p @ normals[slots].T - offsets[slots]) * (q @ normals[slots].T - offsets[slots])
            slots = [slots[k] for k in np.flatnonzero(sides[0] < 0.0).tolist()]
        for slot in slots:
            self._pieces.coverage(slot).count_crossings(crossed, p, q, normals[slot], offsets[slot], self.voxel_size_m)
        return crossed

    def seen_along(
        self, plane_id: int, n: int, begin: Array, step: Array, heights: Array, half: Array
    ) -> NDArray[np.bool_]:
        """(n,) whether an upright plane was seen at one of the heights (H,) [m] over the places begin + i · step (2,)
        [m] of the ground, no farther than `half` (2,) [m] before or behind."""
        slot = self._slot_of[plane_id]
        return self._pieces.coverage(slot).seen_along(
            n, begin, step, heights, half, self._pieces.normal[slot], self._pieces.offset[slot], self.voxel_size_m
        )

    # -- change -------------------------------------------------------------------------------------------
    def update(self, surface: Surface, changed_blocks: Any) -> PlaneChange:
        """Read the blocks that changed (a `Changed`, or indices (K, 3)) from the surface anew, and follow.

        Blocks whose samples stayed within `_UNMOVED` voxels of where they were are left as they are.
        """
        block_ijk = np.asarray(getattr(changed_blocks, "blocks", changed_blocks), dtype=np.int32).reshape(-1, 3)
        if not len(block_ijk):
            return PlaneChange()
        points, normals, owner = _by_block(*surface.surface(block_ijk))
        old, _, slot_of, old_owner = self._pieces.samples_in(block_ijk.tolist())
        same = np.empty(len(block_ijk), np.bool_)
        kernels.find_unmoved(same, points, owner, old, old_owner, _UNMOVED * self.voxel_size_m)
        seen = {self._id_of[slot] for slot in np.unique(slot_of[same[old_owner]]).tolist() if slot in self._id_of}
        if same.all():
            return PlaneChange(tuple(sorted(seen)))
        moved = ~same[owner]
        number = np.cumsum(~same) - 1
        change = self._replace(block_ijk[~same], points[moved], normals[moved], number[owner[moved]])
        changed = tuple(sorted((seen - set(change.deleted)).union(change.changed)))
        return replace(change, changed=changed, moved=block_ijk[~same])

    def replace(self, block_ijk: Array, points: Array, normals: Array, block_of_point: Array) -> PlaneChange:
        """Set the samples of the blocks (K, 3): points and normals (N, 3), and the row of `block_ijk` of each (N,)."""
        return self._replace(block_ijk, *_by_block(points, normals, block_of_point))

    def _replace(self, block_ijk: Array, points: Array, normals: Array, owner: Array) -> PlaneChange:
        """As `replace`, with float32 samples by ascending block."""
        keys: list[Key] = [(i, j, k) for i, j, k in block_ijk.tolist()]
        codes, at, place_of_block = np.unique(
            self._pieces.place_codes(block_ijk), return_index=True, return_inverse=True
        )
        place_of = place_of_block[owner]
        place_ijk = (block_ijk >> self._pieces.place_shift)[at]

        places = self._pieces.about(codes)
        near, candidates = self._pieces.nearby(places)
        slot_of = np.full(len(points), -1, np.int32)
        self._match(slot_of, points, normals, place_of, near, candidates)
        made = self._seed(slot_of, points, normals, place_of, codes, place_ijk)
        held = self._pieces.replace(keys, owner, slot_of, points, normals)
        touched = {*held, *made}
        touched.update(np.unique(slot_of[slot_of >= 0]).tolist())
        self._pieces.refit(touched)
        merged = self._merge(places, touched)
        self._split(touched, held)
        return self._publish(touched, merged)

    def _match(
        self, slot_of: Array, points: Array, normals: Array, place_of: Array, first: Array, candidates: Array
    ) -> None:
        kernels.match(
            slot_of, points, normals, place_of, first, candidates,
            self._pieces.normal, self._pieces.offset, self.tolerance_m, self._cosine,
        )  # fmt: skip

    def _seed(
        self, slot_of: Array, points: Array, normals: Array, place_of: Array, codes: Array, place_ijk: Array
    ) -> list[int]:
        """Find new pieces in the samples that are on none, in place; returns their slots."""
        loose = np.flatnonzero(slot_of < 0)
        if len(loose) < self._least_patch:
            return []
        loose = loose[np.argsort(place_of[loose], kind="stable")]
        first = np.searchsorted(place_of[loose], np.arange(len(codes) + 1))
        moments = np.zeros((len(loose) // self._least_patch + 1, kernels.MOMENTS))
        patch_of = np.full(len(loose), -1, np.int32)
        place = np.zeros(len(moments), np.int64)
        n = kernels.find_patches(
            patch_of, moments, place, points[loose], normals[loose], first,
            _HYPOTHESES, self.tolerance_m, self._patch_cosine, self._least_patch,
        )  # fmt: skip
        group_of = np.full(n, -1, np.int32)
        ijk = place_ijk[place[:n]].astype(np.int64)
        n_groups = kernels.grow_patches(group_of, moments[:n], ijk, self.tolerance_m, self._patch_cosine)
        sums = np.zeros((n_groups, kernels.MOMENTS))
        np.add.at(sums, group_of, moments[:n])
        slot_of_group = np.full(n_groups + 1, -1, np.int32)
        for group in np.flatnonzero(sums[:, 0] >= self._least_group):
            normal = np.empty(3)
            offset, rms = kernels.fit(sums[group], normal)
            if rms < self.tolerance_m:
                slot_of_group[group] = self._pieces.new(sums[group, 1:4] / sums[group, 0], normal, offset)
        made: list[int] = slot_of_group[slot_of_group >= 0].tolist()
        if made:
            on = slot_of_group[np.append(group_of, n_groups)[patch_of]]
            slot_of[loose] = on
            # samples that were in no patch may well be on one of the new pieces
            members: list[set[int]] = [set() for _ in codes]
            for q, slot in set(zip(place_of[loose[on >= 0]].tolist(), on[on >= 0].tolist(), strict=True)):
                members[q].add(slot)
            self._match(slot_of, points, normals, place_of, *self._pieces.nearby_among(codes, members))
        return made

    def _merge(self, places: Surrounding, touched: set[int]) -> dict[int, int]:
        """Join coplanar pieces that touch; returns id → id that it became part of."""
        p = self._pieces
        first_in, inside, first_near, near = p.inside_and_nearby(places)
        pairs = np.empty((int((np.diff(first_in) * np.diff(first_near)).sum()), 2), np.int64)
        n = kernels.find_coplanar(
            pairs, first_in, inside, first_near, near, p.moments, p.normal, p.offset,
            self._merge_cosine, self.tolerance_m,
        )  # fmt: skip
        became: dict[int, int] = {}
        merged: dict[int, int] = {}
        for a, b in sorted(set(map(tuple, pairs[:n].tolist()))):
            while a in became:
                a = became[a]
            while b in became:
                b = became[b]
            large, small = (a, b) if self._pieces.count(a) >= self._pieces.count(b) else (b, a)
            if a == b or not self._join(large, small):
                continue
            ids = sorted(self._id_of[slot] for slot in (large, small) if slot in self._id_of)
            self._pieces.move(small, large)
            self._pieces.refit({large})
            self._forget(small)
            became[small] = large
            touched.discard(small)
            touched.add(large)
            if ids:
                self._forget(large)
                self._id_of[large], self._slot_of[ids[0]] = ids[0], large
                merged.update(dict.fromkeys(ids[1:], ids[0]))
            self._pieces.release(small)
        for old in merged:
            while merged[old] in merged:
                merged[old] = merged[merged[old]]
        return merged

    def _join(self, large: int, small: int) -> bool:
        """Whether the small piece lies in the plane of the large one and touches it."""
        p = self._pieces
        if not kernels.lies_in(
            p.moments[small], p.normal[small], p.normal[large], float(p.offset[large]), self._merge_cosine,
            self.tolerance_m,
        ):  # fmt: skip
            return False
        coverage = p.coverage(large)
        return bool(coverage.near(coverage.frame.project(self._spread(small, 400)), 1.5 * _REACH_M).any())

    def _split(self, touched: set[int], held: Mapping[int, set[Key]]) -> None:
        """Part pieces that do not hang together; the largest part keeps the slot."""
        for slot in sorted(touched):
            coverage = self._pieces.coverage(slot)
            blocks = self._pieces.blocks(slot)
            lost = any(key not in blocks for key in held.get(slot, ()))
            if coverage.n_covered == 0 or not (lost or coverage.n_covered >= 1.1 * self._checked.get(slot, 0)):
                continue
            self._checked[slot] = coverage.n_covered
            n, labels, stride = coverage.parts(_REACH_M)
            if n < 2:
                continue
            part_of = coverage.part_of(self._pieces.samples(slot), labels, stride)
            sizes = np.bincount(part_of, minlength=n + 1)
            parts = {slot}
            for part in np.argsort(-sizes, kind="stable")[1:]:
                if part == 0 or sizes[part] == 0:
                    continue
                new = self._pieces.new(coverage.frame.origin, self._pieces.normal[slot], self._pieces.offset[slot])
                self._pieces.move(slot, new, part_of == part)
                part_of = part_of[part_of != part]
                parts.add(new)
            self._pieces.refit(parts)
            touched |= parts

    def _publish(self, touched: set[int], merged: dict[int, int]) -> PlaneChange:
        """Give ids to what has become large enough, and say what changed."""
        changed: list[int] = []
        deleted: list[int] = sorted(merged)
        for slot in sorted(touched):
            self._known.pop(slot, None)
            area = self._pieces.coverage(slot).area_m2(self._pieces.normal[slot])
            plane_id = self._id_of.get(slot)
            if plane_id is None and area >= self.min_area_m2:
                plane_id = self._next_id
                self._next_id += 1
                self._id_of[slot], self._slot_of[plane_id] = plane_id, slot
            elif plane_id is not None and area < 0.7 * self.min_area_m2:
                deleted.append(plane_id)
                self._forget(slot)
                plane_id = None
            if plane_id is not None:
                changed.append(plane_id)
            if self._pieces.count(slot) == 0:
                self._forget(slot)
                self._pieces.release(slot)
        return PlaneChange(tuple(sorted(changed)), tuple(sorted(deleted)), merged)

    def _forget(self, slot: int) -> None:
        self._known.pop(slot, None)
        self._checked.pop(slot, None)
        plane_id = self._id_of.pop(slot, None)
        if plane_id is not None:
            self._slot_of.pop(plane_id)

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything that makes this map, as named arrays."""
        used = self._pieces.used
        ids = np.array([self._id_of.get(slot, 0) for slot in used], np.int64)
        return {"ids": ids, "next_id": np.array(self._next_id), **self._pieces.state()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take over what `state` gave, in place of all that is here; raises `MappingError` where it is incomplete."""
        missing = self.state().keys() - state.keys()
        if missing:
            raise MappingError(f"the saved planes lack {', '.join(sorted(missing))}")
        self._pieces = self._no_pieces()
        self._pieces.restore(state)
        self._id_of = {slot: plane_id for slot, plane_id in enumerate(state["ids"].tolist()) if plane_id}
        self._slot_of = {plane_id: slot for slot, plane_id in self._id_of.items()}
        self._checked, self._known = {}, {}
        self._next_id = int(state["next_id"])


def _positive(name: str, value: float) -> float:
    if not (isinstance(value, int | float | np.number) and np.isfinite(value) and value > 0.0):
        raise InvalidParameter(f"{name}: expected a number > 0, got {value!r}")
    return float(value)


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
    """The planes of a cloud (N, 3) [m], largest first; points that are not finite are left out.

    normals      : (N, 3) towards free space; where left out, estimated from the 16 nearest points and turned towards
                   `viewpoint`, (3,) or (N, 3) [m], default the origin
    voxel_size_m : the cloud is thinned to one mean point a voxel before

    The rest as in `PlaneMap`. Raises `InvalidParameter` when the arrays do not have these shapes.
    """
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InvalidParameter(f"points: expected an array (N, 3), got {cloud.shape}")
    eye = np.zeros(3) if viewpoint is None else np.asarray(viewpoint, dtype=np.float64)
    if eye.shape not in ((3,), cloud.shape):
        raise InvalidParameter(f"viewpoint: expected (3,) or {cloud.shape} like points, got {eye.shape}")
    given = None if normals is None else np.asarray(normals, dtype=np.float64)
    if given is not None and given.shape != cloud.shape:
        raise InvalidParameter(f"normals: expected {cloud.shape} like points, got {given.shape}")
    planes = PlaneMap(voxel_size_m, tolerance_m=tolerance_m, max_angle_deg=max_angle_deg, min_area_m2=min_area_m2)

    finite = np.isfinite(cloud).all(axis=1)
    towards = np.broadcast_to(eye, cloud.shape)[finite] - cloud[finite] if given is None else given[finite]
    cloud = cloud[finite]
    voxels, voxel_of, n = np.unique(
        np.floor(cloud / voxel_size_m).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    if len(voxels) < _NEIGHBOURS:
        return []
    rows = voxel_of.reshape(-1)
    thinned, towards = (
        np.stack([np.bincount(rows, values[:, a]) for a in range(3)], axis=1) / n[:, None]
        for values in (cloud, towards)
    )
    oriented = _estimated_normals(thinned, towards) if given is None else towards
    oriented = oriented / np.maximum(np.linalg.norm(oriented, axis=1, keepdims=True), 1e-9)
    blocks, block_of = np.unique(voxels >> 3, axis=0, return_inverse=True)
    planes.replace(blocks.astype(np.int32), thinned, oriented, block_of.reshape(-1))
    return sorted(planes.planes(), key=lambda plane: -plane.area_m2)


def _by_block(points: Array, normals: Array, block_of_point: Array) -> tuple[Array, Array, Array]:
    """Copies of points and normals (N, 3) as float32, and the block (N,) of each, by ascending block."""
    owner = np.asarray(block_of_point)
    if (owner[1:] < owner[:-1]).any():
        order = np.argsort(owner, kind="stable")
        points, normals, owner = points[order], normals[order], owner[order]
    return np.array(points, np.float32, order="C"), np.array(normals, np.float32, order="C"), owner


_NEIGHBOURS = 16


def _estimated_normals(points: Array, towards: Array) -> Array:
    """Normals (N, 3) from the nearest points of each, turned the way of `towards` (N, 3)."""
    from scipy.spatial import cKDTree

    _, index = cKDTree(points).query(points, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))[1][:, :, 0]
    return np.asarray(normals * np.where(np.einsum("ni,ni->n", normals, towards) < 0.0, -1.0, 1.0)[:, None])
