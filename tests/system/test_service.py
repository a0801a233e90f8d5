"""Server and client over real Zenoh on loopback, with a world small enough to see through."""

from __future__ import annotations

import json
import threading
import time

import cbor2
import numpy as np
import pytest
import zenoh

from mapping.geometry import SE3
from mapping.observations import AgentPose, LabelSpace
from scenegraph.graph import Node, SceneGraph
from scenegraph.service import Client, Server, keys
from scenegraph.service.errors import (
    EndpointUnavailable,
    InvalidMessage,
    RemoteProblem,
    ServerTimeout,
    ServerUnreachable,
    UnknownWorld,
)
from scenegraph.service.intake import Bounds
from scenegraph.service.session import session_config
from tests.support.fake_world import FakeWorld
from tests.support.net import eventually, free_endpoint, small_image


@pytest.fixture
def world():
    return FakeWorld()


@pytest.fixture
def server(world):
    with Server(world, "home", endpoint=free_endpoint()) as running:
        yield running


@pytest.fixture
def client(server):
    with Client("home", server.endpoint) as connected:
        yield connected


@pytest.fixture
def plain(server):
    """A session that knows nothing of our package."""
    config = session_config("client", connect=[server.endpoint], message_bytes=1 << 27)
    with zenoh.open(config) as session:
        yield session


def get(session: zenoh.Session, selector: str, **options) -> list[zenoh.Reply]:
    return list(session.get(selector, timeout=10.0, **options))


# -- the verbs -----------------------------------------------------------------------------------------------


def test_an_observation_sent_with_integrate_is_mapped_when_the_reply_comes(client, world):
    reply = client.integrate(small_image())
    assert (reply.accepted, reply.revision, reply.changed) == (True, 2, 2)
    assert world.integrated == [small_image()]


def test_a_published_image_is_mapped_and_counted(client, world):
    client.publish(small_image())
    assert eventually(lambda: client.status().inputs["spot/camera/rgbd"].taken == 1)
    assert world.integrated == [small_image()]


@pytest.mark.parametrize("compress", [False, True])
def test_an_image_arrives_as_it_was_sent(client, world, compress):
    image = small_image(size=64)
    client.integrate(image, compress=compress)
    assert world.integrated == [image]
    assert world.integrated[0].depth.flags.aligned


def test_ask_gives_nodes_and_values_and_explains_itself(client):
    client.integrate(small_image())
    answers = client.ask("cup")
    assert answers.truth == "true"
    [row] = answers
    assert isinstance(row["X"], Node)
    assert row["X"].id == "cup_2"
    assert row["N"] == 3
    assert answers.revision == 2
    assert answers.explain().truth == "true"
    assert client.ask("dragon").truth == "false"


def test_where_and_tell_and_status_and_map_query(client):
    place = client.where("near the table")
    [answer] = place.answers
    assert answer.nodes == ("table_1",)
    assert answer.region.polygon[2] == (1.0, 1.0)
    assert answer.poses[0].pose == SE3.identity()
    assert answer.poses[0].path_length_m is None
    told = client.tell("rename(table_1, 'x')", author="operator", reason="because")
    assert told.accepted
    assert client.graph().node("table_1").attributes["author"] == "operator"
    values = client.map_query("occupancy", [[1.0, 0, 0], [-1.0, 0, 0]])
    assert values.known.tolist() == [True, False]
    assert values.values[0] == 0.25
    status = client.status()
    assert status.revision == told.revision
    assert status.requests["tell"]["count"] == 1


def test_the_world_is_touched_by_one_thread_only(client, world):
    threads = [threading.Thread(target=lambda: client.ask("cup")) for _ in range(8)]
    for thread in threads:
        thread.start()
    client.integrate(small_image())
    for thread in threads:
        thread.join()
    assert len(world.threads) == 1


def test_the_endpoint_can_come_from_the_environment(server, monkeypatch):
    monkeypatch.setenv("SCENEGRAPH_ENDPOINT", server.endpoint)
    with Client("home") as client:
        assert client.worlds() == ["home"]


# -- the graph -----------------------------------------------------------------------------------------------


def test_a_mirror_follows_the_graph_by_its_deltas(client, world):
    with client.mirror() as live:
        for n in range(5):
            client.integrate(small_image(n + 1))
        client.integrate(AgentPose(stamp_ns=9, robot="spot", T_map_base=SE3.identity()))
        client.tell("rename(table_1, x)")
        assert live.wait_for(world.graph.revision)
        assert live.graph == world.graph
        assert live.n_gaps == 0


def test_a_mirror_that_missed_deltas_recovers_by_a_snapshot(client, world, plain):
    with client.mirror() as live:
        client.integrate(small_image(1))
        assert live.wait_for(2)
        live._subscriber.undeclare()
        client.integrate(small_image(2))
        client.integrate(small_image(3))
        live._subscriber = client._session.declare_subscriber(keys.key("home", "graph/delta"), live._queue.put)
        client.integrate(small_image(4))
        assert live.wait_for(world.graph.revision)
        assert live.graph == world.graph
        assert live.n_gaps == 1


def test_every_node_and_edge_has_a_key_of_its_own(client, plain):
    seen = []
    pattern = keys.key("home", "graph/edges") + "/on/*/table_1"
    with plain.declare_subscriber(pattern, lambda sample: seen.append((str(sample.key_expr), sample.kind))):
        client.integrate(small_image())
        client.integrate(AgentPose(stamp_ns=9, robot="spot", T_map_base=SE3.identity()))
        assert eventually(lambda: len(seen) == 2)
    where = keys.edge("home", "on", "cup_2", "table_1")
    assert seen == [(where, zenoh.SampleKind.PUT), (where, zenoh.SampleKind.DELETE)]


def test_nodes_and_edges_are_read_by_key(client, plain):
    client.integrate(small_image(1))
    client.integrate(small_image(2))
    prefix = keys.key("home", "graph")
    one = get(plain, f"{prefix}/nodes/object/cup_2")
    assert [json.loads(reply.ok.payload.to_bytes())["label"] for reply in one] == ["cup"]
    assert len(get(plain, f"{prefix}/nodes/**")) == 3
    assert len(get(plain, f"{prefix}/edges/on/*/table_1")) == 2
    assert len(get(plain, f"{prefix}/edges/on/cup_3/*")) == 1
    assert len(get(plain, f"{prefix}/edges/near/**")) == 0
    [reply] = get(plain, f"{prefix}/nodes/object/cup_2?format=cbor")
    assert cbor2.loads(reply.ok.payload.to_bytes())["id"] == "cup_2"


def test_the_graph_is_had_in_every_format(client, world):
    client.integrate(small_image())
    assert client.graph() == world.graph
    assert cbor2.loads(client.export("cbor"))["revision"] == 2
    assert len(json.loads(client.export("node_link"))["nodes"]) == 2
    assert json.loads(client.export("spark_dsg"))
    assert b"graphml" in client.export("graphml")
    with pytest.raises(RemoteProblem, match="format"):
        client.export("docx")


# -- load ----------------------------------------------------------------------------------------------------


def test_events_are_asked_for_as_they_are_in_process(client, world):
    assert client.events() == world.events()
    assert client.events(since_ns=0) == world.events(0)
    assert client.events(since_ns=1) == []


def test_the_newest_images_win_and_each_is_counted(server, client, world):
    world.slow_s = 0.05
    for n in range(30):
        client.publish(small_image(n + 1))
    counts = lambda: client.status().inputs["spot/camera/rgbd"]  # noqa: E731
    assert eventually(lambda: counts().received == 30 and counts().waiting == 0)
    final = counts()
    assert final.dropped > 0
    assert final.taken + final.dropped == 30
    assert world.integrated[-1].stamp_ns == 30


def test_what_must_be_kept_is_all_mapped(client, world):
    for n in range(300):
        client.publish(AgentPose(stamp_ns=n + 1, robot="spot", T_map_base=SE3.identity()))
    assert eventually(lambda: len(world.integrated) == 300)
    assert [pose.stamp_ns for pose in world.integrated] == list(range(1, 301))


def test_a_sender_beyond_the_bound_is_told(world):
    world.slow_s = 0.05
    with (
        Server(world, "home", endpoint=free_endpoint(), bounds=Bounds(kept=5)) as server,
        Client("home", server.endpoint) as client,
    ):
        for n in range(40):
            client.publish(AgentPose(stamp_ns=n + 1, robot="spot", T_map_base=SE3.identity()))
        assert eventually(lambda: len(client.problems().problems) > 0)
        [refusal] = client.problems().problems
        assert refusal.code == "overloaded"
        assert refusal.source.endswith("in/spot/base/pose")
        assert eventually(lambda: client.status().inputs["spot/base/pose"].waiting == 0)
        row = client.status().inputs["spot/base/pose"]
        assert row.taken + row.refused == 40
        assert eventually(lambda: client.problems().problems[0].count == row.refused)


def test_a_question_is_answered_between_images(client, world):
    world.slow_s = 0.05
    for n in range(20):
        client.publish(small_image(n + 1, sensor=f"camera_{n % 10}"))
    began = time.monotonic()
    client.ask("table")
    assert time.monotonic() - began < 0.5
    assert client.status().waiting["images"] > 0


def test_a_question_that_takes_its_time_delays_the_graph_and_the_status_of_nobody(server, client):
    with Client("home", server.endpoint) as other:
        asking = threading.Thread(target=lambda: other.ask("sleep", timeout_s=1.0))
        asking.start()
        assert eventually(lambda: client.status().busy_s > 0.05)
        assert client.graph().revision == 1
        assert asking.is_alive()
        asking.join()


def test_too_many_questions_are_refused_not_kept(world):
    with (
        Server(world, "home", endpoint=free_endpoint(), bounds=Bounds(requests=2)) as server,
        Client("home", server.endpoint) as client,
    ):
        outcomes = []

        def ask() -> None:
            try:
                outcomes.append(client.ask("sleep", timeout_s=0.3).truth)
            except RemoteProblem as error:
                outcomes.append(error.code)

        threads = [threading.Thread(target=ask) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert outcomes.count("overloaded") >= 2
        assert outcomes.count("unknown") >= 2


def test_stopping_finishes_what_was_taken_in(world):
    world.slow_s = 0.02
    server = Server(world, "home", endpoint=free_endpoint()).start()
    with Client("home", server.endpoint) as client:
        for n in range(20):
            client.publish(AgentPose(stamp_ns=n + 1, robot="spot", T_map_base=SE3.identity()))
        assert eventually(lambda: server.status().inputs["spot/base/pose"].received == 20)
        server.stop()
        assert len(world.integrated) == 20
        with pytest.raises((ServerUnreachable, ServerTimeout)):
            client.ask("cup")


# -- who is there --------------------------------------------------------------------------------------------


def test_a_dead_endpoint_is_told_within_two_seconds():
    endpoint = free_endpoint()
    began = time.monotonic()
    with pytest.raises(ServerUnreachable, match=f"nothing answers at {endpoint}"):
        Client("home", endpoint)
    assert time.monotonic() - began < 4.0


def test_an_unknown_world_is_told_with_those_that_are_served(server):
    with pytest.raises(UnknownWorld) as caught:
        Client("hone", server.endpoint)
    assert "did you mean 'home'?" in caught.value.hint
    assert "worlds served: home" in caught.value.hint


def test_an_endpoint_that_is_taken_is_told(server, world):
    with pytest.raises(EndpointUnavailable, match="cannot listen"):
        Server(FakeWorld(), "other", endpoint=server.endpoint).start()


def test_a_server_that_ends_takes_its_liveliness_with_it(plain, server):
    seen = []
    tokens = plain.liveliness()
    notice = lambda sample: seen.append(sample.kind)  # noqa: E731
    with tokens.declare_subscriber(keys.alive_everywhere(), notice, history=True):
        assert eventually(lambda: seen == [zenoh.SampleKind.PUT])
        server.stop()
        assert eventually(lambda: seen[1:] == [zenoh.SampleKind.DELETE])


def test_a_client_and_its_mirror_outlive_a_restart_of_the_server(world):
    endpoint = free_endpoint()
    first = Server(world, "home", endpoint=endpoint).start()
    with Client("home", endpoint) as client, client.mirror() as live:
        client.integrate(small_image(1))
        assert live.wait_for(2)
        first.stop()
        with pytest.raises(ServerUnreachable, match="no server is alive"):
            client.ask("table")
        anew = FakeWorld()
        with Server(anew, "home", endpoint=endpoint):
            assert eventually(lambda: answers(client))
            for n in range(3):
                client.integrate(small_image(10 + n))
            assert eventually(lambda: live.graph == anew.graph)


def answers(client: Client) -> bool:
    try:
        return client.ask("table").truth == "true"
    except (ServerUnreachable, ServerTimeout):
        return False


def test_a_server_that_takes_too_long_is_told(server):
    with Client("home", server.endpoint, timeout_s=0.2) as client, Client("home", server.endpoint) as other:
        asking = threading.Thread(target=lambda: other.ask("sleep", timeout_s=1.0))
        asking.start()
        assert eventually(lambda: client.status().busy_s > 0.05)
        with pytest.raises(ServerTimeout, match="did not reply"):
            client.tell("rename(table_1, x)")
        asking.join()


def test_two_worlds_answer_one_question_each_on_its_own_key(server):
    upstairs = FakeWorld()
    with Server(upstairs, "upstairs", endpoint=free_endpoint(), connect=[server.endpoint]) as second:
        config = session_config("peer", connect=[server.endpoint, second.endpoint], message_bytes=1 << 27)
        with zenoh.open(config) as session:
            options = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
            ask = lambda: get(session, "scenegraph/v1/*/ask", payload=b'{"goal": "table"}', **options)  # noqa: E731
            assert eventually(lambda: len(ask()) == 2)
            assert {str(reply.ok.key_expr) for reply in ask()} == {
                "scenegraph/v1/home/ask",
                "scenegraph/v1/upstairs/ask",
            }


# -- what is asked wrongly -----------------------------------------------------------------------------------


def test_an_error_in_the_world_is_told_without_its_secrets_and_the_server_goes_on(client):
    with pytest.raises(RemoteProblem, match="ZeroDivisionError") as caught:
        client.ask("crash")
    assert caught.value.code == "internal_error"
    assert "secret" not in str(caught.value)
    assert client.ask("table").truth == "true"


def test_a_request_is_refused_before_it_is_sent_when_it_is_none(client):
    with pytest.raises(InvalidMessage, match=r"AskRequest\.goal"):
        client.ask("")
    with pytest.raises(InvalidMessage, match=r"AskRequest\.timeout_s"):
        client.ask("cup", timeout_s=1e9)


@pytest.mark.parametrize("path", ["ask", "where", "tell", "map/occupancy/query"])
@pytest.mark.parametrize("payload", [None, b"", b"\xff\x00garbage", b"{", b"[]", b'{"nonsense": 1}'])
def test_a_request_that_is_none_gets_an_error_reply(plain, path, payload):
    [reply] = get(plain, f"scenegraph/v1/home/{path}", payload=payload)
    problem = json.loads(reply.err.payload.to_bytes())
    assert problem["code"] == "invalid_message"
    assert problem["message"]


def test_a_deletion_and_too_many_points_are_refused(client, plain):
    plain.delete(keys.key("home", "in") + "/spot/camera/rgbd")
    assert eventually(lambda: len(client.problems().problems) == 1)
    assert "a deletion means nothing here" in client.problems().problems[0].message
    with pytest.raises(RemoteProblem, match=r"MapQuery\.points: expected at most 1000000 points"):
        client.map_query("occupancy", np.zeros((1_000_001, 3)))
    with pytest.raises(RemoteProblem, match=r"MapQuery\.points: expected finite"):
        client.map_query("occupancy", [[0.0, 0.0, float("nan")]])


def test_the_reply_has_the_form_of_the_request(plain):
    [reply] = get(plain, "scenegraph/v1/home/ask", payload=cbor2.dumps({"goal": "table"}), encoding="application/cbor")
    assert str(reply.ok.encoding) == "application/cbor;AskReply"
    assert cbor2.loads(reply.ok.payload.to_bytes())["truth"] == "true"
    [reply] = get(plain, "scenegraph/v1/home/ask", payload=cbor2.dumps({"gaol": 1}), encoding="application/cbor")
    assert cbor2.loads(reply.err.payload.to_bytes())["code"] == "invalid_message"


def test_a_statement_that_is_none_is_told_why(client):
    with pytest.raises(RemoteProblem, match="is not a statement") as caught:
        client.tell("nonsense")
    assert caught.value.problem.hint == "rename(Id, Name)"


def test_an_observation_of_another_robot_than_its_key_says_is_refused(client, plain):
    from scenegraph.service.messages import encode

    [reply] = get(plain, "scenegraph/v1/home/in/other/camera/rgbd", payload=encode(small_image()))
    assert "RgbdImage.robot: expected 'other'" in json.loads(cbor_problem(reply))["message"]


def cbor_problem(reply: zenoh.Reply) -> str:
    return json.dumps(cbor2.loads(reply.err.payload.to_bytes()))


def test_a_label_space_without_robot_reaches_the_world(client, world):
    space = LabelSpace(classes={1: {"name": "wall"}})
    client.integrate(space)
    assert world.integrated == [space]


def test_the_schema_is_served(client):
    assert "RgbdImage" in client.schema()["$defs"]


def test_a_snapshot_makes_the_same_graph(client, world):
    assert SceneGraph.from_snapshot(client.snapshot()) == world.graph
