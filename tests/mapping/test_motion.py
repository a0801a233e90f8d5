"""What is foretold of a motion, and how it is put right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.alignment import align
from mapping.geometry import SE3
from mapping.motion import MEMORY_S, MOST_TURN_RAD, SPEED_MPS, Motion
from mapping.tsdf import TsdfMap
from tests.support.rooms import MIDDLE_CAMERA, Room, looking

SECOND = 1_000_000_000
numbers = st.floats(-1.0, 1.0)
motions = st.builds(
    lambda pose, velocity, seed: Motion(0, SE3.exp(pose), np.array(velocity), _covariance(seed)),
    st.tuples(*(numbers,) * 6), st.tuples(*(numbers,) * 6), st.integers(0, 1000),
)  # fmt: skip


def _covariance(seed: int) -> np.ndarray:
    root = 0.1 * np.random.default_rng(seed).normal(size=(12, 12))
    return root @ root.T


def positive(matrix: np.ndarray) -> bool:
    return bool(np.linalg.eigvalsh(matrix).min() > -1e-9) and np.allclose(matrix, matrix.T)


@settings(deadline=None, max_examples=60)
@given(motion=motions, first=st.integers(0, SECOND), then=st.integers(0, SECOND))
def test_to_foretell_in_two_steps_is_to_foretell_in_one(motion: Motion, first: int, then: int) -> None:
    once, twice = motion.at(first + then), motion.at(first).at(first + then)
    assert once.stamp_ns == twice.stamp_ns
    assert once.pose.isclose(twice.pose, atol=1e-9)
    assert np.allclose(once.velocity, twice.velocity)
    widest = np.diag(motion.at(2 * SECOND).covariance)[3:6].max()
    if widest < 0.9 * MOST_TURN_RAD**2:  # beyond that rotations are held
        assert np.allclose(once.covariance, twice.covariance, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(motion=motions, seconds=st.floats(0.0, 1e4))
def test_what_is_foretold_is_ever_less_certain_and_never_without_bounds(motion: Motion, seconds: float) -> None:
    later = motion.at(round(SECOND * seconds))
    assert positive(later.covariance)
    assert np.linalg.norm(later.pose.translation - motion.pose.translation) <= (
        MEMORY_S * np.linalg.norm(motion.velocity[:3]) + 1e-9
    )
    assert np.diag(later.covariance)[3:6].max() <= max(MOST_TURN_RAD**2, np.diag(motion.covariance)[3:6].max()) + 1e-9
    rest = Motion.at_rest(0, motion.pose, 0.01).at(round(SECOND * seconds))
    later_still = Motion.at_rest(0, motion.pose, 0.01).at(round(SECOND * (seconds + 1.0)))
    assert (np.diag(later_still.covariance)[:3] > np.diag(rest.covariance)[:3]).all()
    assert np.allclose(np.diag(rest.covariance)[6:9], SPEED_MPS**2), "of what nothing is known, nothing is forgotten"


@settings(deadline=None, max_examples=60)
@given(motion=motions, off=st.tuples(*(numbers,) * 3), sigma=st.floats(0.01, 1.0))
def test_a_place_is_weighed_as_a_kalman_filter_does(motion: Motion, off: tuple[float, ...], sigma: float) -> None:
    """Joseph's form of the update, with the whole gain written out."""
    told = motion.given_place(np.array(off), sigma)
    measure = np.eye(3, 12)
    gain = motion.covariance @ measure.T @ np.linalg.inv(measure @ motion.covariance @ measure.T + sigma**2 * np.eye(3))
    left = np.eye(12) - gain @ measure
    expected = left @ motion.covariance @ left.T + sigma**2 * gain @ gain.T
    assert np.allclose(told.covariance, expected, atol=1e-9)
    error = gain @ off
    assert np.allclose(told.pose.translation - motion.pose.translation, error[:3])
    assert np.allclose(told.velocity - motion.velocity, error[6:])


@settings(deadline=None, max_examples=60)
@given(motion=motions, seed=st.integers(0, 1000), off=st.tuples(*(st.floats(-0.2, 0.2),) * 6))
def test_a_pose_measured_and_weighed_is_what_a_kalman_filter_gives(
    motion: Motion, seed: int, off: tuple[float, ...]
) -> None:
    """`given_pose` takes what prior and measurement together say of the pose; the rest of the state follows."""
    noise = _covariance(seed)[:6, :6] + 1e-4 * np.eye(6)
    prior = motion.covariance[:6, :6]
    six = prior @ np.linalg.inv(prior + noise)
    told = motion.given_pose(six @ off, prior - six @ prior)
    gain = motion.covariance[:, :6] @ np.linalg.inv(prior + noise)
    assert np.allclose(told.covariance, motion.covariance - gain @ motion.covariance[:6], atol=1e-6)
    assert np.allclose(told.velocity - motion.velocity, (gain @ off)[6:], atol=1e-5)
    assert positive(told.covariance + 1e-9 * np.eye(12))


def test_poses_seen_on_a_way_tell_the_velocity() -> None:
    motion = Motion.at_rest(0, SE3.identity(), 0.005)
    true = np.array([0.5, -0.2, 0.0, 0.0, 0.0, 0.6])
    for n in range(1, 15):
        motion = motion.at(n * SECOND // 10)
        pose = SE3(SE3.exp([0, 0, 0, 0, 0, 0.06 * n]).rotation, 0.1 * n * true[:3])
        prior, noise = motion.covariance[:6, :6], 0.005**2 * np.eye(6)
        turned = (pose.rotation @ motion.pose.rotation.T).astype(float)
        off = np.concatenate([pose.translation - motion.pose.translation, SE3(turned, np.zeros(3)).log()[3:]])
        gain = prior @ np.linalg.inv(prior + noise)
        motion = motion.given_pose(gain @ off, prior - gain @ prior)
    assert np.allclose(motion.velocity, true, atol=0.06)


@settings(deadline=None, max_examples=30)
@given(motion=motions)
def test_a_row_gives_the_very_same_motion_again(motion: Motion) -> None:
    again = Motion.from_row(motion.stamp_ns, motion.row())
    assert again.pose == motion.pose
    assert np.array_equal(again.velocity, motion.velocity)
    assert np.array_equal(again.covariance, motion.covariance)


# -- points on a model ---------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def corner() -> tuple[TsdfMap, np.ndarray]:
    """A model of the corner of a room and points on it."""
    pose, room = looking(0.7, 0.35, (0.2, 0.1, 0.3)), Room()
    model = TsdfMap(voxel_size_m=0.04, truncation_m=0.16)
    depth = room.depth(pose, MIDDLE_CAMERA)
    model.integrate_image(depth, MIDDLE_CAMERA, pose)
    points = pose @ (MIDDLE_CAMERA.rays() * depth[..., None])[::9, ::9].reshape(-1, 3).astype(np.float64)
    return model, np.ascontiguousarray(points)


@settings(deadline=None, max_examples=25)
@given(off=st.tuples(*(numbers,) * 6))
def test_points_that_were_moved_are_laid_back(corner: tuple[TsdfMap, np.ndarray], off: tuple[float, ...]) -> None:
    model, points = corner
    moved = SE3.exp(np.array(off) * (0.03, 0.03, 0.03, 0.015, 0.015, 0.015))
    prior = np.diag(np.repeat([0.1, 0.05], 3) ** 2)
    found = align(model, moved.inverse() @ points, np.full(len(points), 0.01), prior, [SE3.identity()])
    assert found.trusted
    left = (moved.inverse() @ SE3.exp(found.offset)).log()
    assert np.linalg.norm(left[:3]) < 0.012
    assert np.linalg.norm(left[3:]) < 0.006
    assert positive(found.covariance)
    assert (np.diag(found.covariance) <= np.diag(prior)).all()


def test_of_many_starts_a_later_one_must_be_clearly_better(corner: tuple[TsdfMap, np.ndarray]) -> None:
    model, points = corner
    sigma, prior = np.full(len(points), 0.01), np.diag(np.repeat([1.0, 1.0], 3) ** 2)
    away = SE3.exp([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    starts = [SE3.identity(), *(SE3.exp([0.1 * n, 0.0, 0.0, 0.0, 0.0, 0.0]) for n in range(1, 8))]
    there = align(model, away.inverse() @ points, sigma, prior, starts)
    assert there.trusted
    assert np.abs(there.offset - away.log()).max() < 0.02
    here = align(model, points, sigma, prior, [SE3.identity(), SE3.exp([0.002, 0.0, 0.0, 0.0, 0.0, 0.0])])
    assert np.abs(here.offset).max() < 0.01


def test_what_is_not_on_the_model_is_not_trusted(corner: tuple[TsdfMap, np.ndarray]) -> None:
    model, points = corner
    prior = np.diag(np.repeat([0.1, 0.05], 3) ** 2)
    assert not align(model, points + 5.0, np.full(len(points), 0.01), prior, [SE3.identity()]).trusted
    surprise = align(
        model, points + np.array([0.08, 0.0, 0.0]), np.full(len(points), 0.01), 1e-4 * prior, [SE3.identity()]
    )
    assert np.abs(surprise.offset).max() < 0.02, "the prior holds"
    empty = align(TsdfMap(voxel_size_m=0.04), points, np.full(len(points), 0.01), prior, [SE3.identity()])
    assert not empty.trusted
    assert np.allclose(empty.offset, 0.0)
    assert np.allclose(empty.covariance, prior, atol=1e-9)
