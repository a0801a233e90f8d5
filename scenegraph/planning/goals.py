"""What a goal asks for: its wishes, the things that they may be about, and the choice among them."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import TypeAlias, cast

from reasoning.errors import GoalFailed, InvalidTerm
from reasoning.knowledge import KnowledgeBase
from reasoning.planning import Fact, fact_text
from reasoning.terms import Atom, Compound, Term, Var
from scenegraph.errors import GoalRefused
from scenegraph.planning.situation import Scope, Situation

__all__ = ["Aim", "Chooser", "Goal", "GoalReader", "Group", "Literal", "Wish"]

Literal: TypeAlias = tuple[bool, Fact]

WIDTHS = (6, 60, 100_000)
"""Of things of a class so many are weighed against each other, the nearest first; more where these will not do."""
MOST_COMBINATIONS = 4_000
MOST_REASONS = 50
MOST_HOSTS = 3


@dataclass(frozen=True)
class Wish:
    """One relation that shall hold, or shall not. Arguments are ids, or `?0`, `?1`, … for what is to be chosen."""

    holds: bool
    name: str
    arguments: tuple[str, ...]

    def bound(self, binding: dict[str, str]) -> Wish:
        """The wish with what was chosen in its place."""
        return Wish(self.holds, self.name, tuple(binding.get(a, a) for a in self.arguments))

    def told(self, names: Mapping[str, str]) -> str:
        """The wish as a text, classes by their names."""
        text = fact_text((self.name, *(names.get(a, a) for a in self.arguments)))
        return text if self.holds else f"\\+ {text}"


@dataclass(frozen=True)
class Aim:
    """One way to bring about what a group of wishes asks for: what a planner is told, and what it will cost, roughly.

    cost : a way [m]; 0 when it holds already
    """

    cost: float
    literals: tuple[Literal, ...]
    scope: Scope
    about: frozenset[str]


@dataclass(frozen=True)
class Group:
    """Wishes that share what is to be chosen, with the candidates for each, the class that each stands for, and which
    of them go together."""

    wishes: tuple[Wish, ...]
    domains: Mapping[str, tuple[str, ...]]
    names: Mapping[str, str]
    relations: tuple[tuple[tuple[str, ...], frozenset[tuple[str, ...]]], ...] = ()


@dataclass(frozen=True)
class Goal:
    """A goal, taken apart."""

    text: str
    groups: tuple[Group, ...]


class GoalReader:
    """Reads goals with the words and names that a world knows."""

    def __init__(self, knowledge: KnowledgeBase) -> None:
        self._knowledge = knowledge

    def read(self, text: str) -> Goal:
        """Take a goal apart. Raises `GoalRefused`."""
        try:
            [answer] = self._knowledge.call(Compound("plan_goal", (text, Var("Reading"))), limit=1)
        except (GoalFailed, InvalidTerm) as error:
            raise GoalRefused(error.code, str(error), error.hint) from None
        reading = cast(Compound, answer["Reading"])
        if reading.name == "problem":
            code, message, hint = (str(part) for part in reading.args)
            raise GoalRefused(code, message, hint or None)
        wishes, domains, contexts = (cast(list[Compound], part) for part in reading.args)
        found = [_wish(wish) for wish in wishes]
        candidates: dict[str, tuple[str, ...]] = {}
        classes: dict[str, str] = {}
        for domain in domains:
            variable, name, ids = domain.args
            classes[_name(variable)] = str(name)
            candidates[_name(variable)] = tuple(str(i) for i in cast(list[Term], ids))
            if not ids:
                raise GoalRefused(
                    "none_known", f"no {name} is known: the world is not fully seen", "look for one first"
                )
        relations = []
        for context in contexts:
            condition, names, rows = context.args
            variables = tuple(_name(v) for v in cast(list[Term], names))
            held = frozenset(tuple(str(v) for v in cast(list[Term], row)) for row in cast(list[Term], rows))
            if not held:
                raise GoalRefused(
                    "none_known",
                    f"nothing is known of which it holds: {condition}",
                    "the world is not fully seen: look for it first",
                )
            relations.append((variables, held))
        return Goal(text, tuple(_groups(found, candidates, classes, relations)))


def _name(term: Term) -> str:
    if isinstance(term, Compound) and term.name == "v":
        return f"?{term.args[0]}"
    if isinstance(term, Atom):
        return term.name
    raise GoalRefused("bad_argument", f"{term} is not a thing: expected an id, a class or a variable")


def _wish(term: Compound) -> Wish:
    sign, call = term.args
    assert isinstance(call, Compound)
    holds, name, arguments = str(sign) == "yes", call.name, tuple(_name(a) for a in call.args)
    match name:  # each relation has one name here
        case "supports":
            name, arguments = "on", arguments[::-1]
        case "contains":
            name, arguments = "in", arguments[::-1]
        case "closed":
            name, holds = "open", not holds
        case "switched_off":
            name, holds = "switched_on", not holds
    return Wish(holds, name, arguments)


def _groups(
    wishes: Sequence[Wish],
    candidates: Mapping[str, tuple[str, ...]],
    classes: Mapping[str, str],
    relations: Sequence[tuple[tuple[str, ...], frozenset[tuple[str, ...]]]],
) -> Iterator[Group]:
    """Wishes that share a variable, or have variables in one condition, belong together."""
    sets: list[tuple[set[str], list[Wish]]] = []
    for wish in wishes:
        variables = {a for a in wish.arguments if a[0] == "?"}
        joined: tuple[set[str], list[Wish]] = (variables, [wish])
        apart = []
        for group in sets:
            linked = group[0] & joined[0] or any(
                group[0] & set(names) and joined[0] & set(names) for names, _ in relations
            )
            if linked:
                joined = (group[0] | joined[0], [*group[1], *joined[1]])
            else:
                apart.append(group)
        sets = [*apart, joined]
    order = {wish: k for k, wish in enumerate(wishes)}
    for variables, members in sorted(sets, key=lambda group: order[group[1][0]]):
        about = tuple((names, rows) for names, rows in relations if set(names) & variables or not names)
        extra = {name for names, _ in about for name in names}
        for name in sorted(variables):
            if name not in candidates and not any(name in names for names, _ in about):
                wish = next(w for w in members if name in w.arguments)
                raise GoalRefused(
                    "unbound_variable",
                    f"anything may stand for a variable of {wish.name}: say what it is",
                    f"cup(X), {wish.name}(X, table)",
                )
        domains = {name: candidates[name] for name in sorted(variables | extra) if name in candidates}
        yield Group(tuple(members), domains, classes, about)


def _together(ways: Sequence[Aim], binding: dict[str, str]) -> Aim | None:
    """Ways of bringing single wishes about as one; None when they contradict each other."""
    literals = tuple(dict.fromkeys(literal for way in ways for literal in way.literals))
    if any((not holds, fact) in literals for holds, fact in literals):
        return None
    scope = Scope()
    for way in ways:
        scope.join(way.scope)
    about = frozenset().union(*(way.about for way in ways)) | frozenset(binding.values())
    return Aim(sum(way.cost for way in ways), literals, scope, about)


class Chooser:
    """Weighs what the wishes of a group may be about, in a situation."""

    def __init__(self, situation: Situation) -> None:
        self._now = situation
        self._found: dict[Wish, list[Aim]] = {}

    def aims(self, group: Group) -> tuple[list[Aim], list[str]]:
        """The ways to bring a group about, cheapest first; and why others are none."""
        reasons: list[str] = []
        found: list[tuple[float, int, Aim]] = []
        for most in WIDTHS:
            bindings = self._bindings(group, most, reasons)
            for number, binding in enumerate(islice(bindings, MOST_COMBINATIONS)):
                options = [self._ways(wish.bound(binding), reasons) for wish in group.wishes]
                for ways in islice(product(*options), 12):
                    aim = _together(ways, binding)
                    if aim is not None:
                        found.append((aim.cost, number, aim))
                if found and found[-1][0] == 0.0:
                    return [found[-1][2]], reasons
            if found:
                break
        best = heapq.nsmallest(200, found, key=lambda item: item[:2])
        return [aim for *_, aim in best], list(dict.fromkeys(reasons))

    def _bindings(self, group: Group, most: int, reasons: list[str]) -> Iterator[dict[str, str]]:
        """What may stand for the variables of a group: what fits already, then the `most` nearest for each."""
        named = {a for wish in group.wishes for a in wish.arguments if a[0] == "?"}
        domains = {name: list(ids) for name, ids in group.domains.items()}
        joint = []
        for names, held in group.relations:
            if len(names) == 1:
                only = {row[0] for row in held}
                known = domains.get(names[0])
                domains[names[0]] = sorted(only) if known is None else [v for v in known if v in only]
            else:
                joint.append((names, held))
        fitting = self._fitting(group, domains) if not joint else []
        yield from (fit for fit in fitting if len(fit) == len(named))
        rows: list[dict[str, str]] = [{}]
        for names, held in joint:
            rows = [
                {**row, **dict(zip(names, values, strict=True))}
                for row in rows
                for values in sorted(held)
                if all(row.get(n, v) == v and v in domains.get(n, (v,)) for n, v in zip(names, values, strict=True))
            ][:MOST_COMBINATIONS]
        single = sorted(named - {name for names, _ in joint for name in names})
        alone = {n: [w for w in group.wishes if {a for a in w.arguments if a[0] == "?"} == {n}] for n in single}
        lists = [list(islice(self._feasible(n, domains[n], alone[n], reasons), most)) for n in single]
        for row, values in product(rows, product(*lists)):
            yield {**row, **dict(zip(single, values, strict=True))}

    def _fitting(self, group: Group, domains: Mapping[str, Sequence[str]]) -> list[dict[str, str]]:
        """A binding under which a lone relation of two things holds already."""
        if len(group.wishes) != 1 or group.wishes[0].name not in ("on", "in") or not group.wishes[0].holds:
            return []
        thing, host = group.wishes[0].arguments
        things = set(domains.get(thing, (thing,)))
        for carrier in domains.get(host, (host,)):
            if carrier in self._now.graph and self._now.graph.node(carrier).layer in ("object", "structure"):
                for child in self._now.children(carrier):
                    if child in things:
                        return [{n: v for n, v in ((thing, child), (host, carrier)) if n[0] == "?"}]
        return []

    def _feasible(self, name: str, ids: Sequence[str], wishes: Sequence[Wish], reasons: list[str]) -> Iterator[str]:
        """Candidates of which the wishes that are about them alone can be brought about, those nearest by air first;
        the nearest few of them in the order of the ways."""
        now = self._now
        known = [i for i in ids if i in now.graph]
        if now.site is not None and now.site in now.graph:
            at = now.graph.node(now.site).position.tolist()
            known.sort(key=lambda i: (math.dist(now.graph.node(i).position.tolist(), at), i))
        fit = (i for i in known if all(self._ways(wish.bound({name: i}), reasons) for wish in wishes))
        while few := list(islice(fit, 12)):
            yield from sorted(few, key=lambda i: (self._away(i), i))

    def _away(self, node_id: str) -> float:
        node = self._now.graph.node(node_id)
        return self._now.away_m(node_id) if node.layer in ("object", "structure", "room") else 0.0

    # -- wishes ----------------------------------------------------------------------------------------------
    def _ways(self, wish: Wish, reasons: list[str]) -> list[Aim]:
        """How a wish can be brought about; where it cannot, `reasons` is told why."""
        if wish not in self._found:
            try:
                self._found[wish] = list(getattr(self, f"_{wish.name}")(wish))
            except GoalRefused as refused:
                self._found[wish] = []
                if len(reasons) < MOST_REASONS:
                    reasons.append(refused.message)
        return self._found[wish]

    def _check(self, why_not: str | None) -> None:
        if why_not is not None:
            raise GoalRefused("impossible", why_not)

    def _on(self, wish: Wish) -> Iterator[Aim]:
        yield self._put(wish, *wish.arguments)

    def _in(self, wish: Wish) -> Iterator[Aim]:
        thing, into = wish.arguments
        layer = self._now.graph.node(into).layer
        if self._is_robot(thing):
            yield self._robot_in(wish, into)
        elif layer != "room":
            yield self._put(wish, thing, into)
        elif not wish.holds:
            raise GoalRefused("impossible", f"to take {thing} out of {into} is no goal: say where it shall be")
        elif self._now.room_of(thing) == into and self._now.held != thing:
            yield Aim(0.0, (), Scope(), frozenset())
        else:
            hosts = self._now.hosts_in(into, thing, "on", MOST_HOSTS, beside=into)
            self._check(None if hosts else f"nothing is known in {into} that {thing} could be put on")
            for host in hosts:
                yield self._put(Wish(True, "on", (thing, host)), thing, host)

    def _put(self, wish: Wish, thing: str, host: str) -> Aim:
        now, how = self._now, wish.name
        literal: Literal = (wish.holds, (how, thing, host))
        carried = now.host(thing)
        holds = carried is not None and carried[0] == host and (
            carried[1] == how or now.graph.edge(how, thing, host) is not None
        )  # fmt: skip
        things = {thing, host}
        if holds == wish.holds:
            return Aim(0.0, (literal,), Scope(things=things), frozenset())
        if now.held != thing:
            self._check(now.not_graspable(thing))
            self._check(now.not_reached(thing))
        if not wish.holds:
            return Aim(
                now.away_m(thing),
                (literal,),
                Scope(movable={thing}, hosts=now._aside(thing, 3) - {host}, things=things),
                frozenset({thing}),
            )
        self._check(now.not_fitting(thing, how, host))
        self._check(now.not_reached(host))
        cost = 1.0 + now.away_m(thing) + now.way_m(now.room_of(thing), now.room_of(host)) + self._trouble(thing)
        return Aim(cost, (literal,), Scope(movable={thing}, hosts={host}, things=things), frozenset({thing}))

    def _trouble(self, thing: str) -> float:
        """What it costs to get at a thing, as a way [m]."""
        kept = self._now.kept_in(thing)
        shut = kept is not None and self._now.graph.node(kept).layer != "room" and not self._now.opened(kept)
        return 4.0 * shut + 6.0 * len(self._now.children(thing))

    def _robot_in(self, wish: Wish, room: str) -> Aim:
        now = self._now
        literal: Literal = (wish.holds, ("within", now.robot, room))
        self._check(None if now.graph.node(room).layer == "room" else f"{now.robot} cannot be in {room}")
        self._check(None if wish.holds else f"to leave {room} is no goal: say where {now.robot} shall be")
        self._check(now.not_reached(room))
        return Aim(now.way_m(now.room, room), (literal,), Scope(rooms={room}), frozenset())

    def _near(self, wish: Wish) -> Iterator[Aim]:
        now = self._now
        a, b = wish.arguments
        if self._is_robot(b) and not self._is_robot(a):
            a, b = b, a
        self._check(None if wish.holds else f"that {a} is not near {b} is no goal: say where it shall be")
        if self._is_robot(a):
            self._check(now.not_reached(b))
            site = now.reached_from(b)
            yield Aim(now.away_m(b), ((True, ("at", now.robot, site)),), Scope(things={b}), frozenset())
            return
        if now.graph.edge("near", a, b) is not None and now.held != a and a not in now._moved:
            yield Aim(0.0, (), Scope(), frozenset())
            return
        hosts = [now.host(b)] if now.host(b) else []
        near = [host[0] for host in hosts if host is not None]
        near += [edge.target for edge in now.graph.edges("near", source=b) if (edge.value or 0.0) <= 0.3]
        fitting = [h for h in dict.fromkeys(near) if now.not_fitting(a, "on", h) is None and now.not_graspable(h)]
        self._check(None if fitting else f"nothing is known near {b} that {a} could be put on")
        for host in fitting[:MOST_HOSTS]:
            yield self._put(Wish(True, "on", (a, host)), a, host)

    def _holding(self, wish: Wish) -> Iterator[Aim]:
        now = self._now
        *robots, thing = wish.arguments
        for robot in robots:
            self._check(None if robot == now.robot else f"{robot} is not the robot that plans, {now.robot}")
        literal: Literal = (wish.holds, ("holding", now.robot, thing))
        if (now.held == thing) == wish.holds:
            yield Aim(0.0, (literal,), Scope(things={thing}), frozenset())
            return
        if not wish.holds:
            yield Aim(1.0, (literal,), Scope(movable={thing}, hosts=now._aside(thing)), frozenset({thing}))
            return
        self._check(now.not_graspable(thing))
        self._check(now.not_reached(thing))
        cost = 1.0 + now.away_m(thing) + self._trouble(thing)
        yield Aim(cost, (literal,), Scope(movable={thing}, things={thing}), frozenset({thing}))

    def _open(self, wish: Wish) -> Iterator[Aim]:
        now = self._now
        [thing] = wish.arguments
        if now.graph.node(thing).layer == "structure":
            door = now.routes.doors.get(thing)
            self._check(None if door else f"{thing} is no door that rooms are known to share")
            assert door is not None
            self._check(None if door.openable else f"{thing} is an opening and has no leaf")
            self._check(None if any(not math.isinf(now.way_m(now.room, r)) for r in door.rooms) else door.refused)
            scope = Scope(doors={thing}, rooms=set(door.rooms))
        else:
            label = now.graph.node(thing).label
            self._check(None if now.openable(thing) else f"{thing} is a {label}, which cannot be opened or closed")
            self._check(now.not_reached(thing))
            scope = Scope(things={thing})
        cost = 0.0 if now.opened(thing) == wish.holds else 1.0 + now.away_m(thing)
        yield Aim(cost, ((wish.holds, ("opened", thing)),), scope, frozenset())

    def _switched_on(self, wish: Wish) -> Iterator[Aim]:
        now = self._now
        [thing] = wish.arguments
        label = now.graph.node(thing).label
        self._check(None if now.affords(thing, "powered") else f"{thing} is a {label}, which cannot be switched")
        self._check(now.not_reached(thing))
        cost = 0.0 if now.switched_on(thing) == wish.holds else 1.0 + now.away_m(thing)
        yield Aim(cost, ((wish.holds, ("switched_on", thing)),), Scope(things={thing}), frozenset())

    def _poured(self, wish: Wish) -> Iterator[Aim]:
        now = self._now
        source, into = wish.arguments
        self._check(None if wish.holds else "what was poured cannot be brought back")
        for thing, what, words in ((source, "pourable", "be poured from"), (into, "vessel", "be poured into")):
            label = now.graph.node(thing).label
            self._check(None if now.affords(thing, what) else f"{thing} is a {label}, which cannot {words}")
            self._check(now.not_reached(thing))
        self._check(None if source != into else f"{source} cannot be poured into itself")
        self._check(now.not_graspable(source) if now.held != source else None)
        cost = 2.0 + now.away_m(source) + now.way_m(now.room_of(source), now.room_of(into)) + self._trouble(source)
        literal: Literal = (True, ("poured", source, into))
        yield Aim(
            cost, (literal,), Scope(movable={source}, things={source, into}, hosts=now._aside(source)), frozenset()
        )

    def _is_robot(self, node_id: str) -> bool:
        return node_id == self._now.robot
