"""The demo: a real server process, a short tour, everything it promises to leave behind, and nothing it should not."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys

import pytest
from PIL import Image

from scenegraph import demo
from scenegraph.console import Printer
from scenegraph.demo_report import reason_in_words
from scenegraph.errors import ExportError
from scenegraph.server_process import server_process
from scenegraph.service.errors import ServerUnreachable
from scenegraph.simulation import Tour, TruthRecorder
from tests.support.corners import kitchen_corner
from tests.support.homes import home


def listens(endpoint: str) -> bool:
    address, port = endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as probe:
        return probe.connect_ex((address, int(port))) == 0


def short_tour(seed: int, images_per_room: int) -> tuple[object, Tour, TruthRecorder]:
    return home(seed), kitchen_corner(seed, 6), TruthRecorder(home(seed))


def test_the_demo_leaves_all_that_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "_home", short_tour)
    (tmp_path / "report.json").write_text("of an earlier run")
    demo.run(output=tmp_path, seed=3, printer=Printer())
    shown = capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    endpoint = re.search(r"tcp/[\d.:]*\d", shown)[0]
    assert not listens(endpoint)
    assert report["images"] == 6
    assert report["inputs"]["robot/camera/rgbd"]["taken"] == 6
    assert report["inputs"]["robot/camera/rgbd"]["dropped"] == 0
    assert all(layer["blocks"] > 0 for layer in report["layers"].values())
    assert {plane["label"] for plane in report["planes"]} >= {"wall", "floor"}
    assert len(report["questions"]) == 5
    assert all(question["problem"] is None and question["explanation"] for question in report["questions"])
    assert {question["truth"] for question in report["questions"]} >= {"unknown"}
    assert report["where"]["phrase"] == "near the oven"
    assert 0 <= report["truth"]["figures"]["objects.recall"] <= 1
    assert set(report["seconds"]) >= {"mapping", "questions", "picture", "altogether"}
    for words in ("What each layer holds", "The planes and their labels", "The rooms and their objects", "precision"):
        assert words in shown
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width > 1500
    assert {path.name for path in tmp_path.iterdir()} == {
        "picture.png", "mesh.ply", "graph.json", "home.world", "report.json",
    }  # fmt: skip


def test_a_demo_that_is_told_to_end_takes_its_server_along(tmp_path):
    command = [sys.executable, "-m", "scenegraph.cli", "demo", "--output", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        endpoint = re.search(r"tcp/[\d.:]*\d", process.stdout.readline())[0]
        assert listens(endpoint)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 130
    assert not listens(endpoint)


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExportError, match="file: cannot be written"):
        demo.run(output=tmp_path / "file", seed=3, printer=Printer())


def test_a_server_that_does_not_start_is_told_with_its_last_words(tmp_path):
    store = tmp_path / "home.world"
    store.write_bytes(b"no world")
    with (
        pytest.raises(ServerUnreachable, match="did not start and ended with status 2") as caught,
        server_process("home", store, tmp_path / "server.log"),
    ):
        raise AssertionError("a server runs")
    assert "home.world" in caught.value.hint


def test_an_error_of_the_robot_ends_its_server_and_is_told(tmp_path):
    with (  # noqa: PT012
        pytest.raises(ZeroDivisionError),
        server_process("home", tmp_path / "home.world", tmp_path / "server.log") as endpoint,
    ):
        assert listens(endpoint)
        raise ZeroDivisionError
    assert not listens(endpoint)


@pytest.mark.parametrize(
    ("rooms", "expected"),
    [
        ("aaaaaa", [("a", 6)]),
        ("aaaaaabbbbbb", [("a", 6), ("b", 6)]),
        ("aaaaaahhbbbbbb", [("a", 6), ("b", 8)]),
        ("aaaaaahhaaaaa", [("a", 13)]),
        ("aaaaaahh", [("a", 8)]),
        ("hhaaaaaa", [("h", 2), ("a", 6)]),
        ("h", [("h", 1)]),
    ],
)
def test_passages_belong_to_the_room_that_they_lead_to(rooms, expected):
    assert demo.legs(list(rooms)) == expected
    assert sum(count for _, count in expected) == len(rooms)


def test_reasons_for_a_rooms_type_are_put_in_words():
    reason = "evidence(3.6999999999999997,[speaks(coffee_table,1.0),speaks(tv,0.7)])"
    assert reason_in_words(reason) == "coffee table 1, tv 0.7"
    assert reason_in_words("an operator said so") == "an operator said so"
