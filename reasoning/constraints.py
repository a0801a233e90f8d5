"""The cheapest labels that go together: a weighted constraint network, solved with a proof.

Variables have a few values each, at a cost; pairs of variables say which of their values go together. A sweep of
arc consistency takes away what goes with nothing. Costs are then moved along the arcs until the sum of what every
variable costs at least, a lower bound, rises no more (max-product linear programming, Globerson & Jaakkola 2007).
Branch and bound with forward checking closes what gap is left, part by part: whenever what is open falls apart into
parts without constraints between them, each is solved for itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["Optimum", "cheapest"]

Array: TypeAlias = NDArray[Any]

MOST_SWEEPS = 60
LEAST_GAIN = 1e-4
"""Costs are moved along the arcs so often at most, and while the bound rises by so much a sweep."""
MARGIN = 1e-7
"""Costs that differ by less are equal."""


class Optimum(NamedTuple):
    """values (N,) of the variables, what they cost, and what every choice of values costs at least [the same unit].

    Where `bound` is as high as `cost` no other values are cheaper.
    """

    values: NDArray[np.int64]
    cost: float
    bound: float


def cheapest(costs: Array, arcs: Array, fits: Array, *, most_steps: int = 10_000_000) -> Optimum:
    """The cheapest values of N variables that go together.

    costs (N, D) float64: what each value costs, inf where a variable cannot have it; each has one at least
    arcs  (M, 2) int64: pairs of different variables, none of them twice
    fits  (M, D, D) bool: which values of the first and the second go together

    Pairs that are contradictory before anything was chosen (both settled, or all of one's values against all of the
    other's) are passed over. After `most_steps` operations on variables the best that was found is taken.
    """
    costs = np.ascontiguousarray(costs, np.float64)
    first, links = _adjacency(len(costs), np.ascontiguousarray(arcs, np.int64))
    values, cost, bound = _solve(
        costs, np.ascontiguousarray(arcs, np.int64), np.ascontiguousarray(fits, np.bool_), first, links, most_steps
    )
    return Optimum(values, cost, bound)


class _State(NamedTuple):
    """What the search works on: arrays over variables (N), values (D), arcs (M) and links (2 M).

    unary, pairs  costs as they were moved, never negative on pairs; unary inf where a value is out of the question
    used          arcs that can matter;  is_open  variables to be decided;  chosen  what was decided
    steps         (1,) of the search that are left
    """

    unary: Array
    pairs: Array
    arcs: Array
    first: Array
    links: Array
    used: Array
    is_open: Array
    chosen: Array
    steps: Array


@numba.njit(cache=True)
def _adjacency(n, arcs):  # type: ignore[no-untyped-def]
    """For each variable its links, 2·arc or 2·arc + 1 where it is the arc's second: first (n + 1,), links (2 M,)."""
    first = np.zeros(n + 1, np.int64)
    for a in range(len(arcs)):
        first[arcs[a, 0] + 1] += 1
        first[arcs[a, 1] + 1] += 1
    first = np.cumsum(first)
    at, links = first[:-1].copy(), np.empty(2 * len(arcs), np.int64)
    for a in range(len(arcs)):
        for end in range(2):
            links[at[arcs[a, end]]] = 2 * a + end
            at[arcs[a, end]] += 1
    return first, links


@numba.njit(cache=True)
def _solve(costs, arcs, fits, first, links, most_steps):  # type: ignore[no-untyped-def]
    n, d = costs.shape
    possible = np.isfinite(costs)
    used = np.ones(len(arcs), np.bool_)
    _make_consistent(possible, arcs, fits, first, links, used)
    dearest = 1.0
    for i in range(n):
        most = 0.0
        for x in range(d):
            if possible[i, x]:
                most = max(most, costs[i, x])
        dearest += most
    unary = np.where(possible, costs, np.inf)
    pairs = np.zeros((len(arcs), d, d))
    is_open = possible.sum(axis=1) > 1
    for a in range(len(arcs)):
        i, j = arcs[a, 0], arcs[a, 1]
        used[a] = used[a] and is_open[i] and is_open[j] and not _free(possible, fits[a], i, j)
        if used[a]:
            for x in range(d):
                for y in range(d):
                    pairs[a, x, y] = 0.0 if fits[a, x, y] else dearest
    _move_costs(unary, pairs, arcs, used)
    state = _State(unary, pairs, arcs, first, links, used, is_open, np.zeros(n, np.int64), np.array([most_steps]))
    values, total, bound = np.zeros(n, np.int64), 0.0, 0.0
    everything = np.flatnonzero(is_open)
    for i in range(n):
        if not is_open[i]:
            values[i] = np.argmax(possible[i])
    for part in _parts(everything, state):
        least = _least(part, unary)
        state.steps[0] = most_steps * len(part) // len(everything)
        _search(part, np.inf, state)
        if state.steps[0] > 0:
            least = np.inf
        cost = 0.0
        for i in part:
            values[i] = state.chosen[i]
            cost += costs[i, values[i]]
        total += cost
        bound += min(least, cost)
    for i in range(n):
        if not is_open[i]:
            total += costs[i, values[i]]
            bound += costs[i, values[i]]
    return values, total, bound


@numba.njit(cache=True)
def _make_consistent(possible, arcs, fits, first, links, used):  # type: ignore[no-untyped-def]
    """Take away, in place, what goes with nothing; arcs that would leave a variable without value are not `used`."""
    n, d = possible.shape
    waiting = np.ones(n, np.bool_)
    again = True
    while again:
        again = False
        for i in range(n):
            if not waiting[i]:
                continue
            waiting[i] = False
            for k in range(first[i], first[i + 1]):
                a = links[k] >> 1
                if not used[a]:
                    continue
                second = links[k] & 1
                j = arcs[a, 1 - second]
                left, lost = 0, 0
                out = np.zeros(d, np.bool_)
                for y in range(d):
                    if not possible[j, y]:
                        continue
                    supported = False
                    for x in range(d):
                        if possible[i, x] and (fits[a, y, x] if second else fits[a, x, y]):
                            supported = True
                            break
                    if supported:
                        left += 1
                    else:
                        lost += 1
                        out[y] = True
                if left == 0:
                    used[a] = False
                elif lost:
                    possible[j] &= ~out
                    waiting[j] = again = True


@numba.njit(cache=True)
def _free(possible, fits, i, j):  # type: ignore[no-untyped-def]
    """Whether all values that are possible for two variables go together."""
    d = possible.shape[1]
    for x in range(d):
        for y in range(d):
            if possible[i, x] and possible[j, y] and not fits[x, y]:
                return False
    return True


@numba.njit(cache=True)
def _move_costs(unary, pairs, arcs, used):  # type: ignore[no-untyped-def]
    """Move costs between variables and arcs, in place, so that the sum of the variables' least costs rises."""
    d = unary.shape[1]
    mine, theirs = np.empty(d), np.empty(d)
    for _ in range(MOST_SWEEPS):
        gain = 0.0
        for a in range(len(arcs)):
            if not used[a]:
                continue
            i, j = arcs[a, 0], arcs[a, 1]
            pair = pairs[a]
            before = unary[i].min() + unary[j].min()
            mine[:] = np.inf
            theirs[:] = np.inf
            for x in range(d):
                for y in range(d):
                    together = unary[i, x] + unary[j, y] + pair[x, y]
                    mine[x] = min(mine[x], together)
                    theirs[y] = min(theirs[y], together)
            for x in range(d):
                for y in range(d):
                    together = unary[i, x] + unary[j, y] + pair[x, y]
                    pair[x, y] = max(0.0, together - 0.5 * (mine[x] + theirs[y])) if together < np.inf else 0.0
            unary[i] = 0.5 * mine
            unary[j] = 0.5 * theirs
            gain += unary[i].min() + unary[j].min() - before
        if gain < LEAST_GAIN:
            break


@numba.njit(cache=True)
def _least(part, unary):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in part:
        total += unary[i].min()
    return total


@numba.njit(cache=True)
def _parts(part, state):  # type: ignore[no-untyped-def]
    """The open ones of some variables, by the parts into which they fall."""
    inside = np.zeros(len(state.is_open), np.bool_)
    for i in part:
        inside[i] = state.is_open[i]
    found = []
    stack = np.empty(len(part), np.int64)
    for start in part:
        if not inside[start]:
            continue
        inside[start] = False
        stack[0] = start
        low, high = 0, 1
        while low < high:
            i = stack[low]
            low += 1
            for k in range(state.first[i], state.first[i + 1]):
                a = state.links[k] >> 1
                j = state.arcs[a, 1 - (state.links[k] & 1)]
                if state.used[a] and inside[j]:
                    inside[j] = False
                    stack[high] = j
                    high += 1
        found.append(stack[:high].copy())
    return found


@numba.njit(cache=True)
def _settle(i, x, state):  # type: ignore[no-untyped-def]
    """Give a variable its value; its open neighbours pay what goes with that. Returns what it costs by itself."""
    state.chosen[i] = x
    state.is_open[i] = False
    for k in range(state.first[i], state.first[i + 1]):
        a = state.links[k] >> 1
        second = state.links[k] & 1
        j = state.arcs[a, 1 - second]
        if state.used[a] and state.is_open[j]:
            for y in range(state.unary.shape[1]):
                state.unary[j, y] += state.pairs[a, y, x] if second else state.pairs[a, x, y]
    return state.unary[i, x]


@numba.njit(cache=True)
def _narrow(part, cost, ceiling, state):  # type: ignore[no-untyped-def]
    """Take away values that would cost the ceiling or more, and settle what has one left. Returns what everything costs
    at least, with the `cost` that was settled before."""
    d = state.unary.shape[1]
    again = True
    while again:
        again = False
        least = cost
        for i in part:
            if state.is_open[i]:
                least += state.unary[i].min()
        if not least < ceiling:
            break
        for i in part:
            if not state.is_open[i]:
                continue
            lowest = state.unary[i].min()
            left, value = 0, 0
            for x in range(d):
                if least - lowest + state.unary[i, x] >= ceiling:
                    state.unary[i, x] = np.inf
                elif state.unary[i, x] < np.inf:
                    left += 1
                    value = x
            if left == 1:
                cost += _settle(i, value, state)
                again = True
                break
    return least


@numba.njit(cache=True)
def _branching(part, state):  # type: ignore[no-untyped-def]
    """The variable with the most open neighbours; of equals the one whose second choice costs most more."""
    best, best_degree, best_regret = part[0], -1, -1.0
    for i in part:
        degree = 0
        for k in range(state.first[i], state.first[i + 1]):
            a = state.links[k] >> 1
            degree += state.used[a] and state.is_open[state.arcs[a, 1 - (state.links[k] & 1)]]
        costs = np.sort(state.unary[i])
        regret = costs[1] - costs[0]
        if degree > best_degree or (degree == best_degree and regret > best_regret):
            best, best_degree, best_regret = i, degree, regret
    return best


@numba.njit(cache=True)
def _search(part, ceiling, state):  # type: ignore[no-untyped-def]
    """What the open variables of a part cost at least, below the ceiling, and `chosen` as that asks; inf where nothing
    is below. Leaves everything else as it was."""
    if len(part) == 1:
        i = part[0]
        state.chosen[i] = np.argmin(state.unary[i])
        lowest = state.unary[i].min()
        return lowest if lowest < ceiling else np.inf
    state.steps[0] -= len(part)
    i = _branching(part, state)
    before = state.unary[part].copy()
    best, answer = np.inf, np.zeros(len(part), np.int64)
    for x in np.argsort(state.unary[i]):
        limit = min(ceiling, best) - MARGIN
        if state.unary[i, x] == np.inf or (best < np.inf and state.steps[0] <= 0):
            break
        least = _narrow(part, _settle(i, x, state), limit, state)
        if least < limit:
            fits = True
            for rest in _parts(part, state):
                part_least = _least(rest, state.unary)
                found = _search(rest, limit - (least - part_least), state)
                if found == np.inf:
                    fits = False
                    break
                least += found - part_least
            if fits:
                best, answer = least, state.chosen[part]
        for k in range(len(part)):
            state.unary[part[k]] = before[k]
            state.is_open[part[k]] = True
    if best < np.inf:
        for k in range(len(part)):
            state.chosen[part[k]] = answer[k]
    return best
