"""Questions in words: what a text that is no goal means as one, and which of its "the" fit several things."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Final

from reasoning.knowledge import KnowledgeBase, Phrase, Problem, Reply
from reasoning.terms import Atom

__all__ = ["ambiguous", "answered", "is_phrase", "read"]

_WORDS: Final = re.compile(r"['`]?\w[\w'`.,;!?-]*(\s+['`]?\w[\w'`.,;!?-]*)+(\s+[.,;!?])?")
_ARITHMETIC: Final = re.compile(r"[A-Z_]\w*\s+is\s+[-\dA-Z_]")
_MOST_NAMED = 5


def is_phrase(text: str) -> bool:
    """Whether a text is words, not a goal: two of them at least, and neither bracket nor operator.

    `X is 3` is a goal; "Is the cup on the table?" is not.
    """
    bare = text.strip()
    return _WORDS.fullmatch(bare) is not None and _ARITHMETIC.match(bare) is None


def read(text: str, knowledge: KnowledgeBase) -> Phrase:
    """What a phrase means; a goal is a question that means itself."""
    return knowledge.phrase(text) if is_phrase(text) else Phrase("question", text)


def ambiguous(phrase: Phrase, reply: Reply) -> dict[str, tuple[str, ...]]:
    """The variables that were called by "the" and have several values in the answers, with the ids of these."""
    found = {}
    for name in phrase.definite:
        ids = dict.fromkeys(t.name for row in reply.answers if isinstance(t := row.get(name), Atom))
        if len(ids) > 1:
            found[name] = tuple(ids)
    return found


def answered(phrase: Phrase, reply: Reply) -> Reply:
    """The reply to a phrase; where a "the" fits several things it is the question which one, with what fits as
    answers."""
    several = ambiguous(phrase, reply)
    if not several or reply.problem is not None:
        return reply
    name, ids = next(iter(several.items()))
    named = ", ".join(f"`{node}`" for node in ids[:_MOST_NAMED]) + (", …" if len(ids) > _MOST_NAMED else "")
    noun = phrase.definite[name].replace("_", " ")
    problem = Problem(
        "ambiguous",
        f"`the {noun}` fits {len(ids)} things: {named}",
        f"which one? Say more of it, such as where it is, or ask for `a {noun}` or `all`",
    )
    return replace(reply, truth="unknown", problem=problem)
