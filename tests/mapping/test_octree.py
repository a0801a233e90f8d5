"""The tree of uniform cells holds what a dictionary of voxels would; its answers are those of the slow twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.cells import CellStore
from mapping.changes import ChangeDetector
from mapping.errors import InvalidParameter, MappingError
from mapping.geometry import SE3
from mapping.grid import LOCAL_IJK
from mapping.kernels import cells as kernels
from mapping.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from tests import naive_octree as naive
from tests.support.rooms import TOUR, Room

HIT, MISS = 30, -20


def contents(store: CellStore) -> naive.Voxels:
    """Every known voxel, read cell by cell; fails where two cells overlap."""
    found: naive.Voxels = {}
    blocks, slots = store.dense_blocks()
    for block, slot in zip(blocks, slots, strict=True):
        for ijk, value in zip((block * 8 + LOCAL_IJK).tolist(), store.payload[slot].tolist(), strict=True):
            assert tuple(ijk) not in found
            found[tuple(ijk)] = value
    for ijk, level, value in zip(*store.uniform_cells(), strict=True):
        edge = 8 << level
        for inside in np.ndindex(edge, edge, edge):
            voxel = tuple((ijk * edge + inside).tolist())
            assert voxel not in found
            found[voxel] = int(value)
    return {ijk: value for ijk, value in found.items() if value != kernels.UNKNOWN}


def block_voxels(block: tuple[int, ...], values: np.ndarray) -> naive.Voxels:
    pairs = zip((np.array(block) * 8 + LOCAL_IJK).tolist(), values.tolist(), strict=True)
    return {tuple(ijk): value for ijk, value in pairs if value != kernels.UNKNOWN}


blocks = st.tuples(*[st.integers(-2, 1)] * 3)
writes = st.lists(st.tuples(blocks, st.sampled_from(["even", "mixed", "unknown"]), st.integers(0, 1)), max_size=40)


def values_of(kind: str, seed: int) -> np.ndarray:
    if kind == "mixed":
        return np.random.default_rng(seed).choice(np.array([HIT, MISS, kernels.UNKNOWN], np.int8), 512)
    return np.full(512, kernels.UNKNOWN if kind == "unknown" else (HIT, MISS)[seed], np.int8)


@settings(max_examples=40, deadline=None)
@given(writes)
def test_whatever_is_written_is_what_is_read(sequence):
    store, expected = CellStore(0.1), {}
    for revision, (block, kind, seed) in enumerate(sequence, start=1):
        values = values_of(kind, seed)
        before = store.read([block])[0]
        changed = store.write([block], values[None], revision)
        assert changed[0] == (before != values).any()
        for ijk in (np.array(block) * 8 + LOCAL_IJK).tolist():
            expected.pop(tuple(ijk), None)
        expected.update(block_voxels(block, values))
        if changed[0]:
            assert [*block] in store.changed_since(revision - 1).tolist()
    assert contents(store) == expected
    assert {tuple(np.array(v) >> 3) for v in expected} == set(map(tuple, store.block_ijk.tolist()))


@settings(max_examples=20, deadline=None)
@given(writes, st.randoms())
def test_the_order_of_writing_leaves_the_same_cells(sequence, random):
    final = {block: (kind, seed) for block, kind, seed in sequence}
    stores = []
    for _ in range(2):
        order = list(final)
        random.shuffle(order)
        store = CellStore(0.1)
        for block in order:
            store.write([block], values_of(*final[block])[None], 1)
        stores.append(sorted(zip(*(field.tolist() for field in store.uniform_cells()), strict=True)))
    assert stores[0] == stores[1]


def test_a_large_region_that_is_alike_is_one_node_and_splits_where_it_changes():
    store = CellStore(0.1)
    region = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)
    store.write(region, np.full((len(region), 512), MISS, np.int8), 1)
    assert (store.n_nodes, store.n_blocks) == (1, 0)
    assert store.memory_bytes < 0.02 * 16**3 * 512
    one = np.full((1, 512), MISS, np.int8)
    one[0, 77] = HIT
    store.write([[5, 6, 7]], one, 2)
    assert (store.n_nodes, store.n_blocks) == (1 + 4 * 7, 1)
    assert len(store.block_ijk) == 16**3
    assert store.changed_since(1).tolist() == [[5, 6, 7]]
    store.write([[5, 6, 7]], np.full((1, 512), MISS, np.int8), 3)
    assert (store.n_nodes, store.n_blocks) == (1, 0)


def test_cells_are_added_only_where_nothing_is_known():
    layer = OccupancyMap(0.1)
    layer.fill_cells([[0, 0, 0], [-3, 0, 0]], np.array([5, 0]), np.array([MISS, HIT]))
    assert layer.classify([[12.0, 1.0, 25.5], [-2.3, 0.4, 0.4], [25.7, 0.0, 0.0]]).tolist() == [FREE, OCCUPIED, UNKNOWN]
    assert len(layer.block_ijk) == 32**3 + 1
    with pytest.raises(MappingError, match="nothing is known"):
        layer.fill_cells([[3, 3, 3]], np.array([0]), np.array([HIT]))
    before = contents(layer.store)
    for about, level in ([[-1, 0, 0]], [2]), ([[9, 9, 9], [4, 4, 4]], [0, 1]):  # about a block, and about each other
        with pytest.raises(MappingError, match="nothing is known"):
            layer.fill_cells(about, np.array(level), np.full(len(about), HIT))
    assert contents(layer.store) == before
    with pytest.raises(InvalidParameter, match="level"):
        layer.fill_cells([[3, 3, 3]], np.array([12]), np.array([HIT]))


def test_a_state_that_names_a_block_twice_is_refused():
    store = CellStore(0.1)
    store.write([[0, 0, 0]], values_of("mixed", 0)[None], 1)
    state = store.state()
    twice = {**state, "block_ijk": np.zeros((2, 3), np.int32), "evidence": np.repeat(state["evidence"], 2, axis=0)}
    with pytest.raises(MappingError, match="twice"):
        CellStore(0.1).restore(twice, 1)
    inside = {**state, "cell_row": np.array([0]), "cell_ijk": np.zeros((1, 3), np.int32)}
    inside |= {"cell_level": np.array([2], np.uint8), "cell_value": np.array([MISS], np.int8)}
    with pytest.raises(MappingError, match="twice"):
        CellStore(0.1).restore(inside, 1)


# -- questions -------------------------------------------------------------------------------------------------


def small_map(seed: int = 0) -> tuple[OccupancyMap, naive.Voxels]:
    """A map with uniform cells of several sizes, dense blocks and gaps, and its voxels."""
    layer = OccupancyMap(0.1)
    rng = np.random.default_rng(seed)
    region = np.stack(np.meshgrid(*[np.arange(-2, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.full((len(region), 512), layer.lowest_evidence, np.int8)
    values[rng.random(len(region)) < 0.3] = kernels.UNKNOWN
    for n in rng.choice(len(region), 6, replace=False):
        values[n] = rng.choice(np.array([HIT, MISS, kernels.UNKNOWN], np.int8), 512, p=(0.02, 0.9, 0.08))
    layer.set_evidence(region, values)
    return layer, contents(layer.store)


@pytest.mark.parametrize("depth", [15, 14, 13, 12, 11, 9, 6, 2, 0])
def test_coarser_levels_are_the_highest_and_the_mean_of_their_voxels(depth):
    layer, voxels = small_map()
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (25, 3))
    for rule, combine in (("max", np.max), ("mean", np.mean)):
        for point, found in zip(points, layer.query(points, depth=depth, rule=rule), strict=True):
            inside = naive.sum_up(voxels, tuple(np.floor(point / 0.1).astype(int).tolist()), 16 - depth)
            odds = 1.0 / (1.0 + np.exp(-layer.log_odds_step * np.array(inside, np.float64)))
            assert found == pytest.approx(combine(odds)) if inside else np.isnan(found)


@pytest.mark.parametrize("depth", [16, 15, 13, 12, 11])
def test_leaves_are_those_of_the_pruned_tree(depth):
    layer, voxels = small_map()
    leaves = layer.leaves(depth)
    lowest = np.rint(leaves.centre / 0.1 - leaves.size_m[:, None] / 0.2).astype(int).tolist()
    edges = np.rint(leaves.size_m / 0.1).astype(int).tolist()
    found = dict(zip(zip(map(tuple, lowest), edges, strict=True), leaves.probability.tolist(), strict=True))
    expected = naive.leaves(voxels, 16 - depth, 10)
    assert len(found) == len(edges)
    assert found.keys() == expected.keys()
    for leaf, value in expected.items():
        assert found[leaf] == pytest.approx(layer.probabilities[np.uint8(value & 255)])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 5), st.integers(0, 2**31))
def test_rays_meet_what_small_steps_meet(seed, ray_seed):
    layer, voxels = small_map(seed)
    rng = np.random.default_rng(ray_seed)
    origin, direction = rng.uniform(-1.7, 1.7, 3), rng.normal(size=3)
    unit = direction / np.linalg.norm(direction)
    hit, unknown = naive.first_hit(voxels, origin / 0.1, unit, 30.0)
    through = layer.cast(origin, 3.0 * direction, 3.0)
    assert through.met[0] == (1 if hit is not None else 0 if unknown is None else -1)
    assert through.distance_m[0] == pytest.approx(3.0 if hit is None else hit * 0.1, abs=3e-4)
    if unknown is not None:
        assert through.unknown_at_m[0] == pytest.approx(unknown * 0.1, abs=3e-4)
    stopped = layer.cast(origin, direction, 3.0, stop_at_unknown=True)
    first_is_unknown = unknown is not None and (hit is None or unknown < hit)
    assert stopped.met[0] == (-1 if first_is_unknown else through.met[0])
    assert np.allclose(stopped.points[0], origin + unit * stopped.distance_m[0])


def test_rays_in_a_room_end_at_its_walls():
    layer = OccupancyMap(0.05, 10.0)
    origin = np.array(TOUR[0].translation)
    layer.integrate(Room().scan(TOUR[0], 60_000), TOUR[0])
    directions = np.random.default_rng(0).normal(size=(500, 3))
    hits = layer.cast(origin, directions)
    truth = Room().cast(origin, directions / np.linalg.norm(directions, axis=1)[:, None])
    assert np.median(np.abs(hits.distance_m - truth)) < 0.05
    assert (hits.met == 1).mean() > 0.95


def test_bad_rays_are_refused():
    layer = OccupancyMap(0.1)
    for origins, directions, reach in (
        ([0, 0, 0], [0, 0, 0], 1.0),
        ([0, 0, np.nan], [1, 0, 0], 1.0),
        ([0, 0, 0], [1, 0, 0], -1.0),
    ):
        with pytest.raises(InvalidParameter):
            layer.cast(origins, directions, reach)


def test_a_sphere_holds_the_voxels_whose_centres_it_holds():
    layer, voxels = small_map()
    centre, radius = np.array([0.33, -0.21, 0.07]), 0.45
    classes, centres = layer.sphere(centre, radius)
    assert np.array_equal(classes, layer.classify(centres))
    around = (np.stack(np.meshgrid(*[np.arange(-10, 12)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * 0.1
    assert len(classes) == (np.linalg.norm(around - centre, axis=1) <= radius).sum()
    assert len(voxels) > 0


# -- whole maps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["box", "sphere"])
def test_what_is_cleared_is_unknown_and_the_rest_stays(shape):
    layer, voxels = small_map()
    if shape == "box":
        changed = layer.clear_box([-0.53, -0.2, -1.0], [0.61, 1.37, 0.4])
        gone = lambda c: (c >= [-0.53, -0.2, -1.0]).all() and (c <= [0.61, 1.37, 0.4]).all()  # noqa: E731
    else:
        changed = layer.clear_sphere([0.1, 0.2, 0.3], 0.9)
        gone = lambda c: np.linalg.norm(c - [0.1, 0.2, 0.3]) <= 0.9  # noqa: E731
    left = {ijk: value for ijk, value in voxels.items() if not gone((np.array(ijk) + 0.5) * 0.1)}
    assert contents(layer.store) == left
    touched = {tuple(np.array(ijk) >> 3) for ijk in voxels.keys() - left.keys()}
    assert {tuple(block) for block in changed.blocks.tolist()} == touched


def test_two_maps_merged_are_the_map_of_all_scans():
    scans = [(Room().scan(TOUR[n], 500, seed=n), TOUR[n]) for n in range(4)]
    whole, one, other = (OccupancyMap(0.1, lowest=0.001, highest=0.999) for _ in range(3))
    for n, (points, pose) in enumerate(scans):
        whole.integrate(points, pose)
        (one if n % 2 else other).integrate(points, pose)
    one.merge(other)
    assert contents(one.store) == contents(whole.store)
    with pytest.raises(InvalidParameter, match="voxels of"):
        one.merge(OccupancyMap(0.2))


def test_merging_maps_with_other_parameters_keeps_what_they_believe():
    point = np.array([[1.05, 0.05, 0.05]])
    one, other = OccupancyMap(0.1), OccupancyMap(0.1, hit=0.85)
    other.integrate(point, SE3.identity())
    one.merge(other)
    assert one.query(point)[0] == pytest.approx(other.query(point)[0], abs=0.01)


def test_class_changes_are_told_once_and_evidence_alone_is_none():
    layer = OccupancyMap(0.1)
    points = Room().scan(TOUR[0], 2000)
    layer.integrate(points, TOUR[0])
    detector = ChangeDetector(layer)
    layer.integrate(points, TOUR[0])
    assert len(detector.changes().centres) == 0
    layer.clear_sphere(TOUR[0].translation, 0.5)
    changes = detector.changes()
    assert set(changes.after.tolist()) == {UNKNOWN}
    assert np.array_equal(layer.classify(changes.centres), changes.after)
    assert (np.linalg.norm(changes.centres - TOUR[0].translation, axis=1) <= 0.5).all()
    layer.integrate(points, TOUR[0])
    assert len(detector.changes().centres) == len(changes.centres)
    assert len(detector.changes().centres) == 0


def test_the_classes_are_the_same_whether_beams_are_kept_in_a_volume_or_in_a_hash(monkeypatch):
    near, far = OccupancyMap(0.1), OccupancyMap(0.1)
    points = Room().scan(TOUR[1], 3000)
    near.integrate(points, TOUR[1])
    noted = OccupancyMap(0.1)
    monkeypatch.setattr("mapping.scanning._SCANNED_BLOCKS", 0)
    noted.integrate(points, TOUR[1])
    monkeypatch.setattr("mapping.scanning._MOST_BLOCKS", 0)
    far.integrate(points, TOUR[1])
    assert contents(near.store) == contents(far.store) == contents(noted.store)


def test_maps_saved_before_there_were_cells_are_read():
    layer, voxels = small_map()
    blocks = layer.block_ijk
    header = {key: value for key, value in layer.state().items() if key == "kind" or key.startswith("parameter.")}
    del header["parameter.discretize"]
    old = OccupancyMap.from_state({**header, "block_ijk": blocks, "evidence": layer.evidence_of(blocks)})
    assert contents(old.store) == voxels
