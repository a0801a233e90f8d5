"""Height map, elevation map and extended elevation map against their twins, and the laws that they keep."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict
from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.drivable import label_points
from mapping.elevation import GAP, LEVEL, MOST_PARTS, UNKNOWN, VERTICAL, ElevationMap, ExtendedElevationMap, HeightMap
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.kernels import drivable as kernels_drivable
from mapping.kernels import elevation as kernels_elevation
from mapping.kernels import multilevel as kernels_multilevel
from mapping.kernels import tiles as kernels_tiles
from mapping.kernels import traversability as kernels_traversability
from mapping.multilevel import MultiLevelMap
from mapping.occupancy import OccupancyMap
from mapping.tiles import HeightNoise
from mapping.traversability import traversability
from tests import naive_elevation as naive
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

SIZE = 0.2
NOISE = HeightNoise(pose_sigma_m=0.02, tilt_sigma_rad=0.01)
LEVEL_SENSOR = SE3.identity()
EXACT = dict.fromkeys(asdict(NOISE), 0.0) | {"least_sigma_m": 0.01}
"""Noise that gives each height a σ of 1 cm, and the pose none."""


def tilted(seed: int) -> SE3:
    rng = np.random.default_rng(seed)
    return SE3.exp([*rng.uniform(-1.0, 1.0, 3), *rng.uniform(-0.3, 0.3, 3)])


def scans(n: int = 3, points: int = 300) -> list[tuple[np.ndarray, SE3]]:
    return [(Room().scan(TOUR[k], points, seed=k), TOUR[k]) for k in range(n)]


def centres(cells: list[naive.Cell]) -> np.ndarray:
    return (np.array(cells) + 0.5) * SIZE


def column(*heights: float, x: float = 0.1, y: float = 0.1) -> np.ndarray:
    return np.array([[x, y, z] for z in heights])


# -- against the twins -----------------------------------------------------------------------------------------


def test_a_height_map_holds_mean_lowest_highest_and_variance_of_all_points_of_a_cell():
    layer = HeightMap(SIZE)
    cells = defaultdict(list)
    for points, pose in scans():
        layer.integrate(points, pose)
        for cell, heights in naive.measured(points, pose, SIZE, NOISE).items():
            cells[cell] += [h.height for h in heights]
    at = centres(list(cells))
    assert np.allclose(layer.query(at), [np.mean(z) for z in cells.values()], atol=1e-5)
    assert np.allclose(layer.query(at, "lowest"), [min(z) for z in cells.values()], atol=1e-6)
    assert np.allclose(layer.query(at, "highest"), [max(z) for z in cells.values()], atol=1e-6)
    assert np.allclose(layer.variance(at), [np.var(z) for z in cells.values()], atol=1e-5)
    assert np.isfinite(layer.grid()[0]).sum() == len(cells)


def test_the_kalman_kernel_matches_updates_of_one_height_at_a_time():
    layer = ElevationMap(SIZE, **asdict(NOISE))
    cells = defaultdict(lambda: (0.0, np.inf))
    for points, pose in scans():
        layer.integrate(points, pose)
        for cell, heights in naive.measured(points, pose, SIZE, NOISE).items():
            z, variance = naive.kalman_of(heights)
            variance += naive.variance_of_pose(cell, z, pose, NOISE.of_pose, SIZE)
            cells[cell] = naive.kalman(*cells[cell], z, variance)
    at = centres(list(cells))
    assert np.allclose(layer.query(at), [mean for mean, _ in cells.values()], atol=1e-5)
    assert np.allclose(layer.variance(at), [variance for _, variance in cells.values()], rtol=1e-4)


def test_the_parts_of_an_extended_map_are_those_of_all_its_points_together():
    layer = ExtendedElevationMap(SIZE, robot_height_m=0.5, **asdict(NOISE))
    heights, weights = defaultdict(list), defaultdict(list)
    for points, pose in scans(4, 1000):
        layer.integrate(points, pose)
        for cell, found in naive.measured(points, pose, SIZE, NOISE).items():
            shared = naive.variance_of_pose(cell, 0.0, pose, NOISE.of_pose, SIZE)
            for group in naive.intervals([h.height for h in found], 0.5):
                inside = [h for h in found if group[0] <= h.height <= group[-1]]
                total = sum(1.0 / h.variance for h in inside)
                scale = 1.0 / (1.0 / total + shared) / total
                heights[cell] += [h.height for h in inside]
                weights[cell] += [scale / h.variance for h in inside]
    at = centres(list(heights))
    expected = [naive.parts_of(heights[cell], weights[cell], 0.5) for cell in heights]
    low, high = layer.extent(at)
    assert np.allclose(layer.query(at), [parts[0].mean for parts in expected], atol=1e-5)
    assert np.allclose(low, [parts[0].low for parts in expected], atol=1e-6)
    assert np.allclose(high, [parts[0].high for parts in expected], atol=1e-6)
    assert np.allclose(
        layer.variance(at),
        [
            max(1.0 / sum(np.array(weights[c])[np.array(heights[c]) <= parts[0].high]), 0.005**2)
            for c, parts in zip(heights, expected, strict=True)
        ],
        rtol=1e-4,
    )
    free = [parts[1].low - parts[0].high if len(parts) > 1 else np.inf for parts in expected]
    assert np.allclose(layer.clearance(at), free, atol=1e-5)
    classes = [VERTICAL if p[0].sigma > 0.1 else GAP if len(p) > 1 else LEVEL for p in expected]
    assert layer.classify(at).tolist() == classes
    assert {LEVEL, VERTICAL, GAP} <= set(classes)


@given(
    st.lists(st.floats(-5.0, 5.0, width=16), min_size=1, max_size=80),
    st.sampled_from([0.001, 0.1, 0.5, 1.0, 3.0]),
    st.integers(0, 3),
)
@settings(deadline=None, max_examples=150)
def test_heights_are_cut_at_gaps_whichever_way_is_fastest(heights, gap, skipped):
    lows, highs = np.empty(len(heights)), np.empty(len(heights))
    padded = np.array([9.0] * skipped + heights + [-9.0])
    n = kernels_tiles.split_at_gaps(padded, skipped, skipped + len(heights), gap, lows, highs)
    expected = naive.intervals(heights, gap)
    assert lows[:n].tolist() == [group[0] for group in expected]
    assert highs[:n].tolist() == [group[-1] for group in expected]


@given(seed=st.integers(0, 1000), cell=st.tuples(st.integers(-15, 15), st.integers(-15, 15)))
@settings(deadline=None, max_examples=30)
def test_the_variance_that_a_pose_gives_is_that_of_a_moved_pose(seed, cell):
    rng = np.random.default_rng(seed)
    root = rng.normal(0.0, 0.05, (6, 6))
    pose, covariance = tilted(seed), root @ root.T
    noise = {**EXACT, "least_sigma_m": 1e-3}
    layer = ElevationMap(SIZE, **noise)
    point = np.append(centres([cell])[0] + 0.03, 0.3)
    layer.integrate(pose.inverse() @ point[None], pose, covariance)
    shared = [naive.variance_of_pose(cell, z, pose, covariance, SIZE) for z in (-1.0, 0.3)]
    assert shared[0] == pytest.approx(shared[1], rel=1e-3)  # whatever the height
    assert layer.variance(centres([cell]))[0] == pytest.approx(shared[0] + 1e-6, rel=1e-3)


# -- laws ------------------------------------------------------------------------------------------------------


def test_what_is_far_is_known_less_well_and_what_is_seen_again_better():
    layer = ElevationMap(SIZE)
    floor_points = np.array([[x, 0.1, -1.0] for x in np.arange(5.1, 15.0, SIZE)])
    layer.integrate(floor_points, LEVEL_SENSOR)
    once = layer.variance(floor_points)
    assert (np.diff(once) > 0.0).all()
    layer.integrate(floor_points, LEVEL_SENSOR)
    assert np.allclose(layer.variance(floor_points), once / 2.0, rtol=1e-5)


def test_errors_are_as_large_as_the_variance_says():
    """Squared errors over variances average 1 when ranges, beams and poses err as the parameters say."""
    noise = HeightNoise(
        range_sigma_m=0.03, range_sigma_per_m=0.004, beam_sigma_rad=0.004, pose_sigma_m=0.03, tilt_sigma_rad=0.006,
        least_sigma_m=1e-3,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    distances = np.array([1.5, 3.1, 5.1, 8.1])
    floor = np.array([[d, 0.1, 0.0] for d in distances]).repeat(4, axis=0)
    ratios = []
    for _ in range(300):
        believed = SE3.exp([0.1, 0.1, 1.0, *rng.normal(0.0, 0.2, 3)])
        moved = believed @ SE3.exp(rng.multivariate_normal(np.zeros(6), noise.of_pose))
        seen = moved.inverse() @ (floor + np.r_[0.1, 0.0, 0.0])
        reach = np.linalg.norm(seen, axis=1, keepdims=True)
        seen += seen / reach * rng.normal(0.0, noise.range_sigma_m + noise.range_sigma_per_m * reach)
        seen += np.cross(seen, rng.normal(0.0, noise.beam_sigma_rad, seen.shape))
        layer = ElevationMap(2.0, **asdict(noise))
        layer.integrate(seen, believed)
        at = floor[::4, :2] + [0.1, 0.0]
        ratios.append(layer.query(at) ** 2 / layer.variance(at))
    assert np.nanmean(ratios) == pytest.approx(1.0, abs=0.15)


def test_a_height_is_never_believed_better_than_the_least_sigma_so_that_the_map_can_change_its_mind():
    layer = ElevationMap(SIZE, **EXACT)
    for _ in range(50):
        layer.integrate(column(0.0), LEVEL_SENSOR)
    assert layer.variance(column(0.0))[0] == pytest.approx(0.01**2)
    for _ in range(20):
        layer.integrate(column(0.5), LEVEL_SENSOR)
    assert layer.query(column(0.0))[0] == pytest.approx(0.5, abs=1e-3)


@given(st.lists(st.lists(st.floats(0.0, 5.0, width=16), min_size=1, max_size=6), min_size=2, max_size=5))
@settings(deadline=None, max_examples=60)
def test_parts_do_not_depend_on_how_points_are_dealt_to_scans(heights):
    together, apart, reverse = (ExtendedElevationMap(SIZE, robot_height_m=1.3, **EXACT) for _ in range(3))
    together.integrate(column(*chain(*heights)), LEVEL_SENSOR)
    for scan in heights:
        apart.integrate(column(*scan), LEVEL_SENSOR)
    for scan in heights[::-1]:
        reverse.integrate(column(*scan[::-1]), LEVEL_SENSOR)
    for other in (apart, reverse):
        assert np.allclose(
            other.store.fields["parts"], together.store.fields["parts"], rtol=1e-4, atol=1e-3, equal_nan=True
        )


def test_classes_are_level_vertical_gap_and_unknown():
    wall, underpass, hedge = np.arange(0.0, 2.0, 0.05), [0.0, 0.01, 2.5, 2.6], [*np.arange(0.0, 0.9, 0.05), 2.5]
    layer = ExtendedElevationMap(SIZE, robot_height_m=1.0, vertical_sigma_m=0.1)
    points = [column(0.0, 0.02), column(*wall, x=1.1), column(*underpass, x=2.1), column(*hedge, x=3.1)]
    layer.integrate(np.concatenate(points), LEVEL_SENSOR)
    at = np.array([[0.1, 0.1], [1.1, 0.1], [2.1, 0.1], [3.1, 0.1], [4.1, 0.1]])
    assert layer.classify(at).tolist() == [LEVEL, VERTICAL, GAP, VERTICAL, UNKNOWN]
    assert layer.query(at)[2] == pytest.approx(0.005, abs=1e-3)
    assert layer.clearance(at)[[0, 2]].tolist() == pytest.approx([np.inf, 2.49])
    assert np.isnan([layer.query(at)[4], layer.variance(at)[4], layer.clearance(at)[4], layer.extent(at)[0][4]]).all()


def test_a_gap_no_higher_than_the_robot_is_no_gap():
    layer = ExtendedElevationMap(SIZE, robot_height_m=1.0)
    layer.integrate(column(0.0, 1.0), LEVEL_SENSOR)
    assert layer.classify(column(0.0)).tolist() == [VERTICAL]


def test_of_too_many_parts_the_nearest_become_one():
    layer = ExtendedElevationMap(SIZE, robot_height_m=1.0, **EXACT)
    heights = [0.0, 3.0, 4.5, 8.0, 11.0]
    assert len(heights) == MOST_PARTS + 1
    for z in heights:
        layer.integrate(column(z), LEVEL_SENSOR)
    parts = layer.store.used("parts")[0][~np.isnan(layer.store.used("parts")[0])].reshape(-1, 5)
    assert parts[:, :2].tolist() == [[0.0, 0.0], [3.0, 4.5], [8.0, 8.0], [11.0, 11.0]]


def test_points_above_the_sensor_or_beyond_the_range_may_be_left_out():
    points = np.array([[1.0, 0.0, -0.5], [1.0, 0.0, 0.4], [1.0, 0.0, 0.6], [9.0, 0.0, 0.0]])
    pose = SE3(np.eye(3), [0.0, 0.0, 1.0])
    layer = HeightMap(SIZE, max_range_m=8.0, above_sensor_m=0.5)
    layer.integrate(points, pose)
    assert layer.query(np.array([[1.0, 0.0]]), "highest") == pytest.approx(1.4)
    assert np.isnan(layer.query(np.array([[9.0, 0.0]])))


# -- the shell -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [HeightMap, ElevationMap, ExtendedElevationMap])
def test_an_image_is_the_scan_of_its_points(make):
    depth = Room().depth(TOUR[1], SMALL_CAMERA)
    depth[3:9, 4:20] = 0.0
    depth[0, 0] = np.nan
    image, scan = make(SIZE), make(SIZE)
    image.integrate_image(depth, SMALL_CAMERA, TOUR[1])
    points = SMALL_CAMERA.backproject(depth).reshape(-1, 3)
    scan.integrate(points[depth.ravel() > 0.0], TOUR[1])
    for ours, theirs in zip(image.grid(), scan.grid(), strict=True):
        assert np.allclose(ours, theirs, atol=1e-5, equal_nan=True)
    with pytest.raises(InvalidObservation, match="depth"):
        image.integrate_image(depth[1:], SMALL_CAMERA, TOUR[1])


def test_points_may_be_asked_for_by_column_and_pictures_know_where_they_begin():
    layer = HeightMap(SIZE)
    layer.integrate(column(0.3, x=-0.5, y=1.1), LEVEL_SENSOR)
    assert layer.query(np.array([[-0.5, 1.1]])) == layer.query(np.array([[-0.5, 1.1, 9.0]])) == pytest.approx(0.3)
    heights, corner = layer.grid()
    assert heights.shape == (8, 8)
    assert corner == pytest.approx([-1.6, 0.0])
    assert heights[5, 5] == pytest.approx(0.3)
    assert np.isnan(heights).sum() == 63
    heights, corner = layer.box([-0.6, 1.0], [-0.2, 1.6])
    assert heights.shape == (2, 3)
    assert corner == pytest.approx([-0.6, 1.0])
    assert heights[0, 0] == pytest.approx(0.3)
    assert HeightMap(SIZE).grid()[0].shape == (0, 0)


def test_a_picture_of_half_the_world_is_refused():
    layer = HeightMap(SIZE, max_range_m=10_000.0)
    layer.integrate(np.array([[-9000.0, -9000.0, 0.0], [9000.0, 9000.0, 0.0]]) / 2.0, LEVEL_SENSOR)
    with pytest.raises(InvalidParameter, match="lo, hi"):
        layer.grid()
    assert layer.box([4499.0, 4499.0], [4501.0, 4501.0])[0].shape == (10, 10)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_points_that_are_not_finite_are_refused(bad):
    layer = ElevationMap(SIZE, max_range_m=10.0)
    with pytest.raises(InvalidObservation, match="finite"):
        layer.integrate(np.array([[0.0, bad, 0.0]]), LEVEL_SENSOR)
    assert layer.store.n_blocks == 0


def test_bad_questions_and_covariances_are_refused():
    layer = ElevationMap(SIZE)
    for covariance in (np.eye(3), np.full((6, 6), np.nan), -np.eye(6)):
        with pytest.raises(InvalidObservation, match="covariance"):
            layer.integrate(column(0.0), LEVEL_SENSOR, covariance)
    with pytest.raises(InvalidParameter, match="lo, hi"):
        layer.box([0.0, 0.0], [0.0, 1.0])
    with pytest.raises(InvalidParameter, match="which"):
        HeightMap(SIZE).query(column(0.0), "median")


def test_an_empty_scan_changes_nothing():
    for layer in (HeightMap(SIZE), ElevationMap(SIZE), ExtendedElevationMap(SIZE)):
        assert len(layer.integrate(np.zeros((0, 3)), LEVEL_SENSOR)) == 0


def test_a_scan_may_touch_more_tiles_than_there_was_room_for():
    points = np.stack([np.linspace(-20, 20, 900), np.zeros(900), np.zeros(900)], axis=1)
    layer = HeightMap(0.005)
    layer.integrate(points, LEVEL_SENSOR)
    assert layer.store.n_blocks > 256
    assert np.isfinite(layer.query(points)).all()


def compiled() -> dict[str, int]:
    """For each kernel of this layer family, for how many types of input it is compiled."""
    found = {}
    for module in (kernels_drivable, kernels_elevation, kernels_multilevel, kernels_tiles, kernels_traversability):
        found |= {
            f"{module.__name__}.{k}": len(v.signatures) for k, v in vars(module).items() if hasattr(v, "signatures")
        }
    return found


def test_kernels_are_compiled_once_whatever_arrays_a_caller_holds():
    points, depth = Room().scan(TOUR[0], 50), Room().depth(TOUR[0], SMALL_CAMERA)
    frozen = points[:1].copy()
    frozen.setflags(write=False)
    counts = []
    for cloud in (points, points.astype(np.float32)[::2], np.asfortranarray(points), frozen):
        for make in (HeightMap, ElevationMap, ExtendedElevationMap, MultiLevelMap):
            layer = make(SIZE)
            layer.integrate(cloud, TOUR[0])
            layer.integrate_image(depth, SMALL_CAMERA, TOUR[0])
            layer.query(cloud)
            layer.query(cloud[:, :2])
            traversability(layer, overhead=OccupancyMap(0.1))
        label_points(cloud)
        counts.append(compiled())
    assert all(later == counts[0] for later in counts[1:])
