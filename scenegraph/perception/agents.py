"""Robots in the graph: where they are, and the way they came."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.observations import AgentPose
from scenegraph.graph import Box, Node

Array: TypeAlias = NDArray[Any]

STEP_M = 0.25
"""A robot's trajectory holds a point wherever it went this far from the one before …"""
MOST_POINTS = 128
"""… and no more than this: then every second point goes, and the steps are twice as long from there on."""


def agent_node(observation: AgentPose, known: Node | None) -> Node:
    """The node of a robot at its new pose.

    Attributes: `name`, `trajectory` [[x, y, z], …] [m] from where it was first seen with the times `trajectory_ns`,
    and `trajectory_step_m`. A pose that comes late, after a newer one, moves nothing.
    """
    T, stamp_ns = observation.T_map_base, observation.stamp_ns
    pose = {
        "position": T.translation,
        "box": Box(center=T.translation, size=(0.0, 0.0, 0.0), rotation_wxyz=T.quaternion_wxyz),
    }
    if known is None:
        way = {"trajectory": T.translation[None], "trajectory_ns": [stamp_ns], "trajectory_step_m": STEP_M}
        return Node(
            id=f"agent_{observation.robot}", layer="agent", label="robot", **pose,
            first_seen_ns=stamp_ns, last_seen_ns=stamp_ns, attributes={"name": observation.robot, **way},
        )  # fmt: skip
    if stamp_ns < known.last_seen_ns:
        return known.replace(first_seen_ns=min(known.first_seen_ns, stamp_ns))
    fields: dict[str, Any] = {**pose, "last_seen_ns": stamp_ns}
    further = _further(known, T.translation, stamp_ns)
    if further is not None:
        fields["attributes"] = {**known.attributes, **further}
    return known.replace(**fields)


def _further(known: Node, position: Array, stamp_ns: int) -> dict[str, Any] | None:
    """The attributes of the trajectory with one more point; None where the robot went less than a step."""
    points: Any = known.attributes.get("trajectory", [known.position.tolist()])
    times: Any = known.attributes.get("trajectory_ns", [known.last_seen_ns])
    step: Any = known.attributes.get("trajectory_step_m", STEP_M)
    if stamp_ns <= times[-1] or np.linalg.norm(position - points[-1]) < step:
        return None
    points, times = [*points, position.tolist()], [*times, stamp_ns]
    if len(points) > MOST_POINTS:
        points, times, step = points[::2], times[::2], 2.0 * step
    return {"trajectory": np.round(points, 3), "trajectory_ns": times, "trajectory_step_m": step}
