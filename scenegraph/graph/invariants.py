"""What must hold of the graph after every change. Each check looks at the change only, never at the whole graph."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from scenegraph.errors import DanglingEdge, InvariantViolated, nearest
from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.node import Node

__all__ = ["check_edges_have_ends", "check_layers_stay", "check_no_edge_is_left"]


def check_edges_have_ends(edges: Iterable[Edge | None], exists: Callable[[str], bool], known: Iterable[str]) -> None:
    """Every edge put joins two nodes that exist after the change, or `DanglingEdge`."""
    for edge in edges:
        if edge is None:
            continue
        for end, node_id in (("source", edge.source), ("target", edge.target)):
            if not exists(node_id):
                names = nearest(node_id, known)
                raise DanglingEdge(
                    f"{edge.relation}({edge.source}, {edge.target}): its {end} {node_id!r} is not a node of the graph",
                    hint=f"nearest ids: {', '.join(names)}" if names else "put the node in the same change",
                )


def check_layers_stay(before: Mapping[str, Node], after: Mapping[str, Node | None]) -> None:
    """No node moves to another layer: its key on the wire holds the layer."""
    for node_id, node in after.items():
        old = before.get(node_id)
        if node is not None and old is not None and node.layer != old.layer:
            raise InvariantViolated(
                f"{node_id}: a node of layer {old.layer!r} cannot become one of layer {node.layer!r}",
                hint="delete it and put a node with a new id, naming it as what the old one became",
            )


def check_no_edge_is_left(
    deleted: Iterable[str], edges_of: Callable[[str], Iterable[Edge]], dropped: Mapping[EdgeKey, Edge | None]
) -> None:
    """With a node go all its edges: a delta that forgets one is refused."""
    for node_id in deleted:
        for edge in edges_of(node_id):
            if dropped.get(edge.key, edge) is not None:
                raise InvariantViolated(
                    f"{node_id} is deleted, but its edge {edge.relation}({edge.source}, {edge.target}) is not"
                )
