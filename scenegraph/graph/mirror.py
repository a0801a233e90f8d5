"""A copy of a graph that lives elsewhere, kept up to date by its deltas."""

from __future__ import annotations

from collections.abc import Callable

from scenegraph.errors import InvariantViolated, RevisionGap
from scenegraph.graph.delta import Delta, Snapshot
from scenegraph.graph.scene_graph import SceneGraph

__all__ = ["Mirror"]


class Mirror:
    """Follows a graph by its deltas; when one is missing, asks `on_gap` for a snapshot and goes on from there.

    on_gap : called without arguments; returns the graph's present snapshot, no older than the delta before the one
        received

    Deltas that came late or twice are ignored. A graph that began anew (its server restarted without its store) is
    noticed by a delta that is later in time but not in number.
    """

    def __init__(self, on_gap: Callable[[], Snapshot], *, history_limit: int = 0) -> None:
        self._on_gap = on_gap
        self._history_limit = history_limit
        self._graph = SceneGraph(history_limit=history_limit)
        self._n_gaps = 0

    @property
    def graph(self) -> SceneGraph:
        """The mirrored graph; a new object after each snapshot."""
        return self._graph

    @property
    def n_gaps(self) -> int:
        """How often a snapshot had to be asked for."""
        return self._n_gaps

    def receive(self, delta: Delta) -> bool:
        """Take one delta in; whether the graph changed. Raises RevisionGap when even the snapshot was too old."""
        revision = self._graph.revision
        if delta.revision <= revision:
            began_anew = delta.stamp_ns > self._graph.stamp_ns and bool(delta)
            return self._catch_up(delta) if began_anew else False
        if delta.revision > revision + 1 or not delta:  # an empty delta repeats a revision: we missed that one
            return self._catch_up(delta)
        try:
            self._graph.apply(delta)
        except InvariantViolated:  # not the graph we have been following
            return self._catch_up(delta)
        return True

    def resynchronise(self) -> None:
        """Replace the graph by the present snapshot, as when joining."""
        self._graph = SceneGraph.from_snapshot(self._on_gap(), history_limit=self._history_limit)

    def _catch_up(self, delta: Delta) -> bool:
        self._n_gaps += 1
        self.resynchronise()
        if self._graph.revision == delta.revision - 1:
            self._graph.apply(delta)
        elif self._graph.revision < delta.revision:
            raise RevisionGap(self._graph.revision, delta.revision)
        return True
