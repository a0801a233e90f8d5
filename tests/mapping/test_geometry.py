"""Rigid transforms obey the laws of a group; cameras map points to pixels and back."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics, hat

metres = st.floats(-100.0, 100.0, allow_subnormal=False)
angles = st.floats(-1.8, 1.8, allow_subnormal=False)  # three of them stay below π together
poses = st.tuples(metres, metres, metres, angles, angles, angles).map(SE3.exp)
points = st.lists(st.tuples(metres, metres, metres), min_size=1, max_size=5).map(np.array)
shares = st.floats(0.0, 1.0)


def close(a: SE3, b: SE3, atol: float = 1e-8) -> bool:
    return a.isclose(b, atol=atol)


@given(poses, poses, poses)
def test_chaining_is_associative(a, b, c):
    assert close((a @ b) @ c, a @ (b @ c))


@given(poses)
def test_identity_changes_nothing(a):
    assert close(a @ SE3.identity(), a)
    assert close(SE3.identity() @ a, a)


@given(poses)
def test_inverse_undoes(a):
    assert close(a @ a.inverse(), SE3.identity())
    assert close(a.inverse() @ a, SE3.identity())


@given(poses, poses, points)
def test_a_chain_acts_as_its_parts_one_after_the_other(a, b, p):
    np.testing.assert_allclose((a @ b) @ p, a @ (b @ p), atol=1e-8)


@given(poses, points)
def test_distances_are_kept(a, p):
    np.testing.assert_allclose(np.linalg.norm(a @ p - a @ p[:1], axis=1), np.linalg.norm(p - p[0], axis=1), atol=1e-9)


@given(poses)
def test_exp_undoes_log(a):
    assert close(SE3.exp(a.log()), a)


def test_log_and_exp_agree_for_tiny_and_for_nearly_half_turns():
    for angle in (0.0, 1e-12, 1e-7, 1e-6, 2e-6, 1e-3, np.pi - 1e-6, np.pi - 1e-3):
        xi = np.array([1.0, -2.0, 3.0, 0.0, angle, 0.0])
        np.testing.assert_allclose(SE3.exp(xi).log(), xi, atol=1e-7)


@given(poses)
def test_quaternion_round_trip(a):
    q = a.quaternion_wxyz
    assert q[0] >= 0.0
    assert abs(np.linalg.norm(q) - 1.0) < 1e-12
    assert close(SE3.from_quaternion(q, a.translation), a)


@given(poses)
def test_matrix_round_trip_and_pickle_are_exact(a):
    assert SE3.from_matrix(a.matrix) == a
    assert pickle.loads(pickle.dumps(a)) == a
    assert hash(SE3.from_matrix(a.matrix)) == hash(a)


@given(poses, poses, shares)
def test_interpolation_meets_its_ends_and_is_invariant(a, b, share):
    assert close(a.interpolate(b, 0.0), a)
    assert close(a.interpolate(b, 1.0), b)
    assert close((b @ a).interpolate(b @ b, share), b @ a.interpolate(b, share), atol=1e-6)


@given(poses, poses, shares)
def test_interpolation_does_not_depend_on_the_direction(a, b, share):
    angle = np.linalg.norm((a.inverse() @ b).log()[3:])
    if angle < 3.1:  # a half turn may be made either way
        assert close(a.interpolate(b, share), b.interpolate(a, 1.0 - share), atol=1e-6)


def test_a_quarter_turn_about_z_takes_x_to_y():
    T = SE3.exp([0, 0, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(T @ np.array([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(T.quaternion_wxyz, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_float32_points_stay_float32_in_any_shape():
    T = SE3.exp([1, 2, 3, 0.1, 0.2, 0.3])
    image = np.zeros((4, 5, 3), dtype=np.float32)
    assert (T @ image).dtype == np.float32
    assert (T @ image).shape == image.shape
    assert (T @ np.zeros((0, 3))).shape == (0, 3)


def test_hat_is_the_cross_product():
    a, b = np.array([1.0, -2.0, 0.5]), np.array([0.3, 4.0, -1.0])
    np.testing.assert_allclose(hat(a) @ b, np.cross(a, b))


def test_values_cannot_be_changed():
    T = SE3.identity()
    with pytest.raises(ValueError, match="read-only"):
        T.translation[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        T.rotation[0, 0] = 2.0
    with pytest.raises(AttributeError):
        T.translation = np.ones(3)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SE3(np.eye(4), np.zeros(3)), r"rotation \(3, 3\)"),
        (lambda: SE3(np.eye(3), np.zeros(2)), r"translation \(3,\)"),
        (lambda: SE3(np.eye(3) * 1.01, np.zeros(3)), "orthonormal"),
        (lambda: SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3)), "right-handed"),
        (lambda: SE3(np.eye(3), [0.0, np.nan, 0.0]), "finite"),
        (lambda: SE3.from_matrix(np.eye(3)), r"matrix \(4, 4\)"),
        (lambda: SE3.from_matrix(np.full((4, 4), np.nan)), "finite"),
        (lambda: SE3.from_matrix(np.vstack([np.eye(4)[:3], [0, 0, 1, 1]])), "last row"),
        (lambda: SE3.from_quaternion([0.0, 0.0, 0.0, 0.0]), "unit quaternion"),
        (lambda: SE3.from_quaternion([1.0, 0.0, 0.0]), "unit quaternion"),
        (lambda: SE3.from_quaternion([np.nan, 0.0, 0.0, 1.0]), "unit quaternion"),
    ],
)
def test_what_is_no_pose_is_refused(make, message):
    with pytest.raises(InvalidParameter, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert caught.value.code == "invalid_parameter"


def test_a_rotation_with_rounding_is_made_exact():
    rotation = np.round(SE3.exp([0, 0, 0, 0.3, -0.2, 0.9]).rotation, 5)
    T = SE3(rotation, np.zeros(3))
    np.testing.assert_allclose(T.rotation @ T.rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(T.rotation, rotation, atol=2e-5)


# -- cameras ---------------------------------------------------------------------------------------------------

cameras = st.builds(
    CameraIntrinsics,
    fx=st.floats(5.0, 800.0),
    fy=st.floats(5.0, 800.0),
    cx=st.floats(0.0, 16.0),
    cy=st.floats(0.0, 12.0),
    width=st.just(16),
    height=st.just(12),
)


@given(cameras, st.floats(0.1, 50.0))
def test_projection_undoes_backprojection(camera, depth):
    p = camera.backproject(np.full((12, 16), depth)).reshape(-1, 3).astype(np.float64)
    uv, z = camera.project(p)
    v, u = np.mgrid[:12, :16]
    np.testing.assert_allclose(uv, np.column_stack([u.ravel(), v.ravel()]), atol=2e-3)
    np.testing.assert_allclose(z, depth, rtol=1e-6)


@given(cameras, st.floats(-3, 3), st.floats(-3, 3), st.floats(0.1, 10))
def test_a_point_is_on_the_ray_of_its_pixel(camera, x, y, z):
    uv, depth = camera.project(np.array([[x, y, z]]))
    u, v = uv[0]
    ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
    np.testing.assert_allclose(ray * depth[0], [x, y, z], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    camera = CameraIntrinsics(fx=10, fy=10, cx=5, cy=5, width=10, height=10)
    uv, z = camera.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(uv[:2]).all()
    np.testing.assert_allclose(uv[2], [5.0, 5.0])
    np.testing.assert_allclose(z, [-1.0, 0.0, 1.0])


def test_optical_axes_are_right_down_forward():
    camera = CameraIntrinsics(fx=10, fy=10, cx=5, cy=5, width=10, height=10)
    rays = camera.rays()
    assert rays[5, 9, 0] > 0 > rays[5, 0, 0]
    assert rays[9, 5, 1] > 0 > rays[0, 5, 1]
    assert (rays[..., 2] == 1.0).all()


def test_depth_zero_gives_the_origin():
    camera = CameraIntrinsics(fx=10, fy=10, cx=5, cy=5, width=4, height=3)
    assert not camera.backproject(np.zeros((3, 4))).any()


@pytest.mark.parametrize(
    ("field", "value"),
    [(field, value) for field in ("fx", "fy", "width", "height") for value in (float("nan"), float("inf"), -1.0, 0)]
    + [(field, value) for field in ("cx", "cy") for value in (float("nan"), float("inf"))],
)
def test_impossible_intrinsics_are_refused(field, value):
    good = {"fx": 10.0, "fy": 10.0, "cx": 5.0, "cy": 5.0, "width": 4, "height": 3}
    with pytest.raises(ValueError, match=field):
        CameraIntrinsics(**{**good, field: value})
