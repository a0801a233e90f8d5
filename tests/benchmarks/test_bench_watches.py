"""What watched goals cost when things change: by the change, not by how many are watched. Run with `make bench`."""

from __future__ import annotations

import statistics
import time

import pytest

from reasoning import Compound, KnowledgeBase
from tests.support.many_facts import CLASSES, COLORS, Storey
from tests.support.racing import Table


def goals(n: int, storey: Storey) -> list[str]:
    """Questions of all kinds: about single things, classes, rooms and counts."""
    found = []
    for k in range(n):
        label, other = CLASSES[k % len(CLASSES)], CLASSES[(7 * k + 3) % len(CLASSES)]
        one, room, color = f"object_{37 * k % storey.n}", storey.rooms[k % len(storey.rooms)], COLORS[k % len(COLORS)]
        found.append(
            [
                f"near(X, {one})",
                f"{label}(X), near(X, {one})",
                f"on(X, {one})",
                f"near({label}, {one})",
                f"in(X, {room}), {label}(X)",
                f"{label}(X), in(X, {room}), near(X, Y), {other}(Y)",
                f"on({one}, X)",
                f"near(X, {label}), attribute(X, color, {color})",
                f"aggregate_all(count, ({label}(X), in(X, {room})), N)",
                f"\\+ (in(X, {room}), {label}(X))",
            ][k // len(CLASSES) % 10]
        )
    return found


def changed(storey: Storey, rng_seed: int) -> list[Compound]:
    """About 100 facts: what an image tells of the things of one corner of a room."""
    first = 100 * (rng_seed * 31 % len(storey.rooms)) + 40
    return [one for i in range(first, first + 5) for one in storey.of(i)]


@pytest.mark.parametrize("n_things", [1_000, 10_000])
@pytest.mark.parametrize("n_watches", [100, 1_000])
def test_a_change_is_told_to_watches(table: Table, n_things: int, n_watches: int) -> None:
    storey = Storey(n_things)
    with KnowledgeBase() as knowledge:
        knowledge.update(put=storey.facts())
        asked = goals(n_watches, storey)
        started = time.perf_counter()
        for goal in asked:
            knowledge.watch(goal)
        replies = dict(knowledge.watching.refresh())
        first_s = time.perf_counter() - started
        wrong = {asked[number - 1]: reply.problem for number, reply in replies.items() if reply.problem}
        assert not wrong, wrong
        told, took, n_facts, n_asked = [], [], [], []
        for k in range(20):
            facts = changed(storey, k)
            started = time.perf_counter()
            knowledge.update(put=facts)
            told.append(time.perf_counter() - started)
            n_facts.append(len(facts))
            n_asked.append(len(knowledge.watching.due()))
            list(knowledge.watching.refresh())
            took.append(time.perf_counter() - started)
        knowledge.watching.touch()
        started = time.perf_counter()
        list(knowledge.watching.refresh())
        all_s = time.perf_counter() - started
    table.notes.append(
        f"{n_watches:5d} watches, {n_things:6d} things: a change of {statistics.mean(n_facts):.0f} facts "
        f"{1e3 * statistics.median(took):6.1f} ms (worst {1e3 * max(took):.1f}), of it telling the facts "
        f"{1e3 * statistics.median(told):.1f} ms; {statistics.mean(n_asked):.0f} goals are asked again; "
        f"all of them: {1e3 * all_s:.0f} ms; at first: {1e3 * first_s:.0f} ms"
    )
