"""The scene graph: reading, committing, following, and the past."""

import contextlib
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenegraph.errors import DanglingEdge, HistoryUnavailable, InvariantViolated, RevisionGap, UnknownNode
from scenegraph.graph import Delta, Edge, GraphChanges, History, Life, Mirror, Node, SceneGraph, Snapshot, Tombstone

IDS = [f"object_{i}" for i in range(5)] + ["room_0"]
RELATIONS = ["on", "near"]


def node(node_id: str, x: float = 0.0, label: str = "cup", seen: int = 1) -> Node:
    layer = "room" if node_id.startswith("room") else "object"
    return Node(id=node_id, layer=layer, label=label, position=(x, 0, 0), first_seen_ns=0, last_seen_ns=seen)


def edge(relation: str, source: str, target: str, value: float = 0.5) -> Edge:
    return Edge(
        relation=relation, source=source, target=target, value=value, threshold=0.2, first_seen_ns=0, last_seen_ns=1
    )


def changes(*steps: Node | Edge | tuple[str, ...]) -> GraphChanges:
    """Nodes and edges are put; (id, became) deletes a node; (relation, source, target) deletes an edge."""
    collected = GraphChanges()
    for step in steps:
        if not isinstance(step, tuple):
            collected.put(step)
        elif len(step) == 3:
            collected.delete_edge(*step)
        else:
            collected.delete_node(step[0], "gone", became=step[1] if len(step) > 1 else None)
    return collected


def kitchen() -> SceneGraph:
    graph = SceneGraph()
    graph.commit(
        changes(
            node("object_0", 0, "cup"),
            node("object_1", 1, "table"),
            node("object_2", 2, "cup"),
            node("room_0", 0, "kitchen"),
            edge("on", "object_0", "object_1"),
            edge("in", "object_0", "room_0"),
            edge("in", "object_1", "room_0"),
            edge("near", "object_0", "object_2"),
            edge("near", "object_2", "object_0"),
        ),
        stamp_ns=10,
    )
    return graph


def keys(edges: list[Edge]) -> set[tuple[str, str, str]]:
    return {tuple(e.key) for e in edges}


# -- reading ---------------------------------------------------------------------------------------------------------


def test_nodes_are_found_by_layer_and_label() -> None:
    graph = kitchen()
    assert [n.id for n in graph.nodes("room")] == ["room_0"]
    assert {n.id for n in graph.nodes(label="cup")} == {"object_0", "object_2"}
    assert graph.nodes("room", "cup") == []
    assert len(graph.nodes()) == len(graph) == 4


def test_a_relabelled_node_is_found_by_its_new_label_only() -> None:
    graph = kitchen()
    graph.commit(changes(node("object_0", 0, "mug")), 11)
    assert [n.id for n in graph.nodes(label="mug")] == ["object_0"]
    assert [n.id for n in graph.nodes(label="cup")] == ["object_2"]


@pytest.mark.parametrize("relation", [None, "on", "in", "near", "under"])
@pytest.mark.parametrize("source", [None, "object_0", "object_1", "nobody"])
@pytest.mark.parametrize("target", [None, "object_0", "room_0", "nobody"])
def test_edges_are_found_by_any_of_relation_source_and_target(
    relation: str | None, source: str | None, target: str | None
) -> None:
    graph = kitchen()
    expected = [
        e
        for e in graph.edges()
        if (relation in (None, e.relation)) and (source in (None, e.source)) and (target in (None, e.target))
    ]
    found = graph.edges(relation, source, target)
    assert keys(found) == keys(expected)
    assert len(found) == len(expected)


def test_membership_and_single_look_ups() -> None:
    graph = kitchen()
    assert "object_0" in graph
    assert "object_9" not in graph
    assert ("on", "object_0", "object_1") in graph
    assert ("on", "object_1", "object_0") not in graph
    found = graph.edge("on", "object_0", "object_1")
    assert found is not None
    assert found.value == 0.5
    assert keys(graph.edges_of("object_1")) == {("on", "object_0", "object_1"), ("in", "object_1", "room_0")}


def test_an_unknown_node_is_named_with_its_nearest() -> None:
    with pytest.raises(UnknownNode, match="objekt_1") as caught:
        kitchen().node("objekt_1")
    assert "object_1" in (caught.value.hint or "")
    assert caught.value.code == "unknown_node"


def test_networkx_gets_every_node_and_every_parallel_edge() -> None:
    graph = kitchen()
    graph.commit(changes(edge("near", "object_0", "object_1")), 11)
    copy = graph.to_networkx()
    assert copy.number_of_nodes() == 4
    assert copy.number_of_edges() == 6
    assert set(copy["object_0"]["object_1"]) == {"on", "near"}
    assert copy.nodes["object_1"]["label"] == "table"
    assert copy.edges["object_0", "object_1", "on"]["value"] == 0.5


# -- committing ------------------------------------------------------------------------------------------------------


def test_deleting_a_node_deletes_its_edges_and_says_so() -> None:
    graph = kitchen()
    delta = graph.commit(changes(("object_0",)), 20)
    assert delta.nodes.deleted == ("object_0",)
    assert {tuple(key) for key in delta.edges.deleted} == {
        ("on", "object_0", "object_1"),
        ("in", "object_0", "room_0"),
        ("near", "object_0", "object_2"),
        ("near", "object_2", "object_0"),
    }
    assert graph.edges_of("object_0") == []
    assert keys(graph.edges()) == {("in", "object_1", "room_0")}


def test_what_changes_nothing_makes_no_revision() -> None:
    graph = kitchen()
    delta = graph.commit(changes(*graph.nodes(), *graph.edges(), ("on", "object_2", "object_1")), 99)
    assert not delta
    assert (delta.revision, graph.revision, graph.stamp_ns) == (1, 1, 10)


def test_only_what_changed_is_in_the_delta() -> None:
    graph = kitchen()
    delta = graph.commit(changes(*graph.nodes(), node("object_2", 2.5)), 11)
    assert [n.id for n in delta.nodes.put] == ["object_2"]
    assert len(delta) == 1


@pytest.mark.parametrize(
    ("bad", "error"),
    [
        (edge("on", "object_0", "object_9"), DanglingEdge),
        (edge("on", "object_9", "object_0"), DanglingEdge),
        (("object_9",), UnknownNode),
        (("object_2", "object_9"), UnknownNode),
        (node("object_2").model_copy(update={"layer": "agent"}), InvariantViolated),
    ],
)
def test_a_refused_change_leaves_nothing_behind(bad: Edge | Node | tuple[str, ...], error: type[Exception]) -> None:
    graph = kitchen()
    before = graph.snapshot()
    with pytest.raises(error):
        graph.commit(changes(node("object_0", 7), ("object_1",), node("object_4"), bad), 20)
    assert graph.snapshot() == before
    assert graph == kitchen()


def test_an_edge_to_a_node_deleted_before_is_refused_and_one_put_before_goes_with_it() -> None:
    graph = kitchen()
    with pytest.raises(DanglingEdge):
        graph.commit(changes(("object_1",), edge("near", "object_2", "object_1")), 20)
    delta = graph.commit(changes(edge("near", "object_2", "object_1"), ("object_1",)), 20)
    assert delta.edges.put == ()
    assert "object_1" not in graph


def test_an_edge_may_come_before_its_nodes() -> None:
    graph = SceneGraph()
    graph.commit(changes(edge("on", "object_0", "object_1"), node("object_0"), node("object_1")), 1)
    assert graph.n_edges == 1


def test_a_node_put_and_deleted_in_one_change_was_never_there() -> None:
    graph = kitchen()
    delta = graph.commit(changes(node("object_4"), ("object_4", "object_0")), 20)
    assert not delta
    assert graph.tombstone("object_4") is None


def test_a_merge_through_a_node_that_never_was_names_the_last() -> None:
    graph = kitchen()
    graph.commit(changes(node("object_4"), ("object_2", "object_4"), ("object_4", "object_0")), 20)
    assert graph.tombstone("object_2") == Tombstone(id="object_2", became="object_0", reason="gone", stamp_ns=20)


def test_a_tombstone_says_what_became_of_a_node() -> None:
    graph = kitchen()
    delta = graph.commit(changes(("object_0", "object_2")), 20)
    assert delta.tombstones == (Tombstone(id="object_0", became="object_2", reason="gone", stamp_ns=20),)
    graph.commit(changes(("object_2", "object_1")), 30)
    heir = graph.successor("object_0")
    assert heir is not None
    assert heir.id == "object_1"
    with pytest.raises(UnknownNode) as caught:
        graph.node("object_0")
    assert caught.value.hint == "it became object_2: gone"
    graph.commit(changes(node("object_0")), 40)
    assert graph.tombstone("object_0") is None
    graph.commit(changes(("object_1",)), 50)
    assert graph.successor("object_2") is None


def test_nothing_becomes_itself() -> None:
    graph = kitchen()
    for steps in ([("object_0", "object_0")], [("object_0", "object_2"), ("object_2", "object_0")]):
        with pytest.raises(InvariantViolated):
            graph.commit(changes(*steps), 20)
    assert graph == kitchen()


# -- following -------------------------------------------------------------------------------------------------------


def test_a_missed_delta_is_detected() -> None:
    graph, follower = SceneGraph(), SceneGraph()
    first = graph.commit(changes(node("object_0")), 1)
    second = graph.commit(changes(node("object_1")), 2)
    with pytest.raises(RevisionGap, match="delta 2 does not follow revision 0"):
        follower.apply(second)
    assert follower == SceneGraph()
    follower.apply(first)
    follower.apply(second)
    follower.apply(graph.commit(changes(node("object_1")), 3))  # empty
    assert follower == graph
    with pytest.raises(RevisionGap):
        follower.apply(second)


def test_an_empty_delta_tells_of_a_revision_that_was_missed() -> None:
    graph, follower = SceneGraph(), SceneGraph()
    graph.commit(changes(node("object_0")), 1)
    with pytest.raises(RevisionGap):
        follower.apply(graph.commit(changes(node("object_0")), 2))


@pytest.mark.parametrize(
    "fields",
    [
        {"nodes": {"deleted": ["object_9"]}},
        {"edges": {"deleted": [["on", "object_2", "object_1"]]}},
        {"nodes": {"deleted": ["object_1"]}},  # its edges are not deleted with it
        {"edges": {"put": [edge("on", "object_9", "object_1").model_dump()]}},
    ],
)
def test_a_delta_that_does_not_fit_is_refused_whole(fields: dict[str, object]) -> None:
    graph = kitchen()
    with pytest.raises(InvariantViolated):
        graph.apply(Delta.model_validate({"revision": 2, "stamp_ns": 11, **fields}))
    assert graph == kitchen()


def test_a_mirror_asks_for_a_snapshot_when_a_delta_is_missing() -> None:
    graph = kitchen()
    asked = []

    def snapshot() -> Snapshot:
        asked.append(graph.revision)
        return Snapshot.model_validate_json(graph.snapshot().model_dump_json())

    mirror = Mirror(on_gap=snapshot)
    late = graph.commit(changes(node("object_4")), 20)
    assert mirror.receive(late)
    assert mirror.graph == graph
    assert asked == [2]
    assert not mirror.receive(late)  # twice
    assert mirror.receive(graph.commit(changes(("object_4",)), 21))
    assert asked == [2]
    assert mirror.graph == graph


def test_a_mirror_notices_a_graph_that_began_anew() -> None:
    old = kitchen()
    old.commit(changes(("object_0",)), 20)
    current = old
    mirror = Mirror(on_gap=lambda: current.snapshot())
    mirror.resynchronise()
    current = SceneGraph()
    mirror.receive(current.commit(changes(node("object_3")), 30))
    assert mirror.graph == current
    assert mirror.n_gaps == 1


def test_a_mirror_says_when_the_snapshot_is_too_old() -> None:
    graph = kitchen()
    old = graph.snapshot()
    graph.commit(changes(node("object_3")), 30)
    mirror = Mirror(on_gap=lambda: old)
    with pytest.raises(RevisionGap):
        mirror.receive(graph.commit(changes(node("object_4")), 31))


def test_an_edge_of_a_node_that_the_same_change_deletes_is_refused_though_it_is_there_already() -> None:
    graph = SceneGraph()
    graph.commit(changes(node("object_0"), node("object_1"), edge("on", "object_1", "object_0", 0.5)), 1)
    before = graph.snapshot()
    with pytest.raises(DanglingEdge):
        graph.commit(changes(("object_0",), edge("on", "object_1", "object_0", 0.5)), 2)
    assert graph.snapshot() == before


# -- laws ------------------------------------------------------------------------------------------------------------

ids = st.sampled_from(IDS)
steps = st.one_of(
    st.builds(node, ids, st.sampled_from([0.0, 1.0, -0.0, 1e-300]), st.sampled_from(["cup", "TV"]), st.integers(0, 2)),
    st.tuples(st.sampled_from(RELATIONS), ids, ids, st.sampled_from([0.0, 0.5]))
    .filter(lambda e: e[1] != e[2])
    .map(lambda e: edge(*e)),
    st.tuples(ids),
    st.tuples(ids, ids),
    st.tuples(st.sampled_from(RELATIONS), ids, ids),
)
histories = st.lists(st.tuples(st.lists(steps, max_size=8), st.sampled_from([0, 1, 2, 3, -1])), max_size=12)


def consistent(graph: SceneGraph) -> bool:
    """The invariants, by looking at everything."""
    edges = graph.edges()
    return (
        all(e.source in graph and e.target in graph for e in edges)
        and len({e.key for e in edges}) == len(edges) == graph.n_edges
        and all(keys(graph.edges(source=n.id)) == {tuple(e.key) for e in edges if e.source == n.id} for n in graph)
        and all(keys(graph.edges(target=n.id)) == {tuple(e.key) for e in edges if e.target == n.id} for n in graph)
        and {n.id for label in graph.labels() for n in graph.nodes(label=label)} == {n.id for n in graph}
        and all(graph.n_labelled(label) == len(graph.nodes(label=label)) for label in (*graph.labels(), "unheard of"))
        and not any(stone.id in graph for stone in graph.tombstones())
    )


@settings(max_examples=80, deadline=None)
@given(histories)
def test_a_life_spans_the_moments_at_which_it_was_there(history: list[tuple[list, int]]) -> None:
    graph = SceneGraph()
    moments: list[tuple[int, set[object]]] = []
    for number, (steps_of_one, _) in enumerate([([node(i) for i in IDS], 0), *history]):
        for step in steps_of_one:
            with contextlib.suppress(DanglingEdge, UnknownNode, InvariantViolated):
                graph.commit(changes(step), number)
        moments.append((number, {n.id for n in graph} | {e.key for e in graph.edges()}))
    reread = SceneGraph.from_snapshot(graph.snapshot(), history=graph.history.document())
    for item in set().union(*(there for _, there in moments)):
        life = graph.life(item)  # type: ignore[arg-type]
        assert life == reread.life(item)  # type: ignore[arg-type]
        assert life.lives == (item in graph)
        assert all(start is not None for start, _ in life.spans)  # everything began in the remembered past
        for moment, there in moments:
            inside = any(start <= moment and (end is None or moment < end) for start, end in life.spans)  # type: ignore[operator]
            assert inside == (item in there)


def test_a_life_that_began_before_the_remembered_past_has_no_beginning() -> None:
    graph = SceneGraph.from_snapshot(kitchen().snapshot())
    graph.commit(changes(("object_0",)), 20)
    graph.commit(changes(node("object_0", seen=7)), 30)
    assert graph.life("object_1") == Life(0, 1, ((None, None),))
    assert graph.life("object_0") == Life(0, 7, ((None, 20), (30, None)))
    assert graph.life(("on", "object_0", "object_1")) == Life(0, 1, ((None, 20),))
    assert not graph.life(("on", "object_0", "object_1")).lives
    for unknown in ("object_9", ("on", "object_1", "object_0")):
        with pytest.raises(UnknownNode):
            graph.life(unknown)


@settings(max_examples=150, deadline=None)
@given(histories)
def test_a_mirror_equals_its_original_and_the_past_is_as_it_was(history: list[tuple[list, int]]) -> None:
    graph, follower = SceneGraph(), SceneGraph()
    stamp, seen = 100, [(90, graph.snapshot())]
    pending = deque([([node(i) for i in IDS], 0), *history])
    while pending:
        steps_of_one, pause = pending.popleft()
        stamp += pause  # now and then backwards: counts as the last stamp
        before = graph.snapshot()
        try:
            delta = graph.commit(changes(*steps_of_one), stamp)
        except (DanglingEdge, UnknownNode, InvariantViolated):
            assert graph.snapshot() == before
            if len(steps_of_one) > 1:  # then each by itself
                pending.extendleft(([step], 0) for step in reversed(steps_of_one))
            continue
        assert delta.revision == before.revision + bool(delta)
        assert delta.stamp_ns >= before.stamp_ns
        follower.apply(Delta.model_validate_json(delta.model_dump_json()))
        assert follower == graph
        assert consistent(graph)
        if delta and seen[-1][0] == delta.stamp_ns:
            seen.pop()
        if delta:
            seen.append((delta.stamp_ns, graph.snapshot()))
    reread = SceneGraph.from_snapshot(
        Snapshot.model_validate_json(graph.snapshot().model_dump_json()), history=graph.history.document()
    )
    for past in (graph, follower, reread):
        for moment, snapshot in seen:
            assert past.as_of(moment) == SceneGraph.from_snapshot(snapshot)
        assert past.as_of(stamp + 1000) == graph
    assert consistent(graph.as_of(stamp - 1))


# -- the past --------------------------------------------------------------------------------------------------------


def test_a_forgotten_past_is_refused_not_invented() -> None:
    graph = SceneGraph(history_limit=3)
    for i in range(6):
        graph.commit(changes(node("object_0", x=float(i))), 10 * i)
    assert graph.history.n_items <= 3
    assert graph.as_of(35).node("object_0").position[0] == 3.0
    assert graph.as_of(20).node("object_0").position[0] == 2.0
    with pytest.raises(HistoryUnavailable, match="history begins at 20 ns"):
        graph.as_of(15)


def test_without_history_the_past_begins_at_the_snapshot() -> None:
    graph = SceneGraph.from_snapshot(kitchen().snapshot())
    assert graph.as_of(10) == graph
    with pytest.raises(HistoryUnavailable):
        graph.as_of(9)


def test_before_the_first_change_the_graph_was_empty() -> None:
    assert len(kitchen().as_of(9)) == 0


def test_the_past_can_go_on_a_way_of_its_own() -> None:
    graph = kitchen()
    graph.commit(changes(("object_0",)), 20)
    past = graph.as_of(10)
    past.commit(changes(node("object_4")), 11)
    assert "object_0" in past
    assert "object_4" not in graph


@pytest.mark.parametrize("document", [[3], [{"revision": 1}], [{"revision": 1, "stamp_ns": 1, "previous_stamp_ns": 0,
                                      "nodes": {"a": {"id": "A"}}, "edges": [], "tombstones": {}}]])  # fmt: skip
def test_a_history_that_is_none_is_refused(document: list) -> None:
    with pytest.raises(ValueError, match=r"history\[0\]"):
        History.from_document(document)


def test_a_snapshot_must_be_a_consistent_graph() -> None:
    a, b = node("object_0"), node("object_1")
    for nodes, edges in [
        ((a, a), ()),
        ((a,), (edge("on", "object_0", "object_1"),)),
        ((a, b), (edge("on", "object_0", "object_1"),) * 2),
    ]:
        with pytest.raises(InvariantViolated):
            SceneGraph.from_snapshot(Snapshot(revision=1, stamp_ns=1, nodes=nodes, edges=edges))


def test_a_graph_is_true_even_when_empty() -> None:
    assert SceneGraph()
    assert len(SceneGraph()) == 0
