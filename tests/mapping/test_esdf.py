"""Euclidean distances: as far as the nearest of all, and up to date with the map they follow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

import mapping.esdf
from mapping.errors import InvalidParameter
from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.grid import BLOCK_VOXELS, ijk_to_centre, join_ijk, split_ijk
from mapping.kernels import esdf as kernels
from mapping.kernels import occupancy
from mapping.occupancy import OccupancyMap
from mapping.tsdf import TsdfMap
from tests import naive_layers as naive
from tests.support.rooms import SMALL_CAMERA, TOUR, Room


def filled(layer, half_blocks: int):
    """All voxel centres (N, 3) [m] of a cube of blocks, which are allocated, and their slots."""
    edge = np.arange(-half_blocks, half_blocks)
    blocks = np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    slots = layer.store.allocate(blocks)
    local = np.tile(np.arange(BLOCK_VOXELS), len(blocks))
    return ijk_to_centre(join_ijk(np.repeat(blocks, BLOCK_VOXELS, axis=0), local), layer.voxel_size_m), slots


def occupancy_of(room: Room, voxel_size: float, half_blocks: int) -> OccupancyMap:
    layer = OccupancyMap(voxel_size)
    centres, slots = filled(layer, half_blocks)
    evidence = np.where(room.distance(centres) < 0.0, 50, -50)
    layer.store.fields["evidence"][slots] = evidence.reshape(-1, BLOCK_VOXELS)
    layer._note(slots)
    return layer


def tsdf_of(room: Room, voxel_size: float, half_blocks: int) -> TsdfMap:
    layer = TsdfMap(voxel_size)
    centres, slots = filled(layer, half_blocks)
    distance = np.clip(room.distance(centres), -layer.truncation_m, layer.truncation_m)
    layer.store.fields["distance"][slots] = distance.reshape(-1, BLOCK_VOXELS)
    layer.store.fields["weight"][slots] = 1.0
    layer._note(slots)
    return layer


@settings(max_examples=40, deadline=None)
@given(
    npst.arrays(np.bool_, npst.array_shapes(min_dims=3, max_dims=3, max_side=9), elements=st.booleans()),
    st.floats(0.0, 0.2),
    st.integers(1, 12),
)
def test_the_transform_agrees_with_trying_all_sites(random_sites, density, cap):
    sparse = np.random.default_rng(int(density * 1000)).random(random_sites.shape) < density
    for sites in (random_sites, sparse):
        squared, nearest = np.empty(sites.shape, np.int32), np.empty(sites.shape, np.int32)
        kernels.transform(sites, cap, squared, nearest)
        expected = naive.nearest_squared(sites)
        expected[expected > cap**2] = kernels.FAR
        assert np.array_equal(squared, expected)
        there = nearest[nearest >= 0]
        assert sites.ravel()[there].all()
        places = np.stack(np.unravel_index(there, sites.shape), axis=1)
        assert np.array_equal(((places - np.argwhere(nearest >= 0)) ** 2).sum(axis=1), squared[nearest >= 0])


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


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 23), st.integers(1, 60)), min_size=2, max_size=4), st.booleans())
def test_following_the_source_equals_starting_anew(steps, by_image):
    source = OccupancyMap(0.1) if by_image else TsdfMap(0.1)
    field = EsdfMap(source, 0.4)
    for n, count in steps:
        if by_image:
            source.integrate_image(Room().depth(TOUR[n], SMALL_CAMERA), SMALL_CAMERA, TOUR[n])
        else:
            source.integrate(Room().scan(TOUR[n], count, seed=n), TOUR[n])
        field.update()
    anew = EsdfMap(source, 0.4)
    anew.update()
    slots = anew.store.find(field.block_ijk)
    assert field.store.n_blocks == anew.store.n_blocks
    assert np.array_equal(anew.store.fields["distance"][slots], field.store.used("distance"), equal_nan=True)


def test_large_regions_are_done_in_parts_with_the_same_result(monkeypatch):
    source = occupancy_of(Room(), 0.1, 4)
    whole = EsdfMap(source, 0.5)
    whole.update()
    monkeypatch.setattr(mapping.esdf, "_MOST_VOXELS", 100_000)
    parts = EsdfMap(source, 0.5)
    parts.update()
    slots = whole.store.find(parts.block_ijk)
    assert np.array_equal(whole.store.fields["distance"][slots], parts.store.used("distance"), equal_nan=True)


def test_nothing_is_done_when_nothing_changed():
    source = occupancy_of(Room(), 0.1, 2)
    field = EsdfMap(source, 0.5)
    assert len(field.update()) == source.store.n_blocks
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


def test_the_code_of_unknown_is_no_evidence():
    assert OccupancyMap().lowest_evidence > occupancy.UNKNOWN
