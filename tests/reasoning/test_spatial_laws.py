"""On random worlds the rules agree with their naive twin, and the laws of the relations hold."""

from __future__ import annotations

import random
from itertools import combinations, permutations
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


def acyclic(pairs: set[tuple[str, str]]) -> bool:
    left = set(pairs)
    while left:
        tops = {a for a, _ in left} - {b for _, b in left}
        if not tops:
            return False
        left = {(a, b) for a, b in left if a not in tops}
    return True
