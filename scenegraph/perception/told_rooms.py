"""Rooms that an operator draws, splits, merges and deletes: mapping on leaves their ground as it was told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mapping.kernels import regions as kernels
from scenegraph.errors import InvalidStatement
from scenegraph.graph import GraphChanges, SceneGraph
from scenegraph.perception.rooms import LEAST_ROOM_M2, Rooms
from scenegraph.perception.storeys import CELL_M, Storey

Array: TypeAlias = NDArray[Any]

FARTHEST_DRAWN_M = 50.0
"""An operator draws rooms no farther than this from what was mapped: the ground grid is dense."""
APART_M = 0.5
"""Rooms that are merged lie no farther from each other than this: a wall may stand between them."""
REACH_M = 0.1
"""A cut belongs to the stretch of its line that it touches; this much beside it is forgiven."""


def draw(
    rooms: Rooms, name: str, polygon: list[Any], storey_id: str | None, graph: SceneGraph, stamp_ns: int
) -> tuple[GraphChanges, set[str]]:
    """A room with this outline (corners x, y [m]): mapping leaves its ground alone from now on.

    storey_id : the storey that it lies on; default: the lowest that was mapped there

    Returns the changes and the ids of the rooms that it touches. Raises `InvalidStatement`.
    """
    corners = _corners("room", polygon, "room(name, [[x, y], [x, y], [x, y], …])")
    outline = shapely.Polygon(corners) if len(corners) >= 3 else shapely.Polygon()
    if not outline.is_valid or outline.area < 0.1:
        raise InvalidStatement("room: expected corners [x, y] of a simple polygon of at least 0.1 m²")
    storey = _storey_for(rooms, corners, storey_id)
    _check_near("room", storey, corners)
    low, high = (np.floor(edge / CELL_M).astype(np.int64) for edge in (corners.min(axis=0), corners.max(axis=0)))
    window = storey.ground.cover(low, high)
    shape = storey.ground.room[window].shape
    xy = (np.argwhere(np.ones(shape, bool)) + low + 0.5) * CELL_M
    mine = shapely.contains_xy(outline, xy[:, 0], xy[:, 1]).reshape(shape)
    touched = np.unique(storey.ground.room[window][mine])
    number = rooms.new_number()
    rooms.outlined.add(number)
    storey.ground.room[window][mine] = number
    storey.ground.drawn[window][mine] = True
    changes = GraphChanges()
    for room in touched[touched > 0].tolist():
        _shrink(rooms, room, number, storey, graph, stamp_ns, changes)
    rooms.write(number, storey, np.argwhere(mine) + low, graph, stamp_ns, changes, name=name)
    return changes, {f"room_{n}" for n in touched.tolist() if n} | {f"room_{number}"}


def split(rooms: Rooms, room: str, line: list[Any], graph: SceneGraph, stamp_ns: int) -> tuple[GraphChanges, set[str]]:
    """Cut a room along the line through two points [x, y], from wall to wall; the larger part stays what it was.

    Only the stretch of the line that the points touch cuts, so that a room round a corner keeps its far wing. Returns
    the changes and the ids of the rooms. Raises `InvalidStatement`.
    """
    ends = _corners("split", line, "split(room_1, [[x, y], [x, y]])")
    if len(ends) != 2 or np.hypot(*(ends[1] - ends[0])) < CELL_M:
        raise InvalidStatement("split: expected two different points [x, y]", hint="split(room_1, [[x, y], [x, y]])")
    number, storey = _known(rooms, "split", room, graph)
    _check_near("split", storey, ends)
    cells = rooms.floor_of(number, storey)
    low = cells.min(axis=0) - 1
    floor = np.zeros(cells.max(axis=0) - low + 2, bool)
    floor[tuple((cells - low).T)] = True
    cut = np.zeros_like(floor)
    for stretch in _stretches(rooms.footprints[room], ends):
        kernels.draw_segment(cut, *((shapely.get_coordinates(stretch) / CELL_M - low).ravel()))
    parts, n = ndimage.label(floor & ~cut)
    sizes = np.bincount(parts.ravel(), minlength=n + 1)[1:]
    large = np.flatnonzero(sizes * CELL_M**2 >= LEAST_ROOM_M2) + 1
    if len(large) < 2:
        raise InvalidStatement(
            f"split: the line does not cut {room} into two parts of at least {LEAST_ROOM_M2:g} m²",
            hint="both points lie in the room, or the line between them crosses it",
        )
    parts = np.where(np.isin(parts, large), parts, 0).astype(np.int32)
    kernels.flood(parts, floor)
    order = sorted(large.tolist(), key=lambda part: -sizes[part - 1])
    numbers = {part: number if part == order[0] else rooms.new_number() for part in order}
    _deal_out(rooms, storey, number, parts, numbers, low)
    changes = GraphChanges()
    for part, its in numbers.items():
        rooms.write(its, storey, np.argwhere(parts == part) + low, graph, stamp_ns, changes)
    return changes, {f"room_{its}" for its in numbers.values()}


def merge(rooms: Rooms, kept: str, lost: str, graph: SceneGraph, stamp_ns: int) -> tuple[GraphChanges, set[str]]:
    """Make two rooms beside each other one, with what lies between them. Raises `InvalidStatement`."""
    if kept == lost:
        raise InvalidStatement(f"merge: {kept} is given twice")
    layers = graph.node(kept).layer, graph.node(lost).layer
    if layers != ("room", "room"):
        raise InvalidStatement(
            f"merge: {kept} is a node of layer {layers[0]!r}, {lost} of layer {layers[1]!r}",
            hint="things are merged with things, rooms with rooms",
        )
    number, storey = _known(rooms, "merge", kept, graph)
    other, its_storey = _known(rooms, "merge", lost, graph)
    apart = rooms.footprints[kept].distance(rooms.footprints[lost])
    if storey is not its_storey or apart > APART_M:
        where = "on different storeys" if storey is not its_storey else f"{apart:.1f} m apart"
        raise InvalidStatement(f"merge: {kept} and {lost} lie {where}", hint="rooms that are merged share a border")
    cells = np.concatenate([rooms.floor_of(number, storey), rooms.floor_of(other, storey)])
    steps = round(APART_M / CELL_M)
    low, high = cells.min(axis=0) - steps, cells.max(axis=0) + steps
    window = storey.ground.cover(low, high)
    floor = np.zeros(storey.ground.room[window].shape, bool)
    floor[tuple((cells - low).T)] = True
    between = ndimage.binary_closing(floor, np.ones((3, 3), bool), iterations=(steps + 1) // 2)
    between &= np.isin(storey.ground.room[window], (0, number, other))
    floor |= between
    owned = floor | np.isin(storey.ground.room[window], (number, other))
    storey.ground.room[window][owned] = number
    storey.ground.drawn[window] |= owned
    rooms.outlined -= {number, other}
    changes = GraphChanges()
    rooms.footprints.pop(lost)
    rooms.write(number, storey, np.argwhere(floor) + low, graph, stamp_ns, changes)
    changes.delete_node(lost, "an operator merged it with another room", became=kept)
    return changes, {kept, lost}


def delete(rooms: Rooms, room: str, reason: str, graph: SceneGraph) -> tuple[GraphChanges, set[str]]:
    """Take a room out: its ground is no room's from now on, until an operator draws one there."""
    changes = GraphChanges()
    changes.delete_node(room, reason)
    if rooms.footprints.pop(room, None) is not None:
        number = int(room.removeprefix("room_"))
        rooms.outlined.discard(number)
        for storey in rooms.storeys:
            given_up = storey.ground.room == number
            storey.ground.room[given_up] = 0
            storey.ground.drawn |= given_up
    return changes, {room}


def _corners(form: str, points: Any, hint: str) -> Array:
    """Points (N, 2) [m]. Raises `InvalidStatement`."""
    try:
        corners = np.array(points, dtype=np.float64)
        if corners.shape[1:] != (2,) or not np.isfinite(corners).all():
            raise ValueError("expected finite points [x, y]")
    except (ValueError, TypeError, OverflowError) as error:
        raise InvalidStatement(f"{form}: these are no points ({error})", hint=hint) from None
    return corners


def _known(rooms: Rooms, form: str, room: str, graph: SceneGraph) -> tuple[int, Storey]:
    """The number and the storey of a room. Raises `UnknownNode` and `InvalidStatement`."""
    node = graph.node(room)
    if node.layer != "room" or room not in rooms.footprints:
        raise InvalidStatement(f"{form}: {room} is no room that was mapped or drawn")
    number = int(room.removeprefix("room_"))
    storey: Storey = rooms.storeys[int(node.attributes["storey"]) - 1]
    if not len(rooms.floor_of(number, storey)):
        raise InvalidStatement(f"{form}: {room} has no ground left")
    return number, storey


def _storey_for(rooms: Rooms, corners: Array, storey_id: str | None) -> Storey:
    if not rooms.storeys:
        raise InvalidStatement(
            "room: no floor has been mapped yet", hint="a room lies on a storey; map some floor first"
        )
    by_height: Sequence[Storey] = sorted(rooms.storeys, key=lambda s: s.floor_z)
    if storey_id is not None:
        named = [s for s in by_height if s.id == storey_id]
        if not named:
            raise InvalidStatement(
                f"room: {storey_id!r} is no storey", hint=f"one of {', '.join(s.id for s in by_height)}"
            )
        return named[0]
    mapped = [s for s in by_height if s.ground.at(corners).any() or s.ground.at(corners.mean(axis=0)[None]).any()]
    return (mapped or by_height)[0]


def _check_near(form: str, storey: Storey, corners: Array) -> None:
    low, high = storey.ground.low * CELL_M, (storey.ground.low + storey.ground.free.shape) * CELL_M
    if (corners < low - FARTHEST_DRAWN_M).any() or (corners > high + FARTHEST_DRAWN_M).any():
        raise InvalidStatement(f"{form}: a corner lies more than {FARTHEST_DRAWN_M:g} m from all that was mapped")


def _stretches(footprint: shapely.Polygon, ends: Array) -> list[shapely.Geometry]:
    """The pieces of the line through two points, from border to border, that the points or what is between touch."""
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    x0, y0, x1, y1 = footprint.bounds
    reach = float(np.hypot(x1 - x0, y1 - y0)) + float(np.abs(ends - [x0, y0]).max())
    line = shapely.LineString([ends[0] - reach * along, ends[1] + reach * along])
    pieces = shapely.get_parts(footprint.buffer(CELL_M).intersection(line))
    given = shapely.LineString(ends)
    return [p for p in pieces if p.geom_type == "LineString" and p.distance(given) <= REACH_M]


def _deal_out(rooms: Rooms, storey: Storey, number: int, parts: Array, numbers: dict[int, int], low: Array) -> None:
    """Give the parts (W, H) of a room, and the walls about them, their numbers, for good."""
    low, wide = low - 3, np.pad(parts, 3)
    window = storey.ground.cover(low, low + np.array(wide.shape) - 1)
    mine = storey.ground.room[window] == number
    kernels.flood(wide, mine)
    renumber = np.zeros(int(wide.max()) + 1, np.int32)
    for part, its in numbers.items():
        renumber[part] = its
    given = mine & (wide > 0)
    storey.ground.room[window][given] = renumber[wide[given]]
    storey.ground.drawn[window] |= given
    if number in rooms.outlined:
        rooms.outlined |= set(numbers.values())


def _shrink(
    rooms: Rooms, number: int, heir: int, storey: Storey, graph: SceneGraph, stamp_ns: int, changes: GraphChanges
) -> None:
    """Write a room anew that lost ground; one that lost nearly all is gone."""
    room = f"room_{number}"
    cells = rooms.floor_of(number, storey)
    if len(cells) * CELL_M**2 < LEAST_ROOM_M2:
        storey.ground.room[storey.ground.room == number] = 0
        changes.delete_node(room, "an operator drew another room there", became=f"room_{heir}")
        rooms.footprints.pop(room, None)
        rooms.outlined.discard(number)
    else:
        rooms.write(number, storey, cells, graph, stamp_ns, changes)
