"""Plans in a home that was mapped: the robot is sent to places that are free, in the right rooms."""

from __future__ import annotations

import numpy as np
import shapely

from scenegraph.world import World
from tests.scenegraph.test_places import FILLED, RADIUS
from tests.support.small_home import BEDROOM, KITCHEN, id_of, room_at


def test_a_book_is_brought_from_the_kitchen_to_the_bed(home: World) -> None:
    plan = home.plan("on(book, bed)", timeout_s=30.0)
    assert plan.status == "solved", plan.problem
    assert plan.validate() is None
    book, bed = id_of(home, "book"), id_of(home, "bed")
    kitchen, bedroom = room_at(home, KITCHEN), room_at(home, BEDROOM)
    assert plan.rooms == (kitchen, bedroom)
    assert [(s.action, s.arguments) for s in plan if s.action in ("pick", "place")] == [
        ("pick", (book,)),
        ("place", (book, bed)),
    ]
    for step in plan:
        assert step.target is not None
        x, y = step.target.translation[:2]
        assert FILLED.distance(shapely.Point(x, y)) > RADIUS - 0.1
    taken = next(s for s in plan if s.action == "pick").target
    assert taken is not None
    away = home.graph.node(book).position[:2] - taken.translation[:2]
    assert np.linalg.norm(away) < 1.6
    assert away @ taken.rotation[:2, 0] > 0.9 * np.linalg.norm(away)  # it looks at the book
    assert home.verify(plan).holds


def test_a_plan_is_kept_while_it_holds(home: World) -> None:
    plan = home.plan("near(robot, stool)", timeout_s=30.0)
    assert plan.status == "solved", plan.problem
    assert home.replan(plan) is plan
