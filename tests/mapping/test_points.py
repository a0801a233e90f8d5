"""Point map: a bounded sample that does not depend on order, and who is near."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.kernels import points as kernels
from mapping.kernels.points import EMPTY
from mapping.points import PointMap
from tests.naive_points import kept_places, points_of
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

HERE = SE3.identity()


def cloud(n: int, seed: int, spread: float = 0.4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-spread, spread, (n, 3))


def as_set(points: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(p) for p in np.asarray(points, np.float32).tolist()}


def words(layer: PointMap) -> dict[tuple[int, ...], list[int]]:
    """What each voxel keeps, bit by bit."""
    return dict(zip(map(tuple, layer.block_ijk.tolist()), layer.store.used("points")[:, 0].tolist(), strict=True))


@given(seed=st.integers(0, 10_000), n=st.integers(0, 300), max_points=st.sampled_from([1, 2, 4, 5, 16, 40]))
@settings(deadline=None, max_examples=40)
def test_a_voxel_keeps_what_the_naive_reference_keeps(seed, n, max_points):
    points = cloud(n, seed)
    layer = PointMap(0.25, max_points)
    layer.integrate(points, HERE)
    expected = kept_places(points, 0.25, max_points)
    assert as_set(layer.points) == as_set(points_of(expected, 0.25).astype(np.float32))
    assert len(layer.points) == sum(len(of) for of in expected.values())


@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(0, 300), max_size=4), max_points=st.integers(1, 20))
@settings(deadline=None, max_examples=40)
def test_neither_order_nor_division_into_scans_matters(seed, cuts, max_points):
    points = cloud(300, seed)
    whole, parts = PointMap(0.25, max_points), PointMap(0.25, max_points)
    whole.integrate(points, HERE)
    shuffled = np.random.default_rng(seed + 1).permutation(points)
    for part in np.split(shuffled, sorted(cuts)):
        parts.integrate(part, HERE)
    assert words(parts) == words(whole)


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=20)
def test_merged_maps_are_the_map_of_all_points(seed):
    one, other, both = (PointMap(0.25, 4) for _ in range(3))
    first, second = cloud(200, seed), cloud(200, seed + 1)
    one.integrate(first, HERE, intensity=first[:, 0])
    other.integrate(second, HERE, intensity=second[:, 0])
    both.integrate(np.concatenate([first, second]), HERE, intensity=np.concatenate([first, second])[:, 0])
    one.merge(other)
    assert words(one) == words(both)
    assert np.allclose(one.intensity, one.points[:, 0], atol=1e-5)
    with pytest.raises(InvalidParameter, match="max_points"):
        one.merge(PointMap(0.25, 5))


def test_merging_keeps_what_only_one_of_two_maps_has():
    plain, colored = PointMap(0.25), PointMap(0.25)
    plain.integrate([[1.0, 0.0, 0.0]], HERE)
    colored.integrate([[2.0, 0.0, 0.0]], HERE, color=np.array([[1, 2, 3]], np.uint8))
    plain.merge(colored)
    assert plain.color[plain.points[:, 0] > 1.5].tolist() == [[1, 2, 3]]
    assert plain.color[plain.points[:, 0] < 1.5].tolist() == [[0, 0, 0]]
    colored.merge(PointMap(0.25))
    assert len(colored.points) == 1


@given(seed=st.integers(0, 10_000), max_points=st.integers(1, 64))
@settings(deadline=None, max_examples=30)
def test_no_voxel_holds_more_than_its_bound_and_no_cell_more_than_one(seed, max_points):
    layer = PointMap(0.2, max_points)
    for n in range(3):
        layer.integrate(cloud(2000, seed + n, 0.3), HERE)
    for of_voxel in words(layer).values():
        of_voxel = [word for word in of_voxel if word != EMPTY]
        assert of_voxel == sorted(of_voxel)
        assert 1 <= len(of_voxel) <= max_points
        places = [[word >> shift & 0xFFFF for shift in (32, 16, 0)] for word in of_voxel]
        assert len({tuple(q * round(0.2 / layer.cell_size_m) // 65536 for q in place) for place in places}) == len(
            places
        )


def test_points_stay_where_they_were_measured():
    points = cloud(50, 3, 20.0)
    pose = SE3.exp([5.0, -3.0, 1.0, 0.3, -0.2, 2.0])
    layer = PointMap(0.2, 16)
    layer.integrate(points, pose)
    expected = pose @ points
    distance = np.linalg.norm(expected[:, None] - layer.points[None], axis=2).min(axis=1)
    assert len(layer.points) == 50
    assert distance.max() < 1e-5


def test_the_same_scan_again_changes_nothing():
    layer = PointMap(0.1)
    scan = Room().scan(TOUR[0], 2000)
    assert len(layer.integrate(scan, TOUR[0])) == layer.store.n_blocks
    before = words(layer)
    assert len(layer.integrate(scan, TOUR[0])) == 0
    assert words(layer) == before


def test_what_is_kept_is_a_fair_sample():
    """Many points in one voxel, half in each of two scans: about half of those kept are of either."""
    first = 0
    for seed in range(60):
        points = np.random.default_rng(seed).uniform(0.0, 0.1, (400, 3))
        layer = PointMap(0.1, 8)
        layer.integrate(points[:200], HERE, intensity=np.zeros(200))
        layer.integrate(points[200:], HERE, intensity=np.ones(200))
        first += int((layer.intensity == 0.0).sum())
    assert 0.4 < first / (60 * 8) < 0.6


def test_nearest_matches_trying_all():
    rng = np.random.default_rng(0)
    layer = PointMap(0.1, 8)
    layer.integrate(Room().scan(TOUR[0], 3000), TOUR[0])
    points = layer.points.astype(np.float64)
    asked = np.concatenate([rng.uniform(-2.5, 2.5, (300, 3)), points[:50], points[50:100] + 0.01])
    distances = np.linalg.norm(asked[:, None] - points[None], axis=2)
    for reach in (0.03, 0.1, 0.37):
        nearest, distance = layer.nearest(asked, reach)
        found = distances.min(axis=1) <= reach
        assert np.array_equal(~np.isnan(distance), found)
        assert np.allclose(distance[found], distances.min(axis=1)[found], atol=1e-6)
        assert np.allclose(nearest[found], points[distances.argmin(axis=1)][found], atol=1e-6)
        assert np.isnan(nearest[~found]).all()
        owners, near = layer.radius(asked, reach)
        assert np.array_equal(np.bincount(owners, minlength=len(asked)), (distances <= reach).sum(axis=1))
        assert np.allclose(np.linalg.norm(asked[owners] - near, axis=1).max(), reach, atol=reach)
        assert (np.linalg.norm(asked[owners] - near, axis=1) <= reach + 1e-9).all()
    assert np.array_equal(layer.query(asked), layer.nearest(asked, 0.1)[1], equal_nan=True)


def test_the_tree_knows_what_came_last():
    layer = PointMap(0.1)
    rows, distances = layer.neighbours(np.zeros((1, 3)), 2)
    assert rows.tolist() == [[-1, -1]]
    assert np.isnan(distances).all()
    with pytest.raises(InvalidParameter, match="at least one point"):
        _ = layer.tree
    layer.integrate([[5.0, 0.0, 0.0]], HERE)
    assert layer.neighbours(np.zeros((1, 3)), 2)[1][0, 0] == pytest.approx(5.0, abs=1e-4)
    layer.integrate([[1.0, 0.0, 0.0]], HERE)
    rows, distances = layer.neighbours(np.zeros((1, 3)), 3)
    assert distances[0, :2] == pytest.approx([1.0, 5.0], abs=1e-4)
    assert layer.points[rows[0, 0]] == pytest.approx([1.0, 0.0, 0.0], abs=1e-4)
    assert np.isnan(distances[0, 2])
    assert layer.tree is layer.tree


def test_tree_and_voxels_agree():
    layer = PointMap(0.1)
    layer.integrate_image(Room().depth(TOUR[1], SMALL_CAMERA), SMALL_CAMERA, TOUR[1])
    asked = TOUR[1] @ Room().scan(TOUR[1], 300, seed=5)
    near = layer.query(asked, max_distance_m=0.5)
    by_tree = layer.neighbours(asked, 1)[1][:, 0]
    assert np.allclose(near, np.where(by_tree <= 0.5, by_tree, np.nan), atol=1e-5, equal_nan=True)


def test_an_image_gives_its_measured_pixels_with_their_colours():
    depth = Room().depth(TOUR[0], SMALL_CAMERA)
    depth[:5], depth[5, 0] = 0.0, np.nan
    color = np.random.default_rng(0).integers(1, 255, (*depth.shape, 3)).astype(np.uint8)
    layer = PointMap(0.05, 64)
    layer.integrate_image(depth, SMALL_CAMERA, TOUR[0], color)
    measured = np.nan_to_num(depth) > 0.0
    expected = TOUR[0] @ SMALL_CAMERA.backproject(depth)[measured].astype(np.float64)
    rows, distance = layer.neighbours(expected, 1)
    same = distance[:, 0] < 1e-5
    assert same.mean() > 0.9  # a few share a cell
    assert np.array_equal(layer.color[rows[same, 0]], color[measured][same])
    millimetres = PointMap(0.05, 64)
    millimetres.integrate_image(np.uint16(1000 * np.nan_to_num(depth)), SMALL_CAMERA, TOUR[0])
    assert np.nanmax(millimetres.query(layer.points)) < 0.03


def test_points_out_of_range_are_left_out():
    layer = PointMap(0.1, max_range_m=2.0)
    layer.integrate([[1.9, 0.0, 0.0], [2.1, 0.0, 0.0]], SE3(np.eye(3), [10.0, 0.0, 0.0]))
    assert layer.points[:, 0] == pytest.approx([11.9])


def test_bad_scans_are_refused_by_name():
    layer = PointMap(0.1)
    with pytest.raises(InvalidObservation, match="p_sensor"):
        layer.integrate([[np.nan, 0.0, 0.0]], HERE)
    with pytest.raises(InvalidObservation, match="too far"):
        layer.integrate([[1.0, 0.0, 0.0]], SE3(np.eye(3), [1e9, 0.0, 0.0]))
    with pytest.raises(InvalidObservation, match="intensity"):
        layer.integrate(np.zeros((2, 3)), HERE, intensity=[1.0])
    with pytest.raises(InvalidObservation, match="color"):
        layer.integrate(np.zeros((1, 3)), HERE, color=np.zeros((1, 3)))
    with pytest.raises(InvalidObservation, match="color"):
        layer.integrate_image(Room().depth(TOUR[0], SMALL_CAMERA), SMALL_CAMERA, TOUR[0], np.zeros((2, 2, 3), np.uint8))
    for bad in (0.0, np.nan, 11.0):
        with pytest.raises(InvalidParameter, match="max_distance_m"):
            layer.nearest(np.zeros((1, 3)), bad)
        with pytest.raises(InvalidParameter, match="radius_m"):
            layer.radius(np.zeros((1, 3)), bad)
    with pytest.raises(InvalidParameter, match="k: "):
        layer.neighbours(np.zeros((1, 3)), 0)
    with pytest.raises(InvalidParameter, match="p_map"):
        layer.neighbours(np.full((1, 3), np.inf), 1)
    assert len(layer.points) == 0
    assert layer.intensity is None
    assert layer.color is None


def compiled() -> dict[str, int]:
    """For each kernel of the module, for how many types of input it is compiled."""
    own = {name: kernel for name, kernel in vars(kernels).items() if hasattr(kernel, "signatures")}
    return {name: len(k.signatures) for name, k in own.items() if k.py_func.__module__ == kernels.__name__}


def test_kernels_are_compiled_once_whatever_arrays_a_caller_holds():
    points = cloud(60, 0)
    for scan in (points, points.astype(np.float32)[::2], np.asfortranarray(points), points.tolist()):
        plain, rich = PointMap(0.1), PointMap(0.1, 1)
        for layer, extras in ((plain, {}), (rich, {"intensity": np.arange(len(scan)).tolist()}), (rich, {})):
            layer.integrate(scan, HERE, **extras)
            layer.query(scan)
            layer.radius(scan, 0.1)
            layer.merge(PointMap.from_state(layer.state()))
            assert len(layer.points)
        rich.integrate(scan, HERE, color=np.zeros((len(scan), 3), np.uint8)[:, ::-1])
    assert max(compiled().values()) == 1
