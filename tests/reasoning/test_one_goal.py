"""One goal at a time: nothing is passed over in silence."""

import pytest

from reasoning.knowledge import KnowledgeBase


@pytest.fixture(scope="module")
def knowledge():
    with KnowledgeBase() as knowledge:
        yield knowledge


@pytest.mark.parametrize("goal", ["1 < 2. halt", "1 < 2. halt.", "1 < 2. 3 < 4", "1 < 2.\n\n X"])
def test_text_after_the_full_stop_is_refused(knowledge: KnowledgeBase, goal: str) -> None:
    reply = knowledge.ask(goal)
    assert reply.problem is not None
    assert reply.problem.code == "syntax_error"
    assert "full stop" in reply.problem.message


@pytest.mark.parametrize("goal", ["1 < 2", "1 < 2.", " 1 < 2 .\n", "1 < 2 % less", "1.5 < 2.5"])
def test_a_goal_may_end_with_a_full_stop_or_without(knowledge: KnowledgeBase, goal: str) -> None:
    assert knowledge.ask(goal).truth == "true"
