"""A detector that sends boxes in space and no images: things with lasting ids, and what becomes of them when voxels of
their class, or clusters without one, are there as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.geometry import SE3
from mapping.observations import AgentPose, Box3d, Detection, Detections, Transform
from scenegraph.world import World
from tests.support.scenes import Block, Scene, looking_at

SCENE = Scene(
    (
        Block("floor", (1.0, 0.0, -0.1), (8.0, 8.0, 0.2)),
        Block("crate", (1.5, 0.3, 0.2), (0.5, 0.4, 0.4), 1),
        Block("ball", (1.4, -0.4, 0.15), (0.3, 0.3, 0.3), 2),
    )
)
THINGS = [block for block in SCENE.blocks if block.thing]
POSES = [looking_at((0.1 * n, 0.1 * n - 0.2, 1.2), (1.5, -0.2, 0.2)) for n in range(6)]


def detected(
    n: int, *, noise: float = 0.0, things: list[Block] = THINGS, given: bool = True, **how: object
) -> Detections:
    """The boxes of the things in the frame of a sensor that goes round them."""
    random = np.random.default_rng(n)
    T_map_sensor = SE3.exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.3 * n])
    T_sensor_map = T_map_sensor.inverse()
    items = tuple(
        Detection(
            label=block.label,
            confidence=0.8,
            box3d=Box3d(
                center=T_sensor_map @ (np.array(block.center) + random.normal(0.0, noise, 3)),
                size=np.array(block.size),
                rotation_wxyz=T_sensor_map.quaternion_wxyz,
            ),
        )
        for block in things
    )
    pose = {"T_map_sensor": T_map_sensor} if given else {}
    return Detections(**{"stamp_ns": n + 1, "robot": "rob", "sensor": "radar", "items": items, **pose, **how})


def things(world: World) -> dict[str, str]:
    return {node.label: node.id for node in world.graph.nodes("object")}


def test_boxes_alone_are_things_with_places_relations_and_growing_confidence() -> None:
    with World() as world:
        confidence = []
        for n in range(6):
            world.integrate(detected(n, noise=0.02))
            confidence.append([node.confidence for node in world.graph.nodes("object")])
        assert world.status()["waiting_detections"] == 0
        assert confidence[0] == [], "what was seen once may be a slip of the detector"
        assert (np.diff(confidence[1:], axis=0) > 0.0).all()
        assert things(world).keys() == {"crate", "ball"}
        for block in THINGS:
            node = world.graph.node(things(world)[block.label])
            assert node.box is not None
            assert node.position == pytest.approx(block.center, abs=0.03)
            assert np.sort(node.box.size) == pytest.approx(np.sort(block.size), abs=0.03)
            assert node.attributes["views"] == 6
        assert world.ask("near(crate, ball)").truth == "true"


def test_a_pose_that_is_not_given_is_looked_up() -> None:
    with World() as world:
        for n in range(3):
            T_map_base = SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, 0.3 * n])
            world.integrate(AgentPose(stamp_ns=n + 1, robot="rob", T_map_base=T_map_base))
            T_base_radar = SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
            world.integrate(
                Transform(
                    stamp_ns=n + 1,
                    robot="rob",
                    parent="base_link",
                    child="radar",
                    T_parent_child=T_base_radar,
                    static=True,
                )
            )
            world.integrate(detected(n, given=False))
        [crate] = world.graph.nodes("object", label="crate")
        assert crate.position == pytest.approx(THINGS[0].center, abs=0.02)


def test_boxes_of_a_camera_wait_for_its_image() -> None:
    with World() as world:
        world.integrate(SCENE.image(POSES[0], 1, labelled=False, sensor="radar"))
        world.integrate(detected(3))
        assert world.status()["waiting_detections"] == 1


def test_a_thing_that_gets_voxels_of_its_class_keeps_its_id() -> None:
    with World() as world:
        for n in range(3):
            world.integrate(detected(n))
        before = things(world)
        world.integrate(SCENE.label_space)
        for n, pose in enumerate(POSES):
            world.integrate(SCENE.image(pose, 10 + n))
            world.integrate(detected(20 + n))
        assert things(world) == before
        assert len(world.graph.nodes("object")) == 2
        assert all("voxels" in node.attributes for node in world.graph.nodes("object"))


def test_boxes_of_things_that_are_mapped_already_add_none() -> None:
    with World() as world:
        world.integrate(SCENE.label_space)
        for n, pose in enumerate(POSES):
            world.integrate(SCENE.image(pose, 1 + n))
        before = things(world)
        for n in range(4):
            world.integrate(detected(20 + n, noise=0.02))
        assert things(world) == before
        assert len(world.graph.nodes("object")) == 2


def test_a_cluster_that_a_box_names_keeps_its_id() -> None:
    with World() as world:
        for n, pose in enumerate(POSES):
            world.integrate(SCENE.image(pose, 1 + n, labelled=False))
        unnamed = {node.id: node.position for node in world.graph.nodes("object", label="object")}
        assert len(unnamed) == 2
        for n in range(3):
            world.integrate(detected(20 + n))
        for n, pose in enumerate(POSES):
            world.integrate(SCENE.image(pose, 40 + n, labelled=False))
        assert {node.label for node in world.graph.nodes("object")} == {"crate", "ball"}
        for node in world.graph.nodes("object"):
            assert unnamed[node.id] == pytest.approx(node.position, abs=0.1)


def test_boxes_come_back_from_disk_and_a_deleted_one_does_not(tmp_path: Path) -> None:
    with World() as world:
        for n in range(3):
            world.integrate(detected(n))
        before = things(world)
        assert world.tell(f"delete({before['ball']})", author="me").accepted
        world.save(tmp_path / "boxes.world")
    with World.load(tmp_path / "boxes.world") as again:
        again.integrate(detected(5))
        assert things(again) == {"crate": before["crate"]}
        assert again.graph.node(before["crate"]).attributes["views"] == 4
