"""Things that move by themselves, each a model of its own beside the static map.

The third of the policies for dynamic scenes in the SLAM Handbook (chapter on dense maps, section 5.5.1): what moves is
neither fused into the map nor thrown away. The masks of its classes are cut into pieces, pieces are joined to known
things by class, size and the place where each is foretold, and every thing keeps a signed distance map in its own frame
and the trajectory of that frame (`mapping.moving_thing`).

What it does not do: know again a thing that was away for longer than GONE_AFTER_S or comes out far from where it was
foretold (it gets a new id); part things whose masks touch and have no instance ids; bend (a model is rigid and forgets
its older shape; what it does not fit is followed by its middle and not fused). A thing costs some 10 ms an image
that it is seen in.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation
from scipy.optimize import linear_sum_assignment

from mapping.errors import MappingError
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import as_points
from mapping.layer import require
from mapping.moving_thing import BEHIND_M, MOST_POINTS, MovingThing, Sight
from mapping.observations import Box3d, RgbdImage
from mapping.segmentation import segment

Array: TypeAlias = NDArray[Any]

MARGIN_PX = 16
"""Of an image, the part about moving things is looked at, and so many pixels beside it."""
LEAST_PIXELS = 100
"""A smaller piece does not tell where a thing is."""
PLACE_SIGMA_M = 0.10
GATE, MOST_OFF_M = 4.0, 2.0
"""A piece may be a thing when it lies within so many standard deviations of where the thing's middle is foretold, of
which PLACE_SIGMA_M is what the view changes, and no farther from there than this."""
OTHER_CLASS = 4.0
SIZE_SIGMA = 0.4
MOST_FOR_SIZE = 4.0
"""Beside the squared distance there speaks against a match that the class is another, and that the size (its logarithm)
is; the latter up to a limit, as what is seen of a thing changes."""
RIM_PX = 4
HIDDEN_M = 0.05
HIDDEN_SHARE = 0.05
"""A thing's outline is cut when more than this share of what lies within RIM_PX of it is nearer than it by HIDDEN_M, or
beyond the image."""
FORETOLD_S = 0.5
FORETOLD_STEP = 2
"""A thing that was seen within this time is looked for even where it has no mask, in every so many-th row and
column."""
CONFIRMED_VIEWS = 3
"""What was seen in fewer images may be a slip of the segmenter: it is not told of, and forgotten after SLIP_S."""
SLIP_S = 1.0
GONE_AFTER_S = 10.0
"""A thing that was not seen for so long is kept with its last pose, but what is seen then is another thing."""
MOST_GONE = 64
"""So many things that are gone are kept; the one that was seen longest ago goes first."""


@dataclass(frozen=True)
class MovingChange:
    """Moving things that one image showed or that are gone since, and those that are forgotten for good."""

    touched: frozenset[int] = frozenset()
    forgotten: frozenset[int] = frozenset()


class MovingThings:
    """The moving things of a world.

    voxel_size_m  edge of the voxels of their models [m]

    The newest image counts: images that are older than one that was taken in before are not used.
    """

    kind: ClassVar[str] = "moving"

    def __init__(self, *, voxel_size_m: float) -> None:
        self.voxel_size_m = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.stamp_ns = 0
        self._things: dict[int, MovingThing] = {}
        self._next_id = 1

    # -- what is known ------------------------------------------------------------------------------------
    @property
    def things(self) -> dict[int, MovingThing]:
        """All that were seen in enough images, by id: those about and those that are gone."""
        return {i: thing for i, thing in self._things.items() if thing.views >= CONFIRMED_VIEWS}

    def about(self, at_ns: int | None = None) -> dict[int, MovingThing]:
        """Those that were seen by a time (default: that of the newest image) and not long before it."""
        now = self.stamp_ns if at_ns is None else at_ns
        return {i: thing for i, thing in self.things.items() if thing.first_seen_ns <= now and not _gone(thing, now)}

    def query(self, p_map: ArrayLike, at_ns: int | None = None) -> NDArray[np.int64]:
        """The id (N,) of the moving thing at each point (N, 3) [m] as of a time (default: that of the newest image),
        where its model's box is and the model is not free; 0 where there is none. Of several, the smallest."""
        points = as_points(p_map)
        ids = np.zeros(len(points), np.int64)
        now = self.stamp_ns if at_ns is None else at_ns
        for thing in sorted(self.about(now).values(), key=lambda t: (-float(t.box.size.prod()), t.id)):
            ids[thing.holds(points, now)] = thing.id
        return ids

    @property
    def memory_bytes(self) -> int:
        """Bytes of all models."""
        return sum(thing.model.memory_bytes for thing in self._things.values())

    # -- images -------------------------------------------------------------------------------------------
    def integrate_image(self, image: RgbdImage, depth_m: Array, T_map_camera: SE3, moving: Array) -> MovingChange:
        """Follow the things of the classes `moving` (65536,) bool that an image shows.

        depth_m  (H, W) float32 [m], 0 where not measured or not to be believed
        """
        if image.stamp_ns < self.stamp_ns or image.labels is None:
            return MovingChange()
        sights = list(_sights(image, depth_m, T_map_camera, moving))
        if not sights:
            return MovingChange()
        before = {i for i, thing in self.things.items() if not _gone(thing, self.stamp_ns)}
        self.stamp_ns = image.stamp_ns
        known = [thing for thing in self._things.values() if not _gone(thing, self.stamp_ns)]
        touched = {i for i in before if _gone(self._things[i], self.stamp_ns)}
        left = dict(enumerate(sights))
        for row, column in _matches(sights, known):
            known[column].observe(left.pop(row))
            touched.add(known[column].id)
        for sight in left.values():
            if not any(thing.holds(sight.center[None], self.stamp_ns)[0] for thing in known):
                thing = MovingThing(self._next_id, sight, self.voxel_size_m)
                self._things[thing.id] = thing
                self._next_id += 1
        return MovingChange(frozenset(touched & self.things.keys()), frozenset(self._forget()))

    def foretold(self, image: RgbdImage, T_map_camera: SE3) -> Array | None:
        """(H, W) bool: the pixels on things that were seen lately, where each is foretold, whether an image has masks
        of them or not; None where there are none."""
        lately = [
            thing
            for thing in self.things.values()
            if abs(image.stamp_ns - thing.last_seen_ns) <= 1e9 * FORETOLD_S and thing.first_seen_ns <= image.stamp_ns
        ]
        if not lately:
            return None
        mask = np.zeros(image.depth.shape, np.bool_)
        for thing in lately:
            part = _window(thing.box_at(image.stamp_ns), image.intrinsics, T_map_camera)
            if part is None:
                continue
            rows, columns = (slice(s.start, s.stop, FORETOLD_STEP) for s in part)
            depth = image.depth_m[rows, columns]
            points = (image.intrinsics.rays(rows, columns) * depth[..., None])[depth > 0.0]
            hit = np.zeros(depth.shape, np.bool_)
            hit[depth > 0.0] = thing.covers((T_map_camera @ points).astype(np.float64), image.stamp_ns)
            mask[part] |= np.kron(hit, np.ones((FORETOLD_STEP,) * 2, np.bool_))[
                : mask[part].shape[0], : mask[part].shape[1]
            ]
        return mask

    def _forget(self) -> set[int]:
        """Forget slips of the segmenter and, of those that are gone, the oldest above the limit; returns the ids."""
        slips = {
            i
            for i, thing in self._things.items()
            if thing.views < CONFIRMED_VIEWS and self.stamp_ns - thing.last_seen_ns > 1e9 * SLIP_S
        }
        gone = [thing for thing in self.things.values() if _gone(thing, self.stamp_ns)]
        gone.sort(key=lambda thing: (thing.last_seen_ns, thing.id))
        oldest = {thing.id for thing in gone[: max(len(gone) - MOST_GONE, 0)]}
        for thing_id in slips | oldest:
            del self._things[thing_id]
        return oldest

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything that is known, as named arrays."""
        things = {
            f"{thing_id}/{name}": array
            for thing_id, thing in self._things.items()
            for name, array in thing.state().items()
        }
        return {
            "kind": np.array(self.kind),
            "voxel_size_m": np.array(self.voxel_size_m),
            "counts": np.array([self.stamp_ns, self._next_id], np.int64),
            "ids": np.array(list(self._things), np.int64),
            **things,
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> MovingThings:
        """What `state` gave. Raises `MappingError` where it is something else."""
        if str(state.get("kind", "")) != cls.kind:
            raise MappingError(f"expected saved moving things, got {str(state.get('kind', 'something else'))!r}")
        moving = cls(voxel_size_m=float(state["voxel_size_m"]))
        moving.stamp_ns, moving._next_id = state["counts"].tolist()
        for thing_id in state["ids"].tolist():
            prefix = f"{thing_id}/"
            own = {name.removeprefix(prefix): array for name, array in state.items() if name.startswith(prefix)}
            moving._things[thing_id] = MovingThing.from_state(own)
        return moving


def _gone(thing: MovingThing, now_ns: int) -> bool:
    return now_ns - thing.last_seen_ns > 1e9 * GONE_AFTER_S


def _matches(sights: list[Sight], known: list[MovingThing]) -> list[tuple[int, int]]:
    """Which sight is which thing, one to one, so that as many as can be are and then the least speaks against it."""
    if not known:
        return []
    impossible = 1e6
    cost = np.full((len(sights), len(known)), impossible)
    for column, thing in enumerate(known):
        foretold = thing.motion.at(sights[0].stamp_ns)
        trust = np.linalg.inv(foretold.covariance[:3, :3] + PLACE_SIGMA_M**2 * np.eye(3))
        center = thing.expected_center(foretold)
        for row, sight in enumerate(sights):
            off = sight.center - center
            squares = float(off @ trust @ off)
            if squares > GATE**2 or off @ off > MOST_OFF_M**2:
                continue
            sizes = np.log(np.linalg.norm(sight.size) / thing.size_m) / SIZE_SIGMA
            other = 0.0 if sight.label == thing.label else OTHER_CLASS
            cost[row, column] = squares + other + min(sizes**2, MOST_FOR_SIZE)
    rows, columns = linear_sum_assignment(cost)
    return [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if cost[r, c] < impossible]


def _sights(image: RgbdImage, depth_m: Array, T_map_camera: SE3, moving: Array) -> Iterator[Sight]:
    """The pieces of moving things that an image shows, cut out of the part of it that they lie in."""
    assert image.labels is not None
    part = _about(moving[image.labels], MARGIN_PX)
    if part is None:
        return
    cut, depth = _cut(image, part), np.ascontiguousarray(depth_m[part])
    seen = segment(cut, depth, moving)
    rays = cut.intrinsics.rays()
    reach = depth * np.linalg.norm(rays, axis=2)
    for number in (np.flatnonzero(moving[seen.label] & (seen.pixels >= LEAST_PIXELS)) + 1).tolist():
        own = (seen.pieces == number) & (depth > 0.0)
        pixels = np.flatnonzero(own)
        if len(pixels) < LEAST_PIXELS:
            continue
        some = pixels[:: -(-len(pixels) // MOST_POINTS)]
        z = depth.ravel()[some].astype(np.float64)
        points = T_map_camera @ (rays.reshape(-1, 3)[some] * z[:, None])
        range_m = float(reach[own].max()) + BEHIND_M
        window = _about(own, MARGIN_PX)
        assert window is not None
        shown = np.where(own | (reach > range_m), depth, np.float32(0.0))[window]
        yield Sight(
            stamp_ns=image.stamp_ns,
            label=int(seen.label[number - 1]),
            pixels=len(pixels),
            points=np.ascontiguousarray(points),
            sigma=0.004 + 0.002 * z**2,
            center=points.mean(axis=0),
            size=np.maximum(np.subtract(*np.percentile(points, (98, 2), axis=0)), 1e-3),
            whole=_is_whole(own, depth),
            depth=np.ascontiguousarray(shown),
            intrinsics=_window_of(cut.intrinsics, window),
            range_m=range_m,
            T_map_camera=T_map_camera,
        )


def _window(box: Box3d, camera: CameraIntrinsics, T_map_camera: SE3) -> tuple[slice, slice] | None:
    """The rows and columns of an image in which a box in map may be seen; None where there are none."""
    corners = 0.5 * box.size * np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    T_camera_box = T_map_camera.inverse() @ SE3.from_quaternion(box.rotation_wxyz, box.center)
    pixels, z = camera.project(T_camera_box @ corners)
    if not (z > 0.0).any():
        return None
    whole = np.array([[0.0, 0.0], [camera.width, camera.height]])
    around = np.concatenate([pixels.min(axis=0) - MARGIN_PX, pixels.max(axis=0) + MARGIN_PX]).reshape(2, 2)
    low, high = np.clip(around if (z > 0.0).all() else whole, whole[0], whole[1]).astype(int).tolist()
    return (slice(low[1], high[1]), slice(low[0], high[0])) if low[0] < high[0] and low[1] < high[1] else None


def _is_whole(own: Array, depth: Array) -> bool:
    """Whether the outline of a piece (H, W) bool is seen: not cut by what is nearer, nor by the image's border."""
    padded = np.pad(own, RIM_PX)
    rim = binary_dilation(padded, iterations=RIM_PX) & ~padded
    inside = rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX]
    nearer = inside & (depth > 0.0) & (depth < depth[own].min() - HIDDEN_M)
    beyond = int(rim.sum()) - int(inside.sum())
    return bool(nearer.sum() + beyond <= HIDDEN_SHARE * rim.sum())


def _about(mask: Array, margin: int) -> tuple[slice, slice] | None:
    """The rows and columns of an image about the pixels of a mask (H, W); None where there are none."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + margin + 1),
    )


def _cut(image: RgbdImage, part: tuple[slice, slice]) -> RgbdImage:
    """The labels and masks of a part of an image."""
    of_part = {
        name: None if value is None else np.ascontiguousarray(value[part])
        for name, value in (
            ("labels", image.labels), ("instances", image.instances), ("label_confidence", image.label_confidence)
        )
    }  # fmt: skip
    cut = {**of_part, "depth": image.depth[part], "intrinsics": _window_of(image.intrinsics, part)}
    cut |= {"color": None, "color_intrinsics": None, "T_depth_color": None}
    return image.model_copy(update=cut)


def _window_of(camera: CameraIntrinsics, part: tuple[slice, slice]) -> CameraIntrinsics:
    """The camera of a part of its image."""
    rows, columns = part
    height = min(rows.stop, camera.height) - rows.start
    width = min(columns.stop, camera.width) - columns.start
    cx, cy = camera.cx - columns.start, camera.cy - rows.start
    return camera.model_copy(update={"cx": cx, "cy": cy, "width": width, "height": height})
