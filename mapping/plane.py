"""What is known of a plane: its bounded shape, its cheap measures, and how planes changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Plane:
    """A bounded piece of a plane: normal·p = offset for its points p [m] in map.

    normal   : (3,) unit, towards free space        offset : [m]
    centroid : (3,) [m] mean of its samples
    rings    : borders (K, 3) [m], not closed: of each part the outer one, counter-clockwise seen from free space, then
               its holes, clockwise; the largest part first
    area_m2  : covered area        z_min, z_max : [m]        width_m : its extent along the horizontal in its plane
    box_center, box_axes, box_size : the rectangle about it: centre (3,), columns u, v, normal (3, 3), size (3,) [m]
    n_points : number of samples        rms_m : root mean square distance of the samples
    """

    id: int
    normal: Array
    offset: float
    centroid: Array
    rings: tuple[Array, ...]
    area_m2: float
    z_min: float
    z_max: float
    width_m: float
    box_center: Array
    box_axes: Array
    box_size: Array
    n_points: int
    rms_m: float

    @property
    def polygon(self) -> Array:
        """(K, 3) the outer border of its largest part."""
        return self.rings[0]


@dataclass(frozen=True, eq=False)
class PlaneSummary:
    """The measures of several planes that cost little: one row per plane of `ids` (K,).

    normal (K, 3), offset (K,), area_m2 (K,); low and high (K, 3) [m]: the axis-aligned box; width_m (K,): horizontal
    extent.
    """

    ids: NDArray[np.int64]
    normal: Array
    offset: Array
    area_m2: Array
    low: Array
    high: Array
    width_m: Array


@dataclass(frozen=True)
class PlaneChange:
    """What an update did: ids of planes that are new or changed, ids that vanished, and vanished id → merged into; and
    the blocks `moved` (K, 3) of the surface that are not as they were."""

    changed: tuple[int, ...] = ()
    deleted: tuple[int, ...] = ()
    merged: Mapping[int, int] = field(default_factory=dict)
    moved: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 3), np.int32), compare=False)
