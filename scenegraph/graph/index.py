"""The graph's contents with their indexes: every look-up costs what it finds."""

from __future__ import annotations

from collections.abc import Iterator

from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.node import Node

__all__ = ["GraphIndex"]

_ByPair = dict[tuple[str, str], Edge]
_ByEnd = dict[str, dict[str, dict[str, Edge]]]  # one end -> relation -> the other end -> edge


class GraphIndex:
    """Nodes by id, layer and label; edges by relation, source and target. Knows no rules: what is put, is in."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self._by_layer: dict[str, dict[str, None]] = {}
        self._by_label: dict[str, dict[str, None]] = {}
        self._by_relation: dict[str, _ByPair] = {}
        self._by_source: _ByEnd = {}
        self._by_target: _ByEnd = {}
        self.n_edges = 0

    def put_node(self, node: Node) -> None:
        old = self.nodes.get(node.id)
        if old is not None and (old.label != node.label or old.layer != node.layer):
            self._unlist(old)
            old = None
        self.nodes[node.id] = node
        if old is None:
            self._by_layer.setdefault(node.layer, {})[node.id] = None
            self._by_label.setdefault(node.label, {})[node.id] = None

    def drop_node(self, node_id: str) -> None:
        self._unlist(self.nodes.pop(node_id))

    def _unlist(self, node: Node) -> None:
        for index, name in ((self._by_layer, node.layer), (self._by_label, node.label)):
            del index[name][node.id]
            if not index[name]:
                del index[name]

    def put_edge(self, edge: Edge) -> None:
        pairs = self._by_relation.setdefault(edge.relation, {})
        pair = (edge.source, edge.target)
        self.n_edges += pair not in pairs
        pairs[pair] = edge
        self._by_source.setdefault(edge.source, {}).setdefault(edge.relation, {})[edge.target] = edge
        self._by_target.setdefault(edge.target, {}).setdefault(edge.relation, {})[edge.source] = edge

    def drop_edge(self, key: EdgeKey) -> None:
        relation, source, target = key
        pairs = self._by_relation[relation]
        del pairs[source, target]
        if not pairs:
            del self._by_relation[relation]
        for index, here, there in ((self._by_source, source, target), (self._by_target, target, source)):
            relations = index[here]
            del relations[relation][there]
            if not relations[relation]:
                del relations[relation]
                if not relations:
                    del index[here]
        self.n_edges -= 1

    def find_nodes(self, layer: str | None, label: str | None) -> list[Node]:
        if layer is None and label is None:
            return list(self.nodes.values())
        if label is None:
            return [self.nodes[i] for i in self._by_layer.get(layer or "", ())]
        labelled = [self.nodes[i] for i in self._by_label.get(label, ())]
        return labelled if layer is None else [node for node in labelled if node.layer == layer]

    def edge(self, relation: str, source: str, target: str) -> Edge | None:
        pairs = self._by_relation.get(relation)
        return None if pairs is None else pairs.get((source, target))

    def find_edges(self, relation: str | None, source: str | None, target: str | None) -> list[Edge]:
        if source is None and target is None:
            if relation is not None:
                return list(self._by_relation.get(relation, {}).values())
            return list(self.all_edges())
        if source is not None and target is not None:
            relations = (relation,) if relation is not None else tuple(self._by_source.get(source, ()))
            found = (self.edge(name, source, target) for name in relations)
            return [edge for edge in found if edge is not None]
        by_relation = self._by_source.get(source, {}) if source is not None else self._by_target.get(target or "", {})
        if relation is not None:
            return list(by_relation.get(relation, {}).values())
        return [edge for there in by_relation.values() for edge in there.values()]

    def all_edges(self) -> Iterator[Edge]:
        for pairs in self._by_relation.values():
            yield from pairs.values()

    def edges_of(self, node_id: str) -> Iterator[Edge]:
        """Every edge that begins or ends at the node (none does both)."""
        for index in (self._by_source, self._by_target):
            for there in index.get(node_id, {}).values():
                yield from there.values()

    def relations(self) -> list[str]:
        return list(self._by_relation)

    def labels(self) -> list[str]:
        return list(self._by_label)
