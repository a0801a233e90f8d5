"""What is seen, reached and blocked is measured when somebody asks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.observations import RobotDescription
from mapping.occupancy import OccupancyMap
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.perception.access import Access
from scenegraph.perception.relations import MeasurementChange
from scenegraph.world import World
from tests.support.furnishing import Plan, box, thing
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


def test_what_lies_between_is_asked_of_outlines_which_are_forgotten_when_their_thing_changes(copy_home: Copy) -> None:
    world = copy_home()
    outlines = "outline(X, Corners)"
    assert not world.meaning.knowledge.call(outlines), "nobody asked"
    world.ask("between(X, table, oven)")
    told = {str(row["X"]): np.array(row["Corners"]) for row in world.meaning.knowledge.call(outlines)}
    shapes = world.perception.objects.shapes
    assert told.keys() == {name for name, shape in shapes.items() if len(shape.hull) > 2}
    for name, corners in told.items():
        hull, outline = (shapely.Polygon(ring) for ring in (shapes[name].hull, corners))
        assert outline.is_valid
        assert outline.exterior.is_ccw
        assert shapely.hausdorff_distance(hull, outline) < 0.003
    table = world.graph.node(id_of(world, "table"))
    changes = GraphChanges()
    changes.put(table.replace(confidence=0.5))
    world.meaning.infer(changes, MeasurementChange(), [], world.graph, "test", stamp(500))
    left = {str(row["X"]) for row in world.meaning.knowledge.call(outlines)}
    assert left == told.keys() - {table.id}
    world.ask("between(X, table, oven)")
    assert {str(row["X"]) for row in world.meaning.knowledge.call(outlines)} == told.keys()


def test_nothing_is_reached_through_a_wall(copy_home: Copy) -> None:
    """Oven and bed stand back to back; the door is too narrow for this robot, and the bed within its arm's reach."""
    world = copy_home()
    world.integrate(robot(radius_m=0.55, reach_m=2.0))
    assert world.ask("reachable(oven, agent_rob)").truth == "true"
    assert world.ask("reachable(bed, agent_rob)").truth != "true"


def test_what_is_too_far_to_look_for_a_way_is_not_known_to_be_out_of_reach(copy_home: Copy) -> None:
    world = copy_home()
    world.integrate(robot_at(60.0, 40.0, stamp(500)))
    assert world.ask(f"reachable({id_of(world, 'table')}, agent_rob)").truth == "unknown"


@settings(max_examples=40, deadline=None)
@given(
    width=st.floats(0.6, 2.0), aside=st.floats(-1.5, 1.5), wide=st.floats(0.1, 0.8),
    before=st.sampled_from([0.0, 0.2, 1.0]), over=st.sampled_from([0.0, 1.5]), ajar=st.booleans(),
)  # fmt: skip
def test_what_stands_in_a_door_leaves_the_wider_part_beside_it(
    width: float, aside: float, wide: float, before: float, over: float, ajar: bool
) -> None:
    """Also where the node of the door is its leaf, which stands ajar beside the opening."""
    graph, changes = SceneGraph(), GraphChanges()
    times = {"first_seen_ns": 0, "last_seen_ns": 0}
    for name, layer in (("door", "structure"), ("room_1", "room"), ("crate_1", "object")):
        at = (width / 2, width / 2, 1.0) if name == "door" and ajar else (0.0, 0.0, 1.0)
        changes.put(Node(id=name, layer=layer, label=name, position=at, **times))
    way = {"at": [0.0, 0.0]} if ajar else {}
    changes.put(Edge(relation="connects", source="door", target="room_1", value=width, attributes=way, **times))
    graph.commit(changes, 0)
    shapes = {"crate_1": thing(box((wide, 0.2, 0.4)), at=(aside, before, over))}
    walls = Plan(walls=[(-3.0, 0.0, 3.0, 0.0)])
    access = Access(graph, shapes, OccupancyMap(), walls, {}, 0.25)  # type: ignore[arg-type]
    found = access.measure("blocks(X, door)").put
    left, right = max(aside - wide / 2, -width / 2), min(aside + wide / 2, width / 2)
    if before > 0.5 or over > 1.2 or right < left - 0.01:
        assert not found
    elif right > left + 0.01:
        clear = max(left + width / 2, width / 2 - right)
        assert found["clear_width", "crate_1", "door"] == pytest.approx(clear, abs=0.01)
