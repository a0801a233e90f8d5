"""GraphML, both ways: flat attributes, as graph tools expect them."""

from __future__ import annotations

import json
import re
from typing import Any

import networkx as nx

from scenegraph.errors import GraphUnreadable
from scenegraph.graph import Edge, Node, SceneGraph
from scenegraph.interop.node_link import from_networkx

__all__ = ["graphml_text", "read_graphml"]

_PREFIX = "attribute_"

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def graphml_text(graph: SceneGraph) -> str:
    """The graph as GraphML, a directed multigraph.

    Vectors become one number each (`x`, `y`, `z` [m], `size_x` …, `yaw` [rad]); attributes that are not numbers or text
    become JSON text, named `attribute_…`, and listed in `json`; what is absent is left out. Characters that XML cannot
    hold become U+FFFD in labels, and names of attributes.
    """
    tombstones = [stone.model_dump(mode="json") for stone in graph.tombstones()]
    flat = nx.MultiDiGraph(revision=graph.revision, stamp_ns=graph.stamp_ns, tombstones=json.dumps(tombstones))
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
    encoded = []
    for name, value in item.attributes.items():
        field = _text(f"{_PREFIX}{name}")
        plain = isinstance(value, bool | int | float) or (
            isinstance(value, str) and value != "" and value == _text(value) and "\r" not in value
        )
        if not plain:
            value = json.dumps(value)
            encoded.append(field)
        fields[field] = value
    return {**fields, **({"json": " ".join(map(json.dumps, encoded))} if encoded else {})}


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)


def read_graphml(text: str) -> SceneGraph:
    """The graph that `graphml_text` wrote, equal in all but its past and the characters that XML cannot hold.

    Raises GraphUnreadable when the text is not GraphML, or lacks our fields.
    """
    try:
        flat = nx.parse_graphml(text, force_multigraph=True)
    except (SyntaxError, KeyError, ValueError, TypeError, nx.NetworkXError) as error:
        raise GraphUnreadable(f"not GraphML: {type(error).__name__}: {error}") from None
    graph = nx.MultiDiGraph(**flat.graph)
    for name in ("node_default", "edge_default"):
        graph.graph.pop(name, None)
    try:
        graph.graph["tombstones"] = json.loads(graph.graph.get("tombstones", "[]"))
        for node_id, fields in flat.nodes(data=True):
            graph.add_node(node_id, **_read_node(fields))
        for source, target, fields in flat.edges(data=True):
            graph.add_edge(source, target, fields.get("relation"), **_read_edge(fields))
    except (KeyError, TypeError, ValueError) as error:
        raise GraphUnreadable(f"GraphML without the fields of a scene graph: {type(error).__name__}: {error}") from None
    return from_networkx(graph)


def _read_node(fields: dict[str, Any]) -> dict[str, Any]:
    data = {"label": "", **_own(fields), "position": [fields[axis] for axis in "xyz"]}
    if "rotation_wxyz" in fields:
        data["box"] = {
            "center": [fields[f"center_{axis}"] for axis in "xyz"],
            "size": [fields[f"size_{axis}"] for axis in "xyz"],
            "rotation_wxyz": json.loads(fields["rotation_wxyz"]),
        }
    return data


def _read_edge(fields: dict[str, Any]) -> dict[str, Any]:
    return {**_own(fields), "evidence": json.loads(fields.get("evidence", "[]"))}


_FIELDS = ("layer", "label", "relation", "value", "threshold", "confidence", "first_seen_ns", "last_seen_ns")


def _own(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields that are written as they are, and the attributes."""
    encoded = set(_names(fields.get("json", "")))
    attributes = {
        name.removeprefix(_PREFIX): json.loads(value) if name in encoded else value
        for name, value in fields.items()
        if name.startswith(_PREFIX)
    }
    return {**{name: fields[name] for name in _FIELDS if name in fields}, "attributes": attributes}


def _names(text: str) -> list[str]:
    """Names in quotes, one after the other."""
    names, at = [], 0
    while at < len(text):
        name, at = json.JSONDecoder().raw_decode(text, at)
        names.append(name)
        at += 1
    return names
