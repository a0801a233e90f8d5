"""Votes of labelled points: sums that do not depend on order, and a confidence that knows of disagreement."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.semantics import SemanticMap
from tests.naive_semantics import Ballots
from tests.support.rooms import SMALL_CAMERA, Room, looking

VOXEL = 0.1
points_of = st.lists(
    st.tuples(*(st.integers(-12, 12),) * 3, st.integers(0, 2), st.sampled_from([0.0, 0.25, 0.5, 1.0])),
    min_size=1,
    max_size=40,
)


def unpack(rows: list[tuple[int, int, int, int, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    table = np.array(rows)
    return (table[:, :3] + 0.5) * 0.05, table[:, 3].astype(np.uint16), table[:, 4].astype(np.float32)


def mapped(points: np.ndarray, labels: np.ndarray, weights: np.ndarray | None = None) -> SemanticMap:
    semantics = SemanticMap(voxel_size_m=VOXEL)
    semantics.integrate(points, labels, weights)
    return semantics


@settings(max_examples=80, deadline=None)
@given(rows=points_of)
def test_votes_for_two_classes_are_those_of_the_naive_reference(rows: list[tuple[int, int, int, int, float]]) -> None:
    points, labels, weights = unpack(rows)
    semantics, ballots = mapped(points, labels, weights), Ballots()
    ballots.cast(points, labels, weights, VOXEL)
    found, confidence = semantics.query(points)
    for n, point in enumerate(points):
        ijk = tuple(int(np.floor(c / VOXEL)) for c in point)
        votes = ballots.votes.get(ijk, {})
        if not votes:
            assert found[n] == 0
            assert np.isnan(confidence[n])
            continue
        assert votes[int(found[n])] == pytest.approx(max(votes.values()))
        assert confidence[n] == pytest.approx(max(votes.values()) / sum(votes.values()))


@settings(max_examples=60, deadline=None)
@given(rows=points_of, seed=st.integers(0, 99))
def test_the_order_of_votes_does_not_matter(rows: list[tuple[int, int, int, int, float]], seed: int) -> None:
    points, labels, weights = unpack(rows)
    order = np.random.default_rng(seed).permutation(len(points))
    _, one = mapped(points, labels, weights).query(points)
    _, two = mapped(points[order], labels[order], weights[order]).query(points)
    assert np.allclose(one, two, equal_nan=True)


@settings(max_examples=60, deadline=None)
@given(rows=points_of)
def test_relabelling_the_classes_permutes_the_map(rows: list[tuple[int, int, int, int, float]]) -> None:
    points, labels, weights = unpack(rows)
    other = np.array([0, 300, 7], np.uint16)
    one, one_confidence = mapped(points, labels, weights).query(points)
    two, two_confidence = mapped(points, other[labels], weights).query(points)
    assert (other[one] == two).all()
    assert np.array_equal(one_confidence, two_confidence, equal_nan=True)


def test_confidence_falls_when_observations_disagree() -> None:
    point = np.array([[0.04, 0.04, 0.04]])
    semantics = mapped(np.repeat(point, 3, axis=0), [5, 5, 5])
    confidences = [float(semantics.query(point)[1][0])]
    for _ in range(3):
        semantics.integrate(point, [6])
        confidences.append(float(semantics.query(point)[1][0]))
    assert confidences == pytest.approx([1.0, 0.75, 0.6, 0.5])
    semantics.integrate(point, [6])
    assert semantics.query(point)[0][0] == 6


def test_a_class_that_holds_the_majority_leads_whatever_the_order() -> None:
    """The promise of Misra & Gries: 60 % of the votes against any mixture of others."""
    rng = np.random.default_rng(3)
    labels = np.concatenate([np.full(60, 9), rng.integers(10, 30, 40)]).astype(np.uint16)
    for _ in range(20):
        semantics = mapped(np.zeros((100, 3)) + 0.01, rng.permutation(labels))
        assert semantics.query([[0.01, 0.01, 0.01]])[0].tolist() == [9]


def test_old_votes_give_way() -> None:
    point = np.array([[0.0, 0.0, 0.0]]) + 0.01
    semantics = SemanticMap(voxel_size_m=VOXEL, memory=10.0)
    semantics.integrate(np.repeat(point, 1000, axis=0), np.full(1000, 4))
    semantics.integrate(np.repeat(point, 30, axis=0), np.full(30, 5))
    assert semantics.query(point)[0].tolist() == [5], "a thing that was moved away is forgotten"


ROOM = Room()
POSES = [looking(0.3 * n, 0.1 * n) for n in range(4)]


def image_votes(order: list[int]) -> SemanticMap:
    semantics = SemanticMap(voxel_size_m=VOXEL)
    for n in order:
        depth = ROOM.depth(POSES[n], SMALL_CAMERA)
        labels = np.where(np.arange(64)[None] < 32 + n, 1, 2).astype(np.uint16) + np.zeros((48, 1), np.uint16)
        semantics.integrate_image(depth, labels, np.ones_like(depth), SMALL_CAMERA, POSES[n])
    return semantics


def test_the_order_of_images_does_not_matter() -> None:
    one, two = image_votes([0, 1, 2, 3]), image_votes([3, 1, 0, 2])
    at, labels, confidence = one.voxels()
    other, other_confidence = two.query(at)
    assert len(at) == len(two.voxels()[0]) > 500
    assert np.allclose(confidence, other_confidence, atol=1e-5)
    assert (labels == other)[confidence > 0.5 + 1e-4].all()


def test_an_image_votes_like_its_points() -> None:
    depth = ROOM.depth(POSES[0], SMALL_CAMERA)
    labels = np.where(depth > 1.6, 3, 4).astype(np.uint16)
    trust = np.full(depth.shape, 0.5, np.float32)
    seen = SemanticMap(voxel_size_m=VOXEL)
    changed = seen.integrate_image(depth, labels, trust, SMALL_CAMERA, POSES[0])
    points = POSES[0] @ SMALL_CAMERA.backproject(depth).reshape(-1, 3).astype(np.float64)
    weights = 0.5 * depth.ravel() ** 2 / (SMALL_CAMERA.fx * SMALL_CAMERA.fy * VOXEL**2)
    expected = mapped(points, labels.ravel(), weights)
    at, classes, confidence = expected.voxels()
    inside = np.abs(at / VOXEL - np.round(at / VOXEL)).max(axis=1) > 1e-6
    found, found_confidence = seen.query(at[inside])
    known = found > 0  # blocks that single pixels graze are not opened
    assert known.mean() > 0.95
    assert (found == classes[inside])[known].mean() > 0.99
    assert np.allclose(found_confidence[known], confidence[inside][known], atol=0.05)
    assert {tuple(b) for b in changed.blocks.tolist()} == {tuple(b) for b in seen.block_ijk.tolist()}


def test_what_carries_no_label_does_not_vote() -> None:
    depth = ROOM.depth(POSES[0], SMALL_CAMERA)
    semantics = SemanticMap(voxel_size_m=VOXEL)
    changed = semantics.integrate_image(
        depth, np.zeros(depth.shape, np.uint16), np.ones_like(depth), SMALL_CAMERA, SE3.identity()
    )
    assert len(changed) == 0
    assert semantics.query([[0.0, 0.0, 0.0]])[0].tolist() == [0]


def test_votes_that_do_not_match_their_points_are_refused() -> None:
    with pytest.raises(InvalidParameter, match="expected one a point"):
        SemanticMap(voxel_size_m=VOXEL).integrate(np.zeros((3, 3)), [1, 2])


def test_a_point_on_the_border_of_two_voxels_is_found_where_it_voted() -> None:
    on_borders = np.arange(-200, 200)[:, None] * np.array([[0.05, 0.15, -0.35]])
    classes = SemanticMap(voxel_size_m=0.05)
    classes.integrate(on_borders, np.full(len(on_borders), 4))
    assert (classes.query(on_borders)[0] == 4).all()
