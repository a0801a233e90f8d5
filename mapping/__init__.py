"""Observations, geometry and map layers: from sensor data to metric and semantic voxels.

Each name is imported when it is first used, so that `import mapping` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapping.datasets import open_dataset
    from mapping.errors import DatasetError, InvalidObservation, InvalidParameter, MappingError, PoseUnavailable
    from mapping.esdf import EsdfMap
    from mapping.frames import FrameTree
    from mapping.geometry import SE3, CameraIntrinsics
    from mapping.instances import InstanceMap
    from mapping.layer import Changed, MapLayer
    from mapping.layered import LayeredMap
    from mapping.mesh import Mesh
    from mapping.observations import (
        AgentPose,
        ClassInfo,
        Detection,
        Detections,
        LabelSpace,
        RgbdImage,
        RobotDescription,
        Scan,
        Transform,
    )
    from mapping.occupancy import OccupancyMap
    from mapping.octomap import read_octomap
    from mapping.planes import Plane, PlaneMap, extract_planes
    from mapping.semantics import SemanticMap
    from mapping.tsdf import TsdfMap

_HOMES = {
    "datasets": ("open_dataset",),
    "errors": ("DatasetError", "InvalidObservation", "InvalidParameter", "MappingError", "PoseUnavailable"),
    "esdf": ("EsdfMap",),
    "frames": ("FrameTree",),
    "geometry": ("SE3", "CameraIntrinsics"),
    "instances": ("InstanceMap",),
    "layer": ("Changed", "MapLayer"),
    "layered": ("LayeredMap",),
    "mesh": ("Mesh",),
    "observations": (
        "AgentPose",
        "ClassInfo",
        "Detection",
        "Detections",
        "LabelSpace",
        "RgbdImage",
        "RobotDescription",
        "Scan",
        "Transform",
    ),
    "occupancy": ("OccupancyMap",),
    "octomap": ("read_octomap",),
    "planes": ("Plane", "PlaneMap", "extract_planes"),
    "semantics": ("SemanticMap",),
    "tsdf": ("TsdfMap",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "SE3",
    "AgentPose",
    "CameraIntrinsics",
    "Changed",
    "ClassInfo",
    "DatasetError",
    "Detection",
    "Detections",
    "EsdfMap",
    "FrameTree",
    "InstanceMap",
    "InvalidObservation",
    "InvalidParameter",
    "LabelSpace",
    "LayeredMap",
    "MapLayer",
    "MappingError",
    "Mesh",
    "OccupancyMap",
    "Plane",
    "PlaneMap",
    "PoseUnavailable",
    "RgbdImage",
    "RobotDescription",
    "Scan",
    "SemanticMap",
    "Transform",
    "TsdfMap",
    "extract_planes",
    "open_dataset",
    "read_octomap",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value
