"""Instances become nodes that keep their id, whatever becomes of their instance."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.instances import Instance, InstanceChange, Masks
from scenegraph.errors import InvalidStatement
from scenegraph.graph import GraphChanges, SceneGraph
from scenegraph.perception.objects import KNOWN_S, LEAST_VIEWS, Objects
from tests.support.furnishing import VOXEL, box, surface

CLASSES = ["cup", "table", "door"]


class Seen:
    """An instance map that is told what it holds."""

    voxel_size_m = VOXEL

    def __init__(self) -> None:
        self.instances: dict[int, Instance] = {}
        self.surface: dict[int, np.ndarray] = {}
        self.forgotten: list[int] = []
        self.apart = False
        self.gone = 0

    def put(
        self, number: int, label: str, points: np.ndarray, views: int = 5, now: int = 10, wrong: float = 0.0
    ) -> None:
        known = self.instances.setdefault(number, Instance(number, now, now))
        known.views, known.last_seen_ns = views, now
        known.labels = {CLASSES.index(label) + 1: 1.0 - wrong, 1 + (CLASSES.index(label) + 1) % 3: wrong}
        self.surface[number] = points.astype(np.float32)

    def points(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        return self.surface[number], np.ones(len(self.surface[number]), np.float32)

    def forget(self, number: int) -> None:
        self.forgotten.append(number)
        del self.instances[number], self.surface[number]

    def release(self, number: int) -> None:
        del self.instances[number], self.surface[number]

    def were_apart(self, one: int, other: int) -> bool:
        return self.apart

    def n_voxels(self, number: int) -> int:
        return len(self.surface[number])

    def replaced(self, one: int, other: int) -> int:
        return self.gone

    def join(self, kept: int, lost: int) -> InstanceChange:
        self.surface[kept] = np.concatenate([self.surface[kept], self.surface.pop(lost)])
        del self.instances[lost]
        return InstanceChange(frozenset({kept}), {lost: kept})


class Watching:
    def __init__(self) -> None:
        self.seen = Seen()
        self.objects = Objects(lambda number: CLASSES[number - 1], lambda label: label == "door")
        self.graph = SceneGraph()
        self.now = 0

    def update(
        self, *touched: int, merged: dict[int, int] | None = None, stamp_ns: int = 0, masks: Masks | None = None
    ) -> set[str]:
        change = InstanceChange(frozenset(touched), merged or {}, masks=masks)
        changes, reshaped = self.objects.update(
            self.seen,
            change,
            self.graph,
            stamp_ns=stamp_ns,  # type: ignore[arg-type]
        )
        self.now += 1
        self.graph.commit(changes, self.now)
        return reshaped


CUBE = surface(box((0.3, 0.2, 0.2)))
BESIDE = np.array([0.3, 0.0, 0.0])


@pytest.fixture
def world() -> Watching:
    watching = Watching()
    watching.seen.put(1, "table", CUBE)
    watching.update(1)
    return watching


def test_a_thing_becomes_a_node_with_its_box(world: Watching) -> None:
    node = world.graph.node("object_1")
    assert (node.layer, node.label) == ("object", "table")
    assert node.box is not None
    assert node.box.size == pytest.approx([0.3, 0.2, 0.2], abs=0.01)
    assert node.box.center == pytest.approx([0.0, 0.0, 0.1], abs=0.01)
    assert (node.first_seen_ns, node.last_seen_ns) == (10, 10)


@pytest.mark.parametrize(("views", "points"), [(LEAST_VIEWS - 1, CUBE), (9, CUBE[:3])])
def test_what_was_hardly_seen_is_no_node_yet(views: int, points: np.ndarray) -> None:
    world = Watching()
    world.seen.put(1, "cup", points, views=views)
    assert world.update(1) == set()
    assert world.graph.nodes("object") == []


def test_confidence_grows_with_views_and_falls_with_disagreement(world: Watching) -> None:
    def confidence(views: int, wrong: float) -> float:
        world.seen.put(1, "table", CUBE, views=views, wrong=wrong)
        world.update(1)
        return float(world.graph.node("object_1").confidence)

    assert confidence(3, 0.0) < confidence(5, 0.0) == 1.0
    assert confidence(9, 0.4) == pytest.approx(0.6)


def test_noise_does_not_move_a_thing_and_motion_does(world: Watching) -> None:
    world.seen.put(1, "table", CUBE + 0.004, now=20)
    assert world.update(1) == set()
    assert world.graph.node("object_1").box.center == pytest.approx([0.0, 0.0, 0.1], abs=0.003)  # type: ignore[union-attr]
    assert world.graph.node("object_1").last_seen_ns == 20
    world.seen.put(1, "table", CUBE + 0.05, views=6, now=30)
    assert world.update(1) == {"object_1"}
    assert world.graph.node("object_1").box.center == pytest.approx([0.05, 0.05, 0.15], abs=0.003)  # type: ignore[union-attr]


@pytest.mark.parametrize(("views", "points", "again"), [(21, CUBE, False), (24, CUBE, True), (20, CUBE[::2], True)])
def test_a_thing_is_measured_anew_when_much_more_is_known_of_it(views: int, points: np.ndarray, again: bool) -> None:
    world = Watching()
    world.seen.put(1, "table", CUBE, views=20)
    world.update(1)
    world.seen.put(1, "table", points + np.array([0.2, 0.0, 0.0]), views=views, now=20)
    assert (world.update(1) == {"object_1"}) == again
    assert world.graph.node("object_1").last_seen_ns == 20
    assert world.graph.node("object_1").attributes["views"] == views


def test_a_merged_thing_leaves_a_tombstone_that_says_what_became_of_it(world: Watching) -> None:
    world.seen.put(2, "table", CUBE + BESIDE)
    world.update(2)
    world.seen.join(1, 2)
    assert world.update(1, merged={2: 1}) == {"object_1", "object_2"}
    assert [n.id for n in world.graph.nodes("object")] == ["object_1"]
    assert world.graph.tombstone("object_2").became == "object_1"  # type: ignore[union-attr]
    assert world.graph.node("object_1").box.size[0] == pytest.approx(0.6, abs=0.01)  # type: ignore[union-attr]


def test_a_node_lives_on_when_its_instance_is_merged_into_an_older_one_without_a_node() -> None:
    world = Watching()
    world.seen.put(1, "table", CUBE, views=1)
    world.seen.put(2, "table", CUBE + BESIDE)
    world.update(1, 2)
    assert [n.id for n in world.graph.nodes("object")] == ["object_2"]
    world.seen.join(1, 2)
    world.seen.instances[1].views = 6
    world.update(1, merged={2: 1})
    assert [n.id for n in world.graph.nodes("object")] == ["object_2"], "identity lasts"
    assert world.graph.node("object_2").box.size[0] == pytest.approx(0.6, abs=0.01)  # type: ignore[union-attr]


def test_an_instance_that_the_map_gives_up_takes_its_node_along(world: Watching) -> None:
    world.update(1)
    (node,) = world.graph.nodes("object")
    del world.seen.instances[1]
    assert world.update(1) == {node.id}
    assert not world.graph.nodes("object")
    tombstone = world.graph.tombstone(node.id)
    assert tombstone is not None
    assert tombstone.reason == "no longer seen"


def test_a_door_is_structure_and_a_thing_that_turns_out_to_be_one_changes_its_layer(world: Watching) -> None:
    world.seen.put(1, "door", CUBE)
    world.update(1)
    assert "object_1" not in world.graph
    assert world.graph.node("opening_1").layer == "structure"
    world.seen.put(1, "table", CUBE)
    world.update(1)
    [node] = world.graph.nodes("object")
    assert node.id not in ("object_1", "opening_1"), "an id that died is not given again"


def test_a_new_class_is_told_even_where_the_shape_stays(world: Watching) -> None:
    world.seen.put(1, "cup", CUBE)
    assert world.update(1) == {"object_1"}
    assert world.graph.node("object_1").label == "cup"
    assert world.objects.labels["object_1"] == "cup"


def test_a_forgotten_thing_is_gone_from_every_list(world: Watching) -> None:
    assert world.objects.forget("object_1", world.seen) == {"object_1"}  # type: ignore[arg-type]
    assert world.seen.forgotten == [1]
    assert world.objects.shapes == world.objects.labels == {}
    assert world.objects.document()["nodes"] == []
    assert world.objects.forget("room_1", world.seen) == set()  # type: ignore[arg-type]


@pytest.mark.parametrize("pair", [("object_1", "object_1"), ("object_1", "room_1"), ("plane_3", "object_1")])
def test_only_two_different_things_can_be_joined(world: Watching, pair: tuple[str, str]) -> None:
    with pytest.raises(InvalidStatement, match="merge"):
        world.objects.join(*pair, world.seen)  # type: ignore[arg-type]


def test_things_come_back_from_their_document(world: Watching) -> None:
    world.seen.put(2, "cup", CUBE + 1.0)
    world.update(2)
    again = Objects(lambda number: CLASSES[number - 1], lambda label: label == "door")
    again.restore(world.objects.document(), world.seen, world.graph)  # type: ignore[arg-type]
    assert again.labels == world.objects.labels
    assert again.shapes.keys() == world.objects.shapes.keys()
    world.objects = again
    assert world.update(1, 2) == set(), "nothing has changed"


ELSEWHERE = np.array([2.0, 0.0, 0.0])


def gone(world: Watching, number: int) -> None:
    del world.seen.instances[number], world.seen.surface[number]
    world.update(number)


def test_what_comes_back_where_it_was_has_its_id_again(world: Watching) -> None:
    gone(world, 1)
    world.seen.put(2, "table", CUBE + 0.05, now=20)
    world.update(2)
    [node] = world.graph.nodes("object")
    assert (node.id, node.first_seen_ns) == ("object_1", 10)
    assert "moved_ns" not in node.attributes
    assert world.graph.tombstone("object_1") is None


def test_what_was_carried_elsewhere_keeps_its_id_and_says_from_where(world: Watching) -> None:
    gone(world, 1)
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=20)
    world.update(2)
    [node] = world.graph.nodes("object")
    assert node.id == "object_1"
    assert node.position == pytest.approx([2.0, 0.0, 0.1], abs=0.01)
    assert node.attributes["moved_from"] == pytest.approx([0.0, 0.0, 0.1], abs=0.01)
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=30)
    world.update(2)
    assert world.graph.node("object_1").last_seen_ns == 30, "it is looked after where it is now"


MUCH_LATER = round(2 * KNOWN_S * 1e9)


def test_what_was_found_elsewhere_before_its_old_place_was_looked_at_becomes_itself(world: Watching) -> None:
    world.seen.put(3, "cup", CUBE + ELSEWHERE + BESIDE)
    world.update(3)
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=MUCH_LATER)
    world.update(2)
    assert {n.id for n in world.graph.nodes("object")} == {"object_1", "object_2", "object_3"}
    gone(world, 1)
    [node] = world.graph.nodes("object", label="table")
    assert node.id == "object_1"
    assert node.position == pytest.approx([2.0, 0.0, 0.1], abs=0.01)
    assert world.graph.tombstone("object_2").became == "object_1"  # type: ignore[union-attr]
    assert world.objects.shapes.keys() == world.objects.labels.keys() == {"object_1", "object_3"}


NOTHING_SEEN = Masks(np.zeros((1, 1), np.int32), np.zeros((1, 1), np.uint16), np.zeros(1, np.int64))


@pytest.mark.parametrize(
    ("lost", "kept", "later", "seen", "returns"),
    [
        (1, 3, MUCH_LATER, True, True),
        (3, 1, MUCH_LATER, True, True),  # what came is much larger: it lives on under its own name
        (1, 3, MUCH_LATER, False, False),  # told by an operator: they are one
        (1, 3, 20, True, False),  # parts of one thing that were mapped apart
    ],
)
def test_what_another_was_taken_for_long_after_it_was_seen_may_be_elsewhere(
    world: Watching, lost: int, kept: int, later: int, seen: bool, returns: bool
) -> None:
    world.seen.put(3, "cup", np.tile(CUBE, (1 if lost == 1 else 3, 1)), now=later)
    world.update(3, stamp_ns=later)
    if lost == 3:
        world.seen.surface[1] = CUBE
    del world.seen.instances[lost], world.seen.surface[lost]
    world.update(merged={lost: kept}, stamp_ns=later, masks=NOTHING_SEEN if seen else None)
    assert [n.id for n in world.graph.nodes("object")] == ["object_3"]
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=later + 1)
    world.update(2, stamp_ns=later + 1)
    [node] = world.graph.nodes("object", label="table")
    assert node.id == ("object_1" if returns else "object_2")


def test_where_a_thing_is_found_again_it_was_not_looked_for_in_vain(world: Watching) -> None:
    world.objects.presence.doubts["object_1"] = 2.0
    gone(world, 1)
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=20)
    world.update(2)
    assert world.objects.presence.doubts == {}
    assert world.graph.node("object_1").confidence == 1.0


def test_what_was_just_found_where_nobody_had_been_is_not_what_goes_elsewhere(world: Watching) -> None:
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=MUCH_LATER)
    world.update(2)
    gone(world, 1)
    assert [n.id for n in world.graph.nodes("object")] == ["object_2"]


def test_two_that_were_seen_at_one_time_are_two(world: Watching) -> None:
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=10)
    world.update(2)
    gone(world, 1)
    assert [n.id for n in world.graph.nodes("object")] == ["object_2"]


def test_what_operators_told_of_a_thing_comes_back_with_it(world: Watching) -> None:
    changes = GraphChanges()
    node = world.graph.node("object_1")
    changes.put(node.replace(attributes={**node.attributes, "name": "the old one"}))
    world.graph.commit(changes, world.now)
    gone(world, 1)
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=20)
    world.update(2)
    assert world.graph.node("object_1").attributes["name"] == "the old one"


def test_what_has_gone_is_remembered_over_a_restart(world: Watching) -> None:
    gone(world, 1)
    again = Objects(lambda number: CLASSES[number - 1], lambda label: label == "door")
    again.restore(world.objects.document(), world.seen, world.graph)  # type: ignore[arg-type]
    world.objects = again
    world.seen.put(2, "table", CUBE + ELSEWHERE, now=20)
    world.update(2)
    assert [n.id for n in world.graph.nodes("object")] == ["object_1"]


def test_two_nodes_of_a_class_that_interpenetrate_become_one(world: Watching) -> None:
    world.seen.put(2, "table", CUBE + 0.02, now=20)
    world.update(2)
    assert [n.id for n in world.graph.nodes("object")] == ["object_1"]
    assert world.graph.tombstone("object_2") is None, "nobody ever heard of it"
    assert list(world.seen.instances) == [1]


def test_what_came_to_the_place_of_another_that_looks_different_is_not_that(world: Watching) -> None:
    world.seen.gone = 1
    world.seen.put(2, "table", CUBE + 0.02, now=20)
    world.seen.instances[1].colors[7] = world.seen.instances[2].colors[300] = 1.0
    world.update(1, 2)
    assert [n.id for n in world.graph.nodes("object")] == ["object_2"]
    assert world.graph.tombstone("object_1").reason == "no longer seen"  # type: ignore[union-attr]
    assert list(world.seen.instances) == [2]


@pytest.mark.parametrize(
    ("label", "way", "apart"), [("cup", 0.02, False), ("table", 0.3, False), ("table", 0.02, True)]
)
def test_others_stay_two(world: Watching, label: str, way: float, apart: bool) -> None:
    world.seen.apart = apart
    world.seen.put(2, label, CUBE + way, now=20)
    world.update(2)
    assert {n.id for n in world.graph.nodes("object")} == {"object_1", "object_2"}


@pytest.mark.parametrize("seed", range(30))
def test_whatever_happens_each_thing_has_one_node_and_each_node_one_thing(seed: int) -> None:
    """Things are found, lost, found elsewhere, merged, relabelled and looked for in vain, in any order."""
    rng = np.random.default_rng(seed)
    watching = Watching()
    seen, objects = watching.seen, watching.objects
    number = 0
    for _ in range(60):
        watching.now += MUCH_LATER // 4
        touched, merged = set[int](), dict[int, int]()
        alive = sorted(seen.instances)
        match rng.integers(5):
            case 0 if len(alive) > 1:
                kept, lost = sorted(rng.choice(alive, 2, replace=False).tolist())
                seen.join(kept, lost)
                merged, touched = {lost: kept}, {kept}
            case 1 if alive:
                lost = int(rng.choice(alive))
                del seen.instances[lost], seen.surface[lost]
                touched = {lost}
            case 2 if alive:
                one = int(rng.choice(alive))
                label = CLASSES[int(rng.integers(3))]
                seen.put(one, label, seen.surface[one], views=int(rng.integers(1, 9)), now=watching.now)
                touched = {one}
            case 3 if objects.presence.doubts.keys() != objects._instance_of.keys():
                for name in rng.permutation(sorted(objects._instance_of))[:2]:
                    objects.presence.doubts[str(name)] = float(rng.integers(1, 4))
            case _:
                for _ in range(3):
                    number += 1
                    place = rng.integers(0, 3, 3) * [1.0, 0.01, 0.0]
                    seen.put(number, CLASSES[int(rng.integers(2))], CUBE + place, now=watching.now)
                    touched.add(number)
        doubted = set(objects.presence.doubts)
        objects._look_for = lambda *_, doubted=doubted: doubted  # type: ignore[method-assign, misc]
        watching.update(*touched, merged=merged)
        things = {n.id for layer in ("object", "structure") for n in watching.graph.nodes(layer)}
        assert set(objects._node_of.values()) == things == objects.shapes.keys() == objects.labels.keys()
        assert set(objects._node_of) <= seen.instances.keys()
        assert len(set(objects._node_of.values())) == len(objects._node_of)
        assert all(watching.graph.node(n).label == label for n, label in objects.labels.items())
        assert all(watching.graph.tombstone(n) is None for n in things)
        assert not objects.reappearance.absent.keys() & things
        assert objects.reappearance.newcomers.keys() <= things
