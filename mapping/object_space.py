"""From a mask to the space of one object: what it seems to cover is lifted into space, what fell on the background left
out.

After *Semantic 3D mapping from deep image segmentation* (Martín et al. 2021, section 3.1, Algorithm 1). There a search
in a k-d tree spreads from the point at the mask's centre over connected voxels of the output's resolution. Here all
26-connected components of voxels are found at once, in linear time, and the object's is told by where it lies in the
mask: a centre that is not on the object, a hole, or an obstacle in front do not matter. Where the image is known, the
rim of the mask, as wide as masks bleed, has to go on from the object without a jump as well. Output is what the paper
gives out: points, an oriented box, and a coloured octree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import as_points, ijk_to_centre, read_only
from mapping.kernels import object_space as kernels
from mapping.kernels import shapes
from mapping.kernels.hashing import BLOCK_LIMIT
from mapping.kernels.points import sort_into_voxels
from mapping.layer import require, require_whole
from mapping.observations import Box3d
from mapping.occupancy import OccupancyMap
from mapping.octomap_writing import write_octomap
from mapping.plane import Plane
from mapping.view import as_camera, as_depth_m, as_pose

Array: TypeAlias = NDArray[Any]

BLEED_PX = 8
"""How far masks reach beyond their object at most [px]."""
STEP_VOXELS = 2.0
"""Neighbouring pixels whose depths differ by no more than this are taken for one surface."""
DEPTH_NOISE = read_only(np.array([0.0012, 0.0019]))
"""σ(z) = a + b · (z − 0.4)² [m] of a structured-light camera (Nguyen et al., Modeling Kinect sensor noise, 2012)."""
FRONT_SHARE = 0.25
"""Of components that weigh at least this share of the heaviest, the one in front is the object: the others are seen
through it."""
PART_SHARE = 0.005
PART_GAP_M = 1.0
HOLE_GAP_M = 0.1
"""Other parts of an object, seen beside an obstacle or beyond an edge of its own, weigh this share of the main one and
lie no farther than this before or behind its depths; not farther than HOLE_GAP_M if they never come near the border of
the mask, as what is seen through a hole."""
FULL_VIEW_PX = 4.0
"""So many pixels of a voxel are a view's full vote for it …"""
AGAINST = 0.5
"""… and this is the most that it says against one: a voxel at the object's outline shows what lies beside it, too."""
PLANE_SLACK = 0.25
"""A pixel lies on a plane that is nearer than this share of a voxel and half a σ of its depth."""

NEAR_BORDER_PX = 8
"""What comes no nearer to the border of a mask than bleeding and this, is seen through a hole."""

_NO_PLANES = read_only(np.empty((0, 14)))
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
_UPRIGHT_POINTS = 2000


@dataclass(frozen=True, eq=False)
class ObjectSpace:
    """The space of one object as one or several views show it.

    points     (N, 3) float32 [m] that are the object's
    kept       (M,) bool or (H, W) bool: which of the points, or pixels, that were given these are
    voxel_ijk  (K, 3) int32, the voxels that hold them, in lexicographic order
    voxel_of   (N,) int32, the voxel of each point; counts (K,) points of each voxel
    votes      (K,) float32, how much a view says for each voxel: points, each less where its pixel lies near the border
               of its mask
    other_ijk  (L, 3) int32, other_counts (L,): what the same view saw beside the object, where that was asked for
    """

    voxel_size_m: float
    points: NDArray[np.float32]
    kept: NDArray[np.bool_]
    voxel_ijk: NDArray[np.int32]
    voxel_of: NDArray[np.int32]
    counts: NDArray[np.int64]
    votes: NDArray[np.float32]
    other_ijk: NDArray[np.int32]
    other_counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.voxel_ijk)

    @property
    def centres(self) -> NDArray[np.float64]:
        """(K, 3) [m] of the voxels."""
        return ijk_to_centre(self.voxel_ijk, self.voxel_size_m)

    def box(self, up: ArrayLike | None = None) -> Box3d:
        """The oriented box about the points, in their frame.

        up : (3,) direction in which one edge of the box stands; the others lie along most points (`fit_rectangle`).
             None: along the principal axes of the voxels' centres, which do not depend on how densely a side was seen.
        Raises `InvalidParameter` where the space is empty.
        """
        if not len(self):
            raise InvalidParameter("box: the space has no voxels")
        points = self.points.astype(np.float64)
        if up is None:
            centres = self.centres
            axes = np.linalg.eigh(np.cov(centres.T, bias=True))[1][:, ::-1] if len(centres) > 1 else np.eye(3)
        else:
            axes = _upright(points, np.asarray(up, np.float64), self.voxel_size_m)
        axes = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
        along = points @ axes
        low, high = along.min(axis=0), along.max(axis=0)
        size = np.maximum(high - low, 1e-6)
        pose = SE3(axes, axes @ (0.5 * (low + high)))
        return Box3d(center=pose.translation, size=size, rotation_wxyz=pose.quaternion_wxyz)


def space_of_points(points: ArrayLike, voxel_size_m: float, *, weights: ArrayLike | None = None) -> ObjectSpace:
    """The largest 26-connected component of the voxels that hold points (N, 3) [m]; any frame.

    weights : (N,) ≥ 0, how surely a point is the object's, such as the distance of its pixel from the border of the
              mask; the component with the largest sum is the object, of equals that with the lowest voxel. Default 1

    The result does not depend on the order of points (but for the rounding of sums of weights that are no whole
    numbers). Raises `InvalidParameter` where the arrays do not fit or a weight
    is negative or not finite, `InvalidObservation` where a point is not finite or too far away for a voxel.
    """
    size = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
    places = as_points(points, "points")
    if not np.isfinite(places).all():
        raise InvalidObservation("points: expected finite points, got NaN or infinity")
    weight = np.ones(len(places)) if weights is None else np.asarray(weights, np.float64)
    if weight.shape != (len(places),) or not (np.isfinite(weight).all() and (weight >= 0.0).all()):
        raise InvalidParameter(f"weights: expected finite numbers ≥ 0, one of each of {len(places)} points")
    rows, keys = _sorted(*_bin(places, size))
    parent = np.arange(len(keys), dtype=np.int32)
    kernels.join_voxels(keys, np.zeros(len(keys), np.bool_), parent)
    kernels.find_roots(parent)
    counts = np.bincount(rows, minlength=len(keys))
    sums = np.bincount(parent, np.bincount(rows, weight, len(keys)), len(keys))
    chosen = parent == (np.argmax(sums) if len(sums) else -1)
    kept = chosen[rows]
    return _space(size, places[kept].astype(np.float32), kept, rows[kept], keys, counts * chosen, counts)


def space_of_mask(
    depth: Array,
    intrinsics: CameraIntrinsics | Mapping[str, float],
    mask: ArrayLike,
    voxel_size_m: float,
    T_map_camera: SE3 | ArrayLike | None = None,
    *,
    planes: Sequence[Plane] | ArrayLike | None = None,
    bleed_px: int = BLEED_PX,
    with_others: bool = False,
    depth_noise: ArrayLike = DEPTH_NOISE,
) -> ObjectSpace:
    """The space of the object that a mask of a depth image shows, in the frame of `T_map_camera` (None: the camera's
    optical frame).

    depth        (H, W) float32 [m] or uint16 [mm]; 0, NaN and infinity = not measured
    mask         (H, W) bool, of a size with depth (see `register_labels` for the mask of another camera)
    planes       surfaces that the object is not part of, such as the table it stands on: `Plane`s, or rows (P, 4) of
                 unit normal and offset in the frame of T_map_camera. The rim of the mask, where it may bleed, does not
                 go on from the object on to one
    bleed_px     how far the mask may reach beyond the object
    depth_noise  (2,) a, b of the depth's σ(z) = a + b · (z − 0.4)² [m]
    with_others  keep what is seen beside the mask, which `space_of_views` counts against the object

    Raises `InvalidObservation` where the images do not fit, `InvalidParameter` on other bad values.
    """
    size = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
    most = 3 * require_whole("bleed_px", bleed_px, 0, 64) + 3
    deepest = most + 3 * NEAR_BORDER_PX
    noise = read_only(np.array(depth_noise, np.float64))
    if noise.shape != (2,) or not (np.isfinite(noise).all() and (noise >= 0.0).all()):
        raise InvalidParameter(f"depth_noise: expected two finite numbers ≥ 0, got {depth_noise!r}")
    camera, depth_m, whole = as_camera(intrinsics), as_depth_m(depth), _as_mask(mask)
    for name, image in (("depth", depth_m), ("mask", whole)):
        if image.shape != (camera.height, camera.width):
            raise InvalidObservation(
                f"{name} has shape {image.shape}, but intrinsics say {(camera.height, camera.width)}"
            )
    pose = SE3.identity() if T_map_camera is None else as_pose(T_map_camera, "T_map_camera")
    known = _planes_of(planes, pose)
    window = _window(whole, max(2 * bleed_px, 1) if with_others else 1)
    part = np.ascontiguousarray(depth_m[window])
    local = np.array([camera.fx, camera.fy, camera.cx - window[1].start, camera.cy - window[0].start])
    pose_row = np.concatenate([pose.rotation.ravel(), pose.translation])
    inside = np.empty(part.shape, np.uint8)
    kernels.measure_inside(np.ascontiguousarray(whole[window]), deepest, inside)

    row_at, keys = _bin_pixels(part, inside, local, pose_row, size)
    on, flat = np.zeros(part.shape, np.bool_), np.zeros(len(keys), np.bool_)
    if len(known):
        kernels.find_on_planes(part, inside, local, known, PLANE_SLACK * size, noise, on)
        flat[:] = True
        kernels.mark_flat(on, inside, deepest, row_at, flat)
    step = STEP_VOXELS * size
    parent = np.arange(len(keys), dtype=np.int32)
    kernels.join_voxels(keys, flat, parent)
    kernels.join_pixels(part, row_at, flat, step, noise, parent)
    kernels.find_roots(parent)

    sums = np.zeros((len(keys), 4))
    least = int(min(most, inside.max(initial=1)) + 1) // 2
    kernels.weigh_parts(part, inside, least, most, deepest, row_at, parent, sums)
    front = np.zeros(part.shape, np.float32)
    n = kernels.grow_rim(part, inside, most, deepest, row_at, _choose(sums)[parent], on, step, noise, front)

    points, voxel_of = np.empty((n, 3), np.float32), np.empty(n, np.int32)
    counts, votes = np.zeros(len(keys), np.int64), np.zeros(len(keys), np.float32)
    kernels.gather(front, inside, most, row_at, local, pose_row, points, voxel_of, counts, votes)
    kept = np.zeros(whole.shape, np.bool_)
    kept[window] = front > 0.0
    space = _space(size, points, kept, voxel_of, keys, counts, votes)
    if not with_others:
        return space
    row_at, keys = _bin_pixels(part, (inside == 0).astype(np.uint8), local, pose_row, size)
    others = np.bincount(row_at[row_at >= 0], minlength=len(keys))
    return replace(space, other_ijk=_unpack(keys), other_counts=others)


def space_of_views(views: Iterable[ObjectSpace]) -> ObjectSpace:
    """The space of an object that was seen several times, by votes of its voxels; all views in one frame.

    A view votes for the voxels of its object, less where they lie near the border of its mask, and half as much against
    those that it saw beside the mask (`space_of_mask` with `with_others`). A voxel with more votes for it than against
    it is the object's. Votes add: the order of views matters for the order of points only.

    `kept` (M,) says which points of all views stayed. Raises `InvalidParameter` without any view, or where voxels
    differ in size.
    """
    all_views = tuple(views)
    size = _one_size(all_views, "views")
    mine = np.concatenate([_pack(view.voxel_ijk) for view in all_views])
    keys, rows = np.unique(np.concatenate([mine, *(_pack(view.other_ijk) for view in all_views)]), return_inverse=True)
    says: list[Array] = [view.votes for view in all_views] + [-AGAINST * view.other_counts for view in all_views]
    balance = np.bincount(rows, np.clip(np.concatenate(says) / FULL_VIEW_PX, -AGAINST, 1.0), len(keys))
    of_view = rows[: len(mine)]
    votes = np.bincount(of_view, np.concatenate([view.votes for view in all_views]), len(keys))
    first = np.cumsum([0, *(len(view) for view in all_views)])[:-1].tolist()
    voxel_of = of_view[np.concatenate([view.voxel_of + at for at, view in zip(first, all_views, strict=True)])]
    kept = balance[voxel_of] > 0.0
    voxel_of = voxel_of[kept].astype(np.int32)
    points = np.concatenate([view.points for view in all_views])[kept]
    return _space(size, points, kept, voxel_of, keys, np.bincount(voxel_of, minlength=len(keys)), votes)


def write_color_octree(objects: Iterable[tuple[ObjectSpace, ArrayLike]], path: str | Path) -> None:
    """Write objects as one OctoMap file (`.ot`) with colours, each in that of its class (paper, section 3.1).

    objects : spaces and colours (3,) uint8; where two share a voxel the later one counts
    Raises `InvalidParameter` without any object, where voxels differ in size, or the name does not end in `.ot`.
    """
    listed = [(space, np.asarray(color, np.uint8)) for space, color in objects]
    size = _one_size([space for space, _ in listed], "objects")
    tree = OccupancyMap(size)
    ijk = np.concatenate([space.voxel_ijk for space, _ in listed])
    rgb = np.concatenate([np.broadcast_to(color, (len(space), 3)) for space, color in listed])
    tree.assign(ijk_to_centre(ijk, size), np.full(len(ijk), tree.highest_evidence, np.int8))
    last = {tuple(voxel): color for voxel, color in zip(ijk.tolist(), rgb.tolist(), strict=True)}

    def colors(centres: NDArray[np.float64]) -> NDArray[np.uint8]:
        voxels = np.floor(centres / size).astype(np.int64).tolist()
        return np.array([last[tuple(voxel)] for voxel in voxels], np.uint8).reshape(-1, 3)

    write_octomap(tree, path, colors=colors)


# -- steps ---------------------------------------------------------------------------------------------------------


def _bin(points: Array, size: float) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The voxel of each point (N, 3) [m], a row (N,) of the keys (K,) of voxels that are returned after it."""
    rows, offsets = np.empty(len(points), np.int32), np.empty((len(points), 3), np.float32)
    ijk, lost = sort_into_voxels(points, _IDENTITY, np.inf, 1.0 / size, rows, offsets)
    lost += int((np.abs(ijk + 0.5) > BLOCK_LIMIT - 1).any())
    if lost:
        raise InvalidObservation(f"points: {lost} or more lie too far from the origin for a voxel")
    return rows, _pack(ijk)


def _bin_pixels(
    depth: Array, inside: Array, camera: Array, pose: Array, size: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The voxel of each masked pixel of a window, a row (h, w) of the ascending keys (K,), −1 where there is none."""
    row_at = np.empty(depth.shape, np.int32)
    keys, lost = kernels.bin_pixels(depth, inside, camera, pose, 1.0 / size, row_at)
    if lost:
        raise InvalidObservation(f"depth, T_map_camera: {lost} pixels lie too far from the origin for a voxel")
    return _sorted(row_at, keys)


def _sorted(rows: NDArray[np.int32], keys: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Rows (…) of keys (K,), −1 = none, and the keys, renumbered so that the keys ascend."""
    order = np.argsort(keys)
    rank = np.full(len(keys) + 1, -1, np.int32)
    rank[order] = np.arange(len(keys), dtype=np.int32)
    return rank[rows], keys[order]


def _pack(ijk: NDArray[np.int32]) -> NDArray[np.int64]:
    shifted = ijk.astype(np.int64) + BLOCK_LIMIT
    return np.asarray(shifted[:, 0] << 42 | shifted[:, 1] << 21 | shifted[:, 2])


def _unpack(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    mask = 2 * BLOCK_LIMIT - 1
    fields = np.stack([keys >> 42 & mask, keys >> 21 & mask, keys & mask], axis=1)
    return np.asarray(fields - BLOCK_LIMIT, np.int32)


def _as_mask(mask: ArrayLike) -> NDArray[np.bool_]:
    whole = np.asarray(mask)
    if whole.dtype != np.bool_:
        raise InvalidObservation(f"mask: expected bool, got {whole.dtype}")
    return whole


def _window(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """The rows and columns in which a mask (H, W) lies, and `margin` more on each side where the image has them."""
    at = []
    for axis in (1, 0):
        (there,) = np.nonzero(mask.any(axis=axis))
        low, high = (int(there[0]), int(there[-1]) + 1) if len(there) else (0, 0)
        at.append(slice(max(low - margin, 0), min(high + margin, mask.shape[1 - axis])))
    return at[0], at[1]


def _planes_of(planes: Sequence[Plane] | ArrayLike | None, pose: SE3) -> NDArray[np.float64]:
    """Planes as `find_on_planes` takes them (P, 14), in the frame of the camera that stands at `pose`."""
    if planes is None or (isinstance(planes, Sequence) and not planes):
        return _NO_PLANES
    if isinstance(planes, Sequence) and all(isinstance(plane, Plane) for plane in planes):
        bounded = [plane for plane in planes if isinstance(plane, Plane)]
        rows = np.array([[*plane.normal, plane.offset] for plane in bounded])
        axes = [[a for k in (0, 1) for a in (*p.box_axes[:, k], p.box_axes[:, k] @ p.box_center)] for p in bounded]
        rows = np.column_stack([rows, np.array(axes), [0.5 * plane.box_size[:2] for plane in bounded]])
    else:
        rows = np.asarray(planes, np.float64)
        if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
            raise InvalidParameter(f"planes: expected finite rows (P, 4), got shape {rows.shape}")
        rows = np.column_stack([rows, np.zeros((len(rows), 8)), np.full((len(rows), 2), np.inf)])
    if (np.abs(np.linalg.norm(rows[:, :3], axis=1) - 1.0) > 1e-3).any():
        raise InvalidParameter("planes: expected normals of unit length")
    turned = rows.copy()
    for at in (0, 4, 8):
        turned[:, at : at + 3] = rows[:, at : at + 3] @ pose.rotation
        turned[:, at + 3] -= rows[:, at : at + 3] @ pose.translation
    return read_only(turned)


def _choose(sums: Array) -> NDArray[np.bool_]:
    """Which components (K,) are the object: sums (K, 4) as `weigh_parts` gives them."""
    weight = sums[:, 0]
    chosen = np.zeros(len(weight), np.bool_)
    (there,) = np.nonzero(weight > 0.0)
    if len(there) == 0:
        return chosen
    weight = weight[there]
    depth = sums[there, 1] / weight
    spread = np.sqrt(np.maximum(sums[there, 2] / weight - depth**2, 0.0))
    large = weight >= FRONT_SHARE * weight.max()
    main = np.flatnonzero(large)[np.argmin(depth[large])]
    gap = np.where(sums[there, 3] > 0.0, PART_GAP_M, HOLE_GAP_M)
    chosen[there] = (weight >= PART_SHARE * weight[main]) & (np.abs(depth - depth[main]) <= 2.0 * spread[main] + gap)
    return chosen


def _space(
    size: float, points: Array, kept: Array, voxel_of: Array, keys: Array, counts: Array, votes: Array
) -> ObjectSpace:
    """The space of points in voxels `voxel_of` (N,) of ascending keys (K,), with the counts and votes (K,) of these."""
    (used,) = np.nonzero(counts)
    if len(used) < len(keys):
        renumber = np.zeros(len(keys), np.int32)
        renumber[used] = np.arange(len(used), dtype=np.int32)
        voxel_of, keys, counts, votes = renumber[voxel_of], keys[used], counts[used], votes[used]
    return ObjectSpace(
        voxel_size_m=size,
        points=points,
        kept=kept,
        voxel_ijk=_unpack(keys),
        voxel_of=voxel_of,
        counts=counts,
        votes=votes.astype(np.float32),
        other_ijk=np.empty((0, 3), np.int32),
        other_counts=np.empty(0, np.int64),
    )


def _one_size(spaces: Sequence[ObjectSpace], name: str) -> float:
    sizes = sorted({space.voxel_size_m for space in spaces})
    if len(sizes) != 1:
        raise InvalidParameter(f"{name}: expected at least one, and voxels of one size, got sizes {sizes}")
    return sizes[0]


def _upright(points: Array, up: Array, size: float) -> NDArray[np.float64]:
    """Columns (3, 3): the axes of a box about points (N, 3), the last one along `up`."""
    length = np.linalg.norm(up) if up.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise InvalidParameter(f"up: expected a direction (3,), got {up.tolist()}")
    z = up / length
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    ground = np.stack([x, np.cross(z, x)], axis=1)
    yaw = shapes.fit_rectangle(points @ ground, _UPRIGHT_POINTS, 0.5 * size)[4]
    along = ground @ np.array([np.cos(yaw), np.sin(yaw)])
    return np.stack([along, np.cross(z, along), z], axis=1)
