"""Observations are frozen; a bad field is refused in one line that names it, its value and what was expected."""

import numpy as np
import pytest

from mapping.errors import InvalidObservation, MappingError
from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import (
    OBSERVATIONS,
    AgentPose,
    Detections,
    LabelSpace,
    PoseCorrection,
    RgbdImage,
    RobotDescription,
    Scan,
    Transform,
)

CAMERA = {"fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 1.5, "width": 4, "height": 3}
SENSED = {"stamp_ns": 5, "robot": "tiago", "sensor": "head"}
NAN_POSE = np.full((4, 4), np.nan)
ASYMMETRIC = np.triu(np.ones((6, 6)))


def image(**changes):
    return RgbdImage(**{**SENSED, "depth": np.ones((3, 4), np.float32), "intrinsics": CAMERA, **changes})


def scan(**changes):
    return Scan(**{**SENSED, "points": np.ones((5, 3), np.float32), **changes})


def detections(**item):
    return Detections(**SENSED, items=[{"label": "cup", "box2d": (0, 0, 5, 5), **item}])


def agent(**changes):
    return AgentPose(**{"stamp_ns": 5, "robot": "tiago", "T_map_base": np.eye(4), **changes})


def correction(**changes):
    poses = [{"stamp_ns": 3, "T_map_base": np.eye(4)}]
    return PoseCorrection(**{"stamp_ns": 5, "robot": "tiago", "poses": poses, **changes})


def edge(**changes):
    fields = {"stamp_ns": 5, "robot": "tiago", "parent": "odom", "child": "base_link", "T_parent_child": np.eye(4)}
    return Transform(**{**fields, **changes})


def robot(**changes):
    return RobotDescription(**{"robot": "tiago", "footprint": [[0, 0], [1, 0], [0, 1]], **changes})


BAD = [
    # field, value, what was expected
    (image, "stamp_ns", -1, "greater than or equal to 0"),
    (image, "stamp_ns", 2**63, "less than"),
    (image, "stamp_ns", 1.5, "integer"),
    (image, "stamp_ns", "now", "integer"),
    (image, "robot", "Tiago 1", "lower-case"),
    (image, "robot", "", "lower-case"),
    (image, "robot", "a/b", "lower-case"),
    (image, "robot", "a" * 65, "64"),
    (image, "sensor", "@head", "lower-case"),
    (image, "depth", np.ones((3, 4)), "float32 or uint16"),
    (image, "depth", np.ones((3, 4, 1), np.float32), r"\(n, n\)"),
    (image, "depth", -np.ones((3, 4), np.float32), "≥ 0 m"),
    (image, "depth", np.full((3, 4), np.inf, np.float32), "1000 m"),
    (image, "depth", np.full((3, 4), 2e3, np.float32), "1000 m"),
    (image, "depth", np.ones((0, 4), np.float32), "at least one pixel"),
    (image, "depth", "pixels", "an array"),
    (image, "depth", [["a"]], "an array"),
    (image, "intrinsics", {**CAMERA, "fx": 0.0}, "greater than 0"),
    (image, "intrinsics", {**CAMERA, "fy": -1.0}, "greater than 0"),
    (image, "intrinsics", {**CAMERA, "width": 3}, "depth has shape"),
    (image, "intrinsics", {"fx": 1.0}, "required"),
    (image, "T_map_camera", NAN_POSE, "finite"),
    (image, "T_map_camera", np.eye(4) * 2.0, "last row"),
    (image, "T_map_camera", np.diag([1.0, 1.0, -1.0, 1.0]), "right-handed"),
    (image, "T_map_camera", np.eye(3), r"\(4, 4\)"),
    (image, "T_map_camera", {"translation": [0, 0, 0]}, "rotation_wxyz"),
    (image, "T_map_camera", {"translation": [0, 0], "rotation_wxyz": [1, 0, 0, 0]}, r"\(3,\)"),
    (image, "T_map_camera", {"translation": [0, 0, 0], "rotation_wxyz": [2, 0, 0, 0]}, "unit quaternion"),
    (image, "T_map_camera", "here", "SE3"),
    (image, "covariance", np.eye(5), r"\(6, 6\)"),
    (image, "covariance", ASYMMETRIC, "symmetric"),
    (image, "covariance", -np.eye(6), "positive semi-definite"),
    (image, "covariance", np.full((6, 6), np.nan), "finite"),
    (image, "color", np.ones((3, 4, 3), np.float32), "uint8"),
    (image, "color", np.ones((3, 4), np.uint8), r"\(n, n, 3\)"),
    (image, "color", np.ones((6, 8, 3), np.uint8), "color_intrinsics is absent"),
    (image, "T_depth_color", NAN_POSE, "finite"),
    (image, "labels", np.ones((3, 4), np.int64), "uint16"),
    (image, "labels", np.ones((4, 3), np.uint16), "that of depth"),
    (image, "instances", np.ones((3, 4), np.uint16), "uint32"),
    (image, "instances", np.ones((1, 1), np.uint32), "that of depth"),
    (image, "label_confidence", np.full((3, 4), 1.5, np.float32), "0 … 1"),
    (image, "label_confidence", np.full((3, 4), np.nan, np.float32), "0 … 1"),
    (image, "deepth", 1, "not permitted"),
    (scan, "points", np.ones((5, 2), np.float32), r"\(n, 3\)"),
    (scan, "points", np.ones((5, 3)), "float32"),
    (scan, "points", np.full((5, 3), np.nan, np.float32), "finite"),
    (scan, "points", np.full((5, 3), 1e9, np.float32), "within"),
    (scan, "T_map_sensor", NAN_POSE, "finite"),
    (scan, "covariance", -np.eye(6), "positive semi-definite"),
    (scan, "labels", np.ones(4, np.uint16), "one a point: 5"),
    (scan, "instances", np.ones(6, np.uint32), "one a point: 5"),
    (scan, "intensity", np.ones(5), "float32"),
    (scan, "time_offset_ns", np.ones((5, 1), np.int64), r"\(n,\)"),
    (detections, "label", "", "at least 1 character"),
    (detections, "confidence", 1.5, "less than or equal to 1"),
    (detections, "confidence", float("nan"), "finite"),
    (detections, "box2d", None, "exactly one of"),
    (detections, "mask", np.ones((3, 4), np.bool_), "exactly one of"),
    (detections, "box2d", (5, 0, 0, 5), "u0 < u1"),
    (detections, "box2d", (0, 0, np.inf, 5), "u0 < u1|finite"),
    (detections, "instance", -1, "greater than or equal to 0"),
    (agent, "T_map_base", NAN_POSE, "finite"),
    (agent, "covariance", np.eye(3), r"\(6, 6\)"),
    (correction, "poses", [], "at least 1 item"),
    (correction, "poses", [{"stamp_ns": 4, "T_map_base": NAN_POSE}], "poses.*finite"),
    (correction, "poses", [{"stamp_ns": n, "T_map_base": np.eye(4)} for n in (2, 2)], "order of time"),
    (correction, "poses", [{"stamp_ns": 9, "T_map_base": np.eye(4)}], "none after stamp_ns 5, got 9"),
    (edge, "parent", "base_link", "two different frames"),
    (edge, "child", "", "at least 1 character"),
    (edge, "T_parent_child", NAN_POSE, "finite"),
    (robot, "footprint", [[0, 0], [1, 1]], "at least 3 corners"),
    (robot, "footprint", [[0, 0], [1, 0], [0, np.nan]], "finite"),
    (robot, "height_m", 0.0, "greater than 0"),
    (robot, "payload_kg", -1.0, "greater than or equal to 0"),
]


@pytest.mark.parametrize(("make", "field", "value", "expected"), BAD)
def test_a_bad_field_is_refused_in_one_line(make, field, value, expected):
    with pytest.raises(InvalidObservation, match=expected) as caught:
        make(**{field: value})
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 300
    assert message.count("(value: ") <= 1
    assert field in message or field in ("intrinsics", "box2d", "mask", "child", "parent")
    assert caught.value.code == "invalid_observation"
    assert isinstance(caught.value, MappingError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("model", OBSERVATIONS.values(), ids=lambda model: model.__name__)
def test_a_required_field_that_is_missing_is_named(model):
    with pytest.raises(InvalidObservation, match="missing; it is required"):
        model()


@pytest.mark.parametrize(
    ("classes", "expected"),
    [
        ({0: {"name": "wall"}}, "1 … 65535"),
        ({70000: {"name": "wall"}}, "1 … 65535"),
        ({"wall": {"name": "wall"}}, "integer"),
        ({1: {"name": ""}}, r"classes\.1\.name"),
        ({1: {"name": "wall", "color": (0, 0, 300)}}, r"classes\.1\.color.*0 … 255"),
        ({1: {"name": "wall", "kind": "person"}}, "'thing' or 'stuff'"),
    ],
)
def test_bad_classes_are_refused(classes, expected):
    with pytest.raises(InvalidObservation, match=expected):
        LabelSpace(classes=classes)


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ({"center": [0, 0, 0], "size": [1, 1, 0]}, "three lengths > 0 m"),
        ({"center": [0, 0, 0], "size": [1, 1]}, r"box3d\.size.*\(3,\)"),
        ({"center": [0, 0, np.nan], "size": [1, 1, 1]}, "center: expected finite"),
        ({"center": [0, 0, 0], "size": [1, 1, 1], "rotation_wxyz": [0, 0, 0, 0]}, "unit quaternion"),
    ],
)
def test_bad_boxes_are_refused_by_their_path(box, expected):
    with pytest.raises(InvalidObservation, match=expected) as caught:
        Detections(**SENSED, items=[{"label": "cup", "box2d": (0, 0, 1, 1)}, {"label": "cup", "box3d": box}])
    assert str(caught.value).startswith("Detections.items.1.box3d")


def test_poses_come_as_se3_matrix_or_wire_form():
    T = SE3.exp([1, 2, 3, 0.1, 0.2, 0.3])
    wire = {"translation": T.translation.tolist(), "rotation_wxyz": T.quaternion_wxyz.tolist()}
    assert agent(T_map_base=T).T_map_base == T
    assert agent(T_map_base=T.matrix).T_map_base == T
    assert agent(T_map_base=wire).T_map_base.isclose(T)


def test_intrinsics_come_as_a_model_or_a_dict():
    assert image(intrinsics=CameraIntrinsics(**CAMERA)) == image(intrinsics=CAMERA)


def test_arrays_are_read_only_and_not_copied():
    depth = np.ones((3, 4), np.float32)
    frozen = image(depth=depth)
    assert np.shares_memory(frozen.depth, depth)
    with pytest.raises(ValueError, match="read-only"):
        frozen.depth[0, 0] = 2.0
    assert depth.flags.writeable


def test_fields_cannot_be_set():
    with pytest.raises(ValueError, match="frozen"):
        image().stamp_ns = 3


def test_depth_in_millimetres_reads_in_metres():
    np.testing.assert_allclose(image(depth=np.full((3, 4), 1500, np.uint16)).depth_m, 1.5)


def test_a_depth_that_is_nan_was_not_measured():
    depth = np.ones((3, 4), np.float32)
    depth[1, 1] = np.nan
    assert image(depth=depth).depth_m[1, 1] == 0.0


def test_equality_compares_arrays():
    assert image() == image()
    assert image() != image(depth=np.zeros((3, 4), np.float32))
    assert image() != scan()


def test_an_empty_scan_is_a_scan():
    assert scan(points=np.zeros((0, 3), np.float32)).points.shape == (0, 3)


def test_colour_of_another_camera_has_its_own_size():
    color = {"color": np.zeros((6, 8, 3), np.uint8), "color_intrinsics": {**CAMERA, "width": 8, "height": 6}}
    assert image(**color).color.shape == (6, 8, 3)


def test_the_radius_of_a_robot_holds_its_footprint():
    assert robot(footprint=[[0.3, 0.4], [-0.3, 0.4], [0.0, -0.2]]).radius_m == pytest.approx(0.5)
