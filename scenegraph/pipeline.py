"""Recordings into worlds: files, timing and progress around `integrate`, which knows nothing of them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mapping.errors import InvalidObservation, InvalidParameter, PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import Observation, RgbdImage, Scan

if TYPE_CHECKING:
    from mapping.datasets import Dataset
    from scenegraph.service.client import Client
    from scenegraph.world import World

__all__ = ["Replayed", "every_nth", "open_recording", "record_home", "replay", "sending", "world_for"]

Advance = Callable[[], object]

T_BASE_LIDAR = SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
"""Where a recorded home's lidar stands on the robot."""

REFUSALS = (InvalidObservation, PoseUnavailable)


@dataclass
class Replayed:
    """What became of a recording.

    observations   taken, by kind;  refused: reason → how many
    image_ms       the time of each image and scan in `integrate` [ms]
    elapsed_s      of everything, reading included
    """

    observations: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    image_ms: list[float] = field(default_factory=list)
    elapsed_s: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """Counts and times as plain numbers."""
        median, p99 = np.percentile(self.image_ms, (50, 99)).round(2).tolist() if self.image_ms else (None, None)
        return {
            "observations": dict(self.observations),
            "refused": dict(self.refused),
            "image_ms": {"median": median, "p99": p99},
            "elapsed_s": round(self.elapsed_s, 2),
        }


def replay(
    observations: Iterable[Observation],
    integrate: Callable[[Observation], object],
    *,
    every: int = 1,
    advance: Advance = lambda: None,
) -> Replayed:
    """Play a recording into `integrate` (of a `World`, or `sending(client)`), as if its messages came in live.

    every     only every so-manieth image and scan; poses, classes and the rest are all played
    advance   called after each observation, for a progress bar

    An observation that is refused is counted with its reason and does not stop the others. Raises `DatasetError` when
    the recording is damaged.
    """
    told = Replayed()
    began = time.perf_counter()
    for observation, wanted in every_nth(observations, every):
        if wanted:
            start = time.perf_counter()
            try:
                integrate(observation)
            except REFUSALS as error:
                told.refused[str(error)] += 1
            else:
                told.observations[type(observation).__name__] += 1
                if isinstance(observation, RgbdImage | Scan):
                    told.image_ms.append(1e3 * (time.perf_counter() - start))
        advance()
    told.elapsed_s = time.perf_counter() - began
    return told


def every_nth(observations: Iterable[Observation], every: int) -> Iterator[tuple[Observation, bool]]:
    """Each observation, and whether it is wanted: of a sensor's images and scans every so-manieth, of the rest all.

    Raises `InvalidParameter` when `every` is below 1.
    """
    if every < 1:
        raise InvalidParameter(f"every: expected at least 1, got {every}")
    seen: Counter[tuple[str, str]] = Counter()
    for observation in observations:
        wanted = True
        if isinstance(observation, RgbdImage | Scan):
            sensor = (observation.robot, observation.sensor)
            wanted = seen[sensor] % every == 0
            seen[sensor] += 1
        yield observation, wanted


def sending(client: Client) -> Callable[[Observation], object]:
    """`integrate` of a server: sends, waits until the server has mapped it, and raises what the server refused."""
    from scenegraph.service.errors import RemoteProblem

    def integrate(observation: Observation) -> object:
        try:
            return client.integrate(observation)
        except RemoteProblem as error:
            if error.code in (InvalidObservation.code, PoseUnavailable.code):
                raise InvalidObservation(str(error)) from None
            raise

    return integrate


def open_recording(path: str | Path, **options: Any) -> Dataset:
    """The recording at `path`, by the reader that knows it. Raises `DatasetError`."""
    from mapping.datasets import open_dataset

    return open_dataset(path, **options)


def world_for(dataset: Dataset, voxel_size_m: float | None = None, max_range_m: float | None = None) -> World:
    """An empty world whose voxels and range suit the sensor of a recording, unless told otherwise."""
    from scenegraph.config import WorldConfig
    from scenegraph.world import World

    return World(
        WorldConfig(
            voxel_size_m=dataset.default_voxel_size_m if voxel_size_m is None else voxel_size_m,
            max_range_m=dataset.max_range_m if max_range_m is None else max_range_m,
        )
    )


def record_home(
    seed: int,
    folder: str | Path,
    *,
    noise: Literal["none", "realistic"] = "realistic",
    images_per_room: int = 30,
    lidar: bool = False,
    advance: Callable[[int, int], object] = lambda done, total: None,
) -> dict[str, int]:
    """Write what a robot sees on its tour through the simulated home of that seed as a recording that `replay` reads.

    lidar     add a scan of a rotating lidar at every fifth step
    advance   called with how many steps are done and how many there are

    Returns the counts of what was written, by kind. Raises `DatasetError` when the folder cannot be written.
    """
    from mapping.datasets.recorded import Recorder
    from scenegraph.simulation import Tour, simulate_home

    home = simulate_home(seed)
    tour = Tour(home, images_per_room=images_per_room)
    stream = home.observe(noise=noise, seed=seed, tour=tour)
    counts: Counter[str] = Counter()
    notes = {"seed": seed, "noise": noise, "images_per_room": images_per_room}
    with Recorder(folder, name=f"home_{seed}", max_range_m=6.0, notes=notes) as recorder:
        steps = 0
        for observation in stream:
            recorder.write(observation)
            counts[type(observation).__name__] += 1
            if isinstance(observation, RgbdImage):
                if lidar and steps % 5 == 0:
                    T_map_sensor = tour.steps[steps].T_map_base @ T_BASE_LIDAR
                    recorder.write(
                        home.scan(T_map_sensor, noise=noise, seed=seed + steps, stamp_ns=observation.stamp_ns)
                    )
                    counts["Scan"] += 1
                steps += 1
                advance(steps, len(tour))
    return dict(counts)
