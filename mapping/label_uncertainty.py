"""Labels seen from a place that is only known roughly: each point's evidence is spread over where it may belong.

The method of *Semantic 3D Mapping from Deep Image Segmentation* (Martín et al. 2021, §3.2) is here twice. As published,
`published_update`: N times a noise is drawn and all that was seen is put into the map as if the robot stood there; the
mean is blended with the map. And `spread_labels`, which computes what that mean tends to as N grows, at a cost that
does not depend on N: the covariance of the pose gives one of each point, and a Gaussian's mass in a voxel is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.grid import as_points, ijk_to_centre, read_only
from mapping.kernels import hashing, label_sums
from mapping.kernels import label_uncertainty as kernels
from mapping.layer import require, require_whole
from mapping.view import as_pose

__all__ = ["LabelEvidence", "count_labels", "noise_transforms", "published_update", "sample_labels", "spread_labels"]

Array: TypeAlias = NDArray[Any]

TILE = 128
"""Sources of one class are spread in pieces of so many voxels along an axis, which bounds the memory that it takes."""


@dataclass(frozen=True, eq=False)
class LabelEvidence:
    """Evidence for classes by voxel, each pair of a voxel and a class once.

    voxel_size_m  edge of a voxel [m]
    ijk           (M, 3) int32 voxels
    labels        (M,) uint16 class ids
    evidence      (M,) float64 > 0
    left_out      evidence that was not given to voxels: it was too little, or its place too uncertain
    """

    voxel_size_m: float
    ijk: NDArray[np.int32]
    labels: NDArray[np.uint16]
    evidence: NDArray[np.float64]
    left_out: float = 0.0

    def __len__(self) -> int:
        return len(self.labels)

    @staticmethod
    def none(voxel_size_m: float) -> LabelEvidence:
        """No evidence at all: what a map begins with."""
        edge = require("voxel_size_m", voxel_size_m, 0.0, 1e3, "m")
        return LabelEvidence(edge, np.empty((0, 3), np.int32), np.empty(0, np.uint16), np.empty(0))

    @property
    def centres(self) -> NDArray[np.float64]:
        """(M, 3) [m] the middle of each voxel, as layers of votes take points."""
        return ijk_to_centre(self.ijk, self.voxel_size_m)

    def leaders(self) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.float64]]:
        """The voxels (V, 3), sorted, the class with most evidence in each (V,), of equals the lowest, and its share of
        the voxel's evidence (V,)."""
        voxels, of = np.unique(self.ijk, axis=0, return_inverse=True)
        of = of.ravel()
        total = np.bincount(of, self.evidence, len(voxels))
        rank = np.lexsort((self.labels, -self.evidence, of))
        best = rank[np.unique(of[rank], return_index=True)[1]]
        return voxels, self.labels[best], self.evidence[best] / total


def count_labels(
    p_map: ArrayLike, labels: ArrayLike, voxel_size_m: float, *, weights: ArrayLike | None = None
) -> LabelEvidence:
    """Evidence of labelled points where they lie: points (N, 3) [m], class ids (N,), 0 = none, weights (N,) ≥ 0."""
    points = _Points(p_map, labels, weights, voxel_size_m)
    ijk, classes, sums, _ = points.summed()
    return LabelEvidence(points.voxel_size_m, ijk + points.origin, classes, sums[:, 3].copy())


def spread_labels(
    p_map: ArrayLike,
    labels: ArrayLike,
    T_map_sensor: SE3 | ArrayLike,
    covariance: ArrayLike,
    voxel_size_m: float,
    *,
    weights: ArrayLike | None = None,
    least: float = 0.0,
) -> LabelEvidence:
    """Evidence of labelled points, each spread over the voxels in which it may lie, given how well the pose is known.

    p_map         (N, 3) [m], where the points are if the pose is right
    labels        (N,) class ids, 0 = none
    T_map_sensor  the pose, or that of whichever frame the covariance is said of
    covariance    (6, 6) of it: x, y, z, roll, pitch, yaw [m, rad] in that frame, T = T̂·Exp(ξ)
    weights       (N,) ≥ 0, what each point counts; default 1
    least         voxels in which a class has no more evidence are left out: at 3 standard deviations there is little

    The evidence of a point sums to its weight, with what is left out. Points are first summed by voxel and class, and
    such sums again that lie close beside their uncertainty. Each is then a Gaussian about the mean of its points (to
    second order), with their covariance and that which the pose gives, J·Σ·Jᵀ with J = R·[I, −[p]ₓ], cut off at 3
    standard deviations; its mass in each voxel is taken axis by axis, given the axes before. Without any uncertainty
    that is `count_labels`. Points that are less certain than 7.6 voxels (standard deviation along some axis) are left
    out.

    Where it differs from the mean of infinitely many samples: sums are taken for Gaussians, the table rounds a standard
    deviation by up to 2.2 % and a mean by 1/64 voxel, and large rotations bend a Gaussian. Raises `InvalidParameter`.
    """
    pose, sigma = as_pose(T_map_sensor, "T_map_sensor"), _as_covariance(covariance)
    if not 0.0 <= least < np.inf:
        raise InvalidParameter(f"least: expected evidence ≥ 0, got {least!r}")
    points = _Points(p_map, labels, weights, voxel_size_m)
    ijk, classes, sums, squares = points.summed(with_squares=True)
    centre = pose.translation / points.voxel_size_m - points.origin
    twists = _twists(pose, sigma, points.voxel_size_m)
    merged = kernels.merge_sources(ijk, classes, sums, squares, centre, twists)
    by_class = np.argsort(merged[0], kind="stable")
    classes, sources, evidence, around = (part[by_class] for part in merged)
    axes = _axes_by_spread(sources, centre, twists)
    mass, offset, within, beside = _table()
    slopes = np.empty((len(classes), 3))
    levels, low, high = (np.empty((len(classes), 3), np.int64) for _ in range(3))
    kernels.measure_spread(sources, around, centre, twists, axes, within, beside, slopes, levels, low, high)
    certain = levels[:, 0] >= 0
    left_out = 0.0 if certain.all() else float(evidence[~certain].sum())
    pieces, starts = _pieces(sources, classes, certain)
    if not len(starts):
        return LabelEvidence(points.voxel_size_m, *_nothing(), left_out)
    if pieces is not None:
        classes, sources, evidence = classes[pieces], sources[pieces], evidence[pieces]
        slopes, levels, low, high = slopes[pieces], levels[pieces], low[pieces], high[pieces]
    of_pieces = classes[starts]
    found: tuple[Array, Array, Array] = kernels.spread(
        np.append(starts, len(classes)), of_pieces, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts),
        sources, evidence, slopes, levels, axes, points.origin, mass, offset, beside, float(least),
    )  # fmt: skip
    if least > 0.0:
        left_out += max(float(evidence.sum() - found[2].sum()), 0.0)
    if (of_pieces[1:] == of_pieces[:-1]).any():  # pieces of one class meet in some voxels
        found = _summed(*found)
    return LabelEvidence(points.voxel_size_m, *found, left_out)


# -- as published ----------------------------------------------------------------------------------------------


def noise_transforms(covariance: ArrayLike, n_samples: int, seed: int | np.random.Generator) -> NDArray[np.float64]:
    """N transforms (N, 4, 4) of noise, equation (3): x, y, z and roll, pitch, yaw, each drawn by itself from the
    diagonal of the covariance (6, 6); what lies beside the diagonal is not looked at. Rotation = Rz·Ry·Rx."""
    n = require_whole("n_samples", n_samples, 1, 1_000_000)
    deviation = np.sqrt(np.diag(_as_covariance(covariance)))
    x, y, z, roll, pitch, yaw = np.random.default_rng(seed).normal(size=(n, 6)).T * deviation[:, None]
    (cr, cp, cw), (sr, sp, sw) = (np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw)))
    noise = np.zeros((n, 4, 4))
    noise[:, 0] = np.stack([cw * cp, cw * sp * sr - sw * cr, cw * sp * cr + sw * sr, x], axis=1)
    noise[:, 1] = np.stack([sw * cp, sw * sp * sr + cw * cr, sw * sp * cr - cw * sr, y], axis=1)
    noise[:, 2] = np.stack([-sp, cp * sr, cp * cr, z], axis=1)
    noise[:, 3, 3] = 1.0
    return noise


def sample_labels(
    p_map: ArrayLike,
    labels: ArrayLike,
    T_map_frame: SE3 | ArrayLike,
    covariance: ArrayLike,
    voxel_size_m: float,
    *,
    n_samples: int,
    seed: int | np.random.Generator,
    weights: ArrayLike | None = None,
) -> LabelEvidence:
    """The mean over N drawn noises of the evidence of labelled points: Σ 1/N·RT′ᵢ·O of equation (5).

    Parameters as of `spread_labels`; the noise acts in `T_map_frame`. Cost and memory grow with N.
    """
    pose = as_pose(T_map_frame, "T_map_frame")
    points = _Points(p_map, labels, weights, voxel_size_m)
    moves = pose.matrix @ noise_transforms(covariance, n_samples, seed) @ pose.inverse().matrix
    ijk, classes, sums, _ = points.summed(moves)
    return LabelEvidence(points.voxel_size_m, ijk + points.origin, classes, sums[:, 3].copy())


def published_update(
    belief: LabelEvidence,
    p_sensor: ArrayLike,
    labels: ArrayLike,
    *,
    T_map_odom: SE3 | ArrayLike,
    T_odom_base: SE3 | ArrayLike,
    T_base_sensor: SE3 | ArrayLike,
    covariance: ArrayLike,
    keep: float,
    n_samples: int,
    seed: int | np.random.Generator,
    probabilities: ArrayLike | None = None,
) -> LabelEvidence:
    """The map after one more perception, equation (5) as published: K·Mₜ₋₁ + (1 − K)·mean of RT′ᵢ·Oₜ.

    belief         Mₜ₋₁
    p_sensor       (N, 3) [m] the cells of Oₜ in the sensor frame, with class ids `labels` (N,), 0 = none, and
                   `probabilities` (N,) (default 1); those that fall in one voxel of the map are added up
    T_…            map → odom, which localisation says, odom → base_footprint, which odometry says, and base_footprint →
                   sensor
    covariance     (6, 6) of the localisation: x, y, z, roll, pitch, yaw. Only its diagonal is used, and the noise is
                   put between odom and base_footprint, so that it turns the robot about the origin of odom, wherever
                   the robot is (equation (4))
    keep           K, 0 … 1: near 1 what was known counts more
    n_samples      N

    All of the map fades by K, also where nothing was looked at, and a later perception outweighs an earlier one: unlike
    votes, the result depends on the order. Raises `InvalidParameter`.
    """
    if not 0.0 <= keep <= 1.0:
        raise InvalidParameter(f"keep: expected a share 0 … 1, got {keep!r}")
    T_map_frame = as_pose(T_map_odom, "T_map_odom")
    T_map_sensor = T_map_frame @ as_pose(T_odom_base, "T_odom_base") @ as_pose(T_base_sensor, "T_base_sensor")
    seen = sample_labels(
        T_map_sensor @ as_points(p_sensor, "p_sensor"),
        labels,
        T_map_frame,
        covariance,
        belief.voxel_size_m,
        n_samples=n_samples,
        seed=seed,
        weights=probabilities,
    )
    both = _summed(
        np.concatenate([belief.ijk, seen.ijk]),
        np.concatenate([belief.labels, seen.labels]),
        np.concatenate([keep * belief.evidence, (1.0 - keep) * seen.evidence]),
    )
    return LabelEvidence(belief.voxel_size_m, *both)


# -- parts -----------------------------------------------------------------------------------------------------


class _Points:
    """Labelled points as kernels take them: in voxels, relative to a voxel in their midst."""

    def __init__(self, p_map: ArrayLike, labels: ArrayLike, weights: ArrayLike | None, voxel_size_m: float) -> None:
        self.voxel_size_m = require("voxel_size_m", voxel_size_m, 0.0, 1e3, "m")
        self.points, classes = as_points(p_map), np.asarray(labels)
        trust = np.empty(0) if weights is None else np.ascontiguousarray(weights, dtype=np.float64)
        n = len(self.points)
        if classes.shape != (n,) or (weights is not None and trust.shape != (n,)):
            raise InvalidParameter(f"labels, weights: expected one a point, {n}, got {classes.shape}, {trust.shape}")
        if classes.dtype != np.uint16 and (
            classes.dtype.kind not in "iu" or (n and not 0 <= classes.min() <= classes.max() < 1 << 16)
        ):
            raise InvalidParameter(f"labels: expected whole numbers 0 … 65535, got {classes.dtype}")
        self.labels, self.weights = read_only(np.ascontiguousarray(classes, np.uint16)), read_only(trust)
        low, high = label_sums.bounds_of(self.points, self.weights)
        if not np.isfinite(high - low).all():
            raise InvalidParameter("p_map, weights: expected finite coordinates and finite weights ≥ 0")
        if (high - low).max() > hashing.BLOCK_LIMIT * self.voxel_size_m:
            raise InvalidParameter(f"p_map: expected points within {hashing.BLOCK_LIMIT} voxels of each other")
        self.origin: NDArray[np.int32] = np.floor(0.5 * (low + high) / self.voxel_size_m).astype(np.int32)
        """(3,) the voxel relative to which indices are counted."""

    def summed(self, moves: Array | None = None, *, with_squares: bool = False) -> tuple[Array, Array, Array, Array]:
        """Voxels, classes, sums and squares as `label_sums.sum_labels` gives them, over the points as each of `moves`
        (P, 4, 4) [m] moves them in map."""
        poses = np.eye(4)[None, :3].copy() if moves is None else moves[:, :3].copy()
        poses /= self.voxel_size_m
        poses[:, :, 3] -= self.origin
        sums: tuple[Array, Array, Array, Array] = label_sums.sum_labels(
            self.points, self.labels, self.weights, read_only(poses), with_squares
        )
        return sums


def _summed(ijk: Array, labels: Array, evidence: Array) -> tuple[Array, Array, Array]:
    """Evidence > 0 of voxels and classes, of which some may be there several times, each once."""
    if not len(labels):
        return _nothing()
    points = _Points(ijk + 0.5, labels, evidence, 1.0)
    voxels, classes, sums, _ = points.summed()
    return voxels + points.origin, classes, sums[:, 3].copy()


def _nothing() -> tuple[Array, Array, Array]:
    return np.empty((0, 3), np.int32), np.empty(0, np.uint16), np.empty(0)


def _as_covariance(covariance: ArrayLike) -> NDArray[np.float64]:
    """`covariance` as (6, 6); raises `InvalidParameter` where it is not symmetric and positive semi-definite."""
    sigma = np.asarray(covariance, dtype=np.float64)
    if sigma.shape != (6, 6) or not np.isfinite(sigma).all():
        raise InvalidParameter(f"covariance: expected finite numbers (6, 6), got shape {sigma.shape}")
    slack = 1e-9 + 1e-6 * float(np.abs(sigma).max())
    if not np.allclose(sigma, sigma.T, rtol=0.0, atol=slack) or float(np.linalg.eigvalsh(sigma).min()) < -slack:
        raise InvalidParameter("covariance: expected a symmetric, positive semi-definite matrix")
    return 0.5 * (sigma + sigma.T)


def _twists(pose: SE3, sigma: Array, voxel_size_m: float) -> NDArray[np.float64]:
    """(6, 6) columns whose outer products sum to the covariance, in the map's axes, shifts in voxels."""
    values, vectors = np.linalg.eigh(sigma)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.concatenate([pose.rotation @ root[:3] / voxel_size_m, pose.rotation @ root[3:]])


def _axes_by_spread(sources: Array, centre: Array, twists: Array) -> NDArray[np.int64]:
    """(3,) the axes, that along which points are most uncertain last: rows of voxels along it are written fastest."""
    some = sources[:: max(1, len(sources) // 64), :, None] - centre[:, None]
    moved = twists[:3] + np.cross(twists[None, 3:], some, axis=1)
    return np.argsort((moved**2).sum(axis=(0, 2)), kind="stable")


def _pieces(sources: Array, classes: Array, certain: Array) -> tuple[Array | None, Array]:
    """The sources to be spread, piece by piece (None: all, as they are), and where each piece begins.

    sources (S, 3) [voxels], classes (S,) ascending; a piece is what of a class lies in one tile of the class's box
    """
    which = np.flatnonzero(certain)
    if not len(which):
        return which, which
    begins = np.flatnonzero(np.diff(classes[which].astype(np.int64), prepend=-1))
    cells = sources[which]
    low = np.minimum.reduceat(cells, begins)
    if (np.maximum.reduceat(cells, begins) - low).max() < TILE:
        return (None if len(which) == len(classes) else which), begins
    tiles = (cells - np.repeat(low, np.diff(begins, append=len(which)), axis=0)) // TILE
    order = np.lexsort((*tiles.T, classes[which]))
    keys = np.column_stack([classes[which], tiles])[order]
    new = np.append(True, (keys[1:] != keys[:-1]).any(axis=1))
    return which[order], np.flatnonzero(new)


@cache
def _table() -> tuple[Array, Array, Array, Array]:
    """What `kernels.tabulate` fills; mass and offset flat."""
    mass, offset = (np.empty((kernels.LEVELS, kernels.PHASES, kernels.WIDTH), np.float32) for _ in range(2))
    within, beside = np.empty(kernels.LEVELS), np.empty(kernels.LEVELS, np.int64)
    kernels.tabulate(mass, offset, within, beside)
    return read_only(mass.ravel()), read_only(offset.ravel()), read_only(within), read_only(beside)
