"""Labelling the planes of rooms and of a storey, with the proof that nothing is cheaper.

Run with `make bench`, or `pytest tests/benchmarks/test_bench_labelling.py --benchmark-enable --benchmark-only -s`.
Timed is all of it, from planes and their relations to labels. The peer is generate and test in Prolog, as Nüchter &
Hertzberg 2008 have it, on the smallest scene; on others it does not end.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from reasoning.knowledge import KnowledgeBase
from reasoning.labelling import PlaneRules
from reasoning.terms import Atom, Compound, Var
from rules import rule_path
from tests.reasoning.test_labelling import REFERENCE, told
from tests.support.storey_planes import storey_planes

SIZES = [(13, 0.15), (100, 0.15), (100, 0.3), (1000, 0.15), (1000, 0.3)]


@pytest.fixture(scope="module", params=["structure", "furniture too"])
def knowledge(request: pytest.FixtureRequest) -> Iterator[KnowledgeBase]:
    more = [rule_path("optional/furniture_planes")] if request.param != "structure" else []
    with KnowledgeBase([REFERENCE, *more]) as knowledge:
        yield knowledge


@pytest.mark.parametrize(("n", "clutter"), SIZES, ids=lambda value: str(value))
def test_labelling(benchmark: BenchmarkFixture, knowledge: KnowledgeBase, n: int, clutter: float) -> None:
    rules = PlaneRules.of(knowledge)
    planes, relations = storey_planes(n, clutter)
    found = benchmark.pedantic(rules.label, (planes, relations), rounds=15, warmup_rounds=1)
    assert found.optimal
    ms = benchmark.stats.stats.median * 1e3
    print(f"\n{len(planes)} planes, {clutter:.0%} clutter, {len(rules.labels)} labels: {ms:.2f} ms, proven optimal")


def test_generate_and_test(benchmark: BenchmarkFixture) -> None:
    """Two rooms by the reference."""
    planes, relations = storey_planes(13, 0.15)
    goal = Compound(":", (Atom("user_rules"), Compound("least_cost", (*told(planes, relations), Var("Cost")))))
    with KnowledgeBase([REFERENCE]) as knowledge:
        [answer] = benchmark.pedantic(knowledge.call, (goal,), {"timeout_s": 300.0}, rounds=1)
        assert answer["Cost"] == pytest.approx(PlaneRules.of(knowledge).label(planes, relations).cost)
    print(f"\ngenerate and test, {len(planes)} planes: {benchmark.stats.stats.median * 1e3:.0f} ms")
