"""What was seen from the front only is completed into the depth that it hides, and no farther."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.kernels.shapes import points_inside, polygon_area
from scenegraph.graph import Box
from scenegraph.perception.footprints import SQUARE, completed, house_of
from scenegraph.perception.shapes import Shape
from tests.support.furnishing import VOXEL, box, placed, surface, thing

SHELF = Box.from_yaw((0.0, 0.0, 0.8), (0.9, 0.34, 1.6), 0.0)
BREADTH, HEIGHT = 0.3, 0.2


def front(yaw: float = 0.0) -> Shape:
    """The front of a crate, 4 cm behind the front of the shelf."""
    face = surface(((0.0, -0.12, 0.9), (BREADTH, 0.02, HEIGHT)), faces=("y",))
    return placed(face, (0.0, 0.0, 0.0), yaw)


def free_before(y: float, yaw: float = 0.0):
    """Space is seen to be free where y, turned back, is less than this."""
    turn = np.array([-np.sin(yaw), np.cos(yaw)])
    return lambda points: points[:, :2] @ turn < y


def size(hull: np.ndarray, yaw: float = 0.0) -> np.ndarray:
    turned = hull @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.ptp(turned, axis=0)


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.5, 1.5))
def test_a_crate_of_which_the_front_was_seen_gets_the_depth_that_it_hides_however_the_shelf_stands(yaw: float) -> None:
    shelf = Box.from_yaw((0.0, 0.0, 0.8), (0.9, 0.34, 1.6), yaw)
    hull = completed(front(yaw), shelf, free_before(-0.13, yaw))
    assert size(hull, yaw) == pytest.approx([BREADTH, SQUARE * BREADTH], abs=0.04)
    assert polygon_area(hull) > 0.0, "counter-clockwise"


def test_it_ends_where_space_was_seen_to_be_free_and_where_the_shelf_ends() -> None:
    def slot(points: np.ndarray) -> np.ndarray:
        return (points[:, 1] < -0.13) | (points[:, 1] > 0.0)

    assert size(completed(front(), SHELF, slot))[1] == pytest.approx(0.13, abs=VOXEL)
    shallow = Box.from_yaw((0.0, -0.07, 0.8), (0.9, 0.2, 1.6), 0.0)
    assert size(completed(front(), shallow, free_before(-0.13)))[1] <= 0.17 + VOXEL
    everywhere = completed(front(), SHELF, lambda points: np.ones(len(points), bool))
    assert size(everywhere)[1] == pytest.approx(0.02, abs=0.01), "nothing is hidden"


def test_what_a_neighbour_hides_in_part_gets_broader_and_a_book_does_not() -> None:
    """Both were seen as deep as they are; on one side space was seen to be free, on the other a neighbour hides it."""

    def neighbour(points: np.ndarray) -> np.ndarray:
        return (points[:, 0] < 0.05) | (np.abs(points[:, 1]) > 0.12)

    half = placed(surface(((0.0, 0.0, 0.9), (0.16, 0.24, HEIGHT))), (0.0, 0.0, 0.0))
    hull = completed(half, SHELF, neighbour)
    assert size(hull) == pytest.approx([SQUARE * 0.24, 0.24], abs=0.03)
    assert hull[:, 0].min() == pytest.approx(-0.08, abs=0.02), "not where space was seen to be free"
    book = placed(surface(((0.0, 0.0, 0.9), (0.08, 0.24, HEIGHT))), (0.0, 0.0, 0.0))
    assert size(completed(book, SHELF, neighbour)) == pytest.approx([0.08, 0.24], abs=0.02)


def test_what_was_seen_on_all_sides_stays_as_it_is_but_for_strays() -> None:
    crate = surface(((0.0, 0.0, 0.9), (BREADTH, 0.28, HEIGHT)))
    stray = np.array([[0.0, 0.6, 0.9], [0.02, 0.62, 0.9]])
    hull = completed(placed(np.concatenate([crate, stray]), (0.0, 0.0, 0.0)), SHELF, free_before(-9.0))
    assert size(hull) == pytest.approx([BREADTH, 0.28], abs=0.03)
    assert points_inside(hull, crate[:, :2], 0.02).all()


def test_a_thing_is_housed_by_the_smallest_thing_in_whose_box_it_stands_under_a_part_of_it() -> None:
    book = thing(box((0.05, 0.2, 0.25)), at=(0.1, 0.0, 0.5))
    shelf, room = thing(box((0.9, 0.34, 1.6))), thing(box((3.0, 3.0, 2.4)))
    table = thing(box((0.6, 0.4, 0.5)))
    assert house_of(book, {"shelf_1": shelf, "room_1": room, "table_1": table}) == "shelf_1"
    assert house_of(book, {"table_1": table}) is None, "it stands on top"
    assert house_of(book, {}) is None
