"""From the labels of an image to pieces of surface that belong to one thing each.

Source of the problem: *Semantic 3D mapping from deep image segmentation* (Martín et al. 2021): mask pixels beyond an
object's edge fall on the background and would pollute the map. Here each mask is cut where depth jumps, the piece in the
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
LEAST_PIXELS = 40
"""A piece smaller than this says too little about where a thing is."""


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
    thing = (instances != 0) | things[labels]
    distance = np.empty(depth_m.shape, np.uint8)
    kernels.mask_depths(keys, distance)
    keys[~thing] = 0
    pieces = np.empty(depth_m.shape, np.int32)
    n = kernels.connect(keys, depth_m, DEPTH_STEP_M, DEPTH_STEP_SHARE, pieces)
    key, pixels = np.zeros(n, np.int64), np.zeros(n, np.int64)
    core, centrality = np.zeros(n, np.uint8), np.zeros(n)
    kernels.measure_pieces(keys, distance, pieces, key, pixels, core, centrality)

    kept = _central_pieces(key, pixels, core, centrality, by_instance=(key >> 16) != 0)
    masks, number = np.unique(key[kept], return_inverse=True)
    renumber = np.zeros(n + 1, np.int32)
    renumber[1:][kept] = np.where((key[kept] >> 16) != 0, number + 1, 0)
    separate = np.flatnonzero(kept & ((key >> 16) == 0))  # without instance ids every piece stands for itself
    renumber[1 + separate] = len(masks) + 1 + np.arange(len(separate))
    numbers, renumber[:] = np.unique(renumber, return_inverse=True)
    pieces = renumber[pieces]
    n_pieces = len(numbers) - 1
    piece_label, piece_pixels = np.zeros(n_pieces, np.uint16), np.zeros(n_pieces, np.int64)
    of_piece = renumber[1:]
    piece_label[of_piece[kept] - 1] = (key[kept] & 0xFFFF).astype(np.uint16)
    np.add.at(piece_pixels, of_piece[kept] - 1, pixels[kept])

    believed = np.where((depth_m > 0) & ((pieces > 0) | ~thing), labels, 0).astype(np.uint16)
    trust = np.minimum(distance.astype(np.float32) * np.float32(1.0 / BLEED_PX), np.float32(1.0))
    if image.label_confidence is not None:
        trust = trust * image.label_confidence
    return Segmentation(believed, trust, pieces, piece_label, piece_pixels)


def _central_pieces(key: Array, pixels: Array, core: Array, centrality: Array, by_instance: Array) -> Array:
    """(n,) bool: the pieces that are the thing itself, not the rim of its mask on what lies behind or before it."""
    kept = pixels >= LEAST_PIXELS
    if not kept.any():
        return kept
    order = np.lexsort((-centrality, key))
    first = np.ones(len(key), bool)
    first[1:] = key[order][1:] != key[order][:-1]
    leader = np.maximum.accumulate(np.where(first, np.arange(len(key)), 0))
    largest = np.empty(len(key))
    largest[order] = centrality[order][leader]
    # Of one mask: the most central piece, and other parts (seen around an obstacle) that are thicker than a rim can be.
    central = (centrality == largest) | ((core > BLEED_PX + 1) & (centrality > 0.2 * largest))
    return kept & np.where(by_instance, central, core >= 3)
