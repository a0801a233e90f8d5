"""A robot's way through a home: where it stands, and where it looks, so that nearly everything is seen.

In each room views are chosen greedily among many candidates: each next one is that which shows most of what was not, or
seldom, seen before (next-best-view planning; Connolly 1985).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from scenegraph.simulation.driving import FloorGrid
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home

CAMERA_HEIGHT_M = 1.3
_SKETCH = CameraIntrinsics(fx=52.5, fy=52.5, cx=31.5, cy=23.5, width=64, height=48)  # the camera, ten times coarser
_SKETCH_PIXELS = 3  # of a thing that is seen well enough
_SPOTS, _HEADINGS, _PITCHES = 10, 8, (-0.5, -0.28, 0.55)
_NEAR_M, _FAR_M = 0.5, 5.0  # what is nearer or farther is not counted as seen
_CELL_M = 0.2
_STRIDE_M = 1.2  # between two images on the way
_SURFACE_GAIN = np.array([1.0, 0.5, 0.2, 0.0])  # of a surface cell that was seen 0, 1, 2 … times
_THING_GAIN = np.array([25.0, 25.0, 25.0, 12.0, 8.0, 5.0, 0.0])
_SIDE_GAIN = np.array([10.0, 0.0])  # of a thing seen from a new quarter


@dataclass(frozen=True)
class Step:
    """Where the robot and its camera (optical frame) truly are, and in which room."""

    T_map_base: SE3
    T_map_camera: SE3
    room: str


class Tour:
    """The steps of one way through all rooms of a home.

    images_per_room   views the robot takes in each room, beside those on its way there, ≥ 1
    """

    def __init__(self, home: Home, *, images_per_room: int = 30) -> None:
        if images_per_room < 1:
            raise InvalidParameter(f"images_per_room: expected at least 1, got {images_per_room}")
        self.home = home
        self._grid = FloorGrid(home.plan, home.placed)
        self._seen: dict[int, int] = {}
        self.steps: tuple[Step, ...] = tuple(self._walk(images_per_room))

    def __len__(self) -> int:
        return len(self.steps)

    def _walk(self, images_per_room: int) -> list[Step]:
        steps: list[Step] = []
        here = self._grid.start()
        for room in self._grid.order(here):
            views = self._choose(room, images_per_room)
            while views:
                there = min(views, key=lambda cell: self._grid.distance(here, cell))
                steps.extend(self._on_the_way(here, there))
                steps.extend(sorted(views.pop(there), key=_heading))
                here = there
        return steps

    def _on_the_way(self, here: int, there: int) -> list[Step]:
        path = self._grid.path(here, there)
        steps = []
        last = path[0]
        for a, b in pairwise(path):
            if np.linalg.norm(b - last) > _STRIDE_M:
                heading = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
                steps.append(self._step(b, heading, -0.35, self._grid.room_at(b)))
                last = b
        return steps

    def _step(self, spot: Array, heading: float, pitch: float, room: str) -> Step:
        """At `spot` (2,) in the home's frame, looking along `heading` there, `pitch` [rad] above the horizon."""
        c, s = np.cos(heading), np.sin(heading)
        T_home_base = SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), [spot[0], spot[1], 0.0])
        cp, sp = np.cos(pitch), np.sin(pitch)
        forward, right = np.array([cp, 0.0, sp]), np.array([0.0, -1.0, 0.0])
        T_base_camera = SE3(np.stack([right, np.cross(forward, right), forward], axis=1), [0.0, 0.0, CAMERA_HEIGHT_M])
        T_map_base = self.home.T_map_home @ T_home_base
        return Step(T_map_base, T_map_base @ T_base_camera, room)

    # -- choosing views -----------------------------------------------------------------------------------
    def _choose(self, room: str, count: int) -> dict[int, list[Step]]:
        """`count` views in a room, by the cell of the floor that each is taken from."""
        spots = self._grid.spread(room, _SPOTS)
        candidates: list[tuple[int, Step]] = []
        for k, cell in enumerate(spots):
            headings = 2 * np.pi * (np.arange(_HEADINGS) + k / len(spots)) / _HEADINGS
            spot = self._grid.points[cell]
            candidates.extend((cell, self._step(spot, h, pitch, room)) for h in headings for pitch in _PITCHES)
        shown = [self._shows(step) for _, step in candidates]
        keys, column = np.unique(np.concatenate(shown), return_inverse=True)
        table = np.zeros((len(candidates), len(keys)), dtype=np.float32)
        table[np.repeat(np.arange(len(shown)), [len(s) for s in shown]), column] = 1.0
        times = np.array([self._seen.get(int(key), 0) for key in keys])
        kind = keys >> 40
        chosen: dict[int, list[Step]] = {}
        for _ in range(min(count, len(candidates))):
            gain = np.zeros(len(keys), dtype=np.float32)
            for which, gains in enumerate((_SURFACE_GAIN, _THING_GAIN, _SIDE_GAIN)):
                mine = kind == which
                gain[mine] = gains[np.minimum(times[mine], len(gains) - 1)]
            best = int((table @ gain).argmax())
            times += table[best] > 0
            table[best] = 0.0
            cell, step = candidates[best]
            chosen.setdefault(cell, []).append(step)
        self._seen.update(zip(keys.tolist(), times.tolist(), strict=True))
        return chosen

    def _shows(self, step: Step) -> Array:
        """What a view shows, as distinct keys: cells of surfaces, things, and the quarters they are seen from."""
        image = self.home.renderer.render(step.T_map_camera, _SKETCH, _FAR_M, colored=False)
        p_map = step.T_map_camera @ (_SKETCH.rays() * image.depth[..., None])
        cells = np.floor(p_map[image.depth > _NEAR_M] / _CELL_M).astype(np.int64) + 4096
        surface = np.unique((cells[:, 0] << 26) | (cells[:, 1] << 13) | cells[:, 2])
        pixels = np.bincount(image.entities[image.depth > 0], minlength=2)
        things = np.flatnonzero(pixels[1:] >= _SKETCH_PIXELS) + 1
        at = step.T_map_camera.translation
        quarters = []
        for k in things[things <= len(self.home.objects)]:
            x, y, _ = at - self.home.objects[k - 1].center
            quarters.append(4 * int(k) + int((np.arctan2(y, x) + np.pi) // (np.pi / 2)) % 4)
        return np.concatenate([surface, things | (1 << 40), np.array(quarters, dtype=np.int64) | (2 << 40)])


def _heading(step: Step) -> float:
    R = step.T_map_base.rotation
    return float(np.arctan2(R[1, 0], R[0, 0]))
