"""Evidence ages: an edge goes after three contrary observations in view, and what contradicts a new one at once."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning.knowledge import DerivedEdge
from scenegraph.doubts import CONTRARY, WITHDRAWN_AFTER, Doubts
from scenegraph.graph import Box, Edge, EdgeKey, GraphChanges, Node, SceneGraph

BOTTOMS = {"cup": 0.75, "book": 0.7, "table": 0.0}


def node(name: str, layer: str, bottom: float = 0.0) -> Node:
    box = Box(center=(0.0, 0.0, bottom + 0.05), size=(0.1, 0.1, 0.1))
    return Node(id=name, layer=layer, label=name, position=box.center, box=box, first_seen_ns=0, last_seen_ns=0)


def edge(relation: str, a: str, b: str) -> Edge:
    return Edge(relation=relation, source=a, target=b, value=1.0, threshold=0.2, first_seen_ns=0, last_seen_ns=0)


def graph_of(*edges: Edge) -> SceneGraph:
    graph, changes = SceneGraph(), GraphChanges()
    for name, bottom in BOTTOMS.items():
        changes.put(node(name, "object", bottom))
    for room in ("room_1", "room_2"):
        changes.put(node(room, "room"))
    for one in edges:
        changes.put(one)
    graph.commit(changes, 0)
    return graph


def look(
    doubts: Doubts,
    graph: SceneGraph,
    failing: set[EdgeKey],
    seen: set[str] | None,
    derived: tuple[EdgeKey, ...] = (),
) -> None:
    changes = GraphChanges()
    found = [DerivedEdge(*key, 1.0, 0.2, 0.9) for key in derived]
    for key in derived:
        changes.put(edge(*key))
    doubts.weigh(failing, found, seen, graph, {}, changes)
    graph.commit(changes, graph.stamp_ns + 1)


NEAR = EdgeKey("near", "cup", "table")


@settings(max_examples=60, deadline=None)
@given(looks=st.lists(st.tuples(st.booleans(), st.booleans()), max_size=12))
def test_an_edge_goes_with_the_third_contrary_look_in_view_and_never_out_of_view(
    looks: list[tuple[bool, bool]],
) -> None:
    """Each look: whether the cup is in view, and whether the pair is measured anew (else what is known stands)."""
    graph, doubts = graph_of(edge(*NEAR)), Doubts()
    against, doubted = 0, False
    for in_view, measured in looks:
        if graph.edge(*NEAR) is None:
            break
        look(doubts, graph, {NEAR} if measured else set(), {"cup"} if in_view else {"book"})
        doubted |= measured
        against += in_view and doubted
        kept = graph.edge(*NEAR)
        assert (kept is None) == (against >= WITHDRAWN_AFTER)
        assert kept is None or (kept.attributes.get(CONTRARY, 0), kept.last_seen_ns) == (against, 0)


def test_an_edge_that_is_derived_again_is_beyond_doubt() -> None:
    graph, doubts = graph_of(edge(*NEAR)), Doubts()
    for _ in range(5):
        look(doubts, graph, {NEAR}, {"cup"})
        look(doubts, graph, {NEAR}, {"cup"})
        look(doubts, graph, set(), {"cup"}, (NEAR,))
        kept = graph.edge(*NEAR)
        assert kept is not None
        assert CONTRARY not in kept.attributes


def test_doubts_outlive_a_restart() -> None:
    graph, doubts = graph_of(edge(*NEAR)), Doubts()
    look(doubts, graph, {NEAR}, {"cup"})
    again = Doubts()
    again.remember(graph.edges())
    look(again, graph, set(), {"table"})
    assert graph.edge(*NEAR) is not None
    look(again, graph, set(), {"table"})
    assert graph.edge(*NEAR) is None


def test_an_operators_word_counts_at_once() -> None:
    graph, doubts = graph_of(edge(*NEAR)), Doubts()
    look(doubts, graph, {NEAR}, None)
    assert graph.edge(*NEAR) is None


def test_a_thing_is_never_in_two_rooms() -> None:
    graph, doubts = graph_of(edge("in", "cup", "room_1"), edge("contains", "room_1", "cup")), Doubts()
    old = {EdgeKey("in", "cup", "room_1"), EdgeKey("contains", "room_1", "cup")}
    look(doubts, graph, old, {"book"}, (EdgeKey("in", "cup", "room_2"), EdgeKey("contains", "room_2", "cup")))
    assert [e.target for e in graph.edges("in", source="cup")] == ["room_2"]
    assert not graph.edges("contains", source="room_1")


def test_nothing_is_on_and_above_the_same_and_on_stays_acyclic() -> None:
    for new in (EdgeKey("above", "cup", "book"), EdgeKey("on", "book", "cup")):
        graph, doubts = graph_of(edge("on", "cup", "book")), Doubts()
        look(doubts, graph, {EdgeKey("on", "cup", "book")}, {"cup"}, (new,))
        assert graph.edge("on", "cup", "book") is None
    graph, doubts = graph_of(edge("on", "table", "cup")), Doubts()
    look(doubts, graph, {EdgeKey("on", "table", "cup")}, {"cup"})
    assert graph.edge("on", "table", "cup") is None, "the table is lower now: kept, it might close a circle"


def test_what_stands_neither_hangs_nor_is_fixed() -> None:
    fixed, hanging = EdgeKey("attached_to", "cup", "table"), EdgeKey("hanging_from", "cup", "table")
    graph, doubts = graph_of(edge(*fixed), edge(*hanging)), Doubts()
    look(doubts, graph, {fixed, hanging}, {"cup"}, (EdgeKey("on", "cup", "book"),))
    assert graph.edge(*fixed) is None
    assert graph.edge(*hanging) is None
