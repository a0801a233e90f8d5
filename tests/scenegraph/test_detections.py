"""Detections and the image they were made in meet, whichever comes first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from mapping.errors import InvalidObservation, PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import Box3d, Detection, Detections, LabelSpace, RgbdImage
from scenegraph.detections import KEPT_DETECTIONS, KEPT_IMAGES, DetectionDesk, painted
from scenegraph.labels import Labels
from scenegraph.world import World
from tests.support.scenes import Block, Scene, looking_at

SCENE = Scene(
    (
        Block("floor", (0.0, 0.0, -0.1), (6.0, 6.0, 0.2)),
        Block("crate", (1.5, 0.3, 0.2), (0.4, 0.4, 0.4), 1),
        Block("ball", (1.4, -0.5, 0.15), (0.3, 0.3, 0.3), 2),
    )
)
POSES = [looking_at((0.1 * n, 0.1 * n, 1.2), (1.5, 0.0, 0.2)) for n in range(5)]
FOREIGN_IDS = LabelSpace(classes={40: {"name": "ball"}, 41: {"name": "sofa"}, 3: {"name": "floor", "kind": "stuff"}})
"""A label space in which ids mean something else than in the world."""


def bare(n: int) -> RgbdImage:
    return SCENE.image(POSES[n], n + 1, labelled=False)


def found(n: int, **how: object) -> Detections:
    """The masks of the things in image n."""
    _, hit = SCENE.cast(POSES[n])
    items = [Detection(label=b.label, confidence=0.9, mask=hit == k + 1) for k, b in enumerate(SCENE.blocks) if b.thing]
    return Detections(**{"stamp_ns": n + 1, "robot": "rob", "sensor": "camera", "items": tuple(items), **how})


def things(world: World) -> list[tuple[str, list[float], list[float]]]:
    nodes = world.graph.nodes("object")
    return sorted((n.label, n.position.tolist(), n.box.size.tolist()) for n in nodes if n.box is not None)


@pytest.fixture(scope="module")
def detected_after() -> Iterator[World]:
    with World() as world:
        world.integrate(FOREIGN_IDS)
        for n in range(len(POSES)):
            world.integrate(bare(n))
            world.integrate(found(n))
        yield world


def test_detections_label_the_image_before_them(detected_after: World) -> None:
    assert [label for label, *_ in things(detected_after)] == ["ball", "crate"]
    for label, position, _ in things(detected_after):
        block = next(b for b in SCENE.blocks if b.label == label)
        assert position == pytest.approx(block.center, abs=0.06)


def test_detections_before_their_image_give_the_same_things(detected_after: World) -> None:
    with World() as world:
        world.integrate(FOREIGN_IDS)
        for n in range(len(POSES)):
            assert not world.integrate(found(n))
            assert world.status()["waiting_detections"] == 1
            world.integrate(bare(n))
            assert world.status()["waiting_detections"] == 0
        assert things(world) == things(detected_after)
        edges = {(e.relation, e.source, e.target) for e in world.graph.edges()}
        assert edges == {(e.relation, e.source, e.target) for e in detected_after.graph.edges()}


def test_a_pose_that_the_map_corrected_holds_for_detections_that_come_later() -> None:
    off = SE3.exp([0.02, 0.01, -0.02, 0.004, -0.003, 0.002])
    worlds = World(), World()
    for before, world in zip((True, False), worlds, strict=True):
        with world:
            for n in range(len(POSES)):
                pose = POSES[n] @ off if n > 1 else POSES[n]
                covariance = np.diag([1e-3] * 3 + [1e-4] * 3) if n > 1 else None
                image = bare(n).model_copy(update={"T_map_camera": pose, "covariance": covariance})
                for observation in (found(n), image) if before else (image, found(n)):
                    world.integrate(observation)
    assert things(worlds[0]) == things(worlds[1]) != []


def test_classes_of_which_only_detections_speak_can_be_asked_for(detected_after: World) -> None:
    assert detected_after.ask("crate(X)").truth == "true"
    assert detected_after.ask("near(crate, ball)").problem is None


def test_an_image_that_is_refused_leaves_its_detections_waiting() -> None:
    with World() as world:
        world.integrate(found(0))
        with pytest.raises(PoseUnavailable):
            world.integrate(bare(0).model_copy(update={"T_map_camera": None}))
        assert world.status()["waiting_detections"] == 1


# -- painting ----------------------------------------------------------------------------------------------------------


def test_boxes_in_the_image_are_painted_the_surest_on_top() -> None:
    labels = Labels()
    image = RgbdImage(**{**dict(bare(0)), "depth": np.zeros((150, 200), np.float32)})  # which says nothing against them
    items = (
        Detection(label="cup", confidence=0.9, box2d=(20.0, 10.0, 60.0, 40.0)),
        Detection(label="sofa", confidence=0.5, box2d=(40.0, 20.0, 5000.0, 90.4)),
    )
    seen = painted(image, Detections(stamp_ns=1, robot="rob", sensor="camera", items=items), labels)
    assert seen.labels is not None
    assert seen.instances is not None
    assert seen.label_confidence is not None
    cup, sofa = labels.id_of("cup"), labels.id_of("sofa")
    assert (seen.labels[10:40, 20:60] == cup).all()
    assert (seen.labels[40:90, 60:] == sofa).all()
    assert (seen.labels == cup).sum() == 30 * 40
    assert (seen.instances[seen.labels == cup] == 1).all()
    assert (seen.instances[seen.labels == sofa] == 2).all()
    assert seen.label_confidence[15, 25] == pytest.approx(0.9)
    assert seen.label_confidence[0, 0] == 0.0


def test_a_box_beside_the_image_paints_nothing() -> None:
    items = (
        Detection(label="cup", box2d=(-50.0, -20.0, -1.0, -1.0)),
        Detection(label="cup", box2d=(900.0, 0.0, 990.0, 9.0)),
    )
    seen = painted(bare(0), Detections(stamp_ns=1, robot="rob", sensor="camera", items=items), Labels())
    assert not seen.labels.any()  # type: ignore[union-attr]


def test_a_box_in_the_image_paints_the_thing_and_not_what_is_behind_it() -> None:
    _, hit = SCENE.cast(POSES[0])
    v, u = np.nonzero(hit == 3)
    box = (float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1))
    items = (Detection(label="ball", box2d=box),)
    seen = painted(bare(0), Detections(stamp_ns=1, robot="rob", sensor="camera", items=items), Labels())
    mine = seen.labels > 0  # type: ignore[operator]
    assert (mine & (hit == 3)).sum() > 0.95 * (hit == 3).sum()
    assert (mine & (hit != 3)).sum() < 0.02 * mine.sum()


def test_a_box_in_space_paints_the_surface_inside_it() -> None:
    image = bare(0)
    _, hit = SCENE.cast(POSES[0])
    block = SCENE.blocks[1]
    T_camera_map = POSES[0].inverse()
    box = Box3d(
        center=T_camera_map @ np.array([block.center])[0],
        size=np.array(block.size) + 0.02,
        rotation_wxyz=T_camera_map.quaternion_wxyz,
    )
    seen = painted(
        image,
        Detections(stamp_ns=1, robot="rob", sensor="camera", items=(Detection(label="crate", box3d=box),)),
        Labels(),
    )
    mine = seen.labels > 0  # type: ignore[operator]
    assert (mine & (hit == 2)).sum() == (hit == 2).sum() > 100
    assert (mine & (hit != 2)).sum() < 0.05 * mine.sum() + 40


def test_a_mask_of_another_shape_is_refused_and_the_image_still_waits() -> None:
    desk, labels = DetectionDesk(), Labels()
    desk.keep(bare(0), POSES[0])
    bad = Detections(
        stamp_ns=1, robot="rob", sensor="camera", items=(Detection(label="cup", mask=np.ones((3, 4), bool)),)
    )
    with pytest.raises(InvalidObservation, match=r"items.0.mask: .*\(150, 200\)"):
        desk.match(bad, labels)
    assert desk.match(found(0), labels) is not None
    assert desk.match(found(0), labels) is None, "an image is labelled once"


def test_an_image_with_labels_of_its_own_does_not_wait() -> None:
    desk = DetectionDesk()
    desk.keep(SCENE.image(POSES[0], 1), POSES[0])
    assert desk.match(found(0), Labels()) is None


def test_what_waits_is_bounded_and_the_newest_stays() -> None:
    desk, labels = DetectionDesk(), Labels()
    for n in range(KEPT_DETECTIONS + 10):
        desk.match(found(0, stamp_ns=1000 + n), labels)
    assert desk.waiting == KEPT_DETECTIONS
    for n in range(KEPT_IMAGES + 2):
        desk.keep(bare(0).model_copy(update={"stamp_ns": n}), POSES[0])
    assert desk.match(found(0, stamp_ns=0), labels) is None
    assert desk.match(found(0, stamp_ns=KEPT_IMAGES + 1), labels) is not None


def test_detections_meet_only_the_image_of_their_sensor() -> None:
    desk, labels = DetectionDesk(), Labels()
    desk.keep(bare(0), POSES[0])
    assert desk.match(found(0, sensor="other"), labels) is None
    assert desk.match(found(0, robot="ann"), labels) is None
    assert desk.match(found(0), labels) is not None
