"""The block store is a dictionary with arrays for values; indices and points are two names for one place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mapping.errors import InvalidParameter, MappingError
from mapping.grid import BlockStore, ijk_to_centre, join_ijk, point_to_ijk, split_ijk
from mapping.kernels.hashing import BLOCK_LIMIT

blocks_near_and_far = npst.arrays(
    np.int32,
    st.tuples(st.integers(0, 40), st.just(3)),
    elements=st.one_of(st.integers(-2, 2), st.integers(-BLOCK_LIMIT, BLOCK_LIMIT - 1)),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(blocks_near_and_far, max_size=4), blocks_near_and_far)
def test_a_store_is_a_dictionary_from_block_to_slot(batches, asked):
    store = BlockStore({"value": np.float32}, 0.1)
    naive: dict[tuple[int, ...], int] = {}
    for batch in batches:
        slots = store.allocate(batch)
        expected = [naive.setdefault(tuple(block), len(naive)) for block in batch.tolist()]
        assert slots.tolist() == expected
    assert store.n_blocks == len(naive)
    assert [tuple(block) for block in store.block_ijk.tolist()] == list(naive)
    assert store.find(asked).tolist() == [naive.get(tuple(block), -1) for block in asked.tolist()]


@settings(max_examples=60, deadline=None)
@given(
    npst.arrays(np.int32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.integers(-(2**22), 2**22)),
    st.sampled_from([0.01, 0.02, 0.05, 0.08, 0.1, 1.0]),
)
def test_a_voxel_holds_its_centre_and_lies_in_its_block(ijk, voxel_size):
    assert np.array_equal(point_to_ijk(ijk_to_centre(ijk, voxel_size), voxel_size), ijk)
    block, local = split_ijk(ijk)
    assert np.array_equal(join_ijk(block, local), ijk)
    assert ((local >= 0) & (local < 512)).all()
    assert np.array_equal(local, (ijk[:, 0] % 8) * 64 + (ijk[:, 1] % 8) * 8 + ijk[:, 2] % 8)


def test_locate_agrees_with_the_conversions():
    rng = np.random.default_rng(1)
    store = BlockStore({"value": np.int8}, 0.05)
    store.allocate(rng.integers(-5, 5, (200, 3)))
    points = rng.uniform(-2.5, 2.5, (2000, 3))
    slots, local = store.locate(points)
    block, expected = split_ijk(point_to_ijk(points, 0.05))
    assert np.array_equal(slots, store.find(block))
    assert np.array_equal(local[slots >= 0], expected[slots >= 0])


def test_points_nowhere_are_in_no_block():
    store = BlockStore({"value": np.int8}, 0.05)
    store.allocate([[0, 0, 0]])
    slots, _ = store.locate([[np.nan, 0, 0], [np.inf, 0, 0], [1e30, 0, 0], [0.01, 0.01, 0.01]])
    assert slots.tolist() == [-1, -1, -1, 0]


def test_growth_keeps_values_and_fills_new_blocks():
    store = BlockStore({"code": np.int8, "color": np.dtype((np.uint16, 3))}, 0.05, fill={"code": -128})
    first = store.allocate([[1, 2, 3]])
    store.fields["code"][first] = 7
    store.fields["color"][first, 5] = (1, 2, 3)
    store.allocate(np.argwhere(np.ones((20, 20, 20))) + 100)
    assert (store.fields["code"][first] == 7).all()
    assert (store.used("code")[1:] == -128).all()
    assert store.fields["color"][first, 5].tolist() == [[1, 2, 3]]
    store.add_field("later", np.float32)
    assert store.used("later").shape == (8001, 512)


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_voxel_size_that_is_no_length_is_refused(size):
    with pytest.raises(InvalidParameter, match="voxel_size_m"):
        BlockStore({"value": np.int8}, size)


def test_blocks_beyond_the_address_space_are_refused():
    store = BlockStore({"value": np.int8}, 0.05)
    with pytest.raises(InvalidParameter, match="block_ijk"):
        store.allocate([[BLOCK_LIMIT, 0, 0]])
    with pytest.raises(InvalidParameter, match="block_ijk"):
        store.find([[0.5, 0, 0]])


def test_a_state_that_does_not_fit_is_refused():
    store = BlockStore({"value": np.int8}, 0.05)
    store.allocate([[0, 0, 0]])
    state = store.state()
    for bad, what in (
        ({"block_ijk": state["block_ijk"]}, "lacks value"),
        ({**state, "value": state["value"].astype(np.int16)}, "expected int8"),
        ({**state, "value": state["value"][:, :5]}, "shape"),
        ({"block_ijk": np.zeros((2, 3), np.int32), "value": np.zeros((2, 512), np.int8)}, "twice"),
    ):
        with pytest.raises(MappingError, match=what):
            BlockStore({"value": np.int8}, 0.05).restore(bad)
