"""networkx, and its node-link JSON, both ways."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import networkx as nx

from scenegraph.errors import GraphUnreadable, InvalidGraphValue, InvariantViolated
from scenegraph.graph import Edge, Node, SceneGraph, Snapshot, Tombstone

__all__ = ["from_networkx", "is_node_link", "node_link_document", "read_node_link"]


def node_link_document(graph: SceneGraph) -> dict[str, Any]:
    """The graph as networkx's node-link mapping of JSON values, its edges under `edges`, keyed by relation."""
    document: dict[str, Any] = nx.node_link_data(graph.to_networkx(), edges="edges")
    document["graph"]["tombstones"] = [stone.model_dump(mode="json") for stone in graph.tombstones()]
    return document


def is_node_link(document: Mapping[str, Any]) -> bool:
    """Whether a JSON mapping is a graph of networkx."""
    return "nodes" in document and "multigraph" in document and ("edges" in document or "links" in document)


def read_node_link(document: Mapping[str, Any]) -> SceneGraph:
    """The graph that `node_link_document` wrote, equal in all but its past. Raises GraphUnreadable."""
    if not is_node_link(document):
        raise GraphUnreadable("not a node-link graph: expected nodes, multigraph and edges (or links)")
    try:
        graph = nx.node_link_graph(dict(document), edges="edges" if "edges" in document else "links")
    except (KeyError, TypeError, ValueError, AttributeError, nx.NetworkXError) as error:
        raise GraphUnreadable(f"not a node-link graph: {type(error).__name__}: {error}") from None
    return from_networkx(graph)


def from_networkx(graph: nx.MultiDiGraph) -> SceneGraph:
    """The scene graph of a networkx graph whose nodes and edges have the fields of `SceneGraph.to_networkx`.

    The key of an edge is its relation, where its data say nothing else. Raises GraphUnreadable, naming the node or
    edge, when a field is missing or wrong.
    """
    told = graph.graph
    if not isinstance(told, dict) or not isinstance(told.get("tombstones", ()), Iterable):
        raise GraphUnreadable("graph: expected revision, stamp_ns and a list of tombstones")
    edges = graph.edges(keys=True, data=True) if graph.is_multigraph() else _unkeyed(graph)
    try:
        nodes = tuple(_node(node_id, data) for node_id, data in graph.nodes(data=True))
        return SceneGraph.from_snapshot(
            Snapshot(
                revision=told.get("revision", 1),
                stamp_ns=told.get("stamp_ns", max((node.last_seen_ns for node in nodes), default=0)),
                nodes=nodes,
                edges=tuple(_edge(*edge) for edge in edges),
                tombstones=tuple(Tombstone.model_validate(stone) for stone in told.get("tombstones", ())),
            )
        )
    except (InvalidGraphValue, InvariantViolated) as error:
        raise GraphUnreadable(str(error), hint="expected the fields of SceneGraph.to_networkx()") from None


def _unkeyed(graph: nx.Graph) -> list[tuple[Any, Any, Any, dict[str, Any]]]:
    return [(source, target, None, data) for source, target, data in graph.edges(data=True)]


def _node(node_id: Any, data: dict[str, Any]) -> Node:
    try:
        return Node.model_validate({**data, "id": node_id})
    except InvalidGraphValue as error:
        raise GraphUnreadable(f"node {node_id!r}: {error}", hint="expected layer, label, position and times") from None


def _edge(source: Any, target: Any, key: Any, data: dict[str, Any]) -> Edge:
    try:
        return Edge.model_validate({"relation": key, **data, "source": source, "target": target})
    except InvalidGraphValue as error:
        raise GraphUnreadable(f"edge {key!r} from {source!r} to {target!r}: {error}") from None
