"""Two rooms with a door between them and six things, seen by a perfect camera: a world that is mapped in seconds.

The kitchen lies left of x = 3, the bedroom right of it. Oven and bed stand back to back at the wall between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from mapping.geometry import SE3
from mapping.observations import AgentPose, RgbdImage
from scenegraph.config import WorldConfig
from scenegraph.world import World
from tests.support.scenes import Block, Scene, looking_at, shell, table

TABLE, VASE, BOOK, OVEN, BED, STOOL = range(1, 7)
WALL_BETWEEN = [
    Block("wall", (3.1, 1.1, 1.2), (0.2, 2.2, 2.4)),
    Block("wall", (3.1, 3.25, 1.2), (0.2, 0.3, 2.4)),
    Block("wall", (3.1, 2.65, 2.2), (0.2, 0.9, 0.4)),
]
SCENE = Scene(
    (
        *shell((0.0, 0.0), (6.4, 3.4)),
        *WALL_BETWEEN,
        *table(1.0, 2.3, TABLE, yaw=0.3),
        Block("vase", (0.9, 2.15, 0.84), (0.12, 0.12, 0.2), VASE),
        Block("book", (1.25, 2.4, 0.765), (0.28, 0.2, 0.05), BOOK, 0.5),
        Block("oven", (2.7, 0.5, 0.45), (0.58, 0.6, 0.9), OVEN),
        Block("bed", (4.1, 0.6, 0.25), (1.78, 1.0, 0.5), BED),
        Block("stool", (5.5, 2.6, 0.22), (0.36, 0.36, 0.44), STOOL),
    )
)
CENTRES = {
    TABLE: (1.0, 2.3),
    VASE: (0.9, 2.15),
    BOOK: (1.25, 2.4),
    OVEN: (2.7, 0.5),
    BED: (4.1, 0.6),
    STOOL: (5.5, 2.6),
}
ON = {("vase", "table"), ("book", "table"), ("table", "floor"), ("oven", "floor"), ("bed", "floor"), ("stool", "floor")}
KITCHEN, BEDROOM = (1.5, 1.4), (4.8, 1.9)
BEDROOM_EYE = (5.0, 1.7, 1.3)


def poses() -> list[SE3]:
    """Round views in both rooms, views of the things on the table, and the way through the door."""
    found = []
    for x, y in (KITCHEN, BEDROOM):
        for yaw in np.arange(8) * np.pi / 4:
            for tilt in (-0.75, 0.0):
                eye = (x - 0.25 * np.cos(yaw), y - 0.25 * np.sin(yaw), 1.3)
                found.append(looking_at(eye, (x + np.cos(yaw), y + np.sin(yaw), 1.3 + tilt)))
    over_the_table = ((2.1, 2.6, 1.3), (1.0, 1.2, 1.25), (0.3, 1.4, 1.4), (1.9, 1.7, 1.2))
    found += [looking_at(eye, (1.0, 2.3, 0.8)) for eye in over_the_table]
    found += [looking_at(eye, (1.0, 2.3, 0.4)) for eye in ((2.5, 2.5, 0.5), (1.0, 0.8, 0.5), (2.1, 1.2, 0.5))]
    for eye, target in (
        ((2.2, 2.6, 1.3), (3.4, 2.6, 0.6)),
        ((4.0, 2.6, 1.3), (2.6, 2.6, 0.6)),
        (BEDROOM_EYE, (5.5, 2.6, 0.2)),
    ):
        found.append(looking_at(eye, target))
    return found


def stamp(n: int) -> int:
    return (n + 1) * 100_000_000


@cache
def images() -> tuple[RgbdImage, ...]:
    """What the camera sees on its way, in order."""
    return tuple(SCENE.image(pose, stamp(n)) for n, pose in enumerate(poses()))


def observations(*, agent: bool = True) -> Iterator[object]:
    """Everything that is published on the way."""
    yield SCENE.label_space
    yield from images()
    if agent:
        yield robot_at(*KITCHEN, stamp(len(images())))


def robot_at(x: float, y: float, stamp_ns: int) -> AgentPose:
    return AgentPose(stamp_ns=stamp_ns, robot="rob", T_map_base=SE3(np.eye(3), (x, y, 0.0)))


def new_world() -> World:
    return World(WorldConfig())


def id_of(world: World, label: str) -> str:
    """The one node of a class."""
    [node] = [n for layer in ("object", "structure") for n in world.graph.nodes(layer, label=label)]
    return node.id


def room_at(world: World, place: tuple[float, float]) -> str:
    """The room at a place of the ground."""
    [room] = world.perception.rooms.shares(np.array([place]), 0.0)
    return room
