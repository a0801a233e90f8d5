"""The world: observations in; a layered map, a labelled scene graph and symbolic answers out.

`World.integrate` is the one main path; service, replay, simulation, tests and benchmarks all call it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from mapping.errors import PoseUnavailable
from mapping.frames import BASE, MAP, FrameTree
from mapping.geometry import SE3
from mapping.layered import LayeredMap, MapChange
from mapping.observations import (
    AgentPose,
    Detections,
    LabelSpace,
    Observation,
    PoseCorrection,
    RgbdImage,
    RobotDescription,
    Scan,
    Transform,
)
from reasoning.knowledge import Explanation, KnowledgeBase
from reasoning.planning import Planner, Task
from scenegraph import phrases, statements, storing
from scenegraph.answers import Answers, Place, TellResult
from scenegraph.collector import collector_paused
from scenegraph.config import WorldConfig
from scenegraph.detections import DetectionDesk, sightings
from scenegraph.errors import SceneGraphError
from scenegraph.events import Event, EventLog, events_of
from scenegraph.graph import LAYERS, Delta, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion
from scenegraph.labels import Labels
from scenegraph.meaning import Meaning
from scenegraph.past import Past
from scenegraph.perception.access import Access, asks_between, asks_for, outdated
from scenegraph.perception.perception import Perception
from scenegraph.places import PlaceFinder
from scenegraph.realigning import Corrections, Sightings, motions
from scenegraph.watching import AnswerChange, Watch, Watches

if TYPE_CHECKING:
    from scenegraph.planning.desk import PlanDesk
    from scenegraph.planning.mapping import DomainMapping
    from scenegraph.planning.plan import Plan, PlanCheck
    from scenegraph.planning.planner import Planning

__all__ = ["World"]


class World:
    """A world model in this process: no server, no network. A context manager; one thread at a time may use it.

    config : see `WorldConfig`; default: 5 cm voxels
    """

    def __init__(self, config: WorldConfig | None = None) -> None:
        self.config = config or WorldConfig()
        self.map = LayeredMap(
            voxel_size_m=self.config.voxel_size_m,
            instance_voxel_size_m=self.config.fine_voxel_size_m,
            max_range_m=self.config.max_range_m,
            label_range_m=self.config.label_range_m,
            fusion=self.config.fusion,
            spread_labels=self.config.spread_labels,
            follow_moving=self.config.moving == "model",
        )
        self.graph = SceneGraph()
        self.frames = FrameTree()
        self.labels = Labels()
        self.robots: dict[str, RobotDescription] = {}
        self.statements: list[statements.Statement] = []
        self.event_log = EventLog()
        self.sightings = Sightings()
        self._knowledge = KnowledgeBase(self.config.rule_files)
        self.meaning = Meaning(self._knowledge, self.config)
        self.perception = Perception(self.map, self.labels, self.meaning, self.config.robot_radius_m)
        self.watches = Watches(
            self._knowledge,
            ask=lambda asked: self.ask(asked.goal, robot=asked.robot, limit=asked.limit, timeout_s=asked.timeout_s),
            answers=lambda reply: self.meaning.answers(reply, self.graph),
            stamp=lambda: self.graph.stamp_ns,
            on_demand=lambda goal: asks_for(goal) or phrases.is_phrase(goal),
        )
        self._past = Past()
        self._knowledge.watching.supplier = self._tell_past
        self._asked_for: set[tuple[str, ...]] = set()
        self._desk = DetectionDesk()
        self.planner = Planner()
        self.T_map_camera: SE3 | None = None
        """Where the last image was taken from, as the map corrected its pose."""

    # -- observations in ----------------------------------------------------------------------------------
    def integrate(self, observation: Observation) -> Delta:
        """Take in one observation; returns what it changed in the graph.

        Raises `InvalidObservation` when it does not fit what is known (a class id without a label space) and
        `PoseUnavailable` when its pose is neither given nor in the frame tree. The world is then unchanged.
        """
        match observation:
            case RgbdImage():
                change = self._integrate_image(observation)
            case Scan():
                change = self._integrate_scan(observation)
            case Detections():
                return self._integrate_detections(observation)
            case AgentPose():
                self.frames.add(observation)
                return self._commit(self.perception.place_agent(observation, self.graph), observation.stamp_ns)
            case PoseCorrection():
                return self._realign(observation)
            case Transform():
                self.frames.add(observation)
                return self._commit(GraphChanges(), observation.stamp_ns)
            case LabelSpace():
                self.meaning.learn_classes(self.labels.learn(observation))
                return self._commit(GraphChanges(), self.graph.stamp_ns)
            case RobotDescription():
                self.robots[observation.robot] = observation
                self.meaning.learn_robot(observation)
                return self._commit(GraphChanges(), self.graph.stamp_ns)
            case _:
                raise TypeError(f"World.integrate: expected an observation, got {type(observation).__name__}")
        changes = self.perception.perceive(change, self.graph, observation.stamp_ns, _source(observation))
        return self._seen(changes, observation)

    @collector_paused()
    def _integrate_image(self, image: RgbdImage) -> MapChange:
        T_map_camera = image.T_map_camera or self.frames.sensor_pose(
            image.robot, image.sensor, image.stamp_ns, optical=True
        )
        if image.labels is not None:
            labels = self.labels.translate(image.labels, image.robot, image.sensor)
            image = image.model_copy(update={"labels": labels})
        else:
            image = self._desk.label(image, self.labels)
        change = self.map.integrate_image(image, T_map_camera, self.labels.things, self._moving)
        self.T_map_camera = change.T_map_camera or T_map_camera
        self._desk.keep(image, self.T_map_camera)
        return change

    @collector_paused()
    def _integrate_scan(self, scan: Scan) -> MapChange:
        T_map_sensor = scan.T_map_sensor or self.frames.sensor_pose(
            scan.robot, scan.sensor, scan.stamp_ns, optical=False
        )
        if scan.labels is not None:
            scan = scan.model_copy(update={"labels": self.labels.translate(scan.labels, scan.robot, scan.sensor)})
        return self.map.integrate_scan(scan, T_map_sensor)

    def _integrate_detections(self, detections: Detections) -> Delta:
        """Label the image that the detections belong to; they wait for it when it has not come yet. Boxes in space of a
        sensor that sends no images are things by themselves."""
        if self._desk.stands_alone(detections):
            T_map_sensor = self._pose_of(detections)
            if T_map_sensor is not None:
                boxes = sightings(detections, T_map_sensor)
                source = _source(detections)
                changes = self.perception.perceive(self.map.unchanged, self.graph, detections.stamp_ns, source, boxes)
                return self._seen(changes, detections)
        found = self._desk.match(detections, self.labels)
        if found is None:
            return self._commit(GraphChanges(), detections.stamp_ns)
        image, T_map_camera = found
        change = self.map.label_image(image, T_map_camera, self.labels.things, self._moving)
        changes = self.perception.perceive(change, self.graph, detections.stamp_ns, _source(detections))
        return self._seen(changes, detections)

    def _pose_of(self, detections: Detections) -> SE3 | None:
        """The pose of the sensor of detections without an image; None while it is not known."""
        if detections.T_map_sensor is not None:
            return detections.T_map_sensor
        robot, sensor = detections.robot, detections.sensor
        optical = f"{sensor}_optical" in self.frames.frames(robot)
        try:
            return self.frames.sensor_pose(robot, sensor, detections.stamp_ns, optical=optical)
        except PoseUnavailable:
            return None

    def _realign(self, correction: PoseCorrection) -> Delta:
        """Move the things that were seen from poses that turned out to be others; the voxels do not follow yet."""
        robot = correction.robot
        before = [
            pose.T_map_base_before or self.frames.lookup(robot, MAP, BASE, pose.stamp_ns) for pose in correction.poses
        ]
        corrections = Corrections(correction, before)
        self.frames.correct(robot, corrections.at)
        moves = motions(self.graph, corrections, self.sightings)
        source = f"{robot}/correction@{correction.stamp_ns}"
        return self._commit(
            self.perception.realign(moves, corrections, self.graph, source, correction.stamp_ns), correction.stamp_ns
        )

    def _seen(self, changes: GraphChanges, by: RgbdImage | Scan | Detections) -> Delta:
        """Commit what follows from what was seen, and remember when and by whom."""
        delta = self._commit(changes, by.stamp_ns)
        self.sightings.note(delta, by.robot, by.stamp_ns)
        return delta

    @property
    def _moving(self) -> Any:
        """(65536,) bool: the classes that are left out of the static map; None: none is."""
        return None if self.config.moving == "fuse" else self.labels.moving

    def _commit(self, changes: GraphChanges, stamp_ns: int) -> Delta:
        touched = {step.id for step in changes.steps if isinstance(step, Node | NodeDeletion)}
        before = {node_id: self.graph.node(node_id) for node_id in touched if node_id in self.graph}
        delta = self.graph.commit(changes, max(stamp_ns, self.graph.stamp_ns))
        self.event_log.add(events_of(delta, before))
        if self._past.is_asked_for:
            put, deleted = self._past.catch_up(self.graph, self.event_log)
            self._knowledge.update(put=put, deleted=deleted)
        if self.watches and not self.watches.by_hand:
            self.watches.refresh()
        return delta

    # -- answers out --------------------------------------------------------------------------------------
    def ask(
        self, goal: str, *, robot: str | None = None, limit: int = 100, timeout_s: float = 1.0, at_ns: int | None = None
    ) -> Answers:
        """Ask a goal such as `near(X, oven), on(X, Y)`, where a class name stands for any instance, or a question such
        as "which cups are on a table?", where what is sought is called `Target`, `Count`, `Metres`, …

        robot : whose viewpoint left and right mean;  at_ns : ask the graph as it was then (its edges, not new
        inferences)
        """
        asked = phrases.read(goal, self._knowledge)

        def answer(explain: bool) -> Answers:
            if at_ns is None and asks_for(asked.goal):
                self._measure_for(asked.goal)
            return self.meaning.ask(
                asked, self.graph, robot=robot, limit=limit, timeout_s=timeout_s, at_ns=at_ns, explain=explain,
                why=lambda: self._witnessed(answer(True).reply.explanation),
            )  # fmt: skip

        return answer(False)

    def watch(
        self,
        goal: str,
        *,
        robot: str | None = None,
        limit: int = 100,
        timeout_s: float = 1.0,
        on_change: Callable[[AnswerChange], object] | None = None,
    ) -> Watch:
        """Keep a goal answered: `with world.watch("near(X, oven)") as changes:`, and `for change in changes:` whenever
        something was integrated or told. The first change tells the answers that there are.

        on_change : called with each change instead;  robot, limit, timeout_s : as of `ask`

        Raises `GoalRefused` with the problem that asking the goal has.
        """
        return self.watches.add(goal, robot, limit, timeout_s, on_change)

    def _witnessed(self, why: Explanation | None) -> Explanation | None:
        """An explanation with the observations that the graph's edges were seen by."""

        def by(relation: str, source: str, target: str) -> tuple[str, ...]:
            edge = self.graph.edge(relation, source, target)
            return () if edge is None else tuple(map(str, edge.evidence))

        return None if why is None else why.witnessed(by)

    def _measure_for(self, goal: str) -> None:
        """Measure what a goal asks for that is not kept: what is seen, reached and blocked, and the outlines of what
        may lie between."""
        perception = self.perception
        access = Access(
            self.graph, perception.objects.shapes, self.map.occupancy, perception.building, self.robots,
            self.config.robot_radius_m,
        )  # fmt: skip
        measured = access.measure(goal)
        measured.deleted = outdated(self._asked_for, measured)
        self._asked_for = set(measured.put)
        self.meaning.note(measured)
        if asks_between(goal):
            shapes = perception.objects.shapes
            self.meaning.outline({thing: s.outline for thing, s in shapes.items() if len(s.outline) > 2})

    def _tell_past(self, what: str) -> bool:
        """Tell the rules what they need to know of the past; returns whether that was new."""
        if self._past.knows(what):
            return False
        put, deleted = self._past.supply(what, self.graph, self.event_log)
        self._knowledge.update(put=put, deleted=deleted)
        return True

    def where(self, phrase: str, *, robot: str | None = None) -> Place:
        """Where a phrase (`near the oven`) or a goal with one variable (`cup(X)`) is: nodes, region, reachable
        poses."""
        finder = self._place_finder()
        understood = finder.read(phrase)
        if asks_for(understood.goal) or asks_between(understood.goal):
            self._measure_for(understood.goal)
        return finder.find(phrase, understood, robot)

    def _place_finder(self) -> PlaceFinder:
        return PlaceFinder(
            self.graph, self.map.occupancy, self._knowledge, self.robots, self.config.robot_radius_m,
            self.perception.building.floor_below,
        )  # fmt: skip

    def plan(
        self,
        goal: str,
        *,
        robot: str | None = None,
        timeout_s: float = 10.0,
        engine: str = "pyperplan",
        domain: str | Path | DomainMapping | None = None,
    ) -> Plan:
        """A plan that brings a goal about, such as `on(cup, table)`: steps with node ids, preconditions and poses.

        goal      a conjunction of on, in, near, holding, open, closed, switched_on, switched_off, poured; classes stand
                  for any instance, `\\+` for what shall not hold, forall(cup(X), in(X, kitchen)) for all; conditions of
                  other words say what is meant: cup(X), attribute(X, color, red), on(X, table)
        robot     who acts, with its hand and width as it described them; default: the one that was seen last
        timeout_s for looking for it; the first plan also waits for the planner's process to start
        engine    another planner that unified-planning knows, such as "fast-downward"
        domain    a mapping to a domain of your own, or the file it is in (`scenegraph.planning.mapping`); default: the
                  household domain
        """
        from scenegraph.planning.desk import run

        if domain is None:
            return run(self.planning(goal, robot=robot, timeout_s=timeout_s), self.planner, engine)
        planning = self._plan_desk().planning_in(domain, goal, robot=robot, timeout_s=timeout_s)
        return run(planning, self.planner, engine)

    def planning(self, goal: str, *, robot: str | None = None, timeout_s: float = 10.0) -> Planning[Plan]:
        """As `plan`, for whoever lets the planner work in a thread of its own: yields what is to be solved, is sent
        what was found, and returns the plan."""
        return self._plan_desk().planning(goal, robot=robot, timeout_s=timeout_s)

    def planning_task(self, goal: str, *, robot: str | None = None, scoped: bool = True) -> Task:
        """What a planner is given for a goal: `.domain.text` and `.pddl` are PDDL texts, and
        `reasoning.planning.unified.to_unified` makes a unified-planning problem of it.

        scoped  only what the goal and the actions can touch; else everything in the graph

        Raises `GoalRefused` when the goal cannot be planned for.
        """
        return self._plan_desk().task(goal, robot=robot, scoped=scoped)

    def verify(self, plan: Plan, *, done: int = 0) -> PlanCheck:
        """Whether a plan still leads to its goal in the graph as it is now: for each step that is left whether it can
        be taken, and if not why; its first `done` steps were taken."""
        return self._plan_desk().verify(plan, done=done)

    def replan(self, plan: Plan, *, done: int = 0, timeout_s: float = 10.0) -> Plan:
        """The plan itself while it holds, its first `done` steps taken; else a new one for its goal from how things are
        now."""
        if self.verify(plan, done=done):
            return plan
        robot = None if plan.robot is None else plan.robot.removeprefix("agent_")
        return self.plan(plan.goal, robot=robot, timeout_s=timeout_s)

    def _plan_desk(self) -> PlanDesk:
        from scenegraph.planning.desk import PlanDesk

        finder = self._place_finder()
        seen_from = None if self.T_map_camera is None else self.T_map_camera.translation.tolist()
        return PlanDesk(
            self.graph,
            self._knowledge,
            robots=self.robots,
            radius_m=self.config.robot_radius_m,
            finder=finder,
            place=None if seen_from is None else (seen_from[0], seen_from[1], seen_from[2]),
        )

    def tell(self, statement: str, *, author: str, reason: str = "") -> TellResult:
        """State something: `fact(T)`, `retract(T)`, `rename(Id, Name)`, `set(Id, Attribute, Value)`, `delete(Id)`,
        `merge(Id, Id)` of two things or two rooms, `room(Name, Polygon)`, `room(Name, Polygon, Storey)`, `split(Room,
        [[X, Y], [X, Y]])`, `rules(Name, Text)` that define new words by those there are, `forget_rules(Name)`. Mapping
        on keeps it.
        """
        try:
            told = statements.read(statement, author, reason, self.graph.stamp_ns, self._knowledge)
            changes = self.perception.obey(told, self.graph)
            self.meaning.accept(told)
        except SceneGraphError as error:
            return TellResult(False, self.graph.revision, statements.problem(error))
        self.statements.append(told)
        return TellResult(True, self._commit(changes, told.stamp_ns).revision)

    def events(self, since_ns: int | None = None) -> list[Event]:
        """What happened to things, oldest first: *appeared, moved, vanished, merged, split, relabelled*, with when,
        where and why; only what is stamped later than `since_ns`."""
        return self.event_log.since(since_ns)

    def status(self) -> dict[str, Any]:
        """Sizes of every layer and of the graph, and the health of the reasoner."""
        return {
            "revision": self.graph.revision,
            "stamp_ns": self.graph.stamp_ns,
            "layers": {
                name: {
                    "blocks": len(layer.block_ijk),
                    "memory_bytes": layer.memory_bytes,
                    "voxel_size_m": layer.voxel_size_m,
                }
                for name, layer in self.map.layers.items()
            },
            "planes": len(self.map.planes),
            "nodes": {layer: len(self.graph.nodes(layer)) for layer in LAYERS},
            "edges": self.graph.n_edges,
            "classes": [c.name for c in self.labels.classes],
            "facts": len(self._knowledge),
            "rules": self._knowledge.rules,
            "reasoner": {"pid": self._knowledge.engine.pid, "restarts": self._knowledge.engine.restarts},
            "waiting_detections": self._desk.waiting,
        }

    # -- life ---------------------------------------------------------------------------------------------
    def save(self, path: str | Path) -> None:
        """Write the world to one file, whole or not at all."""
        storing.save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a world that `save` wrote. Raises `StoreError` when the file is damaged, foreign or too new."""
        return storing.load(cls, Path(path))

    def close(self) -> None:
        """End the processes of reasoner and planner."""
        self._knowledge.close()
        self.planner.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _source(observation: RgbdImage | Scan | Detections) -> str:
    return f"{observation.robot}/{observation.sensor}@{observation.stamp_ns}"
