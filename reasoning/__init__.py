"""Symbolic reasoning: facts in, questions out, through one Prolog process with limits."""

from reasoning.errors import (
    EngineUnavailable,
    GoalFailed,
    InvalidFact,
    InvalidRules,
    InvalidTerm,
    ReasoningError,
)
from reasoning.knowledge import DerivedEdge, Explanation, KnowledgeBase, Phrase, Problem, Reply, Test
from reasoning.terms import Atom, Compound, Term, Var

__all__ = [
    "Atom",
    "Compound",
    "DerivedEdge",
    "EngineUnavailable",
    "Explanation",
    "GoalFailed",
    "InvalidFact",
    "InvalidRules",
    "InvalidTerm",
    "KnowledgeBase",
    "Phrase",
    "Problem",
    "ReasoningError",
    "Reply",
    "Term",
    "Test",
    "Var",
]
