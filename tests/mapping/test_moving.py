"""What moves by itself: followed to within a voxel or two, kept out of the static map, never moved back in time."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.geometry import SE3
from mapping.moving import CONFIRMED_VIEWS, GONE_AFTER_S, MovingThings
from tests.support.movers import FINE, HZ, LABELS, Block, Mover, Stage, straight, turning, wanders

ROBOT, CAT = LABELS.index("robot") + 1, LABELS.index("cat") + 1


@pytest.fixture(scope="module")
def driven() -> dict[str, Stage]:
    """One turning robot, by policy."""
    stages = {policy: Stage((Mover(turning),), policy) for policy in ("fuse", "leave_out", "model")}
    for n in range(40):
        image = stages["model"].image(n / HZ)
        for stage in stages.values():
            stage.take(image)
            stage.t = (n + 1) / HZ
    return stages


# -- the three policies --------------------------------------------------------------------------------------
def test_fused_movers_leave_a_trail(driven: dict[str, Stage]) -> None:
    trail, at_mover = driven["fuse"].trail()
    assert trail > 20
    assert at_mover > 100
    assert driven["fuse"].labelled("robot") > 300


def test_left_out_movers_leave_nothing_at_all(driven: dict[str, Stage]) -> None:
    stage = driven["leave_out"]
    assert stage.trail() == (0, 0)
    assert stage.labelled("robot") == 0
    assert not stage.map.instances.instances
    assert not stage.map.moving.things


def test_modelled_movers_leave_no_trail_and_are_known(driven: dict[str, Stage]) -> None:
    stage = driven["model"]
    assert stage.trail() == (0, 0)
    assert stage.labelled("robot") == 0
    assert not stage.map.instances.instances
    assert [thing.label for thing in stage.map.moving.things.values()] == [ROBOT]


# -- tracking ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("way", "noisy"), [(straight, False), (turning, False), (turning, True)])
def test_a_mover_is_followed_to_within_a_voxel_or_two(way, noisy: bool) -> None:
    mover = Mover(way)
    stage = Stage((mover,), noisy=noisy)
    stage.t = 1.0  # it stands whole in the image from the beginning
    stage.run(4.5)
    (thing,) = stage.map.moving.things.values()
    stamps, poses = thing.trajectory
    assert len(stamps) == thing.views == 45
    assert thing.fused >= 43
    off_m, off_deg = wanders(poses, [mover.pose(1e-9 * t) for t in stamps.tolist()])
    assert off_m.max() < 2.0 * FINE
    assert off_deg.max() < 6.0
    t, dt = stage.last, 1e-3
    speed = (mover.pose(t + dt).translation - mover.pose(t - dt).translation) / (2.0 * dt)
    assert np.linalg.norm(_speed_of_middle(thing, mover.pose(t)) - speed) < 0.12
    assert abs(thing.motion.velocity[5] - (mover.way(t + dt)[2] - mover.way(t - dt)[2]) / (2.0 * dt)) < 0.15


def _speed_of_middle(thing, middle: SE3) -> np.ndarray:
    """A body's velocity is one and the same, but that of its frame's origin is not that of its middle."""
    velocity, arm = thing.motion.velocity, middle.translation - thing.motion.pose.translation
    return velocity[:3] + np.cross(velocity[3:], arm)


def test_the_model_is_of_the_movers_shape_and_stands_where_it_is(driven: dict[str, Stage]) -> None:
    stage = driven["model"]
    (mover,) = stage.movers
    (thing,) = stage.map.moving.things.values()
    now = round(1e9 * stage.last)
    points = thing.points_at(now)
    off = np.abs(mover.outside(points, stage.last))
    assert np.median(off) < 0.5 * FINE
    assert np.quantile(off, 0.95) < 2.0 * FINE
    box = thing.box_at(now)
    assert np.abs(np.sort(box.size) - np.sort(mover.size)).max() < 4.0 * FINE
    assert np.linalg.norm(box.center - mover.pose(stage.last).translation) < 2.0 * FINE
    mesh = thing.mesh_at(now)
    assert np.quantile(np.abs(mover.outside(mesh.vertices, stage.last)), 0.95) < 2.0 * FINE
    outward = mesh.vertices + 0.05 * mesh.normals
    grown = mover.outside(outward, stage.last) - mover.outside(mesh.vertices, stage.last)
    assert (grown > 0.0).mean() > 0.95, "normals turn with the thing"


def test_points_tell_which_mover_they_lie_in(driven: dict[str, Stage]) -> None:
    stage = driven["model"]
    (mover,) = stage.movers
    middle = mover.pose(stage.last).translation
    assert stage.map.moving.query([middle, middle + np.array([0.0, 0.0, 1.0]), np.zeros(3)]).tolist() == [1, 0, 0]
    then = mover.pose(2.0).translation
    assert stage.map.moving.query([then, middle], at_ns=round(2e9)).tolist() == [1, 0]
    assert stage.map.moving.query([middle], at_ns=round(1e9 * (stage.last + 2.0 * GONE_AFTER_S))).tolist() == [0]
    assert stage.map.moving.query(np.empty((0, 3))).shape == (0,)


def test_poses_between_images_are_between_and_later_ones_ever_less_certain(driven: dict[str, Stage]) -> None:
    (thing,) = driven["model"].map.moving.things.values()
    stamps, poses = thing.trajectory
    half = thing.motion_at(int(stamps[10] + stamps[11]) // 2)
    assert half.pose.isclose(poses[10].interpolate(poses[11], 0.5), atol=1e-6)
    assert thing.motion_at(0 if stamps[0] == 0 else int(stamps[0]) - 1).pose.isclose(poses[0])
    later = [thing.motion_at(thing.last_seen_ns + round(1e9 * s)) for s in (0.0, 1.0, 5.0, 60.0)]
    spread = [float(np.sqrt(m.covariance[:2, :2].trace())) for m in later]
    assert spread == sorted(spread)
    assert spread[0] < 0.02
    assert spread[2] > 1.0
    far = np.linalg.norm(later[3].pose.translation - later[0].pose.translation)
    assert far < 1.5 * np.linalg.norm(thing.motion.velocity[:3]) + 1e-6, "it is not taken to go on for ever"


# -- who is who ----------------------------------------------------------------------------------------------
def test_two_movers_that_cross_keep_their_ids() -> None:
    """They pass each other, the near one before the far one."""
    stage = Stage((
        Mover(lambda t: (-1.0 + 0.5 * t, 0.0, 0.0), (0.4, 0.3, 0.6), "robot", 1),
        Mover(lambda t: (1.0 - 0.5 * t, 0.7, 0.0), (0.4, 0.3, 0.8), "robot", 2),
    ))  # fmt: skip
    stage.run(0.5)
    first = {i: thing.motion.pose.translation[0] for i, thing in stage.map.moving.things.items()}
    assert len(first) == 2
    stage.run(3.5)
    assert stage.map.moving.things.keys() == first.keys()
    for mover in stage.movers:
        known = stage.map.moving.query([mover.pose(stage.last).translation])[0]
        assert known
        assert (first[known] < 0.0) == (mover.pose(0.0).translation[0] < 0.0)


def test_a_mover_behind_a_shelf_is_the_same_when_it_comes_out() -> None:
    stage = Stage(
        (Mover(lambda t: (-1.2 + 0.6 * t, 0.6, 0.0), (0.4, 0.3, 0.6)),),
        extra=(Block("shelf", (0.0, -0.5, 0.6), (0.7, 0.3, 1.2), 7),),
    )
    stage.run(4.0)
    (thing,) = stage.map.moving.things.values()
    assert thing.views < 36, "it was hidden for a while"
    middle = stage.movers[0].pose(stage.last).translation
    assert stage.map.moving.query([middle]).tolist() == [thing.id]


def test_a_mask_seen_once_or_twice_is_no_thing() -> None:
    stage = Stage((Mover(straight),))
    for _ in range(CONFIRMED_VIEWS - 1):
        stage.run(1.0 / HZ)
        assert not stage.map.moving.things
        assert not stage.changes[-1].moving.touched
    stage.run(1.0 / HZ)
    assert list(stage.map.moving.things) == [1]
    assert stage.changes[-1].moving.touched == {1}


def test_who_was_away_for_long_comes_back_as_another_and_is_not_forgotten() -> None:
    stage = Stage((Mover(lambda t: (-0.5, 0.0, 0.0), thing=1), Mover(lambda t: (0.8, 0.0, 0.0), thing=2)))
    stage.run(0.5)
    assert set(stage.map.moving.about()) == {1, 2}
    stage.t += GONE_AFTER_S
    stage.run(0.5)
    assert set(stage.map.moving.things) == {1, 2, 3, 4}
    assert set(stage.map.moving.about()) == {3, 4}
    assert set(stage.map.moving.about(at_ns=round(0.4e9))) == {1, 2}
    assert {1, 2} <= stage.changes[5].moving.touched, "that they are gone is news"


def test_another_that_appears_far_off_is_another() -> None:
    stage = Stage((Mover(lambda t: (-1.5, 0.5, 0.0)),))
    stage.run(0.5)
    stage.movers = (Mover(lambda t: (1.2, 0.5, 0.0)),)
    stage.t += 5.0
    stage.run(0.5)
    assert set(stage.map.moving.things) == {1, 2}
    assert set(stage.map.moving.about()) == {1, 2}


# -- masks that are missed -----------------------------------------------------------------------------------
def test_missed_masks_leave_a_trail_that_clearing_erases() -> None:
    stage = Stage((Mover(turning),), "leave_out")
    stage.run(1.5)
    stage.run(0.3, hide=[1])
    assert sum(stage.trail()) > 30
    stage.run(2.7)
    assert stage.trail() == (0, 0)


@pytest.mark.parametrize("how", ["no mask", "a wrong class", "no labels at all"])
def test_what_is_followed_leaves_no_trail_where_its_mask_is_missed(how: str) -> None:
    stage = Stage((Mover(turning),))
    stage.run(1.5)
    for _ in range(3):
        image = stage.image(stage.t, hide=[1] if how == "no mask" else ())
        labels = image.labels
        if how == "a wrong class":
            labels = np.where(labels == ROBOT, np.uint16(LABELS.index("shelf") + 1), labels)
        stage.take(image.model_copy(update={"labels": None if how == "no labels at all" else labels}))
        stage.t = round(stage.t + 1.0 / HZ, 6)
    assert sum(stage.trail()) < 5
    assert stage.labelled("shelf") < 5
    stage.run(1.0)
    (thing,) = stage.map.moving.things.values()
    assert thing.views == 25, "it is still the same"
    assert thing.fused > 23
    middle = stage.movers[0].pose(stage.last).translation
    assert np.linalg.norm(thing.box_at(thing.last_seen_ns).center - middle) < 2.0 * FINE


def test_where_a_mover_was_long_ago_the_map_is_made_again() -> None:
    stage = Stage((Mover(lambda t: (0.3, 0.5, 0.0)),))
    stage.run(1.0)
    stage.movers = ()
    stage.extra = (Block("shelf", (0.3, 0.5, 0.4), (0.5, 0.35, 0.8), 7),)
    stage.t += 1.0
    stage.run(0.5)
    assert stage.labelled("shelf") > 300


# -- time and state ------------------------------------------------------------------------------------------
def test_an_image_that_comes_late_moves_nothing_back() -> None:
    stage = Stage((Mover(straight),))
    stage.run(1.0)
    before = stage.map.moving.state()
    assert stage.take(stage.image(0.3)).moving.touched == frozenset()
    after = stage.map.moving.state()
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert stage.trail() == (0, 0), "it is left out of the static map all the same"


def test_two_cameras_at_one_time_see_one_thing() -> None:
    stage = Stage((Mover(straight),))
    for n in range(8):
        for eye in ((-0.3, -2.5, 1.4), (0.4, -2.4, 1.2)):
            stage.take(stage.image(1.0 + n / HZ, eye=eye))
    (thing,) = stage.map.moving.things.values()
    assert thing.views == 16
    assert len(thing.trajectory[0]) == 8


def test_an_image_without_movers_changes_nothing() -> None:
    stage = Stage((Mover(straight),))
    stage.run(1.0)
    before = stage.map.moving.state()
    stage.movers = ()
    change = stage.take(stage.image(1.5))
    assert not change.moving.touched
    after = stage.map.moving.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_without_movers_the_policies_make_the_same_map() -> None:
    shelf = (Block("shelf", (0.0, 0.5, 0.6), (0.7, 0.3, 1.2), 7),)
    maps = []
    for policy in ("fuse", "leave_out", "model"):
        stage = Stage((), policy, extra=shelf)
        stage.run(0.3)
        maps.append(stage.map.state())
    for other in maps[1:]:
        for layer, arrays in maps[0].items():
            assert all(np.array_equal(array, other[layer][name]) for name, array in arrays.items()), layer


def test_what_is_saved_comes_back_and_goes_on_as_if_nothing_had_been() -> None:
    stage = Stage((Mover(turning), Mover(lambda t: (0.3, 1.2, 0.3 * t), (0.3, 0.3, 0.3), "cat", 2)))
    stage.run(1.5)
    saved = stage.map.moving.state()
    again = MovingThings.from_state({name: np.array(array) for name, array in saved.items()})
    stage.run(1.0)
    expected = stage.map.moving.state()
    twin = Stage(stage.movers)
    twin.map.moving, twin.t = again, 1.5
    twin.run(1.0)
    told = twin.map.moving.state()
    assert expected.keys() == told.keys()
    for name, array in expected.items():
        assert np.array_equal(array, told[name]), name
    assert {thing.label for thing in again.things.values()} == {ROBOT, CAT}


# -- what a rigid model does not know ------------------------------------------------------------------------
def test_a_body_that_swings_its_legs_is_followed_as_one_thing() -> None:
    """Its model fits one image in some: in the others it is followed by its middle."""

    def walking(side: float) -> Mover:
        swing = 0.0 if side == 0.0 else 0.2 * side
        size = (0.25, 0.4, 0.7) if side == 0.0 else (0.15, 0.14, 0.8)

        def way(t: float) -> tuple[float, float, float]:
            return -0.9 + 0.6 * t + swing * np.sin(2.0 * np.pi * t), 0.12 * side, 0.0

        return Mover(way, size, lift=0.8 if side == 0.0 else 0.0)

    stage = Stage((walking(0.0), walking(1.0), walking(-1.0)), noisy=True)
    stage.run(3.0)
    (thing,) = stage.map.moving.things.values()
    assert thing.views == 30
    assert 2 <= thing.fused < 30, "nobody claims that it is rigid"
    torso = stage.movers[0].pose(stage.last).translation
    box = thing.box_at(thing.last_seen_ns)
    assert np.linalg.norm(box.center[:2] - torso[:2]) < 0.25
    assert 1.2 < box.size[2] < 1.7
    _, poses = thing.trajectory
    assert (poses[-1].translation - poses[0].translation)[0] == pytest.approx(0.6 * 2.9, abs=0.25)
    assert stage.trail()[0] == 0
