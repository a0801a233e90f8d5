"""The copy of the graph that others read: it follows, publishes, and finds its way back."""

from __future__ import annotations

import pytest

from mapping.geometry import SE3
from mapping.observations import AgentPose
from scenegraph.graph import Delta, Mirror, Node
from scenegraph.service.feed import GraphFeed
from tests.support.fake_world import FakeWorld
from tests.support.net import eventually, small_image


class Published(list):
    def put(self, row: str, where: str, what: object) -> None:
        self.append((row, where, what))

    def deltas(self) -> list[Delta]:
        return [what for _, _, what in self if isinstance(what, Delta)]


@pytest.fixture
def world():
    return FakeWorld()


@pytest.fixture
def published():
    return Published()


@pytest.fixture
def feed(world, published):
    running = GraphFeed("home", world.graph.snapshot(), published.put)
    running.start()
    yield running
    running.stop()


def test_it_publishes_the_delta_then_each_node_and_edge(world, feed, published):
    feed.put(world.integrate(small_image()))
    feed.put(world.integrate(AgentPose(stamp_ns=5, robot="spot", T_map_base=SE3.identity())))
    assert eventually(lambda: len(published) == 6)
    assert [(row.split("/")[1].split("{")[0], what is None) for row, _, what in published] == [
        ("delta", False),
        ("nodes", False),
        ("edges", False),
        ("delta", False),
        ("edges", True),
        ("nodes", True),
    ]
    assert published[5][1] == "scenegraph/v1/home/graph/nodes/object/cup_2"


def test_a_read_is_no_older_than_what_was_handed_in(world, feed):
    for n in range(50):
        feed.put(world.integrate(small_image(n + 1)))
        assert feed.snapshot().revision == world.graph.revision


def test_when_deltas_are_missing_the_whole_brings_everyone_up_to_date(world, feed, published):
    mirror = Mirror(feed.snapshot)
    mirror.resynchronise()
    world.integrate(small_image(1))
    world.integrate(AgentPose(stamp_ns=2, robot="spot", T_map_base=SE3.identity()))
    world.integrate(small_image(3))
    feed.put(world.graph.snapshot())
    assert eventually(lambda: bool(published.deltas()))
    for delta in published.deltas():
        mirror.receive(delta)
    assert mirror.graph == world.graph
    assert mirror.n_gaps == 1
    put = [where for row, where, what in published if isinstance(what, Node)]
    assert put == ["scenegraph/v1/home/graph/nodes/object/cup_2"]


def test_a_delta_that_does_not_fit_is_survived_and_the_whole_asked_for(world, feed):
    feed.put(Delta(revision=99, stamp_ns=1))
    world.integrate(small_image(1))
    assert eventually(lambda: feed.revision != 99)
    assert feed.revision + 1 != world.graph.revision
    feed.put(world.graph.snapshot())
    assert feed.snapshot() == world.graph.snapshot()


def test_a_key_finds_its_node_and_edges(world, feed):
    for n in range(3):
        feed.put(world.integrate(small_image(n + 1)))
    prefix = "scenegraph/v1/home/graph"

    def found(path: str) -> set[str]:
        return {where.removeprefix(f"{prefix}/") for where, _ in feed.matches(f"{prefix}/{path}")}

    assert found("nodes/object/cup_2") == {"nodes/object/cup_2"}
    assert found("nodes/*/cup_2") == {"nodes/object/cup_2"}
    assert found("nodes/room/cup_2") == set()
    assert found("nodes/object/cup_9") == set()
    assert len(found("nodes/object/*")) == 4
    assert found("edges/on/cup_3/*") == {"edges/on/cup_3/table_1"}
    assert len(found("edges/*/*/table_1")) == 3
    assert len(found("edges/**/table_1")) == 3
    assert len(found("**")) == 7
