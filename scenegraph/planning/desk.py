"""Planning, checking and planning anew for one world."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mapping.geometry import SE3
from mapping.observations import RobotDescription
from reasoning.knowledge import KnowledgeBase, Problem
from reasoning.planning import Planner, PlannerUnavailable, Task, household
from scenegraph.errors import GoalRefused, InvalidConfig
from scenegraph.graph import Node, SceneGraph
from scenegraph.places import PlaceFinder
from scenegraph.planning.checking import check_plan
from scenegraph.planning.goals import GoalReader
from scenegraph.planning.mapping import DomainMapping, Mapped
from scenegraph.planning.plan import Plan, PlanCheck, PlanStatus, Step, step_of
from scenegraph.planning.planner import Order, Planning, TaskPlanner, whole_task
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

    def planning_in(
        self,
        domain: DomainMapping | str | Path,
        goal: str,
        *,
        robot: str | None = None,
        timeout_s: float = 10.0,
    ) -> Planning[Plan]:
        """Plan in a user's domain: first about what the household domain says that the goal can touch, then, where that
        leads nowhere, about everything. Raises `InvalidConfig` when the mapping is not one."""
        began = time.perf_counter()
        mapping = domain if isinstance(domain, DomainMapping) else DomainMapping.load(domain)
        mapped = Mapped(mapping, self._knowledge)
        found = Plan("unknown", goal, revision=self._graph.revision)
        try:
            situation = self.situation(robot)
            narrow = whole_task(GoalReader(self._knowledge).read(goal), situation)
            about = frozenset(narrow.objects)
            for task in (mapped.task(narrow.goal, about), mapped.task(narrow.goal)):
                left = timeout_s - (time.perf_counter() - began)
                outcome = yield Order(task, max(left, 0.01))
                if outcome.status == "solved":
                    found = replace(found, status="solved", task=task, actions=outcome.actions, robot=situation.robot)
                    found = replace(found, steps=self._mapped_steps(found, mapped, robot))
                    break
                problem = Problem(outcome.status, outcome.message or f"{mapping.domain.name} has no plan for it")
                status: PlanStatus = "timeout" if outcome.status == "timeout" else "unsolvable"
                found = replace(found, status=status, problem=problem)
        except (GoalRefused, InvalidConfig, PlannerUnavailable) as error:
            found = replace(found, status="unknown", problem=Problem(error.code, str(error), error.hint))
        return replace(found, elapsed_ms=1e3 * (time.perf_counter() - began))

    def _mapped_steps(self, plan: Plan, mapped: Mapped, robot: str | None) -> tuple[Step, ...]:
        standing = Standing(self._graph, self._finder, robot)
        targets = {name.lower(): place for name, place in mapped.mapping.targets.items()}
        steps = []
        here: SE3 | None = None
        for action in plan.actions:
            ids = tuple(mapped.node_of.get(name, name) for name in action.arguments)
            place = targets.get(action.name, 0)
            if 0 < place <= len(ids):
                here = standing.before(ids[place - 1])
            step = step_of(action, False, here)
            steps.append(replace(step, action=mapped.mapping.spelled.get(action.name, action.name), arguments=ids))
        return tuple(steps)

    def task(self, goal: str, *, robot: str | None = None, scoped: bool = True) -> Task:
        """What a planner is given for a goal; see `whole_task`. Raises `GoalRefused`."""
        return whole_task(GoalReader(self._knowledge).read(goal), self.situation(robot), scoped=scoped)

    def verify(self, plan: Plan, *, done: int = 0) -> PlanCheck:
        """See `World.verify`."""
        if plan.task is None:
            problem = "there is no plan" if plan.problem is None else plan.problem.message
            return PlanCheck(False, (), (problem,))
        if plan.task.domain != household():
            told = f"plans in the domain {plan.task.domain.name} cannot be checked, only made anew"
            return PlanCheck(False, (), (told,))
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
