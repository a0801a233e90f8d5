"""The compact form of a graph: arrays and one JSON document, read and written without making a node or edge.

A column whose values are all the same is kept as one value, one that equals its twin not at all; numbers of few
decimals are kept as whole numbers of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenegraph.errors import InvalidGraphValue
from scenegraph.graph.history import History
from scenegraph.graph.node import LAYERS, Tombstone
from scenegraph.graph.scene_graph import SceneGraph
from scenegraph.graph.tables import EdgeTable, NodeTable
from scenegraph.graph.values import plain_attributes

__all__ = ["pack", "unpack"]

Array = NDArray[Any]

_NODE_COLUMNS = {
    "layer": (np.uint8, ()),
    "label": (np.int32, ()),
    "position": (np.float64, (3,)),
    "boxed": (np.bool_, ()),
    "center": (np.float64, (3,)),
    "size": (np.float64, (3,)),
    "rotation_wxyz": (np.float64, (4,)),
    "confidence": (np.float64, ()),
    "first_seen_ns": (np.int64, ()),
    "last_seen_ns": (np.int64, ()),
}
_EDGE_COLUMNS = {
    "relation": (np.uint16, ()),
    "source": (np.int32, ()),
    "target": (np.int32, ()),
    "value": (np.float64, ()),
    "threshold": (np.float64, ()),
    "confidence": (np.float64, ()),
    "first_seen_ns": (np.int64, ()),
    "last_seen_ns": (np.int64, ()),
    "evidence_of": (np.int32, ()),
}
_TWINS = {"center": "position", "last_seen_ns": "first_seen_ns"}
"""Columns that are left out where they are the same as an earlier one."""
_IDS = re.compile(r"[a-z][a-z0-9_]{0,127}(?:\n[a-z][a-z0-9_]{0,127})*+")
_DECIMALS = 5
_NONE = np.iinfo(np.int32).min


def pack(graph: SceneGraph) -> tuple[dict[str, Array], dict[str, Any]]:
    """The graph with its past as arrays and JSON values, which `unpack` takes."""
    nodes, edges = graph.tables()
    arrays: dict[str, Array] = {"ids": np.frombuffer("\n".join(nodes.ids).encode(), np.uint8)}
    for prefix, table, columns in (("node_", nodes, _NODE_COLUMNS), ("edge_", edges, _EDGE_COLUMNS)):
        for name in columns:
            column: Array = getattr(table, name)
            twin = _TWINS.get(name)
            if twin is None or not np.array_equal(_bits(getattr(table, twin)), _bits(column)):
                arrays[prefix + name] = _packed(column)
    document = {
        "revision": graph.revision,
        "stamp_ns": graph.stamp_ns,
        "n_nodes": len(nodes),
        "n_edges": len(edges),
        "labels": nodes.labels,
        "relations": edges.relations,
        "evidence": edges.evidence,
        "node_attributes": {str(row): attributes for row, attributes in nodes.attributes.items()},
        "edge_attributes": {str(row): attributes for row, attributes in edges.attributes.items()},
        "tombstones": [stone.model_dump(mode="json") for stone in graph.tombstones()],
        "history": graph.history.document(),
    }
    return arrays, document


def unpack(arrays: Mapping[str, Array], document: Mapping[str, Any], *, history_limit: int = 100_000) -> SceneGraph:
    """The graph that `pack` wrote. Raises InvalidGraphValue when these are not one."""
    try:
        n, m = int(document["n_nodes"]), int(document["n_edges"])
        text = arrays["ids"].tobytes().decode()
        ids = tuple(text.split("\n")) if text else ()
        if len(ids) != n or (text and not _IDS.fullmatch(text)):
            raise ValueError(f"expected {n} ids, got {len(ids)} or what is none")
        nodes = NodeTable(
            ids=ids,
            labels=tuple(document["labels"]),
            attributes=_attributes(document["node_attributes"]),
            **_columns(arrays, "node_", _NODE_COLUMNS, n),
        )
        edges = EdgeTable(
            ids=ids,
            relations=tuple(document["relations"]),
            evidence=tuple(tuple(items) for items in document["evidence"]),
            attributes=_attributes(document["edge_attributes"]),
            **_columns(arrays, "edge_", _EDGE_COLUMNS, m),
        )
        for codes, limit in (
            (nodes.layer, len(LAYERS)),
            (nodes.label, len(nodes.labels)),
            (edges.relation, len(edges.relations)),
            (edges.source, n),
            (edges.target, n),
            (edges.evidence_of, len(edges.evidence)),
        ):
            if len(codes) and (codes.min() < 0 or codes.max() >= limit):
                raise ValueError(f"expected numbers of 0 … {limit - 1}, got {codes.min()} … {codes.max()}")
        return SceneGraph.from_tables(
            nodes,
            edges,
            revision=int(document["revision"]),
            stamp_ns=int(document["stamp_ns"]),
            tombstones=[Tombstone.model_validate(stone) for stone in document["tombstones"]],
            history=History.from_document(document["history"], history_limit),
        )
    except InvalidGraphValue:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidGraphValue(f"not a graph in compact form: {type(error).__name__}: {error}") from None


def _packed(column: Array) -> Array:
    """One value for all where they are the same, and whole numbers of decimals where they are such."""
    bits = _bits(column)
    if len(column) > 1 and bool((bits[1:] == bits[:1]).all()):
        return column[:1].copy()
    if column.dtype != np.float64:
        return column
    scaled = column * 10.0**_DECIMALS
    none = np.isnan(column)
    if not bool((none | (np.abs(scaled) < 2.0e9)).all()):
        return column
    whole = np.where(none, float(_NONE), np.rint(scaled)).astype(np.int32)
    return whole if np.array_equal(_bits(_decimal(whole)), bits) else column


def _bits(column: Array) -> Array:
    """Numbers as they are in memory: zeros have signs, and what is no number equals itself."""
    return np.ascontiguousarray(column).view(np.int64) if column.dtype == np.float64 else column


def _decimal(whole: Array) -> Array:
    return np.asarray(np.where(whole == _NONE, np.nan, whole / 10.0**_DECIMALS))


def _columns(
    arrays: Mapping[str, Array], prefix: str, columns: Mapping[str, tuple[Any, tuple[int, ...]]], n: int
) -> dict[str, Any]:
    read: dict[str, Array] = {}
    for name, (dtype, shape) in columns.items():
        twin = _TWINS.get(name)
        if twin is not None and prefix + name not in arrays:
            read[name] = read[twin]
            continue
        column = arrays[prefix + name]
        if column.dtype == np.int32 and dtype is np.float64:
            column = _decimal(column)
        if column.dtype != dtype or column.shape not in ((n, *shape), (1, *shape)):
            raise ValueError(
                f"{prefix}{name}: expected {np.dtype(dtype)} of {n} rows, got {column.dtype} {column.shape}"
            )
        column.flags.writeable = False
        read[name] = np.broadcast_to(column, (n, *shape)) if len(column) != n else column
    return read


def _attributes(document: Mapping[str, Any]) -> dict[int, Any]:
    return {int(row): plain_attributes(attributes) for row, attributes in document.items()}
