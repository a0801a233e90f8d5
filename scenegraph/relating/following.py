"""A change of a graph of boxes → the relations that then hold, at a cost that is the change's and not the graph's."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenegraph.collector import collector_paused
from scenegraph.graph import LAYERS, Attributes, Edge, EdgeKey, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion
from scenegraph.graph.spatial import box_of
from scenegraph.relating.deciding import INVERSE, RELATIONS, Relations, decide
from scenegraph.relating.measuring import OVER_REACH_M, Scope, measure
from scenegraph.relating.things import OBJECT, ROOM, SOLID, STRUCTURE, Things
from scenegraph.relating.thresholds import Thresholds

__all__ = ["follow"]

Array = NDArray[Any]
Bounds = tuple[Array, Array]
"""Lowest and highest corner (3,) [m]."""

_RELATED = np.isin(np.arange(len(LAYERS)), (OBJECT, ROOM, STRUCTURE))
_PLACING = ("on", "supports", "in", "contains")
_NO_ATTRIBUTES = Attributes()
_ON, _IN = RELATIONS.index("on"), RELATIONS.index("in")


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
    known = around.known_edges()
    found = decide(measure(around.things, thresholds, around.scope), thresholds)
    held, news = around.edges(found, known)
    for edge in news:
        changes.put(edge)
    for relation, source, target in sorted(known.keys() - held):
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
    things    : all that is needed to judge these, as they are after the change
    scope     : the changed are measured in full; on what the unsettled and what carries them stand, and their rooms
    """

    def __init__(self, graph: SceneGraph, moved: dict[str, Node], gone: set[str], thresholds: Thresholds) -> None:
        self._graph, space = graph, graph.space
        margin, reach = thresholds.contact_gap + 1e-3, thresholds.near_most
        column = np.array([0.0, 0.0, OVER_REACH_M])
        put = [node for node in moved.values() if _RELATED[LAYERS.index(node.layer)]]
        old = graph.slots([i for i in (*moved, *gone) if i in graph])
        old = old[_RELATED[space.layer[old]]]
        asked = _asked(graph, old, put)

        self._changed = {i for i, (layer, _) in asked.items() if layer == OBJECT}
        for low, high in [place for layer, places in asked.values() if layer != OBJECT for place in places]:
            self._changed.update(graph.ids_at(space.in_box(low - reach - column, high + reach + column, "object")))
        others = graph.slots([i for i in self._changed if i not in asked])
        places = [place for _, places in asked.values() for place in places]
        places += zip(*space.bounds(others), strict=True)
        self._unsettled = set(self._changed)
        for low, high in places:
            self._unsettled.update(graph.ids_at(space.in_box(low - margin, high + margin, "object")))
        self._unsettled |= self._chained("supports", self._unsettled)
        placed = self._unsettled | self._chained("on", self._unsettled)

        focus = graph.slots([i for i in placed if i in graph])
        near = [focus]
        for low, high in places:
            near += [space.in_box(low - reach, high + reach), space.in_box(low - column, high + column)]
        for low, high in _outside(space.bounds(focus), places, reach - margin):
            near.append(space.in_box(low - margin, high + margin))
        slots = np.unique(np.concatenate(near))
        low, high = space.bounds(slots[space.layer[slots] == OBJECT])
        low, high = np.vstack([low, *(low for low, _ in places)]), np.vstack([high, *(high for _, high in places)])
        slots = np.union1d(slots, space.in_box(low.min(axis=0), high.max(axis=0), "room"))
        slots = slots[_RELATED[space.layer[slots]] & (slots[:, None] != old).all(axis=1)]
        self.things, self._last_seen_ns = _things(graph, slots, put, thresholds)
        is_object = self.things.layer == OBJECT
        self.scope = Scope(whole=is_object & self._among(self._changed), placed=is_object & self._among(placed))

    def known_edges(self) -> dict[EdgeKey, Edge]:
        """The edges of the graph of which what is known here says whether they still hold, as they were before."""
        changed = [edge for edge in self._graph.edges_at(self._changed, RELATIONS) if self._measured(edge)]
        others = self._graph.edges_at(self._unsettled - self._changed, _PLACING)
        return {edge.key: edge for edge in (*changed, *(edge for edge in others if self._places_unsettled(edge)))}

    def _measured(self, edge: Edge) -> bool:
        """Whether what contains is a thing or a room: that a room is in a storey is no measurement."""
        if edge.relation not in ("in", "contains"):
            return True
        return self._layer(edge.target if edge.relation == "in" else edge.source) in (OBJECT, ROOM)

    def _places_unsettled(self, edge: Edge) -> bool:
        """Whether the edge says on what an unsettled object stands, or in which room it is."""
        forwards = edge.relation in ("on", "in")
        upper, lower = (edge.source, edge.target) if forwards else (edge.target, edge.source)
        return upper in self._unsettled and (edge.relation in ("on", "supports") or self._layer(lower) == ROOM)

    def _layer(self, node_id: str) -> int:
        return int(self._graph.space.layer[self._graph.slots([node_id])[0]])

    def edges(self, found: Relations, known: Mapping[EdgeKey, Edge]) -> tuple[set[EdgeKey], list[Edge]]:
        """What holds of the relations that are settled here, both ways; and the edges of which that is news."""
        seen, ids = self._last_seen_ns, self.things.ids
        changed, unsettled = self._among(self._changed), self._among(self._unsettled)
        upper, lower = found.ends.T
        places = (found.relation == _ON) | ((found.relation == _IN) & (self.things.layer[lower] == ROOM))
        settled = np.flatnonzero(np.where(places, unsettled[upper], changed[upper] | changed[lower]))
        columns = (found.relation, found.ends, found.value, found.threshold, found.confidence)
        held: set[EdgeKey] = set()
        news: list[dict[str, Any]] = []
        for code, (a, b), value, threshold, confidence in zip(*(c[settled].tolist() for c in columns), strict=True):
            name, last = RELATIONS[code], max(seen[a], seen[b])
            for key in (EdgeKey(name, ids[a], ids[b]), EdgeKey(INVERSE[name], ids[b], ids[a])):
                held.add(key)
                before = known.get(key)
                if before is not None and (before.value, before.threshold) == (value, threshold):
                    continue
                first = last if before is None else min(before.first_seen_ns, last)
                news.append(
                    {
                        "relation": key.relation,
                        "source": key.source,
                        "target": key.target,
                        "value": value,
                        "threshold": threshold,
                        "confidence": confidence,
                        "evidence": (),
                        "first_seen_ns": first,
                        "last_seen_ns": last,
                        "attributes": _NO_ATTRIBUTES,
                    }
                )
        return held, Edge.trusted(news)

    def _chained(self, relation: str, things: set[str]) -> set[str]:
        """The objects that are joined to the things by a chain of this relation, without these."""
        graph = self._graph
        found: set[str] = set()
        last: Collection[str] = things
        while last:
            slots = graph.slots(graph.targets(relation, last) - found - things)
            last = graph.ids_at(slots[graph.space.layer[slots] == OBJECT])
            found.update(last)
        return found

    def _among(self, ids: set[str]) -> Array:
        """(n,) whether each thing is one of these."""
        return np.fromiter((i in ids for i in self.things.ids), np.bool_, len(self.things))


def _asked(graph: SceneGraph, old: Array, put: Iterable[Node]) -> dict[str, tuple[int, list[Bounds]]]:
    """Layer and places, before and after, of the nodes in slots that change and of those that are put, by id."""
    asked: dict[str, tuple[int, list[Bounds]]] = {}
    low, high = graph.space.bounds(old)
    for n, node_id in enumerate(graph.ids_at(old)):
        asked[node_id] = int(graph.space.layer[old[n]]), [(low[n], high[n])]
    for node in put:
        middle, half, axes = box_of(node)
        reach = np.abs(axes) @ half
        place = middle - reach, middle + reach
        _, places = asked.setdefault(node.id, (LAYERS.index(node.layer), []))
        if places and (place[0] <= places[0][1]).all() and (places[0][0] <= place[1]).all():
            places[0] = np.minimum(place[0], places[0][0]), np.maximum(place[1], places[0][1])
        else:
            places.append(place)
    return asked


def _outside(bounds: Bounds, places: Iterable[Bounds], reach: float) -> list[Bounds]:
    """Those of bounds (n, 3) that lie within `reach` [m] of none of the places."""
    low, high = bounds
    out = np.ones(len(low), np.bool_)
    for place_low, place_high in places:
        out &= ~((low >= place_low - reach) & (high <= place_high + reach)).all(axis=1)
    return list(zip(low[out], high[out], strict=True))


def _things(graph: SceneGraph, slots: Array, put: list[Node], thresholds: Thresholds) -> tuple[Things, list[int]]:
    """The nodes in slots of the graph, and those that are put; and when each was last seen [ns]."""
    space, told = graph.space, graph.told(slots)
    ids = [*told.ids, *(node.id for node in put)]
    labels = [*told.labels, *(node.label for node in put)]
    layer = np.concatenate([space.layer[slots], np.array([LAYERS.index(node.layer) for node in put], np.uint8)])
    own = [box_of(node) for node in put]
    center, half, axes = (
        np.concatenate([column[slots], *(box[k][None] for box in own)])
        for k, column in enumerate((space.center, space.half, space.axes))
    )
    attributes = {len(slots) + n: node.attributes for n, node in enumerate(put)}
    for row in np.flatnonzero(layer[: len(slots)] == ROOM).tolist():
        attributes[row] = graph.node(ids[row]).attributes
    things = Things.described(
        ids,
        layer,
        np.array([*told.boxed, *(node.box is not None for node in put)], np.bool_),
        np.array([label in SOLID for label in labels], np.bool_),
        np.array([thresholds.is_container(label) for label in labels], np.bool_),
        (center, half, axes),
        attributes,
    )
    return things, [*told.last_seen_ns, *(node.last_seen_ns for node in put)]
