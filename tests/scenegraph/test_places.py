"""Where a phrase leads: regions, and poses that are free, reachable and face the thing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import shapely

from mapping.geometry import SE3
from mapping.observations import RobotDescription
from scenegraph.answers import GoalPose, Place
from scenegraph.world import World
from tests.support import small_home
from tests.support.small_home import SCENE, id_of, room_at, stamp

Copy = Callable[[], World]
RADIUS = 0.25


def filled(below: float = 1.2) -> shapely.Geometry:
    """Ground that furniture and walls truly cover up to this height."""
    parts = []
    for block in SCENE.blocks:
        low = block.center[2] - 0.5 * block.size[2]
        if block.label in ("floor", "ceiling") or low > below:
            continue
        corners = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * block.size
        turn = SE3.exp([0, 0, 0, 0, 0, block.yaw]).rotation
        parts.append(shapely.Polygon((corners @ turn.T + block.center)[:, :2]))
    return shapely.union_all(parts)


FILLED = filled()


def poses(place: Place) -> list[GoalPose]:
    return [pose for answer in place.answers for pose in answer.poses]


def heading(pose: GoalPose) -> np.ndarray:
    return pose.pose.rotation[:2, 0]


@pytest.mark.parametrize("thing", ["oven", "table", "bed", "stool"])
def test_poses_are_free_and_face_the_thing(home: World, thing: str) -> None:
    place = home.where(f"near the {thing}")
    assert place.truth == "true"
    assert place.problem is None
    [answer] = place.answers
    assert answer.nodes == (id_of(home, thing),)
    assert answer.poses
    centre = home.graph.node(id_of(home, thing)).position[:2]
    for pose in answer.poses:
        xy = pose.pose.translation[:2]
        assert room_at(home, tuple(xy)) == room_at(home, tuple(centre)), "not behind the wall"
        assert shapely.distance(shapely.Point(xy), FILLED) > RADIUS - 0.06
        assert pose.clearance_m >= RADIUS
        towards = (centre - xy) / np.linalg.norm(centre - xy)
        assert heading(pose) @ towards > 0.95
        assert shapely.distance(shapely.Point(xy), shapely.Point(centre)) < 2.2
        assert abs(pose.pose.translation[2]) < 0.1, "on the floor"


def test_poses_of_one_place_differ(home: World) -> None:
    found = [p.pose.translation[:2] for p in poses(home.where("near the table"))]
    assert len(found) > 1
    for n, one in enumerate(found):
        assert all(np.linalg.norm(one - other) >= 0.4 for other in found[:n])


def test_the_way_is_as_long_as_the_way_through_the_door(home: World) -> None:
    """The robot is in the kitchen; the bed stands behind the wall."""
    start = np.array(small_home.KITCHEN)
    place = home.where("near the bed", robot="rob")
    lengths = [p.path_length_m for p in poses(place)]
    door = np.array([3.1, 2.65])
    for pose, length in zip(poses(place), lengths, strict=True):
        through = np.linalg.norm(start - door) + np.linalg.norm(pose.pose.translation[:2] - door)
        assert length == pytest.approx(through, rel=0.15)
        assert length > np.linalg.norm(start - pose.pose.translation[:2]) + 0.3  # type: ignore[operator]
    near = home.where("near the oven", robot="rob")
    assert min(p.path_length_m for p in poses(near)) < min(lengths)  # type: ignore[type-var]


def test_the_region_lies_around_the_thing_and_not_in_it(home: World) -> None:
    [answer] = home.where("near the oven").answers
    region = shapely.Polygon(answer.region.polygon)
    block = next(b for b in SCENE.blocks if b.label == "oven")
    assert region.contains(shapely.Point(block.center[0] - 0.6, block.center[1]))
    assert region.bounds[0] > block.center[0] - 0.3 - 1.6
    assert answer.region.z_min <= 0.45 <= answer.region.z_max


def test_a_room_is_a_place_to_stand_in(home: World) -> None:
    place = home.where("in the kitchen")
    assert place.truth == "true"
    kitchen = room_at(home, small_home.KITCHEN)
    assert place.answers[0].nodes == (kitchen,)
    assert place.answers[0].poses
    for pose in place.answers[0].poses:
        x, y = pose.pose.translation[:2]
        assert room_at(home, (float(x), float(y))) == kitchen
        assert shapely.distance(shapely.Point(x, y), FILLED) > RADIUS - 0.06


def test_a_goal_is_a_phrase_too(home: World) -> None:
    place = home.where("on(X, table)")
    assert {answer.nodes[0] for answer in place.answers} == {id_of(home, "vase"), id_of(home, "book")}
    assert all(answer.poses for answer in place.answers)


def test_one_name_for_several_things_is_ambiguous(home: World) -> None:
    place = home.where("near(X, table)")
    assert len(place.answers) >= 2
    assert place.ambiguous == (), "a goal asks for all"


def test_what_is_not_there_is_said(home: World) -> None:
    place = home.where("near(X, oven), on(X, stool)")
    assert place.truth in ("false", "unknown")
    assert place.answers == ()
    assert place.problem is None


@pytest.mark.parametrize(
    "phrase",
    [
        "",
        "   ",
        "how are you",
        "near the",
        "beside the point of no return",
        "near(",
        "7",
        "near the unicorn",
        "on(X",
        "🦄",
    ],
)
def test_a_phrase_that_is_not_understood_gives_a_problem(home: World, phrase: str) -> None:
    place = home.where(phrase)
    assert place.truth == "unknown"
    assert place.answers == ()
    assert place.problem is not None
    assert place.problem.message


def test_a_wide_robot_stands_where_it_fits(copy_home: Copy) -> None:
    world = copy_home()
    corners = 0.4 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    world.integrate(RobotDescription(robot="rob", footprint=corners, height_m=1.0))
    found = poses(world.where("near the table", robot="rob"))
    assert found
    for pose in found:
        assert shapely.distance(shapely.Point(pose.pose.translation[:2]), FILLED) > 0.4 - 0.06
    assert not poses(world.where("near the bed", robot="rob")), "the door is too narrow"


def test_a_robot_whose_place_is_not_known_gets_poses_without_ways() -> None:
    with small_home.new_world() as world:
        for observation in small_home.observations(agent=False):
            world.integrate(observation)  # type: ignore[arg-type]
        found = poses(world.where("near the oven"))
        assert found
        assert all(pose.path_length_m is None for pose in found)
        world.integrate(small_home.robot_at(*small_home.BEDROOM, stamp(60)))
        ways = [pose.path_length_m for pose in poses(world.where("near the oven", robot="rob"))]
        assert all(way is not None and way > 2.0 for way in ways)


def test_an_unexplored_world_offers_no_pose() -> None:
    with World() as world:
        world.integrate(SCENE.label_space)
        assert world.where("near the oven").answers == ()


def test_things_are_found_by_the_colour_that_they_show() -> None:
    """All that is left of the wall is lit red, the rest blue."""
    with small_home.new_world() as world:
        world.integrate(SCENE.label_space)
        for image in small_home.images():
            assert image.T_map_camera is not None
            red = image.T_map_camera.translation[0] < 3.0
            shade = np.array([200, 40, 35] if red else [50, 110, 190], np.uint8)
            world.integrate(image.model_copy(update={"color": np.broadcast_to(shade, (*image.depth.shape, 3)).copy()}))
        oven, stool = id_of(world, "oven"), id_of(world, "stool")
        assert world.graph.node(oven).attributes["seen_color"] == "red"
        assert [answer.nodes for answer in world.where("the blue stool").answers] == [(stool,)]
        assert world.ask("is the oven red?").truth == "true"
        assert world.ask("color(X, red), color(X, blue)").truth == "false"
        assert world.tell(f"set({oven}, color, green)", author="operator").accepted
        assert world.ask("what colour is the oven?").truth == "true"
        assert [row["Color"] for row in world.ask("what colour is the oven?")] == ["green"]
