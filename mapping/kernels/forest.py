"""Forests of numbered members: which belong together (union-find with path halving; Tarjan & van Leeuwen 1984).

A forest is `parent` (n,), whole numbers; a root is its own parent.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from numba import njit
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any


@njit(cache=True)
def root_of(parent: Array, n: Int) -> Int:
    """The root of member n; the way to it is halved, in place."""
    while parent[n] != n:
        parent[n] = parent[parent[n]]
        n = parent[n]
    return n


@njit(cache=True)
def join(parent: Array, a: Int, b: Int) -> None:
    """Make the trees of two members one, in place; its root is the lower of both roots."""
    a, b = root_of(parent, a), root_of(parent, b)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
