"""The trajectories of robots: thinned, bounded, and kept over restarts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3
from mapping.observations import AgentPose
from scenegraph.graph import Node
from scenegraph.perception.agents import MOST_POINTS, STEP_M, agent_node
from scenegraph.world import World
from tests.support.small_home import robot_at, stamp


def drive(way: np.ndarray, known: Node | None = None) -> Node:
    """The node of a robot after driving a way (N, 3) [m], a pose a second."""
    for n, point in enumerate(way):
        known = agent_node(AgentPose(stamp_ns=n * 10**9, robot="rob", T_map_base=SE3(np.eye(3), point)), known)
    assert known is not None
    return known


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 400), pace=st.floats(0.01, 2.0))
@settings(max_examples=30, deadline=None)
def test_a_trajectory_is_thinned_and_bounded_and_stays_near_the_way(seed: int, n: int, pace: float) -> None:
    turns = np.random.default_rng(seed).normal(0.0, 0.3, n).cumsum()
    way = np.column_stack([pace * np.cos(turns), pace * np.sin(turns), np.zeros(n)]).cumsum(axis=0)
    node = drive(way)
    points, times = np.array(node.attributes["trajectory"]), node.attributes["trajectory_ns"]
    step = node.attributes["trajectory_step_m"]
    assert len(points) == len(times) <= MOST_POINTS + 1
    assert np.array_equal(np.sort(times), times)
    assert np.allclose(points, way[np.array(times) // 10**9], atol=1e-3), "every point was driven over, at its time"
    assert np.allclose(points[0], way[0], atol=1e-3)
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert (apart >= STEP_M - 2e-3).all()
    assert np.linalg.norm(way[-1] - points[-1]) < 2.0 * step + pace  # type: ignore[operator]
    assert np.array_equal(node.position, way[-1])
    assert (node.first_seen_ns, node.last_seen_ns) == (0, (n - 1) * 10**9)


def test_a_robot_that_stands_still_writes_no_attributes() -> None:
    node = drive(np.zeros((2, 3)))
    assert drive(np.full((2, 3), 0.01), node).attributes is node.attributes


def test_a_late_pose_moves_nothing() -> None:
    node = drive(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    late = agent_node(AgentPose(stamp_ns=5 * 10**8, robot="rob", T_map_base=SE3(np.eye(3), (9.0, 0.0, 0.0))), node)
    assert late == node


def test_a_trajectory_goes_on_after_a_restart_and_keeps_what_was_told(
    copy_home: Callable[[], World], tmp_path: Path
) -> None:
    world = copy_home()
    world.integrate(robot_at(2.5, 1.4, stamp(100)))
    world.tell("set(agent_rob, owner, ann)", author="ann")
    world.save(tmp_path / "home.world")
    with World.load(tmp_path / "home.world") as again:
        again.integrate(robot_at(3.5, 2.6, stamp(200)))
        node = again.graph.node("agent_rob")
        assert np.allclose(node.attributes["trajectory"], [[1.5, 1.4, 0], [2.5, 1.4, 0], [3.5, 2.6, 0]])
        assert node.attributes["owner"] == "ann"
