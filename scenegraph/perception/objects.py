"""Things with lasting identity: instances of the map become object nodes with oriented boxes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.instances import InstanceChange, InstanceMap
from scenegraph.errors import InvalidStatement
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

LEAST_VIEWS = 3
LEAST_VOXELS = 6
"""An instance becomes a node when it was seen in this many images and holds this many voxels."""
MOVED_M = 0.01
RESIZED_M = 0.02
GROWN_SHARE = 0.10
"""A node is measured anew when its box moved or changed by this much, or its voxels by this share; less is noise."""


class Objects:
    """Keeps object nodes (and doors and windows, which are structure) in step with the instance map.

    class_name    class id → class name as shown
    structural    whether a class of that name is part of the building
    """

    def __init__(self, class_name: Callable[[int], str], structural: Callable[[str], bool]) -> None:
        self._class_name = class_name
        self._structural = structural
        self.shapes: dict[str, Shape] = {}
        self.labels: dict[str, str] = {}
        self.inherited: Callable[[Shape], str | None] = lambda _: None
        """The id under which a thing that gets a name now has been known until now, if it has been."""
        self._node_of: dict[int, str] = {}

    def is_node(self, instance_ids: Array) -> Array:
        """(N,) bool: whether the things behind these instance ids (N,) are nodes."""
        return np.isin(instance_ids, list(self._node_of))

    def update(
        self, instances: InstanceMap, change: InstanceChange, graph: SceneGraph
    ) -> tuple[GraphChanges, set[str]]:
        """The changes that bring the graph up to date, and the ids of nodes whose shape is new, changed or gone."""
        changes = GraphChanges()
        reshaped: set[str] = set()
        for lost, kept in change.merged.items():
            if lost in self._node_of and kept not in self._node_of:
                self._node_of[kept] = self._node_of.pop(lost)  # the older instance had no node yet: the node lives on
                reshaped.add(self._node_of[kept])
            else:
                self._bury(lost, self._node_of.get(kept), changes, reshaped)
        for instance_id in sorted(change.touched - change.merged.keys()):
            if instance_id not in instances.instances:
                self._bury(instance_id, None, changes, reshaped)
                continue
            self._refresh(instances, instance_id, graph, changes, reshaped)
        return changes, reshaped

    def _bury(self, lost: int, kept: str | None, changes: GraphChanges, reshaped: set[str]) -> None:
        node_id = self._node_of.pop(lost, None)
        if node_id is not None:
            self.shapes.pop(node_id, None)
            self.labels.pop(node_id, None)
            changes.delete_node(node_id, "the same thing as another" if kept else "no longer seen", became=kept)
            reshaped.add(node_id)

    def _refresh(
        self, instances: InstanceMap, instance_id: int, graph: SceneGraph, changes: GraphChanges, reshaped: set[str]
    ) -> None:
        instance = instances.instances[instance_id]
        if instance.views < LEAST_VIEWS:
            return
        points, weights = instances.points(instance_id)
        shape = Shape.trimmed(points, weights, instances.voxel_size_m) if len(points) >= LEAST_VOXELS else None
        node_id = self._node_of.get(instance_id)
        if shape is None:
            if node_id is not None:
                self._bury(instance_id, None, changes, reshaped)
            return
        label = self._class_name(instance.label)
        structural = self._structural(label)
        if node_id is not None and structural != (graph.node(node_id).layer == "structure"):
            self._bury(instance_id, None, changes, reshaped)  # a node's layer never changes: it starts anew
            node_id = None
        if node_id is None:
            known = None if structural else self.inherited(shape)
            node_id = self._node_of[instance_id] = known or self._name(instance_id, structural, graph)
        if self.labels.get(node_id) != label:
            self.labels[node_id] = label
            reshaped.add(node_id)
        before = self.shapes.get(node_id)
        if before is None or significantly_different(before, shape):
            self.shapes[node_id] = shape
            reshaped.add(node_id)
        else:
            shape = before
        changes.put(
            Node(
                id=node_id,
                layer="structure" if structural else "object",
                label=label,
                position=shape.box.center,
                box=shape.box,
                confidence=round(instance.label_share * min(1.0, instance.views / 5.0), 3),
                first_seen_ns=instance.first_seen_ns,
                last_seen_ns=instance.last_seen_ns,
                attributes={"voxels": len(shape.points), "views": instance.views},
            )
        )

    # -- what an operator states --------------------------------------------------------------------------
    def forget(self, node_id: str, instances: InstanceMap) -> set[str]:
        """Give up the thing behind a node, so that it does not come back by itself; returns the ids whose shape is
        gone."""
        for instance_id, name in list(self._node_of.items()):
            if name == node_id:
                instances.forget(instance_id)
                del self._node_of[instance_id], self.shapes[node_id], self.labels[node_id]
                return {node_id}
        return set()

    def join(self, kept: str, lost: str, instances: InstanceMap) -> InstanceChange:
        """Make the things behind two nodes one. Raises `InvalidStatement` when one is not a thing, or both are one."""
        by_name = {name: instance_id for instance_id, name in self._node_of.items()}
        for node in (kept, lost):
            if node not in by_name:
                raise InvalidStatement(
                    f"merge: {node} is not a thing that was mapped", hint="only objects and openings can be merged"
                )
        if kept == lost:
            raise InvalidStatement(f"merge: {kept} is given twice")
        return instances.join(by_name[kept], by_name[lost])

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> list[list[Any]]:
        """[instance id, node id] of all nodes."""
        return [[instance_id, name] for instance_id, name in self._node_of.items()]

    def restore(self, document: list[list[Any]], instances: InstanceMap, graph: SceneGraph) -> None:
        """Take over what `document` gave; shapes are measured anew."""
        for instance_id, name in document:
            self._node_of[instance_id] = name
            points, weights = instances.points(instance_id)
            shape = Shape.trimmed(points, weights, instances.voxel_size_m)
            if shape is not None:
                self.shapes[name] = shape
            self.labels[name] = graph.node(name).label

    @staticmethod
    def _name(instance_id: int, structural: bool, graph: SceneGraph) -> str:
        prefix = "opening" if structural else "object"
        name, again = f"{prefix}_{instance_id}", 1
        while graph.tombstone(name) is not None:
            again += 1
            name = f"{prefix}_{instance_id}_{again}"
        return name


def significantly_different(a: Shape, b: Shape) -> bool:
    """Whether two shapes of one thing differ by more than noise."""
    if abs(len(b.points) - len(a.points)) > GROWN_SHARE * len(a.points):
        return True
    (a_low, a_high), (b_low, b_high) = a.bounds, b.bounds
    moved = np.abs(0.5 * (a_low + a_high - b_low - b_high)).max()
    resized = np.abs((a_high - a_low) - (b_high - b_low)).max()
    return bool(moved > MOVED_M or resized > RESIZED_M)
