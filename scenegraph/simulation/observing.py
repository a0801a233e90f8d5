"""A robot's tour as the stream of observations that it would publish."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, hat
from mapping.observations import AgentPose, Observation, RgbdImage, RobotDescription, Scan
from scenegraph.simulation.noise import NoiseModel, Segmenter
from scenegraph.simulation.rendering import CAMERA, Lidar
from scenegraph.simulation.shapes import Array
from scenegraph.simulation.tour import Tour

if TYPE_CHECKING:
    from scenegraph.simulation.home import Home
    from scenegraph.simulation.truth import TruthRecorder

ROBOT = "robot"
START_NS = 1_000_000_000


def noise_model(noise: str | NoiseModel, mislabelled: float | None = None) -> NoiseModel:
    """The model that a name stands for, *none* or *realistic*; with another share of things `mislabelled` an image,
    when it is given: *none* is then perfect but for that.

    Raises `InvalidParameter` on an unknown name, or a share outside 0 … 1.
    """
    if isinstance(noise, NoiseModel):
        model = noise
    elif noise in ("none", "realistic"):
        model = NoiseModel() if noise == "realistic" else NoiseModel.none()
    else:
        raise InvalidParameter(f"noise: expected 'none', 'realistic' or a NoiseModel, got {noise!r}")
    return model if mislabelled is None else replace(model, mislabelled=mislabelled)


def robot_description() -> RobotDescription:
    """The simulated robot: a disc of 0.25 m radius, 1.4 m high."""
    angle = 2 * np.pi * np.arange(16) / 16
    outline = 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return RobotDescription(robot=ROBOT, footprint=outline, height_m=1.4, reach_m=0.8)


def make_segmenter(home: Home, noise: NoiseModel, seed: int) -> Segmenter:
    """The segmenter that `observe` uses with this seed; its `persistent` tells which things are always mistaken."""
    classes = home.label_space.classes
    true_class = np.zeros(len(home.entities) + 1, dtype=np.uint16)
    first = np.unique(home.triangle_entity, return_index=True)[1]
    true_class[home.triangle_entity[first]] = home.triangle_class[first]
    true_class[0] = 0
    if home.change is not None:  # what was mistaken before is mistaken still; what is new is not
        before = make_segmenter(home.change.before, noise, seed)
        known = dict(zip(home.change.before.entities, before.persistent[1:].tolist(), strict=True))
        persistent = true_class.copy()
        persistent[1:] = [known.get(e, c) for e, c in zip(home.entities, true_class[1:].tolist(), strict=True)]
        return Segmenter(noise, true_class, before.confusable, persistent)
    things = np.array([key for key, info in classes.items() if info.kind == "thing"], dtype=np.uint16)
    return Segmenter.make(noise, true_class, things, np.random.default_rng([home.seed, seed, 1]))


def observe(
    home: Home,
    *,
    noise: str | NoiseModel,
    seed: int,
    rate_hz: float,
    images_per_room: int,
    tour: Tour | None,
    recorder: TruthRecorder | None,
    start_ns: int = START_NS,
) -> Iterator[Observation]:
    """See `Home.observe`. Raises `InvalidParameter` on an unknown kind of noise or a rate ≤ 0, at once."""
    model = noise_model(noise)
    if not rate_hz > 0.0:
        raise InvalidParameter(f"rate_hz: expected a rate > 0 Hz, got {rate_hz!r}")
    way = tour or Tour(home, images_per_room=images_per_room)
    return _stream(home, model, seed, rate_hz, way, recorder, start_ns)


def _stream(
    home: Home, noise: NoiseModel, seed: int, rate_hz: float, tour: Tour, recorder: TruthRecorder | None, start_ns: int
) -> Iterator[Observation]:
    yield home.label_space
    yield robot_description()
    rng = np.random.default_rng([home.seed, seed, 2] if home.change is None else [home.seed, seed, 2, home.change.seed])
    segmenter = make_segmenter(home, noise, seed)
    if recorder is not None:
        recorder.note_confused(segmenter)
    covariance = noise.covariance
    for k, step in enumerate(tour.steps):
        stamp_ns = start_ns + round(k * 1e9 / rate_hz)
        rendered = home.renderer.render(step.T_map_camera)
        if recorder is not None:
            recorder.record(rendered)
        reported = noise.perturbed(step.T_map_camera, rng)
        T_camera_base = step.T_map_camera.inverse() @ step.T_map_base
        adjoint = _adjoint(T_camera_base.inverse())
        base_covariance = adjoint @ covariance @ adjoint.T
        yield AgentPose(
            stamp_ns=stamp_ns,
            robot=ROBOT,
            T_map_base=reported @ T_camera_base,
            covariance=(base_covariance + base_covariance.T) / 2,
        )
        seen = segmenter.segment(rendered.entities, rendered.labels, rng)
        yield RgbdImage(
            stamp_ns=stamp_ns,
            robot=ROBOT,
            sensor="camera",
            depth=noise.depth_mm(rendered.depth, rng),
            intrinsics=CAMERA,
            T_map_camera=reported,
            covariance=covariance,
            color=rendered.color,
            labels=seen.labels,
            instances=seen.instances,
        )


def scan(
    home: Home, T_map_sensor: SE3, *, noise: str | NoiseModel, seed: int, stamp_ns: int, lidar: Lidar | None
) -> Scan:
    """See `Home.scan`."""
    model = noise_model(noise)
    rng = np.random.default_rng([home.seed, seed, 3])
    directions, distance, triangle = home.renderer.sweep(T_map_sensor, lidar or Lidar())
    noisy = distance + model.range_m * rng.standard_normal(len(distance))
    return Scan(
        stamp_ns=stamp_ns,
        robot=ROBOT,
        sensor="lidar",
        points=(directions * noisy[:, None]).astype(np.float32),
        T_map_sensor=model.perturbed(T_map_sensor, rng),
        covariance=model.covariance,
        labels=home.renderer.classes_of(triangle),
        instances=home.renderer.entities_of(triangle).astype(np.uint32),
    )


def _adjoint(T: SE3) -> Array:
    """(6, 6): a twist x, y, z, roll, pitch, yaw in frame b as one in frame a, for T = T_a_b."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T.rotation
    out[:3, 3:] = hat(T.translation) @ T.rotation
    return out
