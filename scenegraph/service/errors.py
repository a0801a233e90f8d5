"""What can go wrong between a client and a server.

ServiceError (a SceneGraphError)
├── InvalidMessage       bytes that are not a message of the kind expected here (also a ValueError); `field` says where
├── InvalidKey           a name that cannot be a chunk of a key (also a ValueError)
├── UnknownKey           no such key under this world
├── UnknownWatch         no watch of this name is held, or its lease has run out
├── UnknownWorld         nobody serves this world
├── ServerUnreachable    nothing answers at this endpoint (also a ConnectionError)
├── ServerTimeout        a server is there, but did not reply in time (also a TimeoutError)
├── InvalidEndpoint      not an address at which one could listen or call (also a ValueError)
├── EndpointUnavailable  a server cannot listen where it was told to
├── Overloaded           a bounded queue is full; nothing of the message was kept
└── RemoteProblem        the server replied with a `Problem`; its code, message and hint are kept
"""

from __future__ import annotations

from scenegraph.errors import Problem, SceneGraphError

__all__ = [
    "EndpointUnavailable",
    "InvalidEndpoint",
    "InvalidKey",
    "InvalidMessage",
    "Overloaded",
    "RemoteProblem",
    "ServerTimeout",
    "ServerUnreachable",
    "ServiceError",
    "UnknownKey",
    "UnknownWatch",
    "UnknownWorld",
]


class ServiceError(SceneGraphError):
    """Root of the errors of the wire."""

    code = "service_error"


class InvalidMessage(ServiceError, ValueError):
    """Bytes that are not the message expected here. `field` is the path of the bad field, "" when it is the whole."""

    code = "invalid_message"

    def __init__(self, message: str, *, field: str = "", hint: str | None = None) -> None:
        super().__init__(message, hint=hint)
        self.field = field

    def __str__(self) -> str:
        return f"{self.field}: {self.message}" if self.field else self.message

    def within(self, step: str) -> InvalidMessage:
        """The same error, seen from one level further out."""
        self.field = f"{step}.{self.field}" if self.field else step
        return self


class InvalidKey(ServiceError, ValueError):
    """A name that cannot stand in a key."""

    code = "invalid_key"


class UnknownKey(ServiceError):
    """Nothing is served at this key. The hint names the nearest ones that exist."""

    code = "unknown_key"


class UnknownWatch(ServiceError):
    """No watch of this name is held; a lease that was not renewed ends it."""

    code = "unknown_watch"


class UnknownWorld(ServiceError):
    """Nobody serves this world. The hint names those that are served."""

    code = "unknown_world"


class ServerUnreachable(ServiceError, ConnectionError):
    """Nothing answers at the endpoint."""

    code = "server_unreachable"


class ServerTimeout(ServiceError, TimeoutError):
    """The server did not reply in time."""

    code = "server_timeout"


class InvalidEndpoint(ServiceError, ValueError):
    """What was given as an endpoint is none."""

    code = "invalid_endpoint"


class EndpointUnavailable(ServiceError):
    """The server cannot listen at its endpoint."""

    code = "endpoint_unavailable"


class Overloaded(ServiceError):
    """More is waiting than the server keeps; this message was refused, nothing of it was kept."""

    code = "overloaded"


class RemoteProblem(ServiceError):
    """What a server said could not be done. `code` is the server's, `problem` the whole of it."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.message, hint=problem.hint)
        self.problem = problem
        self.code = problem.code  # type: ignore[misc]
