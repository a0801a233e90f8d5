"""Labels by gradient: against the twin, in a room whose surfaces are known, and on real scans of a corridor."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mapping.drivable import CEILING, FLOOR, OBJECT, UNKNOWN, label_points, label_range_image
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.sensors import LidarModel
from tests import naive_elevation as naive
from tests.support.recordings import recording
from tests.support.rooms import Room

MODEL = LidarModel.even(48, np.radians(-70), np.radians(70), 90)


def room_image(pose: SE3) -> np.ndarray:
    rays = MODEL.rays().reshape(-1, 3).astype(np.float64)
    ranges = Room().cast(pose.translation, rays @ pose.rotation.T)
    return (rays * ranges[:, None]).reshape(*MODEL.shape, 3)


def sweep(*points: tuple[float, float]) -> np.ndarray:
    """Points (distance over ground, height) of one sweep along x, as an image with one column, the highest first."""
    return np.array([[[y, 0.0, z]] for y, z in points[::-1]])


def labels(*points: tuple[float, float], **parameters: float) -> list[int]:
    """From bottom to top, by the rule of the paper."""
    return label_range_image(sweep(*points), **{"baseline_m": 0.0, **parameters})[::-1, 0].tolist()


# -- the rule --------------------------------------------------------------------------------------------------


def test_floor_wall_and_ceiling_are_told_by_their_gradient():
    points = [(1.0, -0.5), (2.0, -0.5), (3.0, -0.4), (3.0, 0.2), (3.1, 1.0), (2.0, 1.1), (1.0, 1.0)]
    assert labels(*points) == [FLOOR, FLOOR, FLOOR, OBJECT, OBJECT, CEILING, CEILING]


@pytest.mark.parametrize(
    ("degrees", "label"), [(-80, FLOOR), (19, FLOOR), (21, OBJECT), (90, OBJECT), (159, OBJECT), (161, CEILING)]
)
def test_the_threshold_is_tau_on_both_sides(degrees, label):
    angle = np.radians(degrees)
    assert labels((3.0, -1.0), (3.0 + np.cos(angle), -1.0 + np.sin(angle)))[1] == label


def test_the_angle_runs_from_straight_down_to_straight_down():
    assert naive.gradient((0.0, 0.0), (1.0, -1.0)) == pytest.approx(-np.pi / 4)
    assert naive.gradient((0.0, 0.0), (-1.0, -1.0)) == pytest.approx(5 * np.pi / 4)
    assert labels((3.0, -1.0), (2.0, -1.1))[1] == CEILING  # back towards the sensor, and down


def test_tilting_ground_is_floor_while_it_is_less_steep_than_tau():
    gentle = [(y, -0.5 + y * np.tan(np.radians(15))) for y in np.arange(1.0, 5.0, 0.5)]
    steep = [(y, -0.5 + y * np.tan(np.radians(25))) for y in np.arange(1.0, 5.0, 0.5)]
    assert set(labels(*gentle)) == {FLOOR}
    assert set(labels(*steep)) == {OBJECT}
    assert set(labels(*steep, tau_deg=30.0)) == {FLOOR}


def test_both_sides_of_a_sharp_edge_are_floor():
    pothole = [(1.0, -1.0), (1.5, -1.0), (2.0, -1.0), (2.6, -1.3), (3.0, -1.3), (3.0, -1.0), (3.5, -1.0)]
    assert labels(*pothole) == [FLOOR] * 5 + [OBJECT, FLOOR]


def test_a_point_alone_in_its_sweep_is_unknown():
    assert labels((1.0, -0.5)) == [UNKNOWN]
    assert label_points(np.array([[1.0, 0.0, -0.5], [-1.0, 0.1, -0.5]])).tolist() == [UNKNOWN, UNKNOWN]
    assert label_points(np.zeros((0, 3))).tolist() == []


def test_what_was_not_measured_is_unknown_and_does_not_part_its_neighbours():
    image = sweep((1.0, -0.5), (2.0, -0.5), (3.0, -0.5))
    image[1] = np.nan
    assert label_range_image(image)[:, 0].tolist() == [FLOOR, UNKNOWN, FLOOR]
    image[1] = 0.0
    assert label_range_image(image)[:, 0].tolist() == [FLOOR, UNKNOWN, FLOOR]


def test_a_baseline_keeps_noise_from_making_slopes():
    points = [(y, -0.5 + 0.01 * (n % 2)) for n, y in enumerate(np.arange(1.0, 2.0, 0.01))]
    assert labels(*points).count(FLOOR) < 60
    assert set(labels(*points, baseline_m=0.1)) == {FLOOR}


# -- against the twin ------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(1, 4), st.sampled_from([0.0, 0.3]))
@settings(deadline=None, max_examples=40)
def test_kernel_matches_the_naive_reference(seed, k, baseline):
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, (60, 3))
    sweeps = defaultdict(list)
    for n, (x, y, z) in enumerate(points):
        sweeps[np.floor(np.degrees(np.arctan2(y, x)) / 30.0)].append((np.arctan2(z, np.hypot(x, y)), n))
    expected = np.full(len(points), 99)
    for found in sweeps.values():
        rows = [n for _, n in sorted(found)]
        flat = [(float(np.hypot(*points[n, :2])), float(points[n, 2])) for n in rows]
        expected[rows] = naive.labels_of_sweep(flat, k, baseline, np.radians(20.0))
    ours = label_points(points, k=k, baseline_m=baseline, azimuth_step_deg=30.0)
    assert ours.tolist() == expected.tolist()


def test_a_range_image_and_the_cloud_of_its_points_get_the_same_labels():
    image = room_image(SE3(np.eye(3), [-0.5, 0.2, -0.3]))
    shifted = SE3.exp([0, 0, 0, 0, 0, np.radians(1.0)])  # so that beams lie within sweeps, not on their borders
    cloud = label_points(image.reshape(-1, 3), shifted, azimuth_step_deg=360.0 / MODEL.columns)
    assert (label_range_image(image).ravel() == cloud).all()


# -- where the truth is known ----------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_in_a_room_floor_walls_and_ceiling_are_what_they_are_however_the_sensor_is_held(tilt):
    room = Room(ball=(9.0, 9.0, 9.0))
    pose = SE3(SE3.exp([0, 0, 0, tilt, -tilt, 0.3]).rotation, [-0.5, 0.2, -0.3])
    rays = MODEL.rays().reshape(-1, 3).astype(np.float64)
    image = (rays * room.cast(pose.translation, rays @ pose.rotation.T)[:, None]).reshape(*MODEL.shape, 3)
    p_map = (pose @ image.reshape(-1, 3)).reshape(image.shape)
    inside = (np.abs(p_map[..., :2]) < np.array(room.half[:2]) - 0.3).all(axis=-1)
    found = label_points(image.reshape(-1, 3), pose, azimuth_step_deg=4.0).reshape(MODEL.shape)
    for where, label in (
        (p_map[..., 2] < -room.half[2] + 1e-6, FLOOR),
        ((p_map[..., 2] > room.half[2] - 1e-6) & inside, CEILING),  # its border takes its gradient from the wall
        (np.abs(p_map[..., 2]) < room.half[2] - 0.2, OBJECT),
    ):
        assert (found[where] == label).mean() > 0.97


def floor_plane(points: np.ndarray) -> np.ndarray:
    """Height (N,) above the plane that most of the lower points lie on: of 300 random ones, then by least squares."""
    rng = np.random.default_rng(0)
    low = points[points[:, 2] < np.percentile(points[:, 2], 30)]
    best = low[:3]
    for _ in range(300):
        plane = np.linalg.lstsq(
            np.c_[(some := low[rng.choice(len(low), 3)])[:, :2], np.ones(3)], some[:, 2], rcond=None
        )[0]
        near = low[np.abs(low[:, :2] @ plane[:2] + plane[2] - low[:, 2]) < 0.03]
        if np.hypot(*plane[:2]) < 0.2 and len(near) > len(best):
            best = near
    a, b, c = np.linalg.lstsq(np.c_[best[:, :2], np.ones(len(best))], best[:, 2], rcond=None)[0]
    return (points[:, 2] - a * points[:, 0] - b * points[:, 1] - c) / np.sqrt(1.0 + a * a + b * b)


def test_in_a_real_corridor_the_floor_is_floor_and_walls_are_not():
    """Truth without labels: floor is what lies within 3 cm of the floor plane and 15 cm away from what stands on it;
    wall is what lies 0.3 m to 1.7 m above it, upright by its 20 neighbours, and seen at less than 66° from face-on."""
    from mapping.datasets import open_dataset

    for scan in open_dataset(recording("3dtk_dat_lidar_odometry")):
        points = scan.points.astype(np.float64)
        height = floor_plane(points)
        standing = cKDTree(points[(height > 0.1) & (height < 1.0), :2])
        floor = np.flatnonzero(np.abs(height) < 0.03)
        floor = floor[standing.query(points[floor, :2])[0] > 0.15]
        wall = np.flatnonzero((height > 0.3) & (height < 1.7))[::20]
        around = points[cKDTree(points).query(points[wall], 20)[1]]
        centred = around - around.mean(axis=1, keepdims=True)
        normal = np.linalg.eigh(centred.transpose(0, 2, 1) @ centred)[1][:, :, 0]
        facing = np.abs((normal * points[wall]).sum(axis=1)) / np.linalg.norm(points[wall], axis=1)
        wall = wall[(np.abs(normal[:, 2]) < 0.2) & (facing > 0.4)]
        found = label_points(points)
        assert len(floor) > 10_000
        assert len(wall) > 1_000
        assert (found[floor] == FLOOR).mean() >= 0.95
        assert (found[wall] == FLOOR).mean() <= 0.05
        assert (found[wall] == OBJECT).mean() >= 0.9


# -- refusals --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "bad"),
    [("tau_deg", 0.0), ("tau_deg", 90.0), ("k", 0), ("k", 1.5), ("baseline_m", -1.0), ("azimuth_step_deg", 0.0)],
)
def test_bad_parameters_are_refused_by_name(name, bad):
    with pytest.raises(InvalidParameter, match=name):
        label_points(np.ones((3, 3)), **{name: bad})


def test_bad_points_are_refused():
    for bad in (np.nan, np.inf):
        with pytest.raises(InvalidObservation, match="finite"):
            label_points(np.array([[1.0, 0.0, 0.0], [bad, 0.0, -bad]]))
    with pytest.raises(InvalidParameter, match="rows, columns, 3"):
        label_range_image(np.zeros((4, 3)))
