"""The map of a world: all layers side by side, fed by one observation at a time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter

from mapping.clearing import Clearing
from mapping.clusters import ClusterMap
from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.histograms import ClassHistogram, OrientedBox, class_histogram
from mapping.instances import InstanceChange, InstanceMap
from mapping.kernels.images import cut_off, noise_share, smooth_depth
from mapping.labelled import LabelledCloud, PointLabels, labelled_cloud, labels_at
from mapping.layer import Changed, MapLayer
from mapping.moving import MovingChange, MovingThings
from mapping.object_space import DEPTH_NOISE
from mapping.observations import RgbdImage, Scan
from mapping.occupancy import OccupancyMap
from mapping.palette import Palette
from mapping.planes import PlaneChange, PlaneMap
from mapping.registration import refine_pose
from mapping.segmentation import Bleed, segment
from mapping.semantics import SemanticMap
from mapping.tsdf import TsdfMap
from mapping.view import DepthView

Array: TypeAlias = NDArray[Any]

ESDF_TRUNCATION_M = 2.0
REGISTRATION_STEP = 12
"""Every so many-th row and column of an image takes part in the correction of its pose …"""
REGISTRATION_RANGE_M = 4.5
"""… where it measured less than this."""
SWEEP_VIEWS = 4
"""A scan, which looks all around at once, is worth so many images."""
NOISE_STEP = 6
"""Every so many-th row and column of an image tells how noisy its depth is."""
MOVER_STEP = 2
"""Every so many-th row and column is enough to tell where something that moves was."""
MOVING_RIM_PX = 3
"""Masks of what moves are taken for so much larger: what they leave out, later views show anyway."""


@dataclass(frozen=True)
class MapChange:
    """What one observation changed on each floor of the map.

    T_map_camera  an image's pose as the map corrected it;  view   what it saw from there
    bare_views    how many images without labels the observation is worth, 0 where it has labels
    movers        points (N, 3) [m] where an image whose depth was fused before shows what moves by itself
    """

    occupancy: Changed
    tsdf: Changed
    planes: PlaneChange = field(default_factory=PlaneChange)
    instances: InstanceChange = field(default_factory=lambda: InstanceChange(frozenset(), {}))
    moving: MovingChange = field(default_factory=MovingChange)
    T_map_camera: SE3 | None = None
    bare_views: int = 0
    view: DepthView | None = None
    movers: Array = field(default_factory=lambda: np.empty((0, 3)))


class LayeredMap:
    """Occupancy, signed distance, planes, class votes and instances, and clusters, which whoever knows what the planes
    are keeps up to date; and a distance field that follows the occupancy.

    voxel_size_m           edge of the voxels of occupancy and signed distance [m]
    instance_voxel_size_m  edge of the finer voxels of classes and things [m]
    max_range_m            measurements beyond this are cut [m]
    label_range_m          labels beyond this are not believed [m]
    fusion                 of labels: "votes" or "bayes", see `SemanticMap`
    spread_labels          whether labels are spread over where they may belong, where the pose comes with a covariance
    follow_moving          whether what moves by itself and is left out of the map is kept beside it, see `moving`
    """

    def __init__(
        self,
        *,
        voxel_size_m: float,
        instance_voxel_size_m: float,
        max_range_m: float,
        label_range_m: float,
        fusion: Literal["votes", "bayes"] = "votes",
        spread_labels: bool = False,
        follow_moving: bool = False,
    ) -> None:
        self.max_range_m = max_range_m
        self.spread_labels = spread_labels
        self.follow_moving = follow_moving
        self.label_range_m = label_range_m
        self.occupancy = OccupancyMap(voxel_size_m=voxel_size_m, max_range_m=max_range_m)
        self.tsdf = TsdfMap(
            voxel_size_m=voxel_size_m,
            truncation_m=max(3.0 * voxel_size_m, 0.06),
            max_range_m=max_range_m,
            depth_noise=0.0,  # boards as thin as voxels matter more to relations than walls far away
        )
        self.semantics = SemanticMap(voxel_size_m=instance_voxel_size_m, fusion=fusion)
        self.instances = InstanceMap(voxel_size_m=instance_voxel_size_m)
        self.semantics.things = self.instances
        self.moving = MovingThings(voxel_size_m=instance_voxel_size_m)
        self.planes = PlaneMap(voxel_size_m)
        self.clusters = ClusterMap(voxel_size_m)
        self.esdf = self._distance_field()
        self._clearing = Clearing()
        self._bleed: defaultdict[str, Bleed] = defaultdict(Bleed)  # of the masks of each sensor

    @property
    def layers(self) -> dict[str, MapLayer]:
        return {layer.kind: layer for layer in (self.occupancy, self.tsdf, self.semantics, self.instances)}

    def _distance_field(self) -> EsdfMap:
        """Distances to what is occupied; worked out where something changed, when they are asked for."""
        return EsdfMap(self.occupancy, truncation_m=min(ESDF_TRUNCATION_M, 200.0 * self.occupancy.voxel_size_m))

    def state(self) -> dict[str, dict[str, Array]]:
        """The arrays of all layers, by layer."""
        layers = {name: layer.state() for name, layer in self.layers.items()}
        rest = {"moving": self.moving.state(), "planes": self.planes.state(), "clearing": self._clearing.state()}
        if len(self.clusters):
            rest["clusters"] = self.clusters.state()
        return {**layers, **rest, "bleed": {sensor: bleed.masks for sensor, bleed in self._bleed.items()}}

    def restore(self, state: Mapping[str, Mapping[str, Array]]) -> None:
        """Take over what `state` gave."""
        self.occupancy = OccupancyMap.from_state(state["occupancy"])
        self.tsdf = TsdfMap.from_state(state["tsdf"])
        self.semantics = SemanticMap.from_state(state["semantics"])
        self.instances = InstanceMap.from_state(state["instances"])
        self.semantics.things = self.instances
        self.moving = MovingThings.from_state(state["moving"])
        self.planes.restore(state["planes"])
        if "clusters" in state:
            self.clusters = ClusterMap.from_state(state["clusters"], self.tsdf.voxel_size_m)
        self._clearing = Clearing.from_state(state["clearing"])
        self._bleed.update({sensor: Bleed(masks) for sensor, masks in state.get("bleed", {}).items()})
        self.esdf = self._distance_field()

    def integrate_image(
        self, image: RgbdImage, T_map_camera: SE3, things: Array, moving: Array | None = None
    ) -> MapChange:
        """Fuse an image.

        things  (65536,) bool: class ids that have instances
        moving  (65536,) bool: class ids of what moves by itself and is to be left out of the map
        """
        depth_m = image.depth_m if moving is None else self._still(image, T_map_camera, moving)
        T_map_camera = self._corrected(image, depth_m, T_map_camera)
        view = DepthView(depth_m, image.intrinsics, T_map_camera, self.max_range_m)
        occupancy = self.occupancy.integrate_view(view)
        tsdf = self.tsdf.integrate_view(view, color=_registered_color(image))
        planes = self.planes.update(self.tsdf, tsdf)
        instances = self._vote(image, depth_m, T_map_camera, things)
        lost = self._clearing.update(view, self.occupancy, self.semantics, self.instances)
        instances = replace(instances, touched=instances.touched | lost)
        followed = self._follow(image, T_map_camera, moving)
        bare_views = int(image.labels is None)
        return MapChange(occupancy, tsdf, planes, instances, followed, T_map_camera, bare_views, view)

    def _still(self, image: RgbdImage, T_map_camera: SE3, moving: Array) -> Array:
        """The depth image without what moves: what is labelled so, and what is where something that is followed should
        be, whatever its label."""
        mask = self.moving.foretold(image, T_map_camera)
        if image.labels is not None and moving.any():
            labelled = moving[image.labels]
            mask = labelled if mask is None else mask | labelled
        if mask is None or not mask.any():
            return image.depth_m
        return np.where(beside(mask, MOVING_RIM_PX), np.float32(0.0), image.depth_m)

    def _follow(self, image: RgbdImage, T_map_camera: SE3, moving: Array | None) -> MovingChange:
        if not self.follow_moving or moving is None:
            return MovingChange()
        return self.moving.integrate_image(image, self._near(image.depth_m), T_map_camera, moving)

    def _corrected(self, image: RgbdImage, depth_m: Array, T_map_camera: SE3) -> SE3:
        """The pose as the map corrects it, where it is uncertain."""
        if image.covariance is None:
            return T_map_camera
        rows, columns = (slice(REGISTRATION_STEP // 2, None, REGISTRATION_STEP),) * 2
        depth = depth_m[rows, columns]
        near = (depth > 0.0) & (depth < REGISTRATION_RANGE_M)
        rays = image.intrinsics.rays(rows, columns)
        return refine_pose(self.tsdf, (rays * depth[..., None])[near], T_map_camera, image.covariance)

    def label_image(self, image: RgbdImage, T_map_camera: SE3, things: Array, moving: Array | None = None) -> MapChange:
        """Add the labels of an image whose depth was fused before; `things` and `moving` as for `integrate_image`."""
        depth_m = image.depth_m if moving is None else self._still(image, T_map_camera, moving)
        instances = self._vote(image, depth_m, T_map_camera, things)
        followed = self._follow(image, T_map_camera, moving)
        movers = np.empty((0, 3)) if moving is None else _shown(image, T_map_camera, moving)
        return replace(self.unchanged, instances=instances, moving=followed, movers=movers)

    @property
    def unchanged(self) -> MapChange:
        """The change that is none."""
        nothing = np.empty((0, 3), np.int32)
        return MapChange(Changed(nothing, self.occupancy.block_size_m), Changed(nothing, self.tsdf.block_size_m))

    def _vote(self, image: RgbdImage, depth_m: Array, T_map_camera: SE3, things: Array) -> InstanceChange:
        if image.labels is None:
            return InstanceChange(frozenset(), {})
        near = self._near(depth_m)
        seen = segment(image, near, things, self._bleed[f"{image.robot}/{image.sensor}"])
        depth_m = np.empty_like(near)
        share = noise_share(near, *DEPTH_NOISE, NOISE_STEP)
        smooth_depth(near, *(share * DEPTH_NOISE), depth_m)
        weights = seen.weights(depth_m, self.semantics.voxel_size_m)
        camera = image.intrinsics
        covariance = image.covariance if self.spread_labels else None
        self.semantics.integrate_image(
            depth_m, seen.labels, weights, camera, T_map_camera, image.label_confidence, covariance
        )
        return self.instances.integrate_image(
            seen, depth_m, camera, T_map_camera, image.stamp_ns, weights, _registered_color(image)
        )

    def _near(self, depth_m: Array) -> Array:
        near = np.empty_like(depth_m)
        cut_off(depth_m, self.label_range_m, near)
        return near

    def labels_at(self, p_map: ArrayLike) -> PointLabels:
        """Class and instance at points (N, 3) [m], and whether anything was ever observed there."""
        return labels_at(p_map, self.semantics, self.occupancy, self.instances)

    def class_histogram(self, box: OrientedBox) -> ClassHistogram:
        """What a box holds: voxels and volume of each class; what is unlabelled and what was never seen apart."""
        return class_histogram(box, self.semantics, self.occupancy)

    def labelled_cloud(self, palette: Palette | None = None) -> LabelledCloud:
        """A point for each labelled voxel, with class, instance, confidence and colour."""
        return labelled_cloud(self.semantics, self.instances, palette)

    def integrate_scan(self, scan: Scan, T_map_sensor: SE3) -> MapChange:
        """Fuse a scan; labels of points vote for classes."""
        occupancy = self.occupancy.integrate(scan.points, T_map_sensor)
        tsdf = self.tsdf.integrate(scan.points, T_map_sensor)
        planes = self.planes.update(self.tsdf, tsdf)
        if scan.labels is not None:
            near = np.linalg.norm(scan.points, axis=1) < self.max_range_m
            self.semantics.integrate(T_map_sensor @ scan.points[near], scan.labels[near])
        return MapChange(occupancy, tsdf, planes, bare_views=SWEEP_VIEWS if scan.labels is None else 0)


def _registered_color(image: RgbdImage) -> Array | None:
    """The colour (H, W, 3) of each pixel of the depth image, where both come from one camera."""
    return image.color if image.T_depth_color is None and image.color_intrinsics is None else None


def _shown(image: RgbdImage, T_map_camera: SE3, classes: Array) -> Array:
    """Some of the points (N, 3) [m] of an image that have a label of these classes (65536,) bool."""
    if image.labels is None or not classes.any():
        return np.empty((0, 3))
    some = (slice(None, None, MOVER_STEP),) * 2
    mask = classes[image.labels[some]] & (image.depth_m[some] > 0.0)
    return T_map_camera @ (image.intrinsics.rays(*some)[mask] * image.depth_m[some][mask][:, None])


def beside(mask: Array, pixels: int) -> Array:
    """(H, W) bool: the pixels that lie no more rows or columns than that from one of `mask`."""
    size = 2 * pixels + 1
    wide: Array = maximum_filter(mask, size=size, mode="constant")
    return wide
