"""The cheapest values of a constraint network are those that trying all of them finds."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reasoning.constraints import cheapest


def network(seed: int, n: int, d: int, dense: float) -> tuple[Any, Any, Any]:
    """Random costs, arcs and fits; the last value goes with everything."""
    rng = np.random.default_rng(seed)
    costs = rng.uniform(0.0, 5.0, (n, d))
    costs[rng.random((n, d)) < 0.2] = np.inf
    costs[:, -1] = rng.uniform(1.0, 8.0, n)
    arcs = np.argwhere(np.triu(rng.random((n, n)) < dense, 1))
    fits = rng.random((len(arcs), d, d)) < 0.4
    fits[:, -1, :] = fits[:, :, -1] = True
    return costs, arcs, fits


def tried(costs: Any, arcs: Any, fits: Any) -> float:
    """What the cheapest values cost, by trying all."""
    every = product(*(np.flatnonzero(np.isfinite(row)) for row in costs))
    return min(sum(costs[i, x] for i, x in enumerate(values)) for values in every if fit(values, arcs, fits))


def fit(values: Any, arcs: Any, fits: Any) -> bool:
    return all(fits[k, values[i], values[j]] for k, (i, j) in enumerate(arcs))


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 7), d=st.integers(1, 4), dense=st.floats(0.0, 1.0))
def test_nothing_is_cheaper(seed: int, n: int, d: int, dense: float) -> None:
    costs, arcs, fits = network(seed, n, d, dense)
    found = cheapest(costs, arcs, fits)
    assert fit(found.values, arcs, fits)
    assert found.cost == pytest.approx(sum(costs[i, x] for i, x in enumerate(found.values)))
    assert found.cost == pytest.approx(tried(costs, arcs, fits), abs=1e-6)
    assert found.bound == pytest.approx(found.cost, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), steps=st.integers(1, 2000))
def test_broken_off_it_still_fits_and_is_not_below_its_bound(seed: int, steps: int) -> None:
    costs, arcs, fits = network(seed, 40, 4, 0.3)
    found = cheapest(costs, arcs, fits, most_steps=steps)
    assert fit(found.values, arcs, fits)
    assert found.bound <= found.cost + 1e-9
    assert found.cost >= cheapest(costs, arcs, fits, most_steps=200_000).bound - 1e-6


def test_contradictions_that_were_there_before_are_passed_over() -> None:
    costs = np.array([[0.0, np.inf], [0.0, np.inf], [2.0, 1.0]])
    arcs = np.array([[0, 1], [1, 2]])
    fits = np.array([[[False, True], [True, True]], [[True, False], [True, True]]])
    found = cheapest(costs, arcs, fits)
    assert found.values.tolist() == [0, 0, 0]
    assert (found.cost, found.bound) == (2.0, 2.0)
