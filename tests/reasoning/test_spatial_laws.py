"""On random worlds the rules agree with their naive twin, and the laws of the relations hold."""

from __future__ import annotations

import math
import random
from itertools import combinations, permutations
from typing import Any

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry.polygon import orient

from reasoning import KnowledgeBase
from tests.reasoning.homes import fact
from tests.reasoning.naive_rules import JUDGES, Measured, relations, room_of

OBJECTS, STRUCTURE, ROOMS = ["a", "b", "c", "d"], ["w"], ["r_1", "r_2"]
THINGS = [*OBJECTS, *STRUCTURE]
DIRECTED: dict[str, list[Any]] = {
    "contact": [0.0, 0.1, 0.2, 0.5, 1.0, "unknown"],
    "footing_inside": [0.5, 0.8, 1.0, "unknown"],
    "voxels_inside": [0.2, 0.3, 1.0, "unknown"],
    "rise": [-1.0, 0.03, 0.04, 0.5, "unknown"],
    "structure_between": [0, 1, "unknown"],
    "same_storey": [0, 1],
    "side_contact": [0.1, 0.2, 1.0, "unknown"],
    "top_contact": [0.1, 0.2, 1.0, "unknown"],
    "clear_below": [0.4, 0.5, 1.0, 1.0, "unknown"],
}
SYMMETRIC: dict[str, list[Any]] = {
    "footprint_overlap": [0.1, 0.2, 1.0, "unknown"],
    "path_gap_upper": [0.0, 0.4, 0.7, 1.5, 1e9, "unknown"],
    "path_gap_lower": [0.0, 0.4, 0.7, 1.5, 1.6],
    "gap": [0.0, 0.03, 0.031, "unknown"],
    "things_between": [0, 1, 2, "unknown"],
}


def world_of(seed: int) -> Measured:
    """A random world; some seeds give sparse ones, some dense ones."""
    draw = random.Random(seed)
    density = draw.choice([0.1, 0.4, 0.9])
    world = Measured(
        objects=OBJECTS,
        structure=STRUCTURE,
        rooms=ROOMS,
        lowest={thing: draw.choice([0.0, 0.4, 0.7]) for thing in THINGS},
        side={thing: draw.choice([0.1, 0.8, 2.5]) for thing in THINGS},
    )
    for measurements, pairs in ((DIRECTED, permutations(THINGS, 2)), (SYMMETRIC, combinations(THINGS, 2))):
        chosen = list(pairs)
        for name, values in measurements.items():
            for a, b in chosen:
                if draw.random() < density:
                    world.binary[name, a, b] = draw.choice(values)
    for thing in OBJECTS:
        share = draw.choice([None, 0.0, 0.3, 0.5, 0.7, 0.8, 1.0])
        if share is not None:
            world.binary["footprint_share", thing, "r_1"] = share
            world.binary["footprint_share", thing, "r_2"] = 1.0 - share
    return world


worlds = st.integers(0, 10**9).map(world_of)


def tell(knowledge: KnowledgeBase, world: Measured) -> None:
    facts = [fact("node", thing, "object") for thing in world.objects]
    facts += [fact("node", thing, "structure") for thing in world.structure]
    facts += [fact("node", room, "room") for room in world.rooms]
    facts += [fact("measured", "lowest", thing, low) for thing, low in world.lowest.items()]
    facts += [fact("measured", "longer_side", thing, side) for thing, side in world.side.items()]
    facts += [fact("measured", name, a, b, value) for (name, a, b), value in world.binary.items()]
    knowledge.update(facts, forget=[*THINGS, *ROOMS])


@pytest.fixture(scope="module")
def empty() -> Any:
    with KnowledgeBase() as knowledge:
        yield knowledge


def canonical(knowledge: KnowledgeBase, truth: str) -> set[tuple[str, str, str]]:
    goal = f"member(R, [{', '.join(JUDGES)}]), judged(R, A, B, {truth}, _)"
    return {(str(row["R"]), str(row["A"]), str(row["B"])) for row in knowledge.call(goal)}


@settings(max_examples=150, deadline=None)
@given(world=worlds)
def test_the_rules_agree_with_their_naive_twin(empty: KnowledgeBase, world: Measured) -> None:
    tell(empty, world)
    expected = relations(world)
    assert canonical(empty, "true") == expected["true"]
    assert canonical(empty, "unknown") == expected["unknown"]


@settings(max_examples=80, deadline=None)
@given(world=worlds)
def test_the_laws_hold(empty: KnowledgeBase, world: Measured) -> None:
    tell(empty, world)
    ids, edges = empty.derived_edges(THINGS)
    assert ids == sorted(THINGS)
    found = {(edge.relation, edge.source, edge.target) for edge in edges}
    assert len(found) == len(edges), "an edge is named twice"

    def pairs(relation: str) -> set[tuple[str, str]]:
        return {(a, b) for name, a, b in found if name == relation}

    for relation, inverse in (("on", "supports"), ("in", "contains"), ("above", "under")):
        assert pairs(inverse) == {(b, a) for a, b in pairs(relation)}
    for relation in ("near", "next_to", "touching"):
        assert pairs(relation) == {(b, a) for a, b in pairs(relation)}
    assert acyclic(pairs("on"))
    assert not pairs("above") & pairs("on")
    rooms = [(a, room) for a, room in pairs("in") if room in ROOMS]
    assert len({a for a, _ in rooms}) == len(rooms), "a thing is in two rooms"
    assert dict(rooms) == {thing: room for thing in THINGS if (room := room_of(world, thing))}
    assert all(0.5 <= edge.confidence <= 1.0 for edge in edges)


@settings(max_examples=25, deadline=None)
@given(world=worlds, asked=st.sets(st.sampled_from(THINGS), min_size=1, max_size=3))
def test_the_edges_of_some_ids_are_all_edges_that_touch_them(
    empty: KnowledgeBase, world: Measured, asked: set[str]
) -> None:
    tell(empty, world)
    _, everything = empty.derived_edges(THINGS)
    ids, edges = empty.derived_edges(asked)
    assert set(ids) >= asked
    assert set(edges) == {edge for edge in everything if edge.source in ids or edge.target in ids}
    [answer] = empty.call(f"derived_edges_of([{', '.join(sorted(asked))}], E)")
    told = {tuple(str(part) for part in edge.args[:3]) for edge in answer["E"]}  # type: ignore[union-attr]
    touching = {edge[:3] for edge in everything if edge.source in asked or edge.target in asked}
    assert told == touching


@settings(max_examples=25, deadline=None)
@given(world=worlds, name=st.sampled_from([*JUDGES, "supports", "contains", "under"]))
def test_every_way_of_asking_gives_the_same(empty: KnowledgeBase, world: Measured, name: str) -> None:
    tell(empty, world)
    unbound = {(str(row["A"]), str(row["B"])) for row in empty.call(f"holds({name}, A, B)")}
    for thing in [*THINGS, *ROOMS]:
        assert {str(row["B"]) for row in empty.call(f"holds({name}, {thing}, B)")} == {
            b for a, b in unbound if a == thing
        }
        assert {str(row["A"]) for row in empty.call(f"holds({name}, A, {thing})")} == {
            a for a, b in unbound if b == thing
        }


boxes = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 2), st.floats(0.05, 2), st.floats(-3.2, 3.2))


def rectangle(x: float, y: float, length: float, width: float, yaw: float) -> shapely.Polygon:
    upright = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return affinity.translate(affinity.rotate(upright, yaw, (0, 0), use_radians=True), x, y)


@settings(max_examples=60, deadline=None)
@given(three=st.tuples(boxes, boxes, boxes), turn=st.floats(-3.2, 3.2))
def test_between_is_the_share_of_the_footprint_in_the_hull_of_two_and_outside_both(
    empty: KnowledgeBase, three: tuple[Any, Any, Any], turn: float
) -> None:
    a, b, c = (rectangle(*row) for row in three)
    share = a.intersection(shapely.union_all([b, c]).convex_hull).difference(shapely.union_all([b, c])).area / a.area
    for angle in (0.0, turn):
        facts = []
        for name, (x, y, length, width, yaw) in zip("abc", three, strict=True):
            at = affinity.rotate(shapely.Point(x, y), angle, (0, 0), use_radians=True)
            facts += [
                fact("node", name, "object"), fact("position", name, at.x, at.y, 0.5),
                fact("size", name, length, width, 1.0), fact("yaw", name, yaw + angle),
            ]  # fmt: skip
        empty.update(facts, forget=[*THINGS, *ROOMS])
        for goal in ("lies_between(a, b, c, S)", "lies_between(a, c, b, S)"):
            rows = empty.call(goal)
            if abs(share - 0.5) > 1e-6:
                assert [round(float(row["S"]), 5) for row in rows] == ([round(share, 5)] if share >= 0.5 else [])  # type: ignore[arg-type]


ground = st.integers(-200, 200).map(lambda centimetres: centimetres / 100)
hulls = st.lists(st.tuples(ground, ground), min_size=3, max_size=9).map(
    lambda corners: shapely.MultiPoint(corners).convex_hull
)


@settings(max_examples=60, deadline=None)
@given(three=st.tuples(hulls, hulls, hulls).filter(lambda three: all(hull.area > 0.05 for hull in three)))
def test_between_goes_by_the_outlines_that_were_told_and_not_by_the_boxes(
    empty: KnowledgeBase, three: tuple[Any, Any, Any]
) -> None:
    a, b, c = three
    both = shapely.union(b, c)
    share = a.intersection(both.convex_hull).difference(both).area / a.area
    facts = []
    for name, hull in zip("abc", (a, b, c), strict=True):
        corners = shapely.get_coordinates(orient(hull))[:-1].tolist()
        facts += [
            fact("node", name, "object"), fact("position", name, 0.0, 0.0, 0.0), fact("size", name, 9.0, 9.0, 1.0),
            fact("outline", name, corners),
        ]  # fmt: skip
    empty.update(facts, forget=[*THINGS, *ROOMS])
    rows = empty.call("lies_between(a, b, c, S)")
    if abs(share - 0.5) > 1e-6:
        assert [round(float(row["S"]), 5) for row in rows] == ([round(share, 5)] if share >= 0.5 else [])  # type: ignore[arg-type]


@settings(max_examples=60, deadline=None)
@given(
    thing=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    viewer=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
    turn=st.floats(-3.2, 3.2),
)
def test_the_opposite_viewer_exchanges_sides_and_turning_the_world_does_not(
    empty: KnowledgeBase, thing: tuple[float, float], viewer: tuple[float, float], turn: float
) -> None:
    x, y, vx, vy = *thing, *viewer
    if math.hypot(x, y) < 0.1 or math.hypot(vx, vy) < 0.1:
        return
    bearing = (math.degrees(math.atan2(y, x) - math.atan2(vy, vx)) + 45) % 90
    if min(bearing, 90 - bearing) < 1e-3:  # on the border between two sectors rounding decides
        return
    c, s = math.cos(turn), math.sin(turn)

    def told(x: float, y: float, viewer: tuple[float, float]) -> set[str]:
        empty.update(
            [fact("node", "a", "object"), fact("node", "b", "object"),
             fact("position", "a", x, y, 0.0), fact("position", "b", 0.0, 0.0, 0.0)],
            forget=[*THINGS, *ROOMS],
        )  # fmt: skip
        return {str(row["R"]) for row in empty.call(f"seen_from(R, a, b, point({viewer[0]}, {viewer[1]}, 1.0), _)")}

    [side] = told(x, y, viewer)
    opposite = {"left_of": "right_of", "right_of": "left_of", "in_front_of": "behind", "behind": "in_front_of"}
    assert told(x, y, (-vx, -vy)) == {opposite[side]}
    assert told(c * x - s * y, s * x + c * y, (c * vx - s * vy, s * vx + c * vy)) == {side}


def acyclic(pairs: set[tuple[str, str]]) -> bool:
    left = set(pairs)
    while left:
        tops = {a for a, _ in left} - {b for _, b in left}
        if not tops:
            return False
        left = {(a, b) for a, b in left if a not in tops}
    return True
