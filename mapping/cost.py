"""What it costs to be somewhere, given what is there: a user's table of classes becomes a cost in space and on a grid.

The idea is ViPlanner's (Roth et al. 2024): each class has a cost of driving over or into it, and a planner weighs it
with the geometry. Unknown is NaN, or has a cost of its own; it is never free.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import BLOCK_EDGE, BlockStore, as_points
from mapping.labelled import labels_near, labels_within, reach_of
from mapping.layer import Changed, require
from mapping.observations import LabelSpace
from mapping.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from mapping.semantics import SemanticMap
from mapping.tiles import as_columns

__all__ = ["CostGrid", "CostMap", "CostTable", "cost_cloud", "semantic_cost"]

Array: TypeAlias = NDArray[Any]
Rule: TypeAlias = Literal["max", "mean"]

CHUNK = 256
"""Tiles that are looked at together."""
_DARKEST = 252
"""So much darker than white is the dearest finite cost: map_server makes 99 of it, and 100 of black."""


class CostTable:
    """The cost of each class.

    costs         class id 1 … 65535, or name in `classes` → cost ≥ 0; ∞: never go there
    default       the cost of classes that are not in the table and of surfaces without a label
    free          the cost of free space
    unknown       the cost of what was never observed; NaN: not told
    classes       what the names mean; a name that several classes have counts for all of them
    allow_absent  whether names may be in the table that `classes` does not know; they are told in `absent`

    Raises `InvalidParameter`.
    """

    def __init__(
        self,
        costs: Mapping[int | str, float],
        *,
        default: float,
        free: float = 0.0,
        unknown: float = np.nan,
        classes: LabelSpace | None = None,
        allow_absent: bool = False,
    ) -> None:
        self.default, self.free = _cost("default", default), _cost("free", free)
        not_told = isinstance(unknown, float) and np.isnan(unknown)
        self.unknown = float("nan") if not_told else _cost("unknown", unknown)
        self._of = np.full(1 << 16, self.default)
        self.costs: dict[int, float] = {}
        self.absent: tuple[str, ...] = ()
        for key, value in costs.items():
            cost, ids = _cost(f"costs[{key!r}]", value), _ids(key, classes, allow_absent)
            if isinstance(key, str) and not ids:
                self.absent += (key,)
            for label in ids:
                if label in self.costs:
                    raise InvalidParameter(f"costs: expected each class once, got {key!r} again (class {label})")
                self.costs[label] = self._of[label] = cost

    @classmethod
    def from_document(cls, document: Any, classes: LabelSpace, *, allow_absent: bool = False) -> Self:
        """The table that JSON values tell of.

        `{"costs": {"floor": 0, "grass": 0.5, "person": "never"}, "default": 0.8, "free": 0, "unknown": 2}`: class
        names and costs ≥ 0 or "never" (∞); `free` and `unknown` may be left out. Raises `InvalidParameter` that names
        the field.
        """
        if not isinstance(document, Mapping):
            raise InvalidParameter(f"cost table: expected an object with costs and default, got {document!r:.80}")
        for name in document:
            if name not in _FIELDS:
                raise InvalidParameter(f"cost table: expected the fields {', '.join(_FIELDS)}, got {name!r}")
        for name in ("costs", "default"):
            if name not in document:
                raise InvalidParameter(f"cost table: the field {name!r} is missing")
        costs = document["costs"]
        if not isinstance(costs, Mapping):
            raise InvalidParameter(f"costs: expected an object of class names and costs, got {costs!r:.80}")
        others = {name: _told(document[name]) for name in ("default", "free", "unknown") if name in document}
        return cls(
            {name: _told(cost) for name, cost in costs.items()}, classes=classes, allow_absent=allow_absent, **others
        )

    @classmethod
    def read(cls, path: str | Path, classes: LabelSpace, *, allow_absent: bool = False) -> Self:
        """The table in a JSON file, see `from_document`. Raises `InvalidParameter`."""
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"), object_pairs_hook=_each_once)
        except OSError as error:
            raise InvalidParameter(f"{path}: cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise InvalidParameter(f"{path}: not a JSON file: {error}") from None
        try:
            return cls.from_document(document, classes, allow_absent=allow_absent)
        except InvalidParameter as error:
            raise InvalidParameter(f"{path}: {error}") from None

    def of(self, labels: ArrayLike) -> NDArray[np.float64]:
        """The cost (N,) of class ids (N,); 0 is no label."""
        return np.asarray(self._of[np.asarray(labels)])


_FIELDS = ("costs", "default", "free", "unknown")


def _told(cost: Any) -> Any:
    return np.inf if cost == "never" else cost


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of a JSON file in which no name stands twice."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InvalidParameter(f"expected each name once, got {name!r} again")
        found[name] = value
    return found


def semantic_cost(
    p_map: ArrayLike,
    labels: SemanticMap,
    table: CostTable,
    occupancy: OccupancyMap | None = None,
    *,
    reach_m: float | None = None,
) -> NDArray[np.float64]:
    """The cost (N,) of the voxel at each point (N, 3) [m]; `table.unknown`, by default NaN, where unknown.

    Voxels are those of `occupancy`, without it those of `labels`. Free space, of which only `occupancy` knows, costs
    `table.free`, whatever was once seen there. What is occupied or has a label costs what its class does, what has
    several, of finer voxels, as the dearest of them. An occupied voxel without a label costs what the nearest label
    does that is not farther from its centre than `reach_m` (default `mapping.labelled.REACH` voxels; 0: none), else
    `table.default`.
    """
    reach = 0.0 if occupancy is None else reach_of(reach_m, occupancy.voxel_size_m)
    cost = _look(p_map, labels, table, occupancy, reach)[0]
    return np.where(np.isnan(cost), table.unknown, cost)


def _look(
    p_map: ArrayLike, labels: SemanticMap, table: CostTable, occupancy: OccupancyMap | None, reach_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The cost (N,) at points, NaN where unknown, and whether there is a surface (N,)."""
    points = as_points(p_map)
    classes = np.full(len(points), UNKNOWN, np.int8) if occupancy is None else occupancy.classify(points)
    cost = np.where(classes == FREE, table.free, np.nan)
    solid = classes == OCCUPIED
    size = labels.voxel_size_m if occupancy is None else occupancy.voxel_size_m
    not_free = np.flatnonzero(classes != FREE)
    centres = (np.floor(points[not_free] / size) + 0.5) * size
    per_block = labels.block_size_m / size
    if per_block >= 1.0 and abs(per_block - round(per_block)) < 1e-6:  # no voxel reaches over the border of a block
        something = solid[not_free] | (labels.store.cells_at(centres) >= 0)
        not_free, centres = not_free[something], centres[something]
    names = labels_within(centres, size, labels)
    labelled = (names != 0).any(axis=1)
    names, at = names[labelled], not_free[labelled]
    cost[at] = np.where(names != 0, table.of(names), 0.0).max(axis=1, initial=0.0)
    bare = solid[not_free] & ~labelled
    nearest = labels_near(centres[bare], labels, reach_m)[0] if reach_m > 0.0 else 0
    cost[not_free[bare]] = table.of(nearest)
    solid[at] = True
    return cost, solid


def cost_cloud(
    labels: SemanticMap, table: CostTable, occupancy: OccupancyMap, *, reach_m: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All surfaces with what they cost: centres (N, 3) [m] of the occupied voxels and their costs (N,), as
    `semantic_cost` gives them."""
    centres = occupancy.occupied_centres()
    return centres, semantic_cost(centres, labels, table, occupancy, reach_m=reach_m)


@dataclass(frozen=True, eq=False)
class CostGrid:
    """Costs (nx, ny) of square cells; NaN where unknown. corner_m (2,): where the first cell begins [m]."""

    corner_m: NDArray[np.float64]
    cell_size_m: float
    cost: NDArray[np.float64]

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The cost (N,) at each point (N, 2) or (N, 3) [m]; NaN outside."""
        cells = np.floor((as_columns(p_map) - self.corner_m) / self.cell_size_m)
        inside = ((cells >= 0) & (cells < self.cost.shape)).all(axis=1)
        found = np.full(len(cells), np.nan)
        i, j = cells[inside].astype(np.int64).T
        found[inside] = self.cost[i, j]
        return found

    def write(self, path: str | Path) -> Path:
        """Write the grid and return the path of the file to open.

        `.npz`: the arrays `cost`, `corner_m` and `cell_size_m`. Else two files of this name, a `.png` and a `.yaml`, as
        `map_server` of ROS 1 and 2 reads them in its mode *scale*: white costs nothing, the darker the dearer, up to 99
        of 100; black is ∞, 100; transparent is unknown. The dearest finite cost stands in the YAML file.
        """
        path = Path(path)
        if path.suffix == ".npz":
            np.savez_compressed(path, cost=self.cost, corner_m=self.corner_m, cell_size_m=self.cell_size_m)
            return path
        from PIL import Image

        finite = np.isfinite(self.cost)
        dearest = float(self.cost[finite].max(initial=0.0)) or 1.0
        grey = np.zeros(self.cost.shape, np.uint8)
        grey[finite] = 255 - np.rint(self.cost[finite] / dearest * _DARKEST).astype(np.uint8)
        alpha = np.where(np.isnan(self.cost), 0, 255).astype(np.uint8)
        pixels = np.ascontiguousarray(np.stack([grey, alpha], axis=-1).transpose(1, 0, 2)[::-1])
        x, y = self.corner_m.tolist()
        Image.fromarray(pixels if pixels.size else np.zeros((1, 1, 2), np.uint8), "LA").save(path.with_suffix(".png"))
        lines = (
            f"# a pixel v costs (255 - v) / {_DARKEST} * {dearest:g}; 0 is never to be entered, transparent unknown",
            f"image: {path.with_suffix('.png').name}",
            "mode: scale",
            f"resolution: {self.cell_size_m:g}",
            f"origin: [{x:.6g}, {y:.6g}, 0.0]",
            "negate: 0",
            "occupied_thresh: 0.995",
            "free_thresh: 0.0",
            f"dearest_cost: {dearest:g}",
        )
        path = path.with_suffix(".yaml")
        path.write_text("\n".join((*lines, "")), encoding="utf-8")
        return path

    def inflated(self, radius_m: float) -> CostGrid:
        """The same with costs that reach out: each cell costs the most that any cell at a distance d ≤ radius costs,
        times 1 − d/radius. An infinite cost is infinite all the way; unknown cells stay unknown and add nothing."""
        reach = require("radius_m", radius_m, 0.0, 100.0, "m") / self.cell_size_m
        nx, ny = self.cost.shape
        sources = np.where(np.isnan(self.cost), 0.0, self.cost)
        grown = sources.copy()
        steps = int(reach)
        for di in range(-min(steps, nx - 1), min(steps, nx - 1) + 1):
            for dj in range(-min(steps, ny - 1), min(steps, ny - 1) + 1):
                share = 1.0 - np.hypot(di, dj) / reach
                if share <= 1e-9 or di == dj == 0:
                    continue
                to = np.s_[max(di, 0) : nx + min(di, 0), max(dj, 0) : ny + min(dj, 0)]
                at = np.s_[max(-di, 0) : nx + min(-di, 0), max(-dj, 0) : ny + min(-dj, 0)]
                np.maximum(grown[to], share * sources[at], out=grown[to])
        return CostGrid(self.corner_m, self.cell_size_m, np.where(np.isnan(self.cost), np.nan, grown))


class CostMap:
    """Costs on a grid of columns, kept up to date with the layers that they come from.

    labels       what knows classes
    table        what they cost
    band_m       heights (low, high) [m] that matter: voxels whose centres lie between count
    rule         what surfaces of one column cost together: the most, or the mean
    occupancy    what knows free space; without it only labelled columns are known
    known_share  share of a column's voxels that must be known for it to be free when no surface is in it
    reach_m      occupied voxels without a label are taken for what a label so near says, see `semantic_cost`

    Columns are as wide as the voxels of `occupancy`, without it as those of `labels`. `update` computes anew what has
    changed since it was last called; where a thing gets another class, this is where it was looked at again. Raises
    `InvalidParameter`.
    """

    def __init__(
        self,
        labels: SemanticMap,
        table: CostTable,
        *,
        band_m: tuple[float, float],
        rule: Rule = "max",
        occupancy: OccupancyMap | None = None,
        known_share: float = 0.5,
        reach_m: float | None = None,
    ) -> None:
        if rule not in get_args(Rule):
            raise InvalidParameter(f'rule: expected "max" or "mean", got {rule!r}')
        self.known_share = require("known_share", known_share, 0.0, 1.0)
        self.labels, self.table, self.occupancy, self.rule = labels, table, occupancy, rule
        self.cell_size_m = labels.voxel_size_m if occupancy is None else occupancy.voxel_size_m
        self._reach_m = 0.0 if occupancy is None else reach_of(reach_m, self.cell_size_m)
        low, high = (float(z) for z in band_m)
        first, last = np.ceil(low / self.cell_size_m - 0.5), np.floor(high / self.cell_size_m - 0.5)
        if not (np.isfinite(low) and np.isfinite(high) and first <= last):
            raise InvalidParameter(f"band_m: expected two heights with a voxel between them, got {band_m}")
        self._band = low, high
        self._heights: Array = (np.arange(first, last + 1) + 0.5) * self.cell_size_m
        self._store = BlockStore({"cost": "f8"}, self.cell_size_m, fill={"cost": np.nan}, axes=2)
        self._seen: dict[str, int] = {}

    def update(self) -> Changed:
        """Look again at what changed; the tiles (K, 3) of 8² columns that were computed anew, with index (i, j, 0)."""
        layers = [layer for layer in (self.occupancy, self.labels, self.labels.things) if layer is not None]
        tiles = [self._tiles(layer.changed_since(self._seen.get(layer.kind, 0))) for layer in layers]
        self._seen = {layer.kind: layer.revision for layer in layers}
        changed = np.unique(np.concatenate(tiles), axis=0).astype(np.int32)
        for chunk in np.array_split(changed, max(1, len(changed) // CHUNK)):
            slots = self._store.allocate(chunk)
            self._store.fields["cost"][slots] = self._columns(chunk)
        return Changed(changed, self._store.block_size_m)

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The cost (N,) of the column at each point (N, 2) or (N, 3) [m], as of the last update; `table.unknown` where
        unknown."""
        cells = np.floor(as_columns(p_map) / self.cell_size_m).astype(np.int64)
        slots = self._store.find(np.c_[cells >> 3, np.zeros(len(cells), np.int64)])
        found = np.full(len(cells), np.nan)
        known = slots >= 0
        found[known] = self._store.fields["cost"][slots[known], (cells[known] & 7) @ (BLOCK_EDGE, 1)]
        return np.where(np.isnan(found), self.table.unknown, found)

    def grid(self) -> CostGrid:
        """All columns as of the last update, dense; what was never observed costs `table.unknown`."""
        tiles = self._store.block_ijk[:, :2]
        if not len(tiles):
            return CostGrid(np.zeros(2), self.cell_size_m, np.empty((0, 0)))
        first = tiles.min(axis=0)
        across, along = tiles.max(axis=0) - first + 1
        dense = np.full((across, along, BLOCK_EDGE, BLOCK_EDGE), np.nan)
        i, j = (tiles - first).T
        dense[i, j] = self._store.used("cost").reshape(-1, BLOCK_EDGE, BLOCK_EDGE)
        cost = dense.transpose(0, 2, 1, 3).reshape(across * BLOCK_EDGE, along * BLOCK_EDGE)
        cost = np.where(np.isnan(cost), self.table.unknown, cost)
        return CostGrid(first * self._store.block_size_m, self.cell_size_m, cost)

    def _tiles(self, changed: Changed) -> NDArray[np.int64]:
        """The tiles (K, 3) above and below which blocks within the band changed, or within reach of it."""
        edge, tile, reach = changed.block_size_m, self._store.block_size_m, self._reach_m
        bottom = changed.blocks[:, 2] * edge
        blocks = changed.blocks[(bottom - reach <= self._band[1]) & (bottom + edge + reach >= self._band[0]), :2]
        low = np.floor((blocks * edge - reach) / tile + 1e-6).astype(np.int64)
        high = np.ceil(((blocks + 1) * edge + reach) / tile - 1e-6).astype(np.int64)
        most = int((high - low).max(initial=1))
        tiles = (low[:, None] + np.indices((most, most)).reshape(2, -1).T).reshape(-1, 2)
        tiles = tiles[(tiles < np.repeat(high, most**2, axis=0)).all(axis=1)]
        return np.unique(np.c_[tiles, np.zeros(len(tiles), np.int64)], axis=0)

    def _columns(self, tiles: Array) -> NDArray[np.float64]:
        """The cost (K, 64) of the columns of tiles (K, 3)."""
        i, j = np.indices((BLOCK_EDGE, BLOCK_EDGE)).reshape(2, -1)
        centres = (tiles[:, None, :2] * BLOCK_EDGE + np.stack([i, j], axis=1) + 0.5) * self.cell_size_m
        shape = (*centres.shape[:2], len(self._heights))
        points = np.empty((*shape, 3))
        points[..., :2], points[..., 2] = centres[:, :, None], self._heights
        points = points.reshape(-1, 3)
        cost, solid = (a.reshape(shape) for a in _look(points, self.labels, self.table, self.occupancy, self._reach_m))
        n = solid.sum(axis=2)
        if self.rule == "max":
            together = np.where(solid, cost, 0.0).max(axis=2)
        else:
            together = np.where(solid, cost, 0.0).sum(axis=2) / np.maximum(n, 1)
        empty = np.where((~np.isnan(cost)).mean(axis=2) >= self.known_share, self.table.free, np.nan)
        return np.where(n > 0, together, empty)


def _cost(name: str, value: Any) -> float:
    number = float(value) if isinstance(value, int | float | np.number) and not isinstance(value, bool) else np.nan
    if not number >= 0.0:
        raise InvalidParameter(f"{name}: expected a cost ≥ 0, got {value!r}")
    return number


def _ids(key: int | str, classes: LabelSpace | None, allow_absent: bool) -> list[int]:
    """The classes that a key of the table names."""
    if isinstance(key, str):
        if classes is None:
            raise InvalidParameter(f"costs: expected class ids where no classes are given, got the name {key!r}")
        ids = [label for label, info in classes.classes.items() if info.name == key]
        if not (ids or allow_absent):
            near = get_close_matches(key, [info.name for info in classes.classes.values()], n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InvalidParameter(f"costs: expected the name of a class, got {key!r}{hint}")
        return ids
    if isinstance(key, bool) or not isinstance(key, int | np.integer) or not 1 <= key < 1 << 16:
        raise InvalidParameter(f"costs: expected class ids 1 … 65535 or names, got {key!r}")
    return [int(key)]
