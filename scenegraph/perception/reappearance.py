"""Is what appears here what has gone from there? Things keep their identity when they are carried elsewhere.

A thing that was looked for in vain is remembered for a while. One that appears later, of its class, its size and its
colours, is that thing. All that came and all that has gone are matched at once, one to one, so that they fit best
together; and anew with every look while what came is new, so that it is not the order of looking that decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mapping.colors import distance, no_colors
from scenegraph.graph import Node

Array: TypeAlias = NDArray[Any]

WINDOW_S = 7 * 86_400.0
"""How long what has gone may come back as itself."""
MOST_REMEMBERED = 1000
SIZE_LOG = 0.15
SIZE_M = 0.05
"""Edges of two boxes of one thing differ by this factor (natural logarithm), beside so many metres, …"""
COLORS = 0.1
"""… and their colours are so far apart, at one standard deviation each. Of 1036 loose things of simulated homes that
were mapped on two tours from nothing, one in twenty was farther from itself than 0.14, and three quarters of the others
of their class farther than 0.27; sizes tell less: half of the others are as alike as nine in ten to themselves."""
MOST_UNLIKE = 13.0
"""No more than this is taken for the same thing: seen badly on one tour, a thing is unlike itself by up to 7, where it
was carried elsewhere by 3 to 5 more; …"""
COMMON = 1.5
"""… less by this times the natural logarithm of how many things of the class are known: the only microwave comes back
with another side to the front, but one book of many is soon like another."""
ELSEWHERE = 3.0
FAR = 3.0
FAR_M = 8.0
"""What is not where it was is unlike it by so much, and by so much more when it is far from there: of things that look
the same the nearest is the likeliest."""
DOUBTED = 1.0
"""So much speaks against a thing that was looked for in vain, but not often enough to have gone."""
SETTLED = 0.5
"""What was taken for one thing becomes another when all fits together better by more than this."""
UNSETTLED_S = 600.0
"""What came is new for so long."""
SAME_PLACE_M = 0.3
"""What appears no farther than this from where it was has not been moved."""


@dataclass(frozen=True, eq=False)
class Look:
    """How a thing looks: edge lengths (3,) of its box, the longer horizontal one first [m], and its colours (CELLS,),
    see `mapping.colors`; all 0 where it was seen without colour."""

    size: tuple[float, float, float]
    colors: NDArray[np.float32]

    @staticmethod
    def of(node: Node, colors: NDArray[np.float32]) -> Look:
        size = np.zeros(3) if node.box is None else node.box.size
        a, b, c = size.tolist()
        return Look((max(a, b), min(a, b), c), colors.copy())

    def unlike(self, others: Sequence[Look]) -> NDArray[np.float64]:
        """How unlike n others are, (n,): a sum of standard deviations; the edges of a box count as one."""
        if not others:
            return np.empty(0)
        edges = np.log(np.maximum([self.size, *(other.size for other in others)], SIZE_M))
        size = np.abs(edges[1:] - edges[0]).mean(axis=1) / SIZE_LOG
        colors = distance(self.colors, np.array([other.colors for other in others])) / COLORS
        unlike: NDArray[np.float64] = size + np.nan_to_num(colors)
        return unlike


@dataclass(frozen=True)
class Absent:
    """A thing that has gone: its last node, how it looked, and when it was found to have gone."""

    node: Node
    look: Look
    left_ns: int


@dataclass(frozen=True)
class Arrival:
    """When something came, and what it is taken for: something that had gone, or nothing known."""

    came_ns: int
    was: Absent | None = None


class Reappearance:
    """Remembers what has gone, and what came since and may be it."""

    def __init__(self) -> None:
        self.absent: dict[str, Absent] = {}
        self.newcomers: dict[str, Arrival] = {}
        """By node id; one that is taken for something that had gone has its id."""

    def leave(self, node: Node, look: Look, stamp_ns: int) -> None:
        """A thing has gone."""
        self.newcomers.pop(node.id, None)
        self.absent[node.id] = Absent(node, look, stamp_ns)
        while len(self.absent) > MOST_REMEMBERED:
            del self.absent[next(iter(self.absent))]

    def arrive(self, node: Node, stamp_ns: int) -> None:
        """Something has appeared that is nothing known."""
        self.newcomers[node.id] = Arrival(node.first_seen_ns)
        while (
            stamp_ns - self.newcomers[oldest := next(iter(self.newcomers))].came_ns > UNSETTLED_S * 1e9
            or len(self.newcomers) > MOST_REMEMBERED
        ):
            del self.newcomers[oldest]

    def settle(
        self, came: Sequence[tuple[Node, Look]], doubted: Sequence[tuple[Node, Look]], stamp_ns: int, there: int = 0
    ) -> dict[str, Absent | None]:
        """What newcomers of one class, as they look now, are otherwise than was thought: their node id → what each was
        before; None: nothing that is known.

        doubted : things of that class that at least one look did not find where they were
        there : how many things of that class are known to be somewhere, the doubted too
        """
        arrivals = [self.newcomers[node.id] for node, _ in came]
        gone = {one.was.node.id: one.was for one in arrivals if one.was is not None}
        missed = {
            one.node.id: one
            for one in self.absent.values()
            if one.node.label == came[0][0].label and stamp_ns - one.left_ns <= WINDOW_S * 1e9
        }
        most_unlike = MOST_UNLIKE - COMMON * np.log(max(1, there + len(missed)))
        gone |= missed
        sure = len(gone)
        gone |= {node.id: Absent(node, look, stamp_ns) for node, look in doubted if node.id not in gone}
        known = list(gone.values())
        if not known:
            return {}
        gain = np.zeros((len(came), len(known)))
        for row, ((node, look), arrival) in enumerate(zip(came, arrivals, strict=True)):
            gain[row] = most_unlike - look.unlike([one.look for one in known]) - _away(node, known)
            gain[row, sure:] -= DOUBTED
            gain[row] += [SETTLED * (one is arrival.was) for one in known]
            gain[row, [one.node.last_seen_ns >= arrival.came_ns for one in known]] = 0.0
        gain = np.maximum(gain, 0.0)
        rows, columns = linear_sum_assignment(gain, maximize=True)
        now = {int(r): known[c] for r, c in zip(rows, columns, strict=True) if gain[r, c] > 0.0}
        return {
            node.id: now.get(row)
            for row, ((node, _), arrival) in enumerate(zip(came, arrivals, strict=True))
            if now.get(row) is not arrival.was
        }

    def know(self, node_id: str, arrival: Arrival) -> None:
        """A newcomer is known under this id from now on, as what it was."""
        self.newcomers[node_id] = arrival
        self.absent.pop(node_id, None)

    def misses(self, label: str) -> bool:
        """Whether something of that class has gone."""
        return any(one.node.label == label for one in self.absent.values())

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """What is remembered, as JSON values."""
        return {
            "absent": [_absent_document(one) for one in self.absent.values()],
            "newcomers": [
                [node_id, one.came_ns, one.was and _absent_document(one.was)] for node_id, one in self.newcomers.items()
            ],
        }

    def restore(self, document: Mapping[str, Any]) -> None:
        """Take over what `document` gave."""
        self.absent = {one.node.id: one for one in map(_absent_of, document["absent"])}
        self.newcomers = {
            node_id: Arrival(came_ns, was and _absent_of(was)) for node_id, came_ns, was in document["newcomers"]
        }


def _absent_document(one: Absent) -> list[Any]:
    filled = np.flatnonzero(one.look.colors)
    pairs = list(zip(filled.tolist(), one.look.colors[filled].tolist(), strict=True))
    return [one.node.model_dump(mode="json"), list(one.look.size), pairs, one.left_ns]


def _absent_of(document: Sequence[Any]) -> Absent:
    fields, (a, b, c), pairs, left_ns = document
    look = Look((a, b, c), no_colors())
    for cell, share in pairs:
        look.colors[cell] = share
    return Absent(Node.model_validate(fields), look, left_ns)


def _away(node: Node, known: Sequence[Absent]) -> NDArray[np.float64]:
    """What speaks against a node being each of the known (n,), by the way between them."""
    way = np.linalg.norm(np.array([one.node.position for one in known]) - node.position, axis=1)
    return np.asarray(ELSEWHERE * np.minimum(way / SAME_PLACE_M, 1.0) + FAR * np.minimum(way / FAR_M, 1.0))
