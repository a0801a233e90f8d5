"""Replay: what is played, what is refused, what is counted."""

import numpy as np
import pytest

from mapping.datasets import open_dataset
from mapping.errors import DatasetError, InvalidObservation, InvalidParameter, PoseUnavailable
from mapping.geometry import SE3
from mapping.observations import AgentPose, Scan
from scenegraph.pipeline import replay


def scan(i, sensor="lidar"):
    return Scan(stamp_ns=i, robot="r", sensor=sensor, points=np.ones((1, 3), np.float32), T_map_sensor=SE3.identity())


def pose(i):
    return AgentPose(stamp_ns=i, robot="r", T_map_base=SE3.identity())


def test_every_nth_image_of_each_sensor_is_played_and_all_of_the_rest():
    stream = [observation for i in range(10) for observation in (pose(i), scan(i, "left"), scan(i, "right"))]
    played, steps = [], []
    told = replay(stream, played.append, every=4, advance=lambda: steps.append(1))
    assert [o.stamp_ns for o in played if isinstance(o, AgentPose)] == list(range(10))
    for sensor in ("left", "right"):
        assert [o.stamp_ns for o in played if isinstance(o, Scan) and o.sensor == sensor] == [0, 4, 8]
    assert len(steps) == len(stream)
    assert told.observations == {"AgentPose": 10, "Scan": 6}
    assert len(told.image_ms) == 6


def test_refused_observations_are_counted_with_their_reason_and_do_not_stop_the_rest():
    def integrate(observation):
        if observation.stamp_ns == 1:
            raise PoseUnavailable("no pose")
        if observation.stamp_ns in (2, 3):
            raise InvalidObservation("bad labels")

    told = replay([scan(i) for i in range(6)], integrate)
    assert told.refused == {"no pose": 1, "bad labels": 2}
    assert told.as_json()["observations"] == {"Scan": 3}


def test_faults_of_ours_are_not_swallowed():
    def integrate(observation):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        replay([scan(0)], integrate)


def test_every_is_at_least_one():
    with pytest.raises(InvalidParameter, match="every"):
        replay([scan(0)], lambda observation: None, every=0)


def test_a_damaged_recording_stops_the_replay(tmp_path):
    (tmp_path / "a.clf").write_text("FLASER 1 1 0 0 0 0 0 0 5.0 host 5.0\nFLASER 9 1 2\n")
    with pytest.raises(DatasetError, match="expected FLASER"):
        replay(open_dataset(tmp_path), lambda observation: None)


def test_nothing_played_has_no_times():
    assert replay([], print).as_json()["image_ms"] == {"median": None, "p99": None}
