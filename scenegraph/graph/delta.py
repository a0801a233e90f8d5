"""Changes of the graph: what is asked for (`GraphChanges`), what was done (`Delta`), and the whole (`Snapshot`)."""

from __future__ import annotations

from pydantic import Field

from scenegraph.errors import InvalidGraphValue
from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.node import Node, Tombstone
from scenegraph.graph.values import Identifier, Value, valid_identifier

__all__ = ["Delta", "EdgeChanges", "GraphChanges", "NodeChanges", "NodeDeletion", "Snapshot"]


class NodeChanges(Value):
    """Nodes put (new or changed) and the ids of nodes deleted; no id is in both."""

    put: tuple[Node, ...] = ()
    deleted: tuple[Identifier, ...] = ()


class EdgeChanges(Value):
    """Edges put (new or changed) and the keys of edges deleted; no key is in both."""

    put: tuple[Edge, ...] = ()
    deleted: tuple[EdgeKey, ...] = ()


class Delta(Value):
    """A numbered change set. Applied in order to an empty graph, deltas rebuild it.

    revision   : the graph's revision after the change; a delta without changes repeats the revision before it
    stamp_ns   : when the graph changed; never earlier than the delta before
    nodes, edges : what was put and deleted; a deleted node's edges are among the deleted edges
    tombstones : what became of the deleted nodes
    """

    revision: int = Field(ge=0)
    stamp_ns: int
    nodes: NodeChanges = NodeChanges()
    edges: EdgeChanges = EdgeChanges()
    tombstones: tuple[Tombstone, ...] = ()

    def __len__(self) -> int:
        return len(self.nodes.put) + len(self.nodes.deleted) + len(self.edges.put) + len(self.edges.deleted)

    def __bool__(self) -> bool:
        return len(self) > 0


class Snapshot(Value):
    """The whole graph at one revision, nodes and edges in a fixed order."""

    revision: int = Field(ge=0)
    stamp_ns: int
    nodes: tuple[Node, ...] = ()
    edges: tuple[Edge, ...] = ()
    tombstones: tuple[Tombstone, ...] = ()


class NodeDeletion(Value):
    """A wish to delete a node: why, and the id it was merged into, if it was."""

    id: Identifier
    reason: str
    became: Identifier | None = None


class GraphChanges:
    """Wishes to change the graph, collected in order and carried out by `SceneGraph.commit`, all or none.

    Later wishes win over earlier ones about the same node or edge. Deleting a node also deletes the edges put to it
    before. An edge may be put before the nodes it joins.
    """

    __slots__ = ("_steps",)

    def __init__(self) -> None:
        self._steps: list[Node | Edge | NodeDeletion | EdgeKey] = []

    def put(self, item: Node | Edge) -> None:
        """Add or replace one node or edge."""
        if not isinstance(item, Node | Edge):
            raise InvalidGraphValue(f"GraphChanges.put: expected a Node or an Edge, got {type(item).__name__}")
        self._steps.append(item)

    def delete_node(self, node_id: str, reason: str, became: str | None = None) -> None:
        """Delete a node with all its edges; it leaves a tombstone that says why, and which node it became part of."""
        self._steps.append(NodeDeletion(id=node_id, reason=reason, became=became))

    def delete_edge(self, relation: str, source: str, target: str) -> None:
        """Delete one edge; nothing happens when it is not there."""
        for field, text in (("relation", relation), ("source", source), ("target", target)):
            if not valid_identifier(text):
                raise InvalidGraphValue(f"GraphChanges.delete_edge: {field}: expected [a-z][a-z0-9_]*, got {text!r}")
        self._steps.append(EdgeKey(relation, source, target))

    def extend(self, other: GraphChanges) -> None:
        """Append another's wishes after these."""
        self._steps.extend(other._steps)

    @property
    def steps(self) -> tuple[Node | Edge | NodeDeletion | EdgeKey, ...]:
        """The wishes, in order."""
        return tuple(self._steps)

    def __len__(self) -> int:
        return len(self._steps)

    def __bool__(self) -> bool:
        return bool(self._steps)
