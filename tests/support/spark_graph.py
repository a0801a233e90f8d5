"""The graph of a building (`many_boxes`) in the `spark-dsg` package: the same nodes, boxes and pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import boxes
from scenegraph.graph import LAYERS, EdgeTable, NodeTable

_WHERE = {  # layer: number, partition, character of the node symbols
    "object": (2, 0, "O"),
    "structure": (2, ord("s"), "s"),
    "room": (4, 0, "R"),
    "storey": (5, ord("t"), "t"),
    "building": (5, 0, "B"),
}


class SparkInput:
    """What `spark_graph` is given, as Python and numpy would have it before anything of spark-dsg is made."""

    def __init__(self, nodes: NodeTable, tables: Sequence[EdgeTable]) -> None:
        """tables: edges; spark-dsg has one undirected edge a pair."""
        self.layers = [LAYERS[layer] for layer in nodes.layer.tolist()]
        self.names = nodes.ids
        self.labels = nodes.label.tolist()
        self.centers = nodes.center
        self.sizes = nodes.size.astype(np.float32)
        self.centers32 = nodes.center.astype(np.float32)
        self.axes = boxes.axes_of(nodes.rotation_wxyz).astype(np.float32)
        self.last_seen_ns = nodes.last_seen_ns.tolist()
        ends: NDArray[np.int64] = np.concatenate([np.stack([e.source, e.target], axis=1) for e in tables]).astype(
            np.int64
        )
        ends.sort(axis=1)
        self.take_pairs(np.unique(ends, axis=0))

    def take_pairs(self, pairs: NDArray[np.integer[Any]]) -> None:
        """Pairs (m, 2) of rows, in two flat lists: a list for each pair would be work for the garbage collector."""
        self.sources, self.targets = pairs[:, 0].tolist(), pairs[:, 1].tolist()


def spark_graph(given: SparkInput) -> Any:
    """A `spark_dsg.DynamicSceneGraph` of these nodes and pairs."""
    import spark_dsg

    keys = {
        name: spark_dsg.LayerKey(layer, part) if part else spark_dsg.LayerKey(layer)
        for name, (layer, part, _) in _WHERE.items()
    }
    graph = spark_dsg.DynamicSceneGraph(list(keys.values()), {name.upper(): key for name, key in keys.items()})
    kinds = {
        "object": spark_dsg.ObjectNodeAttributes,
        "room": spark_dsg.RoomNodeAttributes,
    }
    obb = spark_dsg.BoundingBoxType.OBB
    symbols = []
    for n, layer in enumerate(given.layers):
        attributes = kinds.get(layer, spark_dsg.SemanticNodeAttributes)()
        attributes.position = given.centers[n]
        attributes.name = given.names[n]
        attributes.semantic_label = given.labels[n]
        attributes.last_update_time_ns = given.last_seen_ns[n]
        attributes.bounding_box = spark_dsg.BoundingBox(obb, given.sizes[n], given.centers32[n], given.axes[n])
        number, partition, letter = _WHERE[layer]
        symbol = spark_dsg.NodeSymbol(letter, n)
        graph.add_node(number, symbol, attributes, partition)
        symbols.append(symbol)
    for a, b in zip(given.sources, given.targets, strict=True):
        graph.insert_edge(symbols[a], symbols[b])
    return graph
