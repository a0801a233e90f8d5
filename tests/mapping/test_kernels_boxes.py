"""Oriented boxes against slow, obvious twins."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mapping.kernels import box_grid, boxes

Array = NDArray[np.float64]


def some_boxes(seed: int, n: int, spread: float, upright: float = 0.5) -> tuple[Array, Array, Array]:
    """Centres, half sizes and axes; a share of them stands upright."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(n, 4))
    turns[rng.random(n) < upright, 1:3] = 0.0
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    return rng.uniform(-spread, spread, (n, 3)), rng.uniform(0.0, 0.8, (n, 3)), boxes.axes_of(turns)


def onto(point: Array, center: Array, half: Array, axes: Array) -> Array:
    """The nearest point of a box."""
    return np.asarray(center + axes @ np.clip(axes.T @ (point - center), -half, half))


def gap(one: tuple[Array, ...], two: tuple[Array, ...]) -> float:
    """Distance of two convex bodies by projecting to and fro."""
    p = one[0]
    for _ in range(4000):
        q = onto(p, *two)
        last, p = p, onto(q, *one)
        if np.abs(p - last).max() < 1e-12:
            break
    return float(np.linalg.norm(p - q))


@pytest.mark.parametrize("seed", range(6))
def test_the_gap_is_that_of_projecting_to_and_fro(seed: int) -> None:
    center, half, axes = some_boxes(seed, 40, 1.5)
    p, q = np.empty(3), np.empty(3)
    for i in range(0, 40, 2):
        one, two = (center[i], half[i], axes[i]), (center[i + 1], half[i + 1], axes[i + 1])
        found = boxes.gap_between(*one, *two, p, q)
        assert found == pytest.approx(gap(one, two), abs=2e-3)  # the twin is slow to arrive where faces cross
        assert found <= gap(one, two) + 1e-9
        assert found == pytest.approx(boxes.gap_between(*two, *one, q.copy(), p.copy()), abs=1e-9)
        assert np.linalg.norm(p - q) == pytest.approx(found, abs=1e-9)
        if found > 0.0:
            np.testing.assert_allclose(onto(p, *one), p, atol=1e-9)
            np.testing.assert_allclose(onto(q, *two), q, atol=1e-9)


@pytest.mark.parametrize("spread", [0.5, 3.0, 40.0])
@pytest.mark.parametrize("cell", [0.05, 1.0, 7.0])
def test_what_meets_is_what_comparing_all_finds(spread: float, cell: float) -> None:
    center, half, _ = some_boxes(int(10 * spread), 120, spread)
    half[:3] *= 30.0  # some cover very many cells
    low, high = center - half, center + half
    meet = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    size = np.full(3, cell)
    found = box_grid.meeting(low, high, low, high, size, True)
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, np.argwhere(np.triu(meet, 1)).tolist()))
    for n in (50, 5):  # by the grid, and by comparing few with all
        some = box_grid.meeting(low[:n], high[:n], low, high, size, False)
        assert sorted(map(tuple, some.tolist())) == sorted(map(tuple, np.argwhere(meet[:n]).tolist()))
        assert (np.diff(some[:, 0]) >= 0).all()


def test_footprints_hold_the_ground_under_every_corner() -> None:
    center, half, axes = some_boxes(1, 60, 2.0)
    *_, corners, count, area, rectangle = boxes.describe(center, half, axes)
    rng = np.random.default_rng(0)
    for n in range(60):
        ring = corners[n, : count[n]]
        points = center[n] + (rng.uniform(-1, 1, (3000, 3)) * half[n]) @ axes[n].T
        ahead = np.roll(ring, -1, axis=0) - ring
        side = ahead[:, None, 0] * (points[None, :, 1] - ring[:, None, 1])
        side -= ahead[:, None, 1] * (points[None, :, 0] - ring[:, None, 0])
        assert (side >= -1e-9).all()
        local = (points[:, :2] - rectangle[n, :2]) @ np.array(
            [rectangle[n, 2:4], [-rectangle[n, 3], rectangle[n, 2]]]
        ).T
        assert (np.abs(local) <= rectangle[n, 4:] + 1e-9).all()
        assert area[n] <= 4.0 * rectangle[n, 4] * rectangle[n, 5] + 1e-9


def test_a_column_enters_and_leaves_where_points_begin_and_end_to_be_inside() -> None:
    center, half, axes = some_boxes(2, 80, 0.3, upright=0.3)
    heights = np.linspace(-3.0, 3.0, 6001)
    for n in range(80):
        line = np.column_stack([np.zeros((len(heights), 2)), heights])
        inside = (np.abs((line - center[n]) @ axes[n]) <= half[n]).all(axis=1)
        enters, leaves = boxes.column_through(center[n], half[n], axes[n], 0.0, 0.0)
        if inside.any():
            assert enters == pytest.approx(heights[inside][0], abs=2e-3)
            assert leaves == pytest.approx(heights[inside][-1], abs=2e-3)
        else:
            assert leaves - enters < 2e-3


def test_a_segment_meets_a_box_when_one_of_its_points_is_inside() -> None:
    center, half, axes = some_boxes(3, 300, 1.0)
    rng = np.random.default_rng(5)
    for n in range(300):
        p, q = rng.uniform(-1.5, 1.5, (2, 3))
        points = p + np.linspace(0.0, 1.0, 4001)[:, None] * (q - p)
        grown = (np.abs((points - center[n]) @ axes[n]) <= half[n] + 1e-3).all(axis=1).any()
        inside = (np.abs((points - center[n]) @ axes[n]) <= half[n]).all(axis=1).any()
        meets = boxes.crosses(center[n], half[n], axes[n], p, q)
        assert meets or not inside
        assert not meets or grown
