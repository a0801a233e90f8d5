"""A thing is doubted where its place is seen without it, and never where it is out of view or hidden."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.geometry import SE3, CameraIntrinsics
from mapping.instances import Masks
from mapping.view import DepthView
from scenegraph.perception.presence import APART_S, CONTRARY_LOOKS, Presence
from scenegraph.perception.shapes import Shape
from tests.support.furnishing import VOXEL, box, surface
from tests.support.scenes import looking_at

CAMERA = CameraIntrinsics(fx=260.0, fy=260.0, cx=159.5, cy=119.5, width=320, height=240)
SHAPE = (CAMERA.height, CAMERA.width)
CUBE = Shape(surface(box((0.3, 0.3, 0.3))).astype(np.float32), VOXEL)
EYE = (2.0, 0.0, 0.5)
AT_CUBE = looking_at(EYE, (0.0, 0.0, 0.15))
AWAY = looking_at(EYE, (4.0, 0.0, 0.15))
OURS, OTHER = 7, 8
GAP_NS = round(2 * APART_S * 1e9)


def masks(instance: int, label: int = 1) -> Masks:
    """The whole image is one mask of an instance; 0: of none, labelled or not."""
    pieces = np.full(SHAPE, 1 if instance else 0, np.int32)
    return Masks(pieces, np.full(SHAPE, label, np.uint16), np.array([0, instance]))


class Watch:
    def __init__(self) -> None:
        self.presence = Presence()
        self.presence.place("object_7", CUBE)
        self.now = 0

    def look(self, depth_m: float, pose: SE3 = AT_CUBE, seen: Masks | None = None) -> set[str]:
        self.now += GAP_NS
        view = DepthView(np.full(SHAPE, depth_m, np.float32), CAMERA, pose, 6.0)
        missed, _ = self.presence.look(view, seen, lambda _: OURS, [OTHER], self.now)
        return missed


@pytest.fixture
def watch() -> Watch:
    return Watch()


def test_a_thing_goes_after_several_looks_through_its_place(watch):
    for n in range(1, round(CONTRARY_LOOKS) + 1):
        assert not watch.presence.gone("object_7", views=9)
        assert watch.look(4.0) == {"object_7"}
        assert watch.presence.faith("object_7") == pytest.approx(1.0 - n / CONTRARY_LOOKS)
    assert watch.presence.gone("object_7", views=9)


def test_a_thing_that_was_hardly_seen_goes_sooner(watch):
    watch.look(4.0)
    assert not watch.presence.gone("object_7", views=3)
    watch.look(4.0)
    assert watch.presence.gone("object_7", views=3)
    assert not watch.presence.gone("object_7", views=9)


@given(st.floats(0.3, 5.9))
def test_out_of_view_it_is_never_doubted(depth):
    assert Watch().look(depth, AWAY) == set()


@given(st.floats(0.3, 1.5), st.sampled_from([None, masks(OTHER), masks(0)]))
def test_behind_something_it_is_never_doubted(depth, seen):
    assert Watch().look(depth, seen=seen) == set()


def test_where_nothing_is_measured_it_is_not_doubted(watch):
    assert watch.look(0.0) == watch.look(0.0, seen=masks(OTHER)) == set()


def test_one_that_is_seen_again_is_not_doubted_any_more(watch):
    watch.look(4.0)
    watch.look(2.0, seen=masks(OURS))
    assert watch.presence.doubts == {}


def test_labels_of_others_on_its_surface_speak_against_it_and_no_labels_say_nothing(watch):
    near = 1.9  # from EYE to the cube
    assert watch.look(near) == watch.look(near, seen=masks(0, 0)) == set()
    assert watch.look(near, seen=masks(0, 3)) == {"object_7"}
    assert watch.look(near, seen=masks(OTHER)) == {"object_7"}
    assert watch.look(near, seen=masks(99)) == set()  # of an instance that is hardly known: perhaps the thing itself


def test_a_mask_of_its_own_that_lies_elsewhere_does_not_keep_a_thing_where_it_was(watch):
    assert watch.look(4.0, seen=masks(OURS)) == {"object_7"}


def test_two_images_at_once_are_one_look(watch):
    watch.look(4.0)
    watch.now -= GAP_NS
    assert watch.look(4.0) == set()


def test_a_thing_that_would_show_in_few_pixels_is_not_missed(watch):
    far = looking_at((4.9, 0.0, 0.2), (0.0, 0.0, 0.15))
    watch.presence.place("object_7", Shape(CUBE.points[:12] * np.float32(0.1), VOXEL))
    assert watch.look(5.9, far) == set()


def test_doubts_outlive_a_restart(watch):
    watch.look(4.0)
    again = Presence()
    again.place("object_7", CUBE)
    again.restore(watch.presence.document())
    assert again.doubts == watch.presence.doubts


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-np.pi, np.pi))
def test_doubt_is_the_same_wherever_the_world_begins(x, y, yaw):
    T = SE3.exp([x, y, 0.0, 0.0, 0.0, yaw])
    moved = Watch()
    moved.presence.place("object_7", Shape((T @ CUBE.points.astype(np.float64)).astype(np.float32), VOXEL))
    assert moved.look(4.0, T @ AT_CUBE) == {"object_7"}
    assert Watch().look(4.0, T @ AT_CUBE @ SE3.exp([0.0, 0.0, -8.0, 0.0, 0.0, 0.0])) == set()
