"""Semantic voxels: which class a piece of surface belongs to, from many uncertain labels, in little memory.

Two ways of fusing, after *Semantic 3D mapping* (lecture on semantic-aware volumetric mapping): votes, the share of all
views that named a class; and the recursive Bayesian update, Π p(label | class), kept as sums of logarithms. Both are
sums of evidence, so that the order of observations does not matter and maps of two robots can be added. Of each voxel
the best few classes are counted, and one sum of all others, which bounds what any class can have lost (Misra & Gries,
Finding repeated elements, 1982; mergeable after Agarwal et al., Mergeable summaries, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import as_points, ijk_to_centre, point_to_ijk
from mapping.kernels import evidence as kernels
from mapping.label_uncertainty import spread_labels
from mapping.layer import Changed, require, require_whole
from mapping.packed import PackedLayer, PackedStore

if TYPE_CHECKING:
    from mapping.instances import InstanceMap

Array: TypeAlias = NDArray[Any]

LEAST_CONFIDENCE, MOST_CONFIDENCE = 0.01, 0.99
"""What a segmenter says of itself is believed within these."""


def camera_row(intrinsics: CameraIntrinsics) -> Array:
    """(4,) fx, fy, cx, cy as kernels take them."""
    return np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])


def pose_rows(T_map_camera: SE3) -> Array:
    """(3, 4) rotation and translation as kernels take them."""
    return np.ascontiguousarray(T_map_camera.matrix[:3])


@dataclass(frozen=True, eq=False)
class ClassBelief:
    """What N voxels say of their classes, best first.

    classes      (N, k) uint16, 0 where there are fewer
    probability  (N, k) float32 of each: its share of the votes, or its posterior; NaN in voxels without evidence
    other        (N,) float32: what is left for all other classes together
    bound        (N,) float32: by no more than this is a share too low, for want of counters; 0 if no more than k
                 classes were ever seen there
    """

    classes: NDArray[np.uint16]
    probability: NDArray[np.float32]
    other: NDArray[np.float32]
    bound: NDArray[np.float32]

    def entropy(self) -> NDArray[np.float32]:
        """(N,) [nats] of the class, all others counted as one; NaN in voxels without evidence."""
        parts = np.concatenate([self.probability, self.other[:, None]], axis=1)
        logs = np.log(np.where(parts > 0.0, parts, np.float32(1.0)))
        return np.asarray(-(parts * logs).sum(axis=1), np.float32)


class SemanticMap(PackedLayer):
    """Evidence for classes per voxel.

    voxel_size_m   edge of a voxel [m]
    memory         evidence [full views; nats for bayes] beyond which what a voxel holds counts half, ≤ 254
    fusion         "votes": a confidence weighs a vote; "bayes": each label is a measurement that is right with its
                   confidence, and otherwise any of the other classes
    kept           classes that a voxel counts one by one, 1 … 15
    n_classes      classes that the segmenter tells apart (bayes)
    accuracy       how often its labels are right, where it does not say (bayes)
    least          evidence [full views; nats for bayes] below which a voxel is not yet labelled

    A voxel on a thing is of the thing's class, once `things` is set: a whole thing is right more often than single
    voxels of it, which are seen less often and lie at the border of masks.
    """

    kind = "semantics"
    things: InstanceMap | None = None
    """The instances whose classes outrank the evidence of single voxels."""

    def __init__(
        self,
        *,
        voxel_size_m: float,
        memory: float = 200.0,
        fusion: Literal["votes", "bayes"] = "votes",
        kept: int = 3,
        n_classes: int = 40,
        accuracy: float = 0.7,
        least: float = 0.01,
    ) -> None:
        if fusion not in ("votes", "bayes"):
            raise InvalidParameter(f"fusion: expected votes or bayes, got {fusion!r}")
        self.memory = require("memory", memory, 0.0, kernels.MOST)
        self.fusion = fusion
        self.kept = require_whole("kept", kept, 1, 15)
        self.n_classes = require_whole("n_classes", n_classes, 2, 65535)
        self.accuracy = require("accuracy", accuracy, 0.0, 1.0)
        self.least = require("least", least, -1e-9, self.memory)
        self.store = PackedStore({"evidence": ("u2", 2 * self.kept + 1)}, voxel_size_m)

    def parameters(self) -> dict[str, Any]:
        return {
            "voxel_size_m": self.voxel_size_m,
            "memory": self.memory,
            "fusion": self.fusion,
            "kept": self.kept,
            "n_classes": self.n_classes,
            "accuracy": self.accuracy,
            "least": self.least,
        }

    # -- evidence in --------------------------------------------------------------------------------------
    def integrate(
        self, p_map: ArrayLike, labels: ArrayLike, weights: ArrayLike | None = None, confidence: ArrayLike | None = None
    ) -> Changed:
        """Labels of points: p_map (N, 3) [m], class ids (N,) with 0 = none, weights (N,) ≥ 0: views that each counts
        for (default 1), confidence (N,) in 0 … 1 that a label is right."""
        points, choices = as_points(p_map), np.ascontiguousarray(labels, dtype=np.uint16)
        trust = self._trust("weights", weights, points) * self._gain(confidence)
        if choices.shape != (len(points),) or trust.shape != (len(points),):
            raise InvalidParameter(
                f"labels, weights, confidence: expected one a point, {len(points)}, got {choices.shape}, {trust.shape}"
            )
        return self._add(points, choices, trust)

    def integrate_scores(
        self, p_map: ArrayLike, scores: ArrayLike, classes: ArrayLike, weights: ArrayLike | None = None
    ) -> Changed:
        """What a segmenter gives for each of several classes: p_map (N, 3) [m], scores (N, M) ≥ 0, each row made to sum
        to 1, classes (M,) ids ≠ 0, weights (N,) ≥ 0: views that each point counts for (default 1)."""
        points, ids = as_points(p_map), np.asarray(classes, np.uint16)
        share = np.asarray(scores, np.float64)
        if share.shape != (len(points), len(ids)) or not (np.isfinite(share).all() and (share >= 0.0).all()):
            raise InvalidParameter(
                f"scores: expected finite numbers ≥ 0 of shape {(len(points), len(ids))}, got shape {share.shape}"
            )
        if not ids.all() or len(np.unique(ids)) != len(ids):
            raise InvalidParameter("classes: expected different ids, none of them 0")
        weight = self._trust("weights", weights, points)
        total = share.sum(axis=1)
        share = share / np.where(total > 0.0, total, 1.0)[:, None]
        amounts = share if self.fusion == "votes" else self._surprise(share)
        amounts = amounts * weight[:, None]
        ranks = np.argsort(-amounts, axis=1, kind="stable")
        counts, at = self._counts(amounts), np.arange(len(points))
        cells = self._cells(points, counts.any(axis=1))
        return self._give([(cells, ids[rank], counts[at, rank]) for rank in ranks.T if counts[at, rank].any()])

    def integrate_image(
        self,
        depth_m: Array,
        labels: Array,
        trust: Array,
        intrinsics: CameraIntrinsics,
        T_map_camera: SE3,
        confidence: Array | None = None,
        covariance: Array | None = None,
    ) -> Changed:
        """Labels of pixels: depth (H, W) float32 [m], class ids (H, W) uint16 with 0 = none, trust (H, W) in 0 … 1,
        confidence (H, W) in 0 … 1 that a label is right.

        covariance : (6, 6) of the pose, in the camera's frame: each label is spread over where it may belong
                     (`spread_labels`), which takes some ten times as long
        """
        store = self.store
        weight = np.ascontiguousarray(trust, np.float32)
        gain = self._gain(confidence)
        if confidence is not None or gain != 1.0:
            weight = weight * np.asarray(gain, np.float32)
        if covariance is not None:
            return self._spread(depth_m, labels, weight, intrinsics, T_map_camera, covariance)
        cells, choices, counts, blocks, bare = kernels.runs_of_image(
            store.table, store.masks, store.n_blocks, depth_m, np.asarray(labels, np.uint16), weight,
            camera_row(intrinsics), pose_rows(T_map_camera), self.voxel_size_m,
        )  # fmt: skip
        store.allocate(blocks)
        store.add(bare)
        return self._give([(cells, choices, counts)])

    def _spread(
        self,
        depth_m: Array,
        labels: Array,
        weight: Array,
        intrinsics: CameraIntrinsics,
        T_map_camera: SE3,
        sigma: Array,
    ) -> Changed:
        voting = (labels > 0) & (depth_m > 0) & (weight > 0)
        points = T_map_camera @ intrinsics.backproject(depth_m)[voting].astype(np.float64)
        width = depth_m[voting].astype(np.float64) / self.voxel_size_m
        views = weight[voting] * np.minimum(width**2 / (intrinsics.fx * intrinsics.fy), 1.0)
        least = 1.0 / kernels.UNIT
        found = spread_labels(
            points, labels[voting], T_map_camera, sigma, self.voxel_size_m, weights=views, least=least
        )
        return self._add(found.centres, found.labels, found.evidence)

    def merge(self, other: SemanticMap) -> None:
        """Add all that another map with the same parameters knows; both must be in the same frame."""
        if other.parameters() != self.parameters():
            raise InvalidParameter(f"other: expected a map with {self.parameters()}, got {other.parameters()}")
        theirs = other.store.cells()
        voxels, records = other.store.ijk(theirs), other.store.fields["evidence"][other.store.rows(theirs)]
        self.store.allocate(voxels >> 3)
        cells, k = self.store.cells_of(voxels), self.kept
        self.store.add(cells)
        self._give([(cells, records[:, c].copy(), records[:, k + c].copy()) for c in range(k)])
        left = self.store.fields["evidence"][:, 2 * k]
        rows = self.store.rows(cells)
        left[rows] = np.minimum(left[rows].astype(np.int64) + records[:, 2 * k], self._limit).astype(np.uint16)

    def relabel(self, new_ids: ArrayLike) -> None:
        """Give every class c the id new_ids[c], (65536,) or as many as there are; 0 stays 0. Classes that become one
        add up."""
        table = np.arange(65536, dtype=np.uint16)
        given = np.asarray(new_ids, np.uint16)
        if given.ndim != 1 or len(given) > len(table) or (len(given) and given[0] != 0):
            raise InvalidParameter("new_ids: expected up to 65536 class ids, the first of them 0")
        table[: len(given)] = given
        records, k = self.store.fields["evidence"], self.kept
        rows = self.store.rows(self.store.cells())
        held = records[rows]
        held[:, :k] = table[held[:, :k]]
        for a in range(k):
            for b in range(a + 1, k):
                same = (held[:, a] == held[:, b]) & (held[:, k + b] > 0)
                held[same, k + a] += held[same, k + b]
                held[same, k + b] = held[same, b] = 0
        records[rows] = held
        self._note(np.arange(self.store.n_blocks))

    def fade(self, ijk: ArrayLike, gone: ArrayLike | None = None) -> Changed:
        """What voxels (N, 3) hold counts half; those with too little left for a label, and those `gone` (N,), are
        forgotten."""
        given = self.store.cells_of(np.asarray(ijk, np.int32).reshape(-1, 3))
        lost = np.zeros(len(given), np.bool_) if gone is None else np.asarray(gone, np.bool_)
        cells, at = np.unique(given, return_index=True)
        lost, rows = lost[at], self.store.rows(cells)
        cells, lost, rows = cells[rows >= 0], lost[rows >= 0], rows[rows >= 0]
        records = self.store.fields["evidence"]
        kernels.halve(records, rows)
        held = records[rows, self.kept :].sum(axis=1, dtype=np.int64)
        self.store.remove(cells[lost | (held < max(self.least * kernels.UNIT, 1.0))])
        return self._note(np.unique(cells >> 9))

    # -- what is known ------------------------------------------------------------------------------------
    def query(self, p_map: ArrayLike) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Class id (N,), 0 where unknown or not yet labelled, and how sure it is (N,): its share of the votes or its
        posterior, NaN where unknown."""
        return self.classes_at(self.store.cells_at(p_map))

    def belief(self, p_map: ArrayLike) -> ClassBelief:
        """What the voxels at points (N, 3) [m] themselves say, without the things that they belong to."""
        return self._belief(self.store.rows(self.store.cells_at(p_map)))

    def entropy(self, p_map: ArrayLike) -> NDArray[np.float32]:
        """(N,) [nats] how undecided the class at each point (N, 3) [m] is; NaN where unknown."""
        return self.belief(p_map).entropy()

    def voxels(self) -> tuple[Array, Array, Array]:
        """Centres (N, 3) [m], class ids (N,) and confidences (N,) of all voxels with evidence."""
        cells = self.store.cells()
        labels, confidence = self.classes_at(cells)
        known = labels > 0
        return ijk_to_centre(self.store.ijk(cells[known]), self.voxel_size_m), labels[known], confidence[known]

    def classes_at(self, cells: Array) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """As `query`, of cells (N,) of the store."""
        rows = self.store.rows(cells)
        labels = np.empty(len(rows), np.uint16)
        best, held = np.empty(len(rows), np.int64), np.empty(len(rows), np.int64)
        kernels.lead(self.store.fields["evidence"], rows, labels, best, held)
        known = (labels > 0) & (held >= self.least * kernels.UNIT)
        labels[~known] = 0
        confidence = np.full(len(rows), np.nan, np.float32)
        if self.fusion == "votes":
            confidence[known] = best[known] / held[known]
        else:
            confidence[known] = self._belief(rows[known]).probability[:, 0]
        if self.things is not None and known.any():
            ijk = self.store.ijk(cells[known])
            if self.things.voxel_size_m == self.voxel_size_m:
                of_thing, votes, others = self.things.class_votes(ijk)
            else:
                of_thing, votes, others = self.things.classes(ijk * self.voxel_size_m, (ijk + 1) * self.voxel_size_m)
            sure = votes > others
            at = np.flatnonzero(known)[sure]
            labels[at] = of_thing[sure]
            confidence[at] = votes[sure] / (votes[sure] + others[sure])
        return labels, confidence

    def _belief(self, rows: Array) -> ClassBelief:
        k = self.kept
        held = self.store.fields["evidence"][np.maximum(rows, 0)] if self.store.n_records else np.zeros((1, 2 * k + 1))
        held = np.where((rows >= 0)[:, None], held, 0)
        order = np.lexsort((held[:, :k], -held[:, k : 2 * k].astype(np.int64)), axis=1)
        evidence = np.take_along_axis(held[:, k : 2 * k], order, axis=1).astype(np.float64)
        classes = np.where(evidence > 0, np.take_along_axis(held[:, :k], order, axis=1), 0).astype(np.uint16)
        left = held[:, 2 * k].astype(np.float64)
        total = evidence.sum(axis=1) + left
        unknown = total == 0.0
        safe = np.where(unknown, 1.0, total)
        if self.fusion == "votes":
            probability, other = evidence / safe[:, None], left / safe
        else:
            nats = np.where(classes > 0, evidence / kernels.UNIT, -np.inf)
            top = np.maximum(nats.max(axis=1), 0.0)
            counted = (classes > 0).sum(axis=1)
            rest = np.maximum(self.n_classes - counted, 0) * np.exp(-top)
            parts = np.exp(nats - top[:, None])
            sums = parts.sum(axis=1) + rest
            probability, other = parts / sums[:, None], rest / sums
        bound = left / (k + 1) / safe
        probability[unknown], other[unknown], bound[unknown] = np.nan, np.nan, np.nan
        return ClassBelief(classes, probability.astype(np.float32), other.astype(np.float32), bound.astype(np.float32))

    # -- how evidence is counted --------------------------------------------------------------------------
    @property
    def _limit(self) -> int:
        return int(self.memory * kernels.UNIT)

    def _trust(self, name: str, given: ArrayLike | None, points: Array) -> Array:
        weights = np.ones(len(points)) if given is None else np.asarray(given, np.float64)
        if weights.shape != (len(points),) or not (weights >= 0.0).all():
            raise InvalidParameter(f"{name}: expected {len(points)} numbers ≥ 0, one a point")
        return weights

    def _gain(self, confidence: ArrayLike | None) -> Any:
        """Evidence of a full view whose label is right with this confidence: as it is, or the logarithm of how much
        more likely the label is if it is right."""
        if confidence is None and self.fusion == "votes":
            return 1.0
        sure = np.asarray(self.accuracy if confidence is None else confidence, np.float64)
        if not ((sure >= 0.0) & (sure <= 1.0)).all():
            raise InvalidParameter("confidence: expected numbers in 0 … 1")
        if self.fusion == "votes":
            return sure
        sure = np.clip(sure, LEAST_CONFIDENCE, MOST_CONFIDENCE)
        return np.maximum(np.log(sure * (self.n_classes - 1) / (1.0 - sure)), 0.0)

    def _surprise(self, share: Array) -> Array:
        """(N, M) logarithms of how much more likely each class is than the least likely one, or than the first that is
        not kept; classes below that get nothing."""
        logs = np.log(np.clip(share, 0.1 * LEAST_CONFIDENCE / max(share.shape[1], 1), 1.0))
        least = min(self.kept, share.shape[1] - 1)
        floor = -np.partition(-logs, least, axis=1)[:, least] if share.shape[1] else np.zeros(len(share))
        surprise: Array = np.maximum(logs - floor[:, None], 0.0)
        return surprise

    def _counts(self, amounts: Array) -> NDArray[np.uint16]:
        counts: NDArray[np.uint16] = np.rint(np.minimum(amounts, self.memory) * kernels.UNIT).astype(np.uint16)
        return counts

    def _cells(self, points: Array, wanted: Any) -> Array:
        """The cell of each point (N, 3), which gets a record where it has none; −1 where none is wanted."""
        wanted = wanted & np.isfinite(points).all(axis=1)
        voxels = point_to_ijk(points[wanted], self.voxel_size_m)
        self.store.allocate(voxels >> 3)
        cells = np.full(len(points), -1, np.int64)
        cells[wanted] = self.store.cells_of(voxels)
        self.store.add(cells)
        return cells

    def _add(self, points: Array, choices: Array, amounts: Array) -> Changed:
        """Give evidence (N,) for classes (N,) at points (N, 3)."""
        counts = self._counts(amounts)
        return self._give([(self._cells(points, (choices != 0) & (counts > 0)), choices, counts)])

    def _give(self, rounds: list[tuple[Array, Array, Array]]) -> Changed:
        """Give evidence (n,) for classes (n,) to cells (n,), round by round."""
        self.revision += 1
        store, slots = self.store, [np.empty(0, np.int64)]
        for cells, choices, counts in rounds:
            touched = np.empty(store.n_blocks, np.int64)
            n = kernels.give_all(
                store.masks, store.first, store.fields["evidence"], cells, choices, counts, self._limit,
                store.changed_at, self.revision, touched,
            )  # fmt: skip
            slots.append(touched[:n])
        return Changed(self.block_ijk[np.concatenate(slots)], self.block_size_m)
