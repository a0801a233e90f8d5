"""Plans in a home of 40 rooms and 1 000 objects, and of 40 rooms of 1 000 objects each. Run with `make bench`.

Each goal is planned for as `World.plan` does it (rooms first, then a small task for each part of the goal), as one
scoped task, and, in the smaller home, as one task about everything. All plans are checked by unified-planning's
validator. The planner's process is started before.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from reasoning.planning import Planner, Task
from reasoning.planning.unified import validate
from scenegraph.importing import GraphFile
from tests.support.errands import large_home
from tests.support.racing import Table, race

UNSCOPED_TIMEOUT_S = 30.0
GOALS = (
    "holding(plate), in(robot, room_39)",
    "on(cup, X), in(X, room_33), counter(X)",
    "on(cup, X), desk(X), in(X, room_7)",
    "in(apple, X), fridge(X), in(X, room_25), closed(X)",
    "poured(bottle, X), bowl(X), in(X, room_18)",
    "\\+ on(cup, table), open(cabinet)",
    "near(robot, X), fridge(X), in(X, room_38), switched_on(X)",
    "on(X, Y), book(X), bed(Y), in(Y, room_12), on(Z, Y), bottle(Z)",
    "forall(on(X, object_1), in(X, room_9)), in(robot, room_0)",
    "in(A, room_30), cup(A), in(B, room_31), book(B), in(C, room_22), apple(C)",
)


@pytest.fixture(scope="module")
def planner() -> Iterator[Planner]:
    with Planner() as planner:
        planner.start()
        yield planner


@pytest.fixture(scope="module", params=[1_000, 40_000], ids=["1k", "40k"])
def home(request: pytest.FixtureRequest, planner: Planner) -> Iterator[tuple[int, GraphFile]]:
    with GraphFile(large_home(40, request.param)) as file:
        file.__dict__["_planner"] = planner
        yield request.param, file


@pytest.mark.parametrize("goal", GOALS)
def test_plan(
    benchmark: BenchmarkFixture, table: Table, home: tuple[int, GraphFile], planner: Planner, goal: str
) -> None:
    n_objects, file = home
    plan = file.plan(goal)
    assert plan.status == "solved", plan.problem
    assert plan.validate() is None
    assert plan.task is not None
    ours, _ = race(benchmark, lambda n: file.plan(goal), {}, rounds=5)
    whole = scoped(planner, file.planning_task(goal))
    beside = f"{whole} as one scoped task"
    if n_objects <= 1_000 and goal == GOALS[1]:  # takes all the time that it is given
        beside += f", {scoped(planner, file.planning_task(goal, scoped=False))} about everything"
    must_ms = 1000.0 if n_objects <= 1_000 else None
    table.add(f"{len(plan)} steps, {len(plan.task.objects)} objects of {n_objects}", goal, ours, {}, must_ms=must_ms)
    table.notes.append(f"plan among {n_objects} objects: {goal}: {ours.median:.0f} ms; {beside}")


def scoped(planner: Planner, task: Task) -> str:
    """How long a task takes alone, from facts to plan."""
    outcome = planner.solve(task, timeout_s=UNSCOPED_TIMEOUT_S)
    if outcome.status != "solved":
        return f"{outcome.status} ({outcome.message or 'no plan'})"
    assert len(task.objects) > 300 or validate(task, outcome.actions) is None
    return f"{1e3 * outcome.figures['took_s']:.0f} ms"
