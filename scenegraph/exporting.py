"""A world, here or on a server, as files of other programs."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from mapping.observations import ClassInfo, LabelSpace
from scenegraph.errors import ExportError, nearest

if TYPE_CHECKING:
    from scenegraph.graph import SceneGraph
    from scenegraph.importing import GraphFile
    from scenegraph.service.client import Client
    from scenegraph.world import World

__all__ = [
    "LAYER_OF",
    "Imported",
    "Saved",
    "Served",
    "Source",
    "check_format",
    "export",
    "export_cost",
    "export_pddl",
    "formats",
    "layers_of_server",
    "source_of",
    "write_text",
]

LAYER_OF: dict[str, str | None] = {
    "ply": "tsdf",
    "mesh": "semantics",
    "ot": "semantics",
    "bt": "occupancy",
    "npz": None,
}
"""The map layer that a format is of when none is asked for; None: it must be."""
_PLANNING = "pddl"
_OF_MAP = ("png", "cost")
"""Formats that are made from several layers here."""


class Source(Protocol):
    """What is exported: a world in this process, or a server's."""

    @property
    def graph(self) -> SceneGraph: ...
    @property
    def classes(self) -> list[ClassInfo]:
        """The classes 1, 2, …"""

    def layer(self, name: str) -> Any:
        """A map layer by its name."""

    def written(self, name: str, form: str, box: str | None) -> bytes:
        """A layer in one of its formats, cropped to `x0,y0,z0,x1,y1,z1`."""


class Saved:
    """A world in this process."""

    def __init__(self, world: World) -> None:
        self._world = world

    @property
    def graph(self) -> SceneGraph:
        return self._world.graph

    @property
    def classes(self) -> list[ClassInfo]:
        return self._world.labels.classes

    def layer(self, name: str) -> Any:
        return self._world.map.layers[name]

    def written(self, name: str, form: str, box: str | None) -> bytes:
        from scenegraph.service import exports

        return exports.layer_as(name, form, exports.Copies(self._world, name, form, exports.read_box(box)))[0]


class Imported:
    """A graph without a map."""

    classes: ClassVar[list[ClassInfo]] = []

    def __init__(self, graph: SceneGraph) -> None:
        self.graph = graph

    def layer(self, name: str) -> Any:
        raise ExportError(f"{name}: a graph that was read from a file has no map")

    def written(self, name: str, form: str, box: str | None) -> bytes:
        raise ExportError(f"{form} is made from the map: a graph that was read from a file has none")


class Served:
    """A world on a server; each layer is fetched when it is asked for."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._arrays: dict[str, Mapping[str, NDArray[Any]]] = {}

    @cached_property
    def graph(self) -> SceneGraph:
        return self._client.graph()

    @cached_property
    def classes(self) -> list[ClassInfo]:
        from scenegraph.service.exports import classes_in

        return classes_in(self._fetched("semantics"))

    def layer(self, name: str) -> Any:
        from mapping.instances import InstanceMap
        from mapping.occupancy import OccupancyMap
        from mapping.semantics import SemanticMap
        from mapping.tsdf import TsdfMap

        kinds: dict[str, Any] = {kind.kind: kind for kind in (OccupancyMap, TsdfMap, SemanticMap, InstanceMap)}
        made = kinds[name].from_state(self._fetched(name))
        if name == "semantics":
            made.things = self.layer("instances")
        return made

    def written(self, name: str, form: str, box: str | None) -> bytes:
        from scenegraph.service.exports import check_layer_format, read_box

        check_layer_format(name, form)
        corners = read_box(box)
        return self._client.map_layer(name, form, None if corners is None else corners.ravel().tolist())

    def _fetched(self, name: str) -> Mapping[str, NDArray[Any]]:
        if name not in self._arrays:
            with np.load(io.BytesIO(self._client.map_layer(name, "npz"))) as state:
                self._arrays[name] = dict(state)
        return self._arrays[name]


def source_of(opened: World | GraphFile) -> Source:
    """What can be exported of a saved world, or of a graph in a file."""
    from scenegraph.importing import GraphFile

    return Imported(opened.graph) if isinstance(opened, GraphFile) else Saved(opened)


def formats() -> list[str]:
    """The names of all formats."""
    from scenegraph.interop import FORMATS

    return [*FORMATS, _PLANNING, *_OF_MAP, *LAYER_OF]


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
    _writing(path, lambda: path.write_text(text, encoding="utf-8"))


def export(source: Source, name: str, path: str | Path, *, layer: str | None = None, box: str | None = None) -> Path:
    """Write a world in the format of this name to a file, and return its path.

    source  json, spark_dsg, node_link, graphml, csv and parquet are made from its graph; png (picture) and gltf from
            graph and surface; gltf of a graph without a map has boxes only
    layer   of which map layer ply, mesh, ot, bt and npz are, such as "semantics"; default: see `LAYER_OF`
    box     `x0,y0,z0,x1,y1,z1` [m]: only the blocks of the layer that meet it

    Raises `ExportError` when there is no such format or the file cannot be written.
    """
    from scenegraph.interop import export_graph, gltf_bytes

    check_format(name)
    if name == "cost":
        raise ExportError("cost: expected a table of costs", hint="export_cost")
    if name == _PLANNING:
        raise ExportError("pddl: expected a goal", hint="export_pddl")
    path = Path(path)
    of_layer = name in LAYER_OF
    if not of_layer and (layer or box):
        raise ExportError(f"{'layer' if layer else 'box'}: expected with {', '.join(LAYER_OF)}, got it with {name}")
    if of_layer:
        data = source.written(_layer_name(layer or LAYER_OF[name]), name, box)
        _writing(path, lambda: path.write_bytes(data))
    elif name == "png":
        _writing(path, lambda: _draw(source, path))
    elif name == "gltf" and not isinstance(source, Imported):
        model = gltf_bytes(source.graph, source.layer("tsdf").mesh())
        _writing(path, lambda: path.write_bytes(model))
    else:
        export_graph(source.graph, name, path)
    return path


def export_pddl(
    target: World | GraphFile | Client, goal: str, path: str | Path, *, robot: str | None = None, scoped: bool = True
) -> tuple[Path, Path]:
    """Write what a planner is given for a goal, and return the paths of the problem and of its domain beside it.

    path    of the problem; the domain's name ends in `_domain`
    scoped  only what the goal and the actions can touch; else everything in the graph

    Raises `GoalRefused` when the goal cannot be planned for, `ExportError` when a file cannot be written.
    """
    from scenegraph.importing import GraphFile

    if hasattr(target, "planning_task"):
        task = target.planning_task(goal, robot=robot, scoped=scoped)
    else:
        with GraphFile(target.graph()) as copy:
            task = copy.planning_task(goal, robot=robot, scoped=scoped)
    path = Path(path)
    domain = path.with_name(f"{path.stem}_domain{path.suffix or '.pddl'}")
    write_text(path, task.pddl)
    write_text(domain, task.domain.text)
    return path, domain


def export_cost(
    source: Source, costs: str | Path, path: str | Path, *, band_m: tuple[float, float]
) -> tuple[Path, tuple[str, ...]]:
    """Write what it costs to be where, and return the path of the file to open, and which classes of the table the map
    does not know.

    costs   JSON file, see `CostTable.from_document`
    path    `.ply`: all surfaces in space, with a property `cost`; else a grid seen from above: `.npz`, or the name of a
            PNG and a YAML file, see `CostGrid.write`
    band_m  heights [m] that matter to the grid

    Raises `InvalidParameter` where the table is bad, `ExportError` when a file cannot be written.
    """
    from mapping.cost import CostMap, CostTable, cost_cloud
    from mapping.ply import ply_bytes, vectors

    path = Path(path)
    classes = LabelSpace(classes=dict(enumerate(source.classes, start=1)))
    table = CostTable.read(costs, classes, allow_absent=True)
    semantics, occupancy = source.layer("semantics"), source.layer("occupancy")
    if path.suffix == ".ply":
        centres, cost = cost_cloud(semantics, table, occupancy)
        columns = [*vectors("xyz", centres.astype(np.float32)), ("cost", cost.astype(np.float32))]
        _writing(path, lambda: path.write_bytes(ply_bytes(columns)))
        return path, table.absent
    grid = CostMap(semantics, table, band_m=band_m, occupancy=occupancy)
    grid.update()
    _writing(path, lambda: grid.grid().write(path))
    return path if path.suffix == ".npz" else path.with_suffix(".yaml"), table.absent


def _layer_name(name: str | None) -> str:
    from scenegraph.service.exports import LAYER_FORMATS

    if name is None:
        raise ExportError(f"npz: expected a layer, one of {', '.join(LAYER_FORMATS)}", hint="--layer semantics")
    if name not in LAYER_FORMATS:
        near = nearest(name, LAYER_FORMATS)
        raise ExportError(
            f"unknown layer {name!r}: expected one of {', '.join(LAYER_FORMATS)}",
            hint=f"did you mean {near[0]!r}?" if near else None,
        )
    return name


def _writing(path: Path, write: Callable[[], object]) -> None:
    try:
        write()
    except OSError as error:
        raise ExportError(f"{path}: cannot be written: {error.strerror}", hint="check folder and permissions") from None


def _draw(source: Source, path: Path) -> None:
    from scenegraph.picture import draw

    mesh = source.layer("tsdf").mesh()
    draw(source.graph, path, points=mesh.vertices, colors=mesh.colors, normals=mesh.normals)


def layers_of_server(client: Client) -> Callable[[str], Any]:
    """The map layers of a server by their name, each fetched when it is asked for."""
    return Served(client).layer
