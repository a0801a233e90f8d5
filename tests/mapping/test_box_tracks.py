"""Boxes without an image: the laws of their overlap, and tracks that last."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.box_tracks import BoxTracks, Sighting, UprightBox, overlap
from mapping.geometry import SE3
from mapping.observations import Box3d

SIDES = st.floats(0.1, 2.0)
BOXES = st.builds(
    lambda x, y, z, a, b, c, yaw: UprightBox(np.array([x, y, z]), np.array([a, b, c]), yaw),
    *[st.floats(-1.0, 1.0)] * 3, SIDES, SIDES, SIDES, st.floats(-np.pi, np.pi),
)  # fmt: skip


def box(x: float, y: float, *size: float, yaw: float = 0.0, z: float = 0.5) -> UprightBox:
    return UprightBox(np.array([x, y, z]), np.array(size or (1.0, 0.6, 1.0)), yaw)


def chair(x: float, y: float, **how: float) -> Sighting:
    return Sighting("chair", box(x, y, 0.5, 0.5, 0.9, **how), 0.9)


@given(BOXES, BOXES)
def test_overlap_is_symmetric_and_that_of_volumes(a: UprightBox, b: UprightBox) -> None:
    shared = overlap(a, b)
    assert shared == pytest.approx(overlap(b, a), abs=1e-9)
    assert overlap(a, a) == pytest.approx(1.0)
    turn = SE3.exp([0, 0, 0, 0, 0, a.yaw])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 3)) * a.size @ turn.rotation.T + a.center
    assert a.holds(points, 1e-9).all()
    volume = float(b.holds(points, 1e-9).mean() * np.prod(a.size))
    assert shared == pytest.approx(volume / (np.prod(a.size) + np.prod(b.size) - volume), abs=0.05)


@given(BOXES, BOXES, st.floats(-np.pi, np.pi), st.floats(-5.0, 5.0))
def test_overlap_does_not_depend_on_where_the_world_is_turned_to(
    a: UprightBox, b: UprightBox, yaw: float, x: float
) -> None:
    T = SE3.exp([0, 0, 0, 0, 0, yaw])

    def moved(one: UprightBox) -> UprightBox:
        return UprightBox(T.rotation @ one.center + (x, 0.0, 0.0), one.size, one.yaw + yaw)

    assert overlap(moved(a), moved(b)) == pytest.approx(overlap(a, b), abs=1e-6)


@given(BOXES, st.floats(-np.pi, np.pi), st.integers(0, 3))
def test_a_box_seen_from_anywhere_is_the_box_in_the_map(one: UprightBox, yaw: float, quarter: int) -> None:
    T_map_sensor = SE3.exp([0.4, -1.0, 0.3, 0.2, -0.1, yaw])
    turn = SE3.exp([0, 0, 0, 0, 0, one.yaw + 0.5 * np.pi * quarter])
    T_sensor_map = T_map_sensor.inverse()
    size = one.size[[1, 0, 2]] if quarter % 2 else one.size
    seen = Box3d(
        center=T_sensor_map @ one.center,
        size=size,
        rotation_wxyz=SE3(T_sensor_map.rotation @ turn.rotation, np.zeros(3)).quaternion_wxyz,
    )
    assert overlap(UprightBox.about(seen, T_map_sensor), one) == pytest.approx(1.0, abs=1e-6)


def test_a_tilted_box_is_held_by_its_upright_one() -> None:
    tilted = Box3d(
        center=(1.0, 2.0, 0.5), size=(0.8, 0.4, 1.0), rotation_wxyz=SE3.exp([0, 0, 0, 0.3, 0.2, 0.5]).quaternion_wxyz
    )
    upright = UprightBox.about(tilted, SE3.identity())
    turn = SE3.from_quaternion(tilted.rotation_wxyz, tilted.center)
    corners = turn @ (0.5 * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * tilted.size)
    assert upright.holds(corners, 1e-6).all()


def test_noisy_boxes_of_three_things_are_three_tracks_that_average_out() -> None:
    random = np.random.default_rng(3)
    truth = [box(0.0, 0.0, 0.5, 0.5, 0.9), box(0.8, 0.0, 0.5, 0.5, 0.9), box(0.4, 2.0, 1.6, 0.8, 0.7, yaw=0.6)]
    labels = ["chair", "chair", "table"]
    tracks, confidences = BoxTracks(), []
    for n in range(12):
        sightings = [
            Sighting(
                label,
                UprightBox(
                    one.center + random.normal(0.0, 0.04, 3),
                    one.size[[1, 0, 2]] if n % 2 else one.size,
                    one.yaw + random.normal(0.0, 0.05) + (0.5 * np.pi if n % 2 else np.pi * (n % 4)),
                ),
                0.7,
            )
            for label, one in zip(labels, truth, strict=True)
        ]
        random.shuffle(sightings)  # type: ignore[arg-type]
        tracks.see(sightings, n)
        confidences.append([track.confidence for track in tracks.tracks.values()])
    assert len(tracks.tracks) == 3
    for one, label in zip(truth, labels, strict=True):
        best = max(tracks.tracks.values(), key=lambda track: overlap(track.box, one))
        assert best.label == label
        assert overlap(best.box, one) > 0.85
        assert best.views == 12
    assert (np.diff(confidences, axis=0) > 0.0).all(), "more certain with each view"
    assert min(confidences[-1]) > 0.95


def test_two_things_side_by_side_stay_two_and_one_that_is_pushed_stays_one() -> None:
    tracks = BoxTracks()
    assert tracks.see([chair(0.0, 0.0), chair(0.52, 0.0)], 1) == {1, 2}
    assert tracks.see([chair(0.5, 0.0), chair(0.02, 0.0)], 2) == {1, 2}
    assert tracks.see([chair(0.2, 0.2)], 3) == {1}
    assert tracks.see([chair(3.0, 0.0)], 4) == {3}


def test_a_class_that_is_mistaken_once_does_not_make_another_thing() -> None:
    tracks = BoxTracks()
    for n, label in enumerate(("chair", "stool", "chair")):
        tracks.see([chair(0.0, 0.0)._replace(label=label)], n)
    [track] = tracks.tracks.values()
    assert (track.label, track.views) == ("chair", 3)
    assert track.confidence < 0.7
    assert tracks.see([Sighting("cup", box(0.0, 0.0, 0.1, 0.1, 0.1, z=1.0), 0.9)], 5) == {2}, "a cup on the seat is not"


def test_tracks_come_back_as_they_were() -> None:
    tracks = BoxTracks()
    for n in range(3):
        tracks.see([chair(0.0, 0.0, yaw=0.1 * n), chair(4.0, 1.0)], n)
    again = BoxTracks.from_document(tracks.document())
    assert again.document() == tracks.document()
    assert again.see([chair(4.0, 1.0)], 9) == tracks.see([chair(4.0, 1.0)], 9) == {2}
    again.drop(2)
    assert again.see([chair(4.0, 1.0)], 10) == {3}
