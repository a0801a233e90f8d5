"""Relations of oriented boxes: from what was only boxed (imported, detected, drawn), not mapped voxel by voxel.

The definitions are those of the project's relations document, taken for boxes. What is measured means what
`rules/spatial.pl` says: its thresholds, with a user's overrides, are asked of the knowledge base, and its comparisons
are done here on whole columns, with the same values, thresholds and confidences.

A box is solid: what is under a table is under it only if it lies below the box of its top. Only what the taxonomy calls
a container has an inside. Structure (walls, floors, ceilings, stairs) stands between things and carries them; where the
way between two things is not clear of its inner half, they are not known to be near.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import boxes as kernels
from reasoning.knowledge import KnowledgeBase
from reasoning.terms import Atom, Compound
from scenegraph.collector import collector_paused
from scenegraph.facts import class_atom
from scenegraph.graph import LAYERS, Edge, EdgeKey, EdgeTable, GraphChanges, Layer, Node, NodeTable, SceneGraph
from scenegraph.graph.delta import NodeDeletion

__all__ = ["RELATIONS", "Measured", "Thresholds", "follow", "measure", "relate"]

Array = NDArray[Any]

RELATIONS = ("on", "supports", "in", "contains", "above", "under", "near", "touching")
_INVERSE = {"on": "supports", "in": "contains", "above": "under", "near": "near", "touching": "touching"}
_INVERSE |= {inverse: relation for relation, inverse in _INVERSE.items()}
_TURNED = frozenset({"supports", "contains", "under"})
SOLID = frozenset({"wall", "floor", "ceiling", "stairs"})
"""Labels of structure that carries things and stands between them."""
OVER_REACH_M = 4.0
"""Nothing is above what lies more than a storey below it."""
INSET_M = 0.06
"""The way between two things begins and ends this far from them: a picture's box reaches into the wall it hangs on."""
FOOTING_HEIGHT_M = 0.03
"""Columns whose lowest point lies within this of a tilted box's lowest carry it."""
DIGITS = 4
"""Measurements are rounded to a tenth of a millimetre, as all are that the rules are told."""
_CELL_M = (1.5, 1.5, 4.0)
_ROOM_CELL_M = (4.0, 4.0, 4.0)
_OBJECT, _ROOM, _STRUCTURE = (LAYERS.index(name) for name in ("object", "room", "structure"))


@dataclass
class Thresholds:
    """The numbers that `rules/spatial.pl` compares with, and which classes are containers, as a knowledge base has them
    when it is asked. Lengths in metres, shares in 0 … 1."""

    contact_gap: float
    contact_share: float
    overlap_share: float
    footing_inside_share: float
    voxels_inside_share: float
    room_share: float
    own_room_share: float
    near_least: float
    near_most: float
    knowledge: KnowledgeBase = field(repr=False)
    _containers: dict[str, bool] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, knowledge: KnowledgeBase) -> Thresholds:
        """Those that hold now."""
        told = {str(row["N"]): row["V"] for row in knowledge.call("threshold(N, V, _, _)")}
        [answer] = knowledge.call("contact_gap(G)")
        names = cls.__dataclass_fields__.keys() & told.keys()
        values = {name: float(told[name]) for name in names}  # type: ignore[arg-type]
        return cls(contact_gap=float(answer["G"]), knowledge=knowledge, **values)  # type: ignore[arg-type]

    def is_container(self, label: str) -> bool:
        """Whether the taxonomy says that the whole box of such a thing is its inside."""
        if label not in self._containers:
            goal = Compound("container", (Atom(class_atom(label)),))
            self._containers[label] = bool(self.knowledge.call(goal, limit=1))
        return self._containers[label]


def relate(nodes: NodeTable | Iterable[Node], knowledge: KnowledgeBase | Thresholds) -> EdgeTable:
    """All relations between the boxes of the nodes, in both directions, as the rules derive them.

    Objects are related to objects, to the structure that they stand on and to the room that they are in; an object
    without a box is a point. An edge was seen when the later of its ends was last seen.

        edges = relate(nodes, knowledge)
        graph = SceneGraph.from_tables(nodes, edges)
    """
    table = nodes if isinstance(nodes, NodeTable) else NodeTable.of(nodes)
    thresholds = knowledge if isinstance(knowledge, Thresholds) else Thresholds.of(knowledge)
    return decide(measure(table, thresholds), thresholds)


# -- measuring --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """Measurements of the boxes of a table of nodes; things and what carries them are named by their rows there.

    lowest : (n,) lowest point of every node [m];  longer_side : (n,) of its footprint [m]
    rank   : (n,) place of its id in alphabetical order, which decides ties
    pairs  : (m, 2) things near or over each other, with their gap [m] (inf: far), whether the way between is clear,
        footprint_overlap, rise (m, 2) of the first over the second and the second over the first [m], whether structure
        lies between the upper and the lower, and whether both are on the same storey
    standing : (k, 2) upper and lower, with contact (k,)
    inside   : (j, 2) thing and container, with footing_inside (j,) and voxels_inside (j,)
    rooms    : (r, 2) thing and room, with footprint_share (r,)
    """

    table: NodeTable
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


class _Boxes:
    """The boxes of some rows of a table, described for measuring."""

    def __init__(self, table: NodeTable, rows: Array) -> None:
        self.rows = rows
        boxed = table.boxed[rows, None]
        self.center = np.where(boxed, table.center[rows], table.position[rows])
        self.half = np.where(boxed, 0.5 * table.size[rows], 0.0)
        self.axes = kernels.axes_of(np.where(boxed, table.rotation_wxyz[rows], (1.0, 0.0, 0.0, 0.0)))
        self.low, self.high = np.empty_like(self.center), np.empty_like(self.center)
        kernels.bounds_of(self.center, self.half, self.axes, self.low, self.high)
        self.corners, self.count, self.area, self.rectangle = kernels.footprints_of(self.center, self.half, self.axes)

    def __len__(self) -> int:
        return len(self.rows)


def measure(table: NodeTable, thresholds: Thresholds, focus: Array | None = None) -> Measured:
    """Measure what lies near each other; a pair that is too far apart to matter is not measured.

    focus : (n,) bool, the only nodes whose pairs, and on what they stand, are measured in full; all when left out
    """
    is_solid = np.array([label in SOLID for label in table.labels], np.bool_)[table.label]
    things = np.flatnonzero(table.layer == _OBJECT)
    solids = np.flatnonzero((table.layer == _STRUCTURE) & is_solid & table.boxed)
    all_boxes = _Boxes(table, np.concatenate([things, solids]))
    n, tolerance = len(things), thresholds.contact_gap
    low, high = all_boxes.low, all_boxes.high
    side = np.round(2.0 * all_boxes.rectangle[:, 4:].max(axis=1, initial=0.0), DIGITS)
    rank = np.empty(len(table), np.int64)
    rank[sorted(range(len(table)), key=table.ids.__getitem__)] = np.arange(len(table))

    grow = np.clip(0.5 * side[:n], 0.5 * max(thresholds.near_least, tolerance), max(thresholds.near_most, tolerance))
    reach_low, reach_high = low[:n] - grow[:, None], high[:n] + grow[:, None]
    reach_low[:, 2] = np.minimum(reach_low[:, 2], low[:n, 2] - OVER_REACH_M)
    cell = np.array(_CELL_M)
    grid = kernels.fill_grid(reach_low, reach_high, cell)
    if focus is None:
        pairs = kernels.meeting(reach_low, reach_high, reach_low, reach_high, cell, *grid, True)
    else:
        some = np.flatnonzero(focus[things])
        pairs = kernels.meeting(reach_low[some], reach_high[some], reach_low, reach_high, cell, *grid, False)
        one, two = some[pairs[:, 0]], pairs[:, 1]
        once = (one != two) & ((one < two) | ~focus[things[two]])
        pairs = np.stack([one[once], two[once]], axis=1).astype(np.int32)
    solid_grid = kernels.fill_grid(low[n:], high[n:], cell)
    gap, clear, overlap, between = kernels.measure_pairs(
        pairs,
        all_boxes.center,
        all_boxes.half,
        all_boxes.axes,
        low,
        high,
        all_boxes.corners,
        all_boxes.count,
        all_boxes.area,
        grow,
        INSET_M,
        (all_boxes.center[n:], _cores(all_boxes.half[n:]), all_boxes.axes[n:]),
        (cell, *solid_grid),
    )
    counts = np.isfinite(gap) | (overlap > 0.0)
    pairs, gap, clear, overlap, between = (a[counts] for a in (pairs, gap, clear, overlap, between))

    grown = np.array([0.0, 0.0, tolerance])
    on_solid = kernels.meeting(
        low[:n] - grown, low[:n] * (0, 0, 1) + high[:n] * (1, 1, 0) + grown, low[n:], high[n:], cell, *solid_grid, False
    )
    standing, contact = _stand(all_boxes, n, pairs, on_solid, rank[all_boxes.rows], tolerance)
    inside, footing_inside, voxels_inside = _contain(table, all_boxes, pairs, thresholds)
    rooms, share, room_low, room_high = _share_rooms(table, all_boxes, n)
    a, b = pairs.T
    lowest = np.zeros(len(table))
    lowest[all_boxes.rows] = np.round(low[:, 2], DIGITS)
    longer_side = np.zeros(len(table))
    longer_side[all_boxes.rows] = side
    return Measured(
        table=table,
        lowest=lowest,
        longer_side=longer_side,
        rank=rank,
        pairs=all_boxes.rows[pairs],
        gap=np.round(gap, DIGITS),
        clear=clear,
        footprint_overlap=np.round(overlap, DIGITS),
        rise=np.round(np.stack([low[a, 2] - high[b, 2], low[b, 2] - high[a, 2]], axis=1), DIGITS),
        structure_between=between,
        same_storey=_same_storey(pairs, n, rooms, share, rank, room_low, room_high),
        standing=all_boxes.rows[standing],
        contact=np.round(contact, DIGITS),
        inside=all_boxes.rows[inside],
        footing_inside=np.round(footing_inside, DIGITS),
        voxels_inside=np.round(voxels_inside, DIGITS),
        rooms=np.stack([all_boxes.rows[rooms[:, 0]], rooms[:, 1]], axis=1),
        footprint_share=np.round(share, DIGITS),
    )


def _cores(half: Array) -> Array:
    """Half sizes (n, 3) of the inner halves of walls and floors: what reaches a little into one is not behind it."""
    cores = half.copy()
    rows = np.arange(len(half))
    cores[rows, half.argmin(axis=1)] *= 0.5
    return cores


def _over_each_other(boxes: _Boxes, pairs: Array) -> Array:
    """(m,) whether the bounds of pairs meet over the ground."""
    a, b = pairs.T
    apart = (boxes.low[a, :2] > boxes.high[b, :2]) | (boxes.low[b, :2] > boxes.high[a, :2])
    return np.asarray(~apart.any(axis=1))


def _stand(boxes: _Boxes, n: int, pairs: Array, on_solid: Array, rank: Array, tolerance: float) -> tuple[Array, Array]:
    """Upper and lower (k, 2) and contact (k,): what may lie below a thing is looked through column by column."""
    over = pairs[_over_each_other(boxes, pairs)]
    below = np.concatenate([over, over[:, ::-1], on_solid + np.array([0, n])]).astype(np.int64)
    upper, lower = below.T
    foot, top = boxes.low[upper, 2], boxes.high[lower, 2]
    leans = boxes.axes[lower, 2, 2] <= 1.0 - kernels.UPRIGHT
    reached = (top >= foot - tolerance) & (
        (top <= foot + tolerance) | (leans & (boxes.low[lower, 2] <= foot + tolerance))
    )
    below = below[reached]
    below = below[np.argsort(below[:, 0], kind="stable")]
    starts = np.zeros(n + 1, np.int64)
    np.cumsum(np.bincount(below[:, 0], minlength=n), out=starts[1:])
    uppers, lowers, shares = kernels.stand(
        starts,
        below[:, 1].copy(),
        rank,
        boxes.center,
        boxes.half,
        boxes.axes,
        boxes.low,
        boxes.high,
        boxes.rectangle,
        tolerance,
        FOOTING_HEIGHT_M,
    )
    return np.stack([uppers, lowers], axis=1), shares


def _contain(table: NodeTable, boxes: _Boxes, pairs: Array, thresholds: Thresholds) -> tuple[Array, Array, Array]:
    """Thing and container (j, 2), shares of the thing's footing (j,) and volume (j,) inside; where any footing is."""
    used = np.unique(table.label[boxes.rows])
    holds = np.zeros(len(table.labels), np.bool_)
    holds[used] = [thresholds.is_container(table.labels[label]) for label in used.tolist()]
    container = holds[table.label[boxes.rows]]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[container[both[:, 1]]]
    a, b = both.T
    meet = ((boxes.low[a] <= boxes.high[b]) & (boxes.low[b] <= boxes.high[a])).all(axis=1)
    both = np.ascontiguousarray(both[meet])
    footing, volume = kernels.inside_boxes(
        both,
        boxes.center,
        boxes.half,
        boxes.axes,
        boxes.low,
        boxes.high,
        boxes.corners,
        boxes.count,
        boxes.area,
        boxes.rectangle,
        FOOTING_HEIGHT_M,
    )
    some = footing > 0.0
    return both[some], footing[some], volume[some]


def _share_rooms(table: NodeTable, boxes: _Boxes, n: int) -> tuple[Array, Array, Array, Array]:
    """Thing and row of its room (r, 2), and share (r,); floor and ceiling heights by row of the table."""
    rows = np.flatnonzero((table.layer == _ROOM) & table.boxed)
    rooms = _Boxes(table, rows)
    rings = [_ring(table, row, rooms.corners[k, : rooms.count[k]]) for k, row in enumerate(rows.tolist())]
    starts = np.zeros(len(rings) + 1, np.int64)
    np.cumsum([len(ring) for ring in rings], out=starts[1:])
    cell = np.array(_ROOM_CELL_M)
    flat_low, flat_high = boxes.low[:n].copy(), boxes.high[:n].copy()
    flat_low[:, 2] = flat_high[:, 2] = boxes.center[:n, 2]
    room_low, room_high = rooms.low.copy(), rooms.high.copy()
    for k, ring in enumerate(rings):
        room_low[k, :2], room_high[k, :2] = ring.min(axis=0), ring.max(axis=0)
    pairs = kernels.meeting(
        flat_low, flat_high, room_low, room_high, cell, *kernels.fill_grid(room_low, room_high, cell), False
    )
    share = kernels.shares_in_polygons(
        pairs,
        boxes.center,
        boxes.half,
        boxes.axes,
        boxes.rectangle,
        starts,
        np.concatenate(rings) if rings else np.empty((0, 2)),
    )
    some = share > 0.0
    pairs = pairs[some].astype(np.int64)
    pairs[:, 1] = rows[pairs[:, 1]]
    low, high = np.zeros(len(table)), np.zeros(len(table))
    low[rows], high[rows] = rooms.low[:, 2], rooms.high[:, 2]
    return pairs, share[some], low, high


def _ring(table: NodeTable, row: int, corners: Array) -> Array:
    """A room's footprint (k, 2): its attribute where that is a ring, else the ground of its box."""
    told = table.attributes[row].get("footprint") if row in table.attributes else None
    try:
        ring = np.array(corners if told is None else told, np.float64)
    except (TypeError, ValueError):
        return corners
    return ring if ring.ndim == 2 and ring.shape[1] == 2 and len(ring) >= 3 else corners


def _same_storey(
    pairs: Array, n: int, rooms: Array, share: Array, rank: Array, room_low: Array, room_high: Array
) -> Array:
    """(m,) whether the rooms that hold most of two things reach over mostly the same heights; unknown counts as yes."""
    own = np.full(n, -1)
    order = np.lexsort((-rank[rooms[:, 1]], share))
    own[rooms[order, 0]] = rooms[order, 1]  # the largest share is written last
    one, two = own[pairs[:, 0]], own[pairs[:, 1]]
    common = np.minimum(room_high[one], room_high[two]) - np.maximum(room_low[one], room_low[two])
    lower = np.minimum(room_high[one] - room_low[one], room_high[two] - room_low[two])
    same: Array = (one < 0) | (two < 0) | (one == two) | (common >= 0.5 * lower)
    return same


# -- deciding: judged/5 of rules/spatial.pl, on columns ---------------------------------------------------------------


def decide(measured: Measured, thresholds: Thresholds) -> EdgeTable:
    """The edges that the rules derive from the measurements, in both directions."""
    found = _Found()
    on = _decide_on(measured, thresholds, found)
    _decide_in_things(measured, thresholds, found)
    _decide_in_rooms(measured, thresholds, on, found)
    _decide_above(measured, thresholds, on, found)
    a, b = measured.pairs.T
    sides = 0.5 * (measured.longer_side[a] + measured.longer_side[b])
    distance = np.minimum(thresholds.near_most, np.maximum(thresholds.near_least, sides))
    near = measured.clear & (measured.gap <= distance)
    found.add(
        "near", "near", measured.pairs[near], measured.gap[near], distance[near], _below(measured.gap, distance)[near]
    )
    gap = np.full(len(a), thresholds.contact_gap)
    touching = measured.gap <= gap
    found.add(
        "touching",
        "touching",
        measured.pairs[touching],
        measured.gap[touching],
        gap[touching],
        _below(measured.gap, gap)[touching],
    )
    return found.table(measured.table)


class _Found:
    """Edges by column, as they are found."""

    def __init__(self) -> None:
        self.parts: list[tuple[str, Array, Array, Array, Array]] = []

    def add(
        self, relation: str, inverse: str, ends: Array, value: Array, threshold: Array | float, margin: Array
    ) -> None:
        """relation(ends[:, 0], ends[:, 1]) and its inverse, whose confidence grows from a half with the margin."""
        confidence = 0.5 + 0.5 * np.minimum(1.0, margin)
        limit = np.broadcast_to(np.asarray(threshold, np.float64), value.shape)
        self.parts.append((relation, ends, value, limit, confidence))
        self.parts.append((inverse, ends[:, ::-1], value, limit, confidence))

    def table(self, nodes: NodeTable) -> EdgeTable:
        relation = np.repeat(
            np.array([RELATIONS.index(name) for name, *_ in self.parts], np.uint16), [len(p[2]) for p in self.parts]
        )
        ends = np.concatenate([part[1] for part in self.parts])
        value, threshold, confidence = (np.concatenate([part[k] for part in self.parts]) for k in (2, 3, 4))
        source, target = ends.T.astype(np.int32)
        seen = np.maximum(nodes.last_seen_ns[source], nodes.last_seen_ns[target])
        return EdgeTable(
            ids=nodes.ids,
            relations=RELATIONS,
            relation=relation,
            source=source,
            target=target,
            value=value,
            threshold=threshold,
            confidence=confidence,
            first_seen_ns=seen,
            last_seen_ns=seen,
            evidence_of=np.broadcast_to(np.int32(0), len(value)),
        )


def _above(value: Array, threshold: float) -> Array:
    """Margins (m,) of shares that must be at least the threshold: in full at 1."""
    return (value - threshold) / (1.0 - threshold) if threshold < 1.0 else np.full(len(value), np.inf)


def _below(value: Array, threshold: Array) -> Array:
    """Margins (m,) of distances that must be at most the threshold: in full at two thirds of it."""
    return np.where(threshold > 0.0, 3.0 * (threshold - value) / np.where(threshold > 0.0, threshold, 1.0), np.inf)


def _decide_on(measured: Measured, thresholds: Thresholds, found: _Found) -> tuple[Array, Array]:
    """Upper and lower (k, 2) of all that rests on something, and the share of contact (k,)."""
    upper, lower = measured.standing.T
    rise = measured.lowest[upper] - measured.lowest[lower]
    in_order = (
        (measured.table.layer[lower] == _STRUCTURE)
        | (rise > 0.0)
        | ((rise == 0.0) & (measured.rank[upper] > measured.rank[lower]))
    )
    on = (measured.contact >= thresholds.contact_share) & in_order
    share = measured.contact[on]
    found.add(
        "on",
        "supports",
        measured.standing[on],
        share,
        thresholds.contact_share,
        _above(share, thresholds.contact_share),
    )
    return measured.standing[on], share


def _decide_in_things(measured: Measured, thresholds: Thresholds, found: _Found) -> None:
    enough, enough_voxels = thresholds.footing_inside_share, thresholds.voxels_inside_share
    footing, voxels = measured.footing_inside, measured.voxels_inside
    held = (footing >= enough) & (voxels >= enough_voxels)
    margin = np.minimum(_above(footing, enough), _above(voxels, enough_voxels))
    found.add("in", "contains", measured.inside[held], footing[held], enough, margin[held])


def _decide_in_rooms(measured: Measured, thresholds: Thresholds, on: tuple[Array, Array], found: _Found) -> None:
    """room_of/3: the room of the largest share; what straddles a border goes with what it stands on."""
    n = len(measured.table)
    room, share = np.full(n, -1), np.zeros(n)
    order = np.lexsort((-measured.rank[measured.rooms[:, 1]], measured.footprint_share))
    room[measured.rooms[order, 0]] = measured.rooms[order, 1]
    share[measured.rooms[order, 0]] = measured.footprint_share[order]
    support = np.full(n, -1)
    carried = measured.table.layer[on[0][:, 1]] == _OBJECT
    ends, contact = on[0][carried], on[1][carried]
    order = np.lexsort((-measured.rank[ends[:, 1]], contact))
    support[ends[order, 0]] = ends[order, 1]

    own = np.where((room >= 0) & (share >= thresholds.room_share), room, -1)
    unclear = np.flatnonzero((support >= 0) & (share < thresholds.own_room_share))
    for thing in unclear[np.lexsort((measured.rank[unclear], measured.lowest[unclear]))].tolist():
        below = support[thing]  # lower, or the same and earlier by name: decided before
        if own[below] >= 0:
            own[thing], share[thing] = own[below], share[below]
    inside = np.flatnonzero((own >= 0) & (measured.table.layer == _OBJECT))
    value = share[inside]
    ends = np.stack([inside, own[inside]], axis=1)
    found.add("in", "contains", ends, value, thresholds.room_share, _above(value, thresholds.room_share))


def _decide_above(measured: Measured, thresholds: Thresholds, on: tuple[Array, Array], found: _Found) -> None:
    n = len(measured.table)
    overlap, gap = measured.footprint_overlap, thresholds.contact_gap
    rests = np.unique(on[0][:, 0].astype(np.int64) * n + on[0][:, 1])
    for k, ends in enumerate((measured.pairs, measured.pairs[:, ::-1])):
        rise = measured.rise[:, k]
        over = (
            (overlap > 0.0)
            & (overlap >= thresholds.overlap_share)
            & (rise > gap)
            & ~measured.structure_between
            & measured.same_storey
        )
        over[over] = ~np.isin(ends[over, 0].astype(np.int64) * n + ends[over, 1], rests)
        high = (rise - gap) / gap if gap > 0.0 else np.full(len(rise), np.inf)
        margin = np.minimum(high, _above(overlap, thresholds.overlap_share))
        found.add("above", "under", ends[over], rise[over], gap, margin[over])


# -- following changes ------------------------------------------------------------------------------------------------


@collector_paused()
def follow(graph: SceneGraph, changes: GraphChanges, thresholds: Thresholds) -> None:
    """Add to changes of a graph of boxes the relations that then hold, and take away those that hold no longer.

    After the commit, the edges named in `RELATIONS` at objects are those that `relate` would give for all nodes. The
    cost depends on how many nodes are changed and on what is around them, not on the graph.
    """
    moved = {step.id: step for step in changes.steps if isinstance(step, Node)}
    gone = {step.id for step in changes.steps if isinstance(step, NodeDeletion)} - moved.keys()
    moved = {i: node for i, node in moved.items() if i not in graph or not _same_place(graph.node(i), node)}
    if not moved and not gone:
        return
    around = _Around(graph, moved, gone, thresholds)
    stale = around.settled_edges()
    table = NodeTable.of(around.nodes)
    local = decide(measure(table, thresholds, np.array([i in around.focus for i in table.ids], np.bool_)), thresholds)
    for edge in local.rows(around.settled(local)):
        key = edge.key
        stale.discard(key)
        known = around.known(key)
        if known is None:
            changes.put(edge)
        elif (known.value, known.threshold) != (edge.value, edge.threshold):
            changes.put(edge.replace(first_seen_ns=min(known.first_seen_ns, edge.last_seen_ns)))
    for relation, source, target in sorted(stale):
        if source not in gone and target not in gone:
            changes.delete_edge(relation, source, target)


def _same_place(one: Node, two: Node) -> bool:
    """Whether no relation can tell two states of a node apart."""
    return (
        one.box == two.box
        and one.label == two.label
        and (one.box is not None or one.position.tolist() == two.position.tolist())
        and one.attributes.get("footprint") == two.attributes.get("footprint")
    )


class _Around:
    """What must be looked at anew once some nodes are put and others are gone.

    changed   : objects all of whose relations are judged: those that moved, and all that are near changed structure
    unsettled : these, and objects of which it is judged on what they stand and in which room they are
    focus     : these, and what carries them
    nodes     : all that is needed to judge these, as they are after the change
    """

    def __init__(self, graph: SceneGraph, moved: dict[str, Node], gone: set[str], thresholds: Thresholds) -> None:
        self._graph, self._moved, self._gone = graph, moved, gone
        self._before: dict[str, Node] = {}
        self._known: dict[EdgeKey, Edge] = {}
        margin, reach = thresholds.contact_gap + 1e-3, thresholds.near_most
        column = np.array([0.0, 0.0, OVER_REACH_M])
        asked = {*moved, *gone}
        self.changed = {i for i in asked if self._layer(i) == "object"}
        for low, high in self._places(asked - self.changed):
            self.changed |= self._ids(low - reach - column, high + reach + column, "object")
        places = self._places(self.changed | asked)
        self.unsettled = set(self.changed)
        for low, high in places:
            self.unsettled |= self._ids(low - margin, high + margin, "object")
        self.unsettled |= self._joined("supports", self.unsettled)
        carriers = self._joined("on", self.unsettled)
        self.focus = self.unsettled | {i for i in carriers if self._layer(i) == "object"}
        near = asked | self.focus | carriers
        for low, high in places:
            near |= self._ids(low - reach, high + reach) | self._ids(low - column, high + column)
        for low, high in self._places(self.focus):
            if not any((low >= a - reach + margin).all() and (high <= b + reach - margin).all() for a, b in places):
                near |= self._ids(low - margin, high + margin)
        self.nodes = [states[-1] for i in sorted(near - gone) if (states := self._states(i))]
        things = [node for node in self.nodes if node.layer == "object"]
        if things:
            middle = np.array([node.position if node.box is None else node.box.center for node in things])
            far = np.array([0.0 if node.box is None else max(node.box.size.tolist()) for node in things])[:, None]
            rooms = self._ids((middle - far).min(axis=0), (middle + far).max(axis=0), "room") - near - gone
            self.nodes += [self._states(i)[-1] for i in sorted(rooms)]
        self.nodes = [node for node in self.nodes if node.layer in ("object", "structure", "room")]

    def settled_edges(self) -> set[EdgeKey]:
        """The edges of the graph of which what is known here says whether they still hold."""
        known = self._known
        for node_id in self.unsettled:
            if node_id not in self._graph:
                continue
            if node_id in self.changed:
                known.update((e.key, e) for e in self._graph.edges_of(node_id) if e.relation in RELATIONS)
            else:
                known.update((e.key, e) for e in self._graph.edges("on", source=node_id))
                inside = self._graph.edges("in", source=node_id)
                known.update((e.key, e) for e in inside if self._layer(e.target) == "room")
        keys = known.keys() | {EdgeKey(_INVERSE[relation], target, source) for relation, source, target in known}
        return {key for key in keys if key.relation not in ("in", "contains") or self._holds_things(key)}

    def known(self, key: EdgeKey) -> Edge | None:
        """The edge of the graph as it was before the change."""
        edge = self._known.get(key)
        return self._graph.edge(*key) if edge is None else edge

    def _holds_things(self, key: EdgeKey) -> bool:
        """Whether what contains is a thing or a room: that a room is in a storey is no measurement."""
        return self._layer(key.target if key.relation == "in" else key.source) in ("object", "room")

    def settled(self, edges: EdgeTable) -> Array:
        """The rows of the edges between `nodes` that are settled here."""
        changed, unsettled = (
            np.array([i in ids for i in edges.ids], np.bool_) for ids in (self.changed, self.unsettled)
        )
        is_room = np.array([node.layer == "room" for node in self.nodes], np.bool_)
        turned = np.array([name in _TURNED for name in edges.relations], np.bool_)[edges.relation]
        upper, lower = np.where(turned, edges.target, edges.source), np.where(turned, edges.source, edges.target)
        stands = np.array([name in ("on", "supports") for name in edges.relations], np.bool_)[edges.relation]
        return np.flatnonzero(np.where(stands | is_room[lower], unsettled[upper], changed[upper] | changed[lower]))

    def _ids(self, low: Array, high: Array, layer: Layer | None = None) -> set[str]:
        found = {node.id: node for node in self._graph.in_box(low, high, layer)}
        self._before.update(found)
        return set(found)

    def _joined(self, relation: str, things: set[str]) -> set[str]:
        """What is joined to the things by a chain of this relation."""
        found: set[str] = set()
        last = things
        while last:
            ends = {e.target for i in last if i in self._graph for e in self._graph.edges(relation, source=i)}
            last = ends - found - things
            found |= last
        return found

    def _states(self, node_id: str) -> list[Node]:
        """The node before and after the change."""
        before = self._before.get(node_id)
        if before is None and node_id in self._graph:
            before = self._before[node_id] = self._graph.node(node_id)
        after = self._moved.get(node_id)
        return [node for node in (before, after) if node is not None]

    def _places(self, ids: Iterable[str]) -> list[tuple[Array, Array]]:
        return [_bounds(node) for i in ids for node in self._states(i)]

    def _layer(self, node_id: str) -> str | None:
        states = self._states(node_id)
        return states[-1].layer if states else None


def _bounds(node: Node) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) [m]."""
    if node.box is None:
        return node.position, node.position
    reach = 0.5 * np.abs(node.box.rotation) @ node.box.size
    return node.box.center - reach, node.box.center + reach
