"""Figures of the semantic floor, on voxels whose right figures are known."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping import errors
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import ijk_to_centre, point_to_ijk
from mapping.observations import ClassInfo, RgbdImage
from scenegraph import evaluation
from scenegraph.console import Printer
from scenegraph.evaluation import Evaluation, PanopticTally, SemanticTally, ViewLog, evaluate
from scenegraph.evaluation.doors import judge_doors
from scenegraph.evaluation.semantics import judge_voxels
from scenegraph.graph import Edge, GraphChanges, Node, SceneGraph
from scenegraph.simulation import NoiseModel, TruthRecorder
from tests.support.corners import kitchen_corner
from tests.support.homes import home

WALL, FLOOR, CUP, BOTTLE = 1, 2, 10, 11
THINGS = {CUP, BOTTLE}


# -- panoptic quality ------------------------------------------------------------------------------------------------


def quality(true, said, classes=None, **how):
    """Of voxels given as (class, instance, how many)."""
    tally = PanopticTally()
    tally.add(*spelt(true), *spelt(said), things=THINGS, **how)
    return tally.quality(classes)


def spelt(runs):
    classes, instances, counts = np.array(runs).T
    return np.repeat(classes, counts), np.repeat(instances, counts)


def test_a_perfect_division_has_quality_one_whatever_its_numbers():
    true = [(WALL, 0, 50), (CUP, 1, 10), (CUP, 2, 10), (BOTTLE, 3, 5)]
    said = [(WALL, 9, 50), (CUP, 7, 10), (CUP, 4, 10), (BOTTLE, 1, 5)]
    assert quality(true, said) == quality(true, true)
    assert (quality(true, said).pq, quality(true, said).sq, quality(true, said).rq) == (1.0, 1.0, 1.0)


def test_a_thing_split_in_unequal_parts_keeps_the_larger_and_invents_the_smaller():
    found = quality([(CUP, 1, 10)], [(CUP, 1, 7), (CUP, 2, 3)])
    assert found.sq == pytest.approx(0.7)
    assert found.rq == pytest.approx(1 / 1.5)
    assert found.pq == pytest.approx(0.7 / 1.5)


def test_a_thing_split_in_halves_is_missed_for_a_match_needs_more_than_half():
    assert quality([(CUP, 1, 10)], [(CUP, 1, 5), (CUP, 2, 5)]).pq == 0.0


def test_two_things_merged_are_one_match_at_most_and_one_is_missed():
    found = quality([(CUP, 1, 8), (CUP, 2, 2)], [(CUP, 5, 10)])
    assert found.pq == pytest.approx(0.8 / 1.5)
    assert quality([(CUP, 1, 5), (CUP, 2, 5)], [(CUP, 5, 10)]).pq == 0.0


def test_a_thing_of_the_wrong_class_costs_both_classes():
    tally = PanopticTally()
    tally.add(*spelt([(CUP, 1, 10)]), *spelt([(BOTTLE, 1, 10)]), things=THINGS)
    assert (dict(tally.missed), dict(tally.invented), dict(tally.matched)) == ({CUP: 1}, {BOTTLE: 1}, {})
    assert tally.quality().pq == 0.0


def test_stuff_is_one_segment_a_class_whatever_instances_it_is_said_to_have():
    true, said = [(WALL, 0, 6), (FLOOR, 0, 4)], [(WALL, 3, 3), (WALL, 4, 3), (FLOOR, 5, 4)]
    assert quality(true, said).pq == 1.0


def test_an_instance_is_of_the_class_that_most_of_its_voxels_have():
    found = quality([(CUP, 1, 10)], [(CUP, 1, 6), (BOTTLE, 1, 4)])
    assert found.pq == 1.0
    tied = PanopticTally()
    tied.add(*spelt([(CUP, 1, 10)]), *spelt([(BOTTLE, 1, 5), (CUP, 1, 5)]), things=THINGS)
    assert tied.matched == {CUP: 1}  # of a tie, the lower id


def test_voxels_that_nothing_is_said_of_count_in_the_true_segment_only():
    found = quality([(CUP, 1, 10)], [(CUP, 1, 6), (0, 0, 3), (CUP, 0, 1)])
    assert (found.sq, found.rq) == (pytest.approx(0.6), 1.0)
    assert quality([(CUP, 1, 10)], [(0, 0, 10)]).pq == 0.0


def test_void_voxels_count_nowhere_and_what_is_mostly_void_was_not_invented():
    true, said = [(CUP, 1, 10), (CUP, 2, 6)], [(CUP, 1, 12), (BOTTLE, 2, 4)]
    void = np.arange(16) >= 10
    assert quality(true, said, void=void).pq == 1.0
    mostly_real = [(CUP, 1, 4), (BOTTLE, 2, 8), (CUP, 3, 4)]
    tally = PanopticTally()
    tally.add(*spelt(true), *spelt(mostly_real), things=THINGS, void=void)
    assert dict(tally.invented) == {CUP: 1, BOTTLE: 1}  # cup 1 too small to match; bottle 2 true in six of eight
    assert dict(tally.missed) == {CUP: 1}


def test_a_thing_without_any_voxel_is_missed_when_it_should_have_been_seen():
    found = quality([(WALL, 0, 5)], [(WALL, 0, 5)], unseen=[CUP, CUP])
    assert found.pq == 0.5
    assert quality([(WALL, 0, 5)], [(WALL, 0, 5)], {WALL}, unseen=[CUP]).pq == 1.0


def test_segments_without_a_match_are_told_with_their_ids():
    tally = PanopticTally()
    unmatched = tally.add(
        *spelt([(CUP, 3, 10), (BOTTLE, 4, 5), (WALL, 0, 9)]),
        *spelt([(CUP, 8, 10), (BOTTLE, 6, 2), (BOTTLE, 7, 2), (FLOOR, 0, 10)]),
        things=THINGS,
    )
    assert unmatched.missed == [(WALL, 0), (BOTTLE, 4)]
    assert unmatched.invented == [(FLOOR, 0, 10), (BOTTLE, 6, 2), (BOTTLE, 7, 2)]


def test_counts_of_homes_are_summed_before_classes_are_averaged():
    tally = PanopticTally()
    tally.add(*spelt([(CUP, 1, 10)]), *spelt([(CUP, 1, 10)]), things=THINGS)
    tally.add(*spelt([(CUP, 1, 10), (WALL, 0, 5)]), *spelt([(0, 0, 10), (WALL, 0, 5)]), things=THINGS)
    assert tally.quality().pq == pytest.approx(np.mean([1.0, 1.0 / 1.5]))
    assert tally.quality(THINGS).rq == pytest.approx(1.0 / 1.5)


def test_nothing_has_no_quality():
    empty = PanopticTally()
    assert np.isnan(empty.quality().pq)
    none = np.empty(0, np.int64)
    empty.add(none, none, none, none, things=THINGS)
    assert np.isnan(empty.quality().pq)


def naive_quality(true_class, true_instance, said_class, said_instance, void):
    """The definition, by sets of voxels; each said instance has one class."""

    def segments(classes, instances):
        found = {}
        for at, (c, i) in enumerate(zip(classes, instances, strict=True)):
            if (c in THINGS and i == 0) or c == 0:
                continue
            found.setdefault((c, i if c in THINGS else 0), set()).add(at)
        return found

    ignored = set(np.flatnonzero(void).tolist())
    true = {key: s - ignored for key, s in segments(true_class, true_instance).items() if s - ignored}
    said = segments(said_class, said_instance)
    counts = {}
    hit = set()
    for (c, _), a in true.items():
        of_class = counts.setdefault(c, [0.0, 0, 0, 0])
        best = max(
            ((len(a & (b - ignored)) / len(a | (b - ignored)), (d, j)) for (d, j), b in said.items() if d == c),
            default=(0.0, None),
        )
        if best[0] > 0.5:
            hit.add(best[1])
            of_class[0] += best[0]
            of_class[1] += 1
        else:
            of_class[3] += 1
    for (c, i), b in said.items():
        if (c, i) not in hit and len(b & ignored) <= 0.5 * len(b):
            counts.setdefault(c, [0.0, 0, 0, 0])[2] += 1
    each = [overlap / (tp + 0.5 * fp + 0.5 * fn) for overlap, tp, fp, fn in counts.values()]
    return float(np.mean(each)) if each else float("nan")


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(1, 5))
def test_quality_is_that_of_the_definition_and_does_not_depend_on_order_or_numbers(seed, n, n_instances):
    rng = np.random.default_rng(seed)
    class_of = rng.choice([WALL, FLOOR, CUP, BOTTLE], n_instances + 1)
    true_instance = rng.integers(0, n_instances, n) + 1
    true_class = class_of[true_instance]
    said_instance = np.where(rng.random(n) < 0.7, true_instance, rng.integers(0, n_instances + 1, n))
    other = np.where(rng.random(n_instances + 1) < 0.7, class_of, rng.choice([0, WALL, CUP, BOTTLE], n_instances + 1))
    said_class = other[said_instance]
    void = rng.random(n) < 0.2
    given_ = (true_class, true_instance, said_class, said_instance)
    one, two = PanopticTally(), PanopticTally()
    one.add(*given_, things=THINGS, void=void)
    expected = naive_quality(*given_, void)
    assert one.quality().pq == pytest.approx(expected, nan_ok=True)
    order = rng.permutation(n)
    renamed = np.append(0, rng.permutation(n_instances) + 1)[said_instance]
    two.add(true_class[order], true_instance[order], said_class[order], renamed[order], things=THINGS, void=void[order])
    assert two.quality().pq == pytest.approx(one.quality().pq, nan_ok=True)


# -- single views ----------------------------------------------------------------------------------------------------

EYE = CameraIntrinsics(fx=40.0, fy=40.0, cx=19.5, cy=14.5, width=40, height=30)
AHEAD = SE3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.0]))


def wall_image(labels, depth_m=1.9):
    """A wall across the view, with `labels`: a class id, or an image of them."""
    return RgbdImage(
        stamp_ns=1,
        robot="rob",
        sensor="camera",
        depth=np.full((30, 40), depth_m, np.float32),
        intrinsics=EYE,
        T_map_camera=AHEAD,
        labels=np.broadcast_to(np.uint16(labels), (30, 40)).copy(),
    )


def test_each_image_labels_a_voxel_once_by_most_of_its_pixels():
    log = ViewLog(0.2, 5.0)
    labels = np.full((30, 40), CUP, np.uint16)
    labels[::6] = BOTTLE  # the fewer in each voxel that lies wholly in the image
    log.add(wall_image(labels), AHEAD)
    ijk = log.voxels()
    assert (ijk[:, 0] == 9).all()
    ijk = ijk[(ijk[:, 2] > ijk[:, 2].min()) & (ijk[:, 2] < ijk[:, 2].max())]
    views, label = log.query(ijk)
    assert (views == 1).all()
    assert (label == CUP).all()


def test_voxels_count_the_images_that_labelled_them_and_nothing_else():
    log = ViewLog(0.2, 2.5)
    empty = np.zeros((30, 40), np.uint16)
    half = empty.copy()
    half[:, :20] = CUP  # the left: y > 0
    for labels, depth_m in ((CUP, 1.9), (half, 1.9), (empty, 1.9), (CUP, 2.7), (CUP, 0.0)):
        log.add(wall_image(labels, depth_m), AHEAD)
    middle = np.array([[9, 2, 5], [9, -3, 5], [13, 0, 5], [0, 0, 0]])
    views, labels = log.query(middle)
    assert views.tolist() == [2, 1, 0, 0]
    assert labels.tolist() == [CUP, CUP, 0, 0]
    assert len(log.voxels(2)) < len(log.voxels())
    assert (log.voxels(2)[:, 1] >= 0).all()
    assert log.voxels(3).shape == (0, 3)


def test_the_one_view_is_drawn_evenly_for_each_voxel():
    log = ViewLog(0.01, 5.0)
    for label in (CUP, BOTTLE, WALL, WALL):
        log.add(wall_image(label), AHEAD)
    views, labels = log.query(log.voxels())
    assert (views == 4).all()
    assert np.bincount(labels)[[CUP, BOTTLE, WALL]] / len(labels) == pytest.approx([0.25, 0.25, 0.5], abs=0.09)
    again = log.query(log.voxels())[1]
    assert (labels == again).all()


def test_a_pixel_falls_where_the_pose_says():
    log = ViewLog(0.05, 5.0)
    pose = SE3.exp([0.3, -2.0, 0.7, 0.2, -0.4, 1.1])
    image = wall_image(CUP)
    log.add(image, pose)
    p_map = pose @ EYE.backproject(image.depth_m)[::2, ::2].reshape(-1, 3)
    expected = np.unique(point_to_ijk(p_map, 0.05), axis=0)
    assert np.array_equal(log.voxels(), expected)


def test_a_log_without_images_knows_nothing_and_an_image_without_labels_is_refused():
    log = ViewLog(0.05, 5.0)
    views, labels = log.query(np.zeros((2, 3), int))
    assert views.tolist() == labels.tolist() == [0, 0]
    with pytest.raises(errors.InvalidObservation, match="labels"):
        log.add(wall_image(CUP).model_copy(update={"labels": None}), AHEAD)


# -- voxels of a home ------------------------------------------------------------------------------------------------

SEED = 2
SIZE = 0.05


@pytest.fixture(scope="module")
def seen():
    """What a perfect camera saw of a corner of a home: the recorder, the log, and the voxels it labelled."""
    h = home(SEED)
    recorder, log = TruthRecorder(h), ViewLog(SIZE, 5.0)
    for observation in h.observe(noise="none", tour=kitchen_corner(SEED, 4), recorder=recorder):
        if isinstance(observation, RgbdImage):
            log.add(observation, observation.T_map_camera)
    ijk = log.voxels()
    triangles, distance = recorder.surface.closest(ijk_to_centre(ijk, SIZE), 2.0 * SIZE)
    assert (distance <= SIZE).all()
    return SimpleNamespace(
        home=h,
        recorder=recorder,
        log=log,
        ijk=ijk,
        true=h.triangle_class[triangles],
        entity=h.triangle_entity[triangles],
    )


def world_that_says(seen, labels, instances):
    """A world of which nothing but voxels is known: their class and instance, 0 where it has none."""
    there = labels > 0
    semantics = SimpleNamespace(
        voxel_size_m=SIZE,
        voxels=lambda: (ijk_to_centre(seen.ijk[there], SIZE), labels[there], np.ones(there.sum())),
    )
    at = {tuple(i): int(k) for i, k in zip(seen.ijk.tolist(), instances.tolist(), strict=True)}
    held = SimpleNamespace(query=lambda p: np.array([at[tuple(i)] for i in point_to_ijk(p, SIZE).tolist()]))
    classes = [seen.home.label_space.classes.get(k, ClassInfo(name="?")) for k in range(1, 100)]
    return SimpleNamespace(
        map=SimpleNamespace(semantics=semantics, instances=held), labels=SimpleNamespace(classes=classes)
    )


def figures(seen, labels=None, instances=None, recorder=None, log=None):
    tally = SemanticTally()
    labels = seen.true.copy() if labels is None else labels
    instances = seen.entity if instances is None else instances
    notes = judge_voxels(world_that_says(seen, labels, instances), seen.home, recorder or seen.recorder, tally, log)
    assert len(notes) == tally.panoptic.missed.total() + tally.panoptic.invented.total()
    return {name.removeprefix("semantics."): value for name, value in tally.figures().items()}, tally


def with_confused(seen, *names):
    recorder = TruthRecorder(seen.home)
    recorder.__dict__.update(seen.recorder.__dict__)
    recorder.confused = frozenset(names)
    return recorder


def largest_thing(seen):
    """Number and id of the countable thing with most voxels."""
    names = seen.home.entities
    counts = np.bincount(seen.entity, minlength=len(names) + 1)
    counts[[0, *(k for k, name in enumerate(names, 1) if name not in seen.recorder.countable)]] = 0
    return int(counts.argmax()), names[int(counts.argmax()) - 1]


def test_the_truth_itself_is_perfect_on_every_count(seen):
    found, tally = figures(seen, log=seen.log)
    for name in ("voxel_accuracy", "miou", "pq", "sq", "rq", "pq_things", "pq_stuff", "labelled"):
        assert found[name] == 1.0, name
    assert found["off_surface"] == found["confused.voxel_share"] == 0.0
    assert found["views_per_voxel.median"] >= 1
    assert 0.9 < found["single_view.voxel_accuracy"] < 1.0  # a voxel at the border of two classes has pixels of both
    assert "confused.voxel_accuracy" not in found
    rows = tally.accuracy_by_views()
    assert sum(row["voxel_share"] for row in rows) == pytest.approx(1.0, abs=1e-3)
    assert {row["voxel_accuracy"] for row in rows} == {1.0}
    assert [row["views"] for row in rows] == ["2-3", "4-7"]  # two places, twice each


def test_without_a_log_single_views_are_not_told_of(seen):
    found, tally = figures(seen)
    assert "labelled" not in found
    assert not any(name.startswith(("single_view", "views_per_voxel")) for name in found)
    assert tally.accuracy_by_views() == []
    assert found["pq"] == 1.0


def test_accuracy_is_told_by_bands_of_the_number_of_views():
    tally = SemanticTally()
    views = np.array([1, 2, 3, 4, 7, 8, 100])
    right = np.full(7, CUP)
    said = np.array([CUP, CUP, CUP, WALL, CUP, CUP, CUP])
    for _ in range(2):
        tally.count_views(views, right, said, np.full(7, WALL))
    told = [(row["views"], row["voxel_share"], row["voxel_accuracy"]) for row in tally.accuracy_by_views()]
    seventh = round(1 / 7, 4)
    assert told == [
        ("1", seventh, 1.0),
        ("2-3", round(2 / 7, 4), 1.0),
        ("4-7", round(2 / 7, 4), 0.5),
        ("8+", round(2 / 7, 4), 1.0),
    ]
    assert {row["single_view.voxel_accuracy"] for row in tally.accuracy_by_views()} == {0.0}


def test_things_that_are_always_mistaken_are_told_of_apart(seen):
    number, name = largest_thing(seen)
    labels = seen.true.copy()
    labels[seen.entity == number] = next(c for c in seen.home.class_ids.values() if c > 5 and c not in seen.true)
    blamed, _ = figures(seen, labels)
    assert blamed["voxel_accuracy"] < 1.0
    assert blamed["pq"] < 1.0
    excused, _ = figures(seen, labels, recorder=with_confused(seen, name))
    assert excused["voxel_accuracy"] == excused["miou"] == excused["pq"] == 1.0
    assert excused["confused.voxel_accuracy"] == 0.0
    assert excused["confused.voxel_share"] == pytest.approx((seen.entity == number).mean())


def test_a_thing_that_the_map_does_not_label_is_missed_and_lowers_the_labelled_share(seen):
    number, name = largest_thing(seen)
    labels = np.where(seen.entity == number, 0, seen.true).astype(seen.true.dtype)
    found, tally = figures(seen, labels, log=seen.log)
    assert found["voxel_accuracy"] == 1.0
    assert found["labelled"] < 1.0
    label = seen.home.class_ids[seen.home.thing(name).label]
    assert tally.panoptic.missed[label] == 1
    _, tally = figures(seen, labels)
    assert tally.panoptic.missed[label] == 1  # countable, though no voxel of it is left
    hardly_seen = TruthRecorder(seen.home)
    _, tally = figures(seen, labels, recorder=hardly_seen)
    assert tally.panoptic.missed[label] == 0


def test_voxels_off_any_surface_are_told_of_but_not_judged(seen):
    floating = SimpleNamespace(**vars(seen))
    floating.ijk = np.concatenate([seen.ijk, seen.ijk[:50] + np.array([0, 0, 4000])])
    labels = np.append(seen.true, np.full(50, 1, seen.true.dtype))
    found, _ = figures(floating, labels, np.append(seen.entity, np.zeros(50, int)))
    assert found["voxel_accuracy"] == 1.0
    assert found["off_surface"] == pytest.approx(50 / len(floating.ijk))


# -- whole evaluations -----------------------------------------------------------------------------------------------


def test_an_evaluation_maps_homes_under_the_noise_asked_for_and_tells_every_figure(monkeypatch, capsys):
    class Corner:
        """A home whose tour ends after a few images."""

        def __init__(self, seed):
            self.seed = seed

        def __getattr__(self, name):
            return getattr(home(self.seed), name)

        def observe(self, *, noise, seed, recorder):
            asked.append(noise)
            return home(self.seed).observe(noise=noise, seed=seed, recorder=recorder, tour=kitchen_corner(self.seed, 4))

    asked: list[NoiseModel] = []
    monkeypatch.setattr(evaluation.homes, "simulate_home", Corner)
    result = evaluate(1, SEED, noise="none", mislabelled=0.25)
    assert asked == [replace(NoiseModel.none(), mislabelled=0.25)]
    told = json.loads(json.dumps(result.as_json()))
    names = (
        "voxel_accuracy", "miou", "single_view.voxel_accuracy", "single_view.miou", "confused.voxel_share",
        "pq", "sq", "rq", "pq_things", "pq_stuff", "views_per_voxel.median", "labelled", "off_surface",
    )  # fmt: skip
    assert {f"semantics.{name}" for name in names} <= set(told["figures"])
    assert all(0.0 <= told["figures"][f"semantics.{name}"] <= 1.0 for name in names if "views" not in name)
    assert told["figures"]["semantics.labelled"] > 0.95
    assert told["noise"]["mislabelled"] == 0.25
    assert told["semantics.accuracy_by_views"]
    Printer().figures(result)
    text = capsys.readouterr().out
    assert "25% of things mislabelled an image" in text
    assert "semantics.single_view.miou" in text
    assert "right in one image" in text


def test_noise_that_does_not_exist_is_refused_before_anything_is_mapped():
    with pytest.raises(errors.InvalidParameter, match="mislabelled: expected a share of the things, 0 … 1, got 25"):
        evaluate(1, mislabelled=25)
    with pytest.raises(errors.InvalidParameter, match="noise: expected"):
        evaluate(1, noise="loud")  # type: ignore[arg-type]


def test_an_evaluation_of_nothing_has_no_figures():
    assert Evaluation().figures() == {}
    assert Evaluation().as_json()["semantics.accuracy_by_views"] == []


# -- doors -----------------------------------------------------------------------------------------------------------


def test_doors_count_where_a_node_leads_from_the_right_room_to_the_right_room():
    times = {"first_seen_ns": 0, "last_seen_ns": 0}
    true = [
        SimpleNamespace(id=f"door_{n}", kind="ajar", rooms=rooms, center=np.array([float(n), 0.0, 1.0]))
        for n, rooms in enumerate([("a", "b"), ("b", "c"), ("c", "a"), ("a",)])
    ]
    graph, changes = SceneGraph(), GraphChanges()
    for room in "abc":
        changes.put(Node(id=f"room_{room}", layer="room", label="room", position=(0, 0, 0), **times))
    for by, at, rooms in (
        ("leaf", (0.4, 0.2), "ba"),  # right, though the leaf itself stands elsewhere
        ("near_the_wrong", (1.1, 0.0), "ac"),
        ("far", (2.0, 0.7), "ac"),
        ("nowhere", (3.0, 0.0), "a"),  # leads into one room: not judged
    ):
        changes.put(Node(id=by, layer="structure", label="door", position=(9, 9, 1), **times))
        for room in rooms:
            changes.put(
                Edge(relation="connects", source=by, target=f"room_{room}", attributes={"at": list(at)}, **times)
            )
    graph.commit(changes, 0)
    result = Evaluation()
    judge_doors(
        SimpleNamespace(graph=graph),
        SimpleNamespace(seed=1, doors=true),
        {f"room_{room}": room for room in "abc"},
        result,
    )
    doors = result.tallies["doors"]
    assert (doors.right, doors.said, doors.true) == (1, 3, 3)
    assert sorted(result.notes) == [
        "1: far is no way between a and c",
        "1: missed ajar door_1 of ('b', 'c')",
        "1: missed ajar door_2 of ('c', 'a')",
        "1: near_the_wrong is no way between a and c",
    ]


def counted(rng):
    """An evaluation of some homes, and its share of voxels and segments."""
    found = Evaluation(seeds=[int(rng.integers(100))], image_ms=rng.random(3).tolist(), notes=["missed a cup"])
    found.tallies["objects"].add(*rng.integers(0, 9, 3).tolist())
    found.count("labelled", *sorted(rng.integers(1, 9, 2).tolist()))
    true, said, instance = rng.integers(0, 4, (3, 50))
    found.semantics.said.count(true, said)
    found.semantics.count_views(rng.integers(1, 9, 50), true, said, said)
    found.semantics.panoptic.add(true, instance, said, instance, things={1, 2})
    found.semantics.things |= {1, 2}
    found.semantics.off_surface += int(rng.integers(9))
    return found


def test_homes_that_were_counted_apart_give_the_figures_of_all():
    rng = np.random.default_rng(3)
    one, two, three = counted(rng), counted(rng), counted(rng)
    left, right = Evaluation(), Evaluation()
    for part in (one, two, three):
        left.merge(part)
    two.merge(three)
    right.merge(one)
    right.merge(two)
    assert left.as_json() == right.as_json()
    assert left.seeds == right.seeds
    assert len(left.seeds) == 3
    assert left.tallies["objects"].said == one.tallies["objects"].said + two.tallies["objects"].said
    total = sum(part.semantics.said.total() for part in (one, two))  # of which two holds three's
    assert left.semantics.said.total() == total == 150
