"""Planes → structure: which planes are walls, floors, ceilings and door leaves, and the nodes that say so.

Only planes that changed noticeably are measured anew, and only they and their neighbours are labelled anew, with the
planes about them as settled context.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from mapping.geometry import SE3
from mapping.planes import Plane, PlaneChange, PlaneMap, PlaneSummary
from reasoning.labelling import PlaneFacts, PlaneRelation
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.plane_relations import (
    FRONT_M,
    TALLEST_ROOM_M,
    MeasuredPlane,
    measured,
    relations_between,
)

Array: TypeAlias = NDArray[Any]

Labeller: TypeAlias = Callable[[Sequence[PlaneFacts], Sequence[PlaneRelation]], Mapping[int, str]]
"""Planes and their relations → a label for every plane, by its id."""
Evidence: TypeAlias = Callable[[Array], Mapping[str, float]]
"""Points (N, 3) [m] on a plane → class → share of the points that carry it; what carries no label is left out."""


def no_evidence(_: Array) -> Mapping[str, float]:
    """For maps without labels."""
    return {}


_HUB = 24
"""A neighbour with more relations than this (the floor of a storey) is labelled anew only when it changes itself."""
_LOOK_EVERY = 4
"""The labels on a plane that keeps its shape are looked at every so many updates that touch it."""


class Structure:
    """The structure nodes of the graph, kept up to date with a `PlaneMap`.

    noticeable  : relative change of area, extent or evidence that makes a plane be looked at again
    refresh_ns  : `last_seen_ns` of a plane that stays as it is follows in steps of this [ns]
    """

    def __init__(self, *, noticeable: float = 0.1, refresh_ns: int = 5_000_000_000) -> None:
        self.noticeable = noticeable
        self.refresh_ns = refresh_ns
        self._seen: dict[int, MeasuredPlane] = {}
        self._label: dict[int, str] = {}
        self._node: dict[int, Node] = {}
        self._between: dict[int, dict[int, list[PlaneRelation]]] = {}
        self._unsettled: set[int] = set()
        self._dismissed: set[int] = set()
        self.fresh: list[tuple[str, Plane]] = []
        """(label, plane) of the planes that the last update measured or labelled anew."""
        self._passed: dict[int, int] = {}
        self._index = GroundIndex()

    @property
    def labels(self) -> dict[int, str]:
        """Plane id → label."""
        return dict(self._label)

    def area_m2(self, plane_id: int) -> float:
        """The area of a plane when it was last measured [m²]; 0 when it never was."""
        known = self._seen.get(plane_id)
        return 0.0 if known is None else known.facts.area_m2

    def ids(self, *labels: str) -> list[int]:
        """Ids of the planes with one of these labels, ascending."""
        return sorted(i for i, label in self._label.items() if label in labels)

    def update(
        self, planes: PlaneMap, change: PlaneChange, evidence: Evidence, label: Labeller, stamp_ns: int
    ) -> GraphChanges:
        """Measure and label what changed; returns the changes of the structure nodes `plane_<id>`."""
        changes = GraphChanges()
        self.fresh = []
        active = {i for i in self._unsettled if i in self._seen}
        for plane_id in change.deleted:
            active |= self._forget(plane_id, change.merged.get(plane_id), changes)
        active -= set(change.deleted)
        self._dismissed -= set(change.deleted)
        changed = set(change.changed) - self._dismissed
        noticed = self._notice(planes, sorted(changed), evidence)
        for plane_id in noticed:
            self._relate(plane_id, planes)
        active |= set(noticed)
        self._unsettled = active  # stays so, if labelling fails
        flipped = self._relabel(active, label) if active else set()
        self._unsettled = flipped - set(noticed)
        for plane_id in sorted({*noticed, *flipped}):
            self._put(planes.plane(plane_id), plane_id in changed, stamp_ns, changes)
        for plane_id in changed - set(noticed) - flipped:
            node = self._node[plane_id]
            if stamp_ns - node.last_seen_ns >= self.refresh_ns:
                self._node[plane_id] = node = node.replace(last_seen_ns=stamp_ns)
                changes.put(node)
        return changes

    def dismiss(self, node_id: str) -> list[int]:
        """Give up the plane behind a node, for as long as it lasts; returns its id, if there is one."""
        plane_id = next((i for i, node in self._node.items() if node.id == node_id), None)
        if plane_id is None:
            return []
        self._forget(plane_id, None, GraphChanges())
        self._dismissed.add(plane_id)
        return [plane_id]

    # -- state --------------------------------------------------------------------------------------------
    @property
    def dismissed(self) -> list[int]:
        """Ids of the planes that are given up, ascending."""
        return sorted(self._dismissed)

    def document(self) -> list[list[Any]]:
        """[plane id, label, {class: share}] of all planes, as JSON values."""
        return [[i, self._label[i], dict(seen.facts.evidence)] for i, seen in sorted(self._seen.items())]

    def restore(
        self, document: Iterable[Sequence[Any]], planes: PlaneMap, graph: SceneGraph, dismissed: Iterable[int] = ()
    ) -> None:
        """Take over what `document` and `dismissed` gave; `planes` and `graph` have been restored before, shapes are
        measured anew."""
        self._dismissed = set(dismissed)
        known = {
            int(i): (str(label), evidence)
            for i, label, evidence in document
            if int(i) in planes and f"plane_{i}" in graph
        }
        summary = planes.summary(known)
        for k, (plane_id, (label, evidence)) in enumerate(known.items()):
            self._keep(replace(measured(summary, k), evidence=dict(evidence)), summary, k, planes)
            self._label[plane_id] = label
            self._node[plane_id] = graph.node(f"plane_{plane_id}")
        for plane_id in known:
            self._relate(plane_id, planes)

    # -- steps --------------------------------------------------------------------------------------------
    def _forget(self, plane_id: int, became: int | None, changes: GraphChanges) -> set[int]:
        """Drop a plane; returns its neighbours."""
        if plane_id not in self._seen:
            return set()
        neighbours = set(self._between.pop(plane_id, {}))
        for other in neighbours:
            self._between[other].pop(plane_id, None)
        self._passed.pop(plane_id, None)
        self._index.remove(str(plane_id))
        del self._seen[plane_id], self._label[plane_id], self._node[plane_id]
        reason = "its surface is no longer there" if became is None else "found to be one plane"
        changes.delete_node(f"plane_{plane_id}", reason, None if became is None else f"plane_{became}")
        return neighbours

    def _notice(self, planes: PlaneMap, ids: Iterable[int], evidence: Evidence) -> list[int]:
        """Measure the planes `ids`; returns those that changed noticeably, which are kept as they are now."""
        noticed = []
        summary = planes.summary(ids)
        for k, plane_id in enumerate(summary.ids.tolist()):
            facts = measured(summary, k)
            old = self._seen.get(plane_id)
            moved = old is None or self._moved(old.facts, facts)
            self._passed[plane_id] = self._passed.get(plane_id, 0) + 1
            if not moved and self._passed[plane_id] < _LOOK_EVERY:
                continue
            self._passed[plane_id] = 0
            facts = replace(facts, evidence=dict(evidence(planes.spread(plane_id, 300))))
            if old is not None and not moved and not self._reclassified(old.facts, facts):
                continue
            self._keep(facts, summary, k, planes)
            noticed.append(plane_id)
        return noticed

    def _keep(self, facts: PlaneFacts, summary: PlaneSummary, k: int, planes: PlaneMap) -> None:
        points = planes.spread(facts.id, 100)
        self._index.put(str(facts.id), (summary.low[k], summary.high[k]))
        self._seen[facts.id] = MeasuredPlane(
            facts, summary.normal[k], float(summary.offset[k]), summary.low[k], summary.high[k], points
        )

    def _moved(self, old: PlaneFacts, new: PlaneFacts) -> bool:
        share = self.noticeable
        if old.facing != new.facing or abs(new.area_m2 - old.area_m2) > share * old.area_m2:
            return True
        length = max(0.05, share * max(old.width_m, old.z_max - old.z_min))
        return max(abs(new.z_min - old.z_min), abs(new.z_max - old.z_max), abs(new.width_m - old.width_m)) > length

    def _reclassified(self, old: PlaneFacts, new: PlaneFacts) -> bool:
        classes = old.evidence.keys() | new.evidence.keys()
        return any(abs(old.evidence.get(c, 0.0) - new.evidence.get(c, 0.0)) > self.noticeable for c in classes)

    def _relate(self, plane_id: int, planes: PlaneMap) -> None:
        """Measure the relations of a plane to all about it."""
        for other in self._between.pop(plane_id, {}):
            self._between[other].pop(plane_id, None)
        mine: dict[int, list[PlaneRelation]] = {}
        self._between[plane_id] = mine
        a = self._seen[plane_id]
        for other in map(int, self._index.within((a.low, a.high), FRONT_M)):
            b = self._seen[other]
            level = (a.low[2] <= b.high[2] + TALLEST_ROOM_M) and (b.low[2] <= a.high[2] + TALLEST_ROOM_M)
            if other == plane_id or not level or other not in planes:
                continue
            found = relations_between(a, b, planes)
            if found:
                mine[other] = found
                self._between.setdefault(other, {})[plane_id] = found

    def _relabel(self, active: set[int], label: Labeller) -> set[int]:
        """Label the active planes and their neighbours anew; returns those whose label changed or is new."""
        free = set(active)
        for plane_id in active:
            free.update(
                o for o in self._between.get(plane_id, {}) if len(self._between[o]) <= _HUB or o not in self._label
            )
        context = {o for i in free for o in self._between.get(i, {})} - free
        facts = [self._seen[i].facts for i in sorted(free)]
        facts += [replace(self._seen[i].facts, evidence={}, given=self._label[i]) for i in sorted(context)]
        relations = [
            relation
            for i in sorted(free)
            for other, found in sorted(self._between.get(i, {}).items())
            if other not in free or i < other
            for relation in found
        ]
        labels = label(facts, relations)
        flipped = {i for i in free if self._label.get(i) != labels[i]}
        self._label.update({i: labels[i] for i in flipped})
        return flipped

    def _put(self, plane: Plane, seen_now: bool, stamp_ns: int, changes: GraphChanges) -> None:
        old = self._node.get(plane.id)
        seen = stamp_ns if old is None else max(stamp_ns, old.last_seen_ns) if seen_now else old.last_seen_ns
        box = plane_box(plane)
        node = Node(
            id=f"plane_{plane.id}",
            layer="structure",
            label=self._label[plane.id],
            position=box.center,
            box=box,
            confidence=float(1.0 - 0.5 * np.exp(-plane.area_m2)),
            first_seen_ns=seen if old is None else old.first_seen_ns,
            last_seen_ns=seen,
            attributes={
                "normal": np.round(plane.normal, 4),
                "offset": round(plane.offset, 4),
                "area_m2": round(plane.area_m2, 3),
                "polygon": [np.round(ring, 3) for ring in plane.rings],
            },
        )
        self._node[plane.id] = node
        self.fresh.append((node.label, plane))
        changes.put(node)


def plane_box(plane: Plane) -> Box:
    """The box about a plane, z up: x runs along an upright plane; that of a level plane is turned to be smallest."""
    size = plane.box_size
    u, n = plane.box_axes[:, 0], plane.box_axes[:, 2]
    if abs(n[2]) < 0.5:
        rotation = np.stack([u, -n, plane.box_axes[:, 1]], axis=1)
        return Box(
            center=plane.box_center,
            size=np.array([size[0], size[2], size[1]]),
            rotation_wxyz=SE3(rotation, np.zeros(3)).quaternion_wxyz,
        )
    ring = np.concatenate(plane.rings)
    corners = shapely.get_coordinates(shapely.oriented_envelope(shapely.MultiPoint(ring[:, :2])))
    along, across = corners[1] - corners[0], corners[2] - corners[1]
    length, width = float(np.hypot(*along)), float(np.hypot(*across))
    yaw = float(np.arctan2(along[1], along[0]))
    low, high = ring[:, 2].min(), ring[:, 2].max()
    return Box(
        center=np.array([*(0.5 * (corners[0] + corners[2])), 0.5 * (low + high)]),
        size=np.array([length, width, max(high - low, size[2])]),
        rotation_wxyz=np.array([np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]),
    )
