"""Relations of boxes: the rules' own answers, the laws, the awkward cases, and changes followed as if made anew."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from reasoning import KnowledgeBase
from reasoning.terms import Atom, Compound
from scenegraph.facts import node_facts
from scenegraph.graph import Box, Edge, GraphChanges, Node, NodeTable, SceneGraph
from scenegraph.relating import RELATIONS, Measured, Things, Thresholds, decide, follow, measure, relate
from tests.support.many_boxes import building

LAWS = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module")
def rules() -> Iterator[KnowledgeBase]:
    with KnowledgeBase() as knowledge:
        yield knowledge


@pytest.fixture(scope="module")
def thresholds(rules: KnowledgeBase) -> Thresholds:
    return Thresholds.of(rules)


# -- worlds -----------------------------------------------------------------------------------------------------------


def thing(name: str, at: tuple[float, ...], size: tuple[float, ...], yaw: float = 0.0, lean: float = 0.0) -> Node:
    """An object, piece of structure or room named `label` or `label_number`; `at` is the middle of its bottom."""
    label = name.rstrip("0123456789").rstrip("_")
    layer = {"wall": "structure", "floor": "structure", "room": "room"}.get(label, "object")
    middle = (at[0], at[1], at[2] + 0.5 * size[2])
    turn = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    if lean:
        c, s = np.cos(lean / 2), np.sin(lean / 2)
        turn = np.array([turn[0] * c, turn[0] * s, turn[3] * s, turn[3] * c])
    box = Box(center=middle, size=size, rotation_wxyz=turn)
    return Node(id=name, layer=layer, label=label, position=middle, box=box, first_seen_ns=0, last_seen_ns=10)


def floor(number: int = 1, z: float = 0.0) -> Node:
    return thing(f"floor_{number}", (0, 0, z - 0.1), (20, 20, 0.1))


def pairs(nodes: list[Node], thresholds: Thresholds) -> dict[str, set[tuple[str, str]]]:
    found: dict[str, set[tuple[str, str]]] = {name: set() for name in RELATIONS}
    for edge in relate(nodes, thresholds):
        found[edge.relation].add((edge.source, edge.target))
    return found


KINDS = (
    ("table", (1.2, 0.7, 0.75)),
    ("shelf", (0.8, 0.3, 1.6)),
    ("basket", (0.4, 0.4, 0.3)),
    ("cup", (0.08, 0.08, 0.1)),
    ("book", (0.25, 0.18, 0.03)),
    ("lamp", (0.2, 0.2, 0.5)),
)
rows = st.tuples(
    st.sampled_from(KINDS),
    st.floats(-1.6, 1.6),
    st.floats(-1.6, 1.6),
    st.floats(-3.1, 3.1),
    st.sampled_from([0.0, 0.0, 0.0, 0.2, 1.0]),
    st.integers(0, 7),
    st.sampled_from([0.0, 0.0, 0.02, 0.4]),
)
arrangements = st.lists(rows, min_size=1, max_size=9)


def arranged(drawn: list, *, walls: bool = True) -> list[Node]:
    """Things on the floor, on or in the thing before, or in the air, in two rooms beside a wall with a gap."""
    nodes = [
        floor(),
        thing("room_1", (-2, 0, 0), (4, 6, 2.5)),
        thing("room_2", (2.05, 0, 0), (3.9, 6, 2.5)),
    ]
    if walls:
        nodes.append(thing("wall_1", (0.013, 1.517, 0), (0.1, 3.0, 2.5)))
    before: Node | None = None
    for n, ((label, size), x, y, yaw, lean, choice, lift) in enumerate(drawn):
        x, y = x + 0.0137 * np.sin(n + 1), y + 0.0113 * np.cos(2 * n + 1)  # nothing grazes the wall by a mere choice
        z = lift
        if before is not None and before.box is not None and choice % 2:
            x, y = before.box.center[:2] + 0.3 * np.array([x, y]) * before.box.size[:2]
            z = before.box.center[2] + 0.5 * before.box.size[2] + lift
            if before.label == "basket" and choice % 4 == 1:
                z = before.box.center[2] - 0.5 * before.box.size[2] + 0.02
        before = thing(f"{label}_{n}", (x, y, z), size, yaw, lean)
        nodes.append(before)
    return nodes


# -- the rules --------------------------------------------------------------------------------------------------------


def tell(knowledge: KnowledgeBase, nodes: list[Node], measured: Measured) -> list[str]:
    """The measurements as facts; returns what can be asked about."""
    ids = measured.things.ids
    facts: list[Compound] = [fact for node in nodes for fact in node_facts(node)]

    def fact(name: str, *args: object) -> None:
        facts.append(Compound("measured", tuple(Atom(a) if isinstance(a, str) else a for a in (name, *args))))  # type: ignore[misc]

    things = [n for n, node in enumerate(nodes) if node.layer in ("object", "structure")]
    for n in things:
        fact("lowest", ids[n], float(measured.lowest[n]))
        fact("longer_side", ids[n], float(measured.longer_side[n]))
    for k, (i, j) in enumerate(measured.pairs.tolist()):
        a, b = sorted((ids[i], ids[j]))
        if np.isfinite(measured.gap[k]):
            fact("gap", a, b, float(measured.gap[k]))
            if measured.clear[k]:
                fact("path_gap_upper", a, b, float(measured.gap[k]))
                fact("path_gap_lower", a, b, float(measured.gap[k]))
        if measured.footprint_overlap[k] > 0.0:
            fact("footprint_overlap", a, b, float(measured.footprint_overlap[k]))
            for upper, lower, rise in ((i, j, measured.rise[k, 0]), (j, i, measured.rise[k, 1])):
                fact("rise", ids[upper], ids[lower], float(rise))
            fact("structure_between", a, b, float(measured.structure_between[k]))
            fact("same_storey", a, b, float(measured.same_storey[k]))
    for name, ends, values in (
        ("contact", measured.standing, measured.contact),
        ("footing_inside", measured.inside, measured.footing_inside),
        ("voxels_inside", measured.inside, measured.voxels_inside),
        ("footprint_share", measured.rooms, measured.footprint_share),
    ):
        for (i, j), value in zip(ends.tolist(), values.tolist(), strict=True):
            fact(name, ids[i], ids[j], value)
    knowledge.update(put=facts)
    return [ids[n] for n in things]


def agree(knowledge: KnowledgeBase, nodes: list[Node]) -> None:
    """The rules derive from the measurements the edges that are decided on columns."""
    limits = Thresholds.of(knowledge)
    table = NodeTable.of(nodes)
    measured = measure(Things.of(table, limits), limits)
    asked = tell(knowledge, nodes, measured)
    try:
        _, derived = knowledge.derived_edges(asked)
    finally:
        knowledge.update(forget=[node.id for node in nodes])
    expected = {edge[:3]: edge[3:] for edge in derived if edge.relation in RELATIONS}
    found = {tuple(e.key): (e.value, e.threshold, e.confidence) for e in decide(measured, limits).table(table)}
    assert found.keys() == expected.keys()
    for key, numbers in expected.items():
        assert found[key] == pytest.approx(tuple(map(float, numbers)), abs=1e-9)


@LAWS
@given(arrangements)
@example(  # a table that leans on a cup: what carries its footing lies farther from it than its nearest point
    [
        *[(("table", (1.2, 0.7, 0.75)), 0.0, 0.0, 0.0, 0.0, 0, 0.0)] * 5,
        (("cup", (0.08, 0.08, 0.1)), 0.0, 0.0, 0.0, 0.0, 0, 0.0),
        (("cup", (0.08, 0.08, 0.1)), 0.0, 0.0, 0.0, 0.0, 1, 0.0),
        (("table", (1.2, 0.7, 0.75)), 0.0, 0.0, 0.0, 1.0, 1, 0.02),
    ]
)
def test_what_is_decided_on_columns_is_what_the_rules_derive(rules: KnowledgeBase, drawn: list) -> None:
    agree(rules, arranged(drawn))


@settings(max_examples=15, deadline=None)
@given(arrangements)
def test_a_users_thresholds_are_followed(strict: KnowledgeBase, drawn: list) -> None:
    agree(strict, arranged(drawn))


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KnowledgeBase]:
    """Rules whose thresholds a user has changed, over a map of voxels."""
    file: Path = tmp_path_factory.mktemp("rules") / "mine.pl"
    file.write_text(
        ":- override(contact_share(0.55)).\n:- override(contact_margin(0)).\n:- override(near_least(0.1)).\n"
        ":- override(near_most(0.9)).\n:- override(overlap_share(0.7)).\n:- override(room_share(0.3)).\n"
        ":- override(own_room_share(1)).\n:- override(footing_inside_share(1)).\n:- override(voxels_inside_share(0)).\n"
    )
    with KnowledgeBase([file]) as knowledge:
        knowledge.update(put=[Compound("parameter", (Atom("voxel_size_m"), 0.025))])
        yield knowledge


def test_thresholds_are_those_of_the_rules(strict: KnowledgeBase) -> None:
    limits = Thresholds.of(strict)
    assert (limits.contact_gap, limits.contact_share, limits.near_most) == (0.025, 0.55, 0.9)


# -- laws -------------------------------------------------------------------------------------------------------------


@LAWS
@given(arrangements)
def test_the_laws_hold(thresholds: Thresholds, drawn: list) -> None:
    nodes = arranged(drawn)
    found = pairs(nodes, thresholds)
    for one, two in (("on", "supports"), ("in", "contains"), ("above", "under")):
        assert {(b, a) for a, b in found[one]} == found[two]
    for name in ("near", "touching"):
        assert {(b, a) for a, b in found[name]} == found[name]
    assert not found["on"] & found["above"]
    left = set(found["on"])
    while left:
        tops = {a for a, _ in left} - {b for _, b in left}
        assert tops, "something stands on itself"
        left = {(a, b) for a, b in left if a not in tops}
    rooms = [a for a, b in found["in"] if b.startswith("room")]
    assert len(set(rooms)) == len(rooms)


@LAWS
@given(arrangements, st.floats(-3, 3), st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
@example(  # a book that leans: by rounding its footprint has more than six corners
    [
        (("book", (0.25, 0.18, 0.03)), 0.0, 0.0, 1.0, 0.2, 0, 0.0),
        (("table", (1.2, 0.7, 0.75)), 0.0, -1.0, 0.0, 0.0, 1, 0.0),
        (("cup", (0.08, 0.08, 0.1)), 0.0, 0.0, 0.0, 0.0, 1, 0.0),
    ],
    -3.0,
    (0.0, 0.0),
)
def test_turning_and_moving_the_world_changes_no_relation(
    thresholds: Thresholds, drawn: list, yaw: float, by: tuple[float, float]
) -> None:
    nodes = arranged(drawn)
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    half = np.array([np.cos(yaw / 2), np.sin(yaw / 2)])
    moved = []
    for node in nodes:
        assert node.box is not None
        w, x, y, z = node.box.rotation_wxyz
        rotation = (
            half[0] * w - half[1] * z,
            half[0] * x - half[1] * y,
            half[0] * y + half[1] * x,
            half[0] * z + half[1] * w,
        )
        center = turn @ node.box.center + (*by, 0)
        moved.append(node.replace(position=center, box=Box(center=center, size=node.box.size, rotation_wxyz=rotation)))
    one, two = ({tuple(e.key): e.confidence for e in relate(n, thresholds)} for n in (nodes, moved))
    different = {key for key in one.keys() ^ two.keys() if max(one.get(key, 0), two.get(key, 0)) > 0.6}
    assert not different


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(arrangements, arrangements, st.lists(st.tuples(st.integers(0, 30), st.booleans()), min_size=1, max_size=8))
def test_changes_that_are_followed_give_what_relating_anew_gives(
    thresholds: Thresholds, drawn: list, later: list, which: list
) -> None:
    nodes = arranged(drawn)
    table = NodeTable.of(nodes)
    graph = SceneGraph.from_tables(table, relate(table, thresholds))
    other = arranged(later)
    for n, delete in which:
        wishes = GraphChanges()
        present = graph.nodes()
        if delete and len(present) > 1:
            wishes.delete_node(present[n % len(present)].id, "gone")
        else:
            wishes.put(other[n % len(other)])
        follow(graph, wishes, thresholds)
        graph.commit(wishes, graph.stamp_ns + 1)
        anew = {e.key: (e.value, e.threshold, e.confidence) for e in relate(graph.nodes(), thresholds)}
        kept = {e.key: (e.value, e.threshold, e.confidence) for e in graph.edges()}
        assert kept == anew


def test_an_edge_that_holds_on_keeps_its_first_time(thresholds: Thresholds) -> None:
    table = NodeTable.of(
        [floor(), thing("table_1", (0, 0, 0), (1, 1, 0.7)), thing("cup_1", (0, 0, 0.7), (0.1, 0.1, 0.1))]
    )
    graph = SceneGraph.from_tables(table, relate(table, thresholds))
    wishes = GraphChanges()
    wishes.put(thing("cup_1", (0.47, 0, 0.7), (0.1, 0.1, 0.1)).replace(last_seen_ns=99))
    follow(graph, wishes, thresholds)
    graph.commit(wishes, 99)
    edge = graph.edge("on", "cup_1", "table_1")
    assert isinstance(edge, Edge)
    assert (edge.value, edge.first_seen_ns, edge.last_seen_ns) == (0.75, 10, 99)


# -- the awkward cases ------------------------------------------------------------------------------------------------


def test_a_cup_on_a_book_on_a_table(thresholds: Thresholds) -> None:
    found = pairs(
        [
            floor(),
            thing("table_1", (0, 0, 0), (1.4, 0.8, 0.75), yaw=0.4),
            thing("book_1", (0.1, 0, 0.75), (0.25, 0.18, 0.02), yaw=1.0),
            thing("cup_1", (0.1, 0, 0.77), (0.08, 0.08, 0.1)),
        ],
        thresholds,
    )
    assert found["on"] == {("table_1", "floor_1"), ("book_1", "table_1"), ("cup_1", "book_1")}
    assert ("cup_1", "table_1") not in found["above"]  # what lies 2 cm over it is within the contact gap


def test_a_chair_half_under_a_table(thresholds: Thresholds) -> None:
    found = pairs(
        [floor(), thing("table_1", (0, 0, 0), (1.4, 0.8, 0.75)), thing("chair_1", (0.6, 0, 0), (0.45, 0.45, 0.9))],
        thresholds,
    )
    assert found["on"] == {("table_1", "floor_1"), ("chair_1", "floor_1")}
    assert ("chair_1", "table_1") in found["near"]


def test_near_does_not_reach_through_a_wall_but_through_the_gap_beside_it(thresholds: Thresholds) -> None:
    wall = thing("wall_1", (0, 0, 0), (0.1, 4, 2.5))
    beds = [thing("bed_1", (-0.6, 0, 0), (1.0, 2, 0.5)), thing("bed_2", (0.6, 0, 0), (1.0, 2, 0.5))]
    assert pairs([floor(), wall, *beds], thresholds)["near"] == set()
    assert pairs([floor(), *beds], thresholds)["near"] == {("bed_1", "bed_2"), ("bed_2", "bed_1")}


def test_a_bed_above_the_oven_one_storey_up_is_not_above_it(thresholds: Thresholds) -> None:
    stacked = [floor(), thing("oven_1", (0, 0, 0), (0.6, 0.6, 0.9)), thing("bed_1", (0, 0, 3), (1, 2, 0.5))]
    assert ("bed_1", "oven_1") in pairs(stacked, thresholds)["above"]
    assert pairs([*stacked, floor(2, 3.0)], thresholds)["above"] == set()
    rooms = [thing("room_1", (0, 0, 0), (4, 4, 2.5)), thing("room_2", (0, 0, 3), (4, 4, 2.5))]
    assert pairs([*stacked, *rooms], thresholds)["above"] == set()


def test_a_bottle_in_a_basket_is_in_it_and_one_in_a_table_is_not(thresholds: Thresholds) -> None:
    for host, expected in (("basket_1", {("bottle_1", "basket_1")}), ("table_1", set())):
        nodes = [floor(), thing(host, (0, 0, 0), (0.5, 0.4, 0.3)), thing("bottle_1", (0, 0, 0.01), (0.08, 0.08, 0.3))]
        assert pairs(nodes, thresholds)["in"] == expected


def test_a_long_table_across_a_border_is_where_most_of_it_is_and_takes_its_cups_along(thresholds: Thresholds) -> None:
    found = pairs(
        [
            floor(),
            thing("room_1", (-2, 0, 0), (4, 4, 2.5)),
            thing("room_2", (2, 0, 0), (4, 4, 2.5)),
            thing("table_1", (-0.4, 0, 0), (2.4, 0.8, 0.7)),
            thing("cup_1", (0.01, 0, 0.7), (0.1, 0.1, 0.1)),
            thing("cup_2", (0.5, 0, 0.7), (0.1, 0.1, 0.1)),
        ],
        thresholds,
    )
    assert found["in"] == {("table_1", "room_1"), ("cup_1", "room_1"), ("cup_2", "room_2")}


def test_a_room_that_was_drawn_counts_as_it_was_drawn(thresholds: Thresholds) -> None:
    room = thing("room_1", (0, 0, 0), (4, 4, 2.5))
    corner = room.replace(attributes={"footprint": [[-2, -2], [2, -2], [2, 0], [0, 0], [0, 2], [-2, 2]]})
    cups = [thing("cup_1", (-1, -1, 0), (0.1, 0.1, 0.1)), thing("cup_2", (1, 1, 0), (0.1, 0.1, 0.1))]
    assert pairs([room, *cups], thresholds)["in"] == {("cup_1", "room_1"), ("cup_2", "room_1")}
    assert pairs([corner, *cups], thresholds)["in"] == {("cup_1", "room_1")}


def test_things_without_boxes_are_points(thresholds: Thresholds) -> None:
    points = [
        Node(id=f"p_{n}", layer="object", label="x", position=(0.3 * n, 0, 0), first_seen_ns=0, last_seen_ns=0)
        for n in range(3)
    ]
    assert pairs(points, thresholds)["near"] == {("p_0", "p_1"), ("p_1", "p_0"), ("p_1", "p_2"), ("p_2", "p_1")}
    assert len(relate([], thresholds)) == 0


def test_every_relation_occurs_in_a_whole_building_and_agrees_with_the_rules(rules: KnowledgeBase) -> None:
    nodes, _ = building(2, 40)
    assert set(pairs(list(nodes), Thresholds.of(rules))) == set(RELATIONS)
    agree(rules, list(nodes))
