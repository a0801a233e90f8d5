"""Euclidean distances: as far as the nearest of all, and up to date with the map they follow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

import mapping.esdf
from mapping.errors import InvalidParameter
from mapping.esdf import EsdfMap, _offsets
from mapping.geometry import SE3
from mapping.grid import BLOCK_VOXELS, LOCAL_IJK, ijk_to_centre, join_ijk, split_ijk
from mapping.kernels import nearest as kernels
from mapping.occupancy import OccupancyMap
from mapping.tsdf import TsdfMap
from tests import naive_distances as naive
from tests.support.rooms import SMALL_CAMERA, TOUR, Room


def cube_of_blocks(half: int) -> np.ndarray:
    edge = np.arange(-half, half, dtype=np.int32)
    return np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)


def every_voxel(n: int) -> np.ndarray:
    return np.tile(np.arange(BLOCK_VOXELS), n)


def filled(layer, half_blocks: int):
    """All voxel centres (N, 3) [m] of a cube of blocks, which are allocated, and their slots."""
    blocks = cube_of_blocks(half_blocks)
    slots = layer.store.allocate(blocks)
    return ijk_to_centre(
        join_ijk(np.repeat(blocks, BLOCK_VOXELS, axis=0), every_voxel(len(blocks))), layer.voxel_size_m
    ), slots


def occupancy_of(room: Room, voxel_size: float, half_blocks: int) -> OccupancyMap:
    layer = OccupancyMap(voxel_size)
    blocks = cube_of_blocks(half_blocks)
    centres = ijk_to_centre(join_ijk(np.repeat(blocks, BLOCK_VOXELS, axis=0), every_voxel(len(blocks))), voxel_size)
    evidence = np.where(room.distance(centres) < 0.0, 5, -5).astype(np.int8)
    layer.set_evidence(blocks, evidence.reshape(-1, BLOCK_VOXELS))
    return layer


def tsdf_of(room: Room, voxel_size: float, half_blocks: int) -> TsdfMap:
    layer = TsdfMap(voxel_size)
    centres, slots = filled(layer, half_blocks)
    distance = np.clip(room.distance(centres), -layer.truncation_m, layer.truncation_m)
    layer.store.fields["distance"][slots] = distance.reshape(-1, BLOCK_VOXELS)
    layer.store.fields["weight"][slots] = 1.0
    layer._note(slots)
    return layer


@st.composite
def worlds(draw) -> np.ndarray:
    """Sites in a box of up to 4 × 3 × 3 blocks, bool: any, on sheets, or hardly any."""
    shape = tuple(8 * draw(st.integers(1, most)) for most in (4, 3, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sites = rng.random(shape) < draw(st.sampled_from([0.0, 0.001, 0.02, 0.5]))
    for _ in range(draw(st.integers(0, 2))):
        axis = draw(st.integers(0, 2))
        sheet = np.take(sites, draw(st.integers(0, shape[axis] - 1)), axis=axis)  # a copy
        sheet[:] = rng.random(sheet.shape) < 0.9
        index = [slice(None)] * 3
        index[axis] = draw(st.integers(0, shape[axis] - 1))
        sites[tuple(index)] = sheet
    return sites


@settings(max_examples=40, deadline=None)
@given(worlds(), st.integers(2, 400), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_the_nearest_site_agrees_with_trying_all(sites, far, share, seed):
    wanted = np.random.default_rng(seed).random(sites.shape) < share
    blocks, bits = naive.blocks_of(sites)
    cells = np.array(sites.shape) // 8
    grid = np.arange(len(blocks), dtype=np.int32).reshape(cells)
    offsets = _offsets(int(np.sqrt(far)) // 8 + 1, far)
    expected = np.minimum(naive.nearest_squared(sites), far)
    for block in blocks:
        squared, nearest = np.full(512, -7, np.int32), np.full(512, -7, np.int32)
        there = tuple(slice(8 * i, 8 * i + 8) for i in block)
        mask = np.ascontiguousarray(wanted[there].ravel())
        kernels.find_nearest(bits, 0, grid, tuple(int(i) for i in block), offsets, far, mask, squared, nearest)
        assert (squared[~mask] == -7).all()
        assert np.array_equal(squared[mask], expected[there].ravel()[mask])
        found = mask & (squared < far)
        site = np.stack([(nearest[found] >> shift & 1023) - 512 for shift in (20, 10, 0)], axis=1)
        assert sites[tuple((site + 8 * block).T)].all()
        assert np.array_equal(((site - LOCAL_IJK[found]) ** 2).sum(axis=1), squared[found])


def test_distances_from_occupancy_are_those_of_scipy():
    from scipy.ndimage import distance_transform_edt

    source = occupancy_of(Room(half=(0.7, 0.6, 0.5), ball=(0.2, 0.0, 0.0), radius=0.21), 0.05, 2)
    field = EsdfMap(source, 0.5)
    field.update()
    codes, _ = source.box((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8))
    occupied = codes == 1
    half = 0.5
    expected = (
        np.where(occupied, half - distance_transform_edt(occupied), distance_transform_edt(~occupied) - half) * 0.05
    )
    ijk = np.argwhere(np.ones(codes.shape)) - 16
    block, local = split_ijk(ijk)
    ours = field.store.fields["distance"][field.store.find(block), local].reshape(codes.shape)
    assert np.allclose(ours, np.clip(expected, -0.5, 0.5), atol=1e-6)


def test_distances_from_a_tsdf_are_those_of_the_room():
    room = Room(half=(1.5, 1.5, 1.5), ball=(0.3, 0.2, 0.1), radius=0.45)
    field = EsdfMap(tsdf_of(room, 0.1, 3), 1.0)
    points = np.random.default_rng(0).uniform(-1.6, 1.6, (5000, 3))
    distance, gradient = field.query(points, gradient=True)
    expected = room.distance(points)
    error = np.abs(distance - np.clip(expected, -1.0, 1.0))
    print(f"esdf of a tsdf at 10 cm: median error {np.median(error) * 1e3:.1f} mm, largest {error.max() * 1e3:.1f} mm")
    assert np.median(error) < 0.005
    assert error.max() < 0.07
    norm = np.linalg.norm(gradient, axis=1)
    assert np.percentile(norm, 95) < 1.1  # corners and edges have no one gradient
    inside = (np.abs(expected) < 0.9) & (np.abs(expected) > 0.1)
    assert np.median(norm[inside]) == pytest.approx(1.0, abs=0.02)


def test_the_gradient_is_the_slope_of_the_distance():
    field = EsdfMap(tsdf_of(Room(half=(0.7, 0.7, 0.7), ball=(0.0, 0.0, 0.0), radius=0.2), 0.05, 2), 0.5)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (200, 3))
    _, gradient = field.query(points, gradient=True)
    step = 1e-6
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        slope = (field.query(points + offset) - field.query(points - offset)) / (2 * step)
        between = np.abs((points[:, axis] / 0.05 - 0.5) % 1.0 - 0.5) < 0.49  # not across a voxel centre
        assert np.allclose(gradient[between, axis], slope[between], atol=1e-4)


def test_unknown_is_not_free():
    source = OccupancyMap(0.1)
    source.integrate([[2.0, 0.0, 0.0]], SE3(np.eye(3), [0.05, 0.05, 0.05]))
    field = EsdfMap(source, 1.0)
    assert np.isnan(field.query([[1.0, 0.6, 0.0], [9.0, 9.0, 9.0]])).all()
    slots, local = field.store.locate([[1.05, 0.05, 0.05], [1.05, 0.15, 0.05]])
    values = field.store.fields["distance"][slots, local]
    assert values[0] == pytest.approx(0.95, abs=0.011)
    assert np.isnan(values[1])


def assert_equal_to_one_made_anew(field: EsdfMap) -> None:
    anew = EsdfMap(field.source, field.truncation_m)
    anew.update()
    slots = anew.store.find(field.block_ijk)
    assert field.store.n_blocks == anew.store.n_blocks
    assert np.array_equal(anew.store.fields["distance"][slots], field.store.used("distance"), equal_nan=True)


class Changing(RuleBasedStateMachine):
    """A small world whose voxels become occupied, free and unknown; the field is looked at now and then."""

    BLOCKS = cube_of_blocks(2)[::3]

    @initialize(truncation=st.sampled_from([0.15, 0.25, 0.8, 2.0]), in_parts=st.booleans())
    def begin(self, truncation: float, in_parts: bool) -> None:
        self.patch = pytest.MonkeyPatch()
        self.patch.setattr(mapping.esdf, "_MOST_CELLS", 1 if in_parts else 1 << 22)  # block by block, or all at once
        self.source = OccupancyMap(0.1)
        self.evidence = np.full((len(self.BLOCKS), BLOCK_VOXELS), -128, np.int8)
        self.field = EsdfMap(self.source, truncation)

    def tell(self, rows: np.ndarray) -> None:
        self.source.set_evidence(self.BLOCKS[rows], self.evidence[rows])

    @rule(seed=st.integers(0, 2**32), n=st.integers(1, 12), value=st.sampled_from([5, 0, -5, -128]))
    def change_some_voxels(self, seed: int, n: int, value: int) -> None:
        rng = np.random.default_rng(seed)
        rows = rng.integers(0, len(self.BLOCKS), n)
        self.evidence[rows, rng.integers(0, BLOCK_VOXELS, n)] = value
        self.tell(np.unique(rows))

    @rule(row=st.integers(0, len(BLOCKS) - 1), value=st.sampled_from([5, -5, -128]), share=st.floats(0.0, 1.0))
    def change_a_block(self, row: int, value: int, share: float) -> None:
        self.evidence[row, : int(share * BLOCK_VOXELS)] = value
        self.tell(np.array([row]))

    @rule(seed=st.integers(0, 2**32), occupied=st.floats(0.0, 0.2), unknown=st.floats(0.0, 0.5))
    def change_everything(self, seed: int, occupied: float, unknown: float) -> None:
        rng = np.random.default_rng(seed)
        self.evidence[:] = np.where(rng.random(self.evidence.shape) < occupied, 5, -5)
        self.evidence[rng.random(self.evidence.shape) < unknown] = -128
        self.tell(np.arange(len(self.BLOCKS)))

    def contents(self) -> dict[tuple[int, ...], bytes]:
        stored = self.field.store.used("distance")
        return {tuple(b): d.tobytes() for b, d in zip(self.field.block_ijk, stored, strict=True)}

    @rule()
    def look(self) -> None:
        before = self.contents()
        reported = {tuple(b) for b in self.field.update().blocks}
        after = self.contents()
        nothing = np.full(BLOCK_VOXELS, np.nan, np.float32).tobytes()
        assert reported == {b for b, content in after.items() if content != before.get(b, nothing)}
        stored = np.full((len(self.BLOCKS), BLOCK_VOXELS), np.nan, np.float32)
        slots = self.field.store.find(self.BLOCKS)
        stored[slots >= 0] = self.field.store.fields["distance"][slots[slots >= 0]]
        expected = naive.signed_distances(self.BLOCKS, self.evidence, 0.1, self.field.truncation_m)
        assert np.array_equal(stored, expected, equal_nan=True)
        assert_equal_to_one_made_anew(self.field)

    def teardown(self) -> None:
        self.patch.undo()

    @invariant()
    def look_now_and_then(self) -> None:
        if self.source.revision % 3 == 0:
            self.look()


TestChanging = Changing.TestCase
TestChanging.settings = settings(max_examples=10, stateful_step_count=10, deadline=None)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 23), st.integers(1, 60)), min_size=2, max_size=4), st.booleans())
def test_following_signed_distances_equals_starting_anew(steps, by_image):
    source = TsdfMap(0.1, max_weight=3.0)
    field = EsdfMap(source, 0.4)
    for n, count in steps:
        if by_image:
            source.integrate_image(Room().depth(TOUR[n], SMALL_CAMERA), SMALL_CAMERA, TOUR[n])
        else:
            source.integrate(Room().scan(TOUR[n], count, seed=n), TOUR[n])
        field.update()
    assert_equal_to_one_made_anew(field)


def test_following_images_equals_starting_anew():
    source = OccupancyMap(0.05)
    field = EsdfMap(source, 1.0)
    for n in (0, 1, 8, 0):
        source.integrate_image(Room().depth(TOUR[n], SMALL_CAMERA), SMALL_CAMERA, TOUR[n])
        field.update()
    assert_equal_to_one_made_anew(field)


def test_only_what_a_change_can_reach_is_told_as_changed():
    source = occupancy_of(Room(), 0.1, 4)
    field = EsdfMap(source, 0.5)
    field.update()
    block = np.array([[0, -2, 0]])
    evidence = source.evidence_of(block).copy()
    assert (evidence < 0).all()
    evidence[0, 0] = 5
    source.set_evidence(block, evidence)
    changed = field.update()
    assert 1 < len(changed) <= 8
    assert np.abs(changed.blocks - block).max() == 1
    evidence[0, 0] = -5
    source.set_evidence(block, evidence)
    assert {tuple(b) for b in field.update().blocks} == {tuple(b) for b in changed.blocks}
    assert_equal_to_one_made_anew(field)


@pytest.mark.parametrize("of", [occupancy_of, tsdf_of])
def test_large_regions_are_done_in_parts_with_the_same_result(monkeypatch, of):
    source = of(Room(), 0.1, 4)
    whole = EsdfMap(source, 0.5)
    whole.update()
    monkeypatch.setattr(mapping.esdf, "_MOST_CELLS", 200)
    parts = EsdfMap(source, 0.5)
    parts.update()
    slots = whole.store.find(parts.block_ijk)
    assert np.array_equal(whole.store.fields["distance"][slots], parts.store.used("distance"), equal_nan=True)


@pytest.mark.parametrize("of", [occupancy_of, tsdf_of])
def test_any_number_of_threads_gives_the_same_distances(of):
    import numba

    source = of(Room(), 0.1, 3)
    threads = numba.get_num_threads()
    fields = []
    try:
        for n in {1, threads}:
            numba.set_num_threads(n)
            fields.append(EsdfMap(source, 0.5))
            fields[-1].update()
    finally:
        numba.set_num_threads(threads)
    assert all(
        np.array_equal(f.store.used("distance"), fields[0].store.used("distance"), equal_nan=True) for f in fields
    )


def test_nothing_is_done_when_nothing_changed():
    source = occupancy_of(Room(), 0.1, 2)
    field = EsdfMap(source, 0.5)
    assert len(field.update()) == 64
    revision = field.revision
    assert len(field.update()) == 0
    field.query([[0.0, 0.0, 0.0]])
    assert field.revision == revision


def test_a_detached_field_keeps_its_distances(tmp_path):
    field = EsdfMap(occupancy_of(Room(), 0.1, 2), 0.5)
    field.update()
    field.save(tmp_path / "field.npz")
    loaded = EsdfMap.load(tmp_path / "field.npz")
    assert loaded.source is None
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    assert np.array_equal(loaded.query(points), field.query(points), equal_nan=True)


def test_a_voxel_size_other_than_the_sources_is_refused():
    with pytest.raises(InvalidParameter, match="voxel_size_m"):
        EsdfMap(OccupancyMap(0.1), voxel_size_m=0.2)
    with pytest.raises(InvalidParameter, match="voxel_size_m"):
        EsdfMap()
