"""The one contract of all map layers: integrate, query, changed blocks, save, load."""

from __future__ import annotations

import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter, MappingError
from mapping.grid import BlockStore

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Changed:
    """The blocks of one layer that an update changed: `blocks` (K, 3) int32, each once, and their edge [m]."""

    blocks: NDArray[np.int32]
    block_size_m: float

    def __len__(self) -> int:
        return len(self.blocks)

    @property
    def box_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner (3,) [m] of the box about the changed blocks; NaN when there are none."""
        if not len(self.blocks):
            return np.full(3, np.nan), np.full(3, np.nan)
        return self.blocks.min(axis=0) * self.block_size_m, (self.blocks.max(axis=0) + 1.0) * self.block_size_m

    def union(self, other: Changed) -> Changed:
        """The blocks of both; they must be of layers with the same block size."""
        if other.block_size_m != self.block_size_m:
            raise InvalidParameter(f"block_size_m: expected {self.block_size_m}, got {other.block_size_m}")
        return Changed(np.unique(np.concatenate([self.blocks, other.blocks]), axis=0), self.block_size_m)


class Store(Protocol):
    """What keeps a layer's voxels, in blocks."""

    voxel_size_m: float

    @property
    def block_size_m(self) -> float: ...
    @property
    def block_ijk(self) -> NDArray[np.int32]: ...
    @property
    def memory_bytes(self) -> int: ...
    def changed_since(self, revision: int) -> NDArray[np.int32]: ...
    def state(self) -> dict[str, Array]: ...
    def restore(self, state: Mapping[str, Array], revision: int) -> None: ...


class MapLayer(ABC):
    """A map layer on hashed blocks.

    A layer keeps its voxels in `store`; `revision` counts its updates, and `changed_since` names the blocks that
    changed after one, so that whoever builds on a layer needs to look only at those. Unknown is NaN (or a code of its
    own).
    """

    kind: ClassVar[str]
    """Name of the layer in files."""

    store: Store
    revision: int = 0

    @property
    def voxel_size_m(self) -> float:
        return self.store.voxel_size_m

    @property
    def block_size_m(self) -> float:
        return self.store.block_size_m

    @property
    def block_ijk(self) -> NDArray[np.int32]:
        """(n, 3) the blocks that exist."""
        return self.store.block_ijk

    @property
    def memory_bytes(self) -> int:
        return self.store.memory_bytes

    @abstractmethod
    def query(self, p_map: ArrayLike) -> Any:
        """The layer's value at each point (N, 3) [m] in map; NaN where unknown."""

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """What the constructor was called with, by keyword: numbers, strings and booleans."""

    # -- change -------------------------------------------------------------------------------------------
    def changed_since(self, revision: int) -> Changed:
        """The blocks that changed after `revision` (0: all that ever changed)."""
        return Changed(self.store.changed_since(revision), self.block_size_m)

    # -- files --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything that makes this map, as named arrays: parameters and the store's fields."""
        header = {"kind": np.array(self.kind), **{f"parameter.{k}": np.array(v) for k, v in self.parameters().items()}}
        return {**header, **self.store.state()}

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> Self:
        """The map that `state()` described; raises `MappingError` where it is of another kind or incomplete."""
        kind = str(state.get("kind", ""))
        if kind != cls.kind:
            raise MappingError(f"expected a saved {cls.kind} map, got {kind or 'something else'!r}")
        prefix = "parameter."
        parameters = {key.removeprefix(prefix): value.item() for key, value in state.items() if key.startswith(prefix)}
        try:
            layer = cls(**parameters)
        except TypeError as error:
            raise MappingError(
                f"the saved {cls.kind} map has parameters that this version does not know: {error}"
            ) from None
        layer.revision = 1
        layer.store.restore(state, layer.revision)
        return layer

    def save(self, path: str | Path) -> None:
        """Write the map as a compressed .npz file."""
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **self.state())  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a map that `save` wrote; raises `MappingError` on a damaged or foreign file."""
        try:
            with Path(path).open("rb") as file:
                if not zipfile.is_zipfile(file):
                    raise ValueError("expected a .npz archive")
                file.seek(0)
                with np.load(file, allow_pickle=False) as archive:
                    state = {name: archive[name] for name in archive.files}
        except (ValueError, EOFError, zlib.error, zipfile.BadZipFile) as error:
            raise MappingError(f"{path}: not a saved map: {error}") from None
        return cls.from_state(state)


class SlotStore(Store, Protocol):
    """A store that gives its blocks slots, and keeps when each changed."""

    @property
    def changed_at(self) -> NDArray[np.int64]: ...


class SlotLayer(MapLayer):
    """A layer whose store has slots."""

    store: SlotStore

    def _note(self, slots: Array) -> Changed:
        """Count one update that changed the blocks in `slots` (K,), each named once."""
        self.revision += 1
        self.store.changed_at[slots] = self.revision
        return Changed(self.block_ijk[slots], self.block_size_m)


class BlockLayer(SlotLayer):
    """A layer whose voxels lie in a `BlockStore`."""

    store: BlockStore


def require(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """`value` as float when low < value ≤ high, else `InvalidParameter` that says so."""
    number = (
        float(value) if isinstance(value, int | float | np.number) and not isinstance(value, bool) else float("nan")
    )
    if not (low < number <= high):
        raise InvalidParameter(
            f"{name}: expected a number in ({low:g}, {high:g}]{' ' * bool(unit)}{unit}, got {value!r}"
        )
    return number


def require_whole(name: str, value: float, least: int, most: int) -> int:
    """`value` as int when it is a whole number of least … most, else `InvalidParameter` that says so."""
    number = require(name, value, least - 0.5, most)
    if not number.is_integer():
        raise InvalidParameter(f"{name}: expected a whole number, got {value!r}")
    return int(number)
