"""Messages: what is written is read, in both forms; what is not a message is refused, before it costs anything."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import pickle
import struct
import tracemalloc

import cbor2
import numpy as np
import pytest
import zstandard
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from mapping.errors import InvalidObservation
from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import (
    AgentPose,
    Box3d,
    CorrectedPose,
    Detection,
    Detections,
    LabelSpace,
    PoseCorrection,
    RgbdImage,
    RobotDescription,
    Scan,
    Transform,
)
from scenegraph.errors import Problem
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.service import cbor, codec
from scenegraph.service.arrays import DTYPES, Limits
from scenegraph.service.errors import InvalidMessage
from scenegraph.service.messages import (
    MODELS,
    AskReply,
    AskRequest,
    MapValues,
    NodeBinding,
    ValueBinding,
    decode,
    encode,
    encoding_of,
    schema,
)

FORMS = ("cbor", "json")
RNG = np.random.default_rng(3)
CAMERA = CameraIntrinsics(fx=500.0, fy=501.0, cx=3.5, cy=2.5, width=8, height=6)
POSE = SE3.exp([1.0, 2.0, 3.0, 0.1, -0.2, 0.3])
SHIFT = SE3(np.eye(3), [1.0, 2.0, 3.0])

OBSERVATIONS = (
    RgbdImage(
        stamp_ns=1_700_000_000_123_456_789,
        robot="spot",
        sensor="front",
        depth=RNG.random((6, 8), dtype=np.float32),
        intrinsics=CAMERA,
        T_map_camera=POSE,
        covariance=np.eye(6) * 1e-4,
        color=RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8),
        labels=RNG.integers(0, 9, (6, 8), dtype=np.uint16),
        instances=RNG.integers(0, 9, (6, 8), dtype=np.uint32),
        label_confidence=RNG.random((6, 8), dtype=np.float32),
    ),
    RgbdImage(stamp_ns=0, robot="a", sensor="b", depth=np.full((6, 8), 1500, np.uint16), intrinsics=CAMERA),
    Scan(
        stamp_ns=5,
        robot="spot",
        sensor="lidar",
        points=RNG.random((70, 3), dtype=np.float32),
        T_map_sensor=POSE,
        labels=np.arange(70, dtype=np.uint16),
        intensity=np.ones(70, np.float32),
        time_offset_ns=np.arange(70, dtype=np.int64),
    ),
    Scan(stamp_ns=5, robot="spot", sensor="lidar", points=np.empty((0, 3), np.float32)),
    Detections(
        stamp_ns=7,
        robot="spot",
        sensor="front",
        items=(
            Detection(label="TV", confidence=0.5, box2d=(1.0, 2.0, 3.0, 4.0), attributes={"color": "black"}),
            Detection(label="cup", mask=RNG.random((6, 8)) > 0.5),
            Detection(label="oven", box3d=Box3d(center=[1.0, 2.0, 3.0], size=[1.0, 1.0, 1.0]), instance=4),
        ),
    ),
    AgentPose(stamp_ns=7, robot="spot", T_map_base=POSE),
    PoseCorrection(
        stamp_ns=9,
        robot="spot",
        poses=(
            CorrectedPose(stamp_ns=3, T_map_base=SHIFT),
            CorrectedPose(stamp_ns=8, T_map_base=SHIFT, T_map_base_before=SHIFT.inverse()),
        ),
    ),
    Transform(stamp_ns=7, robot="spot", parent="odom", child="base_link", T_parent_child=POSE, static=True),
    LabelSpace(
        classes={1: {"name": "wall", "kind": "stuff", "color": (1, 2, 3)}, 9: {"name": "TV", "parent": "thing"}}
    ),
    RobotDescription(robot="spot", footprint=[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], height_m=0.8),
)


def ids(value: object) -> str:
    return type(value).__name__


# -- round trips ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("observation", OBSERVATIONS, ids=ids)
def test_an_observation_comes_back_as_it_was_sent(observation, form, compress):
    data = encode(observation, form, compress=compress)
    back = decode(data, type(observation).__name__, encoding_of(observation, form))
    if hasattr(observation, "T_map_camera") and observation.T_map_camera is not None:
        assert back.T_map_camera.isclose(observation.T_map_camera, 1e-12)
        back = back.model_copy(update={"T_map_camera": observation.T_map_camera})
    for name in ("T_map_sensor", "T_map_base", "T_parent_child"):
        if getattr(observation, name, None) is not None:
            assert getattr(back, name).isclose(getattr(observation, name), 1e-12)
            back = back.model_copy(update={name: getattr(observation, name)})
    assert back == observation


@pytest.mark.parametrize("form", FORMS)
def test_what_is_asked_and_replied_comes_back_as_it_was_sent(form):
    graph = SceneGraph()
    changes = GraphChanges()
    for name in ("cup_1", "table_1"):
        changes.put(Node(id=name, layer="object", label=name, position=(1, 2, 3), first_seen_ns=1, last_seen_ns=2))
    changes.put(Edge(relation="on", source="cup_1", target="table_1", value=0.1, first_seen_ns=1, last_seen_ns=2))
    delta = graph.commit(changes, 3)
    removal = GraphChanges()
    removal.delete_node("cup_1", "gone")
    reply = AskReply(
        truth="true",
        answers=({"X": NodeBinding(node="cup_1"), "N": ValueBinding(value=3)},),
        revision=1,
        elapsed_ms=0.5,
        problem=Problem(code="timeout", message="late"),
        nodes=tuple(graph.nodes()),
    )
    values = MapValues(
        layer="tsdf", values=np.array([0.5, 0.0], np.float32), known=np.array([True, False]), confidence=None
    )
    for message in (
        AskRequest(goal="cup(X)"),
        reply,
        delta,
        graph.snapshot(),
        graph.commit(removal, 4),
        graph.nodes()[0],
    ):
        assert decode(encode(message, form), type(message).__name__, encoding_of(message, form)) == message
    back = decode(encode(values, form), "MapValues")
    assert back.values.tolist() == [0.5, 0.0]
    assert back.known.tolist() == [True, False]


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**64), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary(max_size=300),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text() | st.integers(0, 2**32), inner, max_size=5),
    max_leaves=20,
)


@given(PLAIN)
def test_any_plain_value_survives_cbor_and_is_what_another_library_reads(value):
    data = cbor.dumps(value)
    assert cbor.loads(data) == value
    assert cbor2.loads(data) == value


@given(PLAIN, st.booleans())
def test_what_another_library_writes_is_read(value, indefinite):

    assert cbor.loads(cbor2.dumps(value, indefinite_containers=indefinite)) == value


def test_short_floats_and_pieced_strings_are_read():
    assert cbor.loads(bytes.fromhex("f93c00")) == 1.0
    assert cbor.loads(bytes.fromhex("fa3f800000")) == 1.0
    assert cbor.loads(bytes.fromhex("7f6161626262ff")) == "abb"
    assert cbor.loads(bytes.fromhex("f7")) is None
    assert cbor.loads(bytes.fromhex("d9d9f7a16161f5")) == {"a": True}


@settings(max_examples=60)
@given(
    hnp.arrays(
        st.sampled_from(sorted(DTYPES.values(), key=str)),
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5),
    ),
    st.booleans(),
    st.sampled_from(FORMS),
    st.integers(0, 8),
)
def test_any_array_survives_both_forms_wherever_it_lies_in_the_message(array, compress, form, padding):
    data = codec.dumps({"pad": "x" * padding, "a": array}, form, compress=compress)
    back = codec.loads(data, form)["a"]
    assert back.dtype == array.dtype
    assert back.shape == array.shape
    assert back.tobytes() == array.tobytes()
    assert back.flags.aligned
    assert not back.flags.writeable


def test_an_array_is_tag_40_with_a_little_endian_typed_array():
    tag = cbor2.loads(cbor.dumps(np.arange(6, dtype=np.uint16).reshape(2, 3)))
    assert tag.tag == 40
    shape, values = tag.value
    assert list(shape) == [2, 3]
    assert values.tag == 69
    assert values.value == struct.pack("<6H", *range(6))


def test_big_endian_and_flat_typed_arrays_are_read_too():
    array = np.array([[1.5, 2.0]], ">f4")
    data = cbor2.dumps(cbor2.CBORTag(40, [[1, 2], cbor2.CBORTag(81, array.tobytes())]))
    assert cbor.loads(data).tolist() == [[1.5, 2.0]]
    assert cbor.loads(data).dtype == np.dtype("float32")
    assert cbor.loads(cbor2.dumps(cbor2.CBORTag(64, b"\1\2"))).tolist() == [1, 2]


@pytest.mark.parametrize(
    ("codec_name", "array"),
    [
        ("png", RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)),
        ("png", RNG.integers(0, 256, (5, 7), dtype=np.uint8)),
        ("png", RNG.integers(0, 65536, (5, 7), dtype=np.uint16)),
        ("jpeg", np.full((16, 16, 3), 90, np.uint8)),
    ],
)
def test_pictures_are_read(codec_name, array):
    back = cbor.loads(cbor.dumps(form_of_picture(codec_name, array)))
    assert back.dtype == array.dtype
    assert np.abs(back.astype(int) - array).max() <= (2 if codec_name == "jpeg" else 0)


def form_of_picture(codec_name: str, array: np.ndarray) -> dict:
    file = io.BytesIO()
    Image.fromarray(array).save(file, codec_name)
    return {"shape": list(array.shape), "dtype": array.dtype.str, "codec": codec_name, "data": file.getvalue()}


def test_json_may_hold_nested_lists_for_small_arrays():
    text = b'{"stamp_ns": 1, "robot": "a", "sensor": "b", "points": [[1, 2, 3], [4, 5, 6.5]]}'
    scan = decode(text, "Scan")
    assert scan.points.dtype == np.float32
    assert scan.points[1].tolist() == [4.0, 5.0, 6.5]


# -- refusals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("observation", OBSERVATIONS, ids=ids)
@pytest.mark.parametrize("form", FORMS)
def test_a_truncated_message_is_refused_wherever_it_ends(observation, form):
    data = encode(observation, form)
    for end in sorted({*range(0, len(data), max(1, len(data) // 150)), len(data) - 1}):
        with pytest.raises(InvalidMessage):
            decode(data[:end], type(observation).__name__, encoding_of(observation, form))


@settings(max_examples=300)
@given(
    st.binary(max_size=200),
    st.sampled_from(sorted(MODELS)),
    st.sampled_from(("application/cbor", "application/json", "")),
)
def test_garbage_is_refused_with_one_clear_error(data, model, encoding):
    assume(data.strip() not in (b"{}", b"\xa0"))  # an empty mapping may mean the defaults
    with pytest.raises((InvalidMessage, InvalidObservation)) as caught:
        decode(data, model, encoding)
    assert str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.parametrize("form", FORMS)
def test_an_empty_or_foreign_mapping_is_refused_or_means_the_defaults(model, form):
    for value in ({"nonsense": 1}, {"code": 3}, {"revision": -1, "stamp_ns": 0}):
        with pytest.raises((InvalidMessage, InvalidObservation)):
            decode(codec.dumps(value, form), model, f"application/{form}")


@settings(max_examples=200)
@given(st.data())
def test_a_message_with_a_few_bytes_changed_is_read_or_refused(data):
    message = bytearray(encode(OBSERVATIONS[0], "cbor"))
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(InvalidMessage, InvalidObservation):
        decode(bytes(message), "RgbdImage", "application/cbor;RgbdImage")


HUGE = 1 << 40


@pytest.mark.parametrize(
    "data",
    [
        b"\x9b" + struct.pack(">Q", HUGE),
        b"\xbb" + struct.pack(">Q", HUGE),
        b"\x5b" + struct.pack(">Q", HUGE),
        b"\x7b" + struct.pack(">Q", HUGE),
        cbor2.dumps(cbor2.CBORTag(40, [[HUGE, HUGE], cbor2.CBORTag(85, b"")])),
        cbor2.dumps({"shape": [65536, 65536], "dtype": "<f8", "codec": "zstd", "data": b""}),
        cbor2.dumps(
            {"shape": [4096, 4096, 3], "dtype": "|u1", "codec": "zstd", "data": zstandard.compress(bytes(1 << 26))}
        ),
        cbor2.dumps({"shape": [2, 2], "dtype": "<f4", "codec": "zstd", "data": zstandard.compress(bytes(1 << 26))}),
        cbor2.dumps(
            {
                "shape": [4, 4],
                "dtype": "|u1",
                "codec": "png",
                "data": form_of_picture("png", np.zeros((4000, 4000), np.uint8))["data"],
            }
        ),
        cbor2.dumps({"shape": [1 << 24], "dtype": "|u1", "codec": "raw", "data": b""}),
    ],
)
def test_a_declared_size_is_checked_before_memory_is_taken(data):
    tracemalloc.start()
    try:
        with pytest.raises(InvalidMessage):
            cbor.loads(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20


def test_a_bomb_of_many_arrays_meets_the_limit_of_the_whole_message():
    bomb = {"shape": [1 << 20], "dtype": "|u1", "codec": "zstd", "data": zstandard.compress(bytes(1 << 20))}
    with pytest.raises(InvalidMessage, match="bytes in a message"):
        cbor.loads(cbor.dumps([bomb] * 20), Limits(decoded_bytes=10 << 20))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\x81" * 5000 + b"\x00", "within each other"),
        (cbor2.dumps({"a": cbor2.CBORTag(28, [1])}), "tag 28"),
        (cbor2.dumps(2**70), "tag 2"),
        (cbor2.dumps(cbor2.CBORTag(35, "(a+)+")), "tag 35"),
        (b"\xa2\x61a\x00\x61a\x01", "twice"),
        (b"\xff", "break"),
        (b"\x81\xff", "break"),
        (b"\xa1\x61a\xff", "break"),
        (b"\x00\x00", "after it"),
        (b"\x61\xff", "UTF-8"),
        (b"\xa1\xf6\x00", "keys"),
        (b"\x1c", "byte 0x1c"),
        (b"", "too early"),
        (pickle.dumps({"robot": "a"}), "at byte|byte 0x|ends too early|bytes after it"),
        (cbor2.dumps(cbor2.CBORTag(40, [[2, 2], cbor2.CBORTag(85, bytes(12))])), "does not fit 3 elements"),
        (cbor2.dumps(cbor2.CBORTag(85, b"123")), "whole elements"),
        (cbor2.dumps({"shape": [3], "dtype": "|b1", "codec": "raw", "data": b"\0\1\2"}), "truth values"),
        (cbor2.dumps({"shape": [3], "dtype": "|O8", "codec": "raw", "data": bytes(24)}), "dtype"),
        (cbor2.dumps({"shape": [3], "dtype": "|u1", "codec": "lzma", "data": b"abc"}), "codec"),
        (cbor2.dumps({"shape": [3], "dtype": "|u1", "codec": "zstd", "data": b"abc"}), "zstd"),
        (cbor2.dumps({"shape": [3, 3], "dtype": "|u1", "codec": "png", "data": b"abc"}), "png"),
        (cbor2.dumps({"shape": [-1], "dtype": "|u1", "codec": "raw", "data": b""}), "shape"),
    ],
)
def test_what_cbor_allows_but_no_message_needs_is_refused(data, said):
    with pytest.raises(InvalidMessage, match=said):
        cbor.loads(data)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"x": NaN}', "finite"),
        ('{"a": 1, "a": 2}', "twice"),
        ("[" * 100_000, "within each other"),
        ("[" * 40 + "]" * 40, "within each other"),
        ('{"a": }', "JSON"),
        (json.dumps({"a": {"shape": [1], "dtype": "<f4", "codec": "raw", "data": "%%"}}), "a.data"),
        (json.dumps({"a": {"shape": [1], "dtype": "<f4", "codec": "raw", "data": "A" * 999}}), "a.data"),
    ],
)
def test_what_is_not_json_for_us_is_refused(text, said):
    with pytest.raises(InvalidMessage, match=said):
        codec.loads(text.encode(), "json")


def test_a_message_beyond_the_limit_is_refused_unread():
    for form in FORMS:
        with pytest.raises(InvalidMessage, match="at most 10 bytes"):
            codec.loads(b"\x00" * 11, form, Limits(message_bytes=10))


def test_the_error_names_the_field_and_carries_a_code():
    data = cbor.dumps({"items": [{"mask": {"shape": [2], "dtype": "|b1", "codec": "raw", "data": b"1"}}]})
    with pytest.raises(InvalidMessage) as caught:
        decode(data, "Detections")
    assert caught.value.code == "invalid_message"
    assert caught.value.field == "items.0.mask.data"
    with pytest.raises(InvalidMessage, match=r"AskRequest\.limit"):
        decode(b'{"goal": "a", "limit": -1}', "AskRequest")
    with pytest.raises(InvalidMessage, match=r"AskRequest\.gaol"):
        decode(b'{"goal": "a", "gaol": 1}', "AskRequest")
    with pytest.raises(InvalidMessage, match=r"AskRequest\.goal"):
        decode(b"{}", "AskRequest")


def test_a_wrong_dtype_is_refused_and_named():
    wrong = {"stamp_ns": 1, "robot": "a", "sensor": "b", "points": np.zeros((4, 3), np.float64)}
    with pytest.raises(InvalidObservation, match=r"Scan\.points.*float32.*float64"):
        decode(cbor.dumps(wrong), "Scan")


def test_the_encoding_must_name_the_model_that_is_expected_there():
    data = encode(AskRequest(goal="a"), "json")
    assert decode(data, "AskRequest", "application/json") == decode(data, "AskRequest", "") == AskRequest(goal="a")
    with pytest.raises(InvalidMessage, match="encoding: expected TellRequest"):
        decode(data, "TellRequest", "application/json;AskRequest")
    with pytest.raises(InvalidMessage, match="encoding: expected application/cbor"):
        decode(data, "AskRequest", "application/python-serialized-object")


# -- schemas -------------------------------------------------------------------------------------------------


def references(value: object):
    if isinstance(value, dict):
        for name, item in value.items():
            if name == "$ref":
                yield item
            else:
                yield from references(item)
    elif isinstance(value, list):
        for item in value:
            yield from references(item)


def test_there_is_a_schema_of_every_model_and_every_reference_in_it_leads_somewhere():
    document = json.loads(json.dumps(schema()))
    assert set(MODELS) <= set(document["$defs"])
    assert "#/$defs/Array" in set(references(document["$defs"]["RgbdImage"]))
    for reference in references(document):
        assert reference.removeprefix("#/$defs/") in document["$defs"]
    assert {row["key"] for row in document["keys"]} >= {
        "scenegraph/v1/{world}/ask",
        "scenegraph/v1/{world}/graph/delta",
    }


@pytest.mark.parametrize("observation", OBSERVATIONS, ids=ids)
def test_the_schema_knows_every_field_that_is_sent(observation):
    fields = schema()["$defs"][type(observation).__name__]["properties"]
    sent = json.loads(encode(observation, "json"))
    assert set(sent) <= set(fields)
    assert set(sent) == set(cbor.loads(encode(observation, "cbor")))


def test_base64_in_json_is_the_bytes_of_cbor():
    image = OBSERVATIONS[0]
    form = json.loads(encode(image, "json"))["labels"]
    assert form["shape"] == [6, 8]
    assert form["dtype"] == "<u2"
    assert base64.b64decode(form["data"]) == image.labels.tobytes()
