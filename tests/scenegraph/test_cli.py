"""The command line: exit statuses, one line for each error, tables for people and JSON for programs."""

import json
import subprocess
import sys
import types
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pytest
from typer.testing import CliRunner

from mapping.datasets import open_dataset
from mapping.datasets.recorded import Recorder
from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.observations import AgentPose, Scan
from scenegraph import simulation
from scenegraph.cli import app
from scenegraph.errors import Problem, StoreForeign
from scenegraph.evaluation import Evaluation
from scenegraph.events import Event
from scenegraph.graph import Node, SceneGraph
from scenegraph.simulation import NoiseModel

COMMANDS = """
    demo serve replay simulate ask where tell evaluate status export join schema doctor
""".split()  # noqa: SIM905


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def document(result):
    """The one JSON object that `--json` prints."""
    (line,) = result.stdout.splitlines()
    return json.loads(line)


# -- a world that answers as it is told ----------------------------------------------------------------------------


@dataclass
class Told:
    truth: str = "true"
    rows: list[dict[str, Any]] = field(default_factory=list)
    problem: Problem | None = None
    truncated: bool = False
    revision: int = 41
    elapsed_ms: float = 0.8

    def __iter__(self):
        return iter(self.rows)

    def explain(self):
        test = {"measurement": "gap", "value": 0.3, "comparison": "=<", "threshold": 1.0}
        child = {
            "goal": "near(object_1, object_2)",
            "truth": self.truth,
            "tests": [test],
            "evidence": ["seen(object_1)"],
        }
        return {"goal": "near(X, oven)", "truth": self.truth, "rule": "near/2", "children": [child]}


@dataclass
class GoalPose:
    pose: SE3
    clearance_m: float
    path_length_m: float | None


@dataclass
class Region:
    polygon: tuple[tuple[float, float], ...]
    z_min: float
    z_max: float


@dataclass
class PlaceAnswer:
    nodes: tuple[str, ...]
    region: Region
    poses: tuple[GoalPose, ...]


@dataclass
class Place:
    truth: str
    phrase: str
    answers: tuple[PlaceAnswer, ...] = ()
    ambiguous: tuple[str, ...] = ()
    problem: Problem | None = None


class World:
    """The verbs of a world, without a world behind them."""

    answers = Told()
    place = Place("unknown", "")
    accepted = True
    asked: ClassVar[list[Any]] = []
    refuse = False

    def __init__(self, config=None):
        self.config = config
        self.graph = SceneGraph()
        self.map = types.SimpleNamespace(layers={})
        self.taken = []

    @classmethod
    def load(cls, path):
        if not path.exists():
            raise StoreForeign(f"{path}: not a stored world", hint="replay --save writes one")
        return cls()

    def save(self, path):
        path.write_text("a world")

    def events(self, since_ns=None):
        appeared = {"kind": "appeared", "node": "object_12", "layer": "object", "label": "oven", "revision": 1}
        return [Event(**appeared, stamp_ns=5, position=(1.0, 2.0, 0.5))] if since_ns is None or since_ns < 5 else []

    def integrate(self, observation):
        if self.refuse:
            raise InvalidObservation("Scan.labels: no label space")
        self.taken.append(observation)

    def ask(self, goal, **options):
        self.asked.append((goal, options))
        return self.answers

    def where(self, phrase, **options):
        return self.place

    def tell(self, statement, *, author, reason):
        problem = (
            None if self.accepted else Problem(code="invalid_statement", message="no such thing", hint="see rules")
        )
        return types.SimpleNamespace(accepted=self.accepted, revision=42, problem=problem)

    def status(self):
        layer = {
            "blocks": 3,
            "memory_bytes": 5_000_000,
            "voxel_size_m": self.config.voxel_size_m if self.config else 0.05,
        }
        return {"revision": 4, "layers": {"tsdf": layer}, "nodes": {"object": 2}, "edges": 1}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.fixture
def world(monkeypatch):
    """The class that commands take for `scenegraph.world.World`."""
    kind = type("World", (World,), {"asked": []})
    module = types.ModuleType("scenegraph.world")
    module.World = kind
    monkeypatch.setitem(sys.modules, "scenegraph.world", module)
    return kind


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "home.world"
    path.write_text("a world")
    return path


@pytest.fixture
def folder(tmp_path):
    with Recorder(tmp_path / "run", name="hall", default_voxel_size_m=0.1) as recorder:
        for i in range(6):
            recorder.write(AgentPose(stamp_ns=i, robot="r", T_map_base=SE3.identity()))
            points = np.ones((4, 3), np.float32)
            recorder.write(Scan(stamp_ns=i, robot="r", sensor="s", points=points, T_map_sensor=SE3.identity()))
    return tmp_path / "run"


OVEN = Node(id="object_12", layer="object", label="oven", position=(1.0, 2.0, 0.5), first_seen_ns=1, last_seen_ns=2)


# -- usage ---------------------------------------------------------------------------------------------------------


def test_help_names_every_command():
    result = run("--help")
    assert result.exit_code == 0
    assert all(command in result.stdout for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_and_json(command):
    result = run(command, "--help")
    assert result.exit_code == 0
    assert "--json" in result.stdout


def test_help_imports_nothing_heavy():
    """Numpy, open3d, numba, zenoh and pydantic would each cost more than the help itself."""
    code = (
        "import sys\n"
        "from typer.testing import CliRunner\n"
        "from scenegraph.cli import app\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print(sorted({'numpy', 'open3d', 'numba', 'zenoh', 'scipy', 'pydantic'} & set(sys.modules)))\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["frobnicate"], "No such command 'frobnicate'"),
        (["ask"], "Missing argument"),
        (["ask", "near(X, oven)", "--limit", "0"], "--limit"),
        (["ask", "near(X, oven)", "--map", "a", "--connect", "b"], "exclude each other"),
        (["replay", "nowhere"], "nowhere: there is no such file or folder"),
        (["replay", "nowhere", "--every", "0"], "--every"),
        (["replay", "x", "--connect", "tcp/127.0.0.1:1", "--save", "y"], "not with --connect"),
        (["replay", "x", "--option", "up"], "NAME=VALUE"),
        (["simulate", "--output", "x", "--noise", "loud"], "loud"),
        (["simulate"], "--output"),
        (["evaluate", "--seeds", "0"], "--seeds"),
        (["evaluate", "--mislabelled", "25"], "--mislabelled"),
        (["evaluate", "--mislabelled", "many"], "--mislabelled"),
        (["evaluate", "--mislabelled", "nan"], "--mislabelled"),
        (["export", "--format", "graphm", "--output", "x", "--map", "y"], "did you mean 'graphml'"),
        (["export", "--format", "csv"], "--output"),
        (["serve", "--config", "no_such.toml"], "no_such.toml: cannot be read"),
        (["status", "--connect", "tcp/127.0.0.1:1"], "nothing answers at tcp/127.0.0.1:1"),
        (["ask", "near(X, oven)", "--world", "Not A World", "--connect", "tcp/127.0.0.1:1"], "world"),
    ],
)
def test_wrong_use_is_told_in_one_line_with_status_2(words, expected):
    result = run(*words)
    assert result.exit_code == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert expected in line


def test_evaluate_passes_on_the_noise_and_prints_figures_once(monkeypatch):
    def evaluate(seeds, **how):
        asked.append((seeds, how.pop("advance") is not None, how))
        return Evaluation(seeds=[7], noise=NoiseModel(mislabelled=0.25), image_ms=[2.0])

    asked = []
    monkeypatch.setattr("scenegraph.evaluation.evaluate", evaluate)
    told = document(run("evaluate", "--seeds", 1, "--first-seed", 7, "--mislabelled", 0.25, "--json"))
    assert told["seeds"] == 1
    assert told["figures"] == {"image_ms.median": 2.0, "image_ms.p99": 2.0}
    assert told["noise"]["mislabelled"] == 0.25
    assert told["semantics.accuracy_by_views"] == []
    assert run("evaluate", "--noise", "none", "--workers", 2).exit_code == 0
    assert asked == [
        (1, True, {"first_seed": 7, "noise": "realistic", "mislabelled": 0.25, "second_tour": False, "workers": 1}),
        (10, True, {"first_seed": 0, "noise": "none", "mislabelled": None, "second_tour": False, "workers": 2}),
    ]


def test_errors_are_json_too_when_asked_for():
    result = run("replay", "nowhere", "--json")
    assert result.exit_code == 2
    assert document(result)["problem"]["code"] == "dataset_error"


def test_a_missing_dependency_points_to_the_doctor(monkeypatch):
    monkeypatch.setitem(sys.modules, "scenegraph.world", None)
    result = run("status", "--map", "x")
    assert result.exit_code == 2
    assert "scenegraph doctor says what to install" in result.stderr


def test_a_fault_of_ours_is_not_hidden(world, saved, monkeypatch):
    monkeypatch.setattr(world, "ask", lambda self, goal, **options: 1 / 0)
    assert isinstance(run("ask", "near(X, oven)", "--map", saved).exception, ZeroDivisionError)


# -- questions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("truth", "status"), [("true", 0), ("false", 1), ("unknown", 1)])
def test_the_exit_status_of_a_question_is_its_truth(world, saved, truth, status):
    world.answers = Told(truth)
    result = run("ask", "near(X, oven)", "--map", saved)
    assert result.exit_code == status
    assert result.stdout.startswith(truth)


def test_answers_are_a_table_or_json(world, saved):
    world.answers = Told(rows=[{"X": OVEN, "N": 3, "D": 0.25}])
    table = run("ask", "near(X, oven)", "--map", saved, "--robot", "r1", "--limit", "5", "--timeout-s", "2")
    assert "object_12 (oven)" in table.stdout
    assert world.asked[-1] == ("near(X, oven)", {"robot": "r1", "limit": 5, "timeout_s": 2.0})
    told = document(run("ask", "near(X, oven)", "--map", saved, "--json"))
    assert told["truth"] == "true"
    assert told["answers"][0]["X"]["node"] == "object_12"
    assert told["answers"][0]["N"] == {"value": 3}
    assert (told["revision"], told["problem"], told["explanation"]) == (41, None, None)


def test_an_explanation_shows_measured_values_and_thresholds(world, saved):
    world.answers = Told("false")
    text = run("ask", "near(X, oven)", "--map", saved, "--explain").stdout
    assert "near(object_1, object_2)" in text
    assert "gap 0.3 =< 1" in text
    told = document(run("ask", "near(X, oven)", "--map", saved, "--explain", "--json"))
    assert told["explanation"]["rule"] == "near/2"


def test_a_question_that_cannot_be_asked_is_an_input_error(world, saved):
    world.answers = Told("unknown", problem=Problem(code="syntax_error", message="unexpected end", hint="close it"))
    result = run("ask", "near(X", "--map", saved)
    assert result.exit_code == 2
    assert "error: unexpected end (close it)" in result.stderr
    result = run("ask", "near(X", "--map", saved, "--json")
    assert result.exit_code == 2
    assert document(result)["problem"]["code"] == "syntax_error"


def test_a_place_is_told_with_poses(world, saved):
    pose = GoalPose(SE3.exp([1.0, 2.0, 0.0, 0.0, 0.0, 0.0]), 0.42, None)
    region = Region(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), 0.0, 2.0)
    world.place = Place("true", "near the oven", (PlaceAnswer(("object_12",), region, (pose,)),), ("object_3",))
    result = run("where", "near the oven", "--map", saved)
    assert result.exit_code == 0
    assert all(part in result.stdout for part in ("object_12", "(1.00, 1.00)", "0.42", "object_3"))
    told = document(run("where", "near the oven", "--map", saved, "--json"))
    assert told["answers"][0]["poses"][0]["pose"]["translation"] == pytest.approx([1.0, 2.0, 0.0])
    world.place = Place("unknown", "near the oven")
    assert run("where", "near the oven", "--map", saved).exit_code == 1
    world.place = Place("unknown", "??", problem=Problem(code="unknown_phrase", message="not understood"))
    result = run("where", "??", "--map", saved)
    assert result.exit_code == 2
    assert "error: not understood" in result.stderr


def test_a_statement_is_kept_in_the_saved_world(world, saved, monkeypatch):
    saves = []
    monkeypatch.setattr(world, "save", lambda self, path: saves.append(path))
    assert run("tell", "rename(room_2, 'guest room')", "--map", saved).exit_code == 0
    assert saves == [saved]
    world.accepted = False
    result = run("tell", "rename(room_99, x)", "--map", saved)
    assert result.exit_code == 2
    assert "error: no such thing (see rules)" in result.stderr
    assert saves == [saved]
    assert document(run("tell", "x", "--map", saved, "--json"))["accepted"] is False


def test_a_file_that_is_no_world_is_refused(world, tmp_path):
    result = run("status", "--map", tmp_path / "nothing")
    assert result.exit_code == 2
    assert "not a stored world (replay --save writes one)" in result.stderr


def test_events_are_told_of_a_stored_world(world, saved):
    told = document(run("events", "--map", saved, "--json"))["events"]
    assert told == [event.model_dump(mode="json") for event in world().events()]
    assert document(run("events", "--map", saved, "--since-ns", 10**18, "--json")) == {"events": []}
    assert "appeared" in run("events", "--map", saved).stdout


def test_status_shows_layers_and_nodes(world, saved):
    result = run("status", "--map", saved)
    assert result.exit_code == 0
    assert all(part in result.stdout for part in ("tsdf", "0.05", "object", "revision 4"))
    assert document(run("status", "--map", saved, "--json"))["edges"] == 1


# -- recordings ----------------------------------------------------------------------------------------------------


def test_replay_plays_counts_and_saves(world, folder, tmp_path):
    result = run("replay", folder, "--every", "2", "--save", tmp_path / "out.world", "--json")
    assert result.exit_code == 0, result.stderr
    told = document(result)
    assert told["format"] == "recorded"
    assert told["observations"] == {"AgentPose": 6, "Scan": 3}
    assert told["status"]["layers"]["tsdf"]["voxel_size_m"] == 0.1  # what the recording suggests
    assert (tmp_path / "out.world").exists()
    told = document(run("replay", folder, "--voxel-size-m", "0.2", "--max-range-m", "3", "--json"))
    assert told["status"]["layers"]["tsdf"]["voxel_size_m"] == 0.2
    assert "hall (recorded)" in run("replay", folder).stdout


def test_replay_says_when_everything_was_refused(world, folder):
    world.refuse = True
    result = run("replay", folder)
    assert result.exit_code == 2
    assert "every image and scan was refused: Scan.labels: no label space" in result.stderr


def test_reader_options_are_passed_on(world, folder):
    result = run("replay", folder, "--option", "partial=true")
    assert result.exit_code == 0
    result = run("replay", folder, "--poses", "odometry")
    assert result.exit_code == 2
    assert "poses: not an option of recorded recordings; those are partial" in result.stderr


def test_impossible_parameters_of_a_world_are_refused(world, folder):
    result = run("replay", folder, "--voxel-size-m", "-1")
    assert result.exit_code == 2
    assert "voxel_size_m" in result.stderr


def test_simulate_writes_a_recording_that_replay_reads(tmp_path, monkeypatch):
    class ShortTour:
        """Three looks along x from the middle of the home, at eye height."""

        def __init__(self, home, images_per_room):
            T_map_camera = SE3([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 1.3])
            self.steps = [simulation.Step(SE3.identity(), T_map_camera, home.rooms[0].id)] * 3

        def __len__(self):
            return len(self.steps)

    monkeypatch.setattr(simulation, "Tour", ShortTour)
    result = run(
        "simulate", "--seed", "3", "--images-per-room", "7", "--lidar", "--output", tmp_path / "home", "--json"
    )
    assert result.exit_code == 0, result.stderr
    told = document(result)
    dataset = open_dataset(tmp_path / "home")
    assert len(dataset) == sum(told["observations"].values())
    assert dataset.notes["seed"] == 3
    kinds = [type(observation).__name__ for observation, _ in zip(dataset, range(5), strict=False)]
    assert kinds == ["LabelSpace", "RobotDescription", "AgentPose", "RgbdImage", "Scan"]
    result = run("simulate", "--seed", "3", "--output", tmp_path / "home")
    assert result.exit_code == 2
    assert "holds a recording already" in result.stderr


# -- the rest ------------------------------------------------------------------------------------------------------


def test_the_graph_is_exported(world, saved, tmp_path):
    result = run("export", "--map", saved, "--format", "node_link", "--output", tmp_path / "g.json", "--json")
    assert result.exit_code == 0, result.stderr
    assert document(result)["bytes"] == (tmp_path / "g.json").stat().st_size
    result = run("export", "--map", saved, "--format", "csv", "--output", tmp_path / "no" / "g.csv")
    assert result.exit_code == 2
    assert "cannot be written" in result.stderr


def test_the_schema_is_json_with_every_observation(tmp_path):
    told = json.loads(run("schema").stdout)
    assert "RgbdImage" in told["$defs"]
    assert run("schema", "--output", tmp_path / "schema.json").exit_code == 0
    assert json.loads((tmp_path / "schema.json").read_text()) == told


def test_the_doctor_prints_a_table_or_json():
    result = run("doctor")
    assert "SWI-Prolog" in result.stdout
    told = document(run("doctor", "--json"))
    assert result.exit_code == (0 if told["ok"] else 1)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.toml", "voxel_size_m = ", "not a TOML file"),
        ("a.json", "{", "not a JSON file"),
        ("a.json", "[1]", "expected names and values, got list"),
        ("a.toml", "voxel = 1", "voxel"),
        ("a.toml", "voxel_size_m = 7.0", "voxel_size_m"),
    ],
)
def test_a_bad_configuration_is_refused(world, tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    result = run("serve", "--config", tmp_path / name)
    assert result.exit_code == 2
    assert expected in result.stderr
