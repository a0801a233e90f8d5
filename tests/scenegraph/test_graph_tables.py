"""Nodes and edges as tables, graphs made of them, and what is found by place."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenegraph.errors import InvalidGraphValue, InvariantViolated, SceneGraphError
from scenegraph.graph import Box, Edge, EdgeTable, GraphChanges, Node, NodeTable, SceneGraph, pack, unpack
from tests.scenegraph.test_graph import changes, consistent, histories, keys, kitchen, node
from tests.support.many_boxes import building


def from_tables(graph: SceneGraph) -> SceneGraph:
    """The same graph, made of tables."""
    nodes = NodeTable.of(graph.nodes())
    edges = EdgeTable.of(graph.edges(), {n: i for i, n in enumerate(nodes.ids)}, nodes.ids)
    return SceneGraph.from_tables(
        nodes, edges, revision=graph.revision, stamp_ns=graph.stamp_ns, tombstones=graph.tombstones()
    )


@settings(max_examples=80, deadline=None)
@given(histories)
def test_a_graph_of_tables_changes_as_any_other(history: list[tuple[list, int]]) -> None:
    one, two = kitchen(), from_tables(kitchen())
    assert two == one
    moments = [(two.stamp_ns, two.snapshot())]
    for steps, pause in history:
        stamp = two.stamp_ns + max(0, pause)
        told: list[object] = []
        for graph in (one, two):
            try:
                told.append(graph.commit(changes(*steps), stamp))
            except SceneGraphError as error:
                told.append(str(error))
        if isinstance(told[0], str):
            assert told[0] == told[1]
        else:
            assert told[0].revision == told[1].revision  # type: ignore[attr-defined]
        assert two == one
        assert consistent(two)
        nodes, edges = two.tables()
        assert (list(nodes), list(edges)) == (two.nodes(), two.edges())
        if moments[-1][0] == two.stamp_ns:
            moments.pop()
        moments.append((two.stamp_ns, two.snapshot()))
    arrays, document = pack(two)
    reread = unpack(arrays, json.loads(json.dumps(document)))
    assert reread.snapshot() == two.snapshot()
    for moment, snapshot in moments:
        for past in (two, reread):
            assert past.as_of(moment) == SceneGraph.from_snapshot(snapshot)


def test_values_of_a_table_are_as_good_as_any() -> None:
    graph = kitchen()
    for table, values in ((NodeTable.of(graph.nodes()), graph.nodes()), (tables_of(graph)[1], graph.edges())):
        assert list(table) == values
        assert table[-1] == values[-1]
        assert table[1:3] == values[1:3]
        for value, same in zip(table, values, strict=True):
            for again in (value, pickle.loads(pickle.dumps(value)), copy.deepcopy(value), value.model_copy()):
                assert again == same
                assert hash(again) == hash(same)
            assert value.model_dump_json() == same.model_dump_json()
            assert type(value).model_validate_json(value.model_dump_json()) == same
    assert table[0].replace(value=0.25).value == 0.25  # type: ignore[call-arg, union-attr]
    with pytest.raises(ValueError, match="read-only"):
        NodeTable.of(graph.nodes())[0].position[0] = 1.0


def tables_of(graph: SceneGraph) -> tuple[NodeTable, EdgeTable]:
    nodes = NodeTable.of(graph.nodes())
    return nodes, EdgeTable.of(graph.edges(), {n: i for i, n in enumerate(nodes.ids)}, nodes.ids)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"ids": ["a", "A"]}, "id: expected .* got 'A'"),
        ({"ids": ["a", "a"]}, "one twice"),
        ({"layers": "shelf"}, "layer: expected one of .* got 'shelf'"),
        ({"labels": ["cup"]}, "label: expected 2 texts, got 1"),
        ({"labels": ["cup", 3]}, "label: expected texts, got 3 in row b"),
        ({"center": [[0, 0, 0]]}, r"center: expected shape \(2, 3\), got \(1, 3\)"),
        ({"center": [[0, 0, 0], [0, np.nan, 0]]}, r"row 1 \(b\): center: expected finite numbers"),
        ({"center": None}, "position: required"),
        ({"size": [[1, 1, 1], [1, 1, -1]]}, r"row 1 \(b\): size: expected edge lengths ≥ 0"),
        ({"rotation_wxyz": [[1, 0, 0, 0], [1, 1, 0, 0]]}, r"row 1 \(b\): rotation_wxyz: expected a unit quaternion"),
        ({"yaw": 0.1, "rotation_wxyz": [1, 0, 0, 0]}, "either a yaw or"),
        ({"confidence": [0.5, 1.5]}, r"row 1 \(b\): confidence: expected a number from 0 to 1"),
        ({"first_seen_ns": 9, "last_seen_ns": 8}, r"row 0 \(a\): first_seen_ns: expected one no later"),
        ({"attributes": {2: {}}}, "rows of 0 … 1, got 2"),
        ({"attributes": {0: {"a": object()}}}, "row 0: attributes: attributes.a: expected a JSON value"),
    ],
)
def test_a_bad_column_is_named(fields: dict[str, object], said: str) -> None:
    good = {"ids": ["a", "b"], "layers": "object", "labels": "cup", "center": np.zeros((2, 3)), "size": (1, 1, 1)}
    assert len(NodeTable.columns(**good)) == 2
    with pytest.raises(InvalidGraphValue, match=said):
        NodeTable.columns(**{**good, **fields})


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"target": [0, 5]}, "row 1 .*: target: expected a row of the 3 nodes, got 5"),
        ({"target": [0, 2**32 + 1]}, "target: expected a row"),
        ({"target": [1, 2]}, "two different ends"),
        ({"relations": "On"}, "relation: expected"),
        ({"value": [0.1, np.inf]}, "row 1 .*: value: expected finite"),
        ({"confidence": -0.1}, "row 0 .*: confidence"),
    ],
)
def test_a_bad_column_of_edges_is_named(fields: dict[str, object], said: str) -> None:
    good = {"ids": ("a", "b", "c"), "relations": "on", "source": [1, 2], "target": [0, 0]}
    assert EdgeTable.columns(**good)[1].value is None
    with pytest.raises(InvalidGraphValue, match=said):
        EdgeTable.columns(**{**good, **fields})


@given(
    st.lists(
        st.tuples(
            st.tuples(*[st.sampled_from([0.0, -0.0, 0.1, 1 / 3, 1e9, 1e306, 0.00001])] * 3),
            st.sampled_from([None, 0.0, 0.12345, 1 / 7, 1e-9, -3.0]),
            st.integers(-(2**62), 2**62),
            st.sampled_from(["cup", "Süße Tür", "", "a\nb"]),
            st.sampled_from([(), (1, "robot/camera@1"), (2**70,)]),
            st.sampled_from([{}, {"name": "x", "polygon": [[0.1, 2]], "n": None}]),
        ),
        max_size=5,
    )
)
def test_whatever_is_in_a_graph_is_in_its_compact_form(drawn: list) -> None:
    graph = SceneGraph()
    wishes = GraphChanges()
    for n, (position, value, stamp, label, evidence, attributes) in enumerate(drawn):
        box = None if value is None else Box(center=position, size=np.abs(position))
        seen = {"first_seen_ns": stamp, "last_seen_ns": stamp, "attributes": attributes}
        wishes.put(Node(id=f"n_{n}", layer="object", label=label, position=position, box=box, **seen))
        if n:
            wishes.put(Edge(relation="on", source=f"n_{n}", target="n_0", value=value, evidence=evidence, **seen))
    graph.commit(wishes, 5)
    arrays, document = pack(graph)
    again = unpack(arrays, json.loads(json.dumps(document)))
    assert again == graph
    assert again.snapshot().model_dump_json() == graph.snapshot().model_dump_json()  # also the signs of zeros


@pytest.mark.parametrize(
    "spoil",
    [
        lambda a, d: a.pop("edge_source"),
        lambda a, d: a.update(edge_source=a["edge_source"] + 100),
        lambda a, d: a.update(node_layer=a["node_layer"] + 9),
        lambda a, d: a.update(ids=a["ids"][:-9]),
        lambda a, d: a.update(node_position=a["node_position"][1:]),
        lambda a, d: d["edges"].update(relations=[]),
        lambda a, d: d.pop("tombstones"),
        lambda a, d: d["nodes"].update(attributes=3),
        lambda a, d: d["past"]["tombstones"].append({}),
        lambda a, d: a.update(past_node_name=a["past_node_name"] + 99),
        lambda a, d: a.update(past_edge_there=~a["past_edge_there"]),
        lambda a, d: a.update(past_steps=a["past_steps"] + 1),
        lambda a, d: a.update(past_node_there=~a["past_node_there"]),
    ],
)
def test_a_compact_form_that_does_not_fit_is_refused(spoil: Callable[[dict, dict], object]) -> None:
    arrays, document = pack(kitchen())
    spoil(arrays, document)
    with pytest.raises((InvalidGraphValue, InvariantViolated)):
        unpack(arrays, document)


def test_tables_that_are_no_graph_are_refused() -> None:
    nodes, edges = tables_of(kitchen())
    with pytest.raises(InvariantViolated, match="differ"):
        SceneGraph.from_tables(NodeTable.of(kitchen().nodes()[1:]), edges)
    twice = EdgeTable.columns(nodes.ids, "on", [0, 0], [1, 1])
    with pytest.raises(InvariantViolated, match=r"edge on\(object_0, object_1\) is there twice"):
        SceneGraph.from_tables(nodes, twice)
    with pytest.raises(InvariantViolated, match="same id"):
        NodeTable.of([*kitchen().nodes(), *kitchen().nodes()])


def test_the_same_edge_is_made_once() -> None:
    graph = from_tables(kitchen())
    assert graph.edge("on", "object_0", "object_1") is graph.edges("on")[0]
    assert graph.node("room_0") is graph.nodes("room")[0]
    assert keys(graph.edges_of("object_1")) == keys(kitchen().edges_of("object_1"))


# -- by place --------------------------------------------------------------------------------------------------------


def away(node: Node, p: np.ndarray) -> float:
    """Distance of a point from a node."""
    if node.box is None:
        return float(np.linalg.norm(p - node.position))
    local = np.abs((p - node.box.center) @ node.box.rotation) - 0.5 * node.box.size
    return float(np.linalg.norm(np.maximum(local, 0.0)))


numbers = st.floats(-30, 30)
quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(c * c for c in q) > 1e-2)
placed = st.tuples(
    st.integers(0, 11), st.tuples(numbers, numbers, numbers), st.tuples(*[st.floats(0, 40)] * 3), quaternions
)
moves = st.lists(st.lists(st.one_of(placed, st.integers(0, 11)), max_size=6), max_size=6)


@settings(max_examples=60, deadline=None)
@given(moves, st.tuples(numbers, numbers, numbers), st.floats(0, 60), st.booleans())
def test_what_is_found_by_place_is_what_a_look_at_all_finds(
    history: list[list], point: tuple, radius: float, tables: bool
) -> None:
    graph = SceneGraph()
    p = np.array(point)
    for steps in [[(n, (n, 0, 0), (n % 3,) * 3, [1, 0, 0, 0]) for n in range(6)], *history]:
        wishes = GraphChanges()
        for step in steps:
            if isinstance(step, int):
                if f"n_{step}" in graph and not any(w.id == f"n_{step}" for w in wishes.steps):  # type: ignore[union-attr]
                    wishes.delete_node(f"n_{step}", "gone")
                continue
            n, center, size, q = step
            box = None if n % 4 == 3 else Box(center=center, size=size, rotation_wxyz=np.array(q) / np.linalg.norm(q))
            layer = "room" if n % 2 else "object"
            wishes.put(
                Node(id=f"n_{n}", layer=layer, label="x", position=center, box=box, first_seen_ns=0, last_seen_ns=0)
            )
        graph.commit(wishes, 1)
        if tables:
            graph, tables = from_tables(graph), False
        for layer in (None, "object", "room", "agent"):
            found = graph.within(p, radius, layer)  # type: ignore[arg-type]
            expected = {n.id: away(n, p) for n in graph.nodes(layer)}  # type: ignore[arg-type]
            assert {n.id for n, _ in found} >= {i for i, d in expected.items() if d <= radius - 1e-9}
            assert {n.id for n, _ in found} <= {i for i, d in expected.items() if d <= radius + 1e-9}
            assert [d for _, d in found] == sorted(d for _, d in found)
            assert all(d == pytest.approx(expected[n.id], abs=1e-9) for n, d in found)
            assert [(n.id, d) for n, d in found] == list(zip(found.ids, found.distances, strict=True))
            assert [found[k] for k in range(len(found))] == list(found) == [*found[:2], *found[2:]]
        low, high = p - radius / 3, p + radius / 2
        inside = {
            n.id
            for n in graph
            if n.box is not None and ((n.box.corners() >= low) & (n.box.corners() <= high)).all(1).any()
        }
        inside |= {n.id for n in graph if n.box is not None and n.box.contains(0.5 * (low + high))}
        beyond = {n.id for n in graph if n.box is not None and (n.box.corners().min(0) > high).any()}
        beyond |= {n.id for n in graph if n.box is not None and (n.box.corners().max(0) < low).any()}
        got = {n.id for n in graph.in_box(low, high)}
        assert inside <= got
        assert not beyond & got


def test_a_past_graph_is_found_by_place_as_it_was() -> None:
    graph = kitchen()
    assert [n.id for n, _ in graph.within((2, 0, 0), 0.5)] == ["object_2"]
    graph.commit(changes(Node(**{**graph.node("object_2").__dict__, "position": (9, 0, 0)})), 20)
    assert list(graph.within((2, 0, 0), 0.5)) == []
    assert [n.id for n, _ in graph.as_of(10).within((2, 0, 0), 0.5)] == ["object_2"]


def test_what_was_found_stays_as_it_was() -> None:
    graph = from_tables(kitchen())
    found = graph.within((0, 0, 0), 1.5)
    graph.commit(changes(node("object_0", 5), ("object_1",), node("object_3", 1)), 20)
    assert [(n.id, n.position[0], d) for n, d in found] == [("object_0", 0, 0), ("room_0", 0, 0), ("object_1", 1, 1)]


def test_a_far_place_is_found_too() -> None:
    graph = SceneGraph()
    far = (1e12, -1e12, 1e9)
    graph.commit(changes(Node(id="a", layer="object", label="x", position=far, first_seen_ns=0, last_seen_ns=0)), 1)
    assert [n.id for n, _ in graph.within(far, 1.0)] == ["a"]
    assert not graph.within((0, 0, 0), 1e6)
    assert len(graph.within((0, 0, 0), 1e13)) == 1


@pytest.mark.parametrize("bad", [((0, 0), 1.0), ((0, 0, np.nan), 1.0), ((0, 0, 0), -1.0), ((0, 0, 0), np.nan)])
def test_a_place_that_is_none_is_refused(bad: tuple) -> None:
    with pytest.raises(InvalidGraphValue, match="within: expected"):
        kitchen().within(*bad)
    with pytest.raises(InvalidGraphValue, match="in_box: expected"):
        kitchen().in_box((0, 0, 1), (0, 0, 0))


def test_a_whole_building_is_one_graph() -> None:
    nodes, edges = building(4, 30)
    graph = SceneGraph.from_tables(nodes, edges)
    assert consistent(graph)
    assert len(graph.nodes("object")) == 120
    assert {e.target for e in graph.edges("in", source="room_2")} == {"storey_2"}
    put = GraphChanges()
    put.put(Edge(relation="near", source="object_1", target="object_2", first_seen_ns=0, last_seen_ns=0))
    graph.commit(put, 3_000)
    assert graph.relations() == ["in", "contains", "near"]
