"""What semantic voxels promise: order does not matter, maps add, and what is not counted is bounded."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import point_to_ijk
from mapping.kernels import evidence as kernels
from mapping.semantics import SemanticMap
from tests.naive_evidence import Counters, Ledger, posterior

VOXEL = 0.1
labelled = st.lists(
    st.tuples(st.integers(-2, 2), st.integers(0, 9), st.integers(0, 700)),
    min_size=1,
    max_size=60,
)


def unpack(rows: list[tuple[int, int, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in a row of five voxels, labels, and weights of whole units."""
    table = np.array(rows)
    points = np.stack([(table[:, 0] + 0.5) * VOXEL, np.full(len(rows), 0.05), np.full(len(rows), -0.05)], axis=1)
    return points, table[:, 1].astype(np.uint16), table[:, 2] / kernels.UNIT


def mapped(points: np.ndarray, labels: np.ndarray, weights: np.ndarray, **parameters) -> SemanticMap:
    semantics = SemanticMap(voxel_size_m=VOXEL, memory=250.0, **parameters)
    semantics.integrate(points, labels, weights)
    return semantics


def held(semantics: SemanticMap) -> dict[tuple[int, ...], tuple[dict[int, int], int]]:
    """Voxel → (class → units, other)."""
    cells = semantics.store.cells()
    records, k = semantics.store.fields["evidence"][semantics.store.rows(cells)].tolist(), semantics.kept
    return {
        tuple(voxel): ({c: n for c, n in zip(r[:k], r[k : 2 * k], strict=True) if n}, r[2 * k])
        for voxel, r in zip(semantics.store.ijk(cells).tolist(), records, strict=True)
    }


# -- sums ----------------------------------------------------------------------------------------------------------


@settings(max_examples=80, deadline=None)
@given(labelled, st.integers(0, 99))
def test_with_all_classes_kept_nothing_is_lost_whatever_the_order(rows, seed) -> None:
    points, labels, weights = unpack(rows)
    order = np.random.default_rng(seed).permutation(len(points))
    one = held(mapped(points, labels, weights, kept=9))
    ledger = Ledger(VOXEL)
    ledger.give(points, labels, weights)
    assert one == {voxel: (dict(counts), 0) for voxel, counts in ledger.given.items()}
    assert held(mapped(points[order], labels[order], weights[order], kept=9)) == one


@settings(max_examples=80, deadline=None)
@given(labelled, labelled)
def test_with_all_classes_kept_the_evidence_of_two_maps_adds(rows, more) -> None:
    one, two = mapped(*unpack(rows), kept=9), mapped(*unpack(more), kept=9)
    both = mapped(*unpack(rows + more), kept=9)
    one.merge(two)
    assert held(one) == held(both)


@settings(max_examples=150, deadline=None)
@given(labelled, labelled, st.integers(1, 4), st.integers(0, 99))
def test_with_few_kept_any_order_and_any_merge_stay_within_the_bound(rows, more, kept, seed) -> None:
    points, labels, weights = unpack(rows + more)
    order = np.random.default_rng(seed).permutation(len(points))
    merged = mapped(*unpack(rows), kept=kept)
    merged.merge(mapped(*unpack(more), kept=kept))
    ledger = Ledger(VOXEL)
    ledger.give(points, labels, weights)
    for semantics in (mapped(points[order], labels[order], weights[order], kept=kept), merged):
        for voxel, (counts, other) in held(semantics).items():
            true = ledger.given[voxel]
            assert sum(counts.values()) + other == sum(true.values())
            for label, units in true.items():
                assert 0 <= units - counts.get(label, 0) <= other / (kept + 1)
            centre = (np.array([voxel]) + 0.5) * VOXEL
            belief = semantics.belief(centre)
            lost = other / (kept + 1) / sum(true.values())
            assert belief.bound[0] == pytest.approx(lost, abs=1e-6)
            leader, share = max(true.values()), sum(true.values())
            assert belief.probability[0, 0] >= leader / share - lost - 1e-6


@settings(max_examples=100, deadline=None)
@given(labelled, st.integers(1, 4))
def test_the_counters_are_those_of_the_book(rows, kept) -> None:
    points, labels, weights = unpack(rows)
    book: dict[tuple[int, ...], Counters] = {}
    for point, label, weight in zip(points, labels, weights, strict=True):
        if label and weight:
            voxel = tuple(point_to_ijk(point[None], VOXEL)[0].tolist())
            book.setdefault(voxel, Counters(kept)).give(int(label), round(weight * kernels.UNIT))
    assert held(mapped(points, labels, weights, kept=kept)) == {v: (c.counts, c.other) for v, c in book.items()}


@settings(max_examples=50, deadline=None)
@given(labelled, st.permutations(range(1, 10)))
def test_relabelling_permutes_the_map(rows, new) -> None:
    points, labels, weights = unpack(rows)
    table = np.array([0, *new], np.uint16)
    one = mapped(points, labels, weights)
    one.relabel(table)
    assert held(one) == held(mapped(points, table[labels], weights))


def test_classes_that_become_one_add_up() -> None:
    semantics = mapped(np.full((3, 3), 0.05), np.array([1, 2, 3]), np.array([1.0, 2.0, 4.0]))
    semantics.relabel([0, 7, 8, 7])
    assert held(semantics) == {(0, 0, 0): ({7: 5 * kernels.UNIT, 8: 2 * kernels.UNIT}, 0)}
    with pytest.raises(InvalidParameter, match="new_ids"):
        semantics.relabel([4, 5])


def test_a_voxel_costs_the_same_for_any_number_of_classes() -> None:
    few, many = (SemanticMap(voxel_size_m=VOXEL) for _ in range(2))
    points = np.random.default_rng(0).uniform(0.0, 1.0, (20000, 3))
    few.integrate(points, np.arange(20000) % 3 + 1)
    many.integrate(points, np.arange(20000) % 3000 + 1)
    assert many.memory_bytes == few.memory_bytes
    assert (many.belief(points).bound <= 0.25).all()


def test_what_is_held_never_exceeds_the_memory() -> None:
    semantics = SemanticMap(voxel_size_m=VOXEL, memory=5.0)
    for label in (1, 2, 3, 4, 5, 1, 1):
        semantics.integrate(np.full((40, 3), 0.05), np.full(40, label))
        counts, other = held(semantics)[0, 0, 0]
        assert sum(counts.values()) + other <= 5 * kernels.UNIT
    assert semantics.query([[0.05, 0.05, 0.05]])[0].tolist() == [1]


# -- Bayes ---------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 6), st.floats(0.2, 0.95)), min_size=1, max_size=8), st.integers(2, 6))
def test_labels_with_confidence_give_the_posterior(views, kept) -> None:
    semantics = SemanticMap(voxel_size_m=VOXEL, fusion="bayes", n_classes=6, kept=kept)
    likelihoods = []
    for label, sure in views:
        semantics.integrate([[0.05, 0.05, 0.05]], [label], confidence=[sure])
        row = np.full(6, (1.0 - sure) / 5)
        row[label - 1] = max(sure, 1.0 / 6.0)
        likelihoods.append(row)
    truth = posterior(likelihoods)
    belief = semantics.belief([[0.05, 0.05, 0.05]])
    if len({label for label, _ in views}) > kept:
        return
    shown = {c: p for c, p in zip(belief.classes[0].tolist(), belief.probability[0].tolist(), strict=True) if c}
    assert shown == pytest.approx({c: truth[c - 1] for c in shown}, abs=0.02)
    assert belief.other[0] == pytest.approx(sum(truth[c] for c in range(6) if c + 1 not in shown), abs=0.02)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_distributions_over_classes_give_the_posterior(seed, n_views) -> None:
    rng = np.random.default_rng(seed)
    ids = np.array([3, 1, 8, 5], np.uint16)
    scores = rng.dirichlet(np.ones(4), n_views) * 0.96 + 0.01
    semantics = SemanticMap(voxel_size_m=VOXEL, fusion="bayes", n_classes=4, kept=4)
    for row in scores:
        semantics.integrate_scores([[0.05, 0.05, 0.05]], [row], ids)
    truth = posterior(list(scores))
    belief = semantics.belief([[0.05, 0.05, 0.05]])
    total = belief.probability[0].sum() + belief.other[0]
    assert total == pytest.approx(1.0, abs=1e-5)
    for label, probability in zip(ids.tolist(), truth.tolist(), strict=True):
        at = np.flatnonzero(belief.classes[0] == label)
        shown = belief.probability[0, at[0]] if len(at) else belief.other[0] / max((belief.classes[0] == 0).sum(), 1)
        assert shown == pytest.approx(probability, abs=0.02)


def test_distributions_as_votes_are_shares() -> None:
    semantics = SemanticMap(voxel_size_m=VOXEL)
    point = [[0.05, 0.05, 0.05]]
    semantics.integrate_scores(point, [[3.0, 1.0, 0.0]], [4, 6, 9])
    semantics.integrate_scores(point, [[0.0, 1.0, 0.0]], [4, 6, 9])
    belief = semantics.belief(point)
    assert belief.classes.tolist() == [[6, 4, 0]]
    assert belief.probability[0] == pytest.approx([0.625, 0.375, 0.0])


def test_one_sure_label_outweighs_two_doubtful_ones() -> None:
    """What votes that ignore confidence get wrong."""
    point = np.full((3, 3), 0.05)
    semantics = SemanticMap(voxel_size_m=VOXEL, fusion="bayes", n_classes=10)
    semantics.integrate(point, [2, 2, 5], confidence=[0.3, 0.3, 0.95])
    assert semantics.query(point[:1])[0].tolist() == [5]


# -- doubt ---------------------------------------------------------------------------------------------------------


def test_entropy_tells_how_undecided_a_voxel_is() -> None:
    points = (np.arange(4)[:, None] + 0.5) * np.array([[VOXEL, 0, 0]]) + [[0, 0.05, 0.05]]
    semantics = SemanticMap(voxel_size_m=VOXEL)
    semantics.integrate(points[[0, 1, 1, 2, 2, 2]], [1, 1, 2, 1, 1, 2])
    entropy = semantics.entropy(points)
    assert entropy[:3] == pytest.approx([0.0, np.log(2.0), np.log(3.0) - 2.0 / 3.0 * np.log(2.0)], abs=1e-5)
    assert np.isnan(entropy[3])


def test_what_fades_counts_half_and_is_forgotten_in_the_end() -> None:
    semantics = mapped(np.full((1, 3), 0.05), np.array([4]), np.array([2.0]))
    shares = []
    for _ in range(8):
        changed = semantics.fade([[0, 0, 0], [0, 0, 1], [50, 50, 50]])
        shares.append(sum(counts[4] for counts, _ in held(semantics).values()))
    assert shares == [256, 128, 64, 32, 16, 8, 4, 0]
    assert changed.blocks.tolist() == [[0, 0, 0]]
    assert semantics.query([[0.05, 0.05, 0.05]])[0].tolist() == [0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"fusion": "mean"}, "fusion: expected votes or bayes, got 'mean'"),
        ({"kept": 0}, "kept"),
        ({"n_classes": 1}, "n_classes"),
        ({"memory": 300.0}, "memory"),
    ],
)
def test_parameters_that_mean_nothing_are_refused(given, message) -> None:
    with pytest.raises(InvalidParameter, match=message):
        SemanticMap(voxel_size_m=VOXEL, **given)


@pytest.mark.parametrize(
    ("scores", "classes", "message"),
    [
        ([[0.5, 0.5]], [1, 2, 3], "scores: expected"),
        ([[0.5, -0.5]], [1, 2], "scores: expected"),
        ([[0.5, 0.5]], [1, 1], "classes: expected different"),
        ([[0.5, 0.5]], [0, 1], "classes: expected different"),
    ],
)
def test_scores_that_do_not_fit_are_refused(scores, classes, message) -> None:
    with pytest.raises(InvalidParameter, match=message):
        SemanticMap(voxel_size_m=VOXEL).integrate_scores([[0.0, 0.0, 0.0]], scores, classes)


def test_maps_that_count_otherwise_are_not_merged() -> None:
    with pytest.raises(InvalidParameter, match="other: expected a map with"):
        SemanticMap(voxel_size_m=VOXEL).merge(SemanticMap(voxel_size_m=VOXEL, kept=4))


# -- images --------------------------------------------------------------------------------------------------------

CAMERA = CameraIntrinsics(fx=11.0, fy=12.0, cx=5.3, cy=4.1, width=12, height=9)
SHAPE = (CAMERA.height, CAMERA.width)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_a_pixel_counts_for_the_voxel_of_its_point(seed) -> None:
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random(SHAPE) < 0.2, 0.0, rng.uniform(0.2, 4.0, SHAPE)).astype(np.float32)
    labels = rng.integers(0, 3, SHAPE).astype(np.uint16)
    trust = rng.uniform(0.0, 1.0, SHAPE).astype(np.float32)
    pose = SE3.exp(rng.uniform(-1.0, 1.0, 6))
    semantics = SemanticMap(voxel_size_m=0.13, kept=3)
    semantics.integrate_image(depth, labels, trust, CAMERA, pose)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    share = depth.astype(np.float64) ** 2 / (CAMERA.fx * CAMERA.fy * 0.13**2)
    dense = depth < kernels.DENSE_PIXELS * 0.13 * np.sqrt(CAMERA.fx * CAMERA.fy)
    share = np.where(dense, np.where((u | v) & 1, 0.0, 4.0 * share), share)
    weight = trust * np.minimum(share, 1.0) * ((labels > 0) & (depth > 0))
    ijk = point_to_ijk((pose @ CAMERA.backproject(depth).astype(np.float64)).reshape(-1, 3), 0.13)
    expected: dict[tuple[int, ...], Counter[int]] = {}
    pixels: Counter[tuple[int, ...]] = Counter()
    for voxel, label, w in zip(ijk.tolist(), labels.ravel().tolist(), weight.ravel().tolist(), strict=True):
        if w > 0:
            expected.setdefault(tuple(voxel), Counter())[label] += w * kernels.UNIT
            pixels[tuple(voxel)] += 1
    found = held(semantics)
    assert set(found) <= set(expected)
    for voxel, counts in expected.items():
        if counts.total() > semantics.memory * kernels.UNIT - 2 * pixels[voxel]:
            continue
        told = found.get(voxel, ({}, 0))[0]
        for label, units in counts.items():
            assert abs(told.get(label, 0) - units) <= pixels[voxel], "each run is rounded once"


@pytest.mark.parametrize("fusion", ["votes", "bayes"])
def test_labels_from_an_uncertain_pose_are_spread_and_none_is_lost(fusion) -> None:
    camera = CameraIntrinsics(fx=60.0, fy=60.0, cx=31.5, cy=23.5, width=64, height=48)
    depth = np.full((48, 64), 1.52, np.float32)
    labels = np.where(np.arange(64) < 32, 3, 4).astype(np.uint16) + np.zeros((48, 1), np.uint16)
    sure, spread = (SemanticMap(voxel_size_m=0.05, fusion=fusion) for _ in range(2))
    for semantics, sigma in ((sure, None), (spread, np.diag([9e-4] * 3 + [0.0] * 3))):
        semantics.integrate_image(depth, labels, np.ones_like(depth), camera, SE3.identity(), covariance=sigma)
    one, two = (sum(sum(c.values()) + o for c, o in held(s).values()) for s in (sure, spread))
    assert two == pytest.approx(one, rel=0.05)
    assert len(held(spread)) > 2 * len(held(sure))
    border, inside = spread.belief([[0.01, 0.0, 1.52]]), spread.belief([[0.5, 0.0, 1.52]])
    assert set(border.classes[0].tolist()) == {0, 3, 4}
    assert set(inside.classes[0].tolist()) == {0, 4}


def test_the_shares_of_many_pixels_add_up() -> None:
    """A full view counts one, though each of its pixels counts less than a unit."""
    camera = CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)
    depth = np.full((480, 640), 1.02, np.float32)
    semantics = SemanticMap(voxel_size_m=0.05)
    semantics.integrate_image(depth, np.full((480, 640), 7, np.uint16), np.ones_like(depth), camera, SE3.identity())
    inner = [sum(counts.values()) for (i, j, _), (counts, _) in held(semantics).items() if abs(i) < 10 and abs(j) < 8]
    assert np.mean(inner) == pytest.approx(kernels.UNIT, rel=0.01)
    assert np.std(inner) < 0.06 * kernels.UNIT
