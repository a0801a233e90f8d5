"""Depth images, points and range images become each other; colours of one camera find the pixels of another."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.conversions import (
    depth_to_points,
    points_to_depth,
    points_to_range_image,
    range_image_to_points,
    register_color,
)
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.sensors import LidarModel
from tests import naive_lidar as naive
from tests.support.rooms import LARGE_CAMERA, MIDDLE_CAMERA, SMALL_CAMERA, Room, looking

COLOR_CAMERA = CameraIntrinsics(fx=300.0, fy=310.0, cx=250.0, cy=180.0, width=500, height=375)
BESIDE = SE3.exp([0.1, -0.02, 0.01, 0.02, -0.03, 0.01])


def depth_with_gaps(camera: CameraIntrinsics, seed: int) -> np.ndarray:
    depth = Room().depth(looking(0.3, 0.1), camera)
    rng = np.random.default_rng(seed)
    for value in (0.0, np.nan, np.inf):
        depth[rng.random(depth.shape) < 0.05] = value
    return depth


@given(st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_depth_comes_back_from_its_points(seed):
    depth = depth_with_gaps(SMALL_CAMERA, seed)
    measured = (depth > 0.0) & np.isfinite(depth)
    points = depth_to_points(depth, SMALL_CAMERA)
    np.testing.assert_allclose(points, SMALL_CAMERA.backproject(depth)[measured], atol=1e-6)
    again, index = points_to_depth(points, SMALL_CAMERA)
    assert np.array_equal(again, np.where(measured, depth, 0.0))
    assert np.array_equal(index[measured], np.arange(len(points)))
    assert (index[~measured] == -1).all()


def test_millimetres_are_metres():
    depth = np.full((48, 64), 1500, np.uint16)
    assert np.allclose(depth_to_points(depth, SMALL_CAMERA.model_dump())[:, 2], 1.5)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_points_fall_on_pixels_as_in_the_naive_twin(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(400, 3)) * (1.0, 1.0, 1.5) + (0.0, 0.0, 1.0)
    points = np.concatenate([points, 2.0 * points[:50], [[np.nan, 0.0, 1.0], [0.0, 0.0, 0.0]]])
    depth, index = points_to_depth(points, SMALL_CAMERA)
    expected, which = naive.depth_image(points, SMALL_CAMERA)
    assert np.array_equal(index, which)
    assert np.array_equal(depth, expected.astype(np.float32))


@given(st.integers(0, 1000), st.integers(1, 12), st.integers(1, 40))
@settings(max_examples=20, deadline=None)
def test_range_images_come_back_from_their_points(seed, rows, columns):
    model = LidarModel.even(rows, -0.5, 0.4, columns)
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.5, 20.0, model.shape).astype(np.float32)
    for value in (0.0, np.nan, np.inf):
        ranges[rng.random(model.shape) < 0.1] = value
    measured = (ranges > 0.0) & np.isfinite(ranges)
    points = range_image_to_points(ranges, model)
    again, index = points_to_range_image(points, model)
    np.testing.assert_allclose(again, np.where(measured, ranges, 0.0), rtol=1e-6)
    assert np.array_equal(index[measured], np.arange(len(points)))


def test_a_depth_image_is_a_part_of_a_range_image():
    """Depth → points → range image: what the camera saw is where the lidar would see it."""
    pose = looking(0.2)
    model = LidarModel.even(32, -0.2, 0.2, 512)
    ranges, _ = points_to_range_image(depth_to_points(Room().depth(pose, LARGE_CAMERA), LARGE_CAMERA) @ LEVEL.T, model)
    turned = model.rays().reshape(-1, 3) @ LEVEL @ pose.rotation.T
    expected = Room().cast(pose.translation, turned).reshape(model.shape)
    seen = ranges > 0.0
    assert 0.15 < seen.mean() < 0.2  # of a whole turn
    assert np.median(np.abs(ranges - expected)[seen]) < 0.01


LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From an optical frame to x forward, y left, z up."""


# -- colour ----------------------------------------------------------------------------------------------------


def paint(p: np.ndarray) -> np.ndarray:
    """A colour (…, 3) for each place (…, 3), which changes slowly."""
    return np.clip(127.5 + 100.0 * np.sin(3.0 * p + [0.0, 1.0, 2.0]), 0, 255).astype(np.uint8)


def picture(pose: SE3, camera: CameraIntrinsics) -> np.ndarray:
    return paint(pose @ camera.backproject(Room().depth(pose, camera)).astype(np.float64))


def test_the_same_camera_keeps_its_colours():
    pose = looking(0.3)
    depth, color = Room().depth(pose, MIDDLE_CAMERA), picture(pose, MIDDLE_CAMERA)
    registered, valid = register_color(color, MIDDLE_CAMERA, SE3.identity(), depth, MIDDLE_CAMERA)
    assert valid.all()
    assert np.array_equal(registered, color)


def test_what_is_not_measured_has_no_colour():
    depth = depth_with_gaps(MIDDLE_CAMERA, 1)
    color = np.full((240, 320, 3), 9, np.uint8)
    registered, valid = register_color(color, MIDDLE_CAMERA, np.eye(4), depth, MIDDLE_CAMERA)
    assert np.array_equal(valid, (depth > 0.0) & np.isfinite(depth))
    assert (registered[valid] == 9).all()
    assert (registered[~valid] == 0).all()


@pytest.mark.parametrize(("color_camera", "coarse"), [(COLOR_CAMERA, 1), (LARGE_CAMERA, 1), (SMALL_CAMERA, 5)])
@pytest.mark.parametrize("T_depth_color", [BESIDE, BESIDE.inverse(), SE3.exp([0.0, 0.4, 0.2, -0.3, 0.0, 0.2])])
def test_colours_of_another_camera_are_those_of_the_same_places(color_camera, coarse, T_depth_color):
    pose = looking(0.0, 0.1, (-0.5, 0.1, 0.0))  # the ball hides a part of the wall
    T_map_color = pose @ T_depth_color
    depth = Room().depth(pose, MIDDLE_CAMERA)
    registered, valid = register_color(
        picture(T_map_color, color_camera), color_camera, T_depth_color, depth, MIDDLE_CAMERA
    )
    p_map = pose @ MIDDLE_CAMERA.backproject(depth).reshape(-1, 3).astype(np.float64)
    rays = p_map - T_map_color.translation
    reached = Room().cast(T_map_color.translation, rays)
    visible = (reached > 0.99).reshape(valid.shape)
    pixels, z = color_camera.project(T_map_color.inverse() @ p_map)
    size = (color_camera.width, color_camera.height)
    inside = ((z > 0.0) & (pixels > -0.5).all(axis=1) & (pixels < np.array(size) - 0.5).all(axis=1)).reshape(
        valid.shape
    )
    assert not valid[~inside].any()
    hidden = inside & ~visible
    assert valid[hidden].sum() <= 0.05 * hidden.sum() + 10 * coarse  # at the edge of what hides them
    assert valid[visible & inside].mean() > 1.0 - 0.02 * coarse
    off = np.abs(registered.astype(int) - paint(p_map).reshape(registered.shape))[valid & visible].max(axis=1)
    assert np.median(off) <= 2
    assert np.percentile(off, 99) <= 20


def test_something_before_the_wall_hides_it_from_the_colour_camera():
    """A near post in the middle: the strip of wall beside it that only the depth camera sees gets no colour."""
    depth = np.full((240, 320), 4.0, np.float32)
    depth[:, 140:180] = 1.0
    color = np.full((240, 320, 3), 77, np.uint8)
    to_the_right = SE3(np.eye(3), [0.2, 0.0, 0.0])
    _, valid = register_color(color, MIDDLE_CAMERA, to_the_right, depth, MIDDLE_CAMERA)
    shift = 200.0 * 0.2 * (1.0 / 1.0 - 1.0 / 4.0)  # of the post against the wall [pixels]
    hidden = ~valid[120, 10:-10]
    assert abs(hidden.sum() - shift) <= 3
    assert hidden[140 - 10 - int(shift) + 2 : 140 - 10 - 2].all()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"color": np.zeros((2, 2, 3), np.uint8)}, "color"),
        ({"color": np.zeros((48, 64, 3))}, "color"),
        ({"depth": np.zeros((2, 2), np.float32)}, "depth"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_images_that_do_not_fit_are_refused(change, expected):
    fitting = {
        "color": np.zeros((48, 64, 3), np.uint8),
        "color_intrinsics": SMALL_CAMERA,
        "T_depth_color": SE3.identity(),
        "depth": np.zeros((48, 64), np.float32),
        "intrinsics": SMALL_CAMERA,
    }
    with pytest.raises((InvalidObservation, InvalidParameter), match=expected):
        register_color(**(fitting | change))
    with pytest.raises(InvalidObservation, match="ranges"):
        range_image_to_points(np.zeros((2, 2), np.float32), LidarModel.even(3, -0.1, 0.1, 4))
