"""The lidar model maps beams to points and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from mapping.errors import InvalidParameter
from mapping.kernels import lidar as kernels
from mapping.sensors import LidarModel
from tests import naive_lidar as naive

even = st.builds(
    LidarModel.even,
    rows=st.integers(1, 8),
    lowest=st.floats(-1.2, -0.1),
    highest=st.floats(0.0, 1.2),
    columns=st.integers(1, 32),
    first_azimuth=st.floats(-7.0, 7.0),
    span=st.one_of(st.just(2.0 * np.pi), st.floats(0.5, 6.2)),
)
uneven = st.builds(
    lambda steps, columns, span, gap: LidarModel(1.2 - np.cumsum(steps), columns, span=span, widest_gap=gap),
    steps=st.lists(st.floats(0.01, 0.3), min_size=1, max_size=8),
    columns=st.integers(1, 32),
    span=st.one_of(st.just(2.0 * np.pi), st.floats(0.5, 6.2)),
    gap=st.floats(0.02, 1.0),
)
lidars = st.one_of(even, uneven)


@settings(deadline=None)
@given(lidars, st.integers(0, 2**32))
def test_a_range_image_comes_back_from_its_points(lidar, seed):
    ranges = np.random.default_rng(seed).uniform(0.5, 20.0, lidar.shape).astype(np.float32)
    again, index = lidar.range_image(lidar.backproject(ranges).reshape(-1, 3))
    np.testing.assert_allclose(again, ranges, rtol=1e-5)
    assert index.ravel().tolist() == list(range(ranges.size))


@settings(deadline=None)
@given(lidars, st.integers(0, 2**32))
def test_a_point_is_assigned_to_the_nearest_beam(lidar, seed):
    p = np.random.default_rng(seed).normal(size=(20, 3)) * (3.0, 3.0, 0.5)
    rows, columns, distance = lidar.project(p)
    azimuths = lidar.first_azimuth - np.arange(lidar.columns) * lidar.span / lidar.columns
    for i in np.flatnonzero(rows >= 0):
        x, y, z = p[i] / distance[i]
        around = np.abs((np.arctan2(y, x) - azimuths + np.pi) % (2.0 * np.pi) - np.pi)
        assert around[columns[i]] <= around.min() + 1e-9
        above = np.abs(lidar.elevations - np.arcsin(z))
        assert above[rows[i]] <= above.min() + 1e-9


@settings(max_examples=60, deadline=None)
@given(lidars, st.integers(0, 2**32))
def test_the_range_image_is_that_of_the_naive_twin(lidar, seed):
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(60, 3)) * (3.0, 3.0, 1.0)
    p = np.concatenate([p, p[:20] * rng.uniform(0.5, 2.0, (20, 1)), np.zeros((1, 3)), [[np.nan, 0.0, 1.0]]])
    p = p[rng.permutation(len(p))]
    ranges, index = lidar.range_image(p)
    expected, which = naive.range_image(p, lidar)
    assert np.array_equal(index, which)
    np.testing.assert_allclose(ranges, expected, rtol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 64), st.integers(0, 2**32))
def test_borders_between_columns_are_exact(columns, seed):
    """What the approximate angle cannot tell apart is looked at again."""
    lidar = LidarModel.even(1, 0.0, 0.0, columns)
    rng = np.random.default_rng(seed)
    azimuth = (rng.integers(0, columns, 50) + 0.5) * 2.0 * np.pi / columns + rng.choice([-1e-9, 1e-9], 50)
    _, found, _ = lidar.project(np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(50)], axis=1))
    turn = (lidar.first_azimuth - azimuth) * columns / (2.0 * np.pi)
    assert np.array_equal(found, np.rint(turn).astype(int) % columns)


def test_the_fast_angle_is_as_good_as_it_says():
    angle = np.random.default_rng(0).uniform(-np.pi, np.pi, 200_000)
    x, y = 3.0 * np.cos(angle), 3.0 * np.sin(angle)

    @njit
    def angles(x, y):
        found = np.empty((2, x.shape[0]))
        for n in range(x.shape[0]):
            found[0, n] = kernels.angle_of(x[n], y[n], kernels.ATAN_64)
            found[1, n] = kernels.angle_of(np.float32(x[n]), np.float32(y[n]), kernels.ATAN_32)
        return found

    error = np.abs(np.exp(1j * angles(x, y)) - np.exp(1j * angle)).max(axis=1)
    assert error[0] < kernels.ATAN_ERROR
    assert error[1] < kernels.ATAN_ERROR + 1e-6


def test_what_lies_between_rings_that_are_far_apart_is_seen_by_none():
    lidar = LidarModel([0.5, 0.0], 4, widest_gap=0.2)
    elevation = np.array([0.65, 0.55, 0.45, 0.35, 0.15, 0.05, -0.05, -0.15])
    rows, _, _ = lidar.project(np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=1))
    assert rows.tolist() == [-1, 0, 0, -1, -1, 1, 1, -1]


def test_a_planar_scanner_sees_its_span_only():
    lidar = LidarModel([0.0], 181, first_azimuth=np.pi / 2, span=np.deg2rad(181.0))
    degrees = np.array([90.0, 90.4, 90.6, 0.0, -90.4, -90.6, 180.0])
    azimuth = np.deg2rad(degrees)
    rows, columns, _ = lidar.project(np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1))
    assert rows.tolist() == [0, 0, -1, 0, 0, -1, -1]
    assert columns[rows >= 0].tolist() == [0, 0, 90, 180]


def test_a_dome_is_a_lidar_too():
    """Rings near the pole are told apart although their sines hardly differ."""
    lidar = LidarModel.even(128, 0.0, np.deg2rad(89.9), 512)
    points = lidar.backproject(np.full(lidar.shape, 3.0, np.float32)).reshape(-1, 3).astype(np.float64)
    rows, _, _ = lidar.project(points)
    assert np.array_equal(rows, np.repeat(np.arange(128), 512))


def test_directions_are_left_to_right_and_top_to_bottom():
    lidar = LidarModel.even(3, -0.5, 0.5, 4)
    np.testing.assert_allclose(lidar.rays()[1], [[-1, 0, 0], [0, 1, 0], [1, 0, 0], [0, -1, 0]], atol=1e-7)
    assert lidar.rays()[0, 0, 2] > 0 > lidar.rays()[2, 0, 2]


def test_the_nearest_of_several_points_on_a_beam_counts():
    lidar = LidarModel.even(3, -0.5, 0.5, 4)
    ranges, index = lidar.range_image(np.array([[5.0, 0, 0], [2.0, 0, 0], [9.0, 0, 0]]))
    assert ranges[1, 2] == 2.0
    assert index[1, 2] == 1
    assert (index == -1).sum() == 11
    assert ranges.sum() == 2.0


def test_points_that_no_beam_sees_are_marked():
    lidar = LidarModel.even(3, -0.2, 0.2, 8)
    rows, _, _ = lidar.project(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, -0.9]]))
    assert rows.tolist() == [-1, -1, 1, -1]


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: LidarModel([], 4), "elevations"),
        (lambda: LidarModel([2.0], 4), "elevations"),
        (lambda: LidarModel([0.0, 0.1], 4), "decreasing"),
        (lambda: LidarModel([0.0], 0), "columns"),
        (lambda: LidarModel([0.0], 4, first_azimuth=np.nan), "first_azimuth"),
        (lambda: LidarModel([0.0], 4, span=0.0), "span"),
        (lambda: LidarModel([0.0], 4, span=7.0), "span"),
        (lambda: LidarModel([0.0], 4, widest_gap=np.nan), "widest_gap"),
        (lambda: LidarModel.even(0, 0.0, 1.0, 4), "rows"),
        (lambda: LidarModel([0.0], 4).backproject(np.zeros((2, 2))), "ranges"),
    ],
)
def test_what_is_no_lidar_is_refused(make, expected):
    with pytest.raises(InvalidParameter, match=expected):
        make()
