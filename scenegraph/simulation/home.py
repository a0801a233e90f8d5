"""A simulated home: its rooms and things, the truth about them, and what a robot sees there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mapping.geometry import SE3
from mapping.observations import LabelSpace, Observation, Scan
from scenegraph.simulation.arrangement import Placed
from scenegraph.simulation.floorplan import DoorKind, FloorPlan
from scenegraph.simulation.noise import Noise
from scenegraph.simulation.shapes import Array, Color
from scenegraph.simulation.structure import TruePlane

if TYPE_CHECKING:
    from scenegraph.simulation.relations import Relation
    from scenegraph.simulation.rendering import Lidar, Renderer
    from scenegraph.simulation.tour import Tour
    from scenegraph.simulation.truth import TruthRecorder


@dataclass(frozen=True)
class TrueRoom:
    """A room: its free floor between the walls as a polygon (K, 2) in map [m], counter-clockwise."""

    id: str
    kind: str
    footprint: Array
    floor_z: float
    ceiling_z: float


@dataclass(frozen=True, eq=False)
class TrueObject:
    """A thing: its mesh in map (vertices (N, 3) [m], triangles (M, 3)) and the box that fits it in its own orientation.

    room       id of the room it was put in
    support    id of the thing it was put on or in; None for the floor or a wall
    container  whether things of its class hold others
    """

    id: str
    label: str
    vertices: Array
    triangles: Array
    colors: Array
    center: Array
    size: Array
    rotation_wxyz: Array
    yaw: float
    room: str
    support: str | None
    container: bool


@dataclass(frozen=True)
class TrueDoor:
    """A door, a doorway without a leaf, or a wide opening, between `rooms` (one, for the front door).

    center (3,) and width, height [m] of the hole; normal (3,) horizontal, into the first room
    """

    id: str
    kind: DoorKind
    rooms: tuple[str, ...]
    center: Array
    width: float
    height: float
    normal: Array


@dataclass(frozen=True)
class TrueWindow:
    """A window: center (3,), width, height [m] of its pane, and the horizontal normal (3,) into its room."""

    id: str
    room: str
    center: Array
    width: float
    height: float
    normal: Array


@dataclass(frozen=True, eq=False)
class Change:
    """How a home came of another, drawn with `seed`: ids of the things removed, moved (these keep theirs) and added."""

    before: Home
    seed: int
    removed: frozenset[str]
    moved: frozenset[str]
    added: frozenset[str]


@dataclass(frozen=True, eq=False)
class Home:
    """A home in the map frame; `T_map_home` is the pose of its own axis-aligned frame.

    The triangles of everything lie in one array, structure first: `vertices` (N, 3) float32 [m], `triangles` (M, 3),
    and for each triangle its class id `triangle_class`, its entity `triangle_entity` (1 … as in `entities`; 0 = wall,
    floor, ceiling), its true plane `triangle_plane` (-1 = none) and its colour. `tints` are the colours of walls and
    floor by room, `change` tells what became of another home, when this one came of it. Pickled as its seeds.
    """

    seed: int
    yaw: float
    T_map_home: SE3
    plan: FloorPlan
    placed: tuple[Placed, ...]
    tints: Mapping[str, tuple[Color, Color]]
    rooms: tuple[TrueRoom, ...]
    objects: tuple[TrueObject, ...]
    doors: tuple[TrueDoor, ...]
    windows: tuple[TrueWindow, ...]
    structure: tuple[TruePlane, ...]
    label_space: LabelSpace
    vertices: Array
    triangles: Array
    triangle_class: Array
    triangle_entity: Array
    triangle_plane: Array
    triangle_color: Array
    entities: tuple[str, ...]
    change: Change | None = None

    @cached_property
    def class_ids(self) -> dict[str, int]:
        """Class name → id in the label space."""
        return {info.name: key for key, info in self.label_space.classes.items()}

    @cached_property
    def renderer(self) -> Renderer:
        """Casts rays at the home; built on first use."""
        from scenegraph.simulation.rendering import Renderer

        return Renderer(self)

    def thing(self, object_id: str) -> TrueObject:
        """The thing of that id; `KeyError` when there is none."""
        return self._by_id[object_id]

    @cached_property
    def _by_id(self) -> dict[str, TrueObject]:
        return {o.id: o for o in self.objects}

    def relations(self) -> frozenset[Relation]:
        """All (relation, a, b) that hold: `on`, `in` (a thing, or a room), `above`, `attached_to` and `hanging_from` (a
        thing, or a true plane); `near`, `next_to` and `touching` with a < b. Found once."""
        return frozenset(self.relation_values)

    @cached_property
    def relation_values(self) -> dict[Relation, float]:
        """What was measured of each relation that holds: a share, a rise or a gap [m]."""
        from scenegraph.simulation.relations import true_relations

        return true_relations(self)

    def nearest_class(self, points: Array) -> Array:
        """Class id (N,) uint16 of the true surface closest to each point (N, 3) in map [m]."""
        return np.asarray(self.triangle_class[self.renderer.scene.closest(points)[0]])

    def observe(
        self,
        *,
        noise: Noise = "realistic",
        seed: int = 0,
        rate_hz: float = 2.0,
        images_per_room: int = 30,
        tour: Tour | None = None,
        recorder: TruthRecorder | None = None,
        start_ns: int = 1_000_000_000,
    ) -> Iterator[Observation]:
        """What a robot on a tour sees: `LabelSpace`, `RobotDescription`, then a step an `AgentPose` and an `RgbdImage`.

        Images are rendered one at a time, as they are asked for, the first at `start_ns`. `recorder` learns what was
        truly seen.
        """
        from scenegraph.simulation.observing import observe

        return observe(
            self, noise=noise, seed=seed, rate_hz=rate_hz, images_per_room=images_per_room, tour=tour,
            recorder=recorder, start_ns=start_ns,
        )  # fmt: skip

    def scan(
        self,
        T_map_sensor: SE3,
        *,
        noise: Noise = "realistic",
        seed: int = 0,
        stamp_ns: int = 0,
        lidar: Lidar | None = None,
    ) -> Scan:
        """One turn of a rotating lidar (64 × 1024 beams unless told otherwise) at its true pose, with labels."""
        from scenegraph.simulation.observing import scan

        return scan(self, T_map_sensor, noise=noise, seed=seed, stamp_ns=stamp_ns, lidar=lidar)
