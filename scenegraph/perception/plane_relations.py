"""How planes stand to each other, measured: parallel, orthogonal, of equal height, one above the other.

What these relations mean for a plane's label is a rule (`rules/structure.pl`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.kernels.shapes import median
from mapping.planes import PlaneMap, PlaneSummary
from reasoning.labelling import PlaneFacts, PlaneRelation

Array: TypeAlias = NDArray[Any]


_LEVEL = float(np.cos(np.deg2rad(18.0)))  # a normal this close to the vertical: level
_UPRIGHT = float(np.sin(np.deg2rad(18.0)))
_PARALLEL = float(np.cos(np.deg2rad(6.0)))  # well-seen planes are known to a degree or two
_ORTHOGONAL = float(np.sin(np.deg2rad(6.0)))
_EQUAL_M = 0.1  # heights this close are equal
_STOREY_M = 2.3  # floors (ceilings) further apart than this belong to different storeys
_BESIDE_M = 0.4  # a wall stands this close to the border of its floor and ceiling
FRONT_M = 1.0  # furniture stands this close to the wall behind it
TALLEST_ROOM_M = 6.0


def facing(normal: Array) -> str:
    """Where a plane faces: up, down, side or oblique."""
    z = float(normal[2])
    if abs(z) >= _LEVEL:
        return "up" if z > 0.0 else "down"
    return "side" if abs(z) <= _UPRIGHT else "oblique"


@dataclass(frozen=True, eq=False)
class MeasuredPlane:
    """A plane as it was when it was last measured."""

    facts: PlaneFacts
    normal: Array
    offset: float
    low: Array
    high: Array
    points: Array


def measured(summary: PlaneSummary, k: int) -> PlaneFacts:
    return PlaneFacts(
        id=int(summary.ids[k]),
        facing=facing(summary.normal[k]),
        z_min=float(summary.low[k, 2]),
        z_max=float(summary.high[k, 2]),
        width_m=float(summary.width_m[k]),
        area_m2=float(summary.area_m2[k]),
    )


def relations_between(a: MeasuredPlane, b: MeasuredPlane, planes: PlaneMap) -> list[PlaneRelation]:
    """What the rules may know of two planes: parallel, orthogonal, equalheight, above (the first over the second).

    Level planes relate when one covers ground beside the other's, within a storey; a level and an upright plane when
    the upright one stands within `_BESIDE_M` of it; upright planes when they touch or one stands before the other.
    """
    upright = (a.facts.facing == "side") + (b.facts.facing == "side")
    if "oblique" in (a.facts.facing, b.facts.facing):
        return []
    if upright == 0:
        return _level_relations(a, b, planes)
    if upright == 2:
        return _upright_relations(a, b, planes)
    return _standing_relations(a, b, planes) if b.facts.facing == "side" else _standing_relations(b, a, planes)


def _level_relations(a: MeasuredPlane, b: MeasuredPlane, planes: PlaneMap) -> list[PlaneRelation]:
    small, large = (a, b) if a.facts.area_m2 < b.facts.area_m2 else (b, a)
    near = planes.near(large.facts.id, small.points, _BESIDE_M, TALLEST_ROOM_M)
    if not near.any():
        return []
    # measured where they are close: floors of long corridors are not quite level
    rise = median(small.points[near] @ large.normal - large.offset) / float(large.normal[2])
    pair = (a.facts.id, b.facts.id)
    found: list[PlaneRelation] = [("parallel", *pair)]
    upper, lower = (small, large) if rise > 0.0 else (large, small)
    alike = a.facts.facing == b.facts.facing
    if abs(rise) <= _EQUAL_M:
        return [*found, ("equalheight", *pair)] if alike else []
    if (alike and abs(rise) < _STOREY_M) or (upper.facts.facing == "down" and lower.facts.facing == "up"):
        return [*found, ("above", upper.facts.id, lower.facts.id)]
    return []


def _standing_relations(level: MeasuredPlane, upright: MeasuredPlane, planes: PlaneMap) -> list[PlaneRelation]:
    near = planes.near(level.facts.id, upright.points + 0.1 * upright.normal, _BESIDE_M, TALLEST_ROOM_M)
    if np.count_nonzero(near) < 0.3 * len(near):
        return []
    found: list[PlaneRelation] = [("orthogonal", level.facts.id, upright.facts.id)]
    rise = median(upright.points @ level.normal - level.offset) / float(level.normal[2])
    if level.facts.facing == "down" and rise < 0.0:
        found.append(("above", level.facts.id, upright.facts.id))
    elif level.facts.facing == "up" and rise > 0.0:
        found.append(("above", upright.facts.id, level.facts.id))
    else:
        return []
    return found


def _upright_relations(a: MeasuredPlane, b: MeasuredPlane, planes: PlaneMap) -> list[PlaneRelation]:
    small, large = (a, b) if a.facts.area_m2 < b.facts.area_m2 else (b, a)
    pair = (a.facts.id, b.facts.id)
    cosine = abs(float(a.normal @ b.normal))
    if cosine >= _PARALLEL:
        before = planes.near(large.facts.id, small.points, _BESIDE_M, FRONT_M).any()
        return [("parallel", *pair)] if before else []
    if not planes.near(large.facts.id, small.points, _BESIDE_M, _BESIDE_M).any():
        return []
    found: list[PlaneRelation] = [("orthogonal", *pair)] if cosine <= _ORTHOGONAL else []
    if found and abs(a.facts.z_max - b.facts.z_max) <= _EQUAL_M:
        found.append(("equalheight", *pair))
    return found
