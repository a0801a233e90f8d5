"""The service on the wire: messages, keys, a server that owns a world, and a client with the world's verbs.

The only place that imports zenoh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenegraph.service.client import Client
    from scenegraph.service.server import Server

__all__ = ["Client", "Server"]


def __getattr__(name: str) -> Any:
    if name == "Client":
        from scenegraph.service.client import Client

        return Client
    if name == "Server":
        from scenegraph.service.server import Server

        return Server
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
