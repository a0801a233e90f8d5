"""A world small enough to see through: what the service needs of one, and nothing else."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from mapping.geometry import SE3
from mapping.observations import AgentPose, RgbdImage
from scenegraph.errors import InvalidStatement, Problem
from scenegraph.events import Event
from scenegraph.graph import Delta, Edge, GraphChanges, Node, SceneGraph


@dataclass
class FakeAnswers:
    truth: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    truncated: bool = False
    problem: Problem | None = None

    def __iter__(self):
        return iter(self.rows)

    def explain(self) -> dict[str, Any]:
        return {"goal": "asked", "truth": self.truth}


class FakeLayer:
    """Known and 0.25 where x > 0, unknown elsewhere."""

    def query(self, p_map: np.ndarray) -> np.ndarray:
        return np.where(p_map[:, 0] > 0, 0.25, np.nan)


class FakeWorld:
    """Each image adds an object on a table; a goal is the label of what is sought, or a word for what should happen."""

    def __init__(self) -> None:
        self.graph = SceneGraph()
        self.map = SimpleNamespace(occupancy=FakeLayer())
        self.integrated: list[Any] = []
        self.threads: set[int] = set()
        self.slow_s = 0.0
        changes = GraphChanges()
        changes.put(node("table_1", "table"))
        self.graph.commit(changes, 1)

    def integrate(self, observation: Any) -> Delta:
        self.threads.add(threading.get_ident())
        time.sleep(self.slow_s)
        self.integrated.append(observation)
        changes = GraphChanges()
        if isinstance(observation, RgbdImage):
            n = len(self.graph) + 1
            changes.put(node(f"cup_{n}", "cup"))
            changes.put(Edge(relation="on", source=f"cup_{n}", target="table_1", first_seen_ns=1, last_seen_ns=1))
        if isinstance(observation, AgentPose) and "cup_2" in self.graph:
            changes.delete_node("cup_2", "taken away")
        return self.graph.commit(changes, getattr(observation, "stamp_ns", 1))

    def ask(self, goal: str, *, robot=None, limit: int = 100, timeout_s: float = 1.0, at_ns=None) -> FakeAnswers:
        self.threads.add(threading.get_ident())
        if goal == "sleep":
            time.sleep(timeout_s)
            return FakeAnswers("unknown", problem=Problem(code="timeout", message="took too long"))
        if goal == "crash":
            raise ZeroDivisionError("a secret")
        found = [n for n in self.graph.nodes() if n.label == goal]
        rows = [{"X": n, "N": len(n.label)} for n in found[:limit]]
        return FakeAnswers("true" if found else "false", rows, truncated=len(found) > limit)

    def where(self, phrase: str, *, robot=None) -> Any:
        pose = SimpleNamespace(pose=SE3.identity(), clearance_m=0.5, path_length_m=float("inf"))
        square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
        region = SimpleNamespace(polygon=square, z_min=0.0, z_max=2.0)
        answer = SimpleNamespace(nodes=[self.graph.node("table_1")], region=region, poses=[pose])
        return SimpleNamespace(truth="true", answers=[answer], ambiguous=(), problem=None)

    def tell(self, statement: str, *, author: str, reason: str) -> Any:
        if not statement.startswith("rename"):
            raise InvalidStatement(f"{statement!r} is not a statement", hint="rename(Id, Name)")
        changes = GraphChanges()
        table = self.graph.node("table_1")
        changes.put(table.replace(attributes={"name": statement, "author": author, "reason": reason}))
        delta = self.graph.commit(changes, 2)
        return SimpleNamespace(accepted=True, revision=delta.revision, problem=None)

    def events(self, since_ns: int | None = None) -> list[Event]:
        return [
            Event(kind="appeared", node=n.id, layer="object", label=n.label, stamp_ns=1, revision=1, position=(0, 0, 0))
            for n in self.graph.nodes()
            if since_ns is None or since_ns < 1
        ]

    def status(self) -> dict[str, Any]:
        return {"nodes": len(self.graph), "observations": len(self.integrated)}


def node(node_id: str, label: str) -> Node:
    return Node(id=node_id, layer="object", label=label, position=(0, 0, 0), first_seen_ns=1, last_seen_ns=1)
