"""The graph and the map layers as files of other programs, made from copies away from the world's thread."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.layer import MapLayer
from scenegraph.errors import ExportError
from scenegraph.graph import SceneGraph, Snapshot
from scenegraph.service import cbor
from scenegraph.service.codec import media_type

__all__ = ["LAYER_FORMATS", "crop", "graph_as", "layer_as", "read_box"]

State = dict[str, NDArray[Any]]

LAYER_FORMATS: dict[str, tuple[str, ...]] = {
    "occupancy": ("npz", "bt", "ply"),
    "tsdf": ("npz", "ply"),
    "esdf": ("npz",),
    "semantics": ("npz", "ply"),
    "instances": ("npz",),
}
"""What each layer can be had as; the first is the default. `ply` of the TSDF is its mesh, of the others points."""


def graph_as(snapshot: Snapshot, name: str) -> tuple[bytes, str]:
    """The graph as bytes, and their encoding. Raises `ExportError` when there is no such format."""
    if name == "json":
        return snapshot.model_dump_json().encode(), media_type("json", "Snapshot")
    if name == "cbor":
        return cbor.dumps(snapshot.model_dump(mode="json")), media_type("cbor", "Snapshot")
    from scenegraph.interop import FORMATS, render_graph

    if name not in FORMATS:
        raise ExportError(f"format: expected one of cbor, {', '.join(FORMATS)}, got {name[:40]!r}")
    text = render_graph(SceneGraph.from_snapshot(snapshot, history_limit=0), name)
    return text.encode(), FORMATS[name].media_type


def read_box(text: str | None) -> NDArray[np.float64] | None:
    """`x0,y0,z0,x1,y1,z1` as corners (2, 3) [m]; None stays. Raises `ExportError`."""
    if not text:
        return None
    try:
        corners = np.array([float(part) for part in text.split(",")], dtype=np.float64)
    except ValueError:
        corners = np.empty(0)
    if corners.shape != (6,) or not np.isfinite(corners).all() or (corners[:3] > corners[3:]).any():
        raise ExportError(f"box: expected x0,y0,z0,x1,y1,z1 with x0 ≤ x1, …, got {text[:80]!r}")
    return corners.reshape(2, 3)


def crop(state: Mapping[str, NDArray[Any]], block_size_m: float, box: NDArray[np.float64] | None) -> State:
    """Only the blocks of a layer's state that a box (2, 3) [m] meets."""
    if box is None:
        return dict(state)
    blocks = state["block_ijk"]
    low, high = blocks * block_size_m, (blocks + 1.0) * block_size_m
    meets = np.all((high > box[0]) & (low <= box[1]), axis=1)
    n = len(blocks)
    return {name: array[meets] if array.ndim and len(array) == n else array for name, array in state.items()}


def layer_as(name: str, kind: type[MapLayer], state: State, form: str) -> tuple[bytes, str]:
    """A layer, given as its state, as bytes, and their encoding. Raises `ExportError` when it has no such format."""
    if form not in LAYER_FORMATS[name]:
        raise ExportError(f"format of {name}: expected one of {', '.join(LAYER_FORMATS[name])}, got {form[:40]!r}")
    if form == "npz":
        file = io.BytesIO()
        np.savez_compressed(file, **state)  # type: ignore[arg-type]
        return file.getvalue(), "application/octet-stream;npz"
    layer: Any = kind.from_state(state)
    if name == "tsdf":
        return _written(lambda path: layer.mesh().write_ply(path), ".ply"), "application/octet-stream;ply"
    if form == "bt":
        return _written(layer.write, ".bt"), "application/octet-stream;bt"
    if name == "occupancy":
        return _points_ply(layer.occupied_centres(), {}), "application/octet-stream;ply"
    points, labels, confidence = layer.voxels()
    columns = {"label": labels.astype(np.uint16), "confidence": confidence.astype(np.float32)}
    return _points_ply(points, columns), "application/octet-stream;ply"


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="scenegraph-") as folder:
        path = Path(folder) / f"map{suffix}"
        write(path)
        return path.read_bytes()


_PLY_TYPES = {"f4": "float", "u2": "ushort"}


def _points_ply(points: NDArray[Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Points (N, 3) with a property a column, as a binary PLY file."""
    layout = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *((name, f"<{c.dtype.str[1:]}") for name, c in columns.items())]
    rows = np.empty(len(points), dtype=layout)
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    for name, column in columns.items():
        rows[name] = column
    properties = "".join(f"property {_PLY_TYPES[kind[1:]]} {name}\n" for name, kind in layout)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    return header.encode() + rows.tobytes()
