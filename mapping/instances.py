"""Instances that last: the masks of single images, joined over views by their overlap in space.

After Voxblox++ (Grinvald et al. 2019): every fine voxel votes for the instance it belongs to; a mask is an instance
that it overlaps (see `mapping.association`), or a new one. Two instances that are seen through one mask again and again
are merged; one that is looked at again and has no mask is given up.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.association import Overlaps, apart, assign, covered, doubted
from mapping.colors import CELLS, likeness, no_colors, piece_colors
from mapping.errors import MappingError
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import ijk_to_centre, read_only
from mapping.kernels import evidence
from mapping.kernels import instances as kernels
from mapping.kernels.instances import BACKGROUND
from mapping.layer import require
from mapping.packed import PackedLayer, PackedStore
from mapping.segmentation import Segmentation
from mapping.semantics import camera_row, pose_rows

Array: TypeAlias = NDArray[Any]

FULL_VIEW_PIXELS = 400.0
"""A mask of so many pixels is a whole vote for the class of its instance, times what the segmenter is sure of it."""
FOUNDING_PIXELS = 100
"""A mask that is no known instance founds one when it has this many pixels."""
CONFIRMED_VIEWS = 2
"""Voxels tell of an instance that was seen in so many images; what was seen once may be a slip of the segmenter."""
SLIP_S = 300.0
"""What was seen no more often, and that so long ago, tells nothing of what is seen there now."""
STRANGERS = 3
"""So many more masks of other things, classes or colours than of its own, that long after it was seen last: something
else is in its place."""
OWN_AGAIN = 2
"""So many more of its own: it is still there."""
DISPLACED_SHARE = 0.5
"""A mask may take the place of an instance when it holds so much of what is visible of it."""
OTHER_COLORS = 0.6
"""Colours less alike than this are not those of one thing: of 930 masks of three simulated homes, 1 % were less like
their own instance, and two thirds of those of other colours less like one of its class."""
DOUBTS_A_VIEW = 1
"""An instance is given up when there were more than so many images for each view of it in which it was looked at and
not seen."""
MERGE_VIEWS = 2
MERGE_VIEWS_OTHER_CLASS = 3
"""One mask covers two instances in so many views, net of views in which both had masks of their own: they are one. Of
two classes it must cover the other as often as that had a mask of its own: a book is no part of a shelf when its mask
is missing now and then."""
APART_VIEWS = 5
"""No more such views than these are held against two instances being one."""
SPLIT_VIEWS = 3
"""A second mask lies on an instance in so many images: from then on what is under such masks leaves it."""
MEAN_MEMORY = 8.0
"""Votes (about: full views) over which a voxel's mean point is taken."""
LEAST_WEIGHT = 0.01
LEAST_SHARE = 0.5
"""A voxel is part of an instance that holds this many votes (about: full views) and this share of all its votes. Where
a thing touches another, only rims were ever seen, which count little."""
FADED_WEIGHT = 0.01
"""A voxel that holds less than this as it fades is forgotten."""
COUNTERS = 2
"""Instances that a voxel counts votes for, one by one."""
SPARSE_RANGE_M = 5.0
"""Every other row and column of an image is enough where that leaves a pixel a voxel at this distance."""


@dataclass
class Instance:
    """What is known of one instance besides its voxels.

    id      lasting; never given again
    views   images in which it had a mask;  doubts  those in which it was looked at and had none
    number  by which its voxels know it; given to another when it has gone
    splits  images in which a second mask lay on it
    own_ns  when it was known to be there last;  strangers  long after: by how many there were more masks of other
            things, classes or colours in its place than of its own
    labels  class id → votes (about: full views)
    slots   blocks in which it may have voxels
    colors  (CELLS,) what its masks showed, see `mapping.colors`, each worth what its vote for the class is
    """

    id: int
    first_seen_ns: int
    last_seen_ns: int
    views: int = 0
    doubts: int = 0
    number: int = 0
    splits: int = 0
    own_ns: int = 0
    strangers: int = 0
    labels: dict[int, float] = field(default_factory=dict)
    slots: set[int] = field(default_factory=set)
    colors: NDArray[np.float32] = field(default_factory=no_colors, compare=False)

    @property
    def label(self) -> int:
        """The class id with most votes (ties: the lowest id)."""
        return min(self.labels, key=lambda c: (-self.labels[c], c))

    @property
    def label_share(self) -> float:
        return self.labels[self.label] / sum(self.labels.values())


@dataclass(frozen=True, eq=False)
class Masks:
    """Whose the pixels of an image are.

    pieces   (H, W) int32: 1 … n on masks, 0 elsewhere
    labels   (H, W) uint16: class ids of pixels to be believed, 0 elsewhere
    instance (n + 1,) the instance that each mask is, 0 for none; the first is 0
    color    (H, W, 3) uint8, None where the image had none
    """

    pieces: Array
    labels: Array
    instance: Array
    color: Array | None = None


@dataclass(frozen=True)
class InstanceChange:
    """Instances that got or lost voxels, and those that were merged: lost id → kept id.

    A touched instance that the map does not know any more has been given up. `split`: instance → the one that it was
    part of. `masks`: of the image that brought the change, where it had any.
    """

    touched: frozenset[int]
    merged: dict[int, int]
    split: dict[int, int] = field(default_factory=dict)
    masks: Masks | None = None


class InstanceMap(PackedLayer):
    """Votes of fine voxels for instances, with the mean of the points that fell into each.

    voxel_size_m  edge of a voxel [m]
    memory        votes [full views] beyond which what a voxel holds counts half, ≤ 254
    """

    kind = "instances"

    def __init__(self, *, voxel_size_m: float, memory: float = 50.0) -> None:
        self.memory = require("memory", memory, 0.0, evidence.MOST)
        self.store = PackedStore({"evidence": ("u2", 2 * COUNTERS + 1), "mean": ("i2", 3)}, voxel_size_m)
        self.instances: dict[int, Instance] = {}
        self._next_id = 1
        self._together: defaultdict[tuple[int, int], int] = defaultdict(int)
        self._id_of = np.zeros(BACKGROUND + 1, np.int64)  # of each number, 0 where it is free
        self._class_of = np.zeros(BACKGROUND + 1, np.uint16)  # of each number; 0 for none, and what was seen once
        self._sizes = np.zeros(BACKGROUND + 1, np.int64)  # voxels in which each number leads
        self._unsure: set[int] = set()  # not confirmed, or doubted since they were last looked at

    def parameters(self) -> dict[str, Any]:
        return {"voxel_size_m": self.voxel_size_m, "memory": self.memory}

    def integrate_image(
        self,
        seen: Segmentation,
        depth_m: Array,
        intrinsics: CameraIntrinsics,
        T_map_camera: SE3,
        stamp_ns: int,
        weights: Array | None = None,
        color: Array | None = None,
    ) -> InstanceChange:
        """Join the pieces of one image to lasting instances and count their votes.

        depth_m (H, W) float32 [m]; weights (H, W) float32: what `seen.weights` gave for it, if that is there already
        color   (H, W, 3) uint8
        """
        store = self.store
        cells, owners, pixels, votes, offsets, blocks, bare = kernels.trace(
            store.table, store.masks, store.n_blocks, seen.pieces, seen.labels,
            seen.weights(depth_m, self.voxel_size_m) if weights is None else weights, depth_m,
            camera_row(intrinsics), pose_rows(T_map_camera), self.voxel_size_m, self._step(intrinsics),
        )  # fmt: skip
        store.allocate(blocks)
        store.add(bare)
        colors = piece_colors(seen.pieces, seen.trust, len(seen), color)
        overlaps = self._overlaps(seen, colors, cells, owners, pixels, offsets, T_map_camera)
        ids = assign(overlaps)
        together = self._compare(overlaps, ids, stamp_ns)
        self._found(ids, seen.pixels)
        for piece, instance_id in enumerate(ids.tolist()):
            if instance_id:
                worth = min(1.0, float(seen.pixels[piece]) / FULL_VIEW_PIXELS) * float(seen.confidence[piece])
                self._witness(instance_id, int(seen.label[piece]), worth, colors[piece], stamp_ns)
        touched = self._displace(overlaps, ids, cells, owners, stamp_ns)
        numbers = [BACKGROUND, *(self.instances[i].number if i else 0 for i in ids.tolist()), 0]
        touched |= self._vote(cells, np.array(numbers, np.uint16)[owners], votes, offsets)  # owner −1 is the last
        split = self._split(apart(overlaps, ids), ids, cells, np.where(votes > 0, owners, -1))
        merged = self._merge(together)
        touched |= {*merged.values(), *split.values(), *self._give_up()}
        ids = np.array([0, *(merged.get(i, i) for i in ids.tolist())])
        return InstanceChange(frozenset(touched), merged, split, Masks(seen.pieces, seen.labels, ids, color))

    def _step(self, intrinsics: CameraIntrinsics) -> int:
        return 2 if self.voxel_size_m * min(intrinsics.fx, intrinsics.fy) >= 2.0 * SPARSE_RANGE_M else 1

    def _vote(self, cells: Array, choices: Array, votes: Array, offsets: Array) -> set[int]:
        """Count votes of runs of pixels for numbers (K,); returns the instances that got or lost voxels."""
        store = self.store
        self.revision += 1
        lost = np.zeros(BACKGROUND + 1, np.bool_)
        pairs = kernels.vote(
            store.masks, store.first, store.fields["evidence"], store.fields["mean"], self._sizes, lost,
            store.changed_at, self.revision, cells, choices, votes, offsets, int(self.memory * evidence.UNIT),
            int(MEAN_MEMORY * evidence.UNIT),
        )  # fmt: skip
        packed = np.unique(pairs[:, 0] << 32 | pairs[:, 1])
        numbers, first = np.unique(packed >> 32, return_index=True)
        for number, slots in zip(numbers.tolist(), np.split(packed & 0xFFFFFFFF, first[1:]), strict=False):
            self.instances[int(self._id_of[number])].slots.update(slots.tolist())
        lost[numbers] = True
        return self._known(lost)

    def _known(self, lost: Array) -> set[int]:
        """The ids of the instances whose numbers are marked (65536,)."""
        return set(self._id_of[np.flatnonzero(lost[:BACKGROUND])].tolist()) - {0}

    # -- association --------------------------------------------------------------------------------------
    def _overlaps(
        self, seen: Segmentation, colors: Array, cells: Array, owners: Array, pixels: Array, offsets: Array,
        T_map_camera: SE3,
    ) -> Overlaps:  # fmt: skip
        store = self.store
        eye = np.asarray(T_map_camera.translation, np.float64) / self.voxel_size_m
        piece, number, hits, looked = kernels.count_overlaps(
            store.table, store.masks, store.first, store.fields["evidence"], read_only(self.block_ijk), cells, owners,
            pixels, offsets, eye, len(seen),
        )  # fmt: skip
        visible = np.bincount(number, hits, minlength=BACKGROUND + 1)
        real = (number != BACKGROUND) & (piece > 0)
        piece, number, hits = piece[real] - 1, number[real], hits[real]
        instance = self._id_of[number]
        known = [self.instances[i] for i in instance.tolist()]
        label = np.array([i.label for i in known], np.int64)
        theirs = np.array([i.colors for i in known], np.float32).reshape(-1, CELLS)
        alike = likeness(colors[piece], theirs)
        return Overlaps(piece, instance, hits, looked[1:], visible[number], label == seen.label[piece], alike)

    def _compare(self, overlaps: Overlaps, ids: Array, stamp_ns: int) -> list[tuple[int, int]]:
        """Note what an image tells of pairs of instances and of those without a mask; returns pairs that may be one."""
        label_of = {i: self.instances[i].label for i in ids[ids > 0].tolist()}
        for pair in combinations(sorted(label_of), 2):  # two masks in one image: two things
            if pair in self._together or label_of[pair[0]] == label_of[pair[1]]:
                self._together[pair] = max(self._together[pair] - 1, -APART_VIEWS)
        for instance_id in doubted(overlaps, ids):
            self.instances[instance_id].doubts += 1
            self.instances[instance_id].strangers += stamp_ns - self.instances[instance_id].own_ns > SLIP_S * 1e9
            self._unsure.add(instance_id)
        return covered(overlaps, ids)

    def _found(self, ids: Array, pixels: Array) -> None:
        """Give new ids to masks that are large enough and no known instance, in place."""
        for piece in np.flatnonzero((ids == 0) & (pixels >= FOUNDING_PIXELS)).tolist():
            ids[piece] = self._next_id
            self._next_id += 1

    def _witness(self, instance_id: int, label: int, worth: float, colors: Array, stamp_ns: int) -> None:
        known = self.instances.get(instance_id)
        if known is None:
            known = self._begin(Instance(instance_id, stamp_ns, stamp_ns, number=self._free_number(), own_ns=stamp_ns))
        if known.views <= CONFIRMED_VIEWS and stamp_ns - known.last_seen_ns > SLIP_S * 1e9:
            known.views = known.doubts = known.strangers = 0
            known.first_seen_ns = known.own_ns = stamp_ns
            known.labels, known.colors = {}, no_colors()
        known.views += 1
        known.labels[label] = known.labels.get(label, 0.0) + worth
        self._classify(known)
        certain = stamp_ns - known.own_ns <= SLIP_S * 1e9
        if label == known.label and (certain or not _other_colors(known.colors, colors)):
            known.last_seen_ns = max(known.last_seen_ns, stamp_ns)
            known.colors += worth * colors
            known.strangers -= 1
            if certain or known.strangers <= -OWN_AGAIN:
                known.own_ns, known.strangers = max(known.own_ns, stamp_ns), 0
        elif not certain:
            known.strangers += 1
            self._unsure.add(instance_id)

    def _begin(self, instance: Instance) -> Instance:
        self.instances[instance.id] = instance
        self._id_of[instance.number] = instance.id
        self._unsure.add(instance.id)
        return instance

    def _classify(self, instance: Instance) -> None:
        """Note the class of an instance that was seen more than once."""
        self._class_of[instance.number] = instance.label if instance.views >= CONFIRMED_VIEWS else 0

    def _free_number(self) -> int:
        free = np.flatnonzero(self._id_of[1:BACKGROUND] == 0)
        if not len(free):
            raise MappingError(f"an instance map holds {BACKGROUND - 1} instances at most")
        return int(free[0]) + 1

    def _merge(self, together: list[tuple[int, int]]) -> dict[int, int]:
        """Join pairs of an instance with a mask and one that it covers; returns lost id → kept id."""
        merged: dict[int, int] = {}
        for one, other in together:
            pair = (min(one, other), max(one, other))
            self._together[pair] += 1
            if pair[0] not in self.instances or pair[1] not in self.instances or self.replaced(*pair):
                continue
            same = self.instances[one].label == self.instances[other].label
            own_views = self.instances[other].views
            if self._together[pair] >= (MERGE_VIEWS if same else max(MERGE_VIEWS_OTHER_CLASS, own_views)):
                self._absorb(*pair)
                merged[pair[1]] = pair[0]
        return merged

    def _displace(self, overlaps: Overlaps, ids: Array, cells: Array, owners: Array, stamp_ns: int) -> set[int]:
        """Take from instances that were not seen for long what lies under masks of other things of other colours that
        hide most of them; returns the ids."""
        other = (overlaps.alike < OTHER_COLORS) & (ids[overlaps.piece] != overlaps.instance)
        other &= overlaps.of_instance >= DISPLACED_SHARE
        lost = set[int]()
        for piece, instance_id in zip(overlaps.piece[other].tolist(), overlaps.instance[other].tolist(), strict=True):
            old = self.instances[instance_id]
            if ids[piece] and stamp_ns - old.own_ns > SLIP_S * 1e9:
                rows = self._known_rows(cells[owners == piece + 1])
                kernels.rename(self.store.fields["evidence"], rows, self._sizes, old.number, 0)
                lost.add(instance_id)
        return lost

    def _split(self, pairs: list[tuple[int, int]], ids: Array, cells: Array, owners: Array) -> dict[int, int]:
        """Give what masks, by index, hold of instances that are seen elsewhere in the image to their own instances,
        where that was seen before; returns new id → the one that it was part of.

        owners : the piece of each run of pixels; −1 for none, and where the mask is not to be trusted
        """
        for instance_id in {whole for _, whole in pairs}:
            self.instances[instance_id].splits += 1
        split: dict[int, int] = {}
        for piece, instance_id in pairs:
            whole, part = self.instances[instance_id], self.instances[int(ids[piece])]
            if whole.splits >= SPLIT_VIEWS:
                mine = cells[owners == piece + 1]
                kernels.rename(
                    self.store.fields["evidence"], self._known_rows(mine), self._sizes, whole.number, part.number
                )
                part.slots.update(np.unique(mine >> 9).tolist())
                split[part.id] = whole.id
        return split

    def _give_up(self) -> set[int]:
        """Take back what is more doubted than seen, has another thing in its place, or has no voxels and was never
        confirmed; returns the ids."""
        unsure = [self.instances[i] for i in sorted(self._unsure) if i in self.instances]
        gone = [
            i
            for i in unsure
            if i.doubts > DOUBTS_A_VIEW * i.views
            or i.strangers >= STRANGERS
            or (i.views < CONFIRMED_VIEWS and self._sizes[i.number] == 0)
        ]
        self._unsure = {i.id for i in unsure if i.views < CONFIRMED_VIEWS}
        for instance in gone:
            self._end(instance, 0)
        return {instance.id for instance in gone}

    def _end(self, instance: Instance, heir: int) -> None:
        """Give the votes for an instance to another number, 0 for none."""
        kernels.rename(self.store.fields["evidence"], self._rows(instance)[1], self._sizes, instance.number, heir)
        del self.instances[instance.id]
        self._id_of[instance.number] = self._class_of[instance.number] = 0
        for pair in [p for p in self._together if instance.id in p]:
            del self._together[pair]

    def _absorb(self, kept: int, lost: int) -> None:
        a, b = self.instances[kept], self.instances[lost]
        self._end(b, a.number)
        a.slots |= b.slots
        a.first_seen_ns, a.last_seen_ns = min(a.first_seen_ns, b.first_seen_ns), max(a.last_seen_ns, b.last_seen_ns)
        a.views += b.views
        a.own_ns = max(a.own_ns, b.own_ns)
        a.colors += b.colors
        for label, votes in b.labels.items():
            a.labels[label] = a.labels.get(label, 0.0) + votes
        self._classify(a)

    # -- as told ------------------------------------------------------------------------------------------
    def join(self, kept: int, lost: int) -> InstanceChange:
        """Make two instances one, as told."""
        self._absorb(kept, lost)
        return InstanceChange(frozenset({kept}), {lost: kept})

    def were_apart(self, one: int, other: int) -> bool:
        """Whether images showed two instances with a mask each more often than both under one mask."""
        return self._together.get((min(one, other), max(one, other)), 0) < 0

    def replaced(self, one: int, other: int) -> int:
        """Which of two instances in one place has gone, 0 for none: the one that was not seen since long before the
        other came, where their colours are not those of one thing."""
        old, new = sorted((self.instances[one], self.instances[other]), key=lambda i: i.own_ns)
        exchanged = new.first_seen_ns - old.own_ns > SLIP_S * 1e9 and _other_colors(old.colors, new.colors)
        return old.id if exchanged else 0

    def n_voxels(self, instance_id: int) -> int:
        """In how many voxels an instance has the most votes, however few."""
        return int(self._sizes[self.instances[instance_id].number])

    def forget(self, instance_id: int) -> None:
        """Give up an instance: its voxels become background until something is seen there again."""
        self._end(self.instances[instance_id], BACKGROUND)

    def release(self, instance_id: int) -> None:
        """Give up an instance that has gone: nothing is known of its voxels any more."""
        self._end(self.instances[instance_id], 0)

    def fade(self, ijk: ArrayLike, gone: ArrayLike) -> dict[int, int]:
        """Votes in voxels (N, 3) count half; those `gone` (N,) bool, and those with little left, are forgotten.

        Returns the ids of the instances that lost voxels, and in how many more they had led. One that is left without
        any stays known until it is forgotten or given up.
        """
        sizes = self._sizes.copy()
        cells, first = np.unique(self.store.cells_of(np.asarray(ijk, np.int64).reshape(-1, 3)), return_index=True)
        lost, empty = np.zeros(BACKGROUND + 1, np.bool_), np.empty(len(cells), np.bool_)
        kernels.fade(
            self.store.fields["evidence"], self.store.rows(cells), np.asarray(gone, np.bool_)[first], self._sizes, lost,
            int(FADED_WEIGHT * evidence.UNIT), empty,
        )  # fmt: skip
        self.store.remove(cells[empty])
        self._note(np.unique(cells[cells >= 0] >> 9))
        return {
            int(self._id_of[number]): int(sizes[number] - self._sizes[number])
            for number in np.flatnonzero(lost[:BACKGROUND]).tolist()
            if self._id_of[number]
        }

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        known = list(self.instances.values())
        votes = [(i.id, label, weight) for i in known for label, weight in i.labels.items()]
        rows = [
            (i.id, i.first_seen_ns, i.last_seen_ns, i.views, i.doubts, i.number, i.splits, i.own_ns, i.strangers)
            for i in known
        ]
        return {
            **super().state(),
            "table.next_id": np.array(self._next_id),
            "table.instances": np.array(rows, np.int64).reshape(-1, 9),
            "table.colors": np.array([i.colors for i in known], np.float32).reshape(-1, CELLS),
            "table.votes": np.array(votes, np.float64).reshape(-1, 3),
            "table.together": np.array([(*pair, n) for pair, n in self._together.items()], np.int64).reshape(-1, 3),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> Self:
        layer = super().from_state(state)
        layer._next_id = int(state["table.next_id"])
        for row in state["table.instances"].tolist():
            layer._begin(Instance(*row))
        for instance, colors in zip(layer.instances.values(), state["table.colors"], strict=True):
            instance.colors = np.array(colors, np.float32)
        for id_, label, weight in state["table.votes"].tolist():
            layer.instances[int(id_)].labels[int(label)] = weight
        for instance in layer.instances.values():
            if instance.labels:
                layer._classify(instance)
        for a, b, n in state["table.together"].tolist():
            layer._together[a, b] = n
        cells = layer.store.cells()
        rows = layer.store.rows(cells)
        held = layer.store.fields["evidence"][rows]
        for column in range(COUNTERS):
            there = held[:, COUNTERS + column] > 0
            pairs = np.unique(held[there, column].astype(np.int64) << 32 | cells[there] >> 9)
            for pair in pairs.tolist():
                instance_id = int(layer._id_of[pair >> 32])
                if instance_id:
                    layer.instances[instance_id].slots.add(pair & 0xFFFFFFFF)
        layer._sizes += np.bincount(layer._leaders(rows), minlength=BACKGROUND + 1)
        return layer

    # -- what is there ------------------------------------------------------------------------------------
    def points(self, instance_id: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Surface points (N, 3) [m], one a voxel that the instance has won, and how much each is worth (N,): the root
        of its votes, since votes fall off steeply towards rims."""
        instance, fields = self.instances[instance_id], self.store.fields
        cells, rows = self._rows(instance)
        chosen, weights = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
        n = kernels.gather(
            fields["evidence"], rows, instance.number, int(LEAST_WEIGHT * evidence.UNIT), LEAST_SHARE, chosen, weights
        )
        centres = ijk_to_centre(self.store.ijk(cells[chosen[:n]]), self.voxel_size_m)
        offsets = fields["mean"][rows[chosen[:n]]] * (self.voxel_size_m / kernels.MEAN_UNIT)
        return (centres + offsets).astype(np.float32), np.sqrt(weights[:n] / np.float32(evidence.UNIT))

    def class_votes(self, ijk: ArrayLike) -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.float32]]:
        """What instances say of the class of voxels (N, 3) of this map's size.

        Returns class ids (N,), 0 where no confirmed instance is, the votes (N,) for instances of that class, and those
        (N,) for others and for background.
        """
        rows = self.store.rows(self.store.cells_of(ijk))
        labels, votes, others = _answers(len(rows))
        kernels.classes_of(self.store.fields["evidence"], rows, self._class_of, labels, votes, others)
        return labels, votes, others

    def classes(
        self, low: ArrayLike, high: ArrayLike
    ) -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.float32]]:
        """What instances say of the class of boxes from corners `low` to `high` (N, 3) [m].

        Returns class ids (N,), 0 where no confirmed instance is, the votes (N,) of voxels for instances of that class,
        and those (N,) of voxels for others and for background.
        """
        size = self.voxel_size_m
        first = np.floor(np.asarray(low, np.float64) / size + 1e-6).astype(np.int64)
        beyond = np.ceil(np.asarray(high, np.float64) / size - 1e-6).astype(np.int64)
        labels, votes, others = _answers(len(first))
        store = self.store
        kernels.classes_of_boxes(
            store.table, store.masks, store.first, store.fields["evidence"], self._class_of, first, beyond, labels,
            votes, others,
        )  # fmt: skip
        return labels, votes, others

    def query(self, p_map: ArrayLike) -> NDArray[np.uint32]:
        """The instance (N,) that holds each point (N, 3) [m]; 0 where none does that was seen more than once."""
        ids = np.where(self._class_of > 0, self._id_of, 0)
        return ids[self._leaders(self.store.rows(self.store.cells_at(p_map)))].astype(np.uint32)

    def _leaders(self, rows: Array) -> NDArray[np.int64]:
        numbers = np.empty(len(rows), np.int64)
        kernels.numbers_of(self.store.fields["evidence"], rows, numbers)
        return numbers

    def _known_rows(self, cells: Array) -> NDArray[np.int64]:
        """The rows of those of the cells that have a record."""
        rows = self.store.rows(np.unique(cells))
        return rows[rows >= 0]

    def _rows(self, instance: Instance) -> tuple[Array, Array]:
        """Cells and rows (n,) of all records in the blocks of an instance."""
        cells = self.store.cells(np.sort(np.fromiter(instance.slots, np.int64, len(instance.slots))))
        return cells, self.store.rows(cells)


def _other_colors(a: Array, b: Array) -> bool:
    """Whether both are known, and hardly of one thing."""
    return bool(likeness(a, b) < OTHER_COLORS)


def _answers(n: int) -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.float32]]:
    return np.empty(n, np.uint16), np.empty(n, np.float32), np.empty(n, np.float32)
