"""Planning by itself: domains, grounding, search, and the process that it runs in."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning.planning import Action, Domain, Planner, Task, household
from reasoning.planning.formulas import read_schemas
from reasoning.planning.grounding import ground_task
from reasoning.planning.search import search
from reasoning.planning.unified import DomainUnreadable, read_domain, read_problem, validate
from reasoning.planning.worker import solve
from tests.reasoning.naive_planning import reachable_actions, shortest_plan_length

BOTTLES = Domain(
    "bottles",
    """(define (domain bottles) (:requirements :adl)
     (:types box item)
     (:predicates (inside ?i - item ?b - box) (shut ?b - box) (seen ?i - item) (dark))
     (:action shift :parameters (?i - item ?a ?b - box)
       :precondition (and (inside ?i ?a) (not (shut ?a)) (not (shut ?b)) (not (= ?a ?b)))
       :effect (and (inside ?i ?b) (not (inside ?i ?a)) (when (dark) (not (seen ?i)))))
     (:action flip :parameters (?b - box)
       :precondition (or (shut ?b) (forall (?i - item) (imply (inside ?i ?b) (seen ?i))))
       :effect (and (when (shut ?b) (not (shut ?b))) (when (not (shut ?b)) (shut ?b))))
     (:action look :parameters () :precondition (exists (?b - box) (not (shut ?b)))
       :effect (forall (?i - item ?b - box) (when (and (inside ?i ?b) (not (shut ?b))) (seen ?i))))
     (:action switch :parameters () :effect (and (when (dark) (not (dark))) (when (not (dark)) (dark)))))""",
)


@st.composite
def bottle_tasks(draw: st.DrawFn) -> Task:
    """Quantifiers, disjunctions and conditional effects, in problems of some dozen states."""
    boxes, items = ["a", "b"], [f"i{k}" for k in range(draw(st.integers(1, 2)))]
    init = {("inside", item, draw(st.sampled_from(boxes))) for item in items}
    init |= {("shut", box) for box in boxes if draw(st.booleans())}
    init |= {("dark",)} if draw(st.booleans()) else set()
    atoms = (
        [("inside", i, b) for i in items for b in boxes] + [("shut", b) for b in boxes] + [("seen", i) for i in items]
    )
    goal = draw(
        st.lists(st.tuples(st.booleans(), st.sampled_from(atoms)), min_size=1, max_size=3, unique_by=lambda g: g[1])
    )
    objects = {**dict.fromkeys(boxes, "box"), **dict.fromkeys(items, "item")}
    return Task(BOTTLES, objects, frozenset(init), tuple(goal))


@given(bottle_tasks())
@settings(max_examples=25, deadline=None)
def test_a_plan_is_found_exactly_when_breadth_first_finds_one_and_is_valid(task: Task) -> None:
    outcome = solve(task)
    shortest = shortest_plan_length(task)
    assert (outcome.status == "solved") == (shortest is not None)
    if shortest is not None:
        assert len(outcome.actions) >= shortest
        assert validate(task, outcome.actions) is None


def errand(rng: random.Random) -> Task:
    """A robot, two rooms, some furniture and things, in the household domain."""
    rooms, hosts, things = ["m1", "m2"], ["h1", "h2", "h3"], ["x1", "x2"]
    init = {
        ("at", "r", "m1"),
        ("within", "r", "m1"),
        ("free", "r"),
        ("joins", "d", "m1", "m2"),
        ("joins", "d", "m2", "m1"),
    }
    init |= {("beside", m, m) for m in rooms} | {("opened", m) for m in rooms} | {("beside", "d", m) for m in rooms}
    init |= {("reached_from", "d", "d")}
    init |= {fact for fact in (("opened", "d"), ("openable", "d"), ("openable", "h3")) if rng.random() < 0.7}
    for host in hosts:
        room = rng.choice(rooms)
        init |= {("beside", host, room), ("reached_from", host, host), ("kept", host, room)}
    for thing in things:
        host = rng.choice(hosts)
        room = next(f[2] for f in init if f[:2] == ("kept", host))
        kept = host if host == "h3" and ("openable", "h3") in init else room
        init |= {("resting", thing, host), ("reached_from", thing, host), ("kept", thing, kept)}
        init.add(("in" if kept == host else "on", thing, host))
        init |= {("graspable", "r", thing)} if rng.random() < 0.9 else set()
        init |= {("fits_on", thing, h) for h in hosts} | {("fits_in", thing, "h3")}
    goals = [
        (True, ("on", "x1", "h1")),
        (True, ("in", "x2", "h3")),
        (False, ("opened", "h3")),
        (True, ("on", "x2", "h2")),
    ]
    goals += [(True, ("holding", "r", "x1")), (True, ("within", "r", "m2")), (False, ("on", "x1", "h2"))]
    objects = {"r": "robot", "d": "door", **dict.fromkeys(rooms, "room"), **dict.fromkeys([*hosts, *things], "thing")}
    return Task(household(), objects, frozenset(init), tuple(rng.sample(goals, 2)))


@pytest.mark.parametrize("seed", range(6))
def test_grounding_finds_the_actions_that_trying_every_binding_finds(seed: int) -> None:
    task = errand(random.Random(seed))
    schemas = read_schemas(read_domain(task.domain.text))
    from reasoning.planning.grounding import _Grounder

    grounder = _Grounder(task, schemas, 100_000)
    grounder.explore()
    found = {(s.name, tuple(b[name] for name, _ in s.parameters)) for s, b in grounder.found}
    assert found == reachable_actions(task, schemas)


@pytest.mark.parametrize("seed", range(40))
def test_plans_for_errands_are_valid(seed: int) -> None:
    task = errand(random.Random(seed))
    outcome = solve(task)
    assert outcome.status in ("solved", "unsolvable")
    if outcome.status == "solved":
        assert validate(task, outcome.actions) is None
        state = set(task.init)
        for action in outcome.actions:  # what steps say of themselves is what happens
            assert not action.failing(state)
            action.apply(state)
        assert all((fact in state) == holds for holds, fact in task.goal)


def test_no_action_of_a_plan_can_be_left_out() -> None:
    for seed in range(20):
        task = errand(random.Random(seed))
        grounded = ground_task(task, read_schemas(read_domain(task.domain.text)))
        plan = search(grounded) or []
        for k in range(len(plan)):
            assert not _leads(task, [*plan[:k], *plan[k + 1 :]])


def _leads(task: Task, actions: list[Action]) -> bool:
    state = set(task.init)
    for action in actions:
        if action.failing(state):
            return False
        action.apply(state)
    return all((fact in state) == holds for holds, fact in task.goal)


def test_the_text_of_a_task_is_pddl_that_reads_as_the_task() -> None:
    task = errand(random.Random(1))
    problem = read_problem(task.domain.text, task.pddl)
    assert {o.name: o.type.name for o in problem.all_objects} == dict(task.objects)
    held = {
        (f.fluent().name, *(str(a) for a in f.args)) for f, v in problem.explicit_initial_values.items() if v.is_true()
    }
    assert held == task.init


def test_a_text_that_is_no_domain_is_refused_with_the_reason() -> None:
    with pytest.raises(DomainUnreadable, match="cannot read it"):
        read_domain("(define (domain broken) (:predicates (p ?x)")
    outcome = solve(Task(Domain("broken", "(nonsense)"), {}, frozenset(), ()))
    assert outcome.status == "unsupported"
    assert "cannot read it" in outcome.message


def test_the_process_solves_and_is_ended_when_it_takes_too_long_and_begins_anew() -> None:
    easy = next(task for seed in range(40) if solve(task := errand(random.Random(seed))).actions)
    with Planner() as planner:
        assert planner.solve(easy).status == "solved"
        first = planner.pid
        assert planner.solve(easy, timeout_s=1e-5).status == "timeout"
        assert planner.solve(easy).status == "solved"
        assert planner.pid != first
    assert planner.pid is None
