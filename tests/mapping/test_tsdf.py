"""Signed distances: the naive sums, the exact room, and the surface between voxels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.grid import join_ijk
from mapping.tsdf import TsdfMap
from tests import naive_layers as naive
from tests.support.rooms import LARGE_CAMERA, MIDDLE_CAMERA, SMALL_CAMERA, TOUR, Room, looking


def distances_of(layer: TsdfMap, rows: np.ndarray | None = None) -> dict[tuple[int, ...], tuple[float, float]]:
    """Voxel → (distance, weight) of every known voxel of the blocks in `rows`, or of all."""
    rows = np.arange(layer.store.n_blocks) if rows is None else rows
    distance, weight = layer.store.used("distance")[rows], layer.store.used("weight")[rows]
    which, local = np.nonzero(weight)
    ijk = join_ijk(layer.block_ijk[rows][which], local)
    d, w = distance[which, local], weight[which, local]
    return {tuple(v): (a, b) for v, a, b in zip(ijk.tolist(), d.tolist(), w.tolist(), strict=True)}


@pytest.fixture(scope="module")
def room_map() -> TsdfMap:
    """The whole room at 4 cm from 24 exact images."""
    layer = TsdfMap(0.04)
    for pose in TOUR:
        layer.integrate_image(Room().depth(pose, MIDDLE_CAMERA), MIDDLE_CAMERA, pose)
    return layer


@settings(max_examples=10, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-0.7, 0.7), st.integers(0, 100), st.sampled_from(["constant", "inverse_square"]))
def test_images_agree_with_the_naive_mean(yaw, pitch, seed, weighting):
    rng = np.random.default_rng(seed)
    layer = TsdfMap(0.05, 0.15, weighting=weighting, carve=False)
    poses = [looking(yaw + turn, pitch, (0.1, turn, 0.0)) for turn in (0.0, 0.1)]
    depths = [Room().depth(pose, SMALL_CAMERA) for pose in poses]
    depths[1][rng.random(depths[1].shape) < 0.05] = 0.0
    for depth, pose in zip(depths, poses, strict=True):
        layer.integrate_image(depth, SMALL_CAMERA, pose)
    rows = rng.integers(0, layer.store.n_blocks, 4)
    known = distances_of(layer, rows)
    for block in layer.block_ijk[rows]:
        for voxel in list(naive.voxels_of_block(tuple(block.tolist())))[:: rng.integers(3, 9)]:
            total, weight, certain = 0.0, 0.0, True
            for depth, pose in zip(depths, poses, strict=True):
                s, sure = naive.signed_distance(voxel, depth, pose, SMALL_CAMERA, 0.05)
                certain &= sure and abs(abs(s) - 0.15) > 1e-4
                if -0.15 < s <= 0.15:
                    z = naive.pixel_of(naive.centre_of(voxel, 0.05), pose, SMALL_CAMERA)[2]
                    gain = 1.0 if weighting == "constant" else 1.0 / max(z, 0.5) ** 2
                    gain *= min(1.0, max(2.0 + s / 0.05, 0.02))
                    total, weight = total + gain * s, weight + gain
            if certain and weight > 0.0:
                assert known[voxel] == pytest.approx((total / weight, weight), abs=2e-4)
            elif certain:
                assert voxel not in known


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 25))
def test_beams_agree_with_the_naive_mean(seed, n):
    rng = np.random.default_rng(seed)
    origin, directions = rng.uniform(-1, 1, 3), rng.normal(size=(n, 3))
    ends = origin + directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.4, 2.0, (n, 1))
    layer = TsdfMap(0.1, 0.3)
    layer.integrate(ends - origin, SE3(np.eye(3), origin))
    known = distances_of(layer)
    expected = naive.means_of_beams(origin, ends, 0.3, 0.1)
    assert known.keys() == expected.keys()
    assert all(known[voxel] == pytest.approx(expected[voxel], abs=1e-5) for voxel in expected)


def test_a_voxel_near_the_surface_is_in_an_allocated_block():
    pose = looking(0.3, 0.2)
    depth = Room().depth(pose, SMALL_CAMERA)
    layer = TsdfMap(0.05, 0.15)
    layer.integrate_image(depth, SMALL_CAMERA, pose)
    known = distances_of(layer)
    rng = np.random.default_rng(0)
    surface = pose @ SMALL_CAMERA.backproject(depth).reshape(-1, 3).astype(np.float64)
    for point in surface[rng.integers(0, len(surface), 300)] + rng.uniform(-0.1, 0.1, (300, 3)):
        voxel = naive.voxel_of(point, 0.05)
        s, sure = naive.signed_distance(voxel, depth, pose, SMALL_CAMERA, 0.05)
        if sure and abs(s) < 0.14:
            assert voxel in known


def test_interpolation_agrees_with_the_naive_one(room_map):
    values = {voxel: d for voxel, (d, _) in distances_of(room_map).items()}
    rng = np.random.default_rng(3)
    points = room_map.surface()[0][::200] + rng.uniform(-0.1, 0.1, (1, 3))
    expected = [naive.trilinear(values, p.astype(np.float64), 0.04) for p in points]
    assert np.allclose(room_map.query(points), expected, atol=1e-6, equal_nan=True)


def test_the_surface_lies_on_the_walls(room_map):
    points, normals, _ = room_map.surface()
    error = np.abs(Room().distance(points.astype(np.float64)))
    print(f"surface at 4 cm: median {np.median(error) * 1e3:.2f} mm, 95 % {np.percentile(error, 95) * 1e3:.2f} mm")
    assert np.median(error) < 0.001
    assert np.percentile(error, 95) < 0.010
    ahead = Room().distance(points + 0.02 * normals.astype(np.float64))
    assert np.mean(ahead > 0.0) > 0.98
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)


def test_a_flat_wall_has_flat_distances():
    """Straight at a wall, the distance is exact everywhere in the band, not only at the surface."""
    layer = TsdfMap(0.05, 0.2)
    layer.integrate_image(np.full((48, 64), 1.53, np.float32), SMALL_CAMERA, looking(0.0))
    points = np.array([[x, y, z] for x in np.arange(1.35, 1.7, 0.01) for y in (0.0, 0.2) for z in (-0.1, 0.1)])
    values = layer.query(points)
    stretch = np.linalg.norm(points, axis=1) / points[:, 0]  # distances run along the rays
    near = np.abs(1.53 - points[:, 0]) < 0.1
    assert np.allclose(values[near], ((1.53 - points[:, 0]) * stretch)[near], atol=2e-3)


def test_surface_of_some_blocks_is_their_part_of_the_whole(room_map):
    points, normals, rows = room_map.surface()
    chosen = room_map.block_ijk[10:40]
    some, some_normals, some_rows = room_map.surface(chosen)
    expected = (rows >= 10) & (rows < 40)
    assert np.array_equal(some, points[expected])
    assert np.array_equal(some_normals, normals[expected])
    assert np.array_equal(some_rows, rows[expected] - 10)
    away = some / room_map.voxel_size_m - 8 * chosen[some_rows]
    assert (away > -1e-3).all()
    assert (away < 9.0).all()  # the sample lies between its voxel's centre and the next one's


def test_surface_of_nothing_is_empty(room_map):
    for blocks in (np.empty((0, 3), np.int32), np.array([[500, 0, 0]], np.int32)):
        points, normals, rows = room_map.surface(blocks)
        assert points.shape == normals.shape == (0, 3)
        assert len(rows) == 0


def test_the_silhouette_of_a_thing_makes_no_wall_to_the_background():
    """A board 1 m before a wall: between its edge and the wall there is no surface."""
    depth = np.full((48, 64), 2.0, np.float32)
    depth[16:32, 20:44] = 1.0
    layer = TsdfMap(0.05)
    layer.integrate_image(depth, SMALL_CAMERA, looking(0.0))
    points, _, _ = layer.surface()
    assert len(points) > 100
    assert not ((points[:, 0] > 1.12) & (points[:, 0] < 1.88)).any()


def test_a_floor_seen_at_a_grazing_angle_is_a_surface():
    pose = looking(0.0, 0.15, (0.0, 0.0, 0.9))
    rays = LARGE_CAMERA.rays().reshape(-1, 3) @ pose.rotation.T
    t = np.where(rays[:, 2] < -0.01, 0.9 / -np.minimum(rays[:, 2], -0.01), 0.0)
    depth = np.where(t < 4.5, t, 0.0).reshape(480, 640).astype(np.float32)
    layer = TsdfMap(0.05)
    layer.integrate_image(depth, LARGE_CAMERA, pose)
    points, normals, _ = layer.surface()
    for near, far in ((1.5, 2.5), (2.5, 3.5), (3.5, 4.2)):
        cells = {(x // 0.05, y // 0.05) for x, y, _ in points if near < x < far and abs(y) < 0.4}
        assert len(cells) > 0.9 * (far - near) * 0.8 / 0.05**2
    assert np.median(np.abs(points[:, 2])) < 0.01
    assert np.median(normals[:, 2]) > 0.95


def test_what_has_gone_is_carved_away_unless_told_not_to():
    wall, board = np.full((48, 64), 2.0, np.float32), np.full((48, 64), 2.0, np.float32)
    board[16:32, 20:44] = 1.0
    left = {}
    for carve in (True, False):
        layer = TsdfMap(0.05, carve=carve, weighting="constant")
        layer.integrate_image(board, SMALL_CAMERA, looking(0.0))
        for _ in range(20):
            layer.integrate_image(wall, SMALL_CAMERA, looking(0.0))
        points, _, _ = layer.surface()
        left[carve] = int((points[:, 0] < 1.5).sum())
    assert left[True] == 0
    assert left[False] > 50


@pytest.mark.parametrize(("thickness", "allowed"), [(0.2, 0.001), (0.15, 0.002), (0.1, 0.007)])
def test_both_sides_of_a_thin_wall_stay_where_they_are(thickness, allowed):
    """Seen from either side at 5 cm voxels: three and two voxels thick. A wall of one voxel is beyond this layer."""
    errors = []
    for shift in (0.0, 0.01, 0.02, 0.03, 0.04):
        layer = TsdfMap(0.05, 0.15)
        for side in (-1, 1):
            for n in range(3):
                pose = looking((0.0 if side < 0 else np.pi) + 0.2 * (n - 1), 0.0, (1.5 * side, 0.1 * n, 0.0))
                rays = MIDDLE_CAMERA.rays().reshape(-1, 3) @ pose.rotation.T
                depth = (shift + side * thickness / 2 - pose.translation[0]) / rays[:, 0]
                layer.integrate_image(depth.reshape(240, 320).astype(np.float32), MIDDLE_CAMERA, pose)
        points, normals, _ = layer.surface()
        side = np.sign(normals[:, 0])
        near = np.abs(points[:, 1:]).max(axis=1) < 0.4
        errors.append((side * (points[:, 0] - shift) - thickness / 2)[near])
    bias = float(np.concatenate(errors).mean())
    print(f"wall of {thickness * 100:.0f} cm: each side {bias * 1e3:+.1f} mm")
    assert abs(bias) < allowed


def test_beams_and_images_make_the_same_surface():
    pose = looking(0.4)
    by_beams = TsdfMap(0.05)
    by_beams.integrate(LARGE_CAMERA.backproject(Room().depth(pose, LARGE_CAMERA)).reshape(-1, 3), pose)
    error = np.abs(Room().distance(by_beams.surface()[0].astype(np.float64)))
    assert np.median(error) < 0.006
    assert len(by_beams.surface()[0]) > 500


def test_colour_is_that_of_the_surface():
    depth = np.full((48, 64), 1.0, np.float32)
    color = np.zeros((48, 64, 3), np.uint8)
    color[:, :32], color[:, 32:] = (200, 40, 10), (10, 60, 220)
    layer = TsdfMap(0.05)
    layer.integrate_image(depth, SMALL_CAMERA, looking(0.0))
    assert not layer.has_color
    for _ in range(5):
        layer.integrate_image(depth, SMALL_CAMERA, looking(0.0), color)
    mesh = layer.mesh()
    left, right = mesh.vertices[:, 1] > 0.1, mesh.vertices[:, 1] < -0.1
    assert np.abs(mesh.colors[left].astype(int) - (200, 40, 10)).max() <= 2
    assert np.abs(mesh.colors[right].astype(int) - (10, 60, 220)).max() <= 2


def test_weights_stop_at_their_maximum():
    layer = TsdfMap(0.05, weighting="constant", max_weight=5.0)
    for _ in range(8):
        layer.integrate_image(np.full((48, 64), 1.0, np.float32), SMALL_CAMERA, looking(0.0))
    assert layer.store.used("weight").max() == 5.0


def test_a_colour_image_of_another_size_is_refused():
    with pytest.raises(InvalidObservation, match="color"):
        TsdfMap(0.05).integrate_image(
            np.ones((48, 64), np.float32), SMALL_CAMERA, SE3.identity(), np.zeros((40, 64, 3), np.uint8)
        )


def test_millimetres_and_metres_are_one_depth():
    pose = looking(0.3)
    depth = np.round(Room().depth(pose, SMALL_CAMERA), 3)
    one, other = TsdfMap(0.05), TsdfMap(0.05)
    one.integrate_image(depth, SMALL_CAMERA, pose)
    other.integrate_image(np.round(depth * 1000).astype(np.uint16), SMALL_CAMERA, pose)
    assert np.allclose(one.store.used("distance"), other.store.used("distance"), atol=1e-5)
