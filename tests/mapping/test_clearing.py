"""What has gone is forgotten; what is there stays, however noisy depth and poses are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.clearing import TURNS, seen_through
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import ijk_to_centre, point_to_ijk
from mapping.kernels import clearing as kernels
from mapping.layered import LayeredMap
from mapping.occupancy import OccupancyMap
from mapping.packed import PackedStore
from mapping.view import DepthView
from tests.naive_clearing import is_seen_through
from tests.support.scenes import Block, Scene, looking_at, shell, table

FINE = 0.025
TINY = CameraIntrinsics(fx=20.0, fy=20.0, cx=15.5, cy=11.5, width=32, height=24)
POSE_SIGMA = np.repeat([0.01, np.deg2rad(0.5)], 3)


class Stage:
    """A map of a scene whose things can be taken away."""

    def __init__(self, *blocks: Block, noisy: bool = False) -> None:
        self.scene = Scene(blocks)
        self.blocks = list(blocks)
        self.map = LayeredMap(voxel_size_m=0.05, instance_voxel_size_m=FINE, max_range_m=6.0, label_range_m=5.0)
        self.things = np.zeros(1 << 16, bool)
        self.things[[self.scene.id_of(block.label) for block in blocks if block.thing]] = True
        self.rng = np.random.default_rng(0)
        self.noisy = noisy
        self.now = 0

    def look(self, eye: tuple[float, float, float], target: tuple[float, float, float], corrected: bool = True) -> None:
        self.now += 1
        pose = looking_at(eye, target)
        image = Scene(tuple(self.blocks)).image(pose, self.now)
        names = [0, *(self.scene.id_of(label) for label in Scene(tuple(self.blocks)).classes)]
        update = {"labels": np.array(names, np.uint16)[image.labels]}
        if self.noisy:
            depth = image.depth
            noise = (0.0012 + 0.0019 * (depth - 0.4) ** 2) * self.rng.normal(size=depth.shape)
            update["depth"] = np.where(depth > 0.0, depth + noise, 0.0).astype(np.float32)
            pose = pose @ SE3.exp(POSE_SIGMA * self.rng.normal(size=6))
            if corrected:
                update["covariance"] = np.diag(POSE_SIGMA**2)
        self.map.integrate_image(image.model_copy(update=update), pose, self.things)

    def voxels_of(self, block: Block) -> int:
        """Voxels on a block's surface that hold its class, from a voxel of the occupancy above what it stands on."""
        store = self.map.semantics.store
        points = ijk_to_centre(store.ijk(store.cells()), FINE)
        near = (np.abs(outside(points, block)) < 1.2 * FINE) & (
            points[:, 2] > block.center[2] - 0.5 * block.size[2] + 0.06
        )
        return int((self.map.semantics.query(points[near])[0] == self.scene.id_of(block.label)).sum())

    def instance_voxels(self, label: str) -> int:
        known = self.map.instances.instances.values()
        return sum(len(self.map.instances.points(i.id)[0]) for i in known if i.label == self.scene.id_of(label))


def outside(points: np.ndarray, block: Block) -> np.ndarray:
    """Signed distance (N,) [m] from points to a block's surface, positive outside."""
    turn = SE3.exp([0, 0, 0, 0, 0, block.yaw]).rotation
    q = np.abs((points - block.center) @ turn) - 0.5 * np.array(block.size)
    return np.where(q.max(axis=1) > 0.0, np.linalg.norm(np.maximum(q, 0.0), axis=1), q.max(axis=1))


# -- the kernel ----------------------------------------------------------------------------------------------
@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1), around=st.integers(0, 4), margin=st.floats(0.0, 0.3), share=st.floats(0.0, 0.1),
    twist=st.tuples(*(st.floats(-1.0, 1.0),) * 6),
)  # fmt: skip
def test_the_kernel_matches_the_naive_reference(seed, around, margin, share, twist):
    rng = np.random.default_rng(seed)
    store = PackedStore({"value": ("u1", 1)}, 0.1)
    ijk = np.unique(rng.integers(-20, 20, (150, 3)), axis=0)
    store.allocate(ijk >> 3)
    store.add(store.cells_of(ijk))
    pose = SE3.exp(twist)
    depth = rng.uniform(0.2, 3.0, (TINY.height, TINY.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0.0
    depth = np.kron(depth[::8, ::8], np.ones((8, 8), np.float32))  # so that neighbours often agree
    view = DepthView(depth, TINY, pose, 100.0)
    slots = np.arange(store.n_blocks)[rng.random(store.n_blocks) < 0.8]
    cells = kernels.list_seen_through(
        store.masks, store.block_ijk, slots, 0.1, view.reach, view.camera, margin, share, around
    )
    inside = np.isin(store.find(ijk >> 3), slots)
    expected = {
        tuple(voxel)
        for voxel in ijk[inside].tolist()
        if is_seen_through(ijk_to_centre(voxel, 0.1), depth.astype(np.float64), TINY, pose, margin, share, around)
    }
    assert len(cells) == len(set(cells.tolist()))
    assert {tuple(v) for v in store.ijk(cells).tolist()} == expected


def test_any_images_that_follow_each_other_look_at_every_block_once():
    """A cloud of voxels in free space, over blocks enough for all turns: each is named in one turn of TURNS."""
    store = PackedStore({"value": ("u1", 1)}, FINE)
    voxels = np.unique(
        point_to_ijk(np.random.default_rng(0).uniform((0.7, -0.2, -0.2), (1.5, 0.2, 0.2), (400, 3)), FINE), axis=0
    )
    store.allocate(voxels >> 3)
    store.add(store.cells_of(voxels))
    occupancy = OccupancyMap(voxel_size_m=0.05)
    view = DepthView(np.full((24, 32), 2.5, np.float32), TINY, looking_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), 5.0)
    occupancy.integrate_view(view)
    for first in (0, 7):
        named = [seen_through(view, store, occupancy, turn=turn)[0] for turn in range(first, first + TURNS)]
        assert all(len(found) for found in named)
        together = np.concatenate(named)
        assert {tuple(v) for v in together.tolist()} == {tuple(v) for v in voxels.tolist()}
        assert len(together) == len(voxels)
    assert not len(seen_through(view, store, OccupancyMap(voxel_size_m=0.05))[0]), "what is unknown is not free"


def test_a_voxel_is_surely_gone_when_occupancy_cannot_be_surer():
    store = PackedStore({"value": ("u1", 1)}, FINE)
    voxel = point_to_ijk([[1.01, 0.01, 0.01]], FINE)
    store.allocate(voxel >> 3)
    store.add(store.cells_of(voxel))
    occupancy = OccupancyMap(voxel_size_m=0.05)
    for _ in range(6):
        occupancy.integrate([[1.01, 0.01, 0.01]], SE3.identity())
    view = DepthView(np.full((24, 32), 2.5, np.float32), TINY, looking_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), 5.0)
    told = []
    for _ in range(25):
        occupancy.integrate_view(view)
        voxels, sure = (
            np.concatenate(found)
            for found in zip(*(seen_through(view, store, occupancy, turn=t) for t in range(TURNS)), strict=True)
        )
        assert len(voxels) == len(sure) <= 1
        told.append("there" if not len(voxels) else "gone" if sure[0] else "fading")
    assert told == sorted(told, key=["there", "fading", "gone"].index)
    assert set(told) == {"there", "fading", "gone"}


# -- maps ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("noisy", [False, True])
def test_a_thing_taken_away_is_forgotten_and_what_stands_about_it_is_not(noisy: bool) -> None:
    crate = Block("crate", (0.3, 0.0, 0.25), (0.4, 0.4, 0.5), 1, 0.3)
    vase = Block("vase", (0.3, 0.42, 0.2), (0.2, 0.2, 0.4), 2)
    shelf = Block("shelf", (-1.0, 0.0, 0.6), (0.3, 1.0, 1.2), 3)
    stage = Stage(*shell((-2.0, -2.5), (2.0, 2.5)), crate, vase, shelf, noisy=noisy)

    def around(n: int, reach: float) -> None:
        for k in range(n):
            angle = reach * np.sin(2.0 * np.pi * k / n)
            stage.look((0.3 + 1.5 * np.cos(angle), 1.5 * np.sin(angle), 1.2), (0.1, 0.0, 0.3))

    around(24, np.pi)
    before = {block.label: stage.voxels_of(block) for block in (crate, vase, shelf)}
    assert stage.instance_voxels("crate") > 500
    stage.blocks.remove(crate)
    around(30, 1.5)
    assert stage.voxels_of(crate) < 0.04 * before["crate"]
    assert stage.instance_voxels("crate") == 0
    assert stage.scene.id_of("crate") not in {i.label for i in stage.map.instances.instances.values()}
    assert stage.voxels_of(vase) > 0.97 * before["vase"]
    assert stage.voxels_of(shelf) > 0.97 * before["shelf"]


@pytest.mark.parametrize(("corrected", "most", "of_structure"), [(True, 0.002, 0.0), (False, 0.01, 0.005)])
def test_what_is_there_does_not_fade_under_noise(
    monkeypatch, corrected: bool, most: float, of_structure: float
) -> None:
    """Depth and poses err as those of a real camera; walls, furniture and a book on a table stay where they are.

    Poses come with a covariance, so that the map corrects them, or without one, half a degree off each.
    """
    blocks = (
        *shell((-2.0, -2.5), (2.0, 2.5)), *table(0.5, 0.5, 1),
        Block("book", (0.5, 0.4, 0.77), (0.2, 0.15, 0.06), 2, 0.3),
        Block("shelf", (-1.7, 0.3, 0.9), (0.4, 0.8, 1.8), 3), Block("picture", (1.985, 0.5, 1.5), (0.03, 0.6, 0.4), 4),
    )  # fmt: skip
    stage = Stage(*blocks, noisy=True)
    named: list[np.ndarray] = []

    def watching(*args: object, **how: int) -> tuple[np.ndarray, np.ndarray]:
        voxels, sure = seen_through(*args, **how)  # type: ignore[arg-type]
        named.append(voxels)
        return voxels, sure

    monkeypatch.setattr("mapping.clearing.seen_through", watching)
    for n in range(40):
        a = 2.0 * np.pi * n / 40
        stage.look(
            (1.2 * np.cos(a) - 0.3, 1.6 * np.sin(a), 1.3 + 0.2 * np.sin(3.0 * a)),
            (0.9 * np.cos(a + 2.5), 0.9 * np.sin(a + 2.5), 0.7), corrected,
        )  # fmt: skip
    voxels = np.unique(np.concatenate(named), axis=0)
    centres = ijk_to_centre(voxels, FINE)
    near = {block: np.abs(outside(centres, block)) < FINE for block in blocks}
    structure = np.any([there for block, there in near.items() if not block.thing], axis=0)
    n_records = stage.map.semantics.store.n_records
    assert structure.sum() <= of_structure * n_records
    assert np.any(list(near.values()), axis=0).sum() <= most * n_records
    known = {instance.label for instance in stage.map.instances.instances.values()}
    assert known >= {stage.scene.id_of(block.label) for block in blocks if block.thing}


def test_a_map_that_is_saved_while_something_fades_goes_on_the_same() -> None:
    crate = Block("crate", (0.3, 0.0, 0.25), (0.4, 0.4, 0.5), 1)
    stage = Stage(*shell((-2.0, -2.5), (2.0, 2.5)), crate)
    twin = Stage(*stage.blocks)

    def look(at: Stage, n: int) -> None:
        for k in range(n):
            at.look((0.3 + 1.5 * np.cos(0.2 * k), 1.5 * np.sin(0.2 * k), 1.2), (0.1, 0.0, 0.3))

    look(stage, 8)
    stage.blocks.remove(crate)
    look(stage, 7)
    twin.map.restore(stage.map.state())
    twin.blocks, twin.now = stage.blocks, stage.now
    look(stage, 12)
    look(twin, 12)
    assert stage.instance_voxels("crate") == twin.instance_voxels("crate") == 0
    ours, theirs = stage.map.state()["clearing"], twin.map.state()["clearing"]
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)
