"""How labels of images reach the layers: with confidences, from uncertain poses, and out again."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.histograms import aligned_box
from mapping.labelled import EMPTY, LABELLED, UNSEEN
from mapping.layered import LayeredMap
from mapping.observations import RgbdImage
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

THINGS = np.zeros(1 << 16, bool)


def room_image(n: int, label: int, sure: float | None = None, covariance: np.ndarray | None = None) -> RgbdImage:
    """A view of the room, all of one class."""
    return RgbdImage(
        stamp_ns=n + 1, robot="r", sensor="c", depth=Room().depth(TOUR[n], SMALL_CAMERA), intrinsics=SMALL_CAMERA,
        T_map_camera=TOUR[n], labels=np.full((SMALL_CAMERA.height, SMALL_CAMERA.width), label, np.uint16),
        label_confidence=None if sure is None else np.full((SMALL_CAMERA.height, SMALL_CAMERA.width), sure, np.float32),
        covariance=covariance,
    )  # fmt: skip


def layers(**options) -> LayeredMap:
    return LayeredMap(voxel_size_m=0.1, instance_voxel_size_m=0.05, max_range_m=6.0, label_range_m=5.0, **options)


@pytest.mark.parametrize(("fusion", "winner"), [("votes", 3), ("bayes", 7)])
def test_one_sure_view_outweighs_two_doubtful_ones_by_bayes_and_not_by_votes(fusion, winner):
    made = layers(fusion=fusion)
    for label, sure in ((3, 0.5), (3, 0.5), (7, 0.99)):
        made.integrate_image(room_image(0, label, sure), TOUR[0], THINGS)
    labels = made.semantics.voxels()[1]
    assert np.mean(labels == winner) > 0.95


def test_labels_are_spread_where_that_is_asked_for_and_the_pose_has_a_covariance():
    sigma = np.diag([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
    counts = {}
    for spread in (False, True):
        made = layers(spread_labels=spread)
        made.integrate_image(room_image(0, 3, covariance=sigma), TOUR[0], THINGS)
        counts[spread] = made.semantics.store.n_records
    assert counts[True] > 1.5 * counts[False]


def test_a_map_tells_what_it_knows_of_points_and_boxes():
    made = layers()
    for n in range(6):
        made.integrate_image(room_image(n, 3), TOUR[n], THINGS)
    on_surface = made.semantics.voxels()[0][:40]
    before = TOUR[0].translation + 0.3 * TOUR[0].rotation[:, 2]
    told = made.labels_at(np.vstack([on_surface, before, [99.0, 0.0, 0.0]]))
    assert (told.labels[:40] == 3).all()
    assert told.state.tolist() == [LABELLED] * 40 + [EMPTY, UNSEEN]
    held = made.class_histogram(aligned_box([-3.0, -3.0, -3.0], [3.0, 3.0, 3.0]))
    assert held.labels.tolist() == [3]
    assert held.unseen > 0
    cloud = made.labelled_cloud()
    assert (cloud.labels == 3).all()
    assert len(cloud.points) == len(made.semantics.voxels()[0])


def test_how_masks_bleed_is_saved_with_the_map():
    made, again = layers(), layers()
    made.integrate_image(room_image(0, 3), TOUR[0], THINGS)
    again.restore(made.state())
    for layered in (made, again):
        layered.integrate_image(room_image(1, 4), TOUR[1], THINGS)
    one, two = (layered.state() for layered in (made, again))
    assert one.keys() == two.keys()
    assert all(np.array_equal(one[name][field], two[name][field]) for name in one for field in one[name])
