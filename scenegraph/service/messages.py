"""Every model of the wire, and how it becomes bytes: one table from model names to models.

Observations come from `mapping`, the graph's values from `scenegraph.graph`; what is asked and replied stands here. A
field that a model does not know is refused, so that a misspelt option is not silently left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue, models_json_schema

from mapping.geometry import SE3
from mapping.observations import OBSERVATIONS, Name, Observation, Pose, Stamp
from scenegraph.errors import InvalidGraphValue, Problem, one_line
from scenegraph.events import Event
from scenegraph.graph import Delta, Edge, Node, Snapshot
from scenegraph.graph.values import Value
from scenegraph.service import keys
from scenegraph.service.arrays import ARRAY_SCHEMA, LIMITS, Limits
from scenegraph.service.codec import Form, dumps, form_of, loads, media_type
from scenegraph.service.errors import InvalidMessage

__all__ = [
    "MODELS",
    "AskReply",
    "AskRequest",
    "Binding",
    "Counts",
    "EventsReply",
    "EventsRequest",
    "GoalPose",
    "MapQuery",
    "MapValues",
    "Message",
    "NodeBinding",
    "ObservationReply",
    "PlanReply",
    "PlanRequest",
    "PlanStep",
    "Problems",
    "Refusal",
    "Region",
    "Status",
    "TellReply",
    "TellRequest",
    "ValueBinding",
    "WatchAnswers",
    "WatchReply",
    "WatchRequest",
    "WhereAnswer",
    "WhereReply",
    "WhereRequest",
    "decode",
    "encode",
    "encoding_of",
    "plain",
    "schema",
]

Truth: TypeAlias = Literal["true", "false", "unknown"]
Limit: TypeAlias = Annotated[int, Field(ge=1, le=100_000)]
Timeout: TypeAlias = Annotated[float, Field(gt=0.0, le=60.0, allow_inf_nan=False)]
Lease: TypeAlias = Annotated[float, Field(ge=0.0, le=86_400.0, allow_inf_nan=False)]
Text: TypeAlias = Annotated[str, Field(min_length=1, max_length=20_000)]
ShortText: TypeAlias = Annotated[str, Field(max_length=2_000)]


def _numbers(dtypes: tuple[str, ...], shape: tuple[int | None, ...]) -> BeforeValidator:
    wanted = f"{' or '.join(dtypes)} of shape ({', '.join('n' if n is None else str(n) for n in shape)})"

    def check(value: Any) -> Any:
        array = np.asarray(value, dtype=dtypes[0]) if isinstance(value, list) else value
        if not isinstance(array, np.ndarray):
            raise ValueError(f"expected an array, {wanted}, got {type(value).__name__}")
        fits = len(shape) == array.ndim and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
        if array.dtype.name not in dtypes or not fits:
            raise ValueError(f"expected {wanted}, got {array.dtype} of shape {array.shape}")
        return array

    return BeforeValidator(check)


def _described(meaning: str) -> WithJsonSchema:
    return WithJsonSchema({"$ref": _ARRAY, "description": meaning})


_ARRAY = "#/$defs/Array"

PointRows: TypeAlias = Annotated[
    NDArray[Any],
    _numbers(("float64", "float32"), (None, 3)),
    _described("(N, 3) float64 or float32 [m] in `map`"),
]
VectorRows: TypeAlias = Annotated[NDArray[Any], _numbers(("float32",), (None, 3)), _described("(N, 3) float32")]
ValueColumn: TypeAlias = Annotated[
    NDArray[Any],
    _numbers(("float32", "uint16", "uint32"), (None,)),
    _described("(N,) float32, or uint16 class ids, or uint32 instance ids"),
]
FloatColumn: TypeAlias = Annotated[NDArray[Any], _numbers(("float32",), (None,)), _described("(N,) float32")]
KnownColumn: TypeAlias = Annotated[NDArray[Any], _numbers(("bool",), (None,)), _described("(N,) bool")]


class Message(BaseModel):
    """Base of what is asked and replied: frozen, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


# -- questions and answers -----------------------------------------------------------------------------------


class AskRequest(Message):
    """A goal. `robot`: whose view is meant; `at_ns`: asked of the past; `nodes`: send the nodes of the answers too."""

    goal: Text
    limit: Limit = 100
    timeout_s: Timeout = 1.0
    explain: bool = False
    robot: Name | None = None
    at_ns: Stamp | None = None
    nodes: bool = False


class NodeBinding(Message):
    """A variable that stands for a node of the graph."""

    node: str


class ValueBinding(Message):
    """A variable that stands for a plain value."""

    value: Any


Binding: TypeAlias = NodeBinding | ValueBinding


class AskReply(Message):
    """Answers: each binds the goal's variables. `nodes` only when asked for; `explanation` only when asked for."""

    truth: Truth
    answers: tuple[dict[str, Binding], ...] = ()
    truncated: bool = False
    revision: int
    elapsed_ms: float
    problem: Problem | None = None
    explanation: Any = None
    nodes: tuple[Node, ...] | None = None


class WatchRequest(Message):
    """A goal to be kept answered for `lease_s` [s]. With the name of a watch of this goal that one's lease is renewed,
    or ended with `lease_s` 0. The other fields are those of `AskRequest`."""

    goal: Text
    limit: Limit = 100
    timeout_s: Timeout = 1.0
    robot: Name | None = None
    nodes: bool = False
    watch: Name | None = None
    lease_s: Lease = 60.0


class WatchReply(Message):
    """The watch, whose answers are put at `answers/{watch}`, and for how long [s] unless it is renewed."""

    watch: str
    lease_s: float


class WatchAnswers(AskReply):
    """The answers to a watched goal, put whenever they change; asked for, those that were put last.

    number      of the message: 1, 2, …
    stamp_ns    of the graph that was asked
    came, went  what is new, and what no longer holds, since the message before; with a problem neither is known
    """

    watch: str
    number: int
    stamp_ns: int
    came: tuple[dict[str, Binding], ...] = ()
    went: tuple[dict[str, Binding], ...] = ()


class WhereRequest(Message):
    """A phrase (`near the oven`) or a goal with one variable."""

    phrase: Text
    robot: Name | None = None
    timeout_s: Timeout = 5.0


class Region(Message):
    """A prism: corners (x, y) in `map` [m] between two heights [m]."""

    polygon: tuple[tuple[float, float], ...]
    z_min: float
    z_max: float


class GoalPose(Message):
    """A free pose that can be reached: clearance to the nearest obstacle and length of the way when known [m]."""

    pose: Pose
    clearance_m: float
    path_length_m: float | None = None


class WhereAnswer(Message):
    """One reading: the nodes it is about, the region that is meant, and where to stand, best first."""

    nodes: tuple[str, ...]
    region: Region | None = None
    poses: tuple[GoalPose, ...] = ()


class WhereReply(Message):
    """Where something is. `ambiguous`: the names that stand for several things."""

    truth: Truth
    phrase: str
    answers: tuple[WhereAnswer, ...] = ()
    ambiguous: tuple[Any, ...] = ()
    problem: Problem | None = None


class PlanRequest(Message):
    """A goal that shall be brought about, such as `on(cup, table)`, and by which robot."""

    goal: Text
    robot: Name | None = None
    timeout_s: Timeout = 10.0


class PlanStep(Message):
    """One thing to do. `target`: where base_link is to stand for it, when a free, reachable pose is known."""

    action: str
    arguments: tuple[str, ...]
    target: Pose | None = None
    preconditions: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()


class PlanReply(Message):
    """A plan. `unsolvable`: there is none, as far as is known; `unknown`: what the goal is about is not known."""

    status: Literal["solved", "unsolvable", "unknown", "timeout"]
    steps: tuple[PlanStep, ...] = ()
    problem: Problem | None = None
    goal: str = ""
    rooms: tuple[str, ...] = ()
    revision: int = 0
    elapsed_ms: float = 0.0


class TellRequest(Message):
    """A statement (`rename(room_2, 'guest room')`), who says so, and why."""

    statement: Text
    author: ShortText = "client"
    reason: ShortText = ""


class EventsRequest(Message):
    """What happened to things after `since_ns`, or all that is remembered."""

    since_ns: Annotated[int, Field(ge=-(2**63), lt=2**63)] | None = None


class EventsReply(Message):
    """Events, oldest first."""

    events: tuple[Event, ...]


class TellReply(Message):
    """Whether the statement holds from now on, and the graph's revision with it."""

    accepted: bool
    revision: int
    problem: Problem | None = None


class ObservationReply(Message):
    """To an observation that was sent as a query: whether it has been mapped, and the revision with it."""

    accepted: bool
    revision: int
    changed: int = 0
    problem: Problem | None = None


# -- maps ----------------------------------------------------------------------------------------------------


class MapQuery(Message):
    """Points (N, 3) in `map` [m]; `gradient` of distance layers."""

    points: PointRows
    gradient: bool = False


class MapValues(Message):
    """A value a point; where `known` is false nothing was ever observed and the value means nothing.

    occupancy: probability; tsdf, esdf: signed distance [m]; semantics: class id, with `confidence`, `instance` (0: of
    none) and `observed`: where `known` is false, whether something was observed there, only without a label;
    instances: number of the instance
    """

    layer: str
    values: ValueColumn
    known: KnownColumn
    confidence: FloatColumn | None = None
    gradient: VectorRows | None = None
    instance: ValueColumn | None = None
    observed: KnownColumn | None = None


# -- health --------------------------------------------------------------------------------------------------


class Refusal(Problem):
    """A problem that was put on `problems`: where the message came in, and how often this cause was met so far."""

    source: str
    count: int = 1


class Problems(Message):
    """The causes of refusal so far, latest last."""

    problems: tuple[Refusal, ...] = ()


class Counts(Message):
    """What became of the messages of one input: every one received is taken, dropped, refused or waiting."""

    received: int = 0
    taken: int = 0
    dropped: int = 0
    refused: int = 0
    waiting: int = 0


class Status(Message):
    """Health of a server.

    busy_s    how long the world's thread has been at its present job [s]
    inputs    by `robot/sensor/kind`;  waiting: by queue;  requests: by verb, counts and times [ms]
    bounds    how much may wait, and what one message may hold
    problems  how many puts were refused
    state     the world's own status: layers, nodes, times
    """

    world: str
    service: str
    version: str
    api: str
    revision: int
    uptime_s: float
    busy_s: float
    inputs: dict[str, Counts]
    waiting: dict[str, int]
    requests: dict[str, dict[str, float]]
    bounds: dict[str, float]
    problems: int
    state: dict[str, Any]


# -- the table, and bytes ------------------------------------------------------------------------------------

_OWN: tuple[type[BaseModel], ...] = (
    AskRequest,
    AskReply,
    WatchRequest,
    WatchReply,
    WatchAnswers,
    WhereRequest,
    WhereReply,
    PlanRequest,
    PlanReply,
    TellRequest,
    TellReply,
    EventsRequest,
    EventsReply,
    ObservationReply,
    MapQuery,
    MapValues,
    Refusal,
    Problems,
    Problem,
    Status,
    Node,
    Edge,
    Delta,
    Snapshot,
)

MODELS: dict[str, type[BaseModel]] = {
    **cast("dict[str, type[BaseModel]]", OBSERVATIONS),
    **{model.__name__: model for model in _OWN},
}
"""Every model that may travel, by the name its encoding carries."""

_WITH_ARRAYS = (Observation, MapQuery, MapValues)
_LARGE = (Value, AskReply)


def plain(value: Any) -> Any:
    """`value` with models as mappings, poses in their wire form and tuples as lists; arrays stay. None fields are left
    out of models that hold arrays."""
    if isinstance(value, _WITH_ARRAYS):
        return {
            name: plain(item)
            for name, item in value.__dict__.items()
            if item is not None and name in type(value).model_fields
        }
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, SE3):
        return {"translation": value.translation.tolist(), "rotation_wxyz": value.quaternion_wxyz.tolist()}
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def encoding_of(message: BaseModel, form: Form) -> str:
    """The encoding to send a message with: `application/cbor;RgbdImage`."""
    return media_type(form, type(message).__name__)


def encode(message: BaseModel, form: Form = "cbor", *, compress: bool = False) -> bytes:
    """A message as bytes. `compress`: its arrays by zstd, for thin lines."""
    if form == "json" and not isinstance(message, _WITH_ARRAYS):
        return message.model_dump_json().encode()
    return dumps(plain(message), form, compress=compress)


def decode(data: bytes, model: str, encoding: str = "", limits: Limits = LIMITS) -> Any:
    """The message of this model that `data` holds.

    Raises `InvalidMessage` for bytes that are not one, and `InvalidObservation` for an observation whose values break
    its contract; both name the field.
    """
    form, told = form_of(encoding, data)
    if told is not None and told != model:
        raise InvalidMessage(f"expected {model}, but the encoding says {told[:60]}", field="encoding")
    kind = MODELS[model]
    try:
        if form == "json" and issubclass(kind, _LARGE):  # without arrays, and from our own server
            return kind.model_validate_json(data)
        value = loads(data, form, limits)
        if not isinstance(value, dict):
            raise InvalidMessage(f"expected {model}, a mapping of its fields, got {type(value).__name__}")
        unknown = next((name for name in value if not isinstance(name, str)), None)
        if unknown is not None:
            raise InvalidMessage(f"{model} has no field {unknown!r}")
        with np.errstate(all="ignore"):  # absurd numbers overflow on their way to being refused
            return kind(**value) if issubclass(kind, Observation) else kind.model_validate(value)
    except InvalidGraphValue as error:
        raise InvalidMessage(str(error)) from None
    except ValidationError as error:
        raise InvalidMessage(one_line(error, model)) from None


class _SchemaGenerator(GenerateJsonSchema):
    """Lets fields refer to `#/$defs/Array`, which no model defines: pydantic follows only references of its own."""

    def generate_inner(self, schema: Any) -> JsonSchemaValue:
        found = super().generate_inner(schema)
        return (
            {_ARRAY: None, **{k: v for k, v in found.items() if k != "$ref"}} if found.get("$ref") == _ARRAY else found
        )


def _with_array_references(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            ("$ref" if k == _ARRAY else k): _ARRAY if k == _ARRAY else _with_array_references(v)
            for k, v in value.items()
        }
    return [_with_array_references(item) for item in value] if isinstance(value, list) else value


@cache
def schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of every model under `$defs`, and the table of keys. The same fields travel in CBOR."""
    models: list[tuple[type[BaseModel], Literal["validation"]]] = [(model, "validation") for model in MODELS.values()]
    _, definitions = models_json_schema(models, ref_template="#/$defs/{model}", schema_generator=_SchemaGenerator)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Messages of the scene graph service",
        "version": keys.PREFIX,
        "keys": [
            {
                "key": f"{keys.PREFIX}/{{world}}/{row.path}",
                "kind": row.kind,
                "request": row.request or None,
                "reply": row.reply or None,
                "priority": row.qos.priority.lower(),
                "congested": row.qos.congested,
            }
            for row in keys.TABLE
        ],
        "$defs": {"Array": ARRAY_SCHEMA, **_with_array_references(definitions["$defs"])},
    }
