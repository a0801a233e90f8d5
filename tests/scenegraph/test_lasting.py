"""A home is mapped, left, changed and mapped again: what has gone goes, what was carried keeps its name, and events
tell it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from scenegraph.world import World
from tests.support.scenes import Block, Scene
from tests.support.small_home import SCENE, STOOL, VASE, id_of, new_world, poses

NEW_PLACE = (4.6, 2.9)
PAUSE_NS = 3600 * 10**9
RESTED_NS = 100_000_000


def changed() -> Scene:
    """The small home without the vase, and with the stool elsewhere."""
    blocks = []
    for block in SCENE.blocks:
        if block.thing == STOOL:
            block = Block("stool", (*NEW_PLACE, block.center[2]), block.size, STOOL)
        if block.thing != VASE:
            blocks.append(block)
    return Scene(tuple(blocks))


def look_around(world: World, scene: Scene, start_ns: int, vase: tuple[int, int, int] | None = None) -> None:
    """Take the whole way; `vase`: in colour, with the vase of this one and all else grey."""
    names = {label: SCENE.id_of(label) for label in scene.classes}
    for n, pose in enumerate(poses()):
        image = scene.image(pose, start_ns + n * RESTED_NS)
        labels = image.labels.copy()
        for label, number in names.items():
            labels[image.labels == scene.id_of(label)] = number
        update = {"labels": labels}
        if vase is not None:
            color = np.full((*labels.shape, 3), 120, np.uint8)
            color[image.instances == VASE] = vase
            update["color"] = color
        world.integrate(image.model_copy(update=update))


@pytest.fixture(scope="module")
def story() -> Iterator[tuple[World, dict[str, str]]]:
    with new_world() as world:
        world.integrate(SCENE.label_space)
        look_around(world, SCENE, RESTED_NS)
        before = {label: id_of(world, label) for label in ("table", "vase", "book", "oven", "bed", "stool")}
        look_around(world, changed(), PAUSE_NS)
        yield world, before


def test_what_was_taken_away_has_gone_and_says_so(story):
    world, before = story
    assert not world.graph.nodes("object", label="vase")
    assert world.graph.tombstone(before["vase"]).reason == "no longer seen"
    (event,) = [e for e in world.events(PAUSE_NS) if e.kind == "vanished" and e.node == before["vase"]]
    assert event.position[:2] == pytest.approx((0.9, 2.15), abs=0.05)


def test_what_was_carried_elsewhere_keeps_its_id(story):
    world, before = story
    assert id_of(world, "stool") == before["stool"]
    stool = world.graph.node(before["stool"])
    assert stool.position[:2] == pytest.approx(NEW_PLACE, abs=0.1)
    assert stool.first_seen_ns < PAUSE_NS < stool.last_seen_ns
    (event,) = [e for e in world.events(PAUSE_NS) if e.kind == "moved"]
    assert event.node == before["stool"]
    assert event.origin[:2] == pytest.approx((5.5, 2.6), abs=0.05)


def test_what_stayed_keeps_its_id_and_nothing_else_is_there(story):
    world, before = story
    for label in ("table", "book", "oven", "bed"):
        assert id_of(world, label) == before[label]
    assert len(world.graph.nodes("object")) == 5


def test_the_past_is_remembered(story):
    world, before = story
    past = world.graph.as_of(PAUSE_NS - 1)
    assert past.node(before["stool"]).position[:2] == pytest.approx((5.5, 2.6), abs=0.05)
    assert before["vase"] in past


def test_events_outlive_a_restart(story, tmp_path):
    world, _ = story
    world.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        assert again.events() == world.events()
        assert (
            again.perception.objects.reappearance.absent.keys() == world.perception.objects.reappearance.absent.keys()
        )


def test_things_are_followed_over_a_restart_between_two_visits(story, tmp_path):
    followed, before = story
    with new_world() as world:
        world.integrate(SCENE.label_space)
        look_around(world, SCENE, RESTED_NS)
        world.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        look_around(again, changed(), PAUSE_NS)
        ids = {label: id_of(again, label) for label in ("table", "book", "oven", "bed", "stool")}
        assert ids == {label: before[label] for label in ids}
        assert again.graph.tombstone(before["vase"]) is not None
        assert [(e.kind, e.node) for e in again.events(PAUSE_NS)] == [
            (e.kind, e.node) for e in followed.events(PAUSE_NS)
        ]


@pytest.mark.parametrize(("later", "same"), [((190, 60, 50), True), ((50, 70, 190), False)])
def test_what_stands_where_one_of_another_colour_stood_is_another(later, same):
    with new_world() as world:
        world.integrate(SCENE.label_space)
        look_around(world, SCENE, RESTED_NS, (200, 60, 50))
        before = id_of(world, "vase")
        look_around(world, SCENE, PAUSE_NS, later)
        assert (id_of(world, "vase") == before) == same
        assert (world.graph.tombstone(before) is None) == same
        assert len(world.graph.nodes("object")) == 6
