"""A world that is served from a store: loaded at the start, kept while it runs, saved at the end."""

from __future__ import annotations

import json
import logging
import signal
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from scenegraph.config import WorldConfig
from scenegraph.errors import InvalidConfig, StoreError
from scenegraph.world import World

__all__ = ["StoredWorld", "read_config", "serve"]


log = logging.getLogger(__name__)


class StoredWorld:
    """A world whose every accepted statement is in the store before it is answered; a context manager.

    save_every_s   while observations come in, the rest is saved at least that often [s]; 0: only at the end
    """

    def __init__(self, world: World, store: Path, *, save_every_s: float = 60.0) -> None:
        self._world = world
        self._store = store
        self._save_every_s = save_every_s
        self._saved_at = time.monotonic()
        self._changed = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._world, name)

    def integrate(self, observation: Any) -> Any:
        """As `World.integrate`; saves from time to time. A save that fails is logged: no observation is to blame."""
        delta = self._world.integrate(observation)
        self._changed = True
        if self._save_every_s and time.monotonic() - self._saved_at > self._save_every_s:
            try:
                self.save()
            except StoreError as error:
                self._saved_at = time.monotonic()
                log.error("the world could not be saved: %s", error)
        return delta

    def tell(self, statement: str, *, author: str, reason: str = "") -> Any:
        """As `World.tell`; what is accepted is saved before it is answered. Raises `StoreError` when it cannot be."""
        told = self._world.tell(statement, author=author, reason=reason)
        if told.accepted:
            self._changed = True
            self.save()
        return told

    def save(self) -> None:
        """Write the world to its store, if anything came in since it was last written."""
        if self._changed:
            self._world.save(self._store)
            self._changed = False
        self._saved_at = time.monotonic()

    def __enter__(self) -> StoredWorld:
        return self

    def __exit__(self, *_: object) -> None:
        self.save()


def read_config(path: Path | None, changes: Mapping[str, Any] | None = None) -> WorldConfig:
    """The configuration in a TOML or JSON file, with changes on top. Raises `InvalidConfig`."""
    fields: dict[str, Any] = {}
    if path is not None:
        try:
            text = path.read_text(encoding="utf-8")
            fields = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
        except OSError as error:
            raise InvalidConfig(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError as error:
            kind = "JSON" if path.suffix == ".json" else "TOML"
            raise InvalidConfig(f"{path}: not a {kind} file ({error})") from None
        if not isinstance(fields, dict):
            raise InvalidConfig(f"{path}: expected names and values, got {type(fields).__name__}")
    return WorldConfig(**{**fields, **{name: value for name, value in (changes or {}).items() if value is not None}})


def serve(
    name: str,
    *,
    endpoint: str | None = None,
    connect: Sequence[str] = (),
    store: Path | None = None,
    config: WorldConfig | None = None,
    save_every_s: float = 60.0,
    started: Callable[[str], object] = lambda endpoint: None,
) -> None:
    """Serve a world until the program is interrupted or told to end (SIGTERM).

    store     where the world is loaded from, if it is there, and saved to; None: it is forgotten at the end
    started   called with the endpoint once the server listens
    """
    from scenegraph.service.server import Server
    from scenegraph.service.session import default_endpoint

    with ExitStack() as stack:
        world: Any = stack.enter_context(World.load(store) if store and store.exists() else World(config))
        if store is not None:
            world = stack.enter_context(StoredWorld(world, store, save_every_s=save_every_s))
        server = stack.enter_context(Server(world, name, endpoint=endpoint or default_endpoint(), connect=connect))
        before = signal.signal(signal.SIGTERM, lambda *_: server.request_stop())
        try:
            started(server.endpoint)
            server.run()
        except KeyboardInterrupt:
            pass  # the usual way to end it
        finally:
            signal.signal(signal.SIGTERM, before)
