"""A picture of the world that a person can check: the map and the graph from above and in perspective, truth dashed.

Surfaces are drawn as samples with a depth buffer, boxes as lines seen by the same camera. Walls that turn their back to
the camera are left out (as in a doll's house), and so is what lies above the ceilings.
"""

from __future__ import annotations

import colorsys
import hashlib
import math
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from scenegraph.errors import PictureError
from scenegraph.graph import Box, Node, SceneGraph
from scenegraph.viewpoint import Points, Surface, View, rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw"]

_BOX_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)]
_TRUTH = "#c0107a"
_DASHED = (0, (4, 3))
_WAY = "#1446c8"
_WALL = "#30343a"
_DOOR = "#d9720b"


def draw(
    graph: SceneGraph,
    path: str | Path,
    *,
    points: ArrayLike | None = None,
    colors: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    trajectory: ArrayLike | None = None,
    truth: Iterable[tuple[str, Box]] | None = None,
    title: str | None = None,
) -> Path:
    """Draw the world into a PNG file of two panels, top view and perspective, and return its path.

    graph      : rooms (attribute `footprint` [[x, y], …]), structure (attribute `polygon`, a ring or rings of
                 [x, y, z], else the box), objects (box, label and id), agents
    points     : (N, 3) surface samples in `map` [m], such as a mesh's vertices
    colors     : (N, 3) uint8, or floats in 0 … 1; by height when left out
    normals    : (N, 3) into free space; they shade the surface, and let the camera look through walls from behind
    trajectory : (M, 3) or (M, 2) where the agent went [m]
    truth      : label and box of each thing that is really there, drawn dashed

    Raises PictureError when an array has a wrong shape or the file cannot be written. Needs matplotlib, not a display.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    surface = Surface.of(points, colors, normals)
    path_points = None if trajectory is None else _trajectory(trajectory)
    things = list(truth) if truth is not None else []
    low, high = _extent(graph, surface, path_points, [box for _, box in things])
    ceiling = _ceiling(graph, high)
    views = _views(low, np.array([*high[:2], min(high[2], ceiling)]))
    figure = Figure(figsize=(20, 1.2 + 9.6 * views[0].height / views[0].width), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    top, perspective = figure.subplots(1, 2)
    for axes, view in zip((top, perspective), views, strict=True):
        axes.imshow(view.splat(surface.below(ceiling)), extent=(0, view.width, view.height, 0), interpolation="none")
        _draw_rooms(axes, view, graph, low[2])
        _draw_structure(axes, view, graph)
        _draw_objects(axes, view, graph)
        _draw_truth(axes, view, things)
        _draw_agents(axes, view, graph, path_points)
        axes.set_xlim(0, view.width)
        axes.set_ylim(view.height, 0)
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
    _draw_scale(top, views[0], low, high)
    top.set_title("from above", fontsize=11)
    perspective.set_title("in perspective", fontsize=11)
    _legend(figure, graph, truth is not None, path_points is not None)
    figure.suptitle(_title(graph, title), fontsize=13, parse_math=False)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=r"Glyph .* missing")  # labels may be in any script
            figure.savefig(path, format="png")
    except OSError as error:
        raise PictureError(
            f"{path}: cannot be written: {error.strerror}", hint="check folder and permissions"
        ) from error
    return Path(path)


# -- what is given ----------------------------------------------------------------------------------------------------


def _trajectory(given: ArrayLike) -> Points:
    array = np.asarray(given, dtype=np.float64)
    if array.ndim == 2 and array.shape[1] == 2:
        array = np.column_stack([array, np.zeros(len(array))])
    array = rows("trajectory", array)
    return array[np.isfinite(array).all(axis=1)]


def _extent(graph: SceneGraph, surface: Surface, path: Points | None, boxes: Sequence[Box]) -> tuple[Points, Points]:
    """Low and high corner of all there is to see, stray samples left out."""
    corners = [box.corners() for box in boxes]
    for node in graph:
        corners.append(node.position[None] if node.box is None else node.box.corners())
        corners += [np.column_stack([ring, np.full(len(ring), node.position[2])]) for ring in _footprint(node)]
    if len(surface.points):
        corners.append(np.percentile(surface.points, [0.2, 99.8], axis=0))
    if path is not None and len(path):
        corners.append(path)
    if not corners:
        return np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0])
    every = np.vstack(corners)
    low, high = every.min(axis=0), every.max(axis=0)
    return low - 0.1, np.maximum(high, low + 0.5) + 0.1


def _ceiling(graph: SceneGraph, high: Points) -> float:
    """Height above which nothing is drawn: just under the ceilings (their median); without one, all is drawn."""
    ceilings = [node.position[2] for node in graph.nodes("structure", "ceiling")]
    return float(np.median(ceilings)) - 0.15 if ceilings else float(high[2])


def _footprint(node: Node) -> list[Points]:
    """A room's footprint, (K, 2), if it has a proper one."""
    ring = _numbers(node.attributes.get("footprint"))
    return [ring[:, :2]] if ring is not None and ring.shape[0] >= 3 and ring.shape[1] >= 2 else []


def _rings(node: Node) -> list[Points]:
    """A piece of structure's outline: its attribute `polygon`, one ring of points or several."""
    given = node.attributes.get("polygon")
    rings = [_numbers(given)] if _numbers(given) is not None else [_numbers(part) for part in given or ()]
    return [ring for ring in rings if ring is not None and len(ring) >= 2 and ring.shape[1] == 3]


def _numbers(given: Any) -> Points | None:
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.ndim == 2 and np.isfinite(array).all() else None


def _views(low: Points, high: Points) -> tuple[View, View]:
    """Both cameras, with pictures of one size."""
    top, perspective = View.from_above(low, high), View.in_perspective(low, high)
    height = max(top.height, perspective.height)
    return top.as_high_as(height), perspective.as_high_as(height)


# -- what is drawn over the surface -----------------------------------------------------------------------------------


def _lines(axes: Axes, view: View, segments: Sequence[Points], **style: Any) -> None:
    from matplotlib.collections import LineCollection

    if segments:
        ends = np.array([len(segment) for segment in segments]).cumsum()[:-1]
        axes.add_collection(LineCollection(np.split(view.project(np.vstack(segments))[:, :2], ends), **style))


def _text(axes: Axes, view: View, at: ArrayLike, text: str, **style: Any) -> None:
    u, v, _ = view.project(np.asarray(at)[None])[0]
    axes.text(u, v, text, ha="center", va="center", parse_math=False, clip_on=True, **style)


def _box_lines(box: Box) -> list[Points]:
    corners = box.corners()
    return [corners[[a, b]] for a, b in _BOX_EDGES]


def _draw_rooms(axes: Axes, view: View, graph: SceneGraph, floor: float) -> None:
    for number, room in enumerate(graph.nodes("room")):
        color = colorsys.hsv_to_rgb((0.09 + number * 0.382) % 1.0, 0.55, 0.85)
        z = room.box.center[2] - room.box.size[2] / 2 if room.box is not None else floor + 0.1
        for ring in _footprint(room):
            outline = np.column_stack([ring, np.full(len(ring), z)])
            uv = view.project(outline)[:, :2]
            axes.fill(uv[:, 0], uv[:, 1], facecolor=(*color, 0.16), edgecolor=color, linewidth=1.6)
        name = room.attributes.get("name") or room.attributes.get("type") or room.label
        at = [*room.position[:2], z]
        box = {"facecolor": "white", "alpha": 0.6, "edgecolor": color, "boxstyle": "round,pad=0.2"}
        _text(axes, view, at, f"{name}\n{room.id}", fontsize=8, color="#333333", bbox=box, zorder=1.5)


def _draw_structure(axes: Axes, view: View, graph: SceneGraph) -> None:
    styles: dict[str, dict[str, Any]] = {
        "door": {"colors": _DOOR, "linewidths": 2.0},
        "floor": {"colors": "#7d8a70", "linewidths": 0.6},
        "ceiling": {},
        "no_feature": {"colors": "#9a9a9a", "linewidths": 0.5, "linestyles": "dotted"},
    }
    wall = {"colors": _WALL, "linewidths": 1.2}
    for node in graph.nodes("structure"):
        style = styles.get(node.label, wall)
        rings = _rings(node)
        if style and rings:
            _lines(axes, view, [np.vstack([ring, ring[:1]]) for ring in rings], **style)
        elif style and node.box is not None:
            _lines(axes, view, _box_lines(node.box), **style)
        if node.label == "door":
            _text(axes, view, node.position, node.id, fontsize=5, color="#8a4300")


def _draw_objects(axes: Axes, view: View, graph: SceneGraph) -> None:
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=1.6, foreground="white")]
    for node in graph.nodes("object"):
        color = _class_color(node.label)
        if node.box is not None:
            _lines(axes, view, _box_lines(node.box), colors=[color], linewidths=0.9)
        short = node.id.removeprefix("object_")
        text = f"{node.attributes.get('name') or node.label} {short}"
        _text(axes, view, node.position, text, fontsize=5.5, color=color, path_effects=halo)


def _class_color(label: str) -> tuple[float, float, float]:
    """The same dark colour for the same class in every picture."""
    hue = hashlib.blake2b(label.encode(), digest_size=2).digest()
    return colorsys.hsv_to_rgb(int.from_bytes(hue, "big") / 65536, 0.9, 0.6)


def _draw_truth(axes: Axes, view: View, truth: Sequence[tuple[str, Box]]) -> None:
    edges = [line for _, box in truth for line in _box_lines(box)]
    _lines(axes, view, edges, colors=_TRUTH, linewidths=0.6, linestyles=_DASHED)


def _draw_agents(axes: Axes, view: View, graph: SceneGraph, path: Points | None) -> None:
    if path is not None and len(path) > 1:
        _lines(axes, view, [path], colors=_WAY, linewidths=1.0, alpha=0.7)
    for agent in graph.nodes("agent"):
        u, v, _ = view.project(agent.position[None])[0]
        axes.plot(u, v, marker="o", color=_WAY, markersize=6)
        if agent.box is not None:
            ahead = agent.position + 0.5 * agent.box.rotation[:, 0]
            _lines(axes, view, [np.array([agent.position, ahead])], colors=_WAY, linewidths=2.5)
        _text(axes, view, agent.position + np.array([0, 0, 0.25]), agent.id, fontsize=6, color=_WAY)


def _draw_scale(axes: Axes, view: View, low: Points, high: Points) -> None:
    """Map coordinates along the top view's edges, and a bar of a round length."""
    step = next(s for s in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 1e9) if float(np.max((high - low)[:2])) / s <= 14)
    for axis, place in ((0, axes.set_xticks), (1, axes.set_yticks)):
        marks = np.arange(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1) * step
        points = np.tile(low, (len(marks), 1))
        points[:, axis] = marks
        place(view.project(points)[:, axis], [f"{mark:g}" for mark in marks])
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _legend(figure: Figure, graph: SceneGraph, with_truth: bool, with_path: bool) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=_WALL, linewidth=1.2, label="wall"),
        Line2D([], [], color=_DOOR, linewidth=2, label="door"),
    ]
    if graph.nodes("object"):
        entries.append(Line2D([], [], color="#7a2222", linewidth=0.9, label="object, as mapped (colour: class)"))
    if with_truth:
        entries.append(Line2D([], [], color=_TRUTH, linewidth=0.8, linestyle=_DASHED, label="truth"))
    if with_path:
        entries.append(Line2D([], [], color=_WAY, linewidth=1, label="way of the robot"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), fontsize=9, frameon=False)


def _title(graph: SceneGraph, title: str | None) -> str:
    counts = ", ".join(
        f"{len(graph.nodes(layer))} {layer}s" for layer in ("room", "structure", "object") if graph.nodes(layer)
    )
    return " · ".join(part for part in (title, counts or "nothing mapped yet", f"revision {graph.revision}") if part)
