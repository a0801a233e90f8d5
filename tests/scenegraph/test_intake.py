"""Waiting work: bounded, fair, and every message counted."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenegraph.errors import Problem
from scenegraph.service.errors import Overloaded
from scenegraph.service.health import Causes, RequestTimes
from scenegraph.service.intake import Bounds, Intake, Job, Tally
from scenegraph.service.keys import Input

FRONT = Input("spot", "front", "rgbd")


def job(log: list, name: object, stream: Input | None = None, size: int = 1) -> Job:
    return Job(lambda: log.append(name), size, stream)


def drain(intake: Intake, n: int = 1000) -> None:
    for _ in range(n):
        taken = intake.take(0.0)
        if taken is None:
            return
        taken.run()


def image(intake: Intake, tally: Tally, log: list, name: object, stream: Input = FRONT) -> None:
    tally.add(stream, "received")
    intake.put_image(job(log, name, stream))


def test_the_newest_images_win_and_the_others_are_counted():
    tally, log = Tally(), []
    intake = Intake(Bounds(images_per_stream=2), tally)
    for n in range(7):
        image(intake, tally, log, n)
    drain(intake)
    assert log == [5, 6]
    assert tally.counts()["spot/front/rgbd"].dropped == 5


def test_a_robot_that_sends_more_does_not_get_more_turns():
    tally, log = Tally(), []
    intake = Intake(Bounds(images_per_stream=3), tally)
    greedy = [Input("greedy", f"camera_{i}", "rgbd") for i in range(4)]
    for round_number in range(3):
        for stream in greedy:
            image(intake, tally, log, ("greedy", round_number), stream)
        image(intake, tally, log, ("modest", round_number), Input("modest", "camera", "rgbd"))
    drain(intake)
    assert [name for name, _ in log[:6]].count("modest") == 3


def test_the_bound_of_all_images_drops_from_the_longest_queue():
    tally, log = Tally(), []
    intake = Intake(Bounds(images_per_stream=4, images=5), tally)
    for n in range(4):
        image(intake, tally, log, n)
    for n in range(3):
        image(intake, tally, log, n, Input("other", f"camera_{n}", "rgbd"))
    assert intake.waiting()["images"] == 5
    counts = tally.counts()
    assert counts["spot/front/rgbd"].dropped == 2
    assert sum(row.dropped for row in counts.values()) == 2


def test_what_must_be_kept_is_kept_in_order_and_refused_beyond_the_bound():
    log: list[int] = []
    intake = Intake(Bounds(kept=3, kept_bytes=100), Tally())
    for n in range(3):
        intake.put_kept(job(log, n))
    with pytest.raises(Overloaded, match="3 observations"):
        intake.put_kept(job(log, 3))
    drain(intake)
    assert log == [0, 1, 2]
    with pytest.raises(Overloaded, match="bytes"):
        intake.put_kept(job(log, 4, size=101))


def test_requests_beyond_the_bound_are_refused():
    intake = Intake(Bounds(requests=2), Tally())
    intake.put_request(job([], 1))
    intake.put_request(job([], 1))
    with pytest.raises(Overloaded, match="2 requests"):
        intake.put_request(job([], 1))


def test_requests_go_first_but_never_keep_observations_from_their_turn():
    tally, log = Tally(), []
    intake = Intake(Bounds(request_share_s=0.05), tally)
    for n in range(6):
        intake.put_request(job(log, f"ask {n}"))
    image(intake, tally, log, "image")
    for _ in range(7):
        taken = intake.take(0.0)
        assert taken is not None
        taken.run()
        if str(log[-1]).startswith("ask"):
            intake.spent_on_request(0.03)
    assert log == ["ask 0", "ask 1", "image", "ask 2", "ask 3", "ask 4", "ask 5"]


def test_a_flood_of_poses_does_not_starve_the_images():
    tally, log = Tally(), []
    intake = Intake(Bounds(), tally)
    for n in range(200):
        intake.put_kept(job(log, n))
    image(intake, tally, log, "image")
    drain(intake)
    assert log.index("image") <= 64
    assert len(log) == 201


def test_take_waits_for_work_and_no_longer():
    intake = Intake(Bounds(), Tally())
    began = time.monotonic()
    assert intake.take(0.05) is None
    assert time.monotonic() - began >= 0.04
    threading.Timer(0.02, lambda: intake.put_request(job([], 1))).start()
    assert intake.take(5.0) is not None


@given(st.lists(st.tuples(st.sampled_from(["image", "kept", "take"]), st.integers(0, 3)), max_size=60))
def test_every_message_is_taken_or_dropped_or_refused_or_waiting(steps):
    tally, log = Tally(), []
    intake = Intake(Bounds(images_per_stream=2, images=4, kept=3), tally)
    sent = 0
    for what, n in steps:
        stream = Input(f"robot_{n}", "camera", "rgbd" if what == "image" else "pose")
        if what == "take":
            taken = intake.take(0.0)
            if taken is not None and taken.stream is not None:
                tally.add(taken.stream, "taken")
            continue
        sent += 1
        tally.add(stream, "received")
        if what == "image":
            intake.put_image(job(log, n, stream))
        else:
            try:
                intake.put_kept(job(log, n, stream))
            except Overloaded:
                tally.add(stream, "refused")
    rows = tally.counts().values()
    waiting = intake.waiting()
    assert waiting["images"] <= 4
    assert waiting["kept"] <= 3
    assert sum(row.received for row in rows) == sent
    assert sum(row.waiting for row in rows) == waiting["images"] + waiting["kept"]


def test_names_invented_by_strangers_do_not_fill_the_memory():
    tally = Tally()
    for n in range(1000):
        tally.add(Input(f"robot_{n}", "camera", "rgbd"), "received")
    counts = tally.counts()
    assert len(counts) <= 257
    assert sum(row.received for row in counts.values()) == 1000


def test_a_cause_is_told_once_and_counted():
    causes = Causes()
    first = causes.add("in/a", Problem(code="invalid_observation", message="Scan.points: bad (value: 1)"))
    assert first is not None
    assert first.count == 1
    assert causes.add("in/a", Problem(code="invalid_observation", message="Scan.points: bad (value: 2)")) is None
    assert causes.add("in/b", Problem(code="invalid_observation", message="Scan.points: bad")) is not None
    assert [refusal.count for refusal in causes.all()] == [2, 1]
    assert causes.total == 3


def test_who_invents_causes_fills_neither_the_memory_nor_the_line():
    causes = Causes()
    told = [causes.add(f"in/{n}", Problem(code="x", message="y")) for n in range(1000)]
    assert len(causes.all()) <= 500
    assert causes.total == 1000
    assert 100 <= sum(refusal is not None for refusal in told) < 200


def test_request_times_are_figures_of_the_latest():
    times = RequestTimes()
    for n in range(1, 11):
        times.add("ask", n / 1000, failed=n == 1)
    assert times.figures()["ask"] == {"count": 10, "failed": 1, "median_ms": 6.0, "worst_ms": 10.0}
