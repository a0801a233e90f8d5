"""Nodes moved as rigid bodies: places, boxes, and the attributes that are geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import SE3
from scenegraph.graph import Box, Edge, Node
from scenegraph.graph.node import footprint_in

__all__ = ["moved", "moved_box", "moved_edge"]

_HEIGHTS = ("floor_z", "ceiling_z")
_DIGITS = 6  # of corners, in metres: far below what is measured


def moved_box(box: Box, T: SE3) -> Box:
    """The box carried along by a motion of the map."""
    turned = T @ SE3.from_quaternion(box.rotation_wxyz, box.center)
    return Box(center=turned.translation, size=box.size, rotation_wxyz=turned.quaternion_wxyz)


def moved(node: Node, T: SE3) -> Node:
    """The node carried along: position, box, and of its attributes the places, outlines, planes, heights, velocities.

    The box of a room or storey stays along the axes of the map: the one about its footprint, or about the box it had.
    A motion that is none gives the node itself.
    """
    if T.isclose(SE3.identity(), atol=0.0):
        return node
    position = T @ node.position
    attributes = {name: _moved_attribute(name, value, node, T) for name, value in node.attributes.items()}
    box = None if node.box is None else moved_box(node.box, T)
    if box is not None and node.layer in ("room", "storey", "building"):
        box = _about(box, footprint_in(attributes))
    return node.replace(position=position, box=box, attributes=attributes)


def moved_edge(edge: Edge, T: SE3, height: float) -> Edge:
    """The edge carried along: of its attributes the place `at` [x, y], which lies at this height [m]."""
    place = edge.attributes.get("at")
    try:
        x, y = _numbers(place)
    except (TypeError, ValueError):
        return edge
    if T.isclose(SE3.identity(), atol=0.0):
        return edge
    at = np.round((T @ np.array((x, y, height)))[:2], _DIGITS).tolist()
    return edge.replace(attributes={**edge.attributes, "at": at})


def _about(box: Box, footprint: NDArray[np.float64] | None) -> Box:
    """The box along the axes of the map about a footprint, where there is one, or about another box."""
    corners = box.corners()
    low, high = corners.min(axis=0), corners.max(axis=0)
    if footprint is not None:
        low[:2], high[:2] = footprint.min(axis=0), footprint.max(axis=0)
    return Box(center=0.5 * (low + high), size=high - low)


def _numbers(value: Any) -> NDArray[np.float64]:
    """Finite numbers as an array; numpy makes NaN of None. Raises `TypeError`, `ValueError`."""
    numbers = np.array(value, np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError("expected finite numbers")
    return numbers


def _moved_attribute(name: str, value: Any, node: Node, T: SE3) -> Any:
    try:
        if name == "footprint":
            height = float(node.attributes.get("floor_z", node.position[2]))
            corners = _numbers([(x, y, height) for x, y in value])
            return np.round((T @ corners)[:, :2], _DIGITS).tolist()
        if name == "polygon":
            return [np.round(T @ _numbers(ring), _DIGITS).tolist() for ring in value]
        if name in ("boundary", "trajectory"):
            return np.round(T @ _numbers(value).reshape(-1, 3), _DIGITS).tolist()
        if name == "moved_from":
            return np.round(T @ _numbers(value), _DIGITS).tolist()
        if name in ("normal", "velocity"):
            return np.round(T.rotation @ _numbers(value), _DIGITS).tolist()
        if name == "offset" and "normal" in node.attributes:
            normal = T.rotation @ _numbers(node.attributes["normal"])
            return round(float(value + normal @ T.translation), _DIGITS)
        if name in _HEIGHTS:
            return round(float((T @ _numbers((*node.position[:2], value)))[2]), _DIGITS)
    except (TypeError, ValueError):
        return value  # of the same name, but not the geometry that we write
    return value


def yaw_of(T: SE3) -> float:
    """The heading of a motion [rad], in (−π, π]."""
    return math.atan2(float(T.rotation[1, 0]), float(T.rotation[0, 0]))
