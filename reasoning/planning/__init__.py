"""Task planning: a domain, objects, facts and a goal in; a plan out.

It knows neither graph nor map. Domains are read by unified-planning, plans found by pyperplan (or another planner that
unified-planning knows) and checked by unified-planning's validator; all of that is imported where it is used.
"""

from reasoning.planning.planner import Planner, PlannerUnavailable
from reasoning.planning.task import Action, Domain, Fact, Outcome, Task, fact_text, household

__all__ = [
    "Action",
    "Domain",
    "Fact",
    "Outcome",
    "Planner",
    "PlannerUnavailable",
    "Task",
    "fact_text",
    "household",
]
