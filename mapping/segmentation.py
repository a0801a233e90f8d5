"""From the labels of an image to pieces of surface that belong to one thing each.

Source of the problem: *Semantic 3D mapping from deep image segmentation* (Martín et al. 2021): mask pixels beyond an
object's edge fall on the background and would pollute the map. Here each mask is cut where depth jumps, the piece in
the
middle of the mask is kept, and pixels near the mask's boundary are trusted less.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import segments as kernels
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


def segment(image: RgbdImage, depth_m: Array, things: Array) -> Segmentation:
    """Cut the masks of `image` into pieces of things.

    depth_m : (H, W) float32 [m], 0 where not measured or out of range
    things  : (65536,) bool: classes that have instances even where the image gives none
    """
    labels = np.zeros(depth_m.shape, np.uint16) if image.labels is None else image.labels
    instances = np.zeros(depth_m.shape, np.uint32) if image.instances is None else image.instances
    keys = instances.astype(np.int64) << 16 | labels
    distance = np.empty(depth_m.shape, np.uint8)
    kernels.mask_depths(keys, distance)
    thing = (instances != 0) | things[labels]
    mask = np.empty(depth_m.shape, np.int32)
    names = kernels.number_masks(np.where(thing, keys, 0), mask)
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
    kernels.widen(pieces, mask, depth_m, BLEED_PX + 2, DEPTH_STEP_M, RIM_SLOPE, 1.0 / image.intrinsics.fx)

    n_pieces = int(group.max(initial=0))
    piece_pixels = np.bincount(pieces.ravel(), minlength=n_pieces + 1)
    large = piece_pixels >= LEAST_PIXELS
    large[0] = False
    renumber = np.where(large, np.cumsum(large), 0).astype(np.int32)
    pieces = renumber[pieces]
    label_of_group = np.zeros(n_pieces + 1, np.uint16)
    label_of_group[group] = (names[of_mask] & 0xFFFF).astype(np.uint16)
    piece_label, piece_pixels = label_of_group[large], piece_pixels[large]

    believed = np.where((depth_m > 0) & ((pieces > 0) | ~thing), labels, 0).astype(np.uint16)
    trust = np.minimum(distance.astype(np.float32) * np.float32(1.0 / BLEED_PX), np.float32(1.0))
    if image.label_confidence is not None:
        trust = trust * image.label_confidence
    return Segmentation(believed, trust, pieces, piece_label, piece_pixels)


def _group_pieces(of_mask: Array, centrality: Array, mean_depth: Array, has_instance: Array) -> Array:
    """The number (n,) of the thing that each piece belongs to, 0 for pieces of background in gaps of a mask.

    Of a mask with an instance id: the most central piece, and others that are large and near enough in depth to be
    parts
    of it. Without instance ids every piece stands for itself.
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
