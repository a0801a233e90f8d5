"""Labels keep out of each other's way, near what they name, and inside the picture."""

from itertools import pairwise

import numpy as np

from scenegraph.lettering import Lettering


def box(place: tuple[float, float], text: str, size: float = 10.0) -> np.ndarray:
    """Where the letters of a label are, narrower than the room it is given: low u, v, high u, v."""
    half = 0.5 * size * np.array([0.5 * len(text), 1.0])
    return np.concatenate([np.array(place) - half, np.array(place) + half])


def test_a_label_alone_is_where_it_belongs() -> None:
    assert Lettering(400, 300, 1.0).place(200, 150, "cup", 10) == (200, 150)


def test_labels_of_one_place_do_not_cover_each_other() -> None:
    sheet = Lettering(400, 300, 1.0)
    boxes = [box(sheet.place(200, 150, "bottle", 10), "bottle") for _ in range(12)]
    for i, a in enumerate(boxes):
        for b in boxes[i + 1 :]:
            assert (np.maximum(a[:2], b[:2]) >= np.minimum(a[2:], b[2:])).any()
    middles = np.array([(b[:2] + b[2:]) / 2 for b in boxes])
    assert np.linalg.norm(middles - [200, 150], axis=1).max() < 110


def test_labels_stay_inside_and_a_full_picture_is_no_error() -> None:
    sheet = Lettering(80, 40, 1.0)
    places = np.array([sheet.place(u, -5, "wardrobe\nroom", 8) for u in np.linspace(-50, 150, 30)])
    assert (places >= 0).all()
    assert (places <= [80, 40]).all()
    assert any((a != b).any() for a, b in pairwise(places))
