"""`scenegraph serve` as a process of its own, a robot that publishes a room, and clients that ask about it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from mapping.observations import LabelSpace, RgbdImage
from scenegraph.service import Client
from scenegraph.service.errors import ServerTimeout, ServerUnreachable
from tests.support.net import eventually, free_endpoint
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

CLASSES = LabelSpace(classes={1: {"name": "wall", "kind": "stuff"}, 2: {"name": "ball"}})


def views() -> Iterator[RgbdImage]:
    """A room with a ball in it, seen from all sides."""
    room = Room()
    for n, T_map_camera in enumerate(TOUR[:12]):
        depth = room.depth(T_map_camera, SMALL_CAMERA)
        p_map = T_map_camera @ SMALL_CAMERA.backproject(depth).reshape(-1, 3)
        on_ball = np.linalg.norm(p_map - room.ball, axis=1) < room.radius + 1e-3
        labels = np.where(on_ball, 2, 1).astype(np.uint16).reshape(depth.shape)
        yield RgbdImage(
            stamp_ns=10**9 + n * 10**8,
            robot="spot",
            sensor="camera",
            depth=depth,
            intrinsics=SMALL_CAMERA,
            T_map_camera=T_map_camera,
            labels=labels,
            instances=np.where(on_ball, np.uint32(1), np.uint32(0)).reshape(depth.shape),
        )


@contextmanager
def served(*options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server process and its endpoint; killed at the end if it still runs."""
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "scenegraph.cli", "serve", "--json", "--endpoint", endpoint, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["endpoint"] == endpoint
        yield process, endpoint
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def test_a_room_is_mapped_over_the_wire_and_asked_about():
    with served() as (_, endpoint), Client("home", endpoint) as robot, Client("home", endpoint) as operator:
        with operator.mirror() as live:
            robot.integrate(CLASSES)
            for image in views():
                reply = robot.integrate(image)
            assert live.wait_for(reply.revision)
            assert live.graph == operator.graph()
            balls = [node for node in live.graph.nodes("object") if node.label == "ball"]
            assert [ball for ball in balls if np.linalg.norm(ball.position - Room().ball) < Room().radius]
        answers = operator.ask("instance_of(X, ball)")
        assert answers.truth == "true"
        assert {row["X"].id for row in answers} >= {ball.id for ball in balls}
        assert "instance_of" in answers.explain().text
        hits = image.T_map_camera @ SMALL_CAMERA.backproject(image.depth).reshape(-1, 3)
        at_hits = operator.map_query("occupancy", hits)
        assert at_hits.known.mean() > 0.9
        assert np.median(at_hits.values) > 0.5
        elsewhere = operator.map_query("occupancy", [[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
        assert elsewhere.known.tolist() == [True, False]
        assert elsewhere.values[0] < 0.5
        assert operator.map_layer("tsdf", "ply").startswith(b"ply")
        assert operator.status().inputs["spot/camera/rgbd"].taken == 12
        assert operator.status().problems == 0


def test_a_killed_server_is_noticed():
    with served() as (process, endpoint), Client("home", endpoint) as client:
        assert client.ask("instance_of(X, ball)").truth == "unknown"
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        with pytest.raises((ServerUnreachable, ServerTimeout)):
            client.ask("instance_of(X, ball)", timeout_s=0.1)


def test_what_was_told_is_still_known_after_the_server_was_ended_or_killed(tmp_path: Path):
    store = tmp_path / "home.world"
    with served("--store", str(store)) as (process, endpoint), Client("home", endpoint) as client:
        assert client.tell("fact(clean(kitchen))", author="operator", reason="looked").accepted
        process.terminate()
        assert process.wait(10.0) == 0
    with served("--store", str(store)) as (process, endpoint), Client("home", endpoint) as client:
        assert client.ask("fact(clean(kitchen))").truth == "true"
        assert client.tell("fact(clean(bath))", author="operator", reason="looked").accepted
        process.kill()
        process.wait()
    with served("--store", str(store)) as (_, endpoint), Client("home", endpoint) as client:
        assert eventually(lambda: client.ask("fact(clean(bath))").truth == "true")
