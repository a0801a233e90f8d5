"""What the graph's history says, as facts: from when to when its edges, labels and attributes were there.

The rules are told nothing until a question is about the past, then the life of all nodes, and the edges of those
relations that it is about; from then on what changed since, when they are asked the next time. So a question costs what
has changed, and a world that is never asked of its past pays nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from reasoning.terms import Atom, Compound, Term
from scenegraph.events import MOST_EVENTS, Event, EventLog
from scenegraph.facts import class_atom
from scenegraph.graph import Edge, EdgeKey, Node, SceneGraph
from scenegraph.graph.history import Undo

__all__ = ["Past"]

ALL = "all"
NOTHING = "nothing"
"""What the rules may need besides a relation's name: every relation, or no more than the nodes."""

MOST_ENDED = 100_000
"""Intervals that have ended and are kept; the oldest go first."""

_NOW = Atom("now")


class _State(NamedTuple):
    """Something that holds for a while: the name of its fact, and the fact's arguments but for the times."""

    name: str
    arguments: tuple[Term, ...]

    def fact(self, since: int, until: int | None) -> Compound:
        return Compound(self.name, (*self.arguments, since, _NOW if until is None else until))


@dataclass
class _Told:
    """Facts that are due."""

    put: list[Compound] = field(default_factory=list)
    deleted: list[Compound] = field(default_factory=list)


class _Followed(NamedTuple):
    """Whose states are followed: of nodes, and of the edges of some relations."""

    nodes: bool
    relations: frozenset[str]


class Past:
    """The intervals of one graph's states, as far as its history goes back and somebody asked."""

    def __init__(self) -> None:
        self._wanted: set[str] = set()
        self._forget()

    def _forget(self) -> None:
        self._revision: int | None = None
        self._since: dict[_State, int] = {}
        self._ended: deque[tuple[_State, int, int]] = deque()
        self._relations: set[str] = set()
        self._events: deque[Compound] = deque()
        self._event_revision = -1

    @property
    def is_asked_for(self) -> bool:
        """Whether the rules were told of the past."""
        return self._revision is not None

    def knows(self, what: str) -> bool:
        """Whether the rules were told what the problem `needs_past` says."""
        return self.is_asked_for and (what == NOTHING or what in self._wanted or ALL in self._wanted)

    def supply(self, what: str, graph: SceneGraph, events: EventLog) -> tuple[list[Compound], list[Compound]]:
        """Facts to put and to delete so that the rules know what the problem `needs_past` says, up to now."""
        put, deleted = self.catch_up(graph, events)
        if self.knows(what):
            return put, deleted
        told = _Told(put, deleted)
        more = {what} if what != ALL else self._relations - self._wanted
        self._wanted.add(what)
        self._begin(list(graph.history), graph, _Followed(False, frozenset(more)), told)
        told.put.append(Compound("told_past", (Atom(what),)))
        return told.put, told.deleted

    def catch_up(self, graph: SceneGraph, events: EventLog) -> tuple[list[Compound], list[Compound]]:
        """Facts to put and to delete for what has changed since the rules were told last."""
        told = _Told()
        if self._revision == graph.revision:
            return told.put, told.deleted
        steps = [undo for undo in graph.history if self._revision is None or undo.revision > self._revision]
        if self._revision is not None and len(steps) != graph.revision - self._revision:  # some are forgotten already
            told.deleted += [state.fact(since, until) for state, since, until in self._spells()] + list(self._events)
            self._forget()
            steps = list(graph.history)
        self._note_relations(steps, graph, told)
        followed = _Followed(True, frozenset(self._relations if ALL in self._wanted else self._wanted))
        if self._revision is None:
            self._begin(steps, graph, followed, told)
        else:
            self._follow(steps, graph, followed, told)
        self._note_events(events, told)
        while len(self._ended) > MOST_ENDED:
            self._drop(self._ended.popleft(), told)
        told.put.append(Compound("parameter", (Atom("now_ns"), graph.stamp_ns)))
        self._revision = graph.revision
        return told.put, told.deleted

    # -- following the history ----------------------------------------------------------------------------
    def _begin(self, steps: list[Undo], graph: SceneGraph, followed: _Followed, told: _Told) -> None:
        """The states of the oldest remembered graph, begun when what they are of was first seen, and all since."""
        nodes: dict[str, Node | None] = {node.id: node for node in graph} if followed.nodes else {}
        edges: dict[EdgeKey, Edge | None] = {
            edge.key: edge for relation in followed.relations for edge in graph.edges(relation)
        }
        for undo in reversed(steps):
            if followed.nodes:
                nodes.update(undo.before.nodes)
            edges.update((key, edge) for key, edge in undo.before.edges.items() if key.relation in followed.relations)
        if steps:  # what is remembered begins with the first change, unless others were forgotten
            begin = steps[0].previous_stamp_ns if steps[0].revision > 1 else steps[0].stamp_ns
        else:
            begin = graph.stamp_ns
        for item in (*nodes.values(), *edges.values()):
            if item is not None:
                for state in _states(item):
                    self._start(state, min(item.first_seen_ns, begin), told)
        if followed.nodes:
            told.put.append(Compound("parameter", (Atom("history_since_ns"), begin)))
        self._follow(steps, graph, followed, told)

    def _follow(self, steps: list[Undo], graph: SceneGraph, followed: _Followed, told: _Told) -> None:
        for undo, changes in zip(steps, _transitions(steps, graph, followed), strict=True):
            for gone, come in changes:
                for state in gone - come:
                    self._end(state, undo.stamp_ns, told)
                for state in come - gone:
                    self._start(state, undo.stamp_ns, told)
            for node_id, before in undo.before.nodes.items() if followed.nodes else ():
                if before is not None and node_id not in graph:
                    seen = (Atom(node_id), before.first_seen_ns, before.last_seen_ns)
                    told.put.append(Compound("sighted", seen))

    def _note_relations(self, steps: list[Undo], graph: SceneGraph, told: _Told) -> None:
        found = {key.relation for undo in steps for key in undo.before.edges}
        if self._revision is None:
            found.update(graph.relations())
        for relation in sorted(found - self._relations):
            self._relations.add(relation)
            told.put.append(Compound("past_relation", (Atom(relation),)))

    def _start(self, state: _State, stamp_ns: int, told: _Told) -> None:
        self._since[state] = stamp_ns
        told.put.append(state.fact(stamp_ns, None))

    def _end(self, state: _State, stamp_ns: int, told: _Told) -> None:
        since = self._since.pop(state)
        if since < stamp_ns:
            self._ended.append((state, since, stamp_ns))
            told.put.append(state.fact(since, stamp_ns))
        else:  # it came and went in one moment
            fact = state.fact(since, None)
            told.deleted.append(fact)
            told.put[:] = [other for other in told.put if other != fact]

    def _drop(self, spell: tuple[_State, int, int], told: _Told) -> None:
        state, since, until = spell
        told.deleted.append(state.fact(since, until))
        told.put.append(Compound("parameter", (Atom("history_since_ns"), until)))

    def _spells(self) -> Iterator[tuple[_State, int, int | None]]:
        yield from self._ended
        yield from ((state, since, None) for state, since in self._since.items())

    def _note_events(self, events: EventLog, told: _Told) -> None:
        for event in events.after(self._event_revision):
            fact = _event_fact(event)
            told.put.append(fact)
            self._events.append(fact)
            self._event_revision = event.revision
        while len(self._events) > MOST_EVENTS:
            told.deleted.append(self._events.popleft())


def _transitions(
    steps: list[Undo], graph: SceneGraph, followed: _Followed
) -> Iterator[list[tuple[set[_State], set[_State]]]]:
    """For each step, oldest first, the states of each item that it touched, before and after."""
    nodes: dict[str, Node | None] = {}
    edges: dict[EdgeKey, Edge | None] = {}
    found: list[list[tuple[set[_State], set[_State]]]] = []
    for undo in reversed(steps):
        changes = []
        for node_id, node in undo.before.nodes.items() if followed.nodes else ():
            now = graph.node(node_id) if node_id not in nodes and node_id in graph else nodes.get(node_id)
            changes.append((_states(node), _states(now)))
        for key, edge in undo.before.edges.items():
            if key.relation not in followed.relations:
                continue
            after = graph.edge(*key) if key not in edges else edges[key]
            changes.append((_states(edge), _states(after)))
        nodes.update(undo.before.nodes)
        edges.update(undo.before.edges)
        found.append([(gone, come) for gone, come in changes if gone != come])
    return reversed(found)


def _states(item: Node | Edge | None) -> set[_State]:
    """What holds while a node or edge is as it is: of attributes texts and truth values, since numbers change with
    every look."""
    if item is None:
        return set()
    if isinstance(item, Edge):
        return {_State("lasted", (Atom(item.relation), Atom(item.source), Atom(item.target)))}
    subject = Atom(item.id)
    states = {_State("lived", (subject, Atom(item.layer), Atom(class_atom(item.label))))}
    for key, value in item.attributes.items():
        if isinstance(value, bool):
            states.add(_State("had", (subject, Atom(key), Atom("true" if value else "false"))))
        elif isinstance(value, str):
            states.add(_State("had", (subject, Atom(key), value)))
    return states


def _event_fact(event: Event) -> Compound:
    if event.kind == "relabelled":
        other, was = class_atom(event.label), class_atom(event.label_before or "")
    else:
        other, was = event.other or "none", "none"
    return Compound(
        "event", (Atom(event.kind), Atom(event.node), event.stamp_ns, Atom(other), Atom(was))
    )  # fmt: skip
