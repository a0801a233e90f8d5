"""Each format on small folders made here: every variant is read, and what is missing or damaged is named."""

import bz2
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mapping.datasets import FORMATS, open_dataset
from mapping.datasets.dataset import seconds_to_ns
from mapping.datasets.pcd import PcdDataset, lzf_decompress, read_columns
from mapping.datasets.threedtk import read_pose
from mapping.datasets.tum import associate
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import AgentPose, LabelSpace, Scan

# -- TUM -------------------------------------------------------------------------------------------------------


def write_tum(folder, *, associations=False, images=5, poses=True):
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    rgb, depth, pairs = ["# colour"], ["# depth"], []
    for i in range(images):
        t_rgb, t_depth = f"{100 + i / 10:.6f}", f"{100.01 + i / 10:.6f}"
        Image.fromarray(np.full((6, 8, 3), 40 * i, np.uint8)).save(folder / "rgb" / f"{t_rgb}.png")
        Image.fromarray(np.full((6, 8), 5000 * (i + 1), np.uint16)).save(folder / "depth" / f"{t_depth}.png")
        rgb.append(f"{t_rgb} rgb/{t_rgb}.png")
        depth.append(f"{t_depth} depth/{t_depth}.png")
        pairs.append(f"{t_rgb} rgb/{t_rgb}.png {t_depth} depth/{t_depth}.png")
    (folder / "rgb.txt").write_text("\n".join(rgb))
    (folder / "depth.txt").write_text("\n".join(depth))
    if associations:
        (folder / "associations.txt").write_text("\n".join(pairs))
    if poses:
        lines = [f"{99.99 + i / 50:.4f} {i / 50:.4f} 0 0 0 0 0 1" for i in range(40)]
        (folder / "groundtruth.txt").write_text("# poses\n" + "\n".join(lines))
    return folder


@pytest.mark.parametrize("associations", [True, False])
def test_tum_pairs_images_and_interpolates_their_poses(tmp_path, associations):
    dataset = open_dataset(write_tum(tmp_path / "freiburg2_desk", associations=associations))
    assert len(dataset) == 5
    for i, image in enumerate(dataset):
        assert image.stamp_ns == 100_010_000_000 + i * 100_000_000
        np.testing.assert_allclose(image.depth_m, i + 1.0)
        assert (image.color == 40 * i).all()
        np.testing.assert_allclose(image.T_map_camera.translation[0], 0.02 + i / 10, atol=1e-6)
        assert image.intrinsics.fx == 520.9  # the name tells the camera


def test_tum_images_without_a_pose_are_left_out_and_counted(tmp_path):
    folder = write_tum(tmp_path / "desk")
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(lines[:8] + lines[16:]))
    dataset = open_dataset(folder)
    assert len(dataset) == 4
    assert dataset.skipped["no pose near the image"] == 1


def test_tum_images_that_are_only_listed_are_left_out_and_counted(tmp_path):
    folder = write_tum(tmp_path / "desk")
    next((folder / "depth").iterdir()).unlink()
    dataset = open_dataset(folder, fx=500.0)
    assert (len(dataset), dataset.skipped["image file not in the folder"]) == (4, 1)
    assert next(iter(dataset)).intrinsics.fx == 500.0


def test_tum_without_poses_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"looks like a TUM RGB-D folder, but lacks groundtruth\.txt"):
        open_dataset(write_tum(tmp_path / "desk", poses=False))


def test_tum_with_poses_of_another_time_is_refused(tmp_path):
    folder = write_tum(tmp_path / "desk")
    (folder / "groundtruth.txt").write_text("5.0 0 0 0 0 0 0 1\n")
    with pytest.raises(DatasetError, match=r"no image with depth and pose \(no pose near the image: 5\)"):
        open_dataset(folder)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("groundtruth.txt", "100 0 0 0\n", "line 1: expected 8 columns, got 4"),
        ("groundtruth.txt", "100 a 0 0 0 0 0 1\n", "expected numbers"),
        ("groundtruth.txt", "# nothing\n", "no poses"),
        ("depth.txt", "soon depth/x.png\n", "expected a time in seconds, got 'soon'"),
    ],
)
def test_tum_lists_that_are_damaged_are_named(tmp_path, name, text, expected):
    folder = write_tum(tmp_path / "desk")
    (folder / name).write_text(text)
    with pytest.raises(DatasetError, match=expected) as caught:
        open_dataset(folder)
    assert name in str(caught.value)


def test_a_truncated_image_is_named_when_it_is_read(tmp_path):
    folder = write_tum(tmp_path / "desk")
    file = sorted((folder / "depth").iterdir())[1]
    file.write_bytes(file.read_bytes()[:40])
    images = iter(open_dataset(folder))
    next(images)
    with pytest.raises(DatasetError, match=f"{file.name}: not a complete image"):
        next(images)


def test_a_depth_image_of_8_bits_is_refused(tmp_path):
    folder = write_tum(tmp_path / "desk")
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(sorted((folder / "depth").iterdir())[0])
    with pytest.raises(DatasetError, match="16 bits, got uint8"):
        next(iter(open_dataset(folder)))


@given(st.lists(st.integers(0, 400), unique=True, max_size=8), st.lists(st.integers(0, 400), unique=True, max_size=8))
def test_association_is_one_to_one_and_within_the_gap(depth_ms, color_ms):
    depth = [(ms * 10**6, ms) for ms in depth_ms]
    color = [(ms * 10**6, ms) for ms in color_ms]
    pairs = associate(depth, color)
    assert len({pair.depth for pair in pairs}) == len({pair.color for pair in pairs}) == len(pairs)
    assert all(abs(pair.depth - pair.color) <= 20 for pair in pairs)
    left = set(depth_ms) - {pair.depth for pair in pairs}
    free = set(color_ms) - {pair.color for pair in pairs}
    assert not any(abs(d - c) <= 20 for d in left for c in free)


def test_times_keep_their_nanoseconds():
    assert seconds_to_ns("1305031229.528784") == 1305031229528784000
    assert seconds_to_ns("1700000000.123456789") == 1700000000123456789
    assert seconds_to_ns("12") == 12 * 10**9
    assert seconds_to_ns("1.5e3") == 1500 * 10**9


# -- Redwood ---------------------------------------------------------------------------------------------------


def write_redwood(folder, images=3, poses=3):
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for i in range(images):
        Image.fromarray(np.zeros((6, 8, 3), np.uint8)).save(folder / "color" / f"{i}.jpg")
        Image.fromarray(np.full((6, 8), 1000 + i, np.uint16)).save(folder / "depth" / f"{i}.png")
    blocks = [f"{i} {i} {i + 1}\n" + "\n".join(" ".join(map(str, row)) for row in np.eye(4)) for i in range(poses)]
    (folder / "trajectory.log").write_text("\n".join(blocks))
    return folder


def test_redwood_images_are_read_with_the_default_camera_and_turned_upright(tmp_path):
    dataset = open_dataset(write_redwood(tmp_path / "room"))
    assert dataset.format == "redwood"
    assert [int(image.depth[0, 0]) for image in dataset] == [1000, 1001, 1002]
    image = next(iter(dataset))
    assert image.intrinsics.fx == 525.0
    np.testing.assert_allclose(image.T_map_camera.rotation[:, 1], [0, 0, -1], atol=1e-12)  # first camera is the world


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_redwood_turns_the_up_axis_to_z(tmp_path, up):
    (image, *_) = open_dataset(write_redwood(tmp_path / "room"), up=up)
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    np.testing.assert_allclose(image.T_map_camera.rotation @ axis, [0, 0, 1], atol=1e-12)


def test_redwood_counts_what_does_not_match(tmp_path):
    dataset = open_dataset(write_redwood(tmp_path / "a", images=3, poses=2))
    assert (len(dataset), dataset.skipped["image without a pose"]) == (2, 1)
    dataset = open_dataset(write_redwood(tmp_path / "b", images=2, poses=3))
    assert (len(dataset), dataset.skipped["pose without an image"]) == (2, 1)


def test_redwood_without_poses_is_refused(tmp_path):
    folder = write_redwood(tmp_path / "room")
    (folder / "trajectory.log").unlink()
    with pytest.raises(DatasetError, match=r"looks like a Redwood RGB-D folder, but lacks trajectory\.log"):
        open_dataset(folder)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("trajectory.log", "0 0 1\n1 0 0", "truncated or not a trajectory"),
        ("trajectory.log", " ".join(["x"] * 19), "expected numbers"),
        ("trajectory.log", "0 0 1 " + " ".join(["2"] * 16), "image 0: pose"),
        ("camera.json", "{}", "intrinsic_matrix"),
    ],
)
def test_redwood_files_that_are_damaged_are_named(tmp_path, name, text, expected):
    folder = write_redwood(tmp_path / "room")
    (folder / name).write_text(text)
    with pytest.raises(DatasetError, match=expected) as caught:
        open_dataset(folder)
    assert name in str(caught.value)


# -- 3DTK ------------------------------------------------------------------------------------------------------


def write_3dtk(folder, *, frames=True, pose=True):
    folder.mkdir()
    for i in range(2):
        (folder / f"scan00{i}.3d").write_text("100 0 0\n0 100 0\n0 0 100\n3276 0 0\n5 5 5\n")
        if frames:
            matrix = np.eye(4)
            matrix[:3, 3] = (10 * i, 20 * i, 300 * i)
            (folder / f"scan00{i}.frames").write_text(" ".join(map(str, matrix.T.ravel())) + " 2\n")
        if pose:
            (folder / f"scan00{i}.pose").write_text(f"0 0 {310 * i}\n0 0 0\n")
    return folder


def test_3dtk_axes_become_forward_left_up_in_metres(tmp_path):
    first, second = open_dataset(write_3dtk(tmp_path / "run"))
    np.testing.assert_allclose(first.points, [[0, -1, 0], [0, 0, 1], [1, 0, 0]])  # right, up, forward
    np.testing.assert_allclose(second.T_map_sensor.translation, [3.0, -0.1, 0.2])


def test_3dtk_euler_angles_turn_as_3dtk_turns(tmp_path):
    """In a left-handed frame with y up, a positive angle about y turns z forward towards x right: to the right."""
    (tmp_path / "a.pose").write_text("0 0 0\n0 30 0\n")
    np.testing.assert_allclose(read_pose(tmp_path / "a.pose").log(), [0, 0, 0, 0, 0, -np.radians(30)], atol=1e-12)
    (tmp_path / "b.pose").write_text("0 0 0\n10 20 30\n")
    T = read_pose(tmp_path / "b.pose")
    z, y, x = (np.radians(a) for a in (30, 20, 10))
    turns = [SE3.exp([0, 0, 0, 0, x, 0]), SE3.exp([0, 0, 0, 0, 0, -y]), SE3.exp([0, 0, 0, -z, 0, 0])]
    assert T.isclose(turns[0] @ turns[1] @ turns[2])


def test_3dtk_odometry_poses_are_read_on_demand(tmp_path):
    _, second = open_dataset(write_3dtk(tmp_path / "run", frames=False), poses="odometry")
    np.testing.assert_allclose(second.T_map_sensor.translation, [3.1, 0, 0])


def test_3dtk_without_registered_poses_hints_at_odometry(tmp_path):
    with pytest.raises(DatasetError, match=r"scan000\.frames, scan001\.frames missing") as caught:
        open_dataset(write_3dtk(tmp_path / "run", frames=False))
    assert "--poses odometry" in caught.value.hint


def test_3dtk_without_any_poses_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"looks like a folder of 3DTK scans, but lacks scan000\.frames"):
        open_dataset(write_3dtk(tmp_path / "run", frames=False, pose=False))


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("scan001.frames", "1 0 0\n", "16 numbers"),
        ("scan001.frames", " ".join(["2"] * 17), "orthonormal"),
        ("scan001.3d", "1 2\n", "lines x y z"),
    ],
)
def test_3dtk_files_that_are_damaged_are_named(tmp_path, name, text, expected):
    folder = write_3dtk(tmp_path / "run")
    (folder / name).write_text(text)
    with pytest.raises(DatasetError, match=expected) as caught:
        list(open_dataset(folder))
    assert name in str(caught.value)


# -- PCD -------------------------------------------------------------------------------------------------------

HEADER = """# .PCD v0.7
VERSION 0.7
FIELDS x y z intensity label
SIZE 4 4 4 4 2
TYPE F F F F U
COUNT 1 1 1 1 1
WIDTH {n}
HEIGHT 1
VIEWPOINT {viewpoint}
POINTS {n}
DATA {encoding}
"""
ROWS = [(1.0, 2.0, 3.0, 0.5, 4), (4.0, 5.0, 6.0, 0.25, 7)]
VIEWPOINT = "1 2 3 0.7071068 0 0 0.7071068"


def write_pcd(path, encoding="ascii", viewpoint=VIEWPOINT, rows=ROWS):
    header = HEADER.format(n=len(rows), viewpoint=viewpoint, encoding=encoding).encode()
    if encoding == "ascii":
        body = "\n".join(" ".join(map(str, row)) for row in rows).encode()
    else:
        body = b"".join(struct.pack("<ffffH", *row) for row in rows)
    if encoding == "binary_compressed":
        columns = [
            struct.pack(f"<{len(rows)}{kind}", *column)
            for kind, column in zip("ffffH", zip(*rows, strict=True), strict=True)
        ]
        plain = b"".join(columns)
        runs = [plain[i : i + 32] for i in range(0, len(plain), 32)]
        packed = b"".join(bytes([len(run) - 1]) + run for run in runs)  # literal runs alone are valid LZF
        body = struct.pack("<II", len(packed), len(plain)) + packed
    path.write_bytes(header + body)
    return path


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_points_in_the_world_move_back_to_the_sensor(tmp_path, encoding):
    dataset = open_dataset(write_pcd(tmp_path / "a.pcd", encoding))
    space, scan = dataset
    assert isinstance(space, LabelSpace)
    assert sorted(space.classes) == [4, 7]
    assert isinstance(scan, Scan)
    np.testing.assert_allclose(scan.points, [[0, 0, 0], [3, -3, 3]], atol=1e-5)
    np.testing.assert_allclose(scan.T_map_sensor @ scan.points, [[1, 2, 3], [4, 5, 6]], atol=1e-5)
    assert scan.labels.tolist() == [4, 7]
    assert scan.intensity.tolist() == [0.5, 0.25]


def test_pcd_points_in_the_sensor_frame_stay(tmp_path):
    _, scan = open_dataset(write_pcd(tmp_path / "a.pcd"), points_in="sensor")
    np.testing.assert_allclose(scan.points, [[1, 2, 3], [4, 5, 6]])


def test_pcd_points_that_are_nan_are_left_out_and_counted(tmp_path):
    dataset = open_dataset(write_pcd(tmp_path / "a.pcd", "binary", rows=[*ROWS, (np.nan, 0.0, 0.0, 0.0, 9)]))
    *_, scan = dataset
    assert scan.points.shape == (2, 3)
    assert scan.labels.tolist() == [4, 7]
    assert dataset.skipped["points that are not finite"] == 1


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_files_written_by_open3d_are_read(tmp_path, encoding):
    o3d = pytest.importorskip("open3d")
    points = np.random.default_rng(0).normal(size=(500, 3)).round(1)  # repeats, so that compression refers back
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    file = tmp_path / "a.pcd"
    o3d.io.write_point_cloud(
        str(file), cloud, write_ascii=encoding == "ascii", compressed=encoding.endswith("compressed")
    )
    header, columns = read_columns(file)
    assert header.encoding == encoding
    np.testing.assert_allclose(np.column_stack([columns[axis] for axis in "xyz"]), points, atol=1e-6)


def test_pcd_scans_without_poses_are_refused(tmp_path):
    for i in range(3):
        write_pcd(tmp_path / f"{i}.pcd", viewpoint="0 0 0 1 0 0 0")
    with pytest.raises(
        DatasetError, match="looks like a folder of PCD scans, but lacks poses: VIEWPOINT is the default"
    ):
        open_dataset(tmp_path)
    file = write_pcd(tmp_path / "0.pcd")
    file.write_bytes(b"\n".join(line for line in file.read_bytes().splitlines() if b"VIEW" not in line))
    with pytest.raises(DatasetError, match=r"lacks VIEWPOINT .* in the header of 0\.pcd"):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda content: content[:-3], "truncated: 36 bytes of points announced, 33 there"),
        (lambda content: content.replace(b"binary", b"morse!"), "expected DATA ascii, binary or binary_compressed"),
        (lambda content: content.replace(b"FIELDS x", b"FIELDS u"), "FIELDS with x, y and z"),
        (lambda content: content.replace(b"TYPE F", b"TYPE Q"), "TYPE F, I or U"),
        (lambda content: content.replace(b"POINTS 2", b"POINTS -2"), "POINTS ≥ 0"),
        (lambda content: content.replace(b"VIEWPOINT 1 2", b"VIEWPOINT 1"), "VIEWPOINT tx ty tz"),
        (lambda content: content[:60], "no DATA line"),
        (lambda content: b"\0" * 100, "no DATA line"),
    ],
)
def test_pcd_files_that_are_damaged_are_named(tmp_path, change, expected):
    file = write_pcd(tmp_path / "a.pcd", "binary")
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(DatasetError, match=expected) as caught:
        list(open_dataset(file))
    assert "a.pcd" in str(caught.value)


def test_lzf_references_may_reach_into_what_they_write():
    assert lzf_decompress(b"\x00a" + bytes([(5 << 5) | 0, 0]), 8) == b"aaaaaaaa"
    for damaged in (b"\x05ab", b"\xe0", bytes([(1 << 5), 7])):
        with pytest.raises(ValueError, match=r"expected|early|before"):
            lzf_decompress(damaged, 8)


# -- CARMEN ----------------------------------------------------------------------------------------------------

LOG = """# CARMEN
PARAM robot_front_laser_max 20.0 0 host 0
ODOM 1 2 0 0 0 0 10.5 host 1.0
FLASER 5 1 2 3 30 5 1.0 2.0 1.5707963267948966 0 0 0 10.0 host 0.5
"""


def test_carmen_lines_become_scans_and_poses_in_order_of_time(tmp_path):
    (tmp_path / "a.clf").write_text(LOG)
    dataset = open_dataset(tmp_path, laser_height_m=0.4)
    assert len(dataset) == 2
    scan, pose = dataset
    assert isinstance(scan, Scan)
    assert isinstance(pose, AgentPose)
    assert (scan.stamp_ns, pose.stamp_ns) == (10 * 10**9, 10_500_000_000)
    d = np.sqrt(0.5)
    np.testing.assert_allclose(scan.points, [[0, -1, 0], [2 * d, -2 * d, 0], [3, 0, 0], [0, 5, 0]], atol=1e-6)
    np.testing.assert_allclose(scan.T_map_sensor.translation, [1, 2, 0.4])
    np.testing.assert_allclose(scan.T_map_sensor @ np.array([[3.0, 0, 0]]), [[1, 5, 0.4]], atol=1e-12)
    assert dataset.skipped["readings that met nothing"] == 1


def test_carmen_logs_may_be_compressed_and_without_odometry(tmp_path):
    (tmp_path / "a.clf.bz2").write_bytes(bz2.compress(LOG.encode()))
    assert len(open_dataset(tmp_path / "a.clf.bz2", odometry=False)) == 1
    (tmp_path / "a.clf.bz2").write_bytes(bz2.compress(LOG.encode() * 500)[:-20])
    with pytest.raises(DatasetError, match="damaged or truncated"):
        open_dataset(tmp_path / "a.clf.bz2")


def test_carmen_logs_without_scans_are_refused(tmp_path):
    (tmp_path / "a.clf").write_text("ODOM 1 2 0 0 0 0 10.5 host 1.0\n")
    with pytest.raises(DatasetError, match="looks like a CARMEN log, but lacks FLASER"):
        open_dataset(tmp_path)


def test_carmen_lines_that_are_damaged_are_named(tmp_path):
    (tmp_path / "a.clf").write_text(LOG + "FLASER 9 1 2 3\n")
    with pytest.raises(DatasetError, match="expected FLASER n, n readings"):
        list(open_dataset(tmp_path))


# -- finding the format ----------------------------------------------------------------------------------------


def test_a_folder_of_nothing_names_what_was_tried(tmp_path):
    with pytest.raises(DatasetError, match="not a recording that can be read; tried") as caught:
        open_dataset(tmp_path)
    assert all(name in str(caught.value) for name in FORMATS)
    with pytest.raises(DatasetError, match="no such file or folder"):
        open_dataset(tmp_path / "nothing")


def test_options_of_another_format_are_refused(tmp_path):
    folder = write_tum(tmp_path / "desk")
    with pytest.raises(InvalidParameter, match=r"poses: not an option of tum recordings; those are fx, fy"):
        open_dataset(folder, poses="odometry")
    with pytest.raises(InvalidParameter, match="format: expected one of"):
        open_dataset(folder, format="rosbag")
    with pytest.raises(DatasetError, match="tried pcd"):
        open_dataset(folder, format="pcd")


def test_bad_options_name_what_was_expected(tmp_path):
    with pytest.raises(InvalidParameter, match="poses: expected 'frames' or 'odometry', got 'gps'"):
        open_dataset(write_3dtk(tmp_path / "a"), poses="gps")
    with pytest.raises(InvalidParameter, match="points_in"):
        PcdDataset(write_pcd(tmp_path / "a.pcd"), points_in="air")  # type: ignore[arg-type]
    with pytest.raises(InvalidParameter, match="up: expected one of"):
        open_dataset(write_redwood(tmp_path / "b"), up="sideways")
    with pytest.raises(InvalidParameter, match="max_pose_gap_s"):
        open_dataset(write_tum(tmp_path / "c"), max_pose_gap_s=-1.0)
