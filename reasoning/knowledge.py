"""What is known, and asking for it: facts in by change, questions out with truth, answers and explanations."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

from reasoning.engine import Engine, learning
from reasoning.errors import GoalFailed, InvalidRules
from reasoning.facts import FactStore
from reasoning.terms import Atom, Compound, Term, Var, term_text
from reasoning.watching import Question, Watching

__all__ = ["DerivedEdge", "Explanation", "KnowledgeBase", "Phrase", "Problem", "Reply", "Test"]

Truth = Literal["true", "false", "unknown"]
Viewer = str | tuple[float, float, float] | None

_INFERENCES_PER_SECOND = 50_000_000


@dataclass(frozen=True, slots=True)
class Problem:
    """Why a question could not be asked, or not to its end."""

    code: str
    message: str
    hint: str | None = None


_RELATION = re.compile(r"([a-z]\w*)\(([a-z]\w*), ([a-z]\w*)\)")
_OPPOSITE = {">=": "<", "<": ">=", ">": "=<", "=<": ">"}
NO_WAY_M = 1.0e9
"""A way this long is none (`no_way` in `rules/spatial.pl`)."""


@dataclass(frozen=True, slots=True)
class Test:
    """A measurement that was to be such that `value comparison threshold` [unit]; as text, how it was."""

    __test__ = False  # not one of pytest's

    measurement: str
    value: Term
    comparison: str
    threshold_name: str
    threshold: Term
    unit: str | None

    def __str__(self) -> str:
        if self.comparison == "=":
            return f"{self.measurement.replace('_', ' ')} {self.value}"
        unit = {"metre": " m", "share": ""}.get(self.unit or "", "")
        name = "" if self.threshold_name == "nothing" else f" ({self.threshold_name})"
        limit = f"{_brief(self.threshold)}{unit}{name}"
        if self.passed is None:
            return f"{self.measurement} unknown, since the space was never seen: {self.comparison} {limit} is open"
        if self.unit == "metre" and isinstance(self.value, float) and self.value >= NO_WAY_M:
            return f"{self.measurement}: no way is known, to be {self.comparison} {limit}"
        comparison = self.comparison if self.passed else _OPPOSITE[self.comparison]
        return f"{self.measurement} {_brief(self.value)}{unit} {comparison} {limit}"

    @property
    def passed(self) -> bool | None:
        """Whether the value is as it was to be; None when it is not known."""
        if self.comparison not in _OPPOSITE:
            return True
        value, limit = self.value, self.threshold
        if not isinstance(value, int | float) or not isinstance(limit, int | float):
            return None
        return {">=": value >= limit, ">": value > limit, "=<": value <= limit, "<": value < limit}[self.comparison]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why something holds, or does not, or is open: the rule, the tests, the facts, and the same for its parts.

    For a goal that does not hold, the children of the part that fails are the candidates that came closest.
    observations : what an edge was seen by: `robot/sensor@stamp`
    """

    goal: str
    truth: Truth
    rule: str = ""
    tests: tuple[Test, ...] = ()
    evidence: tuple[Term, ...] = ()
    children: tuple[Explanation, ...] = ()
    observations: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The explanation as an indented text for people."""
        return "\n".join(self._lines(0))

    def _lines(self, depth: int) -> Iterator[str]:
        pad = "  " * depth
        mark = {"true": "yes", "false": "no", "unknown": "open"}[self.truth]
        yield f"{pad}{mark}: {self.goal}" + (f"   [{self.rule}]" if self.rule else "")
        for test in self.tests:
            yield f"{pad}    {test}"
        if not self.tests:
            for fact in self.evidence:
                yield f"{pad}    {fact}"
        if self.observations:
            yield f"{pad}    seen by {', '.join(self.observations)}"
        for child in self.children:
            yield from child._lines(depth + 1)

    def witnessed(self, by: Callable[[str, str, str], tuple[str, ...]]) -> Explanation:
        """The same with the observations of each relation in it; `by` gives them for relation, source and target."""
        found = _RELATION.fullmatch(self.goal)
        seen = by(*found.groups()) if found is not None and self.truth == "true" else ()
        children = tuple([child.witnessed(by) for child in self.children])
        return replace(self, children=children, observations=seen)

    def as_json(self) -> dict[str, Any]:
        """The explanation as plain dicts, lists, strings and numbers."""
        return {
            "goal": self.goal,
            "truth": self.truth,
            "rule": self.rule,
            "tests": [
                {
                    "measurement": test.measurement,
                    "value": _plain(test.value),
                    "comparison": test.comparison,
                    "threshold_name": test.threshold_name,
                    "threshold": _plain(test.threshold),
                    "unit": test.unit,
                }
                for test in self.tests
            ],
            "evidence": [term_text(fact) for fact in self.evidence],
            "children": [child.as_json() for child in self.children],
            "observations": list(self.observations),
        }


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of a question.

    truth       : "true" with at least one answer; "unknown" without one while one is possible; else "false"
    answers     : distinct bindings of the goal's visible variables; one empty dict when it has none and holds
    truncated   : whether there were more answers than the limit
    problem     : None, or why the goal could not be asked (to the end); then `answers` are those found before
    explanation : when asked for
    """

    truth: Truth
    answers: tuple[dict[str, Term], ...] = ()
    truncated: bool = False
    problem: Problem | None = None
    explanation: Explanation | None = None
    elapsed_ms: float = field(default=0.0, compare=False)


@dataclass(frozen=True, slots=True)
class Phrase:
    """What a phrase means.

    kind      : "thing": the goal finds what is meant; "place": it finds the landmarks, and `relation` leads from there;
                "question": the goal is answered by a number, a value, or yes and no
    relation  : for a place: near, in, on, under, above, behind, in_front_of, left_of, right_of, next_to, between
    variables : the names of the sought variables in `goal` (two landmarks for `between`; none for yes and no)
    definite  : the variables that were called by "the", with their nouns: when one has several values, ask back
    goal      : a goal for `KnowledgeBase.ask`
    problem   : None, or which word was not understood
    """

    kind: Literal["thing", "place", "question"]
    goal: str
    variables: tuple[str, ...] = ()
    definite: Mapping[str, str] = field(default_factory=dict)
    relation: str | None = None
    problem: Problem | None = None


class DerivedEdge(NamedTuple):
    """An edge that the rules derive: ids, the value that was compared, its threshold, and a confidence in 0.5 … 1."""

    relation: str
    source: str
    target: str
    value: float
    threshold: float
    confidence: float


class KnowledgeBase:
    """The facts and rules of one world; a context manager. One question at a time, from any thread.

    rule_files : a user's Prolog files; they may override thresholds (`:- override(contact_share(0.3)).`) and define
                 predicates of their own, which can then be asked
    """

    def __init__(self, rule_files: Sequence[Path | str] = ()) -> None:
        self._facts = FactStore()
        self._told: dict[str, tuple[str, dict[str, str]]] = {}
        self._engine = Engine(
            rule_files,
            remembered=self._facts.text,
            remembered_rules=lambda: {name: text for name, (text, _) in self._told.items()},
        )
        self._watching = Watching(self._engine, self._facts, _reply, _union)

    def __enter__(self) -> KnowledgeBase:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """How many facts are known."""
        return len(self._facts)

    @property
    def engine(self) -> Engine:
        """The process behind it (its `pid`, its `restarts`)."""
        return self._engine

    def close(self) -> None:
        """End the Prolog process."""
        self._engine.close()

    def update(
        self, put: Iterable[Compound] = (), deleted: Iterable[Compound] = (), forget: Iterable[str] = ()
    ) -> None:
        """Change the facts, in one round trip: `forget` ids, then remove `deleted`, then `put`.

        A fact that is put replaces the one with the same key (`reasoning.facts.FACTS`): a second
        `position(object_1, …)` takes the place of the first. `deleted` facts are found by their key too; a `Var` there
        matches anything. `forget` removes every fact about an id. Raises `InvalidFact`, `InvalidTerm`.
        """
        self._expect("updated", self._engine.tell(lambda: self._facts.change(put, deleted, forget)))

    def ask(
        self,
        goal: str,
        *,
        limit: int = 100,
        timeout_s: float = 1.0,
        explain: bool = False,
        viewer: Viewer = None,
    ) -> Reply:
        """Ask a goal in the vocabulary, within limits; never raises for what is wrong with the goal.

        viewer : whose left and right is meant: an id, or a point x, y, z in the map frame [m]
        """
        started = time.perf_counter()
        options = Compound(
            "options",
            (
                int(limit),
                float(timeout_s),
                int(timeout_s * _INFERENCES_PER_SECOND),
                Atom("true" if explain else "false"),
                _viewer(viewer),
            ),
        )
        request = Compound("ask", (options,))
        result = self._engine.request(request, goal, timeout_s=timeout_s)
        while self._watching.supplied(result):
            result = self._engine.request(request, goal, timeout_s=timeout_s)
        elapsed_ms = (time.perf_counter() - started) * 1e3
        return _reply(result, elapsed_ms, goal if explain else None)

    @property
    def watching(self) -> Watching:
        """The questions that are kept answered; `refresh` gives `Reply`s."""
        return self._watching

    def watch(self, goal: str, *, limit: int = 100, timeout_s: float = 1.0, viewer: Viewer = None) -> int:
        """Keep a goal answered, asked as by `ask`: the number under which `watching` has it."""
        return self._watching.add(Question(goal, int(limit), float(timeout_s), _viewer(viewer)))

    def call(
        self, goal: Compound | Atom | str, *, timeout_s: float = 10.0, limit: int = 1_000_000
    ) -> list[dict[str, Term]]:
        """Run a goal of our own: unchecked, every exported rule predicate in sight. Raises `GoalFailed`.

        Variables are named: `kb.call(Compound("near_distance", (Atom("a"), Atom("b"), Var("D"))))` → `[{"D": 0.5}]`.
        """
        text = goal if isinstance(goal, str) else term_text(goal)
        result = self._engine.request(Compound("call", (int(limit), float(timeout_s))), text, timeout_s=timeout_s)
        names, rows = self._expect("answers", result).args
        return list(_answers(names, rows))

    def derived_edges(self, ids: Iterable[str]) -> tuple[list[str], list[DerivedEdge]]:
        """Every edge that the rules now derive at `ids` and at what stands on them.

        Returns the ids that were looked at (sorted) and all derived edges that begin or end there, in both directions
        where both have a name: stored derived edges at these ids that are not among them no longer hold.
        """
        things: list[Any] = [Atom(node) for node in ids]
        goal = Compound("affected_edges", (things, Var("Ids"), Var("Text")))
        [answer] = self.call(goal, timeout_s=30.0)
        edges = []
        for line in str(answer["Text"]).splitlines():
            relation, inverse, a, b, *numbers = line.split(" ")
            value, threshold, confidence = map(float, numbers)
            edges.append(DerivedEdge(relation, a, b, value, threshold, confidence))
            if inverse != "none":
                edges.append(DerivedEdge(inverse, b, a, value, threshold, confidence))
        return [atom.name for atom in cast(list[Atom], answer["Ids"])], edges

    @property
    def rules(self) -> dict[str, dict[str, str]]:
        """The rules that were told, by name: the words that they define, with what each means."""
        return {name: dict(words) for name, (_, words) in self._told.items()}

    def learn(self, name: str, text: str, *, again: bool = False) -> dict[str, str]:
        """Take in rules that anybody told, in the place of those of that name: the words that they define.

        They may define new words, each with its signature, by the words there are, logic and arithmetic, and nothing
        else (`rules/told_rules.pl`). Raises `InvalidRules`, with the line; the rules are then those before.

        again : they were accepted before: what they name may be gone
        """
        if not name:
            raise InvalidRules("rules: expected a name for them")
        reply = self._expect_rules(
            self._engine.request(learning(name, "any" if again else "known"), text, timeout_s=5.0)
        )
        learned = [cast(Compound, word).args for word in cast(list[Term], reply.args[0])]
        words = {str(signature).replace(",", ", "): str(meaning) for signature, meaning in learned}
        self._told[name] = (text, words)
        self._watching.touch()
        return words

    def unlearn(self, name: str) -> None:
        """Forget the rules of that name. Raises `InvalidRules` when there are none, or others are defined by them."""
        self._expect_rules(self._engine.request(Compound("unlearn", (Atom(name),)), timeout_s=5.0))
        del self._told[name]
        self._watching.touch()

    @staticmethod
    def _expect_rules(result: Term) -> Compound:
        if _is(result, "problem"):
            trouble = _problem(result)
            raise InvalidRules(trouble.message, hint=trouble.hint, code=trouble.code)
        return cast(Compound, result)

    def vocabulary(self) -> dict[str, str]:
        """The words that can be asked, with the kinds of their arguments, and what each means."""
        rows = self.call("signature(Head, Meaning)")
        ours = {str(row["Head"]).replace(",", ", "): str(row["Meaning"]) for row in rows}
        return ours | {word: meaning for words in self.rules.values() for word, meaning in words.items()}

    def phrase(self, text: str) -> Phrase:
        """What a phrase such as "near the oven" or "the red cup on the table" means; see `Phrase`."""
        result = self._engine.request(Atom("phrase"), text, timeout_s=1.0)
        if _is(result, "problem"):
            return Phrase("thing", "", problem=_problem(result))
        kind, relation, names, goal, definite = cast(Compound, result).args
        return Phrase(
            kind=cast(Literal["thing", "place", "question"], str(kind)),
            goal=str(goal),
            variables=tuple([str(name) for name in cast(list[Term], names)]),
            definite={str(the.args[0]): str(the.args[1]) for the in cast(list[Compound], definite)},
            relation=None if relation == Atom("none") else str(relation),
        )

    @staticmethod
    def _expect(name: str, result: Term) -> Compound:
        if _is(result, "problem"):
            trouble = _problem(result)
            raise GoalFailed(trouble.message, hint=trouble.hint, code=trouble.code)
        return cast(Compound, result)


def _is(term: Term, name: str) -> bool:
    return type(term) is Compound and term.name == name


def _problem(term: Term) -> Problem:
    code, message, hint = cast(Compound, term).args
    return Problem(str(code), str(message), str(hint) or None)


def _reply(result: Term, elapsed_ms: float, explained: str | None = None) -> Reply:
    """What the engine's result says; `explained`: the goal that was to be explained, None when it was not."""
    if _is(result, "problem"):
        return Reply("unknown", problem=_problem(result), elapsed_ms=elapsed_ms)
    truth, names, rows, truncated, trouble, reasons = cast(Compound, result).args
    children = tuple([_explanation(reason) for reason in cast(list[Term], reasons)])
    return Reply(
        truth=cast(Truth, str(truth)),
        answers=_answers(names, rows),
        truncated=truncated == Atom("true"),
        problem=_problem(trouble) if _is(trouble, "problem") else None,
        explanation=_joined(explained, cast(Truth, str(truth)), children) if explained is not None else None,
        elapsed_ms=elapsed_ms,
    )


def _union(replies: list[Reply], limit: int) -> Reply | None:
    """The reply to a question of which these answer the parts; None where only the whole tells which answers there
    are: more than the limit, with a problem, or with variables that have no value."""
    if any(reply.problem is not None or reply.truncated for reply in replies):
        return None
    rows = {str([term_text(term) for term in row.values()]): row for reply in replies for row in reply.answers}
    if len(rows) > limit or any(_has_variable(term) for row in rows.values() for term in row.values()):
        return None
    unknown = any(reply.truth == "unknown" for reply in replies)
    return Reply(
        truth="true" if rows else "unknown" if unknown else "false",
        answers=tuple(rows.values()),
        elapsed_ms=sum(reply.elapsed_ms for reply in replies),
    )


def _has_variable(term: Term) -> bool:
    if isinstance(term, Compound | list):
        return any(_has_variable(item) for item in (term.args if isinstance(term, Compound) else term))
    return isinstance(term, Var)


def _answers(names: Term, rows: Term) -> tuple[dict[str, Term], ...]:
    keys = [str(name) for name in cast(list[Term], names)]
    return tuple([dict(zip(keys, row, strict=True)) for row in cast(list[list[Term]], rows)])


def _viewer(viewer: Viewer) -> Term:
    if viewer is None:
        return Atom("none")
    if isinstance(viewer, str):
        return Atom(viewer)
    x, y, z = viewer
    return Compound("point", (float(x), float(y), float(z)))


def _test(term: Term) -> Test:
    name, value, comparison, threshold_name, threshold, unit = cast(Compound, term).args
    return Test(
        measurement=str(name),
        value=value,
        comparison=str(comparison),
        threshold_name=str(threshold_name),
        threshold=threshold,
        unit=None if unit == Atom("none") else str(unit),
    )


def _explanation(term: Term) -> Explanation:
    goal, truth, rule, tests, evidence, children = cast(Compound, term).args
    return Explanation(
        goal=str(goal),
        truth=cast(Truth, str(truth)),
        rule=str(rule),
        tests=tuple([_test(test) for test in cast(list[Term], tests)]),
        evidence=tuple(cast(list[Term], evidence)),
        children=tuple([_explanation(child) for child in cast(list[Term], children)]),
    )


def _joined(goal: str, truth: Truth, children: tuple[Explanation, ...]) -> Explanation:
    if len(children) == 1 and children[0].goal == "what is asked":
        children = children[0].children
    return Explanation(goal=goal, truth=truth, children=children)


def _brief(value: Term) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plain(value: Term) -> Any:
    return value if isinstance(value, (int, float, str)) else term_text(value)
