"""Bodies among voxels: the answers are those of looking at every voxel that a body touches."""

from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from mapping.collision import SweepReport, Verdict, spheres_are_free, sweep
from mapping.errors import InvalidParameter
from mapping.esdf import EsdfMap
from mapping.grid import BLOCK_VOXELS, ijk_to_centre, join_ijk
from mapping.occupancy import OccupancyMap
from tests import naive_distances as naive
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

SIZE = 0.1
BLOCKS = np.array(list(product(range(-2, 2), repeat=3)), np.int32)
BOX = np.array([[0.3, 0.2], [-0.25, 0.2], [-0.25, -0.2], [0.3, -0.2]])
HOOK = np.array([[-0.3, -0.3], [0.4, -0.3], [0.4, -0.1], [-0.1, -0.1], [-0.1, 0.35], [-0.3, 0.35]])
THIN = np.array([[-0.21, 0.01], [0.32, -0.013], [0.3, 0.02]])
PLANS = st.sampled_from([BOX, HOOK, HOOK[::-1], THIN])


def world(seed: int, occupied: float, unknown: float) -> tuple[OccupancyMap, EsdfMap]:
    """4³ blocks about the origin, edge 3.2 m, with few occupied and unknown voxels; all else is unknown."""
    rng = np.random.default_rng(seed)
    evidence = np.where(rng.random((64, BLOCK_VOXELS)) < occupied, 5, -5).astype(np.int8)
    evidence[rng.random(evidence.shape) < unknown] = -128
    source = OccupancyMap(SIZE)
    source.set_evidence(BLOCKS, evidence)
    return source, EsdfMap(source, 0.6)


SOURCES = st.builds(world, st.integers(0, 2**32), st.sampled_from([0, 1e-4, 3e-3]), st.sampled_from([0, 1e-4, 1e-2]))


def cube_corners(voxel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return voxel * SIZE, (voxel + 1) * SIZE


@settings(max_examples=25, deadline=None)
@given(SOURCES, st.integers(0, 2**32))
def test_spheres_are_judged_as_by_looking_at_every_voxel(made, seed):
    source, field = made
    rng = np.random.default_rng(seed)
    centres, radii = rng.uniform(-1.7, 1.7, (30, 3)), rng.choice([0.02, 0.1, 0.35, 0.8], 30)
    verdicts = spheres_are_free(field, centres, radii)
    for centre, radius, verdict in zip(centres, radii, verdicts, strict=True):
        voxels = naive.touched_by_sphere(centre, radius, SIZE)
        assert verdict == naive.verdict(source.classify(ijk_to_centre(voxels, SIZE)))
    assert np.array_equal(spheres_are_free(field, centres, 0.1), spheres_are_free(field, centres, np.full(30, 0.1)))


def touched(plan: np.ndarray, height: float, pose: np.ndarray) -> np.ndarray:
    turned = affinity.rotate(shapely.Polygon(plan), pose[3], origin=(0, 0), use_radians=True)
    return naive.touched_by_prism(affinity.translate(turned, *pose[:2]), pose[2], pose[2] + height, SIZE)


@settings(max_examples=25, deadline=None)
@given(SOURCES, PLANS, st.floats(0.05, 1.2), st.integers(0, 2**32))
def test_footprints_are_judged_as_by_looking_at_every_voxel(made, plan, height, seed):
    source, field = made
    rng = np.random.default_rng(seed)
    way = np.column_stack([rng.uniform(-1.4, 1.4, (2, 2)), rng.uniform(-1.7, 1.2, 2), rng.uniform(-4, 4, 2)])
    report = sweep(field, plan, height, way, step_m=0.7)
    occupied = np.floor(source.occupied_centres() / SIZE).astype(int)
    for n, pose in enumerate(report.poses):
        voxels = touched(plan, height, pose)
        codes = source.classify(ijk_to_centre(voxels, SIZE))
        verdict = naive.verdict(codes)
        assert report.verdicts[n] == verdict
        here = np.floor(report.where[n] / SIZE).astype(int)
        decided = codes[(voxels == here).all(axis=1)]
        assert decided == {Verdict.COLLIDES: 1, Verdict.UNKNOWN: -1, Verdict.FREE: 0}[verdict]
        if verdict == Verdict.UNKNOWN:
            assert np.isnan(report.clearance_m[n])
        elif verdict == Verdict.COLLIDES:
            assert report.clearance_m[n] == 0.0
        elif len(occupied):
            assert report.clearance_m[n] <= true_clearance(plan, height, pose, occupied) + 1e-9


def true_clearance(plan: np.ndarray, height: float, pose: np.ndarray, occupied: np.ndarray) -> float:
    """From the body to the nearest occupied cube [m]."""
    turned = affinity.rotate(shapely.Polygon(plan), pose[3], origin=(0, 0), use_radians=True)
    low, high = cube_corners(occupied)
    across = shapely.distance(
        affinity.translate(turned, *pose[:2]), shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    )
    along = np.maximum(np.maximum(low[:, 2] - pose[2] - height, pose[2] - high[:, 2]), 0.0)
    return float(np.hypot(across, along).min())


@settings(max_examples=40, deadline=None)
@given(PLANS, st.integers(0, 2**32), st.integers(1, 4), st.floats(0.02, 0.5))
def test_no_point_of_the_body_moves_farther_than_a_step(plan, seed, n, step):
    rng = np.random.default_rng(seed)
    way = np.column_stack([rng.uniform(-1, 1, (n, 3)), rng.uniform(-7, 7, n)])
    report = sweep(EsdfMap(voxel_size_m=SIZE), plan, 0.5, way, step)
    c, s = np.cos(report.poses[:, 3, None]), np.sin(report.poses[:, 3, None])
    x, y = report.poses[:, :1] + c * plan[:, 0] - s * plan[:, 1], report.poses[:, 1:2] + s * plan[:, 0] + c * plan[:, 1]
    corners = np.stack([x, y, np.broadcast_to(report.poses[:, 2:3], x.shape)], axis=-1)
    assert (np.linalg.norm(np.diff(corners, axis=0), axis=-1) <= step + 1e-9).all()
    firsts = np.flatnonzero(np.diff(report.leg, prepend=-1))
    assert np.allclose(report.poses[firsts], way)
    assert np.array_equal(report.leg[firsts], np.arange(n))
    assert report.verdict == Verdict.UNKNOWN


def thin_post_between(margin_m: float) -> SweepReport:
    source, field = world(0, 0.0, 0.0)
    block = np.array([[0, 0, 0]])
    evidence = source.evidence_of(block).copy()
    evidence[0, 0] = 5  # the voxel from 0 to 0.1 m
    source.set_evidence(block, evidence)
    plate = np.array([[-0.05, -0.2], [0.05, -0.2], [0.05, 0.2], [-0.05, 0.2]])
    return sweep(field, plate, 0.5, [[-0.4, 0.05, 0.0], [0.5, 0.05, 0.0]], 0.9, margin_m=margin_m)


def test_a_margin_of_half_a_step_covers_what_lies_between_the_poses():
    assert thin_post_between(0.0).verdict == Verdict.FREE
    assert thin_post_between(0.45).verdict == Verdict.COLLIDES


def test_a_robot_may_stand_on_the_floor_and_beside_a_wall():
    source, field = world(0, 0.0, 0.0)
    ijk = join_ijk(np.repeat(BLOCKS, BLOCK_VOXELS, axis=0), np.tile(np.arange(BLOCK_VOXELS), 64))
    solid = (ijk[:, 2] < 0) | (ijk[:, 0] >= 5)
    source.set_evidence(BLOCKS, np.where(solid, 5, -5).astype(np.int8).reshape(64, BLOCK_VOXELS))
    square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
    assert sweep(field, square, 0.5, [[0.3, 0.0, 0.0]]).verdict == Verdict.FREE
    assert sweep(field, square, 0.5, [[0.3, 0.0, -0.001, 0.0]]).verdict == Verdict.COLLIDES
    report = sweep(field, square, 0.5, [[-0.5, 0.0, 0.0], [0.6, 0.0, 0.0]])
    assert report.verdict == Verdict.COLLIDES
    assert report.first_blocked is not None
    assert 0.3 < report.poses[report.first_blocked, 0] < 0.45
    assert (report.verdicts[: report.first_blocked] == Verdict.FREE).all()
    assert report.where[report.first_blocked, 0] == pytest.approx(0.55)
    assert spheres_are_free(field, [[0.0, 0.0, 0.3], [0.0, 0.0, 0.3]], [0.299, 0.301]).tolist() == [1, 0]


def test_the_answers_follow_the_map_and_a_saved_field_keeps_them(tmp_path):
    source = OccupancyMap(SIZE)
    field = EsdfMap(source, 0.6)
    centres = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3))
    assert (spheres_are_free(field, centres, 0.2) == Verdict.UNKNOWN).all()
    for pose in TOUR:
        source.integrate_image(Room().depth(pose, SMALL_CAMERA), SMALL_CAMERA, pose)
    verdicts = spheres_are_free(field, centres, 0.2)
    assert set(verdicts.tolist()) == {-1, 0, 1}
    assert (Room().distance(centres[verdicts == Verdict.FREE]) > 0.2 - 0.1 * 3**0.5).all()
    field.save(tmp_path / "field.npz")
    loaded = EsdfMap.load(tmp_path / "field.npz")
    assert np.array_equal(spheres_are_free(loaded, centres, 0.2), verdicts)


def test_points_that_are_nowhere_are_unknown():
    _, field = world(0, 0.0, 0.0)
    assert spheres_are_free(field, [[np.nan, 0, 0], [1e30, 0, 0], [0, 0, 0]], 0.1).tolist() == [-1, -1, 1]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("footprint", {"footprint": [[0, 0], [1, 1], [1, 0], [0, 1]]}),
        ("footprint", {"footprint": [[0, 0], [1, 1]]}),
        ("footprint", {"footprint": [[0, 0], [1, np.nan], [1, 0]]}),
        ("height_m", {"height_m": 0.0}),
        ("poses", {"poses": [[0.0, 0.0]]}),
        ("poses", {"poses": np.empty((0, 4))}),
        ("poses", {"poses": [[0.0, np.inf, 0.0]]}),
        ("step_m", {"step_m": -1.0}),
        ("margin_m", {"margin_m": -0.1}),
    ],
)
def test_bad_values_are_refused_by_name(name, change):
    good = {"footprint": BOX, "height_m": 0.5, "poses": [[0.0, 0.0, 0.0]]}
    with pytest.raises(InvalidParameter, match=name):
        sweep(EsdfMap(voxel_size_m=SIZE), **{**good, **change})


@pytest.mark.parametrize("radius", [0.0, np.nan, [0.1, 0.2, 0.3], [[0.1, 0.1]]])
def test_bad_radii_are_refused(radius):
    with pytest.raises(InvalidParameter, match="radius_m"):
        spheres_are_free(EsdfMap(voxel_size_m=SIZE), np.zeros((2, 3)), radius)
