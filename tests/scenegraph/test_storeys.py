"""A house of two storeys with stairs, seen by a camera: each thing is on its storey, and one leads to the other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from scenegraph.world import World
from tests.support.scenes import Block, Scene, looking_at, shell

STAIRS, OVEN, BED = 1, 2, 3
UP = 2.7
"""Height of the upper floor over the lower one [m]."""


def raised(block: Block, by: float) -> Block:
    x, y, z = block.center
    return Block(block.label, (x, y, z + by), block.size, block.thing, block.yaw)


def house() -> Scene:
    """Two rooms of 6 m × 4 m one above the other; stairs along y = 0.5 lead up through a hole in the slab."""
    lower = [b for b in shell((0.0, 0.0), (6.0, 4.0)) if b.label != "ceiling"]
    upper = [raised(b, UP) for b in shell((0.0, 0.0), (6.0, 4.0)) if b.label != "floor"]
    slab = [
        Block(label, (x, y, z), (a, b, 0.15))
        for label, z in (("ceiling", 2.475), ("floor", 2.625))
        for x, y, a, b in ((3.0, 2.6, 6.4, 3.2), (0.4, 0.4, 1.2, 1.2), (5.3, 0.4, 1.8, 1.2))
    ]
    steps = [
        Block("stairs", (1.0 + 0.225 * n, 0.5, 0.5 * 0.18 * (n + 1)), (0.225, 0.9, 0.18 * (n + 1)), STAIRS)
        for n in range(15)
    ]
    things = [
        Block("oven", (5.4, 3.4, 0.45), (0.6, 0.6, 0.9), OVEN),
        Block("bed", (4.9, 3.3, UP + 0.25), (1.8, 1.0, 0.5), BED),
    ]
    return Scene((*lower, *upper, *slab, *steps, *things))


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    scene = house()
    with World() as world:
        world.integrate(scene.label_space)
        n = 0
        for floor_z in (0.0, UP):
            for x, y in ((1.5, 2.4), (4.0, 2.4)):
                for yaw in np.arange(8) * np.pi / 4:
                    for tilt in (-0.8, 0.0, 0.7):
                        n += 1
                        eye = (x, y, floor_z + 1.3)
                        pose = looking_at(eye, (x + np.cos(yaw), y + np.sin(yaw), eye[2] + tilt))
                        world.integrate(scene.image(pose, n * 100_000_000))
            for x, down in ((1.2, -0.6), (2.4, -0.4), (3.6, -0.2)):
                n += 1
                world.integrate(
                    scene.image(looking_at((x, 2.6, floor_z + 1.4), (x, 0.4, floor_z + 1.4 + down)), n * 100_000_000)
                )
        yield world


def room_on(world: World, storey: str) -> str:
    [edge] = world.graph.edges("contains", source=storey)
    return edge.target


def test_there_are_two_storeys_with_a_room_each(world: World) -> None:
    storeys = {n.id: n.attributes for n in world.graph.nodes("storey")}
    assert set(storeys) == {"storey_1", "storey_2"}
    for name, floor_z in (("storey_1", 0.0), ("storey_2", UP)):
        assert storeys[name]["floor_z"] == pytest.approx(floor_z, abs=0.05)
        assert storeys[name]["height_m"] == pytest.approx(2.4, abs=0.05)
        assert world.graph.node(room_on(world, name)).attributes["height_m"] == pytest.approx(2.4, abs=0.05)


def test_each_thing_is_on_its_storey(world: World) -> None:
    assert world.ask("in(oven, storey_1), \\+ in(oven, storey_2)").truth == "true"
    assert world.ask("in(bed, storey_2), \\+ in(bed, storey_1)").truth == "true"
    assert world.ask("in(bed, building), in(oven, building)").truth == "true"
    assert world.ask("room_type(R, kitchen), in(R, storey_1)").truth == "true"
    assert world.ask("room_type(R, bedroom), in(R, storey_2)").truth == "true"
    assert world.ask("above(bed, oven)").truth == "false", "a slab lies between"


def test_the_stairs_lead_from_one_to_the_other(world: World) -> None:
    [stairs] = world.graph.nodes("structure", label="stairs")
    joined = {e.target for e in world.graph.edges("connects", source=stairs.id)}
    assert joined == {room_on(world, "storey_1"), room_on(world, "storey_2")}
    assert world.ask("room_type(A, kitchen), room_type(B, bedroom), leads_to(A, B)").truth == "true"


def test_places_keep_to_their_storey(world: World) -> None:
    heights = {n.attributes["storey"]: float(n.position[2]) for n in world.graph.nodes("place")}
    assert heights == pytest.approx({1: 0.0, 2: UP}, abs=0.05)


def test_two_storeys_come_back_from_disk(world: World, tmp_path: Path) -> None:
    world.save(tmp_path / "house.world")
    with World.load(tmp_path / "house.world") as again:
        assert again.graph == world.graph
        assert [s.floor_z for s in again.perception.rooms.storeys] == [
            s.floor_z for s in world.perception.rooms.storeys
        ]
        assert again.perception.rooms.storeys[1].ceiling_z == world.perception.rooms.storeys[1].ceiling_z
        assert again.ask("room_type(A, kitchen), room_type(B, bedroom), leads_to(A, B)").truth == "true"
