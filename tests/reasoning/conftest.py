"""Knowledge bases for the tests: one process for all that only ask, a fresh one for those that change or kill it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from reasoning import KnowledgeBase
from tests.reasoning.homes import small_home


@pytest.fixture(scope="session")
def home() -> Iterator[KnowledgeBase]:
    """The small home; tests must not change it."""
    with KnowledgeBase() as knowledge:
        knowledge.update(small_home())
        yield knowledge


@pytest.fixture
def fresh() -> Iterator[KnowledgeBase]:
    """The small home in a process of its own."""
    with KnowledgeBase() as knowledge:
        knowledge.update(small_home())
        yield knowledge
