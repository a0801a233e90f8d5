"""The server: a world on the wire.

One thread owns the world and does one job after another from bounded queues (`intake`); another owns the copy of the
graph that others read and publishes its changes (`feed`); a few encode and send replies. Zenoh's callbacks only hand
over. Nothing that a client sends may stop the server, corrupt the world or go unanswered: whatever fails becomes a
`Problem`, in an error reply to a request, on `problems` for a bare put.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol, Self

import zenoh
from pydantic import BaseModel

from scenegraph.events import Event
from scenegraph.graph import Delta, SceneGraph
from scenegraph.service import exports, keys, replies
from scenegraph.service.arrays import LIMITS, Limits
from scenegraph.service.errors import EndpointUnavailable, InvalidMessage, Overloaded, ServiceError
from scenegraph.service.feed import GraphFeed
from scenegraph.service.health import Causes, RequestTimes
from scenegraph.service.intake import Bounds, Intake, Job, Tally
from scenegraph.service.messages import (
    AskRequest,
    EventsReply,
    EventsRequest,
    MapQuery,
    ObservationReply,
    Problems,
    Status,
    TellRequest,
    WhereRequest,
    decode,
    encode,
    encoding_of,
    schema,
)
from scenegraph.service.planning import PlanRequests
from scenegraph.service.sender import Sender, problem_told, reply_form
from scenegraph.service.session import DEFAULT_ENDPOINT, session_config
from scenegraph.service.watch_desk import WatchDesk

__all__ = ["ServedWorld", "Server"]

log = logging.getLogger(__name__)

_STATUS_EVERY_S = 0.5


class ServedWorld(Protocol):
    """What the server needs of a world. One thread calls it."""

    @property
    def graph(self) -> SceneGraph: ...
    @property
    def map(self) -> Any: ...
    def integrate(self, observation: Any, /) -> Delta: ...
    def ask(self, goal: str, /, *, robot: str | None, limit: int, timeout_s: float, at_ns: int | None) -> Any: ...
    def where(self, phrase: str, /, *, robot: str | None) -> Any: ...
    def planning(self, goal: str, /, *, robot: str | None, timeout_s: float) -> Any: ...
    def tell(self, statement: str, /, *, author: str, reason: str) -> Any: ...
    def events(self, since_ns: int | None, /) -> list[Event]: ...
    def status(self) -> dict[str, Any]: ...


class Server:
    """Serves one world under `scenegraph/v1/{name}/`.

    world          handed over to the server's thread until `stop`; not closed by it
    name           `[a-z][a-z0-9_]*`
    endpoint       where to listen; loopback unless told otherwise
    connect        further endpoints (routers, other servers) to connect to
    bounds         how much may wait (`Bounds`);  limits: what one message may hold (`Limits`)
    max_timeout_s  no question may take longer, whatever it asks for

    A context manager; `run` serves until `stop` is called. Raises `EndpointUnavailable` when it cannot listen.
    """

    def __init__(
        self,
        world: ServedWorld,
        name: str,
        *,
        endpoint: str = DEFAULT_ENDPOINT,
        connect: Sequence[str] = (),
        service: str = "server",
        bounds: Bounds | None = None,
        limits: Limits = LIMITS,
        max_timeout_s: float = 10.0,
    ) -> None:
        self.name = keys.chunk(name, "world")
        self.endpoint = endpoint
        self._world = world
        self._connect = tuple(connect)
        self._service = keys.chunk(service, "service")
        self._bounds = bounds or Bounds()
        self._limits = limits
        self._max_timeout_s = max_timeout_s
        self._prefix = keys.key(self.name)
        self._tally = Tally()
        self._intake = Intake(self._bounds, self._tally)
        self._times = RequestTimes()
        self._causes = Causes()
        self._stopping = threading.Event()
        self._asked_to_stop = False
        self._life = threading.Lock()
        self._began = time.monotonic()
        self._busy_since: float | None = None
        self._world_status: dict[str, Any] = {}
        self._status_at, self._status_stale = 0.0, True
        self._session: zenoh.Session | None = None

    # -- life ----------------------------------------------------------------------------------------------------

    def start(self) -> Self:
        """Listen, and begin to work."""
        message_bytes = 2 * self._limits.message_bytes
        config = session_config("peer", listen=[self.endpoint], connect=self._connect, message_bytes=message_bytes)
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise EndpointUnavailable(
                f"cannot listen at {self.endpoint}: {str(error).split(' at /')[0][:200]}",
                hint="another server may run there already: choose another endpoint",
            ) from None
        self._session = session
        self._sender = Sender(self.name, session, self._bounds.replies)
        self._plans = PlanRequests(self._world, self._intake, self._sender, self._times, self._max_timeout_s)
        self._refresh_status()
        self._feed = GraphFeed(self.name, self._world.graph.snapshot(), self._sender.put)
        self._desk = WatchDesk(self._world, self.name, self._sender.put)
        self._feed.start()
        self._desk.start()
        self._worker = threading.Thread(target=self._work, name="world", daemon=True)
        self._worker.start()
        session.declare_queryable(self._prefix + "/**", self._on_query)
        session.declare_subscriber(self._prefix + "/**", self._on_put, allowed_origin=zenoh.Locality.REMOTE)
        self._token = session.liveliness().declare_token(keys.alive(self.name, self._service))
        log.info("serving %s at %s", self.name, self.endpoint)
        return self

    def stop(self, timeout_s: float = 20.0) -> None:
        """Take nothing more in, work off what is waiting, and end. Safe to call twice, and from several threads."""
        with self._life:
            session = self._session
            if session is None or self._stopping.is_set():
                self._stopping.set()
                return
            self._token.undeclare()  # type: ignore[no-untyped-call]
            self._stopping.set()
            self._intake.wake()
            self._worker.join(timeout_s)
            self._desk.stop()
            self._feed.stop()
            self._plans.close()
            self._sender.close()
            session.close()  # type: ignore[no-untyped-call]
            log.info("stopped serving %s", self.name)

    def run(self) -> None:
        """Serve until `stop` or `request_stop` is called or the program is interrupted."""
        if self._session is None:
            self.start()
        try:
            while not (self._asked_to_stop or self._stopping.wait(0.2)):
                pass
        finally:
            self.stop()

    def request_stop(self) -> None:
        """Let `run` end; does nothing else, so that a signal handler may call it."""
        self._asked_to_stop = True

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    # -- callbacks: hand over ------------------------------------------------------------------------------------

    def _on_put(self, sample: zenoh.Sample) -> None:
        where = str(sample.key_expr)
        head = where.removeprefix(self._prefix + "/").split("/", 1)[0]
        if head in ("graph", "problems", "answers"):
            return  # what servers put, another one of this world included
        try:
            if head != "in":
                raise keys.unknown_key(self.name, where)
            if sample.kind != zenoh.SampleKind.PUT:
                raise InvalidMessage("a deletion means nothing here: expected an observation to be put")
            self._admit(keys.read_input(self.name, where), sample.payload, str(sample.encoding), None)
        except Exception as error:
            self._refuse(where, error)

    def _on_query(self, query: zenoh.Query) -> None:
        try:
            self._dispatch(query)
        except Exception as error:
            self._sender.problem(query, error)

    def _dispatch(self, query: zenoh.Query) -> None:
        expression = str(query.key_expr)
        parts = expression.split("/")[2:]
        if not parts or parts[0] not in (self.name, "*"):
            query.drop()  # type: ignore[no-untyped-call]
            return
        path = "/".join(parts[1:])
        match parts[1:]:
            case ["ask"]:
                self._by_world(query, path, "AskRequest", self._ask)
            case ["where"]:
                self._by_world(query, path, "WhereRequest", self._where)
            case ["watch"]:
                self._by_world(query, path, "WatchRequest", self._desk.take)
            case ["answers", watch]:
                self._by_world(query, path, None, lambda _: self._desk.answers(watch))
            case ["plan"]:
                self._plans.admit(query, lambda: self._request(query, "PlanRequest"))
            case ["tell"]:
                self._by_world(query, path, "TellRequest", self._tell)
            case ["events"]:
                self._by_world(query, path, "EventsRequest", self._events)
            case ["map", layer, "query"] if layer in keys.MAP_LAYERS:
                self._by_world(query, path, "MapQuery", lambda request: self._map_values(layer, request))
            case ["map", layer] if layer in keys.MAP_LAYERS:
                self._by_world(query, path, None, lambda _: self._map_layer(layer, query))
            case ["graph"]:
                self._sender.soon(query, lambda: self._reply_graph(query))
            case ["graph", "nodes" | "edges", _, *_] | ["graph", "**"] | ["**"]:
                self._sender.soon(query, lambda: self._reply_items(query, f"{self._prefix}/{path}"))
            case ["status"]:
                self._sender.soon(query, lambda: self._sender.reply(query, path, self.status()))
            case ["problems"]:
                self._sender.soon(query, lambda: self._sender.reply(query, path, self.problems()))
            case ["schema"]:
                self._sender.soon(query, lambda: self._reply_schema(query))
            case ["in", *_]:
                stream = keys.read_input(self.name, f"{self._prefix}/{path}")
                if query.payload is None:
                    raise InvalidMessage(f"expected {stream.model} as payload, got none")
                self._admit(stream, query.payload, str(query.encoding or ""), query)
            case _:
                raise keys.unknown_key(self.name, f"{self._prefix}/{path}")

    def _admit(self, stream: keys.Input, payload: zenoh.ZBytes, encoding: str, query: zenoh.Query | None) -> None:
        """Queue an observation. With a query its sender waits for the reply, and it is never dropped."""
        size = len(payload)
        self._tally.add(stream, "received")
        try:
            if size > self._limits.message_bytes:
                raise InvalidMessage(f"expected at most {self._limits.message_bytes} bytes, got {size}")
            if self._stopping.is_set():
                raise Overloaded("the server is stopping")
            job = Job(lambda: self._integrate(stream, payload, encoding, query), size, stream)
            if stream.newest_wins and query is None:
                self._intake.put_image(job)
            else:
                self._intake.put_kept(job)
        except ServiceError:
            self._tally.add(stream, "refused")
            raise

    def _by_world(
        self,
        query: zenoh.Query,
        path: str,
        model: str | None,
        handle: Callable[[Any], BaseModel | Callable[[], None]],
    ) -> None:
        """Let the world's thread handle a request and a worker reply: with the message, or by the function, that
        `handle` returns."""
        if self._stopping.is_set():
            raise Overloaded("the server is stopping")

        def run() -> None:
            began, failed = time.perf_counter(), True
            try:
                if job.waited_s > self._bounds.request_wait_s:
                    raise Overloaded(f"the request waited longer than {self._bounds.request_wait_s:g} s for its turn")
                reply = handle(self._request(query, model) if model else None)
                send = (lambda: self._sender.reply(query, path, reply)) if isinstance(reply, BaseModel) else reply
                self._sender.soon(query, send)
                failed = False
            except Exception as error:
                self._sender.problem(query, error)
            finally:
                elapsed = time.perf_counter() - began
                self._intake.spent_on_request(elapsed)
                self._times.add(path, elapsed, failed)

        job = Job(run)
        self._intake.put_request(job)

    def _request(self, query: zenoh.Query, model: str) -> Any:
        if query.payload is None:
            raise InvalidMessage(
                f"expected {model} as payload, got none", hint=f"its schema is at {self._prefix}/schema"
            )
        return decode(query.payload.to_bytes(), model, str(query.encoding or ""), self._limits)

    # -- the thread that owns the world --------------------------------------------------------------------------

    def _work(self) -> None:
        more = False
        while True:
            job = self._intake.take(0.0 if more else 0.25)
            if job is None:
                if self._stopping.is_set():
                    return
            else:
                self._busy_since = time.monotonic()
                try:
                    job.run()
                except Exception:
                    log.exception("a job failed in an unforeseen way; the server goes on")
                self._busy_since = None
            more = self._follow_watches()
            if self._status_stale and (self._intake.idle or time.monotonic() - self._status_at > _STATUS_EVERY_S):
                self._refresh_status()

    def _follow_watches(self) -> bool:
        """Give the watches their share of time; returns whether they need more."""
        try:
            return self._desk.step(idle=self._intake.idle)
        except Exception:
            log.exception("watched goals could not be asked again; the next change tries anew")
            return False

    def _integrate(self, stream: keys.Input, payload: zenoh.ZBytes, encoding: str, query: zenoh.Query | None) -> None:
        try:
            observation = decode(payload.to_bytes(), stream.model, encoding, self._limits)
            _check_belongs(stream, observation)
            delta = self._world.integrate(observation)
        except Exception as error:
            self._tally.add(stream, "refused")
            self._publish_changes(None)
            if query is None:
                self._refuse(f"{self._prefix}/in/{stream.path}", error)
            else:
                self._sender.problem(query, error)
            return
        self._tally.add(stream, "taken")
        self._publish_changes(delta)
        if query is not None:
            reply = ObservationReply(accepted=True, revision=self._world.graph.revision, changed=len(delta))
            self._sender.soon(query, lambda: self._sender.reply(query, f"in/{stream.path}", reply))

    def _publish_changes(self, delta: Delta | None) -> None:
        """Hand what has changed since the last call to the feed: the delta when it is all of it, else the whole."""
        self._status_stale = True
        graph = self._world.graph
        before = self._feed.revision
        if graph.revision == before:
            return
        if delta is not None and delta and delta.revision == graph.revision == before + 1:
            self._feed.put(delta)
        else:
            self._feed.put(graph.snapshot())

    def _refresh_status(self) -> None:
        try:
            self._world_status = replies.json_value(self._world.status())
        except Exception:
            log.exception("the world could not tell its status")
        self._status_at, self._status_stale = time.monotonic(), False

    # -- verbs, on the world's thread ----------------------------------------------------------------------------

    def _ask(self, request: AskRequest) -> BaseModel:
        began = time.perf_counter()
        answers = self._world.ask(
            request.goal,
            robot=request.robot,
            limit=request.limit,
            timeout_s=min(request.timeout_s, self._max_timeout_s),
            at_ns=request.at_ns,
        )
        elapsed_ms = 1e3 * (time.perf_counter() - began)
        return replies.ask_reply(
            answers,
            revision=self._world.graph.revision,
            elapsed_ms=elapsed_ms,
            explain=request.explain,
            nodes=request.nodes,
        )

    def _where(self, request: WhereRequest) -> BaseModel:
        return replies.where_reply(self._world.where(request.phrase, robot=request.robot), request.phrase)

    def _tell(self, request: TellRequest) -> BaseModel:
        try:
            result = self._world.tell(request.statement, author=request.author, reason=request.reason)
        finally:
            self._publish_changes(None)
        return replies.tell_reply(result)

    def _events(self, request: EventsRequest) -> BaseModel:
        return EventsReply(events=tuple(self._world.events(request.since_ns)))

    def _map_values(self, name: str, request: MapQuery) -> BaseModel:
        return replies.map_values(name, replies.map_layer(self._world, name), request, self._world.map)

    def _map_layer(self, name: str, query: zenoh.Query) -> Callable[[], None]:
        replies.map_layer(self._world, name)
        box = exports.read_box(query.parameters.get("box"))
        form = query.parameters.get("format") or exports.LAYER_FORMATS[name][0]
        copies = exports.Copies(self._world, name, form, box)

        def send() -> None:
            data, encoding = exports.layer_as(name, form, copies)
            self._sender.reply_bytes(query, f"map/{name}", data, encoding)

        return send

    # -- replies -------------------------------------------------------------------------------------------------

    def status(self) -> Status:
        """Health of the server; of the world, what it told last."""
        busy = self._busy_since
        return Status(
            world=self.name,
            service=self._service,
            version=_version(),
            api=keys.PREFIX,
            revision=self._world.graph.revision,
            uptime_s=round(time.monotonic() - self._began, 3),
            busy_s=round(time.monotonic() - busy, 3) if busy is not None else 0.0,
            inputs=self._tally.counts(),
            waiting=self._intake.waiting(),
            requests=self._times.figures(),
            bounds={**vars(self._bounds), **vars(self._limits), "max_timeout_s": self._max_timeout_s},
            problems=self._causes.total,
            state=self._world_status,
        )

    def problems(self) -> Problems:
        """The causes of refusal so far."""
        return Problems(problems=self._causes.all())

    def _reply_graph(self, query: zenoh.Query) -> None:
        data, encoding = exports.graph_as(self._feed.snapshot(), query.parameters.get("format") or "json")
        self._sender.reply_bytes(query, "graph", data, encoding)

    def _reply_items(self, query: zenoh.Query, expression: str) -> None:
        form = reply_form(query)
        for where, item in self._feed.matches(expression):
            query.reply(where, encode(item, form), encoding=encoding_of(item, form))

    def _reply_schema(self, query: zenoh.Query) -> None:
        self._sender.reply_bytes(query, "schema", json.dumps(schema()).encode(), "application/schema+json")

    # -- puts ----------------------------------------------------------------------------------------------------

    def _refuse(self, source: str, error: Exception) -> None:
        """Tell of a refused put, once a cause."""
        refusal = self._causes.add(source, problem_told(error))
        if refusal is not None:
            log.warning("refused %s: %s", source, refusal.message)
            try:
                self._sender.put("problems", keys.key(self.name, "problems"), refusal)
            except zenoh.ZError as failure:
                log.debug("a problem could not be told: %s", failure)


def _check_belongs(stream: keys.Input, observation: Any) -> None:
    """An observation must be of the robot and sensor whose key it came by."""
    for name, told in (("robot", stream.robot), ("sensor", stream.sensor)):
        own = getattr(observation, name, None)
        if own is not None and own != told:
            raise InvalidMessage(f"expected {told!r}, as the key says, got {own!r}", field=f"{stream.model}.{name}")


def _version() -> str:
    try:
        return version("scenegraph-service")
    except PackageNotFoundError:
        return "unknown"
