"""The remembered past: what each commit replaced, so that the graph of any past moment can be rebuilt."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from scenegraph.errors import HistoryUnavailable, InvalidGraphValue
from scenegraph.graph.edge import Edge, EdgeKey
from scenegraph.graph.node import Node, Tombstone

__all__ = ["Change", "History", "Life", "Undo"]


@dataclass(frozen=True, slots=True)
class Life:
    """When a node or an edge was seen, and when it was part of the graph, as far as that is remembered.

    first_seen_ns, last_seen_ns : as its latest state says
    spans : (from, to) stamps, oldest first, between which it was in the graph; from is None where it was there when the
        remembered past began, to is None where it is there now
    """

    first_seen_ns: int
    last_seen_ns: int
    spans: tuple[tuple[int | None, int | None], ...]

    @property
    def lives(self) -> bool:
        """Whether it is in the graph now."""
        return self.spans[-1][1] is None


@dataclass(frozen=True, slots=True)
class Change:
    """One change, forwards or backwards: for each id or key it touches, what is there afterwards (None: nothing)."""

    nodes: dict[str, Node | None] = field(default_factory=dict)
    edges: dict[EdgeKey, Edge | None] = field(default_factory=dict)
    tombstones: dict[str, Tombstone | None] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.nodes) + len(self.edges) + len(self.tombstones)


@dataclass(frozen=True, slots=True)
class Undo:
    """How to go from a revision back to the one before it, whose stamp is `previous_stamp_ns`."""

    revision: int
    stamp_ns: int
    previous_stamp_ns: int
    before: Change


class History:
    """The undo steps of the latest commits, oldest first.

    Memory: one reference to a replaced node or edge for every item a commit touched, about 1 to 3 kB each as the
    graph's values go; at most `limit` items are kept (the oldest commits are forgotten first, whole), besides the
    newest commit. The default of 100 000 items is thus bounded by some 0.3 GB. `limit=0` keeps nothing.
    """

    def __init__(self, limit: int = 100_000) -> None:
        if limit < 0:
            raise InvalidGraphValue(f"history_limit: expected a number ≥ 0, got {limit}")
        self.limit = limit
        self._steps: deque[Undo] = deque()
        self._n_items = 0

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def n_items(self) -> int:
        """How many replaced items are kept."""
        return self._n_items

    def remember(self, undo: Undo) -> None:
        """Keep the newest commit's undo step, forgetting the oldest beyond the limit."""
        if self.limit == 0:
            return
        self._steps.append(undo)
        self._n_items += len(undo.before)
        while self._n_items > self.limit and len(self._steps) > 1:
            self._n_items -= len(self._steps.popleft().before)

    def since(self, stamp_ns: int, current_revision: int, current_stamp_ns: int) -> list[Undo]:
        """The steps to undo, newest first, to be back at the state that held at `stamp_ns`.

        Raises HistoryUnavailable when that lies before the oldest remembered state (revision 0 holds since ever).
        """
        if stamp_ns >= current_stamp_ns:
            return []
        steps: list[Undo] = []
        reached, reached_revision = current_stamp_ns, current_revision
        for undo in reversed(self._steps):
            if undo.stamp_ns <= stamp_ns:
                return steps
            steps.append(undo)
            reached, reached_revision = undo.previous_stamp_ns, undo.revision - 1
        if reached_revision > 0 and reached > stamp_ns:
            raise HistoryUnavailable(
                f"the graph at {stamp_ns} ns is not remembered: "
                f"history begins at {reached} ns (revision {reached_revision})",
                hint="ask for a later time, or keep a longer history (history_limit)",
            )
        return steps

    def life(self, item: str | EdgeKey, now: Node | Edge | None) -> Life | None:
        """The life of a node or edge that is now as given; None when it is not there and was not, that is remembered.

        Costs a look at every remembered commit.
        """
        latest, after, until = now, now, None
        spans: list[tuple[int | None, int | None]] = []
        for undo in reversed(self._steps):
            touched = undo.before.nodes if isinstance(item, str) else undo.before.edges
            if item not in touched:
                continue
            before: Node | Edge | None = touched[item]  # type: ignore[index]
            if before is None and after is not None:
                spans.append((undo.stamp_ns, until))
            elif before is not None and after is None:
                until = undo.stamp_ns
            after, latest = before, latest if latest is not None else before
        if after is not None:
            spans.append((None, until))
        if latest is None:
            return None
        return Life(latest.first_seen_ns, latest.last_seen_ns, tuple(reversed(spans)))

    def document(self) -> list[dict[str, Any]]:
        """The history as JSON values, oldest first (`from_document` reads it)."""
        return [_undo_document(undo) for undo in self._steps]

    @classmethod
    def from_document(cls, document: list[Any], limit: int = 100_000) -> History:
        """The history written by `document`; raises InvalidGraphValue when it is not one."""
        history = cls(limit)
        for i, item in enumerate(document):
            history.remember(_undo(item, f"history[{i}]"))
        return history

    def __iter__(self) -> Iterator[Undo]:
        return iter(self._steps)


def _undo_document(undo: Undo) -> dict[str, Any]:
    before = undo.before
    return {
        "revision": undo.revision,
        "stamp_ns": undo.stamp_ns,
        "previous_stamp_ns": undo.previous_stamp_ns,
        "nodes": {node_id: node and node.model_dump(mode="json") for node_id, node in before.nodes.items()},
        "edges": [[*key, edge and edge.model_dump(mode="json")] for key, edge in before.edges.items()],
        "tombstones": {
            node_id: stone and stone.model_dump(mode="json") for node_id, stone in before.tombstones.items()
        },
    }


def _undo(item: Any, path: str) -> Undo:
    try:
        if not isinstance(item, Mapping):
            raise TypeError(f"expected an object, got {type(item).__name__}")
        return Undo(
            revision=int(item["revision"]),
            stamp_ns=int(item["stamp_ns"]),
            previous_stamp_ns=int(item["previous_stamp_ns"]),
            before=Change(
                nodes={i: None if node is None else Node.model_validate(node) for i, node in item["nodes"].items()},
                edges={
                    EdgeKey(r, s, t): None if edge is None else Edge.model_validate(edge)
                    for r, s, t, edge in item["edges"]
                },
                tombstones={
                    i: None if s is None else Tombstone.model_validate(s) for i, s in item["tombstones"].items()
                },
            ),
        )
    except InvalidGraphValue as error:
        raise InvalidGraphValue(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidGraphValue(f"{path}: not an undo step: {type(error).__name__}: {error}") from None
