"""What single images say of each voxel: the baseline that fusion over views has to beat, and how often each was seen.

Direct projection (the first baseline of Martín et al. 2021): a pixel with a label and a depth labels the voxel in which
its point lies, where the map took the image to be seen from. Masks are not cleaned and views are not fused.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.grid import point_to_ijk
from mapping.observations import RgbdImage

__all__ = ["ViewLog", "pack"]

Array: TypeAlias = NDArray[Any]

STEP = 2
"""Every so many-th row and column is looked at: a pixel of these is still narrower than a voxel of 2.5 cm at 5 m."""
_BITS = 21
_ZERO = 1 << (_BITS - 1)
_IMAGE_BITS = 15
"""An image spans less than 2¹⁵ voxels along each axis."""


def pack(ijk: ArrayLike) -> NDArray[np.int64]:
    """Voxels (N, 3) as one number each (N,), in the order of their indices; within ±2²⁰."""
    return _join((np.asarray(ijk, np.int64) + _ZERO).T, _BITS)


def _join(indices: Array, bits: int) -> NDArray[np.int64]:
    """Indices (3, N) ≥ 0 as numbers (N,), so many bits each."""
    return np.asarray(indices[0] << 2 * bits | indices[1] << bits | indices[2])


def _split(keys: Array, bits: int) -> NDArray[np.int64]:
    """The indices (N, 3) that `_join` joined."""
    return np.stack([keys >> 2 * bits, keys >> bits, keys], axis=1) & ((1 << bits) - 1)


class ViewLog:
    """The label that each image gives each voxel it sees.

    voxel_size_m  edge of the voxels [m], those of the map that is judged
    range_m       labels further away than this are left out, as by the map [m]
    """

    def __init__(self, voxel_size_m: float, range_m: float) -> None:
        self.voxel_size_m = voxel_size_m
        self.range_m = range_m
        self._voxels: list[NDArray[np.int64]] = []
        self._labels: list[NDArray[np.uint16]] = []

    def add(self, image: RgbdImage, T_map_camera: SE3) -> None:
        """Take down one image: of each voxel the label that most of its pixels have (ties: the lowest class id).

        Raises `InvalidObservation` when it has no labels.
        """
        if image.labels is None:
            raise InvalidObservation("labels: expected an image with labels, got one without")
        every = (slice(None, None, STEP),) * 2
        depth, labels = image.depth_m[every], image.labels[every]
        wanted = (depth > 0.0) & (depth < self.range_m) & (labels > 0)
        if not wanted.any():
            return
        p_camera = image.intrinsics.rays()[every][wanted] * depth[wanted][:, None]
        p_map = np.einsum("ij,nj->in", T_map_camera.rotation, p_camera) + T_map_camera.translation[:, None]
        ijk = point_to_ijk(p_map, self.voxel_size_m).astype(np.int64)  # an axis a row: several times faster
        low = ijk.min(axis=1)
        cells = _join(ijk - low[:, None], _IMAGE_BITS)
        pairs, pixels = np.unique(cells << 16 | labels[wanted], return_counts=True)
        cells = pairs >> 16
        order = np.lexsort((-pairs, pixels, cells))  # the last of a voxel has most pixels, and of those the lowest id
        best = order[np.append(np.diff(cells) != 0, True)]
        self._voxels.append(pack(_split(cells[best], _IMAGE_BITS) + low))
        self._labels.append((pairs[best] & 0xFFFF).astype(np.uint16))

    def voxels(self, least_views: int = 1) -> NDArray[np.int64]:
        """The voxels (N, 3) into which labelled pixels of so many images fell, in the order of their indices."""
        keys, _ = self._sorted()
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        views = np.diff(first, append=len(keys))
        return _split(keys[first[views >= least_views]], _BITS) - _ZERO

    def query(self, ijk: ArrayLike, seed: int = 0) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
        """In how many images each voxel (N, 3) was labelled (N,), and the label (N,) that one of them, drawn for each
        voxel anew, gave it; 0 where there is none."""
        keys, labels = self._sorted()
        wanted = pack(ijk)
        first = np.searchsorted(keys, wanted)
        views = np.searchsorted(keys, wanted, side="right") - first
        one = first + (np.random.default_rng(seed).random(len(wanted)) * views).astype(np.int64)
        return views, np.append(labels, np.uint16(0))[np.where(views > 0, one, -1)]

    def _sorted(self) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
        """All voxels and labels (M,) so far, by voxel; of one voxel in the order of the images."""
        if len(self._voxels) != 1:
            keys = np.concatenate([np.empty(0, np.int64), *self._voxels])
            labels = np.concatenate([np.empty(0, np.uint16), *self._labels])
            order = np.argsort(keys, kind="stable")
            self._voxels, self._labels = [keys[order]], [labels[order]]
        return self._voxels[0], self._labels[0]
