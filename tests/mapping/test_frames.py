"""The frame tree: chains, interpolation in time, bounds, and clear refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.errors import InvalidObservation, InvalidParameter, PoseUnavailable
from mapping.frames import T_BODY_OPTICAL, FrameTree
from mapping.geometry import SE3
from mapping.observations import AgentPose, Transform

SECOND = 10**9

small = st.floats(-1.0, 1.0, allow_subnormal=False)
poses = st.tuples(*[small] * 6).map(SE3.exp)
stamps = st.integers(0, 2 * SECOND)


def edge(parent, child, pose, stamp_ns=0, static=False, robot="r"):
    return Transform(stamp_ns=stamp_ns, robot=robot, parent=parent, child=child, T_parent_child=pose, static=static)


def agent(pose, stamp_ns=0, robot="r"):
    return AgentPose(stamp_ns=stamp_ns, robot=robot, T_map_base=pose)


def shift(x=0.0, y=0.0, z=0.0):
    return SE3(np.eye(3), [x, y, z])


@given(poses, poses, poses, poses, stamps)
def test_lookups_chain_and_invert(a, b, c, d, stamp_ns):
    tree = FrameTree()
    tree.add(edge("map", "odom", a, static=True))
    tree.add(edge("odom", "base_link", b, static=True))
    tree.add(edge("base_link", "camera", c, static=True))
    tree.add(edge("base_link", "lidar", d, static=True))
    assert tree.lookup("r", "map", "camera", stamp_ns).isclose(a @ b @ c)
    assert tree.lookup("r", "camera", "lidar", stamp_ns).isclose(c.inverse() @ d)
    there = tree.lookup("r", "lidar", "map", stamp_ns)
    assert (there @ tree.lookup("r", "map", "lidar", stamp_ns)).isclose(SE3.identity())
    assert tree.lookup("r", "map", "odom", stamp_ns) @ tree.lookup("r", "odom", "camera", stamp_ns)
    assert tree.lookup("r", "camera", "camera", stamp_ns) == SE3.identity()


@given(st.lists(st.tuples(stamps, poses), min_size=2, max_size=8, unique_by=lambda item: item[0]), stamps)
def test_a_pose_between_two_samples_is_interpolated_whatever_their_order_of_arrival(samples, stamp_ns):
    tree = FrameTree(tolerance_s=0.0)
    for at, pose in samples:
        tree.add(agent(pose, at))
    samples.sort(key=lambda item: item[0])
    known = [at for at, _ in samples]
    if not known[0] <= stamp_ns <= known[-1]:
        with pytest.raises(PoseUnavailable, match="known from"):
            tree.lookup("r", "map", "base_link", stamp_ns)
        return
    after = next(i for i, at in enumerate(known) if at >= stamp_ns)
    if known[after] == stamp_ns:
        expected = samples[after][1]
    else:
        share = (stamp_ns - known[after - 1]) / (known[after] - known[after - 1])
        expected = samples[after - 1][1].interpolate(samples[after][1], share)
    assert tree.lookup("r", "map", "base_link", stamp_ns).isclose(expected)


def test_stamps_since_1970_are_told_apart_by_the_nanosecond():
    tree = FrameTree(tolerance_s=0.0)
    begin = 1_700_000_000 * SECOND
    tree.add(agent(shift(0.0), begin))
    tree.add(agent(shift(1.0), begin + 10))
    np.testing.assert_allclose(tree.lookup("r", "map", "base_link", begin + 3).translation, [0.3, 0, 0])


def test_a_pose_holds_for_the_tolerance_and_no_longer():
    tree = FrameTree(tolerance_s=0.05)
    tree.add(agent(shift(1.0), SECOND))
    for stamp_ns in (SECOND - 50_000_000, SECOND + 50_000_000):
        assert tree.lookup("r", "map", "base_link", stamp_ns) == shift(1.0)
    with pytest.raises(
        PoseUnavailable, match=r"map → base_link is known from 1000000000 to 1000000000 ns, 0\.051 s away"
    ):
        tree.lookup("r", "map", "base_link", SECOND + 51_000_000)


def test_a_long_gap_is_not_bridged():
    tree = FrameTree(max_gap_s=1.0, tolerance_s=0.1)
    tree.add(agent(shift(0.0), 0))
    tree.add(agent(shift(9.0), 3 * SECOND))
    assert tree.lookup("r", "map", "base_link", SECOND // 20) == shift(0.0)
    assert tree.lookup("r", "map", "base_link", 3 * SECOND - 1) == shift(9.0)
    with pytest.raises(PoseUnavailable, match=r"a gap of 3\.000 s"):
        tree.lookup("r", "map", "base_link", SECOND)


def test_memory_is_bounded_and_the_oldest_is_forgotten():
    tree = FrameTree(samples_per_edge=10, tolerance_s=0.0)
    for second in range(100):
        tree.add(agent(shift(float(second)), second * SECOND))
    assert tree.lookup("r", "map", "base_link", 99 * SECOND) == shift(99.0)
    assert tree.lookup("r", "map", "base_link", 90 * SECOND) == shift(90.0)
    with pytest.raises(PoseUnavailable):
        tree.lookup("r", "map", "base_link", 89 * SECOND)
    tree.add(agent(shift(-1.0), 5))
    with pytest.raises(PoseUnavailable):
        tree.lookup("r", "map", "base_link", 5)


def test_frames_and_robots_are_bounded():
    tree = FrameTree()
    for i in range(256):
        tree.add(edge("base_link", f"f{i}", shift(), static=True))
    with pytest.raises(InvalidObservation, match="at most 256 frames"):
        tree.add(edge("base_link", "one_more", shift(), static=True))
    for i in range(1023):
        tree.add(agent(shift(), robot=f"r{i}"))
    with pytest.raises(InvalidObservation, match="at most 1024 robots"):
        tree.add(agent(shift(), robot="one_more"))


def test_a_static_edge_holds_at_all_times_and_can_be_replaced():
    tree = FrameTree()
    tree.add(edge("base_link", "camera", shift(1.0), static=True))
    assert tree.lookup("r", "base_link", "camera", 10**18) == shift(1.0)
    tree.add(edge("base_link", "camera", shift(2.0), static=True))
    assert tree.lookup("r", "base_link", "camera", 0) == shift(2.0)


def test_a_second_sample_of_a_stamp_replaces_the_first():
    tree = FrameTree()
    tree.add(agent(shift(1.0), 7))
    tree.add(agent(shift(2.0), 7))
    assert tree.lookup("r", "map", "base_link", 7) == shift(2.0)


def test_robots_do_not_share_frames():
    tree = FrameTree()
    tree.add(agent(shift(1.0), robot="a"))
    tree.add(agent(shift(2.0), robot="b"))
    assert tree.lookup("a", "map", "base_link", 0) == shift(1.0)
    assert tree.lookup("b", "map", "base_link", 0) == shift(2.0)
    assert tree.robots() == ["a", "b"]


def test_a_loop_and_a_second_parent_are_refused():
    tree = FrameTree()
    tree.add(edge("a", "b", shift()))
    tree.add(edge("b", "c", shift()))
    with pytest.raises(InvalidObservation, match="close a loop"):
        tree.add(edge("c", "a", shift()))
    with pytest.raises(InvalidObservation, match=r"expected 'b'.*one parent.*got 'a'"):
        tree.add(edge("a", "c", shift()))
    assert tree.lookup("r", "a", "c", 0) == SE3.identity()


@given(poses, poses, poses)
def test_a_pose_in_map_corrects_odometry_which_carries_on_from_there(start, moved, true):
    tree = FrameTree()
    tree.add(edge("odom", "base_link", start, 0))
    tree.add(edge("odom", "base_link", moved, SECOND))
    tree.add(agent(true, 0))
    tree.add(agent(true, SECOND // 2))  # says where it is at half time, which corrects the drift
    half = start.interpolate(moved, 0.5)
    assert tree.lookup("r", "map", "base_link", SECOND // 2).isclose(true)
    assert tree.lookup("r", "map", "odom", SECOND // 2).isclose(true @ half.inverse())


def test_odometry_that_appears_later_takes_the_robot_over():
    tree = FrameTree()
    tree.add(agent(shift(5.0), 0))
    tree.add(edge("odom", "base_link", shift(1.0), SECOND))
    tree.add(agent(shift(6.0), SECOND))
    assert tree.lookup("r", "map", "odom", SECOND) == shift(5.0)
    tree.add(edge("odom", "base_link", shift(1.5), SECOND + 40_000_000))
    np.testing.assert_allclose(tree.lookup("r", "map", "base_link", SECOND + 40_000_000).translation, [6.5, 0, 0])


def test_a_correction_without_odometry_at_that_time_is_refused():
    tree = FrameTree()
    tree.add(edge("odom", "base_link", shift(), 0))
    with pytest.raises(PoseUnavailable, match="odom → base_link is known from 0 to 0"):
        tree.add(agent(shift(), 9 * SECOND))


def test_base_link_cannot_hang_below_itself():
    tree = FrameTree()
    tree.add(agent(shift()))
    tree.add(edge("base_link", "camera", shift(), static=True))
    with pytest.raises(InvalidObservation, match="close a loop"):
        tree.add(edge("camera", "base_link", shift()))
    assert tree.lookup("r", "map", "camera", 0) == SE3.identity()


def test_cameras_look_along_z_and_scanners_along_x():
    tree = FrameTree()
    tree.add(agent(SE3.identity()))
    tree.add(edge("base_link", "cam", shift(0.1), static=True))
    tree.add(edge("base_link", "eye_optical", T_BODY_OPTICAL, static=True))
    ahead, forward = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(tree.sensor_pose("r", "cam", 0, optical=True) @ ahead, [1.1, 0, 0])
    np.testing.assert_allclose(tree.sensor_pose("r", "cam", 0, optical=False) @ forward, [1.1, 0, 0])
    np.testing.assert_allclose(tree.sensor_pose("r", "eye", 0, optical=True) @ ahead, [1, 0, 0])
    np.testing.assert_allclose(tree.sensor_pose("r", "eye", 0, optical=False) @ forward, [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("robot", "to", "from_", "expected"),
    [
        ("spot", "map", "base_link", r"map ← base_link of robot spot at 7 ns: no pose .* \(robots known: r\)"),
        ("r", "map", "camera_optical", r"unknown frame camera_optical \(known: arm, base_link, hand, map\)"),
        ("r", "map", "hand", r"nothing joins map \(of map\) to hand \(of arm\)"),
        ("r", "map", "base_link", "map → base_link is known from 1000000000 to 1000000000 ns"),
    ],
)
def test_a_pose_that_is_not_known_is_refused_with_what_is_known(robot, to, from_, expected):
    tree = FrameTree()
    tree.add(agent(shift(), SECOND))
    tree.add(edge("arm", "hand", shift(), static=True))
    with pytest.raises(PoseUnavailable, match=expected) as caught:
        tree.lookup(robot, to, from_, 7)
    assert "\n" not in str(caught.value)


def test_parameters_are_validated():
    with pytest.raises(InvalidParameter, match="tolerance_s"):
        FrameTree(tolerance_s=-1.0)
    with pytest.raises(InvalidParameter, match="max_gap_s"):
        FrameTree(max_gap_s=float("nan"))
    with pytest.raises(InvalidParameter, match="samples_per_edge"):
        FrameTree(samples_per_edge=0)
