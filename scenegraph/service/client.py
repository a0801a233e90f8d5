"""A client: the verbs of `World` against a running server."""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
import zenoh
from numpy.typing import ArrayLike
from pydantic import BaseModel, ValidationError

from mapping.observations import Observation
from reasoning.knowledge import Explanation
from scenegraph.errors import Problem, SceneGraphError, nearest, one_line
from scenegraph.events import Event
from scenegraph.graph import Delta, Mirror, SceneGraph, Snapshot
from scenegraph.service import keys
from scenegraph.service.arrays import LIMITS
from scenegraph.service.codec import Form
from scenegraph.service.errors import (
    InvalidMessage,
    RemoteProblem,
    ServerTimeout,
    ServerUnreachable,
    ServiceError,
    UnknownWorld,
)
from scenegraph.service.messages import (
    AskReply,
    AskRequest,
    EventsReply,
    EventsRequest,
    MapQuery,
    MapValues,
    ObservationReply,
    PlanReply,
    PlanRequest,
    Problems,
    Status,
    TellReply,
    TellRequest,
    WatchRequest,
    WhereReply,
    WhereRequest,
    decode,
    encode,
    encoding_of,
)
from scenegraph.service.remote_watch import RemoteWatch
from scenegraph.service.replies import bound, explanation_of
from scenegraph.service.session import default_endpoint, qos_options, session_config

__all__ = ["Client", "LiveGraph", "RemoteAnswers"]

log = logging.getLogger(__name__)

_M = TypeVar("_M", bound=BaseModel)

_CONNECT_S = 2.0
_GRACE_S = 5.0  # beyond a question's own time: the wait for its turn
_PLAN_GRACE_S = 40.0  # and of a planner, which works on one task at a time and may have to be started


@dataclass(frozen=True)
class RemoteAnswers:
    """Answers of a server. Iterating yields mappings from variable name to a `Node` or a plain value."""

    truth: str
    truncated: bool
    problem: Problem | None
    revision: int
    elapsed_ms: float
    rows: tuple[dict[str, Any], ...]
    _client: Client
    _request: AskRequest

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __bool__(self) -> bool:
        return self.truth == "true"

    def explain(self) -> Explanation | None:
        """Why it holds, or why not: asked of the server now. None when the goal could not be asked."""
        reply = self._client._ask(self._request.model_copy(update={"explain": True}))
        return None if reply.explanation is None else explanation_of(reply.explanation)


class Client:
    """Speaks with the server of one world. A context manager.

    world      name of the world, such as `home`
    endpoint   where its server or a router listens; default: `SCENEGRAPH_ENDPOINT`, else `tcp/127.0.0.1:7447`
    timeout_s  how long to wait for a reply, beyond the time that a question may take by itself

    Raises `ServerUnreachable` when nothing answers there, `UnknownWorld` when no server there has this world. Every
    verb raises `RemoteProblem` with the server's `Problem` when it could not be done.
    """

    def __init__(self, world: str, endpoint: str | None = None, *, timeout_s: float = 10.0) -> None:
        self.world = keys.chunk(world, "world")
        self.endpoint = endpoint or default_endpoint()
        self._timeout_s = timeout_s
        config = session_config(
            "client",
            connect=[self.endpoint],
            message_bytes=4 * LIMITS.message_bytes,
            extra={
                "connect/timeout_ms": int(1e3 * _CONNECT_S),
                "transport/unicast/open_timeout": int(1e3 * _CONNECT_S),
            },
        )
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise ServerUnreachable(
                f"nothing answers at {self.endpoint}",
                hint=f"start a server (scenegraph serve --world {world}) or set SCENEGRAPH_ENDPOINT "
                f"({str(error).split(' at /')[0][:120].strip()})",
            ) from None
        try:
            self._find_world()
        except ServiceError:
            self.close()
            raise

    def close(self) -> None:
        """End the session. Safe to call twice."""
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def worlds(self) -> list[str]:
        """The worlds that are served here."""
        alive = self._session.liveliness().get(keys.alive_everywhere(), timeout=_CONNECT_S)
        return sorted({keys.world_of(str(reply.ok.key_expr)) for reply in alive if reply.ok is not None})

    # -- the verbs of World --------------------------------------------------------------------------------------

    def publish(self, observation: Observation, *, compress: bool = False) -> None:
        """Send an observation, do not wait: images may be dropped for newer ones, refusals are told on `problems`."""
        where = keys.input_key(self.world, observation)
        options = qos_options(keys.qos(keys.row_of(observation)))
        data = encode(observation, "cbor", compress=compress)
        try:
            self._session.put(where, data, encoding=encoding_of(observation, "cbor"), **options)
        except zenoh.ZError as error:
            raise ServerUnreachable(f"the line to {self.endpoint} is closed ({str(error)[:80]})") from None

    def integrate(
        self, observation: Observation, *, compress: bool = False, timeout_s: float = 300.0
    ) -> ObservationReply:
        """Send an observation and wait until it is mapped; none is dropped. The reply tells the graph's revision.

        The very first image on a machine waits for kernels to be compiled, hence the long `timeout_s`; that a server
        has died is noticed at once.
        """
        path = keys.input_key(self.world, observation).removeprefix(keys.key(self.world) + "/")
        return self._call(path, observation, ObservationReply, timeout_s, form="cbor", compress=compress)

    def ask(
        self,
        goal: str,
        *,
        robot: str | None = None,
        limit: int = 100,
        timeout_s: float = 1.0,
        at_ns: int | None = None,
    ) -> RemoteAnswers:
        """Ask a goal, as `World.ask`."""
        fields = {"goal": goal, "robot": robot, "limit": limit, "timeout_s": timeout_s, "at_ns": at_ns, "nodes": True}
        request = _request(AskRequest, fields)
        reply = self._ask(request)
        nodes = {node.id: node for node in reply.nodes or ()}
        return RemoteAnswers(
            truth=reply.truth,
            truncated=reply.truncated,
            problem=reply.problem,
            revision=reply.revision,
            elapsed_ms=reply.elapsed_ms,
            rows=tuple(bound(row, nodes) for row in reply.answers),
            _client=self,
            _request=request,
        )

    def watch(
        self, goal: str, *, robot: str | None = None, limit: int = 100, timeout_s: float = 1.0, lease_s: float = 60.0
    ) -> RemoteWatch:
        """Have a goal kept answered, as `World.watch`: `with client.watch(goal) as changes: for change in changes: …`,
        which waits for each. The server ends the watch `lease_s` after this client was heard of last."""
        fields = {"goal": goal, "robot": robot, "limit": limit, "timeout_s": timeout_s, "lease_s": lease_s}
        if not lease_s > 0.0:
            raise InvalidMessage(f"expected a time > 0 s, got {lease_s!r}", field="WatchRequest.lease_s")
        return RemoteWatch(self, _request(WatchRequest, {**fields, "nodes": True}))

    def where(self, phrase: str, *, robot: str | None = None) -> WhereReply:
        """Where something is, as `World.where`: `.truth`, `.answers[i].nodes/.region/.poses[j].pose`."""
        request = _request(WhereRequest, {"phrase": phrase, "robot": robot})
        return self._call("where", request, WhereReply, request.timeout_s + _GRACE_S)

    def plan(self, goal: str, *, robot: str | None = None, timeout_s: float = 10.0) -> PlanReply:
        """A plan that brings a goal about, as `World.plan`: `.status`, `.steps[i].action/.arguments/.target`."""
        request = _request(PlanRequest, {"goal": goal, "robot": robot, "timeout_s": timeout_s})
        return self._call("plan", request, PlanReply, request.timeout_s + _PLAN_GRACE_S)

    def tell(self, statement: str, *, author: str = "client", reason: str = "") -> TellReply:
        """Tell the world a statement, as `World.tell`."""
        request = _request(TellRequest, {"statement": statement, "author": author, "reason": reason})
        return self._call("tell", request, TellReply, self._timeout_s)

    # -- reading -------------------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """The graph as it is now."""
        data, encoding = self._get("graph", None, self._timeout_s)
        snapshot: Snapshot = decode(data, "Snapshot", encoding)
        return snapshot

    def graph(self) -> SceneGraph:
        """A copy of the graph as it is now; `mirror` gives one that follows."""
        return SceneGraph.from_snapshot(self.snapshot())

    def mirror(self) -> LiveGraph:
        """A copy of the graph that follows the server's until it is closed (a context manager)."""
        return LiveGraph(self)

    def export(self, form: str) -> bytes:
        """The graph in another format: `json, cbor, node_link, spark_dsg, graphml`."""
        return self._get(f"graph?format={form}", None, self._timeout_s)[0]

    def map_layer(self, layer: str, form: str = "npz", box: Sequence[float] | None = None) -> bytes:
        """A map layer as a file; `box`: x0, y0, z0, x1, y1, z1 [m]."""
        corners = "" if box is None else ";box=" + ",".join(f"{float(x):.9g}" for x in box)
        return self._get(f"map/{keys.chunk(layer, 'layer')}?format={form}{corners}", None, 6 * self._timeout_s)[0]

    def map_query(self, layer: str, p_map: ArrayLike, *, gradient: bool = False) -> MapValues:
        """A layer's value at points (N, 3) [m] in map; what is unknown is marked in `.known`."""
        request = MapQuery(points=np.asarray(p_map, dtype=np.float64), gradient=gradient)
        return self._call(f"map/{keys.chunk(layer, 'layer')}/query", request, MapValues, self._timeout_s, form="cbor")

    def events(self, since_ns: int | None = None) -> list[Event]:
        """What happened to things after `since_ns`, oldest first; None: all that the server remembers."""
        return list(self._call("events", EventsRequest(since_ns=since_ns), EventsReply, self._timeout_s).events)

    def status(self) -> Status:
        """Health of the server and of its world."""
        return self._call("status", None, Status, self._timeout_s)

    def problems(self) -> Problems:
        """The causes for which the server refused messages."""
        return self._call("problems", None, Problems, self._timeout_s)

    def schema(self) -> dict[str, Any]:
        """The JSON Schemas that the server serves."""
        document: dict[str, Any] = json.loads(self._get("schema", None, self._timeout_s)[0])
        return document

    # -- the wire ------------------------------------------------------------------------------------------------

    def _ask(self, request: AskRequest) -> AskReply:
        return self._call("ask", request, AskReply, request.timeout_s + _GRACE_S)

    def _call(
        self,
        path: str,
        request: BaseModel | None,
        reply: type[_M],
        timeout_s: float,
        *,
        form: Form = "json",
        compress: bool = False,
    ) -> _M:
        data, encoding = self._get(path, request, timeout_s, form=form, compress=compress)
        message: _M = decode(data, reply.__name__, encoding)
        return message

    def _get(
        self, path: str, request: BaseModel | None, timeout_s: float, *, form: Form = "json", compress: bool = False
    ) -> tuple[bytes, str]:
        """One query, one reply: its bytes and encoding. Raises what went wrong."""
        selector = f"{keys.key(self.world)}/{path}"
        options: dict[str, Any] = {}
        if request is not None:
            options = {"payload": encode(request, form, compress=compress), "encoding": encoding_of(request, form)}
        began = time.monotonic()
        try:
            replies = list(self._session.get(selector, timeout=timeout_s, **options))
        except zenoh.ZError as error:
            raise ServerUnreachable(f"the line to {self.endpoint} is closed ({str(error)[:80]})") from None
        for reply in replies:
            if reply.ok is not None:
                return reply.ok.payload.to_bytes(), str(reply.ok.encoding)
        for reply in replies:
            if reply.err is not None:
                raise _remote_problem(reply.err, timeout_s)
        self._find_world()
        waited = time.monotonic() - began
        raise ServerTimeout(f"the server of {self.world} did not reply to {path.split('?')[0]} within {waited:.1f} s")

    def _find_world(self) -> None:
        """Raise what is wrong when nobody serves this world here."""
        worlds = self.worlds()
        if self.world in worlds:
            return
        if not worlds:
            raise ServerUnreachable(f"nothing answers at {self.endpoint}: no server is alive there")
        near = nearest(self.world, worlds, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UnknownWorld(
            f"nobody serves the world {self.world!r} at {self.endpoint}",
            hint=f"{hint}worlds served: {', '.join(worlds)}",
        )


class LiveGraph:
    """A graph that follows the server's by its deltas, and by a snapshot when it missed one. A context manager.

    `graph` is replaced or changed by a thread of its own; read it inside `with live.lock:` when several reads must fit
    together. `wait_for(revision)` waits until it is at least there.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self.lock = threading.RLock()
        self._changed = threading.Condition(self.lock)
        self._mirror = Mirror(client.snapshot)
        self._queue: queue.SimpleQueue[zenoh.Sample | None] = queue.SimpleQueue()
        self._subscriber = client._session.declare_subscriber(keys.key(client.world, "graph/delta"), self._queue.put)
        self._mirror.resynchronise()
        self._thread = threading.Thread(target=self._follow, name="live-graph", daemon=True)
        self._thread.start()

    @property
    def graph(self) -> SceneGraph:
        """The graph as far as it is known."""
        return self._mirror.graph

    @property
    def n_gaps(self) -> int:
        """How often deltas were missed and a snapshot was asked for."""
        return self._mirror.n_gaps

    def wait_for(self, revision: int, timeout_s: float = 5.0) -> bool:
        """Whether the graph has reached the revision in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._mirror.graph.revision >= revision, timeout_s)

    def resynchronise(self) -> None:
        """Ask for a snapshot now, as after a lost line."""
        with self._changed:
            self._mirror.resynchronise()
            self._changed.notify_all()

    def close(self) -> None:
        """Stop following."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._queue.put(None)
        self._thread.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _follow(self) -> None:
        while (sample := self._queue.get()) is not None:
            try:
                delta: Delta = decode(sample.payload.to_bytes(), "Delta", str(sample.encoding))
                with self._changed:
                    self._mirror.receive(delta)
                    self._changed.notify_all()
            except (SceneGraphError, zenoh.ZError) as error:
                log.warning("a delta could not be followed, the next one will be: %s", error)


def _request(model: type[_M], fields: Mapping[str, Any]) -> _M:
    try:
        return model(**fields)
    except ValidationError as error:
        raise InvalidMessage(one_line(error, model.__name__)) from None


def _remote_problem(reply: zenoh.ReplyError, timeout_s: float) -> ServiceError:
    data = reply.payload.to_bytes()
    try:
        return RemoteProblem(decode(data, "Problem", str(reply.encoding)))
    except InvalidMessage:
        if b"imeout" in data[:40]:
            return ServerTimeout(f"the server did not reply within {timeout_s:g} s")
        return ServiceError(f"the server replied with an error: {data[:200].decode(errors='replace')}")
