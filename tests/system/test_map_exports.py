"""What is known of classes, out of a saved world and of a server: the same files, with what is unknown kept apart."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from mapping.instances import InstanceMap
from mapping.occupancy import OccupancyMap
from mapping.octomap import read_octomap
from mapping.palette import Palette
from mapping.semantics import SemanticMap
from mapping.tsdf import TsdfMap
from scenegraph import Client, World
from scenegraph.cli import app
from scenegraph.errors import ExportError
from scenegraph.exporting import Saved, Served, export, export_cost
from scenegraph.service import Server, exports
from tests import naive_labelled as naive
from tests.support.net import free_endpoint
from tests.support.scenes import Block, Scene, looking_at

SCENE = Scene(
    (
        Block("floor", (0.0, 0.0, -0.1), (4.0, 4.0, 0.2)),
        Block("box", (-0.4, 0.0, 0.15), (0.3, 0.3, 0.3), 1),
        Block("crate", (0.4, 0.1, 0.2), (0.3, 0.4, 0.4), 2),
    )
)
KINDS = {kind.kind: kind for kind in (OccupancyMap, TsdfMap, SemanticMap, InstanceMap)}
COSTS = {"costs": {"floor": 0, "box": "never", "lawn": 1}, "default": 4}
BOX = np.array([[-0.7, -0.3, -0.1], [-0.2, 0.3, 0.5]])


@pytest.fixture(scope="module")
def world():
    with World() as made:
        made.integrate(SCENE.label_space)
        for n in range(4):
            eye = (1.6 * np.cos(n * np.pi / 2), 1.6 * np.sin(n * np.pi / 2), 1.1)
            made.integrate(SCENE.image(looking_at(eye, (0.0, 0.0, 0.1)), n + 1))
        yield made


@pytest.fixture(scope="module")
def endpoint(world):
    where = free_endpoint()
    with Server(world, "home", endpoint=where):
        yield where


@pytest.fixture(scope="module")
def sources(world, endpoint):
    """The world in this process and on a server."""
    with Client("home", endpoint) as client:
        yield Saved(world), Served(client)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.parametrize(
    ("form", "layer"),
    [("ply", "semantics"), ("mesh", None), ("ot", None), ("ply", None), ("bt", None), ("ot", "occupancy")],
)
@pytest.mark.parametrize("box", [None, "-0.7,-0.3,-0.1,-0.2,0.3,0.5"])
def test_a_world_and_a_server_give_the_same_bytes(sources, tmp_path, form, layer, box):
    files = [export(source, form, tmp_path / str(n), layer=layer, box=box) for n, source in enumerate(sources)]
    one, other = (path.read_bytes() for path in files)
    assert one == other
    assert len(one) > 500


def test_a_cloud_has_class_instance_confidence_and_colour(world, sources, tmp_path):
    cloud = naive.read_ply(export(sources[0], "ply", tmp_path / "cloud.ply", layer="semantics"))
    centres, labels, _ = world.map.semantics.voxels()
    assert np.array_equal(cloud["label"], labels)
    assert np.array_equal(cloud["instance"], world.map.instances.query(centres))
    colors = np.stack([cloud[c] for c in ("red", "green", "blue")], axis=1)
    assert np.array_equal(colors, Palette(world.labels.classes).of(labels))


def test_meshes_have_labels_and_an_octree_has_their_colours(world, sources, tmp_path):
    palette = Palette(world.labels.classes)
    mesh = naive.read_ply(export(sources[0], "mesh", tmp_path / "mesh.ply"))
    colors = np.stack([mesh[c] for c in ("red", "green", "blue")], axis=1)
    assert np.array_equal(colors, palette.of(mesh["label"]))
    assert set(np.unique(mesh["label"])) >= {1, 2, 3}
    path = export(sources[0], "ply", tmp_path / "mesh.ply")
    assert np.array_equal(naive.read_ply(path)["label"], mesh["label"])
    assert b"\ncomment class 2 " in path.read_bytes()[:1000]
    tree = read_octomap(export(sources[0], "ot", tmp_path / "classes.ot"))
    centres = world.map.occupancy.occupied_centres()
    assert len(tree.occupied_centres()) == len(centres)
    assert len(tree.free_centres()) == len(world.map.occupancy.free_centres())
    shown = {tuple(c) for c in tree.octomap.colors_of(centres)}
    assert shown >= {tuple(c) for c in palette.of([1, 2, 3])}


def test_costs_are_a_grid_and_names_that_the_map_does_not_know_are_told(sources, tmp_path):
    (tmp_path / "costs.json").write_text(json.dumps(COSTS))
    grids = []
    for source in sources:
        path, absent = export_cost(source, tmp_path / "costs.json", tmp_path / "cost.npz", band_m=(-0.1, 1.0))
        assert absent == ("lawn",)
        with np.load(path) as arrays:
            grids.append(arrays["cost"])
    assert np.array_equal(*grids, equal_nan=True)
    assert {0.0, 4.0, np.inf} <= set(grids[0][~np.isnan(grids[0])].tolist())
    assert np.isnan(grids[0]).any()
    path, _ = export_cost(sources[0], tmp_path / "costs.json", tmp_path / "cost.ply", band_m=(-0.1, 1.0))
    assert {0.0, 4.0, np.inf} <= set(naive.read_ply(path)["cost"].tolist())


def test_an_empty_world_gives_files_that_hold_nothing(tmp_path):
    with World() as empty:
        source = Saved(empty)
        for form, layer in (("ply", "semantics"), ("mesh", None), ("ply", None)):
            assert not len(naive.read_ply(export(source, form, tmp_path / "out", layer=layer))["x"])
        assert not len(read_octomap(export(source, "ot", tmp_path / "out.ot")).occupied_centres())
        (tmp_path / "costs.json").write_text(json.dumps({"costs": {}, "default": 1}))
        assert export_cost(source, tmp_path / "costs.json", tmp_path / "cost", band_m=(0.0, 1.0))[0].exists()


@pytest.mark.parametrize(
    ("form", "words", "told"),
    [
        ("ply", {"layer": "semantic"}, "unknown layer 'semantic'"),
        ("ot", {"layer": "tsdf"}, "format of tsdf: expected one of npz, ply"),
        ("npz", {}, "expected a layer"),
        ("csv", {"layer": "tsdf"}, "layer: expected with"),
        ("ply", {"box": "1,2"}, "box: expected x0,y0,z0,x1,y1,z1"),
        ("cost", {}, "table"),
    ],
)
def test_what_cannot_be_exported_is_told(sources, tmp_path, form, words, told):
    for source in sources:
        with pytest.raises(ExportError, match=told):
            export(source, form, tmp_path / "out", **words)


def test_the_command_line_exports_labels_and_costs(endpoint, tmp_path):
    words = ("--connect", endpoint, "--json", "--output", tmp_path / "out.ply", "--box", "-0.7,-0.3,-0.1,-0.2,0.3,0.5")
    result = run("export", "--format", "ply", "--layer", "semantics", *words)
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["bytes"] == (tmp_path / "out.ply").stat().st_size
    (tmp_path / "costs.json").write_text(json.dumps(COSTS))
    cost = ("export", "--connect", endpoint, "--format", "cost", "--output", tmp_path / "cost")
    result = run(*cost, "--costs", tmp_path / "costs.json", "--band", "-0.1", "0.5", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["absent"] == ["lawn"]
    assert (tmp_path / "cost.png").exists()
    (tmp_path / "costs.json").write_text('{"costs": {"floor": -1}, "default": 0}')
    result = run(*cost, "--costs", tmp_path / "costs.json")
    assert result.exit_code == 2
    assert "costs['floor']" in result.stderr
    result = run(*cost)
    assert result.exit_code == 2
    assert "--costs" in result.stderr


# -- over the wire ---------------------------------------------------------------------------------------------------


def test_a_query_tells_class_and_instance_and_keeps_what_is_unknown_apart(world, endpoint):
    centres, labels, _ = world.map.semantics.voxels()
    on_box = centres[(labels == SCENE.id_of("box")) & (world.map.instances.query(centres) > 0)][0]
    points = np.array([on_box, [0.0, 0.0, 0.52], [9.0, 0.0, 0.0]])
    with Client("home", endpoint) as client:
        told = client.map_query("semantics", points)
    assert told.values.tolist() == [SCENE.id_of("box"), 0, 0]
    assert told.known.tolist() == [True, False, False]
    assert told.observed.tolist() == [True, True, False]
    assert told.instance[0] > 0
    assert told.instance.tolist() == world.map.instances.query(points).tolist()
    assert told.confidence[0] > 0.5


def test_arrays_tell_what_their_class_ids_mean(world, endpoint):
    with Client("home", endpoint) as client, np.load(io.BytesIO(client.map_layer("semantics"))) as state:
        arrays = dict(state)
    assert [(info.name, info.kind, info.color) for info in exports.classes_in(arrays)] == [
        (info.name, info.kind, info.color) for info in world.labels.classes
    ]
    assert np.array_equal(SemanticMap.from_state(arrays).store.cells(), world.map.semantics.store.cells())


@pytest.mark.parametrize("name", ["occupancy", "tsdf", "semantics", "instances"])
def test_a_box_of_a_layer_is_what_the_layer_says_there_and_nothing_elsewhere(world, name):
    layer = getattr(world.map, name)
    part = KINDS[name].from_state(exports.crop(layer.state(), layer.block_size_m, BOX))
    inside = np.random.default_rng(0).uniform(BOX[0] + 0.1, BOX[1] - 0.1, (300, 3))
    outside = inside + np.array([0.0, 1.2, 0.0])
    ask = (lambda of, at: of.belief(at).classes) if name == "semantics" else (lambda of, at: of.query(at))
    distances = name in ("occupancy", "tsdf")
    assert np.array_equal(ask(part, inside), ask(layer, inside), equal_nan=distances)
    assert (np.isnan(ask(part, outside)) if distances else ask(part, outside) == 0).all()
    assert 0 < len(part.block_ijk) < len(layer.block_ijk)


def test_a_box_cuts_large_cells_of_an_octree_out_too():
    layer = OccupancyMap(0.1, 5.0)
    layer.fill_cells(np.array([[0, 0, 0], [5, 0, 0]]), np.array([1, 1]), np.array([20, -20], np.int8))
    layer.assign([[0.05, -0.05, 0.05], [8.05, 8.05, 8.05], [-3.0, 0.0, 0.0]], [30, 30, 30])
    box = np.array([[-0.1, -0.1, 0.0], [1.0, 1.0, 1.0]])
    part = OccupancyMap.from_state(exports.crop(layer.state(), layer.block_size_m, box))
    points = np.array([[0.5, 0.5, 0.5], [0.05, -0.05, 0.05], [8.05, 8.05, 8.05], [9.0, 0.5, 0.5], [-3.0, 0.0, 0.0]])
    assert part.classify(points).tolist() == [1, 1, -1, -1, -1]


def test_a_layer_has_only_its_formats(world):
    with pytest.raises(ExportError, match="format of instances"):
        exports.Copies(world, "instances", "ply")
