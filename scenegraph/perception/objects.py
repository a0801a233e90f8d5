"""Things with lasting identity: instances of the map become object nodes with oriented boxes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.colors import color_name, main_color, no_colors
from mapping.instances import Instance, InstanceChange, InstanceMap
from mapping.view import DepthView
from scenegraph.errors import InvalidStatement
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.presence import Presence
from scenegraph.perception.reappearance import SAME_PLACE_M, Absent, Look, Reappearance
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

LEAST_VIEWS = 3
LEAST_VOXELS = 6
"""An instance becomes a node when it was seen in this many images and holds this many voxels …"""
GOOD_VIEWS = 1.5
"""… or in one image less, if these views [full views] agree on the class and none spoke against it."""
TWIN_SHARE = 0.7
"""Two nodes of a class are one thing when the box of the larger, a voxel wider, holds this share of the other's."""
MUCH_LARGER = 2.0
"""Of two nodes that are one thing the older stays, unless the other has so many times its voxels."""
KNOWN_S = 300.0
"""What is seen first where other things have been known for so long was brought there; before, it may have been hidden
or too far away."""
LEARNT_VIEWS = 0.15
LEARNT_VOXELS = 0.03
"""A thing is looked at closely again when so many more images showed it, as a share of those that did before, or when
so many more or fewer voxels are its own."""
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
        self.inherited: Callable[[Shape, str], str | None] = lambda *_: None
        """The id under which a thing that gets a name now has been known until now, if it has been."""
        self.presence = Presence()
        self.reappearance = Reappearance()
        self._looks: dict[str, Look] = {}
        self._node_of: dict[int, str] = {}
        self._instance_of: dict[str, int] = {}  # of things, not of structure
        self._split_from: dict[int, int] = {}
        self._measured: dict[int, tuple[int, int]] = {}  # instance id → its views and voxels when it was measured

    def is_node(self, instance_ids: Array) -> Array:
        """(N,) bool: whether the things behind these instance ids (N,) are nodes."""
        ids, which = np.unique(instance_ids, return_inverse=True)
        return np.array([i in self._node_of for i in ids.tolist()], np.bool_)[which]

    def update(
        self, instances: InstanceMap, change: InstanceChange, graph: SceneGraph, view: DepthView | None = None,
        stamp_ns: int = 0,
    ) -> tuple[GraphChanges, set[str]]:  # fmt: skip
        """The changes that bring the graph up to date, and the ids of nodes whose shape is new, changed or gone.

        view : what the image saw that brought the change, so that things are looked for where it shows their places
        """
        changes = GraphChanges()
        reshaped: set[str] = set()
        told = change.masks is None
        for lost, kept in change.merged.items():
            if self._voxels(lost) > (np.inf if told and kept in self._node_of else MUCH_LARGER * self._voxels(kept)):
                self._may_return(kept, graph, stamp_ns)
                name = self._disown(lost)
                self._bury(kept, name, changes, reshaped)
                self._own(kept, name)  # the node of the main part lives on
                reshaped.add(name)
            else:
                if not told:
                    self._may_return(lost, graph, stamp_ns)
                self._bury(lost, self._node_of.get(kept), changes, reshaped)
        self._split_from.update(change.split)
        doubted = self._look_for(instances, change, view, stamp_ns)
        for instance_id in sorted(change.touched - change.merged.keys()):
            if instance_id not in instances.instances:
                self._split_from.pop(instance_id, None)
                self._depart(instance_id, instances, graph, stamp_ns, changes, reshaped)
        for node_id in sorted(doubted):
            instance_id = self._instance_of.get(node_id, 0)  # none, when it has just become another that has gone
            if instance_id and self.presence.gone(node_id, instances.instances[instance_id].views):
                instances.release(instance_id)
                self._depart(instance_id, instances, graph, stamp_ns, changes, reshaped)
        for instance_id in sorted(change.touched - change.merged.keys()):
            if instance_id in instances.instances:
                self._refresh(instances, instance_id, graph, stamp_ns, changes, reshaped)
        for node_id in sorted(reshaped & self._instance_of.keys()):
            self._merge_twins(node_id, instances, graph, stamp_ns, changes, reshaped)
        self._recognise(instances, doubted, graph, stamp_ns, changes, reshaped)
        for node_id in sorted((doubted & self._instance_of.keys()) - reshaped):
            instance_id = self._instance_of[node_id]
            if instance_id not in change.touched and node_id in graph:
                node = graph.node(node_id)
                changes.put(node.replace(confidence=self._confidence(node_id, instances.instances[instance_id])))
        for node_id in reshaped:
            self.presence.place(node_id, self.shapes.get(node_id) if node_id in self._instance_of else None)
        return changes, reshaped

    def _voxels(self, instance_id: int) -> int:
        """Size of the node of an instance, 0 where it has none."""
        node_id = self._node_of.get(instance_id)
        return 0 if node_id is None or node_id not in self.shapes else len(self.shapes[node_id].points)

    def _look_for(
        self, instances: InstanceMap, change: InstanceChange, view: DepthView | None, stamp_ns: int
    ) -> set[str]:
        """Nodes of which an image made more or less sure by being looked for."""
        if view is None:
            return set()
        shown = () if change.masks is None else np.unique(change.masks.instance).tolist()
        known = instances.instances
        sure = [i for i in shown if i in known and known[i].views >= LEAST_VIEWS]

        def behind(node_id: str) -> int:
            instance_id = self._instance_of.get(node_id, 0)
            return instance_id if instance_id in known else 0

        missed, found = self.presence.look(view, change.masks, behind, sure, stamp_ns, self._colors_of)
        return missed | found

    def _colors_of(self, node_id: str) -> Array:
        look = self._looks.get(node_id)
        return no_colors() if look is None else look.colors

    def _may_return(self, instance_id: int, graph: SceneGraph, stamp_ns: int) -> None:
        """What becomes part of another and was not seen itself for long may have gone: the other lies in its place,
        or is what it lay on."""
        node_id = self._node_of.get(instance_id, "")
        if node_id in graph and stamp_ns - graph.node(node_id).last_seen_ns > KNOWN_S * 1e9:
            self._remember(node_id, graph, stamp_ns)

    def _bury(self, lost: int, kept: str | None, changes: GraphChanges, reshaped: set[str]) -> None:
        """The node of an instance is no more: it was another's, or is of another layer now."""
        if lost in self._node_of:
            node_id = self._disown(lost)
            self._drop(node_id)
            reason = "the same thing as another" if kept else "part of the building or not"
            changes.delete_node(node_id, reason, became=kept)
            reshaped.add(node_id)

    def _depart(
        self, instance_id: int, instances: InstanceMap, graph: SceneGraph, stamp_ns: int, changes: GraphChanges,
        reshaped: set[str],
    ) -> None:  # fmt: skip
        """The thing of an instance is where it was no more."""
        if instance_id not in self._node_of:
            return
        node_id = self._disown(instance_id)
        self._remember(node_id, graph, stamp_ns)
        self._drop(node_id)
        self.presence.place(node_id, None)
        reshaped.add(node_id)
        changes.delete_node(node_id, "no longer seen")

    def _remember(self, node_id: str, graph: SceneGraph, stamp_ns: int) -> None:
        """Keep in mind how a thing looked, in case it comes back."""
        look = self._looks.get(node_id)
        if node_id in graph and look is not None and graph.node(node_id).layer == "object":
            self.reappearance.leave(graph.node(node_id), look, stamp_ns)

    def _recognise(
        self, instances: InstanceMap, doubted: set[str], graph: SceneGraph, stamp_ns: int, changes: GraphChanges,
        reshaped: set[str],
    ) -> None:  # fmt: skip
        """Look anew at who the newcomers are of which something was learnt: how they look, or who has gone."""
        put = {step.id: step for step in changes.steps if isinstance(step, Node)}
        new = self.reappearance.newcomers
        learnt = {self.labels[i] for i in put.keys() & new.keys() if i in self.labels}
        learnt |= {graph.node(i).label for i in (reshaped - self.shapes.keys()) | doubted if i in graph}
        for label in sorted(learnt):
            came = [i for i in new if self.labels.get(i) == label and i in self._instance_of]
            if not came:
                continue
            suspects = [
                (graph.node(i), self._looks[i])
                for i in sorted(self.presence.suspects() - new.keys())
                if self.labels.get(i) == label and i in graph and i in self._instance_of
            ]
            now = {i: put[i] if i in put else graph.node(i) for i in came}
            there = graph.n_labelled(label) - sum(i in graph and new[i].was is None for i in came)
            settled = self.reappearance.settle([(now[i], self._looks[i]) for i in came], suspects, stamp_ns, there)
            if settled:
                self._rename(settled, now, instances, graph, stamp_ns, changes, reshaped)

    def _rename(
        self, settled: Mapping[str, Absent | None], now: Mapping[str, Node], instances: InstanceMap, graph: SceneGraph,
        stamp_ns: int, changes: GraphChanges, reshaped: set[str],
    ) -> None:  # fmt: skip
        """Newcomers live on as the things that they turned out to be; None: as themselves."""
        taken = {was.node.id for was in settled.values() if was is not None}
        for node_id in sorted((taken & self._instance_of.keys()) - settled.keys()):
            instances.release(self._instance_of[node_id])
            self._disown(self._instance_of[node_id])
            self._drop(node_id)
            self.presence.place(node_id, None)
        parts = {i: (self._instance_of[i], self.shapes[i], self._looks[i], self.labels[i]) for i in settled}
        arrivals = {i: self.reappearance.newcomers[i] for i in settled}
        for node_id, was in settled.items():
            self._disown(parts[node_id][0])
            self._drop(node_id)
            reshaped.add(node_id)
            mistaken = arrivals[node_id].was
            if mistaken is None:
                changes.delete_node(node_id, "the same thing, moved", became=None if was is None else was.node.id)
            elif node_id not in taken:
                self.reappearance.absent[node_id] = mistaken
                changes.delete_node(node_id, "it was taken for another")
        for node_id, was in settled.items():
            instance_id, shape, look, label = parts[node_id]
            node = Node(
                id=self._name(instance_id, False, graph),
                layer="object",
                label=label,
                position=now[node_id].position,
                box=now[node_id].box,
                first_seen_ns=arrivals[node_id].came_ns,
                last_seen_ns=now[node_id].last_seen_ns,
                attributes={k: v for k, v in now[node_id].attributes.items() if k in ("voxels", "views", "seen_color")},
            )
            if was is not None:
                node = now_at(was.node, node, stamp_ns)
            self.shapes[node.id], self._looks[node.id], self.labels[node.id] = shape, look, label
            self._own(instance_id, node.id)
            self.reappearance.know(node.id, replace(arrivals[node_id], was=was))
            reshaped.add(node.id)
            changes.put(node.replace(confidence=self._confidence(node.id, instances.instances[instance_id])))

    def _merge_twins(
        self, node_id: str, instances: InstanceMap, graph: SceneGraph, stamp_ns: int, changes: GraphChanges,
        reshaped: set[str],
    ) -> None:  # fmt: skip
        """Make a thing and others of its class one where they interpenetrate, unless images showed them side by side;
        the one that was known first stays. Where one came to the place of another, that has gone."""
        shape = self.shapes.get(node_id)
        if shape is None:
            return
        for other in sorted(self.presence.near(shape.box.center)):
            if node_id not in self._instance_of:
                return  # it was the younger of two
            if other == node_id or other not in self._instance_of or self.labels[other] != self.labels[node_id]:
                continue
            theirs = self.shapes[other]
            small, large = (shape, theirs) if len(shape.points) <= len(theirs.points) else (theirs, shape)
            if large.box.contains(small.points, large.voxel_size_m).mean() < TWIN_SHARE:
                continue
            one, two = self._instance_of[node_id], self._instance_of[other]
            gone = instances.replaced(one, two)
            if gone:
                instances.release(gone)
                self._depart(gone, instances, graph, stamp_ns, changes, reshaped)
            if gone or instances.were_apart(one, two):
                continue
            kept, lost = min(one, two), max(one, two)
            instances.join(kept, lost)
            lost_id = self._node_of[lost]
            self._may_return(lost, graph, stamp_ns)
            self._bury(lost, self._node_of[kept], changes, reshaped)
            self.presence.place(lost_id, None)

    def _refresh(
        self, instances: InstanceMap, instance_id: int, graph: SceneGraph, stamp_ns: int, changes: GraphChanges,
        reshaped: set[str],
    ) -> None:  # fmt: skip
        instance = instances.instances[instance_id]
        if not well_seen(instance):
            return
        node_id = self._node_of.get(instance_id)
        shape = self._measure(instance, node_id, instances)
        if shape is None:
            self._depart(instance_id, instances, graph, stamp_ns, changes, reshaped)
            return
        label = self._class_name(instance.label)
        structural = self._structural(label)
        if node_id is not None and structural != (graph.node(node_id).layer == "structure"):
            self._bury(instance_id, None, changes, reshaped)  # a node's layer never changes: it starts anew
            node_id = None
        before = None if node_id is None else self.shapes.get(node_id)
        if before is not None and (shape is before or not significantly_different(before, shape)):
            shape = before
        elif node_id is not None:
            reshaped.add(node_id)
        name = node_id or (None if structural else self.inherited(shape, label))
        name = name or self._name(instance_id, structural, graph)
        first_seen_ns = instance.first_seen_ns
        if node_id is not None and node_id in graph:
            first_seen_ns = min(first_seen_ns, graph.node(node_id).first_seen_ns)
        node = Node(
            id=name,
            layer="structure" if structural else "object",
            label=label,
            position=shape.box.center,
            box=shape.box,
            confidence=self._confidence(name, instance),
            first_seen_ns=first_seen_ns,
            last_seen_ns=instance.last_seen_ns,
            attributes=_seen_of(shape, instance),
        )
        look = Look.of(node, instance.colors)
        if node_id is None:
            node = self._arrive(node, instance_id, graph, stamp_ns)
            reshaped.add(node.id)
        if self.labels.get(node.id) != label:
            reshaped.add(node.id)
        self.shapes[node.id], self.labels[node.id], self._looks[node.id] = shape, label, look
        changes.put(node)

    def _measure(self, instance: Instance, node_id: str | None, instances: InstanceMap) -> Shape | None:
        """The shape of an instance; that of its node where little was learnt since. None: it has too few voxels."""
        known = None if node_id is None else self.shapes.get(node_id)
        views, voxels = self._measured.get(instance.id, (0, 0))
        held = instances.n_voxels(instance.id)
        if (
            known is not None
            and instance.views - views <= LEARNT_VIEWS * views
            and abs(held - voxels) <= LEARNT_VOXELS * voxels
        ):
            return known
        self._measured[instance.id] = (instance.views, held)
        points, weights = instances.points(instance.id)
        return Shape.trimmed(points, weights, instances.voxel_size_m) if len(points) >= LEAST_VOXELS else None

    def _arrive(self, node: Node, instance_id: int, graph: SceneGraph, stamp_ns: int) -> Node:
        """A new node; it may be part of another, or a thing that was known before."""
        fresh = node.layer == "object" and node.id not in graph  # and not one that had no name until now
        if fresh and (self._was_known(node, graph) or self.reappearance.misses(node.label)):
            self.reappearance.arrive(node, stamp_ns)
        whole = self._node_of.get(self._split_from.pop(instance_id, 0))
        if whole is not None:
            node = node.replace(attributes={**node.attributes, "split_from": whole})
        self.labels[node.id] = node.label
        self._own(instance_id, node.id)
        return node

    def _was_known(self, node: Node, graph: SceneGraph) -> bool:
        """Whether what is about a node was seen long before it: then it came there, and was not just found."""
        beside = [n for n in self.presence.near(node.position) if n in graph and n != node.id]
        since_ns = min((graph.node(n).first_seen_ns for n in beside), default=node.first_seen_ns)
        return node.first_seen_ns - since_ns >= KNOWN_S * 1e9

    def _confidence(self, node_id: str, instance: Instance) -> float:
        seen = instance.label_share * min(1.0, instance.views / 5.0)
        return round(seen * self.presence.faith(node_id), 3)

    def _own(self, instance_id: int, node_id: str) -> None:
        """Name an instance; the label of the node is known by now."""
        self._node_of[instance_id] = node_id
        if not self._structural(self.labels[node_id]):
            self._instance_of[node_id] = instance_id

    def _disown(self, instance_id: int) -> str:
        node_id = self._node_of.pop(instance_id)
        self._measured.pop(instance_id, None)
        self._instance_of.pop(node_id, None)
        return node_id

    def _drop(self, node_id: str) -> None:
        for about in (self.shapes, self.labels, self._looks, self.reappearance.newcomers):
            about.pop(node_id, None)

    # -- what an operator states --------------------------------------------------------------------------
    def forget(self, node_id: str, instances: InstanceMap) -> set[str]:
        """Give up the thing behind a node, so that it does not come back by itself; returns the ids whose shape is
        gone."""
        for instance_id, name in list(self._node_of.items()):
            if name == node_id:
                instances.forget(instance_id)
                self._disown(instance_id)
                self._drop(node_id)
                self.presence.place(node_id, None)
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
    def document(self) -> dict[str, Any]:
        """[instance id, node id] of all nodes, doubts, and what has gone."""
        return {
            "nodes": [[instance_id, name] for instance_id, name in self._node_of.items()],
            "doubts": self.presence.document(),
            "reappearance": self.reappearance.document(),
        }

    def restore(self, document: Mapping[str, Any], instances: InstanceMap, graph: SceneGraph) -> None:
        """Take over what `document` gave; shapes are measured anew."""
        for instance_id, name in document["nodes"]:
            node = graph.node(name)
            self.labels[name] = node.label
            self._own(instance_id, name)
            points, weights = instances.points(instance_id)
            shape = Shape.trimmed(points, weights, instances.voxel_size_m)
            if shape is not None:
                self.shapes[name] = shape
            self._looks[name] = Look.of(node, instances.instances[instance_id].colors)
            if name in self._instance_of:
                self.presence.place(name, shape)
        self.presence.restore(document["doubts"])
        self.reappearance.restore(document["reappearance"])

    @staticmethod
    def _name(instance_id: int, structural: bool, graph: SceneGraph) -> str:
        prefix = "opening" if structural else "object"
        name, again = f"{prefix}_{instance_id}", 1
        while graph.tombstone(name) is not None:
            again += 1
            name = f"{prefix}_{instance_id}_{again}"
        return name


def well_seen(instance: Instance) -> bool:
    """Whether an instance was seen often enough to be believed: fewer views will do where all are good and agree."""
    if instance.views >= LEAST_VIEWS:
        return True
    full = sum(instance.labels.values())
    return (
        instance.views == LEAST_VIEWS - 1 and instance.doubts == 0 and len(instance.labels) == 1 and full >= GOOD_VIEWS
    )


def _seen_of(shape: Shape, instance: Instance) -> dict[str, Any]:
    """How much of a thing was seen, and the colour that it mainly shows."""
    color = main_color(instance.colors)
    shown = {} if color is None else {"seen_color": color_name(*color)}
    return {"voxels": len(shape.points), "views": instance.views, **shown}


def now_at(known: Node, now: Node, stamp_ns: int) -> Node:
    """A node that was known before, as and where its thing is now; with where it was, if it was moved."""
    attributes = {**known.attributes, **now.attributes}
    if np.linalg.norm(now.position - known.position) > SAME_PLACE_M:
        attributes |= {"moved_ns": stamp_ns, "moved_from": known.position.round(3).tolist()}
    else:
        attributes["returned_ns"] = stamp_ns
    return known.replace(
        label=now.label, position=now.position, box=now.box, last_seen_ns=now.last_seen_ns, attributes=attributes
    )


def significantly_different(a: Shape, b: Shape) -> bool:
    """Whether two shapes of one thing differ by more than noise."""
    if abs(len(b.points) - len(a.points)) > GROWN_SHARE * len(a.points):
        return True
    (a_low, a_high), (b_low, b_high) = a.bounds, b.bounds
    moved = np.abs(0.5 * (a_low + a_high - b_low - b_high)).max()
    resized = np.abs((a_high - a_low) - (b_high - b_low)).max()
    return bool(moved > MOVED_M or resized > RESIZED_M)
