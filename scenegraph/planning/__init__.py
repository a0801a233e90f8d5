"""Task planning in a scene graph: goals in the words of questions, plans of steps that name nodes and poses."""

from scenegraph.planning.plan import Check, Plan, PlanCheck, Step

__all__ = ["Check", "Plan", "PlanCheck", "Step"]
