"""The sparse store holds what was put into it and nothing else, in little room."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import MappingError
from mapping.packed import PackedStore

FIELDS = {"value": ("u2", 2), "weight": ("f4", 1)}

voxels = st.lists(st.tuples(*[st.integers(-20, 20)] * 3), max_size=60)
steps = st.lists(st.tuples(st.booleans(), voxels), max_size=8)


def cells_of(store: PackedStore, ijk: np.ndarray) -> np.ndarray:
    """The cells (n,) of voxels (n, 3), whose blocks are made where they are missing."""
    store.allocate(ijk >> 3)
    return store.cells_of(ijk)


def contents(store: PackedStore) -> dict[tuple[int, ...], int]:
    """Voxel → value of all records."""
    cells = store.cells()
    rows = store.rows(cells)
    assert len(set(rows.tolist())) == len(rows) == store.n_records
    return dict(
        zip(
            [tuple(v) for v in store.ijk(cells).tolist()],
            store.fields["value"][rows, 0].tolist(),
            strict=True,
        )
    )


@settings(deadline=None, max_examples=200)
@given(steps)
def test_records_are_kept_as_a_dictionary_would(steps):
    store, truth = PackedStore(FIELDS, 0.1), {}
    number = 0
    for adds, chosen in steps:
        ijk = np.array(chosen, np.int32).reshape(-1, 3)
        cells = cells_of(store, ijk)
        if adds:
            store.add(cells)
            rows = store.rows(cells)
            for voxel, row in zip(chosen, rows.tolist(), strict=True):
                assert store.fields["value"][row, 0] == truth.setdefault(voxel, 0)
            for voxel, row in zip(chosen, rows.tolist(), strict=True):
                number += 1
                store.fields["value"][row, 0] = truth[voxel] = number
        else:
            store.remove(cells)
            for voxel in chosen:
                truth.pop(voxel, None)
        assert contents(store) == truth


@settings(deadline=None, max_examples=50)
@given(steps)
def test_a_store_is_restored_as_it_was(steps):
    store = PackedStore(FIELDS, 0.1)
    for adds, chosen in steps:
        cells = cells_of(store, np.array(chosen, np.int32).reshape(-1, 3))
        (store.add if adds else store.remove)(cells)
        rows = store.rows(store.cells())
        store.fields["value"][rows, 0] = 1 + np.arange(len(rows))
    again = PackedStore(FIELDS, 0.1)
    again.restore(store.state())
    assert contents(again) == contents(store)
    assert np.array_equal(again.block_ijk, store.block_ijk)


def test_points_find_the_records_of_their_voxels():
    store = PackedStore(FIELDS, 0.5)
    cells = cells_of(store, np.array([[0, 0, 0], [-1, 2, 9]]))
    store.add(cells)
    assert store.cells_at([[0.2, 0.1, 0.4], [-0.1, 1.2, 4.9], [50.0, 0, 0], [np.nan, 0, 0]]).tolist() == [
        *cells.tolist(),
        -1,
        -1,
    ]
    assert store.rows(np.array([-1])).tolist() == [-1]
    assert (store.rows(cells) >= 0).all()


def test_a_wall_costs_little_more_than_its_records():
    store = PackedStore({"value": ("u2", 7)}, 0.025)
    i, j = np.meshgrid(np.arange(400), np.arange(120), indexing="ij")
    wall = np.stack([i, 3 + i // 50, j], axis=-1).reshape(-1, 3)
    for part in np.array_split(wall[np.random.default_rng(0).permutation(len(wall))], 30):
        store.add(cells_of(store, part))
    assert store.n_records == len(wall)
    assert store.memory_bytes / len(wall) < 14 * 1.8


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: s.pop("masks"), "lacks masks"),
        (lambda s: s.update(masks=s["masks"].astype(np.int64)), "masks: expected uint64"),
        (lambda s: s.update(value=s["value"][:-1]), "value: expected uint16"),
        (lambda s: s.update(block_ijk=np.repeat(s["block_ijk"][:1], len(s["block_ijk"]), axis=0)), "twice"),
    ],
)
def test_a_damaged_state_is_refused(spoil, message):
    store = PackedStore(FIELDS, 0.1)
    store.add(cells_of(store, np.array([[0, 0, 0], [9, 9, 9]])))
    state = store.state()
    spoil(state)
    with pytest.raises(MappingError, match=message):
        PackedStore(FIELDS, 0.1).restore(state)
