"""What masks reach beyond their things is measured where depth shows it, and taken off where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mapping.geometry import CameraIntrinsics
from mapping.grid import read_only
from mapping.kernels.bleed import GAP_PX, find_borders, measure_bleed, take_off
from mapping.observations import RgbdImage
from mapping.segmentation import Bleed, Segmentation, segment
from tests import naive_segments as naive

CAMERA = CameraIntrinsics(fx=262.5, fy=262.5, cx=159.5, cy=119.5, width=320, height=240)
V, U = np.mgrid[: CAMERA.height, : CAMERA.width]
WALL, FLOOR, PICTURE, SHOE = 1, 2, 3, 4
THINGS = np.zeros(1 << 16, bool)
THINGS[[PICTURE, SHOE]] = True

mask_images = hnp.arrays(np.int32, (7, 9), elements=st.sampled_from([0, -5, -6, 1, 1, 1, 2]))
depth_images = hnp.arrays(np.float32, (7, 9), elements=st.sampled_from([0.0, 1.0, 1.0, 1.01, 1.2, 2.0]))
some_pixels = st.integers(0, 5)


@settings(max_examples=100, deadline=None)
@given(mask=mask_images)
def test_borders_are_those_of_the_naive_reference(mask: np.ndarray) -> None:
    ways = {step: way for way, step in enumerate(naive.FOUR)}
    expected = [4 * (v * 9 + u) + ways[dv, du] for v, u, dv, du, _ in naive.borders(mask)]
    assert sorted(find_borders(mask).tolist()) == sorted(expected)


@settings(max_examples=100, deadline=None)
@given(mask=mask_images, depth=depth_images)
def test_bleed_is_measured_as_by_the_naive_reference(mask: np.ndarray, depth: np.ndarray) -> None:
    counts = np.zeros((3, 8), np.int32)
    measure_bleed(mask, find_borders(mask), read_only(depth), 0.02, 0.015, 3.0, 0.002, counts)
    found = {m: {k: int(n) for k, n in enumerate(counts[m]) if n} for m in range(3) if counts[m].any()}
    assert found == naive.bleeds(mask, depth, 0.02, 0.015, 3.0, 0.002, GAP_PX, 8)


@settings(max_examples=100, deadline=None)
@given(mask=mask_images, depth=depth_images, one=some_pixels, two=some_pixels, share=st.sampled_from([0.3, 0.45, 1.0]))
def test_rims_are_those_of_the_naive_reference(
    mask: np.ndarray, depth: np.ndarray, one: int, two: int, share: float
) -> None:
    bleed_px = np.array([0, one, two])
    choices = naive.rims(mask, depth, bleed_px, share, 0.02, 3.0, 0.002)
    found, doubtful = mask.copy(), np.zeros(mask.shape, np.uint8)
    take_off(found, doubtful, find_borders(mask), read_only(depth), bleed_px, share, 0.02, 3.0, 0.002)
    for pixel, was in np.ndenumerate(mask):
        assert (found[pixel], bool(doubtful[pixel])) in choices.get(pixel, {(was, False)})


def disc(u: float, v: float, radius: float) -> np.ndarray:
    return (U - u) ** 2 + (V - v) ** 2 < radius**2


def grown(true: np.ndarray, pixels: int) -> np.ndarray:
    """What a mask that bleeds so far covers: all that is this near to a true pixel."""
    return ndimage.distance_transform_edt(~true) <= pixels if pixels else true


def cut(
    depth: np.ndarray, labels: np.ndarray, instances: np.ndarray | None = None, bleed: Bleed | None = None
) -> Segmentation:
    seen = RgbdImage(
        stamp_ns=1, robot="r", sensor="c", depth=depth.astype(np.float32), intrinsics=CAMERA,
        labels=labels.astype(np.uint16), instances=None if instances is None else instances.astype(np.uint32),
    )  # fmt: skip
    return segment(seen, seen.depth_m, THINGS, bleed)


def lost_at_jumps(depth: np.ndarray, thing: np.ndarray) -> np.ndarray:
    """The depth image without the two pixels on either side of the thing's outline."""
    near = ndimage.binary_dilation(thing, iterations=2) & ~ndimage.binary_erosion(thing, iterations=2)
    return np.where(near, 0.0, depth)


@pytest.mark.parametrize("pixels", [0, 3, 5, 8])
@pytest.mark.parametrize("with_gap", [True, False])
def test_an_outline_in_depth_tells_how_far_a_mask_bleeds(pixels: int, with_gap: bool) -> None:
    true = disc(160, 120, 40)
    depth = np.where(true, 1.0, 2.5).astype(np.float32)
    if with_gap:
        depth = lost_at_jumps(depth, true).astype(np.float32)
    mask = grown(true, pixels).astype(np.int32)
    bleed = Bleed()
    assert bleed.typical_px == 0.0
    px = bleed.measure(mask, find_borders(mask), 2, read_only(depth), 1.0 / CAMERA.fx)
    assert abs(px[1] - pixels) <= 1
    assert abs(bleed.typical_px - pixels) <= 0.5


def standing_and_hung(pixels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Depth, labels, instances of a shoe far before a wall and a picture on it, and the picture's true pixels."""
    shoe, picture = disc(80, 170, 30), (np.abs(U - 220) < 30) & (np.abs(V - 80) < 20)
    shoe_mask, picture_mask = grown(shoe, pixels), grown(picture, pixels)
    depth = lost_at_jumps(np.where(shoe, 1.0, 2.5), shoe)
    labels = np.where(shoe_mask, SHOE, np.where(picture_mask, PICTURE, WALL))
    return depth, labels, np.where(shoe_mask, 1, np.where(picture_mask, 2, 0)), picture


@pytest.mark.parametrize("with_instances", [True, False])
@pytest.mark.parametrize("pixels", [3, 6, 8])
def test_the_rim_of_a_picture_is_the_wall_that_it_hangs_on(pixels: int, with_instances: bool) -> None:
    depth, labels, instances, picture = standing_and_hung(pixels)
    seen = cut(depth, labels, instances if with_instances else None)
    rim = (labels == PICTURE) & ~picture
    assert (seen.labels[rim] == WALL).mean() > 0.95
    assert (seen.pieces[rim] == 0).mean() > 0.95
    assert (seen.labels[picture] == PICTURE).mean() > 0.95
    assert seen.trust[80, 220] == 1.0
    assert seen.trust[80, 189] < 0.5, "where the edge is now thought to be"


def test_masks_that_do_not_bleed_lose_nothing() -> None:
    depth, labels, instances, picture = standing_and_hung(0)
    seen = cut(depth, labels, instances)
    assert (seen.labels[depth > 0] == labels[depth > 0]).all()
    assert ((seen.pieces > 0)[picture]).all()


def test_earlier_images_tell_what_an_image_without_outlines_cannot() -> None:
    depth, labels, instances, picture = standing_and_hung(5)
    alone = np.where(labels == PICTURE, PICTURE, WALL)
    wall = np.full(U.shape, 2.5)
    rim = (alone == PICTURE) & ~picture
    assert (cut(wall, alone, instances * (alone == PICTURE)).labels[rim] == PICTURE).all(), "nothing known"
    bleed = Bleed()
    cut(depth, labels, instances, bleed)
    assert abs(bleed.typical_px - 5.0) <= 0.5
    assert (cut(wall, alone, instances * (alone == PICTURE), bleed).labels[rim] == WALL).mean() > 0.95


def test_small_and_thin_things_do_not_vanish() -> None:
    depth, labels, instances, _ = standing_and_hung(8)
    labels, instances = labels.copy(), instances.copy()
    small, thin = disc(200, 200, 10), (np.abs(U - 280) < 5) & (V > 130)
    for number, true in ((3, small), (4, thin)):
        labels[true], instances[true] = PICTURE, number  # masks that do not bleed, among those that do
    seen = cut(depth, labels, instances)
    for true in (small, thin):
        assert (seen.labels[true] == PICTURE).sum() > 0.1 * true.sum()
        assert len(np.unique(seen.pieces[true & (seen.pieces > 0)])) == 1


def test_rims_beside_nothing_labelled_are_nothing() -> None:
    depth, labels, instances, picture = standing_and_hung(6)
    seen = cut(depth, np.where(labels == WALL, 0, labels), instances)
    rim = (labels == PICTURE) & ~picture
    assert (seen.labels[rim] == 0).mean() > 0.95
    assert (seen.pieces[rim] == 0).mean() > 0.95
    assert (seen.labels[picture] == PICTURE).mean() > 0.95


def test_a_thing_that_rests_on_a_floor_keeps_what_stands_out_from_it() -> None:
    """Only pixels that go on from the floor beside the mask are given to the floor."""
    floor = 1.6 / np.maximum((V - 60.0) / CAMERA.fy, 0.2)
    box = (np.abs(U - 160) < 30) & (V > 90) & (V < 150)
    depth = lost_at_jumps(np.where(box, floor[150, 0], floor), box & (V < 146))
    bleeding = grown(box, 6)
    seen = cut(depth, np.where(bleeding, SHOE, FLOOR), bleeding * 3)
    measured = depth > 0
    below = bleeding & ~box & (V >= 150) & measured
    assert (seen.labels[below] == FLOOR).mean() > 0.8
    assert (seen.labels[box & measured] == SHOE).mean() > 0.95


def test_where_two_masks_touch_on_one_surface_neither_is_sure() -> None:
    depth, labels, instances, picture = standing_and_hung(5)
    book = picture & (U > 220)
    seen = cut(depth, labels, np.where(book, 7, instances))
    assert seen.trust[80, 217] < 0.2
    assert seen.trust[80, 223] < 0.2
    assert seen.trust[80, 205] == 1.0
    assert seen.labels[80, 217] == seen.labels[80, 223] == PICTURE, "but each keeps what it has"
    assert len(np.unique(seen.pieces[picture])) >= 2


def test_one_mask_that_seems_to_bleed_among_many_that_do_not_is_taken_for_hollow() -> None:
    """A bowl's far rim lies on the table; behind its near rim depth jumps, as at an outline."""
    bowl = disc(160, 120, 40)
    depth = np.where(disc(160, 128, 32), 1.0, 2.5).astype(np.float32)
    bleed = Bleed()
    for _ in range(20):
        clean = disc(160, 120, 30).astype(np.int32)
        bleed.measure(
            clean, find_borders(clean), 2, read_only(np.where(clean, np.float32(1.0), np.float32(2.5))), 0.004
        )
    mask = bowl.astype(np.int32)
    assert bleed.measure(mask, find_borders(mask), 2, read_only(depth), 0.004)[1] == 0
    assert Bleed().measure(mask, find_borders(mask), 2, read_only(depth), 0.004)[1] >= 3
