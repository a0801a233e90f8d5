"""Points as they were measured, a bounded number a voxel, found by place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mapping.conversions import depth_to_points, measured_pixels
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore, as_points, read_only
from mapping.kernels import points as kernels
from mapping.layer import BlockLayer, Changed, require, require_whole
from mapping.view import as_pose

Array: TypeAlias = NDArray[Any]

_NO_INTENSITY = read_only(np.empty(0, np.float32))
_NO_COLOR = read_only(np.empty(0, np.uint32))


class SortedPoints:
    """The points of one scan by the voxels in which they lie.

    p_sensor     (N, 3) [m] in the sensor frame
    max_range_m  points farther from the sensor are left out

    Raises `InvalidObservation` where a point is not finite, or so far away that no voxel has an index for it.
    """

    def __init__(
        self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike, max_range_m: float, voxel_size_m: float
    ) -> None:
        pose = as_pose(T_map_sensor, "T_map_sensor")
        points = as_points(p_sensor, "p_sensor")
        if not np.isfinite(points).all():
            raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
        row = np.concatenate([pose.rotation.ravel(), pose.translation])
        self.rows: NDArray[np.int32] = np.empty(len(points), np.int32)
        """(N,) the row of each point's voxel in `voxel_ijk`, −1 where it was left out."""
        self.offsets: NDArray[np.float32] = np.empty((len(points), 3), np.float32)
        """(N, 3) each point within its voxel, 0 … 1 of the edge."""
        self.voxel_ijk: NDArray[np.int32]
        """(K, 3) the voxels, each once."""
        self.voxel_ijk, lost = kernels.sort_into_voxels(
            points, row, max_range_m, 1.0 / voxel_size_m, self.rows, self.offsets
        )
        if lost:
            raise InvalidObservation(f"p_sensor, T_map_sensor: {lost} points lie too far from the origin for a voxel")


def as_colors(color: ArrayLike, n: int) -> NDArray[np.uint8]:
    """`color` as contiguous read-only (n, 3) uint8; raises `InvalidObservation` on another shape or type."""
    rgb = np.asarray(color)
    if rgb.dtype != np.uint8 or rgb.shape != (n, 3):
        raise InvalidObservation(f"color: expected uint8 ({n}, 3), got {rgb.dtype} {rgb.shape}")
    return read_only(np.ascontiguousarray(rgb))


def color_of_points(depth: Array, color: Array) -> Array:
    """The colours (N, 3) of the points that `depth_to_points` gives, from an image (H, W, 3) like depth."""
    image, measured = np.asarray(color), measured_pixels(depth)
    if image.shape != (*measured.shape, 3):
        raise InvalidObservation(f"color: expected {(*measured.shape, 3)} like depth, got {image.shape}")
    return np.take(image.reshape(-1, 3), np.flatnonzero(measured), axis=0)  # eight times as fast as image[measured]


class PointMap(BlockLayer):
    """A point cloud of bounded density: measured points, not their means, at most `max_points` a voxel (after the voxel
    maps of Dellenbach et al., CT-ICP, ICRA 2022, and Vizzo et al., KISS-ICP, RA-L 2023).

    voxel_size_m  edge of a voxel [m]
    max_points    points that a voxel keeps at most, 1 … 256
    max_range_m   points farther from the sensor [m] are left out
    with_intensity, with_color   keep these from the beginning; otherwise from the first scan that has them

    A voxel is divided into cells, `cell_size_m` wide, and keeps at most one point of each, so that what it keeps is
    spread over the surface. Which ones does not depend on the order in which they come: each point has a rank, a hash
    of its place, and those of the lowest ranks stay. What stays is a fair sample, neither the oldest nor the newest;
    the same scan again changes nothing; and two maps merge to the map of all their points. Places are kept to
    1/65 536 of a voxel. Blocks of this layer are single voxels.

    Raises `InvalidParameter` on bad values.
    """

    kind: ClassVar[str] = "points"

    def __init__(
        self,
        voxel_size_m: float = 0.1,
        max_points: int = 16,
        max_range_m: float = 100.0,
        *,
        with_intensity: bool = False,
        with_color: bool = False,
    ) -> None:
        size = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.max_points = require_whole("max_points", max_points, 1, 256)
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        bits = next(b for b in range(5) if 4**b >= self.max_points)
        self.cell_size_m = size / (1 << bits)
        """Edge [m] of a cell, of which a voxel keeps one point: a plane along a voxel crosses at least `max_points`."""
        axis = (0xFFFF << (16 - bits)) & 0xFFFF
        self._same_cell = np.uint64(axis << 32 | axis << 16 | axis)
        fields = {"points": np.dtype((np.uint64, (self.max_points,)))}
        self.store = BlockStore(fields, size, fill={"points": int(kernels.EMPTY)}, edge=1)
        if with_intensity:
            self._keep("intensity", np.float32)
        if with_color:
            self._keep("color", np.uint32)
        self._listed: tuple[int, NDArray[np.float32]] = (0, read_only(np.empty((0, 3), np.float32)))
        self._planted: tuple[int, cKDTree] | None = None

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "max_points": self.max_points,
            "max_range_m": self.max_range_m,
            "with_intensity": "intensity" in self.store.fields,
            "with_color": "color" in self.store.fields,
        }

    def _keep(self, name: str, dtype: type) -> None:
        self.store.add_field(name, np.dtype((dtype, (self.max_points,))))

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(
        self,
        p_sensor: ArrayLike,
        T_map_sensor: SE3 | ArrayLike,
        *,
        intensity: ArrayLike | None = None,
        color: ArrayLike | None = None,
    ) -> Changed:
        """Offer one scan to the map: p_sensor (N, 3) [m] in the sensor frame, and what came with each point, if
        anything: intensity (N,), colour (N, 3) uint8. Returns the blocks (voxels) that keep another set of points now.
        """
        scan = SortedPoints(p_sensor, T_map_sensor, self.max_range_m, self.voxel_size_m)
        words = np.empty(len(scan.rows), np.uint64)
        kernels.make_words(scan.offsets, words)
        return self._offer(scan.voxel_ijk, scan.rows, words, *self._extras(len(words), intensity, color))

    def integrate_image(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        color: Array | None = None,
    ) -> Changed:
        """Offer the points of one depth image (H, W) float32 [m] or uint16 [mm], 0 = not measured, and its colours
        (H, W, 3) uint8. Returns the blocks changed."""
        paints = None if color is None else color_of_points(depth, color)
        return self.integrate(depth_to_points(depth, intrinsics), T_map_camera, color=paints)

    def merge(self, other: PointMap) -> Changed:
        """Take over the points of another map of the same frame, voxel size and bound: what is kept then is what would
        be, had all scans of both come here. Returns the blocks changed; raises `InvalidParameter` where they differ.
        """
        mine, theirs = (self.voxel_size_m, self.max_points), (other.voxel_size_m, other.max_points)
        if mine != theirs:
            raise InvalidParameter(f"other: expected voxel_size_m, max_points = {mine}, got {theirs}")
        words = other.store.used("points").reshape(-1)
        rows = np.repeat(np.arange(other.store.n_blocks, dtype=np.int32), other.max_points)
        kept = words != kernels.EMPTY
        extras = []
        for name, dtype in (("intensity", np.float32), ("color", np.uint32)):
            values = other.store.used(name).reshape(-1)[kept] if name in other.store.fields else np.empty(0, dtype)
            if len(values) and name not in self.store.fields:
                self._keep(name, dtype)
            missing = name in self.store.fields and not len(values)
            extras.append(read_only(np.zeros(int(kept.sum()), dtype) if missing else values))
        return self._offer(other.block_ijk, rows[kept], words[kept], *extras)

    def _extras(self, n: int, intensity: ArrayLike | None, color: ArrayLike | None) -> tuple[Array, Array]:
        """What came with the points as the kernel takes it: (n,) where the map keeps it, else (0,)."""
        strengths, paints = _NO_INTENSITY, _NO_COLOR
        if intensity is not None:
            strengths = read_only(np.ascontiguousarray(intensity, np.float32))
            if strengths.shape != (n,):
                raise InvalidObservation(f"intensity: expected one a point ({n},), got {strengths.shape}")
            if "intensity" not in self.store.fields:
                self._keep("intensity", np.float32)
        elif "intensity" in self.store.fields:
            strengths = read_only(np.zeros(n, np.float32))
        if color is not None:
            wide = as_colors(color, n).astype(np.uint32)
            if "color" not in self.store.fields:
                self._keep("color", np.uint32)
            paints = read_only(wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2])
        elif "color" in self.store.fields:
            paints = read_only(np.zeros(n, np.uint32))
        return strengths, paints

    def _offer(
        self, voxel_ijk: Array, rows: NDArray[np.int32], words: NDArray[np.uint64], intensity: Array, color: Array
    ) -> Changed:
        slots = self.store.allocate(voxel_ijk)
        changed = np.empty(len(slots), np.bool_)
        kernels.keep_points(
            self._rows("points", np.uint64), self._rows("intensity", np.float32), self._rows("color", np.uint32),
            slots, rows, words, intensity, color, self._same_cell, changed,
        )  # fmt: skip
        return self._note(slots[changed])

    def _rows(self, name: str, dtype: type) -> Array:
        """A field as (capacity, max_points); no rows where the map does not keep it."""
        field = self.store.fields.get(name, np.empty(0, dtype))
        return field.reshape(-1, self.max_points)

    # -- what is kept -------------------------------------------------------------------------------------
    @property
    def points(self) -> NDArray[np.float32]:
        """(N, 3) float32 [m] all points kept, voxel by voxel; read-only, the same array until the map changes."""
        revision, points = self._listed
        if revision != self.revision:
            voxels, kept = read_only(self.block_ijk), read_only(self._rows("points", np.uint64))
            n = kernels.list_points(kept, voxels, self.voxel_size_m, np.empty((0, 3), np.float32))
            points = np.empty((n, 3), np.float32)
            kernels.list_points(kept, voxels, self.voxel_size_m, points)
            points.setflags(write=False)
            self._listed = self.revision, points
        return points

    @property
    def intensity(self) -> NDArray[np.float32] | None:
        """(N,) of each of `points`, 0 where none came with it; None where none ever came."""
        return self._of_points("intensity") if "intensity" in self.store.fields else None

    @property
    def color(self) -> NDArray[np.uint8] | None:
        """(N, 3) red, green, blue of each of `points`, black where none came with it; None where none ever came."""
        if "color" not in self.store.fields:
            return None
        packed = self._of_points("color")
        return np.stack([packed >> 16, packed >> 8 & 0xFF, packed & 0xFF], axis=1).astype(np.uint8)

    def _of_points(self, name: str) -> Array:
        values: Array = self.store.used(name)[self.store.used("points") != kernels.EMPTY]
        return values

    # -- questions ----------------------------------------------------------------------------------------
    def nearest(
        self, p_map: ArrayLike, max_distance_m: float | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The nearest kept point (N, 3) [m] to each of p_map (N, 3) [m] and its distance (N,) [m]; NaN where there is
        none within `max_distance_m` (default one voxel).

        Looks through the voxels about the point, so it needs no index that a change of the map would make stale; the
        cost grows with the cube of `max_distance_m` in voxels where there is nothing. For far points use `neighbours`.
        """
        reach = self.voxel_size_m if max_distance_m is None else max_distance_m
        require("max_distance_m", reach, 0.0, 100.0 * self.voxel_size_m, "m (100 voxels)")
        points = as_points(p_map)
        nearest, distance = np.empty((len(points), 3)), np.empty(len(points))
        kept = self._rows("points", np.uint64)
        kernels.find_nearest(self.store.table, kept, 1.0 / self.voxel_size_m, float(reach), points, nearest, distance)
        return nearest, distance

    def radius(self, p_map: ArrayLike, radius_m: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """All kept points within `radius_m` of each of p_map (N, 3) [m]: the row in p_map (M,), ascending, and the kept
        point (M, 3) [m] of each pair."""
        require("radius_m", radius_m, 0.0, 100.0 * self.voxel_size_m, "m (100 voxels)")
        points, room = as_points(p_map), 0
        kept = self._rows("points", np.uint64)
        while True:
            owners, found = np.empty(room, np.int64), np.empty((room, 3))
            n = kernels.find_within(
                self.store.table, kept, 1.0 / self.voxel_size_m, float(radius_m), points, owners, found
            )
            if n <= room:
                return owners[:n], found[:n]
            room = n

    def query(self, p_map: ArrayLike, *, max_distance_m: float | None = None) -> NDArray[np.float64]:
        """The distance (N,) [m] from each point (N, 3) [m] to the nearest kept point; NaN where there is none within
        `max_distance_m` (default one voxel): a point map does not know free space."""
        return self.nearest(p_map, max_distance_m)[1]

    @property
    def tree(self) -> cKDTree:
        """A k-d tree (Bentley 1975) over `points`, made at the first use after a change: for k neighbours, far ones, or
        other questions of scipy's. Raises `InvalidParameter` while the map is empty."""
        if not len(self.points):
            raise InvalidParameter("points: expected at least one point in the map, got none")
        if self._planted is None or self._planted[0] != self.revision:
            self._planted = self.revision, cKDTree(self.points)
        return self._planted[1]

    def neighbours(self, p_map: ArrayLike, k: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The `k` kept points nearest to each of p_map (N, 3) [m], however far: rows (N, k) in `points`, ascending in
        distance, and distances (N, k) [m]; where the map holds fewer, the rest is −1 and NaN."""
        if not (isinstance(k, int) and k >= 1):
            raise InvalidParameter(f"k: expected a whole number ≥ 1, got {k!r}")
        points = as_points(p_map)
        if not np.isfinite(points).all():
            raise InvalidParameter("p_map: expected finite points, got NaN or infinity")
        rows, distances = np.full((len(points), k), -1, np.int64), np.full((len(points), k), np.nan)
        held = min(k, len(self.points))
        if held:
            distance, row = self.tree.query(points, k=range(1, held + 1))
            rows[:, :held], distances[:, :held] = row, distance
        return rows, distances
