"""Two graphs of one home become one: laws on random homes, and truth where it is known who is who."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3
from scenegraph.cli import app
from scenegraph.errors import InvalidGraphValue, JoinRefused
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph
from scenegraph.interop import export_graph, read_graph, render_graph
from scenegraph.joining import JoinReport, join
from scenegraph.store import save_graph
from tests.support.furnished import furnished, seen_by_another, turned
from tests.support.graphs import graphs

seeds = st.integers(0, 10_000)
poses = st.builds(turned, st.floats(-3.1, 3.1), st.floats(-20, 20), st.floats(-20, 20), st.floats(-0.5, 0.5))


def copied(graph: SceneGraph) -> SceneGraph:
    return SceneGraph.from_snapshot(graph.snapshot())


def joined(ours: SceneGraph, theirs: SceneGraph, T: SE3 | None = None, **options: Any) -> tuple[SceneGraph, JoinReport]:
    whole = copied(ours)
    changes, report = join(whole, theirs, T, **options)
    whole.commit(changes, 3000)
    return whole, report


def world(*things: tuple[str, str, float, float], **fields: Any) -> SceneGraph:
    changes = GraphChanges()
    for node_id, label, x, y in things:
        box = Box(center=(x, y, 0.5), size=(0.5, 0.5, 1.0))
        times = {"first_seen_ns": 0, "last_seen_ns": 1}
        changes.put(Node(id=node_id, layer="object", label=label, position=(x, y, 0.5), box=box, **{**times, **fields}))
    graph = SceneGraph()
    graph.commit(changes, 1)
    return graph


# -- laws ------------------------------------------------------------------------------------------------------------


@given(graphs())
@settings(max_examples=40)
def test_a_graph_joined_with_itself_is_itself(graph: SceneGraph) -> None:
    rooms = {node.id for node in graph.nodes("room")}
    assume(all(sum(e.target in rooms for e in graph.edges("in", source=node.id)) < 2 for node in graph))
    whole, report = joined(graph, graph, SE3.identity())
    assert whole == graph
    assert all(report.ids[node.id] == node.id for node in graph)
    assert not report.conflicts


@given(seeds)
@settings(max_examples=6)
def test_a_home_joined_with_itself_is_itself_wherever_it_is_found_to_lie(seed: int) -> None:
    home = furnished(seed)
    whole, report = joined(home, home)
    assert report.alignment is not None
    assert report.T_ours_theirs.isclose(SE3.identity(), atol=1e-6)
    again, _ = joined(home, home, SE3.identity())
    assert again == home
    assert {node.id for node in whole} == {node.id for node in home}


@given(seeds, st.floats(0.3, 1.0), poses)
@settings(max_examples=10)
def test_joined_twice_is_joined_once(seed: int, share: float, T: SE3) -> None:
    home = furnished(seed)
    ours, _ = seen_by_another(home, seed + 1, share=share)
    theirs, _ = seen_by_another(home, seed + 2, share=share, T_map_home=T)
    once, report = joined(ours, theirs, T.inverse())
    twice, again = joined(once, theirs, T.inverse())
    assert twice == once
    assert dict(again.ids) == dict(report.ids)
    assert not again.added


@given(seeds, st.floats(0.4, 1.0), poses)
@settings(max_examples=10)
def test_whose_graph_is_ours_decides_ids_but_not_what_there_is(seed: int, share: float, T: SE3) -> None:
    home = furnished(seed)
    one, _ = seen_by_another(home, seed + 1, share=share)
    other, _ = seen_by_another(home, seed + 2, share=share, T_map_home=T)
    a, _ = joined(one, other, T.inverse())
    b, report = joined(other, one, T)
    assert len(a) == len(b)
    assert a.n_edges == b.n_edges
    T_a_b = T.inverse()

    def things(graph: SceneGraph, T_a: SE3) -> list[tuple[Any, ...]]:
        return sorted(
            (node.layer, node.label, *np.round(T_a @ node.position, 3).tolist(), node.confidence) for node in graph
        )

    for left, right in zip(things(a, SE3.identity()), things(b, T_a_b), strict=True):
        assert left[:2] == right[:2]
        np.testing.assert_allclose(left[2:], right[2:], atol=2e-3)
    assert all(id_ in other for id_ in {j.ours for j in report.joined})


@given(graphs(), graphs())
@settings(max_examples=40)
def test_any_two_graphs_can_be_joined_and_ours_keep_their_ids(ours: SceneGraph, theirs: SceneGraph) -> None:
    whole, report = joined(ours, theirs, SE3.identity())
    assert {node.id for node in ours} <= {node.id for node in whole}
    assert report.ids.keys() >= {node.id for node in theirs}
    assert all(new in whole for new in report.ids.values())
    assert len(whole) == len(ours) + len(report.added)
    layers = {node.id: node.layer for node in theirs}
    assert all(whole.node(report.ids[i]).layer == layer for i, layer in layers.items())
    json.dumps(report.as_json())


@given(seeds, st.floats(0.3, 1.0))
@settings(max_examples=6)
def test_nothing_stands_on_itself_and_everything_is_in_one_room(seed: int, share: float) -> None:
    home = furnished(seed)
    ours, _ = seen_by_another(home, seed + 1, share=share)
    theirs, _ = seen_by_another(home, seed + 2, share=share, noise_m=0.15)
    whole, _ = joined(ours, theirs, SE3.identity())
    on = {(e.source, e.target) for e in whole.edges("on")}
    reach = dict.fromkeys((s for s, _ in on), 0)
    for _ in range(len(reach) + 1):
        on |= {(a, d) for a, b in on for c, d in on if b == c}
        if len(reach) > 6:
            break
    assert all(a != b for a, b in on)
    for node in whole.nodes("object"):
        rooms = [e.target for e in whole.edges("in", source=node.id) if whole.node(e.target).layer == "room"]
        assert len(rooms) <= 1
        for room in rooms:
            assert ("contains", room, node.id) in whole


# -- truth -----------------------------------------------------------------------------------------------------------


@given(seeds, poses)
@settings(max_examples=10)
def test_the_same_things_are_joined_and_no_others(seed: int, T: SE3) -> None:
    """Two robots see four fifths of a home each, 3 cm off, each in a map of its own; nothing tells how these lie."""
    home = furnished(seed)
    ours, of_ours = seen_by_another(home, seed + 1)
    theirs, of_theirs = seen_by_another(home, seed + 2, T_map_home=T)
    _, report = joined(ours, theirs)
    wrong = report.T_ours_theirs @ T
    assert np.linalg.norm(wrong.translation) < 0.1
    assert math.acos(min(1.0, (np.trace(wrong.rotation) - 1) / 2)) < math.radians(1.0)
    in_both = set(of_ours.values()) & set(of_theirs.values())
    found = {(of_ours[pair.ours], of_theirs[pair.theirs]) for pair in report.joined}
    assert found == {(thing, thing) for thing in in_both}


def test_edges_are_hung_onto_the_joined_things() -> None:
    home = furnished(5)
    ours, of_ours = seen_by_another(home, 6, share=0.6)
    theirs, of_theirs = seen_by_another(home, 7, share=0.6)
    whole, report = joined(ours, theirs, SE3.identity())
    true_of = of_ours | {report.ids[their_id]: true for their_id, true in of_theirs.items()}
    for edge in theirs.edges():
        assert (edge.relation, report.ids[edge.source], report.ids[edge.target]) in whole
    for edge in whole.edges():
        assert (edge.relation, true_of[edge.source], true_of[edge.target]) in home
    assert report.edges_added + report.edges_shared == theirs.n_edges


def test_a_thing_that_moved_is_where_it_was_seen_last() -> None:
    ours = world(("object_1", "chair", 0.0, 0.0), confidence=0.99, last_seen_ns=10)
    theirs = world(("object_7", "chair", 0.24, 0.0), confidence=0.6, last_seen_ns=20)
    whole, report = joined(ours, theirs, SE3.identity())
    (chair,) = whole.nodes("object")
    assert (chair.id, chair.position[0], chair.confidence, chair.last_seen_ns) == ("object_1", 0.24, 0.99, 20)
    assert report.joined[0].kept == "theirs: seen later, and it has moved"
    assert chair.attributes["known_as"] == ["theirs/object_7"]


def test_things_of_one_class_far_apart_are_two() -> None:
    ours, theirs = world(("object_1", "chair", 0, 0)), world(("object_1", "chair", 2, 0))
    whole, report = joined(ours, theirs, SE3.identity(), name="spot")
    assert report.added == ("object_1_spot",)
    assert whole.node("object_1_spot").attributes["known_as"] == ["spot/object_1"]
    assert dict(report.ids) == {"object_1": "object_1_spot"}


def test_a_thing_with_two_classes_takes_the_surer_and_the_report_says_so() -> None:
    ours = world(("object_1", "chair", 0, 0), confidence=0.6)
    theirs = world(("object_2", "armchair", 0.05, 0), confidence=0.8)
    whole, report = joined(ours, theirs, SE3.identity())
    assert whole.node("object_1").label == "armchair"
    (conflict,) = report.conflicts
    assert (conflict.kind, conflict.ours, conflict.theirs, conflict.stays) == ("label", "chair", "armchair", "theirs")
    assert "0.60 here, 0.80 there" in conflict.why
    back, report = joined(theirs, ours, SE3.identity())
    assert back.node("object_2").label == "armchair"
    assert report.conflicts[0].stays == "ours"


def test_a_name_given_here_stays() -> None:
    ours = world(("object_1", "chair", 0, 0), attributes={"name": "throne"})
    theirs = world(("object_2", "chair", 0, 0), attributes={"name": "seat", "color": "red"}, confidence=1.0)
    whole, report = joined(ours, theirs, SE3.identity())
    assert whole.node("object_1").attributes["name"] == "throne"
    assert whole.node("object_1").attributes["color"] == "red"
    assert [(c.kind, c.stays) for c in report.conflicts] == [("name", "ours")]


def test_a_thing_in_two_rooms_is_in_that_of_the_better_sight() -> None:
    def with_room(graph: SceneGraph, room: str, x: float) -> SceneGraph:
        changes = GraphChanges()
        times = {"first_seen_ns": 0, "last_seen_ns": 1}
        footprint = [[x, -2], [x + 4, -2], [x + 4, 2], [x, 2]]
        changes.put(
            Node(
                id=room,
                layer="room",
                label="room",
                position=(x + 2, 0, 0),
                attributes={"footprint": footprint},
                **times,
            )
        )
        (thing,) = graph.nodes("object")
        changes.put(Edge(relation="in", source=thing.id, target=room, **times))
        changes.put(Edge(relation="contains", source=room, target=thing.id, **times))
        graph.commit(changes, 2)
        return graph

    ours = with_room(world(("object_1", "chair", 0.0, 0), confidence=0.5), "room_1", -4)
    theirs = with_room(world(("object_1", "chair", 0.1, 0), confidence=0.9), "room_1", 0)
    whole, report = joined(ours, theirs, SE3.identity())
    assert [e.target for e in whole.edges("in", source="object_1")] == ["room_1_theirs"]
    assert [e.target for e in whole.edges("contains")] == ["object_1"]
    assert [(c.kind, c.stays) for c in report.conflicts] == [("room", "theirs")]
    back, report = joined(theirs, ours, SE3.identity())
    assert [e.target for e in back.edges("in", source="object_1")] == ["room_1"]
    assert report.edges_dropped == 2


def two_storeys(first: int) -> SceneGraph:
    """A room on each of two storeys, of which the lower has this number, a way between them and a part of a thing."""
    times = {"first_seen_ns": 0, "last_seen_ns": 1}
    changes = GraphChanges()
    for height, number in ((0.0, first), (3.0, 3 - first)):
        about = {"storey": number, "footprint": [[0, 0], [4, 0], [4, 3], [0, 3]], "floor_z": height}
        changes.put(
            Node(
                id=f"storey_{number}", layer="storey", label="storey", position=(2, 1.5, height),
                attributes={"number": number, "floor_z": height}, **times,
            )
        )  # fmt: skip
        changes.put(
            Node(id=f"room_{number}", layer="room", label="room", position=(2, 1.5, height), attributes=about, **times)
        )
    changes.put(Node(id="stairs_1", layer="structure", label="stairs", position=(1, 1, 1.5), **times))
    for number in (1, 2):
        changes.put(
            Edge(
                relation="connects", source="stairs_1", target=f"room_{number}", attributes={"at": [1.0, 1.0]}, **times
            )
        )
    part = {"split_from": "object_1"}
    changes.put(Node(id="object_1", layer="object", label="rack", position=(3, 2, 0.5), **times))
    changes.put(Node(id="object_2", layer="object", label="crate", position=(3, 1, 0.5), attributes=part, **times))
    graph = SceneGraph()
    graph.commit(changes, 1)
    return graph


def test_what_names_a_storey_a_thing_or_a_place_of_their_map_names_ours() -> None:
    T = turned(0.5 * math.pi, 10.0, 0.0, 0.0)
    whole, report = joined(SceneGraph(), two_storeys(1), T, name="spot")
    for edge in whole.edges("connects"):
        assert edge.attributes["at"] == pytest.approx([9.0, 1.0])
    assert whole.node(report.ids["object_2"]).attributes["split_from"] == report.ids["object_1"]
    whole, report = joined(two_storeys(2), two_storeys(1), T=SE3.identity(), name="spot")
    assert {node.id: node.attributes["storey"] for node in whole.nodes("room")} == {"room_2": 2, "room_1": 1}
    far, report = joined(two_storeys(1), two_storeys(1), turned(0.0, 0.0, 0.0, 20.0), name="spot")
    storey_of = {node.id: node.attributes["number"] for node in far.nodes("storey")}
    assert sorted(storey_of.values()) == [1, 2, 3, 4]
    for number in (1, 2):
        room = far.node(report.ids[f"room_{number}"])
        assert room.attributes["storey"] == storey_of[report.ids[f"storey_{number}"]]


@given(
    st.sampled_from(["footprint", "normal", "floor_z", "storey", "number", "split_from", "trajectory"]),
    st.sampled_from([3, "x", [1, 2, 3], [[1], [2], [3]], [["a", "b"]] * 3, [[0, 0], [1, 0], [1]], {"a": 1}, None]),
    poses,
)
@settings(max_examples=60)
@example(name="floor_z", value=None, T=turned(0.0, 0.0, 0.0, 0.5))
def test_attributes_may_hold_anything_when_graphs_are_moved_joined_and_drawn(name: str, value: Any, T: SE3) -> None:
    home = furnished(2)
    changes = GraphChanges()
    for layer in ("room", "storey", "structure", "object"):
        for node in home.nodes(layer)[:2]:  # type: ignore[arg-type]
            changes.put(node.replace(attributes={**node.attributes, name: value}))
    home.commit(changes, 5000)
    whole, _ = joined(home, home, T)
    assert len(whole) >= len(home)
    assert render_graph(whole, "gltf")


def test_a_room_seen_in_halves_becomes_whole() -> None:
    def half(x0: float, x1: float) -> SceneGraph:
        changes = GraphChanges()
        footprint = [[x0, 0], [x1, 0], [x1, 3], [x0, 3]]
        changes.put(
            Node(
                id="room_1", layer="room", label="room", position=(0.5 * (x0 + x1), 1.5, 0), first_seen_ns=0,
                last_seen_ns=1, box=Box(center=(0.5 * (x0 + x1), 1.5, 1.2), size=(x1 - x0, 3, 2.4)),
                attributes={"footprint": footprint, "area_m2": 3 * (x1 - x0)},
            )
        )  # fmt: skip
        graph = SceneGraph()
        graph.commit(changes, 1)
        return graph

    whole, _ = joined(half(0, 3), half(1, 5), SE3.identity())
    (room,) = whole.nodes("room")
    assert room.attributes["area_m2"] == 15
    np.testing.assert_allclose(room.box.size, (5, 3, 2.4))
    np.testing.assert_allclose(room.box.center, (2.5, 1.5, 1.2))


# -- where their map lies ----------------------------------------------------------------------------------------------


def test_a_home_that_fits_in_two_ways_is_refused() -> None:
    ring = [(f"object_{k}", "chair", 3 * math.cos(k * math.pi / 4), 3 * math.sin(k * math.pi / 4)) for k in range(8)]
    graph = world(*ring)
    with pytest.raises(JoinRefused, match="in more than one way: 8 things one way, 8 another") as caught:
        join(graph, graph)
    assert caught.value.hint == "give T_ours_theirs"
    assert len(joined(graph, graph, SE3.identity())[0]) == 8


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_things_are_refused(n: int) -> None:
    things = [(f"object_{k}", f"kind {k}", 1.3 * k, k * k) for k in range(n)]
    with pytest.raises(JoinRefused, match=f"{n} things of the same classes in both"):
        join(world(*things), world(*things))


@given(seeds, seeds)
@settings(max_examples=6)
def test_two_different_homes_are_not_laid_on_one_another(one: int, other: int) -> None:
    if one == other:
        return
    try:
        _, report = join(furnished(one), furnished(other))
    except JoinRefused:
        return
    assert report.alignment is not None
    assert report.alignment.joined < 0.5 * report.alignment.of  # said in the report for who wants to know


def test_a_bad_name_is_refused() -> None:
    with pytest.raises(InvalidGraphValue, match="join: name: expected"):
        join(world(), world(), SE3.identity(), name="Spot 1")


# -- by command ------------------------------------------------------------------------------------------------------


def test_two_files_are_joined_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = furnished(8)
    ours, _ = seen_by_another(home, 9)
    theirs, _ = seen_by_another(home, 10, T_map_home=turned(1.0, 3.0, -2.0))
    save_graph(tmp_path / "ours.world", ours)
    export_graph(theirs, "spark_dsg", tmp_path / "theirs.json")
    files = [str(tmp_path / name) for name in ("ours.world", "theirs.json")]
    words = ["join", *files, "--output", str(tmp_path / "both.json"), "--name", "spot"]
    assert app(words, standalone_mode=False) == 0
    assert "things fit" in capsys.readouterr().out.replace("\n", " ")
    assert app([*words, "--json"], standalone_mode=False) == 0
    told = json.loads(capsys.readouterr().out)
    expected, report = joined(ours, theirs, name="spot")
    both = read_graph(tmp_path / "both.json")
    assert {node.id for node in both} == {node.id for node in expected}
    assert {edge.key for edge in both.edges()} == {edge.key for edge in expected.edges()}
    assert told["alignment"]["joined"] == report.alignment.joined
    assert app(["join", files[0], files[0], "--output", files[1], "--same-map", "--json"], standalone_mode=False) == 0
    assert read_graph(files[1]) == ours
