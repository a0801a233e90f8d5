"""OctoMap files: `.bt` (read, write) and `.ot`, with or without colour (read).

Format after OctoMap's `AbstractOcTree::write`, `OccupancyOcTreeBase::writeBinary` (Hornung et al. 2013, §3.4). What our
map and OctoMap's maximum-likelihood tree both can say survives unchanged: read → write gives the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import InvalidParameter, MappingError
from mapping.kernels import octrees
from mapping.kernels.occupancy import UNKNOWN
from mapping.occupancy import OccupancyMap

Array: TypeAlias = NDArray[Any]

_BINARY, _FULL = b"# Octomap OcTree binary file", b"# Octomap OcTree file"
_COMMENT = b"# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
_CONTENT = {"OcTree": 4, "ColorOcTree": 7}  # bytes of a node in an .ot file
_MOST_BLOCKS = 1 << 21  # about 1 GB of voxels; a damaged file may claim the whole address space


@dataclass(frozen=True)
class _Header:
    binary: bool
    tree: str
    n_nodes: int
    voxel_size_m: float


def read_octomap(path: str | Path) -> OccupancyMap:
    """The occupancy map in an OctoMap `.bt` or `.ot` file; the file's own first line says which.

    A `.bt` file says free or occupied: such voxels get the clamping probabilities. Log-odds of an `.ot` file are
    rounded to the map's steps and clamped; colours are left out. Raises `MappingError` on a damaged or foreign file.
    """
    content = Path(path).read_bytes()
    header, stream = _split(content, path)
    if not stream:
        if header.n_nodes:
            raise MappingError(f"{path}: the file ends after its header; expected {header.n_nodes} nodes")
        return OccupancyMap(header.voxel_size_m)
    return _read_binary(header, stream, path) if header.binary else _read_full(header, stream, path)


def write_octomap(occupancy: OccupancyMap, path: str | Path) -> None:
    """Write the map as OctoMap `.bt`: each known voxel free or occupied, pruned.

    Raises `InvalidParameter` when the path does not end in `.bt` or the map reaches beyond ±32768 voxels.
    """
    if Path(path).suffix != ".bt":
        raise InvalidParameter(f"path: expected a name that ends in .bt, got {Path(path).name!r}")
    blocks = occupancy.block_ijk
    if len(blocks) and (blocks.min() < -octrees.ORIGIN // 8 or blocks.max() >= octrees.ORIGIN // 8):
        raise InvalidParameter(f"the map reaches beyond ±{octrees.ORIGIN} voxels, which OctoMap files cannot hold")
    size = occupancy.voxel_size_m
    resolution = f"{size:g}" if float(f"{size:g}") == size else repr(size)
    words, n_nodes = _encode(occupancy)
    header = f"id OcTree\nsize {n_nodes}\nres {resolution}\ndata\n"
    Path(path).write_bytes(_BINARY + b"\n" + _COMMENT + header.encode("ascii") + words.astype("<u2").tobytes())


# -- reading -------------------------------------------------------------------------------------------------


def _split(content: bytes, path: str | Path) -> tuple[_Header, bytes]:
    """The header of a file and what follows its line `data`."""
    first = content.split(b"\n", 1)[0].rstrip()
    if first not in (_BINARY, _FULL):
        raise MappingError(f"{path}: not an OctoMap file: expected the first line {_BINARY.decode()!r}")
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
        header = _Header(first == _BINARY, fields["id"], int(fields["size"]), float(fields["res"]))
    except (KeyError, ValueError) as error:
        raise MappingError(f"{path}: bad header: expected id, size and res, got {fields}") from error
    if header.tree not in _CONTENT:
        raise MappingError(f"{path}: expected a tree of type {' or '.join(_CONTENT)}, got {header.tree!r}")
    if not (np.isfinite(header.voxel_size_m) and header.voxel_size_m > 0.0 and header.n_nodes >= 0):
        raise MappingError(f"{path}: bad header: size {header.n_nodes}, res {header.voxel_size_m}")
    return header, content[at:]


def _read_binary(header: _Header, stream: bytes, path: str | Path) -> OccupancyMap:
    words = np.frombuffer(stream[: len(stream) // 2 * 2], "<u2")
    room = 8 * len(words)
    corners, levels, occupied = np.empty((room, 3), np.int32), np.empty(room, np.int8), np.empty(room, np.bool_)
    leaves, read = octrees.read_binary(words, corners, levels, occupied)
    _check(path, header, read + leaves, 2 * read, len(stream))
    layer = OccupancyMap(header.voxel_size_m)
    values = np.where(occupied[:leaves], layer.highest_evidence, layer.lowest_evidence).astype(np.int8)
    return _fill(layer, corners[:leaves], levels[:leaves], values, path)


def _read_full(header: _Header, stream: bytes, path: str | Path) -> OccupancyMap:
    content = _CONTENT[header.tree]
    octets = np.frombuffer(stream, np.uint8)
    room = len(octets) // (content + 1) + 1
    corners, levels, offsets = np.empty((room, 3), np.int32), np.empty(room, np.int8), np.empty(room, np.int64)
    leaves, nodes, read = octrees.read_full(octets, content, corners, levels, offsets)
    _check(path, header, nodes, read, len(stream))
    log_odds = octets[offsets[:leaves, None] + np.arange(4)].copy().view("<f4")[:, 0]
    if not np.isfinite(log_odds).all():
        raise MappingError(f"{path}: a node's log-odds is not a finite number")
    layer = OccupancyMap(header.voxel_size_m)
    steps = np.rint(log_odds / layer.log_odds_step)
    steps = np.where(log_odds >= 0.0, np.maximum(steps, 0.0), np.minimum(steps, -1.0))
    values = np.clip(steps, layer.lowest_evidence, layer.highest_evidence).astype(np.int8)
    return _fill(layer, corners[:leaves], levels[:leaves], values, path)


def _check(path: str | Path, header: _Header, nodes: int, bytes_read: int, bytes_there: int) -> None:
    if bytes_read < 0:
        raise MappingError(
            f"{path}: the tree is cut off or damaged: it needs more than the {bytes_there} bytes there are"
        )
    if bytes_read != bytes_there or nodes != header.n_nodes:
        raise MappingError(
            f"{path}: expected {header.n_nodes} nodes in {bytes_there} bytes, got {nodes} in {bytes_read}"
        )


def _fill(layer: OccupancyMap, corners: Array, levels: Array, values: Array, path: str | Path) -> OccupancyMap:
    blocks = np.empty((0, 3), np.int32)
    count = octrees.list_leaf_blocks(corners, levels, blocks)
    if count > _MOST_BLOCKS:
        raise MappingError(
            f"{path}: its leaves cover {count * 512:.2g} voxels; expected at most {_MOST_BLOCKS * 512:.2g}"
        )
    blocks = np.empty((count, 3), np.int32)
    octrees.list_leaf_blocks(corners, levels, blocks)
    slots = layer.store.allocate(blocks)
    octrees.fill_leaves(layer.store.fields["evidence"], corners, levels, values, slots)
    layer._note(np.arange(layer.store.n_blocks))
    return layer


# -- writing -------------------------------------------------------------------------------------------------


def _spread(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """The bits of 13-bit numbers, three places apart."""
    spread = np.zeros_like(values)
    for bit in range(13):
        spread |= (values >> bit & 1) << (3 * bit)
    return spread


def _encode(occupancy: OccupancyMap) -> tuple[NDArray[np.uint16], int]:
    """The `.bt` stream of a map, and the number of nodes of its tree."""
    keys = occupancy.block_ijk.astype(np.int64) + octrees.ORIGIN // 8
    morton = _spread(keys[:, 0]) | _spread(keys[:, 1]) << 1 | _spread(keys[:, 2]) << 2
    order = np.argsort(morton)
    n = len(order)
    block_words = np.empty((n, octrees.BLOCK_NODES), np.uint16)
    lengths, codes = np.empty(n, np.int64), np.empty(n, np.uint8)
    octrees.encode_blocks(occupancy.store.fields["evidence"], order, UNKNOWN, block_words, lengths, codes)
    known = codes > 0
    if not known.any():
        return np.empty(0, np.uint16), 0
    below, codes_below = morton[order][known], codes[known].astype(np.int64)
    inner = codes == octrees.INNER
    block_words, lengths = block_words[inner], lengths[inner]

    upper: list[
        tuple[NDArray[np.int64], NDArray[np.int64]]
    ] = []  # words and rows of first inner children, a level each
    for _ in range(4, octrees.DEPTH + 1):
        parents, which = np.unique(below >> 3, return_inverse=True)
        words = np.zeros(len(parents), np.int64)
        np.bitwise_or.at(words, which, codes_below << 2 * (below & 7))
        prunable = (words == 0x5555) | (words == 0xAAAA)
        inner_before = np.cumsum(codes_below == octrees.INNER) - (codes_below == octrees.INNER)
        first_rows = inner_before[np.searchsorted(which, np.arange(len(parents)))]
        upper.append((words[~prunable], first_rows[~prunable]))
        below = parents
        codes_below = np.where(prunable, words & 3, octrees.INNER)
    upper.reverse()
    starts = np.cumsum([0] + [len(words) for words, _ in upper])
    if len(upper[0][0]) == 0:
        raise InvalidParameter("the map fills the whole address space, which OctoMap files cannot hold")
    words = np.concatenate([words for words, _ in upper]).astype(np.uint16)
    rows = np.concatenate([rows + (starts[n + 1] if n + 1 < len(upper) else 0) for n, (_, rows) in enumerate(upper)])
    levels = np.repeat(np.arange(octrees.DEPTH, 3, -1), [len(words) for words, _ in upper])
    stream = np.empty(len(words) + int(lengths.sum()), np.uint16)
    written = octrees.write_binary(levels, rows, words, block_words, lengths, stream)
    pairs = stream[:written, None] >> np.arange(0, 16, 2, dtype=np.uint16) & 3
    return stream[:written], 1 + int(np.count_nonzero(pairs))
