"""The ground that a thing covers, where one side of it was seen only: on the boards of shelves, in open cabinets.

What lies there was seen from the front, or in part behind what stands beside it. Its footprint is completed along the
depth of what houses it, or along its own shorter side, within its house and as far as space was not seen to be free,
until it is about as deep as it is broad.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import shapes as kernels
from scenegraph.graph import Box
from scenegraph.perception.shapes import HEADROOM_M, Shape

Array: TypeAlias = NDArray[Any]

HOUSED_SHARE = 0.8
"""What has so much of its footing in the box of another is in it (`footing_inside_share` in the rules)."""
STRAY_SHARE = 0.02
"""Share of the points that may lie beyond either end along the axes of the box: what bled onto the shelf."""
SQUARE = 0.85
"""A thing is taken to be so deep as compared with its breadth, where its depth was not seen."""
SLENDER = 0.6
"""What is thinner than this, as compared with its breadth, goes into the depth of its house, as books do; of what is
not, the shorter side is the one that was not seen whole."""
HIDDEN_SHARE = 0.5
HIDDEN_BESIDE_SHARE = 0.7
WITHIN_SHARE = 0.6
"""It goes on where this share of its next slice was not seen to be free, into the depth or along the house, where
neighbours hide it as well; and where this share lies within the box."""
SLICE_SAMPLES = (5, 4)
"""Points of a slice across and up."""
MARGIN_M = 0.02
DEEPEST_M = 0.4
"""No footprint is completed by more than this."""


def house_of(mine: Shape, others: Mapping[str, Shape]) -> str | None:
    """The thing (the smallest of `others`) in whose box a thing stands, under a part of it."""
    low, high = mine.bounds
    middle = 0.5 * (low + high)[:2]
    about = [
        name
        for name, other in others.items()
        if other.lowest < mine.lowest < other.highest - HEADROOM_M
        and (other.bounds[0][:2] <= middle).all()
        and (other.bounds[1][:2] >= middle).all()
    ]
    if not about:
        return None
    start = np.column_stack([mine.footing, np.full(len(mine.footing), mine.lowest)])
    for name in sorted(about, key=lambda name: (float(others[name].box.size.prod()), name)):
        if float(others[name].box.contains(start, 0.5 * others[name].voxel_size_m).mean()) >= HOUSED_SHARE:
            return name
    return None


def completed(mine: Shape, house: Box, seen_free: Callable[[Array], Array]) -> Array:
    """The footprint (K, 2), convex and counter-clockwise, of a thing within the box of another, [m].

    seen_free: which points (N, 3) lie in space that was seen to be free
    """
    _, _, _, _, yaw = mine.rectangle
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    ground = mine.points[:, :2].astype(np.float64)
    local = ground @ turn.T
    low, high = np.quantile(local, [STRAY_SHARE, 1.0 - STRAY_SHARE], axis=0)
    kept = ((local >= low) & (local <= high)).all(axis=1)
    hull: Array = kernels.convex_hull(ground[kept])
    extent = high - low
    depth = int(np.argmax(np.abs(turn @ house.rotation[:2, 1])))  # along the shorter side of its house
    side = depth if extent.min() < SLENDER * extent.max() else int(extent.argmin())
    missing = min(SQUARE * float(extent[1 - side]) - float(extent[side]), DEEPEST_M)
    if missing < mine.voxel_size_m:
        return hull
    enough = HIDDEN_SHARE if side == depth else HIDDEN_BESIDE_SHARE
    before, after = (
        _hidden_depth(mine, house, seen_free, turn, low, high, side, up, missing, enough) for up in (False, True)
    )
    half = 0.5 * missing
    low[side] -= min(before, max(half, missing - after))
    high[side] += min(after, max(half, missing - before))
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]]) @ turn
    return np.asarray(kernels.convex_hull(np.concatenate([hull, corners]))) if before + after > 0.0 else hull


def _hidden_depth(
    mine: Shape, house: Box, seen_free: Callable[[Array], Array], turn: Array, low: Array, high: Array, side: int,
    up: bool, most: float, enough: float,
) -> float:  # fmt: skip
    """How far [m], up to `most`, slices beyond one end of a thing's rectangle lie in its house and were not seen to be
    free by `enough` of their points."""
    step = mine.voxel_size_m
    depths = step * (1 + np.arange(int(np.ceil(most / step - 1e-9))))
    across = np.linspace(low[1 - side] + 0.5 * step, high[1 - side] - 0.5 * step, SLICE_SAMPLES[0])
    lift = min(MARGIN_M, 0.3 * (mine.highest - mine.lowest))
    heights = np.linspace(mine.lowest + lift, mine.highest - lift, SLICE_SAMPLES[1])
    d, a, z = np.meshgrid(depths, across, heights, indexing="ij")
    local = np.empty((d.size, 2))
    local[:, side] = high[side] + d.ravel() if up else low[side] - d.ravel()
    local[:, 1 - side] = a.ravel()
    at = np.column_stack([local @ turn, z.ravel()])
    hidden = (~seen_free(at)).reshape(len(depths), -1).mean(axis=1) >= enough
    hidden &= house.contains(at, 0.0).reshape(len(depths), -1).mean(axis=1) >= WITHIN_SHARE
    return min(most, step * float(np.logical_and.accumulate(hidden).sum()))
