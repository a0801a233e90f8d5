"""Which true thing a node is, by the exact surfaces on which its voxels lie."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scenegraph.graph import Node
from scenegraph.simulation import Home
from scenegraph.world import World

__all__ = ["true_things"]

Array: TypeAlias = NDArray[Any]
SAMPLES = 200
LEAST_SHARE = 0.5


def true_things(world: World, home: Home, nodes: list[Node]) -> dict[str, str]:
    """Node id → id of the thing (or door, window) on whose surface at least half of the node's voxels lie."""
    shapes = world.perception.objects.shapes
    measured = [node.id for node in nodes if node.id in shapes]
    if not measured:
        return {}
    points = [_spread(shapes[i].points) for i in measured]
    entity = home.triangle_entity[home.renderer.scene.closest(np.concatenate(points))[0]]
    found = {}
    for node_id, mine in zip(measured, np.split(entity, np.cumsum([len(p) for p in points])[:-1]), strict=True):
        count = np.bincount(mine, minlength=1)
        count[0] = 0
        if count.max() >= LEAST_SHARE * len(mine):
            found[node_id] = home.entities[int(count.argmax()) - 1]
    return found


def _spread(points: Array) -> Array:
    """At most SAMPLES of the points (N, 3)."""
    some: Array = points[np.linspace(0, len(points) - 1, min(len(points), SAMPLES)).astype(int)]
    return some
