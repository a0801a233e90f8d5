"""Nodes moved as rigid bodies: places, boxes, and the attributes that are geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mapping.geometry import SE3
from scenegraph.graph import Box, Node

__all__ = ["moved", "moved_box"]

_HEIGHTS = ("floor_z", "ceiling_z")
_DIGITS = 6  # of corners, in metres: far below what is measured


def moved_box(box: Box, T: SE3) -> Box:
    """The box carried along by a motion of the map."""
    turned = T @ SE3.from_quaternion(box.rotation_wxyz, box.center)
    return Box(center=turned.translation, size=box.size, rotation_wxyz=turned.quaternion_wxyz)


def moved(node: Node, T: SE3) -> Node:
    """The node carried along: position, box, and of its attributes the footprint, polygon, plane, heights and velocity.

    The box of a room or storey stays upright along the axes of the map and is the one about what it held. A motion that
    is none gives the node itself.
    """
    if T.isclose(SE3.identity(), atol=0.0):
        return node
    position = T @ node.position
    box = node.box
    if box is not None:
        box = _about(moved_box(box, T)) if node.layer in ("room", "storey", "building") else moved_box(box, T)
    attributes = {name: _moved_attribute(name, value, node, T) for name, value in node.attributes.items()}
    return node.replace(position=position, box=box, attributes=attributes)


def _about(box: Box) -> Box:
    """The box along the axes of the map about another."""
    corners = box.corners()
    low, high = corners.min(axis=0), corners.max(axis=0)
    return Box(center=0.5 * (low + high), size=high - low)


def _moved_attribute(name: str, value: Any, node: Node, T: SE3) -> Any:
    try:
        if name == "footprint":
            height = float(node.attributes.get("floor_z", node.position[2]))
            corners = np.array([(x, y, height) for x, y in value], np.float64)
            return np.round((T @ corners)[:, :2], _DIGITS).tolist()
        if name == "polygon":
            return [np.round(T @ np.array(ring, np.float64), _DIGITS).tolist() for ring in value]
        if name == "boundary":
            return np.round(T @ np.array(value, np.float64).reshape(-1, 3), _DIGITS).tolist()
        if name == "normal":
            return np.round(T.rotation @ np.array(value, np.float64), _DIGITS).tolist()
        if name == "velocity":
            return np.round(T.rotation @ np.array(value, np.float64), _DIGITS).tolist()
        if name == "offset" and "normal" in node.attributes:
            normal = T.rotation @ np.array(node.attributes["normal"], np.float64)
            return round(float(value + normal @ T.translation), _DIGITS)
        if name in _HEIGHTS:
            return round(float((T @ np.array((*node.position[:2], value), np.float64))[2]), _DIGITS)
    except (TypeError, ValueError):
        return value  # of the same name, but not the geometry that we write
    return value


def yaw_of(T: SE3) -> float:
    """The heading of a motion [rad], in (−π, π]."""
    return math.atan2(float(T.rotation[1, 0]), float(T.rotation[0, 0]))
