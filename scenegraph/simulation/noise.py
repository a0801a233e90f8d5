"""What is wrong with real sensors, segmenters and localisation: seeded, and each kind on its own.

The figures are those of a structured-light camera (Nguyen et al. 2012: σ = 1.2 mm + 1.9 mm · (z − 0.4)²), a panoptic
segmenter and a laser localisation indoors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numba import njit
from numpy.random import Generator

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from scenegraph.simulation.shapes import Array


@dataclass(frozen=True)
class NoiseModel:
    """How strong each kind of noise is; the defaults are *realistic*, `NoiseModel.none()` has none.

    depth_base_m, depth_growth    σ = base + growth · (z − 0.4)² [m]
    dropout_px                    depth is missing this far from a depth discontinuity
    bleed_px                      masks of things grow over their neighbours by a random number of pixels in this range
    missed, mislabelled           share of things an image that are not segmented, or get a wrong class
    confused                      share of things that always get the same wrong class, one each
    position_m, rotation_rad      σ of each coordinate and of each angle of the reported pose
    range_m                       σ of a lidar's distances

    Raises `InvalidParameter` on a share outside 0 … 1, a negative σ or number of pixels, or a range that is none.
    """

    depth_base_m: float = 0.0012
    depth_growth: float = 0.0019
    dropout_px: int = 2
    bleed_px: tuple[int, int] = (3, 8)
    missed: float = 0.10
    mislabelled: float = 0.05
    confused: float = 0.05
    position_m: float = 0.01
    rotation_rad: float = float(np.deg2rad(0.5))
    range_m: float = 0.01

    def __post_init__(self) -> None:
        for name in ("missed", "mislabelled", "confused"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise InvalidParameter(f"{name}: expected a share of the things, 0 … 1, got {value!r}")
        for name in ("depth_base_m", "depth_growth", "dropout_px", "position_m", "rotation_rad", "range_m"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise InvalidParameter(f"{name}: expected a number ≥ 0, got {value!r}")
        low, high = self.bleed_px
        if not 0 <= low <= high:
            raise InvalidParameter(
                f"bleed_px: expected a range of pixels (low ≤ high, both ≥ 0), got {self.bleed_px!r}"
            )

    @staticmethod
    def none() -> NoiseModel:
        """A perfect sensor."""
        return NoiseModel(0.0, 0.0, 0, (0, 0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def covariance(self) -> Array:
        """(6, 6) of the reported sensor pose: x, y, z, roll, pitch, yaw."""
        return np.diag([self.position_m**2] * 3 + [self.rotation_rad**2] * 3)

    def perturbed(self, T: SE3, rng: Generator) -> SE3:
        """The pose as it is reported: T · Exp(ξ)."""
        if self.position_m == 0.0 and self.rotation_rad == 0.0:
            return T
        xi = rng.normal(size=6) * np.repeat([self.position_m, self.rotation_rad], 3)
        return T @ SE3.exp(xi)

    def depth_mm(self, depth: Array, rng: Generator) -> Array:
        """Depth (H, W) float32 [m] as the camera reports it, (H, W) uint16 [mm]; 0 = not measured."""
        noisy = depth
        if self.depth_base_m or self.depth_growth:
            sigma = np.float32(self.depth_base_m) + np.float32(self.depth_growth) * (depth - np.float32(0.4)) ** 2
            noisy = depth + sigma * rng.standard_normal(depth.shape, dtype=np.float32)
        millimetres = np.rint(np.clip(noisy, 0.0, 65.0) * 1000.0).astype(np.uint16)
        millimetres[depth <= 0.0] = 0
        if self.dropout_px:
            millimetres[grown(discontinuities(depth), self.dropout_px)] = 0
        return millimetres


Noise: TypeAlias = Literal["none", "realistic"] | NoiseModel
"""A noise model, or one of the two that have a name."""


def discontinuities(depth: Array) -> Array:
    """(H, W) bool: pixels beside which the depth [m] jumps by more than 3 cm and 3 % (and more than a slope would)."""
    edge = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        d = depth if axis == 0 else depth.T
        e = edge if axis == 0 else edge.T
        jump = np.abs(np.diff(d, axis=0)) > np.maximum(0.03, 0.03 * np.minimum(d[:-1], d[1:]))
        e[:-1] |= jump
        e[1:] |= jump
    return edge


def grown(mask: Array, pixels: int) -> Array:
    """The mask (H, W) widened so that it covers `pixels` rows and columns on each side of every edge.

    A discontinuity marks the two pixels that it parts, so it is widened by one less.
    """
    for _ in range(pixels - 1):
        wide = mask.copy()
        wide[1:] |= mask[:-1]
        wide[:-1] |= mask[1:]
        wide[:, 1:] |= mask[:, :-1]
        wide[:, :-1] |= mask[:, 1:]
        mask = wide
    return mask


@njit(cache=True)
def bleed(out: Array, entities: Array, radius: Array, rank: Array, winner: Array) -> None:
    """Let the mask of each entity grow over its neighbours, in place.

    out      (H, W) int32, at first a copy of `entities`
    entities (H, W) int32, 0 = background, which does not grow
    radius   (n + 1,) int64 how far each entity grows [px]
    rank     (n + 1,) int64, 0 for the background: an entity grows over those of lower rank, and the highest wins
    winner   (H, W) int64 of zeros: the rank that took each pixel
    """
    height, width = entities.shape
    for v in range(height):
        for u in range(width):
            e = entities[v, u]
            if e == 0 or radius[e] == 0:
                continue
            inside = (
                (v == 0 or entities[v - 1, u] == e)
                and (v == height - 1 or entities[v + 1, u] == e)
                and (u == 0 or entities[v, u - 1] == e)
                and (u == width - 1 or entities[v, u + 1] == e)
            )
            if inside:
                continue
            r = radius[e]
            for dv in range(-r, r + 1):
                for du in range(-r, r + 1):
                    p, q = v + dv, u + du
                    if du * du + dv * dv > r * r or p < 0 or q < 0 or p >= height or q >= width:
                        continue
                    if rank[e] > rank[entities[p, q]] and rank[e] > winner[p, q]:
                        winner[p, q] = rank[e]
                        out[p, q] = e


@dataclass(frozen=True)
class Segmentation:
    """A segmenter's view of an image: labels (H, W) uint16 and instances (H, W) uint32, 0 = none."""

    labels: Array
    instances: Array


@dataclass(frozen=True)
class Segmenter:
    """Gives images labels and instances, with the faults of `noise`.

    true_class   (n + 1,) uint16 class id of each entity; 0 for the background
    confusable   ids of the thing classes, one of which a wrong label is
    persistent   (n + 1,) uint16 the class each entity is given when nothing else goes wrong
    """

    noise: NoiseModel
    true_class: Array
    confusable: Array
    persistent: Array

    @staticmethod
    def make(noise: NoiseModel, true_class: Array, confusable: Array, rng: Generator) -> Segmenter:
        """Draws which things are always mistaken, and for what: exactly the share `noise.confused` of the things."""
        things = np.flatnonzero(np.isin(true_class, confusable))
        persistent = true_class.copy()
        for k in rng.permutation(things)[: round(noise.confused * len(things))]:
            persistent[k] = rng.choice(confusable[confusable != true_class[k]])
        return Segmenter(noise, true_class, confusable, persistent)

    def segment(self, entities: Array, labels: Array, rng: Generator) -> Segmentation:
        """What the segmenter says of an image with the true `entities` (H, W) int32 and `labels` (H, W) uint16."""
        n = len(self.true_class)
        low, high = self.noise.bleed_px
        seen = entities
        if high:
            radius = rng.integers(low, high + 1, n)
            seen = entities.copy()
            rank = np.append(0, rng.permutation(n - 1) + 1)
            bleed(seen, entities, radius, rank, np.zeros(entities.shape, np.int64))
        missed = rng.random(n) < self.noise.missed
        wrong = rng.random(n) < self.noise.mislabelled
        given = self.persistent.copy()
        for k in np.flatnonzero(wrong):
            given[k] = rng.choice(self.confusable[self.confusable != self.true_class[k]])
        given[missed] = 0
        number = np.zeros(n, dtype=np.uint32)
        number[1:] = rng.permutation(n - 1) + 1
        number[missed] = 0
        number[0] = 0
        return Segmentation(np.where(seen > 0, given[seen], labels).astype(np.uint16), number[seen])
