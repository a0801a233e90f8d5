"""Everything that can go wrong in the scene graph service, and how it is told on the wire.

SceneGraphError
├── InvalidConfig          a world was configured with an impossible value (also a ValueError)
├── InvalidStatement       a statement for `tell` that is not one, or that does not fit the world (also a ValueError)
├── GoalRefused            a goal that cannot be watched or planned for, with the problem that it has
├── InvalidGraphValue      a node, edge, box or delta with a bad field (also a ValueError)
├── UnknownNode            an id that is neither a node nor a tombstone (also a KeyError)
├── InvariantViolated      a change that would leave the graph inconsistent; nothing was changed
│   └── DanglingEdge       an edge whose end does not exist
├── RevisionGap            a mirror was given a delta that does not follow its revision
├── HistoryUnavailable     a time before the remembered past
├── ExportError            a format that is not known, or a file that cannot be written
├── GraphUnreadable        a file that holds no graph in a format that is known (also a ValueError)
├── TaxonomyUnreadable     a file that holds no tree of classes, or one that runs in a circle (also a ValueError)
├── JoinRefused            two graphs that cannot be laid on one another, or in more than one way
├── PictureError           a picture that cannot be drawn from what was given
└── StoreError             a stored world that cannot be written or read
    ├── StoreForeign       the file is not a stored world
    ├── StoreTooNew        the file was written by a newer version
    └── StoreCorrupt       the file is truncated or damaged

Every error has a `code` (snake case, stable), a message (`str(error)`) and a `hint` (or None). The errors of `mapping`
and `reasoning` have the same three, so that `problem_of` can turn any of them into the `Problem` that clients receive.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from itertools import islice
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, ValidationError

__all__ = [
    "DanglingEdge",
    "ExportError",
    "GoalRefused",
    "GraphUnreadable",
    "HistoryUnavailable",
    "InvalidConfig",
    "InvalidGraphValue",
    "InvalidStatement",
    "InvariantViolated",
    "JoinRefused",
    "PictureError",
    "Problem",
    "RevisionGap",
    "SceneGraphError",
    "StoreCorrupt",
    "StoreError",
    "StoreForeign",
    "StoreTooNew",
    "TaxonomyUnreadable",
    "UnknownNode",
    "nearest",
    "one_line",
    "problem_of",
]


class SceneGraphError(Exception):
    """Root of the tree. `code` is stable and snake case; `hint` says what to do, or is None."""

    code: ClassVar[str] = "scenegraph_error"

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return self.message


class InvalidConfig(SceneGraphError, ValueError):
    """A world was configured with an impossible value; the message names the field, the value and what was expected."""

    code = "invalid_config"


class InvalidStatement(SceneGraphError, ValueError):
    """A statement for `tell` cannot be understood, or does not fit the world; nothing was changed."""

    code = "invalid_statement"


class GoalRefused(SceneGraphError):
    """A goal cannot be watched or planned for. `code`, message and hint are those of the problem that it has."""

    code = "goal_refused"

    def __init__(self, code: str, message: str, hint: str | None = None) -> None:
        super().__init__(message, hint=hint)
        self.code = code  # type: ignore[misc]


class InvalidGraphValue(SceneGraphError, ValueError):
    """A field of a node, edge, box, delta or snapshot is not what it must be."""

    code = "invalid_value"


class UnknownNode(SceneGraphError, KeyError):
    """No node has this id. The hint names what became of it, or the nearest ids."""

    code = "unknown_node"


class InvariantViolated(SceneGraphError):
    """The change would leave the graph inconsistent; nothing of it was applied."""

    code = "invariant_violated"


class DanglingEdge(InvariantViolated):
    """An edge whose source or target is not a node of the graph."""

    code = "dangling_edge"


class RevisionGap(SceneGraphError):
    """A delta does not follow the mirror's revision: ask for a snapshot."""

    code = "revision_gap"

    def __init__(self, have: int, got: int) -> None:
        super().__init__(
            f"delta {got} does not follow revision {have}: expected {have + 1}",
            hint="ask for a snapshot and go on from its revision",
        )
        self.have = have
        self.got = got


class HistoryUnavailable(SceneGraphError):
    """The time asked for lies before the remembered history."""

    code = "history_unavailable"


class ExportError(SceneGraphError):
    """A graph cannot be written in the format or to the place asked for."""

    code = "export_failed"


class GraphUnreadable(SceneGraphError, ValueError):
    """A file or document is no graph in a format that is known, or a damaged one; the message names the place."""

    code = "graph_unreadable"


class TaxonomyUnreadable(SceneGraphError, ValueError):
    """A file holds no tree of classes in a format that is known; the message names the line, or the circle."""

    code = "taxonomy_unreadable"


class JoinRefused(SceneGraphError):
    """Two graphs cannot be joined: nothing says where one lies in the other, or more than one place would do."""

    code = "join_refused"


class PictureError(SceneGraphError):
    """A picture cannot be drawn from what was given."""

    code = "picture_failed"


class StoreError(SceneGraphError):
    """A stored world cannot be written or read."""

    code = "store_failed"


class StoreForeign(StoreError):
    """The file exists, but is not a stored world."""

    code = "store_foreign"


class StoreTooNew(StoreError):
    """The file was written by a newer version of this program."""

    code = "store_too_new"


class StoreCorrupt(StoreError):
    """The file is a stored world, but truncated or damaged."""

    code = "store_corrupt"


class Problem(BaseModel):
    """What a client is told when something could not be done: `{"code", "message", "hint"}`."""

    model_config = ConfigDict(frozen=True)

    code: str
    message: str
    hint: str | None = None


def nearest(name: str, known: Iterable[str], n: int = 3) -> list[str]:
    """The at most `n` known names that look most like `name`, best first.

    Only 2000 names of about the same length are compared, so that a wrong name costs milliseconds in any world.
    """
    like_long = (other for other in known if abs(len(other) - len(name)) <= 3)
    return difflib.get_close_matches(name, list(islice(like_long, 2000)), n=n, cutoff=0.6)


def one_line(error: ValidationError, root: str = "") -> str:
    """A pydantic error in one line: each field's path, what is wrong, and the value given."""
    parts = []
    for item in error.errors(include_url=False, include_context=False)[:3]:
        path = ".".join(str(step) for step in (root, *item["loc"]) if step != "")
        message = item["msg"].removeprefix("Value error, ")
        if item["type"] == "value_error":  # our own validators name the value themselves
            parts.append(f"{path}: {message}" if path else message)
        elif item["type"] == "missing":
            parts.append(f"{path}: required, but missing")
        else:
            parts.append(f"{path}: {message}, got {shown(item['input'])}")
    more = error.error_count() - len(parts)
    return "; ".join(parts) + (f"; and {more} more" if more > 0 else "")


def shown(value: object, limit: int = 80) -> str:
    """`repr(value)` in one line of at most `limit` characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


def problem_of(error: BaseException) -> Problem:
    """The `Problem` that tells a client of this error.

    Errors of our three packages are known by their `code` and `hint`; pydantic's are put in one line; of any other
    error only the type is told, since its text may hold what is no client's business. The caller logs it.
    """
    if isinstance(error, ValidationError):
        return Problem(code="invalid_message", message=one_line(error), hint=None)
    code = getattr(error, "code", None)
    if isinstance(code, str):
        hint = getattr(error, "hint", None)
        return Problem(code=code, message=str(error), hint=hint if isinstance(hint, str) else None)
    if isinstance(error, MemoryError):
        return Problem(code="out_of_memory", message="the request needs more memory than there is", hint=None)
    return Problem(
        code="internal_error",
        message=f"an unexpected {type(error).__name__} stopped the request",
        hint="the server's log has the details",
    )
