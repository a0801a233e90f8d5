"""Things of which only boxes in space were detected become nodes, until there are voxels of their class."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.box_tracks import BoxTrack, BoxTracks, Sighting, UprightBox, overlap
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.objects import MOVED_M, RESIZED_M
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]

LEAST_VIEWS = 2
"""A box becomes a node when it was detected in so many messages."""
SAME_OVERLAP = 0.2
INSIDE_SHARE = 0.6
"""A thing of voxels and a box of its class are one when the thing's box overlaps it by this much, or so much of the
thing lies in it: of a large thing voxels may show one side."""
MOST_POINTS = 3000


class Boxes:
    """Keeps nodes in step with tracked boxes.

    shapes, labels  of all things, by node id; those of boxes are written here too
    structural      whether a class of that name is part of the building
    voxel_size_m    of the points that stand for a box's surface [m]
    beside_m        surface so near a box is the thing's [m]
    """

    def __init__(
        self,
        shapes: dict[str, Shape],
        labels: dict[str, str],
        structural: Callable[[str], bool],
        voxel_size_m: float,
        beside_m: float,
    ) -> None:
        self._shapes = shapes
        self._labels = labels
        self._structural = structural
        self._voxel_size_m = voxel_size_m
        self._beside_m = beside_m
        self._tracks = BoxTracks()
        self._node_of: dict[int, str] = {}
        self._drawn: dict[int, UprightBox] = {}
        self._dismissed: set[int] = set()
        self._others = GroundIndex()

    def __len__(self) -> int:
        return len(self._node_of)

    # -- voxels that come later ---------------------------------------------------------------------------
    def inherit(self, shape: Shape, label: str) -> str | None:
        """The node id of the box that a thing of voxels is, which is the thing's from now on."""
        for track_id in self._tracks.within(*shape.bounds) if self._node_of else ():
            if track_id in self._node_of and self._is(self._tracks.tracks[track_id], shape, label):
                self._drawn.pop(track_id)
                return self._node_of.pop(track_id)
        return None

    @staticmethod
    def _is(track: BoxTrack, shape: Shape, label: str) -> bool:
        if track.label != label:
            return False
        box = UprightBox(shape.box.center, shape.box.size, shape.box.yaw)
        return overlap(track.box, box) >= SAME_OVERLAP or float(track.box.holds(shape.points).mean()) >= INSIDE_SHARE

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] lie in a box that is a node, or beside it."""
        held = np.zeros(len(points), np.bool_)
        if self._node_of and len(points):
            for track_id in self._tracks.within(points.min(axis=0), points.max(axis=0), self._beside_m):
                if track_id in self._node_of:
                    held |= self._tracks.tracks[track_id].box.holds(points, self._beside_m)
        return held

    def thing_at(self, shape: Shape) -> str | None:
        """The thing of voxels, if there is one, in whose box the middle of a shape lies."""
        for node_id in self._others.within(shape.bounds, 0.0):
            other = self._shapes.get(node_id)
            if other is not None and other.box.contains(shape.box.center[None], self._beside_m)[0]:
                return node_id
        return None

    # -- change -------------------------------------------------------------------------------------------
    def update(
        self,
        sightings: Sequence[Sighting],
        reshaped: Iterable[str],
        inherited: Callable[[Array], str | None],
        graph: SceneGraph,
        stamp_ns: int,
    ) -> tuple[GraphChanges, set[str]]:
        """The changes of the nodes that detected boxes and things of voxels bring, and the ids of those whose shape is
        new, changed or gone.

        reshaped   things of voxels whose shape is new, changed or gone
        inherited  points (N, 3) [m] that fill a box → the id under which what is there was known until now
        """
        changes, mine = GraphChanges(), set[str]()
        for node_id in sorted(reshaped):
            if node_id not in self._shapes:
                self._others.remove(node_id)
                continue
            shape = self._shapes[node_id]
            self._others.put(node_id, shape.bounds)
            for track_id in self._tracks.within(*shape.bounds):
                if track_id in self._node_of and self._is(self._tracks.tracks[track_id], shape, self._labels[node_id]):
                    self._bury(track_id, "the same thing as another", node_id, changes, mine)
        for track_id in sorted(self._tracks.see(sightings, stamp_ns) - self._dismissed) if sightings else ():
            self._refresh(self._tracks.tracks[track_id], inherited, graph, changes, mine)
        return changes, mine

    def _refresh(
        self,
        track: BoxTrack,
        inherited: Callable[[Array], str | None],
        graph: SceneGraph,
        changes: GraphChanges,
        mine: set[str],
    ) -> None:
        node_id, layer = self._node_of.get(track.id), "structure" if self._structural(track.label) else "object"
        if track.views < LEAST_VIEWS or (node_id is None and self._voxels_of(track) is not None):
            return
        if node_id is not None and graph.node(node_id).layer != layer:  # a node's layer never changes: it starts anew
            self._bury(track.id, "found to be something else", None, changes, mine)
            node_id = None
        if node_id is None:
            known = inherited(filled(track.box, 2.0 * self._voxel_size_m)) if layer == "object" else None
            node_id = self._node_of[track.id] = known or _name(track.id, layer, graph)
            mine.add(node_id)
        if track.id not in self._drawn or _moved(self._drawn[track.id], track.box):
            self._drawn[track.id] = track.box
            self._shapes[node_id] = surface_of(track.box, self._voxel_size_m)
            mine.add(node_id)
        if self._labels.get(node_id) != track.label:
            self._labels[node_id] = track.label
            mine.add(node_id)
        changes.put(
            Node(
                id=node_id,
                layer=layer,
                label=track.label,
                position=track.box.center,
                box=Box.from_yaw(track.box.center, track.box.size, track.box.yaw),
                confidence=round(track.confidence, 3),
                first_seen_ns=track.first_seen_ns,
                last_seen_ns=track.last_seen_ns,
                attributes={"views": track.views},
            )
        )

    def _voxels_of(self, track: BoxTrack) -> str | None:
        """The thing of voxels that a track is, if there is one."""
        for node_id in self._others.within(track.box.bounds, 0.0):
            shape = self._shapes.get(node_id)
            if shape is not None and self._is(track, shape, self._labels[node_id]):
                return node_id
        return None

    def _bury(self, track_id: int, reason: str, became: str | None, changes: GraphChanges, mine: set[str]) -> None:
        node_id = self._drop(track_id)
        changes.delete_node(node_id, reason, became=became)
        mine.add(node_id)

    def _drop(self, track_id: int) -> str:
        node_id = self._node_of.pop(track_id)
        del self._drawn[track_id], self._shapes[node_id], self._labels[node_id]
        return node_id

    # -- what an operator states --------------------------------------------------------------------------
    def forget(self, node_id: str) -> set[str]:
        """Give up the thing behind a node, so that it does not come back by itself; returns the ids whose shape is
        gone."""
        for track_id, name in self._node_of.items():
            if name == node_id:
                self._drop(track_id)
                self._dismissed.add(track_id)
                return {node_id}
        return set()

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """Everything as JSON values."""
        return {
            "tracks": self._tracks.document(),
            "nodes": [[i, name] for i, name in self._node_of.items()],
            "dismissed": sorted(self._dismissed),
        }

    def restore(self, document: Mapping[str, Any]) -> None:
        """Take over what `document` gave, after things of voxels have their shapes."""
        for node_id, shape in self._shapes.items():
            self._others.put(node_id, shape.bounds)
        self._tracks = BoxTracks.from_document(document["tracks"])
        self._dismissed = set(document["dismissed"])
        for track_id, node_id in document["nodes"]:
            track = self._tracks.tracks[track_id]
            self._node_of[track_id], self._drawn[track_id] = node_id, track.box
            self._shapes[node_id], self._labels[node_id] = surface_of(track.box, self._voxel_size_m), track.label


def filled(box: UprightBox, step_m: float) -> NDArray[np.float64]:
    """Points (N, 3) [m] all through a box, not farther apart along its axes than `step_m`."""
    counts = np.maximum(np.ceil(box.size / step_m).astype(int), 1) + 1
    local = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    return _placed(local, box)


def surface_of(box: UprightBox, step_m: float) -> Shape:
    """The shape of a box: points on its six sides, not farther apart than `step_m` unless these would be too many."""
    x, y, z = box.size.tolist()
    step = max(step_m, float(np.sqrt(2.0 * (x * y + y * z + z * x) / MOST_POINTS)))
    ends = [np.linspace(-0.5, 0.5, max(int(np.ceil(side / step)), 1) + 1) for side in (x, y, z)]
    sides = []
    for a in range(3):
        across = [ends[b] if b != a else np.array([-0.5, 0.5]) for b in range(3)]
        sides.append(np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, 3))
    points = np.unique(np.concatenate(sides), axis=0)
    return Shape(_placed(points, box).astype(np.float32), step_m)


def _placed(local: Array, box: UprightBox) -> NDArray[np.float64]:
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    return np.asarray((local * box.size) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + box.center)


def _moved(before: UprightBox, now: UprightBox) -> bool:
    return bool(
        np.abs(now.center - before.center).max() > MOVED_M
        or np.abs(now.size - before.size).max() > RESIZED_M
        or abs(now.yaw - before.yaw) * np.hypot(*now.size[:2]) > RESIZED_M
    )


def _name(track_id: int, layer: str, graph: SceneGraph) -> str:
    first = f"{'opening' if layer == 'structure' else 'object'}_b{track_id}"
    name, again = first, 1
    while name in graph or graph.tombstone(name) is not None:
        again += 1
        name = f"{first}_{again}"
    return name
