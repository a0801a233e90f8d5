"""The kernels of instances equal their slow twins, as long as no voxel sees more instances than it can count."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import read_only
from mapping.kernels import evidence
from mapping.kernels import instances as kernels
from mapping.kernels.instances import BACKGROUND, MEAN_UNIT
from mapping.packed import PackedStore
from mapping.semantics import camera_row, pose_rows
from tests.naive_instances import Ballots

CAMERA = CameraIntrinsics(fx=11.0, fy=12.0, cx=5.3, cy=4.1, width=12, height=9)
SHAPE = (CAMERA.height, CAMERA.width)
VOXEL = 0.13
CLASS_OF = {1: 7, 2: 7, 3: 5}

seeds = st.integers(0, 10**6)
laws = settings(max_examples=25, deadline=None)


class Voting:
    """Images from random poses, of which each pixel votes for one of two numbers; a store and its twin count them."""

    def __init__(self, seed: int, images: int = 2) -> None:
        self.rng = np.random.default_rng(seed)
        self.store = PackedStore({"evidence": ("u2", 5), "mean": ("i2", 3)}, VOXEL)
        self.twin = Ballots(VOXEL)
        self.sizes, self.lost = np.zeros(BACKGROUND + 1, np.int64), np.zeros(BACKGROUND + 1, np.bool_)
        self.numbers = self.rng.choice([1, 2, 3, BACKGROUND], 2, replace=False)
        self.camera = camera_row(CAMERA)
        for revision in range(1, images + 1):
            self.look(revision)

    def look(self, revision: int) -> None:
        rng, store = self.rng, self.store
        pose = SE3.exp(rng.uniform(-0.3, 0.3, 6))
        self.rows = pose_rows(pose)
        self.depth = np.where(rng.random(SHAPE) < 0.2, 0.0, rng.uniform(0.6, 1.4, SHAPE)).astype(np.float32)
        self.pieces = np.repeat(rng.integers(0, 3, (SHAPE[0], 4)), 3, axis=1).astype(np.int32)
        self.labels = np.where((self.pieces == 0) & (rng.random(SHAPE) < 0.3), 0, 7).astype(np.uint16)
        self.weights = np.where(rng.random(SHAPE) < 0.1, 0.0, rng.random(SHAPE)).astype(np.float32)
        self.eye = pose.translation / VOXEL
        traced = kernels.trace(
            store.table, store.masks, store.n_blocks, self.pieces, self.labels, self.weights, self.depth, self.camera,
            self.rows, VOXEL, 1,
        )  # fmt: skip
        self.cells, self.owners, self.pixels, self.votes, self.offsets, blocks, bare = traced
        store.allocate(blocks)
        store.add(bare)
        self.choices = np.append(np.append(rng.choice(self.numbers), self.numbers), 0).astype(np.uint16)[self.owners]
        self.pairs = kernels.vote(
            store.masks, store.first, store.fields["evidence"], store.fields["mean"], self.sizes, self.lost,
            store.changed_at, revision, self.cells, self.choices, self.votes, self.offsets, 60000, 60000,
        )  # fmt: skip
        self.counted = (self.votes > 0) & (self.choices > 0)
        for m in np.flatnonzero(self.counted).tolist():
            self.twin.cast(self.point(m), int(self.choices[m]), int(self.votes[m]))
        v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
        z = self.depth.astype(np.float64)
        optical = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], axis=-1)
        self.points = (pose @ optical.reshape(-1, 3)).reshape(*SHAPE, 3)

    def point(self, run: int) -> np.ndarray:
        """The mean point of a run."""
        return (self.store.ijk(self.cells[[run]])[0] + 0.5 + np.clip(self.offsets[run], -0.4999, 0.4999)) * VOXEL

    @property
    def voxels(self) -> list[tuple[int, int, int]]:
        return sorted(self.twin.votes)

    def record_rows(self, voxels: list[tuple[int, int, int]]) -> np.ndarray:
        return self.store.rows(self.store.cells_of(np.array(voxels).reshape(-1, 3)))

    def held(self, voxel: tuple[int, int, int]) -> dict[int, int]:
        record = self.store.fields["evidence"][self.record_rows([voxel])[0]].tolist()
        assert record[4] == 0, "two counters are enough for two numbers"
        return {number: count for number, count in zip(record[:2], record[2:4], strict=True) if count}


@laws
@given(seed=seeds)
def test_votes_are_those_of_the_naive_reference(seed: int) -> None:
    voting = Voting(seed)
    for voxel in voting.voxels:
        assert voting.held(voxel) == dict(voting.twin.votes[voxel])
    leads = [voting.twin.votes[v] for v in voting.voxels]
    if all(len(set(votes.values())) == len(votes) for votes in leads):  # of equals, the one that led goes on leading
        sizes = {int(n): int(voting.sizes[n]) for n in np.flatnonzero(voting.sizes) if n}
        assert sizes == voting.twin.sizes()


@laws
@given(seed=seeds)
def test_runs_hold_what_their_pixels_count(seed: int) -> None:
    """Summed over runs and over pixels, each voxel and piece has the same pixels, votes and mean point."""
    voting = Voting(seed, images=1)
    face = evidence.UNIT / (CAMERA.fx * CAMERA.fy * VOXEL**2)
    pixels, votes, sums = Counter[Any](), Counter[Any](), defaultdict[Any, Any](float)
    for at in zip(*np.nonzero(voting.depth), strict=True):
        piece, z = int(voting.pieces[at]), float(voting.depth[at])
        if piece or voting.labels[at]:
            key = (*voting.twin.at(voting.points[at]), piece)
            count = face * z * z * float(voting.weights[at])
            pixels[key] += 1
            votes[key] += count
            sums[key] += count * voting.points[at]
    told, counted, runs = Counter[Any](), Counter[Any](), Counter[Any]()
    for m in np.flatnonzero(voting.owners >= 0).tolist():
        key = (*voting.store.ijk(voting.cells[[m]])[0].tolist(), int(voting.owners[m]))
        told[key] += int(voting.pixels[m])
        counted[key] += int(voting.votes[m])
        runs[key] += 1
    assert {key: n for key, n in told.items() if key[3]} == {key: n for key, n in pixels.items() if key[3]}
    assert all(told[key] <= pixels[key] for key in told), "background counts where a piece was before it"
    whole = [key for key in votes if told[key] == pixels[key]]
    assert all(abs(counted[key] - votes[key]) < runs[key] + 1e-3 for key in whole), "rounded once a run"
    for m in np.flatnonzero(voting.votes > 0).tolist():
        key = (*voting.store.ijk(voting.cells[[m]])[0].tolist(), int(voting.owners[m]))
        if runs[key] == 1 and told[key] == pixels[key]:
            assert voting.point(m) == pytest.approx(sums[key] / votes[key], abs=1e-3)


@laws
@given(seed=seeds)
def test_the_mean_of_a_voxel_is_that_of_its_points(seed: int) -> None:
    voting = Voting(seed)
    offsets = voting.store.fields["mean"][voting.record_rows(voting.voxels)] / MEAN_UNIT
    assert (np.abs(offsets) <= 0.5).all()
    for voxel, offset in zip(voting.voxels, offsets, strict=True):
        assert (np.array(voxel) + 0.5 + offset) * VOXEL == pytest.approx(voting.twin.mean(voxel), abs=1e-4)


@laws
@given(seed=seeds)
def test_blocks_with_votes_are_told(seed: int) -> None:
    voting = Voting(seed, images=1)
    things = voting.counted & (voting.choices != BACKGROUND)
    expected = set(zip(voting.choices[things].tolist(), (voting.cells[things] >> 9).tolist(), strict=True))
    assert {(number, slot) for number, slot in voting.pairs.tolist()} == expected
    changed = np.flatnonzero(voting.store.changed_at[: voting.store.n_blocks]).tolist()
    assert changed == sorted(set((voting.cells[voting.counted] >> 9).tolist()))


@laws
@given(seed=seeds)
def test_overlaps_at_the_very_point_are_those_of_the_naive_reference(seed: int) -> None:
    voting = Voting(seed)
    store = voting.store
    piece, number, hits, looked = kernels.count_overlaps(
        store.table, store.masks, store.first, store.fields["evidence"], read_only(store.block_ijk), voting.cells,
        voting.owners, voting.pixels, voting.offsets, voting.eye, 2,
    )  # fmt: skip
    expected: Counter[tuple[int, int]] = Counter()
    for m in range(len(voting.cells)):
        votes = voting.twin.votes.get(voting.twin.at(voting.point(m)), {})
        if max(votes.values(), default=0) >= kernels.LEAST_EVIDENCE and len(set(votes.values())) == len(votes):
            expected[max(int(voting.owners[m]), 0), max(votes, key=lambda n: votes[n])] += int(voting.pixels[m])
    found = Counter(dict(zip(zip(piece.tolist(), number.tolist(), strict=True), hits.tolist(), strict=True)))
    assert not expected - found, "voxels with less are left out, and neighbours looked at in their place"
    pixels = np.bincount(np.maximum(voting.owners, 0), voting.pixels, minlength=3)
    assert looked.tolist() == pixels.tolist()
    assert all(found[p, n] <= looked[p] for p, n in found)


@laws
@given(seed=seeds, new=st.sampled_from([0, 3, 9, BACKGROUND]))
def test_renaming_gives_every_vote_to_the_heir(seed: int, new: int) -> None:
    voting = Voting(seed)
    old = int(voting.numbers[0])
    if new == old:
        return
    rows = voting.record_rows(voting.voxels)
    kernels.rename(voting.store.fields["evidence"], rows, voting.sizes, old, new)
    voting.twin.rename(old, new)
    for voxel in voting.voxels:
        assert voting.held(voxel) == {n: c for n, c in voting.twin.votes[voxel].items() if c}
    assert voting.sizes[old] == 0
    leaders = np.empty(len(rows), np.int64)
    kernels.numbers_of(voting.store.fields["evidence"], rows, leaders)
    assert np.array_equal(voting.sizes[1:], np.bincount(leaders, minlength=BACKGROUND + 1)[1:])


@laws
@given(seed=seeds, least=st.integers(0, 100), share=st.floats(0.5, 1.0))
def test_gathered_voxels_are_those_that_an_instance_has_won(seed: int, least: int, share: float) -> None:
    voting = Voting(seed)
    number = int(voting.numbers[0])
    rows = voting.record_rows(voting.voxels)
    chosen, weights = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
    n = kernels.gather(voting.store.fields["evidence"], rows, number, least, share, chosen, weights)
    found = {voting.voxels[m]: weight for m, weight in zip(chosen[:n].tolist(), weights[:n].tolist(), strict=True)}
    ties = {v for v in voting.voxels if len(votes := voting.twin.votes[v]) == 2 and len(set(votes.values())) == 1}
    assert found.keys() - ties == voting.twin.won(number, least, share) - ties
    assert all(voting.twin.votes[voxel][number] == weight for voxel, weight in found.items())


@laws
@given(seed=seeds)
def test_classes_of_voxels_are_those_of_their_instances(seed: int) -> None:
    voting = Voting(seed)
    voxels = [*voting.voxels, (500, 500, 500)]
    class_of = np.zeros(BACKGROUND + 1, np.uint16)
    class_of[list(CLASS_OF)] = list(CLASS_OF.values())
    n = len(voxels)
    labels, weights, others = np.empty(n, np.uint16), np.empty(n, np.float32), np.empty(n, np.float32)
    kernels.classes_of(
        voting.store.fields["evidence"], voting.record_rows(voxels), class_of, labels, weights, others
    )  # fmt: skip
    expected = np.array([voting.twin.class_votes(voxel, CLASS_OF) for voxel in voxels], np.float64)
    assert np.array_equal(labels, expected[:, 0])
    assert weights * evidence.UNIT == pytest.approx(expected[:, 1])
    assert others * evidence.UNIT == pytest.approx(expected[:, 2])


@laws
@given(seed=seeds)
def test_fading_halves_votes_and_tells_what_is_empty(seed: int) -> None:
    voting = Voting(seed)
    rows = np.append(voting.record_rows(voting.voxels), -1)
    gone = voting.rng.random(len(rows)) < 0.3
    lost, empty = np.zeros(BACKGROUND + 1, np.bool_), np.empty(len(rows), np.bool_)
    kernels.fade(voting.store.fields["evidence"], rows, gone, voting.sizes, lost, 10, empty)
    for voxel, is_gone, is_empty in zip(voting.voxels, gone.tolist(), empty.tolist(), strict=False):
        halves = {n: c // 2 for n, c in voting.twin.votes[voxel].items() if c // 2}
        assert is_empty == (is_gone or sum(halves.values()) < 10)
        assert voting.held(voxel) == ({} if is_empty else halves)
        assert not is_empty or any(lost[n] for n in voting.twin.votes[voxel])
    leaders = np.empty(len(rows), np.int64)
    kernels.numbers_of(voting.store.fields["evidence"], rows, leaders)
    assert np.array_equal(voting.sizes[1:], np.bincount(leaders, minlength=BACKGROUND + 1)[1:])
