"""Planes get the labels that the rules make cheapest; new labels are lines of a rule file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning.errors import InvalidRules
from reasoning.knowledge import KnowledgeBase
from reasoning.labelling import FACINGS, NO_FEATURE, PlaneFacts, PlaneRelation, PlaneRules
from reasoning.terms import Atom, Compound, Term, Var
from rules import rule_path
from tests.support.storey_planes import storey_planes

REFERENCE = Path(__file__).parents[1] / "rules" / "generate_and_test.pl"


@pytest.fixture(scope="module")
def reference() -> Iterator[KnowledgeBase]:
    with KnowledgeBase([REFERENCE]) as knowledge:
        yield knowledge


@pytest.fixture(scope="module")
def rules(reference: KnowledgeBase) -> PlaneRules:
    return PlaneRules.of(reference)


def plane(
    id_: int, facing: str, z_min: float, z_max: float, width_m: float, area_m2: float, given: str | None = None,
    **evidence: float,
) -> PlaneFacts:  # fmt: skip
    return PlaneFacts(id_, facing, z_min, z_max, width_m, area_m2, evidence, given)


FLOOR, CEILING, SOUTH, NORTH, WEST, EAST = range(6)
WALLS = (SOUTH, NORTH, WEST, EAST)
ROOM = [
    plane(FLOOR, "up", 0.0, 0.0, 4.0, 12.0),
    plane(CEILING, "down", 2.5, 2.5, 4.0, 12.0),
    plane(SOUTH, "side", 0.0, 2.5, 4.0, 10.0),
    plane(NORTH, "side", 0.0, 2.5, 4.0, 10.0),
    plane(WEST, "side", 0.0, 2.5, 3.0, 7.5),
    plane(EAST, "side", 0.0, 2.5, 3.0, 7.5),
]
"""A room of 4 m × 3 m × 2.5 m."""


def in_room(piece: PlaneFacts) -> list[PlaneRelation]:
    """How a plane in the room stands to its floor and ceiling."""
    if piece.facing == "side":
        return [("orthogonal", FLOOR, piece.id), ("above", piece.id, FLOOR),
                ("orthogonal", CEILING, piece.id), ("above", CEILING, piece.id)]  # fmt: skip
    return [("parallel", FLOOR, piece.id), ("above", piece.id, FLOOR), ("above", CEILING, piece.id)]


ROOM_RELATIONS: list[PlaneRelation] = [
    ("parallel", FLOOR, CEILING), ("above", CEILING, FLOOR), ("parallel", SOUTH, NORTH), ("parallel", WEST, EAST),
    *((name, a, b) for name in ("orthogonal", "equalheight") for a in (SOUTH, NORTH) for b in (WEST, EAST)),
    *(relation for wall in WALLS for relation in in_room(ROOM[wall])),
]  # fmt: skip


def furnished(
    rules: PlaneRules, furniture: list[PlaneFacts], *between: PlaneRelation, at: tuple[int, ...] = ()
) -> list[str]:
    """The labels of furniture in the room, and of the planes `at`."""
    placed = [relation for piece in furniture for relation in in_room(piece)]
    labels = rules.label([*ROOM, *furniture], [*ROOM_RELATIONS, *placed, *between]).labels
    return [labels[piece.id] for piece in furniture] + [labels[i] for i in at]


# -- rooms -----------------------------------------------------------------------------------------------------


def test_an_empty_room_has_no_clutter(rules: PlaneRules) -> None:
    found = rules.label(ROOM, ROOM_RELATIONS)
    assert list(found.labels.values()) == ["floor", "ceiling", *["wall"] * 4]
    assert found.optimal


def test_no_planes_have_no_labels(rules: PlaneRules) -> None:
    assert rules.label([], []).labels == {}


@pytest.mark.parametrize(
    ("furniture", "between", "expected"),
    [
        pytest.param([plane(9, "up", 0.74, 0.76, 1.6, 1.2)], [], [NO_FEATURE], id="a table is not a floor"),
        pytest.param([plane(9, "down", 1.2, 1.2, 1.0, 0.4)], [], [NO_FEATURE], id="a board is not a ceiling"),
        pytest.param([plane(9, "side", 0.0, 2.1, 1.8, 3.8)], [("parallel", 9, NORTH)], [NO_FEATURE],
                     id="a cupboard front is not a wall"),
        pytest.param([plane(9, "side", 0.0, 1.8, 0.65, 1.2)], [("orthogonal", 9, NORTH)], [NO_FEATURE],
                     id="the side of a fridge is not a leaf"),
        pytest.param([plane(9, "side", 0.0, 2.0, 0.9, 1.8, door=0.8)], [("orthogonal", 9, NORTH)], ["door"],
                     id="a leaf at right angles is one where it was seen to be one"),
        pytest.param([plane(8, "side", 0.0, 1.8, 0.65, 1.2), plane(9, "side", 0.0, 1.8, 0.65, 1.2)],
                     [("orthogonal", 8, 9), ("equalheight", 8, 9)], [NO_FEATURE] * 2,
                     id="a box that stands askew is no leaf"),
        pytest.param([plane(8, "side", 0.01, 2.0, 0.9, 1.8), plane(9, "side", 0.01, 2.0, 0.9, 1.8)],
                     [("parallel", 8, 9)], ["door", "door"], id="a leaf ajar is a door"),
        pytest.param([plane(9, "side", 0.0, 2.0, 0.3, 1.8)], [], [NO_FEATURE], id="a leaf is not narrow"),
        pytest.param([plane(9, "side", 0.0, 2.0, 1.6, 1.8)], [], [NO_FEATURE], id="a leaf is not wide"),
        pytest.param([plane(9, "side", 0.3, 1.2, 2.0, 1.6)], [], [NO_FEATURE], id="half a wall is none"),
        pytest.param([plane(9, "side", 0.3, 1.2, 2.0, 1.6, wall=0.9)], [], ["wall"],
                     id="half a wall is one where it was seen to be one"),
    ],
)  # fmt: skip
def test_furniture_is_told_from_structure(
    rules: PlaneRules, furniture: list[PlaneFacts], between: list[PlaneRelation], expected: list[str]
) -> None:
    assert furnished(rules, furniture, *between) == expected


def test_many_tables_do_not_outvote_the_floor(rules: PlaneRules) -> None:
    tables = [plane(10 + k, "up", 0.75, 0.75, 1.5, 1.1) for k in range(6)]
    level: list[PlaneRelation] = [("equalheight", a, b) for a in (10, 11) for b in (12, 13, 14, 15)]
    assert furnished(rules, tables, *level, at=(FLOOR,)) == [NO_FEATURE] * 6 + ["floor"]


@pytest.mark.parametrize(
    ("z_min", "evidence", "expected"), [(0.0, {}, "door"), (7.0, {}, NO_FEATURE), (7.0, {"door": 0.8}, "door")]
)
def test_a_leaf_stands_on_a_floor_unless_it_was_seen_to_be_one(
    rules: PlaneRules, z_min: float, evidence: dict[str, float], expected: str
) -> None:
    planes = [
        plane(0, "up", 0.0, 0.0, 4.0, 12.0, floor=0.9),
        PlaneFacts(1, "side", z_min, z_min + 2.0, 0.9, 0.9, evidence),
    ]
    assert rules.label(planes, [("orthogonal", 0, 1), ("above", 1, 0)]).labels[1] == expected


@pytest.mark.parametrize(
    ("alone", "expected"),
    [
        pytest.param(plane(1, "side", 0.0, 2.0, 0.9, 1.8), "wall", id="no leaf without a floor"),
        pytest.param(plane(1, "up", 0.7, 0.7, 1.5, 1.1, table=0.7, cup=0.1), NO_FEATURE, id="seen to be furniture"),
        pytest.param(plane(1, "up", 0.7, 0.7, 1.5, 1.1), "floor", id="a level plane with nothing about it"),
        pytest.param(plane(1, "side", 0.0, 2.5, 3.0, 7.0, picture=0.6, wall=0.3), "wall", id="behind a picture"),
        pytest.param(plane(1, "side", 0.0, 2.5, 4.0, 10.0, sofa=0.6, wall=0.3), "wall", id="behind a sofa"),
        pytest.param(plane(1, "oblique", 0.0, 1.0, 1.0, 1.0), NO_FEATURE, id="oblique"),
        pytest.param(plane(1, "up", 0.0, 0.0, 4.0, 9.0, given="stairs"), "stairs", id="settled, not by these rules"),
    ],
)
def test_a_plane_alone(rules: PlaneRules, alone: PlaneFacts, expected: str) -> None:
    assert rules.label([alone], []).labels == {1: expected}


def test_floors_of_two_storeys_are_both_floors(rules: PlaneRules) -> None:
    floors = [plane(1, "up", 0.0, 0.0, 4.0, 12.0), plane(2, "up", 2.8, 2.8, 4.0, 12.0)]
    assert set(rules.label(floors, [("parallel", 1, 2)]).labels.values()) == {"floor"}


def test_a_settled_plane_keeps_its_label_and_settles_others(rules: PlaneRules) -> None:
    planes = [plane(1, "up", 0.7, 0.7, 1.5, 90.0), plane(2, "up", 0.0, 0.0, 4.0, 1.0, given="floor")]
    assert rules.label(planes, [("above", 1, 2)]).labels == {1: NO_FEATURE, 2: "floor"}


def test_settled_planes_may_contradict_each_other(rules: PlaneRules) -> None:
    planes = [plane(1, "up", 0.7, 0.7, 1.5, 1.1, given="floor"), plane(2, "up", 0.0, 0.0, 4.0, 9.0, given="floor")]
    assert rules.label(planes, [("above", 1, 2)]).labels == {1: "floor", 2: "floor"}


def test_what_was_not_told_is_named(rules: PlaneRules) -> None:
    with pytest.raises(ValueError, match=r"relations: \(above, 1, 7\): 7 is not"):
        rules.label([plane(1, "up", 0.0, 0.0, 1.0, 1.0)], [("above", 1, 7)])
    with pytest.raises(ValueError, match="'beside' is not a relation"):
        rules.label([plane(1, "up", 0.0, 0.0, 1.0, 1.0)], [("beside", 1, 1)])


# -- laws ------------------------------------------------------------------------------------------------------


@st.composite
def scenes(draw: st.DrawFn, most: int = 8) -> tuple[list[PlaneFacts], list[PlaneRelation]]:
    """Planes with relations drawn at random: harder to satisfy than any that can be built."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(2, most))
    seen: list[dict[str, float]] = [
        {}, {}, {}, {"wall": 0.7, "table": 0.1}, {"table": 0.8}, {"door": 0.6}, {"floor": 0.9},
        {"ceiling": 0.5, "lamp": 0.4},
    ]  # fmt: skip
    planes = []
    for k in range(n):
        z_min = rng.uniform(0.0, 1.0)
        facing = str(rng.choice(["up", "down", "side", "side", "oblique"]))
        given_label = None if rng.random() < 0.9 else str(rng.choice(["wall", "floor", "door", NO_FEATURE]))
        measures = (z_min, z_min + rng.uniform(0.5, 2.3), rng.uniform(0.3, 2.0), rng.uniform(0.2, 8.0))
        planes.append(PlaneFacts(k, facing, *measures, seen[rng.integers(len(seen))], given_label))
    names = ["parallel", "orthogonal", "equalheight", "above", "under"]
    share = rng.uniform(0.2, 0.8)
    pairs = [(a, b) for a in range(n) for b in range(a + 1, n) if rng.random() < share]
    return planes, [(str(rng.choice(names)), *pair) for pair in pairs]


def told(planes: list[PlaneFacts], relations: list[PlaneRelation]) -> tuple[list[Term], list[Term]]:
    """A scene as the rules are told of it."""

    def evidence(plane: PlaneFacts) -> Term:
        if plane.given is not None:
            return Compound("given", (Atom(plane.given),))
        return [Compound("-", (Atom(name), share)) for name, share in plane.evidence.items()]

    return (
        [
            Compound("plane", (p.id, Atom(p.facing), p.z_min, p.z_max, p.width_m, p.area_m2, evidence(p)))
            for p in planes
        ],
        [Compound("relation", (Atom(name), a, b)) for name, a, b in relations],
    )


@settings(max_examples=150, deadline=None)
@given(scene=scenes())
def test_no_consistent_labels_are_cheaper(
    rules: PlaneRules, reference: KnowledgeBase, scene: tuple[list[PlaneFacts], list[PlaneRelation]]
) -> None:
    _compare(rules, reference, *scene)


@settings(max_examples=10, deadline=None)
@given(scene=scenes(most=12))
def test_nor_are_they_for_a_dozen_planes(
    rules: PlaneRules, reference: KnowledgeBase, scene: tuple[list[PlaneFacts], list[PlaneRelation]]
) -> None:
    _compare(rules, reference, *scene)


def _compare(
    rules: PlaneRules, reference: KnowledgeBase, planes: list[PlaneFacts], relations: list[PlaneRelation]
) -> None:
    found = rules.label(planes, relations)
    terms = told(planes, relations)
    goal = Compound("least_cost", (*terms, Var("Cost")))
    least = reference.call(Compound(":", (Atom("user_rules"), goal)), timeout_s=60.0)
    if not least:
        return  # settled planes contradict each other
    labels: list[Term] = [Compound("-", (i, Atom(label))) for i, label in found.labels.items()]
    [weighed] = reference.call(Compound("labelling_cost", (*terms, labels, Var("Cost"))))
    assert weighed["Cost"] == pytest.approx(least[0]["Cost"], abs=1e-6)
    assert found.cost == pytest.approx(least[0]["Cost"], abs=1e-6)
    assert found.optimal


@settings(max_examples=50, deadline=None)
@given(scene=scenes())
def test_under_is_above_the_other_way_round(
    rules: PlaneRules, scene: tuple[list[PlaneFacts], list[PlaneRelation]]
) -> None:
    planes, relations = scene
    other = {"above": "under", "under": "above"}
    turned = [(other.get(name, name), b, a) for name, a, b in relations]
    assert rules.label(planes, relations) == rules.label(planes, turned)


@pytest.mark.parametrize(("n", "clutter"), [(100, 0.15), (100, 0.3), (1000, 0.3)])
def test_storeys_are_labelled_with_proof(rules: PlaneRules, reference: KnowledgeBase, n: int, clutter: float) -> None:
    planes, relations = storey_planes(n, clutter)
    found = rules.label(planes, relations)
    assert found.optimal
    rooms = round(n * (1.0 - clutter) / 7.0)
    assert [found.labels[7 * k] for k in range(rooms)] == ["floor"] * rooms
    assert [found.labels[7 * k + 1] for k in range(rooms)] == ["ceiling"] * rooms
    if n <= 100:
        labels: list[Term] = [Compound("-", (i, Atom(label))) for i, label in found.labels.items()]
        [weighed] = reference.call(Compound("labelling_cost", (*told(planes, relations), labels, Var("Cost"))))
        assert weighed["Cost"] == pytest.approx(found.cost)


def test_what_takes_too_long_is_labelled_with_a_bound(rules: PlaneRules) -> None:
    """Each plane is at odds with a third of the others: far from anything that can be built."""
    rng = np.random.default_rng(7)
    planes = [plane(k, "up", 0.0, 0.0, 1.0, rng.uniform(1.0, 1.1)) for k in range(60)]
    pairs = [(a, b) for a in range(60) for b in range(a + 1, 60) if rng.random() < 0.33]
    relations: list[PlaneRelation] = [("above", a, b) for a, b in pairs]
    found = rules.label(planes, relations, most_steps=20_000)
    assert 0.0 < found.bound < found.cost
    assert not found.optimal
    assert all(NO_FEATURE in (found.labels[a], found.labels[b]) for a, b in pairs)
    better = rules.label(planes, relations, most_steps=2_000_000)
    assert found.bound <= better.cost <= found.cost


# -- rules of one's own ----------------------------------------------------------------------------------------


def with_rules(tmp_path: Path, text: str) -> PlaneRules:
    file = tmp_path / "own.pl"
    file.write_text(text)
    with KnowledgeBase([file]) as knowledge:
        return PlaneRules.of(knowledge)


@pytest.fixture(scope="module")
def furniture() -> Iterator[KnowledgeBase]:
    with KnowledgeBase([REFERENCE, rule_path("optional/furniture_planes")]) as knowledge:
        yield knowledge


def test_a_new_label_is_a_few_lines_of_a_rule_file(tmp_path: Path) -> None:
    own = with_rules(
        tmp_path,
        """
        structure:label(sill, 0.01).
        structure:shape(sill, [one_of(facing, [up]), width >= 0.5, area =< 0.4]).
        structure:needs(sill, above, floor, [a(z_min)-b(z_max) >= 0.6, a(z_min)-b(z_max) =< 1.2]).
        structure:goes(_, sill, _, []).
        """,
    )
    heights = [plane(9, "up", z, z, 1.0, 0.2) for z in (0.2, 0.9, 1.6)]
    assert [furnished(own, [level])[0] for level in heights] == [NO_FEATURE, "sill", NO_FEATURE]
    assert furnished(own, [], at=(FLOOR, *WALLS)) == ["floor", *["wall"] * 4]


@pytest.mark.parametrize(
    ("pieces", "between", "expected"),
    [
        pytest.param([plane(9, "up", 0.74, 0.76, 1.6, 1.2)], [], ["table_top"], id="table"),
        pytest.param([plane(9, "up", 1.74, 1.76, 1.6, 1.2)], [], [NO_FEATURE], id="too high for a table"),
        pytest.param([plane(8, "up", 1.2, 1.2, 0.8, 0.24), plane(9, "up", 1.6, 1.6, 0.8, 0.25)],
                     [("parallel", 8, 9), ("above", 9, 8)], ["shelf_board", "shelf_board"], id="boards"),
        pytest.param([plane(9, "down", 1.6, 1.6, 0.8, 0.24)], [], [NO_FEATURE], id="a board alone"),
        pytest.param([plane(9, "side", 0.0, 2.1, 1.8, 3.8)], [("parallel", 9, NORTH)], ["cupboard_front"],
                     id="cupboard"),
        pytest.param([plane(9, "side", 0.9, 2.1, 1.2, 1.4, window=0.7)], [("parallel", 9, NORTH)], ["window"],
                     id="window"),
        pytest.param([plane(k, "up", 0.18 * (k - 6), 0.18 * (k - 6), 0.9, 0.25) for k in (7, 8, 9)],
                     [("parallel", 7, 8), ("above", 8, 7), ("parallel", 8, 9), ("above", 9, 8)], ["tread"] * 3,
                     id="stairs"),
    ],
)  # fmt: skip
def test_furniture_has_labels_where_its_rules_are_loaded(
    furniture: KnowledgeBase, pieces: list[PlaneFacts], between: list[PlaneRelation], expected: list[str]
) -> None:
    rules = PlaneRules.of(furniture)
    labels = furnished(rules, pieces, *between, at=(FLOOR, CEILING, *WALLS))
    assert labels == [*expected, "floor", "ceiling", *["wall"] * 4]


def test_labels_of_furniture_take_none_from_structure(rules: PlaneRules, furniture: KnowledgeBase) -> None:
    planes, relations = storey_planes(200, 0.3, seed=3)
    with_furniture = PlaneRules.of(furniture).label(planes, relations)
    assert with_furniture.optimal
    for plane_id, label in rules.label(planes, relations).labels.items():
        assert label in (NO_FEATURE, with_furniture.labels[plane_id])


@settings(max_examples=60, deadline=None)
@given(scene=scenes(most=6))
def test_nor_are_any_cheaper_among_more_labels(
    furniture: KnowledgeBase, scene: tuple[list[PlaneFacts], list[PlaneRelation]]
) -> None:
    _compare(PlaneRules.of(furniture), furniture, *scene)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("structure:shape(wal, []).", r"shape\(wal,\[\]\): wal is not one of the labels wall, floor"),
        ("structure:goes(beside, wall, wall, []).", "beside is not one of parallel, orthogonal"),
        ("structure:shape(wall, [widht >= 1.0]).", "widht is neither a measure of a plane, a number nor a threshold"),
        ("structure:shape(wall, [width \\= 1.0]).", "is not a comparison"),
        ("structure:label(wall, 0.5).", "label/2: each label once"),
        ("structure:label(sill, high).", "a label and what it costs, a number, are expected"),
    ],
)
def test_a_line_that_is_wrong_is_named(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(InvalidRules, match=said):
        with_rules(tmp_path, line)


def test_every_plane_can_be_no_feature_at_a_cost(rules: PlaneRules) -> None:
    for facing in FACINGS:
        alone = plane(1, facing, 0.0, 1.0, 1.0, 0.2)
        assert rules.label([alone], []).labels == {1: NO_FEATURE}
        assert rules.label([replace(alone, evidence={"cup": 1.0})], []).cost >= 0.0
        assert rules.label([alone], []).cost > 0.0
