"""Bad input to a real server with a real world: a clear problem each time, the server goes on, nothing is lost."""

from __future__ import annotations

import itertools
import json
import random
import time

import cbor2
import numpy as np
import pytest
import zenoh

from mapping.observations import LabelSpace
from scenegraph.service import Client, Server
from scenegraph.service.errors import RemoteProblem, UnknownWorld
from scenegraph.service.messages import Refusal, decode, plain
from scenegraph.service.session import session_config
from scenegraph.world import World
from tests.support.net import eventually, free_endpoint, small_image

STAMPS = itertools.count(1)
INPUT = "scenegraph/v1/home/in/spot/camera/rgbd"


class Home:
    """A running server, a client, and a session that can send anything."""

    def __init__(self, server: Server, client: Client, session: zenoh.Session) -> None:
        self.server, self.client, self.session = server, client, session
        self.refusals: list[Refusal] = []
        session.declare_subscriber("scenegraph/v1/home/problems", self._remember)

    def _remember(self, sample: zenoh.Sample) -> None:
        self.refusals.append(decode(sample.payload.to_bytes(), "Refusal", str(sample.encoding)))

    def sent(self, fields: dict) -> tuple[Refusal, dict]:
        """What the server says to an image that is put, and to one that is sent as a query."""
        data = cbor2.dumps(fields, default=tag_array)
        return self.put(INPUT, data, "application/cbor;RgbdImage"), self.ask(INPUT, data, "application/cbor;RgbdImage")

    def put(self, where: str, data: bytes, encoding: str) -> Refusal:
        before = len(self.refusals)
        self.session.put(where, data, encoding=encoding)
        assert eventually(lambda: len(self.refusals) > before), "nothing came on problems"
        return self.refusals[-1]

    def ask(self, where: str, data: bytes, encoding: str) -> dict:
        [reply] = self.session.get(where, payload=data, encoding=encoding, timeout=10.0)
        assert reply.err is not None
        return decode(reply.err.payload.to_bytes(), "Problem", str(reply.err.encoding)).model_dump()


def tag_array(encoder: cbor2.CBOREncoder, array: np.ndarray) -> None:
    tag = {"float32": 85, "float64": 86, "uint16": 69, "uint32": 70, "uint8": 64}[array.dtype.name]
    encoder.encode(cbor2.CBORTag(40, [list(array.shape), cbor2.CBORTag(tag, array.tobytes())]))


@pytest.fixture(scope="module")
def running():
    with (
        World() as world,
        Server(world, "home", endpoint=free_endpoint()) as server,
        Client("home", server.endpoint) as client,
    ):
        client.integrate(LabelSpace(classes={1: {"name": "wall", "kind": "stuff"}, 2: {"name": "cup"}}))
        config = session_config("client", connect=[server.endpoint], message_bytes=1 << 27)
        with zenoh.open(config) as session:
            yield Home(server, client, session)


@pytest.fixture
def home(running):
    """After each test: a good image is mapped, the others are still counted, and a question is answered."""
    before = taken(running)
    yield running
    reply = running.client.integrate(small_image(next(STAMPS)))
    assert reply.accepted
    assert taken(running) > before
    answers = running.client.ask("instance_of(X, cup)")
    assert answers.problem is None
    row = running.client.status().inputs["spot/camera/rgbd"]
    assert row.received == row.taken + row.dropped + row.refused + row.waiting


def taken(home: Home) -> int:
    row = home.client.status().inputs.get("spot/camera/rgbd")
    return row.taken if row else 0


def fields(**changes: object) -> dict:
    return {**plain(small_image(next(STAMPS))), **changes}


# -- observations --------------------------------------------------------------------------------------------


def test_wrong_shapes_are_told(home):
    for problem in map(as_dict, home.sent(fields(labels=np.zeros((8, 9), np.uint16)))):
        assert problem["code"] == "invalid_observation"
        assert "labels has shape (8, 9), expected that of depth, (8, 8)" in problem["message"]


def test_a_nan_pose_is_told(home):
    bad = {"translation": [0.0, float("nan"), 0.0], "rotation_wxyz": [1.0, 0.0, 0.0, 0.0]}
    for problem in map(as_dict, home.sent(fields(T_map_camera=bad))):
        assert problem["code"] == "invalid_observation"
        assert "RgbdImage.T_map_camera: expected finite numbers" in problem["message"]


def test_a_negative_depth_is_told(home):
    depth = np.full((8, 8), 2.0, np.float32)
    depth[3, 4] = -1.5
    for problem in map(as_dict, home.sent(fields(depth=depth))):
        assert problem["code"] == "invalid_observation"
        assert "RgbdImage.depth: expected depths ≥ 0 m (0 = not measured), got -1.5" in problem["message"]


def test_a_wrong_dtype_is_told(home):
    for problem in map(as_dict, home.sent(fields(depth=np.full((8, 8), 2.0, np.float64)))):
        assert "RgbdImage.depth: expected float32 or uint16" in problem["message"]


def test_an_image_without_a_pose_that_is_known_is_told(home):
    without = fields(sensor="elsewhere")
    del without["T_map_camera"]
    where = "scenegraph/v1/home/in/spot/elsewhere/rgbd"
    data = cbor2.dumps(without, default=tag_array)
    assert home.ask(where, data, "application/cbor")["code"] == "pose_unavailable"
    assert home.put(where, data, "application/cbor").code == "pose_unavailable"


def test_garbage_bytes_are_told(home):
    random.seed(5)
    for encoding in ("application/cbor;RgbdImage", "application/json;RgbdImage", "application/x-python-pickle"):
        data = random.randbytes(500)
        problem = home.ask(INPUT, data, encoding)
        assert problem["code"] == "invalid_message"
        assert problem["message"]
    assert home.put(INPUT, b"\xff" * 100, "application/cbor;RgbdImage").code == "invalid_message"


def test_a_truncated_image_is_told(home):
    data = cbor2.dumps(fields(), default=tag_array)
    assert "too early" in home.ask(INPUT, data[: len(data) // 2], "application/cbor;RgbdImage")["message"]


def test_a_cause_is_told_once_and_then_counted(home):
    depth = np.full((8, 8), -3.0, np.float32)
    data = cbor2.dumps(fields(depth=depth, sensor="broken"), default=tag_array)
    where = "scenegraph/v1/home/in/spot/broken/rgbd"
    first = home.put(where, data, "application/cbor;RgbdImage")
    assert first.count == 1
    for _ in range(5):
        home.session.put(where, data, encoding="application/cbor;RgbdImage")
    count = lambda: home.client.status().inputs["spot/broken/rgbd"]  # noqa: E731
    assert eventually(lambda: count().received == 6 and count().waiting == 0)
    row = count()
    assert row.refused + row.dropped == 6
    assert len([refusal for refusal in home.refusals if refusal.source == where]) == 1
    [known] = [problem for problem in home.client.problems().problems if problem.source == where]
    assert known.count == row.refused


# -- keys ----------------------------------------------------------------------------------------------------


def test_an_unknown_world_is_told(home):
    with pytest.raises(UnknownWorld, match="nobody serves the world 'hone'") as caught:
        Client("hone", home.server.endpoint)
    assert "did you mean 'home'? worlds served: home" in caught.value.hint


def test_an_unknown_key_is_told(home):
    problem = home.ask("scenegraph/v1/home/aks", b"{}", "application/json")
    assert problem["code"] == "unknown_key"
    assert problem["hint"] == "did you mean scenegraph/v1/home/ask?"
    refusal = home.put("scenegraph/v1/home/in/spot/camera/rgdb", b"{}", "application/json")
    assert refusal.code == "unknown_key"
    assert refusal.hint == "did you mean …/rgbd?"
    assert home.put("scenegraph/v1/home/nonsense", b"{}", "application/json").code == "unknown_key"


def test_a_layer_that_does_not_exist_is_told(home):
    problem = home.ask("scenegraph/v1/home/map/tsfd/query", b"{}", "application/json")
    assert problem["code"] == "unknown_key"


# -- goals ---------------------------------------------------------------------------------------------------


def test_a_goal_with_a_syntax_error_is_told(home):
    answers = home.client.ask("near(X, oven")
    assert answers.truth == "unknown"
    assert answers.problem is not None
    assert "syntax" in f"{answers.problem.code} {answers.problem.message}".lower()


def test_an_endless_goal_is_stopped_in_time_and_told(home):
    began = time.monotonic()
    answers = home.client.ask("repeat, fail", timeout_s=0.5)
    assert time.monotonic() - began < 5.0
    assert answers.truth == "unknown"
    assert answers.problem is not None


def test_a_goal_that_would_run_a_program_is_refused(home, tmp_path):
    trace = tmp_path / "trace"
    answers = home.client.ask(f'shell("touch {trace}")')
    assert answers.truth == "unknown"
    assert answers.problem is not None
    assert not trace.exists()


def test_an_unknown_name_is_told_with_the_nearest(home):
    answers = home.client.ask("near(X, cpu)")
    assert answers.problem is not None
    assert answers.problem.code == "unknown_name"
    assert "cup" in (answers.problem.hint or "") + answers.problem.message


def test_a_statement_that_is_none_is_told(home):
    try:
        told = home.client.tell("abolish(everything)")
        problem = told.problem
        assert not told.accepted
    except RemoteProblem as error:
        problem = error.problem
    assert problem is not None
    assert problem.message


# -- everything at once --------------------------------------------------------------------------------------


def test_a_storm_of_garbage_to_every_key_leaves_the_server_standing(home):
    rng = random.Random(11)
    good = cbor2.dumps(fields(), default=tag_array)
    paths = ["ask", "where", "tell", "graph", "status", "schema", "problems", "map/tsdf", "map/tsdf/query", "nonsense"]
    paths += [
        "in/spot/camera/rgbd",
        "in/spot/camera/scan",
        "in/spot/base/pose",
        "in/spot/description",
        "in/x/y/labelspace",
    ]
    encodings = ["", "application/cbor", "application/json", "application/json;AskRequest", "image/png"]
    for n in range(600):
        path, encoding = rng.choice(paths), rng.choice(encodings)
        data = rng.randbytes(rng.randrange(200)) if n % 3 else mutated(good, rng)
        if n % 2:
            home.session.put(f"scenegraph/v1/home/{path}", data, encoding=encoding)
        else:
            replies = list(
                home.session.get(f"scenegraph/v1/home/{path}", payload=data, encoding=encoding, timeout=20.0)
            )
            assert len(replies) == 1, path
    assert eventually(lambda: not any(home.client.status().waiting.values()))


def mutated(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data[: rng.randrange(1, len(data) + 1)])
    for _ in range(rng.randrange(5)):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


def as_dict(problem: Refusal | dict) -> dict:
    return problem.model_dump() if isinstance(problem, Refusal) else problem


def test_a_message_that_is_too_large_is_refused(home):
    large = json.dumps({"goal": "x" * 100_000})
    assert "AskRequest.goal" in home.ask("scenegraph/v1/home/ask", large.encode(), "application/json")["message"]
