"""How a rigid thing moves: its pose and velocity with their covariance, foretold and corrected.

A Kalman filter on the pose's error (left perturbation in map) and on the velocity, which is an Ornstein-Uhlenbeck
process: what moves goes on moving for a while, and nobody knows what it does after that (Uhlenbeck & Ornstein, *On the
theory of the Brownian motion*, 1930; Singer, *Estimating optimal tracking filter performance for manned maneuvering
targets*, 1970, has the same for accelerations). So one model serves from one image to the next and for a thing that
has not been seen for a minute.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import SE3

Array: TypeAlias = NDArray[Any]

MEMORY_S = 1.5
"""After this time a velocity has decayed to 1/e, as far as is known without looking."""
SPEED_MPS = 1.0
LEAN_RADPS, TURN_RADPS = 0.15, 0.8
"""Standard deviations of what is not known to stand still: along each axis, about the level ones, and about the upright
one, as most of what moves by itself stays upright."""
_SPREAD = np.repeat([SPEED_MPS, LEAN_RADPS, TURN_RADPS], (3, 2, 1))
MOST_TURN_RAD = 1.0
"""The standard deviation of a rotation that nothing tells of (a ball's) is kept at this."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Pose and velocity of a thing at a time.

    pose        T_map_thing
    velocity    (6,) of the thing's origin [m/s] and about it [rad/s], along the axes of map
    covariance  (12, 12) of the errors of position [m], rotation [rad] (left: R = Exp(θ) · R̂), and velocity
    """

    stamp_ns: int
    pose: SE3
    velocity: Array
    covariance: Array

    @staticmethod
    def at_rest(stamp_ns: int, pose: SE3, sigma_m: float) -> Motion:
        """A pose seen once, of whose motion nothing is known; the thing's frame is what it is then."""
        sigma = np.concatenate([np.full(3, sigma_m), np.zeros(3), _SPREAD])
        return Motion(stamp_ns, pose, np.zeros(6), np.diag(sigma**2))

    def at(self, stamp_ns: int) -> Motion:
        """As foretold for a time that is not before this one; for an earlier one, as it is."""
        t = 1e-9 * (stamp_ns - self.stamp_ns)
        if t <= 0.0:
            return self
        left = np.exp(-t / MEMORY_S)
        reach = MEMORY_S * (1.0 - left)
        step = reach * self.velocity
        pose = SE3(SE3.exp([0.0, 0.0, 0.0, *step[3:]]).rotation @ self.pose.rotation, self.pose.translation + step[:3])
        variance = _SPREAD**2
        carry = np.eye(12)
        carry[:6, 6:] = reach * np.eye(6)
        carry[6:, 6:] = left * np.eye(6)
        covariance = carry @ self.covariance @ carry.T
        of_place = MEMORY_S**2 * (2.0 * t / MEMORY_S - 3.0 + 4.0 * left - left**2)
        of_both = MEMORY_S * (1.0 - left) ** 2
        six = np.arange(6)
        covariance[six, six] += max(of_place, 0.0) * variance
        covariance[six, six + 6] += of_both * variance
        covariance[six + 6, six] += of_both * variance
        covariance[six + 6, six + 6] += (1.0 - left**2) * variance
        widest = float(np.sqrt(covariance[[3, 4, 5], [3, 4, 5]].max()))
        if widest > MOST_TURN_RAD:
            scale = np.ones(12)
            scale[3:6] = MOST_TURN_RAD / widest
            covariance *= np.outer(scale, scale)
        return Motion(stamp_ns, pose, left * self.velocity, covariance)

    def given_pose(self, offset: Array, covariance: Array) -> Motion:
        """Knowing that the pose is off by `offset` (6,) [m, rad] with this `covariance` (6, 6), both as they follow
        from what was foretold *and* what was measured."""
        prior = self.covariance[:6, :6] + 1e-12 * np.eye(6)
        gain = np.linalg.solve(prior, self.covariance[:6]).T  # of everything, (12, 6)
        return self._moved(gain @ offset, self.covariance - gain @ (prior - covariance) @ gain.T)

    def given_place(self, off_m: Array, sigma_m: float) -> Motion:
        """Knowing that the thing lies `off_m` (3,) away from where it was foretold, to within `sigma_m`, and of its
        rotation nothing."""
        gain = np.linalg.solve(self.covariance[:3, :3] + sigma_m**2 * np.eye(3), self.covariance[:3]).T
        return self._moved(gain @ off_m, self.covariance - gain @ self.covariance[:3])

    def _moved(self, error: Array, covariance: Array) -> Motion:
        rotation = SE3.exp([0.0, 0.0, 0.0, *error[3:6]]).rotation @ self.pose.rotation
        pose = SE3(rotation, self.pose.translation + error[:3])
        return Motion(self.stamp_ns, pose, self.velocity + error[6:], 0.5 * (covariance + covariance.T))

    # -- as numbers ---------------------------------------------------------------------------------------
    def row(self) -> Array:
        """(162,) everything but the stamp."""
        return np.concatenate([pose_row(self.pose), self.velocity, self.covariance.ravel()])

    @staticmethod
    def from_row(stamp_ns: int, row: Array) -> Motion:
        """What `row` gave."""
        return Motion(stamp_ns, pose_of(row[:12]), row[12:18].copy(), row[18:].reshape(12, 12).copy())


def pose_row(pose: SE3) -> Array:
    """(12,) rotation row by row, translation: unlike a quaternion it gives the very same pose again."""
    return np.concatenate([pose.rotation.ravel(), pose.translation])


def pose_of(row: Array) -> SE3:
    """What `pose_row` gave."""
    return SE3(row[:9].reshape(3, 3), row[9:])
