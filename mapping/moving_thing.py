"""One moving thing: a signed distance map in its own frame, and where that frame has been.

An image's piece of the thing is aligned to the model (frame to model, as KinectFusion aligns a camera to a room;
Newcombe et al. 2011) and fused there, as in MID-Fusion (Xu et al. 2019) and Fusion++ (McCormac et al. 2018). Where the
alignment cannot be trusted, the thing follows the middle of the piece and nothing is fused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.alignment import CLEARLY, Alignment, align
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import as_points
from mapping.kernels import columns, shapes
from mapping.motion import Motion, pose_of, pose_row
from mapping.observations import Box3d
from mapping.tsdf import TsdfMap
from mapping.view import DepthView

if TYPE_CHECKING:
    from mapping.mesh import Mesh

Array: TypeAlias = NDArray[Any]

MOST_POINTS = 1200
"""So many points of a piece are aligned."""
TURNED_RAD = 0.35
YAWS = np.deg2rad([0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0])
"""When the rotation is not known to within TURNED_RAD any more, these turns are tried, too."""
BEGIN_ANEW_AFTER = 6
"""A model that so many images in a row did not fit is given up and begun anew."""
MODEL_MEMORY = 20.0
"""Weight beyond which what was seen first gives way: what moves by itself changes its shape, too."""
BEHIND_M = 0.3
"""What lies farther behind the thing than this is free space to its model."""
MOST_POSES = 2048
"""When a trajectory has so many poses, every second one of its older half is dropped."""
NEAR_VOXELS = 2.0
MOST_UNSURE_M = 0.05
"""What lies within so many voxels of the model's surface, and the uncertainty of its pose up to this, is taken for the
thing even where it has no mask."""
LOOSE_SHARE = 0.01
"""Of the surface, so much may stick out of the box at either end of each of eight level directions."""
WHOLE_SHARE, WHOLE_M = 0.03, 0.02
PART_SHARE, PART_M = 0.15, 0.03
"""The middle of what is seen of a thing lies so near to where it lay in the last image [share of its size, m]: where
the whole of its outline is seen in both images, and where not. The former tells how a flat side slides along itself,
which no alignment of surfaces does; the latter, where a thing goes behind another, tells less than an alignment."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What one image shows of one thing.

    points     (n, 3) [m] in map; sigma (n,) [m] the noise of each
    center     (3,) [m] their mean;  size (3,) [m] their extent along the axes of map
    whole      whether nothing before it and no border of the image cuts its outline
    depth      (h, w) float32 [m] of the part of the image about it, 0 where that is not the thing and not far behind
    intrinsics of that part;  range_m: the thing ends before this distance from the camera
    """

    stamp_ns: int
    label: int
    pixels: int
    points: Array
    sigma: Array
    center: Array
    size: Array
    whole: bool
    depth: Array
    intrinsics: CameraIntrinsics
    range_m: float
    T_map_camera: SE3


class MovingThing:
    """A thing that moves by itself.

    id       lasting; never given again
    labels   class id → images that called it so
    views    images in which it was seen;  fused  those that its model was made of
    motion   pose and velocity when it was seen last
    """

    def __init__(self, thing_id: int, sight: Sight, voxel_size_m: float) -> None:
        self.id = thing_id
        self.first_seen_ns = sight.stamp_ns
        self.labels: dict[int, int] = {sight.label: 1}
        self.views = self.fused = 1
        self.size_m = float(np.linalg.norm(sight.size))
        self._misfits = 0
        self._voxel_size_m = voxel_size_m
        self.motion = Motion.at_rest(sight.stamp_ns, SE3(np.eye(3), sight.center), 0.25 * voxel_size_m)
        self._stamps, self._poses = [sight.stamp_ns], [pose_row(self.motion.pose)]
        self._center, self._whole = np.zeros(3), sight.whole  # of what was seen last, in the thing's frame
        self._box: tuple[int, Box3d] | None = None
        self.model = self._empty_model()
        self._fuse(sight)

    # -- what is known ------------------------------------------------------------------------------------
    @property
    def label(self) -> int:
        """The class id that most images gave (ties: the lowest id)."""
        return min(self.labels, key=lambda c: (-self.labels[c], c))

    @property
    def label_share(self) -> float:
        """The share of the images that gave that class."""
        return self.labels[self.label] / sum(self.labels.values())

    @property
    def last_seen_ns(self) -> int:
        return self.motion.stamp_ns

    @property
    def trajectory(self) -> tuple[NDArray[np.int64], list[SE3]]:
        """When (n,) and where the thing was seen: T_map_thing, in order of time; old ones are thinned out."""
        return np.array(self._stamps, np.int64), [pose_of(row) for row in self._poses]

    def motion_at(self, stamp_ns: int) -> Motion:
        """Pose and velocity as of a time, with their uncertainty.

        After the thing was seen last: foretold, ever less certain. Before: between the poses in which it was seen, with
        the mean velocity between these and the covariance of the last one; before the first, the first.
        """
        if stamp_ns >= self.last_seen_ns or len(self._stamps) == 1:
            return self.motion.at(stamp_ns)
        after = int(np.clip(np.searchsorted(self._stamps, stamp_ns, side="right"), 1, len(self._stamps) - 1))
        before, later = (pose_of(self._poses[n]) for n in (after - 1, after))
        since, until = self._stamps[after - 1], self._stamps[after]
        share = max(stamp_ns - since, 0) / max(until - since, 1)
        pose = before.interpolate(later, share)
        turned = before.rotation @ (before.inverse() @ later).log()[3:]
        velocity = np.concatenate([later.translation - before.translation, turned]) / (1e-9 * max(until - since, 1))
        return Motion(max(stamp_ns, self.first_seen_ns), pose, velocity, self.motion.covariance)

    def expected_center(self, motion: Motion) -> Array:
        """(3,) [m] where the middle of what is seen of it should lie in map."""
        return motion.pose @ self._center

    @property
    def box(self) -> Box3d:
        """The box about the model's surface in the thing's own frame; its z axis was upright when the thing was first
        seen."""
        if self._box is None or self._box[0] != self.model.revision:
            self._box = (self.model.revision, self._fit_box())
        return self._box[1]

    def box_at(self, stamp_ns: int) -> Box3d:
        """The box in map as of a time."""
        box, pose = self.box, self.motion_at(stamp_ns).pose
        placed = pose @ SE3.from_quaternion(box.rotation_wxyz, box.center)
        return Box3d(center=placed.translation, size=box.size, rotation_wxyz=placed.quaternion_wxyz)

    def surface(self) -> NDArray[np.float32]:
        """(N, 3) [m] points of the model's surface in the thing's frame, without what hangs loose beside it."""
        points = self.model.surface()[0]
        if not len(points):
            return points
        joined = columns.largest_cluster(points, np.ones(len(points), np.float32), 2.0 * self._voxel_size_m)
        return np.asarray(points[joined])

    def points_at(self, stamp_ns: int) -> NDArray[np.float32]:
        """(N, 3) [m] the surface in map as of a time."""
        return np.asarray(self.motion_at(stamp_ns).pose @ self.surface())

    def mesh_at(self, stamp_ns: int) -> Mesh:
        """The surface in map as of a time, as triangles."""
        pose = self.motion_at(stamp_ns).pose
        mesh = self.model.mesh()
        turn = pose.rotation.T.astype(np.float32)
        return replace(mesh, vertices=np.asarray(pose @ mesh.vertices), normals=mesh.normals @ turn)

    def holds(self, p_map: ArrayLike, stamp_ns: int) -> NDArray[np.bool_]:
        """Whether each point (N, 3) [m] lies in the thing as of a time: in its box, and not where its model is free."""
        p_thing = self.motion_at(stamp_ns).pose.inverse() @ as_points(p_map)
        margin = 0.5 * self._voxel_size_m
        inside = self._in_box(p_thing, margin)
        inside[inside] = ~(self.model.query(p_thing[inside]) > margin)
        return inside

    def _in_box(self, p_thing: Array, margin_m: float) -> NDArray[np.bool_]:
        p_box = SE3.from_quaternion(self.box.rotation_wxyz, self.box.center).inverse() @ p_thing
        inside: NDArray[np.bool_] = np.all(np.abs(p_box) <= 0.5 * self.box.size + margin_m, axis=1)
        return inside

    def covers(self, p_map: Array, stamp_ns: int) -> NDArray[np.bool_]:
        """Whether each point (N, 3) [m] lies on the thing's surface as of a time, or as near to it as its pose is
        uncertain."""
        motion = self.motion_at(stamp_ns)
        unsure = float(np.sqrt(motion.covariance[:3, :3].trace()))
        margin = NEAR_VOXELS * self._voxel_size_m + min(unsure, MOST_UNSURE_M)
        p_thing = motion.pose.inverse() @ p_map
        near = self._in_box(p_thing, margin)
        near[near] = np.abs(self.model.query(p_thing[near])) < margin
        return near

    # -- images -------------------------------------------------------------------------------------------
    def observe(self, sight: Sight) -> bool:
        """Take in a sight that is no older than the last one; returns whether it could be aligned to the model."""
        foretold = self.motion.at(sight.stamp_ns)
        whole = sight.whole and self._whole
        if whole:
            foretold = self._placed(sight, foretold, WHOLE_M + WHOLE_SHARE * self.size_m)
        alignment = self._align(sight, foretold)
        self.views += 1
        self.labels[sight.label] = self.labels.get(sight.label, 0) + 1
        if alignment.trusted:
            self.motion = _corrected(foretold, alignment)
            self._misfits = 0
            self._center, self._whole = self.motion.pose.inverse() @ sight.center, sight.whole
            self._fuse(sight)
            self.fused += 1
        else:
            self.motion = foretold if whole else self._placed(sight, foretold, PART_M + PART_SHARE * self.size_m)
            self._misfits += 1
            if self._misfits >= BEGIN_ANEW_AFTER:
                self._begin_anew(sight)
        self.size_m = max(self.size_m, float(np.linalg.norm(sight.size)))
        self._note()
        return alignment.trusted

    def _placed(self, sight: Sight, foretold: Motion, sigma_m: float) -> Motion:
        """The motion, knowing where the middle of what is seen lies, to within `sigma_m`."""
        return foretold.given_place(sight.center - self.expected_center(foretold), sigma_m)

    def _align(self, sight: Sight, foretold: Motion) -> Alignment:
        """How the sight lies on the model: beginning where the thing was foretold; where that leads nowhere, the best
        of those that begin where its middle was seen."""
        p_thing = foretold.pose.inverse() @ sight.points
        to_thing = np.kron(np.eye(2), foretold.pose.rotation.T)
        prior = to_thing @ foretold.covariance[:6, :6] @ to_thing.T
        up = foretold.pose.rotation.T @ (0.0, 0.0, 1.0)
        unsure = sight.whole and prior[3:, 3:].trace() > TURNED_RAD**2
        found = align(self.model, p_thing, sight.sigma, prior, [SE3.identity()])
        if found.trusted and not unsure:
            return found
        turns = [SE3.exp([0.0, 0.0, 0.0, *(yaw * up)]).rotation for yaw in (YAWS if unsure else YAWS[:1])]
        starts = [SE3(turn, self._center - turn @ p_thing.mean(axis=0)) for turn in turns]
        again = align(self.model, p_thing, sight.sigma, prior, starts)
        return again if (not again.trusted, again.cost) < (not found.trusted, CLEARLY * found.cost) else found

    def _fuse(self, sight: Sight) -> None:
        T_thing_camera = self.motion.pose.inverse() @ sight.T_map_camera
        view = DepthView(sight.depth, sight.intrinsics, T_thing_camera, sight.range_m)
        self.model.integrate_view(view)

    def _empty_model(self) -> TsdfMap:
        return TsdfMap(self._voxel_size_m, max_weight=MODEL_MEMORY, weighting="constant")

    def _begin_anew(self, sight: Sight) -> None:
        self.model, self._box, self._misfits = self._empty_model(), None, 0
        self._center, self._whole = self.motion.pose.inverse() @ sight.center, sight.whole
        self._fuse(sight)

    def _note(self) -> None:
        if self._stamps[-1] == self.motion.stamp_ns:  # two cameras at one time
            self._poses[-1] = pose_row(self.motion.pose)
            return
        self._stamps.append(self.motion.stamp_ns)
        self._poses.append(pose_row(self.motion.pose))
        if len(self._stamps) >= MOST_POSES:
            half = MOST_POSES // 2
            self._stamps = self._stamps[:half:2] + self._stamps[half:]
            self._poses = self._poses[:half:2] + self._poses[half:]

    def _fit_box(self) -> Box3d:
        points = self.surface().astype(np.float64)
        if len(points) < 4:
            return Box3d(center=self._center, size=np.full(3, max(self.size_m / np.sqrt(3.0), self._voxel_size_m)))
        points = points[columns.inner_part(points, np.ones(len(points)), LOOSE_SHARE, 8, 0.2 * self._voxel_size_m)]
        low, high = points[:, 2].min(), points[:, 2].max()
        x, y, length, width, yaw = shapes.fit_rectangle(points[:, :2].copy(), 400, self._voxel_size_m)
        size = np.maximum([length, width, high - low], self._voxel_size_m)
        return Box3d(
            center=np.array([x, y, 0.5 * (low + high)]), size=size,
            rotation_wxyz=np.array([np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]),
        )  # fmt: skip

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything that is known of the thing, as named arrays."""
        times = [self.first_seen_ns, self.last_seen_ns]
        counts = [self.id, *times, self.views, self.fused, self._misfits, self._whole]
        return {
            "counts": np.array(counts, np.int64),
            "labels": np.array(list(self.labels.items()), np.int64).reshape(-1, 2),
            "stamps": np.array(self._stamps, np.int64),
            "poses": np.array(self._poses, np.float64).reshape(-1, 12),
            "motion": np.concatenate([[self.size_m], self._center, self.motion.row()]),
            **{f"model.{name}": array for name, array in self.model.state().items()},
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> MovingThing:
        """What `state` gave."""
        thing = cls.__new__(cls)
        counts = state["counts"].tolist()
        thing.id, thing.first_seen_ns, last, thing.views, thing.fused, thing._misfits, whole = counts
        thing._whole = bool(whole)
        thing.labels = dict(state["labels"].tolist())
        thing._stamps, thing._poses = state["stamps"].tolist(), list(np.array(state["poses"], np.float64))
        numbers = np.asarray(state["motion"], np.float64)
        thing.size_m, thing._center = float(numbers[0]), numbers[1:4].copy()
        thing.motion = Motion.from_row(last, numbers[4:])
        prefix = "model."
        thing.model = TsdfMap.from_state({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
        thing._voxel_size_m, thing._box = thing.model.voxel_size_m, None
        return thing


def _corrected(foretold: Motion, alignment: Alignment) -> Motion:
    """The motion, knowing how what was seen lies on the model: the thing is where the model has to go."""
    turn = -np.kron(np.eye(2), foretold.pose.rotation)
    corrected = foretold.given_pose(turn @ alignment.offset, turn @ alignment.covariance @ turn.T)
    pose = foretold.pose @ SE3.exp(-alignment.offset)
    return replace(corrected, pose=pose)
