"""The scene graph model: nodes, edges, numbered changes, the past, mirrors. Knows neither maps nor rules nor the
wire."""

from scenegraph.graph.compact import pack, unpack
from scenegraph.graph.delta import Delta, EdgeChanges, GraphChanges, NodeChanges, Snapshot
from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.history import History, Life
from scenegraph.graph.index import Nearby
from scenegraph.graph.mirror import Mirror
from scenegraph.graph.node import LAYERS, Box, Layer, Node, Tombstone
from scenegraph.graph.scene_graph import SceneGraph
from scenegraph.graph.tables import EdgeTable, NodeTable
from scenegraph.graph.values import Attributes, valid_identifier

__all__ = [
    "LAYERS",
    "Attributes",
    "Box",
    "Delta",
    "Edge",
    "EdgeChanges",
    "EdgeKey",
    "EdgeTable",
    "GraphChanges",
    "History",
    "Layer",
    "Life",
    "Mirror",
    "Nearby",
    "Node",
    "NodeChanges",
    "NodeTable",
    "SceneGraph",
    "Snapshot",
    "Tombstone",
    "pack",
    "unpack",
    "valid_identifier",
]
