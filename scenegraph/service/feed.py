"""The graph as others see it: a copy that follows the world by its deltas, publishes them and answers reads.

It has a thread of its own, so that neither a slow subscriber nor the reading of a large graph delays mapping. A
subscriber that stalls holds up this thread at most until Zenoh closes its line (5 s); the deltas wait meanwhile.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator

import zenoh

from scenegraph.errors import SceneGraphError
from scenegraph.graph import Delta, Edge, EdgeChanges, Node, NodeChanges, SceneGraph, Snapshot
from scenegraph.service import keys

__all__ = ["GraphFeed"]

_LOST = -2  # no delta follows it

log = logging.getLogger(__name__)

Publish = Callable[[str, str, "Delta | Node | Edge | None"], None]


class GraphFeed:
    """Follows a graph, publishes its changes and serves reads of it.

    publish : called with the row of the key table, the key, and what is put there (None: deleted)
    """

    def __init__(self, world: str, snapshot: Snapshot, publish: Publish) -> None:
        self._world = world
        self._publish = publish
        self._graph = SceneGraph.from_snapshot(snapshot, history_limit=0)
        self._queue: deque[Delta | Snapshot | None] = deque()
        self._wanted = snapshot.revision
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._follow, name="graph-feed", daemon=True)

    def start(self) -> None:
        """Begin to publish."""
        self._thread.start()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Publish what is queued, then end."""
        with self._changed:
            self._queue.append(None)
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    @property
    def revision(self) -> int:
        """The newest revision handed in."""
        return self._wanted

    def put(self, change: Delta | Snapshot) -> None:
        """Hand in the next delta, or the whole graph when deltas are missing. Never waits."""
        with self._changed:
            self._queue.append(change)
            self._wanted = change.revision
            self._changed.notify_all()

    # -- reading -------------------------------------------------------------------------------------------------

    def snapshot(self, timeout_s: float = 5.0) -> Snapshot:
        """The graph, no older than what had been handed in at the call."""
        with self._changed:
            self._catch_up(timeout_s)
            return self._graph.snapshot()

    def node(self, node_id: str) -> Node | None:
        """One node, or None."""
        with self._changed:
            return self._graph.node(node_id) if node_id in self._graph else None

    def matches(self, expression: str, timeout_s: float = 5.0) -> Iterator[tuple[str, Node | Edge]]:
        """The nodes and edges whose keys the expression matches, with their keys."""
        parts = expression.split("/")[3:]
        with self._changed:
            self._catch_up(timeout_s)
            nodes, edges = self._candidates(parts)
        wanted = zenoh.KeyExpr(expression)
        for node in nodes:
            where = keys.node(self._world, node.layer, node.id)
            if wanted.intersects(where):
                yield where, node
        for edge in edges:
            where = keys.edge(self._world, edge.relation, edge.source, edge.target)
            if wanted.intersects(where):
                yield where, edge

    def _catch_up(self, timeout_s: float) -> None:
        wanted = self._wanted
        self._changed.wait_for(lambda: self._graph.revision >= wanted or not self._thread.is_alive(), timeout_s)

    def _candidates(self, parts: list[str]) -> tuple[list[Node], list[Edge]]:
        """What can match, by index where the expression names it: cost by the answer, not by the graph."""
        fixed = [None if "*" in part else part for part in parts]
        if len(parts) == 4 and parts[:2] == ["graph", "nodes"] and fixed[3] is not None:
            return ([self._graph.node(parts[3])] if parts[3] in self._graph else []), []
        if len(parts) == 5 and parts[:2] == ["graph", "edges"] and "**" not in parts:
            return [], self._graph.edges(fixed[2], fixed[3], fixed[4])
        nodes = [] if parts[:2] == ["graph", "edges"] else self._graph.nodes()
        edges = [] if parts[:2] == ["graph", "nodes"] else self._graph.edges()
        return nodes, edges

    # -- following -----------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._queue))
                change = self._queue.popleft()
                if change is None:
                    return
                try:
                    delta, layers = self._take(change)
                except SceneGraphError:
                    log.exception(
                        "revision %d does not fit the copy: the next change brings the whole", change.revision
                    )
                    self._wanted = _LOST
                    continue
                finally:
                    self._changed.notify_all()
            try:
                self._tell(delta, layers)
            except zenoh.ZError:  # the line is closing; the copy itself is up to date
                log.exception("revision %d could not be published", delta.revision)

    def _take(self, change: Delta | Snapshot) -> tuple[Delta, dict[str, str]]:
        """Bring the copy up to date; returns the delta to publish and the layers of the nodes it deletes."""
        before = self._graph
        delta = _difference(before, change) if isinstance(change, Snapshot) else change
        layers: dict[str, str] = {i: before.node(i).layer for i in delta.nodes.deleted if i in before}
        if isinstance(change, Snapshot):
            self._graph = SceneGraph.from_snapshot(change, history_limit=0)
        else:
            self._graph.apply(change)
        return delta, layers

    def _tell(self, delta: Delta, layers: dict[str, str]) -> None:
        world = self._world
        self._publish("graph/delta", keys.key(world, "graph/delta"), delta)
        for edge in delta.edges.deleted:
            self._publish(_EDGES, keys.edge(world, *edge), None)
        for node_id in delta.nodes.deleted:
            if node_id in layers:
                self._publish(_NODES, keys.node(world, layers[node_id], node_id), None)
        for node in delta.nodes.put:
            self._publish(_NODES, keys.node(world, node.layer, node.id), node)
        for put in delta.edges.put:
            self._publish(_EDGES, keys.edge(world, put.relation, put.source, put.target), put)


_NODES = "graph/nodes/{layer}/{id}"
_EDGES = "graph/edges/{relation}/{source}/{target}"


def _difference(before: SceneGraph, after: Snapshot) -> Delta:
    """What changed between two states. Its number does not follow, so mirrors will ask for the snapshot."""
    nodes = {node.id: node for node in after.nodes}
    edges = {edge.key: edge for edge in after.edges}
    known = {edge.key: edge for edge in before.edges()}
    return Delta.model_construct(
        revision=after.revision,
        stamp_ns=after.stamp_ns,
        nodes=NodeChanges.model_construct(
            put=tuple(node for node in after.nodes if node.id not in before or before.node(node.id) != node),
            deleted=tuple(node.id for node in before.nodes() if node.id not in nodes),
        ),
        edges=EdgeChanges.model_construct(
            put=tuple(edge for key, edge in edges.items() if known.get(key) != edge),
            deleted=tuple(key for key in known if key not in edges),
        ),
        tombstones=tuple(stone for stone in after.tombstones if before.tombstone(stone.id) != stone),
    )
