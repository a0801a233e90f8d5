"""Evidence of labels from uncertain poses: as published, in closed form, and that both are the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.kernels import label_sums
from mapping.kernels import label_uncertainty as kernels
from mapping.label_uncertainty import (
    LabelEvidence,
    count_labels,
    noise_transforms,
    published_update,
    sample_labels,
    spread_labels,
)
from mapping.semantics import SemanticMap
from tests import naive_label_uncertainty as naive

VOXEL = 0.05
POSE = SE3.exp([0.3, -0.2, 0.6, 0.05, -0.1, 0.7])
DEVIATIONS = np.array([0.04, 0.05, 0.02, 0.01, 0.008, 0.03])
seeds = st.integers(0, 10_000)


def a_covariance(seed: int, size: float = 1.0) -> np.ndarray:
    """Correlated, of about the deviations above times `size`."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    mixed = turn @ np.diag(np.linspace(0.2, 1.6, 6)) @ turn.T
    return size**2 * mixed * np.outer(DEVIATIONS, DEVIATIONS)


def cloud(seed: int, n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points about the pose [m], class ids 0 … 3, weights."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    points = POSE.translation + rng.uniform(0.5, 3.0, (n, 1)) * directions / np.linalg.norm(directions, axis=1)[:, None]
    return points, rng.integers(0, 4, n).astype(np.uint16), rng.uniform(0.1, 2.0, n)


def wall(n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """A wall and a thing before it, dense enough to fill voxels."""
    y, z = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.6, 0.6, n), np.linspace(0.1, 1.1, n)))
    points = np.stack([np.full_like(y, 2.013), y, z], axis=1)
    thing = (np.abs(y) < 0.2) & (z < 0.5)
    points[thing, 0] = 1.61
    return points, np.where(thing, 7, 2).astype(np.uint16)


# -- direct projection ---------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(seed=seeds)
def test_counting_matches_the_naive_twin(seed: int) -> None:
    points, labels, weights = cloud(seed)
    found = naive.as_tally(count_labels(points, labels, 0.4, weights=weights))
    expected = naive.tally(points, labels, weights, 0.4)
    assert found.keys() == expected.keys()
    assert all(found[key] == pytest.approx(value) for key, value in expected.items())


def test_more_voxels_than_there_was_room_for_are_counted_too() -> None:
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (40_000, 3))
    labels = (np.arange(40_000) % 3 + 1).astype(np.uint16)
    counted = count_labels(points, labels, 0.1)
    assert naive.as_tally(counted) == naive.tally(points, labels, np.ones(40_000), 0.1)


@settings(max_examples=25)
@given(seed=seeds)
def test_a_certain_pose_is_direct_projection(seed: int) -> None:
    points, labels, weights = cloud(seed)
    found = naive.as_tally(spread_labels(points, labels, POSE, np.zeros((6, 6)), VOXEL, weights=weights))
    expected = naive.as_tally(count_labels(points, labels, VOXEL, weights=weights))
    assert found.keys() == expected.keys()
    assert all(found[key] == pytest.approx(value, rel=1e-6) for key, value in expected.items())


# -- the spread ------------------------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(seed=seeds, size=st.floats(0.0, 3.0))
def test_the_mass_of_each_class_is_kept(seed: int, size: float) -> None:
    points, labels, weights = cloud(seed)
    spread = spread_labels(points, labels, POSE, a_covariance(seed, size), VOXEL, weights=weights)
    assert spread.left_out == 0.0
    for label in (1, 2, 3):
        assert spread.evidence[spread.labels == label].sum() == pytest.approx(weights[labels == label].sum(), rel=1e-5)
    assert (spread.evidence > 0.0).all()
    assert len(np.unique(np.c_[spread.ijk, spread.labels], axis=0)) == len(spread)


@settings(max_examples=25)
@given(seed=seeds)
def test_a_shift_along_the_axes_is_the_product_of_three_gaussians(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sd = rng.uniform(0.2, 2.0, 3) * VOXEL
    point = rng.uniform(-1.0, 1.0, 3)
    spread = spread_labels(point[None], [1], SE3.identity(), np.diag([*sd**2, 0, 0, 0]), VOXEL)
    expected = {
        (*ijk, 1): np.prod(
            [
                naive.mass_between(i * VOXEL, (i + 1) * VOXEL, x, s, kernels.REACH)
                for i, x, s in zip(ijk, point, sd, strict=True)
            ]
        )
        for ijk in spread.ijk.tolist()
    }
    assert naive.distance(naive.as_tally(spread), expected) < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_it_is_what_very_many_correlated_poses_tend_to(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigma = a_covariance(seed)
    root = np.linalg.cholesky(sigma)
    point = POSE @ rng.uniform(-1.5, 1.5, 3)
    places = naive.moved(point, POSE, root, rng.normal(size=(20_000, 6)))
    sampled = naive.tally(places, np.ones(len(places), int), np.full(len(places), 1.0 / len(places)), VOXEL)
    spread = naive.as_tally(spread_labels(point[None], [1], POSE, sigma, VOXEL))
    # 20 000 samples over V voxels are off by about √(V/(2π·20 000)) themselves
    assert naive.distance(sampled, spread) < 0.035 + np.sqrt(len(sampled) / (2 * np.pi * len(places)))


@pytest.mark.parametrize("seed", range(4))
def test_mean_and_covariance_are_those_of_the_point(seed: int) -> None:
    sigma = a_covariance(seed, 1.5)
    p_sensor = np.random.default_rng(seed).uniform(-2.0, 2.0, 3)
    R = POSE.rotation
    J = R @ np.column_stack([np.eye(3), *(np.cross(e, p_sensor) for e in np.eye(3))])
    spread = spread_labels((POSE @ p_sensor)[None], [1], POSE, sigma, 0.02)
    mean = spread.evidence @ spread.centres
    off = spread.centres - mean
    around = (off.T * spread.evidence) @ off - np.eye(3) * 0.02**2 / 12.0
    cut = 0.9733  # variance of a Gaussian cut off at 3 standard deviations
    assert np.allclose(mean, POSE @ p_sensor, atol=0.01)
    assert np.allclose(around, cut * J @ sigma @ J.T, atol=0.06 * np.trace(J @ sigma @ J.T))


@settings(max_examples=15)
@given(seed=seeds, size=st.floats(0.3, 4.0))
def test_merging_keeps_evidence_mean_and_covariance_of_each_class(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4.0, 4.0, (300, 3))
    labels, weights = rng.integers(1, 4, 300).astype(np.uint16), rng.uniform(0.1, 2.0, 300)
    twists = np.zeros((6, 6))
    twists[:3, :3] = size * np.eye(3)
    ijk, classes, sums, squares = label_sums.sum_labels(points, labels, weights, np.eye(4)[None, :3].copy(), True)
    merged, mean, evidence, around = kernels.merge_sources(ijk, classes, sums, squares, np.zeros(3), twists)
    assert len(merged) <= len(classes)
    assert size < 2.0 or len(merged) < 0.3 * len(classes)
    for label in (1, 2, 3):
        these, mine = labels == label, merged == label
        middle = weights[these] @ points[these] / weights[these].sum()
        assert evidence[mine].sum() == pytest.approx(weights[these].sum())
        assert evidence[mine] @ mean[mine] / evidence[mine].sum() == pytest.approx(middle, abs=1e-9)
        off, apart = points[these] - middle, mean[mine] - middle
        expected = (off.T * weights[these]) @ off
        assert np.allclose((apart.T * evidence[mine]) @ apart + np.tensordot(evidence[mine], around[mine], 1), expected)


def test_points_close_together_are_spread_as_each_by_itself() -> None:
    points, labels = wall(120)
    sigma = np.diag([0.03, 0.03, 0.01, 0.002, 0.002, 0.015]) ** 2
    for size in (0.3, 1.0, 2.0):
        together = naive.as_tally(spread_labels(points, labels, POSE, size**2 * sigma, VOXEL))
        seen = sample_labels(points, labels, POSE, size**2 * sigma, VOXEL, n_samples=1000, seed=0)
        assert naive.distance(naive.as_tally(seen), together) < 0.04


@settings(max_examples=15)
@given(seed=seeds)
def test_relabelling_the_classes_permutes_the_evidence(seed: int) -> None:
    points, labels, weights = cloud(seed)
    other = np.array([0, 9, 400, 5], np.uint16)
    sigma = a_covariance(seed)
    one = naive.as_tally(spread_labels(points, labels, POSE, sigma, VOXEL, weights=weights))
    two = naive.as_tally(spread_labels(points, other[labels], POSE, sigma, VOXEL, weights=weights))
    assert {(*key[:3], int(other[key[3]])): value for key, value in one.items()} == pytest.approx(two)


@settings(max_examples=15)
@given(seed=seeds, quarters=st.integers(1, 3), axis=st.integers(0, 2))
def test_a_turned_world_gives_turned_evidence(seed: int, quarters: int, axis: int) -> None:
    """By quarter turns, so that voxels are voxels again; only the rounding of the table is in between."""
    points, labels, weights = cloud(seed)
    twist = np.zeros(6)
    twist[3 + axis] = quarters * np.pi / 2
    turn = SE3(np.rint(SE3.exp(twist).rotation), np.zeros(3))
    sigma = a_covariance(seed)
    still = spread_labels(points, labels, POSE, sigma, VOXEL, weights=weights)
    turned = spread_labels(points @ turn.rotation.T, labels, turn @ POSE, sigma, VOXEL, weights=weights)
    back = np.floor((turned.centres @ turn.rotation) / VOXEL).astype(int)
    again = LabelEvidence(VOXEL, back, turned.labels, turned.evidence)
    assert naive.distance(naive.as_tally(still), naive.as_tally(again)) < 0.03


@settings(max_examples=15)
@given(seed=seeds, shift=st.tuples(*(st.integers(-100_000, 100_000),) * 3))
def test_a_world_moved_by_whole_voxels_gives_moved_evidence(seed: int, shift: tuple[int, int, int]) -> None:
    points, labels, weights = cloud(seed)
    sigma = a_covariance(seed)
    still = naive.as_tally(spread_labels(points, labels, POSE, sigma, 0.0625, weights=weights))
    by = np.array(shift) * 0.0625
    moved = spread_labels(points + by, labels, SE3(np.eye(3), by) @ POSE, sigma, 0.0625, weights=weights)
    again = LabelEvidence(0.0625, moved.ijk - shift, moved.labels, moved.evidence)
    assert naive.distance(still, naive.as_tally(again)) < 1e-3


def test_classes_larger_than_a_tile_are_one_all_the_same() -> None:
    along = np.arange(0.0, 20.0, 0.02)
    points = np.stack([along, 0.3 * along, np.full_like(along, 0.11)], axis=1)
    labels = np.full(len(along), 3, np.uint16)
    spread = spread_labels(points, labels, SE3.identity(), np.diag([0.002, 0.002, 0.0004, 0, 0, 1e-5]), VOXEL)
    assert spread.evidence.sum() == pytest.approx(len(along), rel=1e-5)
    assert len(np.unique(spread.ijk, axis=0)) == len(spread)


def test_points_that_are_too_uncertain_are_left_out_and_counted() -> None:
    points, labels = np.array([[1.0, 0.0, 0.0], [60.0, 0.0, 0.0]]), np.array([1, 2], np.uint16)
    spread = spread_labels(points, labels, SE3.identity(), np.diag([0, 0, 0, 0, 0, 0.02**2]), VOXEL, weights=[2.0, 3.0])
    assert spread.left_out == 3.0
    assert set(spread.labels.tolist()) == {1}
    assert spread.evidence.sum() == pytest.approx(2.0)
    alone = spread_labels(points[1:], labels[1:], SE3.identity(), np.diag([0, 0, 0, 0, 0, 0.02**2]), VOXEL)
    assert len(alone) == 0
    assert alone.left_out == 1.0


def test_voxels_with_little_evidence_are_left_out_when_asked_for() -> None:
    points, labels = wall()
    sigma = a_covariance(1)
    every, some = (spread_labels(points, labels, POSE, sigma, VOXEL, least=least) for least in (0.0, 0.05))
    kept = every.evidence > np.float32(0.05)
    assert len(some) < 0.8 * len(every)
    assert naive.as_tally(some) == {key: value for key, value in naive.as_tally(every).items() if value > 0.05}
    assert kept.sum() == len(some)
    assert some.left_out + some.evidence.sum() == pytest.approx(len(points), rel=1e-5)
    assert some.left_out < 0.02 * len(points)


def test_equal_calls_give_equal_evidence_in_equal_order() -> None:
    points, labels = wall()
    one, two = (spread_labels(points, labels, POSE, a_covariance(1), VOXEL) for _ in range(2))
    assert np.array_equal(one.ijk, two.ijk)
    assert np.array_equal(one.evidence, two.evidence)


def test_no_points_are_no_evidence() -> None:
    none = spread_labels(np.empty((0, 3)), np.empty(0, np.uint16), POSE, np.eye(6), VOXEL)
    assert len(none) == 0
    assert len(count_labels(np.ones((2, 3)), np.zeros(2, np.uint16), VOXEL)) == 0
    assert len(LabelEvidence.none(VOXEL).leaders()[0]) == 0


def hashed(ijk: np.ndarray) -> np.ndarray:
    """One number (n,) for each voxel (n, 3)."""
    return ijk.astype(np.int64) @ np.array([1 << 40, 1 << 20, 1])


def test_a_layer_of_votes_takes_the_evidence() -> None:
    points, labels = wall()
    spread = spread_labels(points, labels, SE3.identity(), np.diag([1e-3, 1e-3, 1e-4, 0, 0, 1e-4]), VOXEL)
    semantics = SemanticMap(voxel_size_m=VOXEL, memory=250.0, least=0.0)
    semantics.integrate(spread.centres, spread.labels, spread.evidence)
    voxels, leaders, share = spread.leaders()
    found, confidence = semantics.query((voxels + 0.5) * VOXEL)
    belief = semantics.belief((voxels + 0.5) * VOXEL)
    told = np.where(np.isnan(belief.other), 0.0, belief.probability[:, 0]) > 0.0
    untold = ~np.isin(hashed(spread.ijk), hashed(voxels[told]))
    assert spread.evidence[untold].max() < 0.5 / 256, "only less than a layer counts is lost"
    clear = told & (share > 0.51)
    assert clear.mean() > 0.5
    assert np.array_equal(found[clear], leaders[clear])
    assert np.quantile(np.abs(confidence[clear] - share[clear]), 0.9) < 0.02


def test_of_equal_classes_the_lowest_leads() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.02, 0.01, 0.01], [0.2, 0.0, 0.0]])
    voxels, labels, share = count_labels(points, [8, 5, 9], VOXEL).leaders()
    assert voxels.tolist() == [[0, 0, 0], [4, 0, 0]]
    assert labels.tolist() == [5, 9]
    assert share.tolist() == [0.5, 1.0]


# -- as published ----------------------------------------------------------------------------------------------------


def test_noise_is_drawn_from_the_diagonal_alone() -> None:
    sigma = a_covariance(3)
    one, two = noise_transforms(sigma, 50, 5), noise_transforms(np.diag(np.diag(sigma)), 50, 5)
    assert np.array_equal(one, two)
    drawn = np.random.default_rng(5).normal(size=(50, 6)) * np.sqrt(np.diag(sigma))
    for T, (x, y, z, roll, pitch, yaw) in zip(one, drawn, strict=True):
        assert np.allclose(T[:3, 3], (x, y, z))
        assert np.allclose(T[:3, :3], naive.rotation(roll, pitch, yaw))


@settings(max_examples=15)
@given(seed=seeds, keep=st.sampled_from([0.0, 0.3, 0.8, 1.0]))
def test_the_update_is_equation_5_to_the_letter(seed: int, keep: float) -> None:
    points, labels, weights = cloud(seed, 30)
    T_map_odom, T_odom_base = SE3.exp([0.5, 0.2, 0, 0, 0, 0.4]), SE3.exp([1.0, -0.7, 0, 0, 0, -1.1])
    T_base_sensor = SE3.exp([0.1, 0, 0.9, 0, 0.3, 0])
    before = count_labels(points + 0.3, labels, 0.2, weights=weights)
    after = published_update(
        before,
        points,
        labels,
        T_map_odom=T_map_odom,
        T_odom_base=T_odom_base,
        T_base_sensor=T_base_sensor,
        covariance=a_covariance(seed),
        keep=keep,
        n_samples=6,
        seed=seed,
        probabilities=weights,
    )
    clouds = []
    for noise in noise_transforms(a_covariance(seed), 6, seed):
        noisy = T_map_odom @ SE3.from_matrix(noise) @ T_odom_base @ T_base_sensor
        clouds.append(naive.tally(noisy @ points, labels, weights, 0.2))
    assert naive.as_tally(after) == pytest.approx(naive.blended(naive.as_tally(before), clouds, keep))


def test_the_published_blend_depends_on_the_order_of_perceptions() -> None:
    points, labels = wall()
    frames = {"T_map_odom": SE3.identity(), "T_odom_base": SE3.identity(), "T_base_sensor": SE3.identity()}
    settings_ = {**frames, "covariance": np.zeros((6, 6)), "keep": 0.5, "n_samples": 1, "seed": 0}
    other = np.where(labels == 7, 3, labels).astype(np.uint16)
    results = []
    for order in ((labels, other), (other, labels)):
        belief = LabelEvidence.none(VOXEL)
        for seen in order:
            belief = published_update(belief, points, seen, **settings_)
        results.append(naive.as_tally(belief))
    assert results[0] != results[1]


def test_the_mean_of_n_samples_tends_to_the_spread_like_one_over_root_n() -> None:
    points, labels = wall()
    cells = count_labels(points, labels, VOXEL)
    sigma = np.diag([0.03, 0.03, 0.01, 0.002, 0.002, 0.015]) ** 2
    spread = naive.as_tally(spread_labels(cells.centres, cells.labels, POSE, sigma, VOXEL, weights=cells.evidence))
    off = []
    for n in (10, 100, 1000):
        seen = [
            sample_labels(
                cells.centres, cells.labels, POSE, sigma, VOXEL, n_samples=n, seed=seed, weights=cells.evidence
            )
            for seed in range(4)
        ]
        off.append(np.mean([naive.distance(naive.as_tally(one), spread) for one in seen]))
    assert off[0] / off[1] == pytest.approx(np.sqrt(10), rel=0.3)
    assert off[1] / off[2] == pytest.approx(np.sqrt(10), rel=0.4)
    assert off[2] < 0.04


# -- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"p_map": np.zeros((3, 2))}, "p_map"),
        ({"p_map": np.full((3, 3), np.nan)}, "p_map"),
        ({"p_map": np.array([[0.0, 0, 0], [1e6, 0, 0], [0, 0, 0]])}, "p_map"),
        ({"labels": np.zeros(2, np.uint16)}, "labels"),
        ({"labels": np.array([1, 2, 70_000])}, "labels"),
        ({"labels": np.array([1.0, 2.0, 3.0])}, "labels"),
        ({"weights": np.array([1.0, -1.0, 1.0])}, "weights"),
        ({"voxel_size_m": 0.0}, "voxel_size_m"),
        ({"least": -1.0}, "least"),
        ({"covariance": np.eye(5)}, "covariance"),
        ({"covariance": -np.eye(6)}, "covariance"),
        ({"covariance": np.triu(np.ones((6, 6)))}, "covariance"),
        ({"T_map_sensor": np.eye(3)}, "pose"),
    ],
)
def test_what_cannot_be_is_refused_by_name(changed: dict[str, object], named: str) -> None:
    given_: dict[str, object] = {
        "p_map": np.zeros((3, 3)),
        "labels": np.array([1, 2, 3], np.uint16),
        "T_map_sensor": POSE,
        "covariance": np.eye(6) * 1e-4,
        "voxel_size_m": VOXEL,
    }
    with pytest.raises(InvalidParameter, match=named):
        spread_labels(**{**given_, **changed})


def test_blending_wants_a_share() -> None:
    with pytest.raises(InvalidParameter, match="keep"):
        published_update(
            LabelEvidence.none(VOXEL), np.zeros((1, 3)), [1], T_map_odom=POSE, T_odom_base=POSE, T_base_sensor=POSE,
            covariance=np.eye(6), keep=1.5, n_samples=3, seed=0,
        )  # fmt: skip
    with pytest.raises(InvalidParameter, match="n_samples"):
        noise_transforms(np.eye(6), 0, 0)
