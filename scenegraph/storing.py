"""A world on disk: what is kept, and how it comes back."""
from __future__ import annotations
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
if TYPE_CHECKING:
    from scenegraph.world import World
W = TypeVar("W")
def save(world: World, path: Path) -> None:
    raise RuntimeError
def load(kind: type[W], path: Path) -> W:
    raise RuntimeError
