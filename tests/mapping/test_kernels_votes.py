"""The kernels by which pixels vote for voxels equal their slow twins."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BlockStore, point_to_ijk
from mapping.kernels import votes as kernels
from mapping.semantics import camera_row, pose_rows

CAMERA = CameraIntrinsics(fx=11.0, fy=12.0, cx=5.3, cy=4.1, width=12, height=9)
SHAPE = (CAMERA.height, CAMERA.width)
VOXEL = 0.13
FIELDS = {"first": "u4", "weight": "f4", "second": "u4", "second_weight": "f4", "total": "f4", "mean": ("f4", 3)}

seeds = st.integers(0, 10**6)


class View:
    """A random depth image from a random pose, with the points of its pixels."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.rng = rng
        self.depth = np.where(rng.random(SHAPE) < 0.2, 0.0, rng.uniform(0.5, 4.0, SHAPE)).astype(np.float32)
        self.choices = (rng.integers(0, 4, SHAPE) * (self.depth > 0)).astype(np.uint32)
        self.pose = SE3.exp(rng.uniform(-1.0, 1.0, 6))
        self.camera, self.rows = camera_row(CAMERA), pose_rows(self.pose)
        v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
        z = self.depth.astype(np.float64)
        optical = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], axis=-1)
        self.points = (self.pose @ optical.reshape(-1, 3)).reshape(*SHAPE, 3)
        self.ijk = point_to_ijk(self.points.reshape(-1, 3), VOXEL).reshape(*SHAPE, 3)

    def store(self) -> BlockStore:
        store = BlockStore(FIELDS, VOXEL)
        store.allocate(np.unique(self.ijk[self.depth > 0] >> 3, axis=0))
        return store


@settings(max_examples=40, deadline=None)
@given(seed=seeds, step=st.integers(1, 3))
def test_touched_blocks_are_those_of_the_points(seed: int, step: int) -> None:
    view = View(seed)
    wanted = view.choices > 0
    found = kernels.touched_blocks(view.depth, wanted, view.camera, view.rows, VOXEL, step)
    looked = np.zeros(SHAPE, bool)
    looked[::step, ::step] = True
    expected = {tuple(b) for b in (view.ijk[wanted & looked] >> 3).tolist()}
    assert {tuple(b) for b in found.tolist()} == expected
    assert len(found) == len(expected), "each once"


def test_many_touched_blocks_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(1.0, 60.0, (80, 90)).astype(np.float32)
    camera = np.array([40.0, 40.0, 45.0, 40.0])
    found = kernels.touched_blocks(depth, depth > 0, camera, pose_rows(SE3.identity()), 0.02, 1)
    assert len(found) == len({tuple(b) for b in found.tolist()}) > 4096


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_pixels_vote_with_the_share_of_a_face_that_they_cover(seed: int) -> None:
    view = View(seed)
    view.choices = np.minimum(view.choices, 2)  # two classes: nothing is forgotten
    store, trust = view.store(), view.rng.random(SHAPE).astype(np.float32)
    fields = store.fields
    names = ("first", "weight", "second", "second_weight", "total")
    kernels.vote_image(
        store.table, *(fields[n] for n in names), fields["mean"], view.depth, view.choices, trust,
        view.camera, view.rows, VOXEL, 1e9, 8.0,
    )  # fmt: skip
    votes: Counter[tuple[int, ...]] = Counter()
    for v, u in np.argwhere(view.choices > 0):
        weight = float(trust[v, u]) * float(view.depth[v, u]) ** 2 / (CAMERA.fx * CAMERA.fy * VOXEL**2)
        votes[(*view.ijk[v, u].tolist(), int(view.choices[v, u]))] += weight
    for *ijk, choice in votes:
        at = store.locate([(np.array(ijk) + 0.5) * VOXEL])
        held = {
            int(fields["first"][at][0]): fields["weight"][at][0],
            int(fields["second"][at][0]): fields["second_weight"][at][0],
        }
        assert held[choice] == pytest.approx(votes[(*ijk, choice)], rel=1e-4, abs=1e-6)
        both = sum(weight for key, weight in votes.items() if list(key[:3]) == ijk)
        assert fields["total"][at][0] == pytest.approx(both, rel=1e-4, abs=1e-6)
        assert fields["weight"][at][0] >= fields["second_weight"][at][0] - 1e-6


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_the_mean_of_a_voxel_lies_in_it_and_is_that_of_its_points(seed: int) -> None:
    view = View(seed)
    store, trust = view.store(), np.ones(SHAPE, np.float32)
    fields = store.fields
    names = ("first", "weight", "second", "second_weight", "total")
    kernels.vote_image(
        store.table, *(fields[n] for n in names), fields["mean"], view.depth, np.minimum(view.choices, 1), trust,
        view.camera, view.rows, VOXEL, 1e9, 1e9,
    )  # fmt: skip
    voting = view.choices > 0
    for ijk in {tuple(i) for i in view.ijk[voting].tolist()}:
        mine = voting & (view.ijk == ijk).all(axis=-1)
        at = store.locate([(np.array(ijk) + 0.5) * VOXEL])
        offset = fields["mean"][at][0]
        assert (np.abs(offset) <= 0.5 + 1e-3).all()
        weights = view.depth[mine].astype(float) ** 2
        mean = np.average(view.points[mine], axis=0, weights=weights) / VOXEL - np.array(ijk) - 0.5
        assert offset == pytest.approx(mean, abs=2e-3)


def random_votes(store: BlockStore, rng: np.random.Generator) -> None:
    for name in ("first", "second"):
        store.fields[name][: store.n_blocks] = rng.integers(0, 4, (store.n_blocks, 512))
    for name in ("weight", "second_weight"):
        store.fields[name][: store.n_blocks] = rng.random((store.n_blocks, 512))
    store.fields["total"][: store.n_blocks] = store.fields["weight"][: store.n_blocks] + rng.random(
        (store.n_blocks, 512)
    )


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_gathered_points_are_those_of_the_voxels_that_an_instance_has_won(seed: int) -> None:
    view = View(seed)
    store = view.store()
    random_votes(store, view.rng)
    fields = store.fields
    fields["mean"][: store.n_blocks] = view.rng.uniform(-0.5, 0.5, (store.n_blocks, 512, 3))
    slots = np.arange(0, store.n_blocks, 2)
    points, weights = kernels.gather(
        slots, store.block_ijk, fields["first"], fields["weight"], fields["total"], fields["mean"], 2, VOXEL, 0.3, 0.5
    )
    expected = []
    for s in slots.tolist():
        for local in range(512):
            held = fields["weight"][s, local]
            if fields["first"][s, local] == 2 and held >= 0.3 and held >= np.float32(0.5) * fields["total"][s, local]:
                ijk = store.block_ijk[s] * 8 + [local >> 6, local >> 3 & 7, local & 7]
                expected.append([*((ijk + 0.5 + fields["mean"][s, local]) * VOXEL), held])
    assert np.column_stack([points, weights]) == pytest.approx(np.reshape(expected, (-1, 4)), abs=1e-5)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_renaming_keeps_every_vote(seed: int) -> None:
    view = View(seed)
    store = view.store()
    random_votes(store, view.rng)
    fields = {name: store.fields[name][: store.n_blocks] for name in ("first", "weight", "second", "second_weight")}
    fields["second"][fields["second"] == fields["first"]] = 0

    def votes_for(choice: int) -> float:
        first, second = fields["first"] == choice, fields["second"] == choice
        return float(fields["weight"][first].sum() + fields["second_weight"][second].sum())

    before = {choice: votes_for(choice) for choice in (1, 2, 3)}
    kernels.rename(np.arange(store.n_blocks), *fields.values(), 2, 3)
    assert votes_for(2) == 0.0
    assert votes_for(3) == pytest.approx(before[2] + before[3], rel=1e-4)
    assert votes_for(1) == pytest.approx(before[1], rel=1e-6)
    assert not ((fields["first"] == fields["second"]) & (fields["first"] != 0)).any()


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_overlaps_at_the_very_point_are_those_of_the_naive_reference(seed: int) -> None:
    """All voxels of the blocks are taken, so that no pixel has to look beside its point."""
    view = View(seed)
    store = view.store()
    random_votes(store, view.rng)
    store.fields["first"][: store.n_blocks] += 1
    store.fields["weight"][: store.n_blocks] += 0.1
    pieces = view.choices.astype(np.int32)
    piece, known, hits, looked = kernels.count_overlaps(
        store.table,
        store.fields["first"],
        store.fields["weight"],
        view.depth,
        pieces,
        view.camera,
        view.rows,
        VOXEL,
        1,
        3,
    )
    seen = view.depth > 0
    slots, local = store.locate((view.ijk[seen] + 0.5) * VOXEL)
    expected = Counter(zip(pieces[seen].tolist(), store.fields["first"][slots, local].tolist(), strict=True))
    assert dict(zip(zip(piece.tolist(), known.tolist(), strict=True), hits.tolist(), strict=True)) == dict(expected)
    assert looked.tolist() == [int((pieces[seen] == n).sum()) for n in range(4)]


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_blocks_of_choices_are_those_of_the_points(seed: int) -> None:
    view = View(seed)
    store = view.store()
    pairs = kernels.blocks_of_choices(store.table, view.depth, view.choices, view.camera, view.rows, VOXEL, 1)
    voting = view.choices > 0
    slots = store.find(view.ijk[voting] >> 3)
    assert {tuple(p) for p in pairs.tolist()} == set(zip(view.choices[voting].tolist(), slots.tolist(), strict=True))
