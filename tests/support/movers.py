"""A room in which boxes drive and turn on known ways, seen by a camera that knows what they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import binary_dilation

from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import ijk_to_centre
from mapping.layered import LayeredMap, MapChange
from mapping.observations import RgbdImage
from tests.support.scenes import CAMERA, Block, Scene, looking_at, shell

ROOM = tuple(shell((-3.0, -3.0), (3.0, 3.0)))
EYE, TARGET = (0.0, -2.5, 1.4), (0.0, 0.3, 0.4)
HZ = 10
VOXEL, FINE = 0.05, 0.025
LABELS = ("floor", "ceiling", "wall", "robot", "cat", "shelf")


@dataclass(frozen=True)
class Mover:
    """A box on its way: `way` gives x, y, yaw at each time [s]; `lift` [m] is how high above the floor it is."""

    way: Callable[[float], tuple[float, float, float]]
    size: tuple[float, float, float] = (0.5, 0.35, 0.8)
    label: str = "robot"
    thing: int = 1
    lift: float = 0.0

    def block(self, t: float) -> Block:
        x, y, yaw = self.way(t)
        return Block(self.label, (x, y, self.lift + 0.5 * self.size[2]), self.size, self.thing, yaw)

    def pose(self, t: float) -> SE3:
        """T_map_box, the origin in the middle."""
        x, y, yaw = self.way(t)
        return SE3(SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, yaw]).rotation, (x, y, self.lift + 0.5 * self.size[2]))

    def outside(self, points: np.ndarray, t: float) -> np.ndarray:
        """Signed distance (N,) [m] to its surface, positive outside."""
        q = np.abs(self.pose(t).inverse() @ points.astype(np.float64)) - 0.5 * np.array(self.size)
        return np.where(q.max(axis=1) > 0.0, np.linalg.norm(np.maximum(q, 0.0), axis=1), q.max(axis=1))


def straight(t: float) -> tuple[float, float, float]:
    return -1.2 + 0.4 * t, 0.0, 0.0


def turning(t: float) -> tuple[float, float, float]:
    return -1.2 + 0.4 * t, 0.3 * np.sin(0.8 * t), 0.5 * t


@dataclass
class Stage:
    """What a world with one of the policies makes of movers."""

    movers: tuple[Mover, ...]
    policy: str = "model"
    noisy: bool = False
    extra: tuple[Block, ...] = ()
    camera: CameraIntrinsics = CAMERA
    bleed_px: int = 0
    t: float = 0.0
    changes: list[MapChange] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.map = LayeredMap(
            voxel_size_m=VOXEL, instance_voxel_size_m=FINE, max_range_m=6.0, label_range_m=5.0,
            follow_moving=self.policy == "model",
        )  # fmt: skip
        self.rng = np.random.default_rng(0)
        self.moving, self.things = np.zeros(1 << 16, bool), np.zeros(1 << 16, bool)
        self.moving[[LABELS.index("robot") + 1, LABELS.index("cat") + 1]] = True
        self.things[LABELS.index("robot") + 1 :] = True

    def image(self, t: float, hide: Iterable[int] = (), eye: tuple[float, float, float] = EYE) -> RgbdImage:
        scene = Scene((*ROOM, *self.extra, *(mover.block(t) for mover in self.movers)))
        image = scene.image(looking_at(eye, TARGET), round(1e9 * t), hide=hide, camera=self.camera)
        ids = np.array([0, *(LABELS.index(label) + 1 for label in scene.classes)], np.uint16)
        labels, instances, depth = ids[image.labels], image.instances, image.depth
        for mover in self.movers if self.bleed_px else ():
            wide = binary_dilation(instances == mover.thing, iterations=self.bleed_px)
            labels = np.where(wide, np.uint16(LABELS.index(mover.label) + 1), labels)
            instances = np.where(wide, np.uint32(mover.thing), instances)
        if self.noisy:
            noise = (0.0012 + 0.0019 * (depth - 0.4) ** 2) * self.rng.normal(size=depth.shape)
            depth = np.where(depth > 0.0, depth + noise, 0.0).astype(np.float32)
        return image.model_copy(update={"labels": labels, "instances": instances, "depth": depth})

    def take(self, image: RgbdImage) -> MapChange:
        assert image.T_map_camera is not None
        moving = None if self.policy == "fuse" else self.moving
        self.changes.append(self.map.integrate_image(image, image.T_map_camera, self.things, moving))
        return self.changes[-1]

    def run(self, seconds: float, *, missed: float = 0.0, hide: Iterable[int] = ()) -> None:
        """Images at HZ; of each the masks of all movers are missed with this probability."""
        for _ in range(round(HZ * seconds)):
            away = [m.thing for m in self.movers] if self.rng.random() < missed else list(hide)
            self.take(self.image(self.t, away))
            self.t = round(self.t + 1.0 / HZ, 6)

    @property
    def last(self) -> float:
        """When the last image was taken [s]."""
        return self.t - 1.0 / HZ

    def trail(self) -> tuple[int, int]:
        """Occupied voxels of the static map in the air of the room: far from all movers, and at one of them."""
        n = round(2.8 / VOXEL)
        axis = np.arange(-n, n)
        voxels = np.stack(np.meshgrid(axis, axis, np.arange(2, 44), indexing="ij"), axis=-1).reshape(-1, 3)
        centres = ijk_to_centre(voxels, VOXEL)
        occupied = centres[self.map.occupancy.query(centres) >= 0.5]
        for block in self.extra:
            standing = Mover(lambda _, b=block: (b.center[0], b.center[1], b.yaw), block.size)
            occupied = occupied[standing.outside(occupied, 0.0) > 2.0 * VOXEL]
        away = np.min([mover.outside(occupied, self.last) for mover in self.movers], axis=0) > 2.0 * VOXEL
        return int(away.sum()), int((~away).sum())

    def labelled(self, label: str) -> int:
        """Voxels of the semantic map that hold a class."""
        store = self.map.semantics.store
        centres = ijk_to_centre(store.ijk(store.cells()), FINE)
        return int((self.map.semantics.query(centres)[0] == LABELS.index(label) + 1).sum())


def wanders(poses: list[SE3], truth: list[SE3]) -> tuple[np.ndarray, np.ndarray]:
    """How far (n,) [m] and turned (n,) [°] each pose is from the true one, given that both begin at one place: a model
    has its frame where the thing was first seen."""
    offset = poses[0].inverse() @ truth[0]
    off = np.array([((pose @ offset).inverse() @ true).log() for pose, true in zip(poses, truth, strict=True)])
    return np.linalg.norm(off[:, :3], axis=1), np.rad2deg(np.linalg.norm(off[:, 3:], axis=1))
