"""A table of the objects, for spreadsheets and for printing."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

from scenegraph.errors import ExportError
from scenegraph.graph import Edge, Node, SceneGraph

__all__ = ["object_rows", "objects_csv", "objects_parquet"]

COLUMNS = (
    "id", "label", "name", "room", "on", "in", "x_m", "y_m", "z_m", "size_x_m", "size_y_m", "size_z_m", "yaw_deg",
    "confidence", "first_seen_ns", "last_seen_ns",
)  # fmt: skip


def object_rows(graph: SceneGraph) -> list[dict[str, Any]]:
    """One mapping from column to value for each object, by id; None where a value is not known.

    `room` is the room it is in, `on` what carries most of it, `in` the object that contains most of it (ids); lengths
    in metres.
    """
    return [_row(graph, node) for node in sorted(graph.nodes("object"), key=_by_number)]


def objects_csv(graph: SceneGraph) -> str:
    """The rows of `object_rows` as CSV with a header line; empty fields are unknown."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(object_rows(graph))
    return text.getvalue()


def objects_parquet(graph: SceneGraph) -> bytes:
    """The rows of `object_rows` as Parquet: text, float64, and int64 for stamps; nulls are unknown.

    Raises ExportError when the package pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError:
        raise ExportError(
            "parquet needs the package pyarrow", hint="pip install 'scenegraph-service[tables]'"
        ) from None
    kinds = {"_ns": pa.int64(), "_m": pa.float64(), "_deg": pa.float64(), "confidence": pa.float64()}
    schema = pa.schema(
        [(name, next((kind for end, kind in kinds.items() if name.endswith(end)), pa.string())) for name in COLUMNS]
    )
    rows = [{**row, "name": None if row["name"] is None else str(row["name"])} for row in object_rows(graph)]
    file = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), file)
    return file.getvalue()


def _row(graph: SceneGraph, node: Node) -> dict[str, Any]:
    inside, supports = (_surest_last(graph.edges(relation, source=node.id)) for relation in ("in", "on"))
    containers = {graph.node(edge.target).layer: edge.target for edge in inside}
    size = [None] * 3 if node.box is None else node.box.size.tolist()
    values = (
        node.id,
        node.label,
        node.attributes.get("name"),
        containers.get("room"),
        supports[-1].target if supports else None,
        containers.get("object"),
        *node.position.tolist(),
        *size,
        None if node.box is None else math.degrees(node.box.yaw),
        node.confidence,
        node.first_seen_ns,
        node.last_seen_ns,
    )
    return dict(zip(COLUMNS, values, strict=True))


def _surest_last(edges: list[Edge]) -> list[Edge]:
    """By the share that was measured: what stands on two things is listed with what carries more of it."""
    return sorted(edges, key=lambda edge: (edge.value or 0.0, edge.target))


def _by_number(node: Node) -> tuple[str, int]:
    """`object_9` before `object_10`."""
    stem, _, number = node.id.rpartition("_")
    return (stem, int(number)) if number.isdigit() else (node.id, -1)
