"""Nodes, edges, boxes and deltas as values: checked, frozen, compared by content, the same on the wire."""

import copy
import json
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenegraph.errors import InvalidGraphValue, Problem, SceneGraphError, problem_of
from scenegraph.graph import Attributes, Box, Delta, Edge, GraphChanges, Node, SceneGraph, Snapshot

CUP = {
    "id": "object_12",
    "layer": "object",
    "label": "cup",
    "position": [1.0, 2.0, 0.5],
    "first_seen_ns": 5,
    "last_seen_ns": 9,
}
ON = {"relation": "on", "source": "object_3", "target": "object_12", "first_seen_ns": 5, "last_seen_ns": 9}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"id": "Object_1"}, "Node.id: .*'Object_1'"),
        ({"id": "object 1"}, "Node.id"),
        ({"id": "object_1\n"}, "Node.id"),
        ({"id": ""}, "Node.id"),
        ({"layer": "thing"}, "Node.layer: .*'structure'.*got 'thing'"),
        ({"position": [1, 2]}, r"Node.position: expected 3 numbers, got shape \(2,\)"),
        ({"position": [1, 2, math.nan]}, "Node.position: expected 3 finite numbers"),
        ({"position": "here"}, "Node.position: expected 3 numbers, got 'here'"),
        ({"box": {"center": [0, 0, 0], "size": [1, -1, 1]}}, "Node.box.size: expected edge lengths ≥ 0"),
        ({"box": {"center": [0, 0, math.inf], "size": [1, 1, 1]}}, "Node.box.center: expected 3 finite"),
        ({"box": {"center": [0, 0, 0], "size": [1, 1, 1], "rotation_wxyz": [2, 0, 0, 0]}}, "unit quaternion.*norm 2"),
        ({"confidence": 1.5}, "Node.confidence: .*1.5"),
        ({"confidence": math.nan}, "Node.confidence"),
        ({"first_seen_ns": 10}, "first_seen_ns 10 is later than last_seen_ns 9"),
        ({"attributes": {"weight": math.nan}}, "attributes.weight: expected a finite number"),
        ({"attributes": {"list": [1, {"deep": object()}]}}, r"attributes.list\[1\].deep: expected a JSON value"),
        ({"attributes": {3: 4}}, "expected names as keys, got 3"),
        ({"colour": "red"}, "no such field: colour"),
    ],
)
def test_a_bad_node_is_refused_in_one_line(changed: dict, message: str) -> None:
    with pytest.raises(InvalidGraphValue, match=message) as caught:
        Node(**{**CUP, **changed})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"relation": "On"}, "Edge.relation"),
        ({"target": "object_3"}, "two different ends"),
        ({"value": math.inf}, "Edge.value: .*finite"),
        ({"confidence": -0.1}, "Edge.confidence"),
        ({"last_seen_ns": 1}, "later than"),
    ],
)
def test_a_bad_edge_is_refused_in_one_line(changed: dict, message: str) -> None:
    with pytest.raises(InvalidGraphValue, match=message):
        Edge(**{**ON, **changed})


def test_a_bad_value_deep_in_a_delta_is_named_by_its_path() -> None:
    bad = {"revision": 1, "stamp_ns": 2, "nodes": {"put": [CUP, {**CUP, "position": [1]}]}}
    with pytest.raises(InvalidGraphValue, match=r"Delta.nodes.put.1.position: expected 3 numbers"):
        Delta.model_validate(bad)
    with pytest.raises(InvalidGraphValue, match=r"Delta.nodes.put.1.position"):
        Delta.model_validate_json(json.dumps(bad))
    with pytest.raises(InvalidGraphValue, match="Invalid JSON"):
        Delta.model_validate_json(b'{"revision": ')


def test_the_wire_form_is_the_published_one() -> None:
    graph = SceneGraph()
    changes = GraphChanges()
    for step in (
        Node(**CUP),
        Node(**{**CUP, "id": "object_3", "box": Box(center=(0, 0, 0), size=(1, 1, 1))}),
        Edge(**ON),
    ):
        changes.put(step)
    graph.commit(changes, 7)
    changes = GraphChanges()
    changes.delete_node("object_12", "merged", became="object_3")
    changes.put(Node(**{**CUP, "id": "object_4", "attributes": {"name": "mug", "footprint": np.eye(2)}}))
    delta = graph.commit(changes, 8)
    assert json.loads(delta.model_dump_json()) == {
        "revision": 2,
        "stamp_ns": 8,
        "nodes": {
            "put": [
                {
                    "id": "object_4",
                    "layer": "object",
                    "label": "cup",
                    "position": [1.0, 2.0, 0.5],
                    "box": None,
                    "confidence": 1.0,
                    "first_seen_ns": 5,
                    "last_seen_ns": 9,
                    "attributes": {"name": "mug", "footprint": [[1.0, 0.0], [0.0, 1.0]]},
                }
            ],
            "deleted": ["object_12"],
        },
        "edges": {"put": [], "deleted": [["on", "object_3", "object_12"]]},
        "tombstones": [{"id": "object_12", "became": "object_3", "reason": "merged", "stamp_ns": 8}],
    }
    assert graph.node("object_3").model_dump()["box"] == {
        "center": [0, 0, 0],
        "size": [1, 1, 1],
        "rotation_wxyz": [1, 0, 0, 0],
    }


def test_fields_that_a_newer_server_added_are_ignored() -> None:
    assert Node.model_validate({**CUP, "mood": "calm"}) == Node(**CUP)
    read = Delta.model_validate({"revision": 1, "stamp_ns": 2, "epoch": 3, "nodes": {"put": [{**CUP, "mood": 1}]}})
    assert read.nodes.put == (Node(**CUP),)


def test_json_schemas_can_be_written() -> None:
    schema = Snapshot.model_json_schema(mode="serialization")
    assert schema["$defs"]["Node"]["properties"]["position"]["maxItems"] == 3


numbers = st.floats(-1e6, 1e6)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | numbers | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


@given(
    st.tuples(numbers, numbers, numbers),
    st.tuples(*[st.floats(0, 1e4)] * 3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(c * c for c in q) > 1e-3),
    st.dictionaries(st.text(max_size=4), json_values, max_size=3),
    st.text(max_size=8),
)
def test_values_survive_the_wire_unchanged(
    center: tuple, size: tuple, q: list[float], attributes: dict, label: str
) -> None:
    box = Box(center=center, size=size, rotation_wxyz=np.array(q) / np.linalg.norm(q))
    node = Node(**{**CUP, "label": label, "position": center, "box": box, "attributes": attributes})
    for again in (
        Node.model_validate_json(node.model_dump_json()),
        Node.model_validate(node.model_dump()),
        Node.model_validate(json.loads(node.model_dump_json())),
        pickle.loads(pickle.dumps(node)),
        copy.deepcopy(node),
    ):
        assert again == node
        assert hash(again) == hash(node)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(c * c for c in q) > 1e-3))
def test_box_corners_keep_their_distances_and_lie_inside(q: list[float]) -> None:
    box = Box(center=(1, 2, 3), size=(0.4, 0.6, 0.8), rotation_wxyz=np.array(q) / np.linalg.norm(q))
    corners = box.corners()
    np.testing.assert_allclose(corners.mean(axis=0), box.center)
    np.testing.assert_allclose(np.linalg.norm(corners - box.center, axis=1), 0.5 * np.linalg.norm(box.size))
    np.testing.assert_allclose(box.rotation @ box.rotation.T, np.eye(3), atol=1e-12)
    assert box.contains(corners, margin_m=1e-9).all()
    assert not box.contains(box.center + 1.01 * (corners - box.center)).any()


def test_a_box_turned_by_yaw_has_that_yaw() -> None:
    box = Box.from_yaw((0, 0, 0), (2, 1, 1), math.pi / 2)
    assert box.yaw == pytest.approx(math.pi / 2)
    np.testing.assert_allclose(box.corners()[0], [0.5, -1.0, -0.5], atol=1e-12)


def test_a_quaternion_that_is_nearly_unit_is_normalised() -> None:
    box = Box(center=(0, 0, 0), size=(1, 1, 1), rotation_wxyz=(1.001, 0, 0, 0))
    assert box.rotation_wxyz.tolist() == [1, 0, 0, 0]


def test_values_cannot_be_changed_from_outside() -> None:
    position = np.zeros(3)
    given_attributes = {"footprint": [[0, 0]]}
    node = Node(**{**CUP, "position": position, "attributes": given_attributes})
    position[0] = 5
    given_attributes["footprint"].append([1, 1])
    assert node.position[0] == 0
    assert node.attributes == {"footprint": [[0, 0]]}
    with pytest.raises(ValueError, match="read-only"):
        node.position[0] = 1
    with pytest.raises(ValueError, match="frozen"):
        node.label = "x"
    for change in (
        lambda: node.attributes.update(a=1),
        lambda: node.attributes.__setitem__("a", 1),
        lambda: node.attributes.pop("footprint"),
        lambda: node.attributes.__ior__({"a": 1}),
    ):
        with pytest.raises(TypeError, match="read-only"):
            change()
    assert isinstance(node.attributes, Attributes)


def test_replace_checks_what_it_changes_and_shares_the_rest() -> None:
    node = Node(**CUP)
    later = node.replace(last_seen_ns=20, attributes={**node.attributes, "name": "mug"})
    assert later.position is node.position
    assert (later.last_seen_ns, later.attributes["name"]) == (20, "mug")
    with pytest.raises(InvalidGraphValue):
        node.replace(confidence=2)
    with pytest.raises(InvalidGraphValue, match="id of a node cannot change"):
        node.replace(id="object_1")
    with pytest.raises(InvalidGraphValue, match="source of an edge cannot change"):
        Edge(**ON).replace(source="object_1")


def test_wishes_are_checked_when_they_are_made() -> None:
    changes = GraphChanges()
    with pytest.raises(InvalidGraphValue, match="expected a Node or an Edge, got str"):
        changes.put("object_3")  # type: ignore[arg-type]
    with pytest.raises(InvalidGraphValue, match="source: expected"):
        changes.delete_edge("on", "Object", "object_1")
    with pytest.raises(InvalidGraphValue):
        changes.delete_node("Object", "gone")
    assert not changes


# -- errors on the wire ----------------------------------------------------------------------------------------------


def all_errors() -> list[type[SceneGraphError]]:
    found, queue = [], [SceneGraphError]
    while queue:
        kind = queue.pop()
        found.append(kind)
        queue += [sub for sub in kind.__subclasses__() if sub.__module__ == "scenegraph.errors"]
    return found


def test_every_error_of_the_tree_has_a_code_of_its_own() -> None:
    codes = [kind.code for kind in all_errors()]
    assert len(set(codes)) == len(codes)


def test_an_error_of_any_package_becomes_a_problem() -> None:
    class ForeignError(Exception):
        code = "pose_unavailable"
        hint = "wait"

    assert problem_of(ForeignError("no pose")) == Problem(code="pose_unavailable", message="no pose", hint="wait")
    assert problem_of(SceneGraphError("m", hint="h")) == Problem(code="scenegraph_error", message="m", hint="h")


def test_an_unexpected_error_tells_its_type_and_no_more() -> None:
    problem = problem_of(RuntimeError("secret path"))
    assert problem.code == "internal_error"
    assert "RuntimeError" in problem.message
    assert "secret" not in problem.message
    assert problem_of(MemoryError()).code == "out_of_memory"
    assert problem_of(SystemExit(3)).code == "internal_error"  # whose code is a number


def test_a_refused_message_becomes_one_line() -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - pydantic's own
        Problem.model_validate({"message": 3})
    problem = problem_of(caught.value)
    assert problem.code == "invalid_message"
    assert problem.message == "code: required, but missing; message: Input should be a valid string, got 3"
