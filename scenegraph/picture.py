"""A picture of the world that a person can check: the map and the graph from above and in perspective, truth dashed.

Surfaces are drawn as samples with a depth buffer, boxes as lines seen by the same camera. Walls that turn their back to
the camera are left out (as in a doll's house), and so is what lies above the ceilings.
"""

from __future__ import annotations

import colorsys
import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from scenegraph.errors import PictureError
from scenegraph.graph import Box, Node, SceneGraph
from scenegraph.lettering import Lettering
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
_WINDOW = "#3a9ad9"
_MAPPED = "#00612e"
_RELATIONS = ("#7a3fc0", "#b08a00", "#0c8599", "#a61e4d")
_DPI = 130
_MARGIN = 50  # around and between the panels, pixels
_WRONG = "#d60000"
_AGREE_M = 0.5  # a true thing is lettered as missing when nothing of its label was mapped so near


def draw(
    graph: SceneGraph,
    path: str | Path,
    *,
    points: ArrayLike | None = None,
    colors: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    trajectory: ArrayLike | None = None,
    truth: Iterable[tuple[str, Box]] | None = None,
    relations: Iterable[str] = (),
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
    relations  : which relations between objects are drawn, such as "on": from one's middle to the other's

    Raises PictureError when an array has a wrong shape or the file cannot be written. Needs matplotlib, not a display.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    surface = Surface.of(points, colors, normals)
    path_points = None if trajectory is None else _trajectory(trajectory)
    things = list(truth) if truth is not None else []
    drawn = tuple(relations)
    every = _extent(graph, surface, path_points, [box for _, box in things])
    ceiling = _ceiling(graph, float(every[:, 2].max()))
    every[:, 2] = np.minimum(every[:, 2], ceiling)
    views = View.from_above(every), View.in_perspective(every)
    widths = [view.width for view in views]
    wide, high = sum(widths) + 3 * _MARGIN, views[0].height + 3 * _MARGIN
    figure = Figure(figsize=(wide / _DPI, high / _DPI), dpi=_DPI)
    FigureCanvasAgg(figure)
    lefts = (_MARGIN, widths[0] + 2 * _MARGIN)
    panels = [
        figure.add_axes((left / wide, 1.5 * _MARGIN / high, view.width / wide, view.height / high))
        for left, view in zip(lefts, views, strict=True)
    ]
    top, perspective = panels
    for axes, view in zip(panels, views, strict=True):
        axes.imshow(view.splat(surface.below(ceiling)), extent=(0, view.width, view.height, 0), interpolation="none")
        sheet = _Sheet(axes, view, Lettering(view.width, view.height, _DPI / 72))
        _draw_rooms(sheet, graph, float(every[:, 2].min()))
        _draw_structure(sheet, graph)
        _draw_agents(sheet, graph, path_points)
        _draw_things(sheet, graph, things)
        _draw_relations(sheet, graph, drawn)
        axes.set_xlim(0, view.width)
        axes.set_ylim(view.height, 0)
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
    _draw_scale(top, views[0], every.min(axis=0), every.max(axis=0))
    top.set_title("from above, x and y in metres", fontsize=11)
    perspective.set_title("in perspective", fontsize=11)
    _legend(figure, graph, truth is not None, path_points is not None, drawn)
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


def _extent(graph: SceneGraph, surface: Surface, path: Points | None, boxes: Sequence[Box]) -> Points:
    """Points (N, 3) that surround all there is to see, stray samples left out."""
    corners = [box.corners() for box in boxes]
    for node in graph:
        corners.append(node.position[None] if node.box is None else node.box.corners())
        corners += [np.column_stack([ring, np.full(len(ring), node.position[2])]) for ring in _footprint(node)]
    if len(surface.points):
        low, high = np.percentile(surface.points, [0.2, 99.8], axis=0)
        some = surface.points[:: max(1, len(surface.points) // 20_000)]
        corners.append(some[((some >= low) & (some <= high)).all(axis=1)])
    if path is not None and len(path):
        corners.append(path)
    every = np.vstack([part for part in corners if len(part)] or [np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])])
    low, high = every.min(axis=0), every.max(axis=0)
    if float(np.min((high - low)[:2])) < 1.0:  # a metre at least
        every = np.vstack([every, (low + high) / 2 - 0.5, (low + high) / 2 + 0.5])
    return every


def _ceiling(graph: SceneGraph, high: float) -> float:
    """Height above which nothing is drawn: just under the ceilings (their median); without one, all is drawn."""
    ceilings = [node.position[2] for node in graph.nodes("structure", "ceiling")]
    return float(np.median(ceilings)) - 0.15 if ceilings else high


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


# -- what is drawn over the surface -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Sheet:
    """One panel: what is drawn at map points, and the places that its labels take."""

    axes: Axes
    view: View
    lettering: Lettering

    def lines(self, segments: Sequence[Points], *, halo: bool = False, **style: Any) -> None:
        """Polylines through map points; `halo`: with a white seam, to be seen on any ground."""
        from matplotlib.collections import LineCollection

        if segments:
            ends = np.array([len(segment) for segment in segments]).cumsum()[:-1]
            drawn = LineCollection(np.split(self.view.project(np.vstack(segments))[:, :2], ends), **style)
            if halo:
                drawn.set_path_effects([_halo(2.2)])
            self.axes.add_collection(drawn)

    def text(self, at: ArrayLike, text: str, points: float, **style: Any) -> None:
        """A label for a map point: there, or near it with a line that leads there."""
        u, v, _ = self.view.project(np.asarray(at)[None])[0]
        x, y = self.lettering.place(u, v, text, points)
        if math.hypot(x - u, y - v) > 1.3 * points * _DPI / 72:
            self.axes.plot([u, x], [v, y], color=style.get("color"), linewidth=0.4, alpha=0.8)
        style.setdefault("path_effects", [_halo(1.8)])
        self.axes.text(
            x, y, text, fontsize=points, ha="center", va="center", parse_math=False, clip_on=True, zorder=5, **style
        )


def _halo(width: float) -> Any:
    from matplotlib.patheffects import withStroke

    return withStroke(linewidth=width, foreground="white")


def _box_lines(box: Box) -> list[Points]:
    corners = box.corners()
    return [corners[[a, b]] for a, b in _BOX_EDGES]


def _draw_rooms(sheet: _Sheet, graph: SceneGraph, floor: float) -> None:
    for number, room in enumerate(graph.nodes("room")):
        color = colorsys.hsv_to_rgb((0.09 + number * 0.382) % 1.0, 0.55, 0.85)
        z = room.box.center[2] - room.box.size[2] / 2 if room.box is not None else floor + 0.1
        for ring in _footprint(room):
            uv = sheet.view.project(np.column_stack([ring, np.full(len(ring), z)]))[:, :2]
            sheet.axes.fill(uv[:, 0], uv[:, 1], facecolor=(*color, 0.16), edgecolor=color, linewidth=1.6)
        name = str(room.attributes.get("name") or room.attributes.get("type") or room.label).replace("_", " ")
        frame = {"facecolor": "white", "alpha": 0.75, "edgecolor": color, "boxstyle": "round,pad=0.2"}
        sheet.text([*room.position[:2], z], f"{name}\n{room.id}", 8, color="#222222", bbox=frame, path_effects=[])


def _draw_structure(sheet: _Sheet, graph: SceneGraph) -> None:
    styles: dict[str, dict[str, Any]] = {
        "door": {"colors": _DOOR, "linewidths": 2.0},
        "window": {"colors": _WINDOW, "linewidths": 1.6},
        "floor": {"colors": "#7d8a70", "linewidths": 0.6},
        "ceiling": {},
        "no_feature": {},
    }
    wall = {"colors": _WALL, "linewidths": 1.2}
    for node in graph.nodes("structure"):
        style = styles.get(node.label, wall)
        if _turned_away(node, sheet.view):
            continue
        rings = _rings(node)
        if style and rings:
            sheet.lines([np.vstack([ring, ring[:1]]) for ring in rings], **style)
        elif style and node.box is not None:
            sheet.lines(_box_lines(node.box), **style)


def _turned_away(node: Node, view: View) -> bool:
    """Whether a camera in perspective sees the back of a wall, which is left out of the surface too."""
    normal = node.attributes.get("normal")
    if not view.focal or node.label == "door" or not isinstance(normal, list | tuple) or len(normal) != 3:
        return False
    return float((view.eye - node.position) @ np.asarray(normal, dtype=np.float64)) < 0


def _draw_things(sheet: _Sheet, graph: SceneGraph, truth: Sequence[tuple[str, Box]]) -> None:
    """Mapped boxes solid, true ones dashed; letters for what is mapped, and for what is there but was not mapped."""
    mapped = sorted(graph.nodes("object"), key=lambda node: 0.0 if node.box is None else -float(np.prod(node.box.size)))
    boxes = [line for node in mapped if node.box is not None for line in _box_lines(node.box)]
    sheet.lines(boxes, halo=True, colors=_MAPPED, linewidths=0.9)
    edges = [line for _, box in truth for line in _box_lines(box)]
    sheet.lines(edges, colors=_TRUTH, linewidths=0.7, linestyles=_DASHED)
    for node in mapped:
        name = _called(node)
        wrong = bool(truth) and not any(_agree(node, label, box) for label, box in truth)
        sheet.text(_top(node), name, 6, color=_WRONG if wrong else _MAPPED)
    for label, box in truth:
        if not any(_agree(node, label, box) for node in mapped):
            sheet.text(box.center, label.replace("_", " "), 6, color=_TRUTH, style="italic")


def _called(node: Node) -> str:
    """The name of a thing, else its class; what has no class but `object` is told apart by its id."""
    name = str(node.attributes.get("name") or node.label)
    return (node.id if name == "object" else name).removeprefix("object_").replace("_", " ")


def _draw_relations(sheet: _Sheet, graph: SceneGraph, relations: Sequence[str]) -> None:
    """A line for each pair of objects of which a relation holds; one each for symmetric ones."""
    things = {node.id: node.position for node in graph.nodes("object")}
    for relation, color in zip(relations, _RELATIONS * len(relations), strict=False):
        pairs = {(edge.source, edge.target) for edge in graph.edges(relation)}
        lines = [
            np.array([things[a], things[b]])
            for a, b in sorted(pairs)
            if a in things and b in things and (a < b or (b, a) not in pairs)
        ]
        sheet.lines(lines, colors=color, linewidths=1.1)


def _agree(node: Node, label: str, box: Box) -> bool:
    return node.label == label and float(np.linalg.norm(node.position - box.center)) <= _AGREE_M


def _top(node: Node) -> Points:
    """Where an object's label points at: the middle of its upper side."""
    rise = 0.0 if node.box is None else float(np.ptp(node.box.corners()[:, 2])) / 2
    at: Points = node.position + np.array([0.0, 0.0, rise])
    return at


def _draw_agents(sheet: _Sheet, graph: SceneGraph, path: Points | None) -> None:
    if path is not None and len(path) > 1:
        sheet.lines([path], colors=_WAY, linewidths=1.0, alpha=0.3 if sheet.view.focal else 0.7)
    for agent in graph.nodes("agent"):
        u, v, _ = sheet.view.project(agent.position[None])[0]
        sheet.axes.plot(u, v, marker="o", color=_WAY, markersize=6)
        if agent.box is not None:
            ahead = agent.position + 0.5 * agent.box.rotation[:, 0]
            sheet.lines([np.array([agent.position, ahead])], colors=_WAY, linewidths=2.5)
        name = str(agent.attributes.get("name") or agent.id)
        sheet.text(agent.position + np.array([0, 0, 0.25]), name, 7, color=_WAY)


def _draw_scale(axes: Axes, view: View, low: Points, high: Points) -> None:
    """Map coordinates along the top view's edges."""
    step = next(s for s in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 1e9) if float(np.max((high - low)[:2])) / s <= 14)
    for axis, place in ((0, axes.set_xticks), (1, axes.set_yticks)):
        marks = np.arange(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1) * step
        points = np.tile(low, (len(marks), 1))
        points[:, axis] = marks
        place(view.project(points)[:, axis], [f"{mark:g}" for mark in marks])


def _legend(figure: Figure, graph: SceneGraph, with_truth: bool, with_path: bool, relations: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=_WALL, linewidth=1.2, label="wall"),
        Line2D([], [], color=_DOOR, linewidth=2, label="door"),
        Line2D([], [], color=_WINDOW, linewidth=1.6, label="window"),
    ]
    if graph.nodes("object"):
        entries.append(Line2D([], [], color=_MAPPED, linewidth=0.9, label="object as mapped"))
    if with_truth:
        entries.append(
            Line2D(
                [],
                [],
                color=_TRUTH,
                linewidth=0.8,
                linestyle=_DASHED,
                label="truth (lettered: nothing such was mapped there)",
            )
        )
    if with_truth:
        entries.append(
            Line2D([], [], color=_WRONG, marker="s", markersize=5, linewidth=0, label="mapped, nothing such is there")
        )
    for relation, color in zip(relations, _RELATIONS * len(relations), strict=False):
        entries.append(Line2D([], [], color=color, linewidth=1.1, label=relation.replace("_", " ")))
    if with_path:
        entries.append(Line2D([], [], color=_WAY, linewidth=1, label="way of the robot"))
    figure.legend(handles=entries, loc="lower center", ncols=len(entries), fontsize=9, frameon=False)


def _title(graph: SceneGraph, title: str | None) -> str:
    counts = ", ".join(
        f"{len(graph.nodes(layer))} {layer}s" for layer in ("room", "structure", "object") if graph.nodes(layer)
    )
    return " · ".join(part for part in (title, counts or "nothing mapped yet", f"revision {graph.revision}") if part)
