"""What a box holds: how much of each class, how much surface without a label, and how much was never looked at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.grid import ijk_to_centre
from mapping.kernels import labelled as kernels
from mapping.labelled import labels_of_cubes, reach_of
from mapping.mesh import Mesh
from mapping.observations import Box3d
from mapping.occupancy import OccupancyMap
from mapping.semantics import SemanticMap

Array: TypeAlias = NDArray[Any]

MOST_VOXELS = 1 << 30
"""A box may hold so many voxels of the occupancy."""
_AT_ONCE = 1 << 20  # voxels that are looked at together


class OrientedBox(Protocol):
    """Such as `Box3d`: centre (3,) [m], edge lengths (3,) [m], rotation w x y z."""

    @property
    def center(self) -> Array: ...
    @property
    def size(self) -> Array: ...
    @property
    def rotation_wxyz(self) -> Any: ...


@dataclass(frozen=True, eq=False)
class ClassHistogram:
    """What a box holds. A voxel is in it if its centre is.

    labels       (C,) uint16 the classes in it, ascending
    voxels       (C,) int64 labelled voxels of each;  volume_m3 (C,) their volume
    area_m2      (C,) surface of each, of the mesh that was given; None without one
    bare_m2      surface without a label
    occupied, free, unseen  voxels of the occupancy; unseen: never observed
    unlabelled   occupied voxels without a label in or next to them
    """

    labels: NDArray[np.uint16]
    voxels: NDArray[np.int64]
    volume_m3: NDArray[np.float64]
    area_m2: NDArray[np.float64] | None
    bare_m2: float | None
    occupied: int
    free: int
    unseen: int
    unlabelled: int

    @property
    def unseen_share(self) -> float:
        """How much of the box was never observed, 0 … 1; NaN of a box without voxels."""
        n = self.occupied + self.free + self.unseen
        return self.unseen / n if n else float("nan")

    @property
    def counts(self) -> dict[int, int]:
        """Class id → labelled voxels."""
        return dict(zip(self.labels.tolist(), self.voxels.tolist(), strict=True))


def aligned_box(low: ArrayLike, high: ArrayLike) -> Box3d:
    """The box from corner `low` to corner `high` (3,) [m], along the axes of map."""
    corners = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return Box3d(center=(corners[0] + corners[1]) / 2, size=corners[1] - corners[0])


def class_histogram(
    box: OrientedBox,
    semantics: SemanticMap,
    occupancy: OccupancyMap,
    mesh: Mesh | None = None,
    *,
    reach_m: float | None = None,
) -> ClassHistogram:
    """What a box in map holds, along the axes or turned.

    mesh    : with labels; then areas are told, too: a third of each triangle whose centre is in the box counts for the
              class of each of its corners. Volumes of voxels tell less of surfaces, which pass one voxel or several.
    reach_m : an occupied voxel is unlabelled where no label is in it nor so near to its centre, see
              `labels_of_cubes`; by default `mapping.labelled.REACH` voxels

    Raises `InvalidParameter` where the box holds more than MOST_VOXELS voxels or the mesh has no labels.
    """
    inside = _Inside(box)
    labels = _labels_in(inside, semantics)
    classes, voxels = np.unique(labels, return_counts=True)
    areas, bare = (None, None) if mesh is None else _areas(inside, mesh)
    if areas is not None:
        classes, voxels = _joined(classes, voxels, np.flatnonzero(areas[1:] > 0.0) + 1)
    counts, unlabelled = np.zeros(3, np.int64), 0
    size = occupancy.voxel_size_m
    reach = reach_of(reach_m, size)
    for centres in _occupied(inside, occupancy, counts):
        unlabelled += int((labels_of_cubes(centres, size, semantics, reach_m=reach) == 0).sum())
    occupied, free, unseen = counts.tolist()
    return ClassHistogram(
        classes.astype(np.uint16),
        voxels.astype(np.int64),
        voxels.astype(np.float64) * semantics.voxel_size_m**3,
        None if areas is None else areas[classes],
        bare,
        occupied,
        free,
        unseen,
        unlabelled,
    )


class _Inside:
    """Which points are in a box: its lower faces belong to it, its upper ones do not."""

    def __init__(self, box: OrientedBox) -> None:
        w, x, y, z = (float(v) for v in box.rotation_wxyz)
        pose = SE3.from_quaternion(np.array([w, x, y, z]), np.asarray(box.center, np.float64))
        self.centre, self.axes = np.array(pose.translation), np.array(pose.rotation)
        self.half = np.asarray(box.size, np.float64) / 2
        reach = np.abs(self.axes) @ self.half
        self.low, self.high = self.centre - reach, self.centre + reach

    def __call__(self, points: Array) -> NDArray[np.bool_]:
        x, y, z = (points - self.centre).T
        away = np.stack([x * a + y * b + z * c for a, b, c in self.axes.T], axis=1)
        return np.asarray(((away >= -self.half) & (away < self.half)).all(axis=1))


def _labels_in(inside: _Inside, semantics: SemanticMap) -> NDArray[np.uint16]:
    """The class (n,) of each labelled voxel in the box."""
    store = semantics.store
    low = store.block_ijk * store.block_size_m
    slots = np.flatnonzero(((low <= inside.high) & (low + store.block_size_m >= inside.low)).all(axis=1))
    centres = ijk_to_centre(store.ijk(store.cells(slots)), semantics.voxel_size_m)
    labels = semantics.query(centres[inside(centres)])[0]
    return labels[labels > 0]


def _occupied(inside: _Inside, occupancy: OccupancyMap, counts: Array) -> Iterator[Array]:
    """The centres (n, 3) of the occupied voxels in the box, a slab at a time; counts (3,) voxels that are occupied,
    free and unknown, in place."""
    size = occupancy.voxel_size_m
    first = np.floor(inside.low / size).astype(np.int64)
    shape = np.floor(inside.high / size).astype(np.int64) + 1 - first
    if float(np.prod(shape.astype(np.float64))) > MOST_VOXELS:
        raise InvalidParameter(f"box: expected at most {MOST_VOXELS} voxels, got about {np.prod(shape / 1.0):.2g}")
    nx, ny, nz = (int(n) for n in shape)
    thick = max(1, _AT_ONCE // (ny * nz))
    for start in range(0, nx, thick):
        corner = first + np.array([start, 0, 0])
        evidence = occupancy.evidence_in(corner, (min(thick, nx - start), ny, nz))
        solid = np.empty((int(np.count_nonzero(evidence >= 0)), 3), np.int64)
        n = kernels.count_box(evidence, corner, size, inside.centre, inside.axes, inside.half, counts, solid)
        yield ijk_to_centre(solid[:n], size)


def _areas(inside: _Inside, mesh: Mesh) -> tuple[NDArray[np.float64], float]:
    """The area (65536,) [m²] of each class, and that without one."""
    if mesh.labels is None:
        raise InvalidParameter("mesh: expected one with labels, as mesh(labels_from=…) gives")
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    within = inside(corners.mean(axis=1))
    a, b, c = corners[within].transpose(1, 0, 2)
    thirds = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    areas = np.zeros(1 << 16)
    for corner in mesh.triangles[within].T:
        areas += np.bincount(mesh.labels[corner], weights=thirds, minlength=1 << 16)
    return areas, float(areas[0])


def _joined(classes: Array, voxels: Array, more: Array) -> tuple[Array, Array]:
    """Classes and their voxels, with those of `more` that have none."""
    every = np.union1d(classes, more)
    counts = np.zeros(len(every), np.int64)
    counts[np.searchsorted(every, classes)] = voxels
    return every, counts
