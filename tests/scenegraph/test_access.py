"""What is seen, reached and blocked is measured when somebody asks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapping.observations import RobotDescription
from scenegraph.world import World
from tests.support.small_home import BEDROOM, id_of, robot_at, stamp

Copy = Callable[[], World]


def robot(radius_m: float = 0.2, reach_m: float = 0.8) -> RobotDescription:
    corner = radius_m / np.sqrt(2.0)
    footprint = np.array([[corner, corner], [-corner, corner], [-corner, -corner], [corner, -corner]])
    return RobotDescription(robot="rob", footprint=footprint, height_m=1.2, reach_m=reach_m)


def test_a_thing_in_the_room_is_seen_and_one_behind_the_wall_is_not(copy_home: Copy) -> None:
    world = copy_home()
    table, bed = id_of(world, "table"), id_of(world, "bed")
    assert world.ask(f"visible_from({table}, agent_rob)").truth == "true"
    assert world.ask(f"visible_from({bed}, agent_rob)").truth == "false"
    answer = world.ask(f"visible_from({table}, agent_rob)")
    assert "visible_share" in answer.explain().text
    world.integrate(robot_at(*BEDROOM, stamp(500)))
    assert world.ask(f"visible_from({table}, agent_rob)").truth == "true", "through the door"
    assert world.ask("visible_from(bed, X)").truth == "true"
    world.integrate(robot_at(5.9, 0.4, stamp(501)))
    assert world.ask(f"visible_from({table}, agent_rob)").truth == "false"
    assert not world.graph.edges("visible_from"), "nothing of it is stored"


def test_what_stands_behind_the_door_is_reachable_for_a_robot_that_fits(copy_home: Copy) -> None:
    world = copy_home()
    world.integrate(robot(radius_m=0.2))
    for label in ("table", "oven", "stool"):
        assert world.ask(f"reachable({label}, agent_rob)").truth == "true", label
    assert "way_upper" in world.ask("reachable(stool, agent_rob)").explain().text
    world.integrate(robot(radius_m=0.7))
    assert world.ask("reachable(stool, agent_rob)").truth != "true"


def test_rooms_lead_to_each_other_for_a_robot_that_fits_through_the_door(copy_home: Copy) -> None:
    world = copy_home()
    one, other = sorted(node.id for node in world.graph.nodes("room"))
    world.integrate(robot(radius_m=0.2))
    answer = world.ask(f"leads_to({one}, {other})", robot="rob")
    assert answer.truth == "true"
    assert "through(" in answer.explain().text
    world.integrate(robot(radius_m=0.6))
    assert world.ask(f"leads_to({one}, {other})", robot="rob").truth == "false"


def test_nothing_blocks_a_door_that_is_clear(copy_home: Copy) -> None:
    world = copy_home()
    world.integrate(robot(radius_m=0.2))
    assert world.ask("blocks(X, D)").truth == "false"
