"""What a box holds, against counting one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.histograms import aligned_box, class_histogram
from mapping.mesh import Mesh
from mapping.observations import Box3d
from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.semantics import SemanticMap
from tests import naive_labelled as naive
from tests.mapping.test_labelled import COARSE, FINE, world

seeds = st.integers(0, 10_000)


def naive_counts(box: Box3d, semantics: SemanticMap, occupancy: OccupancyMap) -> tuple[dict[int, int], list[int]]:
    """Labelled voxels by class; and voxels that are occupied, free, unseen, and occupied without a label."""
    pose = SE3.from_quaternion(box.rotation_wxyz, box.center)
    voxels = naive.labels_by_voxel(semantics)
    counts: dict[int, int] = {}
    for voxel, label in voxels.items():
        if naive.is_inside((np.array(voxel) + 0.5) * FINE, pose.translation, box.size, pose.rotation):
            counts[label] = counts.get(label, 0) + 1
    there = [0, 0, 0, 0]
    reach = int(np.linalg.norm(box.size) + np.abs(box.center).max() / COARSE) + 12
    for voxel in np.indices((2 * reach,) * 3).reshape(3, -1).T - reach:
        centre = (voxel + 0.5) * COARSE
        if not naive.is_inside(centre, pose.translation, box.size, pose.rotation):
            continue
        state = int(occupancy.classify(centre[None])[0])
        there[0 if state == OCCUPIED else 1 if state == FREE else 2] += 1
        bare = naive.label_of_cube(centre - COARSE / 2, 2, voxels, FINE) == 0
        there[3] += state == OCCUPIED and bare
    return counts, there


@settings(max_examples=6, deadline=None)
@given(seed=seeds, turned=st.booleans())
def test_a_box_holds_what_counting_one_by_one_finds(seed: int, turned: bool) -> None:
    semantics, occupancy = world(seed)
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4) if turned else np.array([1.0, 0.0, 0.0, 0.0])
    box = Box3d(
        center=rng.uniform(-0.2, 0.2, 3), size=rng.uniform(0.2, 0.7, 3), rotation_wxyz=turn / np.linalg.norm(turn)
    )
    found = class_histogram(box, semantics, occupancy, reach_m=0.0)
    counts, there = naive_counts(box, semantics, occupancy)
    assert found.counts == counts
    assert [found.occupied, found.free, found.unseen, found.unlabelled] == there
    assert found.volume_m3.sum() == pytest.approx(sum(counts.values()) * FINE**3)
    assert class_histogram(box, semantics, occupancy).unlabelled <= found.unlabelled
    assert found.unseen_share == pytest.approx(there[2] / max(sum(there[:3]), 1), nan_ok=True)


def test_areas_are_those_of_the_mesh() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=FINE), OccupancyMap(COARSE, 5.0)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [6, 5, 5], [5, 6, 5]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], np.int32)
    mesh = Mesh(vertices, triangles, np.tile(np.float32([0, 0, 1]), (7, 1)), labels=np.uint16([3, 3, 3, 0, 3, 3, 3]))
    found = class_histogram(aligned_box((-1, -1, -1), (2, 2, 1)), semantics, occupancy, mesh)
    assert found.labels.tolist() == [3]
    assert found.voxels.tolist() == [0]
    assert found.area_m2 == pytest.approx([5 / 6])
    assert found.bare_m2 == pytest.approx(1 / 6)
    with pytest.raises(InvalidParameter, match="labels"):
        class_histogram(aligned_box((0, 0, 0), (1, 1, 1)), semantics, occupancy, Mesh(vertices, triangles, vertices))


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_eight_boxes_hold_together_what_the_box_about_them_holds(seed: int) -> None:
    semantics, occupancy = world(seed)
    middle = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    whole = class_histogram(aligned_box(middle - 0.5, middle + 0.5), semantics, occupancy)
    corners = [middle + (np.array(c) - 1) * 0.5 for c in np.ndindex(2, 2, 2)]
    parts = [class_histogram(aligned_box(low, low + 0.5), semantics, occupancy) for low in corners]
    for name in ("occupied", "free", "unseen", "unlabelled"):
        assert sum(getattr(part, name) for part in parts) == getattr(whole, name)
    assert sum(part.voxels.sum() for part in parts) == whole.voxels.sum()


def test_a_box_that_nobody_looked_into_is_unseen() -> None:
    semantics, occupancy = world(0)
    found = class_histogram(aligned_box((7.0, 7.0, 7.0), (8.0, 8.0, 8.0)), semantics, occupancy)
    assert (found.unseen, found.unseen_share) == (1000, 1.0)
    assert not len(found.labels)
    assert found.area_m2 is None


def test_a_box_of_a_country_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="box"):
        class_histogram(aligned_box((-5e5, -5e5, 0), (5e5, 5e5, 1e3)), *world(0))
