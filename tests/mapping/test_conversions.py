"""Surfaces from one representation to another: what is said of distances, sides, shares and holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mapping.conversions import (
    estimate_normals,
    mesh_to_points,
    points_to_mesh,
    points_to_tsdf,
    surfels_to_points,
    tsdf_to_occupancy,
)
from mapping.errors import InvalidParameter
from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.grid import ijk_to_centre, join_ijk
from mapping.mesh import Mesh
from mapping.occupancy import FREE, OCCUPIED, UNKNOWN
from mapping.surfels import SurfelMap
from mapping.tsdf import TsdfMap
from tests.support.rooms import MIDDLE_CAMERA, TOUR, Room

SPACING = 0.05


def ball(n: int, radius: float = 0.5, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points on a ball about (0.3, 0.2, 0.1), seen from outside."""
    normals = np.random.default_rng(seed).normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return radius * normals + [0.3, 0.2, 0.1], normals


def plate(spacing: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A square of 1 m in an oblique plane."""
    u, v = np.meshgrid(np.arange(-0.5, 0.5, spacing), np.arange(-0.5, 0.5, spacing))
    pose = SE3.exp([0.02, 0.03, 0.01, 0.4, 0.2, 0.3])
    flat = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    return pose @ flat, np.tile(pose.rotation[:, 2], (u.size, 1))


@pytest.fixture(scope="module")
def room_tsdf() -> TsdfMap:
    layer = TsdfMap(SPACING)
    for n in (0, 2, 4, 6):
        layer.integrate_image(Room().depth(TOUR[n], MIDDLE_CAMERA), MIDDLE_CAMERA, TOUR[n])
    return layer


def voxels_of(layer: TsdfMap) -> np.ndarray:
    """(n, 512, 3) the voxels of all blocks."""
    n = len(layer.block_ijk)
    ijk = join_ijk(np.repeat(layer.block_ijk, 512, axis=0), np.tile(np.arange(512), n))
    return ijk.reshape(n, 512, 3)


# -- mesh → points -----------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), n=st.integers(1, 12), spacing=st.floats(0.1, 2.0))
@settings(deadline=None, max_examples=40)
def test_every_triangle_gets_its_share_of_points_and_they_lie_on_it(seed, n, spacing):
    random = np.random.default_rng(seed)
    vertices = random.uniform(-1.0, 1.0, (3 * n, 3)).astype(np.float32)
    triangles = np.arange(3 * n, dtype=np.int32).reshape(-1, 3)
    mesh = Mesh(vertices, triangles, np.zeros((3 * n, 3), np.float32))
    points, normals, rows = mesh_to_points(mesh, spacing, seed=seed)
    assert len(points) == round(mesh.area_m2 / spacing**2)
    a, b, c = (vertices[triangles[:, k]].astype(np.float64) for k in range(3))
    across = np.cross(b - a, c - a)
    areas = 0.5 * np.linalg.norm(across, axis=1)
    share = areas / areas.sum() * len(points)
    assert (np.abs(np.bincount(rows, minlength=n) - share) <= 1.0 + 1e-9).all()
    for point, normal, row in zip(points.astype(np.float64), normals, rows, strict=True):
        unit = across[row] / (2.0 * areas[row])
        assert normal == pytest.approx(unit, abs=1e-5)
        assert (point - a[row]) @ unit == pytest.approx(0.0, abs=1e-6)
        parts = [np.cross(q - p, point - p) @ unit for p, q in ((a[row], b[row]), (b[row], c[row]), (c[row], a[row]))]
        assert min(parts) > -1e-6


def test_points_of_a_triangle_are_spread_evenly():
    mesh = Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), "f4")
    )
    points = mesh_to_points(mesh, 0.005)[0]
    assert points.mean(axis=0) == pytest.approx([1 / 3, 1 / 3, 0.0], abs=0.01)
    halves = [(points[:, 0] < 0.5) & (points[:, 1] < 0.5), points[:, 0] >= 0.5, points[:, 1] >= 0.5]
    assert [half.mean() for half in halves] == pytest.approx([0.5, 0.25, 0.25], abs=0.01)
    assert np.array_equal(mesh_to_points(mesh, 0.01, seed=1)[0], mesh_to_points(mesh, 0.01, seed=1)[0])
    assert not np.array_equal(mesh_to_points(mesh, 0.01, seed=1)[0], mesh_to_points(mesh, 0.01, seed=2)[0])


def test_an_empty_mesh_gives_no_points():
    mesh = Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.float32))
    assert [len(part) for part in mesh_to_points(mesh, 0.1)] == [0, 0, 0]
    line = Mesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.float32))
    assert [len(part) for part in mesh_to_points(line, 0.1)] == [0, 0, 0]
    with pytest.raises(InvalidParameter, match="spacing_m"):
        mesh_to_points(mesh, 0.0)


def test_distances_to_mesh_to_points_stay_on_the_surface(room_tsdf):
    points, normals, _ = mesh_to_points(room_tsdf.mesh(), 0.03)
    distance = np.abs(room_tsdf.query(points))
    assert np.quantile(distance, 0.95) < 0.05 * SPACING
    assert distance.max() < SPACING  # where the room has edges, triangles cut corners of the interpolated surface
    assert np.quantile(np.abs(Room().distance(points.astype(np.float64))), 0.9) < 0.1 * SPACING
    before = room_tsdf.query(points + 0.5 * SPACING * normals)
    assert np.nanquantile(before, 0.01) > 0.0


# -- points → distances, mesh ------------------------------------------------------------------------------------


def test_distances_from_points_are_those_of_their_surface():
    points, normals = ball(4000)
    layer = points_to_tsdf(points, normals, SPACING)
    centres = ijk_to_centre(voxels_of(layer), SPACING)
    true = np.linalg.norm(centres - [0.3, 0.2, 0.1], axis=2) - 0.5
    known = layer.store.used("weight") > 0.0
    assert np.abs(layer.store.used("distance") - true)[known].max() < 0.1 * SPACING
    assert known[np.abs(true) < 0.9 * layer.truncation_m].mean() > 0.99
    assert not known[np.abs(true) > 1.1 * layer.truncation_m].any()


def test_distances_from_points_average_their_noise():
    points, normals = ball(8000)
    noise = np.random.default_rng(1).normal(0.0, 0.2 * SPACING, (len(points), 1))
    mesh = points_to_tsdf(points + noise * normals, normals, SPACING).mesh()
    off = np.linalg.norm(mesh.vertices - [0.3, 0.2, 0.1], axis=1) - 0.5
    assert np.std(off) < 0.6 * np.std(noise)
    assert abs(np.mean(off)) < 0.02 * SPACING


def test_distances_from_a_plate_are_exact_and_end_where_it_ends():
    points, normals = plate()
    layer = points_to_tsdf(points, normals, SPACING, 0.1)
    centres = ijk_to_centre(voxels_of(layer), SPACING)
    known = layer.store.used("weight") > 0.0
    height = (centres - points[0]) @ normals[0]
    assert np.abs(layer.store.used("distance") - height)[known].max() < 1e-5
    beyond = np.sqrt(np.maximum(cKDTree(points).query(centres[known])[0] ** 2 - height[known] ** 2, 0.0))
    assert beyond.max() <= 1.5 * SPACING + 1e-6


@given(
    seed=st.integers(0, 10_000),
    radius=st.floats(0.15, 0.4),
    spacing=st.floats(0.03, 0.06),
    shift=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
)
@settings(deadline=None, max_examples=8)
def test_points_to_mesh_to_points_stay_near_whatever_the_ball(seed, radius, spacing, shift):
    points, normals = ball(round(30.0 * (radius / spacing) ** 2), radius, seed)
    mesh = points_to_mesh(points + shift, normals, spacing)
    again = mesh_to_points(mesh, 0.4 * spacing, seed=seed)[0] - np.array(shift)
    assert np.abs(np.linalg.norm(again - [0.3, 0.2, 0.1], axis=1) - radius).max() < 0.5 * spacing
    assert cKDTree(again).query(points)[0].max() < 1.4 * spacing


@pytest.mark.parametrize(("method", "near"), [("distance", 0.5), ("poisson", 1.0), ("ball_pivoting", 0.5)])
def test_points_to_mesh_to_points_stay_near(method, near):
    points, normals = ball(4000)
    mesh = points_to_mesh(points, normals, SPACING, method)
    again, sides, _ = mesh_to_points(mesh, 0.02)
    off = np.abs(np.linalg.norm(again - [0.3, 0.2, 0.1], axis=1) - 0.5)
    assert off.max() < near * SPACING  # what came stays on the surface
    assert cKDTree(again).query(points)[0].max() < SPACING + 0.02  # and all of the surface stays
    outwards = (again - [0.3, 0.2, 0.1]) / 0.5
    assert (np.einsum("ni,ni->n", sides, outwards) > 0.5).mean() > 0.99
    assert mesh.area_m2 == pytest.approx(4.0 * np.pi * 0.25, rel=0.03)


@pytest.mark.parametrize("method", ["distance", "poisson", "ball_pivoting"])
def test_a_wide_hole_stays_open(method):
    points, normals = plate()
    solid = np.linalg.norm(points - points.mean(axis=0), axis=1) > 0.3
    mesh = points_to_mesh(points[solid], normals[solid], SPACING, method)
    again = mesh_to_points(mesh, 0.02)[0]
    assert np.linalg.norm(again - points.mean(axis=0), axis=1).min() > 0.3 - 3.5 * SPACING


def test_conversions_of_points_refuse_what_they_cannot_use():
    points, normals = ball(50)
    with pytest.raises(InvalidParameter, match="normals"):
        points_to_tsdf(points, normals[:-1], SPACING)
    with pytest.raises(InvalidParameter, match="unit"):
        points_to_tsdf(points, 2.0 * normals, SPACING)
    with pytest.raises(InvalidParameter, match="finite"):
        points_to_tsdf(points * np.nan, normals, SPACING)
    with pytest.raises(InvalidParameter, match="method"):
        points_to_mesh(points, normals, SPACING, "marching")
    with pytest.raises(InvalidParameter, match="normals"):
        points_to_mesh(points, normals[:-1], SPACING, "poisson")
    with pytest.raises(InvalidParameter, match="four or more"):
        points_to_mesh(points[:3], normals[:3], SPACING, "ball_pivoting")
    with pytest.raises(InvalidParameter, match="spacing_m"):
        points_to_mesh(points, normals, -1.0)
    assert len(points_to_mesh(np.empty((0, 3)), np.empty((0, 3)), SPACING).triangles) == 0


def test_normals_of_points_look_to_the_sensor():
    points, normals = ball(2000)
    outside = points + 3.0 * normals
    found = estimate_normals(points, outside)
    assert np.quantile(np.einsum("ni,ni->n", found, normals), 0.01) > 0.97
    assert np.einsum("ni,ni->n", estimate_normals(points, [0.3, 0.2, 0.1]), normals).max() < 0.0
    with pytest.raises(InvalidParameter, match="seen_from"):
        estimate_normals(points, outside[:-1])
    with pytest.raises(InvalidParameter, match="neighbours"):
        estimate_normals(points[:5], outside[0])


# -- distances → occupancy ---------------------------------------------------------------------------------------


def test_occupancy_of_distances_has_their_sides(room_tsdf):
    occupancy = tsdf_to_occupancy(room_tsdf)
    centres = ijk_to_centre(voxels_of(room_tsdf), SPACING)
    distance, weight = room_tsdf.store.used("distance"), room_tsdf.store.used("weight")
    expected = np.where(weight == 0.0, UNKNOWN, np.where(distance > 0.0, FREE, OCCUPIED))
    assert np.array_equal(occupancy.classify(centres.reshape(-1, 3)).reshape(expected.shape), expected)
    sure = occupancy.query(centres.reshape(-1, 3))
    assert np.nanmin(sure) == pytest.approx(occupancy.lowest, abs=0.01)
    assert np.nanmax(sure) == pytest.approx(occupancy.highest, abs=0.01)


def test_faces_of_the_occupancy_lie_within_half_a_voxel_of_the_zero_crossings(room_tsdf):
    """Along each axis, between every two neighbours of which one is occupied and one is free."""
    occupancy = tsdf_to_occupancy(room_tsdf)
    occupied = occupancy.occupied_centres()
    faces = 0
    for step in np.concatenate([np.eye(3), -np.eye(3)]):
        free = occupied + SPACING * step
        met = occupancy.classify(free) == FREE
        behind = room_tsdf.store.locate(occupied[met])
        before = room_tsdf.store.locate(free[met])
        d0, d1 = (room_tsdf.store.fields["distance"][at].astype(np.float64) for at in (behind, before))
        crossing = -d0 / (d1 - d0)  # 0 … 1 from the occupied centre to the free one; the face is at ½
        assert ((crossing >= 0.0) & (crossing <= 1.0)).all()
        faces += int(met.sum())
    assert faces > 1000
    # and the other way: no zero crossing without a face
    vertices = room_tsdf.mesh().vertices.astype(np.float64)
    reach = np.array(
        [cKDTree(occupied).query(vertices)[0].max(), cKDTree(occupancy.free_centres()).query(vertices)[0].max()]
    )
    assert (reach <= SPACING + 1e-6).all()


def test_occupancy_of_distances_feeds_a_distance_field(room_tsdf):
    occupancy = tsdf_to_occupancy(room_tsdf)
    field = EsdfMap(occupancy, 0.3)
    centres = ijk_to_centre(voxels_of(room_tsdf), SPACING).reshape(-1, 3)
    distance, weight = (room_tsdf.store.used(name).ravel() for name in ("distance", "weight"))
    asked = (weight > 0.0) & (np.abs(distance) < 0.1)
    found = field.query(centres[asked])
    both = np.isfinite(found)
    assert both.mean() > 0.5
    assert (np.sign(found[both]) == np.sign(distance[asked][both])).mean() > 0.99


def test_an_empty_map_becomes_an_empty_map():
    assert len(tsdf_to_occupancy(TsdfMap(SPACING)).occupied_centres()) == 0


# -- surfels → points --------------------------------------------------------------------------------------------


def test_points_of_surfels_lie_on_their_discs():
    layer = SurfelMap(0.2)
    layer.integrate(Room().scan(TOUR[0], 8000), TOUR[0])
    surfels = layer.surfels
    centres, normals = surfels_to_points(surfels)
    assert np.allclose(centres, surfels.centres, atol=1e-6)
    assert np.array_equal(normals, surfels.normals)
    points, normals = surfels_to_points(surfels, 0.03)
    rows = np.repeat(
        np.arange(len(surfels)), np.maximum(np.rint(np.pi * surfels.radii.astype(float) ** 2 / 0.03**2), 1).astype(int)
    )
    offset = points - surfels.centres[rows]
    assert np.array_equal(normals, surfels.normals[rows])
    assert np.abs(np.einsum("ni,ni->n", offset, normals)).max() < 1e-6
    share = np.linalg.norm(offset, axis=1) / surfels.radii[rows]
    assert share.max() < 1.0 + 1e-4
    assert (share**2).mean() == pytest.approx(0.5, abs=0.02)  # uniform by area
    with pytest.raises(InvalidParameter, match="spacing_m"):
        surfels_to_points(surfels, 0.0)
