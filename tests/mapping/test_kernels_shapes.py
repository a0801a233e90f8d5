"""Footprints, columns and distances between surfaces equal their slow twins and keep the laws of plane geometry."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapping.kernels import columns, shapes
from tests import naive_semantics as naive

coordinates = st.integers(-40, 40).map(lambda n: n / 8.0)  # exact in binary: points on a line lie exactly on it


def clouds(dimensions: int, most: int = 24) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, st.tuples(st.integers(1, most), st.just(dimensions)), elements=coordinates)


hulls = clouds(2).map(shapes.convex_hull).filter(lambda hull: len(hull) >= 3)


@settings(max_examples=150, deadline=None)
@given(points=clouds(2))
def test_the_hull_is_that_of_the_naive_reference(points: np.ndarray) -> None:
    hull = shapes.convex_hull(points)
    expected = shapely.MultiPoint(points).convex_hull
    assert {tuple(p) for p in hull} == {tuple(p) for p in shapely.get_coordinates(expected)}
    if len(hull) >= 3:
        assert shapes.polygon_area(hull) == pytest.approx(expected.area)
        assert shapes.polygon_area(hull) > 0, "counter-clockwise"


@settings(max_examples=100, deadline=None)
@given(a=hulls, b=hulls)
def test_the_overlap_of_two_footprints_is_that_of_the_naive_reference(a: np.ndarray, b: np.ndarray) -> None:
    assert shapes.overlap_area(a, b) == pytest.approx(naive.overlap_area(a, b), abs=1e-9)
    assert shapes.overlap_area(a, b) == pytest.approx(shapes.overlap_area(b, a), abs=1e-9)
    assert shapes.overlap_area(a, a) == pytest.approx(shapes.polygon_area(a))


def test_what_has_no_ground_overlaps_nothing() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    assert shapes.overlap_area(square, np.array([[0.2, 0.2], [0.8, 0.8]])) == 0.0
    assert shapes.overlap_area(np.array([[0.5, 0.5]]), square) == 0.0


@settings(max_examples=100, deadline=None)
@given(hull=hulls, points=clouds(2), margin=st.sampled_from([0.0, 0.3]))
def test_points_inside_a_footprint(hull: np.ndarray, points: np.ndarray, margin: float) -> None:
    found = shapes.points_inside(hull, points, margin)
    away = shapely.distance(shapely.points(points), shapely.Polygon(hull))
    assert found[away == 0.0].all()
    if margin == 0.0:
        assert not found[away > 1e-9].any()
    else:  # grown by moving its sides: a corner reaches farther than the margin
        assert found[away < margin - 1e-9].all()


@settings(max_examples=100, deadline=None)
@given(hull=hulls)
def test_the_fitted_rectangle_holds_all_points(hull: np.ndarray) -> None:
    x, y, length, width, angle = shapes.fit_rectangle(hull, 800, 0.02)
    assert length >= width >= 0.0
    assert -np.pi / 2 <= angle < np.pi / 2
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    local = hull - (x, y)
    assert (np.abs(local @ along) <= 0.5 * length + 1e-6).all()
    assert (np.abs(local @ across) <= 0.5 * width + 1e-6).all()


@settings(max_examples=60, deadline=None)
@given(yaw=st.floats(-1.5, 1.5), length=st.floats(0.3, 2.0), share=st.floats(0.2, 0.9), seed=st.integers(0, 99))
def test_two_faces_of_a_box_give_its_direction(yaw: float, length: float, share: float, seed: int) -> None:
    """Its front and one side are seen, the back is not: the box is not turned towards the missing corner."""
    rng = np.random.default_rng(seed)
    width = share * length
    front = np.column_stack([rng.uniform(0.0, length, 300), np.zeros(300)])
    side = np.column_stack([np.zeros(100), rng.uniform(0.0, width, 100)])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    points = (np.concatenate([front, side]) + rng.normal(0.0, 0.004, (400, 2))) @ turn.T
    x, y, found_length, found_width, angle = shapes.fit_rectangle(np.ascontiguousarray(points), 800, 0.02)
    assert abs((angle - yaw + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(4.0)
    assert found_length == pytest.approx(length, abs=0.06)
    assert found_width == pytest.approx(width, abs=0.06)
    assert np.allclose((x, y), turn @ (0.5 * length, 0.5 * width), atol=0.05)


@settings(max_examples=60, deadline=None)
@given(a=clouds(3), b=clouds(3))
def test_the_nearest_pair_is_that_of_the_naive_reference(a: np.ndarray, b: np.ndarray) -> None:
    distance, i, j = shapes.nearest_pair(a.astype(np.float32), b.astype(np.float32))
    assert distance == pytest.approx(naive.nearest_pair(a, b))
    assert np.linalg.norm(a[i] - b[j]) == pytest.approx(distance)


@settings(max_examples=60, deadline=None)
@given(points=clouds(3), radius=st.floats(0.1, 3.0))
def test_the_points_within_a_ball(points: np.ndarray, radius: float) -> None:
    found = shapes.within(points, points[0], radius)
    assert found.tolist() == np.flatnonzero(((points - points[0]) ** 2).sum(axis=1) <= radius * radius).tolist()


@settings(max_examples=60, deadline=None)
@given(points=clouds(3))
def test_what_faces_up_is_that_of_the_naive_reference(points: np.ndarray) -> None:
    keys = columns.column_keys(points, 0.5)
    order = np.lexsort((points[:, 2], keys))
    found = columns.facing_up(points, keys, order, 0.2, 1.0)
    assert found.tolist() == naive.facing_up(points, 0.5, 0.2, 1.0).tolist()


@settings(max_examples=60, deadline=None)
@given(points=clouds(3))
def test_each_column_has_one_bottom_and_each_cell_one_point(points: np.ndarray) -> None:
    keys = columns.column_keys(points, 0.5)
    order = np.lexsort((points[:, 2], keys))
    bottoms = columns.column_bottoms(points, keys, order)
    column = [tuple(c) for c in np.floor(points[:, :2] / 0.5)]
    lowest = {c: min(p[2] for p, d in zip(points, column, strict=True) if d == c) for c in column}
    assert {column[n]: points[n, 2] for n in bottoms} == lowest
    assert len(bottoms) == len(lowest)

    kept = columns.thin_out(points, 0.5)
    cells = [tuple(c) for c in np.floor(points / 0.5)]
    assert kept.tolist() == sorted(cells.index(c) for c in set(cells))


@settings(max_examples=60, deadline=None)
@given(points=clouds(3, 6), material=clouds(3, 30), beside=st.sampled_from([0.3, 1.1]))
def test_closed_sides_are_those_of_the_naive_reference(points: np.ndarray, material: np.ndarray, beside: float) -> None:
    assert columns.closed_sides(points, material, beside).tolist() == naive.closed_sides(points, material, beside)


weighted = clouds(3).flatmap(
    lambda p: st.tuples(st.just(p), hnp.arrays(np.float64, len(p), elements=st.integers(1, 8).map(float)))
)


@settings(max_examples=60, deadline=None)
@given(weighted=weighted, cell=st.sampled_from([0.6, 1.7]))
def test_the_largest_cluster_is_that_of_the_naive_reference(
    weighted: tuple[np.ndarray, np.ndarray], cell: float
) -> None:
    points, weights = weighted
    found = set(np.flatnonzero(columns.largest_cluster(points, weights, cell)).tolist())
    clusters = naive.clusters(points, cell)
    assert found in clusters
    assert weights[list(found)].sum() == max(weights[list(c)].sum() for c in clusters)


@settings(max_examples=60, deadline=None)
@given(weighted=weighted, share=st.sampled_from([0.05, 0.2]))
def test_the_inner_part_is_that_of_the_naive_reference(weighted: tuple[np.ndarray, np.ndarray], share: float) -> None:
    points, weights = weighted
    found = columns.inner_part(points, weights, share, 2, 0.37)
    assert found.tolist() == naive.inner_part(points, weights, share, 2, 0.37).tolist()
