"""The space of an object is what its mask shows in one piece, whatever else the mask covers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapping.conversions import depth_to_points, register_color, register_labels
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import read_only
from mapping.kernels import object_space as kernels
from mapping.object_space import ObjectSpace, space_of_mask, space_of_points, space_of_views, write_color_octree
from mapping.octomap import read_octomap
from tests import naive_object_space as naive

SIZE = 0.02
CAMERA = CameraIntrinsics(fx=262.5, fy=262.5, cx=159.5, cy=119.5, width=320, height=240)
V, U = np.mgrid[: CAMERA.height, : CAMERA.width]
FROM_MIDDLE = np.hypot(V - 120, U - 160)

places = hnp.arrays(np.int64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-4, 4))
offsets = st.tuples(*[st.integers(-1000, 1000)] * 3)


def voxels(space: ObjectSpace) -> set[tuple[int, ...]]:
    return set(map(tuple, space.voxel_ijk.tolist()))


def centres(ijk: np.ndarray) -> np.ndarray:
    return (ijk + 0.5) * SIZE


# -- points --------------------------------------------------------------------------------------------------------


@settings(max_examples=150)
@given(ijk=places, seed=st.integers(0, 2**32 - 1))
def test_the_space_of_points_is_that_of_a_naive_flood_fill(ijk: np.ndarray, seed: int) -> None:
    weights = np.random.default_rng(seed).integers(0, 4, len(ijk)).astype(float)
    space = space_of_points(centres(ijk), SIZE, weights=weights)
    assert voxels(space) == naive.heaviest(centres(ijk), weights, SIZE)


@given(ijk=places, seed=st.integers(0, 2**32 - 1))
def test_the_order_of_points_does_not_matter(ijk: np.ndarray, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(ijk))
    one, other = space_of_points(centres(ijk), SIZE), space_of_points(centres(ijk[order]), SIZE)
    np.testing.assert_array_equal(one.voxel_ijk, other.voxel_ijk)
    np.testing.assert_array_equal(one.counts, other.counts)
    np.testing.assert_array_equal(one.kept[order], other.kept)


@given(ijk=places, away=offsets)
def test_moving_all_points_by_whole_voxels_moves_the_space(ijk: np.ndarray, away: tuple[int, int, int]) -> None:
    moved = space_of_points(centres(ijk + away), SIZE)
    np.testing.assert_array_equal(moved.voxel_ijk, space_of_points(centres(ijk), SIZE).voxel_ijk + away)


@given(ijk=places, far=places)
def test_outliers_far_away_change_nothing(ijk: np.ndarray, far: np.ndarray) -> None:
    space = space_of_points(centres(ijk), SIZE)
    outliers = 1000 + 3 * np.arange(min(len(far), int(space.counts.sum()) - 1))[:, None] * [1, 1, 1]
    more = space_of_points(centres(np.concatenate([ijk, outliers])), SIZE)
    np.testing.assert_array_equal(more.voxel_ijk, space.voxel_ijk)


def test_a_space_says_which_point_lies_in_which_voxel() -> None:
    points = np.random.default_rng(0).uniform(0.0, 0.1, (500, 3))
    space = space_of_points(points, SIZE)
    np.testing.assert_array_equal(space.points, points[space.kept].astype(np.float32))
    np.testing.assert_array_equal(space.voxel_ijk[space.voxel_of], np.floor(points[space.kept] / SIZE))
    np.testing.assert_array_equal(np.bincount(space.voxel_of), space.counts)
    assert voxels(space) <= voxels(space_of_points(space.centres, SIZE))


def test_no_points_have_no_space() -> None:
    space = space_of_points(np.empty((0, 3)), SIZE)
    assert len(space) == 0
    with pytest.raises(InvalidParameter, match="no voxels"):
        space.box()


# -- masks ---------------------------------------------------------------------------------------------------------


def masked(own: np.ndarray, mask: np.ndarray, near: float = 1.5, far: float = 2.5) -> ObjectSpace:
    depth = np.where(own, near, far).astype(np.float32)
    return space_of_mask(depth, CAMERA, mask, SIZE)


def test_bleeding_on_to_a_background_is_left_out() -> None:
    own, mask = FROM_MIDDLE < 60, FROM_MIDDLE < 67
    space = masked(own, mask)
    np.testing.assert_array_equal(space.kept, own)


def test_a_ring_is_kept_whole_without_what_is_seen_through_it() -> None:
    own = (FROM_MIDDLE < 80) & (FROM_MIDDLE > 45)
    np.testing.assert_array_equal(masked(own, FROM_MIDDLE < 85).kept, own)
    points = depth_to_points(np.where(own, 1.5, 0.0).astype(np.float32), CAMERA)
    assert len(space_of_points(points, SIZE).points) == len(points)


def test_both_halves_of_a_thing_behind_a_post_are_its_own() -> None:
    own = (abs(V - 120) < 50) & (abs(U - 160) < 100)
    post = abs(U - 160) < 20
    depth = np.where(post, 1.0, np.where(own, 1.5, 3.0)).astype(np.float32)
    mask = (abs(V - 120) < 55) & (abs(U - 160) < 105) & (abs(U - 160) >= 15)
    np.testing.assert_array_equal(space_of_mask(depth, CAMERA, mask, SIZE).kept, own & ~post)


def test_the_floor_is_cut_where_it_is_known() -> None:
    depth = np.full(V.shape, 3.0, np.float32)
    down = (V - CAMERA.cy) / CAMERA.fy
    floor = down * 3.0 > 0.8
    depth[floor] = 0.8 / down[floor]
    own = (abs(U - 160) < 40) & (V > 80) & (down * 2.0 < 0.8)
    depth[own] = 2.0
    mask = (abs(U - 160) < 46) & (V > 74) & (down * 1.85 < 0.8)
    free = space_of_mask(depth, CAMERA, mask, SIZE)
    cut = space_of_mask(depth, CAMERA, mask, SIZE, planes=[[0.0, -1.0, 0.0, -0.8]])
    print(
        (free.kept & ~own).sum(),
        (cut.kept & ~own).sum(),
        (own & ~cut.kept).sum(),
        np.unique(np.nonzero(own & ~cut.kept)[0], return_counts=True),
    )
    assert (free.kept & ~own).any()
    assert not (cut.kept & ~own).any()
    assert (own & ~cut.kept).sum() <= 3 * 79


@given(seed=st.integers(0, 1000))
def test_pixels_inside_a_mask_are_counted_from_its_border(seed: int) -> None:
    mask = np.random.default_rng(seed).random((7, 9)) < 0.85
    inside = np.empty(mask.shape, np.uint8)
    kernels.measure_inside(mask, 10, inside)
    outside = np.argwhere(~mask)
    for v, u in np.argwhere(mask):
        steps = np.sort(np.abs(outside - (v, u)), axis=1)  # the shorter way is gone diagonally
        assert inside[v, u] == min((3 * steps[:, 1] + steps[:, 0]).min(initial=10), 10)
    assert not inside[~mask].any()


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), gaps=st.booleans())
def test_the_rim_grows_as_the_naive_reference_says(seed: int, gaps: bool) -> None:
    rng = np.random.default_rng(seed)
    shape = (14, 17)
    depth = rng.choice(np.array([1.0, 1.03, 1.07, 1.5, 0.0 if gaps else 1.0], np.float32), shape)
    mask, on = rng.random(shape) < 0.95, rng.random(shape) < 0.2
    inside = np.empty(shape, np.uint8)
    kernels.measure_inside(mask, 12, inside)
    measured = (inside > 0) & (depth > 0.0)
    row_at = np.where(measured, (depth > 1.2).astype(np.int32), -1).astype(np.int32)
    chosen, front = np.array([True, False]), np.zeros(shape, np.float32)
    on &= measured
    n = kernels.grow_rim(depth, inside, 6, 9, row_at, chosen, on, 0.0413, read_only(np.zeros(2)), front)
    expected = naive.grow_rim(depth.astype(float), inside, 6, 9, row_at == 0, on, 0.0413)
    np.testing.assert_array_equal(front > 0.0, expected)
    assert n == expected.sum()


@pytest.mark.parametrize("depth", [0.0, np.nan, np.inf])
def test_where_nothing_was_measured_is_no_space(depth: float) -> None:
    image = np.full(V.shape, depth, np.float32)
    for mask in (FROM_MIDDLE < 50, np.zeros(V.shape, bool), np.ones(V.shape, bool)):
        space = space_of_mask(image, CAMERA, mask, SIZE, with_others=True)
        assert len(space) == len(space.points) == 0
        assert not space.kept.any()


def test_a_thin_pole_before_a_wall_is_the_object() -> None:
    own = abs(U - 160) < 3
    mask = (abs(U - 160) < 10) & (abs(V - 120) < 100)
    np.testing.assert_array_equal(masked(own, mask).kept, own & mask)


def test_a_coplanar_thing_is_not_cut_by_its_plane() -> None:
    mask = FROM_MIDDLE < 60
    flat = np.full(V.shape, 1.5, np.float32)
    space = space_of_mask(flat, CAMERA, mask, SIZE, planes=[[0.0, 0.0, 1.0, 1.5]])
    np.testing.assert_array_equal(space.kept, mask)


def test_a_pose_carries_points_and_voxels_into_the_map() -> None:
    own, mask = FROM_MIDDLE < 60, FROM_MIDDLE < 65
    depth = np.where(own, 1.5, 2.5).astype(np.float32)
    pose = SE3.exp([1.0, -2.0, 0.5, 0.3, -0.2, 0.9])
    here, there = (space_of_mask(depth, CAMERA, mask, SIZE, T) for T in (None, pose))
    np.testing.assert_array_equal(here.kept, there.kept)
    np.testing.assert_allclose(there.points, pose @ here.points, atol=1e-5)
    assert voxels(there) == set(map(tuple, np.floor((pose @ here.points.astype(float)) / SIZE).astype(int).tolist()))


# -- masks of another camera -------------------------------------------------------------------------------------------

COLOR_CAMERA = CameraIntrinsics(fx=400.0, fy=410.0, cx=251.0, cy=183.0, width=500, height=370)
BESIDE = SE3.exp([0.05, 0.01, 0.0, 0.01, -0.02, 0.005])


def test_labels_of_another_camera_are_never_blended() -> None:
    depth = np.where(FROM_MIDDLE < 60, 1.5, 2.5).astype(np.float32)
    labels = np.random.default_rng(0).choice(np.array([3, 70, 60_000], np.uint16), (370, 500))
    registered, valid = register_labels(labels, COLOR_CAMERA, BESIDE, depth, CAMERA)
    assert registered.dtype == np.uint16
    assert set(np.unique(registered[valid]).tolist()) == {3, 70, 60_000}
    assert not registered[~valid].any()
    _, same = register_color(np.zeros((370, 500, 3), np.uint8), COLOR_CAMERA, BESIDE, depth, CAMERA)
    np.testing.assert_array_equal(valid, same)


def test_a_mask_of_another_camera_gives_the_space_of_its_object() -> None:
    own = FROM_MIDDLE < 60
    depth = np.where(own, 1.5, 2.5).astype(np.float32)
    p_color = BESIDE.inverse() @ CAMERA.backproject(depth)[own].astype(float)
    pixels, _ = COLOR_CAMERA.project(p_color)
    v, u = np.mgrid[:370, :500]
    mask = np.hypot(v - pixels[:, 1].mean(), u - pixels[:, 0].mean()) < 400.0 / 262.5 * 60 + 8
    registered, _ = register_labels(mask, COLOR_CAMERA, BESIDE, depth, CAMERA)
    assert (registered & ~own).any()
    space = space_of_mask(depth, CAMERA, registered, SIZE)
    assert not (space.kept & ~own).any()
    assert (own & ~space.kept).sum() <= 0.01 * own.sum()


def test_labels_that_do_not_fit_their_camera_are_refused() -> None:
    with pytest.raises(InvalidObservation, match="labels have shape"):
        register_labels(np.zeros((3, 3), bool), COLOR_CAMERA, BESIDE, np.ones(V.shape, np.float32), CAMERA)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mask": np.zeros((3, 3), bool)}, "mask has shape"),
        ({"mask": np.zeros(V.shape, np.uint8)}, "expected bool"),
        ({"depth": np.zeros((3, 3), np.float32)}, "depth has shape"),
    ],
)
def test_images_that_do_not_fit_are_refused(change: dict[str, np.ndarray], words: str) -> None:
    images = {"depth": np.ones(V.shape, np.float32), "mask": np.ones(V.shape, bool)} | change
    with pytest.raises(InvalidObservation, match=words):
        space_of_mask(images["depth"], CAMERA, images["mask"], SIZE)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"voxel_size_m": 0.0}, "voxel_size_m"),
        ({"bleed_px": -1}, "bleed_px"),
        ({"depth_noise": (0.1, np.nan)}, "depth_noise"),
        ({"planes": [[0.0, 0.0, 1.0]]}, "planes"),
        ({"planes": [[0.0, 0.0, 2.0, 1.0]]}, "unit length"),
    ],
)
def test_bad_parameters_are_refused(change: dict[str, object], words: str) -> None:
    given = {"voxel_size_m": SIZE} | change
    with pytest.raises(InvalidParameter, match=words):
        space_of_mask(np.ones(V.shape, np.float32), CAMERA, FROM_MIDDLE < 50, **given)  # type: ignore[arg-type]


def test_spaces_of_unlike_voxels_are_not_joined() -> None:
    spaces = [space_of_points(np.zeros((1, 3)), size) for size in (0.02, 0.05)]
    for several in (spaces, []):
        with pytest.raises(InvalidParameter, match="voxels of one size"):
            space_of_views(several)


# -- what is given out -------------------------------------------------------------------------------------------------


def test_a_box_stands_upright_about_its_points() -> None:
    turn = SE3(SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, 0.6]).rotation, [3.0, 1.0, 0.5])
    grid = np.stack(np.meshgrid(*(np.linspace(-h, h, 40) for h in (0.4, 0.2, 0.1))), axis=-1).reshape(-1, 3)
    space = space_of_points(turn @ grid, SIZE)
    for up in ([0.0, 0.0, 1.0], None):
        box = space.box(up)
        np.testing.assert_allclose(box.center, [3.0, 1.0, 0.5], atol=0.02)
        np.testing.assert_allclose(sorted(box.size), [0.2, 0.4, 0.8], atol=0.03)
        inside = (space.points - box.center) @ SE3.from_quaternion(box.rotation_wxyz, [0, 0, 0]).rotation
        assert (np.abs(inside) <= 0.5 * box.size + 1e-5).all()


def test_objects_are_written_as_one_octree_in_their_colours(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    red, blue = (
        space_of_points(rng.uniform(0.0, 0.1, (400, 3)) + np.array([away, 0.0, 0.0]), SIZE) for away in (0.0, 1.0)
    )
    write_color_octree([(red, (255, 0, 0)), (blue, (0, 0, 255))], tmp_path / "objects.ot")
    tree = read_octomap(tmp_path / "objects.ot")
    assert tree.octomap is not None
    for space, color in ((red, (255, 0, 0)), (blue, (0, 0, 255))):
        assert (tree.octomap.colors_of(space.centres) == color).all()
        assert (tree.classify(space.centres) == tree.classify(space.centres[:1])).all()


def test_views_outvote_what_one_of_them_took_for_the_object() -> None:
    own = FROM_MIDDLE < 60
    depth = np.where(own, 1.5, 2.5).astype(np.float32)
    depth[(V > 170) & ~own & (abs(U - 160) < 30)] = 1.5  # touches it below
    wide = (FROM_MIDDLE < 60) | ((V > 160) & (V < 195) & (abs(U - 160) < 25))
    wrong = space_of_mask(depth, CAMERA, wide, SIZE, with_others=True)
    right = [space_of_mask(depth, CAMERA, FROM_MIDDLE < 60, SIZE, with_others=True) for _ in range(2)]
    voted, truth = space_of_views([wrong, *right]), right[0]
    assert len(wrong) > 1.03 * len(truth)
    assert len(voxels(truth) - voxels(voted)) <= 0.02 * len(truth)
    assert len(voxels(voted) - voxels(truth)) <= 0.02 * len(truth)
    np.testing.assert_array_equal(voted.voxel_ijk, space_of_views([*right, wrong]).voxel_ijk)
