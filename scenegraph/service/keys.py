"""The one file that spells key expressions, and the quality of service of each.

Everything lives under `scenegraph/v1/{world}/`, one idea a chunk. `{world}`, `{robot}`, `{sensor}`, ids and relations
are `[a-z][a-z0-9_]*`: such a chunk can neither be a wildcard nor begin with `@`, so that no name reaches beyond its
place.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from mapping.observations import LabelSpace, Observation, RobotDescription
from scenegraph.service.errors import InvalidKey, UnknownKey

__all__ = [
    "ANY_CHUNK",
    "INPUT_KINDS",
    "MAP_LAYERS",
    "PREFIX",
    "QOS",
    "TABLE",
    "Input",
    "KeyRow",
    "QualityOfService",
    "alive",
    "alive_everywhere",
    "answers",
    "chunk",
    "edge",
    "everything",
    "input_key",
    "key",
    "node",
    "qos",
    "read_input",
    "row_of",
    "unknown_key",
    "world_of",
]

PREFIX = "scenegraph/v1"

ANY_CHUNK = "any"
"""Stands for the robot or sensor of an input that has none: a world's default label space."""

INPUT_KINDS: dict[str, str] = {
    "rgbd": "RgbdImage",
    "scan": "Scan",
    "detections": "Detections",
    "pose": "AgentPose",
    "correction": "PoseCorrection",
    "transform": "Transform",
    "labelspace": "LabelSpace",
    "description": "RobotDescription",
}
"""The last chunk of an input's key, and the model that is put there."""

_KIND_OF = {model: kind for kind, model in INPUT_KINDS.items()}

MAP_LAYERS = ("occupancy", "tsdf", "esdf", "semantics", "instances")

_CHUNK = re.compile(r"[a-z][a-z0-9_]*")
_MAX_CHUNK = 128


def chunk(name: str, what: str = "name") -> str:
    """`name`, which must be usable as one chunk of a key. Raises `InvalidKey`."""
    if not isinstance(name, str) or len(name) > _MAX_CHUNK or _CHUNK.fullmatch(name) is None:
        raise InvalidKey(
            f"{what}: expected lower-case letters, digits and _ that begin with a letter, got {str(name)[:60]!r}"
        )
    return name


def key(world: str, path: str = "") -> str:
    """`scenegraph/v1/{world}/{path}`, where the path is one of ours, such as `map/tsdf`."""
    return _joined(world, *path.split("/")) if path else f"{PREFIX}/{chunk(world, 'world')}"


def _joined(world: str, *chunks: str) -> str:
    return "/".join((PREFIX, chunk(world, "world"), *map(chunk, chunks)))


def everything(world: str, under: str = "") -> str:
    """The expression of all keys of a world, or of those under one of its branches."""
    return f"{key(world, under)}/**"


def node(world: str, layer: str, node_id: str) -> str:
    """The key of one node."""
    return _joined(world, "graph", "nodes", layer, node_id)


def edge(world: str, relation: str, source: str, target: str) -> str:
    """The key of one edge."""
    return _joined(world, "graph", "edges", relation, source, target)


def answers(world: str, watch: str) -> str:
    """The key where the answers of a watch are put."""
    return _joined(world, "answers", watch)


def alive(world: str, service: str) -> str:
    """The liveliness token of one service of a world."""
    return _joined(world, "alive", service)


def alive_everywhere() -> str:
    """The expression of all liveliness tokens."""
    return f"{PREFIX}/*/alive/*"


def world_of(expression: str) -> str:
    """The world chunk of a key of ours; may be a wildcard."""
    rest = expression.removeprefix(PREFIX + "/")
    return rest.split("/", 1)[0] if rest != expression else ""


# -- inputs --------------------------------------------------------------------------------------------------


class Input(NamedTuple):
    """Where an observation was put: `in/{robot}/{sensor}/{kind}`, or `in/{robot}/description`."""

    robot: str
    sensor: str
    kind: str

    @property
    def model(self) -> str:
        """The name of the model that is put there."""
        return INPUT_KINDS[self.kind]

    @property
    def path(self) -> str:
        """The key below `in/`."""
        return f"{self.robot}/{self.kind}" if self.kind == "description" else "/".join(self)

    @property
    def newest_wins(self) -> bool:
        """Whether a newer one makes an older one that still waits worthless."""
        return self.kind in ("rgbd", "scan")


def input_key(world: str, observation: Observation) -> str:
    """The key where an observation is put."""
    kind = _KIND_OF.get(type(observation).__name__)
    if kind is None:
        raise InvalidKey(f"expected an observation ({', '.join(_KIND_OF)}), got {type(observation).__name__}")
    robot = getattr(observation, "robot", None) or ANY_CHUNK
    if isinstance(observation, RobotDescription):
        return _joined(world, "in", robot, kind)
    sensor = getattr(observation, "sensor", None) or (ANY_CHUNK if isinstance(observation, LabelSpace) else "base")
    return _joined(world, "in", robot, sensor, kind)


def row_of(observation: Observation) -> str:
    """The row of the table that an observation is put to."""
    kind = _KIND_OF[type(observation).__name__]
    return f"in/{{robot}}/{kind}" if kind == "description" else f"in/{{robot}}/{{sensor}}/{kind}"


def read_input(world: str, where: str) -> Input:
    """The robot, sensor and kind that a concrete key under `in/` names. Raises `UnknownKey` with the nearest kinds."""
    parts = where.removeprefix(key(world, "in") + "/").split("/")
    if parts[-1] in INPUT_KINDS and all(_CHUNK.fullmatch(part) for part in parts):
        if len(parts) == 3 and parts[2] != "description":
            return Input(*parts)
        if len(parts) == 2 and parts[1] == "description":
            return Input(parts[0], ANY_CHUNK, parts[1])
    near = difflib.get_close_matches(parts[-1], INPUT_KINDS, n=1, cutoff=0.5)
    raise UnknownKey(
        f"{where[:200]} is not an input: expected in/{{robot}}/{{sensor}}/{{kind}} or in/{{robot}}/description",
        hint=f"did you mean …/{near[0]}?" if near and near[0] != parts[-1] else f"kinds: {', '.join(INPUT_KINDS)}",
    )


def unknown_key(world: str, where: str) -> UnknownKey:
    """The error for a key of this world that nothing is served at."""
    rest = where.removeprefix(f"{PREFIX}/{world}/")
    known = {name for row in TABLE for name in row.examples()}
    near = difflib.get_close_matches(rest, known, n=1, cutoff=0.5) or difflib.get_close_matches(
        rest.split("/")[0], {name.split("/")[0] for name in known}, n=1, cutoff=0.5
    )
    return UnknownKey(
        f"nothing is served at {where[:200]}",
        hint=f"did you mean {PREFIX}/{world}/{near[0]}?" if near else f"keys: {', '.join(row.path for row in TABLE)}",
    )


# -- the table -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class QualityOfService:
    """How a key's messages travel.

    priority   name of a Zenoh priority
    congested  what a sender does when the line is full: `block` (wait) or `drop` (the newest is enough)
    express    not batched with others: for small messages that someone waits for
    """

    priority: Literal["INTERACTIVE_HIGH", "INTERACTIVE_LOW", "DATA_HIGH", "DATA", "DATA_LOW", "BACKGROUND"] = "DATA"
    congested: Literal["block", "drop"] = "block"
    express: bool = False


@dataclass(frozen=True)
class KeyRow:
    """One row of the contract: `{…}` in the path stands for one chunk.

    kind     who does what there
    request  model of what a client puts or asks with, "" for none
    reply    model of what the server puts or replies with, "" for none
    """

    path: str
    kind: Literal["clients put or ask", "server puts", "queryable", "server puts, queryable", "liveliness"]
    request: str
    reply: str
    qos: QualityOfService

    def examples(self) -> Iterable[str]:
        """The path; one for each layer where it names one."""
        return (
            (self.path.replace("{layer}", name) for name in MAP_LAYERS)
            if self.path.startswith("map/")
            else (self.path,)
        )


_IMAGE = QualityOfService("DATA_LOW", "block")  # the server drops and counts; a line that drops would not count
_INPUT = QualityOfService("DATA_HIGH", "block")
_REQUEST = QualityOfService("INTERACTIVE_LOW", "block", express=True)
_BULK = QualityOfService("BACKGROUND", "block")
_CHANGE = QualityOfService("DATA", "block")
_STATUS = QualityOfService("DATA_HIGH", "drop", express=True)

TABLE: tuple[KeyRow, ...] = (
    *(
        KeyRow(
            f"in/{{robot}}/{kind}" if kind == "description" else f"in/{{robot}}/{{sensor}}/{kind}",
            "clients put or ask",
            model,
            "ObservationReply",
            _IMAGE if kind in ("rgbd", "scan") else _INPUT,
        )
        for kind, model in INPUT_KINDS.items()
    ),
    KeyRow("graph", "queryable", "", "Snapshot", _BULK),
    KeyRow("graph/delta", "server puts", "", "Delta", _CHANGE),
    KeyRow("graph/nodes/{layer}/{id}", "server puts, queryable", "", "Node", _CHANGE),
    KeyRow("graph/edges/{relation}/{source}/{target}", "server puts, queryable", "", "Edge", _CHANGE),
    KeyRow("ask", "queryable", "AskRequest", "AskReply", _REQUEST),
    KeyRow("where", "queryable", "WhereRequest", "WhereReply", _REQUEST),
    KeyRow("watch", "queryable", "WatchRequest", "WatchReply", _REQUEST),
    KeyRow("answers/{watch}", "server puts, queryable", "", "WatchAnswers", _CHANGE),
    KeyRow("plan", "queryable", "PlanRequest", "PlanReply", _REQUEST),
    KeyRow("tell", "queryable", "TellRequest", "TellReply", _REQUEST),
    KeyRow("events", "queryable", "EventsRequest", "EventsReply", _REQUEST),
    KeyRow("map/{layer}", "queryable", "", "", _BULK),
    KeyRow("map/{layer}/query", "queryable", "MapQuery", "MapValues", _REQUEST),
    KeyRow("status", "queryable", "", "Status", _STATUS),
    KeyRow("problems", "server puts, queryable", "", "Refusal", _STATUS),
    KeyRow("schema", "queryable", "", "", _BULK),
    KeyRow("alive/{service}", "liveliness", "", "", _STATUS),
)

QOS: dict[str, QualityOfService] = {row.path: row.qos for row in TABLE}


def qos(path: str) -> QualityOfService:
    """The quality of service of a path of the table."""
    return QOS[path]
