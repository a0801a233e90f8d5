"""Zenoh sessions as this service opens them: only the endpoints that were named, nothing found by shouting."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from scenegraph.service.errors import InvalidEndpoint
from scenegraph.service.keys import QualityOfService

__all__ = ["DEFAULT_ENDPOINT", "default_endpoint", "qos_options", "session_config"]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Loopback only: nobody from outside gets in unless told to."""

ENDPOINT_VARIABLE = "SCENEGRAPH_ENDPOINT"


def default_endpoint() -> str:
    """The endpoint from the environment (`SCENEGRAPH_ENDPOINT`), or `tcp/127.0.0.1:7447`."""
    return os.environ.get(ENDPOINT_VARIABLE) or DEFAULT_ENDPOINT


def session_config(
    mode: str,
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    message_bytes: int,
    extra: Mapping[str, Any] | None = None,
) -> zenoh.Config:
    """A configuration without multicast and gossip. `extra`: further settings, by path, as JSON values.

    Raises `InvalidEndpoint`.
    """
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": message_bytes,
        **(extra or {}),
    }
    for path, value in settings.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError:
            if not path.endswith("/endpoints"):
                raise
            raise InvalidEndpoint(
                f"not an endpoint: {', '.join(map(str, value))}", hint="write it as tcp/ADDRESS:PORT"
            ) from None
    return config


_CONGESTION = {"block": zenoh.CongestionControl.BLOCK, "drop": zenoh.CongestionControl.DROP}


def qos_options(qos: QualityOfService) -> dict[str, Any]:
    """The options of `put` and `get` that a quality of service means."""
    return {
        "priority": getattr(zenoh.Priority, qos.priority),
        "congestion_control": _CONGESTION[qos.congested],
        "express": qos.express,
    }
