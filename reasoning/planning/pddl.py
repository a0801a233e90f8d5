"""PDDL texts of others, put in the form that unified-planning reads; nothing here changes what they mean to a planner
that looks for any plan.

What is changed, and why:

- comments go, and names become lower case, since PDDL knows no difference (`?LEnd` is `?lEnd`)
- `:functions`, `:metric` and `(increase …)` go: they say what a plan costs, and functions without values in a problem
  are an error in unified-planning
- an object that is listed twice is listed once, since unified-planning refuses it
- the parts of a problem are put in the order `:domain :requirements :objects :init :goal`; its reader knows no other
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from typing import TypeAlias

__all__ = ["normalised"]

Tree: TypeAlias = "str | list[Tree]"

_TOKEN = re.compile(r";[^\n]*|[()]|[^\s();]+")
_COSTS = (":functions", ":metric", "increase", "decrease", "assign")
_ORDER = ("problem", ":domain", ":requirements", ":objects", ":init", ":goal")


def normalised(text: str) -> str:
    """The text of a domain or a problem. Raises ValueError when its brackets do not match."""
    trees = _trees(text)
    if len(trees) != 1 or not isinstance(trees[0], list):
        raise ValueError(f"expected one (define …), got {len(trees)} parts")
    tree = [part for part in (_without_costs(part) for part in trees[0]) if part is not None]
    if any(_head(part) == "problem" for part in tree):
        tree = [_each_once(part) if _head(part) == ":objects" else part for part in tree]
        tree = tree[:1] + sorted(tree[1:], key=lambda part: _ORDER.index(_head(part)) if _head(part) in _ORDER else 99)
    return "\n".join(_lines(tree)) + "\n"


def _trees(text: str) -> list[Tree]:
    stack: list[list[Tree]] = [[]]
    for match in _TOKEN.finditer(text):
        token = match[0].lower()
        if token.startswith(";"):
            continue
        if token == "(":
            stack.append([])
        elif token == ")":
            if len(stack) == 1:
                raise ValueError(f"a bracket too many at character {match.start()}")
            closed = stack.pop()
            stack[-1].append(closed)
        else:
            stack[-1].append(token)
    if len(stack) != 1:
        raise ValueError(f"{len(stack) - 1} brackets are not closed")
    return stack[0]


def _head(tree: Tree) -> str:
    return tree[0] if isinstance(tree, list) and tree and isinstance(tree[0], str) else ""


def _without_costs(tree: Tree) -> Tree | None:
    """The tree without what only says what a plan costs; None when nothing else was in it."""
    if isinstance(tree, str):
        return tree
    if _head(tree) in _COSTS or (_head(tree) == "=" and any(isinstance(t, list) for t in tree)):
        return None
    return [part for part in (_without_costs(part) for part in tree) if part is not None]


def _each_once(objects: Tree) -> Tree:
    """The list of objects, `name … - type …`, without repetitions of a name."""
    seen: set[str] = set()
    found: list[Tree] = [":objects"]
    names: list[Tree] = []
    parts = iter(objects[1:])
    for part in parts:
        if part == "-":
            kind = next(parts, "object")
            found += [*names, "-", kind] if names else []
            names = []
        elif not isinstance(part, str) or part not in seen:
            names.append(part)
            seen.add(str(part))
    return [*found, *names]


def _lines(tree: Tree, depth: int = 0) -> Iterator[str]:
    """The tree with a part a line, where it does not fit in one; names side by side."""
    flat = _flat(tree)
    if isinstance(tree, str) or len(flat) + depth < 110:
        yield " " * depth + flat
        return
    words: list[str] = []
    opening = "("
    for part in [*tree, None]:
        if isinstance(part, str):
            words.append(part)
            continue
        if words or opening:
            text = opening + " ".join(words)
            yield from textwrap.wrap(
                text, 110, initial_indent=" " * depth, subsequent_indent=" " * (depth + 2), break_on_hyphens=False,
                break_long_words=False,
            )  # fmt: skip
        words, opening = [], ""
        if part is not None:
            yield from _lines(part, depth + 1)
    yield " " * depth + ")"


def _flat(tree: Tree) -> str:
    return tree if isinstance(tree, str) else f"({' '.join(map(_flat, tree))})"
