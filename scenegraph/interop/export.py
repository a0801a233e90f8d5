"""Any of the formats by its name, as bytes or into a file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scenegraph.errors import ExportError, nearest
from scenegraph.graph import SceneGraph
from scenegraph.interop.gltf import gltf_bytes
from scenegraph.interop.graphml import graphml_text
from scenegraph.interop.node_link import node_link_document
from scenegraph.interop.spark_dsg import spark_dsg_document
from scenegraph.interop.table import objects_csv, objects_parquet

__all__ = ["FORMATS", "Format", "export_graph", "render_graph"]


@dataclass(frozen=True, slots=True)
class Format:
    """One way to write a graph: its bytes, the usual ending of a file, and its media type."""

    render: Callable[[SceneGraph], bytes]
    suffix: str
    media_type: str


FORMATS: dict[str, Format] = {
    "json": Format(lambda graph: graph.snapshot().model_dump_json().encode(), ".json", "application/json"),
    "spark_dsg": Format(lambda graph: json.dumps(spark_dsg_document(graph)).encode(), ".json", "application/json"),
    "node_link": Format(lambda graph: json.dumps(node_link_document(graph)).encode(), ".json", "application/json"),
    "graphml": Format(lambda graph: graphml_text(graph).encode(), ".graphml", "application/graphml+xml"),
    "csv": Format(lambda graph: objects_csv(graph).encode(), ".csv", "text/csv"),
    "parquet": Format(objects_parquet, ".parquet", "application/vnd.apache.parquet"),
    "gltf": Format(gltf_bytes, ".glb", "model/gltf-binary"),
}
"""The formats of a whole graph, by name."""


def render_graph(graph: SceneGraph, name: str) -> bytes:
    """The graph in the format of this name; text is UTF-8. Raises ExportError when there is none."""
    if name not in FORMATS:
        near = nearest(name, FORMATS)
        raise ExportError(
            f"unknown graph format {name!r}: expected one of {', '.join(FORMATS)}",
            hint=f"did you mean {near[0]!r}?" if near else None,
        )
    return FORMATS[name].render(graph)


def export_graph(graph: SceneGraph, name: str, path: str | Path) -> Path:
    """Write the graph to a file, replacing what was there, and return its path.

    The file is complete or untouched. Raises ExportError when the format is unknown or the file cannot be written.
    """
    path = Path(path)
    data = render_graph(graph, name)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        raise ExportError(
            f"{path}: cannot be written: {error.strerror}", hint="check folder and permissions"
        ) from error
    finally:
        partial.unlink(missing_ok=True)
    return path
