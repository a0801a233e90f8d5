"""A world model for robots: observations in; a layered map, a labelled scene graph and symbolic answers out.

Each name is imported when it is first used, so that the command line starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapping.geometry import SE3, CameraIntrinsics
    from mapping.observations import (
        AgentPose,
        ClassInfo,
        CorrectedPose,
        Detection,
        Detections,
        LabelSpace,
        PoseCorrection,
        RgbdImage,
        RobotDescription,
        Scan,
        Transform,
    )
    from scenegraph.answers import Answers, GoalPose, Place, PlaceAnswer, Region, TellResult
    from scenegraph.config import WorldConfig
    from scenegraph.errors import Problem, SceneGraphError
    from scenegraph.graph import Box, Delta, Edge, Node, SceneGraph
    from scenegraph.planning.plan import Plan, Step
    from scenegraph.service.client import Client
    from scenegraph.service.server import Server
    from scenegraph.simulation import simulate_home
    from scenegraph.world import World

_HOMES = {
    "mapping.geometry": ("SE3", "CameraIntrinsics"),
    "mapping.observations": (
        "AgentPose",
        "ClassInfo",
        "CorrectedPose",
        "Detection",
        "Detections",
        "LabelSpace",
        "PoseCorrection",
        "RgbdImage",
        "RobotDescription",
        "Scan",
        "Transform",
    ),
    "scenegraph.answers": ("Answers", "GoalPose", "Place", "PlaceAnswer", "Region", "TellResult"),
    "scenegraph.config": ("WorldConfig",),
    "scenegraph.errors": ("Problem", "SceneGraphError"),
    "scenegraph.graph": ("Box", "Delta", "Edge", "Node", "SceneGraph"),
    "scenegraph.planning.plan": ("Plan", "Step"),
    "scenegraph.service.client": ("Client",),
    "scenegraph.service.server": ("Server",),
    "scenegraph.simulation": ("simulate_home",),
    "scenegraph.world": ("World",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "SE3",
    "AgentPose",
    "Answers",
    "Box",
    "CameraIntrinsics",
    "ClassInfo",
    "Client",
    "CorrectedPose",
    "Delta",
    "Detection",
    "Detections",
    "Edge",
    "GoalPose",
    "LabelSpace",
    "Node",
    "Place",
    "PlaceAnswer",
    "Plan",
    "PoseCorrection",
    "Problem",
    "Region",
    "RgbdImage",
    "RobotDescription",
    "Scan",
    "SceneGraph",
    "SceneGraphError",
    "Server",
    "Step",
    "TellResult",
    "Transform",
    "World",
    "WorldConfig",
    "simulate_home",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value
