"""A world, here or on a server, as files of other programs."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenegraph.errors import ExportError, nearest

if TYPE_CHECKING:
    from scenegraph.graph import SceneGraph
    from scenegraph.service.client import Client

__all__ = ["LAYER_OF", "check_format", "export", "formats", "layers_of_server", "write_text"]

LAYER_OF = {"png": "tsdf", "ply": "tsdf", "bt": "occupancy"}
"""The map layer that a format needs; the others are made from the graph alone."""


def formats() -> list[str]:
    """The names of all formats."""
    from scenegraph.interop import FORMATS

    return [*FORMATS, *LAYER_OF]


def check_format(name: str) -> None:
    """Raises `ExportError` when there is no format of this name, with the nearest one."""
    if name not in formats():
        near = nearest(name, formats())
        raise ExportError(
            f"unknown format {name!r}: expected one of {', '.join(formats())}",
            hint=f"did you mean {near[0]!r}?" if near else None,
        )


def write_text(path: Path, text: str) -> None:
    """Write a text file. Raises `ExportError`."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {error.strerror}", hint="check folder and permissions") from None


def export(graph: SceneGraph, layer: Callable[[str], Any], name: str, path: str | Path) -> Path:
    """Write a world in the format of this name to a file, and return its path.

    graph   the scene graph: json, spark_dsg, node_link, graphml and csv are made from it
    layer   gives a map layer by its name: png (picture) and ply (mesh) need `tsdf`, bt (OctoMap) needs `occupancy`

    Raises `ExportError` when there is no such format or the file cannot be written.
    """
    from scenegraph.interop import export_graph

    check_format(name)
    path = Path(path)
    if name not in LAYER_OF:
        return export_graph(graph, name, path)
    try:
        _write_layer(graph, layer(LAYER_OF[name]), name, path)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {error.strerror}", hint="check folder and permissions") from None
    return path


def _write_layer(graph: SceneGraph, layer: Any, name: str, path: Path) -> None:
    if name == "bt":
        layer.write(path)
    elif name == "ply":
        layer.mesh().write_ply(path)
    else:
        from scenegraph.picture import draw

        mesh = layer.mesh()
        draw(graph, path, points=mesh.vertices, colors=mesh.colors, normals=mesh.normals)


def layers_of_server(client: Client) -> Callable[[str], Any]:
    """The map layers of a server by their name, each fetched when it is asked for."""

    def layer(name: str) -> Any:
        import numpy as np

        from mapping.occupancy import OccupancyMap
        from mapping.tsdf import TsdfMap

        kind: Any = {"occupancy": OccupancyMap, "tsdf": TsdfMap}[name]
        with np.load(io.BytesIO(client.map_layer(name, "npz"))) as state:
            return kind.from_state(dict(state))

    return layer
