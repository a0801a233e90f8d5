"""The README tells the truth: its programs run, its commands and options exist, its rule file works."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

import scenegraph
from mapping import read_octomap
from reasoning.knowledge import KnowledgeBase
from reasoning.labelling import PlaneRules
from scenegraph.cli import app
from scenegraph.config import WorldConfig
from scenegraph.evaluation import Evaluation
from scenegraph.service import Server
from scenegraph.world import World
from tests.support.corners import kitchen_corner
from tests.support.homes import home
from tests.support.net import free_endpoint
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The code blocks of a language, in order."""
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


FIRST, OWN_CAMERA, CLIENT, WITHOUT_US, LAYERS, SEMANTIC, BOXES = blocks("python")


def commands() -> list[list[str]]:
    """Every command line of ours that the README names, as words."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    lines += re.findall(r"`((?:\.venv/bin/)?scenegraph [^`]*)`", README)
    ours = [shlex.split(line.split(" &")[0], comments=True) for line in lines if "scenegraph " in line]
    return [words[1:] for words in ours if words and words[0].endswith("scenegraph")]


class OneCorner:
    """A home of which only a corner of the kitchen is looked at."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def observe(self, images_per_room: int):
        return home(self.seed).observe(tour=kitchen_corner(self.seed, images_per_room), noise="none")


def test_the_first_program_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scenegraph, "simulate_home", OneCorner, raising=False)
    exec(compile(FIRST, "README", "exec"), {})
    assert re.search(r"^(true|false|unknown) (yes|no|open): near\(X, oven\)", capsys.readouterr().out, re.MULTILINE)
    with World.load(tmp_path / "home.world") as world:
        assert world.graph.nodes("object")


def test_an_image_of_ones_own_camera_is_mapped_as_the_readme_says(capsys):
    exec(compile(OWN_CAMERA, "README", "exec"), {})
    at_wall, before, beyond = re.findall(r"[\d.]+|nan", capsys.readouterr().out.split("[")[1])
    assert float(at_wall) > 0.5 > float(before)
    assert beyond == "nan"


def test_the_programs_against_a_server_run(monkeypatch, capsys):
    endpoint = free_endpoint()
    monkeypatch.setenv("SCENEGRAPH_ENDPOINT", endpoint)
    with World() as world, Server(world, "home", endpoint=endpoint):
        without_us = WITHOUT_US.replace("tcp/127.0.0.1:7447", endpoint)
        assert endpoint in without_us
        assert not re.search(r"scenegraph\.|mapping|import (?!json|zenoh)", without_us)
        exec(compile(without_us, "README", "exec"), {})
        told = capsys.readouterr().out
        assert "'accepted': True" in told
        assert "'truth':" in told
        exec(compile(CLIENT, "README", "exec"), {})
        assert "things at revision" in capsys.readouterr().out


def test_the_map_layers_work_on_their_own_as_the_readme_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pose, room = TOUR[0], Room()
    depth = room.depth(pose, SMALL_CAMERA)
    given = {
        "p_sensor": room.scan(pose, 2000),
        "T_map_sensor": pose,
        "depth": depth,
        "intrinsics": SMALL_CAMERA,
        "T_map_camera": pose,
        "color": np.full((*depth.shape, 3), 128, np.uint8),
        "origin": pose.translation,
        "directions": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.2]],
        "points": pose.translation[None],
        "footprint": [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]],
        "path": [[*pose.translation, 0.0]],
    }
    exec(compile(LAYERS, "README", "exec"), given)
    assert np.isfinite(given["distance"]).all()
    assert given["report"].clearance_m.shape == (1,)
    read_octomap("map.bt").write("again.bt")
    assert Path("again.bt").read_bytes() == Path("map.bt").read_bytes()
    assert Path("mesh.ply").stat().st_size > 1000


def test_a_map_tells_of_its_labels_as_the_readme_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with World() as world:
        for observation in OneCorner(2).observe(3):
            world.integrate(observation)
        points = world.map.semantics.voxels()[0][:50]
        given = {"world": world, "points": points}
        exec(compile(SEMANTIC, "README", "exec"), given)
    assert (given["labels"] > 0).all()
    assert np.array_equal(given["known"].labels, given["labels"])
    assert given["held"].unseen > 0
    assert len(given["mesh"].labels) == len(given["mesh"].vertices)
    assert Path("cloud.ply").stat().st_size > 1000


def test_boxes_become_a_graph_as_the_readme_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(BOXES, "README", "exec"), {})
    assert "cup_1 0.17 ['table_1']" in capsys.readouterr().out


def test_the_rules_of_the_readme_are_accepted(tmp_path):
    words, planes = blocks("prolog")
    (tmp_path / "mine.pl").write_text(words + planes)
    with KnowledgeBase([tmp_path / "mine.pl"]) as knowledge:
        assert knowledge.ask("in_danger(X)").problem is None
        assert "sill" in PlaneRules.of(knowledge).labels


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_commands_and_options_exist(words):
    group = get_command(app)
    assert words, "scenegraph alone"
    command = group.commands[words[0]]
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known
    assert CliRunner().invoke(app, [words[0], "--help"]).exit_code == 0


def test_all_commands_are_named():
    assert set(get_command(app).commands) <= set(re.findall(r"`?\b([a-z]+)\b`?", README))


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"make ([a-z]+)\b", README)) <= targets


def test_configuration_figures_and_files_are_those_that_exist():
    table = README.split("## Configuration")[1].split("## Figures")[0]
    assert set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) == set(WorldConfig.model_fields)
    for name in ("voxel_size_m", "max_range_m", "label_range_m", "robot_radius_m"):
        assert f"| `{name}` | {WorldConfig.model_fields[name].default} |" in table
    assert Evaluation(image_ms=[1.0]).figures()["image_ms.median"] == 1.0
    for path in re.findall(r"\]\((\.\w[\w./]*)\)", README):
        assert (ROOT / path).is_file()
        assert (ROOT / path).stat().st_size <= 300_000


def test_lines_are_of_the_length_that_people_read():
    prose = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
    assert max(len(line) for line in prose.splitlines() if not line.startswith("|")) <= 140
