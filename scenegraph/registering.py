"""Where one graph lies in another: heading and translation from the things that both hold; gravity is known.

Pairs of things of one class and size are candidates; two candidates that keep their distance propose a heading and a
translation; proposals are voted over a grid, the best are refined on all things (closest of the class, one to one), and
the one that joins most things wins. When another, different one joins almost as many, nobody can tell which is right.
After geometric consistency as used for loop closures (Olson, 2009) and Hough voting of poses; deterministic.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mapping.geometry import SE3
from scenegraph.errors import JoinRefused
from scenegraph.facts import class_atom
from scenegraph.graph import Node

__all__ = ["Alignment", "register"]

Array: TypeAlias = NDArray[Any]

LEAST_JOINED = 4
"""Three things of the right classes lie alike by chance too often."""
MOST_OF_BEST = 0.7
"""A different alignment that joins more than this share of what the best joins makes it ambiguous."""
TOLERANCE_M = 0.3
"""Things may have been seen, or moved, so far from their true place."""
LEAST_BASE_M = 1.0
"""Things that are closer together say too little of the heading."""
SIZE_SLACK = (0.15, 0.35)
"""Sizes of one thing differ by at most so many metres plus this share: parts of it were not seen."""
MOST_CANDIDATES = 500
MOST_REFINED = 24
YAW_CELL = math.radians(8.0)
CELL_M = 0.75
DIFFERENT_YAW = math.radians(15.0)
DIFFERENT_M = 1.0


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where theirs lies in ours.

    T_ours_theirs   heading and translation
    joined          how many things it lays on one another;  of: how many could be, of the smaller graph
    rms_m           how far apart those are
    runner_up       how many the best different alignment joins
    """

    T_ours_theirs: SE3
    joined: int
    of: int
    rms_m: float
    runner_up: int


@dataclass(frozen=True)
class _Things:
    """Objects of one graph: places (N, 3) and sorted sizes (N, 3) [m], classes (N,) as numbers."""

    places: Array
    sizes: Array
    classes: Array


def register(ours: Sequence[Node], theirs: Sequence[Node]) -> Alignment:
    """The alignment of their objects with ours. Things that moved or that only one graph holds do no harm.

    Raises JoinRefused when too few things are alike, or another alignment is almost as good.
    """
    numbers: dict[str, int] = {}
    a, b = _things(ours, numbers), _things(theirs, numbers)
    pairs = _candidates(a, b)
    most = sum((Counter(a.classes.tolist()) & Counter(b.classes.tolist())).values())
    if most < LEAST_JOINED:
        raise JoinRefused(
            f"the graphs cannot be laid on one another: {most} things of the same classes in both, "
            f"expected at least {LEAST_JOINED}",
            hint="give T_ours_theirs",
        )
    middle = b.places.mean(axis=0)
    found: list[tuple[int, float, Array]] = []
    for proposal in _proposals(a, b, pairs, middle):
        refined = _refined(a, b, proposal, middle)
        if refined is not None:
            found.append(refined)
    found.sort(key=lambda item: (-item[0], item[1]))
    if not found or found[0][0] < LEAST_JOINED:
        best = found[0][0] if found else 0
        raise JoinRefused(
            f"the graphs cannot be laid on one another: at most {best} things fit, expected at least {LEAST_JOINED}",
            hint="give T_ours_theirs, or join graphs that overlap more",
        )
    joined, rms, pose = found[0]
    runner_up = max((count for count, _, other in found[1:] if _differ(pose, other)), default=0)
    if runner_up > MOST_OF_BEST * joined:
        raise JoinRefused(
            f"the graphs fit on one another in more than one way: {joined} things one way, {runner_up} another",
            hint="give T_ours_theirs",
        )
    return Alignment(_transform(pose, middle), joined, min(len(a.places), len(b.places)), rms, runner_up)


def _things(nodes: Sequence[Node], numbers: dict[str, int]) -> _Things:
    sizes = [np.zeros(3) if node.box is None else np.sort(node.box.size) for node in nodes]
    return _Things(
        np.array([node.position for node in nodes]).reshape(-1, 3),
        np.array(sizes).reshape(-1, 3),
        np.array([numbers.setdefault(class_atom(node.label), len(numbers)) for node in nodes], np.int64),
    )


def _candidates(a: _Things, b: _Things) -> Array:
    """(C, 2) rows of ours and theirs of one class and about one size; the rarest classes first, and of those that are
    too many the most alike."""
    groups = []
    for number in sorted(set(a.classes.tolist()) & set(b.classes.tolist())):
        i, j = np.flatnonzero(a.classes == number), np.flatnonzero(b.classes == number)
        if len(i) * len(j) > 100 * MOST_CANDIDATES:
            continue
        rows = np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).reshape(-1, 2)
        one, other = a.sizes[rows[:, 0]], b.sizes[rows[:, 1]]
        unlike = np.abs(one - other) - SIZE_SLACK[1] * np.maximum(one, other)
        alike = (unlike <= SIZE_SLACK[0]).all(axis=1)
        order = np.argsort(np.abs(one - other).sum(axis=1)[alike], kind="stable")
        groups.append(rows[alike][order][:MOST_CANDIDATES])
    groups.sort(key=len)
    return np.concatenate(groups)[:MOST_CANDIDATES] if groups else np.empty((0, 2), np.int64)


def _proposals(a: _Things, b: _Things, pairs: Array, middle: Array) -> list[Array]:
    """Poses (yaw, x, y, z) of their middle in ours that most pairs of candidates vote for, best first."""
    p, q = np.triu_indices(len(pairs), 1)
    if not len(p):
        return []
    (ip, jp), (iq, jq) = pairs[p].T, pairs[q].T
    ours, theirs = a.places[iq] - a.places[ip], b.places[jq] - b.places[jp]
    base = np.hypot(theirs[:, 0], theirs[:, 1])
    consistent = (
        (ip != iq)
        & (jp != jq)
        & (base >= LEAST_BASE_M)
        & (np.abs(np.hypot(ours[:, 0], ours[:, 1]) - base) <= TOLERANCE_M)
        & (np.abs(ours[:, 2] - theirs[:, 2]) <= TOLERANCE_M)
    )
    ours, theirs, base = ours[consistent], theirs[consistent], base[consistent]
    if not len(ours):
        return []
    yaw = np.arctan2(ours[:, 1], ours[:, 0]) - np.arctan2(theirs[:, 1], theirs[:, 0])
    here = 0.5 * (a.places[ip] + a.places[iq])[consistent]
    there = 0.5 * (b.places[jp] + b.places[jq])[consistent] - middle
    c, s = np.cos(yaw), np.sin(yaw)
    at = here - np.column_stack([c * there[:, 0] - s * there[:, 1], s * there[:, 0] + c * there[:, 1], there[:, 2]])
    poses = np.column_stack([yaw % (2 * np.pi), at])
    n_yaw = round(2 * np.pi / YAW_CELL)
    cells = np.floor(poses / [2 * np.pi / n_yaw, CELL_M, CELL_M, CELL_M]).astype(np.int64)
    cells[:, 0] %= n_yaw
    keys, of_key, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    row_of = {tuple(key): row for row, key in enumerate(keys.tolist())}
    around = np.stack(np.meshgrid(*[(-1, 0, 1)] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    votes = counts.astype(np.int64)
    busiest = np.argsort(-counts, kind="stable")[: 20 * MOST_REFINED]
    for row in busiest.tolist():
        near = _wrapped(keys[row] + around, n_yaw)
        votes[row] = sum(counts[row_of[key]] for key in near if key in row_of)
    best = sorted(busiest.tolist(), key=lambda row: (-votes[row], row))
    proposals: list[Array] = []
    for row in best:
        members = poses[of_key == row]
        turn = math.atan2(float(np.sin(members[:, 0]).mean()), float(np.cos(members[:, 0]).mean()))
        proposal = np.array([turn, *members[:, 1:].mean(axis=0)])
        if all(_differ(proposal, other, 0.5) for other in proposals):
            proposals.append(proposal)
            if len(proposals) == MOST_REFINED:
                break
    return proposals


def _wrapped(cells: Array, n_yaw: int) -> list[tuple[int, ...]]:
    wrapped = cells.copy()
    wrapped[:, 0] %= n_yaw
    return [tuple(cell) for cell in wrapped.tolist()]


def _refined(a: _Things, b: _Things, pose: Array, middle: Array) -> tuple[int, float, Array] | None:
    """How many things lie on one another, how far apart they are, and the pose after closest things were laid on one
    another, from coarse to fine."""
    for reach in (3.0 * TOLERANCE_M, 2.0 * TOLERANCE_M, TOLERANCE_M, TOLERANCE_M):
        i, j = _closest(a, b, pose, middle, reach)
        if len(i) < 2:
            return None
        pose = _fitted(a.places[i], b.places[j] - middle)
    i, j = _closest(a, b, pose, middle, TOLERANCE_M)
    apart = np.linalg.norm(a.places[i] - _placed(b.places[j], pose, middle), axis=1)
    return len(i), float(np.sqrt((apart**2).mean())) if len(i) else 0.0, pose


def _closest(a: _Things, b: _Things, pose: Array, middle: Array, reach: float) -> tuple[Array, Array]:
    """Rows of things of one class that are each other's closest, at most `reach` apart."""
    apart = 1e3 * max(1.0, reach)  # classes lie as far apart in a fourth dimension
    one = np.column_stack([a.places, apart * a.classes])
    other = np.column_stack([_placed(b.places, pose, middle), apart * b.classes])
    distance, i_of = cKDTree(one).query(other, distance_upper_bound=reach)
    _, j_of = cKDTree(other).query(one, distance_upper_bound=reach)
    j = np.flatnonzero(np.isfinite(distance))
    mutual = j_of[i_of[j]] == j
    return i_of[j][mutual], j[mutual]


def _fitted(here: Array, there: Array) -> Array:
    """The pose (yaw, x, y, z) that lays points (N, 3) on others in the least-squares sense (Umeyama, in the plane)."""
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    yaw = math.atan2(float((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum()), float((a[:, :2] * b[:, :2]).sum()))
    return np.array([yaw, *(here.mean(axis=0) - _turned(there.mean(axis=0)[None], yaw)[0])])


def _placed(points: Array, pose: Array, middle: Array) -> Array:
    return _turned(points - middle, float(pose[0])) + pose[1:]


def _turned(points: Array, yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], points[:, 2]])


def _differ(one: Array, other: Array, share: float = 1.0) -> bool:
    turn = abs((float(one[0] - other[0]) + np.pi) % (2 * np.pi) - np.pi)
    return bool(turn > share * DIFFERENT_YAW or np.linalg.norm(one[1:] - other[1:]) > share * DIFFERENT_M)


def _transform(pose: Array, middle: Array) -> SE3:
    turn = SE3.exp((0.0, 0.0, 0.0, 0.0, 0.0, float(pose[0])))
    return SE3(turn.rotation, pose[1:]) @ SE3(np.eye(3), -middle)
