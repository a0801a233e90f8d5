"""Writing OctoMap files: the tree of a map, with the file's own nodes where it has not changed since it was read."""

from __future__ import annotations

from collections.abc import Callable
from math import log
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import InvalidParameter
from mapping.kernels import octree_merge, octrees
from mapping.octomap_tree import BINARY, FULL, HIGHEST, LOWEST, NODES, OctoMapTree, list_cells, morton_codes

if TYPE_CHECKING:
    from mapping.occupancy import OccupancyMap

Array: TypeAlias = NDArray[Any]
ColorsOf: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.uint8]]

_MOST_SPLIT = 6
"""Leaves of higher levels keep one colour."""
_AT_ONCE = 1 << 18  # voxels whose colours are asked for together
_COMMENT = b"# (feel free to add / change comments, but leave the first line as it is!)\n#\n"


def write_octomap(
    occupancy: OccupancyMap, path: str | Path, *, colors: ColorsOf | None = None, split: bool = False
) -> None:
    """Write the map as an OctoMap file, `.bt` (each voxel free or occupied) or `.ot` (log-odds) as the name ends.

    colors : what gives the colours (N, 3) uint8 of points (N, 3) [m], asked at the centres of occupied leaves, for an
             `.ot` file with colours; white means none. Without it, colours of the file that was read are kept
    split  : whether the colours are asked of each occupied voxel, and leaves whose voxels differ are split; otherwise
             a leaf of many voxels has the colour that its centre has. Leaves of more than 64³ voxels are never split

    Nodes of the file that the map was read from are written as they were where the map has not changed since, but a
    `.bt` file from an `.ot` file has clamped values and is pruned, as OctoMap's `writeBinary` does. Raises
    `InvalidParameter` where the name ends otherwise, a `.bt` file should have colours, the colours are of another
    shape, the map reaches beyond ±32768 voxels, or is one single cell that fills the whole of this (`.bt`).
    """
    suffix = Path(path).suffix
    if suffix not in (".bt", ".ot"):
        raise InvalidParameter(f"path: expected a name that ends in .bt or .ot, got {Path(path).name!r}")
    binary = suffix == ".bt"
    if binary and colors is not None:
        raise InvalidParameter(
            f"colors: a .bt file has none, expected a name that ends in .ot, got {Path(path).name!r}"
        )
    origin = occupancy.octomap
    kind = "OcTree" if origin is None else origin.kind
    kept = None if binary and origin is not None and not origin.is_binary else origin
    children, log_odds, color = _merge(occupancy, kept, binary)
    if colors is not None:
        if split:
            children, log_odds = _split(colors, children, log_odds, occupancy.voxel_size_m)
        kind, color = "ColorOcTree", _ask_colors(colors, children, log_odds, occupancy.voxel_size_m)
    stream = _binary(children, log_odds) if binary else _full(NODES[kind], children, log_odds, color)
    size = occupancy.voxel_size_m
    resolution = f"{size:g}" if float(f"{size:g}") == size else repr(size)
    header = f"id {kind}\nsize {len(children)}\nres {resolution}\ndata\n"
    with Path(path).open("wb") as file:
        file.write((BINARY if binary else FULL) + b"\n" + _COMMENT + header.encode("ascii"))
        file.write(stream.view(np.uint8).data)


def evidence_of_tree(occupancy: OccupancyMap, tree: OctoMapTree) -> NDArray[np.int8]:
    """The evidence (n,) that the map has for the log-odds of each node of `tree`: the nearest step, clamped."""
    lowest, highest = occupancy.lowest_evidence, occupancy.highest_evidence
    if tree.content.dtype == np.bool_:
        return np.where(tree.content, np.int8(highest), np.int8(lowest))
    evidence = np.empty(len(tree.content), np.int8)
    octrees.nearest_evidence(evidence, tree.content, 1.0 / occupancy.log_odds_step, lowest, highest)
    return evidence


def _log_odds_of_evidence(occupancy: OccupancyMap, binary: bool) -> NDArray[np.float32]:
    """The log-odds (256,) of evidence −128 …: for `.bt` files OctoMap's clamps, else the map's and what is between."""
    evidence = np.arange(-128, 128)
    if binary:
        return np.where(evidence >= 0, HIGHEST, LOWEST).astype(np.float32)
    log_odds = (evidence * occupancy.log_odds_step).astype(np.float32)
    for at, probability in (
        (occupancy.lowest_evidence, occupancy.lowest),
        (occupancy.highest_evidence, occupancy.highest),
    ):
        log_odds[at + 128] = log(probability / (1.0 - probability))
    return log_odds


def _cells(occupancy: OccupancyMap) -> tuple[Array, Array, Array]:
    """The map as cells that do not overlap, in Morton order: code, level, content."""
    blocks, slots = occupancy.store.dense_blocks()
    uniform = occupancy.store.uniform_cells()
    corners = np.concatenate([blocks, uniform.ijk << uniform.level[:, None]]).astype(np.int64)
    if len(corners) and (corners.min() < -octrees.ORIGIN // 8 or corners.max() >= octrees.ORIGIN // 8):
        raise InvalidParameter(f"the map reaches beyond ±{octrees.ORIGIN} voxels, which OctoMap files cannot hold")
    codes = morton_codes(corners + octrees.ORIGIN // 8)
    levels = np.concatenate([np.full(len(blocks), 3, np.uint8), uniform.level + np.uint8(3)])
    contents = np.concatenate([slots.astype(np.int64) + octree_merge.ROW, uniform.value.astype(np.int64)])
    order = np.argsort(codes)
    return codes[order], levels[order], contents[order]


def _merge(occupancy: OccupancyMap, origin: OctoMapTree | None, binary: bool) -> tuple[Array, Array, Array | None]:
    """The nodes of the map's tree: children, log-odds, and colours where `origin` has them."""
    codes, levels, contents = _cells(occupancy)
    value_of = _log_odds_of_evidence(occupancy, binary)
    if origin is None:
        of_file: tuple[Array, ...] = (np.empty(0, np.uint8), np.empty(0, np.int8), np.empty(0, np.float32))
        file_colors = None
    else:
        of_file, file_colors = (origin.children, evidence_of_tree(occupancy, origin), origin.log_odds), origin.colors
    white = np.full((1, 3), octrees.WHITE, np.uint8)
    frames = np.empty((octrees.DEPTH + 2, octree_merge.FRAME), np.int64)
    limits = np.zeros((octrees.DEPTH + 2, 2), np.float32)
    cursor = np.array([octrees.DEPTH, 1, 0])
    octree_merge.open_root(frames, of_file[0])
    room = len(of_file[0]) + len(codes) + 64 * occupancy.store.n_blocks + 64
    children, values = np.empty(room, np.uint8), np.empty(room, np.float32)
    colors = white if file_colors is None else np.empty((room, 3), np.uint8)
    while not octree_merge.merge(
        children, values, colors, cursor, frames, limits,
        codes, levels, contents, occupancy.store.payload, value_of,
        *of_file, white if file_colors is None else file_colors,
    ):  # fmt: skip
        children, values = (np.concatenate([array, np.empty_like(array)]) for array in (children, values))
        if file_colors is not None:
            colors = np.concatenate([colors, np.empty_like(colors)])
    n = int(cursor[1])
    return children[:n], values[:n], None if file_colors is None else colors[:n]


def _ask_colors(colors_of: ColorsOf, children: Array, log_odds: Array, voxel_size_m: float) -> NDArray[np.uint8]:
    nodes, corners, levels = list_cells(children, 0)
    occupied = log_odds[nodes] >= 0.0
    centres = (corners[occupied] + 0.5 * (1 << levels[occupied].astype(np.int64))[:, None]) * voxel_size_m
    colors = np.full((len(children), 3), octrees.WHITE, np.uint8)
    colors[nodes[occupied]] = _asked(colors_of, centres)
    octrees.average_colors(colors, children)
    return colors


def _asked(colors_of: ColorsOf, centres: Array) -> NDArray[np.uint8]:
    colors = np.asarray(colors_of(centres))
    if colors.shape != centres.shape or colors.dtype != np.uint8:
        raise InvalidParameter(f"colors: expected uint8 {centres.shape}, got {colors.dtype} {colors.shape}")
    return colors


def _split(colors_of: ColorsOf, children: Array, log_odds: Array, voxel_size_m: float) -> tuple[Array, Array]:
    """Children and log-odds of the tree in which no occupied leaf has voxels of different colours."""
    asked = octrees.DEPTH
    while True:
        nodes, corners, levels = list_cells(children, 0)
        occupied = log_odds[nodes] >= 0.0
        mixed = np.zeros(len(nodes), np.bool_)
        for level in range(1, min(_MOST_SPLIT, asked) + 1):
            leaves = np.flatnonzero(occupied & (levels == level))
            mixed[leaves] = _are_mixed(colors_of, corners[leaves], level, voxel_size_m)
        if not mixed.any():
            return children, log_odds
        parents, asked = nodes[mixed], int(levels[mixed].max()) - 1
        places = np.repeat(parents + 1, 8)
        children = children.copy()
        children[parents] = 255
        log_odds = np.insert(log_odds, places, np.repeat(log_odds[parents], 8))
        children = np.insert(children, places, np.uint8(0))


def _are_mixed(colors_of: ColorsOf, corners: Array, level: int, voxel_size_m: float) -> NDArray[np.bool_]:
    """Whether the voxels of each leaf, given by its lowest voxel (N, 3), have different colours."""
    voxels = np.indices((1 << level,) * 3).reshape(3, -1).T
    mixed = np.zeros(len(corners), np.bool_)
    at_once = max(1, _AT_ONCE // len(voxels))
    for first in range(0, len(corners), at_once):
        chunk = slice(first, first + at_once)
        centres = (corners[chunk, None] + (voxels + 0.5)) * voxel_size_m
        colors = _asked(colors_of, centres.reshape(-1, 3)).reshape(-1, len(voxels), 3)
        mixed[chunk] = (colors != colors[:, :1]).any(axis=(1, 2))
    return mixed


def _binary(children: Array, log_odds: Array) -> Array:
    if len(children) == 1:
        raise InvalidParameter("the map fills the whole address space, which .bt files cannot hold")
    words = np.empty(np.count_nonzero(children), np.uint16)
    octrees.write_words(children, log_odds >= 0.0, words)
    return words.astype("<u2", copy=False)


def _full(node: np.dtype[Any], children: Array, log_odds: Array, colors: Array | None) -> Array:
    nodes = np.empty(len(children), node)
    nodes["log_odds"], nodes["children"] = log_odds, children
    if "color" in (node.names or ()):
        nodes["color"] = octrees.WHITE if colors is None else colors
    return nodes
