"""Graphs come back from other programs' formats as they went out, and theirs come in whole."""

from __future__ import annotations

import copy
import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenegraph.errors import GraphUnreadable
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph
from scenegraph.interop import (
    from_networkx,
    read_graph,
    read_graphml,
    read_node_link,
    read_spark_dsg,
    render_graph,
    spark_dsg_document,
)
from tests.support.graphs import graphs
from tests.support.recordings import recording

FILES = ("apartment_dsg.json", "heracles_example_dsg.json")
HEIGHTS = {"object": 2, "agent": 2, "place": 3, "room": 4, "building": 5}


def recorded(name: str) -> Path:
    return recording("spark_dsg_scene_graphs") / name


def pairs(graph: SceneGraph) -> set[frozenset[str]]:
    return {frozenset((edge.source, edge.target)) for edge in graph.edges()}


# -- ours, there and back --------------------------------------------------------------------------------------------


@given(graphs())
@settings(max_examples=60)
def test_spark_dsg_gives_every_graph_back(graph: SceneGraph) -> None:
    assert read_spark_dsg(json.loads(render_graph(graph, "spark_dsg"))) == graph


@given(graphs())
@settings(max_examples=60)
def test_node_link_and_networkx_give_every_graph_back(graph: SceneGraph) -> None:
    assert read_node_link(json.loads(render_graph(graph, "node_link"))) == graph
    network = graph.to_networkx()
    network.graph["tombstones"] = graph.tombstones()
    assert from_networkx(network) == graph


@given(graphs())
@settings(max_examples=60)
def test_graphml_gives_every_graph_back(graph: SceneGraph) -> None:
    assert read_graphml(render_graph(graph, "graphml").decode()) == graph


@pytest.mark.parametrize("name", ["json", "spark_dsg", "node_link", "graphml"])
def test_a_file_is_known_by_what_is_in_it(name: str, tmp_path: Path) -> None:
    graph = read_graph(recorded(FILES[1]))
    (tmp_path / "graph").write_bytes(render_graph(graph, name))
    assert read_graph(tmp_path / "graph") == graph


@given(graphs())
@settings(max_examples=20)
def test_spark_dsg_itself_keeps_our_graph(graph: SceneGraph) -> None:
    """Loaded and saved by their package, only boxes are rounded to single precision, and the wider number wins."""
    spark_dsg = pytest.importorskip("spark_dsg")
    again = read_spark_dsg(json.loads(_through(spark_dsg, spark_dsg_document(graph))))
    assert len(again) == len(graph)
    assert {edge.key for edge in again.edges()} == {edge.key for edge in graph.edges()}
    for node in graph:
        same = again.node(node.id)
        assert same.replace(box=None, position=node.position) == node.replace(box=None)
        np.testing.assert_allclose(same.position, node.position, atol=1e-12)
        assert (same.box is None) == (node.box is None)


def _through(spark_dsg: Any, document: dict[str, Any]) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "graph.json"
        path.write_text(json.dumps(document))
        spark_dsg.DynamicSceneGraph.load(str(path)).save(str(path), False)
        return path.read_text()


# -- theirs ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_their_files_have_as_many_nodes_and_edges_here_by_layer(name: str) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    theirs = spark_dsg.DynamicSceneGraph.load(str(recorded(name)))
    ours = read_graph(recorded(name))
    kinds = {2: "object", 3: "place", 4: "room", 5: "building"}
    nodes = Counter({kinds[layer.id]: layer.num_nodes() for layer in theirs.layers})
    for layer in theirs.layer_partitions:
        nodes["agent" if layer.id == 2 else kinds[layer.id]] += layer.num_nodes()
    assert Counter(node.layer for node in ours) == +nodes
    between = Counter(
        tuple(sorted((theirs.get_node(e.source).layer.layer, theirs.get_node(e.target).layer.layer)))
        for e in theirs.edges
    )
    assert len(pairs(ours)) == theirs.num_edges()
    assert Counter(tuple(sorted(HEIGHTS[ours.node(i).layer] for i in pair)) for pair in pairs(ours)) == between


@pytest.mark.parametrize("name", FILES)
def test_their_attributes_are_kept(name: str) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    theirs = spark_dsg.DynamicSceneGraph.load(str(recorded(name)))
    by_symbol = {node.attributes["spark_dsg"]["id"]: node for node in read_graph(recorded(name))}
    for node in theirs.nodes:
        ours, their = by_symbol[node.id.value], node.attributes
        np.testing.assert_allclose(ours.position, their.position)
        if ours.layer == "agent":
            turn = their.world_R_body
            np.testing.assert_allclose(ours.box.rotation_wxyz, (turn.w, turn.x, turn.y, turn.z), atol=1e-9)
            continue
        assert ours.attributes.get("name", "") == their.name
        if their.bounding_box.type != spark_dsg.BoundingBoxType.INVALID:
            np.testing.assert_allclose(ours.box.center, their.bounding_box.world_P_center, atol=1e-6)
            np.testing.assert_allclose(ours.box.size, their.bounding_box.dimensions, atol=1e-6)
        else:
            assert ours.box is None
        if ours.layer == "object":
            assert ours.attributes["mesh_connections"] == list(their.mesh_connections)
        if isinstance(their, spark_dsg.PlaceNodeAttributes):
            assert ours.attributes["clearance_m"] == pytest.approx(their.distance)
    if "heracles" in name:
        space = theirs.get_labelspace(2, 0)
        for node in theirs.get_layer(2).nodes:
            assert by_symbol[node.id.value].label == space.get_category(node.attributes.semantic_label)


@pytest.mark.parametrize("name", FILES)
def test_their_files_are_written_back_as_they_were(name: str, tmp_path: Path) -> None:
    """By the package's own account, but for the stamps of agents, which it drops from the older format itself."""
    spark_dsg = pytest.importorskip("spark_dsg")
    ours = read_graph(recorded(name))
    document = spark_dsg_document(ours)
    assert read_spark_dsg(json.loads(json.dumps(document))) == ours
    (tmp_path / "ours.json").write_text(json.dumps(document))
    spark_dsg.DynamicSceneGraph.load(str(tmp_path / "ours.json")).save(str(tmp_path / "back.json"), False)
    spark_dsg.DynamicSceneGraph.load(str(recorded(name))).save(str(tmp_path / "theirs.json"), False)
    back, theirs = (json.loads((tmp_path / f"{which}.json").read_text()) for which in ("back", "theirs"))
    found = {node["id"]: node for node in back["nodes"]}
    for node in theirs["nodes"]:
        same = found[node["id"]]
        for one in (same, node):
            one["attributes"].pop("metadata")
            one["attributes"].pop("timestamp", None)
        assert same == node
    weights = {frozenset((e["source"], e["target"])): e["info"]["weight"] for e in theirs["edges"]}
    assert {frozenset((e["source"], e["target"])): e["info"]["weight"] for e in back["edges"]} == weights


def test_places_of_the_newest_kinds_are_read(tmp_path: Path) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    graph = spark_dsg.DynamicSceneGraph()
    graph.add_layer(3, 2, "TRAVERSABILITY")
    place = spark_dsg.TraversabilityNodeAttributes()
    place.position, place.distance, place.first_observed_ns, place.last_observed_ns = [1, 2, 3], 0.7, 5, 9
    place.boundary.min, place.boundary.max = [-1, -2], [1, 2]
    graph.add_node(3, spark_dsg.NodeSymbol("t", 4).value, place, 2)
    thing = spark_dsg.KhronosObjectAttributes()
    thing.semantic_label = 2
    thing.bounding_box = spark_dsg.BoundingBox(
        spark_dsg.BoundingBoxType.OBB, [1, 2, 3], [4, 5, 6], np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    )
    graph.add_node(2, spark_dsg.NodeSymbol("O", 7).value, thing)
    graph.save(str(tmp_path / "new.json"), False)
    document = json.loads((tmp_path / "new.json").read_text())
    for record in document["nodes"]:
        if record["layer"] == 2:  # the package lets nobody set these
            record["attributes"] |= {"first_observed_ns": [3, 20], "last_observed_ns": [10, 30]}
    ours = read_graph(_written(tmp_path, document), labels={2: "cup"})
    (read,) = ours.nodes("place")
    assert read.attributes["traversability"]["min"] == [-1, -2]
    assert (read.attributes["clearance_m"], read.first_seen_ns, read.last_seen_ns) == (pytest.approx(0.7), 5, 9)
    (cup,) = ours.nodes("object")
    assert (cup.label, cup.first_seen_ns, cup.last_seen_ns) == ("cup", 3, 30)
    np.testing.assert_allclose(cup.box.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    again = spark_dsg.DynamicSceneGraph.load(_written(tmp_path, spark_dsg_document(ours)))
    same = again.get_node(spark_dsg.NodeSymbol("t", 4).value).attributes
    assert isinstance(same, spark_dsg.TraversabilityNodeAttributes)
    assert list(same.boundary.max) == [1, 2]


def _written(folder: Path, document: dict[str, Any]) -> str:
    (folder / "written.json").write_text(json.dumps(document))
    return str(folder / "written.json")


def test_what_changed_here_is_written_and_read_there() -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    graph = read_graph(recorded(FILES[1]))
    changes = GraphChanges()
    moved = graph.nodes("object")[0].replace(
        position=(7, 8, 9), label="sofa", box=Box.from_yaw((7, 8, 9), (1, 2, 3), 0.4)
    )
    changes.put(moved)
    changes.put(
        Edge(relation="on", source=moved.id, target=graph.nodes("object")[1].id, first_seen_ns=1, last_seen_ns=1)
    )
    graph.commit(changes, 1)
    document = spark_dsg_document(graph)
    again = read_spark_dsg(json.loads(json.dumps(document)))
    assert [_without_origin(node) for node in again] == [_without_origin(node) for node in graph]
    assert {edge.key: edge for edge in again.edges()} == {edge.key: edge for edge in graph.edges()}
    with tempfile.TemporaryDirectory() as folder:
        theirs = spark_dsg.DynamicSceneGraph.load(_written(Path(folder), document))
    node = theirs.get_node(moved.attributes["spark_dsg"]["id"]).attributes
    np.testing.assert_allclose(node.position, (7, 8, 9))
    np.testing.assert_allclose(node.bounding_box.world_R_center, moved.box.rotation, atol=1e-6)
    assert theirs.get_labelspace(2, 0).get_category(node.semantic_label) == "sofa"


def _without_origin(node: Node) -> Node:
    return node.replace(attributes={key: value for key, value in node.attributes.items() if key != "spark_dsg"})


# -- what is no graph ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "neither JSON nor GraphML"),
        ("[]", "JSON, but no graph"),
        ('{"a": 1}', "JSON, but no graph"),
        ("<html></html>", "GraphML"),
        (
            '{"layer_ids": [2], "nodes": [{"id": 1, "layer": 2, "attributes": {"type": "X"}}]}',
            r"nodes\[0\]: 'position'",
        ),
        (
            '{"layer_ids": [9], "nodes": [{"id": 1, "layer": 9, "attributes": {"type": "X", "position": [0,0,0]}}]}',
            r"nodes\[0\]: layer 9 has no counterpart",
        ),
        ('{"layer_ids": [2], "nodes": [], "edges": [{"source": 1, "target": 2}]}', r"edges\[0\]: 1 is missing"),
        ('{"nodes": [{"id": "a"}], "edges": [], "multigraph": true, "graph": {}}', "node 'a': Node.layer"),
        ('{"revision": 1, "nodes": 3}', "Snapshot"),
    ],
)
def test_what_is_no_graph_is_refused_in_one_line(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "graph.json"
    path.write_text(text)
    with pytest.raises(GraphUnreadable, match=told) as caught:
        read_graph(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def parts_of(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all that lies in a JSON value."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inside:
        yield (*path, key)
        yield from parts_of(item, (*path, key))


JUNK = (None, True, -1, 1.5, float("inf"), 10**30, "", "x", "No Id", [], {}, [1, 2], [None], {"a": 1})


@pytest.mark.parametrize("name", ["json", "spark_dsg", "node_link"])
@given(graph=graphs(), choice=st.randoms(use_true_random=False))
@settings(max_examples=150, deadline=None)
def test_whatever_is_damaged_in_a_file_is_refused_in_one_line(name: str, graph: SceneGraph, choice: Random) -> None:
    document = json.loads(render_graph(graph, name))
    for _ in range(choice.randint(1, 2)):
        *way, last = choice.choice(list(parts_of(document)))
        place = document
        for key in way:
            place = place[key]
        if choice.random() < 0.2:
            del place[last]
        else:
            place[last] = copy.deepcopy(choice.choice(JUNK))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "graph.json"
        path.write_text(json.dumps(document))
        told = ""
        try:
            read_graph(path)  # what is damaged may be nothing that counts
        except GraphUnreadable as error:
            told = str(error)
        assert "\n" not in told


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(GraphUnreadable, match="cannot be read"):
        read_graph(tmp_path / "none.json")
