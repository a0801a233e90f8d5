"""Two graphs of the same place, by two robots or in two sessions, made one.

Everything of theirs is either the same as something of ours (`matching`), or new. What is the same keeps our id and the
best of both; what is new gets an id that is free; edges follow. Nothing of ours is deleted for not being in theirs: a
thing that only one has seen may have been out of the other's sight. That two graphs show one thing in two places is
no conflict either, but two things: whether one was moved is for those to tell who looked (`scenegraph.events`).

Only the graphs are joined, not the maps below them, which are merged layer by layer; so it is stored graphs that are
joined, and asked as graphs (`scenegraph.importing`): the rules of a world that goes on mapping know only what that
mapped. Between things of ours and of theirs nothing is measured here; `scenegraph.relating.follow` does it from boxes.

Joining a graph with itself changes nothing, joining the same one twice no more than once, and which one is *ours*
decides ids and names, but not what there is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Any

import shapely

from mapping.geometry import SE3
from scenegraph.errors import InvalidGraphValue
from scenegraph.graph import LAYERS, Box, Edge, EdgeKey, GraphChanges, Node, SceneGraph, valid_identifier
from scenegraph.matching import Match, footprint_polygon, match
from scenegraph.registering import Alignment, register
from scenegraph.rigid import moved, moved_edge

__all__ = ["Conflict", "JoinReport", "Joined", "join"]

MOVED_M = 0.15
"""Two sights of one thing that are farther apart are not both right: the later one is believed, not the better one."""
NEWS_SHARE = 0.02
"""A footprint grows by the other's where that adds at least this share of its area; less is noise."""
INVERSE = {"on": "supports", "supports": "on", "in": "contains", "contains": "in"}


@dataclass(frozen=True, slots=True)
class Joined:
    """Two nodes that are one from now on.

    ours, theirs         their ids before; the node goes on under ours
    distance_m, overlap  between them, as they were matched;  reason: the same in words
    kept                 whose place, box and measured attributes stay, and why
    """

    layer: str
    ours: str
    theirs: str
    distance_m: float
    overlap: float
    reason: str
    kept: str


@dataclass(frozen=True, slots=True)
class Conflict:
    """Something on which the graphs do not agree: `label` and `name` of a node, the `room` a thing is in, or an `edge`
    that cannot hold beside ours; what each says, which stays, and why."""

    kind: str
    node: str
    ours: str
    theirs: str
    stays: str
    why: str


@dataclass(frozen=True)
class JoinReport:
    """What became of their nodes and edges.

    T_ours_theirs  where their map lies in ours;  alignment: how that was found, None where it was given
    ids            each id of theirs, dead ones too where something lives on, and the id it has in the joined graph
    added          ids, in the joined graph, of nodes that only they had
    edges_added, edges_shared, edges_dropped   of theirs: new, in both, and left out (with a conflict, or between nodes
                   that are one)
    """

    T_ours_theirs: SE3
    alignment: Alignment | None
    joined: tuple[Joined, ...]
    added: tuple[str, ...]
    conflicts: tuple[Conflict, ...]
    ids: Mapping[str, str] = field(repr=False)
    edges_added: int = 0
    edges_shared: int = 0
    edges_dropped: int = 0

    def as_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        T, found = self.T_ours_theirs, self.alignment
        return {
            "T_ours_theirs": {"translation": T.translation.tolist(), "rotation_wxyz": T.quaternion_wxyz.tolist()},
            "alignment": None
            if found is None
            else {"joined": found.joined, "of": found.of, "rms_m": found.rms_m, "runner_up": found.runner_up},
            "joined": [{name: getattr(item, name) for name in Joined.__slots__} for item in self.joined],
            "added": list(self.added),
            "conflicts": [{name: getattr(item, name) for name in Conflict.__slots__} for item in self.conflicts],
            "ids": dict(self.ids),
            "edges": {"added": self.edges_added, "shared": self.edges_shared, "dropped": self.edges_dropped},
        }


def join(
    ours: SceneGraph, theirs: SceneGraph, T_ours_theirs: SE3 | None = None, *, name: str = "theirs"
) -> tuple[GraphChanges, JoinReport]:
    """What makes ours the graph of both, to be committed to ours, and a report of what was joined and why.

    T_ours_theirs : where the map of theirs lies in that of ours; None: found from the things in both (`registering`)
    name          : what their graph is called, such as the robot's name: an id of theirs that is new here ends in it,
                    and a node that has another id here keeps theirs in its attribute `known_as`, as `name/id`

    Raises JoinRefused when no transform is given and none, or more than one, can be found.
    """
    if not valid_identifier(name):
        raise InvalidGraphValue(f"join: name: expected [a-z][a-z0-9_]*, got {name!r}")
    alignment = None
    if T_ours_theirs is None:
        alignment = register(ours.nodes("object"), theirs.nodes("object"))
        T_ours_theirs = alignment.T_ours_theirs
    return _Join(ours, theirs, T_ours_theirs, name).carried_out(alignment)


class _Join:
    """One joining as it goes on."""

    def __init__(self, ours: SceneGraph, theirs: SceneGraph, T_ours_theirs: SE3, name: str) -> None:
        self._ours = ours
        self._theirs = theirs
        self._T = T_ours_theirs
        self._name = name
        self._changes = GraphChanges()
        self._ids: dict[str, str] = {}
        self._storey_number: dict[int, int] = {}
        self._placed_by_them: set[str] = set()
        self._joined: list[Joined] = []
        self._added: list[str] = []
        self._new: set[str] = set()
        self._conflicts: list[Conflict] = []
        self._known_as = {
            alias.removeprefix(f"{name}/"): node.id
            for node in ours
            for alias in node.attributes.get("known_as", ())
            if alias.startswith(f"{name}/")
        }

    def carried_out(self, alignment: Alignment | None) -> tuple[GraphChanges, JoinReport]:
        for layer in LAYERS:
            ours = self._ours.nodes(layer)
            theirs = [moved(node, self._T) for node in self._theirs.nodes(layer)]
            pairs = match(ours, theirs, layer, self._known_as)
            self._ids.update((theirs[pair.theirs].id, ours[pair.ours].id) for pair in pairs)
            added = [node for node in theirs if node.id not in self._ids]
            for node in added:
                self._ids[node.id] = self._free(node)
                self._new.add(self._ids[node.id])
            if layer == "storey":
                self._number_storeys(theirs)
            for pair in pairs:
                self._join(ours[pair.ours], self._in_our_words(theirs[pair.theirs]), pair)
            for node in added:
                self._add(self._in_our_words(node))
        counts = _Edges(self._ours, self._changes, self._ids, self._placed_by_them, self._conflicts).carry_over(
            self._theirs, self._T
        )
        for stone in self._theirs.tombstones():
            heir = self._theirs.successor(stone.id)
            if heir is not None:
                self._ids[stone.id] = self._ids[heir.id]
        report = JoinReport(
            T_ours_theirs=self._T,
            alignment=alignment,
            joined=tuple(self._joined),
            added=tuple(self._added),
            conflicts=tuple(self._conflicts),
            ids=self._ids,
            edges_added=counts[0],
            edges_shared=counts[1],
            edges_dropped=counts[2],
        )
        return self._changes, report

    def _number_storeys(self, theirs: Sequence[Node]) -> None:
        """Which number each of their storeys has here: that of ours which it is, or a new one."""
        ours = {node.id: node.attributes.get("number") for node in self._ours.nodes("storey")}
        free = count(1 + max((n for n in ours.values() if isinstance(n, int)), default=0))
        for node in theirs:
            number = node.attributes.get("number")
            if isinstance(number, int):
                known = ours.get(self._ids[node.id])
                taken = {*ours.values(), *self._storey_number.values()}
                new = next(n for n in chain((number,), free) if n not in taken)
                self._storey_number[number] = known if isinstance(known, int) else new

    def _in_our_words(self, node: Node) -> Node:
        """A node of theirs, with what its attributes name under the names that it has here."""
        attributes = dict(node.attributes)
        for name in ("number",) if node.layer == "storey" else ("storey",):
            number = attributes.get(name)
            if isinstance(number, int):
                attributes[name] = self._storey_number.get(number, number)
        if "split_from" in attributes:
            whole = self._theirs.successor(str(attributes.pop("split_from")))
            if whole is not None and whole.id in self._ids:
                attributes["split_from"] = self._ids[whole.id]
        return node if attributes == node.attributes else node.replace(attributes=attributes)

    def _add(self, node: Node) -> None:
        new_id = self._ids[node.id]
        self._added.append(new_id)
        attributes = self._with_alias(dict(node.attributes), new_id, node.id)
        self._changes.put(Node(**{**node.__dict__, "id": new_id, "attributes": attributes}))

    def _free(self, node: Node) -> str:
        """An id that nothing has or had here; a robot's is its own everywhere."""
        if node.layer == "agent" and node.id not in self._ours and node.id not in self._new:
            return node.id
        stem = node.id if node.id.endswith(f"_{self._name}") else f"{node.id}_{self._name}"
        wanted, again = stem, 1
        while wanted in self._ours or self._ours.tombstone(wanted) is not None or wanted in self._new:
            again += 1
            wanted = f"{stem}_{again}"
        return wanted

    def _with_alias(self, attributes: dict[str, Any], node_id: str, their_id: str) -> dict[str, Any]:
        if node_id == their_id:
            return attributes
        known = {*attributes.get("known_as", ()), f"{self._name}/{their_id}"}
        return {**attributes, "known_as": sorted(known)}

    def _join(self, ours: Node, theirs: Node, pair: Match) -> None:
        theirs_wins, why = _better(theirs, ours, pair.distance_m)
        best, other = (theirs, ours) if theirs_wins else (ours, theirs)
        if theirs_wins:
            self._placed_by_them.add(ours.id)
        label = self._label(ours, theirs)
        attributes = {**other.attributes, **best.attributes}
        self._keep_name(attributes, ours, theirs)
        aliases = sorted({*ours.attributes.get("known_as", ()), *theirs.attributes.get("known_as", ())})
        if aliases:
            attributes["known_as"] = aliases
        box = best.box if best.box is not None else other.box
        if ours.layer == "room":
            attributes, box = self._grown(ours, theirs, attributes, box)
        node = Node(
            id=ours.id,
            layer=ours.layer,
            label=label,
            position=best.position,
            box=box,
            confidence=max(ours.confidence, theirs.confidence),
            first_seen_ns=min(ours.first_seen_ns, theirs.first_seen_ns),
            last_seen_ns=max(ours.last_seen_ns, theirs.last_seen_ns),
            attributes=self._with_alias(attributes, ours.id, theirs.id),
        )
        if node != ours:
            self._changes.put(node)
        kept = f"{'theirs' if theirs_wins else 'ours'}: {why}"
        self._joined.append(
            Joined(ours.layer, ours.id, theirs.id, round(pair.distance_m, 4), round(pair.overlap, 4), pair.reason, kept)
        )

    def _label(self, ours: Node, theirs: Node) -> str:
        if ours.label == theirs.label:
            return ours.label
        if ours.layer == "room" and ours.label == "room":
            return theirs.label
        if ours.layer == "room" and theirs.label == "room":
            return ours.label
        theirs_wins = theirs.confidence > ours.confidence
        why = f"confidence {ours.confidence:.2f} here, {theirs.confidence:.2f} there"
        self._conflicts.append(
            Conflict("label", ours.id, ours.label, theirs.label, "theirs" if theirs_wins else "ours", why)
        )
        return theirs.label if theirs_wins else ours.label

    def _keep_name(self, attributes: dict[str, Any], ours: Node, theirs: Node) -> None:
        """What our operator called a thing stays; what theirs called it, if ours did not, comes over."""
        names = [node.attributes.get("name") for node in (ours, theirs)]
        if names[0] is not None:
            attributes["name"] = names[0]
        if None not in names and names[0] != names[1]:
            self._conflicts.append(
                Conflict("name", ours.id, str(names[0]), str(names[1]), "ours", "a name that was given here stays")
            )

    def _grown(
        self, ours: Node, theirs: Node, attributes: dict[str, Any], box: Box | None
    ) -> tuple[dict[str, Any], Box | None]:
        """A room's footprint with what theirs adds to it, but for what is another room of ours, and its box."""
        mine, other = footprint_polygon(ours), footprint_polygon(theirs)
        if mine is None or other is None:
            return attributes, box
        rest = [
            outline for node in self._ours.nodes("room") if node.id != ours.id and (outline := footprint_polygon(node))
        ]
        common = shapely.union_all(rest) if rest else shapely.Polygon()
        news = other.difference(common)
        if news.difference(mine).area < NEWS_SHARE * mine.area:
            attributes["footprint"] = ours.attributes["footprint"]
            if "area_m2" in ours.attributes:
                attributes["area_m2"] = ours.attributes["area_m2"]
            return attributes, ours.box
        joined = shapely.union(mine, news).buffer(0.0)
        parts = [part for part in shapely.get_parts(joined) if isinstance(part, shapely.Polygon)]
        whole = max(parts, key=lambda part: float(part.area))
        attributes["footprint"] = [[round(x, 3), round(y, 3)] for x, y in whole.exterior.coords[:-1]]
        if "area_m2" in attributes:
            attributes["area_m2"] = round(float(whole.area), 2)
        if box is None:
            return attributes, box
        x0, y0, x1, y1 = whole.bounds
        low = min(float(node.box.corners()[:, 2].min()) for node in (ours, theirs) if node.box is not None)
        high = max(float(node.box.corners()[:, 2].max()) for node in (ours, theirs) if node.box is not None)
        size = (x1 - x0, y1 - y0, high - low)
        return attributes, Box(center=(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (low + high)), size=size)


def _better(one: Node, other: Node, distance_m: float) -> tuple[bool, str]:
    """Whether `one` is to be believed rather than `other`, strictly, and why one of them is."""
    if distance_m > MOVED_M and one.last_seen_ns != other.last_seen_ns:
        return one.last_seen_ns > other.last_seen_ns, "seen later, and it has moved"
    a, b = _worth(one), _worth(other)
    if a == b:
        return False, "as good"
    k = next(k for k in range(len(a)) if a[k] != b[k])
    return a > b, ("surer", "more of it seen", "seen more often", "seen later")[k]


def _worth(node: Node) -> tuple[float, ...]:
    counts = [node.attributes.get(name, 0) for name in ("voxels", "views")]
    return (node.confidence, *(float(n) if isinstance(n, int | float) else 0.0 for n in counts), node.last_seen_ns)


class _Edges:
    """Their edges, hung onto the joined nodes."""

    def __init__(
        self,
        ours: SceneGraph,
        changes: GraphChanges,
        ids: Mapping[str, str],
        placed_by_them: set[str],
        conflicts: list[Conflict],
    ) -> None:
        self._ours = ours
        self._changes = changes
        self._ids = ids
        self._placed_by_them = placed_by_them
        self._conflicts = conflicts
        self._layer = {node.id: node.layer for node in ours}
        self._put: dict[EdgeKey, Edge] = {}
        self._deleted: set[EdgeKey] = set()
        self._refused: set[EdgeKey] = set()

    def carry_over(self, theirs: SceneGraph, T_ours_theirs: SE3) -> tuple[int, int, int]:
        """Put them; returns how many were new, in both, and left out."""
        self._layer |= {self._ids[node.id]: node.layer for node in theirs}
        added = shared = dropped = 0
        for there in sorted(theirs.edges(), key=lambda edge: edge.relation in ("contains", "supports")):
            edge = moved_edge(there, T_ours_theirs, float(theirs.node(there.source).position[2]))
            source, target = self._ids[edge.source], self._ids[edge.target]
            key = EdgeKey(edge.relation, source, target)
            known = self._put.get(key) or self._ours.edge(*key)
            if source == target or self._conflicts_with_ours(key):
                dropped += 1
            elif known is None:
                self._put[key] = self._renamed(edge, source, target)
                added += 1
            else:
                if edge.last_seen_ns > known.last_seen_ns or edge.first_seen_ns < known.first_seen_ns:
                    self._put[key] = self._both(known, self._renamed(edge, source, target))
                shared += 1
        for key in sorted(self._deleted):
            self._changes.delete_edge(*key)
        for key, edge in self._put.items():
            if key not in self._deleted and self._ours.edge(*key) != edge:
                self._changes.put(edge)
        return added, shared, dropped

    def _renamed(self, edge: Edge, source: str, target: str) -> Edge:
        """The edge between the nodes' new ids, which stand in its attributes too (`through`)."""
        if (source, target) == (edge.source, edge.target) and not edge.attributes:
            return edge
        attributes = {
            name: self._ids.get(value, value) if name == "through" and isinstance(value, str) else value
            for name, value in edge.attributes.items()
        }
        return Edge(**{**edge.__dict__, "source": source, "target": target, "attributes": attributes})

    @staticmethod
    def _both(one: Edge, other: Edge) -> Edge:
        """The one confirmed last, with the time that either first held."""
        later = other if other.last_seen_ns > one.last_seen_ns else one
        return later.replace(first_seen_ns=min(one.first_seen_ns, other.first_seen_ns))

    def _conflicts_with_ours(self, key: EdgeKey) -> bool:
        if key in self._refused:
            return True
        inverse = EdgeKey(INVERSE[key.relation], key.target, key.source) if key.relation in INVERSE else None
        if key.relation == "in" and self._layer[key.target] == "room" and self._in_other_room(key):
            refused = True
        else:
            refused = (
                key.relation == "on" and key not in self._put and self._ours.edge(*key) is None and self._loops(key)
            )
        if refused:
            self._refused.add(key)
            if inverse is not None:
                self._refused.add(inverse)
        return refused

    def _in_other_room(self, key: EdgeKey) -> bool:
        """A thing is in one room: that of the graph that places it. Gives up ours where that is theirs."""
        rooms = [
            edge.target
            for edge in self._ours.edges("in", source=key.source)
            if self._layer[edge.target] == "room" and edge.target != key.target and edge.key not in self._deleted
        ]
        if not rooms:
            return False
        theirs = key.source in self._placed_by_them
        self._conflicts.append(
            Conflict(
                "room",
                key.source,
                rooms[0],
                key.target,
                "theirs" if theirs else "ours",
                "where the thing is taken from",
            )
        )
        if theirs:
            for room in rooms:
                self._deleted |= {EdgeKey("in", key.source, room), EdgeKey("contains", room, key.source)}
        return not theirs

    def _loops(self, key: EdgeKey) -> bool:
        """Whether what it would stand on stands, through whatever, on it."""
        reached, ahead = {key.target}, [key.target]
        while ahead:
            current = ahead.pop()
            below = {edge.target for edge in self._ours.edges("on", source=current)}
            below |= {put.target for put in self._put if put.relation == "on" and put.source == current}
            ahead += below - reached
            reached |= below
        if key.source in reached:
            self._conflicts.append(
                Conflict(
                    "edge", key.source, f"on({key.target}, …)", f"on({key.source}, {key.target})", "ours",
                    "nothing stands on what stands on it",
                )
            )  # fmt: skip
        return key.source in reached
