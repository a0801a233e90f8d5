"""GraphML: flat attributes, as graph tools expect them."""

from __future__ import annotations

import json
import re
from typing import Any

import networkx as nx

from scenegraph.graph import Edge, Node, SceneGraph

__all__ = ["graphml_text"]

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def graphml_text(graph: SceneGraph) -> str:
    """The graph as GraphML, a directed multigraph.

    Vectors become one number each (`x`, `y`, `z` [m], `size_x` …, `yaw` [rad]); attributes that are not numbers or text
    become JSON text, named `attribute_…`; what is absent is left out. Characters that XML cannot hold become U+FFFD.
    """
    flat = nx.MultiDiGraph()
    for node in graph:
        flat.add_node(node.id, **_node_fields(node))
    for number, edge in enumerate(graph.edges()):
        flat.add_edge(edge.source, edge.target, key=f"e{number}", **_edge_fields(edge))
    return "\n".join(nx.generate_graphml(flat)) + "\n"


def _node_fields(node: Node) -> dict[str, Any]:
    x, y, z = node.position.tolist()
    fields: dict[str, Any] = {"layer": node.layer, "label": _text(node.label), "x": x, "y": y, "z": z}
    if node.box is not None:
        fields.update(zip(("center_x", "center_y", "center_z"), node.box.center.tolist(), strict=True))
        fields.update(zip(("size_x", "size_y", "size_z"), node.box.size.tolist(), strict=True))
        fields["yaw"] = node.box.yaw
        fields["rotation_wxyz"] = json.dumps(node.box.rotation_wxyz.tolist())
    return {**fields, **_seen(node), **_attributes(node)}


def _edge_fields(edge: Edge) -> dict[str, Any]:
    fields: dict[str, Any] = {"relation": edge.relation}
    if edge.value is not None:
        fields["value"] = edge.value
    if edge.threshold is not None:
        fields["threshold"] = edge.threshold
    fields["evidence"] = _text(json.dumps(edge.evidence))
    return {**fields, **_seen(edge), **_attributes(edge)}


def _seen(item: Node | Edge) -> dict[str, Any]:
    return {
        "confidence": item.confidence,
        "first_seen_ns": item.first_seen_ns,
        "last_seen_ns": item.last_seen_ns,
    }


def _attributes(item: Node | Edge) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in item.attributes.items():
        if isinstance(value, str):
            value = _text(value)
        elif not isinstance(value, bool | int | float):
            value = _text(json.dumps(value, ensure_ascii=False))
        fields[_text(f"attribute_{name}")] = value
    return fields


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
