"""Answers say why: the rule, the measured value, the threshold, the facts; and why not."""

from __future__ import annotations

import json

import pytest

from reasoning import Explanation, KnowledgeBase
from tests.reasoning.homes import fact, small_home


def explain(knowledge: KnowledgeBase, goal: str, **options: object) -> Explanation:
    reply = knowledge.ask(goal, explain=True, **options)  # type: ignore[arg-type]
    assert reply.problem is None, reply.problem
    assert reply.explanation is not None
    assert reply.explanation.truth == reply.truth
    json.dumps(reply.explanation.as_json())
    return reply.explanation


def test_an_answer_names_rule_value_threshold_and_facts(home: KnowledgeBase) -> None:
    [answer] = explain(home, "near(X, oven), on(X, table_1)").children
    near, on = answer.children
    assert answer.goal == "X = cup_1"
    assert near.goal == "near(cup_1, oven_1)"
    assert [(test.measurement, test.value, test.comparison, test.threshold, test.unit) for test in near.tests] == [
        ("path_gap_upper", 0.4, "=<", 0.5, "metre")
    ]
    assert fact("measured", "path_gap_upper", "cup_1", "oven_1", 0.4) in near.evidence
    assert fact("seen", "oven_1", 1_000, 2_000) in near.evidence
    assert "on/2" in on.rule
    assert on.tests[0].threshold_name == "contact_share"
    assert [child.goal for child in near.children] == ["instance_of(oven_1, oven)"]


def test_why_not_names_the_part_that_fails_and_who_came_closest(home: KnowledgeBase) -> None:
    [failing] = explain(home, "near(X, oven), on(X, book)").children
    assert failing.goal == "on(X, book)"
    assert failing.truth == "false"
    [failing] = explain(home, "on(X, bowl), near(X, oven)").children
    assert failing.goal == "near(apple_1, oven)" or failing.goal == "near(X, oven)"


def test_why_not_shows_the_best_candidate_with_value_and_threshold(home: KnowledgeBase) -> None:
    [failing] = explain(home, "near(tv, oven)").children
    [candidate] = failing.children
    assert candidate.goal == "near(tv_1, oven_1)"
    assert candidate.truth == "false"
    assert [test.value for test in candidate.tests] == [8.0, 7.5]
    assert candidate.tests[0].threshold == pytest.approx(0.9)


def test_the_candidates_come_best_first_and_few(home: KnowledgeBase) -> None:
    [failing] = explain(home, "on(mug_1, table_1)").children
    assert [candidate.tests[0].value for candidate in failing.children] == [0.05]


def test_why_not_says_what_was_not_measured_and_what_does_not_exist(home: KnowledgeBase) -> None:
    [failing] = explain(home, "on(sofa, oven)").children
    assert failing.evidence == (fact("no_measured_pair", "on"),)
    [failing] = explain(home, "near(cup, toilet)").children
    assert failing.evidence == (fact("no_instance", "toilet"),)


def test_unknown_names_the_open_measurement(home: KnowledgeBase) -> None:
    [near] = explain(home, "near(chair, oven)").children
    assert near.truth == "unknown"
    assert [test.value for test in near.tests] == [1e9, 0.45]


def test_unknown_names_the_class_that_was_not_seen() -> None:
    with KnowledgeBase() as knowledge:
        knowledge.update([*small_home(), fact("unobserved", "world")])
        explanation = explain(knowledge, "near(cup, toilet)")
    assert "no toilet is known" in explanation.text
    assert "unobserved(world)" in explanation.text


@pytest.mark.parametrize(
    ("goal", "fragment"),
    [
        ("in(cup, kitchen)", "evidence("),
        ("in(apple, bowl)", "footing_inside 1 >= 0.8"),
        ("above(mug, table)", "rise 0.04 m > 0.03 m (contact_gap)"),
        ("adjacent(kitchen, living_room)", "adjacent/2"),
        ("connects(door, kitchen)", "edge(connects,door_1,room_1"),
        ("\\+ near(tv, oven)", "no candidate is possible"),
        ("\\+ near(chair, oven)", "a candidate is open"),
        ("\\+ on(cup, table)", "it holds of a candidate"),
        ("forall(on(X, table), in(X, kitchen))", "it holds of every candidate"),
        ("forall(on(X, table), on(X, book))", "a candidate is an exception"),
        ("aggregate_all(count, on(_, table), N)", "every candidate is decided"),
        ("on(cup, table) ; on(oven, table)", "contact 0.95 >= 0.2"),
        ("(near(tv, oven) -> true ; on(cup, table))", "contact 0.95"),
        ("attribute(X, color, red)", "attribute(cup_1,color,red)"),
        ("on(X, table), position(X, _, _, Z), Z > 0.79", "0.8>0.79"),
        ("instance_of(X, cup), label(X, mug)", "subclass(mug,cup)"),
        ("gap(cup_1, oven_1, G)", "measured(gap,cup_1,oven_1,0.4)"),
        ("once(on(X, book))", "contact 0.9"),
        ("limit(1, on(X, book))", "contact 0.9"),
    ],
)
def test_the_text_says(home: KnowledgeBase, goal: str, fragment: str) -> None:
    text = explain(home, goal).text
    assert fragment in text, text


def test_a_viewpoint_answer_names_its_frame(home: KnowledgeBase) -> None:
    text = explain(home, "left_of(oven, table)", viewer=(1.2, -3.0, 1.0)).text
    assert "viewer(point)" in text
    assert "centre_distance 1.2" in text


def test_an_explanation_is_only_made_when_asked_for(home: KnowledgeBase) -> None:
    assert home.ask("on(cup, table)").explanation is None


@pytest.mark.parametrize(
    ("goal", "fragment"),
    [
        ("near(tv, oven)", "path_gap_upper 8 m > 0.9 m (near_distance)"),
        ("on(mug_1, table_1)", "contact 0.05 < 0.2 (contact_share)"),
        ("near(chair, oven)", "path_gap_upper: no way is known, to be =< 0.525 m (near_distance)"),
        ("\\+ on(cup, table)", "yes: on(cup_1, table_1)"),
        ("\\+ near(tv, oven)", "no: near(tv_1, oven_1)"),
        ("\\+ near(chair, oven)", "open: near(chair_1, oven_1)"),
        ("forall(on(X, table), on(X, book))", "no: on(cup_1, book)"),
        ("forall((near(X, oven), chair(X)), on(X, table))", "open: near(chair_1, oven_1)"),
        ("aggregate_all(count, on(_, table), N)", "yes: on(bowl_1, table_1)"),
        ("aggregate_all(count, on(_, table), 7)", "it comes to something else"),
        ("on(oven, cup) ; on(tv, cup)", "neither holds"),
        ("distance(cup_1, oven_1, D), D > 3", "no: 0.873"),
        ("on(X, table), X == mug_1", "no: cup_1==mug_1"),
        ("color(cup_1, blue)", "yes: color(cup_1, red)"),
        ("height(table, H)", "size(table_1,1.4,0.8,0.75)"),
        ("largest(cup_1, furniture)", "yes: largest(sofa_1, furniture)"),
        ("nearest(X, cup, oven_1)", "position(cup_1,0.8,0.0,0.8)"),
        ("maximal(V, (cup(X), volume(X, V)))", "yes: volume(cup_1, 0.00064)"),
        ("larger(cup, table)", "yes: larger(table_1, cup_1)"),
        ("room_type(room_2, kitchen)", "yes: room_type(room_2, living_room)"),
        ("adjacent(kitchen, living_room)", "edge(connects,door_1,room_2"),
        ("graspable(table)", "grasp_width 0.75 m > 0.12 m (hand_opening)"),
    ],
)
def test_it_goes_down_to_what_decides(home: KnowledgeBase, goal: str, fragment: str) -> None:
    text = explain(home, goal).text
    assert fragment in text, text
