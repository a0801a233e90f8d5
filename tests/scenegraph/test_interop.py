"""Exports are read by the programs they are for, with everything in its place."""

import csv
import io
import json
import math
import sys
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

from mapping.mesh import Mesh
from scenegraph.cli import app
from scenegraph.errors import ExportError, StoreError, StoreForeign
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph, Snapshot
from scenegraph.importing import GraphFile, open_map
from scenegraph.interop import (
    FORMATS,
    export_graph,
    gltf_bytes,
    node_link_document,
    object_rows,
    objects_csv,
    read_graph,
    render_graph,
    spark_dsg_document,
)
from scenegraph.store import save_graph
from scenegraph.world import World

SEEN = {"first_seen_ns": 1_700_000_000_000_000_000, "last_seen_ns": 1_700_000_001_000_000_001}

TELLY_BOX = Box.from_yaw((1, 2, 0.5), (1, 0.5, 0.25), 0.3)


def home() -> SceneGraph:
    def node(layer: str, node_id: str, label: str, x: float, y: float, z: float, **fields: object) -> Node:
        return Node(id=node_id, layer=layer, label=label, position=(x, y, z), **SEEN, **fields)

    footprint = {"footprint": [[0, 0], [4, 0], [4, 3.5]]}
    telly = {"name": "telly", "points": 120, "moved": None}
    nodes = [
        node("building", "home", "home", 0, 0, 0),
        node("storey", "storey_0", "ground floor", 0, 0, 0),
        node("room", "room_0", "kitchen", 1, 1, 1, attributes=footprint),
        node("room", "room_1", "", 5, 1, 1),
        node("place", "place_3", "place", 5, 1, 1),
        node("structure", "door", "door", 4, 1, 1, box=Box(center=(4, 1, 1), size=(0.1, 1, 2))),
        node("structure", "structure_0", "floor", 2, 2, 0),
        node("object", "object_3", '"TV", <große>\x07', 1, 2, 0.5, box=TELLY_BOX, confidence=0.75, attributes=telly),
        node("object", "object_12", "table", 1, 2, 0.2),
        node("agent", "robot", "robot", 3, 3, 0, box=Box.from_yaw((3, 3, 0), (0.5, 0.5, 1), 1.0)),
    ]
    edges = [
        ("in", "room_0", "storey_0"), ("contains", "storey_0", "room_0"), ("in", "storey_0", "home"),
        ("on", "object_3", "object_12"), ("supports", "object_12", "object_3"),
        ("near", "object_3", "object_12"), ("near", "object_12", "object_3"),
        ("in", "object_3", "room_0"), ("in", "object_12", "room_0"), ("contains", "room_0", "object_12"),
        ("connects", "door", "room_0"), ("connects", "door", "room_1"), ("in", "robot", "room_1"),
        ("on", "object_12", "structure_0"), ("in", "place_3", "room_1"), ("near", "robot", "object_3"),
    ]  # fmt: skip
    changes = GraphChanges()
    for node in nodes:
        changes.put(node)
    for relation, source, target in edges:
        changes.put(Edge(relation=relation, source=source, target=target, value=0.25, evidence=("r/cam@5", 7), **SEEN))
    graph = SceneGraph()
    graph.commit(changes, 5)
    return graph


def test_spark_dsg_loads_the_whole_graph(tmp_path: Path) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    graph = home()
    loaded = spark_dsg.DynamicSceneGraph.load(str(export_graph(graph, "spark_dsg", tmp_path / "graph.json")))
    assert loaded.num_nodes() == len(graph)
    pairs = {frozenset((edge.source, edge.target)) for edge in graph.edges()}
    assert loaded.num_edges() == len(pairs)
    layers = spark_dsg.DsgLayers
    theirs_of_ours = {"object": layers.OBJECTS, "room": layers.ROOMS, "building": layers.BUILDINGS, "agent": "AGENTS"}
    for ours, theirs in {**theirs_of_ours, "structure": "STRUCTURE", "storey": "STOREYS"}.items():
        assert loaded.get_layer(theirs).num_nodes() == len(graph.nodes(ours)), ours
    television = loaded.get_node(spark_dsg.NodeSymbol("O", 3)).attributes
    np.testing.assert_allclose(television.position, [1, 2, 0.5])
    np.testing.assert_allclose(television.bounding_box.dimensions, [1, 0.5, 0.25])
    np.testing.assert_allclose(television.bounding_box.world_R_center, TELLY_BOX.rotation, atol=1e-6)
    assert television.name == "telly"
    assert television.metadata.get()["id"] == "object_3"
    assert television.metadata.get()["attributes"]["points"] == 120
    for labels in (loaded.get_labelspace(layers.OBJECTS), loaded.get_labelspace(2, 0)):
        assert labels.get_category(television.semantic_label) == graph.node("object_3").label
    assert loaded.get_node(spark_dsg.NodeSymbol("O", 12)).get_parent() == spark_dsg.NodeSymbol("R", 0).value
    edge = loaded.get_edge(spark_dsg.NodeSymbol("O", 3), spark_dsg.NodeSymbol("O", 12))
    relations = {(r["relation"], r["source"], r["target"]) for r in edge.info.metadata.get()["relations"]}
    assert relations == {
        ("on", "object_3", "object_12"),
        ("supports", "object_12", "object_3"),
        ("near", "object_3", "object_12"),
        ("near", "object_12", "object_3"),
    }


def test_spark_dsg_symbols_are_one_a_node_whatever_the_ids() -> None:
    graph = SceneGraph()
    changes = GraphChanges()
    for node_id in ("cup_1", "object_1", "cup_2", "x", "a_0", "b_00", f"far_{'9' * 30}", "object_2"):
        changes.put(Node(id=node_id, layer="object", label="x", position=(0, 0, 0), **SEEN))
    graph.commit(changes, 1)
    symbols = [node["id"] for node in spark_dsg_document(graph)["nodes"]]
    assert len(set(symbols)) == len(graph)


def test_an_empty_graph_can_be_exported(tmp_path: Path) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    for name, kind in FORMATS.items():
        assert export_graph(SceneGraph(), name, (tmp_path / name).with_suffix(kind.suffix)).stat().st_size
    assert spark_dsg.DynamicSceneGraph.load(str(tmp_path / "spark_dsg.json")).num_nodes() == 0


def test_networkx_reads_node_link() -> None:
    graph = home()
    again = nx.node_link_graph(json.loads(json.dumps(node_link_document(graph))), edges="edges")
    assert again.is_directed()
    assert again.is_multigraph()
    assert set(again) == {node.id for node in graph}
    assert {(key, s, t) for s, t, key in again.edges(keys=True)} == {tuple(edge.key) for edge in graph.edges()}
    assert again.nodes["object_3"]["position"] == [1, 2, 0.5]
    assert again.graph["revision"] == graph.revision


def test_networkx_reads_graphml() -> None:
    graph = home()
    again = nx.parse_graphml(render_graph(graph, "graphml").decode(), force_multigraph=True)
    assert set(again) == {node.id for node in graph}
    found = {(data["relation"], s, t) for s, t, data in again.edges(data=True)}
    assert found == {tuple(edge.key) for edge in graph.edges()}
    assert len({key for _, _, key in again.edges(keys=True)}) == graph.n_edges
    television = again.nodes["object_3"]
    assert television["label"] == '"TV", <große>\ufffd'
    assert television["last_seen_ns"] == SEEN["last_seen_ns"]
    assert television["yaw"] == pytest.approx(0.3)
    assert television["attribute_points"] == 120
    assert json.loads(again.nodes["room_0"]["attribute_footprint"]) == [[0, 0], [4, 0], [4, 3.5]]


def test_the_table_names_room_and_support_of_each_object() -> None:
    rows = list(csv.DictReader(io.StringIO(objects_csv(home()))))
    assert [row["id"] for row in rows] == ["object_3", "object_12"]
    television, table = rows
    assert television["label"] == home().node("object_3").label
    assert (television["name"], television["room"], television["on"]) == ("telly", "room_0", "object_12")
    assert float(television["yaw_deg"]) == pytest.approx(math.degrees(0.3))
    assert float(television["size_z_m"]) == 0.25
    assert (table["on"], table["in"], table["size_x_m"]) == ("structure_0", "", "")


@pytest.mark.parametrize("first", ["object_12", "structure_0"])
def test_what_stands_on_two_things_is_listed_with_what_carries_more_of_it(first: str) -> None:
    graph, shares = home(), {"object_12": 0.3, "structure_0": 0.6}
    changes = GraphChanges()
    changes.delete_edge("on", "object_3", "object_12")
    graph.commit(changes, graph.stamp_ns + 1)
    changes = GraphChanges()
    for support in sorted(shares, key=lambda support: support != first):
        changes.put(Edge(relation="on", source="object_3", target=support, value=shares[support], **SEEN))
    graph.commit(changes, graph.stamp_ns + 1)
    assert [row["on"] for row in object_rows(graph) if row["id"] == "object_3"] == ["structure_0"]


def test_our_own_json_is_the_snapshot() -> None:
    graph = home()
    assert SceneGraph.from_snapshot(Snapshot.model_validate_json(render_graph(graph, "json"))) == graph


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="unknown graph format 'graphmil'") as caught:
        export_graph(home(), "graphmil", tmp_path / "x")
    assert caught.value.hint == "did you mean 'graphml'?"
    with pytest.raises(ExportError, match="cannot be written"):
        export_graph(home(), "csv", tmp_path / "none" / "x")
    assert list(tmp_path.iterdir()) == []


# -- models for viewers ----------------------------------------------------------------------------------------------


def test_another_reader_finds_every_thing_of_the_model_where_it_is() -> None:
    trimesh = pytest.importorskip("trimesh")
    graph = home()
    scene = trimesh.load(io.BytesIO(render_graph(graph, "gltf")), file_type="glb")
    named = {name.split()[0]: name for name in scene.graph.nodes}
    assert {node.id for node in graph} <= set(named)
    assert named["object_3"].startswith("object_3 telly")
    T_gltf_map = scene.graph.get("map")[0]
    np.testing.assert_allclose(T_gltf_map @ (1, 2, 3, 1), (1, 3, -2, 1), atol=1e-9)  # y up
    for node in graph:
        T_gltf_thing, shape = scene.graph.get(named[node.id])
        if node.box is None:
            if "footprint" not in node.attributes:
                p_gltf = T_gltf_map @ (*node.position, 1)
                np.testing.assert_allclose(T_gltf_thing[:3, 3], p_gltf[:3], atol=1e-9)
            else:
                assert scene.geometry[shape].area == pytest.approx(7.0)  # of the triangle (0, 0), (4, 0), (4, 3.5)
            continue
        corners = trimesh.transform_points(scene.geometry[shape].vertices, np.linalg.inv(T_gltf_map) @ T_gltf_thing)
        distances = np.linalg.norm(corners[:, None] - node.box.corners()[None], axis=2)
        assert distances.min(axis=0).max() < 1e-6
        assert distances.min(axis=1).max() < 1e-6
    cube = scene.geometry[scene.graph.get(named["object_3"])[1]].copy()
    cube.merge_vertices(merge_norm=True, merge_tex=True)
    assert cube.is_watertight
    assert cube.is_winding_consistent
    assert cube.volume == pytest.approx(1.0)  # faces look outwards


def test_the_surface_is_in_the_model_with_its_colours() -> None:
    trimesh = pytest.importorskip("trimesh")
    mesh = Mesh(
        vertices=np.array([[0, 0, 0], [2, 0, 0], [0, 2, 1]], np.float32),
        triangles=np.array([[0, 1, 2]], np.int32),
        normals=np.tile(np.array([0, 0, 1], np.float32), (3, 1)),
        colors=np.array([[255, 0, 0], [0, 255, 0], [188, 188, 188]], np.uint8),
    )
    scene = trimesh.load(io.BytesIO(gltf_bytes(home(), mesh)), file_type="glb")
    T, shape = scene.graph.get("surface")
    found = scene.geometry[shape]
    np.testing.assert_allclose(
        trimesh.transform_points(found.vertices, T), [[0, 0, 0], [2, 0, 0], [0, 1, -2]], atol=1e-6
    )
    assert found.faces.tolist() == [[0, 1, 2]]
    red, green, grey = np.asarray(found.visual.vertex_attributes["color"])[:, :3] / 65535
    np.testing.assert_allclose((red, green), ((1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(grey, 0.5, atol=0.01)  # half the light, as 188 of 255 is in sRGB


def test_open3d_reads_the_model(tmp_path: Path) -> None:
    import open3d

    path = export_graph(home(), "gltf", tmp_path / "home.glb")
    model = open3d.io.read_triangle_model(str(path))
    assert len(model.meshes) == sum(node.box is not None or "footprint" in node.attributes for node in home())


def test_an_empty_model_is_one() -> None:
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.load(io.BytesIO(render_graph(SceneGraph(), "gltf")), file_type="glb")
    assert len(scene.geometry) == 0


# -- the table -------------------------------------------------------------------------------------------------------


def test_parquet_holds_the_same_table_with_types() -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    graph = home()
    table = pq.read_table(io.BytesIO(render_graph(graph, "parquet")))
    assert table.to_pylist() == object_rows(graph)
    kinds = {name: str(kind) for name, kind in zip(table.schema.names, table.schema.types, strict=True)}
    assert (kinds["id"], kinds["x_m"], kinds["last_seen_ns"]) == ("string", "double", "int64")


# -- graphs from files, asked and converted --------------------------------------------------------------------------


def test_a_graph_from_a_file_can_be_asked(tmp_path: Path) -> None:
    path = export_graph(home(), "spark_dsg", tmp_path / "home.json")
    with open_map(path) as asked:
        assert isinstance(asked, GraphFile)
        assert {row["X"].id for row in asked.ask("in(X, room_0)")} == {"object_3", "object_12"}
        assert asked.ask("on(object_3, table)").truth == "true"
        assert asked.ask("object(X), label(X, table)").truth == "true"


def test_a_stored_graph_without_a_map_can_be_asked_and_is_no_world(tmp_path: Path) -> None:
    save_graph(path := tmp_path / "home.sgm", home())
    with open_map(path) as asked:
        assert isinstance(asked, GraphFile)
        assert asked.ask("on(object_3, table)").truth == "true"
    with pytest.raises(StoreForeign, match="without a map") as caught:
        World.load(path)
    assert "ask --map" in str(caught.value.hint)


def test_a_graph_from_a_file_can_be_converted_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = export_graph(home(), "graphml", tmp_path / "home.graphml")
    out = tmp_path / "home.json"
    assert (
        app(["export", "--format", "spark_dsg", "--map", str(path), "--output", str(out)], standalone_mode=False) == 0
    )
    assert len(read_graph(out)) == len(home())
    assert app(["ask", "on(X, table)", "--map", str(out), "--json"], standalone_mode=False) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["answers"][0]["X"]["node"] == "object_3"
    assert app(["export", "--format", "ply", "--map", str(out), "--output", str(out)], standalone_mode=False) == 2
    assert "has none" in capsys.readouterr().err


def test_what_is_no_world_is_told_as_before(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be opened"):
        open_map(tmp_path / "none.world")
    (tmp_path / "some.world").write_bytes(b"\x00\x01" * 50)
    with pytest.raises(StoreForeign, match="not a stored world"):
        open_map(tmp_path / "some.world")


def test_parquet_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ExportError, match="pyarrow") as caught:
        render_graph(home(), "parquet")
    assert "tables" in str(caught.value.hint)
