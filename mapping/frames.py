"""The trees of coordinate frames, one a robot, in time: map → odom → base_link → sensor (REP-105).

Every edge but a static one is a short history of poses, interpolated along the screw motion between two of them.
Nothing is invented: outside the history a pose holds for `tolerance_s` only, and two poses that are further apart
than `max_gap_s` are not joined.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable

import numpy as np

from mapping.errors import InvalidObservation, InvalidParameter, PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import AgentPose, Transform

MAP = "map"
BASE = "base_link"
MAX_FRAMES = 256
MAX_ROBOTS = 1024
"""Frames a robot may have, and robots a tree; more are refused, so that a faulty client cannot fill the memory."""

T_BODY_OPTICAL = SE3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""REP-103: an optical frame (z forward, x right, y down) in the frame of the same sensor (x forward, y left, z up)."""


class TimedPose:
    """One edge of a frame tree: the pose of a child in its parent over time, at most `capacity` samples of it."""

    def __init__(self, *, capacity: int, tolerance_ns: int, max_gap_ns: int) -> None:
        self._capacity = capacity
        self._tolerance_ns = tolerance_ns
        self._max_gap_ns = max_gap_ns
        self._stamps: list[int] = []
        self._poses: dict[int, SE3] = {}
        self._static: SE3 | None = None

    def __len__(self) -> int:
        return len(self._stamps)

    def put(self, stamp_ns: int, pose: SE3) -> None:
        """Add a sample, in any order of time; one of the same stamp is replaced, the oldest is forgotten when full."""
        self._static = None
        if stamp_ns not in self._poses:
            insort(self._stamps, stamp_ns)
        self._poses[stamp_ns] = pose
        if len(self._stamps) > self._capacity:
            del self._poses[self._stamps.pop(0)]

    def put_static(self, pose: SE3) -> None:
        """From now on the edge is `pose` at all times."""
        self._static = pose
        self._stamps.clear()
        self._poses.clear()

    def change(self, changed: Callable[[int, SE3], SE3]) -> None:
        """Replace every sample; a static pose stays."""
        self._poses = {stamp_ns: changed(stamp_ns, pose) for stamp_ns, pose in self._poses.items()}

    def at(self, stamp_ns: int) -> SE3 | str:
        """The pose at `stamp_ns`, or, in words, why it is not known."""
        if self._static is not None:
            return self._static
        stamps = self._stamps
        after = bisect_left(stamps, stamp_ns)
        if after < len(stamps) and stamps[after] == stamp_ns:
            return self._poses[stamp_ns]
        if after == 0 or after == len(stamps):
            nearest = stamps[0] if after == 0 else stamps[-1]
            if abs(nearest - stamp_ns) <= self._tolerance_ns:
                return self._poses[nearest]
            return (
                f"known from {stamps[0]} to {stamps[-1]} ns, {abs(nearest - stamp_ns) * 1e-9:.3f} s away "
                f"(tolerance {self._tolerance_ns * 1e-9:.3f} s)"
            )
        before_ns, after_ns = stamps[after - 1], stamps[after]
        if after_ns - before_ns > self._max_gap_ns:
            nearest = before_ns if stamp_ns - before_ns <= after_ns - stamp_ns else after_ns
            if abs(nearest - stamp_ns) <= self._tolerance_ns:
                return self._poses[nearest]
            return (
                f"not known from {before_ns} to {after_ns} ns, a gap of {(after_ns - before_ns) * 1e-9:.3f} s "
                f"(at most {self._max_gap_ns * 1e-9:.3f} s is bridged)"
            )
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return self._poses[before_ns].interpolate(self._poses[after_ns], share)


class _Robot:
    """The frame tree of one robot: a parent and an edge for each frame but the roots."""

    def __init__(self) -> None:
        self.parent: dict[str, str] = {}
        self.edges: dict[str, TimedPose] = {}

    def chain(self, frame: str) -> list[str]:
        """`frame` and its ancestors, up to its root."""
        chain = [frame]
        while (parent := self.parent.get(chain[-1])) is not None:
            chain.append(parent)
        return chain

    def frames(self) -> list[str]:
        return sorted({*self.parent, *self.parent.values()})


class FrameTree:
    """Where every frame of every robot is, at any remembered time.

    tolerance_s        how far beyond the first or last sample of an edge its pose still holds [s]
    max_gap_s          the longest time between two samples that is interpolated [s]
    samples_per_edge   how many samples of an edge are kept; the oldest are forgotten first

    A frame has one parent. `AgentPose` says where `base_link` is in `map`. Where `base_link` has another parent
    (`odom`), it corrects the edge from `map` to the root above (REP-105), and odometry carries the robot in between.
    """

    def __init__(self, *, tolerance_s: float = 0.05, max_gap_s: float = 2.0, samples_per_edge: int = 4096) -> None:
        for name, value in (("tolerance_s", tolerance_s), ("max_gap_s", max_gap_s)):
            if not 0.0 <= value < 1.0e6:
                raise InvalidParameter(f"{name}: expected seconds ≥ 0, got {value}")
        if samples_per_edge < 1:
            raise InvalidParameter(f"samples_per_edge: expected at least 1, got {samples_per_edge}")
        self._tolerance_ns = round(tolerance_s * 1e9)
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._capacity = samples_per_edge
        self._robots: dict[str, _Robot] = {}

    def add(self, observation: Transform | AgentPose) -> None:
        """Remember an edge of the tree, or where a robot is.

        Raises `InvalidObservation` when the frame has another parent already, when the edge would close a loop or when
        there are too many frames or robots; `PoseUnavailable` when an `AgentPose` cannot be tied to the odometry at its
        stamp.
        """
        if observation.robot not in self._robots and len(self._robots) >= MAX_ROBOTS:
            raise InvalidObservation(
                f"{type(observation).__name__}.robot: expected at most {MAX_ROBOTS} robots, got another: "
                f"{observation.robot!r}"
            )
        robot = self._robots.setdefault(observation.robot, _Robot())
        if isinstance(observation, Transform):
            self._add_transform(robot, observation)
        else:
            self._add_agent_pose(robot, observation)

    def correct(self, robot: str, correction: Callable[[int], SE3]) -> None:
        """Move where the robot has been in map: `correction(stamp_ns)` is how the map there has moved since.

        Only the edges from map are changed, at the samples that are remembered; odometry stays.
        """
        tree = self._robots.get(robot)
        if tree is not None:
            for child, edge in tree.edges.items():
                if tree.parent[child] == MAP:
                    edge.change(lambda stamp_ns, pose: correction(stamp_ns) @ pose)

    def _add_transform(self, robot: _Robot, edge: Transform) -> None:
        known = robot.parent.get(edge.child)
        if known == MAP and edge.child == BASE and edge.parent != MAP:
            self._hang_base_below(robot, edge.parent)
        elif known is not None and known != edge.parent:
            raise InvalidObservation(
                f"Transform.parent: expected {known!r}, the parent of {edge.child!r} so far (a frame has one parent), "
                f"got {edge.parent!r} for robot {edge.robot}"
            )
        self._put(robot, edge.robot, edge.parent, edge.child, edge.stamp_ns, edge.T_parent_child, edge.static)

    def _hang_base_below(self, robot: _Robot, parent: str) -> None:
        """Odometry appears after poses in map: `base_link` gets `parent`, and the next `AgentPose` ties that to map."""
        if BASE in robot.chain(parent):
            raise InvalidObservation(f"Transform.parent: {parent!r} lies below {BASE!r}; the edge would close a loop")
        del robot.parent[BASE], robot.edges[BASE]

    def _add_agent_pose(self, robot: _Robot, pose: AgentPose) -> None:
        root = robot.chain(BASE)[-1]
        if root == MAP and robot.parent[BASE] != MAP:
            root = robot.chain(BASE)[-2]
        if root in (BASE, MAP):
            self._put(robot, pose.robot, MAP, BASE, pose.stamp_ns, pose.T_map_base, static=False)
            return
        T_root_base = self.lookup(pose.robot, root, BASE, pose.stamp_ns)
        self._put(robot, pose.robot, MAP, root, pose.stamp_ns, pose.T_map_base @ T_root_base.inverse(), static=False)

    def _put(self, robot: _Robot, name: str, parent: str, child: str, stamp_ns: int, pose: SE3, static: bool) -> None:
        if child not in robot.edges:
            if child in robot.chain(parent):
                raise InvalidObservation(
                    f"Transform: {child!r} → {parent!r} → … → {child!r} would close a loop (robot {name}); "
                    "expected a tree of frames"
                )
            if len(robot.edges) >= MAX_FRAMES:
                raise InvalidObservation(
                    f"Transform.child: expected at most {MAX_FRAMES} frames a robot (value: {child!r}, robot {name})"
                )
            robot.parent[child] = parent
            robot.edges[child] = TimedPose(
                capacity=self._capacity, tolerance_ns=self._tolerance_ns, max_gap_ns=self._max_gap_ns
            )
        if static:
            robot.edges[child].put_static(pose)
        else:
            robot.edges[child].put(stamp_ns, pose)

    # -- questions ----------------------------------------------------------------------------------------
    def robots(self) -> list[str]:
        return sorted(self._robots)

    def frames(self, robot: str) -> list[str]:
        """The frames of `robot`, in order of name; empty when nothing is known of it."""
        return self._robots[robot].frames() if robot in self._robots else []

    def lookup(self, robot: str, frame_to: str, frame_from: str, stamp_ns: int) -> SE3:
        """`T_to_from`, the pose of `frame_from` in `frame_to` at `stamp_ns`, so that `p_to = T_to_from @ p_from`.

        Raises `PoseUnavailable`, naming both frames, the stamp and what is known.
        """
        if frame_to == frame_from:
            return SE3.identity()
        tree = self._robots.get(robot)
        asked = f"{frame_to} ← {frame_from} of robot {robot} at {stamp_ns} ns"
        if tree is None:
            known = ", ".join(self.robots()) or "none"
            raise PoseUnavailable(
                f"no pose for {asked}: no pose or transform of that robot has arrived (robots known: {known})",
                hint="publish an AgentPose or Transforms of the robot, or give the observation its own pose",
            )
        frames = tree.frames()
        missing = [frame for frame in (frame_to, frame_from) if frame not in frames]
        if missing:
            raise PoseUnavailable(
                f"no pose for {asked}: unknown frame {' and '.join(missing)} (known: {', '.join(frames) or 'none'})",
                hint=f"publish a Transform whose child is {missing[-1]}",
            )
        up_from, up_to = tree.chain(frame_from), tree.chain(frame_to)
        common = next((frame for frame in up_from if frame in up_to), None)
        if common is None:
            raise PoseUnavailable(
                f"no pose for {asked}: nothing joins {frame_to} (of {up_to[-1]}) to {frame_from} (of {up_from[-1]})",
                hint=f"publish an AgentPose, or a Transform that joins {up_to[-1]} and {up_from[-1]}",
            )
        T_common_from = self._climb(tree, up_from[: up_from.index(common)], stamp_ns, asked)
        T_common_to = self._climb(tree, up_to[: up_to.index(common)], stamp_ns, asked)
        return T_common_to.inverse() @ T_common_from

    @staticmethod
    def _climb(tree: _Robot, frames: list[str], stamp_ns: int, asked: str) -> SE3:
        pose = SE3.identity()
        for frame in frames:
            step = tree.edges[frame].at(stamp_ns)
            if isinstance(step, str):
                raise PoseUnavailable(f"no pose for {asked}: {tree.parent[frame]} → {frame} is {step}")
            pose = step @ pose
        return pose

    def sensor_pose(self, robot: str, sensor: str, stamp_ns: int, *, optical: bool) -> SE3:
        """`T_map_sensor` of a camera (`optical`, z forward) or a scanner (x forward) at `stamp_ns`.

        A camera's frame is `<sensor>_optical`, a scanner's `<sensor>`. Where only the other of the two is known, the
        fixed rotation between them (REP-103) is applied. Raises `PoseUnavailable`.
        """
        wanted, other = (f"{sensor}_optical", sensor) if optical else (sensor, f"{sensor}_optical")
        frames = self.frames(robot)
        if wanted in frames or other not in frames:
            return self.lookup(robot, MAP, wanted, stamp_ns)
        T_other_wanted = T_BODY_OPTICAL if optical else T_BODY_OPTICAL.inverse()
        return self.lookup(robot, MAP, other, stamp_ns) @ T_other_wanted
