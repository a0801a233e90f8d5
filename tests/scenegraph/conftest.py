"""The small home, mapped once for all tests that only look, and copies of it for those that change it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from scenegraph.world import World


@pytest.fixture(scope="session")
def home() -> Iterator[World]:
    """The small home after the whole tour; tests must not change it."""
    from tests.support import small_home

    with small_home.new_world() as world:
        for observation in small_home.observations():
            world.integrate(observation)  # type: ignore[arg-type]
        yield world


@pytest.fixture(scope="session")
def home_file(home: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small home on disk."""
    path = tmp_path_factory.mktemp("home") / "home.world"
    home.save(path)
    return path


@pytest.fixture(scope="module")
def copy_home(home_file: Path) -> Iterator[Callable[[], World]]:
    """Gives worlds of one's own, closed at the end of the module."""
    from scenegraph.world import World

    worlds: list[World] = []

    def copy() -> World:
        worlds.append(World.load(home_file))
        return worlds[-1]

    yield copy
    for world in worlds:
        world.close()
