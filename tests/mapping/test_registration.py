"""A pose that is a little off is put right by the map, and left alone where the map cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3
from mapping.kernels import registration as kernels
from mapping.registration import refine_pose
from mapping.tsdf import TsdfMap
from tests.support.rooms import MIDDLE_CAMERA, Room, looking

ROOM = Room()
CORNER = looking(0.7, 0.35, (0.2, 0.1, 0.3))
"""Sees two walls, the floor and a bit of the ball."""
SIGMA = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])


@pytest.fixture(scope="module")
def corner() -> TsdfMap:
    tsdf = TsdfMap(voxel_size_m=0.04, truncation_m=0.16)
    for nudge in range(3):
        pose = CORNER @ SE3.exp([0.02 * nudge, 0.0, 0.0, 0.0, 0.03 * nudge, 0.0])
        tsdf.integrate_image(ROOM.depth(pose, MIDDLE_CAMERA), MIDDLE_CAMERA, pose)
    return tsdf


def seen(pose: SE3, step: int = 9) -> np.ndarray:
    depth = ROOM.depth(pose, MIDDLE_CAMERA)[::step, ::step]
    return (MIDDLE_CAMERA.rays()[::step, ::step] * depth[..., None]).reshape(-1, 3).astype(np.float64)


def error(pose: SE3, truth: SE3) -> tuple[float, float]:
    """Distance [m] and angle [°] between two poses."""
    off = (truth.inverse() @ pose).log()
    return float(np.linalg.norm(off[:3])), float(np.rad2deg(np.linalg.norm(off[3:])))


@settings(max_examples=30, deadline=None)
@given(off=st.tuples(*(st.floats(-1.0, 1.0),) * 6))
def test_a_perturbed_pose_is_recovered(corner: TsdfMap, off: tuple[float, ...]) -> None:
    given_pose = CORNER @ SE3.exp(np.array(off) * (0.02, 0.02, 0.02, 0.009, 0.009, 0.009))
    refined = refine_pose(corner, seen(CORNER), given_pose, np.diag(SIGMA**2))
    distance, angle = error(refined, CORNER)
    assert distance < 0.003
    assert angle < 0.1


def test_noise_of_the_depth_does_not_hinder(corner: TsdfMap) -> None:
    points = seen(CORNER)
    noisy = points * (1.0 + np.random.default_rng(0).normal(scale=0.004, size=(len(points), 1)))
    distance, angle = error(
        refine_pose(corner, noisy, CORNER @ SE3.exp([0.015, -0.01, 0.02, 0.005, -0.005, 0.004]), np.diag(SIGMA**2)),
        CORNER,
    )
    assert distance < 0.004
    assert angle < 0.15


def test_an_exact_prior_is_left_alone(corner: TsdfMap) -> None:
    off = CORNER @ SE3.exp([0.01, 0, 0, 0, 0, 0])
    assert refine_pose(corner, seen(CORNER), off, np.zeros((6, 6))) is off
    kept = refine_pose(corner, seen(CORNER), off, 1e-12 * np.eye(6))
    assert error(kept, off)[0] < 1e-4


def test_where_the_map_is_not_known_the_given_pose_stays(corner: TsdfMap) -> None:
    elsewhere = looking(3.6, 0.0, (0.0, 0.0, 0.0))
    assert refine_pose(corner, seen(elsewhere), elsewhere, np.diag(SIGMA**2)) is elsewhere
    assert refine_pose(corner, seen(CORNER)[:20], CORNER, np.diag(SIGMA**2)) is CORNER
    assert refine_pose(TsdfMap(voxel_size_m=0.04), seen(CORNER), CORNER, np.diag(SIGMA**2)) is CORNER


def test_along_a_bare_wall_the_given_pose_decides() -> None:
    """One plane fixes three of six degrees of freedom; the others must not drift."""
    wall = TsdfMap(voxel_size_m=0.04, truncation_m=0.16)
    rays = MIDDLE_CAMERA.rays()
    depth = np.full(rays.shape[:2], 1.5, np.float32)
    pose = looking(0.0)
    wall.integrate_image(depth, MIDDLE_CAMERA, pose)
    points = (rays * depth[..., None])[40:200:8, 40:280:8].reshape(-1, 3).astype(np.float64)
    off = np.array([0.012, -0.008, 0.015, 0.004, -0.003, 0.006])
    left = (pose.inverse() @ refine_pose(wall, points, pose @ SE3.exp(off), np.diag(SIGMA**2))).log()
    assert abs(left[2]) < 0.003, "the distance is put right"
    assert np.abs(left[3:5]).max() < 0.002, "and the tilt"
    assert np.allclose(left[[0, 1, 5]], off[[0, 1, 5]], atol=2e-3), "the rest is as given"


def test_another_surface_far_outside_the_prior_is_not_believed(corner: TsdfMap) -> None:
    far = CORNER @ SE3.exp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    tight = np.diag(np.array([0.002, 0.002, 0.002, 0.001, 0.001, 0.001]) ** 2)
    kept = refine_pose(corner, seen(CORNER), far, tight)
    assert error(kept, far)[0] < 0.02


def test_what_the_prior_knows_exactly_is_not_moved(corner: TsdfMap) -> None:
    """A robot on wheels: height, roll and pitch of its camera are known."""
    off = CORNER @ SE3.exp([0.02, 0.0, 0.015, 0.0, 0.006, 0.0])
    planar = np.diag([0.05, 0.0, 0.05, 0.0, 0.02, 0.0]) ** 2
    moved = (off.inverse() @ refine_pose(corner, seen(CORNER), off, planar)).log()
    assert np.abs(moved[[1, 3, 5]]).max() < 1e-4
    assert np.abs(moved[[0, 2, 4]]).max() > 0.005


def flat(points: np.ndarray) -> np.ndarray:
    """The points that are far from edges and from the ball, where the field is smooth."""
    at = CORNER @ points
    beside = np.sort(np.array(ROOM.half) - np.abs(at), axis=1)[:, 1]
    return points[(beside > 0.35) & (np.linalg.norm(at - ROOM.ball, axis=1) > ROOM.radius + 0.3)]


def test_the_normal_equations_are_those_of_finite_differences(corner: TsdfMap) -> None:
    pose = CORNER @ SE3.exp([0.004, 0.003, -0.002, 0.001, 0.0, -0.001])
    points = flat(seen(CORNER, 16))
    points = points[np.isfinite(corner.query(pose @ points))]
    sigma = np.full(len(points), 0.02)
    fields = corner.store.fields
    h = 1e-4
    nudges = [
        np.nan_to_num(corner.query(pose @ points + h * e) - corner.query(pose @ points - h * e)) / (2 * h)
        for e in np.eye(3)
    ]
    steep = np.linalg.norm(nudges, axis=0)
    points, sigma, steep = points[steep > 0.5], sigma[steep > 0.5], steep[steep > 0.5]

    def cost(xi: np.ndarray) -> float:
        d = corner.query((pose @ SE3.exp(xi)) @ points) / steep
        return 0.5 * float(np.nansum((d / sigma) ** 2))

    information, vector = np.zeros((6, 6)), np.zeros(6)
    used, misfit = kernels.accumulate(
        corner.store.table, fields["distance"], fields["weight"], corner.voxel_size_m, points, sigma,
        np.ascontiguousarray(pose.matrix[:3]), 1e9, information, vector,
    )  # fmt: skip
    assert used == len(points) > 80
    assert 0.0 < misfit < 0.01
    step = 1e-5
    slope = np.array([(cost(step * e) - cost(-step * e)) / (2 * step) for e in np.eye(6)])
    assert np.allclose(-vector, slope, atol=0.03 * np.abs(slope).max())
    assert np.allclose(information, information.T)
    assert (np.linalg.eigvalsh(information) > 0).all()
