"""What was recorded comes back exactly; what was cut off or damaged says so."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapping.datasets import open_dataset
from mapping.datasets.recorded import RecordedDataset, Recorder
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import (
    AgentPose,
    Box3d,
    Detection,
    Detections,
    LabelSpace,
    PoseCorrection,
    RgbdImage,
    RobotDescription,
    Scan,
    Transform,
)

RNG = np.random.default_rng(3)
POSE = SE3.exp([1.0, 2.0, 3.0, 0.1, -0.2, 0.3])
SENSED = {"stamp_ns": 1_700_000_000_123_456_789, "robot": "r1", "sensor": "cam"}
CAMERA = {"fx": 5.25, "fy": 5.1, "cx": 4.0, "cy": 3.0, "width": 8, "height": 6}

EVERYTHING = [
    LabelSpace(
        classes={1: {"name": "wall", "kind": "stuff", "color": (1, 2, 3)}, 7: {"name": "cup", "parent": "dish"}}
    ),
    LabelSpace(classes={}, robot="r1", sensor="cam"),
    RobotDescription(robot="r1", footprint=[[0.2, 0.1], [-0.2, 0.1], [0.0, -0.3]], reach_m=0.8),
    Transform(stamp_ns=0, robot="r1", parent="base_link", child="cam_optical", T_parent_child=POSE, static=True),
    AgentPose(stamp_ns=1, robot="r1", T_map_base=POSE, covariance=np.diag([1e-4] * 6)),
    PoseCorrection(stamp_ns=4, robot="r1", poses=[{"stamp_ns": 1, "T_map_base": POSE, "T_map_base_before": POSE}]),
    RgbdImage(**SENSED, depth=RNG.integers(0, 5000, (6, 8)).astype(np.uint16), intrinsics=CAMERA),
    RgbdImage(
        **SENSED,
        depth=RNG.uniform(0, 5, (6, 8)).astype(np.float32),
        intrinsics=CAMERA,
        T_map_camera=POSE,
        covariance=np.eye(6, dtype=np.float32),
        color=RNG.integers(0, 255, (12, 16, 3)).astype(np.uint8),
        color_intrinsics={**CAMERA, "width": 16, "height": 12},
        T_depth_color=POSE.inverse(),
        labels=RNG.integers(0, 9, (6, 8)).astype(np.uint16),
        instances=RNG.integers(0, 2**32 - 1, (6, 8)).astype(np.uint32),
        label_confidence=RNG.uniform(0, 1, (6, 8)).astype(np.float32),
    ),
    Scan(**SENSED, points=np.zeros((0, 3), np.float32)),
    Scan(
        **SENSED,
        points=RNG.normal(size=(50, 3)).astype(np.float32),
        T_map_sensor=POSE,
        labels=np.arange(50, dtype=np.uint16),
        instances=np.arange(50, dtype=np.uint32),
        intensity=RNG.uniform(size=50).astype(np.float32),
        time_offset_ns=np.arange(50, dtype=np.int64) - 25,
    ),
    Detections(
        **SENSED,
        items=[
            Detection(label="cup", confidence=0.1 + 0.2, box2d=(0.1, 0.2, 5, 6), instance=9),
            Detection(
                label="tv", mask=RNG.uniform(size=(6, 8)) > 0.5, attributes={"$odd": [1, (2.5, None)], "on": True}
            ),
            Detection(label="sofa", box3d=Box3d(center=[0, 1, 2], size=[1, 2, 3], rotation_wxyz=[0, 1, 0, 0])),
        ],
    ),
]


def record(path, observations=EVERYTHING):
    with Recorder(path, name="a test", max_range_m=5.0, notes={"seed": 7}) as recorder:
        for observation in observations:
            recorder.write(observation)
    return path


def test_every_kind_of_observation_comes_back_exactly(tmp_path):
    dataset = open_dataset(record(tmp_path / "run"))
    assert isinstance(dataset, RecordedDataset)
    assert len(dataset) == len(EVERYTHING)
    for _ in range(2):
        for ours, theirs in zip(dataset, EVERYTHING, strict=True):
            assert type(ours) is type(theirs)
            assert ours == theirs


def test_the_header_is_kept(tmp_path):
    dataset = open_dataset(record(tmp_path / "run"))
    assert dataset.name == "a test"
    assert dataset.max_range_m == 5.0
    assert dataset.notes == {"seed": 7}


@settings(max_examples=20, deadline=None)
@given(
    depth=arrays(np.float32, (6, 8), elements=st.floats(0, 100, width=32) | st.just(np.nan)), pose=st.integers(0, 99)
)
def test_pixels_and_poses_come_back_to_the_last_bit(tmp_path_factory, depth, pose):
    T = SE3.exp(np.random.default_rng(pose).normal(size=6))
    image = RgbdImage(**SENSED, depth=depth, intrinsics=CAMERA, T_map_camera=T)
    (again,) = open_dataset(record(tmp_path_factory.mktemp("run"), [image]))
    assert again.depth.tobytes() == image.depth.tobytes()
    assert again.T_map_camera == T


def test_a_smooth_depth_image_shrinks(tmp_path):
    depth = (1000 + np.add.outer(np.arange(480), np.arange(640)) // 2).astype(np.uint16)
    camera = {**CAMERA, "width": 640, "height": 480}
    record(tmp_path / "run", [RgbdImage(**SENSED, depth=depth, intrinsics=camera)])
    assert (tmp_path / "run" / "arrays.bin").stat().st_size < depth.nbytes / 4


def test_a_recording_is_not_overwritten(tmp_path):
    record(tmp_path / "run")
    with pytest.raises(DatasetError, match="holds a recording already"):
        Recorder(tmp_path / "run")


def test_only_observations_are_recorded(tmp_path):
    with Recorder(tmp_path / "run") as recorder, pytest.raises(InvalidParameter, match="expected one of"):
        recorder.write(Detection(label="cup", box2d=(0, 0, 1, 1)))


def test_a_recording_that_is_being_written_can_be_read(tmp_path):
    recorder = Recorder(tmp_path / "run")
    for observation in EVERYTHING[:5]:
        recorder.write(observation)
    assert len(open_dataset(tmp_path / "run")) == 5
    recorder.close()


@pytest.mark.parametrize("name", ["observations.jsonl", "arrays.bin"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_recording_that_was_cut_off_says_so_and_keeps_what_is_whole(tmp_path, name, share):
    path = record(tmp_path / "run")
    content = (path / name).read_bytes()
    (path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(DatasetError, match=r"was cut off: \d+ of 11 observations are whole") as caught:
        open_dataset(path)
    assert "partial=True" in caught.value.hint
    whole = open_dataset(path, partial=True)
    assert len(whole) < len(EVERYTHING)
    assert list(whole) == EVERYTHING[: len(whole)]


def test_damaged_arrays_are_found(tmp_path):
    path = record(tmp_path / "run")
    content = bytearray((path / "arrays.bin").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (path / "arrays.bin").write_bytes(content)
    with pytest.raises(DatasetError, match=r"observation \d+: damaged"):
        list(open_dataset(path))


def test_a_damaged_line_is_found(tmp_path):
    path = record(tmp_path / "run")
    lines = (path / "observations.jsonl").read_bytes().splitlines(keepends=True)
    lines[3] = b"[" + lines[3][1:]
    (path / "observations.jsonl").write_bytes(b"".join(lines))
    with pytest.raises(DatasetError, match="observation 3: damaged"):
        list(open_dataset(path))


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("{", "damaged"),
        (json.dumps({"format": "something", "version": 1}), "expected format 'scenegraph-recording'"),
        (json.dumps({"format": "scenegraph-recording", "version": 99}), "version 99 is not known"),
    ],
)
def test_a_foreign_header_is_refused(tmp_path, header, expected):
    path = record(tmp_path / "run")
    (path / "recording.json").write_text(header)
    with pytest.raises(DatasetError, match=expected):
        open_dataset(path)


@pytest.mark.parametrize("name", ["recording.json", "observations.jsonl", "arrays.bin"])
def test_a_missing_file_is_named(tmp_path, name):
    path = record(tmp_path / "run")
    (path / name).unlink()
    with pytest.raises(DatasetError, match=f"looks like a recording of this program, but lacks {name}"):
        open_dataset(path)
