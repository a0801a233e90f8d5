"""Edges that the rules no longer derive: evidence ages, so one contrary look does not undo what many have shown.

An edge is withdrawn after WITHDRAWN_AFTER contrary observations while a thing of it was in view; out of view it is
kept, with its date. What cannot hold beside a new edge goes at once: a thing is in one room, nothing is on and above
the same thing, what stands neither hangs nor is fixed to a side, and `on` stays acyclic.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Set

from reasoning.knowledge import DerivedEdge
from scenegraph.graph import Edge, EdgeKey, GraphChanges, Node, SceneGraph

__all__ = ["CONTRARY", "WITHDRAWN_AFTER", "Doubts"]

WITHDRAWN_AFTER = 3
CONTRARY = "contrary"
"""The attribute of an edge that counts the observations against it since it last was derived."""
CANONICAL = {"supports": "on", "contains": "in", "under": "above"}


class Doubts:
    """The edges of a graph that are there although the rules do not derive them."""

    def __init__(self) -> None:
        self._at: defaultdict[str, set[EdgeKey]] = defaultdict(set)

    def remember(self, edges: Iterable[Edge]) -> None:
        """Take over the doubted ones of the edges of a graph that comes back from disk."""
        for edge in edges:
            if CONTRARY in edge.attributes:
                self._doubt(edge.key)

    def forget(self, things: Iterable[str]) -> None:
        """What was doubted of things that are no more is settled: their edges go with them."""
        for thing in things:
            for key in list(self._at.get(thing, ())):
                self._settle(key)

    def weigh(
        self,
        failing: Set[EdgeKey],
        derived: Iterable[DerivedEdge],
        seen: Set[str] | None,
        graph: SceneGraph,
        nodes: Mapping[str, Node],
        changes: GraphChanges,
    ) -> None:
        """Add to `changes` what becomes of edges that were not derived.

        failing : edges of the graph that were looked at and not derived;  derived : those that were
        seen    : the things in view; None: what fails, fails at once, since an operator said so
        nodes   : those that the changes write
        """
        now = {EdgeKey(edge.relation, edge.source, edge.target) for edge in derived}
        for key in now:
            self._settle(key)
        housed = {key.source for key in now if key.relation == "in" and _is_room(key.target, graph, nodes)}
        standing = {key.source for key in now if key.relation == "on"}
        doubted = {key for thing in seen or () for key in self._at.get(thing, ())}
        for key in sorted(failing | (doubted - now)):
            edge = graph.edge(*key)
            if edge is None:
                self._settle(key)
                continue
            against = int(edge.attributes.get(CONTRARY, 0)) + (seen is not None and not seen.isdisjoint(key[1:]))
            if seen is None or against >= WITHDRAWN_AFTER or self._ousted(key, now, housed, standing, graph, nodes):
                changes.delete_edge(*key)
                self._settle(key)
            else:
                self._doubt(key)
                if against != edge.attributes.get(CONTRARY, 0):
                    changes.put(edge.replace(attributes={**edge.attributes, CONTRARY: against}))

    @staticmethod
    def _ousted(
        key: EdgeKey,
        now: Set[EdgeKey],
        housed: Set[str],
        standing: Set[str],
        graph: SceneGraph,
        nodes: Mapping[str, Node],
    ) -> bool:
        """Whether an edge cannot hold beside those that are derived now: of what is in a room, of what stands."""
        relation = CANONICAL.get(key.relation, key.relation)
        a, b = (key.target, key.source) if relation != key.relation else (key.source, key.target)
        if relation == "in":
            return EdgeKey("in", b, a) in now or (a in housed and _is_room(b, graph, nodes))
        if relation in ("on", "above"):
            others = {EdgeKey("on", a, b), EdgeKey("on", b, a), EdgeKey("above", a, b), EdgeKey("above", b, a)}
            return bool(others & now) or _bottom(a, graph, nodes) <= _bottom(b, graph, nodes)
        return relation in ("attached_to", "hanging_from") and a in standing

    def _doubt(self, key: EdgeKey) -> None:
        for thing in key[1:]:
            self._at[thing].add(key)

    def _settle(self, key: EdgeKey) -> None:
        for thing in key[1:]:
            if thing in self._at:
                self._at[thing].discard(key)
                if not self._at[thing]:
                    del self._at[thing]


def _node(name: str, graph: SceneGraph, nodes: Mapping[str, Node]) -> Node | None:
    return nodes.get(name) or (graph.node(name) if name in graph else None)


def _is_room(name: str, graph: SceneGraph, nodes: Mapping[str, Node]) -> bool:
    node = _node(name, graph, nodes)
    return node is not None and node.layer == "room"


def _bottom(name: str, graph: SceneGraph, nodes: Mapping[str, Node]) -> float:
    """Height of the lowest point of a thing [m]; structure lies below everything."""
    node = _node(name, graph, nodes)
    if node is None or node.box is None or node.layer == "structure":
        return -1e9
    return float(node.position[2] - 0.5 * node.box.size[2])
