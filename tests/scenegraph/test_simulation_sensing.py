"""What the simulated sensors say, and how wrong it is."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mapping import errors
from mapping.geometry import SE3
from mapping.observations import AgentPose, LabelSpace, RgbdImage, RobotDescription
from scenegraph.simulation import CAMERA, NoiseModel, Tour, TruthRecorder
from scenegraph.simulation.noise import Segmenter, bleed, discontinuities, grown
from scenegraph.simulation.observing import make_segmenter, noise_model
from tests import naive_simulation as naive
from tests.support.homes import home

SEED = 2


@pytest.fixture(scope="module")
def tour():
    return Tour(home(SEED), images_per_room=8)


def first(count, **how):
    return list(islice(home(SEED).observe(**how), count))


def test_the_stream_begins_with_what_things_mean_and_goes_on_with_poses_and_images(tour):
    stream = first(8, noise="realistic", tour=tour)
    assert [type(o) for o in stream] == [LabelSpace, RobotDescription] + [AgentPose, RgbdImage] * 3
    stamps = [o.stamp_ns for o in stream[3::2]]
    assert [b - a for a, b in pairwise(stamps)] == [500_000_000] * 2


def test_the_same_seed_gives_the_same_stream_and_another_seed_other_noise(tour):
    one, same = first(8, tour=tour, seed=1), first(8, tour=tour, seed=1)
    other = first(8, tour=tour, seed=2)
    assert all(a == b for a, b in zip(one, same, strict=True))
    assert one[3] != other[3]


def test_without_noise_every_pixel_lies_on_the_surface_of_the_class_it_names(tour):
    h = home(SEED)
    for image in first(8, noise="none", tour=tour)[3::2]:
        some = (slice(3, None, 16), slice(3, None, 16))
        p_map = image.T_map_camera @ image.intrinsics.backproject(image.depth_m)[some].reshape(-1, 3)
        seen = image.depth[some].ravel() > 0
        _, closest = h.renderer.scene.closest(p_map[seen])
        assert np.abs(closest - p_map[seen]).max() < 2e-3
        same = h.nearest_class(p_map[seen]) == image.labels[some].ravel()[seen]
        assert same.mean() > 0.98  # the rest lies within half a millimetre of two classes


def test_instances_are_one_a_thing_and_none_for_walls_floors_and_ceilings(tour):
    h = home(SEED)
    stuff = [h.class_ids[name] for name in ("wall", "floor", "ceiling")]
    for step, image in zip(tour.steps, first(12, noise="none", tour=tour)[3::2], strict=False):
        truth = h.renderer.render(step.T_map_camera)
        assert not image.instances[np.isin(image.labels, stuff)].any()
        pairs = np.unique(np.stack([truth.entities[::3, ::3].ravel(), image.instances[::3, ::3].ravel()]), axis=1)
        assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]


def test_depth_noise_grows_with_distance_as_stated():
    rng = np.random.default_rng(0)
    model = NoiseModel(dropout_px=0)
    for z in (0.5, 1.0, 2.0, 4.0, 6.0):
        depth = np.full((200, 200), z, dtype=np.float32)
        measured = model.depth_mm(depth, rng) * 0.001
        assert measured.mean() == pytest.approx(z, abs=5e-4)
        quantised = np.hypot(0.0012 + 0.0019 * (z - 0.4) ** 2, 0.001 / np.sqrt(12))
        assert measured.std() == pytest.approx(quantised, rel=0.03)


def test_depth_is_missing_two_pixels_on_each_side_of_an_edge():
    depth = np.full((20, 20), 2.0, dtype=np.float32)
    depth[:, 10:] = 3.0
    missing = NoiseModel().depth_mm(depth, np.random.default_rng(0)) == 0
    assert missing[:, 8:12].all()
    assert not missing[:, :8].any()
    assert not missing[:, 12:].any()


@given(arrays(np.float32, (9, 11), elements=st.sampled_from([0.0, 1.0, 1.02, 1.2, 4.0, 4.1])), st.integers(1, 3))
@settings(max_examples=20, deadline=None)
def test_dropout_matches_the_naive_reference(depth, pixels):
    assert np.array_equal(grown(discontinuities(depth), pixels), naive.dropped(depth, pixels))


@given(
    arrays(np.int32, (9, 11), elements=st.integers(0, 3)),
    st.permutations([1, 2, 3]),
    st.lists(st.integers(0, 4), min_size=3, max_size=3),
)
@settings(max_examples=30, deadline=None)
def test_bleeding_matches_the_naive_reference(entities, ranks, radii):
    rank, radius = np.array([0, *ranks]), np.array([0, *radii])
    out = entities.copy()
    bleed(out, entities, radius, rank, np.zeros(entities.shape, np.int64))
    assert np.array_equal(out, naive.bleed(entities, radius, rank))


def test_masks_grow_by_three_to_eight_pixels():
    entities = np.zeros((60, 60), dtype=np.int32)
    entities[20:40, 20:40] = 1
    labels = np.where(entities > 0, 9, 1).astype(np.uint16)
    noise = NoiseModel(missed=0.0, mislabelled=0.0, confused=0.0)
    segmenter = Segmenter.make(
        noise, np.array([0, 9], np.uint16), np.array([9, 10], np.uint16), np.random.default_rng(0)
    )
    grown_by = {
        int((segmenter.segment(entities, labels, np.random.default_rng(k)).labels[30] == 9).sum() - 20) / 2
        for k in range(60)
    }
    assert grown_by == {3, 4, 5, 6, 7, 8}


def test_things_are_missed_and_mislabelled_as_often_as_stated():
    n = 400
    true_class = np.concatenate([[0], np.full(n, 7)]).astype(np.uint16)
    entities = np.arange(1, n + 1, dtype=np.int32).reshape(20, 20)
    labels = np.full((20, 20), 7, dtype=np.uint16)
    noise = NoiseModel(bleed_px=(0, 0))
    segmenter = Segmenter.make(noise, true_class, np.arange(5, 30, dtype=np.uint16), np.random.default_rng(0))
    always = segmenter.persistent[1:] != 7
    assert always.sum() == round(0.05 * n)
    missed, wrong, repeated, shown = 0, 0, [], 0
    for k in range(50):
        seen = segmenter.segment(entities, labels, np.random.default_rng(k))
        lost = seen.instances.ravel() == 0
        assert np.array_equal(lost, seen.labels.ravel() == 0)
        assert len(np.unique(seen.instances[seen.instances > 0])) == (~lost).sum()
        missed += lost.sum()
        wrong += (~lost & ~always & (seen.labels.ravel() != 7)).sum()
        shown += (~lost & ~always).sum()
        repeated.append(np.mean(seen.labels.ravel()[always & ~lost] == segmenter.persistent[1:][always & ~lost]))
    assert missed / (50 * n) == pytest.approx(0.10, abs=0.01)
    assert wrong / shown == pytest.approx(0.05, abs=0.007)
    assert np.mean(repeated) == pytest.approx(0.95, abs=0.03)


def test_only_things_are_always_mistaken_and_only_for_things():
    h = home(SEED)
    segmenter = make_segmenter(h, NoiseModel(), 0)
    mistaken = np.flatnonzero(segmenter.persistent != segmenter.true_class)
    assert len(mistaken) == round(0.05 * len(h.objects))
    assert (mistaken <= len(h.objects)).all()
    assert all(h.label_space.classes[int(c)].kind == "thing" for c in segmenter.persistent[mistaken])


def test_reported_poses_are_off_as_their_covariance_says():
    rng = np.random.default_rng(0)
    T = SE3.exp([1.0, 2.0, 0.5, 0.3, -0.2, 2.0])
    xi = np.array([(T.inverse() @ NoiseModel().perturbed(T, rng)).log() for _ in range(2000)])
    assert np.allclose(xi.std(axis=0), [0.01] * 3 + [np.deg2rad(0.5)] * 3, rtol=0.06)
    assert np.allclose(np.diag(NoiseModel().covariance), xi.var(axis=0), rtol=0.12)


def test_camera_and_base_are_reported_consistently(tour):
    stream = first(6, noise="realistic", tour=tour)
    for step, pose, image in zip(tour.steps, stream[2::2], stream[3::2], strict=False):
        T_base_camera = step.T_map_base.inverse() @ step.T_map_camera
        assert (pose.T_map_base @ T_base_camera).isclose(image.T_map_camera)


def test_a_lidar_turn_lies_on_the_surfaces_and_names_them():
    h = home(SEED)
    hall = next(room for room in h.rooms if room.kind == "hallway")
    T = SE3(np.eye(3), [*hall.footprint.mean(axis=0), 1.2])
    scan = h.scan(T, noise="none")
    assert 60_000 < len(scan.points) <= 64 * 1024
    p_map = T @ scan.points
    _, closest = h.renderer.scene.closest(p_map[::50])
    assert np.abs(closest - p_map[::50]).max() < 1e-3
    assert (h.nearest_class(p_map[::50]) == scan.labels[::50]).mean() > 0.98
    noisy = h.scan(T, noise="realistic")
    off = np.linalg.norm(noisy.points, axis=1) - np.linalg.norm(scan.points, axis=1)
    assert off.std() == pytest.approx(0.01, rel=0.05)


def test_unknown_noise_and_impossible_rates_are_refused_at_once():
    with pytest.raises(errors.InvalidParameter, match=r"noise: expected 'none', .* got 'loud'"):
        home(SEED).observe(noise="loud")
    with pytest.raises(errors.InvalidParameter, match="rate_hz"):
        home(SEED).observe(rate_hz=0.0)
    with pytest.raises(errors.InvalidParameter, match="images_per_room"):
        Tour(home(SEED), images_per_room=0)


def test_even_a_short_tour_shows_nearly_all_things_and_planes(tour):
    h = home(SEED)
    recorder = TruthRecorder(h)
    for step in tour.steps:
        recorder.record(h.renderer.render(step.T_map_camera, colored=False))
    assert recorder.images == len(tour)
    assert len(recorder.countable) >= 0.75 * len(h.objects)
    rooms = [p for p in h.structure if p.kind != "door"]
    assert len(recorder.countable_planes) >= 0.95 * len(rooms)
    assert all(0.0 <= share <= 1.0 for share in recorder.plane_seen.values())


def test_the_recorder_counts_pixels_and_places_as_they_are(tour):
    h = home(SEED)
    recorder = TruthRecorder(h)
    assert not recorder.countable
    assert not recorder.countable_planes
    seen = {}
    for step in tour.steps[:3]:
        image = h.renderer.render(step.T_map_camera)
        recorder.record(image)
        for k in range(1, len(h.entities) + 1):
            if ((image.entities == k) & (image.depth > 0)).sum() >= 200:
                seen[h.entities[k - 1]] = seen.get(h.entities[k - 1], 0) + 1
    assert {name: n for name, n in recorder.images_of.items() if n} == seen
    assert image.depth.shape == (CAMERA.height, CAMERA.width)
    assert image.depth.max() <= 6.0


# -- the noise that one asks for --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"mislabelled": 1.01}, "mislabelled: expected a share of the things, 0 … 1, got 1.01"),
        ({"missed": -0.1}, "missed: expected a share of the things, 0 … 1, got -0.1"),
        ({"confused": float("nan")}, "confused: expected a share of the things, 0 … 1, got nan"),
        ({"position_m": -1.0}, "position_m: expected a number ≥ 0, got -1.0"),
        ({"range_m": float("inf")}, "range_m: expected a number ≥ 0, got inf"),
        ({"bleed_px": (8, 3)}, "bleed_px: expected a range of pixels"),
    ],
)
def test_noise_that_cannot_be_is_refused_by_name(fields, told):
    with pytest.raises(errors.InvalidParameter) as refused:
        NoiseModel(**fields)
    assert told in str(refused.value)


def test_the_share_of_mislabelled_things_can_be_set_on_top_of_any_noise():
    assert noise_model("realistic", 0.25) == NoiseModel(mislabelled=0.25)
    assert noise_model("none", 0.25) == replace(NoiseModel.none(), mislabelled=0.25)
    assert noise_model("none", None) == NoiseModel.none()
    assert noise_model(NoiseModel(confused=0.0), 0.0) == NoiseModel(confused=0.0, mislabelled=0.0)
    with pytest.raises(errors.InvalidParameter, match="mislabelled"):
        noise_model("realistic", 2.0)


def test_every_thing_is_mislabelled_in_about_the_share_of_images_asked_for_each_image_anew():
    h = home(SEED)
    noise = NoiseModel(bleed_px=(0, 0), missed=0.0, mislabelled=0.25, confused=0.0)
    segmenter = make_segmenter(h, noise, 0)
    entities = np.arange(len(h.entities) + 1, dtype=np.int32)[None]
    things = np.arange(len(h.objects)) + 1
    rng = np.random.default_rng(0)
    wrong = np.array(
        [
            segmenter.segment(entities, segmenter.true_class[entities], rng).labels[0][things]
            != segmenter.true_class[things]
            for _ in range(400)
        ]
    )
    assert wrong.mean() == pytest.approx(0.25, abs=0.01)
    assert np.abs(wrong.mean(axis=0) - 0.25).max() < 0.1
    again = (wrong[1:] & wrong[:-1]).mean()
    assert again == pytest.approx(0.25**2, abs=0.01)  # independent of the image before


def test_the_recorder_learns_which_things_are_always_mistaken(tour):
    h = home(SEED)
    recorder = TruthRecorder(h)
    first(4, noise=NoiseModel(confused=0.1), tour=tour, seed=7, recorder=recorder)
    persistent = make_segmenter(h, NoiseModel(confused=0.1), 7).persistent
    mistaken = {o.id for k, o in enumerate(h.objects) if persistent[k + 1] != h.class_ids[o.label]}
    assert recorder.confused == mistaken
    assert len(mistaken) == round(0.1 * len(h.objects))
    untroubled = TruthRecorder(h)
    first(4, noise="none", tour=tour, recorder=untroubled)
    assert untroubled.confused == frozenset()
