"""The graph's contents with their indexes: every look-up costs what it finds.

What comes as a table stays one: its nodes and edges are made when they are asked for. What is put later is kept by
value beside it, and crosses out the row that it replaces.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Self, TypeVar, overload

import numpy as np

from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.node import LAYERS, Node
from scenegraph.graph.stored_edges import StoredEdges
from scenegraph.graph.tables import EdgeTable, NodeTable

__all__ = ["GraphIndex", "Nearby", "NodeIndex", "Told"]

_ByPair = dict[tuple[str, str], Edge]
_ByEnd = dict[str, dict[str, dict[str, Edge]]]  # one end -> relation -> the other end -> edge
T = TypeVar("T")
_Names = dict[str, dict[str, None]]


class Nearby(Sequence[tuple[Node, float]]):
    """Nodes by their distance, nearest first, as `(node, distance)` [m]; a node is made when it is looked at.

    ids, distances : of all of them, at once
    """

    def __init__(self, nodes: Sequence[Node | int], table: NodeTable | None, distances: list[float]) -> None:
        """nodes: values, or rows of the table."""
        self._nodes, self._table = nodes, table
        self.distances = tuple(distances)

    @property
    def ids(self) -> tuple[str, ...]:
        rows = () if self._table is None else self._table.ids
        return tuple(rows[node] if isinstance(node, int) else node.id for node in self._nodes)

    def __len__(self) -> int:
        return len(self.distances)

    @overload
    def __getitem__(self, at: int) -> tuple[Node, float]: ...
    @overload
    def __getitem__(self, at: slice) -> Nearby: ...
    def __getitem__(self, at: int | slice) -> tuple[Node, float] | Nearby:
        if isinstance(at, slice):
            return Nearby(self._nodes[at], self._table, list(self.distances[at]))
        node = self._nodes[at]
        if isinstance(node, int):
            assert self._table is not None
            node = self._table[node]
        return node, self.distances[at]

    def __iter__(self) -> Iterator[tuple[Node, float]]:
        rows = np.array([node for node in self._nodes if isinstance(node, int)], np.int64)
        made = iter(() if self._table is None else self._table.rows(rows))
        nodes = (next(made) if isinstance(node, int) else node for node in self._nodes)
        return zip(nodes, self.distances, strict=True)

    def __repr__(self) -> str:
        return f"Nearby({', '.join(f'{i}: {d:.2f} m' for i, d in zip(self.ids, self.distances, strict=True))})"


class Told(NamedTuple):
    """Ids, labels, whether there is a box, and when it was last seen [ns], of some nodes."""

    ids: list[str]
    labels: list[str]
    boxed: list[bool]
    last_seen_ns: list[int]


class NodeIndex(Mapping[str, Node]):
    """Nodes by id, oldest first, each in a slot of its own; nodes of a table have their row as slot."""

    def __init__(self, table: NodeTable | None = None) -> None:
        self.table = table
        self.slot_of: dict[str, int] = {} if table is None else dict(zip(table.ids, range(len(table)), strict=True))
        self.n_slots = len(self.slot_of)
        self._made: list[Node | None] = [None] * self.n_slots
        self._n_unmade = self.n_slots
        self._free: list[int] = []
        self._changed: set[int] = set()

    def copy(self) -> Self:
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        other.slot_of, other._made, other._free = self.slot_of.copy(), self._made.copy(), self._free.copy()
        other._changed = self._changed.copy()
        return other

    def __getitem__(self, node_id: str) -> Node:
        return self.at(self.slot_of[node_id])

    @overload
    def get(self, node_id: str, default: None = None, /) -> Node | None: ...
    @overload
    def get(self, node_id: str, default: Node | T, /) -> Node | T: ...
    def get(self, node_id: str, default: Node | T | None = None, /) -> Node | T | None:
        slot = self.slot_of.get(node_id)
        return default if slot is None else self.at(slot)

    def at(self, slot: int) -> Node:
        """The node in a slot that is taken."""
        node = self._made[slot]
        if node is None:
            assert self.table is not None
            node = self._made[slot] = self.table[slot]
            self._n_unmade -= 1
        return node

    def many(self, slots: list[int]) -> list[Node]:
        """The nodes in these slots, made together."""
        if self._n_unmade:
            made = self._made
            missing = [slot for slot in slots if made[slot] is None]
            if missing:
                assert self.table is not None
                for slot, node in zip(missing, self.table.rows(np.array(missing)), strict=True):
                    made[slot] = node
                self._n_unmade -= len(missing)
        return [self._made[slot] for slot in slots]  # type: ignore[misc]

    def ids_at(self, slots: list[int]) -> list[str]:
        """The ids of the nodes in these slots, none of which is made for it."""
        made, rows = self._made, () if self.table is None else self.table.ids
        return [rows[slot] if (node := made[slot]) is None else node.id for slot in slots]

    def told(self, slots: list[int]) -> Told:
        """What is told of the nodes in these slots, none of which is made for it."""
        table, rows = self.table, []
        for slot in slots:
            node = self._made[slot]
            if node is not None:
                rows.append((node.id, node.label, node.box is not None, node.last_seen_ns))
            else:
                assert table is not None
                label = table.labels[table.label[slot]]
                rows.append((table.ids[slot], label, bool(table.boxed[slot]), int(table.last_seen_ns[slot])))
        return Told(*(list(column) for column in zip(*rows, strict=True))) if rows else Told([], [], [], [])

    def nearby(self, slots: list[int], distances: list[float]) -> Nearby:
        """The nodes in these slots as they are now, not yet made, and their distances."""
        made = self._made
        return Nearby([slot if made[slot] is None else made[slot] for slot in slots], self.table, distances)  # type: ignore[misc]

    def is_made(self, slot: int) -> bool:
        """Whether the node in a slot is a value already, rather than a row of the table."""
        return self._made[slot] is not None

    def put(self, node: Node) -> None:
        slot = self.slot_of.get(node.id)
        if slot is None:
            slot = self._free.pop() if self._free else self.n_slots
            if slot == self.n_slots:
                self._made.append(None)
                self.n_slots += 1
            self.slot_of[node.id] = slot
        elif self._made[slot] is None:
            self._n_unmade -= 1
        self._made[slot] = node
        self._changed.add(slot)

    def drop(self, node_id: str) -> Node:
        node = self[node_id]
        slot = self.slot_of.pop(node_id)
        self._made[slot] = None
        self._changed.discard(slot)
        if self.table is None or slot >= len(self.table):
            self._free.append(slot)  # a row's slot is never given to another: edges of the table name it
        return node

    def __iter__(self) -> Iterator[str]:
        return iter(self.slot_of)

    def __len__(self) -> int:
        return len(self.slot_of)

    def __contains__(self, node_id: object) -> bool:
        return node_id in self.slot_of

    def as_table(self) -> NodeTable:
        """All nodes, oldest first; those that came with a table are not made for it."""
        slots = np.array(list(self.slot_of.values()), np.int64)
        if self.table is None:
            return NodeTable.of(self.all())
        if not self._changed and len(slots) == len(self.table):
            return self.table
        kept = np.array([slot not in self._changed for slot in slots.tolist()], np.bool_)
        changed = NodeTable.of(self.many(slots[~kept].tolist()))
        place = np.empty(len(slots), np.int64)
        place[kept], place[~kept] = np.arange(kept.sum()), kept.sum() + np.arange(len(changed))
        return self.table.take(slots[kept]).joined(changed).take(place)

    def all(self) -> list[Node]:
        """All nodes, oldest first."""
        return self.many(list(self.slot_of.values()))


class GraphIndex:
    """Nodes by id, layer and label; edges by relation, source and target. Knows no rules: what is put, is in."""

    def __init__(self, nodes: NodeTable | None = None, edges: EdgeTable | None = None) -> None:
        self.nodes = NodeIndex(nodes)
        self._by_layer: _Names = {}
        self._by_label: _Names = {}
        self._by_relation: dict[str, _ByPair] = {}
        self._by_source: _ByEnd = {}
        self._by_target: _ByEnd = {}
        self._stored = None if edges is None else StoredEdges(edges)
        self.n_edges = 0 if self._stored is None else len(self._stored)
        if nodes is not None:
            for index, names, code in (
                (self._by_layer, LAYERS, nodes.layer),
                (self._by_label, nodes.labels, nodes.label),
            ):
                ids = np.array(nodes.ids, object)[np.argsort(code, kind="stable")]
                ends = np.cumsum(np.bincount(code, minlength=len(names))).tolist()
                for name, start, end in zip(names, [0, *ends], ends, strict=False):
                    if start < end:
                        index[name] = dict.fromkeys(ids[start:end].tolist())

    def copy(self) -> Self:
        """Another index with the same contents, which changes on its own."""
        other = type(self).__new__(type(self))
        other.nodes = self.nodes.copy()
        other._by_layer = {name: ids.copy() for name, ids in self._by_layer.items()}
        other._by_label = {name: ids.copy() for name, ids in self._by_label.items()}
        other._by_relation = {name: pairs.copy() for name, pairs in self._by_relation.items()}
        other._by_source, other._by_target = (
            {here: {name: there.copy() for name, there in at.items()} for here, at in index.items()}
            for index in (self._by_source, self._by_target)
        )
        other._stored = None if self._stored is None else self._stored.copy()
        other.n_edges = self.n_edges
        return other

    # -- nodes --------------------------------------------------------------------------------------------------------

    def put_node(self, node: Node) -> None:
        old = self.nodes.get(node.id)
        if old is not None and (old.label != node.label or old.layer != node.layer):
            self._unlist(old)
            old = None
        self.nodes.put(node)
        if old is None:
            self._by_layer.setdefault(node.layer, {})[node.id] = None
            self._by_label.setdefault(node.label, {})[node.id] = None

    def drop_node(self, node_id: str) -> None:
        self._unlist(self.nodes.drop(node_id))

    def _unlist(self, node: Node) -> None:
        for index, name in ((self._by_layer, node.layer), (self._by_label, node.label)):
            del index[name][node.id]
            if not index[name]:
                del index[name]

    def find_nodes(self, layer: str | None, label: str | None) -> list[Node]:
        if layer is None and label is None:
            return self.nodes.all()
        if label is None:
            return self._named(self._by_layer.get(layer or "", ()))
        labelled = self._named(self._by_label.get(label, ()))
        return labelled if layer is None else [node for node in labelled if node.layer == layer]

    def _named(self, ids: Iterable[str]) -> list[Node]:
        slot_of = self.nodes.slot_of
        return self.nodes.many([slot_of[node_id] for node_id in ids])

    def labels(self) -> list[str]:
        return list(self._by_label)

    def n_labelled(self, label: str) -> int:
        return len(self._by_label.get(label, ()))

    # -- edges --------------------------------------------------------------------------------------------------------

    def put_edge(self, edge: Edge) -> None:
        pairs = self._by_relation.setdefault(edge.relation, {})
        pair = (edge.source, edge.target)
        if pair not in pairs:
            self._drop_stored(edge.relation, *pair)
            self.n_edges += 1
        pairs[pair] = edge
        self._by_source.setdefault(edge.source, {}).setdefault(edge.relation, {})[edge.target] = edge
        self._by_target.setdefault(edge.target, {}).setdefault(edge.relation, {})[edge.source] = edge

    def drop_edge(self, key: EdgeKey) -> None:
        relation, source, target = key
        if self._drop_stored(relation, source, target):
            return
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

    def __contains__(self, key: EdgeKey) -> bool:
        """Whether there is an edge of this key."""
        relation, source, target = key
        return (source, target) in self._by_relation.get(relation, ()) or self._stored_row(*key) >= 0

    def edge(self, relation: str, source: str, target: str) -> Edge | None:
        pairs = self._by_relation.get(relation)
        edge = None if pairs is None else pairs.get((source, target))
        if edge is None and self._stored is not None:
            row = self._stored_row(relation, source, target)
            return None if row < 0 else self._stored.made(np.array([row]))[0]
        return edge

    def find_edges(self, relation: str | None, source: str | None, target: str | None) -> list[Edge]:
        if source is None and target is None:
            if relation is not None:
                stored = [] if self._stored is None else self._stored.made(self._stored.rows_of(relation))
                return [*stored, *self._by_relation.get(relation, {}).values()]
            return list(self.all_edges())
        if source is not None and target is not None:
            relations = (relation,) if relation is not None else self._relations_from(source)
            found = (self.edge(name, source, target) for name in relations)
            return [edge for edge in found if edge is not None]
        if source is not None:
            return [*self._stored_at(source, relation, begins=True), *_at(self._by_source.get(source), relation)]
        return [
            *self._stored_at(target or "", relation, begins=False),
            *_at(self._by_target.get(target or ""), relation),
        ]

    def all_edges(self) -> Iterator[Edge]:
        if self._stored is not None:
            yield from self._stored
        for pairs in self._by_relation.values():
            yield from pairs.values()

    def edges_of(self, node_id: str) -> Iterator[Edge]:
        """Every edge that begins or ends at the node (none does both)."""
        for begins, index in ((True, self._by_source), (False, self._by_target)):
            yield from self._stored_at(node_id, None, begins=begins)
            yield from _at(index.get(node_id), None)

    def edges_at(self, node_ids: Collection[str], relations: Collection[str]) -> list[Edge]:
        """The edges of these relations that begin or end at any of the nodes, each once."""
        found: list[Edge] = []
        if self._stored is not None:
            slots = self._slots(node_ids)
            rows = [self._stored.rows_at(slots, relations, begins=begins) for begins in (True, False)]
            found += self._stored.made(np.union1d(*rows))
        for node_id in node_ids:
            here, there = self._by_source.get(node_id, {}), self._by_target.get(node_id, {})
            for relation in relations:
                found += here.get(relation, {}).values()
                found += (edge for edge in there.get(relation, {}).values() if edge.source not in node_ids)
        return found

    def targets(self, relation: str, sources: Collection[str]) -> set[str]:
        """Where the edges of a relation end that begin at any of the nodes."""
        found: set[str] = set()
        if self._stored is not None:
            rows = self._stored.rows_at(self._slots(sources), (relation,), begins=True)
            found.update(self._stored.table.ids[row] for row in self._stored.table.target[rows].tolist())
        for node_id in sources:
            found.update(self._by_source.get(node_id, {}).get(relation, ()))
        return found

    def _slots(self, node_ids: Iterable[str]) -> list[int]:
        slot_of = self.nodes.slot_of
        return [slot_of[node_id] for node_id in node_ids if node_id in slot_of]

    def tables(self) -> tuple[NodeTable, EdgeTable]:
        """Everything as tables, in the order of `find_nodes` and `find_edges`."""
        nodes = self.nodes.as_table()
        row_of = {node_id: row for row, node_id in enumerate(nodes.ids)}
        put = EdgeTable.of((e for pairs in self._by_relation.values() for e in pairs.values()), row_of, nodes.ids)
        if self._stored is None:
            return nodes, put
        left = self._stored.left()
        if nodes.ids is not left.ids:
            new_row = np.array([row_of.get(node_id, -1) for node_id in left.ids], np.int32)
            left = left.between(nodes.ids, new_row)
        return nodes, left.joined(put) if len(put) else left

    def relations(self) -> list[str]:
        stored = [] if self._stored is None else self._stored.relations()
        return list(dict.fromkeys([*stored, *self._by_relation]))

    def _relations_from(self, source: str) -> tuple[str, ...]:
        stored = {} if self._stored is None else dict.fromkeys(self._stored.relations())
        return tuple({**stored, **dict.fromkeys(self._by_source.get(source, ()))})

    def _stored_at(self, node_id: str, relation: str | None, *, begins: bool) -> list[Edge]:
        slot = self.nodes.slot_of.get(node_id)
        if self._stored is None or slot is None:
            return []
        rows = self._stored.rows_from(slot, relation) if begins else self._stored.rows_to(slot, relation)
        return self._stored.made(rows)

    def _stored_row(self, relation: str, source: str, target: str) -> int:
        if self._stored is None:
            return -1
        a, b = self.nodes.slot_of.get(source), self.nodes.slot_of.get(target)
        return -1 if a is None or b is None else self._stored.find(relation, a, b)

    def _drop_stored(self, relation: str, source: str, target: str) -> bool:
        """Cross out the row of an edge, if it has one."""
        row = self._stored_row(relation, source, target)
        if row < 0 or self._stored is None:
            return False
        self._stored.drop(row)
        self.n_edges -= 1
        return True


def _at(relations: Mapping[str, Mapping[str, Edge]] | None, relation: str | None) -> Iterator[Edge]:
    """The edges at one end, of one relation if asked."""
    if relations:
        for there in relations.values() if relation is None else (relations.get(relation, {}),):
            yield from there.values()
