"""Any program with Zenoh and JSON or CBOR can take part. The functions below use nothing of our package.

`exchange` is the example of the README: it stays true because it runs here.
"""

from __future__ import annotations

import inspect
import json
import struct

import cbor2
import zenoh

from scenegraph.service import Server
from tests.support.fake_world import FakeWorld
from tests.support.net import eventually, free_endpoint


def exchange(endpoint: str) -> dict:
    """Put a depth image of 4 × 3 pixels as JSON, then ask where the cups are."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        image = {
            "stamp_ns": 1_700_000_000_000_000_000,
            "robot": "spot",
            "sensor": "camera",
            "depth": [[2.0, 2.0, 2.0, 2.0], [2.0, 2.0, 2.0, 2.0], [2.0, 2.0, 2.0, 2.0]],
            "intrinsics": {"fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 1.5, "width": 4, "height": 3},
            "T_map_camera": {"translation": [0, 0, 1], "rotation_wxyz": [0.5, -0.5, 0.5, -0.5]},
        }
        where = "scenegraph/v1/home/in/spot/camera/rgbd"
        for reply in session.get(where, payload=json.dumps(image), encoding="application/json;RgbdImage"):
            print("mapped:", json.loads(reply.ok.payload.to_string()))

        answers = {}
        for reply in session.get("scenegraph/v1/home/ask", payload=json.dumps({"goal": "cup"})):
            if reply.ok is not None:
                answers = json.loads(reply.ok.payload.to_string())
            else:
                print("problem:", json.loads(reply.err.payload.to_string())["message"])
        return answers


def put_cbor(endpoint: str) -> None:
    """Put the same image as CBOR, its depth as a typed array (RFC 8746), and do not wait for a reply."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    float32_little_endian, multi_dimensional = 85, 40
    depth = cbor2.CBORTag(float32_little_endian, struct.pack("<12f", *[2.0] * 12))
    image = {
        "stamp_ns": 1_700_000_000_100_000_000,
        "robot": "spot",
        "sensor": "camera",
        "depth": cbor2.CBORTag(multi_dimensional, [[3, 4], depth]),
        "intrinsics": {"fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 1.5, "width": 4, "height": 3},
        "T_map_camera": {"translation": [0, 0, 1], "rotation_wxyz": [0.5, -0.5, 0.5, -0.5]},
    }
    with zenoh.open(config) as session:
        session.put("scenegraph/v1/home/in/spot/camera/rgbd", cbor2.dumps(image), encoding="application/cbor;RgbdImage")


def test_a_program_without_our_package_maps_an_image_and_asks(capsys):
    with Server(FakeWorld(), "home", endpoint=free_endpoint()) as server:
        answers = exchange(server.endpoint)
    assert "mapped: {'accepted': True" in capsys.readouterr().out
    assert answers["truth"] == "true"
    assert answers["answers"] == [{"X": {"node": "cup_2"}, "N": {"value": 3}}]


def test_a_program_without_our_package_puts_cbor():
    world = FakeWorld()
    with Server(world, "home", endpoint=free_endpoint()) as server:
        put_cbor(server.endpoint)
        assert eventually(lambda: len(world.integrated) == 1)
    [image] = world.integrated
    assert image.depth.tolist() == [[2.0] * 4] * 3
    assert image.T_map_camera.translation.tolist() == [0, 0, 1]


def test_the_examples_use_nothing_of_our_package():
    for function in (exchange, put_cbor):
        used = function.__code__.co_names
        assert not {"scenegraph", "mapping", "Client", "Server", "encode"} & set(used)
        assert "import" not in inspect.getsource(function)
