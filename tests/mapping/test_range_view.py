"""Range images: coarse to fine says what voxel by voxel says, and that is what beams say where both know."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.kernels import lidar as kernels
from mapping.kernels.occupancy import MISS
from mapping.kernels.visibility import FREE
from mapping.occupancy import UNKNOWN, OccupancyMap
from mapping.range_view import RangeView
from mapping.sensors import LidarModel
from tests import naive_lidar as naive
from tests.support.rooms import Room

EVEN = LidarModel.even(32, -0.4, 0.4, 256)
UNEVEN = LidarModel([0.5, 0.3, 0.25, 0.21, 0.2, 0.0, -0.05, -0.3, -0.31], 90, first_azimuth=0.7)
GAPPED = LidarModel([0.4, 0.38, 0.1, 0.05, -0.6], 64, widest_gap=0.08)
PLANAR = LidarModel([0.0], 180, first_azimuth=0.75 * np.pi, span=1.5 * np.pi)
HALF = LidarModel.even(16, -0.6, 0.2, 60, first_azimuth=0.4 * np.pi, span=0.9 * np.pi)
STEEP = LidarModel.even(24, -1.55, 1.5, 48)
models = st.sampled_from([EVEN, UNEVEN, GAPPED, PLANAR, HALF, STEEP])
OFF_BORDERS = SE3.exp([0.0123, 0.0231, 0.0312, 0.0041, 0.0013, 0.0027])
"""So that no voxel lies just between two beams, where rounding decides."""
poses = st.builds(
    lambda xi: SE3.exp(xi) @ OFF_BORDERS,
    st.tuples(*[st.floats(-0.5, 0.5)] * 3, *[st.floats(-0.6, 0.6)] * 2, st.floats(-3.1, 3.1)).map(list),
)
ROUGH = (0.05, 0.1, 0.25)


def ranges_of(model: LidarModel, pose: SE3, seed: int, roughness: float) -> np.ndarray:
    """What the model sees in the room, with gaps, things before the walls and openings into the open."""
    rays = model.rays().reshape(-1, 3).astype(np.float64) @ pose.rotation.T
    with np.errstate(over="ignore"):  # rays along a wall
        ranges = Room().cast(pose.translation, rays).reshape(model.shape)
    rng = np.random.default_rng(seed)
    for value in (0.0, 0.7, np.inf, np.nan, 30.0):
        ranges[rng.random(model.shape) < roughness] = value
    if rng.random() < 0.5:
        ranges[:, : model.columns // 3] = rng.choice([0.0, 1.0, np.inf])
    return ranges.astype(np.float32)


def blocks_around(pose: SE3, block_size: float, reach: float) -> np.ndarray:
    first = np.floor((pose.translation - reach) / block_size).astype(np.int32)
    n = int(np.ceil(2.0 * reach / block_size)) + 1
    return np.ascontiguousarray(np.argwhere(np.ones((n, n, n))) + first, dtype=np.int32)


def voxels_in(block: np.ndarray, local: np.ndarray) -> list[tuple[int, ...]]:
    ijk = np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1) + 8 * block.astype(int)
    return list(map(tuple, ijk.tolist()))


def mark(view: RangeView, blocks: np.ndarray, voxel_size: float) -> np.ndarray:
    marks = np.full((len(blocks), 512), 9, np.uint8)
    view.mark_free(np.ascontiguousarray(blocks), voxel_size, marks)
    return marks


@settings(max_examples=40, deadline=None)
@given(models, poses, st.integers(0, 1000), st.sampled_from(ROUGH), st.sampled_from([0.0, 0.005]))
def test_marks_agree_with_the_naive_twin(model, pose, seed, voxel_size, roughness):
    ranges = ranges_of(model, pose, seed, roughness)
    view = RangeView(ranges, model, pose, 5.0)
    rng = np.random.default_rng(seed)
    reaches = naive.bridged(naive.reaches_of(ranges, 5.0), model)
    np.testing.assert_allclose(np.abs(view.reach), reaches, rtol=1e-6)
    blocks = blocks_around(pose, 8 * voxel_size, 2.5)
    blocks = blocks[rng.integers(0, len(blocks), 12)]
    marks = mark(view, blocks, voxel_size)
    assert set(np.unique(marks)) <= {0, MISS}
    for n, block in enumerate(blocks):
        local = rng.integers(0, 512, 6)
        for voxel, marked in zip(voxels_in(block, local), marks[n, local], strict=True):
            free = naive.is_free(voxel, reaches, model, pose, voxel_size)
            assert free is None or free == bool(marked), voxel


@settings(max_examples=30, deadline=None)
@given(models, poses, st.integers(0, 1000), st.sampled_from(ROUGH), st.sampled_from([0.0, 0.005]))
def test_no_block_is_wrongly_left_out_or_called_free(model, pose, seed, voxel_size, roughness):
    view = RangeView(ranges_of(model, pose, seed, roughness), model, pose, 5.0)
    blocks, kinds = view.blocks(8 * voxel_size, front_m=voxel_size, back_m=0.0, touch_m=voxel_size / 2, with_free=True)
    assert len(np.unique(blocks, axis=0)) == len(blocks)
    rng = np.random.default_rng(seed)
    everything = np.concatenate([blocks_around(pose, 8 * voxel_size, 5.6), blocks])
    everything = everything[rng.integers(0, len(everything), 500)]
    free_voxels = project_all(view, everything, voxel_size)  # voxel by voxel
    listed = {tuple(b): k for b, k in zip(blocks.tolist(), kinds.tolist(), strict=True)}
    hit = {tuple(v >> 3) for v in view.hits(voxel_size)}
    for block, voxels in zip(map(tuple, everything.tolist()), free_voxels, strict=True):
        kind = listed.get(block, 0)
        assert kind or not (voxels.any() or block in hit), block
        assert kind != FREE or (voxels.all() and block not in hit), block
    # Nor does what is done with octants of a block, but for rounding.
    assert (mark(view, everything, voxel_size) != free_voxels).mean() < 5e-4


def project_all(view: RangeView, blocks: np.ndarray, voxel_size: float) -> np.ndarray:
    """Which voxels (n, 512) the rule of `mark_free` calls free, each projected with `project_block`."""
    free = np.empty((len(blocks), 512), bool)
    pixels, r, aside = np.empty(512, np.int32), np.empty(512, np.float32), np.empty(512, np.float32)
    reach, clear = np.abs(view.reach).ravel(), view.clear.ravel()
    for n, block in enumerate(blocks):
        kernels.project_block(*block, voxel_size, view.lidar, view.row_of, view.off_row, pixels, r, aside)
        near = np.where(pixels >= 0, pixels, pixels - kernels.BESIDE)
        at = np.maximum(near, 0)
        passed = (near >= 0) & (r < reach[at]) & (aside < np.float32(0.25 * voxel_size**2))
        free[n] = passed | ((pixels >= 0) & (r + np.float32(0.87 * voxel_size) < clear[at]))
    return free


@settings(max_examples=20, deadline=None)
@given(models, poses, st.integers(0, 1000))
def test_hits_are_those_of_the_naive_twin(model, pose, seed):
    ranges = ranges_of(model, pose, seed, 0.01)
    found = set(map(tuple, RangeView(ranges, model, pose, 2.5).hits(0.1).tolist()))
    expected = naive.hits(ranges, model, pose, 2.5, 0.1)
    assert len(found ^ expected) <= 0.01 * len(expected)  # points on a border of voxels, to within rounding


def test_points_are_hit_where_they_are_not_where_the_beams_look():
    points = np.array([[1.0, 0.011, 0.013], [3.0, 0.02, 0.03], [0.0, 9.0, 0.0]])
    view = RangeView.from_points(points, LidarModel.even(4, -0.3, 0.3, 16), SE3.identity(), 5.0)
    assert view.hits(0.01).tolist() == [[100, 1, 1], [300, 2, 3]]
    assert sorted(view.reach[view.reach != 0.0].tolist()) == pytest.approx([-5.0, 1.0], rel=1e-3)
    with pytest.raises(InvalidObservation, match="p_sensor"):
        RangeView.from_points([[np.nan, 0.0, 0.0]], EVEN, SE3.identity(), 5.0)


def scans_of_the_room() -> list[tuple[np.ndarray, SE3]]:
    poses = [SE3.exp([0.3 * n - 0.5, 0.2 * n - 0.3, 0.05 * n, 0.02 * n, -0.03 * n, 0.7 * n]) for n in range(4)]
    return [(ranges_of(EVEN, pose, 2, 0.0), pose) for pose in poses]


@pytest.mark.parametrize("voxel_size", [0.05, 0.1])
def test_range_images_and_beams_agree_where_both_know(voxel_size):
    projected, cast = OccupancyMap(voxel_size, 5.0), OccupancyMap(voxel_size, 5.0)
    for ranges, pose in scans_of_the_room():
        projected.integrate_range_image(ranges, EVEN, pose)
        ends = np.where(np.isfinite(ranges), ranges, 6.0)
        cast.integrate(EVEN.backproject(ends)[ranges > 0.0], pose)
    centres = np.concatenate([cast.occupied_centres(), cast.free_centres()])
    ours, theirs = projected.classify(centres), cast.classify(centres)
    both = ours != UNKNOWN
    assert (ours == theirs)[both].mean() >= 0.999
    assert both.mean() > 0.9


def test_nothing_is_freed_behind_a_surface():
    """With a sharp eye on edges: between a near and a far beam nothing is believed beyond the near one."""
    for ranges, pose in scans_of_the_room():
        layer = OccupancyMap(0.05, 5.0)
        layer.integrate_range_image(np.where(np.isfinite(ranges), ranges, 0.0), EVEN, pose)
        assert Room().distance(layer.free_centres()).min() > -0.05


def test_an_edge_between_two_beams_is_not_freed_beyond_the_nearer():
    model = LidarModel.even(3, -0.1, 0.1, 36)
    ranges = np.full(model.shape, 8.0, np.float32)
    ranges[:, 18] = 2.0  # straight ahead; its neighbours look 10° to the side and see far
    view = RangeView(ranges, model, SE3.identity(), 20.0)
    layer = OccupancyMap(0.1, 20.0)
    layer.integrate_range_view(view)
    found = {}
    for degrees in (6.0, 10.0, 30.0):
        angle = np.deg2rad(degrees)
        ray = np.linspace(2.2, 7.0, 200)[:, None] * np.array([np.cos(angle), np.sin(angle), 0.01])
        found[degrees] = (layer.classify(ray) == 0).mean()
    assert found[6.0] == 0.0  # nearer to the beam at 10° than to that at 0°, but not on it
    assert 0.1 < found[10.0] < 0.9
    assert found[30.0] == 1.0


def test_a_planar_scanner_frees_what_its_beams_pass():
    layer, cast = OccupancyMap(0.1, 5.0), OccupancyMap(0.1, 5.0)
    pose = SE3.exp([0.012, 0.034, 0.04, 0.0, 0.0, 0.3])
    ranges = ranges_of(PLANAR, pose, 0, 0.0)
    layer.integrate_range_image(ranges, PLANAR, pose)
    cast.integrate(PLANAR.backproject(ranges).reshape(-1, 3), pose)
    known = layer.classify(cast.free_centres()) == 0
    assert known.mean() > 0.85


def test_single_gaps_are_bridged_and_larger_ones_are_not():
    ranges = np.full(EVEN.shape, 4.0, np.float32)
    ranges[10, 100] = 0.0  # alone
    ranges[20, 100:103] = 0.0  # three in a row
    ranges[0, 0] = ranges[1, 255] = np.nan  # two neighbours, across the seam
    ranges[11, 101] = 3.0
    reach = RangeView(ranges, EVEN, SE3.identity(), 20.0).reach
    assert reach[10, 100] == -3.0
    assert reach[20, 100:103].tolist() == [-4.0, 0.0, -4.0]
    assert reach[0, 0] == reach[1, 255] == -4.0
    assert (np.delete(reach.ravel(), [20 * 256 + 101]) != 0.0).all()


def test_any_number_of_threads_gives_the_same_map():
    maps = []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        numba.set_num_threads(threads)
        maps.append(OccupancyMap(0.05, 5.0))
        for ranges, pose in scans_of_the_room():
            maps[-1].integrate_range_image(ranges, EVEN, pose)
    first, second = (layer.state() for layer in maps)
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_an_image_that_saw_nothing_says_nothing():
    layer = OccupancyMap(0.1)
    assert len(layer.integrate_range_image(np.zeros(EVEN.shape, np.float32), EVEN, SE3.identity())) == 0


@pytest.mark.parametrize(
    ("ranges", "expected"),
    [(np.zeros((3, 4), np.float32), "shape"), (np.zeros(EVEN.shape), "float32"), (np.zeros((2, 2, 2)), "shape")],
)
def test_what_is_no_range_image_is_refused(ranges, expected):
    with pytest.raises(InvalidObservation, match=expected):
        RangeView(ranges, EVEN, SE3.identity(), 5.0)
