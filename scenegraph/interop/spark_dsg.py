"""JSON of spark_dsg (Hughes et al., Hydra, RSS 2022; format of spark_dsg 1.1), which `DynamicSceneGraph.load` reads.

A spark_dsg graph is undirected with one edge a pair: the edge between two nodes carries all our relations between them,
in both directions, in `metadata["relations"]`. Whatever spark_dsg has no field for is in a node's metadata. Nodes and
edges that were read from a spark_dsg file are written as they were there, but for what has changed since.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from scenegraph.graph import Edge, Node, SceneGraph
from scenegraph.interop.spark_dsg_values import LAYERS, PLACE_FIELDS, PROMOTED, DsgLayer, bounding_box, box_of, rotation

__all__ = ["spark_dsg_document"]

_VERSION = {"major": 1, "minor": 1, "patch": 3}
_NO_KEY = 2**64 - 1

_Places = dict[str, tuple[int, DsgLayer]]
"""Node id → its symbol and its layer there."""


def spark_dsg_document(graph: SceneGraph) -> dict[str, Any]:
    """The graph as spark_dsg's JSON mapping; spark_dsg wants the file's name to end in `.json`.

    Node symbols keep our numbers where they are free (`object_12` → `O12`), and theirs where they came from there.
    """
    places = _placed(graph)
    labels = _Labels(graph)
    layers = {layer.key_text: layer for layer in map(_Keyed, _layers(places))}
    pairs: dict[tuple[int, int], list[Edge]] = {}
    for edge in graph.edges():
        a, b = places[edge.source][0], places[edge.target][0]
        pairs.setdefault((min(a, b), max(a, b)), []).append(edge)
    heights = {symbol: layer.number for symbol, layer in places.values()}
    return {
        "SPARK_DSG_header": {"project_name": "main", "version": _VERSION},
        "directed": False,
        "multigraph": False,
        "layer_keys": [keyed.layer.key for keyed in layers.values()],
        "layer_names": {keyed.layer.name: keyed.layer.key for keyed in layers.values() if keyed.layer.name},
        "metadata": {
            "revision": graph.revision,
            "stamp_ns": graph.stamp_ns,
            "tombstones": [stone.model_dump(mode="json") for stone in graph.tombstones()],
            "labelspaces": labels.document(layers.values()),
        },
        "nodes": [_node(node, *places[node.id], labels.number(node)) for node in graph],
        "edges": [_edge(a, b, relations, heights) for (a, b), relations in pairs.items()],
    }


class _Keyed:
    """A layer with the text that they look label spaces up by."""

    def __init__(self, layer: DsgLayer) -> None:
        self.layer = layer
        self.key_text = f"_l{layer.number}p{layer.partition}"


def _layers(places: _Places) -> list[DsgLayer]:
    """Ours, and those that nodes came from; the first of each number and partition names it."""
    found = {(layer.number, layer.partition): layer for layer in LAYERS.values()}
    for _, layer in places.values():
        found.setdefault((layer.number, layer.partition), layer)
    return list(found.values())


def _origin(node: Node | Edge) -> dict[str, Any]:
    """What is kept of the spark_dsg file that a node or an edge was read from; empty when it was not."""
    kept = node.attributes.get("spark_dsg")
    return kept if isinstance(kept, dict) else {}


def _layer_of(node: Node) -> DsgLayer:
    ours = LAYERS[node.layer]
    origin = _origin(node)
    if "layer" not in origin:
        return ours
    return DsgLayer(origin["layer"], origin["partition"], origin.get("layer_name", ""), ours.symbol)


def _placed(graph: SceneGraph) -> _Places:
    """Each node's 64-bit symbol: its own from there, else the layer's character with the id's number, else the next
    free number."""
    taken: dict[int, str] = {}
    for node in graph:
        symbol = _origin(node).get("id")
        if symbol is not None:
            taken.setdefault(symbol, node.id)
    placed = {node_id: symbol for symbol, node_id in taken.items()}
    for name, layer in LAYERS.items():
        base = ord(layer.symbol) << 56
        rest = []
        for node in graph.nodes(name):
            if node.id in placed:
                continue
            digits = node.id.rpartition("_")[2]
            number = int(digits) if digits.isdigit() and len(digits) < 15 else None
            if number is None or base | number in taken:
                rest.append(node.id)
            else:
                taken[base | number] = node.id
                placed[node.id] = base | number
        number = 0
        for node_id in rest:
            while base | number in taken:
                number += 1
            taken[base | number] = node_id
            placed[node_id] = base | number
    return {node.id: (placed[node.id], _layer_of(node)) for node in graph}


class _Labels:
    """Numbers of labels, by layer: those that nodes came with, then the next free ones in order of the labels."""

    def __init__(self, graph: SceneGraph) -> None:
        self._of: dict[tuple[int, int], dict[int, str]] = {}
        fresh: dict[tuple[int, int], set[str]] = {}
        for node in graph:
            layer = _layer_of(node)
            names = self._of.setdefault((layer.number, layer.partition), {})
            kept = _kept_label(node)
            if kept is None:
                fresh.setdefault((layer.number, layer.partition), set()).add(node.label)
            else:
                names[kept] = node.label
        self._numbers: dict[tuple[int, int, str], int] = {}
        for key, labels in fresh.items():
            names = self._of[key]
            known = {label: number for number, label in names.items()}
            number = 0
            for label in sorted(labels):
                if label not in known:
                    while number in names:
                        number += 1
                    names[number] = label
                self._numbers[(*key, label)] = known.get(label, number)

    def number(self, node: Node) -> int:
        kept = _kept_label(node)
        layer = _layer_of(node)
        return self._numbers[layer.number, layer.partition, node.label] if kept is None else kept

    def document(self, layers: Iterable[_Keyed]) -> dict[str, list[list[Any]]]:
        """Looked up by name or by key there, so both are given."""
        spaces = {}
        for keyed in layers:
            names = self._of.get((keyed.layer.number, keyed.layer.partition), {})
            for key in (keyed.layer.name, keyed.key_text):
                if key:
                    spaces[key] = [[number, names[number]] for number in sorted(names)]
        return spaces


def _kept_label(node: Node) -> int | None:
    """The label's number in the file that the node came from, if the label is still that."""
    origin = _origin(node)
    number = origin.get("attributes", {}).get("semantic_label")
    return number if number is not None and origin.get("label") == node.label else None


def _node(node: Node, symbol: int, layer: DsgLayer, label: int) -> dict[str, Any]:
    return {"id": symbol, **layer.key, "attributes": _attributes(node, label)}


def _attributes(node: Node, label: int) -> dict[str, Any]:
    own = {name: value for name, value in node.attributes.items() if name != "spark_dsg"}
    origin = _origin(node)
    if "attributes" in origin:
        return _as_it_came(node, dict(origin["attributes"]), own, label)
    fields: dict[str, Any] = {
        "position": node.position.tolist(),
        "last_update_time_ns": max(0, node.last_seen_ns),
        "is_active": False,
        "is_predicted": False,
        "metadata": _told(node, own),
    }
    if node.layer == "agent":
        return fields | {
            "type": "AgentNodeAttributes",
            "timestamp": max(0, node.last_seen_ns),
            "world_R_body": rotation(node.box),
            "external_key": _NO_KEY,
            "dbow_ids": None,
            "dbow_values": None,
        }
    fields |= {
        "name": str(node.attributes.get("name") or node.id),
        "color": {"r": 128, "g": 128, "b": 128, "a": 255},
        "bounding_box": bounding_box(node.box),
        "semantic_label": label,
        "semantic_feature": {"cols": 0, "rows": 0, "data": None},
    }
    match node.layer:
        case "object":
            return fields | {
                "type": "ObjectNodeAttributes",
                "mesh_connections": _numbers(own.get("mesh_connections")),
                "registered": False,
                "world_R_object": rotation(node.box),
            }
        case "room":
            return fields | {"type": "RoomNodeAttributes", "semantic_class_probabilities": {}}
        case "place":
            return fields | _place_fields(own)
    return fields | {"type": "SemanticNodeAttributes"}


def _place_fields(own: dict[str, Any]) -> dict[str, Any]:
    clearance = own.get("clearance_m")
    return {
        "type": "PlaceNodeAttributes",
        "distance": float(clearance) if isinstance(clearance, int | float) else 0.0,
        "num_basis_points": 0,
        "voxblox_mesh_connections": [],
        "pcl_mesh_connections": [],
        "mesh_vertex_labels": [],
        "deformation_connections": [],
        **PLACE_FIELDS,
    }


def _numbers(given: Any) -> list[int]:
    return [n for n in given if isinstance(n, int)] if isinstance(given, list) else []


def _told(node: Node, own: dict[str, Any], *, came: bool = False) -> dict[str, Any]:
    """All that their fields do not hold, or hold in single precision; `came`: whether it was read from there."""
    return {
        "id": node.id,
        "came": came,
        "label": node.label,
        "confidence": node.confidence,
        "first_seen_ns": node.first_seen_ns,
        "last_seen_ns": node.last_seen_ns,
        "box": None if node.box is None else node.box.model_dump(mode="json"),
        "attributes": own,
    }


def _as_it_came(node: Node, fields: dict[str, Any], own: dict[str, Any], label: int) -> dict[str, Any]:
    """The fields of a node that was read from there, with what is different now."""
    for theirs, ours in PROMOTED.items():
        if ours in own:
            fields[theirs] = own.pop(ours)
    if isinstance(own.get("traversability"), dict):
        fields |= own.pop("traversability")
    fields["position"] = node.position.tolist()
    if "semantic_label" in fields:
        fields["semantic_label"] = label
    if "name" in own and "name" in fields:
        fields["name"] = own.pop("name")
    if "bounding_box" in fields and box_of(fields["bounding_box"]) != node.box:
        fields["bounding_box"] = bounding_box(node.box)
    if "world_R_body" in fields:
        fields["world_R_body"] = rotation(node.box)
    fields["metadata"] = {**(fields.get("metadata") or {}), **_told(node, own, came=True)}
    return fields


def _edge(a: int, b: int, relations: list[Edge], heights: dict[int, int]) -> dict[str, Any]:
    upper, lower = (a, b) if heights[a] >= heights[b] else (b, a)
    came = next((origin for origin in map(_origin, relations) if origin), None)
    if came is not None:
        upper, lower = came["source"], came["target"]
    info: dict[str, Any] = (
        {"type": "EdgeAttributes", "weighted": False, "weight": 1.0, "metadata": {}}
        if came is None
        else dict(came["info"])
    )
    info["metadata"] = {
        **info.get("metadata", {}),
        "relations": [edge.model_dump(mode="json") for edge in relations],
    }
    return {"source": upper, "target": lower, "info": info}
