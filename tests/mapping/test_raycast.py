"""What a camera would see of the map: depth, normals and colours of the surface itself, and nothing where it ends."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.tsdf import TsdfMap
from tests.support.rooms import MIDDLE_CAMERA, SMALL_CAMERA, TOUR, Room, looking


def normals_of(room: Room, points: np.ndarray) -> np.ndarray:
    """Unit gradients (N, 3) of the room's distance at points (N, 3), by differences."""
    steps = 1e-5 * np.eye(3)
    gradient = np.stack([room.distance(points + step) - room.distance(points - step) for step in steps], axis=1)
    return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def room_map() -> TsdfMap:
    """The whole room at 4 cm from 24 exact images."""
    layer = TsdfMap(0.04)
    for pose in TOUR:
        layer.integrate_image(Room().depth(pose, MIDDLE_CAMERA), MIDDLE_CAMERA, pose)
    return layer


@settings(max_examples=12, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.9, 0.1), st.floats(-0.4, 0.4), st.floats(-0.2, 0.3))
def test_a_view_shows_the_room_as_it_is(room_map, yaw, pitch, x, y, z):
    """From any pose within the part of the room that the images were taken in: depth within a share of a voxel."""
    pose = looking(yaw, pitch, (x, y, z))
    view = room_map.render(MIDDLE_CAMERA, pose)
    truth = Room().depth(pose, MIDDLE_CAMERA)
    seen = view.depth > 0.0
    points = pose @ MIDDLE_CAMERA.backproject(truth).reshape(-1, 3).astype(np.float64)
    known = ~np.isnan(room_map.query(points)).reshape(seen.shape)  # the images leave some of floor and ceiling out
    assert seen[known].mean() > 0.98
    error = np.abs(view.depth - truth)[seen]
    assert np.median(error) < 0.002
    assert np.mean(error > 0.02) < 0.03  # edges of the ball and corners of the room
    normals = normals_of(Room(), points[seen.ravel()])
    turned = np.degrees(np.arccos(np.clip((normals * view.normals[seen]).sum(axis=1), -1.0, 1.0)))
    assert np.median(turned) < 3.0
    assert np.mean(turned > 15.0) < 0.06


def test_depth_and_field_agree(room_map):
    """Where a ray ends, the interpolated distance is zero."""
    view = room_map.render(MIDDLE_CAMERA, TOUR[5])
    seen = view.depth > 0.0
    points = TOUR[5] @ MIDDLE_CAMERA.backproject(view.depth)[seen].astype(np.float64)
    assert np.nanpercentile(np.abs(room_map.query(points)), 99) < 0.001
    assert np.allclose(np.linalg.norm(view.normals[seen], axis=1), 1.0, atol=1e-5)
    assert (view.normals[~seen] == 0.0).all()
    assert view.colors is None


def test_an_empty_map_shows_nothing():
    view = TsdfMap(0.05).render(SMALL_CAMERA, SE3.identity())
    assert not view.depth.any()
    assert not view.normals.any()


def test_surfaces_beyond_the_range_are_not_seen(room_map):
    pose = looking(0.0, 0.0, (-0.5, 0.0, 0.0))
    near = room_map.render(SMALL_CAMERA, pose, max_range_m=2.0)
    length = near.depth * np.linalg.norm(SMALL_CAMERA.rays(), axis=-1)
    assert 0.0 < length.max() <= 2.0
    whole = room_map.render(SMALL_CAMERA, pose)
    assert np.array_equal(whole.depth[near.depth > 0.0], near.depth[near.depth > 0.0])
    with pytest.raises(InvalidParameter, match="max_range_m"):
        room_map.render(SMALL_CAMERA, pose, max_range_m=0.0)


def test_a_wall_is_seen_from_its_free_side_only():
    layer = TsdfMap(0.05)
    layer.integrate_image(np.full((48, 64), 1.5, np.float32), SMALL_CAMERA, looking(0.0))
    assert (layer.render(SMALL_CAMERA, looking(0.0, 0.0, (0.2, 0.0, 0.0))).depth > 0.0).mean() > 0.9
    assert not layer.render(SMALL_CAMERA, looking(np.pi, 0.0, (3.0, 0.0, 0.0))).depth.any()


def test_no_surface_is_seen_between_a_thing_and_what_is_behind_it():
    depth = np.full((48, 64), 2.0, np.float32)
    depth[16:32, 20:44] = 1.0
    layer = TsdfMap(0.05)
    layer.integrate_image(depth, SMALL_CAMERA, looking(0.0))
    pose = looking(0.3, 0.0, (0.0, -0.5, 0.0))
    view = layer.render(SMALL_CAMERA, pose)
    points = pose @ SMALL_CAMERA.backproject(view.depth)[view.depth > 0.0].astype(np.float64)
    assert len(points) > 500
    assert not ((points[:, 0] > 1.12) & (points[:, 0] < 1.88)).any()


def test_a_view_follows_the_map():
    """What is kept between views is renewed where the map changed."""
    followed = TsdfMap(0.05)
    for n in (0, 3, 9, 12):
        followed.integrate_image(Room().depth(TOUR[n], SMALL_CAMERA), SMALL_CAMERA, TOUR[n])
        after = followed.render(SMALL_CAMERA, TOUR[n + 1])
        fresh = TsdfMap.from_state(followed.state()).render(SMALL_CAMERA, TOUR[n + 1])
        assert np.array_equal(after.depth, fresh.depth)
        assert np.array_equal(after.normals, fresh.normals)


def test_a_view_has_the_colours_of_the_surface():
    depth = np.full((48, 64), 1.0, np.float32)
    color = np.zeros((48, 64, 3), np.uint8)
    color[:, :32], color[:, 32:] = (200, 40, 10), (10, 60, 220)
    layer = TsdfMap(0.05)
    layer.integrate_image(depth, SMALL_CAMERA, looking(0.0), color)
    view = layer.render(SMALL_CAMERA, looking(0.0))
    assert np.abs(view.colors[20:28, 20:26].astype(int) - (200, 40, 10)).max() <= 2
    assert np.abs(view.colors[20:28, 38:44].astype(int) - (10, 60, 220)).max() <= 2
    assert (view.colors[view.depth == 0.0] == 0).all()


def test_any_number_of_threads_shows_the_same(room_map):
    import numba

    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = room_map.render(MIDDLE_CAMERA, TOUR[2])
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(room_map.render(MIDDLE_CAMERA, TOUR[2]).depth, alone.depth)
