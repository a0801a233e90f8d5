"""What comes back from a question: answers with their truth, and places to go to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from mapping.geometry import SE3
from reasoning.knowledge import Explanation, Problem, Reply
from scenegraph.facts import value_of
from scenegraph.graph import Node

__all__ = ["Answers", "GoalPose", "Place", "PlaceAnswer", "Region", "TellResult"]

Truth = Literal["true", "false", "unknown"]


@dataclass(frozen=True)
class Answers:
    """The answers to a goal: iterating yields mappings from variable name to a `Node` or a plain value.

    truth      "true" with at least one answer; "unknown" without one where one is possible; else "false"
    problem    None, or why the goal could not be asked to the end
    truncated  whether there were more answers than the limit
    revision   of the graph that was asked
    """

    reply: Reply
    revision: int
    _nodes: Mapping[str, Node] = field(repr=False)
    _why: Callable[[], Explanation | None] | None = field(default=None, repr=False, compare=False)
    """Asks again, this time for the explanation."""

    @property
    def truth(self) -> Truth:
        return self.reply.truth

    @property
    def problem(self) -> Problem | None:
        return self.reply.problem

    @property
    def truncated(self) -> bool:
        return self.reply.truncated

    @property
    def elapsed_ms(self) -> float:
        return self.reply.elapsed_ms

    def explain(self) -> Explanation | None:
        """Why it holds, or why not: rules, facts, measured values and thresholds. None when the goal could not be
        asked.

        It is made when it is asked for first, from what is known then: call it before the world is changed or closed.
        """
        return self._explanation

    @cached_property
    def _explanation(self) -> Explanation | None:
        known = self.reply.explanation
        return self._why() if known is None and self._why is not None else known

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for row in self.reply.answers:
            yield {name: value_of(term, self._nodes) for name, term in row.items()}

    def __len__(self) -> int:
        return len(self.reply.answers)

    def __bool__(self) -> bool:
        return self.truth == "true"


@dataclass(frozen=True)
class Region:
    """Ground polygon (corners x, y [m]) and a range of heights [m]."""

    polygon: tuple[tuple[float, float], ...]
    z_min: float
    z_max: float


@dataclass(frozen=True)
class GoalPose:
    """A pose of base_link to drive to.

    clearance_m    distance to the nearest obstacle or unknown space
    path_length_m  way to get there from where the robot is; None when the robot's place is not known
    """

    pose: SE3
    clearance_m: float
    path_length_m: float | None


@dataclass(frozen=True)
class PlaceAnswer:
    """One way to read a phrase: the nodes it is about, the region it means, and poses to go to, best first."""

    nodes: tuple[str, ...]
    region: Region
    poses: tuple[GoalPose, ...]


@dataclass(frozen=True)
class Place:
    """The answer to `where`. `ambiguous` holds the ids that the phrase could mean when it asks for one and fits
    several."""

    truth: Truth
    phrase: str
    answers: tuple[PlaceAnswer, ...] = ()
    ambiguous: tuple[str, ...] = ()
    problem: Problem | None = None


@dataclass(frozen=True)
class TellResult:
    """What became of a statement."""

    accepted: bool
    revision: int
    problem: Problem | None = None
