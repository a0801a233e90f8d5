"""Whatever is asked, sought, planned for, told or defined: nothing gets out, nothing stays, and the next is served.

Each text is a goal that wants something it must not have, or more than it may have. It comes in by every way that takes
text; it is refused, or broken off within its limit, the world is what it was, and the next question is answered soon.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scenegraph import World
from scenegraph.errors import GoalRefused
from scenegraph.statements import telling
from tests.support.told_building import furnished_world

TIME_S = 0.5
NEXT_S = 1.0
MARK = "hostile_was_here"

HOSTILE = {
    # files
    "write a file": f"open('{MARK}', write, S), write(S, x), close(S)",
    "read a file": "read_file_to_string('/etc/passwd', X, [])",
    "list a folder": "directory_files('.', X)",
    "delete a file": "delete_file('/tmp/x')",
    "load a program": "consult('/tmp/evil.pl')",
    "load a library": "use_module(library(process))",
    # shell, network, process
    "shell": f"shell('touch {MARK}')",
    "shell inside a negation": f"\\+ \\+ shell('touch {MARK}')",
    "shell as the template's goal": f"findall(X, shell('touch {MARK}'), L)",
    "run a program": "process_create(path(touch), [x], [])",
    "environment": "setenv('PATH', '/tmp'), getenv('HOME', X)",
    "open a socket": "tcp_connect('127.0.0.1':80, S, [])",
    "halt": "halt",
    "halt by its parts": "X = halt, call(X)",
    "halt by name": "G =.. [halt, 0], call(G)",
    "stop a thread": "thread_create(repeat, Id, []), thread_join(Id, S)",
    # code
    "assert in our modules": "assertz(vocabulary:on(a, b))",
    "assert facts": "facts:assertz(position(object_1, 0, 0, 0))",
    "assert by text": "term_to_atom(G, 'assertz(spatial:contact_share(0))'), call(G)",
    "forget everything": "facts:forget_everything",
    "retract a threshold": "retractall(spatial:near_most(_))",
    "override a threshold": "override(near_most(1000))",
    "change the syntax": "op(700, xfx, on)",
    "change a flag": "set_prolog_flag(stack_limit, 1)",
    "a goal after the goal": "true. :- halt",
    "quotes that end early": f'named(X, "a\\"), shell(\'touch {MARK}\'), Y = (\\"b")',
    "a comment that hides": f"true /* \n*/ , shell('touch {MARK}') % ",
    "an escape that spells": "\\x68\\\\x61\\lt",
    "letters that look alike": "hаlt, ѕhell(ls), оn(X, Y)",
    "invisible marks": "ha\u200blt(\u202e)",
    "half a surrogate": "label(X, \ud800)",
    "a zero in a name": "label(X, 'oven\\x0\\halt')",
    # without an end
    "endless": "repeat, fail",
    "endless counting": "between(1, inf, X), X < 0",
    "endless lists": "length(L, N), N < 0",
    "endless backtracking": "member(X, L), fail",
    "an infinite term": "X = f(X), X == f(f(X))",
    "all pairs of all pairs": "near(A, B), near(C, D), near(E, F), near(G, H), near(I, J), A == J, B == C, H == D",
    # too much
    "a long list": "length(L, 100000000)",
    "a large number": "X is 7 ** (7 ** (7 ** 7))",
    "a large text": "findall(X, between(1, inf, X), L)",
    "many answers": "between(1, 100000000, X)",
    "large answers": "length(L, 100000), between(1, inf, X)",
    "doubling": ", ".join(f"A{n} = f(A{n - 1}, A{n - 1})" for n in range(1, 60)),
    "sorted doubling": "findall(X-Y, (between(1, 10000, X), between(1, 10000, Y)), L), msort(L, M)",
    "deep brackets": "(" * 5000 + "true" + ")" * 5000,
    "deep negation": "\\+ " * 6000 + "true",
    "too long": "true, " * 5000 + "true",
}


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with furnished_world(2) as world:
        assert world.tell(
            telling("ours", 'signature(high(thing), "").\nhigh(X) :- on(X, table).'), author="us"
        ).accepted
        world.ask("on(X, table)")
        yield world


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def state(world: World) -> Any:
    """All that a goal could change: the graph, the facts, the rules with their thresholds, the syntax."""
    rules = (
        "findall(M:P-N, (member(M, [facts, spatial, taxonomy, rooms, viewpoint, vocabulary, goals, readings, explain, "
        "told_words, user_rules, structure, affordances, user, question]), current_predicate(M:P0/A), "
        "P = P0/A, \\+ sub_atom(P0, 0, 1, _, $), functor(H, P0, A), \\+ predicate_property(M:H, imported_from(_)), "
        "\\+ member(P0, [current_revision, answer, viewer_now]), "
        "predicate_property(M:H, number_of_clauses(N))), Ps0), sort(Ps0, Ps), term_hash(Ps, Rules), "
        "findall(T-V, spatial:threshold(T, V, _, _), Thresholds), "
        "aggregate_all(count, current_op(_, _, question:_), Operators), current_prolog_flag(stack_limit, Stack)"
    )
    knowledge = world.meaning.knowledge
    [told] = knowledge.call(rules)
    told = {name: str(told[name]) for name in ("Rules", "Thresholds", "Operators", "Stack")}
    return world.graph.revision, len(world.graph), len(knowledge), knowledge.rules, told, sorted(os.listdir("."))


def is_served(world: World) -> None:
    began = time.monotonic()
    assert world.ask("near(X, oven)").truth == "true"
    assert time.monotonic() - began < NEXT_S


@pytest.mark.parametrize("way", ["ask", "where", "plan", "watch", "tell", "fact", "rules"])
@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_nothing_gets_out_and_the_next_is_served(world: World, way: str, text: str) -> None:
    before = state(world)
    began = time.monotonic()
    if way == "ask":
        answers = world.ask(text, timeout_s=TIME_S)
        assert answers.problem is not None or len(answers) <= 100
        assert answers.truth != "false" or answers.problem is None
        assert time.monotonic() - began < TIME_S + 2.0
    elif way == "where":
        assert not world.where(text).answers
    elif way == "plan":
        assert world.plan(text, timeout_s=TIME_S).status != "solved"
    elif way == "watch":
        _watch(world, text)
    elif way == "tell":
        assert not world.tell(text, author="someone").accepted
    elif way == "fact":  # text in a fact is text
        said = f"said({json.dumps(text, ensure_ascii=False)})"
        if world.tell(f"fact({said})", author="someone").accepted:
            assert world.ask("fact(said(_))").truth == "true"
            world.tell(f"retract({said})", author="someone")
    else:
        rules = json.dumps(f'signature(evil(any), "").\nevil(_) :- true, {text}.', ensure_ascii=False)
        told = world.tell(f"rules(evil, {rules})", author="someone")
        if told.accepted:
            assert world.ask("evil(1)", timeout_s=TIME_S).truth != "false"
            assert world.tell("forget_rules(evil)", author="someone").accepted
    assert time.monotonic() - began < 8.0
    is_served(world)
    after = state(world)
    assert after[1:] == before[1:]
    assert not Path(MARK).exists()


def _watch(world: World, text: str) -> None:
    try:
        with world.watch(text, timeout_s=TIME_S) as changes:
            list(changes)
    except GoalRefused:
        return
