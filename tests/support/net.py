"""Loopback ports, small observations, and waiting for what comes."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np

from mapping.geometry import SE3, CameraIntrinsics
from mapping.observations import RgbdImage


def free_endpoint() -> str:
    """A loopback endpoint that nothing listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def eventually(claim: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    """Whether the claim comes true in time."""
    until = time.monotonic() + timeout_s
    while not claim():
        if time.monotonic() > until:
            return False
        time.sleep(0.005)
    return True


def small_image(stamp_ns: int = 1, robot: str = "spot", sensor: str = "camera", size: int = 8) -> RgbdImage:
    """A wall 2 m in front of a camera at the origin."""
    return RgbdImage(
        stamp_ns=stamp_ns,
        robot=robot,
        sensor=sensor,
        depth=np.full((size, size), 2.0, np.float32),
        intrinsics=CameraIntrinsics(fx=size, fy=size, cx=size / 2, cy=size / 2, width=size, height=size),
        T_map_camera=SE3.identity(),
    )
