"""Keys: one place spells them, no name reaches beyond its chunk, and a wrong one is told with the nearest right one."""

from __future__ import annotations

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from mapping.geometry import SE3
from mapping.observations import AgentPose, LabelSpace, PoseCorrection, RobotDescription, Transform
from scenegraph.service import keys
from scenegraph.service.errors import InvalidKey, UnknownKey
from scenegraph.service.messages import MODELS
from scenegraph.service.session import qos_options
from tests.support.net import small_image

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,20}", fullmatch=True)


@pytest.mark.parametrize("name", ["", "Home", "a b", "a/b", "*", "**", "@adm", "a#", "a?", "$*", "1a", "ä", "a" * 129])
def test_a_name_that_would_break_a_key_is_refused(name):
    with pytest.raises(InvalidKey, match="expected lower-case"):
        keys.key(name)
    with pytest.raises(InvalidKey):
        keys.node("home", "object", name)


@given(NAMES, NAMES, NAMES, NAMES)
def test_every_key_that_is_made_is_a_key_of_zenoh_within_its_world(world, relation, source, target):
    for where in (
        keys.edge(world, relation, source, target),
        keys.node(world, relation, source),
        keys.alive(world, target),
    ):
        assert zenoh.KeyExpr(keys.everything(world)).includes(where)
        assert keys.world_of(where) == world


def test_an_observation_goes_to_the_key_that_names_its_robot_sensor_and_kind():
    pose = SE3.identity()
    expected = {
        "in/spot/camera/rgbd": small_image(),
        "in/spot/base/pose": AgentPose(stamp_ns=1, robot="spot", T_map_base=pose),
        "in/spot/base/correction": PoseCorrection(
            stamp_ns=2, robot="spot", poses=[{"stamp_ns": 1, "T_map_base": pose}]
        ),
        "in/spot/base/transform": Transform(stamp_ns=1, robot="spot", parent="a", child="b", T_parent_child=pose),
        "in/any/any/labelspace": LabelSpace(classes={1: {"name": "wall"}}),
        "in/spot/description": RobotDescription(robot="spot", footprint=[[0, 0], [1, 0], [0, 1]]),
    }
    for path, observation in expected.items():
        where = keys.input_key("home", observation)
        assert where == f"scenegraph/v1/home/{path}"
        found = keys.read_input("home", where)
        assert found.model == type(observation).__name__
        assert found.path == path.removeprefix("in/")
        assert keys.row_of(observation) in keys.QOS


def test_only_observations_have_an_input_key():
    with pytest.raises(InvalidKey, match="expected an observation"):
        keys.input_key("home", 3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("in/spot/camera/rgdb", "rgbd"),
        ("in/spot/camera", "kinds"),
        ("in/spot/a/b/scan", "kinds"),
        ("in/spot/camera/description", "kinds"),
        ("in/Spot/camera/rgbd", "kinds"),
        ("in/spot/*/rgbd", "kinds"),
    ],
)
def test_a_wrong_input_key_is_told_with_what_would_be_right(path, hint):
    with pytest.raises(UnknownKey) as caught:
        keys.read_input("home", f"scenegraph/v1/home/{path}")
    assert hint in (caught.value.hint or "")


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("aks", "ask"),
        ("grpah", "graph"),
        ("map/tsfd", "map/tsdf"),
        ("graph/detla", "graph/delta"),
        ("statsu", "status"),
    ],
)
def test_an_unknown_key_is_told_with_the_nearest_one(path, near):
    error = keys.unknown_key("home", f"scenegraph/v1/home/{path}")
    assert f"did you mean scenegraph/v1/home/{near}?" == error.hint
    assert path in str(error)


def test_the_table_names_models_that_exist_and_qualities_that_zenoh_has():
    for row in keys.TABLE:
        assert {row.request, row.reply} - {""} <= set(MODELS)
        assert set(qos_options(row.qos)) == {"priority", "congestion_control", "express"}
    assert len({row.path for row in keys.TABLE}) == len(keys.TABLE)


def test_newest_wins_only_for_images_and_scans():
    winners = {kind for kind in keys.INPUT_KINDS if keys.Input("a", "b", kind).newest_wins}
    assert winners == {"rgbd", "scan"}
