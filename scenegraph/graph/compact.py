"""The compact form of a graph: arrays and one JSON document, read and written without making a node or edge.

A column whose values are all the same is kept as one value, one that equals its twin not at all; numbers of few
decimals are kept as whole numbers of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenegraph.errors import InvalidGraphValue
from scenegraph.graph.edge import EdgeKey
from scenegraph.graph.history import Change, History, Undo
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
    arrays: dict[str, Array] = {"ids": _text(nodes.ids)}
    document = {
        "revision": graph.revision,
        "stamp_ns": graph.stamp_ns,
        "nodes": _pack_table("node_", nodes, arrays),
        "edges": _pack_table("edge_", edges, arrays),
        "tombstones": [stone.model_dump(mode="json") for stone in graph.tombstones()],
        "past": _pack_history(graph.history, arrays),
    }
    return arrays, document


def unpack(arrays: Mapping[str, Array], document: Mapping[str, Any], *, history_limit: int = 100_000) -> SceneGraph:
    """The graph that `pack` wrote. Raises InvalidGraphValue when these are not one."""
    try:
        ids = _names(arrays["ids"])
        return SceneGraph.from_tables(
            _unpack_nodes("node_", ids, arrays, document["nodes"]),
            _unpack_edges("edge_", ids, arrays, document["edges"]),
            revision=int(document["revision"]),
            stamp_ns=int(document["stamp_ns"]),
            tombstones=[Tombstone.model_validate(stone) for stone in document["tombstones"]],
            history=_unpack_history(arrays, document["past"], history_limit),
        )
    except InvalidGraphValue:
        raise
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InvalidGraphValue(f"not a graph in compact form: {type(error).__name__}: {error}") from None


# -- the past ---------------------------------------------------------------------------------------------------------


def _pack_history(history: History, arrays: dict[str, Array]) -> dict[str, Any]:
    """Every step's numbers; in one row the nodes and edges that all steps name, and those of them that were there."""
    steps = [undo.before for undo in history]
    nodes = [item for before in steps for item in before.nodes.items()]
    edges = [item for before in steps for item in before.edges.items()]
    names = {name: None for key, _ in edges for name in key}
    names |= {node_id: None for node_id, _ in nodes}
    code = {name: n for n, name in enumerate(names)}
    arrays["past_steps"] = np.array(
        [(u.revision, u.stamp_ns, u.previous_stamp_ns, len(u.before.nodes), len(u.before.edges)) for u in history],
        np.int64,
    ).reshape(-1, 5)
    arrays["past_names"] = _text(tuple(names))
    arrays["past_node_name"] = np.array([code[node_id] for node_id, _ in nodes], np.int32)
    arrays["past_node_there"] = np.array([node is not None for _, node in nodes], np.bool_)
    arrays["past_edge_name"] = np.array([[code[name] for name in key] for key, _ in edges], np.int32).reshape(-1, 3)
    arrays["past_edge_there"] = np.array([edge is not None for _, edge in edges], np.bool_)
    before_nodes = NodeTable.of((node for _, node in nodes if node is not None), different=False)
    before_edges = EdgeTable.of((edge for _, edge in edges if edge is not None), code, tuple(names))
    return {
        "nodes": _pack_table("past_node_", before_nodes, arrays),
        "edges": _pack_table("past_edge_", before_edges, arrays),
        "tombstones": [
            {node_id: stone and stone.model_dump(mode="json") for node_id, stone in before.tombstones.items()}
            for before in steps
        ],
    }


def _unpack_history(arrays: Mapping[str, Array], document: Mapping[str, Any], limit: int) -> History:
    names = _names(arrays["past_names"])
    node_names = [names[n] for n in arrays["past_node_name"].tolist()]
    keys = [EdgeKey(names[r], names[s], names[t]) for r, s, t in arrays["past_edge_name"].tolist()]
    nodes_there, edges_there = arrays["past_node_there"].tolist(), arrays["past_edge_there"].tolist()
    counts = arrays["past_steps"][:, 3:].sum(axis=0).tolist()
    if counts != [len(node_names), len(keys)] or sum(edges_there) != int(document["edges"]["n"]):
        raise ValueError(f"expected {counts} nodes and edges of the past, got {len(node_names)} and {len(keys)}")
    ids = tuple(name for name, there in zip(node_names, nodes_there, strict=True) if there)
    made_nodes = iter(_unpack_nodes("past_node_", ids, arrays, document["nodes"]))
    made_edges = iter(_unpack_edges("past_edge_", names, arrays, document["edges"]))
    nodes = ((name, next(made_nodes) if there else None) for name, there in zip(node_names, nodes_there, strict=True))
    edges = ((key, next(made_edges) if there else None) for key, there in zip(keys, edges_there, strict=True))
    history = History(limit)
    for step, stones in zip(arrays["past_steps"].tolist(), document["tombstones"], strict=True):
        revision, stamp_ns, previous_stamp_ns, n_nodes, n_edges = step
        before = Change(
            nodes=dict(islice(nodes, n_nodes)),
            edges=dict(islice(edges, n_edges)),
            tombstones={i: None if stone is None else Tombstone.model_validate(stone) for i, stone in stones.items()},
        )
        history.remember(Undo(revision, stamp_ns, previous_stamp_ns, before))
    return history


# -- tables -----------------------------------------------------------------------------------------------------------


def _pack_table(prefix: str, table: NodeTable | EdgeTable, arrays: dict[str, Array]) -> dict[str, Any]:
    """The columns go to `arrays`; returns what is no column."""
    is_nodes = isinstance(table, NodeTable)
    for name in _NODE_COLUMNS if is_nodes else _EDGE_COLUMNS:
        column: Array = getattr(table, name)
        twin = _TWINS.get(name)
        if twin is None or not np.array_equal(_bits(getattr(table, twin)), _bits(column)):
            arrays[prefix + name] = _packed(column)
    texts = ("labels",) if is_nodes else ("relations", "evidence")
    return {
        "n": len(table),
        "attributes": {str(row): attributes for row, attributes in table.attributes.items()},
        **{name: getattr(table, name) for name in texts},
    }


def _unpack_nodes(
    prefix: str, ids: tuple[str, ...], arrays: Mapping[str, Array], document: Mapping[str, Any]
) -> NodeTable:
    n = int(document["n"])
    if len(ids) != n:
        raise ValueError(f"expected {n} ids, got {len(ids)}")
    columns = _columns(arrays, prefix, _NODE_COLUMNS, n)
    labels = tuple(map(str, document["labels"]))
    _check_codes(columns, {"layer": len(LAYERS), "label": len(labels)})
    return NodeTable(ids=ids, labels=labels, attributes=_attributes(document["attributes"]), **columns)


def _unpack_edges(
    prefix: str, ids: tuple[str, ...], arrays: Mapping[str, Array], document: Mapping[str, Any]
) -> EdgeTable:
    columns = _columns(arrays, prefix, _EDGE_COLUMNS, int(document["n"]))
    relations = tuple(map(str, document["relations"]))
    evidence = tuple(tuple(items) for items in document["evidence"])
    limits = {"relation": len(relations), "source": len(ids), "target": len(ids), "evidence_of": len(evidence)}
    _check_codes(columns, limits)
    attributes = _attributes(document["attributes"])
    return EdgeTable(ids=ids, relations=relations, evidence=evidence, attributes=attributes, **columns)


def _check_codes(columns: Mapping[str, Array], limits: Mapping[str, int]) -> None:
    for name, limit in limits.items():
        codes = columns[name]
        if len(codes) and (codes.min() < 0 or codes.max() >= limit):
            raise ValueError(f"{name}: expected numbers of 0 … {limit - 1}, got {codes.min()} … {codes.max()}")


# -- columns ----------------------------------------------------------------------------------------------------------


def _text(names: tuple[str, ...]) -> Array:
    return np.frombuffer("\n".join(names).encode(), np.uint8)


def _names(text: Array) -> tuple[str, ...]:
    together = text.tobytes().decode()
    if together and not _IDS.fullmatch(together):
        raise ValueError("expected ids, one a line")
    return tuple(together.split("\n")) if together else ()


def _packed(column: Array) -> Array:
    """One value for all where they are the same, and whole numbers of decimals where they are such."""
    bits = _bits(column)
    if len(column) > 1 and bool((bits[1:] == bits[:1]).all()):
        return column[:1].copy()
    if column.dtype != np.float64:
        return column
    with np.errstate(over="ignore"):
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
