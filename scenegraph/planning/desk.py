"""Planning, checking and planning anew for one world."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

from mapping.observations import RobotDescription
from reasoning.knowledge import KnowledgeBase, Problem
from reasoning.planning import Planner, PlannerUnavailable, Task
from scenegraph.errors import GoalRefused
from scenegraph.graph import Node, SceneGraph
from scenegraph.places import PlaceFinder
from scenegraph.planning.checking import check_plan
from scenegraph.planning.goals import GoalReader
from scenegraph.planning.plan import Plan, PlanCheck, PlanStatus, step_of
from scenegraph.planning.planner import Planning, TaskPlanner, whole_task
from scenegraph.planning.poses import Standing
from scenegraph.planning.situation import Situation

__all__ = ["PlanDesk", "run"]


def run(planning: Planning[Plan], planner: Planner, engine: str) -> Plan:
    """Plan here and now: every task is solved as it comes."""
    try:
        order = next(planning)
        while True:
            try:
                outcome = planner.solve(order.task, timeout_s=order.timeout_s, engine=engine)
            except PlannerUnavailable as error:
                order = planning.throw(error)
            else:
                order = planning.send(outcome)
    except StopIteration as done:
        plan: Plan = done.value
        return plan


class PlanDesk:
    """Plans in a graph and the rules that go with it.

    finder : finds poses in the map; None: there is none
    place  : where the robot is [m] while the graph knows of no agent, such as the place of the last image
    """

    def __init__(
        self,
        graph: SceneGraph,
        knowledge: KnowledgeBase,
        *,
        robots: Mapping[str, RobotDescription],
        radius_m: float,
        finder: PlaceFinder | None = None,
        place: tuple[float, float, float] | None = None,
    ) -> None:
        self._graph = graph
        self._knowledge = knowledge
        self._robots = robots
        self._radius_m = radius_m
        self._finder = finder
        self._place = place

    def planning(self, goal: str, *, robot: str | None = None, timeout_s: float = 10.0) -> Planning[Plan]:
        """See `World.plan`: yields tasks, is sent what the planner found, and returns the plan."""
        began = time.perf_counter()
        try:
            situation = self.situation(robot)
            read = GoalReader(self._knowledge).read(goal)
            found = yield from TaskPlanner(timeout_s).plan(read, situation)
        except GoalRefused as refused:
            status: PlanStatus = "unsolvable" if refused.code == "impossible" else "unknown"
            why = Problem(refused.code, refused.message, refused.hint)
            found = Plan(status, goal, problem=why, revision=self._graph.revision)
        except PlannerUnavailable as error:
            found = Plan("unknown", goal, problem=Problem(error.code, str(error), error.hint))
        found = self.with_steps(found)
        return replace(found, elapsed_ms=1e3 * (time.perf_counter() - began))

    def task(self, goal: str, *, robot: str | None = None, scoped: bool = True) -> Task:
        """What a planner is given for a goal; see `whole_task`. Raises `GoalRefused`."""
        return whole_task(GoalReader(self._knowledge).read(goal), self.situation(robot), scoped=scoped)

    def verify(self, plan: Plan, *, done: int = 0) -> PlanCheck:
        """See `World.verify`."""
        if plan.task is None:
            problem = "there is no plan" if plan.problem is None else plan.problem.message
            return PlanCheck(False, (), (problem,))
        robot = None if plan.robot is None else plan.robot.removeprefix("agent_")
        return check_plan(plan, self.situation(robot), done)

    def with_steps(self, plan: Plan) -> Plan:
        """A plan with its steps, each with the pose to stand at."""
        name = None if plan.robot is None else plan.robot.removeprefix("agent_")
        targets = Standing(self._graph, self._finder, name).targets(plan.actions)
        pairs = zip(plan.actions, targets, strict=True)
        return replace(plan, steps=tuple(step_of(action, True, target) for action, target in pairs))

    def situation(self, robot: str | None) -> Situation:
        """The graph as this robot finds it; of several robots the one that was seen last. Raises `GoalRefused`."""
        agent = self._agent(robot)
        name = robot or ("robot" if agent is None else agent.id.removeprefix("agent_"))
        place = self._place
        if agent is not None:
            x, y, z = agent.position.tolist()
            place = x, y, z
        return Situation(
            self._graph,
            self._knowledge,
            robot=f"agent_{name}",
            body=self._robots.get(name),
            radius_m=self._radius_m,
            place=place,
        )

    def _agent(self, robot: str | None) -> Node | None:
        agents = self._graph.nodes("agent")
        if robot is None:
            own = [a for a in agents if a.id.removeprefix("agent_") in self._robots] or agents
            return max(own, key=lambda a: a.last_seen_ns, default=None)
        found = [a for a in agents if a.id == f"agent_{robot}"]
        if not found and robot not in self._robots and agents:
            known = ", ".join(sorted(a.id.removeprefix("agent_") for a in agents))
            raise GoalRefused("unknown_robot", f"no robot is called {robot!r}", f"known: {known}")
        return found[0] if found else None
