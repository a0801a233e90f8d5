"""OctoMap files, read and written: `.bt` and `.ot`, with and without colour.

Format after OctoMap's `AbstractOcTree::write`, `OccupancyOcTreeBase::writeBinary` (Hornung et al. 2013, §3.4). Read →
write gives the same bytes: a map remembers the nodes of the file that it was read from (`OccupancyMap.octomap`), and
those that it has not changed since are written as they were.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import MappingError
from mapping.grid import BLOCK_VOXELS
from mapping.kernels import octrees
from mapping.kernels.octree_merge import UNKNOWN
from mapping.occupancy import OccupancyMap
from mapping.octomap_tree import BINARY, FULL, NODES, OctoMapTree, list_cells
from mapping.octomap_writing import evidence_of_tree, write_octomap

__all__ = ["OctoMapTree", "read_octomap", "write_octomap"]

Array: TypeAlias = NDArray[Any]

_MOST_BLOCKS = 1 << 25  # a damaged file may claim the whole address space
_CHUNK = 8192  # blocks that are handed to the map at a time
_PYOCTOMAP = b"\n#PYOC_"  # begins what pyoctomap appends to a `.bt` file: colours, times


@dataclass(frozen=True)
class _Header:
    binary: bool
    tree: str
    n_nodes: int
    voxel_size_m: float


def read_octomap(path: str | Path) -> OccupancyMap:
    """The occupancy map in an OctoMap `.bt` or `.ot` file; the file's own first line says which.

    A `.bt` file says free or occupied: such voxels get the clamping probabilities. Log-odds of an `.ot` file are
    rounded to the map's steps and clamped; exact log-odds and colours stay in the map's `octomap`. Trees may be
    `OcTree`, `ColorOcTree` and `OcTreeStamped` (whose times no file holds); what pyoctomap appends to a `.bt` file
    after its nodes is left out. Raises `MappingError` on a damaged or foreign file.
    """
    header, stream = _split(Path(path).read_bytes(), path)
    tree = _read_binary(header, stream, path) if header.binary else _read_full(header, stream, path)
    layer = OccupancyMap(header.voxel_size_m)
    _fill(layer, tree, path)
    layer.octomap = tree
    return layer


def _split(content: bytes, path: str | Path) -> tuple[_Header, memoryview]:
    """The header of a file and what follows its line `data`."""
    first = content[: content.find(b"\n")].rstrip()
    if first not in (BINARY, FULL):
        raise MappingError(f"{path}: not an OctoMap file: expected the first line {BINARY.decode()!r}")
    fields: dict[str, str] = {}
    at = 0
    while (end := content.find(b"\n", at)) >= 0:
        line = content[at:end].decode("ascii", errors="replace").strip()
        at = end + 1
        if line == "data":
            break
        if line and not line.startswith("#"):
            key, _, value = line.partition(" ")
            fields[key] = value.strip()
    else:
        raise MappingError(f"{path}: the header has no line 'data'")
    try:
        header = _Header(first == BINARY, fields["id"], int(fields["size"]), float(fields["res"]))
    except (KeyError, ValueError) as error:
        raise MappingError(f"{path}: bad header: expected id, size and res, got {fields}") from error
    if header.tree not in NODES:
        raise MappingError(f"{path}: expected a tree of type {' or '.join(NODES)}, got {header.tree!r}")
    if not (0.0 < header.voxel_size_m <= 100.0 and header.n_nodes >= 0):
        raise MappingError(f"{path}: bad header: size {header.n_nodes}, res {header.voxel_size_m}")
    if header.n_nodes and at == len(content):
        raise MappingError(f"{path}: the file ends after its header; expected {header.n_nodes} nodes")
    return header, memoryview(content)[at:]


def _read_binary(header: _Header, stream: memoryview, path: str | Path) -> OctoMapTree:
    words = np.frombuffer(stream[: len(stream) // 2 * 2], "<u2").astype(np.uint16, copy=False)
    expected, there = header.n_nodes, len(stream)
    if expected > 8 * len(words) + 1:
        raise MappingError(f"{path}: the tree is cut off or damaged: {expected} nodes need more than {there} bytes")
    children, occupied = np.empty(expected, np.uint8), np.empty(expected, np.bool_)
    nodes, read = octrees.read_words(words, children, occupied) if expected else (0, 0)
    if read < 0:
        raise MappingError(
            f"{path}: the tree is cut off or damaged: its {there} bytes do not hold {expected} nodes; {nodes} were read"
        )
    rest = bytes(stream[2 * read : 2 * read + len(_PYOCTOMAP)])
    if nodes != expected or (2 * read != there and rest != _PYOCTOMAP):
        raise MappingError(f"{path}: expected {expected} nodes in {there} bytes, got {nodes} in {2 * read}")
    return OctoMapTree(header.tree, True, header.voxel_size_m, children, occupied, None)


def _read_full(header: _Header, stream: memoryview, path: str | Path) -> OctoMapTree:
    expected, node = header.n_nodes, NODES[header.tree]
    if len(stream) < expected * node.itemsize:
        raise MappingError(
            f"{path}: the tree is cut off or damaged: {expected} nodes are {expected * node.itemsize} bytes, "
            f"got {len(stream)}"
        )
    if len(stream) > expected * node.itemsize:
        raise MappingError(
            f"{path}: expected {expected} nodes in {expected * node.itemsize} bytes, got {len(stream)} bytes"
        )
    nodes = np.frombuffer(stream, node)
    log_odds = nodes["log_odds"].astype(np.float32)
    if not np.isfinite(log_odds).all():
        raise MappingError(f"{path}: a node's log-odds is not a finite number")
    colors = nodes["color"].copy() if "color" in (node.names or ()) else None
    return OctoMapTree(header.tree, False, header.voxel_size_m, nodes["children"].copy(), log_odds, colors)


def _fill(layer: OccupancyMap, tree: OctoMapTree, path: str | Path) -> None:
    """Give the leaves of `tree` to a new map."""
    try:
        nodes, corners, levels = list_cells(tree.children, 3)
    except ValueError:
        raise MappingError(
            f"{path}: the tree is cut off or damaged: its nodes name other children than there are"
        ) from None
    n_blocks = int(np.sum(np.left_shift(np.int64(1), 3 * (levels.astype(np.int64) - 3))))
    if n_blocks > _MOST_BLOCKS:
        raise MappingError(
            f"{path}: its leaves cover {n_blocks * 512:.2g} voxels; expected at most {_MOST_BLOCKS * 512:.2g}"
        )
    evidence = evidence_of_tree(layer, tree)
    mixed = tree.children[nodes] > 0
    blocks, roots = corners[mixed] >> 3, nodes[mixed]
    for first in range(0, len(roots), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        rows = np.full((len(roots[chunk]), BLOCK_VOXELS), UNKNOWN, np.int8)
        octrees.fill_blocks(rows, tree.children, evidence, roots[chunk])
        layer.set_evidence(blocks[chunk], rows)
    level = levels[~mixed].astype(np.int64) - 3
    layer.fill_cells(corners[~mixed] >> 3 + level[:, None], level, evidence[nodes[~mixed]])
