"""Measurements → relations: `judged/5` of `rules/spatial.pl`, on columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenegraph.graph import EdgeTable, NodeTable
from scenegraph.relating.measuring import FOOTING_HEIGHT_M, Measured
from scenegraph.relating.things import OBJECT, STRUCTURE
from scenegraph.relating.thresholds import Thresholds

__all__ = ["INVERSE", "RELATIONS", "Relations", "decide"]

Array = NDArray[Any]

RELATIONS = ("on", "supports", "in", "contains", "above", "under", "near", "touching")
INVERSE = {"on": "supports", "in": "contains", "above": "under", "near": "near", "touching": "touching"}
INVERSE |= {inverse: relation for relation, inverse in INVERSE.items()}


@dataclass(frozen=True)
class Relations:
    """Relations that hold, one way each: `INVERSE` says what then holds the other way.

    relation   : (m,) index into `RELATIONS`
    ends       : (m, 2) rows of source and target;  for on, in and above the upper, the inner and the upper first
    value, threshold, confidence : (m,)
    """

    relation: Array
    ends: Array
    value: Array
    threshold: Array
    confidence: Array

    def __len__(self) -> int:
        return len(self.relation)

    def table(self, nodes: NodeTable) -> EdgeTable:
        """The edges of both ways between the nodes, whose rows those of the ends are. An edge was seen when the later
        of its ends was last seen."""
        code = np.array([RELATIONS.index(INVERSE[name]) for name in RELATIONS], np.uint16)
        source, target = self.ends.T.astype(np.int32)
        seen = np.maximum(nodes.last_seen_ns[source], nodes.last_seen_ns[target])
        value, threshold, confidence, seen = (
            np.concatenate([column, column]) for column in (self.value, self.threshold, self.confidence, seen)
        )
        return EdgeTable(
            ids=nodes.ids,
            relations=RELATIONS,
            relation=np.concatenate([self.relation, code[self.relation]]),
            source=np.concatenate([source, target]),
            target=np.concatenate([target, source]),
            value=value,
            threshold=threshold,
            confidence=confidence,
            first_seen_ns=seen,
            last_seen_ns=seen,
            evidence_of=np.broadcast_to(np.int32(0), len(value)),
        )


def decide(measured: Measured, thresholds: Thresholds) -> Relations:
    """The relations that the rules derive from the measurements."""
    found = _Found()
    on = _decide_on(measured, thresholds, found)
    _decide_in_things(measured, thresholds, found)
    _decide_in_rooms(measured, thresholds, on, found)
    _decide_above(measured, thresholds, on, found)
    _decide_near(measured, thresholds, found)
    return found.relations()


class _Found:
    """Relations by column, as they are found."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._parts: list[tuple[Array, Array, Array, Array]] = []

    def add(self, name: str, ends: Array, value: Array, threshold: Array | float, margin: Array) -> None:
        """`name(ends[:, 0], ends[:, 1])`, whose confidence grows from a half with the margin."""
        if len(value):
            limit = np.full(len(value), threshold) if isinstance(threshold, float) else threshold
            self._names.append(name)
            self._parts.append((ends, value, limit, margin))

    def relations(self) -> Relations:
        if not self._parts:
            return Relations(np.empty(0, np.uint16), np.empty((0, 2), np.int64), *np.empty((3, 0)))
        ends, value, threshold, margin = (np.concatenate(columns) for columns in zip(*self._parts, strict=True))
        code = np.array([RELATIONS.index(name) for name in self._names], np.uint16)
        return Relations(
            relation=np.repeat(code, [len(part[1]) for part in self._parts]),
            ends=ends,
            value=value,
            threshold=threshold,
            confidence=0.5 + 0.5 * np.minimum(1.0, margin),
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
        (measured.things.layer[lower] == STRUCTURE)
        | (rise > 0.0)
        | ((rise == 0.0) & (measured.rank[upper] > measured.rank[lower]))
    )
    on = (measured.contact >= thresholds.contact_share) & in_order
    ends, share = measured.standing[on], measured.contact[on]
    found.add("on", ends, share, thresholds.contact_share, _above(share, thresholds.contact_share))
    return ends, share


def _decide_in_things(measured: Measured, thresholds: Thresholds, found: _Found) -> None:
    enough, enough_voxels = thresholds.footing_inside_share, thresholds.voxels_inside_share
    footing, voxels = measured.footing_inside, measured.voxels_inside
    held = (footing >= enough) & (voxels >= enough_voxels)
    margin = np.minimum(_above(footing, enough), _above(voxels, enough_voxels))
    found.add("in", measured.inside[held], footing[held], enough, margin[held])


def _decide_in_rooms(measured: Measured, thresholds: Thresholds, on: tuple[Array, Array], found: _Found) -> None:
    """room_of/3: the room of the largest share; what straddles a border goes with what it stands on."""
    n = len(measured.things)
    room, share = np.full(n, -1), np.zeros(n)
    order = np.lexsort((-measured.rank[measured.rooms[:, 1]], measured.footprint_share))
    room[measured.rooms[order, 0]] = measured.rooms[order, 1]
    share[measured.rooms[order, 0]] = measured.footprint_share[order]
    support = np.full(n, -1)
    carried = measured.things.layer[on[0][:, 1]] == OBJECT
    ends, contact = on[0][carried], on[1][carried]
    order = np.lexsort((-measured.rank[ends[:, 1]], contact))
    support[ends[order, 0]] = ends[order, 1]

    own = np.where((room >= 0) & (share >= thresholds.room_share), room, -1)
    unclear = np.flatnonzero((support >= 0) & (share < thresholds.own_room_share))
    for thing in unclear[np.lexsort((measured.rank[unclear], measured.lowest[unclear]))].tolist():
        below = support[thing]  # lower, or the same and earlier by name: decided before
        if own[below] >= 0:
            own[thing], share[thing] = own[below], share[below]
    inside = np.flatnonzero((own >= 0) & (measured.things.layer == OBJECT))
    value = share[inside]
    ends = np.stack([inside, own[inside]], axis=1)
    found.add("in", ends, value, thresholds.room_share, _above(value, thresholds.room_share))


def _decide_above(measured: Measured, thresholds: Thresholds, on: tuple[Array, Array], found: _Found) -> None:
    n = len(measured.things)
    overlap, gap = measured.footprint_overlap, thresholds.contact_gap
    rests = np.sort(on[0][:, 0] * n + on[0][:, 1])
    over = (overlap > 0.0) & (overlap >= thresholds.overlap_share) & ~measured.structure_between & measured.same_storey
    for k, ends in enumerate((measured.pairs, measured.pairs[:, ::-1])):
        high = np.flatnonzero(over & (measured.rise[:, k] > gap))
        if len(high) and len(rests):
            pair = ends[high, 0] * n + ends[high, 1]
            high = high[rests[np.minimum(rests.searchsorted(pair), len(rests) - 1)] != pair]
        rise = measured.rise[high, k]
        margin = np.minimum(
            (rise - gap) / gap if gap > 0.0 else np.inf, _above(overlap[high], thresholds.overlap_share)
        )
        found.add("above", ends[high], rise, gap, margin)


def _decide_near(measured: Measured, thresholds: Thresholds, found: _Found) -> None:
    """near/2 and touching/2: both from the gap, one along a way that is clear; or one rests firmly on the other."""
    a, b = measured.pairs.T
    sides = 0.5 * (measured.longer_side[a] + measured.longer_side[b])
    near_within = np.clip(sides, thresholds.near_least, thresholds.near_most)
    touching_within = np.full(len(a), thresholds.contact_gap)
    for name, distance, clear in (("near", near_within, measured.clear), ("touching", touching_within, True)):
        held = clear & (measured.gap <= distance)
        gap, limit = measured.gap[held], distance[held]
        found.add(name, measured.pairs[held], gap, limit, _below(gap, limit))
    _decide_touching_firmly(measured, thresholds, found)


def _decide_touching_firmly(measured: Measured, thresholds: Thresholds, found: _Found) -> None:
    """What leans rests on more than its nearest point: it touches what carries enough of its footing."""
    within, n = thresholds.contact_gap, len(measured.things)
    near = np.flatnonzero((measured.gap > within) & (measured.gap <= within + FOOTING_HEIGHT_M))
    firm = np.flatnonzero(measured.contact >= thresholds.contact_share)
    if not (len(near) and len(firm)):
        return
    carried = measured.standing[firm, 0] * n + measured.standing[firm, 1]
    firm = firm[np.argsort(carried)]
    carried.sort()
    a, b = measured.pairs[near].T
    share = np.zeros(len(near))
    for pair in (a * n + b, b * n + a):
        at = np.minimum(carried.searchsorted(pair), len(carried) - 1)
        share = np.maximum(share, np.where(carried[at] == pair, measured.contact[firm[at]], 0.0))
    held = share > 0.0
    ends, share, enough = measured.pairs[near[held]], share[held], thresholds.contact_share
    found.add("touching", ends, share, enough, _above(share, enough))
