"""What the map says of classes and instances, out of it: at points, of voxels of other layers, and as a cloud.

Three things are never mixed up: what was never observed, what was observed and has no label, and what has one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import as_points, ijk_to_centre
from mapping.instances import InstanceMap
from mapping.kernels import labelled as kernels
from mapping.kernels.evidence import UNIT
from mapping.layer import require
from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.octomap_writing import write_octomap
from mapping.palette import Palette
from mapping.ply import Property, ply_bytes, vectors
from mapping.semantics import SemanticMap

Array: TypeAlias = NDArray[Any]

UNSEEN, EMPTY, UNLABELLED, LABELLED = 0, 1, 2, 3
"""What is known of a place: nothing was ever observed there; it is free; there is a surface without a label; there is a
class."""
REACH = 1.5
"""Surfaces are thicker than what has labels, for depth is noisy: a voxel of the occupancy without a label is taken for
what the nearest label says that is not farther from its centre than so many of its edges."""
_AT_ONCE = 1 << 20  # voxels that are looked at together


@dataclass(frozen=True, eq=False)
class PointLabels:
    """What is known at N points.

    labels      (N,) uint16 class ids, 0 without a label
    confidence  (N,) float32 how sure the class is, NaN without a label
    instances   (N,) uint32 numbers of instances, 0 where there is none
    state       (N,) uint8: UNSEEN 0, EMPTY 1, UNLABELLED 2, LABELLED 3
    """

    labels: NDArray[np.uint16]
    confidence: NDArray[np.float32]
    instances: NDArray[np.uint32]
    state: NDArray[np.uint8]

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(N,) whether anything was ever observed there."""
        return np.asarray(self.state != UNSEEN)


def labels_at(
    p_map: ArrayLike, semantics: SemanticMap, occupancy: OccupancyMap, instances: InstanceMap | None = None
) -> PointLabels:
    """Class and instance at points (N, 3) [m], and what is known there where there is no class.

    A label says by itself that a surface was observed; of all else `occupancy` knows (`tsdf_to_occupancy` makes one of
    a signed distance map). Points that are not finite were never observed.
    """
    points = as_points(p_map)
    labels, confidence = semantics.query(points)
    found = np.zeros(len(points), np.uint32) if instances is None else instances.query(points)
    state = np.full(len(points), UNSEEN, np.uint8)
    there = occupancy.classify(points)
    state[there == FREE], state[there == OCCUPIED] = EMPTY, UNLABELLED
    state[labels != 0] = LABELLED
    return PointLabels(labels, confidence, found, state)


def labels_near(
    p_map: ArrayLike, semantics: SemanticMap, reach_m: float
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Class ids (N,) at points (N, 3) [m] and how sure they are (N,), or, where the voxel of a point has none, of the
    nearest voxel that has one and whose centre is not farther than `reach_m`; 0 and NaN where there is none."""
    cells = _nearest_cells(p_map, semantics, reach_m)
    near = cells >= 0
    labels, confidence = np.zeros(len(near), np.uint16), np.full(len(near), np.nan, np.float32)
    labels[near], confidence[near] = semantics.classes_at(cells[near])
    return labels, confidence


def nearest_labelled(
    p_map: ArrayLike, semantics: SemanticMap, reach_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where the label is that `labels_near` gives to points (N, 3) [m]: the centres (M, 3) [m] of these voxels, and
    which points (N,) bool have one."""
    cells = _nearest_cells(p_map, semantics, reach_m)
    near = cells >= 0
    return ijk_to_centre(semantics.store.ijk(cells[near]), semantics.voxel_size_m), near


def _nearest_cells(p_map: ArrayLike, semantics: SemanticMap, reach_m: float) -> NDArray[np.int64]:
    """The cells (N,) of these voxels, −1 where a point (N, 3) [m] has none."""
    points = as_points(p_map)
    store = semantics.store
    cells = np.empty(len(points), np.int64)
    reach = require("reach_m", reach_m, 0.0, 64.0 * semantics.voxel_size_m, "m")
    kernels.nearest_cells(
        store.table, store.masks, store.first, store.fields["evidence"], semantics.least * UNIT, points,
        semantics.voxel_size_m, reach, cells,
    )  # fmt: skip
    return cells


def labels_of_cubes(
    centres: ArrayLike, edge_m: float, semantics: SemanticMap, *, reach_m: float = 0.0
) -> NDArray[np.uint16]:
    """The class id (N,) of cubes about `centres` (N, 3) [m]: that which most of the labelled voxels in it have, of
    equally many the lowest; where none has a label, that of the nearest one not farther than `reach_m` from the centre,
    else 0.

    For voxels of other layers, which are coarser than those of classes. Cubes should be whole numbers of voxels wide.
    """
    middles = as_points(centres, "centres")
    labels = np.zeros(len(middles), np.uint16)
    for chunk in _chunks(len(middles), _voxels_along(edge_m, semantics) ** 3):
        labels[chunk] = _most(labels_within(middles[chunk], edge_m, semantics))
    bare = np.flatnonzero(labels == 0)
    if reach_m > 0.0 and len(bare):
        labels[bare] = labels_near(middles[bare], semantics, reach_m)[0]
    return labels


def reach_of(reach_m: float | None, edge_m: float) -> float:
    """How far [m] a label may be from a voxel of this edge: what is asked for, by default REACH. Raises
    `InvalidParameter`."""
    return REACH * edge_m if reach_m is None else max(0.0, require("reach_m", reach_m, -1e-9, 64.0 * edge_m, "m"))


def labels_within(centres: Array, edge_m: float, semantics: SemanticMap) -> NDArray[np.uint16]:
    """The class ids (N, n³) of the voxels within cubes about `centres` (N, 3) [m], n along each edge; 0 without a
    label. Of a cube that is no larger than a voxel, that of the voxel at its centre."""
    n = _voxels_along(edge_m, semantics)
    steps = ((np.arange(n) + 0.5) / n - 0.5) * edge_m
    offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    found = np.empty((len(centres), n**3), np.uint16)
    for chunk in _chunks(len(centres), n**3):
        points = (centres[chunk, None] + offsets).reshape(-1, 3)
        found[chunk] = semantics.query(points)[0].reshape(-1, n**3)
    return found


def _voxels_along(edge_m: float, semantics: SemanticMap) -> int:
    n = max(1, round(edge_m / semantics.voxel_size_m))
    if n > 64:
        raise InvalidParameter(f"edge_m: expected at most 64 voxels of {semantics.voxel_size_m:g} m, got {edge_m:g}")
    return n


def _chunks(n: int, size: int) -> Iterator[slice]:
    """Parts of n things, each `size` large, that are looked at together."""
    at_once = max(1, _AT_ONCE // size)
    return (slice(first, first + at_once) for first in range(0, n, at_once))


def _most(labels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The label (N,) that is found most often in each row (N, k), the lowest of several; 0 only where all are 0."""
    ordered = np.sort(labels, axis=1)
    best, most = np.zeros(len(ordered), np.uint16), np.zeros(len(ordered), np.int64)
    run = np.zeros(len(ordered), np.int64)
    for n, label in enumerate(ordered.T):
        run = np.where(label == ordered[:, n - 1], run + 1, 1) if n else np.ones(len(ordered), np.int64)
        better = (run > most) & (label != 0)
        best[better], most[better] = label[better], run[better]
    return best


# -- a cloud -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """One point a labelled voxel.

    points      (N, 3) float32 [m]: the mean of what was measured in it, where that is known, else its centre
    labels      (N,) uint16 class ids;  confidence (N,) float32 how sure they are
    instances   (N,) uint32, 0 where there is none
    colors      (N, 3) uint8 of the classes
    legend      lines that say what the labels mean, see `Palette.legend`
    """

    points: NDArray[np.float32]
    labels: NDArray[np.uint16]
    instances: NDArray[np.uint32]
    confidence: NDArray[np.float32]
    colors: NDArray[np.uint8]
    legend: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    def ply(self) -> bytes:
        """A binary PLY file with x, y, z, label, instance, confidence, red, green, blue; the legend as comments."""
        columns: list[Property] = [
            *vectors("xyz", self.points),
            ("label", self.labels.astype(np.int32)),  # Open3D leaves out properties of unsigned types
            ("instance", self.instances.astype(np.int32)),
            ("confidence", self.confidence),
            *vectors(("red", "green", "blue"), self.colors),
        ]
        return ply_bytes(columns, comments=self.legend)

    def write_ply(self, path: str | Path) -> None:
        """Write `ply()` to a file."""
        Path(path).write_bytes(self.ply())

    def to_open3d(self) -> Any:
        """As `open3d.t.geometry.PointCloud` with positions, colors, label, instance (int32) and confidence."""
        import open3d

        cloud = open3d.t.geometry.PointCloud()
        columns = {
            "positions": self.points,
            "colors": self.colors,
            "label": self.labels[:, None],
            "instance": self.instances[:, None].astype(np.int32),
            "confidence": self.confidence[:, None],
        }
        for name, values in columns.items():
            cloud.point[name] = open3d.core.Tensor.from_numpy(np.array(values, order="C"))
        return cloud


def labelled_cloud(
    semantics: SemanticMap, instances: InstanceMap | None = None, palette: Palette | None = None
) -> LabelledCloud:
    """All labelled voxels as a cloud; `palette`: what colours classes have (default: by their number)."""
    centres, labels, confidence = semantics.voxels()
    points = centres.astype(np.float32)
    found = np.zeros(len(points), np.uint32)
    if instances is not None and len(points):
        found = instances.query(centres)
        _move_to_means(points, centres, found, semantics, instances)
    chosen = palette or Palette()
    sure = confidence.astype(np.float32, copy=False)
    return LabelledCloud(points, labels, found, sure, chosen.of(labels), chosen.legend(labels))


def _move_to_means(points: Array, centres: Array, found: Array, semantics: SemanticMap, instances: InstanceMap) -> None:
    """Put points (N, 3) that stand for voxels of instances where these were measured, in place."""
    store = semantics.store
    measured = [instances.points(instance_id)[0] for instance_id in np.unique(found[found > 0]).tolist()]
    means = np.concatenate([np.empty((0, 3), np.float32), *measured])
    held = store.rows(store.cells_at(means))
    means, held = means[held >= 0], held[held >= 0]
    if not len(held):
        return
    n = int(held.max()) + 1
    counts = np.bincount(held, minlength=n)
    rows = store.rows(store.cells_at(centres))
    at = np.flatnonzero((found > 0) & (rows < n))
    at = at[counts[rows[at]] > 0]
    for axis in range(3):
        sums = np.bincount(held, means[:, axis].astype(np.float64), minlength=n)
        points[at, axis] = sums[rows[at]] / counts[rows[at]]


# -- an octree -----------------------------------------------------------------------------------------------------


def class_colors(
    semantics: SemanticMap, edge_m: float, palette: Palette | None = None, *, reach_m: float | None = None
) -> Callable[[NDArray[np.float64]], NDArray[np.uint8]]:
    """What gives the colour (N, 3) uint8 of cubes of edge `edge_m` about points (N, 3) [m]: that of their class, see
    `labels_of_cubes`, grey where they have none. reach_m: by default REACH edges."""
    chosen, reach = palette or Palette(), reach_of(reach_m, edge_m)
    return lambda centres: chosen.of(labels_of_cubes(centres, edge_m, semantics, reach_m=reach))


def write_class_octree(
    occupancy: OccupancyMap,
    semantics: SemanticMap,
    path: str | Path,
    palette: Palette | None = None,
    *,
    reach_m: float | None = None,
) -> None:
    """Write an OctoMap file `.ot` with colours (`ColorOcTree`): free space, and each occupied voxel in the colour that
    `class_colors` gives it, grey without a label."""
    colors = class_colors(semantics, occupancy.voxel_size_m, palette, reach_m=reach_m)
    write_octomap(occupancy, path, colors=colors, split=True)
