"""Masks that reach beyond their objects: of simulated homes, where the truth is known, and of real images, by rules."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import RgbdImage
from mapping.plane import Plane
from mapping.view import as_depth_m
from scenegraph.simulation import CAMERA, Home, NoiseModel, Tour
from scenegraph.simulation.observing import make_segmenter
from scenegraph.simulation.structure import TruePlane

LEAST_PIXELS = 1500
"""Smaller masks are left out: they say little about shape."""
GROW_BACK_PX = 3
SAMPLES = 16  # along the way from a bled pixel to the object


@dataclass(frozen=True)
class MaskedImage:
    """One detection: a mask (H, W) of a depth image (H, W) float32 [m] as it was measured, and what is true of it.

    shown  (H, W) bool: measured pixels that truly show the object, whether in the mask or not
    step   (H, W) bool: measured pixels of the mask beyond the object, across a step in depth of more than two voxels
    touch  (H, W) bool: those on what touches it there
    """

    name: str
    depth: np.ndarray
    mask: np.ndarray
    camera: CameraIntrinsics
    T_map_camera: SE3
    T_map_reported: SE3
    shown: np.ndarray
    step: np.ndarray
    touch: np.ndarray
    entity: int = 0


def beyond_steps(bled: np.ndarray, own: np.ndarray, depth: np.ndarray, step_m: float) -> np.ndarray:
    """Which pixels of `bled` (H, W) are parted from the nearest pixel of `own` (H, W) by a step in depth (H, W) [m]:
    somewhere on the straight way between them the depth changes by more than step_m from one pixel to the next."""
    nearest = ndimage.distance_transform_edt(~own, return_distances=False, return_indices=True)
    v, u = np.nonzero(bled)
    v0, u0 = nearest[0][v, u], nearest[1][v, u]
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    way = depth[np.rint(v0 + (v - v0) * along).astype(int), np.rint(u0 + (u - u0) * along).astype(int)]
    jump = (np.abs(np.diff(way, axis=0)) > step_m) | (way[1:] <= 0.0)
    result = np.zeros(bled.shape, bool)
    result[v, u] = jump.any(axis=0)
    return result


def simulated_masks(
    home: Home, *, noise: NoiseModel, voxel_size_m: float, images_per_room: int, every: int = 1, seed: int = 0
) -> Iterator[MaskedImage]:
    """Detections of things on a tour through a home, none missed or mistaken, with masks that bleed."""
    rng = np.random.default_rng([home.seed, seed])
    segmenter = make_segmenter(home, noise, seed)
    for step in Tour(home, images_per_room=images_per_room).steps[::every]:
        rendered = home.renderer.render(step.T_map_camera, colored=False)
        depth = noise.depth_mm(rendered.depth, rng).astype(np.float32) * np.float32(0.001)
        if not noise.depth_base_m and not noise.dropout_px:
            depth = rendered.depth
        reported = noise.perturbed(step.T_map_camera, rng)
        instances = segmenter.segment(rendered.entities, rendered.labels, rng).instances
        for number in np.unique(instances[instances > 0]).tolist():
            mask = instances == number
            inside = np.bincount(rendered.entities[mask])
            inside[0] = 0
            entity = int(inside.argmax())
            own = rendered.entities == entity
            shown = own & (depth > 0.0)
            if mask.sum() < LEAST_PIXELS or entity > len(home.objects) or (shown & mask).sum() < LEAST_PIXELS // 2:
                continue
            bled = mask & ~own & (depth > 0.0)
            beyond = beyond_steps(bled, own, rendered.depth, 2.0 * voxel_size_m)
            yield MaskedImage(
                home.entities[entity - 1], depth, mask, CAMERA, step.T_map_camera, reported,
                shown, beyond, bled & ~beyond, entity,
            )  # fmt: skip


def known_planes(structure: Iterable[TruePlane]) -> list[Plane]:
    """True planes, as the mapping of planes would know them."""
    return [_known_plane(n, plane) for n, plane in enumerate(structure)]


def _known_plane(number: int, plane: TruePlane) -> Plane:
    axes = np.column_stack([*plane.axes[:2], plane.normal])
    along = plane.polygon @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    middle = axes @ (0.5 * (low + high))
    return Plane(
        id=number, normal=plane.normal, offset=plane.offset, centroid=middle, rings=(plane.polygon,),
        area_m2=plane.area, z_min=0.0, z_max=0.0, width_m=0.0, box_center=middle, box_axes=axes, box_size=high - low,
        n_points=0, rms_m=0.0,
    )  # fmt: skip


def projected(depth: np.ndarray, mask: np.ndarray, camera: CameraIntrinsics, T: SE3, size_m: float) -> np.ndarray:
    """The paper's first baseline: all measured pixels of the mask, as packed indices of voxels, ascending."""
    v, u = np.nonzero(mask & (depth > 0.0))
    z = depth[v, u].astype(np.float64)
    p = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    return packed(np.floor((p @ T.rotation.T + T.translation) / size_m))


def packed(ijk: np.ndarray) -> np.ndarray:
    """Voxel indices (N, 3) as ascending whole numbers, each once."""
    i = ijk.astype(np.int64) + (1 << 20)
    return np.unique(i[:, 0] << 42 | i[:, 1] << 21 | i[:, 2])


def eroded(mask: np.ndarray, pixels: int) -> np.ndarray:
    """The paper's second baseline before it is projected: the mask without `pixels` at its border, by steps of a kernel
    of 3 × 3, beyond the image's edge all is mask."""
    return np.asarray(ndimage.binary_erosion(mask, np.ones((3, 3), bool), iterations=pixels, border_value=1))


def _linked(depth: np.ndarray, axis: int) -> np.ndarray:
    """Which pixels (H, W) lie on one surface with the one before them along an axis: both measured, and no jump."""
    near = np.roll(depth, 1, axis)
    linked = (depth > 0.0) & (near > 0.0) & (np.abs(depth - near) <= 0.03 + 0.01 * np.minimum(depth, near))
    linked[(0, slice(None)) if axis == 0 else (slice(None), 0)] = False
    return linked


def _grown(own: np.ndarray, links: list[np.ndarray]) -> np.ndarray:
    """Pixels and those next to them that lie on one surface with them."""
    grown = own.copy()
    for axis, linked in enumerate(links):
        grown |= linked & np.roll(own, 1, axis)
        grown |= np.roll(linked & own, -1, axis)
    return grown


def depth_clusters(image: RgbdImage, *, seed: int, largest: int = 100_000) -> Iterator[MaskedImage]:
    """Masks of a real image by a rule: surfaces between which the depth jumps by more than 3 cm and 1 % are one cluster
    each, of `LEAST_PIXELS` to `largest` pixels; each then bleeds by 3 to 8 pixels. What the cluster holds is the truth.

    Clusters are found two pixels from every jump, so that no stray pixel bridges one, and then grow back to the jumps.
    """
    depth = as_depth_m(image.depth)
    depth = np.where(np.isfinite(depth) & (depth < 4.0), depth, 0.0).astype(np.float32)
    rng = np.random.default_rng(seed)
    links = [_linked(depth, axis) for axis in (0, 1)]
    jumps = [(depth > 0.0) & ~linked for linked in links]
    numbers, _ = ndimage.label(~ndimage.binary_dilation(jumps[0] | jumps[1] | (depth <= 0.0)))
    sizes = np.bincount(numbers.ravel())
    for number in np.flatnonzero((sizes >= LEAST_PIXELS) & (sizes <= largest)).tolist():
        if number == 0:
            continue
        own = numbers == number
        for _ in range(GROW_BACK_PX):
            own = _grown(own, links)
        reach = ndimage.distance_transform_edt(~own)
        mask = reach <= rng.integers(3, 9)
        bled = mask & ~own & (depth > 0.0)
        beyond = beyond_steps(bled, own, depth, 0.04)
        pose = image.T_map_camera or SE3.identity()
        yield MaskedImage(
            f"cluster {number}", depth, mask, image.intrinsics, pose, pose, own, beyond, bled & ~beyond, number
        )
