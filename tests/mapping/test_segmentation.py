"""Masks are cut where depth jumps, and nothing is lost where they are right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mapping.geometry import CameraIntrinsics
from mapping.kernels import segments as kernels
from mapping.observations import RgbdImage
from mapping.segmentation import BLEED_PX, LEAST_PIXELS, Segmentation, segment
from tests import naive_semantics as naive

CAMERA = CameraIntrinsics(fx=262.5, fy=262.5, cx=159.5, cy=119.5, width=320, height=240)
V, U = np.mgrid[: CAMERA.height, : CAMERA.width]
THINGS = np.zeros(1 << 16, bool)
THINGS[[2, 3]] = True
WALL, CUP = 1, 2

key_images = hnp.arrays(np.int64, (7, 8), elements=st.sampled_from([0, 1, 1, 2]))
depth_images = hnp.arrays(np.float32, (7, 8), elements=st.sampled_from([0.0, 1.0, 1.01, 1.03, 1.06, 2.0]))


@settings(max_examples=100, deadline=None)
@given(keys=key_images)
def test_the_depth_of_a_mask_is_that_of_the_naive_reference(keys: np.ndarray) -> None:
    distance = np.empty(keys.shape, np.uint8)
    kernels.mask_depths(keys, distance)
    assert (distance == naive.mask_depths(keys, kernels.CORE_PX)).all()


@settings(max_examples=150, deadline=None)
@given(keys=key_images, depth=depth_images)
def test_pieces_are_those_of_the_naive_reference(keys: np.ndarray, depth: np.ndarray) -> None:
    found = np.empty(keys.shape, np.int32)
    n = kernels.connect(keys, depth, 0.02, 0.015, found)
    numbers = set(np.unique(found).tolist()) - {0}
    assert numbers == set(range(1, n + 1))
    as_sets = {frozenset((int(v), int(u)) for v, u in np.argwhere(found == k)) for k in numbers}
    assert as_sets == naive.pieces(keys, depth, 0.02, 0.015)


@given(keys=key_images, spread=st.integers(1, 10**9))
def test_masks_are_numbered_in_order_of_appearance(keys: np.ndarray, spread: int) -> None:
    keys = keys * spread
    mask = np.empty(keys.shape, np.int32)
    names = kernels.number_masks(keys, mask)
    order = list(dict.fromkeys([0, *keys.ravel().tolist()]))
    assert names.tolist() == order
    assert (names[mask] == keys).all()


def test_thousands_of_masks_are_told_apart() -> None:
    keys = np.random.default_rng(0).permutation(6000).reshape(60, 100).astype(np.int64) << 16
    mask = np.empty(keys.shape, np.int32)
    names = kernels.number_masks(keys, mask)
    assert len(names) == 6000
    assert (names[mask] == keys).all()


def image(depth: np.ndarray, labels: np.ndarray, instances: np.ndarray | None = None, **fields: object) -> RgbdImage:
    return RgbdImage(
        stamp_ns=1, robot="r", sensor="c", depth=depth.astype(np.float32), intrinsics=CAMERA,
        labels=labels.astype(np.uint16), instances=None if instances is None else instances.astype(np.uint32), **fields,
    )  # fmt: skip


def cut(depth: np.ndarray, labels: np.ndarray, instances: np.ndarray | None = None, **fields: object) -> Segmentation:
    seen = image(depth, labels, instances, **fields)
    return segment(seen, seen.depth_m, THINGS)


def disc(u: float, v: float, radius: float) -> np.ndarray:
    return (U - u) ** 2 + (V - v) ** 2 < radius**2


@pytest.mark.parametrize("radius", [16.0, 30.0, 60.0])
def test_a_bleeding_mask_is_cut_at_the_depth_jump(radius: float) -> None:
    true = disc(160, 120, radius)
    bleeding = ndimage.binary_dilation(true, iterations=BLEED_PX)
    depth = np.where(true, 1.0, 2.5)
    seen = cut(depth, np.where(bleeding, CUP, WALL), bleeding * 7)
    assert len(seen) == 1
    assert seen.label.tolist() == [CUP]
    assert ((seen.pieces == 1) & ~true).sum() == 0, "no pixel of the wall is the cup's"
    assert ((seen.pieces == 1) & true).sum() > 0.98 * true.sum()
    assert seen.pixels.tolist() == [(seen.pieces == 1).sum()]
    assert (seen.labels[bleeding & ~true] == WALL).all(), "the wall behind is no cup"
    assert (seen.labels[~bleeding] == WALL).all()


def test_a_bleeding_cup_on_a_table_leaves_most_of_the_table_alone() -> None:
    """Where the cup meets the table there is no jump: there at most the rim goes with it, and is trusted little."""
    top = 1.6 / np.maximum((V - 60.0) / CAMERA.fy, 0.2)  # a plane under the camera, rising into the distance
    cup = (np.abs(U - 160) < 14) & (V > 110) & (V < 150)
    depth = np.where(cup, top[150, 0] - 0.03, top)
    bleeding = ndimage.binary_dilation(cup, iterations=6)
    seen = cut(depth, np.where(bleeding, CUP, WALL), bleeding * 3)
    mine = seen.pieces > 0
    assert len(seen) == 1
    assert (mine & cup).sum() > 0.95 * cup.sum()
    stolen = mine & ~cup
    assert stolen.sum() < 0.5 * (bleeding & ~cup).sum()
    assert not stolen[:110].any(), "above the cup the table is far behind"


def test_a_right_mask_loses_nothing() -> None:
    slanted = 1.0 + 0.004 * (U - 60)
    true = disc(120, 120, 50)
    seen = cut(np.where(true, slanted, 4.0), np.where(true, CUP, WALL), true * 1)
    assert ((seen.pieces == 1) == true).all()
    assert (seen.labels == np.where(true, CUP, WALL)).all()


def test_trust_is_low_at_the_border_of_a_mask_and_full_inside() -> None:
    true = disc(160, 120, 40)
    seen = cut(np.full(U.shape, 1.0), np.where(true, CUP, WALL), true * 1)
    assert seen.trust[120, 160] == 1.0
    assert seen.trust[120, 121] < 0.3
    assert ((seen.trust >= 0.0) & (seen.trust <= 1.0)).all()
    doubted = cut(
        np.full(U.shape, 1.0), np.where(true, CUP, WALL), true * 1, label_confidence=np.full(U.shape, 0.5, np.float32)
    )
    assert np.allclose(doubted.trust, 0.5 * seen.trust)


def test_a_thing_seen_around_an_obstacle_is_one() -> None:
    mask = (np.abs(V - 120) < 30) & (np.abs(U - 160) < 100)
    post = np.abs(U - 170) < 12
    depth = np.where(post, 0.8, np.where(mask, 1.5, 3.0))
    seen = cut(depth, np.where(mask & ~post, CUP, WALL), (mask & ~post) * 5)
    assert len(seen) == 1
    for side in (U < 158, U > 182):
        assert (seen.pieces[mask & side] == 1).mean() > 0.97, "all but the corners"


def test_without_instance_ids_things_of_a_class_are_parted_where_they_do_not_touch() -> None:
    a, b = disc(80, 120, 30), disc(240, 120, 30)
    seen = cut(np.where(a | b, 1.0, 3.0), np.where(a | b, CUP, WALL))
    assert seen.label.tolist() == [CUP, CUP]
    assert len(set(np.unique(seen.pieces[a])) | set(np.unique(seen.pieces[b]))) == 2


def test_two_touching_things_with_masks_of_their_own_stay_two() -> None:
    box = (np.abs(V - 120) < 40) & (np.abs(U - 160) < 80)
    seen = cut(np.where(box, 1.0, 3.0), np.where(box, CUP, WALL), np.where(box, 1 + (U > 160), 0))
    assert len(seen) == 2


def test_specks_and_unlabelled_images_have_no_pieces() -> None:
    speck = (np.abs(V - 120) < 3) & (np.abs(U - 160) < 3)
    assert speck.sum() < LEAST_PIXELS
    assert len(cut(np.full(U.shape, 1.0), np.where(speck, CUP, WALL), speck * 1)) == 0
    assert len(cut(np.full(U.shape, 1.0), np.full(U.shape, WALL))) == 0
    plain = RgbdImage(stamp_ns=1, robot="r", sensor="c", depth=np.ones(U.shape, np.float32), intrinsics=CAMERA)
    assert len(segment(plain, plain.depth_m, THINGS)) == 0


def test_a_mask_that_fills_the_image_is_one_piece() -> None:
    seen = cut(np.full(U.shape, 1.0), np.full(U.shape, CUP), np.full(U.shape, 9))
    assert seen.label.tolist() == [CUP]
    assert (seen.pieces == 1).all()


def test_pixels_without_depth_belong_to_nothing() -> None:
    true = disc(160, 120, 40)
    depth = np.where(true, 1.0, 3.0)
    depth[100:110] = 0.0
    seen = cut(depth, np.where(true, CUP, WALL), true * 1)
    assert (seen.pieces[100:110] == 0).all()
    assert (seen.labels[100:110] == 0).all()
