"""A graph out of a file of any of the formats that can be read back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenegraph.errors import GraphUnreadable, InvalidGraphValue, InvariantViolated
from scenegraph.graph import SceneGraph, Snapshot
from scenegraph.interop.graphml import read_graphml
from scenegraph.interop.node_link import is_node_link, read_node_link
from scenegraph.interop.spark_dsg_reading import is_spark_dsg, read_spark_dsg

__all__ = ["read_graph"]


def read_graph(path: str | Path, *, labels: Mapping[int, str] | None = None) -> SceneGraph:
    """The graph in a file: spark_dsg, node-link JSON, our own JSON or GraphML, known by what is in it.

    labels : names of semantic labels, for spark_dsg files that have no label spaces

    Raises GraphUnreadable when the file cannot be read, is of no such format, or is damaged.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise GraphUnreadable(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise GraphUnreadable(f"{path}: expected JSON or GraphML, got something that is not text") from None
    try:
        return _graph(text, labels)
    except GraphUnreadable as error:
        raise GraphUnreadable(f"{path}: {error}", hint=error.hint) from None


def _graph(text: str, labels: Mapping[int, str] | None) -> SceneGraph:
    if text.lstrip().startswith("<"):
        return read_graphml(text)
    try:
        document: Any = json.loads(text, parse_constant=lambda _: None)  # NaN and the like: not known
    except ValueError as error:
        raise GraphUnreadable(f"neither JSON nor GraphML: {error}") from None
    if isinstance(document, dict):
        if is_spark_dsg(document):
            return read_spark_dsg(document, labels=labels)
        if is_node_link(document):
            return read_node_link(document)
        if "revision" in document and "nodes" in document:
            try:
                return SceneGraph.from_snapshot(Snapshot.model_validate(document))
            except (InvalidGraphValue, InvariantViolated) as error:
                raise GraphUnreadable(str(error)) from None
    raise GraphUnreadable("JSON, but no graph: expected that of spark_dsg, of networkx (node-link) or our own")
