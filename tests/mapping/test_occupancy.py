"""Occupancy says what OctoMap says; its kernels say what their naive twins say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mapping.datasets.opening import open_dataset
from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.kernels import occupancy as kernels
from mapping.kernels import visibility
from mapping.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from mapping.octomap import read_octomap
from mapping.view import DepthView
from tests import naive_layers as naive
from tests.support.recordings import recording
from tests.support.rooms import LARGE_CAMERA, SMALL_CAMERA, TOUR, Room, looking


def evidence_of(layer: OccupancyMap) -> dict[tuple[int, ...], int]:
    blocks = layer.block_ijk
    evidence = layer.evidence_of(blocks)
    rows, local = np.nonzero(evidence != kernels.UNKNOWN)
    ijk = blocks[rows] * 8 + np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1)
    return dict(zip(map(tuple, ijk.tolist()), evidence[rows, local].tolist(), strict=True))


def steps_of(layer: OccupancyMap) -> tuple[int, int, int, int]:
    step = layer.log_odds_step
    log_odds = [np.log(p / (1 - p)) for p in (layer.hit, layer.miss, layer.lowest, layer.highest)]
    return tuple(round(value / step) for value in log_odds)


coordinates = st.floats(-1.5, 1.5).map(lambda x: round(x, 3))


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(np.float64, (3,), elements=coordinates),
    npst.arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=coordinates),
    st.sampled_from([0.5, 1.0, 5.0]),
)
def test_beams_agree_with_the_naive_walk(origin, ends, max_range):
    # Off the voxel borders, where the order of equal steps is nobody's business.
    origin, ends = origin + 1.234e-4, ends + 3.21e-4 * np.array([1.0, 1.3, 1.7])
    layer = OccupancyMap(0.1, max_range)
    layer.integrate(ends - origin, SE3(np.eye(3), origin))
    expected: dict = {}
    marks = naive.marks_of_beams(origin, (ends - origin) + origin, max_range, 0.1)
    naive.fold(expected, marks, *steps_of(layer))
    assert evidence_of(layer) == expected


@settings(max_examples=15, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-0.7, 0.7), st.integers(0, 100), st.sampled_from([0.04, 0.1, 0.25]))
def test_images_agree_with_the_naive_projection(yaw, pitch, seed, voxel_size):
    pose = looking(yaw, pitch, (0.1, -0.2, 0.05))
    depth = Room().depth(pose, SMALL_CAMERA)
    rng = np.random.default_rng(seed)
    depth[rng.random(depth.shape) < 0.02] = 0.0
    layer = OccupancyMap(voxel_size, 10.0)
    layer.integrate_image(depth, SMALL_CAMERA, pose)
    hits = naive.hits_of_image(depth, pose, SMALL_CAMERA, voxel_size)
    evidence = evidence_of(layer)
    differing = {voxel for voxel, value in evidence.items() if value > 0} ^ hits
    assert len(differing) <= 0.002 * len(hits)  # points on a border of voxels, to within rounding
    for _ in range(200):
        voxel = naive.voxel_of(rng.uniform(-2.2, 2.2, 3), voxel_size)
        free = naive.is_free(voxel, depth, pose, SMALL_CAMERA, voxel_size)
        if voxel not in hits and voxel not in differing and free is not None:
            assert (voxel in evidence) == free, voxel


def test_whole_free_blocks_are_what_their_voxels_are():
    """The coarse test of blocks changes the work, not the result."""
    pose = looking(0.3)
    view = DepthView(Room().depth(pose, LARGE_CAMERA), LARGE_CAMERA, pose, 10.0)
    blocks, kinds = view.blocks(0.16, front_m=0.02, back_m=0.0, with_free=True)
    free = blocks[kinds == visibility.FREE]
    assert len(free) > 100
    marks = np.empty((len(free), 512), np.uint8)
    kernels.mark_free(free, 0.02, view.reach, view.camera, marks)
    assert (marks == kernels.MISS).all()


def test_no_block_that_an_image_says_something_of_is_left_out():
    pose = looking(0.3, 0.2)
    view = DepthView(Room().depth(pose, SMALL_CAMERA), SMALL_CAMERA, pose, 10.0)
    listed, _ = view.blocks(0.4, front_m=0.05, back_m=0.0, with_free=True)
    around = np.ascontiguousarray(np.argwhere(np.ones((16, 16, 16))) - 8, dtype=np.int32)
    marks = np.empty((len(around), 512), np.uint8)
    kernels.mark_free(around, 0.05, view.reach, view.camera, marks)
    assert {tuple(b) for b in around[marks.any(axis=1)].tolist()} <= {tuple(b) for b in listed.tolist()}


@pytest.mark.parametrize("max_range", [1.0, 10.0])
def test_three_scans_give_the_classes_that_octomap_gives(max_range, tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    layer, tree = OccupancyMap(0.1, max_range), pyoctomap.OcTree(0.1)
    for n, pose in enumerate(TOUR[:3]):
        p_sensor = Room().scan(pose, 3000, seed=n).astype(np.float32).astype(np.float64)
        layer.integrate(p_sensor, pose)
        tree.insertPointCloud(pose @ p_sensor, np.array(pose.translation), max_range=max_range)
    tree.writeBinary(str(tmp_path / "theirs.bt"))
    reference = read_octomap(tmp_path / "theirs.bt")
    ours, theirs = evidence_of(layer), evidence_of(reference)
    same = sum((value >= 0) == (theirs.get(voxel, -1) >= 0) and voxel in theirs for voxel, value in ours.items())
    print(f"max range {max_range} m: {len(ours)} voxels, OctoMap {len(theirs)}, same class on {same}")
    assert same >= 0.999 * len(ours.keys() | theirs.keys())


def test_real_scans_agree_with_their_reference_octree():
    folder = recording("la3dm_sim_lidar_poses/sim_structured")
    reference = read_octomap(folder / "map.bt")
    layer = OccupancyMap(0.1, 8.0)  # the range in the recording's configuration
    for scan in open_dataset(folder):
        if hasattr(scan, "points"):
            layer.integrate(scan.points, scan.T_map_sensor)
    centres = np.concatenate([reference.occupied_centres(), reference.free_centres()])
    theirs, ours = reference.classify(centres), layer.classify(centres)
    both = ours != UNKNOWN
    agreement = float((ours == theirs)[both].mean())
    occupied_known = float((ours[theirs == OCCUPIED] != UNKNOWN).mean())
    print(
        f"sim_structured: agreement {agreement:.3%} of {both.sum()} voxels known to both; "
        f"{occupied_known:.3%} of {(theirs == OCCUPIED).sum()} occupied voxels of the reference known to ours"
    )
    assert agreement >= 0.97
    assert occupied_known >= 0.95


def test_images_and_beams_agree_where_both_know():
    by_image, by_beams = OccupancyMap(0.05, 10.0), OccupancyMap(0.05, 10.0)
    pose = looking(0.2, 0.1)
    depth = Room().depth(pose, LARGE_CAMERA)
    by_image.integrate_image(depth, LARGE_CAMERA, pose)
    by_beams.integrate(LARGE_CAMERA.backproject(depth).reshape(-1, 3), pose)
    centres = np.concatenate([by_beams.occupied_centres(), by_beams.free_centres()])
    ours, theirs = by_image.classify(centres), by_beams.classify(centres)
    both = ours != UNKNOWN
    assert (ours == theirs)[both].mean() >= 0.999
    assert both.mean() > 0.75  # beams also pass voxels whose centre lies outside the image


def test_free_occupied_and_unknown_are_three_things():
    layer = OccupancyMap(0.1)
    layer.integrate([[1.05, 0.05, 0.05]], SE3(np.eye(3), [0.05, 0.05, 0.05]))
    points = np.array([[0.55, 0.05, 0.05], [1.1, 0.1, 0.1], [1.5, 0.05, 0.05], [0.55, 0.25, 0.05]])
    assert layer.classify(points).tolist() == [FREE, OCCUPIED, UNKNOWN, UNKNOWN]
    assert np.allclose(layer.query(points), [0.4, 0.7, np.nan, np.nan], equal_nan=True, atol=1e-3)


def test_a_beam_past_the_range_frees_up_to_it_and_hits_nothing():
    layer = OccupancyMap(0.1, 1.0)
    layer.integrate([[3.0, 0.0, 0.0]], SE3(np.eye(3), [0.05, 0.05, 0.05]))
    assert len(layer.occupied_centres()) == 0
    assert layer.free_centres()[:, 0].max() == pytest.approx(0.95)


def test_a_far_image_frees_up_to_the_range_and_hits_nothing():
    layer = OccupancyMap(0.1, 1.0)
    layer.integrate_image(np.full((48, 64), 5.0, np.float32), SMALL_CAMERA, looking(0.0))
    assert len(layer.occupied_centres()) == 0
    assert 0.8 < np.linalg.norm(layer.free_centres(), axis=1).max() <= 1.0


def test_a_voxel_counts_once_a_scan_and_occupied_wins():
    layer = OccupancyMap(0.1)
    origin = SE3(np.eye(3), [0.05, 0.05, 0.05])
    layer.integrate([[0.5, 0.0, 0.0]] * 50 + [[1.0, 0.0, 0.0]] * 50, origin)
    assert layer.query([[0.55, 0.05, 0.05]])[0] == pytest.approx(0.7, abs=2e-3)
    assert layer.query([[0.35, 0.05, 0.05]])[0] == pytest.approx(0.4, abs=2e-3)


def test_evidence_stays_within_its_clamps_and_can_turn():
    layer = OccupancyMap(0.1)
    pose = SE3(np.eye(3), [0.05, 0.05, 0.05])
    near, far = [[0.5, 0.0, 0.0]], [[1.0, 0.0, 0.0]]
    at = np.array([[0.55, 0.05, 0.05]])
    for _ in range(30):
        layer.integrate(near, pose)
    assert layer.query(at)[0] == pytest.approx(0.971, abs=1e-3)
    for _ in range(9):
        layer.integrate(far, pose)
    assert layer.classify(at)[0] == FREE  # OctoMap's defaults: nine misses undo any number of hits
    for _ in range(30):
        layer.integrate(far, pose)
    assert layer.query(at)[0] == pytest.approx(0.1192, abs=2e-3)


@pytest.mark.parametrize("depth", [15, 14, 13, 12, 9])
def test_a_coarse_cell_is_as_occupied_as_its_most_occupied_voxel(depth):
    layer = OccupancyMap(0.1)
    for pose in TOUR[:3]:
        layer.integrate(Room().scan(pose, 300), pose)
    points = np.random.default_rng(0).uniform(-4, 4, (60, 3))
    edge = 2 ** (16 - depth)
    first = np.floor(points / 0.1 / edge).astype(int) * edge
    expected = np.full(len(points), np.nan)
    evidence = evidence_of(layer)
    for voxel, value in evidence.items():
        inside = ((first <= voxel) & (voxel < first + edge)).all(axis=1)
        expected[inside] = np.fmax(expected[inside], value)
    probability = 1.0 / (1.0 + np.exp(-layer.log_odds_step * expected))
    assert np.allclose(layer.query(points, depth=depth), probability, equal_nan=True)
    assert np.isnan(layer.query([[np.nan, 0, 0], [1e12, 0, 0]], depth=depth)).all()


@pytest.mark.parametrize("depth", [-1, 17, 14.5])
def test_a_level_that_is_none_is_refused(depth):
    with pytest.raises(InvalidParameter, match="depth"):
        OccupancyMap(0.1).query([[0.0, 0.0, 0.0]], depth=depth)


def test_a_box_is_what_its_voxels_are():
    layer = OccupancyMap(0.1)
    layer.integrate_image(Room().depth(TOUR[0], SMALL_CAMERA), SMALL_CAMERA, TOUR[0])
    codes, first = layer.box((-0.5, -0.7, -0.3), (1.3, 0.9, 0.6))
    assert codes.shape == (18, 16, 9)
    assert first.tolist() == [-5, -7, -3]
    centres = (np.argwhere(np.ones(codes.shape)) + first + 0.5) * 0.1
    assert np.array_equal(codes.ravel(), layer.classify(centres))
    assert {UNKNOWN, FREE, OCCUPIED} == set(codes.ravel().tolist())


def test_centres_and_blocks_of_an_empty_map():
    layer = OccupancyMap(0.1)
    assert len(layer.integrate(np.empty((0, 3)), SE3.identity())) == 0
    assert layer.occupied_centres().shape == (0, 3)
    assert np.isnan(layer.query([[0.0, 0.0, 0.0]])).all()


@pytest.mark.parametrize(
    ("settings_", "named"),
    [
        ({"hit": 0.4}, "hit"),
        ({"miss": 0.6}, "miss"),
        ({"lowest": 0.7}, "lowest"),
        ({"highest": 0.2}, "highest"),
        ({"max_range_m": 0.0}, "max_range_m"),
        ({"hit": 0.501, "miss": 0.01}, "hit, miss"),
    ],
)
def test_impossible_evidence_is_refused(settings_, named):
    with pytest.raises(InvalidParameter, match=named):
        OccupancyMap(0.1, **settings_)


def test_default_steps_keep_the_ratio_of_hit_and_miss():
    layer = OccupancyMap()
    assert layer.log_odds_step * steps_of(layer)[0] == pytest.approx(np.log(0.7 / 0.3), rel=5e-3)
    assert layer.log_odds_step * steps_of(layer)[1] == pytest.approx(np.log(0.4 / 0.6), rel=5e-3)


def test_points_and_images_that_are_none_are_refused():
    layer = OccupancyMap(0.1)
    with pytest.raises(InvalidObservation, match="p_sensor"):
        layer.integrate([[np.nan, 0.0, 0.0]], SE3.identity())
    with pytest.raises(InvalidParameter, match=r"\(N, 3\)"):
        layer.integrate([[0.0, 0.0]], SE3.identity())
    with pytest.raises(InvalidObservation, match="depth"):
        layer.integrate_image(np.zeros((3, 4), np.float32), SMALL_CAMERA, SE3.identity())
    with pytest.raises(InvalidObservation, match="float32"):
        layer.integrate_image(np.zeros((48, 64)), SMALL_CAMERA, SE3.identity())
    with pytest.raises(InvalidParameter, match="lo, hi"):
        layer.box((0, 0, 0), (0, 1, 1))
