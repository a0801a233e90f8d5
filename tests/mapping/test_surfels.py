"""Surfels: moments that can be merged, the normals and discs that they make, and how well points fit them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.kernels import surfels as kernels
from mapping.surfels import FLATTEST, SurfelMap
from tests.naive_points import distributions, mahalanobis, normal_of, welford
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

HERE = SE3.identity()
UPPER = np.triu_indices(3)


def cloud(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.4, 0.4, (n, 3))


def moments(layer: SurfelMap) -> dict[tuple[int, ...], np.ndarray]:
    rows = layer.store.used("moments")[:, 0].astype(np.float64)
    return dict(zip(map(tuple, layer.block_ijk.tolist()), rows, strict=True))


def assert_equal_up_to_rounding(one: SurfelMap, other: SurfelMap, atol: float = 1e-6) -> None:
    first, second = moments(one), moments(other)
    assert first.keys() == second.keys()
    for voxel, row in first.items():
        assert np.allclose(row[:4], second[voxel][:4], rtol=1e-6, atol=atol)
        assert np.allclose(row[4:], second[voxel][4:], rtol=1e-5, atol=atol * row[0])


def matrices() -> np.ndarray:
    """Symmetric matrices of all kinds: full, flat, lines, with equal eigenvalues, tiny and huge."""
    rng = np.random.default_rng(0)
    turns = np.linalg.qr(rng.normal(size=(400, 3, 3)))[0]
    values = np.array(
        [[0, 0, 0], [1, 1, 1], [0, 1, 1], [0, 0, 1], [1, 2, 3], [-1, 0, 1], [1, 1, 1 + 1e-9], [0, 1e-8, 1]]
    )
    scale = 10.0 ** rng.integers(-12, 13, 400)
    picked = values[np.arange(400) % len(values)] * scale[:, None]
    made = turns @ (picked[:, :, None] * turns.transpose(0, 2, 1))
    return np.concatenate([0.5 * (made + made.transpose(0, 2, 1)), [np.diag(v) for v in values.astype(float)]])


def test_decomposition_matches_lapack():
    values, vectors = np.empty(3), np.empty((3, 3))
    for matrix in matrices():
        kernels.decompose(matrix[UPPER], values, vectors)
        size = np.abs(matrix).max()
        assert np.allclose(values, np.linalg.eigvalsh(matrix), rtol=0.0, atol=1e-14 * size)
        assert np.allclose(vectors @ vectors.T, np.eye(3), atol=1e-13)
        assert np.allclose(vectors @ matrix @ vectors.T, np.diag(values), rtol=0.0, atol=1e-13 * size)


@given(seed=st.integers(0, 10_000), n=st.integers(0, 400))
@settings(deadline=None, max_examples=25)
def test_distributions_match_the_naive_reference(seed, n):
    points = cloud(n, seed)
    layer = SurfelMap(0.25, min_points=3)
    layer.integrate(points, HERE)
    expected = {v: of for v, of in distributions(points, 0.25).items() if of[0] >= 3}
    surfels = layer.surfels
    assert len(surfels) == len(expected)
    for centre, normal, covariance, count in zip(
        surfels.centres, surfels.normals, surfels.covariances, surfels.counts, strict=True
    ):
        n_points, mean, expected_covariance = expected[tuple(np.floor(centre / 0.25).astype(int))]
        assert count == n_points
        assert np.allclose(centre, mean, atol=1e-6)
        assert np.allclose(covariance, expected_covariance, atol=1e-8)
        gap = np.diff(np.linalg.eigvalsh(expected_covariance))[0]
        if gap > 1e-5:
            assert np.allclose(normal, normal_of(expected_covariance, -mean), atol=1e-3)


def test_merging_one_point_is_welfords_update():
    points = np.random.default_rng(1).uniform(0.0, 1.0, (200, 3))
    merged = np.zeros((1, kernels.MOMENTS), np.float32)
    for point in points:
        row = np.array([[1.0, *point, 0, 0, 0, 0, 0, 0, 0, 0, 1.0]])
        kernels.merge_moments(merged, np.array([0]), row)
    n, mean, scatter = welford(points)
    assert merged[0, 0] == n
    assert np.allclose(merged[0, 1:4], mean, atol=1e-6)
    assert np.allclose(merged[0, 4:10], scatter[UPPER], rtol=1e-5)
    assert np.allclose(scatter, np.cov(points, rowvar=False) * (n - 1))


@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(0, 400), max_size=4))
@settings(deadline=None, max_examples=25)
def test_neither_order_nor_division_into_scans_nor_merging_matters(seed, cuts):
    points = cloud(400, seed)
    whole, parts, merged = SurfelMap(0.25), SurfelMap(0.25), SurfelMap(0.25)
    whole.integrate(points, HERE)
    for part in np.split(np.random.default_rng(seed).permutation(points), sorted(cuts)):
        parts.integrate(part, HERE)
        alone = SurfelMap(0.25)
        alone.integrate(part, HERE)
        merged.merge(alone)
    for other in (parts, merged):
        # the side from which a voxel was seen is taken once a scan, hence differs with the division
        for rows in (whole, other):
            rows.store.used("moments")[..., 10:] = 0.0
        assert_equal_up_to_rounding(other, whole)


def test_many_scans_lose_no_precision():
    rng = np.random.default_rng(0)
    layer = SurfelMap(1.0)
    points = 0.5 + 0.001 * rng.normal(size=(300, 50, 3)) + [0.3, 0.0, 0.0]
    for scan in points:
        layer.integrate(scan, HERE)
    expected = np.cov(points.reshape(-1, 3), rowvar=False)
    assert np.allclose(layer.surfels.covariances[0], expected, rtol=0.0, atol=1e-3 * expected.max())
    assert np.allclose(layer.surfels.centres[0], points.mean(axis=(0, 1)), atol=1e-6)


def test_surfels_of_a_room_lie_on_its_surfaces_and_look_inside():
    layer, room = SurfelMap(0.1), Room()
    for n in (0, 2, 4, 6):
        layer.integrate(room.scan(TOUR[n], 10_000, seed=n), TOUR[n])
    surfels = layer.surfels
    distance = room.distance(surfels.centres)
    to_corner = np.sort(np.abs(np.abs(surfels.centres) - room.half), axis=1)[:, 1]
    from_ball = np.linalg.norm(surfels.centres - room.ball, axis=1) - room.radius
    smooth = (to_corner > 0.1) & (from_ball > 0.15)  # not an edge of two walls, not the ball
    assert np.abs(distance[smooth]).max() < 1e-6
    inwards = -np.sign(surfels.centres) * (np.abs(surfels.centres) > np.array(room.half) - 0.001)
    flat = smooth & (surfels.planarity > 0.01)
    assert (np.einsum("ni,ni->n", surfels.normals, inwards)[flat] > 0.999).all()
    ball = np.abs(from_ball) < 0.02
    outwards = (surfels.centres - room.ball)[ball]
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    assert np.median(np.einsum("ni,ni->n", surfels.normals[ball], outwards)) > 0.98
    assert np.linalg.norm(surfels.normals, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_the_radius_is_that_of_the_disc_that_was_sampled():
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0.0, 2 * np.pi, 20_000), 0.3 * np.sqrt(rng.uniform(0.0, 1.0, 20_000))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(20_000)], axis=1)
    layer = SurfelMap(1.0)
    layer.integrate(SE3.exp([0, 0, 0, 0.4, 0.3, 0.0]) @ disc + 0.5, HERE)
    assert layer.surfels.radii == pytest.approx([0.3], rel=0.01)
    assert layer.surfels.planarity == pytest.approx([1.0], abs=0.05)


def test_query_is_the_distance_from_the_plane_on_the_side_of_the_sensor():
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(500, 1.05), rng.uniform(-0.2, 0.2, 500), rng.uniform(-0.2, 0.2, 500)])
    for sensor, sign in ((HERE, 1.0), (SE3(np.eye(3), [3.0, 0.0, 0.0]), -1.0)):
        layer = SurfelMap(0.1)
        layer.integrate(sensor.inverse() @ wall, sensor)
        asked = np.array([[1.02, 0.05, 0.05], [1.07, 0.05, 0.05], [0.95, 0.05, 0.05], [np.nan, 0.0, 0.0]])
        assert layer.query(asked) == pytest.approx([sign * 0.03, -sign * 0.02, np.nan, np.nan], abs=1e-6, nan_ok=True)


def test_likelihood_matches_the_naive_reference():
    points = cloud(600, 4) * [1.0, 1.0, 0.05]
    layer = SurfelMap(0.2)
    layer.integrate(points, HERE)
    known = distributions(points, 0.2)
    asked = cloud(300, 5) * [1.0, 1.0, 0.05]
    m, likelihood = layer.mahalanobis(asked), layer.likelihood(asked)
    for point, value, score in zip(asked, m, likelihood, strict=True):
        of = known.get(tuple(np.floor(point / 0.2).astype(int)), (0,))
        if of[0] < 5:
            assert np.isnan(value)
        else:
            assert value == pytest.approx(mahalanobis(point, of[1], of[2], FLATTEST), rel=1e-3)
            assert score == pytest.approx(np.exp(-0.5 * value**2))
    assert np.nanmax(likelihood) <= 1.0


def test_a_scan_fits_best_where_it_was_taken():
    layer = SurfelMap(0.3)
    scan = Room().scan(TOUR[0], 8000)
    layer.integrate(scan, TOUR[0])
    again = Room().scan(TOUR[0], 2000, seed=1)

    def fit(shift: float) -> float:
        return float(np.nan_to_num(layer.likelihood(TOUR[0] @ again + [shift, 0.0, 0.0])).mean())

    assert fit(0.0) > 1.1 * max(fit(shift) for shift in (-0.1, -0.03, 0.03, 0.1))


def test_images_and_points_give_the_same_map():
    depth = Room().depth(TOUR[0], SMALL_CAMERA)
    by_image, by_points = SurfelMap(0.1), SurfelMap(0.1)
    by_image.integrate_image(depth, SMALL_CAMERA, TOUR[0])
    by_points.integrate(SMALL_CAMERA.backproject(depth).reshape(-1, 3), TOUR[0])
    assert_equal_up_to_rounding(by_image, by_points, atol=1e-5)


def test_colours_are_means_whatever_the_order():
    points = cloud(400, 7)
    color = np.random.default_rng(8).integers(0, 256, (400, 3)).astype(np.uint8)
    whole, parts, merged = SurfelMap(0.4), SurfelMap(0.4), SurfelMap(0.4)
    whole.integrate(points, HERE, color=color)
    for part in np.split(np.random.default_rng(9).permutation(400), [50, 300]):
        parts.integrate(points[part], HERE, color=color[part])
        alone = SurfelMap(0.4)
        alone.integrate(points[part], HERE, color=color[part])
        merged.merge(alone)
    voxel = [tuple(v) for v in np.floor(points / 0.4).astype(int).tolist()]
    for layer in (whole, parts, merged):
        surfels = layer.surfels
        for centre, found in zip(np.floor(surfels.centres / 0.4).astype(int).tolist(), surfels.colors, strict=True):
            expected = color[[v == tuple(centre) for v in voxel]].mean(axis=0)
            assert np.abs(found - expected).max() <= 0.51


def test_colours_come_with_the_first_scan_that_has_them():
    layer = SurfelMap(0.1, min_points=3)
    points = np.array([[0.01, 0.0, 0.0], [0.02, 0.01, 0.0], [0.02, 0.02, 0.0]])
    layer.integrate(points + np.array([1.0, 0.0, 0.0]), HERE)
    assert layer.surfels.colors is None
    layer.integrate(points, HERE, color=np.full((3, 3), 9, np.uint8))
    assert sorted(layer.surfels.colors.tolist()) == [[0, 0, 0], [9, 9, 9]]
    layer.integrate(points, HERE)  # without colours these stay
    assert sorted(layer.surfels.colors.tolist()) == [[0, 0, 0], [9, 9, 9]]
    with pytest.raises(InvalidObservation, match="color"):
        layer.integrate(points, HERE, color=np.zeros((3, 3)))


def test_fewer_points_make_no_surfel_and_bad_ones_are_refused():
    layer = SurfelMap(0.1, 5.0, min_points=3)
    layer.integrate([[0.01, 0.0, 0.0], [0.02, 0.01, 0.0], [6.0, 0.0, 0.0]], HERE)
    assert len(layer.surfels) == 0
    assert np.isnan(layer.query([[0.01, 0.0, 0.0], [6.0, 0.0, 0.0]])).all()
    layer.integrate([[0.02, 0.02, 0.0]], HERE)
    assert len(layer.surfels) == 1
    with pytest.raises(InvalidObservation, match="p_sensor"):
        layer.integrate([[np.inf, 0.0, 0.0]], HERE)
    with pytest.raises(InvalidParameter, match="voxel_size_m"):
        layer.merge(SurfelMap(0.2))
    with pytest.raises(InvalidParameter, match="min_points"):
        SurfelMap(0.1, min_points=3.5)


def compiled() -> dict[str, int]:
    """For each kernel of the module, for how many types of input it is compiled."""
    own = {name: kernel for name, kernel in vars(kernels).items() if hasattr(kernel, "signatures")}
    return {name: len(k.signatures) for name, k in own.items() if k.py_func.__module__ == kernels.__name__}


def test_kernels_are_compiled_once_whatever_arrays_a_caller_holds():
    points = cloud(60, 0)
    for scan in (points, points.astype(np.float32)[::2], np.asfortranarray(points), points.tolist()):
        layer = SurfelMap(0.4)
        layer.integrate(scan, HERE)
        layer.integrate(scan, HERE, color=np.zeros((len(scan), 3), np.uint8)[:, ::-1])
        layer.merge(SurfelMap.from_state(layer.state()))
        layer.query(scan)
        layer.likelihood(scan)
        assert len(layer.surfels)
    assert max(compiled().values()) == 1
