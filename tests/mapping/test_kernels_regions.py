"""Growth, basins and ways on a ground grid equal their slow twins."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mapping.kernels import regions
from tests import naive_semantics as naive

grids = hnp.arrays(bool, st.tuples(st.integers(2, 9), st.integers(2, 9)), elements=st.booleans())
sparse = hnp.arrays(bool, (9, 8), elements=st.sampled_from([False, False, False, True]))


@settings(max_examples=60, deadline=None)
@given(reach=sparse, barrier=sparse, steps=st.integers(0, 4))
def test_growth_is_that_of_the_naive_reference(reach: np.ndarray, barrier: np.ndarray, steps: int) -> None:
    expected = naive.grown(reach, barrier, steps)
    found = reach.copy()
    regions.grow(found, barrier, steps)
    assert (found == expected).all()


@settings(max_examples=60, deadline=None)
@given(reach=grids)
def test_holes_are_those_that_scipy_fills(reach: np.ndarray) -> None:
    filled = reach.copy()
    regions.fill_holes(filled)
    assert (filled == ndimage.binary_fill_holes(reach)).all()


@settings(max_examples=60, deadline=None)
@given(seeds=sparse, allowed=sparse.map(lambda a: ~a))
def test_a_flood_gives_every_cell_to_a_nearest_label(seeds: np.ndarray, allowed: np.ndarray) -> None:
    labels = np.where(seeds, np.arange(1, seeds.size + 1).reshape(seeds.shape), 0).astype(np.int32)
    before = labels.copy()
    regions.flood(labels, allowed)
    away = naive.steps_from({(int(i), int(j)) for i, j in np.argwhere(before)}, allowed)
    assert {(int(i), int(j)) for i, j in np.argwhere(labels)} == set(away)
    for cell, steps in away.items():
        source = {(int(i), int(j)) for i, j in np.argwhere(before == labels[cell])}
        assert naive.steps_from(source, allowed)[cell] == steps


@settings(max_examples=60, deadline=None)
@given(blocked=sparse, ends=st.tuples(*(st.integers(0, 7),) * 4))
def test_a_shortest_way_is_as_short_as_that_of_the_naive_reference(
    blocked: np.ndarray, ends: tuple[int, int, int, int]
) -> None:
    a, b, c, d = ends
    way = regions.shortest_way(blocked, a, b, c, d, 1e9)
    expected = naive.way_length(blocked, (a, b), (c, d))
    if not len(way):
        assert expected == np.inf
        return
    assert naive.length_of(way) == pytest.approx(expected)
    assert tuple(way[0]) == (a, b)
    assert tuple(way[-1]) == (c, d)
    assert not blocked[tuple(way[1:-1].T)].any()
    straight = float(np.hypot(c - a, d - b))
    taut = regions.taut_length(blocked, way)
    assert straight - 1e-9 <= taut <= expected + 1e-9


def test_a_way_longer_than_the_limit_is_none() -> None:
    blocked = np.zeros((30, 30), bool)
    assert len(regions.shortest_way(blocked, 0, 0, 29, 0, 28.5)) == 0
    assert len(regions.shortest_way(blocked, 0, 0, 29, 0, 29.0)) == 30


def test_a_taut_way_around_a_corner_is_within_three_percent_of_the_true_one() -> None:
    blocked = np.zeros((60, 60), bool)
    blocked[30, :40] = True  # a wall that ends at (30, 40)
    way = regions.shortest_way(blocked, 10, 5, 50, 15, 1e9)
    true = np.hypot(20.5, 35.0) + np.hypot(19.5, 25.0)
    assert regions.taut_length(blocked, way) == pytest.approx(true, rel=0.03)


@settings(max_examples=60, deadline=None)
@given(ends=st.tuples(*(st.floats(-2.0, 12.0),) * 4))
def test_a_drawn_segment_is_closed_to_steps_between_neighbours(ends: tuple[float, float, float, float]) -> None:
    """No cell that the line passes by more than a corner is missed: samples along it lie in drawn cells."""
    grid = np.zeros((10, 10), bool)
    regions.draw_segment(grid, *ends)
    x0, y0, x1, y1 = ends
    for i, j in np.argwhere(grid):
        t = np.linspace(0.0, 1.0, 400)
        x, y = x0 + (x1 - x0) * t, y0 + (y1 - y0) * t
        assert np.maximum(np.abs(x - i - 0.5), np.abs(y - j - 0.5)).min() < 0.55
    _, n = ndimage.label(grid, np.ones((3, 3)))
    assert n <= 1


def clearance(free: np.ndarray) -> np.ndarray:
    return ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]


def count_basins(free: np.ndarray, share: float = 0.72) -> int:
    labels = regions.basins(clearance(free), share)
    assert ((labels > 0) == free).all()
    return len(np.unique(labels[labels > 0]))


def test_basins_part_at_narrow_necks_only() -> None:
    narrow, wide = np.ones((61, 30), bool), np.ones((61, 30), bool)
    narrow[30, :10] = narrow[30, 20:] = False  # a passage of 10 between rooms of 30
    wide[30, :2] = wide[30, 28:] = False  # one of 26
    assert count_basins(narrow) == 2
    assert count_basins(wide) == 1
    assert count_basins(np.ones((61, 30), bool)) == 1


def test_a_long_corridor_is_one_basin() -> None:
    assert count_basins(np.ones((200, 14), bool)) == 1


@settings(max_examples=40, deadline=None)
@given(free=grids)
def test_basins_are_connected_and_never_reach_across_walls(free: np.ndarray) -> None:
    labels = regions.basins(clearance(free), 0.72)
    assert ((labels > 0) == free).all()
    for label in np.unique(labels[labels > 0]):
        assert ndimage.label(labels == label)[1] == 1


# -- ways among points -------------------------------------------------------------------------------------------------

places = hnp.arrays(np.float64, (6, 2), elements=st.integers(-20, 20).map(float))
segments = hnp.arrays(
    np.float64, st.tuples(st.integers(0, 4), st.just(4)), elements=st.integers(-20, 20).map(lambda n: n + 0.37)
)


@settings(max_examples=60, deadline=None)
@given(points=places, walls=segments)
def test_points_see_each_other_where_no_wall_crosses_their_line(points: np.ndarray, walls: np.ndarray) -> None:
    distance = regions.sight(points, walls)
    assert (distance == distance.T).all()
    lines = [shapely.LineString(wall.reshape(2, 2)) for wall in walls]
    for i in range(len(points)):
        for j in range(i):
            line = shapely.LineString(points[[i, j]])
            ends = [shapely.Point(points[k]) for k in (i, j)]
            if any(wall.distance(end) < 1e-9 for wall in lines for end in ends):
                continue  # whether what ends at a wall crosses it is a matter of rounding
            crossed = any(line.crosses(wall) for wall in lines)
            expected = np.inf if crossed else line.length
            assert distance[i, j] == pytest.approx(expected)


@settings(max_examples=60, deadline=None)
@given(points=places, walls=segments, ends=st.tuples(st.integers(0, 5), st.integers(0, 5)))
def test_the_shortest_chain_is_that_of_floyd_and_warshall(
    points: np.ndarray, walls: np.ndarray, ends: tuple[int, int]
) -> None:
    distance = regions.sight(points, walls)
    shortest = distance.copy()
    for k in range(len(points)):
        shortest = np.minimum(shortest, shortest[:, k, None] + shortest[None, k])
    assert regions.shortest_chain(distance, *ends) == pytest.approx(shortest[ends])
