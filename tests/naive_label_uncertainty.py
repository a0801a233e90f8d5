"""Slow, obvious twins of evidence from uncertain poses: dictionaries, and the mean over very many poses."""

from __future__ import annotations

from collections import defaultdict
from math import erf, floor, sqrt

import numpy as np

from mapping.geometry import SE3

Tally = dict[tuple[int, int, int, int], float]
"""Evidence by voxel i, j, k and class."""


def tally(points: np.ndarray, labels: np.ndarray, weights: np.ndarray, voxel: float) -> Tally:
    """Evidence of labelled points where they lie."""
    found: defaultdict[tuple[int, int, int, int], float] = defaultdict(float)
    for p, label, weight in zip(points, labels, weights, strict=True):
        if label and weight > 0:
            found[(*(floor(c / voxel) for c in p), int(label))] += float(weight)
    return dict(found)


def as_tally(evidence: object) -> Tally:
    """A `LabelEvidence` as a dictionary."""
    rows = zip(evidence.ijk.tolist(), evidence.labels.tolist(), evidence.evidence.tolist(), strict=True)
    return {(*ijk, label): value for ijk, label, value in rows}


def distance(one: Tally, other: Tally) -> float:
    """The evidence that has to be moved to make one the other, as a share of it: total variation."""
    between = sum(abs(one.get(key, 0.0) - other.get(key, 0.0)) for key in one.keys() | other.keys())
    return 0.5 * between / sum(one.values())


def blended(belief: Tally, clouds: list[Tally], keep: float) -> Tally:
    """Equation (5), literally: each of N terms adds K/N of the old map and (1 − K)/N of what one noise makes of it."""
    found: defaultdict[tuple[int, int, int, int], float] = defaultdict(float)
    for cloud in clouds:
        for key, value in belief.items():
            found[key] += keep / len(clouds) * value
        for key, value in cloud.items():
            found[key] += (1.0 - keep) / len(clouds) * value
    return {key: value for key, value in found.items() if value > 0.0}


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz·Ry·Rx."""
    turns = [SE3.exp([0, 0, 0, *axis]).rotation for axis in ((roll, 0, 0), (0, pitch, 0), (0, 0, yaw))]
    return turns[2] @ turns[1] @ turns[0]


def moved(point: np.ndarray, T_map_sensor: SE3, root: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Where a point lies (N, 3) [m] if the pose was T·Exp(root·n), for each row n of `noise` (N, 6)."""
    p_sensor = np.broadcast_to(T_map_sensor.inverse() @ point, (len(noise), 3))
    shift, turn = np.split(noise @ root.T, 2, axis=1)
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    a, b, c = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    turned = p_sensor + a * np.cross(turn, p_sensor) + b * np.cross(turn, np.cross(turn, p_sensor))
    return T_map_sensor @ (turned + shift + b * np.cross(turn, shift) + c * np.cross(turn, np.cross(turn, shift)))


def mass_between(low: float, high: float, mean: float, sd: float, cut: float) -> float:
    """Mass of a Gaussian, cut off at `cut` standard deviations, between two numbers."""
    a, b = (min(max((x - mean) / sd, -cut), cut) / sqrt(2.0) for x in (low, high))
    return (erf(b) - erf(a)) / (2.0 * erf(cut / sqrt(2.0)))
