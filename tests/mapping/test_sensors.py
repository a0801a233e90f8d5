"""The lidar model maps beams to points and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.sensors import LidarModel

lidars = st.builds(
    LidarModel.even,
    rows=st.integers(1, 8),
    lowest=st.floats(-1.2, -0.1),
    highest=st.floats(0.0, 1.2),
    columns=st.integers(1, 32),
    first_azimuth=st.floats(-7.0, 7.0),
)


@given(lidars, st.integers(0, 2**32))
def test_a_range_image_comes_back_from_its_points(lidar, seed):
    ranges = np.random.default_rng(seed).uniform(0.5, 20.0, lidar.shape).astype(np.float32)
    again, index = lidar.range_image(lidar.backproject(ranges).reshape(-1, 3))
    np.testing.assert_allclose(again, ranges, rtol=1e-5)
    assert index.ravel().tolist() == list(range(ranges.size))


@given(lidars, st.integers(0, 2**32))
def test_a_point_is_assigned_to_the_nearest_beam(lidar, seed):
    p = np.random.default_rng(seed).normal(size=(20, 3)) * (3.0, 3.0, 0.5)
    rows, columns, distance = lidar.project(p)
    azimuths = lidar.first_azimuth - np.arange(lidar.columns) * 2.0 * np.pi / lidar.columns
    for i in np.flatnonzero(rows >= 0):
        x, y, z = p[i] / distance[i]
        around = np.abs((np.arctan2(y, x) - azimuths + np.pi) % (2.0 * np.pi) - np.pi)
        assert around[columns[i]] <= around.min() + 1e-9
        above = np.abs(lidar.elevations - np.arcsin(z))
        assert above[rows[i]] <= above.min() + 1e-9


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
        (lambda: LidarModel.even(0, 0.0, 1.0, 4), "rows"),
        (lambda: LidarModel([0.0], 4).backproject(np.zeros((2, 2))), "ranges"),
    ],
)
def test_what_is_no_lidar_is_refused(make, expected):
    with pytest.raises(InvalidParameter, match=expected):
        make()
