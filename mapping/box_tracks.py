"""Things of which only boxes in space are known: detections without an image, tracked to things that last.

A box is the thing that it overlaps (intersection over union of the upright boxes), or whose class and place it shares;
one to one, the best pairs first. What matches is fused into one box; how sure a thing is rises with each view.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mapping.geometry import SE3
from mapping.observations import Box3d

Array: TypeAlias = NDArray[Any]

SAME_OVERLAP = 0.1
OTHER_OVERLAP = 0.4
"""Boxes of one thing overlap by this much at least, where they are of one class and where not: of two things that touch
the boxes overlap less."""
NEAR_SIDES = 0.5
NEAR_M = 0.15
"""Boxes of one class that overlap less are one thing when their centres are so many of its longest sides apart, or so
near: small things, seen by detectors that are not exact, and things that were pushed."""
VIEW_DOUBT = 0.5
"""A detection that is surely right halves the doubt that there is a thing; one that is less sure, less."""
MEMORY = 10.0
"""Detections over which a box is averaged: after so many it follows what is seen now."""


class UprightBox(NamedTuple):
    """A box that stands upright: centre (3,) [m], size (3,) [m] along its own axes, yaw [rad] of the first."""

    center: Array
    size: Array
    yaw: float

    @property
    def corners(self) -> Array:
        """(4, 2) seen from above, counter-clockwise."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        half = 0.5 * self.size[:2] * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        return np.asarray(half @ np.array([[c, s], [-s, c]]) + self.center[:2])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) of the axis-aligned box."""
        ground, up = self.corners, 0.5 * self.size[2]
        low, high = ground.min(axis=0), ground.max(axis=0)
        return np.array([*low, self.center[2] - up]), np.array([*high, self.center[2] + up])

    def holds(self, points: Array, margin_m: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] lie in the box or so far from it along its axes."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        local = (points - self.center) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray((np.abs(local) <= 0.5 * self.size + margin_m).all(axis=1))

    @staticmethod
    def about(box: Box3d, T_map_sensor: SE3) -> UprightBox:
        """The upright box about a detected one, turned as that is turned about the vertical."""
        T_map_box = T_map_sensor @ SE3.from_quaternion(box.rotation_wxyz, np.asarray(box.center, np.float64))
        axes = T_map_box.rotation
        level = max(range(3), key=lambda a: (round(float(np.hypot(*axes[:2, a])), 6), float(box.size[a])))
        yaw = float(np.arctan2(axes[1, level], axes[0, level]))
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        corners = T_map_box @ (0.5 * signs * box.size)
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        local = (corners - T_map_box.translation) @ turn
        low, high = local.min(axis=0), local.max(axis=0)
        return UprightBox(T_map_box.translation + turn @ (0.5 * (low + high)), high - low, yaw)


def overlap(a: UprightBox, b: UprightBox) -> float:
    """Intersection over union of the volumes of two upright boxes."""
    low = max(a.center[2] - 0.5 * a.size[2], b.center[2] - 0.5 * b.size[2])
    high = min(a.center[2] + 0.5 * a.size[2], b.center[2] + 0.5 * b.size[2])
    reach = 0.5 * (np.hypot(*a.size[:2]) + np.hypot(*b.size[:2]))
    if high <= low or np.hypot(*(a.center - b.center)[:2]) >= reach:
        return 0.0
    shared = _area(_clipped(a.corners, b.corners)) * (high - low)
    return float(shared / (np.prod(a.size) + np.prod(b.size) - shared))


def _clipped(subject: Array, window: Array) -> Array:
    """The part (K, 2) of a convex polygon inside another, both counter-clockwise (Sutherland & Hodgman 1974)."""
    for p, q in zip(window, np.roll(window, -1, axis=0), strict=True):
        if not len(subject):
            break
        side = (q[0] - p[0]) * (subject[:, 1] - p[1]) - (q[1] - p[1]) * (subject[:, 0] - p[0])
        kept: list[Array] = []
        for n in range(len(subject)):
            here, there = subject[n - 1], subject[n]
            if (side[n - 1] >= 0.0) != (side[n] >= 0.0):
                kept.append(here + (there - here) * (side[n - 1] / (side[n - 1] - side[n])))
            if side[n] >= 0.0:
                kept.append(there)
        subject = np.array(kept).reshape(-1, 2)
    return subject


def _area(polygon: Array) -> float:
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


class Sighting(NamedTuple):
    """One detected box in map, its class as detected, and how sure that is (0 … 1)."""

    label: str
    box: UprightBox
    confidence: float


@dataclass
class BoxTrack:
    """A thing of which boxes are known.

    votes   class → sum of the confidences of its detections;  doubt  how sure it is that there is no thing at all
    """

    id: int
    box: UprightBox
    first_seen_ns: int
    last_seen_ns: int
    views: int = 0
    weight: float = 0.0
    doubt: float = 1.0
    votes: dict[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The class with most votes (ties: the first by name)."""
        return min(self.votes, key=lambda c: (-self.votes[c], c))

    @property
    def confidence(self) -> float:
        """How sure it is that there is a thing, and that it is of its class."""
        return (1.0 - self.doubt) * self.votes[self.label] / sum(self.votes.values())

    def see(self, seen: Sighting, stamp_ns: int) -> None:
        """Fuse a detection into the box."""
        worth = max(seen.confidence, 1e-3)
        share = worth / (self.weight + worth)
        size, yaw = _turned_alike(seen.box, self.box.yaw)
        self.box = UprightBox(
            self.box.center + share * (seen.box.center - self.box.center),
            self.box.size + share * (size - self.box.size),
            self.box.yaw + share * (yaw - self.box.yaw),
        )
        self.weight = min(self.weight + worth, MEMORY)
        self.first_seen_ns, self.last_seen_ns = min(self.first_seen_ns, stamp_ns), max(self.last_seen_ns, stamp_ns)
        self.views += 1
        self.doubt *= 1.0 - VIEW_DOUBT * seen.confidence
        self.votes[seen.label] = self.votes.get(seen.label, 0.0) + worth


def _turned_alike(box: UprightBox, yaw: float) -> tuple[Array, float]:
    """Size and yaw of a box, named so that the yaw is within 45° of the one given: a box looks alike every quarter turn
    if its sides change names."""
    quarters = round((box.yaw - yaw) / (0.5 * np.pi))
    size = box.size[[1, 0, 2]] if quarters % 2 else box.size
    return size, box.yaw - quarters * 0.5 * np.pi


class BoxTracks:
    """Boxes of several views joined to things."""

    def __init__(self) -> None:
        self.tracks: dict[int, BoxTrack] = {}
        self._next_id = 1
        self._cells: dict[tuple[int, int], set[int]] = {}
        self._cells_of: dict[int, list[tuple[int, int]]] = {}

    def see(self, sightings: Sequence[Sighting], stamp_ns: int) -> set[int]:
        """Join the boxes of one message to known things, or found new ones; returns the ids of all of them."""
        near = sorted({i for seen in sightings for i in self.within(*seen.box.bounds, NEAR_M)})
        scores = np.array([[self._score(seen, self.tracks[i]) for i in near] for seen in sightings])
        scores = scores.reshape(len(sightings), len(near))
        row_of = dict(zip(*(a.tolist() for a in linear_sum_assignment(-scores)), strict=True))
        seen_ids = set()
        for n, seen in enumerate(sightings):
            if n in row_of and scores[n, row_of[n]] > 0.0:
                track = self.tracks[near[row_of[n]]]
            else:
                track = BoxTrack(self._next_id, seen.box, stamp_ns, stamp_ns)
                self.tracks[track.id] = track
                self._next_id += 1
            track.see(seen, stamp_ns)
            self._enter(track)
            seen_ids.add(track.id)
        return seen_ids

    @staticmethod
    def _score(seen: Sighting, track: BoxTrack) -> float:
        """How well a box fits a thing: 0 where it is none of it, more than 1 where they overlap."""
        shared = overlap(seen.box, track.box)
        same = seen.label in track.votes
        if shared >= (SAME_OVERLAP if same else OTHER_OVERLAP):
            return 1.0 + shared + 0.1 * same
        apart = float(np.linalg.norm(seen.box.center - track.box.center))
        reach = max(NEAR_M, NEAR_SIDES * float(min(seen.box.size.max(), track.box.size.max())))
        return max(0.0, 1.0 - apart / reach) if same else 0.0

    def within(self, low: Array, high: Array, reach_m: float = 0.0) -> list[int]:
        """The things, ascending, whose boxes may come within `reach_m` of the box from `low` to `high` (3,) [m]."""
        found = {i for cell in _cells(low - reach_m, high + reach_m) for i in self._cells.get(cell, ())}
        return sorted(found)

    def drop(self, track_id: int) -> None:
        """Forget a thing."""
        del self.tracks[track_id]
        for cell in self._cells_of.pop(track_id):
            self._cells[cell].discard(track_id)

    def _enter(self, track: BoxTrack) -> None:
        cells = _cells(*track.box.bounds)
        if self._cells_of.get(track.id) == cells:
            return
        for cell in self._cells_of.get(track.id, ()):
            self._cells[cell].discard(track.id)
        for cell in cells:
            self._cells.setdefault(cell, set()).add(track.id)
        self._cells_of[track.id] = cells

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """All things as JSON values."""
        tracks = [
            {**vars(t), "box": [t.box.center.tolist(), t.box.size.tolist(), t.box.yaw]} for t in self.tracks.values()
        ]
        return {"next_id": self._next_id, "tracks": tracks}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """What `document` gave."""
        made = cls()
        made._next_id = document["next_id"]
        for row in document["tracks"]:
            center, size, yaw = row["box"]
            track = BoxTrack(**{**row, "box": UprightBox(np.array(center), np.array(size), yaw)})
            made.tracks[track.id] = track
            made._enter(track)
        return made


CELL_M = 2.0


def _cells(low: Array, high: Array) -> list[tuple[int, int]]:
    (i0, j0), (i1, j1) = (np.floor(corner[:2] / CELL_M).astype(int).tolist() for corner in (low, high))
    return [(i, j) for i in range(i0, i1 + 1) for j in range(j0, j1 + 1)]
