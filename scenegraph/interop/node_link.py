"""networkx's node-link JSON."""

from __future__ import annotations

from typing import Any

import networkx as nx

from scenegraph.graph import SceneGraph

__all__ = ["node_link_document"]


def node_link_document(graph: SceneGraph) -> dict[str, Any]:
    """The graph as networkx's node-link mapping of JSON values, its edges under `edges`, keyed by relation."""
    document: dict[str, Any] = nx.node_link_data(graph.to_networkx(), edges="edges")
    return document
