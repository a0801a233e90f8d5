"""The graph follows the rules whatever was measured anew, also of things that nobody says were touched."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase
from scenegraph.config import WorldConfig
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.meaning import Meaning
from scenegraph.perception.relations import CONTACTS, MeasurementChange

THINGS = ("cup", "jar", "shelf")
HOLDERS = (*THINGS, "wall")
TIMES = {"first_seen_ns": 0, "last_seen_ns": 0}

pairs = st.tuples(st.sampled_from(CONTACTS), st.sampled_from(THINGS), st.sampled_from(HOLDERS))
changes = st.dictionaries(
    pairs.filter(lambda key: key[1] != key[2]), st.sampled_from([None, 0.1, 0.6, 1.0]), max_size=6
)


@pytest.fixture(scope="module")
def knowledge() -> Iterator[KnowledgeBase]:
    with KnowledgeBase() as base:
        yield base


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(changes, min_size=1, max_size=6))
def test_what_rests_or_is_held_elsewhere_has_its_edges_when_only_its_neighbours_changed(
    knowledge: KnowledgeBase, steps: list[dict[tuple[str, str, str], float | None]]
) -> None:
    knowledge.update(forget=HOLDERS)
    meaning, graph, first = Meaning(knowledge, WorldConfig()), SceneGraph(), GraphChanges()
    for height, name in enumerate(HOLDERS):
        layer = "structure" if name == "wall" else "object"
        first.put(Node(id=name, layer=layer, label=name, position=(0.0, 0.0, float(height)), **TIMES))
    lowest = MeasurementChange({("lowest", name): float(k) for k, name in enumerate(THINGS)})
    meaning.infer(first, lowest, HOLDERS, graph, "test", 0)
    graph.commit(first, 0)
    known: set[tuple[str, str, str]] = set()
    for stamp, step in enumerate(steps, start=1):
        put = {key: value for key, value in step.items() if value is not None}
        measured = MeasurementChange(dict(put), [key for key, value in step.items() if value is None and key in known])
        known = (known | put.keys()) - set(measured.deleted)
        follow = GraphChanges()
        meaning.infer(follow, measured, {"wall"}, graph, "test", stamp)
        graph.commit(follow, stamp)
        _, derived = knowledge.derived_edges(list(HOLDERS))
        assert {tuple(edge.key) for edge in graph.edges()} == {(e.relation, e.source, e.target) for e in derived}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(looks=st.lists(st.lists(st.tuples(st.sampled_from(THINGS), st.booleans()), max_size=5), min_size=1, max_size=4))
def test_the_rules_know_the_nodes_of_the_graph_whatever_comes_and_goes_at_once(
    knowledge: KnowledgeBase, looks: list[list[tuple[str, bool]]]
) -> None:
    """What a look puts and deletes, in any order: what one part of the mapping found another may have taken over."""
    knowledge.update(forget=HOLDERS)
    meaning, graph = Meaning(knowledge, WorldConfig()), SceneGraph()
    for stamp, look in enumerate(looks):
        changes, there = GraphChanges(), {node.id for node in graph.nodes()}
        for name, comes in look:
            if comes:
                changes.put(Node(id=name, layer="object", label=name, position=(0.0, 0.0, float(stamp)), **TIMES))
                there.add(name)
            elif name in there:
                changes.delete_node(name, "gone")
                there.discard(name)
        meaning.infer(changes, MeasurementChange(), HOLDERS, graph, "test", stamp)
        graph.commit(changes, stamp)
        known = {str(row["X"]): row["Z"] for row in knowledge.call("node(X, object), position(X, _, _, Z)")}
        assert known == {node.id: node.position[2] for node in graph.nodes()}
