"""Masks of single images become things that last: from all sides, through occlusion, mislabelling and missed masks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from mapping.colors import likeness, piece_colors
from mapping.geometry import SE3
from mapping.instances import InstanceMap
from mapping.segmentation import segment
from mapping.semantics import SemanticMap
from tests.support.scenes import CAMERA, Block, Scene, looking_at

VOXEL = 0.025
FLOOR = Block("floor", (0.0, 0.0, -0.1), (6.0, 6.0, 0.2))


def box(label: str, x: float, y: float, thing: int, size: tuple[float, float, float] = (0.29, 0.29, 0.29)) -> Block:
    return Block(label, (x, y, 0.5 * size[2]), size, thing)


class Watching:
    """An instance map that looks at a scene."""

    def __init__(self, *blocks: Block) -> None:
        self.scene = Scene((FLOOR, *blocks))
        self.map = InstanceMap(voxel_size_m=VOXEL)
        self.merged: dict[int, int] = {}
        self.split: dict[int, int] = {}
        self.now = 0
        self.things = np.zeros(1 << 16, bool)
        for label in self.scene.classes:
            self.things[self.scene.id_of(label)] = label != "floor"

    def look(
        self, eye: tuple[float, float, float], target: tuple[float, float, float] = (0.0, 0.0, 0.1), *,
        hide: Iterable[int] = (), rename: dict[int, str] | None = None, masks: dict[int, int] | None = None,
        color: tuple[int, int, int] | None = None,
    ) -> frozenset[int]:  # fmt: skip
        """One image; `masks`: instance id → the one that the segmenter gives in this image. Returns the touched ids."""
        self.now += 1
        image = self.scene.image(looking_at(eye, target), self.now, hide=hide, rename=rename)
        for old, new in (masks or {}).items():
            given = image.instances.copy()
            given[image.instances == old] = new
            image = image.model_copy(update={"instances": given})
        seen = segment(image, image.depth_m, self.things)
        shown = None if color is None else np.broadcast_to(np.array(color, np.uint8), (*image.depth_m.shape, 3))
        pose = image.T_map_camera or SE3.identity()
        change = self.map.integrate_image(seen, image.depth_m, CAMERA, pose, self.now, color=shown)
        self.merged |= change.merged
        self.split |= change.split
        return change.touched

    def around(self, turns: int = 8, radius: float = 1.4, **how: object) -> None:
        for n in range(turns):
            angle = 2 * np.pi * n / turns
            self.look((radius * np.cos(angle), radius * np.sin(angle), 1.0), **how)  # type: ignore[arg-type]

    @property
    def ids(self) -> list[int]:
        return sorted(self.map.instances)

    def at(self, *point: float) -> int:
        return int(self.map.query([point])[0])


def test_a_thing_keeps_its_id_when_seen_from_the_other_side() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.look((1.4, 0.0, 1.0))
    world.look((-1.4, 0.0, 1.0))
    assert world.ids == [1], "the top joins both sides"
    assert world.at(0.144, 0.0, 0.15) == world.at(-0.144, 0.0, 0.15) == 1
    assert world.map.instances[1].views == 2
    assert (world.map.instances[1].first_seen_ns, world.map.instances[1].last_seen_ns) == (1, 2)


def test_the_points_of_a_thing_lie_on_its_surface() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.around()
    points, weights = world.map.points(1)
    off = np.abs(np.abs(points - (0.0, 0.0, 0.145)).max(axis=1) - 0.145)
    assert len(points) == len(weights) > 300
    assert np.median(off) < 0.002
    assert np.quantile(off, 0.98) < VOXEL
    assert (weights > 0).all()


def test_touching_things_with_masks_of_their_own_stay_two() -> None:
    world = Watching(box("book", -0.145, 0.0, 1), box("book", 0.145, 0.0, 2))
    world.around(16)
    assert len(world.ids) == 2
    assert not world.merged
    assert world.at(-0.1, 0.144, 0.2) != world.at(0.1, 0.144, 0.2)
    sizes = [len(world.map.points(i)[0]) for i in world.ids]
    assert max(sizes) < 1.25 * min(sizes)


def test_mask_ids_mean_nothing_from_one_image_to_the_next() -> None:
    world = Watching(box("crate", -0.4, 0.0, 1), box("crate", 0.4, 0.0, 2))
    world.around(4)
    first = (world.at(-0.4, 0.0, 0.289), world.at(0.4, 0.0, 0.289))
    world.around(4, masks={1: 9, 2: 1})
    assert len(world.ids) == 2
    assert (world.at(-0.4, 0.0, 0.289), world.at(0.4, 0.0, 0.289)) == first


@pytest.mark.parametrize("first", [0.5, 0.9, 1.3])
def test_fragments_become_one_when_a_mask_covers_both(first: float) -> None:
    """A long bench first seen in two parts, then whole; the part seen first may be the smaller one."""
    middle, second = -0.9 + first, 1.8 - first
    left, right = middle - 0.5 * first, middle + 0.5 * second
    world = Watching(box("bench", left, 0.0, 1, (first, 0.29, 0.29)), box("bench", right, 0.0, 2, (second, 0.29, 0.29)))
    world.look((left, 1.0, 1.0), (left, 0.0, 0.1), hide=[2])
    world.look((right, 1.0, 1.0), (right, 0.0, 0.1), hide=[1])
    assert len(world.ids) == 2
    touched: set[int] = set()
    for _ in range(4):
        touched = set(world.look((0.0, 2.2, 1.2), masks={1: 5, 2: 5}))
        if world.merged:
            break
    assert world.ids == [1], "the older id stays"
    assert world.merged == {2: 1}
    assert 1 in touched, "the one that stays has changed"
    assert world.at(left, 0.0, 0.289) == world.at(right, 0.0, 0.289) == 1
    assert world.map.instances[1].first_seen_ns == 1


@pytest.mark.parametrize("own", [3, 5, 8])
def test_what_was_seen_itself_more_often_is_no_part_of_what_covers_it(own: int) -> None:
    """A book on a bench whose mask is missing now and then, so that the mask of the bench lies on it too."""
    book = Block("book", (0.4, 0.0, 0.34), (0.29, 0.29, 0.1), 2)
    world = Watching(box("bench", 0.0, 0.0, 1, (1.6, 0.4, 0.29)), book)
    eye = (0.0, -1.8, 1.4)
    for _ in range(own):
        world.look(eye)
    known = world.at(0.4, 0.0, 0.389)
    assert len(world.ids) == 2
    for _ in range(own - 1):
        world.look(eye, masks={2: 1}, rename={2: "bench"})
    assert not world.merged
    assert world.at(0.4, 0.0, 0.389) == known


def test_missed_masks_cost_nothing() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.around(4)
    before = len(world.map.points(1)[0])
    for _ in range(6):
        world.around(1, hide=[1])
    assert world.ids == [1]
    assert len(world.map.points(1)[0]) > 0.97 * before, "at most its border with the floor gets thinner"


def test_single_wrong_labels_change_neither_identity_nor_class() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1), box("sofa", 50.0, 50.0, 2))
    world.around(4)
    world.around(1, rename={1: "sofa"})
    world.around(4)
    assert len(world.ids) == 1
    known = world.map.instances[1]
    assert known.label == world.scene.id_of("crate")
    assert 0.5 < known.label_share < 1.0


def test_things_far_apart_never_share_an_id() -> None:
    world = Watching(box("cup", -1.0, 0.0, 1), box("cup", 1.0, 0.0, 2))
    world.look((-1.0, 1.2, 0.9), (-1.0, 0.0, 0.1), masks={1: 1})
    world.look((1.0, 1.2, 0.9), (1.0, 0.0, 0.1), masks={2: 1})
    assert len(world.ids) == 2


def test_a_small_thing_before_a_large_one_of_another_class_keeps_its_own_id() -> None:
    world = Watching(box("shelf", 0.0, -0.4, 1, (1.2, 0.3, 1.0)), box("vase", 0.0, -0.1, 2, (0.14, 0.14, 0.25)))
    for x in (-0.8, -0.3, 0.3, 0.8):
        world.look((x, 1.5, 1.0), (0.0, -0.2, 0.3))
    assert len(world.ids) == 2
    vase = world.at(0.0, -0.031, 0.15)
    assert world.map.instances[vase].label == world.scene.id_of("vase")


def test_what_a_thing_left_behind_belongs_to_nobody_after_a_while() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.around(4)
    world.scene = Scene((FLOOR, box("crate", 2.0, 2.0, 1)))
    for _ in range(30):
        world.look((0.0, 1.4, 1.0))
    assert world.at(0.0, 0.0, 0.012) == 0, "the floor that was under it is seen"


def test_what_was_taken_for_one_thing_is_split_when_it_is_seen_apart() -> None:
    world = Watching(box("crate", -0.15, 0.0, 1), box("crate", 0.15, 0.0, 2))
    world.around(8, masks={1: 5, 2: 5})
    (whole,) = world.ids
    world.split = {}
    world.around(24)
    assert set(world.split.values()) == {whole}
    assert len(world.ids) == 2
    left, right = world.at(-0.2, 0.0, 0.289), world.at(0.2, 0.0, 0.289)
    assert {left, right} == set(world.ids)
    sizes = [len(world.map.points(i)[0]) for i in (left, right)]
    assert max(sizes) < 1.25 * min(sizes)


def test_a_slip_of_the_segmenter_is_given_up_when_it_is_looked_at_again() -> None:
    world = Watching(box("crate", -0.4, 0.0, 1), box("table", 0.2, 0.0, 2, (0.9, 0.9, 0.06)))
    world.around(2)
    crate, table = world.at(-0.4, 0.0, 0.289), world.at(0.2, 0.0, 0.058)
    split = np.zeros((CAMERA.height, CAMERA.width), np.uint32)
    split[:, CAMERA.width // 2 :] = 40  # half of the table is a thing of its own, once
    world.now += 1
    image = world.scene.image(looking_at((0.2, -1.4, 1.0), (0.2, 0.0, 0.1)), world.now)
    assert image.instances is not None
    given = np.where(image.instances == 2, image.instances + split, image.instances).astype(np.uint32)
    seen = segment(image.model_copy(update={"instances": given}), image.depth_m, world.things)
    world.map.integrate_image(seen, image.depth_m, CAMERA, image.T_map_camera or SE3.identity(), world.now)
    slip = set(world.ids) - {crate, table}
    assert len(slip) == 1
    assert not slip & set(world.map.query(np.array([[0.3, 0.0, 0.058], [0.1, 0.0, 0.058]])).tolist())
    touched: set[int] = set()
    for _ in range(4):
        touched |= world.look((0.2, -1.4, 1.0), (0.2, 0.0, 0.1))
    assert world.ids == sorted({crate, table})
    assert slip <= touched | set(world.merged)


def test_fading_takes_voxels_away() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.around(4)
    points, _ = world.map.points(1)
    ijk = np.floor(points / VOXEL).astype(int)
    high = points[:, 2] > 0.2
    assert world.map.fade(ijk, high).keys() == {1}
    left = world.map.points(1)[0]
    assert left[:, 2].max() < 0.21
    assert world.at(0.0, 0.0, 0.288) == 0
    assert world.map.fade(ijk, np.ones(len(ijk), bool)).keys() == {1}
    assert len(world.map.points(1)[0]) == 0
    assert world.ids == [1], "it is known until it is forgotten or given up"
    assert world.map.fade(np.empty((0, 3), int), np.empty(0, bool)) == {}
    world.around(4)
    assert world.at(0.0, 0.0, 0.288) != 0


def test_voxels_tell_of_what_was_seen_more_than_once() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.look((1.4, 0.0, 1.0))
    top = np.array([[0.0, 0.0, 0.288]])
    voxel = np.floor(top / VOXEL).astype(int)
    assert world.ids == [1]
    assert world.map.query(top)[0] == 0
    assert world.map.class_votes(voxel)[0][0] == 0
    world.look((1.4, 0.3, 1.0))
    assert world.map.query(top)[0] == 1
    label, votes, others = world.map.class_votes(voxel)
    assert label[0] == world.scene.id_of("crate")
    assert votes[0] > others[0]
    again, same_votes, _ = world.map.classes(voxel * VOXEL, (voxel + 1) * VOXEL)
    assert (again[0], same_votes[0]) == (label[0], votes[0])


def test_joined_and_forgotten_as_told() -> None:
    world = Watching(box("crate", -0.4, 0.0, 1), box("crate", 0.4, 0.0, 2))
    world.around(4)
    left, right = world.at(-0.4, 0.0, 0.289), world.at(0.4, 0.0, 0.289)
    change = world.map.join(left, right)
    assert change.merged == {right: left}
    assert left in change.touched
    assert world.ids == [left]
    assert world.at(0.4, 0.0, 0.289) == left
    world.map.forget(left)
    assert world.ids == []
    assert world.at(0.4, 0.0, 0.289) == 0
    world.around(4)
    assert left not in world.ids, "an id is given once"
    assert world.ids


def test_a_map_that_comes_back_from_its_state_goes_on_with_the_same_ids() -> None:
    world = Watching(box("crate", -0.4, 0.0, 1), box("crate", 0.4, 0.0, 2))
    world.around(4)
    ids = world.ids
    again = InstanceMap.from_state({name: np.array(array) for name, array in world.map.state().items()})
    for i in ids:
        assert np.array_equal(again.points(i)[0], world.map.points(i)[0])
        assert again.instances[i] == world.map.instances[i]
    world.map = again
    world.around(4)
    assert world.ids == ids


@pytest.mark.parametrize("empty", [True, False])
def test_a_query_of_unknown_places_is_zero(empty: bool) -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    if not empty:
        world.around(2)
    assert world.map.query([[50.0, 0.0, 0.0], [0.0, 0.0, 1.5]]).tolist() == [0, 0]


def test_a_voxel_is_of_the_class_of_the_thing_that_it_lies_on() -> None:
    """Wrong labels of single voxels do not change what the thing as a whole is."""
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.around(4)
    crate, floor, chair = world.scene.id_of("crate"), world.scene.id_of("floor"), 999
    classes = SemanticMap(voxel_size_m=0.05)
    points, _ = world.map.points(1)
    beside = np.array([[0.6, 0.6, -0.01], [0.7, 0.3, -0.01]])
    classes.integrate(points, np.full(len(points), chair))
    classes.integrate(beside, np.full(len(beside), floor))
    assert set(classes.query(points)[0].tolist()) == {chair}
    classes.things = world.map
    labels, shares = classes.query(points)
    assert (labels == crate).mean() > 0.98
    assert (shares[labels == crate] > 0.5).all()
    assert classes.query(beside)[0].tolist() == [floor, floor]
    centres, of_voxels, _ = classes.voxels()
    assert np.array_equal(of_voxels, classes.query(centres)[0])
    assert classes.query(np.array([[3.0, 3.0, 3.0]]))[0][0] == 0


MINUTE_NS = 60 * 10**9
RED, BLUE = (200, 40, 40), (40, 40, 200)


def test_what_was_hardly_seen_long_ago_tells_nothing_of_what_is_seen_now() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    world.look((1.4, 0.0, 1.0))
    world.now += 10 * MINUTE_NS
    world.look((1.4, 0.2, 1.0))
    (crate,) = world.map.instances.values()
    assert (crate.views, crate.first_seen_ns) == (1, world.now)


def test_another_thing_in_the_same_place_is_another_instance() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1), box("bin", 2.0, 0.0, 2))
    world.around()
    old = world.at(0.0, 0.0, 0.289)
    world.look((1.4, 0.0, 1.0), rename={1: "bin"})
    assert world.at(0.0, 0.0, 0.289) == old, "one slip of the segmenter is none"
    world.now += 10 * MINUTE_NS
    world.around(rename={1: "bin"})
    new = world.at(0.0, 0.0, 0.289)
    assert new not in (0, old)
    assert old not in world.map.instances
    assert world.map.instances[new].label == world.scene.id_of("bin")


def test_two_of_a_class_that_were_seen_side_by_side_are_known_to_be_two() -> None:
    world = Watching(box("crate", -0.4, 0.0, 1), box("crate", 0.4, 0.0, 2))
    world.around(3)
    one, other = world.ids
    assert world.map.were_apart(one, other)
    assert world.map.were_apart(other, one)
    assert not world.map.were_apart(one, 99)


def test_instances_remember_the_colour_of_their_masks() -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    color = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    color[:] = (200, 100, 50)
    for eye in ((1.4, 0.0, 1.0), (0.0, 1.4, 1.0)):
        image = world.scene.image(looking_at(eye, (0.0, 0.0, 0.1)), 1)
        seen = segment(image, image.depth_m, world.things)
        pose = image.T_map_camera or SE3.identity()
        world.map.integrate_image(seen, image.depth_m, CAMERA, pose, 1, color=color)
    colors = world.map.instances[1].colors
    seen = segment(image, image.depth_m, world.things)
    assert likeness(colors, piece_colors(seen.pieces, seen.trust, 1, color)[0]) == pytest.approx(1.0)
    again = InstanceMap.from_state(world.map.state())
    assert np.array_equal(again.instances[1].colors, colors)


@pytest.mark.parametrize(("later", "same"), [((200, 40, 40), True), ((100, 20, 20), True), ((40, 40, 200), False)])
def test_a_thing_of_another_colour_in_the_same_place_is_another_and_one_in_the_shade_is_not(later, same) -> None:
    world = Watching(box("crate", 0.0, 0.0, 1))
    eyes = ((1.4, 0.0, 1.0), (0.0, 1.4, 1.0), (-1.4, 0.0, 1.0), (0.0, -1.4, 1.0))
    for color, start in (((200, 40, 40), 0), (later, 10 * MINUTE_NS)):
        for n, eye in enumerate(eyes):
            image = world.scene.image(looking_at(eye, (0.0, 0.0, 0.1)), start + n + 1)
            seen = segment(image, image.depth_m, world.things)
            shown = np.broadcast_to(np.array(color, np.uint8), (CAMERA.height, CAMERA.width, 3))
            pose = image.T_map_camera or SE3.identity()
            world.map.integrate_image(seen, image.depth_m, CAMERA, pose, image.stamp_ns, color=shown)
    assert (world.ids == [1]) == same
    assert len(world.ids) == 1


@pytest.mark.parametrize(("minutes", "later", "exchanged"), [(10, BLUE, True), (10, RED, False), (1, BLUE, False)])
def test_of_two_in_one_place_the_one_that_another_colour_came_for_long_after_has_gone(minutes, later, exchanged):
    world = Watching(box("crate", -0.4, 0.0, 1), box("crate", 0.4, 0.0, 2))
    for hidden, color, start in ((2, RED, 0), (1, later, minutes * MINUTE_NS)):
        world.now = start
        for eye in ((1.4, 0.0, 1.0), (-1.4, 0.0, 1.0)):
            world.look(eye, hide=[hidden], color=color)
    one, other = world.ids
    assert world.map.replaced(one, other) == world.map.replaced(other, one) == (one if exchanged else 0)
