"""Truncated signed distances: the surface between voxels, averaged over every image that saw it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BLOCK_VOXELS, BlockStore, as_blocks, as_points, new_table, read_only
from mapping.kernels import range_tsdf, raycast, surface, tsdf, visibility
from mapping.layer import BlockLayer, Changed, require
from mapping.range_view import RangeView
from mapping.sensors import LidarModel
from mapping.view import DepthView, as_pose

if TYPE_CHECKING:
    from mapping.mesh import Labelled, Mesh
    from mapping.raycast import VirtualView

Array: TypeAlias = NDArray[Any]

_NO_COLOR = read_only(np.empty((0, 0, 3), np.uint8))
_NO_COLORS = np.empty((0, 0, 3), np.uint16)
_CHUNK = 256  # blocks sampled at once: bounds the memory of `surface`


class TsdfMap(BlockLayer):
    """Signed distance to the nearest surface along the viewing ray, truncated (Curless & Levoy 1996; Newcombe et al.,
    KinectFusion, ISMAR 2011), positive before surfaces and negative behind them.

    voxel_size_m    edge of a voxel [m]
    truncation_m    distances are kept up to this [m]; default 4 voxels
    max_range_m     surfaces farther from the camera [m, along the ray] are not believed
    weighting       "constant", or "inverse_square": 1/z², as the noise of structured light grows
    depth_noise     images measure depth with a standard deviation of depth_noise · z² [1/m]; the default is that of
                    structured light, 0 that of exact depth. Where noise may have put the surface before a voxel, the
                    voxel is not taken to be behind it: else noise would move far surfaces away from the camera
    max_weight      the running mean's memory: at this weight new measurements begin to displace old ones
    carve           whether voxels of existing blocks that an image sees in front of its surface become free, so that
                    what has gone goes from the map (a block that is made later missed what was seen before: this
                    depends on the order of images); free space is remembered for a few views only, so that what comes
                    appears. Otherwise only the band about the surface is updated
    with_color      keep colours from the beginning; otherwise from the first image that has any

    Measurements count little from two voxels behind their surface on, so that the sides of a thin thing stay apart.
    Measured at 5 cm voxels, walls seen from both sides from 1.5 m: 20 and 15 cm come out as 20.0 and 15.1 cm, 10 cm
    (two voxels) as 11.6 cm, 5 cm (one voxel) as 10.2 cm; with `depth_noise` 0 as 11.0 and 9.2 cm: things thinner than
    two voxels come out about two voxels thick.

    Distances run along the viewing ray, not along the surface's normal; they are exact where they are zero.

    Updates are weighted sums: without `carve` their order does not matter until `max_weight`. Raises
    `InvalidParameter` on bad values.
    """

    kind: ClassVar[str] = "tsdf"

    def __init__(
        self,
        voxel_size_m: float = 0.05,
        truncation_m: float | None = None,
        max_range_m: float = 20.0,
        *,
        weighting: Literal["constant", "inverse_square"] = "inverse_square",
        depth_noise: float = 0.0019,
        max_weight: float = 100.0,
        carve: bool = True,
        with_color: bool = False,
    ) -> None:
        size = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        if truncation_m is None:
            truncation_m = 4.0 * size
        self.truncation_m = require("truncation_m", truncation_m, 1.5 * size, 8.0 * size, "m (1.5 … 8 voxels)")
        self.max_range_m = require("max_range_m", max_range_m, 0.0, 10_000.0, "m")
        if weighting not in ("constant", "inverse_square"):
            raise InvalidParameter(f'weighting: expected "constant" or "inverse_square", got {weighting!r}')
        self.weighting = weighting
        self.depth_noise = 0.0 if depth_noise == 0.0 else require("depth_noise", depth_noise, 0.0, 1.0, "1/m")
        self.max_weight = require("max_weight", max_weight, 0.0, 1e6)
        self.carve = bool(carve)
        self.store = BlockStore({"distance": np.float32, "weight": np.float32}, size)
        self._samples = np.empty((_CHUNK, BLOCK_VOXELS, 6), np.float32)  # scratch of `surface`
        self._boxes, self._boxed_at = np.empty((0, 6), np.int8), -1  # of `surface_boxes`
        if with_color:
            self._keep_color()

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "truncation_m": self.truncation_m,
            "max_range_m": self.max_range_m,
            "weighting": self.weighting,
            "depth_noise": self.depth_noise,
            "max_weight": self.max_weight,
            "carve": self.carve,
            "with_color": self.has_color,
        }

    @property
    def _slack(self) -> float:
        """Two standard deviations of a depth measured at 1 m [voxels]."""
        return 2.0 * self.depth_noise / self.voxel_size_m

    @property
    def has_color(self) -> bool:
        return "color" in self.store.fields

    def _keep_color(self) -> None:
        self.store.add_field("color", np.dtype((np.uint16, 3)))

    # -- updates ------------------------------------------------------------------------------------------
    def integrate(self, p_sensor: ArrayLike, T_map_sensor: SE3 | ArrayLike) -> Changed:
        """Fuse a cloud without an image: each beam updates the voxels that it crosses within the truncation of its end.

        `p_sensor` is (N, 3) [m] in the sensor frame. Every beam counts the same. Returns the blocks changed.
        """
        pose = as_pose(T_map_sensor, "T_map_sensor")
        ends = as_points(p_sensor, "p_sensor")
        if not np.isfinite(ends).all():
            raise InvalidObservation("p_sensor: expected finite points, got NaN or infinity")
        ends = pose @ ends
        room, n_blocks, beam = 1024, 0, 0
        blocks = np.empty((room, 3), np.int32)
        sums, weights = np.empty((room, BLOCK_VOXELS), np.float32), np.empty((room, BLOCK_VOXELS), np.float32)
        while True:
            beam, n_blocks = tsdf.sum_beams(
                pose.translation, ends, beam, self.max_range_m, self.voxel_size_m, self.truncation_m,
                new_table(blocks, n_blocks, len(blocks)), blocks, n_blocks, sums, weights,
            )  # fmt: skip
            if beam == len(ends):
                break
            blocks, sums, weights = (np.concatenate([a, np.empty_like(a)]) for a in (blocks, sums, weights))
        slots = self.store.allocate(blocks[:n_blocks])
        changed = np.empty(n_blocks, np.bool_)
        fields = self.store.fields
        tsdf.fold_sums(fields["distance"], fields["weight"], slots, sums, weights, self.max_weight, changed)
        return self._note(slots[changed])

    def integrate_image(
        self,
        depth: Array,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        color: Array | None = None,
    ) -> Changed:
        """Fuse one depth image (H, W) float32 [m] or uint16 [mm], 0 = not measured, and its colours (H, W, 3) uint8.

        Projective: each voxel takes the pixel nearest to its centre. Returns the blocks changed.
        """
        return self.integrate_view(DepthView(depth, intrinsics, T_map_camera, self.max_range_m), color)

    def integrate_view(self, view: DepthView, color: Array | None = None) -> Changed:
        """Fuse a depth image that has been prepared already."""
        image = _NO_COLOR
        if color is not None:
            image = read_only(np.ascontiguousarray(color))
            if image.dtype != np.uint8 or image.shape != (*view.reach.shape, 3):
                raise InvalidObservation(
                    f"color: expected uint8 {(*view.reach.shape, 3)} like depth, got {image.dtype} {image.shape}"
                )
            if not self.has_color:
                self._keep_color()
        size, tau = self.voxel_size_m, self.truncation_m
        blocks, kinds = view.blocks(
            self.block_size_m, front_m=tau, back_m=tau, with_free=self.carve, gaps_are_free=True
        )
        slots = self.store.find(blocks)
        seen = (slots >= 0) | (kinds == visibility.MIXED)
        blocks, slots = blocks[seen], slots[seen]
        wanted = np.empty(len(blocks), np.bool_)
        tsdf.find_band(blocks, slots, size, tau, view.reach, view.camera, wanted)
        blocks = blocks[wanted]
        slots = self.store.allocate(blocks)
        changed = np.empty(len(blocks), np.bool_)
        fields = self.store.fields
        inverse_square = self.weighting == "inverse_square"
        tsdf.fuse_image(
            fields["distance"], fields["weight"], fields.get("color", _NO_COLORS), slots, blocks, size, tau,
            self.carve, inverse_square, self._slack, self.max_weight, view.reach, view.camera, image, changed,
        )  # fmt: skip
        return self._note(slots[changed])

    def integrate_range_image(self, ranges: Array, model: LidarModel, T_map_sensor: SE3 | ArrayLike) -> Changed:
        """Fuse one lidar range image (rows, columns) float32 [m] of `model`, 0 = not measured.

        Projective: each voxel takes the beam nearest to its centre, if that passes within half the voxel's diagonal.
        Returns the blocks changed.
        """
        return self.integrate_range_view(RangeView(ranges, model, T_map_sensor, self.max_range_m))

    def integrate_range_view(self, view: RangeView) -> Changed:
        """Fuse a lidar range image that has been prepared already."""
        size, tau = self.voxel_size_m, self.truncation_m
        blocks, kinds = view.blocks(self.block_size_m, front_m=tau, back_m=tau, touch_m=size, with_free=self.carve)
        slots = self.store.find(blocks)
        seen = (slots >= 0) | (kinds == visibility.MIXED)
        blocks, slots = blocks[seen], slots[seen]
        lidar = (view.reach, view.lidar, view.row_of, view.off_row)
        wanted = np.empty(len(blocks), np.bool_)
        range_tsdf.find_band(blocks, slots, size, tau, *lidar, wanted)
        blocks = blocks[wanted]
        slots = self.store.allocate(blocks)
        changed = np.empty(len(blocks), np.bool_)
        fields = self.store.fields
        range_tsdf.fuse_ranges(
            fields["distance"], fields["weight"], slots, blocks, size, tau, self.carve,
            self.weighting == "inverse_square", self.max_weight, *lidar, changed,
        )  # fmt: skip
        return self._note(slots[changed])

    # -- questions ----------------------------------------------------------------------------------------
    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The signed distance (N,) [m] at each point (N, 3) [m], interpolated between the eight voxels about it;
        NaN where one of these is unknown."""
        points = as_points(p_map)
        values = np.empty(len(points), np.float64)
        fields = self.store.fields
        tsdf.interpolate(self.store.table, fields["distance"], fields["weight"], self.voxel_size_m, points, values)
        return values

    def surface(
        self, block_ijk: ArrayLike | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """One sample of the surface a voxel that it crosses, in the blocks (K, 3) asked for (default all).

        Returns points (N, 3) float32 [m], unit normals (N, 3) float32 into free space, and for each point the row (N,)
        of its block in `block_ijk`.
        """
        blocks = as_blocks(self.block_ijk if block_ijk is None else block_ijk)
        fields = self.store.fields
        points, normals = [np.empty((0, 3), np.float32)], [np.empty((0, 3), np.float32)]
        counts = np.empty(len(blocks), np.int64)
        samples = self._samples
        for first in range(0, len(blocks), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            surface.sample_surface(
                self.store.table, fields["distance"], fields["weight"], self.voxel_size_m, self.max_jump_m,
                blocks[chunk], samples, counts[chunk],
            )  # fmt: skip
            places, directions = np.empty((2, int(counts[chunk].sum()), 3), np.float32)
            surface.gather_samples(samples, counts[chunk], places, directions)
            points.append(places)
            normals.append(directions)
        return np.concatenate(points), np.concatenate(normals), np.repeat(np.arange(len(blocks)), counts)

    @property
    def max_jump_m(self) -> float:
        """Neighbouring voxels whose distances differ by more [m] lie on two surfaces, one before the other.

        A surface seen at a grazing angle changes fast across the ray, hence not less.
        """
        return 1.5 * self.truncation_m

    def surface_boxes(self) -> NDArray[np.int8]:
        """(n_blocks, 6) the box about the surface in each block, see `mapping.kernels.raycast.box_surfaces`; only the
        blocks that changed since the last call, and their neighbours, are looked at."""
        store = self.store
        boxes = np.empty((store.n_blocks, 6), np.int8)
        boxes[: len(self._boxes)] = self._boxes
        slots = self.changed_near(self._boxed_at, -1, 0)
        fresh = np.empty((len(slots), 6), np.int8)
        raycast.box_surfaces(
            store.table, store.fields["distance"], store.fields["weight"], self.max_jump_m,
            as_blocks(self.block_ijk[slots]), fresh,
        )  # fmt: skip
        boxes[slots] = fresh
        self._boxes, self._boxed_at = boxes, self.revision
        return boxes

    def changed_near(self, revision: int, low: int = -1, high: int = 1) -> NDArray[np.int64]:
        """The slots (n,), in order, of the blocks that changed after `revision` and of those that lie `low` … `high`
        blocks from one along each axis, as far as they exist: whatever reads a block's neighbours changed there."""
        changed = self.changed_since(revision).blocks
        offsets = np.stack(np.meshgrid(*[np.arange(low, high + 1, dtype=np.int32)] * 3, indexing="ij"), -1)
        slots = np.zeros(self.store.n_blocks, np.bool_)
        for offset in offsets.reshape(-1, 3):
            found = self.store.find(changed + offset)
            slots[found[found >= 0]] = True
        return np.flatnonzero(slots)

    def colors_at(self, p_map: ArrayLike) -> NDArray[np.uint8]:
        """The colour (N, 3) uint8 at each point (N, 3) [m], between the voxels about it; 0 where none has a colour."""
        points = as_points(p_map)
        colors = np.zeros((len(points), 3), np.uint8)
        if self.has_color:
            tsdf.blend_colors(self.store.table, self.store.fields["color"], self.voxel_size_m, points, colors)
        return colors

    def render(
        self,
        intrinsics: CameraIntrinsics | Mapping[str, float],
        T_map_camera: SE3 | ArrayLike,
        *,
        max_range_m: float | None = None,
    ) -> VirtualView:
        """The image that a camera would take of the map; see `mapping.raycast`."""
        from mapping.raycast import render

        return render(self, intrinsics, T_map_camera, max_range_m=max_range_m)

    def mesh(self, *, labels_from: Labelled | None = None) -> Mesh:
        """The surface as triangles, with labels from a `SemanticMap` if given; see `mapping.mesh`, which also has a
        mesh that follows the map."""
        from mapping.mesh import extract_mesh

        return extract_mesh(self, labels_from=labels_from)
