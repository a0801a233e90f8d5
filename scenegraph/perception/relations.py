"""Measurements between things: the numbers from which `rules/spatial.pl` decides what is on, in, near or above what.

Definitions are those of the project's relations document; nothing here compares a number with a relation's threshold. A
pair that is too far apart to matter is not measured, and the rules read a missing measurement as *no*.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import shapes as kernels
from scenegraph.perception.contacts import (
    BACK_M,
    CONTACT_MARGIN_M,
    FIRM_SHARE,
    HOVER_M,
    MOST_INSIDE,
    Side,
    Wall,
    clear_below,
    enclosed,
    fixed,
    hanging,
    housed,
    lift,
    resting,
    settled,
    some,
    tolerance,
)
from scenegraph.perception.footprints import DEEPEST_M, HOUSED_SHARE, SQUARE, completed, house_of
from scenegraph.perception.lines import Lines
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Pair: TypeAlias = tuple[str, str]

FAR_M = 1.5
"""Beyond this distance nothing is near anything (`near_most` in the rules)."""
HOLDING_SHARE = 0.2
CLEAR_SHARE = 0.5
"""What has no more of its top or of a side in contact does not hang there, nor has what may have something under more
of its footing: it stands on what is below it (`side_share` and `clear_share` in the rules)."""
CONTACTS = ("contact", "drop", "top_contact", "side_contact", "clear_below")
SAMPLED_VOXELS = 1.0
"""The nearest points of two surfaces, one a voxel each, lie this far apart along them, in voxels, in the median."""
NO_PATH_M = 1.0e9
MOST_COLUMNS = 40


Passage: TypeAlias = Literal["clear", "blocked", "unseen"]


class Surroundings(Protocol):
    """What relations ask of the building and of space."""

    def floor_below(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The floor under a point: its node id and height [m]."""

    def ceiling_above(self, x: float, y: float, z: float) -> tuple[str, float] | None:
        """The ceiling over a point: its node id and height [m]."""

    def walls_beside(self, low: Array, high: Array) -> list[Wall]:
        """The walls whose bounds meet the box from corner `low` to `high` (3,)."""

    def storey(self, z: float) -> int | None:
        """The number of the storey that a height lies in; None where no floor is known."""

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
    near_m: between which bounds [m] the rules say how near is near: half the sum of the longer sides
    """

    def __init__(self, is_container: Callable[[str], bool], near_m: tuple[float, float] = (0.5, 1.5)) -> None:
        self._is_container = is_container
        self._near_m = near_m
        self._index = GroundIndex()
        self._lines = Lines()
        self._footprints: dict[str, tuple[Shape, Shape, Array]] = {}
        self._facts: dict[tuple[str, ...], float] = {}
        self._keys_of: defaultdict[str, set[tuple[str, ...]]] = defaultdict(set)

    def update(
        self, shapes: Mapping[str, Shape], labels: Mapping[str, str], reshaped: Iterable[str], around: Surroundings
    ) -> MeasurementChange:
        """Measure anew everything that involves a reshaped thing; ids that are no longer in `shapes` are forgotten."""
        reshaped = set(reshaped)
        around_lines = self._move(reshaped, shapes)
        fresh: dict[tuple[str, ...], float] = {}
        stale: set[tuple[str, ...]] = set()
        resettled = reshaped & shapes.keys()
        footprints = cache(lambda thing: self._footprint(thing, shapes, around))
        for thing in reshaped:
            for key in self._keys_of[thing]:
                if key[0] in CONTACTS:
                    resettled |= {key[1]} & shapes.keys()
                    if key[1] not in reshaped and thing in shapes:
                        continue
                elif key[0] == "footprint_share" and thing in shapes:
                    continue
                stale.add(key)
        for thing in sorted(reshaped & shapes.keys()):
            mine = shapes[thing]
            fresh["longer_side", thing] = mine.box.size[0]
            fresh["lowest", thing] = mine.lowest
            fresh["highest", thing] = mine.highest
            for other in self._index.within(mine.bounds, FAR_M):
                if other == thing or (other in reshaped and other < thing):
                    continue
                self._measure_pair(thing, other, shapes, labels, around, footprints, fresh)
                if self._may_rest(other, thing, shapes):
                    resettled.add(other)
        for thing in sorted(resettled):
            stale |= {key for key in self._keys_of[thing] if key[0] in CONTACTS and key[1] == thing}
            fresh.update(self._contacts(thing, shapes, around))
        change = self._replace(stale, fresh)
        for thing in resettled:
            around_lines |= self._lines.of(thing)
        change.merge(self._look_between(around_lines, shapes))
        return change

    def _move(self, reshaped: set[str], shapes: Mapping[str, Shape]) -> set[Pair]:
        """Bring the index up to date; returns the pairs with a line that passes where things were or are now."""
        crossed: set[Pair] = set()
        for thing in reshaped:
            before = self._index.bounds(thing)
            if before is not None:
                crossed |= self._lines.over(before)
            self._lines.forget(thing)
            if thing in shapes:
                self._index.put(thing, shapes[thing].bounds)
                crossed |= self._lines.over(shapes[thing].bounds)
            else:
                self._index.remove(thing)
                self._footprints.pop(thing, None)
        return crossed

    def _may_rest(self, other: str, thing: str, shapes: Mapping[str, Shape]) -> bool:
        """Whether what `other` rests on, hangs from or is fixed to may have changed with `thing`."""
        mine, theirs = shapes[thing], shapes[other]
        apart = _ground_gap(mine.bounds, theirs.bounds)
        if apart > max(BACK_M, tolerance(mine)):
            return False
        firm = any(
            key[0] == "contact" and key[1] == other and self._facts[key] >= FIRM_SHARE for key in self._keys_of[other]
        )
        if not firm:
            return apart <= BACK_M  # what is about it was hardly seen: it may have been by now
        return apart <= tolerance(mine) and theirs.lowest >= mine.lowest - 0.1

    def _look_between(self, pairs: set[Pair], shapes: Mapping[str, Shape]) -> MeasurementChange:
        """Note how many things stand between the things of each pair, where both rest on the same."""
        fresh: dict[tuple[str, ...], float] = {}
        for pair in sorted(pairs):
            one, two = (
                {k[2] if k[2] in shapes else "floor" for k in self._keys_of[x] if k[0] == "contact" and k[1] == x}
                for x in pair
            )
            count = self._between(pair, one & two, shapes) if one & two else 0
            if count:
                fresh["things_between", *pair] = count
        return self._replace({("things_between", *pair) for pair in pairs}, fresh)

    def _between(self, pair: Pair, supports: set[str], shapes: Mapping[str, Shape]) -> int:
        levels = {thing: self._facts["rest_level", thing] for thing in pair}
        return self._lines.between(pair, supports, levels, shapes, self._index.within)

    def between(self, things: Iterable[str]) -> dict[tuple[str, ...], float]:
        """All that was measured between these things and others; not in which rooms they lie."""
        return {key: self._facts[key] for key in self._pair_keys(things)}

    def keep(
        self, before: Mapping[tuple[str, ...], float], things: Iterable[str], same: Callable[[str, str], bool]
    ) -> MeasurementChange:
        """Take back what has been measured anew between these things and others where nothing has changed between the
        two, in favour of what `between` gave before."""
        stale = {key for key in self._pair_keys(things) if same(key[1], key[2])}
        return self._replace(stale, {key: value for key, value in before.items() if same(key[1], key[2])})

    def _pair_keys(self, things: Iterable[str]) -> set[tuple[str, ...]]:
        keys = {key for thing in things for key in self._keys_of.get(thing, ())}
        return {key for key in keys if len(key) == 3 and key[0] != "footprint_share"}

    def rooms_of(self, thing: str) -> set[str]:
        """The rooms in which a share of its footprint lies."""
        return {key[2] for key in self._keys_of.get(thing, ()) if key[0] == "footprint_share" and key[1] == thing}

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
        lines = [["line", *row] for row in self._lines.document()]
        return [[*key, value] for key, value in self._facts.items()] + lines

    def restore(self, document: list[list[Any]], shapes: Mapping[str, Shape]) -> None:
        """Take over what `document` gave."""
        self._lines.restore(row[1:] for row in document if row[0] == "line")
        self._replace(set(), {tuple(row[:-1]): row[-1] for row in document if row[0] != "line"})
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
        footprints: Callable[[str], Array],
        fresh: dict[tuple[str, ...], float],
    ) -> None:
        a, b = min(one, two), max(one, two)
        shape_a, shape_b = shapes[a], shapes[b]
        if _bounds_gap(shape_a.bounds, shape_b.bounds) <= FAR_M:
            reach, p, q = shape_a.distance_m(shape_b)
            if reach <= FAR_M:
                apart = 0.5 * SAMPLED_VOXELS * (shape_a.voxel_size_m + shape_b.voxel_size_m)
                fresh["gap", a, b] = gap = float(np.sqrt(max(0.0, reach * reach - apart * apart)))
                upper = lower = gap  # where this is too far already, the way around is not looked for
                least, most = self._near_m
                near = min(most, max(least, 0.5 * float(shape_a.box.size[0] + shape_b.box.size[0])))
                passage = around.between(p, q) if 0.0 < gap <= near else "clear"
                if passage != "clear":
                    upper, lower = around.way_around(p, q, FAR_M)
                if passage == "unseen":
                    lower = gap
                fresh["path_gap_upper", a, b] = min(upper, NO_PATH_M)
                fresh["path_gap_lower", a, b] = min(lower, NO_PATH_M)
                if upper <= near:
                    self._lines.put((a, b), *shape_a.line_to(shape_b, reach, p, q))
        beside = _ground_gap(shape_a.bounds, shape_b.bounds) <= DEEPEST_M
        overlap = _overlap(footprints(a), footprints(b)) if beside else 0.0
        if overlap > 0.0:
            fresh["footprint_overlap", a, b] = min(1.0, overlap)
            for upper_thing, lower_thing in ((a, b), (b, a)):
                self._measure_over(upper_thing, lower_thing, shapes, labels, around, fresh)

    def _footprint(self, thing: str, shapes: Mapping[str, Shape], around: Surroundings) -> Array:
        """The ground that a thing covers, completed where it stands within another; measured anew with either."""
        mine = shapes[thing]
        beside = {o: shapes[o] for o in self._index.within(mine.bounds, 0.0) if o != thing}
        house = house_of(mine, beside)
        if house is None:
            return mine.hull
        known = self._footprints.get(thing)
        if known is None or known[0] is not mine or known[1] is not shapes[house]:
            known = mine, shapes[house], completed(mine, shapes[house].box, around.seen_free)
            self._footprints[thing] = known
        return known[2]

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
        rise, p, q = _rise(over, under, lambda top: self._reaches(a, b, top, shapes, labels), around.seen_free)
        fresh["rise", a, b] = rise
        if rise > CONTACT_MARGIN_M:
            fresh["structure_between", a, b] = float(around.between(p, q) == "blocked")
            storeys = around.storey(over.lowest), around.storey(under.lowest)
            if None not in storeys and storeys[0] != storeys[1]:
                fresh["same_storey", a, b] = 0.0
        footing_inside, voxels_inside = _inside(over, under, self._is_container(labels[b]))
        if footing_inside > 0.0:
            fresh["footing_inside", a, b] = footing_inside
            fresh["voxels_inside", a, b] = voxels_inside

    def _reaches(self, a: str, b: str, top: float, shapes: Mapping[str, Shape], labels: Mapping[str, str]) -> float:
        """Height [m] down to which a may reach over the surface of b at height `top`: in a vessel that stands on b the
        sides hide where a ends, and it is taken to be about as tall as broad, no lower than the vessel."""
        over = shapes[a]
        lowest = over.lowest
        tall = min(lowest, over.highest - SQUARE * float(over.box.size[0]))
        for vessel in self._index.within(over.bounds, 0.0):
            sides = shapes[vessel]
            if vessel in (a, b) or not top - tolerance(sides) <= sides.lowest < lowest < sides.highest:
                continue
            if _inside(over, sides, self._is_container(labels[vessel]))[0] >= HOUSED_SHARE:
                lowest = min(lowest, max(tall, sides.lowest))
        return lowest

    # -- contact ------------------------------------------------------------------------------------------
    def _contacts(self, thing: str, shapes: Mapping[str, Shape], around: Surroundings) -> dict[tuple[str, ...], float]:
        """What the thing rests on; and what it hangs from or is fixed to, when it rests on nothing firmly."""
        mine = shapes[thing]
        low, high = mine.bounds
        x, y = (0.5 * (low + high)[:2]).tolist()
        reach = tolerance(mine)
        beside = {other: shapes[other] for other in self._index.within(mine.bounds, reach) if other != thing}
        under = {o: s for o, s in beside.items() if _ground_gap(s.bounds, mine.bounds) <= 0.0}
        floor = around.floor_below(x, y, mine.lowest)
        rest = resting(mine, under, floor, around.seen_free)
        found: dict[tuple[str, ...], float] = {}
        held = False
        if not rest.firmly:
            below = housed(mine, under, around.seen_free) or settled(mine, under, floor, around.seen_free)
            if rest.hovers and (below is None or mine.lowest - below.level > HOVER_M):
                ceiling = around.ceiling_above(x, y, mine.highest)
                walls = around.walls_beside(low - BACK_M, high + BACK_M)
                tops = hanging(mine, under, ceiling)
                sides = fixed(mine, beside, walls, around.seen_free)
                found.update({("top_contact", thing, o): share for o, share in tops.items()})
                found.update({("side_contact", thing, o): side.share for o, side in sides.items()})
                for other in sorted(o for o in tops.keys() | sides.keys() if _share(o, tops, sides) >= HOLDING_SHARE):
                    clear = clear_below(mine, sides.get(other), around.seen_free)
                    found["clear_below", thing, other] = clear
                    held |= clear >= CLEAR_SHARE
            if below is not None and not held:
                rest = below
        found.update({("drop", thing, o): drop for o, drop in rest.drops.items() if o in shapes})
        found.update({("contact", thing, o): share for o, share in rest.shares.items()})
        found["footing_seen", thing] = rest.footing_seen
        found["rest_level", thing] = rest.level
        return found


def _share(other: str, tops: Mapping[str, float], sides: Mapping[str, Side]) -> float:
    """The larger of the shares of a thing's top and of a side that lie in contact with another."""
    return max(tops.get(other, 0.0), sides[other].share if other in sides else 0.0)


def _rise(
    over: Shape, under: Shape, reaches: Callable[[float], float], seen_free: Callable[[Array], Array]
) -> tuple[float, Array, Array]:
    """Median over the common columns of (bottom of `over` − top of `under`), and a point on each side of the gap.

    Of many columns only the top was seen: they go down to where space was seen to be free, or to the height that
    `over` reaches above a surface at a height.
    """
    inside = kernels.points_inside(under.hull, over.bottoms[:, :2].astype(np.float64), 0.0)
    bottoms = some(over.bottoms[inside] if inside.any() else over.bottoms, MOST_COLUMNS).astype(np.float64)
    common = kernels.points_inside(over.hull, under.tops[:, :2].astype(np.float64), 0.0)
    tops = under.tops[common] if common.any() else under.tops
    top, middle = kernels.median(tops[:, 2]), bottoms[:, :2].mean(axis=0)
    if kernels.median(bottoms[:, 2]) - top > CONTACT_MARGIN_M:
        bottoms[:, 2] = _completed(bottoms, reaches(top), over.voxel_size_m, seen_free)
    bottom = kernels.median(bottoms[:, 2])
    return bottom - top, np.array([*middle, bottom]), np.array([*middle, top])


def _completed(bottoms: Array, lowest: float, voxel_size_m: float, seen_free: Callable[[Array], Array]) -> Array:
    """(C,) heights down to which columns with these lowest points (C, 3) may go: no seen free space is on the way."""
    steps = np.arange(lowest, float(bottoms[:, 2].max()), 2.0 * voxel_size_m)[::-1]
    if not len(steps):
        return bottoms[:, 2]
    at = np.concatenate([np.column_stack([bottoms[:, :2], np.full(len(bottoms), z)]) for z in steps])
    free = seen_free(at).reshape(len(steps), len(bottoms)) & (steps[:, None] < bottoms[:, 2] - voxel_size_m)
    first = free.argmax(axis=0)
    return np.where(free.any(axis=0), np.minimum(steps[first] + 2.0 * voxel_size_m, bottoms[:, 2]), lowest)


def _inside(a: Shape, b: Shape, whole_box: bool) -> tuple[float, float]:
    """Shares of a's footing and of a's voxels that lie in the interior of b.

    The footing is looked at a little above the bottom, where sides of b rise beside it; its top surface does not.
    """
    footing = np.column_stack([a.footing, np.full(len(a.footing), a.lowest + lift(a, b))])
    in_box = b.box.contains(footing, 0.5 * b.voxel_size_m)
    if not in_box.any():
        return 0.0, 0.0
    points = some(a.points, MOST_INSIDE).astype(np.float64)
    voxels = b.box.contains(points, 0.5 * b.voxel_size_m)
    if not whole_box:
        in_box[in_box] = enclosed(footing[in_box], b)
        if in_box.any():
            voxels[voxels] = enclosed(points[voxels], b)
    return float(in_box.mean()), float(voxels.mean())


def _overlap(a: Array, b: Array) -> float:
    """Area common to two convex footprints, as a share of the smaller."""
    if len(a) < 3 or len(b) < 3:
        return 0.0
    smaller = min(abs(kernels.polygon_area(a)), abs(kernels.polygon_area(b)))
    return float(kernels.overlap_area(a, b)) / smaller if smaller > 0.0 else 0.0


def _ground_gap(a: tuple[Array, Array], b: tuple[Array, Array]) -> float:
    return float(np.maximum(a[0] - b[1], b[0] - a[1])[:2].max())


def _bounds_gap(a: tuple[Array, Array], b: tuple[Array, Array]) -> float:
    apart = np.maximum(np.maximum(a[0] - b[1], b[0] - a[1]), 0.0)
    return float(np.sqrt((apart**2).sum()))
