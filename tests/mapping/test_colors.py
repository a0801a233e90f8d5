"""Colours of things are told by what is sure of them, whatever the light and the side they are seen from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.colors import STEP, color_name, distance, likeness, main_color, no_colors, piece_colors
from mapping.kernels.colors import CELLS, CHROMA_CELLS, CHROMA_STEP, DARK, LIGHT_CELLS, LIGHT_STEP, main_block

shades = st.tuples(*[st.integers(0, 255)] * 3)


def plain(color: tuple[int, int, int]) -> np.ndarray:
    """The colours (CELLS,) of a piece that is all of one colour."""
    image = np.broadcast_to(np.array(color, np.uint8), (8, 8, 3))
    found: np.ndarray = piece_colors(np.ones((8, 8), np.int32), np.ones((8, 8), np.float32), 1, image)[0]
    return found


def naive_colors(pieces: np.ndarray, trust: np.ndarray, n: int, color: np.ndarray) -> np.ndarray:
    """The histograms (n, CELLS), pixel by pixel and cell by cell."""
    found = np.zeros((n, CHROMA_CELLS, CHROMA_CELLS, LIGHT_CELLS))
    for v in range(STEP // 2, len(pieces), STEP):
        for u in range(STEP // 2, pieces.shape[1], STEP):
            rgb = color[v, u] + DARK
            at = (*(rgb[:2] / rgb.sum() / CHROMA_STEP), np.log2(rgb.mean() / DARK) / LIGHT_STEP)
            hats = [np.maximum(0.0, 1.0 - np.abs(np.arange(m) - x)) for m, x in zip(found.shape[1:], at, strict=True)]
            if pieces[v, u] > 0:
                found[pieces[v, u] - 1] += trust[v, u] ** 4 * np.einsum("i,j,k->ijk", *hats)
    flat = found.reshape(n, CELLS)
    return flat / np.maximum(flat.sum(axis=1, keepdims=True), 1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_histograms_match_the_naive_reference(seed):
    rng = np.random.default_rng(seed)
    pieces = rng.integers(0, 4, (24, 30)).astype(np.int32)
    trust = rng.random((24, 30)).astype(np.float32)
    color = rng.integers(0, 256, (24, 30, 3)).astype(np.uint8)
    found = piece_colors(pieces, trust, 3, color)
    assert found == pytest.approx(naive_colors(pieces, trust, 3, color), abs=1e-5)
    assert found.sum(axis=1) == pytest.approx(np.ones(3), abs=1e-5)


@given(shades, shades)
def test_likeness_is_symmetric_within_bounds_and_one_for_the_same(one, other):
    a, b = plain(one), plain(other)
    assert likeness(a, b) == pytest.approx(float(likeness(b, a)))
    assert -1e-6 <= likeness(a, b) <= 1.0 + 1e-5
    assert likeness(a, 3.0 * a) == pytest.approx(1.0, abs=1e-5)


@given(shades, shades)
def test_distance_is_the_root_of_the_logarithm_of_likeness_and_nothing_is_far_from_itself(one, other):
    a, b = plain(one), plain(other)
    assert distance(a, b) == distance(b, a)
    assert distance(a, a) == 0.0
    assert distance(a, 3.0 * a) == pytest.approx(0.0, abs=1e-3)
    assert np.exp(-(distance(a, b) ** 2)) == pytest.approx(float(likeness(a, b)), abs=1e-5)
    assert np.isnan(distance(no_colors(), a))


@given(st.floats(2.0, 4.0), st.floats(0.0, 20.0), st.integers(30, 40))
def test_distance_is_how_many_widths_two_bells_are_apart(width, apart, cells):
    cell = np.arange(4 * cells)
    bells = [np.exp(-((cell - 2 * cells - off) ** 2) / (2 * width**2)) for off in (-0.5 * apart, 0.5 * apart)]
    assert distance(*bells) == pytest.approx(apart / width / np.sqrt(8.0), rel=1e-2, abs=1e-2)


@given(st.tuples(*[st.integers(60, 255)] * 3), st.floats(0.75, 1.0))
def test_light_and_shade_change_little(color, shade):
    darker = tuple(round(shade * channel) for channel in color)
    assert likeness(plain(color), plain(darker)) > 0.85  # type: ignore[arg-type]


@pytest.mark.parametrize("other", [(50, 110, 190), (230, 180, 50), (70, 150, 90), (150, 80, 160), (35, 35, 38)])
def test_what_anybody_would_call_another_colour_is_unlike(other):
    assert likeness(plain((200, 60, 50)), plain(other)) < 0.3


def test_a_rim_that_is_not_to_be_trusted_tells_nothing():
    color = np.full((16, 16, 3), (200, 60, 50), np.uint8)
    color[:, 8:] = (50, 110, 190)
    trust = np.ones((16, 16), np.float32)
    trust[:, 8:] = 0.1
    found = piece_colors(np.ones((16, 16), np.int32), trust, 1, color)[0]
    assert likeness(found, plain((200, 60, 50))) > 0.99


def test_what_was_seen_without_colour_is_like_nothing_that_is_known():
    pieces, trust = np.ones((8, 8), np.int32), np.ones((8, 8), np.float32)
    assert not piece_colors(pieces, trust, 2, None).any()
    assert np.isnan(likeness(no_colors(), plain((10, 20, 30))))


def naive_main_block(colors: np.ndarray) -> tuple[float, ...]:
    cells = colors.astype(np.float64).reshape(CHROMA_CELLS, CHROMA_CELLS, LIGHT_CELLS)
    blocks = np.lib.stride_tricks.sliding_window_view(cells, (2, 2, 2))
    sums = blocks.sum(axis=(3, 4, 5))
    best = np.unravel_index(int(sums.argmax()), sums.shape)
    middle = [at + blocks[best].take(1, axis).sum() / sums[best] for axis, at in enumerate(best)]
    return (float(sums[best] / cells.sum()), *map(float, middle))


@pytest.mark.parametrize("seed", range(5))
def test_the_main_block_matches_the_naive_reference(seed):
    colors = np.random.default_rng(seed).random(CELLS).astype(np.float32)
    assert main_block(colors) == pytest.approx(naive_main_block(colors), rel=1e-4)


@given(shades)
def test_the_main_colour_of_one_colour_is_that_colour(color):
    assert main_color(plain(color)) == pytest.approx(color, abs=1.0)


def test_what_shows_no_colour_mainly_has_none():
    assert main_color(no_colors()) is None
    mixed = sum((plain(c) for c in ((250, 10, 10), (10, 250, 10), (10, 10, 250))), no_colors())
    assert main_color(mixed) is None


@pytest.mark.parametrize("light", [1.0, 0.85, 0.75])
@pytest.mark.parametrize(
    ("color", "name"),
    [
        ((200, 40, 35), "red"), ((50, 110, 190), "blue"), ((70, 150, 90), "green"), ((230, 190, 40), "yellow"),
        ((240, 140, 30), "orange"), ((185, 145, 95), "brown"), ((120, 75, 45), "brown"), ((150, 80, 160), "purple"),
        ((240, 170, 190), "pink"), ((235, 235, 230), "white"), ((110, 112, 115), "grey"), ((35, 35, 38), "black"),
        ((220, 205, 175), "beige"),
    ],
)  # fmt: skip
def test_colours_are_called_as_people_call_them_in_light_and_shade(color, name, light):
    assert color_name(*(light * channel for channel in color)) == name
