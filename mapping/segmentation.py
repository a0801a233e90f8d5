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
from numpy.typing import NDArray

from mapping.kernels import segments as kernels
from mapping.kernels.bleed import find_borders, measure_bleed, take_off
from mapping.observations import RgbdImage

Array: TypeAlias = NDArray[Any]

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
BLEED_MEMORY = 50.0
"""The bleed of masks that show none is that of about so many others seen last."""
LEAST_PIXELS = 40
"""A piece smaller than this says too little about where a thing is."""
PART_SHARE = 0.1
PART_DEPTH_M = 0.6
"""A thing seen around an obstacle has more than one piece: each counts this share of the main one and lies this near
it."""


@dataclass(frozen=True)
class Segmentation:
    """The labelled part of one image.

    labels  (H, W) uint16: class ids of pixels to be believed, 0 elsewhere
    trust   (H, W) float32 in 0 … 1
    pieces  (H, W) int32: 1 … n on pieces of things, 0 elsewhere
    label   (n,) class id of each piece;  pixels (n,) its size
    """

    labels: Array
    trust: Array
    pieces: Array
    label: Array
    pixels: Array

    def __len__(self) -> int:
        return len(self.label)


class Bleed:
    """How far the masks of one segmenter reach beyond their things, as far as images have shown."""

    def __init__(self) -> None:
        self._masks = np.zeros(2 * MOST_BLEED_PX)  # seen lately, by bleed [half pixels]

    @property
    def typical_px(self) -> float:
        """The median of the masks seen lately; 0 where none has shown anything."""
        return 0.5 * float(np.searchsorted(np.cumsum(self._masks), 0.5 * self._masks.sum()))

    def measure(self, mask: Array, borders: Array, n: int, depth_m: Array, pixel_m: float) -> Array:
        """How far each mask of an image bleeds, (n,) int64 [px]: as its own outline shows, else what is typical.

        mask (H, W) int32 < n, 0 = background;  depth_m (H, W) float32 [m];  pixel_m: the width of a pixel at 1 m
        """
        counts = np.zeros((n, len(self._masks)), np.int32)
        measure_bleed(mask, borders, depth_m, DEPTH_STEP_M, DEPTH_STEP_SHARE, RIM_SLOPE, pixel_m, counts)
        total = counts.sum(axis=1, keepdims=True)
        own = (np.cumsum(counts, axis=1) < OWN_RANK * total).sum(axis=1)
        shown = total[:, 0] >= LEAST_OUTLINE
        self._masks *= (1.0 - 1.0 / BLEED_MEMORY) ** shown.sum()
        np.add.at(self._masks, own[shown], 1.0)
        return np.asarray(np.where(shown, own, 2 * self.typical_px) + 1, np.int64) // 2


def segment(image: RgbdImage, depth_m: Array, things: Array, bleed: Bleed | None = None) -> Segmentation:
    """Cut the masks of `image` into pieces of things.

    depth_m : (H, W) float32 [m], 0 where not measured or out of range
    things  : (65536,) bool: classes that have instances even where the image gives none
    bleed    what earlier images told of the segmenter's bleed, updated; default: this image alone tells
    """
    labels = np.zeros(depth_m.shape, np.uint16) if image.labels is None else image.labels
    instances = np.zeros(depth_m.shape, np.uint32) if image.instances is None else image.instances
    thing = (instances != 0) | things[labels]
    mask = np.empty(depth_m.shape, np.int32)
    names = kernels.number_masks(np.where(thing, instances.astype(np.int64) << 16 | labels, 0), mask)
    mask[~thing] = -labels[~thing].astype(np.int32)
    pixel_m = 1.0 / image.intrinsics.fx
    borders = find_borders(mask)
    bleed_px = (Bleed() if bleed is None else bleed).measure(mask, borders, len(names), depth_m, pixel_m)
    take_off(mask, borders, depth_m, bleed_px, RIM_SHARE, DEPTH_STEP_M, RIM_SLOPE, pixel_m)
    distance = np.empty(depth_m.shape, np.uint8)
    kernels.mask_depths(mask.astype(np.int64), distance)
    labels = np.where(mask > 0, labels, -mask).astype(np.uint16)
    mask[mask < 0] = 0
    peak = np.empty(depth_m.shape, np.uint8)
    kernels.local_peaks(mask, distance, peak)
    core_px = np.minimum(np.float32(0.5 * CORE_SHARE) * peak, np.float32(BLEED_PX))
    core = np.where(distance > core_px, mask, 0).astype(np.int64)
    pieces = np.empty(depth_m.shape, np.int32)
    n = kernels.connect(core, depth_m, DEPTH_STEP_M, DEPTH_STEP_SHARE, pieces)
    of_mask, pixels = np.zeros(n, np.int32), np.zeros(n, np.int64)
    centrality, mean_depth = np.zeros(n), np.zeros(n)
    kernels.measure_pieces(mask, distance, depth_m, pieces, of_mask, pixels, centrality, mean_depth)
    group = _group_pieces(of_mask, centrality, mean_depth, (names >> 16) != 0)
    pieces = np.concatenate([[0], group]).astype(np.int32)[pieces]
    kernels.widen(pieces, mask, depth_m, BLEED_PX + 2, DEPTH_STEP_M, RIM_SLOPE, pixel_m)

    n_pieces = int(group.max(initial=0))
    piece_pixels = np.bincount(pieces.ravel(), minlength=n_pieces + 1)
    large = piece_pixels >= LEAST_PIXELS
    large[0] = False
    renumber = np.where(large, np.cumsum(large), 0).astype(np.int32)
    pieces = renumber[pieces]
    label_of_group = np.zeros(n_pieces + 1, np.uint16)
    label_of_group[group] = (names[of_mask] & 0xFFFF).astype(np.uint16)
    piece_label, piece_pixels = label_of_group[large], piece_pixels[large]

    believed = np.where((depth_m > 0) & ((pieces > 0) | (mask == 0)), labels, 0).astype(np.uint16)
    trust = np.minimum(distance.astype(np.float32) * np.float32(1.0 / BLEED_PX), np.float32(1.0))
    if image.label_confidence is not None:
        trust = trust * image.label_confidence
    return Segmentation(believed, trust, pieces, piece_label, piece_pixels)


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
