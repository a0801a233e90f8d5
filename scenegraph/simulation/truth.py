"""What was truly seen on a tour: which things count, and how much of each plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scenegraph.simulation.rendering import CAMERA
from scenegraph.simulation.seen_surface import SeenSurface
from scenegraph.simulation.shapes import Array

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home
    from scenegraph.simulation.noise import Segmenter
    from scenegraph.simulation.rendering import Rendered

COUNTABLE_PIXELS = 200
COUNTABLE_IMAGES = 3
PLANE_AREA_M2 = 0.5
PLANE_SEEN = 0.3
_CELL_M = 0.1
_SURFACE_STRIDE = 2
_STRIDE = 4  # every so many-th row and column is looked at for planes


class TruthRecorder:
    """Counts, from noise-free images at true poses, how often each thing and how much of each plane was seen.

    confused   ids of the things that the segmenter always mistakes for the same other class
    surface    the part of all surfaces that the images showed
    """

    def __init__(self, home: Home) -> None:
        self.home = home
        self.images = 0
        self.confused: frozenset[str] = frozenset()
        self.surface = SeenSurface()
        self._good = np.zeros(len(home.entities) + 1, dtype=np.int64)
        self._rays = CAMERA.rays()[::_STRIDE, ::_STRIDE]
        self._surface_rays = CAMERA.rays()[::_SURFACE_STRIDE, ::_SURFACE_STRIDE]
        self._cells = [
            np.zeros(tuple(max(1, int(np.ceil(e / _CELL_M))) for e in plane.extent), dtype=bool)
            for plane in home.structure
        ]

    def note_confused(self, segmenter: Segmenter) -> None:
        """Learn from the segmenter which things it always mistakes."""
        mistaken = np.flatnonzero(segmenter.persistent != segmenter.true_class)
        self.confused = frozenset(self.home.entities[k - 1] for k in mistaken)

    def record(self, rendered: Rendered) -> None:
        """Take in one image of the standard camera."""
        self.images += 1
        pixels = np.bincount(rendered.entities[rendered.depth > 0].ravel(), minlength=len(self._good))
        self._good += pixels >= COUNTABLE_PIXELS
        triangle = rendered.triangles[::_STRIDE, ::_STRIDE]
        depth = rendered.depth[::_STRIDE, ::_STRIDE]
        plane = np.where(triangle >= 0, self.home.triangle_plane[triangle], -1)
        plane[depth <= 0.0] = -1
        p_map = rendered.T_map_camera @ (self._rays * depth[..., None])
        for k in np.unique(plane[plane >= 0]):
            self._mark(int(k), p_map[plane == k])
        triangle = rendered.triangles[::_SURFACE_STRIDE, ::_SURFACE_STRIDE]
        depth = rendered.depth[::_SURFACE_STRIDE, ::_SURFACE_STRIDE]
        seen = (triangle >= 0) & (depth > 0.0)
        p_map = rendered.T_map_camera @ (self._surface_rays[seen] * depth[seen, None])
        self.surface.add(p_map, triangle[seen])

    def _mark(self, k: int, p_map: Array) -> None:
        plane, cells = self.home.structure[k], self._cells[k]
        at = ((p_map - plane.origin) @ plane.axes.T / _CELL_M).astype(int)
        at = np.clip(at, 0, np.array(cells.shape) - 1)
        cells[at[:, 0], at[:, 1]] = True

    # -- results ------------------------------------------------------------------------------------------
    @property
    def images_of(self) -> dict[str, int]:
        """Entity id → number of images in which it had at least 200 pixels with depth."""
        return {name: int(n) for name, n in zip(self.home.entities, self._good[1:], strict=True)}

    @property
    def countable(self) -> frozenset[str]:
        """Ids of the things (not doors or windows) that were seen well enough to count."""
        images = self.images_of
        return frozenset(o.id for o in self.home.objects if images[o.id] >= COUNTABLE_IMAGES)

    @property
    def plane_seen(self) -> dict[str, float]:
        """Plane id → share of its area that was seen, 0 … 1."""
        return {
            plane.id: float(
                min(1.0, cells.sum() / max(1.0, cells.size * plane.area / (plane.extent[0] * plane.extent[1])))
            )
            for plane, cells in zip(self.home.structure, self._cells, strict=True)
        }

    @property
    def countable_planes(self) -> frozenset[str]:
        """Ids of the true planes of at least 0.5 m² of which at least 30 % were seen."""
        seen = self.plane_seen
        return frozenset(p.id for p in self.home.structure if p.area >= PLANE_AREA_M2 and seen[p.id] >= PLANE_SEEN)
