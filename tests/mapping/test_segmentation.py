"""Masks are cut where depth jumps, and nothing is lost where they are right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mapping.geometry import CameraIntrinsics
from mapping.grid import read_only
from mapping.kernels import segments as kernels
from mapping.observations import RgbdImage
from mapping.segmentation import BLEED_PX, LEAST_PIXELS, Segmentation, segment
from tests import naive_segments as segments
from tests import naive_semantics as naive

CAMERA = CameraIntrinsics(fx=262.5, fy=262.5, cx=159.5, cy=119.5, width=320, height=240)
V, U = np.mgrid[: CAMERA.height, : CAMERA.width]
THINGS = np.zeros(1 << 16, bool)
THINGS[[2, 3]] = True
WALL, CUP = 1, 2

mask_images = hnp.arrays(np.int32, (7, 8), elements=st.sampled_from([0, -1, 1, 1, 2]))
depth_images = hnp.arrays(np.float32, (7, 8), elements=st.sampled_from([0.0, 1.0, 1.01, 1.03, 1.06, 2.0]))


@settings(max_examples=100, deadline=None)
@given(mask=mask_images)
def test_the_depth_of_a_mask_is_that_of_the_naive_reference(mask: np.ndarray) -> None:
    distance = np.empty(mask.shape, np.uint8)
    kernels.mask_depths(mask, distance)
    assert (distance == naive.mask_depths(mask, kernels.CORE_PX)).all()


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
def test_the_depth_of_a_large_mask_is_counted_up_to_a_limit(seed: int) -> None:
    mask = np.ones((40, 50), np.int32)
    v, u = np.random.default_rng(seed).integers(0, 40, 2)
    mask[v, u] = -3
    distance = np.empty(mask.shape, np.uint8)
    kernels.mask_depths(mask, distance)
    assert (distance == naive.mask_depths(mask, kernels.CORE_PX)).all()


@settings(max_examples=100, deadline=None)
@given(mask=mask_images, share=st.sampled_from([0.3, 0.5, 0.9]))
def test_cores_are_those_of_the_naive_reference(mask: np.ndarray, share: float) -> None:
    distance, core = np.empty(mask.shape, np.uint8), np.empty(mask.shape, np.int32)
    kernels.mask_depths(mask, distance)
    least = (share * np.arange(2 * kernels.CORE_PX + 1)).astype(np.uint8)
    kernels.find_cores(mask, distance, least, core)
    assert (core == segments.cores(mask, distance, least)).all()


@settings(max_examples=150, deadline=None)
@given(mask=mask_images, depth=depth_images)
def test_pieces_are_those_of_the_naive_reference(mask: np.ndarray, depth: np.ndarray) -> None:
    core, found = np.maximum(mask, 0), np.empty(mask.shape, np.int32)
    n = kernels.connect(core, read_only(depth), 0.02, 0.015, found)
    numbers = set(np.unique(found).tolist()) - {0}
    assert numbers == set(range(1, n + 1))
    as_sets = {frozenset((int(v), int(u)) for v, u in np.argwhere(found == k)) for k in numbers}
    assert as_sets == naive.pieces(core, depth, 0.02, 0.015)


@settings(max_examples=50, deadline=None)
@given(mask=mask_images, depth=depth_images)
def test_pieces_are_measured_as_by_the_naive_reference(mask: np.ndarray, depth: np.ndarray) -> None:
    distance, pieces = np.empty(mask.shape, np.uint8), np.empty(mask.shape, np.int32)
    kernels.mask_depths(mask, distance)
    n = kernels.connect(np.maximum(mask, 0), read_only(depth), 0.02, 0.015, pieces)
    of_mask, centrality, mean_depth = np.zeros(n, np.int32), np.zeros(n), np.zeros(n)
    kernels.measure_pieces(mask, distance, read_only(depth), pieces, of_mask, centrality, mean_depth)
    for k in range(n):
        mine = pieces == k + 1
        assert set(mask[mine].tolist()) == {of_mask[k]}
        assert centrality[k] == (distance[mine].astype(float) ** 2).sum()
        assert np.isclose(mean_depth[k], depth[mine].mean())


@settings(max_examples=100, deadline=None)
@given(mask=mask_images, depth=depth_images, data=st.data())
def test_rims_go_to_the_piece_of_the_naive_reference(mask: np.ndarray, depth: np.ndarray, data: st.DataObject) -> None:
    core = np.where(data.draw(hnp.arrays(bool, mask.shape)) & (depth > 0), np.maximum(mask, 0), 0).astype(np.int32)
    pieces = np.empty(mask.shape, np.int32)
    n = kernels.connect(core, read_only(depth), 0.02, 0.015, pieces)
    group = np.array([0, *data.draw(st.lists(st.integers(0, 3), min_size=n, max_size=n))], np.int32)
    allowed = segments.widened(group[pieces], mask, depth, 3, 0.02, 3.0, 0.01)
    pixels = np.zeros(4, np.int64)
    kernels.widen(pieces, pixels, group, mask, read_only(depth), 3, 0.02, 3.0, 0.01)
    for (v, u), piece in np.ndenumerate(pieces):
        assert piece in allowed[v][u]
    assert (pixels[1:] == np.bincount(pieces.ravel(), minlength=4)[1:]).all()


@settings(max_examples=50, deadline=None)
@given(
    labels=hnp.arrays(np.uint16, (7, 8), elements=st.sampled_from([0, 1, 2, 65535])),
    instances=hnp.arrays(np.uint32, (7, 8), elements=st.sampled_from([0, 1, 2**32 - 1])),
)
def test_masks_are_numbered_in_order_of_appearance(labels: np.ndarray, instances: np.ndarray) -> None:
    mask = np.empty(labels.shape, np.int32)
    names = kernels.number_masks(mask, read_only(labels), read_only(instances), read_only(THINGS))
    thing = (instances > 0) | THINGS[labels]
    keys = np.where(thing, instances.astype(np.int64) << 16 | labels, 0)
    assert names.tolist() == list(dict.fromkeys([0, *keys.ravel().tolist()]))
    assert (names[np.maximum(mask, 0)] == keys).all()
    assert (mask[~thing] == -labels[~thing].astype(int)).all()


def test_thousands_of_masks_are_told_apart() -> None:
    instances = np.random.default_rng(0).permutation(6000).reshape(60, 100).astype(np.uint32)
    labels, mask = np.zeros(instances.shape, np.uint16), np.empty(instances.shape, np.int32)
    names = kernels.number_masks(mask, read_only(labels), read_only(instances), read_only(THINGS))
    assert len(names) == 6000
    assert (names[mask] >> 16 == instances).all()


@settings(max_examples=50, deadline=None)
@given(mask=mask_images, depth=depth_images, seed=st.integers(0, 1000))
def test_what_is_believed_of_each_pixel_is_as_said(mask: np.ndarray, depth: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = (rng.integers(0, 3, mask.shape) * (mask > 0)).astype(np.int32)
    number, class_of = np.array([0, 0, 1], np.int32), np.array([0, 7, 8], np.uint16)
    distance = rng.integers(0, 17, mask.shape).astype(np.uint8)
    labels, trust, renumbered = np.empty(mask.shape, np.uint16), np.empty(mask.shape, np.float32), pieces.copy()
    doubtful = rng.integers(0, 2, mask.shape).astype(np.uint8)
    kernels.believe(
        renumbered, labels, trust, number, class_of, mask, read_only(depth), distance, 8, doubtful, 0.3
    )  # fmt: skip
    for p in np.ndindex(mask.shape):
        piece = number[pieces[p]]
        known = depth[p] > 0 and (mask[p] <= 0 or piece > 0)
        assert renumbered[p] == piece
        assert labels[p] == ((class_of[mask[p]] if mask[p] > 0 else -mask[p]) if known else 0)
        sure = min(distance[p] / 8, 1.0) * (0.3 if doubtful[p] else 1.0)
        assert np.isclose(trust[p], sure)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_vote_weighs_as_said(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces, trust = rng.integers(0, 3, (6, 8)).astype(np.int32), rng.uniform(0.05, 1.0, (6, 8)).astype(np.float32)
    depth = rng.uniform(0.3, 5.0, (6, 8)).astype(np.float32)
    weights = np.empty_like(depth)
    kernels.weigh(pieces, trust, depth, 2, 0.0019, 0.025, weights)
    most = [1.0, *(float(trust[pieces == p].max(initial=0.0)) for p in (1, 2))]
    for p in np.ndindex(depth.shape):
        expected = segments.weight(float(trust[p]), most[pieces[p]], float(depth[p]), 0.0019, 0.025)
        assert np.isclose(weights[p], expected, rtol=1e-4)


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
    assert seen.confidence.tolist() == [1.0]


def test_a_piece_is_as_sure_as_its_pixels() -> None:
    true = disc(160, 120, 40)
    sure = np.where(U < 160, 0.4, 0.8).astype(np.float32)
    seen = cut(np.full(U.shape, 1.0), np.where(true, CUP, WALL), true * 1, label_confidence=sure)
    assert seen.confidence == pytest.approx([sure[seen.pieces == 1].mean()])
    assert seen.trust[120, 160] == 1.0, "trust is that of the mask, not of its label"


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
