"""Simulated homes that several tests look at, each made once."""

from __future__ import annotations

from functools import cache

from scenegraph.simulation import Home, simulate_home

SEEDS = range(20)


@cache
def home(seed: int) -> Home:
    """The home of that seed."""
    return simulate_home(seed)
