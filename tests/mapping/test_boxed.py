"""A box in an image is no segmentation: what of it is the thing, against scenes whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.boxed import background_planes, surface_in_box
from tests.support import small_home
from tests.support.scenes import CAMERA, Block, Scene, looking_at

ROOM = small_home.SCENE


def boxed(mask: np.ndarray) -> tuple[int, int, int, int]:
    v, u = np.nonzero(mask)
    return int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1


def test_the_background_of_a_box_is_left_out_and_the_thing_is_not() -> None:
    precision, recall, shares = [], [], []
    for pose in small_home.poses():
        depth, hit = ROOM.cast(pose)
        for thing in range(1, 7):
            mask = np.isin(hit, [k + 1 for k, block in enumerate(ROOM.blocks) if block.thing == thing])
            if mask.sum() < 300:
                continue
            box = boxed(mask)
            kept = surface_in_box(depth, CAMERA, box)
            precision.append((kept & mask).sum() / kept.sum())
            recall.append((kept & mask).sum() / mask.sum())
            shares.append(mask.sum() / ((box[2] - box[0]) * (box[3] - box[1])))
    assert len(shares) > 30
    assert np.mean(shares) < 0.8, "boxes hold background"
    assert np.mean(precision) > 0.96
    assert np.mean(recall) > 0.93


def test_what_lies_flat_in_its_background_is_the_whole_box() -> None:
    scene = Scene(
        (Block("wall", (2.0, 0.0, 1.0), (0.2, 4.0, 3.0)), Block("picture", (1.899, 0.0, 1.2), (0.005, 0.6, 0.4), 1))
    )
    depth, hit = scene.cast(looking_at((0.0, 0.0, 1.2), (2.0, 0.0, 1.2)))
    kept = surface_in_box(depth, CAMERA, boxed(hit == 2))
    assert (kept & (hit == 2)).sum() == (hit == 2).sum()


@pytest.mark.parametrize("box", [(-20, -20, -5, -3), (500, 10, 600, 60)])
def test_a_box_beside_the_image_holds_nothing(box: tuple[int, int, int, int]) -> None:
    depth, _ = ROOM.cast(small_home.poses()[0])
    assert not surface_in_box(depth, CAMERA, box).any()


def test_where_nothing_was_measured_the_box_is_all_there_is() -> None:
    kept = surface_in_box(np.zeros((150, 200), np.float32), CAMERA, (10, 20, 30, 50))
    assert kept.sum() == 20 * 30
    assert kept[20:50, 10:30].all()


def test_planes_behind_a_box_are_found_whatever_lies_before_them() -> None:
    random = np.random.default_rng(5)
    floor = np.column_stack([random.uniform(-1, 1, 300), np.full(300, 0.8), random.uniform(1, 3, 300)])
    wall = np.column_stack([random.uniform(-1, 1, 200), random.uniform(-1, 0.8, 200), np.full(200, 3.0)])
    rest = random.uniform((-1, -1, 1), (1, 0.6, 2.8), (60, 3))
    found = background_planes(np.concatenate([floor, wall, rest]))
    assert len(found) == 2
    np.testing.assert_allclose(np.abs(found), [[0, 1, 0, 0.8], [0, 0, 1, 3.0]], atol=0.02)
