"""Measurements between things: the numbers from which `rules/spatial.pl` decides what is on, in, near or above what.

Definitions are those of the project's relations document; nothing here compares a number with a relation's threshold. A
pair that is too far apart to matter is not measured, and the rules read a missing measurement as *no*.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import columns
from mapping.kernels import shapes as kernels
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Pair: TypeAlias = tuple[str, str]

FAR_M = 1.5
"""Beyond this distance nothing is near anything (`near_most` in the rules)."""
CONTACT_MARGIN_M = 0.03
"""Two surfaces this close, and a voxel more, may touch (`contact_margin` in the rules)."""
SIDE_WINDOW_M = 0.35
"""How far around a thing the surface below it is looked at, to complete what the thing itself hides."""
SETTLE_M = 0.25
"""How far a thing whose bottom was not seen is completed downwards."""
HIDDEN_SHARE = 0.7
"""The space under a thing hides its bottom when this share of it was not seen to be free."""
NO_PATH_M = 1.0e9
MOST_INSIDE = 300
MOST_MATERIAL = 8000
"""Points of a thing, and of what it may be in, that are looked at to see whether it is inside."""


Passage: TypeAlias = Literal["clear", "blocked", "unseen"]


class Surroundings(Protocol):
    """What relations ask of the building and of space."""

    def floor_below(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The floor under a point: its node id and height [m]."""

    def between(self, p: Array, q: Array) -> Passage:
        """What stands between two points (3,): nothing, structure (walls, floors, ceilings), or a wall's unseen
        part."""

    def way_around(self, p: Array, q: Array, limit_m: float) -> tuple[float, float]:
        """Shortest way from p to q around structure, through observed space only and with unknown passable [m]."""

    def seen_free(self, points: Array) -> Array:
        """(N,) bool: which points (N, 3) lie in space that was observed to be free."""


@dataclass
class MeasurementChange:
    """Facts to put and to delete: (name, a) or (name, a, b) → value."""

    put: dict[tuple[str, ...], float] = field(default_factory=dict)
    deleted: list[tuple[str, ...]] = field(default_factory=list)

    def merge(self, later: MeasurementChange) -> None:
        """Add a change that came after this one."""
        for key in later.deleted:
            self.put.pop(key, None)
        self.put.update(later.put)
        self.deleted = [key for key in self.deleted if key not in later.put] + later.deleted


class Relations:
    """Keeps the measurements of all pairs near each other in step with the things' shapes.

    is_container(label): whether the taxonomy says that the whole box of such a thing is its inside.
    """

    def __init__(self, is_container: Callable[[str], bool]) -> None:
        self._is_container = is_container
        self._index = GroundIndex()
        self._facts: dict[tuple[str, ...], float] = {}
        self._keys_of: defaultdict[str, set[tuple[str, ...]]] = defaultdict(set)

    def update(
        self, shapes: Mapping[str, Shape], labels: Mapping[str, str], reshaped: Iterable[str], around: Surroundings
    ) -> MeasurementChange:
        """Measure anew everything that involves a reshaped thing; ids that are no longer in `shapes` are forgotten."""
        reshaped = set(reshaped)
        for thing in reshaped:
            if thing in shapes:
                self._index.put(thing, shapes[thing].bounds)
            else:
                self._index.remove(thing)
        fresh: dict[tuple[str, ...], float] = {}
        stale: set[tuple[str, ...]] = set()
        for thing in reshaped:
            kept = () if thing not in shapes else ("contact", "footprint_share")
            stale |= {
                key
                for key in self._keys_of[thing]
                if key[0] not in kept or (key[0] == "contact" and key[1] in reshaped)
            }
        supports_of: set[str] = set()
        for thing in sorted(reshaped & shapes.keys()):
            mine = shapes[thing]
            fresh["longer_side", thing] = mine.box.size[0]
            fresh["lowest", thing] = mine.lowest
            fresh["highest", thing] = mine.highest
            for other in self._index.within(mine.bounds, FAR_M):
                if other == thing or (other in reshaped and other < thing):
                    continue
                self._measure_pair(thing, other, shapes, labels, around, fresh)
                if shapes[other].lowest >= mine.lowest - 0.1:
                    supports_of.add(other)  # what stands on a thing is measured anew with it
            supports_of.add(thing)
        for thing in sorted(supports_of):
            stale |= {key for key in self._keys_of[thing] if key[0] == "contact" and key[1] == thing}
            fresh.update(self._contacts(thing, shapes, around))
        return self._replace(stale, fresh)

    def set_shares(self, thing: str, shares: Mapping[str, float]) -> MeasurementChange:
        """Note in which rooms the footprint of a thing lies: room id → share."""
        fresh: dict[tuple[str, ...], float] = {("footprint_share", thing, r): share for r, share in shares.items()}
        stale = {key for key in self._keys_of[thing] if key[0] == "footprint_share"}
        return self._replace(stale, fresh)

    def things_in(self, rooms: Iterable[str]) -> set[str]:
        """The things of whose footprint a share lies in one of the rooms, and those that lie around them."""
        return {key[1] for room in rooms for key in self._keys_of.get(room, ()) if key[0] == "footprint_share"}

    @property
    def facts(self) -> MeasurementChange:
        """All measurements, as a change that puts them."""
        return MeasurementChange(dict(self._facts))

    def document(self) -> list[list[Any]]:
        """All measurements as JSON values: [name, id, …, value]."""
        return [[*key, value] for key, value in self._facts.items()]

    def restore(self, document: list[list[Any]], shapes: Mapping[str, Shape]) -> None:
        """Take over what `document` gave."""
        self._replace(set(), {tuple(row[:-1]): row[-1] for row in document})
        for thing, shape in shapes.items():
            self._index.put(thing, shape.bounds)

    def _replace(self, stale: set[tuple[str, ...]], fresh: dict[tuple[str, ...], float]) -> MeasurementChange:
        change = MeasurementChange()
        for key in sorted(stale - fresh.keys()):
            if self._facts.pop(key, None) is not None:
                change.deleted.append(key)
                for thing in key[1:]:
                    self._keys_of[thing].discard(key)
        for key, value in fresh.items():
            rounded = round(float(value), 4)
            if self._facts.get(key) != rounded:
                self._facts[key] = rounded
                change.put[key] = rounded
                for thing in key[1:]:
                    self._keys_of[thing].add(key)
        return change

    # -- pairs --------------------------------------------------------------------------------------------
    def _measure_pair(
        self,
        one: str,
        two: str,
        shapes: Mapping[str, Shape],
        labels: Mapping[str, str],
        around: Surroundings,
        fresh: dict[tuple[str, ...], float],
    ) -> None:
        a, b = min(one, two), max(one, two)
        shape_a, shape_b = shapes[a], shapes[b]
        if _bounds_gap(shape_a.bounds, shape_b.bounds) <= FAR_M:
            gap, p, q = shape_a.distance_m(shape_b)
            if gap <= FAR_M:
                touch = 0.5 * (shape_a.voxel_size_m + shape_b.voxel_size_m)
                fresh["gap", a, b] = gap = max(0.0, gap - touch)
                upper = lower = gap
                passage = around.between(p, q) if gap > 0.0 else "clear"
                if passage != "clear":
                    upper, lower = around.way_around(p, q, FAR_M)
                if passage == "unseen":
                    lower = gap
                fresh["path_gap_upper", a, b] = min(upper, NO_PATH_M)
                fresh["path_gap_lower", a, b] = min(lower, NO_PATH_M)
        smaller = min(shape_a.area, shape_b.area)
        overlap = kernels.overlap_area(shape_a.hull, shape_b.hull) / smaller if smaller > 0 else 0.0
        if overlap > 0.0:
            fresh["footprint_overlap", a, b] = min(1.0, overlap)
            for upper_thing, lower_thing in ((a, b), (b, a)):
                self._measure_over(upper_thing, lower_thing, shapes, labels, around, fresh)

    def _measure_over(
        self,
        a: str,
        b: str,
        shapes: Mapping[str, Shape],
        labels: Mapping[str, str],
        around: Surroundings,
        fresh: dict[tuple[str, ...], float],
    ) -> None:
        over, under = shapes[a], shapes[b]
        if over.highest <= under.lowest:
            return
        rise, p, q = _rise(over, under)
        fresh["rise", a, b] = rise
        if rise > CONTACT_MARGIN_M:
            fresh["structure_between", a, b] = float(around.between(p, q) == "blocked")
        footing_inside, voxels_inside = _inside(over, under, self._is_container(labels[b]))
        if footing_inside > 0.0:
            fresh["footing_inside", a, b] = footing_inside
            fresh["voxels_inside", a, b] = voxels_inside

    # -- contact ------------------------------------------------------------------------------------------
    def _contacts(self, thing: str, shapes: Mapping[str, Shape], around: Surroundings) -> dict[tuple[str, ...], float]:
        """Share of the footing under which the first other material downwards belongs to each thing.

        A surface hides behind what stands on it, so the surface is completed: the hull of what of it is seen around
        the thing, at the height in question.
        """
        mine = shapes[thing]
        footing = mine.footing
        tolerance = CONTACT_MARGIN_M + mine.voxel_size_m
        surfaces: list[tuple[float, str, Array]] = []
        low, high = mine.bounds
        center = 0.5 * (low + high)
        floor = around.floor_below(float(center[0]), float(center[1]), mine.lowest)
        if floor is not None:
            surfaces.append((floor[1], floor[0], np.ones(len(footing), bool)))
        for other in self._index.within(mine.bounds, 0.0):
            if other != thing:
                surfaces += [(top, other, inside) for top, inside in _surfaces_under(mine, shapes[other], footing)]
        surfaces.sort(key=lambda s: (-s[0], s[1]))
        contacts = _first_below(footing, surfaces, mine.lowest, tolerance)
        if not contacts and surfaces and self._bottom_hidden(mine, surfaces[0][0], footing, around):
            contacts = _first_below(footing, surfaces, surfaces[0][0], tolerance)
        return {("contact", thing, other): share for other, share in contacts.items()}

    @staticmethod
    def _bottom_hidden(mine: Shape, top: float, footing: Array, around: Surroundings) -> bool:
        drop = mine.lowest - top
        if not 0.0 < drop <= SETTLE_M:
            return False
        heights = np.arange(top + mine.voxel_size_m, mine.lowest, mine.voxel_size_m)
        if not len(heights):
            return True
        columns = np.concatenate([np.column_stack([footing, np.full(len(footing), z)]) for z in heights])
        return float(np.mean(~around.seen_free(columns))) >= HIDDEN_SHARE


def _first_below(
    footing: Array, surfaces: list[tuple[float, str, Array]], bottom: float, tolerance: float
) -> dict[str, float]:
    """Each footing column goes to the highest surface under it that is not above `bottom`; shares of those in reach."""
    free = np.ones(len(footing), bool)
    shares: dict[str, float] = {}
    for top, owner, inside in surfaces:
        if top > bottom + tolerance:
            continue
        mine = free & inside
        if mine.any():
            free &= ~mine
            if bottom - top <= tolerance:
                shares[owner] = shares.get(owner, 0.0) + float(mine.sum()) / len(footing)
    return shares


def _surfaces_under(mine: Shape, other: Shape, footing: Array) -> list[tuple[float, Array]]:
    """The upward surfaces of `other` at most SETTLE_M below the bottom of `mine`: height, and which columns they
    cover."""
    tolerance = CONTACT_MARGIN_M + mine.voxel_size_m
    up = other.facing_up
    near = (up[:, 2] <= mine.lowest + tolerance) & (up[:, 2] >= mine.lowest - SETTLE_M)
    low, high = mine.bounds
    near &= ((up[:, :2] >= low[:2] - SIDE_WINDOW_M) & (up[:, :2] <= high[:2] + SIDE_WINDOW_M)).all(axis=1)
    up = up[near]
    found: list[tuple[float, Array]] = []
    while len(up) >= 3:
        top = float(up[:, 2].max())
        level = up[:, 2] >= top - tolerance
        hull = kernels.convex_hull(up[level, :2].astype(np.float64))
        inside = kernels.points_inside(hull, footing, 0.5 * mine.voxel_size_m)
        if inside.any():
            found.append((float(np.median(up[level, 2])), inside))
        up = up[~level]
    return found


def _rise(over: Shape, under: Shape) -> tuple[float, Array, Array]:
    """Median over the common columns of (bottom of `over` − top of `under`), and a point on each side of the gap."""
    inside = kernels.points_inside(under.hull, over.bottoms[:, :2].astype(np.float64), 0.0)
    bottoms = over.bottoms[inside] if inside.any() else over.bottoms
    tops = under.facing_up
    common = kernels.points_inside(over.hull, tops[:, :2].astype(np.float64), 0.0)
    tops = tops[common] if common.any() else tops
    bottom, top = float(np.median(bottoms[:, 2])), float(np.median(tops[:, 2]))
    middle = bottoms[:, :2].mean(axis=0)
    return bottom - top, np.array([*middle, bottom]), np.array([*middle, top])


def _inside(a: Shape, b: Shape, whole_box: bool) -> tuple[float, float]:
    """Shares of a's footing and of a's voxels that lie in the interior of b.

    The footing is looked at a little above the bottom, where sides of b rise beside it; its top surface does not.
    """
    lift = min(1.5 * b.voxel_size_m, 0.5 * (a.highest - a.lowest))
    footing = np.column_stack([a.footing, np.full(len(a.footing), a.lowest + lift)])
    in_box = b.box.contains(footing, 0.5 * b.voxel_size_m)
    if not in_box.any():
        return 0.0, 0.0
    points = _some(a.points, MOST_INSIDE).astype(np.float64)
    voxels = b.box.contains(points, 0.5 * b.voxel_size_m)
    if not whole_box:
        in_box[in_box] = _enclosed(footing[in_box], b)
        if in_box.any():
            voxels[voxels] = _enclosed(points[voxels], b)
    return float(in_box.mean()), float(voxels.mean())


def _enclosed(points: Array, b: Shape) -> Array:
    """(N,) bool: points that b's material closes in at least 4 of the directions ±x, ±y, −z of b's box."""
    box = b.box
    chosen = np.linspace(0, len(points) - 1, min(len(points), MOST_INSIDE)).astype(np.int64)
    local = (points[chosen] - box.center) @ box.rotation
    material = (_some(b.points, MOST_MATERIAL) - box.center) @ box.rotation
    closed = (
        columns.closed_sides(local, material, 0.75 * b.voxel_size_m * max(1.0, (len(b.points) / MOST_MATERIAL) ** 0.5))
        >= 4
    )
    nearest = np.searchsorted(chosen, np.arange(len(points))).clip(max=len(chosen) - 1)
    return np.asarray(closed[nearest])


def _some(points: Array, most: int) -> Array:
    """At most `most` of the points, evenly chosen."""
    return points if len(points) <= most else points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _bounds_gap(a: tuple[Array, Array], b: tuple[Array, Array]) -> float:
    apart = np.maximum(np.maximum(a[0] - b[1], b[0] - a[1]), 0.0)
    return float(np.sqrt((apart**2).sum()))
