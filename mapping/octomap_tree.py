"""The nodes of an OctoMap file as they stand in it: exact log-odds and colours, which a byte a voxel cannot hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import MappingError
from mapping.grid import as_points, point_to_ijk
from mapping.kernels import octrees

Array: TypeAlias = NDArray[Any]

BINARY, FULL = b"# Octomap OcTree binary file", b"# Octomap OcTree file"
"""The first lines of `.bt` and `.ot` files."""
_PLAIN = np.dtype([("log_odds", "<f4"), ("children", "u1")])
_COLORED = np.dtype([("log_odds", "<f4"), ("color", "u1", 3), ("children", "u1")])
NODES: dict[str, np.dtype[Any]] = {"OcTree": _PLAIN, "ColorOcTree": _COLORED, "OcTreeStamped": _PLAIN}
"""What a node is in an `.ot` file of each kind of tree."""
LOWEST, HIGHEST = (np.float32(log(p / (1.0 - p))) for p in (0.1192, 0.971))
"""Log-odds of free and occupied leaves of `.bt` files: the clamps of OctoMap."""


@dataclass(frozen=True, eq=False)
class OctoMapTree:
    """The nodes of an OctoMap file, depth first; children in the order of their index (bit 0: x, 1: y, 2: z).

    A map that was read from a file keeps this, so that writing it again gives the same nodes wherever the map has not
    changed since. It answers as the file does, whatever happened to the map.
    """

    kind: str
    """The file's name for its type of tree, such as `OcTree`."""
    is_binary: bool
    """Whether it is a `.bt` file."""
    voxel_size_m: float
    children: NDArray[np.uint8]
    """(n,) bit c is set where child c exists; 0 for leaves."""
    content: NDArray[np.float32] | NDArray[np.bool_]
    """(n,) log-odds; of a `.bt` file, whether the node is occupied."""
    colors: NDArray[np.uint8] | None
    """(n, 3) red, green, blue; white (255, 255, 255) means none. None where the file has no colours."""

    @property
    def log_odds(self) -> NDArray[np.float32]:
        """(n,) log-odds of each node."""
        return (
            np.where(self.content, HIGHEST, LOWEST) if self.is_binary else self.content.astype(np.float32, copy=False)
        )

    @property
    def memory_bytes(self) -> int:
        """Bytes held by the nodes."""
        return self.children.nbytes + self.content.nbytes + (0 if self.colors is None else self.colors.nbytes)

    def colors_of(self, p_map: ArrayLike) -> NDArray[np.uint8]:
        """The colour (N, 3) uint8 that the file has at each point (N, 3) [m]; white where there is none."""
        nodes = self.find(p_map)
        if self.colors is None:
            return np.full((len(nodes), 3), octrees.WHITE, np.uint8)
        return np.where((nodes < 0)[:, None], np.uint8(octrees.WHITE), self.colors[nodes])

    def log_odds_of(self, p_map: ArrayLike) -> NDArray[np.float32]:
        """The log-odds (N,) float32 that the file has at each point (N, 3) [m]; NaN where unknown."""
        nodes = self.find(p_map)
        if not len(self.children):
            return np.full(len(nodes), np.nan, np.float32)
        return np.where(nodes < 0, np.float32(np.nan), self.log_odds[nodes])

    def state(self) -> dict[str, Array]:
        """Everything that makes this tree but its voxel size, as named arrays, to be saved with a map."""
        state = {
            "octomap.kind": np.array(self.kind),
            "octomap.children": self.children,
            "octomap.content": self.content,
        }
        return state if self.colors is None else {**state, "octomap.colors": self.colors}

    @classmethod
    def from_state(cls, state: Mapping[str, Array], voxel_size_m: float) -> OctoMapTree | None:
        """The tree that `state()` described, None where there is none; raises `MappingError` where it does not fit."""
        if "octomap.kind" not in state:
            return None
        kind, children, content = (state.get(f"octomap.{name}") for name in ("kind", "children", "content"))
        colors = state.get("octomap.colors")
        if (
            str(kind) not in NODES
            or children is None
            or content is None
            or children.dtype != np.uint8
            or content.dtype not in (np.bool_, np.float32)
            or not children.ndim == content.ndim == 1
            or len(children) != len(content)
            or not np.isfinite(content).all()
            or (colors is not None and (colors.dtype != np.uint8 or colors.shape != (len(children), 3)))
            or (content.dtype == np.float32 and (colors is None) == ("color" in (NODES[str(kind)].names or ())))
        ):
            raise MappingError("the saved map's OctoMap nodes do not fit each other")
        try:
            list_cells(children, 3)
        except ValueError:
            raise MappingError("the saved map's OctoMap nodes are not a tree") from None
        return cls(str(kind), content.dtype == np.bool_, voxel_size_m, children, content, colors)

    def find(self, p_map: ArrayLike) -> NDArray[np.int64]:
        """The leaf (N,) that holds each point (N, 3) [m], −1 where there is none."""
        points = as_points(p_map)
        found = np.full(len(points), -1, np.int64)
        codes, nodes, levels = self._cells
        with np.errstate(invalid="ignore"):
            inside = (np.abs(points) < octrees.ORIGIN * self.voxel_size_m).all(axis=1)
        if not len(codes) or not inside.any():
            return found
        keys = point_to_ijk(points[inside], self.voxel_size_m).astype(np.int64) + octrees.ORIGIN
        wanted = morton_codes(keys)
        row = np.searchsorted(codes, wanted, side="right") - 1
        shift = 3 * levels[row].astype(np.int64)
        within = (row >= 0) & (wanted >> shift == codes[row] >> shift)
        below = np.where(within, row, -1)
        octrees.find_leaves(below, self.children, nodes, levels, keys)
        found[inside] = below
        return found

    @cached_property
    def _cells(self) -> tuple[Array, Array, Array]:
        """Nodes at level 3 and leaves above: their Morton codes in voxels, ascending; node; level."""
        nodes, corners, levels = list_cells(self.children, 3)
        return morton_codes(corners.astype(np.int64) + octrees.ORIGIN), nodes, levels


def list_cells(children: Array, finest: int) -> tuple[Array, Array, Array]:
    """The nodes (m,) at level `finest` and the leaves above, their lowest voxels (m, 3) and levels (m,), as they come.

    Raises `ValueError` where there are not the nodes that `children` names.
    """
    room = len(children) // 16 + 64 if finest else int(np.count_nonzero(children == 0))
    while True:
        nodes, corners, levels = np.empty(room, np.int64), np.empty((room, 3), np.int32), np.empty(room, np.int8)
        count, read = octrees.list_cells(children, finest, nodes, corners, levels) if len(children) else (0, 0)
        if count < 0 or read != len(children):
            raise ValueError("not a tree")
        if count <= room:
            return nodes[:count], corners[:count], levels[:count]
        room = count


def morton_codes(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The bits of keys (n, 3) of up to 16 bits, interleaved: x lowest."""
    codes = np.zeros(len(keys), np.int64)
    for axis in range(3):
        spread = keys[:, axis].copy()
        for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
            spread = (spread | spread << shift) & mask
        codes |= spread << axis
    return codes
