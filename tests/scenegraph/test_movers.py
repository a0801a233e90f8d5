"""A world that keeps what moves as models of its own knows where each is, and when it has gone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.moving import GONE_AFTER_S
from mapping.observations import Detection, Detections, LabelSpace
from scenegraph.config import WorldConfig
from scenegraph.world import World
from tests.support.movers import HZ, LABELS, Mover, Stage, straight

SPACE = LabelSpace(
    classes={
        n + 1: {"name": name, "kind": "stuff" if n < 3 else "thing", "moves": name in ("robot", "cat")}
        for n, name in enumerate(LABELS)
    }
)


class Watching:
    """A world that watches movers for some seconds."""

    def __init__(self, world: World, *movers: Mover) -> None:
        self.world = world
        self.stage = Stage(movers)
        world.integrate(SPACE)

    def run(self, seconds: float) -> None:
        for _ in range(round(HZ * seconds)):
            self.world.integrate(self.stage.image(self.stage.t))
            self.stage.t = round(self.stage.t + 1.0 / HZ, 6)


def movers(world: World) -> list[str]:
    return [node.id for node in world.graph.nodes("object") if node.attributes.get("moving")]


def test_a_mover_is_an_object_node_that_moves(tmp_path: Path) -> None:
    with World(WorldConfig(moving="model")) as world:
        watching = Watching(world, Mover(straight))
        watching.run(1.0)
        (mover,) = movers(world)
        first = world.graph.node(mover)
        assert first.label == "robot"
        watching.run(1.0)
        node = world.graph.node(mover)
        assert node.position[0] - first.position[0] == pytest.approx(0.4, abs=0.05)
        assert np.abs(node.position[:2] - straight(1.9)[:2]).max() < 0.06
        assert node.attributes["velocity"] == pytest.approx([0.4, 0.0, 0.0], abs=0.1)
        assert node.attributes["views"] == 20
        assert node.last_seen_ns == round(1.9e9)
        assert len(world.graph.nodes("object")) == 1, "it is no thing of the static map"
        assert world.ask("robot(X), attribute(X, moving, true)").truth == "true"

        world.save(tmp_path / "world")
        with World.load(tmp_path / "world") as again:
            assert again.map.moving.state().keys() == world.map.moving.state().keys()
            assert again.graph.node(mover) == node
            more = Watching(again, Mover(straight))
            more.stage.t = 2.0
            more.run(0.5)
            assert movers(again) == [mover]
            assert again.graph.node(mover).position[0] > node.position[0] + 0.1


def test_a_mover_that_was_not_seen_for_long_leaves_a_tombstone() -> None:
    with World(WorldConfig(moving="model")) as world:
        watching = Watching(world, Mover(lambda t: (-0.5, 0.0, 0.0)))
        watching.run(0.5)
        (mover,) = movers(world)
        watching.stage.movers = (Mover(lambda t: (0.9, 0.3, 0.0), label="cat"),)
        watching.stage.t += GONE_AFTER_S
        watching.run(0.5)
        assert [world.graph.node(i).label for i in movers(world)] == ["cat"]
        tombstone = world.graph.tombstone(mover)
        assert tombstone is not None
        assert "not seen" in tombstone.reason


def test_a_mover_that_was_deleted_does_not_come_back() -> None:
    with World(WorldConfig(moving="model")) as world:
        watching = Watching(world, Mover(straight))
        watching.run(0.5)
        (mover,) = movers(world)
        assert world.tell(f"delete({mover})", author="operator").accepted
        watching.run(0.5)
        assert not movers(world)


@pytest.mark.parametrize("policy", ["leave_out", "fuse"])
def test_other_policies_know_no_movers(policy: str) -> None:
    with World(WorldConfig(moving=policy)) as world:
        watching = Watching(world, Mover(straight))
        watching.run(0.6)
        assert not movers(world)
        assert bool(world.graph.nodes("object")) == (policy == "fuse")


@pytest.mark.parametrize("policy", ["leave_out", "model"])
def test_movers_are_known_from_detections_that_come_after_their_image(policy: str) -> None:
    """Depth was fused before anybody knew of a mover: what it left fades, no thing comes of it, and it is followed."""
    with World(WorldConfig(moving=policy)) as world:
        stage = Stage((Mover(straight),))
        world.integrate(SPACE)
        for n in range(15):
            image = stage.image(n / HZ)
            assert image.instances is not None
            seen = Detection(label="robot", mask=image.instances == 1)
            world.integrate(image.model_copy(update={"labels": None, "instances": None}))
            where = {"stamp_ns": image.stamp_ns, "robot": image.robot, "sensor": image.sensor}
            world.integrate(Detections(**where, items=(seen,)))
        assert bool(movers(world)) == (policy == "model")
        assert len(world.graph.nodes("object")) == (policy == "model")
        if policy == "model":
            node = world.graph.node(movers(world)[0])
            assert np.abs(node.position[:2] - straight(1.4)[:2]).max() < 0.06
