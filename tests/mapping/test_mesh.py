"""Meshes: closed where the field is known, on the surface, with normals into free space."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.datasets.opening import open_dataset
from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BLOCK_VOXELS, ijk_to_centre, join_ijk
from mapping.kernels import marching_cubes
from mapping.mesh import IncrementalMesh, Mesh
from mapping.semantics import SemanticMap
from mapping.tsdf import TsdfMap
from tests import naive_tsdf
from tests.support.recordings import recording
from tests.support.rooms import MIDDLE_CAMERA, SMALL_CAMERA, TOUR, Room, looking


def field_of(distance, voxel_size: float = 0.05, half_blocks: int = 3) -> TsdfMap:
    """A map whose every voxel in a cube of blocks holds distance(centres (N, 3)) [m]."""
    layer = TsdfMap(voxel_size)
    edge = np.arange(-half_blocks, half_blocks)
    blocks = np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    slots = layer.store.allocate(blocks)
    ijk = join_ijk(np.repeat(blocks, BLOCK_VOXELS, axis=0), np.tile(np.arange(BLOCK_VOXELS), len(blocks)))
    values = np.clip(distance(ijk_to_centre(ijk, voxel_size)), -layer.truncation_m, layer.truncation_m)
    layer.store.fields["distance"][slots] = values.reshape(-1, BLOCK_VOXELS)
    layer.store.fields["weight"][slots] = 1.0
    return layer


def ball(centres: np.ndarray) -> np.ndarray:
    return np.linalg.norm(centres - (0.013, 0.02, -0.03), axis=1) - 0.8


def edges_of(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Each undirected edge once, and how many triangles it has."""
    edges = np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    return np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)


def test_a_ball_is_closed_round_and_faces_outwards():
    mesh = field_of(ball).mesh()
    radius = np.linalg.norm(mesh.vertices - np.float32([0.013, 0.02, -0.03]), axis=1)
    assert np.abs(radius - 0.8).max() < 0.001
    assert mesh.area_m2 == pytest.approx(4 * np.pi * 0.8**2, rel=2e-3)
    outwards = (mesh.vertices - np.float32([0.013, 0.02, -0.03])) / radius[:, None]
    assert (outwards * mesh.normals).sum(axis=1).min() > 0.99
    _, counts = edges_of(mesh)
    assert (counts == 2).all()
    n_edges, n_vertices = len(counts), len(mesh.vertices)
    assert n_vertices - n_edges + len(mesh.triangles) == 2  # Euler: one closed surface without handles
    assert len(np.unique(mesh.vertices, axis=0)) == n_vertices  # welded
    assert len(np.unique(mesh.triangles)) == n_vertices  # each used


def triangles_of(mesh: Mesh) -> np.ndarray:
    """The triangles (M, 18) by their corners' positions and normals, in an order of their own."""
    corners = np.concatenate([mesh.vertices, mesh.normals], axis=1)[mesh.triangles]
    first = np.lexsort(corners[..., :3].transpose(2, 0, 1), axis=1)[:, 0]
    turned = (first[:, None] + np.arange(3)) % 3
    flat = np.take_along_axis(corners, turned[..., None], axis=1).reshape(-1, 18)
    return flat[np.lexsort(flat.T)]


def test_a_random_field_has_the_triangles_of_the_naive_one():
    """Every case, edges between two surfaces, unknown voxels and borders of blocks."""
    rng = np.random.default_rng(3)
    layer = field_of(lambda centres: rng.uniform(-0.2, 0.2, len(centres)), half_blocks=1)
    layer.store.used("weight")[rng.random((8, BLOCK_VOXELS)) < 0.02] = 0.0
    layer.store.fields["weight"][layer.store.find(np.array([[0, -1, 0]]))] = 0.0
    which, local = np.nonzero(layer.store.used("weight"))
    ijk = join_ijk(layer.block_ijk[which], local)
    values = dict(zip(map(tuple, ijk.tolist()), layer.store.used("distance")[which, local].tolist(), strict=True))
    expected = np.array(naive_tsdf.triangles_of(values, 0.05, layer.max_jump_m))
    mesh = layer.mesh()
    found = mesh.vertices[mesh.triangles]
    assert len(found) == len(expected) > 3000

    def sorted_rows(triangles: np.ndarray) -> np.ndarray:
        middles = np.concatenate([triangles.mean(axis=1), np.cross(*np.diff(triangles, axis=1).swapaxes(0, 1))], axis=1)
        return middles[np.lexsort(np.round(middles, 5).T)]

    assert np.allclose(sorted_rows(found.astype(np.float64)), sorted_rows(expected), atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.integers(0, 3)), min_size=2, max_size=6),
    st.booleans(),
)
def test_a_mesh_that_follows_the_map_is_the_whole_mesh(views, carve):
    """Whatever is seen between updates, even when many images are, and when what was there is carved away."""
    layer = TsdfMap(0.1, carve=carve, weighting="constant", max_weight=2.0)
    followed, followed_to = IncrementalMesh(layer), 0
    for n, (yaw, pitch, what) in enumerate(views):
        depth = Room(radius=0.4 + 0.2 * (n % 2)).depth(looking(yaw, pitch), SMALL_CAMERA)
        depth[:, : 10 * what] = 0.0
        layer.integrate_image(depth, SMALL_CAMERA, looking(yaw, pitch))
        if what != 2:
            continue
        changed = followed.update()
        whole = IncrementalMesh(layer)
        whole.update()
        assert np.array_equal(triangles_of(followed.mesh()), triangles_of(whole.mesh()))
        near = {
            tuple(np.add(block, step))
            for block in layer.changed_since(followed_to).blocks.tolist()
            for step in product((-1, 0, 1), repeat=3)
        }
        assert {tuple(block) for block in changed.blocks.tolist()} <= near
        followed_to = layer.revision
    followed.update()
    assert np.array_equal(triangles_of(followed.mesh()), triangles_of(layer.mesh()))
    assert len(np.unique(followed.mesh().vertices, axis=0)) == len(followed.mesh().vertices)  # welded
    assert len(followed.update()) == 0


def test_meshes_of_parts_make_up_the_whole():
    layer = field_of(ball)
    pieces = IncrementalMesh(layer)
    pieces.update()
    blocks = np.random.default_rng(0).permutation(layer.block_ijk)
    parts = [pieces.mesh(blocks[n::4]) for n in range(4)]
    corners = np.concatenate([np.concatenate([p.vertices, p.normals], axis=1)[p.triangles] for p in parts])
    apart = Mesh(
        corners[..., :3].reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3),
        corners[..., 3:].reshape(-1, 3),
    )  # fmt: skip
    assert np.array_equal(triangles_of(apart), triangles_of(pieces.mesh()))
    assert len(pieces.mesh(np.array([[90, 0, 0]])).triangles) == 0
    assert all(len(np.unique(p.triangles)) == len(p.vertices) for p in parts)


def test_pieces_that_were_replaced_are_let_go_of():
    layer = field_of(ball)
    pieces = IncrementalMesh(layer)
    pieces.update()
    n = len(pieces.mesh().triangles)
    expected, most = triangles_of(pieces.mesh()), 0
    for _ in range(20):
        layer._note(np.arange(layer.store.n_blocks))
        assert len(pieces.update()) > 0
        most = max(most, pieces.memory_bytes)
    assert np.array_equal(triangles_of(pieces.mesh()), expected)
    assert len(pieces._corners) < 3 * n + 2 * 65_536


def test_vertices_are_labelled_by_the_semantic_map():
    layer, semantics = field_of(ball), SemanticMap(voxel_size_m=0.05)
    surface = layer.surface()[0]
    semantics.integrate(surface, np.where(surface[:, 2] > 0.0, 7, 9))
    mesh = layer.mesh(labels_from=semantics)
    assert mesh.labels.dtype == np.uint16
    assert (mesh.labels[mesh.vertices[:, 2] > 0.06] == 7).mean() > 0.97
    assert (mesh.labels[mesh.vertices[:, 2] < -0.06] == 9).mean() > 0.97
    assert layer.mesh().labels is None


def test_any_field_gives_a_surface_without_cracks():
    """Random signs meet every case and every ambiguous face: each edge inside has an even number of triangles."""
    rng = np.random.default_rng(5)
    layer = field_of(lambda centres: rng.uniform(-0.05, 0.05, len(centres)), half_blocks=1)
    mesh = layer.mesh()
    edges, counts = edges_of(mesh)
    middle = np.abs(mesh.vertices[edges]).max(axis=(1, 2)) < 0.05 * 7.4
    assert middle.sum() > 5000
    assert (counts[middle] % 2 == 0).all()


def test_every_case_cuts_exactly_the_edges_between_unlike_corners():
    for case in range(256):
        behind = [case >> corner & 1 for corner in range(8)]
        cut = {n for n, (a, b) in enumerate(marching_cubes.EDGES) if behind[a] != behind[b]}
        triangles = marching_cubes.triangulate_case(case)
        assert {edge for triangle in triangles for edge in triangle} == cut
        assert all(len(set(triangle)) == 3 for triangle in triangles)


def test_mirrored_fields_give_mirrored_orientation():
    outside = field_of(ball).mesh()
    inside = field_of(lambda centres: -ball(centres)).mesh()
    assert np.allclose(np.sort(outside.vertices, axis=0), np.sort(inside.vertices, axis=0), atol=1e-6)
    assert (inside.vertices * inside.normals).sum(axis=1).max() < 0.0


def test_cubes_with_an_unknown_corner_have_no_surface():
    layer = field_of(ball)
    weight = layer.store.used("weight")
    centres = ijk_to_centre(
        join_ijk(np.repeat(layer.block_ijk, 512, axis=0), np.tile(np.arange(512), len(weight))), 0.05
    )
    weight[(centres[:, 0] > 0.0).reshape(weight.shape)] = 0.0
    mesh = layer.mesh()
    assert mesh.vertices[:, 0].max() <= -0.025 + 1e-6
    assert len(np.unique(mesh.triangles)) == len(mesh.vertices)


def test_the_mesh_of_nothing_is_empty():
    mesh = TsdfMap(0.05).mesh()
    assert mesh.vertices.shape == mesh.triangles.shape == (0, 3)
    assert mesh.area_m2 == 0.0


def test_the_mesh_of_images_lies_on_the_room():
    layer = TsdfMap(0.05)
    for yaw in np.arange(0.0, 2 * np.pi, 0.4):
        pose = looking(yaw)
        layer.integrate_image(Room().depth(pose, SMALL_CAMERA), SMALL_CAMERA, pose)
    mesh = layer.mesh()
    error = np.abs(Room().distance(mesh.vertices.astype(np.float64)))
    assert len(mesh.triangles) > 3000
    assert np.median(error) < 0.004


def open3d_mesh(images: list, camera: CameraIntrinsics, voxel_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of Open3D's voxel block grid, with the same truncation of four voxels."""
    open3d = pytest.importorskip("open3d")
    core = open3d.core
    channels = ("tsdf", "weight"), (core.float32, core.float32), ((1,), (1,))
    grid = open3d.t.geometry.VoxelBlockGrid(*channels, voxel_size, 8, 20000, core.Device("CPU:0"))
    rows = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    intrinsic = core.Tensor(np.array(rows), core.float64)
    for depth, pose in images:
        image = open3d.t.geometry.Image(core.Tensor(depth))
        extrinsic = core.Tensor(pose.inverse().matrix, core.float64)
        blocks = grid.compute_unique_block_coordinates(image, intrinsic, extrinsic, 1.0, 5.0, 4.0)
        grid.integrate(blocks, image, intrinsic, extrinsic, 1.0, 5.0, 4.0)
    mesh = grid.extract_triangle_mesh(0.0)
    return mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()


def errors_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance [m] to the room's surface at 200 001 even steps over the area, in rising order."""
    a, b, c = (vertices[triangles[:, n]].astype(np.float64) for n in range(3))
    error = np.abs(Room().distance((a + b + c) / 3.0))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    order = np.argsort(error)
    steps = np.linspace(0.0, 1.0, 200_001)
    return error[order][np.minimum(np.searchsorted(np.cumsum(area[order]) / area.sum(), steps), len(order) - 1)]


@pytest.mark.parametrize("voxel_size", [0.02, 0.05])
@pytest.mark.parametrize("noise", [False, True], ids=["exact", "noisy"])
def test_the_mesh_is_at_least_as_exact_as_that_of_open3d(voxel_size, noise):
    """The whole room from the same 24 images; noise of a structured-light camera."""
    rng = np.random.default_rng(0)
    images = []
    for pose in TOUR:
        depth = Room().depth(pose, MIDDLE_CAMERA)
        if noise:
            sigma = 0.0012 + 0.0019 * (depth - 0.4) ** 2
            depth = (depth + sigma * rng.standard_normal(depth.shape)).astype(np.float32)
        images.append((depth, pose))
    layer = TsdfMap(voxel_size, max_range_m=5.0)
    for depth, pose in images:
        layer.integrate_image(depth, MIDDLE_CAMERA, pose)
    mesh = layer.mesh()
    ours, peer = errors_of(mesh.vertices, mesh.triangles), errors_of(*open3d_mesh(images, MIDDLE_CAMERA, voxel_size))
    for name, error in (("ours", ours), ("Open3D", peer)):
        print(f"{name}: median {np.median(error) * 1e3:.2f} mm, 95 % {np.percentile(error, 95) * 1e3:.2f} mm")
    assert np.median(ours) <= (0.003 if voxel_size == 0.02 and not noise else 0.01)
    assert np.median(ours) <= np.median(peer)
    assert ours.mean() <= peer.mean()
    assert np.percentile(ours, 95) <= np.percentile(peer, 95)


def test_left_out_images_of_a_real_recording_lie_on_the_mesh():
    """A desk by a Kinect, 2 cm voxels, every fifth image left out: its depths against the mesh of the others."""
    open3d = pytest.importorskip("open3d")
    images = list(open_dataset(recording("tum_fr1_rpy_rgbd")))
    layer = TsdfMap(0.02, max_range_m=5.0)
    for n, image in enumerate(images):
        if n % 5:
            layer.integrate_image(image.depth_m, image.intrinsics, image.T_map_camera)
    mesh = layer.mesh()
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(mesh.vertices), open3d.core.Tensor(mesh.triangles.astype(np.uint32)))
    errors, asked = [], 0
    for image in images[::5]:
        depth = image.depth_m[::3, ::3].ravel()
        rays = image.intrinsics.rays()[::3, ::3].reshape(-1, 3) @ image.T_map_camera.rotation.T
        start = np.broadcast_to(image.T_map_camera.translation, rays.shape)
        hits = scene.cast_rays(open3d.core.Tensor(np.hstack([start, rays]).astype(np.float32)))["t_hit"].numpy()
        counted = (depth > 0.0) & (depth <= 3.0)
        asked += int(counted.sum())
        covered = counted & np.isfinite(hits)
        errors.append(np.abs(hits - depth)[covered])
    error = np.concatenate(errors)
    print(
        f"tum_fr1_rpy at 2 cm: median {np.median(error) * 100:.2f} cm over {len(errors)} left-out images, "
        f"{1.0 - len(error) / asked:.1%} of the pixels not covered by other images"
    )
    assert len(errors) == 13
    assert np.median(error) <= 0.025
    assert len(error) > 0.9 * asked


@pytest.mark.parametrize("with_color", [False, True])
@pytest.mark.parametrize("with_labels", [False, True])
def test_a_ply_file_holds_the_mesh(tmp_path, with_color, with_labels):
    layer = TsdfMap(0.05)
    color = np.full((48, 64, 3), (200, 100, 50), np.uint8) if with_color else None
    layer.integrate_image(np.full((48, 64), 1.0, np.float32), SMALL_CAMERA, SE3.identity(), color)
    mesh = layer.mesh()
    if with_labels:
        mesh = Mesh(
            mesh.vertices, mesh.triangles, mesh.normals, mesh.colors, np.full(len(mesh.vertices), 700, np.uint16)
        )
    mesh.write_ply(tmp_path / "mesh.ply")
    content = (tmp_path / "mesh.ply").read_bytes()
    header, body = content.split(b"end_header\n", 1)
    vertex_bytes = 24 + 3 * with_color + 2 * with_labels
    assert len(body) == vertex_bytes * len(mesh.vertices) + 13 * len(mesh.triangles)
    first = np.frombuffer(body[:24], "<f4")
    assert np.array_equal(first, [*mesh.vertices[0], *mesh.normals[0]])
    order = [header.index(b"property " + name) for name in (b"float x", b"float nx", b"list uchar int vertex_indices")]
    assert all(a < b for a, b in pairwise(order))
    assert (b"uchar red" in header) == with_color
    assert (b"ushort label" in header) == with_labels


def test_open3d_takes_the_mesh():
    open3d = pytest.importorskip("open3d")
    mesh = field_of(ball).mesh().to_open3d()
    assert isinstance(mesh, open3d.geometry.TriangleMesh)
    assert mesh.is_watertight()
    assert mesh.get_volume() == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=5e-3)


def test_values_that_do_not_fit_the_vertices_are_refused():
    corners, triangle = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32)
    with pytest.raises(InvalidParameter, match="labels"):
        Mesh(corners, triangle, corners, labels=np.zeros(2, np.uint16))
    with pytest.raises(InvalidParameter, match="triangles"):
        Mesh(corners, triangle + 1, corners)
