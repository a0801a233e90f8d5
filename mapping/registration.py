"""Scans and images → poses: a pose with covariance is corrected by what the map already knows.

Frame-to-model alignment as in KinectFusion (Newcombe et al. 2011), with the point-to-surface distance read from the
signed distance field, and the given pose as a prior (maximum a posteriori; right perturbation T = T̂ · Exp(ξ)).
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import SE3
from mapping.kernels import registration as kernels
from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]

MAP_SIGMA = np.array([0.004, 0.004, 0.004, 0.0015, 0.0015, 0.0015])
"""How well the map itself is placed where it is seen again [m, rad]. It keeps a map from following its own drift: the
more a pose is trusted against this, the more the map is drawn to the poses."""
LEAST_SHARE = 0.25
"""A pose is corrected when at least this share of the points fall on known surface."""
ITERATIONS = 6
HUBER = 2.0


def refine_pose(tsdf: TsdfMap, p_sensor: Array, T_map_sensor: SE3, covariance: Array) -> SE3:
    """The pose that agrees best with the map and with the given one.

    p_sensor    (N, 3) [m] some hundreds to thousands of points in the sensor frame
    covariance  (6, 6) of the given pose: x, y, z, roll, pitch, yaw [m, rad] in the sensor frame

    Returns the given pose where too little of the map is seen, where the prior is exact, or where alignment fails.
    """
    points = np.ascontiguousarray(p_sensor, dtype=np.float64)
    covariance = np.asarray(covariance, dtype=np.float64)
    if len(points) < 50 or not tsdf.store.n_blocks or not np.trace(covariance) > 0.0:
        return T_map_sensor
    distance = np.linalg.norm(points, axis=1)
    sigma = 0.008 + 0.002 * distance**2
    prior = np.linalg.inv(covariance + 1e-12 * np.eye(6))
    fields = tsdf.store.fields
    pose, information = T_map_sensor, np.zeros((6, 6))
    for _ in range(ITERATIONS):
        information, vector = np.zeros((6, 6)), np.zeros(6)
        used, _ = kernels.accumulate(
            tsdf.store.table, fields["distance"], fields["weight"], tsdf.voxel_size_m, points, sigma,
            np.ascontiguousarray(pose.matrix[:3]), HUBER, information, vector,
        )  # fmt: skip
        if used < LEAST_SHARE * len(points):
            return T_map_sensor
        offset = (T_map_sensor.inverse() @ pose).log()
        step = np.linalg.solve(information + prior, vector - prior @ offset)
        pose = pose @ SE3.exp(step)
        if np.abs(step).max() < 1e-5:
            break
    offset = (T_map_sensor.inverse() @ pose).log()
    if offset @ prior @ offset > 40.0:  # far outside the prior: another surface was met
        return T_map_sensor
    # The alignment is only as good as the map: weigh it against the given pose once more, with the map's own error.
    posterior = np.linalg.inv(information + prior)
    alignment = posterior + np.diag(MAP_SIGMA**2)
    gain = covariance @ np.linalg.inv(covariance + alignment)
    return T_map_sensor @ SE3.exp(gain @ offset)
