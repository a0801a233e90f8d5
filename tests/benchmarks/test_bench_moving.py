"""A robot drives through a room: what each policy leaves of it in the map, how well it is followed, at what cost.

Run with `make bench`. 640×480 images at 10 Hz of a box of 0.5 × 0.35 × 0.8 m from 2.5 m, depth with the noise of
structured light, masks that bleed by 5 px; voxels of 5 and 2.5 cm.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.support.movers import HZ, Mover, Stage, straight, turning, wanders
from tests.support.racing import Table
from tests.support.rooms import LARGE_CAMERA

SECONDS = 5.0


@pytest.mark.parametrize("way", [straight, turning], ids=["straight", "turning"])
def test_policies(benchmark: BenchmarkFixture, table: Table, way: object) -> None:
    mover = Mover(way)  # type: ignore[arg-type]
    stages = {
        policy: Stage((mover,), policy, noisy=True, camera=LARGE_CAMERA, bleed_px=5)
        for policy in ("fuse", "leave_out", "model")
    }
    spent: dict[str, list[float]] = {policy: [] for policy in stages}
    alone: list[float] = []
    followed = stages["model"].map.moving

    def watch() -> None:
        for n in range(round(SECONDS * HZ)):
            image = stages["model"].image(1.0 + n / HZ)
            for policy, stage in stages.items():
                start = time.process_time()
                stage.take(image)
                spent[policy].append(1e3 * (time.process_time() - start))
                stage.t = 1.0 + (n + 1) / HZ

    integrate = followed.integrate_image

    def timed(*args: object) -> object:
        start = time.process_time()
        change = integrate(*args)  # type: ignore[arg-type]
        alone.append(1e3 * (time.process_time() - start))
        return change

    followed.integrate_image = timed  # type: ignore[assignment,method-assign]
    benchmark.pedantic(watch, rounds=1)
    (thing,) = followed.things.values()
    stamps, poses = thing.trajectory
    off_m, off_deg = wanders(poses, [mover.pose(1e-9 * t) for t in stamps.tolist()])
    now = thing.last_seen_ns
    surface = np.abs(mover.outside(thing.points_at(now), 1e-9 * now))
    table.notes.append(f"a robot drives {way.__name__}, {len(stamps)} images:")  # type: ignore[attr-defined]
    table.notes.append("  policy      occupied voxels left behind   at the robot   labelled robot   ms an image")
    for policy, stage in stages.items():
        behind, at_mover = stage.trail()
        table.notes.append(
            f"  {policy:<10s}  {behind:<28d}  {at_mover:<13d}  {stage.labelled('robot'):<15d}  "
            f"{np.median(spent[policy]):.1f}"
        )
    table.notes.append(
        f"  followed: off by {1e3 * np.median(off_m):.0f} mm and {np.median(off_deg):.1f}° (median), "
        f"{1e3 * off_m.max():.0f} mm and {off_deg.max():.1f}° (most); {thing.fused} of {thing.views} images fused; "
        f"its surface {1e3 * np.median(surface):.0f} mm from the true one (median), "
        f"{1e3 * np.quantile(surface, 0.95):.0f} mm (95 %); {np.median(alone):.1f} ms of each image"
    )
    table.notes.append(
        f"  box {' × '.join(f'{s:.2f}' for s in thing.box.size)} m; "
        f"{thing.model.memory_bytes / 1e6:.1f} MB; velocity {thing.motion.velocity[:2].round(2).tolist()} m/s"
    )
    assert stages["model"].trail() == (0, 0)
    assert off_m.max() < 0.06
