"""Masks find their instances by overlap both ways and by class, each instance once at most."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.association import LEAST_HITS, Overlaps, apart, assign, covered, doubted


def overlaps(
    *pairs: tuple[int, int, int, bool], looked: list[int], visible: dict[int, int], alike: float = np.nan
) -> Overlaps:
    """Of pairs of a mask, an instance, the pixels that both share, and whether they are of one class."""
    piece, instance, hits, same = (
        (np.array(column) for column in zip(*pairs, strict=True)) if pairs else [np.empty(0)] * 4
    )
    seen = np.array([visible[int(i)] for i in instance], np.int64)
    return Overlaps(
        piece.astype(np.int64),
        instance.astype(np.int64),
        hits.astype(np.int64),
        np.array(looked),
        seen,
        same.astype(bool),
        np.full(len(piece), alike),
    )


def test_a_mislabelled_mask_that_covers_an_instance_is_that_instance() -> None:
    assert assign(overlaps((0, 7, 90, False), looked=[100], visible={7: 95})).tolist() == [7]


def test_a_mask_on_a_small_part_of_a_large_instance_is_another_thing() -> None:
    """A vase before a shelf: all of it lies on voxels that the shelf has."""
    assert assign(overlaps((0, 7, 80, False), looked=[100], visible={7: 5000})).tolist() == [0]


def test_a_mask_that_covers_all_that_is_visible_sees_an_instance_from_a_new_side() -> None:
    assert assign(overlaps((0, 7, 90, True), looked=[500], visible={7: 100})).tolist() == [7]


def test_a_thing_given_the_class_of_its_neighbour_does_not_become_it() -> None:
    told = overlaps((0, 7, 20, True), (0, 8, 80, False), looked=[100], visible={7: 2000, 8: 90})
    assert assign(told).tolist() == [8]


def test_all_masks_of_an_image_are_different_things() -> None:
    told = overlaps((0, 7, 90, True), (1, 7, 60, True), looked=[100, 100], visible={7: 150})
    assert assign(told).tolist() == [7, 0]


def test_what_lies_where_a_thing_of_other_colours_was_is_another_and_unknown_colours_tell_nothing() -> None:
    told = [
        assign(overlaps((0, 7, 50, True), looked=[100], visible={7: 100}, alike=alike)).tolist()
        for alike in (0.0, 0.9, 1.0, np.nan)
    ]
    assert told == [[0], [7], [7], [7]]


def test_few_pixels_tell_nothing() -> None:
    few = LEAST_HITS - 1
    assert assign(overlaps((0, 7, few, True), looked=[few], visible={7: few})).tolist() == [0]


def test_no_masks_and_no_instances_are_nothing_to_assign() -> None:
    assert assign(overlaps(looked=[], visible={})).tolist() == []
    assert assign(overlaps(looked=[50, 60], visible={})).tolist() == [0, 0]


def test_a_mask_over_two_instances_says_that_they_may_be_one() -> None:
    told = overlaps((0, 7, 60, True), (0, 8, 40, True), looked=[100], visible={7: 60, 8: 45})
    ids = assign(told)
    assert ids.tolist() == [7]
    assert covered(told, ids) == [(7, 8)]
    assert doubted(told, ids) == [8]


def test_an_instance_with_a_mask_of_its_own_is_neither_covered_nor_doubted() -> None:
    told = overlaps((0, 7, 90, True), (0, 8, 40, True), (1, 8, 50, True), looked=[140, 50], visible={7: 95, 8: 90})
    ids = assign(told)
    assert ids.tolist() == [7, 8]
    assert covered(told, ids) == []
    assert doubted(told, ids) == []


def test_what_no_other_mask_claims_is_not_doubted() -> None:
    """The segmenter missed it: its pixels have no label."""
    assert doubted(overlaps((0, 7, 20, False), looked=[500], visible={7: 900}), np.array([3])) == []


def test_a_second_mask_on_an_instance_says_that_it_may_be_two() -> None:
    told = overlaps((0, 7, 300, True), (1, 7, 90, False), looked=[310, 100], visible={7: 400})
    assert apart(told, np.array([7, 9])) == [(1, 7)]
    assert apart(told, np.array([7, 0])) == [], "a mask that is no instance has nothing to take"


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), masks=st.integers(0, 6), instances=st.integers(1, 6))
def test_assignment_is_likelier_than_any_single_exchange(seed: int, masks: int, instances: int) -> None:
    rng = np.random.default_rng(seed)
    hits = rng.integers(0, 100, (masks, instances))
    piece, column = np.nonzero(hits)
    told = Overlaps(
        piece, column + 11, hits[piece, column], hits.sum(axis=1) + 1, hits.sum(axis=0)[column] + 1,
        rng.random(len(piece)) < 0.5, rng.random(len(piece)),
    )  # fmt: skip
    ids = assign(told)
    chosen = ids[ids > 0]
    assert len(set(chosen.tolist())) == len(chosen)
    odds = {(int(p), int(i)): float(o) for p, i, o in zip(piece, told.instance, told.log_odds, strict=True)}
    assert all(odds[p, int(i)] > 0.0 for p, i in enumerate(ids.tolist()) if i)
    free = set(told.instance.tolist()) - set(chosen.tolist())
    for p, i in enumerate(ids.tolist()):
        best = max((odds.get((p, k), 0.0) for k in free), default=0.0)
        assert best <= max(odds.get((p, i), 0.0), 0.0) + 1e-9
    assert told.of_mask == pytest.approx(told.hits / told.looked[told.piece])
