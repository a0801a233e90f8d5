"""How far two occupancy maps say the same, and why they do not where they do not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.kernels.occupancy import UNKNOWN
from mapping.occupancy import OccupancyMap
from mapping.octomap import read_octomap
from tests.support import modes
from tests.support.modes import Beams, Configuration

GRAZE_M = 2e-5
"""OctoMap computes in single precision: 20 m are known to 2 µm, the steps of a walk to some more."""


def classes_of(*layers: OccupancyMap) -> tuple[np.ndarray, list[np.ndarray]]:
    """The voxel ijk (3,) of the first element, and dense classes of each map: 1 occupied, 0 free, −1 unknown."""
    blocks = np.concatenate([layer.block_ijk for layer in layers])
    first = blocks.min(axis=0) * 8
    nx, ny, nz = (int(n) for n in (blocks.max(axis=0) + 1) * 8 - first)
    dense = [layer.evidence_in(first, (nx, ny, nz)) for layer in layers]
    return first, [np.where(e == UNKNOWN, -1, e >= 0).astype(np.int8) for e in dense]


def beams_cast(configuration: Configuration, beams: Beams) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is cast, by definition: ends (N, 3) [m], whether they are hits, and whether single precision is sure of
    that beam."""
    size, reach = configuration.voxel_size_m, configuration.max_range_m
    ends, sure = beams.points_map, np.ones(len(beams.points), np.bool_)
    if configuration.discretize:
        border = np.abs(ends / size - np.rint(ends / size)).min(axis=1) * size < GRAZE_M
        certain = np.unique(np.floor(ends[~border] / size), axis=0)
        beside = np.floor((ends[border, None] + GRAZE_M * _CORNERS) / size).reshape(-1, 3)
        voxels, first = np.unique(np.concatenate([certain, beside]), axis=0, return_index=True)
        sure = first < len(certain)
        ends = (voxels + 0.5) * size
    lengths = np.linalg.norm(ends - beams.origin, axis=1)
    hit = lengths <= reach
    sure &= np.abs(lengths - reach) > GRAZE_M
    share = np.minimum(1.0, reach / np.maximum(lengths, 1e-12))[:, None]
    return beams.origin + share * (ends - beams.origin), hit, sure


_CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])


def why(voxel: np.ndarray, configuration: Configuration, cast: list[tuple[np.ndarray, ...]]) -> str:
    """Why single precision and ours can differ in a voxel (3,). `cast`: origin, ends, hits, sure of each scan."""
    size = configuration.voxel_size_m
    low, high = voxel * size, (voxel + 1) * size
    marks = []
    for origin, ends, hits, sure in cast:
        outer = (ends > low - GRAZE_M).all(axis=1) & (ends < high + GRAZE_M).all(axis=1)
        inner = (ends > low + GRAZE_M).all(axis=1) & (ends < high - GRAZE_M).all(axis=1)
        if (inner & hits & sure).any():
            marks.append("hit")
            continue
        if (outer & hits).any():
            return "an end within 20 µm of a voxel's face"
        passed = _passes(origin, ends, low + GRAZE_M, high - GRAZE_M) & sure & ~outer
        grazed = _passes(origin, ends, low - GRAZE_M, high + GRAZE_M) & ~inner
        if not passed.any() and grazed.any():
            return "a beam within 20 µm of a voxel's edge" if sure[grazed].any() else "a beam whose end is on a face"
        marks += ["miss"] * bool(passed.any())
    layer = configuration.ours()
    exact = 0.0
    for mark in marks:
        change = np.log(modes.HIT / (1 - modes.HIT)) if mark == "hit" else np.log(modes.MISS / (1 - modes.MISS))
        bounds = [np.log(p / (1 - p)) for p in (modes.LOWEST, modes.HIGHEST)]
        exact = float(np.clip(exact + change, *bounds))
    return "evidence within a step of even odds" if abs(exact) < 2 * layer.log_odds_step else "unexplained"


def _passes(origin: np.ndarray, ends: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which of the beams (N,) pass the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - origin) / (ends - origin), (high - origin) / (ends - origin)
    near, far = np.minimum(to_low, to_high).max(axis=1), np.maximum(to_low, to_high).min(axis=1)
    return (near <= far) & (far >= 0.0) & (near <= 1.0)


@dataclass(frozen=True)
class Agreement:
    """known: voxels that either map knows; kinds: (class here, class there) → how many; reasons of the first ones."""

    known: int
    kinds: Counter[tuple[str, str]]
    reasons: Counter[str]

    @property
    def differing(self) -> int:
        return self.kinds.total()

    @property
    def share(self) -> float:
        """Of the voxels known to either, those of the same class."""
        return 1.0 - self.differing / self.known

    def lines(self) -> list[str]:
        found = [f"{self.known} voxels known, same class on {self.share:.4%}; {self.differing} differ"]
        found += [f"    {count} {ours}, OctoMap {theirs}" for (ours, theirs), count in self.kinds.items()]
        examined = self.reasons.total()
        return found + [f"    {count} of {examined}: {reason}" for reason, count in self.reasons.items()]


def with_octomap(configuration: Configuration, scans: list[Beams], folder: Path) -> Agreement:
    """Fuse the scans with both and compare; reasons are sought for the first 200 voxels that differ."""
    layer, tree = configuration.ours(), configuration.theirs()
    for beams in scans:
        configuration.cast(layer, beams)
        configuration.insert(tree, beams)
    tree.updateInnerOccupancy()
    tree.writeBinary(str(folder / "theirs.bt"))
    first, (ours, theirs) = classes_of(layer, read_octomap(folder / "theirs.bt"))
    differing = np.argwhere(ours != theirs)
    cast = [(beams.origin, *beams_cast(configuration, beams)) for beams in scans] if len(differing) else []
    return Agreement(
        known=int(((ours >= 0) | (theirs >= 0)).sum()),
        kinds=Counter((_NAMES[ours[tuple(v)]], _NAMES[theirs[tuple(v)]]) for v in differing),
        reasons=Counter(why(first + voxel, configuration, cast) for voxel in differing[:200]),
    )


_NAMES = {1: "occupied", 0: "free", -1: "unknown"}
