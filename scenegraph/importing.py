"""Graphs from other programs' files, to be asked as a world is."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from reasoning.knowledge import KnowledgeBase, Reply
from reasoning.planning import Planner, Task
from reasoning.terms import Atom
from scenegraph import facts, phrases
from scenegraph.answers import Answers
from scenegraph.config import WorldConfig
from scenegraph.errors import StoreForeign
from scenegraph.graph import SceneGraph
from scenegraph.interop import read_graph
from scenegraph.store import load_graph

if TYPE_CHECKING:
    from scenegraph.planning.desk import PlanDesk
    from scenegraph.planning.mapping import DomainMapping
    from scenegraph.planning.plan import Plan, PlanCheck
    from scenegraph.world import World

__all__ = ["GraphFile", "graph_in", "open_map"]


class GraphFile:
    """A graph without a map, as `read_graph` read it: it can be asked and exported. A context manager.

    Its edges are facts and its nodes have places and sizes, but nothing is measured between them: what no edge tells
    is not known to hold.
    """

    def __init__(self, graph: SceneGraph) -> None:
        self.graph = graph

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file. Raises GraphUnreadable."""
        return cls(read_graph(path))

    @cached_property
    def _knowledge(self) -> KnowledgeBase:
        labels = sorted({node.label for node in self.graph.nodes("object")})
        knowledge = KnowledgeBase()
        knowledge.update(
            put=[
                *facts.class_facts((label, "thing", None) for label in labels),
                *(fact for node in self.graph for fact in facts.node_facts(node)),
                *map(facts.edge_fact, self.graph.edges()),
            ]
        )
        return knowledge

    def ask(self, goal: str, *, robot: str | None = None, limit: int = 100, timeout_s: float = 1.0) -> Answers:
        """Ask a goal such as `in(X, room_1)`, or a phrase, as `World.ask`."""
        viewer = None if robot is None else f"agent_{robot}"
        phrase = phrases.read(goal, self._knowledge)
        if phrase.problem is not None:
            return Answers(Reply("unknown", problem=phrase.problem), self.graph.revision, {})

        def reply(explain: bool) -> Reply:
            return self._knowledge.ask(phrase.goal, limit=limit, timeout_s=timeout_s, explain=explain, viewer=viewer)

        answered = phrases.answered(phrase, reply(False))
        named = {term.name for row in answered.answers for term in row.values() if isinstance(term, Atom)}
        nodes = {i: self.graph.node(i) for i in named if i in self.graph}
        return Answers(answered, self.graph.revision, nodes, lambda: reply(True).explanation)

    def plan(
        self,
        goal: str,
        *,
        robot: str | None = None,
        timeout_s: float = 10.0,
        engine: str = "pyperplan",
        domain: str | Path | DomainMapping | None = None,
    ) -> Plan:
        """A plan, as `World.plan`; its steps have poses only where places of the graph tell them."""
        from scenegraph.planning.desk import run

        if domain is not None:
            planning = self._plan_desk().planning_in(domain, goal, robot=robot, timeout_s=timeout_s)
            return run(planning, self._planner, engine)
        return run(self._plan_desk().planning(goal, robot=robot, timeout_s=timeout_s), self._planner, engine)

    def planning_task(self, goal: str, *, robot: str | None = None, scoped: bool = True) -> Task:
        """What a planner is given for a goal, as `World.planning_task`."""
        return self._plan_desk().task(goal, robot=robot, scoped=scoped)

    def verify(self, plan: Plan, *, done: int = 0) -> PlanCheck:
        """Whether a plan still leads to its goal, as `World.verify`."""
        return self._plan_desk().verify(plan, done=done)

    def _plan_desk(self) -> PlanDesk:
        from scenegraph.planning.desk import PlanDesk

        return PlanDesk(self.graph, self._knowledge, robots={}, radius_m=WorldConfig().robot_radius_m)

    @cached_property
    def _planner(self) -> Planner:
        return Planner()

    def close(self) -> None:
        """End the processes of reasoner and planner."""
        for name in ("_knowledge", "_planner"):
            if name in self.__dict__:
                self.__dict__[name].close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def open_map(path: Path) -> World | GraphFile:
    """A stored world, a stored graph without a map, or a graph of another format, which is text.

    Raises StoreError, GraphUnreadable.
    """
    from scenegraph.world import World

    if _is_text(path):
        return GraphFile.load(path)
    try:
        return World.load(path)
    except StoreForeign:
        return GraphFile(load_graph(path))


def graph_in(path: Path) -> SceneGraph:
    """The graph of a stored world, or one of another format. Raises StoreError, GraphUnreadable."""
    return read_graph(path) if _is_text(path) else load_graph(path)


def _is_text(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(1024).lstrip()[:1] in (b"{", b"[", b"<")
    except OSError:
        return False
