"""Graph and ground terms say the same."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase
from reasoning.knowledge import DerivedEdge
from reasoning.terms import Atom, Compound, Var, term_text
from scenegraph import facts
from scenegraph.graph import Box, Edge, Node
from scenegraph.perception.relations import MeasurementChange


@pytest.fixture(scope="module")
def knowledge() -> Iterator[KnowledgeBase]:
    with KnowledgeBase() as base:
        yield base


@pytest.mark.parametrize(
    ("label", "atom"),
    [
        ("TV", "tv"),
        ("coffee table", "coffee_table"),
        ("Coffee-Table ", "coffee_table"),
        ("3d printer", "c_3d_printer"),
        ("potted plant (large)", "potted_plant_large"),
        ("Stuhl/Hocker", "stuhl_hocker"),
        ("", "c"),
        ("???", "c"),
        ("éclair", "clair"),
    ],
)
def test_a_class_is_written_as_goals_write_it(label: str, atom: str) -> None:
    assert facts.class_atom(label) == atom


@given(label=st.text(max_size=30))
def test_every_label_becomes_a_name_and_names_stay(label: str) -> None:
    atom = facts.class_atom(label)
    assert re.fullmatch(r"[a-z][a-z0-9_]*", atom)
    assert facts.class_atom(atom) == atom


def node(**how: object) -> Node:
    return Node(
        **{
            "id": "object_1", "layer": "object", "label": "Coffee Table", "position": (1.0, 2.0, 0.4),
            "box": Box.from_yaw((1.0, 2.0, 0.4), (1.2, 0.6, 0.8), 0.5), "confidence": 0.75, "first_seen_ns": 5,
            "last_seen_ns": 9, **how,
        }
    )  # fmt: skip


def texts(terms: object) -> set[str]:
    return {term_text(term) for term in terms}  # type: ignore[attr-defined]


def test_a_node_says_all_that_rules_use() -> None:
    found = texts(facts.node_facts(node(attributes={"name": "Ann's", "views": 3, "open": True, "polygon": [[0, 0]]})))
    expected = {
        "node(object_1,object)",
        "label(object_1,coffee_table)",
        "position(object_1,1.0,2.0,0.4)",
        "size(object_1,1.2,0.6,0.8)",
        "confidence(object_1,0.75)",
        "seen(object_1,5,9)",
        "attribute(object_1,views,3)",
        "attribute(object_1,open,true)",
    }
    assert {t.replace(" ", "") for t in found} >= expected
    assert not any("polygon" in text for text in found), "lists are no facts"


def test_a_type_that_the_rules_gave_is_no_fact_and_one_that_was_told_is() -> None:
    room = {"id": "room_1", "layer": "room", "label": "kitchen", "box": None}
    given_by_rules = texts(facts.node_facts(node(**room, attributes={"type": "kitchen", "type_reason": "an oven"})))
    told = texts(facts.node_facts(node(**room, attributes={"type": "Guest room", "type_reason": "told by ann"})))
    assert not any("type" in text for text in given_by_rules)
    assert {t.replace(" ", "") for t in told} >= {"attribute(room_1,type,guest_room)"}


@settings(max_examples=40, deadline=None)
@given(
    name=st.text(max_size=20),
    key=st.from_regex(r"[a-z][a-z0-9_]{0,10}", fullmatch=True),
    value=st.one_of(
        st.text(max_size=20),
        st.integers(-(2**62), 2**62),
        st.booleans(),
        st.floats(allow_nan=False, allow_infinity=False),
    ),
    position=st.tuples(*(st.floats(-1e3, 1e3),) * 3),
)
def test_whatever_a_node_holds_the_rules_can_be_told(
    knowledge: KnowledgeBase, name: str, key: str, value: object, position: tuple[float, float, float]
) -> None:
    if key in ("name", "type", "type_reason"):
        return
    one = node(position=position, attributes={"name": name, key: value})
    knowledge.update(put=facts.node_facts(one), forget=["object_1"])
    [place] = knowledge.call("position(object_1, X, Y, Z)")
    assert [place["X"], place["Y"], place["Z"]] == pytest.approx(list(position), rel=0.0, abs=0.6e-4)  # to 0.1 mm
    [named] = knowledge.call("named(object_1, N)")
    assert named["N"] == name
    [stored] = knowledge.call(Compound("attribute", (Atom("object_1"), Atom(key), Var("V"))))
    expected = str(value).lower() if isinstance(value, bool) else value
    found = stored["V"].name if isinstance(stored["V"], Atom) else stored["V"]  # a plain word is an atom in goals
    assert found == expected


def test_a_stored_edge_is_asked_for_under_its_name(knowledge: KnowledgeBase) -> None:
    rooms = [node(id=f"room_{n}", layer="room", label="room", box=None) for n in (1, 2)]
    door = Edge(relation="connects", source="room_1", target="room_2", value=0.9, first_seen_ns=1, last_seen_ns=2)
    knowledge.update(put=[*(f for r in rooms for f in facts.node_facts(r)), facts.edge_fact(door)])
    assert knowledge.ask("connects(room_1, X)").truth == "true"


def test_measurements_are_put_and_taken_away(knowledge: KnowledgeBase) -> None:
    put, deleted = facts.measurement_facts(MeasurementChange(put={("gap", "a", "b"): 0.25, ("lowest", "a"): 1.0}))
    assert len(put) == 2
    assert not deleted
    knowledge.update(put=put)
    assert knowledge.call("measured(gap, a, b, V)") == [{"V": 0.25}]
    put, deleted = facts.measurement_facts(MeasurementChange(put={("gap", "a", "b"): 0.5}, deleted=[("lowest", "a")]))
    knowledge.update(put=put, deleted=deleted)
    assert knowledge.call("measured(gap, a, b, V)") == [{"V": 0.5}], "replaced, not added"
    assert knowledge.call("measured(lowest, a, V)") == []


def test_later_measurements_win_when_changes_are_joined() -> None:
    change = MeasurementChange(put={("gap", "a", "b"): 1.0, ("gap", "a", "c"): 1.0}, deleted=[("gap", "b", "c")])
    change.merge(MeasurementChange(put={("gap", "b", "c"): 2.0}, deleted=[("gap", "a", "b")]))
    assert change.put == {("gap", "a", "c"): 1.0, ("gap", "b", "c"): 2.0}
    assert change.deleted == [("gap", "a", "b")]


def test_classes_are_told_with_kind_and_parent(knowledge: KnowledgeBase) -> None:
    knowledge.update(put=facts.class_facts([("Wing Chair", "thing", "chair"), ("wall", "stuff", None)]))
    assert knowledge.call("class_info(wing_chair, K, P)") == [{"K": Atom("thing"), "P": Atom("chair")}]
    assert knowledge.call("class_info(wall, K, P)") == [{"K": Atom("stuff"), "P": Atom("none")}]
    put = facts.node_facts(node(id="object_9", label="Wing Chair"))
    knowledge.update(put=put)
    assert knowledge.ask("chair(object_9)").truth == "true", "a kind of chair is a chair"


def test_a_derived_edge_keeps_its_first_time_and_its_last_witnesses() -> None:
    derived = DerivedEdge("on", "object_1", "object_2", 0.8, 0.2, 1.2)
    edge = facts.derived_edge(derived, None, ("first",), 10)
    assert (edge.first_seen_ns, edge.last_seen_ns, edge.confidence) == (10, 10, 1.0)
    for n in range(9):
        edge = facts.derived_edge(derived, edge, (f"later {n}",), 20 + n)
    assert (edge.first_seen_ns, edge.last_seen_ns) == (10, 28)
    assert edge.evidence == tuple(f"later {n}" for n in range(4, 9))


def test_an_answer_means_nodes_numbers_texts_and_lists() -> None:
    table = node()
    nodes = {"object_1": table}
    assert facts.value_of(Atom("object_1"), nodes) is table
    assert facts.value_of(Atom("red"), nodes) == "red"
    assert facts.value_of(["a text", 3, 2.5, Atom("object_1")], nodes) == ["a text", 3, 2.5, table]
    assert facts.value_of(Compound("f", (Atom("a"), 1)), nodes).replace(" ", "") == "f(a,1)"
