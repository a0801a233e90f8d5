"""Watches over real Zenoh on loopback: their answers come when they change, and end with their lease."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from scenegraph.service import Client, Server, keys
from scenegraph.service.errors import InvalidMessage, RemoteProblem
from scenegraph.service.remote_watch import RemoteWatch
from scenegraph.service.session import session_config
from scenegraph.world import World
from tests.support.fake_world import FakeWorld
from tests.support.net import eventually, free_endpoint


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with World() as one:
        yield one


@pytest.fixture
def server(world: World) -> Iterator[Server]:
    for told in ("visitor", "late", "n(1)", "n(2)"):
        world.tell(f"retract({told})", author="test")
    with Server(world, "home", endpoint=free_endpoint()) as running:
        yield running
    assert not len(world.watches)
    assert not len(world.meaning.knowledge.watching)


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client("home", server.endpoint) as connected:
        yield connected


def values(rows: tuple[dict[str, object], ...]) -> list[object]:
    return [row["X"] for row in rows]


def test_a_client_is_told_what_came_and_went(client: Client) -> None:
    with client.watch("fact(X)") as changes:
        first = changes.next(5.0)
        assert first is not None
        assert (first.truth, first.came, first.answers) == ("false", (), ())
        told = client.tell("fact(visitor)")
        second = changes.next(5.0)
        assert second is not None
        assert (second.truth, values(second.came), values(second.answers)) == ("true", ["visitor"], ["visitor"])
        assert second.revision == told.revision
        client.tell("retract(visitor)")
        third = changes.next(5.0)
        assert third is not None
        assert (third.truth, values(third.went), third.answers) == ("false", ["visitor"], ())
        client.tell("rename(nothing, 'x')")
        assert changes.next(0.3) is None
        assert changes.poll() == []


def test_iterating_waits_for_each_change_until_the_watch_is_closed(client: Client) -> None:
    with client.watch("fact(n(X))") as changes:
        seen = []
        for change in changes:
            seen.append(values(change.answers))
            if len(seen) == 3:
                break
            client.tell(f"fact(n({len(seen)}))")
        assert seen == [[], [1], [1, 2]]
    assert list(changes) == []


def test_a_goal_that_cannot_be_asked_is_refused_as_asking_it_is(client: Client, server: Server) -> None:
    asked = client.ask("near(dragon, X)").problem
    assert asked is not None
    with pytest.raises(RemoteProblem) as refused:
        client.watch("near(dragon, X)")
    assert refused.value.problem == asked
    with pytest.raises(InvalidMessage):
        client.watch("fact(X)", lease_s=0.0)
    assert not len(server._desk)


def test_a_watch_of_a_client_that_has_gone_ends_with_its_lease(
    server: Server, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RemoteWatch, "_renew", lambda self: None)
    with Client("home", server.endpoint) as client:
        client.watch("fact(X)", lease_s=0.5)
        kept = client.watch("fact(n(X))", lease_s=30.0)
        assert len(world.watches) == 2
        assert eventually(lambda: len(world.watches) == 1)
        kept.close()
        assert eventually(lambda: len(world.watches) == 0)


def test_a_lease_is_renewed_and_a_watch_that_was_lost_is_started_anew(client: Client, server: Server) -> None:
    with client.watch("fact(X)", lease_s=0.6) as changes:
        first, name = changes.next(5.0), changes.name
        assert first is not None
        time.sleep(1.5)
        assert changes.name == name, "it was renewed"
        server._desk._end(name)
        assert eventually(lambda: changes.name != name)
        client.tell("fact(late)")
        change = changes.next(5.0)
        assert change is not None
        assert values(change.came) == ["late"], "what was known is not told again"


def test_a_client_is_told_when_nobody_keeps_its_answers(world: World) -> None:
    server = Server(world, "home", endpoint=free_endpoint()).start()
    with Client("home", server.endpoint, timeout_s=1.0) as client:
        changes = client.watch("fact(X)", lease_s=0.6)
        assert changes.next(5.0) is not None
        server.stop()
        trouble = changes.next(20.0)
        assert trouble is not None
        assert (trouble.truth, trouble.went) == ("unknown", ())
        assert trouble.problem is not None
        changes.close()


def test_a_program_without_our_package_can_watch(client: Client, server: Server) -> None:
    with zenoh.open(session_config("client", connect=[server.endpoint], message_bytes=1 << 20)) as session:
        puts: list[zenoh.Sample] = []
        session.declare_subscriber("scenegraph/v1/home/answers/*", puts.append)
        [reply] = session.get("scenegraph/v1/home/watch", payload=json.dumps({"goal": "fact(X)"}), timeout=10.0)
        assert reply.ok is not None
        told = json.loads(reply.ok.payload.to_string())
        assert told["lease_s"] == 60
        client.tell("fact(visitor)")
        assert eventually(lambda: len(puts) >= 2)
        assert {str(put.key_expr) for put in puts} == {keys.answers("home", told["watch"])}
        assert str(puts[-1].encoding) == "application/json;WatchAnswers"
        message = json.loads(puts[-1].payload.to_string())
        assert message["answers"] == message["came"] == [{"X": {"value": "visitor"}}]
        assert (message["went"], message["truth"], message["number"]) == ([], "true", 2)
        [again] = session.get(f"scenegraph/v1/home/answers/{told['watch']}", timeout=10.0)
        assert again.ok is not None
        assert json.loads(again.ok.payload.to_string()) == message
        [unknown] = session.get("scenegraph/v1/home/answers/w_0", timeout=10.0)
        assert unknown.err is not None
        assert json.loads(unknown.err.payload.to_string())["code"] == "unknown_watch"


def test_a_goal_that_takes_long_each_time_leaves_others_their_turns(client: Client, world: World) -> None:
    slow = "(fact(visitor) -> repeat, fail ; fact(X))"
    with client.watch(slow) as changes, client.watch("fact(n(X))") as others:
        assert changes.next(5.0) is not None
        assert others.next(5.0) is not None
        client.tell("fact(visitor)")
        trouble = changes.next(10.0)
        assert trouble is not None
        assert trouble.problem is not None
        assert trouble.problem.code == "timeout"
        began = time.monotonic()
        for n in range(5):
            client.tell(f"fact(n({n}))")
        told = [change for _ in range(5) if (change := others.next(5.0)) is not None]
        assert values(told[-1].answers)[-1] == 4
        assert time.monotonic() - began < 5.0, "the slow one rests"
        for n in range(5):
            client.tell(f"retract(n({n}))")


def test_the_command_line_prints_changes_as_they_come(client: Client, server: Server, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "scenegraph.cli", "watch", "fact(X)", "--connect", server.endpoint]
    json_lines, lines = tmp_path / "json_lines", tmp_path / "lines"
    with json_lines.open("w") as first_out, lines.open("w") as second_out:
        ended_by_us = subprocess.Popen([*words, "--json"], stdout=first_out)
        ends_itself = subprocess.Popen([*words, "--changes", "2"], stdout=second_out)
        try:
            assert eventually(lambda: bool(json_lines.read_text() and lines.read_text()), 60.0)
            client.tell("fact(visitor)")
            assert ends_itself.wait(60) == 0
            assert eventually(lambda: len(json_lines.read_text().splitlines()) == 2, 60.0)
        finally:
            ended_by_us.send_signal(signal.SIGINT)
        assert ended_by_us.wait(60) == 0
    first, second = map(json.loads, json_lines.read_text().splitlines())
    assert (first["truth"], first["came"]) == ("false", [])
    assert (second["truth"], second["came"], second["went"]) == ("true", [{"X": {"value": "visitor"}}], [])
    assert "+ X = visitor" in lines.read_text()
    refused = subprocess.run(
        [*words[:4], "near(dragon, X)", *words[5:]], check=False, capture_output=True, text=True, timeout=60
    )
    assert refused.returncode == 2
    assert "did you mean" in refused.stderr


def test_a_world_that_keeps_no_watches_says_so() -> None:
    with Server(FakeWorld(), "home", endpoint=free_endpoint()) as server, Client("home", server.endpoint) as client:
        with pytest.raises(RemoteProblem, match="keeps no watches"):
            client.watch("cup")
        assert client.ask("table").truth == "true"
