"""What carries a thing, what it hangs from and what it is fixed to: shares of its underside, its top and its sides that
meet the material of others.

A surface hides behind what stands on it, so surfaces are completed: the hull of what of them is seen around the thing,
at the height in question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import columns
from mapping.kernels import shapes as kernels
from scenegraph.graph import Box
from scenegraph.perception.footprints import house_of
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Level: TypeAlias = tuple[str, float] | None
"""A floor or ceiling: its node id and height [m]."""

CONTACT_MARGIN_M = 0.03
"""Two surfaces this close, and a voxel more, may touch (`contact_margin` in the rules)."""
SIDE_WINDOW_M = 0.35
"""How far around a thing the surface below it is looked at, to complete what the thing itself hides."""
SETTLE_M = 0.3
"""How far a thing whose bottom was not seen is completed downwards."""
FIRM_SHARE = 0.5
"""What rests on something with this share of its footing does not go down any further, neither hangs nor is fixed to a
side."""
HOVER_M = 0.2
"""What hangs or is fixed to a side is this far from what is below it: nearer, it stands on that, seen or not."""
HIDDEN_SHARE = 0.7
"""The space under a thing hides its bottom when this share of it was not seen to be free."""
FACE_SAMPLES = 7
"""Points along each edge of a side that look for what the side is fixed to."""
MOST_COLUMNS = 200
CLOSED_SIDES = 4
MOST_INSIDE = 300
MOST_MATERIAL = 8000
"""Points of a thing, and of what it may be in, that are looked at to see whether it is inside."""
BACK_M = 0.15
"""How far a thing whose back was not seen is completed to the wall behind it."""
CLEAR_M = 0.1
"""Space this close to what a thing is fixed to is filled by that: whether the thing has something below it is seen in
front."""
WALL_END_M = 0.1
"""A wall goes on this far beyond what was seen of it."""


@dataclass(frozen=True)
class Wall:
    """An upright plane: node id, normal (2,) into the room, its offset along it, and what it spans along (2,) and in
    height."""

    node: str
    normal: Array
    offset: float
    along: Array
    start: float
    end: float
    low: float
    high: float


@dataclass(frozen=True)
class Side:
    """What a side of a thing is fixed to: share of the side that is in contact, normal (2,) of the contact, into the
    thing, and its offset along that [m]."""

    share: float
    normal: Array
    offset: float


@dataclass(frozen=True)
class Resting:
    """On what a thing rests.

    shares        node id → share of its footing;  footing_seen  share of its footing that was seen
    level         height [m] at which it rests
    drops         node id → how far its surface is below that [m], where that is no farther than contact reaches
    hovers        whether no surface at all is so near below that it may carry it, seen or not
    """

    shares: dict[str, float]
    footing_seen: float
    level: float
    drops: dict[str, float]
    hovers: bool = False

    @property
    def firmly(self) -> bool:
        """Whether it goes down no further, and neither hangs nor is fixed to a side."""
        return sum(self.shares.values()) >= FIRM_SHARE


def tolerance(thing: Shape) -> float:
    """How close is in contact, for surfaces that are known no better than a voxel [m]."""
    return CONTACT_MARGIN_M + thing.voxel_size_m


def resting(mine: Shape, others: Mapping[str, Shape], floor: Level, seen_free: Callable[[Array], Array]) -> Resting:
    """Share of the footing under which the first other material downwards, within contact, belongs to each thing.

    A thing of which the lowest part was not seen is completed straight down to what is below it, where the space
    between was not seen to be free.
    """
    surfaces = _surfaces_under(mine, others, mine.footing, floor)
    rest = _resting_at(mine, mine.lowest, surfaces, 1.0)
    below = [top for top, _, _ in surfaces if top < mine.lowest - tolerance(mine)]
    if rest.firmly or not below or not _bottom_hidden(mine, below[0], mine.footing, seen_free):
        return rest
    return _resting_at(mine, below[0], surfaces, 0.0)


def housed(mine: Shape, others: Mapping[str, Shape], seen_free: Callable[[Array], Array]) -> Resting | None:
    """What a thing rests on that lies in the box of another, as on a shelf of which the board was not seen, where the
    space under it was not seen to be free; None where that is nothing."""
    name = house_of(mine, others)
    if name is None or not _bottom_hidden(mine, mine.lowest - tolerance(mine), mine.footing, seen_free):
        return None
    return Resting({name: 1.0}, 0.0, mine.lowest, {})


def settled(
    mine: Shape, others: Mapping[str, Shape], floor: Level, seen_free: Callable[[Array], Array]
) -> Resting | None:
    """What a thing rests on that nothing else holds: completed straight down to what carries it firmly there, if only
    some of the columns under it were not seen to be free, as where thin legs stand; None where that is nothing."""
    surfaces = _surfaces_under(mine, others, mine.footing, floor, np.inf)
    columns = some(mine.ground_samples, MOST_COLUMNS)
    reach = tolerance(mine)
    for top in [top for top, _, _ in surfaces if mine.lowest - SETTLE_M <= top <= mine.lowest + reach]:
        rest = _resting_at(mine, top, surfaces, 0.0)
        if rest.firmly:
            hidden = top >= mine.lowest - reach or _hidden(mine, top, columns, seen_free).all(axis=0).any()
            return rest if hidden else None
    return None


def _resting_at(mine: Shape, level: float, surfaces: list[tuple[float, str, Array]], seen: float) -> Resting:
    reach = tolerance(mine)
    shares = _first_below(mine.footing, surfaces, level, reach)
    drops = {owner: max(0.0, level - top) for top, owner, _ in reversed(surfaces) if abs(level - top) <= reach}
    hovers = not any(level - HOVER_M <= top <= level + reach for top, _, _ in surfaces)
    return Resting(shares, seen, level, drops, hovers)


def hanging(mine: Shape, others: Mapping[str, Shape], ceiling: Level) -> dict[str, float]:
    """Share of the top 5 cm over which the first other material upwards, within contact, belongs to each thing."""
    turned = mine.upside_down
    upon = None if ceiling is None else (ceiling[0], -ceiling[1])
    over = {name: other.upside_down for name, other in others.items() if other.lowest <= mine.highest + tolerance(mine)}
    head = mine.head
    return _first_below(head, _surfaces_under(turned, over, head, upon), turned.lowest, tolerance(mine))


def fixed(
    mine: Shape, others: Mapping[str, Shape], walls: Iterable[Wall], seen_free: Callable[[Array], Array]
) -> dict[str, Side]:
    """The side that faces each thing and each wall, where some of it lies in contact with it.

    The back of what stands before a wall was not seen: it is completed to the wall where the space between was not
    seen to be free.
    """
    reach = tolerance(mine)
    sides = _sides(mine.box, reach)
    found: dict[str, Side] = {}
    for wall in walls:
        if float(mine.box.center[:2] @ wall.normal) - wall.offset < -CONTACT_MARGIN_M:
            continue  # the far face of the wall
        off = sides[:, :, :2] @ wall.normal - wall.offset
        at = sides[:, :, :2] @ wall.along
        beside = (at >= wall.start - WALL_END_M) & (at <= wall.end + WALL_END_M)
        beside &= (sides[:, :, 2] >= wall.low - WALL_END_M) & (sides[:, :, 2] <= wall.high + WALL_END_M)
        close = (np.abs(off) <= reach) & beside
        behind = (off > reach) & (off <= BACK_M) & beside
        if behind.any():
            back = sides[behind].copy()
            back[:, :2] -= 0.5 * off[behind][:, None] * wall.normal
            close[behind] = ~seen_free(back)
        found[wall.node] = Side(float(close.mean(axis=1).max()), wall.normal, wall.offset)
    low, high = mine.bounds
    for name, other in others.items():
        near = ((other.points >= low - reach) & (other.points <= high + reach)).all(axis=1)
        points = other.points[near].astype(np.float64)
        if len(points):
            apart = np.linalg.norm(sides[:, :, None] - points[None, None], axis=3).min(axis=2)
            shares = (apart <= reach).mean(axis=1)
            middle = sides[shares.argmax()].mean(axis=0)[:2]
            inwards = mine.box.center[:2] - middle
            inwards /= max(float(np.linalg.norm(inwards)), 1e-9)
            found[name] = Side(float(shares.max()), inwards, float(middle @ inwards))
    return {name: side for name, side in found.items() if side.share > 0.0}


def clear_below(mine: Shape, side: Side | None, seen_free: Callable[[Array], Array]) -> float:
    """Share of the footing under which space was seen to be free, where something in contact would be.

    side : what the thing is fixed to; beside that, space is looked at CLEAR_M in front of it
    """
    columns = mine.footing
    if side is not None:
        inside = np.maximum(0.0, CLEAR_M + side.offset - columns @ side.normal)
        columns = columns + inside[:, None] * side.normal
    heights = mine.lowest - tolerance(mine) - np.array([0.0, mine.voxel_size_m])
    at = np.concatenate([np.column_stack([columns, np.full(len(columns), z)]) for z in heights])
    return float(seen_free(at).reshape(len(heights), -1).mean(axis=1).max())


def _sides(box: Box, narrow_m: float) -> Array:
    """(4 or 2, FACE_SAMPLES², 3) points spread over the sides of an upright box; the edge of a sheet is no side."""
    steps = (np.arange(FACE_SAMPLES) + 0.5) / FACE_SAMPLES - 0.5
    across, up = (grid.ravel() for grid in np.meshgrid(steps, steps))
    half = np.full(across.shape, 0.5)
    local = np.stack(
        [
            np.stack([half, across, up], axis=1), np.stack([-half, across, up], axis=1),
            np.stack([across, half, up], axis=1), np.stack([across, -half, up], axis=1),
        ]
    )  # fmt: skip
    length, width, _ = box.size
    kept = local[2:] if width < narrow_m <= length else local
    return np.asarray(kept * box.size @ box.rotation.T + box.center)


def _first_below(
    footing: Array, surfaces: list[tuple[float, str, Array]], bottom: float, reach: float
) -> dict[str, float]:
    """Each footing column goes to the highest surface under it that is not above `bottom`; shares of those in reach."""
    free = np.ones(len(footing), bool)
    shares: dict[str, float] = {}
    for top, owner, inside in surfaces:
        if top > bottom + reach:
            continue
        mine = free & inside
        if mine.any():
            free &= ~mine
            if bottom - top <= reach:
                shares[owner] = shares.get(owner, 0.0) + float(mine.sum()) / len(footing)
    return shares


def _surfaces_under(
    mine: Shape, others: Mapping[str, Shape], footing: Array, floor: Level, window_m: float = SIDE_WINDOW_M
) -> list[tuple[float, str, Array]]:
    """The surfaces that may carry columns of the footing, highest first: height, whose, and which columns it covers.

    window_m : how far around the thing they are looked at
    """
    surfaces = [] if floor is None else [(floor[1], floor[0], np.ones(len(footing), bool))]
    for name, other in others.items():
        surfaces += [(top, name, inside) for top, inside in _levels_under(mine, other, footing, window_m)]
        if 0.0 < mine.lowest - other.lowest <= SETTLE_M:
            bottom = _closed_in(mine, other, footing)
            surfaces += [(other.lowest, name, bottom)] if bottom.any() else []
    return sorted(surfaces, key=lambda s: (-s[0], s[1]))


def _closed_in(mine: Shape, other: Shape, footing: Array) -> Array:
    """(F,) bool: the columns of the footing that the sides of `other` close in: its bottom is below, seen or not."""
    if mine.lowest > other.highest:
        return np.zeros(len(footing), bool)
    start = np.column_stack([footing, np.full(len(footing), mine.lowest + lift(mine, other))])
    inside = other.box.contains(start, 0.5 * other.voxel_size_m)
    if inside.any():
        inside[inside] = enclosed(start[inside], other)
    return np.asarray(inside)


def lift(mine: Shape, other: Shape) -> float:
    """How far above its bottom a thing is looked at where sides of another rise beside it; its top surface does not."""
    return min(1.5 * other.voxel_size_m, 0.5 * (mine.highest - mine.lowest))


def enclosed(points: Array, b: Shape) -> Array:
    """(N,) bool: points that b's material closes in at least 4 of the directions ±x, ±y, −z of b's box."""
    box = b.box
    chosen = np.linspace(0, len(points) - 1, min(len(points), MOST_INSIDE)).astype(np.int64)
    local = (points[chosen] - box.center) @ box.rotation
    material = (some(b.points, MOST_MATERIAL) - box.center) @ box.rotation
    beside = 0.75 * b.voxel_size_m * max(1.0, (len(b.points) / MOST_MATERIAL) ** 0.5)
    closed = columns.closed_sides(local, material, beside) >= CLOSED_SIDES
    nearest = np.searchsorted(chosen, np.arange(len(points))).clip(max=len(chosen) - 1)
    return np.asarray(closed[nearest])


def some(points: Array, most: int) -> Array:
    """At most `most` of the points, evenly chosen."""
    return points if len(points) <= most else points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _levels_under(mine: Shape, other: Shape, footing: Array, window_m: float) -> list[tuple[float, Array]]:
    """The upward surfaces of `other` at most SETTLE_M below the bottom of `mine`: height, and which columns they
    cover."""
    reach = tolerance(mine)
    low, high = mine.bounds
    heights, covered = kernels.levels_under(
        other.facing_up, mine.lowest + reach, mine.lowest - SETTLE_M, low[:2] - window_m, high[:2] + window_m, reach,
        footing, 0.5 * mine.voxel_size_m,
    )  # fmt: skip
    return list(zip(heights.tolist(), covered, strict=True))


def _bottom_hidden(mine: Shape, top: float, footing: Array, seen_free: Callable[[Array], Array]) -> bool:
    if not 0.0 < mine.lowest - top <= SETTLE_M:
        return False
    hidden = _hidden(mine, top, footing, seen_free)
    return not hidden.size or float(hidden.mean()) >= HIDDEN_SHARE


def _hidden(mine: Shape, top: float, columns: Array, seen_free: Callable[[Array], Array]) -> Array:
    """(H, C) bool: where in columns (C, 2) from the bottom of `mine` down to `top` [m] space was not seen to be
    free."""
    heights = np.arange(top + mine.voxel_size_m, mine.lowest, mine.voxel_size_m)
    at = np.concatenate([np.tile(columns, (len(heights), 1)), np.repeat(heights, len(columns))[:, None]], axis=1)
    return ~seen_free(at).reshape(len(heights), len(columns)) if len(heights) else np.empty((0, len(columns)), bool)
