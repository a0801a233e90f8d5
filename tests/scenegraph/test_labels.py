"""Class ids of many sensors become one set of classes, by name."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.errors import InvalidObservation
from mapping.observations import LabelSpace
from scenegraph.labels import Labels


def space(
    classes: dict[int, str], robot: str | None = None, sensor: str | None = None, kind: str = "thing"
) -> LabelSpace:
    return LabelSpace(classes={i: {"name": n, "kind": kind} for i, n in classes.items()}, robot=robot, sensor=sensor)


def test_spaces_of_several_sensors_are_unified_by_class_name() -> None:
    labels = Labels()
    labels.learn(space({1: "cup", 2: "table"}))
    labels.learn(space({9: "table", 4: "cup", 5: "sofa"}, robot="bob"))
    mine = labels.translate(np.array([[0, 1, 2]]), "ann", "camera")
    other = labels.translate(np.array([[0, 4, 9]]), "bob", "camera")
    assert mine.tolist() == other.tolist()
    assert [labels.name(int(i)) for i in mine[0, 1:]] == ["cup", "table"]


def test_the_most_special_space_counts() -> None:
    labels = Labels()
    for name, robot, sensor in (("d", None, None), ("c", None, "lidar"), ("b", "bob", None), ("a", "bob", "lidar")):
        labels.learn(space({1: name}, robot, sensor))

    def read(robot: str, sensor: str) -> str:
        return labels.name(int(labels.translate(np.array([1]), robot, sensor)[0]))

    assert read("bob", "lidar") == "a"
    assert read("bob", "camera") == "b"
    assert read("ann", "lidar") == "c"
    assert read("ann", "camera") == "d"


@pytest.mark.parametrize(("ids", "named"), [([0, 1, 7], "7"), ([65535], "65535")])
def test_an_unknown_class_id_is_refused_naming_it(ids: list[int], named: str) -> None:
    labels = Labels()
    labels.learn(space({1: "cup"}))
    with pytest.raises(InvalidObservation, match=rf"class id {named} .*bob/camera") as caught:
        labels.translate(np.array(ids, np.uint16), "bob", "camera")
    assert caught.value.hint is not None


def test_without_a_label_space_labels_are_refused() -> None:
    labels = Labels()
    labels.learn(space({1: "cup"}, robot="ann"))
    with pytest.raises(InvalidObservation, match="no label space is known for bob/camera"):
        labels.translate(np.array([1]), "bob", "camera")


def test_only_new_classes_are_told() -> None:
    labels = Labels()
    assert [c.name for c in labels.learn(space({1: "cup", 2: "table"}))] == ["cup", "table"]
    assert [c.name for c in labels.learn(space({5: "cup", 2: "sofa"}))] == ["sofa"]
    assert [c.name for c in labels.classes] == ["cup", "table", "sofa"]


def test_things_and_stuff_are_told_apart() -> None:
    labels = Labels()
    labels.learn(space({1: "cup"}))
    labels.learn(space({2: "wall"}, kind="stuff"))
    assert labels.things[[labels.id_of("cup"), labels.id_of("wall")]].tolist() == [True, False]
    assert not labels.things[0]
    assert labels.things[labels.id_of("something new")]


@given(names=st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=8, unique=True), data=st.data())
def test_ids_keep_their_meaning_whatever_comes_later(names: list[str], data: st.DataObject) -> None:
    labels = Labels()
    labels.learn(space(dict(enumerate(names, 1))))
    before = {name: labels.id_of(name) for name in names}
    later = data.draw(st.permutations(names))
    labels.learn(space(dict(enumerate(["new", *later], 1)), robot="bob"))
    assert {name: labels.id_of(name) for name in names} == before
    ids = labels.translate(np.arange(1, len(later) + 2), "bob", "camera")
    assert [labels.name(int(i)) for i in ids] == ["new", *later]


def test_labels_come_back_from_their_document() -> None:
    labels, again = Labels(), Labels()
    labels.learn(space({1: "cup", 3: "table"}))
    labels.learn(space({2: "wall"}, robot="bob", sensor="lidar", kind="stuff"))
    labels.id_of("found by a detector")
    again.restore(json.loads(json.dumps(labels.document())))
    assert again.classes == labels.classes
    assert np.array_equal(again.things, labels.things)
    assert (
        again.translate(np.array([0, 2]), "bob", "lidar").tolist()
        == labels.translate(np.array([0, 2]), "bob", "lidar").tolist()
    )
    with pytest.raises(InvalidObservation, match="class id 2 "):
        again.translate(np.array([2]), "ann", "camera")
