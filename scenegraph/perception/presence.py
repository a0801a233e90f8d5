"""Is what is known still there? A thing is looked for where an image shows its place, and doubted when it is not seen.

A look is *contrary* when most of what the image shows of a thing's place is seen through, or belongs to something else,
and the thing has no mask. A thing that is out of view, behind something, where nothing was measured or where nothing is
labelled is not looked at: it keeps what was known of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.colors import likeness, no_colors, point_colors
from mapping.instances import Masks
from mapping.view import DepthView
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Cell: TypeAlias = tuple[int, int, int]

CONTRARY_LOOKS = 3.0
"""A thing has gone after so many contrary looks without one that saw it; one that was hardly seen before, after half as
many looks as there were views of it."""
FULL_LOOK_PIXELS = 250.0
"""A look at a thing of which fewer pixels would show counts less, …"""
APART_S = 0.25
"""Looks follow each other at least so long after, or they are one."""
RANGE_M = 5.0
SAMPLES = 64
"""Points of a thing that are looked for."""
LEAST_VISIBLE = 0.25
LEAST_POINTS = 6
"""An image looks at a thing when it shows this share of its place, and so many of the samples."""
CONTRARY_SHARE = 0.75
"""A look is contrary when this share of what is shown speaks against the thing."""
MARGIN_M = 0.05
MARGIN_SHARE = 0.015
AROUND_RAD = 0.02
"""A point is seen through when the image sees so much farther, at its pixel and beside it: depth and pose err."""
LIKE_COLORS = 0.8
LIKE_LOOK = 0.25
"""Where nothing is seen through and what is seen has the thing's colours, it is likely there, without a mask: a look
counts so much only."""
LEAST_PIXELS = 60.0
"""… and if these are fewer than so many, nothing: masks and poses may be off by as much."""
CELL_M = 1.0


class Presence:
    """Doubts about things that were looked for and not seen, by node id."""

    def __init__(self) -> None:
        self.doubts: dict[str, float] = {}
        self._looked_ns: dict[str, int] = {}
        self._samples: dict[str, Array] = {}
        self._face_m2: dict[str, float] = {}
        self._within: dict[str, set[Cell]] = {}
        self._cells: defaultdict[Cell, set[str]] = defaultdict(set)

    def place(self, node_id: str, shape: Shape | None) -> None:
        """Take note of where a thing is now; None: nowhere."""
        self._samples.pop(node_id, None)
        for cell in self._within.pop(node_id, ()):
            self._cells[cell].discard(node_id)
            if not self._cells[cell]:
                del self._cells[cell]
        if shape is None:
            self._looked_ns.pop(node_id, None)
            self.doubts.pop(node_id, None)
            return
        points = shape.points
        samples = points[np.linspace(0, len(points) - 1, min(len(points), SAMPLES)).astype(int)].astype(np.float64)
        self._samples[node_id] = samples
        self._face_m2[node_id] = len(points) * shape.voxel_size_m**2
        self._within[node_id] = _cells(samples)
        for cell in self._within[node_id]:
            self._cells[cell].add(node_id)

    def look(
        self,
        view: DepthView,
        masks: Masks | None,
        instance_of: Callable[[str], int],
        sure: Iterable[int],
        stamp_ns: int,
        colors_of: Callable[[str], Array] = lambda _: no_colors(),
    ) -> tuple[set[str], set[str]]:
        """What one image says: ids of the nodes that were looked for in vain, and of those that were doubted and seen.

        instance_of  the instance behind a node, 0 for none
        sure         instances that are well known: a mask of another that lies where a thing was may be its own
        colors_of    the colours (CELLS,) of a node's thing
        """
        behind = {n: instance_of(n) for n in self._in_view(view)}
        near = sorted(n for n, instance in behind.items() if instance)
        if not near:
            return set(), set()
        counts = np.array([len(self._samples[n]) for n in near])
        owner = np.repeat(np.arange(len(near)), counts)
        instance = np.array([behind[n] for n in near])
        other, past, visible, depth, pixel = _judge(
            np.concatenate([self._samples[n] for n in near]), view, masks, instance[owner], np.fromiter(sure, np.int64)
        )
        n_visible, n_other = np.bincount(owner, visible, len(near)), np.bincount(owner, other, len(near))
        nearness = np.bincount(owner, np.where(visible, 1.0 / np.maximum(depth, 0.1) ** 2, 0.0), len(near))
        pixels = np.array([self._face_m2[n] for n in near]) * nearness / counts * view.camera[12] * view.camera[13]
        looked = (n_visible >= LEAST_VISIBLE * counts) & (n_visible >= np.minimum(LEAST_POINTS, counts))
        contrary = looked & (n_other >= CONTRARY_SHARE * n_visible) & (pixels >= LEAST_PIXELS)
        seen = ~contrary & np.isin(instance, () if masks is None else masks.instance)
        found = {near[at] for at in np.flatnonzero(seen).tolist()} & self.doubts.keys()
        for node_id in found:
            del self.doubts[node_id]
        missed = set()
        worth = np.minimum(1.0, pixels / FULL_LOOK_PIXELS)
        if masks is not None and masks.color is not None and contrary.any():
            seen_past = np.bincount(owner, past, len(near)) > (1.0 - CONTRARY_SHARE) * n_visible
            some = np.flatnonzero(contrary[owner] & visible)
            shown = point_colors(owner[some], len(near), masks.color.reshape(-1, 3)[pixel[some]])[contrary]
            mine = np.array([colors_of(near[at]) for at in np.flatnonzero(contrary).tolist()])
            worth[contrary] *= np.where(~seen_past[contrary] & (likeness(shown, mine) >= LIKE_COLORS), LIKE_LOOK, 1.0)
        for at in np.flatnonzero(contrary).tolist():
            node_id = near[at]
            if stamp_ns - self._looked_ns.get(node_id, -(10**18)) >= APART_S * 1e9:
                self.doubts[node_id] = self.doubts.get(node_id, 0.0) + float(worth[at])
                self._looked_ns[node_id] = stamp_ns
                missed.add(node_id)
        return missed, found

    def gone(self, node_id: str, views: int) -> bool:
        """Whether a thing that was seen in so many images was looked for in vain often enough."""
        return self.doubts.get(node_id, 0.0) >= min(CONTRARY_LOOKS, max(1.5, 0.5 * views)) - 1e-9

    def suspects(self) -> set[str]:
        """The things that at least one good look did not find where they were."""
        return {node_id for node_id, doubt in self.doubts.items() if doubt >= 1.0}

    def faith(self, node_id: str) -> float:
        """By what the confidence in a thing is multiplied, 0 … 1: less with each contrary look."""
        return max(0.0, 1.0 - self.doubts.get(node_id, 0.0) / CONTRARY_LOOKS)

    def near(self, p_map: Array) -> set[str]:
        """The nodes with voxels in the cell of a point (3,) [m] and in those about it."""
        at = np.floor(np.asarray(p_map) / CELL_M).astype(int).tolist()
        about = product(*([a - 1, a, a + 1] for a in at))
        return set[str]().union(*(self._cells[i, j, k] for i, j, k in about if (i, j, k) in self._cells))

    def _in_view(self, view: DepthView) -> set[str]:
        camera = view.camera
        far = min(RANGE_M, view.farthest_m)
        rays = [
            ((u - camera[14]) / camera[12], (v - camera[15]) / camera[13], 1.0)
            for u in (0.0, camera[16])
            for v in (0.0, camera[17])
        ]
        rotation, eye = view.pose[:9].reshape(3, 3), view.pose[9:]
        corners = np.vstack([eye, eye + far * np.array(rays) @ rotation.T])
        low, high = np.floor(np.stack([corners.min(axis=0), corners.max(axis=0)]) / CELL_M).astype(int).tolist()
        along = [range(a, b + 1) for a, b in zip(low, high, strict=True)]
        cells = product(along[0], along[1], along[2])
        return set[str]().union(*(self._cells[cell] for cell in cells if cell in self._cells))

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, float]:
        """The doubts, as JSON values."""
        return dict(self.doubts)

    def restore(self, document: Mapping[str, float]) -> None:
        """Take over what `document` gave; things have been placed before."""
        self.doubts = {node_id: float(doubt) for node_id, doubt in document.items()}


def _cells(points: Array) -> set[Cell]:
    """The cells in which points (N, 3) lie."""
    return {(i, j, k) for i, j, k in np.floor(points / CELL_M).astype(int).tolist()}


def _judge(
    points: Array, view: DepthView, masks: Masks | None, instance: Array, sure: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Of points (n, 3) [m] of instances (n,): whether the image sees through each or shows something else there,
    whether it sees through, whether it shows the place at all, its depth [m], and its pixel, as one number."""
    camera = view.camera
    x, y, z = (points @ camera[:9].reshape(3, 3).T + camera[9:12]).T
    height, width = view.reach.shape
    around = max(1, round(AROUND_RAD * float(camera[12])))
    ahead = np.where((z > 0.1) & (z < RANGE_M), z, np.inf)
    u = np.floor(camera[12] * x / ahead + camera[14] + 0.5).astype(int)
    v = np.floor(camera[13] * y / ahead + camera[15] + 0.5).astype(int)
    inside = np.isfinite(ahead) & (np.minimum(u, v) >= around) & (u < width - around) & (v < height - around)
    at = np.flatnonzero(inside)
    u, v, margin = u[at], v[at], MARGIN_M + MARGIN_SHARE * z[at]
    here, beyond = np.abs(view.reach[v, u]), z[at] + margin
    shown = (here > 0.0) & (here >= z[at] - margin)
    seen_past = shown & (here > beyond)
    for dv, du in ((0, around), (0, -around), (around, 0), (-around, 0)):
        seen_past &= np.abs(view.reach[v + dv, u + du]) > beyond
    others = np.zeros(len(at), bool)
    if masks is not None:
        piece, label = masks.pieces[v, u], masks.labels[v, u]
        whose = masks.instance[piece]
        others = shown & ~seen_past & (whose != instance[at])
        others &= np.where(piece > 0, np.isin(whose, sure), label > 0)
        shown &= seen_past | (piece > 0) | (label > 0)
    other, past, visible = (np.zeros(len(points), bool) for _ in range(3))
    other[at], past[at], visible[at] = seen_past | others, seen_past, shown
    pixel = np.zeros(len(points), np.int64)
    pixel[at] = v * width + u
    return other, past, visible, z, pixel
