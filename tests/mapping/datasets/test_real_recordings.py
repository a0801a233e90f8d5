"""The readers on real data: where poses, handedness and cameras are right, observations agree on what they saw."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mapping.datasets import open_dataset
from mapping.errors import DatasetError
from mapping.geometry import SE3
from mapping.observations import AgentPose, LabelSpace, RgbdImage, Scan
from tests.support.recordings import recording

TUM = "tum_fr1_rpy_rgbd"
REDWOOD = "open3d_icl_livingroom_rgbd"
CORRIDOR = "3dtk_dat_lidar_odometry"
STRUCTURED = "la3dm_sim_lidar_poses/sim_structured"
LABELLED = "la3dm_sim_lidar_poses/semantic_sim_unstructured_annotated"
LASER = "radish_2d_lidar_odometry"


def reprojection_error(a: RgbdImage, b: RgbdImage) -> float:
    """Median difference [m] between the depth of image b and that of the points of image a seen from b."""
    p_a = a.intrinsics.backproject(a.depth_m)[::4, ::4].reshape(-1, 3)
    p_a = p_a[(p_a[:, 2] > 0) & (p_a[:, 2] < 3.0)].astype(np.float64)
    uv, z = b.intrinsics.project(b.T_map_camera.inverse() @ a.T_map_camera @ p_a)
    pixel = np.rint(np.where(np.isfinite(uv), uv, -1.0)).astype(int)
    inside = ((pixel >= 0) & (pixel < (b.intrinsics.width, b.intrinsics.height))).all(axis=1)
    depth = b.depth_m[pixel[inside, 1], pixel[inside, 0]]
    return float(np.median(np.abs(depth - z[inside])[depth > 0]))


def surface_distance(a: Scan, b: Scan, T_a_b: SE3) -> float:
    """Median distance [m] of the points of scan b from the planes through the nearest points of scan a."""
    p_a = a.points[::3].astype(np.float64)
    tree = cKDTree(p_a)
    p_b = T_a_b @ b.points[::40].astype(np.float64)
    distance, nearest = tree.query(p_b)
    near = distance < 0.3
    around = p_a[tree.query(p_a[nearest[near]], 16)[1]]
    around -= around.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return float(np.median(np.abs(np.einsum("ni,ni->n", p_b[near] - p_a[nearest[near]], vectors[:, :, 0]))))


def test_tum_images_agree_with_each_other():
    dataset = open_dataset(recording(TUM))
    assert (dataset.format, len(dataset)) == ("tum", 61)
    errors, stamps, before = [], [], None
    for number, image in enumerate(dataset):
        stamps.append(image.stamp_ns)
        assert image.depth.shape == image.color.shape[:2] == (480, 640)
        if before is not None and number % 6 == 1:
            errors.append(reprojection_error(before, image))
        before = image
    assert number == 60
    assert stamps == sorted(stamps)
    assert stamps[0] == 1305031229528784000  # of the depth image, to the microsecond
    assert np.median(errors) < 0.02
    assert before.intrinsics.fx == 517.3


def test_tum_images_disagree_when_their_poses_are_shifted():
    images = [image for image, _ in zip(open_dataset(recording(TUM)), range(3), strict=False)]
    right = reprojection_error(images[0], images[1])
    wrong = images[1].model_copy(update={"T_map_camera": images[2].T_map_camera})
    assert reprojection_error(images[0], wrong) > 2.0 * right


def test_tum_map_has_z_up():
    image = next(iter(open_dataset(recording(TUM))))
    assert image.T_map_camera.rotation[2, 1] < -0.4  # the lower side of the image is down, the camera looks at a desk


def test_redwood_images_agree_with_each_other_and_stand_on_a_level_floor():
    dataset = open_dataset(recording(REDWOOD))
    assert (dataset.format, len(dataset)) == ("redwood", 5)
    images = list(dataset)
    assert max(reprojection_error(a, b) for a, b in pairwise(images)) < 0.01
    assert images[0].depth.dtype == np.uint16
    assert images[0].intrinsics.fx == 525.0
    for image in images:
        assert image.T_map_camera.rotation[2, 1] < -0.9  # y points up in the recording, z in the map
    p_camera = images[0].intrinsics.backproject(images[0].depth_m)[::2, ::2].reshape(-1, 3)
    heights = (images[0].T_map_camera @ p_camera[p_camera[:, 2] > 0])[:, 2]
    floor = np.percentile(heights, 2)
    assert np.mean(np.abs(heights - floor) < 0.02) > 0.1  # one level holds much of what is seen


def test_redwood_up_axis_can_be_told():
    kept = next(iter(open_dataset(recording(REDWOOD), up="z")))
    turned = next(iter(open_dataset(recording(REDWOOD), up="y")))
    guessed = next(iter(open_dataset(recording(REDWOOD))))
    assert turned.T_map_camera.isclose(guessed.T_map_camera)
    x, y, z = kept.T_map_camera.translation
    np.testing.assert_allclose(turned.T_map_camera.translation, [x, -z, y], atol=1e-12)


def test_corridor_scans_lie_on_each_other_when_registered():
    dataset = open_dataset(recording(CORRIDOR))
    assert (dataset.format, len(dataset)) == ("3dtk", 3)
    scans = list(dataset)
    assert all(np.linalg.norm(scan.points, axis=1).min() >= 0.3 for scan in scans)
    assert all(np.linalg.norm(scan.points, axis=1).max() < 32.7 for scan in scans)
    steps = [a.T_map_sensor.inverse() @ b.T_map_sensor for a, b in pairwise(scans)]
    for (a, b), step in zip(pairwise(scans), steps, strict=True):
        assert surface_distance(a, b, step) < 0.02
    assert 3.3 < sum(np.linalg.norm(step.translation) for step in steps) < 3.5
    assert scans[2].T_map_sensor.translation[0] > 3.3  # it drove forward, along x


def test_corridor_scans_do_not_fit_with_the_wrong_handedness():
    a, b, _ = open_dataset(recording(CORRIDOR))
    step = a.T_map_sensor.inverse() @ b.T_map_sensor
    mirror = np.diag([1.0, -1.0, 1.0])
    mirrored = SE3(mirror @ step.rotation @ mirror, mirror @ step.translation)
    assert surface_distance(a, b, mirrored) > 1.2 * surface_distance(a, b, step)


def test_corridor_stands_upright():
    scan = next(iter(open_dataset(recording(CORRIDOR))))
    counts, edges = np.histogram(scan.points[:, 2], bins=np.arange(-3.0, 3.0, 0.05))
    floor, rest = edges[counts[:60].argmax()], counts[edges[:-1] < -1.0]
    assert -2.0 < floor < -0.3
    assert rest.sum() < 0.2 * len(scan.points)  # nothing to speak of below the floor


def test_odometry_differs_from_the_registered_poses_by_a_plausible_correction():
    """Less than any other sign of the three angles would give: the convention of the angles is right."""
    path = recording(CORRIDOR)
    corrections = []
    for registered, odometry in zip(open_dataset(path), open_dataset(path, poses="odometry"), strict=True):
        corrections.append((registered.T_map_sensor.inverse() @ odometry.T_map_sensor).log())
    assert np.abs(corrections[0]).max() < 1e-9
    for correction in corrections[1:]:
        assert np.linalg.norm(correction[:3]) < 0.08
        assert 0.3 < np.degrees(np.linalg.norm(correction[3:])) < 1.0


def test_structured_scans_end_in_the_occupied_voxels_of_the_reference_map():
    path = recording(STRUCTURED)
    dataset = open_dataset(path)
    assert (dataset.format, len(dataset)) == ("pcd", 12)
    table = np.loadtxt(path / "sim_structured_octomap.csv", delimiter=",", skiprows=1)
    occupied = cKDTree(table[table[:, 3] > 0.5, :3])
    shares = []
    for scan in dataset:
        p_map = scan.T_map_sensor @ scan.points.astype(np.float64)
        distance, _ = occupied.query(p_map[np.linalg.norm(scan.points, axis=1) < 8.0], p=np.inf)
        shares.append(np.mean(distance < 0.0501))
    assert min(shares) > 0.95
    assert np.mean(shares) > 0.99


def test_pcd_scans_come_in_the_order_of_their_numbers():
    names = [path.name for path in open_dataset(recording(STRUCTURED))._files]  # type: ignore[attr-defined]
    assert names == [f"sim_structured_{i}.pcd" for i in range(1, 13)]


def test_pcd_points_are_those_of_open3d():
    o3d = pytest.importorskip("open3d")
    for folder in (STRUCTURED, LABELLED):
        path = recording(folder)
        scans = [scan for scan in open_dataset(path) if isinstance(scan, Scan)]
        theirs = np.asarray(o3d.io.read_point_cloud(str(sorted(path.glob("*_1.pcd"))[0])).points)
        ours = scans[0].T_map_sensor @ scans[0].points.astype(np.float64)
        np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_labelled_scans_announce_their_classes_first():
    dataset = open_dataset(recording(LABELLED), label_names={1: "ground"})
    observations = list(dataset)
    assert len(dataset) == len(observations) == 13
    assert isinstance(observations[0], LabelSpace)
    assert {i: info.name for i, info in observations[0].classes.items()} == {1: "ground", 2: "class_2", 3: "class_3"}
    labels, heights = [], []
    for scan in observations[1:]:
        labels.append(scan.labels)
        heights.append((scan.T_map_sensor @ scan.points)[:, 2])
    ground = np.concatenate(labels) == 1
    assert np.percentile(np.concatenate(heights)[ground], 95) < 0.3  # the class called ground is the ground


def test_laser_scans_lie_on_each_other_where_the_robot_says_it_is():
    dataset = open_dataset(recording(LASER))
    assert (dataset.format, len(dataset)) == ("carmen", 13885)
    stamp_ns, previous, errors, unmoved = 0, None, [], []
    for number, observation in enumerate(dataset):
        assert observation.stamp_ns >= stamp_ns
        stamp_ns = observation.stamp_ns
        if isinstance(observation, AgentPose):
            assert observation.T_map_base.translation[2] == 0.0
            continue
        assert observation.T_map_sensor.translation[2] == pytest.approx(0.3)
        if previous is not None and number % 40 < 3:
            p_map = [scan.T_map_sensor @ scan.points.astype(np.float64) for scan in (previous, observation)]
            errors.append(np.median(cKDTree(p_map[0]).query(p_map[1])[0]))
            unmoved.append(np.median(cKDTree(previous.points).query(observation.points)[0]))
        previous = observation
        if number > 6000:
            break
    assert np.median(errors) < 0.03
    assert np.median(errors) < 0.5 * np.median(unmoved)


def test_a_dataset_can_be_read_again_and_again():
    for name in (REDWOOD, CORRIDOR, STRUCTURED):
        dataset = open_dataset(recording(name))
        assert next(iter(dataset)) == next(iter(dataset))


def test_a_folder_of_recordings_names_them():
    with pytest.raises(DatasetError, match="not a recording") as caught:
        open_dataset(recording("la3dm_sim_lidar_poses"))
    assert "sim_structured (pcd)" in caught.value.hint
