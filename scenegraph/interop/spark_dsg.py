"""JSON of spark_dsg (Hughes et al., Hydra, RSS 2022; format of spark_dsg 1.1), which `DynamicSceneGraph.load` reads.

A spark_dsg graph is undirected with one edge a pair: the edge between two nodes carries all our relations between them,
in both directions, in `metadata["relations"]`. Whatever spark_dsg has no field for is in a node's metadata.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from scenegraph.graph import Box, Edge, Layer, Node, SceneGraph

__all__ = ["spark_dsg_document"]

_VERSION = {"major": 1, "minor": 1, "patch": 3}
_NO_KEY = 2**64 - 1


class _Layer(NamedTuple):
    """Where a layer of ours lies in theirs: number, partition, name, and the character of its node symbols."""

    number: int
    partition: int
    name: str
    symbol: str


_LAYERS: dict[Layer, _Layer] = {
    "object": _Layer(2, 0, "OBJECTS", "O"),
    "agent": _Layer(2, ord("a"), "AGENTS", "a"),
    "structure": _Layer(2, ord("s"), "STRUCTURE", "s"),
    "place": _Layer(3, 0, "PLACES", "p"),
    "room": _Layer(4, 0, "ROOMS", "R"),
    "building": _Layer(5, 0, "BUILDINGS", "B"),
    "storey": _Layer(5, ord("t"), "STOREYS", "t"),
}

_HEIGHTS = {ord(layer.symbol): layer.number for layer in _LAYERS.values()}


def spark_dsg_document(graph: SceneGraph) -> dict[str, Any]:
    """The graph as spark_dsg's JSON mapping; spark_dsg wants the file's name to end in `.json`.

    Node symbols keep our numbers where they are free (`object_12` → `O12`).
    """
    symbols = _symbols(graph)
    labels = {layer: sorted({node.label for node in graph.nodes(layer)}) for layer in _LAYERS}
    numbers = {(layer, label): i for layer, names in labels.items() for i, label in enumerate(names)}
    pairs: dict[tuple[int, int], list[Edge]] = {}
    for edge in graph.edges():
        a, b = symbols[edge.source], symbols[edge.target]
        pairs.setdefault((min(a, b), max(a, b)), []).append(edge)
    return {
        "SPARK_DSG_header": {"project_name": "main", "version": _VERSION},
        "directed": False,
        "multigraph": False,
        "layer_keys": [_key(layer) for layer in _LAYERS.values()],
        "layer_names": {layer.name: _key(layer) for layer in _LAYERS.values()},
        "metadata": {
            "revision": graph.revision,
            "stamp_ns": graph.stamp_ns,
            "labelspaces": {
                key: [[i, label] for i, label in enumerate(labels[name])]
                for name, layer in _LAYERS.items()
                for key in (layer.name, f"_l{layer.number}p{layer.partition}")  # looked up by either
            },
        },
        "nodes": [_node(node, symbols[node.id], numbers[node.layer, node.label]) for node in graph],
        "edges": [_edge(a, b, relations) for (a, b), relations in pairs.items()],
    }


def _key(layer: _Layer) -> dict[str, int]:
    return {"layer": layer.number, "partition": layer.partition}


def _symbols(graph: SceneGraph) -> dict[str, int]:
    """A 64-bit node symbol for each id: the layer's character, then the id's own number, else the next free one."""
    symbols: dict[str, int] = {}
    for name, layer in _LAYERS.items():
        taken: dict[int, str] = {}
        rest = []
        for node in graph.nodes(name):
            digits = node.id.rpartition("_")[2]
            number = int(digits) if digits.isdigit() and len(digits) < 15 else None
            if number is None or number in taken:
                rest.append(node.id)
            else:
                taken[number] = node.id
        free = (number for number in range(len(taken) + len(rest)) if number not in taken)
        taken.update(zip(free, rest, strict=False))
        symbols.update((node_id, ord(layer.symbol) << 56 | number) for number, node_id in taken.items())
    return symbols


def _node(node: Node, symbol: int, label: int) -> dict[str, Any]:
    return {"id": symbol, **_key(_LAYERS[node.layer]), "attributes": _attributes(node, label)}


def _attributes(node: Node, label: int) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "position": node.position.tolist(),
        "last_update_time_ns": max(0, node.last_seen_ns),
        "is_active": False,
        "is_predicted": False,
        "metadata": {
            "id": node.id,
            "label": node.label,
            "confidence": node.confidence,
            "first_seen_ns": node.first_seen_ns,
            "attributes": dict(node.attributes),
        },
    }
    if node.layer == "agent":
        return fields | {
            "type": "AgentNodeAttributes",
            "timestamp": max(0, node.last_seen_ns),
            "world_R_body": _rotation(node.box),
            "external_key": _NO_KEY,
            "dbow_ids": None,
            "dbow_values": None,
        }
    fields |= {
        "name": str(node.attributes.get("name") or node.id),
        "color": {"r": 128, "g": 128, "b": 128, "a": 255},
        "bounding_box": _bounding_box(node.box),
        "semantic_label": label,
        "semantic_feature": {"cols": 0, "rows": 0, "data": None},
    }
    if node.layer == "object":
        return fields | {
            "type": "ObjectNodeAttributes",
            "mesh_connections": [],
            "registered": False,
            "world_R_object": _rotation(node.box),
        }
    if node.layer == "room":
        return fields | {"type": "RoomNodeAttributes", "semantic_class_probabilities": {}}
    return fields | {"type": "SemanticNodeAttributes"}


def _rotation(box: Box | None) -> dict[str, float]:
    w, x, y, z = (1.0, 0.0, 0.0, 0.0) if box is None else box.rotation_wxyz.tolist()
    return {"w": w, "x": x, "y": y, "z": z}


def _bounding_box(box: Box | None) -> dict[str, Any]:
    return {
        "type": "INVALID" if box is None else "OBB",
        "dimensions": [0.0, 0.0, 0.0] if box is None else box.size.tolist(),
        "world_P_center": [0.0, 0.0, 0.0] if box is None else box.center.tolist(),
        "world_R_center": _rotation(box),
    }


def _edge(a: int, b: int, relations: list[Edge]) -> dict[str, Any]:
    upper, lower = (a, b) if _HEIGHTS[a >> 56] >= _HEIGHTS[b >> 56] else (b, a)
    return {
        "source": upper,
        "target": lower,
        "info": {
            "type": "EdgeAttributes",
            "weighted": False,
            "weight": 1.0,
            "metadata": {"relations": [edge.model_dump(mode="json") for edge in relations]},
        },
    }
