"""Signed distances: the naive sums, the exact room, and the surface between voxels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.grid import join_ijk
from mapping.mesh import Mesh
from mapping.sensors import LidarModel
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
                    slack = 2.0 * layer.depth_noise * z**2  # two standard deviations
                    gain *= min(1.0, max(2.0 + (s + slack) / 0.05, 0.02))
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


def wall_from_both_sides(thickness: float, shift: float, depth_noise: float) -> TsdfMap:
    """A wall across x at `shift`, seen by three cameras on each side, at 5 cm voxels."""
    layer = TsdfMap(0.05, 0.15, depth_noise=depth_noise)
    for side in (-1, 1):
        for n in range(3):
            pose = looking((0.0 if side < 0 else np.pi) + 0.2 * (n - 1), 0.0, (1.5 * side, 0.1 * n, 0.0))
            rays = MIDDLE_CAMERA.rays().reshape(-1, 3) @ pose.rotation.T
            depth = (shift + side * thickness / 2 - pose.translation[0]) / rays[:, 0]
            layer.integrate_image(depth.reshape(240, 320).astype(np.float32), MIDDLE_CAMERA, pose)
    return layer


@pytest.mark.parametrize(
    ("voxels", "depth_noise", "thinner_m", "thicker_m", "share"),
    [
        (4, 0.0, 0.002, 0.002, 0.95),
        (3, 0.0, 0.002, 0.004, 0.95),
        (2, 0.0, 0.002, 0.014, 0.95),
        (1, 0.0, 0.05, 0.05, 0.0),
        (4, 0.0019, 0.002, 0.003, 0.95),
        (3, 0.0019, 0.002, 0.006, 0.95),
        (2, 0.0019, 0.002, 0.018, 0.95),
        (1, 0.0019, 0.05, 0.06, 0.0),
    ],
)
def test_a_thin_wall_is_as_thick_as_said(voxels, depth_noise, thinner_m, thicker_m, share):
    """At four places in the grid. A wall of one voxel may be lost; nothing is promised of it."""
    thickness, found, sides = 0.05 * voxels, [], []
    for shift in (0.0, 0.0125, 0.025, 0.0375):
        mesh = wall_from_both_sides(thickness, shift, depth_noise).mesh()
        middles, area = mesh.vertices[mesh.triangles].mean(axis=1), []
        for side in (-1, 1):
            facing = (mesh.normals[mesh.triangles].mean(axis=1)[:, 0] * side > 0.0) & (
                np.abs(middles[:, 1:]).max(axis=1) < 0.4
            )
            part = Mesh(mesh.vertices, mesh.triangles[facing], mesh.normals)
            area.append(part.area_m2 / 0.8**2)
            found.append(side * (middles[facing, 0] - shift))
        sides.append(min(area))
    measured = 2.0 * float(np.concatenate(found).mean()) if sum(map(len, found)) else float("nan")
    print(f"wall of {voxels} voxels, {thickness * 100:.0f} cm: {measured * 100:.2f} cm; of a side ≥ {min(sides):.0%}")
    assert min(sides) >= share
    assert np.isnan(measured) or -thinner_m <= measured - thickness <= thicker_m


def test_beams_and_images_make_the_same_surface():
    pose = looking(0.4)
    by_beams = TsdfMap(0.05)
    by_beams.integrate(LARGE_CAMERA.backproject(Room().depth(pose, LARGE_CAMERA)).reshape(-1, 3), pose)
    error = np.abs(Room().distance(by_beams.surface()[0].astype(np.float64)))
    assert np.median(error) < 0.006
    assert len(by_beams.surface()[0]) > 500


def ranges_of(model: LidarModel, pose: SE3) -> np.ndarray:
    """The exact range image of the room."""
    rays = model.rays().reshape(-1, 3).astype(np.float64) @ pose.rotation.T
    return Room().cast(pose.translation, rays).reshape(model.shape).astype(np.float32)


def test_range_images_agree_with_the_naive_mean():
    """Each voxel takes the beam nearest to its centre, when that passes near enough."""
    model, pose = LidarModel.even(24, -0.5, 0.5, 180), SE3.exp([0.1, -0.2, 0.05, 0.1, -0.1, 0.7])
    ranges = ranges_of(model, pose)
    ranges[:, 30:40] = 0.0
    layer = TsdfMap(0.1, 0.3, carve=False, weighting="constant")
    layer.integrate_range_image(ranges, model, pose)
    known = distances_of(layer)
    compared = 0
    for block in layer.block_ijk[::3]:
        for voxel in list(naive.voxels_of_block(tuple(block.tolist())))[::5]:
            centre = pose.inverse() @ naive.centre_of(voxel, 0.1)
            rows, columns, (r,) = model.project(centre[None])
            beam = model.rays()[rows[0], columns[0]]
            aside = np.linalg.norm(centre - (centre @ beam) * beam)
            s = ranges[rows[0], columns[0]] - r if rows[0] >= 0 and ranges[rows[0], columns[0]] > 0 else np.nan
            angles = np.degrees([np.arctan2(centre[1], centre[0]), np.arcsin(centre[2] / r)])
            if abs(aside - 0.0866) < 1e-3 or abs(abs(s) - 0.3) < 1e-3 or rows[0] < 0 or on_a_border(model, angles):
                continue  # rounding decides
            compared += 1
            if aside < 0.0866 and abs(s) < 0.3:
                assert known[voxel] == pytest.approx((s, min(1.0, max(2.0 + s / 0.1, 0.02))), abs=2e-4)
            else:
                assert voxel not in known
    assert compared > 500


def on_a_border(model: LidarModel, degrees: np.ndarray) -> bool:
    """Whether a direction (azimuth, elevation) is within 0.05° of a border between two beams."""
    columns = (np.degrees(model.first_azimuth) - degrees[0]) * model.columns / 360.0
    elevations = np.degrees(model.elevations)
    borders = 0.5 * (elevations[1:] + elevations[:-1])
    return abs(columns % 1.0 - 0.5) < 0.05 or np.abs(borders - degrees[1]).min() < 0.05


def test_range_images_and_their_beams_make_the_same_surface():
    model = LidarModel.even(64, -0.5, 0.5, 1024)
    by_image, by_beams = TsdfMap(0.05), TsdfMap(0.05)
    for n in range(4):
        pose = SE3.exp([0.1 * n - 0.5, 0.05 * n, 0.1 * n - 0.2, 0.05 * n, 0.1 * (n % 3 - 1), 0.7 * n])
        by_image.integrate_range_image(ranges_of(model, pose), model, pose)
        by_beams.integrate(model.backproject(ranges_of(model, pose)).reshape(-1, 3), pose)
    points = by_image.surface()[0]
    assert len(points) == pytest.approx(len(by_beams.surface()[0]), rel=0.03)
    error = np.abs(Room().distance(points.astype(np.float64)))
    assert np.median(error) < 0.002
    assert np.percentile(error, 95) < 0.012


def test_what_a_range_image_sees_through_is_carved_away():
    model, pose = LidarModel.even(64, -0.5, 0.5, 1024), looking(0.0)
    pose = SE3(np.eye(3), (0.0, 0.0, 0.0))
    layer = TsdfMap(0.05, weighting="constant")
    near = np.full(model.shape, 1.0, np.float32)
    layer.integrate_range_image(near, model, pose)
    before = len(layer.surface()[0])
    for _ in range(20):
        layer.integrate_range_image(near + np.float32(1.0), model, pose)
    points = layer.surface()[0]
    assert before > 1000
    assert (np.linalg.norm(points, axis=1) > 1.9).all()


def test_noise_is_not_taken_for_being_behind():
    """Seen once at 4.5 m with a structured-light camera's noise, the wall lies where it is when the noise is known."""
    rng = np.random.default_rng(0)
    depth = np.full((240, 320), 4.5, np.float32)
    bias = {}
    for noise in (0.0, 0.0019):
        layer = TsdfMap(0.02, depth_noise=noise)
        for _ in range(6):
            layer.integrate_image(
                (depth + 0.0019 * 4.1**2 * rng.standard_normal(depth.shape)).astype(np.float32),
                MIDDLE_CAMERA, looking(0.0),
            )  # fmt: skip
        bias[noise] = float(layer.surface()[0][:, 0].mean()) - 4.5
    print(f"wall at 4.5 m: {bias[0.0] * 1e3:+.1f} mm, with depth_noise {bias[0.0019] * 1e3:+.1f} mm")
    assert abs(bias[0.0019]) < 0.5 * abs(bias[0.0])


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


def test_colours_between_voxels_are_blends_of_those_that_have_one():
    layer = TsdfMap(0.1, with_color=True)
    slots = layer.store.allocate(np.array([[0, 0, 0]]))
    layer.store.fields["color"][slots[0], 0] = 256 * np.array([100, 0, 0])
    layer.store.fields["color"][slots[0], 64] = 256 * np.array([200, 0, 80])  # the next voxel along x
    points = np.array([[0.05, 0.05, 0.05], [0.125, 0.05, 0.05], [0.05, 0.05, 0.1], [0.5, 0.5, 0.5], [np.nan, 0.0, 0.0]])
    expected = [[100, 0, 0], [175, 0, 60], [100, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert np.abs(layer.colors_at(points).astype(int) - expected).max() <= 1
    assert not TsdfMap(0.1).colors_at(points).any()


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
