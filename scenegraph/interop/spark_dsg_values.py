"""Spark-DSG's layers, node symbols and boxes, and ours: what its writer and its reader share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from scenegraph.graph import Box, Layer

__all__ = ["LAYERS", "NO_LABEL", "PLACE_FIELDS", "PROMOTED", "DsgLayer", "bounding_box", "box_of", "rotation"]

NO_LABEL = 2**32 - 1
"""What `semantic_label` is where there is none."""

PROMOTED = {
    "mesh_connections": "mesh_connections",
    "distance": "clearance_m",
    "boundary": "boundary",
    "semantic_class_probabilities": "class_probabilities",
}
"""Their field → the attribute of ours that holds it; the rest of their fields is kept in one attribute, `spark_dsg`."""


class DsgLayer(NamedTuple):
    """Where a layer of ours lies in theirs: number, partition, name, and the character of its node symbols."""

    number: int
    partition: int
    name: str
    symbol: str

    @property
    def key(self) -> dict[str, int]:
        return {"layer": self.number, "partition": self.partition}


LAYERS: dict[Layer, DsgLayer] = {
    "object": DsgLayer(2, 0, "OBJECTS", "O"),
    "agent": DsgLayer(2, ord("a"), "AGENTS", "a"),
    "structure": DsgLayer(2, ord("s"), "STRUCTURE", "s"),
    "place": DsgLayer(3, 0, "PLACES", "p"),
    "room": DsgLayer(4, 0, "ROOMS", "R"),
    "building": DsgLayer(5, 0, "BUILDINGS", "B"),
    "storey": DsgLayer(5, ord("t"), "STOREYS", "t"),
}


PLACE_FIELDS: dict[str, Any] = {
    "real_place": True,
    "active_frontier": False,
    "anti_frontier": False,
    "need_cleanup": False,
    "num_frontier_voxels": 0,
    "frontier_scale": [0.0, 0.0, 0.0],
    "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
}
"""What their places say of frontiers where nothing is known of any."""


def rotation(box: Box | None) -> dict[str, float]:
    """The box's rotation as they write quaternions."""
    w, x, y, z = (1.0, 0.0, 0.0, 0.0) if box is None else box.rotation_wxyz.tolist()
    return {"w": w, "x": x, "y": y, "z": z}


def bounding_box(box: Box | None) -> dict[str, Any]:
    """A box as they write it; they have no node without one, but invalid ones."""
    return {
        "type": "INVALID" if box is None else "OBB",
        "dimensions": [0.0, 0.0, 0.0] if box is None else box.size.tolist(),
        "world_P_center": [0.0, 0.0, 0.0] if box is None else box.center.tolist(),
        "world_R_center": rotation(box),
    }


def box_of(record: Mapping[str, Any]) -> Box | None:
    """The box that `bounding_box` says; None where it is invalid. An `AABB` has no rotation, whatever it says."""
    if record["type"] == "INVALID":
        return None
    turn = record["world_R_center"]
    upright = (1.0, 0.0, 0.0, 0.0)
    return Box(
        center=record["world_P_center"],
        size=record["dimensions"],
        rotation_wxyz=upright if record["type"] == "AABB" else [turn[axis] for axis in "wxyz"],
    )
