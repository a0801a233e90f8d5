"""Nothing that is asked can stop the engine, reach outside it, change what is known, or pass for an answer."""

from __future__ import annotations

import gc
import os
import time
from pathlib import Path

import pytest

from reasoning import GoalFailed, InvalidFact, InvalidRules, KnowledgeBase
from reasoning.engine import Engine
from reasoning.terms import Atom
from tests.reasoning.homes import fact, small_home


@pytest.mark.parametrize(
    "goal",
    [
        "shell(ls)",
        'shell("rm -rf /")',
        "open('/etc/passwd', read, S)",
        "halt",
        "halt(1)",
        "assert(on(a, b))",
        "assertz(foo)",
        "asserta(foo)",
        "retract(on(a, b))",
        "retractall(on(_, _))",
        "consult('/tmp/x.pl')",
        "[user]",
        "load_files(x, [])",
        "use_module(library(process))",
        "thread_create(true, _, [])",
        "read(X)",
        "write(x)",
        "format('~w', [x])",
        "getenv('HOME', X)",
        "set_prolog_flag(stack_limit, 1)",
        "nb_setval(x, 1)",
        "facts:forget_everything",
        "facts:assertz(told(x))",
        "vocabulary:on(X, Y)",
        "user:halt",
        "system:shell(ls)",
        "catch(true, _, true)",
        "findall(X, shell(ls), L)",
        "\\+ shell(ls)",
        "forall(on(X, Y), halt)",
        "on(X, Y), halt",
        "(true ; halt)",
        "(halt -> true ; true)",
        "aggregate_all(count, halt, N)",
        "once(halt)",
        "call(halt)",
        "limit(1, halt)",
        "order_by([asc(X)], halt)",
        "call(call, halt)",
        "X = halt, X",
        "X = halt, call(X)",
        "clause(on(X, Y), B)",
        "current_op(X, Y, Z)",
        "tab(user_output, 1)",
        "process_create(path(ls), [], [])",
    ],
)
def test_what_reaches_outside_is_forbidden(home: KnowledgeBase, goal: str) -> None:
    reply = home.ask(goal)
    assert reply.problem is not None
    assert reply.problem.code == "forbidden", reply
    assert (reply.truth, reply.answers) == ("unknown", ())


@pytest.mark.parametrize(
    "goal", ["repeat, fail", "between(1, inf, _), fail", "between(1, inf, X), X < 0", "length(L, _), fail"]
)
def test_an_endless_goal_times_out(home: KnowledgeBase, goal: str) -> None:
    started = time.monotonic()
    reply = home.ask(goal, timeout_s=0.2)
    assert reply.problem is not None
    assert reply.problem.code in ("timeout", "resource_limit")
    assert time.monotonic() - started < 5
    assert home.ask("on(cup_1, table_1)").truth == "true"


def test_answers_found_before_the_time_was_up_are_kept(home: KnowledgeBase) -> None:
    reply = home.ask("between(1, inf, X), X =< 3", timeout_s=0.2)
    assert [answer["X"] for answer in reply.answers] == [1, 2, 3]
    assert reply.truth == "true"
    assert reply.problem is not None
    assert reply.problem.code == "timeout"


def test_the_number_of_answers_is_limited(home: KnowledgeBase) -> None:
    reply = home.ask("between(1, inf, X)", limit=5)
    assert [answer["X"] for answer in reply.answers] == [1, 2, 3, 4, 5]
    assert reply.truncated
    assert reply.problem is None
    assert not home.ask("between(1, 5, X)", limit=5).truncated


@pytest.mark.parametrize(
    "goal", ["length(L, 100_000_000)", "findall(X, between(1, inf, X), L)", "X is 7 ** (7 ** (7 ** 7))"]
)
def test_a_memory_bomb_is_a_problem(fresh: KnowledgeBase, goal: str) -> None:
    reply = fresh.ask(goal, timeout_s=2.0)
    assert reply.problem is not None
    assert reply.problem.code in ("resource_limit", "timeout")
    assert fresh.ask("on(cup_1, table_1)").truth == "true"


def test_an_infinite_term_is_no_answer(home: KnowledgeBase) -> None:
    reply = home.ask("X = f(X)")
    assert reply.answers == ()
    assert home.ask("on(cup_1, table_1)").truth == "true"


def test_a_goal_too_long_to_read_is_refused(home: KnowledgeBase) -> None:
    reply = home.ask("(" * 100_000)
    assert reply.problem is not None
    assert reply.problem.code == "resource_limit"


def test_a_deep_goal_is_refused_or_answered_but_harmless(home: KnowledgeBase) -> None:
    reply = home.ask("\\+ " * 3_000 + "true")
    assert reply.truth == "true" or reply.problem is not None
    assert home.ask("on(cup_1, table_1)").truth == "true"


def test_a_killed_worker_is_replaced_and_knows_everything_again(fresh: KnowledgeBase) -> None:
    fresh.update(deleted=[fact("label", "tv_1", "tv")], forget=["sofa_1"])
    before = {
        goal: fresh.ask(goal) for goal in ("on(X, Y)", "in(X, kitchen)", "near(chair, oven)", "instance_of(X, tv)")
    }
    assert fresh.engine.pid is not None
    os.kill(fresh.engine.pid, 9)
    after = {goal: fresh.ask(goal) for goal in before}
    assert after == before
    assert fresh.engine.restarts == 1


def test_a_worker_that_cannot_be_interrupted_is_killed(fresh: KnowledgeBase) -> None:
    with pytest.raises(GoalFailed) as caught:
        fresh.call("sleep(100)", timeout_s=0.1)
    assert caught.value.code == "timeout"
    assert fresh.ask("on(cup_1, table_1)").truth == "true"


def test_what_a_rule_prints_does_not_reach_the_answers(tmp_path: Path) -> None:
    rules = tmp_path / "talk.pl"
    rules.write_text("chatty(X) :- format('[\"pong\"]~n'), X = 1.\n")
    with KnowledgeBase([rules]) as knowledge:
        assert knowledge.ask("chatty(X)").answers == ({"X": 1},)


def test_rule_files_may_override_thresholds_and_add_words(tmp_path: Path) -> None:
    rules = tmp_path / "mine.pl"
    rules.write_text(":- override(contact_share(0.97)).\nstacked(X) :- on(X, Y), on(Y, _).\n")
    with KnowledgeBase([rules]) as knowledge:
        knowledge.update(small_home())
        assert knowledge.ask("on(cup_1, table_1)").truth == "false"
        assert knowledge.ask("on(book_1, table_1)").truth == "true"
        assert knowledge.ask("stacked(book_1)").truth == "true"


def test_a_users_rule_is_unknown_where_what_it_rests_on_is(tmp_path: Path) -> None:
    rules = tmp_path / "mine.pl"
    rules.write_text(
        """
        handy(X) :- instance_of(O, oven), near(X, O).
        safe(X) :- instance_of(X, furniture), instance_of(O, oven), \\+ near(X, O).
        either(X) :- ( handy(X) ; safe(X) ).
        chosen(X, Y) :- ( handy(X) -> Y = handy ; Y = not_handy ).
        first(X) :- on(X, _), !.
        calm :- forall(instance_of(X, chair), \\+ handy(X)).
        """
    )
    with KnowledgeBase([rules]) as knowledge:
        knowledge.update(small_home())
        truths = {
            goal: knowledge.ask(goal).truth
            for goal in (
                "handy(cup_1)",
                "handy(chair_1)",
                "handy(tv_1)",
                "handy(chair)",
                "safe(chair_1)",
                "safe(table_1)",
                "safe(sofa_1)",
                "\\+ handy(chair_1)",
                "either(chair_1)",
                "chosen(cup_1, handy)",
                "chosen(tv_1, not_handy)",
                "chosen(chair_1, handy)",
                "first(X)",
                "calm",
            )
        }
        assert truths == {
            "handy(cup_1)": "true",
            "handy(chair_1)": "unknown",
            "handy(tv_1)": "false",
            "handy(chair)": "unknown",
            "safe(chair_1)": "unknown",
            "safe(table_1)": "false",
            "safe(sofa_1)": "true",
            "\\+ handy(chair_1)": "unknown",
            "either(chair_1)": "unknown",
            "chosen(cup_1, handy)": "true",
            "chosen(tv_1, not_handy)": "true",
            "chosen(chair_1, handy)": "unknown",
            "first(X)": "true",
            "calm": "unknown",
        }
        assert "a user's rule" in (knowledge.ask("handy(X)", explain=True).explanation or "").text  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("broken(X :- y.\n", "bad.pl:1"),
        (":- override(nonsense(1)).\n", "nonsense"),
        (":- override(contact_share(much)).\n", "much"),
        ("p(X) :- q(Y).\n", "ingleton"),
        (":- fail.\n", "bad.pl:1"),
        ("on(a, b).\n", "on/2"),
    ],
)
def test_a_bad_rule_file_is_refused_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    rules = tmp_path / "bad.pl"
    rules.write_text(text)
    with pytest.raises(InvalidRules, match=complaint):
        KnowledgeBase([rules])


def test_a_missing_rule_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRules, match="not a file"):
        KnowledgeBase([tmp_path / "none.pl"])


@pytest.mark.parametrize(
    "term",
    [fact("nonsense", 1), fact("node", "a"), fact("told", "x", "y")],
    ids=str,
)
def test_a_fact_outside_the_vocabulary_is_refused(home: KnowledgeBase, term: object) -> None:
    with pytest.raises(InvalidFact):
        home.update([term])  # type: ignore[list-item]


def test_a_closed_engine_says_so_and_closes_twice() -> None:
    engine = Engine()
    assert engine.ping()
    engine.close()
    engine.close()
    with pytest.raises(Exception, match="closed"):
        engine.request(Atom("ping"), timeout_s=1)


def test_a_forgotten_engine_ends_its_worker() -> None:
    engine = Engine()
    pid = engine.pid
    assert pid is not None
    del engine
    gc.collect()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_ping(home: KnowledgeBase) -> None:
    assert home.engine.ping()
