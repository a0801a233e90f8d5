"""What may be related: the boxes of nodes, with what measuring must know of each, by row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.kernels import boxes as kernels
from scenegraph.graph import LAYERS, Attributes, NodeTable
from scenegraph.graph.node import footprint_in
from scenegraph.relating.thresholds import Thresholds

__all__ = ["OBJECT", "ROOM", "SOLID", "STRUCTURE", "Things"]

Array = NDArray[Any]

SOLID = frozenset({"wall", "floor", "ceiling", "stairs"})
"""Labels of structure that carries things and stands between them."""
OBJECT, ROOM, STRUCTURE = (LAYERS.index(name) for name in ("object", "room", "structure"))


@dataclass(frozen=True)
class Things:
    """Nodes by row.

    ids       : all different
    layer     : (n,) uint8, index into `LAYERS`
    boxed     : (n,) whether there is a box; without one, a node is a point
    solid     : (n,) whether it is structure that carries things and stands between them
    container : (n,) whether its whole box is its inside
    boxes     : of all rows
    rings     : by row of a room, the corners (k, 2) [m] of its footprint
    """

    ids: Sequence[str]
    layer: Array
    boxed: Array
    solid: Array
    container: Array
    boxes: kernels.Boxes
    rings: Mapping[int, Array]

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def of(cls, table: NodeTable, thresholds: Thresholds) -> Things:
        """Those of a table of nodes."""
        boxed = table.boxed[:, None]
        center = np.where(boxed, table.center, table.position)
        half = np.where(boxed, 0.5 * table.size, 0.0)
        axes = kernels.axes_of(np.where(boxed, table.rotation_wxyz, (1.0, 0.0, 0.0, 0.0)))
        used = set(np.unique(table.label[table.layer == OBJECT]).tolist())
        holds = [n in used and thresholds.is_container(label) for n, label in enumerate(table.labels)]
        return cls.described(
            table.ids,
            table.layer,
            table.boxed,
            np.array([label in SOLID for label in table.labels], np.bool_)[table.label],
            np.array(holds, np.bool_)[table.label],
            (center, half, axes),
            table.attributes,
        )

    @classmethod
    def described(
        cls,
        ids: Sequence[str],
        layer: Array,
        boxed: Array,
        solid_label: Array,
        container_label: Array,
        boxes: tuple[Array, Array, Array],
        attributes: Mapping[int, Attributes],
    ) -> Things:
        """Those of these columns; boxes as centres, half sizes (n, 3) [m] and axes (n, 3, 3), attributes by row."""
        described = kernels.describe(*boxes)
        rooms = np.flatnonzero((layer == ROOM) & boxed).tolist()
        return cls(
            ids=ids,
            layer=layer,
            boxed=boxed,
            solid=(layer == STRUCTURE) & solid_label & boxed,
            container=(layer == OBJECT) & container_label,
            boxes=described,
            rings={
                row: _ring(attributes.get(row), described.corners[row, : described.n_corners[row]]) for row in rooms
            },
        )


def _ring(attributes: Attributes | None, corners: Array) -> Array:
    """A room's footprint (k, 2), else the ground of its box."""
    ring = None if attributes is None else footprint_in(attributes)
    return corners if ring is None else ring
