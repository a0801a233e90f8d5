"""The graph and the map layers as files of other programs, made from copies away from the world's thread."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.labelled import labelled_cloud, write_class_octree
from mapping.layer import MapLayer
from mapping.observations import ClassInfo
from mapping.palette import Palette
from mapping.ply import ply_bytes, vectors
from scenegraph.errors import ExportError
from scenegraph.graph import SceneGraph, Snapshot
from scenegraph.service import cbor
from scenegraph.service.codec import media_type

__all__ = ["LAYER_FORMATS", "Copies", "check_layer_format", "classes_in", "crop", "graph_as", "layer_as", "read_box"]

State = dict[str, NDArray[Any]]

LAYER_FORMATS: dict[str, tuple[str, ...]] = {
    "occupancy": ("npz", "bt", "ot", "ply"),
    "tsdf": ("npz", "ply"),
    "esdf": ("npz",),
    "semantics": ("npz", "ply", "ot", "mesh"),
    "instances": ("npz",),
}
"""What each layer can be had as; the first is the default. `npz`: its arrays, and the names and colours of classes.
`ply`: of the TSDF its mesh, with labels; of the semantics a cloud with class, instance and confidence; else points.
`ot` of the semantics: free space and occupied voxels in the colours of their classes. `mesh`: a PLY file of the mesh
in the colours of classes. PLY files name the classes in comments, `class ID RED GREEN BLUE NAME`."""

_BESIDE = {
    ("semantics", "ply"): ("instances",),
    ("semantics", "ot"): ("instances", "occupancy"),
    ("semantics", "mesh"): ("instances", "tsdf"),
    ("tsdf", "ply"): ("semantics", "instances"),
}
"""The other layers that a format takes something from."""


def graph_as(snapshot: Snapshot, name: str) -> tuple[bytes, str]:
    """The graph as bytes, and their encoding. Raises `ExportError` when there is no such format."""
    if name == "json":
        return snapshot.model_dump_json().encode(), media_type("json", "Snapshot")
    if name == "cbor":
        return cbor.dumps(snapshot.model_dump(mode="json")), media_type("cbor", "Snapshot")
    from scenegraph.interop import FORMATS, render_graph

    if name not in FORMATS:
        raise ExportError(f"format: expected one of cbor, {', '.join(FORMATS)}, got {name[:40]!r}")
    return render_graph(SceneGraph.from_snapshot(snapshot, history_limit=0), name), FORMATS[name].media_type


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


def check_layer_format(name: str, form: str) -> None:
    """Raises `ExportError` when a layer cannot be had in a format."""
    if form not in LAYER_FORMATS[name]:
        raise ExportError(f"format of {name}: expected one of {', '.join(LAYER_FORMATS[name])}, got {form[:40]!r}")


def crop(state: Mapping[str, NDArray[Any]], block_size_m: float, box: NDArray[np.float64] | None) -> State:
    """Only the blocks of a layer's state that a box (2, 3) [m] meets; large cells of octrees, which may reach far
    beyond it, stay whole."""
    if box is None:
        return dict(state)
    meets = _meets(state["block_ijk"], 1.0, block_size_m, box)
    of_block = {"block_ijk", "masks"} if "masks" in state else {name for name in state if _is_field(name)}
    cropped = {name: array[meets] if name in of_block else array for name, array in state.items()}
    if "masks" in state:
        bits = np.unpackbits(np.ascontiguousarray(state["masks"]).view(np.uint8), axis=1)
        held = np.repeat(meets, bits.sum(axis=1, dtype=np.int64))
        cropped |= {name: array[held] for name, array in state.items() if _is_field(name) and name not in of_block}
    if "cell_row" in state:
        cropped |= _crop_cells(state, meets, block_size_m, box)
    return {name: array for name, array in cropped.items() if not name.startswith("octomap.")}


def _is_field(name: str) -> bool:
    """Whether an array of a state holds something for each block or voxel."""
    return "." not in name and name != "kind" and not name.startswith("cell_")


def _meets(ijk: NDArray[Any], widths: Any, block_size_m: float, box: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which cells (n, 3), so many blocks wide, a box meets."""
    low = ijk * widths * block_size_m
    return np.asarray(np.all((low + widths * block_size_m > box[0]) & (low <= box[1]), axis=1))


def _crop_cells(
    state: Mapping[str, NDArray[Any]], meets: NDArray[np.bool_], block_size_m: float, box: NDArray[np.float64]
) -> State:
    """The cells that the box meets, with the rows that they have among the blocks that stay."""
    widths = (1 << state["cell_level"].astype(np.int64))[:, None]
    kept = _meets(state["cell_ijk"], widths, block_size_m, box)
    is_cell = np.zeros(len(meets) + len(kept), bool)
    is_cell[state["cell_row"]] = True
    stays = np.empty(len(is_cell), bool)
    stays[is_cell], stays[~is_cell] = kept, meets
    cells = {name: state[name][kept] for name in ("cell_ijk", "cell_level", "cell_value")}
    return {"cell_row": np.flatnonzero(is_cell[stays]).astype(np.int64), **cells}


class Copies:
    """A layer as it was at one moment, with what a format needs besides, to be written by another thread.

    world : has `map` with the layers by their names, and `labels` with `classes`;  box : see `crop`
    Raises `ExportError` when the layer cannot be had in this format.
    """

    def __init__(self, world: Any, name: str, form: str, box: NDArray[np.float64] | None = None) -> None:
        check_layer_format(name, form)
        self._states: dict[str, tuple[type[MapLayer], State]] = {}
        for wanted in (name, *_BESIDE.get((name, form), ())):
            layer = getattr(world.map, wanted, None)
            if layer is not None:
                self._states[wanted] = type(layer), crop(layer.state(), layer.block_size_m, box)
        labels = getattr(world, "labels", None)
        self.classes: list[ClassInfo] = [] if labels is None else labels.classes
        self._layers: dict[str, Any] = {}

    def state(self, name: str) -> State:
        """The arrays of a layer; of the semantics, with what its class ids mean."""
        _, state = self._states[name]
        return {**state, **_class_columns(self.classes)} if name == "semantics" else state

    def layer(self, name: str) -> Any:
        """A layer, made of its copy; None where the world has none of this name or no format asked for it."""
        if name not in self._layers and name in self._states:
            kind, state = self._states[name]
            made: Any = kind.from_state(state)
            self._layers[name] = made
            if name == "semantics":
                made.things = self.layer("instances")
        return self._layers.get(name)


def _class_columns(classes: Iterable[ClassInfo]) -> State:
    """The names, kinds and colours (−1: none) of classes 1, 2, … as arrays."""
    infos = list(classes)
    return {
        "class.name": np.array([info.name for info in infos], np.str_),
        "class.kind": np.array([info.kind for info in infos], np.str_),
        "class.color": np.array([info.color or (-1, -1, -1) for info in infos], np.int16).reshape(-1, 3),
    }


def classes_in(state: Mapping[str, NDArray[Any]]) -> list[ClassInfo]:
    """The classes 1, 2, … that the `npz` of semantics tells of."""
    columns = (state[f"class.{name}"].tolist() for name in ("name", "kind", "color"))
    return [
        ClassInfo(name=name, kind=kind, color=None if color[0] < 0 else tuple(color))
        for name, kind, color in zip(*columns, strict=True)
    ]


def layer_as(name: str, form: str, copies: Copies) -> tuple[bytes, str]:
    """A layer as bytes, and their encoding."""
    if form == "npz":
        file = io.BytesIO()
        np.savez_compressed(file, **copies.state(name))  # type: ignore[arg-type]
        return file.getvalue(), "application/octet-stream;npz"
    palette = Palette(copies.classes)
    layer, semantics = copies.layer(name), copies.layer("semantics")
    match name, form:
        case "tsdf", "ply":
            mesh = layer.mesh(labels_from=semantics)
            data = (mesh if semantics is None else replace(mesh, legend=palette.legend(mesh.labels))).ply()
        case "semantics", "mesh":
            data = copies.layer("tsdf").mesh(labels_from=layer).colored(palette).ply()
        case "semantics", "ply":
            data = labelled_cloud(layer, copies.layer("instances"), palette).ply()
        case "semantics", "ot":
            occupancy = copies.layer("occupancy")
            data = _written(lambda path: write_class_octree(occupancy, layer, path, palette), ".ot")
        case "occupancy", "ply":
            data = ply_bytes(vectors("xyz", layer.occupied_centres().astype(np.float32)))
        case _:
            data = _written(layer.write, f".{form}")
    return data, f"application/octet-stream;{'ply' if form == 'mesh' else form}"


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="scenegraph-") as folder:
        path = Path(folder) / f"map{suffix}"
        write(path)
        return path.read_bytes()
