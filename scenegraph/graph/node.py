"""Nodes of the scene graph, their oriented boxes, and the tombstones they leave."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from scenegraph.errors import InvalidGraphValue
from scenegraph.graph.values import Attributes, Identifier, PlainAttributes, Quaternion, Value, Vector3

__all__ = ["LAYERS", "Box", "Layer", "Node", "Tombstone"]

Layer = Literal["building", "storey", "room", "place", "object", "structure", "agent"]
"""The layers of the graph, from the whole to its parts."""

LAYERS: tuple[Layer, ...] = get_args(Layer)


def _identity() -> NDArray[np.float64]:
    return np.array([1.0, 0.0, 0.0, 0.0])


class Box(Value):
    """An oriented box in the `map` frame.

    center : (3,) float64 [m];  size : (3,) float64 ≥ 0 [m], edge lengths along the box's own x, y, z
    rotation_wxyz : (4,) unit quaternion that turns the box's axes into those of the map; a near-unit one is normalised
    """

    center: Vector3
    size: Vector3
    rotation_wxyz: Quaternion = Field(default_factory=_identity, validate_default=True)

    @field_validator("size")
    @classmethod
    def _not_negative(cls, size: NDArray[np.float64]) -> NDArray[np.float64]:
        if min(size.tolist()) < 0.0:
            raise ValueError(f"expected edge lengths ≥ 0, got {size.tolist()}")
        return size

    @classmethod
    def from_yaw(cls, center: Any, size: Any, yaw: float) -> Self:
        """An upright box turned by `yaw` [rad] about z."""
        return cls(center=center, size=size, rotation_wxyz=(math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3) rotation matrix; its columns are the box's axes in the map."""
        w, x, y, z = self.rotation_wxyz.tolist()
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def yaw(self) -> float:
        """Heading of the box's x axis in the map's ground plane [rad], in (−π, π]."""
        w, x, y, z = self.rotation_wxyz.tolist()
        return math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))

    def corners(self) -> NDArray[np.float64]:
        """(8, 3) corners in the map; corner `4i + 2j + k` is at the low (0) or high (1) end along the box's x, y, z."""
        return self.center + (_CORNERS * (0.5 * self.size)) @ self.rotation.T

    def contains(self, p_map: NDArray[np.floating[Any]], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) lie inside the box grown by `margin_m` on every side."""
        p_box = (np.asarray(p_map, dtype=np.float64) - self.center) @ self.rotation
        inside: NDArray[np.bool_] = np.all(np.abs(p_box) <= 0.5 * self.size + margin_m, axis=-1)
        return inside

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Box):
            return NotImplemented
        return self is other or (
            self.center.tolist() == other.center.tolist()
            and self.size.tolist() == other.size.tolist()
            and self.rotation_wxyz.tolist() == other.rotation_wxyz.tolist()
        )

    def __hash__(self) -> int:
        return hash((*self.center.tolist(), *self.size.tolist(), *self.rotation_wxyz.tolist()))


_CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class Node(Value):
    """One thing of the world: a building, storey, room, place, object, piece of structure or agent.

    id         : `[a-z][a-z0-9_]*`, kept for the thing's whole life
    layer      : one of `LAYERS`; never changes
    label      : class as shown (`coffee table`, `TV`); of structure `wall|floor|ceiling|door|…|no_feature`
    position   : (3,) float64 [m] in `map`
    box        : oriented box, or None where the extent is not known
    confidence : in [0, 1]
    first_seen_ns, last_seen_ns : stamps of the first and the latest observation
    attributes : plain JSON values: `name`, a room's `footprint` [[x, y], …] and `type`, voxel counts, …; read-only
    """

    id: Identifier
    layer: Layer
    label: str
    position: Vector3
    box: Box | None = None
    confidence: float = Field(default=1.0, ge=0.0, le=1.0, allow_inf_nan=False)
    first_seen_ns: int
    last_seen_ns: int
    attributes: PlainAttributes = Field(default_factory=Attributes)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.first_seen_ns > self.last_seen_ns:
            raise ValueError(f"first_seen_ns {self.first_seen_ns} is later than last_seen_ns {self.last_seen_ns}")
        return self

    @property
    def footprint(self) -> NDArray[np.float64] | None:
        """(k, 2) corners [m] of its outline on the ground of the map; None where its attribute is missing or none."""
        return footprint_in(self.attributes)

    def replace(self, **fields: Any) -> Node:
        """A copy with some fields changed and checked; what is unchanged is shared. The id and the layer stay."""
        fixed = fields.keys() & {"id", "layer"}
        if fixed:
            raise InvalidGraphValue(f"Node.replace: {', '.join(sorted(fixed))} of a node cannot change")
        return Node(**{**self.__dict__, **fields})

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Node):
            return NotImplemented
        return self is other or (
            self.id == other.id
            and self.last_seen_ns == other.last_seen_ns
            and self.first_seen_ns == other.first_seen_ns
            and self.layer == other.layer
            and self.label == other.label
            and self.confidence == other.confidence
            and self.position.tolist() == other.position.tolist()
            and self.box == other.box
            and self.attributes == other.attributes
        )

    def __hash__(self) -> int:
        return hash((self.id, self.last_seen_ns, *self.position.tolist()))


def footprint_in(attributes: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """What of a node's attributes is its `Node.footprint`: programs and operators may write there what they like."""
    told = attributes.get("footprint")
    if not isinstance(told, list) or len(told) < 3:
        return None
    try:
        corners = np.array([corner[:2] for corner in told], np.float64)
    except (TypeError, ValueError):
        return None
    return corners if corners.shape == (len(told), 2) and bool(np.isfinite(corners).all()) else None


class Tombstone(Value):
    """What became of a node that is no more: `became` is the id it was merged into, or None when it vanished."""

    id: Identifier
    became: Identifier | None = None
    reason: str
    stamp_ns: int
