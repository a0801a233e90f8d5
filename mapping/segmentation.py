"""From the labels of an image to pieces of surface that belong to one thing each.

Source of the problem: *Semantic 3D mapping from deep image segmentation* (Martín et al. 2021): mask pixels beyond an
object's edge fall on the background and would pollute the map. Here each mask is cut where depth jumps, the piece in
the middle of the mask is kept, and pixels near the mask's boundary are trusted less.

Where a thing touches what is beside it no jump shows its edge: a shoe on the floor, a picture on the wall. How far
masks bleed is measured at the outlines that depth does show, and as much is taken off where it does not: else the rim
of every thing would be the thing's in every view, and no number of votes would undo it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mapping.grid import read_only
from mapping.kernels import segments as kernels
from mapping.kernels.bleed import find_borders, measure_bleed, take_off
from mapping.observations import RgbdImage

Array: TypeAlias = NDArray[Any]

DEPTH_NOISE = 0.0019
"""Depth is measured with a standard deviation of this times z² [1/m], as by structured light."""
BLEED_PX = 8
"""How far masks may reach beyond their object [px]: segmenters bleed by some pixels at image resolution 640 × 480."""
DEPTH_STEP_M = 0.02
DEPTH_STEP_SHARE = 0.015
"""Neighbouring pixels lie on one surface when their depths differ by less than DEPTH_STEP_M + DEPTH_STEP_SHARE · z:
above the noise of depth cameras, and the slope of a table top seen from standing height up to 3 m."""
CORE_SHARE = 0.6
"""The core of a mask is what lies deeper inside than BLEED_PX or, where it is thin (a leg, a pole), than this share of
its depth there."""
RIM_SLOPE = 3.0
"""A rim pixel is the thing's own when its surface is no steeper than this against the image plane, seen from the
core."""
RIM_SHARE = 0.3
"""At most this share of a mask's width is taken off one side: what is thin or small does not vanish."""
MOST_BLEED_PX = 15
LEAST_OUTLINE = 12
"""A mask shows its own bleed when depth shows its outline at so many of its border pixels."""
OWN_RANK = 0.4
"""Which of these is taken: a little under the median, as slanted borders are looked across at an angle."""
MOST_RANK = 0.9
"""No mask is believed to bleed more than this share of those seen lately: such a thing is hollow."""
BLEED_MEMORY = 50.0
"""The bleed of masks that show none is that of about so many others seen last."""
DOUBT = 0.3
"""Trust, times this, where two masks touch on one surface: either may have bled over the other."""
RIM_BLEEDS = 1.5
"""Rims are doubtful for so many times what masks typically bleed, and a pixel, BLEED_PX at most: what was taken off a
mask may have been too little."""
LEAST_PIXELS = 40
"""A piece smaller than this says too little about where a thing is."""
PART_SHARE = 0.1
PART_DEPTH_M = 0.6
"""A thing seen around an obstacle has more than one piece: each counts this share of the main one and lies this near
it."""

_CORE_LEAST = np.minimum(0.5 * CORE_SHARE * np.arange(2 * kernels.CORE_PX + 1), BLEED_PX).astype(np.uint8)
"""Core pixels are deeper than this [px], by how deep the mask is around them [half pixels]."""


@dataclass(frozen=True)
class Segmentation:
    """The labelled part of one image.

    labels  (H, W) uint16: class ids of pixels to be believed, 0 elsewhere
    trust   (H, W) float32 in 0 … 1: less at the rims of masks, as far as they bleed
    pieces  (H, W) int32: 1 … n on pieces of things, 0 elsewhere
    label   (n,) class id of each piece;  pixels (n,) its size;  confidence (n,) the mean of its pixels', 1 where the
            segmenter says nothing of it
    """

    labels: Array
    trust: Array
    pieces: Array
    label: Array
    pixels: Array
    confidence: Array

    def __len__(self) -> int:
        return len(self.label)

    def weights(self, depth_m: Array, voxel_size_m: float) -> NDArray[np.float32]:
        """What each pixel's vote for a voxel weighs, (H, W) in 0 … 1; depth (H, W) float32 [m].

        With the sixth power of its trust, so that a voxel on a border belongs to what a near view saw there well inside
        a mask, rather than to what the rims of many masks say; and little where depth is so uncertain that the pixel
        may mean another voxel.
        """
        found = np.empty(depth_m.shape, np.float32)
        kernels.weigh(self.pieces, self.trust, depth_m, len(self), DEPTH_NOISE, voxel_size_m, found)
        return found


class Bleed:
    """How far the masks of one segmenter reach beyond their things, as far as images have shown."""

    def __init__(self, masks: Array | None = None) -> None:
        self._masks = np.zeros(2 * MOST_BLEED_PX) if masks is None else np.array(masks, np.float64)

    @property
    def masks(self) -> NDArray[np.float64]:
        """How many masks were seen lately, by bleed [half pixels]: what makes another `Bleed` like this one."""
        return self._masks.copy()

    @property
    def rim_px(self) -> float:
        """How far from its border a mask is in doubt, once what it bleeds was taken off: as far as masks may reach
        where none has shown anything yet."""
        return min(1.0 + RIM_BLEEDS * self.typical_px, float(BLEED_PX)) if self._masks.any() else float(BLEED_PX)

    @property
    def typical_px(self) -> float:
        """The median of the masks seen lately; 0 where none has shown anything."""
        return 0.5 * self._at_rank(0.5)

    def _at_rank(self, rank: float) -> int:
        """The bleed [half pixels] that this share of the masks seen lately does not exceed."""
        return int(np.searchsorted(np.cumsum(self._masks), rank * self._masks.sum()))

    def measure(self, mask: Array, borders: Array, n: int, depth_m: Array, pixel_m: float) -> Array:
        """How far each mask of an image bleeds, (n,) int64 [px]: as its own outline shows, else what is typical.

        mask     (H, W) int32 < n, ≤ 0 on the background;  borders: as `find_borders` finds them in it
        depth_m  (H, W) float32 [m], 0 = not measured;  pixel_m: the width of a pixel at 1 m
        """
        counts = np.zeros((n, len(self._masks)), np.int32)
        measure_bleed(mask, borders, depth_m, DEPTH_STEP_M, DEPTH_STEP_SHARE, RIM_SLOPE, pixel_m, counts)
        total = counts.sum(axis=1, keepdims=True)
        own = (np.cumsum(counts, axis=1) < OWN_RANK * total).sum(axis=1)
        shown = total[:, 0] >= LEAST_OUTLINE
        self._masks *= (1.0 - 1.0 / BLEED_MEMORY) ** shown.sum()
        np.add.at(self._masks, own[shown], 1.0)
        likely = np.where(shown, np.minimum(own, self._at_rank(MOST_RANK)), self._at_rank(0.5))
        return np.asarray(likely + 1, np.int64) // 2


def segment(image: RgbdImage, depth_m: Array, things: Array, bleed: Bleed | None = None) -> Segmentation:
    """Cut the masks of `image` into pieces of things.

    depth_m : (H, W) float32 [m], 0 where not measured or out of range
    things  : (65536,) bool: classes that have instances even where the image gives none
    bleed   : what earlier images told of the segmenter's bleed, updated; default: this image alone tells
    """
    shape = depth_m.shape
    depth = read_only(np.ascontiguousarray(depth_m, np.float32))
    mask, distance = np.empty(shape, np.int32), np.empty(shape, np.uint8)
    core, pieces = np.empty(shape, np.int32), np.empty(shape, np.int32)
    names = kernels.number_masks(
        mask, _image(image.labels, shape, np.uint16), _image(image.instances, shape, np.uint32), read_only(things)
    )
    pixel_m = 1.0 / image.intrinsics.fx
    borders = find_borders(mask)
    bleed = Bleed() if bleed is None else bleed
    bleed_px = bleed.measure(mask, borders, len(names), depth, pixel_m)
    doubtful = np.zeros(shape, np.uint8)
    take_off(mask, doubtful, borders, depth, bleed_px, RIM_SHARE, DEPTH_STEP_M, RIM_SLOPE, pixel_m)

    kernels.mask_depths(mask, distance)
    kernels.find_cores(mask, distance, _CORE_LEAST, core)
    n = kernels.connect(core, depth, DEPTH_STEP_M, DEPTH_STEP_SHARE, pieces)
    of_mask, centrality, mean_depth = np.zeros(n, np.int32), np.zeros(n), np.zeros(n)
    kernels.measure_pieces(mask, distance, depth, pieces, of_mask, centrality, mean_depth)
    group = _group_pieces(of_mask, centrality, mean_depth, (names >> 16) != 0)
    n_groups = int(group.max(initial=0))
    pixels = np.zeros(n_groups + 1, np.int64)
    joined = np.append(0, group).astype(np.int32)
    kernels.widen(pieces, pixels, joined, mask, depth, BLEED_PX + 2, DEPTH_STEP_M, RIM_SLOPE, pixel_m)

    large = pixels >= LEAST_PIXELS
    number = np.where(large, np.cumsum(large), 0).astype(np.int32)
    class_of_mask = (names & 0xFFFF).astype(np.uint16)
    class_of_group = np.zeros(n_groups + 1, np.uint16)
    class_of_group[group] = class_of_mask[of_mask]
    labels, trust = np.empty(shape, np.uint16), np.empty(shape, np.float32)
    kernels.believe(pieces, labels, trust, number, class_of_mask, mask, depth, distance, bleed.rim_px, doubtful, DOUBT)
    confidence = np.ones(int(large.sum()))
    if image.label_confidence is not None:
        sums = np.bincount(pieces.ravel(), image.label_confidence.ravel(), minlength=len(confidence) + 1)
        confidence = sums[1:] / pixels[large]
    return Segmentation(labels, trust, pieces, class_of_group[large], pixels[large], confidence)


def _image(given: Array | None, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """What an image gives, as kernels take it; zeros of this shape where it gives nothing."""
    return read_only(np.zeros(shape, dtype) if given is None else np.ascontiguousarray(given, dtype))


def _group_pieces(of_mask: Array, centrality: Array, mean_depth: Array, has_instance: Array) -> Array:
    """The number (n,) of the thing that each piece belongs to, 0 for pieces of background in gaps of a mask.

    Of a mask with an instance id: the most central piece, and others that are large and near enough in depth to be
    parts of it. Without instance ids every piece stands for itself.
    """
    group = np.zeros(len(of_mask), np.int64)
    order = np.lexsort((-centrality, of_mask))
    number, main = 0, -1
    for at in order.tolist():
        same = main >= 0 and of_mask[at] == of_mask[main]
        if not same or not has_instance[of_mask[at]]:
            number += 1
            main = at
            group[at] = number
        elif centrality[at] > PART_SHARE * centrality[main] and abs(mean_depth[at] - mean_depth[main]) < PART_DEPTH_M:
            group[at] = number
    return group
