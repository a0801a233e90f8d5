"""What can go wrong when the rule base is loaded, fed or asked.

```
ReasoningError             "reasoning"
├── InvalidTerm            "invalid_term": a Python value without a Prolog counterpart (also a ValueError)
├── InvalidFact            "invalid_fact": a fact outside the vocabulary of facts (also a ValueError)
├── InvalidRules           "invalid_rules": a rule file with an error or a warning (also a ValueError)
├── GoalFailed             a trusted call raised, or ran out of time or memory: the code says which
└── EngineUnavailable      "engine_unavailable": the Prolog process could not be started, or was closed
```

A goal that a *user* asks never raises: its reply carries a `Problem` with the same three fields.
"""

from __future__ import annotations


class ReasoningError(Exception):
    """The root of this package's errors: a code, one line, and a hint where there is one."""

    code = "reasoning"

    def __init__(self, message: str, *, hint: str | None = None, code: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint
        if code is not None:
            self.code = code


class InvalidTerm(ReasoningError, ValueError):
    """A Python value cannot be written as a Prolog term, or an answer cannot be read as one."""

    code = "invalid_term"


class InvalidFact(ReasoningError, ValueError):
    """A fact is not one of the documented ground facts (`reasoning.facts.FACTS`)."""

    code = "invalid_fact"


class InvalidRules(ReasoningError, ValueError):
    """A rule file has an error or a warning; the message names file and line."""

    code = "invalid_rules"


class GoalFailed(ReasoningError):
    """A trusted call could not be carried out to the end; `code` says why (`timeout`, `resource_limit`, …)."""

    code = "goal_failed"


class EngineUnavailable(ReasoningError):
    """The Prolog worker process could not be started."""

    code = "engine_unavailable"
