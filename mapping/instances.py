"""Instances that last: the masks of single images, joined over views by their overlap in space.

After Voxblox++ (Grinvald et al. 2019): every fine voxel votes for the instance it belongs to; a mask is the instance on
whose voxels most of it lies, or a new one. Two instances that are seen through one mask again and again are merged.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore
from mapping.kernels import votes as kernels
from mapping.layer import BlockLayer, require
from mapping.segmentation import Segmentation
from mapping.semantics import camera_row, pose_rows

Array: TypeAlias = NDArray[Any]

SAME_SHARE = 0.2
"""A mask is a known instance of its class when this share of its pixels lies on that instance's voxels …"""
OTHER_CLASS_SHARE = 0.5
"""… and of another class when this much does: a mislabelled view, but not a cup in front of a bottle."""
YOUNG_VIEWS = 2
YOUNG_SHARE = 0.35
"""An instance seen this few times may have got its class from mislabelled views: then this share is enough."""
FOUNDING_PIXELS = 100
"""A mask that is no known instance founds one when it has this many pixels."""
COVERED_SHARE = 0.6
COVERED_PIXELS = 15
"""A mask that holds this share of what is visible of another instance, and this many of the pixels looked at, …"""
MERGE_VIEWS = 2
MERGE_VIEWS_OTHER_CLASS = 3
"""… in so many views, net of views in which both had masks of their own, makes the two one."""
MEAN_MEMORY = 8.0
"""Votes (about: full views) over which a voxel's mean point is taken."""
LEAST_WEIGHT = 0.15
LEAST_SHARE = 0.5
"""A voxel belongs to an instance that holds this many votes (about: full views) and this share of all its votes."""


@dataclass
class Instance:
    """What is known of one instance besides its voxels."""

    id: int
    first_seen_ns: int
    last_seen_ns: int
    views: int = 0
    labels: dict[int, float] = field(default_factory=dict)
    slots: set[int] = field(default_factory=set)

    @property
    def label(self) -> int:
        """The class id with most votes (ties: the lowest id)."""
        return min(self.labels, key=lambda c: (-self.labels[c], c))

    @property
    def label_share(self) -> float:
        return self.labels[self.label] / sum(self.labels.values())


@dataclass(frozen=True)
class InstanceChange:
    """Instances that got or lost voxels, and those that were merged: lost id → kept id."""

    touched: frozenset[int]
    merged: dict[int, int]


class InstanceMap(BlockLayer):
    """Votes of fine voxels for instances, with the mean of the points that fell into each."""

    kind = "instances"

    def __init__(self, *, voxel_size_m: float, memory: float = 50.0) -> None:
        self.memory = require("memory", memory, 0.0, 1e6)
        self.store = BlockStore(
            {
                "instance": "u4",
                "weight": "f4",
                "second": "u4",
                "second_weight": "f4",
                "total": "f4",
                "mean": ("f4", 3),
            },
            voxel_size_m,
        )
        self.instances: dict[int, Instance] = {}
        self._next_id = 1
        self._together: defaultdict[tuple[int, int], int] = defaultdict(int)

    def parameters(self) -> dict[str, Any]:
        return {"voxel_size_m": self.voxel_size_m, "memory": self.memory}

    def integrate_image(
        self, seen: Segmentation, depth_m: Array, intrinsics: CameraIntrinsics, T_map_camera: SE3, stamp_ns: int
    ) -> InstanceChange:
        """Join the pieces of one image to lasting instances and count their votes."""
        camera, pose = camera_row(intrinsics), pose_rows(T_map_camera)
        ids, together = self._associate(seen, depth_m, camera, pose)
        for piece, instance_id in enumerate(ids.tolist()):
            if instance_id:
                self._witness(instance_id, int(seen.label[piece]), int(seen.pixels[piece]), stamp_ns)

        choices = np.concatenate([[0], ids]).astype(np.uint32)[seen.pieces]
        blocks = kernels.touched_blocks(depth_m, choices != 0, camera, pose, self.voxel_size_m, 2)
        slots = self.store.allocate(blocks)
        background = (seen.labels != 0) & (seen.pieces == 0)
        choices[background] = BACKGROUND
        table, fields = self.store.table, self.store.fields
        trust = np.ascontiguousarray(seen.trust, dtype=np.float32)
        kernels.vote_image(
            table,
            *(fields[n] for n in ("instance", "weight", "second", "second_weight", "total", "mean")),
            depth_m,
            choices,
            trust,
            camera,
            pose,
            self.voxel_size_m,
            self.memory,
            MEAN_MEMORY,
        )
        pairs = kernels.blocks_of_choices(table, depth_m, choices, camera, pose, self.voxel_size_m, 1)
        touched = self._claim(pairs)
        self._note(slots)
        merged = self._merge(together)
        return InstanceChange(frozenset(touched.union(merged.values())), merged)

    # -- association --------------------------------------------------------------------------------------
    def _associate(
        self, seen: Segmentation, depth_m: Array, camera: Array, pose: Array
    ) -> tuple[Array, list[tuple[int, int]]]:
        """The instance (n,) of each piece, 0 for a piece that is too small to found one, and pairs seen through one
        mask."""
        fields = self.store.fields
        piece, known, hits, looked = kernels.count_overlaps(
            self.store.table,
            fields["instance"],
            fields["weight"],
            depth_m,
            seen.pieces,
            camera,
            pose,
            self.voxel_size_m,
            2,
            len(seen),
        )
        real = known != BACKGROUND
        piece, known, hits = piece[real], known[real], hits[real]
        visible: defaultdict[int, int] = defaultdict(int)
        for k, n in zip(known.tolist(), hits.tolist(), strict=True):
            visible[k] += n
        piece, known, hits = piece[piece > 0] - 1, known[piece > 0], hits[piece > 0]
        share = hits / np.maximum(looked[1:][piece], 1)
        same = np.array(
            [self.instances[k].label == seen.label[p] for p, k in zip(piece, known, strict=True)], dtype=bool
        )
        young = np.array([self.instances[k].views <= YOUNG_VIEWS for k in known], dtype=bool)
        fits = share >= np.where(same, SAME_SHARE, np.where(young, YOUNG_SHARE, OTHER_CLASS_SHARE))

        ids = np.zeros(len(seen), np.int64)
        candidates, column = np.unique(known, return_inverse=True)
        gain = np.zeros((len(seen), len(candidates)))
        gain[piece[fits], column[fits]] = hits[fits] * np.where(same[fits], 1.5, 1.0)
        rows, columns = linear_sum_assignment(gain, maximize=True)  # all masks of an image are different things
        chosen = gain[rows, columns] > 0
        ids[rows[chosen]] = candidates[columns[chosen]]
        taken = set(ids[ids > 0].tolist())
        for p in np.flatnonzero(ids == 0):
            if seen.pixels[p] >= FOUNDING_PIXELS:
                ids[p] = self._next_id
                self._next_id += 1
        for pair in combinations(sorted(taken), 2):
            if pair in self._together:  # two masks in one image: two things
                self._together[pair] -= 1
        together = [
            (int(ids[p]), int(k))
            for p, k, n in zip(piece, known, hits.tolist(), strict=True)
            if ids[p]
            and k != ids[p]
            and int(k) not in taken
            and n >= max(COVERED_PIXELS, COVERED_SHARE * visible[int(k)])
        ]
        return ids, together

    def _witness(self, instance_id: int, label: int, pixels: int, stamp_ns: int) -> None:
        known = self.instances.get(instance_id)
        if known is None:
            known = self.instances[instance_id] = Instance(instance_id, stamp_ns, stamp_ns)
        known.last_seen_ns = max(known.last_seen_ns, stamp_ns)
        known.views += 1
        known.labels[label] = known.labels.get(label, 0.0) + min(1.0, pixels / 400.0)

    def _claim(self, pairs: Array) -> set[int]:
        """Note the blocks in which each instance has votes; returns all instances with voxels in blocks that
        changed."""
        touched: set[int] = set()
        pairs = pairs[pairs[:, 0] != BACKGROUND]
        packed = np.unique(pairs[:, 0] << 32 | pairs[:, 1])
        for instance_id in np.unique(packed >> 32).tolist():
            self.instances[instance_id].slots.update((packed[packed >> 32 == instance_id] & 0xFFFFFFFF).tolist())
            touched.add(instance_id)
        return touched

    def _merge(self, together: list[tuple[int, int]]) -> dict[int, int]:
        merged: dict[int, int] = {}
        for one, other in together:
            pair = (min(one, other), max(one, other))
            self._together[pair] += 1
            if pair[0] not in self.instances or pair[1] not in self.instances:
                continue
            same = self.instances[pair[0]].label == self.instances[pair[1]].label
            if self._together[pair] >= (MERGE_VIEWS if same else MERGE_VIEWS_OTHER_CLASS):
                self._absorb(*pair)
                merged[pair[1]] = pair[0]
        return merged

    def join(self, kept: int, lost: int) -> InstanceChange:
        """Make two instances one, as told."""
        self._absorb(kept, lost)
        return InstanceChange(frozenset({kept}), {lost: kept})

    def forget(self, instance_id: int) -> None:
        """Give up an instance: its voxels become background until something is seen there again."""
        gone = self.instances.pop(instance_id)
        slots = np.fromiter(gone.slots, np.int64, len(gone.slots))
        fields = self.store.fields
        kernels.rename(
            slots,
            fields["instance"],
            fields["weight"],
            fields["second"],
            fields["second_weight"],
            instance_id,
            BACKGROUND,
        )
        for pair in [p for p in self._together if instance_id in p]:
            del self._together[pair]

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        known = list(self.instances.values())
        votes = [(i.id, label, weight) for i in known for label, weight in i.labels.items()]
        return {
            **super().state(),
            "table.next_id": np.array(self._next_id),
            "table.instances": np.array(
                [(i.id, i.first_seen_ns, i.last_seen_ns, i.views) for i in known], np.int64
            ).reshape(-1, 4),
            "table.votes": np.array(votes, np.float64).reshape(-1, 3),
            "table.together": np.array([(*pair, n) for pair, n in self._together.items()], np.int64).reshape(-1, 3),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> Self:
        layer = super().from_state(state)
        layer._next_id = int(state["table.next_id"])
        for id_, first, last, views in state["table.instances"].tolist():
            layer.instances[id_] = Instance(id_, first, last, views)
        for id_, label, weight in state["table.votes"].tolist():
            layer.instances[int(id_)].labels[int(label)] = weight
        for a, b, n in state["table.together"].tolist():
            layer._together[a, b] = n
        for name in ("instance", "second"):
            slots, local = np.nonzero(layer.store.used(name))
            pairs = np.unique(np.stack([layer.store.used(name)[slots, local].astype(np.int64), slots], axis=1), axis=0)
            for id_, slot in pairs.tolist():
                if id_ in layer.instances:
                    layer.instances[id_].slots.add(slot)
        return layer

    def _absorb(self, kept: int, lost: int) -> None:
        a, b = self.instances[kept], self.instances.pop(lost)
        slots = np.fromiter(b.slots, np.int64, len(b.slots))
        fields = self.store.fields
        kernels.rename(
            slots, fields["instance"], fields["weight"], fields["second"], fields["second_weight"], lost, kept
        )
        a.slots |= b.slots
        a.first_seen_ns, a.last_seen_ns = min(a.first_seen_ns, b.first_seen_ns), max(a.last_seen_ns, b.last_seen_ns)
        a.views += b.views
        for label, votes in b.labels.items():
            a.labels[label] = a.labels.get(label, 0.0) + votes
        for pair in [p for p in self._together if lost in p]:
            del self._together[pair]

    # -- what is there ------------------------------------------------------------------------------------
    def points(self, instance_id: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Surface points (N, 3) [m], one a voxel that the instance has won, and their votes (N,)."""
        slots = np.sort(np.fromiter(self.instances[instance_id].slots, np.int64))
        fields = self.store.fields
        points, weights = kernels.gather(
            slots,
            self.block_ijk,
            fields["instance"],
            fields["weight"],
            fields["total"],
            fields["mean"],
            instance_id,
            self.voxel_size_m,
            LEAST_WEIGHT,
            LEAST_SHARE,
        )
        return points, weights

    def classes(
        self, low: ArrayLike, high: ArrayLike
    ) -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.float32]]:
        """What instances say of the class of boxes from corners `low` to `high` (N, 3) [m].

        Returns class ids (N,), 0 where there is no instance, the votes (N,) of fine voxels for instances of that class,
        and their votes (N,) for others and for background.
        """
        size, n = self.voxel_size_m, len(np.asarray(low))
        first = np.floor(np.asarray(low, np.float64) / size + 1e-6).astype(np.int64)
        beyond = np.ceil(np.asarray(high, np.float64) / size - 1e-6).astype(np.int64)
        known = np.fromiter(self.instances, np.int64, len(self.instances))
        class_of = np.zeros(int(known.max(initial=0)) + 1, np.uint16)
        class_of[known] = [instance.label for instance in self.instances.values()]
        labels, votes, others = np.zeros(n, np.uint16), np.zeros(n, np.float32), np.zeros(n, np.float32)
        fields = self.store.fields
        kernels.classes_of_instances(
            self.store.table, fields["instance"], fields["weight"], class_of, BACKGROUND, first, beyond, labels, votes,
            others,
        )  # fmt: skip
        return labels, votes, others

    def query(self, p_map: ArrayLike) -> NDArray[np.uint32]:
        """The instance (N,) that holds each point (N, 3) [m]; 0 where none does."""
        slots, local = self.store.locate(p_map)
        if not self.store.n_blocks:
            return np.zeros(len(slots), np.uint32)
        found = self.store.fields["instance"][np.where(slots >= 0, slots, 0), local]
        return np.where((slots >= 0) & (found != BACKGROUND), found, 0).astype(np.uint32)


BACKGROUND = 0xFFFFFFFF
"""The vote of labelled surface that is no instance: walls, floors."""
