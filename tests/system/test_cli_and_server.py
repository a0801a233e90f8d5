"""The command line against a server: the same verbs, the same exit statuses, over the wire."""

import json

import pytest
from typer.testing import CliRunner

from mapping.datasets.recorded import Recorder
from mapping.observations import AgentPose, RgbdImage
from scenegraph.cli import app
from scenegraph.service import Server
from tests.support.fake_world import FakeWorld
from tests.support.net import free_endpoint, small_image


class World(FakeWorld):
    def status(self):
        return {"revision": self.graph.revision, "layers": {}, "nodes": {"object": len(self.graph)}, "edges": 0}


@pytest.fixture
def world():
    return World()


@pytest.fixture
def endpoint(world):
    """Where a server of the world `home` listens."""
    where = free_endpoint()
    with Server(world, "home", endpoint=where):
        yield where


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def document(result):
    return json.loads(result.stdout)


def test_a_recording_is_played_into_a_server_and_none_of_it_is_dropped(world, endpoint, tmp_path):
    with Recorder(tmp_path / "run") as recorder:
        for i in range(20):
            recorder.write(AgentPose(stamp_ns=i, robot="spot", T_map_base=small_image().T_map_camera))
            recorder.write(small_image(stamp_ns=i))
    result = run("replay", tmp_path / "run", "--connect", endpoint, "--every", "2", "--json")
    assert result.exit_code == 0, result.stderr
    assert document(result)["observations"] == {"AgentPose": 20, "RgbdImage": 10}
    images = [o.stamp_ns for o in world.integrated if isinstance(o, RgbdImage)]
    assert images == list(range(0, 20, 2))
    assert document(result)["status"]["world"] == "home"


def test_questions_are_answered_by_the_server(endpoint):
    result = run("ask", "table", "--connect", endpoint, "--json")
    assert result.exit_code == 0, result.stderr
    assert document(result)["answers"][0]["X"]["node"] == "table_1"
    assert run("ask", "unicorn", "--connect", endpoint).exit_code == 1
    assert run("ask", "table", "--connect", endpoint, "--explain").exit_code == 0


def test_the_endpoint_may_come_from_the_environment(endpoint, monkeypatch):
    monkeypatch.setenv("SCENEGRAPH_ENDPOINT", endpoint)
    assert document(run("status", "--json"))["world"] == "home"
    result = run("status")
    assert result.exit_code == 0
    assert "world home" in result.stdout


def test_the_graph_of_a_server_is_exported(endpoint, tmp_path):
    result = run("export", "--connect", endpoint, "--format", "node_link", "--output", tmp_path / "g.json")
    assert result.exit_code == 0, result.stderr
    assert "table_1" in (tmp_path / "g.json").read_text()


def test_a_world_that_is_not_served_is_told_with_those_that_are(endpoint):
    result = run("status", "--connect", endpoint, "--world", "hone")
    assert result.exit_code == 2
    assert "nobody serves the world 'hone'" in result.stderr
    assert "did you mean 'home'?" in result.stderr


def test_an_endpoint_that_is_taken_is_told(endpoint):
    result = run("serve", "--endpoint", endpoint)
    assert result.exit_code == 2
    assert f"cannot listen at {endpoint}" in result.stderr


def test_an_endpoint_that_is_none_is_told_in_one_line():
    for words in (("status", "--connect", "foo"), ("serve", "--endpoint", "foo")):
        result = run(*words)
        assert result.exit_code == 2
        assert result.stderr.strip() == "error: not an endpoint: foo (write it as tcp/ADDRESS:PORT)"


def test_the_demo_refuses_a_seed_below_zero(tmp_path):
    assert run("demo", "--seed", "-1", "--output", tmp_path / "out").exit_code == 2
    assert not (tmp_path / "out").exists()
