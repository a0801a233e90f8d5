"""The scene graph: nodes and edges, changed by numbered deltas, with a remembered past."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Any, Self

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenegraph.errors import InvalidGraphValue, InvariantViolated, RevisionGap, UnknownNode, nearest
from scenegraph.graph.delta import Delta, EdgeChanges, GraphChanges, NodeChanges, NodeDeletion, Snapshot
from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.history import Change, History, Life, Undo
from scenegraph.graph.index import GraphIndex, Nearby, Told
from scenegraph.graph.invariants import check_edges_have_ends, check_layers_stay, check_no_edge_is_left
from scenegraph.graph.node import Layer, Node, Tombstone
from scenegraph.graph.spatial import SpatialIndex
from scenegraph.graph.tables import EdgeTable, NodeTable

__all__ = ["SceneGraph"]


class SceneGraph:
    """A directed multigraph of typed nodes and relations.

    Every change is a `commit`, carried out as a whole or not at all, at a cost that depends on the change and not on
    the size of the graph; it yields a numbered `Delta`. Another graph that `apply`s the deltas equals this one. Deleted
    nodes leave tombstones, kept for good (a few hundred bytes each). The past is kept as `History` states its bound.
    Not thread-safe: one thread owns a graph. Nodes and edges are frozen and may be shared freely.
    """

    def __init__(self, *, history_limit: int = 100_000) -> None:
        self._index = GraphIndex()
        self._space: SpatialIndex | None = None
        self._tombstones: dict[str, Tombstone] = {}
        self._history = History(history_limit)
        self._revision = 0
        self._stamp_ns = 0

    # -- reading ------------------------------------------------------------------------------------------------------

    @property
    def revision(self) -> int:
        """How many changes made the graph; 0 when empty and new."""
        return self._revision

    @property
    def stamp_ns(self) -> int:
        """When the graph last changed; 0 when it never did."""
        return self._stamp_ns

    @property
    def history(self) -> History:
        """What is remembered of the past."""
        return self._history

    def nodes(self, layer: Layer | None = None, label: str | None = None) -> list[Node]:
        """The nodes, of one layer or label if asked; oldest first. The cost depends on the result."""
        return self._index.find_nodes(layer, label)

    def edges(self, relation: str | None = None, source: str | None = None, target: str | None = None) -> list[Edge]:
        """The edges that have the relation, source and target asked for. The cost depends on the result."""
        return self._index.find_edges(relation, source, target)

    def edges_of(self, node_id: str) -> list[Edge]:
        """Every edge that begins or ends at the node."""
        return list(self._index.edges_of(node_id))

    def within(self, p_map: ArrayLike, radius_m: float, layer: Layer | None = None) -> Nearby:
        """The nodes within reach of a point (3,) [m] with their distances, nearest first: `for node, distance in …`.

        The distance is that to the oriented box, 0 inside; a node without a box is a point. The cost depends on what
        is there; the first question of this kind builds an index that every change then keeps.
        """
        p = np.array(p_map, dtype=np.float64)
        if p.shape != (3,) or not np.isfinite(p).all() or not radius_m >= 0.0:
            raise InvalidGraphValue(f"within: expected a point (3,) and a radius ≥ 0, got {p_map!r} and {radius_m!r}")
        slots, distances = self.space.within(p, radius_m, layer)
        return self._index.nodes.nearby(slots, distances)

    def in_box(self, low: ArrayLike, high: ArrayLike, layer: Layer | None = None) -> list[Node]:
        """The nodes whose oriented boxes have a point between two corners (3,) [m]; the cost is that of `within`."""
        a, b = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
        if a.shape != (3,) or b.shape != (3,) or not (a <= b).all():
            raise InvalidGraphValue(f"in_box: expected a lower and a higher corner (3,), got {low!r} and {high!r}")
        return self._index.nodes.many(self.space.in_box(a, b, layer).tolist())

    def node(self, node_id: str) -> Node:
        """The node of this id. Raises UnknownNode, whose hint says what became of it, or names the nearest ids."""
        node = self._index.nodes.get(node_id)
        if node is None:
            raise UnknownNode(f"no node is called {node_id!r}", hint=self._hint(node_id))
        return node

    def edge(self, relation: str, source: str, target: str) -> Edge | None:
        """The one edge of this key, or None."""
        return self._index.edge(relation, source, target)

    def tombstone(self, node_id: str) -> Tombstone | None:
        """What became of a deleted node, or None when it lives or never lived."""
        return self._tombstones.get(node_id)

    def tombstones(self) -> list[Tombstone]:
        """What became of all deleted nodes, oldest first."""
        return list(self._tombstones.values())

    def successor(self, node_id: str) -> Node | None:
        """The living node that this id names today, through any merges; None when it vanished or never was."""
        seen = set()
        current: str | None = node_id
        while current is not None and current not in seen:
            node = self._index.nodes.get(current)
            if node is not None:
                return node
            seen.add(current)
            stone = self._tombstones.get(current)
            current = stone.became if stone is not None else None
        return None

    def relations(self) -> list[str]:
        """The names of the relations that join anything."""
        return self._index.relations()

    def labels(self) -> list[str]:
        """The labels that any node has."""
        return self._index.labels()

    def n_labelled(self, label: str) -> int:
        """How many nodes have a label."""
        return self._index.n_labelled(label)

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return self._index.n_edges

    def __len__(self) -> int:
        return len(self._index.nodes)

    def __contains__(self, item: object) -> bool:
        """Whether a node of this id, or an edge of this `(relation, source, target)`, is in the graph."""
        if isinstance(item, str):
            return item in self._index.nodes
        if isinstance(item, tuple) and len(item) == 3:
            return self._index.edge(*item) is not None
        return False

    def __iter__(self) -> Iterator[Node]:
        return iter(self._index.nodes.all())

    def __bool__(self) -> bool:
        return True  # an empty graph is still a graph: `graph or default` must not drop it

    def __eq__(self, other: object) -> bool:
        """Equal revision, nodes, edges and tombstones, in whatever order they came. The past does not count."""
        if not isinstance(other, SceneGraph):
            return NotImplemented
        return (
            self._revision == other._revision
            and self._index.nodes == other._index.nodes
            and self._index.n_edges == other._index.n_edges
            and all(other._index.edge(*edge.key) == edge for edge in self._index.all_edges())
            and self._tombstones == other._tombstones
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"SceneGraph(revision={self._revision}, nodes={len(self)}, edges={self.n_edges})"

    def to_networkx(self) -> nx.MultiDiGraph:
        """A copy as networkx graph: nodes by id, edges keyed by relation, both with their wire fields as data."""
        graph = nx.MultiDiGraph(revision=self._revision, stamp_ns=self._stamp_ns)
        for node in self:
            graph.add_node(node.id, **node.model_dump(exclude={"id"}))
        for edge in self._index.all_edges():
            graph.add_edge(edge.source, edge.target, key=edge.relation, **edge.model_dump(exclude={"source", "target"}))
        return graph

    # -- by slot: for work on many nodes as arrays, until the next change ---------------------------------------------

    @property
    def space(self) -> SpatialIndex:
        """Where the nodes are, by slot; built when first asked for, and kept by every change."""
        if self._space is None:
            self._space = SpatialIndex(self._index.nodes)
        return self._space

    def slots(self, node_ids: Collection[str]) -> NDArray[np.int32]:
        """The slots (k,) of nodes that are there; raises KeyError for one that is not."""
        slot_of = self._index.nodes.slot_of
        return np.fromiter((slot_of[node_id] for node_id in node_ids), np.int32, len(node_ids))

    def ids_at(self, slots: NDArray[np.integer[Any]]) -> list[str]:
        """The ids of the nodes in slots (k,)."""
        return self._index.nodes.ids_at(slots.tolist())

    def told(self, slots: NDArray[np.integer[Any]]) -> Told:
        """What there is to know of the nodes in slots (k,) beside their boxes, without making them."""
        return self._index.nodes.told(slots.tolist())

    def edges_at(self, node_ids: Collection[str], relations: Collection[str]) -> list[Edge]:
        """The edges of these relations that begin or end at any of the nodes, each once."""
        return self._index.edges_at(node_ids, relations)

    def targets(self, relation: str, sources: Collection[str]) -> set[str]:
        """Where the edges of a relation end that begin at any of the nodes; the edges are not made."""
        return self._index.targets(relation, sources)

    # -- changing -----------------------------------------------------------------------------------------------------

    def commit(self, changes: GraphChanges, stamp_ns: int) -> Delta:
        """Carry out the changes, all or none, and return what was changed.

        Puts that change nothing are dropped; when nothing is left, the delta is empty and the revision stays. Deleting
        a node deletes its edges. A `stamp_ns` before the last change's counts as that: the graph's past has one order.
        Raises UnknownNode (deleting or becoming what is not there), DanglingEdge, InvariantViolated.
        """
        stamp_ns = max(stamp_ns, self._stamp_ns) if self._revision else stamp_ns
        after, before = self._settle(changes, stamp_ns)
        check_edges_have_ends(after.edges.values(), lambda i: self._lives(i, after), self._index.nodes)
        check_layers_stay(self._index.nodes, after.nodes)
        if not after.nodes and not after.edges:
            return Delta.model_construct(revision=self._revision, stamp_ns=stamp_ns)
        delta = Delta.model_construct(
            revision=self._revision + 1,
            stamp_ns=stamp_ns,
            nodes=NodeChanges.model_construct(
                put=tuple(node for node in after.nodes.values() if node is not None),
                deleted=tuple(node_id for node_id, node in after.nodes.items() if node is None),
            ),
            edges=EdgeChanges.model_construct(
                put=tuple(edge for edge in after.edges.values() if edge is not None),
                deleted=tuple(key for key, edge in after.edges.items() if edge is None),
            ),
            tombstones=tuple(stone for stone in after.tombstones.values() if stone is not None),
        )
        self._carry_out(after, before, delta.revision, stamp_ns)
        return delta

    def apply(self, delta: Delta) -> None:
        """Follow another graph by its delta, all or nothing.

        Raises RevisionGap when the delta is not the next one, InvariantViolated when it does not fit this graph. An
        empty delta of the current revision changes nothing.
        """
        if delta.revision == self._revision and not delta:
            return
        if delta.revision != self._revision + 1 or not delta:
            raise RevisionGap(self._revision, delta.revision)
        after = Change(
            nodes={**dict.fromkeys(delta.nodes.deleted), **{node.id: node for node in delta.nodes.put}},
            edges={**dict.fromkeys(delta.edges.deleted), **{edge.key: edge for edge in delta.edges.put}},
            tombstones={**dict.fromkeys(node.id for node in delta.nodes.put if node.id in self._tombstones)},
        )
        after.tombstones.update((stone.id, stone) for stone in delta.tombstones)
        for node_id in delta.nodes.deleted:
            if node_id not in self._index.nodes:
                raise InvariantViolated(f"delta {delta.revision} deletes {node_id!r}, which is not there")
        for key in delta.edges.deleted:
            if self._index.edge(*key) is None:
                raise InvariantViolated(
                    f"delta {delta.revision} deletes {key.relation}({key.source}, {key.target}), which is not there"
                )
        check_edges_have_ends(after.edges.values(), lambda i: self._lives(i, after), self._index.nodes)
        check_layers_stay(self._index.nodes, after.nodes)
        check_no_edge_is_left(delta.nodes.deleted, self._index.edges_of, after.edges)
        before = Change(
            nodes={node_id: self._index.nodes.get(node_id) for node_id in after.nodes},
            edges={key: self._index.edge(*key) for key in after.edges},
            tombstones={node_id: self._tombstones.get(node_id) for node_id in after.tombstones},
        )
        self._carry_out(after, before, delta.revision, delta.stamp_ns)

    def _settle(self, changes: GraphChanges, stamp_ns: int) -> tuple[Change, Change]:
        """What the graph will differ in once the wishes are carried out in order, and how that is before."""
        index = self._index
        nodes: dict[str, Node | None] = {}
        edges: dict[EdgeKey, Edge | None] = {}
        put_at: dict[str, list[EdgeKey]] = {}
        stones: dict[str, Tombstone] = {}
        for step in changes.steps:
            if isinstance(step, Node):
                nodes[step.id] = step
            elif isinstance(step, Edge):
                key = step.key
                edges[key] = step
                put_at.setdefault(step.source, []).append(key)
                put_at.setdefault(step.target, []).append(key)
            elif isinstance(step, NodeDeletion):
                if step.id not in nodes and step.id not in index.nodes:
                    raise UnknownNode(f"cannot delete {step.id!r}: no node is called so", hint=self._hint(step.id))
                nodes[step.id] = None
                edges.update((edge.key, None) for edge in index.edges_of(step.id))
                edges.update((key, None) for key in put_at.pop(step.id, ()))
                stones[step.id] = Tombstone(id=step.id, became=step.became, reason=step.reason, stamp_ns=stamp_ns)
            else:
                edges[step] = None
        old_nodes = {i: index.nodes.get(i) for i in nodes}
        nodes = {i: node for i, node in nodes.items() if old_nodes[i] != node}
        gone = {i for i, node in nodes.items() if node is None}  # a put that joins one of these is no news, but wrong
        old_edges = {key: index.edge(*key) for key in edges}
        edges = {
            key: edge
            for key, edge in edges.items()
            if old_edges[key] != edge or (edge is not None and not gone.isdisjoint((edge.source, edge.target)))
        }
        tombstones: dict[str, Tombstone | None] = {}
        for node_id, node in nodes.items():
            if node is None:
                tombstones[node_id] = self._last_words(stones[node_id], stones, nodes)
            elif node_id in self._tombstones:
                tombstones[node_id] = None
        after = Change(nodes, edges, tombstones)
        self._check_becoming(after)
        before = Change(
            nodes={node_id: old_nodes[node_id] for node_id in nodes},
            edges={key: old_edges[key] for key in edges},
            tombstones={node_id: self._tombstones.get(node_id) for node_id in tombstones},
        )
        return after, before

    def _last_words(self, stone: Tombstone, stones: dict[str, Tombstone], nodes: dict[str, Node | None]) -> Tombstone:
        """The stone, looking past nodes that these changes both put and deleted: nobody ever heard of those."""
        became, seen = stone.became, {stone.id}
        while became in stones and became not in nodes and became not in self._index.nodes and became not in seen:
            seen.add(became)
            became = stones[became].became
        return stone if became == stone.became else stone.model_copy(update={"became": became})

    def _check_becoming(self, after: Change) -> None:
        """What a node became lives, or has a tombstone of its own; nothing becomes itself, however indirectly."""
        for stone in after.tombstones.values():
            if stone is None or stone.became is None:
                continue
            heir, seen = stone.became, {stone.id}
            while not self._lives(heir, after):
                next_stone = after.tombstones.get(heir) or self._tombstones.get(heir)
                if next_stone is None:
                    raise UnknownNode(f"{stone.id} cannot become {heir!r}: no node is called so", hint=self._hint(heir))
                if heir in seen:
                    raise InvariantViolated(f"{stone.id} cannot become {stone.became}: that became {stone.id}")
                if next_stone.became is None:
                    break
                seen.add(heir)
                heir = next_stone.became

    def _lives(self, node_id: str, after: Change) -> bool:
        """Whether the node exists once the change is carried out."""
        return (after.nodes[node_id] is not None) if node_id in after.nodes else node_id in self._index.nodes

    def _carry_out(self, after: Change, before: Change, revision: int, stamp_ns: int) -> None:
        """Install a checked change and remember what it replaces."""
        self._install(after)
        self._history.remember(Undo(revision, stamp_ns, self._stamp_ns, before))
        self._revision = revision
        self._stamp_ns = stamp_ns

    def _install(self, after: Change) -> None:
        index = self._index
        for key, edge in after.edges.items():
            if edge is not None:
                index.put_edge(edge)
            elif key in index:
                index.drop_edge(key)
        for node_id, node in after.nodes.items():
            if node is not None:
                index.put_node(node)
                if self._space is not None:
                    self._space.put(index.nodes.slot_of[node_id], node)
            elif node_id in index.nodes:
                if self._space is not None:
                    self._space.drop(index.nodes.slot_of[node_id])
                index.drop_node(node_id)
        for node_id, stone in after.tombstones.items():
            self._tombstones.pop(node_id, None)
            if stone is not None:
                self._tombstones[node_id] = stone

    # -- the whole, and the past --------------------------------------------------------------------------------------

    def as_of(self, stamp_ns: int) -> SceneGraph:
        """A graph of its own as this one was at that time: after the last change stamped `stamp_ns` or earlier.

        Costs the size of the graph and of the changes since. Its own history begins there.
        Raises HistoryUnavailable when the time lies before the remembered past.
        """
        steps = self._history.since(stamp_ns, self._revision, self._stamp_ns)
        graph = SceneGraph(history_limit=self._history.limit)
        graph._index, graph._tombstones = self._index.copy(), self._tombstones.copy()
        graph._revision, graph._stamp_ns = self._revision, self._stamp_ns
        for undo in steps:
            graph._install(undo.before)
            graph._revision = undo.revision - 1
            graph._stamp_ns = undo.previous_stamp_ns
        return graph

    def life(self, item: str | tuple[str, str, str]) -> Life:
        """When a node, or an edge (relation, source, target), was seen and was part of the graph.

        Raises UnknownNode when nothing of that name is there, nor was in the remembered past.
        """
        if isinstance(item, str):
            found = self._history.life(item, self._index.nodes.get(item))
        else:
            found = self._history.life(EdgeKey(*item), self._index.edge(*item))
        if found is None:
            name = repr(item) if isinstance(item, str) else f"{item[0]}({item[1]}, {item[2]})"
            hint = self._hint(item) if isinstance(item, str) else None
            raise UnknownNode(f"nothing is called {name}, nor was in the remembered past", hint=hint)
        return found

    def snapshot(self) -> Snapshot:
        """The whole graph as one value."""
        return Snapshot.model_construct(
            revision=self._revision,
            stamp_ns=self._stamp_ns,
            nodes=tuple(self._index.nodes.all()),
            edges=tuple(self._index.all_edges()),
            tombstones=tuple(self._tombstones.values()),
        )

    def tables(self) -> tuple[NodeTable, EdgeTable]:
        """All nodes and edges as tables, which `from_tables` takes; what came as tables costs next to nothing."""
        return self._index.tables()

    @classmethod
    def from_tables(
        cls,
        nodes: NodeTable,
        edges: EdgeTable | None = None,
        *,
        revision: int = 1,
        stamp_ns: int | None = None,
        tombstones: Iterable[Tombstone] = (),
        history: History | None = None,
    ) -> Self:
        """A graph of many nodes and edges at once; the edges' table is one of the nodes' ids.

        The tables are kept as they are, and a node or edge is made when it is asked for. Without `history` the past
        begins here, and without `stamp_ns` the graph is as old as what was seen last. Raises InvariantViolated when the
        tables are not a consistent graph.
        """
        if edges is not None and edges.ids is not nodes.ids and edges.ids != nodes.ids:
            raise InvariantViolated("the tables of edges and nodes differ in their nodes")
        graph = cls()
        graph._index = GraphIndex(nodes, edges)
        graph._history = History() if history is None else history
        graph._tombstones = {stone.id: stone for stone in tombstones}
        graph._revision = revision
        graph._stamp_ns = int(nodes.last_seen_ns.max(initial=0)) if stamp_ns is None else stamp_ns
        return graph

    @classmethod
    def from_snapshot(
        cls, snapshot: Snapshot, *, history: list[Any] | None = None, history_limit: int = 100_000
    ) -> Self:
        """A graph with the snapshot's contents; `history` is what `graph.history.document()` gave.

        Without it the past begins at the snapshot. Raises InvariantViolated when the snapshot is not a consistent
        graph.
        """
        graph = cls(history_limit=history_limit)
        for node in snapshot.nodes:
            if node.id in graph._index.nodes:
                raise InvariantViolated(f"snapshot: node {node.id!r} is there twice")
            graph._index.put_node(node)
        check_edges_have_ends(snapshot.edges, graph._index.nodes.__contains__, graph._index.nodes)
        for edge in snapshot.edges:
            graph._index.put_edge(edge)
        if graph.n_edges != len(snapshot.edges):
            raise InvariantViolated("snapshot: an edge is there twice")
        graph._tombstones = {stone.id: stone for stone in snapshot.tombstones}
        if history is not None:
            graph._history = History.from_document(history, history_limit)
        graph._revision = snapshot.revision
        graph._stamp_ns = snapshot.stamp_ns
        return graph

    def _hint(self, node_id: str) -> str | None:
        stone = self._tombstones.get(node_id)
        if stone is not None:
            return f"it became {stone.became}: {stone.reason}" if stone.became else f"it is no more: {stone.reason}"
        names = nearest(node_id, self._index.nodes)
        return f"nearest ids: {', '.join(names)}" if names else None
