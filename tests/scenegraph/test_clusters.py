"""Things without labels: clusters against scenes whose truth is known, what they are called, and how long."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from mapping.box_tracks import UprightBox, overlap
from mapping.geometry import SE3
from mapping.observations import RgbdImage, Scan
from scenegraph.config import WorldConfig
from scenegraph.graph import Node
from scenegraph.world import World
from tests.support import small_home
from tests.support.scenes import Block, Scene, looking_at, shell

GOOD_OVERLAP = 0.4


def bare(image: RgbdImage, stamp_ns: int | None = None) -> RgbdImage:
    """An image without its labels."""
    stamp = image.stamp_ns if stamp_ns is None else stamp_ns
    return image.model_copy(update={"labels": None, "instances": None, "stamp_ns": stamp})


def true_box(blocks: list[Block]) -> UprightBox:
    """The box about the blocks of one thing, which are turned alike."""
    low = np.min([np.subtract(b.center, 0.5 * np.array(b.size)) for b in blocks], axis=0)
    high = np.max([np.add(b.center, 0.5 * np.array(b.size)) for b in blocks], axis=0)
    return UprightBox(0.5 * (low + high), high - low, blocks[0].yaw)


def things(scene: Scene) -> dict[int, UprightBox]:
    numbers = sorted({block.thing for block in scene.blocks if block.thing})
    return {n: true_box([b for b in scene.blocks if b.thing == n]) for n in numbers}


def box_of(node: Node) -> UprightBox:
    assert node.box is not None
    return UprightBox(node.box.center, node.box.size, node.box.yaw)


def unnamed(world: World) -> list[Node]:
    return world.graph.nodes("object", label="object")


def matches(world: World, scene: Scene) -> dict[int, str]:
    """Thing → the cluster whose box overlaps its own by enough."""
    return {
        n: node.id for n, box in things(scene).items() for node in unnamed(world)
        if overlap(box_of(node), box) > GOOD_OVERLAP
    }  # fmt: skip


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterable[World]:
    with World() as world:
        for image in small_home.images():
            world.integrate(bare(image))
        yield world


def test_every_thing_of_a_home_without_labels_is_one_cluster_and_nothing_else_is(home: World) -> None:
    found = matches(home, small_home.SCENE)
    assert found.keys() == things(small_home.SCENE).keys()
    assert len(unnamed(home)) == len(found)


def test_clusters_have_relations_like_all_things(home: World) -> None:
    found = matches(home, small_home.SCENE)
    on = {(edge.source, edge.target) for edge in home.graph.edges("on")}
    for upper in (small_home.VASE, small_home.BOOK):
        assert (found[upper], found[small_home.TABLE]) in on
    floors = {node.id for node in home.graph.nodes("structure", label="floor")}
    for thing in (small_home.TABLE, small_home.OVEN, small_home.BED, small_home.STOOL):
        assert any((found[thing], floor) in on for floor in floors)
    assert home.ask(f"on({found[small_home.VASE]}, X)").truth == "true"


def test_clusters_come_back_from_disk(home: World, tmp_path: Path) -> None:
    home.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        before = {node.id: box_of(node) for node in unnamed(home)}
        for n, image in enumerate(small_home.images()[::4]):
            again.integrate(bare(image, small_home.stamp(200 + n)))
        assert {node.id for node in unnamed(again)} == before.keys()
        for node in unnamed(again):
            assert overlap(box_of(node), before[node.id]) > 0.6


def test_labels_that_come_later_take_the_ids_over(home: World, tmp_path: Path) -> None:
    home.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        before = matches(again, small_home.SCENE)
        again.integrate(small_home.SCENE.label_space)
        for n, image in enumerate(small_home.images()):
            again.integrate(image.model_copy(update={"stamp_ns": small_home.stamp(300 + n)}))
        assert unnamed(again) == []
        labels = {block.thing: block.label for block in small_home.SCENE.blocks if block.thing}
        now = {thing: again.graph.successor(node_id) for thing, node_id in before.items()}
        assert {thing: node and node.label for thing, node in now.items()} == labels
        assert len(again.graph.nodes("object")) == 6
        assert sum(node is not None and node.id == before[thing] for thing, node in now.items()) >= 5


def test_where_there_are_labels_there_are_no_clusters() -> None:
    with World() as world:
        world.integrate(small_home.SCENE.label_space)
        for image in small_home.images():
            world.integrate(image)
        named = {node.id for node in world.graph.nodes("object")}
        for n, image in enumerate(small_home.images()):
            world.integrate(bare(image, small_home.stamp(100 + n)))
        assert {node.id for node in world.graph.nodes("object")} == named


def test_a_cluster_that_an_operator_deletes_stays_away(home: World, tmp_path: Path) -> None:
    home.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        stool = matches(again, small_home.SCENE)[small_home.STOOL]
        assert again.tell(f"delete({stool})", author="me").accepted
        for n, image in enumerate(small_home.images()):
            again.integrate(bare(image, small_home.stamp(400 + n)))
        assert small_home.STOOL not in matches(again, small_home.SCENE)
        assert len(unnamed(again)) == 5


# -- rooms at random ---------------------------------------------------------------------------------------------------


def room(seed: int) -> Scene:
    """A room with things that stand apart from each other, turned at random."""
    random = np.random.default_rng(seed)
    blocks: list[Block] = []
    while len(blocks) < 7:
        size = random.uniform((0.15, 0.15, 0.2), (0.8, 0.6, 0.9))
        x, y = random.uniform(0.6, 3.4, 2)
        block = Block("box", (x, y, 0.5 * size[2]), tuple(size.tolist()), len(blocks) + 1, random.uniform(0.0, np.pi))
        reach = 0.5 * np.hypot(*size[:2])
        if all(np.hypot(x - b.center[0], y - b.center[1]) > reach + 0.5 * np.hypot(*b.size[:2]) + 0.15 for b in blocks):
            blocks.append(block)
    return Scene((*shell((0.0, 0.0), (4.0, 4.0)), *blocks))


def round_the_room() -> list[SE3]:
    angles = np.arange(24) * np.pi / 12
    eyes = np.stack([2.0 + 1.8 * np.cos(angles), 2.0 + 1.8 * np.sin(angles), np.full(24, 2.0)], axis=1)
    targets = [
        (2.0 - far * np.cos(a), 2.0 - far * np.sin(a), 0.3) for a, far in zip(angles, [1.0, -0.5] * 12, strict=True)
    ]
    return [looking_at(tuple(eye), target) for eye, target in zip(eyes.tolist(), targets, strict=True)]


def test_things_that_stand_apart_are_found_and_little_else() -> None:
    found = known = told = 0
    for seed in range(4):
        scene = room(seed)
        with World() as world:
            for n, pose in enumerate(round_the_room()):
                world.integrate(scene.image(pose, n + 1, labelled=False))
            found += len(matches(world, scene))
            known += len(things(scene))
            told += len(unnamed(world))
    assert found / known >= 0.95
    assert found / told >= 0.95


def swept(scene: Scene, T_map_sensor: SE3, stamp_ns: int) -> Scan:
    """What a lidar with 0.5° between beams sees of a scene."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0.0, 360.0, 0.5)), np.radians(np.arange(-60.0, 30.0, 0.5)))
    rays = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    nearest = np.full(len(rays), np.inf)
    for block in scene.blocks:
        turn = SE3.exp([0, 0, 0, 0, 0, block.yaw]).rotation
        origin, along = (T_map_sensor.translation - block.center) @ turn, rays @ T_map_sensor.rotation.T @ turn
        along[np.abs(along) < 1e-9] = 1e-9
        middle, reach = -origin / along, 0.5 * np.array(block.size) / np.abs(along)
        near, far = (middle - reach).max(axis=1), (middle + reach).min(axis=1)
        met = (near <= far) & (near > 0.05)
        nearest[met] = np.minimum(nearest[met], near[met])
    there = np.isfinite(nearest)
    points = (rays[there] * nearest[there, None]).astype(np.float32)
    return Scan(stamp_ns=stamp_ns, robot="rob", sensor="lidar", points=points, T_map_sensor=T_map_sensor)


def test_scans_show_the_things_in_a_room_and_no_others() -> None:
    scene = room(11)
    with World(WorldConfig(max_range_m=10.0)) as world:
        for n, (x, y) in enumerate(((0.4, 0.4), (3.6, 0.4), (3.6, 3.6), (0.4, 3.6))):
            world.integrate(swept(scene, SE3(np.eye(3), np.array([x, y, 1.6])), n + 1))
        found = matches(world, scene)
        assert len(found) >= 6
        assert len(unnamed(world)) <= len(found) + 1


def test_a_window_in_its_niche_is_of_the_wall_and_what_stands_before_the_wall_is_not() -> None:
    """The wall at y = 4 is parted by a window of 1.6 m × 1.2 m that lies 0.3 m behind its face."""
    about = [b for b in shell((0.0, 0.0), (4.0, 4.0)) if b.center[1] < 4.0]
    parted = [
        Block("wall", (0.5, 4.2, 1.2), (1.4, 0.4, 2.4)),
        Block("wall", (3.4, 4.2, 1.2), (1.6, 0.4, 2.4)),
        Block("wall", (1.9, 4.2, 0.4), (1.6, 0.4, 0.8)),
        Block("wall", (1.9, 4.2, 2.2), (1.6, 0.4, 0.4)),
        Block("window", (1.9, 4.35, 1.4), (1.6, 0.1, 1.2)),
    ]
    wardrobe = Block("wardrobe", (3.3, 3.75, 0.9), (1.0, 0.5, 1.8), 1)
    scene = Scene((*about, *parted, wardrobe))
    with World() as world:
        for n, pose in enumerate(round_the_room()):
            world.integrate(scene.image(pose, n + 1, labelled=False))
        for n, x in enumerate(np.linspace(0.8, 3.2, 9).tolist()):
            world.integrate(scene.image(looking_at((x, 1.2, 1.5), (1.9, 4.0, 1.4)), 100 + n, labelled=False))
        assert [node.id for node in unnamed(world)] == [matches(world, scene)[1]]


def test_a_cabinet_before_a_wall_is_no_part_of_the_walls_other_side() -> None:
    wall = Block("wall", (2.0, 2.0, 1.2), (0.1, 2.6, 2.4))
    cabinet = Block("cabinet", (2.23, 2.0, 0.55), (0.36, 0.9, 1.1), 1)
    scene = Scene((*shell((0.0, 0.0), (4.0, 4.0)), wall, cabinet))
    with World() as world:
        for n, angle in enumerate(np.arange(24) * np.pi / 12):
            eye = (2.0 + 1.8 * np.cos(angle), 2.0 + 1.8 * np.sin(angle), 1.6)
            for m, z in enumerate((0.4, 1.4)):
                world.integrate(scene.image(looking_at(eye, (2.0, 2.0, z)), 2 * n + m + 1, labelled=False))
        assert 1 in matches(world, scene)


def test_slippers_on_the_floor_are_things() -> None:
    shoes = [Block("shoe", (1.2 + 0.5 * n, 2.0, 0.035), (0.1, 0.28, 0.07), n + 1) for n in range(4)]
    scene = Scene((*shell((0.0, 0.0), (4.0, 4.0)), *shoes))
    with World() as world:
        for n, angle in enumerate(np.arange(24) * np.pi / 12):
            eye = (2.0 + 1.2 * np.cos(angle), 2.0 + 1.2 * np.sin(angle), 1.3)
            world.integrate(scene.image(looking_at(eye, (2.0, 2.0, 0.0)), n + 1, labelled=False))
        assert len(matches(world, scene)) == 4
        assert len(unnamed(world)) == 4


# -- identity ----------------------------------------------------------------------------------------------------------


def test_an_id_stays_while_a_thing_is_seen_from_more_sides_and_goes_with_the_thing() -> None:
    scene = Scene((*shell((0.0, 0.0), (4.0, 4.0)), Block("chest", (2.0, 2.0, 0.4), (1.4, 0.6, 0.8), 1)))
    empty = Scene(tuple(block for block in scene.blocks if not block.thing))
    ids = []
    with World() as world:
        for n, pose in enumerate(round_the_room()):
            world.integrate(scene.image(pose, n + 1, labelled=False))
            ids += [node.id for node in unnamed(world)]
        assert len(set(ids)) == 1
        assert matches(world, scene) == {1: ids[0]}
        for n, pose in enumerate(2 * round_the_room()):
            world.integrate(empty.image(pose, 100 + n, labelled=False))
        assert unnamed(world) == []
        stone = world.graph.tombstone(ids[0])
        assert stone is not None


def test_of_a_cluster_whose_middle_is_taken_away_one_part_keeps_the_id() -> None:
    posts = [Block("post", (x, 2.0, 0.4), (0.3, 0.4, 0.8), n) for n, x in enumerate((1.4, 2.6), start=1)]
    beam = Block("beam", (2.0, 2.0, 0.7), (0.9, 0.4, 0.2), 3)
    walls = shell((0.0, 0.0), (4.0, 4.0))
    with World() as world:
        for n, pose in enumerate(round_the_room()):
            world.integrate(Scene((*walls, *posts, beam)).image(pose, n + 1, labelled=False))
        [whole] = unnamed(world)
        for n, pose in enumerate(2 * round_the_room()):
            world.integrate(Scene((*walls, *posts)).image(pose, 100 + n, labelled=False))
        parts = {node.id for node in unnamed(world)}
        assert len(parts) == 2
        assert whole.id in parts
        assert len(matches(world, Scene((*walls, *posts)))) == 2
