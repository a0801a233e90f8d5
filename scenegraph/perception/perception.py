"""From changed voxels to changes of the graph: structure → objects → rooms → measurements → what the rules derive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.box_tracks import Sighting
from mapping.geometry import SE3
from mapping.labelled import labels_near
from mapping.layered import LayeredMap, MapChange
from mapping.observations import AgentPose
from scenegraph.collector import collector_paused
from scenegraph.errors import InvalidStatement
from scenegraph.facts import class_atom
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion
from scenegraph.labels import Labels
from scenegraph.perception import told_rooms
from scenegraph.perception.agents import agent_node
from scenegraph.perception.boxes import Boxes
from scenegraph.perception.building import Building
from scenegraph.perception.clusters import Clusters
from scenegraph.perception.free_places import FreePlaces
from scenegraph.perception.movers import move_nodes
from scenegraph.perception.objects import Objects
from scenegraph.perception.passages import Passages
from scenegraph.perception.relations import MeasurementChange, Relations
from scenegraph.perception.rooms import Rooms
from scenegraph.perception.shapes import Shape
from scenegraph.perception.stairs import Stairs, stairs_by_rule
from scenegraph.perception.structure import Structure
from scenegraph.realigning import Corrections, alike, carry, shares_in
from scenegraph.rigid import moved
from scenegraph.statements import FORMS, Statement

if TYPE_CHECKING:
    from scenegraph.meaning import Meaning

Array: TypeAlias = NDArray[Any]

BUILDING = "building_1"
FARTHEST_UP_M = 1e4
"""No thing lies higher or lower."""
MEASURED = frozenset({
    "area_m2", "ceiling_z", "clearance_m", "floor_seen", "floor_z", "footprint", "height_m", "known_as", "moved_from",
    "moved_ns", "moving", "normal", "number", "offset", "polygon", "returned_ns", "seen_color", "speed", "split_from",
    "storey", "trajectory", "trajectory_ns", "trajectory_step_m", "traversable", "type_reason", "velocity", "views",
    "voxels", "width_m",
})  # fmt: skip
"""Attributes that perception writes and reads again; an operator sets others."""
BESIDE_VOXELS = 1.5
"""Surface of the map so near a box that was detected is the thing's."""


class Perception:
    """All that looks at the map and writes the graph; each part looks only at what changed."""

    def __init__(self, map_: LayeredMap, labels: Labels, meaning: Meaning, robot_radius_m: float) -> None:
        self._map = map_
        self._labels = labels
        self._meaning = meaning
        self.structure = Structure()
        self.objects = Objects(labels.name, meaning.is_structural)
        shapes, names = self.objects.shapes, self.objects.labels
        beside_m = BESIDE_VOXELS * map_.tsdf.voxel_size_m
        self.boxes = Boxes(shapes, names, meaning.is_structural, map_.instances.voxel_size_m, beside_m)
        self.stairs = Stairs(
            shapes, names, stairs_by_rule(meaning.knowledge), self.boxes.thing_at, self.structure.area_m2
        )
        self.clusters = Clusters(shapes, names, self.objects.is_node, self._named_otherwise, self.boxes.thing_at)
        self.objects.inherited = self._known_as
        self.rooms = Rooms()
        self.passages = Passages()
        self.free_places = FreePlaces(robot_radius_m)
        self.building = Building(map_.planes, map_.occupancy, self._storey_at)
        self.relations = Relations(meaning.is_container, meaning.near_m)

    @collector_paused()
    def perceive(
        self, seen: MapChange, graph: SceneGraph, stamp_ns: int, source: str, boxes: Sequence[Sighting] = ()
    ) -> GraphChanges:
        """Everything that follows from one observation's change of the map, and from boxes that were detected."""
        changes = self._found(graph, stamp_ns)
        structure_changes = self.structure.update(
            self._map.planes, seen.planes, self._evidence, self._meaning.label_planes, stamp_ns
        )
        changes.extend(_still_possible(structure_changes, graph))
        labelled = self.structure.fresh
        self.building.update(labelled, seen.planes.deleted)
        self.rooms.forget_planes(seen.planes.deleted)

        object_changes, reshaped = self.objects.update(self._map.instances, seen.instances, graph, seen.view, stamp_ns)
        changes.extend(object_changes)
        box_changes, reboxed = self.boxes.update(boxes, reshaped, self._cluster_at, graph, stamp_ns)
        changes.extend(box_changes)
        reshaped |= reboxed
        stairs_changes, climbed = self.stairs.update(
            self._map.planes, seen.planes.moved, self._map.tsdf.block_size_m, graph, stamp_ns
        )
        changes.extend(stairs_changes)
        reshaped |= climbed
        cluster_changes, reclustered = self.clusters.update(
            self._map, seen, labelled, reshaped, self._labels.things, graph, stamp_ns
        )
        changes.extend(cluster_changes)
        reshaped |= reclustered
        mover_changes, movers = move_nodes(self._map.moving, seen.moving, self._labels.name, graph)
        changes.extend(mover_changes)
        room_changes, moved_rooms = self.rooms.update(self._map.occupancy, seen.occupancy, labelled, graph, stamp_ns)
        changes.extend(_still_possible(room_changes, graph))

        self._connect_rooms(changes, moved_rooms, reshaped, seen.occupancy.blocks, graph, stamp_ns)
        _keep_told(changes, graph)
        measured = self.relations.update(self.objects.shapes, self.objects.labels, reshaped, self.building)
        measured.merge(self._room_shares(reshaped, moved_rooms, graph))
        for mover, node in movers.items():
            shares = {} if node is None else self.rooms.shares(node.position[None, :2], float(node.position[2]))
            measured.merge(self.relations.set_shares(mover, shares))
        touched = reshaped | moved_rooms | movers.keys()
        self._meaning.infer(changes, measured, touched, graph, source, stamp_ns, _in_view(changes, stamp_ns))
        return changes

    def place_agent(self, observation: AgentPose, graph: SceneGraph) -> GraphChanges:
        """The node of a robot at its new pose, and the room that it is in."""
        changes = self._found(graph, observation.stamp_ns)
        agent = f"agent_{observation.robot}"
        known = graph.node(agent) if agent in graph else None
        changes.put(agent_node(observation, known))
        position = observation.T_map_base.translation
        shares = self.rooms.shares(position[None, :2], float(position[2]))
        measured = self.relations.set_shares(agent, shares)
        source = f"{observation.robot}/pose@{observation.stamp_ns}"
        self._meaning.infer(changes, measured, {agent}, graph, source, observation.stamp_ns, {agent})
        return changes

    def realign(
        self, moves: Mapping[str, SE3], corrections: Corrections, graph: SceneGraph, source: str, stamp_ns: int
    ) -> GraphChanges:
        """Move nodes, and measure anew what lies between things that did not move alike; the map stays as it is."""
        changes = carry(graph, moves, corrections)
        things = moves.keys() & self.objects.shapes.keys()
        before = self.relations.between(things)
        for thing in things:
            self.objects.shapes[thing] = self.objects.shapes[thing].moved(moves[thing])

        def same(one: str, other: str) -> bool:
            return one in graph and other in graph and alike(graph, moves, one, other)

        measured = self.relations.update(self.objects.shapes, self.objects.labels, things, self.building)
        measured.merge(self.relations.keep(before, things, same))
        rooms = {node.id: moved(node, moves.get(node.id, SE3.identity())) for node in graph.nodes("room")}
        for thing in sorted(things):
            if not all(same(thing, room) for room in self.relations.rooms_of(thing)):
                shares = shares_in(self.objects.shapes[thing].ground_samples, rooms.values())
                measured.merge(self.relations.set_shares(thing, shares))
        self._meaning.infer(changes, measured, moves.keys(), graph, source, stamp_ns)
        return changes

    # -- what an operator states --------------------------------------------------------------------------
    def obey(self, told: Statement, graph: SceneGraph) -> GraphChanges:
        """The changes of the graph that a statement asks for. Raises `InvalidStatement` and `UnknownNode`."""
        changes = GraphChanges()
        measured, touched = MeasurementChange(), set[str]()
        match told.kind, told.args:
            case "rename", (str(node), name):
                changes.put(_with(graph.node(node), name=str(name)))
            case "set", (str(node), str(key), value):
                if key in MEASURED:
                    raise InvalidStatement(
                        f"set: {key} is what was measured of {node}",
                        hint="rooms are drawn with room(Name, [[X, Y], …])",
                    )
                reason = {"type_reason": f"told by {told.author}"} if key == "type" else {}
                changes.put(_with(graph.node(node), **{key: value}, **reason))
            case "delete", (str(node),):
                measured, touched = self._delete(graph.node(node), told, changes, graph)
            case "merge", (str(kept), str(lost)) if "room" in (graph.node(kept).layer, graph.node(lost).layer):
                room_changes, rooms = told_rooms.merge(self.rooms, kept, lost, graph, told.stamp_ns)
                measured, touched = self._redraw(room_changes, rooms, changes, graph, told.stamp_ns)
            case "merge", (str(kept), str(lost)):
                merged = self.objects.join(kept, lost, self._map.instances)
                object_changes, touched = self.objects.update(self._map.instances, merged, graph)
                changes.extend(object_changes)
                measured = self.relations.update(self.objects.shapes, self.objects.labels, touched, self.building)
            case "room", (name, list(polygon), *storey):
                on = str(storey[0]) if storey else None
                room_changes, rooms = told_rooms.draw(self.rooms, str(name), polygon, on, graph, told.stamp_ns)
                measured, touched = self._redraw(room_changes, rooms, changes, graph, told.stamp_ns)
            case "split", (str(room), list(line)):
                room_changes, rooms = told_rooms.split(self.rooms, room, line, graph, told.stamp_ns)
                measured, touched = self._redraw(room_changes, rooms, changes, graph, told.stamp_ns)
            case "fact" | "retract" | "subclass" | "rules" | "forget_rules", _:
                return changes
            case _:
                raise InvalidStatement(f"statement: {told.text!r} does not fit", hint=FORMS[told.kind, len(told.args)])
        self._meaning.infer(changes, measured, touched, graph, f"told by {told.author}", told.stamp_ns)
        return changes

    def _delete(
        self, node: Node, told: Statement, changes: GraphChanges, graph: SceneGraph
    ) -> tuple[MeasurementChange, set[str]]:
        """Delete a node and give up what is behind it, so that it does not come back by itself."""
        if node.layer in ("building", "storey", "place"):
            raise InvalidStatement(
                f"delete: {node.id} is a {node.layer}, which follows from what was mapped and would come back",
                hint="objects, structure, rooms and agents can be deleted",
            )
        reason = told.reason or f"deleted by {told.author}"
        if node.layer == "room":
            room_changes, rooms = told_rooms.delete(self.rooms, node.id, reason, graph)
            return self._redraw(room_changes, rooms, changes, graph, told.stamp_ns)
        changes.extend(self.passages.dismiss(node.id, graph))
        planes = self.structure.dismiss(node.id)
        self.building.update((), planes)
        self.rooms.forget_planes(planes)
        touched = self.objects.forget(node.id, self._map.instances)
        touched |= self.clusters.forget(node.id) | self.boxes.forget(node.id) | self.stairs.forget(node.id)
        self._connect_rooms(changes, set(), touched, np.empty((0, 3), np.int64), graph, told.stamp_ns)
        changes.delete_node(node.id, reason)
        measured = self.relations.update(self.objects.shapes, self.objects.labels, touched, self.building)
        return measured, touched

    def _redraw(
        self, room_changes: GraphChanges, rooms: set[str], changes: GraphChanges, graph: SceneGraph, stamp_ns: int
    ) -> tuple[MeasurementChange, set[str]]:
        """All that follows where an operator made rooms: what was measured anew, and the ids that it is about."""
        changes.extend(room_changes)
        self._connect_rooms(changes, rooms, set(), np.empty((0, 3), np.int64), graph, stamp_ns)
        _keep_told(changes, graph)
        affected = self.relations.things_in(rooms)
        here = set[str]()
        for x0, y0, x1, y1 in (self.rooms.footprints[room].bounds for room in rooms & self.rooms.footprints.keys()):
            about = graph.in_box((x0, y0, -FARTHEST_UP_M), (x1, y1, FARTHEST_UP_M))
            here.update(node.id for node in about if node.id in self.objects.shapes)
        return self._room_shares(here, rooms, graph), rooms | affected | here

    def _connect_rooms(
        self,
        changes: GraphChanges,
        moved_rooms: set[str],
        reshaped: set[str],
        blocks: Array,
        graph: SceneGraph,
        stamp_ns: int,
    ) -> None:
        """Add what follows from rooms, things and blocks of space that changed: storeys, passages between rooms,
        places in them."""
        self.rooms.storeys.write(changes, BUILDING, graph, stamp_ns)
        through = self.passages.see(reshaped, self.objects.shapes, self.objects.labels)
        changes.extend(
            self.passages.update(
                self.rooms.storeys,
                moved_rooms | through,
                self.rooms.footprints,
                self._map.occupancy,
                graph,
                stamp_ns,
            )
        )
        changes.extend(self.free_places.update(self._map.occupancy, blocks, self.rooms, moved_rooms, graph, stamp_ns))

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """What is known besides the graph and the map, as JSON values."""
        return {
            "objects": self.objects.document(),
            "clusters": self.clusters.document(),
            "boxes": self.boxes.document(),
            "relations": self.relations.document(),
            "structure": self.structure.document(),
            "stairs": self.stairs.document(),
            "dismissed_planes": self.structure.dismissed,
            "dismissed_passages": self.passages.document(),
        }

    def restore(self, document: Mapping[str, Any], rooms: Mapping[str, Array], graph: SceneGraph) -> None:
        """Take over what `document` and `Rooms.state` gave; the map and the graph have been restored before."""
        self.objects.restore(document["objects"], self._map.instances, graph)
        if "boxes" in document:
            self.boxes.restore(document["boxes"])
        self.rooms.restore(rooms, graph)
        given_up = document.get("dismissed_passages", ())
        self.passages.restore(given_up, graph, self.objects.shapes, self.objects.labels)
        self.free_places.restore(self._map.occupancy, self.rooms, graph)
        self.structure.restore(document["structure"], self._map.planes, graph, document.get("dismissed_planes", ()))
        if "stairs" in document:
            self.stairs.restore(document["stairs"], self._map.planes, self._map.tsdf.block_size_m)
        if "clusters" in document:
            self.clusters.restore(document["clusters"], self._map, self.structure.labels, graph)
        self.relations.restore(document["relations"], self.objects.shapes)
        labelled = [(label, self._map.planes.plane(i)) for i, label in self.structure.labels.items()]
        self.building = Building(self._map.planes, self._map.occupancy, self._storey_at)
        self.building.update(labelled, ())

    def _storey_at(self, z: float) -> int | None:
        storey = self.rooms.storeys.at(z)
        return None if storey is None else storey.number

    @staticmethod
    def _found(graph: SceneGraph, stamp_ns: int) -> GraphChanges:
        """Changes that begin with the building, which is there from the first observation."""
        changes = GraphChanges()
        if BUILDING not in graph:
            changes.put(
                Node(
                    id=BUILDING, layer="building", label="building", position=(0.0, 0.0, 0.0),
                    first_seen_ns=stamp_ns, last_seen_ns=stamp_ns,
                )
            )  # fmt: skip
        return changes

    def _known_as(self, shape: Shape, label: str) -> str | None:
        """The id under which a thing of which voxels have a class now has been known until now."""
        return self.boxes.inherit(shape, label) or self._cluster_at(shape.points)

    def _named_otherwise(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] are of things whose name does not come from labelled voxels."""
        return self.boxes.holds(points) | self.stairs.holds(points)

    def _cluster_at(self, points: Array) -> str | None:
        return self.clusters.inherit(self._map.clusters, points)

    def _evidence(self, points: Array) -> dict[str, float]:
        """Shares of the points (N, 3) on a plane that carry each class; what carries no label is left out.

        Labels lie in finer voxels than planes: the nearest within a voxel of these counts.
        """
        labels, _ = labels_near(points, self._map.semantics, self._map.tsdf.voxel_size_m)
        ids, counts = np.unique(labels[labels > 0], return_counts=True)
        return {
            class_atom(self._labels.name(int(i))): n / len(points) for i, n in zip(ids, counts.tolist(), strict=True)
        }

    def _room_shares(self, reshaped: set[str], moved_rooms: set[str], graph: SceneGraph) -> MeasurementChange:
        """In which rooms the footprints of things lie, for things and rooms that changed; agents are points."""
        change = MeasurementChange()
        for thing in sorted(reshaped | self.relations.things_in(moved_rooms)):
            shape = self.objects.shapes.get(thing)
            shares: dict[str, float] = {}
            if shape is not None:
                shares = self.rooms.shares(shape.ground_samples, shape.lowest)
            elif thing in graph and thing not in reshaped:
                position = graph.node(thing).position
                shares = self.rooms.shares(position[None, :2], float(position[2]))
            change.merge(self.relations.set_shares(thing, shares))
        return change


def _in_view(changes: GraphChanges, stamp_ns: int) -> set[str]:
    """The things that were seen at a time; planes are seen piecemeal and say nothing of what stands on them."""
    return {
        step.id
        for step in changes.steps
        if isinstance(step, Node)
        and step.last_seen_ns >= stamp_ns
        and (step.layer in ("object", "agent") or step.id.startswith("opening_"))
    }


def _with(node: Node, **attributes: Any) -> Node:
    return node.replace(attributes={**node.attributes, **attributes})


def _still_possible(wishes: GraphChanges, graph: SceneGraph) -> GraphChanges:
    """The changes without the deletion of nodes that are not there: an operator deleted them before."""
    possible = GraphChanges()
    for step in wishes.steps:
        if isinstance(step, Node | Edge):
            possible.put(step)
        elif not isinstance(step, NodeDeletion):
            possible.delete_edge(*step)
        elif step.id in graph:
            possible.delete_node(step.id, step.reason, step.became)
    return possible


def _keep_told(changes: GraphChanges, graph: SceneGraph) -> None:
    """Let nodes that are written anew keep the attributes of which perception knows nothing: what operators set."""
    gone = {step.id for step in changes.steps if isinstance(step, NodeDeletion)}
    for step in changes.steps:
        if isinstance(step, Node) and step.id in graph and step.id not in gone:
            told = {k: v for k, v in graph.node(step.id).attributes.items() if k not in step.attributes}
            if told:
                changes.put(_with(step, **told))
