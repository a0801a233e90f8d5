"""The nodes of an OctoMap file as they stand in it: exact log-odds and colours, which a byte a voxel cannot hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True, eq=False)
class OctoMapTree:
    """The nodes of an OctoMap file, depth first; children in the order of their index (bit 0: x, 1: y, 2: z)."""

    children: Array
    """(n,) uint8: bit c is set where child c exists; 0 for leaves."""
