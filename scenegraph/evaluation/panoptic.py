"""Panoptic quality: how well voxels are divided into things and stuff, and named.

Kirillov, He, Girshick, Rother and Dollár, *Panoptic Segmentation*, CVPR 2019, section 4, with voxels for pixels. For
each class, over the matched pairs of segments (TP), the invented (FP) and the missed ones (FN):

    PQ = Σ IoU / (TP + FP / 2 + FN / 2) = SQ · RQ,   SQ = Σ IoU / TP,   RQ = TP / (TP + FP / 2 + FN / 2)

A true and a said segment match when they are of one class and their intersection over union is above 0.5; there is at
most one such match for each. Figures are means over the classes that have a segment on either side.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["PanopticQuality", "PanopticTally", "Unmatched"]

Array: TypeAlias = NDArray[Any]

MATCH_OVERLAP = 0.5
VOID_SHARE = 0.5


@dataclass(frozen=True)
class PanopticQuality:
    """Panoptic, segmentation and recognition quality, means over classes; NaN without a class."""

    pq: float
    sq: float
    rq: float


@dataclass(frozen=True)
class Unmatched:
    """Segments of one home without a match: those missed by class and instance id (0 for stuff), and those invented by
    class, instance id and number of voxels."""

    missed: list[tuple[int, int]]
    invented: list[tuple[int, int, int]]


@dataclass
class PanopticTally:
    """Segments by class id, counted over all homes.

    overlap   sum of the intersections over unions of matched segments
    matched   true positives;  missed  false negatives;  invented  false positives
    """

    overlap: defaultdict[int, float] = field(default_factory=lambda: defaultdict(float))
    matched: Counter[int] = field(default_factory=Counter)
    missed: Counter[int] = field(default_factory=Counter)
    invented: Counter[int] = field(default_factory=Counter)

    def add(
        self,
        true_class: ArrayLike,
        true_instance: ArrayLike,
        said_class: ArrayLike,
        said_instance: ArrayLike,
        *,
        things: Collection[int],
        void: ArrayLike | None = None,
        unseen: Iterable[int] = (),
    ) -> Unmatched:
        """Count the segments of one home; returns those that found no match.

        true_class, said_class       (N,) class ids of its voxels; 0: none is said
        true_instance, said_instance (N,) instance ids, which matter for things only; 0: none is said
        things                       class ids whose instances are segments; of any other class all voxels are one
        void                         (N,) bool: voxels whose truth is not to be judged
        unseen                       class ids of true things without a voxel, one each: they are missed

        A voxel of a thing class without an instance belongs to no segment, as does one without a class. A said instance
        is one segment, of the class that most of its voxels of thing classes have (Cheng et al., *Panoptic-DeepLab*,
        CVPR 2020, section 3.3). Void voxels do not count in overlaps, and a said segment that matches nothing and of
        which more than half is void was not invented (section 4.1 of the source).
        """
        true, class_of_true, key_of_true = _segments(np.asarray(true_class), np.asarray(true_instance), things)
        said, class_of_said, key_of_said = _segments(np.asarray(said_class), np.asarray(said_instance), things)
        if void is not None:
            true[np.asarray(void, bool)] = -1
        n_true, n_said = len(class_of_true), len(class_of_said)
        judged = true >= 0
        true_size = np.bincount(true[judged], minlength=n_true)
        said_size = np.bincount(said[judged], minlength=n_said)
        said_void = np.bincount(said[~judged], minlength=n_said)
        pairs, shared = _counted(true[judged] * n_said + said[judged])
        t, s = np.divmod(pairs, n_said)
        overlap = shared / (true_size[t] + said_size[s] - shared)
        match = (t > 0) & (s > 0) & (class_of_true[t] == class_of_said[s]) & (overlap > MATCH_OVERLAP)
        for class_id, share in zip(class_of_true[t[match]].tolist(), overlap[match].tolist(), strict=True):
            self.overlap[class_id] += share
            self.matched[class_id] += 1
        missed, invented = true_size > 0, said_void <= VOID_SHARE * (said_size + said_void)
        missed[t[match]] = invented[s[match]] = False
        self.missed.update(class_of_true[1:][missed[1:]].tolist())
        self.invented.update(class_of_said[1:][invented[1:]].tolist())
        self.missed.update(unseen)
        return Unmatched(
            [(int(class_of_true[k]), int(key_of_true[k])) for k in np.flatnonzero(missed[1:]) + 1],
            [
                (int(class_of_said[k]), int(key_of_said[k]), int(said_size[k] + said_void[k]))
                for k in np.flatnonzero(invented[1:]) + 1
            ],
        )

    def merge(self, other: PanopticTally) -> None:
        """Add the segments of other homes."""
        for class_id, overlap in other.overlap.items():
            self.overlap[class_id] += overlap
        self.matched.update(other.matched)
        self.missed.update(other.missed)
        self.invented.update(other.invented)

    def quality(self, classes: Collection[int] | None = None) -> PanopticQuality:
        """The mean over all classes, or those of `classes`, that have a segment, true or said."""
        each = []
        for c in sorted({*self.matched, *self.missed, *self.invented}):
            if classes is None or c in classes:
                recognised = self.matched[c] / (self.matched[c] + 0.5 * self.invented[c] + 0.5 * self.missed[c])
                segmented = self.overlap[c] / self.matched[c] if self.matched[c] else 0.0
                each.append((recognised * segmented, segmented, recognised))
        pq, sq, rq = np.mean(each, axis=0).tolist() if each else (np.nan,) * 3
        return PanopticQuality(pq, sq, rq)


def _segments(classes: Array, instances: Array, things: Collection[int]) -> tuple[Array, Array, Array]:
    """The segment (N,) that each voxel belongs to, 0 for none; and of each segment (n + 1,) the class, and the instance
    id, 0 for stuff."""
    thing = np.isin(classes, np.fromiter(things, np.int64))
    key = np.where(thing, instances.astype(np.int64), -classes.astype(np.int64))
    keys, segment = np.unique(np.append(key, 0), return_inverse=True)
    none = int(np.searchsorted(keys, 0))
    keys[1 : none + 1], keys[0] = keys[:none].copy(), 0  # what belongs to nothing comes first
    number = np.arange(len(keys)) + (np.arange(len(keys)) < none)
    number[none] = 0
    segment = number[segment[:-1].ravel()]
    n_classes = int(classes.max(initial=0)) + 1
    pairs, votes = _counted(segment * n_classes + classes)
    order = np.lexsort((-pairs, votes))  # the last of a segment has most votes, and of those the lowest class id
    class_of = np.zeros(len(keys), np.int64)
    class_of[pairs[order] // n_classes] = pairs[order] % n_classes
    return segment, class_of, np.maximum(keys, 0)


def _counted(values: Array) -> tuple[Array, Array]:
    """The values ≥ 0 that there are, ascending, and how often each: without sorting millions."""
    counts = np.bincount(values)
    there = np.flatnonzero(counts)
    return there, counts[there]
