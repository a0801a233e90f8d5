"""Boxes → measurements: gaps and clear ways, what lies over, under and in what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import box_grid, box_pairs
from scenegraph.relating.things import OBJECT, Things
from scenegraph.relating.thresholds import Thresholds

__all__ = ["OVER_REACH_M", "Measured", "Scope", "measure"]

Array = NDArray[Any]

OVER_REACH_M = 4.0
"""Nothing is above what lies more than a storey below it."""
INSET_M = 0.06
"""The way between two things begins and ends this far from them: a picture's box reaches into the wall it hangs on."""
FOOTING_HEIGHT_M = 0.03
"""Columns whose lowest point lies within this of a tilted box's lowest carry it."""
DIGITS = 4
"""Measurements are rounded to a tenth of a millimetre, as all are that the rules are told."""
_CELL_M = np.array([1.5, 1.5, 4.0])
_ROOM_CELL_M = np.array([4.0, 4.0, 4.0])


@dataclass(frozen=True)
class Scope:
    """Which things are measured, by row.

    whole  : (n,) bool, the objects that are measured with all that is near them
    placed : (n,) bool, the objects of which it is measured on what they stand and in which room they are
    """

    whole: Array
    placed: Array


@dataclass(frozen=True)
class Measured:
    """Measurements of things, which are named by their rows.

    lowest : (n,) lowest point of every thing [m];  longer_side : (n,) of its footprint [m]
    rank   : (n,) place of its id in alphabetical order, which decides ties
    pairs  : (m, 2) things near or over each other, with their gap [m] (inf: far), whether the way between is clear,
        footprint_overlap, rise (m, 2) of the first over the second and the second over the first [m], whether structure
        lies between the upper and the lower, and whether both are on the same storey
    standing : (k, 2) upper and lower, with contact (k,)
    inside   : (j, 2) thing and container, with footing_inside (j,) and voxels_inside (j,)
    rooms    : (r, 2) thing and room, with footprint_share (r,)
    """

    things: Things
    lowest: Array
    longer_side: Array
    rank: Array
    pairs: Array
    gap: Array
    clear: Array
    footprint_overlap: Array
    rise: Array
    structure_between: Array
    same_storey: Array
    standing: Array
    contact: Array
    inside: Array
    footing_inside: Array
    voxels_inside: Array
    rooms: Array
    footprint_share: Array


def measure(things: Things, thresholds: Thresholds, scope: Scope | None = None) -> Measured:
    """Measure what lies near each other, in the scope or all; what is too far apart to matter is not measured."""
    boxes, tolerance = things.boxes, thresholds.contact_gap
    low, high = boxes.low, boxes.high
    side = np.round(2.0 * boxes.rectangle[:, 4:].max(axis=1, initial=0.0), DIGITS)
    rank = np.empty(len(things), np.int64)
    rank[sorted(range(len(things)), key=things.ids.__getitem__)] = np.arange(len(things))
    reach = np.clip(0.5 * side, 0.5 * max(thresholds.near_least, tolerance), max(thresholds.near_most, tolerance))

    pairs = _pairs(things, reach, scope)
    gap, clear, overlap, between = box_pairs.measure_pairs(pairs, boxes, reach, INSET_M, _obstacles(things))
    counts = np.isfinite(gap) | (overlap > 0.0)
    pairs, gap, clear, overlap, between = (a[counts] for a in (pairs, gap, clear, overlap, between))
    a, b = pairs.T
    placed = np.flatnonzero((things.layer == OBJECT) if scope is None else scope.placed)
    standing, contact = _stand(things, placed, rank, tolerance)
    inside, footing, volume = box_pairs.inside_boxes(pairs, things.container, boxes, FOOTING_HEIGHT_M)
    if scope is not None:
        placed = np.union1d(placed, pairs[overlap > 0.0])
    rooms, share = _share_rooms(things, placed)
    return Measured(
        things=things,
        lowest=np.round(low[:, 2], DIGITS),
        longer_side=side,
        rank=rank,
        pairs=pairs,
        gap=np.round(gap, DIGITS),
        clear=clear,
        footprint_overlap=np.round(overlap, DIGITS),
        rise=np.round(np.stack([low[a, 2] - high[b, 2], low[b, 2] - high[a, 2]], axis=1), DIGITS),
        structure_between=between,
        same_storey=_same_storey(things, pairs, rooms, share, rank),
        standing=standing,
        contact=np.round(contact, DIGITS),
        inside=inside,
        footing_inside=np.round(footing, DIGITS),
        voxels_inside=np.round(volume, DIGITS),
        rooms=rooms,
        footprint_share=np.round(share, DIGITS),
    )


def _pairs(things: Things, reach: Array, scope: Scope | None) -> Array:
    """Rows (m, 2) of objects that may be near or over each other, each pair once; `reach` (n,) [m] of every thing."""
    objects = np.flatnonzero(things.layer == OBJECT)
    low = things.boxes.low[objects] - reach[objects, None]
    high = things.boxes.high[objects] + reach[objects, None]
    low[:, 2] = np.minimum(low[:, 2], things.boxes.low[objects, 2] - OVER_REACH_M)
    if scope is None:
        return np.asarray(objects[box_grid.meeting(low, high, low, high, _CELL_M, True)])
    whole = np.flatnonzero(scope.whole[objects])
    found = box_grid.meeting(low[whole], high[whole], low, high, _CELL_M, False)
    one, two = whole[found[:, 0]], found[:, 1]
    once = (one < two) | ((one > two) & ~scope.whole[objects[two]])
    return np.asarray(objects[np.stack([one[once], two[once]], axis=1)])


def _obstacles(things: Things) -> box_pairs.Obstacles:
    """The inner halves of walls and floors: what reaches a little into one is not behind it."""
    rows, boxes = np.flatnonzero(things.solid), things.boxes
    cores = boxes.half[rows]
    cores[np.arange(len(rows)), cores.argmin(axis=1)] *= 0.5
    return box_pairs.Obstacles(
        boxes.center[rows], cores, boxes.axes[rows], box_grid.fill_grid(boxes.low[rows], boxes.high[rows], _CELL_M)
    )


def _stand(things: Things, uppers: Array, rank: Array, tolerance: float) -> tuple[Array, Array]:
    """Upper and lower (k, 2) and contact (k,): what may lie below a thing is looked through column by column."""
    boxes = things.boxes
    carriers = np.flatnonzero((things.layer == OBJECT) | things.solid)
    low, high = boxes.low[uppers], boxes.high[uppers]
    high[:, 2] = low[:, 2] + tolerance
    low[:, 2] -= tolerance
    below = box_grid.meeting(low, high, boxes.low[carriers], boxes.high[carriers], _CELL_M, False)
    ends = np.stack([uppers[below[:, 0]], carriers[below[:, 1]]], axis=1)
    found: tuple[Array, Array] = box_pairs.stand(ends, rank, boxes, tolerance, FOOTING_HEIGHT_M)
    return found


def _share_rooms(things: Things, rows: Array) -> tuple[Array, Array]:
    """Thing and room (r, 2), and the share (r,) of the thing's ground projection that lies in the room's footprint."""
    rooms = np.fromiter(things.rings, np.int64, len(things.rings))
    if len(rooms) == 0:
        return np.empty((0, 2), np.int64), np.empty(0)
    boxes, rings = things.boxes, list(things.rings.values())
    low, high = boxes.low[rows], boxes.high[rows]
    low[:, 2] = high[:, 2] = boxes.center[rows, 2]
    starts = np.zeros(len(rings) + 1, np.int64)
    np.cumsum([len(ring) for ring in rings], out=starts[1:])
    corners = np.concatenate(rings)
    room_low, room_high = boxes.low[rooms], boxes.high[rooms]
    room_low[:, :2] = np.minimum.reduceat(corners, starts[:-1])
    room_high[:, :2] = np.maximum.reduceat(corners, starts[:-1])
    found = box_grid.meeting(low, high, room_low, room_high, _ROOM_CELL_M, False)
    found[:, 0] = rows[found[:, 0]]
    share = box_pairs.shares_in_polygons(found, boxes, starts, corners)
    some = share > 0.0
    found = found[some]
    return np.stack([found[:, 0], rooms[found[:, 1]]], axis=1), share[some]


def _same_storey(things: Things, pairs: Array, rooms: Array, share: Array, rank: Array) -> Array:
    """(m,) whether the rooms that hold most of two things reach over mostly the same heights; unknown counts as yes."""
    own = np.full(len(things), -1)
    order = np.lexsort((-rank[rooms[:, 1]], share))
    own[rooms[order, 0]] = rooms[order, 1]  # the largest share is written last
    one, two = own[pairs.T]
    low, high = things.boxes.low[:, 2], things.boxes.high[:, 2]
    common = np.minimum(high[one], high[two]) - np.maximum(low[one], low[two])
    lower = np.minimum(high[one] - low[one], high[two] - low[two])
    same: Array = (one < 0) | (two < 0) | (one == two) | (common >= 0.5 * lower)
    return same
