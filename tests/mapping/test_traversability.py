"""Traversability: against its twin, and on ground whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.elevation import ElevationMap, ExtendedElevationMap, HeightMap
from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.multilevel import MultiLevelMap
from mapping.observations import RobotDescription
from mapping.occupancy import OccupancyMap
from mapping.tiles import TileLayer
from mapping.traversability import BLOCKED, TRAVERSABLE, UNKNOWN, TerrainLimits, Traversability, traversability
from tests import naive_elevation as naive
from tests.support.recordings import recording
from tests.support.rooms import MIDDLE_CAMERA, TOUR, Room

SIZE = 0.1
ROBOT = TerrainLimits(
    max_step_m=0.06, max_slope_deg=20.0, max_roughness_m=0.02, height_m=0.8, radius_m=0.25, known_share=0.6
)
LAYERS = [HeightMap, ElevationMap, ExtendedElevationMap, MultiLevelMap]


def patch(heights, x=(0.0, 2.0), y=(0.0, 2.0)) -> np.ndarray:
    """A point in the middle of each cell of a rectangle [m], `heights` of its x and y high."""
    i, j = np.meshgrid(
        np.arange(round(x[0] / SIZE), round(x[1] / SIZE)), np.arange(round(y[0] / SIZE), round(y[1] / SIZE))
    )
    at = (np.stack([i.ravel(), j.ravel()], axis=1) + 0.5) * SIZE
    return np.c_[at, np.broadcast_to(heights(*at.T) if callable(heights) else heights, len(at))]


def mapped(make, *clouds: np.ndarray, **parameters) -> TileLayer:
    layer = make(SIZE, **parameters)
    layer.integrate(np.concatenate(clouds), SE3.identity())
    return layer


def judged(make, *clouds: np.ndarray, **limits) -> Traversability:
    return traversability(mapped(make, *clouds), TerrainLimits(**{**vars(ROBOT), **limits}))


def inner(result: Traversability, margin: float = 0.25, x=(0.0, 2.0), y=(0.0, 2.0), z: float = 0.0) -> np.ndarray:
    """The classes of the cells of a rectangle, away from its border."""
    at = patch(z, (x[0] + margin, x[1] - margin), (y[0] + margin, y[1] - margin))
    return result.classify(at)


# -- what is known ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", LAYERS)
def test_flat_ground_costs_nothing_and_what_was_not_seen_is_unknown(make):
    result = judged(make, patch(0.3))
    at = patch(0.3, (0.3, 1.7), (0.3, 1.7))
    assert (result.classify(at) == TRAVERSABLE).all()
    assert result.query(at) == pytest.approx(0.0, abs=1e-4)
    elsewhere = np.array([[2.35, 1.0, 0.3], [50.0, 0.0, 0.0], [-9.0, 0.0, 0.0]])
    assert (result.classify(elsewhere) == UNKNOWN).all()
    assert np.isnan(result.query(elsewhere)).all()
    assert result.classify(at[:, :2]).tolist() == result.classify(at).tolist()


@pytest.mark.parametrize("make", LAYERS)
@pytest.mark.parametrize(("degrees", "expected"), [(15.0, TRAVERSABLE), (25.0, BLOCKED)])
def test_a_ramp_is_as_steep_as_it_is(make, degrees, expected):
    result = judged(make, patch(lambda x, y: np.tan(np.radians(degrees)) * (0.6 * x + 0.8 * y)))
    middle = np.s_[4:-8, 4:-8, 0]
    assert np.nanmax(np.abs(result.slopes_deg[middle] - degrees)) < 0.05
    assert np.nanmax(result.roughness_m[middle]) < 1e-4
    assert (result.classes[middle] == expected).all()
    assert result.cost[middle] == pytest.approx(1.0 if expected == BLOCKED else degrees / 20.0, abs=0.01)


@pytest.mark.parametrize("make", LAYERS)
def test_a_step_blocks_where_it_is_and_a_threshold_does_not(make):
    step = judged(make, patch(lambda x, y: np.where(x > 1.0, 0.5, 0.0)))
    assert (inner(step, x=(0.0, 0.9)) == TRAVERSABLE).all()
    assert (inner(step, x=(1.1, 2.0), z=0.5) == TRAVERSABLE).all()
    assert (step.classify(patch(0.0, (0.9, 1.1), (0.3, 1.7))) == BLOCKED).all()
    threshold = judged(make, patch(lambda x, y: np.where(x > 1.0, 0.04, 0.0)))
    assert (inner(threshold) == TRAVERSABLE).all()
    assert threshold.query(np.array([[0.95, 1.0, 0.0]])) == pytest.approx(0.04 / 0.06, rel=0.05)


@pytest.mark.parametrize("make", LAYERS)
def test_rough_ground_is_told_by_its_distance_from_a_plane(make):
    bumps = 0.03 * np.random.default_rng(0).choice([-1.0, 1.0], 400)
    rough = judged(make, patch(bumps), max_step_m=0.2)
    assert (inner(rough) == BLOCKED).mean() > 0.95
    assert np.nanmedian(rough.roughness_m[4:-8, 4:-8, 0]) == pytest.approx(0.03, rel=0.15)
    assert (inner(judged(make, patch(bumps / 4.0))) == TRAVERSABLE).all()


@pytest.mark.parametrize("make", LAYERS)
def test_what_is_blocked_for_certain_is_blocked_however_little_is_known(make):
    alone = judged(make, patch(0.0, (0.0, 0.1), (0.0, 0.1)), patch(0.6, (0.1, 0.2), (0.0, 0.1)), patch(0.0, (1.0, 1.1)))
    assert alone.classify(np.array([[0.05, 0.05, 0.0]])).tolist() == [BLOCKED]
    assert (alone.classify(patch(0.0, (1.0, 1.1))) == UNKNOWN).all()


def test_the_edge_of_a_platform_is_a_step_down():
    result = judged(MultiLevelMap, patch(0.0, (0.0, 1.0)), patch(-3.0, (1.0, 2.0)))
    assert (result.classify(patch(0.0, (0.9, 1.0), (0.3, 1.7))) == BLOCKED).all()
    assert (inner(result, x=(0.0, 0.9)) == TRAVERSABLE).all()


# -- levels ----------------------------------------------------------------------------------------------------

BRIDGE = (patch(0.0, (0.0, 3.0)), patch(1.5, (1.0, 2.0)), patch(1.6, (1.0, 2.0)), patch(1.7, (1.0, 2.0)))
"""Ground, and a deck of 20 cm across its middle, 1.5 m above it."""


def test_a_robot_passes_under_a_bridge_and_over_it():
    result = judged(MultiLevelMap, *BRIDGE)
    assert (inner(result, x=(0.0, 3.0)) == TRAVERSABLE).all()
    assert (inner(result, x=(1.0, 2.0), z=1.7) == TRAVERSABLE).all()
    under = result.clearance_m[14, 10]
    assert under[:2] == pytest.approx([1.5, np.inf])
    assert (result.classify(patch(1.7, (1.0, 1.1), (0.3, 1.7))) == BLOCKED).all()  # a drop on its edge


def test_a_robot_that_is_too_tall_does_not_pass_under_a_bridge():
    result = judged(MultiLevelMap, *BRIDGE, height_m=1.55)
    assert (inner(result, x=(1.0, 2.0)) == BLOCKED).all()
    assert (inner(result, x=(1.0, 2.0), z=1.7) == TRAVERSABLE).all()


def test_an_extended_elevation_map_passes_under_a_bridge_and_an_elevation_map_does_not():
    layer = mapped(ExtendedElevationMap, *BRIDGE, robot_height_m=0.8)
    extended, plain = traversability(layer, ROBOT), judged(ElevationMap, *BRIDGE)
    assert (inner(extended, x=(0.0, 3.0)) == TRAVERSABLE).all()
    assert (plain.classify(patch(0.0, (1.0, 1.1), (0.3, 1.7))) == BLOCKED).all()


@pytest.mark.parametrize("make", [HeightMap, ExtendedElevationMap, MultiLevelMap])
def test_where_only_a_ceiling_was_seen_nothing_is_known_of_the_floor(make):
    result = judged(make, patch(0.0, (0.0, 1.0)), patch(2.5, (1.0, 2.0)))
    assert (result.classify(patch(0.0, (1.0, 2.0))) == UNKNOWN).all()
    assert (result.classify(patch(0.0, (0.3, 0.8), (0.3, 1.7))) == TRAVERSABLE).all()


@pytest.mark.parametrize("make", LAYERS)
def test_a_wall_blocks_its_own_cells_and_their_neighbours_only(make):
    wall = [patch(z, (1.0, 1.1)) for z in np.arange(0.0, 2.0, 0.05)]
    result = judged(make, patch(0.0), *wall)
    assert (result.classify(patch(0.0, (0.9, 1.2), (0.3, 1.7))) == BLOCKED).all()
    assert (inner(result, x=(0.0, 1.1)) == TRAVERSABLE).all()


# -- overhead --------------------------------------------------------------------------------------------------


def furnished() -> tuple[OccupancyMap, MultiLevelMap]:
    occupancy, layer = OccupancyMap(0.05), MultiLevelMap(SIZE, gap_m=0.2)
    for pose in TOUR[::3]:
        depth = Room().depth(pose, MIDDLE_CAMERA)
        occupancy.integrate_image(depth, MIDDLE_CAMERA, pose)
        layer.integrate_image(depth, MIDDLE_CAMERA, pose)
    return occupancy, layer


def test_overhead_is_what_the_occupancy_map_says_voxel_by_voxel():
    occupancy, layer = furnished()
    robot = TerrainLimits(height_m=1.5, known_share=0.7)
    free, seen = traversability(layer, robot), traversability(layer, robot, overhead=occupancy)
    assert {TRAVERSABLE, BLOCKED, UNKNOWN} == set(np.unique(seen.classes))
    cells = np.argwhere(~np.isnan(seen.heights))
    for i, j, level in cells[np.random.default_rng(0).choice(len(cells), 150, replace=False)]:
        z = seen.heights[i, j, level]
        corner = seen.corner_m + np.array([i, j]) * SIZE
        layers = np.arange(np.ceil((z + robot.max_step_m) / 0.05 - 1e-6), np.ceil((z + robot.height_m) / 0.05 - 1e-6))
        voxels = np.array(
            [
                [*(corner + o), (k + 0.5) * 0.05]
                for k in layers
                for o in ([0.02, 0.02], [0.02, 0.07], [0.07, 0.02], [0.07, 0.07])
            ]
        )
        classes = occupancy.classify(voxels)
        lowest = (np.floor(voxels[classes == 1, 2] / 0.05) * 0.05).min(initial=np.inf) - z
        assert seen.clearance_m[i, j, level] == pytest.approx(min(lowest, free.clearance_m[i, j, level]), abs=1e-6)
        if lowest < robot.height_m:
            assert seen.classes[i, j, level] == BLOCKED
        elif (classes >= 0).mean() < robot.known_share and free.classes[i, j, level] == TRAVERSABLE:
            assert seen.classes[i, j, level] == UNKNOWN
        else:
            assert seen.classes[i, j, level] == free.classes[i, j, level]


def test_room_above_that_nobody_looked_at_is_unknown():
    layer = mapped(ElevationMap, patch(0.0))
    assert (inner(traversability(layer, ROBOT)) == TRAVERSABLE).all()
    assert (inner(traversability(layer, ROBOT, overhead=OccupancyMap(0.05))) == UNKNOWN).all()


# -- against the twin ------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), known=st.floats(0.3, 1.0))
@settings(deadline=None, max_examples=15)
def test_ground_matches_the_naive_reference(seed, known):
    rng = np.random.default_rng(seed)
    clouds = [patch(0.0, (-0.4, 0.4), (-0.4, 0.4)) for _ in range(3)]
    for n, cloud in enumerate(clouds):
        cloud[:, 2] = 1.1 * n + rng.normal(0.0, 0.05, len(cloud)) + 0.3 * cloud[:, 0]
    layer = mapped(MultiLevelMap, *(cloud[rng.random(len(cloud)) < known] for cloud in clouds), gap_m=0.2)
    result = traversability(layer, ROBOT)
    first = np.round(result.corner_m / SIZE).astype(int)
    surfaces: naive.Surfaces = {}
    for i, j, level in np.argwhere(~np.isnan(result.heights)):
        surfaces.setdefault((i + first[0], j + first[1]), []).append(
            (result.heights[i, j, level], result.bottoms[i, j, level])
        )
    for i, j, level in np.argwhere(~np.isnan(result.heights)):
        cell, z = (i + first[0], j + first[1]), result.heights[i, j, level]
        expected = naive.ground(surfaces, cell, z, 0.25, SIZE, 0.8, 0.06, np.tan(np.radians(20.0)))
        assert result.steps_m[i, j, level] == pytest.approx(expected.step)
        assert result.slopes_deg[i, j, level] == pytest.approx(np.degrees(expected.slope), abs=1e-6, nan_ok=True)
        assert result.roughness_m[i, j, level] == pytest.approx(expected.roughness, abs=1e-6, nan_ok=True)
        worst = max(expected.step / 0.06, expected.slope / np.radians(20.0), expected.roughness / 0.02)
        blocked = worst > 1.0 or result.clearance_m[i, j, level] < 0.8
        told = expected.known >= 0.6 and not np.isnan(expected.slope)
        assert result.classes[i, j, level] == (BLOCKED if blocked else TRAVERSABLE if told else UNKNOWN)


@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=10)
def test_knowing_less_never_makes_ground_traversable_that_was_unknown(seed):
    """Cells taken away can only turn traversable ground unknown, where no limit was broken to begin with."""
    rng = np.random.default_rng(seed)
    cloud = patch(lambda x, y: 0.1 * x)
    fewer = cloud[rng.random(len(cloud)) < 0.7]
    whole, part = judged(ElevationMap, cloud), judged(ElevationMap, fewer)
    assert (whole.classify(cloud) != BLOCKED).all()
    assert (whole.classify(cloud)[part.classify(cloud) == TRAVERSABLE] == TRAVERSABLE).all()


# -- real scans ------------------------------------------------------------------------------------------------


def test_the_floor_of_a_real_corridor_is_traversable_and_its_walls_are_not():
    from mapping.datasets import open_dataset

    scan = next(iter(open_dataset(recording("3dtk_dat_lidar_odometry"))))
    for make in (ElevationMap, ExtendedElevationMap, MultiLevelMap):
        layer = make(SIZE, max_range_m=6.0, **({"above_sensor_m": 1.0} if make is ElevationMap else {}))
        layer.integrate(scan.points, SE3.identity())
        result = traversability(layer)
        floor = result.classify(patch(-0.4, (1.5, 3.5), (-0.4, 0.8)))
        assert (floor == TRAVERSABLE).mean() > 0.9
        assert (floor == UNKNOWN).mean() < 0.05
        wall = result.classify(patch(-0.4, (2.3, 3.5), (-0.9, -0.7)))
        assert (wall == BLOCKED).mean() > 0.8
        assert (wall == TRAVERSABLE).mean() < 0.1


# -- the shell -------------------------------------------------------------------------------------------------


def test_a_region_may_be_judged_alone():
    layer = mapped(ElevationMap, patch(0.0))
    whole, part = traversability(layer, ROBOT), traversability(layer, ROBOT, lo=[0.5, 0.5], hi=[1.5, 1.5])
    assert part.heights.shape == (10, 10, 1)
    assert part.corner_m == pytest.approx([0.5, 0.5])
    at = patch(0.0, (0.8, 1.2), (0.8, 1.2))
    assert part.query(at) == pytest.approx(whole.query(at))
    assert whole.level(0.0).shape == whole.heights.shape[:2]
    assert traversability(ElevationMap(SIZE)).heights.size == 0


def test_limits_come_from_a_described_robot():
    robot = RobotDescription(robot="r", footprint=[[0.3, 0.0], [-0.3, 0.2], [-0.3, -0.2]], height_m=1.2)
    limits = TerrainLimits.of(robot, max_step_m=0.1)
    assert (limits.height_m, limits.max_step_m) == (1.2, 0.1)
    assert limits.radius_m == pytest.approx(np.hypot(0.3, 0.2))


@pytest.mark.parametrize(
    "name", ["max_step_m", "max_slope_deg", "max_roughness_m", "height_m", "radius_m", "known_share"]
)
def test_bad_limits_are_refused_by_name(name):
    for bad in (0.0, float("nan"), 1000.0):
        with pytest.raises(InvalidParameter, match=name):
            TerrainLimits(**{name: bad})


def test_layers_without_heights_are_refused():
    with pytest.raises(InvalidParameter, match="layer"):
        traversability(OccupancyMap(0.1))
