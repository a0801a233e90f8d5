"""Stairs that nobody named: flights of steps become structure nodes that lead from one storey to the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.planes import PlaneMap
from reasoning.knowledge import KnowledgeBase
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception.flights import LEVEL, PATCH_M, Flight, inclines, measure
from scenegraph.perception.neighbours import GroundIndex
from scenegraph.perception.shapes import Shape

Array: TypeAlias = NDArray[Any]
Judge: TypeAlias = Callable[[Flight], bool]
"""Whether a flight of steps is to be called stairs."""

LABEL = "stairs"
LOOK_EVERY = 8
"""Surface that changed is looked at every so many updates: flights stay where they are."""
MOST_MEASURED = 2
MORE = 1.3
"""So many inclines are followed at one look, the best seen first; where nothing came of it, again when so much more of
it is seen."""
LARGE_M2 = 1.5
"""A level plane so large is a floor or a table, and no step."""
BESIDE_M = 0.08
SHARED = 0.2
REFRESH_NS = 5_000_000_000


def stairs_by_rule(knowledge: KnowledgeBase) -> Judge:
    """`stairs/1` of `rules/structure.pl`, asked of a knowledge base."""

    def is_stairs(flight: Flight) -> bool:
        measures = (flight.rise_m, flight.unevenness_m, flight.going_m, flight.width_m)
        told = ",".join(f"{value:.4f}" for value in measures)
        return bool(knowledge.call(f"structure:stairs(flight({len(flight.heights)},{told}))", limit=1))

    return is_stairs


class Stairs:
    """The nodes `stairs_<n>` of flights of steps, kept in step with the surface; ids last while the flight is there.

    shapes, labels  of all things, by node id; those of stairs are written here too
    thing_at        a shape → the node of a thing with a name in which it lies: that is what it is
    area_of         a plane's id → its area [m²], 0 when it is not known
    """

    def __init__(
        self,
        shapes: dict[str, Shape],
        labels: dict[str, str],
        is_stairs: Judge,
        thing_at: Callable[[Shape], str | None],
        area_of: Callable[[int], float],
    ) -> None:
        self._shapes = shapes
        self._labels = labels
        self._is_stairs = is_stairs
        self._thing_at = thing_at
        self._area_of = area_of
        self._flights: dict[str, Flight] = {}
        self._index = GroundIndex()
        self._dismissed: set[str] = set()
        self._waiting: dict[tuple[int, int, int], None] = {}
        self._tried: dict[tuple[int, ...], int] = {}
        self._updates = 0
        self._next = 1

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) [m] are of stairs."""
        held = np.zeros(len(points), np.bool_)
        if self._flights and len(points):
            for name in self._index.within((points.min(axis=0), points.max(axis=0)), BESIDE_M):
                held |= self._flights[name].holds(points, BESIDE_M)
        return held

    def update(
        self, planes: PlaneMap, moved: Array, block_size_m: float, graph: SceneGraph, stamp_ns: int
    ) -> tuple[GraphChanges, set[str]]:
        """The changes of the nodes, and the ids of those whose shape is new, changed or gone.

        moved : blocks (K, 3) of which the surface is not as it was
        """
        changes, reshaped = GraphChanges(), set[str]()
        self._waiting.update(dict.fromkeys(map(tuple, moved.tolist())))
        self._updates += 1
        if self._updates % LOOK_EVERY or not self._waiting:
            return changes, reshaped
        points, normals, ids, _ = planes.samples_in(np.array(list(self._waiting), np.int32))
        self._waiting = {}
        level = normals[:, 2] > LEVEL
        points, ids = points[level], ids[level]
        large = [i for i in np.unique(ids).tolist() if self._area_of(i) > LARGE_M2]
        points = points[~np.isin(ids, large)]
        if not len(points):
            return changes, reshaped
        touched = set(self._index.within((points.min(axis=0), points.max(axis=0)), BESIDE_M))
        followed = 0
        for at, uphill, n in inclines(points):
            if followed == MOST_MEASURED:
                break
            place = tuple(np.floor(at / PATCH_M).astype(np.int64).tolist())
            if n < MORE * self._tried.get(place, 0) or any(
                self._flights[name].holds(at[None], BESIDE_M)[0] for name in touched & self._flights.keys()
            ):
                continue
            followed += 1
            self._tried[place] = n
            flight = measure(planes, block_size_m, at, uphill)
            if flight is not None and self._is_stairs(flight):
                self._keep(flight, planes.voxel_size_m, graph, stamp_ns, changes, reshaped)
        for name in sorted(touched):
            known = self._flights.get(name)
            if known is None or not known.holds(points, BESIDE_M).any():
                continue
            again = measure(planes, block_size_m, known.middle, known.uphill)
            if again is None or not self._is_stairs(again):
                self._drop(name, "no steps are there any more", None, changes, reshaped)
            else:
                self._keep(again, planes.voxel_size_m, graph, stamp_ns, changes, reshaped)
        return changes, reshaped

    def _keep(
        self,
        flight: Flight,
        voxel_size_m: float,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        reshaped: set[str],
    ) -> None:
        """Keep a flight under the oldest name of those that share its place, which are parts of it, or a new one."""
        low, high = flight.points.min(axis=0), flight.points.max(axis=0)
        same = [name for name in self._index.within((low, high), BESIDE_M) if _share(flight, self._flights[name])]
        same.sort(key=_number)
        flight = max((flight, *(self._flights[name] for name in same[1:])), key=lambda f: len(f.heights))
        if not same:
            same, self._next = [f"stairs_{self._next}"], self._next + 1
        for part in same[1:]:
            self._drop(part, "the same thing as another", same[0], changes, reshaped)
        self._write(same[0], flight, voxel_size_m, graph, stamp_ns, changes, reshaped)

    def _write(
        self,
        name: str,
        flight: Flight,
        voxel_size_m: float,
        graph: SceneGraph,
        stamp_ns: int,
        changes: GraphChanges,
        reshaped: set[str],
    ) -> None:
        """Keep a flight; written when it is new or longer than it was."""
        shape = Shape(flight.points, voxel_size_m)
        heir = self._thing_at(shape)
        if heir is not None:
            self._drop(name, "the same thing as another", heir, changes, reshaped)
            return
        known = self._flights.get(name)
        grown = known is None or len(known.heights) != len(flight.heights)
        before = graph.node(name) if name in graph else None
        if before is not None and not grown and stamp_ns - before.last_seen_ns < REFRESH_NS:
            return
        self._flights[name] = flight
        self._index.put(name, shape.bounds)
        if name in self._dismissed:
            return
        self._shapes[name], self._labels[name] = shape, LABEL
        reshaped.add(name)
        changes.put(
            Node(
                id=name,
                layer="structure",
                label=LABEL,
                position=shape.box.center,
                box=shape.box,
                confidence=0.9,
                first_seen_ns=stamp_ns if before is None else before.first_seen_ns,
                last_seen_ns=stamp_ns,
                attributes={
                    "levels": len(flight.heights),
                    "rise_m": round(flight.rise_m, 3),
                    "going_m": round(flight.going_m, 3),
                    "width_m": round(flight.width_m, 3),
                },
            )
        )

    def _drop(self, name: str, reason: str, became: str | None, changes: GraphChanges, reshaped: set[str]) -> None:
        if self._flights.pop(name, None) is None:
            return
        self._index.remove(name)
        if name in self._dismissed:
            self._dismissed.discard(name)
            return
        self._shapes.pop(name, None)
        self._labels.pop(name, None)
        changes.delete_node(name, reason, became=became)
        reshaped.add(name)

    def forget(self, name: str) -> set[str]:
        """Give up stairs for as long as their steps are there; returns the ids whose shape is gone."""
        if name not in self._flights:
            return set()
        self._dismissed.add(name)
        self._shapes.pop(name, None)
        self._labels.pop(name, None)
        return {name}

    # -- state --------------------------------------------------------------------------------------------
    def document(self) -> dict[str, Any]:
        """Where the flights are, as JSON values."""
        flights = [[name, f.middle.tolist(), f.uphill.tolist()] for name, f in self._flights.items()]
        return {"flights": flights, "dismissed": sorted(self._dismissed), "next": self._next}

    def restore(self, document: Mapping[str, Any], planes: PlaneMap, block_size_m: float) -> None:
        """Take over what `document` gave; flights are measured anew."""
        self._next = int(document["next"])
        self._dismissed = set(document["dismissed"])
        for name, middle, uphill in document["flights"]:
            flight = measure(planes, block_size_m, np.array(middle), np.array(uphill))
            if flight is not None:
                self._flights[name] = flight
                shape = Shape(flight.points, planes.voxel_size_m)
                self._index.put(name, shape.bounds)
                if name not in self._dismissed:
                    self._shapes[name], self._labels[name] = shape, LABEL


def _share(one: Flight, other: Flight) -> bool:
    """Whether a fifth of the surface of a flight is of the other as well."""
    shares = one.holds(other.points, BESIDE_M).mean(), other.holds(one.points, BESIDE_M).mean()
    return bool(max(shares) >= SHARED)


def _number(name: str) -> int:
    return int(name.removeprefix("stairs_"))
