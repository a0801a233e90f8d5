"""Where the graph meets the rules: facts out, derived edges, labels, room types and answers back in."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Any, cast

from mapping.observations import ClassInfo, RobotDescription
from reasoning.errors import InvalidRules
from reasoning.knowledge import DerivedEdge, Explanation, KnowledgeBase, Phrase, Reply
from reasoning.labelling import PlaneFacts, PlaneRelation, PlaneRules
from reasoning.terms import Atom, Compound, Term, Var
from scenegraph import facts, phrases
from scenegraph.answers import Answers
from scenegraph.config import WorldConfig
from scenegraph.doubts import CONTRARY, Doubts
from scenegraph.errors import InvalidStatement
from scenegraph.graph import Edge, EdgeKey, GraphChanges, Node, SceneGraph
from scenegraph.graph.delta import NodeDeletion
from scenegraph.perception.relations import CONTACTS, MeasurementChange
from scenegraph.statements import Statement

log = logging.getLogger(__name__)

DERIVED = frozenset(
    {
        "on", "supports", "in", "contains", "above", "under", "near", "touching", "next_to",
        "attached_to", "hanging_from", "part_of",
    }
)  # fmt: skip
"""Relations whose stored edges follow the rules; other stored edges are facts of their own."""


PARTS = ("room_", "storey_", "place_")
"""Nodes whose `in` edges say how the building is divided: no rule derives them."""


def follows_rules(edge: Edge) -> bool:
    """Whether an edge is there because the rules derive it; what parts of the building contain is a fact of its own."""
    part = edge.target if edge.relation == "contains" else edge.source
    return edge.relation in DERIVED and not part.startswith(PARTS)


def is_told(edge: Edge) -> bool:
    """Whether the rules are told of an edge: not of what they derive, nor of the ways between places."""
    return edge.relation != "connected_to" and not follows_rules(edge) and not edge.target.startswith("place_")


class Meaning:
    """Keeps the knowledge base in step with the graph, and the graph with what the rules derive."""

    def __init__(self, knowledge: KnowledgeBase, config: WorldConfig) -> None:
        self.knowledge = knowledge
        self._facts_of: dict[str, frozenset[Compound]] = {}
        self._outlined: dict[str, Any] = {}
        self._plane_rules = PlaneRules.of(knowledge)
        self._containers: dict[str, bool] = {}
        self._structural: dict[str, bool] = {}
        self._doubts = Doubts()
        knowledge.update(
            put=[
                Compound("parameter", (Atom("voxel_size_m"), config.fine_voxel_size_m)),
                Compound("parameter", (Atom("robot_width_m"), 2.0 * config.robot_radius_m)),
                Compound("unobserved", (Atom("world"),)),
            ]
        )

    # -- the taxonomy -------------------------------------------------------------------------------------
    def learn_classes(self, classes: Sequence[ClassInfo]) -> None:
        """Tell the rules of new classes."""
        self.knowledge.update(put=facts.class_facts((c.name, c.kind, c.parent) for c in classes))
        self._containers.clear()
        self._structural.clear()

    def learn_robot(self, robot: RobotDescription) -> None:
        """Tell the rules how wide an opening a robot needs, how far it reaches and what it carries, as far as it
        said."""
        abilities = {"width_m": 2.0 * robot.radius_m, "height_m": robot.height_m, "reach_m": robot.reach_m,
                     "max_width_m": robot.max_width_m, "payload_kg": robot.payload_kg}  # fmt: skip
        known = [(name, float(value)) for name, value in abilities.items() if value is not None]
        subject = Atom(f"agent_{robot.robot}")
        self.knowledge.update(put=[Compound("attribute", (subject, Atom(name), value)) for name, value in known])

    def is_container(self, label: str) -> bool:
        """Whether the taxonomy calls things of this class containers."""
        return self._known(self._containers, label, lambda c: Compound("container_class", (c,)))

    @property
    def near_m(self) -> tuple[float, float]:
        """Between which bounds [m] the rules say how near is near."""
        goal = "spatial:threshold(near_least, Least, _, _), spatial:threshold(near_most, Most, _, _)"
        [answer] = self.knowledge.call(goal, limit=1)
        return float(cast(float, answer["Least"])), float(cast(float, answer["Most"]))

    def is_structural(self, label: str) -> bool:
        """Whether things of this class are part of the building: doors, windows."""
        return self._known(self._structural, label, lambda c: Compound("subclass", (c, Atom("structure"))))

    def label_planes(self, planes: Sequence[PlaneFacts], relations: Sequence[PlaneRelation]) -> Mapping[int, str]:
        """What each of the planes is, by its id."""
        return self._plane_rules.label(planes, relations).labels

    def _known(self, cache: dict[str, bool], label: str, goal: Any) -> bool:
        if label not in cache:
            cache[label] = bool(self.knowledge.call(goal(Atom(facts.class_atom(label))), limit=1))
        return cache[label]

    # -- the graph ----------------------------------------------------------------------------------------
    def infer(
        self,
        changes: GraphChanges,
        measured: MeasurementChange,
        touched: Iterable[str],
        graph: SceneGraph,
        source: str,
        stamp_ns: int,
        seen: Set[str] | None = None,
    ) -> None:
        """Tell the rules what changed, and add to `changes` the edges and room types that now follow or fail.

        touched: what may have new edges, beside the things that were found to rest on, or to be held by, something else
        seen: the things in view of an observation; None: an operator's word, against which no doubt is due
        """
        last = {step.id: step for step in changes.steps if isinstance(step, Node | NodeDeletion)}
        nodes = {node_id: step for node_id, step in last.items() if isinstance(step, Node)}
        gone = last.keys() - nodes.keys()
        put, deleted = facts.measurement_facts(measured)
        for node in nodes.values():
            fresh = frozenset(facts.node_facts(node))
            put += fresh - self._facts_of.get(node.id, frozenset())
            self._facts_of[node.id] = fresh
            if self._outlined.pop(node.id, None) is not None:
                deleted.append(facts.outline_key_fact(node.id))
        put += [facts.edge_fact(step) for step in changes.steps if isinstance(step, Edge) and is_told(step)]
        deleted += [
            facts.edge_key_fact(step)
            for step in changes.steps
            if isinstance(step, EdgeKey) and step.relation != "connected_to"
        ]
        for node_id in gone:
            self._facts_of.pop(node_id, None)
            self._outlined.pop(node_id, None)
        self.knowledge.update(put=put, deleted=deleted, forget=sorted(gone))

        resettled = {key[1] for key in (*measured.put, *measured.deleted) if key[0] in CONTACTS}
        asked = sorted((resettled | set(touched)) - gone)
        looked_at, derived = self.knowledge.derived_edges(asked) if asked else ([], [])
        failing = self._bring_edges_in_step(changes, looked_at, derived, graph, source, stamp_ns)
        failing = {key for key in failing if gone.isdisjoint(key[1:])}
        self._doubts.forget(gone)
        self._doubts.weigh(failing, derived, None if seen is None else seen - gone, graph, nodes, changes)
        self._type_rooms(changes, nodes, gone, graph)

    @staticmethod
    def _bring_edges_in_step(
        changes: GraphChanges,
        looked_at: list[str],
        derived: list[DerivedEdge],
        graph: SceneGraph,
        source: str,
        stamp_ns: int,
    ) -> set[EdgeKey]:
        """Put the edges that are new, changed or no longer in doubt; returns those that were looked at and fail."""
        known_at = (node_id for node_id in looked_at if node_id in graph)
        stale = {edge.key for node_id in known_at for edge in graph.edges_of(node_id) if follows_rules(edge)}
        for edge in derived:
            key = EdgeKey(edge.relation, edge.source, edge.target)
            stale.discard(key)
            known = graph.edge(*key)
            if known is not None and _confirms(known, edge):
                continue
            changes.put(facts.derived_edge(edge, known, (source,), stamp_ns))
        return stale

    def _type_rooms(self, changes: GraphChanges, nodes: dict[str, Node], gone: set[str], graph: SceneGraph) -> None:
        """Write the type that the rules give a room, with the reason, where it changed."""
        housed = [s for s in changes.steps if isinstance(s, Edge | EdgeKey) and s.relation == "in"]
        touched = {s.target for s in housed if not s.source.startswith("place_")}
        rooms = {i: graph.node(i) for i in touched - gone if i in graph and graph.node(i).layer == "room"}
        rooms.update({i: n for i, n in nodes.items() if n.layer == "room"})
        for room_id in sorted(rooms):
            goal = Compound("room_type", (Atom(room_id), Var("Type"), Var("Reason")))
            answers = self.knowledge.call(goal, limit=1)
            room = rooms[room_id]
            kind = str(answers[0]["Type"]) if answers else None
            reason = _reason(answers[0]["Reason"]) if answers else None
            if (room.attributes.get("type"), room.attributes.get("type_reason")) != (kind, reason):
                attributes = {k: v for k, v in room.attributes.items() if k not in ("type", "type_reason")}
                if kind is not None:
                    attributes |= {"type": kind, "type_reason": reason}
                changes.put(room.replace(label=kind or "room", attributes=attributes))

    def note(self, measured: MeasurementChange) -> None:
        """Tell the rules what was measured for a question, in the place of what was measured for the one before."""
        put, deleted = facts.measurement_facts(measured)
        self.knowledge.update(put=put, deleted=deleted)

    def outline(self, hulls: Mapping[str, Any]) -> None:
        """Tell the rules the ground projections of things, corners (K, 2) [m] by id: of those that are new or changed.

        They know it until the thing changes.
        """
        fresh = {i: hull for i, hull in hulls.items() if self._outlined.get(i) is not hull and i in self._facts_of}
        self.knowledge.update(put=[facts.outline_fact(i, hull) for i, hull in fresh.items()])
        self._outlined.update(fresh)

    # -- questions ----------------------------------------------------------------------------------------
    def ask(
        self,
        asked: Phrase,
        graph: SceneGraph,
        *,
        robot: str | None,
        limit: int,
        timeout_s: float,
        at_ns: int | None,
        explain: bool = False,
        why: Callable[[], Explanation | None] | None = None,
    ) -> Answers:
        """Ask a goal, or what a phrase means, now, or of the graph as it was; `why` asks again for the explanation."""
        if asked.problem is not None:
            return Answers(Reply("unknown", problem=asked.problem), graph.revision, {})
        goal = asked.goal
        viewer = f"agent_{robot}" if robot is not None else None
        if at_ns is not None:
            past = graph.as_of(at_ns)
            with KnowledgeBase() as memory:
                memory.update(
                    put=[
                        *self._class_facts(),
                        *(f for n in past.nodes() for f in facts.node_facts(n)),
                        *map(facts.edge_fact, past.edges()),
                    ]
                )
                reply = memory.ask(goal, limit=limit, timeout_s=timeout_s, explain=True, viewer=viewer)
            return Answers(phrases.answered(asked, reply), past.revision, {n.id: n for n in past.nodes()})
        reply = self.knowledge.ask(goal, limit=limit, timeout_s=timeout_s, explain=explain, viewer=viewer)
        return self.answers(phrases.answered(asked, reply), graph, why)

    @staticmethod
    def answers(reply: Reply, graph: SceneGraph, why: Callable[[], Explanation | None] | None = None) -> Answers:
        """A reply with the nodes that it names, as they are now."""
        named = {t.name for row in reply.answers for t in row.values() if isinstance(t, Atom)}
        return Answers(reply, graph.revision, {i: graph.node(i) for i in named if i in graph}, why)

    def _class_facts(self) -> list[Compound]:
        return [
            Compound("class_info", (row["C"], row["K"], row["P"]))
            for row in self.knowledge.call("class_info(C, K, P)")
        ]  # fmt: skip

    # -- statements ---------------------------------------------------------------------------------------
    def accept(self, told: Statement) -> None:
        """Tell the rules a fact, or that it holds no longer, or rules; other statements reach them through the graph.

        Raises `InvalidStatement` when a class would be below itself, and for rules that are refused.
        """
        if told.kind in ("rules", "forget_rules"):
            self._take_rules(told, again=False)
        elif told.kind == "subclass":
            self._place_class(*(facts.class_atom(str(name)) for name in told.args))
        if told.kind == "fact":
            self.knowledge.update(put=[Compound("told", told.args)])
        elif told.kind == "retract":
            self.knowledge.update(deleted=[Compound("told", told.args)])

    def _take_rules(self, told: Statement, *, again: bool) -> None:
        name, *text = (str(argument) for argument in told.args)
        try:
            if text:
                self.knowledge.learn(name, text[0], again=again)
            else:
                self.knowledge.unlearn(name)
        except InvalidRules as error:
            raise InvalidStatement(str(error), hint=error.hint) from None

    def _place_class(self, below: str, above: str) -> None:
        """Put one class below another in the taxonomy."""
        if below == above or self.knowledge.call(Compound("subclass", (Atom(above), Atom(below))), limit=1):
            raise InvalidStatement(
                f"subclass: {above} is below {below} already, so that the taxonomy would run in a circle"
            )
        self.knowledge.update(put=[Compound("told", (Compound("subclass", (Atom(below), Atom(above))),))])
        self._containers.clear()
        self._structural.clear()

    def remember(
        self,
        graph: SceneGraph,
        classes: Sequence[ClassInfo],
        measured: MeasurementChange,
        statements: Sequence[Statement],
    ) -> None:
        """Tell the rules everything about a world that comes back from disk."""
        self.learn_classes(classes)
        put = facts.measurement_facts(measured)[0]
        for node in graph.nodes():
            self._facts_of[node.id] = frozenset(facts.node_facts(node))
            put += self._facts_of[node.id]
        put += [facts.edge_fact(edge) for edge in graph.edges() if is_told(edge)]
        self.knowledge.update(put=put)
        self._doubts.remember(graph.edges())
        for told in statements:
            if told.kind in ("rules", "forget_rules"):
                try:
                    self._take_rules(told, again=True)
                except InvalidStatement as error:  # a later version may have a word of that name
                    log.warning("rules that were told before are refused now: %s", error)
            else:
                self.accept(told)


def _reason(term: Term) -> str:
    return term if isinstance(term, str) else str(term)


def _confirms(known: Edge, derived: DerivedEdge) -> bool:
    """Whether an edge says what was derived, and is not in doubt."""
    return (known.value, known.threshold) == (derived.value, derived.threshold) and CONTRARY not in known.attributes
