"""What happened to things, as a stream: each change of the graph read as *appeared, moved, vanished* and so on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import takewhile
from typing import Any, Literal

from scenegraph.graph import Delta, Node
from scenegraph.graph.node import Layer
from scenegraph.graph.values import Identifier, Value

__all__ = ["Event", "EventLog", "events_of"]

Kind = Literal["appeared", "moved", "vanished", "merged", "split", "relabelled"]

MOST_EVENTS = 10_000
OPENINGS = frozenset({"door", "window"})


class Event(Value):
    """Something that happened to one node.

    kind      *appeared, moved, vanished, merged* (into `other`), *split* (from it), *relabelled* (was `label_before`)
    stamp_ns, revision   of the change of the graph
    position  (3,) [m] where the thing is, or was when it vanished;  origin  (3,) [m] where it was before it was moved
    """

    kind: Kind
    node: Identifier
    layer: Layer
    label: str
    stamp_ns: int
    revision: int
    position: tuple[float, float, float]
    origin: tuple[float, float, float] | None = None
    other: Identifier | None = None
    label_before: str | None = None
    reason: str = ""


def events_of(delta: Delta, before: Mapping[str, Node]) -> list[Event]:
    """What a change of the graph means for things, rooms, robots, doors and windows, in the order of the delta.

    before : the nodes that the delta puts or deletes, as they were; those that were not there are left out
    """
    found: list[Event] = []

    def note(kind: Kind, node: Node, **about: Any) -> None:
        about = {
            "position": tuple(node.position.tolist()),
            "stamp_ns": delta.stamp_ns,
            "revision": delta.revision,
        } | about
        found.append(Event(kind=kind, node=node.id, layer=node.layer, label=node.label, **about))

    for node in delta.nodes.put:
        if not _of_interest(node):
            continue
        old = before.get(node.id)
        was = {} if old is None else old.attributes
        about = node.attributes
        if about.get("moved_ns") != was.get("moved_ns"):
            note(
                "moved",
                node,
                origin=tuple(about["moved_from"]),
                reason="it has gone from there and looks the same here",
            )
        elif old is None and "split_from" in about:
            note("split", node, other=about["split_from"], reason="masks of single images hold them apart")
        elif old is None:
            note("appeared", node, reason="seen again where it was" if "returned_ns" in about else "seen first")
        if old is not None and old.label != node.label:
            note("relabelled", node, label_before=old.label, reason="most of its masks say so")
    for stone in delta.tombstones:
        old = before.get(stone.id)
        if old is not None and _of_interest(old):
            kind: Kind = "vanished" if stone.became is None else "merged"
            note(kind, old, other=stone.became, reason=stone.reason)
    return found


def _of_interest(node: Node) -> bool:
    return node.layer in ("object", "room", "agent") or (node.layer == "structure" and node.label in OPENINGS)


class EventLog:
    """The latest events, oldest first, `limit` at most."""

    def __init__(self, limit: int = MOST_EVENTS) -> None:
        self._events: deque[Event] = deque(maxlen=limit)

    def __len__(self) -> int:
        return len(self._events)

    def add(self, events: Iterable[Event]) -> None:
        """Take in what happened last."""
        self._events.extend(events)

    def since(self, stamp_ns: int | None = None) -> list[Event]:
        """The events stamped later than that, oldest first; None: all that are remembered."""
        if stamp_ns is None:
            return list(self._events)
        return list(takewhile(lambda event: event.stamp_ns > stamp_ns, reversed(self._events)))[::-1]

    def after(self, revision: int) -> list[Event]:
        """The events of later revisions of the graph, oldest first; the cost depends on their number."""
        return list(takewhile(lambda event: event.revision > revision, reversed(self._events)))[::-1]

    def document(self) -> list[dict[str, Any]]:
        """The events as JSON values."""
        return [event.model_dump(mode="json") for event in self._events]

    def restore(self, document: Iterable[Mapping[str, Any]]) -> None:
        """Take over what `document` gave."""
        self.add(Event.model_validate(fields) for fields in document)
