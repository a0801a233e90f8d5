"""What a message and a question cost. Run with `make bench`."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import RgbdImage
from scenegraph.service import Client, Server
from scenegraph.service.messages import decode, encode, encoding_of
from tests.support.fake_world import FakeWorld
from tests.support.net import free_endpoint


@pytest.fixture(scope="module")
def image() -> RgbdImage:
    """640 × 480 pixels of depth, colour and labels."""
    rng = np.random.default_rng(0)
    return RgbdImage(
        stamp_ns=1,
        robot="spot",
        sensor="camera",
        depth=rng.uniform(0.5, 5.0, (480, 640)).astype(np.float32),
        intrinsics=CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480),
        T_map_camera=SE3.identity(),
        color=rng.integers(0, 256, (480, 640, 3), dtype=np.uint8),
        labels=np.repeat(rng.integers(0, 30, (480, 10), dtype=np.uint16), 64, axis=1),
    )


@pytest.fixture(scope="module")
def client():
    with Server(FakeWorld(), "home", endpoint=free_endpoint()) as server, Client("home", server.endpoint) as connected:
        yield connected


@pytest.mark.parametrize("compress", [False, True], ids=["plain", "zstd"])
def test_encode_an_image(benchmark, image, compress):
    benchmark(encode, image, "cbor", compress=compress)


@pytest.mark.parametrize("compress", [False, True], ids=["plain", "zstd"])
def test_decode_an_image(benchmark, image, compress):
    data = encode(image, "cbor", compress=compress)
    benchmark(decode, data, "RgbdImage", encoding_of(image, "cbor"))


def test_ask_and_get_the_answer(benchmark, client):
    benchmark(client.ask, "table")


def test_send_an_image_and_wait_until_it_was_taken(benchmark, client, image):
    benchmark.pedantic(client.integrate, args=(image,), rounds=50)
