"""What the world returns ⇄ what travels: small functions, one for each verb."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from mapping.geometry import SE3
from reasoning.knowledge import Explanation, Test
from scenegraph.errors import Problem
from scenegraph.graph import Node
from scenegraph.service.errors import InvalidMessage, UnknownKey
from scenegraph.service.messages import (
    AskReply,
    Binding,
    GoalPose,
    MapQuery,
    MapValues,
    NodeBinding,
    PlanReply,
    PlanStep,
    Region,
    TellReply,
    ValueBinding,
    WhereAnswer,
    WhereReply,
)

__all__ = [
    "ask_reply",
    "bound",
    "explanation_of",
    "json_value",
    "map_layer",
    "map_values",
    "plan_reply",
    "problem_from",
    "tell_reply",
    "where_reply",
]

MAX_POINTS = 1_000_000
"""Points of one map query: they are looked up by the thread that maps."""


def problem_from(given: Any) -> Problem | None:
    """A `Problem` of whatever carries `code`, `message` and `hint`; None of None."""
    if given is None or isinstance(given, Problem):
        return given
    if isinstance(given, Mapping):
        return Problem(code=str(given["code"]), message=str(given["message"]), hint=given.get("hint"))
    code, message = getattr(given, "code", "problem"), getattr(given, "message", None)
    return Problem(
        code=str(code), message=str(given if message is None else message), hint=getattr(given, "hint", None)
    )


def json_value(value: Any) -> Any:
    """`value` made of JSON's types only; models and dataclasses by their fields, anything else by its text."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): json_value(item) for name, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_value(item) for item in value]
    if hasattr(value, "as_json"):
        return json_value(value.as_json())
    fields = getattr(value, "__dataclass_fields__", None)
    return {name: json_value(getattr(value, name)) for name in fields} if fields else str(value)


def _binding(value: Any) -> Binding:
    return NodeBinding(node=value.id) if isinstance(value, Node) else ValueBinding(value=json_value(value))


def ask_reply(answers: Any, *, revision: int, elapsed_ms: float, explain: bool, nodes: bool) -> AskReply:
    """The reply that carries a world's `Answers`."""
    rows = [dict(row) for row in answers]
    named = {value.id: value for row in rows for value in row.values() if isinstance(value, Node)} if nodes else {}
    return AskReply(
        truth=answers.truth,
        answers=tuple({name: _binding(value) for name, value in row.items()} for row in rows),
        truncated=bool(answers.truncated),
        revision=revision,
        elapsed_ms=round(elapsed_ms, 3),
        problem=problem_from(answers.problem),
        explanation=json_value(answers.explain()) if explain else None,
        nodes=tuple(named.values()) if nodes else None,
    )


def bound(row: Mapping[str, Binding], nodes: Mapping[str, Node]) -> dict[str, Any]:
    """An answer's variables with the nodes and values that they stand for."""
    return {
        name: nodes.get(binding.node, binding.node) if isinstance(binding, NodeBinding) else binding.value
        for name, binding in row.items()
    }


def explanation_of(document: Mapping[str, Any]) -> Explanation:
    """An explanation as it was before it travelled; terms have become text and numbers."""
    return Explanation(
        goal=str(document["goal"]),
        truth=document["truth"],
        rule=str(document.get("rule", "")),
        tests=tuple(Test(**test) for test in document.get("tests", ())),
        evidence=tuple(document.get("evidence", ())),
        children=tuple(explanation_of(child) for child in document.get("children", ())),
        observations=tuple(document.get("observations", ())),
    )


def _region(given: Any) -> Region | None:
    if given is None:
        return None
    corners = tuple(
        (float(x), float(y)) for x, y in np.asarray(given.polygon, dtype=np.float64).reshape(-1, 2).tolist()
    )
    return Region(polygon=corners, z_min=float(given.z_min), z_max=float(given.z_max))


def _goal_pose(given: Any) -> GoalPose:
    length = given.path_length_m
    pose = given.pose if isinstance(given.pose, SE3) else SE3.from_matrix(given.pose)
    known = length is not None and np.isfinite(length)
    return GoalPose(pose=pose, clearance_m=float(given.clearance_m), path_length_m=float(length) if known else None)


def _ids(given: Iterable[Any]) -> tuple[str, ...]:
    return tuple(item.id if isinstance(item, Node) else str(item) for item in given)


def where_reply(place: Any, phrase: str) -> WhereReply:
    """The reply that carries a world's `Place`."""
    return WhereReply(
        truth=place.truth,
        phrase=phrase,
        answers=tuple(
            WhereAnswer(
                nodes=_ids(answer.nodes), region=_region(answer.region), poses=tuple(map(_goal_pose, answer.poses))
            )
            for answer in place.answers
        ),
        ambiguous=tuple(json_value(item) for item in getattr(place, "ambiguous", ())),
        problem=problem_from(getattr(place, "problem", None)),
    )


def plan_reply(plan: Any) -> PlanReply:
    """The reply that carries a world's `Plan`."""
    return PlanReply(
        status=plan.status,
        steps=tuple(
            PlanStep(
                action=step.action,
                arguments=step.arguments,
                target=step.target,
                preconditions=step.preconditions,
                effects=step.effects,
            )
            for step in plan.steps
        ),
        problem=problem_from(plan.problem),
        goal=plan.goal,
        rooms=plan.rooms,
        revision=plan.revision,
        elapsed_ms=round(plan.elapsed_ms, 3),
    )


def tell_reply(result: Any) -> TellReply:
    """The reply that carries a world's `TellResult`."""
    return TellReply(accepted=result.accepted, revision=result.revision, problem=problem_from(result.problem))


def map_layer(world: Any, name: str) -> Any:
    """A layer of the world by name. Raises `UnknownKey` when the world has none of this name."""
    layer = getattr(world.map, name, None)
    if layer is None:
        raise UnknownKey(f"this world has no map layer {name}")
    return layer


def map_values(name: str, layer: Any, query: MapQuery, layers: Any = None) -> MapValues:
    """A value for each of the points, with what is unknown marked.

    layers : has the other layers by their names: of semantics, the instances, and what was observed, are told, too
    """
    if len(query.points) > MAX_POINTS:
        raise InvalidMessage(f"expected at most {MAX_POINTS} points, got {len(query.points)}", field="MapQuery.points")
    points = np.asarray(query.points, dtype=np.float64)
    if not np.isfinite(points).all():
        raise InvalidMessage("expected finite numbers, got NaN or infinity", field="MapQuery.points")
    if name == "semantics":
        labels, confidence = layer.query(points)
        labels = np.asarray(labels).astype(np.uint16, copy=False)
        confidence = np.asarray(confidence).astype(np.float32, copy=False)
        instances, occupancy = getattr(layers, "instances", None), getattr(layers, "occupancy", None)
        return MapValues(
            layer=name,
            values=labels,
            known=labels > 0,
            confidence=np.nan_to_num(confidence),
            instance=None if instances is None else np.asarray(instances.query(points)).astype(np.uint32, copy=False),
            observed=None if occupancy is None else (labels > 0) | ~np.isnan(occupancy.query(points)),
        )
    if name == "instances":
        ids = np.asarray(layer.query(points)).astype(np.uint32, copy=False)
        return MapValues(layer=name, values=ids, known=ids > 0)
    gradient = None
    if query.gradient and name == "esdf":
        values, gradient = layer.query(points, gradient=True)
        gradient = np.nan_to_num(np.asarray(gradient)).astype(np.float32, copy=False)
    else:
        values = layer.query(points)
    values = np.asarray(values).astype(np.float32, copy=False)
    known = ~np.isnan(values)
    return MapValues(layer=name, values=np.where(known, values, np.float32(0)), known=known, gradient=gradient)
