"""Scenes made of boxes, rendered exactly: depth, classes and instances without a mesh or a ray tracer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import LabelSpace, RgbdImage

CAMERA = CameraIntrinsics(fx=120.0, fy=120.0, cx=99.5, cy=74.5, width=200, height=150)
STUFF = ("wall", "floor", "ceiling")


@dataclass(frozen=True)
class Block:
    """A box of one class, upright, turned by yaw [rad] about its centre; `thing` = 0: surface that is no instance."""

    label: str
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    thing: int = 0
    yaw: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Boxes; the class ids of the label space are given in the order in which classes first appear."""

    blocks: tuple[Block, ...]

    @property
    def classes(self) -> list[str]:
        return list(dict.fromkeys(block.label for block in self.blocks))

    @property
    def label_space(self) -> LabelSpace:
        classes = {
            n + 1: {"name": name, "kind": "stuff" if name in STUFF else "thing"} for n, name in enumerate(self.classes)
        }
        return LabelSpace(classes=classes)

    def id_of(self, label: str) -> int:
        return self.classes.index(label) + 1

    def cast(self, T_map_camera: SE3, camera: CameraIntrinsics = CAMERA) -> tuple[np.ndarray, np.ndarray]:
        """Depth (H, W) float32 [m], 0 where nothing is hit, and the number (H, W) of the box that is hit, from 1."""
        rays = camera.rays().reshape(-1, 3) @ T_map_camera.rotation.T.astype(np.float32)
        depth, hit = np.full(len(rays), np.inf, np.float32), np.zeros(len(rays), np.int64)
        for n, block in enumerate(self.blocks):
            turn = SE3.exp([0, 0, 0, 0, 0, block.yaw]).rotation
            origin = ((T_map_camera.translation - block.center) @ turn).astype(np.float32)
            along = turn.T.astype(np.float32) @ rays.T
            along[np.abs(along) < 1e-9] = 1e-9
            half = 0.5 * np.asarray(block.size, np.float32)
            middle, reach = -origin[:, None] / along, half[:, None] / np.abs(along)
            near, far = (middle - reach).max(axis=0), (middle + reach).min(axis=0)
            met = (near <= far) & (near > 0.05) & (near < depth)
            depth[met], hit[met] = near[met], n + 1
        shape = (camera.height, camera.width)
        return np.where(np.isfinite(depth), depth, 0.0).astype(np.float32).reshape(shape), hit.reshape(shape)

    def image(
        self, T_map_camera: SE3, stamp_ns: int, *, labelled: bool = True, camera: CameraIntrinsics = CAMERA,
        hide: Iterable[int] = (), rename: dict[int, str] | None = None, robot: str = "rob", sensor: str = "camera",
    ) -> RgbdImage:  # fmt: skip
        """What a perfect camera sees. `hide`: things without masks; `rename`: thing → class it is taken for."""
        depth, hit = self.cast(T_map_camera, camera)
        classes = [self.id_of((rename or {}).get(b.thing, b.label)) for b in self.blocks]
        table = np.array([0, *classes], np.uint16)
        things = np.array([0, *(block.thing for block in self.blocks)], np.uint32)
        labels, instances = table[hit], things[hit]
        hidden = np.isin(instances, list(hide)) & (instances > 0)
        labels[hidden], instances[hidden] = 0, 0
        return RgbdImage(
            stamp_ns=stamp_ns,
            robot=robot,
            sensor=sensor,
            depth=depth,
            intrinsics=camera,
            T_map_camera=T_map_camera,
            labels=labels if labelled else None,
            instances=instances if labelled else None,
        )


def looking_at(eye: Sequence[float], target: Sequence[float]) -> SE3:
    """A camera (z forward, x right, y down) at `eye` that looks at `target`, upright."""
    forward = np.subtract(target, eye).astype(np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return SE3(np.stack([right, np.cross(forward, right), forward], axis=1), np.asarray(eye, dtype=np.float64))


def table(x: float, y: float, thing: int, *, yaw: float = 0.0) -> list[Block]:
    """A table: a plate on a pedestal, both one thing."""
    return [
        Block("table", (x, y, 0.72), (1.2, 0.8, 0.04), thing, yaw),
        Block("table", (x, y, 0.35), (0.6, 0.4, 0.7), thing, yaw),
    ]


def shell(low: tuple[float, float], high: tuple[float, float], height: float = 2.4) -> list[Block]:
    """Floor, ceiling and four walls about the ground from `low` to `high`, all outside it."""
    (x0, y0), (x1, y1) = low, high
    x, y, a, b, z = 0.5 * (x0 + x1), 0.5 * (y0 + y1), x1 - x0 + 0.4, y1 - y0 + 0.4, 0.5 * height
    return [
        Block("floor", (x, y, -0.1), (a, b, 0.2)),
        Block("ceiling", (x, y, height + 0.1), (a, b, 0.2)),
        Block("wall", (x0 - 0.1, y, z), (0.2, b, height)),
        Block("wall", (x1 + 0.1, y, z), (0.2, b, height)),
        Block("wall", (x, y0 - 0.1, z), (a, 0.2, height)),
        Block("wall", (x, y1 + 0.1, z), (a, 0.2, height)),
    ]
