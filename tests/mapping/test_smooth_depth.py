"""Depth is smoothed along surfaces and never across their edges."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.kernels.images import MOST_SIGMA, noise_share, smooth_depth

BASE, GROWTH = 0.0012, 0.0019
PAIRS = (((0, -1), (0, 1)), ((-1, 0), (1, 0)), ((-1, -1), (1, 1)), ((-1, 1), (1, -1)))


def smoothed(depth: np.ndarray) -> np.ndarray:
    out = np.empty_like(depth)
    smooth_depth(depth, BASE, GROWTH, out)
    return out


def twin(depth: np.ndarray) -> np.ndarray:
    out = depth.astype(np.float64)
    for v in range(1, depth.shape[0] - 1):
        for u in range(1, depth.shape[1] - 1):
            z = float(depth[v, u])
            taken = [z]
            for (a, b), (c, d) in PAIRS:
                p, q = float(depth[v + a, u + b]), float(depth[v + c, u + d])
                if p > 0 and q > 0 and abs(0.5 * (p + q) - z) < MOST_SIGMA * (BASE + GROWTH * (z - 0.4) ** 2):
                    taken += [p, q]
            out[v, u] = np.mean(taken) if z > 0 else 0.0
    return out


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_the_kernel_equals_its_twin(seed):
    rng = np.random.default_rng(seed)
    depth = (rng.choice([0.0, 1.0, 2.5], (7, 9)) + 0.01 * rng.standard_normal((7, 9))).astype(np.float32)
    depth[depth < 0.5] = 0.0
    assert np.allclose(smoothed(depth), twin(depth), atol=1e-5)


def test_noise_falls_to_a_third_and_a_slant_stays():
    rng = np.random.default_rng(1)
    true = (2.0 + 0.004 * np.arange(200) + np.zeros((150, 1))).astype(np.float32)
    noisy = true + (0.005 * rng.standard_normal(true.shape)).astype(np.float32)
    error = (smoothed(noisy) - true)[1:-1, 1:-1]
    assert error.std() < 0.4 * 0.005
    assert abs(error.mean()) < 2e-4


def test_an_edge_stays_sharp():
    depth = np.where(np.arange(40) < 20, 1.0, 1.2).astype(np.float32) + np.zeros((30, 1), np.float32)
    assert np.allclose(smoothed(depth), depth, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(0, 10**6))
def test_how_noisy_an_image_is_shows_in_it_whatever_its_surfaces(share, seed):
    rng = np.random.default_rng(seed)
    true = 1.0 + rng.uniform(0.0, 0.01) * np.arange(320) + rng.uniform(0.0, 0.01) * np.arange(240)[:, None]
    true[60:160, 80:200] -= 0.3
    noise = share * (BASE + GROWTH * (true - 0.4) ** 2)
    depth = (true + noise * rng.standard_normal(true.shape)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0.0
    assert abs(noise_share(depth, BASE, GROWTH, 4) - share) < 0.1


def test_an_image_without_enough_pixels_is_as_noisy_as_its_sensor():
    assert noise_share(np.zeros((60, 80), np.float32), BASE, GROWTH, 4) == 1.0


def test_without_noise_a_small_step_in_depth_stays_sharp():
    depth = np.where(np.arange(120) < 60, 3.0, 3.05).astype(np.float32) + np.zeros((90, 1), np.float32)
    share = noise_share(depth, BASE, GROWTH, 6)
    out = np.empty_like(depth)
    smooth_depth(depth, share * BASE, share * GROWTH, out)
    assert np.abs(out - depth).max() < 1e-6
    assert np.abs(smoothed(depth) - depth).max() > 0.01
