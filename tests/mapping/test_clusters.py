"""Clusters: components against a flood over all voxels, and ids that last."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.clusters import LARGEST_M, ClusterMap, Component
from mapping.errors import MappingError
from mapping.kernels.clusters import LOOSE, NOTHING, RAISED
from tests import naive_clusters as naive
from tests.naive_clusters import Samples, Voxel

SIZE = 0.05
VOXELS = st.tuples(st.integers(5, 11), st.integers(-3, 3), st.integers(6, 9))
"""About the corner of eight blocks."""
UPDATES = st.lists(
    st.dictionaries(VOXELS, st.sampled_from((NOTHING, LOOSE, LOOSE, RAISED)), min_size=1, max_size=25),
    min_size=1,
    max_size=6,
)


def mapped() -> tuple[ClusterMap, Any]:
    clusters, surface = ClusterMap(SIZE), Samples(SIZE)
    clusters.assign(surface, {7: "support"})  # type: ignore[arg-type]
    return clusters, surface


def found(clusters: ClusterMap, surface: Any) -> dict[int, frozenset[Voxel]]:
    """The voxels of each component."""
    return {
        i: frozenset(map(tuple, np.round(clusters.surface(i, surface)[0] / SIZE - 1.0).astype(int).tolist()))
        for i in clusters.components
    }


@settings(max_examples=150, deadline=None)
@given(UPDATES)
def test_components_that_follow_changes_are_those_of_a_flood_over_all(updates: list[dict[Voxel, int]]) -> None:
    clusters, surface = mapped()
    for n, codes in enumerate(updates):
        before = found(clusters, surface)
        change = clusters.update(surface, surface.set(codes), n, found=True)
        after = found(clusters, surface)
        assert set(after.values()) == naive.components(surface.codes)
        for i, component in clusters.components.items():
            assert component.n_voxels == len(after[i])
            np.testing.assert_allclose(component.low, (np.min(list(after[i]), axis=0) + 1.0) * SIZE)
            np.testing.assert_allclose(component.high, (np.max(list(after[i]), axis=0) + 1.0) * SIZE)
        for i in before.keys() | after.keys():
            if before.get(i) != after.get(i):
                assert i in change.touched
        check_ids(before, after, change.merged, change.split)


def check_ids(before: dict[int, frozenset[Voxel]], after: dict[int, frozenset[Voxel]], merged: Any, split: Any) -> None:
    """What stays as it is keeps its id; ids come back to none; what has gone into another is said, and what came of
    one."""
    assert all(after[i] == voxels for i, voxels in before.items() if voxels in after.values())
    assert all(i > max(before, default=0) for i in after.keys() - before.keys())
    for lost, kept in merged.items():
        assert lost in before
        assert lost not in after
        assert before[lost] & after[kept]
    for part, whole in split.items():
        assert part not in before
        assert whole in after
        assert after[part] & before[whole]


@settings(max_examples=50, deadline=None)
@given(UPDATES, st.integers(0, 5))
def test_a_map_that_comes_back_from_disk_goes_on_as_if_it_had_not_been_away(
    updates: list[dict[Voxel, int]], when: int
) -> None:
    (one, surface), (other, same) = mapped(), mapped()
    for n, codes in enumerate(updates):
        if n == when:
            other = ClusterMap.from_state(other.state(), SIZE)
            other.assign(same, {7: "support"})
        one.update(surface, surface.set(codes), n, found=True)
        other.update(same, same.set(codes), n, found=True)
    assert found(one, surface) == found(other, same)
    assert {i: vars(c) | {"low": c.low.tolist(), "high": c.high.tolist()} for i, c in one.components.items()} == {
        i: vars(c) | {"low": c.low.tolist(), "high": c.high.tolist()} for i, c in other.components.items()
    }


def bar(first: int, last: int, code: int = LOOSE) -> dict[Voxel, int]:
    return {(i, 0, k): code for i in range(first, last) for k in range(3)}


def test_ids_stay_while_a_cluster_grows_and_two_become_one_when_the_gap_is_filled() -> None:
    clusters, surface = mapped()
    clusters.update(surface, surface.set(bar(0, 9) | bar(20, 26)), 1, found=True)
    assert found(clusters, surface) == {1: frozenset(bar(0, 9)), 2: frozenset(bar(20, 26))}
    clusters.update(surface, surface.set(bar(9, 13)), 2, found=True)
    assert found(clusters, surface)[1] == frozenset(bar(0, 13))
    change = clusters.update(surface, surface.set(bar(13, 20)), 3, found=True)
    assert change.merged == {2: 1}
    assert found(clusters, surface) == {1: frozenset(bar(0, 26))}
    change = clusters.update(surface, surface.set(bar(12, 20, NOTHING)), 4, found=True)
    assert change.split == {3: 1}
    assert found(clusters, surface) == {1: frozenset(bar(0, 12)), 3: frozenset(bar(20, 26))}
    assert clusters.components[3].views == clusters.components[1].views


def test_what_stands_on_a_table_is_not_of_it_but_its_legs_are() -> None:
    clusters, surface = mapped()
    top = {(i, j, 14): RAISED for i in range(20) for j in range(12)}
    legs = {(i, j, k): LOOSE for i in (0, 19) for j in (0, 11) for k in range(14)}
    cup = {(10, 5, k): LOOSE for k in range(15, 19)}
    clusters.update(surface, surface.set(top | legs | cup), 1, found=True)
    assert set(found(clusters, surface).values()) == {frozenset(top | legs), frozenset(cup)}


def test_where_nothing_may_be_founded_what_is_known_is_followed_still() -> None:
    clusters, surface = mapped()
    blocks = surface.set(bar(0, 5) | bar(40, 45))
    clusters.update(surface, blocks[:1], 1, found=True)
    change = clusters.update(surface, surface.set(bar(0, 2, NOTHING) | bar(40, 45)), 2, found=False)
    assert found(clusters, surface) == {1: frozenset(bar(2, 5))}
    assert change.touched == {1}


def test_what_has_a_name_is_no_cluster() -> None:
    clusters, surface = mapped()
    blocks = surface.set(bar(0, 10))
    clusters.update(surface, blocks, 1, found=True)
    assert clusters.covered(np.array([[0.05, 0.05, 0.05]])) == {1: 4}
    clusters.look_again(np.array([[0.05, 0.05, 0.05]]))
    clusters.update(surface, blocks[:0], 2, found=False, named=lambda points: points[:, 0] < 4.5 * SIZE)
    assert found(clusters, surface) == {1: frozenset(bar(4, 10))}


@pytest.mark.parametrize(("n", "size", "thing"), [(40, 0.5, True), (5, 0.5, False), (40, LARGEST_M + 0.1, False)])
def test_a_thing_is_neither_a_speck_nor_larger_than_furniture(n: int, size: float, thing: bool) -> None:
    component = Component(1, 0, 0, n_voxels=n, low=np.zeros(3), high=np.array([0.1, size - SIZE - 1e-6, 0.0]))
    assert ClusterMap(SIZE).is_thing(component) == thing


def test_a_saved_map_without_its_components_is_refused() -> None:
    with pytest.raises(MappingError, match="components"):
        ClusterMap.from_state({}, SIZE)
