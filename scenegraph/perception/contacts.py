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

from mapping.kernels import shapes as kernels
from scenegraph.graph import Box
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Level: TypeAlias = tuple[str, float] | None
"""A floor or ceiling: its node id and height [m]."""

CONTACT_MARGIN_M = 0.03
"""Two surfaces this close, and a voxel more, may touch (`contact_margin` in the rules)."""
SIDE_WINDOW_M = 0.35
"""How far around a thing the surface below it is looked at, to complete what the thing itself hides."""
SETTLE_M = 0.25
"""How far a thing whose bottom was not seen is completed downwards."""
HOVER_M = 0.15
"""What hangs or is fixed to a side is this far from what is below it: nearer, it may stand on what was not seen."""
HIDDEN_SHARE = 0.7
"""The space under a thing hides its bottom when this share of it was not seen to be free."""
FACE_SAMPLES = 7
"""Points along each edge of a side that look for what the side is fixed to."""
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
class Resting:
    """On what a thing rests, node id → share of its footing; the share of its footing that was seen; the height [m] at
    which it rests, and how far the next surface below is [m]."""

    shares: dict[str, float]
    footing_seen: float
    level: float
    drop: float

    @property
    def hovers(self) -> bool:
        """Whether nothing near below may carry it, seen or not."""
        return self.drop > HOVER_M


def tolerance(thing: Shape) -> float:
    """How close is in contact, for surfaces that are known no better than a voxel [m]."""
    return CONTACT_MARGIN_M + thing.voxel_size_m


def resting(mine: Shape, others: Mapping[str, Shape], floor: Level, seen_free: Callable[[Array], Array]) -> Resting:
    """Share of the footing under which the first other material downwards, within contact, belongs to each thing.

    A thing of which the lowest part was not seen is completed straight down to what is below it, where the space
    between was not seen to be free.
    """
    footing = mine.footing
    surfaces = _surfaces_under(mine, others, footing, floor)
    shares = _first_below(footing, surfaces, mine.lowest, tolerance(mine))
    if shares or not surfaces or not _bottom_hidden(mine, surfaces[0][0], footing, seen_free):
        drop = min(
            (mine.lowest - top for top, _, _ in surfaces if top <= mine.lowest + tolerance(mine)), default=np.inf
        )
        return Resting(shares, 1.0, mine.lowest, drop)
    level = surfaces[0][0]
    return Resting(_first_below(footing, surfaces, level, tolerance(mine)), 0.0, level, 0.0)


def hanging(mine: Shape, others: Mapping[str, Shape], ceiling: Level) -> dict[str, float]:
    """Share of the top 5 cm over which the first other material upwards, within contact, belongs to each thing."""
    turned = mine.upside_down
    upon = None if ceiling is None else (ceiling[0], -ceiling[1])
    over = {name: other.upside_down for name, other in others.items() if other.lowest <= mine.highest + tolerance(mine)}
    head = mine.head
    return _first_below(head, _surfaces_under(turned, over, head, upon), turned.lowest, tolerance(mine))


def fixed(mine: Shape, others: Mapping[str, Shape], walls: Iterable[Wall]) -> dict[str, float]:
    """Share of the side that faces each thing and each wall, and that lies in contact with it."""
    reach = tolerance(mine)
    sides = _sides(mine.box, reach)
    found: dict[str, float] = {}
    for wall in walls:
        off = np.abs(sides[:, :, :2] @ wall.normal - wall.offset)
        at = sides[:, :, :2] @ wall.along
        beside = (at >= wall.start - WALL_END_M) & (at <= wall.end + WALL_END_M)
        beside &= (sides[:, :, 2] >= wall.low - WALL_END_M) & (sides[:, :, 2] <= wall.high + WALL_END_M)
        found[wall.node] = float(((off <= reach) & beside).mean(axis=1).max())
    low, high = mine.bounds
    for name, other in others.items():
        near = ((other.points >= low - reach) & (other.points <= high + reach)).all(axis=1)
        points = other.points[near].astype(np.float64)
        if len(points):
            apart = np.linalg.norm(sides[:, :, None] - points[None, None], axis=3).min(axis=2)
            found[name] = float((apart <= reach).mean(axis=1).max())
    return {name: share for name, share in found.items() if share > 0.0}


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
    mine: Shape, others: Mapping[str, Shape], footing: Array, floor: Level
) -> list[tuple[float, str, Array]]:
    """The surfaces that may carry columns of the footing, highest first: height, whose, and which columns it covers."""
    surfaces = [] if floor is None else [(floor[1], floor[0], np.ones(len(footing), bool))]
    for name, other in others.items():
        surfaces += [(top, name, inside) for top, inside in _levels_under(mine, other, footing)]
    return sorted(surfaces, key=lambda s: (-s[0], s[1]))


def _levels_under(mine: Shape, other: Shape, footing: Array) -> list[tuple[float, Array]]:
    """The upward surfaces of `other` at most SETTLE_M below the bottom of `mine`: height, and which columns they
    cover."""
    reach = tolerance(mine)
    up = other.facing_up
    near = (up[:, 2] <= mine.lowest + reach) & (up[:, 2] >= mine.lowest - SETTLE_M)
    low, high = mine.bounds
    near &= ((up[:, :2] >= low[:2] - SIDE_WINDOW_M) & (up[:, :2] <= high[:2] + SIDE_WINDOW_M)).all(axis=1)
    up = up[near]
    found: list[tuple[float, Array]] = []
    while len(up) >= 3:
        top = float(up[:, 2].max())
        level = up[:, 2] >= top - reach
        hull = kernels.convex_hull(up[level, :2].astype(np.float64))
        inside = kernels.points_inside(hull, footing, 0.5 * mine.voxel_size_m)
        if inside.any():
            found.append((float(np.median(up[level, 2])), inside))
        up = up[~level]
    return found


def _bottom_hidden(mine: Shape, top: float, footing: Array, seen_free: Callable[[Array], Array]) -> bool:
    drop = mine.lowest - top
    if not 0.0 < drop <= SETTLE_M:
        return False
    heights = np.arange(top + mine.voxel_size_m, mine.lowest, mine.voxel_size_m)
    if not len(heights):
        return True
    columns = np.concatenate([np.column_stack([footing, np.full(len(footing), z)]) for z in heights])
    return float(np.mean(~seen_free(columns))) >= HIDDEN_SHARE
