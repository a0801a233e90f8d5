"""Questions of worlds of 1 000, 10 000 and 100 000 objects, in-process and over Zenoh. Run with `make bench`, or alone:
`pytest tests/benchmarks/test_bench_reasoning.py --benchmark-enable --benchmark-only`.

The rules are told what mapping would tell them: some forty facts an object. Timed is all of `World.ask`, from a text to
nodes; of a delta, the facts of an object that moved, until the rules know them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from reasoning.terms import Atom, Compound
from scenegraph.service import Client, Server
from scenegraph.world import World
from tests.support.net import free_endpoint
from tests.support.racing import Table, race
from tests.support.told_building import furnished_world

ROOMS = (10, 100, 1000)
QUESTIONS = {  # what is asked → how many answers at least, ms at 10 000 objects
    "on(object_27, X)": (1, 1.0),
    "near(X, oven)": (1, 2.0),
    "near(X, oven), cup(X)": (0, 2.0),
    "cup(X), on(X, Y), table(Y)": (1, 10.0),
    "cup(X), near(X, Y), in(Y, room_1)": (50, 10.0),
    "cup(X), near(X, oven)": (0, 10.0),
    "\\+ near(oven, table)": (0, 10.0),
}


@pytest.fixture(scope="module", params=ROOMS, ids=lambda n: f"{100 * n} objects")
def told(request: pytest.FixtureRequest, table: Table) -> Iterator[tuple[int, World]]:
    n_rooms = int(request.param)
    began = time.perf_counter()
    with furnished_world(n_rooms) as world:
        known = world.status()["facts"]
        pid = world.meaning.knowledge.engine.pid
        table.notes.append(
            f"{size(n_rooms)}: {known:,} facts in {time.perf_counter() - began:.1f} s; the rules' process has "
            f"{_resident_mb(pid):.0f} MB"
        )
        yield n_rooms, world


def size(n_rooms: int) -> str:
    return f"{100 * n_rooms:,} objects".replace(",", " ")


def _resident_mb(pid: int | None) -> float:
    statm = Path(f"/proc/{pid}/statm")
    return int(statm.read_text().split()[1]) * 4096 / 1e6 if statm.exists() else float("nan")


def must(ms: float, n_rooms: int) -> float:
    return ms if n_rooms <= 100 else 3.0 * ms


@pytest.mark.parametrize("goal", QUESTIONS)
def test_ask(benchmark: BenchmarkFixture, table: Table, told: tuple[int, World], goal: str) -> None:
    n_rooms, world = told
    least, ms = QUESTIONS[goal]
    answers = list(world.ask(goal))
    assert len(answers) >= least
    ours, _ = race(benchmark, _asker(world, goal), {}, rounds=100)
    table.add(f"{size(n_rooms)}: {goal}", f"{len(answers)} answers", ours, {}, must_ms=must(ms, n_rooms))


def _asker(world: World | Client, goal: str) -> Callable[[int], object]:
    return lambda n: list(world.ask(goal))


def test_explain(benchmark: BenchmarkFixture, table: Table, told: tuple[int, World]) -> None:
    n_rooms, world = told
    ours, _ = race(benchmark, lambda n: world.ask("near(X, oven)").explain(), {}, rounds=50)
    table.add(f"{size(n_rooms)}: near(X, oven), and why", "–", ours, {})


def test_delta(benchmark: BenchmarkFixture, table: Table, told: tuple[int, World]) -> None:
    """A hundred measurements of a thing that moves."""
    n_rooms, world = told
    knowledge = world.meaning.knowledge
    rng = np.random.default_rng(0)

    def move(n: int) -> None:
        thing = Atom("object_5")
        gaps = rng.uniform(0.0, 1.5, 50).round(4).tolist()
        knowledge.update(
            put=[
                Compound("measured", (Atom(name), thing, Atom(f"object_{600 + k}"), gap))
                for name in ("gap", "path_gap_upper")
                for k, gap in enumerate(gaps)
            ]
        )

    ours, _ = race(benchmark, move, {}, rounds=100)
    table.add(f"{size(n_rooms)}: 100 facts change", "–", ours, {}, must_ms=must(5.0, n_rooms))


def test_over_zenoh(benchmark: BenchmarkFixture, table: Table, told: tuple[int, World]) -> None:
    n_rooms, world = told
    goal = "near(X, oven)"
    with Server(world, "home", endpoint=free_endpoint()) as server, Client("home", server.endpoint) as client:
        ours, theirs = race(benchmark, _asker(client, goal), {"in-process": _asker(world, goal)}, rounds=100)
        table.add(f"{size(n_rooms)}: {goal}", "over Zenoh", ours, theirs)
        table.notes.append(
            f"{size(n_rooms)}: over Zenoh adds {ours.median - theirs['in-process'].median:.2f} ms (median), "
            f"{ours.least - theirs['in-process'].least:.2f} ms (least); must be ≤ 1 ms"
        )
