"""Observations, geometry and map layers: from sensor data to metric and semantic voxels.

Each name is imported when it is first used, so that `import mapping` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapping.changes import ChangeDetector
    from mapping.collision import SweepReport, Verdict, spheres_are_free, sweep
    from mapping.conversions import (
        depth_to_points,
        mesh_to_points,
        points_to_depth,
        points_to_mesh,
        points_to_range_image,
        points_to_tsdf,
        range_image_to_points,
        register_color,
        surfels_to_points,
        tsdf_to_occupancy,
    )
    from mapping.cost import CostGrid, CostMap, CostTable, semantic_cost
    from mapping.datasets import open_dataset
    from mapping.drivable import label_points, label_range_image
    from mapping.elevation import ElevationMap, ExtendedElevationMap, HeightMap
    from mapping.errors import DatasetError, InvalidObservation, InvalidParameter, MappingError, PoseUnavailable
    from mapping.esdf import EsdfMap
    from mapping.frames import FrameTree
    from mapping.geometry import SE3, CameraIntrinsics
    from mapping.histograms import ClassHistogram, aligned_box, class_histogram
    from mapping.instances import InstanceMap
    from mapping.label_uncertainty import LabelEvidence, count_labels, published_update, sample_labels, spread_labels
    from mapping.labelled import LabelledCloud, PointLabels, labelled_cloud, labels_at, write_class_octree
    from mapping.layer import Changed, MapLayer
    from mapping.layered import LayeredMap
    from mapping.mesh import IncrementalMesh, Mesh
    from mapping.moving import MovingThings
    from mapping.multilevel import MultiLevelMap
    from mapping.object_space import ObjectSpace, space_of_mask, space_of_points, space_of_views
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
    from mapping.occupancy import OccupancyMap
    from mapping.octomap import read_octomap, write_octomap
    from mapping.octomap_tree import OctoMapTree
    from mapping.octree import Leaves
    from mapping.palette import Palette
    from mapping.planes import Plane, PlaneMap, extract_planes
    from mapping.points import PointMap
    from mapping.range_view import RangeView
    from mapping.raycast import VirtualView
    from mapping.semantics import ClassBelief, SemanticMap
    from mapping.sensors import LidarModel
    from mapping.sight import Hits
    from mapping.surfels import SurfelMap, Surfels
    from mapping.traversability import TerrainLimits, Traversability
    from mapping.tsdf import TsdfMap
    from mapping.view import DepthView

_HOMES = {
    "changes": ("ChangeDetector",),
    "histograms": (
        "ClassHistogram",
        "aligned_box",
        "class_histogram",
    ),
    "collision": (
        "SweepReport",
        "Verdict",
        "spheres_are_free",
        "sweep",
    ),
    "cost": (
        "CostGrid",
        "CostMap",
        "CostTable",
        "semantic_cost",
    ),
    "conversions": (
        "depth_to_points",
        "mesh_to_points",
        "points_to_depth",
        "points_to_mesh",
        "points_to_range_image",
        "points_to_tsdf",
        "range_image_to_points",
        "register_color",
        "surfels_to_points",
        "tsdf_to_occupancy",
    ),
    "datasets": ("open_dataset",),
    "drivable": (
        "label_points",
        "label_range_image",
    ),
    "elevation": (
        "ElevationMap",
        "ExtendedElevationMap",
        "HeightMap",
    ),
    "errors": (
        "DatasetError",
        "InvalidObservation",
        "InvalidParameter",
        "MappingError",
        "PoseUnavailable",
    ),
    "esdf": ("EsdfMap",),
    "frames": ("FrameTree",),
    "geometry": (
        "SE3",
        "CameraIntrinsics",
    ),
    "instances": ("InstanceMap",),
    "label_uncertainty": (
        "LabelEvidence",
        "count_labels",
        "published_update",
        "sample_labels",
        "spread_labels",
    ),
    "labelled": (
        "LabelledCloud",
        "PointLabels",
        "labelled_cloud",
        "labels_at",
        "write_class_octree",
    ),
    "layer": (
        "Changed",
        "MapLayer",
    ),
    "layered": ("LayeredMap",),
    "mesh": (
        "IncrementalMesh",
        "Mesh",
    ),
    "moving": ("MovingThings",),
    "multilevel": ("MultiLevelMap",),
    "object_space": (
        "ObjectSpace",
        "space_of_mask",
        "space_of_points",
        "space_of_views",
    ),
    "observations": (
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
    "occupancy": ("OccupancyMap",),
    "octomap": (
        "read_octomap",
        "write_octomap",
    ),
    "octomap_tree": ("OctoMapTree",),
    "octree": ("Leaves",),
    "palette": ("Palette",),
    "planes": (
        "Plane",
        "PlaneMap",
        "extract_planes",
    ),
    "points": ("PointMap",),
    "range_view": ("RangeView",),
    "raycast": ("VirtualView",),
    "semantics": (
        "ClassBelief",
        "SemanticMap",
    ),
    "sensors": ("LidarModel",),
    "sight": ("Hits",),
    "surfels": (
        "SurfelMap",
        "Surfels",
    ),
    "traversability": (
        "TerrainLimits",
        "Traversability",
    ),
    "tsdf": ("TsdfMap",),
    "view": ("DepthView",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "SE3",
    "AgentPose",
    "CameraIntrinsics",
    "ChangeDetector",
    "Changed",
    "ClassBelief",
    "ClassHistogram",
    "ClassInfo",
    "CorrectedPose",
    "CostGrid",
    "CostMap",
    "CostTable",
    "DatasetError",
    "DepthView",
    "Detection",
    "Detections",
    "ElevationMap",
    "EsdfMap",
    "ExtendedElevationMap",
    "FrameTree",
    "HeightMap",
    "Hits",
    "IncrementalMesh",
    "InstanceMap",
    "InvalidObservation",
    "InvalidParameter",
    "LabelEvidence",
    "LabelSpace",
    "LabelledCloud",
    "LayeredMap",
    "Leaves",
    "LidarModel",
    "MapLayer",
    "MappingError",
    "Mesh",
    "MovingThings",
    "MultiLevelMap",
    "ObjectSpace",
    "OccupancyMap",
    "OctoMapTree",
    "Palette",
    "Plane",
    "PlaneMap",
    "PointLabels",
    "PointMap",
    "PoseCorrection",
    "PoseUnavailable",
    "RangeView",
    "RgbdImage",
    "RobotDescription",
    "Scan",
    "SemanticMap",
    "SurfelMap",
    "Surfels",
    "SweepReport",
    "TerrainLimits",
    "Transform",
    "Traversability",
    "TsdfMap",
    "Verdict",
    "VirtualView",
    "aligned_box",
    "class_histogram",
    "count_labels",
    "depth_to_points",
    "extract_planes",
    "label_points",
    "label_range_image",
    "labelled_cloud",
    "labels_at",
    "mesh_to_points",
    "open_dataset",
    "points_to_depth",
    "points_to_mesh",
    "points_to_range_image",
    "points_to_tsdf",
    "published_update",
    "range_image_to_points",
    "read_octomap",
    "register_color",
    "sample_labels",
    "semantic_cost",
    "space_of_mask",
    "space_of_points",
    "space_of_views",
    "spheres_are_free",
    "spread_labels",
    "surfels_to_points",
    "sweep",
    "tsdf_to_occupancy",
    "write_class_octree",
    "write_octomap",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value
