"""Plans over Zenoh: while one is being made the world goes on, and every client is answered."""

from __future__ import annotations

import threading
import time

import pytest

from mapping.observations import LabelSpace, RobotDescription
from scenegraph.graph import SceneGraph
from scenegraph.planning import Step
from scenegraph.service import Client, Server
from scenegraph.service.errors import InvalidMessage
from scenegraph.world import World
from tests.support.errands import small_flat
from tests.support.net import free_endpoint


def world_of(graph: SceneGraph) -> World:
    """A world that knows a graph, and saw nothing itself."""
    world = World()
    world.graph = graph
    world.integrate(LabelSpace(classes={k: {"name": n} for k, n in enumerate(sorted({n.label for n in graph}), 1)}))
    world.meaning.remember(graph, world.labels.classes, _nothing(), ())
    return world


def _nothing():
    from scenegraph.perception.relations import MeasurementChange

    return MeasurementChange()


@pytest.fixture
def served():
    with world_of(small_flat()) as world, Server(world, "home", endpoint=free_endpoint()) as server:
        yield world, server


def test_a_client_is_given_the_plan_that_the_world_makes(served) -> None:
    world, server = served
    with Client("home", server.endpoint) as client:
        reply = client.plan("in(apple, fridge), closed(fridge)")
    assert reply.status == "solved", reply.problem
    assert reply.steps[-1].action == "close"
    mine = world.plan("in(apple, fridge), closed(fridge)")
    assert [(s.action, s.arguments) for s in reply.steps] == [(s.action, s.arguments) for s in mine]
    assert all(isinstance(s, Step) for s in mine)
    assert reply.rooms == mine.rooms


def test_what_cannot_be_planned_for_is_a_reply_with_a_problem(served) -> None:
    _, server = served
    with Client("home", server.endpoint) as client:
        assert client.plan("on(banana, bed)").problem.code == "none_known"
        assert client.plan("on(cup, tabel)").status == "unknown"
        assert client.plan("on(bed, desk)").status == "unsolvable"
        assert client.plan("on(cup, bed)", robot="somebody").problem.code == "unknown_robot"
        with pytest.raises(InvalidMessage, match="timeout_s"):
            client.plan("on(cup, bed)", timeout_s=-1.0)


def test_others_are_answered_while_a_plan_is_made(served) -> None:
    world, server = served
    solving, go_on = threading.Event(), threading.Event()
    solve = world.planner.solve

    def slowly(task, **options):
        solving.set()
        go_on.wait(20.0)
        return solve(task, **options)

    world.planner.solve = slowly
    with Client("home", server.endpoint) as client, Client("home", server.endpoint) as other:
        replies = []
        asking = threading.Thread(target=lambda: replies.append(client.plan("on(cup, bed)")))
        asking.start()
        assert solving.wait(20.0)
        began = time.monotonic()
        assert other.ask("cup(X)").truth == "true"
        other.integrate(RobotDescription(robot="rob", footprint=[[0.2, 0.2], [-0.2, 0.2], [0.0, -0.3]]))
        assert time.monotonic() - began < 5.0
        assert not replies
        go_on.set()
        asking.join(30.0)
    assert replies[0].status == "solved"


def test_a_stopped_server_gives_up_the_plan_that_it_makes() -> None:
    with world_of(small_flat()) as world:
        server = Server(world, "home", endpoint=free_endpoint()).start()
        world.planner.start()
        server.stop()
        assert world.plan("on(cup, bed)").status == "solved"
