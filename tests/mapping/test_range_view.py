"""Range images: coarse to fine says what voxel by voxel says, and that is what beams say where both know."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.geometry import SE3
from mapping.kernels import lidar as kernels
from mapping.kernels.occupancy import MISS
from mapping.kernels.visibility import FREE
from mapping.range_view import RangeView
from mapping.sensors import LidarModel
from tests import naive_lidar as naive
from tests.support.rooms import Room

EVEN = LidarModel.even(32, -0.4, 0.4, 256)
UNEVEN = LidarModel([0.5, 0.3, 0.25, 0.21, 0.2, 0.0, -0.05, -0.3, -0.31], 90, first_azimuth=0.7)
GAPPED = LidarModel([0.4, 0.38, 0.1, 0.05, -0.6], 64, widest_gap=0.08)
PLANAR = LidarModel([0.0], 180, first_azimuth=0.75 * np.pi, span=1.5 * np.pi)
HALF = LidarModel.even(16, -0.6, 0.2, 60, first_azimuth=0.4 * np.pi, span=0.9 * np.pi)
STEEP = LidarModel.even(24, -1.55, 1.5, 48)
models = st.sampled_from([EVEN, UNEVEN, GAPPED, PLANAR, HALF, STEEP])
OFF_BORDERS = SE3.exp([0.0123, 0.0231, 0.0312, 0.0041, 0.0013, 0.0027])
"""So that no voxel lies just between two beams, where rounding decides."""
poses = st.builds(
    lambda xi: SE3.exp(xi) @ OFF_BORDERS,
    st.tuples(*[st.floats(-0.5, 0.5)] * 3, *[st.floats(-0.6, 0.6)] * 2, st.floats(-3.1, 3.1)).map(list),
)
ROUGH = (0.05, 0.1, 0.25)


def ranges_of(model: LidarModel, pose: SE3, seed: int, roughness: float) -> np.ndarray:
    """What the model sees in the room, with gaps, things before the walls and openings into the open."""
    rays = model.rays().reshape(-1, 3).astype(np.float64) @ pose.rotation.T
    with np.errstate(over="ignore"):  # rays along a wall
        ranges = Room().cast(pose.translation, rays).reshape(model.shape)
    rng = np.random.default_rng(seed)
    for value in (0.0, 0.7, np.inf, np.nan, 30.0):
        ranges[rng.random(model.shape) < roughness] = value
    if rng.random() < 0.5:
        ranges[:, : model.columns // 3] = rng.choice([0.0, 1.0, np.inf])
    return ranges.astype(np.float32)


def blocks_around(pose: SE3, block_size: float, reach: float) -> np.ndarray:
    first = np.floor((pose.translation - reach) / block_size).astype(np.int32)
    n = int(np.ceil(2.0 * reach / block_size)) + 1
    return np.ascontiguousarray(np.argwhere(np.ones((n, n, n))) + first, dtype=np.int32)


def voxels_in(block: np.ndarray, local: np.ndarray) -> list[tuple[int, ...]]:
    ijk = np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1) + 8 * block.astype(int)
    return list(map(tuple, ijk.tolist()))


def mark(view: RangeView, blocks: np.ndarray, voxel_size: float) -> np.ndarray:
    marks = np.full((len(blocks), 512), 9, np.uint8)
    view.mark_free(np.ascontiguousarray(blocks), voxel_size, marks)
    return marks


@settings(max_examples=40, deadline=None)
@given(models, poses, st.integers(0, 1000), st.sampled_from(ROUGH), st.sampled_from([0.0, 0.005]))
def test_marks_agree_with_the_naive_twin(model, pose, seed, voxel_size, roughness):
    ranges = ranges_of(model, pose, seed, roughness)
    view = RangeView(ranges, model, pose, 5.0)
    rng = np.random.default_rng(seed)
    blocks = blocks_around(pose, 8 * voxel_size, 2.5)
    blocks = blocks[rng.integers(0, len(blocks), 12)]
    marks = mark(view, blocks, voxel_size)
    assert set(np.unique(marks)) <= {0, MISS}
    for n, block in enumerate(blocks):
        local = rng.integers(0, 512, 6)
        for voxel, marked in zip(voxels_in(block, local), marks[n, local], strict=True):
            free = naive.is_free(voxel, ranges, model, pose, 5.0, voxel_size)
            assert free is None or free == bool(marked), voxel


@settings(max_examples=30, deadline=None)
@given(models, poses, st.integers(0, 1000), st.sampled_from(ROUGH), st.sampled_from([0.0, 0.005]))
def test_no_block_is_wrongly_left_out_or_called_free(model, pose, seed, voxel_size, roughness):
    view = RangeView(ranges_of(model, pose, seed, roughness), model, pose, 5.0)
    blocks, kinds = view.blocks(8 * voxel_size, front_m=voxel_size, back_m=0.0, touch_m=voxel_size / 2, with_free=True)
    assert len(np.unique(blocks, axis=0)) == len(blocks)
    rng = np.random.default_rng(seed)
    everything = np.concatenate([blocks_around(pose, 8 * voxel_size, 5.6), blocks])
    everything = everything[rng.integers(0, len(everything), 500)]
    free_voxels = project_all(view, everything, voxel_size)  # voxel by voxel
    listed = {tuple(b): k for b, k in zip(blocks.tolist(), kinds.tolist(), strict=True)}
    hit = {tuple(v >> 3) for v in view.hits(voxel_size)}
    for block, voxels in zip(map(tuple, everything.tolist()), free_voxels, strict=True):
        kind = listed.get(block, 0)
        assert kind or not (voxels.any() or block in hit), block
        assert kind != FREE or (voxels.all() and block not in hit), block
    # Nor does what is done with octants of a block, but for rounding.
    assert (mark(view, everything, voxel_size) != free_voxels).mean() < 5e-4


def project_all(view: RangeView, blocks: np.ndarray, voxel_size: float) -> np.ndarray:
    """Which voxels (n, 512) the rule of `mark_free` calls free, each projected with `project_block`."""
    free = np.empty((len(blocks), 512), bool)
    pixels, r, aside = np.empty(512, np.int32), np.empty(512, np.float32), np.empty(512, np.float32)
    reach, clear = np.abs(view.reach).ravel(), view.clear.ravel()
    for n, block in enumerate(blocks):
        kernels.project_block(*block, voxel_size, view.lidar, view.row_of, view.off_row, pixels, r, aside)
        near = np.where(pixels >= 0, pixels, pixels - kernels.BESIDE)
        at = np.maximum(near, 0)
        passed = (near >= 0) & (r < reach[at]) & (aside < np.float32(0.25 * voxel_size**2))
        free[n] = passed | ((pixels >= 0) & (r + np.float32(0.87 * voxel_size) < clear[at]))
    return free
