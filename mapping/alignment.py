"""Points laid on the surface of a model, with a prior on how far they are from it.

Frame to model, as KinectFusion aligns a camera to a room (Newcombe et al. 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import SE3
from mapping.kernels import registration as kernels
from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]

INDEPENDENT_POINTS = 100.0
"""All points together tell as much as so many would that err each on its own: the errors of a model and of a mask are
shared by many."""
ITERATIONS = 8
STILL = 1e-4
"""An alignment is done when a step is shorter than this [m, rad]."""
TRIED = 2
"""Of many places to begin at, the first and so many of the best others are followed."""
CLEARLY = 0.7
"""An alignment from a later start is taken when its cost is less than this share of an earlier one's."""
HUBER = 2.0
LEAST_KNOWN = 0.5
"""An alignment is trusted when this share of the points falls where the model knows its surface …"""
MOST_MISFIT_VOXELS = 0.5
"""… lies on it to within so many voxels and the noise of depth, …"""
MOST_SURPRISE = 16.0
"""… and its squared distance from what was foretold, in standard deviations, is no more than this."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """How points lie on a model.

    offset      (6,) x, y, z [m], roll, pitch, yaw [rad]: the perturbation that puts the points there
    covariance  (6, 6) of its error
    cost        mean distance of the points from the surface [m], where those off the model count as far
    trusted     whether to believe it
    """

    offset: Array
    covariance: Array
    cost: float
    trusted: bool


def align(model: TsdfMap, points: Array, sigma: Array, prior: Array, starts: Sequence[SE3]) -> Alignment:
    """The alignment of points (n, 3) [m] to the surface of a model, in its frame: of those that begin with the points
    moved by one of `starts`, the first that no later one beats clearly.

    sigma  (n,) [m] noise of the points;  prior  (6, 6) covariance of the offset about none at all [m, rad]
    """
    first, *others = starts
    if len(others) > TRIED:
        sums = np.zeros((6, 6)), np.zeros(6)
        others.sort(key=lambda start: _cost(model, len(points), *_accumulate(model, points, sigma, start, *sums)))
    best = _descend(model, points, sigma, prior, first)
    for start in others[:TRIED]:
        found = _descend(model, points, sigma, prior, start)
        if (not found.trusted, found.cost) < (not best.trusted, CLEARLY * best.cost):
            best = found
    return best


def _descend(model: TsdfMap, points: Array, sigma: Array, prior: Array, start: SE3) -> Alignment:
    """Gauss-Newton from one start, to the maximum a posteriori."""
    trust = np.linalg.inv(prior + 1e-12 * np.eye(6))
    pose, offset, used, misfit = start, start.log(), 0, 0.0
    information, vector = np.zeros((6, 6)), np.zeros(6)
    for _ in range(ITERATIONS):
        used, misfit = _accumulate(model, points, sigma, pose, information, vector)
        share = min(1.0, INDEPENDENT_POINTS / max(used, 1))
        information *= share
        step = np.linalg.solve(information + trust, share * vector - trust @ offset)
        if np.abs(step).max() < STILL:
            break
        pose = pose @ SE3.exp(step)
        offset = pose.log()
    trusted = (
        used >= LEAST_KNOWN * len(points)
        and misfit < MOST_MISFIT_VOXELS * model.voxel_size_m + sigma.mean()
        and offset @ trust @ offset < MOST_SURPRISE
    )
    cost = _cost(model, len(points), used, misfit)
    return Alignment(offset, np.linalg.inv(information + trust), cost, bool(trusted))


def _accumulate(
    model: TsdfMap, points: Array, sigma: Array, pose: SE3, information: Array, vector: Array
) -> tuple[int, float]:
    """Normal equations (6, 6), (6,) in place; returns how many points the model knows and their mean distance [m]."""
    information[:], vector[:] = 0.0, 0.0
    fields = model.store.fields
    used, misfit = kernels.accumulate(
        model.store.table, fields["distance"], fields["weight"], model.voxel_size_m, points, sigma,
        np.ascontiguousarray(pose.matrix[:3]), HUBER, information, vector,
    )  # fmt: skip
    return int(used), float(misfit)


def _cost(model: TsdfMap, n: int, used: int, misfit: float) -> float:
    far = 0.5 * model.truncation_m
    return (used * min(misfit, far) + (n - used) * far) / n
