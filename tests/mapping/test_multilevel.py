"""The multi-level surface map against its twin, rule by rule."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.multilevel import MultiLevelMap
from mapping.tiles import HeightNoise
from tests import naive_elevation as naive
from tests.support.rooms import TOUR, Room

SIZE = 0.2
STILL = SE3.identity()
SIGMA = 0.02
EXACT = dict.fromkeys(asdict(HeightNoise()), 0.0) | {"least_sigma_m": SIGMA}
"""Noise that gives each height a σ of 2 cm, and the pose none."""


def column(*heights: float) -> np.ndarray:
    return np.array([[0.1, 0.1, z] for z in heights])


def fed(*scans: list[float], **parameters: float) -> MultiLevelMap:
    layer = MultiLevelMap(SIZE, **{**EXACT, **parameters})
    for scan in scans:
        layer.integrate(column(*scan), STILL)
    return layer


def patches(layer: MultiLevelMap) -> list[list[float]]:
    """μ, σ and d of the patches of the one cell."""
    found = layer.patches(column(0.0))[0]
    return found[~np.isnan(found[:, 0])].tolist()


# -- the rules -------------------------------------------------------------------------------------------------


def test_a_measurement_within_three_sigma_corrects_the_patch():
    layer = fed([0.0], [0.059])
    (mean, sigma, depth), *others = patches(layer)
    assert not others
    assert (mean, depth) == pytest.approx((0.0295, 0.0))
    assert sigma == pytest.approx(SIGMA)  # SIGMA/√2, but for the floor


def test_the_variance_shrinks_by_the_kalman_gain():
    layer = fed([1.0], range_sigma_m=0.04, least_sigma_m=1e-3)
    before = patches(layer)[0][1]
    layer.integrate(column(1.0), STILL)
    assert patches(layer)[0][1] == pytest.approx(before / np.sqrt(2.0), rel=1e-5)


def test_a_measurement_beyond_three_sigma_is_a_new_patch():
    assert [mean for mean, _, _ in patches(fed([0.0], [0.061]))] == pytest.approx([0.0, 0.061])


def test_a_measurement_where_a_patch_is_solid_is_disregarded():
    wall = list(np.arange(0.0, 1.01, 0.1))
    before = patches(fed(wall))
    assert before == [pytest.approx([1.0, SIGMA, 1.0])]
    assert patches(fed(wall, [0.5])) == before
    assert patches(fed(wall, [0.0])) == before
    assert len(patches(fed(wall, [1.2]))) == 2
    assert len(patches(fed(wall, [-0.1]))) == 2


def test_the_nearest_patch_is_the_one_that_is_updated():
    (low, _, _), (high, _, _) = patches(fed([0.0], [0.11], [0.06], least_sigma_m=0.03))
    assert low == pytest.approx(0.0)
    assert 0.06 < high < 0.11


def test_points_of_a_scan_are_cut_at_gaps_into_horizontal_and_vertical_patches():
    floor, wall, lamp = [0.0, 0.04], list(np.arange(1.0, 2.01, 0.2)), [3.0]
    found = patches(fed(floor + wall + lamp, gap_m=0.3, thickness_m=0.1))
    assert found == [
        pytest.approx([0.02, SIGMA, 0.0], abs=1e-5),
        pytest.approx([2.0, SIGMA, 1.0], abs=1e-5),
        pytest.approx([3.0, SIGMA, 0.0], abs=1e-5),
    ]


def test_a_vertical_patch_has_the_mean_and_variance_of_its_highest_point():
    layer = MultiLevelMap(SIZE, **{**EXACT, "range_sigma_per_m": 0.1})
    layer.integrate(np.array([[0.1, 0.1, z] for z in (-2.0, -1.9, -1.8)]), STILL)
    mean, sigma, depth = patches(layer)[0]
    distance = np.sqrt(0.1**2 + 0.1**2 + 1.8**2)
    assert mean == pytest.approx(-1.8)
    assert depth == pytest.approx(0.2)
    assert sigma == pytest.approx(np.hypot(0.1 * distance * 1.8 / distance, SIGMA), rel=1e-5)


def test_a_bridge_has_two_patches_and_room_between():
    layer = fed([0.0, 2.4, 2.5, 2.6])
    at = np.array([[0.1, 0.1, z] for z in (0.3, 2.4, 5.0)])
    assert layer.query(at) == pytest.approx([0.0, 2.6, 2.6])
    assert layer.clearance(at) == pytest.approx([2.4, np.inf, np.inf])
    assert layer.query(at[:, :2]) == pytest.approx([0.0] * 3)
    assert np.isnan(layer.clearance(at + 5.0)).all()
    assert layer.variance(at) == pytest.approx([SIGMA**2] * 3)


def test_a_wall_seen_in_pieces_that_overlap_is_one_patch():
    low, high = list(np.arange(0.0, 1.0, 0.1)), list(np.arange(0.5, 2.0, 0.1))
    assert patches(fed(low, high)) == [pytest.approx([1.9, SIGMA, 1.9])]
    assert patches(fed(high, low)) == [pytest.approx([1.9, SIGMA, 1.9])]


def test_of_too_many_patches_the_nearest_become_one():
    found = patches(fed([0.0], [1.0], [1.4], [3.0], most_patches=3))
    assert [(mean, depth) for mean, _, depth in found] == [
        pytest.approx(p, abs=1e-6) for p in ((0.0, 0.0), (1.4, 0.4), (3.0, 0.0))
    ]


# -- against the twin ------------------------------------------------------------------------------------------


@given(st.lists(st.lists(st.floats(-2.0, 4.0, width=16), min_size=1, max_size=5), min_size=1, max_size=9))
@settings(deadline=None, max_examples=150)
def test_any_column_follows_the_rules_of_the_twin(heights):
    layer = fed(*heights, gap_m=0.31, most_patches=4)
    expected: list[naive.Patch] = []
    for scan in heights:
        found = [naive.Measured(z, SIGMA**2) for z in scan]
        for z in naive.measurements(found, 0.31, 0.1):
            expected = naive.update(_rounded(expected), z, SIGMA**2, 4)
    assert patches(layer) == [pytest.approx([p.mean, p.variance**0.5, p.depth], abs=1e-4) for p in expected]


def _rounded(patches: list[naive.Patch]) -> list[naive.Patch]:
    """As the map keeps them between scans."""
    return [naive.Patch(*(float(np.float32(v)) for v in (p.mean, p.variance, p.depth))) for p in patches]


def test_scans_of_a_room_follow_the_rules_of_the_twin():
    noise = HeightNoise(pose_sigma_m=0.02, tilt_sigma_rad=0.005)
    layer = MultiLevelMap(SIZE, gap_m=0.31, **asdict(noise))
    cells = defaultdict(list)
    for n in range(4):
        points = Room().scan(TOUR[n], 800, seed=n)
        layer.integrate(points, TOUR[n])
        for cell, heights in naive.measured(points, TOUR[n], SIZE, noise).items():
            shared = naive.variance_of_pose(cell, 0.0, TOUR[n], noise.of_pose, SIZE)
            for z in naive.measurements(heights, 0.31, 0.1):
                z.variance += shared
                cells[cell] = naive.update(_rounded(cells[cell]), z, noise.least_sigma_m**2, 6)
    ours = layer.patches((np.array(list(cells)) + 0.5) * SIZE)
    theirs = np.full_like(ours, np.nan)
    for n, found in enumerate(cells.values()):
        theirs[n, : len(found)] = [[p.mean, p.variance**0.5, p.depth] for p in found]
    assert np.allclose(ours, theirs, atol=1e-4, equal_nan=True)
    assert np.isfinite(theirs[:, 1]).any()


@given(st.lists(st.floats(-2.0, 4.0, width=16), min_size=1, max_size=30))
@settings(deadline=None, max_examples=60)
def test_patches_ascend_and_never_overlap(heights):
    found = np.array(patches(fed(*[[z] for z in heights], most_patches=5)))
    assert (found[:, 2] >= 0.0).all()
    assert (found[1:, 0] - found[1:, 2] > found[:-1, 0]).all()
    solid = [(mean - depth - 3.0 * sigma - 1e-6, mean + 3.0 * sigma + 1e-6) for mean, sigma, depth in found]
    assert found[:, 0].max() >= max(heights) - 3.0 * SIGMA - 1e-6
    assert min(low for low, _ in solid) <= min(heights)


@given(st.lists(st.floats(-2.0, 4.0, width=16), min_size=1, max_size=30), st.floats(-3.0, 5.0))
@settings(deadline=None, max_examples=60)
def test_questions_are_about_the_patch_nearest_to_a_height(heights, z):
    layer = fed(heights, gap_m=0.4)
    found = [naive.Patch(mean, sigma**2, depth) for mean, sigma, depth in patches(layer)]
    n = min(range(len(found)), key=lambda n: found[n].distance(z))
    above = found[n + 1].bottom - found[n].mean if n + 1 < len(found) else np.inf
    assert layer.nearest(column(z))[0] == pytest.approx([found[n].mean, SIGMA, found[n].depth])
    assert layer.query(column(z))[0] == layer.nearest(column(z))[0, 0]
    assert layer.clearance(column(z))[0] == pytest.approx(above)
    assert layer.query(column(z)[:, :2])[0] == found[0].mean


def test_bounds_of_patches_are_checked():
    for bad in (0, 1.5, 65):
        with pytest.raises(InvalidParameter, match="most_patches"):
            MultiLevelMap(SIZE, most_patches=bad)
