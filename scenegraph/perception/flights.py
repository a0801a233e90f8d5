"""Flights of steps, measured: level strips of one height and one depth, one above the other in a row.

Where level surface rises, a plane through it is steep though each piece of it looks straight up: there a flight may be.
It is followed step by step from there, down and up. What may be called stairs is a rule (`rules/structure.pl`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.planes import PlaneMap

Array: TypeAlias = NDArray[Any]

LEVEL = 0.9
"""A surface is level when its normal points up so far (z)."""
PATCH_M = 1.2
"""Slopes are looked for in cubes of this size, with so many samples at least: two steps of most flights."""
LEAST_SAMPLES = 40
STEEP = (0.25, 1.3)
RAGGED_M = 0.1
"""How steep a plane through steps may be, and how far they may be from it, in the mean of squares."""
RISES_M = (0.07, 0.3)
GOINGS_M = (0.15, 0.5)
"""Steps are followed within these bounds, wider than what the rules call stairs."""
ALIKE_M = (0.06, 0.1)
"""Rise and going of one flight differ by less."""
STEP_SAMPLES = 8
NARROWEST_M = 0.3
SAME_HEIGHT_M = 0.03
REACH_M = (4.5, 0.8, 0.5)
"""What is read about a slope: along it, across it, and above and below."""


@dataclass(frozen=True, eq=False)
class Flight:
    """Levels in a row, lowest first, floors at the ends among them: their heights (K,) [m], and how far along `uphill`
    (2,) their middles are (K,) [m].

    across : (2,) where the flight begins and ends to the left of `uphill` [m];  points : (N, 3) its surface
    """

    uphill: Array
    heights: Array
    along: Array
    across: Array
    points: NDArray[np.float32]

    @property
    def rise_m(self) -> float:
        return float(np.median(np.diff(self.heights)))

    @property
    def going_m(self) -> float:
        return float(np.median(np.diff(self.along)))

    @property
    def unevenness_m(self) -> float:
        """By how much a rise differs from the median one, at most."""
        return float(np.abs(np.diff(self.heights) - self.rise_m).max())

    @property
    def width_m(self) -> float:
        return float(self.across[1] - self.across[0])

    @property
    def middle(self) -> Array:
        """(3,) [m]."""
        left = np.array([-self.uphill[1], self.uphill[0]])
        at = self.along.mean() * self.uphill + self.across.mean() * left
        return np.array([*at, self.heights.mean()])

    def holds(self, points: Array, margin_m: float) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] are of the steps or of what is below them."""
        along = points[:, :2] @ self.uphill
        left = points[:, 1] * self.uphill[0] - points[:, 0] * self.uphill[1]
        slope = np.interp(along, self.along, self.heights)
        end = 0.5 * self.going_m + margin_m
        return np.asarray(
            (along > self.along[0] - end)
            & (along < self.along[-1] + end)
            & (left > self.across[0] - margin_m)
            & (left < self.across[1] + margin_m)
            & (points[:, 2] < slope + self.rise_m + margin_m)
            & (points[:, 2] > self.heights[0] - self.rise_m - margin_m)
        )


def inclines(points: Array, patch_m: float = PATCH_M) -> list[tuple[Array, Array, int]]:
    """Where level surface, samples (N, 3) [m], rises evenly: a point (3,) on it, the way up (2,) and the number of
    samples, most first; looked for in cubes of `patch_m`."""
    if len(points) < LEAST_SAMPLES:
        return []
    cells = np.floor(points / patch_m).astype(np.int64)
    _, patch, count = np.unique(_keys(cells - cells.min(axis=0)), return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.bincount(patch, values, len(count)) / count

    middle = np.stack([mean(points[:, a]) for a in range(3)], axis=1)
    x, y, z = (points.astype(np.float64) - middle[patch]).T
    xx, xy, yy, xz, yz, zz = mean(x * x), mean(x * y), mean(y * y), mean(x * z), mean(y * z), mean(z * z)
    area = np.maximum(xx * yy - xy * xy, 1e-9)
    gradient = np.stack([yy * xz - xy * yz, xx * yz - xy * xz], axis=1) / area[:, None]
    steepness = np.hypot(*gradient.T)
    rest = zz - gradient[:, 0] * xz - gradient[:, 1] * yz
    good = (count >= LEAST_SAMPLES) & (steepness > STEEP[0]) & (steepness < STEEP[1]) & (rest < RAGGED_M**2)
    order = np.flatnonzero(good)[np.argsort(-count[good], kind="stable")]
    return [(middle[k], gradient[k] / steepness[k], int(count[k])) for k in order.tolist()]


def measure(planes: PlaneMap, block_size_m: float, at: Array, uphill: Array) -> Flight | None:
    """The flight of steps that leads up through a point (3,) [m] in a direction (2,), which its steps mend; None where
    there is none."""
    points, normals, _, _ = planes.samples_in(_blocks_along(at, uphill, block_size_m, PATCH_M))
    if _along(points[normals[:, 2] > LEVEL], at, uphill) is None:
        return None
    points, normals, _, _ = planes.samples_in(_blocks_along(at, uphill, block_size_m, REACH_M[0]))
    level = points[normals[:, 2] > LEVEL]
    flight = _along(level, at, uphill)
    if flight is None:
        return None
    mended = _gradient(level[flight.holds(level, 0.0)])
    again = None if mended is None else _along(level, flight.middle, mended)
    if again is not None and len(again.heights) >= len(flight.heights):
        flight = again
    return replace(flight, points=points[flight.holds(points, 0.0)])


def _gradient(points: Array) -> Array | None:
    """The way up (2,) of points (N, 3) [m]."""
    found = inclines(points - points.min(axis=0, initial=np.inf), patch_m=100.0)
    return found[0][1] if found else None


def _along(level: Array, at: Array, uphill: Array) -> Flight | None:
    left = np.array([-uphill[1], uphill[0]])
    local = np.column_stack([level[:, :2] @ uphill, level[:, :2] @ left, level[:, 2]])
    here = np.array([at[:2] @ uphill, at[:2] @ left, at[2]])
    near = (np.abs(local - here) < (PATCH_M, REACH_M[1], PATCH_M)).all(axis=1)
    row = _longest_row(_treads(local[near]))
    if len(row) < 3:
        return None
    row = _followed(local, _followed(local, row, +1), -1)
    across = np.median([tread.across for tread in row], axis=0)
    heights, along = np.array([tread.z for tread in row]), np.array([tread.along for tread in row])
    return Flight(uphill, heights, along, across, np.empty((0, 3), np.float32))


@dataclass(frozen=True)
class _Tread:
    along: float
    z: float
    across: tuple[float, float]

    @property
    def width_m(self) -> float:
        return self.across[1] - self.across[0]


def _blocks_along(at: Array, uphill: Array, block_size_m: float, reach_m: float) -> NDArray[np.int32]:
    """The blocks (K, 3) so far up and down a flight that leads through a point, at 33° give or take."""
    s, t, h = (
        np.linspace(-reach, reach, 1 + 2 * int(np.ceil(reach / (0.7 * block_size_m))))
        for reach in (reach_m, *REACH_M[1:])
    )
    s, t, h = (g.reshape(-1) for g in np.meshgrid(s, t, h, indexing="ij"))
    left = np.array([-uphill[1], uphill[0]])
    xy = at[:2] + s[:, None] * uphill + t[:, None] * left
    places = np.column_stack([xy, at[2] + 0.65 * s + h * (1.0 + 0.4 * np.abs(s))])
    keys = np.floor(places / block_size_m).astype(np.int64)
    low = keys.min(axis=0)
    _, first = np.unique(_keys(keys - low), return_index=True)
    return np.asarray(keys[first], np.int32)


def _keys(cells: Array) -> NDArray[np.int64]:
    """One number (N,) for each of cells (N, 3) ≥ 0."""
    sizes = cells.max(axis=0, initial=0) + 1
    return np.asarray((cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2])


def _treads(local: Array) -> list[_Tread]:
    """Level samples (N, 3), along, across and up [m], as treads, lowest first: those of one height."""
    if not len(local):
        return []
    order = np.argsort(local[:, 2])
    bins, counts = np.unique(np.floor(local[order, 2] / 0.02), return_counts=True)
    thick = bins[counts >= 3]
    parts = np.split(thick, np.flatnonzero(np.diff(thick) > SAME_HEIGHT_M / 0.02) + 1)
    found = []
    for part in parts:
        if len(part):
            mine = local[(local[:, 2] >= part[0] * 0.02) & (local[:, 2] < (part[-1] + 1) * 0.02)]
            tread = _tread(mine)
            if tread is not None:
                found.append(tread)
    return found


def _tread(local: Array) -> _Tread | None:
    if len(local) < STEP_SAMPLES:
        return None
    (begin, end), (right, left) = np.percentile(local[:, :2], (5.0, 95.0), axis=0).T
    if end - begin > GOINGS_M[1] or left - right < NARROWEST_M:
        return None
    return _Tread(0.5 * float(begin + end), float(np.median(local[:, 2])), (float(right), float(left)))


def _longest_row(treads: Iterable[_Tread]) -> list[_Tread]:
    """The longest row of treads each of which is a step above the one before; all steps are alike."""
    best: list[_Tread] = []
    row: list[_Tread] = []
    for tread in treads:
        if row and not _follows(row, tread):
            row = [row[-1]] if _follows(row[-1:], tread) else []
        row = [*row, tread]
        best = max(best, row, key=len)
    return best


def _follows(row: list[_Tread], upper: _Tread) -> bool:
    lower = row[-1]
    rise, going = upper.z - lower.z, upper.along - lower.along
    shared = min(lower.across[1], upper.across[1]) - max(lower.across[0], upper.across[0])
    if not (RISES_M[0] < rise < RISES_M[1] and GOINGS_M[0] < going < GOINGS_M[1]):
        return False
    if shared < 0.5 * max(lower.width_m, upper.width_m):
        return False
    if len(row) < 2:
        return True
    before = row[-2]
    return abs(rise - (lower.z - before.z)) < ALIKE_M[0] and abs(going - (lower.along - before.along)) < ALIKE_M[1]


def _followed(local: Array, row: list[_Tread], way: int) -> list[_Tread]:
    """A row of treads, and those that go on from its upper (way 1) or lower (way −1) end."""
    while True:
        rise, going = (float(np.median(np.diff([getattr(t, name) for t in row]))) for name in ("z", "along"))
        end = row[-1] if way > 0 else row[0]
        ahead = np.array([end.along + way * going, 0.5 * sum(end.across), end.z + way * rise])
        reach = (0.5 * going, 0.5 * end.width_m + 0.05, SAME_HEIGHT_M)
        tread = _tread(local[(np.abs(local - ahead) < reach).all(axis=1)])
        if tread is None or tread.width_m < 0.5 * end.width_m or abs(tread.along - ahead[0]) > ALIKE_M[1]:
            return row
        row = [*row, tread] if way > 0 else [tread, *row]
