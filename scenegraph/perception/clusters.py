"""Things that nobody named: clusters of the map become object nodes of label `object`, until a label comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.clusters import LEAST_VOXELS, LEVEL, RIM_M, ClusterChange, ClusterMap, Component, Role
from mapping.kernels import columns
from mapping.labelled import nearest_labelled
from mapping.layered import LayeredMap, MapChange
from mapping.planes import Plane, PlaneMap
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.objects import significantly_different
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

LABEL = "object"
LEAST_VIEWS = 4
"""A cluster becomes a node when so many images saw it: one more than a labelled thing needs, which goes first."""
SURE_VIEWS = 6.0
"""A cluster that was seen so often is there with a confidence of 1 − 1/e."""
SUPPORT_M2 = 0.2
"""A level surface that is no floor carries things when it is this large: a table, not a book."""
UPRIGHT = 0.3
WALL_WIDTH_M = 2.2
"""An upright plane that is wider is of a wall, though not enough of it was seen to call it one."""
FLAT_M = 0.1
FLAT_SHARE = 0.95
OF_WALL_M = (1.0, 0.6)
"""So high and wide, what lies for the most part in the plane of a wall, or in a niche of it, is of the wall: a window
that parts it, a leaf in its frame."""
NICHE_M = 0.5
LOW_VOXELS = 1.3
"""What stands out of a wall or ceiling by less, in this share of its points, is of it, two voxels at least; what rises
above a floor by less lies on it as a rug does."""
BESIDE_VOXELS = 1.5
"""Surface so near what has a label is of it."""
TAKES_SHARE = 0.25
TAKES_SIDES = 0.4
"""A thing with a name that covers this share of a cluster, and along each axis reaches no farther than 1 / TAKES_SIDES
of it, is what the cluster was."""
FEET_VOXELS = 3.0
"""What ends so shortly above a level plane stands on it: what lies next to a plane is the plane's."""
HIDDEN_M = 0.3
"""What a thing stands on goes on so far under it, where nobody sees it."""
GROWN_SHARE = 0.15
RESIZED_M = 0.04
"""A cluster is measured anew when its voxels became more or less by this share, or its sides moved by this much …"""
LOOK_AGAIN = 1.1
MUCH_GROWN_SHARE = 0.5
"""… and it was seen so many times as often as when it was measured last, or changed very much."""
REFRESH_NS = 5_000_000_000


class Clusters:
    """Keeps nodes in step with the clusters of a map; each id lasts as long as its component does.

    shapes, labels  of all things, by node id; those of clusters are written here too
    is_named        instance ids (N,) → (N,) bool: whether they are nodes already
    in_a_box        points (N, 3) [m] → (N,) bool: whether they lie in a box that was detected
    thing_at        a shape → the node of a thing with a name in which it lies
    """

    def __init__(
        self,
        shapes: dict[str, Shape],
        labels: dict[str, str],
        is_named: Callable[[Array], Array],
        in_a_box: Callable[[Array], Array],
        thing_at: Callable[[Shape], str | None],
    ) -> None:
        self._shapes = shapes
        self._labels = labels
        self._is_named = is_named
        self._in_a_box = in_a_box
        self._thing_at = thing_at
        self._node_of: dict[int, str] = {}
        self._measured: dict[int, Component] = {}
        self._told: dict[str, Node] = {}
        self._dismissed: set[int] = set()
        self._again: set[int] = set()

    # -- names that come later ----------------------------------------------------------------------------
    def inherit(self, clusters: ClusterMap, points: Array) -> str | None:
        """The node id of the cluster that a thing with a name is, which is the thing's from now on; of which points
        (N, 3) [m] are given."""
        if not self._node_of:
            return None
        covered = {i: n for i, n in clusters.covered(points).items() if i in self._node_of}
        best = max(covered, key=lambda i: (covered[i], -i), default=None)
        if best is None:
            return None
        cluster = clusters.components[best]
        if covered[best] < TAKES_SHARE * cluster.n_voxels:
            return None
        low, high = np.maximum(cluster.low, points.min(axis=0)), np.minimum(cluster.high, points.max(axis=0))
        shared = np.maximum(high - low, clusters.voxel_size_m)
        if (shared < TAKES_SIDES * np.ptp(points, axis=0)).any():
            return None
        clusters.look_again(points)
        node_id = self._node_of.pop(best)
        self._told.pop(node_id)
        self._measured.pop(best, None)
        self._again.add(best)
        return node_id

    # -- change -------------------------------------------------------------------------------------------
    def update(
        self,
        map_: LayeredMap,
        seen: MapChange,
        fresh: Iterable[tuple[str, Plane]],
        named: Iterable[str],
        things: Array,
        graph: SceneGraph,
        stamp_ns: int,
    ) -> tuple[GraphChanges, set[str]]:
        """The changes of the nodes, and the ids of those whose shape is new, changed or gone.

        fresh   planes that were labelled or measured anew, with their labels
        named   nodes of things with a name whose shape is new or changed: no cluster is where they are
        things  (65536,) bool: class ids that have instances
        """
        changes, reshaped = GraphChanges(), set[str]()
        clusters, planes = map_.clusters, map_.planes
        clusters.forget_planes(seen.planes.deleted)
        clusters.assign(planes, {plane.id: role_of(label, plane) for label, plane in fresh})
        if len(clusters):
            for node_id in sorted(named):
                if node_id in self._shapes:
                    clusters.look_again(self._shapes[node_id].points)
        change = clusters.update(
            planes, seen.planes.moved, stamp_ns, found=seen.bare_views > 0, views=seen.bare_views,
            named=self._naming(map_, things), in_view=seen.tsdf.blocks,
        )  # fmt: skip
        if len(seen.movers) and len(clusters):
            shown = clusters.covered(seen.movers)
            self._dismissed.update(i for i, n in shown.items() if n >= TAKES_SHARE * clusters.components[i].n_voxels)
            self._again.update(shown)
        self._follow(change, clusters, planes, graph, changes, reshaped)
        return changes, reshaped

    def _naming(self, map_: LayeredMap, things: Array) -> Callable[[Array], Array]:
        if not len(map_.semantics.block_ijk):
            return self._in_a_box

        def named(points: Array) -> Array:
            centres, near = nearest_labelled(points, map_.semantics, BESIDE_VOXELS * map_.tsdf.voxel_size_m)
            found = np.zeros(len(points), np.bool_)
            labels, _ = map_.semantics.query(centres)
            found[near] = ((labels > 0) & ~things[labels]) | self._is_named(map_.instances.query(centres))
            return found | self._in_a_box(points)

        return named

    def _follow(
        self,
        change: ClusterChange,
        clusters: ClusterMap,
        planes: PlaneMap,
        graph: SceneGraph,
        changes: GraphChanges,
        reshaped: set[str],
    ) -> None:
        for lost, kept in sorted(change.merged.items()):
            if lost in self._node_of and kept not in self._node_of:
                self._node_of[kept] = self._node_of.pop(lost)  # the other had no node yet: the node lives on
                self._measured.pop(kept, None)
        self._dismissed.update(part for part, whole in change.split.items() if whole in self._dismissed)
        touched = {*change.touched, *change.seen, *self._again}
        self._again.clear()
        for component_id in sorted(touched):
            component = clusters.components.get(component_id)
            heir = self._node_of.get(change.merged.get(component_id, 0))
            if component is None or not clusters.is_thing(component) or component_id in self._dismissed:
                self._bury(component_id, heir, component is None, changes, reshaped)
            elif component_id in self._node_of or component.views >= LEAST_VIEWS:
                self._refresh(component, clusters, planes, graph, changes, reshaped)

    def _bury(self, component_id: int, heir: str | None, gone: bool, changes: GraphChanges, reshaped: set[str]) -> None:
        self._measured.pop(component_id, None)
        node_id = self._node_of.pop(component_id, None)
        if gone:
            self._dismissed.discard(component_id)
        if node_id is None:
            return
        shape = self._shapes.get(node_id)
        heir = heir or (None if shape is None else self._thing_at(shape))
        self._drop(node_id)
        reason = "the same thing as another" if heir else "no longer seen" if gone else "found to be no single thing"
        changes.delete_node(node_id, reason, became=heir)
        reshaped.add(node_id)

    def _drop(self, node_id: str) -> None:
        self._told.pop(node_id, None)
        self._shapes.pop(node_id, None)
        self._labels.pop(node_id, None)

    def _refresh(
        self,
        component: Component,
        clusters: ClusterMap,
        planes: PlaneMap,
        graph: SceneGraph,
        changes: GraphChanges,
        reshaped: set[str],
    ) -> None:
        node_id = self._node_of.get(component.id)
        shape = None if node_id is None else self._shapes.get(node_id)
        if self._changed(component, clusters.voxel_size_m):
            measured = shape_of(component.id, clusters, planes)
            if measured is None or lies_flat(measured.points, component.id, clusters, planes):
                self._bury(component.id, None, False, changes, reshaped)
                self._measured[component.id] = copy(component)
                return
            self._measured[component.id] = copy(component)
            if node_id is None:
                node_id = self._node_of[component.id] = _name(component.id, graph)
                self._labels[node_id] = LABEL
            if shape is None or significantly_different(shape, measured):
                self._shapes[node_id] = shape = measured
                reshaped.add(node_id)
        if node_id is None or shape is None:
            return
        confidence = round(float(1.0 - np.exp(-component.views / SURE_VIEWS)), 1)
        told = self._told.get(node_id)
        if (
            told is None
            or node_id in reshaped
            or told.confidence != confidence
            or component.last_seen_ns - told.last_seen_ns >= REFRESH_NS
        ):
            self._told[node_id] = node = Node(
                id=node_id,
                layer="object",
                label=LABEL,
                position=shape.box.center,
                box=shape.box,
                confidence=confidence,
                first_seen_ns=component.first_seen_ns,
                last_seen_ns=component.last_seen_ns,
                attributes={"voxels": len(shape.points), "views": component.views},
            )
            changes.put(node)

    def _changed(self, component: Component, voxel_size_m: float) -> bool:
        known = self._measured.get(component.id)
        if known is None:
            return True
        grown = abs(component.n_voxels - known.n_voxels) / known.n_voxels
        if grown < MUCH_GROWN_SHARE and component.views < LOOK_AGAIN * known.views:
            return False
        moved = max(np.abs(component.low - known.low).max(), np.abs(component.high - known.high).max())
        return bool(grown > GROWN_SHARE or moved > max(1.5 * voxel_size_m, RESIZED_M))

    # -- what an operator states --------------------------------------------------------------------------
    def forget(self, node_id: str) -> set[str]:
        """Give up the cluster behind a node, for as long as it lasts; returns the ids whose shape is gone."""
        for component_id, name in self._node_of.items():
            if name == node_id:
                del self._node_of[component_id]
                self._measured.pop(component_id, None)
                self._dismissed.add(component_id)
                self._drop(node_id)
                return {node_id}
        return set()

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """Which component is which node, and which are to be none, as JSON values."""
        return {"nodes": [[i, name] for i, name in self._node_of.items()], "dismissed": sorted(self._dismissed)}

    def restore(
        self, document: Mapping[str, Any], map_: LayeredMap, structure: Mapping[int, str], graph: SceneGraph
    ) -> None:
        """Take over what `document` gave; `structure`: the label of each plane. Shapes are measured anew."""
        clusters, planes = map_.clusters, map_.planes
        roles = {i: role_of(label, planes.plane(i)) for i, label in structure.items() if i in planes}
        clusters.assign(planes, roles)
        self._dismissed = set(document["dismissed"])
        for component_id, name in document["nodes"]:
            self._node_of[component_id] = name
            self._told[name] = graph.node(name)
            self._labels[name] = LABEL
            component = clusters.components[component_id]
            self._measured[component_id] = copy(component)
            shape = shape_of(component_id, clusters, planes)
            if shape is not None:
                self._shapes[name] = shape


def role_of(label: str, plane: Plane) -> Role | None:
    """What a plane with this label is to things."""
    up = float(plane.normal[2])
    if label != "no_feature" or (abs(up) < UPRIGHT and plane.width_m >= WALL_WIDTH_M):
        return "structure"
    if up > LEVEL and plane.area_m2 >= SUPPORT_M2:
        return "support"
    return "underside" if up < -LEVEL else None


def lies_flat(points: Array, component_id: int, clusters: ClusterMap, planes: PlaneMap) -> bool:
    """Whether points (N, 3) [m] of a component stand out of a wall, floor or ceiling that is beside it by no more than
    mouldings, door frames and noise do, or are the rim of a table top, or are part of a wall."""
    voxel = clusters.voxel_size_m
    beside = clusters.planes_near(component_id, planes, "structure", "support")
    normals, offsets = planes.equations(beside)
    above = points @ normals.T.astype(np.float32) - offsets.astype(np.float32)
    raised = np.array([clusters.role(i) == "support" for i in beside], np.bool_)
    low = np.where(raised, planes.tolerance_m, LOW_VOXELS * voxel)
    most = np.where(normals[:, 2] > LEVEL, low, max(FLAT_M, 2.0 * voxel))
    behind = above.min(axis=0) > -(most + RIM_M + voxel)
    if bool((behind & ((above < most).mean(axis=0) >= FLAT_SHARE)).any()):
        return True
    walls = np.flatnonzero(~raised & (np.abs(normals[:, 2]) < UPRIGHT) & (above.min(axis=0) > -NICHE_M))
    if np.ptp(points[:, 2]) < OF_WALL_M[0] or not len(walls):
        return False
    along = normals[walls, :2][:, ::-1] * (-1.0, 1.0)
    wide = np.ptp(points[:, :2] @ along.T.astype(np.float32), axis=0) >= OF_WALL_M[1]
    walls = walls[wide & ((above[:, walls] < most[walls]).mean(axis=0) >= 0.5)]
    if not len(walls):
        return False
    _, facing = clusters.surface(component_id, planes)  # what stands behind the wall's other side looks away
    return bool(((facing @ normals[walls].T.astype(np.float32) > UPRIGHT).mean(axis=0) >= 0.5).any())


def shape_of(component_id: int, clusters: ClusterMap, planes: PlaneMap) -> Shape | None:
    """The shape of a component, down to what it stands on; None where there is too little for one, and for a ceiling of
    which too little was seen to call it one."""
    points, normals = clusters.surface(component_id, planes)
    if not len(points) or normals[:, 2].mean() < -LEVEL:
        return None
    carriers = clusters.carriers(component_id, planes)
    points = grounded(points, planes, carriers, clusters.voxel_size_m) if carriers else points
    shape = Shape.trimmed(points, np.ones(len(points), np.float32), clusters.voxel_size_m)
    return None if shape is None or len(shape.points) < LEAST_VOXELS else shape


def grounded(
    points: NDArray[np.float32], planes: PlaneMap, carriers: list[int], voxel_size_m: float
) -> NDArray[np.float32]:
    """Surface points (N, 3) [m], and the feet that were left out because they lie on a plane: below the lowest point of
    every column that ends shortly above one of the planes `carriers`."""
    keys = columns.column_keys(points, voxel_size_m)
    bottoms = points[columns.column_bottoms(points, keys, np.lexsort((points[:, 2], keys)))]
    normals, offsets = planes.equations(carriers)
    above = bottoms @ normals.T - offsets
    parts = [points]
    for k, plane_id in enumerate(carriers):
        rows = np.flatnonzero((above[:, k] > 0.5 * voxel_size_m) & (above[:, k] < FEET_VOXELS * voxel_size_m))
        if len(rows):
            rows = rows[planes.near(plane_id, bottoms[rows], HIDDEN_M, np.inf)]
            parts.append((bottoms[rows] - above[rows, k, None] * normals[k]).astype(np.float32))
    return np.concatenate(parts)


def _name(component_id: int, graph: SceneGraph) -> str:
    name, again = f"object_c{component_id}", 1
    while name in graph or graph.tombstone(name) is not None:
        again += 1
        name = f"object_c{component_id}_{again}"
    return name
