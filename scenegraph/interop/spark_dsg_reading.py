"""Graphs of spark_dsg (Hydra, Khronos, heracles) into ours: JSON of its format 1.1 and of the one before headers.

What becomes what:

layers      objects, segments → `object`; agents → `agent`, a node a pose; places, 2D places, traversability → `place`;
            rooms → `room`; buildings → `building`. Layers that we wrote (structure, storeys) come back as they were
labels      by the label space of the node's layer; without one objects are `class_5`, the rest by their layer
boxes       oriented, as they are; AABBs upright
names, mesh_connections, distance → attributes `name`, `mesh_connections`, `clearance_m`; the grid of a traversability
            place → `traversability`; a 2D place's → `boundary`. All other fields are kept in the attribute `spark_dsg`,
            from where the writer takes them again
edges       across layers: the lower is `in` the upper, which `contains` it; in a layer: `adjacent`, both ways; agents:
            one `precedes` the next. A weight is the edge's value. One edge there is one joined pair here
times       when last updated; of agents, their stamps; of Khronos' objects, first and last observed
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from scenegraph.errors import GraphUnreadable, InvalidGraphValue, InvariantViolated
from scenegraph.graph import Box, Edge, Layer, Node, SceneGraph, Snapshot, Tombstone, valid_identifier
from scenegraph.interop.spark_dsg_values import LAYERS, NO_LABEL, PLACE_FIELDS, PROMOTED, box_of

__all__ = ["is_spark_dsg", "read_spark_dsg"]

_BY_NAME: dict[str, Layer] = {layer.name: ours for ours, layer in LAYERS.items() if ours != "agent"}
_BY_NUMBER: dict[int, Layer] = {1: "object", 2: "object", 3: "place", 4: "room", 5: "building"}
_GRID = ("min", "max", "states_0", "states_1", "states_2", "states_3")
_TOLD = ("id", "came", "label", "confidence", "first_seen_ns", "last_seen_ns", "box", "attributes")
_SINGLE = 1e-5  # relative: what single precision may lose


def is_spark_dsg(document: Mapping[str, Any]) -> bool:
    """Whether a JSON mapping is a graph of spark_dsg."""
    return "SPARK_DSG_header" in document or ("layer_ids" in document and "nodes" in document)


def read_spark_dsg(document: Mapping[str, Any], *, labels: Mapping[int, str] | None = None) -> SceneGraph:
    """The graph that a spark_dsg file holds; its mesh is left out.

    labels : names of the objects' semantic labels, for files without label spaces

    Raises GraphUnreadable, naming the node or edge, when the document is not one or has a layer that we do not know.
    """
    if not is_spark_dsg(document):
        raise GraphUnreadable("not a spark_dsg graph: expected SPARK_DSG_header or layer_ids, with nodes and edges")
    reader = _Reader(document, labels or {})
    nodes = [reader.node(record, i) for i, record in enumerate(_list(document, "nodes"))]
    edges = [edge for i, record in enumerate(_list(document, "edges")) for edge in reader.edges(record, i)]
    last = max((node.last_seen_ns for node in nodes), default=0)
    with _named("metadata"):
        told = document.get("metadata") or {}
        stones = tuple(Tombstone.model_validate(stone) for stone in told.get("tombstones", ()))
        revision, stamp_ns = int(told.get("revision", 1)), int(told.get("stamp_ns", last))
    try:
        return SceneGraph.from_snapshot(
            Snapshot(revision=revision, stamp_ns=stamp_ns, nodes=tuple(nodes), edges=tuple(edges), tombstones=stones)
        )
    except (InvalidGraphValue, InvariantViolated) as error:
        raise GraphUnreadable(f"spark_dsg: {error}") from None


def _list(document: Mapping[str, Any], name: str) -> list[Any]:
    value = document.get(name, [])
    if not isinstance(value, list):
        raise GraphUnreadable(f"spark_dsg: {name}: expected a list, got {type(value).__name__}")
    return value


@contextmanager
def _named(part: str) -> Iterator[None]:
    """What is wrong inside is GraphUnreadable, and names the part of the document."""
    try:
        yield
    except GraphUnreadable as error:
        raise GraphUnreadable(f"spark_dsg: {part}: {error}", hint=error.hint) from None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise GraphUnreadable(f"spark_dsg: {part}: {_words(error)}") from None


class _Reader:
    """Reads nodes, then edges, of one document."""

    def __init__(self, document: Mapping[str, Any], labels: Mapping[int, str]) -> None:
        names = document.get("layer_names") or {layer.name: layer.key for layer in LAYERS.values()}
        with _named("layer_names"):
            self._names = {(key["layer"], key["partition"]): name for name, key in names.items() if name != "AGENTS"}
        with _named("metadata.labelspaces"):
            spaces = (document.get("metadata") or {}).get("labelspaces") or {}
            self._spaces: dict[str, dict[int, str]] = {
                key: {int(number): str(label) for number, label in pairs} for key, pairs in spaces.items()
            }
        self._labels = labels
        self._by_symbol: dict[int, tuple[Node, int]] = {}
        self._taken: set[str] = set()

    def node(self, record: Any, row: int) -> Node:
        with _named(f"nodes[{row}]"):
            return self._node(record)

    def _node(self, record: dict[str, Any]) -> Node:
        fields = _modern(record)
        symbol, number, partition = int(record["id"]), int(record["layer"]), int(fields.pop("partition"))
        if symbol in self._by_symbol:
            raise GraphUnreadable(f"id {symbol} is there twice")
        metadata = fields.get("metadata") or {}
        told = metadata if all(name in metadata for name in _TOLD) else {}
        layer = self._layer(number, partition, fields["type"])
        label = self._label(layer, number, partition, fields, told)
        box = self._box(layer, fields, told)
        first, last = _times(fields, told)
        attributes: dict[str, Any] = dict(told.get("attributes", {}))
        if not told or told["came"]:
            attributes |= _kept(symbol, number, partition, self._names.get((number, partition), ""), label, fields)
        elif fields.get("name") not in (None, "", told["id"], attributes.get("name")):
            attributes["name"] = fields["name"]
        node = Node(
            id=self._id(layer, symbol, told.get("id")),
            layer=layer,
            label=label,
            position=fields["position"],
            box=box,
            confidence=told.get("confidence", 1.0),
            first_seen_ns=first,
            last_seen_ns=last,
            attributes=attributes,
        )
        self._by_symbol[symbol] = node, number
        return node

    def _layer(self, number: int, partition: int, kind: str) -> Layer:
        if kind == "AgentNodeAttributes":
            return "agent"
        named = _BY_NAME.get(self._names.get((number, partition), ""))
        layer = named if named is not None and LAYERS[named].number == number else _BY_NUMBER.get(number)
        if layer is None:
            raise GraphUnreadable(
                f"layer {number} has no counterpart: expected 1 … 5 (segments, objects, places, rooms, buildings)"
            )
        return layer

    def _label(self, layer: Layer, number: int, partition: int, fields: dict[str, Any], told: dict[str, Any]) -> str:
        label = fields.get("semantic_label")
        for key in (f"_l{number}p{partition}", self._names.get((number, partition), "")):
            if label is not None and label in self._spaces.get(key, ()):
                return self._spaces[key][label]
        if told:
            return str(told["label"])
        if layer == "agent":
            return "robot"
        if layer != "object" or label is None or label == NO_LABEL:
            return str(layer)
        return self._labels.get(label, f"class_{label}")

    @staticmethod
    def _box(layer: Layer, fields: dict[str, Any], told: dict[str, Any]) -> Box | None:
        """Theirs; ours where theirs is ours in single precision."""
        ours = told.get("box")
        if layer == "agent":
            turn = [fields["world_R_body"][axis] for axis in "wxyz"]
            if told and (ours is None or _same_turn(ours["rotation_wxyz"], turn)):
                return None if ours is None else Box.model_validate(ours)
            return Box(center=fields["position"], size=(0.0, 0.0, 0.0), rotation_wxyz=turn)
        theirs = fields.get("bounding_box")
        if theirs is None or theirs["type"] == "INVALID":
            return None
        if ours is not None and theirs["type"] != "AABB":
            turn = [theirs["world_R_center"][axis] for axis in "wxyz"]
            if (
                _close(ours["center"], theirs["world_P_center"])
                and _close(ours["size"], theirs["dimensions"])
                and _same_turn(ours["rotation_wxyz"], turn)
            ):
                return Box.model_validate(ours)
        return box_of(theirs)

    def _id(self, layer: Layer, symbol: int, told: Any) -> str:
        """The id that we gave it; else `room_1` of `R1`, `agent_a_5` of `a5`; with a number where that is taken."""
        if isinstance(told, str) and valid_identifier(told) and told not in self._taken:
            given = told
        else:
            prefix, number = chr(symbol >> 56), symbol & (1 << 56) - 1
            stem = f"agent_{prefix}" if layer == "agent" and prefix.isascii() and prefix.isalpha() else layer
            given = wanted = f"{stem.lower()}_{number}"
            again = 1
            while given in self._taken:
                again += 1
                given = f"{wanted}_{again}"
        self._taken.add(given)
        return given

    def edges(self, record: Any, row: int) -> list[Edge]:
        with _named(f"edges[{row}]"):
            return self._edges(record)

    def _edges(self, record: dict[str, Any]) -> list[Edge]:
        info = record.get("info") or {}
        metadata = info.get("metadata") or {}
        if "relations" in metadata:
            return [Edge.model_validate(edge) for edge in metadata["relations"]]
        (one, height), (other, other_height) = self._by_symbol[record["source"]], self._by_symbol[record["target"]]
        lower, upper = (other, one) if height >= other_height else (one, other)
        if height != other_height or one.layer != other.layer:
            names = [("in", lower, upper), ("contains", upper, lower)]
        elif one.layer == "agent":
            earlier, later = sorted((one, other), key=_in_time)
            names = [("precedes", earlier, later)]
        else:
            names = [("adjacent", one, other), ("adjacent", other, one)]
        first = max(one.first_seen_ns, other.first_seen_ns)
        return [
            Edge(
                relation=relation,
                source=source.id,
                target=target.id,
                value=info.get("weight") if info.get("weighted") else None,
                first_seen_ns=first,
                last_seen_ns=max(first, min(one.last_seen_ns, other.last_seen_ns)),
                attributes={"spark_dsg": {"source": record["source"], "target": record["target"], "info": info}},
            )
            for relation, source, target in names
        ]


def _modern(record: dict[str, Any]) -> dict[str, Any]:
    """A copy of a node's fields as format 1.1 has them, and `partition`."""
    fields: dict[str, Any] = dict(record["attributes"])
    prefix = record.get("prefix", 0)
    fields["partition"] = record.get("partition", prefix if isinstance(prefix, int) else ord(prefix))
    if "timestamp" in record:
        fields["timestamp"] = record["timestamp"]
    box = fields.get("bounding_box")
    if box is not None and "dimensions" not in box:
        size = [b - a for a, b in zip(box["min"], box["max"], strict=True)]
        rest = {name: value for name, value in box.items() if name not in ("min", "max")}
        fields["bounding_box"] = {**rest, "dimensions": size}
    color = fields.get("color")
    if isinstance(color, list):
        fields["color"] = dict(zip("rgba", [*color, 255][:4], strict=True))
    if fields.get("voxblox_mesh_connections"):
        fields["voxblox_mesh_connections"] = [{"label": None, **one} for one in fields["voxblox_mesh_connections"]]
    fields.setdefault("metadata", {})
    fields.setdefault("is_predicted", False)
    match fields["type"]:
        case "PlaceNodeAttributes":
            fields = {**PLACE_FIELDS, **fields}
        case "RoomNodeAttributes":
            fields.setdefault("semantic_class_probabilities", {})
    if "bounding_box" in fields:
        fields.setdefault("semantic_feature", {"cols": 0, "data": None, "rows": 0})
    return fields


def _kept(symbol: int, number: int, partition: int, name: str, label: str, fields: dict[str, Any]) -> dict[str, Any]:
    """The attributes that hold what a node of ours has no field for."""
    rest = dict(fields)
    kept = {ours: rest.pop(theirs) for theirs, ours in PROMOTED.items() if theirs in rest}
    if all(part in rest for part in _GRID):
        kept["traversability"] = {part: rest.pop(part) for part in _GRID}
    if rest.get("name"):
        kept["name"] = rest["name"]
    rest["metadata"] = {key: value for key, value in (rest.get("metadata") or {}).items() if key not in _TOLD}
    origin = {"id": symbol, "layer": number, "partition": partition, "label": label, "attributes": rest}
    return {**kept, "spark_dsg": origin | ({"layer_name": name} if name else {})}


def _times(fields: dict[str, Any], told: dict[str, Any]) -> tuple[int, int]:
    last = int(fields.get("timestamp") or fields.get("last_update_time_ns") or 0)
    if told and last in (0, max(0, told["last_seen_ns"])):
        return told["first_seen_ns"], told["last_seen_ns"]
    seen = [n for name in ("first_observed_ns", "last_observed_ns") for n in _stamps(fields.get(name))]
    last = max([last, *seen])
    return min([last, *seen]), last


def _stamps(given: Any) -> list[int]:
    return (
        [] if given is None else [int(n) for n in given] if isinstance(given, list) else [int(given)] if given else []
    )


def _close(a: Sequence[float], b: Sequence[float]) -> bool:
    return a == b or all(abs(x - y) <= _SINGLE * max(1.0, abs(x)) for x, y in zip(a, b, strict=True))


def _same_turn(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two unit quaternions turn alike; −q turns as q does."""
    return _close(a, b) or _close(a, [-x for x in b])


def _in_time(node: Node) -> tuple[int, int]:
    return node.last_seen_ns, node.attributes.get("spark_dsg", {}).get("id", 0)


def _words(error: Exception) -> str:
    return f"{error.args[0]!r} is missing" if isinstance(error, KeyError) and error.args else str(error)
