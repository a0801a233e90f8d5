"""Users' own domains: the public ones, read, mapped onto a home, planned in and validated."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from reasoning.planning.formulas import read_schemas
from reasoning.planning.pddl import normalised
from reasoning.planning.unified import DomainUnreadable, read_domain, read_problem
from scenegraph.cli import app
from scenegraph.errors import InvalidConfig
from scenegraph.importing import GraphFile
from scenegraph.interop import export_graph
from scenegraph.planning.mapping import DomainMapping
from tests.support.errands import large_home, small_flat

MAPPINGS = Path(__file__).parents[1] / "support" / "domains"
PUBLIC = Path(os.environ.get("SCENEGRAPH_DATA", "shared/data")) / "pddl_household"
TASKOGRAPHY = [f"taskography/taskographyv{k}.pddl" for k in (1, 2, 3, 4, 5)]
ALFRED = "alfred/PutTask_domain.pddl"
DOMAINS = [*TASKOGRAPHY, ALFRED]

needs_data = pytest.mark.skipif(not PUBLIC.is_dir(), reason="SCENEGRAPH_DATA has no pddl_household")


def mapping_of(domain: str) -> DomainMapping:
    name = "alfred_put" if domain == ALFRED else Path(domain).stem
    return DomainMapping.load(MAPPINGS / f"{name}.toml", domain=PUBLIC / domain)


@pytest.fixture(scope="module")
def flat() -> Iterator[GraphFile]:
    with GraphFile(small_flat()) as file:
        yield file


@needs_data
@pytest.mark.parametrize("domain", DOMAINS)
def test_putting_a_domain_in_form_changes_nothing_that_a_planner_sees(domain: str) -> None:
    raw = (PUBLIC / domain).read_text()
    text = normalised(raw)
    assert normalised(text) == text
    assert read_schemas(read_domain(text)) == read_schemas(read_domain(raw))


@needs_data
def test_a_problem_that_the_reader_refuses_is_put_in_form() -> None:
    """ALFRED's has its metric before its objects, lists a place twice, and gives costs."""
    domain, raw = (PUBLIC / ALFRED).read_text(), (PUBLIC / "alfred" / "problem_0_0.pddl").read_text()
    with pytest.raises(DomainUnreadable, match="Expected ':init'"):
        read_problem(domain, raw)
    problem = read_problem(normalised(domain), normalised(raw))
    assert len(problem.goals) == 1
    assert {"agent1", "egg", "eggtype"} <= {o.name for o in problem.all_objects}


@needs_data
@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize("goal", ["in(apple, fridge)", "on(bottle, desk), on(cup, counter)", "open(fridge)"])
def test_goals_are_planned_in_public_domains_and_the_plans_are_valid(flat: GraphFile, domain: str, goal: str) -> None:
    plan = flat.plan(goal, domain=mapping_of(domain), timeout_s=30.0)
    assert plan.status == "solved", plan.problem
    assert plan.steps
    assert plan.validate() is None
    assert all(step.arguments[1] in flat.graph for step in plan if len(step.arguments) > 1)


@needs_data
def test_steps_name_nodes_and_actions_as_the_domain_spells_them(flat: GraphFile) -> None:
    plan = flat.plan("in(apple, fridge)", domain=mapping_of(TASKOGRAPHY[0]))
    assert str(plan.steps[0]).startswith("GotoLocation(agent_rob, room_2, ")
    assert str(plan.steps[-1]) == "PutItemInOpeningReceptacle(agent_rob, object_10, object_2, object_2)"


@needs_data
def test_a_domain_with_rooms_is_planned_in_a_larger_home() -> None:
    with GraphFile(large_home(8, 120)) as file:
        plan = file.plan("in(apple, fridge)", domain=mapping_of(TASKOGRAPHY[1]), timeout_s=30.0)
        assert plan.status == "solved", plan.problem
        assert plan.validate() is None


@needs_data
def test_what_a_domain_has_no_word_for_is_said(flat: GraphFile) -> None:
    plan = flat.plan("switched_on(fridge)", domain=mapping_of(ALFRED))
    assert plan.status == "unknown"
    assert plan.problem is not None
    assert plan.problem.code == "not_in_domain"


PAIR = """(define (domain pair) (:types thing)
 (:predicates (stacked ?a ?b - thing)) (:action stack :parameters (?a ?b - thing) :effect (stacked ?a ?b)))"""


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ({}, "types: required, but missing"),
        ({"types": {"thing": {"asks": "object(X)"}}}, "types.thing.asks"),
        ({"types": {"box": {"ask": "object(X)"}}}, "types.box: pair.pddl has no such type"),
        ({"types": {"thing": {"ask": "object(Y)"}}}, "types.thing.ask: expected a question about X"),
        ({"types": {"thing": {"ask": "objekt(X)"}}}, "types.thing.ask: objekt(X)"),
        (
            {"types": {"thing": {"ask": "object(X)"}}, "predicates": {"heap": {"ask": "on(A, B)"}}},
            "predicates.heap: pair.pddl has no such predicate",
        ),
        (
            {
                "types": {"thing": {"ask": "object(X)"}},
                "predicates": {"stacked": {"ask": "on(A, B)", "arguments": ["A"]}},
            },
            "predicates.stacked.arguments: expected 2",
        ),
        (
            {
                "types": {"thing": {"ask": "object(X)"}},
                "predicates": {"stacked": {"ask": "on(A, B)", "arguments": ["A", "C"]}},
            },
            "C is no variable",
        ),
        ({"types": {"thing": {"ask": "object(X)"}}, "goals": {"on": "heap(1, 2)"}}, "goals.on"),
    ],
)
def test_a_wrong_mapping_is_told_by_its_field(flat: GraphFile, tmp_path: Path, mapping: dict, words: str) -> None:
    (tmp_path / "pair.pddl").write_text(PAIR)
    file = tmp_path / "pair.json"
    file.write_text(json.dumps({"domain": "pair.pddl", **mapping}))
    assert words in told_of(flat, file)


def told_of(flat: GraphFile, mapping: Path) -> str:
    """What is wrong with a mapping: a file that is none is an error, one that does not fit the world a problem."""
    try:
        plan = flat.plan("on(cup, table)", domain=mapping)
    except InvalidConfig as error:
        return str(error)
    return "" if plan.problem is None else plan.problem.message


def test_a_mapping_of_a_few_lines_is_enough(flat: GraphFile, tmp_path: Path) -> None:
    (tmp_path / "pair.pddl").write_text(PAIR)
    (tmp_path / "pair.toml").write_text(
        'domain = "pair.pddl"\n[types.thing]\nask = "object(X)"\n[goals]\non = "stacked(1, 2)"\n'
    )
    path = export_graph(flat.graph, "json", tmp_path / "flat.json")
    words = ["plan", "on(cup, table)", "--map", str(path), "--domain", str(tmp_path / "pair.toml"), "--json"]
    assert json.loads(CliRunner().invoke(app, words).stdout)["steps"][0]["action"] == "stack"
    plan = flat.plan("on(cup, table)", domain=tmp_path / "pair.toml")
    assert [str(step) for step in plan] == ["stack(object_6, object_4)"]
    assert flat.verify(plan).reasons == ("plans in the domain pair cannot be checked, only made anew",)
    assert plan.validate() is None
