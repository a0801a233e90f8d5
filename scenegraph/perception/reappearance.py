"""Is what appears here what has gone from there? Things keep their identity when they are carried elsewhere.

A thing that was looked for in vain is remembered for a while. One that appears later, of its class, its size and its
colours, is that thing: the best match of each, one to one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scenegraph.graph import Node

Array: TypeAlias = NDArray[Any]
Known: TypeAlias = "tuple[Node, Look]"

WINDOW_S = 7 * 86_400.0
"""How long what has gone may come back as itself."""
MOST_REMEMBERED = 1000
SIZE_LOG = 0.35
SIZE_M = 0.03
"""Edges of two boxes of one thing differ by this factor (natural logarithm), beside so many metres, …"""
TINT = 30.0
"""… and mean colours by so much (of 255), at one standard deviation each."""
MOST_MISFIT = 2.5
"""No more than this in standard deviations, all together, is taken for the same thing."""
SAME_PLACE_M = 0.3
"""What appears no farther than this from where it was has not been moved."""


@dataclass(frozen=True)
class Look:
    """How a thing looks: edge lengths (3,) of its box, the longer horizontal one first [m], and its mean colour (3,),
    None where it was seen without colour."""

    size: tuple[float, float, float]
    tint: tuple[float, float, float] | None

    @staticmethod
    def of(node: Node, tint: tuple[float, float, float, float]) -> Look:
        size = np.zeros(3) if node.box is None else node.box.size
        a, b, c = size.tolist()
        return Look((max(a, b), min(a, b), c), tint[:3] if tint[3] > 0.0 else None)

    def misfit(self, other: Look) -> float:
        """How many standard deviations two looks lie apart."""
        a, b = np.array(self.size), np.array(other.size)
        apart = np.maximum(np.abs(a - b) - SIZE_M, 0.0) / np.maximum(np.minimum(a, b), SIZE_M)
        square = float(np.mean((np.log1p(apart) / SIZE_LOG) ** 2))
        if self.tint is not None and other.tint is not None:
            square += float(np.sum((np.array(self.tint) - np.array(other.tint)) ** 2)) / TINT**2
        return float(np.sqrt(square))


@dataclass(frozen=True)
class Absent:
    """A thing that has gone: its last node, how it looked, and when it was found to have gone."""

    node: Node
    look: Look
    left_ns: int


class Reappearance:
    """Remembers what has gone, and what came since and may be it."""

    def __init__(self) -> None:
        self.absent: dict[str, Absent] = {}
        self.newcomers: dict[str, int] = {}
        """Node id → when it was first seen, of nodes that may turn out to be something known before."""

    def leave(self, node: Node, look: Look, stamp_ns: int) -> None:
        """A thing has gone."""
        self.newcomers.pop(node.id, None)
        self.absent[node.id] = Absent(node, look, stamp_ns)
        while len(self.absent) > MOST_REMEMBERED:
            del self.absent[next(iter(self.absent))]

    def arrive(self, node: Node, stamp_ns: int) -> None:
        """Something has appeared that is nothing known."""
        self.newcomers[node.id] = node.first_seen_ns
        window_ns = WINDOW_S * 1e9
        while (
            stamp_ns - self.newcomers[oldest := next(iter(self.newcomers))] > window_ns
            or len(self.newcomers) > MOST_REMEMBERED
        ):
            del self.newcomers[oldest]

    def who_is(self, node: Node, look: Look, stamp_ns: int, rivals: Iterable[Known] = ()) -> Absent | None:
        """The thing that a new node is, if it was known before and has gone.

        rivals : things that are thought to be where they were, but were not seen lately; when it is rather one of them,
                 time will tell
        """
        likely = [
            (_unlike(one.node, one.look, node, look), one.node.id, one)
            for one in self.absent.values()
            if one.node.label == node.label
            and one.node.last_seen_ns < node.first_seen_ns
            and stamp_ns - one.left_ns <= WINDOW_S * 1e9
        ]
        best = min(likely, default=None, key=lambda entry: entry[:2])
        if best is None or best[0] > MOST_MISFIT or best[0] > _least(rivals, node, look):
            return None
        return best[2]

    def where_is(self, gone: Node, look: Look, nodes: Iterable[tuple[Node, Look, Iterable[Known]]]) -> Node | None:
        """Of `nodes`, newcomers as they look now, each with its rivals, the one that a thing that has gone is now."""
        likely = [
            (_unlike(gone, look, node, theirs), node.id, node, _least(rivals, node, theirs))
            for node, theirs, rivals in nodes
            if node.label == gone.label and gone.last_seen_ns < node.first_seen_ns
        ]
        best = min((entry for entry in likely if entry[0] <= entry[3]), default=None, key=lambda entry: entry[:2])
        return best[2] if best is not None and best[0] <= MOST_MISFIT else None

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """What is remembered, as JSON values."""
        absent = [
            [one.node.model_dump(mode="json"), list(one.look.size), one.look.tint and list(one.look.tint), one.left_ns]
            for one in self.absent.values()
        ]
        return {"absent": absent, "newcomers": self.newcomers}

    def restore(self, document: Mapping[str, Any]) -> None:
        """Take over what `document` gave."""
        for fields, (a, b, c), tint, left_ns in document["absent"]:
            look = Look((a, b, c), None if tint is None else (tint[0], tint[1], tint[2]))
            node = Node.model_validate(fields)
            self.absent[node.id] = Absent(node, look, left_ns)
        self.newcomers = dict(document["newcomers"])


def _unlike(a: Node, a_look: Look, b: Node, b_look: Look) -> float:
    """How little one thing may be another: by its looks, and a little by the way between them."""
    return a_look.misfit(b_look) + min(0.5, 0.1 * float(np.linalg.norm(a.position - b.position)))


def _least(rivals: Iterable[Known], node: Node, look: Look) -> float:
    return min((_unlike(known, theirs, node, look) for known, theirs in rivals), default=np.inf)
